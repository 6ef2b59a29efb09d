//! The numbers that the paper prints in its Tables 1 to 6.

use crate::Estimator;

/// Table 1: centres of the spheres in the world frame, in mm.
pub(super) const TABLE_1_MM: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [300.009, 0.0, 0.0], [150.049, 260.051, 0.0]];

/// Table 2: the parameters that Algorithm 1 removed (row 1's four apart).
pub(super) const TABLE_2_REDUNDANT: [&str; 3] = ["d6", "a6", "theta7"];

/// Table 3 and Table 4, in mm: rows x, y, z; columns mean, std, min, max.
pub(super) const TABLE_3_MM: [[f64; 4]; 3] = [
    [525.872, 160.031, -7.304, 947.042],
    [-69.712, 220.397, -560.339, 452.969],
    [650.021, 186.840, 198.322, 1197.046],
];
/// See [`TABLE_3_MM`].
pub(super) const TABLE_4_MM: [[f64; 4]; 3] = [
    [501.986, 211.902, -24.214, 995.460],
    [-7.856, 252.262, -578.336, 523.221],
    [750.930, 227.457, 137.178, 1135.052],
];

/// Table 5: model, and mean, std, min, max in mm.
pub(super) const TABLE_5_MM: [(Estimator, [f64; 4]); 3] = [
    (Estimator::LaserNelderMead, [0.645, 0.192, 0.168, 0.932]),
    (Estimator::PaperNelderMead, [0.677, 0.206, 0.225, 0.990]),
    (Estimator::Nominal, [1.403, 0.392, 0.325, 2.381]),
];

/// Table 6: rows of alpha (rad), a (mm), theta (rad), d (mm).
pub(super) const TABLE_6: [[f64; 4]; 7] = [
    [0.0, 0.0, 0.0, 340.0],
    [-1.570759, 0.000061, 0.000062, 0.000062],
    [1.571575, 0.000056, -0.000490, 400.574635],
    [1.569842, 0.000061, 0.000061, 0.000063],
    [-1.570623, 0.000062, 0.000059, 400.629881],
    [-1.571451, 0.000062, 0.000061, 0.0],
    [1.571136, 0.0, 0.0, 125.505736],
];
