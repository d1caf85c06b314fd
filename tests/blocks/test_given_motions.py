"""Trajectories from data: waypoints, arrays and CSV files, for base and arm, in Python, in TOML and by `--set`."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from test_holonomic import mecanum

from mmnn_pin import Circle, Eight, Hold, Line, Sine, Trajectory, load, load_experiment
from mmnn_pin.cli import main
from mmnn_pin.errors import InputError, TrajectoryError, UnknownName
from mmnn_pin.model.robot import Robot
from mmnn_pin.reference import JointTable, Points
from mmnn_pin.reference.rollable import moved, slopes
from mmnn_pin.reference.samples import integrated, table_of
from mmnn_pin.signals import Setpoint

T = np.linspace(0.0, 4.0, 201)


@cache
def robot(name: str = "platform_arm") -> Robot:
    return load(name)


def drawn(path: Trajectory, r: Robot, times: np.ndarray) -> Setpoint:
    return Setpoint.side_by_side(path.table(times, r.dimensions), r.dimensions)


def test_arrays_give_back_the_motion_that_they_were_drawn_from() -> None:
    """The second answer is the analytic path: the splines between its samples must agree with it."""
    r, arm = robot(), {"arm_1_joint": Sine(0.5, 3.0), "arm_2_joint": Sine(0.3, 2.0, 0.1)}
    whole = Trajectory.of(r, base=Eight(2.0, 1.0, 12.0, ramp=1.0), arm=arm)
    at = drawn(whole, r, T)
    for given_rates in (False, True):
        rates = {"velocity": at.velocity, "qdot": at.qdot} if given_rates else {}
        made = drawn(Trajectory.from_arrays(r, T, at.pose, at.q, **rates), r, T[5:-5] + 0.007)  # type: ignore[arg-type]
        true = drawn(whole, r, T[5:-5] + 0.007)
        np.testing.assert_allclose(made.pose, true.pose, atol=1e-6)
        np.testing.assert_allclose(made.q, true.q, atol=1e-6)
        np.testing.assert_allclose(made.velocity, true.velocity, atol=2e-4)
        np.testing.assert_allclose(made.qdot, true.qdot, atol=2e-4)
        np.testing.assert_allclose(made.qddot, true.qddot, atol=2e-2)


def test_a_heading_may_be_wrapped() -> None:
    r = robot()
    circle = drawn(Trajectory.of(r, base=Circle(0.5, 1.0)), r, T)
    wrapped = circle.pose.copy()
    wrapped[:, 2] = np.angle(np.exp(1j * wrapped[:, 2]))
    assert np.ptp(wrapped[:, 2]) < np.ptp(circle.pose[:, 2])
    np.testing.assert_allclose(drawn(Trajectory.from_arrays(r, T, wrapped), r, T).velocity, circle.velocity, atol=1e-3)


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-3, 3), min_size=2, max_size=8),
    st.lists(st.floats(0.05, 2.0), min_size=1, max_size=7),
    st.floats(0.0, 2.0),
)
def test_an_arm_goes_through_its_points_from_rest_to_rest(q: list[float], gaps: list[float], first: float) -> None:
    count = min(len(q), len(gaps) + 1)
    time = first + np.cumsum([0.0, *gaps[: count - 1]])
    points = Points(tuple(time), tuple(q[:count]))
    at = points.sample(time)
    np.testing.assert_allclose(at.q, q[:count], atol=1e-9)
    ends = points.sample([0.0, time[0], time[-1], time[-1] + 1.0])
    np.testing.assert_allclose(ends.qdot, 0.0, atol=1e-7)
    np.testing.assert_allclose(ends.q, [q[0], q[0], q[count - 1], q[count - 1]], atol=1e-9)
    inside = np.linspace(time[0] + 1e-4, time[-1] - 1e-4, 20)
    h = 1e-5
    slope = (points.sample(inside + h).q - points.sample(inside - h).q) / (2 * h)
    np.testing.assert_allclose(points.sample(inside).qdot, slope, atol=1e-3 * max(1.0, abs(slope).max()))


def test_waypoints_share_one_time_and_what_is_not_named_stands_still() -> None:
    r = robot()
    path = Trajectory.from_waypoints(r, base=[(0, 0), (2, 0), (2, 2)], arm=[(0, 0), (0.5, 1), (0, 0.3)], speed=0.4)
    end = drawn(path, r, np.array([path.duration, path.duration + 3.0]))
    np.testing.assert_allclose(end.pose[:, :2], 2.0, atol=1e-9)
    np.testing.assert_allclose(end.q, [[0, 0.3]] * 2, atol=1e-9)
    still = drawn(Trajectory.from_waypoints(r, arm=[(0, 0), (1, 1)], times=(0.5, 2.0)), r, T)
    assert not still.pose.any() and not still.velocity.any()
    only = Trajectory.from_arrays(r, T, q={"arm_2_joint": 0.1 * T})
    np.testing.assert_allclose(drawn(only, r, T).q[:, 0], r.neutral()[3])
    assert only.duration == 4.0 and Trajectory.of(r, base=Line(0.3)).duration == np.inf


def test_a_csv_file_gives_the_same_motion_as_its_arrays(tmp_path: Path) -> None:
    r = robot()
    at = drawn(Trajectory.of(r, base=Circle(1.0, 0.4, ramp=1.0), arm={"arm_1_joint": Sine(0.5, 3.0)}), r, T)
    columns = np.column_stack((at.q[:, 0], T, at.pose, at.velocity, at.qdot[:, 0]))
    heads = "position.arm_1_joint [rad],t [s],x,y,phi,v,w,velocity.arm_1_joint"
    np.savetxt(file := tmp_path / "motion.csv", columns, delimiter=",", header=heads, comments="", fmt="%.17g")
    rates = {"velocity": at.velocity, "qdot": {"arm_1_joint": at.qdot[:, 0]}}
    arrays = Trajectory.from_arrays(r, T, at.pose, {"arm_1_joint": at.q[:, 0]}, **rates)  # type: ignore[arg-type]
    read = Trajectory.from_csv(r, file)
    np.testing.assert_array_equal(read.table(T, r.dimensions), arrays.table(T, r.dimensions))
    made = load_experiment("track", [f"reference.file={file}", "time.duration=4"]).trajectory_of(r)
    np.testing.assert_array_equal(made.table(T, r.dimensions), read.table(T, r.dimensions))


def test_a_file_of_the_base_alone_leaves_the_arm_to_the_tables(tmp_path: Path) -> None:
    r, file = robot(), tmp_path / "base.csv"
    np.savetxt(file, np.column_stack((T, 0.2 * T, 0 * T, 0 * T)), delimiter=",", header="t,x,y,phi", comments="")
    arm = 'reference.arm={ type = "points", time = [0.0, 2.0, 4.0], position = [0.0, 0.7, 0.1] }'
    made = load_experiment("track", [f"reference.file={file}", arm, "time.duration=4"]).trajectory_of(r)
    np.testing.assert_allclose(drawn(made, r, np.array([2.0, 4.0])).q, [[0.7, 0.7], [0.1, 0.1]], atol=1e-12)
    np.testing.assert_allclose(drawn(made, r, T).velocity[:, 0], 0.2, atol=1e-9)
    file.write_text("t,x,y,phi\n" + "\n".join(f"{t},{0.4 * t},0,0" for t in T))
    again = load_experiment("track", [f"reference.file={file}", "time.duration=4"])
    np.testing.assert_allclose(drawn(again.trajectory_of(r), r, T).velocity[:, 0], 0.4, atol=1e-6)


@pytest.mark.parametrize("mark", [";", "\t"])
def test_cells_may_be_separated_by_semicolons_or_tabs(mark: str, tmp_path: Path) -> None:
    text = "t [s],x,y,phi,position.arm_1_joint\n" + "".join(f"{t},{0.2 * t},0,0,{0.1 * t}\n" for t in T)
    (tmp_path / "commas.csv").write_text(text)
    (tmp_path / "others.csv").write_text(text.replace(",", mark))
    one, other = (Trajectory.from_csv(robot(), tmp_path / f"{name}.csv") for name in ("commas", "others"))
    np.testing.assert_array_equal(one.table(T, robot().dimensions), other.table(T, robot().dimensions))
    (tmp_path / "others.csv").write_text("t;x;y;phi\n0;0;0;0\n1;0,5;0;0\n")
    with pytest.raises(TrajectoryError, match=r"others.csv:3: error: x = '0,5' is not a number: write a decimal point"):
        Trajectory.from_csv(robot(), tmp_path / "others.csv")


def test_a_run_ends_with_its_file_unless_the_user_says_how_long(tmp_path: Path) -> None:
    (file := tmp_path / "short.csv").write_text(
        "t,position.arm_1_joint\n" + "".join(f"{t},{0.1 * t}\n" for t in np.linspace(0.0, 2.5004, 9))
    )
    given = f"reference.file={file}"
    assert load_experiment("track", [given]).time.duration == 2.5
    assert load_experiment("track", [given, "time.control_period=0.01"]).time.duration == 2.5
    assert load_experiment("track", [given, "time.control_period=0.002"]).time.duration == 2.5
    assert load_experiment("track", [given, "time.duration=1.5"]).time.duration == 1.5
    assert load_experiment("track").time.duration == 10.0
    trajectory = load_experiment("track", [given]).trajectory_of(robot())
    assert trajectory.table(np.arange(2500) * 0.001, robot().dimensions).shape[0] == 2500
    with pytest.raises(TrajectoryError, match=r"the reference ends at .*shorten the run"):
        load_experiment("track", [given, "time.duration=4"]).trajectory_of(robot()).table([4.0], robot().dimensions)
    own = tmp_path / "own.toml"
    own.write_text(f'experiment = "track"\n[reference]\nfile = "{file}"\n')
    assert load_experiment(own).time.duration == 2.5
    own.write_text(f'experiment = "track"\n[time]\nduration = 3.0\n[reference]\nfile = "{file}"\n')
    assert load_experiment(own).time.duration == 3.0
    for time, seconds in (("", 2.5), ("[time]\ncontrol_period = 0.004\n", 2.5), ("[time]\nduration = 4.0\n", 4.0)):
        own.write_text(f'robot = "platform_arm"\n[reference]\nfile = "{file}"\n{time}')  # on no other experiment
        assert load_experiment(own).time.duration == seconds
    file.write_text(file.read_text() + "12.0,0.3\n")
    assert load_experiment("track", [given]).time.duration == 10.0  # it goes on, as a note says


BAD = {
    "not a number": ("t,x,y,phi\n0,0,0,0\n1,1,nan,0\n", "y = nan is not finite: give a number there", 3),
    "infinite": ("t,x,y,phi\n0,0,0,0\n1,1,0,-inf\n", "phi = -inf is not finite", 3),
    "no x": ("t,y,phi,arm_9\n0,0,0,1\n", "no column x", 1),
    "no motion": ("t,arm_9\n0,1\n", "no motion of platform_arm", 1),
    "no time": ("x,y,arm_1_joint\n0,0,0\n1,0,0\n", "no column t: x and y alone are driven as fast", 1),
    "no way": ("x,y,phi\n0,0,0\n", "points that are all in one place", None),
    "no w": ("t,v\n0,0\n1,0\n", "no column w: give v, w, or none of them", 1),
    "no time for joints": ("x_1,arm_1_joint\n0,0\n1,0\n", "no column t: give the times, in seconds, in a column t", 1),
    "times in another unit": ("time_ms,x,y\n0,0,0\n100,1,0\n", "no column t: 'time_ms' may be it: name it t where", 1),
    "of another base": ("t,vx,vy,w\n0,0,0,0\n1,0,0,0\n", "nothing uses the column 'vy': this base moves by v, w", 1),
    "two of one": ("t,v,vx,w\n0,0,0,0\n1,0,0,0\n", "nothing uses the column 'v': this base moves by v, w", 1),
    "a heading": ("t,x,y,Yaw\n0,0,0,0\n1,1,0,0\n", "nothing uses the column 'Yaw': it may be the heading", 1),
    "a jump of a joint": (
        "t,arm_1_joint\n" + "".join(f"{k / 10},{0.001 * k + 0.6 * (k > 20)}\n" for k in range(40)),
        "arm_1_joint jumps by 0.601 rad to its row of t = 2.1 s: that is 6.01 rad/s, beside 0.01 rad/s around it",
        23,
    ),
    "a jump of the base": (
        "t,x,y,phi\n" + "".join(f"{k / 10},{0.02 * k + 0.5 * (k > 20)},0,0\n" for k in range(40)),
        "x jumps by 0.52 m to its row of t = 2.1 s",
        23,
    ),
    "too far": (
        "t,x,y,phi\n" + "".join(f"{k / 10},{0.03 * k},{0.01 * k},0\n" for k in range(40)),
        "the nearest motion that rolls passes .* beside the sample of .* \\(allowed 0.02 m, 0.1 rad\\)",
        None,
    ),
    "of another motion": (
        "t,x,y,phi,v,w\n" + "".join(f"{k / 10},{0.02 * k},0,0,0.5,0\n" for k in range(40)),
        "v = 0.5 m/s at t = .* s, the poses move at 0.2",
        None,
    ),
    "a word": ("t,x,y,phi\n0,0,0,0\n1,one,0,0\n", "x = 'one' is not a number", 3),
    "a short line": ("t,x,y,phi\n0,0,0,0\n1,1,0\n", "phi = '' is not a number", 3),
    "too few": ("t,x,y,phi\n0,0,0,0\n1,1,0,0\n", "2 samples: a spline takes four or more", None),
    "sideways": ("t,x,y,phi\n" + "".join(f"{k},0,{k},0\n" for k in range(6)), "moves sideways", None),
    "nothing": ("", "no rows", 1),
    "no rows": ("t,x,y,phi\n\n", "no rows", 1),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_named_with_its_line(case: str, tmp_path: Path) -> None:
    text, words, line = BAD[case]
    (file := tmp_path / "bad.csv").write_text(text)
    with pytest.raises(TrajectoryError, match=words) as refused:
        Trajectory.from_csv(robot(), file)
    assert (refused.value.file, refused.value.line) == (file, line)
    with pytest.raises(InputError, match=words):
        load_experiment("track", [f"reference.file={file}"]).trajectory_of(robot())


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda r: Trajectory.from_arrays(r, T, np.zeros((9, 3))), "samples of shapes"),
        (lambda r: Trajectory.from_arrays(r, T, np.zeros((201, 4))), "samples of shapes"),
        (lambda r: Trajectory.from_arrays(r, T, q=np.zeros((201, 3))), "give \\(N, 2\\): arm_1_joint, arm_2_joint"),
        (lambda r: Trajectory.from_arrays(r, T, q={"arm_1_joint": 0.1 * T[1:]}), "give as many of each"),
        (lambda r: Trajectory.from_arrays(r, T[::-1], q={"arm_1_joint": 0.1 * T}), "does not increase at sample 1"),
        (lambda r: Trajectory.from_arrays(r, T + 1.0, q={"arm_1_joint": 0.1 * T}), "time starts at 1 s"),
        (lambda r: Trajectory.from_arrays(r, T, q={"arm_1_joint": 0.0 * T + 4.0}), "= 4 is beyond the joint's limits"),
        (lambda r: Trajectory.from_waypoints(r, arm=[(0, 0), (4, 0)]), "beyond the joint's limits"),
        (
            lambda r: Trajectory.from_waypoints(r, arm=[(0, 0), (1, 0)], duration=-2.0),
            "duration = -2.0 is not positive",
        ),
        (lambda r: Trajectory.from_arrays(r, T, q={"arm_1_joint": T * np.nan}), "not finite"),
        (lambda r: Trajectory.from_waypoints(r, base=[(0, 0)]), "two or more"),
        (lambda r: Trajectory.from_waypoints(r, base=[(0, 0, 0), (1, 1, 1)]), "two or more \\(x, y\\)"),
        (lambda r: Trajectory.from_waypoints(r, arm=[(0, 0), (1, 1)], times=(1.0, 1.0)), "do not increase"),
        (lambda r: Trajectory.from_waypoints(r, arm=[(0, 0), (1, 1)], times=(1.0,)), "one time for each"),
        (lambda r: Trajectory.of(load("two_axis_arm"), base=Line(0.3)), "its base does not move"),
    ],
)
def test_wrong_data_is_refused_with_what_is_taken(make: object, words: str) -> None:
    with pytest.raises(TrajectoryError, match=words):
        make(robot())  # type: ignore[operator]


def test_a_joint_that_is_not_there_is_named() -> None:
    for make in (
        lambda: Trajectory.of(robot(), arm={"arm_1_jont": Hold(0.0)}),
        lambda: Trajectory.from_arrays(robot(), T, q={"arm_1_jont": T}),
    ):
        with pytest.raises(UnknownName, match="did you mean 'arm_1_joint'"):
            make()


def test_samples_of_a_joint_are_scipys_spline_and_end_when_they_end() -> None:
    q = np.cumsum(np.random.default_rng(0).normal(size=T.size)) * 0.01
    table = JointTable(T, q)
    np.testing.assert_allclose(table.sample(T[:-1] + 0.01).qdot, CubicSpline(T, q)(T[:-1] + 0.01, 1), atol=1e-12)
    with pytest.raises(TrajectoryError, match=r"time\.duration = 4"):
        table.sample([4.1])


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ("t,position.elbow\n0,0\n1,0\n", "position.elbow: error: unknown joint 'elbow': there is: arm_1_joint"),
        ("t,velocity.arm_1\n0,0\n1,0\n", "velocity.arm_1: error: unknown joint 'arm_1': did you mean 'arm_1_joint'?"),
        ("t,position.arm_1_joint\n0,0\n1,9\n", "motion.csv:3: error: position.arm_1_joint = 9 is beyond the joint's"),
    ],
)
def test_columns_that_no_joint_can_follow_are_refused(tmp_path: Path, rows: str, told: str) -> None:
    file = tmp_path / "motion.csv"
    file.write_text(rows)
    with pytest.raises(InputError) as error:
        Trajectory.from_csv(load("platform_arm"), file)
    assert told in str(error.value)


def test_a_trajectory_of_arrays_is_one_short_line_and_a_table_in_a_notebook() -> None:
    robot, t = load("platform_arm"), np.linspace(0.0, 2.0, 500)
    pose, q = np.column_stack((0.1 * t, 0 * t, 0 * t)), np.zeros((500, 2))
    made = Trajectory.from_arrays(robot, t, pose, q)
    assert repr(made) == "<Trajectory: base BaseTable of 500 samples; arm 2 JointTable; 2 s>"
    assert made._repr_html_().count("<tr>") == 3 and len(made._repr_html_()) < 500
    drawn = Trajectory(Line(0.3), (Sine(0.8, 4.0), Hold(0.8)))
    assert repr(drawn) == "<Trajectory: base Line; arm Sine, Hold; without an end>"
    assert "Sine(amplitude=0.8, period=4.0, offset=0.0, phase=0.0)" in drawn._repr_html_()


def csv_of(file: Path, head: str, *columns: np.ndarray) -> Path:
    file.write_text(
        "\n".join([head, *(",".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True))])
    )
    return file


@pytest.mark.parametrize("name", ["arm1", "q.arm_1_joint", "arm_1_jiont", "ARM_1_JOINT", "arm_1 pos"])
def test_a_column_that_looks_like_a_joint_without_one_is_refused_and_the_fix_works(name: str, tmp_path: Path) -> None:
    file = csv_of(tmp_path / "a.csv", f"t,{name},arm_2_joint,effort.arm_1_joint,note", T, 0.1 * T, 0.2 * T, T, T)
    with pytest.raises(TrajectoryError, match=r"a\.csv:1: error: nothing uses the column") as error:
        Trajectory.from_csv(robot(), file)
    file.write_text(file.read_text().replace(name, error.value.fix.split()[2].strip(","), 1))
    np.testing.assert_allclose(drawn(Trajectory.from_csv(robot(), file), robot(), T).q[:, 0], 0.1 * T, atol=1e-6)


def test_times_in_milliseconds_are_refused_but_not_those_that_say_seconds(tmp_path: Path) -> None:
    columns = 1000.0 * T, 0.1 * T, 0.1 * T
    file = csv_of(tmp_path / "a.csv", "t,arm_1_joint,arm_2_joint", *columns)
    with pytest.raises(TrajectoryError, match=r"a\.csv:1: error: one row every 20 s: .* look like milliseconds"):
        Trajectory.from_csv(robot(), file)
    csv_of(file, "t [ms],arm_1_joint,arm_2_joint", *columns)
    with pytest.raises(TrajectoryError, match=r"a\.csv:1: error: times in \[ms\]"):
        Trajectory.from_csv(robot(), file)
    csv_of(file, "t [s],arm_1_joint,arm_2_joint", *columns)
    assert Trajectory.from_csv(robot(), file).duration == pytest.approx(4000.0)
    csv_of(file, "t,arm_1_joint,arm_2_joint", *(column[::20] for column in columns))  # few rows: waypoints
    assert Trajectory.from_csv(robot(), file).duration == pytest.approx(4000.0)


# -- paths as planners write them --------------------------------------------------------------------------------------


def waves(rng: np.random.Generator, t: np.ndarray, most: float) -> np.ndarray:
    """A smooth random signal (N,), at most so large, from rest."""
    parts = sum(rng.uniform(-1, 1) * np.sin(rng.uniform(0.1, 1.2) * t + rng.uniform(0, 6)) for _ in range(3))
    return most * np.asarray(parts) / 3 * np.minimum(t, 1.0)


def planned(seed: int, period: float, seconds: float = 8.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, poses and velocities of a planner that steps by Euler's rule, in reverse and on the spot, too."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds + 1e-9, period)
    v, w = waves(rng, t, 0.5), waves(rng, t, 0.8)
    poses = np.zeros((len(t), 3))
    for k in range(len(t) - 1):
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        poses[k + 1] = poses[k] + period * np.array([v[k] * c, v[k] * s, w[k]])
    return t, poses, np.column_stack((v, w))


def driven_by(time: np.ndarray, velocity: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Poses (N, 3) of a base that moves with velocities linear between samples, by scipy's DOP853."""
    holonomic = velocity.shape[1] == 3

    def rates(t: float, pose: np.ndarray) -> np.ndarray:
        u = [np.interp(t, time, column) for column in velocity.T]
        vx, vy, w = u if holonomic else (u[0], 0.0, u[1])
        c, s = np.cos(pose[2]), np.sin(pose[2])
        return np.array([vx * c - vy * s, vx * s + vy * c, w])

    found = solve_ivp(rates, (0, time[-1]), start, "DOP853", time, rtol=1e-9, atol=1e-10, max_step=0.02)
    return np.asarray(found.y.T)


