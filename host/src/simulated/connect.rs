//! The device of a run, with the injected faults around it.

use std::path::PathBuf;
use std::time::Duration;

use spherecal_job::connect::{controller, reliable};
use spherecal_job::{ConnectedDevice, Connection, FaultyJournal, JobError, Link, PreparedRun};
use spherecal_link::qemu::{Qemu, QemuOptions};
use spherecal_link::tcp::RemoteDrive;
use spherecal_link::{
    Controller, Device, Drive as _, Injected, JournalError, LinkError, check_drive, controller_in_process,
};
use spherecal_sim::inject::{FaultPlan, FaultyCell, FaultyDrive, FileLock, HostFaultJournal};
use spherecal_sim::{InjectedCounter, LossyDevice, simulated_arm};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{ConnectOptions as _, Connection as _, Executor as _, SqliteConnection};
use tokio::runtime::Runtime;

use super::{SimulationError, plant};

/// The device behind a link, with the faults of `inject` and the losses of `[host_link]`.
pub(super) fn connect(
    inject: Option<&FaultPlan>,
    prepared: &PreparedRun,
    connection: Connection<'_>,
) -> Result<ConnectedDevice, JobError> {
    if let Some(plan) = inject.filter(|_| !connection.in_file) {
        plan.check_without_file().map_err(SimulationError::from)?;
    }
    // A repeated run skips the moment at which its host was killed.
    let inject = inject.map(|plan| {
        if connection.repeated {
            plan.without_kills()
        } else {
            plan.clone()
        }
    });
    let mut counters: Vec<InjectedCounter> = Vec::new();
    let mut journal = None;
    let mut device: Box<dyn Device> = match (connection.early, &inject) {
        (Some(device), _) => device,
        (None, None) => reliable(prepared, connection.link, connection.folder)?,
        (None, Some(plan)) => {
            let cell = faulty(prepared, connection.link, connection.folder, plan)?;
            counters.push(cell.injected());
            let faults = cell.host_faults();
            let around: FaultyJournal = Box::new(move |journal, path| {
                Box::new(HostFaultJournal::new(
                    journal,
                    faults.clone(),
                    path.clone(),
                    file_lock(path),
                ))
            });
            journal = Some(around);
            Box::new(cell)
        }
    };
    let lossy = inject
        .and_then(|plan| plan.host_link)
        .unwrap_or(prepared.config.host_link);
    if lossy.is_active() {
        let around = LossyDevice::new(device, lossy);
        counters.push(around.injected());
        device = Box::new(around);
    }
    Ok(ConnectedDevice {
        device,
        journal,
        injected: Box::new(move || {
            counters
                .iter()
                .fold(Injected::default(), |sum, one| sum.plus(one.get()))
        }),
    })
}

/// A controller and a drive in lock-step, with faults between them.
fn faulty(
    prepared: &PreparedRun,
    link: &Link,
    folder: &std::path::Path,
    plan: &FaultPlan,
) -> Result<FaultyCell, JobError> {
    let joints = prepared.robot.dof();
    let drive = match link {
        Link::Tcp(address) => FaultyDrive::Other(Box::new(lock_step_drive(prepared, link, address)?)),
        Link::Serial(_)
        | Link::Udp(_)
        | Link::Controller(_)
        | Link::Grpc(_)
        | Link::Franka { .. }
        | Link::Fri(_)
        | Link::Ur { .. } => {
            return Err(no_injection(link));
        }
        Link::Sim | Link::Qemu => {
            let (robot, tool, home) = (&prepared.robot, &prepared.tool, &prepared.plan.home.joints);
            let plant = plant(&prepared.config)?;
            let arm = simulated_arm(robot, tool, &plant, home);
            FaultyDrive::Simulated(arm.map_err(SimulationError::from)?)
        }
    };
    let first = controller(prepared, link, folder)?;
    let (link, folder) = (link.clone(), folder.to_owned());
    let restart = Box::new(move || match link {
        Link::Qemu => Ok(Box::new(Qemu::start(&QemuOptions::new(&folder))?) as Box<dyn Controller>),
        _ => controller_in_process(joints),
    });
    let cell = FaultyCell::new(first, drive, joints, plan, restart).map_err(SimulationError::from)?;
    Ok(cell.ending_process())
}

/// A drive in lock-step, as fault injection needs it.
fn lock_step_drive(prepared: &PreparedRun, link: &Link, address: &str) -> Result<RemoteDrive, JobError> {
    let drive = RemoteDrive::connect(address).map_err(LinkError::from)?;
    check_drive(drive.hello(), &prepared.robot)?;
    if drive.hello().lock_step {
        Ok(drive)
    } else {
        Err(no_injection(link))
    }
}

fn no_injection(link: &Link) -> JobError {
    JobError::NoInjection {
        link: link.to_string(),
        remedy: "faults can be injected only between a controller and a drive in lock-step: use sim, qemu or the tcp: link of such a drive"
            .to_owned(),
    }
}

/// Locks the SQLite file at `path` for a time, as another program would: with a separate connection
/// on a separate thread.
pub fn file_lock(path: PathBuf) -> FileLock {
    Box::new(move |time| lock(path.clone(), time))
}

/// Returns when the file is locked.
fn lock(path: PathBuf, time: Duration) -> Result<(), JournalError> {
    let (told, held) = std::sync::mpsc::sync_channel(1);
    std::thread::spawn(move || {
        let runtime = match tokio::runtime::Builder::new_current_thread().enable_all().build() {
            Ok(runtime) => runtime,
            Err(error) => return drop(told.send(Err(JournalError::store(error)))),
        };
        let connection = match runtime.block_on(locked(&path)) {
            Ok(connection) => connection,
            Err(error) => return drop(told.send(Err(JournalError::store(error)))),
        };
        drop(told.send(Ok(())));
        std::thread::sleep(time);
        unlock(&runtime, connection);
    });
    // A thread that ended without a message holds no lock.
    held.recv().unwrap_or(Ok(()))
}

async fn locked(path: &std::path::Path) -> Result<SqliteConnection, sqlx::Error> {
    let mut connection = SqliteConnectOptions::new().filename(path).connect().await?;
    connection.execute("BEGIN EXCLUSIVE").await?;
    Ok(connection)
}

/// Closing gives up the lock.
fn unlock(runtime: &Runtime, connection: SqliteConnection) {
    drop(runtime.block_on(connection.close()));
}
