"""The thesis's twelve intervals beside runs; what of an improvement is gain and what is learning; the readings."""

from __future__ import annotations

import json

import msgspec
import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmnn_pin import load_experiment, run_experiment
from mmnn_pin.cli import main
from mmnn_pin.lab.experiments.cases import SWITCHES, readings, summaries
from mmnn_pin.lab.experiments.controllers import EFFECTIVE
from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.lab.experiments.result import Improvement, Result, improvements
from mmnn_pin.lab.experiments.thesis import figure_intervals, figure_ranges
from mmnn_pin.lab.show import comparison as effects
from mmnn_pin.lab.show import comparison as verdicts
from mmnn_pin.signals import Array, Layout
from mmnn_pin.torque.neural import MEASURED

LEARNERS = ("two_layer", "one_layer")
# Distance of the ticks on the axes of the thesis's figures.
TICKS = {"4.2 top": 5e-3, "4.2 bottom": 5e-3, "4.3 top": 0.1, "4.3 bottom": 0.01, "4.4 top": 5e-3, "4.4 bottom": 2e-3}


def arrays(seed: int = 0, count: int = 50) -> dict[str, dict[str, Array]]:
    """Both learners' errors at random."""
    rng = np.random.default_rng(seed)
    sizes = {"pose_error": 3, "z": 2, "e": 2}
    return {name: {signal: rng.normal(size=(count, n)) for signal, n in sizes.items()} for name in LEARNERS}


# -- the intervals -----------------------------------------------------------------------------------------------------


def test_there_is_one_tick_for_the_largest_and_one_for_the_smallest_value_of_every_plot() -> None:
    known = figure_intervals()
    assert [(each.figure, each.statistic) for each in known] == [(f, s) for f in TICKS for s in ("max", "min")]
    for each in known:
        assert each.upper - each.lower == pytest.approx(TICKS[each.figure])
        steps = np.array([each.lower, each.upper]) / TICKS[each.figure]
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    largest = {each.figure: each.upper for each in known if each.statistic == "max"}
    assert largest == {"4.2 top": 0.035, "4.2 bottom": 0.02, "4.3 top": 0.5, "4.3 bottom": 0.07, "4.4 top": 0.035,
                       "4.4 bottom": 0.01}  # fmt: skip


def test_values_are_the_extremes_of_the_curves_in_each_plot() -> None:
    runs = arrays()
    one, two = runs["one_layer"], runs["two_layer"]
    z, e = (np.vstack([one[name], two[name]]) for name in ("z", "e"))
    curves = [one["pose_error"].ravel(), two["pose_error"].ravel(), *z.T, *e.T]
    wanted = [value for curve in curves for value in (curve.max(), curve.min())]
    np.testing.assert_array_equal([row["value"] for row in figure_ranges(runs)], wanted)


@given(st.floats(-1, 1), st.sampled_from(figure_intervals()))
def test_inside_is_between_the_ticks(value: float, known) -> None:
    runs = {name: {key: np.full_like(x, value) for key, x in each.items()} for name, each in arrays(count=2).items()}
    (row,) = (r for r in figure_ranges(runs) if (r["figure"], r["statistic"]) == (known.figure, known.statistic))
    assert row["inside"] == (known.lower <= value <= known.upper)
    assert (row["lower"], row["upper"], row["value"]) == (known.lower, known.upper, value)


def test_what_cannot_be_compared_is_left_out() -> None:
    runs = arrays()
    assert figure_ranges({}) == [] == figure_ranges({"pd": runs["two_layer"]})
    alone = figure_ranges({"two_layer": runs["two_layer"]})
    assert {row["figure"] for row in alone} == {"4.2 bottom"}
    for run in runs.values():
        run["e"] = run["e"][:, :1]  # a robot with one joint
        del run["pose_error"]  # and a fixed base
    assert {row["figure"] for row in figure_ranges(runs)} == {"4.3 top", "4.3 bottom", "4.4 top"}
    assert figure_ranges({name: {"z": np.zeros((0, 2))} for name in LEARNERS}) == []


def test_a_run_that_is_not_finite_is_not_inside() -> None:
    runs = arrays()
    runs["two_layer"]["z"][7, 0] = np.nan
    rows = [row for row in figure_ranges(runs) if row["figure"] == "4.3 top"]
    assert [(row["value"], row["inside"]) for row in rows] == [(None, False)] * 2
    json.dumps(rows, allow_nan=False)


