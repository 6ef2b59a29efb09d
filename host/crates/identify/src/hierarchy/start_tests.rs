//! Where a search begins, and that it ends in the same place.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use spherecal_model::Observation;
use spherecal_model::chain::Chain;
use spherecal_shared::robot::{Tool, built_in};

use super::super::fit;
use super::*;
use crate::halton_configurations;
use crate::options::{Model, Options};

/// Points of an arm with wrong zeros and lengths, measured with 20 µm of noise.
fn experiment() -> Experiment {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let nominal = built_in("ur5e").expect("a robot");
    let mut truth = nominal.clone();
    for joint in &mut truth.joints {
        let mut draw = |most: f64| random.random_range(-most..=most);
        joint.mdh.theta += draw(2e-3);
        joint.mdh.a += draw(5e-4);
        joint.mdh.alpha += draw(1e-3);
    }
    let tool = Tool {
        tcp_m: [0.02, 0.01, 0.12],
        ..Tool::default()
    };
    let chain = Chain::unchecked(&truth, &tool);
    let mut measured = |q: Vec<f64>| {
        let noise: Vector3<f64> = Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
        let tcp = chain.pose(&q).position + 2e-5 * noise;
        Observation {
            seat: None,
            q,
            tau: None,
            target: Target::Point(tcp.into()),
            set: spherecal_model::Set::Calibrate,
        }
    };
    Experiment {
        observations: halton_configurations(&nominal, 100)
            .into_iter()
            .map(&mut measured)
            .collect(),
        robot: nominal,
        tool,
        spheres: Vec::new(),
    }
}

// Fails if a search of a part of the rows that begins where that of all rows ended ends elsewhere than one from the ordinary
// sizes, by more than the tolerance of both, or if the start is not that of the rows' noise.
#[test]
fn a_search_ends_where_it_does_from_anywhere() {
    let experiment = experiment();
    let options = Options::default();
    let found = |before: &Before, every: usize| {
        let wanted = |i: usize| every == 0 || !i.is_multiple_of(every);
        fit(&experiment, &options, Model::Full, before, wanted).expect("good data")
    };
    let whole = found(&Before::default(), 0);
    let near = Before {
        ends: whole.ends.clone(),
        ..Before::default()
    };
    let (cold, warm) = (found(&Before::default(), 5), found(&near, 5));
    let postures = halton_configurations(&experiment.robot, 50);
    let apart = |a: &super::super::Fit, b: &super::super::Fit| -> f64 {
        let pairs = a.tcps(&postures).into_iter().zip(b.tcps(&postures));
        pairs.map(|(a, b)| (a - b).norm()).sum::<f64>() / postures.len() as f64
    };
    let (own, of_rows) = (apart(&cold, &warm), apart(&cold, &whole));
    println!("{own:.2e} m apart by the start, {of_rows:.2e} m by the rows");
    assert!(own < 0.05 * of_rows, "{own} of {of_rows}");
    assert!((cold.whitening.joint / warm.whitening.joint).ln().abs() < 0.1);
}
