//! Decides which cells and contacts are drawn, in which size and colour.
//!
//! A field of twenty thousand cells would hide the arm, and most cells are very soft: only the
//! stiffest are drawn, and the stiffer a cell, the larger its ball. Of thousands of contacts a
//! viewer can draw a few hundred in every sample. They are chosen by a fixed pseudo-random number
//! of each cell: those with the lowest numbers. So the same cells are drawn from sample to sample,
//! no arrow flickers, and the drawn ones are evenly spread.

use nalgebra::{Point3, Vector3};
use palpate::{CellId, Contacts, Field};

/// Largest number of cells drawn.
pub const CELLS: usize = 10_000;
/// Largest number of contacts drawn.
pub const CONTACTS: usize = 300;
/// Range of the colour scale, in powers of ten of stiffness.
pub const DECADES: f64 = 1.5;

/// Share of the touched cells that are stiffer than the upper end of the colour scale.
const ABOVE: f64 = 0.005;
/// Radius of a ball, as a multiple of the spacing, at the lower and upper end of the colour scale.
const RADII: [f64; 2] = [0.1, 0.5];

/// A link as a closed mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkShape {
    /// The link's name.
    pub name: String,
    /// Vertices, m, in the frame of the link.
    pub vertices_m: Vec<Point3<f64>>,
    /// Indices of the corners, counter-clockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl LinkShape {
    /// Outward unit normals at the vertices: the mean over the adjacent triangles, weighted by
    /// area.
    ///
    /// # Panics
    ///
    /// If a corner is not the index of a vertex.
    pub fn normals(&self) -> Vec<Vector3<f64>> {
        let mut sums = vec![Vector3::zeros(); self.vertices_m.len()];
        for corners in &self.triangles {
            let [a, b, c] = corners.map(|at| self.vertices_m[at as usize]);
            let twice_area = (b - a).cross(&(c - a));
            corners.iter().for_each(|&at| sums[at as usize] += twice_area);
        }
        sums.iter().map(|sum| sum.try_normalize(0.0).unwrap_or_else(Vector3::z)).collect()
    }
}

/// The drawn cells of a field; every vector has one entry for each cell.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DrawnCells {
    /// Rest points, m.
    pub points_m: Vec<[f32; 3]>,
    /// Colours: red, green, blue.
    pub colours: Vec<[u8; 3]>,
    /// Radii of the balls, m.
    pub radii_m: Vec<f32>,
    /// K, N/m.
    pub stiffness_n_per_m: Vec<f32>,
    /// Standard deviation of K, N/m.
    pub std_n_per_m: Vec<f32>,
    /// Number of frames that touched the cell.
    pub counts: Vec<u32>,
}

impl DrawnCells {
    /// The cells that are stiffer than this, N/m.
    #[must_use]
    pub fn above(&self, stiffness_n_per_m: f32) -> Self {
        let mut kept = Self::default();
        for row in 0..self.points_m.len() {
            if self.stiffness_n_per_m[row] > stiffness_n_per_m {
                kept.points_m.push(self.points_m[row]);
                kept.colours.push(self.colours[row]);
                kept.radii_m.push(self.radii_m[row]);
                kept.stiffness_n_per_m.push(self.stiffness_n_per_m[row]);
                kept.std_n_per_m.push(self.std_n_per_m[row]);
                kept.counts.push(self.counts[row]);
            }
        }
        kept
    }
}

/// The colour scale of stiffness: viridis over the logarithm.
///
/// The upper end only rises as the field grows: if it also fell, cells whose stiffness is constant
/// would change colour more often.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Scale {
    top_n_per_m: f64,
}

impl Scale {
    /// Raises the upper end to fit a field, if needed; returns whether the scale has changed.
    pub fn widen(&mut self, field: &Field) -> bool {
        let mut touched: Vec<f64> =
            field.touched_rows().map(|row| field.stiffness_n_per_m[row]).collect();
        if touched.is_empty() {
            return false;
        }
        let above = (ABOVE * touched.len() as f64) as usize;
        let by_stiffness = |a: &f64, b: &f64| b.total_cmp(a);
        let reached = *touched.select_nth_unstable_by(above, by_stiffness).1;
        let widened = reached > self.top_n_per_m;
        self.top_n_per_m = self.top_n_per_m.max(reached);
        widened
    }

    /// Stiffness at the lower and upper end of the scale, N/m; softer cells are not drawn.
    pub fn ends_n_per_m(&self) -> [f64; 2] {
        [self.top_n_per_m / 10_f64.powf(DECADES), self.top_n_per_m]
    }

