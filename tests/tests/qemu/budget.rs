//! What the controller costs on the Cortex-M7, and that the boards' README says
//! so: instructions of a tick by stage, and memory.
//!
//! `SPHERECAL_BLESS=1` writes the tables ([`spherecal_tests::costs`]).

use std::path::Path;

use spherecal::link::qemu::Machine;
use spherecal_shared::protocol::host::Phase;
use spherecal_tests::bench::HOME;
use spherecal_tests::costs::compare;
use spherecal_tests::qemu::{bench, image, log_of, m4_image, nucleo_image, numbers, options, scenario, stack_image};
use spherecal_tests::stack::{Calls, Indirect, room as stack_room, sizes};

/// Most instructions of a tick, on average.
const MEAN_BUDGET: f64 = 28_000.0;

// Fails if the stages cost more than the budget allows, or if the README says
// something else than what is measured (5 %).
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_the_table_of_stages_is_what_is_measured() {
    let (Some(m7), Some(m4)) = (image(), m4_image()) else {
        return;
    };
    let (costs, small) = (stages(&m7, Machine::CortexM7), stages(&m4, Machine::CortexM4F));
    let cost = |name: &str| {
        costs
            .iter()
            .find(|c| c.0 == name)
            .and_then(|c| c.1[1])
            .expect("a stage")
    };
    let law = [
        "the whole snapshot",
        "observer and wrench",
        "impedance and damping",
        "null space",
    ];
    let law: u32 = law.iter().map(|name| cost(name)).sum();
    assert!(law < MEAN_BUDGET as u32, "the law alone takes {law} instructions");
    let both: Vec<_> = costs
        .into_iter()
        .zip(small)
        .map(|((name, m7), (_, m4))| (name, [m7, m4].concat()))
        .collect();
    let head = "| stage | mean | worst | Cortex-M4F, mean | worst |";
    compare("stages", head, &both, 0.05, 40.0);
}

/// Names of the stages, with their mean and worst costs in instructions.
fn stages(image: &Path, machine: Machine) -> Vec<(String, Vec<Option<u32>>)> {
    let folder = tempfile::tempdir().expect("a folder");
    let output = scenario(image, machine, "stages", folder.path());
    assert!(output.status.success(), "{:?}", output.status);
    let text = String::from_utf8(output.stdout).expect("text");
    let row = |line: &str| {
        let mut parts = line.split('\t');
        let name = parts.next()?.to_owned();
        Some((name, vec![parts.next()?.parse().ok(), parts.next()?.parse().ok()]))
    };
    text.lines().map(|l| row(l).expect("name, mean, worst")).collect()
}

/// Functions that wake a task.
const WAKERS: &[&str] = &["5waker5clone", "5waker4wake", "5waker4drop"];
/// What the processor pushes for an interrupt, floating-point registers and
/// alignment included, in bytes.
const PUSHED: u32 = 108;

