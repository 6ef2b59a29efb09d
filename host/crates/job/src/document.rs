//! Prints the configuration with the description of every field.
//!
//! The descriptions are the fields' own doc comments. They are read from the compiled sources, so
//! they always agree with the program's documentation. A field without a comment fails a test.

use std::collections::BTreeMap;

use super::{Config, ConfigError};

/// The sources that define the configuration's structs.
const SOURCES: [&str; 12] = [
    include_str!("config.rs"),
    include_str!("../../../../shared/src/procedure.rs"),
    include_str!("../../../../shared/src/procedure/contact.rs"),
    include_str!("../../../../shared/src/procedure/limits.rs"),
    include_str!("../../sim/src/lossy.rs"),
    include_str!("../../identify/src/options.rs"),
    include_str!("../../model/src/data.rs"),
    include_str!("../../plan/src/candidates.rs"),
    include_str!("../../plan/src/grid.rs"),
    include_str!("../../plan/src/path.rs"),
    include_str!("../../sim/src/plant/config.rs"),
    include_str!("../../identify/src/parameters.rs"),
];

/// Width to which comments are wrapped.
const WIDTH: usize = 100;

/// One field of a struct.
struct Field {
    name: String,
    /// Its type, without path and `Option`.
    kind: String,
    /// Its doc comment, as one paragraph.
    words: String,
}

/// The structs of the sources, by name.
type Structs = BTreeMap<String, Vec<Field>>;

impl Config {
    /// The whole tree as TOML, with every field and its description. Fields that are left out by
    /// default appear as comments.
    ///
    /// # Errors
    /// An impossible plant.
    pub fn to_documented_toml(&self) -> Result<String, ConfigError> {
        let encode = |message: String| ConfigError::Syntax {
            path: "configuration".to_owned(),
            message,
        };
        let mut whole = toml::Table::try_from(self).map_err(|e| encode(e.to_string()))?;
        // The plant's section also shows every field. Its seed is the run's.
        let mut plant = toml::Table::try_from(self.plant()?).map_err(|e| encode(e.to_string()))?;
        if !self.plant.contains_key("seed") {
            plant.remove("seed");
        }
        whole.insert("plant".to_owned(), toml::Value::Table(plant));
        let mut out = String::from(
            "# Configuration of spherecal. A field that is left out has the value that\n\
             # `spherecal config --print` shows. SI units unless the name says otherwise.\n\n",
        );
        section(&mut out, "", "Config", &whole, &structs());
        Ok(out)
    }
}

/// Writes one table: first its values, then the tables in it.
fn section(out: &mut String, path: &str, kind: &str, table: &toml::Table, structs: &Structs) {
    let none = Vec::new();
    let fields = structs.get(kind).unwrap_or(&none);
    let is_table = |name: &str| matches!(table.get(name), Some(toml::Value::Table(_)));
    for field in fields.iter().filter(|f| !is_table(&f.name)) {
        comment(out, &field.words);
        match table.get(&field.name) {
            Some(value) => out.push_str(&format!("{} = {value}\n", field.name)),
            None => out.push_str(&format!("# {} = (left out)\n", field.name)),
        }
    }
    // A free table (overrides of parameters, by name) has no fixed fields.
    for (name, value) in table.iter().filter(|(name, _)| fields.iter().all(|f| f.name != **name)) {
        if !value.is_table() {
            out.push_str(&format!("{} = {value}\n", key(name)));
        }
    }
    for (name, value) in table {
        let toml::Value::Table(inner) = value else { continue };
        let field = fields.iter().find(|f| f.name == *name);
        let path = if path.is_empty() {
            key(name)
        } else {
            format!("{path}.{}", key(name))
        };
        out.push('\n');
        comment(out, field.map_or("", |f| f.words.as_str()));
        out.push_str(&format!("[{path}]\n"));
        // The plant is a free table in the file and a struct in the program.
        let kind = match field.map(|f| f.kind.as_str()) {
            Some("Table") => "PlantConfig",
            Some(kind) => kind,
            None => "",
        };
        section(out, &path, kind, inner, structs);
    }
}

/// A key, quoted where it must be.
fn key(name: &str) -> String {
    if !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-') {
        name.to_owned()
    } else {
        toml::Value::String(name.to_owned()).to_string()
    }
}

/// Words as comment lines.
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

/// Reads the public structs of all sources. The sources are our own and formatted by rustfmt, so
/// reading line by line is enough: a doc comment, attributes, `pub name: Type,`.
fn structs() -> Structs {
    let mut structs = Structs::new();
    for source in SOURCES {
        let (mut current, mut words): (Option<String>, String) = (None, String::new());
        for line in source.lines() {
            if let Some(rest) = line.strip_prefix("pub struct ") {
                let name: String = rest.chars().take_while(|c| c.is_alphanumeric()).collect();
                current = rest.ends_with('{').then_some(name);
                words.clear();
            } else if line == "}" {
                current = None;
            } else if let Some(text) = line.trim_start().strip_prefix("///") {
                words.push_str(text);
            } else if let Some((name, kind)) = line.strip_prefix("    pub ").and_then(|l| l.split_once(": ")) {
                if let Some(owner) = &current {
                    structs.entry(owner.clone()).or_default().push(Field {
                        name: name.to_owned(),
                        kind: bare(kind),
                        words: plain(&words),
                    });
                }
                words.clear();
            } else if !line.trim_start().starts_with("#[") {
                words.clear();
            }
        }
    }
    structs
}

/// A type without `Option`, path and comma.
fn bare(kind: &str) -> String {
    let kind = kind.trim_end_matches(',');
    let kind = kind
        .strip_prefix("Option<")
        .and_then(|k| k.strip_suffix('>'))
        .unwrap_or(kind);
    kind.rsplit("::").next().unwrap_or(kind).to_owned()
}

/// A doc comment without the marks of its links.
fn plain(words: &str) -> String {
    words.trim().replace("[`", "`").replace("`]", "`")
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a field is printed without a description, is lost, or gets another value when the
    // printed text is read.
    #[test]
    fn every_field_is_described_and_reads_back() {
        let config = Config::default();
        let text = config.to_documented_toml().expect("encodes");
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
        assert_eq!(read.plant().expect("plant"), config.plant().expect("plant"));
        let mut read = read;
        read.plant = config.plant.clone();
        assert_eq!(read, config);
    }

    // Fails if a user's value is printed as the default, or if a name that TOML requires to be
    // quoted is not.
    #[test]
    fn what_was_set_is_printed() {
        let text = "seed = 9\ntool_mm = [1.0, 2.0, 3.0]\n[plan]\npatience = 0.5\n\
                    [identify.parameters.\"odd name\"]\nprior_sigma = 5e-5\n[plant]\npreset = \"ideal\"\nseed = 4\n";
        let config: Config = toml::from_str(text).expect("parses");
        let printed = config.to_documented_toml().expect("encodes");
        let read: Config = toml::from_str(&printed).expect("reads");
        assert_eq!(read.plant().expect("plant"), config.plant().expect("plant"));
        assert_eq!((read.seed, read.tool_mm, &read.plan), (9, config.tool_mm, &config.plan));
        assert_eq!(read.identify, config.identify);
    }
}
