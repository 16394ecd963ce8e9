//! Newton's equations of a tree of bodies on ball joints, solved in one pass from the leaves to the root and one back.
//!
//! This is the articulated-body algorithm (Featherstone) with stiffness instead of inertia: a segment with all that it
//! carries acts on its parent as a 6 × 6 stiffness, and the elimination of a joint causes no fill-in. Cost:
//! O(segments), some 0.3 µs each.
//!
//! The motion of a segment is a translation of its start and a rotation about it, both small, in the world frame. The
//! rotation is the sum of that of its parent and that of its own joint, `w`; the model of the energy is
//!
//! ```text
//! ½ Σ wᵢᵀ kᵢ wᵢ + gᵢᵀ wᵢ  +  Σ ½ vᵢᵀ Aᵢ vᵢ + bᵢᵀ vᵢ ,    vᵢ = (translation of the start, rotation)
//! ```
//!
//! A block slides and does not turn: `wᵢ` is then its translation, and it carries nothing. Springs between blocks enter
//! only the gradient and the diagonal, as if the neighbours were fixed; so a cushion takes more iterations than a tree.

use nalgebra::{Matrix3, Vector3};

/// The quadratic model of the energy at one segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Node {
    /// Index of the segment that carries it.
    pub parent: Option<usize>,
    /// From the start of the parent to the start of this one, m.
    pub arm_m: Vector3<f64>,
    /// Stiffness of the joint, N·m/rad.
    pub joint_stiffness: f64,
    /// Gradient of the joint's energy, N·m; for a block, N.
    pub joint_slope: Vector3<f64>,
    /// For a block only: stiffness by axis, N/m.
    pub slides: Option<Vector3<f64>>,
    /// A: translation by translation, N/m.
    pub tt: Matrix3<f64>,
    /// A: translation by rotation, N.
    pub tr: Matrix3<f64>,
    /// A: rotation by rotation, N·m.
    pub rr: Matrix3<f64>,
    /// b: by translation, N.
    pub slope_t: Vector3<f64>,
    /// b: by rotation, N·m.
    pub slope_r: Vector3<f64>,
}

impl Node {
    /// A joint whose segment has no forces.
    pub(super) fn free(parent: Option<usize>, arm_m: Vector3<f64>, joint_stiffness: f64) -> Self {
        Self {
            parent,
            arm_m,
            joint_stiffness,
            joint_slope: Vector3::zeros(),
            slides: None,
            tt: Matrix3::zeros(),
            tr: Matrix3::zeros(),
            rr: Matrix3::zeros(),
            slope_t: Vector3::zeros(),
            slope_r: Vector3::zeros(),
        }
    }

    /// Adds an energy that depends on the position of a point of the segment, by its gradient, N, and its curvature,
    /// N/m, in that position; `lever_m` is the vector from the start of the segment to the point.
    pub(super) fn add(
        &mut self,
        lever_m: &Vector3<f64>,
        slope: &Vector3<f64>,
        curvature: &Matrix3<f64>,
    ) {
        let across = lever_m.cross_matrix();
        let turned = curvature * across; // the point moves by rotation × lever = −across · rotation
        self.tt += curvature;
        self.tr -= turned;
        self.rr += across.transpose() * turned;
        self.slope_t += slope;
        self.slope_r += lever_m.cross(slope);
    }
}

