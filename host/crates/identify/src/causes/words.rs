//! A cause in words: what it is, how large it is, and what to do about it.

use nalgebra::DVector;

use super::alternatives::Alternative;
use super::payload::PAYLOAD_UNIT_KG;
use super::size::Displaced;
use crate::course::Course;
use crate::targets::Reference;

const AXES: [&str; 3] = ["x", "y", "z"];

fn place_name(reference: Reference) -> String {
    match reference {
        Reference::Tracker => "the tracker".to_owned(),
        Reference::Place(0) => "the plate".to_owned(),
        Reference::Place(place) => format!("the plate (place {place})"),
    }
}

fn share(time: f64) -> String {
    format!("{:.0} %", 100.0 * time)
}

/// The cause without its size.
pub(crate) fn short(alternative: &Alternative, course: &Course) -> String {
    match *alternative {
        Alternative::Certificate { sphere, axis } => format!("the certificate of sphere {sphere} ({})", AXES[axis]),
        Alternative::Slip { reference, time, .. } => {
            format!("{} slipped after {} of the time", place_name(reference), share(time))
        }
        Alternative::Drift { reference } => format!("{} drifted", place_name(reference)),
        Alternative::SphereMoved { sphere, time } => {
            format!("sphere {sphere} moved after {} of the time", share(time))
        }
        Alternative::Seat { coupling } => format!("coupling {} sat elsewhere", coupling + 1),
        Alternative::Reseat { coupling, .. } => {
            format!("the nest sat elsewhere in a part of coupling {}", coupling + 1)
        }
        Alternative::EncoderStep { joint, time } => {
            format!("encoder {} jumped after {} of the time", joint + 1, share(time))
        }
        Alternative::EncoderDrift { joint } => format!("encoder {} drifted", joint + 1),
        Alternative::JointRegion {
            joint,
            from_rad,
            to_rad,
        } => format!(
            "joint {} between {:.0} and {:.0} degrees",
            joint + 1,
            from_rad.to_degrees(),
            to_rad.to_degrees()
        ),
        Alternative::Lag { joint: Some(joint) } => format!("joint {}'s readings lag its motion", joint + 1),
        Alternative::Lag { joint: None } => "the joints' readings lag their motion".to_owned(),
        Alternative::Backlash { joint } => format!(
            "joint {} has another error after moves up than after moves down",
            joint + 1
        ),
        Alternative::Place { place, sphere: None } => format!("{} is off", course.place_name(place)),
        Alternative::Place {
            place,
            sphere: Some(sphere),
        } => format!("sphere {sphere} is off at {}", course.place_name(place)),
        Alternative::Payload => "the load at the flange is another than stated".to_owned(),
    }
}

