"""The schema of a recording: types of its facts, units and columns of its signals, its time.

The recorder holds to it, and every file is held against it when it is opened (`reading`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from ..settings.arguments import shortly, wrong_type
from ..signals import HAND, SIGNALS, WRENCH, Array
from .run_file import SignalColumns

KIND = {name: (kind.split()[-1], base, arm) for name, kind, base, arm in SIGNALS}
MOST_TEXT, DEEPEST = 1000, 32  # letters of a name, levels of a value
LONGEST = 2.0**31  # s: what a stamp of ROS 2 can tell


class RunFacts(msgspec.Struct, frozen=True):
    """Types of what is known of a run: the attributes of a recording. Others may stand there, too."""

    robot: str = ""
    controller: str = ""
    experiment: str = ""
    created: str = ""
    plant: str = ""
    loop: str = ""
    urdf_file: str = ""
    urdf_sha256: str = ""
    seed: int = 0
    control_period: float = 1.0
    delay_margin: float | None = None
    within_limits: bool = False
    velocity_names: tuple[str, ...] = ()
    position_names: tuple[str, ...] = ()
    actuator_names: tuple[str, ...] = ()
    shape_names: tuple[str, ...] = ()
    wheel_names: tuple[str, ...] = ()
    effort_limits: tuple[float, ...] = ()
    armature: float | tuple[float, ...] = 0.0
    viscous: float | tuple[float, ...] = 0.0
    joint_friction: dict[str, float | tuple[float, ...]] = {}
    hands: dict[str, bool] = {}
    mass_factors: dict[str, float] = {}
    radii: float | dict[str, float] = 1.0
    versions: dict[str, str] = {}
    interfaces: dict[str, str] = {}
    law: dict[str, str] = {}
    controller_settings: dict[str, Any] | None = None
    kinematic: dict[str, Any] = {}
    time: dict[str, Any] = {}
    overrides: dict[str, Any] = {}
    package_path: tuple[str, ...] = ()
    nominal: dict[str, Any] = {}
    sensor: dict[str, Any] = {}
    actuator: dict[str, Any] = {}
    latency: dict[str, Any] = {}
    servo: dict[str, Any] = {}
    contact: dict[str, Any] = {}
    safety: dict[str, Any] | None = None
    disturbances: tuple[dict[str, Any], ...] = ()


class Damaged(Exception):
    """One item that cannot be used; the text says why."""


def facts_problem(meta: Mapping[str, Any]) -> tuple[str, str, str] | None:
    """The first fact of a wrong type: its name, what is wrong and what to give; None where there is none."""
    for name in RunFacts.__struct_fields__:
        if name not in meta:
            continue
        try:
            msgspec.convert({name: meta[name]}, RunFacts)
        except msgspec.ValidationError as error:
            return (name, *wrong_type(error, meta[name]))
    for name in ("velocity_names", "position_names", "actuator_names", "shape_names", "wheel_names"):
        if long := next((text for text in meta.get(name, ()) if len(text) > MOST_TEXT), None):
            return name, f"{shortly(long)} has {len(long)} letters", f"use at most {MOST_TEXT}"
    names, limits = meta.get("actuator_names", ()), meta.get("effort_limits", ())
    if limits and len(names) != len(limits):
        return "effort_limits", f"{shortly(list(limits))} for {len(names)} motors", "give one for each"
    period = meta.get("control_period", 1.0)
    if not (math.isfinite(period) and period > 0):
        return "control_period", f"{period} s", "use a finite number of seconds > 0"
    if not 0 <= meta.get("seed", 0) < 2**63:
        return "seed", f"{meta['seed']}", "use an integer from 0 to 2^63 - 1"
    return None


def labels_of(name: str, width: int, meta: Mapping[str, Any]) -> tuple[str, ...]:
    """Labels of the columns of a signal of so many columns, by the facts of its run; empty where these do not tell."""
    velocities, motors = (tuple(meta.get(f"{part}_names", ())) for part in ("velocity", "actuator"))
    own = {"1": 1, "2": 2, "floor": 1, "rig": 1, "scene": 1, "task": 1, "touch": 1}.get(KIND[name][0], 0)
    return {
        "pose": ("x", "y", "phi"),
        "all": velocities,
        "base": velocities[:width],
        "twist": ("v", "w") if width == 2 else ("vx", "vy", "w"),
        "shape": tuple(meta.get("shape_names", ())),
        "arm": velocities[-width:],
        "full": tuple(meta.get("position_names", ())),
        "motor": motors,
        "3": ("x", "y", "z"),
        "wheel": tuple(meta.get("wheel_names", motors))[:width],
        "wrench": WRENCH,
        "hand": tuple(f"{frame}.{each}" for frame in meta.get("hands", ()) for each in HAND),
    }.get(KIND[name][0], (name,) if own == 1 else tuple(f"{name}[{i}]" for i in range(own)))


def signal_problem(name: str, width: int, about: SignalColumns, meta: Mapping[str, Any]) -> str:
    """The fault in unit or columns of a signal; empty where they are as the facts of the run want them."""
    if name not in KIND:
        return "this mmnn_pin knows no such signal"
    _, base, arm = KIND[name]
    if about.unit not in (base, arm, f"{base}; {arm}"):
        return f"its unit is {shortly(about.unit)}, not '{base or arm}'"
    if len(about.labels) != width:
        return f"it has {width} columns and {len(about.labels)} labels"
    wanted = labels_of(name, width, meta)
    if wanted and about.labels != wanted:
        return f"its columns are {shortly(', '.join(about.labels))}, not {shortly(', '.join(wanted))}"
    return f"a label has more than {MOST_TEXT} letters" if max(map(len, about.labels)) > MOST_TEXT else ""


def time_problem(time: Array) -> str:
    """The fault in the time of the rows, which must be finite, below `LONGEST` and increase; empty without one."""
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        return f"row {bad[0]} is at {time[bad[0]]} s"
    if len(time) and np.abs(time[[0, -1]]).max() >= LONGEST:
        return f"it is from {time[0]:g} to {time[-1]:g} s, and no time is further than {LONGEST:g} s from 0"
    back = np.flatnonzero(np.diff(time) <= 0)
    return (
        f"row {back[0] + 1} is at {time[back[0] + 1]:g} s, the one before at {time[back[0]]:g} s" if len(back) else ""
    )


def require_plain(value: Any) -> None:
    """Refuse what cannot be written again as JSON in UTF-8 (`Damaged`)."""
    level = [value]
    for _ in range(DEEPEST):
        texts = [item for item in level if isinstance(item, str)]
        if not all(map(is_utf8, texts)):
            raise Damaged("it is not a text in UTF-8")
        inner = [item for item in level if isinstance(item, dict | list | tuple)]
        level = [part for item in inner for part in (item if not isinstance(item, dict) else [*item, *item.values()])]
        if not level:
            return
    raise Damaged(f"it is nested more than {DEEPEST} levels deep")


def is_utf8(text: str) -> bool:
    """Whether a text can be written as UTF-8: one that was read from other bytes cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
