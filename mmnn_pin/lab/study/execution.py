"""A study is carried out: judged before anything is written, its missing runs made and stored, one made again."""

from __future__ import annotations

import itertools
import json
import math
import queue
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from ... import __version__
from ...errors import InputError, MmnnError, StudyError, few
from ...loop.batch import needed_bytes
from ...recording.metrics import Reducer, metrics
from ...recording.versions import versions
from ..experiments.controllers import EFFECTIVE
from .plan import StudyPlan, short
from .pools import Pool
from .results import DEFAULT, require_patterns, units_of, value_of
from .settings import StudySettings, placing
from .store import NAME, Store, TrialResult, encoded, reading
from .worker import Trial, loop_of, robots_of

AGAIN = ("failed", "interrupted")  # statuses of runs that the next session makes again
LOOK = 1.0  # between looks whether the pool is still there [s]
LOST = "the same command goes on with what is missing"
COSMETIC = ("title", "metrics", "success", "tune")  # settings that change no run


# -- before the first run ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Probe:
    """Facts of a study that are known before it runs."""

    units: dict[str, str]  # metric to its unit
    bytes_per_run: int  # memory that a run takes while it runs


def probe(plan: StudyPlan) -> Probe:
    """Make the loop of the first run of every controller, without running it, and judge what is asked of its metrics.

    Raises:
        InputError: One cannot be made, or a metric does not exist.
    """
    loops = []
    for number in range(len(plan.controllers)):
        trial = plan.trial(number)
        name = EFFECTIVE.get(trial.controller, trial.controller)
        experiment = msgspec.structs.replace(trial.experiment, controllers=(name,))
        try:
            loops.append(loop_of(replace(trial, experiment=experiment)))
            engine = loops[-1].engine_at()
        except InputError as error:
            raise plan.blamed(error) from None
    facts = loops[-1].facts() | {"loop": engine.name}
    names = list(Reducer.of(loops[-1].layout, facts, trial.experiment.windows).result())
    settings = plan.study.settings
    wanted = {"metrics": settings.metrics or (), "success.at_most": tuple(settings.success.at_most)}
    wanted |= {"tune.objective": (settings.tune.objective,)} if settings.tune is not None else {}
    with placing(plan.study.path):
        for key, patterns in wanted.items():
            require_patterns(patterns, names, key)
    return Probe(units_of(names, robots_of(trial, None)[0]), max(needed_bytes([loop], False, 1) for loop in loops))


def shown(settings: StudySettings, names: Sequence[str]) -> tuple[str, ...]:
    """Metrics that tables and pictures show."""
    if settings.metrics is not None:
        return settings.metrics
    return tuple(pattern for pattern in DEFAULT if value_of(dict.fromkeys(names, 0.0), pattern) == 0.0)


def missing_trials(store: Store, plan: StudyPlan, found: Probe, force: bool) -> list[int]:
    """Numbers of the runs that are still to be made, once the results agree with the study's settings.

    Args:
        store: The results.
        plan: The study's runs.
        found: What is known of them.
        force: Give up results that the settings no longer have; the others stay.

    Raises:
        StudyError: There are results of other settings, and `force` is off.
    """
    numbers = {fingerprint: i for i, fingerprint in enumerate(plan.fingerprints)}
    same_code, now = store.facts.get("mmnn_pin") == __version__, facts(plan, found)
    if store.results and not (same_code and store.facts.get("plan") == plan.digest):
        kept = {numbers[r.fingerprint]: r for r in store.results if r.fingerprint in numbers}
        if not force:
            raise changed_settings(store, plan, len(kept))
        again = sorted(kept.items()) if same_code else []
        store.rewrite(now, [msgspec.structs.replace(result, id=i) for i, result in again])
    elif store.facts != json.loads(encoded(now)):
        store.add(now)
    done = {result.fingerprint for result in store.results if result.status not in AGAIN}
    return [i for i, fingerprint in enumerate(plan.fingerprints) if fingerprint not in done]


def facts(plan: StudyPlan, found: Probe) -> dict[str, Any]:
    """The facts that stand before the results."""
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


def changed_settings(store: Store, plan: StudyPlan, kept: int) -> StudyError:
    """The complaint about results of other settings."""
    before, rows = store.facts, len(store.results)
    if before.get("mmnn_pin") != __version__:
        why = f"mmnn_pin {before.get('mmnn_pin')} wrote its {rows} rows, this is {__version__}"
        fix = "--force drops them and starts anew; or choose another folder with --out"
        return StudyError("the rows are of another version", why=why, fix=fix, file=store.path)
    settings = {k: v for k, v in msgspec.to_builtins(plan.study.settings).items() if k not in COSMETIC}
    old = {k: v for k, v in before["settings"].items() if k not in COSMETIC}
    different = [*differences(old, settings), *differences(before["experiment"], plan.table, "experiment.")]
    changed = few(different, 4) or "a file of the robot"
    why = f"changed: {changed}; {kept} of {rows} stored rows are also in the new study"
    fix = "--force keeps these and drops the others; or choose another folder with --out"
    return StudyError("the study has other settings than its results", why=why, fix=fix, file=store.path)


def differences(one: Any, other: Any, prefix: str = "") -> list[str]:
    """Key paths at which two tables differ."""
    if not (isinstance(one, dict) and isinstance(other, dict)):
        return [] if msgspec.json.encode(one) == msgspec.json.encode(other) else [prefix.rstrip(".")]
    keys = dict.fromkeys([*one, *other])
    return [path for key in keys for path in differences(one.get(key), other.get(key), f"{prefix}{key}.")]


