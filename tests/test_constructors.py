"""Everything public, called with values of wrong types: the package's error with key and value, never a bare one."""

from __future__ import annotations

import inspect
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from test_strangers import WRONG

import mmnn_pin
from mmnn_pin import (
    PD,
    Feedback,
    Line,
    Loop,
    Measurement,
    Setpoint,
    Stepper,
    StepperSettings,
    Timing,
    Trajectory,
    load,
    load_experiment,
)
from mmnn_pin.errors import ConfigError, InputError, MmnnError
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.settings.arguments import HOW, fits, hints
from mmnn_pin.torque.adaptive import Adaptive
from mmnn_pin.torque.learning_law import LearningLaw

ODD = [*WRONG, "pd", np.zeros(2), np.zeros((2, 2)), ["a"], ((1, 2), (3,)), lambda: 1, object(), {"x": "y"}, 10**400]
LONG = ("check", "compare", "embed", "identify", "judge", "run_experiment", "sweep", "Recording", "Robot")


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> dict[str, dict[str, Any]]:
    """Arguments of everything public that are as they should be."""
    robot = load("platform_arm")
    path = Trajectory.of(robot, base=Line(0.3))
    four, three = dict.fromkeys(("pose", "velocity", "q", "qdot"), np.zeros(2)), {"acceleration": np.zeros(2)}
    known = {
        "PD": {"feedback": Feedback(base=300.0, arm=40.0)},
        "Circle": {"radius": 1.0, "speed": 0.3},
        "Eight": {"length": 2.0, "width": 1.0, "period": 20.0},
        "Hold": {"value": 0.3},
        "InputError": {"what": "x"},
        "Line": {"speed": 0.3},
        "Loop": {"robot": robot, "trajectory": path, "controller": PD(), "timing": Timing(duration=0.01)},
        "Measurement": four,
        "Setpoint": four | three | {"qddot": np.zeros(2)},
        "Sine": {"amplitude": 0.3, "period": 4.0},
        "Stepper": {"robot": robot, "controller": PD()},
        "Trajectory": {"base": Line(0.3)},
        "check": {"robot": robot},
        "compare": {"robot": robot, "trajectory": path, "duration": 0.01},
        "embed": {"loop": Loop(robot, path, PD()), "folder": tmp_path_factory.mktemp("c") / "out"},
        "identify": {"robot": robot, "logs": []},
        "load": {"robot": "two_axis_arm"},
        "load_experiment": {"name_or_path": "track"},
        "judge": {},
        "run_experiment": {"experiment": load_experiment("track"), "name": "track"},
        "sweep": {"robot": robot, "trajectory": path, "key": "time.control_period", "values": [0.002]},
        "Robot": {field: getattr(robot, field) for field in robot.__dataclass_fields__},
        "Trajectory.of": {"robot": robot},
        "Trajectory.from_waypoints": {"robot": robot, "base": [(0, 0), (1, 0)]},
        "Trajectory.from_arrays": {"robot": robot, "time": [0, 1, 2], "q": {"arm_1_joint": [0, 0.1, 0.2]}},
        "Trajectory.from_csv": {"robot": robot, "file": "nowhere.csv"},
        "Recording": {"columns": {}, "rows": 0, "read": dict, "meta": {}, "texts": {}, "outcome": None},
        "Recording.open": {"path": "nowhere.h5"},
    }
    return {name: known.get(name, {}) for name in {*mmnn_pin.__all__, *known}}


def public(name: str) -> Callable[..., Any]:
    first, _, method = name.partition(".")
    found = getattr(mmnn_pin, first)
    return getattr(found, method) if method else found


def parameters(thing: Callable[..., Any]) -> list[str]:
    return [name for name in inspect.signature(thing).parameters if name != "self"]


METHODS = ["Trajectory.of", "Trajectory.from_waypoints", "Trajectory.from_arrays", "Trajectory.from_csv"]
NAMES = [n for n in mmnn_pin.__all__ if n not in ("TorqueController", "LearningLaw")] + [*METHODS, "Recording.open"]


