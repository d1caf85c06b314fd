"""`mmnn run track` on any robot: profiles within limits, gains scaled by effective inertia, torques against limits."""

from __future__ import annotations

import json
import os
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import config
from robots import mobile_arm, tiny_arm

from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.references import Swing
from mmnn_pin.lab.experiments.runner import run_experiment
from mmnn_pin.lab.show import comparison as table
from mmnn_pin.loop.sampled import Machinery, SampledLoop, sampled_loop
from mmnn_pin.loop.suited import effective_inertia
from mmnn_pin.model.base.base import Fixed
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robots import robot_data
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.reference import Hold
from mmnn_pin.signals import Layout
from mmnn_pin.torque import law
from mmnn_pin.torque.controller import Context, Feedback
from mmnn_pin.torque.neural import Inputs, Neural, Robust
from mmnn_pin.torque.two_layer import TwoLayer

needs_data = pytest.mark.skipif(robot_data() is None, reason="example-robot-data is not installed")

DURATION = 0.02 if config.DISABLE_JIT else 1.5
CONTROLLERS = {"two_layer", "pd_gravity", "pid", "feedforward", "learned", "computed_torque"}
DATA = os.environ.get("EXAMPLE_ROBOT_DATA")


def experiment(*settings: str) -> Experiment:
    return load_experiment("track", (f"time.duration={DURATION}", *settings))


def test_swing_stays_within_limits_and_starts_at_rest():
    swing = Swing(amplitude=0.4, period=2.0, share=0.5)
    for lower, upper in ((-3.0, 1.0), (0.0, 0.35), (-np.inf, np.inf), (0.2, np.inf)):
        samples = swing.of(lower, upper).sample(np.linspace(0, 2, 50))
        assert samples.qdot[0] == pytest.approx(0.0, abs=1e-12)
        if np.isfinite(upper):
            assert samples.q.min() >= lower and samples.q.max() <= upper
        assert np.ptp(samples.q) == pytest.approx(2 * min(0.4, 0.25 * (upper - lower)), rel=1e-2)
    with pytest.raises(ConfigError, match="share 2"):
        Swing(0.4, 2.0, 2.0)


def test_one_table_for_every_joint():
    robot = tiny_arm()
    profiles = experiment().trajectory_of(robot).arm
    assert len(profiles) == 7
    middles = [profile.sample([1.5]).q[0] for profile in profiles]  # a quarter of the period later
    np.testing.assert_allclose(middles, 0.5)
    held = experiment("reference.arm={type='hold', value=0.3}").trajectory_of(robot).arm
    assert held == (Hold(0.3),) * 7


def test_effective_inertia_is_what_a_held_torque_accelerates():
    """Against the plant itself: a small torque on one velocity for one period, at rest."""
    robot = replace(tiny_arm(damping=0.01), coulomb=np.zeros(12))
    model = robot.model.copy()
    model.gravity.linear = np.zeros(3)
    robot = replace(robot, model=model)
    h, position = 0.001, robot.neutral_position()
    position[robot.arm_index] = 0.2
    found = effective_inertia(robot, [position], h)
    for i in range(robot.dimensions.dof) if not config.DISABLE_JIT else (8,):
        plant = IdealPlant(robot, h / 400)
        plant.start(position, np.zeros(robot.dimensions.dof))
        tau = np.zeros(robot.dimensions.dof)
        tau[i] = 1e-3 * found[i] / h
        for _ in range(400):
            plant.step(tau)
            plant.refresh()
        assert plant.nu[i] == pytest.approx(1e-3, rel=1e-3)


def test_without_friction_it_is_that_of_the_mass_matrix():
    robot = tiny_arm()
    position = robot.neutral_position()
    position[robot.arm_index] = 0.2
    inverse = np.linalg.inv(Dynamics(robot).mass_matrix(position))
    found = effective_inertia(robot, [position], 0.001)
    np.testing.assert_allclose(found, 1 / np.diag(inverse), rtol=1e-9)
    assert found[-1] < 1e-5 < 1 < found[0]


def test_scaled_gains_are_stable_where_plain_ones_are_not():
    robot = tiny_arm()
    scaled = experiment().controller("pd", robot=robot)
    loop = experiment().loop(robot, scaled)
    loop.require_stable_gains()
    plain = replace(loop, controller=replace(scaled, feedback=Feedback(500.0, 30.0)))  # type: ignore[type-var]
    with pytest.raises(ConfigError, match=r"joint_6: 30 \(limit alone"):
        plain.require_stable_gains()


