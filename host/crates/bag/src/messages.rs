//! The types of messages that a bag is read for.

use spherecal_model::excerpt;

use super::cdr::{Cdr, CdrError, Numbers};

pub(crate) const JOINT_STATE: &str = "sensor_msgs/msg/JointState";

/// A type of messages that says where the tool was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TargetKind {
    /// A header, then three coordinates.
    Position,
    /// The same, with the name of a child frame between.
    Transform,
    /// A number of transforms, of which the caller names one by its frames.
    Transforms,
    /// A header, then a number of poses: one counts.
    Poses,
    /// A whole number of so many bytes.
    Number { bytes: u8, signed: bool },
}

/// All of them, with their names.
pub(crate) const TARGETS: [(&str, TargetKind); 14] = {
    const fn number(bytes: u8, signed: bool) -> TargetKind {
        TargetKind::Number { bytes, signed }
    }
    [
        ("geometry_msgs/msg/PointStamped", TargetKind::Position),
        ("geometry_msgs/msg/PoseStamped", TargetKind::Position),
        ("geometry_msgs/msg/TransformStamped", TargetKind::Transform),
        ("nav_msgs/msg/Odometry", TargetKind::Transform),
        ("tf2_msgs/msg/TFMessage", TargetKind::Transforms),
        ("geometry_msgs/msg/PoseArray", TargetKind::Poses),
        ("std_msgs/msg/Int8", number(1, true)),
        ("std_msgs/msg/Int16", number(2, true)),
        ("std_msgs/msg/Int32", number(4, true)),
        ("std_msgs/msg/Int64", number(8, true)),
        ("std_msgs/msg/UInt8", number(1, false)),
        ("std_msgs/msg/UInt16", number(2, false)),
        ("std_msgs/msg/UInt32", number(4, false)),
        ("std_msgs/msg/UInt64", number(8, false)),
    ]
};

pub(crate) fn target_kind(name: &str) -> Option<TargetKind> {
    TARGETS.iter().find(|(known, _)| *known == name).map(|(_, kind)| *kind)
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ToolPlace<'a> {
    /// A point in a frame, in m.
    Point { frame: &'a str, at: [f64; 3] },
    /// At the centre of a sphere; the name of the plate's placement, or nothing.
    Sphere { sphere: u32, place: &'a str },
}

/// Why a message cannot be used: what, and the remedy.
pub(crate) type MessageRefusal = (String, String);

fn broken(error: CdrError) -> MessageRefusal {
    (
        error.words(),
        "record the topic again, or convert the bag with `ros2 bag convert`".to_owned(),
    )
}

/// A header's time in ns; `None` where it is not set.
fn header<'a>(at: &mut Cdr<'a>) -> Result<(Option<i64>, &'a str), CdrError> {
    let (seconds, rest) = (i64::from(at.i32()?), i64::from(at.u32()?));
    let time_ns = seconds.saturating_mul(1_000_000_000).saturating_add(rest);
    Ok((Some(time_ns).filter(|t| *t != 0), at.text()?))
}

/// The sphere that a frame is named after: `sphere_2`, or `PLACE/sphere_2`.
fn sphere_of(frame: &str) -> Option<(u32, &str)> {
    let (place, name) = frame.trim_start_matches('/').rsplit_once('/').unwrap_or(("", frame));
    let number = name.trim_start_matches('/').strip_prefix("sphere_")?;
    let plain = !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit());
    plain.then(|| number.parse().ok())?.map(|sphere| (sphere, place))
}

/// Largest distance of a contact's point from the centre of the sphere in whose frame it is, in m.
const AT_CENTRE_M: f64 = 1e-6;

/// A target with its header's time in ns, where it has one.
type Found<'a> = (Option<i64>, ToolPlace<'a>);

/// Most pairs of frames that a message lists.
const LISTED: usize = 6;

