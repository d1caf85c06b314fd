"""Motions that excite: within their limits, as informative as they say, and better than an eight with sines."""

from __future__ import annotations

import json
import re
import shlex
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yourdfpy
from closed_form import inertial, joint
from robots import dynamics, place, robot_of

from benchmarks.identification import eight_with_sines
from mmnn_pin import Feedback, Measurement, Setpoint, Stepper, StepperSettings, Trajectory, load, load_experiment
from mmnn_pin.cli import main
from mmnn_pin.deploy.identify.clearance import Obstacle, clearances, to_obstacles
from mmnn_pin.deploy.identify.excitation import (
    NOISE,
    RATE,
    ExcitationLimits,
    ExcitationSearch,
    ExcitingMotion,
    excite,
)
from mmnn_pin.errors import ConfigError
from mmnn_pin.model.regressor import Regressor
from mmnn_pin.model.robot import Robot, speed_limits
from mmnn_pin.model.robots import robot_data
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.recording.recording import Recording
from mmnn_pin.reference import BaseTable
from mmnn_pin.signals import Array
from mmnn_pin.torque.model_based import PD

needs_data = pytest.mark.skipif(robot_data() is None, reason="example-robot-data is not installed")
LIMITS = ExcitationLimits(duration=20.0, space=0.6, seconds=1.0)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load("platform_arm")


@pytest.fixture(scope="module")
def found(robot: Robot) -> ExcitingMotion:
    return excite(robot, LIMITS)


def test_it_keeps_all_limits(found: ExcitingMotion, robot: Robot) -> None:
    low, high = robot.lower[robot.arm_index], robot.upper[robot.arm_index]
    assert (found.position >= low - 1e-9).all() and (found.position <= high + 1e-9).all()
    of_motor = dict(zip(robot.actuator_names, speed_limits(robot), strict=True))
    fastest = np.abs(found.nu[:, robot.dimensions.base :]).max(axis=0)
    assert (fastest <= [0.8 * min(of_motor[name], 1e3) for name in robot.joint_names]).all()
    assert np.abs(found.pose[:, :2]).max() <= 0.6 * 1.01
    tau = Regressor.of(robot).along(found.position, found.nu, found.nudot)
    forces = np.abs(tau @ parameters(robot))
    limit = np.abs(robot.E) @ robot.effort_limits
    assert (forces.max(axis=0) <= 0.801 * np.where(np.isfinite(limit), limit, np.inf)).all()


def test_it_is_one_smooth_motion_from_rest_to_rest(found: ExcitingMotion) -> None:
    np.testing.assert_allclose(np.diff(found.time), 1 / RATE, rtol=0.02)
    rate = np.gradient(found.position, found.time, axis=0)
    nb = found.robot.dimensions.base
    np.testing.assert_allclose(rate[2:-2], found.nu[2:-2, nb:], atol=2e-3)
    np.testing.assert_allclose(np.gradient(found.nu, found.time, axis=0)[2:-2], found.nudot[2:-2], atol=0.02)
    for end in (0, -1):
        assert np.abs(found.nu[end]).max() < 1e-6 and np.abs(found.nudot[end]).max() < 1e-6


def test_the_predicted_deviations_are_those_of_least_squares(found: ExcitingMotion) -> None:
    """Of white noise on every row, over random draws, for the regressor that the fit would use."""
    search = ExcitationSearch.of(found.robot, LIMITS)
    Y = search.unknowns.matrix(found.position[::5], found.nu[::5], found.nudot[::5])[:, :, found.base.independent]
    X = (Y / search.noise[:, None]).reshape(-1, Y.shape[2])
    size = np.linalg.norm(X, axis=0)
    noise = np.random.default_rng(0).standard_normal((len(X), 400)) / np.sqrt(5)
    scatter = (np.linalg.lstsq(X / size, noise, rcond=None)[0] / size[:, None]).std(axis=1)
    np.testing.assert_allclose(found.sd, scatter, rtol=0.2)
    limits = np.abs(found.robot.E) @ found.robot.effort_limits
    np.testing.assert_allclose(search.noise[np.isfinite(limits)], NOISE * limits[np.isfinite(limits)])


def test_it_tells_more_than_an_eight_with_sines(found: ExcitingMotion, robot: Robot) -> None:
    """In what the eight determines, scaled alike; the wheels that it never turns back leave it the rest."""
    eight = eight_with_sines(ExcitationSearch.of(robot, LIMITS), found.time[-1])
    there = np.isfinite(eight.sd)
    assert there.sum() >= 10 and np.isfinite(found.sd).all()
    assert found.relative[there].max() < 0.5 * eight.relative[there].max()
    np.testing.assert_array_equal(eight.scale, found.scale)


