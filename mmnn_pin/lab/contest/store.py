"""The rows that are done, in a file that is written whole after every controller, so that a contest goes on later."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from ...errors import RecordingError
from ...settings import plain
from ..study.worker import code_digest
from .row import Row, arm_of, base_of, known
from .task import Task

NAME, TABLE = "rows.json", "rows.csv"


class Heat(msgspec.Struct, frozen=True):
    """All rows of one controller on one task.

    Attributes:
        fingerprint: Of all that decides them.
        step_time: Processor time of the controller's step [s]; None where it was not measured.
        rows: One per seed.
    """

    fingerprint: str
    step_time: float | None
    rows: list[Row]


@dataclass
class Store:
    """What is done.

    Attributes:
        folder: Where the files are; None keeps everything in memory.
        heats: `task/controller` to what came of it.
    """

    folder: Path | None
    heats: dict[str, Heat] = field(default_factory=dict)

    @classmethod
    def opened(cls, folder: Path | None) -> Store:
        """The rows of a folder; none where there is no file.

        Raises:
            RecordingError: The file is not one of rows.
        """
        file = None if folder is None else folder / NAME
        if file is None or not file.exists():
            return cls(folder)
        try:
            return cls(folder, msgspec.json.decode(file.read_bytes(), type=dict[str, Heat]))
        except (OSError, msgspec.DecodeError) as error:
            fix = "replace it with --force, or choose another folder with --out"
            raise RecordingError("not a file of rows", why=str(error), fix=fix, file=file) from error

    def put(self, key: str, heat: Heat) -> None:
        """Keep what came of a controller on a task.

        Raises:
            RecordingError: The files cannot be written.
        """
        self.heats[key] = heat
        if self.folder is None:
            return
        write(self.folder / NAME, msgspec.json.encode(self.heats))
        write(self.folder / TABLE, as_csv([row for one in self.heats.values() for row in one.rows]).encode())


def write(path: Path, content: bytes) -> None:
    """Write a file whole or not at all.

    Raises:
        RecordingError: It cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(content)
        os.replace(part, path)
    except OSError as error:
        raise RecordingError("cannot be written", why=error.strerror or str(error), file=path) from error


def fingerprint(task: Task, controller: str) -> str:
    """Of all that decides the rows of a controller on a task: settings, robot, code."""
    contest = task.contest
    asked = {"seeds": contest.seeds, "window": contest.window, "start": contest.start}
    cosmetic: dict[str, Any] = {"cases": {}, "title": "", "variant": "", "plots": (), "contest": None}
    experiment = msgspec.structs.replace(task.experiment, controllers=(controller,), **cosmetic)
    facts = plain(task.training(task.controller(controller), task.experiment.seed).facts())  # with URDF and origin
    text = json.dumps([experiment.to_json(), asked, facts, code_digest()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def as_csv(rows: Sequence[Row]) -> str:
    """Rows as a table, one line per run, a column per number; empty where there is none."""
    tables = [flat(row) for row in rows]
    columns = list(dict.fromkeys(name for table in tables for name in table))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(tables)
    return text.getvalue()


def flat(row: Row) -> dict[str, Any]:
    """A row without its curve, one number per key."""
    table: dict[str, Any] = {}
    for name, value in as_json(row).items():
        spread(table, name, value)
    return table


def spread(table: dict[str, Any], name: str, value: Any) -> None:
    """Put a value into a flat table, what is inside it under `name.inner`."""
    if isinstance(value, dict):
        for inner, one in value.items():
            spread(table, f"{name}.{inner}", one)
    else:
        table[name] = "; ".join(value) if isinstance(value, list | tuple) else value


def as_json(row: Row) -> dict[str, Any]:
    """A row for JSON: without its curve, with the errors of base, heading and arm."""
    table: dict[str, Any] = {k: v for k, v in msgspec.to_builtins(row).items() if k != "curve"}
    for word in ("rms", "peak"):
        numbers = getattr(row, word)
        table[f"{word}_base"], table[f"{word}_arm"] = known(base_of(numbers)), known(arm_of(numbers))
        table[f"{word}_heading"] = numbers.get("phi")
    return table
