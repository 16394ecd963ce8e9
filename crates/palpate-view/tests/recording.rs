//! Recorded data is in the file, read back with Rerun's decoder.
#![cfg(feature = "rerun")]
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::io::{self, Write};

use nalgebra::{DVector, Isometry3, Point3, Vector3, dvector};
use palpate::unstable::{LinkContacts, LinkId};
use palpate::{CellId, ContactConfig, Contacts, ExternalTorqueConfig, Field, Lattice};
use palpate_view::contents::{chunks, layout, rows, scalars};
use palpate_view::view_model::{CONTACTS, LinkShape};
use palpate_view::{DrawnSample, Recording, SampleTorque, Scene, ViewError};
use re_sdk::log::Chunk;
use re_sdk_types::archetypes::{Arrows3D, Mesh3D, Points3D, Transform3D};
use re_sdk_types::components::{Position3D, Translation3D, Vector3D};

fn lattice() -> Lattice {
    Lattice::new([0.0; 3], 0.01, [100; 3]).unwrap()
}

fn scene() -> Scene {
    let corners = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]];
    let link = |name: &str| LinkShape {
        name: name.to_owned(),
        vertices_m: corners.map(Point3::from).to_vec(),
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    };
    Scene {
        name: "a test".to_owned(),
        about: "Nothing real.".to_owned(),
        links: vec![link("upper"), link("fore/arm")],
        world_from_link: poses(0).to_vec(),
        joints: vec!["shoulder".to_owned(), "elbow 2".to_owned()],
        lattice: lattice(),
        clock: true,
        torques: true,
    }
}

/// Contacts with `many` cells, each displaced along y by its number in millimetres.
fn contacts(many: u32) -> Contacts {
    let cells = (0..many).map(CellId).collect();
    let displacements_m = (0..many).map(|n| [0.0, 0.001 * n as f32, 0.0]).collect();
    let links = vec![LinkContacts { link: LinkId(1), cells, displacements_m }];
    Contacts { links: if many > 0 { links } else { Vec::new() } }
}

fn tau(sample: u64) -> [DVector<f64>; 2] {
    let part = sample as f64;
    [dvector![3.0 * part, 4.0 * part], dvector![3.0 * part, 4.0 * part + 0.5]]
}

/// Poses of two links, which depend on the sample's number.
fn poses(sample: u64) -> [Isometry3<f64>; 2] {
    let x = 0.01 * sample as f64;
    [Isometry3::identity(), Isometry3::new(Vector3::new(x, 0.2, 0.3), Vector3::z() * x)]
}

/// Records samples 0 to 299; the first ten have no torque, and samples 100 to 199 have contacts.
fn say(recording: &mut Recording<'_>) -> Result<(), ViewError> {
    recording.touch("seq_0", 0, Some(0.0))?;
    for sample in 0..300 {
        let [measured, predicted] = tau(sample);
        let touching = if (100..200).contains(&sample) { contacts(5) } else { contacts(0) };
        let torque = SampleTorque { measured: &measured, predicted: &predicted };
        recording.frame(&DrawnSample {
            sample,
            time_s: Some(0.02 * sample as f64),
            world_from_link: &poses(sample),
            contacts: &touching,
            torque: (sample >= 10).then_some(torque),
        })?;
    }
    Ok(())
}

