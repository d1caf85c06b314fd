"""Chapter 5: marked values, two starts of one network, units, rotors, largest errors, and what its rig does."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import msgspec
import numba
import numpy as np
import pytest
from marks import leaves, marked

from mmnn_pin import Recording, load, load_experiment, run_experiment
from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError
from mmnn_pin.lab.experiments.cases import readings
from mmnn_pin.lab.experiments.config import bundled, read_toml
from mmnn_pin.lab.experiments.controllers import effective
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.result import Result, unfair
from mmnn_pin.lab.experiments.thesis import PRINTED, largest_errors, mean_ratio, ratios, thesis_ratios
from mmnn_pin.lab.psi.learner import recorded_learner
from mmnn_pin.lab.show import comparison
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.recording.recording import recorded_robot
from mmnn_pin.signals import Layout
from mmnn_pin.torque.neural import Inputs, Neural
from mmnn_pin.torque.two_layer import TwoLayer

FILE = bundled()["chapter5"]
LEARNERS = ("two_layer_zero", "two_layer_random", "one_layer")
DEGREES = 180 / np.pi
whole = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="runs of eight seconds, uncompiled")


def short(*settings: str, seconds: float = 0.1) -> Experiment:
    return load_experiment("chapter5", [f"time.duration={seconds}", f"windows=[[0.0, {seconds}]]", *settings])


@pytest.fixture(scope="module")
def result() -> Result:
    return run_experiment(short(seconds=0.03 if numba.config.DISABLE_JIT else 8.0), "chapter5")


def one(experiment: Experiment, name: str, **options: Any) -> Recording:
    robot = experiment.load_robot()
    return replace(experiment.loop(robot, experiment.controller(name)), **options).run()


# -- the file ----------------------------------------------------------------------------------------------------------


def test_every_value_carries_exactly_one_mark() -> None:
    assert sorted(marked(FILE)) == sorted(leaves(read_toml(FILE)))


def test_what_the_thesis_prints_stands_in_the_file() -> None:
    e = load_experiment("chapter5")
    t = np.arange(e.time.samples) * e.time.control_period
    robot = e.load_robot()
    reference = e.trajectory_of(robot).table(t, robot.dimensions)[:, :2]
    np.testing.assert_allclose(DEGREES * reference, np.outer(30 * np.sin(0.5 * np.pi * t), [1, 1]), atol=1e-12)
    assert (e.time.duration, e.time.control_period, robot.dimensions.base) == (8.0, 1 / 200, 0)
    assert (e.feedback.arm, e.kinematic.K, e.sensor.velocity) == (40.0, 10.0, "difference")
    two, net = e.two_layer, e.one_layer
    assert (two.hidden, two.F[1], two.G[1], two.kappa) == (10, 1.8, 1.0, 0.007)
    assert (net.beta[1], net.centre_range, net.width, net.hidden) == (1.0, 70.0, 70.0, 10)
    assert e.inputs.rows(Layout.of(robot.dimensions)).size == 10 and e.inputs.signals == (
        "e",
        "edot",
        "q_ref",
        "qdot_ref",
        "qddot_ref",
    )
    assert e.actuator.gap > 0 and e.friction.breakaway > 1 and e.time.integrator == "stick"
    for name in ("kinematic.K", "feedback.arm", "two_layer.F", "two_layer.kappa", "one_layer.width", "inputs.signals"):
        assert marked(FILE)[name][1] == "printed"


def test_all_learners_share_everything_but_the_network() -> None:
    e = load_experiment("chapter5")
    controllers = [e.controller(name) for name in LEARNERS]
    assert len({(c.feedback, c.robust, c.inputs, c.update, c.rates) for c in controllers}) == 1
    assert [c.name for c in controllers] == list(LEARNERS) and unfair(e, {name: {} for name in LEARNERS}) == ""
    text = msgspec.structs.replace(e, one_layer=msgspec.structs.replace(e.one_layer, hidden=9))
    assert "differ in size" in unfair(text, {name: {"effective_gain.arm": 1.0} for name in LEARNERS})


# -- two starts of one network -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("initial", ["zero", "random"])
def test_each_start_is_its_own_whatever_the_file_says(initial: str) -> None:
    e = short(f"two_layer.initial={initial}")
    zero, random, plain = (e.controller(name) for name in ("two_layer_zero", "two_layer_random", "two_layer"))
    assert isinstance(zero, Neural) and isinstance(random, Neural) and isinstance(plain, Neural)
    assert (zero.network.initial, random.network.initial, plain.network.initial) == ("zero", "random", initial)
    context = e.loop(e.load_robot(), zero).context()
    assert not zero.init(context)["V2"].any() and np.linalg.matrix_rank(random.init(context)["V2"]) == 10


def test_pd_effective_takes_the_gain_of_the_first_two_layer_network_that_is_run(result: Result) -> None:
    assert effective(["pd_effective", *LEARNERS])["pd_effective"] == "two_layer_zero"
    assert effective(["two_layer_random"])["pd_effective"] == "two_layer_random"
    assert effective(["two_layer_zero", "two_layer"])["pd_effective"] == effective([])["pd_effective"] == "two_layer"
    runs = result.recordings
    for pd, learner in (("pd_effective", "two_layer_zero"), ("pd_effective_one_layer", "one_layer")):
        assert np.array_equal(runs[pd]["effective_gain"], runs[learner]["effective_gain"])
    assert set(result.improvements()) == {"two_layer_zero", "one_layer"}


def test_readings_turn_switches_for_the_learners_of_the_experiment() -> None:
    assert all(set(r.recordings) == set(LEARNERS) for r in readings(short(seconds=0.02), "chapter5").values())


# -- units -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [DEGREES, 1.0])
def test_a_network_in_degrees_is_appendix_b_with_degrees_in_it(unit: float) -> None:
    """Line by line in NumPy: input in degrees, r times the unit, the torque that comes out divided by it."""
    e = short(f"inputs.error_scale={unit}", seconds=0.3)
    run = one(e, "two_layer_random")
    start = e.controller("two_layer_random").init(e.loop(e.load_robot(), e.controller("two_layer_random")).context())
    W, V, net = start["W2"].copy(), start["V2"].copy(), e.two_layer
    for k in range(len(run)):
        x = DEGREES * np.hstack([run[name][k] for name in e.inputs.signals])
        r = unit * run["r"][k]
        sigma = 1 / (1 + np.exp(-V.T @ x))
        np.testing.assert_allclose(run["psi_hat"][k], W.T @ sigma / unit, rtol=1e-7, atol=1e-9)
        slope, norm = np.diag(sigma * (1 - sigma)), np.linalg.norm(r)
        dW = net.F[1] * (np.outer(sigma, r) - slope @ V.T @ np.outer(x, r) - net.kappa * norm * W)
        dV = net.G[1] * (np.outer(x, slope.T @ W @ r) - net.kappa * norm * V)
        W, V = W + dW, V + dV
    assert np.abs(run["psi_hat"]).max() > 1.0


@pytest.mark.parametrize("value", [0.0, -1.0, np.inf])
def test_a_unit_is_a_positive_number(value: float) -> None:
    with pytest.raises(ConfigError, match="error_scale"):
        Inputs(error_scale=value)


def test_only_ratios_of_torque_inertia_and_friction_matter() -> None:
    """A drive that gives a tenth, on an arm of a tenth of the inertia, friction and stiffness: the same motion."""
    c, e = 0.1, short(seconds=0.5)
    f, a = e.friction, e.actuator
    scaled = {name: c * getattr(a, name) for name in ("rotor_inertia", "stiffness", "damping")}
    weak = msgspec.structs.replace(
        e,
        armature=c * e.armature,
        friction=msgspec.structs.replace(f, arm=c * f.arm, coulomb=tuple(c * x for x in f.coulomb)),
        actuator=msgspec.structs.replace(a, torque_gain=c, torque_limit=c * 40.0, **scaled),
    )
    robot = weak.load_robot().with_masses(c)
    for name in ("pd", "two_layer_zero"):
        loop = replace(weak.loop(robot, weak.controller(name)), check_gains=False)
        np.testing.assert_allclose(loop.run()["position"], one(e, name)["position"], atol=1e-6)


# -- rotors ------------------------------------------------------------------------------------------------------------


def test_rotors_stand_on_the_diagonal_of_the_arm_s_inertia() -> None:
    for name, free in (("two_axis_arm", 0), ("platform_arm", 2)):
        robot, rotors = load(name), np.array([0.3, 0.07])
        heavier = robot.with_armature(rotors)
        position = robot.neutral_position() + 0.3
        difference = Dynamics(heavier).mass_matrix(position) - Dynamics(robot).mass_matrix(position)
        np.testing.assert_allclose(difference, np.diag([*np.zeros(free), *rotors]), atol=1e-12)
        assert not np.any(robot.model.armature), "the robot itself is as it was"


@pytest.mark.parametrize("value", [-0.1, np.nan, (0.1, 0.2, 0.3)])
def test_rotors_that_cannot_be_are_refused(value: Any) -> None:
    with pytest.raises(ConfigError, match="armature"):
        load("two_axis_arm").with_armature(value)


def test_a_recording_brings_its_rotors_back(tmp_path: Any) -> None:
    e = short("armature=[0.2, 0.4]", "controllers=['pd']", seconds=0.02)
    run_experiment(e, "x", out=tmp_path)
    again = recorded_robot(Recording.open(tmp_path / "pd.h5"))
    q = again.neutral_position()
    np.testing.assert_allclose(Dynamics(again).mass_matrix(q), Dynamics(e.load_robot()).mass_matrix(q))


def test_kv_of_40_at_200_hz_is_refused_for_the_links_alone() -> None:
    e = short("armature=0.0", "actuator.gap=0.0", "friction.arm=0.0")
    with pytest.raises(ConfigError, match="unstable") as refused:
        one(e, "pd")
    limits = [float(text.split()[0].rstrip("):;,")) for text in str(refused.value).split("limit alone ")[1:]]
    np.testing.assert_allclose(limits, [15, 1.3], rtol=0.02, err_msg="the numbers in the file's comment")


# -- the rig -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["one_layer", "two_layer_random"])
def test_both_engines_run_the_rig_alike(name: str) -> None:
    e = short(seconds=0.05)
    fast, slow = (one(e, name, engine=engine) for engine in ("compiled", "ordinary"))
    for signal in ("q", "qdot", "torque", "position"):
        np.testing.assert_allclose(fast[signal], slow[signal], rtol=1e-6, atol=1e-9)


@whole
def test_friction_backlash_and_encoders_each_make_pd_worse() -> None:
    def rms(*settings: str) -> float:
        run = one(load_experiment("chapter5", ["weights_interval=8.0", *settings]), "pd")
        return float(np.sqrt(np.mean(run["true_e"][400:] ** 2)))

    smooth = rms("friction.coulomb=0.0", "friction.arm=0.0")
    assert rms() > 5 * smooth
    loose = rms("friction.coulomb=0.0", "friction.arm=0.0", "actuator.gap=0.01")
    assert loose > rms("friction.coulomb=0.0", "friction.arm=0.0", "actuator.gap=1e-5")
    coarse = rms("friction.coulomb=0.0", "friction.arm=0.0", "sensor.resolution=0.01")
    assert coarse > 1.2 * smooth


@whole
def test_a_proof_knows_both_starts_and_the_unit_of_the_error(tmp_path: Any, capsys: Any) -> None:
    """The learner is built again with its name, its start and its unit, and `judge` takes it."""
    e = short("controllers=['two_layer_zero', 'two_layer_random']", seconds=2.0)
    run_experiment(e, "x", out=tmp_path)
    for name in ("two_layer_zero", "two_layer_random"):
        recording = Recording.open(tmp_path / f"{name}.h5")
        learner = recorded_learner(recording, e.load_robot())
        assert learner is not None and learner.controller == e.controller(name)
        assert main(["judge", str(tmp_path / f"{name}.h5"), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)


# -- the numbers beside the thesis's -----------------------------------------------------------------------------------


def test_the_thesis_s_ratio_is_eight_percent() -> None:
    assert thesis_ratios() == pytest.approx((0.92, 0.92), abs=0.005)
    assert mean_ratio((0.5, 2.0)) == pytest.approx(1.0) and mean_ratio((0.0, 2.0)) == 0.0
    assert PRINTED == {"one_layer": (1.7789, 1.7463), "two_layer": (1.6394, 1.6091)}


def test_largest_errors_are_those_of_the_whole_measured_run(result: Result) -> None:
    found = largest_errors(result.recordings)
    for name, recording in result.recordings.items():
        assert found[name] == pytest.approx([DEGREES * max(map(abs, x)) for x in recording["e"].T.tolist()])
    true = largest_errors(result.recordings, "true_e")
    assert true != found and ratios(found)["pd"][1] == pytest.approx(found["pd"][1] / found["one_layer"][1])
    assert "one_layer" not in ratios(found) and ratios({"pd": [1.0, 2.0]}) == {}


def test_a_run_that_is_lost_has_no_largest_error() -> None:
    run = run_experiment(short("controllers=['pd', 'one_layer']", "bounds.joint_speed=1e-6", seconds=0.02), "x")
    assert not run.completed and run.largest_errors()["largest_errors_deg"] == {}
    assert "-" in comparison.render(run)


@whole
def test_the_one_layer_network_meets_what_it_was_calibrated_on(result: Result) -> None:
    found = largest_errors(result.recordings)["one_layer"]
    np.testing.assert_allclose(found, PRINTED["one_layer"], rtol=0.03)
    intervals = {(row["figure"], row["statistic"]): row["inside"] for row in result.figure_ranges()}
    assert len(intervals) == 12 and all(
        intervals[f"5.5 {place}", s] for place in ("top", "bottom") for s in ("max", "min")
    )


def test_the_command_prints_the_four_numbers_beside_the_thesis_s(capsys: Any, tmp_path: Any) -> None:
    options = [
        "--set",
        "time.duration=0.05",
        "--set",
        "plots=['figure-5.5']",
        "--set",
        "windows=[[0.0, 0.05]]",
        "--details",
    ]
    assert main(["run", "chapter5", *options, "--out", str(tmp_path / "a")]) == 0
    text = capsys.readouterr().out
    assert all(number in text for number in ("1.7789", "1.7463", "1.6394", "1.6091", "0.922", "0.921"))
    assert max(map(len, text.splitlines()[: text.splitlines().index("")])) <= 100
    assert main(["run", "chapter5", *options, "--out", str(tmp_path / "b"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["comparison"]
    assert set(told["largest_errors_deg"]) == set(load_experiment("chapter5").controllers)
    assert all(len(values) == 2 for values in told["largest_errors_deg"].values())
    assert set(told["largest_error_ratios"]) >= {"two_layer_zero", "two_layer_random"}
    chapter4 = ["run", "chapter4", "--set", "time.duration=0.02", "--set", "plots=[]", "--controller", "pd", "--json"]
    assert main([*chapter4, "--out", str(tmp_path / "c")]) == 0
    assert "largest_errors_deg" not in json.loads(capsys.readouterr().out)["comparison"]


def test_weights_that_start_equal_stay_equal_and_random_ones_do_not() -> None:
    e = short(seconds=0.2)
    zero, random = (one(e, name) for name in ("two_layer_zero", "two_layer_random"))
    ranks = []
    for run, name in ((zero, "two_layer_zero"), (random, "two_layer_random")):
        controller = e.controller(name)
        state = controller.init(e.loop(e.load_robot(), controller).context())
        state.values[:] = run.final["controller_state"]
        ranks.append(np.linalg.matrix_rank(state["V2"], tol=1e-9 * np.linalg.norm(state["V2"])))
    assert ranks[0] == 1 < ranks[1] and isinstance(e.controller("two_layer_zero").network, TwoLayer)
