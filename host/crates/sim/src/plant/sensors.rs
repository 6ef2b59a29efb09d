//! What the drive link shows of the arm: encoders, velocities, joint torques.
//!
//! - **Angle**: the motor side's angle through the encoder's and the gear's
//!   repeating errors, plus white and correlated noise, quantised.
//! - **Velocity**: differences of the noise-free encoder over the tick, as a drive computes them
//!   from the fine motor encoder, low-passed, plus white noise, quantised. It is half a tick late,
//!   as on a real drive.
//! - **Torque**: the torque transmitted to the link, averaged over the tick,
//!   through the sensor's play, plus a constant bias and white noise, quantised. At rest it equals
//!   `gravity(q) − Jᵀ F`, `F` being the environment's force on the tool.

use rand_chacha::ChaCha8Rng;

use super::config::SensorConfig;
use super::random::normal;

/// Control period, in s.
pub(super) const TICK_S: f64 = 1e-3;

/// Fault of one joint's torque sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TorqueSensorFault {
    /// Reads zero.
    Dead,
    /// Reads this much too high, in N m.
    Bias(f64),
}

/// What real hardware shows after a tick, base to flange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensed<const N: usize> {
    /// Ticks of 1 ms since the plant was made.
    pub tick: u64,
    /// Encoder angles, in rad.
    pub q: [f64; N],
    /// Joint velocities, in rad/s.
    pub dq: [f64; N],
    /// Measured joint torques: what the actuators exert on the links, in N m.
    pub tau: [f64; N],
    /// A torque command was beyond the joint's limit and was cut to it.
    pub saturated: bool,
    /// A torque command was not finite; the drive kept the last good one.
    pub refused: bool,
}

#[derive(Clone, Debug)]
pub(super) struct Sensors<const N: usize> {
    config: SensorConfig,
    rng: ChaCha8Rng,
    bias: [f64; N],
    /// Half width of the torque sensors' play, in N m, and their readings before bias and noise.
    play: [f64; N],
    played: Option<[f64; N]>,
    /// Encoder angles without noise, of the last tick.
    encoder: [f64; N],
    velocity: [f64; N],
    correlated: [f64; N],
    /// Decay per tick of the correlated noise, and its drive.
    decay: (f64, f64),
    /// Share of the new difference in the velocity filter.
    share: f64,
    stuck: [Option<f64>; N],
    torque_fault: [Option<TorqueSensorFault>; N],
}

impl<const N: usize> Sensors<N> {
    pub(super) fn new(
        config: &SensorConfig,
        rng: ChaCha8Rng,
        bias: [f64; N],
        play: [f64; N],
        encoder: [f64; N],
    ) -> Self {
        let decay = if config.angle_correlation_s > 0.0 {
            libm::exp(-TICK_S / config.angle_correlation_s)
        } else {
            0.0
        };
        let share = if config.velocity_filter_s > 0.0 {
            1.0 - libm::exp(-TICK_S / config.velocity_filter_s)
        } else {
            1.0
        };
        let mut sensors = Self {
            config: *config,
            rng,
            bias,
            play,
            played: None,
            encoder,
            velocity: [0.0; N],
            correlated: [0.0; N],
            decay: (decay, config.angle_correlated_rad * (1.0 - decay * decay).sqrt()),
            share,
            stuck: [None; N],
            torque_fault: [None; N],
        };
        if config.noise {
            for value in &mut sensors.correlated {
                *value = config.angle_correlated_rad * normal(&mut sensors.rng);
            }
        }
        sensors
    }

    /// Freezes (`Some`) or frees one encoder at what it last read.
    pub(super) fn stick(&mut self, joint: usize, stuck: bool) {
        if let (Some(slot), Some(angle)) = (self.stuck.get_mut(joint), self.encoder.get(joint)) {
            *slot = stuck.then_some(*angle);
        }
    }

    /// Injects or clears a fault of one torque sensor.
    pub(super) fn fail_torque(&mut self, joint: usize, fault: Option<TorqueSensorFault>) {
        if let Some(slot) = self.torque_fault.get_mut(joint) {
            *slot = fault;
        }
    }

    /// Reads all joints: encoder angles without noise (rad) and mean transmitted torques (N m).
    pub(super) fn read(&mut self, tick: u64, encoder: &[f64; N], torque: &[f64; N]) -> Sensed<N> {
        let c = self.config;
        let mut sensed = Sensed {
            tick,
            q: *encoder,
            dq: [0.0; N],
            tau: *torque,
            saturated: false,
            refused: false,
        };
        let played = self.played.get_or_insert(*torque);
        for i in 0..N {
            if self.play[i] > 0.0 {
                played[i] = played[i].max(torque[i] - self.play[i]).min(torque[i] + self.play[i]);
                sensed.tau[i] = played[i];
            }
            let angle = self.stuck[i].unwrap_or(encoder[i]);
            let difference = (angle - self.encoder[i]) / TICK_S;
            self.encoder[i] = angle;
            self.velocity[i] += self.share * (difference - self.velocity[i]);
            sensed.q[i] = angle;
            sensed.dq[i] = self.velocity[i];
            sensed.tau[i] += self.bias[i];
            if c.noise {
                self.correlated[i] = self.decay.0 * self.correlated[i] + self.decay.1 * normal(&mut self.rng);
                if self.stuck[i].is_none() {
                    sensed.q[i] += self.correlated[i] + c.angle_white_rad * normal(&mut self.rng);
                }
                sensed.dq[i] += c.velocity_white_rad_s * normal(&mut self.rng);
                sensed.tau[i] += c.torque_white_nm * normal(&mut self.rng);
                sensed.q[i] = quantised(sensed.q[i], c.angle_step_rad);
                sensed.dq[i] = quantised(sensed.dq[i], c.velocity_step_rad_s);
                sensed.tau[i] = quantised(sensed.tau[i], c.torque_step_nm);
            }
            match self.torque_fault[i] {
                Some(TorqueSensorFault::Dead) => sensed.tau[i] = 0.0,
                Some(TorqueSensorFault::Bias(bias)) => sensed.tau[i] += bias,
                None => {}
            }
        }
        sensed
    }
}

/// `value` to the nearest multiple of `step`; a step of 0 leaves it.
#[inline]
fn quantised(value: f64, step: f64) -> f64 {
    if step > 0.0 {
        libm::rint(value / step) * step
    } else {
        value
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::PlantConfig;
    use super::super::random::{Stream, stream};
    use super::*;

    // Fails if a reading with play follows the torque at once after a reversal, lags it by another amount than the
    // play, or does so on a sensor without play.
    #[test]
    fn a_sensor_with_play_follows_late() {
        let config = PlantConfig::ideal().sensors;
        let rng = stream(1, Stream::Sensors);
        let mut sensors = Sensors::new(&config, rng, [0.25, 0.0], [0.5, 0.0], [0.0; 2]);
        for (torque, read) in [
            (2.0, 2.0),
            (2.4, 2.0),
            (4.0, 3.5),
            (3.5, 3.5),
            (3.0, 3.5),
            (1.0, 1.5),
            (1.9, 1.5),
        ] {
            let tau = sensors.read(1, &[0.0; 2], &[torque; 2]).tau;
            assert!((tau[0] - 0.25 - read).abs() < 1e-12, "{torque} N m: {tau:?}");
            assert_eq!(tau[1], torque);
        }
    }
}
