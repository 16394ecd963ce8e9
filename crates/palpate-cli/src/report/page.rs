//! The page around the figures: slots of a template, and text that is safe in HTML.

use std::fmt::Write;

use plotly::Plot;

/// A page, one HTML file.
pub(super) struct Page<'a> {
    pub(super) title: &'a str,
    /// What was found, as one sentence without its full stop.
    pub(super) verdict: &'a str,
    /// Whether the touches come from a simulator, which the page then says.
    pub(super) simulated: bool,
    /// Figures and tables, as HTML.
    pub(super) body: String,
    /// Where the data come from; a name and a text each.
    pub(super) card: Vec<(&'static str, String)>,
    /// What the settings are called, and they, as TOML.
    pub(super) settings: (&'static str, &'a str),
    /// What is drawn, as JSON that may stand in a script element.
    pub(super) data: String,
    /// What draws it, after `shared.js`.
    pub(super) script: &'static str,
}

impl Page<'_> {
    pub(super) fn html(self) -> String {
        let simulated = if self.simulated { "<p>The touches are simulated.</p>" } else { "" };
        let mut entries = self.card;
        entries.push(("palpate", env!("CARGO_PKG_VERSION").to_owned()));
        entries.push(("plotly.js", plotly_version()));
        let slots = [
            ("title", escaped(self.title)),
            ("style", include_str!("report.css").to_owned()),
            ("verdict", escaped(self.verdict)),
            ("simulated", simulated.to_owned()),
            ("body", self.body),
            ("card", card(&entries)),
            ("settings-title", self.settings.0.to_owned()),
            ("settings", escaped(self.settings.1)),
            ("plotly", plotly_js()),
            ("data", self.data),
            ("script", [include_str!("shared.js"), self.script].concat()),
        ];
        fill(include_str!("page.html"), &slots)
    }
}

/// Fills the slots `{{name}}` of a template.
///
/// What is filled in is never searched for slots.
///
/// # Panics
///
/// If the template has a slot without a filling, or half a slot: both are ours.
pub(super) fn fill(template: &str, slots: &[(&str, String)]) -> String {
    let mut page = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        let (name, after) = after.split_once("}}").expect("a slot of the template is closed");
        let slot = slots.iter().find(|(slot, _)| *slot == name);
        let (_, text) = slot.expect("every slot of the template has a filling");
        page += before;
        page += text;
        rest = after;
    }
    page + rest
}

/// Text as HTML shows it, in elements and in quoted attributes.
pub(super) fn escaped(text: &str) -> String {
    let mut html = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => html += "&amp;",
            '<' => html += "&lt;",
            '>' => html += "&gt;",
            '"' => html += "&quot;",
            '\'' => html += "&#39;",
            _ => html.push(letter),
        }
    }
    html
}

/// Names and what belongs to them.
fn card(entries: &[(&str, String)]) -> String {
    entries.iter().fold(String::new(), |mut html, (name, text)| {
        let _ = writeln!(html, "<dt>{}</dt><dd>{}</dd>", escaped(name), escaped(text));
        html
    })
}

/// plotly.js in its script element.
///
/// The crate hands out MathJax behind it, 2 MB that a page without formulas does not need.
fn plotly_js() -> String {
    let mut sources = Plot::offline_js_sources();
    let end = "</script>";
    if let Some(at) = sources.find(end) {
        sources.truncate(at + end.len());
    }
    sources
}

/// The version that plotly.js gives itself at its head.
fn plotly_version() -> String {
    let source = plotly_js();
    let version = source.split_once("plotly.js v").and_then(|(_, rest)| rest.lines().next());
    version.unwrap_or("of the plotly crate").to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filling_is_not_searched_for_slots() {
        let slots = [("a", "{{b}}".to_owned()), ("b", "2".to_owned())];
        assert_eq!(fill("<{{a}}|{{b}}>", &slots), "<{{b}}|2>");
    }

    #[test]
    fn names_cannot_break_out_of_the_page() {
        assert_eq!(escaped("<b a=\"'\">&"), "&lt;b a=&quot;&#39;&quot;&gt;&amp;");
        assert_eq!(card(&[("robot", "a<b".to_owned())]), "<dt>robot</dt><dd>a&lt;b</dd>\n");
    }

    #[test]
    fn plotly_comes_alone_and_with_a_version() {
        let source = plotly_js();
        assert_eq!(source.matches("<script").count(), source.matches("</script>").count());
        assert!(source.len() < 5_000_000, "{} bytes", source.len());
        assert!(plotly_version().starts_with(|first: char| first.is_ascii_digit()));
    }
}
