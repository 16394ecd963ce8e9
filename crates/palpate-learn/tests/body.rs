//! The body of a simulated plant is reconstructed from a cloud of its seen side.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};
use palpate::unstable::{ElasticBody, Segment, SegmentKind};
use palpate_learn::body::{
    ObjectCloud, ObjectHints, ObjectKind, candidate_bodies, guess_viewpoint,
};

const BROWN: [u8; 3] = [110, 65, 30];
const GREEN: [u8; 3] = [40, 110, 30];
const EYE: Point3<f64> = Point3::new(-0.5, -0.6, 0.6);

/// A cloud as a camera sees it: only surfaces that face the camera.
struct Seen {
    eye: Point3<f64>,
    points: Vec<Point3<f64>>,
    colours: Vec<[u8; 3]>,
}

impl Default for Seen {
    fn default() -> Self {
        Self { eye: EYE, points: Vec::new(), colours: Vec::new() }
    }
}

fn of_kind(kind: ObjectKind) -> ObjectHints {
    ObjectHints { kind: Some(kind), ..ObjectHints::default() }
}

impl Seen {
    /// A tapering rod; the part between two shares of its length (`hidden`) is not seen.
    fn rod(&mut self, from: [f64; 3], to: [f64; 3], radii: [f64; 2], hidden: [f64; 2]) {
        let (from, to) = (Point3::from(from), Point3::from(to));
        let axis = (to - from).normalize();
        let across = axis.cross(&Vector3::x()).try_normalize(0.1).unwrap_or(Vector3::y());
        let other = axis.cross(&across);
        let steps = ((to - from).norm() / 0.0015) as usize;
        for step in 0..=steps {
            let share = step as f64 / steps as f64;
            if (hidden[0]..hidden[1]).contains(&share) {
                continue;
            }
            let radius = radii[0] + (radii[1] - radii[0]) * share;
            let around = (std::f64::consts::TAU * radius / 0.0012) as usize;
            for turn in 0..around {
                let angle = std::f64::consts::TAU * turn as f64 / around as f64;
                let normal = across * angle.cos() + other * angle.sin();
                let point = from + (to - from) * share + normal * radius;
                if normal.dot(&(self.eye - point)) > 0.0 {
                    self.points.push(point);
                    self.colours.push(BROWN);
                }
            }
        }
    }

    fn leaf(&mut self, middle: [f64; 3], along: Vector3<f64>, wide: Vector3<f64>) {
        for i in -70..=70 {
            for j in -30..=30 {
                let (a, b) = (f64::from(i) / 70.0, f64::from(j) / 30.0);
                if a * a + b * b <= 1.0 {
                    self.points.push(Point3::from(middle) + along * a + wide * b);
                    self.colours.push(GREEN);
                }
            }
        }
    }

    fn picture(&self, viewpoint: Option<Point3<f64>>) -> ObjectCloud<'_> {
        ObjectCloud { points: &self.points, colours: &self.colours, viewpoint }
    }

    fn body(&self, viewpoint: Option<Point3<f64>>) -> ElasticBody {
        candidate_bodies(&[self.picture(viewpoint)], &of_kind(ObjectKind::Plant)).remove(0)
    }
}

/// A stem of half a metre with one branch, and a leaf that hides a part of it.
fn plant() -> Seen {
    let mut seen = Seen::default();
    seen.rod([0.5, 0.0, 0.1], [0.5, 0.0, 0.6], [0.012, 0.008], [2.0, 3.0]);
    seen.rod([0.5, 0.0, 0.4], [0.36, -0.14, 0.46], [0.006, 0.004], [0.4, 0.6]);
    let (middle, along) =
        (Point3::new(0.43, -0.07, 0.43), Vector3::new(-0.14, -0.14, 0.06).normalize());
    let towards = (EYE - middle).normalize();
    let wide = along.cross(&towards).normalize();
    seen.leaf((middle + 0.03 * towards).into(), 0.035 * along, 0.016 * wide);
    seen
}

