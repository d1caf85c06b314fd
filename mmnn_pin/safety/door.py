"""The door: what every measurement passes before anything else reads it.

Numbers that are not finite are refused. An angle of an encoder that wraps, whatever its seam, goes on without turning
over: it is moved by whole turns to where its last velocity leads. A joint with ends is first moved between them where
whole turns can do that. What of a joint's change no speed explains is a jump: it trips, and is taken out for good, so
that all that follows, a stop too, sees a position that goes on from the last one that could be true. Angles of a base
that steers are taken as those of joints; which measurement has no rates of.
"""

from __future__ import annotations

import math

from ..compiled import compiled, copy_to, internal, linked
from ..elementary import cos_sin, nearest_turn
from ..signals import EARLY, INDEX, Array, IntArray
from .supervisor import (
    CONTRADICTION,
    DRIFT,
    EXPLAINS,
    IS_FREE,
    JUMP,
    JUMPED,
    LOWER,
    OFFSET,
    PLAUSIBLE,
    RARE,
    SAME,
    SMOOTH,
    STEP,
    TURN,
    UPPER,
    USUAL,
    WITHOUT,
    Door,
    Supervisor,
    trip,
)

POSE, SHAPE = INDEX["pose"], INDEX["shape"]
NEAR = 0.01  # a joint this far beyond an end is there; farther, it is read a turn away if it can be [rad]
FARTHEST = 8.0 * math.pi  # that a base is taken to turn between two measurements [rad]
MEMORY = 0.2  # over which positions and velocities are compared [s]


@linked
def accept(row: Array, at: IntArray, time: float, now: float, is_new: bool, door: Door) -> None:
    """Take a measurement that came in; one that is not finite is refused, and the last good one stays.

    Args:
        row: (width,) row of signals with pose, velocity, q, qdot, shape as received; afterwards as they are taken.
        at: Offsets of the signals.
        time: When it was measured [s].
        now: When it came [s].
        is_new: Whether it is another one than last time.
        door: The supervisor's.
    """
    state, message, measured, fine = door.state, door.message, row[at[POSE] : at[SHAPE + 1]], True
    for i in range(measured.size):
        fine = fine and math.isfinite(measured[i])
    state.held[0] = 0.0 if fine else 1.0
    if not fine or not is_new:
        if not fine and is_new:
            state.bad[0] += 1.0
        copy_to(message, measured)
        return
    if state.good[0] > 0.0:
        go_on(measured, time, now, door)
    else:
        for i in range(door.joints.shape[1]):
            place = place_of(i, measured, door)
            measured[place] = between_ends(measured[place], i, door)
    if time != state.heard[0] and state.news[0] < 2.0:
        state.news[0] += 2.0
    copy_to(measured, message)
    state.heard[0], state.arrived[0], state.good[0] = time, now, state.good[0] + 1.0


def release(time: float, supervisor: Supervisor) -> bool:
    """Forget a trip, so that the controller is asked again; false, and nothing done, without a fresh measurement.

    Joints are where they are read then, jumps included.
    """
    state, door = supervisor.state, supervisor.door
    if state.good[0] == 0.0 or time - state.arrived[0] > supervisor.numbers.fresh:
        return False
    state.tripped[0], state.commanded[0], state.acted[0], state.period[0] = 0.0, time, 0.0, 0.0
    for i in range(door.joints.shape[1]):
        q, j = place_of(i, door.message, door), door.sense.shape[1] - door.joints.shape[1] + i
        if door.sense[OFFSET, j] != 0.0:
            door.message[q] = between_ends(door.message[q] - door.sense[OFFSET, j], i, door)
    for k in range(supervisor.shake.shape[0]):
        for j in range(supervisor.shake.shape[1]):
            supervisor.shake[k, j] = 0.0
    supervisor.above[:] = 0.0
    for i in range(door.sense.shape[1]):
        door.sense[DRIFT, i], door.sense[WITHOUT, i], door.sense[OFFSET, i] = 0.0, 0.0, 0.0
    return True


@compiled
def place_of(i: int, message: Array, door: Door) -> int:
    """Place in a message of the position of joint i of the door: of the arm, then of the pivots."""
    pivots = door.sense.shape[1] - door.rows.shape[1]
    n = door.joints.shape[1] - pivots
    return int(message.size - pivots - 2 * n + i + (n if i >= n else 0))


@compiled
def between_ends(q: float, i: int, door: Door) -> float:
    """The position of a joint, moved by whole turns between its ends where that is possible."""
    lower, upper = door.joints[LOWER, i], door.joints[UPPER, i]
    if door.joints[TURN, i] == 0.0 or lower - NEAR <= q <= upper + NEAR:
        return q
    moved = nearest_turn(q, 0.5 * (lower + upper))
    return moved if lower <= moved <= upper else q


