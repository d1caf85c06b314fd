"""Paths as planners send them: what their headings say, which legs they have, and a drive from wherever the base is."""

from __future__ import annotations

import math
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

sys.path.insert(0, str(Path(__file__).parents[1] / "model"))

from test_holonomic import mecanum

from mmnn_pin import load
from mmnn_pin.reference.drive import NEAR, REACHED, TINY, Joined, RouteDrive
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.route import FOLD, Route, corners
from mmnn_pin.reference.timed import Smoothed

Array = np.ndarray
ROBOT, PERIOD = load("platform_arm"), 0.01
LIMITS, LATERAL = Limits(speed=0.4, yaw_rate=1.0, acceleration=0.5, yaw_acceleration=1.5), 0.5
NO = math.nan


def line(*ends: tuple[float, float], apart: float = 0.05) -> Array:
    """Points on straight lines between ends."""
    parts = [np.linspace(a, b, max(2, round(math.dist(a, b) / apart) + 1)) for a, b in pairwise(ends)]
    return np.vstack([parts[0], *(part[1:] for part in parts[1:])])


def route_of(points: ArrayLike, headings: ArrayLike = NO) -> Route:
    """A route whose headings that are 0 are identities."""
    points = np.asarray(points, float)
    headings = np.broadcast_to(np.asarray(headings, float), len(points)).copy()
    return Route.of(points, headings, headings == 0.0)


def drive_of(points: ArrayLike, headings: ArrayLike = NO, robot=ROBOT) -> RouteDrive:
    return RouteDrive.along(route_of(points, headings), robot, LIMITS, LATERAL, PERIOD)


def totals(table: Array) -> tuple[float, float, float]:
    """Turned in all [rad], driven ahead and in reverse [m], by the velocities alone."""
    v, w = table[:, 3], table[:, 4]
    return np.abs(w).sum() * PERIOD, np.maximum(v, 0.0).sum() * PERIOD, np.maximum(-v, 0.0).sum() * PERIOD


def lone(count: int, at: int, heading: float, others: float = 0.0) -> list[float]:
    headings = [others] * count
    headings[at] = heading
    return headings


AHEAD, BACK = line((0, 0), (2, 0)), line((0, 0), (-2, 0))
TIP, PI = line((0, 0), (1, 0), (0.3, 0)), math.pi
ASIDE = 2 * math.atan2(0.3, 0.4)
# points, headings (0: identity, NaN: none), pose of the base; turned, ahead, in reverse; heading at the end
CASES = {
    "identities say nothing": (BACK, 0.0, (0, 0, PI), (0, 2, 0), PI),
    "no headings": (BACK, NO, (0, 0, PI), (0, 2, 0), PI),
    "first true, others identity": (BACK, lone(41, 0, PI), (0, 0, PI), (0, 2, 0), PI),
    "identity, last is the goal's": (BACK, lone(41, -1, PI), (0, 0, PI), (0, 2, 0), PI),
    "the tail does not lead": (BACK, 0.0, (0, 0, 0), (PI, 2, 0), PI),
    "the goal's heading is turned to": (BACK, lone(41, -1, 1.0), (0, 0, PI), (PI - 1, 2, 0), 1.0),
    "true headings in reverse": (BACK, lone(41, 3, 1e-5, 1e-5), (0, 0, 0), (0, 0, 2), 0.0),
    "a tip with true headings": (TIP, 0.0, (0, 0, 0), (0, 1, 0.7), 0.0),
    "a tip without headings": (TIP, NO, (0, 0, 0), (PI, 1.7, 0), PI),
    "a tip turned on": (TIP, [0.0] * 21 + [PI] * 14, (0, 0, 0), (PI, 1.7, 0), PI),
    "back and forth": (line((0, 0), (1, 0), (0.5, 0), (1.5, 0)), 0.0, (0, 0, 0), (0, 2, 0.5), 0.0),
    "turned tips": (line((0, 0), (1, 0), (0, 1), (1, 1)), NO, (0, 0, 0), (1.5 * PI, 2 + math.sqrt(2), 0), 0.0),
    "each pose three times": (np.repeat(AHEAD, 3, axis=0), 0.0, (0, 0, 0), (0, 2, 0), 0.0),
    "two poses": (AHEAD[[0, -1]], NO, (0, 0, 0), (0, 2, 0), 0.0),
    "one pose": ([(1.0, 1.0)], NO, (0, 0, 0), (PI / 4, math.sqrt(2), 0), PI / 4),
    "one pose with a heading": ([(1.0, 1.0)], PI / 2, (0, 0, 0), (PI / 2, math.sqrt(2), 0), PI / 2),
    "all in one place": ([(1.0, 0.0)] * 5, 0.0, (0, 0, 0), (0, 1, 0), 0.0),
    "there already": ([(0.0, 0.0)], -2.0, (0, 0, 1), (3, 0, 0), -2.0),
    "aside": (line((0.4, 0.3), (1.4, 0.3)), 0.0, (0, 0, 0), (ASIDE, 1.5, 0), 0.0),
    "on its way": (line((-1, 0), (1, 0)), 0.0, (0, 0, 0), (0, 1, 0), 0.0),
    "at its end": (AHEAD, 0.0, (2, 0, 0), (0, 0, 0), 0.0),
}