@pytest.mark.parametrize("friction", [(0.0, 0.0), (0.5, 0.5)])
@pytest.mark.parametrize("name", ["two_layer", "pd"])
def test_tiny_last_joint_runs_at_1_khz(name, friction):
    e, robot = experiment(), tiny_arm(*friction)
    run = e.loop(robot, e.controller(name, robot=robot)).run()
    assert run.outcome.status == "completed"
    if name == "two_layer" and not config.DISABLE_JIT:
        without = e.loop(robot, e.controller("pd", robot=robot)).run()
        assert np.sqrt((run["e"][700:] ** 2).mean()) < 0.5 * np.sqrt((without["e"][700:] ** 2).mean())


def test_scaling_is_a_change_of_coordinates():
    """In coordinates where every velocity has inertia 1 the thesis's law, with plain gains, gives the same torque."""
    robot = mobile_arm(2)
    layout = Layout.of(robot.dimensions)
    m = np.array([2.0, 8.0, 0.5, 4.5])
    c = np.array([5.0, 5.0, 2.5, 2.5])
    context = Context(layout, 0.001, 10)
    network, inputs = TwoLayer(hidden=5, initial="random"), Inputs(scale=0.9)
    feedback, robust = Feedback(3.0, 4.0, "inertia").scaled(layout, m), Robust(1.0, 2.0).scaled(layout, m)
    given = Neural(network, feedback, robust, inputs, inertia=tuple(m))
    plain = Neural(network, Feedback(3.0, 4.0), Robust(1.0, 2.0), inputs)
    rng, s = np.random.default_rng(0), np.zeros(4)
    rows = [layout.new_row(), layout.new_row()]
    memories = [given.init(Context(layout, 0.001, 10)), plain.init(Context(layout, 0.001, 10))]
    numbers = [given.law(context), plain.law(context)]
    for _ in range(5):
        s = rng.standard_normal(4)
        for row, scale in zip(rows, (np.ones(4), np.sqrt(m / c)), strict=True):
            row[layout.where("pose_ref")] = 0.3
            row[layout.where("z")], row[layout.where("r")] = (scale * s)[:2], (scale * s)[2:]
        # The inputs of the networks are the same only if they do not see z and r: hide them.
        for row, state, number in zip(rows, memories, numbers, strict=True):
            view = getattr(law.numbers_of, "py_func", law.numbers_of)  # plain Python where numba is off
            scale_of_inputs = view(number.numbers.settings, number.numbers.sizes).inputs[0]
            scale_of_inputs[10:12] = scale_of_inputs[14:16] = 0.0
            law.step(row, layout.offsets, number.numbers, state.values, None, None)
        torque = rows[1][layout.where("torque")]
        np.testing.assert_allclose(rows[0][layout.where("torque")], np.sqrt(m * c) * torque, rtol=1e-12)
    for name in ("W1", "V1", "W2", "V2"):
        np.testing.assert_allclose(memories[0][name], memories[1][name], rtol=1e-12)
        assert np.abs(memories[0][name]).max() > 0


def test_bandwidths_are_not_taken_for_gains():
    layout = Layout.of(mobile_arm(2).dimensions)
    with pytest.raises(ConfigError, match=r"feedback.scaling: error: bandwidths"):
        Feedback(1.0, 1.0, "inertia").vector(layout)
    plain = Feedback(1.0, 1.0)
    assert plain.scaled(layout, np.full(4, 7.0)) is plain
    with pytest.raises(ConfigError, match="give 4 inertias > 0"):
        Neural(feedback=plain, inertia=(1.0, -1.0, 1.0, 1.0)).law(Context(layout, 0.001, 1))


def test_compiled_and_ordinary_loop_agree_on_implicit_friction():
    e, robot = load_experiment("track", ["time.duration=0.02"]), tiny_arm(0.5, 0.5)
    loop = e.loop(robot, e.controller("two_layer", robot=robot))
    runs = [replace(loop, engine=engine).run() for engine in ("compiled", "ordinary")]
    for name in ("position", "nu", "torque", "energy_residual"):
        np.testing.assert_allclose(runs[0][name], runs[1][name], rtol=1e-6, atol=1e-9)


