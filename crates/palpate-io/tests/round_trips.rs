//! Written files read back exactly, to the last bit: touches of each writer, and fields. The tests
//! for clouds, arrays and headers are beside their writers.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod common;

use std::fs::File;
use std::sync::Arc;

use palpate::unstable::{ElasticBody, ElasticModel, ElasticVariant, Segment, SegmentKind};
use palpate::{Calibration, CellId, EstimatorKind, Field, LearntTorques, MapperConfig};
use palpate_io::body;
use palpate_io::field::npz::{Array, Data, read_npz, write_npz};
use palpate_io::field::{FieldFile, FieldLattice, SavedField, from_bytes, load, save, to_bytes};
use palpate_io::log::Sample;
use palpate_io::log::bag_write::{BagWriter, Compression};
use palpate_io::log::write::{ArraysWriter, TableWriter, TouchWriter};
use proptest::prelude::*;

/// Touches with their names.
type Touches = Vec<(String, Vec<Sample>)>;

/// Any finite number.
fn number() -> impl Strategy<Value = f64> {
    prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO
}

/// One to three touches of one to four joints; times are whole nanoseconds, in order.
fn touches(name: &'static str) -> impl Strategy<Value = Touches> {
    (1usize..5).prop_flat_map(move |joints| {
        let torques = || prop::collection::vec(number(), joints);
        let samples = prop::collection::vec((torques(), torques(), 1u32..9_000_000), 1..12);
        prop::collection::vec((name, samples), 1..4).prop_map(|touches| {
            let mut ns = 1_700_000_000_000_000_000_u64;
            let mut sample = |(q, tau, later)| {
                ns += u64::from(later);
                Sample::new(Some(seconds(ns)), q, tau)
            };
            let mut touch = |(name, samples): (String, Vec<_>)| {
                (name, samples.into_iter().map(&mut sample).collect())
            };
            touches.into_iter().map(&mut touch).collect()
        })
    })
}

/// Converts ns to s as the reader of bags does.
fn seconds(ns: u64) -> f64 {
    (ns / 1_000_000_000) as f64 + (ns % 1_000_000_000) as f64 * 1e-9
}

fn write(mut out: impl TouchWriter, touches: &Touches) {
    for (name, samples) in touches {
        out.touch(name).unwrap();
        samples.iter().for_each(|sample| out.sample(sample).unwrap());
    }
    out.finish().unwrap();
}

/// Samples as bits, so that 0 and −0 differ.
fn bits(touches: &Touches) -> Vec<Vec<u64>> {
    let numbers = |sample: &Sample| {
        let numbers = sample.q.iter().chain(&sample.tau).chain(&sample.time_s).copied();
        numbers.map(f64::to_bits).collect()
    };
    touches.iter().flat_map(|(_, samples)| samples.iter().map(numbers)).collect()
}

/// The names, with a number appended to those that occurred before.
fn unique(touches: &Touches) -> Vec<String> {
    let mut given: Vec<String> = Vec::new();
    for (name, _) in touches {
        let numbered = |n: usize| if n == 1 { name.clone() } else { format!("{name}_{n}") };
        given.push((1..).map(numbered).find(|name| !given.contains(name)).unwrap());
    }
    given
}

fn names_of(touches: &Touches) -> Vec<String> {
    touches.iter().map(|(name, _)| name.clone()).collect()
}

