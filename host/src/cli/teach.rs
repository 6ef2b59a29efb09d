//! `spherecal teach`: stores waypoints by hand-guiding.
//!
//! If the arm is simulated in this process, a simulated hand leads it. Over every other link an
//! operator does, and confirms with the Enter key.

use std::collections::BTreeMap;

use super::args::RunArgs;
use super::exit::{CliError, Exit, interrupt, unwritten};
use super::features;
use super::out::{errln, outln};
use super::progress::{ProgressView, TerminalOperator};
use spherecal_campaign::Operator;
use spherecal_job as job;
use spherecal_model::chain::Chain;

impl Operator for TerminalOperator {
    fn lead(&mut self, sphere: u32) {
        while self.entered() {}
        errln!("Lead the nest to about 50 mm above sphere {sphere}, with its opening downwards, and press Enter.");
    }

    fn is_there(&mut self) -> bool {
        self.entered()
    }

    fn let_go(&mut self) {
        errln!("The arm holds: let go.");
    }
}

/// Teaches, and writes the file.
pub(super) fn run(args: &RunArgs) -> Result<Exit, CliError> {
    if args.resume {
        return Err(CliError::input(
            "--resume: `spherecal teach` always starts a new measurement: leave the option out",
        ));
    }
    features::check_run(args)?;
    let interrupt = interrupt()?;
    let prepared = args.prepare()?;
    let path = args.out.join("waypoints.toml");
    std::fs::create_dir_all(&args.out).map_err(unwritten(&args.out))?;
    let mut view = ProgressView::new();
    let mut person = TerminalOperator::default();
    let taught = job::teach(&prepared, &args.link, &args.out, &mut person, &mut view, &interrupt);
    view.finish();
    let taught = taught?;
    taught.write(&path)?;
    if args.json {
        let document = serde_json::json!({"command": "teach", "file": path, "waypoints": taught});
        outln!("{document:#}");
        return Ok(Exit::Done);
    }
    let chain = Chain::new(&prepared.robot, &prepared.tool)?;
    let spheres: BTreeMap<(u32, u32), _> = prepared
        .plan
        .spheres
        .iter()
        .map(|v| ((v.sphere_id, v.place), v.position_m))
        .collect();
    for waypoint in &taught.waypoint {
        let at = chain.pose(&waypoint.joints_rad).position;
        let nominal = spheres
            .get(&(waypoint.sphere, waypoint.place))
            .copied()
            .unwrap_or_default();
        let [x, y, z] = [0, 1, 2].map(|k| (at[k] - nominal[k]) * 1e3);
        outln!(
            "sphere {}: taught at ({x:.1}, {y:.1}, {z:.1}) mm from its nominal centre",
            waypoint.sphere
        );
    }
    outln!(
        "\nNext: spherecal run --waypoints {} --out {}",
        path.display(),
        args.out.display()
    );
    Ok(Exit::Done)
}
