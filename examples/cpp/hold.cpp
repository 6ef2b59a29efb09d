// A loop of 1 kHz that holds a simulated arm, is pushed with 8 N, and tells by how much it gave way. See README.md.
#include <cmath>
#include <cstdio>
#include <memory>

#include "arm.hpp"

namespace {

struct Free {
  void operator()(SpherecalLoop* control) const { spherecal_loop_free(control); }
};

bool done(SpherecalStatus status, const char* what) {
  if (status != SPHERECAL_STATUS_OK) std::fprintf(stderr, "%s: %s\n", what, spherecal_status_text(status));
  return status == SPHERECAL_STATUS_OK;
}

bool hold(const char* name, const std::array<double, 7>& start) {
  SpherecalRobot robot{};
  SpherecalLaw law{};
  if (!done(spherecal_robot_built_in(name, &robot), name) || !done(spherecal_law_default(&law), "law")) return false;
  const SpherecalTool tool{};
  const SpherecalDrive drive{};
  SpherecalLoop* made;
  if (!done(spherecal_loop_new(&robot, &tool, &law, &drive, 1e-3, &made), "loop")) return false;
  const std::unique_ptr<SpherecalLoop, Free> control(made);

  // Soft along x, stiff along y; z and x belong together.
  SpherecalSpring spring{{300, 0, 100, 0, 800, 0, 100, 0, 400}, {40, 0, 0, 0, 30, 0, 0, 0, 20}, 0};
  if (!done(spherecal_loop_set_stiffness(control.get(), &spring), "stiffness")) return false;
  SpherecalSpring wrong = spring;
  wrong.translation_n_m[2] = -100;
  if (spherecal_loop_set_stiffness(control.get(), &wrong) != SPHERECAL_STATUS_STIFFNESS) return false;
  if (!done(spherecal_loop_limit_energy(control.get(), 2.0, 0.0), "energy")) return false;

  arm::Simulated simulated(robot, start);
  std::array<double, 7> torque = simulated.holding();
  SpherecalOutput out{};
  double before[3] = {0, 0, 0};
  for (int cycle = 0; cycle < 4000; ++cycle) {
    SpherecalState state{};
    for (int i = 0; i < 7; ++i) {
      state.q_rad[i] = simulated.q[i];
      state.dq_rad_s[i] = simulated.dq[i];
      state.tau_nm[i] = torque[i];
    }
    if (!done(spherecal_loop_step(control.get(), &state, &out), "step")) return false;
    if (cycle == 500)
      for (int i = 0; i < 3; ++i) before[i] = out.position_m[i];
    for (int i = 0; i < 7; ++i) torque[i] = out.torque_nm[i];
    simulated.step(torque.data(), {0, 0, cycle < 500 ? 0.0 : -8.0}, 1e-3);
  }
  // K moved = push.
  const double moved[3] = {out.position_m[0] - before[0], out.position_m[1] - before[1], out.position_m[2] - before[2]};
  const double x = 300 * moved[0] + 100 * moved[2], y = 800 * moved[1], z = 100 * moved[0] + 400 * moved[2];
  std::printf("%s held: moved by %.1f, %.1f, %.1f mm, feels %.2f N\n", name, 1e3 * moved[0], 1e3 * moved[1], 1e3 * moved[2],
              out.force_n[2]);
  return std::hypot(x, y, z + 8) < 0.1 && std::abs(out.force_n[2] + 8) < 0.1;
}

}  // namespace

int main() {
  const bool seven = hold("iiwa7", {0, 0.7, 0, -1.2, 0, 1.24, 0});
  const bool six = hold("ur5e", {0.1, -1.2, 1.5, -1.4, -1.5, 0.2, 0});
  return seven && six ? 0 : 1;
}
