"""The structure of a robot: its Pinocchio model and the motions that its wheels permit.

All velocities of the full model follow from the independent ones, `nu = [base velocity; arm joint velocities]`:

    velocity = T nu        A velocity = 0        A T = 0        (2.17), (2.18)

The root is Pinocchio's planar joint, whose velocity `(vx, vy, w)` is in the body frame: T is constant, unless wheels
steer; then it follows from the angles of their pivots (`base.rolling`). Motor torques u act on the joints as `E_full u`
and on nu as `E u`, `E = T' E_full` (2.25).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..elementary.matrices import product
from ..errors import ConfigError, RobotError, UnknownName
from ..settings import one_or_each
from ..settings.arguments import faced, is_numeric, require_types, shortly
from ..signals import Array, Dimensions
from .arm import Arm
from .base.base import Base
from .base.overrides import Overrides
from .base.rolling import Maps, Rolling, closed, new_maps, roll
from .base.steered import SteeredBase, steered_rows
from .urdf.finding import Finding
from .urdf.packages import environment

MOST_FACTOR = 1e6  # by which masses and radii are scaled


@faced
@dataclass(frozen=True, eq=False)
class Structure:
    """Its Pinocchio model, its base, and the maps between its velocities. Arrays are read-only.

    Sizes: p independent velocities, nv velocities of the full model, n_u motors, nc = nv - p constraints.
    """

    name: str  # file name without its suffix
    path: Path  # the URDF file
    urdf: str  # the XML that Pinocchio read
    sha256: str  # hash of the file
    model: pin.Model  # full Pinocchio model, nothing locked away; planar root joint for a mobile base
    base: Base  # the mobile base
    arm: Arm  # the manipulator: its joints, what is locked and where, and what follows
    dimensions: Dimensions  # how many velocities, joints and motors it has
    joint_names: tuple[str, ...]  # the n arm joints in the model's order
    velocity_names: tuple[str, ...]  # names of nu, p of them
    full_velocity_names: tuple[str, ...]  # names of the model's velocities, nv of them
    actuator_names: tuple[str, ...]  # joints with a motor, n_u of them: drive wheels from left to right, then the arm
    template: Array  # (nv, p) what is constant of the map T: all of it, or all but the base's columns
    E_full: Array  # (nv, n_u) map from motor torques to joint torques
    # (nv,) first index in Pinocchio's q of each velocity's joint; 0, 1, 2 for the planar root
    q_index: NDArray[np.int64]
    # (nv,) 1 where q holds (cos, sin) of an angle, the root's heading included; else 0
    is_continuous: NDArray[np.uint8]
    frame: Array  # (3,) control frame `(x, y, heading)` in the root link's frame [m, m, rad]
    lower: Array  # (nv,) lower position limits [rad or m], -inf when unlimited
    upper: Array  # (nv,) upper position limits [rad or m], inf when unlimited
    effort_limits: Array  # (n_u,) largest motor torques [N m or N]; inf when the file states none or 0
    damping: Array  # (nv,) viscous friction of the joints [N m s or N s/m]
    # (nv,) Coulomb friction of the joints [N m or N]; on the root's yaw rate that of a skid-steer base's turning
    coulomb: Array
    viscous: Array  # (p,) further viscous friction, on nu, declared by the user
    # (nv,) position at rest: locked joints where they are locked, the others at 0 clipped into their limits
    rest: Array
    # what the audit and the understanding have to say, warnings and notes
    findings: tuple[Finding, ...] = field(default=())
    # what the user says about it, in the call and beside the file
    overrides: Overrides = field(default_factory=Overrides)
    # factors that `with_masses` put on its bodies, by the joint that carries them
    masses: Mapping[str, float] = field(default_factory=dict)
    breakaway: Array | float = 1.0  # (nv,) ratio of static to Coulomb friction, at least 1
    stribeck: float = 0.05  # velocity over which the one falls to the other [rad/s or m/s]
    # the robot as its file has it, where masses, rotors or friction were changed; None where nothing was
    origin: Structure | None = None

    def __post_init__(self) -> None:
        require_types(self)

    # -- its maps -------------------------------------------------------------------------------------------------

    @property
    def hands(self) -> tuple[str, ...]:
        """The frame at the end of every arm, that of the arm with the most joints first."""
        return tuple(hand.frame for hand in self.arm.hands)

    @property
    def steers(self) -> bool:
        """Whether its maps depend on where its wheels, casters or hitches stand."""
        return self.dimensions.shape > 0

    @property
    def T(self) -> Array:
        """(nv, p) map from nu to all velocities.

        Raises:
            RobotError: It steers.
        """
        self.require_constant("T")
        return self.template

    @cached_property
    def A(self) -> Array:
        """(nc, nv) constraint rows.

        Raises:
            RobotError: It steers.
        """
        self.require_constant("A")
        return self.A_at(self.rest)

    @cached_property
    def E(self) -> Array:
        """(p, n_u) `T' E_full`.

        Raises:
            RobotError: It steers.
        """
        self.require_constant("E")
        return read_only(product(self.T.T, self.E_full))

    def require_constant(self, what: str) -> None:
        """Refuse a robot that steers to what needs constant maps (`RobotError`)."""
        if self.steers:
            why = (
                f"its base of kind '{self.base.kind}' moves as {', '.join(self.base.shape)} stand, others do not steer"
            )
            fix = f"use {what}_at(position) in Python, or its arm alone: --base fixed"
            raise RobotError(f"'{self.name}' has no constant {what}", why=why, fix=fix)

    @cached_property
    def rows(self) -> dict[str, int]:
        """Place of every joint in a position, and its row of T."""
        root = self.dimensions.pose
        return {name: i for i, name in enumerate(self.full_velocity_names) if i >= root}

    @cached_property
    def rolling(self) -> Rolling | None:
        """Its base as arrays for `base.rolling.roll`; None where T is constant."""
        return self.base.rolling_at(self.rows) if isinstance(self.base, SteeredBase) else None

    def maps_at(self, position: ArrayLike, nu: ArrayLike | None = None) -> Maps:
        """T, its rate under nu (p,), and the motion of the base at a position (nv,)."""
        if self.rolling is None:
            return new_maps(None, self.template)
        maps = new_maps(self.rolling, self.template)
        still = np.zeros(self.dimensions.dof) if nu is None else np.array(nu, float)
        roll(self.rolling, np.array(position, float), still, maps)
        return maps

    def T_at(self, position: ArrayLike) -> Array:
        """(nv, p) map from nu to all velocities at a position (nv,)."""
        return self.template if self.rolling is None else self.maps_at(position).T

    def Tdot_at(self, position: ArrayLike, nu: ArrayLike) -> Array:
        """(nv, p) rate of T at a position (nv,) under nu (p,)."""
        return np.zeros_like(self.template) if self.rolling is None else self.maps_at(position, nu).Tdot

    def E_at(self, position: ArrayLike) -> Array:
        """(p, n_u) `T' E_full` at a position (nv,)."""
        return self.E if self.rolling is None else product(self.T_at(position).T, self.E_full)

    def A_at(self, position: ArrayLike) -> Array:
        """(nc, nv) constraint rows at a position (nv,), independent of T; more than nc where wheels repeat one."""
        if isinstance(self.base, SteeredBase):
            found = steered_rows(self.base, self.rows, np.asarray(position, float))
        else:
            found = rolling_rows(self.base, self.rows)
        return read_only(np.vstack((found, joint_rows(self.dimensions.full, self.rows, self.arm))))

    def base_velocity(self, position: ArrayLike, twist: Array) -> Array:
        """Base velocities, (nb,), with which it moves by a twist at a position (nv,), as far as its wheels permit."""
        return self.base.velocity_along(self.maps_at(position), twist) if isinstance(self.base, SteeredBase) else twist

    def steered_along(self, position: Array, twist: Array) -> Array:
        """The position with its pivots along the path of a twist, (nv,), changed in place."""
        if isinstance(self.base, SteeredBase):
            position[self.shape_index] = self.base.angles(twist)
        return self.follow(position)

    @property
    def wheel_names(self) -> tuple[str, ...]:
        """Joints of the base's wheels."""
        return tuple(wheel.joint for wheel in self.base.wheels)

    @property
    def position_names(self) -> tuple[str, ...]:
        """Names of the columns of a position, nv of them: the pose, then every joint in the model's order."""
        root = self.dimensions.pose
        return ("x", "y", "phi")[:root] + self.full_velocity_names[root:]

    @cached_property
    def arm_index(self) -> NDArray[np.int64]:
        """Places of the arm joints in a position, (n,)."""
        return np.array([self.full_velocity_names.index(name) for name in self.joint_names], dtype=np.int64)

    @cached_property
    def shape_index(self) -> NDArray[np.int64]:
        """Places of the pivots of a base that steers in a position, (shape,)."""
        return np.array([self.rows[name] for name in self.base.shape], dtype=np.int64)

    @cached_property
    def measured_index(self) -> NDArray[np.int64]:
        """Places of the joints whose angles are measured in a position: the arm's, then the pivots', (n + shape,)."""
        return np.concatenate((self.arm_index, self.shape_index))

    def configuration(self, position: ArrayLike) -> Array:
        """Pinocchio's configuration q of a position.

        Args:
            position: (nv,) pose of the control frame in the world (mobile bases), then every joint in the model's
                order; angles unwrapped [m, rad].

        Returns:
            (nq,) with the root link's pose and (cos, sin) for continuous joints.
        """
        given = np.asarray(position, dtype=float)
        q = np.zeros(self.model.nq)
        root = self.dimensions.pose
        if root:
            x, y, psi = self.frame
            heading = given[2] - psi
            c, s = np.cos(heading), np.sin(heading)
            q[:4] = given[0] - c * x + s * y, given[1] - s * x - c * y, c, s
        turns = self.is_continuous[root:].astype(bool)
        at, angles = self.q_index[root:], given[root:]
        q[at] = np.where(turns, np.cos(angles), angles)
        q[at[turns] + 1] = np.sin(angles[turns])
        return q

    def neutral_position(self) -> Array:
        """Position at rest, (nv,): locked joints where they are locked, the others at 0 clipped into their limits."""
        return self.rest.copy()

    def follow(self, position: Array) -> Array:
        """The position with its slaves (mimic joints) where their masters have them, (nv,), changed in place.

        So are wheels that follow others' steering.
        """
        names = self.full_velocity_names
        for name, slave in self.arm.slaves.items():
            position[names.index(name)] = slave.at(position[names.index(slave.master)])
        return position if self.rolling is None else closed(self.rolling, position)

    def arm_map(self) -> tuple[Array, Array]:
        """Position at rest with the arm's joints at 0, (nv,), and what each arm joint adds per unit, (nv, n).

        A slave (mimic joint) moves with its master.
        """
        offset = self.neutral_position()
        offset[self.arm_index] = 0.0
        self.follow(offset)
        columns = np.zeros((offset.size, self.dimensions.arm))
        for i, place in enumerate(self.arm_index):
            one = offset.copy()
            one[place] = 1.0
            columns[:, i] = self.follow(one) - offset
        return offset, columns

    def changed(self, **parts: Any) -> Self:
        """A copy with other masses, rotors or friction than its file has, which remembers the one of the file."""
        return replace(self, origin=self.described, **parts)

    @property
    def described(self) -> Self:
        """The robot as its file describes it, without the masses, rotors and friction that were put on it."""
        return self if self.origin is None else cast(Self, self.origin)

    def with_masses(self, factors: float | Mapping[str, float]) -> Self:
        """A copy with the inertias of its moving bodies scaled (mass and rotational inertia alike).

        Args:
            factors: One factor for all bodies, or a factor per joint that carries the body (`root` for a mobile base).

        Raises:
            ConfigError: A factor that is not positive and finite.
            UnknownName: A joint that the robot does not have.
        """
        model = self.model.copy()
        names = dict(zip(bodies_of(model), range(1, model.njoints), strict=True))
        table = factors if isinstance(factors, Mapping) else dict.fromkeys(names, factors)
        for name in table:
            if name not in names:
                raise UnknownName("body", name, names)
        table = {name: factor_of(value, f"the mass at '{name}'") for name, value in table.items()}
        for name, factor in table.items():
            scale_body(model, names[name], factor)
        masses = {**self.masses, **{name: self.masses.get(name, 1.0) * factor for name, factor in table.items()}}
        return self.changed(model=model, masses=masses)

    def with_radii(self, factors: float | Mapping[str, float]) -> Self:
        """A copy on drive wheels of other radii, its hubs as much higher, so that it stands as before.

        Args:
            factors: One factor for all drive wheels, or a factor per joint of one.

        Raises:
            ConfigError: A factor that is not positive and finite, no drive wheels, or a side whose wheels turn alike
                with several.
            UnknownName: A joint that is not a drive wheel's.
        """
        wheels = tuple(wheel.joint for wheel in self.base.wheels)
        table = dict(factors) if isinstance(factors, Mapping) else dict.fromkeys(wheels, factors)
        if not (wheels or (isinstance(factors, Real) and factors == 1.0)):
            raise ConfigError(f"'{self.name}' has no drive wheels", fix="leave it out", key="radii")
        for name in table:
            if name not in wheels:
                raise UnknownName("drive wheel", name, wheels, key="radii")
        table = {name: factor_of(value, f"'{name}'", "radii") for name, value in table.items()}
        base, model = self.base.with_radii({name: table.get(name, 1.0) for name in wheels}), self.model.copy()
        data = model.createData()
        pin.forwardKinematics(model, data, self.configuration(self.rest))
        for old, new in zip(self.base.wheels, base.wheels, strict=True):
            j = model.getJointId(old.joint)
            parent = data.oMi[model.parents[j]].rotation
            model.jointPlacements[j].translation += (new.radius - old.radius) * parent[2]
        return replace(self, model=model, base=base, template=read_only(motion_map(base, self.rows, self.arm)))

    def with_limits(self, effort: ArrayLike, speed: ArrayLike) -> Self:
        """A copy with other limits of its motors than the URDF's: who knows the robot knows them.

        Args:
            effort: Largest torques, one number or (n_u,), 0 for those of the URDF [N m or N].
            speed: Likewise [rad/s or m/s].

        Raises:
            ConfigError: A number that is negative or not finite, or not one number per motor.
        """
        motors = self.dimensions.motors
        most, fastest = (
            one_or_each(limit, motors, "motor", f"{name}_limits", least=0)
            for limit, name in ((effort, "effort"), (speed, "speed"))
        )
        if not (most.any() or fastest.any()):
            return self
        model = self.model.copy()
        speeds = np.array(model.velocityLimit)
        for name, limit in zip(self.actuator_names, fastest, strict=True):
            if limit > 0.0 and name in self.rows:
                speeds[self.rows[name]] = limit
        model.velocityLimit = speeds
        efforts = np.where(most > 0.0, most, self.effort_limits)
        efforts.flags.writeable = False
        origin = None if self.origin is None else self.origin.with_limits(effort, speed)
        return replace(self, model=model, effort_limits=efforts, origin=origin)

    def with_armature(self, inertia: ArrayLike) -> Self:
        """A copy with the rotors of its arm's motors, seen through their gears; a URDF does not know them.

        They are added to the diagonal of the mass matrix; the gyroscopic effects of their spin are left out.

        Args:
            inertia: Rotor inertia times the square of the gear ratio, one number or (n,) [kg m^2 or kg].

        Raises:
            ConfigError: A number that is negative or not finite, or not one number per joint.
        """
        rotors = one_or_each(inertia, self.dimensions.arm, "joint", "armature", least=0)
        armature = np.array(self.model.armature)
        armature[self.arm_index] = rotors
        if np.array_equal(armature, self.model.armature):
            return self
        model = self.model.copy()
        model.armature = armature
        return self.changed(model=model)

    def with_friction(self, viscous: ArrayLike) -> Self:
        """A copy with viscous friction on nu besides that of its joints.

        Args:
            viscous: (p,) coefficients, or one number for all [N s/m, N m s].

        Raises:
            ConfigError: Wrong number of coefficients, or a negative or non-finite one.
        """
        given = one_or_each(viscous, self.dimensions.dof, "velocity", "friction", least=0, names=self.velocity_names)
        return self.changed(viscous=read_only(given))

    def with_joint_friction(
        self,
        viscous: float | Sequence[float] | Array = 0.0,
        coulomb: float | Sequence[float] | Array = 0.0,
        breakaway: float | Sequence[float] | Array = 1.0,
        stribeck: float = 0.05,
    ) -> Self:
        """A copy with more friction in the gears of its arm, beside that of its URDF.

        Args:
            viscous: One number or (n,) [N m s or N s/m].
            coulomb: One number or (n,) [N m or N].
            breakaway: Ratio of static to all Coulomb friction, one number or (n,), at least 1.
            stribeck: Velocity over which static friction falls to Coulomb friction [rad/s or m/s].

        Raises:
            ConfigError: A number that is negative or not finite, a ratio below 1, or not one number per joint.
        """
        n, at = self.dimensions.arm, self.arm_index
        damping, level, ratio = self.damping.copy(), self.coulomb.copy(), np.ones(self.dimensions.full)
        damping[at] += one_or_each(viscous, n, "joint", "friction.viscous", least=0)
        level[at] += one_or_each(coulomb, n, "joint", "friction.coulomb", least=0)
        ratio[at] = one_or_each(breakaway, n, "joint", "friction.breakaway", least=1)
        if not (is_numeric(stribeck) and 0.0 < stribeck < np.inf):
            raise ConfigError(f"{stribeck}", fix="use a finite number > 0", key="friction.stribeck")
        more: dict[str, Any] = {"coulomb": read_only(level), "breakaway": read_only(ratio), "stribeck": float(stribeck)}
        return self.changed(damping=read_only(damping), **more)

    def without_friction(self) -> Self:
        """A copy with no friction at all: of its joints, of its gears, of its base."""
        none, smooth = read_only(np.zeros(self.dimensions.full)), read_only(np.ones(self.dimensions.full))
        viscous = read_only(np.zeros(self.dimensions.dof))
        return self.changed(damping=none, coulomb=none, viscous=viscous, breakaway=smooth)

    @property
    def dry(self) -> Array:
        """Dry friction of the joints, (nv, 3): Coulomb, static minus Coulomb, Stribeck velocity."""
        more = self.coulomb * (np.asarray(self.breakaway) - 1.0)
        return np.column_stack((self.coulomb, more, np.full(self.coulomb.size, self.stribeck)))

    def dry_friction(self, v: Array) -> Array:
        """Largest dry friction of every joint at its velocity v, (nv,) [N m or N]."""
        coulomb, more, speed = self.dry.T
        return coulomb + more * np.exp(-((v / speed) ** 2))

    def facts(self) -> dict[str, Any]:
        """Facts for a recording, enough for `recorded_robot` to build it again."""
        stated, ros = self.overrides.stated(), environment()
        if "package_dirs" in stated:  # who builds it again may stand in another folder
            stated["package_dirs"] = tuple(map(os.path.abspath, stated["package_dirs"]))
        return {
            "robot": self.name,
            "urdf": self.urdf,
            "urdf_file": str(self.path.absolute()),
            "urdf_sha256": self.sha256,
            "overrides": stated,
            **({"package_path": ros} if ros else {}),
            "mass_factors": dict(self.masses),
            "armature": self.model.armature[self.arm_index].tolist(),
            "viscous": self.viscous.tolist(),
            "joint_friction": {
                "damping": self.damping.tolist(),
                "coulomb": self.coulomb.tolist(),
                "breakaway": np.broadcast_to(self.breakaway, self.coulomb.shape).tolist(),
                "stribeck": self.stribeck,
            },
            "velocity_names": self.velocity_names,
            "position_names": self.position_names,
            "actuator_names": self.actuator_names,
            **({"shape_names": self.base.shape, "wheel_names": self.wheel_names} if self.steers else {}),
            "effort_limits": self.effort_limits.tolist(),
        }


