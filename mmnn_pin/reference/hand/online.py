"""The hand on a robot that runs: a wish whose setpoints are made sample by sample, and close on the measured hand.

    stepper.step(time, measurement, FollowHand(body, HandLine((0.5, 0.0, 0.0))))

    wish = HandWish(body)                     once
    wish.go((0.8, 0.1, 0.9))                  whenever a place comes, or wish.move(twist)

The program moves its own reference on, as ahead of a run, but what it drives to zero is the error of the hand as it is
measured: what the torque loop leaves behind comes back as motion of the reference.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...elementary import cos_sin
from ...elementary.matrices import length, product
from ...errors import ConfigError
from ...model.chain import SIZE, move
from ...model.reduction import as_measured
from ...signals import Array, Setpoint
from .path import HandPath, placed, rotations
from .tasks import TARGET, WDOT, A, P, R, V, W, advance, rotation_error
from .whole_body import WholeBody

LONGEST = 0.05  # a sample that comes later than this is stepped through in parts [s]
CLOSES = 3.0  # how fast a wished place is closed in on [1/s]
GROWS = 4.0  # of a wished velocity: acceleration per largest speed [1/s]


class FollowHand:
    """A path of the hand from where it is, for base and arm together.

    Args:
        body: The robot's tasks; the first frame follows the path, others stay where they are. Its period is that of the
            loop. One body serves one wish at a time.
        path: From where the hand's reference is, in the robot's axes.
        on_measured: Whether the measured hand is driven to the path; else the reference's.
    """

    def __init__(self, body: WholeBody, path: HandPath, on_measured: bool = True) -> None:
        self.body, self.path, self.on_measured = body, path, on_measured
        self.samples = path.sample(np.arange(int(np.ceil(path.duration / body.period)) + 2) * body.period)


class HandWish:
    """A place or a velocity of the hand, told again and again, for base and arm together.

    Args:
        body: As of `FollowHand`.
        speed: Largest speed and turning rate with which it goes there [m/s, rad/s].
        timeout: Age of a velocity at which it stops [s].
        on_measured: As of `FollowHand`; false for a hand that gives way, which is not to be driven back.

    Attributes:
        goal: (24,) place and orientation, see `tasks.TARGET`; None for a velocity.
        turns: Whether the orientation counts.
        twist: (6,) velocity, linear and angular, in the world [m/s, rad/s].
        count: How often it was told anything.

    Raises:
        ConfigError: A speed or a timeout that is not finite and > 0.
    """

    def __init__(
        self, body: WholeBody, speed: tuple[float, float] = (0.25, 1.0), timeout: float = 0.5, on_measured: bool = True
    ) -> None:
        if not (min(*speed, timeout) > 0 and np.isfinite((*speed, timeout)).all()):
            raise ConfigError(f"speeds {speed}, timeout {timeout}", fix="give finite numbers > 0", key="hand")
        self.body, self.speed, self.timeout, self.on_measured = body, speed, timeout, on_measured
        self.goal: Array | None = None
        self.turns, self.twist, self.count = False, np.zeros(6), 0

    def go(self, position: ArrayLike, quaternion: ArrayLike | None = None) -> None:
        """Go to a position (3,) [m], and turn to a quaternion `(x, y, z, w)`, both in the world.

        Raises:
            ConfigError: Numbers that are not finite, or a quaternion that is none.
        """
        there, turned = np.asarray(position, float), np.asarray([0, 0, 0, 1] if quaternion is None else quaternion)
        if there.shape != (3,) or turned.shape != (4,) or not np.isfinite([*there, *turned]).all():
            raise ConfigError("a place of the hand that is not finite", fix="give 3 numbers, and 4 or None", key="hand")
        if not abs(float(turned @ turned) - 1.0) < 0.04:
            raise ConfigError("a quaternion that is not of length 1", fix="give (x, y, z, w), or None", key="hand")
        self.goal = np.zeros(TARGET)
        self.goal[P : P + 3] = there
        self.goal[R : R + 9] = rotations(turned[None].astype(float), *np.zeros((2, 1, 4)))[0].ravel()
        self.turns, self.count = quaternion is not None, self.count + 1

    def move(self, twist: ArrayLike) -> None:
        """Go at a velocity (6,) of the world's axes, until it is old.

        Raises:
            ConfigError: Numbers that are not finite.
        """
        if np.shape(twist) != (6,) or not np.isfinite(twist).all():
            raise ConfigError("a velocity of the hand that is not finite", fix="give 6 numbers", key="hand")
        self.goal, self.count = None, self.count + 1
        self.twist[:] = twist


class HandCourse:
    """A wish for the hand under way: see `wishes.Course`.

    Args:
        wish: The wish.
        now: Flat setpoint of the last sample, where it begins.
        measured: Pose, velocity, q, qdot side by side, a view that is kept up to date.
    """

    def __init__(self, wish: Any, now: Array, measured: Array) -> None:
        body, d = wish.body, wish.body.robot.dimensions
        self.body, self.wish, self.measured, self.parts = body, wish, measured, (0, 1) if d.base else (1,)
        start = Setpoint.side_by_side(now, d)
        body.put(start.pose, start.q, np.hstack((start.velocity, start.qdot)))
        self.targets = np.array([body.target_here(i) for i in range(len(body.tasks))])
        self.elapsed, self.place = 0.0, np.zeros(SIZE)
        self._begin(body.places[0])
        self.places, self.bends = np.array([[-np.inf], [np.inf]]).repeat(d.arm, axis=1), np.zeros(d.arm)
        self.position, self.nu = np.zeros(d.full), np.zeros(d.twist + d.arm)
        self.two, self.J = np.zeros((2, 6)), np.zeros((6, d.twist + d.arm))
        self._solve()

    @property
    def ends_at_rest(self) -> bool:
        """It ends with what the reference does then."""
        return False

    def write(self, elapsed: float, wanted: Array) -> bool:
        """See `Course.write`."""
        body, left = self.body, elapsed - self.elapsed
        while left > 1e-9:
            step = min(left, LONGEST)
            advance(body.pose, body.q, body.nu, body.nudot, body.robot.dimensions.sideways, step, body.two)
            self.elapsed, left = self.elapsed + step, left - step
            self._solve()
        d = body.robot.dimensions
        setpoint = Setpoint.side_by_side(wanted, d)
        setpoint.pose[:], setpoint.q[:] = body.pose, body.q
        setpoint.velocity[:], setpoint.qdot[:] = body.nu[: d.twist], body.nu[d.twist :]
        setpoint.acceleration[:], setpoint.qddot[:] = body.nudot[: d.twist], body.nudot[d.twist :]
        return self._goes_on(elapsed)

    def _begin(self, place: Array) -> None:
        """Put the path where the hand's reference is (12,)."""
        body, own = self.body, place.copy()
        self.rows = placed(self.wish.samples, own[9:], body.axes, own[:9].reshape(3, 3)).flat

    def _goes_on(self, elapsed: float) -> bool:
        """Whether it is not over at a time [s]."""
        return bool(elapsed < self.wish.path.duration)

    def _aim(self, target: Array) -> None:
        """Write the target (24,) of the sample that begins now."""
        target[:] = self.rows[min(round(self.elapsed / self.body.period), len(self.rows) - 1)]

    def _solve(self) -> None:
        """The solution for the sample that begins now."""
        body, target = self.body, self.targets[0]
        self._aim(target)
        if self.wish.on_measured:
            self._shift(target)
        body.solve(self.targets)

    def _shift(self, target: Array) -> None:
        """Move a target (24,) by what the measured hand is off the reference's: the error left is the measured one."""
        body, d = self.body, self.body.robot.dimensions
        pose, velocity, q, qdot = np.split(self.measured, np.cumsum([d.pose, d.twist, d.arm]))
        as_measured(body.offset, body.arm, pose, velocity, q, qdot, self.position, self.nu)
        twist, bias = self.two
        move(body.chains[0], self.position, self.nu, self.place, twist, bias, self.J)
        body.look_around()
        mine, other = body.places[0], self.place
        target[P : P + 3] += mine[9:] - other[9:]
        turned = product(target[R : R + 9].reshape(3, 3), other[:9].reshape(3, 3).T, mine[:9].reshape(3, 3))
        target[R : R + 9] = turned.ravel()


