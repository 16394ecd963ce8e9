//! Logarithmic colours for stiffness, and their colour bar.

use plotters::element::{PathElement, Rectangle, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, RGBColor};

use super::draw::{Area, Drawn, INK, text};

/// Number of decades of a scale whose ends are not given.
const DECADES: f64 = 2.5;
const SOFT: RGBColor = RGBColor(226, 228, 232);

/// The colour of every stiffness.
pub(super) struct Scale {
    /// Stiffness at the lower end of the colour bar, N/m.
    start: f64,
    /// Number of decades from the lower to the upper end.
    decades: f64,
}

impl Scale {
    /// A scale up to a stiffness, N/m.
    pub(super) fn up_to(largest_n_per_m: f64) -> Self {
        let largest = if largest_n_per_m > 0.0 { largest_n_per_m } else { 1.0 };
        Self { start: largest / 10_f64.powf(DECADES), decades: DECADES }
    }

    /// A scale between two stiffnesses above zero, N/m.
    pub(super) fn between([low, high]: [f64; 2]) -> Self {
        Self { start: low, decades: (high / low).log10() }
    }

    /// Colour of a stiffness; grey below the bar.
    pub(super) fn colour(&self, stiffness: f64) -> RGBColor {
        if stiffness < self.start { SOFT } else { viridis(self.part(stiffness)) }
    }

    /// Position of a stiffness on the bar: 0 at the lower end, 1 at the upper end.
    fn part(&self, stiffness: f64) -> f64 {
        (stiffness / self.start).log10() / self.decades
    }

    /// Draws the bar between two heights, px, with room for its name above and for grey below.
    pub(super) fn bar(&self, area: &Area<'_>, (top, bottom): (i32, i32)) -> Drawn {
        area.draw(&Text::new("K [N/m]", (8, top - 32), text(14)))?;
        let y = |part: f64| bottom - (part * f64::from(bottom - top)).round() as i32;
        for step in 0..64 {
            let (from, to) = (f64::from(step) / 64.0, f64::from(step + 1) / 64.0);
            let box_px = [(10, y(to)), (28, y(from))];
            area.draw(&Rectangle::new(box_px, viridis(0.5 * (from + to)).filled()))?;
        }
        let beside = text(13).pos(Pos::new(HPos::Left, VPos::Center));
        let first = self.start.log10().floor() as i32;
        let digits: &[f64] =
            if self.decades < 1.3 { &[1.0, 2.0, 3.0, 5.0, 7.0] } else { &[1.0, 3.0] };
        for decade in first..=first + self.decades.ceil() as i32 + 1 {
            for &digit in digits {
                let stiffness = digit * 10_f64.powi(decade);
                let part = self.part(stiffness);
                if (0.0..=1.0).contains(&part) {
                    let line = [(28, y(part)), (34, y(part))];
                    area.draw(&PathElement::new(line, INK))?;
                    area.draw(&Text::new(shown(stiffness), (38, y(part)), beside.clone()))?;
                }
            }
        }
        area.draw(&Rectangle::new([(10, bottom + 10), (28, bottom + 24)], SOFT.filled()))?;
        area.draw(&Text::new("softer", (38, bottom + 17), beside))?;
        Ok(())
    }
}

/// A round number for the colour bar.
fn shown(stiffness: f64) -> String {
    let digits = (-stiffness.log10().floor()).max(0.0) as usize;
    format!("{stiffness:.digits$}")
}

/// Matplotlib's colour map of that name, 0 to 1.
fn viridis(part: f64) -> RGBColor {
    let [red, green, blue] = palpate_view::view_model::viridis(part);
    RGBColor(red, green, blue)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_colour_map_meets_its_ends() {
        assert_eq!(viridis(0.0), RGBColor(68, 1, 84));
        assert_eq!(viridis(1.0), RGBColor(253, 231, 37));
        assert_eq!(
            (shown(0.03), shown(1.0), shown(300.0)),
            ("0.03".into(), "1".into(), "300".into())
        );
    }
}
