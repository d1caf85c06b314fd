"""`load(name or path) -> Robot`: a URDF read and audited, its base and arm found, its model built and checked.

Pinocchio's model has nothing locked away, and mimic joints are joints of their own. The constant maps T from nu to all
velocities, A that vanishes on them and E from motors are put together from those of the base and the arm. Sizes: p
independent velocities, nv of the full model, n_u motors, nc = nv - p constraints.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from ..compiled import one_thread
from ..elementary.matrices import product
from ..errors import RobotError
from ..settings.arguments import checked
from ..signals import Array, Dimensions
from .arm import Arm
from .base.base import Base
from .base.overrides import Overrides, folders_of, with_file
from .base.report import friction_notes, printed_notes, rotor_notes, settle, weak_notes
from .base.rolling import FREE
from .base.steered import SteeredBase
from .base.understanding import understand
from .dynamics import Dynamics
from .hands import placed
from .robot import Robot, lacking_rotors
from .robots import find
from .structure import configuration_indices, motion_map, motor_map, read_only
from .urdf.audit import BodyPart
from .urdf.document import Document, Joint
from .urdf.finding import Finding, excused
from .urdf.reading import read
from .urdf.shapes import AtRest

ROOT_NAMES = ("root_vx", "root_vy", "root_w")
_stderr_lock = threading.Lock()
STATES = 8
SINGULAR = 1e-12  # smallest eigenvalue of the mass matrix scaled to a unit diagonal
INDISTINCT = 1e-15  # smallest eigenvalue over the largest entry, unscaled: less is lost in a double
LEAST = 1e-18  # eigenvalue of M of anything that moves [kg or kg m^2]


@checked
def load(  # noqa: PLR0913 - options of a file, by name
    robot: str | Path,
    *,
    base: str | None = None,
    wheels: Sequence[str] | None = None,
    radius: float | None = None,
    wheel_radii: Sequence[str] = (),
    track: float | None = None,
    roller: float | None = None,
    lock: Sequence[str] = (),
    free: Sequence[str] = (),
    arm: str | None = None,
    arm_tip: str | None = None,
    package_dirs: Sequence[str | Path] = (),
    xacro: Sequence[str] = (),
    without: Sequence[str] = (),
    strict: bool = False,
    controllers_file: str | Path | None = None,
    mu: float | None = None,
    steer: Sequence[str] | None = None,
    hitch: Sequence[str] | None = None,
    wheelbase: float | None = None,
    steering_limit: float | None = None,
    forward: str | None = None,
) -> Robot:
    """Load a robot. What is not given comes from `NAME.mmnn.toml` beside it or is found in it (docs/how-to/robots.md).

    Args:
        robot: Name of a bundled robot or of one of example-robot-data, or path of a URDF or xacro file.
        base: One of `mmnn_pin.model.base.KINDS`, such as `differential_drive`, `car_like` or `fixed`.
        wheels: Joints of the drive wheels; of two on one axle the left one first.
        radius: Radius of the drive wheels [m].
        wheel_radii: Radius of single drive wheels, `joint=radius` [m].
        track: Lateral distance of the drive wheels [m]; of a skid-steer base the effective one.
        roller: Angle of the rollers of a holonomic base [rad], see `Overrides`.
        lock: Joints that stand still: `joint` where it rests, or `joint=position` [rad or m].
        free: Joints of heads, jaws and sensors to free, which are locked by default; `all` for all.
        arm: `left` or `right` to lock the joints of the other of two arms, `both` for none.
        arm_tip: Link at the end of the arm; joints that do not lead to it are locked.
        package_dirs: Folders that hold the packages of `package://` meshes and of xacro files.
        xacro: Arguments of a xacro file, `NAME:=VALUE`.
        without: Macros of a xacro file to leave out, because a package is missing.
        strict: Whether impossible inertias and implausible sizes are errors.
        controllers_file: YAML file of the robot's controllers, see `Overrides`.
        mu: Friction coefficient between the floor and the wheels of a skid-steer base, 1 by default.
        steer: Joints that steer, about vertical axes above wheels.
        hitch: Joints on which trailers follow.
        wheelbase: Distance from the fixed axle to the wheels that steer [m].
        steering_limit: Largest angle of what steers, to either side [rad].
        forward: The axis of the root link along which the base drives forward: `x`, `-x`, `y` or `-y`.

    Raises:
        UnknownName: Neither a name nor a path; a joint, link or kind of base that does not exist.
        ConfigError: Something said that does not suit the robot, or a file of overrides that cannot be read.
        RobotError: The file cannot be used, the base is undecided or of a kind not supported; with the line.

    >>> robot = load("platform_arm")
    >>> robot.base.kind, robot.joint_names
    ('differential_drive', ('arm_1_joint', 'arm_2_joint'))
    """
    overrides = Overrides(
        base=base,
        wheels=None if wheels is None else tuple(wheels),
        radius=radius,
        wheel_radii=tuple(wheel_radii),
        track=track,
        roller=roller,
        lock=tuple(lock),
        free=tuple(free),
        arm=arm,
        arm_tip=arm_tip,
        package_dirs=tuple(map(str, package_dirs)),
        xacro=tuple(xacro),
        without=tuple(without),
        strict=strict,
        controllers_file=None if controllers_file is None else str(controllers_file),
        mu=mu,
        steer=None if steer is None else tuple(steer),
        hitch=None if hitch is None else tuple(hitch),
        wheelbase=wheelbase,
        steering_limit=steering_limit,
        forward=forward,
    )
    return load_with(robot, overrides)


def load_with(robot: str | Path, overrides: Overrides) -> Robot:
    """`load` with all that is said in one; arguments and errors as there."""
    path = find(robot)
    overrides, notes = with_file(path, overrides)
    folders = folders_of(path, overrides)
    document = read(path, overrides.strict, folders, overrides.xacro, overrides.without)
    built = build(document, overrides)
    return replace(built, findings=(*built.findings, *notes))


@one_thread
def build(document: Document, overrides: Overrides | None = None) -> Robot:
    """Robot of an audited URDF.

    Args:
        document: The URDF.
        overrides: What the user says about it.

    Raises:
        UnknownName: A joint or link that does not exist.
        ConfigError: Something said that does not suit the robot.
        RobotError: The base is undecided or of a kind not supported, or the dynamics are singular.
    """
    overrides = overrides or Overrides()
    moving = {j.name for j in document.joints.values() if j.moves}
    if moving and moving <= {f.joint for f in document.findings if f.code == "zero-mass"}:
        excused(document.findings, ())  # a file without masses is told as that, before its base is looked for
    roles = understand(document, overrides)
    document, base, arm = placed(roles.document, roles.arm.hands), roles.base, roles.arm
    model, printed = pinocchio_model(document, mobile=base.root_size > 0)
    audited = excused(document.findings, arm.locked, arm.joints, alone=not base.columns, rolls=base.joints)
    rolling = {f.joint for f in audited if f.code == "zero-inertia"}
    require_sane(document, model, {*arm.locked, *rolling})
    findings = (*settle(audited, (*roles.findings, *roles.notes)), *printed_notes(roles.rest, printed))
    said = settled(msgspec.structs.replace(overrides, **roles.taken), base)
    robot = replace(assemble(document, base, arm, model), findings=findings, overrides=said)
    require_finite(document, robot)
    return replace(robot, findings=(*findings, *strength_notes(roles.rest, robot)))


def strength_notes(rest: AtRest, robot: Robot) -> list[Finding]:
    """Motors that cannot hold their joints where the robot rests, no friction, and joints without rotors."""
    held = Dynamics(robot).gravity(robot.neutral_position())[robot.dimensions.base :]
    limits = dict(zip(robot.actuator_names, robot.effort_limits, strict=True))
    efforts = np.array([limits[name] for name in robot.joint_names])
    weak = weak_notes(rest, robot.joint_names, held, efforts)
    return [*weak, *friction_notes(rest, robot.damping, robot.coulomb), *rotor_notes(rest, *lacking_rotors(robot))]


def settled(overrides: Overrides, base: Base) -> Overrides:
    """The overrides with a controllers' file replaced by what it led to: a recording stands alone."""
    if overrides.controllers_file is None:
        return overrides
    result: dict[str, Any] = {"base": base.kind, "controllers_file": None}
    if isinstance(base, SteeredBase):
        steer = tuple(pivot.joint for pivot in base.pivots if pivot.role != "passive")
        hitch = tuple(pivot.joint for pivot in base.pivots if pivot.role == "passive" and not pivot.motor)
        result |= {"wheels": tuple(w.joint for w in base.wheels if w.driven), "steer": steer or None}
        result["hitch"] = hitch if base.body != FREE and hitch else None
    elif base.wheels:
        result |= {"wheels": tuple(wheel.joint for wheel in base.wheels), "track": base.track}
        alike = len({wheel.radius for wheel in base.wheels}) == 1 and not overrides.wheel_radii
        result["radius"] = base.wheels[0].radius if alike else overrides.radius
    return msgspec.structs.replace(overrides, **result)


