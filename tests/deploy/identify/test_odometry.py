"""Wheels from odometry, and what a hand carries: the truth within the intervals that are told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from motions import rubbing, simulated
from scipy.integrate import solve_ivp

from mmnn_pin import identify, load
from mmnn_pin.cli import main
from mmnn_pin.deploy.identify.corrected import write
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.deploy.identify.odometry import has_reference, path, wheels_of
from mmnn_pin.deploy.identify.payload import payload
from mmnn_pin.errors import RecordingError, UnknownName
from mmnn_pin.model.robot import Robot, carrying
from mmnn_pin.model.tree.body import parameters
from mmnn_pin.plant.contact.plant import ContactPlant
from mmnn_pin.signals import Array

TRUE = np.array([0.103, 0.0985, 0.52])


@pytest.fixture(scope="module")
def base() -> Robot:
    return load("platform_arm")


def square_by_contact(robot: Robot, turn: int, side: float = 0.5, leg: float = 1.0, period: float = 0.002) -> Log:
    """A square of a base on MuJoCo's floor, to the left or right, leg by leg; 1 mm and 1 mrad of noise."""
    plant, seen, angles = ContactPlant(robot, period), [], []
    plant.start(robot.neutral_position(), np.zeros(robot.dimensions.dof))
    wheels = [next(w for w in robot.base.wheels if (w.y > 0) == left) for left in (True, False)]
    rates = [robot.full_velocity_names.index(w.joint) for w in wheels]
    places = [robot.position_names.index(w.joint) for w in wheels]
    for k in range(int(8 * leg / period)):
        part, s = divmod(k * period, leg)
        wish = np.array([side, 0.0] if part % 2 == 0 else [0.0, turn * np.pi / 2])
        wish = wish * 30 * (s / leg) ** 2 * (1 - s / leg) ** 2 / leg
        rims = np.array([w.sign * w.radius * plant.velocity[i] for w, i in zip(wheels, rates, strict=True)])
        nu = np.array([rims.mean(), (rims[1] - rims[0]) / robot.base.track])
        arm = -20 * plant.position[robot.arm_index] - 4 * plant.nu[2:]
        plant.step(np.concatenate((np.array([300.0, 30.0]) * (wish - nu), arm)))
        if k % 10 == 0:
            angles.append([w.sign * plant.position[i] for w, i in zip(wheels, places, strict=True)])
            seen.append(plant.position[:3].copy())
    pose = np.array(seen) + 1e-3 * np.random.default_rng(turn + 1).standard_normal((len(seen), 3))
    position = {w.joint: w.sign * np.array(angles)[:, i] for i, w in enumerate(wheels)}
    reference = dict(zip(("x", "y", "phi"), pose.T, strict=True))
    return Log.of(10 * period * np.arange(len(seen)), position, {}, reference=reference)


def test_squares_both_ways_on_the_contact_plant_tell_radii_and_track(base: Robot, tmp_path: Path) -> None:
    """UMBmark (Borenstein, Feng 1996): where the wheels touch is MuJoCo's to say, and the file has other wheels."""
    pytest.importorskip("mujoco")
    true, text = np.array([0.075, 0.075, 0.342]), base.urdf
    left, right = (text.index(f'<link name="wheel_{side}">') for side in ("left", "right"))
    parts = zip((text[:left], text[left:right], text[right:]), (0.075, 0.0765, 0.0738), strict=True)
    sized = (part.replace('radius="0.075"', f'radius="{radius}"') for part, radius in parts)
    (tmp_path / "file.urdf").write_text("".join(sized).replace("0.171 0", "0.178 0"))
    file = load(tmp_path / "file.urdf", base="differential_drive", wheels=[w.joint for w in base.base.wheels])
    assert file.base.track == pytest.approx(0.356) and len({w.radius for w in file.base.wheels}) == 2
    found = wheels_of(file, [square_by_contact(base, turn) for turn in (1, -1)])
    np.testing.assert_allclose(found.value, true, rtol=3e-3)
    assert (np.abs(found.value - true) < 3 * found.sd).all() and (found.sd < 2e-3 * true).all()


