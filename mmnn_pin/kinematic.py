"""From pose error to velocity command: the law of the base, Kanayama's (3.1)-(3.3) or its like, and the arm's error.

The laws stand with the bases that they drive (`model.base`). The arm's part is the filtered error (3.10), (3.11); a
fixed arm has nothing else. Everything is computed from the reference and the Measurement; the derivative of the
command is analytic, taken along the error kinematics with the measured velocities.
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import compiled, internal
from .elementary import cos_sin
from .model.base import kind_of, velocity_command
from .model.base.base import LinearErrors
from .parts import view
from .settings import Settings, one_or_each, require_gains
from .signals import INDEX, SIDEWAYS, Array, Dimensions, IntArray

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
    c, s = cos_sin(pose[2])
    error[0] = c * dx + s * dy
    error[1] = c * dy - s * dx
    error[2] = wrap(pose_ref[2] - pose[2])


@compiled
def world_error(pose_ref: Array, pose: Array, error: Array) -> None:
    """Pose error in the world frame, `q_vd - q_v`, heading wrapped; writes error (3,)."""
    error[0], error[1] = pose_ref[0] - pose[0], pose_ref[1] - pose[1]
    error[2] = wrap(pose_ref[2] - pose[2])


@internal
def command(row: Array, at: IntArray, gains: Array, K: Array) -> None:
    """Velocity command of one sample: fills alpha ... nudot_ref of the row from its reference and measurement.

    Args:
        row: (width,) row of signals.
        at: offsets of the signals (`Layout.offsets`).
        gains: (3,) of the law that fits the base (`Kinematic.base_gains`); unused for a fixed arm.
        K: (n,) gain of the filtered error [1/s].
    """
    nu_ref, nudot_ref = view(row, at, NU_REF), view(row, at, NUDOT_REF)
    nb, n = at[ALPHA + 1] - at[ALPHA], at[E + 1] - at[E]
    if nb:
        error, velocity = view(row, at, POSE_ERROR), view(row, at, VELOCITY)
        alpha, alphadot, z = (view(row, at, ALPHA), view(row, at, ALPHADOT), view(row, at, Z))
        pose_ref, pose = view(row, at, POSE_REF), view(row, at, POSE)
        body_error(pose_ref, pose, error)
        world_error(pose_ref, pose, view(row, at, WORLD_ERROR))
        v_ref, a_ref = (view(row, at, VELOCITY_REF), view(row, at, ACCELERATION_REF))
        velocity_command(at[SIDEWAYS], error, v_ref, a_ref, velocity, gains, alpha, alphadot)
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

    def base_gains(self, layout: Dimensions) -> Array:
        """Gains of the law of a robot's base, (3,); zeros for a fixed arm, which has none."""
        names = kind_of(layout).gain_names
        return np.hstack([getattr(self, name) for name in names]).astype(float) if names else np.zeros(3)

    def linear_errors(self, layout: Dimensions, v_ref: Array) -> LinearErrors:
        """The pose error under the law for small errors at a reference velocity (nb,), see `Base.linear_errors`."""
        return kind_of(layout).linear_errors(v_ref, self.base_gains(layout))

    def pose_weights(self, layout: Dimensions) -> Array | None:
        """Weights of the squares of the errors of a base's velocities in its pose error, (base,); None for all alike.

        They are second derivatives of the Lyapunov function of the pose error (`Base.pose_weights`).
        """
        return kind_of(layout).pose_weights(self.base_gains(layout))

    def arm_gains(self, layout: Dimensions) -> Array:
        """K for every joint, shape (n,).

        Raises:
            ConfigError: Neither one gain nor one per joint.
        """
        return one_or_each(self.K, layout.arm, "joint", "kinematic.K")