# -- Pinocchio's model -------------------------------------------------------------------------------------------------


def pinocchio_model(document: Document, mobile: bool) -> tuple[pin.Model, str]:
    """Full Pinocchio model, on a planar root joint for a mobile base, and what its parser printed.

    Raises:
        RobotError: Pinocchio refuses the file, or loses a mass of it; what it printed is attached.
    """
    root_name = "root_joint"
    while root_name in document.joints:
        root_name += "_"
    root = (pin.JointModelPlanar(), root_name) if mobile else ()
    try:
        with captured_stderr() as printed:
            model = pin.buildModelFromXML(document.text, *root)
    except (ValueError, RuntimeError) as error:
        why = " ".join(" ".join([*printed, str(error)]).split())
        raise RobotError("Pinocchio cannot build the model", why=why, file=document.path) from None
    model.name, message = document.path.stem, " ".join(" ".join(printed).split())
    stated, taken = document.mass, sum(body.mass for body in model.inertias)
    if not math.isclose(stated, taken, rel_tol=1e-9):
        what = f"Pinocchio's model has {taken:.6g} kg where the file states {stated:.6g} kg"
        raise RobotError(what, why=message or "it lost an <inertial>", file=document.path)
    place(document, model)
    return model, message


def place(document: Document, model: pin.Model) -> None:
    """Put joints and inertias of a model where the file has them, by our own sines and cosines.

    Pinocchio's parser takes roll, pitch and yaw through the platform's; the two differ in the last place at most.
    """
    index = {name: j for j, name in enumerate(model.names) if j}  # 0 is the universe, whose name a joint may have, too

    def carried(link: str) -> tuple[int, Array]:
        """The joint of the model that carries a link, 0 for none, and the link's placement on it."""
        at = np.eye(4)
        while link in document.carrier:
            joint = document.carrier[link]
            if joint.name in index:
                return index[joint.name], at
            at, link = product(joint.origin, at), joint.parent
        return int(model.njoints > 1 and model.nvs[1] == 3), at

    for name, j in index.items():
        if name in document.joints:
            joint = document.joints[name]
            model.jointPlacements[j] = pin.SE3(product(carried(joint.parent)[1], joint.origin))
    sums = {j: pin.Inertia.Zero() for j in range(1, model.njoints)}
    for name, link in document.links.items():
        j, at = carried(name)
        if j and link.find("inertial") is not None:
            part = BodyPart.of(link, at)
            R = part.frame[:3, :3]
            inertia = pin.Inertia.Zero()  # filled, not constructed: what is not positive is judged later
            inertia.mass, inertia.lever, inertia.inertia = part.mass, part.frame[:3, 3], product(R, part.inertia, R.T)
            sums[j] += inertia
    for j, inertia in sums.items():
        model.inertias[j] = inertia


