"""Paths of the base timed along their length: they keep to their limits, waste none, and agree with closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mmnn_pin import load
from mmnn_pin.errors import TrajectoryError
from mmnn_pin.reference import Circle, Eight, Smoothed, Timed, Trajectory, Waypoints
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.wishes import Motion

POINTS = ((0.0, 0.0), (3.0, 0.0), (3.0, 2.5), (6.0, 4.0))
LIMITS = {"speed": 0.8, "yaw_rate": 1.2, "acceleration": 0.6, "yaw_acceleration": 1.5, "lateral": 0.4}


def axle(track: float, rim: float) -> tuple[tuple[float, float, float], ...]:
    """Two drive wheels at a distance, whose rims reach a speed."""
    return (1.0, -track / 2, rim), (1.0, track / 2, rim)


def used(path: Timed, count: int = 1001) -> dict[str, np.ndarray]:
    """Share of every limit over time."""
    t = np.linspace(0, path.duration, count)[1:-1]
    one = path.sample(t)
    (v, w), (vdot, wdot) = one.velocity.T, one.acceleration.T
    wheels = [abs(a * v + b * w) / most for a, b, most in path.wheels] or [np.zeros_like(v)]
    return {
        "speed": abs(v) / path.speed, "yaw_rate": abs(w) / path.yaw_rate, "wheels": np.max(wheels, axis=0),
        "lateral": abs(v * w) / path.lateral, "acceleration": abs(vdot) / path.acceleration,
        "yaw_acceleration": abs(wdot) / path.yaw_acceleration,
    }  # fmt: skip


@given(
    radius=st.floats(0.2, 0.6), speed=st.floats(0.2, 2.0), yaw_rate=st.floats(0.3, 3.0), acceleration=st.floats(0.2, 2),
    yaw_acceleration=st.floats(0.5, 4.0), lateral=st.floats(0.1, 2.0),
    rim=st.floats(0.3, 2.0), sign=st.sampled_from([1, -1]),
)  # fmt: skip
@example(
    radius=0.21875, speed=1.0, sign=1, yaw_rate=1.0, acceleration=1.0, yaw_acceleration=1.0, lateral=1.0, rim=1.0
)  # fmt: skip
@settings(max_examples=5, deadline=None)
def test_it_keeps_to_every_limit_and_is_always_at_one(radius, speed, sign, **limits):
    wheels = axle(0.5, limits.pop("rim"))
    path = Timed(Waypoints(POINTS, sign * 0.5, radius, ramp=0.0), speed, wheels=wheels, **limits)
    shares = np.array(list(used(path).values()))
    assert shares.max() < 1.05  # between the points of its grid
    assert np.mean(shares.max(axis=0) > 0.9) > 0.95  # no faster way: some limit is used up nearly always
    ends = path.sample([0.0, path.duration, path.duration + 1])
    assert np.abs(ends.velocity).max() < 1e-6
    assert ends.pose[-1, :2] == pytest.approx(POINTS[-1], abs=1e-9) and ends.pose[0, :2] == pytest.approx(POINTS[0])


@given(st.floats(0.5, 20), st.floats(0.2, 2), st.floats(0.2, 2))
@settings(max_examples=6, deadline=None)
def test_a_straight_line_is_driven_by_the_trapezoid(length, speed, acceleration):
    path = Timed(Waypoints(((0.0, 0.0), (length, 0.0)), 0.5, 0.3, ramp=0.0), speed, acceleration=acceleration)
    up = speed**2 / acceleration
    closed = length / speed + speed / acceleration if length > up else 2 * math.sqrt(length / acceleration)
    assert path.duration == pytest.approx(closed, rel=0.01)


def test_a_wheel_that_turns_slowly_sets_the_pace():
    straight = Waypoints(((0.0, 0.0), (10.0, 0.0)), 0.5, 0.3, ramp=0.0)
    slow = Timed(straight, 2.0, acceleration=5.0, wheels=axle(0.5, 0.4))
    assert np.abs(slow.sample(np.linspace(0, slow.duration, 999)).velocity[:, 0]).max() == pytest.approx(0.4, rel=1e-6)
    corner = Waypoints(POINTS, 0.5, 0.4, ramp=0.0)
    narrow, wide = (Timed(corner, **LIMITS, wheels=axle(track, 0.8)) for track in (0.1, 1.0))
    assert wide.duration > narrow.duration * 1.01  # the outer wheel is faster on a wide base


@pytest.mark.parametrize("period", [10.0, -10.0])
def test_one_lap_of_an_eight_either_way(period):
    path = Timed(Eight(3.0, 1.5, period), **LIMITS)
    shares = np.array(list(used(path).values()))
    assert shares.max() < 1.05 and np.mean(shares.max(axis=0) > 0.9) > 0.95
    ends = path.sample([0.0, path.duration]).pose
    assert ends[1, :2] == pytest.approx(ends[0, :2], abs=1e-6)
    v = path.sample(np.linspace(0, path.duration, 99)[1:-1]).velocity[:, 0]
    assert (np.sign(v) == np.sign(period)).all()


@given(st.floats(0.05, 0.95))
@settings(max_examples=4, deadline=None)
def test_velocities_are_the_derivative_of_the_path(share):
    path = Timed(Waypoints(POINTS, 0.5, 0.4, ramp=0.0), **LIMITS)
    t, h = share * path.duration, 1e-6
    before, here, after = path.sample([t - h, t, t + h]).pose
    v, w = path.sample([t]).velocity[0]
    moved = (after - before) / (2 * h)
    assert moved == pytest.approx([v * math.cos(here[2]), v * math.sin(here[2]), w], abs=1e-4)


@given(st.floats(0.3, 3.0), st.floats(-1.0, 1.0), st.booleans(), st.integers(0, 1000))
@settings(max_examples=5, deadline=None)
def test_points_of_a_planner_are_smoothed_and_timed(length, bent, tail_first, seed):
    """Noisy points on an arc: near them all, to every limit, and the derivatives of its curve by finite differences."""
    along, noise = np.linspace(0.0, length, 40), np.random.default_rng(seed).normal(0.0, 0.003, (40, 2))
    points = np.stack([along, 0.3 * bent * along**2], axis=1) + noise
    smooth = Smoothed(points, 3.0 if tail_first else 0.1)
    s, h = np.linspace(0.05, 0.95, 41) * smooth.span, 1e-6
    here, before, after = (smooth.curve(s + d) for d in (0.0, -h, h))
    for one, rate in (("x", here.g * np.cos(here.phi)), ("y", here.g * np.sin(here.phi)), ("phi", here.k)):
        assert (getattr(after, one) - getattr(before, one)) / (2 * h) == pytest.approx(rate, abs=1e-5)
    for one, rate in (("g", here.dg), ("k", here.dk)):
        assert (getattr(after, one) - getattr(before, one)) / (2 * h) == pytest.approx(rate, rel=1e-4, abs=1e-3)
    path = Timed(smooth, **LIMITS, wheels=axle(0.5, 0.6))
    shares = np.array(list(used(path).values()))
    assert shares.max() < 1.1 and np.mean(shares.max(axis=0) > 0.9) > 0.9
    driven = path.sample(np.linspace(0.0, path.duration, 2000))
    assert np.hypot(*(driven.pose[:, None, :2] - points[None]).T).min(axis=1).max() < 0.06
    assert (driven.velocity[:, 0] <= 1e-9).all() if tail_first else (driven.velocity[:, 0] >= -1e-9).all()
    assert abs(driven.velocity[[0, -1]]).max() < 1e-6


@given(
    st.lists(st.tuples(st.floats(0.1, 1.5), st.floats(-1.75, 1.75)), min_size=1, max_size=8), st.floats(0.005, 0.03)
)  # fmt: skip
@settings(max_examples=100)
def test_a_smooth_way_stays_within_its_bound_and_keeps_its_ends(stretches, wander):
    """Beside a planner's points at 5 cm, with corners of up to 100 degrees."""
    ways = np.cumsum([turn for _, turn in stretches])
    corners = np.vstack(
        [
            (0.0, 0.0),
            *(length * np.array([np.cos(a), np.sin(a)]) for (length, _), a in zip(stretches, ways, strict=True)),
        ]
    )
    corners = np.cumsum(corners, axis=0)
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(corners, axis=0).T)))
    at = np.union1d(np.arange(0.0, along[-1], 0.05), along)
    points = np.stack([np.interp(at, along, column) for column in corners.T], axis=1)
    smooth = Smoothed(points, wander=wander)
    curve = smooth.curve(np.linspace(0.0, smooth.span, 3000))
    way = np.stack([curve.x, curve.y], axis=1)
    assert way[[0, -1]] == pytest.approx(points[[0, -1]], abs=1e-9)
    bound = Smoothed.FARTHEST * wander + Smoothed.NEAR  # a point near the one before is left out
    assert np.hypot(*(way[:, None] - points).transpose(2, 0, 1)).min(axis=0).max() < bound
    fine = np.stack([np.interp(np.linspace(0.0, along[-1], 2000), along, column) for column in corners.T], axis=1)
    assert np.hypot(*(way[::10, None] - fine).transpose(2, 0, 1)).min(axis=1).max() < bound
    assert curve.g.min() > 0.2  # it never stands, and so has a heading everywhere


