//! Section `[certificate]`: what only the user knows of the report's certificate.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use spherecal_model::read_text;
use spherecal_report::Certificate;
use spherecal_store::time::{is_date, months_after};

use super::{ConfigError, MOST_BYTES};

/// Most characters of a name or number: more does not fit on the page.
const MOST_CHARACTERS: usize = 60;

/// Whether a word that is printed is one line of a usual length: a longer one, or one with a line break, could look like
/// rows of a table.
pub(super) fn is_one_line(text: &str) -> bool {
    text.chars().count() <= MOST_CHARACTERS && !text.chars().any(char::is_control)
}
/// Longest validity, in months.
const MOST_MONTHS: u32 = 120;

/// Names and numbers of the certificate that `spherecal certificate` writes. The program cannot know them. A certificate is
/// refused while one that ISO/IEC 17025 asks for is left out; a draft has "not stated" in its place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CertificateSection {
    /// Number of the certificate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub number: Option<String>,
    /// Customer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub customer: Option<String>,
    /// Address of the customer, with a contact.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub customer_address: Option<String>,
    /// Laboratory or company that calibrates.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub laboratory: Option<String>,
    /// Address of the laboratory.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub laboratory_address: Option<String>,
    /// Where the robot stands: building, room, cell.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub place: Option<String>,
    /// Who calibrates.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub operator: Option<String>,
    /// Who authorises the certificate, and signs it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub authorised_by: Option<String>,
    /// Serial number of the robot. Default: `arm`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Temperature at the robot during the measurement, in degrees Celsius.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature_c: Option<f64>,
    /// Further conditions that matter, such as humidity, or how long the robot had warmed up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub conditions: Option<String>,
    /// Instrument that judged the result or measured the points: maker, type, serial number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instrument: Option<String>,
    /// Number of the instrument's own certificate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instrument_certificate: Option<String>,
    /// The plate: maker, type, serial number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plate: Option<String>,
    /// Number of the plate's certificate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub plate_certificate: Option<String>,
    /// Date of the measurement, as YYYY-MM-DD, for a table of poses. A run knows its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub measured_on: Option<String>,
    /// Months from the measurement to the next calibration, as your procedure says, 1 to 120.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub validity_months: Option<u32>,
}

