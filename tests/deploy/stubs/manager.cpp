// A controller manager, a robot and its operator: one plugin through its life, and what dies when. Arguments are KEY=VALUE.
#include <cstdlib>
#include <map>

#include "plugin.cpp"

using namespace PACKAGE;

namespace
{
std::map<std::string, double> given;

double option(const std::string & name, double otherwise)
{
  const auto found = given.find(name);
  return found == given.end() ? otherwise : found->second;
}

builtin_interfaces::msg::Time stamp(const rclcpp::Time & time)
{
  builtin_interfaces::msg::Time found;
  found.sec = static_cast<int32_t>(time.ns / 1000000000);
  found.nanosec = static_cast<uint32_t>(time.ns % 1000000000);
  return found;
}

struct World  // a base of 112 kg on two wheels, joints with inertia and friction
{
  double x = 0.0, y = 0.0, yaw = 0.0, v = 0.0, w = 0.0;
  std::array<double, N + 1> q{}, qdot{};

  void step(const std::vector<double> & commands, const std::vector<std::string> & kinds, double dt)
  {
    const double force = (commands[0] + commands[1]) / 0.075 - 20.0 * v;
    const double moment = (commands[1] - commands[0]) / 0.075 * 0.171 - 2.0 * w;
    if (kinds[0] == "velocity") {
      v += dt * 20.0 * (0.5 * (commands[0] + commands[1]) * 0.075 - v);
      w += dt * 20.0 * ((commands[1] - commands[0]) * 0.075 / (2.0 * 0.171) - w);
    } else {
      v += dt * force / 112.0;
      w += dt * moment / 8.0;
    }
    x += dt * v * std::cos(yaw);
    y += dt * v * std::sin(yaw);
    yaw += dt * w;
    for (size_t i = 0; i < N; i++) {
      const double one = commands[motors.size() - N + i];
      if (kinds[motors.size() - N + i] == "effort") {
        qdot[i] += dt * (one - qdot[i]) / 1.5;
      } else {
        qdot[i] += dt * 20.0 * (kinds[motors.size() - N + i] == "velocity" ? one - qdot[i] : 10.0 * (one - q[i]) - qdot[i]);
      }
      q[i] += dt * qdot[i];
    }
  }
};
}  // namespace

