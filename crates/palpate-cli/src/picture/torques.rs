//! Predicted and measured torque over the frames: one row for each touch, with its norm and every
//! joint. Bands are those of single joints, so they are drawn around the torques of the joints only: of the norm, they
//! give no more than an interval that is much too wide.

use std::ops::Range;

use palpate::Field;
use palpate_learn::bands::Band;
use palpate_work::predict::{FrameResult, ReferenceTorque, TouchResult};
use plotters::chart::ChartBuilder;
use plotters::element::Polygon;
use plotters::series::{AreaSeries, LineSeries};
use plotters::style::{Color, RGBAColor, RGBColor};

use super::draw::{Area, Drawn, INK, LEGEND_HEIGHT, legend, mesh, svg, text};

const WIDTH: u32 = 1480;
const ROW_HEIGHT: u32 = 300;
const NORM_WIDTH: u32 = 560;

const MEASURED: RGBColor = INK;
const PREDICTED: RGBColor = RGBColor(0, 114, 178);
const ERROR: RGBColor = RGBColor(213, 94, 0);

/// Opacity of bands.
const BAND: f64 = 0.2;

/// Draws all touches, with the bands of the field; `against` says what the predictions are compared with.
pub(crate) fn torques(
    results: &[TouchResult],
    (field, against): (&Field, ReferenceTorque),
) -> Result<String, String> {
    let rows = results.len().max(1) as u32;
    // Bands are for measured torques.
    let of =
        |touch: &TouchResult| touch.band(field).filter(|_| against == ReferenceTorque::Measured);
    let bands: Vec<Option<Band>> = results.iter().map(of).collect();
    let level = bands.iter().flatten().next().map(|band| band.level);
    let band = level.map(|level| format!("{:.0} % band of a joint", 100.0 * level));
    svg((WIDTH, LEGEND_HEIGHT + rows * ROW_HEIGHT), |area| {
        let (head, body) = area.split_vertically(LEGEND_HEIGHT);
        let entries = [
            (against.word(), MEASURED.stroke_width(2), 130),
            ("predicted", PREDICTED.stroke_width(2), 130),
            ("error of the prediction", ERROR.mix(0.45).filled(), 220),
            ("error of predicting zero", INK.mix(0.12).filled(), 220),
        ];
        let band = band.as_deref().map(|name| (name, PREDICTED.mix(BAND).filled(), 220));
        legend(&head, entries.into_iter().chain(band))?;
        let largest = results
            .iter()
            .flat_map(|touch| &touch.frames)
            .map(|frame| frame.external.norm().max(frame.predicted.norm()).max(error_of(frame)));
        let largest = largest.fold(0.5, f64::max);
        let touches = results.iter().zip(&bands);
        for (row, (touch, band)) in body.split_evenly((rows as usize, 1)).iter().zip(touches) {
            let (left, right) = row.split_horizontally(NORM_WIDTH);
            norm(&left, touch, largest)?;
            joints(&right, touch, band.as_ref())?;
        }
        Ok(())
    })
}

fn error_of(frame: &FrameResult) -> f64 {
    (&frame.predicted - &frame.external).norm()
}

/// The frames of a touch, from first to last.
fn span(touch: &TouchResult) -> Range<f64> {
    let first = touch.frames.first().map_or(0.0, |frame| frame.frame as f64);
    let last = touch.frames.last().map_or(1.0, |frame| frame.frame as f64);
    first..last.max(first + 1.0)
}

/// ‖τ‖ measured and predicted; the areas are the errors of the prediction and of predicting zero.
fn norm(area: &Area<'_>, touch: &TouchResult, largest: f64) -> Drawn {
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .margin_right(16)
        .caption(&touch.name, text(18))
        .x_label_area_size(40)
        .y_label_area_size(54)
        .build_cartesian_2d(span(touch), 0.0..largest * 1.05)?;
    mesh(&mut chart, 13)
        .disable_x_mesh()
        .x_labels(8)
        .y_labels(6)
        .x_label_formatter(&|frame| format!("{frame:.0}"))
        .x_desc("frame")
        .y_desc("|τ|  [N·m]")
        .draw()?;
    let curve = |of: fn(&FrameResult) -> f64| {
        touch.frames.iter().map(move |frame| (frame.frame as f64, of(frame)))
    };
    chart.draw_series(AreaSeries::new(curve(|f| f.external.norm()), 0.0, INK.mix(0.12)))?;
    chart.draw_series(AreaSeries::new(curve(error_of), 0.0, ERROR.mix(0.45)))?;
    chart.draw_series(LineSeries::new(curve(|f| f.external.norm()), MEASURED.stroke_width(2)))?;
    chart.draw_series(LineSeries::new(curve(|f| f.predicted.norm()), PREDICTED.stroke_width(2)))?;
    Ok(())
}

/// The outline of the band around a joint's predicted torque: forth along the upper edge, back along the lower one.
fn outline(touch: &TouchResult, band: &Band, joint: usize) -> Vec<(f64, f64)> {
    let frames = || touch.frames.iter().zip(&band.half_width);
    let edge = |(frame, width): (&FrameResult, &Vec<f64>), side: f64| {
        (frame.frame as f64, frame.predicted[joint] + side * width[joint])
    };
    let upper = frames().map(|at| edge(at, 1.0));
    upper.chain(frames().rev().map(|at| edge(at, -1.0))).collect()
}

/// Every joint's torque, measured and predicted with its band, to one scale.
fn joints(area: &Area<'_>, touch: &TouchResult, band: Option<&Band>) -> Drawn {
    let n_joints = touch.frames.first().map_or(0, |frame| frame.external.len());
    let outlines: Vec<Vec<(f64, f64)>> = band.map_or_else(Vec::new, |band| {
        (0..n_joints).map(|joint| outline(touch, band, joint)).collect()
    });
    let torques = touch.frames.iter().flat_map(|f| f.external.iter().chain(f.predicted.iter()));
    let torques = torques.copied().chain(outlines.iter().flatten().map(|(_, edge)| *edge));
    let (low, high) =
        torques.fold((-0.25_f64, 0.25_f64), |(low, high), tau| (low.min(tau), high.max(tau)));
    let pad = 0.06 * (high - low);
    let columns = n_joints.div_ceil(2).max(1);
    for (joint, panel) in area.split_evenly((2, columns)).iter().take(n_joints).enumerate() {
        let first = joint % columns == 0;
        let mut chart = ChartBuilder::on(panel)
            .margin(6)
            .caption(format!("joint {} [N·m]", joint + 1), text(13))
            .x_label_area_size(22)
            .y_label_area_size(if first { 38 } else { 30 })
            .build_cartesian_2d(span(touch), low - pad..high + pad)?;
        mesh(&mut chart, 11)
            .disable_x_mesh()
            .x_labels(4)
            .y_labels(5)
            .x_label_formatter(&|frame| format!("{frame:.0}"))
            .draw()?;
        let curve = |of: fn(&FrameResult) -> &nalgebra::DVector<f64>| {
            touch.frames.iter().map(move |frame| (frame.frame as f64, of(frame)[joint]))
        };
        let shade: RGBAColor = PREDICTED.mix(BAND);
        let band = outlines.get(joint).map(|edge| Polygon::new(edge.clone(), shade));
        chart.draw_series(band)?;
        chart.draw_series(LineSeries::new(curve(|f| &f.external), MEASURED.stroke_width(1)))?;
        chart.draw_series(LineSeries::new(curve(|f| &f.predicted), PREDICTED.stroke_width(1)))?;
    }
    Ok(())
}
