//! The controller on a Cortex-M7 in QEMU computes what it computes in this
//! process, bit by bit, over the whole procedure on a sphere.

use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex};

use spherecal::campaign::Outcome;
use spherecal::link::qemu::{Qemu, QemuOptions, TickCost};
use spherecal::link::{Controller, LinkError, LocalDevice, controller_in_process};
use spherecal::plan::Plan;
use spherecal::sim::plant::PlantConfig;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_tests::costs::compare;
use spherecal_tests::plan::{Memory, carry_out, plant, short_plan};
use spherecal_tests::qemu::image;

/// What a controller was told and what it answered, bit by bit.
#[derive(Clone, Debug, Default, PartialEq)]
struct Trace {
    ticks: Vec<[u64; 15]>,
    costs: Vec<TickCost>,
}

/// Bits of a tick: its number, the joint angles and the torques.
fn bits(state: &DriveState, command: &DriveCommand) -> [u64; 15] {
    let mut out = [0; 15];
    out[0] = command.tick;
    for (slot, value) in out[1..].iter_mut().zip(state.q.iter().chain(&command.tau)) {
        *slot = value.to_bits();
    }
    out
}

/// A controller that keeps a trace.
struct Traced<C> {
    inner: C,
    trace: Arc<Mutex<Trace>>,
    cost: fn(&C) -> TickCost,
}

impl<C: Controller> Controller for Traced<C> {
    fn connect(&mut self, hello: &DriveHello) -> Result<(), LinkError> {
        self.inner.connect(hello)
    }

    fn exchange(
        &mut self,
        now_us: u64,
        state: &DriveState,
        down: &[u8],
        up: &mut Vec<u8>,
    ) -> Result<DriveCommand, LinkError> {
        let command = self.inner.exchange(now_us, state, down, up)?;
        let mut trace = self.trace.lock().expect("one thread");
        trace.ticks.push(bits(state, &command));
        trace.costs.push((self.cost)(&self.inner));
        Ok(command)
    }
}

struct Boxed(Box<dyn Controller>);

impl Controller for Boxed {
    fn connect(&mut self, hello: &DriveHello) -> Result<(), LinkError> {
        self.0.connect(hello)
    }

    fn exchange(
        &mut self,
        now_us: u64,
        state: &DriveState,
        down: &[u8],
        up: &mut Vec<u8>,
    ) -> Result<DriveCommand, LinkError> {
        self.0.exchange(now_us, state, down, up)
    }
}

fn traced<C: Controller + 'static>(
    config: &PlantConfig,
    plan: &Plan,
    inner: C,
    cost: fn(&C) -> TickCost,
) -> (Memory, Outcome, Trace) {
    let trace = Arc::new(Mutex::new(Trace::default()));
    let controller = Traced {
        inner,
        trace: trace.clone(),
        cost,
    };
    let mut cell = LocalDevice::new(Box::new(controller), plant(config, plan), 7).expect("a cell");
    let (memory, outcome, result) = carry_out(&mut cell, plan, &BTreeSet::new());
    result.expect("the campaign ends well");
    let trace = trace.lock().expect("one thread").clone();
    (memory, outcome, trace)
}

fn in_qemu(config: &PlantConfig, plan: &Plan, image: &Path, folder: &Path) -> (Memory, Outcome, Trace) {
    let options = QemuOptions {
        image: Some(image.to_path_buf()),
        record: std::env::var_os("SPHERECAL_RECORD_TURNS").map(Into::into),
        ..QemuOptions::new(folder)
    };
    let qemu = Qemu::start(&options).expect("QEMU starts");
    traced(config, plan, qemu, Qemu::cost)
}

// Fails if one bit of one torque or recording differs between the controller in
// this process and the one in QEMU, contact included.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_sphere_of_five_poses_is_the_same_in_every_bit() {
    let Some(image) = image() else { return };
    let config = PlantConfig::typical();
    let plan = short_plan(&config, &[1], &[0.0, 0.15, -0.1, 0.1, -0.15]);
    let in_process = Boxed(controller_in_process(7).expect("a controller"));
    let (here, outcome, expected) = traced(&config, &plan, in_process, |_| TickCost::default());
    assert_eq!((here.recordings.len(), outcome.faults.len()), (5, 0));
    assert_eq!(outcome.contacts.len(), 1);
    assert!(expected.ticks.len() >= 10_000, "only {} ticks", expected.ticks.len());

    let folder = tempfile::tempdir().expect("a folder");
    let start = std::time::Instant::now();
    let (there, outcome, trace) = in_qemu(&config, &plan, &image, folder.path());
    let seconds = start.elapsed().as_secs_f64();
    eprintln!(
        "{} ticks in QEMU, {:.0} a second",
        trace.ticks.len(),
        trace.ticks.len() as f64 / seconds
    );
    let costs: Vec<_> = trace.costs.iter().map(|c| c.tick).collect();
    let mean = costs.iter().map(|&c| f64::from(c)).sum::<f64>() / costs.len() as f64;
    let worst = costs.iter().copied().max().unwrap_or(0);
    eprintln!("tick: mean {mean:.0}, worst {worst} instructions");
    for (tick, (a, b)) in expected.ticks.iter().zip(&trace.ticks).enumerate() {
        assert_eq!(a, b, "tick {tick} differs");
    }
    assert_eq!(expected.ticks.len(), trace.ticks.len());
    assert_eq!(here.recordings, there.recordings);
    assert_eq!(outcome.faults.len(), 0);
    let row = |name: &str, value: u32| (name.to_owned(), vec![Some(value)]);
    let rows = [row("on average", mean as u32), row("at worst", worst)];
    compare("run", "| a tick on the sphere | instructions |", &rows, 0.05, 0.0);
    // The budget, over the whole procedure.
    assert!(mean <= 28_000.0, "a tick takes {mean:.0} instructions on average");
    assert!(worst <= 35_000, "a tick took {worst} instructions");
    let log = std::fs::read_to_string(folder.path().join("controller.log")).expect("a log");
    let ended = log.lines().find(|line| line.contains("ended:")).expect("last words");
    eprintln!("{ended}");
    let numbers: Vec<usize> = ended.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let [used, room, ..] = numbers[..] else {
        panic!("{ended}")
    };
    assert!(2 * used <= room, "{used} bytes of stack used of {room}");
}
