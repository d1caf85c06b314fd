"""From pose error to velocity command: Kanayama's law (3.1)-(3.3), its like for a holonomic base, the arm's error.

The arm's part is the filtered error (3.10), (3.11); a fixed arm has nothing else. Everything is computed from the
reference and the Measurement; the derivative of the command is analytic, taken along the error kinematics with the
measured velocities.
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled
from .errors import ConfigError
from .settings import Settings, require_gains
from .signals import INDEX, Array, IntArray, Layout

POSE_REF, VELOCITY_REF, ACCELERATION_REF = INDEX["pose_ref"], INDEX["velocity_ref"], INDEX["acceleration_ref"]
Q_REF, QDOT_REF, QDDOT_REF = INDEX["q_ref"], INDEX["qdot_ref"], INDEX["qddot_ref"]
POSE, VELOCITY, Q, QDOT = INDEX["pose"], INDEX["velocity"], INDEX["q"], INDEX["qdot"]
ALPHA, ALPHADOT, POSE_ERROR, Z = INDEX["alpha"], INDEX["alphadot"], INDEX["pose_error"], INDEX["z"]
WORLD_ERROR = INDEX["world_error"]
E, EDOT, R, NU_REF, NUDOT_REF = INDEX["e"], INDEX["edot"], INDEX["r"], INDEX["nu_ref"], INDEX["nudot_ref"]


@compiled
def wrap(angle: float) -> float:
    """Angle wrapped to (-pi, pi] [rad]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


@compiled
def body_error(pose_ref: Array, pose: Array, error: Array) -> None:
    """Pose error in the base frame, `e_p = T_e(phi) (q_vd - q_v)` (3.1), heading wrapped; writes error (3,)."""
    dx, dy = pose_ref[0] - pose[0], pose_ref[1] - pose[1]
    c, s = math.cos(pose[2]), math.sin(pose[2])
    error[0] = c * dx + s * dy
    error[1] = c * dy - s * dx
    error[2] = wrap(pose_ref[2] - pose[2])


@compiled
def world_error(pose_ref: Array, pose: Array, error: Array) -> None:
    """Pose error in the world frame, `q_vd - q_v`, heading wrapped; writes error (3,)."""
    error[0], error[1] = pose_ref[0] - pose[0], pose_ref[1] - pose[1]
    error[2] = wrap(pose_ref[2] - pose[2])


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
    c, s = math.cos(ephi), math.sin(ephi)
    exdot, eydot, ephidot = w * ey - v + vr * c, -w * ex + vr * s, wr - w  # Eqn. 3.2
    speed, speed_dot = abs(vr), a_ref[0] if vr > 0.0 else -a_ref[0]
    if vr == 0.0:
        speed_dot = abs(a_ref[0])
    alpha[0] = vr * c + kx * ex
    alpha[1] = wr + vr * ky * ey + speed * kth * s
    alphadot[0] = a_ref[0] * c - vr * s * ephidot + kx * exdot
    alphadot[1] = a_ref[1] + ky * (a_ref[0] * ey + vr * eydot) + kth * (speed_dot * s + speed * c * ephidot)


