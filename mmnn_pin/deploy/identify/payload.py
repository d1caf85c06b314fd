"""The load of a hand: its mass and centre with intervals, from a short motion with it.

The load is what the torques have beyond the robot's own, `Y_b p`, with Y_b the columns of the body that carries it. But
the robot is not known exactly: an error of its last link looks like a load. So the robot's parameters are fitted with
the load's, `y = Y (theta_0 + B x) + Y_b p`, with x of standard deviation s: one for all bodies, relative to each. How
large s is the motion tells: it is known by how well `y` is explained beforehand (the evidence, MacKay 1992, Neural
Computation 4(3)), and the answer is the mean over all s, so that its interval has the doubt of s as well.
Friction and constants are free. A motion without the load tells the robot's errors from the load's.

p has mass and first moments, and the second moments of a point mass at the centre that these give, linear about the
last estimate; what a load turns about its own centre is as large as that of a ball of radius of gyration `BALL`, or 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from ...errors import RecordingError, UnknownName
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...signals import Array
from ...torque.prior import DOUBT
from ...torque.pseudo_inertia import BODY
from .doctor import examined, require_no_contradiction
from .equations import (
    Bools,
    Equations,
    Unknowns,
    chosen_cutoff,
    equations,
    measured_rows,
    require_identifiable,
    still_speeds,
)
from .least_squares import FINEST, BaseParameters, WeightedFit, inverted, meat, weighted_fit
from .log import Log
from .programme import BALL, LIGHT, WIDE, Prior
from .quality import sound
from .report import links_of

VISIBLE = 4  # of the ten numbers: m and mc
ROUNDS, SETTLED = 10, 1e-3  # of second moments at most; relative change of the mass at which they end
TURNS = 4  # of residual variances in each of them
SELDOM = 0.01  # likelihood of a size of errors, over that of the best, below which it does not count
LONGEST = 1.0  # distance of a load from its joint up to which its second moments follow the centre [m]
SCALES = (0.005, 0.0125, 0.03, 0.08, 0.2, DOUBT)  # of the doubt in every body, relative
SHAPES = (0.2, 1.0)  # doubt in the ten numbers of a body by themselves, over that in all of them together
TIMES = (1.0, 10.0)  # of the deviations of a covariance that is given
BESIDE = (1e-4, 0.003, 0.01, 0.03, 0.1)  # and of what its parameters are off beside, relative
UNSEEN = 1e12  # variance of what no torque tells
FAR = 10.0  # standard deviation of a centre from which nothing is known [m]


@dataclass(frozen=True, eq=False)
class CarriedLoad:
    """The load that a robot carries."""

    link: str  # link that carries it, the first of its body
    mass: float  # [kg]
    mass_sd: float  # its standard deviation
    centre: Array  # (3,) in the link's frame [m]
    centre_sd: Array  # (3,) of it; inf where no torque tells a coordinate
    error: tuple[float, float]  # torque error without and with the load, relative to the measured torque
    doubt: float  # how far off the robot's bodies are, relative; its parameters beside a covariance that is given

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
            "doubt": self.doubt,
        }


def payload(
    robot: Robot,
    logs: Log | Sequence[Log],
    joint: str = "",
    cutoff: float | None = None,
    believed: tuple[Array, Array] | None = None,
    without: Log | Sequence[Log] = (),
) -> CarriedLoad:
    """Mass and centre of the load that a robot carries.

    Args:
        robot: Without the load.
        logs: Motions with the load.
        joint: Joint whose body carries it; the last of the arm by default.
        cutoff: Of the low-pass [Hz]; by the motion by default.
        believed: Parameters (k,) of the robot's regressor without the load, in place of the URDF's, and their
            covariance (k, k).
        without: Motions without the load, best the same ones: they separate the load from the robot's own errors.

    Raises:
        RobotError: Its base steers.
        UnknownName: No such joint.
        RecordingError: A log that cannot be used or contradicts the physics, or a motion in which the load is not seen.
    """
    require_identifiable(robot)
    loaded, empty = (
        [examined(sound(log, robot), robot).log for log in ([some] if isinstance(some, Log) else some)]
        for some in (logs, without)
    )
    every = [*loaded, *empty]
    require_no_contradiction(every)
    unknowns = Unknowns(robot, Regressor.of(robot), measured_rows(robot, every))
    bodies = unknowns.regressor.bodies
    joint = joint or robot.joint_names[-1]
    if joint not in bodies:
        raise UnknownName("joint", joint, bodies)
    cutoff = chosen_cutoff(every, robot) if cutoff is None else cutoff
    still = still_speeds(every, unknowns, cutoff)
    parts = [equations(log, unknowns, cutoff, still) for log in every]
    if not any(part.use.any() for part in parts[: len(loaded)]):
        raise RecordingError("too still a motion", fix="move the load", file=every[0].name)
    rows, carries = Equations.stacked(parts), np.repeat(np.arange(len(parts)) < len(loaded), [len(p) for p in parts])
    numbers = numbers_of(rows, carries, doubts(unknowns, rows, believed), bodies.index(joint))
    if not (numbers.seen[0] and numbers.value[0] > 0):
        why = f"mass {numbers.value[0]:.3g} kg" if numbers.seen[0] else "no torque tells its mass"
        raise RecordingError("no load is seen", why=why, fix="turn the wrist against gravity", file=every[0].name)
    link, back = links_of(robot)[joint][0][0], np.linalg.inv(links_of(robot)[joint][0][1])
    mass, lever = float(numbers.value[0]), numbers.value[1:] / numbers.value[0]
    slope = back[:3, :3] @ np.column_stack((-lever, np.eye(3))) / mass
    hidden = np.diag(np.where(numbers.seen, 0.0, UNSEEN))
    sd = np.sqrt(np.diag(slope @ (numbers.covariance + hidden) @ slope.T))
    centre, mass_sd = back[:3, :3] @ lever + back[:3, 3], float(np.sqrt(numbers.covariance[0, 0]))
    return CarriedLoad(link, mass, mass_sd, centre, np.where(sd > FAR, np.inf, sd), numbers.error, numbers.scale)


# -- mass and first moments, and the robot's errors --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Doubts:
    """The uncertainty of a robot's parameters: `theta = centre + B x`."""

    centre: Array  # (k,) parameters without a load
    B: Array  # (k, m)
    scales: Array  # (S,) the s that may be
    likely: Array  # (S,) how likely each is beforehand
    sd: Array  # (S, m) of x with each