fn distance_from_rod(point: &Point3<f64>, from: [f64; 3], to: [f64; 3]) -> f64 {
    let (from, to) = (Point3::from(from), Point3::from(to));
    let way = to - from;
    let share = ((point - from).dot(&way) / way.norm_squared()).clamp(0.0, 1.0);
    (point - (from + way * share)).norm()
}

fn wood(body: &ElasticBody) -> Vec<&Segment> {
    body.segments().iter().filter(|segment| segment.kind == SegmentKind::Wood).collect()
}

fn branches(body: &ElasticBody) -> BTreeSet<u32> {
    wood(body).iter().map(|segment| segment.branch).collect()
}

/// The segments without a parent.
fn rooted(body: &ElasticBody) -> Vec<&Segment> {
    body.segments().iter().filter(|segment| segment.parent.is_none()).collect()
}

#[test]
fn a_plant_seen_from_one_side_has_its_axes_where_they_are() {
    let body = plant().body(Some(EYE));
    assert_eq!(branches(&body).len(), 2, "a stem and a branch");
    for segment in wood(&body) {
        for end in [segment.start_m, segment.end_m].map(Point3::from) {
            let stem = distance_from_rod(&end, [0.5, 0.0, 0.08], [0.5, 0.0, 0.6]);
            let branch = distance_from_rod(&end, [0.5, 0.0, 0.4], [0.36, -0.14, 0.46]);
            assert!(stem.min(branch) < 0.006, "{end} is {} m from wood", stem.min(branch));
        }
    }
    let length: f64 = wood(&body).iter().map(|segment| segment.axis().norm()).sum();
    assert!((length - (0.52 + 0.207)).abs() < 0.04, "{length} m of wood");
}

#[test]
fn radii_are_those_of_the_rods() {
    let body = plant().body(Some(EYE));
    let stem: Vec<&Segment> = wood(&body).into_iter().filter(|s| s.branch == 0).collect();
    for segment in &stem[1..] {
        let share = (0.5 * (segment.start_m[2] + segment.end_m[2]) - 0.1) / 0.5;
        let wanted = 0.012 - 0.004 * share;
        let off = segment.radius_m / wanted - 1.0;
        assert!(off.abs() < 0.12, "{} m at {share}, wanted {wanted}", segment.radius_m);
    }
}

#[test]
fn a_branch_hangs_from_the_stem_across_what_is_hidden_and_the_leaf_from_the_branch() {
    let body = plant().body(Some(EYE));
    let segments = body.segments();
    let first = segments.iter().find(|segment| segment.branch == 1).unwrap();
    let carrier = &segments[first.parent.unwrap() as usize];
    assert_eq!(carrier.branch, 0);
    assert!((first.start_m[2] - 0.4).abs() < 0.015, "it starts at {:?}", first.start_m);
    let leaves: Vec<&Segment> = segments.iter().filter(|s| s.kind == SegmentKind::Leaf).collect();
    assert_eq!(leaves.len(), 1);
    assert_eq!(segments[leaves[0].parent.unwrap() as usize].branch, 1);
}

#[test]
fn a_guessed_camera_gives_nearly_the_same_body() {
    let (known, guessed) = (plant().body(Some(EYE)), plant().body(None));
    assert_eq!(wood(&known).len(), wood(&guessed).len());
    for (known, guessed) in wood(&known).iter().zip(wood(&guessed)) {
        let apart = (known.start() - guessed.start()).norm();
        assert!(apart < 0.006, "{:?} and {:?}", known.start_m, guessed.start_m);
    }
}

#[test]
fn the_same_cloud_gives_the_same_body_to_the_bit() {
    assert_eq!(plant().body(None), plant().body(None));
}

