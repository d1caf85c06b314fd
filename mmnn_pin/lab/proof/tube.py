"""A tube around one reference that the sampled loop does not leave: docs/explanation/theory.md, section 9.

The state y is how far the robot is from its reference: the pose in the reference's frame, the joints, the velocities.
Over a control period, with the torque `k s + Psi_hat` held, it goes from y to `G(y, tau)`; Psi_hat is Psi less an
error that counts as a disturbance, `|Psi~| <= eps(t)`. Linearised along the reference at a period of every block of
periods, with the delay of commands as more states,

    y+ = P y + c + B (Psi~ + disturbance) + remainder

The response to the start and to c is known; what all disturbances and remainders within their bounds can add is their
sum over time of absolute values, which sequences of signs reach. The remainder is bounded over the box that the tube
takes up, and the tube made anew, until neither grows: then, by induction over the periods, no motion leaves it. Nothing
is asked of a Lyapunov function: the reference may begin at rest, friction may be stiff, commands may be late.

Bounds of remainders are *sampled*: the largest at random corners of the box in random periods of every block, times
`MORE`.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...errors import InputError, RecordingError
from ...settings import finite
from ...signals import Array, IntArray
from .certified_loop import push_bound
from .known import Errors, Observed, Proved
from .periods import Linear, Periods
from .subject import Subject

BLOCKS = 100  # of the run
OFTEN = 8  # in a block is the integrator looked at
CORNERS = 3  # of the box, looked at in every block
MORE = 1.5  # than the largest remainder that was seen
ROUNDS, AHEAD = 10, 1.2  # of tube and remainder; times what was found is tried next
SHORTEST, LATEST = 20, 4  # rows of a run; periods of delay, whose squares the memory grows with
LOST = 2.0  # [m, rad] of error: no tube
FACTORS = np.geomspace(1e-3, 1e3, 25)  # on the error of Psi, for how much is borne


@dataclass(frozen=True, eq=False)
class Tube:
    """Bounds on the errors of every motion that is where the run was at its start.

    Attributes:
        start: Time from which on there is one [s]; inf for never, and then all else is of the second half of the run.
        time: (J,) ends of blocks of periods after that [s].
        names: Of the errors: along, across and turned from the reference, then the joints.
        size: (J, m) largest magnitudes [m, rad].
        reached: (J, m) magnitudes in the run.
        torque: (motors,) largest torque over the motor's limit; 0 for motors without one.
        eps: (p,) largest error of Psi that was counted with [N, N m].
        share: (p,) the same over the largest Psi of the run.
        bears: Factor on the run's errors of Psi up to which there is a tube; 0 for none, inf beyond what was looked at,
            NaN for errors that are proved.
        integrator: (m + p,) what the plant does in a period otherwise than exact motion without dry friction's changes.
        late: Periods by which commands are late.
        proof: The same with the errors of Psi that are proved of the learner in place of the run's; None for nothing.
        unproved: Why there is none.
    """

    start: float
    time: Array
    names: tuple[str, ...]
    size: Array
    reached: Array
    torque: Array
    eps: Array
    share: Array
    bears: float
    integrator: Array
    late: int
    proof: Tube | None = None
    unproved: str = ""

    @property
    def exists(self) -> bool:
        """Whether there is a tube, in which no motor passes its limit."""
        return bool(np.isfinite(self.start) and (self.torque < 1.0).all())

    @property
    def covers(self) -> bool:
        """Whether the run stays in it; nothing is said where there is none."""
        proved = self.proof is None or self.proof.covers
        return proved and (not self.exists or bool((self.reached <= self.size).all()))

    def to_dict(self) -> dict[str, Any]:
        """For JSON: from when on, the largest of every error and that at the end, and what was counted with."""
        told = {"largest": self.size.max(axis=0), "at_the_end": self.size[-1], "run": self.reached.max(axis=0)}
        return {
            "exists": self.exists,
            "from": finite(self.start),
            **{key: dict(zip(self.names, map(finite, values), strict=True)) for key, values in told.items()},
            "torque_over_limit": finite(self.torque.max(initial=0.0)),
            "psi_error": [finite(v) for v in self.eps],
            "psi_error_share": [finite(v) for v in self.share],
            "bears": finite(self.bears),
            "commands_late": self.late,
            "proved": self.unproved if self.proof is None else self.proof.to_dict(),
        }


def refusal(subject: Subject) -> str:
    """What of a run the tube does not know; empty if nothing."""
    meta = subject.recording.meta
    if subject.plant != "ideal" or subject.timing.integrator == "stick":
        return "wheels may slip, or friction stick, in its plant"
    if subject.motors_lag:
        return "its motors have more than a limit of torque"
    if any(event["type"] != "push" for event in meta.get("disturbances", ())):
        return "something else than pushes happens to the robot"
    latency, h = subject.latency, subject.timing.control_period
    if len(subject.rows) <= SHORTEST:
        return f"it has {len(subject.rows)} rows only"
    if latency.command > LATEST * h:
        return f"its commands are late by more than {LATEST} periods"
    if latency.sensing or latency.jitter:
        return "its measurements are late, or its commands by chance"
    if abs(latency.command / h - round(latency.command / h)) > 1e-6:
        return "its commands are late by a part of a period"
    if not subject.exact_poses:
        return "its sensors err by more than noise of velocities, or are slower than its controller"
    if subject.recording.outcome.status != "completed":
        return f"the run was {subject.recording.outcome.status}"
    if any(not np.all(np.asarray(getattr(subject.kinematic, name)) > 0) for name in ("kx", "ky", "kth", "K")):
        return "a kinematic gain is 0"
    gain, tau = subject.signal("effective_gain"), subject.signal("torque")
    off = np.abs(gain[0] * subject.s + subject.signal("psi_hat") - tau).max()
    if not (gain > 0).all() or np.ptp(gain, axis=0).any() or off > 1e-6 * max(np.abs(tau).max(), 1e-300):
        return "its torque is not a constant gain on s plus Psi_hat (a robust term, a lead or a limit adds to it)"
    return ""


Told = Callable[[float], None]


def tube_of(subject: Subject, disturbance: Array | None = None, progress: Told | None = None) -> Tube:
    """The tube of a run: from its start, for errors of Psi no larger than it had from then on.

    Args:
        subject: The run.
        disturbance: (p,) external force beside the pushes of the run [N, N m].
        progress: Called with the share that is done.

    Raises:
        RecordingError: The loop is another one; why.
    """
    with subject.recording.using("what it tells of its hardware"):
        why = refusal(subject)
        force = np.zeros(subject.layout.dof) if why else push_bound(subject)
        search = None if why else Search(Periods(subject), force if disturbance is None else force + disturbance)
    if search is None:
        raise RecordingError("no tube", why=why, file=subject.recording.path)
    told = progress or (lambda share: None)
    with subject.recording.using("its loop"), np.errstate(all="ignore"):
        found = search.tube(told)
        try:
            proof = search.proved().tube(told)
        except InputError as error:
            return replace(found, unproved=error.why or error.what)
    return replace(found, proof=proof)


class Search:
    """Tube and remainder made in turn.

    Args:
        periods: The loop.
        force: (p,) largest external force [N, N m].

    Attributes:
        errors: What is counted with of Psi: those of the run, or those of `proved`.
    """

    def __init__(self, periods: Periods, force: Array) -> None:
        subject = periods.subject
        self.periods, self.force, self.limits = periods, force, subject.motor_limits
        self.late = round(subject.latency.command / subject.timing.control_period)
        self.noise = periods.gain * subject.velocity_noise
        missed = np.abs(subject.signal("psi") - subject.signal("psi_hat"))
        self.errors: Errors = Observed(missed, self.starts)

    @cached_property
    def linear(self) -> Linear:
        """The loop along the reference."""
        return Linear.of(self.periods, self.late, BLOCKS)

    @property
    def starts(self) -> IntArray:
        """(K,) first period of every block."""
        return self.linear.at[:-1]

    @property
    def ends(self) -> IntArray:
        """(K,) first period after every block."""
        return self.linear.at[1:]

    def proved(self) -> Search:
        """The same with what is proved of the learner; errors as of `Proved`."""
        found = copy(self)
        found.errors = Proved(self.periods, self.starts, self.ends, self.force)
        return found

    def response(self, first: int) -> Array:
        """(K, m + l) the state at the end of every block from the run's at block `first`, nothing else; 0 before."""
        lin, m, found = self.linear, self.periods.size, np.zeros((len(self.ends), self.linear.P.shape[1]))
        y = np.zeros(lin.P.shape[1])
        y[:m] = self.reached[first]
        y[m:] = self.commanded(first)
        for b in range(first, len(self.ends)):
            for j in range(self.starts[b], self.ends[b]):
                P, c = lin.between(b, j, "P", "c")
                y = P @ y
                y[:m] += c
            found[b] = y
        return found

    @cached_property
    def reached(self) -> Array:
        """(K + 1, m) states of the run between the blocks."""
        rows, where = self.periods.subject.rows, self.periods.layout.where
        return np.array([self.periods.state(r, r[where("position")], r[where("nu")]) for r in rows[self.linear.at]])

    def commanded(self, first: int) -> Array:
        """(l,) torques on their way at the beginning of a block, less those without errors; none before the start."""
        subject, j = self.periods.subject, int(self.linear.at[first])
        tau = [
            subject.signal("torque")[i] if i >= 0 else np.zeros(self.periods.layout.dof)
            for i in range(j - self.late, j)
        ]
        return np.ravel([one - self.linear.torque[first] for one in tau])

    @cached_property
    def kernels(self) -> tuple[Array, Array]:
        """What errors of the torque and remainders in a block add at most by the end of a block, per unit.

        (K, m + l, K, p) and (K, m + l, K, m + l): by the end of the first index's block, in the third's.
        """
        lin, K, (_, m, p) = self.linear, len(self.ends), self.linear.B.shape
        of_torque, of_rest = np.zeros((K, m, K, p)), np.zeros((K, m, K, m))
        Z = np.zeros((K, m, m))
        for b in range(K - 1, -1, -1):
            Z[b] = np.eye(m)
            for j in range(self.ends[b] - 1, self.starts[b] - 1, -1):
                P, B = lin.between(b, j, "P", "B")
                of_torque[b:, :, b] += np.abs(Z[b:] @ B)
                of_rest[b:, :, b] += np.abs(Z[b:])
                Z[b:] = Z[b:] @ P
        return of_torque, of_rest

    @cached_property
    def integrator(self) -> Array:
        """(K, m + l) what the plant's integrator does otherwise than the exact motion in a period, from a block on."""
        subject, found = self.periods.subject, np.zeros((len(self.ends), self.linear.P.shape[1]))
        where, force = self.periods.layout.where, subject.hardware.torque + subject.hardware.push
        for b, (start, end) in enumerate(zip(self.starts, self.ends, strict=True)):
            for j in range(start, end, max((end - start) // OFTEN, 1)):
                row, following = subject.rows[j], subject.rows[j + 1]
                y, then = (self.periods.state(r, r[where("position")], r[where("nu")]) for r in (row, following))
                after = self.periods.after(row, following, y, force[j] - self.periods.dry(row[where("nu")]))
                found[b, : len(y)] = np.maximum(found[b, : len(y)], np.abs(then - after))
        return np.asarray(np.maximum.accumulate(found[::-1], axis=0)[::-1])

    def sums(self, errors: Array, remainder: Array) -> Array:
        """(K, m + l) what errors of the torque (K, p) and remainders (K, m + l) add at most by the end of a block."""
        of_torque, of_rest = self.kernels
        return np.asarray(np.einsum("imbp,bp->im", of_torque, errors) + np.einsum("imbn,bn->im", of_rest, remainder))

    def remainder(self, first: int, size: Array) -> Array:
        """(K, m + l) the largest remainder from a block on, at corners of the boxes of a tube (K, m + l)."""
        lin, rows, rng = self.linear, self.periods.subject.rows, np.random.default_rng(0)
        m, found, boxes = self.periods.size, np.zeros_like(size), self.boxes(first, size)
        for b in range(first, len(self.ends)):
            box = boxes[b]
            for j in rng.integers(self.starts[b], self.ends[b], CORNERS):
                y, sampled = (box * rng.choice((-1.0, 1.0), m) for _ in range(2))
                sampled = sampled if self.late else y
                P, A, plant, T, torque, c = lin.between(b, j, "P", "A", "plant", "T", "torque", "c")
                tau = self.periods.torque(rows[j], sampled)
                off = self.periods.after(rows[j], rows[j + 1], y, tau) - c
                if self.late:
                    off -= A @ y + plant @ (tau - torque)
                    bent = np.abs(tau - torque - T @ sampled)
                    found[b, -len(bent) :] = np.maximum(found[b, -len(bent) :], bent)
                else:
                    off -= P @ y
                found[b, :m] = np.maximum(found[b, :m], np.abs(off))
        return MORE * np.asarray(np.maximum.accumulate(found[::-1], axis=0)[::-1])

    def boxes(self, first: int, size: Array) -> Array:
        """(K, m) what a tube (K, m + l) is at most within every block from `first` on, 0 before."""
        start = np.concatenate((np.abs(self.reached[first])[None], size[first:-1, : self.periods.size]))
        return np.concatenate((np.zeros((first, start.shape[1])), np.maximum(start, size[first:, : start.shape[1]])))

    def size(self, first: int, factor: float = 1.0) -> Array:
        """(K, m + l) the tube from a block on for `factor` times the errors of Psi, 0 before; inf if there is none."""
        return self.found(first, factor)[0]

    def found(self, first: int, factor: float = 1.0) -> tuple[Array, Array]:
        """The same, and the errors of Psi (K, p) that were counted with."""
        response, since = np.abs(self.response(first)), (np.arange(len(self.ends)) >= first)[:, None]
        remainder, eps = np.zeros_like(response), self.errors.eps(first, self.boxes(first, response))
        for _ in range(ROUNDS):
            errors = since * (factor * eps + self.force + self.noise)
            size = response + since * self.sums(errors, since * self.integrator + remainder)
            if not (size[:, : self.periods.poses + self.periods.layout.arm] < LOST).all():
                break
            rest, wider = self.remainder(first, size), self.errors.eps(first, self.boxes(first, size))
            if (rest <= remainder).all() and (wider <= eps).all():
                return size, eps
            if (rest > remainder).any():
                remainder = AHEAD * np.maximum(remainder, rest)
            eps = np.where(wider > eps, AHEAD * wider, eps)
        return np.full_like(response, np.inf), eps

    def first(self, progress: Told) -> int:
        """The first block from which there is a tube, by bisection; their number where the last quarter has none."""
        low, high = 0, 3 * len(self.ends) // 4
        if self.exists(low):
            return low
        if not self.exists(high):
            return len(self.ends)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.exists(middle) else (middle, high)
            progress(1 - (high - low) / len(self.ends))
        return high

    def exists(self, first: int, factor: float = 1.0) -> bool:
        """Whether there is a tube."""
        return bool(np.isfinite(self.size(first, factor)).all())

    def torques(self, first: int, size: Array, eps: Array) -> Array:
        """(motors,) largest torque in a tube, for errors of Psi (K, p), over the motors' limits; 0 without limits."""
        lin, m, robot = self.linear, self.periods.size, self.periods.robot
        E_inv, since = np.linalg.inv(robot.E), slice(first, None)
        tau = np.einsum("kpm,km->kp", np.abs(lin.T[1:]), size[:, :m]) + eps + self.noise
        asked = np.abs(lin.torque[1:] @ E_inv.T) + tau @ np.abs(E_inv).T
        return np.asarray((asked[since] / self.limits).max(axis=0))

    def bears(self, first: int) -> float:
        """Largest of `FACTORS` on the errors of Psi from a block on for which there is a tube; 0 for none."""
        low, high = -1, len(FACTORS)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self.exists(first, float(FACTORS[middle])) else (low, middle)
        return 0.0 if low < 0 else float(FACTORS[low]) if high < len(FACTORS) else np.inf

    def tube(self, progress: Told) -> Tube:
        """All of it."""
        periods, first = self.periods, self.first(progress)
        at, there, told = periods.poses, first < len(self.ends), slice(0, periods.poses + periods.layout.arm)
        begin = first if there else len(self.ends) // 2
        (size, errors), since = self.found(begin), slice(begin, None)
        eps = errors.max(axis=0)
        time = periods.subject.rows[self.linear.at][:, periods.layout.where("time")][:, 0]
        largest = np.abs(periods.subject.signal("psi")).max(axis=0)
        return Tube(
            start=float(time[begin]) if there else np.inf,
            time=time[1:][since],
            names=(*("along", "across", "heading")[:at], *periods.robot.velocity_names[periods.layout.base :]),
            size=size[since, told],
            reached=np.abs(self.reached[1:][since, told]),
            torque=self.torques(begin, size, errors) if there else np.zeros(0),
            eps=eps,
            share=eps / np.maximum(largest, 1e-300),
            bears=self.bears(begin) if isinstance(self.errors, Observed) else np.nan,
            integrator=self.integrator[begin],
            late=self.late,
        )
