//! XML from anywhere: `roxmltree` recurses once a level, so depth is bounded before it is asked.

use roxmltree::Document;

/// No file of a robot nests deeper.
const MAX_DEPTH: usize = 256;

/// Parses a document. An error is half a sentence for the user.
pub(super) fn parse(text: &str) -> Result<Document<'_>, String> {
    if is_too_deep(text) {
        return Err(format!("is no readable XML: elements nest deeper than {MAX_DEPTH}"));
    }
    Document::parse(text).map_err(|error| format!("is no readable XML: {error}"))
}

/// Whether more than [`MAX_DEPTH`] elements are open somewhere.
///
/// Where the text is not well-formed the count may be wrong, but there the parser stops as well.
fn is_too_deep(text: &str) -> bool {
    let (mut depth, mut rest) = (0_usize, text);
    while let Some(at) = rest.find('<') {
        let tag = &rest[at + 1..];
        let skip_to = |end| tag.find(end).map_or("", |at| &tag[at..]);
        if tag.starts_with("!--") {
            rest = skip_to("-->");
        } else if tag.starts_with("![CDATA[") {
            rest = skip_to("]]>");
        } else if tag.starts_with(['!', '?']) {
            rest = skip_to(">");
        } else if tag.starts_with('/') {
            depth = depth.saturating_sub(1);
            rest = skip_to(">");
        } else {
            let (inside, after) = tag.split_at(end_of_tag(tag));
            depth += usize::from(!inside.ends_with('/'));
            rest = after;
        }
        if depth > MAX_DEPTH {
            return true;
        }
    }
    false
}

/// Where the `>` of a tag stands: not within quotes.
fn end_of_tag(tag: &str) -> usize {
    let mut quote = None;
    for (at, byte) in tag.bytes().enumerate() {
        match (quote, byte) {
            (None, b'>') => return at,
            (None, b'"' | b'\'') => quote = Some(byte),
            (Some(open), close) if open == close => quote = None,
            _ => {}
        }
    }
    tag.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deep_xml_is_refused_before_it_exhausts_the_stack() {
        for level in ["<node>", "<node a='/>'>", "<a b=\"/>\"><!-- </a> --><![CDATA[</a>]]>"] {
            let error = parse(&level.repeat(200_000)).unwrap_err();
            assert!(error.contains("nest deeper"), "{level}: {error}");
        }
    }

    #[test]
    fn shallow_xml_may_be_long() {
        let flat =
            format!("<a>{}</a>", "<b c='/>'/><b>x</b><!-- <b> --><![CDATA[<b>]]>".repeat(2_000));
        assert!(parse(&flat).is_ok());
        assert!(parse(&format!("{}{}", "<a>".repeat(200), "</a>".repeat(200))).is_ok());
    }
}
