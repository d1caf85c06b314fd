"""What errors of torques and states within their bounds can add up to along a linearised loop, period by period.

By the end of a block of periods: the sum over all periods before of absolute values, which the right signs reach.
Within a block: what its own periods add so, and what the block began with, bounded by the state's errors or, where that
is less, with s in the place of the velocities' errors.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from mmnn_pin.signals import Array

from .steps import Steps


class Sums:
    """The sums of a loop of m states (late torques among them), p velocities, r rows that are bounded, K blocks.

    Args:
        steps: The loop.
    """

    def __init__(self, steps: Steps) -> None:
        self.steps, self.p = steps, len(steps.S[0])
        self.m, self.K = steps.size + steps.late * self.p, len(steps.at) - 1
        self.r = self.m + 2 * self.p

    def rows(self, j: int) -> Array:
        """(m + 2 p, m) what is bounded at the beginning of a period: the state, s and f of `steps.Box`."""
        return np.concatenate((np.eye(self.m), self.steps.sees(j)))

    @cached_property
    def kernels(self) -> tuple[Array, Array]:
        """What errors of torques and states in a block add at most by the end of a block, per unit.

        (K, r, K, p) and (K, r, K, m): by the end of the first index's block, in the third's.
        """
        steps, K, m = self.steps, self.K, self.m
        of_torque, of_rest = np.zeros((K, self.r, K, self.p)), np.zeros((K, self.r, K, m))
        Z = np.zeros((K, self.r, m))
        for b in range(K - 1, -1, -1):
            Z[b] = self.rows(steps.at[b + 1])
            flat = Z[b:].reshape(-1, m)
            for j in range(steps.at[b + 1] - 1, steps.at[b] - 1, -1):
                of_torque[b:, :, b] += np.abs(flat @ steps.B(j)).reshape(K - b, self.r, self.p)
                of_rest[b:, :, b] += np.abs(flat).reshape(K - b, self.r, m)
                flat = flat @ steps.P(j)
            Z[b:] = flat.reshape(K - b, self.r, m)
        return of_torque, of_rest

    @cached_property
    def inside(self) -> list[tuple[Array, Array, Array, Array]]:
        """The same within every block, for the L + 1 states of its L periods and of its end.

        (L + 1, r, p), (L + 1, r, m) of its own periods; (L + 1, r, m) twice of what it begins with: for
        bounds of the state, and for those of it with s in the place of the velocities' errors.
        """
        return [self._within(int(a), int(b)) for a, b in zip(self.steps.at, self.steps.at[1:], strict=False)]

    def _within(self, start: int, end: int) -> tuple[Array, Array, Array, Array]:
        L, m, p, joints = end - start, self.m, self.p, self.steps.size - self.p
        of_torque, of_rest, begun = np.zeros((L + 1, self.r, p)), *np.zeros((2, L + 1, self.r, m))
        swapped = np.eye(m)
        swapped[joints : joints + p] = self.steps.sees(start)[:p]
        back = np.linalg.inv(swapped)
        Z, ZB, first = np.zeros((L, m, m)), np.zeros((L, p, m)), np.eye(m)  # transposed, by the period they are of
        begun[0] = self.rows(start)
        for i in range(L):
            P, rows = self.steps.P(start + i), self.rows(start + i + 1)
            Z[:i] = (Z[:i].reshape(-1, m) @ P.T).reshape(i, m, m)
            ZB[:i] = (ZB[:i].reshape(-1, m) @ P.T).reshape(i, p, m)
            Z[i], ZB[i], first = np.eye(m), self.steps.B(start + i).T, P @ first
            of_rest[i + 1] = np.abs(Z[: i + 1].reshape(-1, m) @ rows.T).reshape(i + 1, m, -1).sum(axis=0).T
            of_torque[i + 1] = np.abs(ZB[: i + 1].reshape(-1, m) @ rows.T).reshape(i + 1, p, -1).sum(axis=0).T
            begun[i + 1] = rows @ first
        return of_torque, of_rest, np.abs(begun), np.abs(begun @ back)

    def ends(self, errors: Array, rest: Array) -> Array:
        """(K, r) what errors of torques (K, p) and states (K, m) add at most by the end of every block."""
        of_torque, of_rest = self.kernels
        return np.asarray(np.einsum("imbp,bp->im", of_torque, errors) + np.einsum("imbn,bn->im", of_rest, rest))

    def largest(self, first: int, response: Array, errors: Array, rest: Array) -> Array:
        """(K, r) the largest of every block from `first` on, begin and end included; 0 before.

        Args:
            first: The block.
            response: (N + 1, r) what is without errors.
            errors: (K, p) of torques; 0 before `first`.
            rest: (K, m) of states; likewise.
        """
        found, ends, at, p = np.zeros((self.K, self.r)), self.ends(errors, rest), self.steps.at, self.p
        joints = self.steps.size - p
        for b in range(first, self.K):
            of_torque, of_rest, begun, other = self.inside[b]
            before = ends[b - 1] if b > first else np.zeros(self.r)
            state, swapped = before[: self.m], before[: self.m].copy()
            swapped[joints : joints + p] = before[self.m : self.m + p]
            start = np.minimum(begun @ state, other @ swapped)
            added = start + of_torque @ errors[b] + of_rest @ rest[b]
            found[b] = (np.abs(response[at[b] : at[b + 1] + 1]) + added).max(axis=0)
        return found