/// Reads a target. `pair` is the parent and child frame of the transform that is wanted of many. `None` for a message
/// without one: another transform, or no pose.
pub(crate) fn target<'a>(
    kind: TargetKind,
    bytes: &'a [u8],
    pair: Option<&(String, String)>,
) -> Result<Option<Found<'a>>, MessageRefusal> {
    let mut at = Cdr::new(bytes).map_err(broken)?;
    if let TargetKind::Number { bytes, signed } = kind {
        let number = at.whole(bytes, signed).map_err(broken)?;
        let sphere = u32::try_from(number).map_err(|_| {
            (
                format!("its number is {number}"),
                "give the id of a sphere of the plate, 0 to 4294967295".to_owned(),
            )
        })?;
        return Ok(Some((None, ToolPlace::Sphere { sphere, place: "" })));
    }
    let position = |at: &mut Cdr<'a>| Ok::<_, CdrError>([at.f64()?, at.f64()?, at.f64()?]);
    let turn = |at: &mut Cdr<'a>| (0..4).try_for_each(|_| at.f64().map(drop));
    let found = match kind {
        TargetKind::Transforms => {
            let mut others = Vec::new();
            let mut found = None;
            for _ in 0..at.length().map_err(broken)? {
                let mut read = || {
                    let (time_ns, parent) = header(&mut at)?;
                    let child = at.text()?;
                    let point = position(&mut at)?;
                    turn(&mut at)?;
                    Ok((time_ns, parent, child, point))
                };
                let (time_ns, parent, child, point) = read().map_err(broken)?;
                match pair {
                    Some((wanted, own)) if wanted == parent && own == child => found = Some((time_ns, parent, point)),
                    _ => others.push(format!("{}:{}", excerpt(parent), excerpt(child))),
                }
            }
            if pair.is_none() {
                others.truncate(LISTED);
                return Err((
                    "it holds the transforms of many frames".to_owned(),
                    format!(
                        "name the measured one by its frames: --tf PARENT:CHILD, such as {}",
                        others.join(" or ")
                    ),
                ));
            }
            found
        }
        TargetKind::Poses => {
            let mut read = || {
                let (time_ns, frame) = header(&mut at)?;
                let count = at.length()?;
                Ok((
                    time_ns,
                    frame,
                    count,
                    if count == 0 { [0.0; 3] } else { position(&mut at)? },
                ))
            };
            let (time_ns, frame, count, point) = read().map_err(broken)?;
            if count > 1 {
                return Err((
                    format!("it holds {count} poses"),
                    "publish the pose of one target, as PoseStamped or as an array of one".to_owned(),
                ));
            }
            (count == 1).then_some((time_ns, frame, point))
        }
        TargetKind::Position | TargetKind::Transform | TargetKind::Number { .. } => {
            let mut read = || {
                let (time_ns, frame) = header(&mut at)?;
                if kind == TargetKind::Transform {
                    at.text()?;
                }
                Ok((time_ns, frame, position(&mut at)?))
            };
            Some(read().map_err(broken)?)
        }
    };
    found
        .map(|(time_ns, frame, point)| Ok((time_ns, place(frame, point)?)))
        .transpose()
}

fn place(frame: &str, point: [f64; 3]) -> Result<ToolPlace<'_>, MessageRefusal> {
    if let Some((axis, value)) = ["x", "y", "z"].iter().zip(point).find(|(_, value)| !value.is_finite()) {
        return Err((
            format!("its {axis} is {value}"),
            "a measurement that failed must not be published; leave its topic out, or filter the bag".to_owned(),
        ));
    }
    let Some((sphere, place)) = sphere_of(frame) else {
        return Ok(ToolPlace::Point { frame, at: point });
    };
    if let Some((axis, value)) = ["x", "y", "z"]
        .iter()
        .zip(point)
        .find(|(_, value)| value.abs() > AT_CENTRE_M)
    {
        return Err((
            format!("its frame is \"{}\", and its {axis} is {value} m", excerpt(frame)),
            "a point in a sphere's frame is a contact: the tool is at the centre, (0, 0, 0). Give a measured point in the \
             instrument's frame"
                .to_owned(),
        ));
    }
    Ok(ToolPlace::Sphere { sphere, place })
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct JointStateMessage<'a> {
    /// Time of its header in ns, where it is set.
    pub(crate) time_ns: Option<i64>,
    /// The bytes of its names: equal bytes are equal names.
    pub(crate) names_key: &'a [u8],
    names: Cdr<'a>,
    pub(crate) position: Numbers<'a>,
    pub(crate) effort: Numbers<'a>,
}

impl<'a> JointStateMessage<'a> {
    /// The time of its header in ns, where it is set.
    pub(crate) fn time(bytes: &[u8]) -> Result<Option<i64>, MessageRefusal> {
        let mut at = Cdr::new(bytes).map_err(broken)?;
        Ok(header(&mut at).map_err(broken)?.0)
    }

    pub(crate) fn read(bytes: &'a [u8]) -> Result<Self, MessageRefusal> {
        let mut at = Cdr::new(bytes).map_err(broken)?;
        let mut read = || {
            let (time_ns, _) = header(&mut at)?;
            let names = at;
            for _ in 0..at.length()? {
                at.text()?;
            }
            let names_key = at.since(&names);
            let (position, _, effort) = (at.f64s()?, at.f64s()?, at.f64s()?);
            Ok(Self {
                time_ns,
                names_key,
                names,
                position,
                effort,
            })
        };
        read().map_err(broken)
    }

    pub(crate) fn names(&self) -> Vec<&'a str> {
        let mut at = self.names;
        let count = at.length().unwrap_or(0);
        (0..count).map_while(|_| at.text().ok()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_spheres() {
        for (frame, found) in [
            ("sphere_2", Some((2, ""))),
            ("/sphere_12", Some((12, ""))),
            ("plate_b/sphere_0", Some((0, "plate_b"))),
            ("cell/left/sphere_3", Some((3, "cell/left"))),
            ("sphere_", None),
            ("sphere_-1", None),
            ("sphere_+1", None),
            ("sphere_99999999999", None),
            ("tracker", None),
            ("", None),
        ] {
            assert_eq!(sphere_of(frame), found, "{frame}");
        }
    }
}
