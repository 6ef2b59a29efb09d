/* The law of spherecal for C and C++. Written by cbindgen from firmware/law/c; a test compares it. Units are SI. */

#ifndef SPHERECAL_LAW_H
#define SPHERECAL_LAW_H

#include <stdint.h>

/**
 * What became of a call.
 */
typedef enum SpherecalStatus {
  /**
   * It was done.
   */
  SPHERECAL_STATUS_OK = 0,
  /**
   * A pointer is null.
   */
  SPHERECAL_STATUS_NULL = 1,
  /**
   * No built-in robot has this name.
   */
  SPHERECAL_STATUS_UNKNOWN = 2,
  /**
   * The robot, its tool or the number of its joints is not possible.
   */
  SPHERECAL_STATUS_ROBOT = 3,
  /**
   * A number of the law, of the drive or the period is not possible.
   */
  SPHERECAL_STATUS_LAW = 4,
  /**
   * A stiffness is not symmetric, negative in some direction, or too large.
   */
  SPHERECAL_STATUS_STIFFNESS = 5,
  /**
   * An energy is negative or not finite.
   */
  SPHERECAL_STATUS_ENERGY = 6,
  /**
   * A goal is not finite, or its matrix is no rotation.
   */
  SPHERECAL_STATUS_GOAL = 7,
  /**
   * The state has a number that is not finite.
   */
  SPHERECAL_STATUS_STATE = 8,
} SpherecalStatus;

/**
 * A loop of six or seven joints.
 */
typedef struct SpherecalLoop SpherecalLoop;

/**
 * Mass distribution of a body, in its frame.
 */
typedef struct SpherecalInertia {
  /**
   * Mass, in kg.
   */
  double mass_kg;
  /**
   * Centre of mass, in m.
   */
  double com_m[3];
  /**
   * Inertia about the centre of mass: xx, yy, zz, xy, xz, yz of the matrix, in kg m².
   */
  double inertia_kg_m2[6];
} SpherecalInertia;

/**
 * A joint and the link that it moves: a row of modified Denavit-Hartenberg parameters, masses and limits.
 */
typedef struct SpherecalJoint {
  /**
   * Twist about the last x axis, in rad.
   */
  double alpha_rad;
  /**
   * Length along it, in m.
   */
  double a_m;
  /**
   * Hayati's rotation about y after the twist, in rad; 0 in plain tables.
   */
  double beta_rad;
  /**
   * Angle that is added to the joint's, in rad.
   */
  double theta_rad;
  /**
   * Offset along the joint's axis, in m.
   */
  double d_m;
  /**
   * The link, in the joint's frame.
   */
  struct SpherecalInertia link;
  /**
   * Smallest angle, in rad.
   */
  double min_rad;
  /**
   * Largest angle, in rad.
   */
  double max_rad;
  /**
   * Largest speed, in rad/s.
   */
  double velocity_rad_s;
  /**
   * Largest torque, in N m.
   */
  double torque_nm;
  /**
   * Inertia of the rotor at the link's side, in kg m².
   */
  double rotor_kg_m2;
} SpherecalJoint;

/**
 * A robot of six or seven revolute joints.
 */
typedef struct SpherecalRobot {
  /**
   * Number of joints.
   */
  uint32_t joints;
  /**
   * The joints from base to flange.
   */
  struct SpherecalJoint joint[7];
} SpherecalRobot;

/**
 * Numbers of the law; `spherecal_law_default` writes good ones.
 */
typedef struct SpherecalLaw {
  /**
   * Lehr's damping ratio of the Cartesian spring.
   */
  double damping_ratio;
  /**
   * Stiffness of the elbow or posture, in N m/rad.
   */
  double elbow_nm_rad;
  /**
   * Its damping ratio.
   */
  double elbow_damping_ratio;
  /**
   * Time of a ramp of the stiffness, in s.
   */
  double stiffness_ramp_s;
  /**
   * Largest rate of a torque, in N m/s.
   */
  double torque_rate_nm_s;
  /**
   * Pole of the observer, in 1/s.
   */
  double observer_rad_s;
  /**
   * Gain of the torque loop; 0 for a drive that has its own.
   */
  double torque_loop_gain;
  /**
   * Its corner frequency, in rad/s.
   */
  double torque_loop_rad_s;
  /**
   * Largest torque that it adds, in N m.
   */
  double torque_loop_nm;
} SpherecalLaw;

/**
 * A tool at the flange, with the flange's axes.
 */
typedef struct SpherecalTool {
  /**
   * Tool centre point, in m.
   */
  double tcp_m[3];
  /**
   * Mass distribution.
   */
  struct SpherecalInertia body;
} SpherecalTool;

/**
 * What the drive is like.
 */
typedef struct SpherecalDrive {
  /**
   * Inertia of the motors between commanded and measured torque, in kg m²; 0 where the drive hides them.
   */
  double motor_kg_m2[7];
  /**
   * Time from a state to the torque that answers it, beyond the period, in s.
   */
  double latency_s;
  /**
   * Not 0: the drive adds the torque of gravity itself.
   */
  uint8_t carries_gravity;
} SpherecalDrive;

/**
 * A Cartesian stiffness: two symmetric matrices, row by row.
 */
