"""The nominal robot of an experiment: what its model-based controllers believe, deliberately not quite the truth."""

from __future__ import annotations

import numpy as np

from ...errors import ConfigError, InputError, UnknownName
from ...model.base.overrides import Overrides
from ...model.loading import load_with
from ...model.robot import Robot
from ...model.tree.body import parameters
from ...settings import Settings
from ...signals import Array


class Nominal(Settings, frozen=True):
    """A model that is wrong on purpose: the start of `adaptive`, the model of `nominal` and of every residual learner.

    Args:
        robot: Name or path of a robot that moves alike; empty for the robot itself.
        masses: Factor on its inertias, one for all bodies or one per joint that carries a body, see `with_masses`.
        friction: Whether it knows the friction: of joints, gears and base.

    Raises:
        ConfigError: A factor that is not finite and positive.
    """

    robot: str = ""
    masses: float | dict[str, float] = 0.7
    friction: bool = False

    def __post_init__(self) -> None:
        factors = np.array([*self.masses.values()] if isinstance(self.masses, dict) else [self.masses], float)
        if not (factors.size and (np.isfinite(factors) & (factors > 0)).all()):
            raise ConfigError(f"{self.masses}", fix="use finite factors > 0", key="nominal.masses")


def require_robot(robot: Robot | None, what: str) -> Robot:
    """The robot that a controller is made for.

    Raises:
        ConfigError: There is none.
    """
    if robot is None:
        raise ConfigError(f"{what} of no robot", fix="give the robot", key="controllers")
    return robot


def nominal_robot(nominal: Nominal, robot: Robot | None, said: Overrides) -> Robot:
    """The robot that is believed in.

    Args:
        nominal: What is said of it.
        robot: The robot that the controllers are made for.
        said: What the experiment says about its robots.

    Raises:
        ConfigError: No robot, or a nominal one that moves otherwise.
        UnknownName: No robot of that name, or no such body.
        InputError: It cannot be loaded, or has no such body.
    """
    robot = require_robot(robot, "a nominal model")
    try:
        believed = load_with(nominal.robot, said) if nominal.robot else robot
    except UnknownName as error:
        error.key = "nominal.robot"
        raise
    alike = (believed.layout.dof, believed.layout.base) == (robot.layout.dof, robot.layout.base)
    if not alike or not np.array_equal(believed.T, robot.T):
        fix = "name one with the same base and the same joints"
        raise ConfigError(f"{believed.name} does not move as {robot.name}", fix=fix, key="nominal.robot")
    try:
        believed = believed.with_masses(nominal.masses)
    except InputError as error:
        error.key = "nominal.masses"
        raise
    return believed if nominal.friction else believed.without_friction()


def nominal_parameters(nominal: Nominal, robot: Robot | None, said: Overrides) -> Array:
    """Its parameters, (k,), with which a regressor of the robot gives its Psi; arguments and errors as above."""
    return parameters(nominal_robot(nominal, robot, said))
