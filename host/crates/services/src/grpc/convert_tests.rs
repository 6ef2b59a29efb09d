use super::*;
use proptest::prelude::*;
use prost::Message as _;
use spherecal_shared::protocol::host::{Fault, Phase};

fn signal() -> impl Strategy<Value = SignalStatistics> {
    [any::<f64>(), any::<f64>(), any::<f64>(), any::<f64>()].prop_map(|[mean, std, min, max]| SignalStatistics {
        mean,
        std,
        min,
        max,
    })
}

fn bits(event: &Event) -> String {
    // Debug prints the shortest digits that read back, and distinguishes -0 from 0.
    format!("{event:?}")
}

proptest! {
    // Fails if a number, a name or a joint changes on its way over the wire.
    #[test]
    fn recordings_and_faults_travel_bit_by_bit(
        q in prop::collection::vec(signal(), 0..=8),
        tau in prop::collection::vec(signal(), 0..=8),
        numbers in any::<[f64; 6]>(),
        times in any::<[u64; 3]>(),
        ids in any::<[u32; 4]>(),
        joint in any::<u8>(),
    ) {
        let [a, b, c, d, e, f] = numbers;
        let recording = Event::Recording(Recording {
            sphere: ids[0], pose: ids[1], start_us: times[0], end_us: times[1], count: ids[2], gaps: ids[3],
            q: q.into_iter().collect(), tau: tau.into_iter().collect(), tcp_spread_m: a, force_n: [b, c, d],
        });
        let fault = Event::Fault(FaultReport {
            fault: Fault::NotFinite, phase: Phase::HandGuiding, time_us: times[2], tick: times[0],
            joint, value: e, limit: f,
        });
        for body in [recording, fault] {
            let sent = Arrival { session: SessionId::default(), event: ids[0], sent_us: times[1], body };
            let bytes = event(sent.event, sent.sent_us, &sent.body).expect("kept").encode_to_vec();
            let came = arrival(proto::Event::decode(&bytes[..]).expect("decodes")).expect("well formed");
            prop_assert_eq!(bits(&sent.body), bits(&came.body));
            prop_assert_eq!((sent.event, sent.sent_us), (came.event, came.sent_us));
        }
    }
}

// Fails if a malformed message is accepted, or refused without the field's name.
#[test]
fn malformed_messages_are_refused_by_field() {
    let contact = proto::Contact {
        tare_n: vec![0.0; 3],
        tcp_m: vec![0.0; 2],
        ..proto::Contact::default()
    };
    let refused = |body| {
        arrival(proto::Event {
            event: 1,
            sent_us: 0,
            body: Some(body),
        })
        .expect_err("refused")
    };
    assert!(refused(proto::event::Body::Contact(contact)).contains("tcp_m has 2 numbers, not 3"));
    let phase = proto::PhaseChange {
        phase: "dancing".to_owned(),
        ..proto::PhaseChange::default()
    };
    assert!(refused(proto::event::Body::Phase(phase)).contains("phase is \"dancing\""));
    let recording = proto::Recording {
        q: vec![proto::Signal::default(); 9],
        force_n: vec![0.0; 3],
        ..proto::Recording::default()
    };
    assert!(refused(proto::event::Body::Recording(recording)).contains("q has 9 joints"));
    let recording = proto::Recording {
        tau: vec![proto::Signal {
            std: Some(f64::NAN),
            ..proto::Signal::default()
        }],
        force_n: vec![0.0; 3],
        ..proto::Recording::default()
    };
    assert!(refused(proto::event::Body::Recording(recording)).contains("tau has the number NaN"));
}

// Fails if a store takes a laser measurement that it could not give back, or a
// state that no run has.
#[test]
fn numbers_that_are_not_finite_and_unknown_states_are_refused() {
    let shot = |q: f64, x: f64| proto::LaserShot {
        purpose: "validation".to_owned(),
        q_rad: vec![0.0, q],
        point_m: vec![x, 0.0, 0.0],
    };
    assert!(laser(vec![shot(0.1, 0.2)]).is_ok());
    assert!(laser(vec![shot(f64::NAN, 0.0)]).expect_err("refused").contains("q_rad"));
    let refusal = laser(vec![shot(0.0, f64::INFINITY)]).expect_err("refused");
    assert!(refusal.contains("point_m has the number inf"), "{refusal}");
    assert!(state_of_run("measured").is_ok());
    assert!(state_of_run("").is_err() && state_of_run("done\u{1b}[2J").is_err());
}
