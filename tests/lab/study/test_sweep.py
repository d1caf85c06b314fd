"""A setting swept: equal draws at every value, which value is best, and what a study says of its gains."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mmnn_pin import Hold, Line, Sine, Trajectory, load, sweep
from mmnn_pin.errors import ConfigError, InputError, UnknownName
from mmnn_pin.lab.show.study import levels_text, render
from mmnn_pin.lab.show.study_figures import errors_against_factors, shown_unit
from mmnn_pin.lab.study.choice import advice, best_of, gains_of, levels
from mmnn_pin.lab.study.factors import Factor
from mmnn_pin.lab.study.results import Results
from mmnn_pin.lab.study.settings import StudySettings
from mmnn_pin.lab.study.store import TrialResult
from mmnn_pin.lab.study.sweep import assembled, loops_of


@pytest.fixture(scope="module")
def robot():
    return load("platform_arm")


@pytest.fixture(scope="module")
def found(robot):
    path = Trajectory.of(robot, base=Line(speed=0.3), arm={"arm_1_joint": Sine(0.5, 4.0)})
    return sweep(robot, path, "feedback.arm", [2.0, 8.0, 300.0], ["pd"], runs=3, duration=0.1, masses=(0.9, 1.1))


def rows_of(errors: dict[float, list[float]], key: str = "feedback.arm", statuses: dict[float, str] | None = None):
    """Results of made-up rows: value to the errors of its runs."""
    rows, number = [], 0
    for value, each in errors.items():
        for i, error in enumerate(each):
            status = "completed" if math.isfinite(error) else (statuses or {}).get(value, "diverged")
            rows.append(
                TrialResult(id=number, status=status, metrics={"e.arm.rms": error}, fingerprint="", point=i, seed=i,
                       controller="pd", parameters={key: value}, finished="")
            )  # fmt: skip
            number += 1
    about = StudySettings(experiment="", factors={key: Factor(grid=tuple(errors))}, metrics=("e.*.rms",))
    facts = {"controllers": ["pd"], "versions": {}, "settings": {}, "file": ""}
    return Results(Path("x"), "made", about, number, rows, [], ("e.*.rms",), {"e.arm.rms": "rad"}, facts)


def test_the_best_value_has_most_successes_then_the_least_error():
    results = rows_of({1.0: [0.5] * 6, 10.0: [0.02] * 6, 50.0: [0.01] * 5 + [math.inf], 90.0: [math.inf] * 6})
    every = levels(results, "pd", "feedback.arm")
    assert [level.value for level in every] == [1.0, 10.0, 50.0, 90.0]
    best = best_of(every)
    assert best is not None and best.value == 10.0
    assert "take feedback.arm = 10 " in advice(results, "pd", "feedback.arm")
    at_the_end = rows_of({1.0: [0.5] * 6, 2.0: [0.4] * 6, 3.0: [0.3] * 6})
    assert "largest that was tried, so try larger ones" in advice(at_the_end, "pd", "feedback.arm")
    nothing = rows_of({1.0: [math.inf] * 6, 2.0: [math.inf] * 6})
    assert "no feedback.arm that was tried succeeds" in advice(nothing, "pd", "feedback.arm")


def test_a_study_says_which_gain_to_take_but_not_which_mass():
    text = render(rows_of({1.0: [0.5] * 8, 10.0: [0.02] * 8, 20.0: [0.03] * 8}))
    assert "pd: take feedback.arm = 10" in text
    other = rows_of({1.0: [0.5] * 8, 10.0: [0.02] * 8, 20.0: [0.03] * 8}, key="masses.root")
    assert gains_of(other) == [] and "take masses" not in render(other)


@pytest.mark.parametrize("runs", [1, 3, 40])
def test_a_completed_run_is_never_said_to_be_infinite(runs):
    text = render(rows_of({1.0: [0.5] * runs, 2.0: [0.2] * runs}))
    assert "inf" not in text.replace("inflated", "")
    one_lost = rows_of({1.0: [0.5] * runs, 2.0: [0.2] * (runs - 1) + [math.nan]})
    one_lost = replace(one_lost, rows=[msgspec.structs.replace(row, status="completed") for row in one_lost.rows])
    assert not np.isinf(one_lost.metric("pd", "e.*.rms")).any()
    assert "inf" not in render(one_lost)


def test_draws_are_equal_at_every_value_and_the_controller_does_not_know_them(found):
    rows = found.results.rows
    assert len(rows) == 9 and {(row.seed, row.parameters["feedback.arm"]) for row in rows} == {
        (i, v) for i in range(3) for v in (2.0, 8.0, 300.0)
    }
    metrics = [row.metrics["effort"] for row in rows if row.parameters["feedback.arm"] == 8.0]
    assert len(set(metrics)) == 3  # three robots
    assert found.best["pd"] in (2.0, 8.0)


def test_a_sweep_shows_itself(found, tmp_path):
    assert "feedback.arm" in str(found) and repr(found).startswith("<Sweep of feedback.arm: pd best at ")
    file = found.plot().save(tmp_path / "sweep.svg")
    assert file.stat().st_size > 1000 and "<img" in found._repr_html_()
    axes = errors_against_factors(found.results).axes
    assert len(axes) == 2 and axes[-1].get_xlabel() == "feedback.arm" and axes[0].get_ylim()[0] == 0.0
    assert [tick.get_text() for tick in axes[-1].get_xticklabels()] == ["2", "8", "300"]
    assert set(found.errors("pd")) == {2.0, 8.0, 300.0}
    with pytest.raises(UnknownName):
        found.errors("nobody")


def test_an_interval_without_an_upper_end_reaches_the_top(robot):
    """At 80 N m s some robots are lost, fewer than half: the median is finite, the end of its interval is not."""
    reference = Trajectory(base=Line(speed=0.3), arm=[Sine(amplitude=0.8, period=4.0), Hold(0.8)])
    found = sweep(
        robot, reference, "feedback.arm", [20.0, 80.0], ["pd"], duration=2.0, settings={"feedback.base": 300.0}
    )
    (_, high), (_, lost) = found.errors("pd").items()
    pattern = found.results.patterns[0]
    assert np.isfinite(high.medians[pattern].high) and np.isfinite(lost.medians[pattern].value)
    assert lost.medians[pattern].high == np.inf
    axes = errors_against_factors(found.results).axes[0]
    tops = [segment[:, 1].max() for lines in axes.collections for segment in lines.get_segments()]
    assert tops.count(axes.get_ylim()[1]) == 1


def test_the_delay_margin_stands_beside_the_error_and_counts_before_it(robot):
    """Within the motors' limits an unstable gain completes, and one that bears hardly any delay errs least."""
    path = Trajectory.of(robot, base=Line(speed=0.3), arm={"arm_1_joint": Sine(0.5, 4.0)})
    limits = {"actuator.torque_limit": "urdf"}
    found = sweep(robot, path, "feedback.arm", [8.0, 24.0, 80.0], ["pd"], runs=2, duration=0.6, settings=limits)
    good, fast, bad = found.errors("pd").values()
    assert good.margin == pytest.approx(found.results.rows[0].metrics["delay_margin"], rel=0.3) and not good.short
    assert bad.success.value == 1.0 and bad.margin == 0.0 and bad.short
    pattern = found.results.patterns[-1]
    assert 0 < fast.margin < 0.003 == fast.asked and fast.medians[pattern].value < good.medians[pattern].value
    assert found.best == {"pd": 8.0}
    text = str(found)
    assert "delay" in text and "0 !" in text and f"{1e3 * good.margin:.3g}" in text
    picture = found.plot().figure
    rings = [line for axes in picture.axes for line in axes.get_lines() if line.get_fillstyle() == "none"]
    assert {float(np.ravel(ring.get_xdata())[0]) for ring in rings} == {24.0, 80.0}
    assert "delay margin too small" in [text.get_text() for text in picture.legends[0].get_texts()]


