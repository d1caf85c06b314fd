"""The constant maps of a robot: T from nu to all velocities, A that vanishes on them, E from motors.

Sizes: p independent velocities, nv of the full model, n_u motors, nc = nv - p constraints; `A T = 0`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mmnn_pin.model.arm import Arm
from mmnn_pin.signals import Array

from .base import Base


def motion_map(base: Base, rows: Mapping[str, int], arm: Arm) -> Array:
    """T, (nv, p): the root moves with the base, wheels roll, the arm moves freely, slaves follow, the rest stands.

    Args:
        base: The mobile base.
        rows: Velocity index of every joint in the full model.
        arm: The manipulator.
    """
    nb, root = len(base.velocity_names), root_size(base)
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
    root = root_size(base)
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
    root = root_size(base)
    nv = root + len(rows)
    on_joints = np.eye(nv)[:, [rows[name] for name in motors]]
    if not is_pushed(base):
        return on_joints
    pushes = np.zeros((nv, 3))
    pushes[:root] = base.to_control.T
    return np.hstack((pushes, on_joints))


def is_pushed(base: Base) -> bool:
    """Whether forces on its frame drive a mobile base, in the place of wheels."""
    return base.kind == "holonomic" and not base.wheels


def root_size(base: Base) -> int:
    """Number of velocities of the root joint."""
    return 0 if base.kind == "fixed" else 3
