"""One run, on disk or in memory: signals with units, weights, config, URDF, versions and the outcome.

`Recording` reads it, `recorder.Recorder` writes it, `run_file` describes the HDF5 file. A run that was killed
is readable up to its last flush.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from ..errors import RecordingError, UnknownName
from ..model.base.overrides import Overrides
from ..model.loading import build
from ..model.robot import Robot
from ..model.urdf.reading import parse
from ..signals import INDEX, Array
from .run_file import Arrays, Columns, decode, open_run, read_arrays

OUTCOME = ("outcome", "outcome_time", "outcome_signal", "outcome_message")
# Names in the group `final` of recordings before version 0.2, and what they are called now.
FINAL_OF_OLD = {"memory": "controller_state", "rig_memory": "hardware_state"}
NOT_META = ("format", "format_version", "complete", *OUTCOME)

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


class Recording:
    """The signals of one run by name, each read from the file when it is first asked for.

    `recording["z"]` is the velocity error (3.6), shape (N, nb); scalar signals have shape (N,). Iterating gives
    the names, `len` the number of rows. Made by `Recording.open` or by `Recorder.finish`.

    Attributes:
        meta: Robot, controller, seed, versions and whatever else the run was given.
        outcome: How the run ended; `interrupted` for a run that was killed.
        complete: Whether the run closed its file itself.
        config_text: The config of the run.
        urdf: The robot's URDF.
        path: The file, None for a recording in memory.
    """

    def __init__(
        self,
        *,
        columns: Mapping[str, Columns],
        rows: int,
        read: Callable[[str], Arrays],
        meta: Mapping[str, Any],
        texts: Mapping[str, str],
        outcome: Outcome | None,
        path: Path | None = None,
    ) -> None:
        self._columns = {name: columns[name] for name in sorted(columns, key=lambda n: INDEX.get(n, len(INDEX)))}
        self._rows, self._read = rows, read
        self._signals: Arrays = {}
        self.meta, self.path = dict(meta), path
        self.config_text, self.urdf = texts.get("config", ""), texts.get("urdf", "")
        self.complete = outcome is not None
        self.outcome = outcome or self._killed()

    @classmethod
    def open(cls, path: str | Path) -> Recording:
        """Read a recording from a file; its signals stay on disk until asked for.

        Raises:
            RecordingError: No such file, not HDF5, not a recording, or written by a newer mmnn_pin.
        """
        path = Path(path)
        with open_run(path) as file:
            rows = min(len(table) for group in ("signals", "timing") for table in file[group].values())
            end = {name.removeprefix("outcome_"): decode(file.attrs[name]) for name in OUTCOME if name in file.attrs}
            return cls(
                columns={n: Columns(t.attrs["unit"], decode(t.attrs["labels"])) for n, t in file["signals"].items()},
                rows=rows,
                read=lambda where: read_arrays(path, where, {"weights": -1, "final": None}.get(where, rows)),
                meta={name: decode(value) for name, value in file.attrs.items() if name not in NOT_META},
                texts={name: file[name].asstr()[()] for name in ("config", "urdf") if name in file},
                outcome=Outcome(end.pop("outcome"), **end) if file.attrs["complete"] else None,
                path=path,
            )

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
        """Summary, plots and replay in a notebook; what shows recordings stands above them, so it is found by name."""
        return str(import_module("mmnn_pin.lab.show.gallery").notebook_html(self))

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

    @cached_property
    def weights(self) -> Arrays:
        """Snapshots of the networks' weights, each (k, ...), and their `time` (k,) [s]; empty if none were taken."""
        return self._read("weights")

    @cached_property
    def final(self) -> Arrays:
        """The states of controller, hardware and plant at the end of the run."""
        return {FINAL_OF_OLD.get(name, name): array for name, array in self._read("final").items()}

    @cached_property
    def step_times(self) -> Array:
        """Wall-clock time that every step took [s], shape (N,); 0 where it was not measured."""
        return self._read("timing/step_time")["step_time"]

    def summary(self) -> str:
        """What was run, how it ended and how much was recorded, in one or two lines."""
        who = " on ".join(str(self.meta[key]) for key in ("controller", "robot") if key in self.meta)
        end = f"{self.outcome.status} at t = {self.outcome.time:g} s, {self._rows:,} rows"
        return "\n".join(line for line in (f"{who}: {end}" if who else end, self.outcome.message) if line)

    def _about(self, name: str) -> Columns:
        if name not in self._columns:
            raise UnknownName("signal", str(name), self._columns, file=self.path)
        return self._columns[name]

    def _killed(self) -> Outcome:
        if not self._rows:
            return Outcome("interrupted", 0.0, message="run incomplete: no rows")
        end = float(self.time[-1])
        return Outcome("interrupted", end, message=f"run incomplete: {self._rows:,} rows, ends at t = {end:g} s")


def as_columns(signal: Array) -> Array:
    """Signal as (N, size), also where a recording holds (N,)."""
    return signal if signal.ndim == 2 else signal[:, None]


def recorded_robot(recording: Recording) -> Robot:
    """The true robot of a recording.

    Meshes are looked for where the file was; wheels whose radius came from one need it.

    Args:
        recording: The recording.

    Raises:
        RecordingError: It does not hold these facts, or another robot comes out of them.
        InputError: As `load`.
    """
    meta = recording.meta
    try:
        overrides = msgspec.convert(meta["overrides"], Overrides)
        document = parse(recording.urdf.encode(), meta["urdf_file"], overrides.strict, overrides.package_dirs)
        masses, viscous, gears = meta["mass_factors"], meta["viscous"], meta["joint_friction"]
    except KeyError as error:
        what = f"the recording does not tell {error} of its robot"
        raise RecordingError(what, why="an older mmnn_pin wrote it", file=recording.path) from None
    robot = build(document, overrides)
    if robot.position_names != meta["position_names"] or robot.velocity_names != meta["velocity_names"]:
        why = f"it moves by {', '.join(robot.velocity_names)}, not by {', '.join(meta['velocity_names'])}"
        raise RecordingError("another robot comes out of the recording's facts", why=why, file=recording.path)
    gears = {name: np.array(value) if isinstance(value, list) else value for name, value in gears.items()}
    robot = robot.with_masses(masses).with_armature(meta.get("armature", 0.0)).with_friction(viscous)
    return replace(robot, **gears)


def recorded_position(recording: Recording, robot: Robot) -> Array:
    """Where a robot was, (N, nv): the true position, or without one what was measured, the other joints at rest."""
    if "position" in recording:
        return as_columns(recording["position"])
    table = np.tile(robot.neutral_position(), (len(recording), 1))
    if "pose" in recording:
        table[:, :3] = recording["pose"]
    if "q" in recording:
        table[:, robot.arm_index] = as_columns(recording["q"])
    robot.follow(table.T)
    return table