@pytest.mark.parametrize("case", CASES)
def test_what_is_driven_is_what_was_asked(case):
    points, headings, start, wanted, heading = CASES[case]
    table = drive_of(points, headings).placed(start).table
    assert totals(table) == pytest.approx(wanted, abs=2e-3)
    assert table[0, :3] == pytest.approx(start, abs=1e-9)
    assert table[-1, :2] == pytest.approx(np.asarray(points)[-1], abs=1e-9)
    assert math.remainder(table[-1, 2] - heading, math.tau) == pytest.approx(0.0, abs=1e-4)
    assert not table[-1, 3:].any()
    if "tip" in case and "turned" not in case:
        assert table[:, 0].max() == pytest.approx(1.0, abs=1e-6)  # it is reached, not cut and not passed


@given(st.floats(-PI, PI), st.booleans())
def test_identities_count_where_they_lie_along_the_way(way, folded):
    """On a line at an angle: within ten degrees of the x axis, and not where all of them look back."""
    c, s = math.cos(way), math.sin(way)
    points = TIP if folded else AHEAD
    route = route_of(points @ np.array([[c, s], [-s, c]]), 0.0)
    off = abs(math.remainder(way, PI))
    if abs(off - math.acos(0.985)) > 1e-6:
        parallel = off < math.acos(0.985)
        assert (route.heading is not None) == (parallel and (folded or abs(way) < 1.0))
        assert [leg.backwards for leg in route.legs][1:] == ([parallel and abs(way) < 1.0] if folded else [])


@given(st.integers(0, 10_000), st.floats(0.005, 0.05), st.integers(3, 60))
def test_a_polygon_through_its_corners_passes_all_points_in_their_order(seed, within, count):
    """Each point is near the part of the polygon that stands for it, and none goes back on it; by brute force."""
    points = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.04, (count, 2)), axis=0)
    kept = corners(points, within)
    assert kept[0] == 0 and kept[-1] == count - 1
    for first, last in pairwise(kept):
        fine = np.linspace(points[first], points[last], 2001)
        away = np.hypot(*(points[first : last + 1, None] - fine).transpose(2, 0, 1)).min(axis=1)
        along = (points[first : last + 1] - points[first]) @ (points[last] - points[first])
        along = along / max(math.dist(points[first], points[last]), 1e-9)
        assert away.max() < within + 1e-3
        assert (
            max((along[i] - along[j] for i in range(len(along)) for j in range(i, len(along))), default=0) < 2 * within
        )


@given(st.integers(0, 10_000), st.sampled_from([0.01, 0.02, 0.05]))
def test_a_trembling_planner_asks_for_no_change_of_direction(seed, apart):
    points = line((0, 0), (2, 0), (2, 2), apart=apart)
    noisy = points + np.clip(np.random.default_rng(seed).normal(0.0, 0.005, points.shape), -0.01, 0.01)
    route = route_of(noisy)
    assert len(route.legs) == 1 and not route.legs[0].backwards
    table = drive_of(noisy).placed((*noisy[0], 0.0)).table
    assert table[:, 3].min() > -1e-9 and table[-1, :2] == pytest.approx(noisy[-1], abs=1e-9)
    assert totals(table)[1] == pytest.approx(4.0, abs=0.15)


