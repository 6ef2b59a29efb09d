//! Formats results for people.

use std::fmt::Write as _;
use std::path::PathBuf;

use spherecal_identify::evaluate::model_title;
use spherecal_job::{ModelSummary, Summary};
use spherecal_plan::Plan;
use spherecal_report::headline::brief;

/// The models of the printed validation table, in order.
const MODELS: [&str; 4] = ["nominal", "sphere", "laser", "laser_full"];

/// The result of a run: the answer, what to keep in mind, what was done, the files, and what to do next.
pub(super) fn result(summary: &Summary, files: &[PathBuf]) -> String {
    let mut out = format!("\n{}", verdict(summary));
    let p = &summary.poses;
    let faults = summary.faults.len();
    let _ = writeln!(
        out,
        "\n{}: {} of {} poses recorded on {} contacts, {faults} {}; {:.0} s of robot time in {:.1} s ({:.0}x)",
        summary.robot,
        p.recorded,
        p.chosen,
        summary.contacts.len(),
        if faults == 1 { "fault" } else { "faults" },
        summary.simulated_s,
        summary.wall_s,
        summary.real_time_factor
    );
    if let Some(ended) = &summary.ended_early {
        let _ = writeln!(out, "Ended early: {}", ended.words());
    }
    if let Some(drive) = &summary.drive {
        let _ = writeln!(out, "Real time: {}", drive.words());
    }
    if !files.is_empty() {
        out.push_str("\nFiles:\n");
        for file in files {
            let _ = writeln!(out, "  {}", file.display());
        }
    }
    let _ = writeln!(out, "\nNext: {}", summary.verdict.next);
    out
}

/// Table 5.
pub(super) fn table(summary: &Summary) -> String {
    let v = &summary.validation;
    if v.models.is_empty() {
        return String::new();
    }
    let mut out = format!(
        "Error of the TCP on {} laser measurements, in mm (Table 5 of the paper)\n\n",
        v.n
    );
    let _ = writeln!(
        out,
        "  {:30} {:>8} {:>8} {:>8} {:>8}    {:>8} {:>8}",
        "model", "mean", "std", "min", "max", "mean*", "max*"
    );
    for name in MODELS {
        if let Some(m) = v.models.get(name) {
            out.push_str(&row(model_title(name), m));
        }
    }
    for (name, m) in v.models.iter().filter(|(n, _)| !MODELS.contains(&n.as_str())) {
        out.push_str(&row(model_title(name), m));
    }
    out.push_str("\n  base measured by arcs, as in the paper; * base fitted to the points: the arm's shape alone\n\n");
    out
}

fn row(title: &str, m: &ModelSummary) -> String {
    let (a, b) = (&m.arcs, &m.best_fit);
    format!(
        "  {title:30} {:8.3} {:8.3} {:8.3} {:8.3}    {:8.3} {:8.3}\n",
        a.mean_mm, a.std_mm, a.min_mm, a.max_mm, b.mean_mm, b.max_mm
    )
}

/// The headline, and each remark by its first clause: `report.html` has them in full, and all figures.
pub(super) fn verdict(summary: &Summary) -> String {
    let v = &summary.verdict;
    let mut out = format!("{}\n", v.headline);
    for remark in v.reasons.iter().chain(&summary.remarks) {
        let _ = writeln!(out, "  - {}", brief(remark));
    }
    out
}

/// A plan in words.
pub(super) fn plan(plan: &Plan) -> String {
    let mut out = format!(
        "{}: {} poses chosen of {} within reach ({} considered), about {:.0} s of robot time\n",
        plan.robot,
        plan.recorded(),
        plan.reachable,
        plan.planned,
        plan.robot_s
    );
    for visit in &plan.spheres {
        let [x, y, z] = visit.position_m.map(|m| m * 1e3);
        let _ = writeln!(
            out,
            "  sphere {} at ({x:.1}, {y:.1}, {z:.1}) mm in the base frame: {} poses{}",
            visit.sphere_id,
            visit.recorded(),
            if visit.over_home {
                ""
            } else {
                ", straight from the visit before"
            }
        );
    }
    if !plan.promise.is_empty() {
        out.push_str("  predicted TCP error over the workspace (mean, mean at the worst place):\n");
    }
    for a in plan.promise.iter().filter(|a| a.poses > 0) {
        let _ = writeln!(out, "    {:4} poses {:7.3} {:7.3} mm", a.poses, a.mean_mm, a.worst_mm);
    }
    for (reason, count) in plan.rejected_by_reason() {
        let _ = writeln!(out, "  {count} poses out of reach: {reason}");
    }
    out
}
