"""Slotine-Li adaptive control with physical estimates: `tau = Y theta_hat + K s`, `s = [z; r]`; see `adaptation`.

The controller knows how the robot moves (`model.regressor`), never what it weighs: it starts from a guess or from the
parameters of a nominal robot that it is given as numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import eigh, solve_triangular

from ..errors import ConfigError
from ..model.regressor import BODY, Regressor
from ..settings import plain
from ..signals import Array, Layout
from . import law
from .adaptation import Adaptation
from .adaptive_settings import Adapting, Predicting
from .controller import CompiledController, Context, ControllerState, Feedback, Law
from .filtered import new_filter, parts
from .guess import gains_of, guess_of, scales, tempo
from .prediction import Prediction
from .pseudo_inertia import to_matrix, to_vector

FLOOR = 1e-4  # least share of the guess that a nominal body keeps: massless and flat ones have no density
TAKEN = 0.01  # how often a sample is taken for the excitation [s]
EXCITED = 1e-3  # share of what random motion of unit speed excites, above which a direction counts as excited


@dataclass(frozen=True, eq=False)
class Adaptive(CompiledController):
    """`tau = Y theta_hat + K s` with `V' = -s' K s`: s goes to zero without leakage, bounds and disturbances.

    Args:
        regressor: How the robot moves.
        feedback: K.
        adapting: Rates, start and bounds.
        nominal: (k,) parameters to start from, needed for `initial = "nominal"`.
        learning: Off keeps the estimate as it starts.
        predicting: The term of a prediction error, which makes it composite; None without one.

    Raises:
        ConfigError: A start from nominal parameters without them, or with others than k finite ones.
    """

    regressor: Regressor
    feedback: Feedback = field(default_factory=Feedback)
    adapting: Adapting = field(default_factory=Adapting)
    nominal: Array | None = None
    learning: bool = True
    predicting: Predicting | None = None

    within_limits: ClassVar[bool] = True

    @property
    def name(self) -> str:  # type: ignore[override]
        """With a prediction error or without."""
        return "adaptive" if self.predicting is None else "adaptive_composite"

    def __post_init__(self) -> None:
        k, given = self.regressor.size, self.nominal
        if self.adapting.initial == "nominal" and given is None:
            raise ConfigError(
                "no nominal parameters", fix="give them, or use initial = 'guess'", key="adaptive.initial"
            )
        if given is not None and (given.shape != (k,) or not np.isfinite(given).all()):
            raise ConfigError(f"{given.size} parameters", fix=f"give {k} finite ones", key="adaptive.nominal")

    @property
    def notes(self) -> list[str]:
        """How many of the parameters matter."""
        known = self.unit.shape[1]
        return [f"{self.name}: {known} combinations of its {self.regressor.size} parameters matter on this robot"]

    def law(self, context: Context) -> Law:
        """The numbers of the law, with a memory of its own to work in.

        Raises:
            ConfigError: A gain of 0: the bound on s then does not hold.
        """
        K, start, own = self.feedback.vector(context.layout), self.start(), self.adapting
        if not (K > 0).all():
            raise ConfigError(f"gains {K.tolist()}", why="adaptation needs all > 0", fix="raise them", key="feedback")
        scale, first = scales(self.regressor, K), self.regressor.inertial
        matrices = pseudo_inertias(start[:first])
        roots: Array = np.linalg.cholesky(matrices).astype(np.float64)
        faster = tempo(K, context.layout.base)
        rates = faster * np.repeat([own.rotor, own.viscous, own.coulomb], self.counts()) * scale**2
        adaptation = Adaptation(
            known=self.regressor.workspace(),
            gain=K,
            learning=self.learning,
            h=float(context.control_period),
            tracking=1.0 if self.predicting is None else float(self.predicting.tracking),
            gamma=faster * float(own.rate),
            sigma=float(own.leakage),
            by_error=own.modification == "e",
            rho=float(own.bounds),
            roots=roots,
            inverses=np.array([solve_triangular(C, np.eye(4), lower=True) for C in roots]).reshape(roots.shape),
            rates=rates,
            start=start[first:].copy(),
            top=np.maximum(own.friction_bound * scale, start[first:]),
            share=float(own.share),
            stride=max(1, round(TAKEN / context.control_period)),
            gradient=np.zeros(start.size),
            steps=np.zeros(roots.shape),
            rest=np.zeros(rates.size),
            factors=np.zeros(roots.shape),
            work=np.zeros((3, 4, 4)),
            prediction=self.prediction(context, K),
        )
        return Law(law.CONSTANT_GAIN, np.zeros(0, np.int64), K, adaptation)

    def prediction(self, context: Context, K: Array) -> Prediction | None:
        """The numbers of the prediction error's term."""
        own, k, h = self.predicting, self.regressor.size, float(context.control_period)
        if own is None or not self.learning:
            return None
        every = max(1, round(own.every / h))
        size = 16 * len(self.regressor.bodies) + k - self.regressor.inertial
        return Prediction(
            filter=new_filter(context.layout, h, own.pole),
            first=k + 1 + k * k,
            trust=1.0 / K,
            weight=float(own.weight) * every * h,
            keep=float(np.exp(-every * h / own.memory)),
            every=every,
            gradient=np.zeros(k),
            velocity=np.zeros(k),
            step=np.zeros(size),
            work=np.zeros((3, size)),
        )

    def init(self, context: Context) -> ControllerState:
        """The estimate at its start, and nothing seen yet."""
        k, seen = self.regressor.size, dict[str, tuple[int, ...]]()
        if self.predicting is not None:
            seen = {**parts(context.layout, context.layout.dof, k), "Q": (k, k), "b": (k,)}
        state = ControllerState.of(theta=(k,), samples=(1,), gram=(k, k), **seen)
        state["theta"] = self.start()
        return state

    def feedback_gain(self, layout: Layout) -> Array:
        """K, (p,)."""
        return self.feedback.vector(layout)

    def weights(self, state: ControllerState) -> dict[str, Array]:
        """The estimate, (k,)."""
        return {"theta": state["theta"]}

    def facts(self) -> dict[str, Any]:
        """Gains, settings and start, with the names of the parameters."""
        named = {"labels": list(self.regressor.labels), "start": self.start().tolist(), "learning": self.learning}
        own = {} if self.predicting is None else {"predicting": plain(self.predicting)}
        return {"feedback": plain(self.feedback), "adapting": plain(self.adapting), **own} | named

    def features(self, law: Law, state: ControllerState) -> Array | None:
        """Y, (p, k)."""
        return None if law.adaptation is None else law.adaptation.known.Y

    def findings(self, state: ControllerState) -> list[str]:
        """Says when the run did not excite all that matters: then the estimate tracks, but is no knowledge."""
        gram, unit = state["gram"], self.unit
        if not self.learning or not np.isfinite(gram).all() or state["samples"][0] == 0:
            return []
        values = np.linalg.eigvalsh(unit.T @ gram @ unit)
        excited, known = int(np.sum(values > EXCITED * values[-1])), unit.shape[1]
        if excited == known:
            return []
        verdict = "not excited: " if 2 * excited < known else ""
        return [f"{self.name}: {verdict}the motion excited {excited} of {known} combinations of parameters that matter"]

    def start(self) -> Array:
        """The estimate before anything is learned, (k,); its pseudo-inertias are positive definite."""
        return self._start.copy()

    @cached_property
    def _start(self) -> Array:
        """The same, computed once: a guess looks at many positions."""
        first, own = self.regressor.inertial, self.adapting
        guess = guess_of(self.regressor, gains_of(self.regressor, self.feedback), own.mass, own.size, own.slowest)
        if self.adapting.initial == "guess" or self.nominal is None:
            return guess
        theta = np.maximum(self.nominal, 0.0)
        pairs = zip(pseudo_inertias(self.nominal[:first]), pseudo_inertias(guess[:first]), strict=True)
        theta[:first] = np.concatenate([vector_of(lifted(P, G)) for P, G in pairs])
        return theta

    def counts(self) -> tuple[int, int, int]:
        """How many parameters are rotors, viscous and dry friction."""
        count = len(self.regressor.joints)
        return count, self.regressor.massless.base + count, count

    @cached_property
    def unit(self) -> Array:
        """The combinations of theta that matter, each of the size that random motion excites alike, (k, known)."""
        return self.regressor.unit()


def pseudo_inertias(theta: Array) -> Array:
    """Pseudo-inertias of the inertial parameters, (bodies, 4, 4)."""
    matrices = np.zeros((theta.size // BODY, 4, 4))
    for P, numbers in zip(matrices, theta.reshape(-1, BODY), strict=True):
        to_matrix(numbers, 1.0, P)
    return matrices


def vector_of(P: Array) -> Array:
    """The ten numbers of a pseudo-inertia."""
    theta = np.zeros(BODY)
    to_vector(P, theta)
    return theta


def lifted(P: Array, guess: Array) -> Array:
    """A pseudo-inertia with at least `FLOOR` times a guess, in every direction in which it has less."""
    values, vectors = eigh(P, guess)
    back = guess @ vectors
    return np.asarray(back @ np.diag(np.maximum(values, FLOOR)) @ back.T)
