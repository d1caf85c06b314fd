"""References: what they promise about their derivatives, their shape, and what they refuse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from mmnn_pin.errors import TrajectoryError
from mmnn_pin.reference import (
    BasePath,
    BaseSamples,
    BaseTable,
    Circle,
    Eight,
    Hold,
    JointProfile,
    Line,
    MinimumJerk,
    Sine,
    Sines,
    Trajectory,
    Waypoints,
    check_followable,
    warnings,
)
from mmnn_pin.signals import Layout, Setpoint

POINTS = ((0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (6.0, 2.0), (8.0, 5.0))
TIMES = np.array([0.013, 0.4, 1.1, 2.7, 3.9, 5.3, 8.8])


def between(low: float, high: float) -> SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


def either_sign(low: float, high: float) -> SearchStrategy[float]:
    return between(low, high) | between(-high, -low)


starts = st.tuples(between(-3, 3), between(-3, 3), between(-7, 7))
ramps = st.just(0.0) | between(0.2, 3)
paths: SearchStrategy[BasePath] = st.one_of(
    st.builds(Line, speed=between(-1, 1), start=starts, ramp=ramps),
    st.builds(Circle, between(0.2, 5), between(-1, 1), starts, st.sampled_from([1, -1]), ramps),
    st.builds(Eight, between(0.5, 5), between(0.5, 5), either_sign(8, 30), starts, ramps),
    st.builds(Waypoints, st.just(POINTS), either_sign(0.2, 1), between(0.1, 0.7), ramps),
)
profiles: SearchStrategy[JointProfile] = st.one_of(
    st.builds(Sine, between(-2, 2), between(0.5, 10), between(-1, 1), between(-4, 4)),
    st.builds(
        Sines, st.tuples(between(-1, 1), between(-1, 1)), st.tuples(between(0.5, 9), between(0.5, 9)), between(-1, 1)
    ),
    st.builds(Hold, between(-3, 3)),
    st.builds(MinimumJerk, between(-2, 2), between(-2, 2), between(0.5, 5), between(0, 3)),
)


def assert_derivative(left: np.ndarray, right: np.ndarray, rate: np.ndarray, h: float) -> None:
    """Central differences of values against their claimed rates."""
    np.testing.assert_allclose((right - left) / (2 * h), rate, atol=2e-6 * max(1, abs(rate).max()))


@settings(max_examples=80, deadline=None)
@given(paths)
def test_base_derivatives_agree_with_differences(path: BasePath) -> None:
    h, at = 1e-5, TIMES
    if isinstance(path, Waypoints):  # also on the way to rest
        at = np.r_[TIMES, path.duration - np.array([0.1, 0.3, 0.6]) * max(path.ramp, 1)]
    a, m, b = (path.sample(at + d) for d in (-h, 0, h))
    phi, (v, w) = m.pose[:, 2], m.velocity.T
    rate = np.stack([v * np.cos(phi), v * np.sin(phi), w], axis=1)  # R(phi) (v, 0), w
    assert_derivative(a.pose, b.pose, rate, h)
    moving = np.ones(len(at), bool)
    if isinstance(path, Waypoints):  # with ramp = 0 the speed jumps at the end
        moving = abs(at - path.duration) > 2 * h
    assert_derivative(a.velocity[moving], b.velocity[moving], m.acceleration[moving], h)


@settings(max_examples=60, deadline=None)
@given(profiles)
def test_joint_derivatives_agree_with_differences(profile: JointProfile) -> None:
    h = 1e-5
    a, m, b = (profile.sample(TIMES + d) for d in (-h, 0, h))
    assert_derivative(a.q, b.q, m.qdot, h)
    inside = np.ones(len(TIMES), bool)
    if isinstance(profile, MinimumJerk):  # its jerk, and so the error of a difference, jumps at both ends
        ends = profile.begin, profile.begin + profile.duration
        inside = np.min([abs(TIMES - end) for end in ends], axis=0) > 2 * h
    scale = max(1, abs(m.qddot).max())
    np.testing.assert_allclose(((b.qdot - a.qdot) / (2 * h))[inside], m.qddot[inside], atol=2e-6 * scale)


def test_a_sum_of_sines_is_the_sum_of_its_sines() -> None:
    samples = Sines((0.7, 0.1), (3.0, 0.6), 0.4, (1.0, 2.0)).sample(TIMES)
    each = 0.7 * np.sin(2 * np.pi * TIMES / 3.0 + 1.0), 0.1 * np.sin(2 * np.pi * TIMES / 0.6 + 2.0)
    np.testing.assert_allclose(samples.q, 0.4 + sum(each), atol=1e-12)
    rate = -each[0] * (2 * np.pi / 3.0) ** 2 - each[1] * (2 * np.pi / 0.6) ** 2
    np.testing.assert_allclose(samples.qddot, rate, atol=1e-10)
    np.testing.assert_array_equal(Sines((0.7,), (3.0,), 0.4).sample(TIMES).qdot, Sine(0.7, 3.0, 0.4).sample(TIMES).qdot)


@settings(max_examples=40, deadline=None)
@given(paths)
def test_paths_start_at_the_start_with_continuous_heading(path: BasePath) -> None:
    samples = path.sample(np.linspace(0, 20, 4001))
    if not isinstance(path, Waypoints):
        np.testing.assert_allclose(samples.pose[0], path.start, atol=1e-12)  # type: ignore[attr-defined]
    assert abs(np.diff(samples.pose[:, 2])).max() < 1  # unwrapped, no jump by 2 pi


@pytest.mark.parametrize("path", [Line(0.5, ramp=2), Circle(1, -0.5, ramp=2), Eight(3, 2, 10, ramp=2)])
def test_a_ramp_starts_from_rest_and_reaches_the_unramped_speed(path: BasePath) -> None:
    samples = path.sample(np.array([0.0, 3.0]))
    np.testing.assert_allclose([samples.velocity[0], samples.acceleration[0]], 0, atol=1e-12)
    assert abs(samples.velocity[1]).max() > 0.1


def test_reversing_keeps_the_heading_and_the_circle() -> None:
    t = np.linspace(0, 10, 200)
    back = Line(-0.4, (1, 2, 0.3)).sample(t)
    np.testing.assert_allclose(back.pose[:, 2], 0.3)
    assert (back.velocity[:, 0] == -0.4).all()
    ahead, back = (Circle(2.0, speed, (0, 0, 0)).sample(t) for speed in (0.5, -0.5))
    for circle in (ahead, back):
        np.testing.assert_allclose(np.hypot(circle.pose[:, 0], circle.pose[:, 1] - 2), 2)
    np.testing.assert_allclose(ahead.velocity, -back.velocity)


def test_turn_says_on_which_side_the_centre_lies() -> None:
    t = np.linspace(0, 10, 200)
    for turn in (1, -1):
        circle = Circle(2.0, 0.5, turn=turn).sample(t)
        np.testing.assert_allclose(np.hypot(circle.pose[:, 0], circle.pose[:, 1] - 2 * turn), 2)
        assert (np.sign(circle.velocity[:, 1]) == turn).all()


def test_eight_fills_its_box_and_closes() -> None:
    t = np.linspace(0, 12, 20001)
    eight = Eight(3.0, 1.2, 12, start=(0, 0, float(np.arctan2(1.2, 1.5)))).sample(t)  # its own frame is the world's
    np.testing.assert_allclose(np.ptp(eight.pose[:, :2], axis=0), [3.0, 1.2], rtol=1e-6)
    np.testing.assert_allclose(eight.pose[0], eight.pose[-1], atol=1e-9)  # one loop to each side, no net turn


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(between(-5, 5), between(-5, 5)), min_size=2, max_size=6),
    either_sign(0.1, 1),
    between(0.02, 1),
)
def test_waypoints_never_exceed_the_curvature(points: list[tuple[float, float]], speed: float, radius: float) -> None:
    try:
        path = Waypoints(tuple(points), speed, radius, ramp=0)
    except TrajectoryError:
        return
    t = np.linspace(0, path.duration, 3000)
    samples = path.sample(t)
    inner = samples.velocity[:-1]  # at the very end it stands
    assert (abs(inner[:, 1]) <= abs(inner[:, 0]) / radius * (1 + 1e-9)).all()
    np.testing.assert_allclose(samples.pose[[0, -1], :2], [points[0], points[-1]], atol=1e-9)
    step = np.hypot(*np.diff(samples.pose[:, :2], axis=0).T)  # no gap between the pieces, at constant speed
    assert step.max() <= abs(speed) * t[1] * (1 + 1e-9)
    assert (np.sign(inner[:, 0]) == np.sign(speed)).all()


def test_waypoints_reach_the_bound_and_turn_without_a_jump() -> None:
    path = Waypoints(POINTS, speed=0.5, radius=0.5)
    t = np.linspace(0, path.duration, 40001)
    samples = path.sample(t)
    w, wdot = samples.velocity[:, 1], samples.acceleration[:, 1]
    assert abs(w).max() == pytest.approx(0.5 / 0.5, rel=1e-4)
    assert abs(np.diff(w)).max() < 2e-3
    assert abs(np.diff(wdot)).max() < 1e-2  # an arc would make wdot a spike, a clothoid would make it jump by 1
    ends = np.r_[samples.velocity[[0, -1]], samples.acceleration[[0, -1]]]
    np.testing.assert_allclose(ends, 0, atol=1e-9)
    after = path.sample(np.array([path.duration + 5]))
    np.testing.assert_allclose(after.pose[0], samples.pose[-1])
    assert not after.velocity.any()


def test_waypoints_backwards_follow_the_same_path_tail_first() -> None:
    ahead, back = (Waypoints(POINTS, speed, 0.5) for speed in (0.5, -0.5))
    t = np.linspace(0, ahead.duration, 500)
    a, b = ahead.sample(t), back.sample(t)
    np.testing.assert_allclose(a.pose + np.array([0, 0, np.pi]), b.pose, atol=1e-12)
    np.testing.assert_allclose(a.velocity * np.array([-1, 1]), b.velocity, atol=1e-12)


def test_radius_offered_for_crowded_waypoints_fits() -> None:
    with pytest.raises(TrajectoryError) as refused:
        Waypoints(POINTS, 0.5, radius=3.0)
    offered = float(refused.value.fix.split("<= ")[1].split(" m")[0])
    Waypoints(POINTS, 0.5, radius=offered * 0.995)
    with pytest.raises(TrajectoryError):
        Waypoints(POINTS, 0.5, radius=offered * 1.01)


def test_minimum_jerk_rests_at_both_ends() -> None:
    samples = MinimumJerk(0.2, 1.5, duration=2, begin=1).sample(np.array([0, 1, 2, 3, 9]))
    np.testing.assert_allclose(samples.q, [0.2, 0.2, 0.85, 1.5, 1.5])
    np.testing.assert_allclose(samples.qdot[[0, 1, 3, 4]], 0, atol=1e-12)
    np.testing.assert_allclose(samples.qddot, 0, atol=1e-12)  # also half way, by symmetry
    assert samples.qdot[2] == pytest.approx(1.875 * 1.3 / 2)  # Flash and Hogan: the peak is 1.875 times the mean


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Line(float("nan")), "speed = nan is not finite"),
        (lambda: Line(1, start=(0, 0)), "not a pose"),  # type: ignore[arg-type]
        (lambda: Line(1, ramp=-1), "ramp = -1 s is negative"),
        (lambda: Circle(0, 1), "radius = 0 is not positive"),
        (lambda: Circle(1, 1, turn=2), "turn = 2"),
        (lambda: Eight(1, -1, 10), "width = -1"),
        (lambda: Eight(1, 1, 0), "period = 0"),
        (lambda: Waypoints(((0, 0),), 1, 1), "two or more"),
        (lambda: Waypoints(((0, 0), (1, 0), (1, 0)), 1, 0.1), "points 1 and 2 are the same"),
        (lambda: Waypoints(((0, 0), (3, 0), (0, 0)), 1, 0.1), "turns back at point 1"),
        (lambda: Waypoints(((0, 0), (3, 0), (3, 1), (6, 1)), 1, 1), "points 1 and 2 are too close"),
        (lambda: Waypoints(((0, 0), (1, 0)), 1, 1, ramp=2), "too short for ramps"),
        (lambda: Waypoints(((0, 0), (1, 0)), 0, 1), "speed = 0"),
        (lambda: Sine(1, 0), "period = 0 is not positive"),
        (lambda: Hold(float("inf")), "value = inf"),
        (lambda: MinimumJerk(0, 1, -1), "duration = -1"),
        (lambda: Sines((), ()), "0 amplitudes"),
        (lambda: Sines((1.0, 2.0), (1.0,)), "2 amplitudes, 1 periods"),
        (lambda: Sines((1.0,), (1.0,), phase=(1.0, 2.0)), "2 phases"),
        (lambda: Sines((1.0,), (0.0,)), "period = 0"),
        (lambda: Line(1).sample([-1.0]), "sample times"),
    ],
)
def test_refusals_say_what(make, says: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(TrajectoryError) as refused:
        make()
    assert says in str(refused.value)


# --- tables


def circle_samples(n: int = 101) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = np.linspace(0, 10, n)
    samples = Circle(1.0, 0.5, ramp=2).sample(t)
    return t, samples.pose, samples.velocity


def test_table_gives_back_the_motion_it_was_sampled_from() -> None:
    t, pose, velocity = circle_samples()
    wrapped = pose.copy()
    wrapped[:, 2] = np.angle(np.exp(1j * pose[:, 2]))
    dense = np.linspace(0, 10, 777)
    got, true = BaseTable(t, wrapped, velocity).sample(dense), Circle(1.0, 0.5, ramp=2).sample(dense)
    np.testing.assert_allclose(got.pose, true.pose, atol=1e-5)
    np.testing.assert_allclose(got.velocity, true.velocity, atol=1e-4)
    np.testing.assert_allclose(got.acceleration, true.acceleration, atol=1e-2)


def test_table_refuses_sideways_motion_and_names_time_and_speed() -> None:
    t, pose, velocity = circle_samples()
    sideways = pose + np.outer(t, [0, 0.3, 0])  # the whole circle drifts along y
    with pytest.raises(TrajectoryError) as refused:
        BaseTable(t, sideways, velocity)
    at = float(refused.value.what.split("t = ")[1].split(" s")[0])
    speed = float(refused.value.what.split("by ")[1].split(" m/s")[0])
    phi = pose[int(np.argmin(abs(t - at))), 2]
    assert speed == pytest.approx(0.3 * np.cos(phi), rel=0.05)
    assert abs(speed) == pytest.approx(0.3, rel=0.05)
    check_followable(t, pose, velocity)  # without the drift it passes


@pytest.mark.parametrize(("column", "name"), [(0, "v ="), (1, "w =")])
def test_table_refuses_velocities_of_another_motion(column: int, name: str) -> None:
    t, pose, velocity = circle_samples()
    velocity = velocity.copy()
    velocity[50, column] += 0.2
    with pytest.raises(TrajectoryError, match=name) as refused:
        BaseTable(t, pose, velocity)
    assert "t = 5 s" in refused.value.what


def test_table_accepts_reversing() -> None:
    t = np.linspace(0, 10, 101)
    samples = Circle(1.0, -0.5).sample(t)
    BaseTable(t, samples.pose, samples.velocity)


def test_table_ends_where_its_samples_end() -> None:
    table = BaseTable(*circle_samples())
    with pytest.raises(TrajectoryError, match="ends at 10 s"):
        table.sample([10.5])


def test_table_refuses_malformed_samples() -> None:
    t, pose, velocity = circle_samples()
    with pytest.raises(TrajectoryError, match="shapes"):
        BaseTable(t, pose[:, :2], velocity)
    with pytest.raises(TrajectoryError, match="does not increase"):
        BaseTable(t[::-1], pose, velocity)
    with pytest.raises(TrajectoryError, match="not finite"):
        BaseTable(t, pose * np.nan, velocity)


def test_table_reads_csv_and_points_at_the_line(tmp_path: Path) -> None:
    t, pose, velocity = circle_samples()
    file = tmp_path / "reference.csv"
    lines = [",".join(f"{x:.9f}" for x in row) for row in np.c_[t, pose, velocity]]
    file.write_text("\n".join(["t,x,y,phi,v,w", *lines]))
    np.testing.assert_allclose(BaseTable.read(file).sample(t).pose, pose, atol=1e-6)
    lines[4] = lines[4].replace(".", ",,", 1)
    file.write_text("\n".join(["t,x,y,phi,v,w", *lines]))
    with pytest.raises(TrajectoryError) as refused:
        BaseTable.read(file)
    assert str(refused.value).startswith(f"{file}:6: error: x = '' is not a number")
    file.write_text("t,x,y,phi,v\n0,0,0,0,0\n1,0,0,0,0\n")
    with pytest.raises(TrajectoryError, match="no column w"):
        BaseTable.read(file)


def test_standing_references_are_warned_about_and_moving_ones_are_not() -> None:
    t = np.linspace(0, 10, 1001)
    assert warnings(Line(0.3).sample(t)) == []
    assert warnings(Line(0.3, ramp=0.5).sample(t)) == []  # short
    assert len(warnings(Line(0.0).sample(t))) == 1
    stop = Waypoints(((0, 0), (1, 0)), 0.5, 1).sample(t)  # rests from 3 s on
    assert len(warnings(stop)) == 1
    assert "to 10 s" in warnings(stop)[0]


# --- both together


@pytest.mark.parametrize(
    ("base", "arm"), [(Circle(1, 0.3), (Sine(0.7, 4), Hold(0.7))), (None, (Sine(0.5, 4),)), (Line(0.3), ())]
)
def test_table_rows_are_the_consecutive_reference_signals(base: BasePath | None, arm: tuple[JointProfile, ...]) -> None:
    layout = Layout(base=2 if base else 0, arm=len(arm), full=7, motors=4)
    t = np.linspace(0, 3, 31)
    table = Trajectory(base, arm).table(t, layout)
    assert table.flags.c_contiguous
    assert table.dtype == np.float64
    row = layout.new_row()
    row[layout.where("pose_ref").start : layout.where("qddot_ref").stop] = table[7]
    view = Setpoint.of(row, layout)
    if base:
        samples = base.sample(t)
        np.testing.assert_array_equal(view.pose, samples.pose[7])
        np.testing.assert_array_equal(view.velocity, samples.velocity[7])
        np.testing.assert_array_equal(view.acceleration, samples.acceleration[7])
    for i, profile in enumerate(arm):
        joint = profile.sample(t)
        assert (view.q[i], view.qdot[i], view.qddot[i]) == (joint.q[7], joint.qdot[7], joint.qddot[7])


def test_trajectory_must_fit_the_robot() -> None:
    t = np.zeros(1)
    with pytest.raises(TrajectoryError, match=r"\(v, w\) for a base of \(vx, vy, w\)"):
        Trajectory(Line(1)).table(t, Layout(base=3, arm=0, full=3, motors=3, sideways=True))
    with pytest.raises(TrajectoryError, match=r"no velocities for a base of \(v, w\)"):
        Trajectory(None).table(t, Layout(base=2, arm=0, full=5, motors=2))
    with pytest.raises(TrajectoryError, match="1 arm profiles for 2"):
        Trajectory(Line(1), (Hold(0),)).table(t, Layout(base=2, arm=2, full=7, motors=4))


class Sideways(BasePath):
    """A user's own path: it slides along y while it looks along x."""

    def sample(self, t: np.ndarray) -> BaseSamples:
        zero = np.zeros_like(t)
        return BaseSamples(t, np.stack([t, 0.2 * t, zero], 1), np.stack([zero + 1, zero], 1), np.zeros((len(t), 2)))


def test_a_users_path_that_slides_sideways_is_refused_when_sampled() -> None:
    with pytest.raises(TrajectoryError, match=r"sideways .* 0\.2 m/s"):
        Trajectory(Sideways()).table(np.linspace(0, 1, 50), Layout(base=2, arm=0, full=5, motors=2))
