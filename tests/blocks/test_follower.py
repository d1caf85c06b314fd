"""References made while the robot runs: no jump, within limits, inside the joints' ends, told when nothing comes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from mmnn_pin import Circle, Line, Sine, Trajectory, load
from mmnn_pin.errors import ConfigError, TrajectoryError
from mmnn_pin.reference.braking import brought_home
from mmnn_pin.reference.follower import Follower
from mmnn_pin.reference.guide import ARM, BASE
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.wishes import HOLD, BaseVelocity, JointGoal, Motion
from mmnn_pin.signals import Dimensions, Setpoint

H = 0.002
ROBOT = load("platform_arm")
D = ROBOT.dimensions
LIMITS = Limits(joint_speed=2.0, joint_acceleration=5.0, joint_jerk=50.0)
SMALL = {"deadline": None, "max_examples": 15, "phases": (Phase.generate,)}


class Run:
    """A follower, stepped at a period where the robot is wherever its reference is."""

    def __init__(self, velocity=(0.0, 0.0), q=(0.0, 0.0), qdot=(0.0, 0.0), timeout=0.5, robot=ROBOT, limits=LIMITS):
        self.follower, self.k, self.rows = Follower(robot, limits, timeout), 0, []
        self.follower.stand(np.concatenate((np.zeros(robot.dimensions.pose), velocity, q, qdot)))
        self.now = Setpoint.side_by_side(self.follower.now, robot.dimensions)

    def step(self, wish=None, measured=None):
        wishes = () if wish is None else wish if isinstance(wish, tuple) else (wish,)
        m = (
            np.concatenate((self.now.pose, self.now.velocity, self.now.q, self.now.qdot))
            if measured is None
            else measured
        )
        courses = [self.follower.check(one) for one in wishes]
        self.follower.step(self.k * H, H if self.k else 0.0, m, wishes, courses)
        self.k += 1
        self.rows.append(self.follower.now.copy())
        return self.now

    def steps(self, count, wish=None):
        for k in range(count):
            self.step(wish if k == 0 else None)
        return self.table()

    def table(self):
        return Setpoint.side_by_side(np.array(self.rows), D)


def swing(amplitude=0.3):
    return tuple(Sine(amplitude, 2.0, offset=0.1, phase=0.7 + i) for i in range(D.arm))


# -- hold, and velocities ----------------------------------------------------------------------------------------------


@settings(**SMALL)
@given(st.floats(-1, 1), st.floats(-1.5, 1.5), st.floats(-2, 2))
def test_it_brakes_from_where_it_is_along_the_path_of_a_rolling_base(v, w, qdot):
    """Against the unicycle under the same deceleration, integrated by DOP853."""
    run = Run((v, w), qdot=(qdot, 0.0))
    table = run.steps(round(1.2 / H))
    rest = max(abs(v) / 1.0, abs(w) / 2.0)  # v and w come to rest together: the curvature stays

    def rate(t, pose):
        share = max(0.0, 1.0 - t / rest) if rest else 0.0
        forward, turn = share * v, share * w
        return [forward * np.cos(pose[2]), forward * np.sin(pose[2]), turn]

    end = solve_ivp(rate, (0.0, 1.2), np.zeros(3), "DOP853", rtol=1e-10, atol=1e-10).y[:, -1]
    np.testing.assert_allclose(table.pose[-1], end, atol=2.5 * H)
    assert table.q[-1, 0] == pytest.approx(np.sign(qdot) * qdot**2 / 10.0, abs=2 * H)
    assert not table.velocity[-1].any() and not table.qdot[-1].any()
    assert np.abs(np.diff(table.velocity, axis=0)).max() <= 2.0 * H * (1 + 1e-9)


@settings(**SMALL)
@given(st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=5))
def test_a_velocity_is_ramped_within_its_limits_and_leaves_no_pose_error(wishes):
    run, rng = Run(), np.random.default_rng(0)
    for wish in wishes:
        for _ in range(100):
            measured = rng.normal(size=9)
            now = run.step(BaseVelocity(wish), measured)
            np.testing.assert_array_equal(now.pose, measured[:3])
    table = run.table()
    change = np.diff(table.velocity, axis=0) / H
    assert (np.abs(change) <= np.array([1.0, 2.0]) * (1 + 1e-9)).all()
    np.testing.assert_allclose(change, table.acceleration[1:], atol=1e-9)
    assert (np.abs(table.velocity) <= [1.0, 1.5]).all()
    for _ in range(2000):
        run.step(BaseVelocity(wishes[-1]), measured)
    share = 1.0 / max(1.0, *np.abs(wishes[-1]) / (1.0, 1.5))  # both alike: a curvature stays one
    np.testing.assert_allclose(run.now.velocity, share * np.array(wishes[-1]), atol=1e-12)


@pytest.mark.parametrize("wish", [BaseVelocity((0.4, 0.2)), "sample"])
def test_what_is_not_renewed_in_time_ends_in_a_stop_that_is_counted(wish):
    run = Run(timeout=0.1)
    if wish == "sample":
        wish = Setpoint(np.zeros(3), np.array([0.4, 0.2]), np.zeros(2), np.zeros(2), np.array([0.5, 0.0]), np.zeros(2))
    for _ in range(1500):
        run.step(wish)
        if isinstance(wish, Setpoint):
            c, s = np.cos(wish.pose[2] + 0.1 * H), np.sin(wish.pose[2] + 0.1 * H)
            wish.q[0] += 0.5 * H
            wish.pose[:] += 0.4 * H * np.array([c, s, 0.5])
    last, moving = run.now.velocity.copy(), run.k
    table = run.steps(500)
    np.testing.assert_allclose(table.velocity[moving + round(0.1 / H) - 2], last, atol=1e-12)  # it goes on meanwhile
    assert not table.velocity[-1].any() and not table.qdot[-1].any() and run.follower.losses >= 1
    assert np.abs(np.diff(table.velocity[moving:], axis=0)).max() <= 2.0 * H * (1 + 1e-9)


def test_a_sample_that_does_not_come_is_made_from_the_last():
    run, pose = Run(limits=Limits(samples="exact")), np.array([1.0, 2.0, 0.3])
    sample = Setpoint(pose, np.array([0.5, 0.0]), np.ones(2), np.zeros(2), np.array([0.5, -0.25]), np.ones(2))
    run.step(sample)
    for name in Setpoint.__slots__:
        np.testing.assert_array_equal(getattr(run.now, name), getattr(sample, name))
    run.steps(10)
    np.testing.assert_allclose(
        run.now.pose, pose + 10 * H * 0.5 * np.array([np.cos(0.3), np.sin(0.3), 0.0]), atol=1e-12
    )
    np.testing.assert_allclose(run.now.q, 10 * H * np.array([0.5, -0.25]), atol=1e-12)
    assert not run.now.qddot.any()


# -- motions handed in while it runs -----------------------------------------------------------------------------------


@pytest.mark.compiled
@settings(**SMALL)
@given(st.floats(-0.8, 0.8), st.floats(-1, 1), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_motion_takes_over_without_a_jump_and_is_then_the_motion_itself(v, w, q, qdot):
    motion = Motion.of(Trajectory(Circle(1.0, 0.3, start=(0.2, -0.1, 0.4)), swing()), 8.0, H, D)
    run = Run((v, w), (q, 0.2), (qdot, 0.0))
    run.steps(20)
    first = run.k
    table = run.steps(3500, motion)
    for part, most in (("q", 3.0), ("qdot", 12.0), ("velocity", 4.0), ("pose", 3.0)):
        steps = np.abs(np.diff(getattr(table, part)[first - 1 :], axis=0))
        assert steps.max() <= most * H, (part, steps.max() / H)
    rates = np.diff(table.q[first:], axis=0) / H
    np.testing.assert_allclose(rates, 0.5 * (table.qdot[first:-1] + table.qdot[first + 1 :]), atol=5.0 * H)
    asked = Setpoint.side_by_side(motion.table, D)
    for part in ("pose", "velocity", "acceleration", "q", "qdot", "qddot"):
        np.testing.assert_array_equal(getattr(table, part)[-1], getattr(asked, part)[3499])


@settings(**SMALL)
@given(st.floats(-1, 1), st.floats(-3, 3), st.floats(0.5, 10.0), st.floats(0.3, 2.0), st.floats(0.0, 2.0))
def test_the_shortest_way_to_rest_is_that_of_another_solver(gap, rate, most, fastest, dt):
    """Against ruckig with a jerk that is as good as none."""
    ruckig = pytest.importorskip("ruckig")
    asked, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    asked.current_position, asked.current_velocity, asked.current_acceleration = [gap], [rate], [0.0]
    asked.target_position = [0.0]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [fastest], [most], [1e7]
    ruckig.Ruckig(1).calculate(asked, found)
    place, speed, _ = (value[0] for value in found.at_time(dt)[:3])
    np.testing.assert_allclose(brought_home(gap, rate, most, fastest, dt), (place, speed), atol=2e-3)
    one, two = brought_home(gap, rate, most, fastest, 0.3 * dt), brought_home(gap, rate, most, fastest, dt)
    np.testing.assert_allclose(brought_home(*one, most, fastest, 0.7 * dt), two, atol=1e-7)  # steps of any size


def test_a_path_from_here_begins_at_the_reference_pose_and_ends_in_a_stop():
    run = Run((0.5, 0.5))
    run.steps(300)
    before = run.now.pose.copy()
    motion = Motion.of(Trajectory(Line(0.3, (5.0, 6.0, 1.0)), ()), 1.0, H, D, from_here=True)
    table = run.steps(200, motion)
    direction = np.array([np.cos(before[2]), np.sin(before[2])])
    travelled = table.pose[-1, :2] - before[:2]
    assert travelled @ direction > 0.05 and abs(np.cross(np.append(direction, 0), np.append(travelled, 0))[2]) < 1e-9
    assert run.follower.is_moving
    table = run.steps(600)
    assert not table.velocity[-1].any() and not run.follower.is_moving


def test_base_and_arm_follow_different_wishes():
    run = Run()
    arm = Motion.of(Trajectory(None, swing()), 3.0, H, D)
    run.step((BaseVelocity((0.2, 0.1)), arm))
    assert run.follower.courses[ARM] is not None and run.follower.courses[BASE] is None
    for _ in range(200):
        run.step(BaseVelocity((0.2, 0.1)))
    np.testing.assert_allclose(run.now.velocity, [0.2, 0.1])
    asked = Setpoint.side_by_side(arm.table, D)
    table = run.steps(1000)
    np.testing.assert_array_equal(table.q[-1], asked.q[1200])
    assert not table.velocity[-1].any()  # nobody renewed it


def test_in_a_pause_a_motion_waits_and_then_goes_on():
    run, motion = Run(), Motion.of(Trajectory(Circle(1.0, 0.3, ramp=0.5), swing()), 4.0, H, D)
    run.steps(1000, motion)
    run.follower.pause((run.k - 1) * H)
    run.steps(1000)
    assert not run.now.velocity.any() and not run.now.qdot.any()
    run.follower.resume((run.k - 1) * H)
    table = run.steps(990)
    assert (
        np.abs(np.diff(table.q, axis=0)).max() <= 4.0 * H and np.abs(np.diff(table.velocity, axis=0)).max() <= 4.0 * H
    )
    np.testing.assert_array_equal(table.q[-1], Setpoint.side_by_side(motion.table, D).q[1989])


def test_points_are_passed_at_their_times():
    time, rng = np.array([0.5, 1.0, 1.8, 2.5]), np.random.default_rng(0)
    q, qdot, qddot = rng.normal(size=(3, 4, 2))
    at = np.round((time - 0.5) / H).astype(int)
    for parts in ({}, {"qdot": qdot}, {"qdot": qdot, "qddot": qddot}):
        motion = Motion.through(time, q, H, D, **parts)
        table = Setpoint.side_by_side(motion.table, D)
        np.testing.assert_allclose(table.q[at], q, atol=1e-9)
        for name in parts:
            np.testing.assert_allclose(getattr(table, name)[at], parts[name], atol=1e-9)
        np.testing.assert_allclose(np.gradient(table.q, H, axis=0)[2:-2], table.qdot[2:-2], atol=0.03)
    with pytest.raises(TrajectoryError, match="out of order"):
        Motion.through(time[::-1], q, H, D)
    with pytest.raises(TrajectoryError, match="shape"):
        Motion.through(time, q[:, :1], H, D)


# -- joints' ends ------------------------------------------------------------------------------------------------------


def bounded():
    """The robot with joints that end at -0.5 and 0.6."""
    lower, upper = ROBOT.lower.copy(), ROBOT.upper.copy()
    lower[ROBOT.arm_index], upper[ROBOT.arm_index] = -0.5, 0.6
    return replace(ROBOT, lower=lower, upper=upper)


@settings(**SMALL)
@given(st.floats(0.1, 3.0), st.floats(0.4, 6.0), st.floats(-1.0, 1.0), st.floats(-0.4, 0.5))
def test_no_reference_of_a_joint_passes_its_end_whatever_is_wished(amplitude, period, offset, start):
    run, rate = Run(q=(start, 0.0), robot=bounded()), 2 * np.pi / period
    for k in range(1500):
        angle, zero = rate * k * H, np.zeros(2)
        q, qdot = amplitude * np.sin(angle) + offset, amplitude * rate * np.cos(angle)
        run.step(Setpoint(np.zeros(3), zero, zero, np.array([q, 0.0]), np.array([qdot, 0.0]), zero))
    table = run.table()
    assert table.q[:, 0].min() >= min(-0.5, start) - 1e-9 and table.q[:, 0].max() <= 0.6 + 1e-9
    held = np.abs(table.q[1:, 0] - table.q[:-1, 0] - H * table.qdot[1:, 0]) < 1e-12
    change = np.abs(np.diff(table.qdot[:, 0]))[held]
    assert change.size == 0 or np.all((change <= 5.0 * H * 1.5) | (change <= amplitude * rate**2 * H * 1.5))


def test_a_reference_that_can_stop_in_time_is_left_as_it_is_and_caught_up_with():
    run, zero = Run(robot=bounded()), np.zeros(2)

    def asked(t):
        q, qdot = np.array([0.9 * np.sin(t), 0.0]), np.array([0.9 * np.cos(t), 0.0])
        return Setpoint(np.zeros(3), zero, zero, q, qdot, zero)

    for k in range(round(4 * np.pi / H)):
        run.step(asked(k * H))
    q, wished = run.table().q[:, 0], 0.9 * np.sin(np.arange(run.k) * H)
    inside = np.abs(wished - 0.05) < 0.25
    assert (q[inside] == wished[inside]).mean() > 0.8
    assert q.max() == pytest.approx(0.6, abs=1e-3) and q.min() == pytest.approx(-0.5, abs=1e-3)


# -- joint goals -------------------------------------------------------------------------------------------------------


@settings(**SMALL)
@given(st.floats(-1.5, 1.5), st.floats(-1, 1), st.floats(-2.0, 2.0))
def test_a_joint_goal_is_reached_at_rest_within_speed_acceleration_and_jerk(q, qdot, goal):
    pytest.importorskip("ruckig")
    run = Run(q=(q, 0.0), qdot=(qdot, 0.0))
    table = run.steps(3000, JointGoal((goal, -0.4)))
    np.testing.assert_allclose(table.q[-1], (goal, -0.4), atol=1e-7)
    assert not run.follower.is_moving and np.abs(table.qdot[-1]).max() < 1e-7
    assert np.abs(table.qdot).max() <= 2.0 + 1e-9 and np.abs(table.qddot).max() <= 5.0 + 1e-9
    assert np.abs(np.diff(table.qddot, axis=0)).max() <= 50.0 * H * (1 + 1e-6)
    np.testing.assert_allclose(np.diff(table.q, axis=0), H * 0.5 * (table.qdot[1:] + table.qdot[:-1]), atol=50 * H**3)


@pytest.mark.parametrize("acceleration", [0.0, 200.0, 1000.0])
@pytest.mark.parametrize("speed", [-5.0, 0.0, 5.0])
def test_a_joint_goal_after_a_setpoint_that_no_joint_follows_is_planned(speed: float, acceleration: float) -> None:
    """The planner refuses such a start by an error of its own."""
    pytest.importorskip("ruckig")
    run, still = Run(robot=bounded()), np.zeros(2)
    asked = Setpoint(np.zeros(3), still, still, np.zeros(2), np.array([0.0, speed]), np.array([0.0, acceleration]))
    for _ in range(5):
        run.step(asked)
    table = run.steps(4000, JointGoal((0.2, -0.3)))
    np.testing.assert_allclose(table.q[-1], (0.2, -0.3), atol=1e-6)


def test_a_goal_from_rest_takes_the_time_of_the_closed_form_and_waypoints_are_passed():
    pytest.importorskip("ruckig")
    run = Run()
    goal = run.follower.check(JointGoal((1.9, 0.0)))
    assert goal.duration == pytest.approx(1.9 / 2.0 + 2.0 / 5.0 + 5.0 / 50.0)  # d / v + v / a + a / j
    way = run.follower.check(JointGoal([[0.5, 0.2], [1.0, 0.0], [0.2, -0.3]], [[0.3, 0.0], [0.0, 0.1], [0.0, 0.0]]))
    wanted = np.zeros(run.follower.now.size)
    for end, q, qdot in zip(
        way.ends[1:], [[0.5, 0.2], [1.0, 0.0], [0.2, -0.3]], [[0.3, 0.0], [0.0, 0.1], [0, 0]], strict=True
    ):
        way.write(end, wanted)
        now = Setpoint.side_by_side(wanted, D)
        np.testing.assert_allclose((now.q, now.qdot), (q, qdot), atol=1e-9)


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wish", "text"),
    [
        (BaseVelocity((1.0, np.nan)), "base velocity"),
        (BaseVelocity((1.0,)), "base velocity"),
        (JointGoal((99.0, 0.0)), "arm_1_joint to 99.*its ends"),
        (JointGoal((0.0,)), "setpoint.q"),
        (JointGoal((0.1, 0.1), (99.0, 0.0)), "cannot be planned.*velocity limit"),
        (Motion(np.zeros((3, 5)), H, (ARM,), Dimensions(0, 1, 1, 1)), "another robot"),
        ("home", "a str as a setpoint"),
    ],
)
def test_wishes_of_another_robot_or_without_sense_are_one_line(wish, text):
    run = Run(robot=bounded())
    with pytest.raises(ConfigError, match=text) as caught:
        run.step(wish)
    assert "\n" not in str(caught.value)
    run.step(HOLD)


def test_limits_without_room_are_refused():
    with pytest.raises(ConfigError, match=r"limits\.joint_margin"):
        Follower(bounded(), Limits(joint_margin=0.6), 0.5)
    with pytest.raises(ConfigError, match=r"limits\.speed"):
        Limits(speed=0.0)
    with pytest.raises(ConfigError, match=r"limits\.joint_speed"):
        Limits(joint_speed="fast")


def arc(period: float = H) -> Motion:
    """Two seconds of a bend of the base, and of both joints, from rest to rest."""
    t = np.arange(round(2.0 / period) + 1) * period
    s, v, a = 0.3 * (0.75 * t**2 - 0.25 * t**3), 0.3 * (1.5 * t - 0.75 * t * t), 0.3 * (1.5 - 1.5 * t)
    table = np.zeros((len(t), 13))
    table[:, 0], table[:, 1], table[:, 2] = np.sin(s), 1 - np.cos(s), s  # an arc of radius 1 m
    table[:, 3] = table[:, 4] = v
    table[:, 5] = table[:, 6] = a
    for i, reach in enumerate((1.0, -2.0)):
        table[:, 7 + i], table[:, 9 + i], table[:, 11 + i] = reach * s, reach * v, reach * a
    return Motion(table, period, (BASE, ARM), D)


@settings(**SMALL)
@given(st.lists(st.tuples(st.floats(0.0, 1.5), st.floats(0.0, 1.0)), min_size=1, max_size=4))
def test_at_any_pace_the_path_is_the_same_and_no_limit_is_passed(changes: list[tuple[float, float]]) -> None:
    """Second answer: the arc's closed form in its own length, and differences of what the reference is."""
    run = Run()
    run.step(arc())
    for k in range(round(2.0 / H)):
        run.follower.share = next((share for time, share in reversed(changes) if time <= k * H), 1.0)
        run.step()
    run.follower.share = 1.0
    run.steps(round(4.0 / H))
    table = run.table()
    s = table.q[:, 0]
    assert table.pose == pytest.approx(np.stack([np.sin(s), 1 - np.cos(s), s], axis=1), abs=1e-6)
    assert table.q[:, 1] == pytest.approx(-2 * s, abs=1e-9) and s[-1] == pytest.approx(0.3, abs=1e-9)
    assert (np.diff(s) >= -1e-12).all()
    for rate, bend, most in (
        (table.qdot[:, 0], table.qddot[:, 0], 5.0), (table.velocity[:, 0], table.acceleration[:, 0], 1.0),
    ):  # fmt: skip
        assert np.diff(s) / H == pytest.approx(0.5 * (rate[1:] + rate[:-1]), abs=2e-4)
        slope, ends = np.diff(rate) / H, np.stack((bend[1:], bend[:-1]))
        beyond = np.maximum(slope - ends.max(axis=0), ends.min(axis=0) - slope)  # of what is said at a step's two ends
        assert np.quantile(beyond, 0.98) < 1e-6  # all but where a change begins or ends
        assert np.abs(bend).max() < 0.45 + most + 1e-3 and rate.max() <= 0.225 + 1e-9


def test_half_the_pace_takes_twice_as_long() -> None:
    run = Run()
    run.follower.share = 0.5
    run.step()
    run.steps(round(4.0 / H) - 1, arc())
    assert run.table().q[-1, 0] < 0.3 - 1e-7 and run.steps(4).q[-1, 0] == pytest.approx(0.3, abs=1e-9)
