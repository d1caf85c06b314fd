"""Things that a hand touches: flat surfaces, and a door that it holds by the handle. A force at a frame of the robot.

    surface:  f = max(0, k d - c d'),  d how deep the frame is behind it,  and Coulomb friction f mu against the sliding
    door:     F = k (handle - hand) + c (their velocities' difference),   I a'' = (r x F)_z - friction - c_h a' - stop

Springs with numbers, so that a stiffness that is asked of a robot can be measured against a known one. They are the
same on both plants: `J' F` on nu, and on the contact plant the force itself on the body, which loads its wheels. The
force of a step of the plant is that at its beginning.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, copy_to, internal
from ..elementary import cos_sin, tanh
from ..errors import ConfigError
from ..model.chain import SIZE, hands_of, pushing, track
from ..model.robot import Robot
from ..model.tip import Tip, move_tip, tip_of
from ..signals import EARLY, Array
from .effects import Forces
from .settings import Window, of_type

SLIDING = 0.005  # speed over which friction of a surface grows to its value [m/s]
STOP = 2e3  # of a closed door [N m/rad], and what damps it [N m s/rad]
STOP_DAMPING = 50.0
HAND_DAMPING = 50.0  # of a hand that touches something, about [N s/m]
TURNING = 0.02  # rate over which friction of a hinge grows to its value [rad/s]
# Columns of the table of surfaces, and numbers of a door.
NORMAL, STIFFNESS, DAMPING, FRICTION, START, END, SURFACE = 0, 3, 4, 5, 6, 7, 8
REACH, SENSE, INERTIA, GRIP, GRIP_DAMPING, TORQUE, HINGE_DAMPING, ON, OFF, DOOR = 0, 2, 3, 4, 5, 6, 7, 8, 9, 10
ANGLE, RATE = 0, 1
POINT, LAST, WORK, DONE = 0, 3, 6, 7  # of what a scene remembers of the frame: where it was, the force, its work


class Surface(Window, frozen=True, kw_only=True, tag="surface"):
    """A flat surface that pushes a hand back: a table, a wall.

    Args:
        frame: What touches it; empty for the robot's hand.
        normal: Direction in which it faces, in the world, of any length. None for the opposite of the first of down,
            left and ahead in which the arm can push.
        gap: Distance from the frame when the run begins [m].
        at: A point of the surface in the world [m]; None for the place that `gap` gives.
        stiffness: Stiffness k [N/m].
        damping: Damping c while it is pressed [N s/m].
        friction: Coulomb coefficient.

    Raises:
        ConfigError: Numbers out of range, or no direction.
    """

    frame: str = ""
    normal: tuple[float, float, float] | None = None
    gap: float = 0.02
    at: tuple[float, float, float] | None = None
    stiffness: float = 2e4
    damping: float = 100.0
    friction: float = 0.2

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "stiffness")
        for name in ("damping", "friction"):
            require_finite(getattr(self, name), f"disturbances.{name}", 0.0)
        for name in ("normal", "gap", "at"):
            if (value := getattr(self, name)) is not None and not np.all(np.isfinite(value)):
                raise ConfigError(f"{value}", fix="use finite numbers", key=f"disturbances.{name}")
        if self.normal is not None and not np.any(self.normal):
            raise ConfigError(f"{self.normal} is no direction", fix="use (0, 0, 1)", key="disturbances.normal")


class HingedDoor(Window, frozen=True, kw_only=True, tag="door"):
    """A door about a vertical hinge that a hand holds by the handle from `start` on, where it then is; closed before.

    Args:
        frame: What holds it; empty for the robot's hand.
        hinge: From the handle to the hinge, ahead and to the left of the robot as it stands when the run begins [m].
        opens: Whether the robot pulls or pushes; a hinge at its side turns one way for each.
        inertia: Inertia about the hinge [kg m^2].
        friction: Dry friction of the hinge [N m].
        damping: Viscous friction of the hinge [N m s].
        grip: Stiffness between hand and handle [N/m].
        grip_damping: Damping between hand and handle [N s/m].

    Raises:
        ConfigError: Numbers out of range, or a hinge at the handle.
    """

    frame: str = ""
    hinge: tuple[float, float] = (0.0, -0.7)
    opens: Literal["pull", "push"] = "pull"
    inertia: float = 4.0
    friction: float = 2.0
    damping: float = 1.0
    grip: float = 2e4
    grip_damping: float = 100.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "inertia", "grip")
        for name in ("friction", "damping", "grip_damping"):
            require_finite(getattr(self, name), f"disturbances.{name}", 0.0)
        if not math.sqrt(self.hinge[0] ** 2 + self.hinge[1] ** 2) >= 0.05 or not np.all(np.isfinite(self.hinge)):
            why, fix = "a door turns about a hinge beside its handle", "put it at least 0.05 m away"
            raise ConfigError(f"a hinge at {self.hinge}", why=why, fix=fix, key="disturbances.hinge")


def require_finite(value: float, key: str, least: float) -> None:
    """Refuse a number that is not finite or below `least` (`ConfigError`)."""
    if not least <= value < math.inf:
        raise ConfigError(f"{value}", fix=f"use a finite number >= {least:g}", key=key)


def require_positive(settings: Any, *names: str) -> None:
    """Refuse numbers that are not finite or not positive (`ConfigError`)."""
    for name in names:
        if not 0 < getattr(settings, name) < math.inf:
            what = f"{getattr(settings, name)}"
            raise ConfigError(what, fix="use a finite number > 0", key=f"disturbances.{name}")


@by_address
class Touched(NamedTuple):
    """The things that a frame touches in one run."""

    dt: float  # step of the plant [s]
    tip: Tip  # the frame
    place: Array  # (12,) placement of the frame, written
    twist: Array  # (6,) twist of the frame, written
    bias: Array  # (6,) bias of the twist, written
    J: Array  # (6, p) its Jacobian, written
    surfaces: Array  # (k, SURFACE)
    door: Array  # (DOOR,), or (0,) without one
    done: Array  # (DONE,) where the frame was a step ago and the force there, and the work since the start [J]
    state: Array  # places (k, 3) of the surfaces and hinge (3,), flat, then the angle of the door and its rate

    @internal
    def act(self, wire: Forces, k: int, time: float) -> None:
        """Add the force of the step that begins at a time; the door moves on by it."""
        copy_to(wire.n, self.tip.maps.n)
        move_tip(self.tip, wire.position, wire.nu, self.place, self.twist, self.bias, self.J)
        hand, done = wire.hand, self.done
        for i in range(3):
            hand[i], hand[3 + i] = self.place[9 + i], 0.0
            done[WORK] += done[LAST + i] * (hand[i] - done[POINT + i])
        for i in range(self.surfaces.shape[0]):
            if in_time(self.surfaces[i, START], self.surfaces[i, END], time):
                press(self.surfaces[i], self.state[3 * i : 3 * i + 3], self.twist, hand)
        if self.door.size:
            pull(self.door, self.state[3 * self.surfaces.shape[0] :], self.twist, hand, self.dt, time)
        for j in range(wire.force.size):
            wire.by_hand[j] = 0.0
            for i in range(3):
                wire.by_hand[j] += self.J[i, j] * hand[3 + i]
            wire.force[j] += wire.by_hand[j]
        copy_to(hand[:3], done[POINT : POINT + 3])
        copy_to(hand[3:], done[LAST : LAST + 3])


@compiled
def in_time(start: float, end: float, time: float) -> bool:
    """Whether a stretch of time has begun and is not over."""
    return start - EARLY <= time and time < end - EARLY


@compiled
def press(surface: Array, at: Array, twist: Array, hand: Array) -> None:
    """Add the force of a surface through `at` (3,) to `hand`: point and force (6,); twist (6,) is the frame's."""
    deep, rate = 0.0, 0.0
    for i in range(3):
        deep += surface[NORMAL + i] * (at[i] - hand[i])
        rate -= surface[NORMAL + i] * twist[i]
    force = surface[STIFFNESS] * deep + surface[DAMPING] * rate
    if deep <= 0.0 or force <= 0.0:
        return
    speed = SLIDING * SLIDING
    for i in range(3):
        along = twist[i] + rate * surface[NORMAL + i]
        speed += along * along
    grip = surface[FRICTION] * force / math.sqrt(speed)
    for i in range(3):
        hand[3 + i] += force * surface[NORMAL + i] - grip * (twist[i] + rate * surface[NORMAL + i])


