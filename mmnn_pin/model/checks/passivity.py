"""Passivity: what the torques put into a robot is stored or lost, never made (Property 2, along motions)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...signals import Array
from .terms import Terms


def energy_leak(terms: Terms, position: Array, rng: np.random.Generator, nodes: int = 24) -> float:
    """Passivity: energy gained along a random motion, minus the work of the torques and the loss by friction.

    The motion is a sum of sines over half a second, the torque the one that drives it, `tau = Mbar nudot + Cbar nu +
    gravity + friction` (2.23), the work its integral by Gauss-Legendre. Friction that feeds energy counts as a leak.
    The residual is divided by the sum of the magnitudes of all powers, integrated.
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    duration = 0.5
    motion = Motion.random(terms.robot.layout.dof, rng)
    net, total, fed = 0.0, 0.0, 0.0
    for t, weight in zip((1 + x) * duration / 2, w * duration / 2, strict=True):
        nu, nudot = motion.nu(t), motion.nudot(t)
        q = configuration_along(terms, position, motion, t)
        friction = float(nu @ terms.friction(nu))
        conservative = (
            float(nu @ terms.reduced_mass(q) @ nudot),
            float(nu @ terms.reduced_coriolis(q, nu) @ nu),
            float(nu @ (terms.T.T @ terms.gravity(q))),
        )
        net += weight * sum(conservative)
        fed += weight * max(0.0, -friction)
        total += weight * (sum(map(abs, conservative)) + abs(friction))
    gained = energy_at(terms, position, motion, duration) - energy_at(terms, position, motion, 0.0)
    return (abs(gained - net) + fed) / max(total, np.finfo(float).tiny)


@dataclass(frozen=True)
class Motion:
    """A smooth motion of all independent velocities: `nu = a sin(b t + c)`, each (p,)."""

    a: Array
    b: Array
    c: Array

    @classmethod
    def random(cls, p: int, rng: np.random.Generator) -> Motion:
        """Of speeds about one, turning within a second or a few."""
        return cls(rng.standard_normal(p), rng.uniform(1.0, 6.0, p), rng.uniform(0.0, 2 * np.pi, p))

    def nu(self, t: float) -> Array:
        """Velocities."""
        return self.a * np.sin(self.b * t + self.c)

    def nudot(self, t: float) -> Array:
        """Accelerations."""
        return self.a * self.b * np.cos(self.b * t + self.c)

    def travel(self, t: float) -> Array:
        """Integral of the velocities from 0 to t."""
        return self.a / self.b * (np.cos(self.c) - np.cos(self.b * t + self.c))


def configuration_along(terms: Terms, position: Array, motion: Motion, t: float) -> Array:
    """Pinocchio's q after a time of a motion; the base stays at its place, on which no energy depends, and turns."""
    root = terms.robot.layout.pose
    travel = terms.T @ motion.travel(t)
    travel[: max(0, root - 1)] = 0.0
    return terms.robot.configuration(position + travel)


def energy_at(terms: Terms, position: Array, motion: Motion, t: float) -> float:
    """Kinetic and potential energy after a time of a motion [J]."""
    q, nu = configuration_along(terms, position, motion, t), motion.nu(t)
    return float(nu @ terms.reduced_mass(q) @ nu) / 2 + terms.potential(q)