@pytest.mark.parametrize("clock", ["time", "Time [s]", "timestamp"])
def test_a_planners_own_heads_are_read_as_ours(clock: str, tmp_path: Path) -> None:
    own, theirs = tmp_path / "own.csv", tmp_path / "theirs.csv"
    rows = "".join(f"{k / 10},{0.3 + 0.01 * k},{np.sin(k / 5)}\n" for k in range(30))
    theirs.write_text(f"{clock},vx,w\n" + rows)
    own.write_text("t,v,w\n" + rows)
    r, t = robot(), np.arange(0.0, 2.9, 0.1)
    same = Trajectory.from_csv(r, own).table(t, r.dimensions)
    np.testing.assert_array_equal(Trajectory.from_csv(r, theirs).table(t, r.dimensions), same)
    aside = Trajectory.from_csv(r := mecanum(), own)
    np.testing.assert_array_equal(drawn(aside, r, t).velocity[:, 1], 0.0)
    np.testing.assert_allclose(drawn(aside, r, t).pose, same[:, :3], atol=1e-12)


@given(st.integers(0, 10**6), st.sampled_from([0.02, 0.05, 0.1, 0.2]))
@settings(max_examples=12, deadline=None)
def test_what_a_planner_steps_is_driven_by_a_motion_that_rolls_close_to_it(seed: int, period: float) -> None:
    t, poses, velocity = planned(seed, period)
    for its in (None, velocity):
        made = table_of(t, poses, its, False)
        off = made.sample(t).pose - poses
        assert np.hypot(*off[:, :2].T).max() < 0.02 and abs(off[:, 2]).max() < 0.1
        if made.note:
            assert driven_by(made.time, made.velocity, made.pose[0]) == pytest.approx(made.pose, abs=2e-3)
            assert f"{1e3 * np.hypot(*off[:, :2].T).max():.2g} mm" in made.note
        for place in (0, -1):
            assert made.pose[place] == pytest.approx(poses[place], abs=0.02 if place else 1e-3)


