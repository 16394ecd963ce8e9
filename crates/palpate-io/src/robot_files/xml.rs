//! Parses XML of unknown origin: `roxmltree` recurses once for each level, so the depth is checked
//! first.

use palpate::unstable::nests_deeper_than;
use roxmltree::Document;

/// Deepest nesting of elements; a deeper document is refused.
const MAX_DEPTH: usize = 256;

/// Parses a document. The error is the end of a message to the user.
pub(super) fn parse(text: &str) -> Result<Document<'_>, String> {
    if nests_deeper_than(text, MAX_DEPTH) {
        return Err(format!("is not readable XML: elements nest deeper than {MAX_DEPTH}"));
    }
    Document::parse(text).map_err(|error| format!("is not readable XML: {error}"))
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
