"""What a user says of an adaptive controller: rates, bounds and start, and the term of its prediction error."""

from __future__ import annotations

from typing import Literal

from ..errors import ConfigError
from ..settings import Settings, require_numbers


class Predicting(Settings, frozen=True):
    """The prediction error's term of a composite adaptive controller.

    Args:
        weight: c, its factor; dimensionless. Large is safe: a step never overshoots.
        tracking: a, the factor on the gradient of the tracking error, which is 1 without a prediction error.
        pole: Of the low-pass of regressor and torque [1/s].
        memory: T, how long what was seen counts [s].
        every: Time between two steps [s].

    Raises:
        ConfigError: A number that is negative or not finite, or a memory or period of 0.
    """

    weight: float = 1000.0
    tracking: float = 0.1
    pole: float = 3.0
    memory: float = 30.0
    every: float = 0.01

    def __post_init__(self) -> None:
        require_numbers(self, "prediction", ("memory", "every"))


class Adapting(Settings, frozen=True):
    """How an adaptive controller learns.

    The rates are in units of energy: a body's estimate moves by its own size where `rate` times the work that its error
    does in a sample is one. They hold for an arm with gains of 30 N m s (the median of its joints) and are multiplied
    with 30 N m s over its gains for another one: light arms have little energy. Friction is measured by
    `c_j = 1 / (t_j K^-1 t_j')`, the feedback gain that joint j with the row t_j of T feels.

    Args:
        rate: gamma of the pseudo-inertias [1/J].
        viscous: Rate of viscous friction; gamma_j is `viscous c_j^2` [s^2/J rad^2, 1/s^2 J m^2].
        coulomb: Rate of dry friction; gamma_j is `coulomb c_j^2` [1/J].
        rotor: Rate of the rotors' inertias; gamma_j is `rotor c_j^2`. Mostly a link's own inertia says the same: 0.
        leakage: sigma, how fast the estimate is pulled back to its start [1/s].
        share: Largest answer of one sample to s, as a share of the feedback; rates that ask for more are cut.
        modification: "sigma" leaks always, "e" in proportion to |s|.
        bounds: rho, the largest ratio of an estimate to its start, either way.
        friction_bound: Largest friction that is believed: viscous in c_j, dry in c_j times 1 rad/s or m/s.
        initial: "guess" for balls of `mass` and `size` at every joint without friction; "nominal" for a robot's (in an
            experiment the one of `[nominal]`).
        mass: Masses of the guess, (base, every other body) [kg].
        size: Radii of gyration of the guess about each axis, likewise [m].
        slowest: The guess is made lighter where a velocity feels more inertia of it than this times its gain [s]; see
            `torque.guess`.

    Raises:
        ConfigError: A number that is negative, not finite or 0 where it must not be.
    """

    rate: float = 100.0
    viscous: float = 1.0
    coulomb: float = 10.0
    rotor: float = 0.0
    leakage: float = 0.0
    share: float = 0.2
    modification: Literal["sigma", "e"] = "sigma"
    bounds: float = 100.0
    friction_bound: float = 10.0
    initial: Literal["guess", "nominal"] = "guess"
    mass: tuple[float, float] = (30.0, 2.0)
    size: tuple[float, float] = (0.3, 0.2)
    slowest: float = 0.3

    def __post_init__(self) -> None:
        require_numbers(self, "adaptive", ("mass", "size", "slowest"))
        if not self.bounds > 1:
            raise ConfigError(f"{self.bounds}", fix="use a finite ratio > 1", key="adaptive.bounds")
