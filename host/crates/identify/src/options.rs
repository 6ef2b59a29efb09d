//! What the user may ask of an identification: method, model, noise, parameters.

use core::fmt;
use core::str::FromStr;

use serde::{Deserialize, Serialize};

use super::error::IdentifyError;
use super::parameters::Overrides;
use spherecal_model::Pose;

/// How the model is fitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The full model: robust maximum a posteriori with geometry, compliance and
    /// encoder harmonics. The default and the best.
    // Stored configurations of earlier versions call it `map`.
    #[default]
    #[serde(alias = "map")]
    Full,
    /// The same estimator with geometry alone.
    Geometry,
    /// Levenberg-Marquardt on the paper's distance residuals and 21 parameters.
    Lm,
    /// Gauss-Newton on the same.
    // Stored configurations of earlier versions may name the paper's simplex, which sought the least of the same fitness.
    #[serde(alias = "nelder-mead", alias = "nelder-mead-scaled")]
    GaussNewton,
}

impl Method {
    /// All methods, in the order of the documentation.
    pub const ALL: [Self; 4] = [Self::Full, Self::Geometry, Self::Lm, Self::GaussNewton];

    /// Name on the command line and in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Full => "full",
            Self::Geometry => "geometry",
            Self::Lm => "lm",
            Self::GaussNewton => "gauss-newton",
        }
    }
}

/// Which errors of the robot are modelled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// Links, tool and base.
    Geometry,
    /// And joint compliance and link bending under gravity.
    Stiffness,
    /// And encoder harmonics.
    #[default]
    Full,
}

impl Model {
    /// All models, poorest first.
    pub const ALL: [Self; 3] = [Self::Geometry, Self::Stiffness, Self::Full];

    /// Name on the command line and in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Geometry => "geometry",
            Self::Stiffness => "stiffness",
            Self::Full => "full",
        }
    }
}

/// A name that is none of those there are.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{name}` is not one of {known}{hint}")]
pub struct UnknownName {
    name: String,
    known: String,
    hint: &'static str,
}

/// What to give in place of a name of an earlier version.
fn renamed(name: &str) -> &'static str {
    match name {
        "map" => ": give `full`, the new name of `map`",
        "nelder-mead" | "nelder-mead-scaled" => ": the paper's simplex is in `spherecal-lab reproduce`",
        _ => "",
    }
}

macro_rules! named {
    ($type:ty) => {
        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(self.name())
            }
        }

        impl FromStr for $type {
            type Err = UnknownName;

            fn from_str(name: &str) -> Result<Self, UnknownName> {
                Self::ALL
                    .into_iter()
                    .find(|x| x.name() == name)
                    .ok_or_else(|| UnknownName {
                        name: name.to_owned(),
                        known: Self::ALL.map(Self::name).join(", "),
                        hint: renamed(name),
                    })
            }
        }
    };
}

named!(Method);
named!(Model);

/// Where the torque that bends the joints comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Torque {
    /// From the inertial model where the robot has masses, else measured.
    #[default]
    Auto,
    /// From the inertial model.
    Model,
    /// From the data's `tau` columns.
    Measured,
}

/// What a measurement is worth before its residuals have been seen.
///
/// Only the ratio of the two parts matters where the scale is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    /// Unmodelled joint error of each joint (1 sigma), in rad: gear noise and
    /// what the harmonics leave; it reaches the TCP through the joint Jacobian.
    pub joint_rad: f64,
    /// Seating of the nest on a sphere (1 sigma, each axis), in m.
    pub seating_m: f64,
    /// Measured point of absolute data (1 sigma, each axis), in m. Default:
    /// 49 µm at 95 %, the paper's tracker.
    pub point_m: f64,
    /// Estimate a common factor of the noise from the residuals.
    pub estimate: bool,
    /// Most by which the estimated noise is inflated: gear errors repeat with
    /// position, so residuals are not white and each counts for less than one. It
    /// is used in full where residuals repeat or where few poses cannot tell, and
    /// not at all where many poses show white noise.
    pub inflation: f64,
}

impl Default for Noise {
    fn default() -> Self {
        Self {
            joint_rad: 1e-4,
            seating_m: 10e-6,
            point_m: 49e-6 / 1.96,
            estimate: true,
            inflation: 2.0,
        }
    }
}

/// Which pairs' fitness the paper's estimators minimise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Pairs {
    /// Differences of distances, as the authors' library computes: free of the
    /// base rotation.
    #[default]
    Norm,
    /// Differences of vectors, as Equations 9 to 11 print: needs the rotation of
    /// the base in the plate's frame.
    Vector,
}

/// Everything that may be asked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// How the model is fitted.
    pub method: Method,
    /// Which errors are modelled (methods `full` and `geometry`).
    pub model: Model,
    /// Encoder harmonics per joint, orders 1 to this.
    pub harmonics: usize,
    /// Noise before the data are seen.
    pub noise: Noise,
    /// Degrees of freedom of the Student-t weights; lighter tails are taken where
    /// the residuals speak for them. 0 for least squares.
    pub student_t: f64,
    /// Where the joint torque comes from.
    pub torque: Torque,
    /// Nominal values, priors and fixed parameters, by name.
    pub parameters: Overrides,
    /// Base pose (F0 in the plate's or tracker's frame) where it was measured:
    /// start of `full`, fixed for the paper's estimators.
    pub base: Option<Pose>,
    /// Fitness of the paper's estimators.
    pub pairs: Pairs,
    /// Indices of the observations that the paper's estimators use; all if none.
    pub subset: Option<Vec<usize>>,
    /// Seed of what draws at random.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: Method::Full,
            model: Model::Full,
            harmonics: 30,
            noise: Noise::default(),
            student_t: 4.0,
            torque: Torque::Auto,
            parameters: Overrides::default(),
            base: None,
            pairs: Pairs::Norm,
            subset: None,
            seed: 1,
        }
    }
}

impl Options {
    /// Checks every number.
    ///
    /// # Errors
    /// The first that is not possible, with its value and the remedy.
    pub fn check(&self) -> Result<(), IdentifyError> {
        let positive = |field: &str, value: f64| {
            if value > 0.0 && value.is_finite() {
                Ok(())
            } else {
                Err(IdentifyError::Option {
                    field: field.to_owned(),
                    value,
                    remedy: "give a positive number",
                })
            }
        };
        positive("noise.joint_rad", self.noise.joint_rad)?;
        positive("noise.seating_m", self.noise.seating_m)?;
        positive("noise.point_m", self.noise.point_m)?;
        positive("noise.inflation", self.noise.inflation)?;
        if !(self.student_t >= 0.0 && self.student_t.is_finite()) {
            return Err(IdentifyError::Option {
                field: "student_t".to_owned(),
                value: self.student_t,
                remedy: "give the degrees of freedom, or 0 for least squares",
            });
        }
        if self.harmonics > 64 {
            return Err(IdentifyError::Option {
                field: "harmonics".to_owned(),
                value: self.harmonics as f64,
                remedy: "give at most 64 orders",
            });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a run that an earlier version stored cannot be read any more because of the name of its method.
    #[test]
    fn stored_methods_of_earlier_versions_are_read() {
        for (name, method) in [
            ("map", Method::Full),
            ("nelder-mead", Method::GaussNewton),
            ("nelder-mead-scaled", Method::GaussNewton),
        ] {
            let read: Method = serde_json::from_value(name.into()).expect("a method");
            assert_eq!(read, method);
        }
    }
}
