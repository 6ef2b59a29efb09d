//! The tables of costs in the boards' README, which tests regenerate.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Tests of one program run side by side, and may write the same page.
static PAGE: Mutex<()> = Mutex::new(());

fn readme() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware/boards/README.md")
}

/// Compares the README's table called `name`, row by row and column by column,
/// with `rows`: numbers may differ by `share` of themselves and `slack`. With
/// `SPHERECAL_BLESS` set the table is written instead, under `head`.
///
/// # Panics
/// When the README has no such table or row, or says something else.
pub fn compare(name: &str, head: &str, rows: &[(String, Vec<Option<u32>>)], share: f64, slack: f64) {
    let _page = PAGE.lock().unwrap_or_else(PoisonError::into_inner);
    let text = std::fs::read_to_string(readme()).expect("the boards' README");
    let (begin, end) = (format!("<!-- {name} -->\n"), format!("<!-- end of {name} -->"));
    let start = text.find(&begin).expect("a table") + begin.len();
    let stop = text.find(&end).expect("the table's end");
    let said = |value: &Option<u32>| value.map_or("–".to_owned(), |value| value.to_string());
    if std::env::var_os("SPHERECAL_BLESS").is_some() {
        let columns = head.matches('|').count() - 2;
        let mut table = format!("{head}\n|---|{}\n", "---:|".repeat(columns));
        for (row, values) in rows {
            let values: Vec<_> = values.iter().map(said).collect();
            table.push_str(&format!("| {row} | {} |\n", values.join(" | ")));
        }
        std::fs::write(readme(), format!("{}{table}{}", &text[..start], &text[stop..])).expect("written");
        return;
    }
    for (row, values) in rows {
        let line = text[start..stop]
            .lines()
            .find(|line| line.starts_with(&format!("| {row} |")))
            .unwrap_or_else(|| panic!("no row {row}: SPHERECAL_BLESS=1 writes it"));
        let told: Vec<_> = line.split('|').skip(2).map(str::trim).collect();
        for (told, value) in told.iter().zip(values) {
            let near = match (told.parse::<f64>(), value) {
                (Ok(told), Some(value)) => (told - f64::from(*value)).abs() <= share * told + slack,
                (Err(_), None) => true,
                _ => false,
            };
            assert!(
                near,
                "{row}: the README says {told}, measured {}; SPHERECAL_BLESS=1 mends it",
                said(value)
            );
        }
    }
}
