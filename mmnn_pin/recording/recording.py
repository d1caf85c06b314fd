"""One run, on disk or in memory: signals with units, weights, config, URDF, versions and the outcome.

`Recording` reads it, `recorder.Recorder` writes it, `run_file` describes the HDF5 file and `schema` what it must be. A
run that was killed is readable up to its last flush. Whoever made a file: its texts and names are data. Nothing that
they name is run, and nothing opened but the meshes of a robot whose own file still lies where the run found it
(`robot_file`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cached_property, lru_cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import msgspec
import numpy as np

from ..errors import InputError, RecordingError, UnknownName
from ..model.base.overrides import Overrides
from ..model.robot import Robot
from ..settings.arguments import checked, faced
from ..shown import ShownView, shown
from ..signals import INDEX, Array
from .reading import AGAIN, contents, read_arrays
from .robot_file import robot_of
from .run_file import Arrays, Places, RunFile, SignalColumns, decode, encode
from .tracking import Errors, prismatic_joints

if TYPE_CHECKING:
    from pandas import DataFrame
T = TypeVar("T")

Status = Literal["completed", "diverged", "tripped", "interrupted"]


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        status: `completed`, `diverged`, `tripped` (by the safety layer) or `interrupted` (by the user or a kill).
        time: When it ended, of a tripped run when it tripped [s].
        signal: Signal that went first, as `name[index]`; empty if none.
        message: One line for people.
    """

    status: Status
    time: float
    signal: str = ""
    message: str = ""


