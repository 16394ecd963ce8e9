//! Elastic bodies from coloured clouds: stems, branches and leaves of a plant, or a cushion.
//!
//! | file        | does                                                                       |
//! |-------------|----------------------------------------------------------------------------|
//! | `blocks`    | a cushion: blocks under the seen surface                                   |
//! | `wood`      | separates wood from leaves by colour and shape                             |
//! | `otsu`      | the threshold between two classes of numbers                               |
//! | `skeleton`  | level sets of the distance from the root; joins pieces across gaps         |
//! | `tubes`     | axis and radius of each branch: from the seen width, then by least squares |
//! | `fit`       | the least squares of one branch                                            |
//! | `radii`     | regularises radii towards the common taper of branches of the same order   |
//! | `leaves`    | flat patches, attached to the nearest wood                                 |
//! | `explained` | the share of the cloud that a body does not explain                        |
//! | `view`      | viewpoints of the cameras, and the space that they saw to be free          |
//! | `graph`     | neighbours, connected components, distances along a surface                |
//!
//! Only surfaces that face a camera are seen; hidden parts, and wood with the colour of leaves, are
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
pub(crate) use self::skeleton::principal_axes;
use self::skeleton::{Branch, Joining, SkeletonNode};
use self::tubes::{Tube, at_arc};
pub use self::view::guess_viewpoint;
use self::view::{View, Views};

/// Young's modulus of wood before any touch, Pa.
pub const WOOD_MODULUS_PA: f64 = 4.8e8;
/// Length of a segment, m; twice as long in stems.
const SEGMENT_M: f64 = 0.03;
/// Larger clouds are thinned to one point in a cube of [`THINNED_M`].
const MAX_POINTS: usize = 60_000;
const THINNED_M: f64 = 0.0015;
/// A tube that starts nearer than this to its root is not extended to it, m.
const NO_LEAD_M: f64 = 0.005;
/// Largest share of unexplained points at which a cloud counts as a plant.
const MAX_UNEXPLAINED: f64 = 0.4;

/// The coloured points of one camera.
#[derive(Debug, Clone, Copy)]
pub struct ObjectCloud<'a> {
    /// Points, world frame, m.
    pub points: &'a [Point3<f64>],
    /// Colours, sRGB, one for each point.
    pub colours: &'a [[u8; 3]],
    /// Position of the camera, m, world frame; `None`: guessed by [`guess_viewpoint`].
    pub viewpoint: Option<Point3<f64>>,
}

/// What is known of an object besides its pictures.
#[derive(Debug, Clone, Default)]
pub struct ObjectHints {
    /// Kind of the object; `None`: found from the pictures.
    pub kind: Option<ObjectKind>,
    /// Root of each tree of a plant, m, world frame; if empty, trees start where they meet the ground.
    pub roots_m: Vec<Point3<f64>>,
}

impl ObjectHints {
    /// The kind of the object, if it is given; an object with roots is a plant.
    pub fn kind(&self) -> Option<ObjectKind> {
        self.kind.or((!self.roots_m.is_empty()).then_some(ObjectKind::Plant))
    }
}

/// The elastic bodies that an object may be according to its pictures, the most likely first. They differ in
/// how pieces are joined across gaps: a branch that comes out of hidden space may belong to any of several
/// others, and only touches show to which.
///
/// Joints have the bending stiffness of round rods of [`WOOD_MODULUS_PA`]: `E π r⁴ / 4` over the length that
/// a joint represents. The same pictures give the same bodies. Cost: 0.1 s for 30,000 points, and a second
/// to guess a viewpoint.
///
/// All bodies are different. If no branch is found, or stems, branches and leaves leave more than two fifths of
/// the points unexplained, the only body is a cushion of blocks; there is none if nothing is above the lowest
/// point. If the kind of the object is given, only bodies of this kind are made; an object with roots is a
/// plant.
///
/// # Panics
///
/// If a picture does not have one colour for each point.
pub fn candidate_bodies(pictures: &[ObjectCloud<'_>], hints: &ObjectHints) -> Vec<ElasticBody> {
    let all: Vec<SeenPoint> = seen_points(pictures);
    let points: Vec<Point3<f64>> = all.iter().map(|seen| seen.place).collect();
    let kind = hints.kind();
    let mut bodies = Vec::new();
    if kind != Some(ObjectKind::Cushion)
        && let Some(cloud) = Cloud::new(pictures, &all)
    {
        for body in Joining::ALL.iter().filter_map(|how| cloud.body(how, &hints.roots_m)) {
            let explains =
                kind == Some(ObjectKind::Plant) || unexplained(&body, &points) <= MAX_UNEXPLAINED;
            if explains && !bodies.contains(&body) {
                bodies.push(body);
            }
        }
    }
    if bodies.is_empty() && kind != Some(ObjectKind::Plant) {
        let colours: Vec<[u8; 3]> = all.iter().map(|seen| seen.colour).collect();
        bodies.extend(ElasticBody::new(blocks::blocks(&points, &colours)));
    }
    bodies
}

/// Kind of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ObjectKind {
    /// Stems, branches and leaves.
    Plant,
    /// Any other soft object: a cushion, a bag, a dense bush.
    Cushion,
}

impl ObjectKind {
    /// Names of the kinds in files and options.
    pub const WORDS: [&str; 2] = ["plant", "cushion"];
}

/// A point of a picture.
#[derive(Debug, Clone, Copy)]
struct SeenPoint {
    place: Point3<f64>,
    colour: [u8; 3],
    picture: usize,
}

