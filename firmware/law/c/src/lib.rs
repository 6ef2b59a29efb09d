//! The law for C and C++: a static library, and the header `include/spherecal_law.h`.
//!
//! A loop is made once ([`spherecal_loop_new`]), set between cycles, and stepped once a cycle ([`spherecal_loop_step`]). Only making one
//! allocates. All units are SI, all vectors are in F0; matrices are 3 x 3, row by row. A pointer may be null, which is refused, or must
//! point to a whole value of its type. A loop belongs to one thread at a time.

mod types;

use core::ffi::{CStr, c_char};
use core::mem::MaybeUninit;

use nalgebra::{Matrix3, Rotation3, Vector3, Vector6};
use spherecal_law::{
    Actuation, Axes, CartesianSetpoint, EnergyLimit, FullStiffness, Goal, ImpedanceLoop, JointSetpoint, LawError,
    NullSpace,
};
use spherecal_shared::procedure::Law;
use spherecal_shared::robot::{Robot, built_in};

pub use types::{
    SpherecalDrive, SpherecalInertia, SpherecalJoint, SpherecalJointGoal, SpherecalLaw, SpherecalOutput, SpherecalPose,
    SpherecalRobot, SpherecalSpring, SpherecalState, SpherecalStatus, SpherecalTool,
};

/// A loop of six or seven joints.
pub struct SpherecalLoop(Any);

#[expect(clippy::large_enum_variant, reason = "a loop is on the heap as a whole")]
enum Any {
    Six(ImpedanceLoop<6>),
    Seven(ImpedanceLoop<7>),
}

/// Does the same with a loop of either size.
macro_rules! with {
    ($handle:expr, $control:ident => $body:expr) => {
        match $handle {
            Some(SpherecalLoop(Any::Six($control))) => $body,
            Some(SpherecalLoop(Any::Seven($control))) => $body,
            None => SpherecalStatus::Null,
        }
    };
}

impl From<LawError> for SpherecalStatus {
    fn from(error: LawError) -> Self {
        match error {
            LawError::Robot(_) => Self::Robot,
            LawError::Law(_) => Self::Law,
            LawError::Stiffness { .. } => Self::Stiffness,
            LawError::Energy { .. } => Self::Energy,
        }
    }
}

fn status(result: Result<(), LawError>) -> SpherecalStatus {
    result.map_or_else(SpherecalStatus::from, |()| SpherecalStatus::Ok)
}

/// The first numbers of an array of seven.
fn first<const N: usize>(values: &[f64; 7]) -> [f64; N] {
    core::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0))
}

/// What a status means, in English.
// C finds the function by this name; no other of the library has it. So it is with all that follow.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_status_text(status: i32) -> *const c_char {
    let text = match status {
        0 => c"done",
        1 => c"a pointer is null",
        2 => c"no built-in robot has this name",
        3 => c"the robot, its tool or the number of its joints is not possible",
        4 => c"a number of the law, of the drive or the period is not possible",
        5 => c"a stiffness is not symmetric, negative in some direction, or more than 5000 N/m or 300 N m/rad",
        6 => c"the energy is negative or not finite",
        7 => c"a goal is not finite, or its matrix is no rotation",
        8 => c"the state has a number that is not finite: nothing was changed",
        _ => c"no status of this library",
    };
    text.as_ptr()
}

/// Writes the description of a built-in robot, such as "iiwa7", "fr3" or "ur5e".
///
/// # Safety
/// `name` is null or a C string.
#[expect(unsafe_code, reason = "a name that C finds, and its string")]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn spherecal_robot_built_in(
    name: *const c_char,
    robot: Option<&mut SpherecalRobot>,
) -> SpherecalStatus {
    let (false, Some(robot)) = (name.is_null(), robot) else {
        return SpherecalStatus::Null;
    };
    // SAFETY: it is not null, and the caller promises a C string.
    let name = unsafe { CStr::from_ptr(name) };
    let Some(found) = name.to_str().ok().and_then(built_in) else {
        return SpherecalStatus::Unknown;
    };
    robot.joints = 0;
    for (to, from) in robot.joint.iter_mut().zip(&found.joints) {
        *to = from.into();
        robot.joints += 1;
    }
    SpherecalStatus::Ok
}

