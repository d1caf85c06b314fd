"""Keys of an experiment that follow from a robot's hardware, and from these everything else.

Reading an experiment turns the table (`hardware_table`) into the keys that simulations, checks, steppers, ROS 2 and
exported C have anyway: interfaces, servos, motors, sensors, latency, periods, friction and rotors, limits, and gains of
the kinematic layer that the whole bears. What a user says by these keys counts more.
"""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from ...actuator.settings import heaviest
from ...errors import ConfigError, UnknownName
from ...kinematic import Kinematic, by_name
from ...loop.servo import POSITION, VELOCITY, Command, movers, own_velocities
from ...loop.stable_gains import SHARES, holds, two_digits
from ...loop.suited import MotorLoad
from ...model.base.steered import SteeredBase
from ...model.inspection import interfaces_of
from ...model.robot import Robot, revolute
from ...signals import Array
from .experiment import Experiment
from .hardware_table import UNKNOWN, HardwareTable, JointHardware

COARSEST = 0.001  # step of the plant between samples of a slow controller [s]
ROOM = 1.25  # times the gains of the kinematic layer that are taken, the loop bears, too
JUDGED = "computed_torque"  # the controller whose loop is: none has more feedback inside
PLAIN_BANDWIDTH = 30.0  # of a servo of which nothing is said [1/s]
OTHER = "name hardware that it has"
WAYS_OUT = {  # profiles that may be named in place of hardware that cannot, and what they are
    UNKNOWN: "takes the torques of its URDF",
    "ideal": "has torques at once, measured exactly",
}
UNITS = ("current", "pwm")  # interfaces that are efforts in other units
OFFERS = {"arm": POSITION, "slides": POSITION, "wheels": VELOCITY, "steering": POSITION}  # of "offered"
PER_TURN = ("stiffness", "damping", "integral", "stall", "dead_band", "profile_speed", "profile_acceleration")


class UnfitHardware(ConfigError):
    """Hardware that cannot move a robot as it is asked to."""


