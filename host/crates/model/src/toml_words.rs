//! What is wrong with a TOML text, in words for people.
//!
//! The TOML reader speaks of sequences, maps and f64; a user wrote a list, a table
//! or a number.

use serde::de::DeserializeOwned;

use crate::printable;

/// Why a text is not the TOML of what it should describe.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub struct TomlError {
    /// Line, from 1, where it is known.
    pub line: Option<usize>,
    /// What is wrong there; printable.
    pub words: String,
}

impl std::fmt::Display for TomlError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.line {
            Some(line) => write!(f, "line {line}: {}", self.words),
            None => f.write_str(&self.words),
        }
    }
}

/// Reads TOML text as a `T`.
///
/// # Errors
/// What is wrong with the text and on which line.
pub fn read_toml<T: DeserializeOwned>(text: &str) -> Result<T, TomlError> {
    toml::from_str(text).map_err(|error: toml::de::Error| TomlError {
        line: error
            .span()
            .map(|span| 1 + text.get(..span.start).unwrap_or_default().matches('\n').count()),
        words: printable(&plain(error.message())).into_owned(),
    })
}

fn plain(message: &str) -> String {
    let message = message.lines().next().unwrap_or_default();
    if let Some(rest) = message.strip_prefix("missing field ") {
        return format!("{rest} is missing");
    }
    if let Some((field, known)) = message
        .strip_prefix("unknown field ")
        .and_then(|rest| rest.split_once(", "))
    {
        let known = known
            .strip_prefix("expected one of ")
            .or_else(|| known.strip_prefix("expected "));
        return match known {
            Some(known) => format!("{field} is not known here: remove or rename it; known are {known}"),
            None => format!("{field} is not known here: remove it"),
        };
    }
    for start in ["invalid type: ", "invalid value: ", "invalid length "] {
        if let Some((found, expected)) = message
            .strip_prefix(start)
            .and_then(|rest| rest.split_once(", expected "))
        {
            return format!("found {}, expected {}", noun(found), wanted(expected));
        }
    }
    message.to_owned()
}

fn noun(found: &str) -> String {
    for (start, words) in [
        ("floating point `", "the number "),
        ("integer `", "the number "),
        ("boolean `", ""),
        ("string \"", "the text \""),
    ] {
        if let Some(rest) = found.strip_prefix(start) {
            return format!("{words}{}", rest.trim_end_matches('`'));
        }
    }
    match found {
        "sequence" => "a list".to_owned(),
        "map" => "a table".to_owned(),
        _ => found.to_owned(),
    }
}

fn wanted(expected: &str) -> String {
    match expected {
        "f64" | "f32" => "a number".to_owned(),
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more".to_owned(),
        "i32" | "i64" => "a whole number".to_owned(),
        "a string" => "a text in quotes".to_owned(),
        "a boolean" => "true or false".to_owned(),
        "a sequence" => "a list".to_owned(),
        "a map" => "a table".to_owned(),
        _ if expected.starts_with("struct ") => "a table".to_owned(),
        _ => expected
            .replace("an array of length", "a list of length")
            .replace("a sequence", "a list"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "only the refusals are looked at")]
    struct Plate {
        id: u32,
        x_mm: f64,
        #[serde(default)]
        list: [f64; 3],
        name: Option<String>,
    }

    #[test]
    fn complaints_are_in_words_and_name_the_line() {
        for (text, words) in [
            ("id = 1\n", "`x_mm` is missing"),
            (
                "id = 1\nx = 2\n",
                "line 2: `x` is not known here: remove or rename it; known are `id`, `x_mm`, `list`, `name`",
            ),
            (
                "id = 1\nx_mm = \"two\"\n",
                "line 2: found the text \"two\", expected a number",
            ),
            (
                "id = 1.5\nx_mm = 2\n",
                "line 1: found the number 1.5, expected a whole number, 0 or more",
            ),
            (
                "id = -1\nx_mm = 2\n",
                "line 1: found the number -1, expected a whole number, 0 or more",
            ),
            (
                "id = 1\nx_mm = 2.0\nname = 7\n",
                "line 3: found the number 7, expected a text in quotes",
            ),
            ("id = 1\nid = 2\n", "line 2: duplicate key"),
            ("id = 1\nx_mm = [1]\n", "line 2: found a list, expected a number"),
            ("[[id]]\n", "found a list, expected a whole number, 0 or more"),
        ] {
            let found = read_toml::<Plate>(text).unwrap_err().to_string();
            assert!(found.contains(words), "{text:?}: {found}");
        }
    }

    #[test]
    fn names_are_escaped() {
        let found = read_toml::<Plate>("id = 1\n\"\\u001b[2J\" = 2\n")
            .unwrap_err()
            .to_string();
        assert!(found.contains("\\u001b[2J") && !found.contains('\u{1b}'), "{found}");
    }
}
