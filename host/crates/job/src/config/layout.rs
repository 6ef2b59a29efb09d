//! Migrates configurations of older programs, which kept a part of the real cell in other sections.
//!
//! | then | now |
//! |---|---|
//! | `tool_mm` | `cell.tool.tcp_mm` |
//! | `plant.plate.spheres_m`, `certificate_sigma_m`, `sphere_radius_m`, `surface_below_m` | the same in `[cell.plate]` |
//! | `plant.plate.origin_m`, `rpy_rad` | the first of `[[cell.placements]]` |
//! | `plant.plate.moved` | the other `[[cell.placements]]` |
//!
//! A stored configuration is migrated when it is read ([`Config::stored`](super::Config::stored)).
//! The stored text itself stays unchanged: it is part of the record, and digests and other stores
//! contain the same text. A user's file is refused with the lines to write
//! ([`ConfigError::OldLayout`](super::ConfigError::OldLayout)), so that files and documentation
//! agree.

use spherecal_model::Placement;
use toml::{Table, Value};

/// Fields that moved from `[plant.plate]` to `[cell.plate]` under the same name.
const PLATE: [&str; 4] = ["spheres_m", "certificate_sigma_m", "sphere_radius_m", "surface_below_m"];

/// Moves every field to its present place. Returns the old names of the moved fields.
///
/// A field that `[cell]` already has keeps its value.
pub(super) fn bring_forward(config: &mut Table) -> Vec<String> {
    let mut moved = Vec::new();
    if config.get("cell").is_some_and(|cell| !cell.is_table()) {
        return moved;
    }
    let mut cell = Table::new();
    if let Some(tcp_mm) = config.remove("tool_mm") {
        moved.push("tool_mm".to_owned());
        cell.insert(
            "tool".to_owned(),
            Table::from_iter([("tcp_mm".to_owned(), tcp_mm)]).into(),
        );
    }
    if let Some(Value::Table(plant)) = config.get_mut("plant") {
        if let Some(Value::Table(old)) = plant.get_mut("plate") {
            take_plate(old, &mut cell, &mut moved);
            if old.is_empty() {
                plant.remove("plate");
            }
        }
        if plant.is_empty() {
            config.remove("plant");
        }
    }
    if !moved.is_empty() {
        if let Some(Value::Table(given)) = config.remove("cell") {
            overwrite(&mut cell, given);
        }
        config.insert("cell".to_owned(), cell.into());
    }
    moved
}

/// Removes from the old `[plant.plate]` the fields that are now in `[cell]`.
fn take_plate(old: &mut Table, cell: &mut Table, moved: &mut Vec<String>) {
    let mut take = |name: &str| {
        let value = old.remove(name);
        if value.is_some() {
            moved.push(format!("plant.plate.{name}"));
        }
        value
    };
    let plate: Table = PLATE
        .iter()
        .filter_map(|name| Some(((*name).to_owned(), take(name)?)))
        .collect();
    if !plate.is_empty() {
        cell.insert("plate".to_owned(), plate.into());
    }
    let (origin_m, rpy_rad, others) = (take("origin_m"), take("rpy_rad"), take("moved"));
    if origin_m.is_none() && rpy_rad.is_none() && others.is_none() {
        return;
    }
    // A field that an older file left out had this default.
    let default = Placement::default();
    let floats = |values: [f64; 3]| Value::from(values.to_vec());
    let first = Table::from_iter([
        (
            "origin_m".to_owned(),
            origin_m.unwrap_or_else(|| floats(default.origin_m)),
        ),
        ("rpy_rad".to_owned(), rpy_rad.unwrap_or_else(|| floats(default.rpy_rad))),
    ]);
    let mut placements = vec![Value::from(first)];
    match others {
        Some(Value::Array(others)) => placements.extend(others),
        // Not a list of placements: the reader of the new layout reports the mistake.
        Some(other) => placements.push(other),
        None => {}
    }
    cell.insert("placements".to_owned(), placements.into());
}

/// Writes `over` into `base`, table by table.
fn overwrite(base: &mut Table, over: Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(new)) => overwrite(inner, new),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

