"""Functions of a few variables within boxes, to first order and what is left: Taylor models, rigorous and vectorised.

`f(z) = value + slope z + rest(z)` with `|rest(z)| <= rest` wherever `|z_i| <= box_i`. Sums, products, sines and cosines
of such functions are such functions again, so that a formula written in them bounds its own second order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mmnn_pin.signals import Array

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

    @classmethod
    def constant(cls, value: Number, box: Array) -> Taylor:
        """The same everywhere."""
        nothing = np.zeros(len(box))
        return cls(np.broadcast_to(value, len(box)).astype(float), np.zeros_like(box), nothing, box)

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


@dataclass(frozen=True, eq=False)
class Matrices:
    """Matrices of such functions, of N instants and perhaps more."""

    value: Array  # (N, ..., a, b) at 0
    slope: Array  # (z, N, ..., a, b) there
    rest: Array  # (N, ..., a, b) what is left, at most
    box: Array  # (N, z) half-widths

    __array_ufunc__ = None

    @classmethod
    def zero(cls, box: Array, size: int = 4) -> Matrices:
        """(N, size, size) zeros."""
        N, z = box.shape
        return cls(np.zeros((N, size, size)), np.zeros((z, N, size, size)), np.zeros((N, size, size)), box)

    @classmethod
    def of(cls, f: Taylor, A: Array) -> Matrices:
        """A function times a constant matrix (a, b)."""
        times = np.multiply.outer
        return cls(times(f.value, A), times(f.slope.T, A), times(f.rest, np.abs(A)), f.box)

    @classmethod
    def stacked(cls, some: list[Matrices]) -> Matrices:
        """(N, len(some), a, b)."""
        value, slope, rest = ([getattr(one, name) for one in some] for name in ("value", "slope", "rest"))
        return cls(np.stack(value, 1), np.stack(slope, 2), np.stack(rest, 1), some[0].box)

    def spread(self) -> Matrices:
        """(N, 1, a, b) of (N, a, b)."""
        return Matrices(self.value[:, None], self.slope[:, :, None], self.rest[:, None], self.box)

    def like(self, A: Array) -> Matrices:
        """A constant matrix."""
        shape = (*self.value.shape[:-2], *A.shape)
        nothing = np.zeros(shape)
        return Matrices(np.broadcast_to(A, shape), np.zeros((len(self.slope), *shape)), nothing, self.box)

    @property
    def off(self) -> Array:
        """(N, ..., a, b) how far it is from its value at 0, at most."""
        wide = self.box.T.reshape(len(self.slope), -1, *(1,) * (self.value.ndim - 1))
        return np.asarray((np.abs(self.slope) * wide).sum(axis=0) + self.rest)

    def transposed(self) -> Matrices:
        """(N, ..., b, a)."""
        value, slope, rest = (one.swapaxes(-1, -2) for one in (self.value, self.slope, self.rest))
        return Matrices(value, slope, rest, self.box)

    def times(self, factor: float) -> Matrices:
        """All times a number."""
        return Matrices(factor * self.value, factor * self.slope, abs(factor) * self.rest, self.box)

    def __add__(self, other: Matrices | Array) -> Matrices:
        if isinstance(other, Matrices):
            return Matrices(self.value + other.value, self.slope + other.slope, self.rest + other.rest, self.box)
        return Matrices(self.value + other, self.slope, self.rest, self.box)

    __radd__ = __add__

    def __sub__(self, other: Matrices | Array) -> Matrices:
        return self + (other.times(-1.0) if isinstance(other, Matrices) else -other)

    def __matmul__(self, other: Matrices) -> Matrices:
        a, b = self.value, other.value
        rest = np.abs(a) @ other.rest + self.rest @ np.abs(b) + self.off @ other.off
        return Matrices(a @ b, a @ other.slope + self.slope @ b, rest, self.box)

    def __mul__(self, f: Taylor) -> Matrices:
        one, N = (1,) * (self.value.ndim - 1), len(f.value)
        value, rest, off = (np.reshape(x, (N, *one)) for x in (f.value, f.rest, f.off))
        slope = value * self.slope + self.value * f.slope.T.reshape(-1, N, *one)
        left = np.abs(value) * self.rest + np.abs(self.value) * rest + self.off * off
        return Matrices(value * self.value, slope, left, self.box)
