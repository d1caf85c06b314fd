"""What a supervisor's memory tells after a run."""

from __future__ import annotations

from ..model.robot import Robot
from ..signals import Array
from .supervisor import (
    BAD,
    BAD_WEIGHTS,
    CODE,
    DEAF,
    HAS_TRIPPED,
    LIMIT,
    LOST,
    OFF_HEADING,
    OFF_JOINT,
    OFF_PATH,
    OVER_SPEED,
    OVER_TORQUE,
    PLACE,
    REFUSED,
    TIME,
    VALUE,
)

SIGNAL = {OVER_TORQUE: "motor_torque", OFF_PATH: "pose_error", OFF_HEADING: "pose_error", OFF_JOINT: "e"}
SIGNAL |= {DEAF: "measurement", LOST: "command", BAD_WEIGHTS: "weights"}
WHAT = {OVER_TORQUE: "torque", OVER_SPEED: "speed", OFF_PATH: "position error", OFF_HEADING: "heading error"}
WHAT |= {OFF_JOINT: "joint error", DEAF: "age of the measurement", LOST: "age of the command"}
UNIT = {OVER_TORQUE: " N m", OVER_SPEED: " rad/s", OFF_PATH: " m", OFF_HEADING: " rad", OFF_JOINT: " rad"}
UNIT |= {DEAF: " s", LOST: " s"}
SLIDING = {OVER_TORQUE: " N", OVER_SPEED: " m/s", OFF_JOINT: " m"}


def trip_of(state: Array, robot: Robot) -> tuple[float, str, str]:
    """When a run tripped [s], the signal that passed its limit, and a line that says by how much."""
    code, i, time = int(state[CODE]), int(state[PLACE]), float(state[TIME])
    if code == BAD_WEIGHTS:
        return time, f"weights[{i}]", f"tripped at t = {time:g} s: weights are not finite"
    names = {OVER_TORQUE: robot.actuator_names, OVER_SPEED: robot.velocity_names, OFF_JOINT: robot.joint_names}
    name = names[code][i] if code in names else ""
    unit = SLIDING[code] if name and slides(robot, name) else UNIT[code]
    value, limit, nb = state[VALUE], state[LIMIT], robot.layout.base
    of, over = f" of {name}" if name else "", f"{value - limit:.3g}{unit} over its limit of {limit:.4g}{unit}"
    signal = f"{SIGNAL[code]}[{i}]" if code in SIGNAL else f"velocity[{i}]" if i < nb else f"qdot[{i - nb}]"
    return time, signal, f"tripped at t = {time:g} s: {WHAT[code]}{of} {value:.4g}{unit}, {over}"


def slides(robot: Robot, name: str) -> bool:
    """Whether a velocity or a joint is one along a line."""
    if not robot.model.existJointName(name):
        return name != "w"
    kind = robot.model.joints[robot.model.getJointId(name)].shortname()
    return str(kind).startswith(("JointModelP", "JointModelMimicP"))


def remarks(state: Array, robot: Robot, status: str) -> list[str]:
    """What else is to be told of a run that ended so: what was refused, and that it had tripped before."""
    told = [trip_of(state, robot)[2]] if state[HAS_TRIPPED] and status != "tripped" else []
    for place, kind in ((BAD, "measurement"), (REFUSED, "command")):
        if count := int(state[place]):
            told.append(f"refused {count} {kind}{'s' if count > 1 else ''} with numbers that are not finite")
    return told
