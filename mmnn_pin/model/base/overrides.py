"""Statements of the user about a robot's base and arm: in a call, on the command line or in a file beside the URDF.

Beside `NAME.urdf` the file is `NAME.mmnn.toml`, with the keys of `Overrides`; its folders and files start from its own
folder. What is said in a call, on the command line or in an experiment counts more than the file.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from ...errors import ConfigError, UnknownName
from ...files import read_toml
from ...settings import Settings
from ...settings.arguments import unknown_key, wrong_type
from ..robots import package_dirs_of
from ..urdf.finding import Finding
from . import KINDS

ARMS = ("left", "right", "both")
FORWARD = {"x": (1.0, 0.0), "-x": (-1.0, 0.0), "y": (0.0, 1.0), "-y": (0.0, -1.0)}  # of the root link
SMALLEST, LARGEST = 1e-4, 1e3  # [m] what a radius and a track can be
RANGES = (  # of other values: above the first, up to the second
    ("mu", "a friction coefficient", 0.0, 10.0, "give one above 0, such as 0.6"),
    ("steering_limit", "the limit of a steering angle", 0.0, math.pi, "give radians above 0, such as 0.6"),
    ("roller", "a roller angle", -1.4, 1.4, "give radians within +-1.4"),
)


class Overrides(Settings, frozen=True):
    """Statements of the user about a robot; None and () leave it to the loader.

    Args:
        base: Kind of the base, one of `KINDS`.
        wheels: Joints of the drive wheels; of two on one axle the left one first, which says where forward is.
        radius: Radius of the drive wheels [m].
        wheel_radii: Radius of single drive wheels, `joint=radius` [m]; they count more than `radius`.
        track: Lateral distance of the drive wheels [m]; of a skid-steer base the effective one.
        roller: Angle of the rollers from the rolling direction [rad]: 0 for omni wheels; for mecanum wheels that of
            the front right one on the floor, pi/4 by default, negative for wheels mounted the other way round.
        lock: Joints that stand still, `joint` where it rests or `joint=position` [rad or m].
        free: Joints to free that are locked by default; `all` for all.
        arm: One of `ARMS`: whose joints move where there are two arms; what both share moves with either.
        arm_tip: Link at the end of the arm; joints that do not lead to it are locked.
        package_dirs: Folders that hold the packages of `package://` meshes and of xacro files.
        xacro: Arguments of a xacro file, `NAME:=VALUE`.
        without: Macros of a xacro file to leave out, because a package is missing.
        strict: Whether impossible inertias and implausible sizes are errors.
        controllers_file: YAML file of the robot's controllers: evidence of its kind, what corrects radius and track,
            and opinions on them.
        mu: Friction coefficient between the floor and the wheels of a skid-steer base.
        steer: Joints that steer, about vertical axes above wheels.
        hitch: Joints on which trailers follow.
        wheelbase: Distance from the fixed axle to the wheels that steer [m].
        steering_limit: Largest angle of what steers, to either side [rad].
        forward: The axis of the root link along which the base drives forward: `x`, `-x`, `y` or `-y`.
    """

    base: str | None = None
    wheels: tuple[str, ...] | None = None
    radius: float | None = None
    wheel_radii: tuple[str, ...] = ()
    track: float | None = None
    roller: float | None = None
    lock: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    arm: str | None = None
    arm_tip: str | None = None
    package_dirs: tuple[str, ...] = ()
    xacro: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    strict: bool = False
    controllers_file: str | None = None
    mu: float | None = None
    steer: tuple[str, ...] | None = None
    hitch: tuple[str, ...] | None = None
    wheelbase: float | None = None
    steering_limit: float | None = None
    forward: str | None = None

    def __post_init__(self) -> None:
        for key, known, name in (("base", KINDS, "base"), ("arm", ARMS, "arm"), ("forward", FORWARD, "direction")):
            if (said := getattr(self, key)) is not None and said not in known:
                raise UnknownName(name, said, known, key=key)
        lengths = {"radius": self.radius, "track": self.track, "wheelbase": self.wheelbase}
        for key, value in (*lengths.items(), *(("wheel_radii", radius) for radius in self.radius_of.values())):
            if value is not None and not SMALLEST <= value <= LARGEST:
                fix = f"give metres, from {SMALLEST:g} to {LARGEST:g}"
                raise ConfigError(f"{value} cannot be a {key.replace('wheel_radii', 'radius')}", fix=fix, key=key)
        for key, what, low, high, fix in RANGES:
            value = getattr(self, key)
            if value is not None and not low < value <= high:
                raise ConfigError(f"{value} cannot be {what}", fix=fix, key=key)
        if self.wheels is not None and len(set(self.wheels)) < max(len(self.wheels), 1):
            raise ConfigError("wheels are named twice, or none is", fix="name each drive wheel once", key="wheels")
        if len(self.locks) < len(self.lock) or set(self.locks) & set(self.free):
            fix = "name each joint once, in lock or in free"
            raise ConfigError("a joint is locked twice, or locked and freed", fix=fix, key="lock")
        if self.base == "fixed" and self.wheels is not None:
            raise ConfigError("drive wheels for a fixed base", fix="leave out one of the two", key="wheels")

    @property
    def locks(self) -> dict[str, float | None]:
        """Position of every joint in `lock`, None where it rests; errors as of `numbers_of`."""
        bare = {text: None for text in self.lock if "=" not in text}
        return bare | numbers_of([text for text in self.lock if "=" in text], "lock", "position to lock a joint at")

    @property
    def radius_of(self) -> dict[str, float]:
        """Radius of every wheel in `wheel_radii` [m]; errors as of `numbers_of`."""
        return numbers_of(self.wheel_radii, "wheel_radii", "radius of a wheel")

    def over(self, other: Overrides) -> Overrides:
        """These, and the other ones where these say nothing."""
        return msgspec.structs.replace(other, **self.stated())

    def stated(self) -> dict[str, Any]:
        """The values that differ from the default, by key."""
        default = Overrides()
        return {f: getattr(self, f) for f in self.__struct_fields__ if getattr(self, f) != getattr(default, f)}


def with_file(urdf: Path, overrides: Overrides) -> tuple[Overrides, tuple[Finding, ...]]:
    """The overrides of a call and of the file beside a URDF in one, and the note that tells of that file.

    Raises:
        ConfigError, UnknownName: As in `read_overrides`.
    """
    file = beside(urdf)
    if not os.path.lexists(file):  # which has no opinion on names that no file system takes
        return overrides, ()
    text = "it says what the loader does not look for"
    note = Finding("note", "overrides", str(file), 1, "", f"overrides of {urdf.name} are read from here", text)
    return overrides.over(read_overrides(file)), (note,)


def folders_of(urdf: Path, overrides: Overrides) -> tuple[Path, ...]:
    """Folders that hold the packages of a file's meshes: those that are said, and that of example-robot-data.

    Raises:
        ConfigError: One that is said does not exist.
    """
    for folder in overrides.package_dirs:
        if not os.path.isdir(folder):
            fix = "name the folder that holds the packages"
            raise ConfigError("no such folder", fix=fix, file=folder, key="package_dirs")
    return (*map(Path, overrides.package_dirs), *package_dirs_of(urdf))


def numbers_of(texts: Sequence[str], key: str, what: str) -> dict[str, float]:
    """Numbers by joint that texts `joint=number` state.

    Raises:
        ConfigError: No joint, or a number that is not finite.
    """
    table = dict[str, float]()
    for text in texts:
        name, _, value = text.rpartition("=")
        try:
            table[name] = float(value)
        except ValueError:
            name = ""
        if not name or not math.isfinite(table[name]):
            raise ConfigError(f"'{text}' is no {what}", fix="write joint=number in m or rad", key=key)
    return table


def beside(urdf: Path) -> Path:
    """The file of overrides that belongs to a URDF."""
    return urdf.parent / f"{urdf.stem}.mmnn.toml"


def read_overrides(path: Path) -> Overrides:
    """Overrides of a TOML file; its package folders and controllers' file start from its own folder.

    Raises:
        ConfigError: The file cannot be read, is not TOML, or a value is of the wrong type or out of range.
        UnknownName: A key or a kind of base that does not exist.
    """
    try:
        overrides = msgspec.convert(read_toml(path), Overrides)
        folders = tuple(str(path.parent / folder) for folder in overrides.package_dirs)
        file = None if overrides.controllers_file is None else str(path.parent / overrides.controllers_file)
        return msgspec.structs.replace(overrides, package_dirs=folders, controllers_file=file)
    except msgspec.ValidationError as error:
        if isinstance(error.__cause__, ConfigError | UnknownName):
            raise error.__cause__.but(file=path) from None
        message, _, where = str(error).partition(" - at ")
        if (unknown := unknown_key(error)) is not None:
            raise UnknownName("key", unknown, Overrides.__struct_fields__, file=path) from None
        what, fix = wrong_type(message)
        raise ConfigError(what, fix=fix, file=path, key=where.strip("`").removeprefix("$.") or None) from None
    except (ConfigError, UnknownName) as error:
        raise error.but(file=path) from error
