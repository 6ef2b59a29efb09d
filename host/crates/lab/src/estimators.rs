//! The estimators that the studies compare.

use serde::{Deserialize, Serialize};
use spherecal_identify::{Comparison, Method, Options, Override, identify};

use crate::paper::{self, PaperProcedure};

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
}

impl std::fmt::Display for Estimator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// An estimator to compare with. `None` for those that every table has, and for that which knows the laws where there are none.
pub(crate) fn comparison(estimator: Estimator, known_laws: Option<&Options>) -> Option<Comparison> {
    Some(match estimator {
        Estimator::Nominal | Estimator::Sphere => return None,
        Estimator::KnownLaws => {
            let options = known_laws?.clone();
            Comparison::of_contacts(estimator.name(), move |c| identify(c.contacts(), &options))
        }
        Estimator::Laser => Comparison::laser(),
        Estimator::LaserFull => Comparison::laser_full(),
        Estimator::Geometry => {
            Comparison::of_contacts(estimator.name(), |c| identify(c.contacts(), &c.by(Method::Geometry)))
        }
        Estimator::PaperNelderMead => Comparison::of_contacts(estimator.name(), |c| {
            paper::identify(&c.with_tool(c.contacts()), &c.by(Method::GaussNewton))
        }),
        // The paper holds base and tool at what the arcs gave.
        Estimator::LaserNelderMead => Comparison::of_points(estimator.name(), |c| {
            paper::identify(&c.with_tool(&c.points()), &c.absolute(Method::GaussNewton))
        }),
        Estimator::GaussNewton => Comparison::of_contacts(estimator.name(), |c| {
            let contacts = c.with_tool(c.contacts());
            let per_sphere = PaperProcedure::default().poses_per_sphere;
            let options = Options {
                subset: Some(paper::subset(&contacts, per_sphere, c.options.seed)),
                ..c.by(Method::GaussNewton)
            };
            identify(&contacts, &options)
        }),
        Estimator::TwoHarmonics => Comparison::of_contacts(estimator.name(), |c| {
            let mut options = Options {
                harmonics: 2,
                ..c.by(Method::Full)
            };
            for name in ["bending", "tilt"] {
                let fixed = Override {
                    free: Some(false),
                    ..Override::default()
                };
                options.parameters.0.insert(name.to_owned(), fixed);
            }
            identify(c.contacts(), &options)
        }),
    })
}
