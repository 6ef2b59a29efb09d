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

#[test]
#[ignore = "a look"]
fn look() {
    use spherecal::worlds::{Recipe, judge, record_poses};
    let poses = paper_poses().expect("the nominal cell");
    let which = [Estimator::Geometry, Estimator::TwoHarmonics, Estimator::Map, Estimator::LaserMap, Estimator::Bound];
    for (l, a, t) in [(0.2e-3, 0.5e-3, 0.8e-3), (0.41e-3, 0.27e-3, 0.32e-3)] {
        for world in [World::W0, World::W3, World::W4] {
            let recipe = Recipe { length_m: l, alpha_rad: a, theta_rad: t, ..world.recipe() };
            let mut all: Vec<Vec<f64>> = vec![vec![]; which.len()];
            let mut scales = vec![];
            for seed in 0..12 {
                let trial = record_poses(world, &recipe, seed, poses).unwrap();
                scales.push(trial.truth.geometry_scale);
                let table = judge(&trial, &recipe, &which).unwrap();
                for (k, m) in table.models.iter().enumerate() { all[k].push(m.best_fit.mean_mm); }
            }
            scales.sort_by(f64::total_cmp);
            println!("{l} {a} {t} {world} scale {:.2} {:.2} {:.2}", scales[0], scales[6], scales[11]);
            for (k, w) in which.iter().enumerate() { all[k].sort_by(f64::total_cmp); if !all[k].is_empty() { println!("   {w} {:.3} {:.3} {:.3}", all[k][0], (all[k][5]+all[k][6])/2.0, all[k][11]); } }
        }
    }
}

#[test]
#[ignore = "a look"]
fn dump() {
    use spherecal::worlds::record;
    for world in [World::W1, World::W4] {
        for seed in 0..6u64 {
            let t = record(world, seed).unwrap();
            let p: Vec<f64> = t.truth.robot.joints.iter().flat_map(|j| [j.mdh.alpha, j.mdh.a*1e3, j.mdh.theta, j.mdh.d*1e3]).collect();
            let back = |m: &spherecal::laser::Measured| { let v = t.truth.base.inverse_point(&m.point_m.into()); [v.x*1e3, v.y*1e3, v.z*1e3] };
            let q: Vec<_> = t.validation.iter().map(|m| m.q.clone()).collect();
            let v: Vec<_> = t.validation.iter().map(back).collect();
            let lq: Vec<_> = t.laser.observations.iter().map(|o| o.q.clone()).collect();
            let lp: Vec<_> = t.laser.observations.iter().map(|o| match o.target { spherecal::identify::Target::Point(p) => back(&spherecal::laser::Measured{q: vec![], point_m: p}), _ => [0.0;3] }).collect();
            let j = serde_json::json!({"truth": {"p": p, "tool": t.truth.tool.tcp_m.map(|x| x*1e3)}, "valid_q": q, "valid_p": v, "laser_q": lq, "laser_p": lp, "base_t_measured": [0,0,0], "tool_measured": t.frames.tool_m.map(|x| x*1e3)});
            std::fs::write(format!("/tmp/wt/ours_{world}_{seed}.json"), j.to_string()).unwrap();
        }
    }
}

#[test]
#[ignore = "a look"]
fn many() {
    let options = CompareOptions { worlds: vec![World::W0, World::W4], seeds: (100..148).collect(), estimators: vec![Estimator::TwoHarmonics, Estimator::Map, Estimator::Bound], ..CompareOptions::default() };
    println!("{}", compare(&options).unwrap());
}
