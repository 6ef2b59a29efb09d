//! The presets of the worlds W0 to W5: whole sets of errors, for studies of estimators and for hard runs.

use super::config::{GeometryConfig, PlantConfig};
use super::nest_kind::NestKind;

impl PlantConfig {
    /// World W5, as measured: an arm that is as hard to calibrate as real ones, with a nest of steel.
    ///
    /// Every size comes from published figures or from the only real data that the project may store,
    /// `mukca_iiwa14.csv` (a real iiwa 14: 180 contacts, MIT). None comes from what an estimator does well on.
    ///
    /// | effect | size | source |
    /// |---|---|---|
    /// | lengths, twists, offsets | 0.3 mm, 0.5 mrad, 0.8 mrad | what the full model finds on that iiwa 14: d 0.4-0.55 mm, alpha to 0.47 mrad, theta to 1 mrad |
    /// | joint offsets to 20 mrad | one robot in three | six real Franka arms: offsets to 21 mrad |
    /// | joint compliance | 2e-5 to 6e-5 rad/(N m) on joints 1-4 | the real iiwa 14: 1.7e-5 to 6.6e-5 on joints 2-4; the real iiwa 7: 6e-5 |
    /// | | 4e-5 to 1e-4 on joints 5-7 | their gears are two sizes smaller; joint stiffness of 10,000 to 25,000 N m/rad |
    /// | stiffening | slope at the torque limit 0.6 of that at rest | catalogues of strain wave gears: K1/K3 of 0.55 to 0.7 |
    /// | torque hysteresis, lost motion by direction | ±5e-5; ±2.5e-5 to ±7.5e-5 rad | the same catalogues: hysteresis loss under 1 arcmin (2.9e-4 rad) at full torque; here 1e-4 rad from side to side |
    /// | harmonics 1 to 6 | 2, 2, 1, 0.7, 0.5, 0.4 x 1e-4 rad | the same: transmission error of 1 to 1.5 arcmin from peak to peak; ruled by orders 1 and 2 of the output |
    /// | gear ripple, orders 60 to 160 | 3e-5 rad rms | assumed: a tenth of that error at the orders of the wave generator |
    /// | cross-joint errors | 1e-4 rad rms over 1 rad | twice those of world W4; assumed |
    /// | link bending, base tilt | 5e-6 (± 1.5e-6) rad/(N m) | the real iiwa 14: 0.5e-5 to 1e-5 where the data determine them |
    /// | warm-up of links; of the plate | 0.1 to 0.3 mm in the first hour, each | Vocetka et al. 2021 (Appl. Sci. 11, 10813): repeatability of 0.025 mm ten times worse without warm-up |
    /// | seats | 3 µm | the largest that kinematic couplings of steel repeat to; a printed socket: [`Self::as_measured_socket`] |
    /// | scatter at rest | 2e-5 rad | KUKA: ISO 9283 repeatability of ±0.1 and ±0.15 mm (iiwa 7, 14), an upper bound |
    /// | early readings | 5 ms before rest in 10 % of the rows | issue of the residuals of a real IRB 120 along the last move |
    /// | masses | 3 %, tool up to 3 % | Stürz et al. 2017, Gaz et al. 2019: identified dynamics differ so much from CAD models |
    ///
    /// Elasticity is a state (the inverse of each joint's compliance), rotors are on, encoders sit on the motors.
    /// Friction and sensors are those of [`Self::typical`].
    pub fn as_measured() -> Self {
        let mut config = Self::typical();
        config.geometry = GeometryConfig {
            enabled: true,
            length_sigma_m: 0.3e-3,
            alpha_sigma_rad: 0.5e-3,
            theta_sigma_rad: 0.8e-3,
            nominal_mean_m: 0.0,
            overall_mean_m: 0.0,
            offset_share: 1.0 / 3.0,
            offset_rad: 0.020,
        };
        let (large, small) = ([2e-5, 6e-5], [4e-5, 1e-4]);
        config.compliance.joints_rad_per_nm = vec![large, large, large, large, small, small, small];
        config.compliance.quadratic_share = -0.2;
        config.compliance.hysteresis_rad = 5e-5;
        config.compliance.link_rad_per_nm = 5e-6;
        config.compliance.link_sigma_rad_per_nm = 1.5e-6;
        config.compliance.base_rad_per_nm = 5e-6;
        config.compliance.base_sigma_rad_per_nm = 1.5e-6;
        config.encoder.harmonic_rad = vec![2e-4, 2e-4, 1e-4, 7e-5, 5e-5, 4e-5];
        config.encoder.gear_rad = 3e-5;
        config.encoder.cross_rad = 1e-4;
        config.encoder.scatter_rad = 2e-5;
        config.lost_motion.enabled = true;
        config.lost_motion.half_width_rad = [2.5e-5, 7.5e-5];
        config.thermal.enabled = true;
        config.thermal.links_m = [1e-4, 3e-4];
        config.thermal.plate_m = [1e-4, 3e-4];
        config.reading.early_share = 0.1;
        config.nest.seating_sigma_m = 3e-6;
        config.inertia.link_mass_sigma = 0.03;
        config.inertia.tool_mass_error = [0.0, 0.03];
        config.inertia.rotors = true;
        config.elasticity.enabled = true;
        config.elasticity.stiffness_nm_rad = 0.0;
        config.tracker.restation_m = 0.0;
        config.tracker.after_s = 1800.0;
        config
    }

