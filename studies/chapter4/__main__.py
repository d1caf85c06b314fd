"""Everything that docs/chapter4.md says, from nothing: `python -m studies.chapter4` in a checkout.

Runs the three variants, every other reading of the thesis, the calibration, the walk around its optimum and the test
of the claim, and writes figures, tables and the document itself.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin.lab.show.figure import save
from mmnn_pin.loop.precompile import precompile

from .calibration import Budget as Searches
from .calibration import Trials, calibrate
from .claim import Row, accuracy, claim, conditions
from .document import publish, render, same_fit
from .draws import PERIODS, RANGES, REFERENCES
from .flatness import Effort, flatness
from .judging import PARTS
from .plots import claim_figure, flatness_figure, intervals_figure, ranges_of
from .tuning import Budget as Tuning
from .tuning import tunings
from .unstated import CASES
from .variants import read_otherwise, run_variants
from .verdict import verdict, what_decides

FITTED = CASES[0]  # the variant `figures` takes its values from it


@dataclass(frozen=True)
class Amount:
    """How much is run.

    Attributes:
        searches: The calibration's.
        effort: The flatness's.
        tuning: The claim's, for each learner.
        draws: The claim's test draws.
        explained: For how many of them gain and integral are run, too: medians need fewer draws than shares.
        chunk: How many of them are run at a time.
        checked: How many of them are run again with a finer plant.
    """

    searches: Searches = field(default_factory=Searches)
    effort: Effort = field(default_factory=Effort)
    tuning: Tuning = field(default_factory=Tuning)
    draws: int = 1000
    explained: int = 200
    chunk: int = 50
    checked: int = 8


QUICK = Amount(Searches(1, 12, 2), Effort(2, 4, 2, 12, 1), Tuning(2, 2, 7), draws=8, explained=4, chunk=4, checked=1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, run, write."""
    parser = argparse.ArgumentParser(prog="python -m studies.chapter4", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/chapter4-study"), help="folder for all that is written")
    parser.add_argument(
        "--quick", action="store_true", help="a little of everything: shows that it runs, not what holds"
    )
    parser.add_argument(
        "--publish", action="store_true", help="renew docs/chapter4.md, its figures and the saved summary"
    )
    parser.add_argument("--draws", type=int, default=Amount.draws, help=f"draws of the claim's test ({Amount.draws})")
    options = parser.parse_args(arguments)
    precompile()
    amount = QUICK if options.quick else Amount(draws=options.draws)
    summary = study(amount, options.out)
    (options.out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    (options.out / "chapter4.md").write_text(render(summary), encoding="utf-8")
    if options.publish:
        publish(options.out)


def study(amount: Amount, out: Path) -> dict[str, Any]:
    """Run all of it; figures and rows go to `out`, the numbers of the document are returned."""
    figures = out / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    begin, load = time.perf_counter(), os.getloadavg()[0]
    say = partial(told, begin)
    summary: dict[str, Any] = {"variants": run_variants(figures, say), "readings": read_otherwise(say)}
    summary["calibration"], tried = calibrate(amount.searches, say)
    write_trials(out / "trials.csv", tried)
    found = summary["calibration"][FITTED.name]
    if not same_fit(summary["variants"]["figures"], found):
        say(f"chapter4.figures.toml holds another fit; now it is {found['values']}")
    summary["flatness"] = flatness(FITTED, tried[FITTED.name], found["values"], amount.effort, say)
    rows = claimed(amount, summary, say)
    write_rows(out / "draws.csv", rows)
    for name, figure in {
        "intervals": intervals_figure(fits(summary)),
        "flatness": flatness_figure(
            summary["flatness"]["numbers"], ranges_of(found["numbers"]), summary["flatness"]["enough"]
        ),
        "claim": claim_figure(rows),
    }.items():
        save(figure, figures / f"{name}.png")
    wall = time.perf_counter() - begin
    summary["run"] = {
        "wall_s": wall,
        "processor_s": time.process_time(),
        "cores": os.cpu_count(),
        "load_before": load,
        "load_after": os.getloadavg()[0],
    }
    say("done")
    return summary


def claimed(amount: Amount, summary: dict[str, Any], say: Any) -> list[Row]:
    """Tune, test and judge; the verdict goes into the summary, the rows are returned."""
    tuned = tunings(amount.tuning, say)
    wanted = conditions(tuned["learners"])
    rows = claim(wanted, amount.draws, amount.explained, amount.chunk, say)
    summary["claim"] = {
        "tuned": tuned,
        "explained": min(amount.explained, amount.draws),
        "ranges": {name: {"lower": low, "upper": high, "unit": unit} for name, (low, high, unit, _) in RANGES.items()},
        "periods": PERIODS,
        "references": {name: words for name, (words, _) in REFERENCES.items()},
        "verdict": verdict(rows),
        "decides": {name: decides([row for row in rows if row["condition"] == name]) for name in wanted},
        "accuracy": accuracy(wanted, amount.checked),
    }
    return rows


def decides(rows: Sequence[Row]) -> dict[str, Any]:
    """What decides over the base and over the arm."""
    return {part: what_decides(rows, part) for part in PARTS}


def fits(summary: dict[str, Any]) -> dict[str, Any]:
    """Intervals of the variants and of the fit with equal gains, for the figure."""
    shown = {f"variant {name}": variant["intervals"] for name, variant in summary["variants"].items()}
    return shown | {"best fit with equal gains": summary["calibration"]["equal_22"]["intervals"]}


def told(begin: float, text: str) -> None:
    """Say what is done and when."""
    print(f"{time.perf_counter() - begin:6.1f} s  {text}", flush=True)


def write_rows(path: Path, rows: Sequence[Row]) -> None:
    """Rows as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def write_trials(path: Path, tried: dict[str, list[Trials]]) -> None:
    """Every trial of every search: case, seed, cost, twelve extremes, and its place in the ranges, 0 to 1."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["case", "seed", "cost", *(f"extreme {i}" for i in range(12)), "place ..."])
        for name, searches in tried.items():
            for trials in searches:
                for line in np.column_stack((trials.costs, trials.extremes, trials.places)):
                    writer.writerow([name, trials.seed, *line.tolist()])


if __name__ == "__main__":
    main()
