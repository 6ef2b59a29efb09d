//! When the arm rested, and the pose of each rest.

use super::targets::{TargetAt, Where};

/// Shortest rest, in s.
pub const REST_S: f64 = 0.3;
/// Longest time between two joint states of a rest, in s.
pub const GAP_S: f64 = 0.5;
/// Joint states count for a pose up to this time from a target, in s.
pub const NEAR_S: f64 = 0.25;

/// Lengths up to which times without motion are counted, in s; the last is [`REST_S`].
pub(crate) const SHORT_S: [f64; 3] = [0.05, 0.15, REST_S];

const REST_NS: i64 = (REST_S * 1e9) as i64;
const GAP_NS: i64 = (GAP_S * 1e9) as i64;
const NEAR_NS: i64 = (NEAR_S * 1e9) as i64;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RestMeasurement {
    pub(crate) at: Where,
    /// Targets that it is the mean of.
    pub(crate) count: usize,
    /// Largest distance of a point from the mean, in m.
    pub(crate) spread_m: f64,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RestPose {
    /// Begin and end of the rest, in ns.
    pub(crate) from_ns: i64,
    pub(crate) to_ns: i64,
    /// Mean joint angles, in rad.
    pub(crate) q: Vec<f64>,
    /// Mean efforts, where every joint state has them.
    pub(crate) effort: Option<Vec<f64>>,
    pub(crate) measured: RestMeasurement,
}

/// Why the targets of a rest are not one target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Mixed {
    pub(crate) from_ns: i64,
    pub(crate) to_ns: i64,
    pub(crate) first: Where,
    pub(crate) other: Where,
}

/// A time without motion, so far.
#[derive(Debug)]
struct Still {
    from_ns: i64,
    to_ns: i64,
    min: Vec<f64>,
    max: Vec<f64>,
    /// First angles and efforts: sums are of the differences from these.
    q: Vec<f64>,
    effort: Option<Vec<f64>>,
    sum: Vec<f64>,
    effort_sum: Vec<f64>,
    count: usize,
}

impl Still {
    fn new(time_ns: i64, q: &[f64], effort: Option<&[f64]>) -> Self {
        Self {
            from_ns: time_ns,
            to_ns: time_ns,
            min: q.to_vec(),
            max: q.to_vec(),
            q: q.to_vec(),
            effort: effort.map(<[f64]>::to_vec),
            sum: vec![0.0; q.len()],
            effort_sum: vec![0.0; q.len()],
            count: 0,
        }
    }

    /// Whether angles are within the band of all before.
    fn holds(&self, q: &[f64], band_rad: f64) -> bool {
        let mut bounds = self.min.iter().zip(&self.max);
        q.iter().all(|q| {
            bounds
                .next()
                .is_some_and(|(min, max)| max.max(*q) - min.min(*q) <= band_rad)
        })
    }

    fn extend(&mut self, time_ns: i64, q: &[f64]) {
        self.to_ns = time_ns;
        for ((min, max), q) in self.min.iter_mut().zip(&mut self.max).zip(q) {
            *min = min.min(*q);
            *max = max.max(*q);
        }
    }

    fn add(&mut self, q: &[f64], effort: Option<&[f64]>) {
        self.count += 1;
        for ((sum, q), first) in self.sum.iter_mut().zip(q).zip(&self.q) {
            *sum += q - first;
        }
        match (&self.effort, effort) {
            (Some(first), Some(effort)) => {
                for ((sum, tau), first) in self.effort_sum.iter_mut().zip(effort).zip(first) {
                    *sum += tau - first;
                }
            }
            _ => self.effort = None,
        }
    }

    fn means(&self) -> (Vec<f64>, Option<Vec<f64>>) {
        let n = self.count.max(1) as f64;
        let mean = |first: &[f64], sum: &[f64]| first.iter().zip(sum).map(|(first, sum)| first + sum / n).collect();
        (
            mean(&self.q, &self.sum),
            self.effort.as_deref().map(|first| mean(first, &self.effort_sum)),
        )
    }
}

/// Finds the rests in a stream of joint states.
#[derive(Debug)]
pub(crate) struct Rests<'a> {
    targets: &'a [TargetAt],
    band_rad: f64,
    /// Targets before this one are too early for the joint states that come.
    near: usize,
    /// Targets before this one are of an earlier time than the current still time, or used.
    next: usize,
    still: Option<Still>,
    last_ns: Option<i64>,
    pub(crate) poses: Vec<RestPose>,
    /// Targets that are in no rest.
    pub(crate) left_out: usize,
    /// Rests, also without targets.
    pub(crate) count: usize,
    /// Time in rests, in ns.
    pub(crate) rested_ns: i64,
    /// Times without motion that are shorter than a rest, by [`SHORT_S`]; single joint states are none.
    pub(crate) short: [u64; SHORT_S.len()],
    /// The longest time without motion, in ns.
    pub(crate) longest_ns: i64,
    /// Joint states that are older than the one before.
    pub(crate) backwards: u64,
    /// First and last time, in ns.
    pub(crate) span_ns: Option<(i64, i64)>,
}

