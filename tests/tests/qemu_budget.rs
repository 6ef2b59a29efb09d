//! What the controller costs on the Cortex-M7: instructions, by stage and over
//! a run.

use std::path::Path;

use spherecal_tests::qemu::{image, scenario};

/// Most instructions of a tick, on average.
const MEAN_BUDGET: f64 = 28_000.0;

/// What comes out of the image in each stage, in instructions: (name, mean, worst).
fn stages(image: &Path, folder: &Path) -> Vec<(String, u32, u32)> {
    let output = scenario(image, "stages", folder);
    assert!(output.status.success(), "{:?}", output.status);
    let text = String::from_utf8(output.stdout).expect("text");
    let line = |line: &str| {
        let mut parts = line.split('\t');
        let name = parts.next()?.to_owned();
        Some((name, parts.next()?.parse().ok()?, parts.next()?.parse().ok()?))
    };
    text.lines().map(|l| line(l).expect("name, mean, worst")).collect()
}

// Fails if the stages cost more than the budget allows, or if the table in the
// boards' README says something else than what is measured (5 %);
// SPHERECAL_BLESS=1 writes the table.
#[test]
fn the_table_of_costs_is_what_is_measured() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let costs = stages(&image, folder.path());
    let cost = |name: &str| costs.iter().find(|c| c.0 == name).map_or(0, |c| c.2);
    let law = [
        "the whole snapshot",
        "observer and wrench",
        "impedance and damping",
        "null space",
    ];
    let law: u32 = law.iter().map(|name| cost(name)).sum();
    assert!(law < MEAN_BUDGET as u32, "the law alone takes {law} instructions");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../firmware/boards/README.md");
    let readme = std::fs::read_to_string(&path).expect("the boards' README");
    let (begin, end) = ("<!-- stages -->\n", "<!-- end of stages -->");
    let start = readme.find(begin).expect("a table") + begin.len();
    let stop = readme.find(end).expect("the table's end");
    let mut table = "| stage | mean | worst |\n|---|---:|---:|\n".to_owned();
    for (name, mean, worst) in &costs {
        table.push_str(&format!("| {name} | {mean} | {worst} |\n"));
    }
    if std::env::var_os("SPHERECAL_BLESS").is_some() {
        std::fs::write(&path, format!("{}{table}{}", &readme[..start], &readme[stop..])).expect("written");
        return;
    }
    let said: Vec<Vec<&str>> = readme[start..stop]
        .lines()
        .skip(2)
        .map(|l| l.split('|').map(str::trim).collect())
        .collect();
    for (name, mean, _) in &costs {
        let row = said
            .iter()
            .find(|row| row.get(1) == Some(&name.as_str()))
            .expect("a row for each stage");
        let told: f64 = row[2].parse().expect("a number");
        let off = (told - f64::from(*mean)).abs();
        assert!(
            off <= 0.05 * told + 40.0,
            "{name}: the README says {told}, measured {mean}; SPHERECAL_BLESS=1 mends it"
        );
    }
}
