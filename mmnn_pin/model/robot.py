"""A robot for people: what is asked of it at a configuration, and how it shows itself.

`structure` has what it is made of, `dynamics` the equations. Here a state is what a user has: `q`, the pose of the base
and the positions of the arm's joints, and `nu`, the velocities. All that does not move by itself stands where it rests,
and mimic joints follow their masters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..elementary.matrices import inverse
from ..errors import ConfigError, UnknownName
from ..settings import Numbers, one_or_each
from ..settings.arguments import checked, checked_but, faced, is_numeric
from ..shown import ShownView, shown
from ..signals import Array
from .dynamics import Dynamics
from .structure import Structure, bodies_of


@faced
class Robot(Structure):
    """A robot, made by `load`: its model, its base, its arm, and its equations of motion.

        M(q) nudot + C(q, nu) nu + gravity(q) + friction(nu) = E motor_torques

    `q` is what places it: `[x, y, phi]` of the base's control frame in the world, phi unwrapped, then the arm's joints
    in the order of `joint_names` [m, m, rad, rad or m]; for a fixed arm the joints alone. Of a base that steers the
    angles of its steering, casters and hitches stand between them. `nu` is the base velocity in the control frame,
    `(v, w)`, or `(vx, vy, w)` of a holonomic base, or of one that steers `[u; steering rates]`, then the joints' rates,
    in the order of `velocity_names` [m/s, rad/s, rad/s or m/s]. Wheels roll: `A velocity = 0` holds for all velocities
    of the model, and `velocity = T nu` gives those that do. T is called S in the thesis and in the literature. Its
    attributes are those of `Structure`.

    >>> robot = load("platform_arm")
    >>> robot
    <Robot platform_arm: differential drive, 2 arm joints, 112 kg>
    >>> robot.q_names
    ('x', 'y', 'phi', 'arm_1_joint', 'arm_2_joint')
    >>> q = robot.neutral()
    >>> robot.mass_matrix(q).shape
    (4, 4)
    >>> robot.jacobian("arm_tip", q).shape
    (6, 4)
    """

    @property
    def q_names(self) -> tuple[str, ...]:
        """Names of the numbers of `q`, the pose before the arm's joints."""
        return ("x", "y", "phi")[: self.dimensions.pose] + self.base.shape + self.joint_names

    @property
    def q_places(self) -> NDArray[np.int64]:
        """Places of the numbers of `q` in a position."""
        return np.concatenate((np.arange(self.dimensions.pose), self.shape_index, self.arm_index))

    def neutral(self) -> Array:
        """The q of a robot at the origin whose joints rest: at 0, or at the limit that is nearest to it."""
        return self._q_of(self.neutral_position())

    @checked
    def random(self, rng: np.random.Generator | int | None = None) -> Array:
        """A q anywhere: joints evenly within their limits (a turn for those without), the base within 1 m, any heading.

        Args:
            rng: A generator, or the seed of one; None for another q every time.

        Raises:
            ConfigError: A negative seed.
        """
        if isinstance(rng, int) and rng < 0:
            raise ConfigError(f"{rng}", fix="use a seed of 0 or more", key="Robot.random.rng")
        joints, root = self.q_places[self.dimensions.pose :], self.dimensions.pose
        bounded = np.isfinite(self.upper[joints] - self.lower[joints])
        lower = np.append([-1.0, -1.0, -np.pi][:root], np.where(bounded, self.lower[joints], -np.pi))
        upper = np.append([1.0, 1.0, np.pi][:root], np.where(bounded, self.upper[joints], np.pi))
        return self._q_of(self.position(np.random.default_rng(rng).uniform(lower, upper)))

    def position(self, q: ArrayLike) -> Array:
        """The position of every joint, (nv,), `position_names` its order: q, the other joints where they rest.

        Raises:
            ConfigError: q has another length, or is not finite; with the names that it takes.
        """
        given, position = self._checked("q", q, self.q_names), self.neutral_position()
        position[self.q_places] = given
        return self.follow(position)

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Mass matrix M of base and arm, (p, p) [kg, kg m, kg m^2]; `T' M_full T` (2.23).

        Raises:
            ConfigError: q is of another length or not finite.
        """
        return Dynamics(self).mass_matrix(self.position(q))

    def coriolis(self, q: ArrayLike, nu: ArrayLike) -> Array:
        """Coriolis matrix C, (p, p), with `Mdot = C + C'`; the torque is `C @ nu`.

        Raises:
            ConfigError: q or nu is of another length or not finite.
        """
        return Dynamics(self).coriolis_matrix(self.position(q), self._nu(nu))

    def gravity(self, q: ArrayLike) -> Array:
        """Torque that holds the robot still, (p,) [N, N m].

        Raises:
            ConfigError: q is of another length or not finite.
        """
        return Dynamics(self).gravity(self.position(q))

    def friction(self, nu: ArrayLike, q: ArrayLike | None = None) -> Array:
        """Torque that overcomes the friction of joints and base, (p,) [N, N m].

        Args:
            nu: How it moves.
            q: Where it is; only a base that steers asks for it, which is at rest without.

        Raises:
            ConfigError: nu or q is of another length or not finite.
        """
        return Dynamics(self).friction(self._nu(nu), None if q is None else self.position(q))

    def psi(self, q: ArrayLike, nu: ArrayLike, nu_ref: ArrayLike, nudot_ref: ArrayLike) -> Array:
        """True Psi, which a learner has to learn: `M nudot_ref + C nu_ref + gravity + friction`, (p,) (3.20), (3.21).

        With `nu_ref = nu` it is the torque that accelerates the robot by nudot_ref.

        Args:
            q: Where it is.
            nu: How it moves.
            nu_ref: (p,) velocities that are asked for.
            nudot_ref: (p,) their derivative.

        Raises:
            ConfigError: One is of another length or not finite.
        """
        asked = self._nu(nu_ref, "nu_ref"), self._nu(nudot_ref, "nudot_ref")
        return Dynamics(self).psi(self.position(q), self._nu(nu), *asked)

    @checked_but("q")
    def placement(self, frame: str, q: ArrayLike) -> Array:
        """Placement of a link or a joint in the world, a homogeneous (4, 4) matrix [m].

        Raises:
            UnknownName: The robot has no such link or joint.
            ConfigError: q is of another length or not finite.
        """
        data, place = self.model.createData(), self._frame(frame)
        pin.framesForwardKinematics(self.model, data, self.configuration(self.position(q)))
        return np.array(data.oMf[place].homogeneous)

    @checked_but("q")
    def jacobian(self, frame: str, q: ArrayLike, *, reduced: bool = True) -> Array:
        """Jacobian of a link or a joint: its velocity is `J @ nu`, linear, then angular, in the world's axes.

        Args:
            frame: Name of a link or a joint; the velocity is that of its origin [m/s, rad/s].
            q: Where the robot is.
            reduced: To nu, the motions that wheels and mimic joints permit, (6, p); else that of Pinocchio, (6, nv), to
                all velocities, `full_velocity_names` their order. The one is the other times T.

        Raises:
            UnknownName: The robot has no such link or joint.
            ConfigError: q is of another length or not finite.
        """
        at, place = self.configuration(self.position(q)), self._frame(frame)
        full = pin.computeFrameJacobian(self.model, self.model.createData(), at, place, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(full @ self.T_at(self.position(q)) if reduced else full)

    @checked
    def view(
        self, q: ArrayLike | None = None, *, port: int = 7007, package_dirs: Sequence[str | Path] = ()
    ) -> ShownView:
        """Show it in meshcat, in colours of what was understood of it, with a slider for every joint.

        A notebook shows what is returned; in a script open its `url`. It lives until it is closed, or the process ends.

        Args:
            q: Where it stands; where it rests by default.
            port: Port to listen on, on this machine alone, or the next one that is free; 0 takes any.
            package_dirs: Folders to look for meshes in before those that it knows.

        Raises:
            ConfigError: A q of another size or not finite, or no free port.
        """
        made: ShownView = shown(self, "view", q, port=port, package_dirs=package_dirs)
        return made

    def __repr__(self) -> str:
        d, kind = self.dimensions, self.base.kind.replace("_", " ")
        joints = f"{d.arm} arm joint{'s' * (d.arm != 1)}"
        what = joints if not d.base else f"{kind}, {joints}" if d.arm else f"{kind}, no arm"
        return f"<Robot {self.name}: {what}, {self.mass:.3g} kg>"

    def _repr_html_(self) -> str:
        """A table for a notebook: the base, every arm joint with its limits; names of a file are escaped."""
        rows = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in self._joint_rows())
        heads = "".join(f"<th>{head}</th>" for head in ("arm joint", "from", "to", "effort"))
        table = f"<table><tr>{heads}</tr>{rows}</table>" if rows else ""
        return f"<p><b>{escape(repr(self).strip('<>'))}</b></p>{table}"

    @property
    def mass(self) -> float:
        """Mass of all its links [kg]."""
        return float(sum(body.mass for body in self.model.inertias))

    def _joint_rows(self) -> list[tuple[str, ...]]:
        """Name, lower and upper limit, effort limit of every arm joint."""
        limits = zip(self.lower[self.arm_index], self.upper[self.arm_index], strict=True)
        efforts = dict(zip(self.actuator_names, self.effort_limits, strict=True))
        return [
            (name, f"{low:.3g}", f"{high:.3g}", f"{efforts[name]:.3g}")
            for name, (low, high) in zip(self.joint_names, limits, strict=True)
        ]

    def _q_of(self, position: Array) -> Array:
        return position[self.q_places]

    def _nu(self, nu: ArrayLike, name: str = "nu") -> Array:
        return self._checked(name, nu, self.velocity_names)

    def _checked(self, what: str, values: ArrayLike, names: Sequence[str]) -> Array:
        """Numbers as an array, one for each name.

        Raises:
            ConfigError: Another number of them, or one that is not finite.
        """
        if not is_numeric(values):
            raise ConfigError("not a list of numbers", fix=f"give {', '.join(names)}", key=what)
        array = np.asarray(values, float)
        if array.shape != (len(names),):
            given = (
                f"{array.size} number{'s' * (array.size != 1)}"
                if array.ndim == 1
                else f"an array of shape {array.shape}"
            )
            raise ConfigError(f"{given} where {self.name} has {len(names)}", fix=f"give {', '.join(names)}", key=what)
        if not np.isfinite(array).all():
            raise ConfigError(f"{array.tolist()} is not finite", fix=f"give {', '.join(names)}", key=what)
        return array

    def _frame(self, name: str) -> int:
        """Index of a frame of the model.

        Raises:
            UnknownName: There is none of that name.
        """
        names = [frame.name for frame in self.model.frames][1:]
        if name not in names:
            raise UnknownName("link or joint", name, names)
        return int(self.model.getFrameId(name))


def carrying(robot: Robot, mass: float, joint: str = "", at: Sequence[float] = (0.0, 0.0, 0.0)) -> Robot:
    """A copy of a robot with a point mass on a link.

    Args:
        robot: The robot.
        mass: [kg].
        joint: Joint whose link carries it; empty for the last of the arm, or the base where there is no arm.
        at: Where, (3,) in that joint's frame [m].

    Raises:
        UnknownName: It has no such joint.
        ConfigError: A joint that stands still, or numbers that cannot be used.
    """
    names = bodies_of(robot.model)
    joint = joint or (robot.joint_names[-1] if robot.joint_names else "root")
    if joint not in names:
        raise UnknownName("joint", joint, names, key="joint")
    if not (np.isfinite(mass) and mass > 0 and np.shape(at) == (3,) and np.isfinite(at).all()):
        raise ConfigError(f"{mass} kg at {at}", fix="give a mass > 0 and three finite numbers", key="mass")
    model = robot.model.copy()
    i = names.index(joint) + 1
    model.inertias[i] = model.inertias[i] + pin.Inertia(mass, np.array(at, float), np.zeros((3, 3)))
    return replace(robot, model=model)


def revolute(robot: Robot) -> Array:
    """Which positions are angles, (nv,) bool."""
    root = robot.dimensions.pose
    kinds = [joint.shortname().removeprefix("JointModel") for joint in robot.model.joints][2 if root else 1 :]
    return np.array([False, False, True][:root] + ["R" in kind for kind in kinds])


def speed_limits(robot: Robot) -> Array:
    """Velocity limits of the URDF of every motor's joint, inf where it states none or 0, (motors,)."""
    names, limits = robot.full_velocity_names, robot.model.velocityLimit
    stated = [limits[names.index(name)] if name in names else math.inf for name in robot.actuator_names]
    return np.array([limit if 0 < limit < 1e30 else math.inf for limit in stated], float)


