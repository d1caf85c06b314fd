"""The hand on a robot that runs: a wish whose setpoints are made sample by sample, and close on the measured hand.

    stepper.step(time, measurement, FollowHand(body, HandLine((0.5, 0.0, 0.0))))

The program moves its own reference on, as ahead of a run, but what it drives to zero is the error of the hand as it is
measured: what the torque loop leaves behind comes back as motion of the reference.
"""

from __future__ import annotations

import numpy as np

from ...elementary.matrices import product
from ...model.chain import SIZE, move
from ...model.reduction import as_measured
from ...signals import Array, Setpoint
from .path import HandPath, placed
from .tasks import P, R, advance
from .whole_body import WholeBody

LONGEST = 0.05  # a sample that comes later than this is stepped through in parts [s]


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


class HandCourse:
    """A wish for the hand under way: see `wishes.Course`.

    Args:
        wish: The wish.
        now: Flat setpoint of the last sample, where it begins.
        measured: Pose, velocity, q, qdot side by side, a view that is kept up to date.
    """

    def __init__(self, wish: FollowHand, now: Array, measured: Array) -> None:
        body, d = wish.body, wish.body.robot.dimensions
        self.body, self.wish, self.measured, self.parts = body, wish, measured, (0, 1) if d.base else (1,)
        start = Setpoint.side_by_side(now, d)
        body.put(start.pose, start.q, np.hstack((start.velocity, start.qdot)))
        place = body.places[0]
        self.rows = placed(wish.samples, place[9:].copy(), body.axes, place[:9].reshape(3, 3).copy()).flat
        self.targets = np.array([body.target_here(i) for i in range(len(body.tasks))])
        self.elapsed, self.place = 0.0, np.zeros(SIZE)
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
        return elapsed < self.wish.path.duration

    def _solve(self) -> None:
        """The solution for the sample that begins now."""
        body, target = self.body, self.targets[0]
        k = min(round(self.elapsed / body.period), len(self.rows) - 1)
        target[:] = self.rows[k]
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
