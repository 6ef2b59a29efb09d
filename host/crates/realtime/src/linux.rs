//! The system calls. `std` has none of them.
#![allow(
    unsafe_code,
    reason = "four system calls without a safe wrapper among the dependencies that the project has already; each \
              gets valid memory of its own stack and has its errors checked"
)]

use super::{AHEAD_PRIORITY, Granted, PRIORITY};

pub(super) fn enter() -> Granted {
    Granted {
        memory_locked: lock_memory(),
        processor: pin(),
        // Last: the calls before it need not run with priority.
        priority: fixed_priority(PRIORITY),
    }
}

pub(super) fn go_ahead() -> bool {
    fixed_priority(AHEAD_PRIORITY)
}

fn fixed_priority(priority: i32) -> bool {
    let parameters = libc::sched_param {
        sched_priority: priority,
    };
    // SAFETY: the parameters live until the call returns; 0 is the calling thread.
    unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) == 0 }
}

/// Binds the thread to the last processor that it may use: the first ones serve most interrupts.
fn pin() -> Option<usize> {
    let size = std::mem::size_of::<libc::cpu_set_t>();
    // SAFETY: a set of processors is an array of integers; all zeros is the empty set.
    let mut set: libc::cpu_set_t = unsafe { std::mem::zeroed() };
    // SAFETY: the set is of the stated size and lives until the call returns; 0 is the calling thread.
    if unsafe { libc::sched_getaffinity(0, size, &raw mut set) } != 0 {
        return None;
    }
    let permitted = (0..libc::CPU_SETSIZE as usize).filter(|&k| {
        // SAFETY: `k` is below CPU_SETSIZE.
        unsafe { libc::CPU_ISSET(k, &set) }
    });
    let all: Vec<usize> = permitted.collect();
    // With one processor there is nothing to choose.
    let [.., _, last] = all.as_slice() else { return None };
    // SAFETY: as above; `last` came from the set.
    unsafe {
        libc::CPU_ZERO(&mut set);
        libc::CPU_SET(*last, &mut set);
        (libc::sched_setaffinity(0, size, &raw const set) == 0).then_some(*last)
    }
}

/// Keeps the pages of the process in memory from their first use on. Only where the permitted
/// amount is unlimited: otherwise a later allocation would fail.
fn lock_memory() -> bool {
    let mut limit = libc::rlimit {
        rlim_cur: 0,
        rlim_max: 0,
    };
    // SAFETY: the limit lives until the call returns.
    if unsafe { libc::getrlimit(libc::RLIMIT_MEMLOCK, &raw mut limit) } != 0 {
        return false;
    }
    if limit.rlim_cur != libc::RLIM_INFINITY {
        let unlimited = libc::rlimit {
            rlim_cur: libc::RLIM_INFINITY,
            rlim_max: libc::RLIM_INFINITY,
        };
        // SAFETY: as above. The superuser may raise the limit.
        if unsafe { libc::setrlimit(libc::RLIMIT_MEMLOCK, &raw const unlimited) } != 0 {
            return false;
        }
    }
    // SAFETY: takes no memory of ours.
    unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE | libc::MCL_ONFAULT) == 0 }
}
