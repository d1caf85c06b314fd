"""`mmnn study` and `mmnn tune`: many runs, on this machine or on a cluster, gone on with after a stop."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .options import examples, makes_runs, shared
from .output import DONE, FAILED, STOPPED, compile_if_cold, say, say_json, warn
from .run import remembered_interrupt

if TYPE_CHECKING:
    from rich.progress import Progress, ProgressColumn

    from ..lab.study.execution import Pool
    from ..lab.study.plan import Plan
    from ..lab.study.session import Probe
    from ..lab.study.tuning import Tuned
    from ..lab.study.worker import JobResult

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
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the database.  [default: runs/STUDY]")
@click.option(
    "--force", is_flag=True, help="Settings may have changed: keep the rows that are the same, drop the rest."
)
@shared
def study(
    file: Path,
    workers: int | None,
    processes: bool,
    cluster: str | None,
    row: int | None,
    settings: tuple[str, ...],
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Make every run of STUDY.toml that is not in its database yet, then print what came out.

    A run that diverges is a row like any other. Rows are stored as they finish: after Ctrl-C, a kill or a crash the
    same command goes on with what is missing. The file is explained in docs/studies.md.
    """
    from ..lab.experiments.runner import window_notes
    from ..lab.study.plan import plan_of
    from ..lab.study.session import probe
    from ..lab.study.settings import load_study

    plan = plan_of(load_study(file, settings))
    folder = out or Path("runs") / plan.study.name
    found = probe(plan)
    compile_if_cold()
    if row is not None:
        return run_again(plan, row, folder, force, as_json)
    require_at_hand(plan, cluster)
    for note in window_notes(plan.base):
        warn(note)
    pool = choose(found, workers, processes, cluster)
    stopped = make(plan, found, folder, pool, force)
    return say_results(folder, stopped, as_json)


def require_at_hand(plan: Plan, cluster: str | None) -> None:
    """Refuse controllers from files on a cluster: its workers get settings, no code.

    Raises:
        ConfigError: With the name of the first.
    """
    from ..errors import ConfigError

    for name in plan.controllers if cluster is not None else ():
        if ".py:" in str(plan.base.laws.get(name, {}).get("law", "")):
            why = "workers elsewhere get settings, and no code"
            fix = "install it there as a package, and name it package.module:Class"
            raise ConfigError(f"the controller {name} is a file on this machine", why=why, fix=fix, key="--cluster")


def choose(found: Probe, workers: int | None, processes: bool, cluster: str | None) -> AbstractContextManager[Pool]:
    """Where the runs are made."""
    from ..errors import ConfigError
    from ..lab.study import execution
    from ..lab.study.cluster import cluster as dask
    from ..lab.study.session import require_room

    if cluster is not None:
        if workers is not None or processes:
            fix = "say on the cluster how many workers there are"
            raise ConfigError("--cluster with --workers or --processes", fix=fix, key="--cluster")
        return dask(cluster)
    require_room(found, execution.number_of(workers))
    return execution.processes(workers) if processes or not found.compiled else execution.threads(workers)


def make(plan: Plan, found: Probe, folder: Path, where: AbstractContextManager[Pool], force: bool) -> bool:
    """Make the missing runs; whether Ctrl-C ended them."""
    from ..lab.study.execution import fill
    from ..lab.study.session import missing_rows
    from ..lab.study.store import NAME, writing

    with writing(folder / NAME) as store:
        missing = missing_rows(store, plan, found, force)
        if not missing:
            return False
        try:
            with where as pool, remembered_interrupt() as stop_if_pressed, bar(plan, missing, pool) as advance:

                def progress(done: JobResult) -> None:
                    stop_if_pressed()
                    advance(done)

                fill(store, plan, missing, pool, progress)
        except KeyboardInterrupt:
            return True
    return False


@contextmanager
def bar(plan: Plan, missing: list[int], pool: Pool) -> Iterator[Callable[[JobResult], None]]:
    """Runs done of all, their rate and the time left, on standard error: a bar on a terminal, else a first line."""
    done, total = len(plan) - len(missing), len(plan)
    begun = f", {done} of them done" if done else ""
    crew = f" ({pool.crew})" if pool.crew else ""
    click.echo(f"{total} runs{begun}, on {pool.place}{crew}", err=True)
    if not sys.stderr.isatty():
        yield lambda finished: None
        return
    from rich.progress import TimeRemainingColumn

    with counter("runs", "{task.fields[rate]}", TimeRemainingColumn(), "{task.fields[lost]}") as shown:
        task = shown.add_task("", total=total, completed=done, rate="", lost="")
        lost = 0

        def advance(finished: JobResult) -> None:
            nonlocal lost
            lost += finished.status != "completed"
            speed = shown.tasks[0].speed
            texts = {"rate": f"{speed:.1f}/s" if speed else "", "lost": f"{lost} not completed" if lost else ""}
            shown.update(task, advance=1, **texts)  # type: ignore[arg-type]

        yield advance