# -- the missing runs --------------------------------------------------------------------------------------------------


def fill(
    store: Store,
    plan: StudyPlan,
    missing: Sequence[int],
    pool: Pool,
    progress: Callable[[TrialResult], None] = lambda result: None,
) -> None:
    """Make runs and store their results.

    Args:
        store: Takes them.
        plan: All runs.
        missing: Numbers of those to make.
        pool: Makes them.
        progress: Called after each.

    Raises:
        MmnnError: As in `execute`.
    """
    for result in execute(pool, plan, missing):
        if result.status != "interrupted":
            store.add(result)
            progress(result)


def execute(pool: Pool, plan: StudyPlan, numbers: Sequence[int]) -> Iterator[TrialResult]:
    """Make runs, given back as they end, in any order.

    Args:
        pool: Makes them.
        plan: All runs.
        numbers: Of those to make.

    Raises:
        MmnnError: The pool is lost; what was given back is done.
        StudyError: A worker cannot make runs of this study.
    """
    finished: queue.SimpleQueue[Future[TrialResult]] = queue.SimpleQueue()
    pending: dict[Future[TrialResult], Trial] = {}
    waiting = map(plan.trial, numbers)
    try:
        while True:
            room = (pool.window() if pool.is_warm else 1) - len(pending)
            for trial in itertools.islice(waiting, max(room, 0)):
                future = pool.submit(trial, plan.bundle(trial.experiment))
                pending[future] = trial
                future.add_done_callback(finished.put)
            if not pending:
                return
            try:
                future = finished.get(timeout=LOOK)
            except queue.Empty:
                pool.check()
                continue
            yield result_of(future, pending.pop(future), pool)
            pool.is_warm = True
    finally:
        for future in pending:
            future.cancel()


def result_of(future: Future[TrialResult], trial: Trial, pool: Pool) -> TrialResult:
    """Result of a run; a failure where it killed its workers again and again; errors as of `execute`."""
    try:
        return future.result()
    except StudyError:
        raise
    except BrokenProcessPool as error:
        raise MmnnError(f"a worker process died, killed or out of memory; {LOST}") from error
    except CancelledError as error:
        pool.check()
        raise MmnnError(f"{pool.place} no longer knows its runs: was it stopped? {LOST}") from error
    except Exception as error:
        if type(error).__name__ == "KilledWorker":
            return trial.result("failed", message="the workers that ran it died, one after the other")
        raise MmnnError(f"a worker failed: {type(error).__name__}: {error}; {LOST}") from error


# -- a run again -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rerun:
    """A run that was made again."""

    result: TrialResult  # its result now
    file: Path  # its recording
    stored: TrialResult | None  # the stored result; None if there is none, or one with other settings

    @property
    def different(self) -> list[str]:
        """Metrics that are not the stored ones bit for bit; "outcome" where it ended otherwise."""
        now, then = self.result, self.stored or self.result
        names = dict.fromkeys([*then.metrics, *now.metrics])
        other = [n for n in names if not same(then.metrics.get(n), now.metrics.get(n))]
        return ["outcome"] * (now.status != then.status) + other

    @property
    def same(self) -> bool | None:
        """Whether all its numbers are the stored ones; None where none are stored."""
        return None if self.stored is None else not self.different

    def to_dict(self) -> dict[str, Any]:
        """The comparison for JSON."""
        now = self.result
        numbers = {name: value if math.isfinite(value) else None for name, value in now.metrics.items()}
        about = {"row": now.id, "controller": now.controller, "seed": now.seed, "parameters": now.parameters}
        about |= {"file": str(self.file), "outcome": now.status, "message": now.message, "metrics": numbers}
        return about | {"same": self.same, "different": self.different}

    def describe(self) -> str:
        """The comparison for people."""
        now = self.result
        values = ", ".join(f"{name} = {short(value)}" for name, value in now.parameters.items())
        compared = f"the same numbers as stored, bit for bit: all {len(now.metrics)}"
        if self.stored is None:
            compared = "not stored with these settings, so nothing to compare"
        elif self.different:
            names = ", ".join(self.different[:6])
            compared = f"OTHER numbers than the stored ones (made on {self.stored.host}): {names}"
        end = f"{now.status}: {now.message}" if now.message else now.status
        lines = (f"row {now.id}: {now.controller}, seed {now.seed}", values, end, compared)
        return "\n  ".join(lines) + f"\nwrote {self.file}"


def rerun(plan: StudyPlan, number: int, folder: Path, force: bool = False) -> Rerun:
    """Make a run alone and record all its signals in `folder/rows/NUMBER.h5`.

    Args:
        plan: The study's runs.
        number: The run's.
        folder: Of the results.
        force: Replace the recording.

    Raises:
        ConfigError: No such run.
        RecordingError: The recording exists.
        InputError: The run cannot be made.
    """
    trial = plan.trial(number)
    file = folder / "rows" / f"{number}.h5"
    about = {"experiment": f"{plan.study.name} row {number}", "config": trial.experiment.to_json()}
    recording = loop_of(trial).run(file, force=force, meta=about | {"study_parameters": trial.parameters})
    results = reading(folder / NAME).results if (folder / NAME).exists() else []
    stored = next((r for r in results if (r.id, r.fingerprint) == (number, trial.fingerprint)), None)
    return Rerun(trial.ended(recording.outcome, metrics(recording, trial.experiment.windows)), file, stored)


def same(one: float | None, other: float | None) -> bool:
    """Whether two numbers are the same, nan too."""
    return one == other or (one is not None and other is not None and math.isnan(one) and math.isnan(other))