class WishedCourse(HandCourse):
    """A `HandWish` under way: its target goes to the place, or at the velocity, within its speeds."""

    def _begin(self, place: Array) -> None:
        self.row, self.error, self.aimed = self.body.target_here(0), np.zeros(12), 0.0
        self.heard, self.renewed = -1, 0.0

    def _goes_on(self, elapsed: float) -> bool:
        return True

    def _aim(self, target: Array) -> None:
        wish, row, dt = self.wish, self.row, self.elapsed - self.aimed
        self.aimed = self.elapsed
        if wish.count != self.heard:
            self.heard, self.renewed = wish.count, self.elapsed
        for half, wanted in enumerate(self._wanted()):
            rates, gains = row[(V, W)[half] :][:3], row[(A, WDOT)[half] :][:3]
            wanted *= min(1.0, wish.speed[half] / max(length(wanted), 1e-12))
            change, most = wanted - rates, GROWS * wish.speed[half] * dt
            change *= min(1.0, most / max(length(change), 1e-12))
            rates += change
            gains[:] = change / dt if dt > 0.0 else 0.0
        row[P : P + 3] += dt * row[V : V + 3]
        turned = dt * row[W : W + 3]
        c, s = cos_sin(0.5 * length(turned))
        q = np.append(turned * (s / max(length(turned), 1e-12)), c)
        step = rotations(q[None], *np.zeros((2, 1, 4)))[0][0]
        row[R : R + 9] = product(step, row[R : R + 9].reshape(3, 3)).ravel()
        target[:] = row

    def _wanted(self) -> tuple[Array, Array]:
        """Velocities (3,) that close in on the place, or those that were told while they are fresh."""
        wish, row = self.wish, self.row
        if wish.goal is not None:
            rotation_error(row[R : R + 9], wish.goal, self.error)
            turn = CLOSES * self.error[3:6] if wish.turns else np.zeros(3)
            return CLOSES * (wish.goal[P : P + 3] - row[P : P + 3]), turn
        share = 1.0 if self.elapsed - self.renewed <= wish.timeout else 0.0
        return share * wish.twist[:3], share * wish.twist[3:]
