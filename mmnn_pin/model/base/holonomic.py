"""The holonomic base: wheels with rollers, or forces on its frame, velocities `(vx, vy, w)`, and its law."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ...compiled import compiled
from ...elementary import cos_sin
from ...signals import Array
from .base import Base, LinearErrors, PoseEnergy


class HolonomicBase(Base):
    """A base that moves in all directions at once. Gains of its law: kx, ky, kphi [1/s]."""

    kind = "holonomic"
    words = "holonomic bases"
    twist_names = ("vx", "vy", "w")
    columns: ClassVar[list[int]] = [0, 1, 2]
    gain_names = ("holonomic",)
    sideways = True

    @property
    def pushes(self) -> tuple[str, ...]:
        """See `Base.pushes`."""
        return () if self.wheels else ("base_x", "base_y", "base_turn")

    @staticmethod
    def linear_errors(v_ref: Array, gains: Array) -> LinearErrors:
        """See `Base.linear_errors`."""
        vx, vy, wr = v_ref
        rates, command = np.zeros((3, 3)), np.diag(np.asarray(gains, float))
        rates[0, 1], rates[1, 0], rates[0, 2], rates[1, 2] = wr, -wr, -vy, vx
        command[0, 2], command[1, 2] = -vy, vx
        return LinearErrors(rates, -np.eye(3), command)

    @staticmethod
    def pose_energy(error: Array, z: Array, v_ref: Array, gains: Array) -> PoseEnergy | None:
        """See `Base.pose_energy` and `holonomic_command`, whose V it is."""
        kx, ky, kphi = gains.tolist()
        ex, ey, sine, cosine = error[:, 0], error[:, 1], np.sin(error[:, 2]), np.cos(error[:, 2])
        decay = -kx * ex**2 - ky * ey**2 - kphi * sine**2
        return PoseEnergy((ex**2 + ey**2) / 2 + 1 - cosine, decay, ex * z[:, 0] + ey * z[:, 1] + sine * z[:, 2])

    @staticmethod
    def pose_weights(gains: Array) -> Array | None:
        """See `Base.pose_weights`."""
        return np.ones(3)

    @staticmethod
    def largest_gain(gains: Array, speed: float) -> float:
        """See `Base.largest_gain`."""
        return float(max(gains))


@compiled
def holonomic_command(
    error: Array, v_ref: Array, a_ref: Array, velocity: Array, gains: Array, alpha: Array, alphadot: Array
) -> None:
    """Velocity command of a holonomic base and its derivative along the error kinematics.

    `alpha = [R(ephi) (vxr, vyr) + (kx ex, ky ey); wr + kphi sin ephi]`, along which

        exdot = w ey - vx + vxr cos ephi - vyr sin ephi      eydot = -w ex - vy + vxr sin ephi + vyr cos ephi
        ephidot = wr - w

    With `V = (ex^2 + ey^2)/2 + 1 - cos ephi` and `velocity = alpha`, `Vdot = -kx ex^2 - ky ey^2 - kphi sin^2 ephi`:
    strict but for the heading turned by pi, whatever the reference does; `velocity = alpha - z` adds
    `ex z1 + ey z2 + sin(ephi) z3`.

    Args:
        error: (3,) pose error in the base frame [m, m, rad].
        v_ref: (3,) reference velocity (vxr, vyr, wr), in the reference's own frame [m/s, m/s, rad/s].
        a_ref: (3,) its derivative [m/s^2, m/s^2, rad/s^2].
        velocity: (3,) measured velocity (vx, vy, w) [m/s, m/s, rad/s].
        gains: (3,) kx, ky, kphi [1/s].
        alpha: (3,) written: command [m/s, m/s, rad/s].
        alphadot: (3,) written: its derivative [m/s^2, m/s^2, rad/s^2].
    """
    ex, ey, ephi = error[0], error[1], error[2]
    (c, s), w = cos_sin(ephi), velocity[2]
    ux, uy = c * v_ref[0] - s * v_ref[1], s * v_ref[0] + c * v_ref[1]
    exdot, eydot, ephidot = w * ey - velocity[0] + ux, -w * ex - velocity[1] + uy, v_ref[2] - w
    alpha[0] = ux + gains[0] * ex
    alpha[1] = uy + gains[1] * ey
    alpha[2] = v_ref[2] + gains[2] * s
    alphadot[0] = c * a_ref[0] - s * a_ref[1] - uy * ephidot + gains[0] * exdot
    alphadot[1] = s * a_ref[0] + c * a_ref[1] + ux * ephidot + gains[1] * eydot
    alphadot[2] = a_ref[2] + gains[2] * c * ephidot
