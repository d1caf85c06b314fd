"""What a planner and a teleoperator send, on an arm whose joints turn without end: it moves as asked, and no farther.

The plant is plain pinocchio (`aba`), the encoder is ours: it turns over at a seam. Public reports of the kind:
ros2_controllers #584 and #796, moveit2 #2136, kinova-ros #334, spartan #350.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import plain_messages as msg
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import PD, Stepper, StepperSettings, load
from mmnn_pin.deploy.ros2.planned import PlannedArm, Refused
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.wishes import JointGoal
from mmnn_pin.safety import Safety
from mmnn_pin.signals import Measurement

pytestmark = pytest.mark.compiled
PERIOD, NOTHING = 0.002, np.zeros(0)
LINK = """<link name="{name}"><inertial><origin xyz="0 0.01 0.12"/><mass value="{mass}"/>
<inertia ixx="0.04" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.04"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 {z}"/><axis xyz="{axis}"/><limit {ends} effort="80" velocity="6"/></joint>"""


def text_of(*ends):
    """An arm of three joints; one without ends turns on and on."""
    parts, parent = ['<robot name="arm"><link name="world"/>'], "world"
    for i, (end, axis) in enumerate(zip(ends, ("0 0 1", "0 1 0", "0 0 1"), strict=True), 1):
        kind, limit = ("continuous", "") if end is None else ("revolute", f'lower="{-end}" upper="{end}"')
        parts += [LINK.format(name=f"l{i}", mass=3.0 - i / 2)]
        parts += [JOINT.format(name=f"j{i}", kind=kind, parent=parent, child=f"l{i}", z=0.3, axis=axis, ends=limit)]
        parent = f"l{i}"
    return "".join([*parts, "</robot>"])


class Robot:
    """The plant, a stepper before it, and what both did."""

    def __init__(self, folder, q, seam=None, ends=(None, 3.1, None), limits=None):
        (folder / "arm.urdf").write_text(text_of(*ends))
        self.model = pin.buildModelFromXML(text_of(*ends))
        self.data, self.robot = self.model.createData(), load(folder / "arm.urdf")
        self.q, self.v, self.seam, self.k = np.array(q, float), np.zeros(3), seam, 0
        self.endless = [end is None for end in ends]
        more = {} if limits is None else {"limits": limits}
        self.stepper = Stepper(self.robot, PD(), StepperSettings(safety=Safety(torque="urdf"), period=PERIOD, **more))
        self.arm = PlannedArm.of(self.robot, {}, limits or Limits(), PERIOD)
        self.places, self.asked = [], []

    def step(self, wish=None):
        read = self.q.copy()
        if self.seam is not None:
            read = np.where(self.endless, (read - self.seam) % (2 * np.pi) + self.seam, read)
        command = self.stepper.step(self.k * PERIOD, Measurement(NOTHING, NOTHING, read, self.v.copy()), wish)
        position = np.concatenate(
            [[np.cos(q), np.sin(q)] if free else [q] for q, free in zip(self.q, self.endless, strict=True)]
        )
        self.v = self.v + PERIOD * pin.aba(self.model, self.data, position, self.v, command.motor_effort - 2.0 * self.v)
        self.q, self.k = self.q + PERIOD * self.v, self.k + 1
        self.places.append(self.q.copy())
        self.asked.append(self.stepper.setpoint.q.copy())

    def steps(self, seconds):
        for _ in range(round(seconds / PERIOD)):
            self.step()
        return np.array(self.asked), np.array(self.places)

    def motion(self, points, names=("j1", "j2", "j3")):
        """The motion of a planner's message: points (positions, time, rates or none)."""
        made = [
            msg.JointTrajectoryPoint(list(q), list(rates), [], [], msg.Duration(int(t), round(1e9 * (t % 1))))
            for q, t, rates in points
        ]
        now = self.stepper.follower.now[self.stepper.follower.q :].reshape(3, -1)
        return self.arm.motion(msg.JointTrajectory(msg.Header(msg.Time()), list(names), made), now)


def travel(places):
    return np.abs(np.diff(places[:, 0])).sum()


@settings(max_examples=12, derandomize=True)
@given(st.floats(-20.0, 20.0), st.floats(-3.0, 3.0), st.integers(-3, 3), st.one_of(st.none(), st.floats(-7.0, 7.0)))
def test_a_goal_is_reached_by_the_nearest_turn_whatever_the_encoder_says(tmp_path_factory, start, way, turns, seam):
    robot = Robot(tmp_path_factory.mktemp("arm"), (start, 0.1, 0.0), seam)
    robot.steps(0.1)
    told = robot.stepper.setpoint.q[0]
    robot.step(JointGoal((told + way + 2 * np.pi * turns, 0.1, 0.0)))
    _, places = robot.steps(3.5)
    assert not robot.stepper.tripped
    assert places[-1, 0] - start == pytest.approx(way, abs=1e-2) and travel(places) == pytest.approx(abs(way), abs=0.02)


