"""Recordings and the rows of a study in the formats of other programs: CSV, NumPy's npz, Parquet, and MCAP.

As a table, a recording has one row per control sample and one column per column of a signal, named `signal.label`, such
as `z.v` or `torque.arm_1_joint`; a signal of one column has its own name. Foxglove and PlotJuggler read the MCAP.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ConfigError, RecordingError, UnknownName
from ...files import whole_file
from ...recording.recording import Recording, as_columns
from ...signals import Array
from ..study.results import Results
from .curves import column_units

FACTS = "id point controller seed status time signal message seconds host finished"


@dataclass(frozen=True, eq=False)
class ExportColumn:
    """A column: its name, its unit (empty for a pure number), its values (N,), or as a list that may have gaps."""

    name: str
    unit: str
    values: Array | list[Any]


@dataclass(frozen=True)
class RecordingPart:
    """The part of a recording that is written."""

    signals: tuple[str, ...]  # names, with the time; all where there are none
    every: int  # n, of which every n-th sample is kept

    @classmethod
    def of(cls, recording: Recording, signals: Sequence[str], rate: float | None) -> RecordingPart:
        """From names of signals, and how many rows per second there are at most [Hz].

        Raises:
            UnknownName: A signal that the recording does not have.
            ConfigError: A rate that is not above 0.
            RecordingError: No signals.
        """
        for name in signals:
            if name not in recording:
                raise UnknownName("signal", name, list(recording), key="--signals")
        if not (found := named(recording, signals)):
            raise RecordingError("nothing to export", why="none of its signals can be read", file=recording.path)
        if rate is None or len(recording) < 2:
            return cls(found, 1)
        if not rate > 0.0:
            raise ConfigError(f"{rate:g} Hz", fix="give a rate above 0", key="--rate")
        period = float(np.median(np.diff(recording.time)))
        return cls(found, max(1, math.ceil(1.0 / (rate * period) - 1e-6)))


def named(recording: Recording, signals: Sequence[str]) -> tuple[str, ...]:
    """Signals in a recording's order, the time among them; all where none are named."""
    return tuple(name for name in recording if not signals or name in {"time", *signals})


def columns_of(recording: Recording, part: RecordingPart) -> Iterator[ExportColumn]:
    """The columns of signals, the time first."""
    for signal in part.signals:
        names, units = recording.column_names(signal), column_units(recording, signal)
        for name, unit, values in zip(names, units, as_columns(recording[signal])[:: part.every].T, strict=True):
            yield ExportColumn(name, unit, values)


def about(recording: Recording) -> dict[str, Any]:
    """The rest of a recording beside its signals, as JSON has it: facts, outcome, config, URDF."""
    facts = json.loads(json.dumps(recording.meta, default=lambda array: np.asarray(array).tolist()))
    found = {"meta": facts, "outcome": asdict(recording.outcome)}
    return found | {"config": recording.config_text, "urdf": recording.urdf}


def write_csv(recording: Recording, path: Path, part: RecordingPart) -> None:
    """One line of names with units, `z.v [m/s]`, then the numbers, written so that reading gives the same bits."""
    columns = list(columns_of(recording, part))
    heads = [f"{column.name} [{column.unit}]" if column.unit else column.name for column in columns]
    write_rows(path, heads, np.column_stack([column.values for column in columns]).tolist())


