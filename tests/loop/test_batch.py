"""Batches: every run is the run it would have been alone, whatever its neighbours do; and robots with other masses."""

from __future__ import annotations

import threading
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import config
from robots import fixed_arm, mobile_arm

from mmnn_pin import (
    PD,
    Circle,
    Feedback,
    Hold,
    Line,
    Loop,
    Neural,
    Robot,
    Sine,
    Timing,
    TorqueController,
    Trajectory,
    load,
)
from mmnn_pin.errors import ConfigError, TrajectoryError, UnknownName
from mmnn_pin.loop import batch
from mmnn_pin.loop.batch import BatchRun, simulate_many
from mmnn_pin.loop.before_run import Bounds, Start
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.recording.metrics import metrics
from mmnn_pin.signals import Layout
from mmnn_pin.torque.controller import ControllerState
from mmnn_pin.torque.model_based import ComputedTorque
from mmnn_pin.torque.one_layer import OneLayer
from mmnn_pin.torque.two_layer import TwoLayer

ROBOT = load("platform_arm")
GAINS = Feedback(base=500.0, arm=10.0)
DURATION = 0.04 if config.DISABLE_JIT else 0.3  # [s]
TIMING = Timing(duration=DURATION)
WINDOWS = ((0.0, DURATION / 4), (DURATION / 2, DURATION))
LINE = Trajectory(Line(0.3), (Sine(0.5, 2.0), Hold(0.4)))
TURN = Trajectory(Circle(1.0, 0.4), (Hold(0.2), Sine(0.3, 1.0)))
BASIC = Loop(ROBOT, LINE, Neural(TwoLayer(), GAINS), timing=TIMING, weights_interval=0.01)


class Mine(TorqueController):
    """PD in plain Python that counts its samples."""

    name = "mine"

    def init(self, context):
        return {"count": np.zeros(1)}

    def step(self, time, reference, measurement, command, state):
        state["count"] += 1
        return GAINS.vector(ROBOT.dimensions) * np.concatenate((command.z, command.r))

    def weights(self, state):
        return state


def trained(seed: int) -> ControllerState:
    """Memory with weights as after some training."""
    state = BASIC.state_from()
    state.values += np.random.default_rng(seed).normal(0.0, 0.1, state.values.size)
    return state


def different() -> tuple[list[Loop], list[ControllerState | None]]:
    """Runs that differ in all that a run may differ in; the last two diverge and run in plain Python."""
    arm = Loop(
        load("two_axis_arm"), Trajectory(None, (Sine(0.3, 2.0), Hold(0.1))), PD(Feedback(arm=1.0)), timing=TIMING
    )
    loops = {
        "basic": (BASIC, None),
        "masses": (replace(BASIC, robot=ROBOT.with_masses({"root": 1.5, "arm_2_joint": 0.5})), None),
        "friction": (replace(BASIC, robot=ROBOT.with_friction([20.0, 3.0, 0.5, 0.4])), None),
        "gains": (replace(BASIC, controller=Neural(TwoLayer(), Feedback(base=200.0, arm=(4.0, 3.0)))), None),
        "seed": (replace(BASIC, seed=5), None),
        "reference": (replace(BASIC, trajectory=TURN), None),
        "start": (replace(BASIC, start=Start(pose_offset=(-0.05, 0.02, 0.1), joint_offset=(0.1, -0.1))), None),
        "weights": (BASIC, trained(1)),
        "nominal": (replace(BASIC, controller=ComputedTorque(GAINS), nominal=ROBOT.with_masses(0.6)), None),
        "network": (replace(BASIC, controller=Neural(OneLayer(), GAINS), seed=3), None),
        "arm": (arm, None),
        "diverges": (
            replace(BASIC, controller=PD(Feedback(base=500.0, arm=500.0)), bounds=Bounds(joint_speed=3.0)),
            None,
        ),
        "python": (replace(BASIC, controller=Mine()), None),
    }
    return [loop for loop, _ in loops.values()], [state for _, state in loops.values()]


