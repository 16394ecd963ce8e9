//! Files of pictures: SVG as it was drawn, or PNG at twice its size.
//!
//! The letters of a PNG come from a font that is compiled in, not from the fonts of the machine, so
//! that the same picture has the same bytes everywhere. It is Noto Sans, under the SIL Open Font
//! Licence, which the `notosans` crate ships beside it.

use std::path::Path;

use crate::error::CliError;
use crate::file_paths;

/// Pixels of a PNG per pixel of the SVG, along each side.
#[cfg(feature = "full")]
const SCALE: f32 = 2.0;

/// Format of the file of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Format {
    Svg,
    Png,
}

impl Format {
    /// The format that belongs to a file's ending.
    pub(crate) fn of(path: &Path) -> Result<Self, CliError> {
        let format =
            file_paths::format_of(path, "picture", &[("svg", Self::Svg), ("png", Self::Png)])?;
        if format == Self::Png && !cfg!(feature = "full") {
            return Err(CliError::Usage(palpate_io::not_built("pictures as PNG")));
        }
        Ok(format)
    }

    /// Writes a picture that was drawn as SVG, whole or not at all.
    pub(crate) fn write(self, path: &Path, svg: &str) -> Result<(), CliError> {
        match self {
            Self::Svg => file_paths::write(path, svg),
            #[cfg(feature = "full")]
            Self::Png => file_paths::write(path, &png(svg)?),
            #[cfg(not(feature = "full"))]
            Self::Png => Err(palpate_io::not_built("pictures as PNG").into()),
        }
    }
}

/// An SVG as PNG.
#[cfg(feature = "full")]
fn png(svg: &str) -> Result<Vec<u8>, String> {
    use resvg::tiny_skia::{Pixmap, Transform};
    use resvg::usvg::fontdb::Database;
    use resvg::usvg::{Options, Tree};

    let broken = |why: String| format!("the picture cannot be turned into a PNG: {why}");
    let mut fonts = Database::new();
    fonts.load_font_data(notosans::REGULAR_TTF.to_vec());
    fonts.set_sans_serif_family("Noto Sans");
    let options = Options { fontdb: fonts.into(), ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|error| broken(error.to_string()))?;
    let size = tree.size().to_int_size().scale_by(SCALE);
    let pixels = size.and_then(|size| Pixmap::new(size.width(), size.height()));
    let mut pixels = pixels.ok_or_else(|| broken("it has no size".to_owned()))?;
    resvg::render(&tree, Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| broken(error.to_string()))
}

#[cfg(test)]
#[cfg(feature = "full")]
mod tests {
    use resvg::tiny_skia::Pixmap;

    use super::*;

    /// Size of a picture, and its number of dark pixels.
    fn looked_at(png: &[u8]) -> ((u32, u32), usize) {
        let pixels = Pixmap::decode_png(png).unwrap();
        let dark = pixels.pixels().iter().filter(|pixel| pixel.red() < 100).count();
        ((pixels.width(), pixels.height()), dark)
    }

    #[test]
    fn the_ending_selects_the_format() {
        let of = |name: &str| Format::of(Path::new(name));
        assert_eq!(of("a/field.svg").unwrap(), Format::Svg);
        assert_eq!(of("FIELD.PNG").unwrap(), Format::Png);
        for name in ["field.jpg", "field", ".png"] {
            let error = of(name).unwrap_err().to_string();
            assert!(error.contains(".svg") && error.contains(".png") && error.contains(name));
        }
    }

    #[test]
    fn a_png_has_twice_the_size_and_its_letters() {
        let svg = |text: &str| {
            format!(
                "<svg width=\"300\" height=\"60\" viewBox=\"0 0 300 60\" \
                 xmlns=\"http://www.w3.org/2000/svg\"><rect width=\"300\" height=\"60\" \
                 fill=\"#FFFFFF\"/><text x=\"10\" y=\"40\" font-family=\"sans-serif\" \
                 font-size=\"24\">{text}</text></svg>"
            )
        };
        let (size, blank) = looked_at(&png(&svg("")).unwrap());
        assert_eq!((size, blank), ((600, 120), 0));
        // Each letter beyond ASCII in our pictures has a glyph: a missing one would look like
        // U+E123, which no font has.
        let ink = |letter: char| looked_at(&png(&svg(&letter.to_string())).unwrap()).1;
        let missing = ink('\u{e123}');
        for letter in ['K', 'τ', '|', '·', '≥', '−', '²', 'ä'] {
            assert!(ink(letter) > 20 && ink(letter) != missing, "{letter}");
        }
    }

    #[test]
    fn the_pixels_of_fig_4_come_through_and_its_letters_stand_on_them() {
        let example = crate::extrapolation_view::tests::Example::new(2, 3_000);
        let svg = crate::picture::fig4(&example.seen(), None).unwrap();
        let without = svg.replace("<text", "<desc").replace("</text", "</desc");
        let empty: String = without.lines().filter(|line| !line.starts_with("<image")).collect();
        let pictures = [&svg, &without, &empty].map(|svg| png(svg).unwrap());
        let [(size, all), (_, no_letters), (_, no_pixels)] =
            pictures.each_ref().map(|png| looked_at(png));
        let attribute = |name: &str| -> u32 {
            let (_, rest) = svg.split_once(name).unwrap();
            rest.split('"').nth(1).unwrap().parse().unwrap()
        };
        assert_eq!(size, (2 * attribute(" width="), 2 * attribute(" height=")));
        assert!(all > no_letters + 1_000, "{all} and {no_letters}");
        assert!(no_letters > no_pixels + 10_000, "{no_letters} and {no_pixels}");
        assert_eq!(pictures[0], png(&svg).unwrap(), "the same each time");
    }

    #[test]
    fn a_text_that_is_no_picture_is_an_error() {
        assert!(png("no picture").unwrap_err().starts_with("the picture cannot be turned"));
    }
}
