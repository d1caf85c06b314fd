"""The second look at what a search of the contest found: the robust try wins, for every learner by the same rule."""

from __future__ import annotations

from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mmnn_pin.errors import StudyError
from mmnn_pin.lab.experiments.config import load_experiment
from mmnn_pin.model.dynamics import Dynamics
from research.contest.task import tasks_of
from research.studies.contest import __main__ as command
from research.studies.contest.search import TUNINGS, Bench, changed_by, tuned, tuning_file
from research.studies.contest.second_look import LIMIT, LIMITS, LOOKS, NOISE, Other, benches, holds, noisier, taken

QUICK = (
    *("time.duration=1.6", "time.control_period=0.0025", "time.plant_step=0.00125", "windows=[[0, 0.5], [0.8, 1.6]]"),
    *(f"held_out.{name}.duration=0.8" for name in ("similar", "tight", "circle")),
)


class Stub:
    """A robot on which the try `k` scores what a list says."""

    def __init__(self, scores):
        self.scores, self.asked = scores, []

    def score(self, learner, settings):
        self.asked.append(settings["k"])
        return self.scores[settings["k"]]


def looked(scores, noise, light, heavy):
    others = dict(zip(LIMITS, map(Stub, (noise, light, heavy)), strict=True))
    tries = [({"k": k}, score) for k, score in enumerate(scores)]
    return taken(others, "any", tries, lambda text: None), others


def test_a_fragile_best_try_loses_to_the_next_that_holds():
    """The best is lost on a lighter robot, the second worse than allowed with noise; nobody is looked at after that."""
    scores = [1.0, 0.2, 0.3, 0.1]
    found, others = looked(scores, [1.0, 0.61, 0.3, 0.1], [1.0, 0.2, 0.4, 900.0], [1.0, 0.2, 0.3, 0.1])
    assert found["taken"] == 2 and found["settings"] == {"k": 2} and found["score"] == 0.3
    assert list(found["looked"]) == ["3", "1", "2"] and found["own"] == 1.0 and found["scores"] == scores
    assert all(other.asked == [3, 1, 2] for other in others.values())
    assert looked(scores, scores, scores, scores)[0]["taken"] == 3


def test_where_none_holds_the_start_is_taken_if_it_bears_most():
    """Six fragile tries and a start that is lost nowhere; a start that is worse everywhere is not taken."""
    scores = [0.5, *(0.1 + 0.01 * k for k in range(8))]
    light = [0.9, *[50.0] * 8]
    found, others = looked(scores, light, light, light)
    assert found["taken"] == 0 and others["light"].asked == [1, 2, 3, 4, 5, 6, 0]
    worse = [60.0, 50.0, 50.0, 40.0, *[50.0] * 5]
    assert looked([1000.0, *scores[1:]], worse, worse, worse)[0]["taken"] == 3  # though the start, lost, holds


@given(st.data())
def test_what_is_taken_is_the_best_that_holds_or_bears_most(data):
    """By brute force over all tries, without an order."""
    n = data.draw(st.integers(1, 10))
    some = st.lists(st.floats(0.01, 1000.0), min_size=n, max_size=n)
    scores, noise, light, heavy = (data.draw(some) for _ in range(4))
    k = looked(scores, noise, light, heavy)[0]["taken"]
    first = np.argsort(scores, kind="stable")[:LOOKS].tolist()
    sound = [i for i in first if noise[i] <= LIMIT * NOISE * scores[i] and max(light[i], heavy[i]) <= LIMIT * scores[i]]
    if sound:
        assert k in sound and scores[k] == min(scores[i] for i in sound)
    else:
        worst = {i: max(scores[i], noise[i], light[i], heavy[i]) for i in {*first, 0}}
        assert worst[k] == min(worst.values())


