"""The errors' part of the Lyapunov function: `V1(pose error) + s' M s / 2`, `s = [z; r]`, and how it changes.

`V1 = (ex^2 + ey^2)/2 + (1 - cos ephi)/ky` for a differential drive: the corrected form of (3.4), which as printed is
indefinite. For a holonomic base the heading counts as `1 - cos ephi`; a fixed arm has no V1. Along a motion

    V1dot = -kx ex^2 - (|vr| kth/ky) sin^2 ephi + ex z1 + (sin ephi/ky) z2        z is the input; (3.19) drops it
    d/dt (s' M s/2) = s' (Psi - torque)                                           by skew symmetry
"""

from __future__ import annotations

import numpy as np

from ...errors import RecordingError
from ...kinematic import Kinematic
from ...model.base import BY_SIZE
from ...model.base.base import PoseEnergy
from ...signals import Array
from .subject import Subject


def pose_part(error: Array, z: Array, v_ref: Array, gains: Kinematic) -> PoseEnergy:
    """V1 and its derivative from the pose error (k, 3), z and the reference's velocity (k, nb); nb = 0 has none.

    Raises:
        RecordingError: `ky` is 0: there is no V1.
    """
    nb = z.shape[1]
    energy = BY_SIZE[nb].pose_energy(error, z, v_ref, gains.base_gains(nb))
    if energy is None:
        raise RecordingError("no Lyapunov function of the pose", why="ky is 0")
    return energy


def pose_of(subject: Subject, rows: Array) -> PoseEnergy:
    """V1 along rows of the truth (k, width); errors as in `pose_part`."""
    where, nb = subject.layout.where, subject.layout.base
    s = rows[:, where("nu_ref")] - rows[:, where("nu")]
    try:
        return pose_part(rows[:, where("pose_error")], s[:, :nb], rows[:, where("velocity_ref")], subject.kinematic)
    except RecordingError as error:
        error.file = subject.recording.path
        raise


def motion_energy(subject: Subject, rows: Array) -> Array:
    """`s' M s / 2` along rows of the truth (k, width) [J]."""
    where, times = subject.layout.where, rows[:, subject.layout.where("time")][:, 0].tolist()
    positions, velocities = (np.ascontiguousarray(rows[:, where(name)]) for name in ("position", "nu"))
    s, found = rows[:, where("nu_ref")] - velocities, np.zeros(len(rows))
    for k, (time, position, nu) in enumerate(zip(times, positions, velocities, strict=True)):
        dynamics = subject.dynamics(time)
        dynamics.refresh(position, nu)
        found[k] = s[k] @ dynamics.M @ s[k] / 2
    return found
