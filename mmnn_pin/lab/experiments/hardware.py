"""The table of a robot's hardware, from which an experiment's settings follow.

It stands as `[hardware]` in an experiment, as `ROBOT.hardware.toml` beside a URDF, or comes with the package as a
profile (`profiles/`) that `--hardware NAME` or `profile = "NAME"` takes. Reading an experiment turns it into the keys
that simulations, checks, steppers, ROS 2 and exported C have anyway: interfaces, servos, motors, sensors, latency,
periods, friction and rotors, limits, and gains of the kinematic layer that the whole bears. What a user says by these
keys counts more.
"""

from __future__ import annotations

import fnmatch
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec
import numpy as np

from ...actuator.settings import heaviest
from ...errors import ConfigError, InputError, UnknownKey, UnknownName
from ...files import read_toml
from ...kinematic import Kinematic
from ...loop.servo import POSITION, VELOCITY, movers, own_velocities
from ...loop.stable_gains import SHARES, holds, two_digits
from ...loop.suited import MotorLoad
from ...model.base.steered import SteeredBase
from ...model.inspection import interfaces_of
from ...model.robot import Robot, revolute
from ...model.robots import find
from ...settings import Settings, require_numbers
from ...settings.arguments import unknown_key, wrong_type
from ...signals import Array

if TYPE_CHECKING:
    from .experiment import Experiment

PROFILES = Path(__file__).parent / "profiles"
GROUPS = ("arm", "slides", "wheels", "steering")
COARSEST = 0.001  # step of the plant between samples of a slow controller [s]
ROOM = 1.25  # times the gains of the kinematic layer that are taken, the loop bears, too
JUDGED = "computed_torque"  # the controller whose loop is: none has more feedback inside
UNKNOWN = "unknown"  # the profile for what has no other
PLAIN_BANDWIDTH = 30.0  # of a servo of which nothing is said [1/s]
OFFERS = {"arm": POSITION, "slides": POSITION, "wheels": VELOCITY, "steering": POSITION}  # of "offered"
PER_TURN = ("stiffness", "damping", "integral", "stall", "dead_band", "profile_speed", "profile_acceleration")


class JointHardware(Settings, frozen=True):
    """Hardware of a joint, or of a group of joints; what is None is not known. All numbers are at the joint.

    Args:
        interface: What is sent: "effort", "velocity", "position"; "current" or "pwm" for an effort in these units;
            "offered" for what the URDF's `ros2_control` tags offer, a position for joints, a velocity for wheels first.
        bandwidth: Of the servo [1/s]; of a position servo with a stiffness that over its damping.
        stiffness: Kp of a position servo [N m/rad or N/m], see `loop.servo.Servo`, like those that follow.
        damping: Kd of it, back-EMF included [N m s/rad or N s/m].
        integral: Ki of it [N m/(rad s) or N/(m s)].
        stall: Torque at rest with all voltage [N m or N].
        dead_band: Error that is none [rad or m].
        profile_speed: Of its own profile [rad/s or m/s].
        profile_acceleration: Likewise [rad/s^2 or m/s^2].
        rate: Of its own loop [1/s].
        torque: Largest one, in place of the URDF's [N m or N].
        speed: Likewise [rad/s or m/s].
        lag: Of a motor that takes efforts, its current loop [s].
        encoder: Step of the encoder [rad or m].
        backlash: Of the gear, from flank to flank [rad or m].
        rotor: Inertia of the rotor seen through the gear [kg m^2 or kg].
        friction: Viscous, where the URDF states less [N m s/rad or N s/m].
        coulomb: Dry, likewise [N m or N].
        torque_constant: Torque per current or, for "pwm", at full duty [N m/A or N m].

    Raises:
        ConfigError: A number that is negative or not finite.
    """

    interface: Literal["effort", "velocity", "position", "current", "pwm", "offered"] | None = None
    bandwidth: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    integral: float | None = None
    stall: float | None = None
    dead_band: float | None = None
    profile_speed: float | None = None
    profile_acceleration: float | None = None
    rate: float | None = None
    torque: float | None = None
    speed: float | None = None
    lag: float | None = None
    encoder: float | None = None
    backlash: float | None = None
    rotor: float | None = None
    friction: float | None = None
    coulomb: float | None = None
    torque_constant: float | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "", ("bandwidth", "stiffness", "rate", "torque", "speed", "torque_constant"))


class BaseHardware(Settings, frozen=True):
    """What a base tells of itself.

    Args:
        odometry: Where its pose comes from: "wheels", integrated from their encoders, or "true".
        rate: How often it is told [1/s]; what it is older by counts as delay.
        delay: Of it [s].
        lag: Time constant of its velocity, where wheels' `bandwidth` does not say [s].
    """

    odometry: Literal["wheels", "true"] = "true"
    rate: float | None = None
    delay: float = 0.0
    lag: float | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "base", ("rate", "lag"))


