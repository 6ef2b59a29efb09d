//! Converts between the project's types and the messages, bit by bit. Numbers are neither rounded
//! nor scaled, so a round trip gives an equal value.

use serde::de::DeserializeOwned;
use spherecal_shared::protocol::host::{
    Contact, Coupled, Event, FaultReport, PhaseChange, Recording, Sample, SessionId, SignalStatistics,
};

use super::proto;
use spherecal_link::Arrival;
use spherecal_model::{LaserShot, Sphere, name_of};
use spherecal_store::{NewRun, RunInfo, SessionEnd, StoredPose};

/// A text in a message that matches no type, or a list of the wrong length; in words.
pub(super) type Malformed = String;

fn named<T: DeserializeOwned>(field: &str, name: String) -> Result<T, Malformed> {
    serde_json::from_value(serde_json::Value::String(name.clone())).map_err(|_| format!("{field} is \"{name}\""))
}

fn list<const N: usize>(field: &str, values: &[f64]) -> Result<[f64; N], Malformed> {
    finite(field, values)?;
    values
        .try_into()
        .map_err(|_| format!("{field} has {} numbers, not {N}", values.len()))
}

/// A store that took a number that is not finite could not be read again.
fn finite(field: &str, values: &[f64]) -> Result<(), Malformed> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(format!("{field} has the number {value}, which is not finite")),
        None => Ok(()),
    }
}

/// A run's state from the wire.
pub(super) fn state_of_run(state: &str) -> Result<(), Malformed> {
    if RunInfo::STATES.contains(&state) {
        Ok(())
    } else {
        Err(format!(
            "state is {state:?}: give one of {}",
            RunInfo::STATES.join(", ")
        ))
    }
}

/// An event for the wire, with its number and the time when it was sent, where
/// they are known; `None` for what is not kept (telemetry, replies).
pub(super) fn event(number: u32, sent_us: u64, body: &Event) -> Option<proto::Event> {
    use proto::event::Body;
    let body = match body {
        Event::Phase(phase) => Body::Phase(phase_change(phase)),
        Event::Contact(contact) => Body::Contact(contact_out(contact)),
        Event::Coupled(coupled) => Body::Coupled(coupled_out(coupled)),
        Event::Recording(recording) => Body::Recording(recording_out(recording)),
        Event::Fault(fault) => Body::Fault(fault_out(fault)),
        Event::Passed { pose } => Body::Passed(*pose),
        Event::Banner(_) | Event::Held { .. } | Event::Reply { .. } | Event::Telemetry(_) | Event::Statistics(_) => {
            return None;
        }
    };
    Some(proto::Event {
        event: number,
        sent_us,
        body: Some(body),
    })
}

pub(super) fn arrival(event: proto::Event) -> Result<Arrival, Malformed> {
    use proto::event::Body;
    let body = match event.body.ok_or("an event without a body")? {
        Body::Phase(m) => Event::Phase(PhaseChange {
            phase: named("phase", m.phase)?,
            from: named("previous", m.previous)?,
            time_us: m.time_us,
            tick: m.tick,
        }),
        Body::Contact(m) => Event::Contact(Contact {
            sphere: m.sphere,
            time_us: m.time_us,
            force_n: m.force_n.unwrap_or_default(),
            peak_n: m.peak_n.unwrap_or_default(),
            tare_n: list("tare_n", &m.tare_n)?,
            tcp_m: list("tcp_m", &m.tcp_m)?,
            travel_m: m.travel_m.unwrap_or_default(),
            latency_ticks: m.latency_ticks,
            early_crossings: m.early_crossings,
        }),
        Body::Coupled(m) => Event::Coupled(Coupled {
            sphere: m.sphere,
            time_us: m.time_us,
            centre_m: list("centre_m", &m.centre_m)?,
            shift_m: m.shift_m.unwrap_or_default(),
            test_m: m.test_m.unwrap_or_default(),
        }),
        Body::Recording(m) => Event::Recording(recording(m)?),
        Body::Fault(m) => Event::Fault(FaultReport {
            fault: named("fault", m.fault)?,
            phase: named("phase", m.phase)?,
            time_us: m.time_us,
            tick: m.tick,
            joint: u8::try_from(m.joint).map_err(|_| format!("joint is {}", m.joint))?,
            value: m.value.unwrap_or_default(),
            limit: m.limit.unwrap_or_default(),
        }),
        Body::Passed(pose) => Event::Passed { pose },
    };
    Ok(Arrival {
        // Its place is sent beside it (PlacedEvent).
        session: SessionId::default(),
        event: event.event,
        sent_us: event.sent_us,
        body,
    })
}

