//! Presets of the error sources: `ideal`, `typical`, `harsh`, `as_measured` (world W5), and the worlds
//! `w0` to `w4` of `docs/design/identification.md` (their static errors on an otherwise ideal arm).

use core::f64::consts::PI;

use spherecal_model::NominalCell;

use super::config::{
    ComplianceConfig, DisturbanceConfig, DriveConfig, ElasticityConfig, EncoderConfig, EncoderSide, FrictionConfig,
    GeometryConfig, InertiaConfig, LostMotionConfig, NestConfig, PlantConfig, PlateConfig, ReadingConfig, SensorConfig,
    ThermalConfig, ToolConfig, TrackerConfig,
};
use super::error::PlantError;
use super::nest_kind::NestKind;

/// Names of the presets.
pub const PRESETS: &[&str] = &[
    "ideal",
    "typical",
    "harsh",
    "as_measured",
    "as_measured_socket",
    "w0",
    "w1",
    "w2",
    "w3",
    "w4",
];

impl Default for PlateConfig {
    fn default() -> Self {
        Self {
            certificate_error: true,
            placement_error: true,
            placement_sigma_m: 2e-3,
            placement_sigma_rad: 5e-3,
        }
    }
}

impl Default for NestConfig {
    fn default() -> Self {
        Self {
            stiffness_n_m: 1e6,
            damping_n_s_m: 1e3,
            friction: 0.15,
            friction_speed_m_s: 1e-3,
            magnet: true,
            magnet_n: 26.5,
            magnet_scale_m: 1e-3,
            magnet_range_m: 0.05,
            rim_height_m: 2.5e-3,
            body_radius_m: 0.042,
            seating_error: true,
            kind: NestKind::Steel,
            seating_sigma_m: 1.5e-6,
            form_sigma_m: 1.5e-6,
        }
    }
}

impl Default for GeometryConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            length_sigma_m: 0.2e-3,
            alpha_sigma_rad: 0.5e-3,
            theta_sigma_rad: 0.8e-3,
            nominal_mean_m: 1.27e-3,
            overall_mean_m: 0.0,
            offset_share: 0.0,
            offset_rad: 0.0,
        }
    }
}

impl Default for ToolConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            tcp_sigma_m: 1e-3,
        }
    }
}

impl Default for ComplianceConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            joint_rad_per_nm: 3e-6,
            spread: 0.3,
            joints_rad_per_nm: Vec::new(),
            quadratic_rad_per_nm2: 0.0,
            quadratic_share: 0.0,
            hysteresis_rad: 0.0,
            link_rad_per_nm: 0.0,
            link_sigma_rad_per_nm: 0.0,
            base_rad_per_nm: 0.0,
            base_sigma_rad_per_nm: 0.0,
            settling_s: 4e-3,
        }
    }
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self {
            side: EncoderSide::Motor,
            harmonics: true,
            harmonic_rad: vec![2e-4, 1e-4],
            gear: true,
            gear_rad: 5e-5,
            gear_orders: [60, 160],
            smooth_rad: 0.0,
            smooth_length_rad: 0.35,
            cross_rad: 0.0,
            cross_length_rad: 1.0,
            scatter_rad: 0.0,
            scatter_travel_rad: 2e-3,
        }
    }
}

impl Default for SensorConfig {
    fn default() -> Self {
        Self {
            noise: true,
            angle_white_rad: 1e-5,
            angle_correlated_rad: 4e-6,
            angle_correlation_s: 0.05,
            angle_step_rad: 2.0 * PI / 4_194_304.0,
            velocity_white_rad_s: 3e-4,
            velocity_step_rad_s: 1e-5,
            velocity_filter_s: 8e-4,
            torque_white_nm: 0.03,
            torque_step_nm: 0.005,
            torque_bias_share: 5e-4,
        }
    }
}

impl Default for FrictionConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            coulomb_nm: [0.03, 0.10],
            viscous_nm_s: [0.05, 0.2],
            beyond_sensor: 0.0,
        }
    }
}

impl Default for InertiaConfig {
    fn default() -> Self {
        Self {
            mass_error: true,
            link_mass_sigma: 0.003,
            tool_mass_error: [0.0, 0.005],
            rotors: false,
            rotor_kg_m2: [
                1.836,
                4.446_999_04,
                3.241_999_36,
                1.816_998_4,
                1.392,
                1.401_984,
                1.392,
                0.0,
            ],
            rotor_share: 0.25,
            rotor_sigma: 0.1,
        }
    }
}

