//! An arm that hardly rests, or never.

use super::*;

// Fails if the bag of an arm that never rests, or that rests before it moves and never again, is taken, or is refused without
// saying that it moved, for how long, and how many times without motion of which length there were.
#[test]
fn an_arm_that_moves_all_the_time_is_told_so() {
    // Stops, as their first joint state (at 100 Hz) and the number of joint states in them.
    let streamed = |stops: &[(u64, u64)]| {
        let folder = tempfile::tempdir().unwrap();
        let mut bag = TestBag::new(folder.path());
        let mut q = 0.0;
        for k in 0..500_u64 {
            let time = START_NS + k * 10_000_000;
            if !stops.iter().any(|(from, count)| (from + 1..from + count).contains(&k)) {
                q += 1e-3;
            }
            let joints = joint_state(time, &["elbow", "shoulder"], &[q, q], &[]);
            bag.put("/joint_states", JOINT_STATE, "cdr", time, &joints);
            bag.put("/point", POINT, "cdr", time, &point(time, "t", [0.0; 3]));
        }
        let file = bag.finish();
        (folder, file)
    };
    let mut words = vec!["--rest-mrad", "0.5 mrad", "in 5.0 s"];
    let (_folder, never) = streamed(&[]);
    words.extend([
        "the arm moved all the time and never rests",
        "there are 0 shorter times",
    ]);
    refused(&never, &wanted(), &words);
    // 5 of 40 ms, 2 of 90 ms, 1 of 200 ms.
    let mut stops: Vec<(u64, u64)> = (0..5).map(|k| (100 + 30 * k, 5)).collect();
    stops.extend([(300, 10), (330, 10), (400, 21)]);
    let lengths = "8 shorter times without motion, of 0 to 0.05 s: 5, 0.05 to 0.15 s: 2, 0.15 to 0.3 s: 1";
    let (_folder, short) = streamed(&stops);
    words.truncate(3);
    words.extend(["never rests", lengths, "is 0.20 s, and 0.3 s are needed"]);
    refused(&short, &wanted(), &words);
    // A rest of 0.5 s before it moves.
    stops.push((0, 51));
    let (_folder, first) = streamed(&stops);
    words.truncate(3);
    words.extend(["moved most of the time and rests for 0.3 s or more 1 times", lengths]);
    refused(&first, &wanted(), &words);
}
