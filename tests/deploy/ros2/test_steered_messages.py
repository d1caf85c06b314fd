"""Bases that steer in messages: joint states and odometry to a measurement, commands to a car's own controller."""

from __future__ import annotations

import math

import numpy as np
import plain_messages as msg
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import load
from mmnn_pin.deploy.ros2.drivers import driver_of
from mmnn_pin.deploy.ros2.example import commands_of
from mmnn_pin.deploy.ros2.sensing import Sensing, Tree
from mmnn_pin.deploy.ros2.settings import ACKERMANN, TWIST_STAMPED, Node, Odometry, Output
from mmnn_pin.deploy.ros2.wiring import ackermann, controllers, interfaces, topic_of
from mmnn_pin.errors import ConfigError

ROBOTS = {name: load(name) for name in ("car_arm", "swerve_arm", "truck_trailer_arm", "casters_arm")}
NOW = msg.Header(msg.Time(), "odom")


def told(name: str, source: str, angles: list[float], speed: float):
    """A robot's measurement out of messages of a state, and the state."""
    robot = ROBOTS[name]
    d, position = robot.dimensions, robot.neutral_position()
    position[robot.shape_index] = np.resize(angles, d.shape)
    robot.follow(position)
    nu = speed * np.linspace(1.0, 0.3, d.dof)
    velocity = robot.T_at(position) @ nu
    node = Node(name, {"a": Output(joints=robot.actuator_names)}, odometry=Odometry(source=source, at=(0.0, 0.0, 0.0)))  # type: ignore[arg-type]
    sensing = Sensing(robot, node, Tree())
    names = list(robot.full_velocity_names[3:])
    states = msg.JointState(NOW, names, position[3:].tolist(), velocity[3:].tolist(), [])
    vx, vy, w = robot.base.to_control @ velocity[:3]
    turn = msg.Quaternion(0.0, 0.0, 0.0, 1.0)
    if source == "odometry":
        pose = msg.PoseWithCovariance(msg.Pose(msg.Point(1.0, 2.0), turn), [0.0] * 36)
        twist = msg.TwistWithCovariance(msg.Twist(msg.Vector3(vx, vy), msg.Vector3(z=w)), [0.0] * 36)
        assert sensing.take_base(msg.Odometry(NOW, "x", pose, twist), 0.0) == ""
    else:
        sensing.tree.parents["base_footprint"] = ("odom", (1.0, 2.0, 0.0), 0.0)
    assert sensing.take_joints(states, 0.0) == ""
    return sensing.measurement(), position, nu


@settings(deadline=None, max_examples=40)
@given(
    st.sampled_from(sorted(ROBOTS)),
    st.sampled_from(["odometry", "tf"]),
    st.lists(st.floats(-0.4, 0.4), min_size=4, max_size=4),
    st.floats(-1.0, 1.0),
)
def test_joint_states_and_odometry_are_the_state(name: str, source: str, angles: list[float], speed: float) -> None:
    if name == "swerve_arm":
        angles = [angles[0]] * 4  # its axles meet
    m, position, nu = told(name, source, angles, speed)
    robot = ROBOTS[name]
    assert m is not None and m.pose.tolist() == [1.0, 2.0, 0.0]
    np.testing.assert_array_equal(m.shape, position[robot.shape_index])
    np.testing.assert_allclose(m.velocity, nu[: robot.dimensions.base], atol=1e-9)
    np.testing.assert_allclose(m.qdot, nu[robot.dimensions.base :], atol=1e-12)


def test_u_is_counted_as_the_stepper_counts_it() -> None:
    robot = ROBOTS["swerve_arm"]
    node = Node("swerve_arm", {"a": Output(joints=robot.actuator_names)}, odometry=Odometry(at=(0.0, 0.0, 0.0)))
    sensing = Sensing(robot, node, Tree())
    sensing.velocity[:], sensing.is_new, sensing.placed = (0.5, 0.0, 0.0), True, 0.0
    sensing.heard[:] = 0.0
    for direction in (1.0, -1.0):
        m = sensing.measurement(np.array([direction, 0.0, 0.0]))
        assert m is not None and m.velocity[0] == pytest.approx(0.5 * direction)
        sensing.is_new = True


@given(st.floats(-3.0, 3.0), st.floats(-2.0, 2.0), st.sampled_from([0.5, 2.0, -1.2]))
def test_a_car_drives_the_curvature_that_it_is_told(v: float, w: float, wheelbase: float) -> None:
    speed, angle = ackermann(np.array([v, w]), wheelbase, 0.25)
    assert speed == v and abs(angle) <= math.pi / 2
    if abs(v) > 0.01:
        assert v * math.tan(angle) / wheelbase == pytest.approx(w, abs=1e-9)
    if v == w == 0.0:
        assert angle == 0.25


def test_commands_for_a_cars_own_controller() -> None:
    robot = ROBOTS["car_arm"]
    arm = {"arm": Output(joints=robot.joint_names)}
    for kind in (ACKERMANN, TWIST_STAMPED):
        node = Node("car_arm", {"drive": Output(kind)} | arm)
        found = interfaces(robot, node)
        assert {found[name] for name in robot.base.driven} == {"velocity"}
    assert topic_of(robot, "drive", Output(ACKERMANN)) == "drive/ackermann_cmd"
    assert topic_of(robot, "drive", Output(TWIST_STAMPED)) == "drive/reference"
    driver = driver_of(robot.base)
    assert driver is not None and driver.name == "ackermann_steering_controller"
    with pytest.raises(ConfigError, match="parameters of steering controllers are not written"):
        controllers(robot, Node("car_arm", {"drive": Output(TWIST_STAMPED)} | arm))
    with pytest.raises(ConfigError, match="an AckermannDriveStamped for a base of kind 'swerve'"):
        swerve = ROBOTS["swerve_arm"]
        interfaces(swerve, Node("s", {"d": Output(ACKERMANN), "a": Output(joints=swerve.joint_names)}))


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_the_example_commands_every_motor(name: str) -> None:
    robot = ROBOTS[name]
    node = Node(name, commands_of(robot))
    assert set(interfaces(robot, node)) == set(robot.actuator_names)
    assert "drive_controller: {type: forward_command_controller" in controllers(robot, node)
