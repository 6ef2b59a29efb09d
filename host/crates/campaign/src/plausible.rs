//! Checks what a controller sends before it is stored. A frame with a correct checksum may still
//! come from a controller that is broken, or from another device.

use spherecal_shared::protocol::host::{Event, Recording, SignalStatistics};

/// A number of an event that cannot be.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{event}: {field} is {value}")]
pub struct Implausible {
    /// Which event.
    pub event: &'static str,
    /// Field.
    pub field: &'static str,
    /// Its value.
    pub value: f64,
}

/// Largest plausible joint angle, in rad; multi-turn encoders are included.
const ANGLE_MOST: f64 = 1e3;
/// Largest plausible torque, in N m.
const TORQUE_MOST: f64 = 1e5;
/// Largest plausible length, in m.
const LENGTH_MOST: f64 = 100.0;
/// Largest plausible force, in N.
const FORCE_MOST: f64 = 1e5;
/// Largest number of samples of a recording, as the procedure limits them.
const SAMPLES_MOST: u32 = 120_000;

/// Checks whether an event of a controller for `joints` joints can be true.
///
/// # Errors
/// The first number that cannot be true.
pub fn plausible(event: &Event, joints: usize) -> Result<(), Implausible> {
    match event {
        Event::Recording(recording) => check_recording(recording, joints),
        Event::Contact(c) => {
            let of = Of("a contact");
            of.within("force_n", c.force_n, FORCE_MOST)?;
            of.within("peak_n", c.peak_n, FORCE_MOST)?;
            of.all("tare_n", &c.tare_n, FORCE_MOST)?;
            of.all("tcp_m", &c.tcp_m, LENGTH_MOST)?;
            of.within("travel_m", c.travel_m, LENGTH_MOST)
        }
        Event::Coupled(c) => {
            let of = Of("a coupling");
            of.all("centre_m", &c.centre_m, LENGTH_MOST)?;
            of.within("shift_m", c.shift_m, LENGTH_MOST)?;
            of.within("test_m", c.test_m, LENGTH_MOST)
        }
        // A fault may be about a NaN.
        Event::Fault(report) if usize::from(report.joint) > joints => Err(Implausible {
            event: "a fault",
            field: "joint",
            value: report.joint.into(),
        }),
        _ => Ok(()),
    }
}

fn check_recording(r: &Recording, joints: usize) -> Result<(), Implausible> {
    let of = Of("a recording");
    for (field, count) in [
        ("the number of joints", r.q.len()),
        ("the number of torques", r.tau.len()),
    ] {
        if count != joints {
            return of.not(field, count as f64);
        }
    }
    if !(1..=SAMPLES_MOST).contains(&r.count) {
        return of.not("count", r.count.into());
    }
    if r.end_us < r.start_us {
        return of.not("end_us", r.end_us as f64);
    }
    for (signals, most, field) in [(&r.q, ANGLE_MOST, "a joint angle"), (&r.tau, TORQUE_MOST, "a torque")] {
        for s in signals {
            check_signal(s, most, field)?;
        }
    }
    of.within("tcp_spread_m", r.tcp_spread_m, LENGTH_MOST)?;
    of.all("force_n", &r.force_n, FORCE_MOST)
}

fn check_signal(s: &SignalStatistics, most: f64, field: &'static str) -> Result<(), Implausible> {
    let of = Of("a recording");
    of.all(field, &[s.mean, s.min, s.max, s.std], most)?;
    // A mean is rounded, an extreme is not.
    let slack = 1e-9 * most;
    if !(s.std >= 0.0 && s.min <= s.mean + slack && s.mean <= s.max + slack) {
        return of.not(field, s.mean);
    }
    Ok(())
}

/// An event in words.
#[derive(Clone, Copy)]
struct Of(&'static str);

impl Of {
    fn not(self, field: &'static str, value: f64) -> Result<(), Implausible> {
        Err(Implausible {
            event: self.0,
            field,
            value,
        })
    }

    fn within(self, field: &'static str, value: f64, most: f64) -> Result<(), Implausible> {
        // A NaN is refused with the rest.
        if value.abs() <= most {
            Ok(())
        } else {
            self.not(field, value)
        }
    }

    fn all(self, field: &'static str, values: &[f64], most: f64) -> Result<(), Implausible> {
        values.iter().try_for_each(|value| self.within(field, *value, most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn recording() -> Recording {
        let signal = SignalStatistics {
            mean: 0.1,
            std: 1e-6,
            min: 0.0999,
            max: 0.1001,
        };
        Recording {
            sphere: 1,
            pose: 2,
            start_us: 5,
            end_us: 9,
            count: 1000,
            gaps: 0,
            q: [signal; 7].into_iter().collect(),
            tau: [signal; 7].into_iter().collect(),
            tcp_spread_m: 1e-5,
            force_n: [0.0; 3],
        }
    }

    proptest! {
        // Fails if a NaN or an absurd number passes in any field of any joint.
        #[test]
        fn no_field_may_be_absurd(
            place in 0usize..60,
            bad in prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e9, -1e9]),
        ) {
            let mut r = recording();
            match place {
                0..=27 => {
                    let s = &mut r.q[place / 4];
                    *[&mut s.mean, &mut s.std, &mut s.min, &mut s.max][place % 4] = bad;
                }
                28..=55 => {
                    let s = &mut r.tau[(place - 28) / 4];
                    *[&mut s.mean, &mut s.std, &mut s.min, &mut s.max][place % 4] = bad;
                }
                56 => r.tcp_spread_m = bad,
                _ => r.force_n[place - 57] = bad,
            }
            prop_assert!(plausible(&Event::Recording(r), 7).is_err());
        }
    }

    #[test]
    fn what_is_in_order_passes_and_what_does_not_fit_is_named() {
        assert_eq!(plausible(&Event::Recording(recording()), 7), Ok(()));
        let short = plausible(&Event::Recording(recording()), 6).expect_err("refused");
        assert!(short.to_string().contains("number of joints is 7"), "{short}");
        let empty = Recording {
            count: 0,
            ..recording()
        };
        assert!(plausible(&Event::Recording(empty), 7).is_err());
        let backwards = Recording {
            end_us: 1,
            ..recording()
        };
        assert!(plausible(&Event::Recording(backwards), 7).is_err());
    }
}