def test_sampled_loop_knows_the_friction_of_joints():
    """A scalar loop with friction, by hand: Phi = exp(-d h / m), Gamma = (1 - Phi) / d."""
    m, d, h, still = 4e-6, 1.0, 1e-3, Fixed.linear_errors(np.zeros(0), np.zeros(0))

    def verdict(gain: float) -> SampledLoop:
        return sampled_loop(np.array([[m]]), np.array([gain]), still, np.zeros(1), h, Machinery(np.array([[d]])))

    limit, phi = verdict(0.1).gain_limits[0], np.exp(-d * h / m)
    assert limit == pytest.approx((1 + phi) / ((1 - phi) / d))
    assert verdict(0.9 * limit).stable and not verdict(1.1 * limit).stable


def run_track(capsys, folder: Path, *arguments: str) -> dict:
    code = main(["run", "track", "--json", "--out", str(folder), "--set", f"time.duration={DURATION}", *arguments])
    found = json.loads(capsys.readouterr().out)
    assert code == 0, found
    return found


def require_torques(found: dict, motors: int) -> None:
    limits = found["comparison"]["torque_limits"]
    assert len(limits) == motors
    for row in limits:
        assert set(row["peak"]) == CONTROLLERS
        assert row["limit"] is None or max(row["peak"].values()) <= row["limit"] * (1 + 1e-12), row


def test_track_runs_by_default_on_platform_arm(capsys, tmp_path):
    found = run_track(capsys, tmp_path / "runs")
    assert found["robot"] == "platform_arm" and set(found["runs"]) == CONTROLLERS
    require_torques(found, 4)
    code = main(["run", "track", "--out", str(tmp_path / "more"), "--set", "time.duration=0.02", "--details"])
    out = capsys.readouterr().out
    assert code == 0 and "peak torque arm_1_joint" in out and "of 200" in out


def test_a_torque_above_its_limit_is_marked():
    few = 'controllers=["two_layer", "pd", "pd_effective", "computed_torque"]'
    result = run_experiment(experiment("time.duration=0.02", "torque_limits=false", few), "track")
    assert "effort limit" not in table.render(result) and "peak torque" not in table.render(result)
    for recording in result.recordings.values():
        recording.meta["effort_limits"] = [1e-9, float("inf"), 200.0, 200.0]
    text = table.render(result)
    assert " !" in text and "above the motor's effort limit" in text.replace("\n", " ")
    assert "peak torque wheel_left_joint" in text and text.count("peak torque") == 1
    assert [row["limit"] for row in result.torque_limits()] == [1e-9, None, 200.0, 200.0]


@pytest.mark.skipif(DATA is None, reason="EXAMPLE_ROBOT_DATA is not set")
def test_track_runs_on_tiago(capsys, tmp_path):
    file = next(Path(str(DATA)).rglob("tiago_no_hand.urdf"))
    found = run_track(capsys, tmp_path / "runs", "--robot", str(file))
    assert all(run["outcome"] == "completed" for run in found["runs"].values())
    require_torques(found, len(found["comparison"]["torque_limits"]))
    if not config.DISABLE_JIT:
        error = {name: run["metrics"]["e.arm_7_joint.peak"] for name, run in found["runs"].items()}
        assert error["computed_torque"] < error["two_layer"] < 0.5 * min(error["pd"], error["pd_effective"])


@pytest.mark.parametrize("more", [[], ['feedback.scaling="inertia"']])
@pytest.mark.parametrize("robot", ["platform_arm", pytest.param("tiago", marks=needs_data)])
def test_gains_that_are_too_high_are_told_settings_that_hold(robot: str, more: list[str]) -> None:
    """The settings that the line says, read by a shell."""
    keys = [
        f'robot="{robot}"',
        'controllers=["pd"]',
        "time.control_period=0.01",
        "feedback.base=3000",
        "feedback.arm=800",
    ]
    with pytest.raises(ConfigError, match="the sampled PD loop is unstable") as refused:
        run_experiment(load_experiment("track", keys + more), "track")
    words = shlex.split(refused.value.fix.partition("lower them, ")[2].partition(", or leave them out")[0])
    assert words[::2] == ["--set"] * (2 + len(more))
    found = load_experiment("track", keys + more + words[1::2])
    found.loop(found.load_robot(), "pd").require_stable_gains()
