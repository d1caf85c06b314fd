"""Joints that nothing drives where the file drives others have no motor: named, locked, freed where the user says so.

The second answer is the list of names that the test itself has written into a transmission, a command interface or a
plugin, each by one of the ways in which files of robots do it.
"""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest
from drives import Drive, joint, link, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from test_arm import chain, mimic, two_armed
from test_base import three

from mmnn_pin.errors import ConfigError, RobotError
from mmnn_pin.model import Robot
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.urdf.finding import AuditError

NAMES = [f"{side}_joint_{i}" for side in ("left", "right") for i in range(4)]
PLUGIN = '<gazebo><plugin filename="{file}" name="p">{inside}</plugin></gazebo>'


def transmission(name: str) -> str:
    return f'<transmission name="t_{name}"><joint name="{name}"/><actuator name="m_{name}"/></transmission>'


def of_pr2(name: str) -> str:
    return f'<transmission name="t_{name}"><flexJoint name="{name}" mechanicalReduction="1"/></transmission>'


def commanded(name: str) -> str:
    control = f'<joint name="{name}"><command_interface name="effort"/><state_interface name="position"/></joint>'
    return f'<ros2_control name="c_{name}" type="system">{control}</ros2_control>'


def by_plugin(name: str) -> str:
    return PLUGIN.format(file="gz-sim-joint-controller-system", inside=f"<joint_name>{name}</joint_name>")


def read(names: list[str]) -> str:
    """What only reads joints: states, and a plugin that publishes them."""
    states = "".join(f'<joint name="{name}"><state_interface name="position"/></joint>' for name in names)
    told = "".join(f"<joint_name>{name}</joint_name>" for name in names)
    publisher = PLUGIN.format(file="gz-sim-joint-state-publisher-system", inside=told)
    return f'<ros2_control name="s" type="sensor">{states}</ros2_control>{publisher}'


WAYS = (transmission, of_pr2, commanded, by_plugin)


def robot(more: str, **said) -> Robot:
    arms = chain("left", 4, "base", (0, 0.2, 0.3)) + chain("right", 4, "base", (0, -0.2, 0.3))
    return robot_of(Drive(names=("wl", "wr")).urdf(arms + more), **said)


def told(found: Robot) -> list[str]:
    """The joints that findings call without a motor."""
    texts = [f.message for f in found.findings if f.code == "arm-passive"]
    return [name for text in texts for name in re.findall(r"\w+_joint_\d", text)]


@given(st.lists(st.sampled_from(NAMES), min_size=1, unique=True), st.data())
@settings(max_examples=40, deadline=None)
def test_motors_are_what_the_file_drives(driven, data):
    ways = [data.draw(st.sampled_from(WAYS)) for _ in driven]
    idle = [name for name in NAMES if name not in driven]
    text = "".join(way(name) for way, name in zip(ways, driven, strict=True)) + read(NAMES)
    try:
        found = robot(text)
    except AuditError as asked:  # a stub beside a whole arm could be a head
        found = robot(text, free=re.findall(r"--free (\S+)", asked.fix))
    assert set(found.actuator_names) == {"wl", "wr", *driven} and list(found.arm.locked) == idle == told(found)
    if idle:
        back = data.draw(st.sampled_from(idle))
        again = robot("".join(map(transmission, driven)), free=(back,))
        assert set(again.actuator_names) == {"wl", "wr", *driven, back} and back not in told(again)


@pytest.mark.parametrize(
    "more", ["", read(NAMES), "".join(map(commanded, ("wl", "wr"))), commanded("wl") + commanded("wr")]
)
def test_where_the_file_drives_none_of_the_arm_its_motors_are_said_elsewhere(more):
    assert set(robot(more).actuator_names) == {"wl", "wr", *NAMES} and told(robot(more)) == []


def test_fingers_alone_say_nothing_of_the_arm():
    """As Baxter's file, which has transmissions of its grippers."""
    found = robot_of(two_armed(transmission("a_joint") + transmission("b_joint")))
    assert len(found.joint_names) == 13 and not [f for f in found.findings if f.code == "arm-passive"]


def test_the_master_of_a_driven_slave_is_driven():
    slave = link("s") + joint(
        "s_joint",
        "revolute",
        "left_3",
        "s",
        more='<limit lower="-1" upper="1" effort="1" velocity="1"/>' + mimic("left_joint_3"),
    )
    found = robot(slave + transmission("left_joint_0") + transmission("s_joint"))
    assert {"left_joint_0", "left_joint_3"} <= set(found.joint_names) and "left_joint_3" not in told(found)


def test_a_locked_linkage_is_the_reduced_model_of_pinocchio():
    found = robot("".join(map(transmission, NAMES[:4])))
    model = found.model
    q = found.configuration(found.neutral_position())
    reduced = pin.buildReducedModel(model, [model.getJointId(name) for name in NAMES[4:]], q)
    M = pin.crba(reduced, reduced.createData(), pin.neutral(reduced))
    M = np.triu(M) + np.triu(M, 1).T
    kept = [i for i, name in enumerate(found.full_velocity_names) if name not in NAMES[4:]]
    np.testing.assert_allclose(
        Dynamics(found).mass_matrix(found.neutral_position()), found.T[kept].T @ M @ found.T[kept], atol=1e-9
    )
    assert not found.T[[found.full_velocity_names.index(name) for name in NAMES[4:]]].any()


def test_a_drive_wheel_without_a_motor_is_refused_and_the_way_out_is_one():
    with pytest.raises(RobotError, match=r"nothing drives the wheel\(s\) wr: .*'wl' has a motor.*--wheels wl,wr"):
        robot(commanded("wl"))
    assert robot(commanded("wl"), wheels=("wl", "wr")).actuator_names[:2] == ("wl", "wr")
    assert robot(commanded("wl") + commanded("wr")).actuator_names[:2] == ("wl", "wr")


def test_every_wheel_of_a_holonomic_base_needs_a_motor():
    text = three((0.0, 2.0, 4.2)).replace("</robot>", f"{commanded('w0')}{commanded('w2')}</robot>")
    with pytest.raises(
        RobotError, match=r"drives the wheel\(s\) w1: 'w.' has a motor.*--wheels (w\d,w\d,w\d)"
    ) as error:
        robot_of(text)
    names = tuple(error.value.fix.split("--wheels ")[1].split()[0].split(","))
    assert set(robot_of(text, wheels=names).actuator_names) >= {"w0", "w1", "w2"}


def test_a_joint_that_has_a_motor_cannot_be_freed():
    with pytest.raises(ConfigError, match="'left_joint_0' need not be freed"):
        robot(transmission("left_joint_0"), free=("left_joint_0",))


@pytest.mark.parametrize(
    "ends", ["<parent>left_3</parent><child>right_3</child>", '<parent link="left_3"/><child link="r::right_3"/>']
)
def test_a_loop_that_gazebo_closes_is_told(ends):
    found = robot(f'<gazebo><joint name="close" type="revolute">{ends}</joint></gazebo>')
    text = next(str(f) for f in found.findings if f.code == "gazebo-loop")
    assert "joint 'close' closes a loop: it holds 'right_3' to 'left_3'" in text
    world = robot('<gazebo><joint name="held" type="fixed"><parent>world</parent><child>base</child></joint></gazebo>')
    assert not [f for f in world.findings if f.code == "gazebo-loop"]
