//! The optimal plan: poses chosen by the predicted TCP error over the workspace, with the accuracy
//! to expect before anything moves.
//!
//! A first small design over all visits shows which visits are worth an approach and a coupling.
//! Then the poses are chosen on those visits alone.

use super::candidates::CandidateVisit;
use super::cell::Cell;
use super::design_problem::{DesignProblem, model_of, predictions};
use super::design_request::DesignRequest;
use super::error::PlanError;
use super::optimal::Design;
use super::selection::SelectionProblem;
use super::travel::Travel;
use super::types::{Accuracy, Plan};
use spherecal_identify::Options;
use spherecal_model::chain::Chain;

/// Poses at most that an asked accuracy may take.
const LONGEST: usize = 400;
/// Poses and candidates of each visit in the choice of visits.
const SCOUT: (usize, usize) = (40, 60);
/// Number of poses that take as long as a visit with its travel.
const VISIT_POSES: usize = 7;
/// Candidates that an exchange considers besides the chosen ones.
const SHORTLIST: usize = 700;

/// Chooses and orders the poses. [`Plan::promise`] has the predicted accuracy.
///
/// # Errors
/// The cell or the request is not possible, the arm cannot reach a sphere, or the identification
/// refuses the options.
pub fn design(cell: &Cell, request: &DesignRequest) -> Result<Plan, PlanError> {
    if request.poses == 0 {
        return Err(PlanError::OutOfRange {
            field: "poses",
            value: 0.0,
            remedy: "ask for at least one pose",
        });
    }
    let design_problem = design_problem(cell, request)?;
    let mut first = design_problem.design(request);
    let mut curve = vec![accuracy(&first, request)];
    design_problem.fill(&mut first, request.poses, |d| {
        if worth_noting(d.chosen.len()) {
            curve.push(accuracy(d, request));
        }
    });
    // Hopeless candidates are not looked at again.
    let shortlist = first.shortlist(SHORTLIST);
    let chosen = (0..first.chosen.len()).collect();
    let design_problem = design_problem.only(&shortlist);
    let mut design = Design::of(&design_problem.problem, chosen);
    if request.patience.is_finite() {
        design.hurry(
            Travel::new(
                &design_problem.chain,
                &design_problem.candidates,
                &design_problem.visits,
            ),
            request.patience,
        );
    }
    design.exchange(request.passes, 0.005);
    let mut plan = design_problem.plan(cell, request, &design.chosen);
    let accuracy = accuracy(&design, request);
    plan.promise
        .extend(curve.into_iter().filter(|a| a.poses < accuracy.poses));
    plan.promise.push(accuracy);
    Ok(plan)
}

/// The design problem of a request: its visits chosen, candidates on each.
fn design_problem(cell: &Cell, request: &DesignRequest) -> Result<DesignProblem, PlanError> {
    let all = DesignProblem::visits(cell, request)?;
    let visits = if all.visits.len() > all.groups() {
        let count = SCOUT.1 * all.visits.len();
        worthwhile(all.with_candidates(cell, request, count)?, request)
    } else {
        all.visits.clone()
    };
    let count = request.range.candidates;
    DesignProblem { visits, ..all }.with_candidates(cell, request, count)
}

/// The visits that are worth an approach and a coupling. Visits are removed one after the other,
/// always the one that the others replace best, while there are too many or while the time of a
/// visit is better spent on more poses of the others. One visit of each sphere in each placement
/// stays.
///
/// A visit is harder to replace the fewer others are left. So its value from an earlier round bounds that of this round from
/// below, and only the visits whose bound is the smallest are tried again (lazy greedy search).
fn worthwhile(scouted: DesignProblem, request: &DesignRequest) -> Vec<CandidateVisit> {
    let most = match request.contacts {
        0 => usize::MAX,
        contacts => contacts.max(scouted.groups()),
    };
    let poses = request.poses.min(SCOUT.0);
    let mut design = Design::new(&scouted.problem);
    scouted.fill(&mut design, poses, |_| ());
    let mut kept = vec![true; scouted.visits.len()];
    let key = |v: usize| (scouted.visits[v].sphere_id, scouted.visits[v].place);
    let among = |kept: &[bool]| scouted.candidates.iter().map(|c| kept[c.visit]).collect();
    // For each visit the least value that the design without it can have, and the number of additional poses that the bound is for.
    let mut bounds = vec![(f64::NEG_INFINITY, 0); kept.len()];
    loop {
        let count = kept.iter().filter(|k| **k).count();
        // Number of additional poses for one visit less; in a small design its share.
        let more = if count > most {
            0
        } else {
            VISIT_POSES * poses / request.poses
        };
        let others = |v: usize| (0..kept.len()).any(|w| kept[w] && w != v && key(w) == key(v));
        let removable: Vec<usize> = (0..kept.len()).filter(|v| kept[*v] && others(*v)).collect();
        for v in &removable {
            if bounds[*v].1 != more {
                bounds[*v] = (f64::NEG_INFINITY, more);
            }
        }
        let mut tried = vec![false; kept.len()];
        let best = loop {
            let bound = |v: &&usize| bounds[**v].0;
            let least = removable.iter().min_by(|a, b| bound(a).total_cmp(&bound(b)));
            let Some(v) = least.copied().filter(|v| !tried[*v]) else {
                break least.copied();
            };
            let mut without = kept.clone();
            without[v] = false;
            bounds[v].0 = design.among(among(&without), poses + more).value;
            tried[v] = true;
        };
        match best {
            Some(v) if count > most || bounds[v].0 <= design.value => {
                kept[v] = false;
                design = design.among(among(&kept), poses);
            }
            _ => break,
        }
    }
    let visits = scouted.visits.iter().cloned().zip(kept);
    visits.filter(|(_, kept)| *kept).map(|(v, _)| v).collect()
}

