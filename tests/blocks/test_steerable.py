"""References of bases that steer: what is accepted can be steered, and what is refused tells how."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
import steerable as steered
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mmnn_pin import load
from mmnn_pin.errors import ConfigError, RobotError, TrajectoryError
from mmnn_pin.model.base.rolling import MASTER, STEERED, TURN, new_maps, roll
from mmnn_pin.model.base.stance import along, bends
from mmnn_pin.model.base.steered import SteeredBase
from mmnn_pin.reference import Circle, Eight, HolonomicPath, Line, Parking, Sine, Timed, Trajectory, Waypoints
from mmnn_pin.reference.drive import RouteDrive
from mmnn_pin.reference.follower import Follower
from mmnn_pin.reference.guide import advance, brake, drive, new_guide, stand
from mmnn_pin.reference.guide import roll as rolled_on
from mmnn_pin.reference.hand import HandLine, Task, WholeBody, plan
from mmnn_pin.reference.limits import Limits, rims
from mmnn_pin.reference.motion import Motion
from mmnn_pin.reference.route import Route
from mmnn_pin.reference.steerable import (
    OF_RATE,
    OF_STOPS,
    Enlarged,
    curvatures,
    fitted,
    in_columns,
    needs_of,
    require_steerable,
    start_angles,
)
from mmnn_pin.signals import Dimensions, Setpoint


def dimensions_of(base: SteeredBase) -> Dimensions:
    return Dimensions(len(base.velocity_names), 0, 20, len(base.driven), base.kind, base.sideways, len(base.shape))


def sampled(trajectory: Trajectory, base: SteeredBase, duration: float, count: int = 4001):
    t, d = np.linspace(0.0, duration, count), dimensions_of(base)
    return t, Setpoint.side_by_side(trajectory.table(t, d), d)


def moved(base: SteeredBase, angles: np.ndarray, rates: np.ndarray, twist: np.ndarray):
    """The twist and the pivots' rates that `rolling` makes of joint angles and rates (K,), driven as along a twist."""
    places = {name: 3 + i for i, name in enumerate(base.shape)} | {w.joint: 12 + i for i, w in enumerate(base.wheels)}
    rolling, nb = base.rolling_at(places), len(base.velocity_names)
    maps = new_maps(rolling, np.zeros((30, nb)))
    position, nu = np.zeros(30), np.zeros(nb)
    for k, name in enumerate(base.shape):
        position[places[name]] = angles[k]
        if rolling.turns[k, TURN.role] == MASTER:
            nu[rolling.turns[k, TURN.column]] = rates[k]
    maps.n[:] = twist * np.array([1.0, 1.0, base.length])
    maps.n[:] /= np.linalg.norm(maps.n)
    roll(rolling, position, nu, maps)
    if base.body == STEERED:
        nu[0] = maps.V[0][:, 0] @ (np.array([1.0, 1.0, base.length**2]) * twist)
    else:
        nu[:3] = twist
    roll(rolling, position, nu, maps)
    return maps.eta, np.array([maps.T[places[name]] @ nu for name in base.shape])


def wave(rng: np.random.Generator, t: np.ndarray, size: float, about: float = 0.0):
    """A smooth signal and its derivative."""
    a, w, p = rng.uniform(0, size, 3), rng.uniform(0.3, 2.0, 3), rng.uniform(0, 6, 3)
    return about + np.sum(a * np.sin(np.outer(t, w) + p), 1), np.sum(a * w * np.cos(np.outer(t, w) + p), 1)


# -- how pivots stand --------------------------------------------------------------------------------------------------


@given(st.sampled_from(["car", "other way round", "tricycle", "swerve"]), st.integers(0, 999))
@settings(max_examples=20, deadline=None)
def test_a_base_that_stands_as_it_should_moves_as_asked(name, seed):
    """Second answer: the mechanism of `rolling`, which knows nothing of paths."""
    makes = {"car": steered.car, "other way round": lambda: steered.car(sign=-1.0), "tricycle": steered.tricycle}
    base, rng = {**makes, "swerve": steered.swerve}[name](), np.random.default_rng(seed)
    t = np.linspace(0.0, 4.0, 401)
    (v, vdot), (k, kdot) = wave(rng, t, 0.1, rng.choice([-1.0, 1.0]) * 0.6), wave(rng, t, 0.2)
    twist, change = np.stack([v, 0 * v, k * v], 1), np.stack([vdot, 0 * v, k * vdot + kdot * v], 1)
    if base.sideways:
        twist[:, 1], change[:, 1] = wave(rng, t, 0.1)
    stance = along(base.pivots, t, twist, change)
    assert stance.fits.all() and stance.moves.all()
    np.testing.assert_allclose(np.gradient(stance.angles, t, axis=0)[2:-2], stance.rates[2:-2], atol=2e-3)
    for i in (0, 150, 400):
        eta, rates = moved(base, stance.angles[i], stance.rates[i], twist[i])
        np.testing.assert_allclose(eta, twist[i], atol=1e-12)
        np.testing.assert_allclose(rates, stance.rates[i], atol=1e-10)


