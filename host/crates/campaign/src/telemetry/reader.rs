//! Reads a telemetry file that the writer wrote, sample by sample.

use serde::Deserialize;

use super::messages::{JointStates, PhaseState, Tcp, TelemetryMessage as _, Wrench};
use super::writer::TelemetryError;

/// The messages of one control period. A message that the file lacks is `None`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Period {
    /// Device time, in ns.
    pub time_ns: u64,
    /// Joints.
    pub joint_states: Option<JointStates<'static>>,
    /// Force and torque.
    pub wrench: Option<Wrench<'static>>,
    /// TCP.
    pub tcp: Option<Tcp<'static>>,
    /// Phase and flags.
    pub phase: Option<PhaseState>,
}

/// Iterates over the control periods of a telemetry file, in the file's order.
///
/// The messages of one control period follow each other and have one time. A
/// message on a topic that this program does not write is skipped.
pub struct TelemetryReader<'a> {
    messages: mcap::MessageStream<'a>,
    period: Option<Period>,
    ended: bool,
}

impl<'a> TelemetryReader<'a> {
    /// Over the bytes of a file.
    ///
    /// # Errors
    /// When they do not begin as an MCAP file.
    pub fn new(bytes: &'a [u8]) -> Result<Self, TelemetryError> {
        Ok(Self {
            messages: mcap::MessageStream::new(bytes).map_err(TelemetryError::NotMcap)?,
            period: None,
            ended: false,
        })
    }

    /// Takes one message. Returns the period before it, if it begins the next.
    fn take(&mut self, message: &mcap::Message<'_>) -> Result<Option<Period>, TelemetryError> {
        let topic = message.channel.topic.as_str();
        let mut next = Period {
            time_ns: message.log_time,
            ..Period::default()
        };
        let current = self.period.as_ref().is_some_and(|p| p.time_ns == message.log_time);
        let target = if current {
            self.period.get_or_insert_default()
        } else {
            &mut next
        };
        match topic {
            JointStates::TOPIC => target.joint_states = Some(decode(topic, &message.data)?),
            Wrench::TOPIC => target.wrench = Some(decode(topic, &message.data)?),
            Tcp::TOPIC => target.tcp = Some(decode(topic, &message.data)?),
            PhaseState::TOPIC => target.phase = Some(decode(topic, &message.data)?),
            _ => return Ok(None),
        }
        Ok(if current { None } else { self.period.replace(next) })
    }
}

fn decode<'a, M: Deserialize<'a>>(topic: &str, data: &'a [u8]) -> Result<M, TelemetryError> {
    serde_json::from_slice(data).map_err(|cause| TelemetryError::Decode {
        topic: topic.to_owned(),
        cause,
    })
}

impl Iterator for TelemetryReader<'_> {
    type Item = Result<Period, TelemetryError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.ended {
            let taken = match self.messages.next() {
                Some(Ok(message)) => self.take(&message),
                Some(Err(error)) => Err(TelemetryError::NotMcap(error)),
                None => {
                    self.ended = true;
                    return self.period.take().map(Ok);
                }
            };
            match taken {
                Ok(None) => {}
                Ok(Some(period)) => return Some(Ok(period)),
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use spherecal_shared::MAX_JOINTS;
    use spherecal_shared::protocol::host::{Phase, Sample};

    use super::super::TelemetryWriter;
    use super::*;

    fn written(samples: &[(u64, Sample)]) -> Vec<u8> {
        let names: Vec<String> = (1..=6).map(|k| format!("joint_{k}")).collect();
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut writer = TelemetryWriter::new(&mut bytes, &names, &BTreeMap::new()).expect("a writer");
        for (time_us, sample) in samples {
            writer.write(*time_us, sample).expect("written");
        }
        writer.finish().expect("finished");
        bytes.into_inner()
    }

    // Fails if a number, a time or a phase reads back as another, or if a number
    // that is not finite makes the file unreadable.
    #[test]
    fn samples_read_back_bit_by_bit() {
        let sample = Sample {
            phase: Phase::HandGuiding,
            q: [0.1, -1.0 / 3.0, f32::MIN_POSITIVE, 1e-7, 2.5, -0.0, 9.0, 9.0],
            tau: [f32::NAN; MAX_JOINTS],
            force_n: [0.1, f32::INFINITY, -7.3],
            setpoint_m: [0.3, 0.2, 0.1],
            flags: 5,
            ..Sample::default()
        };
        let bytes = written(&[(1_234_567, sample), (1_236_567, Sample::default())]);
        let periods: Vec<Period> = TelemetryReader::new(&bytes)
            .expect("a file")
            .collect::<Result<_, _>>()
            .expect("readable");
        assert_eq!(
            periods.iter().map(|p| p.time_ns).collect::<Vec<_>>(),
            [1_234_567_000, 1_236_567_000]
        );
        let joints = periods[0].joint_states.as_ref().expect("joints");
        assert_eq!(joints.timestamp.time_us(), 1_234_567);
        assert_eq!(joints.name.len(), 6);
        let bits = |values: &[f32]| values.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&joints.position), bits(&sample.q[..6]));
        assert!(joints.effort.iter().all(|x| x.is_nan()));
        let wrench = periods[0].wrench.as_ref().expect("a wrench").wrench;
        assert!(wrench.force.x.to_bits() == 0.1f32.to_bits() && wrench.force.y.is_nan());
        let tcp = periods[0].tcp.as_ref().expect("a TCP");
        assert_eq!(tcp.setpoint, sample.setpoint_m.into());
        let phase = periods[0].phase.expect("a phase");
        assert_eq!(
            (phase.phase, phase.saturated, phase.rate_limited),
            (Phase::HandGuiding, true, false)
        );
        assert!(phase.near_singular);
    }

    // Fails if a file that was cut off is read as a whole one.
    #[test]
    fn a_file_that_was_cut_off_is_refused() {
        let bytes = written(&[(1000, Sample::default())]);
        let result = TelemetryReader::new(&bytes[..bytes.len() / 2]).and_then(Iterator::collect::<Result<Vec<_>, _>>);
        let error = result.expect_err("refused").to_string();
        assert!(error.contains("mcap recover"), "{error}");
        let other = TelemetryReader::new(b"no MCAP").and_then(Iterator::collect::<Result<Vec<_>, _>>);
        assert!(other.is_err(), "{other:?}");
    }
}