class Fitted:
    """A table of hardware on the joints of one robot.

    Args:
        hardware: The table.
        robot: The robot.

    Attributes:
        groups: Group of every motor's joint.
        motors: Hardware of every motor's joint, in the order of `Robot.actuator_names`.

    Raises:
        UnknownName: A single joint that the robot does not have.
        ConfigError: Currents or duties whose torque is not known.
    """

    def __init__(self, hardware: HardwareTable, robot: Robot) -> None:
        self.hardware, self.robot = hardware, robot
        self.groups = groups_of(robot)
        for pattern in hardware.joints:
            if not fnmatch.filter(robot.actuator_names, pattern):
                raise UnknownName("joint", pattern, robot.actuator_names, key="hardware.joints")
        offered = interfaces_of(robot)["interfaces_offered"]
        self.motors = [self._joint(*pair, offered) for pair in zip(robot.actuator_names, self.groups, strict=True)]

    def _joint(self, name: str, group: str, offered: Mapping[str, list[str]]) -> JointHardware:
        own: JointHardware = getattr(self.hardware, group)
        said = {f: v for f in JointHardware.__struct_fields__ if (v := getattr(own, f)) is not None}
        if group == "slides":  # a stiffness per radian says nothing of a joint that slides
            arm = self.hardware.arm
            for f in ("interface", "bandwidth", "rate", "lag"):
                if f not in said and getattr(arm, f) is not None:
                    said[f] = getattr(arm, f)
        for pattern, one in self.hardware.joints.items():
            if fnmatch.fnmatchcase(name, pattern):
                said |= {f: v for f in JointHardware.__struct_fields__ if (v := getattr(one, f)) is not None}
        if said.get("interface") == "offered":
            there = [kind for kind in offered[name] if kind in (POSITION, VELOCITY)]
            said["interface"] = OFFERS[group] if OFFERS[group] in there or not there else there[0]
        if said.get("interface") in UNITS and "torque_constant" not in said:
            what, why = f"'{name}' takes a {said['interface']}", "how much torque that makes is not known"
            raise ConfigError(what, why=why, fix="give torque_constant, too", key=f"hardware.joints.{name}")
        return JointHardware(**said)

    def of(self, name: str, rows: slice = slice(None), unsaid: float = 0.0) -> Array:
        """A number of every motor, or of some; `unsaid` where it is not known."""
        values = (getattr(motor, name) for motor in self.motors[rows])
        return np.array([unsaid if value is None else value for value in values], float)

    @property
    def arm(self) -> slice:
        """Which motors are the arm's."""
        return slice(self.robot.dimensions.motors - self.robot.dimensions.arm, None)

    def bandwidths(self) -> list[float]:
        """Of every velocity [1/s]."""
        robot, found = self.robot, []
        for motor in self.motors:
            own = motor.bandwidth
            if own is None and motor.stiffness and motor.interface == POSITION:
                own = motor.stiffness / max((motor.damping or 0.0) + (motor.friction or 0.0), 1e-9)
            found.append(PLAIN_BANDWIDTH if own is None else own)
        wheels = [b for b, group in zip(found, self.groups, strict=True) if group == "wheels"]
        if lag := self.hardware.base.lag:
            told = self.hardware.wheels.bandwidth is not None
            wheels = [min(1.0 / lag, *wheels) if told else 1.0 / lag]
        steering = [found[robot.actuator_names.index(name)] for name in masters_of(robot)]
        return [min(wheels, default=PLAIN_BANDWIDTH)] * own_velocities(robot) + steering + found[self.arm]

    def settings(self) -> dict[str, Any]:
        """Keys of an experiment and their values, tables in tables."""
        robot, arm = self.robot, self.arm
        names = robot.actuator_names
        kinds = {n: m.interface for n, m in zip(names, self.motors, strict=True) if m.interface in (VELOCITY, POSITION)}
        found: dict[str, Any] = {"interfaces": kinds}
        if kinds:
            servo = {"bandwidth": short(self.bandwidths())}
            servo |= {name: short(self.of(name)) for name in PER_TURN if self.of(name).any()}
            periods = [0.0 if motor.rate is None else 1.0 / motor.rate for motor in self.motors]
            found["servo"] = servo | ({"period": short(periods)} if any(periods) else {})
        gaps = self._gaps()
        motors: dict[str, Any] = {"torque_limit": "urdf"}
        if (lags := self._lags()).any():
            motors["lag"] = short(lags)
        if gaps.any():
            motors |= {"gap": short(gaps), "rotor_inertia": short(np.where(gaps > 0.0, self.of("rotor"), 0.0))}
        found["actuator"] = motors
        limits = {"effort_limits": "torque", "speed_limits": "speed"}
        found |= {key: short(self.of(name)) for key, name in limits.items() if self.of(name).any()}
        if robot.dimensions.arm:
            rotors = np.where(gaps > 0.0, 0.0, self.of("rotor"))[arm]
            found |= {"armature": short(rotors)} if rotors.any() else {}
            found |= self._friction()
        return found | self._sensing() | self._times()

    def sent(self, command: Command) -> dict[str, float]:
        """A command as a driver sends it, by joint: in the unit of its interface.

        Args:
            command: Of a `Stepper`, whose interfaces are those of this table.
        """
        values = {POSITION: command.motor_position, VELOCITY: command.motor_velocity}
        found = dict[str, float]()
        for j, (name, motor) in enumerate(zip(self.robot.actuator_names, self.motors, strict=True)):
            value = float(values.get(motor.interface or "", command.motor_effort)[j])
            found[name] = value / (motor.torque_constant or 1.0) if motor.interface in UNITS else value
        return found

    def units(self) -> dict[str, tuple[str, float]]:
        """By joint, the interface of motors that take an effort in another unit, and the torque per unit (`sent`)."""
        named = zip(self.robot.actuator_names, self.motors, strict=True)
        return {n: (m.interface, m.torque_constant or 1.0) for n, m in named if m.interface in UNITS}

    def _gaps(self) -> Array:
        """Backlash of every motor that can be simulated: of rotors that are lighter than what they drive."""
        gaps, rotors = self.of("backlash"), self.of("rotor")
        gaps = np.where(rotors > 0.0, gaps, 0.0)
        while (worst := heaviest(self.robot, np.where(gaps > 0.0, rotors, 0.0))[0]) >= 0:
            gaps[worst] = 0.0
        return gaps

    def _lags(self) -> Array:
        """Of every motor; a base that is slow by itself is so by its wheels where they take efforts."""
        lag = self.hardware.base.lag or 0.0
        driven = [g == "wheels" and m.interface != VELOCITY for m, g in zip(self.motors, self.groups, strict=True)]
        return np.where(driven, np.maximum(self.of("lag"), lag), self.of("lag"))

    def notes(self) -> tuple[str, ...]:
        """Notes on what a simulation leaves out."""
        left = (self.of("backlash") > 0.0) & (self._gaps() == 0.0)
        names = [name for name, is_left in zip(self.robot.actuator_names, left, strict=True) if is_left]
        most = self.of("backlash").max(initial=0.0)
        if not names:
            return ()
        why = "their rotors are heavier than what they drive"
        return (f"backlash is left out at {', '.join(names)}: {why}; a joint may stand up to {most:g} rad off",)

    def _friction(self) -> dict[str, Any]:
        robot, arm = self.robot, self.arm
        more = {
            "arm": np.maximum(self.of("friction", arm) - robot.damping[robot.arm_index], 0.0),
            "coulomb": np.maximum(self.of("coulomb", arm) - robot.coulomb[robot.arm_index], 0.0),
        }
        return {"friction": said} if (said := {name: short(each) for name, each in more.items() if each.any()}) else {}

    def _sensing(self) -> dict[str, Any]:
        hardware, sensor = self.hardware, dict[str, Any]()
        wheels = [m.encoder or 0.0 for m, g in zip(self.motors, self.groups, strict=True) if g == "wheels"]
        if self.of("encoder", self.arm).any():
            sensor["resolution"] = short(self.of("encoder", self.arm))
        if any(wheels):
            sensor["wheel_resolution"] = max(wheels)
        if self.robot.dimensions.shape and hardware.steering.encoder:
            sensor["steering_resolution"] = hardware.steering.encoder
        measured = bool(self.robot.base.wheels) or not self.robot.dimensions.base
        if hardware.velocity != "true" and measured:
            sensor |= {"velocity": hardware.velocity, "bandwidth": hardware.filter}
        if hardware.base.odometry == "wheels" and self.robot.base.wheels:
            sensor["pose"] = "odometry"
        if hardware.base.rate and self.robot.dimensions.base:
            sensor["base_period"] = 1.0 / hardware.base.rate
        if hardware.base.delay and self.robot.dimensions.base:
            sensor["base_delay"] = hardware.base.delay
        return {"sensor": sensor} if sensor else {}

    def _times(self) -> dict[str, Any]:
        hardware, found = self.hardware, dict[str, Any]()
        period = None if hardware.rate is None else 1.0 / hardware.rate
        if hardware.delay or hardware.jitter:
            found["latency"] = {"command": hardware.delay, "jitter": hardware.jitter}
        if period is not None:
            found["time"] = {"control_period": period, "plant_step": period / math.ceil(period / COARSEST - 1e-9)}
        return found