def alone(loop: Loop, state: ControllerState | None) -> BatchRun:
    recording = replace(loop, check_gains=False).run(state=state)
    return BatchRun(recording.outcome, metrics(recording, WINDOWS), recording.final, recording)


@pytest.fixture(scope="module")
def singles() -> list[BatchRun]:
    return [alone(loop, state) for loop, state in zip(*different(), strict=True)]


def assert_same_bits(run: BatchRun, single: BatchRun) -> None:
    ends = [(o.status, o.time, o.signal) for o in (run.outcome, single.outcome)]
    assert ends[0] == ends[1] and run.metrics.keys() == single.metrics.keys()
    np.testing.assert_array_equal(list(run.metrics.values()), list(single.metrics.values()))
    assert run.final.keys() == single.final.keys()
    for name, array in single.final.items():
        np.testing.assert_array_equal(run.final[name], array, err_msg=name)


# --- Every run is the run it would have been alone --------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, 2, 5, None])
def test_runs_of_a_batch_are_the_single_runs_bit_for_bit(singles, workers):
    loops, states = different()
    for run, single in zip(simulate_many(loops, states=states, windows=WINDOWS, workers=workers), singles, strict=True):
        assert_same_bits(run, single)
        assert run.recording is None


def test_the_runs_differ(singles):
    """Every parameter that is varied reaches its run."""
    basic = singles[0].metrics["energy_residual"], singles[0].final["nu"].tolist()
    for single in singles[1:]:
        assert (single.metrics["energy_residual"], single.final["nu"].tolist()) != basic


@settings(max_examples=2 if config.DISABLE_JIT else 6, deadline=None)
@given(order=st.permutations(range(13)), workers=st.integers(1, 4))
def test_order_and_workers_do_not_matter(singles, order, workers):
    loops, states = different()
    runs = simulate_many([loops[i] for i in order], states=[states[i] for i in order], windows=WINDOWS, workers=workers)
    for i, run in zip(order, runs, strict=True):
        assert_same_bits(run, singles[i])


def test_states_given_are_not_touched():
    state = trained(2)
    before = state.values.copy()
    simulate_many([BASIC, BASIC], states=[state, state], workers=2)
    np.testing.assert_array_equal(state.values, before)


def test_recordings_are_kept_where_asked_for(singles):
    loops, states = different()
    for run, single in zip(simulate_many(loops, states=states, windows=WINDOWS, keep=True), singles, strict=True):
        kept, wanted = run.recording, single.recording
        assert_same_bits(run, single)
        assert kept.names == wanted.names and len(kept) == len(wanted)
        assert {**kept.meta, "created": 0} == {**wanted.meta, "created": 0} and kept.urdf == wanted.urdf
        for name in wanted.names:
            np.testing.assert_array_equal(kept[name], wanted[name])
        assert kept.weights.keys() == wanted.weights.keys()
        for name, array in wanted.weights.items():
            np.testing.assert_array_equal(kept.weights[name], array)


def test_windows_are_honoured(singles):
    run = simulate_many([BASIC], windows=((0.01, 0.02), (100.0, 200.0)))[0]
    recording = singles[0].recording
    inside = (recording.time >= 0.01) & (recording.time < 0.02)
    assert run.metrics["z.v.rms_0.01_0.02"] == pytest.approx(
        np.sqrt(np.mean(recording["z"][inside, 0] ** 2)), rel=1e-12
    )
    assert np.isnan(run.metrics["z.v.rms_100_200"]) and not any("rms_0_1" in name for name in run.metrics)


def test_a_run_that_diverges_is_a_result_with_numbers():
    wild = replace(BASIC, controller=PD(Feedback(base=500.0, arm=500.0)), bounds=Bounds(joint_speed=3.0))
    runs = simulate_many([BASIC, wild, BASIC], windows=[(0.0, 0.002)])
    assert [run.outcome.status for run in runs] == ["completed", "diverged", "completed"]
    assert runs[1].outcome.signal in ("nu[2]", "nu[3]") and 0 < runs[1].outcome.time < DURATION
    assert np.isfinite(list(runs[1].metrics.values())).all() and np.isfinite(runs[1].final["nu"]).all()
    assert_same_bits(runs[0], runs[2])


