//! From a coloured cloud to an elastic body: stems, branches and leaves of what a camera saw.
//!
//! | file       | does                                                                             |
//! |------------|----------------------------------------------------------------------------------|
//! | `blocks`   | a cushion: blocks under the seen surface                                          |
//! | `wood`     | parts wood from leaves by colour and shape                                        |
//! | `otsu`     | the threshold between two classes of numbers                                      |
//! | `skeleton` | level sets of the distance from the root; joins pieces across gaps                |
//! | `tubes`    | axis and radius of each branch: from the seen width, then by least squares         |
//! | `fit`      | the least squares of one branch                                                    |
//! | `radii`    | draws radii to the taper that branches of an order have in common                  |
//! | `leaves`   | flat patches, hung on the nearest wood                                            |
//! | `explained` | whether the body is what the cloud shows                                       |
//! | `view`     | where the camera stood, and through which space it looked                          |
//! | `graph`    | neighbours, connected pieces, distances along a surface                            |
//!
//! Only the side that faces the camera is seen. What is hidden, and wood of the colour of leaves, is
//! missed. If stems, branches and leaves leave much of the cloud unexplained, it shows a cushion.

mod blocks;
mod explained;
mod fit;
mod graph;
mod leaves;
mod otsu;
mod radii;
mod skeleton;
mod tubes;
mod view;
mod wood;

use std::collections::HashSet;

use nalgebra::{Point3, Vector3};
use palpate::unstable::{ElasticBody, Segment, SegmentKind};
use serde::Deserialize;

use self::explained::unexplained;
use self::skeleton::{Branch, Joining, SkeletonNode};
use self::tubes::{Tube, at_arc};
use self::view::View;
pub use self::view::guess_viewpoint;

/// Young's modulus of wood before a touch says otherwise, Pa.
pub const WOOD_MODULUS_PA: f64 = 4.8e8;
/// Length of a segment, m; twice as long in stems.
const SEGMENT_M: f64 = 0.03;
/// Larger clouds are thinned to one point in a cube of [`THINNED_M`].
const MOST_POINTS: usize = 60_000;
const THINNED_M: f64 = 0.0015;
/// Largest share of the points that may lie on no segment of a body.
const MOST_UNEXPLAINED: f64 = 0.4;

/// The elastic body of an object, the first of its [`readings`].
///
/// Returns `None` if no branch is found.
///
/// # Panics
///
/// If there is not one colour for each point.
pub fn from_cloud(
    points: &[Point3<f64>],
    colours: &[[u8; 3]],
    viewpoint: Option<Point3<f64>>,
) -> Option<ElasticBody> {
    Cloud::new(points, colours, viewpoint)?.body(&Joining::ALL[0])
}

/// The elastic bodies that a cloud of an object can be read as. They differ in what hangs together across
/// gaps: a branch that comes out of hidden space may hang from any of several others, and only touches
/// tell from which.
///
/// - `points`: world frame, m; `colours`: sRGB, one for each point;
/// - `viewpoint`: where the camera stood, m, world frame; if it is not known, a place from which no
///   point hides another.
///
/// Springs are those of round rods of [`WOOD_MODULUS_PA`]: `E π r⁴ / 4` over the length that a joint
/// stands for. The same cloud gives the same body. Cost: 0.1 s for 30,000 points, and a second
/// for the search of the camera.
///
/// No two of them are the same. If no branch is found, or stems, branches and leaves leave two fifths of the
/// points unexplained, the only one is a cushion of blocks; none if nothing stands above the lowest point.
/// If the `kind` of the object is given, only such bodies are made.
///
/// # Panics
///
/// If there is not one colour for each point.
pub fn readings(
    points: &[Point3<f64>],
    colours: &[[u8; 3]],
    viewpoint: Option<Point3<f64>>,
    kind: Option<ObjectKind>,
) -> Vec<ElasticBody> {
    let mut bodies = Vec::new();
    if kind != Some(ObjectKind::Cushion)
        && let Some(cloud) = Cloud::new(points, colours, viewpoint)
    {
        for body in Joining::ALL.iter().filter_map(|joining| cloud.body(joining)) {
            let explains =
                kind == Some(ObjectKind::Plant) || unexplained(&body, points) <= MOST_UNEXPLAINED;
            if explains && !bodies.contains(&body) {
                bodies.push(body);
            }
        }
    }
    if bodies.is_empty() && kind != Some(ObjectKind::Plant) {
        bodies.extend(ElasticBody::new(blocks::blocks(points, colours)));
    }
    bodies
}

/// What an object is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ObjectKind {
    /// Stems, branches and leaves.
    Plant,
    /// Anything else that gives way: a cushion, a bag, a dense bush.
    Cushion,
}

impl ObjectKind {
    /// The words for them.
    pub const WORDS: [&str; 2] = ["plant", "cushion"];
}

/// A cloud, parted.
struct Cloud {
    wood: Vec<Point3<f64>>,
    leaves: (Vec<Point3<f64>>, Vec<[u8; 3]>),
    view: View,
}

