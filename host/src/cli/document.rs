//! Prints the configuration with the description of every field.
//!
//! The descriptions are the fields' own doc comments. They are read from the compiled sources, so
//! they always agree with the program's documentation. A field without a comment fails a test.

use schemars::SchemaGenerator;
use serde::Serialize;
use serde_json::Value;
use spherecal_job::{Config, ConfigError, JobError};
use spherecal_sim::plant::PlantConfig;
use toml::Table;

use crate::simulated::plant;

const PLANT: &str = "The simulated arm: the name of a `preset` (default: `as_measured`), and the errors that differ from it. \
                     A real arm does not use this section.";

/// Width of wrapped comments, in characters.
const WIDTH: usize = 100;

/// The plant's section with every field, instead of the preset's name.
#[derive(Serialize)]
struct WholePlant {
    plant: PlantConfig,
}

/// The whole tree as TOML, with every field and its description. Fields that are left out by default appear as comments.
/// Errors: an impossible plant.
pub(super) fn documented(config: &Config) -> Result<String, JobError> {
    let encode = |message: String| ConfigError::Syntax {
        path: "configuration".to_owned(),
        message,
    };
    let without_plant = Config {
        plant: Table::new(),
        ..config.clone()
    };
    let plant = WholePlant { plant: plant(config)? };
    let mut text = without_plant.to_toml()?;
    text.push('\n');
    let plant = toml::to_string(&plant).map_err(|e| encode(e.to_string()))?;
    // The plant's seed is the run's, unless the user set one for the plant.
    let shown = |line: &&str| config.plant.contains_key("seed") || !line.starts_with("seed = ");
    for line in plant.lines().filter(shown) {
        text.push_str(line);
        text.push('\n');
    }
    let table: Table = toml::from_str(&text).map_err(|e| encode(e.to_string()))?;
    let schema = schema();
    let mut out = String::from(
        "# Configuration of spherecal. A field that is left out has the value that\n\
         # `spherecal config --print` shows. SI units unless the name says otherwise.\n\n",
    );
    let root = SchemaNode {
        schema: &schema,
        root: &schema,
    };
    describe(&mut out, &text, &table, root);
    Ok(out)
}

/// The schema of the configuration, with that of the simulated arm in its place.
fn schema() -> Value {
    let mut generator = SchemaGenerator::default();
    let mut plant = generator.subschema_for::<PlantConfig>().to_value();
    plant["description"] = PLANT.into();
    let mut schema = generator.into_root_schema_for::<Config>().to_value();
    schema["properties"]["plant"] = plant;
    schema
}

/// A part of the schema: one type or one field.
#[derive(Clone, Copy)]
struct SchemaNode<'a> {
    schema: &'a Value,
    root: &'a Value,
}

impl<'a> SchemaNode<'a> {
    fn with(self, schema: &'a Value) -> Self {
        Self { schema, ..self }
    }

    /// The type behind references and options; for a list, the type of its elements.
    fn resolved(self) -> Self {
        let mut node = self;
        // A schema of our own types has only a few levels; the limit ends a cycle.
        for _ in 0..16 {
            let schema = node.schema;
            if let Some(path) = schema.get("$ref").and_then(Value::as_str) {
                let Some(target) = path.strip_prefix('#').and_then(|p| node.root.pointer(p)) else {
                    return node;
                };
                node = node.with(target);
            } else if let Some(variants) = schema.get("anyOf").and_then(Value::as_array) {
                let real = variants.iter().find(|v| v["type"] != "null");
                let Some(real) = real else { return node };
                node = node.with(real);
            } else if let Some(element) = schema.get("items") {
                node = node.with(element);
            } else {
                return node;
            }
        }
        node
    }

    /// A field of this type, by name. In a free table (parameters by name), any field.
    fn field(self, name: &str) -> Option<Self> {
        let node = self.resolved();
        let schema = node.schema;
        let named = schema.get("properties").and_then(|p| p.get(name));
        let any = schema.get("additionalProperties").filter(|any| any.is_object());
        named.or(any).map(|schema| node.with(schema))
    }

    /// Names of the fields of this type.
    fn names(self) -> impl Iterator<Item = &'a String> {
        let properties = self.resolved().schema.get("properties").and_then(Value::as_object);
        properties.into_iter().flat_map(|p| p.keys())
    }

    /// The names that a value of this type may have; none where it is not a choice.
    fn choices(self) -> impl Iterator<Item = &'a str> {
        let schema = self.resolved().schema;
        let list = |of: &'a Value, key| of.get(key).and_then(Value::as_array).into_iter().flatten();
        // A variant with a doc comment has a schema of its own; the others share one.
        list(schema, "oneOf")
            .chain([schema])
            .flat_map(move |variant| variant.get("const").into_iter().chain(list(variant, "enum")))
            .filter_map(Value::as_str)
    }

    /// What the field is, in the words of its doc comment, and the names that it may have where it is a choice.
    fn words(self) -> String {
        let words = self
            .schema
            .get("description")
            .and_then(Value::as_str)
            .unwrap_or_default();
        let mut words = words.replace("[`", "`").replace("`]", "`").replace("`Self::", "`");
        let choices: Vec<String> = self.choices().map(|name| format!("\"{name}\"")).collect();
        if !choices.is_empty() {
            words.push_str(&format!(" One of {}.", choices.join(", ")));
        }
        words
    }
}

