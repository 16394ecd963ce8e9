//! Position, speed and acceleration of joints from logged positions, by a polynomial that is fitted to the samples of a
//! window around each time (Savitzky and Golay 1964, with weights that fall to zero at the window's ends, and samples
//! at any times).

use nalgebra::{DMatrix, SMatrix, SVector};

/// Where the window of a fit lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Window {
    /// Around the time; near the ends of the log shifted into the log.
    Centred,
    /// Before the present, which may be later than the time of the fit.
    Causal {
        /// The present, s.
        now_s: f64,
    },
}

/// Values at a time, with their first and second derivatives.
#[derive(Debug, Clone, PartialEq)]
pub struct PolynomialFit {
    /// Values.
    pub value: Vec<f64>,
    /// First derivatives, per second.
    pub first: Vec<f64>,
    /// Second derivatives, per second squared.
    pub second: Vec<f64>,
    /// At the ends of a log, where a window is not full: differences to the first and second derivatives of a
    /// polynomial of a higher degree, per second and per second squared; infinite with too few samples for that degree.
    pub doubt: Option<[Vec<f64>; 2]>,
}

/// Vectors of values at times; polynomials are fitted to the values near a time.
#[derive(Debug, Clone)]
pub struct LocalPolynomial<'a> {
    times_s: &'a [f64],
    values: &'a [Vec<f64>],
    half_s: f64,
    window: Window,
}

impl<'a> LocalPolynomial<'a> {
    /// For values at ascending times, s, with windows of `2 · half_s`.
    ///
    /// # Panics
    ///
    /// If there are no values, or not as many as times.
    pub fn new(times_s: &'a [f64], values: &'a [Vec<f64>], half_s: f64, window: Window) -> Self {
        assert!(!times_s.is_empty() && times_s.len() == values.len(), "as many values as times");
        Self { times_s, values, half_s, window }
    }

    /// The polynomial's value and derivatives at a time, s. Its degree is three, two at the ends of a log, zero at the
    /// very start of a causal one, and lower if there are too few samples.
    pub fn at(&self, time_s: f64) -> PolynomialFit {
        let (first, last) = (self.times_s[0], self.times_s[self.times_s.len() - 1]);
        let room = |low: f64, high: f64| low >= first && high <= last;
        let wide = 2.0 * self.half_s;
        let (mut low, mut high) = match self.window {
            Window::Centred => (time_s - self.half_s, time_s + self.half_s),
            Window::Causal { now_s } => (now_s - wide, now_s),
        };
        let inside = room(low, high);
        if self.window == Window::Centred && !inside {
            low = low.min(last - wide).max(first);
            high = high.max(first + wide).min(last);
        }
        // From so short a time only the position is known: a speed would be mostly noise.
        let is_short = self.window != Window::Centred && time_s - first < 0.5 * self.half_s;
        let (degree, higher) = match (inside, is_short) {
            (true, _) => (3, None),
            (false, true) => (0, Some(2)),
            (false, false) => (2, Some(3)),
        };
        // Rounding errors of the clock must not exclude a sample.
        let slack = 1e-9 * wide;
        let start = self.times_s.partition_point(|time| *time < low - slack);
        let end = self.times_s.partition_point(|time| *time <= high + slack);
        self.fit(time_s, (start, end), (degree, higher))
    }

    fn fit(
        &self,
        time_s: f64,
        (mut start, mut end): (usize, usize),
        (degree, higher): (usize, Option<usize>),
    ) -> PolynomialFit {
        let wanted = degree + 2;
        while end - start < wanted
            && (start > 0 || (end < self.times_s.len() && self.window == Window::Centred))
        {
            start = start.saturating_sub(1);
            if self.window == Window::Centred {
                end = (end + 1).min(self.times_s.len());
            }
        }
        if end <= start {
            end = start + 1;
        }
        let distance = |index: usize| self.times_s[index] - time_s;
        let scale = distance(start).abs().max(distance(end - 1).abs()).max(1e-9) * 1.001;
        let n = self.values[0].len();
        let mut gram = SMatrix::<f64, 4, 4>::zeros();
        let mut right = DMatrix::<f64>::zeros(4, n);
        for index in start..end {
            let at = distance(index) / scale;
            let weight = (1.0 - at * at).powf(1.5);
            let powers = SVector::<f64, 4>::new(1.0, at, at * at, at * at * at);
            gram += weight * powers * powers.transpose();
            for (mut column, value) in right.column_iter_mut().zip(&self.values[index]) {
                column += weight * value * powers;
            }
        }
        let most = (end - start).saturating_sub(1);
        let (solution, _) = solve(&gram, &right, degree.min(most));
        let row = |solution: &DMatrix<f64>, row: usize| -> Vec<f64> {
            let factor = [1.0, 1.0 / scale, 2.0 / scale / scale][row];
            (0..n).map(|column| factor * solution[(row, column)]).collect()
        };
        let doubt = higher.map(|higher| match solve(&gram, &right, higher.min(most)) {
            (other, reached) if reached == higher => {
                let other = other - &solution;
                [row(&other, 1), row(&other, 2)]
            }
            _ => [vec![f64::INFINITY; n], vec![f64::INFINITY; n]],
        });
        PolynomialFit {
            value: row(&solution, 0),
            first: row(&solution, 1),
            second: row(&solution, 2),
            doubt,
        }
    }
}

