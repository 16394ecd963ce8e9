//! From coloured clouds to an elastic body: stems, branches and leaves of what cameras saw.
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
//! | `view`     | where the cameras stood, and through which space they looked                       |
//! | `graph`    | neighbours, connected pieces, distances along a surface                            |
//!
//! Only what faces a camera is seen. What is hidden, and wood of the colour of leaves, is
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
pub use self::view::guess_viewpoint;
use self::view::{View, Views};

/// Young's modulus of wood before a touch says otherwise, Pa.
pub const WOOD_MODULUS_PA: f64 = 4.8e8;
/// Length of a segment, m; twice as long in stems.
const SEGMENT_M: f64 = 0.03;
/// Larger clouds are thinned to one point in a cube of [`THINNED_M`].
const MOST_POINTS: usize = 60_000;
const THINNED_M: f64 = 0.0015;
/// A tube that begins nearer than this to its root begins at it, m.
const NO_LEAD_M: f64 = 0.005;
/// Largest share of the points that may lie on no segment of a body.
const MOST_UNEXPLAINED: f64 = 0.4;

/// What one camera saw of an object.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'a> {
    /// World frame, m.
    pub points: &'a [Point3<f64>],
    /// sRGB, one for each point.
    pub colours: &'a [[u8; 3]],
    /// Where the camera stood, m, world frame; if it is not known, a place from which no point hides another.
    pub viewpoint: Option<Point3<f64>>,
}

/// What is known of an object besides its pictures.
#[derive(Debug, Clone, Default)]
pub struct ObjectHints {
    /// What it is; found from the pictures if left out.
    pub kind: Option<ObjectKind>,
    /// Where a plant is held, one for each tree, m, world frame; where it meets the ground if there is none.
    pub roots_m: Vec<Point3<f64>>,
}

impl ObjectHints {
    /// What the object is said to be: what has roots is a plant.
    pub fn kind(&self) -> Option<ObjectKind> {
        self.kind.or((!self.roots_m.is_empty()).then_some(ObjectKind::Plant))
    }
}

/// The elastic bodies that pictures of an object can be read as. They differ in what hangs together across
/// gaps: a branch that comes out of hidden space may hang from any of several others, and only touches
/// show from which.
///
/// Springs are those of round rods of [`WOOD_MODULUS_PA`]: `E π r⁴ / 4` over the length that a joint
/// stands for. The same pictures give the same bodies. Cost: 0.1 s for 30,000 points, and a second
/// for the search of a camera.
///
/// No two of them are the same. If no branch is found, or stems, branches and leaves leave two fifths of the
/// points unexplained, the only one is a cushion of blocks; none if nothing stands above the lowest point.
/// If the kind of the object is given, only such bodies are made; what has roots is a plant.
///
/// # Panics
///
/// If a picture has not one colour for each point.
pub fn readings(pictures: &[Picture<'_>], hints: &ObjectHints) -> Vec<ElasticBody> {
    let all: Vec<SeenPoint> = seen_points(pictures);
    let points: Vec<Point3<f64>> = all.iter().map(|seen| seen.place).collect();
    let kind = hints.kind();
    let mut bodies = Vec::new();
    if kind != Some(ObjectKind::Cushion)
        && let Some(cloud) = Cloud::new(pictures, &all)
    {
        for body in Joining::ALL.iter().filter_map(|how| cloud.body(how, &hints.roots_m)) {
            let explains =
                kind == Some(ObjectKind::Plant) || unexplained(&body, &points) <= MOST_UNEXPLAINED;
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

/// A point of a picture.
#[derive(Debug, Clone, Copy)]
struct SeenPoint {
    place: Point3<f64>,
    colour: [u8; 3],
    picture: usize,
}

fn seen_points(pictures: &[Picture<'_>]) -> Vec<SeenPoint> {
    let of_picture = |(number, picture): (usize, &Picture<'_>)| -> Vec<SeenPoint> {
        assert_eq!(picture.points.len(), picture.colours.len(), "a colour for each point");
        let points = picture.points.iter().zip(picture.colours);
        points.map(|(&place, &colour)| SeenPoint { place, colour, picture: number }).collect()
    };
    pictures.iter().enumerate().flat_map(of_picture).collect()
}

/// All points, parted.
struct Cloud {
    wood: Vec<Point3<f64>>,
    leaves: (Vec<Point3<f64>>, Vec<[u8; 3]>),
    views: Views,
}

impl Cloud {
    fn new(pictures: &[Picture<'_>], all: &[SeenPoint]) -> Option<Self> {
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
        let view = |(number, picture): (usize, &Picture<'_>)| {
            let own = kept.iter().filter(|seen| seen.picture == number).map(|seen| seen.place);
            let own: Vec<Point3<f64>> = own.collect();
            View::new(&own, picture.viewpoint.unwrap_or_else(|| guess_viewpoint(&own)))
        };
        let views = Views { all: pictures.iter().enumerate().map(view).collect(), of_wood };
        let leaves = part(false).map(|seen| (seen.place, seen.colour)).unzip();
        Some(Self { wood, leaves, views })
    }

    /// The body that it is if its pieces hang together in a way.
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

/// One point of each picture, the first, in each small cube of large clouds.
fn thinned(all: &[SeenPoint]) -> Vec<SeenPoint> {
    if all.len() <= MOST_POINTS {
        return all.to_vec();
    }
    let mut taken = HashSet::new();
    let cube = |seen: &SeenPoint| seen.place.coords.map(|along| (along / THINNED_M).floor() as i64);
    all.iter().copied().filter(|seen| taken.insert((seen.picture, cube(seen)))).collect()
}

/// Puts a place before the first of a tube that stands by itself: its root, or one in the ground below the
/// lowest point that was seen. Returns whether it did: a tube may begin at its root.
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

/// The branch that carries each branch, if one does.
fn carriers(nodes: &[SkeletonNode], branches: &[Branch]) -> Vec<Option<usize>> {
    let mut branch_of = vec![usize::MAX; nodes.len()];
    for (number, branch) in branches.iter().enumerate() {
        branch.own().iter().for_each(|&node| branch_of[node] = number);
    }
    branches.iter().map(|branch| branch.carried.then(|| branch_of[branch.nodes[0]])).collect()
}

/// Cuts a tube into straight segments; `carries` is called with the segment that each node of the tube lies on. So many
/// places `ahead` of its nodes are none.
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
        for (node, way) in arc[ahead..].iter().enumerate() {
            if piece.contains(way) {
                carries(node, own);
            }
        }
    }
}
