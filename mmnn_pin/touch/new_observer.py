"""The observer of one robot, made from its settings."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..elementary import exp
from ..errors import ConfigError, UnknownName
from ..model.regressor import BODY, Regressor
from ..model.robot import Robot
from ..model.tree.body import body_of, evaluate, new_work, parameters
from ..model.tree.motion import AT, BASE, LINK
from ..model.tree.tree import configuration
from ..signals import Array, Dimensions, IntArray
from .observer import BOTH, DEADZONE, FROZEN, LEARNER, LOAD, ON, URDF, Feeler, TouchNumbers, TouchState
from .settings import Touch

MODELS = {"urdf": URDF, "learner": LEARNER, "both": BOTH}
LEARNING = {"on": ON, "frozen": FROZEN, "deadzone": DEADZONE}


class Sending(NamedTuple):
    """How a torque reaches the robot.

    Attributes:
        period: Control period [s].
        every: Samples from one measurement to the next.
        way: Known time from the command of a torque to the measurement that shows it [s].
        lag: (p,) time constants of the motors, seen from the velocities [s].
        most: (motors,) known limits of the motors [N m or N], inf for none.
        E: (p, motors) torque on nu from motor torques.
        E_inv: (motors, p) and back.
        felt: (p,) 1 where a torque is sent, 0 where a servo holds a velocity.
        gains: (p,) feedback on the velocities, by which small torques are measured.
        gives: Whether the robot gives way to contact.
        eases: Whether its feedback is eased back after that.
        loads: Whether its hand may carry a load; one that pushes does not.
    """

    period: float
    every: int
    way: float
    lag: Array
    most: Array
    E: Array
    E_inv: Array
    felt: Array
    gains: Array
    gives: bool = False
    eases: bool = True
    loads: bool = True


def touch_shapes(
    regressor: Regressor, layout: Dimensions, way: float, period: float, saved: int
) -> tuple[tuple[int, ...], ...]:
    """Shapes of the parts of a `TouchState`.

    Args:
        regressor: How the robot moves.
        layout: Its sizes.
        way: As of `Sending` [s].
        period: Control period [s].
        saved: Size of what a learner knows, 0 where it is not to go back.
    """
    p, groups = layout.dof, len(groups_of(regressor)) - 1
    vectors = ((p,),) * 7
    load = (LOAD, p), (LOAD,), (LOAD + 1, LOAD + 1)
    sent = (1 + math.ceil(way / period), p), (p,)
    return (13,), *vectors, (2, p), (p,), *((groups, p),) * 3, *load, (p, p), (p, p), (2, saved), *sent


def new_state(parts: list[Array]) -> TouchState:
    """The state in some arrays of `touch_shapes`, as it is before the first sample."""
    state = TouchState._make(parts)
    state.learned[0, 0] = -1.0
    return state


def new_feeler(touch: Touch, robot: Robot, regressor: Regressor, sending: Sending, state: TouchState) -> Feeler:
    """The observer of a robot as its file describes it.

    Args:
        touch: Settings.
        robot: The robot.
        regressor: How it moves.
        sending: How a torque reaches it.
        state: What the observer remembers.

    Raises:
        RobotError: A joint that cannot be flattened.
        UnknownName: No such hand.
        ConfigError: A hand that no torque moves; a robot of servos alone.
    """
    from scipy.special import chdtri  # slow to import

    if not sending.felt.any():
        why, fix = "servos hold all its velocities", "use interface 'effort', or leave [touch] out"
        raise ConfigError(f"'{robot.name}' feels nothing by its motors", why=why, fix=fix, key="touch")
    body, layout, theta = body_of(robot), robot.dimensions, parameters(robot)
    work, p, h = new_work(body), layout.dof, sending.period
    ends, count = groups_of(regressor), len(regressor.joints)
    doubt = np.where(np.arange(len(ends) - 1) < len(regressor.bodies) + count, touch.masses, touch.friction)
    first = theta.size - count - int(robot.base.scrubs)
    numbers = TouchNumbers(
        h=float(h),
        every=int(sending.every),
        bandwidth=float(touch.bandwidth),
        threshold=float(chdtri(sending.felt.sum(), touch.false_alarms)),
        model=MODELS[touch.model],
        late=float(sending.way / h),
        torque=float(touch.torque),
        clear=float(touch.clear),
        settle=float(touch.settle),
        freezes=LEARNING[touch.learning],
        gives=int(sending.gives),
        eases=int(sending.eases),
        yields=float(touch.yields),
        back=float(touch.back),
        heaviest=float(sum(theta[BODY * k] for k, name in enumerate(regressor.bodies) if name in robot.joint_names)),
    )
    carrier, place = hand_of(touch.hand, robot)
    gains = np.array(sending.gains, float)
    return Feeler(
        numbers=numbers, body=body, work=work, known=regressor.workspace(), theta=theta, doubt=doubt, ends=ends,
        dry=theta[first : first + count].copy(), felt=sending.felt,
        gains=gains, floor=touch.unknown * gains,
        most=sending.most, E=sending.E, E_inv=sending.E_inv,
        motor=np.array([exp(-h / each) if each > 0.0 else 0.0 for each in sending.lag]), drag=sending.lag / h,
        column=column_of(carrier, robot, regressor) if sending.loads else -1,
        carrier=carrier, moving=int(layout.base > 0), hand=place,
        position=robot.neutral_position(), nu=np.zeros(p),
        vectors=np.zeros((7, p)), S=np.zeros((p, p)), L=np.zeros((p, p)), J=np.zeros((6, p)), X=np.zeros((6, p)),
        G=np.zeros((2, 6, 6)), wrench=np.zeros((2, 6)), state=state,
    )  # fmt: skip


def groups_of(regressor: Regressor) -> IntArray:
    """Where groups of parameters begin that are wrong together: those of every body, then every rotor and friction."""
    bodies = len(regressor.bodies)
    ends = np.append(BODY * np.arange(bodies), np.arange(BODY * bodies, regressor.size + 1))
    return ends.astype(np.int64)


def column_of(carrier: int, robot: Robot, regressor: Regressor) -> int:
    """Column of the regressor with the mass of the body that a row of the tree is; -1 for the base."""
    coordinate = body_of(robot).tree.links[carrier, LINK.coordinate]
    name = robot.full_velocity_names[coordinate] if carrier > BASE.w else ""
    return BODY * regressor.bodies.index(name) if name in regressor.bodies else -1


def hand_of(name: str, robot: Robot) -> tuple[int, Array]:
    """Row of the tree that carries the hand, and where it is in the axes of that body, (3,) [m].

    Raises:
        UnknownName: There is no such link or joint.
        ConfigError: No joint moves it, or the robot has no hand.
    """
    if not name and not robot.hands:
        fix = "name a link that moves with it: --set touch.hand=LINK"
        raise ConfigError(f"'{robot.name}' has no hand", why="the wrench is told there", fix=fix, key="touch.hand")
    frames, name = [frame.name for frame in robot.model.frames][1:], name or robot.hands[0]
    if name not in frames:
        raise UnknownName("link or joint", name, frames, key="touch.hand")
    model, tree, body = robot.model, body_of(robot).tree, body_of(robot)
    frame = model.frames[model.getFrameId(name)]
    rows, joint = {int(c): i for i, c in enumerate(tree.links[:, LINK.coordinate]) if i > BASE.w}, frame.parentJoint
    while joint > 0 and model.joints[joint].idx_v not in rows:
        joint = model.parents[joint]
    carrier = rows[model.joints[joint].idx_v] if joint > 0 else int(BASE.w)
    if joint == 0 and not robot.dimensions.base:
        what, fix = f"'{name}' stands still", "name a link that the arm moves"
        raise ConfigError(what, why="no torque is felt through it", fix=fix, key="touch.hand")
    work, position = new_work(body), robot.neutral_position()
    evaluate(body, work, position, np.zeros(robot.dimensions.dof))
    data = model.createData()
    pin.framesForwardKinematics(model, data, configuration(model, position, tree.frame))
    root = data.oMi[1] if robot.dimensions.base else pin.SE3.Identity()
    there = root.actInv(data.oMf[model.getFrameId(name)]).translation
    if carrier == BASE.w:
        return carrier, np.array(there)
    scratch = work.scratch[carrier]
    R = scratch[AT.rotation : AT.rotation + 9].reshape(3, 3)
    return carrier, np.asarray(R.T @ (there - scratch[AT.origin : AT.origin + 3]))
