// Times Pinocchio's C++ on the iiwa 7: frames and Jacobian; and with them gravity
// and mass matrix. Prints JSON, least ns of a call. `scripts/speed` compiles it.
//
// The model comes as lines of numbers on standard input, made from
// tests/data/iiwa7.json by speed.py, one for each joint and the last for the
// tool: alpha a d, mass, centre of mass (3), inertia about it (xx yy zz xy xz yz).
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/multibody.hpp>

namespace pin = pinocchio;

template <typename F> double least_ns(F &&call) {
    double least = std::numeric_limits<double>::infinity();
    const auto begin = std::chrono::steady_clock::now();
    while (std::chrono::steady_clock::now() - begin < std::chrono::milliseconds(1500)) {
        const auto from = std::chrono::steady_clock::now();
        for (int k = 0; k < 1000; ++k) call(k);
        const std::chrono::duration<double, std::nano> time = std::chrono::steady_clock::now() - from;
        least = std::min(least, time.count() / 1000);
    }
    return least;
}

int main() {
    pin::Model model;
    double v[13];
    pin::JointIndex last = 0;
    for (int row = 0;; ++row) {
        int read = 0;
        while (read < 13 && std::scanf("%lf", &v[read]) == 1) ++read;
        if (read < 13) break;
        Eigen::Matrix3d inertia;
        inertia << v[7], v[10], v[11], v[10], v[8], v[12], v[11], v[12], v[9];
        const pin::Inertia body(v[3], Eigen::Vector3d(v[4], v[5], v[6]), inertia);
        if (row < 7) {
            const Eigen::Matrix3d turn = Eigen::AngleAxisd(v[0], Eigen::Vector3d::UnitX()).toRotationMatrix();
            const Eigen::Vector3d shift(v[1], -std::sin(v[0]) * v[2], std::cos(v[0]) * v[2]);
            last = model.addJoint(last, pin::JointModelRZ(), pin::SE3(turn, shift), "joint" + std::to_string(row + 1));
        }
        model.appendBodyToJoint(last, body, pin::SE3::Identity());
    }
    if (model.nv != 7) {
        std::fprintf(stderr, "%d joints, not 7\n", model.nv);
        return 1;
    }
    pin::Data data(model);
    std::mt19937 random(1);
    std::uniform_real_distribution<double> angle(-1.5, 1.5);
    std::vector<Eigen::VectorXd> q(16, Eigen::VectorXd(7));
    for (auto &v : q)
        for (int i = 0; i < 7; ++i) v[i] = angle(random);
    pin::Data::Matrix6x jacobian(6, 7);
    double sink = 0;
    const auto kinematics = [&](int k) {
        pin::computeJointJacobians(model, data, q[k % 16]);
        pin::getJointJacobian(model, data, 7, pin::LOCAL_WORLD_ALIGNED, jacobian);
        sink += jacobian(0, 3);
    };
    const auto all = [&](int k) {
        kinematics(k);
        sink += pin::computeGeneralizedGravity(model, data, q[k % 16])[1];
        sink += pin::crba(model, data, q[k % 16], pin::Convention::WORLD)(1, 1);
    };
    const double first = least_ns(kinematics), second = least_ns(all);
    // For speed.py: the same arm at the bench's configuration.
    Eigen::VectorXd at(7);
    at << 0.3, 0.6, -0.2, -1.2, 0.4, 0.9, 0.1;
    const double gravity = pin::computeGeneralizedGravity(model, data, at)[1];
    std::printf("{\"kinematics\": %.1f, \"all\": %.1f, \"gravity2_nm\": %.12f}\n", first, second, gravity);
    return sink == 0.123 ? 1 : 0;
}
