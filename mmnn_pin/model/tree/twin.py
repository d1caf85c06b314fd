"""The compiled twin for Python: a robot's terms at a state, without Pinocchio and without a libm."""

from __future__ import annotations

from contextlib import suppress
from typing import Protocol

import numpy as np

from ...compiled import compiled, spliced
from ...errors import RobotError
from ...signals import Array, IntArray
from ..dynamics import Dynamics
from ..reduction import friction, spread
from ..robot import Robot
from .body import Body, Work, body_of
from .dynamics import potential_energy, psi_again, terms
from .motion import Tree, new_scratch


class Terms(Protocol):
    """Terms of the dynamics at a state, for loops that go through Python.

    Attributes:
        M: (p, p) reduced mass matrix.
        h: (p,) `C nu + gravity + friction`.
        F: (p,) friction.
        v: (nv,) `T nu`.
    """

    M: Array
    h: Array
    F: Array
    v: Array

    def refresh(self, position: Array, nu: Array) -> None:
        """Evaluate the terms at a position (nv,) and velocity nu (p,)."""

    def refresh_psi(self, nu_ref: Array, nudot_ref: Array, psi: Array) -> None:
        """True Psi at the state last refreshed, written to psi (p,)."""

    def potential(self) -> float:
        """Potential energy at the place last refreshed [J]."""


@spliced
def psi_of(body: Body, work: Work, position: Array, nu_ref: Array, nudot_ref: Array, out: Array) -> None:
    """`M nudot_ref + C nu_ref + gravity + friction` at the state last evaluated, into out (p,)."""
    psi_again(body.tree, position, nu_ref, nudot_ref, work.scratch, out)
    for i in range(out.size):
        out[i] += work.F[i]


# From Python a tuple of arrays costs 0.15 us per array and call: these take the few that they need.


@spliced
def whole(links: IntArray, numbers: Array, rotors: Array, rest: Array) -> Tree:
    """A tree from its arrays and its single numbers."""
    gravity, frame = (rest[0], rest[1], rest[2]), (rest[3], rest[4], rest[5])
    return Tree(links, numbers, rotors, gravity, frame, int(rest[6]), rest[7])


@compiled
def refresh(
    links: IntArray, numbers: Array, rotors: Array, rest: Array, T: Array, damping: Array, dry: Array, viscous: Array,
    scratch: Array, position: Array, nu: Array, M: Array, h: Array, F: Array, v: Array,
) -> None:  # fmt: skip
    """What `body.evaluate` does."""
    terms(whole(links, numbers, rotors, rest), position, nu, scratch, M, h)
    spread(T, nu, v)
    friction(T, v, nu, damping, dry, viscous, F)
    for i in range(nu.size):
        h[i] += F[i]


@compiled
def refresh_psi(
    links: IntArray, numbers: Array, rotors: Array, rest: Array, scratch: Array, position: Array, F: Array,
    nu_ref: Array, nudot_ref: Array, out: Array,
) -> None:  # fmt: skip
    """What `psi_of` does."""
    psi_again(whole(links, numbers, rotors, rest), position, nu_ref, nudot_ref, scratch, out)
    for i in range(out.size):
        out[i] += F[i]


@compiled
def potential(
    links: IntArray, numbers: Array, rotors: Array, rest: Array, scratch: Array, position: Array
) -> float:  # fmt: skip
    """Potential energy [J]."""
    return potential_energy(whole(links, numbers, rotors, rest), position, scratch)


class Twin:
    """Reduced dynamics of one robot by its compiled twin. Holds a workspace: one object per thread.

    Args:
        robot: The robot.

    Attributes:
        As of `Terms`.

    Raises:
        RobotError: It has a joint that cannot be flattened.
    """

    def __init__(self, robot: Robot) -> None:
        body, p = body_of(robot), robot.dimensions.dof
        tree = body.tree
        rest = np.array([*tree.gravity, *tree.frame, tree.level, tree.root_energy])
        self.tree, self.scratch = (tree.links, tree.numbers, tree.rotors, rest), new_scratch(tree)
        self.fixed = (*self.tree, body.T, body.damping, body.dry, body.viscous, self.scratch)
        self.position, self.feels_gravity = robot.neutral_position(), body.feels_gravity
        self.M, self.h, self.F, self.v = np.zeros((p, p)), np.zeros(p), np.zeros(p), np.zeros(robot.dimensions.full)

    def mass_matrix(self, position: Array) -> Array:
        """Reduced mass matrix at a position (nv,), (p, p) [kg, kg m, kg m^2]; a copy."""
        self.refresh(position, np.zeros(len(self.M)))
        return self.M.copy()

    def refresh(self, position: Array, nu: Array) -> None:
        """See `Terms.refresh`."""
        self.position[:] = position
        refresh(*self.fixed, self.position, nu, self.M, self.h, self.F, self.v)

    def refresh_psi(self, nu_ref: Array, nudot_ref: Array, psi: Array) -> None:
        """See `Terms.refresh_psi`."""
        refresh_psi(*self.tree, self.scratch, self.position, self.F, nu_ref, nudot_ref, psi)

    def potential(self) -> float:
        """See `Terms.potential`."""
        return float(potential(*self.tree, self.scratch, self.position)) if self.feels_gravity else 0.0


def terms_of(robot: Robot) -> Terms:
    """The terms by the compiled twin; by Pinocchio (with its libm) for a robot that cannot be flattened."""
    with suppress(RobotError):
        return Twin(robot)
    return Dynamics(robot)
