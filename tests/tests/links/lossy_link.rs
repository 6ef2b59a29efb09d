//! A host link that loses, repeats, reorders and damages frames: what is
//! recorded is the same to the last bit, and what happened is counted.

use spherecal::job::{self, Choice, Config, Measurements};
use spherecal::link::Lossy;
use spherecal::simulated;
use spherecal_tests::plan;

/// The worst that the link is built for: a fifth of the frames lost, one in a
/// hundred damaged, and many late or twice.
const BAD: Lossy = Lossy {
    loss: 0.2,
    duplication: 0.1,
    reorder: 0.1,
    bit_flip: 0.01,
    seed: 11,
};

fn measured(poses: usize, host_link: Lossy) -> Measurements {
    let mut config = Config::default().on_preset("typical");
    config.plan.poses = poses;
    config.plan.choice = Choice::Grid;
    config.laser.enabled = false;
    config.host_link = host_link;
    plan::measured(&simulated::prepare(&config).expect("a plan"))
}

/// Fails if over a bad link one bit of what was measured differs from what a
/// good link brings, a recording is lost or stored twice, or if what the link
/// did is not counted.
fn same_recordings(poses: usize, seeds: std::ops::Range<u64>) {
    let clean = measured(poses, Lossy::default());
    assert_eq!(clean.recordings.len(), poses);
    let good = job::LinkSummary::of(&clean.link);
    assert_eq!((good.crc_errors, good.lost, good.late), (0, 0, 0), "{good:?}");
    assert_eq!(good.resent, 0, "a good link repeats nothing: {good:?}");
    for seed in seeds {
        let bad = measured(poses, Lossy { seed, ..BAD });
        let link = job::LinkSummary::of(&bad.link);
        println!("{poses} poses, seed {seed}: {link:?}");
        assert_eq!(link.late, 0, "seed {seed}: {link:?}");
        assert!(bad.recordings == clean.recordings, "seed {seed}: recordings differ");
        assert_eq!(bad.contacts, clean.contacts, "seed {seed}");
        assert_eq!(bad.couplings, clean.couplings, "seed {seed}");
        assert!(bad.faults.is_empty(), "seed {seed}: {:?}", bad.faults);
        let done = link.injected;
        assert!(done.lost * 5 > done.frames * 9 / 10 && done.flipped > 0, "{done:?}");
        // What was damaged is seen as damaged, what was lost as lost.
        assert!(
            link.crc_errors > 0 && link.resent > 0 && link.duplicates > 0,
            "{link:?}"
        );
        assert!(link.lost * 10 > done.lost * 9, "{link:?}");
    }
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_bad_link_changes_no_bit_of_a_short_run() {
    same_recordings(9, 1..3);
}

#[test]
#[ignore = "long: 150 poses over a bad link"]
fn long_a_bad_link_changes_no_bit_of_a_whole_run() {
    same_recordings(150, 1..4);
}
