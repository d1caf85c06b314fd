"""A second look at what a search found, on robots that it did not have; the same for learners and plain controllers.

The settings with the best score may be at the edge of stability. So the tries are looked at in the order of their
scores, on the search's own tasks with other seeds and noise, and steps of encoders, `NOISE` times as large; and with a
true robot whose masses are 10 % smaller and 10 % larger than is told, which has a higher or a lower loop gain. The
first try holds whose score there is at most `LIMIT` times the one it had, where there is more noise `LIMIT` times
`NOISE`: an error that noise makes grows with it. Where none of the first `LOOKS` holds, it is that of them and the
start whose worst score is the least. Motors at their limits do not count as lost here: the errors tell, and a heavy arm
comes to them as it starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import msgspec

from mmnn_pin.lab.experiments.experiment import Experiment
from mmnn_pin.loop.loop import Loop
from mmnn_pin.model.robot import Robot, carrying
from research.contest.task import Task

from .search import Bench, Say, Tries, changed_by

LOOKS = 6
LIMIT = 1.5
NOISE = 2.0
SEEDS = 500  # added to the seeds
MASSES = {"light": 0.9, "heavy": 1.1}
LIMITS = {"noise": LIMIT * NOISE, **dict.fromkeys(MASSES, LIMIT)}
NOISY = ("pose_noise", "noise", "velocity_noise", "resolution", "wheel_resolution")  # of the sensors


class Scores(Protocol):
    """What gives settings a score, as `Bench` does."""

    def score(self, learner: str, settings: Mapping[str, Any]) -> float:
        """Of a learner's settings; less is better."""


@dataclass(frozen=True, eq=False)
class Other(Task):
    """A task whose true robot has other masses than its controllers are told; their gains are those of the told one.

    Attributes:
        factor: The true masses and inertias over those told.
    """

    factor: float = 1.0

    @cached_property
    def true(self) -> Robot:
        """The true robot before it picks up what it may pick up."""
        return self.robot.with_masses(self.factor)

    @cached_property
    def at_the_end(self) -> Robot:
        """The true robot at the end of the training."""
        load = self.load
        return self.true if load is None or self.puts_down else carrying(self.true, load.mass, load.joint, load.at)

    def training(self, controller: Any, seed: int) -> Loop:
        """The closed loop of a training run."""
        loop = super().training(controller, seed)
        return replace(loop, robot=self.true, nominal=loop.nominal or self.robot)


def noisier(experiment: Experiment) -> Experiment:
    """An experiment with other seeds, noise and steps of encoders `NOISE` times as large."""
    sensor = msgspec.to_builtins(experiment.sensor)
    changes = {f"sensor.{key}": times(sensor[key]) for key in NOISY}
    return changed_by(msgspec.structs.replace(experiment, seed=experiment.seed + SEEDS), changes)


def times(value: Any) -> Any:
    """A number, or every one of several, `NOISE` times as large."""
    return [times(one) for one in value] if isinstance(value, list | tuple) else NOISE * value


def benches(bench: Bench) -> dict[str, Bench]:
    """The robots of the second look, from the bench of the search; keys as `LIMITS`."""
    noisy = tuple(replace(task, experiment=noisier(task.experiment)) for task in bench.tasks)
    others = {
        name: tuple(
            Other(task.name, task.title, task.experiment, task.contest, task.robot, factor) for task in bench.tasks
        )
        for name, factor in MASSES.items()
    }
    return {name: Bench.of(tasks, limits=False) for name, tasks in {"noise": noisy, **others}.items()}


def holds(score: float, again: Mapping[str, float]) -> bool:
    """Whether settings hold on the robots that their search did not have.

    Args:
        score: Theirs in the search.
        again: Those of the second look, keys as `LIMITS`.
    """
    return all(again[name] <= limit * score for name, limit in LIMITS.items())


def taken(others: Mapping[str, Scores], learner: str, tries: Tries, say: Say) -> dict[str, Any]:
    """Which of the tries of a search is taken.

    Args:
        others: The robots of the second look, keys as `LIMITS`.
        learner: Whose tries.
        tries: In the order in which they were made, the start first.
        say: Told every look.

    Returns:
        For JSON: `score` and `settings`; `taken`, its place among the tries; `looked`, place to the scores of the
        second look, in the order of the looks; `own`, the start's score; `tries`, their number; and all `scores`.
    """
    scores = [score for _, score in tries]
    order = sorted(range(len(tries)), key=lambda k: scores[k])
    looked: dict[int, dict[str, float]] = {}
    for k in order[:LOOKS]:
        looked[k] = look(others, learner, tries[k], say)
        if holds(scores[k], looked[k]):
            chosen = k
            break
    else:
        if 0 not in looked:
            looked[0] = look(others, learner, tries[0], say)
        chosen = min(looked, key=lambda k: max(scores[k], *looked[k].values()))
    return {
        "own": scores[0],
        "score": scores[chosen],
        "settings": tries[chosen][0],
        "taken": chosen,
        "looked": {str(k): again for k, again in looked.items()},
        "tries": len(tries),
        "scores": scores,
    }


def look(others: Mapping[str, Scores], learner: str, one: tuple[dict[str, Any], float], say: Say) -> dict[str, float]:
    """The scores of a try on the robots of the second look."""
    settings, score = one
    again = {name: other.score(learner, settings) for name, other in others.items()}
    words = ", ".join(f"{name} {value / score:.3g}" for name, value in again.items())
    say(f"{learner}: second look at {score:.4f}, times {words}")
    return again
