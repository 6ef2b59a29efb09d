//! Robots from the parameters that a controller of Universal Robots states.
//!
//! The calibrations are those of three robots in use: nominal UR10 and the corrections of the test `calibration` of
//! Universal_Robots_ROS2_Driver, `ur_calibration/test/calibration_test.cpp` (BSD-3-Clause). Two of them put the frames of the
//! parallel joints hundreds of metres apart.

use nalgebra::Vector3;

use super::super::frames::{compose, distance, from_rpy, rot_x, rot_z};
use super::super::vendor::{UR_KEYS, UR_ROBOTS};
use super::super::*;
use crate::halton::halton;

/// Corrections of theta, a, d and alpha.
const CORRECTIONS: [[[f64; 6]; 4]; 3] = [
    [
        [
            -7.29e-5,
            -0.017_138_972_897_05,
            -0.037_071_594_134_927_56,
            0.054_279_462_160_583_214,
            1.489e-7,
            1.5515e-5,
        ],
        [
            4.631e-5,
            -0.000_125_683_153_318_623,
            0.001_862_165_811_614_58,
            9.918_6e-5,
            4.215e-6,
            0.0,
        ],
        [
            0.000_656_092_129_8,
            1.444_216_237_628_478_8,
            0.854_147_723_854_608,
            -2.298_942_587_756_370_5,
            -1.5735e-5,
            1.9072e-5,
        ],
        [
            0.000_211_987_863_87,
            -0.007_255_362_595_765_3,
            -0.013_483_226_769_541_364,
            0.001_349_582_022_732_942_5,
            -0.001_263_136_163_68,
            0.0,
        ],
    ],
    [
        [
            1.596e-7,
            -0.917_209_621_528_830_2,
            7.129_361_313_464_995,
            0.071_029_902_942_439_23,
            -1.6426e-6,
            9.1729e-8,
        ],
        [
            0.000_108_651_07,
            0.240_324_175_250_532_35,
            0.001_806_281_802_134_93,
            2.630_8e-5,
            3.966e-6,
            0.0,
        ],
        [
            -0.000_144_894_98,
            303.469_135_666_158_2,
            -309.883_943_077_897_5,
            6.414_599_043_973_95,
            -4.4823e-5,
            -0.000_870_714_03,
        ],
        [
            -0.000_444_781_95,
            -0.001_602_151_125_312_15,
            0.006_319_177_933_310_919,
            -0.001_650_552_473_41,
            0.000_763_682_515_5,
            0.0,
        ],
    ],
    [
        [
            -2.4148e-7,
            1.602_339_523_866_945_6,
            -1.686_071_907_521_713,
            0.083_733_114_770_011_87,
            -1.0126e-7,
            3.9199e-8,
        ],
        [
            2.1223e-5,
            0.632_017_132_627_700_7,
            0.002_298_336_388_912_303,
            -4.614_1e-5,
            -6.392_8e-5,
            0.0,
        ],
        [
            -0.000_160_188_29,
            439.140_974_079_900_96,
            -446.027_059_806_332_15,
            6.886_186_896_423_601,
            -3.8659e-5,
            -0.000_879_082_74,
        ],
        [
            -0.000_650_246_56,
            0.001_394_166_668_255_904,
            0.006_938_188_803_259_95,
            -0.000_811_641_562_39,
            0.000_411_120_504_57,
            0.0,
        ],
    ],
];

fn corrected(nominal: UrParameters, [theta, a, d, alpha]: &[[f64; 6]; 4]) -> UrParameters {
    let plus = |x: [f64; 6], y: &[f64; 6]| std::array::from_fn(|j| x[j] + y[j]);
    UrParameters {
        theta: plus(nominal.theta, theta),
        a: plus(nominal.a, a),
        d: plus(nominal.d, d),
        alpha: plus(nominal.alpha, alpha),
    }
}

/// The flange in the robot's base by the definition of the parameters, joint by joint.
fn by_definition(dh: &UrParameters, q: &[f64]) -> Pose<f64> {
    let step = |rotation, position| Pose { rotation, position };
    let mut at = Pose::identity();
    for j in 0..6 {
        at = compose(&at, &step(rot_z(q[j] + dh.theta[j]), Vector3::zeros()));
        at = compose(
            &at,
            &step(nalgebra::Matrix3::identity(), Vector3::new(0.0, 0.0, dh.d[j])),
        );
        at = compose(&at, &step(rot_x(dh.alpha[j]), Vector3::new(dh.a[j], 0.0, 0.0)));
    }
    at
}

