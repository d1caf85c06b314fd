"""`load(name or path) -> Robot`: a Pinocchio model and the motions that its wheels permit.

All velocities of the full model follow from the independent ones, `nu = [base velocity; arm joint velocities]`:

    velocity = T nu        A velocity = 0        A T = 0        (2.17), (2.18)

T is constant because the root is Pinocchio's planar joint, whose velocity `(vx, vy, w)` is in the body frame. Motor
torques u act on the joints as `E_full u` and on nu as `E u`, `E = T' E_full` (2.25).
"""

from __future__ import annotations

import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

import mmnn_pin
from mmnn_pin.errors import ConfigError, RobotError, UnknownName
from mmnn_pin.model.base import Base, find_base
from mmnn_pin.model.urdf import Document, read
from mmnn_pin.signals import Array, Layout

ROOT_NAMES = ("root_vx", "root_vy", "root_w")
_stderr_lock = threading.Lock()


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot: its Pinocchio model, its base, and the maps between its velocities. Arrays are read-only.

    Sizes: p independent velocities, nv velocities of the full model, n_u motors, nc = nv - p constraints.

    Attributes:
        name: File name without its suffix.
        path: The URDF file.
        urdf: The XML that Pinocchio read.
        sha256: Hash of the file.
        model: Full Pinocchio model, nothing locked away; planar root joint for a mobile base.
        base: The mobile base.
        layout: Sizes of all signals.
        joint_names: The n arm joints in the model's order.
        velocity_names: Names of nu, p of them.
        full_velocity_names: Names of the model's velocities, nv of them.
        actuator_names: Joints with a motor, n_u of them: drive wheels from left to right, then the arm.
        T: (nv, p) map from nu to all velocities.
        A: (nc, nv) constraint rows.
        E_full: (nv, n_u) map from motor torques to joint torques.
        E: (p, n_u) `T' E_full`.
        q_index: (nv,) first index in Pinocchio's q of each velocity's joint; 0, 1, 2 for the planar root.
        is_continuous: (nv,) 1 where q holds (cos, sin) of an angle, the root's heading included; else 0.
        frame: (3,) control frame `(x, y, heading)` in the root link's frame [m, m, rad].
        lower: (nv,) lower position limits [rad or m], -inf when unlimited.
        upper: (nv,) upper position limits [rad or m], inf when unlimited.
        effort_limits: (n_u,) largest motor torques [N m or N]; inf when the file states none or 0.
        damping: (nv,) viscous friction of the joints [N m s or N s/m].
        coulomb: (nv,) Coulomb friction of the joints [N m or N].
        viscous: (p,) further viscous friction, on nu, declared by the user.
    """

    name: str
    path: Path
    urdf: str
    sha256: str
    model: pin.Model
    base: Base
    layout: Layout
    joint_names: tuple[str, ...]
    velocity_names: tuple[str, ...]
    full_velocity_names: tuple[str, ...]
    actuator_names: tuple[str, ...]
    T: Array
    A: Array
    E_full: Array
    E: Array
    q_index: NDArray[np.int64]
    is_continuous: NDArray[np.uint8]
    frame: Array
    lower: Array
    upper: Array
    effort_limits: Array
    damping: Array
    coulomb: Array
    viscous: Array

    @property
    def position_names(self) -> tuple[str, ...]:
        """Names of the columns of a position, nv of them: the pose, then every joint in the model's order."""
        root = self.layout.pose
        return ("x", "y", "phi")[:root] + self.full_velocity_names[root:]

    @cached_property
    def arm_index(self) -> NDArray[np.int64]:
        """Places of the arm joints in a position, (n,)."""
        return np.array([self.full_velocity_names.index(name) for name in self.joint_names], dtype=np.int64)

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
        root = self.layout.pose
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
        """Position at rest, (nv,): 0 clipped into the limits."""
        return np.clip(0.0, self.lower, self.upper)

    def with_masses(self, factors: float | Mapping[str, float]) -> Robot:
        """The same robot with the inertias of its moving bodies scaled (mass and rotational inertia alike).

        Args:
            factors: One factor for all bodies, or a factor per joint that carries the body (`root` for a mobile base).

        Raises:
            ConfigError: A factor that is not positive and finite.
            UnknownName: A joint that the robot does not have.
        """
        model = self.model.copy()
        names = dict(zip(bodies_of(model), range(1, model.njoints), strict=True))
        table = factors if isinstance(factors, Mapping) else dict.fromkeys(names, factors)
        for name, factor in table.items():
            if name not in names:
                raise UnknownName("body", name, names)
            if not (np.isfinite(factor) and factor > 0):
                raise ConfigError(f"factor {factor} for the mass at '{name}'", fix="give a finite number > 0")
            body = model.inertias[names[name]]
            model.inertias[names[name]] = pin.Inertia(body.mass * factor, body.lever, body.inertia * factor)
        return replace(self, model=model)

    def with_friction(self, viscous: ArrayLike) -> Robot:
        """The same robot with viscous friction on nu besides that of its joints.

        Args:
            viscous: (p,) coefficients, or one number for all [N s/m, N m s].

        Raises:
            ConfigError: Wrong number of coefficients, or a negative or non-finite one.
        """
        p = self.layout.dof
        given = np.asarray(viscous, dtype=float)
        if given.shape not in ((), (p,)) or not np.all(np.isfinite(given) & (given >= 0)):
            raise ConfigError(
                f"viscous friction {given.tolist()} cannot be used",
                fix=f"give {p} finite coefficients >= 0, for {', '.join(self.velocity_names)}",
            )
        return replace(self, viscous=read_only(np.broadcast_to(given, p).copy()))