#[test]
fn clouds_without_a_body_give_none_and_no_panic() {
    let grid = |n: i32| -> Vec<Point3<f64>> {
        let place =
            |at: i32| Point3::new(0.002 * f64::from(at % n), 0.002 * f64::from(at / n), 0.0);
        (0..n * n).map(place).collect()
    };
    let same = vec![Point3::new(0.5, 0.0, 0.3); 2000];
    let clouds = [vec![], vec![Point3::origin()], vec![EYE; 3], same, grid(60), grid(300)];
    let plants = of_kind(ObjectKind::Plant);
    for points in clouds {
        for colours in [vec![BROWN; points.len()], vec![GREEN; points.len()]] {
            for viewpoint in [None, Some(EYE)] {
                // Any body is allowed, also a meaningless one.
                candidate_bodies(
                    &[ObjectCloud { points: &points, colours: &colours, viewpoint }],
                    &plants,
                );
            }
        }
    }
    assert_eq!(candidate_bodies(&[], &plants), []);
    assert_eq!(candidate_bodies(&[], &ObjectHints::default()), []);
}

#[test]
fn two_cameras_see_a_stem_from_both_sides_and_it_is_as_thick_as_it_is() {
    let eyes = [EYE, Point3::new(1.5, 0.6, 0.6)];
    let seen = eyes.map(|eye| {
        let mut seen = Seen { eye, ..Seen::default() };
        seen.rod([0.5, 0.0, 0.1], [0.5, 0.0, 0.6], [0.012, 0.008], [2.0, 3.0]);
        seen.rod([0.5, 0.0, 0.4], [0.4, -0.1, 0.44], [0.006, 0.004], [2.0, 3.0]);
        seen
    });
    let pictures = [seen[0].picture(Some(eyes[0])), seen[1].picture(Some(eyes[1]))];
    let bodies = candidate_bodies(&pictures, &ObjectHints::default());
    let guessed = [seen[0].picture(None), seen[1].picture(None)];
    for body in [&bodies[0], &candidate_bodies(&guessed, &ObjectHints::default())[0]] {
        let stem = wood(body).into_iter().filter(|segment| segment.branch == 0);
        for segment in stem.filter(|segment| segment.start_m[2] > 0.11) {
            let off = distance_from_rod(&segment.start(), [0.5, 0.0, 0.08], [0.5, 0.0, 0.6]);
            assert!(off < 0.002, "{} is {off} m from the axis", segment.start());
            let radius = 0.012 - 0.008 * (segment.start_m[2] + 0.03 - 0.1);
            assert!(
                (segment.radius_m / radius - 1.0).abs() < 0.15,
                "{} m, not {radius}",
                segment.radius_m
            );
        }
        assert_eq!(branches(body).len(), 2, "a stem and a branch, as from one side");
    }
}

#[test]
fn a_camera_that_looked_elsewhere_changes_nothing() {
    let seen = plant();
    let alone = candidate_bodies(&[seen.picture(Some(EYE))], &ObjectHints::default());
    let empty =
        ObjectCloud { points: &[], colours: &[], viewpoint: Some(Point3::new(1.0, 1.0, 1.0)) };
    let with_empty = candidate_bodies(&[seen.picture(Some(EYE)), empty], &ObjectHints::default());
    assert_eq!(alone, with_empty);
    // A close-up of the foot does not show the space behind the leaf above.
    let mut foot = Seen { eye: Point3::new(0.5, -0.3, 0.12), ..Seen::default() };
    foot.rod([0.5, 0.0, 0.1], [0.5, 0.0, 0.14], [0.012, 0.01168], [2.0, 3.0]);
    let with_foot = [seen.picture(Some(EYE)), foot.picture(Some(foot.eye))];
    let with_foot = candidate_bodies(&with_foot, &ObjectHints::default());
    assert_eq!(branches(&alone[0]), branches(&with_foot[0]));
}