def test_python_controllers_run_beside_compiled_ones():
    runs = simulate_many([replace(BASIC, controller=Mine()), BASIC], keep=True, workers=2)
    assert [run.recording.meta["loop"] for run in runs] == ["ordinary", "compiled"]
    assert runs[0].recording.weights["count"][-1] == TIMING.samples


@pytest.mark.parametrize("keep", [("z", "e"), ["slip"], "z"])
def test_signals_kept_by_name_are_those_of_the_whole_recording(keep):
    loops, states = different()
    named = simulate_many(loops, states=states, keep=keep, workers=2)
    for run, whole in zip(named, simulate_many(loops, states=states, keep=True), strict=True):
        names = ("time", *[name for name in ([keep] if isinstance(keep, str) else keep) if name in whole.recording])
        assert run.recording.names == names
        for name in names:
            np.testing.assert_array_equal(run.recording[name], whole.recording[name])
        assert run.metrics == pytest.approx(whole.metrics, rel=0, abs=0, nan_ok=True)
        assert run.outcome == whole.outcome and len(run.recording) == len(whole.recording)


# --- Bad input, refused before anything runs --------------------------------------------------------------------------


@pytest.fixture
def nothing_runs(monkeypatch):
    def begun(*arguments):
        raise AssertionError("something ran")

    monkeypatch.setattr(batch, "simulate", begun)


def wrong_size() -> ControllerState:
    state = BASIC.state_from()
    return ControllerState(state.values[:-3], state.shapes)


def not_finite() -> ControllerState:
    state = BASIC.state_from()
    state.values[4] = np.nan
    return state


@pytest.mark.usefixtures("nothing_runs")
@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"loops": []}, "no runs"),
        ({"workers": 0}, "0 workers"),
        ({"workers": -2}, "-2 workers"),
        ({"states": [None]}, "1 states for 2 runs"),
        ({"states": [None, wrong_size()]}, r"states\[1\].*shape"),
        ({"states": [not_finite(), None]}, r"states\[0\].*not finite"),
        ({"states": [None, Neural(TwoLayer(hidden=3)).init(BASIC.context())]}, r"states\[1\].*two_layer.*22.*3"),
        ({"states": [None, np.zeros(5)]}, r"states\[1\].*ndarray"),
        ({"states": [PD().init(BASIC.context()), None]}, r"states\[0\].*two_layer"),
    ],
)
def test_bad_arguments_are_refused_before_anything_runs(arguments, text):
    with pytest.raises(ConfigError, match=text):
        simulate_many(**{"loops": [BASIC, BASIC]} | arguments)


@pytest.mark.usefixtures("nothing_runs")
def test_a_signal_to_keep_that_does_not_exist_is_refused():
    with pytest.raises(UnknownName, match="unknown signal 'zz'"):
        simulate_many([BASIC], keep=("e", "zz"))


@pytest.mark.usefixtures("nothing_runs")
def test_more_memory_than_the_machine_has_is_refused_with_both_numbers():
    endless = replace(BASIC, timing=Timing(duration=1e5))
    with pytest.raises(ConfigError, match=r"need \d[\d.e+]* GiB, \d[\d.e+]* GiB are free"):
        simulate_many([endless] * 100, keep=True)


@pytest.mark.usefixtures("nothing_runs")
def test_memory_is_counted_per_run_kept_and_per_worker_otherwise(monkeypatch):
    size = 8 * TIMING.samples * Layout.of(ROBOT.dimensions).width
    monkeypatch.setattr(batch, "free_bytes", lambda: 6 * size)
    light = replace(BASIC, controller=PD(GAINS))  # no weights
    named = 5 * Layout.of(ROBOT.dimensions).width // (1 + 2 * ROBOT.dimensions.dof)
    for keep, runs, workers, fits in (
        (True, 5, 1, True),
        (True, 6, 1, False),
        (("nu", "psi"), named, 1, True),
        (("nu", "psi"), named + 1, 1, False),
        (False, 50, 6, True),
        (False, 50, 7, False),
    ):
        with pytest.raises(AssertionError if fits else ConfigError):
            simulate_many([light] * runs, keep=keep, workers=workers)


