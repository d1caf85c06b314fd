"""The features of a learner with a regressor, on every motion in a tube: docs/explanation/theory.md, section 9.

With H the placement of a body, S_i H its motion along the i-th velocity and A what is asked of its acceleration, all 4
by 4, the ten columns of the body in row i of the regressor are those of

    tr(P (S_i H)' A),      A = (sum_j S_j nudot_ref_j + sum_jk S_jk nu_j nu_ref_k - g e4') H

(`model.regressor`). As Taylor models in the errors (`taylor.py`) these are a value and slopes at every sample of the
reference, and a bound of the rest. Dry friction, `tanh` of a fast rate, changes by no more than it does between the
ends of what its velocity may be. Nothing is sampled, neither in the box nor along the reference: a learner says Psi_hat
at the samples alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mmnn_pin.model.regressor import BODY, Regressor
from mmnn_pin.model.tree.motion import BASE, NUMBER, PRISMATIC
from mmnn_pin.signals import Array

from .errors_ahead import Course
from .screws import PLANAR, placement
from .taylor import Matrices, Taylor, stacked

ROWS, COLUMNS = (3, 0, 1, 2, 0, 0, 0, 1, 1, 2), (3, 3, 3, 3, 0, 1, 2, 1, 2, 2)  # of a body's numbers in P


@dataclass(frozen=True, eq=False)
class Features:
    """The regressor along a reference.

    Args:
        regressor: Of the robot.
        course: The reference and its kinematic law, at N instants.
        q_ref: (N, n).
    """

    regressor: Regressor
    course: Course
    q_ref: Array

    def smooth(self, places: slice, box: Array) -> tuple[Array, Array, Array]:
        """All but dry friction: value (N, p, k), slope (z, N, p, k), rest (N, p, k).

        Args:
            places: Some instants, N.
            box: (N, z) of the errors that the learner sees.
        """
        course, known = self.course.at(places), self.regressor.massless
        nu_ref, nudot_ref = course.command(box)
        first = course.poses + len(course.K) + known.base
        rates = [Taylor.variable(first + i, box, course.qdot_ref[:, i]) for i in range(len(course.K))]
        nu = [*course.velocity(box), *rates]
        q = [Taylor.variable(course.poses + i, box, self.q_ref[places, i]) for i in range(len(course.K))]
        bodies = [of_body(*pair) for pair in self.bodies(box, q, nu, nu_ref, nudot_ref)]
        some = [*bodies, self.joints(box, nu, nudot_ref)]
        return tuple(np.concatenate([one[i] for one in some], axis=-1) for i in range(3))  # type: ignore[return-value]

    def bodies(
        self, box: Array, q: list[Taylor], nu: list[Taylor], nu_ref: list[Taylor], nudot_ref: list[Taylor]
    ) -> list[tuple[Matrices, Matrices]]:
        """Of every body its motions along the velocities (N, p, 4, 4) and what is asked of its acceleration."""
        known, p = self.regressor.massless, len(nu)
        tree, T = known.tree, np.zeros((len(known.tree.links), p))
        for row, (_, _, _, start, stop), own in zip(T, tree.links, tree.numbers, strict=True):
            row[start:stop] = own[NUMBER.weight : NUMBER.weight + stop - start]
        of_base, fall = np.einsum("bi,brc->irc", T[: BASE.w + 1], PLANAR), np.zeros((4, 4))
        fall[:3, 3] = tree.gravity

        def turned(x: list[Taylor]) -> Matrices:
            return sum((Matrices.of(one, of_base[i]) for i, one in enumerate(x)), Matrices.zero(box))

        none, parts = Matrices.zero(box), {}
        # of the base: placement, screws of the velocities, twists of nu and nu_ref, acceleration
        twist, ref = turned(nu), turned(nu_ref)
        screws = [none + of_base[i] for i in range(p)]
        parts[BASE.w] = none + np.eye(4), screws, twist, ref, turned(nudot_ref) + twist @ ref - fall
        for i in range(BASE.w + 1, len(tree.links)):
            parent, kind, at, _, _ = tree.links[i].tolist()
            H, screws, twist, ref, asked = parts[max(parent, BASE.w)]
            H = H @ (none + placement(tree.numbers[i])) @ self.moved(box, q, kind, at)
            S = screw(H, kind == PRISMATIC)
            x, y, a = (
                sum((one * T[i, j] for j, one in enumerate(some)), 0.0 * some[0]) for some in (nu, nu_ref, nudot_ref)
            )
            asked = asked + S * a + (twist @ S) * y + (ref @ S) * x + (S @ S) * (x * y)
            moves = [one + S.times(T[i, j]) for j, one in enumerate(screws)]
            parts[i] = H, moves, twist + S * x, ref + S * y, asked
        return [
            (Matrices.stacked(screws) @ H.spread(), (asked @ H).spread())
            for H, screws, _, _, asked in (parts[i] for i in range(known.first, len(tree.links)))
        ]

    def moved(self, box: Array, q: list[Taylor], kind: int, at: int) -> Matrices:
        """What a joint does to what it carries."""
        known, found = self.regressor.massless, Matrices.zero(box)
        here = sum((one * known.arm[at, j] for j, one in enumerate(q)), Taylor.constant(known.offset[at], box))
        slides, turns, across = np.zeros((3, 4, 4))
        slides[2, 3] = turns[0, 0] = turns[1, 1] = across[1, 0] = 1.0
        across[0, 1] = -1.0
        if kind == PRISMATIC:
            return found + np.eye(4) + Matrices.of(here, slides)
        c, s = here.turned()
        return found + np.diag((0.0, 0.0, 1.0, 1.0)) + Matrices.of(c, turns) + Matrices.of(s, across)

    def joints(self, box: Array, nu: list[Taylor], nudot_ref: list[Taylor]) -> tuple[Array, Array, Array]:
        """Columns of rotors, viscous friction, and zeros for the dry one."""
        known, (N, z) = self.regressor.massless, box.shape
        count, p, k = len(known.joints), len(nu), self.regressor.size - self.regressor.inertial
        value, slope, rest = np.zeros((N, p, k)), np.zeros((z, N, p, k)), np.zeros((N, p, k))
        found = value, slope.transpose(1, 2, 3, 0), rest
        (v, dv, rv), (a, da, ra) = stacked(nu), stacked(nudot_ref)
        T = known.joints
        for one, speeds, asked in zip(found, (v, dv, rv), (a, da, ra), strict=True):
            by = np.abs(T) if one is rest else T
            one[:, :, :count] = np.einsum("ki,kj,nj...->nik...", by, by, asked)
            for i in range(known.base):
                one[:, i, count + i] = speeds[:, i]
            one[:, :, count + known.base : 2 * count + known.base] = np.einsum("ki,kj,nj...->nik...", by, by, speeds)
        return value, slope, rest

    def dry(self, places: slice, off: Array) -> tuple[Array, Array]:
        """Columns of dry friction along the reference (N, p, k), and how far (N, p, k) it is from there at most.

        Args:
            places: Some instants, N.
            off: (N, p) of the velocities that the learner sees.
        """
        known, k = self.regressor.massless, self.regressor.size
        nu, p = self.course.nu[places], len(known.nu)
        value, more = np.zeros((2, len(nu), p, k))
        first, count = self.regressor.inertial + 2 * len(known.joints) + known.base, len(known.joints)
        rows = [*known.joints, *([np.eye(p)[1]] if first + count < k else [])]  # the last is that of turning
        for j, row in enumerate(rows):
            speed, wide = nu @ row / known.coulomb_speed, off @ np.abs(row) / known.coulomb_speed
            here = np.tanh(speed)
            value[:, :, first + j] = here[:, None] * row
            most = np.maximum(np.tanh(speed + wide) - here, here - np.tanh(speed - wide))
            more[:, :, first + j] = most[:, None] * np.abs(row)
        return value, more


def screw(H: Matrices, slides: bool) -> Matrices:
    """Of a joint along or around the z of its placement: `H E H^-1`, E that of the axis itself."""
    along, turn = np.zeros((2, 4, 4))
    along[2, 3] = turn[1, 0] = 1.0
    turn[0, 1] = -1.0
    if slides:
        return H @ H.like(along)  # the axis in the place of the origin
    R = H @ H.like(np.diag((1.0, 1.0, 1.0, 0.0)))
    W = R @ H.like(turn) @ R.transposed()  # w x
    return W - W @ H @ H.like(np.diag((0.0, 0.0, 0.0, 1.0)))


def of_body(moves: Matrices, asked: Matrices) -> tuple[Array, Array, Array]:
    """Ten columns: value (N, p, 10), slope (z, N, p, 10), rest (N, p, 10)."""
    Q = moves.transposed() @ asked

    def numbers(one: Array) -> Array:
        found = one[..., ROWS, COLUMNS] + one[..., COLUMNS, ROWS]
        found[..., [r == c for r, c in zip(ROWS, COLUMNS, strict=True)]] /= 2
        return np.asarray(found)

    assert Q.value.shape[-1] == 4 and len(ROWS) == BODY
    return numbers(Q.value), numbers(Q.slope), numbers(Q.rest)