def counter(what: str, *more: str | ProgressColumn) -> Progress:
    """A bar on standard error that counts something; `more` stands behind it, texts as rich's templates."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = (TextColumn(each) if isinstance(each, str) else each for each in more)
    return Progress(
        TextColumn(what), BarColumn(), MofNCompleteColumn(), *columns, console=Console(stderr=True), transient=True
    )


def run_again(plan: Plan, number: int, folder: Path, force: bool, as_json: bool) -> int:
    """Run one row alone with all its signals and compare its numbers with those stored."""
    from ..lab.study.session import rerun

    result = rerun(plan, number, folder, force)
    if as_json:
        say_json(result.to_dict())
    else:
        say(result.describe())
    return DONE if result.same in (True, None) else FAILED


def say_results(folder: Path, stopped: bool, as_json: bool) -> int:
    """Print what the database holds, and give the exit code."""
    from ..lab.show.study import render, to_dict
    from ..lab.study.results import load_results

    results = load_results(folder)
    if as_json:
        say_json(to_dict(results) | {"stopped": stopped})
    else:
        say(render(results, colour=sys.stdout.isatty()))
        say(f"\nrows: {results.path}")
        if stopped:
            click.echo(STOPPED_TEXT, err=True)
    return STOPPED if stopped else FAILED if results.failed else DONE


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
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the trials.  [default: runs/STUDY]")
@click.option("--force", is_flag=True, help="Drop trials of other settings and start anew.")
@shared
def tune(
    file: Path,
    workers: int | None,
    processes: bool,
    cluster: str | None,
    settings: tuple[str, ...],
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Try gains within the bounds of STUDY.toml's [tune] and print the best.

    Each set of gains is run on all draws of the study; a quantile of the objective over them counts, not one run. Gains
    that make the sampled PD loop unstable, and learning rates beyond the certificate's condition, are refused without
    the study's runs. Trials are stored as they finish: the same command goes on with what is missing. Needs
    `pip install 'mmnn_pin[tune]'`.
    """
    from ..lab.study.plan import plan_of
    from ..lab.study.session import probe
    from ..lab.study.settings import load_study
    from ..lab.study.tuning import imported, result, search, tuned_part

    imported()
    study = load_study(file, settings)
    trials = tuned_part(study).trials
    found = probe(plan_of(study))
    compile_if_cold()
    folder, stopped = out or Path("runs") / study.name, False
    with choose(found, workers, processes, cluster) as pool:
        try:
            with (
                remembered_interrupt() as stop_if_pressed,
                trial_bar(trials) as show,
            ):

                def progress(done: int, best: float) -> None:
                    stop_if_pressed()
                    show(done, best)

                search(study, folder, pool, force=force, progress=progress)
        except KeyboardInterrupt:
            stopped = True
        best = result(study, folder, None if stopped else pool)
    if as_json:
        say_json(tuned_dict(best) | {"stopped": stopped})
    else:
        say(tuned_text(best))
        if stopped:
            click.echo(STOPPED_TEXT, err=True)
    return STOPPED if stopped else DONE


@contextmanager
def trial_bar(total: int) -> Iterator[Callable[[int, float], None]]:
    """Trials done and the best value, on standard error and only where that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda done, best: None
        return
    from rich.progress import TimeRemainingColumn

    with counter("trials", TimeRemainingColumn(), "{task.fields[best]}") as shown:
        task = shown.add_task("", total=total, best="")
        yield lambda done, best: shown.update(task, completed=done, best=f"best {value_words(best)}")


def value_words(value: float | None) -> str:
    """A value in words: also that too many runs were lost, or that the gains are refused."""
    from ..lab.study.objective import LOST, REFUSED

    if value is None:
        return "outside the bounds"
    if value >= REFUSED:
        return "refused by a constraint"
    return f"{100 * (value / LOST - 1):.0f} % of runs not completed" if value >= LOST else f"{value:.4g}"


def tuned_text(tuned: Tuned) -> str:
    """The result for people."""
    t = tuned.tune
    lines = [
        f"{t.controller}: {tuned.trials} trials, {tuned.refused} of them refused by a constraint",
        f"quantile {t.quantile:g} of {t.objective} over the study's draws: {value_words(tuned.value)}"
        f" (the experiment's own gains: {value_words(tuned.own)})",
    ]
    if tuned.fresh is not None:
        (own, best), names = tuned.fresh, ("own gains", "best gains")
        lines.append(f"on {len(best.metric) or t.check} runs with fresh draws:")
        for name, score in zip(names, (own, best), strict=True):
            span = score.interval
            interval = "" if score.refused else f" [{span.low:.4g}, {span.high:.4g}]"
            lines.append(
                f"  {name}: {value_words(score.value)}{interval}, {100 * score.lost:.1f} % of runs not completed"
            )
    lines += [
        "best gains:",
        *(f"  --set {shlex.quote(f'{path}={json.dumps(value)}')}" for path, value in tuned.best.items()),
    ]
    return "\n".join(lines)


def tuned_dict(tuned: Tuned) -> dict[str, Any]:
    """The result for JSON."""
    fresh = None
    if tuned.fresh is not None:
        fresh = {
            name: {"quantile": score.interval.to_dict(), "lost": score.lost, "refused": score.refused}
            for name, score in zip(("own", "best"), tuned.fresh, strict=True)
        }
    t = tuned.tune
    about = {"controller": t.controller, "objective": t.objective, "quantile": t.quantile}
    counts = {"trials": tuned.trials, "refused": tuned.refused}
    return about | counts | {"own": tuned.own, "best": tuned.value, "gains": tuned.best, "fresh": fresh}
