//! Reads images from files: colour as PNG or JPEG, depth as PNG, TIFF or npy.
//!
//! The file's first bytes decide the format. The crates `png`, `zune-jpeg` and `tiff` are used
//! directly: the crate `image` would add colour management and cannot read depth as 32-bit floats.
//! The size of an image is checked before memory is allocated for it.

use super::camera::MAX_SIDE;
use super::error::{RgbdError, bytes_of};
use super::images::{ColourImage, DepthImage};
use crate::npy::Rows;
use png::Transformations;
use std::io::Cursor;
use std::path::Path;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Largest number of pixels of an image; a larger image is refused.
const MAX_PIXELS: u64 = 1 << 26;
/// Largest number of pixels per byte of the file; an image that claims more is refused. Deflate
/// unpacks one byte to at most 1032, and eight pixels may share a byte.
const MAX_PIXELS_PER_BYTE: u64 = 10_000;
/// Memory limit of a decoder, without the pixels, bytes.
const MAX_EXTRA_BYTES: usize = 1 << 26;

/// Reads a colour image: JPEG, or PNG of any kind with 8 or 16 bits per channel, also grey or
/// indexed. Transparency is ignored.
///
/// # Errors
///
/// [`RgbdError::Io`] or [`RgbdError::File`].
pub fn read_colour(path: &Path) -> Result<ColourImage, RgbdError> {
    decode_colour(&bytes_of(path)?, path)
}

/// Reads a depth image: PNG of 16 bits, TIFF of 16 or 32 bits or of floats, or a two-dimensional
/// npy.
///
/// Integers are multiplied by `unit_m`, 0.001 for millimetres; floats are taken as metres.
///
/// # Errors
///
/// [`RgbdError::Io`] or [`RgbdError::File`].
///
/// # Panics
///
/// If `unit_m` is not positive and finite.
pub fn read_depth(path: &Path, unit_m: f64) -> Result<DepthImage, RgbdError> {
    decode_depth(&bytes_of(path)?, path, unit_m)
}

/// Reads a colour image from bytes; `path` is for error messages.
pub(super) fn decode_colour(bytes: &[u8], path: &Path) -> Result<ColourImage, RgbdError> {
    let image = match bytes {
        [0x89, b'P', b'N', b'G', ..] => colour_png(bytes),
        [0xff, 0xd8, ..] => colour_jpeg(bytes),
        _ => Err(unknown(bytes, "a PNG or JPEG")),
    };
    image.map_err(|reason| RgbdError::File { path: path.to_owned(), reason })
}

/// Reads a depth image from bytes; `path` is for error messages.
pub(super) fn decode_depth(
    bytes: &[u8],
    path: &Path,
    unit_m: f64,
) -> Result<DepthImage, RgbdError> {
    assert!(unit_m > 0.0 && unit_m.is_finite(), "the unit of depth must be positive and finite");
    let image = match bytes {
        [0x89, b'P', b'N', b'G', ..] => depth_png(bytes, unit_m),
        [b'I', b'I', ..] | [b'M', b'M', ..] => depth_tiff(bytes, unit_m),
        [0x93, b'N', ..] => depth_npy(bytes, unit_m),
        _ => Err(unknown(bytes, "a PNG, TIFF or npy")),
    };
    image.map_err(|reason| RgbdError::File { path: path.to_owned(), reason })
}

fn unknown(bytes: &[u8], wanted: &str) -> String {
    match &bytes[..bytes.len().min(8)] {
        [] => format!("is empty; wanted {wanted} image"),
        start => format!("begins with `{}`; wanted {wanted} image", start.escape_ascii()),
    }
}

/// Checks the size that a file of `length` bytes claims; an error if it is zero or too large.
fn size(width: u64, height: u64, length: usize) -> Result<[u32; 2], String> {
    let side = |side: u64| u32::try_from(side).ok().filter(|side| (1..=MAX_SIDE).contains(side));
    let most = MAX_PIXELS.min((length as u64).saturating_mul(MAX_PIXELS_PER_BYTE));
    match (side(width), side(height)) {
        (Some(w), Some(h)) if width * height <= most => Ok([w, h]),
        _ => Err(format!(
            "claims {width} x {height} pixels; wanted 1 to {MAX_SIDE} on each side and at \
             most {most} in all for a file of this length"
        )),
    }
}

fn broken(error: &dyn std::fmt::Display) -> String {
    format!("cannot be read: {error}")
}

type Png<'a> = png::Reader<Cursor<&'a [u8]>>;

fn open_png(bytes: &[u8], transformations: Transformations) -> Result<Png<'_>, String> {
    let limits = png::Limits { bytes: MAX_EXTRA_BYTES };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    decoder.set_transformations(transformations);
    let reader = decoder.read_info().map_err(|error| broken(&error))?;
    let (width, height) = reader.info().size();
    size(width.into(), height.into(), bytes.len())?;
    Ok(reader)
}