@pytest.fixture(scope="module")
def result() -> Result:
    """Chapter 4, long enough for both windows."""
    duration = "0.04" if numba.config.DISABLE_JIT else "1.5"
    windows = "windows=[[0.0, 0.02], [0.02, 5.0]]"
    return run_experiment(load_experiment("chapter4", [f"time.duration={duration}", windows]), "chapter4")


def test_a_run_tells_its_intervals_as_its_arrays_do(result: Result) -> None:
    signals = ("pose_error", "z", "e")
    plain = {name: {s: np.array(result.recordings[name][s]) for s in signals} for name in LEARNERS}
    rows = result.to_dict()["comparison"]["figure_ranges"]
    assert len(rows) == 12 and rows == figure_ranges(plain)
    assert set(rows[0]) >= {"figure", "curve", "statistic", "value", "lower", "upper", "inside"}


def test_an_experiment_is_compared_with_the_figures_that_it_draws() -> None:
    options = ["time.duration=0.02", "controllers=['two_layer', 'one_layer']"]
    for plots, count in (("['figure-4.3']", 4), ("['errors']", 0)):
        e = load_experiment("chapter4", [*options, f"plots={plots}"])
        assert len(run_experiment(e, "x").figure_ranges()) == count


# -- gain and learning -------------------------------------------------------------------------------------------------

errors = st.floats(1e-6, 1e3)


@given(errors, errors, errors)
def test_an_improvement_is_gain_and_learning(pd: float, effective: float, learner: float) -> None:
    i = Improvement(pd, effective, learner)
    assert i.total == pytest.approx(pd - learner) == pytest.approx(i.gain + i.learning, abs=1e-9)
    numbers = i.to_dict()
    if learner < pd:
        assert numbers["gain_share"] + numbers["learning_share"] == pytest.approx(1)  # type: ignore[operator]
        assert numbers["learning_share"] * (pd - learner) == pytest.approx(effective - learner)  # type: ignore[operator]
    else:  # nothing to share; the parts still say what the network did
        assert numbers["gain_share"] is numbers["learning_share"] is None
        assert numbers["improvement"] <= 0  # type: ignore[operator]


@pytest.mark.parametrize(
    ("numbers", "shown"),
    [
        ((4.0, 3.0, 1.0), ("75.0", "25.0", "50.0", "  33 : 67")),
        ((4.0, 5.0, 2.0), ("50.0", "-25.0", "75.0", "  -50 : 150")),  # the gain does harm, the network makes up for it
        ((4.0, 1.0, 2.0), ("50.0", "75.0", "-25.0", "  150 : -50")),  # all gain, and the network takes some back
        ((4.0, 3.0, 5.0), ("-25.0", "25.0", "-50.0", "  -")),  # worse than PD, in spite of the gain
        ((0.0, 0.0, 0.0), ("-", "-", "-", "  -")),
        ((4.0, float("nan"), float("nan")), ("nan", "nan", "nan", "  -")),
    ],
)
def test_what_the_table_says_of_an_improvement(numbers: tuple[float, ...], shown: tuple[str, ...]) -> None:
    assert verdicts.improvement_cells(Improvement(*numbers)) == shown


def test_improvements_take_the_last_window_and_each_learner_s_own_pd(result: Result) -> None:
    late = result.recordings["pd"].time >= 0.02
    found = result.to_dict()["comparison"]["improvement"]
    assert set(found) == set(LEARNERS)
    for effective, learner in EFFECTIVE.items():
        for name, key in (("pd", "pd"), (effective, "pd_effective"), (learner, "learner")):
            x = result.recordings[name]["pose_error"][late, 0]
            assert found[learner]["pose_error.x"][key] == pytest.approx(np.sqrt(np.mean(x**2)))


def test_improvements_need_pd_and_pd_at_the_learner_s_gain(result: Result) -> None:
    windows = result.experiment.windows
    for missing, left in (("pd", set()), ("pd_effective", {"one_layer"}), ("two_layer", {"one_layer"})):
        some = {name: numbers for name, numbers in result.metrics.items() if name != missing}
        assert set(improvements(some, windows)) == left
    assert improvements(result.metrics, ()) == {}


# -- readings ----------------------------------------------------------------------------------------------------------


def short(*settings: str) -> Experiment:
    return load_experiment("chapter4", ["time.duration=0.02", "windows=[[0.0, 0.02]]", *settings])


