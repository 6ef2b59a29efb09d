//! A short plan of the spheres, a journal in memory and the cell of one process,
//! for tests that run a campaign.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;

use nalgebra::{Matrix3, Rotation3, SVector, UnitQuaternion, Vector3};
use spherecal::campaign::{Assignment, CampaignError, CampaignObserver, Outcome, RunOptions, Silent, run};
use spherecal::job::{Link, Measurements, PreparedRun, Site, measure, read};
use spherecal::link::{Arrival, Device, Drive, Journal, JournalError, LocalDevice, controller_in_process};
use spherecal::plan::{Plan, PlannedPose, Visit, Waypoint};
use spherecal::sim::plant::PlantConfig;
use spherecal::sim::simulated_arm;
use spherecal::store::{CalibrationStore as _, SqlStore};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{Event, Recording};
use spherecal_shared::robot::elbow::elbow;
use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

/// Everything that was stored, in memory.
#[derive(Default)]
pub struct Memory {
    /// Recordings, in the order in which they were stored.
    pub recordings: Vec<Recording>,
    /// All events that were stored, recordings included.
    pub events: Vec<Event>,
}

impl Journal for Memory {
    fn append(&mut self, events: &[Arrival]) -> Result<(), JournalError> {
        for arrival in events {
            if let Event::Recording(recording) = &arrival.body {
                self.recordings.push(recording.clone());
            }
            self.events.push(arrival.body.clone());
        }
        Ok(())
    }

    fn reject(&mut self, _: u32, _: u32, _: &str) -> Result<(), JournalError> {
        Ok(())
    }
}

/// Joint angles that bring the TCP to `position` (F0, in m) with axes
/// `rotation`: damped least squares from `seed`, on the nominal arm.
///
/// # Panics
/// When it does not converge.
pub fn solve(arm: &Arm<f64, 7>, position: Vector3<f64>, rotation: Matrix3<f64>, seed: [f64; 7]) -> [f64; 7] {
    let mut q = SVector::<f64, 7>::from(seed);
    for _ in 0..500 {
        let frames = arm.frames(&q.data.0[0]);
        let tcp = arm.tcp_frame(&frames);
        let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
            rotation * tcp.rotation.transpose(),
        ))
        .scaled_axis();
        let mut error = SVector::<f64, 6>::zeros();
        error.fixed_rows_mut::<3>(0).copy_from(&(position - tcp.position));
        error.fixed_rows_mut::<3>(3).copy_from(&turn);
        let jacobian = arm.jacobian(&frames, &tcp.position);
        let normal = jacobian * jacobian.transpose() + nalgebra::SMatrix::<f64, 6, 6>::identity() * 1e-4;
        let step = jacobian.transpose() * normal.cholesky().expect("positive definite").solve(&error);
        q += step * (0.1 / step.norm()).min(1.0);
    }
    let tcp = arm.tcp_frame(&arm.frames(&q.data.0[0]));
    assert!(
        (tcp.position - position).norm() < 1e-6,
        "inverse kinematics did not converge"
    );
    q.data.0[0]
}