def groups_of(robot: Robot) -> list[str]:
    """Group of every motor's joint; a caster's motor that drives the base is a wheel's, whatever it turns."""
    turning, names = revolute(robot), robot.position_names
    drives = np.atleast_1d(movers(robot)[: own_velocities(robot)].any(axis=0))
    first, found = robot.dimensions.motors - robot.dimensions.arm, []
    for j, name in enumerate(robot.actuator_names):
        if j < first:
            found.append("wheels" if drives[j] else "steering")
        else:
            found.append("arm" if turning[names.index(name)] else "slides")
    return found


def masters_of(robot: Robot) -> list[str]:
    """Joints that steer and whose rates are velocities."""
    base = robot.base
    return [base.pivots[k].joint for k in base.masters] if isinstance(base, SteeredBase) else []


def short(values: Any) -> Any:
    """A list as settings take it: one number where all are alike."""
    numbers = np.asarray(values, float)
    return float(numbers[0]) if numbers.size and np.ptp(numbers) == 0.0 else numbers.tolist()


def require_strength(fitted: Fitted, experiment: Experiment, robot: Robot) -> None:
    """Refuse motors that cannot carry what the reference asks for (`UnfitHardware`)."""
    trajectory, duration = experiment.trajectory_of(robot), experiment.time.duration
    load = MotorLoad(robot).along(trajectory, duration)[0]
    if load.max(initial=0.0) <= 1.0:
        return
    j = int(np.argmax(load))
    name, most = robot.actuator_names[j], robot.effort_limits[j]
    what, why = (
        f"{name_of(fitted.hardware)} is too weak",
        f"{name} needs {load[j] * most:.3g} N m or N, it gives {most:.3g}",
    )
    raise UnfitHardware(f"{what} for {robot.name}", why=why, fix=OTHER, key="--hardware")


