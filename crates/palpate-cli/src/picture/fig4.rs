//! The paper's Fig. 4: the stiff part of a field with the arm that touched it, beside the cloud that a
//! camera sees, coloured by the stiffness that was extrapolated to it.
//!
//! Both have the same view and the same scale. Points and arm are pixel images within the SVG, letters
//! and the colour bar are not.

use indicatif::HumanCount;
use nalgebra::Isometry3;
use plotters::element::{PathElement, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::draw::{Area, Drawn, INK, svg, text};
use super::raster::Raster;
use super::scale::Scale;
use super::view::{Rectangle, View};
use crate::extrapolation_view::ExtrapolationView;
use crate::hull::Hulls;

/// Height of the panels, px, without labels.
const HEIGHT: f64 = 560.0;
/// Largest width of the left and of the right panel, px.
const WIDTHS: [f64; 2] = [700.0, 520.0];
/// Pixels of the images in the panels per pixel of the picture, along each side.
const PIXELS: f64 = 1.6;
const EDGE: i32 = 14;
const HEAD: i32 = 56;
const FOOT: i32 = 52;
const BAR_WIDTH: i32 = 110;
/// Largest number of arms drawn: more of them would hide each other.
const ARMS: usize = 5;
const ARM: [u8; 3] = [150, 164, 186];
const ARM_ALPHA: f32 = 0.24;

/// Draws a field, and the cloud to which it was extrapolated.
///
/// The left panel has the touched cells whose stiffness is at least the threshold, N/m, which is
/// [`ExtrapolationView::threshold_n_per_m`] if not given.
///
/// # Errors
///
/// If the joint positions do not fit the arm.
pub(crate) fn fig4(
    seen: &ExtrapolationView<'_>,
    threshold_n_per_m: Option<f64>,
) -> Result<String, String> {
    let figure = Figure::of(seen, threshold_n_per_m)?;
    let [left, right] = figure.panels();
    let size = |panel: &Rectangle| panel.size().map(|side| (side * figure.px_per_m).round() as i32);
    let ([left_px, height], [right_px, _]) = (size(&left), size(&right));
    let second = 2 * EDGE + left_px;
    let width = second + right_px + EDGE + BAR_WIDTH;
    let drawn = svg((width as u32, (HEAD + height + FOOT) as u32), |area| {
        figure.words(area, [EDGE, second])?;
        figure.length(area, [EDGE, HEAD + height + 14])?;
        figure.axes(area, [EDGE + left_px - 60, HEAD + height + FOOT - 14])?;
        let bar =
            area.clone().shrink((second + right_px + EDGE, 0), (BAR_WIDTH, area_height(area)));
        figure.scale.bar(&bar, (HEAD + 20, HEAD + height - 40))
    })?;
    let image = |raster: &Raster, x: i32, width: i32| {
        let uri = raster.data_uri();
        format!(
            "<image x=\"{x}\" y=\"{HEAD}\" width=\"{width}\" height=\"{height}\" href=\"{uri}\"/>\n"
        )
    };
    let images = image(&figure.touched(left), EDGE, left_px)
        + &image(&figure.cloud(right), second, right_px);
    // Behind the letters, in front of the white background.
    let ground = drawn.find("/>").map_or(0, |at| at + 2);
    Ok([&drawn[..ground], "\n", &images, &drawn[ground..]].concat())
}

fn area_height(area: &Area<'_>) -> i32 {
    area.dim_in_pixel().1 as i32
}

/// What is shown, from which direction, and in which colours.
struct Figure<'a> {
    seen: &'a ExtrapolationView<'a>,
    threshold_n_per_m: f64,
    hulls: Hulls,
    /// `world_from_link` of each hull, for each arm that is drawn.
    arms: Vec<Vec<Isometry3<f64>>>,
    view: View,
    scale: Scale,
    px_per_m: f64,
}