impl<'a> Rests<'a> {
    /// `targets` are in the order of their times.
    pub(crate) fn new(targets: &'a [TargetAt], band_rad: f64) -> Self {
        Self {
            targets,
            band_rad,
            near: 0,
            next: 0,
            still: None,
            last_ns: None,
            poses: Vec::new(),
            left_out: 0,
            count: 0,
            rested_ns: 0,
            short: [0; SHORT_S.len()],
            longest_ns: 0,
            backwards: 0,
            span_ns: None,
        }
    }

    /// Takes a joint state. Angles that are not finite end a rest.
    /// Errors: a rest whose targets are not one.
    pub(crate) fn push(&mut self, time_ns: i64, q: &[f64], effort: Option<&[f64]>) -> Result<(), Mixed> {
        let last = *self.last_ns.get_or_insert(time_ns);
        if time_ns < last {
            self.backwards += 1;
            return Ok(());
        }
        self.last_ns = Some(time_ns);
        self.span_ns = Some((self.span_ns.map_or(time_ns, |(from, _)| from), time_ns));
        if !q.iter().all(|q| q.is_finite()) {
            return self.close();
        }
        let goes_on =
            time_ns - last <= GAP_NS && self.still.as_ref().is_some_and(|still| still.holds(q, self.band_rad));
        if !goes_on {
            self.close()?;
        }
        let near = self.is_near(time_ns);
        let still = self.still.get_or_insert_with(|| Still::new(time_ns, q, effort));
        still.extend(time_ns, q);
        if near {
            still.add(q, effort);
        }
        Ok(())
    }

    fn is_near(&mut self, time_ns: i64) -> bool {
        let too_early = |target: &TargetAt| target.time_ns < time_ns.saturating_sub(NEAR_NS);
        while self.targets.get(self.near).is_some_and(too_early) {
            self.near += 1;
        }
        let target = self.targets.get(self.near);
        target.is_some_and(|target| target.time_ns <= time_ns.saturating_add(NEAR_NS))
    }

    /// Ends the current time without motion.
    fn close(&mut self) -> Result<(), Mixed> {
        let Some(still) = self.still.take() else { return Ok(()) };
        let lasts = still.to_ns - still.from_ns;
        self.longest_ns = self.longest_ns.max(lasts);
        if lasts < REST_NS {
            let bin = SHORT_S.iter().position(|s| lasts as f64 * 1e-9 <= *s);
            if let Some(count) = bin.filter(|_| lasts > 0).and_then(|bin| self.short.get_mut(bin)) {
                *count += 1;
            }
            return Ok(());
        }
        self.count += 1;
        self.rested_ns = self.rested_ns.saturating_add(lasts);
        let until = |from: usize, before: &dyn Fn(i64) -> bool| {
            let rest = self.targets.get(from..).unwrap_or_default();
            from + rest.partition_point(|target| before(target.time_ns))
        };
        let begin = until(self.next, &|t| t < still.from_ns);
        let end = until(begin, &|t| t <= still.to_ns);
        self.left_out += begin - self.next;
        self.next = end;
        let Some((first, rest)) = self.targets.get(begin..end).and_then(<[TargetAt]>::split_first) else {
            return Ok(());
        };
        let mixed = |other: Where| Mixed {
            from_ns: still.from_ns,
            to_ns: still.to_ns,
            first: first.at,
            other,
        };
        let measured = mean(first.at, rest).map_err(mixed)?;
        let (q, effort) = still.means();
        self.poses.push(RestPose {
            from_ns: still.from_ns,
            to_ns: still.to_ns,
            q,
            effort,
            measured,
        });
        Ok(())
    }

    /// Ends the stream.
    /// Errors: as [`push`](Self::push).
    pub(crate) fn finish(&mut self) -> Result<(), Mixed> {
        self.close()?;
        self.left_out += self.targets.len() - self.next;
        self.next = self.targets.len();
        Ok(())
    }
}

