"""The controllers of an experiment: their names and settings, and each of them made with what it may know of the robot.

`mmnn_pin.torque` has the list, `learner_tables` their settings; nothing here knows a single one of its learners.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Literal

import numpy as np

from ...elementary.matrices import product
from ...errors import ConfigError, UnknownName, keyed
from ...loop.suited import SCALED
from ...model.base.overrides import Overrides
from ...model.loading import load_with
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...model.tree.body import parameters
from ...settings import Settings, require_numbers
from ...signals import Array
from ...torque.controller import CompiledController, ControllerSettings, Feedback, MachineLimits, TorqueController
from ...torque.entries import CONTROLLERS as ENTRIES
from ...torque.entries import DESCRIBED, NOMINAL, Entry
from ...torque.neural import STARTS, Robust
from .laws import own_controller

CONTROLLERS = {name: entry.about for name, entry in ENTRIES.items()}
# PD at a learner's effective gain: the learner whose gain it takes, see also `effective`.
EFFECTIVE = {name: entry.gain_of for name, entry in ENTRIES.items() if entry.gain_of}
ORACLES = tuple(name for name, entry in ENTRIES.items() if entry.oracle)
# Their Psi_hat is computed from a model, not learned.
MODELS = (*ORACLES, *(name for name, entry in ENTRIES.items() if entry.baseline and DESCRIBED in entry.told))
LEARNERS = tuple(name for name, entry in ENTRIES.items() if entry.thesis)
# What an engineer has without learning; headlines compare with the best of those that ran, and miss those of `USUAL`.
PLAIN = tuple(name for name, entry in ENTRIES.items() if entry.baseline and NOMINAL not in entry.told)
USUAL = ("pd_gravity", "pid", "feedforward")
# What an experiment runs unless it says.
DEFAULT = ("two_layer", "one_layer", "pd", *EFFECTIVE, "computed_torque")
# Learners of older recordings.
GONE = ("prediction", "replay", "two_layer_composite", "disturbance_observer", "drem", "deep_residual")


def effective(controllers: Iterable[str]) -> dict[str, str]:
    """`EFFECTIVE` for controllers that run together: `pd_effective` goes with the first two-layer network of them."""
    names = set(controllers)
    return EFFECTIVE | {"pd_effective": next((name for name in ("two_layer", *STARTS) if name in names), "two_layer")}


def of_today(config: dict[str, Any]) -> dict[str, Any]:
    """The config of a recording without learners that are no more."""
    names = config.get("controllers")
    kept = [name for name in names if name not in GONE] if isinstance(names, list) else []
    config = {key: value for key, value in config.items() if key not in GONE}
    return config | {"controllers": kept or DEFAULT} if isinstance(names, list) else config


class RobustOf(Settings, frozen=True):
    """Robust terms of single learners in place of the common one; with them a comparison is no longer fair.

    Args:
        two_layer: Kz, ZB of the two-layer controller; None for the common ones.
        one_layer: Kz, ZB of the one-layer controller; None for the common ones.
    """

    two_layer: Robust | None = None
    one_layer: Robust | None = None


class Learning(Settings, frozen=True):
    """Conventions and switches of the learners.

    Args:
        rates: "per_sample" (Appendix B) or "per_second".
        update: "after_output", or "before_output" as in Appendix B.
        learning: Off keeps the initial weights.
        leakage: Off drops the e-modification.
        robust_term: Off drops the robust term (3.50).
        projection: Bound on |W|_F in units (what the feedback answers to 0.1 m/s or rad/s) and on |V|_F of every
            network: larger ones are scaled back onto it. Without it 100 for `two_layer_residual` and none for the
            thesis's networks.
        within_loop: Whether updates and robust term of the thesis's networks are cut to what the loop bears of them, as
            those of the other learners are.
        within_limits: Whether robust term and Psi_hat get only what the feedback leaves of every motor's limit, for all
            controllers. Without it they do for all learners but the thesis's networks.

    Raises:
        ConfigError: A projection that is not above 0 or not finite.
    """

    rates: Literal["per_sample", "per_second"] = "per_sample"
    update: Literal["after_output", "before_output"] = "after_output"
    learning: bool = True
    leakage: bool = True
    robust_term: bool = True
    projection: float | None = None
    within_loop: bool = False
    within_limits: bool | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "learning", ("projection",))


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


@dataclass(frozen=True)
class Granted:
    """The knowledge of a controller about its robot: the part of `torque.controller.Told` that its entry grants."""

    entry: Entry  # the controller
    robot: Robot | None  # the true robot; None where there is none
    model: Nominal  # the nominal robot, as the experiment says it
    overrides: Overrides  # what the experiment says about its robots

    @property
    def motion(self) -> Regressor:
        """The regressor of the robot, its way to move; errors as of `true`."""
        return Regressor.of(self.true("motion"))

    @property
    def machine(self) -> MachineLimits:
        """Names, ends of the joints, limits of the motors; errors as of `true`."""
        return machine_of(self.true("machine"))

    @property
    def nominal(self) -> Robot:
        """The nominal robot; errors as of `nominal_robot`."""
        return nominal_robot(self.model, self.true("nominal"), self.overrides)

    @property
    def parameters(self) -> Array:
        """Parameters (k,) of the nominal robot, for a regressor of the robot; errors as of `nominal_robot`."""
        return parameters(nominal_robot(self.model, self.true("parameters"), self.overrides))

    @property
    def described(self) -> Array:
        """The parameters of the robot as its file has it, without what an experiment adds; errors as of `true`."""
        return parameters(self.true("described").described)

    def true(self, what: str) -> Robot:
        """The true robot, where the controller may be told something of it.

        Raises:
            ConfigError: There is no robot, or the list of controllers does not grant it.
        """
        name = self.entry.name
        if what not in self.entry.told:
            raise ConfigError(f"{name} may not know '{what}'", fix="grant it in mmnn_pin/torque/entries.py")
        if self.robot is None:
            raise ConfigError(f"{name} of no robot", fix="give the robot", key="controllers")
        return self.robot


def machine_of(robot: Robot) -> MachineLimits:
    """The facts of a robot that do not tell how it moves: names, and ends and motors of its joints."""
    n, limits = robot.dimensions.arm, robot.effort_limits
    joints = (
        product(np.abs(robot.E_at(robot.rest)), limits)[robot.dimensions.dof - n :]
        if np.isfinite(limits).all()
        else np.full(n, np.inf)
    )
    return MachineLimits(
        velocities=tuple(robot.velocity_names),
        lower=robot.lower[robot.arm_index],
        upper=robot.upper[robot.arm_index],
        effort=joints,
        stops=np.column_stack((robot.lower, robot.upper))[robot.shape_index],
    )


def moves_alike(one: Robot, other: Robot) -> bool:
    """Whether two robots have the same joints and the same T; of bases that steer at some angles."""
    if (one.dimensions.dof, one.base.shape) != (other.dimensions.dof, other.base.shape):
        return False
    turned = other.rest.copy()
    turned[other.shape_index] += 0.3
    return all(np.array_equal(one.T_at(at), other.T_at(at)) for at in (other.rest, turned))


def nominal_robot(nominal: Nominal, robot: Robot, said: Overrides) -> Robot:
    """The robot that is believed in.

    Args:
        nominal: What is said of it.
        robot: The robot that the controllers are made for.
        said: What the experiment says about its robots.

    Raises:
        ConfigError: It moves otherwise.
        UnknownName: No robot of that name, or no such body.
        InputError: It cannot be loaded, or has no such body.
    """
    try:
        believed = load_with(nominal.robot, said) if nominal.robot else robot
    except UnknownName as error:
        raise error.but(key="nominal.robot") from None
    if not moves_alike(believed, robot):
        raise ConfigError(
            f"{believed.name} does not move as {robot.name}",
            fix="name one with the same base and the same joints",
            key="nominal.robot",
        )
    with keyed(lambda key: "nominal.masses"):
        believed = believed.with_masses(nominal.masses)
    return believed if nominal.friction else believed.without_friction()


def new_controller(
    experiment: Any, name: str, gains: Array | None, robot: Robot | None
) -> CompiledController | TorqueController:
    """A controller of an `Experiment` by name; arguments and errors as in `Experiment.controller`."""
    switches = experiment.learning
    feedback, robust, inertia = scaled(experiment, name, robot)
    if name in experiment.laws:
        return own_controller(name, experiment.laws[name], feedback, switches.learning)
    if name not in ENTRIES:
        raise UnknownName("controller", name, (*experiment.laws, *ENTRIES), key="controller")
    entry = ENTRIES[name]
    tables = [attrgetter(ENTRIES[other].key)(experiment) for other in entry.beside]
    own = attrgetter(entry.key)(experiment) if entry.settings else None
    given = ControllerSettings(
        name=name,
        settings=(*tables, own) if tables else own,
        feedback=feedback,
        learning=switches.learning,
        told=Granted(entry, robot, experiment.nominal, experiment.overrides),
        inertia=None if inertia is None else tuple(inertia.tolist()),
        networks={
            "robust": robust if switches.robust_term else None,
            "inputs": experiment.inputs,
            "rates": switches.rates,
            "leakage": switches.leakage,
            "update": switches.update,
            "projection": switches.projection,
            "within_loop": switches.within_loop,
        },
        gains=gains,
    )
    made: CompiledController = entry.load().build(given)
    return made


def scaled(experiment: Any, name: str, robot: Robot | None) -> tuple[Feedback, Robust, Array | None]:
    """Feedback and robust term of a controller, and the effective inertias (p,) that both are scaled by, or None."""
    feedback, robust = experiment.feedback, experiment.robust_term(name)
    found = None if robot is None else experiment.fit(robot)
    if robot is None or found is None:
        return feedback, robust, None
    robust = SCALED if robust == Robust() and not feedback.given(robot.dimensions) else robust
    gains = feedback.scaled(robot.dimensions, found.inertia, found.share)
    return gains, robust.scaled(robot.dimensions, found.share * found.inertia), found.inertia
