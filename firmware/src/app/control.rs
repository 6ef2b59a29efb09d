//! The control task.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Duration;
use spherecal_shared::protocol::drive::{DriveCommand, DriveMessage, DriveState};

use super::mailbox::ControlSide;
use super::ports::{Clock, DrivePort, Probe, Tick};
use crate::Controller;

/// Why the control task ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Ended {
    /// The drive is gone for good.
    DriveGone,
    /// This controller cannot work with the drive: its handshake was refused.
    DriveRefused,
}

/// State of the control task between two ticks. It is large, so it does not
/// stand in the task's stack frame.
#[derive(Debug, Default)]
pub struct ControlState<const N: usize> {
    /// The controller.
    pub controller: Controller<N>,
    state: DriveState,
    /// Whether a drive state has come yet.
    state_received: bool,
    drive_us: u64,
}

/// Runs the controller: one cycle per tick of `clock`, until the drive is gone
/// (on a real board: for ever).
///
/// When no new drive state has come, the control path gets the last one again.
/// It recognises that by the tick number, bridges a few such ticks and then
/// faults. It is also told of missed periods; it counts them, reports them to
/// the host and faults after too many in a row.
pub async fn run<const N: usize>(
    state: &mut ControlState<N>,
    clock: &mut impl Clock,
    drive: &mut (impl DrivePort + Probe),
    host: &mut ControlSide<'_, impl RawMutex>,
) -> Ended {
    clock.start();
    loop {
        let tick = clock.next_tick().await;
        if let Err(ended) = run_cycle(state, clock, &tick, drive, host) {
            return ended;
        }
        clock.set_period(Duration::from_micros(u64::from(state.controller.period_us())));
    }
}

/// One control cycle: takes the messages that have come, runs the control path,
/// sends torque, events and samples.
///
/// # Errors
/// Why there is no next cycle.
pub fn run_cycle<const N: usize>(
    state: &mut ControlState<N>,
    clock: &impl Clock,
    tick: &Tick,
    drive: &mut (impl DrivePort + Probe),
    host: &mut ControlSide<'_, impl RawMutex>,
) -> Result<(), Ended> {
    if tick.missed > 0 {
        log_warn!("overrun: {} periods missed", tick.missed);
    }
    state.controller.begin_cycle();
    state.controller.record_missed(tick.missed);
    while let Some(message) = drive.next_message() {
        take_message(state, message)?;
    }
    if drive.has_ended() {
        return Err(Ended::DriveGone);
    }
    let before = state.controller.phase();
    drive.before_tick();
    let command = control(state, clock, tick, host);
    drive.after_tick();
    if state.state_received {
        drive.send(&command);
    }
    let controller = &mut state.controller;
    host.send_reports(&mut || controller.next_report());
    host.send_samples(&mut || controller.next_sample());
    host.set_period(controller.period_us());
    controller.end_cycle();
    host.finish_tick(clock.device_time(tick, state.drive_us), controller.statistics());
    let after = controller.phase();
    if after != before {
        log_info!("phase {} after {}, tick {}", after, before, state.state.tick);
    }
    Ok(())
}

/// Runs the host's commands and the control law.
fn control<const N: usize>(
    state: &mut ControlState<N>,
    clock: &impl Clock,
    tick: &Tick,
    host: &mut ControlSide<'_, impl RawMutex>,
) -> DriveCommand {
    let controller = &mut state.controller;
    if host.was_heard() {
        controller.host_heard();
    }
    loop {
        let mut taken = false;
        let more = host.with_next_command(&mut |sequence, start_us, command| {
            taken = controller.queue_command(sequence, start_us, command);
        });
        if !(more && taken) {
            // A command that found no room gets no answer, so the host repeats it.
            break;
        }
        report_outcomes(controller, host);
    }
    controller.commands_taken();
    let command = controller.tick(clock.device_time(tick, state.drive_us), &state.state);
    report_outcomes(controller, host);
    command
}

fn report_outcomes<const N: usize>(controller: &mut Controller<N>, host: &mut ControlSide<'_, impl RawMutex>) {
    while let Some(outcome) = controller.command_outcome() {
        host.report_outcome(outcome);
    }
}

fn take_message<const N: usize>(control: &mut ControlState<N>, message: DriveMessage) -> Result<(), Ended> {
    match message {
        DriveMessage::State { state, time_us } => {
            control.state = state;
            control.drive_us = time_us;
            control.state_received = true;
        }
        DriveMessage::Hello(hello) => {
            if control.controller.connect(&hello).is_err() && control.controller.has_session() {
                log_error!("a handshake that does not fit the session with the drive is ignored");
            } else if !control.controller.has_session() {
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
