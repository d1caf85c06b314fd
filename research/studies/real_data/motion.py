"""A recorded motion as a learner sees it, and as it is judged.

Positions and torques pass one low-pass without phase, the motion is differentiated by a spline: what
`mmnn_pin.deploy.identify.equations` does. A prediction along the motion passes the same low-pass once more, as the
measured torques do there, and is compared where these equations count: where the joint moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from mmnn_pin.deploy.identify.equations import (
    Equations,
    Unknowns,
    coordinates,
    efforts,
    equations,
    evenly,
    low_pass,
    still_speeds,
)
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.deploy.identify.times import spans
from mmnn_pin.signals import Array, Layout

APART = 1.0  # between two stretches, so that no filter takes one for the other's end [s]


@dataclass(frozen=True, eq=False)
class Stretch:
    """A motion without gaps at even times, low-passed."""

    time: Array  # (N,) [s]
    q: Array  # (N, n) joints
    nu: Array  # (N, p) velocities
    nudot: Array  # (N, p) their time derivative
    torque: Array  # (N, p) measured torques [N m, N]

    @property
    def period(self) -> float:
        """Time between two samples [s]."""
        return float(self.time[1] - self.time[0])

    def rows(self, layout: Layout, start: float) -> Array:
        """Signals of every sample, (N, width), of a fixed arm that follows its reference exactly.

        The torque of a row is the mean over the control period that it begins.

        Args:
            layout: Where the signals stand.
            start: Time of the first row [s].
        """
        rows = np.zeros((len(self.time), layout.width))
        parts = {"q": self.q, "qdot": self.nu, "qddot_ref": self.nudot, "nudot_ref": self.nudot}
        parts |= {"q_ref": self.q, "qdot_ref": self.nu, "nu": self.nu, "nu_ref": self.nu}
        held = np.vstack((0.5 * (self.torque[1:] + self.torque[:-1]), self.torque[-1:]))
        times = start + self.period * np.arange(len(self.time))
        for name, values in (parts | {"torque": held, "time": times[:, None]}).items():
            rows[:, layout.where(name)] = values
        return rows


@dataclass(frozen=True, eq=False)
class Motion:
    """Logs, as stretches and as equations.

    Attributes:
        stretches: Without gaps.
        equations: Of each of them, with the measured torques.
        cutoff: Of the low-pass [Hz].
    """

    stretches: tuple[Stretch, ...]
    equations: tuple[Equations, ...]
    cutoff: float

    @classmethod
    def of(cls, logs: Sequence[Log], unknowns: Unknowns, cutoff: float, period: float) -> Motion:
        """From sound logs; stretches that are too short for the filter are left out.

        Args:
            logs: Sound ones.
            unknowns: What equations are of.
            cutoff: Of the low-pass [Hz].
            period: Of the stretches' samples [s].
        """
        still, stretches, made = still_speeds(logs, unknowns, cutoff), [], []
        for log in logs:
            for where in spans(log.time):
                part = log.rows(where)
                if len(part.time) > 30 and part.time[-1] - part.time[0] > 6 / cutoff:
                    stretches.append(stretch_of(part, unknowns, cutoff, period))
                    made.append(equations(part, unknowns, cutoff, still))
        return cls(tuple(stretches), tuple(made), cutoff)

    @property
    def stacked(self) -> Equations:
        """All equations as one."""
        return Equations.stacked(self.equations)

    def filtered(self, along: Callable[[Stretch], Array]) -> Array:
        """What a function says along the stretches, (N, r, ...), filtered as the measured torques, (M, r, ...)."""
        parts = []
        for stretch, rows in zip(self.stretches, self.equations, strict=True):
            said = np.asarray(along(stretch))
            flat = low_pass(said.reshape(len(said), -1), self.cutoff, 1.0 / stretch.period)
            parts.append(evenly(stretch.time, flat, rows.time).reshape(len(rows.time), *said.shape[1:]))
        return np.concatenate(parts)


def stretch_of(log: Log, unknowns: Unknowns, cutoff: float, period: float) -> Stretch:
    """A log without gaps, low-passed, at even times."""
    robot, own = unknowns.robot, float(np.median(np.diff(log.time)))
    time = np.arange(log.time[0], log.time[-1], own)
    x, _ = coordinates(log, robot)
    tau, _ = efforts(log, robot, unknowns.rows)
    x, tau = (low_pass(evenly(log.time, part, time), cutoff, 1.0 / own) for part in (x, tau))
    spline, at = make_interp_spline(time, x, 5), np.arange(time[0], time[-1], period)
    return Stretch(at, spline(at)[:, robot.dimensions.base :], spline(at, 1), spline(at, 2), evenly(time, tau, at))
