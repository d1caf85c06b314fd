// What an exported plugin needs of ros2_control, as the branches humble (0941f73c), jazzy (9ffbf97f), kilted (cbe7d2c3) and
// master (53b9999d) declare it. MMNN_HUMBLE: values by get_value(), void set_value(), an update of references without arguments.
#pragma once
#include <cmath>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>
#include "rclcpp/rclcpp.hpp"

namespace rclcpp_lifecycle
{
struct State {};
using LifecycleNode = rclcpp::Node;
}
namespace hardware_interface
{
struct Handle
{
  std::string prefix, name;
  double * value;
  Handle(const std::string & prefix_name, const std::string & interface_name, double * value_ptr)
  : prefix(prefix_name), name(interface_name), value(value_ptr) {}
  std::string get_name() const { return prefix + "/" + name; }
};
struct CommandInterface : Handle
{
#if !defined(MMNN_HUMBLE)
  [[deprecated("Use InterfaceDescription for initializing the Interface")]]
#endif
  CommandInterface(const std::string & prefix, const std::string & name, double * value) : Handle(prefix, name, value) {}
  CommandInterface(const CommandInterface &) = delete;
  CommandInterface(CommandInterface &&) = default;
};
struct Loaned
{
  std::string prefix, interface;
  double * value;
  bool * is_taken;
  std::string get_name() const { return prefix + "/" + interface; }
  const std::string & get_interface_name() const { return interface; }
#if defined(MMNN_HUMBLE)
  double get_value() const { return *value; }
#else
  template <class T = double>
  [[nodiscard]] std::optional<T> get_optional(unsigned int = 10) const
  {
    return std::isnan(*value) ? std::nullopt : std::optional<T>(*value);
  }
#endif
};
struct LoanedStateInterface : Loaned {};
struct LoanedCommandInterface : Loaned
{
  LoanedCommandInterface(Loaned && loaned) : Loaned(std::move(loaned)) {}
  LoanedCommandInterface(const LoanedCommandInterface &) = delete;
  LoanedCommandInterface(LoanedCommandInterface &&) = default;
#if defined(MMNN_HUMBLE)
  void set_value(double x) { *value = x; }
#else
  template <class T>
  [[nodiscard]] bool set_value(const T & x, unsigned int = 10)
  {
    if (*is_taken) {
      *value = x;
    }
    return *is_taken;
  }
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
  interface_configuration_type type = interface_configuration_type::NONE;
  std::vector<std::string> names = {};
};
class ChainableControllerInterface
{
public:
  virtual ~ChainableControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
  virtual CallbackReturn on_error(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return node_; }
  unsigned int get_update_rate() const { return update_rate_; }

  // As chainable_controller_interface.cpp has it.
  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period)
  {
    if (!in_chained_mode_) {
#if defined(MMNN_HUMBLE)
      const auto found = update_reference_from_subscribers();
#else
      const auto found = update_reference_from_subscribers(time, period);
#endif
      if (found != return_type::OK) {
        return found;
      }
    }
    return update_and_write_commands(time, period);
  }

  std::vector<hardware_interface::CommandInterface> export_reference_interfaces()
  {
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wdeprecated-declarations"
    auto found = on_export_reference_interfaces();
#pragma GCC diagnostic pop
    if (found.size() != reference_interfaces_.size()) {
      throw std::runtime_error("as many references as exported interfaces are expected");
    }
    for (const auto & one : found) {
      if (one.prefix != node_->get_name()) {
        throw std::runtime_error("an interface that does not begin with the controller's name");
      }
    }
    return found;
  }

  bool set_chained_mode(bool chained)
  {
    in_chained_mode_ = on_set_chained_mode(chained) && chained;
    return true;
  }

  void assign_interfaces(
    std::vector<hardware_interface::LoanedCommandInterface> && commands,
    std::vector<hardware_interface::LoanedStateInterface> && states)
  {
    command_interfaces_ = std::move(commands);
    state_interfaces_ = std::move(states);
  }

  unsigned int update_rate_ = 0;  // of the parameter; 0 in Humble where it is not given

protected:
#if !defined(MMNN_HUMBLE)
  [[deprecated("Replaced by on_export_reference_interfaces_list() method.")]]
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() { return {}; }
  virtual return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) = 0;
#else
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
  virtual return_type update_reference_from_subscribers() = 0;
#endif
  virtual bool on_set_chained_mode(bool) { return true; }
  virtual return_type update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;
  std::vector<double> reference_interfaces_;

private:
  bool in_chained_mode_ = false;
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>();
};
}
