"""`mmnn readings`."""

from __future__ import annotations

from pathlib import Path

import click

from .options import examples, shared
from .output import DONE, compile_if_cold, progress_bar, say, say_json


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
    from ..lab.experiments.config import load_experiment
    from ..lab.experiments.readings import readings as turn
    from ..lab.experiments.readings import summaries
    from ..lab.show import effects

    asked, name = load_experiment(experiment, settings, variant), Path(experiment).stem
    compile_if_cold()
    with progress_bar() as show:
        rows = summaries(turn(asked, name, show))
    if as_json:
        say_json({"experiment": name, "variant": asked.variant, "readings": rows})
    else:
        variant = f" (variant {asked.variant})" if asked.variant else ""
        say(effects.render(f"{asked.title or name}{variant}, each switch turned alone", rows))
    return DONE
