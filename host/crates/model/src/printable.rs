//! Text from outside, made safe to print.
//!
//! A file, a name in a database or a message of another machine may hold control
//! characters. A terminal that receives them can clear its screen, change its
//! title or print words that look like ours. Everything that comes from outside
//! passes through [`printable`] before it is printed.

use std::borrow::Cow;
use std::fmt::Write as _;

/// Longest excerpt of a foreign value in a message, in characters.
const EXCERPT: usize = 60;

/// Whether a character can act on a terminal or hide in a text instead of being read.
///
/// True for control characters (C0, DEL and C1, the line feed included), for the
/// characters that change the direction of writing, for those without any width,
/// and for Unicode's line separators.
fn acts(letter: char) -> bool {
    letter.is_control()
        || matches!(
            letter,
            '\u{ad}'
                | '\u{61c}'
                | '\u{180e}'
                | '\u{200b}'..='\u{200f}'
                | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}'
                | '\u{feff}'
                | '\u{fff9}'..='\u{fffb}'
                | '\u{e0000}'..='\u{e007f}'
        )
}

fn escape(text: &str, keep: impl Fn(char) -> bool) -> Cow<'_, str> {
    let bad = |letter: char| acts(letter) && !keep(letter);
    if !text.contains(bad) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for letter in text.chars() {
        if !bad(letter) {
            out.push(letter);
            continue;
        }
        match letter {
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            '\t' => out.push_str("\\t"),
            _ => {
                for unit in letter.encode_utf16(&mut [0; 2]) {
                    let _ = write!(out, "\\u{unit:04x}");
                }
            }
        }
    }
    Cow::Owned(out)
}

/// One line of foreign text: every character that could act on a terminal is
/// replaced by its JSON escape (`\u001b` for ESC).
///
/// ```
/// use spherecal_model::printable;
/// assert_eq!(printable("arm \u{1b}[2J"), "arm \\u001b[2J");
/// assert_eq!(printable("größer"), "größer");
/// ```
pub fn printable(text: &str) -> Cow<'_, str> {
    escape(text, |_| false)
}

/// The same for text of several lines: line feeds and tabs stay.
///
/// A JSON document stays the same document, because it holds these characters
/// within strings only, where their escapes mean the same.
///
/// ```
/// use spherecal_model::printable_lines;
/// assert_eq!(printable_lines("a\n\u{9b}b"), "a\n\\u009bb");
/// ```
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    escape(text, |letter| matches!(letter, '\n' | '\t'))
}

/// The beginning of a foreign value, printable, for a message: at most 60 characters.
///
/// ```
/// use spherecal_model::excerpt;
/// assert_eq!(excerpt("0,5\n"), "0,5\\n");
/// assert_eq!(excerpt(&"9".repeat(100)).chars().count(), 61);
/// ```
pub fn excerpt(text: &str) -> String {
    match text.char_indices().nth(EXCERPT) {
        None => printable(text).into_owned(),
        Some((end, _)) => printable(text.get(..end).unwrap_or_default()).into_owned() + "…",
    }
}

/// Name of a unit variant as serde writes it (`joint_position`); "?" for any other value.
pub fn name_of(value: impl serde::Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::from("?"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Fails if any character that acts on a terminal is left in the text.
        #[test]
        fn nothing_printable_acts(text in "(?s).{0,40}", wild in proptest::collection::vec(any::<char>(), 0..20)) {
            let text = text + &wild.into_iter().collect::<String>();
            prop_assert!(!printable(&text).contains(acts));
            prop_assert!(!printable_lines(&text).contains(|c: char| acts(c) && c != '\n' && c != '\t'));
            prop_assert!(!excerpt(&text).contains(acts));
        }

        /// Fails if a JSON document means something else after its characters were escaped.
        #[test]
        fn a_json_document_keeps_its_meaning(text in proptest::collection::vec(any::<char>(), 0..40)) {
            let text: String = text.into_iter().collect();
            let document = serde_json::json!({ "name": text });
            let shown = printable_lines(&format!("{document:#}")).into_owned();
            prop_assert_eq!(serde_json::from_str::<serde_json::Value>(&shown).unwrap(), document);
        }
    }

    #[test]
    fn escapes_of_terminals_are_shown() {
        for (text, shown) in [
            ("\u{1b}]0;title\u{7}", "\\u001b]0;title\\u0007"),
            ("a\u{202e}b", "a\\u202eb"),
            ("\u{7f}\u{e0041}", "\\u007f\\udb40\\udc41"),
            ("two\nlines\tand\r", "two\\nlines\\tand\\r"),
        ] {
            assert_eq!(printable(text), shown);
        }
    }
}
