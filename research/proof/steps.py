"""The loop linearised at every period of a run's reference, and a bound of what that leaves out in a box of errors.

With y from the reference and u from the torque that acts on it, a period of `periods` is, all of M, C, g at its place,

    N da = u - dg - d(C nu) - D dnu - dM (a_r + da),      N = M_r + brakes h D

and, where the torque is that of the state, `N a = (k + C) s + M nudot_ref - dM (a - a_r) + errors`: gravity drops out.
The part of first order is P and B; all else is at most what `curvature`, `errors_ahead` and the box say. Nothing is
sampled, neither in the box nor along the reference.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mmnn_pin.errors import RecordingError, RobotError
from mmnn_pin.signals import Array, IntArray

from .curvature import Bent, Curvature
from .errors_ahead import Course, driven
from .periods import Periods
from .screws import Bodies
from .taylor import Taylor, stacked

SIZES = (0.003, 0.01, 0.03, 0.1, 0.3)  # of joint errors, up to which curvatures are bounded [rad or m]
ROUNDING = 1e-13  # of a state, relative to the largest of the reference, in a period


@dataclass(frozen=True, eq=False)
class Box:
    """Largest errors within every block."""

    y: Array  # (K, m) of the state
    s: Array  # (K, p) of s
    f: Array  # (K, p) of what the state adds to accelerations, without delay less what it adds to nudot_ref
    # (K, p) of the torque that acts in a period, from that of the state, or from the reference's where commands are
    # late
    torque: Array


class Rest(NamedTuple):
    """What the first order leaves out in every block, at most."""

    torque: Array  # (K, p) of torques
    state: Array  # (K, m) of states after a period
    acceleration: Array  # (K, p) how far accelerations are from the reference's, all of it


class Steps:
    """The periods of a run along its reference.

    Args:
        periods: The loop.
        late: Periods by which commands are late.
        blocks: Into which the run is cut, at most.

    Attributes:
        at: (K + 1,) first period of every block, and the end of the last one.
        A: (N, m, m) what a period does to a state under a given torque.
        plant: (N, m, p) what that torque does.
        c: (N, m) where the reference leads.
        torque: (N + 1, p) of the reference.
        T: (N + 1, p, m) what a state adds to it.
        S: (N + 1, p, m) what it adds to s.
        answers: (N + 1, p, p) what errors of measured velocities add to the torque.

    Raises:
        RecordingError: A robot whose M, C and gravity have no bounds.
    """

    def __init__(self, periods: Periods, late: int, blocks: int) -> None:
        self.periods, self.late, subject = periods, late, periods.subject
        try:
            self.bodies = Bodies.of(subject.robot)
        except RobotError as error:
            why = f"{error.what}: {error.why}" if error.why else error.what
            raise RecordingError("no tube", why=f"its robot's M, C and gravity have no bounds: {why}") from error
        self.h, self.rows, self.size = subject.timing.control_period, subject.rows, periods.size
        signals = (self.signal(name) for name in ("velocity_ref", "acceleration_ref", "qdot_ref", "qddot_ref"))
        nb = periods.layout.base
        v_ref, a_ref, qdot_ref, qddot_ref = signals
        self.course = Course(v_ref[:, :nb], a_ref[:, :nb], qdot_ref, qddot_ref, *periods.gains)
        self.at: IntArray = np.unique(np.linspace(0, len(self.rows) - 1, blocks + 1).astype(np.int64))
        self.of = np.repeat(np.arange(len(self.at) - 1), np.diff(self.at))
        self._along()
        self._linearise()
        self._curvatures: dict[float, Curvature] = {}

    @property
    def joints(self) -> slice:
        """Of a state."""
        return slice(self.periods.poses, self.periods.poses + self.periods.layout.arm)

    def signal(self, name: str) -> Array:
        """A signal of the run, (N + 1, size)."""
        return self.rows[:, self.periods.layout.where(name)]

    def most(self, values: Array) -> Array:
        """(K, ...) the largest of every block of values (N, ...)."""
        return np.asarray(np.maximum.reduceat(values, self.at[:-1], axis=0))

    # -- along the reference --

    def _along(self) -> None:
        """M, C and slopes of inverse dynamics where the reference is."""
        periods, R, nu = self.periods, len(self.rows), self.course.nu
        p, n, damping = nu.shape[1], periods.layout.arm, periods.damping
        rest, robot = np.zeros(self.size), periods.robot
        _, nudot_ref = self.course.command(np.zeros((R, self.size)))
        self.nudot = stacked(nudot_ref)[0]
        self.M, self.C, self.by_nu = (np.zeros((R, p, p)) for _ in range(3))
        self.torque, acting, self.by_q = np.zeros((R, p)), np.zeros((R, p)), np.zeros((R, p, n))
        self.acceleration, by_q = np.zeros((R, p)), np.zeros((R, p, n))
        columns, (T, dynamics) = robot.arm_map()[1], (robot.T, periods.dynamics)
        for j, row in enumerate(self.rows):
            position, _ = periods.placed(row, rest)
            q = robot.configuration(position)
            self.M[j], self.C[j] = dynamics.mass_matrix(position), dynamics.coriolis_matrix(position, nu[j])
            drift = dynamics.gravity(position) + (self.C[j] + damping) @ nu[j]
            self.torque[j] = self.M[j] @ self.nudot[j] + drift
            acting[j] = self.torque[j - self.late] if j >= self.late else 0.0
            a = np.linalg.solve(self.M[j] + periods.brakes * self.h * damping, acting[j] - drift)
            pin.computeRNEADerivatives(dynamics.model, dynamics.data, q, T @ nu[j], T @ a)
            by_q[j], self.acceleration[j] = T.T @ dynamics.data.dtau_dq @ columns, a
            pin.computeRNEADerivatives(dynamics.model, dynamics.data, q, T @ nu[j], T @ self.nudot[j])
            self.by_q[j], self.by_nu[j] = T.T @ dynamics.data.dtau_dq @ columns, T.T @ dynamics.data.dtau_dv @ T
        self.plant_by_q, self.acting = by_q, acting
        self.N_inv = np.linalg.inv(self.M + periods.brakes * self.h * damping)

    def _linearise(self) -> None:
        """The first order of all."""
        gain, at, n = self.periods.gain, self.periods.poses, self.periods.layout.arm
        nothing, rates = np.zeros((len(self.rows), self.size)), slice(at + n, None)
        command = self.course.command(nothing)
        (_, of_ref, _), (_, of_rate, _) = (stacked(one) for one in command)
        self.S, self.of_rate = of_ref.copy(), of_rate
        self.S[:, :, rates] -= np.eye(len(gain))
        seen = self.M @ of_rate
        self.answers = gain[:, None] * np.eye(len(gain)) - seen[:, :, rates]
        self.T = gain[:, None] * self.S + seen + self.C @ of_ref
        self.T[:, :, at : at + n] += self.by_q
        self.T[:, :, rates] += self.by_nu - self.C + self.periods.damping
        self.open = np.zeros_like(self.S)
        self.open[:, :, at : at + n] -= self.plant_by_q
        self.open[:, :, rates] -= self.by_nu + self.periods.damping
        self.open = self.N_inv @ self.open
        self.noisy = self.most(np.abs(of_rate[:-1, :, rates]))
        box = np.zeros((len(self.rows) - 1, self.size + len(gain)))
        self.c, slope, _ = stacked(self.ahead(box, self.accelerations(box, np.zeros((len(box), len(gain))))))
        self.A, self.plant = slope[:, :, : self.size], slope[:, :, self.size :]

    def accelerations(self, box: Array, rest: Array, closed: bool = False) -> list[Taylor]:
        """(p) of the periods, for states and torques in boxes (N, m + p), of which `rest` (N, p) is not known."""
        N = len(box)
        by_state = self.open[:N] + (self.N_inv[:N] @ self.T[:N] if closed else 0.0)
        slope = np.concatenate((by_state, self.N_inv[:N]), axis=2)
        return [Taylor(self.acceleration[:N, i], slope[:, i], rest[:, i], box) for i in range(rest.shape[1])]

    def ahead(self, box: Array, a: list[Taylor]) -> list[Taylor]:
        """(m) states after the periods."""
        periods, h, nb = self.periods, self.h, self.periods.layout.base
        at, n, N, nu = periods.poses, periods.layout.arm, len(box), self.course.nu
        speed = [Taylor.variable(at + n + i, box, nu[:N, i]) for i in range(len(a))]
        moved = [(v + one * (periods.moves * h)) * h for v, one in zip(speed, a, strict=True)]
        pose: list[Taylor] = []
        if at:
            way = moved[:2] if self.periods.layout.sideways else [moved[0], moved[0] * 0.0]
            pose = driven(self.signal("pose_ref"), way, moved[nb - 1], 1 - periods.moves, box)
        steps = np.diff(self.signal("q_ref"), axis=0)
        joints = [Taylor.variable(at + i, box) + moved[nb + i] - steps[:, i] for i in range(n)]
        return [*pose, *joints, *(v + one * h - nu[1:, i] for i, (v, one) in enumerate(zip(speed, a, strict=True)))]

    # -- with late torques as more states --

    def P(self, j: int) -> Array:
        """(m + l, m + l) what period j does to a state, late torques behind it."""
        return delayed(self.A[j], self.plant[j], self.T[j], self.late)[0]

    def B(self, j: int) -> Array:
        """(m + l, p) what an error of the torque does."""
        return delayed(self.A[j], self.plant[j], self.T[j], self.late)[1]

    def sees(self, j: int) -> Array:
        """(2 p, m + l) s of a state, and f of `Box`, to first order."""
        p, late = len(self.S[j]), np.zeros((len(self.S[j]), self.late * len(self.S[j])))
        if self.late:
            late[:, :p] = self.N_inv[j]
            return np.block([[self.S[j], 0 * late], [self.open[j], late]])
        return np.concatenate((self.S[j], self.open[j] + self.N_inv[j] @ self.T[j] - self.of_rate[j]))

    # -- what is left out --

    def bent(self, errors: Array, moved: Array | None = None, other: Array | None = None) -> Bent | None:
        """What joint errors (K, n) change of M, C and gravity in every block; None beyond the largest of `SIZES`.

        With `moved` (K, n): what that changes between two places within these errors; with `other`, of the second
        order what both do together.
        """
        size = next((one for one in SIZES if errors.max(initial=0.0) <= one), None)
        if size is None:
            return None
        if size not in self._curvatures:
            q = self.signal("q_ref")
            low, high = (f.reduceat(q, self.at[:-1], axis=0) for f in (np.minimum, np.maximum))
            low, high = np.minimum(low, q[self.at[1:]]), np.maximum(high, q[self.at[1:]])
            stiff = self.periods.brakes * self.h * self.periods.damping
            found = Curvature.of(self.bodies, (low + high) / 2, (high - low) / 2 + size, stiff)
            self._curvatures[size] = found
            self.moved = np.abs(self.N_inv[: len(self.of)] @ np.linalg.inv(found.X)[self.of])
        return self._curvatures[size].along(errors if moved is None else moved, other)

    def rest(self, box: Box, noise: Array) -> Rest | None:
        """What is left out in every block; None for boxes without a bound.

        Without delay that of states has all: what is left out of a torque acts in the same period, and most of it is
        what the motion leaves out, too.

        Args:
            box: Of the errors.
            noise: (p,) of the velocities that the controller is told.
        """
        periods, p, N = self.periods, len(noise), len(self.of)
        if (bent := self.bent(box.y[:, self.joints])) is None:
            return None
        seen, rates = box.y.copy(), box.y[:, -p:]
        seen[:, -p:] += noise
        refs, accelerations = (stacked(one) for one in self.course.at(slice(0, N)).command(seen[self.of]))
        nu, nudot, a, late, M, inverse = self.sizes
        ref_rest, rate_rest = self.most(refs[2]), self.most(accelerations[2])
        ref_off, rate_off = (self.off(one, seen) for one in (refs, accelerations))
        asked = periods.gain * ref_rest + times(M, rate_rest)
        torque = asked + times(bent.M1, rate_off) + times(bent.M2, nudot) + bent.g2
        torque += twice(bent.C0, nu, ref_rest) + twice(bent.C1, nu, ref_off) + twice(bent.C1, rates, nu)
        torque += twice(bent.C2, nu, nu) + twice(bent.C0, rates, ref_off)
        if self.late:
            forces = bent.g2 + twice(bent.C2, nu, nu) + times(bent.M2, a)
            off = twice(bent.XC1, nu, rates) + twice(bent.XC1, rates, nu) + twice(bent.XC0, rates, rates)
            off += times(bent.XM1, box.f)
        else:
            forces = asked + times(bent.M2, late)
            told = rate_rest + self.noisy @ noise  # what nudot_ref asks for beside, which M of the place answers
            off = times(bent.XM1, box.f + times(inverse, box.torque) + told)
            off += twice(bent.XC1, nu, box.s) + twice(bent.XC0, rates, box.s) + twice(bent.XC0, nu + rates, ref_rest)
        if (left := self.left(bent, off + times(bent.X, forces))) is None:
            return None
        variables = np.concatenate((box.y, box.torque), axis=1)[self.of]
        rest = stacked(self.ahead(variables, self.accelerations(variables, left, closed=not self.late)))[2]
        largest = 1 + np.abs(self.rows[:, periods.layout.where("pose_ref")]).max(initial=0.0) + nu.max()
        off = box.f + self.most(left) + (0.0 if self.late else rate_off + times(inverse, box.torque))
        return Rest(torque, self.most(rest) + ROUNDING * largest, off)

    @cached_property
    def sizes(self) -> tuple[Array, ...]:
        """Largest of every block: nu, nudot_ref, accelerations, their difference, M, N^-1."""
        late = self.nudot - self.acceleration
        some = (self.course.nu, self.nudot, self.acceleration, late, self.M, self.N_inv)
        return tuple(self.most(np.abs(one[: len(self.of)])) for one in some)

    @property
    def unbounded(self) -> Bent:
        """Changes of M, C and gravity without a bound."""
        K, p = len(self.at) - 1, self.M.shape[1]
        one, two, three = (np.full((K, *(p,) * order), np.inf) for order in (1, 2, 3))
        return Bent(M1=two, M2=two, C0=three, C1=three, C2=three, g1=one, g2=one, XM1=two, XC0=three, XC1=three, X=two)

    def errors(self, box: Box) -> Array:
        """(K, p) bounds of s in a box: what is linear, and what is left of the reference velocities."""
        return box.s + self.most(stacked(self.course.at(slice(0, len(self.of))).command(box.y[self.of])[0])[2])

    def off(self, functions: tuple[Array, Array, Array], box: Array) -> Array:
        """(K, p) how far functions are from their values at 0 in boxes (K, m)."""
        _, slope, rest = functions
        return self.most(times(np.abs(slope), box[self.of]) + rest)

    def left(self, bent: Bent, off: Array) -> Array | None:
        """(N, p) accelerations beyond the first order: `x = |N^-1 / X| (off + XM1 x)`, if that has a solution."""
        moved = self.moved
        drive = times(moved, off[self.of]) + np.finfo(float).tiny
        with np.errstate(all="ignore"):
            found = np.linalg.solve(np.eye(moved.shape[1]) - moved @ bent.XM1[self.of], drive[..., None])[..., 0]
        return np.asarray(found) if (found > 0).all() else None


def times(A: Array, x: Array) -> Array:
    """(K, p) of matrices (K, p, q) and vectors (K, q)."""
    return np.asarray(np.einsum("kij,kj->ki", A, x))


def twice(C: Array, x: Array, y: Array) -> Array:
    """(K, p): `C_ijl x_j y_l`."""
    return np.asarray(np.einsum("kijl,kj,kl->ki", C, x, y))


def delayed(A: Array, B: Array, T: Array, late: int) -> tuple[Array, Array]:
    """A period (m, m), (m, p) whose torque answers a state as T (p, m), with commands that act `late` periods later.

    Returns what it does to the state, late torques behind it, and what an error of the torque does.
    """
    if not late:
        return A + B @ T, B
    m, p = B.shape
    P, into = np.zeros((m + late * p, m + late * p)), np.zeros((m + late * p, p))
    P[:m, :m], P[:m, m : m + p] = A, B
    P[m:-p, m + p :] = np.eye((late - 1) * p)
    P[-p:, :m], into[-p:] = T, np.eye(p)
    return P, into