def name_of(hardware: HardwareTable) -> str:
    """A few words for a table."""
    return hardware.title or hardware.profile or "a table of hardware"


def borne(experiment: Experiment, robot: Robot) -> dict[str, Any]:
    """Gains of the kinematic layer that the whole loop bears, in place of an experiment's; none where it bears these.

    Args:
        experiment: With all that follows from the hardware.
        robot: Its robot.

    Raises:
        UnfitHardware: It bears none.
    """
    whole = experiment.loop(robot, JUDGED).plan()
    alike = whole.servo is not None and bool(whole.servo.on.all())  # no feedback is to suit these gains

    def with_shares(base: float, arm: float) -> dict[str, Any]:
        parts = by_name(robot.base.gain_names, two_digits(base * whole.gains)).items()
        made: dict[str, Any] = {name: tidy(part) if part.size > 1 else tidy(part)[0] for name, part in parts}
        return made | ({"K": short(tidy(two_digits(arm * whole.K)))} if whole.K.size else {})

    def bears(base: float, arm: float, room: float = ROOM) -> bool:
        plan = whole
        if not alike and (base, arm) != (1.0, 1.0):
            kinematic = msgspec.convert(msgspec.to_builtins(experiment.kinematic) | with_shares(base, arm), Kinematic)
            changed = msgspec.structs.replace(experiment, kinematic=kinematic)
            plan, base, arm = changed.loop(robot, JUDGED).plan(), 1.0, 1.0
        more = [room * share if share < 1.0 or not alike else 1.0 for share in (base, arm)]
        return holds(replace(plan, gains=more[0] * plan.gains, K=more[1] * plan.K))

    if bears(1.0, 1.0, 1.0):
        return {}
    low, high = 1, len(SHARES)  # the largest share that it bears is in between
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if bears(SHARES[middle], SHARES[middle]) else (middle + 1, high)
    if low == len(SHARES):
        assert experiment.hardware is not None
        what = f"{name_of(experiment.hardware)} is too slow or too soft for {robot.name}"
        why = "the whole loop is unstable with any gains of the kinematic layer"
        raise UnfitHardware(what, why=why, fix=OTHER, key="--hardware")
    share = float(SHARES[low])
    apart = [(1.0, share), (share, 1.0)] if whole.gains.size and whole.K.size else []
    return with_shares(*next((pair for pair in apart if bears(*pair)), (share, share)))


def tidy(numbers: Array) -> list[float]:
    """Numbers without what floating-point numbers add to few digits."""
    return [float(f"{number:.4g}") for number in numbers]


def lines(hardware: HardwareTable) -> Iterator[str]:
    """Notes of a run on its hardware."""
    rate = "" if hardware.rate is None else f", {hardware.rate:g} control samples per second"
    late = f", {1e3 * hardware.delay:g} ms late" if hardware.delay else ""
    yield f"hardware: {name_of(hardware)}{rate}{late}"
    yield from hardware.notes