@pytest.mark.parametrize("speed", [0.5, -0.5])
@pytest.mark.parametrize("curvature", [-0.3, 0.0, 0.4])
def test_a_waist_and_hitches_stand_along_a_circle(speed, curvature):
    """On a circle all that a base carries turns with it: `rolling` finds no rate of what is passive."""
    for base in (steered.loader(), steered.truck(2)):
        twist = np.tile([speed, 0.0, speed * curvature], (2, 1))
        stance = along(base.pivots, np.array([0.0, 1.0]), twist, 0 * twist)
        if base.kind == "trailer":  # a long way forwards, until it has settled
            t = np.linspace(0.0, 40.0, 2001)
            ahead = np.tile([abs(speed), 0.0, abs(speed) * curvature], (len(t), 1))
            stance = along(base.pivots, t, ahead, 0 * ahead)
        eta, rates = moved(base, stance.angles[-1], stance.rates[-1], np.sign(speed) * np.abs(twist[0]))
        np.testing.assert_allclose(rates, 0.0, atol=1e-9)
        assert eta[2] / eta[0] == pytest.approx(curvature, abs=1e-9)


@given(st.integers(0, 999))
@settings(max_examples=10, deadline=None)
def test_what_is_passive_swings_as_it_rolls(seed):
    for base in (steered.truck(2), steered.casters()):
        rng, t = np.random.default_rng(seed), np.linspace(0.0, 3.0, 3001)
        (v, vdot), (w, wdot) = wave(rng, t, 0.1, 0.6), wave(rng, t, 0.1)
        twist, change = np.stack([v, 0 * v, w], 1), np.stack([vdot, 0 * v, wdot], 1)
        stance = along(base.pivots, t, twist, change)
        np.testing.assert_allclose(np.gradient(stance.angles, t, axis=0)[2:-2], stance.rates[2:-2], atol=5e-3)
        for i in (0, 1500, 3000):
            _, rates = moved(base, stance.angles[i], stance.rates[i], twist[i])
            np.testing.assert_allclose(rates, stance.rates[i], atol=1e-9)


@pytest.mark.parametrize("base", [*(make() for make in steered.ON_AXLE), steered.car(sign=-1.0), steered.car(-0.65)])
def test_the_curvatures_are_those_at_the_stops(base):
    least, most = bends(base.pivots)
    assert least == pytest.approx(-most)
    sines = []
    for share in (0.999, 1.001):
        twist = np.tile([1.0, 0.0, share * most], (2, 1))
        stance = along(base.pivots, np.array([0.0, 1.0]), twist, 0 * twist)
        sines.append(max(np.abs(stance.angles[0]) / [p.upper for p in base.pivots]))
    assert sines[0] < 1.0 < sines[1]


def test_a_wheel_that_turns_past_a_right_angle_has_no_tightest_curve():
    assert bends(steered.tricycle(stop=1.7).pivots) == (-math.inf, math.inf)
    most = bends(steered.tricycle(stop=1.5).pivots)[1]
    assert most == pytest.approx(math.tan(1.5) / 1.2)


# -- what is accepted and refused --------------------------------------------------------------------------------------

shapes = st.one_of(
    st.builds(Eight, st.floats(1, 8), st.floats(0.8, 4), st.floats(6, 40) | st.floats(-40, -6), ramp=st.just(2.0)),
    st.builds(Circle, st.floats(0.4, 5.0), st.floats(0.2, 1.0), turn=st.sampled_from([1, -1]), ramp=st.just(1.0)),
    st.builds(
        Waypoints, st.just(((0.0, 0.0), (6.0, 0.0), (6.0, 6.0), (11.0, 3.0))), st.floats(0.2, 1.5), st.floats(0.3, 1.2)
    ),
)  # fmt: skip


