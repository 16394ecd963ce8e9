//! Pictures, as SVG that needs no font of this machine.
//!
//! [`torques()`] shows what was predicted beside what was felt, [`field()`] the field from three
//! sides, [`errors()`] how wrong every method was during a touch, [`fig4()`] the field beside the
//! camera's cloud that it was extrapolated to. They return the file's text; [`Format`] writes it, or
//! turns it into a PNG, with letters that the command brings along.

mod errors;
mod field;
mod fig4;
mod format;
mod raster;
mod scale;
mod torques;
mod view;

use plotters::backend::SVGBackend;
use plotters::coord::Shift;
use plotters::drawing::DrawingArea;
use plotters::style::{Color, IntoFont, RGBColor, TextStyle};

pub(crate) use errors::{counted, errors};
pub(crate) use field::field;
pub(crate) use fig4::fig4;
pub(crate) use format::Format;
pub(crate) use torques::torques;
pub(crate) use view::View;

/// Where a picture is drawn.
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// Drawing into memory fails only if plotters does.
type Drawn = Result<(), Box<dyn std::error::Error>>;

const INK: RGBColor = RGBColor(40, 44, 52);
const FAINT: RGBColor = RGBColor(225, 228, 232);

/// Text of a size, in the reader's own sans-serif.
fn text(size_px: u32) -> TextStyle<'static> {
    ("sans-serif", size_px).into_font().color(&INK)
}

/// Draws a picture of a size, px, and returns the SVG.
fn svg(size_px: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> Result<String, String> {
    use plotters::drawing::IntoDrawingArea;
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size_px).into_drawing_area();
        let white = RGBColor(255, 255, 255).filled();
        let drawn = area.fill(&white.color).map_err(Into::into).and_then(|()| draw(&area));
        drawn.map_err(|error| format!("the picture cannot be drawn: {error}"))?;
        area.present().map_err(|error| format!("the picture cannot be drawn: {error}"))?;
    }
    Ok(svg)
}
