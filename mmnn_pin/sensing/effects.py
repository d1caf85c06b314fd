"""Effects on a measurement on its way from the robot to the controller: one class per effect, compiled.

It passes through them in this order:

    truth ─▶ encoders ─▶ rates ─▶ velocities ─▶ odometry ─▶ noise ─▶ line ─▶ controller

Every encoder reads an angle, `step * round((angle + offset + noise) / step)`. Rates of the joints and of the wheels are
made of the readings; the base's velocity is the least-squares solution over its wheels, and odometry integrates their
increments. A base that steers has encoders on its pivots, too: its rows are those of T at the angles that they read. A
message leaves through a line that delays, jitters and loses it; what was received last is held. The loop
puts before them what motors and faults do to the encoders (`MotorSide` of the loop's hardware, `FrozenEncoders`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from ..by_address import by_address
from ..compiled import copy_to, internal, linked
from ..elementary import cos_sin
from ..elementary.matrices import product
from ..model.base.rolling import Maps, Rolling, roll
from ..model.reduction import shares
from ..parts import view
from ..signals import EARLY, INDEX, Array, IntArray, Measurement

POSE, VELOCITY, Q, QDOT, SHAPE = (INDEX[name] for name in ("pose", "velocity", "q", "qdot", "shape"))
# State of the line: measurements so far, number of the one received last. State of an encoder: its reading, how far
# that has moved since the one before, a tracked angle and the rate.
COUNT, RECEIVED, CLOCK = range(3)
READING, MOVED, ESTIMATE, RATE, COLUMNS = range(5)


@linked
def exact(row: Array, at: IntArray, position: Array, nu: Array, places: IntArray) -> None:
    """Exact measurement of pose, base velocity, arm joints and their rates, and of the pivots of a base that steers.

    Args:
        row: (width,) row of signals; pose, velocity, q, qdot, shape are written.
        at: Offsets of the signals.
        position: (nv,) true position.
        nu: (p,) true velocity.
        places: (n + shape,) of the arm joints in the position, then of the pivots.
    """
    shape = view(row, at, SHAPE)
    pose, velocity, q, qdot = (view(row, at, POSE), view(row, at, VELOCITY), view(row, at, Q), view(row, at, QDOT))
    for i in range(pose.size):
        pose[i] = position[i]
    for i in range(velocity.size):
        velocity[i] = nu[i]
    for i in range(q.size):
        q[i] = position[places[i]]
        qdot[i] = nu[velocity.size + i]
    for i in range(shape.size):
        shape[i] = position[places[q.size + i]]


@by_address
class Reading(NamedTuple):
    """The signal from the robot to the controller; the effects change it one after the other."""

    position: Array  # (nv,) true position, on which the encoders sit
    nu: Array  # (p,) true velocity
    clock: Array  # (CLOCK,) state: how many measurements there were, and which was received last
    joints: Array  # (nw + n, COLUMNS) state of the encoders: of wheels and pivots, then of the arm
    message: Array  # what is sent: pose, base velocity, q, qdot, angles of the pivots
    received: Array  # (the same,) what the controller has
    # (p,) state: what the loop expects of nu until the next sample [m/s^2, rad/s^2]; (0,) where nothing is made of it
    acceleration: Array
    bias: Array  # (nw + n,) state: by how much the encoders accelerate beyond that [rad/s^2]; (0,) likewise
    pivots: int  # number of pivots


@by_address
class Sensors(NamedTuple):
    """The sensors of one run: time between two measurements [s], what they pass on, and the effects."""

    period: float
    wire: Reading
    effects: tuple[Any, ...]


@by_address
class FrozenEncoders(NamedTuple):
    """Encoders that keep their reading for a while."""

    windows: Array  # (k, 4) place in the position, start and end [s], place in nu, negative for a wheel
    held: Array  # (k,) state: what they keep

    @internal
    def act(self, wire: Reading, k: int, time: float) -> None:
        """Put what they keep in place of the truth."""
        for i in range(self.windows.shape[0]):
            window, joint = self.windows[i], int(self.windows[i, 0])
            if wire.clock[COUNT] == 0.0 or time + EARLY < window[1] or time + EARLY >= window[2]:
                self.held[i] = wire.position[joint]
            else:
                wire.position[joint] = self.held[i]
                if window[3] >= 0.0:
                    wire.nu[int(window[3])] = 0.0


@by_address
class Encoders(NamedTuple):
    """Readings in whole steps of angles with an offset and noise."""

    places: IntArray  # (nw + n,) of the encoders in the position
    step: Array  # (nw + n,) resolution, 0 for none [rad or m]
    offset: Array  # (nw + n,) zero error [rad or m]
    spread: Array  # (nw + n,) standard deviation of the noise [rad or m]
    normals: Array  # (measurements, nw + n) standard normal numbers

    @internal
    def act(self, wire: Reading, k: int, time: float) -> None:
        """Read all encoders."""
        for i in range(self.places.size):
            angle = wire.position[self.places[i]] + (self.offset[i] + self.spread[i] * self.normals[k, i])
            if self.step[i] > 0.0:
                angle = self.step[i] * math.floor(angle / self.step[i] + 0.5)
            wire.joints[i, MOVED] = 0.0 if wire.clock[COUNT] == 0.0 else angle - wire.joints[i, READING]
            wire.joints[i, READING] = angle


@by_address
class SteeredRows(NamedTuple):
    """The rows by which wheels and pivots of a base that steers tell of its motion, at the angles that are read."""

    rolling: Rolling  # the base
    maps: Maps  # its maps
    places: IntArray  # (nw,) of its encoders in the position: of the wheels, then of the pivots
    position: Array  # (nv,) scratch
    still: Array  # (p,) zeros
    scratch: Array  # (2, nb, nb)
    shares: Array  # (nw, nb) scratch
    rolls: Array  # (nw, nb) written, see `Rates`
    # (nb, nw) written, see `Velocities`: half way between this reading and the one before, as their difference is
    W: Array
    path: Array  # (3, nw) written, see `WheelOdometry`: likewise

    @internal
    def act(self, wire: Reading, k: int, time: float) -> None:
        """Write the rows."""
        nw, nb = self.rolls.shape
        first = nw - wire.pivots
        for i in range(first, nw):
            self.position[self.places[i]] = wire.joints[i, READING] - 0.5 * wire.joints[i, MOVED]
        roll(self.rolling, self.position, self.still, self.maps)
        shares(self.maps.T, self.places, self.scratch, self.shares)
        for j in range(nw):
            for a in range(nb):
                self.W[a, j] = self.shares[j, a]
            for i in range(3):
                self.path[i, j] = 0.0
                for a in range(nb):
                    self.path[i, j] += self.maps.V[0, i, a] * self.shares[j, a]
        for i in range(first, nw):
            self.position[self.places[i]] = wire.joints[i, READING]
        roll(self.rolling, self.position, self.still, self.maps)
        for j in range(nw):
            for a in range(nb):
                self.rolls[j, a] = self.maps.T[self.places[j], a]


@by_address
class Rates(NamedTuple):
    """Rates from readings: differences and their first-order filter, or an observer that tracks angle and rate.

    The observer on a model is told an acceleration a, and learns what is missing of it, b. It is the Kalman filter of
    an angle whose acceleration is known but for a random walk, its three poles p made equal (the alpha-beta-gamma
    filter of fading memory: Morrison 1969, Introduction to Sequential Smoothing and Prediction),

        x + h v + h^2/2 (a + b) + (1 - p^3) i,    v + h (a + b) + 3/2 (1 - p)^2 (1 + p) i / h,    b + (1 - p)^3 i / h^2

    with i the reading less what was expected. Without a model a and b are zero.
    """

    observer: bool  # whether it is the observer
    period: float  # between two measurements [s]
    alpha: float  # share of a new difference, 1 for plain ones; or the observer's correction of the angle
    beta: float  # the observer's correction of the rate [1/s]
    gamma: float  # of the acceleration that is missing [1/s^2]
    rolls: Array  # (nw, nb) rates of wheels and pivots from the base's velocity

    @internal
    def act(self, wire: Reading, k: int, time: float) -> None:
        """Rates of wheels and joints."""
        nw, nb = self.rolls.shape
        for i in range(wire.joints.shape[0]):
            joint, change = wire.joints[i], 0.0
            if wire.clock[COUNT] == 0.0:
                joint[ESTIMATE], joint[RATE] = joint[READING], 0.0
            elif self.observer:
                if wire.bias.size:
                    expected = wire.bias[i]
                    for j in range(nb if i < nw else 0):
                        expected += self.rolls[i, j] * wire.acceleration[j]
                    if i >= nw:
                        expected += wire.acceleration[nb + i - nw]
                    change = self.period * expected
                predicted = joint[ESTIMATE] + self.period * (joint[RATE] + 0.5 * change)
                off = joint[READING] - predicted
                joint[ESTIMATE] = predicted + self.alpha * off
                joint[RATE] += change + self.beta * off
                if wire.bias.size:
                    wire.bias[i] += self.gamma * off
            else:
                joint[RATE] += self.alpha * (joint[MOVED] / self.period - joint[RATE])


@by_address
class Velocities(NamedTuple):
    """The message's velocities and joint positions."""

    exact: bool  # whether velocities are the true ones
    W: Array  # (nb, nw) base velocity from the rates of wheels and pivots; (nb, 0) if no wheel is measured
    place: int  # column of the encoders' state that is sent as q: `READING`, or the observer's `ESTIMATE`

    @internal
    def act(self, wire: Reading, k: int, time: float) -> None:
        """Write base velocity, q, qdot and the angles of the pivots."""
        nb, nw = self.W.shape
        n, last = wire.joints.shape[0] - nw, wire.message.size - wire.pivots
        pose = last - nb - 2 * n
        for i in range(nb):
            rate = wire.nu[i]
            if not self.exact:
                rate = 0.0
                for j in range(nw):
                    rate += self.W[i, j] * wire.joints[j, RATE]
            wire.message[pose + i] = rate
        for i in range(n):
            wire.message[pose + nb + i] = wire.joints[nw + i, self.place]
            wire.message[pose + nb + n + i] = wire.nu[nb + i] if self.exact else wire.joints[nw + i, RATE]
        for i in range(wire.pivots):
            wire.message[last + i] = wire.joints[nw - wire.pivots + i, self.place]


