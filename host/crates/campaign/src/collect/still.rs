//! Finds still poses in the readings of a guided arm, and averages them.

use spherecal_link::JointReading;

/// When an arm is at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StillRules {
    /// Largest change of a joint angle during rest and average, in rad.
    pub band_rad: f64,
    /// Time at rest before the average begins, in s.
    pub settle_s: f64,
    /// Time of the average, in s.
    pub average_s: f64,
    /// Least change of a joint angle to the pose before, in rad. A pose that is nearer is the same pose.
    pub apart_rad: f64,
}

impl Default for StillRules {
    /// Half a milliradian within half a second of rest and 1 s of average; 50 mrad to the pose before.
    fn default() -> Self {
        Self {
            band_rad: 5e-4,
            settle_s: 0.5,
            average_s: 1.0,
            apart_rad: 0.05,
        }
    }
}

/// A pose at which the arm was still.
#[derive(Clone, Debug, PartialEq)]
pub struct StillPose {
    /// Mean joint angles, in rad.
    pub q: Vec<f64>,
    /// Mean torques of the actuators, in N m; empty where the link gives none.
    pub tau: Vec<f64>,
    /// Largest standard deviation of a joint angle, in rad.
    pub spread_rad: f64,
    /// Number of readings.
    pub readings: u32,
}

/// Sums of the readings during one rest.
#[derive(Clone, Debug, Default)]
struct Sums {
    count: u32,
    q: Vec<f64>,
    /// Sums of the squares of the angles less the first angle: large offsets would cost digits.
    squares: Vec<f64>,
    tau: Vec<f64>,
}

/// Watches readings for still poses.
#[derive(Clone, Debug)]
pub struct StillWatch {
    rules: StillRules,
    /// Angles and time at the begin of the rest.
    rest: Option<(Vec<f64>, f64)>,
    last_s: f64,
    sums: Sums,
    /// The last pose that was found.
    before: Option<Vec<f64>>,
}

impl StillWatch {
    /// Watches from now on.
    pub fn new(rules: StillRules) -> Self {
        Self {
            rules,
            rest: None,
            last_s: f64::NEG_INFINITY,
            sums: Sums::default(),
            before: None,
        }
    }

    /// Takes a reading. Returns a pose when the arm has been still for long enough at a new pose.
    pub fn take(&mut self, reading: &JointReading) -> Option<StillPose> {
        // A repeated reading tells nothing new.
        if reading.time_s <= self.last_s {
            return None;
        }
        self.last_s = reading.time_s;
        let near = |q: &[f64], within: f64| q.iter().zip(&reading.q).all(|(a, b)| (a - b).abs() <= within);
        if self.before.as_ref().is_some_and(|q| near(q, self.rules.apart_rad)) {
            self.rest = None;
            return None;
        }
        let began = match &self.rest {
            Some((q, began_s)) if near(q, self.rules.band_rad) => *began_s,
            _ => {
                self.rest = Some((reading.q.clone(), reading.time_s));
                self.sums = Sums::default();
                return None;
            }
        };
        let averaged = reading.time_s - began - self.rules.settle_s;
        if averaged < 0.0 {
            return None;
        }
        let first = self.rest.as_ref().map(|(q, _)| q.as_slice()).unwrap_or_default();
        self.sums.add(reading, first);
        if averaged < self.rules.average_s {
            return None;
        }
        let pose = self.sums.mean(first);
        self.rest = None;
        self.before = Some(pose.q.clone());
        Some(pose)
    }

    /// The next pose may be the one before: it was not kept, or the user asks for it.
    pub fn again(&mut self) {
        self.before = None;
        self.rest = None;
    }
}

impl Sums {
    fn add(&mut self, reading: &JointReading, first: &[f64]) {
        if self.count == 0 {
            self.q = vec![0.0; reading.q.len()];
            self.squares = vec![0.0; reading.q.len()];
            self.tau = vec![0.0; reading.tau.len()];
        }
        self.count += 1;
        for (j, (q, first)) in reading.q.iter().zip(first).enumerate() {
            self.q[j] += q - first;
            self.squares[j] += (q - first).powi(2);
        }
        for (sum, tau) in self.tau.iter_mut().zip(&reading.tau) {
            *sum += tau;
        }
    }

    fn mean(&self, first: &[f64]) -> StillPose {
        let n = f64::from(self.count.max(1));
        let variance = |(sum, square): (&f64, &f64)| (square / n - (sum / n).powi(2)).max(0.0);
        StillPose {
            q: self.q.iter().zip(first).map(|(sum, first)| first + sum / n).collect(),
            tau: self.tau.iter().map(|sum| sum / n).collect(),
            spread_rad: self
                .q
                .iter()
                .zip(&self.squares)
                .map(variance)
                .fold(0.0, f64::max)
                .sqrt(),
            readings: self.count,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch(readings: impl Iterator<Item = f64>) -> Vec<StillPose> {
        let mut watch = StillWatch::new(StillRules::default());
        let reading = |(k, q): (usize, f64)| JointReading {
            time_s: k as f64 * 1e-3,
            q: vec![q, 1.0],
            tau: vec![2.0, -3.0],
            ..JointReading::default()
        };
        readings
            .enumerate()
            .filter_map(|(k, q)| watch.take(&reading((k, q))))
            .collect()
    }

    // Fails if a slowly moving arm counts as still, or a rest that is shorter than rest and average together.
    #[test]
    fn an_arm_that_moves_is_not_still() {
        assert!(watch((0..5000).map(|k| f64::from(k) * 1e-6)).is_empty());
        assert!(watch((0..20).flat_map(|k| std::iter::repeat_n(f64::from(k) * 0.1, 1400))).is_empty());
    }

    // Fails if the mean or the spread is wrong, one rest gives two poses, or a jitter within the band ends the rest.
    #[test]
    fn one_rest_is_one_pose_with_the_mean_of_its_last_second() {
        let found = watch((0..6000).map(|k| 3.0 + if k % 2 == 0 { 1e-4 } else { -1e-4 }));
        let [pose] = found.as_slice() else { panic!("{found:?}") };
        assert!((pose.q[0] - 3.0).abs() < 1e-6, "{pose:?}");
        assert!((pose.spread_rad - 1e-4).abs() < 1e-6, "{pose:?}");
        assert_eq!((pose.q[1], pose.tau.as_slice()), (1.0, &[2.0, -3.0][..]));
        assert!((1000..=1002).contains(&pose.readings), "{pose:?}");
    }

    // Fails if the second of two poses is lost, or a return to the first one is.
    #[test]
    fn each_new_pose_counts() {
        let at = |q: f64| std::iter::repeat_n(q, 1600);
        let found = watch(at(0.0).chain(at(0.2)).chain(at(0.22)).chain(at(0.0)));
        let q: Vec<f64> = found.iter().map(|pose| pose.q[0]).collect();
        assert_eq!(q, [0.0, 0.2, 0.0]);
    }
}
