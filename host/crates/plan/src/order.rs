//! Orders with short moves. Poses in neighbour order take a turn of about a second each; in a random order of four or five.

use spherecal_model::chain::{TcpPose, turn_between};

/// Size of a move, in rad: the larger of rotation and elbow angle determines the time, the other
/// breaks ties.
pub(super) fn move_size(a: &TcpPose, b: &TcpPose) -> f64 {
    let elbow = match (a.elbow, b.elbow) {
        (Some(a), Some(b)) => (b - a).abs(),
        _ => 0.0,
    };
    let turn = turn_between(&a.rotation, &b.rotation);
    turn.max(elbow) + 0.1 * turn.min(elbow)
}

/// A short round trip from node `n` over the nodes 0 to n-1: nearest neighbour, then 2-opt and
/// single moves until nothing gets shorter. `size` is the distance between two nodes, the same in
/// both directions. f32 halves the memory traffic and is precise enough for an order.
pub(super) fn round_trip(n: usize, size: impl Fn(usize, usize) -> f64) -> Vec<usize> {
    if n == 0 {
        return Vec::new();
    }
    let mut distance = vec![0f32; (n + 1) * (n + 1)];
    for a in 0..=n {
        for b in 0..a {
            let d = size(a, b) as f32;
            distance[a * (n + 1) + b] = d;
            distance[b * (n + 1) + a] = d;
        }
    }
    let d = |a: usize, b: usize| distance[a * (n + 1) + b];

    let mut left: Vec<usize> = (0..n).collect();
    let mut tour = vec![n];
    let mut last = n;
    while let Some(k) = (0..left.len()).min_by(|a, b| d(last, left[*a]).total_cmp(&d(last, left[*b]))) {
        last = left.swap_remove(k);
        tour.push(last);
    }
    for _ in 0..50 {
        let improved = two_opt(&mut tour, &d) | relocate(&mut tour, &d);
        if !improved {
            break;
        }
    }
    tour.split_off(1)
}

/// A short way over the nodes 0 to n-1 that begins at node `n + 1` and ends at node `n`. `size` is the distance, in s, between
/// two nodes, the same in both directions.
pub(super) fn one_way(n: usize, size: impl Fn(usize, usize) -> f64) -> Vec<usize> {
    // A round trip with a step from the end to the beginning that costs less than nothing.
    const BACK_S: f64 = -100.0;
    let mut tour = round_trip(n + 1, |a, b| if a.min(b) == n { BACK_S } else { size(a, b) });
    if tour.first() == Some(&n) {
        tour.reverse();
    }
    tour.retain(|k| *k != n);
    tour
}

/// One sweep of 2-opt on a round trip whose first node is fixed.
fn two_opt(tour: &mut [usize], d: &impl Fn(usize, usize) -> f32) -> bool {
    let n = tour.len();
    let mut improved = false;
    for i in 1..n.saturating_sub(1) {
        for j in (i + 1)..n {
            let (before, first, last, after) = (tour[i - 1], tour[i], tour[j], tour[(j + 1) % n]);
            let gain = d(before, first) + d(last, after) - d(before, last) - d(first, after);
            if gain > 1e-5 {
                tour[i..=j].reverse();
                improved = true;
            }
        }
    }
    improved
}

/// One sweep that removes each node and inserts it at the cheapest position.
fn relocate(tour: &mut Vec<usize>, d: &impl Fn(usize, usize) -> f32) -> bool {
    let n = tour.len();
    let mut improved = false;
    for i in 1..n {
        let node = tour[i];
        let detour = |a: usize, b: usize| d(a, node) + d(node, b) - d(a, b);
        let saved = detour(tour[i - 1], tour[(i + 1) % n]);
        // Position k: between tour[k] and the next, not next to itself.
        let best = (0..n)
            .filter(|k| *k != i && *k + 1 != i)
            .map(|k| (k, detour(tour[k], tour[(k + 1) % n])))
            .min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((k, cost)) = best
            && cost < saved - 1e-5
        {
            tour.remove(i);
            let at = if k < i { k + 1 } else { k };
            tour.insert(at, node);
            improved = true;
        }
    }
    improved
}

/// Indices of `count` poses spread well over `poses`: first the nearest to `start`, then always the
/// farthest from those taken.
pub(super) fn spread(start: &TcpPose, poses: &[TcpPose], count: usize) -> Vec<usize> {
    let size = |a: &TcpPose, b: &TcpPose| {
        let elbow = match (a.elbow, b.elbow) {
            (Some(a), Some(b)) => b - a,
            _ => 0.0,
        };
        turn_between(&a.rotation, &b.rotation).hypot(elbow)
    };
    let mut taken = Vec::new();
    let first = (0..poses.len()).min_by(|a, b| size(start, &poses[*a]).total_cmp(&size(start, &poses[*b])));
    let mut gap = vec![f64::INFINITY; poses.len()];
    let mut next = first;
    while let Some(k) = next
        && taken.len() < count
    {
        taken.push(k);
        for (g, pose) in gap.iter_mut().zip(poses) {
            *g = g.min(size(&poses[k], pose));
        }
        next = (0..poses.len())
            .max_by(|a, b| gap[*a].total_cmp(&gap[*b]))
            .filter(|k| gap[*k] > 1e-9);
    }
    taken
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if nodes on a line are not visited out and back without a detour, or on a way between two others not in order.
    #[test]
    fn a_line_is_walked_out_and_back() {
        let places = [0.3, 0.1, 0.9, 0.5, 0.2, 0.7, 0.0_f64];
        let size = |a: usize, b: usize| (places[a] - places[b]).abs();
        let tour = round_trip(6, size);
        let mut sorted = tour.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, [0, 1, 2, 3, 4, 5]);
        let round = core::iter::once(6).chain(tour);
        let ends = round.clone().skip(1).chain(core::iter::once(6));
        let length: f64 = round.zip(ends).map(|(a, b)| size(a, b)).sum();
        assert!((length - 2.0 * size(6, 2)).abs() < 1e-6, "{length}");
        assert_eq!(one_way(5, size), [1, 4, 0, 3, 2][..].to_vec());
    }
}
