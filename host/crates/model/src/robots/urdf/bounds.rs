//! Bounds on the XML of a URDF, checked before it is parsed.
//!
//! The parser compares every attribute of an element with all others of it, and
//! every name space with those around it: 100,000 attributes took 28 s. One pass
//! over the text refuses what no robot description needs. What is not well-formed
//! is left to the parser, which says why.

const MOST_ELEMENTS: usize = 200_000;
const MOST_ATTRIBUTES: usize = 64;
/// Most elements within each other.
const MOST_DEPTH: usize = 64;
/// Most declarations of name spaces in the whole file.
const MOST_NAMESPACES: usize = 64;

/// What is beyond a bound, on which line, with the remedy.
pub(super) fn check(text: &str) -> Result<(), TooMuch> {
    let bytes = text.as_bytes();
    let (mut elements, mut depth, mut namespaces) = (0, 0_usize, 0);
    let mut at = 0;
    let refuse = |at: usize, what: &'static str, limit: usize| {
        let line = 1 + text.get(..at).unwrap_or_default().matches('\n').count();
        Err(TooMuch { line, what, limit })
    };
    while let Some(start) = memchr::memchr(b'<', bytes.get(at..).unwrap_or_default()).map(|k| at + k) {
        let rest = text.get(start..).unwrap_or_default();
        let skip = |end: &str| rest.find(end).map_or(bytes.len(), |k| start + k + end.len());
        if rest.starts_with("<!--") {
            at = skip("-->");
            continue;
        }
        if rest.starts_with("<![CDATA[") {
            at = skip("]]>");
            continue;
        }
        if rest.starts_with("<?") {
            at = skip("?>");
            continue;
        }
        if rest.starts_with("</") {
            depth = depth.saturating_sub(1);
            at = skip(">");
            continue;
        }
        let tag = tag(bytes, start + 1);
        elements += 1;
        namespaces += tag.namespaces;
        depth += 1;
        if depth > MOST_DEPTH {
            return refuse(start, "elements within each other", MOST_DEPTH);
        }
        if tag.attributes > MOST_ATTRIBUTES {
            return refuse(start, "attributes of one element", MOST_ATTRIBUTES);
        }
        if elements > MOST_ELEMENTS {
            return refuse(start, "elements", MOST_ELEMENTS);
        }
        if namespaces > MOST_NAMESPACES {
            return refuse(start, "name spaces", MOST_NAMESPACES);
        }
        depth -= usize::from(tag.closed);
        at = tag.end;
    }
    Ok(())
}

/// More than a robot description holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TooMuch {
    pub(super) line: usize,
    pub(super) what: &'static str,
    pub(super) limit: usize,
}

struct Tag {
    attributes: usize,
    namespaces: usize,
    /// Whether it ends itself: `<a/>`.
    closed: bool,
    /// Just behind its `>`.
    end: usize,
}

/// The tag whose name starts at `from`.
fn tag(bytes: &[u8], from: usize) -> Tag {
    let mut tag = Tag {
        attributes: 0,
        namespaces: 0,
        closed: false,
        end: bytes.len(),
    };
    let mut quote = None;
    let mut word = from;
    for (at, &byte) in bytes.iter().enumerate().skip(from) {
        match (quote, byte) {
            (Some(open), _) if byte == open => quote = None,
            (Some(_), _) => {}
            (None, b'"' | b'\'') => quote = Some(byte),
            (None, b'=') => {
                tag.attributes += 1;
                tag.namespaces += usize::from(bytes.get(word..at).unwrap_or_default().starts_with(b"xmlns"));
            }
            (None, b' ' | b'\t' | b'\r' | b'\n') => word = at + 1,
            (None, b'>') => {
                tag.closed = bytes.get(at.wrapping_sub(1)) == Some(&b'/');
                tag.end = at + 1;
                return tag;
            }
            _ => {}
        }
    }
    tag
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(text: &str) -> Option<(usize, &'static str)> {
        check(text).err().map(|e| (e.line, e.what))
    }

    #[test]
    fn what_no_robot_needs_is_refused() {
        let attributes: String = (0..100).map(|k| format!(" a{k}=\"<'{k}>\"")).collect();
        assert_eq!(
            refused(&format!("<robot>\n<link{attributes}/></robot>")),
            Some((2, "attributes of one element"))
        );
        assert_eq!(refused(&"<a>".repeat(65)), Some((1, "elements within each other")));
        assert_eq!(refused(&"<a>\n".repeat(64)), None);
        assert_eq!(refused(&"<a/>".repeat(200_001)), Some((1, "elements")));
        let spaces: String = (0..30).map(|k| format!(" xmlns:n{k}='x'")).collect();
        assert_eq!(
            refused(&format!("<robot><a{spaces}/>\n<b{spaces}/><c{spaces}/></robot>")),
            Some((2, "name spaces"))
        );
    }

    #[test]
    fn comments_quotes_and_broken_text_do_not_count() {
        assert_eq!(refused(&format!("<robot><!-- {} --></robot>", "<a>".repeat(100))), None);
        assert_eq!(
            refused(&format!("<robot><![CDATA[{}]]></robot>", "<a>".repeat(100))),
            None
        );
        assert_eq!(refused(&format!("<robot a='{}'/>", "=<a>".repeat(100))), None);
        for broken in ["<", "<!--", "<a", "<a b=\"", "</", "<?x", "", "<a b='>", ">"] {
            assert_eq!(refused(broken), None, "{broken}");
        }
        assert_eq!(refused(&"<a></a>".repeat(1000)), None);
    }
}