@given(st.integers(0, 10**6))
@settings(max_examples=10, deadline=None)
def test_points_without_headings_are_driven_through_forwards(seed: int) -> None:
    rng, t = np.random.default_rng(seed), np.arange(0.0, 8.0, 0.1)
    velocity = np.column_stack((0.3 + abs(waves(rng, t, 0.3)), waves(rng, t, 0.5)))
    points = driven_by(t, velocity, np.zeros(3))[:, :2]
    made = table_of(t, points, None, False)
    assert "drives forwards through the points" in made.note
    assert np.hypot(*(made.sample(t).pose[:, :2] - points).T).max() < 0.02
    assert np.median(made.velocity[:, 0]) > 0.2


@pytest.mark.parametrize("columns", [2, 3])
def test_velocities_alone_are_integrated_from_the_origin(columns: int) -> None:
    rng, t = np.random.default_rng(columns), np.linspace(0.0, 6.0, 61)
    velocity = np.column_stack([waves(rng, t, 0.5) for _ in range(columns)])
    made = integrated(t, velocity)
    assert made.pose[0] == pytest.approx([0, 0, 0]) and "no poses are given" in made.note
    assert made.sample(t).pose == pytest.approx(driven_by(t, velocity, np.zeros(3)), abs=1e-4)


def test_slopes_of_rolling_are_finite_differences() -> None:
    rng, steps = np.random.default_rng(4), np.array([0.1, 0.3, 0.05])
    unknown = rng.normal(size=(4, 5))
    found = slopes(unknown, steps)

    def missed(at: np.ndarray) -> np.ndarray:
        return moved(at[:, :3], at[:, 3:], steps) - at[1:, :3]

    for k in range(3):
        for column in range(10):
            change = np.zeros((4, 5))
            change[k + column // 5, column % 5] = 1e-6
            assert (missed(unknown + change) - missed(unknown - change))[k] / 2e-6 == pytest.approx(
                found[k, :, column], abs=1e-7
            )


def test_points_without_times_are_driven_within_the_robots_limits(tmp_path: Path) -> None:
    s = np.linspace(0.0, 3.0, 60)
    file = csv_of(tmp_path / "way.csv", "x,y,phi", s, 0.3 * np.sin(s), np.arctan(0.3 * np.cos(s)))
    made = Trajectory.from_csv(robot(), file)
    rows = drawn(made, robot(), np.linspace(0.0, made.duration, 500))
    assert rows.pose[-1, :2] == pytest.approx([3.0, 0.3 * np.sin(3.0)], abs=0.01)
    assert abs(rows.velocity[:, 0]).max() <= 1.0 + 1e-6 and rows.velocity[-1] == pytest.approx([0, 0], abs=1e-3)


def test_a_run_of_a_planners_file_says_how_far_beside_it_drives(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    t = np.arange(0.0, 2.05, 0.1)
    heading = np.where(t > 0, 0.5 * (t - 0.1), 0.0)  # of a planner that turns a step too late
    way = np.array([np.cumsum(0.03 * turn(0.5 * t)) for turn in (np.cos, np.sin)]).T
    poses = np.column_stack((way - way[0], heading))
    file = csv_of(tmp_path / "plan.csv", "t,x,y,phi", t, *poses.T)
    out = ["--out", str(tmp_path / "runs")]
    given = ["--controller", "pd", "--set", f"reference.file={file}"]
    assert main(["run", "track", "--robot", "platform_arm", *given, *out]) == 0
    assert "driven is the nearest motion that rolls, at most" in " ".join("".join(capsys.readouterr()).split())
