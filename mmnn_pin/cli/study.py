"""`mmnn study`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .options import examples, makes_runs, shared
from .output import DONE, FAILED, STOPPED, compile_if_cold, say, say_json, warn
from .run import remembered_interrupt

if TYPE_CHECKING:
    from ..lab.study.execution import Pool
    from ..lab.study.plan import Plan
    from ..lab.study.session import Probe
    from ..lab.study.worker import JobResult


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
    """Make every run of STUDY.toml that is not in its database yet, then tell what came out.

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
    return tell(folder, stopped, as_json)


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
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("runs"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[lost]}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("", total=total, completed=done, rate="", lost="")
        lost = 0

        def advance(finished: JobResult) -> None:
            nonlocal lost
            lost += finished.status != "completed"
            speed = shown.tasks[0].speed
            told = {"rate": f"{speed:.1f}/s" if speed else "", "lost": f"{lost} not completed" if lost else ""}
            shown.update(task, advance=1, **told)  # type: ignore[arg-type]

        yield advance


def run_again(plan: Plan, number: int, folder: Path, force: bool, as_json: bool) -> int:
    """Run one row alone with all its signals and compare its numbers with those stored."""
    from ..lab.study.session import rerun

    result = rerun(plan, number, folder, force)
    if as_json:
        say_json(result.to_dict())
    else:
        say(result.describe())
    return DONE if result.same in (True, None) else FAILED


def tell(folder: Path, stopped: bool, as_json: bool) -> int:
    """Tell what the database holds, and give the exit code."""
    from ..lab.show.study import table
    from ..lab.study.results import load_results

    results = load_results(folder)
    if as_json:
        say_json(table.to_dict(results) | {"stopped": stopped})
    else:
        say(table.render(results, colour=sys.stdout.isatty()))
        say(f"\nrows: {results.path}")
        if stopped:
            click.echo("stopped by Ctrl-C; the same command goes on with what is missing", err=True)
    return STOPPED if stopped else FAILED if results.failed else DONE
