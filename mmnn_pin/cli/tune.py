"""`mmnn tune`."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .options import examples, makes_runs, shared
from .output import DONE, STOPPED, compile_if_cold, say, say_json
from .run import remembered_interrupt
from .study import choose

if TYPE_CHECKING:
    from ..lab.study.tuning import Tuned


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
    """Try gains within the bounds of STUDY.toml's [tune] and tell the best.

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
                bar(trials) as show,
            ):

                def progress(done: int, best: float) -> None:
                    stop_if_pressed()
                    show(done, best)

                search(study, folder, pool, force=force, progress=progress)
        except KeyboardInterrupt:
            stopped = True
        best = result(study, folder, None if stopped else pool)
    if as_json:
        say_json(to_dict(best) | {"stopped": stopped})
    else:
        say(told(best))
        if stopped:
            click.echo("stopped by Ctrl-C; the same command goes on with what is missing", err=True)
    return STOPPED if stopped else DONE


@contextmanager
def bar(total: int) -> Iterator[Callable[[int, float], None]]:
    """Trials done and the best value, on standard error and only where that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda done, best: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("trials"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[best]}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as shown:
        task = shown.add_task("", total=total, best="")
        yield lambda done, best: shown.update(task, completed=done, best=f"best {words(best)}")


def words(value: float | None) -> str:
    """A value in words: also that too many runs were lost, or that the gains are refused."""
    from ..lab.study.objective import LOST, REFUSED

    if value is None:
        return "outside the bounds"
    if value >= REFUSED:
        return "refused by a constraint"
    return f"{100 * (value / LOST - 1):.0f} % of runs not completed" if value >= LOST else f"{value:.4g}"


def told(found: Tuned) -> str:
    """The result for people."""
    t = found.tune
    lines = [
        f"{t.controller}: {found.trials} trials, {found.refused} of them refused by a constraint",
        f"quantile {t.quantile:g} of {t.objective} over the study's draws: {words(found.value)}"
        f" (the experiment's own gains: {words(found.own)})",
    ]
    if found.fresh is not None:
        (own, best), names = found.fresh, ("own gains", "best gains")
        lines.append(f"on {len(best.metric) or t.check} runs with fresh draws:")
        for name, score in zip(names, (own, best), strict=True):
            span = score.interval
            interval = "" if score.refused else f" [{span.low:.4g}, {span.high:.4g}]"
            lines.append(f"  {name}: {words(score.value)}{interval}, {100 * score.lost:.1f} % of runs not completed")
    lines += [
        "best gains:",
        *(f"  --set {shlex.quote(f'{path}={json.dumps(value)}')}" for path, value in found.best.items()),
    ]
    return "\n".join(lines)


def to_dict(found: Tuned) -> dict[str, Any]:
    """The result for JSON."""
    fresh = None
    if found.fresh is not None:
        fresh = {
            name: {"quantile": score.interval.to_dict(), "lost": score.lost, "refused": score.refused}
            for name, score in zip(("own", "best"), found.fresh, strict=True)
        }
    t = found.tune
    about = {"controller": t.controller, "objective": t.objective, "quantile": t.quantile}
    counts = {"trials": found.trials, "refused": found.refused}
    return about | counts | {"own": found.own, "best": found.value, "gains": found.best, "fresh": fresh}