#[test]
fn a_plant_hangs_from_its_root_wherever_that_is() {
    let seen = plant();
    for (root, segment_from) in [([0.5, 0.0, 0.65], 0.65), ([0.5, 0.0, 0.6], 0.6)] {
        let hints = ObjectHints { roots_m: vec![root.into()], ..ObjectHints::default() };
        let body = &candidate_bodies(&[seen.picture(Some(EYE))], &hints)[0];
        let rooted = rooted(body);
        assert_eq!(rooted.len(), 1);
        assert!((rooted[0].start_m[2] - segment_from).abs() < 0.01, "{:?}", rooted[0].start_m);
        assert!(rooted[0].end_m[2] < rooted[0].start_m[2], "it hangs down");
    }
    // Two roots at one piece: both hold it, and nothing else does.
    let roots_m = vec![[0.5, 0.0, 0.1].into(), [0.5, 0.0, 0.6].into()];
    let hints = ObjectHints { roots_m, ..ObjectHints::default() };
    let body = &candidate_bodies(&[seen.picture(Some(EYE))], &hints)[0];
    let mut heights: Vec<f64> = rooted(body).iter().map(|segment| segment.start_m[2]).collect();
    heights.sort_by(f64::total_cmp);
    assert_eq!(heights.len(), 2, "{heights:?}");
    assert!((heights[0] - 0.1).abs() < 0.01 && (heights[1] - 0.6).abs() < 0.01, "{heights:?}");
    // A root far from all wood is used, too.
    let hints = ObjectHints { roots_m: vec![[0.5, 0.0, 0.0].into()], ..ObjectHints::default() };
    let body = &candidate_bodies(&[seen.picture(Some(EYE))], &hints)[0];
    assert_eq!(body.segments()[0].start_m, [0.5, 0.0, 0.0]);
}

#[test]
fn a_table_gives_no_body_and_a_plant_on_it_only_with_a_given_kind() {
    let seen = plant();
    let kinds = |points: &[Point3<f64>], colours: &[[u8; 3]], kind| -> Vec<SegmentKind> {
        let picture = ObjectCloud { points, colours, viewpoint: Some(EYE) };
        let bodies = candidate_bodies(&[picture], &ObjectHints { kind, ..ObjectHints::default() });
        let first = bodies.first().map_or(&[][..], |body| body.segments());
        first.iter().map(|segment| segment.kind).collect()
    };
    assert!(kinds(&seen.points, &seen.colours, None).contains(&SegmentKind::Wood));
    assert!(
        !kinds(&seen.points, &seen.colours, Some(ObjectKind::Cushion)).contains(&SegmentKind::Wood)
    );
    let table = (0..40_000).map(|at| {
        Point3::new(0.003 * f64::from(at % 200), 0.003 * f64::from(at / 200) - 0.3, -0.05)
    });
    let table: Vec<Point3<f64>> = table.collect();
    let colours = vec![BROWN; table.len()];
    assert!(kinds(&table, &colours, None).is_empty());
    let points = [&seen.points[..], &table[..]].concat();
    let colours = [&seen.colours[..], &colours[..]].concat();
    assert!(!kinds(&points, &colours, None).contains(&SegmentKind::Wood));
    assert!(kinds(&points, &colours, Some(ObjectKind::Plant)).contains(&SegmentKind::Wood));
}

#[test]
fn a_cushion_is_blocks_whose_tops_are_where_its_surface_was_seen_in_two_materials() {
    // A hump of 40 cm by 30 cm, half of it blue.
    let height = |x: f64, y: f64| 0.2 + 0.05 * (x * 5.0).sin() - 0.3 * y * y;
    let (mut points, mut colours) = (Vec::new(), Vec::new());
    for at in 0..12_000 {
        let (x, y) = (0.004 * f64::from(at % 100), 0.0025 * f64::from(at / 100) - 0.15);
        points.push(Point3::new(x, y, height(x, y)));
        colours.push(if x < 0.2 { [40, 70, 180] } else { [220, 190, 90] });
    }
    // Its side, down to the ground.
    points.extend((0..200).map(|at| Point3::new(0.0, -0.15, 0.001 * f64::from(at))));
    colours.extend([[40, 70, 180]; 200]);
    let picture = ObjectCloud { points: &points, colours: &colours, viewpoint: None };
    let bodies = candidate_bodies(&[picture], &ObjectHints::default());
    assert_eq!(bodies.len(), 1);
    let body = &bodies[0];
    assert!(body.segments().len() > 60, "{} blocks", body.segments().len());
    assert_eq!(body.n_trees(), 2);
    for (block, tree) in body.segments().iter().zip(body.trees()) {
        assert_eq!(block.kind, SegmentKind::Block);
        let middle = block.start() + 0.5 * block.axis();
        let off = middle.z + block.radius_m - height(middle.x, middle.y);
        assert!(off.abs() < 0.004, "{off} m at {middle}");
        let steep = block.axis().z / block.axis().x - 0.25 * (middle.x * 5.0).cos();
        // Points of the seen side tilt the block at that corner a little.
        assert!(steep.abs() < 0.1, "{steep} at {middle}");
        if (middle.x - 0.2).abs() > 0.02 {
            assert_eq!(*tree == body.trees()[0], middle.x < 0.2, "{middle}");
        }
    }
}

