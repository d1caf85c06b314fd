"""Recordings as tables: one row per control sample, one column per column of a signal.

A column is named `signal.label`, such as `z.v` or `torque.arm_1_joint`; a signal of one column by its own name.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....recording.recording import Recording, as_columns
from ....signals import Array
from ..units import column_units


@dataclass(frozen=True, eq=False)
class Column:
    """A column: its name, its unit (empty for a pure number), its values (N,)."""

    name: str
    unit: str
    values: Array


def columns_of(recording: Recording) -> Iterator[Column]:
    """All columns of all signals, the time first."""
    for signal in recording:
        labels, units = recording.labels(signal), column_units(recording, signal)
        for label, unit, values in zip(labels, units, as_columns(recording[signal]).T, strict=True):
            own = label == signal or label.startswith(f"{signal}[")
            yield Column(label if own else f"{signal}.{label}", unit, values)


def about(recording: Recording) -> dict[str, Any]:
    """What a recording tells beside its signals, as JSON has it: facts, outcome, config, URDF."""
    end = recording.outcome
    outcome = {"status": end.status, "time": end.time, "signal": end.signal, "message": end.message}
    facts = json.loads(json.dumps(recording.meta, default=lambda array: np.asarray(array).tolist()))
    return {"meta": facts, "outcome": outcome, "config": recording.config_text, "urdf": recording.urdf}


def write_csv(recording: Recording, path: Path) -> None:
    """One line of names with units, `z.v [m/s]`, then the numbers, written so that reading gives the same bits."""
    columns = list(columns_of(recording))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f"{column.name} [{column.unit}]" if column.unit else column.name for column in columns])
        writer.writerows(np.column_stack([column.values for column in columns]).tolist())


def write_npz(recording: Recording, path: Path) -> None:
    """Signals by name, `weights/NAME`, `final/NAME`, `step_time`, and `about`: JSON with labels, units and facts."""
    arrays: dict[str, Any] = {name: recording[name] for name in recording} | {"step_time": recording.step_times}
    told = {name: {"labels": recording.labels(name), "units": column_units(recording, name)} for name in recording}
    groups = {"weights": recording.weights, "final": recording.final}
    arrays |= {f"{group}/{name}": array for group, found in groups.items() for name, array in found.items()}
    arrays["about"] = np.array(json.dumps(about(recording) | {"signals": told}))
    with path.open("wb") as file:
        np.savez_compressed(file, **arrays)


def write_parquet(recording: Recording, path: Path) -> None:
    """The table; units in the metadata of its columns, facts in that of the file, under `mmnn_pin`."""
    import pyarrow
    import pyarrow.parquet

    columns = list(columns_of(recording))
    fields = [pyarrow.field(c.name, pyarrow.float64(), metadata={"unit": c.unit}) for c in columns]
    schema = pyarrow.schema(fields, metadata={"mmnn_pin": json.dumps(about(recording))})
    arrays = [pyarrow.array(np.ascontiguousarray(c.values)) for c in columns]
    pyarrow.parquet.write_table(pyarrow.Table.from_arrays(arrays, schema=schema), path)