@faced
class Recording:
    """The signals of one run by name, each read from the file when it is first asked for.

    `recording["z"]` is the velocity error (3.6), shape (N, nb); scalar signals have shape (N,). Iterating gives
    the names, `len` the number of rows. Made by `Recording.open` or by `Recorder.finish`.

    Attributes:
        meta: Robot, controller, seed, versions and whatever else the run was given.
        outcome: How the run ended; `interrupted` for a run that was killed.
        complete: Whether the run closed its file itself.
        damage: What of a damaged file cannot be read, as `signals/z`, and why; empty for a sound one.
        path: The file, None for a recording in memory.

    >>> robot = load("platform_arm")
    >>> path = Trajectory.of(robot, base=Line(speed=0.3))
    >>> file = Loop(robot, path, PD(), timing=Timing(duration=0.1)).run().save("pd.h5")
    >>> run = Recording.open(file)
    >>> run["z"].shape, run.labels("z"), run.errors()["x"].unit
    ((50, 2), ('v', 'w'), 'm')
    """

    @checked
    def __init__(
        self,
        *,
        columns: Mapping[str, SignalColumns],
        rows: int,
        read: Callable[[str], Arrays],
        meta: Mapping[str, Any],
        texts: Mapping[str, str],
        outcome: Outcome | None,
        damage: Mapping[str, str] | None = None,
        path: Path | None = None,
    ) -> None:
        self._columns = {name: columns[name] for name in sorted(columns, key=lambda n: INDEX.get(n, len(INDEX)))}
        self._rows, self._read = rows, read
        self._signals: Arrays = {}
        self.meta, self.path, self.damage, self._texts = dict(meta), path, dict(damage or {}), dict(texts)
        self.complete = outcome is not None
        self.outcome = outcome or self._killed()

    @classmethod
    @checked
    def open(cls, path: str | Path) -> Recording:
        """Read a recording from a file; its signals stay on disk until asked for.

        Raises:
            RecordingError: No such file, not HDF5, not a recording, one that breaks the schema, or by a newer mmnn_pin.
        """
        path = Path(path)
        found = contents(path)
        end = dict(found.end)
        return cls(
            columns=found.columns,
            rows=found.rows,
            read=from_file(path, found.rows),
            meta=found.meta,
            texts=found.texts,
            outcome=Outcome(end.pop("outcome"), **end) if end else None,
            damage=found.damage,
            path=path,
        )

    @property
    def config_text(self) -> str:
        """The config of the run, empty where it had none.

        Raises:
            RecordingError: It is damaged.
        """
        return self._text("config")

    @property
    def urdf(self) -> str:
        """The robot's URDF, empty where it is not known.

        Raises:
            RecordingError: It is damaged.
        """
        return self._text("urdf")

    def require_whole(self) -> None:
        """Refuse a damaged recording, where a part alone would give wrong numbers (`RecordingError`)."""
        for where in self.damage:
            self._require_intact(where)

    def read_signals(self) -> None:
        """Read all signals, the file opened once for all; a damaged one raises (`RecordingError`)."""
        if self.path is not None and self._signals.keys() != self._columns.keys():
            self._signals |= self._read("signals")

    def fact(self, name: str, kind: type[T]) -> T:
        """A fact of the run as settings of a kind.

        Raises:
            RecordingError: It is not there, or not of this kind.
        """
        if name not in self.meta:
            what, why = f"the recording does not hold its '{name}'", "an older mmnn_pin wrote it"
            raise RecordingError(what, why=why, file=self.path)
        with self.using(f"its attribute '{name}'"):
            return msgspec.convert(self.meta[name], kind)

    @contextmanager
    def using(self, what: str) -> Iterator[None]:
        """Facts of the run are made into something within: what they cannot be made into is the recording's error.

        Args:
            what: Which facts, for the message.

        Raises:
            RecordingError: They cannot be used.
        """
        try:
            yield
        except RecordingError:
            raise
        except (InputError, msgspec.ValidationError, LookupError, TypeError, ValueError, AttributeError) as error:
            why = " ".join(str(error).removeprefix("error: ").split())
            raise RecordingError(f"{what} cannot be used", why=why, fix=AGAIN, file=self.path) from error

    def __getitem__(self, name: str) -> Array:
        if name not in self._signals:
            self._about(name)
            self._signals |= self._read(f"signals/{name}")
        return self._signals[name]

    def __contains__(self, name: object) -> bool:
        return name in self._columns

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return self._rows

    def __bool__(self) -> bool:
        return True

    def __repr__(self) -> str:
        return f"<Recording: {self.summary()}>"

    def _repr_html_(self) -> str:
        """Summary, plots and replay in a notebook."""
        return str(shown(self, "html"))

    @checked
    def view(self, *, port: int = 7007, package_dirs: Sequence[str | Path] = ()) -> ShownView:
        """Play it in meshcat, again and again; a notebook shows what is returned, in a script open its `url`.

        Args:
            port: Port to listen on, on this machine alone, or the next one that is free; 0 takes any.
            package_dirs: Folders to look for meshes in before those that it knows.

        Raises:
            RecordingError: It has nothing to show, or does not hold its robot.
            ConfigError: No port is free.
        """
        made: ShownView = shown(self, "view", port=port, package_dirs=package_dirs)
        return made

    @property
    def names(self) -> tuple[str, ...]:
        """Signals recorded; those that the robot does not have (size 0) are left out."""
        return tuple(self._columns)

    @property
    def time(self) -> Array:
        """Time of every row [s], shape (N,)."""
        return self["time"]

    def unit(self, name: str) -> str:
        """Unit of a signal; base and arm parts separated by a semicolon."""
        return self._about(name).unit

    def labels(self, name: str) -> tuple[str, ...]:
        """Label of every column of a signal, e.g. `("x", "y", "phi")`."""
        return self._about(name).labels

    @checked
    def errors(self, start: float = 0.0, stop: float = np.inf) -> Errors:
        """How well the robot followed its reference: RMS, peak and last error of the base and of every joint.

        They are those of the robot, not of what its sensors say, where the recording knows both.

        Args:
            start: Since when [s].
            stop: Until before when [s].

        Raises:
            RecordingError: The errors are damaged, or the run has no row in that time.
        """
        columns, slides = {}, prismatic_joints(self.urdf)
        for name in ("pose_error", "e"):
            true, labels = f"true_{name}", self.labels(name) if name in self else ()
            for i, label in enumerate(labels):
                unit = "m" if label in (slides if name == "e" else ("x", "y")) else "rad"
                columns[label] = as_columns(self[true if true in self else name])[:, i], unit
        if not ((self.time >= start) & (self.time < stop)).any():
            end = f"it ends at {self.outcome.time:g} s" if len(self) else "it has no rows"
            until = "on" if stop == np.inf else f"to {stop:g} s"
            raise RecordingError(f"no samples from {start:g} s {until}", why=end, file=self.path)
        return Errors.of(self.time, columns, start, stop)

    def columns(self) -> dict[str, Array]:
        """All columns of all signals, (N,) each: `z.v`, `torque.arm_1_joint`, and `time`."""
        return {
            name: values
            for signal in self
            for name, values in zip(self.column_names(signal), as_columns(self[signal]).T, strict=True)
        }

    def column_names(self, signal: str) -> list[str]:
        """Names of a signal's columns in a table."""
        own = (signal, f"{signal}[")
        return [n if n == own[0] or n.startswith(own[1]) else f"{signal}.{n}" for n in self.labels(signal)]

    def to_dataframe(self) -> DataFrame:
        """All signals as a pandas DataFrame over time [s]; its columns are those of `columns`.

        Raises:
            RecordingError: pandas is not installed, or a signal is damaged.
        """
        try:
            pandas = import_module("pandas")
        except ModuleNotFoundError:
            fix = "pip install pandas; or take recording.columns(), a dictionary of arrays"
            raise RecordingError("no DataFrame", why="pandas is not installed", fix=fix) from None
        return pandas.DataFrame(self.columns()).set_index("time")

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the recording to an HDF5 file, which `Recording.open` and `mmnn` read.

        Args:
            path: The file.
            force: Replace an existing one.

        Raises:
            RecordingError: It is damaged, the file exists, or it cannot be written.
        """
        self.require_whole()
        arrays = {name: as_columns(self[name]) for name in self}
        places = Places.of({name: array.shape[1] for name, array in arrays.items()})
        file = RunFile(Path(path), force, places, self._columns, self.meta, self._texts, len(self))
        file.write(np.ascontiguousarray(np.hstack([*arrays.values()])), self.step_times)
        if self.weights:
            file.weights(self.weights)
        file.finish(asdict(self.outcome), self.final)
        return Path(path)

    @cached_property
    def weights(self) -> Arrays:
        """Snapshots of the networks' weights, each (k, ...), and their `time` (k,) [s]; empty if none were taken."""
        return self._read("weights")

    @cached_property
    def final(self) -> Arrays:
        """The states of controller, hardware and plant at the end of the run."""
        return self._read("final")

    @cached_property
    def step_times(self) -> Array:
        """Wall-clock time that every step took [s], shape (N,); 0 where it was not measured."""
        return self._read("timing/step_time")["step_time"]

    def summary(self) -> str:
        """Controller and robot, how the run ended and how much was recorded, in one or two lines."""
        who = " on ".join(str(self.meta[key]) for key in ("controller", "robot") if key in self.meta)
        end = f"{self.outcome.status} at t = {self.outcome.time:g} s, {self._rows:,} rows"
        return "\n".join(line for line in (f"{who}: {end}" if who else end, self.outcome.message) if line)

    def _text(self, name: str) -> str:
        self._require_intact(name)
        return self._texts.get(name, "")

    def _require_intact(self, where: str) -> None:
        if where in self.damage:
            raise RecordingError(f"{where} is damaged", why=self.damage[where], fix=AGAIN, file=self.path)

    def _about(self, name: str) -> SignalColumns:
        self._require_intact(f"signals/{name}")
        if name not in self._columns:
            raise UnknownName("signal", str(name), self._columns, file=self.path)
        return self._columns[name]

    def _killed(self) -> Outcome:
        if not self._rows:
            return Outcome("interrupted", 0.0, message="run incomplete: no rows")
        if "time" not in self._columns:
            return Outcome("interrupted", 0.0, message=f"run incomplete: {self._rows:,} rows, its time is damaged")
        end = float(self.time[-1])
        return Outcome("interrupted", end, message=f"run incomplete: {self._rows:,} rows, ends at t = {end:g} s")