@contextmanager
def captured_stderr() -> Iterator[list[str]]:
    """Lines that C++ code prints on standard error meanwhile; the list is filled on leaving."""
    lines: list[str] = []
    with _stderr_lock, tempfile.TemporaryFile() as file:
        sys.stderr.flush()
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            lines += file.read().decode(errors="replace").splitlines()


# -- the robot and its maps --------------------------------------------------------------------------------------------


def assemble(document: Document, base: Base, arm: Arm, model: pin.Model) -> Robot:
    """Robot of an audited URDF, its base, its arm and its full Pinocchio model."""
    root = base.root_size
    joints = [document.joints[name] for name in model.names[2 if root else 1 :]]
    names = [joint.name for joint in joints]
    arm = replace(arm, joints=tuple(name for name in names if name in arm.joints))
    driven = (name for name in base.driven if document.joints[name].mimics is None)
    motors = (*driven, *arm.joints)
    pushes, rows = base.pushes, {name: i for i, name in enumerate(names, root)}
    T, E_full = motion_map(base, rows, arm), motor_map(base, rows, motors)
    q_index, is_continuous = configuration_indices(model, root)
    at_rest = [0.0] * root + [arm.locked.get(joint.name, joint.rest) for joint in joints]
    robot = Robot(
        name=document.path.stem,
        path=document.path,
        urdf=document.text,
        sha256=document.sha256,
        model=model,
        base=base,
        arm=arm,
        dimensions=Dimensions(
            base=len(base.velocity_names),
            arm=len(arm.joints),
            full=model.nv,
            motors=E_full.shape[1],
            kind=base.kind,
            sideways=base.sideways,
            shape=len(base.shape),
        ),
        joint_names=arm.joints,
        velocity_names=base.velocity_names + arm.joints,
        full_velocity_names=ROOT_NAMES[:root] + tuple(names),
        actuator_names=pushes + motors,
        template=read_only(T),
        E_full=read_only(E_full),
        q_index=q_index,
        is_continuous=is_continuous,
        frame=read_only(base.frame.copy()),
        lower=with_stops(of_joints(joints, root, "lower", -np.inf), base, rows, "lower"),
        upper=with_stops(of_joints(joints, root, "upper", np.inf), base, rows, "upper"),
        effort_limits=read_only(np.array([np.inf] * len(pushes) + [document.joints[n].effort for n in motors], float)),
        damping=of_joints(joints, root, "damping", 0.0),
        coulomb=with_turning(of_joints(joints, root, "friction", 0.0), base),
        viscous=read_only(np.zeros(T.shape[1])),
        rest=np.array(at_rest, dtype=float),
    )
    read_only(robot.follow(robot.rest))
    return robot