impl<'a> Figure<'a> {
    fn of(seen: &'a ExtrapolationView<'a>, threshold_n_per_m: Option<f64>) -> Result<Self, String> {
        let hulls = Hulls::of(seen.arm);
        let touches = seen.touching.len();
        let chosen =
            (0..touches.min(ARMS)).map(|n| &seen.touching[n * touches / touches.min(ARMS)]);
        let pose = |q: &Vec<f64>| hulls.poses(seen.arm, q).map_err(|error| error.to_string());
        let arms = chosen.map(pose).collect::<Result<_, _>>()?;

        let view = View::of(&seen.middle());
        let scale = Scale::between(seen.colour_range_n_per_m());
        let threshold_n_per_m = threshold_n_per_m.unwrap_or_else(|| seen.threshold_n_per_m());
        let mut figure = Self { seen, threshold_n_per_m, hulls, arms, view, scale, px_per_m: 1.0 };
        let sizes = figure.panels().map(|panel| panel.size());
        let across = sizes.iter().zip(WIDTHS).map(|(size, width)| width / size[0]);
        figure.px_per_m = across.fold(HEIGHT / sizes[0][1], f64::min);
        Ok(figure)
    }

    /// The frame of the left panel, with the stiff cells, the cloud and as much of the arms as fits; and that of the
    /// right panel, with the cloud.
    fn panels(&self) -> [Rectangle; 2] {
        let points = Rectangle::around(self.seen.points.iter().map(|point| self.view.seen(point)));
        let stiff = Rectangle::around(self.stiff().map(|(point, _)| self.view.seen(&point)));
        let [points, stiff] = [points, stiff].map(|frame| Some(frame?.with_margin([0.03; 2])));
        let nothing = Rectangle { low: [-0.2, 0.0], high: [0.2, 0.4] };
        let cloud = points.or(stiff).unwrap_or(nothing);
        let object = cloud.and(stiff.unwrap_or(cloud));
        let corners = self.arms.iter().flat_map(|arm| self.hulls.hulls.iter().zip(arm));
        let corners = corners.flat_map(|(hull, pose)| {
            hull.vertices_m.iter().map(move |vertex| self.view.seen(&(pose * vertex)))
        });
        let [width, height] = object.size();
        let room = object.with_margin([0.5 * width.max(height), 0.25 * height]);
        let arms = Rectangle::around(corners).map(|arms| arms.with_margin([0.02; 2]).within(room));
        let left = arms.map_or(object, |arms| object.and(arms));
        let heights = [left.low[1], left.high[1]];
        [left, Rectangle { low: [cloud.low[0], heights[0]], high: [cloud.high[0], heights[1]] }]
    }

    /// Position of a point of the view in the pixels of a panel.
    fn pixel(&self, panel: &Rectangle, [x, y, near]: [f64; 3]) -> [f64; 3] {
        let px_per_m = self.px_per_m * PIXELS;
        [x - panel.low[0], panel.high[1] - y, near].map(|side| side * px_per_m)
    }

    fn raster(&self, panel: &Rectangle) -> Raster {
        Raster::new(panel.size().map(|side| (side * self.px_per_m * PIXELS).round() as u32))
    }

    fn stiff(&self) -> impl Iterator<Item = (nalgebra::Point3<f64>, f64)> {
        self.seen.cells().filter(|&(_, stiffness)| stiffness >= self.threshold_n_per_m)
    }

