"""Whole-body motion of base and arm: tasks and limits as one quadratic program per control sample.

The variables are nudot, base and arm together. Of every frame that has a task, `J S nudot + bias` should be

    a = a_d + 2 k (v_d + [k/2 error] - twist)          k = rate, [.] limited in length: critically damped

and of all velocities `nudot = settle (wish - nu)`, where the wish adds up posture, manipulability and heading. The
program minimises the squared slack of both kinds, weighted, within limits that hold by construction:

    |nudot| <= acceleration      |nu + h nudot| <= velocity      |W (nu + h nudot)| <= wheel speeds
    joints brake in time: nu + h nudot <= sqrt-like bound of the way that is left

Braking straight to rest fulfils all of them, so that a solution exists from any state that fulfils them. A frame's
slack costs far more than a wish's, not infinitely more: near a singularity, or where a goal is out of reach, the arm
stays calm and the frame falls short. The weights of base and arm say what a share of their speed limits costs.

Tasks of one priority are weighed against each other. Those of another come in order: the program is solved again for
the next ones with `J S nudot` of all tasks before held where it is, so a later task never disturbs an earlier one.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from ...compiled import compiled, inlined
from ...elementary import atan2, cos_sin
from ...errors import ConfigError
from ...model.robot import Robot, speed_limits
from ...model.robot import limits as limits_of
from ...settings import Numbers, Settings, one_or_each
from ...signals import Array
from ..guide import new_guide
from ..limits import Limits, rims

# Places in a target: position, velocity, acceleration, rotation row by row, angular velocity, its derivative.
P, V, A, R, W, WDOT, TARGET = 0, 3, 6, 9, 18, 21, 24
AXES = ("x", "y", "z")


class Task(Settings, frozen=True):
    """The task of one frame: where it should be, and how strictly.

    Args:
        frame: A link or joint that the arm moves; empty for the tip of the arm (the first, of several arms).
        position: Weight of position errors, one number or one along x, y, z of the world; 0 leaves the position free.
        orientation: Weight of orientation errors, one number or one about x, y, z of the frame; 0 leaves it free.
        looks: An axis of the frame, "x", "y" or "z", that should point at `at`; the frame then has no other task.
        at: Where the axis points: a frame of the robot, or a point (3,) in the world [m].
        priority: Tasks with a smaller number come first; tasks with a larger number use what they leave free.

    Raises:
        ConfigError: A weight that is negative or not finite, a priority below 0.
    """

    frame: str = ""
    position: float | tuple[float, float, float] = 1.0
    orientation: float | tuple[float, float, float] = 0.1
    looks: Literal["", "x", "y", "z"] = ""
    at: str | tuple[float, float, float] = ""
    priority: int = 0

    def __post_init__(self) -> None:
        if self.priority < 0:
            raise ConfigError(f"{self.priority}", fix="use 0, 1, 2, ...", key="reference.hand.priority")
        for name in ("position", "orientation"):
            one_or_each(getattr(self, name), 3, "axis", f"reference.hand.{name}", least=0)

    @property
    def weights(self) -> Array:
        """(6,) of the rows, x, y, z of the world, then about x, y, z of the frame."""
        if self.looks:
            turned = [0.0 if axis == self.looks else 0.1 for axis in AXES]
            return np.array([0.0, 0.0, 0.0, *turned])
        return np.hstack(
            [one_or_each(getattr(self, name), 3, "axis", name, least=0) for name in ("position", "orientation")]
        )


class WholeBodySettings(Settings, frozen=True):
    """How base and arm share the work.

    Args:
        rate: How fast an error of a frame decays [1/s].
        approach: Largest speed and turning rate with which a frame catches up [m/s, rad/s].
        base: Cost of the base's velocities, as shares of their limits, against that of the joints'; only ratios count.
        arm: Cost of the joints' velocities likewise, one number or one per joint.
        settle: How fast velocities follow the wishes [1/s].
        posture: How fast joints drift to the posture where tasks leave them free [1/s].
        manipulability: How fast the arm leaves singular postures [rad/s per unit of the log of sqrt(det J J')].
        heading: How fast the base turns towards the hand's goal [1/s].
        slack: Cost of a wish's slack, relative to that of a frame.
        wheel_speed: Largest speeds of the wheels [rad/s]; "urdf" for those of the URDF.
        clearance: Distance between the bodies that `Capsule`s describe [m].

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    rate: float = 10.0
    approach: tuple[float, float] = (0.3, 1.0)
    base: float = 1.0
    arm: Numbers = 1.0
    settle: float = 3.0
    posture: float = 0.5
    manipulability: float = 0.0
    heading: float = 0.0
    slack: float = 1e-4
    wheel_speed: Literal["urdf"] | Numbers = "urdf"
    clearance: float = 0.02

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, str):
                continue
            least = 0.0 if name in ("posture", "manipulability", "heading", "clearance") else 1e-9
            if not (np.isfinite(value).all() and (np.asarray(value) >= least).all()):
                fix = "give numbers > 0" if least else "give a number >= 0"
                raise ConfigError(f"{value}", fix=fix, key=f"reference.hand.{name}")


class WholeBodyBounds(NamedTuple):
    """Limits of the velocities nu of base and arm."""

    speed: Array  # (p,) largest speeds [m/s, rad/s]
    acceleration: Array  # (p,) largest accelerations [m/s^2, rad/s^2]
    ends: Array  # (2, n) ends of the joints [rad or m]
    wheels: Array  # (k, nb) rates of the wheels that have a limit, by the velocity of the base
    wheel_speed: Array  # (k,) that limit [rad/s]


def bounds_of(robot: Robot, settings: WholeBodySettings, limits: Limits) -> WholeBodyBounds:
    """The limits of a robot.

    Raises:
        ConfigError: Not one number per joint or wheel, or limits that leave a joint no room.
    """
    for name, i in zip(robot.joint_names, robot.arm_index, strict=True):
        if robot.lower[i] >= robot.upper[i]:
            why = f"the URDF limits it to {robot.lower[i]:g} ... {robot.upper[i]:g}"
            raise ConfigError(
                f"'{name}' cannot move", why=why, fix=f"correct that, or --lock {name}", key="reference.hand"
            )
    guide, (rows, speeds) = new_guide(robot, limits), wheel_rows(robot)
    given = limits_of(settings.wheel_speed, speeds, "wheel", "reference.hand.wheel_speed")
    kept = np.isfinite(given)
    return WholeBodyBounds(
        np.hstack((guide.base[0], guide.arm[0])),
        np.hstack((guide.base[1], guide.arm[1])),
        np.ascontiguousarray(guide.ends),
        np.ascontiguousarray(rows[kept]),
        given[kept],
    )


def wheel_rows(robot: Robot) -> tuple[Array, Array]:
    """Rows (k, twist) of the wheels by the velocity of the base, and their limits (k,) [rad/s]."""
    if not robot.dimensions.base:
        return np.zeros((0, 0)), np.zeros(0)
    if robot.steers:
        return rims(robot)
    return robot.base.wheel_map, speed_limits(robot)[: len(robot.base.wheels)]


class FrameMotion(NamedTuple):
    """Where a frame is and how it moves."""

    place: Array  # (12,) rotation row by row, origin
    twist: Array  # (6,) its twist
    bias: Array  # (6,) its acceleration where nudot = 0
    J: Array  # (6, p) its Jacobian


@compiled
def wanted_acceleration(frame: FrameMotion, target: Array, numbers: Array, error: Array) -> None:
    """Error (linear and angular in the world's axes) and wanted acceleration of a frame, into error (12,).

    Args:
        frame: The frame.
        target: (24,) see `TARGET`.
        numbers: (3,) rate, largest speed and turning rate of catching up.
        error: (12,) written.
    """
    k = numbers[0]
    for i in range(3):
        error[i] = target[P + i] - frame.place[9 + i]
    rotation_error(frame.place, target, error)
    for half in range(2):
        at, size = 3 * half, 0.0
        for i in range(3):
            size += error[at + i] * error[at + i]
        size = 0.5 * k * math.sqrt(size)
        share = 1.0 if size <= numbers[1 + half] else numbers[1 + half] / size
        for i in range(3):
            v, a = target[(V, W)[half] + i], target[(A, WDOT)[half] + i]
            wanted = v + 0.5 * k * share * error[at + i] - frame.twist[at + i]
            error[6 + at + i] = a + 2.0 * k * wanted - frame.bias[at + i]


@compiled
def add_frame(frame: FrameMotion, weights: Array, error: Array, rows: Array, H: Array, f: Array) -> None:
    """Add a frame's task to `nudot' H nudot / 2 + f' nudot`.

    Args:
        frame: The frame.
        weights: (6,) cost of the rows' slack; the angular ones are about the axes of the frame.
        error: (12,) as `wanted_acceleration` writes it.
        rows: (6, p) written: the rows of nudot.
        H: (p, p) added to.
        f: (p,) added to.
    """
    place, J, p = frame.place, frame.J, f.size
    for i in range(6):
        weight = weights[i]
        if weight == 0.0:
            continue
        wanted = error[6 + i]
        if i < 3:
            for j in range(p):
                rows[i, j] = J[i, j]
        else:  # about the axes of the frame
            c = i - 3
            wanted = place[c] * error[9] + place[3 + c] * error[10] + place[6 + c] * error[11]
            for j in range(p):
                rows[i, j] = place[c] * J[3, j] + place[3 + c] * J[4, j] + place[6 + c] * J[5, j]
        for j in range(p):
            share = weight * rows[i, j]
            if share != 0.0:
                f[j] -= share * wanted
                for m in range(p):
                    H[j, m] += share * rows[i, m]


@inlined
def rotation_error(place: Array, target: Array, error: Array) -> None:
    """Rotation vector from the frame's orientation to the target's in the world, into error[3:6]."""
    trace = 0.0
    error[3] = error[4] = error[5] = 0.0
    for c in range(3):  # target R', half its skew part: sum of a x b over the axes
        for i in range(3):
            trace += target[R + 3 * i + c] * place[3 * i + c]
        ax, ay, az = place[c], place[3 + c], place[6 + c]
        bx, by, bz = target[R + c], target[R + 3 + c], target[R + 6 + c]
        error[3] += 0.5 * (ay * bz - az * by)
        error[4] += 0.5 * (az * bx - ax * bz)
        error[5] += 0.5 * (ax * by - ay * bx)
    sine = math.sqrt(error[3] * error[3] + error[4] * error[4] + error[5] * error[5])
    angle = atan2(sine, 0.5 * (trace - 1.0))
    if sine > 1e-9:
        for i in range(3):
            error[3 + i] *= angle / sine
    elif trace < 0.0:  # turned by half a turn: about any axis at right angles to none, here the frame's z
        for i in range(3):
            error[3 + i] = angle * place[3 * i + 2]


@compiled
def look(place: Array, point: Array, axis: int, target: Array) -> None:
    """Let an axis of a frame point at a point (3,): the orientation nearest to the frame's own, into a target (24,)."""
    d0, d1, d2 = point[0] - place[9], point[1] - place[10], point[2] - place[11]
    far = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
    a0, a1, a2 = place[axis], place[3 + axis], place[6 + axis]
    for i in range(9):
        target[R + i] = place[i]
    if far < 1e-6:
        return
    d0, d1, d2 = d0 / far, d1 / far, d2 / far
    x, y, z = a1 * d2 - a2 * d1, a2 * d0 - a0 * d2, a0 * d1 - a1 * d0  # axis times sine
    c = a0 * d0 + a1 * d1 + a2 * d2
    if c < -0.999:  # behind: begin by turning about another axis
        b = (axis + 1) % 3
        x, y, z, c = place[b], place[3 + b], place[6 + b], 0.0
    for j in range(3):
        u0, u1, u2 = place[j], place[3 + j], place[6 + j]
        along = (x * u0 + y * u1 + z * u2) / (1.0 + c)
        target[R + j] = c * u0 + (y * u2 - z * u1) + along * x
        target[R + 3 + j] = c * u1 + (z * u0 - x * u2) + along * y
        target[R + 6 + j] = c * u2 + (x * u1 - y * u0) + along * z


@compiled
def add_wishes(nu: Array, wish: Array, cost: Array, settle: float, H: Array, f: Array) -> None:
    """Add `sum of cost_i (nudot_i - settle (wish_i - nu_i))^2 / 2`, all (p,)."""
    for i in range(nu.size):
        H[i, i] += cost[i]
        f[i] -= cost[i] * settle * (wish[i] - nu[i])


@compiled
def fill_bounds(q: Array, nu: Array, h: float, b: WholeBodyBounds, lower: Array, upper: Array) -> None:
    """Bounds of nudot (p,) and of the wheels' rows, such that speeds and ends hold now and can be held later.

    A joint that has the way d left before its end may have the velocity v after this sample where braking with the
    acceleration a, a sample of h later at the latest, ends before it: `v^2 / (2 a) + v h <= d`.
    """
    nb, p = nu.size - q.size, nu.size
    for i in range(p):
        low, high, a = -b.speed[i], b.speed[i], b.acceleration[i]
        if i >= nb:
            there = q[i - nb] + 0.5 * h * nu[i]
            high = min(high, brake(b.ends[1, i - nb] - there, a, h))
            low = max(low, -brake(there - b.ends[0, i - nb], a, h))
        # from a state beyond its limits: as fast as it may back into them
        lower[i] = min(max((low - nu[i]) / h, -a), a)
        upper[i] = max(min((high - nu[i]) / h, a), -a)
    for k in range(b.wheel_speed.size):
        now, most = 0.0, b.wheel_speed[k]
        for j in range(nb):
            now += b.wheels[k, j] * nu[j]
        upper[p + k] = max((most - now) / h, 0.0 if now > most else -math.inf)
        lower[p + k] = min((-most - now) / h, 0.0 if now < -most else math.inf)


@inlined
def brake(way: float, a: float, h: float) -> float:
    """Largest speed from which braking ends within a way; 0 beyond the end."""
    return a * (math.sqrt(h * h + 2.0 * way / a) - h) if way > 0.0 else 0.0


@compiled
def advance(pose: Array, q: Array, nu: Array, nudot: Array, sideways: bool, h: float, c0: Array) -> None:
    """Move pose, q and nu on by h, nudot held: exact but for the pose, which is Simpson's rule of its velocity.

    Args:
        pose: (3,), or (0,) for a fixed arm.
        q: (n,).
        nu: (p,).
        nudot: (p,).
        sideways: Whether the base velocity is `(vx, vy, w)`.
        h: [s].
        c0: (2,) scratch.
    """
    nb = nu.size - q.size
    if nb:
        c0[:] = 0.0
        w0, dw, turned = nu[nb - 1], nudot[nb - 1], pose[2]
        for i in range(3):
            s = 0.5 * h * i
            c, sine = cos_sin(turned + s * w0 + 0.5 * s * s * dw)
            share = h / 6.0 if i != 1 else 4.0 * h / 6.0
            vx = nu[0] + s * nudot[0]
            vy = nu[1] + s * nudot[1] if sideways else 0.0
            c0[0] += share * (c * vx - sine * vy)
            c0[1] += share * (sine * vx + c * vy)
        pose[0] += c0[0]
        pose[1] += c0[1]
        pose[2] += h * w0 + 0.5 * h * h * dw
    for i in range(q.size):
        q[i] += h * nu[nb + i] + 0.5 * h * h * nudot[nb + i]
    for i in range(nu.size):
        nu[i] += h * nudot[i]
