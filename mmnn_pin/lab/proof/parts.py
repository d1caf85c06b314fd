"""Which weights' part of the Lyapunov function a run's learner has: by the name that its class says (`lyapunov_part`).

The part "gain" needs nothing but what a learner tells of itself. A learner whose Psi_hat is linear in its weights, with
`features` Phi and `gain` Gamma [1/s in its units], is taken to follow s by `W' = Gamma Phi' s`, with the best fixed
weights as W* (`linear_fit`). Over a sample of period h that would change the part by `-h s' Phi W~ + h^2 tr(g' Gamma g)
/ 2`, `g = Phi' s`: pull and `step`. What the law changes it by beyond that, in W or in Gamma, is the term `own`:
prediction errors, leakage, forgetting, bounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from ...errors import RecordingError
from ...signals import Array, IntArray
from ...torque.controller import ControllerState
from .ideal import Ideal, LinearFit, of_shape
from .learner import Learner
from .linear_parts import covariance_part, stack_part
from .lyapunov import MOST, Part
from .network_part import network_part
from .subject import Subject
from .truth import Truth, estimate_part
from .weights_part import WITHOUT, Row, WeightsPart, part_of, step_again


class Kept(NamedTuple):
    """The weights' part of a learner.

    Attributes:
        part: What gives it at rows.
        most: Samples to look at.
        every: Control periods from one update of the weights to the next.
    """

    part: Part
    most: float = math.inf
    every: int = 1


# Name of a part to what makes it for a learner and its ideal weights.
PARTS: dict[str, Callable[[Subject, Any, Any], Kept]] = {
    "networks": lambda subject, learner, ideal: Kept(partial(network_part, learner, ideal, subject.rows), MOST),
    "estimate": lambda subject, learner, ideal: Kept(
        partial(estimate_part, subject, learner, ideal), MOST, interval(learner)
    ),
    "stack": lambda subject, learner, ideal: Kept(
        partial(stack_part, subject, learner, ideal.W[:, 0]), every=interval(learner)
    ),
    "covariance": lambda subject, learner, ideal: Kept(
        partial(covariance_part, subject, learner, ideal.W), every=interval(learner)
    ),
    "gain": lambda subject, learner, ideal: Kept(partial(gain_part, subject, learner, ideal.W)),
}


def weights_of(subject: Subject, ideal: dict[int, Ideal] | Truth | LinearFit) -> Kept | None:
    """The weights' part of a run's learner with its ideal weights; None where nothing was learned."""
    learner = subject.learner
    if learner is None or not learner.controller.learning or learner.controller.lyapunov_part is None:
        return None
    return PARTS[learner.controller.lyapunov_part](subject, learner, ideal)


def interval(learner: Learner) -> int:
    """Control periods from one update of the weights to the next."""
    return int(getattr(learner.controller.law(learner.context).learner, "every", 1))


def gain_part(
    subject: Subject, learner: Learner, ideal: Array, at: IntArray, progress: Callable[[float], None] | None = None
) -> WeightsPart:
    """The part at some rows of a run, (k,) ascending, for ideal weights (k, m).

    Raises:
        RecordingError: The law tells no gain, or one that is not positive definite; or not which array its weights are.
    """
    h, found = learner.context.control_period, np.zeros((3, len(subject.rows)))
    weights_error(learner, learner.start, ideal)  # before the run is stepped again

    def visit(row: Row) -> None:
        error, weighed, gain = (row.before[name] for name in ("error", "weighed", "gain"))
        g = row.Phi.T @ row.s[:, None] if ideal.shape[1] == 1 else np.outer(row.Phi[0], row.s)
        after = weights_error(learner, row.state, ideal)
        change = ((after["error"] * after["weighed"]).sum() - (error * weighed).sum()) / (2 * h)
        pull = (g * error).sum()
        step = h * (g * times(gain, g)).sum() / 2
        found[:, row.number] = (error * weighed).sum() / 2, pull, change + pull - step

    missed = step_again(learner, subject.rows, lambda state: weights_error(learner, state, ideal), visit, progress)
    value, pull, own = found[:, at]
    return part_of(subject, at, value, pull, {"own": own}, missed)


def weights_error(learner: Learner, state: ControllerState, ideal: Array) -> dict[str, Array]:
    """`W~` and `Gamma^-1 W~` (k, m), and Gamma, at a state; errors as in `gain_part`."""
    law = learner.controller
    gain, W = law.learning_gain(state, learner.context), of_shape(law.weights(state), *ideal.shape)
    if gain is None:
        raise left_out(
            f"{law.name} does not tell its learning gain",
            "write a method gain(state) that returns Gamma of W' = Gamma Phi' s + ...: a number, (k,) or (k, k)",
        )
    if W is None:
        raise left_out(
            f"not exactly one learned array of {law.name} has the {ideal.size} numbers that its features multiply",
            "name it in `learned`",
        )
    gain, k = np.array(gain, float), len(ideal)
    if gain.shape not in ((), (k,), (k, k)):
        raise left_out(
            f"gain(state) of {law.name} has the shape {gain.shape}", f"return one number, ({k},) or ({k}, {k})"
        )
    error = ideal - W
    try:
        weighed = cho_solve(cho_factor((gain + gain.T) / 2), error) if gain.ndim == 2 else divided(gain, error)
    except (LinAlgError, ValueError) as problem:
        raise left_out(f"gain(state) of {law.name} is not positive definite", "return one that is") from problem
    return {"error": error, "weighed": weighed, "gain": gain}


def left_out(why: str, fix: str) -> RecordingError:
    """Why a law's weights have no part in V, and what to write."""
    return RecordingError(WITHOUT, why=f"{why}; {fix}")


def divided(gain: Array, error: Array) -> Array:
    """`Gamma^-1 W~` of one number or a diagonal.

    Raises:
        LinAlgError: One that is not positive and finite.
    """
    if not (np.isfinite(gain).all() and (gain > 0).all()):
        raise LinAlgError("not positive")
    return np.asarray(error / (gain if gain.ndim == 0 else gain[:, None]))


def times(gain: Array, g: Array) -> Array:
    """`Gamma g` of (k, m)."""
    return np.asarray(gain @ g if gain.ndim == 2 else (gain if gain.ndim == 0 else gain[:, None]) * g)