@given(shapes, st.sampled_from([*steered.ON_AXLE, steered.swerve]), st.floats(0.3, 4.0))
@settings(max_examples=60, deadline=None)
def test_what_is_accepted_can_be_steered_and_advice_works(path, make, rate):
    base = make(rate=rate)
    whole = Trajectory(HolonomicPath(path) if base.sideways else path)
    duration, times = 12.0, 1.0
    for _ in range(3):
        t, setpoints = sampled(whole, base, times * duration)
        needs = needs_of(base, t, setpoints)
        if needs.refused is None:
            break
        assume("pushed" not in str(needs.refused))  # what backs is to be guided by its other axle
        said = re.search(r"draw it ([\d.e+]+) times as large|take ([\d.e+]+) times as long", needs.refused.fix)
        assert said, needs.refused
        if said[1]:
            assert whole.slowness == 1.0  # size first
            whole, times = Trajectory(Enlarged(whole.base, float(said[1]))), times * math.sqrt(float(said[1]))
        else:
            whole, times = Trajectory(whole.base, slowness=whole.slowness * float(said[2])), times * float(said[2])
    assert needs.refused is None, "twice advised, and still refused"
    v = setpoints.velocity
    fast = np.abs(v[:, 0]) > 0.01
    if not base.sideways:
        assert np.all(np.abs(v[fast, -1] / v[fast, 0]) <= curvatures(base)[1] * (1 + 1e-5))
        p, (speed, w) = base.pivots[0], v[fast].T
        angle = np.arctan(w * p.x / (speed - w * p.y))
        steps = np.abs(np.diff(angle)) / np.diff(t[fast])
        if base.kind != "articulated":
            assert np.abs(angle).max() <= OF_STOPS * base.pivots[0].upper + 1e-6
            assert steps.max(initial=0.0) <= OF_RATE * rate * 1.01


def test_an_eight_is_drawn_as_large_as_a_car_needs_it_and_no_larger():
    base = steered.car(rate=1.0)
    for period in (40.0, 7.0):
        asked = Trajectory(Eight(6.0, 3.0, period, ramp=2.0))
        found = fitted(asked, base, dimensions_of(base), 20.0)
        require_steerable(base, *sampled(found, base, 20.0 * found.slowness))
        smaller = Trajectory(Enlarged(asked.base, 0.98 * found.base.factor))
        with pytest.raises(TrajectoryError, match=r"the path bends by .* its steering reaches .* draw it 1\.\d+ times"):
            require_steerable(base, *sampled(smaller, base, 40.0))
    assert found.slowness > 1.0


def test_what_a_base_follows_stays_as_it_is():
    base = steered.car()
    for asked in (Trajectory(Eight(12.0, 6.0, 30.0, ramp=2.0)), Trajectory(Line(0.5))):
        assert fitted(asked, base, dimensions_of(base), 20.0) is asked


def test_an_enlarged_path_is_one_motion():
    path = Enlarged(Eight(2.0, 1.0, 15.0, start=(1.0, 2.0, 0.5), ramp=1.0), 2.5)
    t = np.linspace(0.0, 12.0, 4001)
    one = path.sample(t)
    assert one.pose[0, :2] == pytest.approx((1.0, 2.0))
    c, s = np.cos(one.pose[:, 2]), np.sin(one.pose[:, 2])
    rate = np.gradient(one.pose, t, axis=0)[2:-2]
    np.testing.assert_allclose(rate[:, 0], (c * one.velocity[:, 0])[2:-2], atol=1e-4)
    np.testing.assert_allclose(rate[:, 2], one.velocity[2:-2, 1], atol=1e-4)
    np.testing.assert_allclose(np.gradient(one.velocity, t, axis=0)[2:-2], one.acceleration[2:-2], atol=1e-4)
    assert np.hypot(*(s, c)).max() == pytest.approx(1.0)


def test_turning_on_the_spot_is_no_curve_of_a_car():
    base, t = steered.car(), np.linspace(0.0, 1.0, 11)
    spin = np.tile([0.0, 0.5], (11, 1))
    still = Setpoint(np.zeros((11, 3)), spin, 0 * spin, *np.zeros((3, 11, 0)))
    with pytest.raises(TrajectoryError, match=r"turns on the spot at t = 0 s.*drive a curve of"):
        require_steerable(base, t, still)


