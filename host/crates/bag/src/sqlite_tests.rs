//! Bags in SQLite.

use super::super::test_bag::{execute, to_sqlite};
use super::*;

// Fails if a bag in SQLite, as a file or as a folder, gives other poses than the same messages in MCAP.
#[test]
fn a_bag_in_sqlite_is_the_same_bag() {
    let folder = tempfile::tempdir().unwrap();
    let mcap = points(folder.path(), "tracker", None);
    let expected = read(&mcap, &wanted()).unwrap();
    let bag = folder.path().join("bag");
    std::fs::create_dir(&bag).unwrap();
    let db3 = bag.join("bag_0.db3");
    to_sqlite(&mcap, &db3);
    for path in [&db3, &bag] {
        let found = read(path, &wanted()).unwrap();
        assert_eq!(found.to_csv(), expected.to_csv());
        assert_eq!(found.notes, expected.notes);
    }
    assert!(!bag.join("bag_0.db3-wal").exists() && !bag.join("bag_0.db3-shm").exists());
    // Cut short, it is no database any more.
    let bytes = std::fs::read(&db3).unwrap();
    std::fs::write(&db3, &bytes[..bytes.len() / 3]).unwrap();
    refused(&db3, &wanted(), &["bag_0.db3", "is not a whole bag in SQLite"]);
}

// Fails if messages that are in a file beside the bag are lost without a word, or an empty such file is a reason to refuse.
#[test]
fn a_bag_that_is_still_written_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let db3 = folder.path().join("bag.db3");
    to_sqlite(&points(folder.path(), "tracker", None), &db3);
    for ending in ["-wal", "-journal"] {
        let beside = folder.path().join(format!("bag.db3{ending}"));
        std::fs::write(&beside, "").unwrap();
        assert_eq!(read(&db3, &wanted()).unwrap().len(), 4);
        std::fs::write(&beside, "frames").unwrap();
        refused(&db3, &wanted(), &["bag.db3", ending, "stop the recorder"]);
        std::fs::remove_file(&beside).unwrap();
    }
}

// Fails if messages are lost or doubled where a piece ends by its bytes and not by its rows (40 messages of 3 MiB), or if data
// of a type that is not read are loaded.
#[test]
fn large_messages_come_in_pieces() {
    let folder = tempfile::tempdir().unwrap();
    let mcap = points(folder.path(), "tracker", None);
    let expected = read(&mcap, &wanted()).unwrap();
    let db3 = folder.path().join("bag.db3");
    to_sqlite(&mcap, &db3);
    execute(
        &db3,
        &[
            "INSERT INTO topics VALUES (100, '/odom', 'nav_msgs/msg/Odometry', 'cdr', ''), (101, '/image', 'sensor_msgs/msg/Image', \
             'cdr', '')",
            "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n WHERE k < 80) INSERT INTO messages (topic_id, timestamp, \
             data) SELECT 100 + k % 2, (SELECT min(timestamp) FROM messages) + 10000000 * k, zeroblob(3145728) FROM n",
        ],
    );
    let (mut messages, mut times, mut largest) = (0, Vec::new(), 0);
    crate::records::each_message(&db3, &mut |_| {}, &mut |message| {
        messages += 1;
        times.push(message.time_ns);
        if message.topic.name == "/image" {
            assert!(message.data.is_empty());
        }
        largest = largest.max(message.data.len());
        Ok(())
    })
    .unwrap();
    assert_eq!((messages, largest), (600 + 4 + 80, 3 << 20));
    assert!(times.is_sorted());
    assert_eq!(read(&db3, &wanted()).unwrap().to_csv(), expected.to_csv());
}