int main(int argc, char ** argv)
{
  for (int i = 1; i < argc; i++) {
    const std::string one = argv[i];
    given[one.substr(0, one.find('='))] = std::atof(one.substr(one.find('=') + 1).c_str());
  }
  const double never = 1e9, dt = 1.0 / option("rate", 1000.0), begins = option("begins", 0.5);
  const bool feeds = option("feedforward", 0.0) > 0.0, is_chained = option("chained", 0.0) > 0.0;
  Params & parameters = ParamListener::current();
  parameters.feedforward_only = feeds;
  Exported c;
  World world;
  world.yaw = option("yaw", 0.0);
  c.update_rate_ = static_cast<unsigned int>(option("update_rate", 1000.0));
  const rclcpp_lifecycle::State state;
  if (c.on_init() != CallbackReturn::SUCCESS || c.on_configure(state) != CallbackReturn::SUCCESS) {
    return 3;
  }
  auto references = c.export_reference_interfaces();
  c.set_chained_mode(is_chained);
  std::vector<double> commands(motors.size(), 0.0), states(2 * N + 1, 0.0);
  bool is_taken = true;
  const auto activate = [&]() {
    std::vector<hardware_interface::LoanedCommandInterface> out;
    std::vector<hardware_interface::LoanedStateInterface> in;
    const auto claimed = c.command_interface_configuration().names;
    for (size_t j = 0; j < claimed.size(); j++) {
      const auto slash = claimed[j].rfind('/');
      const size_t at = motors.size() - claimed.size() + j;
      out.push_back(hardware_interface::Loaned{claimed[j].substr(0, slash), claimed[j].substr(slash + 1), &commands[at], &is_taken});
    }
    for (size_t i = 0; i < 2 * N; i++) {
      in.push_back({{arm[i / 2], i % 2 ? "velocity" : "position", &states[i], &is_taken}});
    }
    c.assign_interfaces(std::move(out), std::move(in));
    return c.on_activate(state) == CallbackReturn::SUCCESS;
  };
  if (!activate()) {
    return 4;
  }
  auto & node = *c.get_node();
  const auto odometry_every = static_cast<long>(1.0 / (dt * option("odometry_rate", 50.0)) + 0.5);
  bool is_active = true;
  int result = 0;
  nav_msgs::msg::Odometry odometry;
  for (long k = 0; k < static_cast<long>(option("until", 4.0) / dt + 0.5); k++) {
    const double t = static_cast<double>(k) * dt;
    const auto now = [&](const std::string & name) { return std::abs(t - option(name, never)) < 0.5 * dt; };
    node.clock.ns += static_cast<int64_t>(1e9 * dt);
    if (k % odometry_every == 0 && t < option("odometry_dies", never)) {
      if (t < option("odometry_repeats", never)) {
        odometry.header.stamp = stamp(rclcpp::Time(node.clock.ns + static_cast<int64_t>(1e9 * option("odometry_ahead", 0.0))));
        odometry.pose.pose.position.x = t < option("odometry_nan", never) ? world.x : std::nan("");
        odometry.pose.pose.position.y = world.y;
        odometry.pose.pose.orientation.w = std::cos(0.5 * world.yaw);
        odometry.pose.pose.orientation.z = std::sin(0.5 * world.yaw);
        odometry.twist.twist.linear.x = world.v;
        odometry.twist.twist.angular.z = world.w;
      }
      node.publish("~/odom", odometry);
    }
    const double wave = std::sin(2.0 * (t - begins));
    const bool has_base = t > begins && t < option("velocity_dies", never), has_arm = t > begins && t < option("arm_dies", never);
    std::vector<double> q(N), qdot(N), qddot(N);
    for (size_t i = 0; i < N; i++) {
      const double size = option("arm", 0.3);
      q[i] = size * (1.0 - std::cos(2.0 * (t - begins)));
      qdot[i] = 2.0 * size * wave;
      qddot[i] = 4.0 * size * std::cos(2.0 * (t - begins));
    }
    if (is_chained && !feeds) {
      for (size_t i = 0; i < N; i++) {
        *references[3 * i].value = has_arm ? q[i] : unset;
        *references[3 * i + 1].value = has_arm ? qdot[i] : unset;
        *references[3 * i + 2].value = has_arm ? qddot[i] : unset;
      }
      *references[3 * N].value = has_base ? option("v", 0.3) : unset;
      *references[3 * N + 1].value = has_base ? option("w", 0.0) : unset;
    } else {
      if (has_base && k % 20 == 0) {
        geometry_msgs::msg::TwistStamped message;
        message.header.stamp = stamp(rclcpp::Time(node.clock.ns - static_cast<int64_t>(1e9 * option("velocity_age", 0.0))));
        message.twist.linear.x = option("v", 0.3);
        message.twist.angular.z = option("w", 0.0);
        node.publish("~/cmd_vel", message);
      }
      if (has_arm && k % 5 == 0) {
        trajectory_msgs::msg::JointTrajectory message;
        control_msgs::msg::JointTrajectoryControllerState told;
        message.joint_names.assign(arm.rbegin(), arm.rend());  // any order
        message.points.resize(1);
        message.points[0].positions.assign(q.rbegin(), q.rend());
        message.points[0].velocities.assign(qdot.rbegin(), qdot.rend());
        message.points[0].accelerations.assign(qddot.rbegin(), qddot.rend());
        told.joint_names = message.joint_names;
        told.reference = message.points[0];
        if (feeds) {
          node.publish("~/jtc_state", told);
        } else {
          node.publish("~/joint_reference", message);
        }
      }
    }
    for (size_t i = 0; i < N; i++) {
      states[2 * i] = t < option("joint_nan", never) ? world.q[i] : unset;
      states[2 * i + 1] = world.qdot[i];
      if (feeds) {  // a PD with gravity left to the feed-forward, as a joint_trajectory_controller before us
        *references[i].value = has_arm || t <= begins ? 40.0 * ((t > begins ? q[i] : 0.0) - world.q[i]) + 15.0 * ((t > begins ? qdot[i] : 0.0) - world.qdot[i]) : 0.0;
      }
    }
    is_taken = t < option("hardware_refuses", never);
    if (now("gain")) {
      parameters.gains.feedback[0] *= option("gain_by", 0.5);
      ParamListener::version()++;
    }
    if (now("deactivate") && is_active) {
      is_active = false;
      result = c.on_deactivate(state) == CallbackReturn::SUCCESS ? 0 : 5;
    }
    if (now("activate")) {
      is_active = activate();
    }
    if (is_active && c.update(node.clock, {static_cast<int64_t>(1e9 * dt)}) != return_type::OK) {
      result = 1;
#if !defined(MMNN_HUMBLE)
      is_active = false;  // newer managers deactivate it
      c.on_deactivate(state);
#endif
    }
    std::printf("%.4f %.9g %.9g %.9g %.9g %.9g", t, world.x, world.y, world.yaw, world.v, world.w);
    for (size_t i = 0; i < N; i++) {
      std::printf(" %.9g %.9g", world.q[i], q[i]);
    }
    for (const double one : commands) {
      std::printf(" %.17g", one);
    }
    for (size_t i = 0; i < N; i++) {
      std::printf(" %.17g", feeds ? *references[i].value : 0.0);
    }
    std::printf(" %d\n", result);
    world.step(commands, motor_interfaces, dt);
  }
  return 0;
}