def test_a_swerve_drive_turns_while_it_drives():
    base = steered.swerve()
    whole = Trajectory(HolonomicPath(Eight(3.0, 1.5, 20.0, ramp=2.0), Sine(amplitude=1.0, period=20.0)))
    t, setpoints = sampled(whole, base, 20.0)
    require_steerable(base, t, setpoints)
    stance = along(base.pivots, t, setpoints.velocity, setpoints.acceleration)
    assert np.ptp(stance.angles, axis=0).min() > 1.0  # the wheels have to turn, and do
    slow = steered.swerve(rate=0.3)
    with pytest.raises(TrajectoryError, match=r"'steer_\d' would turn at .* times as long"):
        require_steerable(slow, t, setpoints)
    free = fitted(whole, slow, dimensions_of(slow), 20.0)
    require_steerable(slow, *sampled(free, slow, 20.0 * free.slowness))


def test_a_swerve_drive_that_goes_on_elsewhere_stands_meanwhile():
    base, t = steered.swerve(rate=2.0), np.linspace(0.0, 10.0, 2001)
    for rest, fine in ((0.2, False), (1.0, True)):
        v = np.zeros((len(t), 3))
        v[:, 0] = np.where(t < 4, np.sin(np.pi * t / 4), 0.0)
        v[:, 1] = np.where((t > 4 + rest) & (t < 8 + rest), np.sin(np.pi * (t - 4 - rest) / 4), 0.0)
        made = Setpoint(np.zeros((len(t), 3)), v, np.gradient(v, t, axis=0), *np.zeros((3, len(t), 0)))
        if fine:
            require_steerable(base, t, made)
        else:
            with pytest.raises(TrajectoryError, match=r"jump by 1.57 rad .* stand there for 0.88\d s"):
                require_steerable(base, t, made)


def test_wheels_with_stops_start_on_the_side_that_they_can_keep():
    base = steered.swerve(stop=2.0)
    t = np.linspace(0.0, 4.0, 401)
    way = 1.3 + 0.475 * t  # from 1.3 to 3.2 rad: beyond the stop, but not half a turn less
    v = np.stack([np.cos(way), np.sin(way), 0 * t], axis=1)
    made = Setpoint(np.zeros((401, 3)), v, np.gradient(v, t, axis=0), *np.zeros((3, 401, 0)))
    require_steerable(base, t, made)
    assert start_angles(base, made) == pytest.approx(1.3 - math.pi)
    with pytest.raises(TrajectoryError, match=r"'steer_0' would stand at .* let the base look along its path"):
        long = np.linspace(0.0, 8.0, 401)
        round_ = np.stack([np.cos(long), np.sin(long), 0 * long], axis=1)
        turning = np.gradient(round_, long, axis=0)
        require_steerable(base, long, Setpoint(made.pose, round_, turning, *np.zeros((3, 401, 0))))


def test_a_trailer_that_would_fold_or_be_pushed_is_refused():
    base = steered.truck()
    require_steerable(base, *sampled(Trajectory(Eight(9.0, 4.5, 40.0, ramp=3.0)), base, 40.0))
    with pytest.raises(TrajectoryError, match=r"backs up by 4 m with a trailer.*at most"):
        require_steerable(base, *sampled(Trajectory(Line(-0.4)), base, 10.0))
    require_steerable(base, *sampled(Trajectory(Line(-0.4)), base, 1.5))
    waist = steered.loader()
    with pytest.raises(TrajectoryError, match="backs up by 4 m with an axle pushed"):
        require_steerable(waist, *sampled(Trajectory(Line(-0.4)), waist, 10.0))
    require_steerable(waist, *sampled(Trajectory(Circle(6.0, -0.4)), waist, 10.0), trailer=True)
    with pytest.raises(TrajectoryError, match="the truck folds up"):
        require_steerable(waist, *sampled(Trajectory(Circle(1.0, -0.4)), waist, 10.0), trailer=True)
    long = steered.truck(length=3.0)
    with pytest.raises(TrajectoryError, match=r"'hitch_0' would stand at .*draw it") as refused:
        require_steerable(long, *sampled(Trajectory(Circle(2.0, 0.5)), long, 60.0))
    factor = float(re.search(r"draw it ([\d.]+) times", refused.value.fix)[1])
    require_steerable(long, *sampled(Trajectory(Enlarged(Circle(2.0, 0.5), factor)), long, 60.0))