def factor_of(value: Any, what: str, key: str | None = None) -> float:
    """A factor of what a robot weighs or rolls on.

    Raises:
        ConfigError: It is no number, or one that no robot needs.
    """
    is_number = isinstance(value, Real) and not isinstance(value, bool)
    if is_number and 1.0 / MOST_FACTOR <= value <= MOST_FACTOR:
        return float(value)
    fix = f"give a number from {1.0 / MOST_FACTOR:g} to {MOST_FACTOR:g}"
    raise ConfigError(f"factor {shortly(value)} for {what}", fix=fix, key=key)


def bodies_of(model: pin.Model) -> list[str]:
    """Joint that carries each moving body, `root` for a planar base."""
    names = list(model.names)[1:]
    return ["root", *names[1:]] if names and model.joints[1].shortname() == "JointModelPlanar" else names


def scale_body(model: pin.Model, joint: int, factor: float) -> None:
    """Scale the mass and the rotational inertia of the body that a joint carries."""
    body = model.inertias[joint]
    model.inertias[joint] = pin.Inertia(body.mass * factor, body.lever, body.inertia * factor)


def read_only(array: Array) -> Array:
    """The array, closed for writing."""
    array.flags.writeable = False
    return array


# -- its maps, put together from those of base and arm -----------------------------------------------------------------


