//! The motions that do not count in a statement.

use nalgebra::DMatrix;

use crate::workspace::Rigid;

/// What is taken out of displacements before they count.
#[derive(Clone, Debug)]
pub(super) enum Taken {
    /// The best rigid motion.
    Rigid(Rigid),
    /// The best rigid motion of another model; nothing of the draws, whose frame is that of the fit.
    RigidOfModels(Rigid),
    /// Of contacts the mean of the postures on each sphere and place: of the draws where the fit does not have the place.
    Means {
        unknown: Vec<Vec<usize>>,
        all: Vec<Vec<usize>>,
    },
}

impl Taken {
    pub(super) fn of_draws(&self, columns: &mut DMatrix<f64>) {
        match self {
            Self::Rigid(rigid) => rigid.remove(columns),
            Self::RigidOfModels(_) => {}
            Self::Means { unknown, .. } => remove_means(unknown, columns),
        }
    }

    pub(super) fn of_models(&self, columns: &mut DMatrix<f64>) {
        match self {
            Self::Rigid(rigid) | Self::RigidOfModels(rigid) => rigid.remove(columns),
            Self::Means { all, .. } => remove_means(all, columns),
        }
    }
}

fn remove_means(groups: &[Vec<usize>], columns: &mut DMatrix<f64>) {
    for mut column in columns.column_iter_mut() {
        for group in groups {
            for axis in 0..3 {
                let mean = group.iter().map(|k| column[3 * k + axis]).sum::<f64>() / group.len().max(1) as f64;
                for k in group {
                    column[3 * k + axis] -= mean;
                }
            }
        }
    }
}
