"""The compiled loop against the ordinary one with Pinocchio in it: every controller, period, integrator and robot."""

from __future__ import annotations

import os
import signal
import sysconfig
import threading
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import feedback, fixed_arm, mobile_arm, robot_of, with_joint_friction

from mmnn_pin import (
    PD,
    Circle,
    Feedback,
    Loop,
    Neural,
    Recording,
    Robot,
    Sine,
    Timing,
    TorqueController,
    Trajectory,
    load,
)
from mmnn_pin.errors import ConfigError, RobotError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.loop.before_run import Bounds, Start
from mmnn_pin.loop.sample import Unflattened
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.tree import body
from mmnn_pin.torque.model_based import ComputedTorque, ScheduledPD
from mmnn_pin.torque.neural import Robust
from mmnn_pin.torque.one_layer import OneLayer
from mmnn_pin.torque.two_layer import TwoLayer

SAME = 1e-9
LONG = 0.04 if config.DISABLE_JIT else 5.0  # [s]
SHORT = 0.04 if config.DISABLE_JIT else 0.4  # [s]
ROBOT = robot_of(with_joint_friction(load("platform_arm").urdf, 0.3, 0.2)).with_friction([20.0, 3.0, 0.2, 0.1])
HEAVY = ROBOT.with_masses({"root": 1.2, "arm_1_joint": 0.7, "arm_2_joint": 1.6}).with_friction(0.4)
GAINS = Feedback(base=500.0, arm=8.0)
SLOW_SENSOR = {"control_period": 0.004, "plant_step": 0.001, "sensor_period": 0.003}
FAST_SENSOR = {"control_period": 0.005, "plant_step": 0.001, "sensor_period": 0.002}


def trajectory(robot: Robot) -> Trajectory:
    """A circle from rest, and a sine of its own for every joint."""
    arm = [Sine(0.5 / (1 + 0.3 * i), 2.0 + 0.7 * i, phase=0.4 * i) for i in range(robot.dimensions.arm)]
    return Trajectory(Circle(1.0, 0.4, ramp=0.5) if robot.dimensions.base else None, tuple(arm))


def loop(controller=None, robot: Robot = ROBOT, duration: float = LONG, periods=None, **more) -> Loop:
    timing = Timing(duration=duration, **{"integrator": more.pop("integrator", "rk4"), **(periods or SLOW_SENSOR)})
    start = Start(pose_offset=(-0.02, 0.01, 0.03), joint_offset=0.04)
    settings = {"robot": robot, "trajectory": trajectory(robot), "start": start} | more
    return Loop(controller=controller or PD(GAINS), timing=timing, **settings)


def both(closed: Loop, **arguments) -> list[Recording]:
    """By the ordinary loop with Pinocchio's dynamics in plant and controller, and by the compiled one."""
    believed = patch("mmnn_pin.loop.sample.believed_model", lambda robot: Unflattened(robot, Dynamics(robot)))
    with patch("mmnn_pin.plant.ideal.terms_of", Dynamics), believed:
        ordinary = replace(closed, engine="ordinary").run(**arguments)
    return [ordinary, replace(closed, engine="compiled").run(**arguments)]


def assert_same(ordinary: Recording, compiled: Recording, tolerance: float = SAME) -> None:
    """Every signal at every sample, the weights, the end and the memory."""
    assert (ordinary.meta["loop"], compiled.meta["loop"]) == ("ordinary", "compiled")
    assert ordinary.names == compiled.names and len(ordinary) == len(compiled) > 0
    for field in ("status", "time", "signal"):
        assert getattr(ordinary.outcome, field) == getattr(compiled.outcome, field)
    assert ordinary.weights.keys() == compiled.weights.keys() and ordinary.final.keys() == compiled.final.keys()
    pairs = {name: (ordinary[name], compiled[name]) for name in ordinary.names}
    pairs |= {f"weights {name}": (array, compiled.weights[name]) for name, array in ordinary.weights.items()}
    pairs |= {f"final {name}": (array, compiled.final[name]) for name, array in ordinary.final.items()}
    for name, (one, other) in pairs.items():
        scale = max(1.0, np.abs(one[np.isfinite(one)]).max(initial=0.0))
        np.testing.assert_allclose(other, one, rtol=0, atol=tolerance * scale, err_msg=name)


