"""Wherever a robot may be along its reference: boxes of joint positions that hold all that the arm may reach.

While the arm errors are within their size the robot is, at every instant of the reference, in one of the boxes of a
`Cover`, in which M, C and gravity are known in the middle and bounded elsewhere (`postures`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from mmnn_pin.loop.before_run import viscous_friction
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import Robot
from mmnn_pin.signals import Array, IntArray

from .postures import Postures, postures
from .screws import Bodies

STRETCHES = 120  # of the reference, at most
EFFORT, FEWEST = 20000, 160  # boxes of a cover times p^2; boxes of any cover
FEW = 50  # boxes for a first look
BENT = 0.03  # of M, up to which a box is not cut in two
METRICS = 60  # instants of the reference, in which a metric of arm errors is looked for


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

    @property
    def nu(self) -> Array:
        """Velocities without any error, (N, p)."""
        return np.concatenate((self.v_ref, self.qdot_ref), axis=1)

    @property
    def nudot(self) -> Array:
        """Accelerations without any error, (N, p)."""
        return np.concatenate((self.a_ref, self.qddot_ref), axis=1)

    def stretches(self, most: int) -> tuple[tuple[Array, Array], ...]:
        """Middles and half-widths of q_ref, nu and nudot over stretches that together are all of it; (K, .) each.

        Between two instants a signal goes from one value to the other, and beyond them by at most half their distance.
        """
        edges = np.unique(np.linspace(0, len(self.v_ref) - 1, most + 1).astype(int))
        edges = edges if len(edges) > 1 else np.array([0, 0])
        result = []
        for signal in (self.q_ref, self.nu, self.nudot):
            low, high = (np.empty((len(edges) - 1, signal.shape[1])) for _ in range(2))
            for k, (a, b) in enumerate(pairwise(edges)):
                part = signal[a : b + 1]
                beyond = np.abs(np.diff(part, axis=0)).max(axis=0, initial=0.0) / 2
                low[k], high[k] = part.min(axis=0) - beyond, part.max(axis=0) + beyond
            result.append(((low + high) / 2, (high - low) / 2))
        return tuple(result)


@dataclass(frozen=True, eq=False)
class ArmMetric:
    """N (n, n): the size of an arm error e is `sqrt(e' N e)`. Any does that is positive definite."""

    N: Array  # the arm's inertia with the base free, or one that counts every joint by itself

    @classmethod
    def best(cls, robot: Robot, along: Along, K: Array) -> ArmMetric:
        """The one whose errors a given energy drives less far: the inertia; or, for gains K (n,) that differ, diagonal.

        Both are means along the reference, the second the inverse of what is on the diagonal of the inverse.
        """
        dynamics, position = Dynamics(robot), robot.neutral_position()
        inverses = []
        for k in np.linspace(0, len(along.v_ref) - 1, METRICS).astype(int):
            position[robot.arm_index] = along.q_ref[k]
            inverses.append(np.linalg.inv(dynamics.mass_matrix(robot.follow(position)))[2:, 2:])
        mean = np.mean(inverses, axis=0)
        coupled, single = cls(np.linalg.inv(mean)), cls(np.diag(1 / np.diag(mean)))
        if not len(mean) or not np.ptp(K):
            return coupled
        return max((coupled, single), key=lambda one: one.decay(K) / one.driven(np.array(inverses)))

    @cached_property
    def root(self) -> Array:
        """(n, n): `e = root y` with |y| the size of e."""
        return np.linalg.inv(np.linalg.cholesky(self.N)).T

    @cached_property
    def reach(self) -> Array:
        """(n,) largest |e_i| for a size of 1."""
        return np.linalg.norm(self.root, axis=1)

    def driven(self, inverses: Array) -> float:
        """Largest `|r|_N / sqrt(s' M s)` for the arm's parts (N, n, n) of `M^-1`."""
        if not len(self.N):
            return 0.0
        L = np.linalg.cholesky(self.N)
        return float(np.sqrt(np.linalg.eigvalsh(L.T @ inverses @ L).max()))

    def decay(self, K: Array) -> float:
        """Rate at which the size of the arm errors decays for r = 0 [1/s]: of `e' N e`, with edot = r - K e, K (n,)."""
        if not len(self.N):
            return np.inf
        L, NK = np.linalg.inv(np.linalg.cholesky(self.N)), self.N * K
        return float(np.linalg.eigvalsh(L @ (NK + NK.T) @ L.T / 2)[0])