def motion_map(base: Base, rows: Mapping[str, int], arm: Arm) -> Array:
    """T, (nv, p): the root moves with the base, wheels roll, the arm moves freely, slaves follow, the rest stands.

    The columns of a base that steers are 0 but for the joints that steer, and what follows these.

    Args:
        base: The mobile base.
        rows: Velocity index of every joint in the full model.
        arm: The manipulator.
    """
    nb, root = len(base.velocity_names), base.root_size
    T = np.zeros((root + len(rows), nb + len(arm.joints)))
    if not base.shape:
        T[:root, :nb] = base.root_map[:root]
        for wheel, rates in zip(base.wheels, base.wheel_map, strict=True):
            T[rows[wheel.joint], :nb] = rates
    for i, name in enumerate(base.velocity_names):
        if name in base.shape:
            T[rows[name], i] = 1.0
    for i, name in enumerate(arm.joints):
        T[rows[name], nb + i] = 1.0
    for name, slave in arm.slaves.items():
        T[rows[name]] = slave.multiplier * T[rows[slave.master]]
    return T


def rolling_rows(base: Base, rows: Mapping[str, int]) -> Array:
    """Rows on all velocities: no lateral slip of the control frame (2.6), no slip under each wheel.

    Args:
        base: A base with a constant T.
        rows: Velocity index of every joint in the full model.
    """
    root = base.root_size
    slip = np.zeros((len(base.slip_rows), root + len(rows)))
    slip[:, :root] = base.slip_rows[:, :root]
    rolling = np.zeros((len(base.wheels), root + len(rows)))
    for row, wheel, rim in zip(rolling, base.wheels, base.rolling_rows, strict=True):
        row[:root] = rim
        row[rows[wheel.joint]] = -wheel.sign * wheel.radius
    return np.vstack((slip, rolling))


