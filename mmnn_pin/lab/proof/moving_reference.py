"""Is a recorded reference one motion: do poses, velocities and accelerations of its samples belong together?

Between two samples a rate that moves smoothly from f0 to f1, with derivatives g0 and g1, adds
`h (f0 + f1)/2 + h^2 (g0 - g1)/12` (corrected trapezoidal rule, an error of order h^5); a rate without them `h (f0 +
f1)/2`. Poses of a table may drift away from its velocities by a little, which the certificate counts with; a velocity
that jumps gives the errors a jump, which it cannot.
"""

from __future__ import annotations

import numpy as np

from ...signals import Array

TOLERANCE = 1e-3  # of the largest rate


def drift(pose: Array, velocity: Array, acceleration: Array, period: float) -> tuple[float, float]:
    """Largest speed [m/s] and yaw rate [rad/s] at which poses (N, 3) leave those that velocities (N, 2) lead to."""
    (v, w), (vdot, wdot), (c, s) = velocity.T, acceleration.T, (np.cos(pose[:, 2]), np.sin(pose[:, 2]))
    rate = np.stack([v * c, v * s, w], axis=1)
    change = np.stack([vdot * c - v * w * s, vdot * s + v * w * c, wdot], axis=1)
    off = np.diff(pose, axis=0) / period - mean(rate) + period / 12 * np.diff(change, axis=0)
    return float(np.hypot(off[:, 0], off[:, 1]).max(initial=0.0)), float(np.abs(off[:, 2]).max(initial=0.0))


def jump(time: Array, value: Array, rate: Array, period: float) -> float:
    """When values (N, k) first change by something else than their rates (N, k) say [s]; nan if never."""
    off = np.abs(np.diff(value, axis=0) / period - mean(rate))
    rounding = 1e-14 * np.abs(value).max(axis=0) / period
    fastest = np.maximum(np.abs(rate).max(axis=0), 1e-6 * np.abs(value).max(axis=0))
    found = (off > TOLERANCE * fastest + rounding).any(axis=1)
    return float(time[int(np.argmax(found))]) if found.any() else float("nan")


def mean(rate: Array) -> Array:
    """Of every two samples that follow each other, (N - 1, k)."""
    return (rate[1:] + rate[:-1]) / 2