@settings(max_examples=8, derandomize=True)
@given(st.floats(-3.0, 3.0), st.integers(-3, 3), st.sampled_from([None, -np.pi, 0.0, 1.0]))
def test_a_plan_that_is_written_whole_turns_away_is_followed_here(tmp_path_factory, start, turns, seam):
    robot = Robot(tmp_path_factory.mktemp("arm"), (start, 0.1, 0.0), seam)
    robot.steps(0.1)
    there = start + 2 * np.pi * turns
    robot.step(robot.motion([((there, 0.1, 0.0), 0.0, ()), ((there + 0.2, 0.1, 0.0), 2.0, ())]))
    _, places = robot.steps(3.0)
    assert travel(places) == pytest.approx(0.2, abs=0.01) and places[-1, 0] - start == pytest.approx(0.2, abs=5e-3)


JOGS = [(0.05, 0.1), (0.1, 0.2), (0.2, 0.2), (0.5, 0.5), (1.0, 0.6), (0.0108, 0.15), (0.3, 0.3), (0.02, 0.05)]


@pytest.mark.parametrize(("way", "seconds"), JOGS)
@pytest.mark.parametrize("rates", [(), (0.0, 0.0, 0.0)])
def test_a_short_motion_is_the_cubic_from_rest_to_rest_at_most_one_sample_late(tmp_path, way, seconds, rates):
    robot = Robot(tmp_path, (0.0, 0.0, 0.0))
    robot.steps(0.1)
    first = robot.k
    robot.step(robot.motion([((way, 0.0, 0.0), seconds, rates)]))
    asked, _ = robot.steps(1.0)
    u = np.clip((np.arange(len(asked) - first) * PERIOD) / seconds, 0.0, 1.0)
    cubic, late = way * u * u * (3.0 - 2.0 * u), 1.5 * way / seconds * PERIOD
    assert np.abs(asked[first:, 0] - cubic).max() <= late + 1e-9
    assert asked[-1, 0] == pytest.approx(way, abs=1e-9) and not asked[:, 1:].any()


@settings(max_examples=10, derandomize=True)
@given(st.floats(0.02, 0.1), st.floats(0.05, 0.2), st.floats(0.2, 2.0))
def test_jogs_one_after_the_other_go_ahead_without_a_stop_and_end_where_the_last_ends(
    tmp_path_factory, gap, ahead, speed
):
    """A point every 20 to 100 ms, 0.05 to 0.2 s ahead, where a hand at that speed will be."""
    robot = Robot(tmp_path_factory.mktemp("arm"), (0.0, 0.0, 0.0), limits=Limits(joint_speed=6.0))
    robot.steps(0.1)
    count, last = round(1.0 / gap), 0.0
    for i in range(count):
        last = speed * (i * gap + ahead)
        robot.step(robot.motion([((last, 0.0, 0.0), max(ahead, 2 * PERIOD), ())]))
        robot.steps(gap - PERIOD)
    asked, _ = robot.steps(1.5)
    rate = np.diff(asked[:, 0]) / PERIOD
    assert asked[:, 0].min() >= 0.0 and asked[-1, 0] == pytest.approx(last, abs=1e-6)
    assert asked[:, 0].max() <= last + 1e-6 and rate.min() >= -1e-6 and rate.max() <= 3.0 * max(speed, last / ahead / 3)


@pytest.mark.parametrize("bend", [10.0, 12.0, 15.0])
def test_a_trapezoid_as_planners_make_them_ends_at_its_end(tmp_path, bend):
    """Positions and rates at 10 Hz and at 100 Hz, 1 rad within 3 rad/s."""
    ramp = 3.0 / bend
    end = 1.0 / 3.0 + ramp
    for step in (0.1, 0.01):
        robot = Robot(tmp_path, (0.0, 0.0, 0.0))
        robot.steps(0.1)
        at = np.append(np.arange(step, end, step), end)
        u = np.minimum(at, end - at)
        half = np.where(u < ramp, 0.5 * bend * u**2, 0.5 * bend * ramp**2 + 3.0 * (u - ramp))
        q = np.where(at <= end / 2, half, 1.0 - half)
        rates = np.minimum(bend * u, 3.0)
        robot.step(robot.motion([((x, 0.0, 0.0), t, (v, 0.0, 0.0)) for x, t, v in zip(q, at, rates, strict=True)]))
        asked, _ = robot.steps(2.0)
        assert asked[-1, 0] == pytest.approx(1.0, abs=1e-9)
        assert asked[:, 0].max() <= 1.0 + 1e-9 and np.diff(asked[:, 0]).min() >= -1e-9


