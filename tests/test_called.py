"""All that a user may call, with arguments of wrong types, shapes and values: only the package's errors leave."""

from __future__ import annotations

import inspect
import random
from collections import Counter
from collections.abc import Callable, Iterator
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_constructors import ODD

from mmnn_pin import (
    PD,
    Line,
    Loop,
    Measurement,
    Recording,
    Setpoint,
    Stepper,
    StepperSettings,
    Timing,
    Trajectory,
    compare,
    judge,
    load,
    load_experiment,
)
from mmnn_pin.errors import ConfigError, MmnnError
from mmnn_pin.loop.batch import simulate_many
from mmnn_pin.model.urdf.finding import AuditError
from mmnn_pin.reference.motion import Motion
from mmnn_pin.reference.wishes import HOLD, BaseVelocity, JointGoal
from mmnn_pin.safety import Safety
from mmnn_pin.settings.arguments import faced, shortly
from mmnn_pin.signals import Array

CALLS = 3_000
SHAPED = [np.zeros(5), np.full(5, np.nan), np.full(2, 1e308), np.zeros(0), np.array("x"), [None], [[0] * 5] * 5, {1, 2}]
SHAPED += [
    np.zeros(5, complex),
    np.zeros(5, object),
    np.float32(3),
    2**63,
    -(2**63),
    float("inf"),
    -0.0,
    1e308,
    range(3),
]
NUMBERS = [np.int64(3), np.bool_(True), np.array(3.0), np.broadcast_to(0.0, 2), np.ma.masked, Decimal("sNaN"), 10**400]
NUMBERS += [np.ma.masked_array([1.0, 2.0], [0, 1]), np.array([10**30, 1], object), np.zeros(2, ">f8"), Fraction(1, 3)]
TEXTS = [
    "\ud800",
    "a\0b",
    Path("a\0b"),
    "x" * 10**5,
    "z\nz",
    np.str_("z"),
    bytearray(b"z"),
    iter("z"),
    "\x1b[31m",
    "/dev/zero",
]


def own(name: str) -> Any:
    """An object of which one method raises an error of its own."""

    def fail(*_: Any) -> Any:
        raise LookupError(name)

    return type("Own", (), {name: property(fail) if name == "__class__" else fail})()


METHODS = ("repr", "eq", "hash", "len", "bool", "iter", "array", "array_ufunc", "float", "index", "fspath", "getattr")
OWN = [own(f"__{name}__") for name in (*METHODS, "getattribute", "class")]
OWN += [[OWN[0]], (OWN[0], 1.0), {"a": OWN[0]}, np.array([OWN[0]], object), np.array(None), np.array({"a": 1.0})]
VALUES = [
    *ODD,
    *SHAPED,
    *NUMBERS,
    *TEXTS,
    *OWN,
    "0.5",
    "arm_1_joint",
    "base_link",
    "v",
    "z",
    ...,
    np.zeros(2, [("a", "f8")]),
]
LONG = {"run", "view", "replay", "report", "plot", "save"}  # they would work, or write
AT_REST = Measurement(np.zeros(3), np.zeros(2), np.zeros(2), np.zeros(2))


def stepper() -> Stepper:
    made = Stepper(load("platform_arm"), PD(), StepperSettings(safety=Safety(torque="urdf")))
    made.step(0.0, AT_REST)
    return made


@pytest.fixture(scope="module")
def things() -> list[Any]:
    """What a user has in hand."""
    robot = load("platform_arm")
    path = Trajectory.of(robot, base=Line(0.3))
    run = Loop(robot, path, PD(), timing=Timing(duration=0.05)).run()
    tried = compare(robot, path, ["pd", "adaptive"], duration=0.8)
    experiment = load_experiment("track", overrides=["time.duration=0.05"])
    made = [robot, load("car_arm"), load("two_axis_arm"), stepper(), run, run.errors(), path, tried, experiment]
    return [*made, judge(tried["adaptive"]), Loop(robot, path, PD(), timing=Timing(duration=0.05))]


def calls(things: list[Any]) -> Iterator[tuple[str, Callable[..., Any]]]:
    """The public methods of things, and what makes others."""
    for thing in things:
        kind = type(thing)
        for name in [*(name for name in dir(kind) if not name.startswith("_")), "__getitem__"]:
            found = inspect.getattr_static(kind, name, None)
            if callable(getattr(found, "__func__", found)) and name not in LONG and not isinstance(found, type):
                yield f"{kind.__name__}.{name}", getattr(thing, name)
    for made in (BaseVelocity, JointGoal, Motion.of, Motion.through, Trajectory.of, Trajectory.from_arrays, Stepper.of):
        yield made.__qualname__, made
    for made in (Trajectory.from_waypoints, Trajectory.from_csv, Recording.open, simulate_many):
        yield made.__qualname__, made


