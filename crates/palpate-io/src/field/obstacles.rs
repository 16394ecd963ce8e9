//! Exports a field as obstacles for other programs: rigid boxes, or balls on springs.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use palpate::{CellId, Lattice};

use super::file::FieldFile;

/// Ratio of damping to stiffness of a spring, s.
const RELAXATION_S: f64 = 0.05;
/// Density of the balls, kg/m³; it only affects the dynamics, as their weight is compensated.
const DENSITY_KG_PER_M3: f64 = 100.0;

/// An axis-aligned box in the world frame: its lower and its upper corner, m.
pub type Corners = [[f64; 3]; 2];

/// Disjoint boxes that together cover exactly the cells of a field.
///
/// Each box starts at the first cell that is not covered yet, and grows along x, then y, then z as long as all new
/// cells belong to the field and are not covered.
///
/// # Errors
///
/// The end of a message, if the field has no lattice.
pub fn boxes(field: &FieldFile) -> Result<Vec<Corners>, String> {
    let (lattice, places) = places(field)?;
    // By z, then y, then x: the order in which boxes grow.
    let mut left: BTreeSet<[u32; 3]> = places.iter().map(|&[x, y, z]| [z, y, x]).collect();
    let mut boxes = Vec::new();
    while let Some(low) = left.pop_first() {
        left.insert(low);
        let mut high = low;
        for axis in [2, 1, 0] {
            // The next layer of cells along an axis, with the cross-section of the box.
            let layer = |at: u32, high: [u32; 3]| {
                let (mut from, mut to) = (low, high);
                (from[axis], to[axis]) = (at, at);
                all_between(from, to)
            };
            while let Some(next) = high[axis].checked_add(1)
                && layer(next, high).all(|cell| left.contains(&cell))
            {
                high[axis] = next;
            }
        }
        all_between(low, high).for_each(|cell| _ = left.remove(&cell));
        let half = 0.5 * lattice.spacing_m();
        let corner = |[z, y, x]: [u32; 3], by: f64| {
            let centre = lattice.origin_m();
            let place = [x, y, z];
            std::array::from_fn(|axis| {
                centre[axis] + f64::from(place[axis]) * lattice.spacing_m() + by
            })
        };
        boxes.push([corner(low, -half), corner(high, half)]);
    }
    Ok(boxes)
}

/// All cells between two corners, inclusive.
fn all_between(low: [u32; 3], high: [u32; 3]) -> impl Iterator<Item = [u32; 3]> {
    (low[0]..=high[0]).flat_map(move |a| {
        (low[1]..=high[1]).flat_map(move |b| (low[2]..=high[2]).map(move |c| [a, b, c]))
    })
}

/// The lattice of a field, and the grid coordinates of its cells.
fn places(field: &FieldFile) -> Result<(Lattice, Vec<[u32; 3]>), String> {
    let (Some(lattice), Some(cells)) = (&field.lattice, &field.cells) else {
        return Err(
            "has no lattice; boxes and springs are made from the cells of a lattice".to_owned()
        );
    };
    let lattice = Lattice::new(lattice.origin_m, lattice.spacing_m, lattice.shape)
        .map_err(|error| error.to_string())?;
    let places = cells.iter().map(|&cell| lattice.place(CellId(cell))).collect();
    Ok((lattice, places))
}

/// A URDF of one link whose collision and visual geometry is the boxes.
pub fn urdf(boxes: &[Corners]) -> String {
    let mut xml =
        String::from("<?xml version=\"1.0\"?>\n<robot name=\"field\">\n  <link name=\"field\">\n");
    for kind in ["visual", "collision"] {
        for [low, high] in boxes {
            let centre: [f64; 3] = std::array::from_fn(|axis| 0.5 * (low[axis] + high[axis]));
            let size: [f64; 3] = std::array::from_fn(|axis| high[axis] - low[axis]);
            let _ = writeln!(
                xml,
                "    <{kind}><origin xyz=\"{}\"/><geometry><box size=\"{}\"/></geometry></{kind}>",
                spaced(centre),
                spaced(size)
            );
        }
    }
    xml + "  </link>\n</robot>\n"
}

fn spaced(numbers: [f64; 3]) -> String {
    numbers.map(|number| format!("{number:.6}")).join(" ")
}

/// Balls on springs.
#[derive(Debug, Clone, PartialEq)]
pub struct PointSprings {
    /// Rest points, m, and stiffness, N/m.
    pub points: Vec<([f64; 3], f64)>,
    /// Radius of every ball, m.
    pub radius_m: f64,
}

