"""Controllers compared on a robot and a trajectory made in Python: an experiment without a file.

`Assembled` is an experiment whose robot, trajectory and controllers are objects. All that is said beside them has the
keys that a file has, so that its gains, sensors, plants and periods are made in the one way that there is.
"""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ...errors import ConfigError
from ...model.robot import Robot
from ...reference import Trajectory
from ...settings import Timing
from ...settings.arguments import checked_but
from ...signals import Array
from ...torque.controller import Controller
from .config import config_error, put
from .experiment import Experiment
from .laws import name_of
from .result import Result
from .runner import run_experiment

ENDLESS = 10.0  # duration of a run along a trajectory without an end [s]
FIRST = 1.0  # the errors of the start are told apart from the later ones [s]
DEFAULT = ("pd_gravity", "pid", "feedforward", "two_layer", "learned")
TAKEN = ("robot", "reference", "controllers", "cases", "held_out")  # keys that the objects stand for
DEFAULTS: Mapping[str, Any] = {  # kinematic gains and learners, those of `mmnn run track`
    "weights_interval": 0.1,
    "kinematic": {"kx": 3.0, "ky": 16.0, "kth": 8.0, "K": 7.0, "holonomic": [3.0, 3.0, 3.0]},
    "robust": {"base": 1.0, "arm": 1.0, "ZB": [5.0, 5.0]},
    "two_layer": {
        "hidden": 22, "F": [0.2, 0.5], "G": [0.2, 0.5], "kappa": 0.05, "initial": "random", "v_range": 0.5,
    },
    "adaptive": {"rate": 20.0, "slowest": 0.3},
    "learning": {"rates": "per_sample", "within_loop": True, "within_limits": True},
}  # fmt: skip
LABEL = re.compile(r"[A-Za-z_][\w. -]*")
Controllers = Iterable[str | Controller] | Mapping[str, str | Controller]


class Assembled(Experiment, frozen=True, kw_only=True):
    """An experiment of objects, beside what else an experiment says.

    Args:
        given: The robot.
        path: The trajectory.
        own: Controllers by name.
    """

    given: Any = None
    path: Any = None
    own: dict[str, Any] = msgspec.field(default_factory=dict)

    @property
    def objects(self) -> Mapping[str, Any]:
        """The controllers that are objects."""
        return self.own

    def load_robot(self) -> Robot:
        """The robot; errors as of `made_true`."""
        return self.made_true(self.given)

    def made_true(self, robot: Robot) -> Robot:
        """The robot, changed only where masses, friction or rotors are said."""
        plain = self.masses == 1.0 and self.armature == 0.0 and self.friction == type(self.friction)()
        return robot if plain else super().made_true(robot)

    def trajectory_of(self, robot: Robot) -> Trajectory:
        """The trajectory, whatever the robot."""
        found: Trajectory = self.path
        return found

    def controller(self, name: str, gains: Array | None = None, robot: Robot | None = None) -> Any:
        """A controller: the object of that name, or one of the package; errors as in `Experiment.controller`."""
        return self.own[name] if name in self.own else super().controller(name, gains, robot)

    def setting(self, values: Mapping[str, str]) -> str:
        """The argument of `compare` that sets some of its keys."""
        pairs = ", ".join(f'"{key}": {value}' for key, value in values.items())
        return f"settings={{{pairs}}}"

    def to_json(self) -> str:
        """Nothing: no file says what the objects are."""
        return ""


def unlimited_notes(experiment: Experiment, robot: Robot) -> list[str]:
    """A note that motors give more than their limits, where the robot has some and the experiment keeps none."""
    if experiment.actuator.torque_limit is not None or not np.isfinite(robot.effort_limits).any():
        return []
    key = experiment.setting({"actuator.torque_limit": '"urdf"'})
    return [f"motors give whatever is asked, above the URDF's effort limits, too; {key} keeps to them"]


