"""A robot in MuJoCo: its tree, its free base and its friction, made from its Pinocchio model.

A body per joint with the same placement, axis and inertia; locked joints are welds, mimic joints equalities, as are the
wheels of a skid-steer side, which a chain or a gear turns alike; the root is free. Every contact is an explicit pair,
because otherwise MuJoCo takes the larger friction of two shapes.

Of the free base MuJoCo keeps the root link's position and quaternion (w, x, y, z) and its linear velocity in the
world's axes, its angular velocity in its own: `v_mj = diag(R, I) v_pin`. Friction follows the same laws as in
`model.reduction.friction`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ...elementary import arrays, atan2, cos, cos_sin, hypot, sin
from ...errors import ConfigError, RobotError
from ...model.reduction import COULOMB_SPEED
from ...model.robot import Robot
from ...signals import Array
from .feet import Contact, Feet, Foot, at_origin, turning_axis

SOFT_CASTER = ((0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0))  # solref, solimp: MuJoCo's defaults
RIGID_IMPEDANCE = (0.99, 0.99, 0.001, 0.5, 2.0)
NO_FRICTION = 1e-5  # the least that MuJoCo takes
TOUCH = 1e-7  # how far the feet start in the floor, so that contacts exist from the first step on [m]
MASSLESS = 1e-12  # [kg, kg m^2], what a moving body without mass gets


def engine() -> Any:
    """The module `mujoco`.

    Raises:
        ConfigError: It is not installed.
    """
    try:
        import mujoco
    except ImportError:
        why, fix = "MuJoCo is not installed", "pip install 'mmnn_pin[contact]'"
        raise ConfigError("the contact plant cannot run", why=why, fix=fix, key="plant") from None
    return mujoco


def compile_tree(robot: Robot, feet: Feet, contact: Contact, dt: float) -> Any:
    """MuJoCo's model (`mjModel`) of a robot on the floor.

    Args:
        robot: The robot.
        feet: What touches the floor.
        contact: Friction and stiffness.
        dt: Step of the engine [s].

    Raises:
        ConfigError: MuJoCo is not installed.
        RobotError: MuJoCo refuses the robot, such as for an inertia that no body can have.
    """
    mj = engine()
    spec = mj.MjSpec()
    set_options(mj, spec, robot, dt)
    bodies = add_bodies(mj, spec, robot)
    add_motors(mj, spec, robot)
    add_ties(mj, spec, robot)
    add_contacts(mj, spec, bodies, feet, robot.base.floor, contact, dt)
    try:
        return spec.compile()
    except ValueError as error:
        why = " ".join(str(error).split())
        fix = "mmnn inspect lists impossible inertias"
        raise RobotError(f"MuJoCo refuses '{robot.name}'", why=why, fix=fix, file=robot.path) from None


def set_options(mj: Any, spec: Any, robot: Robot, dt: float) -> None:
    """Step, gravity and solver; an unstable run must not restart by itself."""
    option = spec.option
    option.timestep, option.gravity = dt, np.array(robot.model.gravity.linear)
    option.solver, option.cone = mj.mjtSolver.mjSOL_NEWTON, mj.mjtCone.mjCONE_ELLIPTIC
    option.impratio, option.tolerance, option.iterations = 10.0, 1e-12, 100
    option.disableflags = int(mj.mjtDisableBit.mjDSBL_AUTORESET)


def add_bodies(mj: Any, spec: Any, robot: Robot) -> list[Any]:
    """One body per joint of the Pinocchio model, the world first."""
    model, data = robot.model, robot.model.createData()
    mobile = robot.dimensions.base > 0
    pin.forwardKinematics(model, data, robot.configuration(at_origin(robot) if mobile else robot.rest))
    bodies = [spec.worldbody]
    for j in range(1, model.njoints):
        name, root = model.names[j], mobile and j == 1
        locked = name in robot.arm.locked
        place = pin.SE3.Identity() if root else data.liMi[j] if locked else model.jointPlacements[j]
        body = bodies[model.parents[j]].add_body(name=f"{name} body", pos=place.translation, quat=wxyz(place.rotation))
        set_inertia(body, model.inertias[j], locked)
        if root:
            body.add_freejoint(name=name)
        elif not locked:
            slides = model.joints[j].shortname().startswith("JointModelP")
            kind = mj.mjtJoint.mjJNT_SLIDE if slides else mj.mjtJoint.mjJNT_HINGE
            armature = float(model.armature[model.idx_vs[j]])
            body.add_joint(name=name, type=kind, axis=turning_axis(data, j), armature=armature)
        bodies.append(body)
    return bodies


def wxyz(rotation: Any) -> Any:
    """(4,) MuJoCo's quaternion of a rotation."""
    return np.roll(pin.Quaternion(rotation).coeffs(), 1)