def assert_same_and_done(closed: Loop) -> None:
    ordinary, compiled = both(closed)
    assert ordinary.outcome.status == "completed", ordinary.outcome.message
    assert len(ordinary) == closed.timing.samples and np.ptp(ordinary["torque"], axis=0).min() > 0
    assert_same(ordinary, compiled)


# --- The thesis's robot, with friction in its joints and on its base --------------------------------------------------


def schedule(robot: Robot, samples: int) -> ScheduledPD:
    """Gains that swing, in a table that is shorter than the run."""
    swing = 1.0 + 0.3 * np.sin(np.arange(max(1, samples // 2)) / 7.0)
    return ScheduledPD(swing[:, None] * GAINS.vector(robot.dimensions))


CONTROLLERS = {
    "two_layer per sample": Neural(TwoLayer(), GAINS),
    "two_layer per second": Neural(TwoLayer(F=(50.0, 5.0), G=(50.0, 5.0)), GAINS, rates="per_second"),
    "two_layer of appendix B": Neural(TwoLayer(initial="zero"), GAINS, update="before_output"),
    "one_layer per sample": Neural(OneLayer(), GAINS),
    "one_layer per second": Neural(OneLayer(centres="random"), GAINS, rates="per_second", leakage=False),
    "pd": PD(GAINS),
    "scheduled": schedule(ROBOT, round(LONG / 0.004)),
    "computed_torque": ComputedTorque(GAINS),
}


@pytest.mark.parametrize("name", ["two_layer per sample", "computed_torque", "pd"])
@pytest.mark.parametrize("integrator", ["rk4", "implicit_friction"])
def test_both_engines_give_the_same_bits(name: str, integrator: str) -> None:
    closed = loop(CONTROLLERS[name], robot=HEAVY, duration=SHORT, integrator=integrator)
    ordinary, compiled = (replace(closed, engine=engine).run() for engine in ("ordinary", "compiled"))
    assert ordinary.meta["loop"] != compiled.meta["loop"] and np.ptp(ordinary["torque"], axis=0).min() > 0
    for signal_name in ordinary.names:
        np.testing.assert_array_equal(ordinary[signal_name], compiled[signal_name], err_msg=signal_name)


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit_euler"])
@pytest.mark.parametrize("controller", CONTROLLERS.values(), ids=CONTROLLERS)
def test_every_controller(controller, integrator):
    assert_same_and_done(loop(controller, integrator=integrator, nominal=HEAVY))


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit_euler"])
@pytest.mark.parametrize(
    "periods",
    [
        {"control_period": 0.001, "plant_step": 0.001},
        {"control_period": 0.002, "plant_step": 0.001},
        {"control_period": 0.002, "plant_step": 0.002, "sensor_period": 0.006},
        FAST_SENSOR,
        {"control_period": 0.004, "plant_step": 0.0005, "sensor_period": 0.0065},
    ],
    ids=str,
)
def test_every_period(periods, integrator):
    for controller in (Neural(TwoLayer(), GAINS), ComputedTorque(GAINS)):
        assert_same_and_done(loop(controller, duration=SHORT, periods=periods, integrator=integrator, nominal=HEAVY))


def test_friction_and_a_wrong_nominal_robot_matter():
    """Without these differences the comparisons would not see them."""
    smooth = replace(ROBOT, damping=0 * ROBOT.damping, coulomb=0 * ROBOT.coulomb)
    rubbing, free, mistaken = (
        loop(ComputedTorque(GAINS), robot, SHORT, nominal=nominal, engine="compiled").run()
        for robot, nominal in ((ROBOT, None), (smooth, None), (ROBOT, HEAVY))
    )
    for other in (free, mistaken):
        assert np.abs(other["psi_hat"] - rubbing["psi_hat"]).max() > 0.1


def test_a_nominal_robot_of_another_shape_is_refused():
    for engine in ("ordinary", "compiled"):
        with pytest.raises(ConfigError, match=r"nominal robot has Dimensions\(base=0, arm=2"):
            loop(ComputedTorque(GAINS), nominal=load("two_axis_arm"), engine=engine).run()


# --- Other robots -----------------------------------------------------------------------------------------------------

FINE = {"control_period": 0.002, "plant_step": 0.001, "sensor_period": 0.003}


def controllers_for(robot: Robot) -> dict:
    """PD, a network and computed torque with gains that suit its inertias."""
    gains = feedback(robot, FINE["control_period"])
    quiet = Robust(base=0.01 * min(gains.base, default=0.0), arm=0.01 * min(gains.arm))
    rates = (1e-3 * min(gains.base, default=0.0), 1e-3 * min(gains.arm))
    network = Neural(TwoLayer(F=rates, G=rates), gains, quiet)
    return {"pd": PD(gains), "two_layer": network, "computed_torque": ComputedTorque(gains)}


def loop_of(name: str, robot: Robot, duration: float, **more) -> Loop:
    nominal = robot.with_masses(1.3) if name == "computed_torque" else None
    controller = controllers_for(robot)[name]
    return loop(controller, robot, duration, FINE, nominal=nominal, kinematic=Kinematic(K=4.0), **more)


@pytest.mark.parametrize("name", ["pd", "two_layer", "computed_torque"])
@pytest.mark.parametrize("make", [mobile_arm, fixed_arm, lambda: load("two_axis_arm")], ids=["mobile", "fixed", "axes"])
def test_arms_that_feel_gravity(make, name):
    robot = make()
    assert_same_and_done(loop_of(name, robot, LONG))


def test_the_seven_joint_arms_are_what_they_are_for():
    """Seven joints, one of them sliding, gravity and an axle away from the root link."""
    for robot, base in ((mobile_arm(), 2), (fixed_arm(), 0)):
        assert (robot.dimensions.arm, robot.dimensions.base) == (7, base)
        assert body.body_of(robot).feels_gravity and np.all(robot.damping[robot.arm_index] > 0)
        assert robot.model.joints[robot.model.getJointId("joint_2")].shortname() == "JointModelPrismaticUnaligned"
    assert mobile_arm().frame[0] > 0.1


@settings(max_examples=2 if config.DISABLE_JIT else 12, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    joints=st.integers(1, 5),
    mobile=st.booleans(),
    name=st.sampled_from(["pd", "two_layer", "computed_torque"]),
    integrator=st.sampled_from(["rk4", "semi_implicit_euler"]),
)
def test_random_robots(seed, joints, mobile, name, integrator):
    robot = mobile_arm(joints, seed, axle=seed / 10_000 - 0.5) if mobile else fixed_arm(joints, seed)
    closed = loop_of(name, robot, 0.02 if config.DISABLE_JIT else 0.1, integrator=integrator, check_gains=False)
    assert_same(*both(closed))


def tiago() -> Path:
    wheel = Path(sysconfig.get_paths()["purelib"]) / "cmeel.prefix/share/example-robot-data/robots"
    folder = Path(os.environ.get("EXAMPLE_ROBOT_DATA", wheel))
    return next(iter(sorted(folder.rglob("tiago_no_hand.urdf"))), folder / "tiago_no_hand.urdf")


@pytest.mark.skipif(not tiago().exists(), reason="example-robot-data is not installed")
@pytest.mark.parametrize("name", ["pd", "two_layer", "computed_torque"])
def test_tiago(name):
    """With the friction of its URDF, which stops the lightest joint within 40 ns: implicit; and without, explicit."""
    robot = load(tiago())
    assert_same_and_done(loop_of(name, robot, LONG, integrator="implicit_friction"))
    assert_same_and_done(loop_of(name, replace(robot, damping=0 * robot.damping, coulomb=0 * robot.coulomb), LONG))


# --- How runs end -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("bounds", "signal"),
    [(Bounds(joint_speed=2.0), "nu[2]"), (Bounds(speed=0.02), "nu[0]"), (Bounds(yaw_rate=0.2), "nu[1]")],
)
def test_a_run_that_leaves_its_bounds_ends_alike(bounds, signal):
    wild = Feedback(base=500.0, arm=60.0)
    ordinary, compiled = both(loop(Neural(TwoLayer(), wild), bounds=bounds, check_gains=False))
    assert ordinary.outcome.status == "diverged" and ordinary.outcome.signal == signal
    assert 0 < ordinary.outcome.time < LONG and len(ordinary) > 2
    assert_same(ordinary, compiled, 1e-7)  # errors grow with what diverges


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit_euler"])
def test_a_number_that_is_not_finite_ends_both_at_that_sample(integrator):
    gains = np.tile(GAINS.vector(ROBOT.dimensions), (50, 1))
    gains[7, 1] = 1e308  # the torque is a number, what it does is none
    ordinary, compiled = both(loop(ScheduledPD(gains), check_gains=False, integrator=integrator))
    assert (ordinary.outcome.status, ordinary.outcome.signal) == ("diverged", "position[0]")
    assert ordinary.outcome.time == pytest.approx(0.032) and len(ordinary) == 8
    assert_same(ordinary, compiled)


@pytest.mark.parametrize("engine", ["ordinary", "compiled"])
def test_ctrl_c_keeps_whole_samples(engine):
    """A real signal, sent by another thread while the loop runs."""
    timers = []

    def progress(time: float) -> None:
        if not timers:
            timers.append(threading.Timer(0.005, os.kill, (os.getpid(), signal.SIGINT)))
            timers[0].start()

    endless = loop(duration=0.4 if config.DISABLE_JIT and engine == "compiled" else 400.0, engine=engine)
    if config.DISABLE_JIT:
        endless = replace(endless, weights_interval=0.004)
    run = endless.run(progress=progress)
    timers[0].join()
    assert run.outcome.status == "interrupted" and "Ctrl-C" in run.outcome.message
    assert 0 < len(run) < endless.timing.samples and run.outcome.time == pytest.approx(0.004 * len(run))
    short = replace(endless, timing=Timing(duration=min(len(run), 100) * 0.004, **SLOW_SENSOR)).run()
    for name in ("time", "nu", "torque"):
        np.testing.assert_array_equal(run[name][: len(short)], short[name])


class Pressing:
    """A sink that counts rows, and in which Ctrl-C is pressed just when it has taken some."""

    rows = 0

    def append_block(self, rows, step_times):
        self.rows += len(rows)
        signal.raise_signal(signal.SIGINT)

    def weights(self, time, arrays):
        pass


@pytest.mark.parametrize("engine", ["ordinary", "compiled"])
def test_ctrl_c_between_rows_and_their_count_comes_when_they_are_counted(engine):
    blocks, sink = loop(weights_interval=0.02, engine=engine), Pressing()
    outcome = blocks.stream(blocks.engine_at(), sink)
    assert outcome.status == "interrupted" and "Ctrl-C" in outcome.message
    assert sink.rows == 5 and outcome.time == pytest.approx(0.004 * sink.rows)


@pytest.mark.parametrize("engines", [("compiled", "ordinary"), ("ordinary", "compiled"), ("compiled", "compiled")])
@pytest.mark.parametrize("name", ["two_layer per sample", "scheduled", "computed_torque"])
def test_one_engine_resumes_what_the_other_began(engines, name):
    whole = loop(CONTROLLERS[name], duration=0.072 if config.DISABLE_JIT else 0.72, nominal=HEAVY)
    half = replace(whole, timing=Timing(duration=whole.timing.duration / 2, **SLOW_SENSOR), engine=engines[0])
    begun, run = half.run(), replace(whole, engine="ordinary").run()
    state = whole.state_from()
    state.values[:] = begun.final["controller_state"]
    plant_state = begun.final["position"], begun.final["nu"]
    ended = replace(whole, engine=engines[1]).run(state=state, plant_state=plant_state, first=len(begun))
    assert ended.meta["loop"] == engines[1] and len(begun) + len(ended) == len(run)
    for signal_name in ("time", "position", "nu", "q", "torque", "psi", "psi_hat", "effective_gain"):
        joined = np.concatenate((begun[signal_name], ended[signal_name]))
        scale = max(1.0, np.abs(joined).max())
        np.testing.assert_allclose(joined, run[signal_name], rtol=0, atol=SAME * scale, err_msg=signal_name)


# --- Which engine -----------------------------------------------------------------------------------------------------


class Mine(TorqueController):
    """PD in plain Python."""

    name = "mine"

    def step(self, time, reference, measurement, command, state):
        return GAINS.vector(ROBOT.dimensions) * np.concatenate((command.z, command.r))


def test_a_python_controller_runs_in_the_ordinary_loop_and_says_so(tmp_path):
    mine, ours = loop(Mine(), duration=SHORT), loop(duration=SHORT)
    run, compiled = mine.run(tmp_path / "run.h5"), ours.run()
    assert Recording.open(tmp_path / "run.h5").meta["loop"] == "ordinary"
    for name in ("position", "nu", "torque", "psi"):
        scale = max(1.0, np.abs(run[name]).max())
        np.testing.assert_allclose(run[name], compiled[name], rtol=0, atol=SAME * scale)
    with pytest.raises(ConfigError, match="plain Python"):
        replace(mine, engine="compiled").run()


def test_a_robot_that_cannot_be_flattened_runs_in_the_ordinary_loop_and_says_so(monkeypatch):
    def refuse(*arguments, **more):
        raise RobotError("joint 'odd' cannot be compiled")

    monkeypatch.setattr(body, "flatten", refuse)
    odd = loop(robot=replace(ROBOT), duration=SHORT)
    assert odd.run().meta["loop"] == "ordinary"
    with pytest.raises(RobotError, match="'odd'"):
        replace(odd, engine="compiled").run()
    assert loop(duration=SHORT, robot=load("platform_arm"), engine="ordinary").run().meta["loop"] == "ordinary"


def test_a_nominal_robot_that_cannot_be_flattened_counts_too(monkeypatch):
    odd, flatten = HEAVY.with_masses(1.1), body.flatten

    def refuse(model, *arguments, **more):
        if model is odd.model:
            raise RobotError("joint 'odd' cannot be compiled")
        return flatten(model, *arguments, **more)

    monkeypatch.setattr(body, "flatten", refuse)
    assert loop(ComputedTorque(GAINS), duration=SHORT, nominal=odd).run().meta["loop"] == "ordinary"
    assert loop(PD(GAINS), duration=SHORT, nominal=odd).run().meta["loop"] == "compiled"  # it is not asked


def test_samples_that_the_run_or_its_block_does_not_have_are_refused() -> None:
    engine = loop(duration=SHORT, engine="compiled").engine_at()
    for first, last in ((0, len(engine.rows) + 1), (0, 10**6), (10**6, 10**6 + 1), (-1, 0), (2, 1)):
        with pytest.raises(ConfigError, match="at a time"):
            engine.advance(first, last)
    assert engine.counter[0] == 0 and engine.advance(0, 1) == -1 and engine.counter[0] == 1
