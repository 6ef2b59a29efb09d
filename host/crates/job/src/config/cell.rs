//! Section `[cell]`: the real cell, for simulated and real arms.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use spherecal_model::chain::Chain;
use spherecal_model::robots::RobotModel;
use spherecal_model::{CalibrationPlate, CellError, NominalCell, Placement, WorkBox};
use spherecal_shared::protocol::drive::{MOST_LATENCY_US, MOST_MOTOR_KG_M2};
use spherecal_shared::robot::Inertia;

use crate::waypoints::TaughtWaypoint;

/// The known data of the real cell: tool, plate, nominal pose of the plate, and start of the
/// descents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CellSection {
    /// The tool with the nest.
    pub tool: ToolSection,
    /// The plate with the spheres.
    pub plate: CalibrationPlate,
    /// Nominal poses of the plate. The plate moves from one placement to the next; the paper has
    /// one.
    pub placements: Vec<Placement>,
    /// Start of the descent to each sphere, as `spherecal teach` found it. Empty: above the
    /// sphere's nominal position, displaced by `campaign.taught_error_m`. `--waypoints` replaces
    /// this list.
    pub waypoints: Vec<TaughtWaypoint>,
    /// What a robot does not say of itself over its own interface (`franka:`, `fri:`), and how the program waits for it.
    #[serde(skip_serializing_if = "DriveSection::is_default")]
    pub drive: DriveSection,
    /// Where the arm is to work. Plan, expected error, verdict and files are for it. Default: the space in front of the arm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub work: Option<WorkSection>,
}

/// A box in the robot's base frame in which the arm is to work.
#[allow(clippy::struct_field_names)] // Fields of a file say their unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WorkSection {
    /// Least and greatest x, in mm.
    pub x_mm: [f64; 2],
    /// Least and greatest y, in mm.
    pub y_mm: [f64; 2],
    /// Least and greatest z, in mm.
    pub z_mm: [f64; 2],
}

impl WorkSection {
    /// Configurations of an arm with the TCP in the box, in rad.
    ///
    /// # Errors
    /// Impossible ranges, or a box that the arm hardly reaches.
    pub fn configurations(&self, chain: &Chain) -> Result<Vec<Vec<f64>>, CellError> {
        let found = WorkBox::from_mm([self.x_mm, self.y_mm, self.z_mm])
            .and_then(|work| work.configurations(chain, spherecal_identify::WORKSPACE));
        found.map_err(|remedy| CellError {
            field: "work.x_mm",
            value: self.x_mm[0],
            remedy,
        })
    }
}

impl Default for CellSection {
    fn default() -> Self {
        let NominalCell { plate, placements } = NominalCell::default();
        Self {
            tool: ToolSection::default(),
            plate,
            placements,
            waypoints: Vec::new(),
            drive: DriveSection::default(),
            work: None,
        }
    }
}

/// What a robot does not say of itself over its own interface, and two ways to save the time that a sleeping thread needs
/// to wake up when a state of the robot comes. Other drives declare motors and delay in their handshake.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct DriveSection {
    /// The loop polls the socket for this long before it sleeps, in us; 0: it sleeps at once. 1000 costs a processor core.
    pub spin_us: u32,
    /// The kernel polls the network card for this long, in us; 0: it does not. Linux only; it may need the right
    /// `CAP_NET_ADMIN`.
    pub busy_poll_us: u32,
    /// Inertia of each motor, seen at its joint, that the robot's own torque control leaves between commanded and measured
    /// torque, in kg m², base to flange. Empty: none. If it is too small, runs end with TorqueSensor or PathDeviation; if
    /// it is too large, with Unstable.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub motor_kg_m2: Vec<f64>,
    /// Delay of the robot beyond one period, in us: age of a state when it is sent, and time until the torque that answers
    /// it acts, together.
    pub latency_us: u32,
}

impl DriveSection {
    fn is_default(&self) -> bool {
        *self == Self::default()
    }

    fn check(&self) -> Result<(), CellError> {
        for (field, value) in [
            ("drive.spin_us", self.spin_us),
            ("drive.busy_poll_us", self.busy_poll_us),
        ] {
            if value > 4000 {
                return Err(CellError {
                    field,
                    value: f64::from(value),
                    remedy: "give 0 to 4000 us, at most the robot's period",
                });
            }
        }
        if self.latency_us > MOST_LATENCY_US {
            return Err(CellError {
                field: "drive.latency_us",
                value: f64::from(self.latency_us),
                remedy: "give the delay that was measured, 0 to 5000 us: no safe gains are known beyond",
            });
        }
        for &inertia in &self.motor_kg_m2 {
            if !(0.0..=MOST_MOTOR_KG_M2).contains(&inertia) {
                return Err(CellError {
                    field: "drive.motor_kg_m2",
                    value: inertia,
                    remedy: "give one inertia for each joint in kg m², 0 to 50, or leave the field out",
                });
            }
        }
        Ok(())
    }
}

