"""One measurement of a robot by its encoders, compiled.

Every encoder reads an angle: `step * round((angle + offset + noise) / step)`. Rates of the joints and of the wheels
come from the true velocity, from differences of readings, from a filtered derivative or from a tracking observer; the
base's velocity is the least-squares solution over its wheels, and odometry integrates their increments. A reading
leaves through a line that delays, jitters and loses messages; what was received last is held.
"""

from __future__ import annotations

import math

from ..compiled import compiled
from ..model.base.holonomic import moves_sideways
from ..signals import INDEX, Array, IntArray

POSE, VELOCITY, Q, QDOT = INDEX["pose"], INDEX["velocity"], INDEX["q"], INDEX["qdot"]

TRUE, DIFFERENCE, FILTERED, OBSERVER = 0, 1, 2, 3
VELOCITIES = {"true": TRUE, "difference": DIFFERENCE, "filtered": FILTERED, "observer": OBSERVER}

# Numbers: how velocities are made, whether the pose is odometry, period, two coefficients of the derivative, delay and
# jitter in measurements, probability of a loss, length of the line; from PER_ENCODER on step, offset and noise of every
# encoder, then noise of the velocities (nb + n) and of the pose.
MODE, ODOMETRY, PERIOD, ALPHA, BETA, DELAY, JITTER, LOSS, DEPTH, PER_ENCODER = range(10)
# Memory: number of measurements so far, number of the one received last; from STATES on reading, its increment,
# estimate and rate of every encoder, the odometry's pose, what was received last, the line.
COUNT, RECEIVED, STATES = 0, 1, 2
READING, MOVED, ESTIMATE, RATE = 0, 1, 2, 3


@compiled
def measure(
    row: Array,
    at: IntArray,
    position: Array,
    nu: Array,
    encoders: IntArray,
    W: Array,
    numbers: Array,
    noise: Array,
    state: Array,
) -> None:
    """Take a measurement and write the one received last to the row: pose, velocity, q, qdot.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        position: (nv,) true position.
        nu: (p,) true velocity.
        encoders: (nw + n,) places in the position that are measured: wheels, then arm joints.
        W: (nb, nw) base velocity from the rates of the wheels; (nb, 0) if no wheel is measured.
        numbers: Settings, see above.
        noise: (nw + n + nb + n + pose + 4,) standard normal numbers for encoders, velocities and pose, two uniform ones
            for jitter and loss, then how many measurements later still the message is (negative: lost), and what is
            added to all its numbers.
        state: See above; all zero before the first measurement.
    """
    first, count = state[COUNT] == 0.0, int(state[COUNT])
    for i in range(encoders.size):
        read(i, position[encoders[i]], first, encoders.size, numbers, noise, state)
    size = at[QDOT + 1] - at[POSE]
    sent = STATES + 4 * encoders.size + at[POSE + 1] - at[POSE]
    lines = sent + size
    depth = int(numbers[DEPTH])
    slot = lines + (count % depth) * size
    compose(state[slot : slot + size], at, position, nu, encoders.size, W, numbers, noise, state, first)
    jitter, chance, late, added = (
        noise[noise.size - 4],
        noise[noise.size - 3],
        noise[noise.size - 2],
        noise[noise.size - 1],
    )
    if added != 0.0:  # or not a number
        for i in range(size):
            state[slot + i] += added
    arrived = count - int(numbers[DELAY]) - int(jitter * (numbers[JITTER] + 1.0)) - int(late)
    state[COUNT] = count + 1.0
    if first or (chance >= numbers[LOSS] and late >= 0.0 and arrived > state[RECEIVED]):
        state[RECEIVED] = max(arrived, 0)
        slot = lines + (max(arrived, 0) % depth) * size
        for i in range(size):
            state[sent + i] = state[slot + i]
    for i in range(size):
        row[at[POSE] + i] = state[sent + i]


@compiled
def read(i: int, angle: float, first: bool, size: int, numbers: Array, noise: Array, state: Array) -> None:
    """Reading of encoder i, its increment, and the rate made from it."""
    step = numbers[PER_ENCODER + i]
    angle += numbers[PER_ENCODER + size + i] + numbers[PER_ENCODER + 2 * size + i] * noise[i]
    if step > 0.0:
        angle = step * math.floor(angle / step + 0.5)
    at = STATES + 4 * i
    if first:
        state[at + READING], state[at + MOVED], state[at + ESTIMATE], state[at + RATE] = angle, 0.0, angle, 0.0
        return
    state[at + MOVED] = angle - state[at + READING]
    state[at + READING] = angle
    if int(numbers[MODE]) == OBSERVER:
        predicted = state[at + ESTIMATE] + numbers[PERIOD] * state[at + RATE]
        state[at + ESTIMATE] = predicted + numbers[ALPHA] * (angle - predicted)
        state[at + RATE] += numbers[BETA] * (angle - predicted)
    else:  # plain differences with ALPHA = 1
        state[at + RATE] += numbers[ALPHA] * (state[at + MOVED] / numbers[PERIOD] - state[at + RATE])


@compiled
def compose(
    out: Array,
    at: IntArray,
    position: Array,
    nu: Array,
    size: int,
    W: Array,
    numbers: Array,
    noise: Array,
    state: Array,
    first: bool,
) -> None:
    """Pose, velocity, q and qdot from what the encoders have read, written to out; arguments as in `measure`."""
    nb, nw = W.shape
    pose, exact = at[POSE + 1] - at[POSE], int(numbers[MODE]) == TRUE
    spread, pose_at = PER_ENCODER + 3 * size, STATES + 4 * size
    for i in range(nb + size - nw):
        rate = nu[i]
        if not exact and i < nb:
            rate = 0.0
            for j in range(nw):
                rate += W[i, j] * state[STATES + 4 * j + RATE]
        elif not exact:
            rate = state[STATES + 4 * (nw + i - nb) + RATE]
        out[pose + i + (0 if i < nb else size - nw)] = rate + numbers[spread + i] * noise[size + i]
    for i in range(size - nw):
        out[pose + nb + i] = state[STATES + 4 * (nw + i) + READING]
    spread, shift = spread + nb + size - nw, size + nb + size - nw
    if pose:
        if first or numbers[ODOMETRY] == 0.0:
            for i in range(3):
                state[pose_at + i] = position[i]
        else:
            drive(W, state, pose_at)
        for i in range(3):
            out[i] = state[pose_at + i] + numbers[spread + i] * noise[shift + i]


@compiled
def drive(W: Array, state: Array, pose_at: int) -> None:
    """Move the odometry's pose on by what the wheels have turned, along the chord of the arc (its middle heading)."""
    ahead = aside = turn = 0.0
    for j in range(W.shape[1]):
        moved = state[STATES + 4 * j + MOVED]
        ahead += W[0, j] * moved
        turn += W[W.shape[0] - 1, j] * moved
        if moves_sideways(W.shape[0]):
            aside += W[1, j] * moved
    heading = state[pose_at + 2] + 0.5 * turn
    c, s = math.cos(heading), math.sin(heading)
    state[pose_at] += c * ahead - s * aside
    state[pose_at + 1] += s * ahead + c * aside
    state[pose_at + 2] += turn


def noise_columns(encoders: int, velocities: int, pose: int) -> int:
    """Numbers that one measurement takes besides the truth: normal ones, two uniform ones, two of disturbances."""
    return encoders + velocities + pose + 4
