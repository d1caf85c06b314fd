"""The wires between the blocks: one flat row of float64 per control sample, and named views into it.

A row holds every signal of one control sample. The compiled blocks read and write slices of it; a recording is
the rows one after the other. `Layout` says what stands where; `Setpoint`, `Measurement` and
`VelocityCommand` are views for people, refreshed in place at every sample (copy what you want to keep).

Notation: a *twist* is the velocity of the base's control frame in its own axes, `(v, w)`, or `(vx, vy, w)` where it
moves sideways. There are `nb` base velocities: the twist, or `[u; steering rates]` of a base that steers, 0 for a fixed
arm; `n` arm joints, `p = nb + n`, `nv` velocities of the full Pinocchio model. Poses are those of the control frame in
the world, `(x, y, phi)` with phi unwrapped.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

# The signals of a row in the order in which a sample computes them: (name, size, unit of base part, unit of arm part).
# Sizes: "pose" 3 or 0, "twist" 3, 2 or 0, "base" nb, "arm" n, "all" p, "shape" pivots of a base that steers, else 0,
# "full" coordinates of all joints, "motor" actuators, or a number; on the contact plant "wheel" drive wheels and
# "floor" 1 with wheels, else 0; those that begin with "rig" where motors, disturbances or a supervisor are simulated,
# else 0; "scene": a hand touches something; "task": it is compliant; "lead all" p where Psi_hat leads, else 0; those
# that begin with "touch" where external torque is observed, else 0, of a "wrench" 6, `WRENCH`; "hand" 7 for every frame
# that the reference takes along a path: position and quaternion, `HAND`.
SIGNALS: tuple[tuple[str, str, str, str], ...] = (
    ("time", "1", "s", ""),
    ("position", "full", "m, rad", "rad or m"),
    ("nu", "all", "m/s, rad/s", "rad/s or m/s"),
    ("pose_ref", "pose", "m, m, rad", ""),
    ("velocity_ref", "twist", "m/s, rad/s", ""),
    ("acceleration_ref", "twist", "m/s^2, rad/s^2", ""),
    ("q_ref", "arm", "", "rad or m"),
    ("qdot_ref", "arm", "", "rad/s or m/s"),
    ("qddot_ref", "arm", "", "rad/s^2 or m/s^2"),
    ("pose", "pose", "m, m, rad", ""),
    ("velocity", "base", "m/s, rad/s", ""),
    ("q", "arm", "", "rad or m"),
    ("qdot", "arm", "", "rad/s or m/s"),
    ("shape", "shape", "rad", ""),
    ("alpha", "base", "m/s, rad/s", ""),
    ("alphadot", "base", "m/s^2, rad/s^2", ""),
    ("pose_error", "pose", "m, m, rad", ""),
    ("world_error", "pose", "m, m, rad", ""),
    ("z", "base", "m/s, rad/s", ""),
    ("e", "arm", "", "rad or m"),
    ("edot", "arm", "", "rad/s or m/s"),
    ("r", "arm", "", "rad/s or m/s"),
    ("true_pose_error", "pose", "m, m, rad", ""),
    ("true_z", "base", "m/s, rad/s", ""),
    ("true_e", "arm", "", "rad or m"),
    ("nu_ref", "all", "m/s, rad/s", "rad/s or m/s"),
    ("nudot_ref", "all", "m/s^2, rad/s^2", "rad/s^2 or m/s^2"),
    ("psi", "all", "N, N m", "N m or N"),
    ("psi_hat", "all", "N, N m", "N m or N"),
    ("psi_applied", "lead all", "N, N m", "N m or N"),
    ("robust", "all", "N, N m", "N m or N"),
    ("weight_norm", "2", "", ""),
    ("effective_gain", "all", "N s/m, N m s", "N m s or N s/m"),
    ("torque", "all", "N, N m", "N m or N"),
    ("motor_torque", "motor", "N m", "N m or N"),
    ("applied", "rig motor", "N m", "N m or N"),
    ("disturbance", "rig all", "N, N m", "N m or N"),
    ("hand_force", "scene 3", "N", ""),
    ("hand_work", "scene", "J", ""),
    ("opening", "scene", "rad", ""),
    ("asked_force", "task 3", "N", ""),
    ("storage", "task", "J", ""),
    ("injected", "task", "J", ""),
    ("safety", "rig", "", ""),
    ("external_torque", "touch all", "N, N m", "N m or N"),
    ("external_band", "touch all", "N, N m", "N m or N"),
    ("external_wrench", "touch wrench", "N, N, N, N m, N m, N m", ""),
    ("wrench_seen", "touch wrench", "", ""),
    ("contact", "touch", "", ""),
    ("load", "touch", "kg", ""),
    ("energy", "1", "J", ""),
    ("work", "1", "J", ""),
    ("energy_residual", "1", "J", ""),
    ("constraint_residual", "floor", "m/s", ""),
    ("slip", "wheel", "m/s", ""),
    ("traction", "wheel", "", ""),
    ("hand_ref", "hand", "m, 1", ""),
    ("hand", "hand", "m, 1", ""),
)
# Compiled code freezes these numbers: this file is part of the key of the compiled code's cache.
INDEX = {name: i for i, (name, *_) in enumerate(SIGNALS)}
SIDEWAYS = len(SIGNALS) + 1  # behind the offsets of a layout: `Dimensions.sideways`
ALONG = ("x", "y", "u", "v", "vx", "vy")  # coordinates and velocities of a base along a line; others turn
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")  # force and moment that the world exerts on the hand, in the world
HAND = ("x", "y", "z", "qx", "qy", "qz", "qw")  # columns of a frame, in the world
EARLY = 5e-10  # half a nanosecond early counts, as times are rounded [s]


@dataclass(frozen=True)
class Dimensions:
    """Numbers of velocities, joints and motors of a robot, and its kind of base."""

    base: int  # number of base velocities nb
    arm: int  # number of arm joints n
    full: int  # number of velocities nv of the full model (pose and all joints)
    motors: int  # number of actuators
    kind: str = ""  # kind of the base, a key of `model.base.KINDS`; empty where nobody asks for it
    sideways: bool = False  # whether a twist is `(vx, vy, w)` and not `(v, w)`. Compiled code knows a base by it
    shape: int = 0  # number of measured angles on which the motions of the base depend: steering, casters, hitches

    @property
    def twist(self) -> int:
        """Number of velocities of the control frame that a reference has: 3, 2, or 0 for a fixed arm."""
        return (3 if self.sideways else 2) if self.base else 0

    @property
    def pose(self) -> int:
        """Number of pose coordinates: 3, or 0 for a fixed arm."""
        return 3 if self.base else 0

    @property
    def dof(self) -> int:
        """Number of independent velocities p."""
        return self.base + self.arm


@dataclass(frozen=True)
class Layout(Dimensions):
    """Places of the signals in a row: a robot's dimensions, and what is recorded of a run beside its motion.

    Args:
        wheels: Number of wheels whose contact is recorded; 0 on the ideal plant.
        hardware: 1 where motors, disturbances or a supervisor are simulated, else 0.
        lead: 1 where the torque has Psi_hat as of the time in which it acts (`loop.lead`), else 0.
        hands: Number of frames that the reference takes along paths.
        scene: 1 where a hand touches something (`disturbance.scene`), else 0.
        task: 1 where the hand is compliant (`compliance`), else 0.
        touch: 1 where external torque is observed, else 0.
    """

    wheels: int = 0
    hardware: int = 0
    lead: int = 0
    hands: int = 0
    scene: int = 0
    task: int = 0
    touch: int = 0

    @classmethod
    def of(cls, dimensions: Dimensions, **recorded: int) -> Layout:
        """Layout of the rows of a robot with these dimensions; what is recorded beside its motion by name."""
        d = dimensions
        return cls(d.base, d.arm, d.full, d.motors, d.kind, d.sideways, d.shape, **recorded)

    @cached_property
    def offsets(self) -> NDArray[np.int64]:
        """Start of every signal in the order of `SIGNALS`, width of the row, and `sideways`: (len(SIGNALS) + 2,)."""
        size = {"pose": self.pose, "base": self.base, "arm": self.arm, "all": self.dof, "full": self.full}
        size |= {"twist": self.twist, "shape": self.shape}
        size |= {"motor": self.motors, "wheel": self.wheels, "floor": min(1, self.wheels), "1": 1, "2": 2}
        size |= {"rig": self.hardware, "rig motor": self.hardware * self.motors, "rig all": self.hardware * self.dof}
        size |= {"scene": self.scene, "scene 3": 3 * self.scene, "task": self.task, "task 3": 3 * self.task}
        size |= {"lead all": self.lead * self.dof, "hand": len(HAND) * self.hands}
        size |= {"touch": self.touch, "touch all": self.touch * self.dof, "touch wrench": self.touch * 6}
        starts = np.cumsum([0] + [size[kind] for _, kind, *_ in SIGNALS])
        return np.append(starts, int(self.sideways))

    @cached_property
    def width(self) -> int:
        """Number of float64 in a row."""
        return int(self.offsets[len(SIGNALS)])

    def where(self, name: str) -> slice:
        """Slice of a signal in a row.

        Raises:
            KeyError: There is no signal of that name.
        """
        i = INDEX[name]
        return slice(int(self.offsets[i]), int(self.offsets[i + 1]))

    def unit(self, name: str) -> str:
        """Unit of a signal on this robot; base and arm parts separated by a semicolon."""
        _, kind, base, arm = SIGNALS[INDEX[name]]
        if kind in ("all", "rig all", "lead all", "touch all"):
            return "; ".join(u for u, used in ((base, self.base), (arm, self.arm)) if used)
        return base or arm

    def new_row(self) -> Array:
        """Row of zeros, shape (width,)."""
        return np.zeros(self.width)


class View:
    """A record whose fields are views into a row, named as the signals are, up to a suffix."""

    __slots__ = ()
    suffix: ClassVar[str] = ""

    @classmethod
    def of(cls, row: Array, layout: Layout) -> Self:
        """View of a row; nothing is copied."""
        return cls(**{f.name: row[layout.where(f.name + cls.suffix)] for f in fields(cls)})  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class Setpoint(View):
    """The reference at one instant: the signals `pose_ref` ... `qddot_ref` of a row and of a recording.

    Attributes:
        pose: (3,) pose of the control frame in the world [m, m, rad]; (0,) for a fixed arm.
        velocity: (2,) or (3,) twist in the reference's own frame [m/s, rad/s].
        acceleration: (likewise) its time derivative [m/s^2, rad/s^2].
        q: (n,) arm joints [rad or m].
        qdot: (n,) their rates [rad/s or m/s].
        qddot: (n,) their accelerations [rad/s^2 or m/s^2].

    >>> there = Setpoint(np.zeros(3), np.zeros(2), np.zeros(2), q=np.zeros(2), qdot=np.zeros(2), qddot=np.zeros(2))
    >>> there.pose.size + there.q.size
    5
    """

    suffix: ClassVar[str] = "_ref"

    pose: Array
    velocity: Array
    acceleration: Array
    q: Array
    qdot: Array
    qddot: Array

    @classmethod
    def side_by_side(cls, values: Array, dimensions: Dimensions) -> Setpoint:
        """Views into its six arrays side by side, (..., 3 + 2 twist + 3 n): a row, or the rows of a table."""
        d, parts, end = dimensions, [], 0
        for size in (d.pose, d.twist, d.twist, d.arm, d.arm, d.arm):
            parts.append(values[..., end : end + size])
            end += size
        return cls(*parts)


@dataclass(frozen=True, slots=True)
class Measurement(View):
    """The sensors' readings: all that a controller may know of the robot's state.

    Attributes:
        pose: (3,) pose of the control frame in the world, phi unwrapped [m, m, rad].
        velocity: (nb,) base velocity [m/s, rad/s].
        q: (n,) arm joints [rad or m].
        qdot: (n,) their rates [rad/s or m/s].
        shape: (pivots,) angles of steering, casters and hitches of a base that steers [rad]; else (0,).

    >>> seen = Measurement(pose=np.zeros(3), velocity=np.zeros(2), q=np.array([0.1, 0.2]), qdot=np.zeros(2))
    >>> seen.q[1]
    np.float64(0.2)
    """

    pose: Array
    velocity: Array
    q: Array
    qdot: Array
    shape: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, slots=True)
class VelocityCommand(View):
    """The kinematic layer's demand on the torque controller, thesis (3.3), (3.6), (3.10), (3.11)."""

    alpha: Array  # (nb,) commanded base velocity [m/s, rad/s]
    alphadot: Array  # (nb,) its analytic time derivative [m/s^2, rad/s^2]
    pose_error: Array  # (3,) reference minus pose, in the base frame, heading wrapped to (-pi, pi] [m, m, rad]
    world_error: Array  # (3,) the same in the world frame
    z: Array  # (nb,) `alpha - velocity`
    e: Array  # (n,) `q_ref - q`
    edot: Array  # (n,) `qdot_ref - qdot`
    r: Array  # (n,) filtered error `edot + K e`
    nu_ref: Array  # (p,) `[alpha; qdot_ref + K e]`, so that `[z; r] = nu_ref - nu`
    nudot_ref: Array  # (p,) `[alphadot; qddot_ref + K edot]`
