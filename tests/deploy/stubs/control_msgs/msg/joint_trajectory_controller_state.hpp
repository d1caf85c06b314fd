#pragma once
#include "trajectory_msgs/msg/joint_trajectory.hpp"
namespace control_msgs::msg
{
struct JointTrajectoryControllerState
{
  std_msgs::msg::Header header;
  std::vector<std::string> joint_names;
  trajectory_msgs::msg::JointTrajectoryPoint reference, feedback, error, output;
};
}
