//! What was found in a bag, in words: whether it can be used, and how its poses were formed.

use spherecal_model::excerpt;

use super::error::BagError;
use super::joints::JointReader;
use super::rests::{GAP_S, Mixed, NEAR_S, REST_S, Rests, SHORT_S};
use super::targets::{Targets, Where};
use super::topics::Wanted;

/// Points of one rest may be as far from their mean, in m.
const MOST_SPREAD_M: f64 = 2e-3;

/// Fewer poses place no base. Where the arm moved for most of the time, that is why there are no more.
const FEWEST: usize = 3;

/// A time in s, as ROS prints it.
fn seconds(time_ns: i64) -> String {
    format!("{:.3} s", time_ns as f64 * 1e-9)
}

fn where_words(at: Where, places: &[String]) -> String {
    match at {
        Where::Point(_) => "a measured point".to_owned(),
        Where::Sphere { sphere, place } => match places.get(place).filter(|name| !name.is_empty()) {
            Some(name) => format!("sphere {sphere} in placement {}", excerpt(name)),
            None => format!("sphere {sphere}"),
        },
    }
}

pub(crate) fn mixed_targets(bag: &str, found: &Targets, mixed: Mixed) -> BagError {
    BagError::NoPose {
        path: bag.to_owned(),
        what: format!(
            "topic {} ({}): while the arm rested from {} to {} it says {} and {}",
            excerpt(&found.chosen.targets.name),
            excerpt(&found.chosen.targets.kind),
            seconds(mixed.from_ns),
            seconds(mixed.to_ns),
            where_words(mixed.first, &found.places),
            where_words(mixed.other, &found.places),
        ),
        remedy: "publish one target per rest, and while the arm rests; are the clocks of the publishers the same?"
            .to_owned(),
    }
}

/// How many times without motion have which length.
fn lengths(short: &[u64; SHORT_S.len()]) -> String {
    let one = |(k, count): (usize, &u64)| {
        let from = if k == 0 { 0.0 } else { SHORT_S[k - 1] };
        format!("{from} to {} s: {count}", SHORT_S[k])
    };
    short.iter().enumerate().map(one).collect::<Vec<_>>().join(", ")
}

/// Whether what was found can be used.
pub(crate) fn judge(bag: &str, wanted: &Wanted, found: &Targets, rests: &Rests<'_>) -> Result<(), BagError> {
    let refuse = |what: String, remedy: &str| {
        Err(BagError::NoPose {
            path: bag.to_owned(),
            what,
            remedy: remedy.to_owned(),
        })
    };
    let (joints, targets) = (excerpt(&found.chosen.joints.name), excerpt(&found.chosen.targets.name));
    if rests.backwards * 10 > found.joint_states {
        return refuse(
            format!(
                "topic {joints}: {} of {} joint states are older than the one before",
                rests.backwards, found.joint_states
            ),
            "record the joint states of one publisher, with one clock",
        );
    }
    if let Some(pose) = rests.poses.iter().find(|pose| pose.measured.spread_m > MOST_SPREAD_M) {
        return refuse(
            format!(
                "topic {targets}: {} points of one rest ({} to {}) are up to {:.1} mm from their mean; at most {:.0} mm \
                 are taken",
                pose.measured.count,
                seconds(pose.from_ns),
                seconds(pose.to_ns),
                pose.measured.spread_m * 1e3,
                MOST_SPREAD_M * 1e3
            ),
            "publish points of one target of the tool, in m, and with the clock of the joint states",
        );
    }
    let (from, to) = rests.span_ns.unwrap_or_default();
    let streamed = rests.poses.len() < FEWEST && rests.rested_ns < to.saturating_sub(from) / 2;
    if !rests.poses.is_empty() && !streamed {
        return Ok(());
    }
    let (Some(first), Some(last)) = (found.all.first(), found.all.last()) else {
        return refuse(
            format!("topic {targets} has no message"),
            "record the points or contacts",
        );
    };
    if last.time_ns < from || first.time_ns > to {
        return refuse(
            format!(
                "the joint states are from {} to {}, the {} messages of {targets} from {} to {}: they have no time in common",
                seconds(from),
                seconds(to),
                found.all.len(),
                seconds(first.time_ns),
                seconds(last.time_ns)
            ),
            "publish both with one clock (use_sim_time everywhere or nowhere)",
        );
    }
    let band_mrad = wanted.rest_rad * 1e3;
    if rests.count == 0 || streamed {
        let moved = match rests.count {
            0 => "all the time and never rests".to_owned(),
            count => format!("most of the time and rests for {REST_S} s or more {count} times"),
        };
        return refuse(
            format!(
                "the arm moved {moved}: in {:.1} s of joint states there are {} shorter times without motion, of \
                 {}; the longest in which no joint leaves a band of {band_mrad} mrad is {:.2} s, and {REST_S} s are needed",
                (to - from) as f64 * 1e-9,
                rests.short.iter().sum::<u64>(),
                lengths(&rests.short),
                rests.longest_ns as f64 * 1e-9
            ),
            "stop the arm for a second at each pose; for noisy encoders give a wider band with --rest-mrad; joint states \
             must come at 2 Hz or more",
        );
    }
    refuse(
        format!(
            "the arm rests {} times, and none of the {} messages of {targets} is of a time in a rest",
            rests.count,
            found.all.len()
        ),
        "publish the point or contact while the arm rests, with the clock of the joint states; for noisy encoders give a \
         wider band with --rest-mrad",
    )
}

/// How the poses were formed, in words.
pub(crate) fn notes(wanted: &Wanted, found: &Targets, rests: &Rests<'_>, reader: &JointReader<'_>) -> Vec<String> {
    let (joints, targets) = (&found.chosen.joints, &found.chosen.targets);
    let frame = match rests.poses.first().map(|pose| pose.measured.at) {
        Some(Where::Point(_)) => format!(", frame \"{}\"", excerpt(&found.frame)),
        _ => String::new(),
    };
    let mut notes = vec![format!(
        "{} poses were formed from the bag: one for each rest of the arm (no joint leaves a band of {} mrad for {REST_S} s, \
         joint states at most {GAP_S} s apart) with a message on {} ({}{frame}); angles are the mean of {} within {NEAR_S} s \
         of these messages; times are those of {}",
        rests.poses.len(),
        wanted.rest_rad * 1e3,
        excerpt(&targets.name),
        excerpt(&targets.kind),
        excerpt(&joints.name),
        if found.by_header { "the headers" } else { "the recorder" },
    )];
    notes.extend(found.early.iter().cloned());
    if rests.left_out > 0 {
        notes.push(format!(
            "{} of {} messages on {} were left out: the arm moved, or rested for less than {REST_S} s",
            rests.left_out,
            found.all.len(),
            excerpt(&targets.name)
        ));
    }
    if reader.efforts && !wanted.effort_nm {
        notes.push(format!(
            "the efforts of {} were left out: some robots publish currents; if they are measured torques in N m, give \
             --effort-nm",
            excerpt(&joints.name)
        ));
    }
    if reader.partial > 0 {
        notes.push(format!(
            "{} of {} messages on {} lack a joint of the robot and were left out",
            reader.partial,
            reader.partial + reader.whole,
            excerpt(&joints.name)
        ));
    }
    notes
}