def test_a_closed_path_is_driven_around():
    square = line((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))
    drive = drive_of(square)
    table = drive.placed((0.0, 0.0, 0.0)).table
    assert table[-1, :2] == pytest.approx([0.0, 0.0], abs=1e-9) and table[:, 3].min() > -1e-9
    assert table[:, 2].max() == pytest.approx(1.5 * PI, abs=0.15)
    bound = Smoothed.FARTHEST * drive.route.legs[0].path.wander  # a corner is cut by no more
    for corner in square[[20, 40, 60]]:
        assert np.hypot(*(table[:, :2] - corner).T).min() < bound


ANGLES = st.one_of(st.floats(-PI, PI), st.sampled_from([0.0, PI / 2, PI]))
STRETCHES = st.lists(st.tuples(st.floats(0.02, 1.0), ANGLES), min_size=1, max_size=5)


@given(
    STRETCHES, st.sampled_from([0.01, 0.05, 0.3]), st.sampled_from([NO, 0.0, 1.0]), st.floats(0.0, 1.0),
    st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.sampled_from([0.02, 0.5, 2.0]), st.tuples(*[st.floats(-1.0, 1.0)] * 3),
    st.booleans(), st.booleans(),
)  # fmt: skip
@settings(max_examples=400)
def test_any_route_is_driven_within_limits_and_without_a_jump(
    stretches, apart, heading, share, beside, far, velocity, omni, along
):
    """Own integration of the velocities gives the poses; limits hold from sample to sample; it ends where it should."""
    ways = np.cumsum([turn for _, turn in stretches])
    steps = np.array([length for length, _ in stretches])[:, None] * np.stack([np.cos(ways), np.sin(ways)], axis=1)
    points = line((0.0, 0.0), *map(tuple, np.cumsum(steps, axis=0)), apart=apart)
    robot = MECANUM if omni else ROBOT
    drive = drive_of(points, heading, robot)
    start, v = far * np.array(beside), np.array(velocity) * (0.39, 0.3, 0.9)
    v = v if omni else v[[0, 2]]
    if along and drive.route.legs:
        leg = drive.route.legs[0]
        start = leg.pose(0.5 * share * leg.path.span) + 0.02 * np.array(beside)
        v = np.array([-abs(v[0]) if leg.backwards else abs(v[0]), *([0.0] if omni else []), 0.0])
    motion, nb = drive.placed(start, v), robot.dimensions.base
    pose, rates = motion.table[:, :3], motion.table[:, 3 : 3 + nb]
    assert np.isfinite(motion.table).all() and not rates[-1].any()
    assert pose[0] == pytest.approx(start, abs=2 * TINY) and abs(rates[0] - v).max() < 0.1 * abs(v).max() + 1e-2
    middle, moved = 0.5 * (pose[1:, 2] + pose[:-1, 2]), np.diff(pose, axis=0) / PERIOD
    c, s, mean = np.cos(middle), np.sin(middle), 0.5 * (rates[1:] + rates[:-1])
    ahead, sideways = c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0]
    assert ahead == pytest.approx(mean[:, 0], abs=3e-3) and moved[:, 2] == pytest.approx(mean[:, -1], abs=1e-2)
    assert sideways == pytest.approx(mean[:, 1] if omni else 0.0, abs=2e-3 if omni else 1e-3)
    changes = np.abs(np.diff(rates, axis=0)).max(axis=0) / PERIOD
    first = np.hypot(*v[:2]) if omni else abs(v[0])
    assert np.hypot(rates[:, 0], rates[:, 1] if omni else 0.0).max() <= max(LIMITS.speed, first) + 1e-9
    assert abs(rates[:, -1]).max() <= LIMITS.yaw_rate * 1.01 and changes[-1] <= LIMITS.yaw_acceleration * 1.01
    assert changes[:-1].max() <= LIMITS.acceleration * 1.01
    assert pose[-1, :2] == pytest.approx(points[-1], abs=REACHED)
    if drive.route.heading is not None:
        assert math.remainder(pose[-1, 2] - drive.route.heading, math.tau) == pytest.approx(0.0, abs=1e-6)


