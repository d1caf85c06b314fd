"""Friction features: that they say friction of joints that nobody fitted them on, and that a learner takes it in."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import strategies as st

from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import Context, ControllerState
from mmnn_pin.torque.filtered import Filtered, low_pass, new_filter, parts
from mmnn_pin.torque.friction_features import beside, follow, friction, shipped
from mmnn_pin.torque.linear import Linear, Parts, drift, heed, predict

motions = st.floats(-20.0, 20.0)
CONTEXT = Context(Layout(0, 1, 0, 1), 0.01, 1)


def test_features_pass_the_filter_of_the_torque() -> None:
    """Their means behind `x' = pole (u - x)`, u the mean of two samples, against many small steps of it."""
    layout, h, pole = CONTEXT.layout, CONTEXT.control_period, 60.0
    filter, f = new_filter(CONTEXT, 5.0, pole), friction()
    k = 3 + len(shipped()[1]) + 1
    seen = Filtered(**{name: np.zeros(shape) for name, shape in parts(CONTEXT, 1, k).items()})
    moved, rng, x, last = np.zeros((2, 4)), np.random.default_rng(1), np.zeros(4), np.zeros(4)
    at = layout.offsets
    for n in range(30):
        row, Phi = layout.new_row(), np.zeros((1, k))
        row[layout.where("qdot_ref")], row[layout.where("qddot_ref")] = rng.normal(size=2)
        beside(row, at, f, Phi)
        now = Phi[0, 3:7].copy()
        assert Phi[0, :3].tolist() == [0, 0, 0] and Phi[0, 7] == 1.0
        seen.clock[1] = n + 1.0
        follow(filter, seen, moved, Phi)
        if n:
            u, fine, means = 0.5 * (last + now), 2000, np.zeros(4)
            for _ in range(fine):
                half = x + 0.5 * h / fine * pole * (u - x)
                means += half / fine
                x = x + h / fine * pole * (u - half)
            assert Phi[0, 3:7] == pytest.approx(means, abs=1e-6)
        last = now
    seen.clock[1] = 1.0  # a period that follows no other begins anew
    follow(filter, seen, moved, Phi)
    assert (moved[1] == 0.0).all()


def relearned(alarm: float, jump: float = 5.0, period: float = 0.01) -> tuple[float, list[int]]:
    """Updates after which a parameter that has jumped stays known, and the updates at which a change was seen."""
    k, rng = 3, np.random.default_rng(0)
    own = {"W": (1, k), "U": (k, k), "D": (k,), "prior": (k,), "counts": (7,), "expected": (1,), "level": (1,)}
    state = ControllerState.of(
        **own, **parts(CONTEXT, 1, k), a=(0, 0), b=(0,), moved=(0, 0), w=(0,), when=(0,), asked=(0,), cut=(0,)
    )
    state["D"], state["prior"] = 100.0, 100.0
    o, f = state.view(Parts), new_filter(Context(CONTEXT.layout, period, 1), 5.0)
    sizes = {"noise": 0.01, "interval": period, "drift": 1e-9, "change": 0.0, "alarm": alarm, "gain": np.ones(1)}
    sizes |= {"work": np.zeros((4, k)), "Phi": np.zeros((1, k)), "filter": f, "carrying": np.array([1])}
    a, seen, found = Linear(**dict.fromkeys(Linear._fields) | sizes), [], 0.0  # type: ignore[arg-type]
    true = np.array([1.0, -2.0, 0.5])
    for n in range(4000):
        true[1] = -2.0 + (jump if n >= 1000 else 0.0)
        a.Phi[:] = rng.normal(size=(1, k))
        f.torque[:] = a.Phi @ true + 0.1 * rng.normal(size=1)
        low_pass(f, a.Phi, o.filtered)
        if alarm:
            heed(a, o)
        seen += [n] * int(o.counts[3])
        o.counts[6] = 1.0
        predict(a, o)
        if n >= 1000 and abs(o.W[0, 1] - true[1]) > 0.06 * abs(jump):
            found = n - 1000.0
    return found, seen


def test_what_a_robot_carries_is_learned_anew_when_that_changes() -> None:
    """Within a few updates, where without the alarm the past counts; what had been filtered is dropped as well."""
    found, seen = relearned(alarm=3.0)
    assert len(seen) == 1 and 1000 <= seen[0] < 1010 and found < 30
    assert relearned(alarm=0.0)[0] > 500


@pytest.mark.parametrize("period", [0.002, 0.01, 0.05, 1.0])
def test_noise_is_no_change_of_a_robot(period: float) -> None:
    assert relearned(alarm=3.0, jump=0.0, period=period)[1] == []


def test_variance_that_comes_back_stops_at_the_prior() -> None:
    k = 2
    o = Parts(np.zeros((1, k)), np.zeros((k, k)), np.array([1.0, 4.0]), np.full(k, 4.0), np.zeros(5), *[None] * 7)  # type: ignore[arg-type]
    a = Linear(**dict.fromkeys(Linear._fields) | {"work": np.zeros((4, k))})  # type: ignore[arg-type]
    for _ in range(5):
        drift(a, o, 0, 0.5)
        drift(a, o, 1, 0.5)
    assert pytest.approx([4.0, 4.0]) == o.D


@pytest.mark.compiled
def test_friction_that_no_regressor_has_is_learned() -> None:
    """Stribeck friction with presliding in the arm, which moves on as it was not trained: half of the error at most."""
    friction = "friction={base=[30.0,5.0],arm=0.5,coulomb=1.0,breakaway=1.6,stribeck=0.04}"
    settings = (friction, 'time.integrator="stick"', "time.duration=12.0", "windows=[[0.0,2.0],[6.0,12.0]]")
    experiment = load_experiment("track", (*settings, "reference.arm.period=3.0", "lead=true"))
    robot = experiment.load_robot()
    error = {}
    for name in ("kalman_regressor", "kalman_friction"):
        run = experiment.loop(robot, experiment.controller(name, robot=robot)).run()
        late = run["time"].ravel() > 6.0
        error[name] = np.sqrt((run["e"][late] ** 2).mean())
    assert error["kalman_friction"] < 0.5 * error["kalman_regressor"]


def late_error(*settings: str) -> float:
    """RMS error of the arm under `kalman_friction` in the last part of a run of `track` with sensors that are noisy."""
    noise = "sensor={pose_noise=[1e-4,1e-4,1e-4],noise=1e-4,velocity_noise=[1e-3,2e-3,5e-3,5e-3]}"
    common = ("time.duration=12.0", "time.control_period=0.002", "reference.arm.period=3.4", "lead=true", noise)
    experiment = load_experiment("track", (*common, "windows=[[0.0,2.0],[9.0,12.0]]", *settings))
    robot = experiment.load_robot()
    run = experiment.loop(robot, experiment.controller("kalman_friction", robot=robot)).run()
    return float(np.sqrt((run["true_e"][run["time"].ravel() > 9.0] ** 2).mean()))


@pytest.mark.compiled
def test_a_load_that_is_put_down_is_known_to_be_gone_at_once() -> None:
    load = 'disturbances=[{type="payload",mass=2.2,start=4.0,end=9.0,at=[0.33,0.05,0.02]}]'
    assert late_error(load) < 0.3 * late_error(load, "kalman.friction.alarm=0")


@pytest.mark.compiled
def test_just_after_a_change_every_sample_is_an_update() -> None:
    """Between two runs that differ in a load that is picked up: 0.5 s of updates every 2 ms in place of 10 ms."""
    updates = []
    for mass in (0.0, 2.2):
        load = f'disturbances=[{{type="payload",mass={mass},start=4.0,at=[0.33,0.05,0.02]}}]' if mass else "seed=1"
        experiment = load_experiment("track", ("time.duration=6.0", "time.control_period=0.002", "lead=true", load))
        robot = experiment.load_robot()
        own = experiment.loop(robot, experiment.controller("kalman_friction", robot=robot))
        state = own.controller.init(own.context())
        state.values[:] = own.run().final["controller_state"]
        updates.append(state["counts"][1])
    assert updates[1] - updates[0] == pytest.approx(0.5 / 0.002 - 0.5 / 0.01, abs=2)


@pytest.mark.compiled
def test_motors_whose_lag_is_known_are_learned_as_those_that_have_none() -> None:
    """Equations with the torque that was asked for are wrong by as much as the motors lag."""
    assert late_error("actuator.lag=0.01") < 1.5 * late_error()
