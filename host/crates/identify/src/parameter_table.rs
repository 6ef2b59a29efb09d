//! The table of parameters of a model on given data: the priors, then what the user sets.

use super::error::IdentifyError;
use super::options::Options;
use super::parameters::{Kind, Layout, Override, Parameter};
use super::priors::default_of;
use spherecal_model::Experiment;

/// The table of a model on given data.
///
/// # Errors
/// The name of an override matches nothing, or its number is not possible.
pub(crate) fn table(
    experiment: &Experiment,
    layout: &Layout,
    options: &Options,
) -> Result<Vec<Parameter>, IdentifyError> {
    let mut table: Vec<Parameter> = layout
        .kinds()
        .into_iter()
        .map(|kind| default_of(kind, experiment, layout))
        .collect();
    let mut richest: Option<Vec<Parameter>> = None;
    for (name, set) in &options.parameters.0 {
        match apply(&mut table, name, set) {
            // A smaller model may lack a parameter that the user sets for a larger one.
            Err(IdentifyError::UnknownParameter { .. }) => {
                let all = richest.get_or_insert_with(|| {
                    let layout = Layout::new(experiment, options.harmonics, true);
                    let kinds = layout.kinds().into_iter();
                    kinds.map(|kind| default_of(kind, experiment, &layout)).collect()
                });
                apply(all, name, set)?;
            }
            other => other?,
        }
    }
    Ok(table)
}

fn apply(table: &mut [Parameter], name: &str, set: &Override) -> Result<(), IdentifyError> {
    let option = |field: &str, value, remedy| {
        Err(IdentifyError::Option {
            field: format!("parameters.{name}.{field}"),
            value,
            remedy,
        })
    };
    if let Some(value) = set.prior_sigma
        && !(value > 0.0 && value.is_finite())
    {
        return option("prior_sigma", value, "give a positive number, or `free = false`");
    }
    if let Some(value) = set.nominal
        && !(value.is_finite() && value.abs() < 1e3)
    {
        return option("nominal", value, "give a finite number in SI units");
    }
    let mut found = false;
    for parameter in table.iter_mut() {
        let group = parameter.name.starts_with(name)
            && !name.ends_with(|c: char| c.is_ascii_digit())
            && parameter.name[name.len()..].starts_with(|c: char| c.is_ascii_digit() || c == '_');
        if parameter.name != name && !group {
            continue;
        }
        found = true;
        parameter.nominal = set.nominal.unwrap_or(parameter.nominal);
        if let Some(sigma) = set.prior_sigma {
            parameter.reason = if set.open {
                "the tolerance of the robot's description; the data find the actual size"
            } else {
                "set by the user"
            };
            parameter.set_by_user = !set.open;
            parameter.prior_sigma = match parameter.kind {
                // A group's prior keeps the decay with the order.
                Kind::Cosine(_, k) | Kind::Sine(_, k) if group => sigma / k as f64,
                _ => sigma,
            };
        }
        if let Some(free) = set.free {
            parameter.free = free;
        }
    }
    if found {
        return Ok(());
    }
    let known: Vec<_> = table.iter().take(8).map(|p| p.name.as_str()).collect();
    Err(IdentifyError::UnknownParameter {
        name: name.to_owned(),
        known: format!("there are {}, ...", known.join(", ")),
    })
}