typedef struct SpherecalSpring {
  /**
   * Translation, in N/m.
   */
  double translation_n_m[9];
  /**
   * Rotation, in N m/rad.
   */
  double rotation_nm_rad[9];
  /**
   * Not 0: in the axes of the tool, and not in those of the base.
   */
  uint8_t tool_axes;
} SpherecalSpring;

/**
 * A pose that the TCP is pulled to.
 */
typedef struct SpherecalPose {
  /**
   * Position, in m.
   */
  double position_m[3];
  /**
   * Orientation: a rotation matrix, row by row.
   */
  double rotation[9];
  /**
   * Velocity of the setpoint: linear in m/s, angular in rad/s.
   */
  double velocity[6];
  /**
   * Force (N) and moment (N m) that are added.
   */
  double feed_forward[6];
} SpherecalPose;

/**
 * Angles that the joints are pulled to.
 */
typedef struct SpherecalJointGoal {
  /**
   * Angles, in rad.
   */
  double q_rad[7];
  /**
   * Speeds, in rad/s.
   */
  double dq_rad_s[7];
  /**
   * Natural frequency of every motion, in rad/s, up to 100.
   */
  double natural_rad_s;
} SpherecalJointGoal;

/**
 * State of the joints; of an arm with six the last numbers are ignored.
 */
typedef struct SpherecalState {
  /**
   * Angles, in rad.
   */
  double q_rad[7];
  /**
   * Speeds, in rad/s.
   */
  double dq_rad_s[7];
  /**
   * Torques that the actuators exert on their links, with gravity, in N m.
   */
  double tau_nm[7];
} SpherecalState;

/**
 * What a cycle gives.
 */
typedef struct SpherecalOutput {
  /**
   * Torques for the drive, in N m.
   */
  double torque_nm[7];
  /**
   * Position of the TCP, in m.
   */
  double position_m[3];
  /**
   * Its orientation, row by row.
   */
  double rotation[9];
  /**
   * Force of the environment on the arm at the TCP, in N.
   */
  double force_n[3];
  /**
   * Its moment, in N m.
   */
  double moment_nm[3];
  /**
   * Energy that the guard still has, in J; negative without a guard.
   */
  double tank_j;
  /**
   * First joint at its torque limit, from 1; 0: none.
   */
  uint8_t saturated;
  /**
   * 1: a rate of a torque was limited.
   */
  uint8_t rate_limited;
  /**
   * 1: the arm is near a singularity; stiffness and wrench mean less there.
   */
  uint8_t near_singular;
  /**
   * What the guard held back: 0 nothing, 1 a part of a change, 2 velocity and added force.
   */
  uint8_t withheld;
} SpherecalOutput;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/**
 * What a status means, in English.
 */
const char *spherecal_status_text(int32_t status);

/**
 * Writes the description of a built-in robot, such as "iiwa7", "fr3" or "ur5e".
 *
 * # Safety
 * `name` is null or a C string.
 */
enum SpherecalStatus spherecal_robot_built_in(const char *name, struct SpherecalRobot *robot);

/**
 * Writes the law that is good for most arms.
 */
enum SpherecalStatus spherecal_law_default(struct SpherecalLaw *law);

/**
 * Makes a loop that is stepped once in `period_s` (s). It holds the arm where the first state finds it, with no stiffness until one is
 * set. End it with `spherecal_loop_free`. Without one, `made` is null.
 */
enum SpherecalStatus spherecal_loop_new(const struct SpherecalRobot *robot,
                                        const struct SpherecalTool *tool,
                                        const struct SpherecalLaw *law,
                                        const struct SpherecalDrive *drive,
                                        double period_s,
                                        struct SpherecalLoop **made);

/**
 * Ends a loop; null is allowed.
 */
void spherecal_loop_free(struct SpherecalLoop *control);

/**
 * Ramps to a stiffness. A spring that is refused changes nothing.
 */
enum SpherecalStatus spherecal_loop_set_stiffness(struct SpherecalLoop *control,
                                                  const struct SpherecalSpring *spring);

/**
 * Bounds the energy (J) that changes of goal and stiffness give, with a refill (W).
 */
enum SpherecalStatus spherecal_loop_limit_energy(struct SpherecalLoop *control,
                                                 double capacity_j,
                                                 double refill_w);

/**
 * Pulls the TCP to a pose, from the next cycle on. A new one each cycle is a streamed path.
 */
enum SpherecalStatus spherecal_loop_set_pose(struct SpherecalLoop *control,
                                             const struct SpherecalPose *pose);

/**
 * Pulls the joints to angles, from the next cycle on.
 */
enum SpherecalStatus spherecal_loop_set_joints(struct SpherecalLoop *control,
                                               const struct SpherecalJointGoal *goal);

/**
 * Pulls the elbow of a pose goal to an angle (rad) that moves with a rate (rad/s). Arms with six joints have none, and ignore it.
 */
enum SpherecalStatus spherecal_loop_set_elbow(struct SpherecalLoop *control,
                                              double angle,
                                              double rate);

/**
 * Forgets goal and history: the arm is held where the next state finds it.
 */
enum SpherecalStatus spherecal_loop_reset(struct SpherecalLoop *control);

/**
 * One cycle: from the state to the torques. A state that is not finite changes nothing, and writes nothing.
 */
enum SpherecalStatus spherecal_loop_step(struct SpherecalLoop *control,
                                         const struct SpherecalState *state,
                                         struct SpherecalOutput *output);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* SPHERECAL_LAW_H */
