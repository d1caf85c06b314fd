"""A study is carried out: judged before anything is written, its missing runs made and stored, a row run again."""

from __future__ import annotations

import itertools
import math
import queue
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from ... import __version__
from ...errors import InputError, MmnnError, StudyError
from ...loop.batch import needed_bytes
from ...loop.compiled import CompiledLoop
from ...recording.metrics import Reducer, metrics
from ...recording.versions import versions
from ..experiments.controllers import EFFECTIVE
from .plan import Plan, short
from .pools import Pool, root_of
from .results import DEFAULT, require_patterns, units_of, value_of
from .settings import StudySettings, placing
from .store import NAME, Store, Stored, reading
from .worker import JobResult, Row, loop_of, robots_of, run

AGAIN = ("failed", "interrupted")  # statuses of rows that the next session runs again
AT_A_TIME, MOST_AT_A_TIME = 0.5, 64  # how long the runs of a call are to take [s], and how many they are at most
LOST = "the same command goes on with what is missing"
COSMETIC = ("title", "metrics", "success", "tune")  # settings that change no row


# -- before the first run ----------------------------------------------------------------------------------------------


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
            loop = loop_of(replace(row, experiment=experiment))
            loops.append((loop, loop.engine_at(), row))
        except InputError as error:
            raise plan.blamed(error) from None
    loop, engine, row = loops[0]
    facts = loop.facts() | {"loop": engine.name}
    names = list(Reducer.of(loop.layout, facts, row.experiment.windows).result())
    settings = plan.study.settings
    wanted = {"metrics": settings.metrics or (), "success.at_most": tuple(settings.success.at_most)}
    wanted |= {"tune.objective": (settings.tune.objective,)} if settings.tune is not None else {}
    with placing(plan.study.path):
        for key, patterns in wanted.items():
            require_patterns(patterns, names, key)
    units = units_of(names, robots_of(row, None)[0])
    size = max(needed_bytes([loop], False, 1) for loop, _, _ in loops)
    return Probe(all(isinstance(engine, CompiledLoop) for _, engine, _ in loops), units, size)


def shown(settings: StudySettings, names: Sequence[str]) -> tuple[str, ...]:
    """Metrics that tables and pictures show."""
    if settings.metrics is not None:
        return settings.metrics
    return tuple(pattern for pattern in DEFAULT if value_of(dict.fromkeys(names, 0.0), pattern) == 0.0)


def judged(path: Path) -> str:
    """Digest of the plan whose points this version judged before it wrote a database; empty where there is none.

    Raises:
        StudyError: As in `reading`.
    """
    if not path.is_file() or not path.stat().st_size:
        return ""
    with reading(path) as store:
        meta = store.meta()
    return str(meta.get("plan", "")) if meta.get("mmnn_pin") == __version__ else ""


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
    before, rows = store.meta(), store.fingerprints()
    kept = [print_ for print_ in fingerprints if print_ in rows]
    if rows and (before.get("plan"), before.get("mmnn_pin")) != (plan.digest, __version__):
        if not force:
            raise changed_settings(store.path, before, plan, len(rows), len(kept))
        same_code = before.get("mmnn_pin") == __version__
        store.renumber({p: i for i, p in enumerate(fingerprints)} if same_code else {})
        rows = store.fingerprints()
    store.set_meta(facts(plan, found))
    return [i for i, p in enumerate(fingerprints) if p not in rows or rows[p][1] in AGAIN]


