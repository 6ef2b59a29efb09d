//! What is believed of each parameter before the data are seen, and why.

use super::parameters::{Kind, Layout, Overrides, Parameter, name_of};
use spherecal_model::Experiment;
use spherecal_model::robots::Tolerances;

/// Prior of lengths `a` and `d`: machining and assembly of a link, in m.
pub const LENGTH_SIGMA_M: f64 = 0.5e-3;
/// Prior of twists `alpha` and `beta`: squareness of two bearings, in rad.
pub const TWIST_SIGMA_RAD: f64 = 0.5e-3;
/// Prior of offsets `theta`: mastering of a joint, in rad.
pub const OFFSET_SIGMA_RAD: f64 = 1e-3;
/// Prior of the TCP in the flange frame: a bolted tool, measured by hand, in m.
pub const TOOL_SIGMA_M: f64 = 1.5e-3;
/// Prior of a seat that some rows have for themselves, about the TCP, in m.
pub const SEAT_SIGMA_M: f64 = 0.5e-3;
/// Prior of targets 2.. about where the first fit puts them: they are not measured by hand, in m.
pub const TARGET_SIGMA_M: f64 = 0.05;
/// Prior of the measured body's orientation about the first fit's, in rad.
pub const BODY_SIGMA_RAD: f64 = 0.1;
/// Prior of the scale of an instrument or a certificate: a laser tracker or a coordinate measuring machine.
pub const SCALE_SIGMA: f64 = 1e-5;
/// Prior of the base's position about its registration: none worth the name, in m.
pub const BASE_SIGMA_M: f64 = 10.0;
/// Prior of the base's rotation about its registration, in rad: far wider than
/// what registration leaves open, but it holds a plate of one or two spheres,
/// whose turn about their line no contact sees.
pub const BASE_SIGMA_RAD: f64 = 0.1;
/// Prior mean of joint compliance, in rad/(N m): a spring gives way to its load
/// and never against it, so its sign is known. Mean and sigma are those of the
/// half of a normal distribution of 4e-6 rad/(N m) that is positive.
pub const COMPLIANCE_MEAN: f64 = 3.2e-6;
/// Prior sigma of joint compliance about [`COMPLIANCE_MEAN`], in rad/(N m).
pub const COMPLIANCE_SIGMA: f64 = 2.4e-6;
/// Prior mean of the bending of links, and its sigma, in rad/(N m). A link gives way to its load, so the sign is known; of all
/// laws of a positive number whose mean is known, the exponential one says least, and its sigma is its mean. A tube of aluminium
/// (0.4 m long, 120 mm wide, wall of 6 mm) has 1.6e-6; a real iiwa 14 has 5e-6 to 1e-5. With a mean of zero the splits of five real
/// tables lost 1.8 % (the iiwa 14 from 20 to 40 rows 15 %).
pub const BENDING: f64 = 3e-6;
/// Prior of the tilt of the base, zero mean, in rad/(N m): it is the table's, and a rigid one is ordinary. With twice the sigma,
/// simulated arms on rigid tables lost 3 %.
pub const TILT_SIGMA: f64 = 1.5e-6;
/// Prior of encoder harmonics of order 1, zero mean; order k has 1/k of it, in rad.
pub const HARMONIC_SIGMA_RAD: f64 = 2e-4;

/// Priors of an arm without a factory calibration, by group of parameters, in m and rad. Sizes as
/// calibrations found them: offsets of Pandas reach 21 mrad. On public data these priors predicted an FR3, a Panda and a
/// Kinova better than the defaults did, and another Kinova and another Panda worse.
pub const UNCALIBRATED: [(&str, f64); 4] = [("a", 1e-3), ("d", 1e-3), ("alpha", 3e-3), ("theta", 20e-3)];

impl Overrides {
    /// Expects the errors of an arm without a factory calibration: lengths of 1 mm, twists of 3 mrad and joint offsets of
    /// 20 mrad (1 sigma). A prior that the user set stays.
    pub fn expect_uncalibrated(&mut self) {
        for (group, sigma) in UNCALIBRATED {
            let set = self.0.entry(group.to_owned()).or_default();
            set.prior_sigma.get_or_insert(sigma);
        }
    }

    /// Takes a robot's own tolerances as ordinary sizes. A prior that the user set stays.
    pub fn expect_tolerances(&mut self, tolerances: &Tolerances) {
        let groups = [
            ("a", tolerances.length_m),
            ("d", tolerances.length_m),
            ("alpha", tolerances.twist_rad),
            ("theta", tolerances.offset_rad),
        ];
        for (group, sigma) in groups {
            if let Some(sigma) = sigma {
                let set = self.0.entry(group.to_owned()).or_default();
                if set.prior_sigma.is_none() {
                    set.prior_sigma = Some(sigma);
                    set.open = true;
                }
            }
        }
    }
}