@dataclass(frozen=True, eq=False)
class LoadNumbers:
    """Mass and first moments of a load."""

    value: Array  # (4,) in the joint's frame [kg, kg m]
    covariance: Array  # (4, 4)
    seen: Bools  # (4,) whether the motion determines each
    error: tuple[float, float]  # torque error without and with the load, relative to the measured torque
    scale: float  # mean of s


def doubts(unknowns: Unknowns, rows: Equations, believed: tuple[Array, Array] | None = None) -> Doubts:
    """The doubts in a URDF, whose friction is not known; or in a covariance, which may be too small.

    Bodies of a URDF are heavier or lighter as they are, or off in each of their ten numbers.
    """
    prior, k = Prior.of(unknowns, rows), unknowns.regressor.size
    if believed is not None:
        centre, B = unknowns.prior.copy(), prior.B * WIDE
        values, vectors = np.linalg.eigh(believed[1])
        centre[:k], B[:, :k], B[:k, :k] = believed[0], 0.0, vectors * np.sqrt(np.maximum(values, 0.0))
        scales, times = (part.ravel() for part in np.meshgrid(BESIDE, TIMES))
        given = np.where(np.arange(B.shape[1]) < k, times[:, None], 1.0)
        sd = np.hstack((given, np.repeat(scales[:, None], k, axis=1)))
        return Doubts(centre, np.hstack((B, np.eye(len(B), k) * centre[:k])), scales, np.ones(len(scales)), sd)
    first, bodies = unknowns.regressor.inertial, prior.bodies
    whole = np.zeros((unknowns.size, bodies))
    whole[np.arange(first), np.repeat(np.arange(bodies), BODY)] = unknowns.prior[:first]
    scales, shapes = (part.ravel() for part in np.meshgrid(SCALES, SHAPES))
    own = np.where(prior.strength >= 1, (scales * shapes)[:, None], WIDE)
    sd = np.hstack((own, np.repeat(scales[:, None], bodies, axis=1)))
    return Doubts(unknowns.prior, np.hstack((prior.B, whole)), scales, scales, sd)  # s up to the largest alike


