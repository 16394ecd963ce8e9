//! Drawing into an SVG: colours, letters, a legend.

use plotters::backend::SVGBackend;
use plotters::chart::{ChartContext, MeshStyle};
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::types::RangedCoordf64 as Axis;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::element::{PathElement, Rectangle, Text};
use plotters::style::{Color, IntoFont, RGBColor, ShapeStyle, TextStyle, WHITE};

/// Where a picture is drawn.
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// Result of drawing; drawing into memory fails only on an error within plotters.
pub(super) type Drawn = Result<(), Box<dyn std::error::Error>>;

pub(super) const INK: RGBColor = RGBColor(40, 44, 52);
pub(super) const FAINT: RGBColor = RGBColor(225, 228, 232);
/// Height of a legend, px.
pub(super) const LEGEND_HEIGHT: u32 = 44;

/// Text of a size, in the reader's own sans-serif.
pub(super) fn text(size_px: u32) -> TextStyle<'static> {
    ("sans-serif", size_px).into_font().color(&INK)
}

/// Draws a picture of a size, px, and returns the SVG.
pub(super) fn svg(
    size_px: (u32, u32),
    draw: impl FnOnce(&Area<'_>) -> Drawn,
) -> Result<String, String> {
    let mut svg = String::new();
    let area = SVGBackend::with_string(&mut svg, size_px).into_drawing_area();
    let filled = area.fill(&WHITE).map_err(Into::into);
    let drawn = filled.and_then(|()| draw(&area)).and_then(|()| Ok(area.present()?));
    drop(area);
    drawn.map(|()| svg).map_err(|error| format!("the picture cannot be drawn: {error}"))
}

/// Axes, faint lines and labels of a size, px, of a chart.
pub(super) fn mesh<'a, 'b, 'c>(
    chart: &'c mut ChartContext<'a, SVGBackend<'b>, Cartesian2d<Axis, Axis>>,
    labels_px: u32,
) -> MeshStyle<'a, 'c, Axis, Axis, SVGBackend<'b>> {
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(FAINT.mix(0.0)).bold_line_style(FAINT).axis_style(INK);
    mesh.label_style(text(labels_px)).axis_desc_style(text(14));
    mesh
}

/// Draws a legend in one row: name, style (filled for an area, else for a line) and width, px, of each
/// entry.
pub(super) fn legend<'a>(
    area: &Area<'_>,
    entries: impl IntoIterator<Item = (&'a str, ShapeStyle, i32)>,
) -> Drawn {
    let mut x = 62;
    for (name, style, width) in entries {
        if style.filled {
            area.draw(&Rectangle::new([(x, 14), (x + 24, 30)], style))?;
        } else {
            area.draw(&PathElement::new([(x, 22), (x + 24, 22)], style))?;
        }
        area.draw(&Text::new(name.to_owned(), (x + 32, 14), text(16)))?;
        x += width;
    }
    Ok(())
}
