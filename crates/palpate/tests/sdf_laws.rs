//! Laws of baked distances: of primitives, of meshes sound and broken, of cached bytes.
#![allow(clippy::unwrap_used)] // these are tests, though clippy does not see it in helpers

mod scene;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3, point, vector};
use palpate::BakeConfig;
use palpate::unstable::{
    BakeReport, Collision, DistanceGrid, SdfError, Shape, Solid, TriangleMesh, bake,
    signed_distance,
};
use proptest::prelude::*;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use scene::uniform;

const CONFIG: BakeConfig = BakeConfig::new(0.005, 0.03);

fn points(seed: u64, n: usize, half: f64) -> Vec<Point3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| Point3::from(Vector3::from_fn(|_, _| uniform(&mut rng, -half, half)))).collect()
}

fn part(shape: Shape) -> Collision {
    let rotation = UnitQuaternion::from_euler_angles(0.3, -0.4, 0.5);
    let link_from_shape = Isometry3::from_parts(Translation3::new(0.01, 0.02, -0.01), rotation);
    Collision { link_from_shape, shape }
}

fn four_shapes() -> [Shape; 4] {
    [
        Shape::Box { size_m: vector![0.08, 0.1, 0.12] },
        Shape::Cylinder { radius_m: 0.04, length_m: 0.1 },
        Shape::Sphere { radius_m: 0.05 },
        Shape::Capsule { radius_m: 0.03, length_m: 0.08 },
    ]
}

fn of_primitive(part: &Collision) -> DistanceGrid {
    baked(part, &CONFIG)
}

fn baked(part: &Collision, config: &BakeConfig) -> DistanceGrid {
    bake(&Solid { primitives: vec![part.clone()], meshes: vec![] }, config).unwrap().0
}

fn exact(part: &Collision, point: &Point3<f64>) -> f64 {
    signed_distance(&part.shape, &part.link_from_shape.inverse_transform_point(point)).unwrap()
}

/// A cuboid of two triangles a face, normals outwards, moved.
fn cuboid(half_m: f64, middle: Vector3<f64>) -> TriangleMesh {
    let corner = |i: usize| {
        let sign = |bit: usize| if i >> bit & 1 == 1 { half_m } else { -half_m };
        Point3::from(middle + vector![sign(0), sign(1), sign(2)])
    };
    let faces: [[u32; 4]; 6] =
        [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    TriangleMesh {
        vertices: (0..8).map(corner).collect(),
        triangles: faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
    }
}

fn turned_round(mut mesh: TriangleMesh) -> TriangleMesh {
    mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(0, 1));
    mesh
}

fn of_meshes(meshes: Vec<TriangleMesh>) -> (DistanceGrid, BakeReport) {
    bake(&Solid { primitives: vec![], meshes }, &CONFIG).unwrap()
}

/// A cube of 8 cm about the origin as a primitive.
fn cube() -> Collision {
    let shape = Shape::Box { size_m: Vector3::repeat(0.08) };
    Collision { link_from_shape: Isometry3::identity(), shape }
}

fn assert_same(one: &DistanceGrid, other: &DistanceGrid, tolerance_m: f64) {
    for point in points(9, 4_000, 0.06) {
        let (a, b) = (one.distance(&point), other.distance(&point));
        assert!((a - b).abs() <= tolerance_m, "{point}: {a} and {b}");
    }
}

