"""Controllers compared without a file: names and objects, settings, equal starts, and what the result shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mmnn_pin import (
    PD,
    Feedback,
    LearningLaw,
    Line,
    Loop,
    Sine,
    Timing,
    Trajectory,
    compare,
    load,
    load_experiment,
    torque,
)
from mmnn_pin.actuator import Actuator
from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, InputError, UnknownName
from mmnn_pin.lab.experiments.compare import DEFAULTS, assembled
from mmnn_pin.lab.experiments.config import complete, find, recorded_experiment
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.torque.controller import ControllerState, TorqueController
from mmnn_pin.torque.entries import CONTROLLERS

SHORT = 0.04


@pytest.fixture(scope="module")
def robot():
    return load("platform_arm")


@pytest.fixture(scope="module")
def path(robot):
    return Trajectory.of(robot, base=Line(speed=0.3), arm={"arm_1_joint": Sine(0.5, 4.0)})


class Bias(LearningLaw):
    """One constant per velocity."""

    rate: float = 10.0

    def init(self, context):
        return ControllerState.of(bias=(context.layout.dof,))

    def estimate(self, sample, state):
        return state["bias"]

    def learn(self, sample, state):
        state["bias"] += self.rate * sample.period * sample.s


class Sleeper(TorqueController):
    """No torque at all."""

    def step(self, time, reference, measurement, command, state):
        return np.zeros(4)


def test_gains_and_learners_are_those_of_track():
    track = complete(find("track"))
    assert {key: track[key] for key in DEFAULTS} == DEFAULTS
    of_the_run = {"title", "robot", "controllers", "seed", "windows", "time", "reference", "actuator", "torque_limits"}
    assert set(track) - of_the_run == set(DEFAULTS)


def test_names_and_objects_stand_beside_each_other(robot, path):
    runs = compare(robot, path, ["pd", PD(Feedback(300.0, 5.0), name="stiff"), Bias(), Sleeper()], duration=SHORT)
    assert list(runs) == ["pd", "stiff", "Bias", "custom"] and runs.completed
    assert runs["stiff"].meta["controller"] == "stiff"
    track = load_experiment("track", [f"time.duration={SHORT}"])
    timing = Timing(duration=SHORT, integrator="implicit_friction")
    loop = replace(track.loop(robot, PD()), trajectory=path, controller=PD(), timing=timing, actuator=Actuator())
    alone = loop.run()
    np.testing.assert_array_equal(runs["pd"]["torque"], alone["torque"])
    assert recorded_experiment(runs["pd"]) is None
    assert not runs["custom"]["torque"].any() and runs["Bias"]["psi_hat"].any()
    with pytest.raises(UnknownName, match="did you mean 'stiff'"):
        runs["stif"]


def test_two_of_a_kind_need_names_of_their_own(robot, path):
    with pytest.raises(ConfigError, match="two controllers are called pd"):
        compare(robot, path, [PD(), PD()])
    soft, hard = PD(Feedback(100.0, 1.0)), PD(Feedback(400.0, 8.0))
    runs = compare(robot, path, {"pd soft": soft, "pd hard": hard}, duration=SHORT)
    assert list(runs) == ["pd soft", "pd hard"] and soft.name == "pd"
    assert float(runs["pd hard"]["effective_gain"][0, 0]) == 400.0


@pytest.mark.parametrize("name", [name for name, entry in CONTROLLERS.items() if not entry.gain_of])
def test_every_controller_has_gains_that_suit_the_robot(name, robot, path):
    """In Python as in a file: what was not given is chosen for the robot, and the loop is stable with it."""
    made = assembled(robot, path, [name], duration=SHORT)
    loop = made.loop(robot, made.controller(name, robot=robot))
    loop.require_stable_gains()
    context = loop.context()
    assert (loop.controller.feedback_gain(context.layout) > 0).all()


@pytest.mark.parametrize("kind", [torque.PD, torque.PID, torque.Neural, torque.ComputedTorque, torque.ExtendedState])
def test_a_controller_made_without_arguments_gets_the_same_gains(kind, robot, path):
    gains = Loop(robot, path, PD()).controller.feedback
    controller = Loop(robot, path, kind()).controller
    assert controller.feedback == gains


def test_settings_are_the_keys_of_an_experiment(robot, path):
    settings = {"feedback.arm": 3.0, "time.control_period": 0.004, "seed": 5, "masses": 1.2}
    runs = compare(robot, path, "pd", duration=0.019, settings=settings)
    run = runs["pd"]
    assert run.meta["seed"] == 5 and len(run) == 5  # up to the next whole control period
    assert run["effective_gain"][0, 2] == 3.0
    np.testing.assert_allclose(run.meta["mass_factors"]["root"], 1.2)


def test_what_is_said_of_a_robot_in_python_stays(robot, path):
    heavy = robot.with_masses(2.0).with_friction(3.0).with_armature(0.1)
    run = compare(heavy, path, ["pd"], duration=SHORT)["pd"]
    assert set(run.meta["mass_factors"].values()) == {2.0} and run.meta["armature"] == [0.1, 0.1]
    assert set(run.meta["viscous"]) == {3.0}


def test_a_run_takes_as_long_as_its_trajectory(robot):
    ends = Trajectory.from_waypoints(robot, base=[(0, 0), (0.4, 0)], speed=0.3, arm=[(0, 0), (0.1, 0.1)])
    made = assembled(robot, ends, ["pd"])
    assert 0 <= made.time.duration - ends.duration < made.time.control_period
    assert made.windows == ((0.0, 1.0), (1.0, made.time.duration))
    assert assembled(robot, replace(ends, slowness=2.0), ["pd"]).time.duration > 2 * ends.duration - 1e-9


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robot": "platform_arm"}, "write load|load\\('tiago'\\)"),
        ({"trajectory": Line(0.3)}, "Line is no Trajectory"),
        ({"controllers": []}, "no controllers"),
        ({"controllers": ["pdd"]}, "did you mean 'pd'"),
        ({"controllers": [PD]}, "write PD\\(\\)"),
        ({"controllers": [3]}, "int is no controller"),
        ({"controllers": {"mine": "pd"}}, "'pd' under another name"),
        ({"controllers": {"a/b": PD()}}, "no name for a file"),
        ({"settings": {"feedback.am": 1.0}}, "unknown key 'am'"),
        ({"settings": {"feedback.arm": "much"}}, "feedback.arm"),
        ({"settings": {"reference.file": "x.csv"}}, "beside the objects"),
        ({"duration": -1.0}, "time.duration"),
        ({"duration": float("nan")}, "time.duration"),
    ],
)
def test_wrong_arguments_are_one_line_that_says_what_to_give(change, words, robot, path):
    arguments = {"robot": robot, "trajectory": path, "controllers": ["pd"], "duration": SHORT} | change
    with pytest.raises(InputError, match=words) as refused:
        compare(**arguments)
    assert "\n" not in str(refused.value)


def test_a_result_shows_itself(robot, path, tmp_path):
    runs = compare(robot, path, ["pd", Bias()], duration=0.1)
    text = str(runs.table())
    assert "pose x [mm]" in text and "Bias" in text and str(runs) == text
    assert repr(runs) == "<Result: pd completed, Bias completed>"
    assert runs.plot().save(tmp_path / "errors.svg").read_text().startswith("<?xml")
    with pytest.raises(UnknownName, match="did you mean 'errors'"):
        runs.plot("erors")
    assert runs.report().save(tmp_path / "report.html").stat().st_size > 1000
    assert runs.replay().save(tmp_path / "replay.html").stat().st_size > 1000
    assert "<img" in runs._repr_html_() and "<pre>" in runs._repr_html_()


def test_light_wrists_in_stiff_joints_do_not_diverge():
    """TIAGo's wrist has milligrams and friction: rk4 loses it within 4 ms."""
    tiago = load("tiago")
    runs = compare(tiago, Trajectory.of(tiago, base=Line(speed=0.3, ramp=0.5)), ["pd"], duration=0.02)
    assert runs.completed and runs["pd"].errors()["arm_7_joint"].peak < 0.01


