use std::sync::atomic::{AtomicU64, Ordering};

use serde::{Deserialize, Serialize};

use super::*;

/// A study whose outcomes are numbers with all of their digits.
#[derive(Serialize, Deserialize)]
struct Sines {
    count: u64,
    step: f64,
    /// Items that were worked on.
    #[serde(skip)]
    worked: AtomicU64,
}

#[derive(Debug, thiserror::Error)]
#[error("item {0} fails")]
struct Fails(u64);

impl ShardedStudy for Sines {
    const NAME: &'static str = "sines";
    const COMMAND: &'static str = "sines";
    const ITEMS: &'static str = "values";
    type Context = f64;
    type Outcome = (u64, f64);
    type Error = Fails;

    fn items(&self) -> u64 {
        self.count
    }

    fn prepare(&self, _: Range<u64>) -> Result<f64, Fails> {
        Ok(self.step)
    }

    fn run(&self, step: &f64, item: u64) -> Result<(u64, f64), Fails> {
        self.worked.fetch_add(1, Ordering::Relaxed);
        match item {
            666 => Err(Fails(item)),
            _ if self.step.is_nan() => Ok((item, f64::NAN)),
            _ => Ok((item, (item as f64 * step).sin() / 3.0)),
        }
    }
}

fn sines(count: u64) -> Sines {
    Sines {
        count,
        step: 0.1,
        worked: AtomicU64::new(0),
    }
}

fn shard(text: &str) -> Shard {
    text.parse().expect("a shard")
}

fn run(study: &Sines, text: &str, folder: &Path) -> Result<ShardDone, ShardError> {
    run_shard(study, shard(text), folder, false)
}

fn bits(values: &[(u64, f64)]) -> Vec<(u64, u64)> {
    values.iter().map(|(item, value)| (*item, value.to_bits())).collect()
}

fn merged_bits(folder: &Path) -> Result<Vec<(u64, u64)>, ShardError> {
    merged::<Sines>(folder).map(|(_, outcomes)| bits(&outcomes))
}

// Fails if shards leave an item out, have one twice, or differ by more than one item.
#[test]
fn shards_part_the_items() {
    for items in [0, 1, 2, 7, 100, 1_000_003, u64::MAX] {
        for of in [1, 2, 3, 7, 1000] {
            let mut end = 0;
            let (mut least, mut most) = (u64::MAX, 0);
            for number in 1..=of {
                let range = Shard::new(number, of).expect("a shard").range(items);
                assert_eq!(range.start, end);
                end = range.end;
                least = least.min(range.end - range.start);
                most = most.max(range.end - range.start);
            }
            assert_eq!(end, items);
            assert!(most - least <= 1, "{items} in {of}: {least} to {most}");
        }
    }
    for bad in [
        "", "1", "0/3", "4/3", "1/0", "-1/3", "1/3/3", "a/b", "1/100001", "1 / 3",
    ] {
        assert_eq!(bad.parse::<Shard>(), Err(BadShard), "{bad}");
    }
}

// Fails if the merge of any number of shards, more than items too, differs from one run by a bit.
#[test]
fn merged_shards_have_the_bits_of_one_run() {
    let study = sines(10);
    let one = bits(&whole(&study, false).expect("it runs"));
    for of in [1, 2, 3, 10, 13] {
        let folder = tempfile::tempdir().expect("a folder");
        for number in (1..=of).rev() {
            let done = run(&study, &format!("{number}/{of}"), folder.path()).expect("it runs");
            assert_eq!(done.done_before, 0);
        }
        assert_eq!(merged_bits(folder.path()).expect("merged"), one, "{of} shards");
    }
}

// Fails if a shard that was stopped at any byte of its file does not go on from there: loses an item,
// works twice on one that is whole, or gives other bits.
#[test]
fn a_stopped_shard_goes_on_at_every_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let study = sines(4);
    let one = bits(&whole(&study, false).expect("it runs"));
    let path = run(&study, "1/1", folder.path()).expect("it runs").file;
    let text = std::fs::read(&path).expect("read");
    for length in 0..=text.len() {
        std::fs::write(&path, &text[..length]).expect("cut");
        let whole_lines = text[..length].split(|byte| *byte == b'\n').count() as u64 - 1;
        let study = sines(4);
        let done = run(&study, "1/1", folder.path()).expect("it goes on");
        assert_eq!(done.done_before, whole_lines.saturating_sub(1), "{length}");
        assert_eq!(study.worked.load(Ordering::Relaxed), 4 - done.done_before, "{length}");
        assert_eq!(merged_bits(folder.path()).expect("merged"), one, "{length}");
    }
}