def drive(
    robot: Robot, numbers: Array, noise: float = 1e-3, seed: int = 0, marker: tuple[float, ...] = (0.2, -0.1, 0.4)
) -> Log:
    """Wheel angles of a drive with turns, and the marker's pose by integrating the rates (DOP853)."""
    t = np.linspace(0, 40, 1200)
    left, right = (lambda s: 3 + 2 * np.sin(0.5 * s)), (lambda s: 3 + 2 * np.cos(0.37 * s))

    def rates(s: float, y: Array) -> list[float]:
        v = (numbers[0] * left(s) + numbers[1] * right(s)) / 2
        return [
            v * np.cos(y[2]),
            v * np.sin(y[2]),
            (numbers[1] * right(s) - numbers[0] * left(s)) / numbers[2],
            left(s),
            right(s),
        ]

    made = solve_ivp(rates, (0, 40), [1.0, 2.0, 0.3, 0, 0], "DOP853", t, rtol=1e-10, atol=1e-10).y
    c, s = np.cos(made[2]), np.sin(made[2])
    pose = np.array(
        [made[0] + c * marker[0] - s * marker[1], made[1] + s * marker[0] + c * marker[1], made[2] + marker[2]]
    )
    pose += noise * np.random.default_rng(seed).standard_normal(pose.shape)
    pose[2] = (pose[2] + np.pi) % (2 * np.pi) - np.pi
    angles = {True: made[3], False: made[4]}
    position = {wheel.joint: wheel.sign * angles[wheel.y > 0] for wheel in robot.base.wheels}
    return Log.of(t, position, {}, reference=dict(zip(("x", "y", "phi"), pose, strict=True)))


def test_the_path_is_the_integral_of_the_rates(base: Robot) -> None:
    log = drive(base, TRUE, 0.0, marker=(0.0, 0.0, 0.0))
    left, right = (next(w for w in base.base.wheels if (w.y > 0) == side) for side in (True, False))
    angles = np.column_stack([w.sign * log.position[w.joint] for w in (left, right)])
    found = path(angles, TRUE, np.array([1.0, 2.0, 0.3]))
    np.testing.assert_allclose(found[:, 0], log.reference["reference.x"], atol=1e-4)
    np.testing.assert_allclose(found[:, 2], np.unwrap(log.reference["reference.phi"]), atol=1e-9)


def test_radii_and_track_are_found_whatever_the_marker(base: Robot) -> None:
    found = wheels_of(base, [drive(base, TRUE)])
    assert np.abs((found.value - TRUE) / found.sd).max() < 4
    assert (found.sd < [1e-4, 1e-4, 1e-3]).all()
    assert found.error[0] < 2e-3 < 0.05 < found.error[1]


@pytest.mark.long
def test_their_intervals_cover_the_truth(base: Robot) -> None:
    inside = [
        np.abs(one.value - TRUE) < 1.96 * one.sd
        for one in (wheels_of(base, [drive(base, TRUE, seed=i)]) for i in range(100))
    ]
    assert np.abs(np.mean(inside, axis=0) - 0.95).max() < 0.07  # of 100 draws


def test_a_drive_that_does_not_turn_is_refused(base: Robot) -> None:
    log = drive(base, TRUE)
    assert has_reference(log, base) and not has_reference(replace(log, reference={}), base)
    with pytest.raises(RecordingError, match="too small a drive for wheels"):
        wheels_of(base, [log.rows(slice(0, 40))])


def test_identify_writes_them_beside_the_urdf(base: Robot, tmp_path: Path) -> None:
    drove, moved = drive(base, TRUE), simulated(rubbing(base), 40.0, 0.01)
    n = len(drove.time)
    at = np.linspace(0, 40, n)
    effort = {name: np.interp(at, moved.time, values) for name, values in moved.effort.items()}
    joints = {name: np.interp(at, moved.time, moved.position[name]) for name in base.joint_names}
    log = replace(drove, position=drove.position | joints, effort=effort)
    found = replace(identify(base, moved), wheels=wheels_of(base, [log]))
    again = load(write(found, tmp_path)["urdf"])
    assert again.base.track == pytest.approx(TRUE[2], abs=2e-3)
    for wheel in again.base.wheels:
        assert wheel.radius == pytest.approx(TRUE[0 if wheel.y > 0 else 1], abs=1e-4)


# -- payload -----------------------------------------------------------------------------------------------------------


def test_a_load_is_found_within_its_interval() -> None:
    robot = rubbing(load("panda"), 0.5, 0.3)
    at = (0.02, -0.03, 0.12)
    log = simulated(carrying(robot, 1.2, "panda_joint7", at), 12.0, 0.01)
    found = payload(robot, log)
    assert abs(found.mass - 1.2) < 4 * found.mass_sd and found.mass_sd < 0.05
    assert (np.abs(found.centre - at) < 4 * found.centre_sd).all() and found.centre_sd.max() < 0.02
    assert found.error[1] < 0.2 * found.error[0]