#[test]
fn primitives_agree_with_parry() {
    use parry3d_f64::math::Vector;
    use parry3d_f64::query::PointQuery;
    use parry3d_f64::shape::{Ball, Capsule, Cuboid, Cylinder};
    // parry's axes of revolution are y.
    let half = Vector::new(0.04, 0.05, 0.06);
    for p in points(1, 2_000, 0.15) {
        let (plain, along_y) = (Vector::new(p.x, p.y, p.z), Vector::new(p.x, p.z, p.y));
        let [block, cylinder, ball, capsule] =
            four_shapes().map(|shape| signed_distance(&shape, &p).unwrap());
        let far = [
            block - Cuboid::new(half).distance_to_local_point(plain, false),
            ball - Ball::new(0.05).distance_to_local_point(plain, false),
            cylinder - Cylinder::new(0.05, 0.04).distance_to_local_point(along_y, false),
            capsule - Capsule::new_y(0.04, 0.03).distance_to_local_point(along_y, false),
        ];
        // parry's distances are negative inside when it is not solid.
        assert!(far.iter().all(|far| far.abs() < 1e-9), "{p}: {far:?}");
    }
}

#[test]
fn a_grid_holds_the_distance_to_a_tenth_of_a_cell_where_it_is_smooth() {
    for shape in four_shapes() {
        let part = part(shape);
        let grid = of_primitive(&part);
        let (mut worst, mut sum, mut n) = (0.0_f64, 0.0, 0.0);
        for point in points(2, 5_000, 0.1) {
            let exact = exact(&part, &point);
            if exact.abs() > CONFIG.margin_m {
                continue;
            }
            let error = (grid.distance(&point) - exact).abs();
            worst = worst.max(error);
            sum += error;
            n += 1.0;
        }
        // The worst are at edges and medial axes, where the distance has a kink.
        assert!(sum / n < 0.1 * CONFIG.spacing_m, "{part:?}: mean {}", sum / n);
        assert!(worst < 0.9 * CONFIG.spacing_m, "{part:?}: worst {worst}");
    }
}

#[test]
fn the_normal_is_the_slope_of_the_distance() {
    let step = 1e-6;
    for shape in four_shapes() {
        let grid = of_primitive(&part(shape));
        for point in points(3, 2_000, 0.2) {
            let (distance, normal) = grid.distance_and_normal(&point);
            assert_eq!(distance, grid.distance(&point));
            assert!((normal.norm() - 1.0).abs() < 1e-9, "{point}: {normal}");

            let at = |by: f64, axis: usize| grid.distance(&(point + Vector3::ith(axis, by)));
            let slope =
                Vector3::from_fn(|axis, _| (at(step, axis) - at(-step, axis)) / (2.0 * step));
            // f32 nodes limit the difference quotient; near cell faces it straddles two slopes.
            let straddles = (0..3).any(|axis| {
                let ahead = (at(step, axis) - distance) / step;
                let behind = (distance - at(-step, axis)) / step;
                (ahead - behind).abs() > 0.02
            });
            if !straddles && slope.norm() > 0.3 {
                let error = (slope.normalize() - normal).norm();
                assert!(error < 0.05, "{point}: {slope} {normal}");
            }
        }
    }
}

#[test]
fn the_normal_is_a_unit_vector_where_the_slope_vanishes() {
    let ball = Collision {
        link_from_shape: Isometry3::identity(),
        shape: Shape::Sphere { radius_m: 0.05 },
    };
    let grid = of_primitive(&ball);
    for point in [Point3::origin(), point![1e-12, 0.0, 0.0], point![1e6, -1e6, 1e6]] {
        let (_, normal) = grid.distance_and_normal(&point);
        assert!((normal.norm() - 1.0).abs() < 1e-9, "{point}: {normal}");
    }
}

#[test]
fn beyond_the_grid_the_distance_is_continuous_and_a_lower_bound() {
    for shape in four_shapes() {
        let part = part(shape);
        let grid = of_primitive(&part);
        for point in points(4, 3_000, 0.5) {
            let (found, exact) = (grid.distance(&point), exact(&part, &point));
            assert!(found <= exact + 0.2 * CONFIG.spacing_m, "{point}: {found} above {exact}");
            if exact > 2.0 * CONFIG.margin_m {
                assert!(found >= CONFIG.margin_m, "{point}: {found}");
            }
            let beside = grid.distance(&(point + vector![1e-4, -1e-4, 1e-4]));
            assert!((found - beside).abs() < 3e-4, "{point}: jumps from {found} to {beside}");
        }
    }
}

