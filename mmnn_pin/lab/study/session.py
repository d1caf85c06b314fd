"""What is done with a study's plan: judged before anything is written, missing rows found, a row run again."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from ... import __version__
from ...errors import InputError, StudyError, UnknownName
from ...loop.batch import needed_bytes, require_memory
from ...loop.compiled import CompiledLoop
from ...recording.metrics import Reducer, metrics
from ...recording.recorder import versions
from ..experiments.controllers import EFFECTIVE
from .execution import AGAIN
from .plan import Plan, Row, short
from .results import DEFAULT, require_patterns, units_of, value_of
from .settings import StudySettings
from .store import NAME, Store, Stored, reading
from .worker import loop_of, robots_of

COSMETIC = ("title", "metrics", "success", "tune")  # settings that change no row


@dataclass(frozen=True)
class Probe:
    """What is known of a study before it runs.

    Attributes:
        compiled: Whether the compiled engine runs all controllers.
        units: Metric to its unit.
        bytes_per_run: Memory that a run takes while it runs.
    """

    compiled: bool
    units: dict[str, str]
    bytes_per_run: int


def probe(plan: Plan) -> Probe:
    """Make the loop of the first run of every controller, without running it, and judge what is asked of its metrics.

    Raises:
        InputError: One cannot be made, or a metric does not exist.
    """
    loops = []
    for number in range(len(plan.controllers)):
        row = plan.row(number)
        name = EFFECTIVE.get(row.controller, row.controller)
        experiment = msgspec.structs.replace(row.experiment, controllers=(name,))
        try:
            loop = loop_of(replace(row.job, experiment=experiment))
            loops.append((loop, loop.engine_at(), row))
        except InputError as error:
            raise plan.blamed(error) from None
    loop, engine, row = loops[0]
    facts = loop.facts() | {"loop": engine.name}
    names = list(Reducer.of(loop.layout, facts, row.experiment.windows).result())
    require_asked(plan.study.settings, names, plan)
    units = units_of(names, robots_of(row.job, None)[0])
    size = max(needed_bytes([loop], False, 1) for loop, _, _ in loops)
    return Probe(all(isinstance(engine, CompiledLoop) for _, engine, _ in loops), units, size)


def require_asked(settings: StudySettings, names: Sequence[str], plan: Plan) -> None:
    """Refuse metrics that no run has; errors as in `require_patterns`, with the study's file and line."""
    asked = {"metrics": settings.metrics or (), "success.at_most": tuple(settings.success.at_most)}
    if settings.tune is not None:
        asked["tune.objective"] = (settings.tune.objective,)
    for key, patterns in asked.items():
        try:
            require_patterns(patterns, names, key)
        except UnknownName as error:
            raise plan.study.placed(error) from None


def require_room(found: Probe, workers: int) -> None:
    """Refuse runs that do not fit into memory together; errors as in `batch.require_memory`."""
    require_memory(found.bytes_per_run * workers)


def shown(settings: StudySettings, names: Sequence[str]) -> tuple[str, ...]:
    """Metrics that tables and pictures show."""
    if settings.metrics is not None:
        return settings.metrics
    return tuple(pattern for pattern in DEFAULT if value_of(dict.fromkeys(names, 0.0), pattern) == 0.0)


def missing_rows(store: Store, plan: Plan, found: Probe, force: bool) -> list[int]:
    """Rows that are still to be run, after the database has agreed to the study's settings.

    Args:
        store: The database.
        plan: The study's runs.
        found: What is known of them.
        force: Give up rows that the settings no longer have; the others stay.

    Raises:
        StudyError: It holds rows of other settings, and `force` is off.
    """
    fingerprints = list(plan.fingerprints())
    digest = hashlib.sha256(" ".join(fingerprints).encode()).hexdigest()
    before, rows = store.meta(), store.fingerprints()
    kept = [print_ for print_ in fingerprints if print_ in rows]
    if rows and (before.get("plan"), before.get("mmnn_pin")) != (digest, __version__):
        if not force:
            raise changed_settings(store.path, before, plan, len(rows), len(kept))
        same_code = before.get("mmnn_pin") == __version__
        store.renumber({p: i for i, p in enumerate(fingerprints)} if same_code else {})
        rows = store.fingerprints()
    store.set_meta(facts(plan, found, digest))
    return [i for i, p in enumerate(fingerprints) if p not in rows or rows[p][1] in AGAIN]


