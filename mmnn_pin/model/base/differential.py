"""The differential drive: two coaxial wheels, velocities `(v, w)`, Kanayama's law (3.1)-(3.3)."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ...compiled import compiled
from ...elementary import cos_sin
from ...signals import Array
from .base import Base, LinearErrors, PoseEnergy


class DifferentialDrive(Base):
    """A base on two coaxial drive wheels, or on more that count as two: it moves along its x and turns.

    Gains of its law: kx [1/s], ky [1/m^2], kth [1/m].
    """

    kind = "differential_drive"
    words = "differential bases"
    twist_names = ("v", "w")
    columns: ClassVar[list[int]] = [0, 2]
    gain_names = ("kx", "ky", "kth")
    two_sided = True

    @staticmethod
    def linear_errors(v_ref: Array, gains: Array) -> LinearErrors:
        """See `Base.linear_errors`: (3.2), (3.3) around zero errors."""
        vr, wr = v_ref
        kx, ky, kth = gains
        rates, by_velocity, command = np.zeros((3, 3)), np.zeros((3, 2)), np.zeros((2, 3))
        rates[0, 1], rates[1, 0], rates[1, 2] = wr, -wr, vr
        by_velocity[0, 0], by_velocity[2, 1] = -1.0, -1.0
        command[0, 0], command[1, 1], command[1, 2] = kx, vr * ky, abs(vr) * kth
        return LinearErrors(rates, by_velocity, command)

    @staticmethod
    def pose_energy(error: Array, z: Array, v_ref: Array, gains: Array) -> PoseEnergy | None:
        """See `Base.pose_energy`: `V1 = (ex^2 + ey^2) / 2 + (1 - cos ephi) / ky`; there is none without ky."""
        kx, ky, kth = gains.tolist()
        if not ky > 0:
            return None
        ex, ey, sine, cosine = error[:, 0], error[:, 1], np.sin(error[:, 2]), np.cos(error[:, 2])
        turning = sine / ky
        decay = -kx * ex**2 - np.abs(v_ref[:, 0]) * kth * sine * turning
        return PoseEnergy((ex**2 + ey**2) / 2 + (1 - cosine) / ky, decay, ex * z[:, 0] + turning * z[:, 1])

    @staticmethod
    def pose_weights(gains: Array) -> Array | None:
        """See `Base.pose_weights`."""
        return np.array([1.0, 1.0 / gains[1]]) if gains[1] > 0 else None

    @staticmethod
    def largest_gain(gains: Array, speed: float) -> float:
        """See `Base.largest_gain`."""
        return float(max(gains[0], gains[2] * speed))


@compiled
def kanayama(
    error: Array, v_ref: Array, a_ref: Array, velocity: Array, gains: Array, alpha: Array, alphadot: Array
) -> None:
    """Kanayama's velocity command (3.3) and its derivative along the error kinematics (3.2).

    `alpha = [vr cos ephi + kx ex; wr + vr ky ey + |vr| kth sin ephi]`. The thesis prints `vr kth`; with `|vr|` the law
    also tracks in reverse, and for `vr >= 0` the two are the same.

    Args:
        error: (3,) pose error in the base frame [m, m, rad].
        v_ref: (2,) reference velocity (vr, wr) [m/s, rad/s].
        a_ref: (2,) its derivative [m/s^2, rad/s^2].
        velocity: (2,) measured velocity (v, w) [m/s, rad/s].
        gains: (3,) kx [1/s], ky [1/m^2], kth [1/m].
        alpha: (2,) written: command [m/s, rad/s].
        alphadot: (2,) written: its derivative [m/s^2, rad/s^2].
    """
    ex, ey, ephi = error[0], error[1], error[2]
    vr, wr, v, w = v_ref[0], v_ref[1], velocity[0], velocity[1]
    kx, ky, kth = gains[0], gains[1], gains[2]
    c, s = cos_sin(ephi)
    exdot, eydot, ephidot = w * ey - v + vr * c, -w * ex + vr * s, wr - w  # Eqn. 3.2
    speed, speed_dot = abs(vr), a_ref[0] if vr > 0.0 else -a_ref[0]
    if vr == 0.0:
        speed_dot = abs(a_ref[0])
    alpha[0] = vr * c + kx * ex
    alpha[1] = wr + vr * ky * ey + speed * kth * s
    alphadot[0] = a_ref[0] * c - vr * s * ephidot + kx * exdot
    alphadot[1] = a_ref[1] + ky * (a_ref[0] * ey + vr * eydot) + kth * (speed_dot * s + speed * c * ephidot)