QUICK, GEARED = 1e-3, 1e-2  # [s] from rest to top speed at the effort limit: too quick for a gear, and with one
STRONGEST = 100.0  # [N m/kg] all torques of an arm over its mass; servos that weigh nothing but themselves give 50


def lacking_rotors(robot: Robot) -> tuple[str, str]:
    """Joints of the arm that lack a rotor's inertia, in words, and an option that gives some; empty where none does.

    URDF has no rotors, and a light link alone would be at its joint's top speed within microseconds. One lacks a rotor
    that would be there within `QUICK`; one with the rotor that is printed takes `GEARED`. Joints whose limits of speed
    or effort are not stated lack none. No option where the limits of effort are placeholders (`no_motors`).
    """
    names, base, arm = robot.actuator_names, robot.dimensions.base, robot.arm_index
    inertia = 1.0 / np.diag(inverse(Dynamics(robot).mass_matrix(robot.neutral_position())))[base:]
    motors = [names.index(name) for name in robot.joint_names]
    efforts, one = robot.effort_limits[motors], np.zeros(len(arm))  # inertia that takes 1 s; 0 where it is not stated
    np.divide(efforts, speed_limits(robot)[motors], out=one, where=np.isfinite(efforts))
    time = np.divide(inertia, one, out=np.full(len(arm), math.inf), where=one > 0)
    few = time < QUICK
    if not few.any():
        return "", ""
    worst, others = int(np.argmin(time)), int(few.sum()) - 1
    size = "{:.2g} kg m^2, {:g} N m" if revolute(robot)[arm][worst] else "{:.2g} kg, {:g} N"
    size = size.format(inertia[worst], efforts[worst])
    what = f"no rotors: by its link alone '{robot.joint_names[worst]}' ({size}) is at its top speed within "
    what += f"{1e6 * time[worst]:.3g} us" + (f", {others} more within 1 ms" if others else "")
    if told := no_motors(robot, efforts):
        return f"{what}; {told}", ""
    rotors = np.where(few, GEARED * one, robot.model.armature[arm])
    return what, f"--set 'armature=[{', '.join(f'{rotor:.3g}' for rotor in rotors)}]'"


def no_motors(robot: Robot, efforts: Array) -> str:
    """That no motors give the torques that an arm's limits state, in words; empty where some may.

    Args:
        robot: The robot.
        efforts: Limits of its arm's joints [N m or N], inf where none is stated, (n,).
    """
    model = robot.model
    torque = float(efforts[np.isfinite(efforts) & revolute(robot)[robot.arm_index]].sum())
    carried = {body for name in robot.joint_names for body in model.subtrees[model.getJointId(name)]}
    mass = float(sum(model.inertias[body].mass for body in carried))
    if torque <= STRONGEST * mass:
        return ""
    return f"its effort limits are placeholders: no motors of an arm of {mass:.3g} kg give {torque:.4g} N m together"


def limits(value: Literal["urdf", "none"] | Numbers | None, urdf: Array, kind: str, key: str) -> Array:
    """Limits of all motors or joints: those of the URDF, given ones, or inf for None; errors as in `one_or_each`."""
    if value == "urdf":
        return urdf
    return one_or_each(math.inf if value is None or isinstance(value, str) else value, urdf.size, kind, key)