fn recorded(
    scene: &Scene,
    say: impl FnOnce(&mut Recording<'_>) -> Result<(), ViewError>,
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut recording = Recording::to_file(&mut bytes, scene).unwrap();
    say(&mut recording).unwrap();
    recording.finish().unwrap();
    bytes
}

/// The values of a component in all rows of an entity.
fn all<C: re_sdk::Component>(
    chunks: &[Chunk],
    entity: &str,
    component: re_sdk::ComponentDescriptor,
) -> Vec<Vec<C>> {
    let of = chunks.iter().filter(|chunk| chunk.entity_path().to_string() == entity);
    let rows = of.flat_map(|chunk| {
        let rows = chunk.iter_component::<C>(component.component);
        rows.map(|row| row.as_slice().to_vec()).collect::<Vec<_>>()
    });
    rows.collect()
}

#[test]
fn every_sample_is_there_with_its_torques() {
    let bytes = recorded(&scene(), say);
    let rows = rows(&bytes).unwrap();
    assert_eq!(rows["/contacts"], 301, "a name, and a number for each sample");
    for entity in ["/touches", "/about", "/world/arm/upper", "/world/arm/fore\\/arm"] {
        assert!(rows.contains_key(entity), "{entity} in {rows:?}");
    }
    for (joint, entity) in ["/torque/shoulder", "/torque/elbow\\ 2"].iter().enumerate() {
        for (which, what) in ["measured", "predicted"].iter().enumerate() {
            let said = scalars(&bytes, &format!("{entity}/{what}")).unwrap();
            let expected: Vec<f64> = (10..300).map(|sample| tau(sample)[which][joint]).collect();
            assert_eq!(said, expected, "{entity}/{what}");
        }
    }
    let norms = scalars(&bytes, "/torque/norm/measured").unwrap();
    assert_eq!((norms[0], norms.len()), (50.0, 290)); // 3-4-5
    assert!(scalars(&bytes, "/torque/norm/error").unwrap().iter().all(|e| (e - 0.5).abs() < 1e-9));
}

#[test]
fn links_have_their_shape_once_and_a_pose_in_every_sample() {
    let bytes = recorded(&scene(), say);
    let chunks = chunks(&bytes).unwrap();
    let entity = "/world/arm/fore\\/arm";
    let shapes = all::<Position3D>(&chunks, entity, Mesh3D::descriptor_vertex_positions());
    assert_eq!((shapes.len(), shapes[0].len()), (1, 4));
    let at = all::<Translation3D>(&chunks, entity, Transform3D::descriptor_translation());
    assert_eq!(at.len(), 300);
    for (sample, at) in at.iter().enumerate() {
        assert_eq!(at[0].0.0, [(0.01 * sample as f64) as f32, 0.2, 0.3]);
    }
}

#[test]
fn arrows_go_from_rest_to_where_the_points_are_and_vanish_with_the_contact() {
    let bytes = recorded(&scene(), say);
    let chunks = chunks(&bytes).unwrap();
    let arrows = "/world/contacts/displaced";
    let vectors = all::<Vector3D>(&chunks, arrows, Arrows3D::descriptor_vectors());
    let origins = all::<Position3D>(&chunks, arrows, Arrows3D::descriptor_origins());
    let tips = all::<Position3D>(&chunks, "/world/contacts/at", Points3D::descriptor_positions());
    assert_eq!((vectors.len(), tips.len()), (101, 101), "a hundred, and one that clears");
    assert!(vectors[100].is_empty() && tips[100].is_empty());
    for n in 0..5 {
        let rest = lattice().point(CellId(n as u32)).cast::<f32>();
        assert_eq!(origins[0][n].0.0, [rest.x, rest.y, rest.z]);
        assert_eq!(vectors[0][n].0.0, [0.0, 0.001 * n as f32, 0.0]);
        assert_eq!(tips[0][n].0.0, [rest.x, rest.y + 0.001 * n as f32, rest.z]);
    }
}

#[test]
fn of_many_contacts_some_are_drawn_and_all_are_counted() {
    let bytes = recorded(&scene(), |recording| {
        let [measured, predicted] = tau(1);
        recording.frame(&DrawnSample {
            sample: 0,
            time_s: None,
            world_from_link: &poses(0),
            contacts: &contacts(4000),
            torque: Some(SampleTorque { measured: &measured, predicted: &predicted }),
        })
    });
    assert_eq!(scalars(&bytes, "/contacts").unwrap(), [4000.0]);
    let chunks = chunks(&bytes).unwrap();
    let drawn =
        all::<Vector3D>(&chunks, "/world/contacts/displaced", Arrows3D::descriptor_vectors());
    assert_eq!(drawn[0].len(), CONTACTS);
    let timelines: Vec<String> =
        chunks.iter().flat_map(|c| c.timelines().keys()).map(|t| t.to_string()).collect();
    assert!(timelines.iter().all(|name| name == "sample"), "no clock, no time: {timelines:?}");
}

#[test]
fn the_field_has_its_stiffness_and_its_colours_in_words() {
    let stiffness_n_per_m = vec![200.0, 100.0, 0.1];
    let (contact, touch) = (ContactConfig::default(), ExternalTorqueConfig::default());
    let mut field = Field::new(lattice(), contact, touch, 0.01);
    field.cells = (0..3).map(CellId).collect();
    (field.stiffness_n_per_m, field.std_n_per_m) = (stiffness_n_per_m, vec![1.0; 3]);
    field.counts = vec![3, 5, 7];
    let bytes = recorded(&scene(), |recording| {
        recording.field(&field, 0, None)?;
        recording.field(&field, 9, None)
    });
    let rows = rows(&bytes).unwrap();
    assert_eq!((rows["/world/field"], rows["/colours"]), (2, 1), "words only when they change");
    let chunks = chunks(&bytes).unwrap();
    let of = chunks.iter().find(|c| c.entity_path().to_string() == "/world/field").unwrap();
    let known: Vec<String> = of.components_identifiers().map(|id| id.to_string()).collect();
    for name in ["K_N_per_m", "K_std_N_per_m", "frames_that_touched"] {
        assert!(known.iter().any(|id| id == name), "{name} in {known:?}");
    }
    let points = all::<Position3D>(&chunks, "/world/field", Points3D::descriptor_positions());
    assert_eq!(points[0].len(), 2, "the softest is below the colours");
}

#[test]
fn a_file_that_is_cut_off_is_no_recording() {
    let bytes = recorded(&scene(), say);
    assert!(chunks(&bytes).unwrap().len() > 10);
    assert!(chunks(&bytes[..16.min(bytes.len())]).map_or(true, |chunks| chunks.is_empty()));
    assert!(chunks(b"no recording at all").is_err());
}

/// A writer that accepts this number of bytes; then the disk is full.
struct Full(usize);

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if bytes.len() > self.0 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        self.0 -= bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_an_error_of_the_call_that_writes() {
    for room in [0, 20_000, 60_000] {
        let mut out = Full(room);
        let result = Recording::to_file(&mut out, &scene()).and_then(|mut recording| {
            say(&mut recording)?;
            recording.finish()
        });
        match result {
            Err(ViewError::Write(error)) => assert_eq!(error.kind(), io::ErrorKind::StorageFull),
            other => panic!("with room for {room} bytes: {other:?}"),
        }
    }
}

#[test]
fn an_invalid_address_and_a_missing_viewer_are_named() {
    let refused = |url: &str| Recording::to_viewer(url, &scene()).err().unwrap().to_string();
    for url in ["", "nonsense", "http://127.0.0.1:9876", "rerun+http://127.0.0.1:9876/other"] {
        let said = refused(url);
        assert!(said.contains("is no address") && said.contains("/proxy"), "{said}");
    }
    // No process listens on a port that was free just before.
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let said = refused(&format!("rerun+http://127.0.0.1:{port}/proxy"));
    assert!(said.contains("no Rerun viewer answers") && said.contains(&port.to_string()), "{said}");
}

#[test]
fn the_layout_has_a_view_a_joint_and_a_camera() {
    let laid_out = layout(&recorded(&scene(), say)).unwrap();
    let views = laid_out.iter().filter(|entity| entity.ends_with("/ViewContents")).count();
    assert_eq!(views, 7, "space, three of words, the norm, two joints: {laid_out:?}");
    let legends = laid_out.iter().filter(|entity| entity.ends_with("/PlotLegend")).count();
    assert_eq!(legends, 3, "the norm, two joints: {laid_out:?}");
    let cameras = laid_out.iter().filter(|entity| entity.ends_with("/EyeControls3D")).count();
    assert_eq!(cameras, 1, "{laid_out:?}");
}