def test_a_comparison_notes_that_motors_have_no_limits(robot, path):
    notes = compare(robot, path, ["pd"], duration=SHORT).notes
    (note,) = [note for note in notes if "effort limits" in note]
    settings = eval(note.partition("settings=")[2].rpartition(" keeps")[0])
    limited = compare(robot, path, ["pd"], duration=SHORT, settings=settings)
    assert not [note for note in limited.notes if "effort limits" in note]
    assert limited.experiment.actuator.torque_limit == "urdf"
    free = replace(robot, effort_limits=np.full(len(robot.effort_limits), np.inf))
    assert not [note for note in compare(free, path, ["pd"], duration=SHORT).notes if "effort limits" in note]


def test_friction_is_added_to_the_urdfs_damping_as_the_keys_say(robot, tmp_path, capsys):
    text = robot.path.read_text().replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><dynamics damping="0.2"/>')
    (file := tmp_path / "rubs.urdf").write_text(text)
    damped, nu = load(file), np.array([0.0, 0.0, 1.0, 1.0])
    given = load_experiment("track", [f'robot="{file}"', "friction.arm=0.3"]).load_robot()
    np.testing.assert_allclose(Dynamics(damped).friction(nu)[2:].max(), 0.2)
    np.testing.assert_allclose(Dynamics(given).friction(nu) - Dynamics(damped).friction(nu), [0.0, 0.0, 0.3, 0.3])
    for key in ("friction.base", "friction.arm", "friction.coulomb"):
        assert main(["docs", key]) == 0
        assert "added to" in capsys.readouterr().out


def test_who_knows_what_of_changed_masses_is_said() -> None:
    robot = load("platform_arm")
    path = Trajectory.of(robot, base=Line(speed=0.3))
    names = ["pd", "feedforward", "adaptive", "computed_torque"]
    told = compare(robot.with_masses(1.2), path, names, duration=0.1).notes
    [note] = [note for note in told if note.startswith("masses are not those of the file")]
    assert "feedforward know those of the file; computed_torque know the true ones" in note
    assert "adaptive know these times nominal.masses; the others none" in note
    assert not any("masses are not" in note for note in compare(robot, path, ["pd"], duration=0.1).notes)