def test_every_switch_is_turned_alone_and_turned_back() -> None:
    e = short()
    assert len({switch.turned(e)[0] for switch in SWITCHES}) == len(SWITCHES)
    for switch in SWITCHES:
        words, other = switch.turned(e)
        back, again = switch.turned(other)
        assert again == e != other and {words, back} == {switch.first[1], switch.second[1]}
        changed = [name for name in e.__struct_fields__ if getattr(e, name) != getattr(other, name)]
        assert changed == [switch.key.partition(".")[0]]
        assert msgspec.json.decode(other.to_json(), type=Experiment) == other  # a valid experiment


def test_inputs_without_position_hold_nothing_that_grows_on_a_line() -> None:
    layout = Layout.of(short().load_robot().dimensions)
    sizes = {switch.turned(short())[0]: switch.turned(short())[1].inputs for switch in SWITCHES}
    assert sizes["no absolute position"].rows(layout).size == 19
    assert sizes["Appendix B's short input"].rows(layout).size == 14
    for words in ("no absolute position", "Appendix B's short input"):
        assert not {"pose_ref", "pose"} & set(sizes[words].signals) and set(sizes[words].signals) <= set(MEASURED)


def test_readings_give_both_learners_for_every_switch() -> None:
    results = readings(short(), "chapter4")
    rows = json.loads(json.dumps(summaries(results), allow_nan=False))
    assert [row["reading"] for row in rows] == ["as it is", *(switch.turned(short())[0] for switch in SWITCHES)]
    for row, result in zip(rows, results.values(), strict=True):
        for learner in LEARNERS:
            x = result.recordings[learner]["e"][:, 0]
            assert row[learner]["rms"]["e.arm_1_joint"] == pytest.approx(np.sqrt(np.mean(x**2)))
            assert row[learner]["outcome"] == "completed"
        assert row["of"] == 12 and row["met"] == sum(each["inside"] for each in row["figure_ranges"])
    text = effects.render_readings("Title", rows)
    assert max(map(len, text.splitlines())) <= 100 and text.count("two_layer") == text.count("one_layer") == len(rows)
    e1 = 1e3 * rows[-1]["one_layer"]["rms"]["e.arm_1_joint"]
    assert f"{e1:.3g}" in text.splitlines()[-4]


def test_the_readings_command(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--set", "time.duration=0.02", "--variant", "printed"]
    assert main(["readings", "chapter4", *options, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["variant"] == "printed" and "weights from random" in [row["reading"] for row in found["readings"]]
    assert main(["readings", "chapter4", *options]) == 0
    assert "rates per second" in capsys.readouterr().out


def test_a_reading_of_a_fixed_arm_is_compared_with_no_figure(capsys: pytest.CaptureFixture[str]) -> None:
    arm = ["--set", "robot=two_axis_arm", "--set", "feedback.arm=1", "--set", "time.duration=0.02"]
    assert main(["readings", "chapter4", *arm]) == 0
    assert "of 12" not in capsys.readouterr().out


@pytest.mark.parametrize("frame", ["body", "world"])
def test_the_networks_see_the_pose_error_in_the_frame_asked_for(frame: str) -> None:
    options = ["controllers=['two_layer']", "start.pose_offset=[-0.1, 0.2, 0.5]", f"inputs.pose_error={frame}"]
    run = run_experiment(short(*options), "x").recordings["two_layer"]
    x = run.final["controller_state"][7:10]  # after q_vd (3), alpha (2) and its derivative (2)
    world, phi = run["pose_ref"][-1] - run["pose"][-1], run["pose"][-1, 2]
    turned = np.array(
        [np.cos(phi) * world[0] + np.sin(phi) * world[1], np.cos(phi) * world[1] - np.sin(phi) * world[0]]
    )
    np.testing.assert_allclose(x, world if frame == "world" else [*turned, world[2]], rtol=1e-12)
    assert abs(world[0] - turned[0]) > 0.05  # the two differ


def test_appendix_b_s_slip_replaces_the_yaw_rate_alone() -> None:
    run = run_experiment(short("controllers=['two_layer']", "inputs.constant_yaw_rate=5"), "x").recordings["two_layer"]
    x, signals = run.final["controller_state"][:22], short().inputs.signals
    wanted = np.concatenate([run[name][-1] for name in signals])
    assert x[4] == 5.0 != wanted[4]
    np.testing.assert_array_equal(np.delete(x, 4), np.delete(wanted, 4))
