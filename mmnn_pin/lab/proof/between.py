"""The reference inside a control period, as its recorded samples determine it.

Base velocities are cubic Hermite polynomials of the recorded velocities and accelerations, and the pose follows from
integrating them, so that the reference stays one that the base can follow; joints are quintic polynomials of recorded
angles, rates and accelerations.
"""

from __future__ import annotations

import numpy as np

from ...signals import INDEX, Array, Layout


class Between:
    """The reference between the rows of a run, but for the pose.

    Args:
        rows: (N, width) the rows.
        layout: Where signals stand in them.
        period: Time between two rows [s].
    """

    def __init__(self, rows: Array, layout: Layout, period: float) -> None:
        from scipy.interpolate import BPoly, CubicHermiteSpline, PPoly  # slow to import

        time = np.arange(len(rows)) * period
        velocity, acceleration, q, qdot, qddot = (
            rows[:, layout.where(name)]
            for name in ("velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref")
        )
        # coefficients (degree + 1, N - 1, size), highest first, in the time since the row
        self.base = CubicHermiteSpline(time, velocity, acceleration).c if layout.base else np.zeros((4, len(rows), 0))
        joints = np.stack((q, qdot, qddot), axis=1)
        self.arm = PPoly.from_bernstein_basis(BPoly.from_derivatives(time, joints)).c if layout.arm else None
        at = layout.offsets
        self.of_base = slice(int(at[INDEX["velocity_ref"]]), int(at[INDEX["acceleration_ref"] + 1]))
        self.of_arm = slice(int(at[INDEX["q_ref"]]), int(at[INDEX["qddot_ref"] + 1]))

    def write(self, k: int, t: float, row: Array) -> None:
        """Reference at a time t [s] after row k into a row (width,)."""
        row[self.of_base] = np.concatenate(polynomial(self.base[:, k], t)[:2])
        if self.arm is not None:
            row[self.of_arm] = np.concatenate(polynomial(self.arm[:, k], t))


def polynomial(coefficients: Array, t: float) -> tuple[Array, Array, Array]:
    """Value and first two derivatives at t of polynomials (n, m), highest coefficient first; (m,) each."""
    value = rate = half = np.zeros(coefficients.shape[1])
    for c in coefficients:  # Horner's scheme
        half = half * t + rate
        rate = rate * t + value
        value = value * t + c
    return value, rate, 2.0 * half
