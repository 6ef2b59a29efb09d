//! Tests of the hub.

use super::*;
use crate::live::{LiveWatch, RealTime, Times, WAITING};
use spherecal_campaign::telemetry::ContactTrace;
use spherecal_campaign::{CampaignObserver as _, Progress};
use spherecal_link::native::DriveRecord;
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

fn scene(arm: &str) -> LiveScene {
    LiveScene {
        robot: "iiwa7".to_owned(),
        arm: arm.to_owned(),
        link: "sim".to_owned(),
        begun_utc: String::new(),
        joints: Vec::new(),
        tcp_m: [0.0; 3],
        sites: Vec::new(),
        home_rad: Vec::new(),
        trigger_n: 7.5,
    }
}

fn watch(arm: &str) -> (LiveWatch, mpsc::Receiver<ViewerMessage>) {
    let (out, messages) = mpsc::channel(WAITING);
    (LiveWatch::new(out, &iiwa7(), &iiwa7_tool(), scene(arm)), messages)
}

fn end() -> End {
    End {
        run: Some(3),
        trusted: Some(true),
        text: "done".to_owned(),
    }
}

// Fails if a campaign waits for browsers, or if an essential message is lost while nobody reads
// the channel.
#[test]
fn nobody_holds_the_campaign_up_and_the_end_is_told() {
    let (mut watch, mut messages) = watch("a");
    for k in 0..20 * WAITING {
        watch.progress(&Progress {
            done: k,
            ..Progress::default()
        });
        watch.note(&format!("remark {k}"));
    }
    let mut taken = Vec::new();
    while let Ok(message) = messages.try_recv() {
        taken.push(message);
    }
    assert!(matches!(taken.first(), Some(ViewerMessage::Scene(_))), "{taken:?}");
    assert!(taken.len() <= WAITING);
    watch.end(end());
    while let Ok(message) = messages.try_recv() {
        taken.push(message);
    }
    assert_eq!(taken.last(), Some(&ViewerMessage::End(end())));
}

// Fails if a browser that connects later is not shown the same as earlier ones, if a slow one
// is not brought up to date, or if a run that was cut off looks alive.
#[test]
fn late_and_slow_ones_know_the_same() {
    let hub = Hub::default();
    let (known, mut early) = hub.listen().expect("open");
    assert!(known.is_empty());
    let mut run = None;
    assert!(
        !hub.take(&mut run, ViewerMessage::Note { text: "x".to_owned() }),
        "no scene yet"
    );
    assert!(hub.take(&mut run, ViewerMessage::Scene(scene("a"))));
    assert!(!hub.take(&mut run, ViewerMessage::Scene(scene("b"))), "a second scene");
    assert!(hub.take(&mut run, ViewerMessage::Note { text: "x".to_owned() }));
    let (known, _) = hub.listen().expect("open");
    assert_eq!(known.len(), 2);
    assert_eq!(early.try_recv().as_deref(), Ok(known[0].as_ref()));
    assert_eq!(early.try_recv().as_deref(), Ok(known[1].as_ref()));
    for _ in 0..2 * NEWS {
        hub.take(&mut run, ViewerMessage::Note { text: "y".to_owned() });
    }
    assert!(matches!(
        early.try_recv(),
        Err(broadcast::error::TryRecvError::Lagged(_))
    ));
    hub.gone(run);
    let (known, _) = hub.listen().expect("open");
    assert_eq!(known.len(), 1 + NOTES + 1);
    assert!(
        known
            .last()
            .is_some_and(|text| text.contains("disconnected without a result")),
        "{known:?}"
    );
    hub.close();
    assert!(hub.listen().is_none());
}

// Fails if viewers are not shown the real-time loop of a run that has one, or are shown one of a run without.
#[test]
fn the_real_time_loop_is_shown() {
    let mut record = DriveRecord {
        cycles: 1,
        ..DriveRecord::default()
    };
    record.turnaround.record(20);
    for drive in [None, Some(record)] {
        let (mut watch, mut messages) = watch("a");
        watch.progress(&Progress {
            drive,
            ..Progress::default()
        });
        let frame = std::iter::from_fn(|| messages.try_recv().ok()).find_map(|message| match message {
            ViewerMessage::Frame(frame) => Some(frame),
            _ => None,
        });
        let shown = frame.expect("a frame").real_time;
        assert_eq!(shown.as_ref().map(|loop_| loop_.turnaround.max_us), drive.map(|_| 20));
    }
}

// Fails if a message changes on its way through the service.
#[test]
fn messages_go_round() {
    let frame = Frame {
        stage: spherecal_campaign::CampaignStage::Couple,
        phase: spherecal_shared::protocol::host::Phase::HandGuiding,
        sphere: 2,
        done: 3,
        poses: 4,
        contacts: 5,
        faults: 6,
        simulated: true,
        device_s: 7.125,
        wall_s: 1e-9,
        eta_s: None,
        residual_mm: Some(0.3),
        q: vec![0.1, -2.5],
        tau: vec![],
        tcp_m: [0.1, 0.2, 0.3],
        force_n: [0.0, 0.0, 7.5],
        force_is_vague: false,
        forces: vec![(1.23, 4.56)],
        real_time: Some(RealTime {
            cycles: 1000,
            late: 2,
            missed: 3,
            turnaround: Times {
                median_us: 48,
                most_us: 192,
                max_us: 400,
                octaves: vec![(64, 997), (512, 3)],
            },
            jitter: Times::default(),
        }),
    };
    let contact = LiveContact {
        force_n: 7.7,
        travel_mm: 59.3,
        trace: ContactTrace {
            sphere: 1,
            trigger_s: 12.5,
            samples: vec![(12.0, 0.25)],
        },
    };
    let note = ViewerMessage::Note { text: "x".to_owned() };
    let all = [
        ViewerMessage::Scene(scene("a")),
        ViewerMessage::Frame(frame),
        ViewerMessage::Contact(contact),
        note,
        ViewerMessage::End(end()),
    ];
    for message in all {
        let text = serde_json::to_string(&message).expect("JSON");
        assert_eq!(serde_json::from_str::<ViewerMessage>(&text).expect(&text), message);
    }
}

// Fails if runs accumulate without limit, or if a live run is removed before an ended one.
#[test]
fn runs_do_not_pile_up() {
    let hub = Hub::default();
    let mut alive = None;
    hub.take(&mut alive, ViewerMessage::Scene(scene("alive")));
    for k in 0..50 {
        let mut run = None;
        hub.take(&mut run, ViewerMessage::Scene(scene(&format!("{k}"))));
        hub.take(&mut run, ViewerMessage::End(end()));
    }
    let (known, _) = hub.listen().expect("open");
    assert_eq!(known.iter().filter(|t| t.contains("{\"scene\":")).count(), 1 + ENDED);
    assert!(known[0].contains("\"alive\""), "{}", known[0]);
    for k in 0..2 * RUNS {
        hub.take(&mut None, ViewerMessage::Scene(scene(&format!("more {k}"))));
    }
    assert!(hub.listen().expect("open").0.len() <= RUNS + ENDED);
}