MECANUM = mecanum()


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("bent", [0.0, 0.4])
def test_a_planner_that_plans_anew_every_second_does_not_stop_the_robot(backwards, bent):
    """From where it drives, a little aside: the speed never falls, and the whole way is as long as the first plan."""
    x = np.arange(0.0, 4.01, 0.05)
    points, ways = np.stack([x, bent * np.sin(x)], axis=1), np.arctan2(bent * np.cos(x), 1.0)
    headings = ways + (PI if backwards else 1e-5)
    motion = drive_of(points, headings).placed((*points[0], headings[0]))
    rng, seen = np.random.default_rng(0), []
    for _ in range(6):
        seen.append(motion.table[:100])
        here = motion.table[100]
        i = int(np.argmin(np.hypot(*(points - here[:2]).T)))
        anew = np.vstack([here[:2] + rng.normal(0.0, 0.01, 2), points[i + 2 :]])
        motion = drive_of(anew, np.append(here[2], headings[i + 2 :])).placed(here[:3], here[3:5])
    table = np.vstack([*seen, motion.table])
    v = abs(table[:, 3])
    assert v[120:-150].min() > 0.3 and np.abs(np.diff(table[:, :3], axis=0)).max() < 0.011
    assert np.abs(np.diff(table[:, 3])).max() < 1.01 * PERIOD * LIMITS.acceleration
    length = np.hypot(*np.diff(points, axis=0).T).sum()
    assert v.sum() * PERIOD == pytest.approx(length, abs=0.05)


def test_a_motion_that_leads_elsewhere_is_braked_first():
    """Both velocities in proportion, in the time that the slower of both needs; then as from rest."""
    drive, v = drive_of(AHEAD), np.array([-0.3, 0.6])
    table = drive.placed((0.0, 0.5, 1.0), v).table
    still = int(np.argmax(np.abs(table[:, 3:5]).max(axis=1) < 1e-9))
    braking = table[:still, 3:5]
    assert braking[:, 1] == pytest.approx(-2 * braking[:, 0], abs=1e-9)
    assert still * PERIOD == pytest.approx(max(0.3 / 0.5, 0.6 / 1.5) / 0.98, abs=2 * PERIOD)
    radius, turned = 0.5, table[still, 2] - 1.0  # a circle, by its chord
    assert math.dist(table[still, :2], (0.0, 0.5)) == pytest.approx(2 * radius * math.sin(turned / 2), abs=1e-6)
    rest = drive.placed(table[still, :3]).table
    assert table[still:, :3] == pytest.approx(rest[: len(table) - still, :3], abs=1e-9)


def test_a_base_that_drives_the_other_way_along_a_route_is_braked_first():
    table = drive_of(AHEAD).placed((0.5, 0.0, 0.0), (-0.3, 0.0)).table
    assert table[0, 3] == pytest.approx(-0.3) and totals(table)[2] == pytest.approx(0.3**2 / (2 * 0.98 * 0.5), abs=2e-3)
    assert table[-1, :3] == pytest.approx([2.0, 0.0, 0.0], abs=1e-9)


