"""The compiled twin for Python: a robot's terms at a state, without Pinocchio and without a libm."""

from __future__ import annotations

from contextlib import suppress
from typing import Protocol

import numpy as np

from ...compiled import linked
from ...errors import RobotError
from ...signals import Array
from ..base.rolling import Maps
from ..dynamics import Dynamics
from ..robot import Robot
from .body import Body, Work, body_of, evaluate, new_work
from .dynamics import potential_energy, psi_again


class Terms(Protocol):
    """Terms of the dynamics at a state, for loops that go through Python.

    Attributes:
        M: (p, p) reduced mass matrix.
        h: (p,) `C nu + gravity + friction`.
        F: (p,) friction.
        v: (nv,) `T nu`.
        maps: T and the motion of the base.
    """

    M: Array
    h: Array
    F: Array
    v: Array
    maps: Maps

    def refresh(self, position: Array, nu: Array) -> None:
        """Evaluate the terms at a position (nv,) and velocity nu (p,)."""

    def refresh_psi(self, nu_ref: Array, nudot_ref: Array, psi: Array) -> None:
        """True Psi at the state last refreshed, written to psi (p,)."""

    def potential(self) -> float:
        """Potential energy at the place last refreshed [J]."""


@linked
def psi_of(body: Body, work: Work, position: Array, nu_ref: Array, nudot_ref: Array, out: Array) -> None:
    """`M nudot_ref + C nu_ref + gravity + friction` at the state last evaluated, into out (p,)."""
    psi_again(body.tree, position, nu_ref, nudot_ref, work.scratch, out)
    for i in range(out.size):
        out[i] += work.F[i]


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
        self.body = body_of(robot)
        self.work, self.position = new_work(self.body), robot.neutral_position()
        self.M, self.h, self.F, self.v, self.maps = self.work.M, self.work.h, self.work.F, self.work.v, self.work.maps

    def mass_matrix(self, position: Array) -> Array:
        """Reduced mass matrix at a position (nv,), (p, p) [kg, kg m, kg m^2]; a copy."""
        self.refresh(position, np.zeros(len(self.M)))
        return self.M.copy()

    def refresh(self, position: Array, nu: Array) -> None:
        """See `Terms.refresh`."""
        self.position[:] = position
        evaluate(self.body, self.work, self.position, nu)

    def refresh_psi(self, nu_ref: Array, nudot_ref: Array, psi: Array) -> None:
        """See `Terms.refresh_psi`."""
        psi_of(self.body, self.work, self.position, nu_ref, nudot_ref, psi)

    def potential(self) -> float:
        """See `Terms.potential`."""
        body = self.body
        return float(potential_energy(body.tree, self.position, self.work.scratch)) if body.feels_gravity else 0.0


def terms_of(robot: Robot) -> Terms:
    """The terms by the compiled twin; by Pinocchio (with its libm) for a robot that cannot be flattened."""
    with suppress(RobotError):
        return Twin(robot)
    return Dynamics(robot)