fn phase_change(phase: &PhaseChange) -> proto::PhaseChange {
    proto::PhaseChange {
        phase: name_of(phase.phase),
        previous: name_of(phase.from),
        time_us: phase.time_us,
        tick: phase.tick,
    }
}

fn contact_out(contact: &Contact) -> proto::Contact {
    proto::Contact {
        sphere: contact.sphere,
        time_us: contact.time_us,
        force_n: Some(contact.force_n),
        peak_n: Some(contact.peak_n),
        tare_n: contact.tare_n.to_vec(),
        tcp_m: contact.tcp_m.to_vec(),
        travel_m: Some(contact.travel_m),
        latency_ticks: contact.latency_ticks,
        early_crossings: contact.early_crossings,
    }
}

fn coupled_out(coupled: &Coupled) -> proto::Coupled {
    proto::Coupled {
        sphere: coupled.sphere,
        time_us: coupled.time_us,
        centre_m: coupled.centre_m.to_vec(),
        shift_m: Some(coupled.shift_m),
        test_m: Some(coupled.test_m),
    }
}

fn fault_out(report: &FaultReport) -> proto::Fault {
    proto::Fault {
        fault: name_of(report.fault),
        phase: name_of(report.phase),
        time_us: report.time_us,
        tick: report.tick,
        joint: u32::from(report.joint),
        value: Some(report.value),
        limit: Some(report.limit),
    }
}

pub(super) fn recording_out(recording: &Recording) -> proto::Recording {
    let signals = |signals: &[SignalStatistics]| {
        signals
            .iter()
            .map(|s| proto::Signal {
                mean: Some(s.mean),
                std: Some(s.std),
                min: Some(s.min),
                max: Some(s.max),
            })
            .collect()
    };
    proto::Recording {
        sphere: recording.sphere,
        pose: recording.pose,
        start_us: recording.start_us,
        end_us: recording.end_us,
        count: recording.count,
        gaps: recording.gaps,
        q: signals(&recording.q),
        tau: signals(&recording.tau),
        tcp_spread_m: Some(recording.tcp_spread_m),
        force_n: recording.force_n.to_vec(),
    }
}

pub(super) fn recording(m: proto::Recording) -> Result<Recording, Malformed> {
    let signals = |field: &str, signals: &[proto::Signal]| {
        let mut out = heapless::Vec::new();
        for s in signals {
            let signal = SignalStatistics {
                mean: s.mean.unwrap_or_default(),
                std: s.std.unwrap_or_default(),
                min: s.min.unwrap_or_default(),
                max: s.max.unwrap_or_default(),
            };
            finite(field, &[signal.mean, signal.std, signal.min, signal.max])?;
            out.push(signal)
                .map_err(|_| format!("{field} has {} joints", signals.len()))?;
        }
        Ok::<_, Malformed>(out)
    };
    Ok(Recording {
        sphere: m.sphere,
        pose: m.pose,
        start_us: m.start_us,
        end_us: m.end_us,
        count: m.count,
        gaps: m.gaps,
        q: signals("q", &m.q)?,
        tau: signals("tau", &m.tau)?,
        tcp_spread_m: m.tcp_spread_m.unwrap_or_default(),
        force_n: list("force_n", &m.force_n)?,
    })
}

/// The newest telemetry of a robot with `joints` joints.
pub(super) fn state(sample: &Sample, joints: usize) -> proto::RobotState {
    let wide = |values: &[f32]| values.iter().take(joints).map(|v| f64::from(*v)).collect();
    proto::RobotState {
        tick: sample.tick,
        phase: name_of(sample.phase),
        q_rad: wide(&sample.q),
        dq_rad_s: wide(&sample.dq),
        tau_nm: wide(&sample.tau),
        force_n: wide(&sample.force_n),
        tcp_m: wide(&sample.tcp_m),
    }
}