    /// The stiff cells, and the arms laid over them.
    fn touched(&self, panel: Rectangle) -> Raster {
        let mut raster = self.raster(&panel);
        let cell_px = self.seen.field.lattice.spacing_m() * self.px_per_m * PIXELS;
        for (point, stiffness) in self.stiff() {
            let at = self.pixel(&panel, self.view.seen(&point));
            let colour = self.scale.colour(stiffness);
            raster.ball(at, (0.56 * cell_px).max(1.0), [colour.0, colour.1, colour.2]);
        }
        raster.crease(3.0 * cell_px);
        for arm in &self.arms {
            let mut glass = raster.glass();
            for (hull, pose) in self.hulls.hulls.iter().zip(arm) {
                let vertices: Vec<_> = hull.vertices_m.iter().map(|vertex| pose * vertex).collect();
                for corners in &hull.triangles {
                    let [a, b, c] = corners.map(|at| vertices[at as usize]);
                    let out = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
                    let [right, up, near] = self.view.turned(&out);
                    let place = |point| self.pixel(&panel, self.view.seen(&point));
                    glass.triangle([a, b, c].map(place), [right, -up, near]);
                }
            }
            raster.lay(&glass, ARM, ARM_ALPHA);
        }
        raster
    }

    /// The cloud, coloured by stiffness.
    fn cloud(&self, panel: Rectangle) -> Raster {
        let mut raster = self.raster(&panel);
        // If the points were spread evenly over the panel, these dots would about fill it.
        let [width, height] = panel.size().map(|side| side * self.px_per_m * PIXELS);
        let apart = (width * height / self.seen.points.len().max(1) as f64).sqrt();
        let radius = (0.5 * apart).clamp(0.8, 6.0);
        for (point, &stiffness) in self.seen.points.iter().zip(&self.seen.found.stiffness_n_per_m) {
            let at = self.pixel(&panel, self.view.seen(point));
            let colour = self.scale.colour(stiffness);
            raster.ball(at, radius, [colour.0, colour.1, colour.2]);
        }
        raster.crease(6.0 * radius);
        raster
    }

    fn words(&self, area: &Area<'_>, [left, right]: [i32; 2]) -> Drawn {
        let (all, stiff) = (self.seen.cells().count(), self.stiff().count());
        let touches = self.seen.touching.len();
        let arm = match (self.arms.len(), touches) {
            (0, _) => String::new(),
            (1, 1) => "; the arm in its touch".to_owned(),
            (drawn, all) if drawn == all => format!("; the arm in its {all} touches"),
            (drawn, all) => format!("; the arm in {drawn} of its {all} touches"),
        };
        let field = if all == 0 {
            format!("no cell was touched{arm}")
        } else {
            let [stiff, all] = [stiff, all].map(|cells| HumanCount(cells as u64));
            format!("K ≥ {} N/m: {stiff} of {all} touched cells{arm}", self.threshold_n_per_m)
        };
        let cloud = match self.seen.points.len() {
            0 => "the camera sees no point".to_owned(),
            n => format!("{} points that the camera sees", HumanCount(n as u64)),
        };
        for (x, title, under) in
            [(left, "(a) Learnt field", field), (right, "(b) Extrapolated stiffness", cloud)]
        {
            area.draw(&Text::new(title, (x, 12), text(17)))?;
            area.draw(&Text::new(under, (x, 34), text(13)))?;
        }
        Ok(())
    }

    /// Draws a scale bar, which is valid in both panels.
    fn length(&self, area: &Area<'_>, [x, y]: [i32; 2]) -> Drawn {
        let rounds = [1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01];
        let length_m = rounds.into_iter().find(|m| m * self.px_per_m < 130.0).unwrap_or(0.01);
        let end = x + (length_m * self.px_per_m).round() as i32;
        let bar = [(x, y - 4), (x, y + 4), (x, y), (end, y), (end, y - 4), (end, y + 4)];
        area.draw(&PathElement::new(bar, INK))?;
        let beside = text(13).pos(Pos::new(HPos::Left, VPos::Center));
        Ok(area.draw(&Text::new(format!("{} cm", 100.0 * length_m), (end + 8, y), beside))?)
    }

