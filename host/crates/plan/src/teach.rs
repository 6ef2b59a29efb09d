//! The operator's error: waypoints taught by hand are some millimetres off.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Uniform};

use super::types::Plan;
use spherecal_model::chain::{Chain, TcpPose, rotation_of};

/// Moves every approach waypoint by up to `error_m` along each axis of F0, as quick hand-guiding
/// does (uniform, from `seed`), and adapts the joints.
///
/// Two visits to one sphere in one placement share the error, because the sphere was taught once.
/// If the shifted waypoint is out of reach, the planned one stays.
pub fn teach(plan: &mut Plan, chain: &Chain, error_m: f64, seed: u64) {
    let Ok(axis) = Uniform::new_inclusive(-error_m.abs(), error_m.abs()) else {
        return;
    };
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0x7465_6163_6800_0000);
    let mut taught: Vec<((u32, u32), Vector3<f64>)> = Vec::new();
    for visit in &mut plan.spheres {
        let key = (visit.sphere_id, visit.place);
        let shift = if let Some((_, shift)) = taught.iter().find(|(k, _)| *k == key) {
            *shift
        } else {
            let shift = Vector3::from_fn(|_, _| axis.sample(&mut random));
            taught.push((key, shift));
            shift
        };
        let position = Vector3::from(visit.approach.position_m) + shift;
        let pose = TcpPose {
            position,
            rotation: rotation_of(&visit.approach.orientation),
            elbow: visit.approach.elbow_rad,
        };
        if let Some(joints) = chain.follow(&pose, &visit.approach.joints)
            && chain.limit_margin(&joints) >= 0.0
        {
            visit.approach.position_m = position.into();
            visit.approach.joints = joints;
        }
    }
}
