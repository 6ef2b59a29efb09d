//! What the parsers of ROS read and XML does not permit: prefixes that a file uses and does not declare
//! (`<gazebo:plugin ..>`), and hyphens in comments (`<!-- -- arm -- -->`). Nothing that a calibration reads stands there, so
//! such a file is read all the same. And the semantic description (SRDF) beside a URDF.

use std::borrow::Cow;

use super::super::error::RobotFileError;

/// Most prefixes that are put right.
const MOST_PREFIXES: usize = 16;

/// A text of the same length that the parser reads: undeclared prefixes `a:b` become `a_b`, and hyphens in comments blanks.
/// The text itself where nothing needs it, or where something else is wrong with it.
pub(super) fn readable<'t>(text: &'t str, notes: &mut Vec<String>) -> Cow<'t, str> {
    let mut readable = comments(text);
    let mut names: Vec<String> = Vec::new();
    // Each pass finds one prefix.
    for _ in 0..MOST_PREFIXES {
        match roxmltree::Document::parse_with_options(&readable, super::parsing()) {
            Err(roxmltree::Error::UnknownNamespace(prefix, _)) => {
                readable = Cow::Owned(without(&readable, &prefix));
                names.push(prefix);
            }
            _ => break,
        }
    }
    if !names.is_empty() {
        notes.push(format!(
            "the XML prefix {} is not declared: what stands under it is not read",
            names.join(", ")
        ));
    }
    readable
}

/// The text with blanks for the hyphens of comments that hold two in a row, or end with one.
fn comments(text: &str) -> Cow<'_, str> {
    let mut out = Cow::Borrowed(text);
    let mut at = 0;
    while let Some(start) = text.get(at..).and_then(|rest| rest.find("<!--")).map(|k| at + k + 4) {
        let Some(inside) = text
            .get(start..)
            .and_then(|rest| rest.split_once("-->"))
            .map(|pair| pair.0)
        else {
            break;
        };
        at = start + inside.len() + 3;
        if inside.contains("--") || inside.ends_with('-') {
            out.to_mut()
                .replace_range(start..start + inside.len(), &inside.replace('-', " "));
        }
    }
    out
}

/// The text with `prefix:` as `prefix_` wherever a name may begin.
fn without(text: &str, prefix: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut rest = text;
    let found = format!("{prefix}:");
    while let Some(at) = rest.find(&found) {
        let (before, behind) = rest.split_at(at);
        out.push_str(before);
        let begins = out.ends_with(|c: char| c == '<' || c == '/' || c.is_whitespace());
        out.push_str(prefix);
        out.push(if begins { '_' } else { ':' });
        rest = behind.get(found.len()..).unwrap_or_default();
    }
    out + rest
}

/// The chains and end effectors of an SRDF.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Srdf {
    /// Tip links of its chains, each with the name of its group.
    pub(super) chains: Vec<(String, String)>,
    /// Links that carry an end effector.
    pub(super) parents: Vec<String>,
    /// Groups that are end effectors.
    pub(super) effectors: Vec<String>,
}

impl Srdf {
    /// Reads an SRDF; `path` is for messages.
    ///
    /// # Errors
    /// Text that is not XML.
    pub(in super::super) fn parse(path: &str, text: &str) -> Result<Self, RobotFileError> {
        let syntax = |message: String| RobotFileError::Syntax {
            path: path.to_owned(),
            message,
        };
        super::bounds::check(text)
            .map_err(|e| syntax(format!("line {}: holds more than {} {}", e.line, e.limit, e.what)))?;
        let document = roxmltree::Document::parse_with_options(text, super::parsing())
            .map_err(|e| syntax(super::xml_words(&e)))?;
        let mut own = Self::default();
        let word = |node: roxmltree::Node<'_, '_>, name: &str| node.attribute(name).unwrap_or_default().to_owned();
        for node in document.root_element().children() {
            if node.has_tag_name("group") {
                for chain in node.children().filter(|n| n.has_tag_name("chain")) {
                    own.chains.push((word(node, "name"), word(chain, "tip_link")));
                }
            } else if node.has_tag_name("end_effector") {
                own.parents.push(word(node, "parent_link"));
                own.effectors.push(word(node, "group"));
            }
        }
        Ok(own)
    }
}
