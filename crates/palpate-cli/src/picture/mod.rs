//! Pictures, as SVG that needs no font of this machine.
//!
//! [`torques()`] shows predicted and measured torques, [`field()`] the field from three
//! sides, [`errors()`] the error of every method during a touch, [`fig4()`] the field beside the
//! camera's cloud that it was extrapolated to. They return the file's text; [`Format`] writes it, or
//! converts it to a PNG, with a font that is compiled in.

mod draw;
mod errors;
mod field;
mod fig4;
mod format;
mod raster;
mod scale;
mod torques;
mod view;

pub(crate) use errors::{colour, counted, errors};
pub(crate) use field::field;
pub(crate) use fig4::fig4;
pub(crate) use format::Format;
pub(crate) use torques::torques;
pub(crate) use view::View;
