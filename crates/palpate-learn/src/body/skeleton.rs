//! The skeleton of the wood: level sets of the distance from the root, and bridges between separate pieces.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};

use super::graph::Graph;
use super::view::Views;

/// Settings of how points are joined to pieces, and pieces to trees.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joining {
    /// Points nearer than this are in the same piece, m.
    near_m: f64,
    /// Pieces of fewer points are left out.
    fewest_points: usize,
    /// Cost of a bridge per length if it is perpendicular to the direction of its piece; parallel to it, one less.
    across: f64,
}

impl Joining {
    /// The settings that are tried, those that are right most often first.
    pub(super) const ALL: [Self; 4] = [
        Self { near_m: 0.006, fewest_points: 4, across: 2.0 },
        Self { near_m: 0.008, fewest_points: 4, across: 2.0 },
        Self { near_m: 0.006, fewest_points: 10, across: 2.0 },
        Self { near_m: 0.006, fewest_points: 4, across: 1.3 },
    ];
}

/// Range of distances in a level set, m.
const LEVEL_M: f64 = 0.008;
/// Widest gap that is bridged, m.
const WIDEST_GAP_M: f64 = 0.12;
/// Widest gap as a share of the size of the piece, if that is larger: leaves may hide much of a stem.
const WIDEST_GAP_SHARE: f64 = 0.5;
/// Pieces whose lowest point is less than this above the ground may stand on it, m.
const GROUND_M: f64 = 0.03;
/// Least horizontal distance of such a piece from larger ones that stand on the ground, m.
const APART_M: f64 = 0.05;
/// Shorter branches that carry no other branch are left out, m.
const SHORTEST_M: f64 = 0.012;

/// A level set of a branch.
#[derive(Debug, Clone)]
pub(super) struct SkeletonNode {
    /// Mean of its points, m.
    pub place: Point3<f64>,
    /// The node that carries it.
    pub parent: Option<usize>,
    /// Indices of its points.
    pub members: Vec<u32>,
}

/// The nodes of wood points, parents first. Trees begin at the roots, or on the ground if no roots are given.
pub(super) fn skeleton(
    points: &[Point3<f64>],
    views: &Views,
    (joining, roots_m): (&Joining, &[Point3<f64>]),
) -> Vec<SkeletonNode> {
    let graph = Graph::new(points, joining.near_m, |_, _| true);
    let all: Vec<u32> = (0..points.len() as u32).collect();
    let mut pieces = graph.pieces(&all);
    pieces.retain(|piece| piece.len() >= joining.fewest_points);
    let lowest = |piece: &[u32]| {
        piece.iter().map(|&point| points[point as usize].z).fold(f64::INFINITY, f64::min)
    };
    let ground = pieces.iter().map(|piece| lowest(piece)).fold(f64::INFINITY, f64::min);
    let foot = |piece: &[u32]| -> Vec<u32> {
        let below = lowest(piece) + 0.004;
        piece.iter().copied().filter(|&point| points[point as usize].z < below).collect()
    };
    pieces.sort_by_key(|piece| std::cmp::Reverse(piece.len()));

    let mut builder = Builder { points, graph: &graph, nodes: Vec::new() };
    let (mut feet, mut hanging): (Vec<Point3<f64>>, Vec<Vec<u32>>) = (Vec::new(), Vec::new());
    let starts_of = rooted(points, &pieces, roots_m);
    for (&piece, starts) in &starts_of {
        builder.add(&pieces[piece], starts, None);
    }
    let left = pieces.into_iter().enumerate().filter(|(piece, _)| !starts_of.contains_key(piece));
    for (_, piece) in left {
        let starts = foot(&piece);
        let place = middle(points, &starts);
        let is_apart = |other: &Point3<f64>| (other.xy() - place.xy()).norm() > APART_M;
        let stands = roots_m.is_empty() && lowest(&piece) < ground + GROUND_M;
        if stands && feet.iter().all(is_apart) {
            feet.push(place);
            builder.add(&piece, &starts, None);
        } else {
            hanging.push(piece);
        }
    }
    join(&mut builder, &hanging, views, joining);
    prune(builder.nodes)
}

/// For each root, the nearest piece, with its points that are nearest to the root.
fn rooted(
    points: &[Point3<f64>],
    pieces: &[Vec<u32>],
    roots_m: &[Point3<f64>],
) -> BTreeMap<usize, Vec<u32>> {
    let mut starts_of: BTreeMap<usize, Vec<u32>> = BTreeMap::new();
    for root in roots_m {
        let apart = |&point: &u32| (points[point as usize] - root).norm();
        let nearest = |piece: &Vec<u32>| piece.iter().map(apart).fold(f64::INFINITY, f64::min);
        let by_piece = pieces.iter().map(nearest).enumerate();
        let Some((at, nearest_m)) = by_piece.min_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        let starts = starts_of.entry(at).or_default();
        let is_start = |point: &&u32| apart(point) < nearest_m + 0.004;
        starts.extend(pieces[at].iter().filter(is_start));
        starts.sort_unstable();
        starts.dedup();
    }
    starts_of
}

