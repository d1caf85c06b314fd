"""`mmnn list` and `mmnn readings`: what there is to run, and what the thesis leaves open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from .options import examples, shared
from .output import DONE, compile_if_cold, progress_bar, say, say_json

MOST = 8  # names of cases that a line shows


@click.command(
    "list",
    short_help="List experiments with their cases, robots, controllers, references.",
    epilog=examples("mmnn list", "mmnn list --json"),
)
@shared
def list_(as_json: bool) -> int:
    """List the bundled experiments with their cases, robots, the controllers and the references.

    A contest's cases are its tasks. Controllers are listed with what they are told and what they learn.
    """
    from ..lab.experiments.config import bundled, read_toml, variants
    from ..lab.experiments.controllers import CONTROLLERS
    from ..lab.experiments.references import ARM_PROFILES, BASE_PATHS
    from ..model.robots import bundled as robots
    from ..model.robots import extra

    there_is: dict[str, dict[str, Any]] = {
        "experiments": {name: read_toml(path).get("title", "") for name, path in bundled().items()},
        "variants": {name: list(variants(path)) for name, path in bundled().items()},
        "cases": {name: list(read_toml(path).get("cases", {})) for name, path in bundled().items()},
        "robots": {name: str(path) for name, path in (robots() | extra()).items()},
        "controllers": CONTROLLERS,
        "references": {"base": about(BASE_PATHS), "arm": about(ARM_PROFILES)},
    }
    if as_json:
        say_json(there_is)
        return DONE
    references = there_is.pop("references")
    for option in ("variant", "case"):
        for name, known in there_is.pop(f"{option}s").items():
            shown = [*known[:MOST], "..."] if len(known) > MOST else known
            there_is["experiments"][name] += f" (--{option} {', '.join(shown)})" if known else ""
    there_is |= {f"references of the {part}": kinds for part, kinds in references.items()}
    for kind, entries in there_is.items():
        say("\n".join([kind, *(f"  {name:24}{text}" for name, text in entries.items())]))
    return DONE


def about(kinds: dict[str, Any]) -> dict[str, str]:
    """First line of the docstring of every class."""
    return {name: (kind.__doc__ or "").partition("\n")[0] for name, kind in kinds.items()}


@click.command(
    short_help="Turn each switch that the thesis leaves open, one at a time.",
    epilog=examples(
        "mmnn readings chapter4",
        "mmnn readings chapter4 --variant printed",
        "mmnn readings chapter4 --set time.control_period=0.001 --json",
    ),
)
@click.argument("experiment")
@click.option("--variant", metavar="NAME", help="A variant of the experiment, see `mmnn list`.  [default: its first]")
@click.option("--set", "settings", metavar="KEY=VALUE", multiple=True, help="Change a key of the TOML; repeatable.")
@shared
def readings(experiment: str, variant: str | None, settings: tuple[str, ...], as_json: bool) -> int:
    """Run both learners of EXPERIMENT as it is, then with each switch turned alone, and print what that changes.

    The switches: learning rates per sample or per second, weights from zero or random, Appendix B's order and its
    wd = 5, the frame of the pose error in the networks' input, the input with and without absolute position. Nothing
    is written.
    """
    from ..lab.experiments.cases import readings as turn
    from ..lab.experiments.cases import summaries
    from ..lab.experiments.config import load_experiment
    from ..lab.show.comparison import render_readings

    asked, name = load_experiment(experiment, settings, variant), Path(experiment).stem
    compile_if_cold()
    with progress_bar() as show:
        rows = summaries(turn(asked, name, show))
    if as_json:
        say_json({"experiment": name, "variant": asked.variant, "readings": rows})
    else:
        variant = f" (variant {asked.variant})" if asked.variant else ""
        say(render_readings(f"{asked.title or name}{variant}, each switch turned alone", rows))
    return DONE