def numbers_of(rows: Equations, carries: Bools, robot: Doubts, body: int) -> LoadNumbers:
    """Mass and first moments, the mean over all scales of the robot's errors.

    Args:
        rows: Equations of all motions.
        carries: (M,) where there is a load.
        robot: What it may be.
        body: Which of its bodies carries the load.
    """
    of_load = rows.Y[:, :, BODY * body : BODY * (body + 1)] * carries[:, None, None]
    columns = np.concatenate((rows.Y @ robot.B, of_load), axis=2)
    given, own = replace(rows, Y=columns, y=rows.y - rows.Y @ robot.centre), np.arange(columns.shape[2])
    widest = weighted_fit(given, BaseParameters(own, np.eye(len(own))), sureness(robot.sd[-1], np.ones(1)))
    sums = LoadSums.of(given, widest)
    fits, p = [], widest.value[-BODY : VISIBLE - BODY]
    for sd in robot.sd[::-1]:
        fits.append(sums.fitted(sd, p))
        p = fits[-1].load
    fits = fits[::-1]
    likely = np.array([fit.evidence for fit in fits])
    weights = robot.likely * np.exp(likely - likely.max())
    weights = np.where(weights > SELDOM * weights.max(), weights, 0.0)
    weights /= weights.sum()
    loads, best = np.array([fit.load for fit in fits]), fits[int(np.argmax(weights))]
    mean = weights @ loads
    covariance = np.einsum("s,si,sj->ij", weights, loads - mean, loads - mean)
    for weight, fit in zip(weights, fits, strict=True):
        if weight > 0:
            covariance += weight * fit.covariance(given, widest, sums.spread)
    errors = given.y, given.y - given.Y @ best.value
    size = np.sqrt((np.where(rows.use, rows.y, 0.0) ** 2).sum())
    without, after = (float(np.sqrt((np.where(rows.use, e, 0.0) ** 2).sum()) / size) for e in errors)
    seen = widest.seen[-BODY : VISIBLE - BODY]
    return LoadNumbers(mean, covariance, seen, (without, after), float(weights @ robot.scales))


