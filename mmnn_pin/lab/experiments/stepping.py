"""A stepper of a robot on hardware that has a name."""

from __future__ import annotations

from typing import Any

from ...loop.stepper import Stepper
from ...model.robot import Robot
from ...safety import Safety
from .config import load_experiment


def stepper_on(robot: Robot, hardware: str, controller: str = "pd", **more: Any) -> Stepper:
    """A stepper of a robot with all that follows from its hardware: rate, interfaces, servos, latency, gains.

    Args:
        robot: The robot.
        hardware: Name of a profile, or a file.
        controller: Name of a controller, with the settings of `track`.
        more: Fields of `StepperSettings` that differ.

    Raises:
        InputError: No such hardware or controller; one that does not suit the robot.
    """
    experiment = load_experiment("track", [f"robot={str(robot.path)!r}", f"hardware={hardware!r}"])
    loop = experiment.loop(robot, controller)
    return Stepper.of(loop, **{"safety": loop.safety or Safety()} | more)
