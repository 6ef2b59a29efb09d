// A Cartesian spring on the effort interfaces of an arm. See README.md.
#include <array>
#include <cmath>
#include <cstdio>
#include <exception>
#include <memory>
#include <string>
#include <vector>

#include "controller_interface/controller_interface.hpp"
#include "geometry_msgs/msg/pose_stamped.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/rclcpp.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "realtime_tools/realtime_buffer.hpp"
#include "std_msgs/msg/float64_multi_array.hpp"

#include "spherecal_law.h"

namespace spherecal {

using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::return_type;

class ImpedanceController : public controller_interface::ControllerInterface {
 public:
  CallbackReturn on_init() override {
    try {
      auto_declare<std::string>("robot", "fr3");
      auto_declare<std::vector<std::string>>("joints", {});
      auto_declare<bool>("gravity_by_drive", false);
      auto_declare<bool>("torque_loop", true);
      auto_declare<double>("latency_s", 0.0);
      auto_declare<std::vector<double>>("tcp_m", {0.0, 0.0, 0.0});
      auto_declare<double>("tool_mass_kg", 0.0);
      auto_declare<std::vector<double>>("tool_com_m", {0.0, 0.0, 0.0});
      auto_declare<double>("translation_n_m", 400.0);
      auto_declare<double>("rotation_nm_rad", 30.0);
      auto_declare<double>("energy_j", 0.0);
    } catch (const std::exception& error) {
      std::fprintf(stderr, "spherecal: %s\n", error.what());
      return CallbackReturn::ERROR;
    }
    return CallbackReturn::SUCCESS;
  }

  InterfaceConfiguration command_interface_configuration() const override { return claim({"effort"}); }

  InterfaceConfiguration state_interface_configuration() const override {
    return claim({"position", "velocity", "effort"});
  }

  // Here memory is allocated; `update` allocates none.
  CallbackReturn on_configure(const rclcpp_lifecycle::State&) override {
    const auto node = get_node();
    joints_ = node->get_parameter("joints").as_string_array();
    const std::string name = node->get_parameter("robot").as_string();
    SpherecalRobot robot{};
    SpherecalLaw law{};
    if (!done(spherecal_robot_built_in(name.c_str(), &robot), "robot") || !done(spherecal_law_default(&law), "law")) {
      return CallbackReturn::ERROR;
    }
    const auto tcp = node->get_parameter("tcp_m").as_double_array();
    const auto com = node->get_parameter("tool_com_m").as_double_array();
    if (robot.joints != joints_.size() || tcp.size() != 3 || com.size() != 3) {
      RCLCPP_ERROR(node->get_logger(), "give the %u names of the joints, and three numbers for tcp_m and tool_com_m", robot.joints);
      return CallbackReturn::ERROR;
    }
    SpherecalTool tool{};
    tool.body.mass_kg = node->get_parameter("tool_mass_kg").as_double();
    for (size_t i = 0; i < 3; ++i) {
      tool.tcp_m[i] = tcp[i];
      tool.body.com_m[i] = com[i];
    }
    SpherecalDrive drive{};
    drive.latency_s = node->get_parameter("latency_s").as_double();
    drive.carries_gravity = node->get_parameter("gravity_by_drive").as_bool() ? 1 : 0;
    if (!node->get_parameter("torque_loop").as_bool()) law.torque_loop_gain = 0;
    SpherecalLoop* made = nullptr;
    if (!done(spherecal_loop_new(&robot, &tool, &law, &drive, 1.0 / get_update_rate(), &made), "loop")) return CallbackReturn::ERROR;
    loop_.reset(made);
    const double energy = node->get_parameter("energy_j").as_double();
    if (energy > 0 && !done(spherecal_loop_limit_energy(made, energy, 0.0), "energy_j")) return CallbackReturn::ERROR;
    spring_ = SpherecalSpring{};
    for (size_t i = 0; i < 3; ++i) {
      spring_.translation_n_m[4 * i] = node->get_parameter("translation_n_m").as_double();
      spring_.rotation_nm_rad[4 * i] = node->get_parameter("rotation_nm_rad").as_double();
    }
    if (!done(spherecal_loop_set_stiffness(made, &spring_), "stiffness")) return CallbackReturn::ERROR;

    const auto quality = rclcpp::SystemDefaultsQoS();
    target_ = node->create_subscription<geometry_msgs::msg::PoseStamped>(
        "~/target", quality, [this](const geometry_msgs::msg::PoseStamped::SharedPtr message) { take(message->pose); });
    // 18 numbers: translation, then rotation, row by row.
    stiffness_ = node->create_subscription<std_msgs::msg::Float64MultiArray>(
        "~/stiffness", quality, [this](const std_msgs::msg::Float64MultiArray::SharedPtr message) { take(*message); });
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State&) override {
    // Held where the first state finds it; what was asked for before is forgotten.
    new_pose_.writeFromNonRT(Asked<SpherecalPose>{});
    new_spring_.writeFromNonRT(Asked<SpherecalSpring>{});
    pose_number_ = spring_number_ = 0;
    return done(spherecal_loop_reset(loop_.get()), "reset") ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;
  }

