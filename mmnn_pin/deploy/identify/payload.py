"""What a hand carries: mass and centre with intervals, from a short motion with it.

The robot is known, from its maker or better from `identify`. What its torques have too much is `Y_b p`, with Y_b the
columns of the body that carries the load and p the load's ten numbers. Mass and first moments are fitted; the second
moments are those of a point mass at the centre that they give, round by round: what a load turns about its own centre
is seldom visible beside that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import RecordingError, UnknownName
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...signals import Array
from ...torque.pseudo_inertia import BODY
from .equations import Equations, Unknowns, chosen_cutoff, equations, measured_rows, still_speeds
from .least_squares import Base, Fit, inverted, weighted_fit
from .log import Log
from .quality import sound
from .report import links_of

VISIBLE = 4  # of the ten numbers: m and mc
ROUNDS, SETTLED = 100, 1e-5  # of second moments at most; relative change of the mass at which they end
UNSEEN, FAR = (
    1e12,
    10.0,
)  # variance of what no torque tells; standard deviation of a centre from which nothing is known [m]


@dataclass(frozen=True, eq=False)
class Load:
    """What is carried.

    Attributes:
        link: Link that carries it, the first of its body.
        mass: [kg].
        mass_sd: Its standard deviation.
        centre: (3,) in the link's frame [m].
        centre_sd: (3,) of it; inf where no torque tells a coordinate.
        error: Torque error without and with the load, relative to the measured torque.
    """

    link: str
    mass: float
    mass_sd: float
    centre: Array
    centre_sd: Array
    error: tuple[float, float]

    def to_dict(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return {
            "link": self.link,
            "mass": self.mass,
            "mass_sd": self.mass_sd,
            "com": self.centre.tolist(),
            "com_sd": [float(sd) if np.isfinite(sd) else None for sd in self.centre_sd],
            "error_without": self.error[0],
            "error_with": self.error[1],
        }


def payload(
    robot: Robot,
    logs: Log | Sequence[Log],
    joint: str = "",
    cutoff: float | None = None,
    believed: tuple[Array, Array] | None = None,
) -> Load:
    """What a robot that is known carries.

    Args:
        robot: Without the load, best with identified friction.
        logs: Motions with the load.
        joint: Joint whose body carries it; the last of the arm by default.
        cutoff: Of the low-pass [Hz]; by the motion by default.
        believed: Parameters (k,) of the robot's regressor without the load, in place of the URDF's, and their
            covariance (k, k), which the intervals contain.

    Raises:
        UnknownName: No such joint.
        RecordingError: A log that cannot be used, or a motion in which the load is not seen.
    """
    every = [sound(log, robot) for log in ([logs] if isinstance(logs, Log) else logs)]
    unknowns = Unknowns(robot, Regressor.of(robot), measured_rows(robot, every))
    bodies = unknowns.regressor.bodies
    joint = joint or robot.joint_names[-1]
    if joint not in bodies:
        raise UnknownName("joint", joint, bodies)
    cutoff = chosen_cutoff(every, robot) if cutoff is None else cutoff
    still = still_speeds(every, unknowns, cutoff)
    rows = Equations.stacked([equations(log, unknowns, cutoff, still) for log in every])
    if not rows.use.any():
        raise RecordingError("too still a motion", fix="move the load", file=every[0].name)
    first = BODY * bodies.index(joint)
    places = np.array([*range(first, first + VISIBLE), *unknowns.columns("offset")])
    without_load = unknowns.prior.copy()
    if believed is not None:
        without_load[: unknowns.regressor.size] = believed[0]
    left = replace(rows, y=rows.y - rows.Y @ without_load)
    fit, second = weighted_fit(left, Base(places, np.eye(unknowns.size)[places])), np.zeros(BODY - VISIBLE)
    for _ in range(ROUNDS):
        second = point_mass(fit.value[:VISIBLE])
        of_second = left.Y[:, :, first + VISIBLE : first + BODY] @ second
        before, fit = fit.value[0], weighted_fit(replace(left, y=left.y - of_second), fit.base)
        if abs(fit.value[0] - before) <= SETTLED * abs(before):
            break
    if not (fit.seen[0] and fit.value[0] > 0):
        why = f"mass {fit.value[0]:.3g} kg" if fit.seen[0] else "no torque tells its mass"
        raise RecordingError("no load is seen", why=why, fix="turn the wrist against gravity", file=every[0].name)
    link, back = links_of(robot)[joint][0][0], np.linalg.inv(links_of(robot)[joint][0][1])
    mass, lever = float(fit.value[0]), fit.value[1:VISIBLE] / fit.value[0]
    slope = back[:3, :3] @ np.column_stack((-lever, np.eye(3))) / mass
    covariance = fit.covariance + (0.0 if believed is None else inherited(left, fit, believed[1]))
    mass_sd = float(np.sqrt(covariance[0, 0]))
    covariance = covariance[:VISIBLE, :VISIBLE] + np.diag(np.where(fit.seen[:VISIBLE], 0.0, UNSEEN))
    sd = np.sqrt(np.diag(slope @ covariance @ slope.T))
    size = np.sqrt((np.where(rows.use, rows.y, 0.0) ** 2).sum())
    errors = [left.y, left.y - of_second - left.Y[:, :, places] @ fit.value]
    without, after = (float(np.sqrt((np.where(rows.use, e, 0.0) ** 2).sum()) / size) for e in errors)
    centre = back[:3, :3] @ lever + back[:3, 3]
    return Load(link, mass, mass_sd, centre, np.where(sd > FAR, np.inf, sd), (without, after))


def inherited(rows: Equations, fit: Fit, covariance: Array) -> Array:
    """What the doubt of the robot's own parameters adds to the covariance of a fit of the rest, (b, b)."""
    size = covariance.shape[0]
    A, mixed = np.zeros((len(fit.value), len(fit.value))), np.zeros((len(fit.value), size))
    for i in np.flatnonzero(np.isfinite(fit.deviation)):
        X = rows.Y[:, i, fit.base.independent]
        weighed = X * (fit.weights[:, i] / fit.deviation[i] ** 2)[:, None]
        A += weighed.T @ X
        mixed += weighed.T @ rows.Y[:, i, :size]
    moved = inverted(A)[0] @ mixed
    return np.asarray(moved @ covariance @ moved.T)


def point_mass(first: Array) -> Array:
    """Second moments xx xy xz yy yz zz of a point with mass and first moments (4,); zero without mass."""
    mass, moment = first[0], first[1:]
    return np.outer(moment, moment)[np.triu_indices(3)] / mass if mass > 0 else np.zeros(BODY - VISIBLE)
