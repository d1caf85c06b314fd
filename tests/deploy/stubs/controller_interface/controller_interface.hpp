// The parts of ros2_control that an exported plugin uses, in both flavours, to compile it without ROS 2.
#pragma once
#include <memory>
#include <optional>
#include <string>
#include <vector>
#include "rclcpp/rclcpp.hpp"

namespace rclcpp_lifecycle
{
struct State {};
}
namespace hardware_interface
{
struct LoanedStateInterface
{
#ifdef MMNN_GET_OPTIONAL
  std::optional<double> get_optional() const { return 0.0; }
#else
  double get_value() const { return 0.0; }
#endif
};
struct LoanedCommandInterface
{
#ifdef MMNN_GET_OPTIONAL
  [[nodiscard]] bool set_value(const double &) { return true; }
#else
  void set_value(double) {}
#endif
};
}
namespace controller_interface
{
enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };
struct InterfaceConfiguration
{
  interface_configuration_type type;
  std::vector<std::string> names = {};
};
class ControllerInterface
{
public:
  virtual ~ControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual return_type update(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) = 0;
  std::shared_ptr<rclcpp::Node> get_node() { return std::make_shared<rclcpp::Node>(); }

protected:
  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;
};
}
