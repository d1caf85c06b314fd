"""M, C and gravity of a robot over boxes of joint positions: their values in the middle, and how far off they may be.

A body's motion is that of its homogeneous transform H, and with its pseudo-inertia P (4 x 4) every term of the reduced
dynamics is an inner product `<A, B> = tr(A P B')` of derivatives of H, summed over bodies:

    M_ij = <H_i, H_j>        C_ijk nu_j = <H_i, H_jk> nu_j        gravity_i = -<H_i, g e4'>

H_i is the motion along the i-th velocity and H_jk how H_k changes along the j-th. Both are products of screws from the
base outwards, `S_i S_j H`, and so are all their derivatives by joint positions. Two facts make bounds of these:

* derivatives to the third order are known in the middle, exactly;
* a derivative by any joints is no longer than that by the outermost of them alone, as screws further in only turn it:
  `|S_a ... S_d H| <= |S_d H|`, the root of the inertia around joint d of all that it carries. Nothing else is needed
  to close Taylor's formula.

All is measured in coordinates in which M of the middle is the identity, `s = L^-T x` with `M = L L'`: a joint of grams
counts as much as the base. So with the middle M0, at every place of the box,

    (1 - mass) M0 <= M <= (1 + mass) M0        |L^-1 (C - C0)_jk| <= coriolis_jk        |L^-1 (g - g0)| <= gravity

Nothing is sampled. Wheels may stand at any angle: each counts as alike all around its axis, and what it is not is added
to the bounds. Rounding: `UNIT` times the sizes of the factors of every inner product is added, some thousand times what
the sums can lose, and `SLACK` for what is computed afterwards from matrices near the identity.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from itertools import combinations_with_replacement as multisets
from itertools import product
from math import factorial, prod

import numpy as np
from numpy.typing import NDArray

from mmnn_pin.signals import Array, IntArray

from .screws import Bodies

ORDER = 3  # of the derivatives that are known in the middle
UNIT, SLACK = 1e-12, 1e-9  # of rounding
CHUNK = 32  # boxes at a time
CORNERS = 9  # joints up to which all corners of a box are looked at


@dataclass(frozen=True, eq=False)
class Postures:
    """Terms in the middle of N boxes, and how far off they may be anywhere in each."""

    q: Array  # (N, n) middles of the boxes [rad or m]
    half: Array  # (N, n) their half-widths
    M: Array  # (N, p, p) mass matrices
    coriolis: Array  # (N, p, p, p): `C(q, nu)_ik = sum_j coriolis_ijk nu_j`
    gravity: Array  # (N, p)
    mass_off: Array  # (N,) `|L^-1 (M - M0) L^-T|` at most
    coriolis_off: Array  # (N, p, p) `|L^-1 (C - C0)_jk|` at most
    gyration_off: Array  # (N, p) of the symmetric part of `L^-1 (C - C0)_k L^-T` over i and j at most
    gravity_off: Array  # (N,) `|L^-1 (g - g0)|` at most
    gravity_slope: Array  # (N, n) `|L^-1 dg/dq|` by each joint of the arm at most
    gravity_wheels: Array  # (N,) what of `gravity_off` the angles of wheels make that are heavier on one side
    bend: Array  # (N, n) what of `mass_off` the positions of each joint of the arm make to first order

    def at(self, places: IntArray | NDArray[np.bool_] | slice) -> Postures:
        """Some of the boxes."""
        return Postures(*(getattr(self, one.name)[places] for one in fields(self)))

    def joined(self, other: Postures) -> Postures:
        """These boxes and then others."""
        return Postures(*(np.concatenate((getattr(self, f.name), getattr(other, f.name))) for f in fields(self)))


def postures(bodies: Bodies, q: Array, half: Array) -> Postures:
    """The terms over boxes with middles (N, n) and half-widths (N, n)."""
    parts = [Jets(bodies, q[k : k + CHUNK], half[k : k + CHUNK]).postures() for k in range(0, len(q), CHUNK)]
    return Postures(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Postures)))


class Jets:
    """Derivatives of all transforms in the middles of N boxes, and the bounds that follow.

    Derivatives by joints K = (a, b, ...), from the base outwards, of `H R`, flat in e entries: `w[K]` (N, B, 4, 4) of
    the transforms; `first[K]` (N, e, p) of the motions along the velocities and `Z[K]` along the normalised ones;
    `W[K]` (N, e, p, p) of how they change, along velocities in their own units.

    Args:
        bodies: The robot.
        q: (N, n) middles [rad or m].
        half: (N, n) half-widths.
    """

    def __init__(self, bodies: Bodies, q: Array, half: Array) -> None:
        self.bodies, self.q, self.half = bodies, q, half
        self.width = half @ np.abs(bodies.columns).T  # (N, J)
        self.moving = [int(k) for k in np.flatnonzero(bodies.columns.any(axis=1))]
        H, self.screws = bodies.placed(bodies.offset + q @ bodies.columns.T)
        self.roots = H @ bodies.roots
        self.signs = np.broadcast_to(bodies.signs[:, None], (len(bodies.signs), 3, 4)).ravel()
        self.riding = np.flatnonzero(bodies.base.any(axis=(1, 2))).tolist()  # velocities that move the base
        self.w: dict[tuple[int, ...], Array] = {}
        self.orders = [list(multisets(self.moving, order)) for order in range(ORDER + 1)]
        self.first = first = {K: self._along(K) for some in self.orders for K in some}
        self.W = {K: self._twice(K) for some in self.orders[:2] for K in some}
        self.pull = (bodies.g[:, None] * bodies.roots[:, 3:]).ravel()  # g e4' R, (e,)
        start = first[()]
        self.M = self.inner(start, start) + bodies.rotors
        self.C = self.inner(start, self.W[()])
        self.gravity = -np.einsum("nei,e,e->ni", start, self.signs, self.pull)
        self.L_inv = np.linalg.inv(np.linalg.cholesky(self.M))
        self.Z = {K: value @ self.L_inv.swapaxes(1, 2) for K, value in first.items()}
        self.sizes = np.linalg.norm(start, axis=1)  # (N, p)

    # -- derivatives in the middle --

    def screwed(self, K: tuple[int, ...]) -> Array:
        """`w[K]`."""
        if K not in self.w:
            chain = self.screws[:, K[0]] if K else np.broadcast_to(np.eye(4), (len(self.q), 4, 4))
            for joint in K[1:]:
                chain = chain @ self.screws[:, joint]
            carried = np.all(self.bodies.above[:, list(K)], axis=1).reshape(1, -1, 1, 1)
            self.w[K] = np.where(carried, chain[:, None] @ self.roots, 0.0)
        return self.w[K]

    def _along(self, K: tuple[int, ...]) -> Array:
        """(N, e, p) before it is normalised."""
        T, base, here = self.bodies.T, self.bodies.base, self.screwed(K)
        found = np.zeros((len(base), *here[:, :, :3].shape))
        for j in self.riding:
            found[j] = base[j, :3] @ here
        for t, j in np.argwhere(T):
            found[j] += T[t, j] * self.screwed(tuple(sorted((*K, int(t)))))[:, :, :3]
        return np.ascontiguousarray(found.reshape(len(base), len(here), -1).transpose(1, 2, 0))

    def _twice(self, K: tuple[int, ...]) -> Array:
        """`W[K]`."""
        T, base, here = self.bodies.T, self.bodies.base, self.screwed(K)
        found = np.zeros((len(base), len(base), *here[:, :, :3].shape))
        for j in self.riding:
            for k in self.riding:
                found[j, k] = base[j, :3] @ base[k] @ here
        for t, k in np.argwhere(T):
            one = self.screwed(tuple(sorted((*K, int(t)))))
            for j in self.riding:
                turned = T[t, k] * (base[j, :3] @ one)
                found[j, k] += turned
                found[k, j] += turned
            for u, j in np.argwhere(T):
                found[j, k] += T[t, k] * T[u, j] * self.screwed(tuple(sorted((*K, int(t), int(u)))))[:, :, :3]
        return np.ascontiguousarray(found.reshape(len(base), len(base), len(here), -1).transpose(2, 3, 0, 1))

    def inner(self, A: Array, B: Array) -> Array:
        """`<A_i, B_j>` of (N, e, i), (N, e, ...)."""
        found = (A * self.signs[:, None]).swapaxes(1, 2) @ B.reshape(*B.shape[:2], -1)
        return np.asarray(found.reshape(len(A), A.shape[2], *B.shape[2:]))

    def of_M(self, K: tuple[int, ...], along: dict[tuple[int, ...], Array] | None = None) -> Array:
        """Derivative of the mass matrix, (N, p, p), normalised unless other motions `along` are given."""
        Z, found = along or self.Z, np.zeros_like(self.M)
        for bits in product((False, True), repeat=len(K) - 1):
            left = (K[0], *(k for k, bit in zip(K[1:], bits, strict=True) if bit))
            right = tuple(k for k, bit in zip(K[1:], bits, strict=True) if not bit)
            found += self.inner(Z[left], Z[right])
        return found + found.swapaxes(1, 2)

    # -- bounds over the boxes --

    def postures(self) -> Postures:
        """The terms and how far off they may be."""
        mass, coriolis, gyration, gravity, slope, wheels = (
            (1 + SLACK) * off for off in (self.mass_off(), *self.coriolis_off(), *self.gravity_off())
        )
        terms = self.q, self.half, self.M, self.C, self.gravity
        return Postures(*terms, mass, coriolis, gyration, gravity, slope, wheels, self.bend())

    def weight(self, K: tuple[int, ...]) -> Array:
        """What a derivative counts with in Taylor's formula at the corners of the boxes, (N,)."""
        return np.asarray(self.width[:, K].prod(axis=1) / prod(factorial(K.count(k)) for k in set(K)))

    @cached_property
    def reach(self) -> Array:
        """(N, J) largest `|S_d H|`: the root of the inertia around joint d of what it carries."""
        found = np.zeros_like(self.width)
        for d in reversed(range(found.shape[1])):
            found[:, d] = length(self.screwed((d,))[:, :, :3])
            for k in self.moving:
                if k > d and (self.bodies.above[:, d] & self.bodies.above[:, k]).any():
                    found[:, d] += self.width[:, k] * found[:, k]
        return found

    @property
    def further(self) -> IntArray:
        """(J, J) the further out of two joints."""
        every = np.arange(self.width.shape[1])
        return np.maximum.outer(every, every)

    @cached_property
    def once(self) -> Array:
        """(N, p, J) largest derivative of the motion along a velocity by joints of which d is the outermost."""
        outer = self.reach[:, self.further]
        return np.asarray(np.einsum("ti,ntd->nid", self.arm, outer) + self.turning[:, None] * self.reach[:, None])

    @cached_property
    def again(self) -> Array:
        """(N, p, p, J) the same of how that motion changes along another velocity."""
        arm, turning = self.arm, self.turning
        outer = self.reach[:, np.maximum.outer(self.further, np.arange(len(arm)))]
        found = np.einsum("tj,uk,ntud->njkd", arm, arm, outer)
        found += np.einsum("j,nkd->njkd", turning, self.once)
        return found + np.einsum("njd,k->njkd", self.once - turning[:, None] * self.reach[:, None], turning)

    @cached_property
    def pulls(self) -> Array:
        """(N, p, J) largest derivative of gravity by joints of which d is the outermost."""
        carried = np.array([np.linalg.norm(self.pull.reshape(len(own), -1)[own]) for own in self.bodies.above.T])
        heavy = self.reach * carried
        turned = self.turning[:, None] * heavy[:, None]
        return np.asarray(np.einsum("ti,ntd->nid", self.arm, heavy[:, self.further]) + turned)

    @cached_property
    def arm(self) -> Array:
        """(J, p) how fast the joints of the arm move, without sign."""
        found = np.abs(self.bodies.T)
        found[[k for k in range(len(found)) if k not in self.moving]] = 0.0
        return found

    @property
    def turning(self) -> Array:
        """(p,) how fast the base turns."""
        return self.bodies.turning

    def outermost(self, order: int) -> Array:
        """(N, J) sum of the weights of all derivatives of an order whose outermost joint is d."""
        upto = np.zeros((len(self.q), self.width.shape[1] + 1))
        moving = np.isin(np.arange(self.width.shape[1]), self.moving)
        upto[:, 1:] = np.cumsum(self.width * moving, axis=1) ** order
        return np.asarray(np.diff(upto, axis=1) / factorial(order))

    def sums(self, centre: dict[tuple[int, ...], Array], crude: Array, last: int) -> list[Array]:
        """Sums by order, up to `last`, of weights times largest norms: known in the middle; by the outermost joint.

        Args:
            centre: Norms (N, ...) of the derivatives that are known.
            crude: (N, ..., J) bounds of all of at least the first order, by the outermost joint.
            last: Order to go to, one above what is known.
        """
        most = self.largest(centre, crude)
        result = [np.zeros_like(most[()]) for _ in range(last)]
        for K, value in most.items():
            result[len(K)] += expand(self.weight(K), value) * value
        rest = self.outermost(last)
        return [*result, (crude * rest.reshape(len(rest), *(1,) * (crude.ndim - 2), -1)).sum(axis=-1)]

    def largest(self, centre: dict[tuple[int, ...], Array], crude: Array) -> dict[tuple[int, ...], Array]:
        """Largest norms in the boxes of the derivatives that are known in the middle; arguments as of `sums`."""
        most: dict[tuple[int, ...], Array] = {}
        for K in sorted(centre, key=len, reverse=True):
            grown = centre[K].copy()
            for k in self.moving:
                more = tuple(sorted((*K, k)))
                grown += expand(self.width[:, k], grown) * most.get(more, crude[..., more[-1]])
            most[K] = np.minimum(grown, crude[..., K[-1]]) if K else grown
        return most

    @cached_property
    def motions(self) -> list[Array]:
        """Sums by order of `Z`, up to ORDER + 1, (N,) each."""
        centre = {K: norm(value) for K, value in self.Z.items()}
        crude = np.linalg.norm(np.abs(self.L_inv) @ self.once, axis=1)
        return self.sums(centre, crude, ORDER + 1)

    def corners(self, parts: list[Array]) -> Array:
        """Largest norm of `sum d_k parts_k` over all corners `|d_k| = width_k`; of matrices or vectors (N, ...)."""
        if not parts:
            return np.zeros(len(self.q))
        parts = [expand(self.width[:, k], part) * part for k, part in zip(self.moving, parts, strict=True)]
        if len(parts) > CORNERS:
            return np.asarray(sum(norm(part) for part in parts))
        signs = product((1.0, -1.0), repeat=len(parts) - 1)
        sums = (sum((s * part for s, part in zip(sign, parts[1:], strict=True)), parts[0]) for sign in signs)
        return np.max([norm(one) for one in sums], axis=0)

    def mass_off(self) -> Array:
        """See `Postures`."""
        found = self.corners([self.of_M(K) for K in self.orders[1]])
        for some in self.orders[2:]:
            for K in some:
                found += self.weight(K) * norm(self.of_M(K))
        found += sum(a * b for a, b in zip(self.motions, reversed(self.motions), strict=True))
        return found + self.uneven**2 + UNIT * self.loose**2 + SLACK

    def bend(self) -> Array:
        """See `Postures`."""
        found = np.zeros_like(self.half)
        for (k,) in self.orders[1]:
            found += norm(self.of_M((k,)))[:, None] * self.half * np.abs(self.bodies.columns[k])
        return found

    def gravity_off(self) -> tuple[Array, Array, Array]:
        """`gravity_off`, `gravity_slope` and `gravity_wheels` of `Postures`."""
        pull = self.signs * self.pull
        centre = {K: norm(pull @ self.Z[K]) for some in self.orders[1:] for K in some}
        found = self.corners([pull @ self.Z[K] for K in self.orders[1]])
        for K, value in centre.items():
            found += self.weight(K) * value * (len(K) > 1)
        crude, slope = np.linalg.norm(np.abs(self.L_inv) @ self.pulls, axis=1), np.zeros_like(self.half)
        found += (crude * self.outermost(ORDER + 1)).sum(axis=1)
        for K, value in self.largest(centre, crude).items():
            if len(K) == 1:
                slope += value[:, None] * np.abs(self.bodies.columns[K[0]])
        tilt = sum(u * np.linalg.norm(self.bodies.placements[k][3]) for k, u in self.bodies.uneven)
        strength = np.linalg.norm(self.bodies.g)
        rough = UNIT * self.loose * np.linalg.norm(self.pull)
        wheels = self.uneven * strength * tilt
        return found + wheels + rough, slope + rough[:, None], wheels

    def coriolis_off(self) -> tuple[Array, Array]:
        """`coriolis_off` and `gyration_off` of `Postures`."""
        Z, W, by = self.Z[()], self.W[()], self.L_inv.swapaxes(1, 2)
        found, turned = np.zeros(W.shape[:1] + W.shape[2:]), np.zeros(W.shape[:1] + W.shape[3:])
        for K in self.orders[1]:
            change = self.inner(self.Z[K], W) + self.inner(Z, self.W[K])
            found += expand(self.weight(K), found) * np.linalg.norm(change, axis=1)
            change = change.transpose(0, 3, 1, 2) @ by[:, None]
            turned += expand(self.weight(K), turned) * norm((change + change.swapaxes(2, 3)) / 2)
        first, own = self.motions, {K: np.linalg.norm(value, axis=1) for K, value in self.W.items()}
        some = self.sums(own, self.again, 2)
        found += sum(expand(a, b) * b for a, b in zip(first[:3], reversed(some), strict=True))
        own = {K: norm(value.transpose(0, 3, 1, 2) @ by[:, None]) for K, value in self.W.items()}
        crude = np.linalg.norm(np.einsum("nij,njkd->nikd", np.abs(self.L_inv), self.again), axis=1)
        some = self.sums(own, crude, 2)
        turned += sum(expand(a, b) * b for a, b in zip(first[:3], reversed(some), strict=True))
        rough, odd = self.uneven_twice, expand(self.uneven, found)
        size = np.linalg.norm(W, axis=1)
        found += odd * rough + UNIT * expand(self.loose, found) * size
        mixed = np.linalg.norm(np.abs(self.L_inv) @ rough, axis=1)
        sized = np.linalg.norm(np.abs(self.L_inv) @ size, axis=1)
        return found, turned + expand(self.uneven, turned) * mixed + UNIT * expand(self.loose, turned) * sized

    @cached_property
    def loose(self) -> Array:
        """(N,) `| |L^-1| |H_i| |`: what rounding counts with."""
        return np.asarray(np.linalg.norm(np.einsum("nij,nj->ni", np.abs(self.L_inv), self.sizes), axis=1))

    @cached_property
    def uneven(self) -> Array:
        """(N,) root of what wheels that are not alike all around take from or give to M, normalised."""
        found = self.L_inv @ self.uneven_mass @ self.L_inv.swapaxes(1, 2)
        return np.asarray(np.sqrt(np.abs(np.linalg.eigvalsh(found)[:, -1])))

    @cached_property
    def uneven_mass(self) -> Array:
        """(p, p) the same of M in its own units."""
        found, base = np.zeros((len(self.bodies.base),) * 2), self.bodies.base
        for k, u in self.bodies.uneven:
            A = u * (base + np.multiply.outer(self.bodies.T[k], self.screws[0, k])) @ self.bodies.placements[k]
            found += np.einsum("irc,jrc->ij", A, A)
        return found

    @cached_property
    def uneven_twice(self) -> Array:
        """(p, p) the same of how motions along velocities change along others, in their own units."""
        base, found = self.bodies.base, np.zeros((len(self.bodies.base),) * 2)
        for k, u in self.bodies.uneven:
            S, T = self.screws[0, k], self.bodies.T[k]
            spun = np.multiply.outer(T, S)
            twice = np.einsum("jrs,ksc->jkrc", base, base + spun) + np.einsum("krs,jsc->jkrc", base + spun, spun)
            found += u**2 * np.einsum("jkrc,jkrc->jk", *(2 * [twice @ self.bodies.placements[k]]))
        return np.sqrt(found)


def expand(weights: Array, like: Array) -> Array:
    """Weights (N,) that multiply an array (N, ...)."""
    return weights.reshape(-1, *(1,) * (like.ndim - 1))


def length(values: Array) -> Array:
    """Of everything but the first axis, (N,)."""
    return np.asarray(np.sqrt((values.reshape(len(values), -1) ** 2).sum(axis=1)))


def norm(values: Array) -> Array:
    """Largest singular value of matrices (..., a, b); length of vectors (N, a)."""
    if values.ndim == 2:
        return np.asarray(np.linalg.norm(values, axis=1))
    small = values.swapaxes(-1, -2) @ values
    return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(small)[..., -1], 0.0)))
