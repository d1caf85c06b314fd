"""A study's rows for other programs: one line per run as CSV or Parquet."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ...study.results import Results
from ...study.store import Stored
from ..export import write_as

ABOUT = ("id", "point", "controller", "seed", "status", "time", "signal", "message", "seconds", "host", "finished")


def columns(results: Results) -> dict[str, list[Any]]:
    """Column to its values, a row per run: facts, `factor NAME`, metrics by name."""
    rows: list[Stored] = [*results.rows, *results.failed]
    rows.sort(key=lambda row: row.id)
    table: dict[str, list[Any]] = {name: [getattr(row, name) for row in rows] for name in ABOUT}
    for name in results.settings.factors:
        table[f"factor {name}"] = [simple(row.parameters.get(name)) for row in rows]
    for name in results.units:
        table[name] = [row.metrics.get(name) for row in rows]
    return table


def simple(value: Any) -> Any:
    """A value that a cell can hold: lists as JSON."""
    return json.dumps(value) if isinstance(value, list | tuple) else value


def write_csv(results: Results, path: Path) -> None:
    """One line of names, then the rows, numbers written so that reading gives the same bits."""
    table = columns(results)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        writer.writerows(zip(*table.values(), strict=True))


def write_parquet(results: Results, path: Path) -> None:
    """The table; units in the metadata of its columns, the study's facts in that of the file, under `mmnn_pin`."""
    import pyarrow
    import pyarrow.parquet

    table = columns(results)
    arrays = [pyarrow.array(uniform(values)) for values in table.values()]
    fields = [
        pyarrow.field(name, array.type, metadata={"unit": results.units.get(name, "")})
        for name, array in zip(table, arrays, strict=True)
    ]
    schema = pyarrow.schema(fields, metadata={"mmnn_pin": json.dumps(dict(results.meta))})
    pyarrow.parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), path)


def uniform(values: list[Any]) -> list[Any]:
    """Values of one type: numbers that are not all whole as floats, other mixtures as texts."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return [None if value is None else float(value) for value in values]
    return values if len(kinds) < 2 else [None if value is None else str(value) for value in values]


def export(results: Results, path: Path, to: str, *, force: bool = False) -> Path:
    """Write the rows; the file appears whole or not at all.

    Raises:
        UnknownName: A format that has no rows.
        RecordingError: The file exists or cannot be written; a package is missing.
    """
    return write_as(FORMATS, "format for the rows of a study", results, path, to, force)


FORMATS: Mapping[str, Callable[[Results, Path], None]] = {"csv": write_csv, "parquet": write_parquet}