def test_it_starts_along_the_first_setpoint_that_moves():
    base = steered.car()
    _, setpoints = sampled(Trajectory(Circle(2.0, 0.5, ramp=1.0)), base, 5.0)
    angles = start_angles(base, setpoints)
    assert angles == pytest.approx([math.atan2(0.65, 2.0 - 0.22), math.atan2(0.65, 2.0 + 0.22)], abs=1e-9)
    assert start_angles(steered.car(sign=-1.0), setpoints) == pytest.approx(-angles)
    _, back = sampled(Trajectory(Circle(2.0, -0.5, ramp=1.0)), base, 5.0)
    assert start_angles(base, back) == pytest.approx(angles)
    first = Setpoint(*(getattr(setpoints, name)[0] for name in Setpoint.__slots__))
    assert start_angles(base, first) == pytest.approx(0.0)  # it stands: as it is
    sideways = Setpoint(np.zeros(3), np.array([0.0, 1.0, 0.0]), np.zeros(3), *np.zeros((3, 0)))
    assert np.cos(start_angles(steered.casters(), sideways) - math.pi / 2) == pytest.approx(1.0)  # they trail


# -- parking and backing -----------------------------------------------------------------------------------------------


@given(
    st.floats(0.2, 3.0) | st.floats(-3.0, -0.2), st.floats(0.8, 3.0), st.floats(0.1, 0.6) | st.floats(-0.6, -0.1),
    st.integers(1, 5), st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3)),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_it_parks_where_it_should_and_is_one_motion(aside, radius, speed, strokes, start):
    try:
        path = Parking(aside, radius, speed, strokes, start, 0.0)
        path = Parking(aside, radius, speed, strokes, start, 0.5 * path.length / abs(speed))
    except TrajectoryError as refused:
        least = int(re.search(r"strokes >= (\d+)", refused.fix)[1])
        assert least > strokes
        path = Parking(aside, radius, speed, least, start, 0.0)
        path = Parking(aside, radius, speed, least, start, 0.5 * path.length / abs(speed))
    t = np.linspace(0.0, path.duration + 1.0, 8001)
    one = path.sample(t)
    c, s = math.cos(start[2]), math.sin(start[2])
    dx, dy = one.pose[-1, 0] - start[0], one.pose[-1, 1] - start[1]
    along_, across = c * dx + s * dy, c * dy - s * dx
    assert across == pytest.approx(aside, abs=1e-9) and one.pose[-1, 2] == pytest.approx(start[2])
    assert along_ == pytest.approx(0.0 if path.strokes % 2 == 0 else -math.copysign(path.room, speed), abs=1e-9)
    rate, h = np.gradient(one.pose, t, axis=0)[2:-2], t[1]
    v, w = one.velocity[2:-2].T
    heading = one.pose[2:-2, 2]
    scale = 20.0 * h * (1.0 + np.abs(one.acceleration).max())
    np.testing.assert_allclose(rate[:, 0], v * np.cos(heading), atol=scale)
    np.testing.assert_allclose(rate[:, 1], v * np.sin(heading), atol=scale)
    np.testing.assert_allclose(rate[:, 2], w, atol=scale)
    assert np.abs(w).max() <= np.abs(v).max() / radius * (1 + 1e-9)
    assert np.all(np.abs(w) <= np.abs(v) / radius * (1 + 1e-9))
    assert np.count_nonzero(np.diff(np.sign(v[v != 0.0]))) == path.strokes - 1  # it turns back at every cusp


def test_a_car_parks_and_a_trailer_does_not():
    radius = 1.01 / curvatures(steered.car())[1]
    path = Parking(-1.2, radius, 0.4, strokes=2)
    require_steerable(steered.car(), *sampled(Trajectory(path), steered.car(), path.duration + 1.0))
    with pytest.raises(TrajectoryError, match="the path bends by"):
        tight = Parking(-1.2, 0.9 * radius, 0.4, strokes=2)
        require_steerable(steered.car(), *sampled(Trajectory(tight), steered.car(), tight.duration))
    with pytest.raises(TrajectoryError, match="backs up by"):
        require_steerable(steered.truck(), *sampled(Trajectory(path), steered.truck(), path.duration))


