// A rigid arm, simulated: Newton-Euler on the rows of a SpherecalRobot, independent of the library.
#pragma once

#include <array>
#include <cmath>

#include "spherecal_law.h"

namespace arm {

using V = std::array<double, 3>;
using M = std::array<double, 9>;  // row by row

inline V operator+(const V& a, const V& b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline V operator*(double s, const V& a) { return {s * a[0], s * a[1], s * a[2]}; }
inline V cross(const V& a, const V& b) {
  return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}
inline V mul(const M& m, const V& a) {
  return {m[0] * a[0] + m[1] * a[1] + m[2] * a[2], m[3] * a[0] + m[4] * a[1] + m[5] * a[2],
          m[6] * a[0] + m[7] * a[1] + m[8] * a[2]};
}
inline V turn_back(const M& m, const V& a) {
  return {m[0] * a[0] + m[3] * a[1] + m[6] * a[2], m[1] * a[0] + m[4] * a[1] + m[7] * a[2],
          m[2] * a[0] + m[5] * a[1] + m[8] * a[2]};
}

// A robot that carries no tool.
class Simulated {
 public:
  std::array<double, 7> q{}, dq{};

  Simulated(const SpherecalRobot& robot, const std::array<double, 7>& start) : q(start), robot_(robot), n_(robot.joints) {}

  // Torques for accelerations under gravity; `push` (N) acts on the flange, in the axes of the base.
  std::array<double, 7> torques(const std::array<double, 7>& ddq, const std::array<double, 7>& dq, double gravity,
                                const V& push) const {
    std::array<M, 7> r;
    std::array<V, 7> p, force, moment;
    M base = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    V w{}, dw{}, a = {0, 0, gravity};
    for (unsigned i = 0; i < n_; ++i) {
      const SpherecalJoint& j = robot_.joint[i];
      const double ca = std::cos(j.alpha_rad), sa = std::sin(j.alpha_rad);
      const double ct = std::cos(q[i] + j.theta_rad), st = std::sin(q[i] + j.theta_rad);
      r[i] = {ct, -st, 0, st * ca, ct * ca, -sa, st * sa, ct * sa, ca};
      p[i] = {j.a_m, -sa * j.d_m, ca * j.d_m};
      const V z = {0, 0, 1};
      a = turn_back(r[i], a + cross(dw, p[i]) + cross(w, cross(w, p[i])));
      const V wr = turn_back(r[i], w);
      dw = turn_back(r[i], dw) + dq[i] * cross(wr, z) + ddq[i] * z;
      w = wr + dq[i] * z;
      const V c = {j.link.com_m[0], j.link.com_m[1], j.link.com_m[2]};
      const double* k = j.link.inertia_kg_m2;
      const M inertia = {k[0], k[3], k[4], k[3], k[1], k[5], k[4], k[5], k[2]};
      force[i] = j.link.mass_kg * (a + cross(dw, c) + cross(w, cross(w, c)));
      moment[i] = mul(inertia, dw) + cross(w, mul(inertia, w)) + cross(c, force[i]);
      M next;
      for (int row = 0; row < 3; ++row)
        for (int col = 0; col < 3; ++col)
          next[3 * row + col] =
              base[3 * row] * r[i][col] + base[3 * row + 1] * r[i][3 + col] + base[3 * row + 2] * r[i][6 + col];
      base = next;
    }
    std::array<double, 7> torque{};
    // The push is at the flange's origin, so it has no moment there.
    V f = -1.0 * turn_back(base, push), m{};
    for (unsigned i = n_; i-- > 0;) {
      f = f + force[i];
      m = m + moment[i];
      torque[i] = m[2];
      m = mul(r[i], m) + cross(p[i], mul(r[i], f));
      f = mul(r[i], f);
    }
    return torque;
  }

  // Torques that hold it at rest, in N m.
  std::array<double, 7> holding() const { return torques({}, {}, 9.80665, {}); }

  // One period under the joints' torques and a push on the flange.
  void step(const double* torque, const V& push, double period_s) {
    std::array<std::array<double, 8>, 7> rows{};
    const std::array<double, 7> bias = torques({}, dq, 9.80665, push);
    for (unsigned k = 0; k < n_; ++k) {
      std::array<double, 7> unit{};
      unit[k] = 1;
      const std::array<double, 7> column = torques(unit, {}, 0, {});
      for (unsigned i = 0; i < n_; ++i) rows[i][k] = column[i];
    }
    for (unsigned i = 0; i < n_; ++i) rows[i][7] = torque[i] - bias[i];
    // Gauss; a mass matrix needs no pivots.
    for (unsigned i = 0; i < n_; ++i)
      for (unsigned k = 0; k < n_; ++k) {
        if (k == i) continue;
        const double factor = rows[k][i] / rows[i][i];
        for (unsigned col = i; col < 8; ++col) rows[k][col] -= factor * rows[i][col];
      }
    for (unsigned i = 0; i < n_; ++i) {
      dq[i] += rows[i][7] / rows[i][i] * period_s;
      q[i] += dq[i] * period_s;
    }
  }

 private:
  SpherecalRobot robot_;
  unsigned n_;
};

}  // namespace arm
