"""The comparison of blocks of velocity errors, by the motion itself and by linear programming."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.optimize import linprog

from mmnn_pin.model import load
from research.studies.blocks import comparison, cuts, one_box, radius, study


@pytest.fixture(scope="module")
def robot():
    return load("platform_arm")


def test_sizes_of_blocks_stay_below_their_comparison(robot):
    """`M sdot = -k s` exactly, from random errors, against the comparison's own motion."""
    rng = np.random.default_rng(1)
    for blocks in cuts(robot).values():
        for _ in range(20):
            M, k = robot.mass_matrix(robot.random(rng)), rng.uniform(20.0, 200.0, 4)
            decay, drive = comparison(M, k, blocks)
            roots = [np.linalg.cholesky(np.linalg.inv(np.linalg.inv(M)[np.ix_(a, a)])).T for a in blocks]
            s, t = rng.standard_normal(4), rng.uniform(0.001, 0.05)
            sizes = np.array([np.linalg.norm(root @ s[a]) for a, root in zip(blocks, roots, strict=True)])
            after = expm(-t * np.linalg.solve(M, np.diag(k))) @ s
            bound = expm(t * (drive - np.diag(decay))) @ sizes
            reached = [np.linalg.norm(root @ after[a]) for a, root in zip(blocks, roots, strict=True)]
            assert np.all(reached <= bound * (1 + 1e-9))


def test_single_velocities_compare_by_the_correlations_of_the_inverse_whatever_the_gains_are(robot):
    rng = np.random.default_rng(2)
    M = robot.mass_matrix(robot.random(rng))
    inverse = np.linalg.inv(M)
    correlation = np.abs(inverse / np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))) - np.eye(4)
    expected = np.abs(np.linalg.eigvals(correlation)).max()
    for _ in range(5):
        found = radius(*comparison(M, rng.uniform(1.0, 500.0, 4), cuts(robot)["single velocities"]))
        assert_allclose(found, expected, rtol=1e-10)


def test_the_box_for_all_postures_is_that_of_a_linear_program(robot):
    """Sizes d exist for a little more than the radius, and none for a little less."""
    rng = np.random.default_rng(3)
    masses = [robot.mass_matrix(robot.random(rng)) for _ in range(30)]
    pairs = [comparison(M, np.full(4, 60.0), cuts(robot)["single velocities"]) for M in masses]
    found = one_box(pairs)

    def possible(r: float) -> bool:
        rows = np.vstack([drive - r * np.diag(decay) for decay, drive in pairs])
        rows /= np.abs(rows).max(axis=1, keepdims=True)
        return linprog(np.zeros(4), rows, np.zeros(len(rows)), bounds=[(1e-3, 1.0)] * 4).status == 0

    assert possible(1.001 * found) and not possible(0.999 * found)


def test_single_velocities_compare_in_every_posture_and_no_box_serves_all_of_them(robot):
    """As the page says, on fewer postures; near neutral a box does."""
    both, single = study(robot, "platform_arm", 60)
    assert single.share == 1.0 and single.worst < 1.0 < single.uniform
    assert 1.0 < both.worst < 1.3
    near = study(robot, "platform_arm", 60, spread=0.5)[1]
    assert near.uniform < 1.0