def set_inertia(body: Any, inertia: pin.Inertia, welded: bool) -> None:
    """Mass, centre of mass and inertia about it; a moving body without any gets next to nothing."""
    about = inertia.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    if not welded:
        about[:3] += MASSLESS * (inertia.mass == 0)
    body.explicitinertial = True
    body.mass = inertia.mass or (0.0 if welded else MASSLESS)
    body.ipos, body.fullinertia = inertia.lever, about


def add_motors(mj: Any, spec: Any, robot: Robot) -> None:
    """A motor of gain 1 on every joint that has one, in the order of `Robot.actuator_names`."""
    for name in robot.actuator_names:
        spec.add_actuator(name=name, target=name, trntype=mj.mjtTrn.mjTRN_JOINT)


def add_ties(mj: Any, spec: Any, robot: Robot) -> None:
    """A stiff equality for every mimic joint that moves, and one that turns the wheels of a side alike."""
    ties = [(name, slave.master, slave.offset, slave.multiplier) for name, slave in robot.arm.slaves.items()]
    if robot.base.scrubs:
        for side in (1.0, -1.0):
            first, *others = (wheel for wheel in robot.base.wheels if wheel.y * side > 0)
            rim = first.sign * first.radius
            ties += [(wheel.joint, first.joint, 0.0, rim / (wheel.sign * wheel.radius)) for wheel in others]
    for name, master, offset, multiplier in ties:
        tie = spec.add_equality(type=mj.mjtEq.mjEQ_JOINT, objtype=mj.mjtObj.mjOBJ_JOINT)
        tie.name1, tie.name2 = name, master
        tie.data[:5] = offset, multiplier, 0.0, 0.0, 0.0
        tie.solref, tie.solimp = (2 * spec.option.timestep, 1.0), RIGID_IMPEDANCE


def add_contacts(mj: Any, spec: Any, bodies: list[Any], feet: Feet, height: float, contact: Contact, dt: float) -> None:
    """The floor and one pair per foot, named `wheel 0`, ..., `caster 0`, ..."""
    rigid = (2 * dt, 1.0), RIGID_IMPEDANCE
    stiffness = {"wheel": rigid, "caster": rigid if contact.casters == "rigid" else SOFT_CASTER}
    if feet.wheels:
        plane = mj.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(name="floor", type=plane, size=[0, 0, 1], pos=[0, 0, height], contype=0, conaffinity=0)
    named: list[tuple[str, int, Foot]] = [("wheel", i, foot) for i, foot in enumerate(feet.wheels)]
    named += [("caster", i, foot) for i, foot in enumerate(feet.casters)]
    for kind, i, foot in named:
        sphere = mj.mjtGeom.mjGEOM_SPHERE
        name = f"{kind} {i}"
        bodies[foot.joint].add_geom(
            name=name, type=sphere, size=[foot.radius, 0, 0], pos=foot.centre, contype=0, conaffinity=0
        )
        pair = spec.add_pair(name=name, geomname1="floor", geomname2=name, condim=3 if kind == "wheel" else 1)
        pair.solref, pair.solimp = stiffness[kind]
        mu = max(NO_FRICTION, contact.friction)
        pair.friction = [mu, mu, NO_FRICTION, NO_FRICTION, NO_FRICTION]


@dataclass(frozen=True, eq=False)
class BaseMotion:
    """Where the control frame is and how it moves.

    Attributes:
        pose: (3,) in the world, heading in (-pi, pi] [m, m, rad].
        velocity: (3,) forward, to the left, and about the vertical [m/s, m/s, rad/s].
        rotation: (3, 3) axes of the root link in the world.
        lever: (3,) from the root link's origin to that of the control frame, in the world's axes [m].
    """

    pose: Array
    velocity: Array
    rotation: Array
    lever: Array