pub(super) fn spheres_out(spheres: &[Sphere]) -> Vec<proto::Sphere> {
    spheres
        .iter()
        .map(|s| proto::Sphere {
            id: s.id,
            position_m: s.position_m.to_vec(),
            sigma_m: s.sigma_m,
        })
        .collect()
}

pub(super) fn spheres(messages: &[proto::Sphere]) -> Result<Vec<Sphere>, Malformed> {
    messages
        .iter()
        .map(|m| {
            Ok(Sphere {
                id: m.id,
                position_m: list("position_m", &m.position_m)?,
                sigma_m: {
                    finite("sigma_m", &[m.sigma_m])?;
                    m.sigma_m
                },
            })
        })
        .collect()
}

pub(super) fn new_run_out(new: &NewRun) -> Result<proto::NewRun, Malformed> {
    let json = |e: serde_json::Error| e.to_string();
    Ok(proto::NewRun {
        created_utc: new.created_utc.clone(),
        seed: new.seed,
        link: new.link.clone(),
        robot_json: serde_json::to_string(&new.robot).map_err(json)?,
        tool_json: serde_json::to_string(&new.tool).map_err(json)?,
        config_toml: new.config_toml.clone(),
        plan_json: new.plan_json.clone(),
        program: new.program.clone(),
        spheres: spheres_out(&new.spheres),
        poses: new
            .poses
            .iter()
            .map(|p| proto::PlannedPose {
                sphere: p.sphere,
                pose: p.pose,
                orientation: p.orientation.to_vec(),
                elbow_rad: p.elbow_rad,
            })
            .collect(),
        arm: new.arm.clone(),
    })
}

pub(super) fn new_run(m: proto::NewRun) -> Result<NewRun, Malformed> {
    let poses = m.poses.iter().map(|p| {
        Ok(StoredPose {
            sphere: p.sphere,
            pose: p.pose,
            orientation: {
                finite("elbow_rad", p.elbow_rad.as_slice())?;
                list("orientation", &p.orientation)?
            },
            elbow_rad: p.elbow_rad,
        })
    });
    Ok(NewRun {
        poses: poses.collect::<Result<_, Malformed>>()?,
        created_utc: m.created_utc,
        seed: m.seed,
        link: m.link,
        robot: serde_json::from_str(&m.robot_json).map_err(|e| format!("robot_json: {e}"))?,
        tool: serde_json::from_str(&m.tool_json).map_err(|e| format!("tool_json: {e}"))?,
        config_toml: m.config_toml,
        plan_json: m.plan_json,
        program: m.program,
        spheres: spheres(&m.spheres)?,
        arm: m.arm,
    })
}

pub(super) fn session_out(run: i64, session: i64, end: &SessionEnd) -> proto::SessionEnd {
    proto::SessionEnd {
        run,
        session,
        firmware: end.firmware.clone(),
        simulated_us: end.simulated_us,
        ticks: end.ticks,
        wall_s: end.wall_s,
        link_json: end.link_json.clone(),
        telemetry_json: end.telemetry_json.clone(),
    }
}

pub(super) fn session(m: proto::SessionEnd) -> SessionEnd {
    SessionEnd {
        firmware: m.firmware,
        simulated_us: m.simulated_us,
        ticks: m.ticks,
        wall_s: m.wall_s,
        link_json: m.link_json,
        telemetry_json: m.telemetry_json,
    }
}

pub(super) fn laser_out(shots: &[LaserShot]) -> Vec<proto::LaserShot> {
    shots
        .iter()
        .map(|s| proto::LaserShot {
            purpose: s.purpose.clone(),
            q_rad: s.q.clone(),
            point_m: s.point_m.to_vec(),
        })
        .collect()
}

pub(super) fn laser(messages: Vec<proto::LaserShot>) -> Result<Vec<LaserShot>, Malformed> {
    messages
        .into_iter()
        .map(|m| {
            finite("q_rad", &m.q_rad)?;
            Ok(LaserShot {
                point_m: list("point_m", &m.point_m)?,
                purpose: m.purpose,
                q: m.q_rad,
            })
        })
        .collect()
}

#[cfg(test)]
#[path = "convert_tests.rs"]
mod tests;
