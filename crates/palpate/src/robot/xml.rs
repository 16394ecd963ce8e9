//! Nesting depth of XML: parsers of robot descriptions recurse once for each level.

/// Whether more than `limit` elements are open at once somewhere in an XML text.
///
/// To be called before a recursive parser, whose stack a malicious file could exhaust.
///
/// Where the text is not well-formed the count may be wrong, but there the parser stops as well.
pub fn nests_deeper_than(text: &str, limit: usize) -> bool {
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
        if depth > limit {
            return true;
        }
    }
    false
}

/// Position of the `>` of a tag, which is not within quotes.
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
    fn depth_counts_open_elements_whatever_stands_in_quotes_and_comments() {
        for level in ["<node>", "<node a='/>'>", "<a b=\"/>\"><!-- </a> --><![CDATA[</a>]]>"] {
            assert!(nests_deeper_than(&level.repeat(300), 256), "{level}");
            assert!(!nests_deeper_than(&level.repeat(256), 256), "{level}");
        }
        let flat = "<b c='/>'/><b>x</b><!-- <b> --><![CDATA[<b>]]>".repeat(2_000);
        assert!(!nests_deeper_than(&flat, 1));
    }
}