def test_the_margin_is_that_of_the_loop(robot):
    """The least of the draws, as each loop tells its own; a latency that is stated counts on top of what is asked."""
    path = Trajectory.of(robot, base=Line(speed=0.3))
    settings = {"latency.command": 0.002, "latency.margin": 0.004, "feedback.base": 300.0}
    found = sweep(robot, path, "feedback.arm", [4.0], ["pd"], runs=3, duration=0.05, settings=settings)
    level = found.errors("pd")[4.0]
    made = assembled(robot, path, ["pd"], duration=0.05, settings={**settings, "feedback.arm": 4.0})
    loops = [loop for i in range(3) for _, loop in loops_of(made, i, 3, (0.8, 1.25))]
    assert level.margin == min(loop.delay_margin() for loop in loops) and level.asked == pytest.approx(0.006)


def test_a_study_without_margins_has_no_column_for_them():
    results = rows_of({1.0: [0.5] * 6, 2.0: [0.4] * 6})
    assert "delay margin" not in levels_text(results, "feedback.arm")
    assert not any(level.short for level in levels(results, "pd", "feedback.arm"))


def test_one_run_for_a_value_has_a_point_and_no_bar():
    axes = errors_against_factors(rows_of({1.0: [0.5], 2.0: [0.2]})).axes[0]
    ends = [segment[:, 1] for lines in axes.collections for segment in lines.get_segments()]
    assert all(np.ptp(end) == 0.0 for end in ends) and axes.get_ylim()[1] < 600.0


