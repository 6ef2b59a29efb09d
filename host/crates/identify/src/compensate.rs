//! The full model as a compensator for a controller that keeps the nominal robot.

use spherecal_shared::robot::Robot;
use spherecal_shared::robot::compensator::{CompensatedJoint, Compensator, MAX_ORDERS};

use super::calibration::Calibration;

impl Calibration {
    /// Corrects the commands of a controller that keeps the nominal robot: `nominal` as it was given,
    /// `nominal_tcp_m` in the last frame of its table.
    pub fn compensator(&self, nominal: &Robot, nominal_tcp_m: [f64; 3]) -> Compensator {
        let n = self.robot.dof();
        let joint = |j: usize| {
            let mut harmonics_rad = [[0.0; 2]; MAX_ORDERS];
            let own = self.harmonics_rad.get(j).map_or(&[][..], Vec::as_slice);
            harmonics_rad.iter_mut().zip(own).for_each(|(slot, h)| *slot = *h);
            let (mass_kg, com) = self.inner.nominal.body(j);
            CompensatedJoint {
                nominal: nominal.joints.get(j).map(|x| x.mdh).unwrap_or_default(),
                calibrated: self.robot.joints.get(j).map(|x| x.mdh).unwrap_or_default(),
                mass_kg,
                com_m: com.into(),
                compliance_rad_per_nm: self.compliance_rad_per_nm.get(j).copied().unwrap_or_default(),
                bending_rad_per_nm: self.bending_rad_per_nm.get(j).copied().unwrap_or_default(),
                harmonics_rad,
            }
        };
        let joints: Vec<CompensatedJoint> = (0..n).map(joint).collect();
        Compensator::new(&joints, nominal_tcp_m, self.tool.tcp_m, self.tilt_rad_per_nm)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use spherecal_model::chain::Chain;
    use spherecal_shared::robot::{iiwa7, iiwa7_tool};

    use crate::testing::points;
    use crate::{Options, halton_configurations, identify};

    // Fails if the compensator's own arithmetic does not give the TCP of the full model, or if its
    // command does not take the full model to the nominal TCP.
    #[test]
    fn the_compensator_is_the_full_model() {
        let (robot, tool) = (iiwa7(), iiwa7_tool());
        let chain = Chain::unchecked(&robot, &tool);
        // Every group of effects gets a value: angles with waves, and a TCP that sags with its reach.
        let experiment = points((&robot, &tool), halton_configurations(&robot, 120), |q| {
            let real: Vec<f64> = q.iter().map(|q| q + 4e-4 * q.cos() - 2e-4 * (2.0 * q).sin()).collect();
            let tcp = chain.tcp_of(&chain.frames(&real));
            tcp + Vector3::z() * (-5e-4 * tcp.xy().norm_squared())
        });
        let full = identify(&experiment, &Options::default()).unwrap();
        assert!(
            full.compliance_rad_per_nm
                .iter()
                .chain(full.bending_rad_per_nm.iter().flatten())
                .any(|c| *c > 1e-7)
        );
        let compensator = full.compensator(&robot, tool.tcp_m);
        let mut reached = 0;
        for q in halton_configurations(&robot, 100) {
            let off = (compensator.tcp_m(&q) - full.tcp_m(&q, None)).norm();
            assert!(off < 1e-12, "{off} m apart at {q:?}");
            let mut command = q.clone();
            if compensator.command(&q, &mut command).is_ok() {
                reached += 1;
                let off = (full.tcp_m(&command, None) - chain.pose(&q).position).norm();
                assert!(off < 2e-9, "{off} m left at {q:?}");
            }
        }
        // Some configurations are near a singular posture.
        assert!(reached >= 90, "{reached} of 100");
    }
}
