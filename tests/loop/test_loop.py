"""The closed loop: who sees what and when, how runs end, and that learning and models do what they are for."""

from __future__ import annotations

from dataclasses import fields

import h5py
import numpy as np
import pytest
from builders import with_gains
from numba import config

from mmnn_pin import (
    PD,
    Feedback,
    Hold,
    Line,
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
from mmnn_pin.errors import ConfigError, InputError, RecordingError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.loop.before_run import Bounds, Start
from mmnn_pin.loop.suited import timing_for
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.loading import build
from mmnn_pin.model.urdf.reading import parse
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.signals import Measurement, Setpoint, VelocityCommand
from mmnn_pin.torque.model_based import ComputedTorque, ScheduledPD
from mmnn_pin.torque.one_layer import OneLayer
from mmnn_pin.torque.two_layer import TwoLayer

ROBOT = load("platform_arm").with_friction([30.0, 5.0, 0.5, 0.5])
ARM = load("two_axis_arm")
PATH = Trajectory(Line(0.3), (Sine(np.pi / 4, 4.0), Hold(np.pi / 4)))
SWING = Trajectory(None, (Sine(0.5, 4.0), Sine(0.5, 4.0)))
BEHIND = Start(pose_offset=(-0.01, 0.005, 0.02), joint_offset=0.03)
SHORT = 0.06 if config.DISABLE_JIT else 0.2  # [s]
LONG = 0.12 if config.DISABLE_JIT else 1.0  # [s]
SLOW = Feedback(base=500.0, arm=5.0)  # stable at a control period of 10 ms
engines = pytest.mark.parametrize("engine", ["ordinary", "compiled"])


def loop(controller=None, duration: float = SHORT, **more) -> Loop:
    timing = more.pop("timing", None) or Timing(duration=duration)
    settings = {"robot": ROBOT, "trajectory": PATH, "start": BEHIND} | more
    return Loop(controller=with_gains(controller or PD()), timing=timing, **settings)


class Mine(TorqueController):
    """PD of a user's own, which keeps what it was shown."""

    name = "mine"

    def __init__(self, gains=(500.0, 500.0, 30.0, 30.0)) -> None:
        self.gains = np.array(gains)
        self.seen: list[dict[str, np.ndarray]] = []

    def torque(self, time, command):
        return self.gains * np.concatenate((command.z, command.r))

    def step(self, time, reference, measurement, command, state):
        assert (type(reference), type(measurement), type(command)) == (Setpoint, Measurement, VelocityCommand)
        self.seen.append({f.name: getattr(measurement, f.name).copy() for f in fields(measurement)})
        return self.torque(time, command)

    def saw(self, name: str) -> np.ndarray:
        return np.array([sample[name] for sample in self.seen])


def rms(recording: Recording, *names: str, after: float = 0.0) -> float:
    late = recording.time >= after
    return float(np.sqrt(sum(np.mean(np.sum(recording[name][late] ** 2, axis=1)) for name in names)))


def plant_states(recording: Recording, robot: Robot, timing: Timing) -> tuple[np.ndarray, np.ndarray]:
    """Position and nu at every plant step, from the recorded start and torques alone."""
    plant = IdealPlant(robot, timing.plant_step, timing_for(robot, timing).integrator)
    plant.start(recording["position"][0], recording["nu"][0])
    position, nu = [], []
    for torque in recording["torque"]:
        for _ in range(timing.steps_per_control):
            position.append(plant.position.copy())
            nu.append(plant.nu.copy())
            plant.step(torque)
            plant.refresh()
    return np.array(position), np.array(nu)


# --- Time -------------------------------------------------------------------------------------------------------------


@engines
@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit_euler"])
def test_torque_is_held_over_the_control_period(engine, integrator):
    timing = Timing(duration=SHORT, control_period=0.01, plant_step=0.001, integrator=integrator)
    run = loop(PD(SLOW), timing=timing, engine=engine).run()
    position, nu = plant_states(run, ROBOT, timing)
    assert len(run) == round(SHORT / 0.01) and run.meta["loop"].startswith(engine)
    np.testing.assert_allclose(run.time, 0.01 * np.arange(len(run)), rtol=1e-14)
    np.testing.assert_allclose(run["position"], position[::10], rtol=0, atol=1e-10)
    np.testing.assert_allclose(run["nu"], nu[::10], rtol=0, atol=1e-9)
    assert np.all(np.abs(np.diff(run["torque"], axis=0)).max(axis=0) > 1e-3)


@engines
@pytest.mark.parametrize("sensor_period", [None, 0.001, 0.002, 0.003, 0.008, 0.009])
def test_measurement_is_held_over_the_sensor_period(engine, sensor_period):
    timing = Timing(duration=SHORT, control_period=0.002, plant_step=0.001, sensor_period=sensor_period)
    run = loop(PD(SLOW), timing=timing, engine=engine).run()
    position, nu = plant_states(run, ROBOT, timing)
    step = 2 * np.arange(len(run))
    measured = step - step % round(1000 * (sensor_period or 0.002))
    for name, wanted in (
        ("pose", position[measured, :3]),
        ("q", position[measured][:, ROBOT.arm_index]),
        ("velocity", nu[measured, :2]),
        ("qdot", nu[measured, 2:]),
    ):
        np.testing.assert_allclose(run[name], wanted, rtol=0, atol=1e-9)
    is_late = bool((measured < step).any())
    assert is_late == (np.abs(run["velocity"] - run["nu"][:, :2]).max() > 1e-4)


def test_control_slower_than_the_plant_is_another_motion():
    fast, slow = (loop(PD(SLOW), timing=Timing(duration=SHORT, control_period=h)).run() for h in (0.002, 0.01))
    assert len(fast) == 5 * len(slow)
    assert np.abs(fast["nu"][::5] - slow["nu"]).max() > 1e-3


# --- A row ------------------------------------------------------------------------------------------------------------


@engines
@pytest.mark.parametrize(
    "controller",
    [PD(SLOW), ComputedTorque(SLOW), Neural(TwoLayer(), SLOW), Neural(OneLayer(), SLOW)],
    ids=lambda controller: controller.name,
)
def test_signals_of_a_row_belong_together(controller, engine):
    closed = loop(controller, engine=engine, timing=Timing(duration=SHORT, sensor_period=0.006))
    run, K = closed.run(), Kinematic().K
    assert run.outcome.status == "completed"
    np.testing.assert_allclose(run["z"], run["alpha"] - run["velocity"], atol=1e-14)
    np.testing.assert_allclose(run["e"], run["q_ref"] - run["q"], atol=1e-14)
    np.testing.assert_allclose(run["edot"], run["qdot_ref"] - run["qdot"], atol=1e-14)
    np.testing.assert_allclose(run["r"], run["edot"] + K * run["e"], atol=1e-13)
    np.testing.assert_allclose(run["nu_ref"], np.hstack((run["alpha"], run["qdot_ref"] + K * run["e"])), atol=1e-13)
    nudot_ref = np.hstack((run["alphadot"], run["qddot_ref"] + K * run["edot"]))
    np.testing.assert_allclose(run["nudot_ref"], nudot_ref, atol=1e-12)
    s = np.hstack((run["z"], run["r"]))
    np.testing.assert_allclose(run["torque"], run["effective_gain"] * s + run["psi_hat"], atol=1e-9)
    np.testing.assert_allclose(run["motor_torque"] @ ROBOT.E.T, run["torque"], atol=1e-9)
    dynamics = Dynamics(ROBOT)
    for k in range(0, len(run), 10):
        position, nu = run["position"][k], run["nu"][k]
        psi = dynamics.psi(position, nu, run["nu_ref"][k], run["nudot_ref"][k])
        np.testing.assert_allclose(run["psi"][k], psi, rtol=1e-9, atol=1e-9)
        kinetic = dynamics.energy(position, nu) - dynamics.energy(position, 0 * nu)
        assert run["energy"][k] == pytest.approx(kinetic, abs=1e-9)  # this robot does not feel gravity
    balance = run["energy"] - run["energy"][0] - run["work"]
    np.testing.assert_allclose(run["energy_residual"], balance, atol=1e-12)
    table = np.hstack([run[n] for n in ("pose_ref", "velocity_ref", "acceleration_ref", "q_ref", "qdot_ref")])
    np.testing.assert_allclose(table, closed.table()[:, : table.shape[1]], atol=1e-14)


@engines
def test_energy_balance_closes_and_better_with_a_shorter_step(engine):
    residuals = {}
    for integrator, dt in (("rk4", 0.002), ("rk4", 0.0005), ("semi_implicit_euler", 0.002)):
        timing = Timing(duration=SHORT, control_period=0.002, plant_step=dt, integrator=integrator)
        run = loop(timing=timing, engine=engine).run()
        residuals[integrator, dt] = np.abs(run["energy_residual"]).max()
        assert np.abs(run["work"]).max() > 1e-3
    assert residuals["rk4", 0.002] < 1e-6 and residuals["rk4", 0.0005] < 1e-2 * residuals["rk4", 0.002]
    assert residuals["semi_implicit_euler", 0.002] > 100 * residuals["rk4", 0.002]


@engines
def test_start_is_relative_to_the_reference_and_may_move(engine):
    run = loop(engine=engine, start=Start(pose_offset=(-0.01, 0.005, 0.02), joint_offset=0.03, moving=True)).run()
    np.testing.assert_allclose(run["position"][0, :3], [-0.01, 0.005, 0.02])
    np.testing.assert_allclose(run["e"][0], [-0.03, -0.03])
    np.testing.assert_allclose(run["nu"][0], [0.3, 0.0, np.pi / 4 * np.pi / 2, 0.0])


# --- What a controller sees -------------------------------------------------------------------------------------------


def test_controller_sees_the_measurement_and_not_the_state():
    mine = Mine()
    run = loop(mine, timing=Timing(duration=SHORT, sensor_period=0.01)).run()
    for name in ("pose", "velocity", "q", "qdot"):
        np.testing.assert_array_equal(mine.saw(name), run[name])
    assert np.abs(mine.saw("velocity") - run["nu"][:, :2]).max() > 1e-3  # stale: it contradicts the state
    assert np.abs(mine.saw("q") - run["position"][:, ROBOT.arm_index]).max() > 1e-4
    shown = {f.name + record.suffix for record in (Setpoint, Measurement, VelocityCommand) for f in fields(record)}
    assert not shown & {"position", "nu", "psi", "energy"}


@engines
def test_model_based_controller_computes_with_what_is_measured(engine):
    fresh, stale = (
        loop(ComputedTorque(SLOW), engine=engine, timing=Timing(duration=SHORT, sensor_period=period)).run()
        for period in (None, 0.01)
    )
    np.testing.assert_allclose(fresh["psi_hat"], fresh["psi"], rtol=1e-9, atol=1e-9)
    assert np.abs(stale["psi_hat"] - stale["psi"]).max() > 0.01
    k = 3  # three samples after a measurement
    nu = np.concatenate((stale["velocity"][k], stale["qdot"][k]))
    position = stale["position"][k].copy()
    position[:3], position[ROBOT.arm_index] = stale["pose"][k], stale["q"][k]
    psi = Dynamics(ROBOT).psi(position, nu, stale["nu_ref"][k], stale["nudot_ref"][k])
    np.testing.assert_allclose(stale["psi_hat"][k], psi, rtol=1e-9, atol=1e-9)


@engines
def test_python_controller_equals_the_compiled_one(engine):
    mine, ours = loop(Mine()).run(), loop(PD(), engine=engine).run()
    assert mine.meta["controller"] == "mine" and "ordinary" in mine.meta["loop"]
    tolerance = 1e-12 if engine == "ordinary" else 1e-9
    for name in ("position", "nu", "torque", "motor_torque", "psi"):
        np.testing.assert_allclose(mine[name], ours[name], rtol=0, atol=tolerance)


def test_python_controller_cannot_be_compiled():
    with pytest.raises(ConfigError, match="plain Python"):
        loop(Mine(), engine="compiled").run()


def test_engines_agree_on_every_signal():
    runs = [loop(Neural(), engine=engine).run() for engine in ("ordinary", "compiled")]
    for name in runs[0].names:
        scale = max(1.0, np.abs(runs[0][name]).max())
        np.testing.assert_allclose(runs[0][name], runs[1][name], rtol=0, atol=1e-8 * scale, err_msg=name)


class Counter(Mine):
    """Remembers how often it was called, and calls that its weights."""

    def init(self, context):
        return {"count": np.zeros(1)}

    def step(self, time, reference, measurement, command, state):
        state["count"] += 1
        return super().step(time, reference, measurement, command, state)

    def weights(self, state):
        return state


def test_python_controller_has_memory_and_weights_of_its_own():
    run = loop(Counter(), weights_interval=0.01).run()
    np.testing.assert_allclose(run.weights["time"], 0.01 * np.arange(len(run) // 5 + 1), atol=1e-12)
    np.testing.assert_array_equal(run.weights["count"][:, 0], 5 * np.arange(len(run) // 5 + 1))


# --- Learning and models do what they are for -------------------------------------------------------------------------


@engines
def test_learning_lowers_the_error_and_the_same_network_without_learning_does_not(engine):
    pd, learning, idle = (
        loop(controller, LONG, engine=engine).run()
        for controller in (PD(), Neural(robust=None), Neural(robust=None, learning=False))
    )
    half = LONG / 2
    assert rms(learning, "r", after=half) < 0.9 * rms(pd, "r", after=half)
    assert rms(learning, "z", after=half) < rms(pd, "z", after=half)
    np.testing.assert_allclose(idle["nu"], pd["nu"], rtol=0, atol=1e-12)  # W = 0: exactly PD


def test_learner_beats_pd_at_its_own_effective_gain():
    learning = loop(Neural(), LONG).run()
    matched = loop(ScheduledPD(learning["effective_gain"]), LONG, check_gains=False).run()
    np.testing.assert_array_equal(matched["effective_gain"], learning["effective_gain"])
    assert matched["effective_gain"].min() > 30.0 and np.ptp(matched["effective_gain"]) > 0
    assert rms(learning, "r", after=LONG / 2) < 0.9 * rms(matched, "r", after=LONG / 2)


@engines
def test_computed_torque_tracks_best_and_wrong_masses_cost(engine):
    wrong = build(parse(ROBOT.urdf.replace('<mass value="4.0"/>', '<mass value="12.0"/>').encode(), "r.urdf"))
    assert sum(body.mass for body in wrong.model.inertias) == pytest.approx(112 + 2 * 8)
    oracle, mismatched, learning, pd = (
        loop(controller, LONG, engine=engine, nominal=nominal, start=Start(moving=True)).run()
        for controller, nominal in (
            (ComputedTorque(), None),
            (ComputedTorque(), wrong),
            (Neural(robust=None), None),
            (PD(), None),
        )
    )
    half = LONG / 2
    assert rms(oracle, "z", "r", after=half) < 0.7 * min(rms(run, "z", "r", after=half) for run in (learning, pd))
    assert np.abs(mismatched["psi_hat"] - mismatched["psi"]).max() > 1.0
    np.testing.assert_allclose(oracle["psi_hat"], oracle["psi"], rtol=1e-9, atol=1e-9)
    assert rms(mismatched, "r", after=half) > 1.5 * rms(oracle, "r", after=half)


# --- Randomness and resuming ------------------------------------------------------------------------------------------


def datasets(path) -> dict:
    """Everything in a file but how long its steps took and when it was made."""
    found: dict = {}
    with h5py.File(path) as file:
        file.visititems(lambda name, item: found.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None)
        found |= {f"@{name}": value for name, value in file.attrs.items() if name != "created"}
    return {name: same_bits(np.asarray(value)) for name, value in found.items() if not name.startswith("timing")}


def same_bits(value: np.ndarray):
    """Bytes of numbers; texts as they are."""
    return value.tolist() if value.dtype == object else value.tobytes()


@engines
def test_equal_seeds_are_equal_on_disk_and_others_are_not(tmp_path, engine):
    files = []
    for i, seed in enumerate((3, 3, 4)):
        loop(Neural(), seed=seed, engine=engine).run(tmp_path / f"{i}.h5")
        files.append(datasets(tmp_path / f"{i}.h5"))
    one, same, other = files
    assert len(one) > 30 and one == same
    assert one["signals/torque"] != other["signals/torque"] and one["weights/V1"] != other["weights/V1"]


@engines
def test_run_in_two_halves_is_the_run(engine):
    whole = loop(Neural(), engine=engine)
    first = loop(Neural(), SHORT / 2, engine=engine).run()
    state = whole.controller.init(whole.context())
    state.values[:] = first.final["controller_state"]
    before = state.values.copy()
    plant_state = first.final["position"], first.final["nu"]
    second, run = whole.run(state=state, plant_state=plant_state, first=len(first)), whole.run()
    assert len(first) + len(second) == len(run)
    for name in ("time", "position", "nu", "torque", "psi_hat"):
        np.testing.assert_array_equal(np.concatenate((first[name], second[name])), run[name])
    np.testing.assert_array_equal(state.values, before)  # the caller's snapshot is left alone
    fresh = whole.run(plant_state=plant_state, first=len(first))
    assert np.abs(fresh["psi_hat"] - second["psi_hat"]).max() > 1e-3


@pytest.mark.parametrize(("key", "nominal", "arguments"), [
    ("nominal", ARM, {}),
    ("plant_state", None, {"plant_state": (np.full(7, np.nan), np.zeros(4))}),
    ("plant_state", None, {"plant_state": (np.zeros(7), np.zeros(5))}),
    ("state", None, {"state": PD().init(loop().context())}),
    ("first", None, {"first": 10_000}),
    ("first", None, {"first": 1}),
])  # fmt: skip
def test_starts_that_do_not_fit_are_refused_before_a_file_is_written(tmp_path, key, nominal, arguments):
    closed = loop(Neural(), timing=Timing(duration=SHORT, sensor_period=0.004), nominal=nominal)
    with pytest.raises(ConfigError) as error:
        closed.run(tmp_path / "run.h5", **arguments)
    assert error.value.key == key and not any(tmp_path.iterdir())


@engines
def test_weights_are_recorded_at_intervals_and_at_the_end(tmp_path, engine):
    run = loop(Neural(), weights_interval=0.02, engine=engine).run(tmp_path / "run.h5")
    assert set(run.weights) == {"time", "W1", "V1", "W2", "V2"}
    wanted = np.append(np.arange(0.0, SHORT - 1e-9, 0.02), SHORT)
    np.testing.assert_allclose(run.weights["time"], wanted, atol=1e-12)
    assert not run.weights["W2"][0].any()
    steps = np.abs(np.diff(run.weights["W2"], axis=0)).max(axis=(1, 2))
    assert np.all(steps > 0)
    state = Neural().init(loop(Neural()).context())
    state.values[:] = run.final["controller_state"]
    np.testing.assert_array_equal(run.weights["V2"][-1], state["V2"])
    norms = np.sqrt((run.weights["W2"][:-1] ** 2).sum((1, 2)) + (run.weights["V2"][:-1] ** 2).sum((1, 2)))
    at = np.round(run.weights["time"][:-1] / 0.002).astype(int)
    np.testing.assert_allclose(run["weight_norm"][at, 1], norms, rtol=1e-12)


# --- How runs end -----------------------------------------------------------------------------------------------------


@engines
def test_run_that_leaves_its_bounds_ends_at_once(tmp_path, engine):
    wild = loop(PD(Feedback(arm=130.0)), 2.0, engine=engine, check_gains=False, bounds=Bounds(joint_speed=5.0))
    run = wild.run(tmp_path / "run.h5")
    assert run.outcome.status == "diverged" and run.complete
    joint = {"nu[2]": "arm_1_joint", "nu[3]": "arm_2_joint"}[run.outcome.signal]
    assert run.outcome.message.startswith(f"nu of {joint} left its bounds (")
    assert 0 < run.outcome.time < 2.0
    nu = np.abs(run["nu"])
    assert run.time[-1] == pytest.approx(run.outcome.time)  # the sample that left is finite, so it is kept
    assert nu[-1, 2:].max() > 5.0 and np.all(nu[:-1, 2:] <= 5.0)


@engines
def test_run_that_blows_up_keeps_its_last_samples_and_no_nan(tmp_path, engine):
    # Unstable by little, so that there are more than 100 samples before the end.
    far = Bounds(speed=1e300, yaw_rate=1e300, joint_speed=1e300)
    settings = {"engine": engine, "check_gains": False, "bounds": far, "weights_interval": 0.01}
    run = loop(PD(Feedback(base=500.0, arm=300.0)), 20.0, **settings).run(tmp_path / "run.h5")
    assert run.outcome.status == "diverged" and run.outcome.signal
    assert "not finite" in run.outcome.message and f"t = {run.outcome.time:g} s" in run.outcome.message
    np.testing.assert_allclose(run.time, 0.002 * np.arange(len(run)), atol=1e-12)
    assert run.time[-1] == pytest.approx(run.outcome.time - 0.002)  # every sample before it
    assert all(np.isfinite(run[name]).all() for name in run.names)


def test_more_than_a_hundred_samples_before_a_divergence_are_kept():
    class Late(Mine):
        def torque(self, time, command):
            return super().torque(time, command) * (1e9 if time > 0.25 else 1.0)

    run = loop(Late(), 0.5).run()
    assert run.outcome.status == "diverged" and len(run) > 125
    np.testing.assert_allclose(run.time, 0.002 * np.arange(len(run)), atol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_bad_torque_of_a_users_controller_is_named(bad):
    class Broken(Mine):
        def torque(self, time, command):
            torque = super().torque(time, command)
            torque[2] = bad if time > 0.0195 else torque[2]
            return torque

    run = loop(Broken()).run()
    assert run.outcome.status == "diverged" and run.outcome.signal == "torque[2]"
    assert run.outcome.time == pytest.approx(0.02) and len(run) == 10
    assert np.isfinite(run["torque"]).all()


def stop_at(end: float):
    def progress(time: float) -> None:
        if time >= end:
            raise KeyboardInterrupt

    return progress


@engines
def test_ctrl_c_keeps_what_is_done(tmp_path, engine):
    run = loop(engine=engine, weights_interval=0.01).run(tmp_path / "run.h5", progress=stop_at(0.02))
    assert run.outcome.status == "interrupted" and run.complete and "Ctrl-C" in run.outcome.message
    assert run.outcome.time == pytest.approx(0.02)
    whole = loop(engine=engine).run()
    assert 0 < len(run) < len(whole)
    np.testing.assert_array_equal(run["nu"], whole["nu"][: len(run)])


class Stops(Mine):
    """Raises at a given sample."""

    def __init__(self, error: type[BaseException]) -> None:
        super().__init__()
        self.error = error

    def torque(self, time, command):
        if len(self.seen) == 8:
            raise self.error
        return super().torque(time, command)


def test_ctrl_c_in_the_middle_of_a_sample_keeps_those_before():
    run = loop(Stops(KeyboardInterrupt)).run()
    assert run.outcome.status == "interrupted" and len(run) == 7


def test_error_in_a_users_controller_is_raised_and_the_file_reads_as_incomplete(tmp_path):
    with pytest.raises(InputError, match=r"test_loop.py:\d+: error: controller 'mine' failed") as error:
        loop(Stops(ZeroDivisionError)).run(tmp_path / "run.h5")
    assert isinstance(error.value.__cause__, ZeroDivisionError)
    run = Recording.open(tmp_path / "run.h5")
    assert not run.complete and run.outcome.status == "interrupted" and len(run) == 7


def test_unstable_sampled_gains_are_refused_with_numbers_before_a_file_is_written(tmp_path):
    with pytest.raises(ConfigError, match=r"spectral radius \d") as error:
        loop(PD(Feedback(arm=3000.0))).run(tmp_path / "run.h5")
    assert "arm_2_joint: 3000 (limit alone" in str(error.value) and error.value.key == "feedback"
    assert not any(tmp_path.iterdir())
    assert loop(PD(Feedback(arm=3000.0)), check_gains=False).run().outcome.status == "diverged"


def test_existing_recording_is_left_alone_unless_forced(tmp_path):
    loop().run(tmp_path / "run.h5")
    with pytest.raises(RecordingError, match="exists"):
        loop().run(tmp_path / "run.h5")
    assert loop(seed=7).run(tmp_path / "run.h5", force=True).meta["seed"] == 7


# --- A fixed arm ------------------------------------------------------------------------------------------------------


@engines
@pytest.mark.parametrize("controller", [PD(Feedback(arm=1.0)), ComputedTorque(Feedback(arm=1.0))], ids=lambda c: c.name)
def test_fixed_arm_runs(controller, engine):
    start = Start(joint_offset=0.05, moving=True)
    run = loop(controller, LONG, robot=ARM, trajectory=SWING, start=start, engine=engine).run()
    assert run.outcome.status == "completed"
    assert "pose" not in run and "z" not in run and run.labels("nu") == ("arm_1_joint", "arm_2_joint")
    np.testing.assert_allclose(run["torque"], 1.0 * run["r"] + run["psi_hat"], atol=1e-12)
    assert np.abs(run["r"][-1]).max() < np.abs(run["r"][0]).max()


def test_fixed_arm_learns():
    fixed = {"robot": ARM, "trajectory": SWING, "start": Start(joint_offset=0.05)}
    network = TwoLayer(F=(0.02, 0.02), G=(0.02, 0.02))
    learning, pd = (
        loop(controller, LONG, **fixed).run()
        for controller in (Neural(network, Feedback(arm=1.0), robust=None), PD(Feedback(arm=1.0)))
    )
    assert set(learning.weights) == {"time", "W2", "V2"}
    assert rms(learning, "r", after=LONG / 2) < rms(pd, "r", after=LONG / 2)


def test_gains_are_judged_by_the_slower_of_control_and_sensor(tmp_path):
    timing = Timing(duration=SHORT, control_period=0.002, sensor_period=0.01)
    with pytest.raises(ConfigError, match=r"held for 0\.01 s.*arm_2_joint: 30"):
        loop(timing=timing).run(tmp_path / "run.h5")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("wrong", [0.0, [1.0, 2.0], np.zeros((1, 4))])
def test_a_torque_of_wrong_shape_is_refused(wrong):
    class Wrong(TorqueController):
        def step(self, time, reference, measurement, command, state):
            return wrong

    with pytest.raises(ConfigError, match=r"custom.*shape"):
        loop(Wrong()).run()
