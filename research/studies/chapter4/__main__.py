"""Everything that docs/thesis/chapter4.md says, from nothing: `python -m research.studies.chapter4` in a checkout.

Runs the three variants, every other reading of the thesis, the calibration, the walk around its optimum and the test
of the claim, and writes figures, tables and the document itself.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin import load_experiment, run_experiment
from mmnn_pin.lab.experiments.cases import readings, summaries
from mmnn_pin.lab.experiments.config import find, variants
from mmnn_pin.lab.experiments.result import Result
from mmnn_pin.lab.show.figure import save
from mmnn_pin.lab.show.gallery import write_pictures
from research.studies.document import Clock, write_rows

from .calibration import Budget as Searches
from .calibration import Effort, Trials, calibrate, flatness
from .claim import Row, accuracy, claim, conditions
from .document import DOCUMENT, same_fit
from .draws import PARTS, PERIODS, RANGES, REFERENCES
from .plots import claim_figure, flatness_figure, intervals_figure, ranges_of
from .tuning import Budget as Tuning
from .tuning import tunings
from .unstated import CASES
from .verdict import verdict, what_decides

FITTED = CASES[0]  # the variant `figures` takes its values from it


@dataclass(frozen=True)
class Amount:
    """How much is run."""

    searches: Searches = field(default_factory=Searches)  # the calibration's
    effort: Effort = field(default_factory=Effort)  # the flatness's
    tuning: Tuning = field(default_factory=Tuning)  # the claim's, for each learner
    draws: int = 1000  # the claim's test draws
    explained: int = 200  # for how many of them gain and integral are run, too: medians need fewer draws than shares
    chunk: int = 50  # how many of them are run at a time
    checked: int = 8  # how many of them are run again with a finer plant


QUICK = Amount(Searches(1, 12, 2), Effort(2, 4, 2, 12, 1), Tuning(2, 2, 7), draws=8, explained=4, chunk=4, checked=1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, run, write."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.chapter4", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/chapter4-study"), help="folder for all that is written")
    parser.add_argument(
        "--quick", action="store_true", help="a little of everything: shows that it runs, not what holds"
    )
    parser.add_argument(
        "--publish", action="store_true", help="renew docs/thesis/chapter4.md, its figures and the saved summary"
    )
    parser.add_argument("--draws", type=int, default=Amount.draws, help=f"draws of the claim's test ({Amount.draws})")
    options = parser.parse_args(arguments)
    amount = QUICK if options.quick else Amount(draws=options.draws)
    summary = study(amount, options.out)
    DOCUMENT.save(summary, options.out, options.publish)


def study(amount: Amount, out: Path) -> dict[str, Any]:
    """Run all of it; figures and rows go to `out`, the numbers of the document are returned."""
    figures = out / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    clock = Clock()
    say = clock.say
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
    summary["run"] = clock.facts()
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


def write_trials(path: Path, tried: dict[str, list[Trials]]) -> None:
    """Every trial of every search: case, seed, cost, twelve extremes, and its place in the ranges, 0 to 1."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["case", "seed", "cost", *(f"extreme {i}" for i in range(12)), "place ..."])
        for name, searches in tried.items():
            for trials in searches:
                for line in np.column_stack((trials.costs, trials.extremes, trials.places)):
                    writer.writerow([name, trials.seed, *line.tolist()])


PICTURES = ("figure-4.2", "figure-4.3", "figure-4.4", "psi", "gains")


def run_variants(folder: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Run every variant, write its pictures as `VARIANT-NAME.png`, and give the numbers for JSON."""
    found = {}
    for variant in variants(find("chapter4")):
        result = run_experiment(load_experiment("chapter4", variant=variant), "chapter4")
        for name, file in write_pictures(result.recordings, PICTURES, folder).items():
            file.replace(folder / f"{variant}-{name}.png")
        found[variant] = numbers_of(result)
        say(f"variant {variant}: {found[variant]['met']} of {len(found[variant]['intervals'])}")
    return found


def numbers_of(result: Result) -> dict[str, Any]:
    """What the document takes from a variant."""
    as_json = result.to_dict()
    ranges = as_json["comparison"]["figure_ranges"]
    kept = ("effective_gain.", "learned_share.", "pose_error.x", "e.arm_1_joint", "z.v")
    metrics = {
        name: {key: value for key, value in run["metrics"].items() if key.startswith(kept)}
        for name, run in as_json["runs"].items()
    }
    return {
        "intervals": ranges,
        "met": sum(row["inside"] for row in ranges),
        "metrics": metrics,
        "improvement": as_json["comparison"]["improvement"],
        "unfair": as_json["comparison"]["unfair"],
        "messages": [run["message"] for run in as_json["runs"].values() if run["message"]],
    }


def read_otherwise(say: Callable[[str], None]) -> list[dict[str, Any]]:
    """Every reading of what the thesis does not state, changed alone from the default variant."""
    rows = summaries(readings(load_experiment("chapter4"), "chapter4"))
    say(f"{len(rows)} readings")
    return rows


if __name__ == "__main__":
    main()
