"""The kinematic law and a period's way of the base as Taylor models in the errors (theory.md, section 9).

The variables are the state of `periods`: pose errors in the reference's frame, joint errors, velocity errors, all
counted from the reference to the robot. Behind them may stand more, which these formulas do not read.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mmnn_pin.signals import Array

from .taylor import Taylor


@dataclass(frozen=True, eq=False)
class Course:
    """A reference and the kinematic law around it, at N instants."""

    v_ref: Array  # (N, nb) velocity of the base [m/s, rad/s]
    a_ref: Array  # (N, nb) its derivative
    qdot_ref: Array  # (N, n)
    qddot_ref: Array  # (N, n)
    gains: Array  # (3,) of the base's law
    K: Array  # (n,) of the arm's [1/s]

    @property
    def poses(self) -> int:
        """Number of pose errors: 3, or 0 of a fixed arm."""
        return 3 if self.v_ref.shape[1] else 0

    @property
    def nu(self) -> Array:
        """(N, p) velocities of the reference."""
        return np.concatenate((self.v_ref, self.qdot_ref), axis=1)

    def at(self, places: slice) -> Course:
        """Some of the instants."""
        v_ref, a_ref, qdot_ref, qddot_ref = (
            one[places] for one in (self.v_ref, self.a_ref, self.qdot_ref, self.qddot_ref)
        )
        return Course(v_ref, a_ref, qdot_ref, qddot_ref, self.gains, self.K)

    def command(self, box: Array) -> tuple[list[Taylor], list[Taylor]]:
        """nu_ref and nudot_ref, p each, for errors in boxes (N, m or more)."""
        n, first = len(self.K), self.poses + len(self.K) + self.v_ref.shape[1]
        errors = [Taylor.variable(self.poses + i, box) for i in range(n)]
        rates = [Taylor.variable(first + i, box) for i in range(n)]
        alpha, alphadot = BASES[self.v_ref.shape[1]](self, box) if self.poses else ([], [])
        nu_ref = [e * -k + self.qdot_ref[:, i] for i, (k, e) in enumerate(zip(self.K, errors, strict=True))]
        nudot_ref = [r * -k + self.qddot_ref[:, i] for i, (k, r) in enumerate(zip(self.K, rates, strict=True))]
        return [*alpha, *nu_ref], [*alphadot, *nudot_ref]

    def velocity(self, box: Array) -> list[Taylor]:
        """Velocities of the base, nb."""
        first = self.poses + len(self.K)
        return [Taylor.variable(first + i, box, self.v_ref[:, i]) for i in range(self.v_ref.shape[1])]


def pose_error(box: Array) -> tuple[Taylor, Taylor, Taylor, Taylor]:
    """(3.1): ex, ey, and cosine and sine of ephi."""
    x, y, (c, s) = Taylor.variable(0, box), Taylor.variable(1, box), (-Taylor.variable(2, box)).turned()
    return s * y - c * x, -(s * x) - c * y, c, s


def differential(course: Course, box: Array) -> tuple[list[Taylor], list[Taylor]]:
    """Kanayama's law and its derivative, see `model.base.differential.kanayama`."""
    (ex, ey, c, s), (v, w) = pose_error(box), course.velocity(box)
    (vr, wr), (a, b), (kx, ky, kth) = course.v_ref.T, course.a_ref.T, course.gains
    exdot, eydot, ephidot = w * ey - v + c * vr, s * vr - w * ex, wr - w
    speed, rise = np.abs(vr), np.where(vr > 0, a, np.where(vr == 0, np.abs(a), -a))
    alpha = [c * vr + ex * kx, ey * (ky * vr) + s * (kth * speed) + wr]
    turning = ey * (ky * a) + eydot * (ky * vr) + s * (kth * rise) + c * ephidot * (kth * speed) + b
    return alpha, [c * a - s * ephidot * vr + exdot * kx, turning]


def holonomic(course: Course, box: Array) -> tuple[list[Taylor], list[Taylor]]:
    """The law of holonomic bases and its derivative, see `model.base.holonomic.holonomic_command`."""
    (ex, ey, c, s), (vx, vy, w), (kx, ky, kphi) = pose_error(box), course.velocity(box), course.gains
    (vxr, vyr, wr), (ax, ay, b) = course.v_ref.T, course.a_ref.T
    ux, uy, ephidot = c * vxr - s * vyr, s * vxr + c * vyr, wr - w
    exdot, eydot = w * ey - vx + ux, uy - w * ex - vy
    alpha = [ux + ex * kx, uy + ey * ky, s * kphi + wr]
    first = c * ax - s * ay - uy * ephidot + exdot * kx
    return alpha, [first, s * ax + c * ay + ux * ephidot + eydot * ky, c * ephidot * kphi + b]


BASES = {2: differential, 3: holonomic}


def driven(pose_ref: Array, way: list[Taylor], turn: Taylor, share: float, box: Array) -> list[Taylor]:
    """Pose errors after a period in which the base goes `way` (x, y) and turns, headed as after a share of the turn.

    Args:
        pose_ref: (N + 1, 3) poses of the reference, the first N at the periods' beginnings.
        way: In the base's frame [m].
        turn: [rad].
        share: Of the turn.
        box: (N, z) of the variables.
    """
    x, y, heading = (Taylor.variable(i, box) for i in range(3))
    (c, s), moved = (turn * share + heading).turned(), np.diff(pose_ref[:, :2], axis=0)
    turned = np.remainder(np.diff(pose_ref[:, 2]) + np.pi, 2 * np.pi) - np.pi
    x, y = x + c * way[0] - s * way[1], y + s * way[0] + c * way[1]
    ahead_c, ahead_s, back_c, back_s = (f(a) for a in (pose_ref[1:, 2], turned) for f in (np.cos, np.sin))
    return [
        x * back_c + y * back_s - (ahead_c * moved[:, 0] + ahead_s * moved[:, 1]),
        y * back_c - x * back_s - (ahead_c * moved[:, 1] - ahead_s * moved[:, 0]),
        heading + turn - turned,
    ]