@dataclass(frozen=True, eq=False)
class Cover:
    """Terms of the reduced dynamics wherever the robot may be, in N boxes."""

    nu: Array  # (N, p) velocities without any error in the middle of each box's stretch of the reference
    nu_off: Array  # (N, p) how far off they may be
    nudot: Array  # (N, p) accelerations without any error
    nudot_off: Array  # (N, p) how far off they may be
    postures: Postures  # terms over the boxes; all `mass_off` below 1
    viscous: Array  # (p, p) viscous friction on nu, positive semi-definite
    dry: Array  # (p,) largest dry friction on nu
    metric: ArmMetric  # of the arm errors
    size: float  # of the arm errors up to which the boxes hold all
    beyond: float = 0.0  # how far joints beside their places there are in the boxes, too [rad or m]

    @classmethod
    def of(
        cls, robot: Robot, bodies: Bodies, along: Along, metric: ArmMetric, size: float, beyond: float = 0.0
    ) -> Cover:
        """The cover of a whole reference with arm errors of up to a size; boxes in which M bends are cut in two."""
        dry = np.abs(robot.T).T @ robot.dry[:, :2].sum(axis=1)
        (q, q_off), (nu, nu_off), (nudot, nudot_off) = along.stretches(STRETCHES)
        q_off = q_off + size * metric.reach + beyond
        most = max(EFFORT // nu.shape[1] ** 2, FEWEST)
        owner, found = np.arange(len(q)), postures(bodies, q, q_off)
        while len(owner) < most and (bent := found.mass_off > BENT).any() and q.shape[1]:
            worst = np.argsort(-found.mass_off)[: min(int(bent.sum()), most - len(owner))]
            kept = np.setdiff1d(np.arange(len(owner)), worst)
            cut = postures(bodies, *halves(found.q[worst], found.half[worst], found.bend[worst].argmax(axis=1), beyond))
            owner = np.concatenate((owner[kept], owner[worst], owner[worst]))
            found = found.at(kept).joined(cut)
        nu, nu_off, nudot, nudot_off = (part[owner] for part in (nu, nu_off, nudot, nudot_off))
        friction = viscous_friction(robot)
        return cls(nu, nu_off, nudot, nudot_off, found, friction, dry, metric, size, beyond)

    @cached_property
    def few(self) -> Cover:
        """Some of the boxes: for a first look, no bound."""
        some = slice(None, None, max(len(self.nu) // FEW, 1))
        return self.at(some, self.postures.at(some))

    def sampled(self, bodies: Bodies, seed: int = 0) -> Cover:
        """A random corner or place of each box alone, in the middle of its stretch: how loose bounds are, no bound."""
        rng, here = np.random.default_rng(seed), self.postures
        place = rng.uniform(-1, 1, here.q.shape)
        place[::2] = np.sign(place[::2])
        still = postures(bodies, here.q + place * here.half, np.zeros_like(here.q))
        found = self.at(slice(None), still)
        return replace(found, nu_off=0 * self.nu_off, nudot_off=0 * self.nudot_off)

    def at(self, places: slice, postures: Postures) -> Cover:
        """Stretches at some places, with other terms."""
        nu, nu_off, nudot, nudot_off = (one[places] for one in (self.nu, self.nu_off, self.nudot, self.nudot_off))
        return replace(self, nu=nu, nu_off=nu_off, nudot=nudot, nudot_off=nudot_off, postures=postures)

    @property
    def mass_off(self) -> Array:
        """(N,) `(1 - mass_off) M0 <= M <= (1 + mass_off) M0`."""
        return self.postures.mass_off

    @property
    def low(self) -> Array:
        """(N,) M is at least so much of M0."""
        return 1 - self.mass_off

    @property
    def high(self) -> Array:
        """(N,) M is at most so much of M0."""
        return 1 + self.mass_off

    @cached_property
    def L(self) -> Array:
        """(N, p, p) `M0 = L L'`."""
        return np.asarray(np.linalg.cholesky(self.postures.M))

    @cached_property
    def L_inv(self) -> Array:
        """(N, p, p)."""
        return np.asarray(np.linalg.inv(self.L))

    @cached_property
    def coriolis(self) -> Array:
        """(N, p, p, p) `L^-1 C0`, see `Postures.coriolis`."""
        return np.einsum("nai,nijk->najk", self.L_inv, self.postures.coriolis)

    @cached_property
    def M_inverse(self) -> Array:
        """(N, p, p): no `M^-1` is larger."""
        return np.asarray(self.L_inv.swapaxes(1, 2) @ self.L_inv / self.low[:, None, None])

    @cached_property
    def lightest(self) -> Array:
        """(p,) largest `(M^-1)_ii`: an energy E of the errors allows `|s_i| <= sqrt(2 E (M^-1)_ii)`."""
        return np.asarray(np.einsum("nii->ni", self.M_inverse).max(axis=0))

    def fastest(self, gain: Array) -> float:
        """Largest eigenvalue of `M^-1 diag(gain)` [1/s]; inf for gains (p,) without bound."""
        if not np.isfinite(gain).all():
            return np.inf
        L = self.L_inv
        return float((np.linalg.eigvalsh(L * gain @ L.swapaxes(1, 2))[:, -1] / self.low).max())

    @cached_property
    def arm_gain(self) -> float:
        """Largest `|r|_N / sqrt(s' M s)`."""
        return self.metric.driven(self.M_inverse[:, 2:, 2:])

    def old_gravity(self, error: Array, energy: float, age: float) -> Array:
        """(N,) how far gravity may be from that of an age ago [s], normalised; inf where that may be outside of a box.

        Args:
            error: (p,) of nu_ref at most.
            energy: Of the errors in velocity at most [J].
            age: In seconds.
        """
        before = age * (np.abs(self.nudot) + self.nudot_off)  # the command may be as old as the stretch before
        speed = np.abs(self.nu) + self.nu_off + before + error + np.sqrt(2 * energy * self.lightest)
        moved = age * speed[:, 2:]
        slope = self.postures.gravity_slope
        changed = np.einsum("nk,nk->n", slope, moved) + 2 * self.postures.gravity_wheels  # its wheels stand elsewhere
        return np.where((moved <= self.beyond).all(axis=1), changed, np.inf)

    @cached_property
    def weight(self) -> Array:
        """(p,) largest gravity [N, N m]."""
        rows = np.linalg.norm(self.L, axis=2) * self.postures.gravity_off[:, None]
        return np.asarray((np.abs(self.postures.gravity) + rows).max(axis=0))

    @cached_property
    def eigenvalues(self) -> tuple[float, float]:
        """Smallest and largest eigenvalue of M."""
        values = np.linalg.eigvalsh(self.postures.M)
        return float((values[:, 0] * self.low).min()), float((values[:, -1] * self.high).max())


def halves(middle: Array, half: Array, at: IntArray, beyond: float) -> tuple[Array, Array]:
    """Middles and half-widths (2 N, n) of N boxes that are each cut in two along a joint, the lower ones first.

    They overlap, so that all that is within `beyond` of a place stays in one box with it.

    Args:
        middle: (N, n) of the boxes.
        half: (N, n) half-widths, at least `beyond`.
        at: (N,) joints.
        beyond: [rad or m].
    """
    rows, half, step = np.arange(len(middle)), half.copy(), np.zeros_like(half)
    width = half[rows, at]
    half[rows, at], step[rows, at] = (width + beyond) / 2, (width - beyond) / 2
    return np.concatenate((middle - step, middle + step)), np.concatenate((half, half))
