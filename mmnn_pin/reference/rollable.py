"""The motion nearest to a planner's samples that wheels can roll.

Samples of a planner that steps once every 0.1 s are of no motion that rolls: where they turn they slip by millimetres.
Here `(v, w)` at the nodes of a grid, linear between them, are found so that the poses that follow from them pass the
samples as closely as they can and change no more sharply than they must: least squares under the equations of rolling

    phi' = w,  x' = v cos phi,  y' = v sin phi        (Simpson's rule between two nodes; exact in phi)

by Gauss-Newton, every step one sparse linear system (Nocedal and Wright 2006, Numerical Optimization, 18.1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..elementary.arrays import atan2, cos_sin, hypot
from ..errors import TrajectoryError
from ..signals import Array

STEP = 0.05  # longest between two nodes [s]
CLOSE, TURNED = 0.003, 0.01  # errors that weigh as much as one another [m, rad]
QUICK = 0.4  # changes of the speed that take longer than this, or two samples, are hardly smoothed [s]
ROUNDS, SETTLED = 30, 1e-7
MOST_NODES = 100_000
STANDS = 1e-4  # a way between two samples below which it has no direction [m]


@dataclass(frozen=True, eq=False)
class RollingMotion:
    """A motion that rolls, and how far from the samples it passes."""

    time: Array  # (M,) nodes [s]
    pose: Array  # (M, 3) `(x, y, phi)`, phi unwrapped [m, m, rad]
    velocity: Array  # (M, 2) `(v, w)` [m/s, rad/s]
    rows: NDArray[np.int64]  # (N,) nodes of the samples
    apart: Array  # (N,) distance from every sample [m]
    turned: Array  # (N,) difference of heading [rad]; 0 where the samples have none


def grid_of(time: Array) -> tuple[Array, NDArray[np.int64]]:
    """Nodes (M,) that are at most `STEP` apart, and which of them are the samples' times (N,).

    Raises:
        TrajectoryError: They would be too many.
    """
    counts = np.maximum(np.ceil(np.diff(time) / STEP - 1e-9).astype(int), 1)
    if counts.sum() > MOST_NODES:
        what, why = f"{len(time):,} samples over {time[-1] - time[0]:,.0f} s", "a motion that rolls is sought near them"
        fix = f"give the time in seconds, at most {MOST_NODES * STEP:,.0f} of them, and at most {MOST_NODES:,} samples"
        raise TrajectoryError(what, why=why, fix=fix)
    rows = np.append(0, np.cumsum(counts))
    nodes = np.interp(np.arange(rows[-1] + 1), rows, time)
    return nodes, rows


def moved(pose: Array, velocity: Array, steps: Array) -> Array:
    """Poses (M - 1, 3) at the next nodes, from poses (M, 3) and velocities (M, 2) at these."""
    (v0, w0), (v1, w1) = velocity[:-1].T, velocity[1:].T
    phi = pose[:-1, 2]
    middle, end = phi + steps * (3 * w0 + w1) / 8, phi + steps * (w0 + w1) / 2
    c, s = (a + 4 * b + d for a, b, d in zip(
        scaled(v0, phi), scaled((v0 + v1) / 2, middle), scaled(v1, end), strict=True))  # fmt: skip
    return np.column_stack((pose[:-1, 0] + steps * c / 6, pose[:-1, 1] + steps * s / 6, end))


def scaled(v: Array, phi: Array) -> tuple[Array, Array]:
    """Components of speeds along headings."""
    c, s = cos_sin(phi)
    return v * c, v * s


def driven_from(start: Array, velocity: Array, steps: Array) -> Array:
    """Poses (M, 3) of a base that starts at (3,) and moves with velocities (M, 2)."""
    phi = start[2] + np.append(0.0, np.cumsum(steps * (velocity[1:, 1] + velocity[:-1, 1]) / 2))
    flat = np.column_stack((np.zeros((len(phi), 2)), phi))
    ways = moved(flat, velocity, steps)[:, :2]
    flat[:, :2] = start[:2] + np.vstack(([0.0, 0.0], np.cumsum(ways, axis=0)))
    return flat


def headings_along(way: Array) -> Array:
    """Headings (N,) along points (N, 2), unwrapped; where it stands, that of the next motion."""
    steps = np.diff(way, axis=0)
    lengths = hypot(*steps.T)
    moves = np.flatnonzero(lengths > STANDS)
    if not len(moves):
        return np.zeros(len(way))
    angle = np.unwrap(atan2(steps[moves, 1], steps[moves, 0]))
    middles = moves + 0.5
    return np.asarray(np.interp(np.arange(len(way)), middles, angle))


def nearest(time: Array, pose: Array, headed: bool = True) -> RollingMotion:
    """The motion that rolls nearest to samples.

    Args:
        time: (N,) increasing times [s].
        pose: (N, 3) poses, phi unwrapped [m, m, rad]; (N, 2) points where `headed` is not said.
        headed: Whether the samples have headings; else they drive forwards.

    Raises:
        TrajectoryError: They are too many.
    """
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    nodes, rows = grid_of(time)
    steps = np.diff(nodes)
    if not headed:
        pose = np.column_stack((pose[:, :2], headings_along(pose[:, :2])))
    guess = np.column_stack([np.interp(nodes, time, column) for column in pose.T])
    velocity = speeds_of(guess, steps)
    problem = Problem(nodes, rows, pose, headed, max(float(abs(velocity).max()), 1e-3))
    unknown, m = np.hstack((guess, velocity)), len(nodes)
    for _ in range(ROUNDS):
        matrix, right = problem.system(unknown)
        change = splu(csc_matrix(matrix)).solve(right)[: 5 * m].reshape(m, 5)
        change *= min(1.0, 0.5 / max(float(abs(change[:, 2]).max()), 1e-300))
        unknown = unknown + change
        if abs(change).max() < SETTLED:
            break
    velocity = unknown[:, 3:]
    driven = driven_from(unknown[0, :3], velocity, steps)
    off = driven[rows] - pose
    turned = abs(off[:, 2]) if headed else np.zeros(len(rows))
    return RollingMotion(nodes, driven, velocity, rows, hypot(*off[:, :2].T), turned)


def speeds_of(pose: Array, steps: Array) -> Array:
    """Velocities (M, 2) with which a base would move from pose (M, 3) to pose, roughly."""
    rates = np.diff(pose, axis=0) / steps[:, None]
    c, s = cos_sin((pose[1:, 2] + pose[:-1, 2]) / 2)
    between = np.column_stack((rates[:, 0] * c + rates[:, 1] * s, rates[:, 2]))
    padded = np.vstack((between[:1], between, between[-1:]))
    return np.asarray((padded[1:] + padded[:-1]) / 2)


class Problem:
    """Least squares under the equations of rolling, at one guess after the other.

    The unknowns of a node are `x, y, phi, v, w`; the multipliers of the equations stand behind them.

    Args:
        nodes: (M,) times [s].
        rows: (N,) nodes of the samples.
        pose: (N, 3) samples.
        headed: Whether their headings count.
        fast: Largest speed that occurs, by which changes are measured [m/s, rad/s].
    """

    def __init__(self, nodes: Array, rows: NDArray[np.int64], pose: Array, headed: bool, fast: float) -> None:
        from scipy.sparse import coo_matrix, diags

        self.steps, self.rows, self.pose, self.m = np.diff(nodes), rows, pose, len(nodes)
        weights = np.tile([CLOSE**-2, CLOSE**-2, TURNED**-2 * headed], (len(rows), 1))
        weights[0] *= 1e4  # it starts where it is told to
        if not headed:
            weights[:, 2] = 1e-6 * TURNED**-2  # so that one that stands has some heading
        self.weights = weights
        n = 5 * self.m
        fit = np.zeros((self.m, 5))
        fit[rows, :3] = weights
        # changes of the slope of v and of w, as a spline has them
        h = self.steps
        inner = np.arange(1, self.m - 1)
        width = np.sqrt((h[:-1] + h[1:]) / 2) * max(QUICK, 2 * float(np.median(np.diff(nodes[rows])))) ** 2 / fast
        entries = [1 / h[:-1], -(1 / h[:-1] + 1 / h[1:]), 1 / h[1:]]
        blocks = []
        for column in (3, 4):
            places = np.concatenate([5 * (inner + shift) + column for shift in (-1, 0, 1)])
            values = np.concatenate([width * entry / ((h[:-1] + h[1:]) / 2) for entry in entries])
            blocks.append(coo_matrix((values, (np.tile(inner - 1, 3), places)), shape=(self.m, n)))
        smooth = sum((block.T @ block for block in blocks), start=0)
        self.smooth = smooth
        self.normal = (diags(fit.ravel()) + smooth + diags(np.full(n, 1e-9))).tocoo()

    def system(self, unknown: Array) -> tuple[object, Array]:
        """The sparse matrix and right side of the step from a guess (M, 5)."""
        from scipy.sparse import bmat, coo_matrix

        m, h = self.m, self.steps
        residual = np.zeros((m, 5))
        residual[self.rows, :3] = self.weights * (self.pose - unknown[self.rows, :3])
        downhill = residual.ravel() - self.smooth @ unknown.ravel()
        defect = moved(unknown[:, :3], unknown[:, 3:], h) - unknown[1:, :3]
        jacobian = slopes(unknown, h)  # (M - 1, 3, 10)
        places = 5 * np.arange(m - 1)[:, None, None] + np.arange(10)[None, None, :]
        lines = 3 * np.arange(m - 1)[:, None, None] + np.arange(3)[None, :, None]
        shape = (m - 1, 3, 10)
        equations = coo_matrix(
            (jacobian.ravel(), (np.broadcast_to(lines, shape).ravel(), np.broadcast_to(places, shape).ravel())),
            shape=(3 * (m - 1), 5 * m),
        )
        matrix = bmat([[self.normal, equations.T], [equations, None]], format="csc")
        return matrix, np.concatenate((downhill, -defect.ravel()))


def slopes(unknown: Array, steps: Array) -> Array:
    """(M - 1, 3, 10) derivatives of `moved(...) - next pose` by the unknowns of a node and of the next one."""
    (v0, w0), (v1, w1), phi, h = unknown[:-1, 3:].T, unknown[1:, 3:].T, unknown[:-1, 2], steps
    middle, end = phi + h * (3 * w0 + w1) / 8, phi + h * (w0 + w1) / 2
    vm = (v0 + v1) / 2
    (c0, s0), (cm, sm), (c1, s1) = cos_sin(phi), cos_sin(middle), cos_sin(end)
    found = np.zeros((len(h), 3, 10))
    found[:, :, 5:8] = -np.eye(3)
    found[:, 0, 0] = found[:, 1, 1] = found[:, 2, 2] = 1.0
    found[:, 0, 2] = -h / 6 * (v0 * s0 + 4 * vm * sm + v1 * s1)
    found[:, 1, 2] = h / 6 * (v0 * c0 + 4 * vm * cm + v1 * c1)
    found[:, 0, 3], found[:, 1, 3] = h / 6 * (c0 + 2 * cm), h / 6 * (s0 + 2 * sm)
    found[:, 0, 8], found[:, 1, 8] = h / 6 * (2 * cm + c1), h / 6 * (2 * sm + s1)
    for column, at_middle, at_end in ((4, 3 * h / 8, h / 2), (9, h / 8, h / 2)):
        found[:, 0, column] = -h / 6 * (4 * vm * sm * at_middle + v1 * s1 * at_end)
        found[:, 1, column] = h / 6 * (4 * vm * cm * at_middle + v1 * c1 * at_end)
        found[:, 2, column] = h / 2
    return found
