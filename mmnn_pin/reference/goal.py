"""A goal of the joints as a motion: planned by ruckig from where the reference is, within speed, acceleration, jerk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..elementary import nearest_turn
from ..errors import ConfigError
from ..settings import given_array
from ..signals import Array
from .guide import ARM, AT_REST, Guide
from .wishes import JointGoal

LEDGE = 0.05  # by which a joint that stays may be outside of its end [rad or m]
STIFF = 1e4  # times the jerk, where braking within it would pass a joint's end
LONGER = 1e-6  # way beyond what the shortest time takes that is rounding [rad or m]


class Reach:
    """A joint goal on its way; its time per sample is a microsecond.

    From rest the joints move on a line, else so that all arrive together, and where that would lead a joint farther
    than the shortest time does, each for itself.

    Args:
        goal: The goal.
        start: (3, n) q, qdot, qddot of the reference.
        guide: With the limits.
        names: Of the joints.

    Raises:
        ConfigError: A goal of wrong shape, not finite or outside the joints' ends; ruckig is missing or finds no way.
    """

    parts = (ARM,)

    def __init__(self, goal: JointGoal, start: Array, guide: Guide, names: Sequence[str]) -> None:
        n, ends = start.shape[1], guide.ends
        points = of_joints("setpoint.q", goal.q, n)
        rates = np.zeros_like(points) if goal.qdot is None else of_joints("setpoint.qdot", goal.qdot, n)
        rates = given_array("setpoint.qdot", rates, points.shape)
        before = start[0]
        for point in points:
            for i in np.flatnonzero(guide.turn):
                point[i] = nearest_turn(point[i], before[i])
            before = point
        stays = np.abs(points - start[0]) < LEDGE  # a joint that rests a little outside of its end stays at its end
        points = np.where(stays, np.clip(points, *ends), points)
        outside = np.argwhere((points < ends[0]) | (points > ends[1]))
        if len(outside):
            k, i = outside[0]
            what, why = f"{names[i]} to {points[k, i]:.4g}", f"its ends are {ends[0, i]:.4g} and {ends[1, i]:.4g}"
            raise ConfigError(what, why=why, fix="give a goal between them", key="setpoint.q")
        self.first, self.n, self.legs, self.ends = guide.now.size - 3 * n, n, list[Any](), [0.0]
        self.bends = np.zeros(n)
        state = start
        for q, qdot in zip(points, rates, strict=True):
            leg = planned(state, q, qdot, guide.arm[:3], ends)
            self.legs.append(leg)
            self.ends.append(self.ends[-1] + leg.duration)
            state = np.array([q, qdot, np.zeros(n)])
        least, most = zip(*map(extremes, self.legs), strict=True)
        self.places = np.array([np.min(least, axis=0), np.max(most, axis=0)])

    @property
    def duration(self) -> float:
        """Time that it takes [s]."""
        return self.ends[-1]

    @property
    def ends_at_rest(self) -> bool:
        """Whether it ends at rest."""
        return bool(np.abs(self.legs[-1].at_time(self.legs[-1].duration)[1]).max(initial=0.0) < AT_REST)

    def write(self, elapsed: float, wanted: Array) -> bool:
        """See `Course`."""
        leg = 0
        while leg + 1 < len(self.legs) and elapsed >= self.ends[leg + 1]:
            leg += 1
        inside = min(max(elapsed - self.ends[leg], 0.0), self.legs[leg].duration)
        wanted[self.first :].reshape(3, self.n)[:] = self.legs[leg].at_time(inside)[:3]
        return elapsed < self.ends[-1]


def of_joints(name: str, values: ArrayLike, n: int) -> Array:
    """One row, or several, with a number for every joint, (k, n); a copy.

    Raises:
        ConfigError: They are not numbers, or of another shape.
    """
    try:
        rows = np.array(np.atleast_2d(np.asarray(values, float)))
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} that are not numbers", fix=f"give {n} numbers, or rows of {n}", key=name) from error
    return np.array(given_array(name, rows, (rows.shape[0] or 1, n)))


def planned(start: Array, q: Array, qdot: Array, limits: Array, ends: Array) -> Any:
    """The fastest motion of the joints from a state (3, n) to q with qdot, (n,), within limits (3, n), inside ends.

    Raises:
        ConfigError: ruckig is missing, or finds no way.
    """
    try:
        import ruckig
    except ImportError as error:
        fix = "pip install 'mmnn_pin[tasks]', or give full setpoints"
        raise ConfigError("a joint goal without ruckig", fix=fix, key="setpoint") from error
    leg, why, begin = None, "", np.array([*start[:2], eased(start[1], start[2], limits)])
    calm = begin * [[1.0], [1.0], [0.0]]
    for state, stiffer in ((begin, 1.0), (calm, 1.0), (calm, STIFF)):
        within = limits * [[1.0], [1.0], [stiffer]]
        try:
            leg = solved(ruckig, state, q, qdot, within, ruckig.Synchronization.Phase)
            if state[1:].any():
                alone = solved(ruckig, state, q, qdot, within, ruckig.Synchronization.No)
                leg = alone if wider(leg, extremes(alone)) else leg
        except (ruckig.RuckigError, RuntimeError) as error:
            why = " ".join(str(error).split()).partition(" input:")[0]  # in one line
            continue
        if not wider(leg, np.array([np.minimum(ends[0], start[0]), np.maximum(ends[1], start[0])])):
            return leg
    if leg is None:
        fix = "raise [limits], or wait until the robot moves more slowly"
        raise ConfigError("a joint goal that cannot be planned", why=why, fix=fix, key="setpoint.q")
    return leg  # what passes an end is stopped there by the guide


def eased(rate: Array, bend: Array, limits: Array) -> Array:
    """Accelerations (n,) within limits (3, n), from which braking within the jerk keeps to the speed."""
    most = np.minimum(limits[1], np.sqrt(2.0 * limits[2] * np.maximum(limits[0] - np.sign(bend) * rate, 0.0)))
    return np.clip(bend, -most, most)


def solved(ruckig: Any, start: Array, q: Array, qdot: Array, limits: Array, mode: Any) -> Any:
    """Ruckig's trajectory from a state (3, n) to q with qdot, (n,), the joints synchronised in a way.

    Raises:
        RuntimeError: There is none, and why.
    """
    n = limits.shape[1]
    asked, found = ruckig.InputParameter(n), ruckig.Trajectory(n)
    asked.current_position, asked.current_velocity, asked.current_acceleration = start.tolist()
    asked.target_position, asked.target_velocity = q.tolist(), qdot.tolist()
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = limits.tolist()
    asked.synchronization = mode
    result = ruckig.Ruckig(n).calculate(asked, found)
    if result not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise RuntimeError(f"ruckig says {result.name}")
    return found


def extremes(leg: Any) -> Array:
    """Least and largest places of the joints on a trajectory of ruckig, (2, n): at its phases' ends, or resting in one.

    `position_extrema` of ruckig 0.19 leaves some out.
    """
    parts = [(one.brake, one) for one in leg.profiles[0]]
    t, jerk, bend, rate, place = (
        np.array([[*getattr(brake, name)[:2], *getattr(main, name)[:7]] for brake, main in parts]) for name in "tjavp"
    )
    place = np.where(t > 0.0, place, place[:, 2:3])  # a phase that is not there has no place of its own
    turn = np.sqrt(np.maximum(bend * bend - 2.0 * jerk * rate, 0.0))
    found: list[Array] = [place.T, np.array([[main.pf for _, main in parts]])]
    with np.errstate(divide="ignore", invalid="ignore"):
        for at in ((-bend + turn) / jerk, (-bend - turn) / jerk, -rate / bend):
            inside = np.where((at > 0.0) & (at < t), at, 0.0)
            found.append((place + inside * (rate + inside * (0.5 * bend + inside * jerk / 6.0))).T)
    every = np.vstack(found)
    return np.array([every.min(axis=0), every.max(axis=0)])


def wider(leg: Any, than: Array) -> bool:
    """Whether a trajectory leaves an interval of every joint, (2, n)."""
    least, most = extremes(leg)
    return bool((least < than[0] - LONGER).any() or (most > than[1] + LONGER).any())