/// Writes the law that is good for most arms.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_law_default(law: Option<&mut SpherecalLaw>) -> SpherecalStatus {
    let Some(law) = law else {
        return SpherecalStatus::Null;
    };
    *law = Law::default().into();
    SpherecalStatus::Ok
}

/// Makes a loop that is stepped once in `period_s` (s). It holds the arm where the first state finds it, with no stiffness until one is
/// set. End it with `spherecal_loop_free`. Without one, `made` is null.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_loop_new(
    robot: Option<&SpherecalRobot>,
    tool: Option<&SpherecalTool>,
    law: Option<&SpherecalLaw>,
    drive: Option<&SpherecalDrive>,
    period_s: f64,
    made: Option<&mut MaybeUninit<Option<Box<SpherecalLoop>>>>,
) -> SpherecalStatus {
    let (Some(robot), Some(tool), Some(law), Some(drive), Some(made)) = (robot, tool, law, drive, made) else {
        return SpherecalStatus::Null;
    };
    // C does not clear its variables, so what stands there is no loop that could be dropped.
    made.write(None);
    let possible = period_s > 0.0 && period_s <= 0.1 && drive.latency_s >= 0.0 && drive.latency_s <= 0.1;
    if !possible
        || drive
            .motor_kg_m2
            .iter()
            .any(|motor| !(motor.is_finite() && *motor >= 0.0))
    {
        return SpherecalStatus::Law;
    }
    let joints = robot.joint.iter().take(robot.joints as usize).map(Into::into).collect();
    let description: Robot = Robot {
        name: heapless::String::new(),
        joints,
    };
    let (tool, law, gravity) = (tool.into(), law.into(), drive.carries_gravity != 0);
    macro_rules! made {
        ($size:ident) => {{
            let drive = Actuation::new(first(&drive.motor_kg_m2), period_s, drive.latency_s);
            ImpedanceLoop::new(&description, &tool, law, drive, gravity, period_s).map(Any::$size)
        }};
    }
    let any = match robot.joints {
        6 => made!(Six),
        7 => made!(Seven),
        _ => return SpherecalStatus::Robot,
    };
    match any {
        Ok(any) => {
            made.write(Some(Box::new(SpherecalLoop(any))));
            SpherecalStatus::Ok
        }
        Err(error) => error.into(),
    }
}

/// Ends a loop; null is allowed.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_loop_free(control: Option<Box<SpherecalLoop>>) {
    drop(control);
}

/// Ramps to a stiffness. A spring that is refused changes nothing.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_loop_set_stiffness(
    control: Option<&mut SpherecalLoop>,
    spring: Option<&SpherecalSpring>,
) -> SpherecalStatus {
    let Some(spring) = spring else {
        return SpherecalStatus::Null;
    };
    let stiffness = FullStiffness {
        translation: Matrix3::from_row_slice(&spring.translation_n_m),
        rotation: Matrix3::from_row_slice(&spring.rotation_nm_rad),
    };
    let axes = if spring.tool_axes == 0 { Axes::Base } else { Axes::Tool };
    with!(control, control => status(control.set_stiffness(stiffness, axes)))
}

/// Bounds the energy (J) that changes of goal and stiffness give, with a refill (W).
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_loop_limit_energy(
    control: Option<&mut SpherecalLoop>,
    capacity_j: f64,
    refill_w: f64,
) -> SpherecalStatus {
    let limit = EnergyLimit { capacity_j, refill_w };
    with!(control, control => status(control.set_energy_limit(Some(limit))))
}

