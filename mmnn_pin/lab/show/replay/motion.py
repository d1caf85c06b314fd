"""A run as a replay shows it: the robot's moving bodies, their places at the rate of a display, and events.

Links fixed to one another are one body. An event colours the bodies of its joints, or the whole robot, and a stretch of
the scrub bar; another kind of event is another function in `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ....errors import RecordingError
from ....model.chain import chain_of, hands_of, track
from ....model.robot import Robot
from ....model.urdf.document import Document, Joint
from ....plant.contact.plant import SLIPPING
from ....recording.recording import (
    Recording,
    as_columns,
    guided_pose,
    recorded_position,
    trailer_guided,
)
from ....recording.tracking import prismatic_joints
from ....safety import RAMPING, STEPPED_IN, STOPPING
from ....signals import HAND, Array, IntArray
from ...experiments.pushing import handle_way, surface_normal
from ..files import Blob

IncidentKind = Literal["stop", "slip", "limit"]
FAR = 1e6  # a coordinate beyond this is as good as infinite: it is not drawn [m or rad]
MOST_TIPS = 4  # more ends than this are fingers: only the one with the most joints before it is traced
GAP = 0.1  # two stretches that are nearer than this are one [s]
AT_LIMIT = 1 - 1e-6
MOST_FRAMES = 10_000_000  # of a replay, before those without a row are left out


# -- bodies ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MovingBody:
    """A moving body: the root, or what one joint carries."""

    parent: int  # index of the body it hangs on; -1 for the root
    origin: Array  # (4, 4) its placement on the parent with the joint at 0
    joint: Joint | None  # the joint that carries it; None for the root

    def for_page(self, robot: Robot) -> dict[str, Any]:
        """The body as the page reads it; `column` is the joint's place in a position."""
        placed = {"parent": self.parent, "origin": columns(self.origin)}
        if self.joint is None:
            return placed | {"kind": "root"}
        kind = "prismatic" if self.joint.type == "prismatic" else "revolute"
        column = robot.position_names.index(self.joint.name)
        return placed | {"kind": kind, "axis": self.joint.axis.tolist(), "column": column}


@dataclass(frozen=True, eq=False)
class ReplayTree:
    """The bodies of a robot."""

    document: Document  # the URDF
    bodies: list[MovingBody]  # parents before their children
    places: dict[str, tuple[int, Array]]  # for every link the index of its body and its (4, 4) placement on it

    @classmethod
    def of(cls, document: Document) -> ReplayTree:
        """The tree of a URDF whose joints are fixed, revolute, continuous or prismatic."""
        root = document.root_link
        bodies, places = [MovingBody(-1, np.eye(4), None)], {root: (0, np.eye(4))}
        pending = [root]
        while pending:
            link = pending.pop()
            body, place = places[link]
            for joint in document.children[link]:
                at = place @ joint.origin
                places[joint.child] = (len(bodies), np.eye(4)) if joint.moves else (body, at)
                bodies += [MovingBody(body, at, joint)] if joint.moves else []
                pending.append(joint.child)
        return cls(document, bodies, places)

    def tips(self, robot: Robot) -> list[dict[str, Any]]:
        """The tips of a robot's arms, as the page reads them: a body and a point on it [m]."""
        links = robot.hands if len(robot.hands) <= MOST_TIPS else robot.hands[:1]
        return [{"body": self.places[link][0], "point": self.places[link][1][:3, 3].tolist()} for link in links]


def columns(transform: Array) -> list[float]:
    """The 16 numbers of a (4, 4) transform, column after column as three.js has them."""
    return [round(float(number), 9) for number in transform.T.ravel()]


EMPTY = "it ended before its first sample"

# -- frames ------------------------------------------------------------------------------------------------------------


def drawable(table: Array) -> NDArray[np.bool_]:
    """Rows (k,) of a table (k, n) that can be drawn, as truth values."""
    return np.asarray((np.abs(table) < FAR).all(axis=1))


