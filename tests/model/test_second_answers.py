"""yourdfpy's forward kinematics, a second answer to Pinocchio's, on every robot at hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import Drive, joint, link, robot_of
from robots import fixed_arm, mobile_arm

from mmnn_pin.errors import RobotError
from mmnn_pin.model import bundled, load
from mmnn_pin.model.checks.properties import check
from mmnn_pin.model.checks.second_answers import SecondKinematics
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.robots import extra

MOBILE = [name for name in ("tiago", "tiago_no_hand", "tiago_dual", "tiago_pro") if name in extra()]


def assert_same_placements(robot: Robot, seed: int = 0) -> None:
    kinematics, rng = SecondKinematics(robot), np.random.default_rng(seed)
    for _ in range(3):
        position = robot.follow(rng.uniform(-np.pi, np.pi, robot.dimensions.full))
        ours, theirs = kinematics.by_pinocchio(position), kinematics.placements(position)
        assert len(ours) > 1 and ours.keys() == theirs.keys()
        for name, placement in ours.items():
            np.testing.assert_allclose(theirs[name], placement, rtol=0, atol=1e-9, err_msg=name)
        assert kinematics.residual(position) < 1e-9


@pytest.mark.parametrize("name", bundled())
def test_bundled_robots(name):
    assert_same_placements(load(name))


@pytest.mark.skipif(not MOBILE, reason="needs example-robot-data")
@pytest.mark.parametrize("name", MOBILE)
def test_mobile_robots_of_the_extra(name):
    assert_same_placements(load(name, free=["all"]))


@pytest.mark.parametrize("new", [mobile_arm, fixed_arm])
def test_any_axes_and_slides(new):
    assert_same_placements(new(5))


def test_a_wrong_placement_is_seen():
    robot = mobile_arm(3)
    model = robot.model.copy()
    model.jointPlacements[4].translation += 1e-6
    wrong = replace(robot, model=model)
    report = check(wrong, samples=1)
    assert not report.properties["forward_kinematics"].passed and not report.passed


def test_what_yourdfpy_cannot_read_is_skipped_with_a_reason():
    more = "".join(link(f"{name}_link") for name in "abc")
    for name, mimics in (("a", ""), ("b", '<mimic joint="a"/>'), ("c", '<mimic joint="b"/>')):
        more += joint(name, "continuous", "base", f"{name}_link", p=(0, 0, 1), axis=(0, 0, 1), more=mimics)
    robot = robot_of(Drive().urdf().replace("</robot>", more + "</robot>"))
    with pytest.raises(RobotError, match="'b', which mimics another"):
        SecondKinematics(robot)
    report = check(robot, samples=1)
    assert "forward_kinematics" not in report.properties and "'b'" in report.skipped["forward_kinematics"]
    assert report.passed


def test_a_report_does_without_yourdfpy():
    report = check(mobile_arm(3), samples=1, placements=False)
    assert report.passed and list(report.skipped) == ["forward_kinematics"]
    assert "forward_kinematics" not in report.properties and "mmnn check" in report.skipped["forward_kinematics"]
