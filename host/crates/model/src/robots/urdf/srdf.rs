//! The semantic description (SRDF) beside a URDF, as far as it says where an arm ends.

use super::super::error::RobotFileError;

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
