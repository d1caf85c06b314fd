"""The door: what every measurement passes before anything else reads it.

Numbers that are not finite are refused. An angle of an encoder that wraps, whatever its seam, goes on without turning
over: it is moved by whole turns to where its last velocity leads. A joint with ends is first moved between them where
whole turns can do that. What of a joint's change no speed explains is a jump: it trips, and is taken out for good, so
that all that follows, a stop too, sees a position that goes on from the last one that could be true.
"""

from __future__ import annotations

import math

from ..compiled import compiled, copy_to, internal, linked
from ..elementary import cos_sin, nearest_turn
from ..signals import INDEX, Array, IntArray
from .supervisor import (
    ACTED,
    ARRIVED,
    BAD,
    BLIND,
    COMMANDED,
    FRESH,
    GIVEN_UP,
    GOOD,
    HAS_TRIPPED,
    HEARD,
    HELD,
    JUMPED,
    LIMIT,
    PERIOD,
    PLAUSIBLE,
    Supervisor,
    trip,
)

POSE, QDOT = INDEX["pose"], INDEX["qdot"]
NEAR = (
    0.01  # a joint this far beyond an end is there [rad]; farther, it is read a turn away if that is between its ends
)
MEMORY = 0.2  # over which positions and velocities are compared [s]


@linked
def accept(row: Array, at: IntArray, time: float, now: float, is_new: bool, supervisor: Supervisor) -> None:
    """Take a measurement that came in; one that is not finite is refused, and the last good one stays.

    Args:
        row: (width,) row of signals with pose, velocity, q, qdot as received; afterwards as they are taken.
        at: Offsets of the signals.
        time: When it was measured [s].
        now: When it came [s].
        is_new: Whether it is another one than last time.
        supervisor: The supervisor.
    """
    state, message, measured, fine = supervisor.state, supervisor.message, row[at[POSE] : at[QDOT + 1]], True
    for i in range(measured.size):
        fine = fine and math.isfinite(measured[i])
    state[HELD] = 0.0 if fine else 1.0
    if fine and is_new:
        if state[GOOD] == 0.0:
            for i in range(supervisor.turn.size):
                q = measured.size - 2 * supervisor.turn.size + i
                measured[q] = between_ends(measured[q], i, supervisor)
        else:
            go_on(measured, time, now, supervisor)
        copy_to(measured, message)
        state[HEARD], state[ARRIVED], state[GOOD] = time, now, state[GOOD] + 1.0
    elif fine:
        copy_to(message, measured)
    else:
        state[BAD] += is_new
        copy_to(message, measured)


def release(time: float, supervisor: Supervisor) -> bool:
    """Forget a trip, so that the controller is asked again; false, and nothing done, without a fresh measurement.

    Joints are where they are read then, jumps included.
    """
    state, n = supervisor.state, supervisor.turn.size
    if state[GOOD] == 0.0 or time - state[ARRIVED] > supervisor.numbers[FRESH]:
        return False
    state[HAS_TRIPPED : LIMIT + 1] = 0.0
    state[COMMANDED], state[ACTED], state[BLIND], state[GIVEN_UP], state[PERIOD] = time, 0.0, -1.0, 0.0, 0.0
    for i in range(n):
        q = supervisor.message.size - 2 * n + i
        if supervisor.offset[i] != 0.0:
            supervisor.message[q] = between_ends(supervisor.message[q] - supervisor.offset[i], i, supervisor)
    for part in (supervisor.above, supervisor.integral, supervisor.stale, supervisor.offset):
        part[:] = 0.0
    for part in (supervisor.drift, supervisor.lost):
        part[:] = 0.0
    return True


@compiled
def between_ends(q: float, i: int, supervisor: Supervisor) -> float:
    """The position of a joint, moved by whole turns between its ends where that is possible."""
    lower, upper = supervisor.ends[0, i], supervisor.ends[1, i]
    if supervisor.turn[i] == 0.0 or lower - NEAR <= q <= upper + NEAR:
        return q
    moved = nearest_turn(q, 0.5 * (lower + upper))
    return moved if lower <= moved <= upper else q


@internal
def go_on(measured: Array, time: float, now: float, supervisor: Supervisor) -> None:
    """Take whole turns and jumps out of what was measured after another measurement, and compare it with velocities.

    Args:
        measured: (m,) pose, velocity, q, qdot.
        time: When [s].
        now: When it came [s].
        supervisor: The supervisor.
    """
    message, n, state = supervisor.message, supervisor.turn.size, supervisor.state
    first, dt = measured.size - 2 * n, max(time - state[HEARD], 0.0)
    nb = supervisor.gains.size - n
    keep = max(0.0, 1.0 - dt / MEMORY)
    if nb > 0:
        ahead = min(max(dt * message[first - 1], -math.pi), math.pi)
        measured[2] = nearest_turn(measured[2], message[2] + ahead)
        if math.isfinite(supervisor.contradiction[0]):
            compare_base(measured, dt, keep, nb, supervisor)
    for i in range(n):
        q, qdot = first + i, first + n + i
        most = supervisor.fastest[i]
        if not math.isfinite(supervisor.speed[nb + i]):  # a joint that may be as fast as it likes
            most = max(most, max(abs(measured[qdot]), abs(message[qdot])))
        before = min(max(message[qdot], -most), most)
        after = min(max(measured[qdot], -most), most)
        if supervisor.offset[i] != 0.0:
            measured[q] += supervisor.offset[i]
        if supervisor.turn[i] > 0.0:
            measured[q] = nearest_turn(measured[q], message[q] + dt * before)
        jump, explained = measured[q] - message[q], supervisor.jump[i] + PLAUSIBLE * most * dt
        if abs(jump) > explained:
            trip(now, JUMPED, i, abs(jump), explained, state)
            supervisor.offset[i] -= jump
            measured[q] = message[q]
        step = measured[q] - message[q] - 0.5 * dt * (before + after)
        supervisor.drift[nb + i] = keep * (supervisor.drift[nb + i] + step)


@internal
def compare_base(measured: Array, dt: float, keep: float, nb: int, supervisor: Supervisor) -> None:
    """By how much the pose of the base has lately changed more than its velocities say."""
    message, drift = supervisor.message, supervisor.drift
    c, s = cos_sin(message[2])
    x, y = measured[0] - message[0], measured[1] - message[1]
    for i in range(nb):
        step = measured[2] - message[2]
        if i == 0:
            step = c * x + s * y
        elif i == 1 and nb == 3:
            step = c * y - s * x
        drift[i] = keep * (drift[i] + step - 0.5 * dt * (message[3 + i] + measured[3 + i]))