/// The cause with its size: `shift` in m (rad, or its own unit), `sigma` in thousandths of it. `moved` is how far
/// it displaces the TCP.
pub(crate) fn words(
    alternative: &Alternative,
    shift: &DVector<f64>,
    sigma: f64,
    moved: Displaced,
    course: &Course,
) -> String {
    let mm = |k: usize| shift.get(k).copied().unwrap_or_default() * 1e3;
    let size = shift.norm() * 1e3;
    let in_part = if moved.in_part {
        "; as far as the data tell: not in every direction"
    } else {
        ""
    };
    let vector = || format!("({:+.3}, {:+.3}, {:+.3}) mm", mm(0), mm(1), mm(2));
    match *alternative {
        Alternative::Certificate { sphere, axis } => format!(
            "the certificate of sphere {sphere} is wrong: {} is off by {:.3} ± {sigma:.3} mm",
            AXES[axis],
            mm(0)
        ),
        Alternative::Slip {
            reference,
            time,
            turned: false,
        } => format!(
            "{} slipped by {size:.3} ± {sigma:.3} mm, {}, after {} of the time",
            place_name(reference),
            vector(),
            share(time)
        ),
        // How far it shifted and how far it turned about its middle may both be uncertain where the displacement
        // of what stands on it is not.
        Alternative::Slip {
            reference,
            time,
            turned: true,
        } => format!(
            "{} slipped and turned after {} of the time: what was touched then lay {:.3} ± {:.3} mm from where it was \
             before (root mean square{})",
            place_name(reference),
            share(time),
            moved.mm,
            moved.sigma_mm,
            in_part
        ),
        Alternative::Drift { reference } => format!(
            "{} drifted by {size:.3} ± {sigma:.3} mm, {}, from its first to its last pose",
            place_name(reference),
            vector()
        ),
        Alternative::SphereMoved { sphere, time } => format!(
            "sphere {sphere} moved by {size:.3} ± {sigma:.3} mm, {}, between two couplings, after {} of the time",
            vector(),
            share(time)
        ),
        Alternative::Seat { coupling } => format!(
            "coupling {} sat {size:.3} ± {sigma:.3} mm from the others on its sphere, {}",
            coupling + 1,
            vector()
        ),
        Alternative::Reseat { coupling, .. } => format!(
            "the nest sat {size:.3} ± {sigma:.3} mm from its usual seat in a part of coupling {}, {} in the flange frame",
            coupling + 1,
            vector()
        ),
        Alternative::EncoderStep { joint, time } => format!(
            "the encoder of joint {} jumped by {:+.3} ± {sigma:.3} mrad after {} of the time",
            joint + 1,
            mm(0),
            share(time)
        ),
        Alternative::EncoderDrift { joint } => format!(
            "the encoder of joint {} drifted by {:+.3} ± {sigma:.3} mrad from first to last pose",
            joint + 1,
            mm(0)
        ),
        Alternative::JointRegion { .. } => {
            format!(
                "{} is off by {:+.3} ± {sigma:.3} mrad",
                short(alternative, course),
                mm(0)
            )
        }
        Alternative::Lag { .. } => format!(
            "{} by {:.3} ± {:.3} % of each move",
            short(alternative, course),
            0.1 * mm(0),
            0.1 * sigma
        ),
        Alternative::Backlash { .. } => {
            format!(
                "{}: {:.3} ± {sigma:.3} mrad apart",
                short(alternative, course),
                mm(0).abs()
            )
        }
        Alternative::Place { .. } => {
            format!(
                "{} by {size:.3} ± {sigma:.3} mm, {}",
                short(alternative, course),
                vector()
            )
        }
        Alternative::Payload => format!(
            "the load at the flange is {:.2} ± {:.2} kg {} than stated",
            1e-3 * mm(0).abs() * PAYLOAD_UNIT_KG,
            1e-3 * sigma * PAYLOAD_UNIT_KG,
            if mm(0) > 0.0 { "heavier" } else { "lighter" }
        ),
    }
}

/// What to do about a cause.
pub(crate) fn next(alternative: &Alternative) -> &'static str {
    match alternative {
        Alternative::Certificate { .. } => {
            "compare this sphere's coordinates in the plate file with its certificate, or have the plate measured again"
        }
        Alternative::Slip { .. } | Alternative::Drift { .. } => {
            "fasten the plate, let it reach the temperature of the room, and measure again"
        }
        Alternative::SphereMoved { .. } => "fasten this sphere and measure again",
        Alternative::Seat { .. } | Alternative::Reseat { .. } => {
            "clean nest and sphere, and repeat this coupling or leave its rows out"
        }
        Alternative::EncoderStep { .. } | Alternative::EncoderDrift { .. } => {
            "look for a slipping encoder or a lost reference of this joint, master it, and measure again"
        }
        Alternative::JointRegion { .. } => "check encoder and gear of this joint in this range",
        Alternative::Lag { .. } => "wait longer before reading the angles, or average them for longer",
        Alternative::Backlash { .. } => "approach every pose from the same side, or have the gear's play looked at",
        Alternative::Place { sphere: None, .. } => {
            "measure this place again, or leave its rows out: instrument or target moved there"
        }
        Alternative::Place { sphere: Some(_), .. } => {
            "look whether this sphere sat firmly in this placement, and measure the placement again"
        }
        Alternative::Payload => {
            "weigh the tool and give --payload-kg and --payload-com-mm; the result holds with the load that was found"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a plate that slipped and turned is described by its shift alone, or a turn is told where none was tried.
    #[test]
    fn a_plate_that_turned_is_said_to_have_turned() {
        let shift = DVector::from_row_slice(&[3e-4, 0.0, -4e-4]);
        let told = |turned, in_part| {
            let slip = Alternative::Slip {
                reference: Reference::Place(0),
                time: 0.5,
                turned,
            };
            let moved = Displaced {
                mm: 0.6,
                sigma_mm: 0.2,
                in_part,
            };
            words(&slip, &shift, 0.1, moved, &Course::default())
        };
        assert_eq!(
            told(false, false),
            "the plate slipped by 0.500 ± 0.100 mm, (+0.300, +0.000, -0.400) mm, after 50 % of the time"
        );
        assert_eq!(
            told(true, false),
            "the plate slipped and turned after 50 % of the time: what was touched then lay 0.600 ± 0.200 mm from \
             where it was before (root mean square)"
        );
        assert!(told(true, true).ends_with("(root mean square; as far as the data tell: not in every direction)"));
    }
}