@checked_but("robot", "trajectory", "controllers")
def compare(
    robot: Robot,
    trajectory: Trajectory,
    controllers: Controllers = DEFAULT,
    *,
    duration: float | None = None,
    settings: Mapping[str, Any] | None = None,
    out: str | Path | None = None,
    force: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> Result:
    """Run controllers from equal starts along one trajectory, each with gains that suit the robot.

    Learners and kinematic gains are as `mmnn run track` has them; motors have no limits unless `actuator.torque_limit`
    says so.

    Args:
        robot: The robot.
        trajectory: What it should do.
        controllers: Names of `mmnn list`, controllers, `FILE.py:Class`, or these by names of your own.
        duration: Of the runs [s]; by default the trajectory's, or 10 s where it has no end.
        settings: More of the experiment: its keys to values, as `--set` takes them, such as `{"feedback.arm": 40.0,
            "sensor.noise": 1e-4, "seed": 3}`.
        out: Folder for the recordings; None keeps them in memory.
        force: Replace recordings that are there.
        progress: Called with a controller and the share of its run that is done.

    Returns:
        The runs: a mapping from names to recordings, with `table()`, `plot()`, `replay()` and `report()`.

    Raises:
        InputError: A robot, trajectory, controller or setting that cannot be used; nothing has been written then.

    >>> robot = load("platform_arm")
    >>> path = Trajectory.of(robot, base=Line(speed=0.3), arm={"arm_1_joint": Sine(0.5, period=4.0)})
    >>> runs = compare(robot, path, ["pd", "two_layer"], duration=0.4)
    >>> runs
    <Result: pd completed, two_layer completed>
    >>> best = min(runs, key=lambda name: runs[name].errors()["arm_1_joint"].rms)
    >>> runs["pd"].errors()["x"].unit
    'm'
    """
    experiment = assembled(robot, trajectory, controllers, duration=duration, settings=settings)
    folder = None if out is None else Path(out)
    leave_out = controllers is DEFAULT
    made = run_experiment(experiment, "comparison", out=folder, force=force, progress=progress, leave_out=leave_out)
    return replace(made, notes=(*made.notes, *unlimited_notes(experiment, robot)))


def assembled(
    robot: Robot,
    trajectory: Trajectory,
    controllers: Controllers,
    *,
    duration: float | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Assembled:
    """The experiment of these objects; arguments and errors as in `compare`."""
    require_kind(robot, Robot, "robot", "load('tiago')")
    require_kind(trajectory, Trajectory, "trajectory", "Trajectory.of(robot, base=..., arm=...)")
    names, own = by_name(controllers)
    table = copy.deepcopy(dict(DEFAULTS)) | {"robot": robot.name, "reference": {}, "controllers": names}
    for key, value in (settings or {}).items():
        if key.partition(".")[0] in TAKEN:
            what = f"'{key}' beside the objects that stand for it"
            raise ConfigError(what, fix="change the robot, the trajectory or the list of controllers", key="settings")
        put(table, key, value)
    times = table.setdefault("time", {})
    times.setdefault("integrator", "implicit_friction")  # light links in stiff joints, such as wrists, need it
    if duration is not None or "duration" not in times:
        times["duration"] = whole(duration or ending(trajectory), times.get("control_period", Timing().control_period))
    table.setdefault("windows", windows_of(times["duration"]))
    table["controllers"] = [name for name in names if name not in own] or ["pd"]
    try:
        said = msgspec.convert(table, Experiment)
    except msgspec.ValidationError as error:
        raise config_error(error, table) from error
    fields = {name: getattr(said, name) for name in Experiment.__struct_fields__}
    fields["controllers"] = tuple(name if name in own else name_of(name) for name in names)
    return Assembled(**fields, given=robot, path=trajectory, own=own)


def by_name(controllers: Controllers) -> tuple[list[str], dict[str, Controller]]:
    """Names in order, and the controllers among them that are objects.

    Raises:
        ConfigError: None, something that is no controller, or two of one name.
    """
    if isinstance(controllers, str | Controller | type) or not isinstance(controllers, Iterable):
        controllers = [controllers]
    pairs: list[tuple[str | None, Any]] = (
        list(controllers.items()) if isinstance(controllers, Mapping) else [(None, one) for one in controllers]
    )
    names: list[str] = []
    own: dict[str, Controller] = {}
    for label, one in pairs:
        if isinstance(one, type):
            raise ConfigError(f"{one.__name__} is a class", fix=f"write {one.__name__}()", key="controllers")
        if not isinstance(one, str | Controller):
            fix = "give names of `mmnn list`, or controllers such as PD()"
            raise ConfigError(f"{type(one).__name__} is no controller", fix=fix, key="controllers")
        if isinstance(one, str) and label not in (None, one):
            fix = f"give a controller, or leave the name '{label}' out"
            raise ConfigError(f"'{one}' under another name", fix=fix, key="controllers")
        name = label or (one if isinstance(one, str) else one.name)
        if name in names:
            fix = f"name them: {{'{name} soft': ..., '{name} stiff': ...}}"
            raise ConfigError(f"two controllers are called {name}", fix=fix, key="controllers")
        if not isinstance(one, str):
            if not LABEL.fullmatch(name):
                raise ConfigError(
                    f"'{name}' is no name for a file", fix="use letters, digits, _ and -", key="controllers"
                )
            own[name] = renamed(one, name)
        names.append(name)
    return names, own


def renamed(controller: Controller, name: str) -> Controller:
    """The controller under a name of tables and files."""
    if controller.name == name:
        return controller
    made = copy.copy(controller)
    object.__setattr__(made, "name", name)
    return made


def require_kind(value: Any, kind: type, key: str, fix: str) -> None:
    """Refuse an object of another kind (`ConfigError`)."""
    if not isinstance(value, kind):
        shown = f"'{value}'" if isinstance(value, str) else "None" if value is None else f"a {type(value).__name__}"
        raise ConfigError(f"{shown} is no {kind.__name__}", fix=f"give one: {fix}", key=key)


def ending(trajectory: Trajectory) -> float:
    """Duration of a run along a trajectory [s]."""
    return trajectory.duration if math.isfinite(trajectory.duration) else ENDLESS


def whole(duration: Any, period: Any) -> Any:
    """A duration, up to the next whole number of control periods [s]; what is no such number is judged elsewhere."""
    if not all(isinstance(part, int | float) and 0 < part < math.inf for part in (duration, period)):
        return duration
    return math.ceil(duration / period - 1e-6) * period


def windows_of(duration: Any) -> list[list[float]]:
    """The start of a run and the rest of it, as intervals [s]."""
    if not isinstance(duration, int | float) or not FIRST < duration < math.inf:
        return [[0.0, duration]]
    return [[0.0, FIRST], [FIRST, duration]]
