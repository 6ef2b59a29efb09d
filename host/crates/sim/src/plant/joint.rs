//! The mechanics between a joint's encoder and its link, one joint at a time.
//!
//! ```text
//!   encoder e ─ h(e), scatter ─▶ gear ─ deflection(τ), lost motion ─▶ link
//! ```
//!
//! An encoder on the link sees the second half, which then cancels.

use rand_chacha::ChaCha8Rng;

use super::random::{Stream, normal, stream};

/// `amplitude sin(order own + other_order other + phase)`, angles in rad.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tone {
    pub(super) order: f64,
    pub(super) other_order: f64,
    pub(super) amplitude: f64,
    pub(super) phase: f64,
}

/// Error `h` of one joint, in rad: a function of the encoder's angle and of another joint's.
#[derive(Clone, Debug, Default)]
pub(super) struct JointError {
    /// Cosine and sine coefficients of orders 1, 2, ..., in rad.
    pub(super) harmonics: Vec<[f64; 2]>,
    /// Gear and smooth errors.
    pub(super) tones: Vec<Tone>,
    /// Dependence on this joint's angle and another's.
    pub(super) cross: Vec<Tone>,
    /// The other joint of [`Self::cross`], from 0.
    pub(super) other: usize,
}

impl JointError {
    /// Error (rad) and its slope at the encoder angle `e`, with the other joint's angle.
    pub(super) fn at(&self, e: f64, other: f64) -> (f64, f64) {
        let (mut value, mut slope) = (0.0, 0.0);
        if !self.harmonics.is_empty() {
            let (s1, c1) = libm::sincos(e);
            let (mut s, mut c) = (s1, c1);
            for (k, [cosine, sine]) in self.harmonics.iter().enumerate() {
                value += cosine * c + sine * s;
                slope += (k + 1) as f64 * (sine * c - cosine * s);
                (s, c) = (s * c1 + c * s1, c * c1 - s * s1);
            }
        }
        for tone in &self.tones {
            let (s, c) = libm::sincos(tone.order * e + tone.phase);
            value += tone.amplitude * s;
            slope += tone.amplitude * tone.order * c;
        }
        for tone in &self.cross {
            let (s, c) = libm::sincos(tone.order * e + tone.other_order * other + tone.phase);
            value += tone.amplitude * s;
            slope += tone.amplitude * tone.order * c;
        }
        (value, slope)
    }
}

/// How a joint deflects under the torque that it transmits.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Deflection {
    /// Linear part, in rad/(N m).
    pub(super) compliance: f64,
    /// Quadratic part, in rad/(N m)².
    pub(super) quadratic: f64,
    /// Half width of the torque hysteresis, in rad.
    pub(super) hysteresis: f64,
}

/// Torque scale over which the torque hysteresis changes sides, in N m.
const HYSTERESIS_NM: f64 = 0.5;

impl Deflection {
    /// The angle by which the gear leads the link under a torque (N m), in rad.
    #[inline]
    pub(super) fn at(&self, torque: f64) -> f64 {
        self.compliance * torque + self.nonlinear(torque)
    }

    /// The same without the linear part.
    #[inline]
    pub(super) fn nonlinear(&self, torque: f64) -> f64 {
        let mut angle = 0.0;
        if self.quadratic != 0.0 {
            angle += self.quadratic * torque * torque.abs();
        }
        if self.hysteresis != 0.0 {
            angle += self.hysteresis * libm::tanh(torque / HYSTERESIS_NM);
        }
        angle
    }
}

/// The state of one joint that depends on its path.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathMemory {
    /// Largest lost motion, in rad.
    pub(super) half_width: f64,
    /// Travel scale over which lost motion changes sides, in rad.
    pub(super) travel: f64,
    /// Standard deviation of the scatter, in rad.
    pub(super) scatter: f64,
    /// Travel after which the scatter is drawn again, in rad.
    pub(super) scatter_travel: f64,
}

impl PathMemory {
    /// Whether there is anything to remember.
    pub(super) fn is_off(&self) -> bool {
        self.half_width == 0.0 && self.scatter == 0.0
    }
}

