//! The estimators that the studies compare.

use spherecal_identify::{Comparison, Estimator, Method, Options, Override, identify};

use crate::paper::{self, PaperProcedure};

/// An estimator to compare with. `None` for those that every table has, and for that which knows the laws where there are none.
pub(crate) fn comparison(estimator: Estimator, known_laws: Option<&Options>) -> Option<Comparison> {
    Some(match estimator {
        Estimator::Nominal | Estimator::Sphere => return None,
        Estimator::KnownLaws => {
            let options = known_laws?.clone();
            Comparison::new(estimator, move |c| identify(c.contacts(), &options))
        }
        Estimator::Laser => Comparison::laser(),
        Estimator::LaserFull => Comparison::laser_full(),
        Estimator::Geometry => Comparison::new(estimator, |c| identify(c.contacts(), &c.by(Method::Geometry))),
        Estimator::PaperNelderMead => Comparison::new(estimator, |c| {
            paper::identify(&c.with_tool(c.contacts()), &c.by(Method::GaussNewton))
        }),
        // The paper holds base and tool at what the arcs gave.
        Estimator::LaserNelderMead => Comparison::new(estimator, |c| {
            paper::identify(&c.with_tool(&c.points()), &c.absolute(Method::GaussNewton))
        }),
        Estimator::GaussNewton => Comparison::new(estimator, |c| {
            let contacts = c.with_tool(c.contacts());
            let per_sphere = PaperProcedure::default().poses_per_sphere;
            let options = Options {
                subset: Some(paper::subset(&contacts, per_sphere, c.options.seed)),
                ..c.by(Method::GaussNewton)
            };
            identify(&contacts, &options)
        }),
        Estimator::TwoHarmonics => Comparison::new(estimator, |c| {
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