/// Pulls the TCP to a pose, from the next cycle on. A new one each cycle is a streamed path.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_loop_set_pose(
    control: Option<&mut SpherecalLoop>,
    pose: Option<&SpherecalPose>,
) -> SpherecalStatus {
    let Some(pose) = pose else {
        return SpherecalStatus::Null;
    };
    let rotation = Matrix3::from_row_slice(&pose.rotation);
    let off = (rotation * rotation.transpose() - Matrix3::identity()).norm();
    let others = pose.position_m.iter().chain(&pose.velocity).chain(&pose.feed_forward);
    if !(off < 1e-6 && rotation.determinant() > 0.0 && others.clone().all(|x| x.is_finite())) {
        return SpherecalStatus::Goal;
    }
    let goal = CartesianSetpoint {
        velocity: Vector6::from(pose.velocity),
        feed_forward: Vector6::from(pose.feed_forward),
        ..CartesianSetpoint::at(
            Vector3::from(pose.position_m),
            Rotation3::from_matrix_unchecked(rotation).into_inner(),
        )
    };
    with!(control, control => {
        control.goal = Some(Goal::Pose(goal));
        SpherecalStatus::Ok
    })
}

/// Pulls the joints to angles, from the next cycle on.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_loop_set_joints(
    control: Option<&mut SpherecalLoop>,
    goal: Option<&SpherecalJointGoal>,
) -> SpherecalStatus {
    let Some(goal) = goal else {
        return SpherecalStatus::Null;
    };
    let finite = goal.q_rad.iter().chain(&goal.dq_rad_s).all(|x| x.is_finite());
    if !(finite && goal.natural_rad_s > 0.0 && goal.natural_rad_s <= 100.0) {
        return SpherecalStatus::Goal;
    }
    with!(control, control => {
        control.goal = Some(Goal::Joints {
            setpoint: JointSetpoint {
                q: first(&goal.q_rad),
                dq: first(&goal.dq_rad_s),
            },
            natural_rad_s: goal.natural_rad_s,
        });
        SpherecalStatus::Ok
    })
}

/// Pulls the elbow of a pose goal to an angle (rad) that moves with a rate (rad/s). Arms with six joints have none, and ignore it.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_loop_set_elbow(
    control: Option<&mut SpherecalLoop>,
    angle: f64,
    rate: f64,
) -> SpherecalStatus {
    if !(angle.is_finite() && rate.is_finite()) {
        return SpherecalStatus::Goal;
    }
    match control {
        Some(SpherecalLoop(Any::Six(_))) => SpherecalStatus::Ok,
        Some(SpherecalLoop(Any::Seven(control))) => {
            control.null_space = Some(NullSpace::Elbow {
                angle,
                rate,
                acceleration: 0.0,
            });
            SpherecalStatus::Ok
        }
        None => SpherecalStatus::Null,
    }
}

/// Forgets goal and history: the arm is held where the next state finds it.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_loop_reset(control: Option<&mut SpherecalLoop>) -> SpherecalStatus {
    with!(control, control => {
        control.reset();
        SpherecalStatus::Ok
    })
}

/// One cycle: from the state to the torques. A state that is not finite changes nothing, and writes nothing.
#[expect(unsafe_code, reason = "a name that C finds")]
#[unsafe(no_mangle)]
pub extern "C" fn spherecal_loop_step(
    control: Option<&mut SpherecalLoop>,
    state: Option<&SpherecalState>,
    output: Option<&mut SpherecalOutput>,
) -> SpherecalStatus {
    let (Some(state), Some(output)) = (state, output) else {
        return SpherecalStatus::Null;
    };
    with!(control, control => {
        let (q, dq, tau) = (first(&state.q_rad), first(&state.dq_rad_s), first(&state.tau_nm));
        match control.step(&q, &dq, &tau) {
            Some(out) => {
                output.write(&out, control.tank_j());
                SpherecalStatus::Ok
            }
            None => SpherecalStatus::State,
        }
    })
}