def frames_of(recording: Recording, fps: float) -> IntArray:
    """Rows to show: those nearest to an even grid of times, the first and the last; finite ones only.

    Args:
        recording: The run.
        fps: Frames per second.

    Raises:
        RecordingError: There are none.
    """
    known = [name for name in (("position",) if "position" in recording else ("pose", "q")) if name in recording]
    table = np.hstack([np.zeros((len(recording), 0)), *(as_columns(recording[name]) for name in known)])
    good = np.flatnonzero(drawable(table)) if known else np.array([], int)
    if not len(good):
        why = ("no position in it is finite" if known else "it has no positions") if len(recording) else EMPTY
        raise RecordingError("nothing to replay", why=why, file=recording.path)
    times = recording.time[good]
    if (times[-1] - times[0]) * fps > MOST_FRAMES:  # rows years apart: all of them are fewer
        return good
    grid = np.append(np.arange(times[0], times[-1], 1 / fps), times[-1])
    return good[np.unique(np.searchsorted((times[1:] + times[:-1]) / 2, grid))]


def base_reference(recording: Recording) -> Array:
    """(N, 3) where the base should be: on its reference, or as it stands to a trailer that should be there."""
    asked = recording["pose_ref"]
    if not trailer_guided(recording):
        return asked
    guided = guided_pose(recording)
    turn, (x, y, phi) = asked[:, 2] - guided[:, 2], (recording["pose"] - guided).T
    c, s = np.cos(turn), np.sin(turn)
    return asked + np.column_stack((c * x - s * y, s * x + c * y, phi))


def wanted(recording: Recording, robot: Robot, rows: IntArray) -> Array | None:
    """Positions (k, nv) that the reference asked for; None where the run has none.

    What no reference speaks of (wheels, locked joints) is where the robot has it; mimic joints follow.
    """
    if "q_ref" not in recording and "pose_ref" not in recording:
        return None
    table = recorded_position(recording, robot)[rows]
    if "pose_ref" in recording:
        table[:, :3] = base_reference(recording)[rows]
    if "q_ref" in recording:
        table[:, robot.arm_index] = as_columns(recording["q_ref"])[rows]
    robot.follow(table.T)
    return table if drawable(table).all() else None


def packed(recording: Recording, robot: Robot, rows: IntArray, blob: Blob) -> dict[str, Any]:
    """Frames of a run as the page reads them: times (k,), positions (k, nv), wanted ones or None, hands."""
    position, reference = recorded_position(recording, robot)[rows], wanted(recording, robot, rows)
    return {
        "frames": len(rows),
        "width": position.shape[1],
        "time": blob.add(recording.time[rows], "f4"),
        "position": blob.add(position, "f4"),
        "reference": None if reference is None else blob.add(reference, "f4"),
        "hands": list(hands(recording, rows, blob)),
        "touch": touched(recording, robot, rows, blob),
    }


def hands(recording: Recording, rows: IntArray, blob: Blob) -> Iterator[dict[str, Any]]:
    """Frames that a run took along paths: names, poses (k, 7) that they had and should have had."""
    if "hand" not in recording or "hand_ref" not in recording:
        return
    tables = [recording[name][rows] for name in ("hand", "hand_ref")]
    for i, name in enumerate(recording.meta.get("hands", ())):
        true, wished = (table[:, len(HAND) * i : len(HAND) * (i + 1)] for table in tables)
        if drawable(true).all() and drawable(wished).all():
            yield {"name": name, "pose": blob.add(true, "f4"), "wanted": blob.add(wished, "f4")}


def touched(recording: Recording, robot: Robot, rows: IntArray, blob: Blob) -> dict[str, Any] | None:
    """The things that a hand touches: where (k, 3) with which force (k, 3), surfaces, a door; None without any."""
    things = [one for one in recording.meta.get("disturbances", ()) if one.get("type") in ("surface", "door")]
    if not things or "hand_force" not in recording:
        return None
    chain = chain_of(robot, things[0]["frame"] or hands_of(robot)[0])
    places = track(chain, recorded_position(recording, robot)[rows])[:, 9:]
    start = track(chain, recorded_position(recording, robot)[:1])[0, 9:]
    found: dict[str, Any] = {"surfaces": [], "door": None}
    for one in things:
        if one["type"] == "surface":
            normal = surface_normal(one, recording, robot)
            point = start - one["gap"] * normal if one["at"] is None else np.array(one["at"])
            found["surfaces"].append({"point": point.tolist(), "normal": normal.tolist()})
        else:
            arm = handle_way(recording, one)[1][rows]
            x, y = start[:2] - arm[0, :2]
            found["door"] = {"hinge": [float(x), float(y), float(start[2])], "handle": blob.add(arm[:, :2], "f4")}
    return found | {"forces": blob.add(np.hstack((places, recording["hand_force"][rows])), "f4")}


