"""One control sample at a time from outside: the same numbers as in a loop, nothing that stops a real-time loop."""

from __future__ import annotations

import gc
import subprocess
import sys
import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest
from builders import first_of
from numba import config

from mmnn_pin import (
    PD,
    Eight,
    Feedback,
    LearningLaw,
    Line,
    Loop,
    Neural,
    Recording,
    Sine,
    Stepper,
    StepperSettings,
    Timing,
    TorqueController,
    Trajectory,
    load,
    load_experiment,
)
from mmnn_pin.actuator import Actuator
from mmnn_pin.cli import main
from mmnn_pin.disturbance import DeadMotor, Push
from mmnn_pin.errors import ConfigError, RecordingError
from mmnn_pin.lab.psi.judgement import Judgement
from mmnn_pin.loop.setup import UNKNOWN
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.recording.recording import recorded_position
from mmnn_pin.reference.wishes import HOLD, BaseVelocity, JointGoal
from mmnn_pin.safety import RAMPING, Safety
from mmnn_pin.sensing import Sensor
from mmnn_pin.signals import Measurement, Setpoint
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.neural import Robust
from mmnn_pin.torque.one_layer import OneLayer
from mmnn_pin.torque.two_layer import TwoLayer

H = 0.005
GAINS = Feedback(300.0, 5.0)
ROBOT = load("platform_arm")
ARM = load("two_axis_arm")


class Integral(TorqueController):
    """PD with an integral, in plain Python."""

    name = "integral"

    def init(self, context):
        return {"sum": np.zeros(context.layout.dof), "k": GAINS.vector(context.layout)}

    def step(self, time, reference, measurement, command, state):
        s = np.concatenate((command.z, command.r))
        state["sum"] += H * s
        return state["k"] * (s + state["sum"])


def closed(controller=None, robot=ROBOT, duration=0.5, **changes):
    base = Eight(3.0, 1.5, 20.0) if robot.dimensions.base else None
    arm = tuple(Sine(amplitude=0.3, period=2.0) for _ in range(robot.dimensions.arm))
    timing = Timing(duration=duration, control_period=H, plant_step=0.001)
    given = {"safety": Safety(), "timing": timing, "engine": "ordinary", "weights_interval": 0.05} | changes
    return Loop(robot, Trajectory(base, arm), controller or PD(GAINS), **given)


def measurement(run, k, layout=ROBOT.dimensions):
    """What was measured at a sample of a run; arrays of size 0 where the robot has none."""
    sizes = {"pose": layout.pose, "velocity": layout.base, "q": layout.arm, "qdot": layout.arm}
    return Measurement(**{name: run[name][k].reshape(size) if size else np.zeros(0) for name, size in sizes.items()})


def asked(loop, k=None):
    """The setpoints of a loop's trajectory, or one of them."""
    setpoints = Setpoint.side_by_side(loop.table(), loop.robot.dimensions)
    of = lambda k: Setpoint(*(getattr(setpoints, f.name)[k] for f in fields(Setpoint)))  # noqa: E731
    return [of(i) for i in range(loop.timing.samples)] if k is None else of(k)


def replayed(loop, run, **arguments):
    """The recording of a stepper that is given all setpoints and measurements of a run."""
    with Stepper.of(loop, **arguments) as cycle:
        for k, setpoint in enumerate(asked(loop)):
            command = cycle.step(k * H, measurement(run, k, loop.robot.dimensions), setpoint)
            assert command.effort.tolist() == run["torque"][k].tolist()
            assert command.motor_effort.tolist() == run["motor_torque"][k].tolist()
            cycle.record()
        return cycle.finish()


# -- the same numbers --------------------------------------------------------------------------------------------------

