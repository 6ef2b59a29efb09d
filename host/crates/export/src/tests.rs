//! Tables as another reader finds them.

use super::*;

fn table() -> ExportTable {
    let mut t = ExportTable::new("sample");
    t.real("real", [0.1, -0.0, f64::MIN_POSITIVE, 1.0 / 3.0]);
    t.whole("whole", [i64::MIN, -1, 0, i64::MAX]);
    t.text("text", ["a", "", "c,\"d\"\n", "é"].map(str::to_owned));
    t
}

// Fails if a value changes, a row group is lost, or a reader of Parquet sees another column name or
// type.
#[cfg(feature = "parquet")]
#[test]
fn parquet_reads_back_bit_by_bit() {
    use parquet::file::reader::{FileReader as _, SerializedFileReader};
    use parquet::record::RowAccessor as _;

    let folder = tempfile::tempdir().expect("a folder");
    let table = table();
    let mut file = TableFile::create(folder.path(), Format::Parquet, &table).expect("made");
    file.append(&table).expect("written");
    file.append(&table).expect("written");
    let path = file.finish().expect("closed");
    let reader = SerializedFileReader::new(std::fs::File::open(path).expect("open")).expect("Parquet");
    assert_eq!(reader.metadata().num_row_groups(), 2);
    let names: Vec<_> = reader.metadata().file_metadata().schema_descr().columns().to_vec();
    assert_eq!(
        names.iter().map(|c| c.name()).collect::<Vec<_>>(),
        ["real", "whole", "text"]
    );
    let rows: Vec<_> = reader
        .get_row_iter(None)
        .expect("rows")
        .map(|r| r.expect("a row"))
        .collect();
    assert_eq!(rows.len(), 8);
    let (Column::Real(real), Column::Whole(whole), Column::Text(text)) =
        (&table.columns[0].1, &table.columns[1].1, &table.columns[2].1)
    else {
        panic!("types");
    };
    for (k, row) in rows.iter().enumerate() {
        assert_eq!(row.get_double(0).expect("real").to_bits(), real[k % 4].to_bits());
        assert_eq!(row.get_long(1).expect("whole"), whole[k % 4]);
        assert_eq!(row.get_string(2).expect("text"), &text[k % 4]);
    }
}

// Fails if CSV loses a bit of a number or splits a text.
#[test]
fn csv_reads_back_bit_by_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let table = table();
    let mut file = TableFile::create(folder.path(), Format::Csv, &table).expect("made");
    file.append(&table).expect("written");
    let mut reader = csv::Reader::from_path(file.finish().expect("closed")).expect("CSV");
    let rows: Vec<_> = reader.records().map(|r| r.expect("a row")).collect();
    assert_eq!(rows.len(), 4);
    let Column::Real(real) = &table.columns[0].1 else {
        panic!("type")
    };
    for (row, value) in rows.iter().zip(real) {
        let read: f64 = row[0].parse().expect("a number");
        assert_eq!(read.to_bits(), value.to_bits());
    }
    assert_eq!(&rows[2][2], "c,\"d\"\n");
    assert_eq!(&rows[0][1], i64::MIN.to_string());
}

// Fails if a program without Parquet leaves an empty file behind, or does not name the missing
// feature.
#[cfg(not(feature = "parquet"))]
#[test]
fn without_the_feature_parquet_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let refusal = TableFile::create(folder.path(), Format::Parquet, &table())
        .err()
        .expect("refused");
    assert!(refusal.to_string().contains("--features parquet"), "{refusal}");
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0);
}

// Fails if a sample of a resumed run is lost, or if it is not told which piece ends in the middle of
// a record.
#[test]
fn pieces_of_a_run_are_one_table_and_one_bag() {
    use spherecal_campaign::telemetry::{DrawnArm, Moment, TelemetryWriter};
    use spherecal_model::robots;
    use spherecal_shared::protocol::host::Sample;

    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, first_us: u64, samples: u64| {
        let path = folder.path().join(name);
        let file = std::fs::File::create(&path).expect("made");
        let model = robots::built_in("iiwa7").expect("built in");
        let arm = DrawnArm::new(&model, &model.tool);
        let about = std::collections::BTreeMap::default();
        let mut writer = TelemetryWriter::new(file, arm, &about, 0).expect("a writer");
        for k in 0..samples {
            let device_us = first_us + k * 1000;
            let utc_ns = 1_800_000_000_000_000_000 + device_us * 1000;
            writer
                .write(Moment { utc_ns, device_us }, &Sample::default())
                .expect("written");
        }
        writer.finish().expect("closed");
        path
    };
    let pieces = [
        write("telemetry-run-1.mcap", 0, 2500),
        write("telemetry-run-1-2.mcap", 9_000_000, 3),
    ];
    let whole = std::fs::read(&pieces[0]).expect("read");
    std::fs::write(&pieces[0], &whole[..whole.len() - 3]).expect("cut");
    let mut times: Vec<u64> = Vec::new();
    let mut read = |pieces: &[PathBuf]| {
        telemetry::read(pieces, |table| {
            let (name, Column::Whole(values)) = &table.columns[0] else {
                panic!("a type")
            };
            assert_eq!((table.name, name.as_str()), ("telemetry", "time_ns"));
            times.extend(values.iter().map(|ns| ns.unsigned_abs()));
            Ok(())
        })
        .expect("read")
    };
    assert_eq!(read(&[]), []);
    let torn = read(&pieces);
    let [torn] = torn.as_slice() else { panic!("{torn:?}") };
    assert_eq!(torn.file, pieces[0]);
    assert_eq!(times[times.len() - 3..], [9_000_000_000, 9_001_000_000, 9_002_000_000]);
    assert!(
        times[..times.len() - 3]
            .iter()
            .copied()
            .eq((0..times.len() as u64 - 3).map(|k| k * 1_000_000))
    );
    assert!(times.len() > 2000, "{}", times.len());
    // A ROS 2 bag is made of the same pieces, and cannot be made of none.
    let bag = export_ros2(&pieces, &folder.path().join("ros2")).expect("exported");
    assert_eq!(bag.torn_telemetry, std::slice::from_ref(torn));
    assert_eq!(torn.read.periods + 3, times.len() as u64);
    let bytes = std::fs::read(&bag.files[0]).expect("a bag");
    let messages = mcap::MessageStream::new(&bytes).expect("MCAP");
    let joints = messages
        .filter(|m| m.as_ref().expect("a message").channel.topic == "/joint_states")
        .count();
    assert_eq!(joints, times.len());
    export_ros2(&[], &folder.path().join("empty")).expect_err("no sample");
}