    /// The touched cells at or above the lower end of the scale; the stiffest [`CELLS`] if there
    /// are more.
    pub fn cells(&self, field: &Field) -> DrawnCells {
        let [low, high] = self.ends_n_per_m();
        let stiffness = |row: usize| field.stiffness_n_per_m[row];
        let mut drawn: Vec<usize> = field
            .touched_rows()
            .filter(|&row| stiffness(row) > 0.0 && stiffness(row) >= low)
            .collect();
        if drawn.len() > CELLS {
            let by_stiffness = |a: &usize, b: &usize| stiffness(*b).total_cmp(&stiffness(*a));
            drawn.select_nth_unstable_by(CELLS, by_stiffness);
            drawn.truncate(CELLS);
        }
        drawn.sort_unstable();
        let spacing_m = field.lattice.spacing_m();
        let mut cells = DrawnCells::default();
        for row in drawn {
            let part = ((stiffness(row) / high).log10() / DECADES + 1.0).clamp(0.0, 1.0);
            let radius_m = spacing_m * (RADII[0] + part * (RADII[1] - RADII[0]));
            cells.points_m.push(single(&field.lattice.point(field.cells[row])));
            cells.colours.push(viridis(part));
            cells.radii_m.push(radius_m as f32);
            cells.stiffness_n_per_m.push(stiffness(row) as f32);
            cells.std_n_per_m.push(field.std_n_per_m[row] as f32);
            cells.counts.push(field.counts[row]);
        }
        cells
    }
}

/// Matplotlib's colour map viridis, for values 0 to 1; returns sRGB.
pub fn viridis(part: f64) -> [u8; 3] {
    let colour = colorous::VIRIDIS.eval_continuous(part.clamp(0.0, 1.0));
    [colour.r, colour.g, colour.b]
}

/// Displaced cells and their displacements, m: all, or [`CONTACTS`] of them, chosen
/// pseudo-randomly.
pub fn thinned(contacts: &Contacts) -> Vec<(CellId, [f32; 3])> {
    let links = contacts.links.iter();
    let mut drawn: Vec<(CellId, [f32; 3])> = links
        .flat_map(|link| link.cells.iter().copied().zip(link.displacements_m.iter().copied()))
        .collect();
    if drawn.len() > CONTACTS {
        drawn.select_nth_unstable_by_key(CONTACTS, |(cell, _)| lot(*cell));
        drawn.truncate(CONTACTS);
    }
    drawn
}

/// A fixed pseudo-random number of a cell; no two cells have the same one.
fn lot(cell: CellId) -> u32 {
    // Multiplication by an odd number and this xor-shift are both one-to-one.
    let mixed = cell.0.wrapping_mul(0x9e37_79b1);
    (mixed ^ (mixed >> 16)).wrapping_mul(0x85eb_ca6b)
}

