//! One plan for each fault, at the moment of its largest effect.

use std::path::Path;

use spherecal_shared::protocol::host::{Fault, Phase};

use super::fault::{InjectedFault, NotReadyStatus};
use super::plan::{FaultPlan, InjectError, When};
use spherecal_link::Lossy;

/// A plan with a name.
#[derive(Clone, Copy, Debug)]
pub struct Preset {
    /// Name, that of its fault.
    pub name: &'static str,
    /// What happens, in a line.
    pub about: &'static str,
    /// The fault.
    pub what: InjectedFault,
    /// Its moment.
    pub when: When,
    /// Faults that the controller may report first.
    pub faults: &'static [Fault],
    /// Time limit from its start, in ms; `None` if it depends on when the arm next moves, touches
    /// or tares.
    pub within_ms: Option<u32>,
    /// Whether it may also pass without a fault.
    pub borne: bool,
}

impl Preset {
    /// As a plan.
    pub fn plan(&self) -> FaultPlan {
        FaultPlan::of(self.what, self.when)
    }

    /// Time limit from its start, in ms, for a fault that is reported in `phase`.
    pub fn within_ms_in(&self, phase: Phase) -> Option<u32> {
        match (self.what, phase) {
            (InjectedFault::StateFrozen, Phase::Recording) => Some(FROZEN_AT_REST_MS),
            _ => self.within_ms,
        }
    }
}

const fn during(name: Phase, entry: u32, after_s: f64) -> When {
    When::Phase { name, entry, after_s }
}

/// Faults that an arm reports when its motion or its coupling is disturbed. Which of these depends
/// on what it was doing.
const DISTURBED: &[Fault] = &[
    Fault::ContactLost,
    Fault::NotSeated,
    Fault::PathDeviation,
    Fault::MotionTimeout,
    Fault::Force,
    Fault::JointVelocity,
    Fault::JointTorque,
    Fault::Tare,
    Fault::NoContact,
    Fault::StillCoupled,
    Fault::TorqueSensor,
    Fault::Workspace,
    Fault::Pressing,
    Fault::Disturbance,
];

/// The same of a blow, which may also make a light joint swing.
const STRUCK: &[Fault] = &{
    let mut faults = [Fault::Unstable; DISTURBED.len() + 1];
    let mut k = 0;
    while k < DISTURBED.len() {
        faults[k] = DISTURBED[k];
        k += 1;
    }
    faults
};

/// The same for an arm whose encoder sticks; when it is free again, its angle jumps.
const STUCK: &[Fault] = &[
    Fault::StaleState,
    Fault::PositionJump,
    Fault::ContactLost,
    Fault::PathDeviation,
    Fault::MotionTimeout,
    Fault::Force,
    Fault::JointVelocity,
    Fault::NotSeated,
    Fault::TorqueSensor,
    Fault::Pressing,
    Fault::Disturbance,
];

/// The same for a drive that freezes during a recording: the arm rests, so a state that repeats tells nothing before
/// the sent torque has changed. The injected fault ends after 500 ms.
const FROZEN_AT_REST_MS: u32 = 510;

