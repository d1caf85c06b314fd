// The parts of rclcpp that an exported plugin uses: a clock that a test sets, topics that it publishes on.
#pragma once
#include <any>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <string>

namespace builtin_interfaces::msg
{
struct Time { int32_t sec = 0; uint32_t nanosec = 0; };
}
namespace rclcpp
{
struct Duration
{
  int64_t ns = 0;
  double seconds() const { return 1e-9 * static_cast<double>(ns); }
};
struct Time
{
  int64_t ns = 0;
  Time() = default;
  explicit Time(int64_t nanoseconds) : ns(nanoseconds) {}
  explicit Time(const builtin_interfaces::msg::Time & stamp) : ns(int64_t(stamp.sec) * 1000000000 + stamp.nanosec) {}
  int64_t nanoseconds() const { return ns; }
  Duration operator-(const Time & other) const { return {ns - other.ns}; }
};
struct Logger {};
struct SystemDefaultsQoS {};
template <class M> struct Subscription { std::function<void(std::shared_ptr<M>)> callback; };
struct Node
{
  std::string name = "mmnn";
  Time clock{int64_t(1000000000000)};
  std::map<std::string, std::any> topics;
  Time now() const { return clock; }
  Logger get_logger() const { return {}; }
  const char * get_name() const { return name.c_str(); }
  template <class M, class F>
  std::shared_ptr<Subscription<M>> create_subscription(const std::string & topic, SystemDefaultsQoS, F callback)
  {
    topics[topic] = std::function<void(std::shared_ptr<M>)>(callback);
    return std::make_shared<Subscription<M>>();
  }
  template <class M>
  void publish(const std::string & topic, const M & message)
  {
    std::any_cast<std::function<void(std::shared_ptr<M>)>>(topics.at(topic))(std::make_shared<M>(message));
  }
};
}
#define RCLCPP_LOG(level, logger, ...) ((void)(logger), std::fprintf(stderr, level ": " __VA_ARGS__), std::fputc('\n', stderr))
#define RCLCPP_ERROR(logger, ...) RCLCPP_LOG("error", logger, __VA_ARGS__)
#define RCLCPP_WARN(logger, ...) RCLCPP_LOG("warning", logger, __VA_ARGS__)
