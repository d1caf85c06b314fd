#pragma once
#include <vector>
#include "geometry_msgs/msg/twist_stamped.hpp"
namespace trajectory_msgs::msg
{
struct JointTrajectoryPoint { std::vector<double> positions, velocities, accelerations, effort; };
struct JointTrajectory { std_msgs::msg::Header header; std::vector<std::string> joint_names; std::vector<JointTrajectoryPoint> points; };
}