impl Cloud {
    fn new(
        points: &[Point3<f64>],
        colours: &[[u8; 3]],
        viewpoint: Option<Point3<f64>>,
    ) -> Option<Self> {
        assert_eq!(points.len(), colours.len(), "a colour for each point");
        let (points, colours) = thinned(points, colours);
        let is_wood = wood::is_wood(&points, &colours);
        let part = |wanted: bool| -> (Vec<Point3<f64>>, Vec<[u8; 3]>) {
            let of = points.iter().zip(&colours).zip(&is_wood).filter(|(_, wood)| **wood == wanted);
            of.map(|((point, colour), _)| (*point, *colour)).unzip()
        };
        let ((wood, _), leaves) = (part(true), part(false));
        if wood.is_empty() {
            return None;
        }
        let view = View::new(&points, viewpoint.unwrap_or_else(|| guess_viewpoint(&points)));
        Some(Self { wood, leaves, view })
    }

    /// The body that it is if its pieces hang together in a way.
    fn body(&self, joining: &Joining) -> Option<ElasticBody> {
        let nodes = skeleton::skeleton(&self.wood, &self.view, joining);
        let branches = skeleton::branches(&nodes);
        let mut tubes = tubes::tubes(&self.wood, &self.view, &nodes, &branches);
        radii::draw_together(&mut tubes, &carriers(&nodes, &branches));

        let mut segments = Vec::new();
        // The segment that carries each node.
        let mut carrying: Vec<Option<u32>> = vec![None; nodes.len()];
        for (number, (branch, tube)) in branches.iter().zip(&tubes).enumerate() {
            let parent = if branch.carried { carrying[branch.nodes[0]] } else { None };
            cut(tube, parent, number as u32, &mut segments, |node, segment| {
                carrying[branch.nodes[node]].get_or_insert(segment);
            });
        }
        let leaves = leaves::leaves(&self.leaves.0, &self.leaves.1, &segments, &self.view);
        segments.extend(leaves);
        ElasticBody::new(segments).ok()
    }
}

/// One point, the first, in each small cube of a large cloud.
fn thinned(points: &[Point3<f64>], colours: &[[u8; 3]]) -> (Vec<Point3<f64>>, Vec<[u8; 3]>) {
    let all = points.iter().copied().zip(colours.iter().copied());
    if points.len() <= MOST_POINTS {
        return all.unzip();
    }
    let mut taken = HashSet::new();
    let cube = |point: &Point3<f64>| point.coords.map(|along| (along / THINNED_M).floor() as i64);
    all.filter(|(point, _)| taken.insert(cube(point))).unzip()
}

/// The branch that carries each branch, if one does.
fn carriers(nodes: &[SkeletonNode], branches: &[Branch]) -> Vec<Option<usize>> {
    let mut branch_of = vec![usize::MAX; nodes.len()];
    for (number, branch) in branches.iter().enumerate() {
        branch.own().iter().for_each(|&node| branch_of[node] = number);
    }
    branches.iter().map(|branch| branch.carried.then(|| branch_of[branch.nodes[0]])).collect()
}

/// Cuts a tube into straight segments; `carries` is told which segment each node of the tube lies on.
fn cut(
    tube: &Tube,
    mut parent: Option<u32>,
    branch: u32,
    segments: &mut Vec<Segment>,
    mut carries: impl FnMut(usize, u32),
) {
    let mut tube = tube.clone();
    let ground = usize::from(!tube.carried);
    if ground == 1 {
        // It goes on into the ground below the lowest point that was seen.
        tube.axis.insert(0, tube.axis[0] - 0.02 * Vector3::z());
        tube.radii.insert(0, tube.radii[0]);
    }
    let arc = tube.arc_m();
    let length = arc[arc.len() - 1];
    if length < 0.004 {
        if let Some(parent) = parent {
            (0..tube.axis.len()).for_each(|node| carries(node, parent));
        }
        return;
    }
    let piece = if ground == 1 { 2.0 * SEGMENT_M } else { SEGMENT_M };
    let pieces = ((length / piece).round() as usize).max(1);
    let at = |piece: usize| length * piece as f64 / pieces as f64;
    let radius = |way: f64| {
        let after = arc.partition_point(|&arc| arc < way).clamp(1, arc.len() - 1);
        let share = (way - arc[after - 1]) / (arc[after] - arc[after - 1]).max(1e-12);
        tube.radii[after - 1] + (tube.radii[after] - tube.radii[after - 1]) * share.clamp(0.0, 1.0)
    };
    for number in 0..pieces {
        let (start_m, end_m) =
            (at_arc(&tube.axis, &arc, at(number)), at_arc(&tube.axis, &arc, at(number + 1)));
        let straight = (end_m - start_m).norm().max(1e-4);
        let joint_radius = radius(at(number));
        let inertia = std::f64::consts::FRAC_PI_4 * joint_radius.powi(4);
        // The first joint stands for the bending of half a segment, the others for that of a whole one.
        let bends = if number == 0 { 0.5 * straight } else { straight };
        segments.push(Segment {
            parent,
            kind: SegmentKind::Wood,
            start_m: start_m.into(),
            end_m: end_m.into(),
            bare_m: 0.0,
            radius_m: radius(0.5 * (at(number) + at(number + 1))),
            half_width_m: [0.0; 3],
            joint_stiffness: WOOD_MODULUS_PA * inertia / bends,
            branch,
        });
        let own = segments.len() as u32 - 1;
        parent = Some(own);
        let piece = at(number) - 1e-9..=at(number + 1) + 1e-9;
        for (node, way) in arc[ground..].iter().enumerate() {
            if piece.contains(way) {
                carries(node, own);
            }
        }
    }
}