@given(st.floats(-0.05, 0.05), st.floats(-0.3, 0.3), st.floats(-1.0, 1.0), st.booleans())
def test_the_curve_onto_a_route_has_the_derivatives_that_it_says_and_no_corner(aside, off, bend, backwards):
    """By finite differences, also across the point where it reaches the route; curvature and its slope do not jump."""
    x = np.arange(0.0, 2.0, 0.05)
    leg = route_of(np.stack([x, 0.3 * np.sin(2 * x)], axis=1), PI if backwards else NO).legs[0]
    start = leg.pose(0.4) + np.array([0.0, aside, off])
    curve, h = Joined(leg.path, 0.9, start, bend, leg.backwards), 1e-5
    first = curve.curve(np.zeros(1))
    assert [first.x[0], first.y[0], first.phi[0]] == pytest.approx(start, abs=1e-9)
    assert (first.g[0], first.k[0]) == pytest.approx((-1.0 if backwards else 1.0, bend), abs=1e-9)
    s = np.linspace(h, curve.span - h, 301)
    here, before, after = (curve.curve(s + d) for d in (0.0, -h, h))
    slopes = {"x": here.g * np.cos(here.phi), "y": here.g * np.sin(here.phi), "phi": here.k, "g": here.dg, "k": here.dk}
    for one, slope in slopes.items():
        assert (getattr(after, one) - getattr(before, one)) / (2 * h) == pytest.approx(slope, rel=1e-3, abs=1e-2)
    length = curve.span - abs(leg.path.curve(np.array([0.9])).g[0]) * (leg.path.span - 0.9)
    left, right = (curve.curve(np.array([length + d])) for d in (-1e-9, 1e-9))
    for one in vars(left):
        assert getattr(left, one) == pytest.approx(getattr(right, one), abs=1e-5), one


def test_the_curve_onto_a_short_and_bent_way_does_not_wind():
    """Its end bends so much that one polynomial to there would turn around on the spot, and leap by a whole turn."""
    table = drive_of([(0.0, 0.0), (0.043, 0.073), (-0.023, 0.099)]).placed((-0.001, 0.0109, 1.0783), (0.068, 0.0)).table
    assert np.abs(np.diff(table[:, 2])).max() <= 1.01 * PERIOD * LIMITS.yaw_rate
    assert totals(table)[0] < 4.0


def test_what_begins_there_already_is_kept():
    drive = drive_of(AHEAD).placed((0.0, 0.2, 0.0))
    assert drive.placed((0.0, 0.2, 1e-4)) is drive
    assert drive.placed((0.0, 0.25, 0.0)) is not drive
    assert drive.placed((0.0, 0.2, 0.0), (0.2, 0.0)) is not drive


@pytest.mark.parametrize("aside", [0.004, 0.03, 0.09, 0.3])
def test_a_base_beside_the_route_gets_onto_it(aside):
    """Close by it curves, within NEAR; from further off it drives there, straight."""
    table = drive_of(AHEAD, 0.0).placed((0.0, aside, 0.0)).table
    turned, ahead, reverse = totals(table)
    assert reverse == 0.0 and abs(table[:, 1]).max() < aside + 1e-3
    if aside < NEAR:
        assert turned < 4 * 1.875 * aside / 0.3 and ahead == pytest.approx(2.0, abs=0.05)
    else:
        assert turned == pytest.approx(PI, abs=2e-3) and ahead == pytest.approx(2.0 + aside, abs=2e-3)
    on = table[:, 0] > max(0.31, 5 * aside)
    assert abs(table[on, 1]).max() < 1e-9


def test_less_than_a_fold_is_none():
    for back, legs in ((0.8 * FOLD, 1), (1.5 * FOLD, 3)):
        assert len(route_of(line((0, 0), (1, 0), (1 - back, 0), (2, 0), apart=0.01)).legs) == legs


@pytest.mark.parametrize("degrees", [60, 80, 95, 120, 170])
def test_a_change_of_direction_that_headings_tell_is_driven_in_reverse_at_any_angle(degrees: float) -> None:
    """1 m ahead along x, then 1 m in reverse with the robot's nose turned: closed forms of both ways and the tip."""
    s, turn = np.arange(0.0, 1.001, 0.05), np.deg2rad(degrees)
    back = np.array([1.0, 0.0]) + s[1:, None] * [np.cos(turn), np.sin(turn)]
    points = np.vstack((np.stack([s, 0.0 * s], axis=1), back))
    headings = np.append(np.zeros(len(s) - 1), np.full(len(s), turn - np.pi))
    route = Route.of(points, headings, np.zeros(len(points), bool))
    assert [leg.backwards for leg in route.legs] == [False, True]
    assert [leg.path.span for leg in route.legs] == pytest.approx([1.0, 1.0], abs=1e-6)
    assert route.legs[0].pose(1.0)[:2] == pytest.approx([1.0, 0.0])