NETWORK = TwoLayer(hidden=6, F=(0.05, 0.05), G=(0.05, 0.05))
CONTROLLERS = {
    "pd": PD(GAINS),
    "two_layer": Neural(NETWORK, GAINS, Robust(1.0, 0.05)),
    "one_layer": Neural(OneLayer(hidden=6), GAINS, Robust(1.0, 0.05)),
    "computed_torque": ComputedTorque(GAINS),
    "python": Integral(),
}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_signal_is_that_of_the_ordinary_loop(name):
    loop = closed(CONTROLLERS[name])
    if name == "computed_torque":
        loop = replace(loop, nominal=ROBOT.with_masses(0.7))
    run = loop.run()
    found = replayed(loop, run)
    assert set(found.names) == set(run.names) - set(UNKNOWN)
    for signal in found.names:
        np.testing.assert_array_equal(found[signal], run[signal], signal)
    for array in run.weights:
        np.testing.assert_array_equal(found.weights[array], run.weights[array], array)
    assert list(found.weights) == list(run.weights)
    if name != "python":
        assert found.final["controller_state"].tolist() == run.final["controller_state"].tolist()
    assert found.outcome == run.outcome
    assert found.step_times.min() > 0


LEARNERS = [
    *("kalman_regressor", "kalman_bilinear", "kalman_features", "kalman_residual", "concurrent", "adaptive"),
    *("adaptive_composite", "two_layer_residual", "own"),
]
QUICK = [  # so that all of them learn within 0.1 s
    *(f"kalman.{table}.state_pole=1000.0" for table in ("regressor", "bilinear", "features", "residual")),
    *(
        "kalman.bilinear.hidden=3",
        "kalman.residual.hidden=3",
        "kalman.features.hidden=20",
    ),
    "concurrent.entries=10",
]


class Follow(LearningLaw):
    """A law of a user that learns from both errors: `Psi_hat = W' [1, nu, nudot_ref]`."""

    def init(self, context):
        return ControllerState.of(W=(1 + 2 * context.layout.dof, context.layout.dof))

    def estimate(self, now, state):
        return np.concatenate(([1.0], now.nu, now.nudot_ref)) @ state["W"]

    def learn(self, now, state):
        x = np.concatenate(([1.0], now.nu, now.nudot_ref))
        error = 10.0 * now.s if now.first else 10.0 * now.s + 1e-3 * (now.sent - x @ state["W"])
        state["W"] += now.period * np.outer(x, error)


def learner(name, robot=ROBOT):
    """A learner with `GAINS`, the numbers of a robot's own."""
    if name == "own":
        return Follow(feedback=GAINS)
    told = [*QUICK, f"feedback.base={GAINS.base}", f"feedback.arm={GAINS.arm}"]
    return load_experiment("chapter4", told).controller(name, robot=robot)


@pytest.mark.parametrize("name", first_of(LEARNERS, "adaptive", "own"))
def test_a_learner_learns_there_what_it_learns_in_the_loop(name, monkeypatch):
    monkeypatch.setattr("mmnn_pin.torque.kalman.SAMPLES", 20)  # of the prior: the time that plain Python takes
    monkeypatch.setattr("mmnn_pin.torque.concurrent.SAMPLES", 60)
    monkeypatch.setattr("mmnn_pin.torque.prior.SAMPLES", 10)
    loop = closed(learner(name), duration=0.05 if config.DISABLE_JIT else 0.5)
    run = loop.run()
    found = replayed(loop, run)
    for signal in ("psi_hat", "torque", "weight_norm"):
        np.testing.assert_array_equal(found[signal], run[signal], signal)
    assert found.final["controller_state"].tolist() == run.final["controller_state"].tolist()
    assert list(found.weights) == list(run.weights)
    for array in run.weights:
        np.testing.assert_array_equal(found.weights[array], run.weights[array], array)
    learned = [name for name in run.weights if name != "time"]
    assert any(np.abs(run.weights[name][-1] - run.weights[name][0]).max() > 0 for name in learned)


def test_a_fixed_arm_has_one_too():
    loop = closed(PD(Feedback(arm=0.2)), ARM)
    assert len(replayed(loop, loop.run())) == 100


