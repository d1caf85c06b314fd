"""Messages on an experiment that cannot run: which key is to blame, or which robot it is made for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import msgspec

from ...errors import LENGTH, ConfigError, InputError, UnknownName
from ...model.loading import load_with
from ...model.robot import Robot
from .config import find, find_variant, users_own
from .experiment import Experiment
from .origins import of_override, placed

SIZED = ("feedback", "friction", "masses", "radii", "sensor", "actuator", "interfaces")  # may hold lists of joints
OF_POSE = "sensor.pose_noise"
ANY = "track"  # drives any robot


def explained(error: InputError, name: str, asked: Experiment, own: Experiment) -> InputError:
    """An error about the length of a list, or a name that a robot lacks, in the words of who gave another robot.

    Args:
        error: What the run of an experiment was refused for.
        name: The experiment's name.
        asked: The experiment as it was asked for.
        own: As its file has it, with the robot that it is made for.

    Returns:
        The error itself where it is about something else.
    """
    wrong = error.code == LENGTH or isinstance(error, UnknownName)
    if not wrong or not error.key or (asked.robot, asked.overrides) == (own.robot, own.overrides):
        return error
    here, there = (load_with(one.robot, one.overrides) for one in (asked, own))
    made = list(sized(own, there, here))
    if not any(error.key.endswith(key) for key in made):  # the user's own
        return error
    what = f"{name} is made for {there.name} and its {count(there)}: {', '.join(made)}"
    fix = f"take {ANY}, which drives any robot: mmnn run {ANY} --robot {asked.robot}; or set these for {here.name}"
    return ConfigError(what, why=f"{here.name} has {count(here)}", fix=fix, key="--robot")


def count(robot: Robot) -> str:
    """Number of its arm joints, in words."""
    n = robot.dimensions.arm
    return f"{n} arm joint{'s' * (n != 1)}"


def sized(experiment: Experiment, robot: Robot, other: Robot) -> Iterator[str]:
    """Keys of an experiment whose values suit one robot alone: one for each of its joints, or its joints by name.

    Args:
        experiment: The experiment.
        robot: The robot that it is made for.
        other: The one that it should drive.
    """
    arm = experiment.reference.arm
    if not isinstance(arm, dict) and len(arm) != other.dimensions.arm:
        yield "reference.arm"
    table = msgspec.to_builtins(experiment)
    for key, value in flat({name: table[name] for name in SIZED}):
        if isinstance(value, dict):
            if set(value) & (names_of(robot) - names_of(other)):
                yield key
        elif isinstance(value, list | tuple) and key != OF_POSE:
            fits = [{one.dimensions.base} if key.endswith(".base") else lengths_of(one) for one in (robot, other)]
            if len(value) in fits[0] - fits[1]:
                yield key


def names_of(robot: Robot) -> set[str]:
    """Names of its joints and motors."""
    return {*robot.position_names, *robot.actuator_names}


def lengths_of(robot: Robot) -> set[int]:
    """Lengths of lists that have a number for each joint of its arm, velocity, motor, or joint."""
    size = robot.dimensions
    return {size.arm, size.dof, len(robot.actuator_names), size.full}


def flat(table: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Key paths and values of nested tables; a table is a value, too."""
    for key, value in table.items():
        yield f"{before}{key}", value
        if isinstance(value, dict):
            yield from flat(value, f"{before}{key}.")


# -- which key is to blame -------------------------------------------------------------------------------------------


def located(error: InputError, name_or_path: str, overrides: Iterable[str], variant: str | None = None) -> InputError:
    """An error at a key of an experiment that was met after it was loaded: from which override or line of a file.

    Args:
        error: It.
        name_or_path: The experiment, as of `load_experiment`.
        overrides: Likewise.
        variant: Likewise.

    Returns:
        The error with its file and line, or its option, where the key is found in what is the user's to change.
    """
    texts = tuple(overrides)
    if error.file is not None or not error.key or error.key.startswith("-"):
        return error
    if (found := of_override(error, texts)).option:
        return found
    if any(text.partition("=")[0].strip().partition(".")[0] == error.key.partition(".")[0] for text in texts):
        return error  # by an option
    path = find(name_or_path)
    found = placed(error, *users_own(path if variant is None else find_variant(path, variant)))
    return found if found.line else error
