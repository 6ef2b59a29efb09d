//! Delays between controller and joints, and the lag of the actuators.
//!
//! Each tick sends one command and one state. Each arrives after its delay, and never before an
//! earlier message.
//!
//! - **Command**: the drive holds a command until the next one arrives. Arrivals may lie anywhere
//!   within a tick. The plant holds one torque for a tick, so it uses the mean over the tick.
//! - **State**: the controller sees the newest state that has arrived, so a delay of 1.5 ms shows as one of 2 ms.
//! - **Lag**: the torque follows the held command as a first-order system.

use std::collections::VecDeque;

use nalgebra::SVector;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::config::DriveConfig;
use super::sensors::{Sensed, TICK_S};

/// Control period, in µs.
const TICK_US: i64 = 1000;

/// Messages in transit, with their arrival times in µs.
type DelayLine<T> = VecDeque<(i64, T)>;

/// Delay lines of commands and states.
#[derive(Clone, Debug)]
pub(super) struct Delays<const N: usize> {
    config: DriveConfig,
    rng: ChaCha8Rng,
    now_us: i64,
    commands: DelayLine<SVector<f64, N>>,
    states: DelayLine<Sensed<N>>,
    /// Command that the drive holds, in N m.
    held: SVector<f64, N>,
    /// Torque of the actuators, in N m.
    actuator: SVector<f64, N>,
}

impl<const N: usize> Delays<N> {
    pub(super) fn new(config: DriveConfig, rng: ChaCha8Rng, torque: SVector<f64, N>) -> Self {
        Self {
            config,
            rng,
            now_us: 0,
            commands: DelayLine::new(),
            states: DelayLine::new(),
            held: torque,
            actuator: torque,
        }
    }

    /// Changes the delays from now on. Messages in transit keep their arrival times.
    pub(super) fn set(&mut self, config: DriveConfig) {
        self.config = config;
    }

    /// Whether commands and states pass as they are.
    pub(super) fn is_off(&self) -> bool {
        self.config == DriveConfig::default() && self.commands.is_empty() && self.states.is_empty()
    }

    /// A tick without delays: updates only time and torque.
    pub(super) fn pass(&mut self, command: &SVector<f64, N>) {
        self.now_us += TICK_US;
        self.held = *command;
        self.actuator = *command;
    }

    /// Brakes: messages in transit to the actuators have no effect any more.
    pub(super) fn brake(&mut self, torque: &SVector<f64, N>) {
        self.now_us += TICK_US;
        self.commands.clear();
        self.held = *torque;
        self.actuator = *torque;
    }

    /// Sends a command at the start of a tick; returns the mean torque that acts during it, in N m.
    pub(super) fn command(&mut self, command: &SVector<f64, N>) -> SVector<f64, N> {
        let arrival = self.arrival(self.config.command_delay_s, self.commands.back().map(|c| c.0));
        self.commands.push_back((arrival, *command));
        let end = self.now_us + TICK_US;
        let (mut mean, mut from) = (SVector::zeros(), self.now_us);
        while let Some((arrival, command)) = self.commands.front().copied() {
            if arrival >= end {
                break;
            }
            let at = arrival.max(self.now_us);
            mean += self.act((at - from) as f64 * 1e-6);
            from = at;
            self.held = command;
            self.commands.pop_front();
        }
        mean += self.act((end - from) as f64 * 1e-6);
        self.now_us = end;
        mean
    }

    /// Lets the actuators follow the held command for `for_s`; returns the impulse as a share of a tick's, in N m.
    fn act(&mut self, for_s: f64) -> SVector<f64, N> {
        let lag = self.config.actuator_lag_s;
        let left = if lag > 0.0 { libm::exp(-for_s / lag) } else { 0.0 };
        let gap = self.actuator - self.held;
        self.actuator = self.held + gap * left;
        (self.held * for_s + gap * (lag * (1.0 - left))) / TICK_S
    }

    /// Sends the state at the end of a tick; returns the newest that has arrived, or `seen` if none
    /// has.
    pub(super) fn state(&mut self, state: &Sensed<N>, seen: &Sensed<N>) -> Sensed<N> {
        let arrival = self.arrival(self.config.state_delay_s, self.states.back().map(|s| s.0));
        self.states.push_back((arrival, *state));
        let mut newest = *seen;
        while let Some((arrival, state)) = self.states.front().copied() {
            if arrival > self.now_us {
                break;
            }
            newest = state;
            self.states.pop_front();
        }
        newest
    }

