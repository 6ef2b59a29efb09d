//! The definitions of the ROS 2 messages, as a bag carries them: the message, then each message
//! that it is made of.

/// Line between two definitions.
macro_rules! of {
    ($name:literal) => {
        concat!(
            "================================================================================\nMSG: ",
            $name,
            "\n"
        )
    };
}

macro_rules! header {
    () => {
        concat!(
            of!("std_msgs/Header"),
            "builtin_interfaces/Time stamp\nstring frame_id\n",
            of!("builtin_interfaces/Time"),
            "int32 sec\nuint32 nanosec\n"
        )
    };
}

macro_rules! vector3 {
    () => {
        concat!(of!("geometry_msgs/Vector3"), "float64 x\nfloat64 y\nfloat64 z\n")
    };
}

/// `sensor_msgs/msg/JointState`.
pub(super) const JOINT_STATE: &str = concat!(
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    header!()
);

/// `geometry_msgs/msg/WrenchStamped`.
pub(super) const WRENCH_STAMPED: &str = concat!(
    "std_msgs/Header header\nWrench wrench\n",
    header!(),
    of!("geometry_msgs/Wrench"),
    "Vector3 force\nVector3 torque\n",
    vector3!()
);

/// `geometry_msgs/msg/PointStamped`.
pub(super) const POINT_STAMPED: &str = concat!(
    "std_msgs/Header header\nPoint point\n",
    header!(),
    of!("geometry_msgs/Point"),
    "float64 x\nfloat64 y\nfloat64 z\n"
);

/// `tf2_msgs/msg/TFMessage`.
pub(super) const TF_MESSAGE: &str = concat!(
    "geometry_msgs/TransformStamped[] transforms\n",
    of!("geometry_msgs/TransformStamped"),
    "std_msgs/Header header\nstring child_frame_id\nTransform transform\n",
    header!(),
    of!("geometry_msgs/Transform"),
    "Vector3 translation\nQuaternion rotation\n",
    vector3!(),
    of!("geometry_msgs/Quaternion"),
    "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
);
