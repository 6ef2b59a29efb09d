//! What a caller wants of a bag.

/// What is wanted of a bag.
#[derive(Clone, Debug, PartialEq)]
pub struct Wanted {
    /// Names of the robot's joints as the joint states have them, base to flange.
    pub joints: Vec<String>,
    /// Other names of the same joints, taken where a joint state has not all of `joints`; or none.
    pub other_joints: Vec<String>,
    /// Topics that are taken; empty to take the only ones that could be meant.
    pub topics: Vec<String>,
    /// Parent and child frame of the transform that is the target, on a topic of `tf2_msgs/msg/TFMessage`.
    pub transform: Option<(String, String)>,
    /// Width of the band in which a joint counts as resting, in rad.
    pub rest_rad: f64,
    /// Whether `effort` is the measured torque in N m.
    pub effort_nm: bool,
}

impl Wanted {
    /// The usual band of a rest, in rad.
    pub const REST_RAD: f64 = 0.5e-3;

    /// Joint states of these joints, and whatever else is usual.
    pub fn new(joints: Vec<String>) -> Self {
        Self {
            joints,
            other_joints: Vec::new(),
            topics: Vec::new(),
            transform: None,
            rest_rad: Self::REST_RAD,
            effort_nm: false,
        }
    }
}