@pytest.mark.usefixtures("nothing_runs")
def test_memory_of_recorded_weights_is_counted(monkeypatch):
    light, heavy = replace(BASIC, controller=PD(GAINS)), replace(BASIC, weights_interval=0.002)
    monkeypatch.setattr(batch, "free_bytes", lambda: batch.needed_bytes([light], True, 1))
    simulations = pytest.raises(AssertionError, match="something ran")
    with simulations:
        simulate_many([light], keep=True, workers=1)
    with pytest.raises(ConfigError, match="GiB"):
        simulate_many([heavy], keep=True, workers=1)
    recording = heavy.run()
    held = sum(array.size for array in recording.weights.values())
    assert held == pytest.approx(batch.recorded_weights(heavy), rel=0.2)


def test_free_memory_is_some_of_the_machines():
    assert 2**20 < batch.free_bytes() < 2**50


@pytest.mark.parametrize(
    ("bad", "error", "text"),
    [
        (
            replace(BASIC, controller=PD(Feedback(base=500.0, arm=(1.0, 2.0, 3.0)))),
            ConfigError,
            "3 numbers for 2 velocities",
        ),
        (replace(BASIC, trajectory=Trajectory(Line(0.3), (Hold(0.0),))), TrajectoryError, "1 arm profiles"),
        (replace(BASIC, start=Start(joint_offset=(0.1, 0.1, 0.1))), ConfigError, "3 numbers for 2 joints"),
        (replace(BASIC, controller=Mine(), engine="compiled"), ConfigError, "plain Python"),
        (replace(BASIC, controller=ComputedTorque(GAINS), nominal=load("two_axis_arm")), ConfigError, "nominal robot"),
    ],
)
@pytest.mark.parametrize("place", [0, 2])
def test_an_input_error_of_one_run_is_raised(bad, error, text, place):
    loops = [BASIC] * 5
    loops[place] = bad
    with pytest.raises(error, match=rf"loops\[{place}\].*{text}"):
        simulate_many(loops, workers=2)
    assert not pool_threads()


@pytest.mark.skipif(config.DISABLE_JIT, reason="the horizon is too short")
def test_a_network_that_ends_at_rank_one_is_told_as_in_a_single_run():
    zero = replace(BASIC, controller=Neural(TwoLayer(initial="zero"), GAINS))
    message = simulate_many([zero])[0].outcome.message
    assert "rank one" in message and message == zero.run().outcome.message


# --- Progress and Ctrl-C ----------------------------------------------------------------------------------------------


def pool_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("ThreadPoolExecutor")]


@pytest.mark.parametrize("count", [1, 6])
def test_progress_counts_up_to_all(count):
    told = []
    simulate_many([BASIC] * count, workers=2, progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (count, count) and {total for _, total in told} == {count}
    assert all(before < after for (before, _), (after, _) in pairwise(told))


def stop_at(limit: int):
    def progress(done: int, total: int) -> None:
        if done >= limit:
            raise KeyboardInterrupt

    return progress


@pytest.mark.parametrize("limit", [1, 3])
def test_ctrl_c_gives_back_what_is_done(limit):
    longer = replace(BASIC, timing=Timing(duration=20 * DURATION))
    loops = [BASIC] * 3 + [longer] * 30
    runs = simulate_many(loops, workers=2, progress=stop_at(limit))
    assert not pool_threads() and len(runs) == 33
    done = [run for run in runs if run.outcome.status == "completed"]
    assert limit <= len(done) < 10
    assert_same_bits(runs[0], simulate_many([BASIC])[0])
    for run in runs:
        if not any(run is one for one in done):
            assert run.outcome.status == "interrupted"
            started = run.outcome.message != "not started"
            assert bool(run.metrics) == bool(run.final) == started and (run.outcome.time > 0) == started
    assert runs[-1].outcome.message == "not started"


def test_ctrl_c_in_the_first_run_ends_the_batch(monkeypatch):
    calls = []

    def interrupted(self, state):
        calls.append(0)
        raise KeyboardInterrupt

    monkeypatch.setattr(Neural, "weights", interrupted)
    runs = simulate_many([BASIC] * 4, workers=2)
    assert [run.outcome.status for run in runs] == ["interrupted"] * 4 and len(calls) == 1
    assert [run.outcome.message for run in runs[1:]] == ["not started"] * 3 and not pool_threads()


def test_an_error_in_progress_is_raised_and_ends_the_threads():
    def progress(done: int, total: int) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        simulate_many([BASIC] * 20, workers=2, progress=progress)
    assert not pool_threads()


# --- Other masses -----------------------------------------------------------------------------------------------------

ROBOTS = {"platform_arm": ROBOT, "mobile": mobile_arm(4, 1), "fixed": fixed_arm(4, 2)}
robots = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)