    /// Draws the directions of x, y and z.
    fn axes(&self, area: &Area<'_>, [x, y]: [i32; 2]) -> Drawn {
        let centred = text(13).pos(Pos::new(HPos::Center, VPos::Center));
        for (name, axis) in ["x", "y", "z"].into_iter().zip([[1, 0, 0], [0, 1, 0], [0, 0, 1]]) {
            let [right, up, _] = self.view.turned(&nalgebra::Vector3::from(axis.map(f64::from)));
            let at = |px: f64| (x + (right * px).round() as i32, y - (up * px).round() as i32);
            area.draw(&PathElement::new([at(0.0), at(26.0)], INK))?;
            area.draw(&Text::new(name, at(34.0), centred.clone()))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extrapolation_view::tests::Example;

    /// The images within an SVG, and the rest of it.
    fn parts(svg: &str) -> (Vec<&str>, String) {
        let images = svg.lines().filter(|line| line.starts_with("<image")).collect();
        let words = svg.lines().filter(|line| !line.starts_with("<image"));
        (images, words.collect::<Vec<_>>().join("\n"))
    }

    #[test]
    fn the_same_picture_is_drawn_twice_and_shows_its_threshold() {
        let example = Example::new(9, 2_000);
        let svg = fig4(&example.seen(), None).unwrap();
        assert_eq!(svg, fig4(&example.seen(), None).unwrap());
        let (images, words) = parts(&svg);
        assert_eq!(images.len(), 2);
        let threshold = example.seen().threshold_n_per_m();
        let reach = example.seen().cells().filter(|cell| cell.1 >= threshold).count();
        let all = example.seen().cells().count();
        let said =
            format!("K ≥ {threshold} N/m: {reach} of {} touched cells", HumanCount(all as u64));
        for word in [&said, "5 of its 9 touches", "2,000 points", "K [N/m]", " cm"] {
            assert!(words.contains(word), "{word}");
        }
    }

    #[test]
    fn a_threshold_changes_the_left_panel_alone() {
        let example = Example::new(1, 2_000);
        let [low, high] = [1.0, 60.0].map(|k| fig4(&example.seen(), Some(k)).unwrap());
        let (low, high) = (parts(&low), parts(&high));
        assert!(low.0[0] != high.0[0] && low.0[1] == high.0[1]);
        assert!(low.1.contains("K ≥ 1 N/m") && high.1.contains("K ≥ 60 N/m"));
        assert!(
            low.1.contains("; the arm in its touch<") || low.1.contains("the arm in its touch\n")
        );
    }

    #[test]
    fn untouched_cells_are_not_drawn() {
        let mut example = Example::new(0, 500);
        let touched = fig4(&example.seen(), Some(0.0)).unwrap();
        let half = example.field.counts.len() / 2;
        example.field.counts[..half].fill(0);
        let fewer = fig4(&example.seen(), Some(0.0)).unwrap();
        assert_ne!(parts(&touched).0[0], parts(&fewer).0[0]);
        let left = HumanCount((example.field.counts.len() - half) as u64);
        assert!(fewer.contains(&format!(" of {left} touched")));
    }

    #[test]
    fn whatever_is_missing_the_rest_is_drawn() {
        for (touches, points, field) in [(0, 0, false), (3, 0, true), (0, 100, false), (1, 1, true)]
        {
            let mut example = Example::new(touches, points);
            if !field {
                example.field.counts.fill(0);
            }
            let svg = fig4(&example.seen(), None).unwrap();
            assert_eq!(svg.contains("no cell was touched"), !field);
            assert_eq!(svg.contains("the camera sees no point"), points == 0);
            assert_eq!(svg.contains("the arm in"), touches > 0);
            let (images, words) = parts(&svg);
            assert_eq!(images.len(), 2);
            assert!(!words.contains("NaN") && !words.contains("inf"), "{words}");
        }
    }

    #[test]
    fn a_large_cloud_stays_a_small_file() {
        let svg = fig4(&Example::new(3, 100_000).seen(), None).unwrap();
        assert!(svg.len() < 1_000_000, "{} bytes", svg.len());
    }

    #[test]
    fn joint_positions_of_another_arm_are_an_error() {
        let mut example = Example::new(2, 10);
        example.touching[1].pop();
        assert!(fig4(&example.seen(), None).is_err());
    }
}
