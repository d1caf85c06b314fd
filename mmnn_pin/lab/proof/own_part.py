"""The weights' part of a user's law that tells its learning gain Gamma, `tr(W~' Gamma^-1 W~) / 2`, and what changes it.

A law whose Psi_hat is linear in its weights, with `features` Phi and `gain` Gamma [1/s in its units], is taken to
follow s by `W' = Gamma Phi' s`, with the best fixed weights as W* (`linear_fit`). Over a sample of period h that would
change the part by `-h s' Phi W~ + h^2 tr(g' Gamma g) / 2`, `g = Phi' s`: pull and `step`. What the law changes it by
beyond that, in W or in Gamma, is the term `own`: prediction errors, leakage, forgetting, bounds.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from ...errors import RecordingError
from ...signals import Array, IntArray
from ...torque.controller import ControllerState
from ...torque.learning_law import LearningLaw
from .ideal import of_shape
from .learner import Learner
from .subject import Subject
from .together import Row, together
from .weights_part import WITHOUT, WeightsPart, part_of


def own_part(
    subject: Subject, learner: Learner, ideal: Array, at: IntArray, progress: Callable[[float], None] | None = None
) -> WeightsPart:
    """The part at some rows of a run, (k,) ascending, for ideal weights (k, m).

    Raises:
        RecordingError: The law tells no gain, or one that is not positive definite; or not which array its weights are.
    """
    law, h, found = learner.controller, learner.context.control_period, np.zeros((3, len(subject.rows)))
    weights_error(law, learner.start, ideal)  # before the run is stepped again

    def visit(row: Row) -> None:
        error, weighed, gain = (row.before[name] for name in ("error", "weighed", "gain"))
        g = row.Phi.T @ row.s[:, None] if ideal.shape[1] == 1 else np.outer(row.Phi[0], row.s)
        after = weights_error(law, row.state, ideal)
        change = ((after["error"] * after["weighed"]).sum() - (error * weighed).sum()) / (2 * h)
        pull = (g * error).sum()
        step = h * (g * times(gain, g)).sum() / 2
        found[:, row.number] = (error * weighed).sum() / 2, pull, change + pull - step

    missed = together(learner, subject.rows, lambda state: weights_error(law, state, ideal), visit, progress)
    value, pull, own = found[:, at]
    return part_of(subject, at, value, pull, {"own": own}, missed)


def weights_error(law: LearningLaw, state: ControllerState, ideal: Array) -> dict[str, Array]:
    """`W~` and `Gamma^-1 W~` (k, m), and Gamma, at a memory; errors as in `own_part`."""
    gain, W = law.gain(state), of_shape(law.weights(state), *ideal.shape)
    if gain is None:
        fix = "write a method gain(memory) that returns Gamma of W' = Gamma Phi' s + ...: a number, (k,) or (k, k)"
        raise left_out(f"{law.name} does not tell its learning gain", fix)
    if W is None:
        what = f"not exactly one learned array of {law.name} has the {ideal.size} numbers that its features multiply"
        raise left_out(what, "name it in `learned`")
    gain, k = np.array(gain, float), len(ideal)
    if gain.shape not in ((), (k,), (k, k)):
        raise left_out(
            f"gain(memory) of {law.name} has the shape {gain.shape}", f"return one number, ({k},) or ({k}, {k})"
        )
    error = ideal - W
    try:
        weighed = cho_solve(cho_factor((gain + gain.T) / 2), error) if gain.ndim == 2 else divided(gain, error)
    except (LinAlgError, ValueError) as problem:
        raise left_out(f"gain(memory) of {law.name} is not positive definite", "return one that is") from problem
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