def from_file(path: Path, rows: int) -> Callable[[str], Arrays]:
    """A reader of the arrays of a file with so many rows, which reads them when they are asked for."""
    return lambda where: read_arrays(path, where, {"weights": -1, "final": None}.get(where, rows))


def as_columns(signal: Array) -> Array:
    """Signal as (N, size), also where a recording holds (N,)."""
    return signal if signal.ndim == 2 else signal[:, None]


def recorded_robot(recording: Recording, package_dirs: Sequence[str | Path] = ()) -> Robot:
    """The true robot of a recording.

    Its meshes are read from the folders given, and from where the run found them if the robot's own file still lies
    there unchanged, or is a xacro file that names them: a recording makes nobody read other files. Wheels whose radius
    came from a mesh need it.

    Args:
        recording: The recording.
        package_dirs: Folders that hold the packages of its meshes, or the meshes.

    Raises:
        RecordingError: It does not hold these facts, or another robot comes out of them.
        InputError: As `load`.
    """
    meta = recording.meta
    if missing := [key for key in ("urdf_file", "mass_factors", "viscous", "joint_friction") if key not in meta]:
        what = f"the recording does not tell '{missing[0]}' of its robot"
        raise RecordingError(what, why="an older mmnn_pin wrote it", file=recording.path)
    stated, found = recording.fact("overrides", Overrides), tuple(map(str, meta.get("package_path", ())))
    robot = robot_of(recording.urdf, Path(meta["urdf_file"]), stated, found, tuple(map(str, package_dirs)))
    for key in ("velocity_names", "position_names", "actuator_names"):
        own, told = getattr(robot, key), tuple(meta.get(key, ()))
        if own != told:
            why = f"it moves by {', '.join(own)}, not by {', '.join(told)}"
            raise RecordingError("another robot comes out of the recording's facts", why=why, file=recording.path)
    with recording.using("what it tells of masses and friction"):
        changes = (meta["mass_factors"], meta.get("armature", 0.0), meta["viscous"], meta["joint_friction"])
        return with_changes(robot, encode(changes))