def of_joints(joints: list[Joint], root: int, attribute: str, of_root: float) -> Array:
    """A number of every joint, read-only, (nv,); the root's velocities have one of their own."""
    return read_only(np.array([of_root] * root + [getattr(joint, attribute) for joint in joints]))


def with_stops(limits: Array, base: Base, rows: dict[str, int], end: str) -> Array:
    """Limits of every joint, (nv,), those of steering as the base has them: the user may have stated them."""
    if not isinstance(base, SteeredBase):
        return limits
    stopped = limits.copy()
    for pivot in base.pivots:
        stopped[rows[pivot.joint]] = getattr(pivot, end)
    return read_only(stopped)


def with_turning(coulomb: Array, base: Base) -> Array:
    """Coulomb friction of every joint, (nv,), with the base's friction against turning on the root's yaw rate."""
    if not base.turning:
        return coulomb
    full = coulomb.copy()
    full[2] += base.turning
    return read_only(full)


# -- is it fit to be driven --------------------------------------------------------------------------------------------


def require_sane(document: Document, model: pin.Model, still: set[str]) -> None:
    """Hold M and the forward dynamics against non-finite numbers and singularity at rest and random states.

    Args:
        document: The URDF, for the line of the body to blame.
        model: Its full model.
        still: Joints that stand still: what they alone would feel is no matter.

    Raises:
        RobotError: M or the acceleration is not finite, or M is not positive definite; names the body.
    """
    data, rng = model.createData(), np.random.default_rng(0)
    q0, rest = pin.neutral(model), np.zeros(model.nv)
    held = [j.idx_v + k for n, j in zip(model.names, model.joints, strict=True) if n in still for k in range(j.nv)]
    for k in range(STATES):
        q = pin.integrate(model, q0, rng.uniform(-np.pi, np.pi, model.nv)) if k else q0
        velocity = rng.uniform(-1.0, 1.0, model.nv) if k else rest
        M = pin.crba(model, data, q)
        M = np.triu(M) + np.triu(M, 1).T
        M[held], M[:, held] = 0.0, 0.0
        M[held, held] = np.abs(M).max(initial=0.0) or 1.0
        if not np.isfinite(M).all():
            raise blame(document, model, ~np.isfinite(M).all(axis=1), "the mass matrix is not finite")
        for matrix, least in ((scaled(M), SINGULAR), (M, max(LEAST, INDISTINCT * np.abs(M).max(initial=0.0)))):
            values, vectors = np.linalg.eigh(matrix)
            if values.min(initial=np.inf) <= least:
                what = f"the mass matrix is singular or not positive definite (smallest eigenvalue {values[0]:.3g})"
                raise blame(document, model, np.abs(vectors[:, 0]), what)
        forces = pin.nonLinearEffects(model, data, q, velocity)
        with np.errstate(all="ignore"):
            acceleration = -np.linalg.solve(M, np.where(np.isin(range(model.nv), held), 0.0, forces))
        if not np.isfinite(acceleration).all():
            raise blame(document, model, ~np.isfinite(acceleration), "the forward dynamics are not finite")