fn accuracy(design: &Design<'_>, request: &DesignRequest) -> Accuracy {
    let predicted = design.predicted(1.0 / request.options.noise.inflation);
    Accuracy {
        poses: design.chosen.len(),
        mean_mm: predicted.mean * 1e3,
        worst_mm: predicted.worst * 1e3,
    }
}

/// The plan with the fewest poses whose predicted mean error is `wanted_mm`
/// ([`Accuracy::mean_mm`]). The number of poses in the request is ignored.
///
/// The number comes from a growing design. It is then lowered while the plan itself, which also weighs
/// the travel as the request says, meets the error, or raised until it does.
///
/// # Errors
/// See [`design`]; and [`PlanError::Accuracy`] if 400 poses are not enough.
pub fn design_for(cell: &Cell, request: &DesignRequest, wanted_mm: f64) -> Result<Plan, PlanError> {
    if !(wanted_mm > 0.0) {
        return Err(PlanError::OutOfRange {
            field: "accuracy_mm",
            value: wanted_mm,
            remedy: "give a positive mean error in mm",
        });
    }
    let most = DesignRequest {
        poses: LONGEST,
        ..request.clone()
    };
    let mut poses = poses_for(cell, &most, wanted_mm)?;
    let (mut enough, mut raised): (Option<Plan>, bool) = (None, false);
    loop {
        let plan = design(
            cell,
            &DesignRequest {
                poses,
                ..request.clone()
            },
        )?;
        let promised = plan.promise.last().map_or(f64::INFINITY, |a| a.mean_mm);
        match (promised <= wanted_mm, enough) {
            // The growing design needs more poses than one with exchanges.
            (true, _) if poses > 1 && !raised => {
                poses -= poses.div_ceil(10);
                enough = Some(plan);
            }
            (true, _) => return Ok(plan),
            (false, Some(plan)) => return Ok(plan),
            (false, None) if poses >= LONGEST => {
                return Err(PlanError::Accuracy {
                    wanted_mm,
                    poses,
                    best_mm: promised,
                });
            }
            (false, None) => {
                raised = true;
                poses = (poses + poses.div_ceil(20)).min(LONGEST);
                enough = None;
            }
        }
    }
}

/// Number of poses after which a growing design predicts the wanted mean error (mm).
fn poses_for(cell: &Cell, request: &DesignRequest, wanted_mm: f64) -> Result<usize, PlanError> {
    let design_problem = design_problem(cell, request)?;
    let mut design = design_problem.design(request);
    for poses in 1..=request.poses {
        design.grow(poses, |_| ());
        // The mean is somewhat smaller than the root mean square, which is available.
        let maybe = design.root_mean_square(1.0 / request.options.noise.inflation) * 0.7e3 <= wanted_mm;
        if maybe && accuracy(&design, request).mean_mm <= wanted_mm {
            return Ok(poses);
        }
        if design.chosen.len() < poses {
            break;
        }
    }
    Err(PlanError::Accuracy {
        wanted_mm,
        poses: design.chosen.len(),
        best_mm: accuracy(&design, request).mean_mm,
    })
}

/// Predicted accuracy of a plan from any source (for example the paper's grid).
///
/// # Errors
/// See [`design`].
pub fn predicted_accuracy(cell: &Cell, plan: &Plan, options: &Options) -> Result<Accuracy, PlanError> {
    let model = model_of(cell, options)?;
    let chain = Chain::new(&cell.robot, &cell.tool)?;
    let rows: Vec<Vec<f64>> = plan
        .spheres
        .iter()
        .flat_map(|visit| {
            let recorded = visit.poses.iter().filter(|p| !p.via);
            recorded.map(|p| model.observation(&p.joints, visit.sphere_id, visit.place as usize))
        })
        .collect();
    let problem = SelectionProblem::new(model.columns(), &rows, &predictions(&model, cell, &chain));
    let all = Design::with_all(&problem);
    let predicted = all.predicted(1.0 / options.noise.inflation);
    Ok(Accuracy {
        poses: rows.len(),
        mean_mm: predicted.mean * 1e3,
        worst_mm: predicted.worst * 1e3,
    })
}

/// Numbers of poses that the curve keeps.
fn worth_noting(poses: usize) -> bool {
    let step = match poses {
        0..=30 => 5,
        31..=100 => 10,
        _ => 50,
    };
    poses.is_multiple_of(step)
}

#[cfg(test)]
#[path = "design_tests.rs"]
mod tests;