/// What runs on a board, for its stack's bound.
struct Board {
    name: &'static str,
    /// Priorities that may interrupt each other, lowest first; of the functions
    /// of one priority only one runs at a time.
    priorities: &'static [&'static [&'static str]],
    /// Whom functions that call through a register may reach; those behind the
    /// executors' wake tasks.
    indirect: Indirect<'static>,
}

const MPS2: Board = Board {
    name: "mps2-an500",
    priorities: &[
        &["main"],
        &["7on_link"],
        &["16on_uart0_receive", "17on_uart0_transmit"],
        &["10on_control"],
        &["5timer12on_interrupt"],
    ],
    indirect: &[
        (
            "on_control",
            &[
                "12___piped_task",
                "14___stepped_task",
                "12___wired_task",
                "14___wrapped_task",
            ],
        ),
        (
            "7on_link",
            &[
                "12___serve_task",
                "17___serve_host_task",
                "14___host_in_task",
                "15___host_out_task",
                "15___drive_in_task",
                "16___drive_out_task",
            ],
        ),
        ("10run_thread", &["11___task_task", "10___hog_task"]),
        ("5State5serve", WAKERS),
        ("11TaskStorage", WAKERS),
        ("RawMutex4lock", WAKERS),
        ("8LinkSide", WAKERS),
        ("4Uart10on_receive", WAKERS),
        ("12embassy_time5timer", WAKERS),
        ("_defmt_release", WAKERS),
        // Whatever else of the board does so wakes tasks.
        ("mps2_an500", WAKERS),
    ],
};

const NUCLEO: Board = Board {
    name: "nucleo-h743zi",
    priorities: &[
        &["main"],
        &["UART8"],
        &["USART3"],
        &["ETH", "DMA1_STREAM2", "DMA1_STREAM3"],
        &["UART7"],
        &["TIM8_BRK_TIM12"],
    ],
    indirect: &[
        ("UART7", &["14___control_task"]),
        (
            "UART8",
            &[
                "17___serve_host_task",
                "14___host_in_task",
                "15___host_out_task",
                "17___drive_link_task",
                "16___run_stack_task",
            ],
        ),
        ("8Executor3run", &["19___housekeeping_task"]),
        ("11TaskStorage", WAKERS),
        ("TIM8_BRK_TIM12", WAKERS),
        ("12embassy_time5timer", WAKERS),
        ("_embassy_time_schedule_wake", WAKERS),
        ("_defmt_", &["9defmt_rtt7channel"]),
        ("13nucleo_h743zi", WAKERS),
        ("13embassy_stm32", WAKERS),
        ("ETH", WAKERS),
        ("USART3", WAKERS),
    ],
};

/// Bound on the stack of `board` with all priorities at their deepest.
fn bound(board: &Board) -> u32 {
    let image = stack_image(board.name).expect("an image");
    let calls = Calls::read(&image);
    let depth = |root: &&str| {
        // The scenario that measures stages runs no tasks.
        let depth = calls.depth(root, board.indirect, &["6stages3run"]);
        let depth = depth.unwrap_or_else(|error| panic!("{}: {error}", board.name));
        eprintln!("{} {root}: {} bytes", board.name, depth.bytes);
        for (frame, name) in &depth.path {
            eprintln!("  {frame:6} {name}");
        }
        depth.bytes
    };
    let deepest = |roots: &&[&str]| roots.iter().map(depth).max().unwrap_or(0) + PUSHED;
    board.priorities.iter().map(deepest).sum()
}

// Fails if the stack's room is less than one and a half times what it may need, by paint after
// a run with contact or by the frames and calls of the code; or if the README
// says something else than what is measured (5 %).
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_the_table_of_memory_is_what_is_measured() {
    let (Some(image), Some(nucleo)) = (image(), nucleo_image()) else {
        return;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let mut bench = bench(&options(&image, folder.path()), &HOME);
    bench.approach(0.015);
    bench.until(Phase::Coupled, 15_000);
    bench.pose(1, 0.1);
    bench.until(Phase::Recording, 5_000);
    bench.until(Phase::Coupled, 5_000);
    let log = log_of(bench, folder.path());
    let stack = numbers(&log, "ended:");
    let [used, room, ..] = stack[..] else { panic!("{log}") };
    let (used, room) = (used as u32, room as u32);
    assert_eq!(room, stack_room(&image), "the image and its ELF disagree");
    let (bounds, rooms) = ([bound(&MPS2), bound(&NUCLEO)], [room, stack_room(&nucleo)]);
    assert!(
        used <= bounds[0],
        "{used} bytes were used, more than the bound of {bounds:?}"
    );
    for (bound, room) in bounds.iter().zip(rooms) {
        assert!(3 * bound <= 2 * room, "{bound} bytes of stack may be used of {room}");
    }
    let (here, there) = (sizes(&image), sizes(&nucleo));
    let row = |name: &str, here: u32, there: Option<u32>| (name.to_owned(), vec![Some(here), there]);
    let rows = [
        row("text: code and constants", here.text, Some(there.text)),
        row("data", here.data, Some(there.data)),
        row("bss", here.bss, Some(there.bss)),
        row("stack, bound", bounds[0], Some(bounds[1])),
        row("stack, room", rooms[0], Some(rooms[1])),
    ];
    compare("memory", "| bytes | mps2-an500 | nucleo-h743zi |", &rows, 0.05, 256.0);
}