/// A plan of `spheres` (indices into the plate) with one pose for each angle
/// (rad) in `turns`, about F0's x axis, planned on the nominal arm.
///
/// # Panics
/// When a pose is out of reach.
pub fn short_plan(config: &PlantConfig, spheres: &[usize], turns: &[f64]) -> Plan {
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("an arm");
    let [roll, pitch, yaw] = config.cell.first().rpy_rad;
    let plate = Rotation3::from_euler_angles(roll, pitch, yaw);
    let down = -(plate * Vector3::z());
    let x = (plate * Vector3::x() - down * down.dot(&(plate * Vector3::x()))).normalize();
    let facing = Matrix3::from_columns(&[x, down.cross(&x), down]);
    let seed = [0.0, 0.5, 0.0, -1.5, 0.0, 1.1, 0.0];
    let waypoint = |q: [f64; 7]| Waypoint {
        joints: q.to_vec(),
        ..Waypoint::default()
    };
    let visits = spheres
        .iter()
        .map(|&k| {
            let centre =
                Vector3::from(config.cell.first().origin_m) + plate * Vector3::from(config.cell.plate.spheres_m[k]);
            let approach = solve(&arm, centre - down * 0.03, facing, seed);
            let poses = turns
                .iter()
                .zip(0..)
                .map(|(&angle, pose)| {
                    let rotation = Rotation3::from_axis_angle(&Vector3::x_axis(), angle).matrix() * facing;
                    let q = solve(&arm, centre, rotation, approach);
                    let quaternion = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
                    PlannedPose {
                        id: pose,
                        orientation: [quaternion.w, quaternion.i, quaternion.j, quaternion.k],
                        elbow_rad: elbow(&arm.frames(&q)).map(|e| e.angle),
                        joints: q.to_vec(),
                        via: false,
                    }
                })
                .collect();
            Visit {
                sphere_id: k as u32 + 1,
                place: 0,
                position_m: centre.into(),
                over_home: true,
                approach: waypoint(approach),
                approach_direction: down.into(),
                poses,
            }
        })
        .collect();
    let above = Vector3::from(config.cell.first().origin_m) - down * 0.15;
    Plan {
        home: waypoint(solve(&arm, above, facing, seed)),
        spheres: visits,
        ..Plan::default()
    }
}

/// The simulated iiwa 7 of `config`, at the plan's home.
///
/// # Panics
/// When there is no such plant.
pub fn plant(config: &PlantConfig, plan: &Plan) -> Box<dyn Drive> {
    simulated_arm(&iiwa7(), &iiwa7_tool(), config, &plan.home.joints).expect("a plant")
}

/// Every sphere of the plan is coupled once.
pub const ONCE: RunOptions = RunOptions {
    second_visits: false,
    ..RunOptions::DEFAULT
};

/// The controller in this process, on `drive`.
///
/// # Panics
/// When the drive is not an arm of seven joints.
pub fn cell(drive: Box<dyn Drive>) -> LocalDevice {
    LocalDevice::new(controller_in_process(7).expect("a controller"), drive, 7).expect("a cell")
}

/// Carries out `plan` with the default procedure and without second visits on whatever stands behind the
/// host link, all but the (sphere, pose) pairs in `done`.
pub fn carry_out(
    device: &mut dyn Device,
    plan: &Plan,
    done: &BTreeSet<(u32, u32)>,
) -> (Memory, Outcome, Result<(), CampaignError>) {
    carry_out_with(device, plan, done, &Procedure::default(), ONCE)
}

/// Like [`carry_out`], with another procedure and other options.
pub fn carry_out_with(
    device: &mut dyn Device,
    plan: &Plan,
    done: &BTreeSet<(u32, u32)>,
    procedure: &Procedure,
    options: RunOptions,
) -> (Memory, Outcome, Result<(), CampaignError>) {
    carry_out_observed(device, plan, done, procedure, options, &mut Silent)
}

/// Like [`carry_out_with`], before the eyes of `observer`.
pub fn carry_out_observed(
    device: &mut dyn Device,
    plan: &Plan,
    done: &BTreeSet<(u32, u32)>,
    procedure: &Procedure,
    options: RunOptions,
    observer: &mut dyn CampaignObserver,
) -> (Memory, Outcome, Result<(), CampaignError>) {
    let (robot, tool) = (iiwa7(), iiwa7_tool());
    let assignment = Assignment {
        robot: &robot,
        tool: &tool,
        procedure,
        plan,
        done,
        seated: &[],
        options,
    };
    let mut memory = Memory::default();
    let (outcome, result) = run(&assignment, device, &mut memory, observer, &AtomicBool::new(false));
    (memory, outcome, result)
}

/// What `prepared` measures on the simulated arm, out of a store of its own.
///
/// # Panics
/// When it does not end well.
pub fn measured(prepared: &PreparedRun) -> Measurements {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = SqlStore::create_or_open(&folder.path().join("calibration.db")).expect("a database");
    let site = Site {
        link: &Link::Sim,
        tracker: None,
        folder: folder.path(),
        store: &mut store,
        observer: &mut Silent,
        interrupt: &AtomicBool::new(false),
        device: None,
    };
    measure(prepared, site, None).expect("measured to the end");
    let info = store.require_last_run().expect("a run");
    read(&mut store, &info).expect("read")
}