@compiled
def pull(door: Array, state: Array, twist: Array, hand: Array, dt: float, time: float) -> None:
    """Add the force of a door to `hand`, and move the door on by it; arguments as of `press`."""
    angle, rate = state[3 + ANGLE], state[3 + RATE]
    c, s = cos_sin(door[SENSE] * angle)
    x, y = c * door[REACH] - s * door[REACH + 1], s * door[REACH] + c * door[REACH + 1]
    along = door[SENSE] * rate
    torque = -door[TORQUE] * tanh(rate / TURNING) - door[HINGE_DAMPING] * rate
    if angle < 0.0:
        torque += -STOP * angle - STOP_DAMPING * rate
    if in_time(door[ON], door[OFF], time):
        if time < door[ON] - EARLY + dt:  # the hand takes hold where it is
            state[0], state[1], state[2] = hand[0] - x, hand[1] - y, hand[2]
        k, c = door[GRIP], door[GRIP_DAMPING]
        fx = k * (state[0] + x - hand[0]) + c * (-along * y - twist[0])
        fy = k * (state[1] + y - hand[1]) + c * (along * x - twist[1])
        hand[3] += fx
        hand[4] += fy
        hand[5] += k * (state[2] - hand[2]) - c * twist[2]
        torque += door[SENSE] * (y * fx - x * fy)
    state[3 + RATE] = rate + dt * torque / door[INERTIA]
    state[3 + ANGLE] = angle + dt * state[3 + RATE]


