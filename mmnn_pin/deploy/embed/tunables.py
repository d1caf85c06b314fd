"""Gains, limits and the load of the hand, which a board may change: names, units, bounds and places.

A field of a struct is a part of one or more arrays of the stepper. Such arrays are members of the controller in place
of constant tables, and the functions that set them refuse what the export has not been judged with: gains are at most
`ROOM` times those that were exported, or as much less as the sampled loop bears; limits may be lowered, not raised.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ...loop.stable_gains import holds
from ...loop.stepper import Stepper
from ...model.robot import Robot
from ...model.tree.body import body_of
from ...model.tree.motion import LINK
from ...model.tree.tree import carriers
from ...signals import Array
from ...torque.law import ROUNDING, Packed, numbers_of

ROOM = (4.0, 3.0, 2.0, 1.5, 1.25)  # times the exported gains that are tried, the largest first
SMALLEST = 1e-6  # of a limit that something is divided by


@dataclass(frozen=True)
class Tunable:
    """A field of a struct that a board may change."""

    name: str  # in C
    about: str  # its meaning and unit
    arrays: tuple[Array, ...]  # where it stands: views of one size
    least: Array  # (size,) lower bounds
    most: Array  # (size,) upper bounds; of limits what was exported


class Carrier(NamedTuple):
    """The body of a model that carries what the hand holds."""

    joint: str  # name of the joint that moves it
    row: int  # of `BodyTree.numbers`
    numbers: Array  # (3 + n, ...) of the model
    turn: Array  # (3, 3) from the frame of the joint in the URDF to that of the tree


def gains_of(stepper: Stepper) -> list[Tunable]:
    """The gains of the kinematic layer and of the feedback."""
    control, setup, found = stepper.control.controls, stepper.setup, list[Tunable]()
    kinematic, feedback = room_of(stepper)
    K = feedback_of(control.law, setup.layout.dof)
    units = ("N s/m, N m s/rad; " if setup.layout.base else "") + "N m s/rad or N s/m"
    rows = [
        (
            "base",
            "of the errors of the pose: along, across, heading [1/s, 1/m^2, 1/m; of a holonomic base 1/s]",
            (control.gains,),
            kinematic,
        ),
        ("joints", "K of r = edot + K e [1/s]", (control.K,), kinematic),
        ("feedback", f"K of tau = K s + Psi_hat [{units}]", (K,), feedback),
    ]
    for name, about, arrays, room in rows:
        if arrays[0].size:
            found.append(Tunable(name, about, arrays, np.zeros(arrays[0].size), room * arrays[0]))
    return found


def feedback_of(law: Packed, p: int) -> Array:
    """K (p,) of a law, a view; (0,) of one whose gains follow a schedule."""
    gains = numbers_of(law.settings, law.sizes).gains
    return gains[0] if gains.shape[1] == p else np.zeros(0)


def room_of(stepper: Stepper) -> tuple[float, float]:
    """How many times the gains of the kinematic layer, and those of the feedback, the sampled loop bears."""
    setup, plan = stepper.setup, stepper.judged
    if not stepper.check_gains:
        return 1.0, 1.0
    base, arm = stepper.control.controls.gains, stepper.control.controls.K
    kinematic = (r for r in ROOM if holds(replace(plan, gains=r * base, K=r * arm)))
    K = feedback_of(stepper.control.controls.law, setup.layout.dof)
    feedback = (r for r in ROOM if K.size and holds(plan, r * K))
    return next(kinematic, 1.0), next(feedback, 1.0)


def limits_of(stepper: Stepper) -> list[Tunable]:
    """The limits of motors, speeds and references; they may be lowered."""
    guide, supervisor, motors = stepper.follower.guide, stepper.hardware.way.supervisor, stepper.control.torque.limits
    layout, same = (
        stepper.setup.layout,
        motors is not None and (np.array_equal(motors.effort, (1.0 - ROUNDING) * supervisor.torque)),
    )
    twist, joint = layout.unit("velocity_ref"), layout.unit("qdot")
    bend = layout.unit("acceleration_ref")
    torque = (supervisor.torque, motors.effort) if motors is not None and same else (supervisor.torque,)
    rows: list[tuple[str, str, tuple[Array, ...]]] = [
        ("torque", "largest torques of the motors [N m or N]", torque),
        ("base_speed", f"of references that are made here [{twist}]", (guide.base[0],)),
        ("base_acceleration", f"likewise [{bend}]", (guide.base[1],)),
        ("joint_speed", f"likewise [{joint}]", (guide.arm[0],)),
        ("joint_acceleration", f"likewise [{layout.unit('qddot_ref')}]", (guide.arm[1],)),
    ]
    return [
        Tunable(name, about, arrays, np.full(arrays[0].size, SMALLEST), arrays[0].copy())
        for name, about, arrays in rows
        if arrays[0].size
    ]


def carrier_of(robot: Robot, numbers: Array) -> Carrier | None:
    """The body that carries the robot's first hand, in the tree's numbers; None where nothing moves it."""
    model = robot.model
    if not robot.hands or not model.existFrame(robot.hands[0]):
        return None
    joint = model.frames[model.getFrameId(robot.hands[0])].parentJoint
    while joint and not robot.template[model.idx_vs[joint]].any():
        joint = model.parents[joint]
    tree = body_of(robot).tree
    rows = np.flatnonzero(tree.links[:, LINK.coordinate] == model.idx_vs[joint])
    if not joint or not rows.size:
        return None
    _, at = carriers(model, robot.template, robot.neutral_position())[joint - 1]
    return Carrier(model.names[joint], int(rows[-1]), numbers, at[:3, :3])
