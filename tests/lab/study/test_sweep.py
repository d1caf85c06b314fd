"""A setting swept: equal draws at every value, which value is best, and what a study says of its gains."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mmnn_pin import Hold, Line, Sine, Trajectory, load, sweep
from mmnn_pin.errors import ConfigError, InputError, UnknownName
from mmnn_pin.lab.show.study import render
from mmnn_pin.lab.show.study_figures import errors_against_factors
from mmnn_pin.lab.study.choice import advice, best_of, gains_of, levels
from mmnn_pin.lab.study.factors import Factor
from mmnn_pin.lab.study.results import Results
from mmnn_pin.lab.study.settings import StudySettings
from mmnn_pin.lab.study.store import Stored


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
                Stored(id=number, status=status, metrics={"e.arm.rms": error}, fingerprint="", point=i, seed=i,
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
    one_lost = replace(one_lost, rows=[replace(row, status="completed") for row in one_lost.rows])
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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"values": []}, "no values"),
        ({"values": "12"}, "no values"),
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
