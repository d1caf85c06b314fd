"""How strongly M, C and gravity bend, entry by entry, over boxes of joint positions: bounds of their derivatives.

Section 11 of docs/explanation/theory.md measures all in the metric of M. The tube asks for more: what the second order
does to each velocity by itself. Derivatives by joints are known in the middle of a box to the third order of the
bodies' motions; anywhere in it a derivative is at most that in the middle plus widths times those of one order more,
and the last are bounded by the outermost joint (`postures`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from mmnn_pin.signals import Array

from .postures import CHUNK, SLACK, Jets
from .screws import Bodies

Table = dict[tuple[int, ...], Array]


@dataclass(frozen=True, eq=False)
class Curvature:
    """Largest magnitudes anywhere in K boxes, by the r joints of the model that the arm moves.

    Attributes:
        M1, M2: (K, r, p, p), (K, r, r, p, p) of the first and second derivatives of M.
        C0, C1, C2: (K, p, p, p), (K, r, p, p, p), (K, r, r, p, p, p) of C_ijk, with `C(q, nu)_ik = sum_j C_ijk nu_j`,
            and of its derivatives.
        g1, g2: (K, r, p), (K, r, r, p) of the derivatives of gravity.
        XM1, XC0, XC1: As M1, C0, C1, of what they are times X: accelerations rather than forces.
        X: (K, p, p) the inverse of `M + stiff` in the middle.
        columns: (K, r, n) how far the arm's joints move them.
    """

    M1: Array
    M2: Array
    C0: Array
    C1: Array
    C2: Array
    g1: Array
    g2: Array
    XM1: Array
    XC0: Array
    XC1: Array
    X: Array
    columns: Array

    @classmethod
    def of(cls, bodies: Bodies, q: Array, half: Array, stiff: Array) -> Curvature:
        """In boxes with middles (K, n) and half-widths (K, n) [rad or m]; `stiff` (p, p) is added to M for X."""
        places = [slice(k, k + CHUNK) for k in range(0, len(q), CHUNK)]
        parts = [Bends(bodies, q[at], half[at]).curvature(stiff) for at in places]
        return cls(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(cls)))

    def along(self, moved: Array, other: Array | None = None) -> Bent:
        """What joints of the arm that move by at most (K, n) change; with `other`, of the second order what both do."""
        d, half = np.einsum("kra,ka->kr", self.columns, moved), 0.5 if other is None else 1.0
        twice = half * np.einsum("kr,ks->krs", d, d if other is None else np.einsum("kra,ka->kr", self.columns, other))
        return Bent(
            M1=np.einsum("kr,krij->kij", d, self.M1),
            M2=np.einsum("krs,krsij->kij", twice, self.M2),
            C0=self.C0,
            C1=np.einsum("kr,krijl->kijl", d, self.C1),
            C2=np.einsum("krs,krsijl->kijl", twice, self.C2),
            g1=np.einsum("kr,kri->ki", d, self.g1),
            g2=np.einsum("krs,krsi->ki", twice, self.g2),
            XM1=np.einsum("kr,krij->kij", d, self.XM1),
            XC0=self.XC0,
            XC1=np.einsum("kr,krijl->kijl", d, self.XC1),
            X=np.abs(self.X),
        )


@dataclass(frozen=True, eq=False)
class Bent:
    """Largest changes of M (K, p, p), C (K, p, p, p) and gravity (K, p), and times X."""

    M1: Array  # all of the change
    M2: Array  # beyond the first order
    C0: Array  # (K, p, p, p) C itself
    C1: Array  # all of the change
    C2: Array  # beyond the first order
    g1: Array  # all of the change
    g2: Array  # beyond the first order
    XM1: Array  # all of the change
    XC0: Array  # (K, p, p, p) C itself
    XC1: Array  # all of the change
    X: Array  # (K, p, p) without sign


class Bends(Jets):
    """The bounds, from the derivatives in the middles."""

    def curvature(self, stiff: Array) -> Curvature:
        """All of them."""
        every = np.array(self.moving, int)
        width, columns = self.width[:, every], np.abs(self.bodies.columns[every])
        X = np.linalg.inv(self.M + stiff)
        size = np.abs(X)
        M, g = self.largest(*self.of_mass()), self.largest(*self.of_gravity())
        M2, (slopes, C2) = self.second_order(M), self.of_coriolis()
        slope = self.first_order({(k,): self.of_M((k,), self.first) for k in self.moving}, self.M)
        beyond, twice = np.einsum("ks,krsij->krij", width, M2), np.einsum("ks,krsijl->krijl", width, C2)
        M1, C1 = self.first_order(M, self.M), np.abs(slopes) + twice
        once = np.einsum("kr,krijl->kijl", width, C1) + self.odd
        found = (
            *(M1, M2, np.abs(self.C) + once, C1, C2, self.first_order(g, self.gravity), self.second_order(g)),
            np.abs(np.einsum("kia,kraj->krij", X, slope)) + np.einsum("kia,kraj->krij", size, beyond),
            np.abs(np.einsum("kia,kajl->kijl", X, self.C)) + np.einsum("kia,kajl->kijl", size, once),
            np.abs(np.einsum("kia,krajl->krijl", X, slopes)) + np.einsum("kia,krajl->krijl", size, twice),
        )
        columns = np.broadcast_to(columns, (len(width), *columns.shape))
        return Curvature(*(*(np.asarray((1 + SLACK) * one + SLACK) for one in found), X, columns))

    def first_order(self, table: Table, like: Array) -> Array:
        """(K, r, ...) of the first derivatives in a table of arrays like another one."""
        found = [table[(k,)] for k in self.moving]
        return np.stack(found, axis=1) if found else np.zeros((len(self.q), 0, *like.shape[1:]))

    def second_order(self, table: Table) -> Array:
        """(K, r, r, ...) of the second ones."""
        rows = [[table[tuple(sorted((k, m)))] for m in self.moving] for k in self.moving]
        if not rows:
            return np.zeros((len(self.q), 0, 0, *table[()].shape[1:]))
        return np.stack([np.stack(row, axis=1) for row in rows], axis=1)

    @property
    def grown(self) -> Array:
        """(K, p) largest length of the motion along a velocity, anywhere."""
        return np.asarray(self.sizes + np.einsum("kid,kd->ki", self.once, self.width))

    @property
    def odd(self) -> Array:
        """(p, p, p) what wheels that are heavier on one side add to C."""
        return np.sqrt(self.uneven_mass.diagonal())[:, None, None] * self.uneven_twice

    def of_mass(self) -> tuple[Table, Array]:
        """Derivatives of M in the middle, without sign, and bounds (K, p, p, J) of all of up to the fourth order."""
        centre: Table = {(): np.abs(self.M)}
        for some in self.orders[1:]:
            centre |= {K: np.abs(self.of_M(K, self.first)) for K in some}
        other = self.grown + 7 * self.once.max(axis=2)  # the other motion: as it is, or by the other three joints
        crude = self.once[:, :, None] * other[:, None, :, None]
        return centre, crude + crude.swapaxes(1, 2)

    def of_gravity(self) -> tuple[Table, Array]:
        """The same of gravity, (K, p) and (K, p, J)."""
        pull = self.signs * self.pull
        return {K: np.abs(pull @ value) for K, value in self.first.items()}, self.pulls

    def of_coriolis(self) -> tuple[Array, Array]:
        """First derivatives of C_ijk in the middle, (K, r, p, p, p), and bounds of its second ones anywhere."""
        first, W = self.first, self.W
        by: Table = {(k,): self.inner(first[(k,)], W[()]) + self.inner(first[()], W[(k,)]) for k in self.moving}
        own = np.linalg.norm(W[()], axis=1) + np.einsum("kijd,kd->kij", self.again, self.width)
        table: Table = {(): self.C}

        def meet(one: Array, other: Array) -> Array:
            return one[:, :, None, None] * other[:, None]

        for a in self.moving:
            for b in (k for k in self.moving if k >= a):  # b is the outermost of the two
                by_a, by_b = self.once[:, :, a], self.once[:, :, b]
                found = meet(by_b, own) + meet(self.grown, self.again[..., b])
                table[(a, b)] = found + meet(by_a, self.again[..., b]) + meet(by_b, self.again[..., a])
        return self.first_order(by, self.C), self.second_order(table)