# -- events ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ReplayEvent:
    """Something to see."""

    kind: IncidentKind  # `stop` (in red), `slip` (in purple) or `limit` (in amber)
    start: float  # when it begins [s]
    end: float  # when it is over [s]; inf for the rest of the replay
    text: str  # one line for people
    joints: tuple[str, ...] = ()  # whose bodies are coloured; the whole robot if empty

    def for_page(self, bodies: dict[str, int]) -> dict[str, Any]:
        """The event as the page reads it; bodies by the name of the joint that carries them."""
        end = self.end if np.isfinite(self.end) else None
        on = [bodies[joint] for joint in self.joints if joint in bodies]
        return {"kind": self.kind, "start": self.start, "end": end, "text": self.text, "bodies": on}


def early_end(recording: Recording) -> Iterator[ReplayEvent]:
    """A run that did not complete: diverged, tripped by the safety layer, or interrupted."""
    outcome = recording.outcome
    if outcome.status != "completed":
        why = outcome.message.partition(";")[0] or f"at t = {outcome.time:.3g} s"
        yield ReplayEvent("stop", outcome.time, np.inf, f"{outcome.status}: {why}")


def supervised(recording: Recording) -> Iterator[ReplayEvent]:
    """Acts of a supervisor: a torque clipped or a value held, and a stop, under feedback or without."""
    if "safety" not in recording:
        return
    state = np.asarray(recording["safety"])
    for kind, code, text in SUPERVISED:
        if code == STOPPING and recording.outcome.status == "tripped":
            continue  # its end says so, with the reason
        for start, end in stretches(recording.time, state == code):
            yield ReplayEvent(kind, start, end, text)


def slipping(recording: Recording) -> Iterator[ReplayEvent]:
    """Wheels that slip, on the contact plant, a stretch of time each."""
    if "slip" not in recording:
        return
    for name, speed in zip(recording.labels("slip"), as_columns(recording["slip"]).T, strict=True):
        for start, end in stretches(recording.time, speed > SLIPPING):
            yield ReplayEvent("slip", start, end, f"{name} slips", (name,))


def at_limits(recording: Recording) -> Iterator[ReplayEvent]:
    """Motors that are asked for their largest torque or more, a stretch of time each."""
    limits = recording.meta.get("effort_limits")
    if limits is None or "motor_torque" not in recording:
        return
    sliding = prismatic_joints(recording.urdf)
    torques = as_columns(recording["motor_torque"]).T
    for name, limit, torque in zip(recording.labels("motor_torque"), limits, torques, strict=True):
        text = f"{name} at its limit of {limit:g} {'N' if name in sliding else 'N m'}"
        for start, end in stretches(recording.time, np.abs(torque) >= AT_LIMIT * limit):
            yield ReplayEvent("limit", start, end, text, (name,))


def stretches(time: Array, holds: NDArray[np.bool_]) -> Iterator[tuple[float, float]]:
    """First and last time of every stretch in which something holds; short pauses are no pauses."""
    rows = np.flatnonzero(holds)
    for part in np.split(rows, np.flatnonzero(np.diff(time[rows]) > GAP) + 1):
        if len(part):
            yield float(time[part[0]]), float(time[part[-1]])


SUPERVISED: tuple[tuple[IncidentKind, float, str], ...] = (
    ("limit", STEPPED_IN, "the supervisor clips a torque or holds a value"),
    ("stop", STOPPING, "the supervisor stops the robot"),
    ("stop", RAMPING, "stopped without feedback: the torque goes to zero"),
)
SOURCES: tuple[Callable[[Recording], Iterator[ReplayEvent]], ...] = (early_end, supervised, slipping, at_limits)


def events_of(recording: Recording) -> list[ReplayEvent]:
    """All events of a run, as they began."""
    return sorted((event for source in SOURCES for event in source(recording)), key=lambda event: event.start)
