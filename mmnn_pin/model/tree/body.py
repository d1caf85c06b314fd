"""A known robot as arrays: its terms at a state, what compiled loops have instead of Pinocchio, and its theta.

The flattened tree is checked against Pinocchio when it is built.
"""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from ...by_address import by_address
from ...compiled import compiled, linked
from ...signals import Array, IntArray
from ..base.rolling import Maps, Rolling, new_maps, roll
from ..dynamics import feels_gravity
from ..reduction import friction, quadratic, spread
from ..regressor import inertial_parameters, moving_joints
from ..robot import Robot
from .dynamics import potential_energy, terms
from .motion import BodyTree, new_scratch, steer
from .tree import flatten


@by_address
class Body(NamedTuple):
    """A robot as arrays."""

    tree: BodyTree  # its bodies
    T: Array  # (nv, p) what is constant of the map from nu to all velocities
    damping: Array  # (nv,) viscous friction of joints
    dry: Array  # (nv, 3) dry friction of joints
    viscous: Array  # (p,) friction of nu
    places: IntArray  # of the joints whose angles are measured in a position: the arm's, then the base's pivots
    base: int  # number of base velocities
    sideways: bool  # whether a twist is `(vx, vy, w)`
    feels_gravity: bool  # whether gravity does work on it
    offset: Array  # see `Robot.arm_map`
    columns: Array  # see `Robot.arm_map`
    shape: IntArray  # (shape,) places of the base's pivots
    rolling: Rolling | None  # a base that steers, which makes the rest of T; None where T is constant


@by_address
class Work(NamedTuple):
    """Scratch memory for one robot in one thread."""

    scratch: Array
    v: Array
    M: Array
    h: Array
    F: Array
    L: Array
    rest: Array
    hold: Array
    ydot: Array
    total: Array
    trial: Array
    maps: Maps


BODIES: WeakKeyDictionary[Robot, Body] = WeakKeyDictionary()


def body_of(robot: Robot) -> Body:
    """Robot as arrays, made once per robot.

    Raises:
        RobotError: It has a joint that cannot be flattened.
    """
    if robot not in BODIES:
        BODIES[robot] = new_body(robot)
    return BODIES[robot]


def new_body(robot: Robot) -> Body:
    """Robot as arrays; its tree is checked against Pinocchio.

    Raises:
        RobotError: It has a joint that cannot be flattened.
    """
    frame = robot.frame if robot.dimensions.base else np.zeros(3)
    tree = flatten(robot.model, robot.template, robot.neutral_position(), tuple(frame), rolling=robot.rolling)
    offset, columns = robot.arm_map()
    return Body(
        tree=tree,
        T=np.array(robot.template),
        damping=np.array(robot.damping),
        dry=robot.dry,
        viscous=np.array(robot.viscous),
        places=np.array(robot.measured_index),
        base=robot.dimensions.base,
        sideways=robot.dimensions.sideways,
        feels_gravity=feels_gravity(robot),
        offset=offset,
        columns=columns,
        shape=np.array(robot.shape_index),
        rolling=robot.rolling,
    )


def new_work(body: Body) -> Work:
    """Scratch memory for a robot."""
    nv, p = body.T.shape
    size = nv + p + 1
    shapes = ((nv,), (p, p), (p,), (p,), (p, p), (p,), (nv,), (size,), (size,), (size,))
    v, M, h, F, L, rest, hold, ydot, total, trial = (np.zeros(shape) for shape in shapes)
    maps = new_maps(body.rolling, body.T)
    return Work(new_scratch(body.tree), v, M, h, F, L, rest, hold, ydot, total, trial, maps)


def parameters(robot: Robot) -> Array:
    """Parameters of a robot, (k,): `Y theta` is its Psi where dry friction is Coulomb's, without `breakaway`.

    Friction on a joint's velocity counts as friction of the joint.

    Raises:
        RobotError: A joint that cannot be flattened.
    """
    layout, T, rolling = robot.dimensions, np.array(robot.template), robot.rolling
    frame = tuple(robot.frame) if layout.base else (0.0, 0.0, 0.0)
    tree = flatten(robot.model, T, robot.neutral_position(), frame, absorb=False, rolling=rolling)
    moving, viscous = moving_joints(T, layout.base, rolling), robot.damping.copy()
    viscous[robot.arm_index] += robot.viscous[layout.base :]
    return np.concatenate(
        (
            inertial_parameters(tree, layout.base),
            robot.model.armature[moving],
            robot.viscous[: layout.base],
            viscous[moving],
            robot.coulomb[moving],
            robot.coulomb[2:3] if robot.base.scrubs else (),
        )
    )


@compiled
def turn_wheels(rolling: Rolling | None, tree: BodyTree, position: Array, nu: Array, work: Work) -> None:
    """Write the maps of a base that steers at a state where its dynamics read them."""
    if rolling is not None:
        roll(rolling, position, nu, work.maps)
        steer(tree, work.maps.T, work.maps.Tdot, work.scratch)


@linked
def evaluate(body: Body, work: Work, position: Array, nu: Array) -> None:
    """M, `h = C nu + gravity + friction`, friction F and `v = T nu` at a state."""
    turn_wheels(body.rolling, body.tree, position, nu, work)
    terms(body.tree, position, nu, work.scratch, work.M, work.h)
    spread(work.maps.T, nu, work.v)
    friction(work.maps.T, work.v, nu, body.damping, body.dry, body.viscous, work.F)
    for i in range(nu.size):
        work.h[i] += work.F[i]


@linked
def energy_of(body: Body, work: Work, position: Array, nu: Array) -> float:
    """Kinetic and potential energy at a state [J]; the work's terms become those of that state."""
    evaluate(body, work, position, nu)
    potential = potential_energy(body.tree, position, work.scratch) if body.feels_gravity else 0.0
    return float(0.5 * quadratic(work.M, nu) + potential)