impl Default for ElasticityConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            stiffness_nm_rad: 16_000.0,
            damping_nm_s: 20.0,
            least_motor_kg_m2: 0.05,
        }
    }
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self {
            noise: true,
            sigma_m: 49e-6 / 1.96,
            encoder_rad: 2e-6,
            remount_m: 0.0,
            restation_m: 0.15e-3,
            after_s: 0.0,
            shot_s: 5.0,
            position_m: [2.1, -1.4, 1.1],
            rpy_rad: [0.02, -0.03, 2.4],
        }
    }
}

impl Default for PlantConfig {
    fn default() -> Self {
        Self::typical()
    }
}

impl PlantConfig {
    /// A good arm in normal conditions: see each section's defaults. The nominal model's error on
    /// random configurations is scaled to the paper's 1.40 mm.
    pub fn typical() -> Self {
        Self {
            seed: 1,
            contact: true,
            substep_s: 2.5e-4,
            free_step_s: 1e-3,
            cell: NominalCell::default(),
            plate: PlateConfig::default(),
            nest: NestConfig::default(),
            geometry: GeometryConfig::default(),
            tool: ToolConfig::default(),
            compliance: ComplianceConfig::default(),
            encoder: EncoderConfig::default(),
            lost_motion: LostMotionConfig::default(),
            thermal: ThermalConfig::default(),
            reading: ReadingConfig::default(),
            sensors: SensorConfig::default(),
            friction: FrictionConfig::default(),
            inertia: InertiaConfig::default(),
            elasticity: ElasticityConfig::default(),
            disturbance: DisturbanceConfig::default(),
            drive: DriveConfig::default(),
            tracker: TrackerConfig::default(),
        }
    }

    /// The exact nominal arm with perfect sensors; contact and magnet stay.
    pub fn ideal() -> Self {
        let mut config = Self::typical();
        config.plate.certificate_error = false;
        config.plate.placement_error = false;
        config.nest.seating_error = false;
        config.geometry.enabled = false;
        config.tool.enabled = false;
        config.compliance.enabled = false;
        config.encoder.harmonics = false;
        config.encoder.gear = false;
        config.sensors.noise = false;
        config.sensors.velocity_filter_s = 0.0;
        config.sensors.torque_bias_share = 0.0;
        config.friction.enabled = false;
        config.inertia.mass_error = false;
        config.inertia.rotors = false;
        config.tracker.noise = false;
        config.tracker.restation_m = 0.0;
        config
    }

    /// Conditions in which other methods failed: 1-2 N m of dry friction, visible rotors, a payload
    /// 3-5 % off, biased torque sensors. (Poor waypoints are a setting of the campaign.)
    ///
    pub fn harsh() -> Self {
        let mut config = Self::typical();
        config.plate.placement_sigma_m = 4e-3;
        config.plate.placement_sigma_rad = 0.01;
        config.nest.seating_sigma_m = 3e-6;
        config.sensors.angle_correlated_rad = 1e-5;
        config.sensors.velocity_white_rad_s = 1e-3;
        config.sensors.torque_white_nm = 0.1;
        config.sensors.torque_bias_share = 0.003;
        config.friction.coulomb_nm = [1.0, 2.0];
        config.friction.viscous_nm_s = [0.5, 2.0];
        config.inertia.link_mass_sigma = 0.01;
        config.inertia.tool_mass_error = [0.03, 0.05];
        config.inertia.rotors = true;
        config
    }

    /// A preset by name.
    ///
    /// # Errors
    /// A name that is not in [`PRESETS`].
    pub fn preset(name: &str) -> Result<Self, PlantError> {
        match name {
            "ideal" => Ok(Self::ideal()),
            "typical" => Ok(Self::typical()),
            "harsh" => Ok(Self::harsh()),
            "as_measured" => Ok(Self::as_measured()),
            "as_measured_socket" => Ok(Self::as_measured_socket()),
            "w0" => Ok(Self::world(0)),
            "w1" => Ok(Self::world(1)),
            "w2" => Ok(Self::world(2)),
            "w3" => Ok(Self::world(3)),
            "w4" => Ok(Self::world(4)),
            _ => Err(PlantError::Preset {
                name: name.to_owned(),
                known: PRESETS.join(", "),
            }),
        }
    }
}
