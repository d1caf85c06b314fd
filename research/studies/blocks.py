"""Would an energy for each block certify more than one for all? `python -m research.studies.blocks`.

Velocity errors under feedback alone obey `M sdot = -k s` in a posture that is held fixed. With blocks (base, arm) or
single velocities, each with a size of its own, `|s_a|` in a metric, the sizes obey
`d|s_a|/dt <= -lambda_a |s_a| + sum_b c_ab |s_b|`, and they shrink whatever the signs are if and only if the spectral
radius of `c_ab / lambda_a` is below 1 (Lakshmikantham, Matrosov and Sivasundaram 1991, vector Lyapunov functions). For
single velocities no metric and no gain changes it: it is that of the off-diagonal entries of the correlation matrix of
`M^-1`, without signs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mmnn_pin.lab.show.table import Column, Table, number, row_of, terminal_text
from mmnn_pin.model import Robot, load
from mmnn_pin.signals import Array

ROBOTS = ("platform_arm", "tiago_no_hand", "tiago")
BANDWIDTH = 60.0  # of every velocity, by its effective inertia in the neutral posture [1/s]
POSTURES, SEED = 400, 0
ITERATIONS = 300


@dataclass(frozen=True)
class Found:
    """One robot cut in one way."""

    robot: str  # its name
    blocks: str  # how it is cut
    share: float  # of the postures, in which the comparison holds
    worst: float  # largest spectral radius of one posture
    # the radius of one box for all postures: below 1 some sizes `d > 0` have `sum_b c_ab d_b < lambda_a d_a` in all of
    # them
    uniform: float


def cuts(robot: Robot) -> dict[str, list[list[int]]]:
    """The velocities of every block."""
    base, p = robot.dimensions.base, robot.dimensions.dof
    return {"base and arm": [list(range(base)), list(range(base, p))], "single velocities": [[i] for i in range(p)]}


def comparison(M: Array, k: Array, blocks: list[list[int]]) -> tuple[Array, Array]:
    """`lambda_a` and `c_ab` of one posture, each block in the metric of its own inertia.

    That is the inertia which the block has where the others are free to move, `((M^-1)_aa)^-1`. In it the block's own
    part of `M^-1 k` is symmetric and positive, so every block alone shrinks.
    """
    F = -np.linalg.solve(M, np.diag(k))
    roots = [np.linalg.cholesky(np.linalg.inv(np.linalg.inv(M)[np.ix_(a, a)])).T for a in blocks]
    decay, drive = np.empty(len(blocks)), np.zeros((len(blocks), len(blocks)))
    for i, a in enumerate(blocks):
        for j, b in enumerate(blocks):
            part = roots[i] @ F[np.ix_(a, b)] @ np.linalg.inv(roots[j])
            if i == j:
                decay[i] = np.linalg.eigvalsh(-part)[0]
            else:
                drive[i, j] = np.linalg.norm(part, 2)
    return decay, drive


def radius(decay: Array, drive: Array) -> float:
    """Spectral radius of `c_ab / lambda_a`."""
    return float(np.abs(np.linalg.eigvals(drive / decay[:, None])).max())


def one_box(pairs: Sequence[tuple[Array, Array]]) -> float:
    """The least r for which some `d > 0` has `sum_b c_ab d_b <= r lambda_a d_a` in every posture.

    The largest of every row makes one monotone map of d, so the power method finds it. Errors leave a box of sizes d
    through one face first, and there only that row counts.
    """
    ratios = np.array([drive / decay[:, None] for decay, drive in pairs])
    sizes = np.ones(ratios.shape[1])
    for _ in range(ITERATIONS):
        grown = (ratios @ sizes).max(axis=0) + sizes  # the added sizes make it converge where blocks alternate
        sizes = grown / grown.max()
    return float(((ratios @ sizes).max(axis=0) / sizes).max())


def posture(robot: Robot, rng: np.random.Generator, spread: float | None) -> Array:
    """A random posture: anywhere, or with the arm's joints at most `spread` [rad or m] from neutral."""
    if spread is None:
        return robot.random(rng)
    q, arm = robot.neutral(), robot.dimensions.pose
    q[arm:] += rng.uniform(-spread, spread, len(q) - arm)
    return q


def study(robot: Robot, name: str, postures: int = POSTURES, spread: float | None = None) -> list[Found]:
    """Every cut of a robot, over random postures."""
    rng = np.random.default_rng(SEED)
    neutral = robot.mass_matrix(robot.neutral())
    k = BANDWIDTH / np.diag(np.linalg.inv(neutral))
    masses = [robot.mass_matrix(posture(robot, rng, spread)) for _ in range(postures)]
    found = []
    for title, blocks in cuts(robot).items():
        pairs = [comparison(M, k, blocks) for M in masses]
        radii = np.array([radius(*pair) for pair in pairs])
        found.append(Found(name, title, float(np.mean(radii < 1)), float(radii.max()), one_box(pairs)))
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m research.studies.blocks", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("robots", nargs="*", default=ROBOTS, help="names or URDF files")
    parser.add_argument("--spread", type=float, help="arm joints at most so far from neutral [rad or m]; else anywhere")
    given = parser.parse_args(arguments)
    found = [one for name in given.robots for one in study(load(name), name, spread=given.spread)]
    rows = [row_of(one.robot, one.blocks, *map(number, (100 * one.share, one.worst, one.uniform))) for one in found]
    heads = (
        Column(text=True),
        Column("blocks\n", text=True),
        Column("holds in\n", "% of postures"),
        Column("radius\n", "largest"),
        Column("radius\n", "one box for all"),
    )
    print(terminal_text([Table("blocks", heads, tuple(rows))], False, 120))


if __name__ == "__main__":
    main()
