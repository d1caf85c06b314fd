"""What moves is what was asked (docs/how-to/realtime.md, "The promise"): a property of random wishes, times and pauses.

The judge knows nothing of how a reference is made: it looks at the samples, the wishes and the limits alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test
from test_holonomic import mecanum

from mmnn_pin import load
from mmnn_pin.errors import ConfigError
from mmnn_pin.reference.drive import RouteDrive
from mmnn_pin.reference.follower import Follower
from mmnn_pin.reference.guide import ARM, BASE
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.route import Route
from mmnn_pin.reference.wishes import HOLD, BaseVelocity, JointGoal, Motion
from mmnn_pin.signals import Setpoint

PLATFORM = load("platform_arm")
OMNI = mecanum()
PERIOD = 0.004
TIMEOUT = 0.2
CLOSE = 1e-7


def bounded(robot, low, high):
    """A robot with other ends of its joints."""
    lower, upper = robot.lower.copy(), robot.upper.copy()
    lower[robot.arm_index], upper[robot.arm_index] = low, high
    return replace(robot, lower=lower, upper=upper)


@dataclass
class Asked:
    """What holds from a wish for the arm on: where its joints may go, and how hard they may be pushed."""

    low: np.ndarray
    high: np.ndarray
    most: np.ndarray
    goal: np.ndarray | None = None


def braking(rate, bend, a, jerk):
    """The farthest that braking within acceleration and jerk may take, in either direction (an upper bound)."""
    speed = np.abs(rate) + bend**2 / (2 * jerk)
    return speed**2 / (2 * a) + speed * (a + np.abs(bend)) / jerk + np.abs(bend) ** 3 / (3 * jerk**2)


class Promise(RuleBasedStateMachine):
    """A follower that is asked at random, late and irregularly; its robot is where its reference is."""

    @initialize(seed=st.integers(0, 2**32 - 1), sideways=st.booleans(), stated=st.booleans(), outside=st.booleans())
    def begin(self, seed, sideways, stated, outside):
        self.rng = rng = np.random.default_rng(seed)
        robot = OMNI if sideways else PLATFORM
        self.d = d = robot.dimensions
        n = d.arm
        self.speed, self.a = rng.uniform(0.3, 4.0, n), rng.uniform(1.0, 15.0, n)
        self.jerk = self.a * rng.uniform(5.0, 50.0)
        self.base_speed = np.array([rng.uniform(0.2, 1.5), rng.uniform(0.3, 2.0)])
        self.base_a = np.array([rng.uniform(0.3, 2.0), rng.uniform(0.5, 4.0)])
        self.low, self.high = -rng.uniform(0.2, 2.0, n), rng.uniform(0.2, 2.0, n)
        self.stated = stated
        self.limits = limits = Limits(
            *self.base_speed, *self.base_a, tuple(self.speed), tuple(self.a) if stated else None, tuple(self.jerk)
        )
        if not stated:
            self.a = np.full(n, 5.0)
        self.robot = bounded(robot, self.low, self.high)
        self.follower = Follower(self.robot, limits, TIMEOUT)
        q, qdot = rng.uniform(self.low, self.high), rng.uniform(-1.2, 1.2, n) * self.speed
        if outside:  # a little beyond an end, at rest, as on a hard stop
            q[0], qdot[0] = self.high[0] + 10.0 ** rng.uniform(-6, -2), 0.0
        velocity = rng.uniform(-0.7, 0.7, d.base) * self.per_velocity(self.base_speed)
        self.follower.stand(np.concatenate((rng.normal(size=d.pose), velocity, q, qdot)))
        self.now = Setpoint.side_by_side(self.follower.now, d)
        self.time, self.first, self.over = 0.0, True, []
        self.arm_asked = None
        self.base_kind, self.resting, self.base_goal = "hold", self.base_rest(), None
        self.ask_hold()

    # -- what may be asked ---------------------------------------------------------------------------------------------

    def per_velocity(self, pair):
        return np.array([pair[0]] * (self.d.base - 1) + [pair[1]])

    def state(self):
        return self.now.q.copy(), self.now.qdot.copy(), self.now.qddot.copy()

    def ask_hold(self):
        q, qdot, _ = self.state()
        stop = np.clip(q + qdot * np.abs(qdot) / (2 * self.a), self.low, self.high)  # from outside, to the end
        self.arm_asked = Asked(np.minimum(q, stop), np.maximum(q, stop), self.a)

    @rule(steps=st.integers(1, 60))
    def go_on(self, steps):
        for _ in range(steps):
            self.step()

    @rule(steps=st.integers(1, 5), late=st.floats(0.1, 30.0))
    def go_on_irregularly(self, steps, late):
        for _ in range(steps):
            self.step(dt=PERIOD * late)

    @rule()
    def brake(self):
        self.ask_hold()
        self.base_kind, self.resting = "hold", self.time + self.base_rest()
        self.step((HOLD,))

    @rule(far=st.floats(0.0, 1.0), lines=st.integers(1, 2))
    def goal(self, far, lines):
        q, qdot, qddot = self.state()
        goals = np.clip(q + far * self.rng.uniform(-2, 2, (lines, self.d.arm)), self.low, self.high)
        more = braking(qdot, qddot, self.a, self.jerk)
        ends = np.vstack((q, goals))
        self.try_arm(JointGoal(goals), Asked(ends.min(axis=0) - more, ends.max(axis=0) + more, self.a, goals[-1]))

    @rule(
        duration=st.floats(0.02, 1.5),
        points=st.integers(1, 4),
        far=st.floats(0.0, 1.0),
        off=st.floats(0.0, 0.1),
        period=st.sampled_from([PERIOD, PERIOD, 0.01, 0.1]),
    )
    def plan(self, duration, points, far, off, period=PERIOD):
        """A plan through points at times, from where the arm is or a little beside it."""
        q, qdot, _ = self.state()
        at = np.append(0.0, np.sort(self.rng.uniform(0.1, 1.0, points))) * duration
        at[-1] = duration
        if (np.diff(at) < 2 * period).any():  # finer than its samples
            return
        first = q + off * self.rng.normal(size=q.size)
        way = np.cumsum(np.vstack((np.zeros(q.size), far * duration * self.rng.normal(size=(points, q.size)))), axis=0)
        motion = Motion.through(at, first + way, period, self.d)
        table = Setpoint.side_by_side(motion.table, self.d)
        most = np.maximum(np.abs(table.qddot).max(axis=0), np.abs(np.diff(table.qdot, axis=0)).max(axis=0) / period)
        most = np.maximum(self.a, most if period == PERIOD else 1.3 * most)  # which its samples may not show
        more = np.abs(qdot) ** 2 / (2 * self.a)
        ends = np.vstack((q, table.q, self.between(motion)))
        ends = np.vstack((ends, np.clip(ends, self.low, self.high)))  # from outside it is led back
        asked = Asked(ends.min(axis=0) - more, ends.max(axis=0) + more, most, table.q[-1])
        taken = self.try_arm(motion, asked)
        fits = (np.abs(table.qdot).max(axis=0) <= self.speed).all() and (not self.stated or (most <= self.a).all())
        inside = (table.q >= np.minimum(self.low, q)).all() and (table.q <= np.maximum(self.high, q)).all()
        assert taken or not (fits and inside), "a plan within the limits is refused"

    @rule(
        points=st.integers(1, 6),
        far=st.floats(0.05, 0.7),
        aside=st.sampled_from([0.0, 0.02, 0.5]),
        steps=st.integers(1, 200),
    )
    def path(self, points, far, aside, steps):
        """A planner's path without headings from where the base is, or a little or far aside, also while it moves."""
        way = self.now.pose[:2] + aside * self.rng.normal(size=2)
        way = way + np.vstack((np.zeros(2), np.cumsum(far * self.rng.normal(size=(points, 2)), axis=0)))
        unknown = np.full(len(way), np.nan)
        route = Route.of(way, unknown, np.zeros(len(way), bool))
        motion = RouteDrive.along(route, self.robot, self.limits, 1.0, PERIOD)
        self.follower.check(motion)
        self.base_kind, self.base_goal = "path", way[-1]
        for k in range(steps):
            self.step(motion if k == 0 else None)

    @rule(rate=st.floats(0.0, 3.0), hz=st.sampled_from([20.0, 50.0, 250.0]), count=st.integers(1, 8))
    def jog(self, rate, hz, count):
        """Joint targets one after the other without rates, as a teleoperator or a policy sends them."""
        d, aim = self.d, self.now.q.copy()
        pose, still = self.now.pose.copy(), np.zeros(d.base)
        for _ in range(count):
            q, qdot, _ = self.state()
            aim = np.clip(aim + rate / hz * self.rng.uniform(-1, 1, d.arm), self.low, self.high)
            more = np.abs(qdot) ** 2 / (2 * self.a)
            low, high = np.minimum(q, aim) - more, np.maximum(q, aim) + more
            self.arm_asked, self.base_kind = Asked(low, high, self.a), "sample"
            wish = Setpoint(pose, still, still, aim, np.zeros(d.arm), np.zeros(d.arm))
            for k in range(max(1, round(1.0 / hz / PERIOD))):
                self.step(wish if k == 0 else None)
        self.after_samples()

    @rule(count=st.integers(1, 60), size=st.floats(0.0, 1.5), jump=st.floats(0.0, 0.5))
    def stream(self, count, size, jump):
        """Full samples of a smooth motion of base and arm, from a little beside the reference."""
        d, w = self.d, self.rng.uniform(0.5, 4.0, self.d.arm)
        base = size * 0.5 * self.rng.uniform(-1, 1, d.base) * self.per_velocity(self.base_speed)
        start = self.now.q.copy()
        pose, offset = self.now.pose + jump * self.rng.normal(size=d.pose), jump * self.rng.normal(size=d.arm)
        self.arm_asked, self.base_kind = None, "sample"
        for k in range(count):
            t, swing = k * PERIOD, size * self.speed / w
            q, qdot = start + offset + swing * (1 - np.cos(w * t)), swing * w * np.sin(w * t)
            anywhere = np.full(d.arm, np.inf)
            self.arm_asked = Asked(-anywhere, anywhere, np.maximum(1.5 * self.a, 2 * swing * w * w))
            self.step(Setpoint(pose, base, 0 * base, q, qdot, swing * w * w * np.cos(w * t)))
            c, s = np.cos(pose[2] + base[-1] * PERIOD / 2), np.sin(pose[2] + base[-1] * PERIOD / 2)
            side = base[1] if d.base == 3 else 0.0
            pose = pose + PERIOD * np.array([c * base[0] - s * side, s * base[0] + c * side, base[-1]])
        self.after_samples()

    @rule(x=st.floats(-3, 3), y=st.floats(-3, 3), turn=st.floats(-4, 4), count=st.integers(1, 20))
    def cmd_vel(self, x, y, turn, count):
        wish = (x, turn) if self.d.base == 2 else (x, y, turn)
        self.base_kind = "velocity"
        for k in range(count):
            self.step(BaseVelocity(wish) if k % 5 == 0 else None)

    @rule(count=st.integers(1, 80))
    def pause(self, count):
        moving, asked = self.follower.courses[ARM] is not None, self.arm_asked
        on_its_way = self.follower.courses[BASE] is not None
        self.ask_hold()
        self.follower.pause(self.time)
        self.base_kind, self.resting = "hold", self.time + self.base_rest()
        for _ in range(count):
            self.step()
        self.follower.resume(self.time)
        if on_its_way:
            self.base_kind = "path"
        if moving:
            ends = self.arm_asked
            self.arm_asked = replace(asked, low=np.minimum(asked.low, ends.low), high=np.maximum(asked.high, ends.high))

    def between(self, motion):
        """Places of a motion between its samples, as their rates imply them."""
        room, found = np.zeros(self.follower.now.size), []
        for time in np.linspace(0.0, motion.duration, 200 if motion.period > PERIOD else 2):
            motion.write(time, room)
            found.append(Setpoint.side_by_side(room, self.d).q.copy())
        return np.array(found)

    # -- one sample and its judge --------------------------------------------------------------------------------------

    def after_samples(self):
        """The samples end: within the timeout and the braking the robot stands."""
        self.arm_asked = Asked(np.full(self.d.arm, -np.inf), np.full(self.d.arm, np.inf), self.arm_asked.most)

    def base_rest(self):
        return float(np.max(np.abs(self.now.velocity) / self.per_velocity(self.base_a), initial=0.0))

    def try_arm(self, wish, asked):
        """Whether a wish for the arm is taken; one that is not changes nothing."""
        before = self.follower.now.copy()
        try:
            self.follower.check(wish)
        except ConfigError as error:
            assert error.what and error.fix
            np.testing.assert_array_equal(self.follower.now, before)
            return False
        self.arm_asked = asked
        if self.base_kind == "sample":
            self.base_kind = "any"
        self.step((wish,))
        return True

    def step(self, wish=None, dt=PERIOD):
        wishes = () if wish is None else wish if isinstance(wish, tuple) else (wish,)
        before = Setpoint.side_by_side(self.follower.now.copy(), self.d)
        measured = np.concatenate((self.now.pose, self.now.velocity, self.now.q, self.now.qdot))
        courses = [self.follower.check(one) for one in wishes]
        dt = 0.0 if self.first else dt
        self.time += dt
        self.follower.step(self.time, dt, measured, wishes, courses)
        self.first = False
        if any(isinstance(one, Setpoint | BaseVelocity) for one in wishes):
            self.renewed = self.time
        elif self.base_kind in ("sample", "velocity") and self.time - self.renewed > TIMEOUT:
            self.resting = self.time - dt + float(np.max(np.abs(before.velocity) / self.per_velocity(self.base_a)))
            self.base_kind = "hold"
        self.judge_arm(before, dt)
        self.judge_base(before, dt)

    def judge_arm(self, before, dt):
        q, v, q0, v0, asked = self.now.q, self.now.qdot, before.q, before.qdot, self.arm_asked
        assert np.isfinite(self.follower.now).all()
        assert (np.abs(v) <= np.maximum(self.speed * 1.011, np.abs(v0) + CLOSE)).all(), "faster than its limit"
        out0, out = (np.maximum(x - self.high, self.low - x) for x in (q0, q))
        assert (out <= np.maximum(out0, 0.0) + 2e-6).all(), "beyond an end"
        room = np.where(v0 > 0, self.high - q0, q0 - self.low)
        late = v0**2 > 2 * self.a * np.maximum(room, 0.0) * (1 - 1e-6) - CLOSE  # it cannot stop within its acceleration
        most = asked.most * 1.1 * dt + 1e-6  # a plan's own is known at its samples only
        assert (late | (np.abs(v - v0) <= most)).all(), "pushed harder than its limit"
        drift = np.abs(q - q0 - 0.5 * (v + v0) * dt)
        assert (late | (drift <= 0.5 * most * dt + 1e-7)).all(), "places that its rates do not explain"
        inside = (q >= asked.low - 1e-5) | (q >= q0), (q <= asked.high + 1e-5) | (q <= q0)
        assert (late | (inside[0] & inside[1])).all(), "it leaves the interval of start and goal"

    def judge_base(self, before, dt):
        v, v0 = self.now.velocity, before.velocity
        top, a = self.per_velocity(self.base_speed), self.per_velocity(self.base_a)
        most = np.maximum(top, np.abs(v0)) * (1 + 1e-6) + CLOSE
        assert (np.abs(v) <= most).all(), "the base is faster than its limit"
        if self.base_kind in ("hold", "velocity"):
            assert (np.abs(v - v0) <= a * dt * (1 + 1e-6) + CLOSE).all(), "the base is pushed harder than its limit"
        if self.base_kind == "path":  # a curve of a few centimetres is timed on a grid that is coarse for it
            assert (np.abs(v - v0) <= 2.2 * a * dt + CLOSE).all(), "a path pushes the base harder than its limit"
        if self.base_kind == "hold":
            assert np.linalg.norm(np.outer(v, v0) - np.outer(v0, v)) <= 1e-9, "braking bends its way"
            assert self.time < self.resting + CLOSE or not v.any(), "it does not rest in time"

    def teardown(self):
        """Whatever was asked last: after it is reached, or the samples end, everything stands, at the last goal."""
        if not hasattr(self, "follower"):
            return
        for _ in range(12_000):
            self.step()
            moves = self.now.qdot.any() or self.now.velocity.any()
            if not self.follower.is_moving and self.time > 1.0 and not moves:
                break
        assert not self.now.qdot.any() and not self.now.velocity.any(), "it does not come to rest"
        if self.base_kind == "path":
            np.testing.assert_allclose(self.now.pose[:2], self.base_goal, atol=0.011)  # nearer it is not driven to
        if self.arm_asked.goal is not None:
            goal = np.clip(self.arm_asked.goal, self.low, self.high)  # from outside it is led back
            np.testing.assert_allclose(self.now.q, goal, atol=2e-6)


FEW = {"deadline": None, "phases": (Phase.generate,), "suppress_health_check": list(HealthCheck)}


def test_whatever_is_asked_the_reference_moves_as_asked_within_its_limits_or_stops():
    run_state_machine_as_test(
        Promise, settings=settings(max_examples=60, stateful_step_count=20, derandomize=True, **FEW)
    )


@pytest.mark.long
def test_a_hundred_thousand_sequences_keep_the_promise():
    run_state_machine_as_test(Promise, settings=settings(max_examples=100_000, stateful_step_count=12, **FEW))