#[test]
fn every_point_with_a_negative_distance_is_within_the_bounds() {
    for shape in four_shapes() {
        let grid = of_primitive(&part(shape));
        let (low, high) = grid.bounds();
        let mut inside = 0;
        for point in points(5, 20_000, 0.12) {
            let within = (0..3).all(|i| low[i] <= point[i] && point[i] <= high[i]);
            inside += usize::from(grid.distance(&point) <= 0.0);
            assert!(within || grid.distance(&point) > 0.0, "{point}");
        }
        assert!(inside > 100);
    }
}

#[test]
fn a_closed_mesh_bakes_as_the_primitive_that_it_is() {
    let (grid, report) = of_meshes(vec![cuboid(0.04, Vector3::zeros())]);
    assert_same(&grid, &of_primitive(&cube()), 1e-6);
    assert_eq!((report.leaked_fraction, report.sealed_fraction), (0.0, 0.0));
    assert!((report.inside_m3 / 0.08_f64.powi(3) - 1.0).abs() < 0.05, "{report:?}");
}

#[test]
fn a_mesh_that_faces_inwards_bakes_as_if_it_faced_outwards() {
    let (grid, report) = of_meshes(vec![turned_round(cuboid(0.04, Vector3::zeros()))]);
    assert_eq!(report.flipped, 12);
    assert_same(&grid, &of_primitive(&cube()), 1e-6);

    let mut one_lid = cuboid(0.04, Vector3::zeros());
    one_lid.triangles[10..].iter_mut().for_each(|triangle| triangle.swap(0, 1));
    let (grid, report) = of_meshes(vec![one_lid]);
    assert_eq!(report.flipped, 2);
    assert_same(&grid, &of_primitive(&cube()), 1e-6);
}

#[test]
fn a_mirrored_mesh_still_faces_outwards() {
    let mirrored = cuboid(40.0, Vector3::zeros())
        .into_link(&Isometry3::identity(), &vector![-1e-3, 1e-3, 1e-3]);
    let (grid, report) = of_meshes(vec![mirrored]);
    assert_eq!(report.flipped, 0);
    assert_same(&grid, &of_primitive(&cube()), 1e-6);
}

#[test]
fn a_cube_without_a_face_is_closed_without_a_jump_and_the_report_says_so() {
    let mut open = cuboid(0.04, Vector3::zeros());
    open.triangles.truncate(10); // without +z
    let (grid, report) = of_meshes(vec![open]);
    assert!(report.leaked_fraction > 0.9, "{report:?}");
    assert!((report.inside_m3 / 0.08_f64.powi(3) - 1.0).abs() < 0.12, "{report:?}");

    let far_from_mouth = |p: &Point3<f64>| p.z < -0.01;
    let whole = of_primitive(&cube());
    for point in points(6, 4_000, 0.06) {
        let distance = grid.distance(&point);
        if far_from_mouth(&point) {
            assert!((distance - whole.distance(&point)).abs() < 1e-3, "{point}: {distance}");
        }
        let beside = grid.distance(&(point + vector![0.0, 0.0, 0.001]));
        assert!((distance - beside).abs() < 0.0015, "{point}: jumps from {distance} to {beside}");
    }
    assert!(grid.distance(&point![0.0, 0.0, 0.01]) < -0.02);
    assert!(grid.distance(&point![0.0, 0.0, 0.07]) > 0.01);
}

#[test]
fn inner_walls_do_not_bring_the_surface_nearer() {
    let hollow = vec![cuboid(0.04, Vector3::zeros()), turned_round(cuboid(0.03, Vector3::zeros()))];
    let (grid, _) = of_meshes(hollow);
    assert_same(&grid, &of_primitive(&cube()), 1e-6);

    let mut partition = cuboid(0.04, Vector3::zeros());
    let sheet = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    let first = partition.vertices.len() as u32;
    partition.vertices.extend(sheet.map(|[x, y]| point![0.035 * x, 0.035 * y, 0.003]));
    partition.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    let (grid, _) = of_meshes(vec![partition]);
    assert_same(&grid, &of_primitive(&cube()), 1e-3);
}

