//! A field beside the camera's cloud that it was extrapolated to (Fig. 4), for picture and page.

use nalgebra::{Point3, Vector3};
use palpate::{Arm, Field};
use palpate_learn::extrapolate::Extrapolation;

/// Share of the touched cells that a picture shows if no threshold is given: the stiffest ones.
const STIFFEST: f64 = 0.05;
/// Share of the cloud's points, and of the cells shown without a given threshold, above the colour
/// range.
const ABOVE: [f64; 2] = [0.02, 0.1];
/// Share of the cloud's points above the lower end of the colour range.
const ABOVE_LOWER_END: f64 = 0.98;
/// Least and largest number of decades of the colour range.
const DECADES: [f64; 2] = [0.5, 2.5];

/// A field, the arm that touched it, and a camera's cloud to which it was extrapolated.
pub(crate) struct ExtrapolationView<'a> {
    /// The field; its cells with a count of zero were never touched, and are not shown.
    pub(crate) field: &'a Field,
    pub(crate) arm: &'a Arm,
    /// Joint positions in the deepest frame of each touch, rad.
    pub(crate) touching: &'a [Vec<f64>],
    /// The cloud, world frame, m.
    pub(crate) points: &'a [Point3<f64>],
    /// Red, green and blue of each point.
    pub(crate) colours: &'a [[u8; 3]],
    /// The extrapolated stiffness of each point.
    pub(crate) found: &'a Extrapolation,
}

/// A table of the page, as text; its first column names the rows.
pub(crate) struct Table {
    pub(crate) title: &'static str,
    pub(crate) caption: &'static str,
    pub(crate) head: Vec<&'static str>,
    pub(crate) rows: Vec<Vec<String>>,
}

impl ExtrapolationView<'_> {
    /// The cells that were touched, and K of each, N/m.
    pub(crate) fn cells(&self) -> impl Iterator<Item = (Point3<f64>, f64)> {
        let field = self.field;
        field
            .touched_rows()
            .map(|row| (field.lattice.point(field.cells[row]), field.stiffness_n_per_m[row]))
    }

    /// The mean of the cloud's points, or of the touched cells if there is no point, m, world
    /// frame.
    pub(crate) fn middle(&self) -> Point3<f64> {
        let places: Vec<Point3<f64>> = match self.points {
            [] => self.cells().map(|(place, _)| place).collect(),
            points => points.to_vec(),
        };
        let sum: Vector3<f64> = places.iter().map(|place| place.coords).sum();
        Point3::from(sum / places.len().max(1) as f64)
    }

    /// The stiffness that one touched cell in twenty reaches, N/m, rounded down to two digits; 0 if
    /// no cell was touched.
    pub(crate) fn threshold_n_per_m(&self) -> f64 {
        let stiffness = self.cells().map(|(_, stiffness)| stiffness);
        two_digits(reached_by(stiffness, STIFFEST))
    }

    /// The stiffness at the ends of the colour range, N/m, the same for field and cloud.
    pub(crate) fn colour_range_n_per_m(&self) -> [f64; 2] {
        let cloud = |part| reached_by(self.found.stiffness_n_per_m.iter().copied(), part);
        let cells = self.cells().map(|(_, stiffness)| stiffness);
        let high = cloud(ABOVE[0]).max(reached_by(cells, STIFFEST * ABOVE[1]));
        let high = if high > 0.0 { high } else { 1.0 };
        let [least, most] = DECADES.map(|decades| high / 10_f64.powf(decades));
        let low = if self.points.is_empty() { most } else { cloud(ABOVE_LOWER_END) };
        [low.clamp(most, least), high]
    }
}

/// The largest value that at least this share of the numbers reaches; 0 if there are no numbers.
pub(crate) fn reached_by(numbers: impl Iterator<Item = f64>, part: f64) -> f64 {
    let mut sorted: Vec<f64> = numbers.collect();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let many = (part * sorted.len() as f64).ceil().max(1.0) as usize;
    sorted.get(many - 1).copied().unwrap_or(0.0)
}