// Fails if a changed byte of an outcome is merged, or a shard goes on beside it.
#[test]
fn a_changed_byte_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let study = sines(3);
    let one = bits(&whole(&study, false).expect("it runs"));
    let path = run(&study, "1/1", folder.path()).expect("it runs").file;
    let text = std::fs::read(&path).expect("read");
    let header = text.iter().position(|b| *b == b'\n').expect("a line") + 1;
    for at in header..text.len() {
        let mut changed = text.clone();
        changed[at] ^= 1;
        std::fs::write(&path, &changed).expect("written");
        match merged_bits(folder.path()) {
            // A digit beyond the last bit of a number says the same.
            Ok(bits) => assert_eq!(bits, one, "byte {at}"),
            Err(ShardError::Damaged { line, .. }) => {
                assert!(line >= 2);
                assert!(matches!(
                    run(&study, "1/1", folder.path()),
                    Err(ShardError::Damaged { .. })
                ));
            }
            // The last line has lost its end.
            Err(ShardError::Incomplete { done, .. }) => assert_eq!((at, done), (text.len() - 1, 2)),
            Err(error) => panic!("byte {at}: {error}"),
        }
    }
}

// Fails if shards of different studies are merged or continued, if a shard that is missing or not
// finished is not named, or if the message does not name the field that differs.
#[test]
fn what_does_not_belong_together_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let refused = |error: ShardError, parts: &[&str]| {
        let said = error.to_string();
        assert!(error.is_input(), "{said}");
        assert!(parts.iter().all(|part| said.contains(part)), "{said}");
    };
    refused(
        merged_bits(folder).expect_err("empty"),
        &["holds no shard of `sines`", "--shard 1/3"],
    );
    run(&sines(9), "1/3", folder).expect("it runs");
    let error = merged_bits(folder).expect_err("two are missing");
    refused(error, &["shard 2/3 has 0 of 3 values", "--shard 2/3"]);
    let other = Sines { step: 0.2, ..sines(9) };
    refused(
        run(&other, "1/3", folder).expect_err("another step"),
        &["`step` is 0.1, not 0.2", "--out"],
    );
    run(&other, "2/3", folder).expect("it is a file of its own");
    run(&sines(9), "3/3", folder).expect("it runs");
    refused(
        merged_bits(folder).expect_err("mixed"),
        &["2-of-3", "`step` is 0.2, not 0.1"],
    );
    std::fs::remove_file(folder.join("sines-shard-2-of-3.jsonl")).expect("removed");
    run(&sines(9), "2/3", folder).expect("it runs");
    assert_eq!(merged_bits(folder).expect("all are there").len(), 9);
    // A file of two shards beside those of three.
    run(&sines(9), "1/2", folder).expect("it runs");
    refused(merged_bits(folder).expect_err("of another number"), &["`shards` is"]);
}

// Fails if two processes may work on one shard, if a failed item loses those that are done, or if a
// number that JSON does not have is stored.
#[test]
fn failures_are_told_and_lose_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let study = sines(5);
    let held = ShardFile::open(&study, shard("1/1"), folder).expect("opened");
    assert!(matches!(run(&study, "1/1", folder), Err(ShardError::Busy { .. })));
    drop(held);
    assert_eq!(run(&study, "1/1", folder).expect("it runs").items, 5);

    let study = sines(670);
    let error = run(&study, "1/1", &folder.join("b")).expect_err("one fails");
    assert!(!error.is_input() && error.to_string() == "item 666 fails", "{error}");
    let (_, done) = ShardFile::open(&study, shard("1/1"), &folder.join("b")).expect("opened");
    assert!(!done.is_empty() && !done.contains(&666));

    let nan = Sines {
        step: f64::NAN,
        ..sines(2)
    };
    let error = run(&nan, "1/1", &folder.join("c")).expect_err("not a number");
    assert!(matches!(error, ShardError::NotFinite { .. }), "{error}");
}
