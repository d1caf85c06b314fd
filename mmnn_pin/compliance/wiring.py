"""A compliant hand of one robot, made from its settings."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..elementary.matrices import inverse, length, product
from ..errors import ConfigError, keyed
from ..model.chain import SIZE, hands_of, pushing
from ..model.robot import Robot
from ..model.tip import jacobian_at, tip_of
from ..model.tree.body import body_of, evaluate, new_work
from ..signals import Array
from .bound import Held, bound_of
from .law import DIRECTION, FORCE, INTEGRAL, NEWTONS, SPEED, START, STATE, Compliance, HandScratch
from .settings import Force, Impedance, require_not_negative

LEAST_STIFFNESS, LEAST_ROTATION = 100.0, 5.0  # by which an axis without a spring is damped [N/m, N m/rad]


def compliance_size(impedance: Impedance | None) -> int:
    """How many numbers a compliant hand remembers, 0 without one."""
    return 0 if impedance is None else STATE


def hand_of(impedance: Impedance, robot: Robot) -> str:
    """The frame of a compliant hand.

    Raises:
        ConfigError: A robot without an arm, or a frame that no joint of the arm moves.
    """
    frame = impedance.frame or hands_of(robot)[0]
    if robot.model.existFrame(frame):
        joint = robot.model.frames[robot.model.getFrameId(frame)].parentJoint
        arm = {robot.model.getJointId(name) for name in robot.joint_names}
        if not arm & {*robot.model.supports[joint]}:
            why, fix = "no joint of the arm moves it", f"name one that does, such as '{hands_of(robot)[0]}'"
            raise ConfigError(f"'{frame}' stands still on '{robot.name}'", why=why, fix=fix, key="impedance.frame")
    return frame


def compliance_of(
    impedance: Impedance,
    force: Force | None,
    robot: Robot,
    believed: Robot,
    held: Held,
    position: Array,
    state: Array,
    felt: int = -1,
) -> Compliance:
    """A compliant hand of a robot.

    Args:
        impedance: What it resists with.
        force: What it pushes with; None for nothing.
        robot: The robot, as the controller takes it.
        believed: Whose inertias the posture goes by.
        held: The loop around it: gains, period, delay, servos.
        position: (nv,) where it starts, where damping ratios hold and the bound is taken.
        state: (`compliance_size`,) what it remembers, written.
        felt: Place of the signal `external_torque` in a row, -1 without it.

    Raises:
        ConfigError: No such hand, not one number per axis or joint, or a stiffness beyond the bound.
        RobotError: A frame that cannot be led, or a joint that cannot be flattened.
    """
    with keyed(lambda key: "impedance.frame"):
        tip = tip_of(robot, hand_of(impedance, robot))
    d = robot.dimensions
    place, J = jacobian_at(tip, position)
    body = body_of(believed)
    inertia = new_work(body)
    evaluate(body, inertia, position, np.zeros(d.dof))
    M = inertia.M.copy()
    springs = np.concatenate([np.broadcast_to(each, 3) for each in (impedance.stiffness, impedance.rotation)])
    rows = 6 if springs[3:].any() else 3
    masses = hand_masses(M, J, place if impedance.axes == "hand" else None)
    numbers = np.zeros(FORCE)
    if force is not None:
        along = (
            pushing(tip.chain, position, d.arm) if force.along is None else np.array(force.along) / length(force.along)
        )
        numbers[:] = (
            force.newtons, force.start, force.rise, force.gain, float(force.follow), force.speed, force.far,
            force.turning,
        )  # fmt: skip
        state[DIRECTION : DIRECTION + 3] = along
    admits = bool(np.any(held.on[d.base :]))
    if admits and felt < 0:
        why, fix = "the arm takes no torques, and nothing tells what it feels", "drive the arm by effort"
        raise ConfigError(f"a compliant hand of '{robot.name}'", why=why, fix=fix, key="impedance")
    made = Compliance(
        tip=tip,
        offset=robot.arm_map()[0],
        columns=robot.arm_map()[1],
        rows=rows,
        by_hand=float(impedance.axes == "hand"),
        springs=springs.astype(float),
        dampers=dampers(impedance, springs, masses),
        limit=impedance.limit,
        station=impedance.station,
        weights=weights_of(J[:3], d.base, impedance.share),
        still=held.gains.copy(),
        most=np.inf,
        force=numbers,
        mass=(masses if impedance.mass is None else impedance.mass * masses / masses[0]) if admits else np.zeros(0),
        felt=felt,
        h=held.period,
        body=body,
        inertia=inertia,
        torque=np.zeros(d.dof),
        state=state,
        work=HandScratch(
            place=np.zeros((3, SIZE)),
            twist=np.zeros((3, 6)),
            bias=np.zeros((3, 6)),
            position=np.zeros(d.full),
            rate=np.zeros(d.full),
            led=np.zeros(tip.nu.size),
            nu=np.zeros(d.dof),
            nudot=np.zeros(d.dof),
            J=np.stack((J, J)),
            A=np.zeros((2, rows, rows)),
            X=np.zeros((rows, d.dof)),
            L=np.zeros((d.dof, d.dof)),
            b=np.zeros((5, 6)),
            s=np.zeros((2, d.dof)),
        ),
    )
    bound = bound_of(made, M, held, lambda factor: dampers(impedance, factor * springs, masses))
    bound.require(impedance)
    return made._replace(most=bound.factor * max(LEAST_STIFFNESS, float(np.max(springs[:3]))))


def soften(c: Compliance, stiffness: ArrayLike, damping: ArrayLike | None) -> None:
    """Give a compliant hand another stiffness in place; arguments as of `Stepper.comply`.

    Raises:
        ConfigError: Numbers that are negative or not finite, or a stiffness beyond the bound.
    """
    require_not_negative(stiffness, "stiffness")
    require_not_negative(damping, "damping")
    wanted = np.broadcast_to(np.asarray(stiffness, float), 3)
    if wanted.max() > c.most:
        why = f"delay and period bear {c.most:.4g} N/m"
        raise ConfigError(f"{wanted.max():g} N/m", why=why, fix=f"use at most {0.98 * c.most:.4g}", key="stiffness")
    if damping is None:
        now, then = (np.maximum(each, LEAST_STIFFNESS) for each in (c.springs[:3], wanted))
        damping = c.dampers[:3] * np.sqrt(then / now)
    c.springs[:3], c.dampers[:3] = wanted, damping


def set_force(c: Compliance, force: ArrayLike, time: float) -> None:
    """Give a compliant hand another force (3,) in the world from a time [s] on [N]; one that comes anew rises.

    Raises:
        ConfigError: Numbers that are not finite, or a hand without a force.
    """
    wanted = np.array(force, float)
    if wanted.shape != (3,) or not np.all(np.isfinite(wanted)):
        raise ConfigError(f"a force of {wanted}", fix="use three finite numbers", key="force")
    if not c.force[SPEED] > 0.0:
        what, fix = "the hand has no force", "give StepperSettings(hand_force=Force(newtons=0.0)), or a table [force]"
        raise ConfigError(what, fix=fix, key="force")
    size, u = length(wanted), c.state[DIRECTION : DIRECTION + 3]
    if size > 0.0:
        if c.force[NEWTONS] == 0.0:
            c.force[START], c.state[INTEGRAL] = max(float(c.force[START]), time), 0.0
        u[:] = wanted / size
    c.force[NEWTONS] = size


def weights_of(J: Array, base: int, share: float) -> Array:
    """(p,) W: along J (3, p) the first `base` velocities take a share of the hand's motion, the others the rest."""
    W, own = np.ones(J.shape[1]), float(np.sum(J[:, base:] ** 2))
    if base:
        W[:base] = share / (1.0 - share) * own / float(np.sum(J[:, :base] ** 2))
    return W


def hand_masses(M: Array, J: Array, place: Array | None) -> Array:
    """(6,) what the hand weighs along and about every axis, of the world or of its own placement [kg, kg m^2]."""
    R = np.eye(3) if place is None else place[:9].reshape(3, 3)
    own = np.vstack((product(R.T, J[:3]), product(R.T, J[3:])))
    answers = np.diag(product(own, inverse(M), own.T))
    return 1.0 / np.maximum(answers, 1e-3)


def dampers(impedance: Impedance, springs: Array, masses: Array) -> Array:
    """(6,) what is given, else `2 ratio sqrt(k m)`; an axis without a spring as one with the least."""
    least = np.repeat((LEAST_STIFFNESS, LEAST_ROTATION), 3)
    found = 2.0 * impedance.ratio * np.sqrt(np.maximum(springs, least) * np.minimum(masses, 50.0))
    for half, given in ((0, impedance.damping), (3, impedance.rotation_damping)):
        if given is not None:
            found[half : half + 3] = given
    return np.asarray(found, float)