@pytest.mark.parametrize("tuning", TUNINGS)
def test_what_is_kept_was_looked_at_by_the_rule(tuning):
    """Every look that stands there, judged again: all before the last failed, and the one that is taken follows."""
    for found in tuned()[tuning].values():
        scores, again = found["scores"], {int(k): one for k, one in found["looked"].items()}
        order = sorted(range(len(scores)), key=lambda k: scores[k])
        assert list(again) == list(dict.fromkeys([*order[:LOOKS], 0]))[: len(again)]
        sound = [k for k in again if k in order[:LOOKS] and holds(scores[k], again[k])]
        if sound:
            assert sound == [found["taken"]] == list(again)[-1:]
        else:
            assert len(again) == len({*order[:LOOKS], 0})
            assert found["taken"] == min(again, key=lambda k: max(scores[k], *again[k].values()))
        assert found["score"] == scores[found["taken"]]


def test_the_robot_is_another_one_and_the_controller_is_not_told():
    """Its true mass matrix is 0.9 times that of the told robot; gains and belief are those of the told one."""
    for task in tasks_of(load_experiment(tuning_file("payload"), QUICK[1:3]), ("pd",)):
        other = Other(task.name, task.title, task.experiment, task.robot, 0.9)
        own, theirs = (one.training(one.controller("pd"), 3001) for one in (task, other))
        q, nu = task.robot.neutral_position(), np.zeros(task.robot.dimensions.dof)
        matrices = [Dynamics(robot) for robot in (task.robot, theirs.robot, theirs.believed, other.at_the_end)]
        for one in matrices:
            one.refresh(q, nu)
        told, true, believed, loaded = (np.array(one.M) for one in matrices)
        np.testing.assert_allclose(true, 0.9 * told, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(believed, told)
        assert own.controller == theirs.controller and task.held_out.keys() == other.held_out.keys()
        load = Dynamics(task.at_the_end)
        load.refresh(q, nu)
        np.testing.assert_allclose(loaded - true, np.array(load.M) - told, rtol=1e-9, atol=1e-12)
        held = other.held_out_loop(other.controller("pd"), 3001, "tight", True)
        assert held.robot is other.at_the_end and held.believed is task.robot


def test_noise_and_encoders_are_twice_as_coarse_with_other_seeds():
    experiment = load_experiment(tuning_file("eight"))
    other = noisier(experiment)
    assert other.sensor.pose_noise == tuple(2 * value for value in experiment.sensor.pose_noise)
    assert other.sensor.velocity_noise == tuple(2 * value for value in experiment.sensor.velocity_noise)
    count = experiment.contest.seeds
    assert not {other.seed + i for i in range(count)} & {experiment.seed + i for i in range(count)}
    coarse = noisier(changed_by(experiment, {"sensor.resolution": 1e-3, "sensor.wheel_resolution": 0.0}))
    assert coarse.sensor.resolution == 2e-3 and coarse.sensor.wheel_resolution == 0.0
    assert msgspec.structs.replace(other, sensor=experiment.sensor, seed=experiment.seed) == experiment


@pytest.mark.long
def test_a_robot_that_is_fragile_when_lighter_shows_in_the_second_look():
    """A lighter and a heavier robot, and PD's score is one on each; motors at their limits do not count as lost."""
    bench = Bench.made("eight", *QUICK)
    others = benches(bench)
    assert list(others) == list(LIMITS)
    for other in others.values():
        assert other.score("pd", {}) == pytest.approx(1.0) and not other.limits
        assert other.score("two_layer", {"two_layer.F": [1e6, 1e6]}) > 1.0
    scores = {name: other.score("computed_torque", {}) for name, other in others.items()}
    exact = bench.score("computed_torque", {})
    assert min(scores["light"], scores["heavy"]) > 2.0 * exact  # it believes in the masses that it is told


def test_scores_of_other_code_are_refused_before_a_second_look():
    """With the command that searches anew; the same score passes."""
    bench = SimpleNamespace(score=lambda learner, settings: settings["k"])
    command.require_today(bench, "lag", "adaptive", [({"k": 0.3}, 0.3), ({"k": 0.9}, 0.7)])
    with pytest.raises(StudyError) as refused:
        command.require_today(bench, "lag", "adaptive", [({"k": 0.31}, 0.3)])
    assert "0.3, today's 0.31" in str(refused.value)
    assert refused.value.fix.endswith("--tune --only lag --learner adaptive")