#[test]
fn overlapping_parts_bake_as_their_union() {
    let (one, other) = (vector![-0.02, 0.0, 0.0], vector![0.02, 0.0, 0.0]);
    let (grid, report) = of_meshes(vec![cuboid(0.03, one), turned_round(cuboid(0.03, other))]);
    assert_eq!(report.flipped, 12);
    let block = Shape::Box { size_m: vector![0.1, 0.06, 0.06] };
    let union = Collision { link_from_shape: Isometry3::identity(), shape: block };
    // The skin is cut where the parts meet to within two cells.
    assert_same(&grid, &of_primitive(&union), 1.5 * CONFIG.spacing_m);
    assert!(grid.distance(&Point3::origin()) < -0.025, "no surface in the middle");
}

#[test]
fn baking_in_parallel_is_baking_serially() {
    let mut open = cuboid(0.04, vector![0.01, 0.0, 0.0]);
    open.triangles.truncate(9);
    let solid = Solid { primitives: vec![part(four_shapes()[3].clone())], meshes: vec![open] };
    let on = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let [(serial, serial_report), (parallel, report)] =
        [1, 2].map(|threads| on(threads).install(|| bake(&solid, &CONFIG)).unwrap());
    assert_eq!(parallel.to_bytes(), serial.to_bytes());
    assert_eq!(report, serial_report);
}

#[test]
fn shapes_that_cannot_be_baked_are_refused() {
    let refused = |mesh: TriangleMesh, config: &BakeConfig| {
        bake(&Solid { primitives: vec![], meshes: vec![mesh] }, config).unwrap_err()
    };
    let good = || cuboid(0.04, Vector3::zeros());
    let changed = |change: fn(&mut TriangleMesh)| {
        let mut mesh = good();
        change(&mut mesh);
        refused(mesh, &CONFIG)
    };
    assert_eq!(changed(|mesh| mesh.triangles.clear()), SdfError::Empty { triangles: 0 });
    let flat = changed(|mesh| mesh.triangles = vec![[0, 1, 1], [2, 2, 2]]);
    assert_eq!(flat, SdfError::Empty { triangles: 2 });
    let beyond = changed(|mesh| mesh.triangles[3][1] = 8);
    assert_eq!(beyond, SdfError::Vertex { triangle: 3, vertex: 8, vertices: 8 });
    assert!(matches!(changed(|mesh| mesh.vertices[2].y = f64::NAN), SdfError::Number { .. }));

    let millimetres = refused(cuboid(40.0, Vector3::zeros()), &CONFIG);
    assert!(matches!(millimetres, SdfError::TooLarge { .. }));
    assert!(millimetres.to_string().contains("scale of 0.001"), "{millimetres}");
    assert!(matches!(refused(cuboid(1e8, Vector3::zeros()), &CONFIG), SdfError::TooLarge { .. }));
    assert!(matches!(refused(cuboid(1e300, Vector3::zeros()), &CONFIG), SdfError::Number { .. }));

    for (spacing_m, margin_m) in [(0.0, 0.03), (-0.1, 0.03), (f64::NAN, 0.03), (0.005, 0.0)] {
        let error = refused(good(), &BakeConfig::new(spacing_m, margin_m));
        assert!(matches!(error, SdfError::Number { .. }), "{error}");
    }
    let nothing = bake(&Solid::default(), &CONFIG).unwrap_err();
    assert_eq!(nothing, SdfError::Empty { triangles: 0 });
}

#[test]
fn triangles_without_area_are_left_out_and_counted() {
    let mut mesh = cuboid(0.04, Vector3::zeros());
    mesh.triangles.extend([[0, 0, 3], [5, 5, 5]]);
    let (grid, report) = of_meshes(vec![mesh]);
    assert_eq!((report.triangles, report.degenerate), (12, 2));
    assert_same(&grid, &of_primitive(&cube()), 1e-6);
}

