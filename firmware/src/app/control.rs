//! The control task.

use spherecal_shared::protocol::drive::{DriveCommand, DriveState};

use super::FromDrive;
use super::ports::{Beat, Clock, DrivePort, HostPort, Probe};
use crate::Controller;

/// Why the control task ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Ended {
    /// The drive has gone for good.
    DriveGone,
    /// The drive is not one that this controller can work with.
    DriveRefused,
}

/// What the control task keeps from tick to tick, out of its stack frame.
#[derive(Debug, Default)]
pub struct Workspace<const N: usize> {
    /// The controller.
    pub controller: Controller<N>,
    state: DriveState,
    heard: bool,
    drive_us: u64,
}

/// Runs the controller: one tick on every beat of `clock`, until the drive has
/// gone for good (on a real board: for ever).
///
/// Without a fresh drive state the tick sees the last one again; the control
/// path tells it by its number, bridges a few and then faults. Missed periods
/// are told to the control path, which counts them, reports them to the host
/// and faults when they are too many.
pub async fn run<const N: usize>(
    work: &mut Workspace<N>,
    clock: &mut impl Clock,
    drive: &mut (impl DrivePort + Probe),
    host: &mut impl HostPort,
) -> Ended {
    loop {
        let beat = clock.next().await;
        if let Err(ended) = turn(work, clock, &beat, drive, host) {
            return ended;
        }
    }
}

/// One beat: takes in what has come, ticks, hands on what there is to say.
///
/// # Errors
/// Why there is no next one.
pub fn turn<const N: usize>(
    work: &mut Workspace<N>,
    clock: &impl Clock,
    beat: &Beat,
    drive: &mut (impl DrivePort + Probe),
    host: &mut impl HostPort,
) -> Result<(), Ended> {
    if beat.missed > 0 {
        log_warn!("overrun: {} periods missed", beat.missed);
    }
    work.controller.missed(beat.missed);
    while let Some(message) = drive.receive() {
        take(work, message)?;
    }
    if drive.ended() {
        return Err(Ended::DriveGone);
    }
    let before = work.controller.phase();
    drive.before_tick();
    let command = tick(work, clock, beat, host);
    drive.after_tick();
    if work.heard {
        drive.send(&command);
    }
    let controller = &mut work.controller;
    host.events(&mut || controller.event());
    host.samples(&mut || controller.sample());
    host.ticked(clock.time(beat, work.drive_us), controller.statistics());
    let after = controller.phase();
    if after != before {
        log_info!("phase {} after {}, tick {}", after, before, work.state.tick);
    }
    Ok(())
}

/// The host's commands and the control law.
fn tick<const N: usize>(
    work: &mut Workspace<N>,
    clock: &impl Clock,
    beat: &Beat,
    host: &mut impl HostPort,
) -> DriveCommand {
    let controller = &mut work.controller;
    if host.heard() {
        controller.heard();
    }
    loop {
        let mut taken = false;
        let more = host.command(&mut |sequence, start_us, command| {
            taken = controller.order(sequence, start_us, command);
        });
        if !(more && taken) {
            // One that found no room is sent again by the host, which has no answer.
            break;
        }
        hand_on(controller, host);
    }
    let command = controller.tick(clock.time(beat, work.drive_us), &work.state);
    hand_on(controller, host);
    command
}

fn hand_on<const N: usize>(controller: &mut Controller<N>, host: &mut impl HostPort) {
    while let Some(verdict) = controller.verdict() {
        host.verdict(verdict);
    }
}

fn take<const N: usize>(work: &mut Workspace<N>, message: FromDrive) -> Result<(), Ended> {
    match message {
        FromDrive::State { state, time_us } => {
            work.state = state;
            work.drive_us = time_us;
            work.heard = true;
        }
        FromDrive::Hello(hello) => {
            if work.controller.connect(&hello).is_err() {
                log_error!(
                    "drive refused: protocol {}, {} joints, {} us",
                    hello.protocol,
                    hello.limits.len(),
                    hello.period_us
                );
                return Err(Ended::DriveRefused);
            }
            log_info!("drive: {} joints, period {} us", hello.limits.len(), hello.period_us);
        }
    }
    Ok(())
}
