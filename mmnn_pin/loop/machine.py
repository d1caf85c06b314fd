"""A robot as arrays for compiled code: the true one, which moves, and the one that a controller believes in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..by_address import by_address
from ..model.robot import Robot
from ..model.tree.body import Body, Work, body_of, new_work
from ..plant.integrators import PlantJoints, PlantTerms, plant_joints, plant_terms
from ..signals import Array


@by_address
class Machine(NamedTuple):
    """A robot in motion: its body, also with its payload, memory to work in and views of it, position, nu.

    Not `torque.controller.Machine`, which is what a controller may be told of one.
    """

    body: Body
    loaded: Body
    work: Work
    terms: PlantTerms
    joints: PlantJoints
    y: Array
    position: Array
    nu: Array


def new_machine(robot: Robot, loaded: Robot | None, position: Array, nu: Array) -> Machine:
    """A robot at a position (nv,) with velocity nu (p,).

    Raises:
        RobotError: It has a joint that cannot be flattened.
    """
    body, y, nv = body_of(robot), np.concatenate((position, nu, [0.0])), position.size
    work = new_work(body)
    terms = plant_terms(work.v, work.M, work.h, work.F, work.hold, work.ydot)
    joints = plant_joints((body.damping, body.dry, body.viscous), body.base, body.sideways, work.maps)
    with_load = body if loaded is None else body_of(loaded)
    return Machine(body, with_load, work, terms, joints, y, y[:nv], y[nv : nv + nu.size])