class Hardware(Settings, frozen=True):
    """The hardware of a robot, its groups of joints and single ones; see the top of the module.

    Args:
        profile: Name of a profile or a file to start from.
        title: One line.
        robots: Regular expression of names of robots, or of their folders, which have it.
        sources: Where the numbers come from.
        rate: Control samples per second, "experiment" for its own [1/s].
        delay: From a measurement to servos or motors [s].
        jitter: Largest further delay of a command [s].
        velocity: Where measured velocities come from, as `Sensor.velocity`.
        filter: Their bandwidth [rad/s].
        arm: Joints of the arm that turn.
        slides: Those that slide; of the arm's numbers they take interface, bandwidth and rate.
        wheels: Wheels that drive.
        steering: Joints that steer, and the arm's numbers for none.
        joints: Single joints, by name or pattern (`*`), more than their group.
        base: The base.
        notes: What reading it has found.
    """

    profile: str = ""
    title: str = ""
    robots: str = ""
    sources: tuple[str, ...] = ()
    rate: float | None = None
    delay: float = 0.0
    jitter: float = 0.0
    velocity: Literal["true", "difference", "filtered", "observer", "model"] = "true"
    filter: float = 100.0
    arm: JointHardware = JointHardware()
    slides: JointHardware = JointHardware()
    wheels: JointHardware = JointHardware()
    steering: JointHardware = JointHardware()
    joints: dict[str, JointHardware] = msgspec.field(default_factory=dict)
    base: BaseHardware = BaseHardware()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.rate is not None and not 1.0 <= self.rate <= 1e4:
            raise ConfigError(f"{self.rate:g} control samples per second", fix="use 1 to 10000", key="rate")
        if not (0.0 <= self.delay <= 1.0 and 0.0 <= self.jitter <= 1.0):
            fix = "give seconds from 0 to 1"
            raise ConfigError(f"{self.delay:g} and {self.jitter:g} s", fix=fix, key="delay")


def profiles() -> dict[str, Path]:
    """The profiles that come with the package, name to file."""
    return {path.stem: path for path in sorted(PROFILES.glob("*.toml"))}


def beside_urdf(robot: str) -> str | None:
    """The table that lies beside a robot's URDF; None where there is none."""
    try:
        path = find(robot)
    except InputError:
        return None
    file = path.parent / f"{path.name.partition('.')[0]}.hardware.toml"
    return str(file) if file.is_file() else None


def read_hardware(given: str | Mapping[str, Any], merge: Callable[..., dict[str, Any]]) -> Hardware:
    """A table of hardware on top of the profile that it starts from.

    Args:
        given: Name of a profile, a file, or a table.
        merge: Two tables into one, the second counts more.

    Raises:
        UnknownName: No such profile or key.
        ConfigError: A file that cannot be read, a value that cannot be.
    """
    table, file = completed(given, merge, ())
    kinds = dict.fromkeys(GROUPS, JointHardware) | {"base": BaseHardware}
    for name, value in table.items():
        if name in kinds:
            converted(value, kinds[name], file, f"{name}.")
        elif name == "joints" and isinstance(value, Mapping):
            for joint, item in value.items():
                converted(item, JointHardware, file, f"joints.{joint}.")
    made: Hardware = converted(table, Hardware, file, "")
    return made


def completed(
    given: str | Mapping[str, Any], merge: Callable[..., dict[str, Any]], before: tuple[Path, ...]
) -> tuple[dict[str, Any], Path | None]:
    """The whole table of `read_hardware`, and the file that it stands in; None for none."""
    file: Path | None = None
    if isinstance(given, str):
        file = profiles().get(given, Path(given))
        if given not in profiles() and (not file.suffix or not file.is_file()):
            if file.suffix:
                raise ConfigError("no such file", fix=f"or name one of: {', '.join(profiles())}", file=file)
            raise UnknownName("hardware", given, profiles(), key="hardware")
        if file in before:
            raise ConfigError("starts from itself", fix="name another profile", file=file, key="profile")
        given = read_toml(file)
    start = given.get("profile")
    if not isinstance(start, str) or not start:
        return dict(given), file
    if file is not None and (file.parent / start).is_file():
        start = str(file.parent / start)
    try:
        inner, _ = completed(start, merge, (*before, *([] if file is None else [file])))
    except UnknownName as error:
        raise error.but(file=file, key="profile" if file else "hardware.profile") from None
    return merge(inner, given), file