@given(st.sampled_from(["car", "tricycle", "loader"]), st.floats(0.2, 3), st.floats(0.3, 2), st.sampled_from([1, -1]))
@settings(max_examples=15, deadline=None)
def test_a_timed_path_turns_no_pivot_faster_than_it_can(name, rate, speed, sign):
    assume(name != "loader" or sign > 0)  # backwards it would push its other axle
    base = getattr(steered, name)(rate=rate)
    radius = 1.2 / curvatures(base)[1]
    way = Waypoints(((0.0, 0.0), (14.0, 0.0), (14.0, 14.0), (28.0, 14.0)), sign * 0.5, radius, ramp=0.0)
    free = Timed(way, speed)
    path = Timed(way, speed, base=base)
    t, setpoints = sampled(Trajectory(path), base, path.duration, 6001)
    require_steerable(base, t, setpoints)
    stance = along(base.pivots, t, in_columns(setpoints.velocity), in_columns(setpoints.acceleration))
    fastest = np.abs(stance.rates).max()
    assert fastest <= OF_RATE * rate * 1.02
    if path.duration > 1.01 * free.duration:  # slower, since it has to be
        assert fastest > 0.9 * OF_RATE * rate


# -- routes of a planner -----------------------------------------------------------------------------------------------


def robot_on(base: SteeredBase) -> SimpleNamespace:
    """What references ask of a robot; its wheels have no limits."""
    names, none = base.driven, SimpleNamespace(velocityLimit=np.zeros(0))
    return SimpleNamespace(
        base=base, dimensions=dimensions_of(base), actuator_names=names, full_velocity_names=(), model=none,
        lower=np.zeros(0), upper=np.zeros(0), arm_index=np.zeros(0, int), is_continuous=np.zeros(0), joint_names=(),
    )  # fmt: skip


def driven_by(base: SteeredBase, points: np.ndarray, headings: np.ndarray) -> RouteDrive:
    bends = curvatures(base)[1]
    route = Route.of(points, headings, np.zeros(len(points), bool), bends)
    return RouteDrive.along(route, robot_on(base), Limits(speed=0.6, acceleration=0.5), 1.0, 0.02)