struct Builder<'a> {
    points: &'a [Point3<f64>],
    graph: &'a Graph,
    nodes: Vec<SkeletonNode>,
}

impl Builder<'_> {
    /// Adds the level sets of the distance from `starts` in a piece, as descendants of `parent`.
    fn add(&mut self, piece: &[u32], starts: &[u32], parent: Option<usize>) {
        let distances = self.graph.distances_m(starts);
        let level = |point: u32| (distances[point as usize] / LEVEL_M) as usize;
        let mut by_level: Vec<Vec<u32>> = Vec::new();
        for &point in piece.iter().filter(|&&point| distances[point as usize].is_finite()) {
            by_level.resize(by_level.len().max(level(point) + 1), Vec::new());
            by_level[level(point)].push(point);
        }
        let mut node_of = vec![usize::MAX; self.points.len()];
        for (number, points) in by_level.iter().enumerate() {
            for members in self.graph.pieces(points) {
                let parent = if number == 0 { parent } else { self.below(&members, &node_of) };
                let parent = parent.or_else(|| (number > 0).then(|| self.nearest(&members)));
                let place = middle(self.points, &members);
                members.iter().for_each(|&point| node_of[point as usize] = self.nodes.len());
                self.nodes.push(SkeletonNode { place, parent, members });
            }
        }
    }

    /// The earlier node to which most edges lead.
    fn below(&self, members: &[u32], node_of: &[usize]) -> Option<usize> {
        let edges = members.iter().flat_map(|&point| self.graph.neighbours(point as usize));
        let mut nodes: Vec<usize> = (edges.map(|(other, _)| node_of[*other as usize]))
            .filter(|&node| node != usize::MAX)
            .collect();
        nodes.sort_unstable();
        let runs = nodes.chunk_by(|a, b| a == b);
        runs.max_by_key(|run| run.len()).map(|run| run[0])
    }

    fn nearest(&self, members: &[u32]) -> usize {
        let place = middle(self.points, members);
        let by_distance = |a: &&SkeletonNode, b: &&SkeletonNode| {
            let distance = |node: &SkeletonNode| (node.place - place).norm_squared();
            distance(a).total_cmp(&distance(b))
        };
        let nearest = self.nodes.iter().enumerate().min_by(|a, b| by_distance(&a.1, &b.1));
        nearest.expect("level zero was added").0
    }
}

fn middle(points: &[Point3<f64>], members: &[u32]) -> Point3<f64> {
    let sum = members.iter().fold(Vector3::zeros(), |sum, &at| sum + points[at as usize].coords);
    Point3::from(sum / members.len() as f64)
}

/// The diagonal of the bounding box of points, m.
fn size_m(points: &[Point3<f64>], members: &[u32]) -> f64 {
    let places = || members.iter().map(|&at| points[at as usize].coords);
    let Some(first) = places().next() else { return 0.0 };
    let (low, high) =
        places().fold((first, first), |(low, high), at| (low.inf(&at), high.sup(&at)));
    (high - low).norm()
}

/// Middle and principal axes of points, the longest first, and their standard deviations along them, m.
pub(crate) fn principal_axes(
    points: impl Iterator<Item = Point3<f64>> + Clone,
) -> (Point3<f64>, [Vector3<f64>; 3], [f64; 3]) {
    let n = points.clone().count() as f64;
    let sum = points.clone().fold(Vector3::zeros(), |sum, point| sum + point.coords);
    let middle = Point3::from(sum / n);
    let spread = points.fold(Matrix3::zeros(), |sum, point| {
        let apart = point - middle;
        sum + apart * apart.transpose()
    }) / n;
    let eigen = SymmetricEigen::new(spread);
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let axes = order.map(|axis| eigen.eigenvectors.column(axis).into_owned());
    (middle, axes, order.map(|axis| eigen.eigenvalues[axis].max(0.0).sqrt()))
}

/// A bridge from a node of the tree to a point of a piece.
#[derive(Clone, Copy)]
struct Bridge {
    cost: f64,
    node: usize,
    point: u32,
}