@dataclass(frozen=True, eq=False)
class LoadSums:
    """Weighted sums over the equations in the robot's errors and the load's ten numbers, m + 10 columns."""

    A: Array  # (r, m + 10, m + 10) `X' W X` of every row that counts
    b: Array  # (r, m + 10) `X' W y`
    c: Array  # (r,) `y' W y`
    count: Array  # (r,) sum of the weights W
    least: Array  # (r,) variance that a row has at least
    spread: float  # how many equations say as much as one of their own

    @classmethod
    def of(cls, given: Equations, fit: WeightedFit) -> LoadSums:
        """With the weights of a fit."""
        A, b, c = [], [], []
        there = np.flatnonzero(np.isfinite(fit.deviation))
        for i in there:
            X = np.ascontiguousarray(given.Y[:, i])
            weighed, y = X * fit.weights[:, i, None], given.y[:, i]
            A.append(X.T @ weighed)
            b.append(weighed.T @ y)
            c.append(float(fit.weights[:, i] @ y**2))
        count = fit.weights[:, there].sum(axis=0)
        least = FINEST**2 * np.array(c) / np.maximum(count, 1.0)
        return cls(np.array(A), np.array(b), np.array(c), count, least, max(1.0, fit.inflation))

    def fitted(self, sd: Array, p: Array) -> Posterior:
        """The fit with errors of the robot of deviations sd (m,), begun at a load p (4,), by residual variances."""
        m, variance, value = len(sd), np.maximum(self.c / self.count, self.least), np.zeros(len(sd) + BODY)
        for _ in range(ROUNDS):
            before, T, sure = p[0], np.eye(m + BODY), sureness(sd, p)
            T[m + VISIBLE :, m : m + VISIBLE] = slopes(p)
            A = np.array([T.T @ one @ T for one in self.A])
            for _ in range(TURNS):
                total = np.tensordot(1 / variance, A, (0, 0)) / self.spread
                inverse, _, _ = inverted(total + np.diag(sure))
                value = inverse @ (T.T @ (self.b.T @ (1 / variance))) / self.spread
                full = T @ value
                square = (self.A @ full) @ full - 2 * self.b @ full + self.c
                free = self.count - (A * inverse).sum(axis=(1, 2)) / variance / self.spread
                variance = np.maximum(square / np.maximum(free, 1.0), self.least)
            p = full[m : m + VISIBLE]
            if abs(p[0] - before) <= SETTLED * abs(before):
                break
        size = 1 / np.sqrt(np.diag(total) + sure + 1e-300)
        values = scipy.linalg.eigh((total + np.diag(sure)) * np.outer(size, size), eigvals_only=True)
        volume = np.log(np.maximum(values, 1e-12)).sum() - 2 * np.log(size).sum() - np.log(sure[sure > 0]).sum()
        noise = (self.count * np.log(variance) + square / variance).sum() / self.spread
        return Posterior(full, T, sure, inverse, np.sqrt(variance), float(-0.5 * (noise + value**2 @ sure + volume)))


@dataclass(frozen=True, eq=False)
class Posterior:
    """A fit of the robot's errors and the load's numbers."""

    value: Array  # (m + 10,) of the columns
    T: Array  # (m + 10, m + 10) from what is fitted to them: with mass and first moments go the second ones of a point
    sure: Array  # (m + 10,) what is known beforehand, 1 / sd^2
    inverse: Array  # (m + 10, m + 10) of the information, the spread counted
    deviation: Array  # (r,) of rows that count
    evidence: float  # logarithm of the density of the torques beforehand, up to a constant

    @property
    def load(self) -> Array:
        """Mass and first moments, (4,)."""
        return self.value[-BODY : VISIBLE - BODY]

    def covariance(self, given: Equations, fit: WeightedFit, spread: float) -> Array:
        """Of mass and first moments, (4, 4), of residuals that are correlated in time.

        Args:
            given: The equations.
            fit: With their weights.
            spread: How many equations say as much as one of their own.
        """
        X, deviation = given.Y @ self.T, np.full(len(fit.deviation), np.nan)
        deviation[np.isfinite(fit.deviation)] = self.deviation
        residual = np.where(given.use, given.y - given.Y @ self.value, 0.0)
        B = meat(X, residual, fit.weights, deviation, given, self.inverse / spread) / spread**2
        at = slice(-BODY, VISIBLE - BODY)
        return np.asarray(self.inverse[at] @ (B + np.diag(self.sure)) @ self.inverse[:, at])


def sureness(sd: Array, p: Array) -> Array:
    """1 / sd^2 of robot (m,), mass, first moments and own second moments beforehand, (m + 10,)."""
    own = 1 / (max(p[0], LIGHT) * BALL**2) ** 2
    return np.concatenate((sd**-2.0, np.zeros(VISIBLE), np.full(BODY - VISIBLE, own)))


def slopes(p: Array) -> Array:
    """Second moments xx xy xz yy yz zz of a point by its mass and first moments (4,), (6, 4); 0 without mass.

    They are of degree 1, so second moments are these times p.
    """
    if not p[0] > 0:
        return np.zeros((BODY - VISIBLE, VISIBLE))
    c = p[1:] / p[0]
    c = c * min(1.0, LONGEST / max(float(np.linalg.norm(c)), 1e-12))
    eye, upper = np.eye(3), np.triu_indices(3)
    columns = [-np.outer(c, c), *(np.outer(e, c) + np.outer(c, e) for e in eye)]
    return np.column_stack([column[upper] for column in columns])