def test_wheels_without_a_limit_leave_the_arm_its_own(robot: Robot) -> None:
    free = replace(robot, effort_limits=np.where(np.arange(len(robot.effort_limits)) < 2, np.inf, robot.effort_limits))
    with warnings.catch_warnings(action="error"):
        search = ExcitationSearch.of(free, LIMITS)
    assert np.isinf(search.torque[:2]).all()
    assert search.torque[2:].tolist() == ExcitationSearch.of(robot, LIMITS).torque[2:].tolist()


def test_spheres_are_as_far_apart_as_the_joints_that_they_stand_on() -> None:
    robot = load("ur10")
    apart = clearances(robot, 0.05)
    rest = robot.rest[robot.arm_index]
    assert apart(rest) > 1.0
    folded = rest.copy()
    folded[2] = np.pi  # the forearm lies on the upper arm
    assert apart(folded) < 1.0


AROUND = (Obstacle(1.3, 0.2, 0.2), Obstacle(-0.2, -1.3, 0.2, 0.3))  # a pillar, and a low one


@pytest.fixture(scope="module")
def by_points(robot: Robot) -> Callable[[Array, Array], list[float]]:
    """Distances to obstacles in closed form, of points on the meshes that yourdfpy places."""
    urdf = yourdfpy.URDF.load(str(robot.path), build_collision_scene_graph=True, load_collision_meshes=True)

    def distances(q: Array, pose: Array) -> list[float]:
        urdf.update_cfg(dict(zip(robot.joint_names, q, strict=True)))
        points = trimesh.sample.sample_surface(urdf.collision_scene.to_geometry(), 5000, seed=0)[0]
        c, s, (x, y, z) = np.cos(pose[2]), np.sin(pose[2]), points.T
        x, y = pose[0] + c * x - s * y, pose[1] + s * x + c * y
        gaps = (np.hypot(x - one.x, y - one.y) - one.radius for one in AROUND)
        above = (np.maximum(z - one.height, 0.0) for one in AROUND)
        return [float(np.hypot(np.maximum(a, 0.0), b).min()) for a, b in zip(gaps, above, strict=True)]

    return distances


def test_obstacles_are_as_far_as_points_on_the_shapes(
    robot: Robot, by_points: Callable[[Array, Array], list[float]]
) -> None:
    rng, ours = np.random.default_rng(0), to_obstacles(robot, AROUND, 0.06)
    for _ in range(20):
        q, pose = rng.uniform(-np.pi, np.pi, 2), rng.uniform(-0.5, 0.5, 3)
        np.testing.assert_allclose(np.maximum(ours(q, pose), 0.0), by_points(q, pose), atol=0.02)
    bare = replace(robot, urdf=re.sub(r"(?s)<(collision|visual)>.*?</\1>", "", robot.urdf))
    by_spheres = to_obstacles(bare, AROUND, 0.06)(np.zeros(2), np.zeros(3))
    np.testing.assert_allclose(by_spheres, ours(np.zeros(2), np.zeros(3)), atol=0.3)