/// The row of one kind: nominal value, prior and its reason, free or fixed.
pub(crate) fn default_of(kind: Kind, experiment: &Experiment, layout: &Layout) -> Parameter {
    let (name, unit) = name_of(kind, layout);
    let last = layout.n.saturating_sub(1);
    let row = |i: usize| experiment.robot.joints.get(i).map(|j| j.mdh).unwrap_or_default();
    let base_does = "fixed: the base frame moves the TCP alike";
    let (nominal, prior_sigma, fixed, reason) = match kind {
        Kind::Alpha(i) if i == 0 => (row(i).alpha, TWIST_SIGMA_RAD, true, base_does),
        Kind::Alpha(i) => (
            row(i).alpha,
            TWIST_SIGMA_RAD,
            false,
            "squareness of two bearings of a link",
        ),
        Kind::A(i) if i == 0 => (row(i).a, LENGTH_SIGMA_M, true, base_does),
        Kind::A(i) => (row(i).a, LENGTH_SIGMA_M, false, "machining and assembly of a link"),
        Kind::Beta(i) => (
            row(i).beta,
            TWIST_SIGMA_RAD,
            false,
            "parallelism of two bearings of a link",
        ),
        Kind::D(i) if i == 0 => (row(i).d, LENGTH_SIGMA_M, true, base_does),
        Kind::D(i) if i == last => (row(i).d, LENGTH_SIGMA_M, true, "fixed: tool_z moves the TCP alike"),
        Kind::D(i) => (row(i).d, LENGTH_SIGMA_M, false, "machining and assembly of a link"),
        Kind::Theta(i) if i == 0 => (row(i).theta, OFFSET_SIGMA_RAD, true, base_does),
        Kind::Theta(i) if i == last => (
            row(i).theta,
            OFFSET_SIGMA_RAD,
            true,
            "fixed: the tool moves the TCP alike",
        ),
        Kind::Theta(i) => (row(i).theta, OFFSET_SIGMA_RAD, false, "mastering of a joint"),
        Kind::Tool(k) => (
            experiment.tool.tcp_m.get(k).copied().unwrap_or_default(),
            TOOL_SIGMA_M,
            false,
            "a bolted tool measured by hand",
        ),
        Kind::Target(..) => (
            0.0,
            TARGET_SIGMA_M,
            false,
            "wide: only the data say where the target is on the tool",
        ),
        Kind::Body(_) => (
            0.0,
            BODY_SIGMA_RAD,
            false,
            "wide: only the data say how the measured body is turned",
        ),
        Kind::Bending(..) => (BENDING, BENDING, false, "a link: a spring, so of known sign"),
        Kind::Tilt(_) => (0.0, TILT_SIGMA, false, "zero-mean random effect: a stiff table"),
        Kind::Compliance(_) => (
            COMPLIANCE_MEAN,
            COMPLIANCE_SIGMA,
            false,
            "a geared joint: a spring, so of known sign",
        ),
        Kind::Cosine(_, k) | Kind::Sine(_, k) => (
            0.0,
            HARMONIC_SIGMA_RAD / k as f64,
            false,
            "zero-mean random effect: encoder eccentricity, decaying with the order",
        ),
        Kind::Base(_, k) => {
            let sigma = if k < 3 { BASE_SIGMA_M } else { BASE_SIGMA_RAD };
            (0.0, sigma, false, "flat: only the data say where the base is")
        }
        Kind::Scale => (
            0.0,
            SCALE_SIGMA,
            false,
            "calibration of the instrument, or of what measured the plate",
        ),
        Kind::Sphere(s, _) => {
            let sigma = layout
                .spheres
                .get(s)
                .and_then(|id| experiment.spheres.iter().find(|x| x.id == *id))
                .map_or(0.0, |x| x.sigma_m);
            (
                0.0,
                sigma,
                sigma == 0.0,
                "offset from the certificate, within its uncertainty",
            )
        }
        Kind::Seat(..) => (
            0.0,
            SEAT_SIGMA_M,
            false,
            "wide: in these rows the sphere sat elsewhere in the nest",
        ),
    };
    Parameter {
        name,
        kind,
        unit,
        nominal,
        prior_sigma,
        free: !fixed,
        set_by_user: false,
        reason,
    }
}