def bodies_of(model: pin.Model) -> list[str]:
    """Joint that carries each moving body, `root` for a planar base."""
    names = list(model.names)[1:]
    return ["root", *names[1:]] if names and model.joints[1].shortname() == "JointModelPlanar" else names


def bundled() -> dict[str, Path]:
    """The robots that come with the package: name to URDF file."""
    package = Path(mmnn_pin.__file__).parent
    folder = next((f for f in (package / "urdf", package.parent / "urdf") if f.is_dir()), package / "urdf")
    return {file.stem: file for file in sorted(folder.glob("*.urdf"))}


def load(robot: str | Path) -> Robot:
    """Load a robot.

    Args:
        robot: Name of a bundled robot, or path of a URDF file.

    Raises:
        UnknownName: Neither a bundled robot nor a path.
        RobotError: The file cannot be used; says why, with the line.
    """
    if isinstance(robot, str) and robot in bundled():
        return build(read(bundled()[robot]))
    path = Path(robot)
    if isinstance(robot, str) and not (path.suffix or os.sep in robot or path.exists()):
        raise UnknownName("robot", robot, bundled())
    return build(read(path))


def build(document: Document) -> Robot:
    """Robot of an audited URDF.

    Raises:
        RobotError: The base is undecided, a joint is of a kind not supported, or the dynamics are singular.
    """
    base = find_base(document)
    refuse_unsupported(document)
    model = pinocchio_model(document, mobile=base.kind != "fixed")
    check_dynamics(document, model)
    return assemble(document, base, model)


def refuse_unsupported(document: Document) -> None:
    """Refuse joints that this version cannot drive.

    Raises:
        RobotError: A mimic, floating or planar joint.
    """
    for joint in document.joints.values():
        if joint.type in ("floating", "planar") or (joint.mimics is not None and joint.moves):
            kind = "mimic" if joint.mimics is not None else joint.type
            raise RobotError(
                f"joint '{joint.name}' is a {kind} joint, which is not supported",
                fix="make it fixed" if kind == "mimic" else "make it fixed, a mobile base needs no joint to the world",
                file=document.path,
                line=joint.line,
            )