/// Joins pieces to the trees, the cheapest bridge first (Prim). Bridges are cheap if they are short, in the direction
/// of the piece, and not through space that a camera saw to be free.
fn join(builder: &mut Builder<'_>, pieces: &[Vec<u32>], views: &Views, joining: &Joining) {
    let points = builder.points;
    let widest_m: Vec<f64> = (pieces.iter())
        .map(|piece| f64::max(WIDEST_GAP_M, WIDEST_GAP_SHARE * size_m(points, piece)))
        .collect();
    let axes: Vec<_> = pieces
        .iter()
        .map(|piece| principal_axes(piece.iter().map(|&at| points[at as usize])))
        .collect();
    let mut best: Vec<Option<Bridge>> = vec![None; pieces.len()];
    let mut left: Vec<usize> = (0..pieces.len()).collect();
    let mut looked = 0;
    loop {
        for &at in &left {
            let (_, [along, ..], [spread_m, ..]) = axes[at];
            for (node, candidate) in builder.nodes.iter().enumerate().skip(looked) {
                let nearest = pieces[at].iter().map(|&point| {
                    (point, (points[point as usize] - candidate.place).norm_squared())
                });
                let Some((point, squared)) = nearest.min_by(|a, b| a.1.total_cmp(&b.1)) else {
                    continue;
                };
                let length = squared.sqrt() + 1e-6;
                if length > widest_m[at] || best[at].is_some_and(|best| length + 0.004 >= best.cost)
                {
                    continue;
                }
                let place = points[point as usize];
                let free =
                    if length > 0.008 { views.seen_free(&candidate.place, &place) } else { 0.0 };
                let gap = place - candidate.place;
                let aligned = if spread_m > 0.008 { gap.dot(&along).abs() / length } else { 0.5 };
                let cost = length * (1.0 + 3.0 * free) * (joining.across - aligned) + 0.004;
                if best[at].is_none_or(|best| cost < best.cost) {
                    best[at] = Some(Bridge { cost, node, point });
                }
            }
        }
        looked = builder.nodes.len();
        let next = left.iter().copied().filter_map(|at| Some((at, best[at]?)));
        let Some((at, bridge)) = next.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost)) else { return };
        left.retain(|&other| other != at);
        if bridge.cost > 1.5 * widest_m[at] {
            continue;
        }
        let place = points[bridge.point as usize];
        let is_near = |point: &u32| (points[*point as usize] - place).norm() <= 0.004;
        let starts: Vec<u32> = pieces[at].iter().copied().filter(is_near).collect();
        builder.add(&pieces[at], &starts, Some(bridge.node));
    }
}

/// Leaves out carried branches shorter than [`SHORTEST_M`] that carry no other branch.
fn prune(mut nodes: Vec<SkeletonNode>) -> Vec<SkeletonNode> {
    for _ in 0..3 {
        let branches = branches(&nodes);
        let mut dropped = vec![false; nodes.len()];
        for branch in branches.iter().filter(|branch| branch.carried) {
            let length: f64 = branch
                .nodes
                .windows(2)
                .map(|w| (nodes[w[1]].place - nodes[w[0]].place).norm())
                .sum();
            let own = branch.own();
            let carries =
                branches.iter().any(|other| other.carried && own.contains(&other.nodes[0]));
            if length < SHORTEST_M && !carries {
                own.iter().for_each(|&node| dropped[node] = true);
            }
        }
        if !dropped.contains(&true) {
            break;
        }
        let mut number = vec![usize::MAX; nodes.len()];
        let mut kept = Vec::new();
        for (at, node) in nodes.into_iter().enumerate().filter(|(at, _)| !dropped[*at]) {
            number[at] = kept.len();
            let parent = node.parent.map(|parent| number[parent]);
            kept.push(SkeletonNode { parent, ..node });
        }
        nodes = kept;
    }
    nodes
}

/// A path through the skeleton from a root or a fork to a tip.
#[derive(Debug, Clone)]
pub(super) struct Branch {
    /// Its nodes; if it is carried, the first belongs to the branch that carries it.
    pub nodes: Vec<usize>,
    /// Whether another branch carries it; otherwise it begins at a root.
    pub carried: bool,
}

impl Branch {
    /// Its nodes without the first one of a carried branch.
    pub(super) fn own(&self) -> &[usize] {
        &self.nodes[usize::from(self.carried)..]
    }
}

/// Divides the skeleton into branches: at each fork, a branch continues along the longest path.
pub(super) fn branches(nodes: &[SkeletonNode]) -> Vec<Branch> {
    let mut children = vec![Vec::new(); nodes.len()];
    let mut reach = vec![0.0_f64; nodes.len()];
    for (at, node) in nodes.iter().enumerate().rev() {
        if let Some(parent) = node.parent {
            children[parent].push(at);
            let through = reach[at] + (node.place - nodes[parent].place).norm();
            reach[parent] = reach[parent].max(through);
        }
    }
    let roots = (0..nodes.len()).filter(|&at| nodes[at].parent.is_none());
    let mut open: Vec<(Option<usize>, usize)> = roots.map(|at| (None, at)).collect();
    open.reverse();
    let mut branches = Vec::new();
    while let Some((from, at)) = open.pop() {
        let mut way: Vec<usize> = from.into_iter().chain([at]).collect();
        let mut end = at;
        while !children[end].is_empty() {
            let length = |at: usize| reach[at] + (nodes[at].place - nodes[end].place).norm();
            let mut next = children[end].clone();
            next.sort_by(|&a, &b| length(b).total_cmp(&length(a)).then(a.cmp(&b)));
            open.extend(next[1..].iter().map(|&other| (Some(end), other)));
            end = next[0];
            way.push(end);
        }
        branches.push(Branch { nodes: way, carried: from.is_some() });
    }
    branches
}
