//! Stores what must be on the disk before the campaign goes on, while the link to the controller stays alive.
//!
//! A disk may take seconds to store a few bytes: 8 s were measured beside programs that write much. A controller that
//! hears nothing of its host for 2 s stops the arm. So a device whose time does not wait is served meanwhile: it gets
//! keep-alives, and what it sends is kept for later. A device in lock-step stands still until the disk has answered.

use std::time::{Duration, Instant};

use spherecal_link::{Device, HostEndpoint, LinkError};

/// How long the disk may take. After that the controller hears no more, and stops the arm.
const PATIENCE: Duration = Duration::from_secs(30);

/// Carries `work` out. Serves `cell` meanwhile if its time does not wait, and appends what it sends to `late`.
///
/// # Errors
/// The link failed while the work was done. The work itself is complete then, too; its result is lost.
pub(super) fn keeping_alive<T: Send>(
    cell: &mut dyn Device,
    endpoint: &mut HostEndpoint,
    late: &mut Vec<u8>,
    work: impl FnOnce() -> T + Send,
) -> Result<T, LinkError> {
    if cell.waits() {
        return Ok(work());
    }
    let begun = Instant::now();
    std::thread::scope(|scope| {
        let working = scope.spawn(work);
        let mut down = Vec::new();
        while !working.is_finished() && begun.elapsed() < PATIENCE {
            down.clear();
            endpoint.keep_alive(cell.now_us(), &mut down)?;
            cell.step(&down, late)?;
        }
        // A panic of the work is one of its caller.
        working.join().or_else(|panic| std::panic::resume_unwind(panic))
    })
}

#[cfg(test)]
mod tests {
    use spherecal_link::Timing;
    use spherecal_shared::protocol::frame::{self, Accumulator};
    use spherecal_shared::protocol::host::{Command, Downlink};

    use super::*;

    /// A device of 1 kHz that says one byte in each period and keeps what it hears.
    struct Clocked {
        waits: bool,
        ticks: u64,
        heard: Vec<u8>,
        fails_at: u64,
    }

    impl Device for Clocked {
        fn waits(&self) -> bool {
            self.waits
        }

        fn now_us(&self) -> u64 {
            1_000 * self.ticks
        }

        fn ticks(&self) -> u64 {
            self.ticks
        }

        fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
            if !self.waits {
                std::thread::sleep(Duration::from_millis(1));
            }
            self.ticks += 1;
            self.heard.extend_from_slice(down);
            up.push(self.ticks as u8);
            if self.ticks == self.fails_at {
                return Err(LinkError::device(std::io::Error::other("the cable")));
            }
            Ok(())
        }
    }

    fn clocked(waits: bool, fails_at: u64) -> Clocked {
        Clocked {
            waits,
            ticks: 0,
            heard: Vec::new(),
            fails_at,
        }
    }

    fn store_slowly(cell: &mut Clocked, ticks: u64) -> (Result<u32, LinkError>, Vec<u8>) {
        let mut endpoint = HostEndpoint::new(Timing::default());
        let mut late = vec![0];
        // The disk answers when the device has carried out that many periods of a real clock.
        let stored = keeping_alive(cell, &mut endpoint, &mut late, || {
            std::thread::sleep(Duration::from_millis(ticks));
            7
        });
        (stored, late)
    }

    // Fails if a controller hears nothing for 2 s while the disk works, if a byte of it is lost, or if it hears commands.
    #[test]
    fn a_controller_whose_time_does_not_wait_is_kept_alive() {
        let mut cell = clocked(false, 0);
        let (stored, late) = store_slowly(&mut cell, 1_200);
        assert_eq!(stored.ok(), Some(7));
        let said: Vec<u8> = (0..=cell.ticks).map(|tick| tick as u8).collect();
        assert_eq!(late, said);
        let mut times_us = Vec::new();
        let mut accumulator = Accumulator::default();
        for byte in cell.heard {
            accumulator.push(byte, &mut |bytes| {
                let (header, message) = bytes.and_then(frame::decode::<Downlink>).expect("a whole frame");
                assert_eq!(message.command, Command::KeepAlive);
                times_us.push(header.time_us);
            });
        }
        let keep_alive_us = Timing::default().keep_alive_us;
        assert_eq!(times_us.first(), Some(&0));
        assert!(
            times_us.windows(2).all(|t| t[1] - t[0] == keep_alive_us),
            "{times_us:?}"
        );
        let silent_us = cell.ticks * 1_000 - times_us.last().expect("one");
        assert!(silent_us <= keep_alive_us, "{silent_us} us of silence at the end");
    }

    // Fails if a simulation in lock-step goes on by the time that a disk takes: its bits would depend on the disk.
    #[test]
    fn a_device_in_lock_step_stands_still() {
        let mut cell = clocked(true, 0);
        let (stored, late) = store_slowly(&mut cell, 20);
        assert_eq!((stored.ok(), late, cell.ticks), (Some(7), vec![0], 0));
    }

    // Fails if a link that fails meanwhile is not told.
    #[test]
    fn a_link_that_fails_meanwhile_is_told() {
        let mut cell = clocked(false, 5);
        let (stored, _) = store_slowly(&mut cell, 100);
        assert!(stored.expect_err("the cable").to_string().contains("the cable"));
        assert_eq!(cell.ticks, 5);
    }
}