def observe(sensors: Sensors, seen: Measurement, received: Array) -> None:
    """Put what an observer says in place of a measurement that no sensor here has made: of a robot, not simulated.

    Args:
        sensors: With the observer; wheels turn as the base's velocity says.
        seen: Base velocity and angles, as measured.
        received: Pose, base velocity, q, qdot and shape, of which all but the pose is overwritten.
    """
    wire, nw = sensors.wire, sensors.wire.joints.shape[0] - seen.q.size
    wheels, pose = nw - seen.shape.size, seen.pose.size
    wire.joints[wheels:nw, READING], wire.joints[nw:, READING] = seen.shape, seen.q
    for effect in sensors.effects:
        if isinstance(effect, Rates):
            wire.joints[:wheels, READING] += sensors.period * product(effect.rolls[:wheels], seen.velocity)
        if isinstance(effect, SteeredRows | Rates | Velocities):
            effect.act(wire, 0, 0.0)
    wire.clock[COUNT] += 1.0
    received[pose:] = wire.message[pose:]


@by_address
class WheelOdometry(NamedTuple):
    """The pose: the true one, or integrated from the wheels along the chord of the arc (its middle heading)."""

    integrated: bool  # whether it is integrated; the first one is true
    path: Array  # (3, nw) `(vx, vy, w)` of the control frame from the rates of wheels and pivots
    pose: Array  # (3,) state; (0,) for a fixed arm

    @internal
    def act(self, wire: Reading, k: int, time: float) -> None:
        """Write the pose."""
        if self.pose.size:
            if self.integrated and wire.clock[COUNT] != 0.0:
                ahead = aside = turn = 0.0
                for j in range(self.path.shape[1]):
                    moved = wire.joints[j, MOVED]
                    ahead += self.path[0, j] * moved
                    aside += self.path[1, j] * moved
                    turn += self.path[2, j] * moved
                heading = self.pose[2] + 0.5 * turn
                c, s = cos_sin(heading)
                self.pose[0] += c * ahead - s * aside
                self.pose[1] += s * ahead + c * aside
                self.pose[2] += turn
            else:
                copy_to(wire.position, self.pose)
            for i in range(3):
                wire.message[i] = self.pose[i]