def test_what_the_loop_simulates_is_left_out():
    noisy = closed(CONTROLLERS["two_layer"], sensor=Sensor(noise=0.001, resolution=0.001))
    run = noisy.run()
    assert np.abs(run["q"] - run["q_ref"] + run["true_e"]).max() > 1e-4  # the measurement is not the truth
    events = Push(on="arm_1_joint", force=5.0), DeadMotor(joint="arm_2_joint")
    replayed(replace(noisy, actuator=Actuator(lag=0.02), disturbances=events, plant="contact"), run)


# -- measurements that do not come, or should not have -----------------------------------------------------------------


def test_a_measurement_that_is_refused_is_one_that_did_not_come():
    loop = closed(CONTROLLERS["two_layer"])
    run = loop.run()
    bad = measurement(run, 0)
    with Stepper.of(loop) as one, Stepper.of(loop) as other:
        for k, setpoint in enumerate(asked(loop)):
            good = measurement(run, k)
            bad = replace(good, q=good.q * (np.nan, np.inf, 1e300)[k % 3]) if k % 4 else good
            mine = one.step(k * H, good if k % 4 == 0 else None, setpoint).effort.copy()
            assert mine.tolist() == other.step(k * H, bad, setpoint).effort.tolist()
            assert np.isfinite(other.row).all()
            one.record()
            other.record()
        quiet, told = one.finish(), other.finish()
    assert quiet.outcome.message == ""
    assert told.outcome.status == "completed"
    assert "refused 75 measurements" in told.outcome.message


@pytest.mark.parametrize("age", [0.1, np.nan])
def test_a_measurement_older_than_the_last_or_of_no_time_changes_nothing(age):
    loop = closed()
    run = loop.run()
    with Stepper.of(loop) as one, Stepper.of(loop) as other:
        for cycle in (one, other):
            cycle.step(0.0, measurement(run, 0))
            cycle.step(0.2, measurement(run, 40), measured=0.19)
        torque = one.step(0.205).effort.tolist()
        assert other.step(0.205, measurement(run, 20), measured=age).effort.tolist() == torque
        told = cycle.setup.layout.where("safety")
        assert (one.row[told] == other.row[told]) == (age == 0.1)  # what is refused is told
        one.row[told] = other.row[told]
        assert one.row.tolist() == other.row.tolist()


def test_an_age_counts_from_when_it_was_measured_and_never_lies_ahead():
    loop = closed(duration=2.0, safety=Safety(timeout=0.498, joint_error=9.0))
    run = loop.run()
    with Stepper.of(loop) as late, Stepper.of(loop) as ahead:
        for k, setpoint in enumerate(asked(loop)[:200]):
            late.step(k * H, measurement(run, k), setpoint, measured=k * H - 0.3)
            ahead.step(k * H, measurement(run, k), setpoint, measured=1e6)
        assert not late.tripped and not ahead.tripped
        stopped = {}
        for name, cycle in (("late", late), ("ahead", ahead)):
            stopped[name] = next(k for k in range(200, 400) if cycle.step(k * H) is not None and cycle.tripped)
    assert stopped == {"late": 199 + 40, "ahead": 199 + 100}