def test_errors_of_turning_and_sliding_joints_have_both_units():
    results = rows_of({1.0: [0.5] * 6, 2.0: [0.4] * 6})
    mixed = replace(results, units={"e.arm.rms": "rad", "e.lift.rms": "m"})
    assert mixed.unit("e.*.rms") == "rad or m" and shown_unit(mixed, "e.*.rms") == (1e3, "mrad or mm")
    assert "mrad or mm" in levels_text(mixed, "feedback.arm")
    assert errors_against_factors(mixed).axes[0].get_title() == "e.*.rms [mrad or mm]"
    assert replace(results, units={"e.arm.rms": "rad", "e.share.rms": ""}).unit("e.*.rms") == ""


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"values": []}, "no values"),
        ({"values": "12"}, "is no list"),
        ({"runs": 0}, "0 runs"),
        ({"masses": (1.2, 0.8)}, "least and the largest"),
        ({"key": "feedback.am"}, "unknown key 'am'"),
        ({"key": "robot"}, "beside the objects"),
        ({"values": [1.0, -1.0]}, "feedback.arm"),
        ({"values": [1.0, 1.0]}, "comes twice"),
        ({"controllers": ["pd_effective"]}, "takes the gain of a learner"),
        ({"metrics": ["nothing"]}, "unknown metric"),
    ],
)
def test_wrong_arguments_are_refused_before_a_run(change, words, robot):
    path = Trajectory.of(robot, base=Line(speed=0.3))
    arguments = {"key": "feedback.arm", "values": [2.0], "controllers": ["pd"], "runs": 1, "duration": 0.02} | change
    with pytest.raises(InputError, match=words):
        sweep(robot, path, **arguments)


def test_a_sweep_in_which_nothing_runs_says_why(robot):
    path = Trajectory.of(robot, base=Line(speed=0.3), arm={"arm_1_joint": Sine(0.5, 4.0)})
    found = sweep(robot, path, "feedback.arm", [1e5, 1e6], ["pd"], runs=1, duration=0.5)
    (first, _) = found.results.rows
    assert found.best == {"pd": None} and first.message
    assert f"succeeds in any run; the first: {first.message}" in " ".join(str(found).split())


def test_a_sweep_of_something_without_numbers_has_no_picture(robot):
    path = Trajectory.of(robot, base=Line(speed=0.3))
    found = sweep(robot, path, "learning.leakage", [True, False], ["two_layer"], runs=1, duration=0.02)
    assert "True" in str(found)
    with pytest.raises(InputError, match="no number"):
        found.plot()
    assert isinstance(ConfigError("x"), InputError)
