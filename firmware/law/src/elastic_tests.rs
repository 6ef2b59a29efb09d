//! A joint that gives way, on a drive that answers late.

use super::Actuation;

/// Step of the joint's own equations, in s.
const STEP_S: f64 = 2e-5;
/// Damping of the gear, in N m s/rad (`docs/design/plant.md`).
const GEAR_NM_S: f64 = 20.0;
/// Natural frequency of the procedure's joint spring, in rad/s, and its smallest stiffness, in N m/rad.
const NATURAL_RAD_S: f64 = 20.0;
const LEAST_NM_RAD: f64 = 40.0;

/// Control periods and latencies, in s.
const DRIVES: [(f64, f64); 6] = [
    (1e-3, 1e-3),
    (1e-3, 2e-3),
    (1e-3, 4e-3),
    (1e-3, 5e-3),
    (2e-3, 4e-3),
    (2e-3, 6e-3),
];

/// A joint of a motor (kg m²), a gear of `stiffness` (N m/rad) and a link (kg m²), held by the joint spring.
struct Joint {
    motor: f64,
    link: f64,
    stiffness: f64,
}

impl Joint {
    /// Energy after 3 s, in parts of that at the beginning, when the spring is 10 mrad off. Commands act `latency_s` after
    /// their states, once in `period_s`; `smoothed`: as the law has it.
    fn energy_left(&self, (period_s, latency_s): (f64, f64), smoothed: bool) -> f64 {
        let drive = Actuation::<1>::new([self.motor], period_s, latency_s);
        let plain = Actuation::<1>::new([0.0], period_s, latency_s);
        let law = if smoothed { drive } else { plain };
        let share = period_s / (period_s + law.smoothing_s);
        let inertia = self.motor + self.link;
        let natural = NATURAL_RAD_S.min(law.fastest_rad_s);
        let least = LEAST_NM_RAD.min(law.joint_rad_s * law.joint_rad_s * inertia);
        let damping = (2.0 * libm::sqrt(least * inertia)).min(law.joint_rad_s * inertia);
        let (k, d) = (inertia * natural * natural + least, 2.0 * inertia * natural + damping);
        let (mut q, mut dq) = ([0.01; 2], [0.0; 2]);
        let energy = |q: &[f64; 2], dq: &[f64; 2]| {
            let twist = q[0] - q[1];
            0.5 * (self.motor * dq[0] * dq[0]
                + self.link * dq[1] * dq[1]
                + self.stiffness * twist * twist
                + k * q[0] * q[0])
        };
        let first = energy(&q, &dq);
        let late = (latency_s / period_s + 0.5) as usize;
        let (mut sent, mut last) = ([0.0; 8], 0.0);
        for tick in 0..(3.0 / period_s) as usize {
            last += share * (-k * q[0] - d * dq[0] - last);
            sent[tick % 8] = last;
            let acts = if tick >= late { sent[(tick - late) % 8] } else { 0.0 };
            for _ in 0..(period_s / STEP_S + 0.5) as usize {
                let gear = self.stiffness * (q[0] - q[1]) + GEAR_NM_S * (dq[0] - dq[1]);
                dq[0] += (acts - gear) / self.motor * STEP_S;
                dq[1] += gear / self.link * STEP_S;
                q[0] += dq[0] * STEP_S;
                q[1] += dq[1] * STEP_S;
            }
            if energy(&q, &dq) > 1e3 * first {
                return f64::INFINITY;
            }
        }
        energy(&q, &dq) / first
    }
}

// Fails if the late torques of the joint spring drive a motor against its gear: stiff and soft gears, light and heavy motors and
// links, with 1 to 6 ms. Without the low-pass most of them ring (the second count), so the test sees what it is for.
#[test]
fn a_late_drive_does_not_make_an_elastic_joint_ring() {
    let (mut joints, mut ring) = (0, 0);
    for stiffness in [7e3, 16e3, 30e3] {
        for motor in [0.1, 0.3, 1.0] {
            for link in [0.3, 1.0, 3.0] {
                for drive in DRIVES {
                    let joint = Joint { motor, link, stiffness };
                    let left = joint.energy_left(drive, true);
                    assert!(
                        left < 1e-2,
                        "{drive:?}, {stiffness} N m/rad, {motor} and {link} kg m²: {left}"
                    );
                    joints += 1;
                    ring += u32::from(joint.energy_left(drive, false) > 1.0);
                }
            }
        }
    }
    assert!(ring > joints / 4, "{ring} of {joints} ring without it");
}

// Fails if a prompt drive, or one that hides its motors, is smoothed: it would lose the stiffness that it has.
#[test]
fn only_late_drives_with_visible_motors_are_smoothed() {
    let smoothing =
        |motor: f64, period_s: f64, latency_s: f64| Actuation::<1>::new([motor], period_s, latency_s).smoothing_s;
    assert_eq!(smoothing(0.5, 1e-3, 0.0), 0.0);
    assert_eq!(smoothing(0.0, 2e-3, 4e-3), 0.0);
    assert!(smoothing(0.1, 1e-3, 1e-3) > 0.0);
    assert!(smoothing(0.1, 2e-3, 4e-3) > 0.0);
    let (late, prompt) = (
        Actuation::<1>::new([0.1], 2e-3, 4e-3),
        Actuation::<1>::new([0.0], 2e-3, 4e-3),
    );
    assert!(late.fastest_rad_s < prompt.fastest_rad_s && late.joint_rad_s < prompt.joint_rad_s);
}