def arcs(*parts: tuple[float, float], step: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Poses of a planner: ways [m], negative backwards, along circles of a curvature [1/m], from the origin."""
    poses = [np.zeros(3)]
    for way, curvature in parts:
        for _ in range(round(abs(way) / step)):
            x, y, phi = poses[-1]
            forward = math.copysign(step, way)
            middle = phi + 0.5 * forward * curvature
            poses.append(
                np.array([x + forward * math.cos(middle), y + forward * math.sin(middle), phi + forward * curvature])
            )
    return np.array(poses)[:, :2], np.array(poses)[:, 2]


@given(
    st.sampled_from(["car", "tricycle", "loader"]), st.floats(0.3, 0.6), st.sampled_from([1.0, -1.0]),
    st.floats(0.5, 1.5), st.booleans(),
)  # fmt: skip
@settings(max_examples=12, deadline=None)
def test_a_planner_s_way_with_cusps_is_driven_within_the_steering(name, share, side, turn, cusps):
    """Arcs as a planner of car-like robots makes them, whose curvature jumps; with cusps it backs in between."""
    assume(name != "loader" or not cusps)  # backwards it would push its other axle
    base = getattr(steered, name)()
    k = side * share * curvatures(base)[1]
    way = turn / abs(k)
    parts = ((2.0, 0.0), (way, k), (1.5, 0.0))
    parts = (*parts, (-way, -k), (-1.5, 0.0), (way, k), (1.0, 0.0)) if cusps else parts
    points, headings = arcs(*parts)
    drive = driven_by(base, points, headings)
    assert len(drive.route.legs) == (3 if cusps else 1)
    motion = drive.placed((0.0, 0.0, 0.0))
    setpoints = Setpoint.side_by_side(motion.table, motion.dimensions)
    require_steerable(base, motion.times, setpoints)
    away = np.hypot(*(points[:, None] - setpoints.pose[None, :, :2]).T).min(axis=0)
    assert away.max() < 0.08
    assert setpoints.pose[-1, :2] == pytest.approx(points[-1], abs=0.02)
    jumps = np.abs(np.diff(setpoints.pose, axis=0)).max(axis=0)
    assert jumps[:2].max() < 0.7 * 0.02 and jumps[2] < 1.6 * 0.02
    at_rest = np.abs(setpoints.velocity[:, 0]) < 1e-6
    assert np.abs(setpoints.velocity[at_rest, 1]).max(initial=0.0) < 1e-6  # no turn on the spot


@given(st.floats(-0.15, 0.15), st.floats(-0.2, 0.2))
@settings(max_examples=15, deadline=None)
def test_a_car_curves_onto_its_route_from_where_it_stands(aside, off):
    base = steered.car()
    points, headings = arcs((6.0, 0.0))
    motion = driven_by(base, points, headings).placed((0.1, aside, off))
    require_steerable(base, motion.times, Setpoint.side_by_side(motion.table, motion.dimensions))
    assert motion.table[0, :3] == pytest.approx((0.1, aside, off)) and motion.table[-1, :2] == pytest.approx((6.0, 0.0))


def test_a_route_that_a_car_cannot_join_is_refused_in_one_line():
    base = steered.car()
    points, headings = arcs((6.0, 0.0))
    drive = driven_by(base, points, headings)
    for pose, match in (((0.0, 0.0, 2.0), r"0 m beside the base and turned by 2 rad: .* not on the spot"),
                        ((5.9, 1.0, 0.0), r"1 m beside")):  # fmt: skip
        with pytest.raises(TrajectoryError, match=match):
            drive.placed(pose)
    tight, ways = arcs((1.0, 0.0), (3.0, 2.0))
    with pytest.raises(
        TrajectoryError,
        match=r"the route bends by .*it turns within 1.05 m.*raise the planner.s smallest turning radius, by 13[0-9] %",
    ):
        driven_by(base, tight, ways)
    ended = headings.copy()
    ended[-1] = 1.0
    with pytest.raises(TrajectoryError, match=r"a turn by 1 rad on the spot"):
        driven_by(base, points, ended)


def test_samples_of_a_planner_with_cusps_are_one_motion_too():
    """Poses alone, and with velocities, as a CSV file has them: noise where it stands is no curvature."""
    robot = load("car_arm")
    path = Parking(-1.0, 1.05 / curvatures(robot.base)[1], 0.3, strokes=2)
    t = np.arange(0.0, path.duration, 0.05)
    one = path.sample(t)
    for velocity in (None, one.velocity):
        whole = Trajectory.from_arrays(robot, t, one.pose, velocity=velocity)
        fine = np.arange(0.0, t[-1], 0.002)
        setpoints = Setpoint.side_by_side(whole.table(fine, robot.dimensions), robot.dimensions)
        require_steerable(robot.base, fine, setpoints)
        assert setpoints.pose[-1] == pytest.approx((0.0, -1.0, 0.0), abs=2e-3)
        hurried = replace(whole, slowness=0.08)
        short = np.arange(0.0, 0.08 * t[-1], 0.0005)
        setpoints = Setpoint.side_by_side(hurried.table(short, robot.dimensions), robot.dimensions)
        with pytest.raises(TrajectoryError, match=r"_steering_joint' would turn at .* times as long"):
            require_steerable(robot.base, short, setpoints)


def test_a_motion_that_a_robot_cannot_steer_is_refused_when_it_is_handed_in():
    robot = load("car_arm")
    follower = Follower(robot, Limits(), 0.5)
    for radius, fine in ((1.5, True), (0.5, False)):
        motion = Motion.of(Trajectory(Circle(radius, 0.3, ramp=1.0)), 4.0, 0.02, robot.dimensions)
        if fine:
            assert follower.check(motion) is not None
        else:
            with pytest.raises(ConfigError, match=r"setpoint: error: the path bends by 2 1/m .* 1.9\d times as large"):
                follower.check(motion)
    points, headings = arcs((3.0, 0.0))
    route = Route.of(points, headings, np.zeros(len(points), bool), curvatures(robot.base)[1])
    follower.now[2] = 2.0
    with pytest.raises(ConfigError, match="not on the spot"):
        follower.check(RouteDrive.along(route, robot, Limits(), 1.0, 0.02))


# -- velocities of a joystick ------------------------------------------------------------------------------------------

twists = st.tuples(st.floats(-1.5, 1.5) | st.just(0.0), st.floats(-2.0, 2.0) | st.just(0.0))


@given(st.sampled_from(["car", "tricycle", "loader"]), st.lists(twists, min_size=2, max_size=6))
@settings(max_examples=30, deadline=None)
def test_whatever_a_joystick_asks_stays_within_the_steering(name, asked):
    base, dt, bends = getattr(steered, name)(), 0.01, []
    guide, limits = new_guide(robot_on(base), Limits()), curvatures(base)
    measured = np.zeros(5)
    stand(measured, guide)
    for velocity in (*asked, asked[-1], asked[-1], asked[-1]):
        drive(np.array(velocity), guide)
        for _ in range(100):
            advance(measured, dt, guide)
            v, w = guide.now[3:5]
            rolled_on(measured[:3], guide.now[3:5], False, dt)
            measured[3:] = guide.now[3:5]
            assert limits[0] * abs(v) - 1e-9 <= w * math.copysign(1.0, v) <= limits[1] * abs(v) + 1e-9
            bends.append(guide.curve[3])
            if abs(v) > 1e-5:
                assert w / v == pytest.approx(bends[-1], abs=1e-6)
    assert guide.now[3] == pytest.approx(guide.wanted[3]), "it drives as fast as asked"
    assert np.abs(np.diff(bends)).max() <= guide.curve[2] * dt * (1 + 1e-9)
    brake(0, measured, guide)
    for _ in range(400):
        advance(measured, dt, guide)
    assert guide.now[3:5] == pytest.approx(0.0) and guide.curve[3] == pytest.approx(bends[-1])


def test_a_car_asked_to_turn_on_the_spot_stands_and_a_gentle_curve_is_driven_as_asked():
    guide = new_guide(robot_on(steered.car()), Limits())
    stand(np.zeros(5), guide)
    for asked, found in (((0.0, 1.0), (0.0, 0.0)), ((0.4, 0.2), (0.4, 0.2)), ((-0.4, 0.2), (-0.4, 0.2))):
        drive(np.array(asked), guide)
        for _ in range(300):
            advance(np.zeros(5), 0.01, guide)
        assert guide.now[3:5] == pytest.approx(found)
    drive(np.array([0.4, 5.0]), guide)
    assert guide.wanted[4] / guide.wanted[3] == pytest.approx(curvatures(steered.car())[1])


def test_wheels_that_steer_are_no_faster_than_they_can():
    """Rows of `rims` bound the speed of every wheel, by what it is and not by more than their number of directions."""
    for base in (steered.swerve(), steered.tricycle(), steered.car()):
        robot = robot_on(base)
        rows, _ = rims(robot)
        rng = np.random.default_rng(0)
        for _ in range(200):
            twist = rng.normal(size=3) * np.array([1.0, float(base.sideways), 1.0])
            fastest = 0.0
            for wheel in (w for w in base.wheels if w.driven):
                x, y = base.place(wheel)
                fastest = max(fastest, math.hypot(twist[0] - y * twist[2], twist[1] + x * twist[2]) / wheel.radius)
            bound = np.abs(rows @ twist[base.columns]).max()
            assert fastest <= bound * (1 + 1e-9) and bound <= 1.09 * fastest


# -- hands -------------------------------------------------------------------------------------------------------------


@given(
    st.sampled_from(["car_arm", "loader_arm", "casters_arm"]),
    st.floats(0.3, 1.0) | st.floats(-0.8, -0.3), st.floats(-0.6, 0.6), st.floats(0.15, 0.3),
)  # fmt: skip
@settings(max_examples=4, deadline=None)
def test_a_hand_is_led_through_a_base_that_steers(name, ahead, aside, speed):
    assume(name != "loader_arm" or ahead > 0)  # backwards it would push its other axle, which a run refuses
    robot = load(name)
    body = WholeBody(robot, [Task(orientation=0.0)], period=0.02)
    motion = plan(body, [HandLine((ahead, aside, 0.0), speed)], 3.0 + 1.5 / speed, tolerance=0.02)
    assert motion.misses == 0
    d, t = robot.dimensions, np.arange(len(motion.samples.nu)) * 0.02
    setpoints = Setpoint.side_by_side(motion.trajectory.table(t, d), d)
    require_steerable(robot.base, t, setpoints)
    assert np.abs(setpoints.velocity).max() > 0.01, "the base helps"
    data, frame = robot.model.createData(), robot.model.getFrameId(motion.frames[0])
    for k in (0, len(t) // 2, len(t) - 1):  # Pinocchio has the hand where the program has it
        position = robot.neutral_position()
        position[:3], position[robot.arm_index] = setpoints.pose[k], setpoints.q[k]
        pin.framesForwardKinematics(robot.model, data, robot.configuration(robot.follow(position)))
        np.testing.assert_allclose(data.oMf[frame].translation, motion.reached[k, 0, 9:], atol=1e-9)


def test_a_car_is_not_turned_on_the_spot_to_where_a_hand_begins():
    body = WholeBody(load("car_arm"), [Task(orientation=0.0)], period=0.01)
    with pytest.raises(TrajectoryError, match="turn on the spot"):
        plan(body, [HandLine((1.0, 0.0, 0.0), 0.2)], 12.0, at=(1.0, 2.0, 0.8), tolerance=None)
    with pytest.raises(RobotError, match="'hitch_joint', on which the base stands, carries"):
        WholeBody(load("truck_trailer_arm"))