@by_address
class Noise(NamedTuple):
    """Noise of velocities and pose as they are sent."""

    velocity: Array  # (p,) standard deviations [m/s, rad/s]
    pose: Array  # (3,) or (0,) standard deviations [m, m, rad]
    velocity_normals: Array  # (measurements, p) standard normal numbers
    pose_normals: Array  # (measurements, 3) or (measurements, 0)

    @internal
    def act(self, wire: Reading, k: int, time: float) -> None:
        """Add it to the message."""
        p, pose = self.velocity.size, self.pose.size
        n = wire.message.size - pose - p - wire.pivots
        for i in range(p):
            wire.message[pose + i + (0 if i < p - n else n)] += self.velocity[i] * self.velocity_normals[k, i]
        for i in range(pose):
            wire.message[i] += self.pose[i] * self.pose_normals[k, i]


@by_address
class MessageLine(NamedTuple):
    """The line to the controller: messages are late, out of order, lost or corrupted, and the newest one counts."""

    delay: int  # measurements by which every message is late
    jitter: int  # largest further delay, equally likely
    loss: float  # probability that a message is lost
    uniforms: Array  # (measurements, 2) numbers in [0, 1) for jitter and loss
    faults: Array  # (measurements, 2) how many measurements later still, negative for lost, and what is added
    of_base: int  # how many numbers tell of the base, the first of a message: its pose and velocity
    every: int  # measurements from one time that these are new to the next
    base_late: int  # measurements by which they are later than the rest
    slots: Array  # (longest delay + 1, message) state: what is under way

    @internal
    def act(self, wire: Reading, k: int, time: float) -> None:
        """Send the message off, and receive what has come."""
        count, late, added = int(wire.clock[COUNT]), self.faults[k, 0], self.faults[k, 1]
        slot, before = self.slots[count % self.slots.shape[0]], self.slots[(count - 1) % self.slots.shape[0]]
        if count % self.every != 0:
            for i in range(self.of_base):
                wire.message[i] = before[i]
        copy_to(wire.message, slot)
        if added != 0.0:  # or not a number
            for i in range(slot.size):
                slot[i] += added
        arrived = count - self.delay - int(self.uniforms[k, 0] * (self.jitter + 1.0)) - int(late)
        wire.clock[COUNT] = count + 1.0
        newer = self.uniforms[k, 1] >= self.loss and late >= 0.0 and arrived > wire.clock[RECEIVED]
        if count == 0 or newer:
            wire.clock[RECEIVED] = max(arrived, 0)
            copy_to(self.slots[max(arrived, 0) % self.slots.shape[0]], wire.received)
            base = self.slots[max(arrived - self.base_late, 0) % self.slots.shape[0]]
            for i in range(self.of_base):
                wire.received[i] = base[i]
