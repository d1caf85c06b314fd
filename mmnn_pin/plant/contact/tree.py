"""A robot in MuJoCo: its tree and what touches the floor, made from its Pinocchio model.

A body per joint with the same placement, axis and inertia; locked joints are welds, mimic joints equalities, as are the
wheels of a skid-steer side, which a chain or a gear turns alike; the root is free. Every contact is an explicit pair,
because otherwise MuJoCo takes the larger friction of two shapes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ...errors import ConfigError, RobotError
from ...model.base.rolling import FOLLOWER, ROLES
from ...model.base.steered import SteeredBase
from ...model.robot import Robot
from .feet import Contact, Feet, Foot, at_origin, on_rollers, turning_axis

SOFT_CASTER = ((0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0))  # solref, solimp: MuJoCo's defaults
RIGID_IMPEDANCE = (0.99, 0.99, 0.001, 0.5, 2.0)
NO_FRICTION = 1e-5  # the least that MuJoCo takes
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
    add_contacts(mj, spec, bodies, feet, robot, contact, dt)
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
    """A stiff equality for every joint that follows another: mimic joints that move, wheels of a side, steered wheels.

    The curve of a steered one changes as it moves (`pivots`).
    """
    ties = [(name, slave.master, slave.offset, slave.multiplier) for name, slave in robot.arm.slaves.items()]
    if isinstance(robot.base, SteeredBase):
        followers = [pivot.joint for pivot in robot.base.pivots if pivot.role == ROLES[FOLLOWER]]
        ties += [(name, robot.base.pivots[robot.base.masters[0]].joint, 0.0, 1.0) for name in followers]
    if robot.base.scrubs:
        for side in (1.0, -1.0):
            first, *others = (wheel for wheel in robot.base.wheels if wheel.y * side > 0)
            rim = first.sign * first.radius
            ties += [(wheel.joint, first.joint, 0.0, rim / (wheel.sign * wheel.radius)) for wheel in others]
    for name, master, offset, multiplier in ties:
        tie = spec.add_equality(name=tie_of(name), type=mj.mjtEq.mjEQ_JOINT, objtype=mj.mjtObj.mjOBJ_JOINT)
        tie.name1, tie.name2 = name, master
        tie.data[:5] = offset, multiplier, 0.0, 0.0, 0.0
        tie.solref, tie.solimp = (2 * spec.option.timestep, 1.0), RIGID_IMPEDANCE


def tie_of(joint: str) -> str:
    """Name of the equality of a joint that follows another."""
    return f"{joint} follows"


def add_contacts(mj: Any, spec: Any, bodies: list[Any], feet: Feet, robot: Robot, contact: Contact, dt: float) -> None:
    """The floor and one pair per foot, named `wheel 0`, ..., `caster 0`, ..."""
    rigid = (2 * dt, 1.0), RIGID_IMPEDANCE
    stiffness = {"wheel": rigid, "caster": rigid if contact.casters == "rigid" else SOFT_CASTER}
    if feet.wheels:
        plane = mj.mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(
            name="floor", type=plane, size=[0, 0, 1], pos=[0, 0, robot.base.floor], contype=0, conaffinity=0
        )
    named: list[tuple[str, int, Foot]] = [("wheel", i, foot) for i, foot in enumerate(feet.wheels)]
    named += [("caster", i, foot) for i, foot in enumerate(feet.casters)]
    for kind, i, foot in named:
        sphere = mj.mjtGeom.mjGEOM_SPHERE
        name = f"{kind} {i}"
        bodies[foot.joint].add_geom(
            name=name, type=sphere, size=[foot.radius, 0, 0], pos=foot.centre, contype=0, conaffinity=0
        )
        grips = kind == "wheel" and not on_rollers(robot)
        pair = spec.add_pair(name=name, geomname1="floor", geomname2=name, condim=3 if grips else 1)
        pair.solref, pair.solimp = stiffness[kind]
        mu = max(NO_FRICTION, contact.friction)
        pair.friction = [mu, mu, NO_FRICTION, NO_FRICTION, NO_FRICTION]