/// The presets.
pub const PRESETS: &[Preset] = &[
    Preset {
        name: "state_frozen",
        about: "the drive continues to count but sends the same state for 0.5 s",
        what: InjectedFault::StateFrozen,
        when: during(Phase::Turning, 2, 0.2),
        faults: &[Fault::StaleState],
        within_ms: Some(40),
        borne: true,
    },
    Preset {
        name: "state_repeated",
        about: "the drive repeats one state for 0.5 s",
        what: InjectedFault::StateRepeated,
        when: during(Phase::Recording, 2, 0.3),
        faults: &[Fault::StaleState],
        within_ms: Some(5),
        borne: false,
    },
    Preset {
        name: "state_late",
        about: "every state arrives 10 ms late for 0.5 s",
        what: InjectedFault::StateLate { ticks: 10 },
        when: during(Phase::Turning, 3, 0.1),
        faults: &[Fault::StaleState],
        within_ms: Some(15),
        borne: false,
    },
    Preset {
        name: "state_dropped",
        about: "no state arrives for 0.5 s",
        what: InjectedFault::StateDropped,
        when: during(Phase::Approaching, 1, 1.0),
        faults: &[Fault::StaleState],
        within_ms: Some(510),
        borne: false,
    },
    Preset {
        name: "state_bits",
        about: "three bits of every state's frame are flipped for 20 ms",
        what: InjectedFault::StateBits { bits: 3 },
        when: during(Phase::Recording, 1, 0.5),
        faults: &[Fault::StaleState],
        within_ms: Some(30),
        borne: false,
    },
    Preset {
        name: "state_nan",
        about: "angle 4 is not a number for 20 ms",
        what: InjectedFault::StateNan { joint: 4 },
        when: during(Phase::Turning, 1, 0.3),
        faults: &[Fault::NotFinite],
        within_ms: Some(5),
        borne: false,
    },
    Preset {
        name: "position_jump",
        about: "angle 2 reads 0.1 rad too high for 20 ms",
        what: InjectedFault::PositionJump { joint: 2, rad: 0.1 },
        when: during(Phase::Moving, 1, 0.5),
        faults: &[Fault::PositionJump],
        within_ms: Some(5),
        borne: false,
    },
    Preset {
        name: "encoder_stuck",
        about: "encoder 4 sticks for 0.5 s",
        what: InjectedFault::EncoderStuck { joint: 4 },
        when: during(Phase::Moving, 2, 0.3),
        faults: STUCK,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "torque_bias",
        about: "torque sensor 2 reads 30 N m too high for 0.5 s",
        what: InjectedFault::TorqueBias { joint: 2, nm: 30.0 },
        when: during(Phase::Coupling, 1, 1.0),
        faults: DISTURBED,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "torque_dead",
        about: "torque sensor 2 reads zero for 0.5 s",
        what: InjectedFault::TorqueDead { joint: 2 },
        when: during(Phase::Recording, 1, 0.4),
        faults: DISTURBED,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "drive_status",
        about: "an emergency stop for 2 s",
        what: InjectedFault::DriveStatus {
            status: NotReadyStatus::EmergencyStop,
        },
        when: during(Phase::Recording, 3, 0.2),
        faults: &[Fault::Drive],
        within_ms: Some(1),
        borne: false,
    },
    Preset {
        name: "torque_saturation",
        about: "motor 2 delivers at most 20 N m for 0.5 s",
        what: InjectedFault::TorqueSaturation { joint: 2, nm: 20.0 },
        when: during(Phase::Turning, 2, 0.1),
        faults: DISTURBED,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "payload",
        about: "an undeclared payload of 1.5 kg, from the second approach on",
        what: InjectedFault::Payload { kg: 1.5 },
        when: during(Phase::Moving, 3, 0.2),
        faults: DISTURBED,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "obstacle",
        about: "a soft obstacle blocks the path for 2 s",
        what: InjectedFault::Obstacle {
            ahead_m: 0.02,
            stiffness_n_m: 1e4,
        },
        when: during(Phase::Moving, 3, 0.8),
        faults: DISTURBED,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "magnet_lost",
        about: "the magnet lets go for 2 s",
        what: InjectedFault::MagnetLost,
        when: during(Phase::Turning, 2, 0.3),
        faults: DISTURBED,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "sphere_missing",
        about: "the sphere is not there for 20 s",
        what: InjectedFault::SphereMissing,
        when: during(Phase::Taring, 1, 0.1),
        faults: DISTURBED,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "sphere_moved",
        about: "the sphere is pushed aside by 20 mm while the nest sits on it",
        what: InjectedFault::SphereMoved {
            by_m: [0.02, 0.0, 0.0],
            over_s: 0.2,
        },
        when: during(Phase::Recording, 2, 0.5),
        faults: STRUCK,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "human_push",
        about: "a person pushes with 50 N for 0.5 s",
        what: InjectedFault::HumanPush {
            force_n: [35.0, 35.0, 0.0],
        },
        when: during(Phase::Recording, 2, 0.4),
        faults: STRUCK,
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "controller_reset",
        about: "the controller restarts and has lost its state; the host finds it silent",
        what: InjectedFault::ControllerReset,
        when: during(Phase::Recording, 2, 0.5),
        faults: &[],
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "host_silent",
        about: "the host link is interrupted for 3 s",
        what: InjectedFault::HostSilent,
        when: during(Phase::Turning, 2, 0.1),
        faults: &[Fault::HostSilence],
        within_ms: Some(2500),
        borne: true,
    },
    Preset {
        name: "host_link",
        about: "the host link loses 20 % of the frames, repeats 10 %, delays 10 % and flips a bit in 1 %, for 20 s",
        what: InjectedFault::HostLink(Lossy {
            loss: 0.2,
            duplication: 0.1,
            reorder: 0.1,
            bit_flip: 0.01,
            seed: 1,
        }),
        when: during(Phase::Turning, 2, 0.1),
        faults: &[],
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "host_killed",
        about: "the host is killed; another one continues after 3 s",
        what: InjectedFault::HostKilled { away_s: 3.0 },
        when: during(Phase::Recording, 2, 0.5),
        faults: &[Fault::HostSilence],
        within_ms: Some(2500),
        borne: true,
    },
    Preset {
        name: "disk_full",
        about: "the disk is full; after the run has stopped, an operator frees space and continues",
        what: InjectedFault::DiskFull,
        when: during(Phase::Turning, 2, 0.1),
        faults: &[Fault::HostSilence],
        within_ms: None,
        borne: true,
    },
    Preset {
        name: "database_locked",
        about: "another program locks the database for 1 s",
        what: InjectedFault::DatabaseLocked { wall_s: 1.0 },
        when: during(Phase::Turning, 2, 0.1),
        faults: &[],
        within_ms: None,
        borne: true,
    },
];

