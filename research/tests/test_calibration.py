"""The calibration of chapter 4: its search repeats itself, its robots are what they say, its saved result holds."""

import json

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import ROOT

from mmnn_pin import Loop, load, load_experiment
from mmnn_pin.lab.experiments.thesis import figure_intervals, figure_ranges
from mmnn_pin.model.dynamics import Dynamics

pytest.importorskip("optuna")
pytest.importorskip("cmaes")
SIMULATES = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="runs of five seconds, uncompiled")


@pytest.fixture(autouse=True)
def checkout(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


@pytest.fixture
def saved():
    return json.loads((ROOT / "research" / "studies" / "chapter4" / "summary.json").read_text(encoding="utf-8"))


def bowl(places):
    return np.sum((places - [0.2, 0.7, 0.55]) ** 2, axis=1)


def test_search_repeats_itself_bit_for_bit_and_another_seed_does_not():
    from research.studies.search import search

    first, again, other = (search(bowl, 3, 28, seed) for seed in (4, 4, 5))
    assert np.array_equal(first[0], again[0]) and np.array_equal(first[1], again[1])
    assert not np.array_equal(first[0], other[0])


def test_search_goes_downhill():
    from research.studies.search import search

    places, costs = search(bowl, 3, 210, 0)
    assert costs.min() < 1e-3 < costs[:7].min()
    np.testing.assert_allclose(costs, bowl(places))
    assert places.min() >= 0 and places.max() <= 1


@given(st.floats(0.01, 10), st.floats(1.01, 100), st.floats(0, 1), st.booleans())
def test_a_number_and_its_place_are_inverse(lower, factor, place, log):
    from research.studies.search import Number

    number = Number("x", lower, lower * factor, "", log)
    assert number.lower * (1 - 1e-9) <= number.at(place) <= number.upper * (1 + 1e-9)
    assert number.place(number.at(place)) == pytest.approx(place, abs=1e-9)


def test_distance_counts_widths_outside_and_a_lost_run_misses_all():
    from research.studies.chapter4.unstated import cost_of, distances, met

    middle = np.array([(known.lower + known.upper) / 2 for known in figure_intervals()])
    width = np.array([known.upper - known.lower for known in figure_intervals()])
    off = middle + np.eye(12)[3] * 1.5 * width - np.eye(12)[7] * 0.75 * width
    np.testing.assert_allclose(distances(off), 1.0 * np.eye(12)[3] + 0.25 * np.eye(12)[7], atol=1e-9)
    found = np.array([middle, off, np.full(12, np.nan)])
    assert met(found).tolist() == [12, 10, 0]
    assert np.all(np.diff(cost_of(found)) > 1.5)
    assert cost_of(middle + 0.3 * width) > cost_of(middle)


@pytest.mark.parametrize("kind", ["mount", "centre of mass"])
def test_a_moved_robot_is_the_one_whose_urdf_says_so(kind, tmp_path):
    from research.studies.rollouts import with_centre_of_mass, with_mount

    robot = load("platform_arm")
    if kind == "mount":
        moved, old, new = with_mount(robot, 0.23), '<origin xyz="0.12 0 0.26" rpy="0 0 0"/>', "0.23 0 0.26"
    else:
        moved, old, new = with_centre_of_mass(robot, -0.07), '<origin xyz="0 0 0.06" rpy="0 0 0"/>', "-0.07 0 0.06"
    assert robot.urdf.count(old) == 1
    file = tmp_path / "moved.urdf"
    file.write_text(robot.urdf.replace(old, f'<origin xyz="{new}" rpy="0 0 0"/>'))
    position, nu = np.array([0.1, 0.2, 0.3, 0.4, -0.5, 0.0, 0.0]), np.array([0.3, 0.8, -0.6, 1.1])
    other, unmoved = Dynamics(load(file)), Dynamics(robot)
    for what in (lambda d: d.mass_matrix(position), lambda d: d.coriolis_matrix(position, nu) @ nu):
        np.testing.assert_allclose(what(Dynamics(moved)), what(other), atol=1e-10)
        assert np.abs(what(other) - what(unmoved)).max() > 1e-3


def test_rollouts_are_the_runs_of_the_loop():
    from research.studies.rollouts import roll_out

    experiment = load_experiment("chapter4", ["time.duration=0.1"])
    robot = experiment.load_robot()
    loops: list[Loop] = [experiment.loop(robot, experiment.controller(name)) for name in ("two_layer", "pd")]
    for loop, rollout in zip(loops, roll_out(loops, ("e", "effective_gain")), strict=True):
        recording = loop.run()
        assert rollout.completed and set(rollout.signals) == {"e", "effective_gain"}
        assert np.array_equal(rollout.signals["e"], recording["e"])


def test_jacobian_of_a_linear_robot(monkeypatch):
    """Two numbers, one of which alone moves one extreme by three widths: sqrt(1 / (1 + 9)) of its range is left."""
    from research.studies.chapter4 import calibration
    from research.studies.search import Number

    widths = calibration.widths()
    slope = np.zeros((2, 12))
    slope[0, 4] = 3.0
    monkeypatch.setattr(calibration, "run", lambda case, numbers, places: (places @ slope) * widths)
    numbers = (Number("a", 0, 1, ""), Number("b", 0, 1, ""))
    left, singular_values = calibration.left_by_jacobian(None, numbers, np.array([0.5, 0.5]))
    np.testing.assert_allclose(left, [1 / np.sqrt(10), 1.0])
    assert singular_values[0] == pytest.approx(3.0)


def test_walk_fills_what_meets_enough_and_nothing_else(monkeypatch):
    """Inside a box in two of three dimensions: the walk's quantiles are the box's."""
    from research.studies.chapter4 import calibration
    from research.studies.search import Number

    def meets(places):
        return np.where((np.abs(places[:, 0] - 0.3) < 0.1) & (np.abs(places[:, 1] - 0.6) < 0.3), 11, 4)

    monkeypatch.setattr(calibration, "run", lambda case, numbers, places: places)
    monkeypatch.setattr(calibration, "met", meets)
    numbers = tuple(Number(name, 0, 1, "") for name in "abc")
    start = np.array([0.3, 0.6, 0.5]) + 0.02 * np.random.default_rng(1).standard_normal((24, 3))
    walked, accepted = calibration.walk(None, numbers, start, 11, calibration.Effort(chains=24, steps=600))
    assert np.all(meets(walked) == 11) and 0.1 < accepted < 0.9
    assert 0 < calibration.unsure(walked) < 0.1 < calibration.unsure(np.sort(walked, axis=0))
    expected = [(0.21, 0.39), (0.33, 0.87), (0.05, 0.95)]
    for i, (low, high) in enumerate(expected):
        np.testing.assert_allclose(np.quantile(walked[:, i], (0.05, 0.95)), (low, high), atol=0.06)


def test_a_stretch_ends_at_the_first_gap():
    from research.studies.chapter4.calibration import stretch

    grid = np.linspace(0, 1, 6)
    enough = np.array([True, False, True, True, False, True])
    assert stretch(grid, enough, 0.45) == pytest.approx((0.4, 0.6))
    assert stretch(grid, np.zeros(6, bool), 0.45) == (0.45, 0.45)


@SIMULATES
def test_the_saved_fits_give_the_saved_extremes(saved):
    from research.studies.chapter4.unstated import CASES, extremes, loops, met

    found = extremes([loops(case, saved["calibration"][case.name]["values"]) for case in CASES])
    for case, values in zip(CASES, found, strict=True):
        entry = saved["calibration"][case.name]
        np.testing.assert_allclose(values, [row["value"] for row in entry["intervals"]], rtol=1e-6, atol=1e-9)
        assert met(values) == entry["met"]


@SIMULATES
def test_the_variant_figures_holds_the_saved_fit_and_meets_eleven(saved):
    from research.studies.chapter4.unstated import CASES

    entry, experiment = saved["calibration"][CASES[0].name], load_experiment("chapter4", variant="figures")
    values, robust = entry["values"], experiment.robust_of
    assert experiment.two_layer.hidden == experiment.one_layer.hidden == entry["hidden"]
    assert values["K"] == experiment.kinematic.K and -values["behind"] == experiment.start.pose_offset[0]
    assert experiment.friction.base == (values["friction_v"], values["friction_w"])
    assert experiment.friction.arm == values["friction_arm"]
    assert (experiment.two_layer.v_range, experiment.one_layer.width) == (values["v_range"], values["width"])
    for learner in ("two_layer", "one_layer"):
        own = getattr(robust, learner)
        assert (own.base, own.arm, own.ZB[0], own.ZB[1]) == tuple(
            values[f"{learner}.{name}"] for name in ("Kz1", "Kz2", "ZB", "ZB")
        )
    robot = experiment.load_robot()
    runs = {name: experiment.loop(robot, experiment.controller(name)).run() for name in ("two_layer", "one_layer")}
    assert sum(row["inside"] for row in figure_ranges(runs)) == entry["met"] >= 11
