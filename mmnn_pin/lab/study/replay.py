"""One row of a study run again, alone and with all its signals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...recording.metrics import metrics
from .plan import Plan, Row, short
from .store import NAME, Stored, reading
from .worker import Task, loop_of


@dataclass(frozen=True)
class Replay:
    """A row that was run again.

    Attributes:
        row: The row.
        file: Its recording.
        status: How it ended.
        message: One line for people.
        metrics: Its numbers.
        stored: The row in the database; None if it is not there, or there with other settings.
    """

    row: Row
    file: Path
    status: str
    message: str
    metrics: dict[str, float]
    stored: Stored | None

    @property
    def different(self) -> list[str]:
        """Metrics that are not the stored ones bit for bit; "outcome" where it ended otherwise."""
        if self.stored is None:
            return []
        ended = [] if self.stored.status == self.status else ["outcome"]
        names = dict.fromkeys([*self.stored.metrics, *self.metrics])
        return ended + [n for n in names if not same(self.stored.metrics.get(n), self.metrics.get(n))]

    @property
    def same(self) -> bool | None:
        """Whether all its numbers are the stored ones; None where none are stored."""
        return None if self.stored is None else not self.different

    def to_dict(self) -> dict[str, Any]:
        """The same for JSON."""
        numbers = {name: value if math.isfinite(value) else None for name, value in self.metrics.items()}
        about = {"row": self.row.id, "controller": self.row.controller, "seed": self.row.seed}
        told = {"parameters": self.row.parameters, "file": str(self.file), "outcome": self.status}
        return (
            about | told | {"message": self.message, "metrics": numbers, "same": self.same, "different": self.different}
        )

    def told(self) -> str:
        """The same for people."""
        values = ", ".join(f"{name} = {short(value)}" for name, value in self.row.parameters.items())
        lines = [f"row {self.row.id}: {self.row.controller}, seed {self.row.seed}", f"  {values}"]
        lines.append(f"  {self.status}{': ' if self.message else ''}{self.message}")
        if self.stored is None:
            lines.append("  not in the database with these settings, so nothing to compare")
        elif self.different:
            made = f"made on {self.stored.host}"
            lines.append(f"  OTHER numbers than the stored ones ({made}): {', '.join(self.different[:6])}")
        else:
            lines.append(f"  the same numbers as stored, bit for bit: all {len(self.metrics)}")
        return "\n".join([*lines, f"wrote {self.file}"])


def replay(plan: Plan, number: int, folder: Path, force: bool = False) -> Replay:
    """Run a row alone and record all its signals in `folder/rows/NUMBER.h5`.

    Args:
        plan: The study's runs.
        number: The row's.
        folder: Of the database.
        force: Replace the recording.

    Raises:
        ConfigError: No such row.
        RecordingError: The recording exists.
        InputError: The run cannot be made.
    """
    row = plan.row(number)
    file = folder / "rows" / f"{number}.h5"
    loop = loop_of(Task.of(row))
    about = {"experiment": f"{plan.study.name} row {number}", "config": row.experiment.to_json()}
    recording = loop.run(file, force=force, meta=about | {"study_parameters": row.parameters})
    found = None
    if (folder / NAME).exists():
        with reading(folder / NAME) as store:
            found = store.row(number)
    stored = found if found is not None and found.fingerprint == row.fingerprint else None
    outcome = recording.outcome
    return Replay(row, file, outcome.status, outcome.message, metrics(recording, row.experiment.windows), stored)


def same(one: float | None, other: float | None) -> bool:
    """Whether two numbers are the same, nan too."""
    return one == other or (one is not None and other is not None and math.isnan(one) and math.isnan(other))
