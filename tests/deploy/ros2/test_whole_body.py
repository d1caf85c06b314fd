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
from mmnn_pin.deploy.ros2.planned import INVALID_JOINTS, OLD_STAMP, PlannedArm, Refused, RobotSituation
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


def planned(
    trajectory: Any, multi: Any = None, base: Any = HERE, since: float = 0.0, place: Any = STILL, smooth: float = 0.0
) -> Any:
    points = base_points(trajectory, multi)
    assert points is not None
    here = np.asarray(base, float)
    now = RobotSituation(NOW, NOW[:2], here, here[:3], here[3:], 0.0)
    return whole_motion(OF_ROBOT, trajectory, points, now, place, since, smooth)


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


def with_rates(rows: Any, step: float = 1.0) -> msg.MultiDOFJointTrajectory:
    """Rows of pose, its rates and theirs, in the frame of the message."""
    made = transforms([row[:3] for row in rows], step)
    for point, row in zip(made.points, rows, strict=True):
        for kind, (x, y, w) in zip((point.velocities, point.accelerations), (row[3:6], row[6:9]), strict=True):
            kind.append(msg.Twist(msg.Vector3(x, y), msg.Vector3(0.0, 0.0, w)))
    return made


def circle(t: float) -> list[float]:
    """A turn to the left of 0.5 m, from rest to rest in 4 s: pose, rates and theirs in the plane, in closed form."""
    s, v, a = 0.3 * (t / 4) ** 2 * (3 - 2 * t / 4) * 4, 0.3 * 6 * (t / 4) * (1 - t / 4), 0.3 * 6 / 4 * (1 - t / 2)
    phi, w, wdot = s / 0.5, v / 0.5, a / 0.5
    c, n = math.cos(phi), math.sin(phi)
    return [0.5 * n, 0.5 * (1 - c), phi, v * c, v * n, w, a * c - v * w * n, a * n + v * w * c, wdot]


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (1.0, -2.0, 2.5)])
def test_rates_and_their_rates_are_those_of_the_pose_in_the_messages_frame(place: Any) -> None:
    """Second answer: the closed form that the points were taken from, between them, too, in a turned frame, too."""
    rows = [circle(t) for t in np.linspace(0.0, 4.0, 6)]
    motion = planned(NOTHING, with_rates(rows, 0.8), base=(*place, 0.0, 0.0), place=place)
    c, s = math.cos(place[2]), math.sin(place[2])
    for k, row in enumerate(motion.table):
        x, y, phi, vx, vy, w, ax, ay, wdot = circle(min(0.01 * k, 4.0))
        there = place[0] + c * x - s * y, place[1] + s * x + c * y, place[2] + phi
        assert row[:3] == pytest.approx(there, abs=2e-4)
        v = math.hypot(vx, vy)
        assert row[3:5] == pytest.approx([v, w], abs=2e-3)
        assert row[5:7] == pytest.approx([ax * math.cos(phi) + ay * math.sin(phi), wdot], abs=0.02)


def test_velocities_that_slide_or_do_not_end_or_are_missing_are_refused() -> None:
    rows = [circle(t) for t in (0.0, 2.0, 4.0)]
    slides = [row[:] for row in rows]
    slides[1][3:5] = slides[1][4], -slides[1][3]
    moving, several = [row[:] for row in rows], with_rates(rows, 2.0)
    moving[2][5] = 0.2
    several.points[1].velocities = []
    for multi, why in (
        (with_rates(slides, 2.0), r"cannot roll through its point 1 at 2 s: it slides 0\.45 m/s aside"),
        (with_rates(moving, 2.0), "world_joint: its last point is not at rest"),
        (several, "velocities or accelerations of the base are missing at a point"),
    ):
        with pytest.raises(Refused, match=why):
            planned(NOTHING, multi)


def moveit(turns: Any, blend: float = 0.05, period: float = 0.1) -> msg.JointTrajectory:
    """A path of x, y, theta as time-optimal parameterization writes it: corners cut, even times, rates and theirs."""
    way, corners = [np.array(turns[0], float)], np.array(turns, float)
    for a, b, c in zip(corners, corners[1:], corners[2:], strict=False):
        u, v = (one / np.linalg.norm(one) for one in (b - a, c - b))
        bend = np.linspace(0.0, 1.0, 20)[:, None]
        way += list((1 - bend) ** 2 * (b - blend * u) + 2 * bend * (1 - bend) * b + bend**2 * (b + blend * v))
    way.append(corners[-1])
    points = np.array(way)
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    times = np.arange(0.0, s[-1] / 0.2 + 1.0 + period, period)
    times[-1] = s[-1] / 0.2 + 1.0
    ramp = np.clip(times, 0.0, 1.0) ** 2 / 2, np.clip(times[-1] - times, 0.0, 1.0) ** 2 / 2
    along = 0.2 * (ramp[0] - ramp[1] + 0.5 + np.clip(times - 1, 0.0, times[-1] - 2.0))
    fine = np.clip(along[:, None] + [-1e-4, 0.0, 1e-4], 0.0, s[-1])
    poses = np.stack([np.interp(fine, s, column) for column in points.T], axis=-1)
    speed = 0.2 * np.minimum(np.clip(times, 0, 1), np.clip(times[-1] - times, 0, 1))
    slope = (poses[:, 2] - poses[:, 0]) / np.maximum(fine[:, 2] - fine[:, 0], 1e-9)[:, None]
    names = [f"position/{part}" for part in ("x", "y", "theta")]
    made = [
        msg.JointTrajectoryPoint(q.tolist(), (v * d).tolist(), [], time_from_start=at(t))
        for t, q, v, d in zip(times, poses[:, 1], speed, slope, strict=True)
    ]
    return msg.JointTrajectory(msg.Header(), names, made)


def test_what_moveit_writes_for_a_diff_drive_is_rolled() -> None:
    """Turn, drive, turn with corners cut by its blends, sampled at 10 Hz with rates."""
    trajectory = moveit(TURNS)
    table = planned(trajectory).table
    must_roll(table)
    asked = np.array([point.positions for point in trajectory.points])
    times = np.array([point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in trajectory.points])
    there = table[np.minimum(np.round(times / 0.01).astype(int), len(table) - 1), :3]
    assert np.abs(there - asked)[:, :2].max() < 0.02 and np.abs(there - asked)[:, 2].max() < 0.03


def test_what_cannot_be_rolled_is_smoothed_when_asked() -> None:
    """A lane change of 0.1 m with the heading held: rolled, near every point, at rest; a slide on the spot is none."""
    lane = [(0.25 * i, 0.1 * (i / 8) ** 2 * (3 - 2 * i / 8), 0.0) for i in range(9)]
    multi = transforms([*lane, (2.25, 0.1, 0.0), (2.5, 0.1, 0.0)], 1.0)
    with pytest.raises(Refused, match=r"it passes .* aside .action.smooth lets it"):
        planned(NOTHING, multi)
    table = planned(NOTHING, multi, smooth=0.05).table
    must_roll(table)
    asked = np.array([(one.transforms[0].translation.x, one.transforms[0].translation.y) for one in multi.points])
    away = np.hypot(*(table[np.minimum(100 * np.arange(11), len(table) - 1), :2] - asked).T)
    assert away.max() < 0.05 and not table[-1, 3:5].any()
    with pytest.raises(Refused, match=r"point 1 at 1 s: it passes 0\.\d+ m aside .even when smoothed"):
        planned(NOTHING, transforms([(0, 0, 0), (0.0, 0.3, 0)]), smooth=0.05)