@compiled
def holonomic(
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
    c, s, w = math.cos(ephi), math.sin(ephi), velocity[2]
    ux, uy = c * v_ref[0] - s * v_ref[1], s * v_ref[0] + c * v_ref[1]
    exdot, eydot, ephidot = w * ey - velocity[0] + ux, -w * ex - velocity[1] + uy, v_ref[2] - w
    alpha[0] = ux + gains[0] * ex
    alpha[1] = uy + gains[1] * ey
    alpha[2] = v_ref[2] + gains[2] * s
    alphadot[0] = c * a_ref[0] - s * a_ref[1] - uy * ephidot + gains[0] * exdot
    alphadot[1] = s * a_ref[0] + c * a_ref[1] + ux * ephidot + gains[1] * eydot
    alphadot[2] = a_ref[2] + gains[2] * c * ephidot


@compiled
def command(row: Array, at: IntArray, gains: Array, K: Array) -> None:
    """Velocity command of one sample: fills alpha ... nudot_ref of the row from its reference and measurement.

    Args:
        row: (width,) row of signals.
        at: offsets of the signals (`Layout.offsets`).
        gains: (3,) of the law that fits the base (`Kinematic.base_gains`); unused for a fixed arm.
        K: (n,) gain of the filtered error [1/s].
    """
    nu_ref, nudot_ref = row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]]
    nb, n = at[ALPHA + 1] - at[ALPHA], at[E + 1] - at[E]
    if nb:
        error, velocity = row[at[POSE_ERROR] : at[POSE_ERROR + 1]], row[at[VELOCITY] : at[VELOCITY + 1]]
        alpha, alphadot, z = (
            row[at[ALPHA] : at[ALPHA + 1]],
            row[at[ALPHADOT] : at[ALPHADOT + 1]],
            row[at[Z] : at[Z + 1]],
        )
        pose_ref, pose = row[at[POSE_REF] : at[POSE_REF + 1]], row[at[POSE] : at[POSE + 1]]
        body_error(pose_ref, pose, error)
        world_error(pose_ref, pose, row[at[WORLD_ERROR] : at[WORLD_ERROR + 1]])
        v_ref, a_ref = (
            row[at[VELOCITY_REF] : at[VELOCITY_REF + 1]],
            row[at[ACCELERATION_REF] : at[ACCELERATION_REF + 1]],
        )
        if nb == 3:
            holonomic(error, v_ref, a_ref, velocity, gains, alpha, alphadot)
        else:
            kanayama(error, v_ref, a_ref, velocity, gains, alpha, alphadot)
        for i in range(nb):
            z[i] = alpha[i] - velocity[i]  # Eqn. 3.6
            nu_ref[i], nudot_ref[i] = alpha[i], alphadot[i]
    for i in range(n):
        e, edot = row[at[Q_REF] + i] - row[at[Q] + i], row[at[QDOT_REF] + i] - row[at[QDOT] + i]  # Eqn. 3.10
        row[at[E] + i], row[at[EDOT] + i] = e, edot
        row[at[R] + i] = edot + K[i] * e  # Eqn. 3.11
        nu_ref[nb + i] = row[at[QDOT_REF] + i] + K[i] * e
        nudot_ref[nb + i] = row[at[QDDOT_REF] + i] + K[i] * edot


class Kinematic(Settings, frozen=True):
    """Gains of the kinematic layer.

    Args:
        kx: Differential drive: gain of the error along the heading [1/s].
        ky: Differential drive: gain of the lateral error [1/m^2].
        kth: Differential drive: gain of the heading error [1/m].
        K: Gain of the arm's filtered error `r = edot + K e`, one number or one per joint [1/s].
        holonomic: Holonomic base: gains of the errors along x, along y and of the heading [1/s].

    Raises:
        ConfigError: A gain is negative or not finite.
    """

    kx: float = 10.0
    ky: float = 64.0
    kth: float = 16.0
    K: float | tuple[float, ...] = 7.0
    holonomic: tuple[float, float, float] = (5.0, 5.0, 5.0)

    def __post_init__(self) -> None:
        require_gains(self, "kinematic")

    def base_gains(self, base: int = 2) -> Array:
        """Gains of a base with this many velocities: (kx, ky, kth), or those of a holonomic base for 3; shape (3,)."""
        return np.array(self.holonomic if base == 3 else (self.kx, self.ky, self.kth), float)

    def arm_gains(self, layout: Layout) -> Array:
        """K for every joint, shape (n,).

        Raises:
            ConfigError: As many gains are given as there are joints, or one.
        """
        if np.ndim(self.K) and np.shape(self.K) != (layout.arm,):
            raise ConfigError(
                f"{np.size(self.K)} gains for {layout.arm} joints",
                fix="give one number or one per joint",
                key="kinematic.K",
            )
        return np.ascontiguousarray(np.broadcast_to(np.asarray(self.K, float), (layout.arm,)))