def facts(plan: Plan, found: Probe, digest: str) -> dict[str, Any]:
    """What the database tells of its study."""
    study = plan.study
    return {
        "mmnn_pin": __version__,
        "versions": versions(),
        "plan": digest,
        "rows": len(plan),
        "name": study.name,
        "file": str(study.path),
        "settings": msgspec.to_builtins(study.settings),
        "experiment": plan.table,
        "controllers": plan.controllers,
        "metrics": shown(study.settings, list(found.units)),
        "units": found.units,
        "robots": [bundle.digest for bundle in plan.bundles],
    }


def changed_settings(path: Path, before: dict[str, Any], plan: Plan, rows: int, kept: int) -> StudyError:
    """The complaint about a database of other settings."""
    if before.get("mmnn_pin") != __version__:
        why = f"mmnn_pin {before.get('mmnn_pin')} wrote its {rows} rows, this is {__version__}"
        fix = "--force drops them and starts anew; or choose another folder with --out"
        return StudyError("the rows are of another version", why=why, fix=fix, file=path)
    settings = {k: v for k, v in msgspec.to_builtins(plan.study.settings).items() if k not in COSMETIC}
    old = {k: v for k, v in before.get("settings", {}).items() if k not in COSMETIC}
    different = [*differences(old, settings), *differences(before.get("experiment", {}), plan.table, "experiment.")]
    what = ", ".join(different[:4]) + (f" and {len(different) - 4} more" if len(different) > 4 else "")
    why = f"changed: {what or 'a file of the robot'}; {kept} of {rows} stored rows are also in the new study"
    fix = "--force keeps these and drops the others; or choose another folder with --out"
    return StudyError("the study has other settings than its database", why=why, fix=fix, file=path)


def differences(one: Any, other: Any, prefix: str = "") -> list[str]:
    """Key paths at which two tables differ."""
    if not (isinstance(one, dict) and isinstance(other, dict)):
        return [] if plain(one) == plain(other) else [prefix.rstrip(".")]
    keys = dict.fromkeys([*one, *other])
    return [path for key in keys for path in differences(one.get(key), other.get(key), f"{prefix}{key}.")]


def plain(value: Any) -> Any:
    """A value as JSON has it."""
    return msgspec.json.decode(msgspec.json.encode(value))


@dataclass(frozen=True)
class Rerun:
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
        about |= {"parameters": self.row.parameters, "file": str(self.file), "outcome": self.status}
        return about | {"message": self.message, "metrics": numbers, "same": self.same, "different": self.different}

    def describe(self) -> str:
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


def rerun(plan: Plan, number: int, folder: Path, force: bool = False) -> Rerun:
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
    loop = loop_of(row.job)
    about = {"experiment": f"{plan.study.name} row {number}", "config": row.experiment.to_json()}
    recording = loop.run(file, force=force, meta=about | {"study_parameters": row.parameters})
    found = None
    if (folder / NAME).exists():
        with reading(folder / NAME) as store:
            found = store.row(number)
    stored = found if found is not None and found.fingerprint == row.fingerprint else None
    outcome = recording.outcome
    return Rerun(row, file, outcome.status, outcome.message, metrics(recording, row.experiment.windows), stored)


def same(one: float | None, other: float | None) -> bool:
    """Whether two numbers are the same, nan too."""
    return one == other or (one is not None and other is not None and math.isnan(one) and math.isnan(other))