@pytest.mark.parametrize("over", [1e-6, 1e-4, 2e-3, 0.02])
def test_a_joint_that_rests_beyond_its_end_is_led_back_and_holds_up_no_other(tmp_path, over):
    robot = Robot(tmp_path, (-1.5 - over, 0.1, 0.0), ends=(1.5, 1.5, 1.5))
    there = robot.motion([((-1.0, 0.1, 0.0), 2.0, ())])  # made before it is led back
    asked, _ = robot.steps(0.4)
    assert asked[-1, 0] == pytest.approx(-1.5, abs=1e-12) and (np.diff(asked[:, 0]) >= -1e-12).all()
    other = robot.motion([((0.5,), 2.0, ())], ("j2",))
    robot.step(other)
    asked, _ = robot.steps(2.5)
    assert asked[-1].tolist() == pytest.approx([-1.5, 0.5, 0.0])
    robot.step(there)
    asked, _ = robot.steps(2.5)
    assert asked[-1].tolist() == pytest.approx([-1.0, 0.1, 0.0])
    for bad in (-1.6, 1.6):
        with pytest.raises(Refused, match=r"its ends are -1\.5 and 1\.5"):
            robot.motion([((bad, 0.1, 0.0), 2.0, ())])


def test_a_plan_beyond_a_stated_acceleration_is_refused_with_it_and_else_brings_its_own(tmp_path):
    robot = Robot(tmp_path, (0.0, 0.0, 0.0), limits=Limits(joint_acceleration=5.0))
    robot.steps(0.1)
    with pytest.raises(Refused, match=r"j1 at 30 .*its limit is 5 .*limits\.joint_acceleration"):
        robot.motion([((0.05, 0.0, 0.0), 0.1, ())])
    robot.step(robot.motion([((0.05, 0.0, 0.0), 0.3, ())]))
    assert robot.steps(1.0)[0][-1, 0] == pytest.approx(0.05)


def test_points_that_wrap_within_a_plan_are_taken_by_the_nearest_turn(tmp_path):
    robot = Robot(tmp_path, (3.0, 0.1, 0.0), seam=-np.pi)
    robot.steps(0.1)
    points = [((3.0, 0.1, 0.0), 0.0, ()), ((3.13, 0.1, 0.0), 2.0, ()), ((-3.05, 0.1, 0.0), 4.0, ())]
    robot.step(robot.motion(points))
    _, places = robot.steps(5.0)
    assert travel(places) == pytest.approx(2 * np.pi - 6.05, abs=0.02)


@pytest.mark.parametrize("ahead", [0.001, 0.002, 0.004])
def test_a_point_that_no_speed_reaches_in_time_is_refused(tmp_path, ahead):
    robot = Robot(tmp_path, (0.0, 0.0, 0.0))
    robot.steps(0.1)
    with pytest.raises(Refused, match=r"j1 at .* /s: its limit is 6 /s"):
        robot.motion([((2.0, 0.0, 0.0), ahead, ())])
    with pytest.raises(Refused, match="time 0"):
        robot.motion([((0.1, 0.0, 0.0), 0.0, ())])


def test_a_joint_that_is_not_named_stands_where_it_stops(tmp_path):
    robot = Robot(tmp_path, (0.0, 0.0, 0.0))
    robot.steps(0.1)
    robot.step(robot.motion([((1.0, 0.0, 0.0), 1.0, ())]))
    robot.steps(0.5)
    moving = robot.stepper.setpoint.qdot[0]
    robot.step(robot.motion([((0.3,), 0.5, ())], ("j3",)))
    asked, _ = robot.steps(1.5)
    assert moving > 1.0 and np.diff(asked[:, 0]).min() > -1e-9 and asked[-1, 2] == pytest.approx(0.3)


def test_a_plan_that_leaves_a_joint_a_little_outside_of_its_end_is_followed_by_the_others(tmp_path):
    robot = Robot(tmp_path, (-1.5001, 0.1, 0.0), ends=(1.5, 1.5, 1.5))
    robot.steps(0.1)
    robot.step(robot.motion([((-1.5001, 0.5, 0.0), 1.0, ())]))
    assert robot.steps(1.5)[0][-1].tolist() == pytest.approx([-1.5, 0.5, 0.0])
    robot.step(JointGoal((-1.5001, 0.1, 0.0)))
    assert robot.steps(2.0)[0][-1].tolist() == pytest.approx([-1.5, 0.1, 0.0])