/// A positive number rounded down to two significant digits, so that its text is short.
fn two_digits(number: f64) -> f64 {
    if number <= 0.0 {
        return 0.0;
    }
    let digits = 1 - number.log10().floor() as i32;
    let cut = (number * 10_f64.powi(digits) + 1e-9).floor() / 10_f64.powi(digits);
    format!("{cut:.*}", digits.max(0) as usize).parse().unwrap_or(cut)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::example;

    /// A ball of cells and the points of a shell around it; owns what an `ExtrapolationView`
    /// borrows.
    pub(crate) struct Example {
        pub(crate) field: Field,
        pub(crate) arm: Arm,
        pub(crate) touching: Vec<Vec<f64>>,
        pub(crate) points: Vec<Point3<f64>>,
        colours: Vec<[u8; 3]>,
        found: Extrapolation,
    }

    impl Example {
        /// An example with this number of touches and points.
        pub(crate) fn new(touches: usize, points: usize) -> Self {
            let turn = |n: usize| 2.4 * n as f64;
            let place = |n: usize| {
                let z = 1.0 - 2.0 * (n as f64 + 0.5) / points as f64;
                let radius = (1.0 - z * z).sqrt();
                let on_ball = [radius * turn(n).cos(), radius * turn(n).sin(), z];
                Point3::from([0.4, 0.0, 0.5]) + Vector3::from(on_ball) * 0.26
            };
            let stiff = |n: usize| n.is_multiple_of(7);
            let every = 0..points;
            Self {
                field: example::field(),
                arm: example::arm(),
                touching: (0..touches).map(|touch| vec![0.1 * touch as f64; 7]).collect(),
                points: every.clone().map(place).collect(),
                colours: every.clone().map(|n| [40, if stiff(n) { 30 } else { 160 }, 20]).collect(),
                found: Extrapolation {
                    stiffness_n_per_m: (every.clone())
                        .map(|n| if stiff(n) { 300.0 } else { 4.0 + (n % 5) as f64 })
                        .collect(),
                    std_n_per_m: every.clone().map(|n| 1.0 + (n % 3) as f64).collect(),
                    touched: every.map(|n| n.is_multiple_of(2)).collect(),
                },
            }
        }

        pub(crate) fn seen(&self) -> ExtrapolationView<'_> {
            ExtrapolationView {
                field: &self.field,
                arm: &self.arm,
                touching: &self.touching,
                points: &self.points,
                colours: &self.colours,
                found: &self.found,
            }
        }
    }

    #[test]
    fn one_touched_cell_in_twenty_reaches_the_threshold() {
        let mut example = Example::new(1, 10);
        let seen = example.seen();
        let all = seen.cells().count();
        let threshold = seen.threshold_n_per_m();
        let reach = seen.cells().filter(|&(_, stiffness)| stiffness >= threshold).count();
        assert!((0.05..0.06).contains(&(reach as f64 / all as f64)), "{reach} of {all}");

        example.field.counts.fill(0);
        let seen = example.seen();
        assert_eq!((seen.cells().count(), seen.threshold_n_per_m()), (0, 0.0));
    }

    #[test]
    fn the_colour_range_is_that_of_the_cloud_within_limits() {
        let mut example = Example::new(0, 700);
        let decades = |example: &Example| {
            let [low, high] = example.seen().colour_range_n_per_m();
            (high / low).log10()
        };
        assert!((decades(&example) - 75_f64.log10()).abs() < 1e-9, "{}", decades(&example));
        example.found.stiffness_n_per_m.fill(100.0);
        assert!((decades(&example) - DECADES[0]).abs() < 1e-9, "one stiffness");
        example.found.stiffness_n_per_m[..600].fill(0.0);
        assert!((decades(&example) - DECADES[1]).abs() < 1e-9, "nearly all without any");
    }

    #[test]
    fn two_digits_never_exceed_the_number() {
        let cut = [0.0, 0.1299, 1.0, 12.99, 123.4, 999.9].map(two_digits);
        assert_eq!(cut, [0.0, 0.12, 1.0, 12.0, 120.0, 990.0]);
        assert_eq!(reached_by([3.0, 1.0, 2.0].into_iter(), 0.5), 2.0);
    }
}
