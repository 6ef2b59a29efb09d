//! Which configurations are possible: each refusal names field, value and remedy.

use super::config::PlantConfig;
use super::error::PlantError;

impl PlantConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// The first field that is not finite or not possible, with value and remedy.
    pub fn check(&self) -> Result<(), PlantError> {
        let step = |field, value: f64| {
            let whole = 1e-3 / value;
            require(
                field,
                value,
                value > 0.0 && (whole - whole.round()).abs() < 1e-6 && whole.round() >= 1.0,
                "a whole number of sub-steps makes 1 ms: 1e-3, 5e-4, 2.5e-4, 1e-4 ...",
            )
        };
        step("substep_s", self.substep_s)?;
        step("free_step_s", self.free_step_s)?;
        self.cell.check()?;
        self.check_nest()?;
        let sizes = [
            ("plate.placement_sigma_m", self.plate.placement_sigma_m, 0.1),
            ("plate.placement_sigma_rad", self.plate.placement_sigma_rad, 0.5),
            ("geometry.length_sigma_m", self.geometry.length_sigma_m, 0.01),
            ("geometry.alpha_sigma_rad", self.geometry.alpha_sigma_rad, 0.1),
            ("geometry.theta_sigma_rad", self.geometry.theta_sigma_rad, 0.1),
            ("geometry.nominal_mean_m", self.geometry.nominal_mean_m, 0.05),
            ("geometry.overall_mean_m", self.geometry.overall_mean_m, 0.05),
            ("geometry.offset_share", self.geometry.offset_share, 1.0),
            ("geometry.offset_rad", self.geometry.offset_rad, 0.1),
            ("tool.tcp_sigma_m", self.tool.tcp_sigma_m, 0.02),
            ("compliance.joint_rad_per_nm", self.compliance.joint_rad_per_nm, 1e-3),
            ("compliance.spread", self.compliance.spread, 1.0),
            (
                "compliance.quadratic_rad_per_nm2",
                self.compliance.quadratic_rad_per_nm2,
                1e-5,
            ),
            ("compliance.hysteresis_rad", self.compliance.hysteresis_rad, 1e-2),
            ("compliance.link_rad_per_nm", self.compliance.link_rad_per_nm, 1e-4),
            (
                "compliance.link_sigma_rad_per_nm",
                self.compliance.link_sigma_rad_per_nm,
                1e-4,
            ),
            ("compliance.base_rad_per_nm", self.compliance.base_rad_per_nm, 1e-4),
            (
                "compliance.base_sigma_rad_per_nm",
                self.compliance.base_sigma_rad_per_nm,
                1e-4,
            ),
            ("compliance.settling_s", self.compliance.settling_s, 1.0),
            ("encoder.gear_rad", self.encoder.gear_rad, 1e-2),
            ("encoder.smooth_rad", self.encoder.smooth_rad, 1e-2),
            ("encoder.smooth_length_rad", self.encoder.smooth_length_rad, 10.0),
            ("encoder.cross_rad", self.encoder.cross_rad, 1e-2),
            ("encoder.cross_length_rad", self.encoder.cross_length_rad, 10.0),
            ("encoder.scatter_rad", self.encoder.scatter_rad, 1e-2),
            ("sensors.angle_white_rad", self.sensors.angle_white_rad, 0.01),
            ("sensors.angle_correlated_rad", self.sensors.angle_correlated_rad, 0.01),
            ("sensors.angle_correlation_s", self.sensors.angle_correlation_s, 100.0),
            ("sensors.angle_step_rad", self.sensors.angle_step_rad, 0.01),
            ("sensors.velocity_white_rad_s", self.sensors.velocity_white_rad_s, 1.0),
            ("sensors.velocity_step_rad_s", self.sensors.velocity_step_rad_s, 1.0),
            ("sensors.velocity_filter_s", self.sensors.velocity_filter_s, 0.1),
            ("sensors.torque_white_nm", self.sensors.torque_white_nm, 100.0),
            ("sensors.torque_step_nm", self.sensors.torque_step_nm, 100.0),
            ("sensors.torque_bias_share", self.sensors.torque_bias_share, 0.5),
            ("friction.coulomb_nm", self.friction.coulomb_nm[0], 100.0),
            ("friction.coulomb_nm", self.friction.coulomb_nm[1], 100.0),
            ("friction.viscous_nm_s", self.friction.viscous_nm_s[0], 1000.0),
            ("friction.viscous_nm_s", self.friction.viscous_nm_s[1], 1000.0),
            ("friction.beyond_sensor", self.friction.beyond_sensor, 1.0),
            ("inertia.link_mass_sigma", self.inertia.link_mass_sigma, 0.3),
            ("inertia.tool_mass_error", self.inertia.tool_mass_error[0], 1.0),
            ("inertia.tool_mass_error", self.inertia.tool_mass_error[1], 1.0),
            ("inertia.rotor_share", self.inertia.rotor_share, 1.0),
            ("inertia.rotor_sigma", self.inertia.rotor_sigma, 0.3),
            ("tracker.sigma_m", self.tracker.sigma_m, 0.01),
            ("tracker.encoder_rad", self.tracker.encoder_rad, 0.01),
            ("tracker.remount_m", self.tracker.remount_m, 0.05),
            ("tracker.restation_m", self.tracker.restation_m, 0.05),
            ("tracker.after_s", self.tracker.after_s, 1e6),
            ("tracker.shot_s", self.tracker.shot_s, 1e4),
            ("lost_motion.half_width_rad", self.lost_motion.half_width_rad[0], 1e-2),
            ("lost_motion.half_width_rad", self.lost_motion.half_width_rad[1], 1e-2),
            ("thermal.links_m", self.thermal.links_m[0], 1e-2),
            ("thermal.links_m", self.thermal.links_m[1], 1e-2),
            ("thermal.plate_m", self.thermal.plate_m[0], 1e-2),
            ("thermal.plate_m", self.thermal.plate_m[1], 1e-2),
            ("thermal.on_since_s", self.thermal.on_since_s, 1e6),
            ("reading.early_share", self.reading.early_share, 1.0),
            ("reading.early_s", self.reading.early_s, 1.0),
            ("reading.deceleration_rad_s2", self.reading.deceleration_rad_s2, 1000.0),
            ("disturbance.torque_play_share", self.disturbance.torque_play_share, 0.1),
            ("disturbance.cable_laid_rad", self.disturbance.cable_laid_rad, 6.3),
            ("disturbance.cable_bend_rad", self.disturbance.cable_bend_rad, 6.3),
            ("drive.state_delay_s", self.drive.state_delay_s, 0.02),
            ("drive.command_delay_s", self.drive.command_delay_s, 0.02),
            ("drive.jitter_s", self.drive.jitter_s, 0.02),
            ("drive.step_s", self.drive.step_s, 0.02),
            ("drive.step_every_s", self.drive.step_every_s, 1e4),
            ("drive.declared_s", self.drive.declared_s.unwrap_or(0.0), 0.02),
            ("drive.actuator_lag_s", self.drive.actuator_lag_s, 0.02),
        ];
        for (field, value, most) in sizes {
            require(
                field,
                value,
                (0.0..=most).contains(&value),
                "zero or positive, in SI units, and of a plausible size",
            )?;
        }
        for value in self.inertia.rotor_kg_m2 {
            require(
                "inertia.rotor_kg_m2",
                value,
                (0.0..=100.0).contains(&value),
                "zero or positive, in kg m²",
            )?;
        }
        for value in &self.encoder.harmonic_rad {
            require(
                "encoder.harmonic_rad",
                *value,
                (0.0..=0.01).contains(value),
                "zero or positive, in rad, at most 0.01",
            )?;
        }
        let orders = self.encoder.harmonic_rad.len();
        require(
            "encoder.harmonic_rad",
            orders as f64,
            orders <= 12,
            "at most 12 orders; finer errors are the gear's",
        )?;
        let [low, high] = self.encoder.gear_orders;
        require(
            "encoder.gear_orders",
            f64::from(high),
            low >= 1 && high >= low && high <= 1000,
            "two orders per turn, the lower first, within 1 to 1000",
        )?;
        for (field, value) in [
            ("encoder.scatter_travel_rad", self.encoder.scatter_travel_rad),
            ("lost_motion.travel_rad", self.lost_motion.travel_rad),
        ] {
            require(field, value, (1e-6..=10.0).contains(&value), "in rad, 1e-6 to 10")?;
        }
        require(
            "thermal.time_constant_s",
            self.thermal.time_constant_s,
            (1.0..=1e6).contains(&self.thermal.time_constant_s),
            "in s, 1 to 1e6",
        )?;
        self.check_disturbance()?;
        self.check_compliance()?;
        let e = &self.elasticity;
        require(
            "elasticity.stiffness_nm_rad",
            e.stiffness_nm_rad,
            e.stiffness_nm_rad >= 0.0,
            "positive, or 0 for the inverse of each joint's compliance",
        )?;
        require(
            "elasticity.damping_nm_s",
            e.damping_nm_s,
            e.damping_nm_s >= 0.0,
            "zero or positive",
        )?;
        require(
            "elasticity.least_motor_kg_m2",
            e.least_motor_kg_m2,
            e.least_motor_kg_m2 > 0.0,
            "must be positive",
        )?;
        for value in self.tracker.position_m.into_iter().chain(self.tracker.rpy_rad) {
            require(
                "tracker.position_m/rpy_rad",
                value,
                value.abs() <= 100.0,
                "a finite pose within 100 m",
            )?;
        }
        Ok(())
    }

    fn check_compliance(&self) -> Result<(), PlantError> {
        let c = &self.compliance;
        for [least, most] in &c.joints_rad_per_nm {
            for value in [*least, *most] {
                require(
                    "compliance.joints_rad_per_nm",
                    value,
                    (0.0..=1e-3).contains(&value),
                    "the least and the most of each joint, in rad/(N m), 0 to 1e-3",
                )?;
            }
        }
        // At the limit of torque a joint still gives way: the slope there is 1 + 2 share of that at rest.
        require(
            "compliance.quadratic_share",
            c.quadratic_share,
            (-0.45..=2.0).contains(&c.quadratic_share),
            "-0.45 to 2: below, more torque would bend the joint back",
        )?;
        if self.elasticity.enabled && self.elasticity.stiffness_nm_rad == 0.0 {
            let softest = c.joint_rad_per_nm * (1.0 - c.spread);
            for value in c.joints_rad_per_nm.iter().map(|r| r[0]).chain([softest]) {
                require(
                    "elasticity.stiffness_nm_rad",
                    value,
                    value > 0.0,
                    "with 0 every joint needs a positive compliance: see compliance.joints_rad_per_nm, \
                     compliance.joint_rad_per_nm and compliance.spread",
                )?;
            }
        }
        Ok(())
    }

    fn check_disturbance(&self) -> Result<(), PlantError> {
        let d = &self.disturbance;
        let good = |value: &f64, least: f64| (least..=100.0).contains(value);
        for (field, values, least, remedy) in [
            (
                "disturbance.torque_bias_nm",
                &d.torque_bias_nm,
                -100.0,
                "the bias of each joint, in N m, -100 to 100",
            ),
            (
                "disturbance.cable_nm",
                &d.cable_nm,
                0.0,
                "the largest torque on each joint, in N m, 0 to 100",
            ),
        ] {
            for value in values {
                require(field, *value, good(value, least), remedy)?;
            }
        }
        require(
            "disturbance.cable_bend_rad",
            d.cable_bend_rad,
            d.cable_bend_rad > 0.0,
            "must be positive",
        )
    }

    fn check_nest(&self) -> Result<(), PlantError> {
        let n = &self.nest;
        for (field, value, least, most) in [
            ("nest.stiffness_n_m", n.stiffness_n_m, 1.0, 1e9),
            ("nest.damping_n_s_m", n.damping_n_s_m, 0.0, 1e7),
            ("nest.friction", n.friction, 0.0, 2.0),
            ("nest.friction_speed_m_s", n.friction_speed_m_s, 1e-7, 1.0),
            ("nest.magnet_n", n.magnet_n, 0.0, 1000.0),
            ("nest.magnet_scale_m", n.magnet_scale_m, 1e-5, 1.0),
            ("nest.magnet_range_m", n.magnet_range_m, 0.0, 0.2),
            ("nest.rim_height_m", n.rim_height_m, -0.02, 0.02),
            ("nest.body_radius_m", n.body_radius_m, 0.01, 0.2),
            ("nest.seating_sigma_m", n.seating_sigma_m, 0.0, 1e-3),
            ("nest.form_sigma_m", n.form_sigma_m, 0.0, 1e-3),
        ] {
            require(
                field,
                value,
                (least..=most).contains(&value),
                "in SI units, and of a plausible size",
            )?;
        }
        Ok(())
    }
}

/// Refuses a value that is not finite or for which `good` is false.
fn require(field: &'static str, value: f64, good: bool, remedy: &'static str) -> Result<(), PlantError> {
    if value.is_finite() && good {
        Ok(())
    } else {
        Err(PlantError::Field { field, value, remedy })
    }
}
