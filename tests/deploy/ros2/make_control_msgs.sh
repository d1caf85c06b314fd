#!/usr/bin/env bash
# Builds the action FollowJointTrajectory for an environment of rclpy wheels, which have no control_msgs.
#   make_control_msgs.sh FOLDER DISTRIBUTION        FOLDER/DISTRIBUTION is the environment; needs cmake and a C++ compiler
set -euo pipefail
folder=$(realpath "$1") distribution=$2 here=$1/$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
packages=(ament-package python-cmake-module rosidl-{default,core}-{generators,runtime} rosidl-generator-py ament-cmake
    ament-cmake-{core,ros,gtest,gmock,pytest,python,test,version,libraries,include-directories,target-dependencies}
    ament-cmake-export-{definitions,dependencies,include-directories,interfaces,libraries,link-flags,targets})
"$here/bin/pip" install -q catkin_pkg "${packages[@]/#/ros-$distribution-}"

mkdir -p "$work"/{msg,action}
printf '%s\n' 'string name' 'float64 position' 'float64 velocity' 'float64 acceleration' > "$work/msg/JointTolerance.msg"
printf '%s\n' 'string joint_name' 'uint16 component' 'float64 position' 'float64 velocity' 'float64 acceleration' \
    > "$work/msg/JointComponentTolerance.msg"
cat > "$work/action/FollowJointTrajectory.action" <<'ACTION'
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
string error_string
---
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
ACTION
cat > "$work/package.xml" <<'XML'
<package format="3"><name>control_msgs</name><version>5.0.0</version><description>One action of it.</description>
<maintainer email="someone@example.com">nobody</maintainer><license>BSD</license>
<buildtool_depend>ament_cmake</buildtool_depend><depend>action_msgs</depend><depend>trajectory_msgs</depend>
<member_of_group>rosidl_interface_packages</member_of_group></package>
XML
cat > "$work/CMakeLists.txt" <<'CMAKE'
cmake_minimum_required(VERSION 3.16)
project(control_msgs)
foreach(name ament_cmake action_msgs builtin_interfaces std_msgs trajectory_msgs rosidl_default_generators)
  find_package(${name} REQUIRED)
endforeach()
# The wheels name folders of the machine on which they were built.
get_directory_property(targets IMPORTED_TARGETS)
foreach(target ${targets})
  get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
  if(folders)
    set(there "")
    foreach(one ${folders})
      if(NOT one MATCHES "^/opt/python")
        list(APPEND there ${one})
      endif()
    endforeach()
    set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${there}")
  endif()
endforeach()
rosidl_generate_interfaces(control_msgs msg/JointTolerance.msg msg/JointComponentTolerance.msg
  action/FollowJointTrajectory.action DEPENDENCIES action_msgs builtin_interfaces std_msgs trajectory_msgs)
ament_package()
CMAKE
export PATH=$folder/$distribution/bin:$PATH AMENT_PREFIX_PATH=$folder/$distribution
export CMAKE_PREFIX_PATH=$AMENT_PREFIX_PATH LD_LIBRARY_PATH=$AMENT_PREFIX_PATH/lib
export PYTHONPATH=$AMENT_PREFIX_PATH/lib/python3.11/site-packages
cmake -S "$work" -B "$work/build" -DCMAKE_INSTALL_PREFIX="$folder/control_msgs_$distribution" \
    -DPython3_EXECUTABLE="$folder/$distribution/bin/python" -DBUILD_TESTING=OFF > "$work/log" || { cat "$work/log"; exit 1; }
cmake --build "$work/build" >> "$work/log" 2>&1 || { tail -n 50 "$work/log"; exit 1; }
cmake --install "$work/build" > /dev/null