/// Coefficients of a polynomial of this degree, or of the largest that the samples allow, and that degree.
fn solve(gram: &SMatrix<f64, 4, 4>, right: &DMatrix<f64>, degree: usize) -> (DMatrix<f64>, usize) {
    for degree in (0..=degree).rev() {
        let mut lower = *gram;
        for power in degree + 1..4 {
            lower.row_mut(power).fill(0.0);
            lower.column_mut(power).fill(0.0);
            lower[(power, power)] = 1.0;
        }
        let mut known = right.clone();
        known.rows_mut(degree + 1, 3 - degree).fill(0.0);
        if let Some(factor) = lower.cholesky()
            && (0..=degree).all(|power| factor.l_dirty()[(power, power)] > 1e-6)
        {
            return (factor.solve(&known), degree);
        }
    }
    (DMatrix::zeros(4, right.ncols()), 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_recovered_from_uneven_samples() {
        let times: Vec<f64> =
            (0..60).map(|k| 0.01 * f64::from(k) + 0.002 * f64::from(k % 3)).collect();
        let cubic = |t: f64| 1.0 - 2.0 * t + 3.0 * t * t - 4.0 * t * t * t;
        let values: Vec<Vec<f64>> =
            times.iter().map(|t| vec![cubic(*t), 2.0 * cubic(*t)]).collect();
        let fit = LocalPolynomial::new(&times, &values, 0.05, Window::Centred).at(0.31);
        let (first, second) = (-2.0 + 6.0 * 0.31 - 12.0 * 0.31 * 0.31, 6.0 - 24.0 * 0.31);
        assert!((fit.value[0] - cubic(0.31)).abs() < 1e-12 && (fit.first[0] - first).abs() < 1e-9);
        assert!((fit.second[1] - 2.0 * second).abs() < 1e-6, "{fit:?}");
    }

    #[test]
    fn a_parabola_is_recovered_at_the_ends_and_from_what_came_before() {
        let times: Vec<f64> = (0..60).map(|k| 0.01 * f64::from(k)).collect();
        let values: Vec<Vec<f64>> = times.iter().map(|t| vec![1.0 + t * t]).collect();
        let now = Window::Causal { now_s: 0.32 };
        for (window, at) in [(Window::Centred, 0.0), (Window::Centred, 0.59), (now, 0.3)] {
            let fit = LocalPolynomial::new(&times, &values, 0.05, window).at(at);
            assert!((fit.value[0] - 1.0 - at * at).abs() < 1e-12, "{window:?} {at}");
            assert!((fit.first[0] - 2.0 * at).abs() < 1e-9 && (fit.second[0] - 2.0).abs() < 1e-6);
        }
    }

    #[test]
    fn at_the_ends_the_doubt_of_a_parabola_is_its_error_for_a_cubic() {
        let times: Vec<f64> = (0..60).map(|k| 0.01 * f64::from(k)).collect();
        let values: Vec<Vec<f64>> = times.iter().map(|t| vec![t * t * t]).collect();
        let causal = |now_s: f64| (Window::Causal { now_s }, now_s);
        for (window, at) in [(Window::Centred, 0.0), (Window::Centred, 0.58), causal(0.08)] {
            let fit = LocalPolynomial::new(&times, &values, 0.05, window).at(at);
            let [first, second] = fit.doubt.expect("samples are on one side");
            assert!((fit.first[0] + first[0] - 3.0 * at * at).abs() < 1e-9, "{window:?} {at}");
            assert!((fit.second[0] + second[0] - 6.0 * at).abs() < 1e-6, "{window:?} {at}");
        }
        let fit = |window, at| LocalPolynomial::new(&times, &values, 0.05, window).at(at).doubt;
        assert_eq!(fit(Window::Centred, 0.3), None);
        assert_eq!(fit(Window::Causal { now_s: 0.3 }, 0.3), None);
        let [first, second] = fit(Window::Causal { now_s: 0.01 }, 0.01).unwrap();
        assert_eq!([first[0], second[0]], [f64::INFINITY; 2]);
    }

    #[test]
    fn too_few_samples_give_what_they_can() {
        let fit = |values: &[f64]| {
            let times: Vec<f64> = (0..values.len()).map(|k| k as f64).collect();
            let values: Vec<Vec<f64>> = values.iter().map(|value| vec![*value]).collect();
            LocalPolynomial::new(&times, &values, 0.1, Window::Centred).at(0.0)
        };
        let alone = fit(&[2.0]);
        assert_eq!((alone.value[0], alone.first[0], alone.second[0]), (2.0, 0.0, 0.0));
        let two = fit(&[2.0, 5.0]);
        assert!((two.value[0] - 2.0).abs() < 1e-9 && (two.first[0] - 3.0).abs() < 1e-6, "{two:?}");
    }
}