def require_finite(document: Document, robot: Robot) -> None:
    """Hold the reduced mass matrix and the reduced forces at rest against numbers that are not finite.

    Radii, mimic multipliers and what they multiply enter only there.

    Raises:
        RobotError: One is not finite, or the mass matrix is not positive definite.
    """
    model, T, p = robot.model, robot.T_at(robot.neutral_position()), robot.dimensions.dof
    data, q = model.createData(), robot.configuration(robot.neutral_position())
    with np.errstate(all="ignore"):
        M = np.triu(pin.crba(model, data, q))
        M = T.T @ (M + np.triu(M, 1).T) @ T
        forces = T.T @ pin.nonLinearEffects(model, data, q, T @ np.ones(p))
    if not (np.isfinite(M).all() and np.isfinite(forces).all()):
        what = "the dynamics of base and arm are not finite"
    elif np.linalg.eigvalsh(scaled(M)).min(initial=np.inf) <= SINGULAR:
        what = "the mass matrix of base and arm is singular"
    else:
        return
    why = "a wheel's radius, a mimic multiplier or a mass is beyond what a double holds"
    raise RobotError(what, why=why, fix="check them", file=document.path)


def scaled(M: Array) -> Array:
    """M with a unit diagonal where it is positive, so that kg and g m^2 count alike."""
    diagonal = np.diag(M)
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    with np.errstate(over="ignore", invalid="ignore"):
        result = M * scale * scale[:, None]
    return np.where(np.isfinite(result), result, 0.0)


def blame(document: Document, model: pin.Model, guilt: Array, what: str) -> RobotError:
    """The error that names the body of the velocity with the most guilt, the last of equals.

    Args:
        document: The URDF.
        model: Its full model.
        guilt: (nv,) how much each velocity is to blame.
        what: What is wrong.
    """
    index = len(guilt) - 1 - int(np.argmax(np.asarray(guilt, dtype=float)[::-1]))
    name = next(
        n for n, joint in zip(model.names, model.joints, strict=True) if joint.idx_v <= index < joint.idx_v + joint.nv
    )
    joint = document.joints.get(name)
    body = "the root's body" if joint is None else f"link '{joint.child}', moved by joint '{name}'"
    link = document.links[document.root_link if joint is None else joint.child]
    return RobotError(
        f"{body}: {what}",
        why="its inertia is zero, next to nothing or beyond what a double holds",
        fix="check its <inertial>, and those of what hangs on it",
        file=document.path,
        line=link.sourceline,
    )
