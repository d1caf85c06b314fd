"""The robot along its reference, sampled: what the bounds on the energy of the errors are made of.

Mass, Coriolis and gravity terms at configurations around the reference; everything that follows from them holds for
these configurations, not for all between (its source is "sampled" in a certificate). Spread: the arm's configuration is
the reference's plus an offset in a box, its corners first.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...loop.before_run import viscous_friction
from ...model.dynamics import Dynamics
from ...model.robot import Robot
from ...signals import Array, IntArray

SAMPLES = 240


@dataclass(frozen=True, eq=False)
class Along:
    """A reference at N instants.

    Attributes:
        v_ref: (N, 2) vr, wr [m/s, rad/s].
        a_ref: (N, 2) their derivatives.
        q_ref: (N, n) [rad or m].
        qdot_ref: (N, n).
        qddot_ref: (N, n).
        pose_ref: (N, 3) [m, m, rad].
    """

    v_ref: Array
    a_ref: Array
    q_ref: Array
    qdot_ref: Array
    qddot_ref: Array
    pose_ref: Array

    def at(self, places: IntArray) -> Along:
        """The reference at some of the instants."""
        return Along(*(getattr(self, name)[places] for name in self.__dataclass_fields__))

    @property
    def nu(self) -> Array:
        """Velocities without any error, (N, p)."""
        return np.concatenate((self.v_ref, self.qdot_ref), axis=1)

    @property
    def nudot(self) -> Array:
        """Accelerations without any error, (N, p)."""
        return np.concatenate((self.a_ref, self.qddot_ref), axis=1)


@dataclass(frozen=True, eq=False)
class MotionSamples:
    """Terms of the reduced dynamics at N instants of a reference.

    Args:
        along: The reference there.
        q: (N, n) the arm's configurations, off the reference by up to `spread` [rad or m].
        M: (N, p, p) mass matrices.
        coriolis: (N, p, p, p): `C(q, nu)_ik = sum_j coriolis_ijk nu_j`.
        gravity: (N, p).
        viscous: (p, p) viscous friction on nu, positive semi-definite.
        dry: (p,) largest dry friction on nu.
        spread: (n,) half-width of the box of the arm's offsets from the reference [rad or m].
        decoupled: Whether the size of arm errors counts every joint by itself, see `arm_metric`.
    """

    along: Along
    q: Array
    M: Array
    coriolis: Array
    gravity: Array
    viscous: Array
    dry: Array
    spread: Array
    decoupled: bool = False
    root_inverse: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "root_inverse", np.linalg.inv(np.linalg.cholesky(self.M)))

    def thinned(self, step: int) -> MotionSamples:
        """Every step-th sample."""
        keep = np.arange(0, len(self.M), step)
        M, C, gravity = self.M[keep], self.coriolis[keep], self.gravity[keep]
        return replace(self, along=self.along.at(keep), q=self.q[keep], M=M, coriolis=C, gravity=gravity)

    @cached_property
    def M_inverse(self) -> Array:
        """(N, p, p)."""
        return np.asarray(np.linalg.inv(self.M))

    @cached_property
    def lightest(self) -> Array:
        """(p,) largest `(M^-1)_ii`: an energy E of the errors allows `|s_i| <= sqrt(2 E (M^-1)_ii)`."""
        return np.asarray(np.einsum("nii->ni", self.M_inverse).max(axis=0))

    def fastest(self, gain: Array) -> float:
        """Largest eigenvalue of `M^-1 diag(gain)` [1/s]; inf for gains (p,) without bound."""
        if not np.isfinite(gain).all():
            return np.inf
        L = self.root_inverse
        return float(np.linalg.eigvalsh(L * gain @ L.swapaxes(1, 2)).max())

    @cached_property
    def arm_metric(self) -> Array:
        """N (n, n): the size of an arm error e is `sqrt(e' N e)`.

        The arm's inertia with the base free; `decoupled` the inverse of what is on the diagonal of its inverse.
        """
        mean = self.M_inverse[:, 2:, 2:].mean(axis=0)
        return np.diag(1 / np.diag(mean)) if self.decoupled else np.asarray(np.linalg.inv(mean))

    @cached_property
    def arm_root(self) -> Array:
        """(n, n): `e = arm_root y` with |y| the size of e."""
        return np.linalg.inv(np.linalg.cholesky(self.arm_metric)).T

    @cached_property
    def joint_reach(self) -> Array:
        """(n,) largest |e_i| for a size of 1."""
        return np.linalg.norm(self.arm_root, axis=1)

    @cached_property
    def arm_gain(self) -> float:
        """Largest `|r|_N / sqrt(s' M s)`."""
        if not self.M.shape[1] > 2:
            return 0.0
        root = np.linalg.cholesky(self.arm_metric)
        return float(np.sqrt(np.linalg.eigvalsh(root.T @ self.M_inverse[:, 2:, 2:] @ root).max()))

    def arm_decay(self, K: Array) -> float:
        """Rate at which the size of the arm errors decays for r = 0 [1/s]: of `e' N e`, with edot = r - K e, K (n,)."""
        N = self.arm_metric
        if not len(N):
            return np.inf
        L, NK = np.linalg.inv(np.linalg.cholesky(N)), N * K
        return float(np.linalg.eigvalsh(L @ (NK + NK.T) @ L.T / 2)[0])

    @cached_property
    def gyration(self) -> Array:
        """(N, p) rates: `|s' C(q, s) e_k| <= gyration_k s' M s`."""
        return self.rate(self.coriolis.transpose(0, 3, 1, 2))

    @cached_property
    def shears(self) -> Array:
        """(N, p, p) rates: `|s' M E_ik s| <= shears_ik s' M s`, E_ik the matrix with a single 1."""
        p = self.M.shape[1]
        units = np.eye(p * p).reshape(p * p, p, p)
        return self.rate(np.einsum("nij,ujk->nuik", self.M, units)).reshape(-1, p, p)

    def rate(self, X: Array) -> Array:
        """Largest `|s' X s| / s' M s` of matrices (N, k, p, p); (N, k) [1/s]."""
        L = self.root_inverse[:, None]
        symmetric = (X + X.swapaxes(2, 3)) / 2
        return np.asarray(np.abs(np.linalg.eigvalsh(L @ symmetric @ L.swapaxes(2, 3))).max(axis=-1))


def sample(robot: Robot, along: Along, spread: Array, seed: int = 0, samples: int = SAMPLES) -> MotionSamples:
    """Terms along a whole reference (T instants), `samples` of them, the arm spread around it."""
    rng, n, dynamics = np.random.default_rng(seed), robot.layout.arm, Dynamics(robot)
    places = np.unique(np.linspace(0, len(along.v_ref) - 1, samples).astype(int))
    places = np.resize(places, samples)  # a short reference is sampled again with other offsets
    offsets = rng.uniform(-1, 1, (samples, n))
    offsets[: samples * 3 // 4] = np.where(offsets[: samples * 3 // 4] < 0, -1.0, 1.0)
    offsets[::4] = 0.0
    rng.shuffle(offsets)
    here, p = along.at(places), robot.layout.dof
    M, C, g = np.zeros((samples, p, p)), np.zeros((samples, p, p, p)), np.zeros((samples, p))
    position = robot.neutral_position()
    for k in range(samples):
        position[robot.arm_index] = here.q_ref[k] + offsets[k] * spread
        placed = robot.follow(position)
        M[k], g[k] = dynamics.mass_matrix(placed), dynamics.gravity(placed)
        for j, unit in enumerate(np.eye(p)):
            C[k, :, j, :] = dynamics.coriolis_matrix(placed, unit)
    dry = np.abs(robot.T).T @ robot.dry[:, :2].sum(axis=1)
    return MotionSamples(here, here.q_ref + offsets * spread, M, C, g, viscous_friction(robot), dry, spread)