def test_a_motion_without_the_load_tells_the_robots_errors_from_it() -> None:
    """The last link is 15 % heavier than its URDF: that looks like a load, and an interval says so."""
    urdf = load("two_axis_arm")
    true, at = rubbing(urdf.with_masses({"arm_1_joint": 0.9, "arm_2_joint": 1.15}), 0.2, 0.1), (0.1, 0.2, 0.0)
    with_load = simulated(carrying(true, 0.5, "arm_2_joint", at), 12.0, 0.01)
    alone = payload(urdf, with_load)
    both = payload(urdf, with_load, without=simulated(true, 12.0, 0.01, seed=3))
    for found in (alone, both):
        assert (np.abs(found.centre - at)[:2] < 3 * found.centre_sd[:2]).all() and np.isinf(found.centre_sd[2])
        assert abs(found.mass - 0.5) < 3 * found.mass_sd
    assert both.mass_sd < 0.1 * alone.mass_sd
    assert 0.02 < both.doubt < 0.4


@pytest.mark.parametrize("sure", [1e-6, 1e-3])
def test_who_believes_too_firmly_is_doubted(sure: float) -> None:
    """Parameters 1 % off, with standard deviations of less: they do not explain the motion, and count for less."""
    robot, rng = rubbing(load("two_axis_arm"), 0.2, 0.1), np.random.default_rng(4)
    theta = parameters(robot)
    log = simulated(carrying(robot, 0.8, "arm_2_joint", (0.0, 0.2, 0.0)), 12.0, 0.002)
    right = payload(robot, log, believed=(theta, np.diag((sure * theta) ** 2)))
    for _ in range(5):
        wrong = theta * (1 + 0.01 * rng.standard_normal(len(theta)))
        found = payload(robot, log, believed=(wrong, np.diag((sure * wrong) ** 2)))
        assert found.doubt > 0.002 and found.mass_sd > 2 * right.mass_sd
        assert abs(found.mass - 0.8) < 3 * found.mass_sd
        assert (np.abs(found.centre - (0.0, 0.2, 0.0)) < 3 * found.centre_sd).all()
    assert right.doubt < 0.002 and abs(right.mass - 0.8) < 3 * right.mass_sd


def test_the_command_tells_the_load(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = load("two_axis_arm").without_friction()
    log = simulated(carrying(robot, 0.8, "arm_2_joint", (0.0, 0.2, 0.0)), 12.0, 0.01)
    np.savetxt(
        tmp_path / "log.csv", np.column_stack([log.time, *log.signals.values()]), "%.9g", ",",
        header=",".join(["time", *log.signals]), comments="",
    )  # fmt: skip
    command = ["identify", str(tmp_path / "log.csv"), "--robot", "two_axis_arm", "--payload"]
    assert main([*command, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert abs(found["mass"] - 0.8) < 4 * found["mass_sd"] and found["link"] == "arm_2"
    assert main(command) == 0
    assert "arm_2 carries 0.8" in capsys.readouterr().out
    empty = simulated(robot, 12.0, 0.01, seed=2)
    rows = np.column_stack([empty.time, *empty.signals.values()])
    np.savetxt(tmp_path / "empty.csv", rows, "%.9g", ",", header=",".join(["time", *empty.signals]), comments="")
    more = ["--without-load", str(tmp_path / "empty.csv")]
    assert main([*command, *more, "--json"]) == 0
    better = json.loads(capsys.readouterr().out)
    assert abs(better["mass"] - 0.8) < 4 * better["mass_sd"] < 0.4 * found["mass_sd"]
    assert main([*command[:-1], *more]) == 2
    assert "it goes with --payload" in capsys.readouterr().err
    known = ["identify", str(tmp_path / "empty.csv"), "--robot", "two_axis_arm", "--out", str(tmp_path / "known")]
    assert main([*known, "--even-if-worse"]) == 0
    file = tmp_path / "known" / "two_axis_arm.urdf"
    assert main([*command[:2], "--robot", str(file), "--payload", "--json"]) == 0
    known_by = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert known_by["known_by"] == str(file.with_suffix(".identified.json"))
    assert abs(known_by["mass"] - 0.8) < 4 * known_by["mass_sd"] < 3 * found["mass_sd"]


def test_no_load_and_no_joint_are_refused() -> None:
    robot = rubbing(load("two_axis_arm"), 0.2, 0.1)
    with pytest.raises(UnknownName, match="unknown joint 'wrist'"):
        payload(robot, simulated(robot, 12.0, 0.01), "wrist")
    lighter = robot.with_masses({"arm_2_joint": 0.5})
    with pytest.raises(RecordingError, match="no load is seen"):
        payload(robot, simulated(lighter, 12.0, 0.001))
