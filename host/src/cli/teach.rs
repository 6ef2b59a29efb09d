//! `spherecal teach`: waypoints by hand.
//!
//! Where the arm is simulated in this process, a simulated hand leads it; over
//! every other link a person does, and says so by the Enter key.

use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, channel};

use super::args::RunArgs;
use super::exit::{CliError, Exit};
use super::progress::ProgressView;
use super::run::interrupt;
use crate::campaign::Operator;
use crate::job::{self, JobError};
use crate::plan::Chain;

/// A person at this terminal. The keyboard is read in a thread of its own, so
/// that the arm's time never waits for it.
#[derive(Default)]
struct Person {
    lines: Option<Receiver<()>>,
}

impl Person {
    /// Whether a line was entered since the last call.
    fn entered(&mut self) -> bool {
        let lines = self.lines.get_or_insert_with(|| {
            let (told, lines) = channel();
            std::thread::spawn(move || {
                let mut line = String::new();
                // A closed stdin is no word of the operator.
                while std::io::stdin().read_line(&mut line).is_ok_and(|count| count > 0) {
                    if told.send(()).is_err() {
                        break;
                    }
                }
            });
            lines
        });
        lines.try_recv().is_ok()
    }
}

impl Operator for Person {
    fn lead(&mut self, sphere: u32) {
        while self.entered() {}
        eprintln!("Lead the nest to some 50 mm over sphere {sphere}, opening downwards, and press Enter.");
    }

    fn is_there(&mut self) -> bool {
        self.entered()
    }

    fn let_go(&mut self) {
        eprintln!("The arm holds: let go.");
    }
}

/// Teaches, and writes the file.
pub(super) fn run(args: &RunArgs) -> Result<Exit, CliError> {
    if args.resume {
        return Err(CliError::input("teach begins anew: leave out --resume"));
    }
    let interrupt = interrupt()?;
    let prepared = args.prepare()?;
    let path = args.out.join("waypoints.toml");
    std::fs::create_dir_all(&args.out).map_err(|source| JobError::Write {
        path: args.out.display().to_string(),
        source,
    })?;
    let mut view = ProgressView::new();
    let mut person = Person::default();
    let taught = job::teach(&prepared, &args.link, &args.out, &mut person, &mut view, &interrupt);
    view.finish();
    let taught = taught?;
    taught.write(&path)?;
    if args.json {
        let document = serde_json::json!({"command": "teach", "file": path, "waypoints": taught});
        println!("{document:#}");
        return Ok(Exit::Done);
    }
    let chain = Chain::new(&prepared.robot, &prepared.tool)?;
    let spheres: BTreeMap<u32, _> = prepared
        .plan
        .spheres
        .iter()
        .map(|v| (v.sphere_id, v.position_m))
        .collect();
    for waypoint in &taught.waypoint {
        let at = chain.pose(&waypoint.joints_rad).position;
        let nominal = spheres.get(&waypoint.sphere).copied().unwrap_or_default();
        let [x, y, z] = [0, 1, 2].map(|k| (at[k] - nominal[k]) * 1e3);
        println!(
            "sphere {}: taught at ({x:.1}, {y:.1}, {z:.1}) mm from its nominal centre",
            waypoint.sphere
        );
    }
    println!(
        "\nNext: spherecal run --waypoints {} --out {}",
        path.display(),
        args.out.display()
    );
    Ok(Exit::Done)
}
