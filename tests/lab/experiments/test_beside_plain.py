"""What is said of runs that are worse than plain control: by `compare`, by the command line's JSON, by the numbers."""

from __future__ import annotations

import numpy as np
import pytest

from mmnn_pin import PD, Feedback, Sine, TorqueController, Trajectory, compare, load
from mmnn_pin.lab.experiments.beside_plain import compared, errors_of, times, worse_than_plain
from mmnn_pin.lab.experiments.result import WORSE

ROBOT = load("two_axis_arm")
SWING = Trajectory.of(ROBOT, arm=dict.fromkeys(ROBOT.joint_names, Sine(0.4, period=2.0)))
GAINS = np.array([6.0, 0.8])


class Added(TorqueController):
    """The feedback times a factor, and a torque that changes sign at every sample."""

    def __init__(self, factor=1.0, rings=0.0):
        self.factor, self.rings, self.sign = factor, rings, 1.0

    def step(self, time, reference, measurement, command, state):
        self.sign = -self.sign
        return self.factor * GAINS * command.r + self.rings * self.sign


CASES = {
    "alike": Added(),
    "stronger": Added(2.0),
    "weaker": Added(0.4),
    "shaking": Added(1.5, rings=4.0),
}


@pytest.fixture(scope="module")
def found():
    return compare(ROBOT, SWING, {"pd": PD(Feedback(None, (6.0, 0.8))), **CASES}, duration=2.0)


def test_runs_that_err_more_spend_more_or_shake_are_told_and_others_are_not(found):
    worse = found.worse
    assert set(worse) == {"weaker", "shaking"}
    assert "the arm errs" in worse["weaker"] and "worse than plain control (pd)" in worse["weaker"]
    assert "its effort is" in worse["shaking"] and "it shakes arm_" in worse["shaking"]
    assert "errs" not in worse["shaking"]


def test_every_way_of_telling_has_it_and_the_runs_are_done_all_the_same(found):
    runs = found.to_dict()["runs"]
    assert {name: run["outcome"] for name, run in runs.items()} == {
        "pd": "completed", "alike": "completed", "stronger": "completed", "weaker": WORSE, "shaking": WORSE,
    }  # fmt: skip
    assert found.completed
    assert found.worse["shaking"] in found.to_dict()["comparison"]["notes"]
    text = str(found)
    assert "worse" in text and "than plain" in text


def test_errors_are_root_mean_squares_after_the_start(found):
    run = found["weaker"]
    e = np.asarray(run["e"])[len(run) // 5 :]
    assert errors_of(run) == pytest.approx({"the arm": np.linalg.norm(e) / np.sqrt(len(e))}, rel=1e-6)
    assert not compared(run, run)


def test_effort_is_no_fault_beside_plain_control_that_is_lost():
    """Plain control with hardly any gain spends next to nothing, and turns away by more than a radian."""
    idle = PD(Feedback(None, (6e-3, 8e-4)))
    wide = Trajectory.of(ROBOT, arm=dict.fromkeys(ROBOT.joint_names, Sine(1.5, period=2.0)))
    lost = compare(ROBOT, wide, {"pd": idle, "alike": Added()}, duration=2.0)
    spent = [float(np.sum(run["motor_torque"] ** 2)) for run in (lost["alike"], lost["pd"])]
    assert lost.lost.keys() == {"pd"} and spent[0] > 10 * spent[1] and not lost.worse


def test_plain_control_is_run_where_none_was_asked_for():
    alone = compare(ROBOT, SWING, {"weaker": Added(0.4)}, duration=0.4, settings={"feedback.arm": [6.0, 0.8]})
    assert list(alone) == ["weaker"] and alone.plain is not None
    assert "(pd_gravity)" in alone.worse["weaker"]
    assert worse_than_plain(alone.recordings) == {}  # without one nothing is said


@pytest.mark.parametrize(("ratio", "words"), [(2.34, "2.3 times"), (99.0, "99 times"), (3412.0, "3,400 times")])
def test_factors_are_told_in_two_digits(ratio, words):
    assert times(ratio) == words