def test_silence_trips_with_a_ramp_to_zero_and_keeps_everything(tmp_path):
    loop = closed(
        CONTROLLERS["two_layer"], duration=4.0, safety=Safety(timeout=0.3, ramp=0.1, stop_time=0.6, joint_error=9.0)
    )
    run, torques, memories = loop.run(), [], []
    with Stepper.of(loop, path=tmp_path / "run.h5") as cycle:
        for k, setpoint in enumerate(asked(loop)):
            torques.append(cycle.step(k * H, measurement(run, k) if k < 100 else None, setpoint).effort.copy())
            cycle.record()
            memories += [cycle.state.values.copy()] if cycle.tripped else []
            if cycle.is_over:
                break
        found = cycle.finish("completed", "and more")
    assert found.outcome.status == "tripped" and found.outcome.signal == "measurement[0]"
    assert found.outcome.time == pytest.approx(99 * H + 0.3, abs=1.01 * H)
    assert found.outcome.message.endswith("and more")
    assert len(found) == k + 1 == round((found.outcome.time + 0.6) / H) + 1
    assert (np.array(memories) == memories[0]).all()  # it learns nothing from a stop
    size = np.abs(torques).sum(axis=1)
    tripped = int(np.argmax(found["safety"] == RAMPING))
    assert size[tripped - 1] > 1.0 and (np.diff(size[tripped - 1 : tripped + 20]) <= 0).all()
    assert not size[tripped + round(0.1 / H) + 1 :].any()


def test_old_measurements_are_no_basis_for_a_stop():
    loop = closed(duration=3.0, safety=Safety(timeout=0.3, ramp=0.1, stop_time=2.0))
    run = loop.run()
    with Stepper.of(loop) as cycle:
        for k, setpoint in enumerate(asked(loop)):
            late = k - 120  # samples, 0.6 s, from the 100th on
            given = (k, k * H) if k < 100 else (late, late * H) if late >= 100 else None
            cycle.step(k * H, given and measurement(run, given[0]), setpoint, measured=given and given[1])
            if cycle.tripped and k * H > 0.5 + 0.3 + 0.1 + 2 * H:
                assert not cycle.command.effort.any()
        assert cycle.tripped


def test_nothing_moves_and_nothing_trips_before_the_first_measurement():
    loop = closed(safety=Safety(joint_error=0.01, position_error=0.01, speed=0.001))
    far = replace(loop, trajectory=Trajectory(Line(speed=0.3, start=(5.0, 5.0, 1.0)), loop.trajectory.arm))
    with Stepper.of(far) as cycle:
        for k, setpoint in enumerate(asked(far)[:50]):
            assert not cycle.step(k * H, None, setpoint).effort.any()
        assert not cycle.tripped


# -- errors ------------------------------------------------------------------------------------------------------------


def test_without_a_supervisor_there_is_none():
    with pytest.raises(ConfigError, match=r"safety: error: a stepper without a supervisor.*Safety\(\)"):
        Stepper.of(closed(safety=None))