def test_a_whole_robot_keeps_away_from_obstacles(
    robot: Robot, by_points: Callable[[Array, Array], list[float]]
) -> None:
    found = excite(robot, replace(LIMITS, duration=10.0, seconds=0.0, obstacles=AROUND))
    away = [min(by_points(found.position[i], found.pose[i])) for i in range(0, len(found.time), 10)]
    assert 0.05 < found.nearest < min(away) + 1e-3
    assert np.abs(found.pose[:, :2]).max() <= LIMITS.space * 1.01 and np.ptp(found.pose, axis=0).max() > 0.05
    assert np.isfinite(found.sd).all() and found.to_dict()["nearest_obstacle"] == found.nearest


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("0.8,0", "write X,Y,RADIUS or X,Y,RADIUS,HEIGHT"),
        ("a,b,c", "is no obstacle"),
        ("1,0,-1", "radius and height > 0"),
        ("1,nan,1", "radius and height > 0"),
        ("0.2,0,0.1", "it stands nearer than 0.06 m .* move the obstacle away"),
    ],
)
def test_obstacles_that_cannot_be_are_one_line(given: str, told: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["excite", "platform_arm", "--obstacle", given]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("--obstacle: error: ") and re.search(told, line)


def test_the_table_is_a_reference_of_the_base(found: ExcitingMotion, tmp_path: Path) -> None:
    table = BaseTable.read(found.save(tmp_path / "motion.csv"))
    np.testing.assert_allclose(table.pose, found.pose, atol=1e-8)


def test_the_table_is_played_by_the_loop_and_by_the_stepper(
    found: ExcitingMotion, robot: Robot, tmp_path: Path
) -> None:
    """`--set reference.file=...` and `Trajectory.from_csv`: base and arm are asked for what the table says."""
    file = found.save(tmp_path / "motion.csv")
    short = [f"reference.file='{file}'", "reference.share=0.0", "time.duration=0.5", "controllers=['pd']"]
    experiment = load_experiment("track", [*short, "windows=[[0.0, 0.5]]"])
    gains = PD(Feedback(base=500.0, arm=30.0))
    run = replace(experiment.loop(robot, gains), engine="ordinary").run()
    nb, early = robot.dimensions.base, found.time < 0.45
    for signal, wanted in (("q_ref", found.position), ("qdot_ref", found.nu[:, nb:]), ("pose_ref", found.pose)):
        asked = np.array([np.interp(found.time[early], run.time, column) for column in run[signal].T]).T
        np.testing.assert_allclose(asked, wanted[early], atol=1e-3 if signal == "qdot_ref" else 1e-5)
    assert run.outcome.status == "completed" and np.abs(run["true_e"]).max() < 0.2
    stepper = Stepper(robot, PD(Feedback(base=100.0, arm=3.0)), StepperSettings(period=0.01))
    wish = stepper.plan(Trajectory.from_csv(robot, file), float(found.time[-1]))
    measured = Measurement(found.pose[0], np.zeros(nb), found.position[0], np.zeros(found.position.shape[1]))
    for i in range(40):
        command = stepper.step(0.01 * i, measured, wish if i == 0 else None)
        now = Setpoint.side_by_side(stepper.follower.now, robot.dimensions)
        for asked, wanted in ((now.q, found.position), (now.pose, found.pose)):
            at = [np.interp(0.01 * i, found.time, column) for column in wanted.T]
            np.testing.assert_allclose(asked, at, atol=1e-4)
    assert np.isfinite(command.effort).all()


def test_the_command_writes_and_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "m.csv"
    command = ["excite", "two_axis_arm", "--out", str(out), "--seconds", "0.2", "--duration", "10"]
    assert main([*command, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert out.read_text().startswith("t,position.arm_1_joint") and report["base_parameters"]
    assert main([*command, "--force"]) == 0
    assert "predicted within 10 %" in capsys.readouterr().out
    assert main(command) == 2
    assert main([*command, "--force", "--share", "1.5"]) == 2
    assert "give a share up to 1" in capsys.readouterr().err


def test_the_printed_command_drives_the_motion_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not slowed into the share of the limits that `track` keeps, and to its end."""
    monkeypatch.chdir(tmp_path)
    words = ["--seconds", "0.2", "--duration", "8", "--lock", "arm_2_joint=0.1", "--share", "1.0"]
    assert main(["excite", "two_axis_arm", "--out", "a motion.csv", *words]) == 0
    *_, command = capsys.readouterr().out.splitlines()
    assert main([*shlex.split(command)[1:], "--out", "driven"]) == 0
    run, table = (
        Recording.open(next(Path("driven").glob("*.h5"))),
        np.genfromtxt("a motion.csv", delimiter=",", names=True),
    )
    assert run.time[-1] == pytest.approx(table["t"][-1], abs=0.01) and run["q_ref"].ndim == 1
    asked = np.interp(table["t"], run.time, run["q_ref"])
    np.testing.assert_allclose(asked, table["positionarm_1_joint"], atol=2e-3)


@pytest.mark.compiled
@pytest.mark.parametrize("robot", ["two_axis_arm", pytest.param("so100", marks=needs_data)])
def test_the_printed_command_follows_the_motion(
    robot: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A light arm asks for more than the feedback that suits it gives: PID misses most of it."""
    monkeypatch.chdir(tmp_path)
    assert main(["excite", robot, "--out", "motion.csv", "--seconds", "2", "--duration", "10"]) == 0
    *_, command = capsys.readouterr().out.splitlines()
    words = [*shlex.split(command)[1:], "--set", "plots=[]", "--out"]
    learner = words[words.index("--controller") + 1]
    assert main([*words, "good"]) == 0
    assert main([*(word if word != learner else "pid" for word in words), "weak"]) == 0
    ours, theirs = (
        np.sqrt(
            np.mean([error.rms**2 for error in Recording.open(next(Path(folder).glob("*.h5"))).errors(2.0).values()])
        )
        for folder in ("good", "weak")
    )
    assert ours < 0.02 and ours < 0.1 * theirs


def hanging_arm(right: float = np.pi / 2, effort: float = 200.0, range_of_last: float = 3.0) -> str:
    """A fixed arm of three joints; the last two turn alike, but for what `right` misses a right angle by."""
    text = '<robot name="hanging"><link name="base"/>'
    for i, turn in enumerate((0.0, right, -2 * right)):
        high = 3.0 if i < 2 else range_of_last
        limit = f'<limit lower="{-high}" upper="{high}" effort="{effort}" velocity="2"/>' + dynamics(0.1, 0.2)
        at = place((0.0, 0.3, 0.0) if i == 2 else (0.0, 0.0, 0.2), (turn, 0.0, 0.0))
        text += f'<link name="link_{i}">{inertial(3.0, (0.03, 0.01, 0.03), place((0.02, 0.15, 0.05)))}</link>'
        parent = "base" if i == 0 else f"link_{i - 1}"
        text += joint(f"joint_{i}", parent, f"link_{i}", at, "0 0 1", limit, "revolute")
    return text + "</robot>"


@pytest.mark.parametrize("right", [1.57, 1.5708, 1.570796])
def test_axes_that_a_file_makes_parallel_but_for_rounding_are_parallel(right: float) -> None:
    """What tells them apart is no base parameter: no motion would show it, and none was found."""
    exact, rounded = (robot_of(hanging_arm(angle)) for angle in (np.pi / 2, right))
    found = excite(rounded, LIMITS)
    assert np.isfinite(found.sd).all() and found.condition < 1e3
    assert len(found.sd) == len(ExcitationSearch.of(exact, LIMITS).base.independent)
    Y = Regressor.of(rounded).along(found.position, found.nu, found.nudot)
    torque, theta = Y @ parameters(rounded), parameters(rounded)
    search = ExcitationSearch.of(rounded, LIMITS)
    whole = search.unknowns.matrix(found.position, found.nu, found.nudot)
    folded = whole[:, :, found.base.independent] @ (found.base.combination[:, : len(theta)] @ theta)
    assert np.abs(folded - torque).max() < 2e-3 * np.abs(torque).max()


def test_an_arm_that_its_motors_cannot_stretch_out_moves_where_they_hold_it_up() -> None:
    weak = robot_of(hanging_arm(effort=9.0))
    assert np.abs(weak.gravity([0.0, np.pi / 2, np.pi])).max() > 1.5 * 9.0
    found = excite(weak, LIMITS)
    forces = Regressor.of(weak).along(found.position, found.nu, found.nudot) @ parameters(weak)
    assert np.abs(forces).max() <= 0.8 * 9.0 + 1e-9


def test_a_parameter_that_no_motion_shows_beyond_the_noise_refuses_none() -> None:
    """Without its hand TIAGo's last rotor moves so little that it is lost in the noise; all others are to be found."""
    found = excite(load("tiago_no_hand"), replace(LIMITS, seconds=0.0))
    assert np.isfinite(found.sd).all() and found.relative.max() > 10 and (found.relative < 0.1).sum() > 20


@pytest.mark.parametrize(
    ("text", "limits", "key", "told"),
    [
        (hanging_arm(effort=0.5), LIMITS, "--share", r"400 of 400 .* the arm's weight alone .* at joint_1"),
        (hanging_arm(range_of_last=1e-4), LIMITS, "--lock", "joint_2 cannot move: --lock joint_2"),
        (hanging_arm(), replace(LIMITS, share=1e-3, duration=5.0), "--share", "the arm's weight alone"),
    ],
)
def test_what_refuses_most_candidates_is_told_with_what_to_change(
    text: str, limits: ExcitationLimits, key: str, told: str
) -> None:
    with pytest.raises(ConfigError, match=f"no motion found: .*{told}") as error:
        excite(robot_of(text), limits)
    assert error.value.key == key


def test_a_base_without_room_is_told(robot: Robot) -> None:
    with pytest.raises(ConfigError, match="the base has no room"):
        excite(robot, replace(LIMITS, space=0.0))


def test_links_that_come_too_close_are_told_with_a_clearance_that_works() -> None:
    robot, wide = load("ur5"), replace(LIMITS, clearance=0.4)
    with pytest.raises(ConfigError, match=r"links that are no neighbours come closer than 0\.8 m") as error:
        excite(robot, wide)
    assert error.value.key == "--clearance"
    advised = float(error.value.fix.split(": ")[1].split()[0])
    assert np.isfinite(excite(robot, replace(wide, clearance=advised)).sd).all()