def joint_rows(nv: int, rows: Mapping[str, int], arm: Arm) -> Array:
    """Rows on all velocities: locks hold, slaves follow.

    Args:
        nv: Number of velocities.
        rows: Velocity index of every joint in the full model.
        arm: The manipulator.
    """
    still = np.zeros((len(arm.locked), nv))
    for row, name in zip(still, arm.locked, strict=True):
        row[rows[name]] = 1.0
    following = np.zeros((len(arm.slaves), nv))
    for row, (name, slave) in zip(following, arm.slaves.items(), strict=True):
        row[rows[slave.master]] = -slave.multiplier
        row[rows[name]] = 1.0
    return np.vstack((still, following))


def motor_map(base: Base, rows: Mapping[str, int], motors: tuple[str, ...]) -> Array:
    """E_full, (nv, n_u): a motor on every wheel and arm joint; a base without wheels is pushed along its own axes.

    Args:
        base: The mobile base.
        rows: Velocity index of every joint in the full model.
        motors: Joints with a motor.
    """
    root = base.root_size
    nv = root + len(rows)
    on_joints = np.eye(nv)[:, [rows[name] for name in motors]]
    if not base.pushes:
        return on_joints
    pushes = np.zeros((nv, 3))
    pushes[:root] = base.to_control.T
    return np.hstack((pushes, on_joints))


def configuration_indices(model: pin.Model, root: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Place in q of each velocity's joint, and whether q holds its cosine and sine; the root fills the first 3."""
    first = 2 if root else 1
    q_index = np.array([*range(root), *list(model.idx_qs)[first:]], dtype=np.int64)
    doubled = [0, 0, 1][:root] + [int(size == 2) for size in list(model.nqs)[first:]]
    is_continuous = np.array(doubled, dtype=np.uint8)
    q_index.flags.writeable = is_continuous.flags.writeable = False
    return q_index, is_continuous