// Fails if a robot moves otherwise than its parameters say, seen in `base_link`, which the maker turns by half a turn about
// z; or if the far frames of a calibration get into its joint origins.
#[test]
fn a_calibrated_robot_moves_as_its_parameters_say() {
    let half_turn = Pose {
        rotation: rot_z(std::f64::consts::PI),
        position: Vector3::zeros(),
    };
    for correction in &CORRECTIONS {
        let dh = corrected(
            UrParameters::of_lengths(ur_lengths("ur10").expect("built in")),
            correction,
        );
        let model = dh.robot().expect("a robot");
        assert_eq!(model.robot.name.as_str(), "ur10");
        for k in 1..200 {
            let q: Vec<f64> = (0..6).map(|j| 12.0 * (halton(k, j) - 0.5)).collect();
            let expected = compose(&half_turn, &by_definition(&dh, &q));
            let off = distance(&model.flange_at(&q), &expected);
            assert!(off < 1e-10, "off by {off:e}");
        }
        let yaml = write_kinematics_yaml(&model, &model.rows(), &[]);
        let again = kinematics_yaml::load("again.yaml", &yaml).expect("joint origins");
        let q = [0.3, -0.7, 1.1, -1.3, 0.2, 0.9];
        assert!(distance(&again.flange_at(&q), &model.flange_at(&q)) < 1e-10);
        assert!(UR_KEYS.iter().all(|key| yaml.contains(&format!("  {key}:"))), "{yaml}");
        // Upper arm and forearm are told by one length along x, as in the maker's own files.
        let Origin::Urdf(source) = &model.origin else {
            panic!("no description");
        };
        let at = |name: &str| {
            source
                .0
                .joints
                .iter()
                .find(|j| j.name == name)
                .expect("a joint")
                .origin
                .position
        };
        for (joint, length) in [("elbow_joint", 0.612), ("wrist_1_joint", 0.5723)] {
            let p = at(joint);
            assert!((p.x + length).abs() < 3e-3, "{joint}: {p}");
        }
        assert!(at("elbow_joint").yz().norm() < 1e-9, "{}", at("elbow_joint"));
        assert!((at("wrist_1_joint") - Vector3::new(-0.5723, 0.0, 0.163_941)).norm() < 5e-3);
    }
}

// Fails if a built-in robot is not recognised by its parameters, nominal or calibrated, or does not get its masses, its
// limits and its table.
#[test]
fn built_in_robots_are_recognised() {
    for name in UR_ROBOTS {
        let lengths = ur_lengths(name).expect("built in");
        let known = built_in(name).expect("built in");
        let exact = UrParameters::of_lengths(lengths).robot().expect("a robot");
        let difference = compare(&known, &exact).expect("six joints");
        assert!(difference.max_m < 1e-12, "{name}: {difference:?}");
        let small = |x: &[f64; 3]| x.iter().all(|x| x.abs() < 1e-9);
        assert!(
            difference
                .links
                .iter()
                .all(|link| small(&link.shift_m) && small(&link.turn_rad)),
            "{difference:?}"
        );
        let one = corrected(UrParameters::of_lengths(lengths), &CORRECTIONS[0])
            .robot()
            .expect("a robot");
        for model in [exact, one] {
            assert_eq!(model.robot.name.as_str(), name);
            for (own, source) in model.robot.joints.iter().zip(&known.robot.joints) {
                assert_eq!((own.link, own.limits), (source.link, source.limits), "{name}");
            }
            assert_eq!(model.joint_names, known.joint_names);
        }
    }
}

// Fails if a difference is told of another link, in other axes or with another size than it was made with.
#[test]
fn differences_are_told_link_by_link() {
    let own = built_in("ur5e").expect("built in");
    let mut other = own.clone();
    // Row 3 (the elbow): 2 mm along x of its predecessor, and the joint turned by 3 mrad.
    other.robot.joints[2].mdh.a += 2e-3;
    other.robot.joints[2].mdh.theta += 3e-3;
    other.flange.rotation = from_rpy([1e-3, 0.0, 0.0]);
    let found = compare(&own, &other).expect("six joints");
    for (k, link) in found.links.iter().enumerate() {
        let expected = match k {
            2 => ([2e-3, 0.0, 0.0], [0.0, 0.0, 3e-3]),
            6 => ([0.0; 3], [1e-3, 0.0, 0.0]),
            _ => ([0.0; 3], [0.0; 3]),
        };
        let near = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-8);
        assert!(
            near(&link.shift_m, &expected.0) && near(&link.turn_rad, &expected.1),
            "{link:?}"
        );
    }
    assert_eq!(
        (found.links[2].name.as_str(), found.links[6].name.as_str()),
        ("elbow_joint", "tool0")
    );
    assert!(
        (1e-3..6e-3).contains(&found.mean_m) && found.max_m > found.mean_m,
        "{found:?}"
    );
    assert_eq!(compare(&own, &built_in("panda").expect("built in")), None);
}
