"""Radii of the wheels and track from odometry against a reference pose, such as that of a motion capture system.

The wheels' angles turn into a path by the base's own law, with unknown radii left and right and an unknown track b:

    phi = phi_0 + (r_right theta_right - r_left theta_left) / b,    ds = (r_right dtheta_right + r_left dtheta_left) / 2

The reference is that path, from an unknown start, seen by a marker somewhere on the base (Antonelli, Chiaverini, Fusco
2005, IEEE T-RO 21(5), have the same unknowns but the marker). Nonlinear least squares; residuals that are correlated in
time widen the standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from ...elementary.arrays import unwrapped
from ...errors import RecordingError
from ...model.robot import Robot
from ...signals import Array
from .log import REFERENCE, Log

NAMES = ("radius_left", "radius_right", "track")
ROWS = 2000  # of a log at most
TURNED = 1.0  # heading that has to change for a track to be seen [rad]
TRAVELLED = 0.5  # way that has to be driven for radii to be seen [m]


@dataclass(frozen=True, eq=False)
class Wheels:
    """Wheels of a differential or skid-steer base.

    Attributes:
        value: (3,) left and right radius, track [m].
        sd: (3,) their standard deviations [m].
        urdf: (3,) what the robot had.
        error: RMS distance of the path from the reference [m], and before.
    """

    value: Array
    sd: Array
    urdf: Array
    error: tuple[float, float]

    def to_dict(self) -> dict[str, dict[str, float]]:
        """Value, sd and the former value by name."""
        rows = zip(NAMES, self.value.tolist(), self.sd.tolist(), self.urdf.tolist(), strict=True)
        return {name: {"value": value, "sd": sd, "urdf": urdf} for name, value, sd, urdf in rows}


def has_reference(log: Log, robot: Robot) -> bool:
    """Whether a log has a reference pose, and the angles of a base on two sides of wheels."""
    wheels = [wheel.joint for wheel in robot.base.wheels]
    angles = all(name in log.position for name in wheels)
    return robot.base.two_sided and angles and all(name in log.reference for name in REFERENCE)


def wheels_of(robot: Robot, logs: Sequence[Log]) -> Wheels:
    """Radii and track that lead the wheels' angles along the reference.

    Raises:
        RecordingError: The base hardly drives or turns.
    """
    sides = [side_angles(log, robot) for log in logs]
    poses = [np.column_stack([log.reference[name][rows_of(log)] for name in REFERENCE]) for log in logs]
    for pose in poses:
        pose[:, 2] = unwrapped(pose[:, 2])
    way = sum(float(np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1).sum()) for pose in poses)
    if way < TRAVELLED or max(np.ptp(pose[:, 2]) for pose in poses) < TURNED:
        why = f"it drives {way:.2g} m; radii and track need {TRAVELLED:g} m and {TURNED:g} rad"
        raise RecordingError("too small a drive for wheels", why=why, fix="drive an eight", file=logs[0].name)
    radius = np.array([np.mean([w.radius for w in robot.base.wheels if (w.y > 0) == left]) for left in (True, False)])
    urdf = np.array([*radius, robot.base.track])

    def residual(x: Array, fixed: Array | None = None) -> Array:
        numbers = x[:3] if fixed is None else fixed
        parts = []
        for i, (angles, pose) in enumerate(zip(sides, poses, strict=True)):
            parts.append(
                (seen(path(angles, numbers, x[6 + 3 * i : 9 + 3 * i]), x[3:6]) - pose) * np.array([1, 1, urdf[2]])
            )
        return np.concatenate(parts).ravel()

    starts = [start for pose in poses for start in pose[0]]
    first = np.array([*urdf, 0.0, 0.0, 0.0, *starts])
    solution = least_squares(residual, first, x_scale=np.array([*urdf, 0.1, 0.1, 0.1, *([1.0] * len(starts))]))
    before = least_squares(lambda x: residual(np.concatenate((urdf, x)), urdf), first[3:])
    covariance = np.linalg.pinv(solution.jac.T @ solution.jac) * np.mean(solution.fun**2) * correlated(solution.fun)
    errors = [float(np.sqrt(np.mean(fun.reshape(-1, 3)[:, :2] ** 2) * 2)) for fun in (solution.fun, before.fun)]
    return Wheels(solution.x[:3], np.sqrt(np.diag(covariance)[:3]), urdf, (errors[0], errors[1]))


def rows_of(log: Log) -> slice:
    """Every n-th row, `ROWS` at most."""
    return slice(None, None, max(1, len(log.time) // ROWS))


def side_angles(log: Log, robot: Robot) -> Array:
    """Angles that the wheels of the left and of the right side have turned forward, (N, 2), their means."""
    found = []
    for left in (True, False):
        own = [wheel for wheel in robot.base.wheels if (wheel.y > 0) == left]
        found.append(np.mean([wheel.sign * log.position[wheel.joint] for wheel in own], axis=0)[rows_of(log)])
    angles = np.column_stack(found)
    return np.asarray(angles - angles[0])


def path(angles: Array, numbers: Array, start: Array) -> Array:
    """Poses (N, 3) of a base whose wheels turn by angles (N, 2), by radii and track, from a start (3,); exact arcs."""
    left, right = numbers[0] * angles[:, 0], numbers[1] * angles[:, 1]
    phi = start[2] + (right - left) / numbers[2]
    way, turn = np.diff(left + right) / 2, np.diff(phi)
    chord, middle = way * np.sinc(turn / (2 * np.pi)), (phi[1:] + phi[:-1]) / 2
    x = start[0] + np.concatenate(([0.0], np.cumsum(chord * np.cos(middle))))
    y = start[1] + np.concatenate(([0.0], np.cumsum(chord * np.sin(middle))))
    return np.column_stack((x, y, phi))


def seen(pose: Array, marker: Array) -> Array:
    """Poses of a marker (x, y, angle) on the base, (N, 3)."""
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x, y = pose[:, 0] + c * marker[0] - s * marker[1], pose[:, 1] + s * marker[0] + c * marker[1]
    return np.column_stack((x, y, pose[:, 2] + marker[2]))


def correlated(residual: Array) -> float:
    """How many residuals say as much as one: 1 and twice their autocorrelation, up to where it is lost in noise."""
    rows = residual.reshape(-1, 3) - residual.reshape(-1, 3).mean(axis=0)
    power, total = float((rows**2).sum()), 1.0
    for lag in range(1, len(rows) // 4):
        rho = float((rows[lag:] * rows[:-lag]).sum()) / max(power, 1e-300)
        if rho < 2 / np.sqrt(len(rows)):
            break
        total += 2 * rho
    return total