impl CertificateSection {
    /// Reads the block `[certificate]` of a file, which may be a whole configuration. `arm` beside
    /// the block is the serial number where the block has none.
    ///
    /// # Errors
    /// The file cannot be read, is not TOML, has no such block, or a value is impossible.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let name = path.display().to_string();
        let syntax = |message: String| ConfigError::Syntax {
            path: name.clone(),
            message,
        };
        let text = read_text(path, MOST_BYTES, "a configuration has some kilobytes")?;
        let mut table: toml::Table =
            toml::from_str(&text).map_err(|e: toml::de::Error| syntax(e.to_string().trim_end().to_owned()))?;
        let block = table.remove("certificate").ok_or_else(|| {
            syntax(
                "it has no block [certificate], for instance with the lines\n\n[certificate]\noperator = \"A. Miller\""
                    .to_owned(),
            )
        })?;
        let mut section: Self = block
            .try_into()
            .map_err(|e: toml::de::Error| syntax(format!("certificate: {}", e.to_string().trim_end())))?;
        let arm = table.get("arm").and_then(toml::Value::as_str).unwrap_or_default();
        if section.serial.is_none() && !arm.is_empty() {
            section.serial = Some(arm.to_owned());
        }
        section.check()?;
        Ok(section)
    }

    /// Writes what is stated here onto a certificate; what is left out stays as it is there. A date of measurement that the
    /// data told stays, too.
    pub fn state(&self, certificate: &mut Certificate) {
        let put = |own: &Option<String>, there: &mut Option<String>| {
            if let Some(words) = own.as_ref().filter(|v| !v.trim().is_empty()) {
                *there = Some(words.clone());
            }
        };
        put(&self.number, &mut certificate.number);
        put(&self.customer, &mut certificate.customer);
        put(&self.customer_address, &mut certificate.customer_address);
        put(&self.laboratory, &mut certificate.laboratory);
        put(&self.laboratory_address, &mut certificate.laboratory_address);
        put(&self.place, &mut certificate.place);
        put(&self.operator, &mut certificate.operator);
        put(&self.authorised_by, &mut certificate.authorised_by);
        put(&self.serial, &mut certificate.serial);
        put(&self.conditions, &mut certificate.conditions);
        put(&self.instrument, &mut certificate.instrument);
        put(&self.instrument_certificate, &mut certificate.instrument_certificate);
        put(&self.plate, &mut certificate.plate);
        put(&self.plate_certificate, &mut certificate.plate_certificate);
        if certificate.measured.is_none() {
            put(&self.measured_on, &mut certificate.measured);
        }
        certificate.temperature_c = self.temperature_c.or(certificate.temperature_c);
        certificate.validity_months = self.validity_months.or(certificate.validity_months);
        certificate.next_calibration = certificate
            .validity_months
            .filter(|_| certificate.may_be_used)
            .and_then(|months| months_after(certificate.measured.as_deref()?, months));
    }

    /// Checks every value.
    /// Errors: the first field with an impossible value.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        for (field, text) in [
            ("number", &self.number),
            ("customer", &self.customer),
            ("customer_address", &self.customer_address),
            ("laboratory", &self.laboratory),
            ("laboratory_address", &self.laboratory_address),
            ("place", &self.place),
            ("operator", &self.operator),
            ("authorised_by", &self.authorised_by),
            ("conditions", &self.conditions),
            ("serial", &self.serial),
            ("instrument", &self.instrument),
            ("instrument_certificate", &self.instrument_certificate),
            ("plate", &self.plate),
            ("plate_certificate", &self.plate_certificate),
        ] {
            let text = text.as_deref().unwrap_or_default();
            if !is_one_line(text) {
                return Err(ConfigError::Certificate {
                    field,
                    value: text.escape_debug().take(2 * MOST_CHARACTERS).collect(),
                    remedy: "give one line of at most 60 characters, or leave it out",
                });
            }
        }
        if let Some(day) = &self.measured_on
            && !(is_date(day) && day.len() == 10)
        {
            return Err(ConfigError::Certificate {
                field: "measured_on",
                value: day.escape_debug().take(MOST_CHARACTERS).collect(),
                remedy: "give a date in quotes, such as \"2026-11-23\", or leave it out",
            });
        }
        if let Some(celsius) = self.temperature_c
            && !(-40.0..=85.0).contains(&celsius)
        {
            return Err(ConfigError::Range {
                field: "certificate.temperature_c",
                value: celsius,
                remedy: "give degrees Celsius from -40 to 85, or leave it out",
            });
        }
        if let Some(months) = self.validity_months
            && !(1..=MOST_MONTHS).contains(&months)
        {
            return Err(ConfigError::Range {
                field: "certificate.validity_months",
                value: f64::from(months),
                remedy: "give months from 1 to 120, or leave it out",
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Config;

    fn refusal(text: &str) -> String {
        let config = Config::parse("cell.toml", text).expect("parses");
        config.check().expect_err(text).to_string()
    }

    // Fails if the name of an arm can look like rows of a table, or fills a screen.
    #[test]
    fn the_name_of_an_arm_is_one_short_line() {
        let config = |arm: String| Config {
            arm,
            ..Config::default()
        };
        config("A-17, Zelle Süd".to_owned()).check().expect("a name");
        for arm in [
            "A\n    9  2026-01-01".to_owned(),
            "x".repeat(5000),
            "\u{1b}[2J".to_owned(),
        ] {
            let said = config(arm).check().expect_err("refused").to_string();
            assert!(
                said.contains("one line of at most 60 characters") && said.len() < 500,
                "{said}"
            );
            assert!(!said.contains(char::is_control), "{said}");
        }
    }

    // Fails if a value that cannot be printed or cannot be true is accepted, or if the message
    // lacks field, value or remedy.
    #[test]
    fn impossible_values_are_refused_by_field() {
        assert_eq!(
            refusal("[certificate]\ntemperature_c = 293.15"),
            "certificate.temperature_c is 293.15: give degrees Celsius from -40 to 85, or leave it out"
        );
        assert!(refusal("[certificate]\ntemperature_c = nan").starts_with("certificate.temperature_c is NaN"));
        assert!(refusal("[certificate]\nvalidity_months = 0").contains("give months from 1 to 120"));
        assert!(
            refusal("[certificate]\noperator = \"a\\nb\"").starts_with("certificate.operator is a\\nb: give one line")
        );
        let long = format!("[certificate]\nplace = \"{}\"", "x".repeat(61));
        assert!(refusal(&long).contains("at most 60 characters"));
        assert!(refusal("[certificate]\nmeasured_on = \"23.11.2026\"").contains("such as \"2026-11-23\""));
        let unknown = Config::parse("cell.toml", "[certificate]\noperater = \"A\"");
        assert!(unknown.expect_err("a wrong name").to_string().contains("operater"));
    }

    // Fails if a good block is refused, loses a value on its way through the store, or is not
    // found in a file of its own.
    #[test]
    fn a_good_block_reads_back() {
        let text = "arm = \"A-17\"\n[certificate]\noperator = \"Zo\u{eb} M\u{fc}ller\"\ntemperature_c = 21\n\
                    validity_months = 12\nmeasured_on = \"2026-11-23\"\n";
        let config = Config::parse("cell.toml", text).expect("parses");
        config.check().expect("a good block");
        let stored = Config::stored(&config.to_toml().expect("encodes")).expect("reads");
        assert_eq!(stored.certificate, config.certificate);
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("cell.toml");
        std::fs::write(&path, text).expect("written");
        let read = CertificateSection::read(&path).expect("a block");
        assert_eq!(read.serial.as_deref(), Some("A-17"));
        assert_eq!(read.operator, config.certificate.operator);
        std::fs::write(&path, "seed = 3\n").expect("written");
        let none = CertificateSection::read(&path).expect_err("no block").to_string();
        assert!(none.contains("has no block [certificate]"), "{none}");
    }
}