def test_unstable_gains_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ConfigError, match="unstable"):
        Stepper.of(closed(PD(Feedback(1e5, 1e3))), path=tmp_path / "run.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("time", [-H, H, np.nan, np.inf])
def test_times_that_do_not_go_forward_are_refused(time):
    with Stepper.of(closed()) as cycle:
        cycle.step(0.0)
        cycle.step(H)
        with pytest.raises(ConfigError, match="a control sample at"):
            cycle.step(time)
        cycle.step(2 * H)


@pytest.mark.parametrize("name", ["pose", "velocity", "q", "qdot"])
def test_measurements_of_another_size_are_refused(name):
    with Stepper.of(closed()) as cycle:
        good = measurement(closed(duration=H).run(), 0)
        with pytest.raises(ConfigError, match=f"a measurement with {name} of shape"):
            cycle.step(0.0, replace(good, **{name: np.zeros(1)}))


# -- setpoints one by one ----------------------------------------------------------------------------------------------


def test_a_trajectory_writes_the_setpoints_of_its_table():
    loop = closed()
    values, table = np.zeros(loop.table().shape[1]), loop.table()
    setpoint, measured = Setpoint.side_by_side(values, loop.layout), measurement(loop.run(), 0)
    for k in range(loop.timing.samples):
        loop.trajectory.write(k * H, measured, setpoint)
        np.testing.assert_allclose(values, table[k], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("acceleration", [30.0, 100.0, 1000.0, 1e6])
@pytest.mark.parametrize("velocity", [-5.0, 0.0, 5.0])
def test_a_goal_behind_setpoints_of_any_acceleration_is_reached(velocity, acceleration):
    zero, full = np.zeros(2), lambda q, qdot, qddot: Setpoint(np.zeros(3), np.zeros(2), np.zeros(2), q, qdot, qddot)
    given = Measurement(np.zeros(3), np.zeros(2), zero, zero)
    with Stepper(ROBOT, PD(GAINS), StepperSettings(period=H)) as cycle:
        cycle.step(0.0, given)
        for k in range(1, 6):
            cycle.step(
                k * H, given, full(np.array([0.0, 0.5]), np.array([0.0, velocity]), np.array([0.0, acceleration]))
            )
        for k in range(6, 2000):
            cycle.step(k * H, given, JointGoal((0.2, -0.8)) if k == 6 else None)
        np.testing.assert_allclose(cycle.setpoint.q, (0.2, -0.8), atol=1e-6)


def test_setpoints_of_another_robot_or_not_finite_are_refused():
    loop = closed()
    table = Setpoint.side_by_side(loop.table()[0].copy(), loop.layout)
    with Stepper.of(loop) as one:
        with pytest.raises(ConfigError, match="a setpoint with q of shape"):
            one.step(0.0, None, replace(table, q=np.zeros(7)))
        with pytest.raises(ConfigError, match="a setpoint that is not finite"):
            one.step(0.0, None, replace(table, q=table.q + np.nan))
        with pytest.raises(ConfigError, match="a control sample at"):
            one.step(np.inf, None, table)
        one.step(0.0, None, table)


# -- a loop of one's own -----------------------------------------------------------------------------------------------


class Real:
    """A robot of its own: the ideal plant between the steps of a stepper."""

    def __init__(self, stepper, at=(0.0, 0.0, 0.0), q=(0.3, 0.2)):
        self.stepper, self.k, self.nb = stepper, 0, ROBOT.dimensions.base
        self.plant = IdealPlant(stepper.robot, stepper.period, "implicit_friction")
        position = ROBOT.neutral_position()
        position[:3], position[ROBOT.arm_index] = at, q
        self.plant.start(position, np.zeros(ROBOT.dimensions.dof))

    def measure(self):
        position, nu, nb = self.plant.position, self.plant.nu, self.nb
        return Measurement(position[:3].copy(), nu[:nb].copy(), position[ROBOT.arm_index].copy(), nu[nb:].copy())

    def run(self, seconds, setpoint=None, renew=False):
        for i in range(round(seconds / self.stepper.period)):
            asked = setpoint if i == 0 or renew else None
            effort = self.stepper.step(self.k * self.stepper.period, self.measure(), asked).effort
            self.plant.step(np.ascontiguousarray(effort))
            self.plant.refresh()
            self.stepper.record()
            self.k += 1
        return self.measure()


CALM = Feedback(15.0, 20.0, "inertia")


def new(**changes):
    given = {"safety": Safety(joint_error=0.5, position_error=0.5), "weights_interval": 1.0, **changes}
    return Stepper(ROBOT, given.pop("controller", PD(CALM)), StepperSettings(**given))


def test_it_starts_where_the_robot_stands_drives_reaches_and_follows():
    real = Real(new(controller=ComputedTorque(CALM)), at=(5.0, -3.0, 2.0), q=(1.0, -0.7))
    rest = real.run(0.5)
    np.testing.assert_allclose(rest.pose, (5.0, -3.0, 2.0), atol=1e-9)
    np.testing.assert_allclose(rest.q, (1.0, -0.7), atol=1e-9)
    moving = real.run(2.0, BaseVelocity((0.3, 0.2)), renew=True)
    np.testing.assert_allclose(moving.velocity, (0.3, 0.2), atol=0.02)
    motion = real.stepper.plan(Trajectory(None, (Sine(0.3, 2.0), Sine(0.2, 3.0))), 6.0)
    real.run(4.0, (BaseVelocity((0.1, 0.0)), motion))
    np.testing.assert_allclose(real.stepper.measured.q, real.stepper.setpoint.q, atol=0.02)
    still = real.run(2.5, HOLD)
    assert np.abs(still.velocity).max() < 1e-2 and not real.stepper.tripped
    run = real.stepper.finish()
    assert run.outcome.status == "completed" and "not renewed in time, 1 times" in run.outcome.message


def test_a_stop_from_outside_stops_and_a_reset_goes_on_with_what_was_learned():
    stepper = new(controller=learner("adaptive"), check_gains=False)
    real = Real(stepper)
    real.run(0.4, BaseVelocity((0.3, 0.0)), renew=True)
    stepper.stop("a hand on the button")
    with pytest.raises(ConfigError, match="nothing to reset"):
        new().reset()
    learned = None
    for _ in range(30):
        real.run(0.02, BaseVelocity((0.3, 0.0)), renew=True)
        learned = stepper.snapshot() if learned is None else learned
        assert stepper.tripped
    assert np.abs(stepper.measured.velocity).max() < 0.1
    assert stepper.snapshot().values.tolist() == learned.values.tolist()
    stepper.reset()
    assert not stepper.tripped
    moved = real.run(1.0, BaseVelocity((0.3, 0.0)), renew=True)
    assert moved.velocity[0] > 0.2 and not stepper.tripped
    message = stepper.finish().outcome.message
    assert "a hand on the button" in message and "stopped from outside at t = " in message


def test_a_reset_without_fresh_measurements_is_refused():
    stepper = new()
    real = Real(stepper)
    real.run(0.1)
    stepper.stop()
    for k in range(100):
        stepper.step(1.0 + k * H)
    with pytest.raises(ConfigError, match="blind"):
        stepper.reset()


def test_gains_change_while_it_runs_and_what_was_learned_stays():
    stepper = new(controller=Neural(NETWORK, Feedback(300.0, 5.0), Robust(1.0, 0.05)))
    real = Real(stepper)
    real.run(0.3, BaseVelocity((0.2, 0.1)), renew=True)
    before, row = stepper.snapshot(), stepper.row.copy()
    stepper.change(controller=Neural(NETWORK, Feedback(600.0, 10.0), Robust(1.0, 0.05)))
    assert stepper.snapshot().values.tolist() == before.values.tolist()
    stepper.step(10.0, real.measure(), BaseVelocity((0.2, 0.1)))
    gain = stepper.setup.layout.where("effective_gain")
    assert (stepper.row[gain] > row[gain] + 4.0).all()
    kept = stepper.control
    for bad in (PD(GAINS), Neural(NETWORK, Feedback(1e6, 1e4), Robust(1.0, 0.05))):
        with pytest.raises(ConfigError):
            stepper.change(controller=bad)
    assert stepper.control is kept


def test_another_stepper_goes_on_from_a_snapshot_with_the_same_torques():
    loop = closed(CONTROLLERS["two_layer"], duration=0.2)
    run, setpoints = loop.run(), asked(loop)
    with Stepper.of(loop) as one:
        for k in range(20):
            one.step(k * H, measurement(run, k), setpoints[k])
        with Stepper.of(loop, state=one.snapshot()) as other:
            for k in range(20, 40):
                torque = other.step(k * H, measurement(run, k), setpoints[k]).effort.tolist()
                assert torque == one.step(k * H, measurement(run, k), setpoints[k]).effort.tolist()


def test_a_pause_holds_and_a_motion_goes_on_after_it():
    stepper = new(controller=ComputedTorque(CALM))
    real = Real(stepper, q=(0.0, 0.0))
    real.run(1.0, stepper.plan(Trajectory(Line(0.2, ramp=0.5), (Sine(0.2, 2.0), Sine(0.2, 2.0))), 3.0))
    stepper.pause()
    still = real.run(1.5)
    assert np.abs(still.velocity).max() < 0.02 and np.abs(still.qdot).max() < 0.05
    stepper.resume()
    real.run(1.0)
    assert stepper.is_moving and stepper.setpoint.velocity[0] == pytest.approx(0.2)
    np.testing.assert_allclose(stepper.measured.q, stepper.setpoint.q, atol=0.03)


@pytest.mark.parametrize("wish", [BaseVelocity((1.0,)), "home"])
def test_a_wish_that_is_refused_changes_nothing(wish):
    one, other = new(), new()
    for real in (Real(one), Real(other)):
        real.run(0.1, BaseVelocity((0.2, 0.1)))
    with pytest.raises(ConfigError):
        one.step(1.0, None, wish)
    still = Real(one).measure()
    assert one.step(1.0, still).effort.tolist() == other.step(1.0, still).effort.tolist()


# -- time and memory ---------------------------------------------------------------------------------------------------

FRESH = """
import sys, numpy as np
from mmnn_pin import *
from mmnn_pin.reference.wishes import HOLD, BaseVelocity, JointGoal
from mmnn_pin.torque.model_based import ComputedTorque
def count():
    return sum(len(f.overloads) for name, m in list(sys.modules.items()) if name.startswith("mmnn_pin")
               for f in vars(m).values() if hasattr(f, "overloads"))
with Stepper(load("platform_arm"), CONTROLLER, StepperSettings(period=0.005)) as cycle:
    zero = type(cycle.measured)(np.zeros(3), np.zeros(2), np.zeros(2), np.zeros(2))
    motion = cycle.plan(Trajectory(Line(speed=0.3), (Sine(0.3, 2.0), Hold(0.8))), 0.1)
    wishes = {2: motion, 4: HOLD, 6: BaseVelocity((0.1, 0.0)), 8: cycle.setpoint}
    before = count()
    for k in range(20):
        cycle.step(k * 0.005, zero, wishes.get(k))
        cycle.is_over
    print(before > 5, count() - before)
"""


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize("controller", ["Neural()", "ComputedTorque()"])
def test_nothing_is_compiled_in_a_step(controller):
    script = FRESH.replace("CONTROLLER", controller).replace("Neural()", "Neural(feedback=Feedback(300.0, 5.0))")
    script = script.replace("ComputedTorque()", "ComputedTorque(Feedback(300.0, 5.0))")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "0"]


def test_the_rehearsal_leaves_no_trace():
    with Stepper.of(closed(CONTROLLERS["two_layer"])) as cycle:
        fresh = cycle.setup.controller.init(cycle.setup.context())
        assert cycle.state.values.tolist() == fresh.values.tolist()
        assert not cycle.row.any() and not cycle.tripped


@pytest.mark.skipif(config.DISABLE_JIT, reason="uncompiled blocks allocate")
@pytest.mark.parametrize(("name", "samples"), [
    ("two_layer", 10_000),
    ("computed_torque", 10_000),
    *(pytest.param(name, 100_000, marks=pytest.mark.long) for name in CONTROLLERS if name != "python"),
])  # fmt: skip
def test_steps_collect_no_garbage_and_keep_no_memory(name, samples):
    loop = closed(CONTROLLERS[name], duration=20.0)
    run, began = closed(CONTROLLERS[name], duration=0.5).run(), []
    given, setpoints = [measurement(run, k) for k in range(100)], asked(loop)[:100]
    drive = BaseVelocity((0.2, 0.1))
    note = lambda phase, info: began.append(phase)  # noqa: E731
    with Stepper.of(loop) as cycle:
        gc.collect()
        gc.callbacks.append(note)
        tracemalloc.start()
        sizes, counts = [], []
        try:
            for k in range(samples):
                if k % (samples // 8) == 0:
                    sizes.append(tracemalloc.get_traced_memory()[0])
                    counts.append(gc.get_count()[0])
                cycle.step(k * H, given[k % 100], setpoints[k % 100] if k % 1000 < 500 else drive)
        finally:
            tracemalloc.stop()
            gc.callbacks.remove(note)
    assert began == [] and min(np.diff(counts)) < 10, "of 700 that start a collection"
    assert min(np.diff(sizes)) < samples // 8, "one byte a step: what is kept once fills caches"


# -- the recording -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    loop = closed(CONTROLLERS["two_layer"])
    path = tmp_path_factory.mktemp("cycle") / "run.h5"
    return loop.run(), replayed(loop, loop.run(), path=path)


def test_plots_reports_replays_and_exports_take_it(recorded, tmp_path, capsys):
    path = str(recorded[1].path)
    for command in (
        ["plot", path, "--out", str(tmp_path / "plots")],
        ["report", path, "--html", str(tmp_path / "report.html")],
        ["replay", path, "--html", str(tmp_path / "replay.html")],
        ["export", path, "--to", "csv", "--out", str(tmp_path / "run.csv")],
    ):
        assert main(command) == 0, capsys.readouterr().err
    assert main(["plot", path, "--what", "psi", "--out", str(tmp_path / "psi.png")]) == 2
    assert "psi" in capsys.readouterr().err


def test_its_transforms_are_those_of_the_simulated_run_but_for_the_wheels(recorded, tmp_path):
    pytest.importorskip("mcap_ros2")
    assert main(["export", str(recorded[1].path), "--to", "mcap", "--out", str(tmp_path / "run.mcap")]) == 0
    simulated, found = (recorded_position(run, ROBOT) for run in recorded)
    known = [ROBOT.position_names.index(name) for name in ("x", "y", "phi", *ROBOT.joint_names)]
    np.testing.assert_allclose(found[:, known], simulated[:, known], atol=1e-12)


def test_what_needs_the_truth_says_so(recorded):
    with pytest.raises(RecordingError, match="no truth") as caught:
        Judgement(recorded[1])
    assert "outside a simulation" in caught.value.why


def test_an_exception_leaves_what_was_recorded(tmp_path):
    with pytest.raises(RuntimeError), Stepper.of(closed(), path=tmp_path / "run.h5") as cycle:
        for k in range(10):
            cycle.step(k * H)
            cycle.record()
        raise RuntimeError
    run = Recording.open(tmp_path / "run.h5")
    assert len(run) == 10 and run.outcome.status == "interrupted"


def test_an_observer_gives_velocities_of_coarse_angles_and_of_a_jumping_odometry():
    """Angles in steps of 1.5 mrad a millisecond: their differences jump by 1.5 rad/s, the observer's hardly move."""
    robot, h, speed = load("platform_arm"), 0.001, 0.3
    weak = PD(Feedback(0.1, 0.01))  # nothing here answers to torques
    stepper = Stepper(robot, weak, StepperSettings(safety=Safety(), period=h, observer=60.0, check_gains=False))
    seen = []
    for k in range(400):
        t = k * h
        q = 0.0015 * np.round(np.array([speed * t, -speed * t]) / 0.0015)
        v = 2.0 * speed * (k % 2)  # every other message says twice the velocity
        pose = np.array([speed * t, 0.0, 0.0])
        stepper.step(t, Measurement(pose, np.array([v, 0.0]), q, np.zeros(2)), None)
        seen.append(np.concatenate((stepper.measured.velocity, stepper.measured.qdot, stepper.measured.q)))
    late = np.array(seen)[300:]
    np.testing.assert_allclose(late[:, 0].mean(), speed, atol=0.02)
    assert np.abs(late[:, 2:4] - [speed, -speed]).max() < 0.1
    truth = np.outer(h * np.arange(300, 400), [speed, -speed])
    assert np.abs(late[:, 4:] - truth).max() < 0.0015
    with pytest.raises(ConfigError, match=r"observer: error: "):
        Stepper(robot, weak, StepperSettings(safety=Safety(), period=h, observer=-1.0))
