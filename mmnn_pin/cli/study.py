"""`mmnn study` and `mmnn tune`: many runs, on this machine or on a cluster, gone on with after a stop."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import StudyError
from .options import examples, makes_runs, shared
from .output import DONE, FAILED, STOPPED, answer, compile_if_cold, counter, interruptible, look, note, styled, warn

if TYPE_CHECKING:
    from ..lab.study.execution import Probe
    from ..lab.study.plan import StudyPlan
    from ..lab.study.pools import Pool
    from ..lab.study.store import TrialResult

STOPPED_TEXT = "stopped by Ctrl-C; the same command goes on with what is missing"


@click.command(
    short_help="Make thousands of runs of an experiment and judge its controllers by them.",
    epilog=examples(
        "mmnn study examples/robustness.toml",
        "mmnn study examples/robustness.toml             again, after Ctrl-C or a kill: goes on with what is missing",
        "mmnn study examples/robustness.toml --row 17    one run alone, with all its signals",
        "mmnn study examples/robustness.toml --set sampling.points=64 --out runs/short",
        "mmnn study examples/robustness.toml --cluster tcp://10.0.0.1:8786",
        "mmnn report runs/robustness --html robustness.html",
        "mmnn export runs/robustness --to csv",
    ),
)
@makes_runs
@click.option("--row", type=int, metavar="N", help="Run row N alone, record all its signals, compare its numbers.")
@click.option("--force", is_flag=True, help="Keep the rows whose settings have not changed, and drop the rest.")
@shared
def study(
    file: Path,
    workers: int | None,
    cluster: str | None,
    row: int | None,
    settings: tuple[str, ...],
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Make every run of STUDY.toml that is not stored yet, then print a summary.

    A run that diverges is a row like any other. Rows are stored as runs end: after Ctrl-C, a kill or a crash the same
    command continues with the missing runs. `mmnn docs how-to/studies` explains the file.
    """
    from ..lab.experiments.runner import window_notes
    from ..lab.show.study import render, to_dict
    from ..lab.study.execution import probe, rerun
    from ..lab.study.plan import plan_of
    from ..lab.study.results import load_results
    from ..lab.study.settings import load_study

    study = load_study(file, settings)
    folder = out or Path("runs") / study.name
    plan = plan_of(study)
    known = probe(plan)
    compile_if_cold()
    if row is not None:
        again = rerun(plan, row, folder, force)
        answer(as_json, again.to_dict, again.describe)
        return DONE if again.same in (True, None) else FAILED
    require_at_hand(plan, cluster)
    for remark in window_notes(plan.base):
        warn(remark)
    stopped = make(plan, known, folder, choose(known, workers, cluster), force)
    with before_the_first(stopped):
        results = load_results(folder)
    answer(
        as_json,
        lambda: to_dict(results) | {"stopped": stopped},
        lambda: f"{styled(render(results, **look()))}\n\nrows: {results.path}",
    )
    if stopped and not as_json:
        note(STOPPED_TEXT)
    return STOPPED if stopped else FAILED if results.failed else DONE


@contextmanager
def before_the_first(stopped: bool) -> Iterator[None]:
    """Ctrl-C before there is anything to tell is that, and no error of a database without rows.

    Raises:
        KeyboardInterrupt: It came, and there is none.
    """
    try:
        yield
    except StudyError:
        if not stopped:
            raise
        raise KeyboardInterrupt from None


def require_at_hand(plan: StudyPlan, cluster: str | None) -> None:
    """Refuse controllers from files on a cluster: its workers get settings, no code (`ConfigError`)."""
    from ..errors import ConfigError

    for name in plan.controllers if cluster is not None else ():
        if ".py:" in str(plan.base.laws.get(name, {}).get("law", "")):
            why = "workers elsewhere get settings, and no code"
            fix = "install it there as a package, and name it package.module:Class"
            raise ConfigError(f"the controller {name} is a file on this machine", why=why, fix=fix, key="--cluster")


def choose(known: Probe, workers: int | None, cluster: str | None) -> AbstractContextManager[Pool]:
    """Where the runs are made."""
    from ..errors import ConfigError
    from ..lab.study import pools
    from ..loop.batch import require_memory

    if cluster is not None:
        if workers is not None:
            fix = "say on the cluster how many workers there are"
            raise ConfigError("--cluster with --workers", fix=fix, key="--cluster")
        return pools.cluster(cluster)
    require_memory(known.bytes_per_run * pools.number_of(workers))
    return pools.local(workers)


def make(plan: StudyPlan, known: Probe, folder: Path, where: AbstractContextManager[Pool], force: bool) -> bool:
    """Make the missing runs and count them on standard error; whether Ctrl-C ended them."""
    from ..lab.study.execution import fill, missing_trials
    from ..lab.study.store import NAME, writing

    with writing(folder / NAME) as store:
        missing = missing_trials(store, plan, known, force)
        if not missing:
            return False
        before, begun, ended = len(plan) - len(missing), time.monotonic(), []
        try:
            with where as pool, counter("runs", len(plan), before) as show, interruptible(show) as advance:
                note(f"{len(plan)} runs{f', {before} of them done' * bool(before)}, on {pool.place}")

                def progress(result: TrialResult) -> None:
                    ended.append(result.status)
                    lost = len(ended) - ended.count("completed")
                    rate = len(ended) / max(time.monotonic() - begun, 1e-3)
                    advance(before + len(ended), f"{rate:.1f}/s" + f"  {lost} not completed" * bool(lost))

                fill(store, plan, missing, pool, progress)
        except KeyboardInterrupt:
            return True
    return False


@click.command(
    short_help="Look for gains that hold over a study's uncertainty.",
    epilog=examples(
        "mmnn tune examples/tuning.toml",
        "mmnn tune examples/tuning.toml                        again: goes on with the trials that are missing",
        "mmnn tune examples/tuning.toml --set tune.trials=200  more of them",
        "mmnn tune examples/tuning.toml --cluster tcp://10.0.0.1:8786",
    ),
)
@makes_runs
@click.option("--force", is_flag=True, help="Drop trials of other settings and start anew.")
@shared
def tune(
    file: Path,
    workers: int | None,
    cluster: str | None,
    settings: tuple[str, ...],
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Try gains within the bounds of STUDY.toml's [tune] and print the best.

    Each set of gains is run on all draws of the study, and judged by a quantile of the objective over them. Gains that
    make the sampled PD loop unstable, and learning rates beyond the certificate's condition, are refused without a run.
    Trials are stored as they end: the same command continues with the missing ones. Needs
    `pip install 'mmnn_pin[tune]'`.
    """
    from ..lab.study.execution import probe
    from ..lab.study.plan import plan_of
    from ..lab.study.settings import load_study
    from ..lab.study.tuning import imported, result, search, tuned_part, value_words

    imported()
    study = load_study(file, settings)
    trials = tuned_part(study)[0].trials
    known = probe(plan_of(study))
    compile_if_cold()
    folder, stopped = out or Path("runs") / study.name, False
    with choose(known, workers, cluster) as pool:
        try:
            with counter("trials", trials) as show, interruptible(show) as advance:

                def progress(done: int, best: float) -> None:
                    advance(done, f"best {value_words(best)}")

                search(study, folder, pool, force=force, progress=progress)
        except KeyboardInterrupt:
            stopped = True
        with before_the_first(stopped):
            best = result(study, folder, None if stopped else pool)
    answer(as_json, lambda: best.to_dict() | {"stopped": stopped}, best.describe)
    if stopped and not as_json:
        note(STOPPED_TEXT)
    return STOPPED if stopped else DONE