def sound(things: list[Any]) -> dict[str, Any]:
    """Arguments that are as they should be, by their names."""
    robot, nu = things[0], np.zeros(4)
    known = {"q": robot.neutral(), "position": robot.neutral_position(), "frame": "base_link", "rng": 0, "time": 1.0}
    known |= dict.fromkeys(("nu", "nu_ref", "nudot_ref"), nu) | dict.fromkeys(("name", "signal"), "z")
    known |= {
        "measurement": AT_REST,
        "robot": robot,
        "trajectory": things[6],
        "duration": 1.0,
        "values": {},
        "kind": str,
    }
    return known | {"layout": robot.dimensions, "t": [0.0, 1.0], "loop": things[-1], "controller": "pd", "other": "pd"}


def test_nothing_but_the_packages_errors_leaves(things, monkeypatch, tmp_path) -> None:
    monkeypatch.chdir(tmp_path)
    rng, known, every = random.Random(5), sound(things), list(calls(things))
    seen = Counter[str]()
    assert len(every) > 120
    for _ in range(CALLS):
        name, function = rng.choice(every)
        parameters = list(inspect.signature(function).parameters.values())
        given = {
            p.name: known.get(p.name, 0) for p in parameters if p.default is p.empty and p.kind < p.VAR_POSITIONAL + 2
        }
        given = {key: value for key, value in given.items() if key not in ("args", "kwargs")}
        usable = [p.name for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
        for key in rng.sample(usable, min(len(usable), rng.choice([1, 1, 2]))):
            given[key] = rng.choice(VALUES)
        try:
            function(*given.values()) if name.endswith("__getitem__") else function(**given)
            seen["done"] += 1
        except MmnnError as error:
            assert "internal" not in str(error) and (str(error).isprintable() or isinstance(error, AuditError))
            seen["refused"] += 1
        except Exception as error:
            raise AssertionError(f"{name} of {[*map(shortly, given.values())]} ended in {error!r}") from error
    assert seen["done"] > CALLS / 6 and seen["refused"] > CALLS / 4


IMPOSSIBLE = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e17, 1e9]
POSSIBLE = [0.0, -0.0, 1e-310, 0.3, -3.0, 7.0, 100.0]


def test_states_that_look_like_some_but_cannot_be_end_in_no_other_error(things) -> None:
    """Numbers of the right shapes: what a broken driver or planner hands in, one sample after another."""
    rng, robot, loops = np.random.default_rng(3), things[0], [stepper() for _ in range(4)]
    refused = 0
    for k in range(1, 400):
        one = loops[k % 4]
        if one.tripped and k % 8 == 0:
            loops[k % 4] = one = stepper()

        def some(size: int) -> Array:
            values = rng.choice(POSSIBLE, size)
            return np.where(rng.random(size) < 0.1, rng.choice(IMPOSSIBLE, size), values)

        wish = rng.choice(4)
        try:
            goal = (
                Setpoint(some(3), some(2), some(2), some(2), some(2), some(2)),
                JointGoal(tuple(some(2))) if wish == 1 else HOLD,
                BaseVelocity(tuple(some(2))) if wish == 2 else HOLD,
                None,
            )[wish]
            command = one.step(one.time + 0.002, Measurement(some(3), some(2), some(2), some(2)), goal)
            assert np.isfinite(command.motor_effort).all()
            one.plan(Trajectory.of(robot, base=Line(float(some(1)[0]))), min(float(abs(some(1)[0])), 2.0))
        except MmnnError:
            refused += 1
    assert 50 < refused < 350


def test_an_error_of_a_method_with_arguments_that_fit_stays_its_own() -> None:
    @faced
    class Thing:
        def one(self, name: str) -> None:
            raise ZeroDivisionError(name)

        def two(self, q: Array) -> Any:
            return np.zeros(3) + q

    with pytest.raises(ZeroDivisionError):
        Thing().one("a")
    with pytest.raises(ConfigError, match=r"Thing\.one\.name: error: 3 is a whole number: give a text"):
        Thing().one(3)  # type: ignore[arg-type]
    with pytest.raises(
        ConfigError, match=r"Thing\.two: error: arguments that do not fit: operands could not be broadcast"
    ):
        Thing().two(np.zeros(4))
    assert Thing().two(np.ones(3)).sum() == 3.0


@pytest.mark.parametrize("odd", [np.full(2, 1j), np.ma.masked_array([0.0, 0.0], [0, 1]), np.array([0, 10**30], object)])
def test_what_is_no_plain_array_of_numbers_is_refused(odd) -> None:
    """Numbers could be made of it: of the real part, and of what a mask says not to look at."""
    with pytest.raises(ConfigError, match="a measurement with q that is no array of numbers: give 2"):
        stepper().step(0.002, Measurement(np.zeros(3), np.zeros(2), odd, np.zeros(2)))
    with pytest.raises(ConfigError, match="nu: error: not a list of numbers"):
        load("two_axis_arm").friction(odd)