/// The preset of that name.
pub fn preset(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|p| p.name == name)
}

impl FaultPlan {
    /// A preset by its name, or a file.
    ///
    /// # Errors
    /// Neither a preset nor a valid file.
    pub fn load(name: &str) -> Result<Self, InjectError> {
        if let Some(preset) = preset(name) {
            return Ok(preset.plan());
        }
        let text = std::fs::read_to_string(Path::new(name)).map_err(|source| InjectError::Unknown {
            name: name.to_owned(),
            source,
            presets: PRESETS.iter().map(|preset| preset.name).collect::<Vec<_>>().join(", "),
        })?;
        Self::parse(name, &text)
    }
}

/// The second table of `docs/recovery.md`: one line of Markdown for each injected fault.
pub fn table() -> String {
    let mut text = String::from(
        "| injected | what happens | first reported fault | within, ms | may pass without a fault |\n|---|---|---|---:|---|\n",
    );
    for preset in PRESETS {
        let faults: Vec<String> = preset
            .faults
            .iter()
            .map(|f| format!("`{}`", spherecal_model::name_of(*f)))
            .collect();
        text.push_str(&format!(
            "| `{}` | {} | {} | {} | {} |\n",
            preset.name,
            preset.about,
            if faults.is_empty() {
                "none".to_owned()
            } else {
                faults.join(", ")
            },
            match (preset.within_ms, preset.within_ms_in(Phase::Recording)) {
                (None, _) => "–".to_owned(),
                (Some(ms), Some(recording)) if recording != ms => format!("{ms}; {recording} in a recording"),
                (Some(ms), _) => ms.to_string(),
            },
            if preset.borne { "yes" } else { "no" }
        ));
    }
    text
}