def converted(value: Any, kind: type[Settings], file: Path | None, prefix: str) -> Any:
    """One table as settings of a kind; errors name its file, or its key within an experiment."""
    front = prefix if file is not None else f"hardware.{prefix}"
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at ")
        key = (front + where.strip("`").removeprefix("$").removeprefix(".")).rstrip(".") or None
        if (unknown := unknown_key(error)) is not None:
            fix = f"there is: {', '.join(kind.__struct_fields__)}"
            raise UnknownKey(unknown, fix=fix, file=file, key=key) from None
        what, fix = wrong_type(message)
        raise ConfigError(what, fix=fix, file=file, key=key) from None
    except ConfigError as error:
        own = (error.key or "").removeprefix(".").removeprefix("base.")
        raise error.but(file=file, key=f"{front}{own}".rstrip(".")) from None


# -- what follows from it ----------------------------------------------------------------------------------------------


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
    """

    def __init__(self, hardware: Hardware, robot: Robot) -> None:
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
            there = offered[name]
            said["interface"] = OFFERS[group] if OFFERS[group] in there or not there else there[0]
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
        if self.hardware.base.lag and self.hardware.wheels.bandwidth is None:
            wheels = [1.0 / self.hardware.base.lag]
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
        if self.of("lag").any():
            motors["lag"] = short(self.of("lag"))
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

    def _gaps(self) -> Array:
        """Backlash of every motor that can be simulated: of rotors that are lighter than what they drive."""
        gaps, rotors = self.of("backlash"), self.of("rotor")
        gaps = np.where(rotors > 0.0, gaps, 0.0)
        while (worst := heaviest(self.robot, np.where(gaps > 0.0, rotors, 0.0))[0]) >= 0:
            gaps[worst] = 0.0
        return gaps

    def notes(self) -> tuple[str, ...]:
        """What a simulation leaves out of it."""
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
        return {"sensor": sensor} if sensor else {}

    def _times(self) -> dict[str, Any]:
        hardware, base = self.hardware, self.hardware.base
        period = None if hardware.rate is None else 1.0 / hardware.rate
        late = base.delay + max(0.0, 1.0 / base.rate - (period or 0.0)) if base.rate else base.delay
        delay = max(hardware.delay, hardware.delay + late if self.robot.dimensions.base else 0.0)
        found: dict[str, Any] = {}
        if delay or hardware.jitter:
            found["latency"] = {"command": delay, "jitter": hardware.jitter}
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
    """Refuse motors that cannot carry what the reference asks for.

    Raises:
        ConfigError: With the weakest, and hardware that can.
    """
    trajectory, duration = experiment.trajectory_of(robot), experiment.time.duration
    load = MotorLoad(robot).along(trajectory, duration)[0]
    if load.max(initial=0.0) <= 1.0:
        return
    j = int(np.argmax(load))
    name, most = robot.actuator_names[j], robot.effort_limits[j]
    own = fitted.hardware.profile or fitted.hardware.title or "hardware"
    why = f"{name} needs {load[j] * most:.3g} N m or N, it gives {most:.3g}"
    fix = "name hardware that it has; --hardware unknown takes the torques of its URDF"
    raise ConfigError(f"{own} is too weak for {robot.name}", why=why, fix=fix, key="--hardware")


def borne(experiment: Experiment, robot: Robot) -> dict[str, Any]:
    """Gains of the kinematic layer that the whole loop bears, in place of an experiment's; none where it bears these.

    Args:
        experiment: With all that follows from the hardware.
        robot: Its robot.
    """
    whole, names = experiment.loop(robot, JUDGED).plan(), robot.base.gain_names
    alike = whole.servo is not None and bool(whole.servo.on.all())  # no feedback is to suit these gains

    def with_shares(base: float, arm: float) -> dict[str, Any]:
        parts = np.split(two_digits(base * whole.gains), len(names)) if names else []
        made = dict(zip(names, (tidy(part) if part.size > 1 else tidy(part)[0] for part in parts), strict=True))
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
    share = next((float(share) for share in SHARES[1 :: 1 if alike else 3] if bears(share, share)), None)
    if share is None:
        return {}
    apart = [(1.0, share), (share, 1.0)] if whole.gains.size and whole.K.size else []
    return with_shares(*next((pair for pair in apart if bears(*pair)), (share, share)))


def tidy(numbers: Array) -> list[float]:
    """Numbers without what floating-point numbers add to few digits."""
    return [float(f"{number:.4g}") for number in numbers]


def proposed(robot: Robot) -> str:
    """The profile whose robots have names like this one's or its folders', "unknown" where there is none."""
    words = (robot.name.lower(), *(part.lower() for part in robot.path.parts[-4:]))
    for name, path in profiles().items():
        pattern = read_toml(path).get("robots")
        if pattern and any(re.search(pattern, word) for word in words):
            return name
    return UNKNOWN


def lines(hardware: Hardware) -> Iterator[str]:
    """Notes of a run on its hardware."""
    rate = "" if hardware.rate is None else f", {hardware.rate:g} control samples per second"
    late = f", {1e3 * hardware.delay:g} ms late" if hardware.delay else ""
    yield f"hardware: {hardware.title or hardware.profile or 'a table'}{rate}{late}"
    yield from hardware.notes
