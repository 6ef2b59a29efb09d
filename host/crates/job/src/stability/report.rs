//! A report of long holds: how still the seated arm is.

use super::{HARMLESS_UM, Held};
use spherecal_report::{Curves, Headline, ReportInput, SimpleTable};

/// The report of `holds`, windows of `window_s`; `model` names the kinematic
/// model, `about` goes under the title, `provenance` to the end.
pub fn holds_report(
    robot: &str,
    about: &str,
    model: &str,
    holds: &[Held],
    window_s: f64,
    provenance: Vec<(String, String)>,
) -> ReportInput {
    let agree = holds.iter().filter(|h| h.first_agrees()).count();
    let worst = |f: &dyn Fn(&Held) -> f64| holds.iter().map(f).fold(0.0, f64::max);
    let largest = worst(&|h| h.tcp_um.largest);
    let joint = worst(&|h| h.joints_urad.iter().map(|j| j.largest).fold(0.0, f64::max));
    let seconds = holds.iter().map(|h| h.windows as f64 * window_s).fold(0.0, f64::max);
    let all = holds.iter().all(Held::is_still);
    ReportInput {
        title: format!("{robot}: stability of long holds"),
        subtitle: about.to_owned(),
        headline: Headline {
            trusted: all,
            sentence: format!(
                "Over {seconds:.0} s the TCP's {window_s:.0} s mean was never more than {largest:.2} µm from the mean \
                 of the whole hold; at {agree} of {} places the first {window_s:.0} s gave the same position, within the noise or {HARMLESS_UM} µm.",
                holds.len()
            ),
            reasons: reasons(holds, joint),
            next: if all {
                format!("Recordings of {window_s:.0} s are long enough.")
            } else {
                "Clean nest and spheres, and check that the seating is monitored: the TCP must not drift while the nest is seated."
                    .to_owned()
            },
            files: Vec::new(),
            figures: vec![
                (
                    "Largest joint deviation".to_owned(),
                    format!("{joint:.2} µrad"),
                    format!("of a {window_s:.0} s mean from the mean of {seconds:.0} s"),
                ),
                (
                    "Largest TCP deviation".to_owned(),
                    format!("{largest:.2} µm"),
                    format!("by the {model} model"),
                ),
                (
                    "Fastest drift of the TCP".to_owned(),
                    format!("{:.3} µm/s", worst(&|h| h.tcp_um.drift_per_s)),
                    "straight line through the windows".to_owned(),
                ),
            ],
        },
        stillness: figures(model, holds, window_s),
        stillness_tables: vec![table(holds, window_s)],
        provenance,
        ..ReportInput::default()
    }
}

/// Remarks on drift, if there is any.
fn reasons(holds: &[Held], joint_urad: f64) -> Vec<String> {
    let mut reasons = Vec::new();
    if !holds.iter().all(Held::first_agrees) {
        reasons.push("The TCP drifts while the arm holds: the figures below show where and how fast.".to_owned());
    } else if let Some(drift) = holds
        .iter()
        .filter(|h| !h.within_noise)
        .map(|h| h.tcp_um.first)
        .reduce(f64::max)
    {
        reasons.push(format!(
            "The TCP drifts, by {drift:.1} µm from the first second to the mean of the hold: too little to harm a calibration."
        ));
    }
    for hold in holds {
        if let Some(jump) = hold.jump {
            reasons.push(format!(
                "At {} the TCP moved by {:.0} µm at once, after {:.0} s: the nest moved on its sphere, or a joint moved within its play. No length of a recording helps.",
                name(hold),
                jump.size_um,
                jump.at_s
            ));
        }
    }
    if !holds.iter().all(|h| h.joints_within_noise) {
        reasons.push(format!(
            "Single joints drift by up to {joint_urad:.0} µrad: the elbow gives way slowly about the seated TCP. Means of \
             the joints over the same time belong together, so this does not harm a recording."
        ));
    }
    reasons
}

fn name(hold: &Held) -> String {
    format!("pose {} (sphere {})", hold.pose, hold.sphere)
}

fn yes(is: bool) -> String {
    if is { "yes" } else { "no" }.to_owned()
}

fn table(holds: &[Held], window_s: f64) -> SimpleTable {
    SimpleTable {
        title: "Holds".to_owned(),
        caption: format!(
            "Means over {window_s:.0} s against the mean of the whole hold. Joints: the worst joint of the hold. Noise is \
             the standard deviation of a {window_s:.0} s mean, estimated from the variation within the windows."
        ),
        columns: [
            "place",
            "windows",
            "joint noise (µrad)",
            "first less all (µrad)",
            "largest (µrad)",
            "drift (µrad/s)",
            "TCP noise (µm)",
            "first to all (µm)",
            "largest (µm)",
            "drift (µm/s)",
            "TCP within noise",
            "joints within noise",
        ]
        .map(str::to_owned)
        .to_vec(),
        rows: holds
            .iter()
            .map(|h| {
                let ratio = |j: &super::Stillness| j.first.abs() / j.noise.max(1e-12);
                let joint = h
                    .joints_urad
                    .iter()
                    .max_by(|a, b| ratio(a).total_cmp(&ratio(b)))
                    .copied()
                    .unwrap_or_default();
                vec![
                    name(h),
                    h.windows.to_string(),
                    format!("{:.3}", joint.noise),
                    format!("{:.3}", joint.first),
                    format!("{:.3}", joint.largest),
                    format!("{:.4}", joint.drift_per_s),
                    format!("{:.3}", h.tcp_um.noise),
                    format!("{:.3}", h.tcp_um.first),
                    format!("{:.3}", h.tcp_um.largest),
                    format!("{:.4}", h.tcp_um.drift_per_s),
                    yes(h.within_noise),
                    yes(h.joints_within_noise),
                ]
            })
            .collect(),
    }
}

fn figures(model: &str, holds: &[Held], window_s: f64) -> Vec<Curves> {
    let pairs = |times: &[f64], values: &[f64]| times.iter().copied().zip(values.iter().copied()).collect::<Vec<_>>();
    let mut figures = Vec::new();
    for hold in holds {
        let noise = hold.joints_urad.iter().map(|j| j.noise).fold(0.0, f64::max);
        figures.push(Curves {
            what: "joint angle less its mean (µrad)".to_owned(),
            caption: format!(
                "{}: means of the joints over {window_s:.0} s against time. The band is two sigma of the noisiest joint.",
                name(hold)
            ),
            curves: hold
                .joint_curves_urad
                .iter()
                .zip(1..)
                .map(|(curve, j)| (format!("joint {j}"), pairs(&hold.time_s, curve)))
                .collect(),
            band: 2.0 * noise,
        });
        figures.push(Curves {
            what: "TCP less its mean (µm)".to_owned(),
            caption: format!(
                "{}: the TCP of the {model} model against time. The band is two sigma of the distance by noise.",
                name(hold)
            ),
            curves: ["x", "y", "z"]
                .iter()
                .zip(&hold.tcp_curves_um)
                .map(|(axis, curve)| ((*axis).to_owned(), pairs(&hold.time_s, curve)))
                .collect(),
            band: 2.0 * hold.tcp_um.noise,
        });
    }
    figures
}