    /// When a message that is sent now arrives, in µs.
    fn arrival(&mut self, delay_s: f64, last: Option<i64>) -> i64 {
        let c = self.config;
        let mut delay = delay_s;
        if c.jitter_s > 0.0 {
            delay += c.jitter_s * self.rng.random::<f64>();
        }
        if c.step_every_s > 0.0 && (self.now_us as f64 * 1e-6 / c.step_every_s) as i64 % 2 == 1 {
            delay += c.step_s;
        }
        let arrival = self.now_us + (delay * 1e6).round() as i64;
        last.map_or(arrival, |last| arrival.max(last))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn delays(config: DriveConfig) -> Delays<1> {
        Delays::new(config, ChaCha8Rng::seed_from_u64(1), SVector::zeros())
    }

    fn sensed(tick: u64) -> Sensed<1> {
        Sensed {
            tick,
            q: [0.0],
            dq: [0.0],
            tau: [0.0],
            saturated: false,
            refused: false,
        }
    }

    /// Torques that act when tick k commands k, and ticks whose states are seen.
    fn run(config: DriveConfig, ticks: u64) -> (Vec<f64>, Vec<u64>) {
        let mut d = delays(config);
        let mut seen = sensed(0);
        (1..=ticks)
            .map(|k| {
                let torque = d.command(&SVector::from([k as f64]))[0];
                seen = d.state(&sensed(k), &seen);
                (torque, seen.tick)
            })
            .unzip()
    }

    // Fails if a delay is longer or shorter than stated, or if a part of a tick is lost.
    #[test]
    fn a_constant_delay_is_what_it_says() {
        let config = DriveConfig {
            state_delay_s: 2e-3,
            command_delay_s: 1.25e-3,
            ..DriveConfig::default()
        };
        let (torque, seen) = run(config, 6);
        // Command k acts from 0.25 ms into tick k+1: a quarter of command k-1 and three quarters of k.
        for (k, torque) in torque.iter().enumerate().skip(2) {
            let expected = 0.25 * (k as f64 - 1.0) + 0.75 * k as f64;
            assert!((torque - expected).abs() < 1e-12, "{torque} {expected}");
        }
        assert_eq!(seen, [0, 0, 1, 2, 3, 4]);
        let (none, fresh) = run(DriveConfig::default(), 4);
        assert_eq!((none, fresh), (vec![1.0, 2.0, 3.0, 4.0], vec![1, 2, 3, 4]));
    }

    // Fails if jitter lets a state overtake an older one, or if it shortens the constant delay.
    #[test]
    fn nothing_overtakes() {
        let config = DriveConfig {
            state_delay_s: 1e-3,
            jitter_s: 4e-3,
            ..DriveConfig::default()
        };
        let (_, seen) = run(config, 500);
        assert!(seen.windows(2).all(|w| w[0] <= w[1]));
        let ages: Vec<u64> = (1..=500).zip(&seen).map(|(k, s)| k - s).collect();
        assert!(ages.iter().skip(10).all(|age| (1..=6).contains(age)), "{ages:?}");
        assert!(ages.iter().max() > ages.iter().skip(10).min());
    }

    // Fails if steps do not come and go.
    #[test]
    fn steps_alternate() {
        let config = DriveConfig {
            step_s: 3e-3,
            step_every_s: 0.05,
            ..DriveConfig::default()
        };
        let (_, seen) = run(config, 200);
        let age = |k: usize| (k as u64 + 1) - seen[k];
        assert_eq!([age(40), age(80), age(140), age(180)], [0, 3, 0, 3]);
    }

    // Fails if the lag has another time constant, or if the mean over a tick is not the integral of
    // the response.
    #[test]
    fn actuators_lag_exponentially() {
        let lag = 3e-3;
        let config = DriveConfig {
            actuator_lag_s: lag,
            ..DriveConfig::default()
        };
        let mut d = delays(config);
        let mut impulse = 0.0;
        for k in 1..=10 {
            impulse += d.command(&SVector::from([1.0]))[0] * 1e-3;
            let t = f64::from(k) * 1e-3;
            let expected = t - lag * (1.0 - (-t / lag).exp());
            assert!((impulse - expected).abs() < 1e-12, "{impulse} {expected}");
        }
    }
}
