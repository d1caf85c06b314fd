"""Wheels whose true radii are other than told: how they roll and push, and what is measured by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import ARM, robot_of
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import fixed_arm
from test_skid_steer import rover

from mmnn_pin import PD, Feedback, Line, Loop, Sine, Timing, Trajectory, load
from mmnn_pin.cli import main
from mmnn_pin.disturbance import Payload
from mmnn_pin.errors import ConfigError, UnknownName
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.sensing import Sensor

ROBOT = load("platform_arm")
LEFT, RIGHT = (wheel.joint for wheel in ROBOT.base.wheels)
PATH = Trajectory(Line(0.3), (Sine(0.5, 2.0), Sine(0.3, 3.0)))
FEW = 3 if config.DISABLE_JIT else 25
STEP = 0.001
factors = st.floats(0.8, 1.25)
speeds = st.floats(-1.0, 1.0)


def loop_with(radii, duration=0.1, **changes):
    timing = Timing(duration=duration, control_period=0.002, plant_step=STEP, integrator="rk4")
    return replace(Loop(ROBOT, PATH, PD(Feedback(300.0, 10.0)), timing=timing, radii=radii), **changes)


def by_hand(left, right):
    """Base velocity (v, w) that told radii make of the true rates of the wheels."""
    wheel = ROBOT.base.wheels[0]
    r, b = wheel.radius, ROBOT.base.track / 2
    return np.array([r * (left + right) / 2, r * (right - left) / (2 * b)])


@settings(max_examples=FEW, deadline=None)
@given(factors, factors, speeds, speeds)
def test_wheels_roll_on_their_true_radii_and_push_by_them(left, right, v, w):
    """`theta_dot = (v -+ w b) / r`; a torque u pushes the floor by u / r."""
    true, told = ROBOT.with_radii({LEFT: left, RIGHT: right}), ROBOT.base.wheels[0].radius
    r, b = np.array([left, right]) * told, ROBOT.base.track / 2
    names, nu, u = list(true.full_velocity_names), np.array([v, w, 0.0, 0.0]), np.array([3.0, -2.0, 0.0, 0.0])
    rates = (true.T @ nu)[[names.index(LEFT), names.index(RIGHT)]]
    assert rates == pytest.approx([(v - w * b) / r[0], (v + w * b) / r[1]])
    push = u[:2] / r
    assert true.E @ u == pytest.approx([push.sum(), b * (push[1] - push[0]), 0.0, 0.0])
    assert np.abs(true.A @ true.T).max() < 1e-12
    assert [wheel.radius for wheel in true.base.wheels] == pytest.approx(r)


@pytest.mark.parametrize("factor", [0.9, 1.03])
def test_one_factor_is_the_robot_loaded_with_that_radius(factor):
    theirs = load("platform_arm", radius=factor * ROBOT.base.wheels[0].radius)
    ours, q, nu = ROBOT.with_radii(factor), ROBOT.random(3), np.array([0.4, -0.7, 0.3, 0.2])
    for name in ("T", "A", "E"):
        assert getattr(ours, name) == pytest.approx(getattr(theirs, name), abs=1e-12)
    for equation in (lambda robot: robot.mass_matrix(q), lambda robot: robot.psi(q, nu, nu, nu)):
        assert equation(ours) == pytest.approx(equation(theirs), abs=1e-12)
        assert np.abs(equation(ours) - equation(ROBOT)).max() > 1e-4


@settings(max_examples=FEW, deadline=None)
@given(factors, factors)
def test_what_wheels_measure_is_wrong_by_the_radii_and_what_a_tracker_measures_is_not(left, right):
    radii = {LEFT: left, RIGHT: right}
    run = loop_with(radii, sensor=Sensor(velocity="difference", pose="odometry")).run()
    names = list(ROBOT.position_names)
    turned = run["position"][:, [names.index(LEFT), names.index(RIGHT)]]
    rates = np.diff(turned, axis=0) / 0.002
    assert run["velocity"][1:] == pytest.approx(np.array([by_hand(*rate) for rate in rates]), abs=1e-9)
    true = (run["nu"][1:, :2] + run["nu"][:-1, :2]) / 2  # what the rates are of true wheels, within the step
    wheel, b = ROBOT.base.wheels[0].radius, ROBOT.base.track / 2
    ours = np.array([by_hand((v - w * b) / (left * wheel), (v + w * b) / (right * wheel)) for v, w in true])
    assert run["velocity"][5:] == pytest.approx(ours[4:], abs=2e-3)
    pose = np.zeros(3)
    for a, c in (by_hand(*step) for step in np.diff(turned, axis=0)):
        heading = pose[2] + c / 2
        pose += [a * np.cos(heading), a * np.sin(heading), c]
    assert run["pose"][-1] == pytest.approx(pose + run["position"][0, :3], abs=1e-9)
    tracked = loop_with(radii).run()
    assert (tracked["velocity"] == tracked["nu"][:, :2]).all()
    assert (tracked["pose"] == tracked["position"][:, :3]).all()


@settings(max_examples=FEW, deadline=None)
@given(factors, factors)
def test_the_true_robot_moves_by_what_the_motors_give(left, right):
    """Every command is a torque of motors by the told radii; the plant alone, driven by these, moves as the loop."""
    radii = {LEFT: left, RIGHT: right}
    run, true = loop_with(radii).run(), ROBOT.with_radii(radii)
    motors = run["torque"] @ np.linalg.inv(ROBOT.E).T
    assert run["applied"] == pytest.approx(motors, abs=1e-9)
    plant = IdealPlant(true, STEP, "rk4")
    plant.start(run["position"][0].copy(), run["nu"][0].copy())
    turned = np.array([run["position"][:, true.position_names.index(name)] for name in true.actuator_names]).T
    for u in motors[:-1]:
        for _ in range(2):
            plant.step(true.E @ u)
            plant.refresh()
    assert plant.position == pytest.approx(run["position"][-1], abs=1e-9)
    work = np.concatenate(([0.0], np.cumsum((motors[:-1] * np.diff(turned, axis=0)).sum(axis=1))))
    assert np.ptp(work) > 1e-3 and np.abs(run["energy_residual"]).max() < 0.05 * np.ptp(work)


def test_radii_as_told_change_no_bit_and_engines_agree_where_they_are_not():
    plain, told = loop_with(1.0), loop_with({LEFT: 1.0})
    assert "radii" not in plain.run().meta
    assert np.abs(plain.run()["nu"] - told.run()["nu"]).max() < 1e-12
    loop = loop_with({RIGHT: 1.05}, disturbances=(Payload(mass=2.0, start=0.02, end=0.06),))
    runs = [replace(loop, engine=name).run() for name in ("compiled", "ordinary")]
    assert runs[0].meta["radii"] == {RIGHT: 1.05}
    for name in ("position", "nu", "velocity", "psi", "energy_residual"):
        assert (runs[0][name] == runs[1][name]).all()
    rates, nu = np.diff(runs[0]["position"], axis=0) / 0.002, (runs[0]["nu"][1:] + runs[0]["nu"][:-1]) / 2
    assert rates[5:, 3:] == pytest.approx((nu @ loop.true.T.T)[5:, 3:], abs=0.02)  # with the payload, too
    assert np.abs(runs[0]["nu"] - plain.run()["nu"]).max() > 1e-4


def test_by_odometry_a_line_is_too_long_by_the_factor():
    run = loop_with(1.03, 1.0, sensor=Sensor(velocity="difference", pose="odometry")).run()
    driven = run["position"][-1, 0] - run["position"][0, 0]
    assert driven == pytest.approx(1.03 * (run["pose"][-1, 0] - run["pose"][0, 0]), rel=1e-5)


@pytest.mark.parametrize(
    ("robot", "radii", "error", "said"),
    [
        (ROBOT, {"wheel": 1.03}, UnknownName, "drive wheel"),
        (ROBOT, 0.0, ConfigError, "factor"),
        (ROBOT, {LEFT: np.nan}, ConfigError, "factor"),
        (fixed_arm(), 1.03, ConfigError, "no drive wheels"),
        (robot_of(rover(more=ARM), base="skid_steer", track=0.9), {"l0": 1.1}, ConfigError, "turn alike"),
    ],
)
def test_radii_that_cannot_be_are_refused_at_their_key(robot, radii, error, said):
    with pytest.raises(error, match=said) as caught:
        robot.with_radii(radii)
    assert caught.value.key == "radii" and caught.value.fix


def test_a_skid_steer_side_may_have_another_radius():
    robot = robot_of(rover(more=ARM), base="skid_steer", track=0.9)
    true, nu = robot.with_radii({"l0": 1.1, "l1": 1.1}), np.array([0.6, 0.2, *np.zeros(robot.dimensions.arm)])
    ratio = dict(zip(robot.full_velocity_names, (true.T @ nu) / np.where(robot.T @ nu, robot.T @ nu, 1.0), strict=True))
    assert [ratio[name] for name in ("l0", "l1", "r0", "r1")] == pytest.approx([1 / 1.1, 1 / 1.1, 1.0, 1.0])


def test_the_command_line_refuses_them_in_a_line_and_writes_nothing(tmp_path, capsys):
    arguments = ["run", "track", "--controller", "pd", "--out", str(tmp_path / "out"), "--set"]
    assert main([*arguments, "radii={wheel=1.03}"]) == 2
    assert "--set radii" in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.parametrize("factors", ["x", None, [1, 1], np.ones(2), True, {"wheel_left_joint": None}])
def test_a_factor_that_is_no_number_is_refused_in_python(factors: object) -> None:
    with pytest.raises(ConfigError, match=r"give a number from 1e-06 to 1e\+06"):
        load("platform_arm").with_radii(factors)  # type: ignore[arg-type]
