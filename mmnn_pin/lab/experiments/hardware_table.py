"""The table of a robot's hardware: what stands behind its joints and its base.

It is `[hardware]` in an experiment, `ROBOT.hardware.toml` beside a URDF, or a profile that comes with the package
(`profiles/`), which `--hardware NAME` takes and `profile = "NAME"` starts from. `hardware` has what follows from it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from os.path import lexists
from pathlib import Path
from typing import Any, Literal

import msgspec

from ...errors import ConfigError, InputError, UnknownName
from ...files import read_toml
from ...model.robot import Robot
from ...model.robots import find
from ...settings import Settings, require_numbers
from .origins import placed

PROFILES = Path(__file__).parent / "profiles"
UNKNOWN = "unknown"  # the profile for what has no other
GROUPS = ("arm", "slides", "wheels", "steering")


class JointHardware(Settings, frozen=True):
    """Hardware of a joint, or of a group of joints; what is None is not known. All numbers are at the joint.

    Args:
        interface: What the motor takes: "effort", "velocity", "position"; "current" or "pwm" for an effort in these
            units; "offered" for what the URDF's `ros2_control` tags offer: first a position for joints, a velocity for
            wheels, and never an effort, which needs known motors.
        bandwidth: Bandwidth of the servo [1/s]; for a position servo with a stiffness the stiffness over the damping.
        stiffness: Kp of a position servo [N m/rad or N/m], see `loop.servo.Servo`.
        damping: Kd of a position servo, back-EMF included [N m s/rad or N s/m].
        integral: Ki of a position servo [N m/(rad s) or N/(m s)].
        stall: Torque of a position servo at rest with full voltage [N m or N].
        dead_band: Error to which a position servo does not react [rad or m].
        profile_speed: Speed of a position servo's own motion profile [rad/s or m/s].
        profile_acceleration: Acceleration of that profile [rad/s^2 or m/s^2].
        rate: Rate of the servo's own loop [1/s].
        torque: Largest torque, in place of the URDF's [N m or N].
        speed: Largest speed, in place of the URDF's [rad/s or m/s].
        lag: Time constant of the current loop of a motor that takes efforts [s].
        encoder: Step of the encoder [rad or m].
        backlash: Backlash of the gear, from flank to flank [rad or m].
        rotor: Inertia of the rotor seen through the gear [kg m^2 or kg].
        friction: Viscous friction, if the URDF states less [N m s/rad or N s/m].
        coulomb: Dry friction, if the URDF states less [N m or N].
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
    """Hardware of a base.

    Args:
        odometry: Source of the base's pose: "wheels", integrated from their encoders, or "true".
        rate: How often the base's pose and velocity are new [1/s]; the loop is checked as if all measurements were as
            old as these become.
        delay: How much later the base's pose and velocity come than the other measurements [s]; checked likewise.
        lag: Time constant of the base's velocity [s]. On a velocity interface the base follows with it, unless the
            wheels' `bandwidth` is slower; for wheels that take efforts it is the time constant of their torque.
    """

    odometry: Literal["wheels", "true"] = "true"
    rate: float | None = None
    delay: float = 0.0
    lag: float | None = None

    def __post_init__(self) -> None:
        require_numbers(self, "base", ("rate", "lag"))
        if self.delay > 1.0:
            raise ConfigError(f"{self.delay:g} s", fix="give seconds from 0 to 1", key="base.delay")


class HardwareTable(Settings, frozen=True):
    """Hardware of a robot: groups of its joints, and single ones.

    Args:
        profile: Name of a profile or a file to start from.
        title: One line.
        robots: Regular expression that matches the names, or folders, of robots with this hardware.
        sources: Where the numbers come from.
        rate: Control samples per second; None for the experiment's own [1/s].
        delay: Delay from a measurement to servos or motors [s].
        jitter: Largest further delay of a command [s].
        velocity: Source of measured velocities, as `Sensor.velocity`.
        filter: Bandwidth of the measured velocities [rad/s].
        arm: Joints of the arm that turn.
        slides: Joints that slide; they take interface, bandwidth and rate from `arm`.
        wheels: Drive wheels.
        steering: Joints that steer; they take nothing from `arm`.
        joints: Single joints, by name or pattern (`*`); they override their group.
        base: The base.
        notes: Notes of the reader.
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
        for name in ("delay", "jitter"):
            if not 0.0 <= (value := getattr(self, name)) <= 1.0:
                raise ConfigError(f"{value:g} s", fix="give seconds from 0 to 1", key=name)
        if not 0.0 < self.filter <= 1e4:
            raise ConfigError(f"{self.filter:g} rad/s", fix="use a number > 0, up to 10000", key="filter")


def profiles() -> dict[str, Path]:
    """The profiles that come with the package, name to file."""
    return {path.stem: path for path in sorted(PROFILES.glob("*.toml"))}


def proposed(robot: Robot) -> str:
    """The profile whose robots have names like this one's or its folders', "unknown" where there is none."""
    words = (robot.name.lower(), *(part.lower() for part in robot.path.parts[-4:]))
    for name, path in profiles().items():
        pattern = read_toml(path).get("robots")
        if pattern and any(re.search(pattern, word) for word in words):
            return name
    return UNKNOWN


def beside_urdf(robot: str) -> str | None:
    """The table that lies beside a robot's URDF; None where there is none."""
    try:
        path = find(robot)
    except InputError:
        return None
    file = path.parent / f"{path.name.partition('.')[0]}.hardware.toml"
    return str(file) if lexists(file) else None


def completed(
    given: str | Mapping[str, Any], merge: Callable[..., dict[str, Any]], before: tuple[Path, ...] = ()
) -> tuple[dict[str, Any], list[Path]]:
    """A table of hardware on top of the profile that it starts from, and their files, without those of the package.

    Args:
        given: Name of a profile, a file, or a table.
        merge: Two tables into one, the second counts more.
        before: Files that started from this one.

    Raises:
        UnknownName: No such profile.
        ConfigError: A file that cannot be read.
    """
    file: Path | None = None
    if isinstance(given, str):
        file = profiles().get(given, Path(given))
        if given not in profiles() and (not file.suffix or not lexists(file)):
            if file.suffix:
                raise ConfigError("no such file", fix=f"or name one of: {', '.join(profiles())}", file=file)
            raise UnknownName("hardware", given, profiles(), key="hardware")
        if file in before:
            raise ConfigError("starts from itself", fix="name another profile", file=file, key="profile")
        given = read_toml(file)
    elif not isinstance(given, Mapping):
        raise ConfigError("no hardware", fix="give the name of a profile, a file, or a table", key="hardware")
    own = [] if file is None else [file]
    theirs = [one for one in own if one.parent != PROFILES]
    start = given.get("profile")
    if not isinstance(start, str) or not start:
        return dict(given), theirs
    if file is not None and (file.parent / start).is_file():
        start = str(file.parent / start)
    try:
        inner, others = completed(start, merge, (*before, *own))
    except UnknownName as error:
        raise placed(error.but(key="profile"), file) if file else error.but(key="hardware.profile") from None
    said = [table["sources"] for table in (inner, given) if "sources" in table]
    wrong = [one for one in said if not isinstance(one, list | tuple)]  # refused with its key
    sources = wrong[0] if wrong else [source for one in said for source in one]
    return merge(inner, given) | ({"sources": sources} if said else {}), [*theirs, *others]