@lru_cache(maxsize=4)  # runs of one experiment share it, and what is made for it
def with_changes(robot: Robot, changes: str) -> Robot:
    """A robot with masses, rotors and friction of a recording, as `encode` has them."""
    masses, armature, viscous, friction = decode(changes)
    changed = robot.with_masses(masses).with_armature(armature).with_friction(viscous)
    return changed.changed(**friction_of(robot, friction))


def friction_of(robot: Robot, recorded: Mapping[str, Any]) -> dict[str, Any]:
    """Friction of the joints as fields of a robot.

    Raises:
        ValueError: It is none, or that of another robot.
    """
    found = {name: np.array(value) if isinstance(value, list) else value for name, value in recorded.items()}
    for name, value in found.items():
        sizes = ((),) if name == "stribeck" else ((), (robot.dimensions.full,))
        if name not in ("damping", "coulomb", "breakaway", "stribeck") or np.shape(value) not in sizes:
            raise ValueError(f"'{name}' of joint_friction does not suit the robot")
        if not np.isfinite(value).all() or np.min(value, initial=np.inf) < 0:
            raise ValueError(f"'{name}' of joint_friction is negative or not finite")
    return found


def trailer_guided(recording: Recording) -> bool:
    """Whether a trailer follows the reference, not the base."""
    kinematic = recording.meta.get("kinematic")
    trailer = isinstance(kinematic, Mapping) and kinematic.get("guide") == "trailer"
    return trailer and "world_error" in recording


def guided_pose(recording: Recording) -> Array:
    """(N, 3) measured pose of what follows the reference, the base or a trailer [m, m, rad]."""
    return recording["pose_ref"] - recording["world_error"] if trailer_guided(recording) else recording["pose"]


def recorded_position(recording: Recording, robot: Robot) -> Array:
    """Where a robot was, (N, nv): the true position, or without one what was measured, the other joints at rest."""
    if "position" in recording:
        return as_columns(recording["position"])
    table = np.tile(robot.neutral_position(), (len(recording), 1))
    if "pose" in recording:
        table[:, :3] = recording["pose"]
    if "q" in recording:
        table[:, robot.arm_index] = as_columns(recording["q"])
    if "shape" in recording:
        table[:, robot.shape_index] = as_columns(recording["shape"])
    robot.follow(table.T)
    return table
