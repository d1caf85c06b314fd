"""Functions of a few variables within boxes, to first order and what is left: Taylor models, rigorous and vectorised.

`f(z) = value + slope z + rest(z)` with `|rest(z)| <= rest` wherever `|z_i| <= box_i`. Sums, products, sines and cosines
of such functions are such functions again, so that a formula written in them bounds its own second order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...signals import Array

Number = float | Array


@dataclass(frozen=True, eq=False)
class Taylor:
    """N functions of z variables.

    Attributes:
        value: (N,) at 0.
        slope: (N, z) there.
        rest: (N,) what is left, at most.
        box: (N, z) half-widths, the same for all that are computed with one another.
    """

    value: Array
    slope: Array
    rest: Array
    box: Array

    __array_ufunc__ = None  # an array times a function is a function

    @classmethod
    def variable(cls, i: int, box: Array, value: Number = 0.0) -> Taylor:
        """The i-th variable, and what it is counted from."""
        slope = np.zeros_like(box)
        slope[:, i] = 1.0
        return cls(np.broadcast_to(value, len(box)).astype(float), slope, np.zeros(len(box)), box)

    @property
    def off(self) -> Array:
        """(N,) how far it is from its value at 0, at most."""
        return np.asarray((np.abs(self.slope) * self.box).sum(axis=1) + self.rest)

    def __add__(self, other: Taylor | Number) -> Taylor:
        if isinstance(other, Taylor):
            return Taylor(self.value + other.value, self.slope + other.slope, self.rest + other.rest, self.box)
        return Taylor(self.value + other, self.slope, self.rest, self.box)

    def __mul__(self, other: Taylor | Number) -> Taylor:
        if isinstance(other, Taylor):
            a, b = self.value, other.value
            rest = np.abs(a) * other.rest + np.abs(b) * self.rest + self.off * other.off
            return Taylor(a * b, a[:, None] * other.slope + b[:, None] * self.slope, rest, self.box)
        factor = np.broadcast_to(other, len(self.value))
        return Taylor(factor * self.value, factor[:, None] * self.slope, np.abs(factor) * self.rest, self.box)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> Taylor:
        return self * -1.0

    def __sub__(self, other: Taylor | Number) -> Taylor:
        return self + -other

    def __rsub__(self, other: Number) -> Taylor:
        return -self + other

    def turned(self) -> tuple[Taylor, Taylor]:
        """Its cosine and sine."""
        c, s, bent = np.cos(self.value), np.sin(self.value), self.off**2 / 2
        return (
            Taylor(c, -s[:, None] * self.slope, np.abs(s) * self.rest + bent, self.box),
            Taylor(s, c[:, None] * self.slope, np.abs(c) * self.rest + bent, self.box),
        )


def stacked(some: list[Taylor]) -> tuple[Array, Array, Array]:
    """Values (N, k), slopes (N, k, z) and rests (N, k) of k functions."""
    return tuple(np.stack([getattr(f, name) for f in some], axis=1) for name in ("value", "slope", "rest"))  # type: ignore[return-value]