def touching(disturbances: Sequence[Any]) -> list[tuple[int, Any]]:
    """The surfaces and doors among disturbances, with their places in the list, surfaces first."""
    return [*of_type(Surface, disturbances), *of_type(HingedDoor, disturbances)]


def require_step(disturbances: Sequence[Any], dt: float) -> None:
    """Refuse a spring that gives energy: held over a step it is as one whose damping is smaller by `k dt / 2`.

    Raises:
        ConfigError: That is more than its own damping and what a hand has.
    """
    for i, one in touching(disturbances):
        is_door = isinstance(one, HingedDoor)
        k, c, name = (one.grip, one.grip_damping, "grip") if is_door else (one.stiffness, one.damping, "stiffness")
        most = 2.0 * max(c, HAND_DAMPING) / k
        if dt > most:
            why, key = f"held over a step of {1e3 * dt:g} ms it gives energy", f"disturbances.{i}.{name}"
            raise ConfigError(f"{k:g} N/m", why=why, fix=f"use a time.plant_step of at most {most:.2g}", key=key)


def touched_frame(disturbances: Sequence[Any], robot: Robot) -> str:
    """The frame that touches something in a run; empty where none does.

    Raises:
        ConfigError: There are two of them, or two doors, or the robot has no arm.
        UnknownName: It has no such frame.
    """
    found = touching(disturbances)
    frames = list(dict.fromkeys(one.frame or hands_of(robot)[0] for _, one in found))
    if len(frames) > 1:
        why, key = "one frame touches things in a run", f"disturbances.{found[-1][0]}.frame"
        raise ConfigError(f"'{frames[1]}' beside '{frames[0]}'", why=why, fix="name one of them", key=key)
    if len(doors := of_type(HingedDoor, disturbances)) > 1:
        raise ConfigError("a second door", fix="one run has one door", key=f"disturbances.{doors[1][0]}")
    return frames[0] if frames else ""


def scene_size(disturbances: Sequence[Any]) -> int:
    """How many numbers a scene remembers, 0 without one."""
    found = touching(disturbances)
    return 3 * len(found) + 2 * any(isinstance(one, HingedDoor) for _, one in found) + (DONE if found else 0)


def scene_of(
    disturbances: Sequence[Any], robot: Robot, dt: float, position: Array, state: Array, frame: str
) -> Touched | None:
    """The things that a frame touches in a run; None for nothing.

    Args:
        disturbances: Of the run.
        robot: The robot.
        dt: Step of the plant [s].
        position: (nv,) where the robot starts.
        state: What the scene remembers, `scene_size`; written.
        frame: Of `touched_frame`.
    """
    if not frame:
        return None
    found = [one for _, one in touching(disturbances)]
    require_step(disturbances, dt)
    tip, p, done, state = tip_of(robot, frame), robot.dimensions.dof, state[:DONE], state[DONE:]
    hand = track(tip.chain, position[None])[0, 9:]
    c, s = cos_sin(float(position[2])) if robot.dimensions.base else (1.0, 0.0)
    rows, door = [], np.zeros(0)
    for i, one in enumerate(found):
        if isinstance(one, Surface):
            normal = -pushing(tip.chain, position, robot.dimensions.arm) if one.normal is None else np.array(one.normal)
            normal = normal / math.sqrt(float(np.sum(np.square(normal))))
            state[3 * i : 3 * i + 3] = hand - one.gap * normal if one.at is None else one.at
            rows.append((*normal, one.stiffness, one.damping, one.friction, one.start, one.end))
        else:
            x, y = one.hinge
            to_hinge = np.array([c * x - s * y, s * x + c * y, 0.0])
            state[3 * i : 3 * i + 5] = [*(hand + to_hinge), 0.0, 0.0]
            # Turned to the left, the handle moves by (y, -x) of `hinge`, in the robot's axes.
            sense = math.copysign(1.0, -y) if one.opens == "pull" else math.copysign(1.0, y)
            numbers = one.inertia, one.grip, one.grip_damping, one.friction, one.damping, one.start, one.end
            door = np.array([*-to_hinge[:2], sense, *numbers])
    return Touched(
        float(dt), tip, np.zeros(SIZE), np.zeros(6), np.zeros(6), np.zeros((6, p)),
        np.array(rows, float).reshape(-1, SURFACE), door, done, state,
    )  # fmt: skip