/// A field on a lattice of 5 x 6 x 7 points.
fn fields() -> impl Strategy<Value = FieldFile> {
    let row = (number(), number(), any::<u32>(), number());
    let rows = prop::collection::btree_map(0u32..210, row, 0..30);
    (rows, prop::array::uniform3(-100.0..100.0), 1e-3..1.0, any::<[bool; 4]>()).prop_map(
        |(rows, origin_m, spacing_m, has)| {
            let column = |of: fn(&(f64, f64, u32, f64)) -> f64| rows.values().map(of).collect();
            FieldFile {
                points: rows.values().map(|row| [row.0, row.1, row.3]).collect(),
                stiffness: column(|row| row.0.abs().min(1e12)),
                std: has[0].then(|| column(|row| row.1.abs().min(1e12))),
                counts: has[1].then(|| rows.values().map(|row| row.2).collect()),
                prior: has[2].then(|| column(|row| row.3.abs().min(1e12))),
                lattice: has[3].then_some(FieldLattice { origin_m, spacing_m, shape: [5, 6, 7] }),
                cells: has[3].then(|| rows.keys().copied().collect()),
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_table_holds_touches_of_any_name(written in touches(r"[^\pC\s](\PC{0,18}[^\pC\s])?")) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        write(TableWriter::new(File::create(&path).unwrap(), None), &written);
        let found = common::touches(&path);
        prop_assert_eq!(bits(&found), bits(&written));
        prop_assert_eq!(names_of(&found), unique(&written));
    }

    #[test]
    fn folders_of_arrays_hold_touches_in_their_order_whatever_they_are_called(
        written in touches("\\PC{0,300}"),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        write(ArraysWriter::new(&path).unwrap(), &written);
        let found = common::touches(&path);
        prop_assert_eq!(bits(&found), bits(&written));
        prop_assert_eq!(found.len(), written.len());
    }

    #[test]
    fn a_bag_holds_touches_of_any_name(
        written in touches("\\PC{1,300}"),
        compression in prop::sample::select(&[Compression::None, Compression::Zstd, Compression::Lz4][..]),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.mcap");
        let joints = (0..written[0].1[0].q.len()).map(|joint| format!("j{joint}")).collect();
        write(BagWriter::new(File::create(&path).unwrap(), joints, compression).unwrap(), &written);
        let found = common::touches(&path);
        prop_assert_eq!(bits(&found), bits(&written));
        prop_assert_eq!(names_of(&found), unique(&written));
    }

    #[test]
    fn a_field_reads_back_exactly(field in fields()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("field.npz");
        write_npz(&path, &field.to_arrays()).unwrap();
        prop_assert_eq!(FieldFile::from_arrays(&read_npz(&path).unwrap()).unwrap(), field);
    }
}

/// A stem with a branch and a leaf, and a stem beside it.
fn variant() -> ElasticVariant {
    let piece = |parent: Option<u32>, z: f64, kind| Segment {
        parent,
        kind,
        start_m: [0.1, 0.2, z],
        end_m: [0.1 + 1e-3 / 3.0, 0.2, z + 0.06],
        bare_m: 0.01,
        radius_m: 0.008,
        half_width_m: [0.0, 0.01, 0.0],
        joint_stiffness: 20.0 / 3.0,
        branch: 0,
    };
    let (wood, leaf) = (SegmentKind::Wood, SegmentKind::Leaf);
    let segments = vec![
        piece(None, 0.0, wood),
        piece(Some(0), 0.06, wood),
        piece(Some(0), 0.05, leaf),
        piece(None, 0.0, wood),
    ];
    let body = ElasticBody::new(segments).unwrap();
    ElasticVariant { body, weight: 1.0, stiffness_factors: vec![2.0, 3.0] }
}

#[test]
fn a_body_that_bends_reads_back_with_its_touches_and_a_broken_one_is_refused() {
    let variant = ElasticVariant { stiffness_factors: vec![1.0 / 7.0, 1.0], ..variant() };
    let learnt = LearntTorques { error_n_m: vec![0.1, 0.2], torque_n_m: vec![1.0, 2.0] };
    let model = ElasticModel {
        variants: vec![variant],
        friction: 0.4,
        creep_s: 1e-4,
        torque_limit_n_m: None,
        share: 1.0 / 3.0,
        n_touches: 2,
        speed_m_per_s: 0.3,
        residual_cells: vec![CellId(7), CellId(3)],
        residual_n_per_m: vec![0.1, 1.0 / 9.0],
        untouched_residual_n_per_m: 0.0,
        calibration: Calibration::of_other_objects(&learnt, 2, 0.5),
    };
    let config = MapperConfig::of(EstimatorKind::Elastic);
    let mut field = Field::new(config.lattice, config.contact, config.touch, 0.0);
    field.cells = vec![CellId(3), CellId(1)];
    (field.stiffness_n_per_m, field.std_n_per_m) = (vec![1.0, 2.0], vec![0.5, 0.5]);
    (field.counts, field.elastic) = (vec![1, 0], Some(Arc::new(model)));
    let sample = |time_s| Sample::new(time_s, vec![0.1, 1.0 / 3.0], vec![-1.0, 2.0]);
    let mut saved = SavedField::of_field(field, "arm");
    saved.elastic_touches =
        vec![vec![sample(Some(-0.5)), sample(Some(0.5))], vec![], vec![sample(None)]];
    let bytes = to_bytes(&saved);
    let read = from_bytes(&bytes, "field.npz").unwrap();
    assert!(read.field.bands().is_some());
    assert_eq!(read.field, saved.field);
    assert_eq!(read.elastic_touches, saved.elastic_touches);

    let with = |change: &dyn Fn(&mut ElasticModel)| {
        let mut broken = saved.clone();
        change(Arc::make_mut(broken.field.elastic.as_mut().unwrap()));
        from_bytes(&to_bytes(&broken), "field.npz").unwrap_err().to_string()
    };
    let error = with(&|model| model.share = 1.5);
    assert!(error.contains("share of the elastic model is 1.5"), "{error}");
    let error = with(&|model| model.variants.push(model.variants[0].clone()));
    assert!(error.contains("sum of weights of the elastic model is 2"), "{error}");
    let error = with(&|model| model.variants[0].stiffness_factors.push(1.0));
    assert!(error.contains("stiffness_factors"), "{error}");
    let error = with(&|model| model.residual_n_per_m.truncate(1));
    assert!(error.contains("K_residual"), "{error}");
    let error = with(&|model| model.residual_cells[1] = CellId(u32::MAX));
    assert!(error.contains("a residual cell of the elastic model is 4294967295"), "{error}");
    let error = with(&|model| model.speed_m_per_s = 0.0);
    assert!(error.contains("speed_m_per_s of the elastic model is 0"), "{error}");
    let error = with(&|model| model.calibration.as_mut().unwrap().by_torque = -1.0);
    assert!(error.contains("the bands hold -1"), "{error}");
}

#[test]
fn a_body_reads_back_from_its_json_and_a_broken_one_says_where() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("body.json");
    let written = variant().body;
    std::fs::write(&path, body::json(&written)).unwrap();
    assert_eq!(body::read(&path).unwrap(), written);
    for (from, to, words) in [
        ("\"radius_m\":0.008", "\"radius_m\":-1", "radius_m of segment 0 is -1"),
        ("\"parent\":0", "\"parent\":7", "is segment 7"),
        ("\"radius_m\"", "\"radius\"", "unknown field `radius`"),
        ("]}", "", "is not the JSON"),
    ] {
        std::fs::write(&path, body::json(&written).replacen(from, to, 1)).unwrap();
        let error = body::read(&path).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("body.json"), "{error}");
    }
}

