//! The limits that a robot states in its own model (URDF, the answer to `GetRobotModel`).

use roxmltree::{Document, Node};

use super::ArmLimits;
use super::limits::NearStops;
use crate::JOINTS;

/// Why a robot's model states no limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ModelError {
    /// The text is not XML.
    #[error("the robot's model is not XML, see its line {line}")]
    Xml {
        /// Where it breaks.
        line: u32,
    },
    /// Another number of revolute joints.
    #[error("the robot's model has {got} revolute joints, expected {JOINTS}")]
    Joints {
        /// How many there are.
        got: usize,
    },
    /// A limit is missing or no limit.
    #[error("the robot's model has no usable limit {name} of joint {joint}")]
    Limit {
        /// The joint, from 1.
        joint: usize,
        /// The attribute.
        name: &'static str,
    },
}

impl ArmLimits {
    /// The limits in a robot's model. Its revolute joints stand in the order of the arm.
    ///
    /// Where the model says how the velocity limits fall near the stops, the stops are taken to be the position limits:
    /// the model does not state them.
    ///
    /// # Errors
    /// A [`ModelError`] if the text is no URDF of an arm with seven revolute joints and finite limits.
    pub fn from_urdf(text: &str) -> Result<Self, ModelError> {
        let document = Document::parse(text).map_err(|error| ModelError::Xml { line: error.pos().row })?;
        let joints: Vec<Node<'_, '_>> = document
            .root_element()
            .children()
            .filter(|node| node.has_tag_name("joint") && node.attribute("type") == Some("revolute"))
            .collect();
        let Ok(joints) = <[Node<'_, '_>; JOINTS]>::try_from(joints.as_slice()) else {
            return Err(ModelError::Joints { got: joints.len() });
        };
        let mut limits = Self {
            near_stops: None,
            ..Self::FR3
        };
        let mut near = NearStops {
            velocity_offset: [0.0; JOINTS],
            deceleration: [0.0; JOINTS],
            lower_stop: [0.0; JOINTS],
            upper_stop: [0.0; JOINTS],
        };
        let mut stated = 0;
        for (j, joint) in joints.into_iter().enumerate() {
            let of = |tag: &str| joint.children().find(|node| node.has_tag_name(tag));
            let number = |node: Option<Node<'_, '_>>, name: &'static str, least: f64| {
                let text = node.and_then(|node| node.attribute(name)).unwrap_or_default();
                let value = text.trim().parse().ok().filter(|v: &f64| v.is_finite() && *v >= least);
                value.ok_or(ModelError::Limit { joint: j + 1, name })
            };
            let limit = of("limit");
            limits.lower[j] = number(limit, "lower", f64::MIN)?;
            limits.upper[j] = number(limit, "upper", limits.lower[j])?;
            limits.velocity[j] = number(limit, "velocity", f64::MIN_POSITIVE)?;
            limits.torque[j] = number(limit, "effort", f64::MIN_POSITIVE)?;
            if let braking @ Some(_) = of("position_based_velocity_limits") {
                near.velocity_offset[j] = number(braking, "velocity_offset", 0.0)?;
                near.deceleration[j] = number(braking, "deceleration_limit", f64::MIN_POSITIVE)?;
                stated += 1;
            }
        }
        if stated == JOINTS {
            near.lower_stop = limits.lower;
            near.upper_stop = limits.upper;
            limits.near_stops = Some(near);
        }
        Ok(limits)
    }
}

#[cfg(test)]
mod tests {
    use super::super::FR3_URDF;
    use super::*;

    // Fails if a limit of the FR3's own model is read otherwise than the maker's table states it.
    #[test]
    fn the_fr3s_model_states_its_limits() {
        let (read, table) = (ArmLimits::from_urdf(FR3_URDF).expect("a model"), ArmLimits::FR3);
        assert_eq!((read.lower, read.upper), (table.lower, table.upper));
        assert_eq!((read.velocity, read.torque), (table.velocity, table.torque));
        let (read, table) = (read.near_stops.expect("stated"), table.near_stops.expect("stated"));
        assert_eq!(read.velocity_offset, table.velocity_offset);
        assert_eq!(read.deceleration, table.deceleration);
    }

    // Fails if a model without usable limits is accepted, or the error does not say where.
    #[test]
    fn a_model_without_limits_is_refused() {
        for (from, to, words) in [
            ("<robot", "robot", "not XML"),
            ("type=\"revolute\"", "type=\"fixed\"", "has 6 revolute joints"),
            ("lower=\"-2.7437\"", "", "lower of joint 1"),
            ("upper=\"1.7837\"", "upper=\"-2.0\"", "upper of joint 2"),
            ("velocity=\"2.62\"", "velocity=\"NaN\"", "velocity of joint 1"),
            ("effort=\"87.0\"", "effort=\"0\"", "effort of joint 1"),
            ("deceleration_limit=\"6.0\"", "", "deceleration_limit of joint 1"),
        ] {
            let text = FR3_URDF.replacen(from, to, 1);
            assert_ne!(text, FR3_URDF, "{from}");
            let error = ArmLimits::from_urdf(&text).expect_err(from).to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
