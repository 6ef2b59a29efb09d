//! The law as a library, on any drive: holds an iiwa 7 by a Cartesian spring, draws a circle with it, and tells how far the
//! TCP is off and what it feels.
//!
//! ```console
//! $ cargo run -p spherecal-sim --example hold                      # on the simulated arm, in this program
//! $ cargo run -p spherecal-sim --example hold -- 127.0.0.1:7401    # over the drive link
//! ```
//!
//! Over the drive link it drives `spherecal plant --listen 7401`, MuJoCo (`examples/python/mujoco_drive.py 7401`) and every other
//! drive that waits for its controller. It has no guards: take it to simulated arms.

use nalgebra::Vector3;
use spherecal_firmware::law::{
    Actuation, Axes, CartesianSetpoint, EnergyLimit, Goal, ImpedanceLoop, Output, Stiffness, Withheld,
};
use spherecal_link::Drive;
use spherecal_link::tcp::RemoteDrive;
use spherecal_shared::procedure::Law;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState, TorqueSign};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};
use spherecal_sim::plant::PlantConfig;
use spherecal_sim::simulated_arm;

type Failed = Box<dyn std::error::Error>;

/// Home of the default plan, over the middle of the plate, in rad.
const HOME: [f64; 7] = [0.0, 0.306_69, 0.0, -1.202_41, 0.0, 1.6325, 0.0];
/// Radius of the circle, in m, and time of a turn, in s.
const RADIUS_M: f64 = 0.05;
const TURN_S: f64 = 4.0;

fn main() -> Result<(), Failed> {
    let mut drive: Box<dyn Drive> = match std::env::args().nth(1) {
        Some(address) => Box::new(RemoteDrive::connect(&address)?),
        None => Box::new(simulated()?),
    };
    let off_m = circle(&mut *drive, |second, off_m, out| {
        println!(
            "{second} s: {:.1} mm off, feels {:.1} N",
            1e3 * off_m,
            out.wrench.force.norm()
        );
    })?;
    println!("at most {:.1} mm off the circle", 1e3 * off_m);
    Ok(())
}

/// The simulated arm, with the errors of the preset `typical`.
fn simulated() -> Result<impl Drive, Failed> {
    let config: PlantConfig = PlantConfig::typical();
    Ok(simulated_arm(&iiwa7(), &iiwa7_tool(), &config, &HOME)?)
}

/// Holds the arm for a second and draws a circle across z. Returns how far the TCP was off it at most, in m.
fn circle(drive: &mut dyn Drive, mut told: impl FnMut(u64, f64, &Output<7>)) -> Result<f64, Failed> {
    let hello = drive.hello().clone();
    let period_s = 1e-6 * f64::from(hello.period_us);
    let motors = std::array::from_fn(|i| hello.motor_kg_m2.get(i).copied().unwrap_or(0.0));
    let actuation = Actuation::new(motors, period_s, 1e-6 * f64::from(hello.latency_us));
    let gravity = hello.compensates_gravity;
    let mut control = ImpedanceLoop::<7>::new(&iiwa7(), &iiwa7_tool(), Law::default(), actuation, gravity, period_s)?;
    control.set_stiffness(Stiffness::isotropic(1000.0, 100.0), Axes::Base)?;
    // No change of the setpoint may give more than 2 J.
    control.set_energy_limit(Some(EnergyLimit {
        capacity_j: 2.0,
        refill_w: 1.0,
    }))?;
    let mut state = DriveState::default();
    let mut command: Option<DriveCommand> = None;
    let (mut start, mut most_m) = (None, 0.0f64);
    let cycles = ((1.0 + TURN_S) / period_s) as u64;
    for cycle in 0..cycles {
        drive.exchange(command.as_ref(), &mut state)?;
        let joints = |values: &[f64]| <[f64; 7]>::try_from(values).map_err(|_| "the drive has no seven joints");
        let sign = match hello.torque_sign {
            TorqueSign::OfActuator => 1.0,
            TorqueSign::OfLink => -1.0,
        };
        let tau = joints(&state.tau)?.map(|tau| sign * tau);
        let out = control
            .step(&joints(&state.q)?, &joints(&state.dq)?, &tau)
            .ok_or("a state is not finite")?;
        let at = *start.get_or_insert(out.tcp);
        let angle = std::f64::consts::TAU * (cycle as f64 * period_s - 1.0).max(0.0) / TURN_S;
        let (sine, cosine) = angle.sin_cos();
        let mut goal = CartesianSetpoint::at(
            at.position + Vector3::new(cosine - 1.0, sine, 0.0) * RADIUS_M,
            at.rotation,
        );
        if angle > 0.0 {
            let speed = RADIUS_M * std::f64::consts::TAU / TURN_S;
            goal.velocity
                .fixed_rows_mut::<3>(0)
                .copy_from(&Vector3::new(-sine * speed, cosine * speed, 0.0));
        }
        let off_m = (out.tcp.position - goal.position).norm();
        most_m = most_m.max(off_m);
        control.goal = Some(Goal::Pose(goal));
        if cycle % (0.5 / period_s) as u64 == 0 {
            told(cycle * u64::from(hello.period_us) / 1_000_000, off_m, &out);
        }
        if out.withheld != Withheld::Nothing {
            return Err(format!("the guard held back: {:?}", out.withheld).into());
        }
        command = Some(DriveCommand {
            session: hello.session,
            tick: state.tick,
            tau: out.torque.into_iter().collect(),
            enable: true,
            ..DriveCommand::default()
        });
    }
    Ok(most_m)
}

#[cfg(test)]
mod tests {
    // Fails if the example does not run on the simulated arm, or if its spring does not follow a circle of 50 mm within 5 mm
    // against the friction of a typical arm.
    #[test]
    fn the_circle_is_drawn() {
        let mut drive = super::simulated().expect("an arm");
        let off_m = super::circle(&mut drive, |_, _, _| {}).expect("a circle");
        assert!(off_m < 5e-3, "{off_m} m");
    }
}
