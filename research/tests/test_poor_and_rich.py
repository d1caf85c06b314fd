"""What learners say of the contest's poor and rich motions."""

from __future__ import annotations

import re

import pytest
from proofs import SLOW

from mmnn_pin.lab.experiments.cases import chosen_cases
from mmnn_pin.lab.psi.excitation import (
    signals_for,
)
from mmnn_pin.loop.batch import simulate_many
from research.contest.settings import load_contest
from research.contest.task import tasks_of
from research.contest.trial import KEPT, findings_after

LONG = pytest.mark.skipif(SLOW, reason="needs a long run")


@LONG
def test_the_networks_say_it_after_the_poor_motion_and_not_after_the_rich_one():
    """`one_layer` says it after both, as it says what no motion can change; rows of few signals tell the same."""
    said = {}
    experiment = chosen_cases(load_contest("contest", ["contest.seeds=1"]), ["poor", "rich"])
    for task in tasks_of(experiment, ("one_layer", "two_layer", "two_layer_residual")):
        for name in task.experiment.controllers:
            controller = task.controller(name)
            loop = task.training(controller, 1)
            (run,) = simulate_many([loop], keep={*KEPT, *signals_for(controller)})
            state = controller.init(loop.context())
            state.values[:] = run.final["controller_state"]
            said[task.name, name] = " ".join(findings_after(task, name, controller, 1, run, state))
    for name in ("two_layer", "two_layer_residual"):
        assert "not excited: the run leaves" in said["poor", name] and said["rich", name] == ""
    for motion in ("poor", "rich"):
        assert re.search(r"units of its \w+'s network act as \d on random motion, so no", said[motion, "one_layer"])