  CallbackReturn on_deactivate(const rclcpp_lifecycle::State&) override {
    for (auto& command : command_interfaces_) (void)command.set_value(0.0);
    return CallbackReturn::SUCCESS;
  }

  return_type update(const rclcpp::Time&, const rclcpp::Duration&) override {
    const auto& spring = *new_spring_.readFromRT();
    if (spring.number != spring_number_) {
      spring_number_ = spring.number;
      // One that is no spring is refused, and the last one stays.
      (void)spherecal_loop_set_stiffness(loop_.get(), &spring.value);
    }
    const auto& pose = *new_pose_.readFromRT();
    if (pose.number != pose_number_) {
      pose_number_ = pose.number;
      (void)spherecal_loop_set_pose(loop_.get(), &pose.value);
    }
    // The order is that of `claim`: all interfaces of a kind, joint by joint.
    const size_t n = joints_.size();
    SpherecalState state{};
    for (size_t i = 0; i < n; ++i) {
      state.q_rad[i] = read(i);
      state.dq_rad_s[i] = read(n + i);
      state.tau_nm[i] = read(2 * n + i);
    }
    SpherecalOutput out{};
    if (spherecal_loop_step(loop_.get(), &state, &out) != SPHERECAL_STATUS_OK) return return_type::ERROR;
    for (size_t i = 0; i < n; ++i) (void)command_interfaces_[i].set_value(out.torque_nm[i]);
    return return_type::OK;
  }

 private:
  struct Free {
    void operator()(SpherecalLoop* control) const { spherecal_loop_free(control); }
  };
  template <typename T>
  struct Asked {
    unsigned number = 0;
    T value{};
  };

  double read(size_t i) const { return state_interfaces_[i].get_optional().value_or(std::nan("")); }

  InterfaceConfiguration claim(const std::vector<std::string>& kinds) const {
    InterfaceConfiguration configuration{controller_interface::interface_configuration_type::INDIVIDUAL, {}};
    for (const auto& kind : kinds)
      for (const auto& joint : get_node()->get_parameter("joints").as_string_array())
        configuration.names.push_back(joint + "/" + kind);
    return configuration;
  }

  bool done(SpherecalStatus status, const char* what) const {
    if (status != SPHERECAL_STATUS_OK)
      RCLCPP_ERROR(get_node()->get_logger(), "%s: %s", what, spherecal_status_text(status));
    return status == SPHERECAL_STATUS_OK;
  }

  void take(const geometry_msgs::msg::Pose& pose) {
    const auto& q = pose.orientation;
    const double norm = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    if (!(norm > 0.5)) {
      RCLCPP_WARN(get_node()->get_logger(), "a target without an orientation is ignored");
      return;
    }
    const double x = q.x / norm, y = q.y / norm, z = q.z / norm, w = q.w / norm;
    Asked<SpherecalPose> asked;
    asked.number = ++poses_;
    asked.value = SpherecalPose{{pose.position.x, pose.position.y, pose.position.z},
                                {1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
                                 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
                                 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)},
                                {},
                                {}};
    new_pose_.writeFromNonRT(asked);
  }

  void take(const std_msgs::msg::Float64MultiArray& message) {
    if (message.data.size() != 18) {
      RCLCPP_WARN(get_node()->get_logger(), "a stiffness has 18 numbers");
      return;
    }
    Asked<SpherecalSpring> asked;
    asked.number = ++springs_;
    for (size_t i = 0; i < 9; ++i) {
      asked.value.translation_n_m[i] = message.data[i];
      asked.value.rotation_nm_rad[i] = message.data[9 + i];
    }
    new_spring_.writeFromNonRT(asked);
  }

  std::vector<std::string> joints_;
  std::unique_ptr<SpherecalLoop, Free> loop_;
  SpherecalSpring spring_{};
  rclcpp::Subscription<geometry_msgs::msg::PoseStamped>::SharedPtr target_;
  rclcpp::Subscription<std_msgs::msg::Float64MultiArray>::SharedPtr stiffness_;
  realtime_tools::RealtimeBuffer<Asked<SpherecalPose>> new_pose_;
  realtime_tools::RealtimeBuffer<Asked<SpherecalSpring>> new_spring_;
  unsigned poses_ = 0, springs_ = 0, pose_number_ = 0, spring_number_ = 0;
};

}  // namespace spherecal

PLUGINLIB_EXPORT_CLASS(spherecal::ImpedanceController, controller_interface::ControllerInterface)
