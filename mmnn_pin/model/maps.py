"""The constant maps of a robot, put together from those of its base and its arm.

T takes nu to the velocities of all joints, A vanishes on what T reaches, E takes motors to joints.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..signals import Array
from .arm import Arm
from .base.base import Base


def configuration_indices(model: pin.Model, root: int) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Where each velocity's joint starts in q, and whether q holds its cosine and sine; the root fills the first 3."""
    first = 2 if root else 1
    q_index = np.array([*range(root), *list(model.idx_qs)[first:]], dtype=np.int64)
    doubled = [0, 0, 1][:root] + [int(size == 2) for size in list(model.nqs)[first:]]
    is_continuous = np.array(doubled, dtype=np.uint8)
    q_index.flags.writeable = is_continuous.flags.writeable = False
    return q_index, is_continuous


def motion_map(base: Base, rows: Mapping[str, int], arm: Arm) -> Array:
    """T, (nv, p): the root moves with the base, wheels roll, the arm moves freely, slaves follow, the rest stands.

    Args:
        base: The mobile base.
        rows: Velocity index of every joint in the full model.
        arm: The manipulator.
    """
    nb, root = len(base.velocity_names), base.root_size
    T = np.zeros((root + len(rows), nb + len(arm.joints)))
    T[:root, :nb] = base.root_map[:root]
    for wheel, rates in zip(base.wheels, base.wheel_map, strict=True):
        T[rows[wheel.joint], :nb] = rates
    for i, name in enumerate(arm.joints):
        T[rows[name], nb + i] = 1.0
    for name, slave in arm.slaves.items():
        T[rows[name]] = slave.multiplier * T[rows[slave.master]]
    return T


def constraint_rows(base: Base, rows: Mapping[str, int], arm: Arm) -> Array:
    """A, (nc, nv): no lateral slip of the control frame (2.6), no slip under each wheel, slaves follow, locks hold.

    Args:
        base: The mobile base.
        rows: Velocity index of every joint in the full model.
        arm: The manipulator.
    """
    root = base.root_size
    slip = np.zeros((len(base.slip_rows), root + len(rows)))
    slip[:, :root] = base.slip_rows[:, :root]
    rolling = np.zeros((len(base.wheels), root + len(rows)))
    for row, wheel, rim in zip(rolling, base.wheels, base.rolling_rows, strict=True):
        row[:root] = rim
        row[rows[wheel.joint]] = -wheel.sign * wheel.radius
    still = np.zeros((len(arm.locked), root + len(rows)))
    for row, name in zip(still, arm.locked, strict=True):
        row[rows[name]] = 1.0
    following = np.zeros((len(arm.slaves), root + len(rows)))
    for row, (name, slave) in zip(following, arm.slaves.items(), strict=True):
        row[rows[slave.master]] = -slave.multiplier
        row[rows[name]] = 1.0
    return np.vstack((slip, rolling, still, following))


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