    /// World W5s: [`Self::as_measured`] with a printed socket as its nest.
    pub fn as_measured_socket() -> Self {
        let mut config = Self::as_measured();
        config.nest.kind = NestKind::Socket;
        config
    }

    /// World W0 to W4 of `docs/design/identification.md` (beyond: W4): static errors only; dynamics and sensors are
    /// ideal but for the noise of averaged encoders. W0: compliance, first and second harmonics, white joint noise. W1: and frames
    /// measured wrongly. W2: all non-geometric effects three to four times larger. W3: W0 and harmonics 3 to 8, link
    /// bending, base tilt. W4: out of every model's class.
    pub fn world(number: u32) -> Self {
        let mut config = Self::typical();
        config.friction.enabled = false;
        config.inertia.mass_error = false;
        config.sensors.torque_bias_share = 0.0;
        config.nest.seating_sigma_m = 3e-6;
        config.nest.form_sigma_m = 0.0;
        config.tracker.restation_m = 0.0;
        config.geometry.overall_mean_m = 1.403e-3;
        // The joints' noise of these worlds is white: it does not repeat with the angle.
        config.encoder.gear = false;
        config.encoder.scatter_rad = 5e-5;
        match number {
            0 => {}
            1 => {
                config.tracker.remount_m = 0.58e-3;
                config.tracker.restation_m = 0.15e-3;
            }
            2 => {
                config.compliance.joint_rad_per_nm = 8e-6;
                config.encoder.harmonic_rad = vec![7e-4, 4e-4];
                config.encoder.scatter_rad = 1.5e-4;
            }
            3 => {
                // Six orders of 1e-4 rad rms together; a wave's mean square is half its square.
                config.encoder.harmonic_rad.extend([5.77e-5; 6]);
                config.compliance.link_sigma_rad_per_nm = 1.5e-6;
                config.compliance.base_sigma_rad_per_nm = 1e-6;
            }
            _ => {
                config.encoder.smooth_rad = 1.2e-4;
                config.encoder.cross_rad = 5e-5;
                config.encoder.gear = true;
                config.encoder.gear_orders = [20, 60];
                config.compliance.quadratic_rad_per_nm2 = 2e-8;
                config.compliance.hysteresis_rad = 3e-5;
                config.compliance.link_sigma_rad_per_nm = 1.5e-6;
                config.compliance.base_sigma_rad_per_nm = 1e-6;
            }
        }
        config
    }
}