/// Writes `text` with a description above each line. `table` is the same as `text`, parsed.
fn describe(out: &mut String, text: &str, table: &Table, root: SchemaNode<'_>) {
    let mut section = Some(root);
    let mut present = Some(table);
    for line in text.lines() {
        if line.starts_with('[') {
            left_out(out, section, present);
            let path = header(line);
            section = path.iter().try_fold(root, |node, name| node.field(name));
            present = path.iter().try_fold(table, |table, name| match table.get(name) {
                Some(toml::Value::Table(inner)) => Some(inner),
                // All tables of a list have the same fields.
                Some(toml::Value::Array(list)) => list.first().and_then(toml::Value::as_table),
                _ => None,
            });
            out.push('\n');
            comment(out, &section.map(SchemaNode::words).unwrap_or_default());
            out.push_str(line);
            out.push('\n');
        } else if let Some((name, _)) = line.split_once(" = ") {
            let field = section.and_then(|s| s.field(name.trim_matches('"')));
            comment(out, &field.map(SchemaNode::words).unwrap_or_default());
            out.push_str(line);
            out.push('\n');
        }
    }
    left_out(out, section, present);
}

/// The names in a header such as `[identify.parameters."theta 1"]`.
fn header(line: &str) -> Vec<String> {
    let mut path = Vec::new();
    let mut table: Table = toml::from_str(line).unwrap_or_default();
    while let Some((name, value)) = table.into_iter().next() {
        path.push(name);
        table = match value {
            toml::Value::Table(inner) => inner,
            toml::Value::Array(list) => list.into_iter().find_map(|v| v.try_into().ok()).unwrap_or_default(),
            _ => Table::new(),
        };
    }
    path
}

/// Writes the fields of a section that have no value, as comments.
fn left_out(out: &mut String, section: Option<SchemaNode<'_>>, present: Option<&Table>) {
    let Some(section) = section else { return };
    for name in section.names() {
        let absent = present.is_none_or(|table| !table.contains_key(name));
        // The plant's seed is the run's, and is not printed twice.
        if absent && let Some(field) = section.field(name) {
            comment(out, &field.words());
            out.push_str(&format!("# {name} = (left out)\n"));
        }
    }
}

fn comment(out: &mut String, words: &str) {
    let mut line = String::from("#");
    for word in words.split_whitespace() {
        if line.len() + 1 + word.len() > WIDTH {
            out.push_str(&line);
            out.push('\n');
            line = String::from("#");
        }
        line.push(' ');
        line.push_str(word);
    }
    if line.len() > 1 {
        out.push_str(&line);
        out.push('\n');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a field is printed without a description, is lost, or gets another value when the
    // printed text is read.
    #[test]
    fn every_field_is_described_and_reads_back() {
        let config = Config::default();
        let text = documented(&config).expect("encodes");
        let mut before = "";
        let mut fields = 0;
        for line in text.lines() {
            let value = line.trim_start_matches("# ");
            if value.contains(" = ") && (!line.starts_with('#') || line.ends_with("(left out)")) {
                fields += 1;
                assert!(before.starts_with("# "), "undescribed: {line}");
            }
            before = line;
        }
        assert!(fields > 150, "{fields} fields");
        let read: Config = toml::from_str(&text).expect("parses");
        assert_eq!(plant(&read).expect("plant"), plant(&config).expect("plant"));
        let mut read = read;
        read.plant = config.plant.clone();
        assert_eq!(read, config);
    }

    // Fails if a choice does not say what it may be.
    #[test]
    fn choices_are_listed() {
        let text = documented(&Config::default()).expect("encodes");
        for choices in [
            "One of \"optimal\", \"grid\".\nchoice = \"optimal\"",
            "One of \"motor\", \"link\".\nside = \"motor\"",
            "One of \"norm\", \"vector\".\npairs = \"norm\"",
        ] {
            assert!(text.contains(choices), "{choices} in {text}");
        }
    }

    // Fails if a user's value is printed as the default, or if a name that TOML requires to be
    // quoted is not.
    #[test]
    fn what_was_set_is_printed() {
        let text = "seed = 9\n[cell.tool]\ntcp_mm = [1.0, 2.0, 3.0]\n[plan]\npatience = 0.5\n\
                    [identify.parameters.\"odd name\"]\nprior_sigma = 5e-5\n[plant]\npreset = \"ideal\"\nseed = 4\n";
        let config: Config = toml::from_str(text).expect("parses");
        let printed = documented(&config).expect("encodes");
        let read: Config = toml::from_str(&printed).expect("reads");
        assert_eq!(plant(&read).expect("plant"), plant(&config).expect("plant"));
        assert_eq!((read.seed, &read.cell, &read.plan), (9, &config.cell, &config.plan));
        assert_eq!(read.identify, config.identify);
    }
}
