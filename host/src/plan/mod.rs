//! The planner: poses on the spheres, inverse kinematics, order, laser configurations.
