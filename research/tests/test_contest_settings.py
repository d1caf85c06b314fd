"""What a contest asks, held against what can be: one line with the key."""

from __future__ import annotations

import pytest

from mmnn_pin.errors import InputError
from mmnn_pin.lab.experiments.cases import chosen_cases
from research.contest.settings import load_contest
from research.contest.task import tasks_of

CIRCLE = "base={type='circle',radius=1.0,speed=1.0}"
BAD = {
    "contest.knows.kinematics=['nosuch']": "contest.knows.kinematics: error: unknown controller 'nosuch'",
    "contest.knows.kinematics='x'": "contest.knows.kinematics: error: 'x' is a text: give a list",
    "contest.knows.kinematics=['pd', 3]": "contest.knows.kinematics.1: error: 3 is a whole number: give a text",
    "contest.knows.form=['adaptive']": "contest.knows.form: error: 'adaptive' is in kinematics, too: name it once",
    "contest.beside=['adaptiv']": "contest.beside: error: unknown controller 'adaptiv': did you mean 'adaptive'?",
    "contest.targets.task='nosuch'": "contest.targets.task: error: unknown task 'nosuch'",
    "contest.targets.frozen_fvu.form=inf": "contest.targets.frozen_fvu.form: error: inf: give finite numbers > 0",
    "contest.targets.frozen_fvu.form='x'": "contest.targets.frozen_fvu.form: error: 'x' is a text: give a number",
    "contest.targets.near=inf": "contest.targets.near: error: inf is negative or not finite",
}
LATER = {  # told when the tasks are made, still before anything is run
    "nominal.robot='nosuch'": "nominal.robot: error: unknown robot 'nosuch'",
    "nominal.robot='two_axis_arm'": "nominal.robot: error: two_axis_arm does not move as platform_arm",
    "nominal.masses={nosuch=1.0}": "nominal.masses: error: unknown body 'nosuch'",
    "contest.window=1e-9": "contest.window: error: 1e-09 s: use a time from the control period",
    "contest.window=1000": "contest.window: error: 1000 s: use a time from the control period",
    "contest.start=1e-9": "contest.start: error: 1e-09 s",
    "windows=[]": "windows: error: no windows: the errors count in the last",
    f"held_out.mine={{duration=0.5, {CIRCLE}}}": "held_out.mine.duration: error: 0.5 s: the first 0.5 s do not count",
    f"held_out.mine={{{CIRCLE}}}": "held_out.mine.arm: error: 0 profiles for 2 arm joints: add one [[held",
    "held_out.mine={base={type='circle', speed=1.0}}": "held_out.mine.base: error: 'circle' without radius",
}


@pytest.mark.parametrize("text", BAD)
def test_a_bad_setting_is_told_with_its_key(text: str) -> None:
    with pytest.raises(InputError) as caught:
        load_contest("contest", [text])
    assert BAD[text] in str(caught.value) and "contest.toml" not in str(caught.value)  # the file does not say it


@pytest.mark.parametrize("text", LATER)
def test_what_only_a_robot_shows_is_told_before_anything_runs(text: str) -> None:
    with pytest.raises(InputError) as caught:
        tasks_of(chosen_cases(load_contest("contest", [text]), ["eight"]), ("pd", "nominal"))
    assert LATER[text] in str(caught.value) and "`" not in str(caught.value)
