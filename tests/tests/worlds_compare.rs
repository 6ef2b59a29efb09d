//! Worlds and estimators: the generator's own properties, and the comparison.

use spherecal::validate::Alignment;
use spherecal::worlds::{CompareOptions, Estimator, World, compare, paper_poses};

// Prints the whole table.
#[test]
#[ignore = "a study of a minute, run by name in release"]
fn study_of_all_worlds() {
    let poses = paper_poses().expect("the nominal cell");
    println!("{} poses", poses.len());
    let seeds: u64 = std::env::var("SEEDS").ok().and_then(|s| s.parse().ok()).unwrap_or(12);
    let options = CompareOptions {
        seeds: (0..seeds).collect(),
        progress: true,
        ..CompareOptions::default()
    };
    let t = std::time::Instant::now();
    let table = compare(&options).expect("every estimator works");
    println!("{table}\n{:?}", t.elapsed());
    for world in World::ALL {
        let c = table.cell(world, Estimator::Map).expect("compared");
        println!("{world} worst {:.3}", c.worst_mm(Alignment::BestFit));
    }
}
