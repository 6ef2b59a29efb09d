//! When and in which coupling each recording of a run was made.

use spherecal_identify::causes::Course;
use spherecal_shared::protocol::host::{Coupled, Recording};

/// The course of a run.
///
/// A recording belongs to the last coupling of its sphere before it, so two successive
/// couplings of one sphere are two. The clock of a controller that was restarted begins
/// again: then the order alone says when.
pub(crate) fn course(recordings: &[Recording], couplings: &[Coupled]) -> Course {
    let mut coupling = Vec::with_capacity(recordings.len());
    let mut count = 0;
    let mut before = None;
    for recording in recordings {
        let seated = |c: &&Coupled| c.sphere == recording.sphere && c.time_us <= recording.start_us;
        let latest = couplings.iter().filter(seated).map(|c| c.time_us).max();
        let now = Some((recording.sphere, latest));
        if before.is_some() && before != now {
            count += 1;
        }
        before = now;
        coupling.push(count);
    }
    let starts: Vec<u64> = recordings.iter().map(|r| r.start_us).collect();
    let time = match (starts.first(), starts.last()) {
        (Some(first), Some(last)) if first < last && starts.is_sorted() => {
            let span = (last - first) as f64;
            starts.iter().map(|start| (start - first) as f64 / span).collect()
        }
        _ => {
            let last = starts.len().saturating_sub(1).max(1) as f64;
            (0..starts.len()).map(|k| k as f64 / last).collect()
        }
    };
    Course {
        coupling,
        time,
        ..Course::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recording(sphere: u32, start_us: u64) -> Recording {
        Recording {
            sphere,
            pose: 0,
            start_us,
            end_us: start_us + 1,
            count: 1,
            gaps: 0,
            q: std::iter::empty().collect(),
            tau: std::iter::empty().collect(),
            tcp_spread_m: 0.0,
            force_n: [0.0; 3],
        }
    }

    fn coupled(sphere: u32, time_us: u64) -> Coupled {
        Coupled {
            sphere,
            time_us,
            centre_m: [0.0; 3],
            shift_m: 0.0,
            test_m: 0.0,
        }
    }

    // Fails if two successive couplings of one sphere count as one, or if the time is not
    // the device's.
    #[test]
    fn successive_couplings_of_one_sphere_are_told_apart() {
        let couplings = [coupled(2, 10), coupled(1, 100), coupled(1, 200)];
        let recordings = [(2, 20), (1, 110), (1, 120), (1, 220)].map(|(sphere, at)| recording(sphere, at));
        let course = course(&recordings, &couplings);
        assert_eq!(course.coupling, [0, 1, 1, 2]);
        assert_eq!(course.time, [0.0, 0.45, 0.5, 1.0]);
    }

    // Fails if a clock that begins again makes the time run backwards.
    #[test]
    fn a_restarted_clock_leaves_the_order() {
        let couplings = [coupled(1, 100), coupled(1, 5)];
        let recordings = [(1, 110), (1, 120), (1, 6), (1, 7), (1, 8)].map(|(sphere, at)| recording(sphere, at));
        let course = course(&recordings, &couplings);
        assert_eq!(course.coupling, [0, 0, 1, 1, 1]);
        assert_eq!(course.time, [0.0, 0.25, 0.5, 0.75, 1.0]);
    }
}
