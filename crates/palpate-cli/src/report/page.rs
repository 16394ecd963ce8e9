//! The page around the figures.

use plotly::Plot;

/// Content of every page besides its figures.
pub(crate) struct Page<'a> {
    pub(crate) title: &'a str,
    /// Whether the touches come from a simulator; the page then says so.
    pub(crate) simulated: bool,
    /// Origin of the data, such as logs and robot: name and text of each entry.
    pub(crate) card: Vec<(&'static str, String)>,
    /// The settings, as TOML.
    pub(crate) settings_toml: &'a str,
}

impl Page<'_> {
    /// The script element with plotly.js.
    ///
    /// The crate appends MathJax, which is cut off: 2 MB that a page without formulas does not
    /// need.
    pub(super) fn plotly_js() -> String {
        let mut sources = Plot::offline_js_sources();
        let end = "</script>";
        if let Some(at) = sources.find(end) {
            sources.truncate(at + end.len());
        }
        sources
    }

    /// The version of plotly.js, from the comment at its start.
    pub(super) fn plotly_version() -> String {
        let source = Self::plotly_js();
        let version = source.split_once("plotly.js v").and_then(|(_, rest)| rest.lines().next());
        version.unwrap_or("of the plotly crate").to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    pub(super) fn plotly_comes_alone_and_with_a_version() {
        let source = Page::plotly_js();
        assert_eq!(source.matches("<script").count(), source.matches("</script>").count());
        assert!(source.len() < 5_000_000, "{} bytes", source.len());
        assert!(Page::plotly_version().starts_with(|first: char| first.is_ascii_digit()));
    }
}