/// The targets of a rest as one; else one that differs from the first.
fn mean(first: Where, rest: &[TargetAt]) -> Result<RestMeasurement, Where> {
    let count = 1 + rest.len();
    let Where::Point(origin) = first else {
        return match rest.iter().find(|target| target.at != first) {
            Some(other) => Err(other.at),
            None => Ok(RestMeasurement {
                at: first,
                count,
                spread_m: 0.0,
            }),
        };
    };
    let mut sum = [0.0; 3];
    for target in rest {
        let Where::Point(at) = target.at else {
            return Err(target.at);
        };
        for k in 0..3 {
            sum[k] += at[k] - origin[k];
        }
    }
    let mean: [f64; 3] = core::array::from_fn(|k| origin[k] + sum[k] / count as f64);
    let distance = |at: [f64; 3]| (0..3).map(|k| (at[k] - mean[k]).powi(2)).sum::<f64>().sqrt();
    let spread_m = rest.iter().fold(distance(origin), |most, target| match target.at {
        Where::Point(at) => most.max(distance(at)),
        Where::Sphere { .. } => most,
    });
    Ok(RestMeasurement {
        at: Where::Point(mean),
        count,
        spread_m,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn point(ms: i64, x: f64) -> TargetAt {
        TargetAt {
            time_ns: ms * MS,
            at: Where::Point([x, 0.0, 0.0]),
        }
    }

    /// Two rests of 1 s, a motion of 1 s between, at 100 Hz.
    fn run(targets: &[TargetAt], noise_rad: f64) -> Rests<'_> {
        let mut rests = Rests::new(targets, 0.5e-3);
        for k in 0..300 {
            let time = k * 10 * MS;
            let q = match k {
                0..100 => 0.0,
                100..200 => (k - 100) as f64 * 5e-3,
                _ => 0.5,
            };
            let noise = if k % 2 == 0 { noise_rad } else { -noise_rad };
            rests.push(time, &[q + noise, -q], Some(&[1.0 + noise, 2.0])).unwrap();
        }
        rests.finish().unwrap();
        rests
    }

    // Fails if a rest is lost, a target in motion is used, or the mean takes joint states far from the target.
    #[test]
    fn a_pose_is_the_mean_of_a_rest() {
        let targets = [point(500, 1.0), point(520, 3.0), point(1500, 9.0), point(2800, 5.0)];
        let rests = run(&targets, 1e-4);
        assert_eq!((rests.poses.len(), rests.count, rests.left_out), (2, 2, 1));
        let [first, second] = &rests.poses[..] else { panic!() };
        assert_eq!(first.measured.at, Where::Point([2.0, 0.0, 0.0]));
        assert_eq!((first.measured.count, first.measured.spread_m), (2, 1.0));
        assert!(first.q[0].abs() < 1e-5 && (second.q[0] - 0.5).abs() < 1e-5, "{rests:?}");
        assert!((second.effort.as_ref().unwrap()[1] - 2.0).abs() < 1e-12);
        // Noise beyond the band is motion.
        let noisy = run(&targets, 3e-4);
        assert_eq!((noisy.poses.len(), noisy.left_out), (0, 4));
        assert!(noisy.longest_ns < REST_NS);
    }

    // Fails if a drift is averaged over more than the time of the target.
    #[test]
    fn a_drift_is_averaged_around_the_target() {
        let targets = [point(4000, 0.0)];
        let mut rests = Rests::new(&targets, 0.5e-3);
        for k in 0..500_i64 {
            // 0.09 mrad/s: within the band for all 5 s.
            rests.push(k * 10 * MS, &[9e-5 * k as f64 * 0.01], None).unwrap();
        }
        rests.finish().unwrap();
        assert!((rests.poses[0].q[0] - 9e-5 * 4.0).abs() < 1e-7, "{:?}", rests.poses);
    }

    // Fails if a gap, a value that is not finite or a time that goes back is taken as rest.
    #[test]
    fn gaps_and_nans_end_a_rest() {
        let targets = [point(300, 0.0), point(2000, 0.0)];
        let mut rests = Rests::new(&targets, 0.5e-3);
        for ms in [0, 100, 200, 300, 900, 1000, 1900, 2000, 2100] {
            rests.push(ms * MS, &[0.1], None).unwrap();
        }
        rests.push(2200 * MS, &[f64::NAN], None).unwrap();
        rests.push(2150 * MS, &[0.1], None).unwrap();
        rests.finish().unwrap();
        assert_eq!((rests.poses.len(), rests.backwards, rests.left_out), (1, 1, 1));
        assert_eq!((rests.poses[0].from_ns, rests.poses[0].to_ns), (0, 300 * MS));
    }

    #[test]
    fn a_rest_on_two_spheres_is_refused() {
        let sphere = |ms, sphere| TargetAt {
            time_ns: ms * MS,
            at: Where::Sphere { sphere, place: 0 },
        };
        let targets = [sphere(100, 1), sphere(200, 2)];
        let mut rests = Rests::new(&targets, 0.5e-3);
        for k in 0..50 {
            rests.push(k * 10 * MS, &[0.0], None).unwrap();
        }
        let mixed = rests.finish().unwrap_err();
        assert_eq!((mixed.first, mixed.other), (targets[0].at, targets[1].at));
    }
}
