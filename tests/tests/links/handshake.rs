//! Who greets whom: a controller that does not belong to this program is
//! refused with the remedy, before any command moves the arm.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

use spherecal::campaign::{Assignment, CampaignError, RunOptions, Silent, run};
use spherecal::link::{Device, Drive, LinkError, LocalDevice, controller_in_process};
use spherecal::sim::plant::PlantConfig;
use spherecal::sim::simulated_arm;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::frame::{self, Accumulator};
use spherecal_shared::protocol::host::{Banner, Event, Uplink};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};
use spherecal_tests::bench::framed;
use spherecal_tests::plan::{Memory, carry_out, cell, plant, short_plan};

/// A controller that says something else than it is.
struct Forged {
    cell: LocalDevice,
    accumulator: Accumulator,
    forge: fn(Uplink) -> Vec<u8>,
    frames: u32,
}

impl Device for Forged {
    fn now_us(&self) -> u64 {
        self.cell.now_us()
    }

    fn ticks(&self) -> u64 {
        self.cell.ticks()
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        let mut honest = Vec::new();
        self.cell.step(down, &mut honest)?;
        for byte in honest {
            self.accumulator.push(byte, &mut |frame| {
                let (_, uplink) = frame::decode::<Uplink>(frame.expect("whole")).expect("an uplink");
                up.extend((self.forge)(uplink));
                self.frames += 1;
            });
        }
        Ok(())
    }
}

/// What a campaign says of a controller whose words are forged.
fn attempt_handshake(forge: fn(Uplink) -> Vec<u8>) -> Result<(), CampaignError> {
    let (robot, tool, config) = (iiwa7(), iiwa7_tool(), PlantConfig::typical());
    let plan = short_plan(&config, &[1], &[0.0]);
    let drive = simulated_arm(&robot, &tool, &config, &plan.home.joints).expect("a plant");
    let cell = LocalDevice::new(controller_in_process(7).expect("a controller"), drive, 7).expect("a cell");
    let mut device = Forged {
        cell,
        accumulator: Accumulator::new(),
        forge,
        frames: 0,
    };
    let procedure = Procedure::default();
    let assignment = Assignment {
        robot: &robot,
        tool: &tool,
        procedure: &procedure,
        plan: &plan,
        done: &BTreeSet::new(),
        seated: &[],
        options: RunOptions::default(),
    };
    let (mut memory, stop) = (Memory::default(), AtomicBool::new(false));
    let (outcome, result) = run(&assignment, &mut device, &mut memory, &mut Silent, &stop);
    assert!(device.frames > 0, "the controller spoke");
    assert_eq!((outcome.contacts.len(), memory.recordings.len()), (0, 0));
    result
}

/// The uplink as it is, but for the banner.
fn with_banner(mut uplink: Uplink, change: fn(&mut Banner)) -> Vec<u8> {
    if let Event::Banner(banner) = &mut uplink.body {
        change(banner);
    }
    framed(&uplink, 0)
}

fn refused(forge: fn(Uplink) -> Vec<u8>) -> (CampaignError, String) {
    let error = attempt_handshake(forge).expect_err("it must be refused");
    let text = error.to_string();
    (error, text)
}

// Fails if a controller of another protocol, schema, version or number of joints
// is worked with, or refused without saying what to do.
#[test]
fn a_controller_that_does_not_belong_is_refused_with_the_remedy() {
    let (error, text) = refused(|up| with_banner(up, |banner| banner.protocol += 1));
    assert!(matches!(error, CampaignError::Protocol { .. }), "{text}");
    assert!(
        text.contains("use a firmware and a program of the same version"),
        "{text}"
    );

    let (error, text) = refused(|up| with_banner(up, |banner| banner.schema ^= 1));
    assert!(matches!(error, CampaignError::Schema { .. }), "{text}");
    assert!(
        text.contains("build firmware and program from the same sources"),
        "{text}"
    );
    assert!(text.contains("build in-process"), "{text}");

    let (error, text) = refused(|up| {
        with_banner(up, |banner| {
            banner.version.clear();
            let _ = banner.version.push_str("9.9.9");
        })
    });
    assert!(matches!(error, CampaignError::Version { .. }), "{text}");
    assert!(text.contains("9.9.9 (build in-process)"), "{text}");

    let (error, text) = refused(|up| with_banner(up, |banner| banner.joints = 6));
    assert!(matches!(error, CampaignError::Joints { .. }), "{text}");
    assert!(text.contains("use the controller for this robot"), "{text}");
}

// Fails if a controller whose every frame is of another schema looks like one
// that is silent.
#[test]
fn a_controller_that_is_not_understood_is_said_to_be_of_another_schema() {
    let (error, text) = refused(|_| framed(&DriveState::default(), 0));
    assert!(matches!(error, CampaignError::Schema { .. }), "{text}");
    assert!(text.contains("scripts/cross.sh build"), "{text}");
}

/// A drive whose controller misses ten periods before one exchange.
struct HeldUp {
    drive: Box<dyn Drive>,
    exchanges: u32,
    at: u32,
}

impl Drive for HeldUp {
    fn hello(&self) -> &DriveHello {
        self.drive.hello()
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        self.exchanges += 1;
        // The drive goes on meanwhile.
        for _ in 0..self.missed() {
            self.drive.exchange(command, state)?;
        }
        self.drive.exchange(command, state)
    }

    fn missed(&self) -> u32 {
        if self.exchanges == self.at { 10 } else { 0 }
    }
}

// Fails if a fault at any instant of the handshake, before or between its steps, ends the session.
#[test]
fn a_fault_during_the_handshake_is_cleared() {
    let typical = PlantConfig::typical();
    let short = short_plan(&typical, &[1], &[0.0]);
    let all = short
        .spheres
        .iter()
        .flat_map(|visit| visit.poses.iter().map(|pose| (visit.sphere_id, pose.id)));
    let done: BTreeSet<(u32, u32)> = all.collect();
    // The controller is configured after about 750 periods.
    for at in 1..1200 {
        let drive = HeldUp {
            drive: plant(&typical, &short),
            exchanges: 0,
            at,
        };
        let (_, _, result) = carry_out(&mut cell(Box::new(drive)), &short, &done);
        assert!(result.is_ok(), "held up at {at}: {result:?}");
    }
}