fn small_grid() -> DistanceGrid {
    baked(&cube(), &BakeConfig::new(0.02, 0.02))
}

#[test]
fn bytes_give_back_the_grid() {
    let grid = small_grid();
    assert_eq!(DistanceGrid::from_bytes(&grid.to_bytes()).unwrap(), grid);
}

#[test]
fn bytes_that_are_cut_or_lengthened_are_refused() {
    let bytes = small_grid().to_bytes();
    for length in 0..bytes.len() {
        assert!(DistanceGrid::from_bytes(&bytes[..length]).is_err(), "{length}");
    }
    assert!(DistanceGrid::from_bytes(&[bytes, vec![0]].concat()).is_err());
}

proptest! {
    #[test]
    fn bytes_with_a_flipped_bit_are_refused(at in any::<prop::sample::Index>(), bit in 0..8_u32) {
        let mut bytes = small_grid().to_bytes();
        let at = at.index(bytes.len());
        bytes[at] ^= 1_u8 << bit;
        prop_assert!(DistanceGrid::from_bytes(&bytes).is_err());
    }

    #[test]
    fn no_sequence_of_bytes_makes_the_reader_panic(mut bytes in prop::collection::vec(any::<u8>(), 0..400), magic in any::<bool>()) {
        if magic {
            let head = small_grid().to_bytes();
            let n = bytes.len().min(24);
            bytes[..n].copy_from_slice(&head[..n]);
        }
        prop_assert!(DistanceGrid::from_bytes(&bytes).is_err());
    }
}

#[test]
fn surface_points_lie_on_the_surface_and_all_over_it() {
    for shape in four_shapes() {
        let part = part(shape);
        let grid = of_primitive(&part);
        let surface = grid.surface_points();
        let off = surface.iter().map(|point| exact(&part, point).abs()).fold(0.0, f64::max);
        assert!(off < 0.5 * CONFIG.spacing_m, "{off} m off {part:?}");
        for point in points(20, 500, 0.08) {
            let (distance, normal) = grid.distance_and_normal(&point);
            let foot = point - distance * normal;
            if exact(&part, &foot).abs() < 0.1 * CONFIG.spacing_m {
                let gap = surface.iter().map(|p| nalgebra::distance(p, &foot));
                let gap = gap.fold(f64::INFINITY, f64::min);
                assert!(gap < 1.5 * CONFIG.spacing_m, "none within {gap} m of {foot} on {part:?}");
            }
        }
    }
}

#[test]
fn the_smooth_slope_is_the_derivative_of_the_smooth_distance_and_near_the_true_one() {
    let shape = Shape::Sphere { radius_m: 0.05 };
    let sphere = Collision { shape, link_from_shape: Isometry3::identity() };
    let grid = baked(&sphere, &BakeConfig::new(0.004, 0.04));
    for step in 0..200 {
        let angle = f64::from(step);
        let direction = nalgebra::vector![angle.sin(), (1.3 * angle).cos(), (0.7 * angle).sin()];
        let distance = -0.02 + 0.045 * f64::from(step) / 200.0;
        let point = nalgebra::Point3::from(direction.normalize() * (0.05 + distance));
        let (smooth, slope) = grid.smooth_distance_and_slope(&point);
        assert!((smooth - distance).abs() < 3e-4, "{smooth} m, wanted {distance}");
        for axis in 0..3 {
            let nudge = nalgebra::Vector3::ith(axis, 1e-6);
            let ahead = grid.smooth_distance_and_slope(&(point + nudge)).0;
            let behind = grid.smooth_distance_and_slope(&(point - nudge)).0;
            let wanted = (ahead - behind) / 2e-6;
            assert!((slope[axis] - wanted).abs() < 1e-5, "{} and {wanted}", slope[axis]);
        }
    }
}
