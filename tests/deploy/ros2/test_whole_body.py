"""Goals of base and arm together: what is rolled is where it was asked to be, and what cannot be rolled is refused."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import plain_messages as msg
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import load
from mmnn_pin.deploy.ros2.planned import INVALID_JOINTS, OLD_STAMP, PlannedArm, Refused
from mmnn_pin.deploy.ros2.sensing import STILL
from mmnn_pin.deploy.ros2.whole_body import base_points, whole_motion
from mmnn_pin.reference.guide import ARM, BASE
from mmnn_pin.reference.limits import Limits

ROBOT = load("platform_arm")
OF_ROBOT = PlannedArm.of(ROBOT, {}, Limits(), 0.01)
HERE, NOW = np.zeros(5), np.array([[0.1, 0.2], [0.0, 0.0], [0.0, 0.0]])
NOTHING = msg.JointTrajectory(msg.Header(), [], [])


def at(time: float) -> msg.Duration:
    return msg.Duration(int(time), round(1e9 * (time % 1)))


def transforms(poses: Any, step: float = 1.0, begin: float = 0.0) -> msg.MultiDOFJointTrajectory:
    """As MoveIt writes a planar joint of several degrees of freedom."""
    made = [
        msg.Transform(msg.Vector3(x, y), msg.Quaternion(0.0, 0.0, math.sin(phi / 2), math.cos(phi / 2)))
        for x, y, phi in poses
    ]
    points = [
        msg.MultiDOFJointTrajectoryPoint([one], time_from_start=at(begin + step * i)) for i, one in enumerate(made)
    ]
    return msg.MultiDOFJointTrajectory(msg.Header(), ["world_joint"], points)


def columns(poses: Any, joints: Any, step: float = 1.0) -> msg.JointTrajectory:
    """As MoveIt writes the variables of a planar joint among others."""
    names = ["world_joint/x", "world_joint/y", "arm_2_joint", "world_joint/theta"]
    rows = [[x, y, q, phi] for (x, y, phi), q in zip(poses, joints, strict=True)]
    points = [msg.JointTrajectoryPoint(row, time_from_start=at(step * i)) for i, row in enumerate(rows)]
    return msg.JointTrajectory(msg.Header(), names, points)


def planned(trajectory: Any, multi: Any = None, base: Any = HERE, since: float = 0.0, place: Any = STILL) -> Any:
    points = base_points(trajectory, multi)
    assert points is not None
    return whole_motion(OF_ROBOT, trajectory, points, NOW, np.asarray(base, float), place, since)


def must_roll(table: np.ndarray) -> None:
    """The pose goes where its velocity says, and nowhere else."""
    middle = 0.5 * (table[1:, 3:5] + table[:-1, 3:5]), 0.5 * (table[1:, 2] + table[:-1, 2])
    driven = middle[0][:, :1] * np.stack([np.cos(middle[1]), np.sin(middle[1])], axis=1)
    assert np.diff(table[:, :2], axis=0) / 0.01 == pytest.approx(driven, abs=2e-3)
    assert np.diff(table[:, 2]) / 0.01 == pytest.approx(middle[0][:, 1], abs=2e-3)


# Turn, drive, turn: what MoveIt 2 plans for a planar joint with the motion model of a differential drive.
TURNS = [(0, 0, 0), (0, 0, 0.5), (math.cos(0.5), math.sin(0.5), 0.5), (math.cos(0.5), math.sin(0.5), 0.0)]


def test_turning_and_driving_goes_through_every_point_with_the_arm() -> None:
    motion = planned(columns(TURNS, [0.2, 0.3, 0.4, 0.5], step=2.0))
    table = motion.table
    assert motion.parts == (BASE, ARM) and len(table) == 601
    assert table[::200, :3] == pytest.approx(np.array(TURNS, float), abs=1e-6)
    assert table[::200, 8] == pytest.approx([0.2, 0.3, 0.4, 0.5]) and (table[:, 7] == 0.1).all()
    must_roll(table)
    alone = planned(NOTHING, transforms(TURNS, 2.0))
    assert alone.parts == (BASE,) and alone.table[:, :7] == pytest.approx(table[:, :7], abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.floats(-1.0, 1.0), st.floats(0.2, 1.0), st.floats(-3.0, 3.0), st.sampled_from([-1, 1]))
def test_arcs_are_rolled_ahead_and_in_reverse(bend: float, length: float, heading: float, way: int) -> None:
    """Points every 10 cm of an arc: none is passed more than 2 cm aside, wherever it begins."""
    s = way * np.linspace(0.0, length, 11)
    phi = heading + bend * s
    x = np.cumsum(np.append(0.0, np.diff(s) * np.cos(0.5 * (phi[1:] + phi[:-1]))))
    y = np.cumsum(np.append(0.0, np.diff(s) * np.sin(0.5 * (phi[1:] + phi[:-1]))))
    base = np.array([1.0, -2.0, heading, 0.0, 0.0])
    motion = planned(NOTHING, transforms(np.stack([1.0 + x, y - 2.0, phi], axis=1), 0.4), base)
    must_roll(motion.table)
    assert math.dist(motion.table[-1, :2], (1.0 + x[-1], y[-1] - 2.0)) < 0.02
    assert motion.table[-1, 2] == pytest.approx(phi[-1])


ASIDE = [(0, 0, 0), (0.5, 0, 0), (0.5, 0.3, 0)]
BAD: dict[str, tuple[Any, Any, dict[str, Any], int, str]] = {
    "sideways": (NOTHING, transforms(ASIDE), {}, -1, r"cannot roll to its point 2 at 2 s: it passes 0\.3 m aside"),
    "elsewhere": (NOTHING, transforms(TURNS), {"base": (1.0, 0, 0, 0, 0)}, -1, "it begins 1 m and 0 rad from where"),
    "too fast": (NOTHING, transforms(TURNS, 0.2), {}, -1, "w at|v at"),
    "a column is missing": (
        msg.JointTrajectory(msg.Header(), ["b/x", "b/y"], [msg.JointTrajectoryPoint([0.0, 0.0])]), None, {},
        INVALID_JOINTS, "b/theta is missing",
    ),
    "two bases": (columns(TURNS, [0.0] * 4), msg.MultiDOFJointTrajectory(msg.Header(), ["other"], []), {},
                  INVALID_JOINTS, "other, world_joint: there is one base"),
    "over": (NOTHING, transforms(TURNS), {"since": 9.0}, OLD_STAMP, "it was over 6 s ago"),
    "no points": (NOTHING, msg.MultiDOFJointTrajectory(msg.Header(), ["world_joint"], []), {}, -1, "two points"),
    "not finite": (NOTHING, transforms([(0, 0, 0), (math.nan, 0, 0)]), {}, -1, "not finite"),
    "the arm's joint": (
        msg.JointTrajectory(msg.Header(), ["elbow"], [msg.JointTrajectoryPoint([0.0], time_from_start=at(1.0))]),
        transforms(TURNS), {}, INVALID_JOINTS, "joints elbow: there is arm_1_joint",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_done_is_refused_with_where_and_by_how_much(name: str) -> None:
    trajectory, multi, more, code, why = BAD[name]
    with pytest.raises(Refused, match=why) as refused:
        planned(trajectory, multi, **more)
    assert refused.value.code == code


def test_a_map_places_it_and_the_shorter_part_waits() -> None:
    place = (1.0, 2.0, math.pi / 2)
    arm = msg.JointTrajectory(msg.Header(), ["arm_1_joint"], [
        msg.JointTrajectoryPoint([0.1]), msg.JointTrajectoryPoint([0.3], time_from_start=at(1.0)),
    ])  # fmt: skip
    motion = planned(
        arm, transforms([(0, 0, 0), (0.5, 0, 0)], 2.0), (1.0, 2.0, math.pi / 2 + math.tau, 0, 0), 0.0, place
    )
    assert motion.table[-1, :3] == pytest.approx([1.0, 2.5, math.pi / 2 + math.tau]) and len(motion.table) == 201
    assert motion.table[100:, 7] == pytest.approx(0.3) and not motion.table[100:, 9].any()
