"""The cases of the default learner: all of them can be run, what counts as lost, and the rival's torque."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from mmnn_pin import load_experiment
from research.studies.lost import (
    CASES,
    EYES,
    FIRST,
    FRESH,
    RESUMED,
    TRULY,
    UNSEEN,
    Clamped,
    Rival,
    cells,
    errors_of,
    truth_of,
)


def test_every_case_is_one_of_track() -> None:
    lists = FIRST, FRESH, UNSEEN, EYES
    assert [len(one) for one in lists] == [30] * 4 and len(CASES) == 120 and set(RESUMED) | set(TRULY) <= set(CASES)
    for said in CASES.values():
        load_experiment("track", said)


def test_a_true_robot_is_not_where_its_file_has_it() -> None:
    """Upside down gravity is the other way round; without a moved joint nothing changes."""
    file = load_experiment("track", ["robot=z1"]).load_robot()
    q = np.linspace(0.3, 0.8, 6)
    hung = truth_of(file, TRULY["hangs from the ceiling, told it stands"])
    assert np.abs(file.gravity(q)).max() > 1.0
    assert hung.gravity(q) == pytest.approx(-file.gravity(q), abs=1e-9)
    assert truth_of(file, {}).gravity(q) == pytest.approx(file.gravity(q), abs=1e-12)


@pytest.mark.parametrize("kind", [Rival, Clamped])
def test_the_rival_is_the_model_of_the_file(kind: type[Rival]) -> None:
    """Where that is right, and sensors are exact, it errs by little; with other masses by more."""
    errors = []
    for said in ((), ("masses=1.3",)):
        experiment = load_experiment("track", ["robot=panda", *said, "time.duration=1.0"])
        robot, file = experiment.load_robot(), load_experiment("track", ["robot=panda"]).load_robot()
        loop = experiment.loop(robot, experiment.controller("feedforward", robot=robot))
        rival = kind(file, loop.controller.feedback.vector(robot.dimensions))
        errors.append(errors_of(replace(loop, controller=rival).run(), robot))
    assert [one["lost"] for one in errors] == ["", ""]
    assert 20.0 * errors[0]["arm"] < errors[1]["arm"]


@pytest.mark.parametrize(("shift", "lost"), [(0.0, ""), (1.1, "errs by 1 rad or 1 m")])
def test_a_run_is_lost_where_a_joint_errs_by_a_radian(shift: float, lost: str) -> None:
    experiment = load_experiment("track", ["time.duration=0.1"])
    robot = experiment.load_robot()
    loop = experiment.loop(robot, "feedforward")
    timing = msgspec.structs.replace(loop.timing, duration=0.1)
    run = replace(loop, timing=timing).run()
    run["true_e"][50, 1] += shift
    found = errors_of(run, robot)
    assert found["lost"] == lost
    assert found["base"] == pytest.approx(np.sqrt((run["true_pose_error"][50:, :2] ** 2).sum(axis=1).mean()))


def test_a_row_says_ratios_or_what_was_instead() -> None:
    plain, lost = {"lost": "", "arm": 2.0, "base": 4.0}, {"lost": "why", "arm": 0.0, "base": 0.0}
    assert cells(plain, {"lost": "", "arm": 1.0, "base": 1.0}) == ("0.500", "0.250")
    assert (cells(plain, lost)[0], cells(lost, lost)[0]) == ("lost", "both lost")
    assert cells(plain, {"lost": "", "refused": "why"})[0] == "refused"
