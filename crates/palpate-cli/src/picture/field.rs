//! A field from the front, the side and above: the stiffest touched cell on each line of sight.
//!
//! Cells that were never touched are not shown: they have only a prior.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use palpate::{CellId, Field, Lattice};
use plotters::chart::ChartBuilder;
use plotters::element::{Circle, Text};
use plotters::style::Color;

use super::draw::{Area, Drawn, mesh, svg, text};
use super::scale::Scale;

/// Name of each view, its axis to the right and its axis up: x, y, z as 0, 1, 2.
const VIEWS: [(&str, usize, usize); 3] =
    [("front (along x)", 1, 2), ("side (along y)", 0, 2), ("top (along z)", 0, 1)];
const AXES: [&str; 3] = ["x [m]", "y [m]", "z [m]"];

/// Size of the three plots together, px, before labels.
const PLOTS: (f64, f64) = (1200.0, 560.0);
const LABELS: (u32, u32) = (66, 46);
const TITLE: u32 = 34;
const GAP: u32 = 14;
const EDGE: u32 = 8;
const BAR_WIDTH: u32 = 110;

/// Draws a field.
pub(crate) fn field(field: &Field) -> Result<String, String> {
    let Some(scene) = Scene::of(field) else {
        return svg((640, 80), |area| {
            let note = "The field is empty: no cell was touched.";
            Ok(area.draw(&Text::new(note, (24, 30), text(18)))?)
        });
    };
    let px_per_m = scene.px_per_m();
    let sizes = VIEWS.map(|(_, right, up)| {
        let px = |axis: usize| (scene.length_m(axis) * px_per_m).round() as u32;
        (px(right) + EDGE + LABELS.0 + GAP, px(up) + LABELS.1 + TITLE + GAP)
    });
    let width = sizes.iter().map(|size| size.0).sum::<u32>() + BAR_WIDTH;
    let height = sizes.iter().map(|size| size.1).max().unwrap_or(0).max(260);
    svg((width, height), |area| {
        let mut x = 0;
        for (view, size) in VIEWS.into_iter().zip(sizes) {
            scene.view(&area.clone().shrink((x, 0), size), view)?;
            x += size.0;
        }
        let bar = (TITLE as i32 + 12, (height - LABELS.1) as i32 - 34);
        scene.scale.bar(&area.clone().shrink((x, 0), (BAR_WIDTH, height)), bar)
    })
}

/// The cells that are shown, the box around them, and the colours.
struct Scene<'a> {
    lattice: &'a Lattice,
    /// The touched cells, and the stiffness of each, N/m.
    cells: Vec<(CellId, f64)>,
    low_m: Point3<f64>,
    high_m: Point3<f64>,
    scale: Scale,
}

impl<'a> Scene<'a> {
    fn of(field: &'a Field) -> Option<Self> {
        let margin_m = Vector3::repeat(3.0 * field.lattice.spacing_m());
        let touched = field.touched_rows();
        let cells: Vec<_> =
            touched.map(|row| (field.cells[row], field.stiffness_n_per_m[row])).collect();
        let points = || cells.iter().map(|&(cell, _)| field.lattice.point(cell));
        let low_m = points().reduce(|low, point| low.inf(&point))? - margin_m;
        let high_m = points().reduce(|high, point| high.sup(&point))? + margin_m;
        let largest = cells.iter().map(|&(_, stiffness)| stiffness).fold(0.0, f64::max);
        let (lattice, scale) = (&field.lattice, Scale::up_to(largest));
        Some(Self { lattice, cells, low_m, high_m, scale })
    }

    fn length_m(&self, axis: usize) -> f64 {
        self.high_m[axis] - self.low_m[axis]
    }

    /// One scale for all views, so that lengths can be compared.
    fn px_per_m(&self) -> f64 {
        let across: f64 = VIEWS.iter().map(|&(_, right, _)| self.length_m(right)).sum();
        let up = VIEWS.iter().map(|&(_, _, up)| self.length_m(up)).fold(0.0, f64::max);
        (PLOTS.0 / across).min(PLOTS.1 / up)
    }

    /// The stiffest cell of each line of sight, softest first.
    fn projected(&self, right: usize, up: usize) -> Vec<((f64, f64), f64)> {
        let lattice = self.lattice;
        let mut seen: BTreeMap<[u32; 2], ((f64, f64), f64)> = BTreeMap::new();
        for &(cell, stiffness) in &self.cells {
            let (place, point) = (lattice.place(cell), lattice.point(cell));
            let dot = seen
                .entry([place[right], place[up]])
                .or_insert(((point[right], point[up]), stiffness));
            dot.1 = dot.1.max(stiffness);
        }
        let mut dots: Vec<_> = seen.into_values().collect();
        dots.sort_by(|a, b| a.1.total_cmp(&b.1));
        dots
    }

    fn view(&self, area: &Area<'_>, (name, right, up): (&str, usize, usize)) -> Drawn {
        let (head, body) = area.split_vertically(TITLE);
        head.draw(&Text::new(name, ((EDGE + LABELS.0) as i32, 10), text(17)))?;
        let mut chart = ChartBuilder::on(&body)
            .margin_left(EDGE)
            .margin_right(GAP)
            .margin_bottom(GAP)
            .x_label_area_size(LABELS.1)
            .y_label_area_size(LABELS.0)
            .build_cartesian_2d(
                self.low_m[right]..self.high_m[right],
                self.low_m[up]..self.high_m[up],
            )?;
        let labels = |axis: usize| ((self.length_m(axis) * self.px_per_m() / 70.0) as usize).max(2);
        mesh(&mut chart, 13)
            .x_labels(labels(right))
            .y_labels(labels(up))
            .x_desc(AXES[right])
            .y_desc(AXES[up])
            .draw()?;
        let radius_px = 0.46 * self.lattice.spacing_m() * self.px_per_m();
        let radius_px = radius_px.round().max(1.0) as i32;
        let dot =
            |(at, stiffness)| Circle::new(at, radius_px, self.scale.colour(stiffness).filled());
        chart.draw_series(self.projected(right, up).into_iter().map(dot))?;
        Ok(())
    }
}
