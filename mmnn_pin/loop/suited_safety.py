"""The limits of a supervisor on a robot where none are given, by its URDF and its gains.

- A joint or a drive wheel is too fast at `OVER` times the URDF's speed, or at a speed that no arm has.
- A base is lost `AWAY` and `TURNED` off its reference.
- A joint is lost `REACH` off its reference, plus what its load needs: under a feedback k s it hangs `load / (k K)`
  below, by a servo it is late by the latency.
- A jump is more than `JUMP` beyond what the speed explains.
- A learner shakes a motor with `SHAKEN` of its limit.
- A control period is too long where the sampled loop is unstable by far.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from ..compiled import one_thread
from ..model.dynamics import Dynamics
from ..model.robot import revolute, speed_limits
from ..safety import Safety, steering_motors
from ..signals import Array, Setpoint
from .before_run import Start, viscous_friction
from .plan import Plan
from .sampled import gains_of, judges, machinery_of, sampled_loop

OVER = 1.5
TURN, SLIDE = 10.0, 2.0  # speed of a joint where the URDF states none [rad/s, m/s]
REACH, REACH_SLIDE = 0.2, 0.1  # [rad, m]
JUMP, JUMP_SLIDE = 0.1, 0.05  # [rad, m]
AWAY, TURNED = 0.3, 0.5  # of a base from its reference [m, rad]
SHAKEN = 0.15  # RMS of what is learned, faster than 10 Hz, over a motor's limit
LONGEST = 64.0  # times the control period that is tried
ROOM = 1.25  # times the longest stable period that is borne: joints have friction that no URDF states
HALVINGS = 7


def suited_safety(given: Safety, plan: Plan, references: Array, limited: bool = True) -> Safety:
    """The given supervisor, with limits that suit the robot where none are given.

    Args:
        given: The supervisor's limits.
        plan: Of the stepper, with postures as setpoints.
        references: (2, p) largest speeds and accelerations of the references.
        limited: Whether references begin where the robot is, and stay within these.
    """
    robot, (speed, acceleration) = plan.robot, references[:, plan.robot.dimensions.base :]
    urdf, wheels, turns = speed_limits(robot), robot.dimensions.motors - robot.dimensions.arm, revolute(robot)
    turns = turns[robot.arm_index]
    fastest = np.where(np.isfinite(urdf[wheels:]), urdf[wheels:], np.maximum(np.where(turns, TURN, SLIDE), speed))
    found: dict[str, object] = {
        "joint_speed": tuple((OVER * fastest).tolist()),
        "wheel_speed": over(urdf[: wheels - steering_motors(robot)]),
        "steering_rate": over(urdf[wheels - steering_motors(robot) : wheels]),
        "shaking": SHAKEN,
        "jump": tuple(np.where(turns, JUMP, JUMP_SLIDE).tolist()),
    }
    if robot.dimensions.base and limited:
        found |= {"position_error": AWAY, "heading_error": TURNED}
    if judges(plan):
        error = np.where(turns, REACH, REACH_SLIDE) + loads_of(plan, np.minimum(fastest, speed), acceleration)
        longest = longest_period(plan)
        found |= {"joint_error": tuple(error.tolist()), "slowest": longest if math.isfinite(longest) else None}
    return msgspec.structs.replace(
        given, **{name: value for name, value in found.items() if getattr(given, name) is None}
    )


def over(urdf: Array) -> tuple[float, ...] | None:
    """Speeds beyond the URDF's; None where it does not state all of them."""
    return tuple((OVER * urdf).tolist()) if urdf.size and np.isfinite(urdf).all() else None


def loads_of(plan: Plan, speed: Array, acceleration: Array) -> Array:
    """How far joints are off their references under what they carry, and for the time that a command takes, (n,).

    Args:
        plan: Of the stepper.
        speed: (n,) of the references [rad/s or m/s].
        acceleration: (n,) of the references [rad/s^2 or m/s^2].
    """
    robot, nb = plan.robot, plan.robot.dimensions.base
    dynamics, arm = Dynamics(robot), robot.arm_index
    load = np.zeros(robot.dimensions.arm)
    for setpoint in plan.setpoints:
        position, _ = Start().state(robot, setpoint)
        inertia = np.diag(dynamics.mass_matrix(position))[nb:]
        load = np.maximum(load, np.abs(dynamics.gravity(position)[nb:]) + inertia * acceleration)
    friction = np.asarray(viscous_friction(robot))
    load += robot.coulomb[arm] + np.diag(friction)[nb:] * speed
    load = np.minimum(load, robot.effort_limits[robot.dimensions.motors - load.size :])
    springs = gains_of(plan)[nb:] * plan.K
    if plan.servo is not None:  # a servo holds what it is sent
        springs[plan.servo.on[nb:] > 0.0] = 0.0
    held = np.divide(load, springs, out=np.zeros_like(load), where=springs > 0.0)
    late = speed * (plan.latency + plan.timing.control_period)
    return np.where(springs > 0.0, held, late)


@one_thread
def longest_period(plan: Plan) -> float:
    """`ROOM` times the longest period at which the sampled loop is stable, less what latency takes [s]; inf for any."""
    robot, dynamics, machinery = plan.robot, Dynamics(plan.robot), machinery_of(plan)
    gains, places = gains_of(plan), []
    for setpoint in plan.setpoints:
        position, _ = Start().state(robot, setpoint)
        velocity = Setpoint.side_by_side(setpoint, robot.dimensions).velocity
        law = robot.base.linear_errors(velocity, plan.gains)
        places.append((dynamics.mass_matrix(position).copy(), law))

    def bears(h: float) -> bool:
        for k, (M, law) in enumerate(places):
            if not sampled_loop(M, gains, law, plan.K, h, machinery).stable:
                places.insert(0, places.pop(k))
                return False
        return True

    period = plan.timing.control_period
    if bears(LONGEST * period) or not bears(period):
        return math.inf
    low, high = 1.0, LONGEST
    for _ in range(HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if bears(middle * period) else (low, middle)
    return ROOM * max(period, low * period - 2.0 * plan.latency)
