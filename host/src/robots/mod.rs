//! Robots of the field: TOML, URDF, kinematics YAML, in and out.