@given(st.floats(0.05, 0.79), st.floats(0.6, 3.0))
def test_a_way_begun_in_motion_is_driven_by_the_rest_of_the_trapezoid(pace, length):
    path = Timed(Waypoints(((0.0, 0.0), (length, 0.0)), 0.5, 0.3, ramp=0.0), pace=pace, **LIMITS)
    speed, a = LIMITS["speed"], LIMITS["acceleration"]
    top = min(speed, math.sqrt(a * length + pace**2 / 2))
    ramps = (top - pace) / a + top / a
    closed = ramps + (length - (2 * top**2 - pace**2) / (2 * a)) / top
    assert path.duration == pytest.approx(closed, rel=0.01)
    assert path.sample([0.0]).velocity[0, 0] == pytest.approx(pace)
    assert path.fastest_entry == pytest.approx(min(speed, math.sqrt(2 * a * length)), rel=1e-3)


def test_a_robots_wheels_and_a_motion_of_it():
    robot = load("platform_arm")
    path = Timed.of(Waypoints(POINTS, 0.5, 0.4, ramp=0.0), robot, Limits(speed=0.7), lateral=0.5)
    assert path.speed == 0.7 and path.lateral == 0.5
    (a, b, most), (c, d, _) = path.wheels
    first, second = robot.base.wheels[:2]
    assert (1 / a, 1 / c) == pytest.approx((first.radius, second.radius)) and most == 30.0
    assert abs(b / a - d / c) == pytest.approx(robot.base.track)
    motion = Motion.of(Trajectory(path), path.duration, 0.002, robot.dimensions)
    assert motion.table[-1, :2] == pytest.approx(POINTS[-1], abs=1e-3)


@pytest.mark.parametrize(("more", "words"), [
    ({"speed": 0.0}, "speed = 0.0 is not positive"),
    ({"lateral": -1.0}, "lateral = -1.0 is not positive"),
    ({"wheels": axle(0.5, math.nan)}, "wheels = nan is not finite"),
])  # fmt: skip
def test_bad_limits_are_refused(more, words):
    with pytest.raises(TrajectoryError, match=words):
        Timed(Waypoints(POINTS, 0.5, 0.4, ramp=0.0), **more)
    with pytest.raises(TrajectoryError, match="cannot be timed"):
        Timed(Circle(1.0, 0.5))
    for points, why in (
        ([[1.0, 1.0]] * 5, "all in one place"),
        ([1.0, 2.0], "two or more"),
        ([[0, 0], [1, math.nan]], "finite"),
    ):
        with pytest.raises(TrajectoryError, match=why):
            Smoothed(points)
