"""What the energy of an adaptive law leaves open: docs/explanation/theory.md, section 9.

V_theta falls on every motion, but with `dV / dt = -s' K s` alone: nothing tells directions that the motion shows from
those that it does not. `allowed` is how large an error of Psi it leaves, `patience` how long that takes to fall.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mmnn_pin.signals import Array
from mmnn_pin.torque.pseudo_inertia import BODY, pseudo_inertias

from .periods import Periods
from .truth import distances, metric, numbers_of, regressors, true_parameters

INSTANTS, HALVINGS = 5, 20  # of a run, for what an energy allows; of a bisection
SAMPLES, LONGEST = 500, 1e15  # of a run, for its mean; the longest time that is looked at [s]


def patience(periods: Periods, largest: Array) -> float:
    """How long motion like the run's takes until V_theta leaves errors of Psi up to largest (p,) alone [s].

    Averaged, for slow adaptation and small errors: `theta~' = -Gamma H theta~` with H the mean of `a Y' K^-1 Y`, of a
    composite law also the Q of its prediction error. Then `|Psi~_i| <= (2 V)^1/2 |exp(-H T) Gamma^1/2 Y_i'|`.
    """
    subject, learner = periods.subject, periods.subject.learner
    assert learner is not None
    (a, prediction), end = numbers_of(learner), learner.end["theta"]
    energy = float(distances(a.bodies, true_parameters(subject, learner).theta, end[None])[0])
    Y = regressors(learner, subject.rows[np.linspace(0, len(subject.rows) - 1, SAMPLES).astype(int)])
    H = a.tracking * np.einsum("nij,i,nik->jk", Y, 1 / a.gain, Y) / len(Y)
    if prediction is not None:
        H += prediction.weight / (prediction.every * learner.context.control_period) * learner.end["Q"]
    values, vectors = np.linalg.eigh(metric(a.bodies, end))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    rates, ways = np.linalg.eigh(root.T @ H @ root)
    known = Y @ root @ ways

    def leaves(time: float) -> bool:
        left = np.sqrt(2 * energy * (known**2 * np.exp(-2 * np.maximum(rates, 0.0) * time)).sum(axis=2))
        return bool((left <= largest).all())

    if not leaves(LONGEST):
        return np.inf
    low, high = 0.0, LONGEST
    while high > 1.01 * max(low, 1e-3):
        middle = float(np.sqrt(max(low, 1e-3) * high))
        low, high = (low, middle) if leaves(middle) else (middle, high)
    return high


def allowed(periods: Periods) -> Array:
    """(p,) how large an error of Psi the energy of an adaptive law at the end of its run allows [N, N m].

    For every velocity there are parameters as far from the estimate, in V_theta, as the true ones are, with which Psi
    differs by so much along the reference: on the ray `theta_hat + c Gamma Y_i'`, as far as V_theta lets c be. V falls
    on every motion, so nothing less is proved of the law by it.
    """
    subject, learner = periods.subject, periods.subject.learner
    assert learner is not None
    bodies, end = numbers_of(learner)[0].bodies, learner.end["theta"]
    energy = float(distances(bodies, true_parameters(subject, learner).theta, end[None])[0])
    some = np.linspace(0, len(subject.rows) - 1, INSTANTS).astype(int)
    Gamma, Y = metric(bodies, end), regressors(learner, subject.rows[some])
    return np.asarray(np.max([[reach(bodies, end, Gamma @ y, energy) * (y @ Gamma @ y) for y in one] for one in Y], 0))


def reach(bodies: Any, theta: Array, ray: Array, energy: float) -> float:
    """The largest c, either way, for which `theta + c ray` is no further than an energy from theta."""
    best = 0.0
    for sign in (1.0, -1.0):
        low, high = 0.0, 1.0
        while near(bodies, theta, sign * high * ray, energy) and high < 1e12:
            low, high = high, 2 * high
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if near(bodies, theta, sign * middle * ray, energy) else (low, middle)
        best = max(best, low)
    return best


def near(bodies: Any, theta: Array, step: Array, energy: float) -> bool:
    """Whether parameters are those of bodies and within an energy of theta."""
    inertial = pseudo_inertias((theta + step)[: BODY * len(bodies.roots)])
    if any(np.linalg.eigvalsh(P)[0] <= 0 for P in inertial):
        return False
    return bool(distances(bodies, theta + step, theta[None])[0] <= energy)