def write_rows(path: Path, heads: Iterable[str], rows: Iterable[Sequence[Any]]) -> None:
    """A CSV file."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(heads)
        writer.writerows(rows)


def write_npz(recording: Recording, path: Path, part: RecordingPart) -> None:
    """Signals by name, `weights/NAME`, `final/NAME`, `step_time`, and `about`: JSON with labels, units and facts."""
    arrays: dict[str, Any] = {name: recording[name][:: part.every] for name in part.signals}
    arrays["step_time"] = recording.step_times[:: part.every]
    labels = {name: {"labels": recording.labels(name), "units": column_units(recording, name)} for name in part.signals}
    groups = {"weights": recording.weights, "final": recording.final}
    arrays |= {f"{group}/{name}": array for group, found in groups.items() for name, array in found.items()}
    arrays["about"] = np.array(json.dumps(about(recording) | {"signals": labels}))
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def write_parquet(recording: Recording, path: Path, part: RecordingPart) -> None:
    """The table; units in the metadata of its columns, facts in that of the file, under `mmnn_pin`."""
    write_columns(path, columns_of(recording, part), about(recording))


def write_columns(path: Path, columns: Iterable[ExportColumn], facts: Mapping[str, Any]) -> None:
    """A Parquet file of columns with their units."""
    import pyarrow
    import pyarrow.parquet

    every = list(columns)
    arrays = [pyarrow.array(c.values if isinstance(c.values, list) else np.ascontiguousarray(c.values)) for c in every]
    typed = zip(every, arrays, strict=True)
    fields = [pyarrow.field(column.name, array.type, metadata={"unit": column.unit}) for column, array in typed]
    schema = pyarrow.schema(fields, metadata={"mmnn_pin": json.dumps(facts)})
    pyarrow.parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), path)


def write_mcap(recording: Recording, path: Path, part: RecordingPart) -> None:
    """Messages of ROS 2, see `bag.write_bag`; all of them."""
    from .bag import write_bag

    if part != RecordingPart(tuple(recording), 1):
        why, fix = "its messages are whole samples", "leave out --signals and --rate, or write a table"
        raise ConfigError("a part of a recording as MCAP", why=why, fix=fix, key="--to")
    write_bag(recording, path, about(recording))


FORMATS: Mapping[str, Callable[[Recording, Path, RecordingPart], None]] = {
    "csv": write_csv,
    "npz": write_npz,
    "parquet": write_parquet,
    "mcap": write_mcap,
}

DATASET = "lerobot"  # a folder


def export(
    recording: Recording,
    path: str | Path,
    to: str = "",
    *,
    force: bool = False,
    signals: Sequence[str] = (),
    rate: float | None = None,
) -> Path:
    """Write a recording, or a part of it, in another format, atomically.

    Args:
        recording: The run.
        path: The file, of a dataset its folder.
        to: One of `FORMATS`, or `DATASET`; by default what the file's name ends in.
        force: Replace an existing file.
        signals: Those that a table has beside the time; none for all.
        rate: Rows per second that a table has at most, samples of the run [Hz]; None for all.

    Raises:
        UnknownName: No such format, or no such signal.
        ConfigError: A rate that is not above 0, a part as MCAP.
        RecordingError: The file exists or cannot be written; a package is missing; for MCAP a recording that does not
            hold its robot.
    """
    path, part = Path(path), RecordingPart.of(recording, signals, rate)
    to = to or path.suffix[1:].lower()
    if to == DATASET:
        return as_dataset(recording, path, part, force)
    if to not in FORMATS:
        raise UnknownName("format", to, (*FORMATS, DATASET))
    return written(lambda file: FORMATS[to](recording, file, part), path, to, force)


def as_dataset(recording: Recording, path: Path, part: RecordingPart, force: bool) -> Path:
    """Write a recording as a LeRobot dataset, a folder; errors as in `export`."""
    from .lerobot import write_lerobot

    if part.signals != tuple(recording):
        why = "an episode has its states and actions"
        raise ConfigError("a part of a run's signals as a dataset", why=why, fix="leave out --signals", key="--signals")
    try:
        return write_lerobot(recording, path, part.every, force)
    except ModuleNotFoundError as error:
        raise missing(error, DATASET) from error


def missing(error: ModuleNotFoundError, to: str) -> RecordingError:
    """The error of a package that a format needs."""
    why = f"the package {(error.name or '').partition('.')[0]} is not installed"
    return RecordingError(f"cannot export to {to}", why=why, fix="pip install 'mmnn_pin[export]'")


def written(write: Callable[[Path], None], path: Path, to: str, force: bool) -> Path:
    """Write a file whole or not at all; errors as in `export`."""
    with whole_file(path, "file", force) as part:
        try:
            write(part)
        except ModuleNotFoundError as error:
            raise missing(error, to) from error
    return path


# -- the rows of a study -----------------------------------------------------------------------------------------------


def study_columns(results: Results) -> dict[str, list[Any]]:
    """ExportColumn to its values, a row per run: facts, `factor NAME`, metrics by name."""
    rows = sorted([*results.rows, *results.failed], key=lambda row: row.id)
    table: dict[str, list[Any]] = {name: [getattr(row, name) for row in rows] for name in FACTS.split()}
    for name in results.settings.factors:
        values = (row.parameters.get(name) for row in rows)
        table[f"factor {name}"] = [json.dumps(v) if isinstance(v, list | tuple) else v for v in values]
    return table | {name: [row.metrics.get(name) for row in rows] for name in results.units}


def write_study_csv(results: Results, path: Path) -> None:
    """One line of names, then the rows, numbers written so that reading gives the same bits."""
    table = study_columns(results)
    write_rows(path, table, zip(*table.values(), strict=True))


def write_study_parquet(results: Results, path: Path) -> None:
    """The table; units in the metadata of its columns, the study's facts in that of the file, under `mmnn_pin`."""
    columns = (ExportColumn(n, results.units.get(n, ""), uniform(v)) for n, v in study_columns(results).items())
    write_columns(path, columns, dict(results.meta))


def uniform(values: list[Any]) -> list[Any]:
    """Values of one type: numbers that are not all integers as floats, other mixtures as texts."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in values]
    return values if len(kinds) < 2 else [None if value is None else str(value) for value in values]


def export_study(results: Results, path: Path, to: str, *, force: bool = False) -> Path:
    """Write the rows, atomically.

    Raises:
        UnknownName: A format that has no rows.
        RecordingError: The file exists or cannot be written; a package is missing.
    """
    if to not in STUDY_FORMATS:
        raise UnknownName("format for the rows of a study", to, STUDY_FORMATS)
    return written(partial(STUDY_FORMATS[to], results), path, to, force)


STUDY_FORMATS: Mapping[str, Callable[[Results, Path], None]] = {"csv": write_study_csv, "parquet": write_study_parquet}
