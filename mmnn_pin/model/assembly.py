"""A robot put together of its parts: names, indices, limits and the maps T, A and E."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..signals import Array, Layout
from .arm import Arm
from .base.base import Base
from .base.maps import constraint_rows, is_pushed, motion_map, motor_map, root_size
from .robot import Robot, read_only
from .urdf.parsing import Document

ROOT_NAMES = ("root_vx", "root_vy", "root_w")
PUSHES = ("base_x", "base_y", "base_turn")  # motors of a base without wheels


def assemble(document: Document, base: Base, arm: Arm, model: pin.Model) -> Robot:
    """Robot of an audited URDF, its base, its arm and its full Pinocchio model."""
    root = root_size(base)
    joints = [document.joints[name] for name in model.names[2 if root else 1 :]]
    names = [joint.name for joint in joints]
    arm = replace(arm, joints=tuple(name for name in names if name in arm.joints))
    motors = (*(wheel.joint for wheel in base.wheels), *arm.joints)
    pushes = PUSHES if is_pushed(base) else ()
    rows = {name: root + i for i, name in enumerate(names)}
    T, E_full = motion_map(base, rows, arm), motor_map(base, rows, motors)
    q_index, is_continuous = configuration_indices(model, root)

    def per_velocity(attribute: str, of_root: float) -> Array:
        return read_only(np.array([of_root] * root + [getattr(joint, attribute) for joint in joints]))

    effort = [np.inf] * len(pushes) + [document.joints[name].effort for name in motors]
    robot = Robot(
        name=document.path.stem,
        path=document.path,
        urdf=document.text,
        sha256=document.sha256,
        model=model,
        base=base,
        arm=arm,
        layout=Layout(base=len(base.velocity_names), arm=len(arm.joints), full=model.nv, motors=E_full.shape[1]),
        joint_names=arm.joints,
        velocity_names=base.velocity_names + arm.joints,
        full_velocity_names=ROOT_NAMES[:root] + tuple(names),
        actuator_names=pushes + motors,
        T=read_only(T),
        A=read_only(constraint_rows(base, rows, arm)),
        E_full=read_only(E_full),
        E=read_only(T.T @ E_full),
        q_index=q_index,
        is_continuous=is_continuous,
        frame=read_only(base.frame.copy()),
        lower=per_velocity("lower", -np.inf),
        upper=per_velocity("upper", np.inf),
        effort_limits=read_only(np.array(effort, dtype=float)),
        damping=per_velocity("damping", 0.0),
        coulomb=per_velocity("friction", 0.0),
        viscous=read_only(np.zeros(T.shape[1])),
        rest=np.zeros(model.nv),
    )
    at_rest = [0.0] * root + [arm.locked.get(joint.name, joint.rest) for joint in joints]
    return replace(robot, rest=read_only(robot.follow(np.array(at_rest, dtype=float))))


def configuration_indices(model: pin.Model, root: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Where each velocity's joint starts in q, and whether q holds its cosine and sine; the root fills the first 3."""
    first = 2 if root else 1
    q_index = np.array([*range(root), *list(model.idx_qs)[first:]], dtype=np.int64)
    doubled = [0, 0, 1][:root] + [int(size == 2) for size in list(model.nqs)[first:]]
    is_continuous = np.array(doubled, dtype=np.uint8)
    q_index.flags.writeable = is_continuous.flags.writeable = False
    return q_index, is_continuous