#[test]
fn a_row_of_stems_stands_on_the_ground_each_by_itself() {
    let mut seen = Seen::default();
    for y in [-0.1, 0.0, 0.1] {
        seen.rod([0.5, y, 0.0], [0.5, y, 0.5], [0.01, 0.009], [0.5, 0.55]);
    }
    let body = seen.body(Some(EYE));
    assert_eq!(rooted(&body).len(), 3);
}

#[test]
fn the_camera_of_the_bundled_plant_is_found_in_its_cloud() {
    let cloud = concat!(env!("CARGO_MANIFEST_DIR"), "/../palpate-cli/data/plant_a/object.ply");
    let cloud = palpate_io::cloud::read(cloud.as_ref()).unwrap().cloud;
    let centre = cloud.points().iter().map(|point| point.coords).sum::<Vector3<f64>>();
    let centre = Point3::from(centre / cloud.len() as f64);
    let camera = Point3::new(-0.33, -0.58, 0.86); // data/plant_a/rgbd/camera.json
    let guess = guess_viewpoint(cloud.points());
    let apart = (guess - centre).angle(&(camera - centre)).to_degrees();
    assert!(apart < 5.0, "{guess} is off by {apart:.1} degrees");
}

#[test]
fn the_first_candidate_is_the_body_and_no_two_candidates_are_equal() {
    let seen = plant();
    let bodies = candidate_bodies(&[seen.picture(Some(EYE))], &ObjectHints::default());
    assert_eq!(bodies[0], seen.body(Some(EYE)));
    for (number, body) in bodies.iter().enumerate() {
        assert!(!bodies[..number].contains(body), "candidate {number}");
    }
}

#[test]
fn a_stem_is_wood_whatever_its_colour() {
    let mut seen = Seen::default();
    for y in [-0.1, 0.0, 0.1] {
        seen.rod([0.5, y, 0.0], [0.5, y, 0.5], [0.01, 0.009], [2.0, 3.0]);
    }
    for (point, colour) in seen.points.iter().zip(&mut seen.colours) {
        *colour = if point.y > 0.05 { BROWN } else { GREEN };
    }
    let body = seen.body(Some(EYE));
    assert_eq!(body.n_trees(), 3);
    assert_eq!(wood(&body).len(), body.segments().len(), "no leaves");
}

#[test]
fn a_crown_hangs_on_a_stem_of_which_leaves_hide_much() {
    let mut seen = Seen::default();
    seen.rod([0.5, 0.0, 0.0], [0.5, 0.0, 0.8], [0.012, 0.006], [0.1, 0.3]);
    let towards = (EYE - Point3::new(0.5, 0.0, 0.16)).normalize();
    let middle = Point3::new(0.5, 0.0, 0.16) + 0.04 * towards;
    let across = Vector3::z().cross(&towards).normalize();
    seen.leaf(middle.into(), 0.11 * across.cross(&towards), 0.05 * across);
    let body = seen.body(Some(EYE));
    let length: f64 = wood(&body).iter().map(|segment| segment.axis().norm()).sum();
    assert_eq!(body.n_trees(), 1);
    assert!((length - 0.8).abs() < 0.05, "{length} m of wood");
}
