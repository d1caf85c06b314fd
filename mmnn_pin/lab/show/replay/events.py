"""What happened in a run and is coloured while it lasts: how it ended, a supervisor's stops, slip, motors at limits.

An event colours the bodies of its joints, or the whole robot, and a stretch of the scrub bar. Another kind of event
is another function in `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ....plant.contact.slip import SLIPPING
from ....recording.recording import Recording, as_columns
from ....safety import RAMPING, STEPPED_IN, STOPPING
from ....signals import Array
from ..units import prismatic_joints

Kind = Literal["stop", "slip", "limit"]
GAP = 0.1  # two stretches that are nearer than this are one [s]
AT_LIMIT = 1 - 1e-6


@dataclass(frozen=True)
class Event:
    """Something to see.

    Attributes:
        kind: `stop` (in red), `slip` (in purple) or `limit` (in amber).
        start: When it begins [s].
        end: When it is over [s]; inf for the rest of the replay.
        text: One line for people.
        joints: Whose bodies are coloured; the whole robot if empty.
    """

    kind: Kind
    start: float
    end: float
    text: str
    joints: tuple[str, ...] = ()

    def for_page(self, bodies: dict[str, int]) -> dict[str, Any]:
        """What the page needs of it; bodies by the name of the joint that carries them."""
        end = self.end if np.isfinite(self.end) else None
        on = [bodies[joint] for joint in self.joints if joint in bodies]
        return {"kind": self.kind, "start": self.start, "end": end, "text": self.text, "bodies": on}


def early_end(recording: Recording) -> Iterator[Event]:
    """A run that did not complete: diverged, tripped by the safety layer, or interrupted."""
    outcome = recording.outcome
    if outcome.status != "completed":
        why = outcome.message.partition(";")[0] or f"at t = {outcome.time:.3g} s"
        yield Event("stop", outcome.time, np.inf, f"{outcome.status}: {why}")


def supervised(recording: Recording) -> Iterator[Event]:
    """What a supervisor did: a torque clipped or a value held, and a stop, under feedback or without."""
    if "safety" not in recording:
        return
    state = np.asarray(recording["safety"])
    for kind, code, text in SUPERVISED:
        if code == STOPPING and recording.outcome.status == "tripped":
            continue  # its end tells it, with the reason
        for start, end in stretches(recording.time, state == code):
            yield Event(kind, start, end, text)


def slipping(recording: Recording) -> Iterator[Event]:
    """Wheels that slip, on the contact plant, a stretch of time each."""
    if "slip" not in recording:
        return
    for name, speed in zip(recording.labels("slip"), as_columns(recording["slip"]).T, strict=True):
        for start, end in stretches(recording.time, speed > SLIPPING):
            yield Event("slip", start, end, f"{name} slips", (name,))


def at_limits(recording: Recording) -> Iterator[Event]:
    """Motors that are asked for their largest torque or more, a stretch of time each."""
    limits = recording.meta.get("effort_limits")
    if limits is None or "motor_torque" not in recording:
        return
    sliding = prismatic_joints(recording.urdf)
    torques = as_columns(recording["motor_torque"]).T
    for name, limit, torque in zip(recording.labels("motor_torque"), limits, torques, strict=True):
        text = f"{name} at its limit of {limit:g} {'N' if name in sliding else 'N m'}"
        for start, end in stretches(recording.time, np.abs(torque) >= AT_LIMIT * limit):
            yield Event("limit", start, end, text, (name,))


def stretches(time: Array, holds: NDArray[np.bool_]) -> Iterator[tuple[float, float]]:
    """First and last time of every stretch in which something holds; short pauses are no pauses."""
    rows = np.flatnonzero(holds)
    for part in np.split(rows, np.flatnonzero(np.diff(time[rows]) > GAP) + 1):
        if len(part):
            yield float(time[part[0]]), float(time[part[-1]])


SUPERVISED: tuple[tuple[Kind, float, str], ...] = (
    ("limit", STEPPED_IN, "the supervisor clips a torque or holds a value"),
    ("stop", STOPPING, "the supervisor stops the robot"),
    ("stop", RAMPING, "stopped without feedback: the torque goes to zero"),
)
SOURCES: tuple[Callable[[Recording], Iterator[Event]], ...] = (early_end, supervised, slipping, at_limits)


def events_of(recording: Recording) -> list[Event]:
    """All events of a run, as they began."""
    found = [event for source in SOURCES for event in source(recording)]
    return sorted(found, key=lambda event: event.start)
