"""Priors of learners that know the kinematics: before it has moved a robot is balls at its joints.

Which balls? A prior multiplies `nudot_ref`, which holds `K edot`, so a prior much heavier than the robot is a feedback
that the control period does not stand: 2 kg in every joint of a servo arm of 50 g. Masses are unknown, but the feedback
K was chosen for this robot, and says how heavy it can be: K over the inertia is the bandwidth of a velocity. So the
prior is made lighter, body by body, until no velocity feels more inertia of it than `slowest` times its gain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from ..elementary.matrices import product
from ..errors import ConfigError
from ..files import parsed_json, read_text
from ..model.regressor import BODY, Regressor
from ..settings.arguments import require_types
from ..signals import Array, Layout
from .controller import (
    Bears,
    CompiledController,
    ControllerSettings,
    ControllerState,
    Feedback,
    Told,
    borne,
    read_facts,
)

DOUBT = 0.5  # standard deviation of a body, relative, that `mmnn identify` knows nothing of
GAINS = 500.0, 30.0  # on a base's forward velocity and of an arm for which rates in 1/J are meant [N s/m, N m s]
SAMPLES = 100  # of random positions
LARGEST = 50_000_000  # bytes of a report of an identification
POWERS = [0, 1, 1, 1, 2, 2, 2, 2, 2, 2]  # of the size in the ten numbers of a body


@dataclass(frozen=True, eq=False)
class ParameterLearner(CompiledController):
    """A learner that is told how the robot moves, and starts from a prior or from the numbers of a nominal robot.

    Raises:
        ConfigError: A start from nominal parameters without them, or with others than k finite ones.
    """

    regressor: Regressor  # how the robot moves
    feedback: Feedback = field(default_factory=Feedback)  # K
    settings: Any = None  # its table, with `initial`
    nominal: Array | None = None  # (k,) parameters to start from, needed for `initial = "nominal"`
    learning: bool = True  # off keeps the estimate as it starts
    covariance: Array | None = None  # (k, k) of them, where they are those of a fit (`start`)
    bears: Bears | None = None  # as of `CompiledController`

    within_limits: ClassVar[bool] = True

    def __post_init__(self) -> None:
        require_types(self)
        section, k = self.name.partition("_")[0], self.regressor.size
        require_start("nominal" if self.covariance is not None else self.settings.initial, self.nominal, k, section)
        if self.covariance is not None and not (self.covariance.shape == (k, k) and np.isfinite(self.covariance).all()):
            raise ConfigError("no covariance of these parameters", fix=f"give {k} by {k}", key=f"{section}.start")

    @property
    def informed(self) -> bool:
        """Whether it starts from parameters that it was given, not from a prior."""
        return self.nominal is not None and (self.settings.initial == "nominal" or self.covariance is not None)

    @classmethod
    def build(cls, given: ControllerSettings) -> Self:
        """With how the robot moves, and the nominal parameters where it starts from them."""
        own, motion = given.settings, given.told.motion
        start, covariance = given.told.parameters if own.initial == "nominal" else None, None
        if own.start:
            start, covariance = identified(own.start, motion.labels, f"{cls.name.partition('_')[0]}.start")
        return cls(motion, given.feedback, own, start, given.learning, covariance)

    @classmethod
    def from_facts(cls, name: str, facts: dict[str, Any], told: Told) -> Self | None:
        """From gains, settings and start."""
        if not facts:
            return None
        own = dict(facts.get("settings") or facts["adapting"])
        own["initial"] = own["initial"].replace("guess", "prior")
        made = read_facts(cls, {**facts, "settings": own}, "feedback", "settings", "learning", *borne(facts))
        covariance = np.array(facts["covariance"], float) if "covariance" in facts else None
        given = own["initial"] == "nominal" or covariance is not None
        start = np.array(facts["start"], float) if given else None
        return cls(told.motion, nominal=start, covariance=covariance, **made)

    def facts(self) -> dict[str, Any]:
        """Gains, settings and start, with the names of the parameters."""
        known = {} if self.covariance is None else {"covariance": self.covariance.tolist()}
        return super().facts() | known | {"labels": list(self.regressor.labels), "start": self.start().tolist()}

    def bearable(self, inertia: float) -> Array:
        """The inertia that a velocity may feel over its gain, at most what the loop bears, (p,) [s]."""
        most = np.full(self.regressor.massless.nu.size, float(inertia))
        return most if self.bears is None else np.minimum(most, self.bears.weight)

    def start(self) -> Array:
        """The parameters before anything is learned, (k,)."""
        return self._start.copy()

    def knowledge(self, state: ControllerState) -> tuple[Array, Array | None]:
        """The estimate as parameters of the robot (k,), and its covariance (k, k) where it has one."""
        return state["theta"].copy(), None

    @cached_property
    def _start(self) -> Array:
        """The parameters of `start`, (k,), computed once: a prior looks at many positions."""
        raise NotImplementedError


def require_start(initial: str, nominal: Array | None, k: int, section: str) -> None:
    """Refuse a start from nominal parameters without them, and others than k finite ones (`ConfigError`)."""
    if initial == "nominal" and nominal is None:
        fix = "give them, or use initial = 'prior'"
        raise ConfigError("no nominal parameters", fix=fix, key=f"{section}.initial")
    if nominal is not None and (nominal.shape != (k,) or not np.isfinite(nominal).all()):
        raise ConfigError(f"{nominal.size} parameters", fix=f"give {k} finite ones", key=f"{section}.nominal")


def require_one_start(settings: Any, section: str) -> None:
    """Refuse a start from a file beside one from a nominal robot (`ConfigError`)."""
    if settings.start and settings.initial != "prior":
        fix = "leave out one of the two"
        raise ConfigError(f"'{settings.start}' beside initial = 'nominal'", fix=fix, key=f"{section}.start")


def prior_of(
    regressor: Regressor, K: Array, mass: tuple[float, float], size: tuple[float, float], slowest: float | Array
) -> Array:
    """Balls at every joint and no friction, (k,).

    Args:
        regressor: How the robot moves.
        K: (p,) feedback gains.
        mass: Masses at most (base, every other body) [kg].
        size: Radii of gyration about each axis, likewise [m].
        slowest: Inertia that a velocity feels of the prior, over its gain, at most, one number or (p,) [s].
    """
    theta = balls(regressor, mass, size)
    return theta * np.concatenate(
        (np.repeat(lightness(regressor, theta, K, slowest), BODY), np.ones(theta.size - regressor.inertial))
    )


def sizes_of(
    regressor: Regressor, K: Array, mass: tuple[float, float], size: tuple[float, float], slowest: float
) -> Array:
    """How large the inertial parameters of such bodies may be, (10 bodies,): mass times powers of the size.

    Arguments as in `prior_of`.
    """
    powers = [np.array([1.0, one, one * one])[POWERS] for one in size]
    found = np.array([mass[b != "root"] * powers[b != "root"] for b in regressor.bodies])
    return np.asarray(found * lightness(regressor, balls(regressor, mass, size), K, slowest)[:, None]).ravel()


def balls(regressor: Regressor, mass: tuple[float, float], size: tuple[float, float]) -> Array:
    """Parameters of balls of a mass and a radius of gyration, (base, every other body), without friction, (k,)."""
    theta = np.zeros(regressor.size)
    for i, body in enumerate(regressor.bodies):
        theta[BODY * i] = mass[body != "root"]
        theta[BODY * i + np.array([4, 7, 9])] = mass[body != "root"] * (size[body != "root"] * size[body != "root"])
    return theta


def lightness(regressor: Regressor, theta: Array, K: Array, slowest: float | Array) -> Array:
    """Factor in (0, 1] on every body after which no velocity feels more inertia than `slowest` K, (bodies,).

    Every body is lightened by what the velocity that is worst off, of those that move it, asks for; so the sum over
    bodies holds for each of them at the positions that were looked at.
    """
    felt = inertia_of_bodies(regressor, theta)
    total = felt.sum(axis=0)
    room = np.minimum(1.0, slowest * K / np.where(total > 0, total, 1.0))
    return np.asarray(np.where(felt > 0, room, 1.0).min(axis=1))


def inertia_of_bodies(regressor: Regressor, theta: Array, seed: int = 0) -> Array:
    """How much of the diagonal of M every body is, at most, over random positions, (bodies, p) [kg, kg m^2]."""
    rng, count, p = np.random.default_rng(seed), len(regressor.bodies), regressor.massless.nu.size
    felt, still, first = np.zeros((count, p)), np.zeros(p), regressor.inertial
    for _ in range(SAMPLES):
        position = regressor.random_position(rng)
        gravity = regressor.matrix(position, still, still, still)[:, :first]
        for i, one in enumerate(np.eye(p)):
            Y = regressor.matrix(position, still, still, one)[i, :first] - gravity[i]
            felt[:, i] = np.maximum(felt[:, i], (Y * theta[:first]).reshape(count, BODY).sum(axis=1))
    return felt


def tempo(regressor: Regressor, K: Array) -> tuple[Array, Array]:
    """Factors on rates in 1/J, of the bodies (bodies,) and of the other parameters (k - 10 bodies,).

    Errors of weak joints have little energy, so a rate in 1/J that suits a shoulder leaves a wrist without a lesson,
    and one that suits the wrist lets the shoulder burst. A joint's factor is `GAINS[1]` over the geometric mean of the
    gain that it feels and the median of the arm's: a robot that is the same but for its masses and gains, all of them
    a hundredth, learns as fast, and within one arm weak joints do not wait for strong ones. What the base carries has
    `GAINS[0]` over the gain on its forward velocity.

    Args:
        regressor: How the robot moves.
        K: (p,) feedback gains.
    """
    known = regressor.massless
    base, count = known.base, len(known.joints)
    of_base = GAINS[0] / K[0] if base else 1.0
    middle = np.median(K[base:]) if K.size > base else 1.0
    wheels = known.joints[:, :base].any(axis=1)
    joints = np.where(wheels, of_base, GAINS[1] / np.sqrt(middle * scales(regressor, K)[:count]))
    carried = dict(zip(regressor.joints, joints.tolist(), strict=True))
    bodies = np.array([carried.get(body, of_base) for body in regressor.bodies])
    alone = regressor.size - regressor.inertial - 3 * count - base
    return bodies, np.concatenate((joints, np.full(base, of_base), joints, joints, np.full(alone, of_base)))


def gains_of(regressor: Regressor, feedback: Feedback) -> Array:
    """K of the robot that a regressor belongs to, (p,)."""
    m = regressor.massless
    return feedback.vector(Layout(m.base, m.nu.size - m.base, m.offset.size, 0))


def scales(regressor: Regressor, K: Array) -> Array:
    """c_j of rotors, viscous and dry friction, (k - 10 bodies,): the gain that each of them feels."""
    known = regressor.massless
    joints = 1.0 / product(known.joints**2, 1.0 / K)
    alone = regressor.size - regressor.inertial - 3 * len(joints) - known.base  # dry friction of the base's turning
    return np.concatenate((joints, K[: known.base], joints, joints, K[1 : 1 + alone]))


def identified(file: str, labels: Sequence[str], key: str) -> tuple[Array, Array]:
    """Parameters of some names (k,) and their covariance (k, k), as `mmnn identify` found them.

    Args:
        file: `NAME.identified.json`.
        labels: Names of a regressor's parameters.
        key: Of the setting, for errors.

    Raises:
        ConfigError: No such file, one that `mmnn identify` has not written, or one of another robot.
    """
    fix = "give NAME.identified.json as mmnn identify writes it"
    try:
        report = parsed_json(read_text(Path(file), LARGEST))
        names, theta, covariance = list(report["labels"]), np.array(report["theta"]), np.array(report["covariance"])
        right = theta.shape == (len(names),) and covariance.shape == (len(names), len(names))
        if not (
            right and np.isfinite(theta).all() and np.isfinite(covariance).all() and (np.diag(covariance) >= 0).all()
        ):
            raise ValueError
    except ConfigError as error:
        raise ConfigError(f"'{file}' {error.what}", why=error.why, fix=fix, key=key) from None
    except (ValueError, KeyError, TypeError):
        raise ConfigError(f"'{file}' is no report of an identification", fix=fix, key=key) from None
    if missing := [name for name in labels if name not in names]:
        raise ConfigError(f"'{file}' has no {missing[0]}", why="it is of another robot", fix=fix, key=key)
    at = [names.index(name) for name in labels]
    return theta[at], covariance[np.ix_(at, at)]


def within_prior(covariance: Array, prior: Array) -> Array:
    """A fit's covariance (k, k) with variances of at most a prior's (k,), and with those where it says nothing."""
    said = np.diag(covariance)
    share = np.sqrt(np.minimum(1.0, prior / np.where(said > 0.0, said, 1.0)))
    P = covariance * np.outer(share, share)
    P[np.diag_indices_from(P)] = np.where(said > 0.0, np.diag(P), prior)
    return np.asarray(P)