@internal
def go_on(measured: Array, time: float, now: float, door: Door) -> None:
    """Take whole turns and jumps out of what was measured after another measurement, and compare it with velocities.

    Args:
        measured: (m,) pose, velocity, q, qdot, shape.
        time: When [s].
        now: When it came [s].
        door: The supervisor's.
    """
    message, joints, sense, every = door.message, door.joints, door.sense, door.joints.shape[1]
    n = every - (sense.shape[1] - door.rows.shape[1])
    nb, passed = door.rows.shape[1] - n, max(time - door.state.heard[0], 0.0)
    if nb > 0:
        turning = door.eta[2] if door.eta.size else message[2 + nb]
        ahead = min(max(passed * turning, -FARTHEST), FARTHEST)
        measured[2] = nearest_turn(measured[2], message[2] + ahead)
        take_base(measured, passed, nb, door)
    for i in range(every):
        q, j, most, before, after = place_of(i, measured, door), nb + i, joints[EXPLAINS, i], 0.0, 0.0
        measured[q] += sense[OFFSET, j]
        if i < n:
            before, after = message[q + n], measured[q + n]
        if joints[IS_FREE, i] > 0.0:
            most = max(most, max(abs(after), abs(before)))
        most *= PLAUSIBLE
        near = nearest_turn(measured[q], message[q]) if joints[TURN, i] > 0.0 else measured[q]
        dt = since_then(j, passed, near == message[q], near - message[q], before, after, door)
        before, after = min(max(before, -most), most), min(max(after, -most), most)
        if joints[TURN, i] > 0.0:
            measured[q] = nearest_turn(measured[q], message[q] + dt * before)
        jump, explained = measured[q] - message[q], joints[JUMP, i] + most * dt
        if abs(jump) > explained:
            trip(now, JUMPED, i, abs(jump), explained, door.state)
            sense[OFFSET, j] -= jump
            measured[q] = message[q]
        drift(j, measured[q] - message[q], before, after, dt, sense)


@internal
def since_then(i: int, passed: float, stays: bool, moved: float, before: float, after: float, door: Door) -> float:
    """How long ago position or velocity i was measured last [s]; 0 where it is the same and its time may be, too.

    It is the same where both stay, to the last bit, or the position goes back and forth between two values. A
    measurement is as old as its oldest part: what changed while its time stood has the age of its last change. Learns
    how old that usually gets: more at once, less by and by.
    """
    sense, age = door.sense, door.sense[SAME, i]
    same = (stays and before == after) or (moved == -sense[STEP, i] and moved != 0.0)
    sense[STEP, i] = moved
    is_known = passed > 0.0 and (age == 0.0 or age > door.state.waited[0] - EARLY)
    if not same:
        if before != 0.0:  # what rests says nothing of how often it is measured
            lasted = min(age, RARE)
            sense[USUAL, i] = max(lasted, sense[USUAL, i] + SMOOTH * (lasted - sense[USUAL, i]))
        sense[SAME, i] = 0.0
        if door.state.news[0] != 1.0 and door.state.news[0] != 3.0:
            door.state.news[0] += 1.0
    return passed if is_known else 0.0 if same else age


@internal
def drift(i: int, step: float, before: float, after: float, dt: float, sense: Array) -> None:
    """By how much position i has lately changed more than its velocities say, a step after."""
    sense[DRIFT, i] = max(0.0, 1.0 - dt / MEMORY) * (sense[DRIFT, i] + unexplained(step, dt * before, dt * after))


@internal
def take_base(measured: Array, passed: float, nb: int, door: Door) -> None:
    """Compare the pose of the base with its velocities."""
    message, sense = door.message, door.sense
    c, s = cos_sin(message[2])
    x, y, last = (
        measured[0] - message[0],
        measured[1] - message[1],
        measured.size - (sense.shape[1] - door.rows.shape[1]),
    )
    turned = measured[2] - message[2]
    for i in range(nb):
        step, stays, moved = turned, x == 0.0 and y == 0.0 and turned == 0.0, x + y + turned
        if door.masters.size and i >= nb - door.masters.size:
            place = last + door.masters[i - (nb - door.masters.size)]
            step = measured[place] - message[place]
            stays, moved = step == 0.0, step
        elif door.eta.size:
            step = share_of(c * x + s * y, c * y - s * x, step, i, door)
        elif i == 0:
            step = c * x + s * y
        elif i == 1 and door.sideways:
            step = c * y - s * x
        before, after = message[3 + i], measured[3 + i]
        dt = since_then(i, passed, stays, moved, before, after, door)
        if math.isfinite(door.rows[CONTRADICTION, 0]):
            drift(i, step, before, after, dt, sense)


@compiled
def share_of(ahead: float, aside: float, turned: float, i: int, door: Door) -> float:
    """Share of base velocity i in a step of the control frame, `n' W step / n' W n`."""
    n, W = door.along, door.length * door.length
    size2 = n[0, i] * n[0, i] + n[1, i] * n[1, i] + W * n[2, i] * n[2, i]
    return (n[0, i] * ahead + n[1, i] * aside + W * n[2, i] * turned) / size2


@compiled
def unexplained(step: float, one: float, other: float) -> float:
    """By how much a step is beyond those of the first and of the last velocity."""
    return step - min(max(step, min(one, other)), max(one, other))