#[test]
fn a_mujoco_model_has_the_bodies_joints_and_springs() {
    let xml = body::mujoco_xml(&variant(), 0.4);
    let model = roxmltree::Document::parse(&xml).unwrap();
    let of = |name: &str| model.descendants().filter(|node| node.has_tag_name(name)).count();
    assert_eq!((of("body"), of("joint"), of("geom")), (4, 4, 5)); // one geom is in <default>
    let stiffness: Vec<f64> = (model.descendants())
        .filter_map(|node| node.attribute("stiffness")?.parse().ok())
        .collect();
    assert_eq!(stiffness, [40.0 / 3.0, 40.0 / 3.0, 40.0 / 3.0, 20.0]);
    let second = model.descendants().find(|n| n.attribute("name") == Some("segment_1")).unwrap();
    assert_eq!(second.parent().unwrap().attribute("name"), Some("segment_0"));
    assert_eq!(second.attribute("pos"), Some("0 0 0.06"));
}

#[test]
fn a_cushion_as_a_mujoco_model_has_three_slides_a_block_and_a_tendon_between_neighbours() {
    let block = |(at, material): (u32, u32)| Segment {
        parent: None,
        kind: SegmentKind::Block,
        start_m: [0.04 * f64::from(at), 0.0, 0.2],
        end_m: [0.04 * f64::from(at) + 0.04, 0.0, 0.2],
        bare_m: 0.0,
        radius_m: 0.004,
        half_width_m: [0.0, 0.02, 0.0],
        joint_stiffness: 10.0,
        branch: material,
    };
    let body = ElasticBody::new([(0, 0), (1, 0), (2, 1)].map(block).to_vec()).unwrap();
    let json = body::json(&body);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("body.json");
    std::fs::write(&path, &json).unwrap();
    assert_eq!(body::read(&path).unwrap(), body);

    let variant = ElasticVariant { body, weight: 1.0, stiffness_factors: vec![2.0, 4.0] };
    let xml = body::mujoco_xml(&variant, 0.4);
    let model = roxmltree::Document::parse(&xml).unwrap();
    let of = |name: &str| -> Vec<f64> {
        let nodes = model.descendants().filter(|node| node.has_tag_name(name));
        nodes.filter_map(|node| node.attribute("stiffness")?.parse().ok()).collect()
    };
    assert_eq!(of("joint"), [80.0, 80.0, 20.0, 80.0, 80.0, 20.0, 160.0, 160.0, 40.0]);
    assert_eq!(of("fixed"), [20.0, 30.0]);

    std::fs::write(&path, json.replace("\"parent\":null", "\"parent\":0")).unwrap();
    let error = body::read(&path).unwrap_err().to_string();
    assert!(error.contains("the parent of segment 0 is segment 0"), "{error}");
}

#[test]
fn points_that_are_not_those_of_their_cells_are_refused_with_their_row() {
    let config = MapperConfig::of(EstimatorKind::Map);
    let mut field = Field::new(config.lattice, config.contact, config.touch, 0.0);
    field.cells = vec![CellId(3), CellId(1), CellId(90_000)];
    (field.stiffness_n_per_m, field.std_n_per_m) = (vec![1.0, 2.0, 3.0], vec![0.5; 3]);
    field.counts = vec![1; 3];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("field.npz");
    save(&path, &SavedField::of_field(field, "arm")).unwrap();
    let whole = read_npz(&path).unwrap();
    let points = whole.floats("points", &[None, Some(3)]).unwrap();
    let with = |change: &dyn Fn(&mut [f64])| {
        let (mut arrays, mut points) = (whole.clone(), points.clone());
        change(&mut points);
        arrays.insert("points", Array::new(vec![3, 3], Data::F64(points)));
        write_npz(&path, &arrays).unwrap();
        load(&path).map_err(|error| error.to_string())
    };
    let rounded = with(&|points| points.iter_mut().for_each(|x| *x = f64::from(*x as f32)));
    assert!(rounded.is_ok(), "{rounded:?}");
    for (row, change) in [
        (0, &(|points: &mut [f64]| points.rotate_left(3)) as &dyn Fn(&mut [f64])),
        (2, &|points| points[8] += 0.005),
    ] {
        let error = with(change).unwrap_err();
        assert!(error.contains(&format!("row {row} (from 0) of `points`")), "{error}");
    }
}