/// The rotation of every joint that minimises the model, rad, or the translation of a block, m; and the Newton
/// decrement `−slope · step`, J.
///
/// Adds to each node the contributions of the segments that it carries. Parents come first.
pub(super) fn minimise(nodes: &mut [Node]) -> (Vec<Vector3<f64>>, f64) {
    let mut inverses = vec![Matrix3::zeros(); nodes.len()];
    for index in (0..nodes.len()).rev() {
        let node = nodes[index];
        if let Some(stiffness) = node.slides {
            let held = node.tt + Matrix3::from_diagonal(&stiffness);
            inverses[index] = held.try_inverse().unwrap_or_else(Matrix3::zeros);
            continue;
        }
        let k = node.joint_stiffness;
        let held = node.rr + Matrix3::from_diagonal_element(k);
        // Positive definite: k is positive, and curvatures are positive semidefinite.
        let inverse = held.try_inverse().unwrap_or_else(|| Matrix3::from_diagonal_element(1.0 / k));
        inverses[index] = inverse;
        let Some(parent) = node.parent else { continue };

        let by_joint = inverse * (node.joint_slope + node.slope_r);
        let tt = node.tt - node.tr * inverse * node.tr.transpose();
        let tr = node.tr * inverse * k;
        let rr = inverse * node.rr * k;
        let slope_t = node.slope_t - node.tr * by_joint;
        let slope_r = node.slope_r - node.rr * by_joint;

        let across = node.arm_m.cross_matrix();
        let shifted_tr = tr - tt * across;
        let shifted_rr = rr - tr.transpose() * across + across * shifted_tr;
        let above = &mut nodes[parent];
        above.tt += tt;
        above.tr += shifted_tr;
        above.rr += (shifted_rr + shifted_rr.transpose()) * 0.5;
        above.slope_t += slope_t;
        above.slope_r += slope_r + node.arm_m.cross(&slope_t);
    }

    let mut steps = Vec::with_capacity(nodes.len());
    let mut motions: Vec<(Vector3<f64>, Vector3<f64>)> = Vec::with_capacity(nodes.len());
    let mut decrement = 0.0;
    for (node, inverse) in nodes.iter().zip(&inverses) {
        if node.slides.is_some() {
            let pull = node.joint_slope + node.slope_t;
            let step = -(inverse * pull);
            decrement -= pull.dot(&step);
            motions.push((step, Vector3::zeros()));
            steps.push(step);
            continue;
        }
        let (shift, turn) = node.parent.map_or_else(
            || (Vector3::zeros(), Vector3::zeros()),
            |parent| {
                let (shift, turn): (Vector3<f64>, Vector3<f64>) = motions[parent];
                (shift + turn.cross(&node.arm_m), turn)
            },
        );
        let pull = node.joint_slope + node.slope_r;
        let step = -(inverse * (pull + node.tr.transpose() * shift + node.rr * turn));
        // The decrease of the energy by the elimination of this joint.
        decrement += pull.dot(&(inverse * pull));
        motions.push((shift, turn + step));
        steps.push(step);
    }
    (steps, decrement)
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector, Matrix6xX, Vector6};
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;

    fn number(rng: &mut ChaCha8Rng) -> f64 {
        f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0
    }

    fn vector(rng: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| number(rng))
    }

    fn a_tree(segments: usize) -> Vec<Node> {
        let mut rng = ChaCha8Rng::seed_from_u64(21);
        let mut nodes: Vec<Node> = Vec::new();
        for index in 0..segments {
            // Two roots, and forks of every kind.
            let parent = (index > 1).then(|| rng.next_u32() as usize % index);
            let arm = parent.map_or(Vector3::zeros(), |_| vector(&mut rng));
            let mut node = Node::free(parent, arm, 1.0 + number(&mut rng).abs());
            node.joint_slope = vector(&mut rng);
            for _ in 0..rng.next_u32() % 3 {
                let normal = vector(&mut rng);
                node.add(
                    &vector(&mut rng),
                    &vector(&mut rng),
                    &(5.0 * normal * normal.transpose()),
                );
            }
            nodes.push(node);
        }
        nodes
    }

    /// Jacobian of the motion of a segment with respect to the rotations of the joints.
    fn motion_by_turns(nodes: &[Node], mut at: usize) -> Matrix6xX<f64> {
        let mut motion = Matrix6xX::zeros(3 * nodes.len());
        let mut lever = Vector3::zeros();
        loop {
            let joint = 3 * at;
            let turned = Matrix3::identity();
            motion.fixed_view_mut::<3, 3>(0, joint).copy_from(&-lever.cross_matrix());
            motion.fixed_view_mut::<3, 3>(3, joint).copy_from(&turned);
            let Some(parent) = nodes[at].parent else { return motion };
            lever += nodes[at].arm_m;
            at = parent;
        }
    }

    #[test]
    fn the_turns_are_those_of_the_dense_equations() {
        let nodes = a_tree(12);
        let size = 3 * nodes.len();
        let (mut normal, mut slope) =
            (DMatrix::<f64>::zeros(size, size), DVector::<f64>::zeros(size));
        for (index, node) in nodes.iter().enumerate() {
            let motion = motion_by_turns(&nodes, index);
            let mut a = nalgebra::Matrix6::zeros();
            a.fixed_view_mut::<3, 3>(0, 0).copy_from(&node.tt);
            a.fixed_view_mut::<3, 3>(0, 3).copy_from(&node.tr);
            a.fixed_view_mut::<3, 3>(3, 0).copy_from(&node.tr.transpose());
            a.fixed_view_mut::<3, 3>(3, 3).copy_from(&node.rr);
            let (t, r) = (node.slope_t, node.slope_r);
            normal += motion.transpose() * a * &motion;
            slope += motion.transpose() * Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z);
            for axis in 0..3 {
                normal[(3 * index + axis, 3 * index + axis)] += node.joint_stiffness;
                slope[3 * index + axis] += node.joint_slope[axis];
            }
        }
        let dense = -normal.clone().cholesky().expect("positive definite").solve(&slope);

        let (turns, decrement) = minimise(&mut nodes.clone());

        for (index, turn) in turns.iter().enumerate() {
            let apart = (turn - dense.fixed_rows::<3>(3 * index)).norm();
            assert!(apart < 1e-9, "joint {index} is off by {apart}");
        }
        assert!((decrement + slope.dot(&dense)).abs() < 1e-9 * decrement);
    }
}
