"""The part of the Lyapunov function that a recording tells: `V = V1(pose error) + s' M s / 2`, `s = [z; r]`.

`V1 = (ex^2 + ey^2)/2 + (1 - cos ephi)/ky` for a differential drive: the corrected form of (3.4), which as printed is
indefinite. For a holonomic base the heading counts as `1 - cos ephi`; a fixed arm has no V1. The derivative comes from
recorded signals, without a difference in time:

    V1dot = -kx ex^2 - (|vr| kth/ky) sin^2 ephi + ex z1 + (sin ephi/ky) z2        z is the input; (3.19) drops it
    d/dt (s' M s/2) = s' (Psi - torque)                                           by skew symmetry

The thesis's V also has the networks' weight errors, which need the ideal weights: no recording tells them, so a V that
rises here is no counterexample to the proof. Torque is held between samples, and wheels that slip or sensors that err
break these lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import RecordingError
from ..kinematic import Kinematic
from ..metrics import as_columns
from ..model.dynamics import Dynamics
from ..recorded_robot import recorded_robot
from ..recording import Recording
from ..signals import Array

MOST = 1000  # samples at which the mass matrix is computed


@dataclass(frozen=True, eq=False)
class Lyapunov:
    """V along a run, at (k,) samples.

    Attributes:
        time: [s].
        pose: V1 [m^2].
        motion: s' M s / 2 [J].
        pose_rate: Derivative of V1 [m^2/s].
        motion_rate: Derivative of the other part [W].
    """

    time: Array
    pose: Array
    motion: Array
    pose_rate: Array
    motion_rate: Array

    @property
    def derivative(self) -> Array:
        """Derivative of V."""
        return self.pose_rate + self.motion_rate

    @property
    def total(self) -> Array:
        """V, whose two parts the thesis adds as numbers in SI units."""
        return self.pose + self.motion


def lyapunov(recording: Recording, most: int = MOST) -> Lyapunov:
    """V of a run, at no more than `most` samples, evenly spaced.

    Raises:
        RecordingError: It does not tell its robot or its gains, or `ky` is 0, for which there is no V1.
    """
    robot = recorded_robot(recording)
    if "kinematic" not in recording.meta:
        raise RecordingError("the recording does not tell the gains of its kinematic layer", file=recording.path)
    if "nu" not in recording:
        why = "it was recorded outside a simulation, where the state and Psi are not known"
        raise RecordingError("no Lyapunov function", why=why, file=recording.path)
    gains = Kinematic(**recording.meta["kinematic"])
    rows = np.arange(len(recording))[:: max(1, -(-len(recording) // most))]
    rows = rows[np.isfinite(as_columns(recording["position"])[rows]).all(axis=1)]
    s = (as_columns(recording["nu_ref"]) - as_columns(recording["nu"]))[rows]
    dynamics, positions = Dynamics(robot), as_columns(recording["position"])[rows]
    motion = np.array([v @ dynamics.mass_matrix(x) @ v / 2 for x, v in zip(positions, s, strict=True)])
    power = (s * (as_columns(recording["psi"]) - as_columns(recording["torque"]))[rows]).sum(axis=1)
    nb = robot.layout.base
    pose, rate = np.zeros(len(rows)), np.zeros(len(rows))
    if nb:
        v_ref = as_columns(recording["velocity_ref"])[rows]
        pose, rate = pose_part(recording["pose_error"][rows], s[:, :nb], v_ref, gains, recording)
    return Lyapunov(recording.time[rows], pose, motion.reshape(len(rows)), rate, power)


def pose_part(error: Array, z: Array, v_ref: Array, gains: Kinematic, recording: Recording) -> tuple[Array, Array]:
    """V1 and its derivative, (k,) each, from the pose error (k, 3), z and the reference's velocity (k, nb)."""
    ex, ey, sine, cosine = error[:, 0], error[:, 1], np.sin(error[:, 2]), np.cos(error[:, 2])
    if z.shape[1] == 3:
        kx, ky, kphi = gains.holonomic
        rate = -kx * ex**2 - ky * ey**2 - kphi * sine**2 + ex * z[:, 0] + ey * z[:, 1] + sine * z[:, 2]
        return (ex**2 + ey**2) / 2 + 1 - cosine, rate
    if not gains.ky > 0:
        raise RecordingError("no Lyapunov function of the pose", why="ky is 0", file=recording.path)
    turning = sine / gains.ky
    rate = -gains.kx * ex**2 - np.abs(v_ref[:, 0]) * gains.kth * sine * turning + ex * z[:, 0] + turning * z[:, 1]
    return (ex**2 + ey**2) / 2 + (1 - cosine) / gains.ky, rate