/// The springs of a field's cells; `most` is the largest number of springs. Cells are merged in cubic blocks, which are
/// enlarged until there are no more than `most`. The stiffness of a block is the sum over its cells, since a link that
/// pushes into a block displaces all of them; its point is their mean, weighted by stiffness.
///
/// # Errors
///
/// The end of a message, if the field has no lattice.
pub fn springs(field: &FieldFile, most: usize) -> Result<PointSprings, String> {
    let (lattice, places) = places(field)?;
    let mut side = 1;
    loop {
        let mut blocks: BTreeMap<[u32; 3], (f64, [f64; 3])> = BTreeMap::new();
        for ((place, k), point) in places.iter().zip(&field.stiffness).zip(&field.points) {
            if *k > 0.0 {
                let (sum, moment) = blocks.entry(place.map(|at| at / side)).or_default();
                *sum += k;
                moment.iter_mut().zip(point).for_each(|(moment, at)| *moment += k * at);
            }
        }
        if blocks.len() <= most.max(1) {
            let points = blocks.into_values().map(|(k, moment)| (moment.map(|own| own / k), k));
            let radius_m = 0.5 * f64::from(side) * lattice.spacing_m();
            return Ok(PointSprings { points: points.collect(), radius_m });
        }
        side += 1;
    }
}

/// A MuJoCo model of springs: each is a ball on three slide joints, with gravity compensation. The balls do not collide
/// with each other.
pub fn mujoco_xml(springs: &PointSprings) -> String {
    let radius = springs.radius_m;
    let mut xml = format!(
        "<mujoco model=\"field\">\n  <option integrator=\"implicitfast\"/>\n  <default>\n    \
         <geom type=\"sphere\" size=\"{radius:.6}\" density=\"{DENSITY_KG_PER_M3}\" contype=\"0\" \
         conaffinity=\"1\" rgba=\"0.3 0.6 0.3 1\"/>\n  </default>\n  <worldbody>\n"
    );
    for (number, (point, stiffness)) in springs.points.iter().enumerate() {
        let _ = write!(
            xml,
            "    <body name=\"cell_{number}\" pos=\"{}\" gravcomp=\"1\">",
            spaced(*point)
        );
        for axis in ["1 0 0", "0 1 0", "0 0 1"] {
            let damping = RELAXATION_S * stiffness;
            let _ = write!(
                xml,
                "<joint type=\"slide\" axis=\"{axis}\" stiffness=\"{stiffness:.6}\" damping=\"{damping:.6}\"/>"
            );
        }
        xml += "<geom/></body>\n";
    }
    xml + "  </worldbody>\n</mujoco>\n"
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::field::FieldLattice;

    fn field(cells: &BTreeSet<u32>) -> FieldFile {
        let lattice =
            FieldLattice { origin_m: [0.1, -0.2, 0.3], spacing_m: 0.02, shape: [5, 4, 3] };
        let of = Lattice::new(lattice.origin_m, lattice.spacing_m, lattice.shape).unwrap();
        FieldFile {
            points: cells.iter().map(|&cell| of.point(CellId(cell)).into()).collect(),
            stiffness: cells.iter().map(|&cell| f64::from(cell) + 1.0).collect(),
            std: None,
            counts: None,
            prior: None,
            lattice: Some(lattice),
            cells: Some(cells.iter().copied().collect()),
        }
    }

    proptest! {
        #[test]
        fn boxes_hold_each_cell_once_and_nothing_else(cells in prop::collection::btree_set(0_u32..60, 0..60)) {
            let field = field(&cells);
            let boxes = boxes(&field).unwrap();
            let volume: f64 = boxes.iter().map(|[low, high]| {
                (0..3).map(|axis| high[axis] - low[axis]).product::<f64>()
            }).sum();
            prop_assert!((volume - cells.len() as f64 * 0.02_f64.powi(3)).abs() < 1e-12);
            for point in &field.points {
                let holds = |[low, high]: &&Corners| {
                    (0..3).all(|axis| low[axis] < point[axis] && point[axis] < high[axis])
                };
                prop_assert_eq!(boxes.iter().filter(holds).count(), 1);
            }
        }

        #[test]
        fn blocks_of_springs_keep_the_sum_and_are_few_enough(
            cells in prop::collection::btree_set(0_u32..60, 1..60), most in 1_usize..20,
        ) {
            let field = field(&cells);
            let springs = springs(&field, most).unwrap();
            prop_assert!(springs.points.len() <= most);
            let sum: f64 = springs.points.iter().map(|(_, k)| k).sum();
            prop_assert!((sum - field.stiffness.iter().sum::<f64>()).abs() < 1e-9);
            let all = super::springs(&field, 60).unwrap();
            prop_assert_eq!(all.points.len(), cells.len());
            prop_assert!((all.radius_m - 0.01).abs() < 1e-12);
        }
    }

    #[test]
    fn a_full_lattice_is_one_box() {
        let boxes = boxes(&field(&(0..60).collect())).unwrap();
        assert_eq!(boxes.len(), 1);
        for (found, wanted) in
            boxes[0].as_flattened().iter().zip([0.09, -0.21, 0.29, 0.19, -0.13, 0.35])
        {
            assert!((found - wanted).abs() < 1e-12);
        }
        let none = FieldFile { cells: None, ..field(&BTreeSet::new()) };
        assert!(super::boxes(&none).unwrap_err().contains("no lattice"));
    }
}