/// The section `[cell]` of a configuration, as lines for a file.
pub(super) fn cell_lines(config: &Table) -> String {
    let cell = config.get("cell").cloned().unwrap_or(Value::Table(Table::new()));
    toml::to_string(&Table::from_iter([("cell".to_owned(), cell)])).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::super::{Config, ConfigError};
    use super::*;

    const OLD: &str = "seed = 3\ntool_mm = [10.0, 0.0, 120.0]\n[plan]\nposes = 12\n[plant]\npreset = \"harsh\"\n\
                       [plant.plate]\norigin_m = [0.5, -0.1, 0.3]\nplacement_sigma_m = 0.001\nsphere_radius_m = 0.02\n\
                       [[plant.plate.moved]]\norigin_m = [0.5, 0.1, 0.4]\nrpy_rad = [0.0, 0.0, 1.0]\n";

    // Fails if a value of an older configuration is lost, changed or moved to another field, or if
    // a field that did not move moves.
    #[test]
    fn every_field_finds_its_new_home() {
        let config = Config::stored(OLD).expect("brought forward");
        assert_eq!(config.cell.tool.tcp_mm, Some([10.0, 0.0, 120.0]));
        assert_eq!(config.cell.plate.sphere_radius_m, 0.02);
        assert_eq!(config.cell.plate.spheres_m.len(), 3);
        let [first, second] = config.cell.placements[..] else {
            panic!("two placements")
        };
        // The yaw was left out: it keeps the default of 150 degrees.
        assert_eq!(
            (first.origin_m, first.rpy_rad),
            ([0.5, -0.1, 0.3], Placement::default().rpy_rad)
        );
        assert_eq!((second.origin_m, second.rpy_rad), ([0.5, 0.1, 0.4], [0.0, 0.0, 1.0]));
        let plant = config.plant().expect("possible");
        assert_eq!(
            (plant.plate.placement_sigma_m, plant.plate.placement_sigma_rad),
            (0.001, 0.01)
        );
        assert_eq!(
            (plant.cell, config.seed, config.plan.poses),
            (config.cell.nominal(), 3, 12)
        );
    }

    // Fails if a user's older file is silently read, if the error does not name each field to
    // remove, or if the file that follows the remedy gives another configuration than the older
    // program read.
    #[test]
    fn the_lines_to_paste_make_the_same_configuration() {
        let refusal = Config::parse("cell.toml", OLD).expect_err("an older file");
        let ConfigError::OldLayout { fields, lines, .. } = &refusal else {
            panic!("{refusal}")
        };
        assert_eq!(
            fields,
            "tool_mm, plant.plate.sphere_radius_m, plant.plate.origin_m, plant.plate.moved"
        );
        assert!(
            refusal
                .to_string()
                .contains("[cell.tool]\ntcp_mm = [10.0, 0.0, 120.0]\n"),
            "{refusal}"
        );
        // Follows the remedy: the named fields are removed and the lines are added.
        let mut edited: Table = toml::from_str(OLD).expect("TOML");
        for field in fields.split(", ") {
            let mut names = field.split('.').rev();
            let last = names.next().expect("a name");
            let table = names
                .rev()
                .fold(&mut edited, |t, n| t[n].as_table_mut().expect("a table"));
            assert!(table.remove(last).is_some(), "{field}");
        }
        let text = format!("{}\n{lines}", toml::to_string(&edited).expect("TOML"));
        let config = Config::parse("cell.toml", &text).expect("the new layout");
        assert_eq!(config, Config::stored(OLD).expect("brought forward"));
    }

    /// A run that an older program measured and stored; see `tests/data/README.md`.
    const OLD_RUN: &[u8] = include_bytes!("../../../../../tests/data/old_configuration.db");

    // Fails if a run that an older program stored cannot be read, if its cell has changed (then its
    // plan differs), or if reading changes the stored text.
    #[test]
    #[ignore = "slow: the gate runs it"]
    fn slow_a_stored_run_of_an_older_program_goes_on() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("calibration.db");
        std::fs::write(&path, OLD_RUN).expect("written");
        let mut store = spherecal_store::SqlStore::open(&path).expect("opens");
        let run = spherecal_store::CalibrationStore::last_run(&mut store);
        let run = run.expect("reads").expect("a run");
        assert!(run.config_toml.contains("tool_mm") && !run.config_toml.contains("[cell"));
        let measured = crate::read(&mut store, &run).expect("reads");
        let cell = &measured.config.cell;
        assert_eq!(cell.tool.tcp_mm, Some([50.0, 0.0, 101.5]));
        assert_eq!(cell.placements.len(), 2);
        assert_eq!(cell.placements[0].rpy_rad, Placement::default().rpy_rad);
        assert_eq!(cell.placements[1].origin_m, [0.643, 0.12, 0.42]);
        assert_eq!(
            measured.config.plant().expect("possible").plate.placement_sigma_m,
            0.0015
        );
        // `--resume` and `report` prepare the run anew.
        let prepared = crate::prepare(&measured.config).expect("prepares");
        // The planner of that program also counted poses in which the arm does not stand clear.
        let plan = spherecal_plan::Plan {
            planned: measured.plan.planned,
            reachable: measured.plan.reachable,
            ..prepared.plan
        };
        assert_eq!(plan, measured.plan);
        assert_eq!(prepared.spheres, measured.spheres);
        assert_eq!(prepared.tool, measured.tool);
        let again = spherecal_store::CalibrationStore::last_run(&mut store);
        assert_eq!(again.expect("reads").expect("a run").config_toml, run.config_toml);
    }

    // Fails if a file of the present layout, with errors of the plate, is taken for an older one,
    // or if an older field beside `[cell]` overrides the value in `[cell]`.
    #[test]
    fn the_present_layout_is_left_alone() {
        let text = "[plant.plate]\nplacement_sigma_m = 0.001\n[cell.plate]\nsphere_radius_m = 0.02\n";
        let mut table: Table = toml::from_str(text).expect("TOML");
        assert!(bring_forward(&mut table).is_empty());
        assert_eq!(table, toml::from_str(text).expect("TOML"));
        let both = format!("tool_mm = [1.0, 2.0, 3.0]\n{text}[cell.tool]\ntcp_mm = [4.0, 5.0, 6.0]\n");
        let config = Config::stored(&both).expect("brought forward");
        assert_eq!(config.cell.tool.tcp_mm, Some([4.0, 5.0, 6.0]));
        assert_eq!(config.cell.plate.sphere_radius_m, 0.02);
    }
}
