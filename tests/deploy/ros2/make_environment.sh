#!/usr/bin/env bash
# Makes an environment with rclpy from wheels, this package, and what those wheels lack: the messages of the actions
# FollowJointTrajectory and FollowPath, of the controller's state and of /tf, which are built.
#   make_environment.sh FOLDER DISTRIBUTION        FOLDER/kilted or FOLDER/jazzy; needs cmake and a C++ compiler
set -euo pipefail
distribution=$2 root=$(cd "$(dirname "$0")/../../.." && pwd)
python3 -m venv "$1/$distribution"
here=$(realpath "$1/$distribution") work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$here/bin/pip" install -q "ros-$distribution-rclpy[fastrtps]" "ros-$distribution-std-srvs" \
    "ros-$distribution-"{sensor,nav,geometry,trajectory,diagnostic}-msgs
"$here/bin/pip" install -q -e "$root[tasks,robots,contact]" foxglove-sdk websockets
packages=(ament-package rosidl-{default,core}-{generators,runtime} rosidl-generator-py ament-cmake
    ament-cmake-{core,ros,gtest,gmock,pytest,python,test,version,libraries,include-directories,target-dependencies}
    ament-cmake-export-{definitions,dependencies,include-directories,interfaces,libraries,link-flags,targets})
more=(ros-jazzy-python-cmake-module)
[ "$distribution" = jazzy ] || more=(ros-python-cmake-module ros-ament-cmake-ros-core)
"$here/bin/pip" install -q catkin_pkg "${more[@]}" "${packages[@]/#/ros-$distribution-}"
site=$("$here/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
export PATH=$here/bin:$PATH AMENT_PREFIX_PATH=$here CMAKE_PREFIX_PATH=$here LD_LIBRARY_PATH=$here/lib

# build NAME DEPENDENCIES FILES: the package NAME out of the files in $work/NAME, into the environment
build() {
    local name=$1 dependencies=$2 files=$3 one
    cat > "$work/$name/package.xml" <<XML
<package format="3"><name>$name</name><version>5.0.0</version><description>Some of its messages.</description>
<maintainer email="someone@example.com">nobody</maintainer><license>BSD</license>
<buildtool_depend>ament_cmake</buildtool_depend>$(for one in $dependencies; do echo "<depend>$one</depend>"; done)
<member_of_group>rosidl_interface_packages</member_of_group></package>
XML
    cat > "$work/$name/CMakeLists.txt" <<CMAKE
cmake_minimum_required(VERSION 3.16)
project($name)
foreach(name ament_cmake $dependencies rosidl_default_generators)
  find_package(\${name} REQUIRED)
endforeach()
# The wheels name folders of the machine on which they were built.
get_directory_property(targets IMPORTED_TARGETS)
foreach(target \${targets})
  get_target_property(folders \${target} INTERFACE_INCLUDE_DIRECTORIES)
  if(folders)
    list(FILTER folders EXCLUDE REGEX "^/opt/python")
    set_target_properties(\${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "\${folders}")
  endif()
endforeach()
rosidl_generate_interfaces($name $files DEPENDENCIES $dependencies)
ament_package()
CMAKE
    cmake -S "$work/$name" -B "$work/$name/build" -DCMAKE_INSTALL_PREFIX="$here" -DPYTHON_INSTALL_DIR="$site" \
        -DPython3_EXECUTABLE="$here/bin/python" -DBUILD_TESTING=OFF > "$work/log" 2>&1 || { cat "$work/log"; exit 1; }
    cmake --build "$work/$name/build" >> "$work/log" 2>&1 || { tail -n 50 "$work/log"; exit 1; }
    cmake --install "$work/$name/build" > /dev/null
}

mkdir -p "$work"/control_msgs/{msg,action} "$work"/nav2_msgs/action "$work"/tf2_msgs/msg
printf '%s\n' 'string name' 'float64 position' 'float64 velocity' 'float64 acceleration' > "$work/control_msgs/msg/JointTolerance.msg"
printf '%s\n' 'string joint_name' 'uint16 component' 'float64 position' 'float64 velocity' 'float64 acceleration' \
    > "$work/control_msgs/msg/JointComponentTolerance.msg"
echo 'float64 factor' > "$work/control_msgs/msg/SpeedScalingFactor.msg"
{
    printf '%s\n' 'std_msgs/Header header' 'string[] joint_names'
    printf 'trajectory_msgs/JointTrajectoryPoint %s\n' reference feedback error output
    echo 'string[] multi_dof_joint_names'
    printf 'trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_%s\n' reference feedback error output
} > "$work/control_msgs/msg/JointTrajectoryControllerState.msg"
cat > "$work/control_msgs/action/FollowJointTrajectory.action" <<'ACTION'
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
said=$([ "$distribution" = jazzy ] || echo 'string error_msg')
cat > "$work/nav2_msgs/action/FollowPath.action" <<ACTION
nav_msgs/Path path
string controller_id
string goal_checker_id
string progress_checker_id
---
std_msgs/Empty result
uint16 error_code
$said
---
float32 distance_to_goal
float32 speed
ACTION
echo 'geometry_msgs/TransformStamped[] transforms' > "$work/tf2_msgs/msg/TFMessage.msg"
build control_msgs "action_msgs builtin_interfaces std_msgs trajectory_msgs" \
    "msg/JointTolerance.msg msg/JointComponentTolerance.msg msg/SpeedScalingFactor.msg
    msg/JointTrajectoryControllerState.msg action/FollowJointTrajectory.action"
build nav2_msgs "action_msgs nav_msgs std_msgs" "action/FollowPath.action"
build tf2_msgs "geometry_msgs" "msg/TFMessage.msg"