fn seen_points(pictures: &[ObjectCloud<'_>]) -> Vec<SeenPoint> {
    let of_picture = |(number, picture): (usize, &ObjectCloud<'_>)| -> Vec<SeenPoint> {
        assert_eq!(picture.points.len(), picture.colours.len(), "a colour for each point");
        let points = picture.points.iter().zip(picture.colours);
        points.map(|(&place, &colour)| SeenPoint { place, colour, picture: number }).collect()
    };
    pictures.iter().enumerate().flat_map(of_picture).collect()
}

/// All points, separated into wood and leaves.
struct Cloud {
    wood: Vec<Point3<f64>>,
    leaves: (Vec<Point3<f64>>, Vec<[u8; 3]>),
    views: Views,
}

impl Cloud {
    fn new(pictures: &[ObjectCloud<'_>], all: &[SeenPoint]) -> Option<Self> {
        let kept = thinned(all);
        let (points, colours): (Vec<_>, Vec<_>) =
            kept.iter().map(|seen| (seen.place, seen.colour)).unzip();
        let is_wood = wood::is_wood(&points, &colours);
        let part = |wanted: bool| {
            let of = kept.iter().zip(&is_wood).filter(move |(_, wood)| **wood == wanted);
            of.map(|(seen, _)| *seen)
        };
        let (wood, of_wood): (Vec<_>, Vec<_>) =
            part(true).map(|seen| (seen.place, seen.picture)).unzip();
        if wood.is_empty() {
            return None;
        }
        let view = |(number, picture): (usize, &ObjectCloud<'_>)| {
            let own = kept.iter().filter(|seen| seen.picture == number).map(|seen| seen.place);
            let own: Vec<Point3<f64>> = own.collect();
            View::new(&own, picture.viewpoint.unwrap_or_else(|| guess_viewpoint(&own)))
        };
        let views = Views { all: pictures.iter().enumerate().map(view).collect(), of_wood };
        let leaves = part(false).map(|seen| (seen.place, seen.colour)).unzip();
        Some(Self { wood, leaves, views })
    }

    /// The body under these settings of joining; `None` if there is no branch.
    fn body(&self, joining: &Joining, roots_m: &[Point3<f64>]) -> Option<ElasticBody> {
        let nodes = skeleton::skeleton(&self.wood, &self.views, (joining, roots_m));
        let branches = skeleton::branches(&nodes);
        let mut tubes = tubes::tubes(&self.wood, &self.views, &nodes, &branches);
        radii::draw_together(&mut tubes, &carriers(&nodes, &branches));

        let mut segments = Vec::new();
        // The segment that carries each node.
        let mut carrying: Vec<Option<u32>> = vec![None; nodes.len()];
        for (number, (branch, tube)) in branches.iter().zip(&mut tubes).enumerate() {
            let parent = if branch.carried { carrying[branch.nodes[0]] } else { None };
            let ahead = usize::from(!tube.carried && lead_to_root(tube, roots_m));
            cut(tube, (parent, ahead), number as u32, &mut segments, |node, segment| {
                carrying[branch.nodes[node]].get_or_insert(segment);
            });
        }
        let leaves = leaves::leaves(&self.leaves.0, &self.leaves.1, &segments, &self.views);
        segments.extend(leaves);
        ElasticBody::new(segments).ok()
    }
}

/// The points; of large clouds, only the first point of each picture in each small cube.
fn thinned(all: &[SeenPoint]) -> Vec<SeenPoint> {
    if all.len() <= MAX_POINTS {
        return all.to_vec();
    }
    let mut taken = HashSet::new();
    let cube = |seen: &SeenPoint| seen.place.coords.map(|along| (along / THINNED_M).floor() as i64);
    all.iter().copied().filter(|seen| taken.insert((seen.picture, cube(seen)))).collect()
}

/// Extends the start of a tube to its nearest root or, without roots, 2 cm down. Returns whether it did: a tube that
/// starts at its root is not extended.
fn lead_to_root(tube: &mut Tube, roots_m: &[Point3<f64>]) -> bool {
    let first = tube.axis[0];
    let apart = |root: &Point3<f64>| (root - first).norm();
    let nearest = roots_m.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)));
    if nearest.is_some_and(|root| apart(root) < NO_LEAD_M) {
        return false;
    }
    tube.axis.insert(0, nearest.copied().unwrap_or(first - 0.02 * Vector3::z()));
    tube.radii.insert(0, tube.radii[0]);
    true
}

/// For each branch, the branch that carries it, if any.
fn carriers(nodes: &[SkeletonNode], branches: &[Branch]) -> Vec<Option<usize>> {
    let mut branch_of = vec![usize::MAX; nodes.len()];
    for (number, branch) in branches.iter().enumerate() {
        branch.own().iter().for_each(|&node| branch_of[node] = number);
    }
    branches.iter().map(|branch| branch.carried.then(|| branch_of[branch.nodes[0]])).collect()
}

/// Cuts a tube into straight segments; `carries` is called with each node of the tube and its segment. The first
/// `ahead` places of the tube are not nodes.
fn cut(
    tube: &Tube,
    (mut parent, ahead): (Option<u32>, usize),
    branch: u32,
    segments: &mut Vec<Segment>,
    mut carries: impl FnMut(usize, u32),
) {
    let arc = tube.arc_m();
    let length = arc[arc.len() - 1];
    if length < 0.004 {
        if let Some(parent) = parent {
            (0..tube.axis.len()).for_each(|node| carries(node, parent));
        }
        return;
    }
    let piece = if !tube.carried { 2.0 * SEGMENT_M } else { SEGMENT_M };
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
        // The first joint represents the bending of half a segment, the others that of a whole one.
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
        for (node, way) in arc[ahead..].iter().enumerate() {
            if piece.contains(way) {
                carries(node, own);
            }
        }
    }
}