/// All samples of an opened PNG; an error if it is an animation.
fn samples_of(mut reader: Png) -> Result<Vec<u8>, String> {
    let size = reader.output_buffer_size().ok_or("is too large")?;
    let mut samples = vec![0; size];
    let frame = reader.next_frame(&mut samples).map_err(|error| broken(&error))?;
    if (frame.width, frame.height) != reader.info().size() {
        return Err("is an animation; wanted one picture".to_owned());
    }
    Ok(samples)
}

fn colour_png(bytes: &[u8]) -> Result<ColourImage, String> {
    let reader = open_png(bytes, Transformations::normalize_to_color8())?;
    let (width, height) = reader.info().size();
    let channels = reader.output_color_type().0.samples();
    let samples = samples_of(reader)?;
    let pixels = samples.chunks_exact(channels).map(|pixel| match *pixel {
        [r, g, b] | [r, g, b, _] => [r, g, b],
        [grey, ..] => [grey; 3],
        [] => [0; 3],
    });
    Ok(ColourImage::new(width, height, pixels.collect()))
}

fn colour_jpeg(bytes: &[u8]) -> Result<ColourImage, String> {
    let options = DecoderOptions::default()
        .set_max_width(MAX_SIDE as usize)
        .set_max_height(MAX_SIDE as usize)
        .set_strict_mode(true)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(Cursor::new(bytes), options);
    decoder.decode_headers().map_err(|error| broken(&error))?;
    let (width, height) = decoder.dimensions().ok_or("cannot be read: it has no size")?;
    let [width, height] = size(width as u64, height as u64, bytes.len())?;
    let samples = decoder.decode().map_err(|error| broken(&error))?;
    let pixels = samples.as_chunks::<3>().0.to_vec();
    if pixels.len() as u64 != u64::from(width) * u64::from(height) {
        return Err("cannot be read: its colours are not red, green and blue".to_owned());
    }
    Ok(ColourImage::new(width, height, pixels))
}

fn depth_png(bytes: &[u8], unit_m: f64) -> Result<DepthImage, String> {
    let reader = open_png(bytes, Transformations::IDENTITY)?;
    let (width, height) = reader.info().size();
    let (colour, bits) = reader.output_color_type();
    if (colour, bits) != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        return Err(format!(
            "is a PNG of type {colour:?} with {} bits; wanted grey with 16 bits: a picture \
             in colours or with 8 bits does not contain the depth",
            bits as u8
        ));
    }
    let samples = samples_of(reader)?;
    let metres = samples
        .as_chunks::<2>()
        .0
        .iter()
        .map(|&raw| (f64::from(u16::from_be_bytes(raw)) * unit_m) as f32);
    Ok(DepthImage::new(width, height, metres.collect(), unit_m))
}

fn depth_tiff(bytes: &[u8], unit_m: f64) -> Result<DepthImage, String> {
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_PIXELS as usize * 8;
    limits.intermediate_buffer_size = MAX_EXTRA_BYTES;
    let decoder = Decoder::new(Cursor::new(bytes)).map_err(|error| broken(&error))?;
    let mut decoder = decoder.with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(|error| broken(&error))?;
    size(width.into(), height.into(), bytes.len())?;
    let colour = decoder.colortype().map_err(|error| broken(&error))?;
    let wanted = "wanted grey with floats or 16 bits";
    if !matches!(colour, tiff::ColorType::Gray(16 | 32 | 64)) {
        return Err(format!("is a TIFF of type {colour:?}; {wanted}"));
    }
    let integer = |number: f64| (number * unit_m) as f32;
    let metres: Vec<f32> = match decoder.read_image().map_err(|error| broken(&error))? {
        DecodingResult::F32(metres) => metres,
        DecodingResult::F64(metres) => metres.into_iter().map(|m| m as f32).collect(),
        DecodingResult::U16(units) => units.into_iter().map(|u| integer(u.into())).collect(),
        DecodingResult::U32(units) => units.into_iter().map(|u| integer(u.into())).collect(),
        _ => return Err(format!("is a TIFF with another type of numbers; {wanted}")),
    };
    if metres.len() as u64 != u64::from(width) * u64::from(height) {
        return Err("cannot be read: it does not have one depth for each pixel".to_owned());
    }
    Ok(DepthImage::new(width, height, metres, unit_m))
}

/// Reads an array of height x width or height x width x 1.
fn depth_npy(bytes: &[u8], unit_m: f64) -> Result<DepthImage, String> {
    let rows = Rows::open(Cursor::new(bytes)).map_err(|error| error.to_string())?;
    let (height, width) = match *rows.shape() {
        [height, width] | [height, width, 1] => (height, width),
        ref shape => return Err(format!("has the shape {shape:?}; wanted height x width")),
    };
    let [width, height] = size(width, height, bytes.len())?;
    let unit = if rows.is_float() { 1.0 } else { unit_m };
    let numbers = rows.all().map_err(|error| error.to_string())?;
    let metres = numbers.into_iter().map(|number| (number * unit) as f32);
    Ok(DepthImage::new(width, height, metres.collect(), unit_m))
}