/// State of one joint's [`PathMemory`].
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Trace {
    /// Angle by which the gear leads the link for the direction of its last motion, in rad.
    pub(super) lost: f64,
    /// Present scatter, in rad.
    pub(super) scatter: f64,
}

impl Trace {
    /// The joint moves by `by` (rad) without reversing.
    pub(super) fn moved(&mut self, memory: &PathMemory, by: f64, rng: &mut ChaCha8Rng) {
        if by == 0.0 {
            return;
        }
        if memory.half_width > 0.0 {
            let side = memory.half_width.copysign(by);
            self.lost = side + (self.lost - side) * libm::exp(-by.abs() / memory.travel);
        }
        if memory.scatter > 0.0 {
            let kept = libm::exp(-by.abs() / memory.scatter_travel);
            self.scatter = kept * self.scatter + memory.scatter * (1.0 - kept * kept).sqrt() * normal(rng);
        }
    }
}

/// State of all joints that depends on the arm's path.
#[derive(Clone, Debug)]
pub(super) struct SlowState<const N: usize> {
    pub(super) traces: [Trace; N],
    rng: ChaCha8Rng,
}

impl<const N: usize> SlowState<N> {
    /// The state at the start of a run: scatter is drawn, and no joint has lost motion.
    pub(super) fn new(seed: u64, memory: &[PathMemory; N], which: Stream) -> Self {
        let mut rng = stream(seed, which);
        let traces = core::array::from_fn(|i| Trace {
            lost: 0.0,
            scatter: if memory[i].scatter > 0.0 {
                memory[i].scatter * normal(&mut rng)
            } else {
                0.0
            },
        });
        Self { traces, rng }
    }

    /// The joints move by `by` (rad); none of them reverses.
    pub(super) fn moved(&mut self, memory: &[PathMemory; N], by: &[f64; N]) {
        for i in 0..N {
            if !memory[i].is_off() {
                self.traces[i].moved(&memory[i], by[i], &mut self.rng);
            }
        }
    }

    /// The angle by which each gear leads its link, and the scatter ahead of it, taken together:
    /// motor-side angle minus scatter, over the link and its deflection, in rad.
    #[inline]
    pub(super) fn lead(&self, i: usize) -> f64 {
        self.traces[i].lost - self.traces[i].scatter
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    const MEMORY: PathMemory = PathMemory {
        half_width: 1e-4,
        travel: 1e-3,
        scatter: 5e-5,
        scatter_travel: 2e-3,
    };

    // Fails if the lost motion depends on the steps into which a path is cut, or on anything but
    // the path.
    #[test]
    fn lost_motion_depends_on_the_way_alone() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut one, mut many) = (Trace::default(), Trace::default());
        let quiet = PathMemory { scatter: 0.0, ..MEMORY };
        one.moved(&quiet, 0.02, &mut rng);
        one.moved(&quiet, -7e-4, &mut rng);
        for _ in 0..200 {
            many.moved(&quiet, 1e-4, &mut rng);
        }
        for _ in 0..70 {
            many.moved(&quiet, -1e-5, &mut rng);
        }
        assert!((one.lost - many.lost).abs() < 1e-12, "{one:?} {many:?}");
        // 1/e² of the way back from +1e-4 to -1e-4 is left after two travels.
        assert!((one.lost - (-1.0 + 2.0 * (-0.7f64).exp()) * 1e-4).abs() < 1e-9);
    }

    // Fails if scatter has another size than stated, repeats after a long path, or changes at rest.
    #[test]
    fn scatter_is_new_after_a_long_way_and_kept_at_rest() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut trace = Trace::default();
        let draws: Vec<f64> = (0..4000)
            .map(|_| {
                trace.moved(&MEMORY, 0.1, &mut rng);
                let before = trace.scatter;
                trace.moved(&MEMORY, 0.0, &mut rng);
                assert_eq!(trace.scatter, before);
                before
            })
            .collect();
        let square = draws.iter().map(|x| x * x).sum::<f64>() / 4000.0;
        assert!((square.sqrt() / 5e-5 - 1.0).abs() < 0.05, "{}", square.sqrt());
        let product: f64 = draws.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / 4000.0;
        assert!((product / square).abs() < 0.05);
    }
}