def pinocchio_model(document: Document, mobile: bool) -> pin.Model:
    """Full Pinocchio model, on a planar root joint for a mobile base.

    Raises:
        RobotError: Pinocchio refuses the file; what it printed is attached.
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
    model.name = document.path.stem
    return model


@contextmanager
def captured_stderr() -> Iterator[list[str]]:
    """What C++ code prints on standard error meanwhile; the list is filled on leaving."""
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


def check_dynamics(document: Document, model: pin.Model) -> None:
    """Hold the mass matrix at rest against non-finite entries and singularity.

    Raises:
        RobotError: It is not finite or not positive definite.
    """
    M = pin.crba(model, model.createData(), pin.neutral(model))
    M = np.triu(M) + np.triu(M, 1).T
    smallest = -np.inf
    if np.all(np.isfinite(M)) and np.all(np.diag(M) > 0):
        scale = 1 / np.sqrt(np.diag(M))  # kilograms and gram metres squared alike become 1
        smallest = np.linalg.eigvalsh(M * np.outer(scale, scale)).min(initial=1.0)
    if smallest < 1e-12:
        raise RobotError(
            "the mass matrix is not positive definite",
            why="an inertia is zero, negative or impossible",
            fix="check the inertials",
            file=document.path,
        )


def assemble(document: Document, base: Base, model: pin.Model) -> Robot:
    """Robot of its parts: names, indices, limits and the maps T, A and E."""
    root = 0 if base.kind == "fixed" else 3
    joints = [document.joints[name] for name in model.names[2 if root else 1 :]]
    names = [joint.name for joint in joints]
    standing = {*base.locked, *(wheel.joint for wheel in base.wheels)}
    arm = tuple(name for name in names if name not in standing)
    motors = (*(wheel.joint for wheel in base.wheels), *arm)
    rows = {name: root + i for i, name in enumerate(names)}
    T, A = motion_map(base, rows, arm), constraint_rows(base, rows)
    E_full = np.eye(model.nv)[:, [rows[name] for name in motors]]
    q_index, is_continuous = configuration_indices(model, root)

    def per_velocity(attribute: str, of_root: float) -> Array:
        return read_only(np.array([of_root] * root + [getattr(joint, attribute) for joint in joints]))

    return Robot(
        name=document.path.stem,
        path=document.path,
        urdf=document.text,
        sha256=document.sha256,
        model=model,
        base=base,
        layout=Layout(base=len(base.velocity_names), arm=len(arm), full=model.nv, motors=len(motors)),
        joint_names=arm,
        velocity_names=base.velocity_names + arm,
        full_velocity_names=ROOT_NAMES[:root] + tuple(names),
        actuator_names=motors,
        T=read_only(T),
        A=read_only(A),
        E_full=read_only(E_full),
        E=read_only(T.T @ E_full),
        q_index=q_index,
        is_continuous=is_continuous,
        frame=read_only(base.frame.copy()),
        lower=per_velocity("lower", -np.inf),
        upper=per_velocity("upper", np.inf),
        effort_limits=read_only(np.array([document.joints[name].effort for name in motors])),
        damping=per_velocity("damping", 0.0),
        coulomb=per_velocity("friction", 0.0),
        viscous=read_only(np.zeros(T.shape[1])),
    )


def motion_map(base: Base, rows: dict[str, int], arm: tuple[str, ...]) -> Array:
    """T, (nv, p): the root moves with the control frame, wheels roll, arm joints move freely, the rest stands still.

    Args:
        base: The mobile base.
        rows: Velocity index of every joint in the full model.
        arm: The arm joints.
    """
    nb, root = len(base.velocity_names), 0 if base.kind == "fixed" else 3
    T = np.zeros((root + len(rows), nb + len(arm)))
    T[:root, :nb] = base.root_map[:root]
    for wheel, rates in zip(base.wheels, base.wheel_map, strict=True):
        T[rows[wheel.joint], :nb] = rates
    for i, name in enumerate(arm):
        T[rows[name], nb + i] = 1.0
    return T


def constraint_rows(base: Base, rows: dict[str, int]) -> Array:
    """A, (nc, nv): no lateral slip of the control frame (2.6), no slip under each drive wheel, locked joints stand.

    Args:
        base: The mobile base.
        rows: Velocity index of every joint in the full model.
    """
    root = 0 if base.kind == "fixed" else 3
    lateral, rolling, still = len(base.slip_rows), len(base.wheels), len(base.locked)
    A = np.zeros((lateral + rolling + still, root + len(rows)))
    A[:lateral, :root] = base.slip_rows[:, :root]
    for i, (wheel, forward) in enumerate(zip(base.wheels, base.rolling_rows, strict=True), start=lateral):
        A[i, :root] = forward
        A[i, rows[wheel.joint]] = -wheel.sign * wheel.radius
    for i, name in enumerate(base.locked, start=lateral + rolling):
        A[i, rows[name]] = 1.0
    return A


def configuration_indices(model: pin.Model, root: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Where each velocity's joint starts in q, and whether q holds its cosine and sine; the root fills the first 3."""
    first = 2 if root else 1
    q_index = np.array([*range(root), *list(model.idx_qs)[first:]], dtype=np.int64)
    doubled = [0, 0, 1][:root] + [int(size == 2) for size in list(model.nqs)[first:]]
    is_continuous = np.array(doubled, dtype=np.uint8)
    q_index.flags.writeable = is_continuous.flags.writeable = False
    return q_index, is_continuous


def read_only(array: Array) -> Array:
    """The array, closed for writing."""
    array.flags.writeable = False
    return array