def mass_matrix(robot: Robot) -> np.ndarray:
    return Dynamics(robot).mass_matrix(np.random.default_rng(0).uniform(-1, 1, robot.dimensions.full))


@robots
def test_one_factor_scales_the_mass_matrix_and_gravity(robot):
    before, scaled = mass_matrix(robot), robot.with_masses(2.5)
    np.testing.assert_allclose(mass_matrix(scaled), 2.5 * before, rtol=1e-12)
    position = np.random.default_rng(0).uniform(-1, 1, robot.dimensions.full)
    gravity = [Dynamics(r).gravity(position) for r in (robot, scaled)]
    np.testing.assert_allclose(gravity[1], 2.5 * gravity[0], rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(scaled.damping, robot.damping)
    np.testing.assert_array_equal(mass_matrix(robot), before)  # the original is left alone


@robots
def test_factors_per_body_add_up(robot):
    """M is linear in the bodies: what each adds alone, all add together."""
    names, before = batch_bodies(robot), mass_matrix(robot)
    factors = dict(zip(names, np.random.default_rng(1).uniform(0.5, 2.0, len(names)), strict=True))
    alone = [mass_matrix(robot.with_masses({name: factor})) - before for name, factor in factors.items()]
    assert all(np.abs(change).max() > 0 for change in alone)
    np.testing.assert_allclose(mass_matrix(robot.with_masses(factors)), before + sum(alone), rtol=0, atol=1e-9)


def batch_bodies(robot: Robot) -> list[str]:
    """Joints that carry bodies, as `with_masses` lists them."""
    with pytest.raises(UnknownName) as error:
        robot.with_masses({"nobody": 2.0})
    return list(error.value.available)


def test_bodies_are_scaled_about_their_own_centres():
    body, other = (
        robot.model.inertias[robot.model.getJointId("arm_1_joint")]
        for robot in (ROBOT, ROBOT.with_masses({"arm_1_joint": 3.0}))
    )
    assert other.mass == pytest.approx(3 * body.mass)
    np.testing.assert_array_equal(other.lever, body.lever)
    np.testing.assert_allclose(other.inertia, 3 * body.inertia, rtol=1e-14)


def test_unknown_bodies_are_refused_with_those_there_are():
    with pytest.raises(UnknownName, match="did you mean 'arm_1_joint'") as error:
        ROBOT.with_masses({"arm_1": 2.0})
    assert set(error.value.available) == {"root", *ROBOT.actuator_names}


@pytest.mark.parametrize("factor", [0.0, -1.0, np.nan, np.inf])
def test_bad_factors_are_refused(factor):
    for factors in (factor, {"root": factor}):
        with pytest.raises(ConfigError, match=f"factor {factor} for the mass at 'root'"):
            ROBOT.with_masses(factors)


def test_other_masses_move_otherwise_in_both_engines():
    runs = [
        replace(BASIC, robot=robot, engine=engine).run()
        for robot in (ROBOT, ROBOT.with_masses(1.4))
        for engine in ("ordinary", "compiled")
    ]
    np.testing.assert_allclose(runs[2]["nu"], runs[3]["nu"], rtol=0, atol=1e-9)
    assert np.abs(runs[0]["nu"] - runs[2]["nu"]).max() > 1e-3