@pytest.mark.parametrize("name", NAMES)
def test_arguments_of_wrong_types_are_one_line_with_key_and_value(name, sound, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    thing, rng, refused = public(name), random.Random(name), 0
    kinds = hints(thing) | (hints(thing.__init__) if inspect.isfunction(getattr(thing, "__init__", None)) else {})
    for key in parameters(thing):
        for value in rng.sample(ODD, 12):
            known = key in kinds
            if name in LONG and known and fits(value, kinds[key]):
                continue  # it would begin to work
            try:
                thing(**(sound[name] | {key: value}))
            except MmnnError as error:
                assert "\n" not in str(error) and "internal" not in str(error)
                if known and not fits(value, kinds[key]) and isinstance(error, ConfigError):
                    assert error.key is None or key in error.key or "." in error.key, str(error)
                refused += 1
            except TypeError as error:
                assert "missing a required argument" in str(error), (key, value)
    if name not in ("InputError", "Measurement", "Setpoint"):  # texts; views that a stepper holds against its robot
        assert refused > 5


def test_ten_wrong_arguments_say_what_was_expected(sound):
    robot, path = sound["Loop"]["robot"], sound["Loop"]["trajectory"]
    cases: list[tuple[Callable[[], Any], str]] = [
        (lambda: Loop(robot, path, "pd"), "Loop.controller: error: 'pd' is a text: give a TorqueController or a Compi"),
        (lambda: Loop(robot, Line(0.3), PD()), "Loop.trajectory: error: Line(speed=0.3, start=(0.0, 0.0, 0.0), ramp="),
        (lambda: Loop("platform_arm", path, PD()), "Loop.robot: error: 'platform_arm' is a text: give a Robot, such"),
        (lambda: Loop(robot, path, PD(), seed=0.5), "Loop.seed: error: 0.5 is a number: give a whole number"),
        (lambda: Loop(robot, path, PD(), engine="fast"), "Loop.engine: error: 'fast' is a text: give 'auto' or 'com"),
        (lambda: Stepper(robot, "pd"), "Stepper.controller: error: 'pd' is a text: give a CompiledController, such as"),
        (lambda: PD(3.0), "PD.feedback: error: 3.0 is a number: give a Feedback"),
        (lambda: Adaptive("x"), "Adaptive.regressor: error: 'x' is a text: give a Regressor"),
        (lambda: Line("x"), "Line.speed: error: 'x' is a text: give a number"),
        (lambda: load(5), "load.robot: error: 5 is a whole number: give a text or a path"),
        (lambda: load("platform_arm", wheels="x"), "load.wheels: error: 'x' is a text: give a list, each item a text"),
        (lambda: Timing(duration=True), "Timing.duration: error: true is true or false: give a number"),
    ]
    for call, says in cases:
        with pytest.raises(InputError) as raised:
            call()
        assert str(raised.value).startswith(says), str(raised.value)


def refuses(call: Callable[..., Any], *given: Any, **named: Any) -> bool:
    """Whether a call is refused by an error of the package, in one line."""
    with pytest.raises(MmnnError) as raised:
        call(*given, **named)
    return "\n" not in str(raised.value) and "error: " in str(raised.value)


@pytest.mark.parametrize("value", ["x", None, [1, "a"], {"a": 1}, object(), 1j], ids=lambda value: type(value).__name__)
def test_methods_refuse_wrong_types_in_one_line(value, sound):
    robot, loop = sound["Loop"]["robot"], Loop(**sound["Loop"])
    run, here = loop.run(), robot.neutral()
    assert refuses(robot.placement, value, here) and refuses(robot.jacobian, value, here)
    assert value is None or refuses(robot.random, value)
    assert all(refuses(getattr(robot, f"with_{name}"), value) for name in ("friction", "armature", "masses", "radii"))
    assert refuses(run.errors, start=value) and refuses(simulate_many, [value])
    with Stepper(robot, PD()) as stepper:
        assert refuses(stepper.step, value) and refuses(stepper.step, 0.0, run, measured=value)


def test_facts_that_no_file_can_hold_are_refused(sound):
    circle: list[Any] = []
    circle.append(circle)
    for value in (object(), circle, {"a": {1, 2}, "b": object()}):
        assert refuses(Loop(**sound["Loop"]).run, meta={"a": value})


@pytest.mark.parametrize(("key", "value"), [("period", 0.0), ("period", -1.0), ("observer", -5.0)])
def test_a_steppers_numbers_are_told_by_its_own_keys(key, value, sound):
    with pytest.raises(ConfigError, match=f"^{key}: error: {value} "):
        Stepper(sound["Loop"]["robot"], PD(), StepperSettings(**{key: value}))


def test_what_an_error_tells_to_give_is_of_that_kind(sound):
    given = {name: getattr(mmnn_pin, name) for name in mmnn_pin.__all__} | sound["Loop"]
    for kind, how in HOW.items():
        if kind != "Recording":  # needs a file
            made = eval(how, dict(given))
            assert kind in {one.__name__ for one in type(made).__mro__}, how


def test_a_law_of_ones_own_is_checked_as_well():
    class Mine(LearningLaw):
        rate: float = 1.0

        def init(self, context): ...
        def estimate(self, sample, state): ...
        def learn(self, sample, state): ...

    assert Mine(rate=2).rate == 2
    with pytest.raises(ConfigError, match=r"Mine\.rate: error: 'x' is a text: give a number"):
        Mine(rate="x")


def test_a_measurement_or_a_setpoint_of_wrong_types_is_one_line_or_no_measurement(sound):
    stepper = Stepper(**sound["Stepper"])
    good = Measurement(np.zeros(3), np.zeros(2), np.zeros(2), np.zeros(2))
    goal = Setpoint(np.zeros(3), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2))
    refused = 0
    for value in ODD:
        for seen, wish in ((value, goal), (good, value), (Measurement(value, *[np.zeros(2)] * 3), goal)):
            try:
                stepper.step(0.0, seen, wish)
            except MmnnError as error:
                assert "\n" not in str(error)
                refused += 1
    assert refused > 2 * len(ODD)
