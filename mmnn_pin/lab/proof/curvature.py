"""How strongly M, C and gravity bend, entry by entry, over boxes of joint positions: bounds of their derivatives.

Section 11 of docs/explanation/theory.md measures all in the metric of M. The tube asks for more: what the second order
does to each velocity by itself. Derivatives by joints are known in the middle of a box to the third order of the
bodies' motions; anywhere in it a derivative is at most that in the middle plus widths times those of one order more,
and the last are bounded by the outermost joint (`postures`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ...signals import Array
from .postures import CHUNK, SLACK, Jets
from .screws import Bodies


@dataclass(frozen=True, eq=False)
class Curvature:
    """Largest magnitudes anywhere in K boxes, by the r joints of the model that the arm moves.

    Attributes:
        M1, M2: (K, r, p, p), (K, r, r, p, p) of the first and second derivatives of M.
        C0, C1, C2: (K, p, p, p), (K, r, p, p, p), (K, p, p, p) of C_ijk, with `C(q, nu)_ik = sum_j C_ijk nu_j`, of its
            first derivatives, and of any of its second ones.
        g1, g2: (K, r, p), (K, r, r, p) of gravity's.
        columns: (K, r, n) how far the arm's joints move them.
    """

    M1: Array
    M2: Array
    C0: Array
    C1: Array
    C2: Array
    g1: Array
    g2: Array
    columns: Array

    @classmethod
    def of(cls, bodies: Bodies, q: Array, half: Array) -> Curvature:
        """In boxes with middles (K, n) and half-widths (K, n) [rad or m]."""
        places = [slice(k, k + CHUNK) for k in range(0, len(q), CHUNK)]
        parts = [Bends(bodies, q[at], half[at]).curvature() for at in places]
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))

    def along(self, moved: Array) -> Bent:
        """What joints of the arm that move by at most (K, n) change."""
        d = np.einsum("kra,ka->kr", self.columns, moved)
        far = (d.sum(axis=1) ** 2 / 2)[:, None, None, None]
        return Bent(
            M1=np.einsum("kr,krij->kij", d, self.M1),
            M2=np.einsum("kr,ks,krsij->kij", d, d, self.M2) / 2,
            C0=self.C0,
            C1=np.einsum("kr,krijl->kijl", d, self.C1),
            C2=far * self.C2,
            g1=np.einsum("kr,kri->ki", d, self.g1),
            g2=np.einsum("kr,ks,krsi->ki", d, d, self.g2) / 2,
        )


@dataclass(frozen=True, eq=False)
class Bent:
    """Largest changes of M (K, p, p), C (K, p, p, p) and gravity (K, p): all, and what is beyond the first order.

    Attributes:
        M1, C1, g1: All of the change.
        M2, C2, g2: Beyond the first order.
        C0: (K, p, p, p) C itself.
    """

    M1: Array
    M2: Array
    C0: Array
    C1: Array
    C2: Array
    g1: Array
    g2: Array


class Bends(Jets):
    """The bounds, from the derivatives in the middles."""

    def curvature(self) -> Curvature:
        """All of them."""
        every = np.array(self.moving, int)
        width, columns = self.width[:, every], np.abs(self.bodies.columns[every])
        M, g = self.largest(*self.of_mass()), self.largest(*self.of_gravity())
        C0, C1, C2 = self.of_coriolis()
        C1 = C1 + np.einsum("kr,kijl->kijl", width, C2)[:, None]
        C0 = C0 + np.einsum("kr,krijl->kijl", width, C1)
        found = self.first_order(M), self.second_order(M), C0, C1, C2, self.first_order(g), self.second_order(g)
        return Curvature(*((1 + SLACK) * one for one in found), np.broadcast_to(columns, (len(width), *columns.shape)))

    def first_order(self, most: dict[tuple[int, ...], Array]) -> Array:
        """(K, r, ...) of the first derivatives in a table of all."""
        found = [most[(k,)] for k in self.moving]
        return np.stack(found, axis=1) if found else np.zeros((len(self.q), 0, *most[()].shape[1:]))

    def second_order(self, most: dict[tuple[int, ...], Array]) -> Array:
        """(K, r, r, ...) of the second ones."""
        rows = [[most[tuple(sorted((k, m)))] for m in self.moving] for k in self.moving]
        if not rows:
            return np.zeros((len(self.q), 0, 0, *most[()].shape[1:]))
        return np.stack([np.stack(row, axis=1) for row in rows], axis=1)

    @property
    def grown(self) -> Array:
        """(K, p) largest length of the motion along a velocity, anywhere."""
        return np.asarray(self.sizes + np.einsum("kid,kd->ki", self.once, self.width))

    def of_mass(self) -> tuple[dict[tuple[int, ...], Array], Array]:
        """Derivatives of M in the middle, without sign, and bounds (K, p, p, J) of all of up to the fourth order."""
        centre = {(): np.abs(self.M)}
        for some in self.orders[1:]:
            centre |= {K: np.abs(self.of_M(K, self.first)) for K in some}
        other = self.grown + 7 * self.once.max(axis=2)  # the other motion: as it is, or by the other three joints
        crude = self.once[:, :, None] * other[:, None, :, None]
        return centre, crude + crude.swapaxes(1, 2)

    def of_gravity(self) -> tuple[dict[tuple[int, ...], Array], Array]:
        """The same of gravity, (K, p) and (K, p, J)."""
        pull = self.signs * self.pull
        return {K: np.abs(pull @ value) for K, value in self.first.items()}, self.pulls

    def of_coriolis(self) -> tuple[Array, Array, Array]:
        """C_ijk and its first derivatives in the middle, without sign, and a bound of all second ones."""
        first, W = self.first, self.W
        by = [self.inner(first[(k,)], W[()]) + self.inner(first[()], W[(k,)]) for k in self.moving]
        once, again = self.once.max(axis=2), self.again.max(axis=3)
        twice = np.linalg.norm(W[()], axis=1) + np.einsum("kijd,kd->kij", self.again, self.width)
        most = once[:, :, None, None] * (twice + 2 * again)[:, None] + self.grown[:, :, None, None] * again[:, None]
        odd = np.sqrt(self.uneven_mass.diagonal())[:, None, None] * self.uneven_twice
        C = np.abs(self.C) + odd
        return C, np.abs(np.stack(by, axis=1)) if by else np.zeros((len(C), 0, *C.shape[1:])), most
