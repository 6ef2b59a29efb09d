//! The force with which the arm presses is bounded by the controller itself.

use spherecal::job::Config;
use spherecal::lab::faults::{Case, Ended, Finish, Trial};
use spherecal::sim::inject::{Entry, FaultPlan, InjectedFault, When};
use spherecal_shared::protocol::host::{Fault, Phase};

/// Arms that are hard to control: name, seed, `[plant]`.
const HARD: [(&str, u64, &str); 8] = [
    ("typical", 1, ""),
    ("as measured", 1, "preset = \"as_measured\""),
    ("as measured", 2, "preset = \"as_measured\""),
    ("harsh", 1, "preset = \"harsh\""),
    ("harsh", 2, "preset = \"harsh\""),
    ("elastic, 16,000 N m/rad", 1, "[elasticity]\nenabled = true\nstiffness_nm_rad = 16000.0"),
    ("dry friction to 2 N m", 1, "[friction]\ncoulomb_nm = [1.0, 2.0]"),
    ("torque noise of 0.25 N m", 1, "[sensors]\ntorque_white_nm = 0.25"),
];

fn case(seed: u64, plant: &str) -> Case {
    let config = Config {
        seed,
        plant: toml::from_str(plant).expect("settings"),
        ..Config::default()
    };
    Case::of(config, Finish::Record).unwrap_or_else(|e| panic!("{plant}: {e}"))
}

fn one(what: InjectedFault, name: Phase, entry: u32, after_s: f64, for_s: f64) -> FaultPlan {
    FaultPlan {
        seed: 1,
        host_link: None,
        faults: vec![Entry {
            what,
            when: When::Phase { name, entry, after_s },
            for_s: Some(for_s),
        }],
    }
}

// Fails if model error, friction, elasticity or noise of a sound run counts as pressing.
#[test]
fn sound_runs_do_not_press() {
    for (name, seed, plant) in HARD.into_iter().filter(|h| std::env::var("ONLY").is_err() || h.0.contains(&std::env::var("ONLY").unwrap())) {
        let trial = case(seed, plant).run(&FaultPlan::default()).expect("a run");
        println!("{name}, seed {seed}: {:?}", trial.faults);
        assert_eq!(trial.ended, Ended::Finished, "{name}");
        assert!(trial.faults.iter().all(|f| f.fault != Fault::Pressing), "{name}: {:?}", trial.faults);
    }
}
