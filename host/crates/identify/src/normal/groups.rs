//! Groups of observations, and sums over them on all cores that do not depend on the number of threads.

use rayon::prelude::*;

use crate::chain::Prepared;
use crate::parameters::Layout;

/// Group of observations that share a reference frame, a sphere and a seat.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Group {
    pub(crate) reference: usize,
    pub(crate) sphere: Option<usize>,
    pub(crate) seat: Option<usize>,
    /// Indices into the prepared observations.
    pub(crate) members: Vec<usize>,
}

/// Groups in order of first appearance.
pub(crate) fn groups(prepared: &[Prepared]) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    let mut at = std::collections::HashMap::new();
    for (i, observation) in prepared.iter().enumerate() {
        let key = (observation.reference, observation.sphere, observation.seat);
        let slot = *at.entry(key).or_insert_with(|| {
            groups.push(Group {
                reference: key.0,
                sphere: key.1,
                seat: key.2,
                members: Vec::new(),
            });
            groups.len() - 1
        });
        groups[slot].members.push(i);
    }
    groups
}

/// Poses that one task sums. Sums of as many or fewer are those of a plain loop,
/// to the last bit; those of more do not depend on the number of threads.
pub(super) const BLOCK: usize = 16_384;
/// Tasks whose sums are in memory together.
const BATCH: usize = 16;

/// The poses of all groups in blocks: number of the group, and its poses.
fn blocks(groups: &[Group]) -> Vec<(usize, &[usize])> {
    let of = |(g, group)| -> Vec<(usize, &[usize])> {
        let group: &Group = group;
        group.members.chunks(BLOCK).map(|members| (g, members)).collect()
    };
    groups.iter().enumerate().flat_map(of).collect()
}

/// Sums each group's blocks with `sum`, on all cores where there are many poses,
/// and hands each group's total to `done`, in order. `add` adds the second sum to
/// the first.
pub(super) fn by_group<'g, S: Send>(
    groups: &'g [Group],
    sum: impl Fn(&'g [usize]) -> S + Sync,
    add: impl Fn(&mut S, &S),
    mut done: impl FnMut(&'g Group, &S),
) {
    let blocks = blocks(groups);
    let many = groups.iter().map(|g| g.members.len()).sum::<usize>() > BLOCK;
    let mut open: Option<(usize, S)> = None;
    for batch in blocks.chunks(BATCH) {
        let sums: Vec<S> = if many {
            batch.par_iter().map(|(_, members)| sum(members)).collect()
        } else {
            batch.iter().map(|(_, members)| sum(members)).collect()
        };
        for ((group, _), next) in batch.iter().zip(sums) {
            match &mut open {
                Some((last, total)) if last == group => add(total, &next),
                _ => {
                    if let Some((last, total)) = open.replace((*group, next)) {
                        done(&groups[last], &total);
                    }
                }
            }
        }
    }
    if let Some((last, total)) = open {
        done(&groups[last], &total);
    }
}

pub(super) fn add_all(to: &mut [f64], from: &[f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += from;
    }
}

/// Where a group's own column lies in the layout. Sphere columns are the base's shifts with the sign
/// turned; seat columns are the tool's.
pub(super) fn places(layout: &Layout, group: &Group) -> Vec<(usize, usize, f64)> {
    let general = layout.general();
    let mut places: Vec<_> = (0..general).map(|c| (c, c, 1.0)).collect();
    places.extend((0..6).map(|k| (general + k, layout.base(group.reference) + k, 1.0)));
    if let Some(sphere) = group.sphere {
        places.extend((0..3).map(|k| (general + k, layout.sphere(sphere) + k, -1.0)));
    }
    if let Some(seat) = group.seat {
        places.extend((0..3).map(|k| (3 * layout.n + k, layout.seat(seat) + k, 1.0)));
    }
    places
}
