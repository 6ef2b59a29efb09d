//! Makes the calling thread a real-time thread, as far as the system permits: fixed priority
//! (`SCHED_FIFO`), one processor, locked memory, a stack that is in memory already.
//!
//! The controller's thread calls [`enter`] once, before its loop. Nothing fails: what was refused is
//! in the answer, with what to do. `spherecal doctor --realtime` measures how well the thread then
//! keeps its period.

#[cfg(target_os = "linux")]
mod linux;

/// Priority of the real-time thread, 1 to 99: above ordinary threads and most interrupts of a
/// `PREEMPT_RT` kernel (50).
pub const PRIORITY: i32 = 80;
/// Priority of a thread that has a deadline of seconds: above ordinary threads, below all that has one of milliseconds.
const AHEAD_PRIORITY: i32 = 10;
/// Stack that is touched before the loop, in bytes.
const STACK: usize = 256 * 1024;
/// Size of a page, in bytes; a smaller one is touched more than once.
const PAGE: usize = 4096;

/// What the system granted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Granted {
    /// The thread runs with a fixed priority.
    pub priority: bool,
    /// Pages of the process stay in memory once they were used.
    pub memory_locked: bool,
    /// The only processor on which the thread runs; `None`: any.
    pub processor: Option<usize>,
}

impl std::fmt::Display for Granted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.priority {
            write!(f, "real-time thread: SCHED_FIFO {PRIORITY}")?;
        } else {
            f.write_str(
                "warning: no right to real-time priority (add `@realtime - rtprio 99` to /etc/security/limits.conf \
                 and join that group): cycles will be late under load",
            )?;
        }
        if self.memory_locked {
            f.write_str(", memory locked")?;
        } else {
            f.write_str(", memory not locked (add `@realtime - memlock unlimited`)")?;
        }
        match self.processor {
            Some(processor) => write!(f, ", processor {processor}"),
            None => f.write_str(", any processor"),
        }
    }
}

/// Makes the calling thread a real-time thread. Call it once, at the thread's start.
#[must_use]
pub fn enter() -> Granted {
    touch_stack();
    #[cfg(target_os = "linux")]
    {
        linux::enter()
    }
    #[cfg(not(target_os = "linux"))]
    {
        Granted::default()
    }
}

/// Lets the calling thread go ahead of all ordinary threads, where the system permits it: on a busy computer an ordinary one
/// may wait for a processor for seconds.
pub fn go_ahead() {
    #[cfg(target_os = "linux")]
    let _ = linux::go_ahead();
}

/// Writes to the stack, so that the loop meets no page fault there.
#[inline(never)]
#[allow(clippy::large_stack_arrays, reason = "the stack is what is to be touched")]
fn touch_stack() {
    let mut stack = [0_u8; STACK];
    for byte in stack.iter_mut().step_by(PAGE) {
        *byte = 1;
    }
    std::hint::black_box(&stack);
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if entering fails on a system without rights, or the answer hides what was refused.
    #[test]
    fn entering_never_fails_and_says_what_was_refused() {
        let granted = std::thread::spawn(enter).join().expect("a thread");
        let text = granted.to_string();
        assert_eq!(text.contains("warning"), !granted.priority, "{text}");
        assert_eq!(text.contains("not locked"), !granted.memory_locked, "{text}");
    }
}
