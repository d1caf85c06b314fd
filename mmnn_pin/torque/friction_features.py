"""Friction features that were learned offline, on simulated joints that no experiment contains. Compiled.

    f_i(nu_i, a_i) = W2 tanh(W1 u(nu_i, a_i)),    d numbers for every velocity, the same functions for all of them

What rigid bodies do not say of a joint, Stribeck's friction and friction that gives way before it slides, depends on
how fast a joint moves and how far it has come since it turned back. The second is `nu^2 / (2 |a|)` where it has been
accelerated evenly, and nu and a have the same sign only after it has turned; so a function of both knows it without a
memory. Both are those of the reference, and carry neither noise nor feedback. All units are odd and without a bias:
friction changes its sign with the motion.

W1 and W2 were fitted (`research.studies.friction_features`) so that over many random joints a combination of the d
features, another one for each joint, says what is left of its friction when viscous and dry friction have had their
share: features that are shared and a last layer that is adapted, as in Neural-Fly (O'Connell, Shi et al. 2022, Science
Robotics 7(66)), with ridge regression in place of their discriminator. The last layer is learned online by
`torque.linear`.
"""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from ..compiled import compiled, internal
from ..elementary import tanh
from ..signals import INDEX, Array, IntArray
from .filtered import Filter, Filtered

VELOCITY_REF, ACCELERATION_REF = INDEX["velocity_ref"], INDEX["acceleration_ref"]
QDOT_REF, QDDOT_REF = INDEX["qdot_ref"], INDEX["qddot_ref"]
SHAPE, ALPHA, ALPHADOT = INDEX["shape"], INDEX["alpha"], INDEX["alphadot"]
SPEEDS = np.array([0.01, 0.03, 0.1, 0.4, 1.5])  # [rad/s or m/s]
ACCELERATIONS = np.array([0.3, 1.5, 8.0])  # [rad/s^2 or m/s^2]
WAYS = np.array([0.001, 0.01, 0.1])  # since it turned [rad or m]
SLOWEST = 0.05  # acceleration below which a way is not told [rad/s^2 or m/s^2]
WEIGHTS = "friction_features.json"


class FrictionFeatures(NamedTuple):
    """The learned functions, and room to work in."""

    W1: Array  # (units, INPUTS) first layer
    W2: Array  # (d, units) features from units
    u: Array  # (INPUTS,) room to work in
    hidden: Array  # (units,) room to work in


@cache
def shipped() -> tuple[Array, Array]:
    """W1 (units, INPUTS) and W2 (d, units) that ship with the package."""
    found = json.loads((files(__package__) / WEIGHTS).read_text())
    return np.array(found["W1"]), np.array(found["W2"])


def friction() -> FrictionFeatures:
    """The learned functions with room of their own to work in."""
    W1, W2 = shipped()
    return FrictionFeatures(W1.copy(), W2.copy(), np.zeros(W1.shape[1]), np.zeros(len(W1)))


@compiled
def inputs(nu: float, a: float, u: Array) -> None:
    """The inputs of the first layer, of a velocity and its acceleration [SI units], (INPUTS,), into u."""
    way, place = nu * abs(nu) / (2.0 * (abs(a) + SLOWEST)), 0
    for i in range(SPEEDS.size):
        u[place] = tanh(nu / SPEEDS[i])
        place += 1
    for i in range(ACCELERATIONS.size):
        u[place] = tanh(a / ACCELERATIONS[i])
        place += 1
    for i in range(WAYS.size):
        u[place] = tanh(way / WAYS[i])
        place += 1


@internal
def features(f: FrictionFeatures, nu: float, a: float, phi: Array) -> None:
    """The features (d,) of a velocity and its acceleration [SI units], into phi."""
    inputs(nu, a, f.u)
    for j in range(f.hidden.size):
        total = 0.0
        for c in range(f.u.size):
            total += f.W1[j, c] * f.u[c]
        f.hidden[j] = tanh(total)
    for c in range(phi.size):
        total = 0.0
        for j in range(f.hidden.size):
            total += f.W2[c, j] * f.hidden[j]
        phi[c] = total


@compiled
def desired_rates(row: Array, at: IntArray, i: int) -> tuple[float, float]:
    """Desired velocity i of p and its derivative: the reference's, or the commanded one of a base that steers."""
    nb = at[ALPHA + 1] - at[ALPHA]
    if i >= nb:
        return row[at[QDOT_REF] + i - nb], row[at[QDDOT_REF] + i - nb]
    if at[SHAPE + 1] > at[SHAPE]:
        return row[at[ALPHA] + i], row[at[ALPHADOT] + i]
    return row[at[VELOCITY_REF] + i], row[at[ACCELERATION_REF] + i]


@internal
def beside(row: Array, at: IntArray, f: FrictionFeatures, Phi: Array) -> None:
    """Features of the reference's motion, and a constant for each velocity, into the last columns of Phi (p, k)."""
    for i in range(Phi.shape[0]):
        nu, a = desired_rates(row, at, i)
        columns(f, i, nu, a, Phi)


@internal
def columns(f: FrictionFeatures, i: int, nu: float, a: float, Phi: Array) -> None:
    """Features and constant of velocity i into its row of Phi (p, k); other columns there stay."""
    (p, k), d = Phi.shape, f.W2.shape[0]
    first = k - p - p * d + i * d
    features(f, nu, a, Phi[i, first : first + d])
    Phi[i, k - p + i] = 1.0


@internal
def follow(f: Filter, seen: Filtered, moved: Array, Phi: Array) -> None:
    """Features of the period that ends with a sample, filtered as its torque is, in place of those in Phi.

    Torque is linear in them, and the reference has no noise: they are filtered themselves, not the states that they
    are made of.

    Args:
        f: The filter of torque and states.
        seen: What it remembers, with this sample.
        moved: (2, p d) features of the last sample, and behind the filter; changed.
        Phi: (p, k) with the features of this sample.
    """
    p, k = Phi.shape
    d, follows = moved.shape[1] // p, seen.clock[1] > 1.0
    for place in range(p * d):
        i, column = place // d, k - p - p * d + place
        now = Phi[i, column]
        held, before = 0.5 * (moved[0, place] + now), moved[1, place] if follows else 0.0
        moved[0, place] = now
        moved[1, place] = f.keep * before + (1.0 - f.keep) * held if follows else 0.0
        Phi[i, column] = held - f.lag * (moved[1, place] - before)