def facts(plan: Plan, found: Probe) -> dict[str, Any]:
    """What the database holds of its study."""
    study = plan.study
    return {
        "mmnn_pin": __version__,
        "versions": versions(),
        "plan": plan.digest,
        "rows": len(plan),
        "name": study.name,
        "file": str(study.path),
        "settings": msgspec.to_builtins(study.settings),
        "experiment": plan.table,
        "controllers": plan.controllers,
        "metrics": shown(study.settings, list(found.units)),
        "units": found.units,
        "robots": [bundle.digest for bundle in plan.bundles.values()],
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
        return [] if msgspec.json.encode(one) == msgspec.json.encode(other) else [prefix.rstrip(".")]
    keys = dict.fromkeys([*one, *other])
    return [path for key in keys for path in differences(one.get(key), other.get(key), f"{prefix}{key}.")]


# -- the missing runs --------------------------------------------------------------------------------------------------


def fill(
    store: Store, plan: Plan, missing: list[int], pool: Pool, progress: Callable[[JobResult], None] = lambda done: None
) -> None:
    """Run rows and store them.

    Args:
        store: Takes them.
        plan: All rows.
        missing: Numbers of those to run.
        pool: Makes the runs.
        progress: Called after each.

    Raises:
        MmnnError: As in `execute`.
    """
    for group in execute(pool, plan, missing):
        ended = [(row, done) for row, done in group if done.status != "interrupted"]
        store.add_all(
            (row.fingerprint, row.point, row.controller, row.seed, row.parameters, done) for row, done in ended
        )
        for _, done in ended:
            progress(done)


def execute(
    pool: Pool, plan: Plan, numbers: Sequence[int], handed: dict[str, Any] | None = None
) -> Iterator[list[tuple[Row, JobResult]]]:
    """Make runs, some in a call, given back when the call has ended, in any order.

    A call has as many as take `AT_A_TIME`: a kill loses little, and short ones cost little to hand out and to store.

    Args:
        pool: Makes them.
        plan: All runs.
        numbers: Of those to make.
        handed: Robots' files that the pool has already, by digest; it is added to.

    Raises:
        MmnnError: The pool is lost; what was given back is done.
        StudyError: A worker cannot make runs of this study.
    """
    finished: queue.SimpleQueue[Future[list[JobResult]]] = queue.SimpleQueue()
    pending: dict[Future[list[JobResult]], list[Row]] = {}
    again: list[list[Row]] = []
    size, alone, left = 1, pool.first_alone, len(numbers)
    waiting = groups(plan, map(plan.row, numbers), lambda: size)
    files: dict[str, Any] = {} if handed is None else handed
    try:
        while True:
            room = (1 if alone else pool.window()) - len(pending)
            for group in itertools.islice(itertools.chain(taken(again), waiting), max(room, 0)):
                bundle = plan.bundle(group[0].experiment)
                if bundle.digest not in files:  # the pool gets the files of a robot once
                    files[bundle.digest] = pool.share(bundle)
                future = pool.executor.submit(run, group, files[bundle.digest], pool.stop)
                pending[future] = group
                future.add_done_callback(finished.put)
            if not pending:
                return
            try:
                future = finished.get(timeout=1.0)
            except queue.Empty:
                pool.check()
                continue
            group = pending.pop(future)
            if (done := results_of(future, group, pool)) is None:
                again += [[row] for row in group]
                continue
            yield list(zip(group, done, strict=True))
            left -= len(group)
            size, alone = min(together(done), max(left // pool.window(), 1)), False
    finally:
        for future in pending:
            future.cancel()


def groups(plan: Plan, rows: Iterable[Row], size: Callable[[], int]) -> Iterator[list[Row]]:
    """Runs of one robot's files, so many at a time."""
    group: list[Row] = []
    for row in rows:
        if group and (len(group) >= size() or plan.bundle(row.experiment) is not plan.bundle(group[0].experiment)):
            yield group
            group = []
        group.append(row)
    if group:
        yield group


def taken(groups: list[list[Row]]) -> Iterator[list[Row]]:
    """The groups, taken out of their list."""
    while groups:
        yield groups.pop()


def together(done: Sequence[JobResult]) -> int:
    """How many runs a call is to have, after those of one."""
    each = sum(result.seconds for result in done) / len(done)
    return int(min(max(AT_A_TIME / max(each, 1e-6), 1), MOST_AT_A_TIME))


def results_of(future: Future[list[JobResult]], rows: Sequence[Row], pool: Pool) -> list[JobResult] | None:
    """Results of runs; None for some that kill their workers again and again, of which one alone has failed.

    Raises:
        MmnnError, StudyError: As in `execute`.
    """
    try:
        return future.result()
    except StudyError:
        raise
    except BrokenProcessPool as error:
        raise MmnnError(f"a worker process died, killed or out of memory; {LOST}") from error
    except CancelledError as error:
        pool.check()
        raise MmnnError(f"{pool.place} no longer knows its runs: was it stopped? {LOST}") from error
    except ModuleNotFoundError as error:
        fix = "install the same version of mmnn_pin there as here"
        raise StudyError(f"a worker has no {root_of(error)}", fix=fix) from error
    except Exception as error:
        if type(error).__name__ == "KilledWorker":
            message = "the workers that ran it died, one after the other"
            return [JobResult(row.id, "failed", message=message) for row in rows] if len(rows) == 1 else None
        raise MmnnError(f"a worker failed: {type(error).__name__}: {error}; {LOST}") from error


# -- a row again -------------------------------------------------------------------------------------------------------


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
        if self.stored is None:
            compared = "not in the database with these settings, so nothing to compare"
        elif self.different:
            names = ", ".join(self.different[:6])
            compared = f"OTHER numbers than the stored ones (made on {self.stored.host}): {names}"
        else:
            compared = f"the same numbers as stored, bit for bit: all {len(self.metrics)}"
        who = f"row {self.row.id}: {self.row.controller}, seed {self.row.seed}"
        end = f"{self.status}: {self.message}" if self.message else self.status
        return f"{who}\n  {values}\n  {end}\n  {compared}\nwrote {self.file}"


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
    loop = loop_of(row)
    about = {"experiment": f"{plan.study.name} row {number}", "config": row.experiment.to_json()}
    recording = loop.run(file, force=force, meta=about | {"study_parameters": row.parameters})
    stored = None
    if (folder / NAME).exists():
        with reading(folder / NAME) as store:
            stored = store.row(number)
    stored = stored if stored is not None and stored.fingerprint == row.fingerprint else None
    outcome = recording.outcome
    return Rerun(row, file, outcome.status, outcome.message, metrics(recording, row.experiment.windows), stored)


def same(one: float | None, other: float | None) -> bool:
    """Whether two numbers are the same, nan too."""
    return one == other or (one is not None and other is not None and math.isnan(one) and math.isnan(other))