class FreeBase:
    """Converts between the free joint's coordinates and the control frame's.

    Args:
        robot: A mobile robot.
    """

    def __init__(self, robot: Robot) -> None:
        x, y, self.psi = robot.frame
        self.origin = np.array([x, y, robot.base.floor])  # of the control frame, in the root link
        self.from_control = np.linalg.inv(robot.base.to_control)

    def place(self, pose: Array, velocity: Array, qpos: Array, qvel: Array) -> None:
        """Write a level base on the floor into MuJoCo's state.

        Args:
            pose: (3,) of the control frame.
            velocity: (3,) planar velocity of the root link in its own axes, as Pinocchio's planar joint has it.
            qpos: (7,) written.
            qvel: (6,) written.
        """
        heading = pose[2] - self.psi
        c, s = cos_sin(heading)
        x, y, _ = self.origin
        qpos[:3] = pose[0] - c * x + s * y, pose[1] - s * x - c * y, -TOUCH
        qpos[3:] = cos(heading / 2), 0.0, 0.0, sin(heading / 2)
        vx, vy, w = velocity
        qvel[:] = c * vx - s * vy, s * vx + c * vy, 0.0, 0.0, 0.0, w

    def motion(self, qpos: Array, qvel: Array) -> BaseMotion:
        """The control frame's motion at MuJoCo's state (7,), (6,)."""
        R = rotation(qpos[3:])
        lever, omega = R @ self.origin, R @ qvel[3:]
        v = qvel[:3] + cross(omega, lever)
        heading = atan2(R[1, 0], R[0, 0]) + self.psi
        c, s = cos_sin(heading)
        pose = np.array([qpos[0] + lever[0], qpos[1] + lever[1], heading])
        return BaseMotion(pose, np.array([c * v[0] + s * v[1], c * v[1] - s * v[0], omega[2]]), R, lever)


def rotation(quaternion: Array) -> Array:
    """(3, 3) rotation of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def tilt(quaternion: Array) -> float:
    """Angle of the z axis of a unit quaternion (w, x, y, z) from the vertical [rad]."""
    return 2 * math.asin(min(1.0, hypot(quaternion[1], quaternion[2])))


def cross(a: Array, b: Array) -> Array:
    """`a x b` of two (3,); numpy's takes fifty times as long."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


class ContactFriction:
    """Friction of a robot: in the joints as a damping, which MuJoCo's Euler takes implicitly, on the base as a force.

    Args:
        robot: The robot.
        moving: (k,) places of the moving joints in the velocities of our model.
        at: (k,) places of the same in MuJoCo's.
        model: MuJoCo's model, whose damping is written.
    """

    def __init__(self, robot: Robot, moving: Array, at: Array, model: Any) -> None:
        viscous = np.zeros(robot.dimensions.full)
        viscous[robot.arm_index] = robot.viscous[robot.dimensions.base :]
        self.model, self.at = model, at
        self.damping, self.dry = (robot.damping + viscous)[moving], robot.dry[moving]
        self.base = robot.viscous[: robot.dimensions.base]
        self.held = False
        self.has_coulomb, self.has_breakaway = self.dry[:, :2].any(axis=0).tolist()
        self.on_base = bool(self.base.any())
        model.dof_damping[at] = self.damping

    def apply(self, data: Any, motion: BaseMotion | None, hold: Array) -> None:
        """Write damping, and add the force on the base, for the next step; hold (k,) is friction of blocked joints."""
        if self.has_coulomb or hold.any() or self.held:
            self.held = bool(hold.any())
            v = data.qvel[self.at]
            slow = np.abs(v) < 1e-6 * COULOMB_SPEED
            level = hold + self.dry[:, 0]
            if self.has_breakaway:
                level = level + self.dry[:, 1] * arrays.exp(-((v / self.dry[:, 2]) ** 2))
            ratio = arrays.tanh(v / COULOMB_SPEED) / np.where(slow, 1.0, v)
            self.model.dof_damping[self.at] = self.damping + level * np.where(slow, 1 / COULOMB_SPEED, ratio)
        if self.on_base and motion is not None:
            v, _, w = motion.velocity
            on_base(data, motion, -self.base[0] * v, -self.base[1] * w)

    def power(self, data: Any, motion: BaseMotion | None) -> float:
        """Power that friction takes at this velocity [W]."""
        lost = float(self.model.dof_damping[self.at] @ data.qvel[self.at] ** 2)
        if self.on_base and motion is not None:
            v, _, w = motion.velocity
            lost += float(self.base[0] * v**2 + self.base[1] * w**2)
        return lost


def on_base(data: Any, motion: BaseMotion, forward: float, turning: float) -> None:
    """Add a force along the heading at the control frame [N], and a torque about the vertical [N m]."""
    c, s = cos_sin(motion.pose[2])
    force = np.array([c * forward, s * forward, 0.0])
    moment = cross(motion.lever, force)
    moment[2] += turning
    data.qfrc_applied[:3] += force
    data.qfrc_applied[3:6] += motion.rotation.T @ moment