/// A point in single precision, for drawing.
pub(crate) fn single(point: &Point3<f64>) -> [f32; 3] {
    [point.x as f32, point.y as f32, point.z as f32]
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate::unstable::{LinkContacts, LinkId};
    use palpate::{ContactConfig, ExternalTorqueConfig, Lattice};
    use std::collections::HashSet;

    /// A field whose cell n has the n-th of these stiffnesses and was touched in n + 1 frames.
    fn field(stiffness_n_per_m: Vec<f64>) -> Field {
        let n = stiffness_n_per_m.len() as u32;
        let lattice = Lattice::new([0.0; 3], 0.01, [100; 3]).unwrap();
        let (contact, touch) = (ContactConfig::default(), ExternalTorqueConfig::default());
        let mut field = Field::new(lattice, contact, touch, 0.01);
        field.cells = (0..n).map(CellId).collect();
        field.std_n_per_m = stiffness_n_per_m.iter().map(|k| 0.5 * k).collect();
        field.stiffness_n_per_m = stiffness_n_per_m;
        field.counts = (1..=n).collect();
        field
    }

    fn scale(field: &Field) -> Scale {
        let mut scale = Scale::default();
        assert!(scale.widen(field));
        scale
    }

    fn contacts(cells: impl Iterator<Item = u32>) -> Contacts {
        let cells: Vec<CellId> = cells.map(CellId).collect();
        let displacements_m = cells.iter().map(|cell| [cell.0 as f32, 0.0, 1.0]).collect();
        Contacts { links: vec![LinkContacts { link: LinkId(0), cells, displacements_m }] }
    }

    #[test]
    fn the_ends_of_the_scale_are_the_ends_of_viridis_and_of_the_radii() {
        let field = field(vec![100.0, 100.0 / 10_f64.powf(DECADES) * 1.000_001, 1.0]);
        let cells = scale(&field).cells(&field);
        assert_eq!(cells.colours, [[253, 231, 37], [68, 1, 84]]);
        assert_eq!(cells.counts, [1, 2], "what is softer than the first colour is not drawn");
        assert!((cells.radii_m[0] - 0.005).abs() < 1e-8 && (cells.radii_m[1] - 0.001).abs() < 1e-6);
        assert_eq!((cells.stiffness_n_per_m[0], cells.std_n_per_m[0]), (100.0, 50.0));
        assert_eq!(cells.points_m[1], single(&field.lattice.point(CellId(1))));
    }

    #[test]
    fn cells_that_were_never_touched_are_not_drawn() {
        let mut field = field(vec![100.0, 90.0]);
        field.counts[0] = 0;
        let scale = scale(&field);
        assert_eq!(scale.ends_n_per_m()[1], 90.0);
        assert_eq!(scale.cells(&field).stiffness_n_per_m, [90.0]);
    }

    #[test]
    fn a_scale_only_grows() {
        let mut scale = scale(&field(vec![100.0]));
        assert!(!scale.widen(&field(vec![10.0])) && !scale.widen(&field(Vec::new())));
        assert_eq!(scale.ends_n_per_m()[1], 100.0);
        assert!(scale.widen(&field(vec![200.0])));
    }

    #[test]
    fn few_outliers_do_not_stretch_the_scale() {
        let mut stiffness = vec![10.0; 1000];
        stiffness[7] = 1e6;
        assert_eq!(scale(&field(stiffness)).ends_n_per_m()[1], 10.0);
    }

    #[test]
    fn of_a_large_field_the_stiffest_cells_are_drawn() {
        let field = field((0..CELLS + 500).map(|n| 100.0 + (n as f64 * 0.7).sin()).collect());
        let drawn = scale(&field).cells(&field).stiffness_n_per_m;
        let mut sorted = field.stiffness_n_per_m.clone();
        sorted.sort_by(|a, b| b.total_cmp(a));
        assert_eq!(drawn.len(), CELLS);
        assert_eq!(drawn.iter().copied().fold(f32::MAX, f32::min), sorted[CELLS - 1] as f32);
    }

    #[test]
    fn an_empty_field_draws_nothing() {
        let (soft, empty) = (field(vec![0.0; 5]), field(Vec::new()));
        let scale = Scale::default();
        assert_eq!(
            (scale.cells(&soft), scale.cells(&empty)),
            (DrawnCells::default(), DrawnCells::default())
        );
    }

    #[test]
    fn few_contacts_are_all_drawn_with_their_displacements() {
        let drawn = thinned(&contacts(0..CONTACTS as u32));
        assert_eq!(drawn.len(), CONTACTS);
        assert!(drawn.iter().all(|(cell, u)| *u == [cell.0 as f32, 0.0, 1.0]));
    }

    #[test]
    fn a_contact_that_is_drawn_stays_so_while_others_leave() {
        let cells = |range| thinned(&contacts(range)).iter().map(|(c, _)| *c).collect();
        let (all, fewer): (HashSet<CellId>, HashSet<CellId>) = (cells(0..4000), cells(500..4000));
        assert_eq!((all.len(), fewer.len()), (CONTACTS, CONTACTS));
        assert!(all.iter().filter(|cell| cell.0 >= 500).all(|cell| fewer.contains(cell)));
        // Evenly spread: each quarter of the cells has its share.
        for quarter in 0..4 {
            let share = all.iter().filter(|cell| cell.0 / 1000 == quarter).count();
            assert!((45..105).contains(&share), "{share} of {CONTACTS} in quarter {quarter}");
        }
    }

    #[test]
    fn normals_of_an_octahedron_point_away_from_its_middle() {
        let corners = [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
        let vertices_m: Vec<Point3<f64>> =
            corners.iter().map(|c: &[i32; 3]| Point3::from(c.map(f64::from))).collect();
        let around = [[0, 1], [1, 2], [2, 3], [3, 0]];
        let triangles = around.iter().flat_map(|&[a, b]| [[a, b, 4], [b, a, 5]]).collect();
        let shape = LinkShape { name: "octahedron".into(), vertices_m, triangles };
        for (normal, vertex) in shape.normals().iter().zip(&shape.vertices_m) {
            assert!((normal - vertex.coords).norm() < 1e-12, "{normal} at {vertex}");
        }
    }
}
