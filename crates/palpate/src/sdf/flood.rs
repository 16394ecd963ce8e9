//! Nodes of a grid that the outside can reach, and distances from the openings of a mesh.
//!
//! The flood goes from node to neighbouring node unless a triangle is between them; nodes that it
//! never reaches are sealed. The openings are where the sign changes although no triangle is near:
//! there the winding number defines the surface. Distances must include this surface: otherwise `φ`
//! would jump from `+r` to `−r` across the mouth of a tube of radius `r`.

use super::bake::NodeGrid;

/// Which nodes can be reached from the rim of the grid. `blocked(node, axis)`: whether the surface
/// is between a node and the next one along an axis.
pub(super) fn reached(lattice: &NodeGrid, blocked: impl Fn(usize, usize) -> bool) -> Vec<bool> {
    let mut reached = vec![false; lattice.len()];
    let mut waiting: Vec<usize> = (0..lattice.len()).filter(|&n| lattice.on_rim(n)).collect();
    waiting.iter().for_each(|&node| reached[node] = true);
    while let Some(node) = waiting.pop() {
        for axis in 0..3 {
            let (before, after) = lattice.neighbours(node, axis);
            let before = before.filter(|&before| !blocked(before, axis));
            let after = after.filter(|_| !blocked(node, axis));
            for next in before.into_iter().chain(after) {
                if !std::mem::replace(&mut reached[next], true) {
                    waiting.push(next);
                }
            }
        }
    }
    reached
}

/// Distance of every node from the openings, m, infinite if there are none.
///
/// An opening crosses the edge between two nodes of different sign whose distances from the surface
/// add up to more than the edge: no triangle can be there. The crossing is where the winding
/// number, linear along the edge, is one half. From there distances spread by the eikonal equation,
/// first order, fast sweeping. Their error is a few per cent, but the position of an opening is not
/// exact either.
pub(super) fn distance_to_openings(
    lattice: &NodeGrid,
    winding: &[f32],
    inside: &[bool],
    distance_m: &[f64],
) -> Option<Vec<f64>> {
    let h = lattice.spacing_m;
    // Nearest crossing along each axis, as a share of the edge.
    let mut crossings = vec![[f64::INFINITY; 3]; lattice.len()];
    let mut any = false;
    for node in 0..lattice.len() {
        for axis in [0, 1, 2] {
            let (_, Some(next)) = lattice.neighbours(node, axis) else { continue };
            let free = lattice.proves_free(distance_m[node], distance_m[next]);
            if inside[node] == inside[next] || !free {
                continue;
            }
            any = true;
            let (here, there) = (f64::from(winding[node]), f64::from(winding[next]));
            let at = (here - 0.5) / (here - there);
            let at = if at.is_finite() { at.clamp(0.01, 0.99) } else { 0.5 };
            for (end, at) in [(node, at), (next, 1.0 - at)] {
                let nearest = &mut crossings[end][axis];
                *nearest = nearest.min(at);
            }
        }
    }
    any.then(|| {
        // Three crossings at a, b, c along the axes span a plane at 1/√(a⁻² + b⁻² + c⁻²).
        let mut near: Vec<f64> = (crossings.iter())
            .map(|at| h / at.iter().map(|a| a.powi(-2)).sum::<f64>().sqrt())
            .collect();
        (0..2).for_each(|_| sweep(lattice, &mut near));
        near
    })
}

/// Spreads distances once in each of the eight directions.
fn sweep(lattice: &NodeGrid, distance_m: &mut [f64]) {
    for directions in 0..8 {
        let ordered = |axis: usize, step: usize| {
            if directions >> axis & 1 == 0 { step } else { lattice.shape[axis] - 1 - step }
        };
        for k in 0..lattice.shape[2] {
            for j in 0..lattice.shape[1] {
                for i in 0..lattice.shape[0] {
                    let node = lattice.index([ordered(0, i), ordered(1, j), ordered(2, k)]);
                    let nearest = std::array::from_fn(|axis| {
                        let (before, after) = lattice.neighbours(node, axis);
                        let at = |n: Option<usize>| n.map_or(f64::INFINITY, |n| distance_m[n]);
                        at(before).min(at(after))
                    });
                    let through = eikonal(nearest, lattice.spacing_m);
                    distance_m[node] = distance_m[node].min(through);
                }
            }
        }
    }
}

/// The distance at a node from those of its nearest neighbour along each axis: `|∇φ| = 1`.
fn eikonal(mut nearest: [f64; 3], h: f64) -> f64 {
    nearest.sort_by(f64::total_cmp);
    let [a, b, c] = nearest;
    let one = a + h;
    if one <= b {
        return one;
    }
    let two = (a + b + (2.0 * h * h - (a - b).powi(2)).sqrt()) / 2.0;
    if two <= c {
        return two;
    }
    let sum = a + b + c;
    let square = sum * sum - 3.0 * (a * a + b * b + c * c - h * h);
    (sum + square.max(0.0).sqrt()) / 3.0
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    /// Nodes in a cube of ten, those of the middle four walled in.
    fn walled(lattice: &NodeGrid, door: Option<usize>) -> impl Fn(usize, usize) -> bool {
        let in_middle = |node: usize| {
            let digits = [node % 10, node / 10 % 10, node / 100];
            digits.iter().all(|digit| (3..7).contains(digit))
        };
        let shape = lattice.shape;
        move |node, axis| {
            let next = node + shape[..axis].iter().product::<usize>();
            in_middle(node) != in_middle(next) && door != Some(node)
        }
    }

    #[test]
    fn the_flood_stops_at_closed_walls_and_passes_any_opening() {
        let lattice = NodeGrid { origin_m: Point3::origin(), spacing_m: 1.0, shape: [10, 10, 10] };
        let dry = |reached: Vec<bool>| reached.iter().filter(|reached| !**reached).count();
        assert_eq!(dry(reached(&lattice, walled(&lattice, None))), 4 * 4 * 4);
        assert_eq!(dry(reached(&lattice, walled(&lattice, Some(245)))), 0); // (5, 4, 2) upwards
    }

    #[test]
    fn distances_spread_from_a_flat_opening_as_the_distance_from_a_plane() {
        let lattice = NodeGrid { origin_m: Point3::origin(), spacing_m: 0.5, shape: [6, 6, 20] };
        let layer = |node: usize| (node / 36) as f64;
        let n = lattice.len();
        // The winding number is one half at layer 7.3; no triangle is anywhere near.
        let winding: Vec<f32> =
            (0..n).map(|node| (0.5 + 0.1 * (7.3 - layer(node))) as f32).collect();
        let inside: Vec<bool> = winding.iter().map(|&w| w >= 0.5).collect();
        let found = distance_to_openings(&lattice, &winding, &inside, &vec![9.0; n]).unwrap();
        for (node, distance_m) in found.iter().enumerate() {
            let plane = 0.5 * (layer(node) - 7.3).abs();
            assert!((distance_m - plane).abs() < 1e-5, "layer {}: {distance_m}", layer(node));
        }
    }
}
