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

Bounds of remainders hold everywhere in the box (`steps`, `features`): nothing is sampled but the size of rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mmnn_pin.errors import InputError, RecordingError
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.settings import finite
from mmnn_pin.signals import Array

from .certified_loop import push_bound
from .known import Observed
from .periods import Periods
from .tube_search import Search, Told

SHORTEST, LATEST = 20, 4  # rows of a run; periods of delay, whose squares the memory grows with


@dataclass(frozen=True, eq=False)
class Tube:
    """Bounds on the errors of every motion that is where the run was at its start.

    Attributes:
        start: Time from which on there is one [s]; inf for never, and then all else is of the second half of the run.
        time: (J,) ends of blocks of periods after that [s].
        names: Of the errors: along, across and turned from the reference, then the joints.
        size: (J, m) largest magnitudes in each block [m, rad].
        reached: (J, m) those of the run.
        torque: (motors,) largest torque over the motor's limit; 0 for motors without one.
        eps: (p,) largest error of Psi that was counted with [N, N m].
        share: (p,) the same over the largest Psi of the run.
        bears: Factor on the run's errors of Psi up to which there is a tube; 0 for none, inf beyond what was looked at,
            NaN for errors that are proved.
        pushes: Velocity to the largest further push on it under which there is a tube, all at once [N, N m].
        integrator: (m + p,) what the plant does in a period otherwise than exact motion without dry friction's changes.
        late: Periods by which commands are late.
        blame: What stands in the way of a proof where there is none: what errs most, and what to change.
        note: What else is to be said of the errors of Psi that were counted with.
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
    pushes: dict[str, float]
    integrator: Array
    late: int
    blame: str = ""
    note: str = ""
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
            "pushes": self.pushes,
            "commands_late": self.late,
            "in_the_way": self.blame,
            "proved": self.unproved if self.proof is None else self.proof.to_dict(),
        }


def refusal(subject: Subject) -> str:
    """The first property of a run that the tube does not cover; empty if it covers all."""
    return hardware_refusal(subject) or timing_refusal(subject) or loop_refusal(subject)


def hardware_refusal(subject: Subject) -> str:
    """The first property of plant, motors and disturbances that the tube does not cover; empty if it covers all."""
    if subject.plant != "ideal" or subject.timing.integrator == "stick":
        return "wheels may slip, or friction stick, in its plant"
    if subject.rolls_otherwise:
        return "its wheels have other radii than its controller takes"
    if subject.motors_lag:
        return "its motors have more than a limit of torque"
    if any(event["type"] != "push" for event in subject.recording.meta.get("disturbances", ())):
        return "something else than pushes happens to the robot"
    return ""


def timing_refusal(subject: Subject) -> str:
    """The first property of length and latency that the tube does not cover; empty if it covers all."""
    latency, h = subject.latency, subject.timing.control_period
    if len(subject.rows) <= SHORTEST:
        return f"it has {len(subject.rows)} rows only"
    if latency.command > LATEST * h:
        return f"its commands are late by more than {LATEST} periods"
    if latency.sensing or latency.jitter:
        return "its measurements are late, or its commands by chance"
    if abs(latency.command / h - round(latency.command / h)) > 1e-6:
        return "its commands are late by a part of a period"
    return ""


def loop_refusal(subject: Subject) -> str:
    """The first property of sensors, gains and torque that the tube does not cover; empty if it covers all."""
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
        found = tube_from(search, told)
        try:
            proof = tube_from(search.proved(), told)
        except InputError as error:
            return replace(found, unproved=error.why or error.what)
    return replace(found, proof=proof)


def tube_from(search: Search, progress: Told) -> Tube:
    """The tube of a search."""
    periods, first, steps = search.periods, search.first(progress), search.steps
    at, there, told = periods.poses, first < len(search.ends), slice(0, periods.poses + periods.layout.arm)
    begin = first if there else len(search.ends) // 2
    (size, errors), since = search.found(begin), slice(begin, None)
    eps, reached = errors.max(axis=0), np.abs(search.reached[:, told])
    time = periods.subject.signal("time")[:, 0]
    largest = np.abs(periods.subject.signal("psi")).max(axis=0)
    pushes = search.pushes(first) if there else np.zeros(periods.layout.dof)
    return Tube(
        start=float(time[search.starts[begin]]) if there else np.inf,
        time=time[search.ends[since]],
        names=(*("along", "across", "heading")[:at], *periods.robot.velocity_names[periods.layout.base :]),
        size=size[since, told],
        reached=np.maximum(steps.most(reached[:-1]), reached[search.ends])[since],
        torque=search.torques(begin) if there else np.zeros(0),
        eps=eps,
        share=eps / np.maximum(largest, 1e-300),
        bears=search.bears(begin) if isinstance(search.errors, Observed) else np.nan,
        pushes=dict(zip(periods.robot.velocity_names, pushes.tolist(), strict=True)),
        integrator=search.integrator[begin],
        late=search.late,
        blame="" if there else search.blame(begin),
        note=search.errors.note,
    )