/// What differs from the tool in the robot's file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ToolSection {
    /// Nominal TCP (centre of a seated sphere) in the flange frame, in mm. Default: from the robot
    /// file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tcp_mm: Option<[f64; 3]>,
    /// Mass of the tool, in kg. It replaces the whole mass distribution in the robot file. Default:
    /// from the robot file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mass_kg: Option<f64>,
    /// Centre of that mass in the flange frame, in mm; only with `mass_kg`. Default: the flange's
    /// origin.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub com_mm: Option<[f64; 3]>,
}

impl ToolSection {
    /// Checks every number.
    /// Errors: the first field with an impossible value.
    pub(super) fn check(&self) -> Result<(), CellError> {
        let refuse = |field, value, remedy| Err(CellError { field, value, remedy });
        for value in self.tcp_mm.iter().flatten() {
            if !(value.abs() <= 2000.0) {
                return refuse(
                    "tool.tcp_mm",
                    *value,
                    "give the TCP in the flange frame in mm, within 2000",
                );
            }
        }
        for value in self.com_mm.iter().flatten() {
            if !(value.abs() <= 2000.0) {
                return refuse(
                    "tool.com_mm",
                    *value,
                    "give the centre of mass in the flange frame in mm, within 2000",
                );
            }
            if self.mass_kg.is_none() {
                return refuse("tool.com_mm", *value, "give tool.mass_kg too, or leave this out");
            }
        }
        if let Some(mass) = self.mass_kg
            && !(0.0..=1000.0).contains(&mass)
        {
            return refuse("tool.mass_kg", mass, "give a mass in kg from 0 to 1000");
        }
        Ok(())
    }

    /// Puts what is given into the robot's model.
    pub(crate) fn apply(&self, model: &mut RobotModel) {
        if let Some(tcp_mm) = self.tcp_mm {
            model.tool.tcp_m = tcp_mm.map(|mm| mm * 1e-3);
        }
        if let Some(mass_kg) = self.mass_kg {
            model.tool.body = Inertia {
                mass_kg,
                com_m: self.com_mm.unwrap_or_default().map(|mm| mm * 1e-3),
                inertia_kg_m2: [0.0; 6],
            };
        }
    }
}

impl CellSection {
    /// The plate with its placements.
    pub fn nominal(&self) -> NominalCell {
        NominalCell {
            plate: self.plate.clone(),
            placements: self.placements.clone(),
        }
    }

    /// Checks every number. Waypoints are checked against the plan when they are used.
    /// Errors: the first field with an impossible value.
    pub(super) fn check(&self) -> Result<(), CellError> {
        self.tool.check()?;
        self.drive.check()?;
        self.nominal().check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if an impossible tool is accepted, or if a centre of mass without a mass is silently
    // ignored.
    #[test]
    fn impossible_tools_are_refused_by_field() {
        let refusal = |text: &str| {
            let tool: ToolSection = toml::from_str(text).expect("parses");
            tool.check().expect_err(text).to_string()
        };
        assert!(refusal("tcp_mm = [0, 0, nan]").starts_with("cell.tool.tcp_mm is NaN"));
        assert!(refusal("mass_kg = -0.1").starts_with("cell.tool.mass_kg is -0.1"));
        assert!(refusal("com_mm = [0, 0, 40]").contains("give tool.mass_kg"));
        assert!(refusal("mass_kg = 1\ncom_mm = [0, 0, 40e3]").starts_with("cell.tool.com_mm is 40000"));
    }

    // Fails if a work region is lost, or if one that the arm does not reach is taken.
    #[test]
    fn a_work_region_is_within_reach() {
        let (robot, tool) = (spherecal_shared::robot::iiwa7(), spherecal_shared::robot::iiwa7_tool());
        let chain = Chain::new(&robot, &tool).expect("a chain");
        let of = |x: &str| {
            let text = format!("work = {{ x_mm = {x}, y_mm = [-200, 200], z_mm = [200, 600] }}");
            let cell = toml::from_str::<CellSection>(&text).expect("parses");
            cell.work.expect("given").configurations(&chain)
        };
        assert!(of("[300, 700]").is_ok_and(|found| found.len() > 100));
        let refused = of("[3000, 4000]").expect_err("out of reach").to_string();
        assert!(refused.starts_with("cell.work.x_mm is 3000"), "{refused}");
    }

    // Fails if a loop may poll past the state that it waits for, or settings that were not made fill the file.
    #[test]
    fn polling_is_bounded_by_the_period() {
        let cell = |text: &str| toml::from_str::<CellSection>(text).expect("parses");
        let error = cell("drive.spin_us = 4001").check().expect_err("too long").to_string();
        assert!(error.starts_with("cell.drive.spin_us is 4001"), "{error}");
        assert_eq!(cell("drive.busy_poll_us = 50").check(), Ok(()));
        let text = toml::to_string(&CellSection::default()).expect("a text");
        assert!(!text.contains("spin_us"), "{text}");
    }
}
