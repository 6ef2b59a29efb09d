//! The estimators that an evaluation can compare with.

use serde::{Deserialize, Serialize};

/// An estimator on one kind of data. The names are those of tables and files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Estimator {
    /// The nominal robot with the tool as the instrument measured it.
    Nominal,
    /// Contacts: the paper's mini-batch Nelder-Mead, 100 poses a sphere.
    PaperNelderMead,
    /// Contacts: Gauss-Newton on the paper's pairs and 21 parameters, 100 poses a sphere.
    GaussNewton,
    /// Contacts: geometry with priors.
    Geometry,
    /// Contacts: geometry, compliance and two harmonics.
    TwoHarmonics,
    /// Contacts: the calibration itself, by default the full model.
    Sphere,
    /// Tracker: the paper's Nelder-Mead, base and tool as measured.
    LaserNelderMead,
    /// Tracker: Gauss-Newton on the geometry, base and tool as measured.
    Laser,
    /// Tracker: the full model.
    LaserFull,
    /// Contacts: the full model with the priors that a simulation drew its arm from.
    KnownLaws,
}

impl Estimator {
    /// All of them, in the order of tables.
    pub const ALL: [Self; 10] = [
        Self::Nominal,
        Self::PaperNelderMead,
        Self::GaussNewton,
        Self::Geometry,
        Self::TwoHarmonics,
        Self::Sphere,
        Self::LaserNelderMead,
        Self::Laser,
        Self::LaserFull,
        Self::KnownLaws,
    ];

    /// Name in tables and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Nominal => "nominal",
            Self::PaperNelderMead => "paper_nelder_mead",
            Self::GaussNewton => "gauss_newton",
            Self::Geometry => "geometry",
            Self::TwoHarmonics => "two_harmonics",
            Self::Sphere => "sphere",
            Self::LaserNelderMead => "laser_nelder_mead",
            Self::Laser => "laser",
            Self::LaserFull => "laser_full",
            Self::KnownLaws => "known_laws",
        }
    }

    /// Whether it calibrates from the instrument's points.
    pub const fn by_tracker(self) -> bool {
        matches!(self, Self::LaserNelderMead | Self::Laser | Self::LaserFull)
    }

    /// Whether the rest of an evaluation goes on where it gives no model.
    pub(super) const fn optional(self) -> bool {
        matches!(self, Self::PaperNelderMead | Self::KnownLaws)
    }
}

/// What a model of a table is called for people, on the terminal and in the report; its own
/// name where it has no other.
pub fn model_title(name: &str) -> &str {
    match name {
        "sphere" => "spheres (this calibration)",
        "laser" => "laser tracker, geometry",
        "laser_full" => "laser tracker, full model",
        "calibrated_table_only" => "calibrated, URDF only",
        other => other,
    }
}

impl std::fmt::Display for Estimator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}
