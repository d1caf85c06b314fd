"""Everything that docs/thesis/chapter5.md says, from nothing: `python -m research.studies.chapter5` in a checkout.

Runs the experiment, the calibration of its rig, the same rig again and again, one number of it moved at a time, and
the ranking over drawn rigs, and writes figures, tables and the document itself.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from mmnn_pin import run_experiment
from mmnn_pin.lab.show.figure import save
from mmnn_pin.lab.show.gallery import write_pictures
from research.studies.document import Clock, write_rows

from .calibration import CASES, Budget, calibrate, deviation, largest, taken
from .compare import SETTLED, accuracy, ranking, repeatability, sweep
from .document import DOCUMENT
from .plots import sweep_figure
from .rigs import DRAWN, PERIODS, TIGHT, chapter5, saturation
from .verdict import verdict


@dataclass(frozen=True)
class Amount:
    """How much is run."""

    searches: Budget = field(default_factory=Budget)  # the calibration's
    repeats: int = 40  # runs of each calibrated rig
    moved: int = 8  # runs at each place of the sweep
    rigs: int = 200  # drawn rigs of the ranking
    chunk: int = 25  # how many of them are run at a time
    checked: int = 12  # how many of them are run again with a finer plant


QUICK = Amount(Budget(1, 10), repeats=2, moved=1, rigs=4, chunk=4, checked=1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, run, write."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.chapter5", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/chapter5-study"), help="folder for all that is written")
    parser.add_argument(
        "--quick", action="store_true", help="a little of everything: shows that it runs, not what holds"
    )
    parser.add_argument(
        "--publish", action="store_true", help="renew docs/thesis/chapter5.md, its figures and the saved summary"
    )
    parser.add_argument("--rigs", type=int, default=Amount.rigs, help=f"drawn rigs of the ranking ({Amount.rigs})")
    options = parser.parse_args(arguments)
    summary = study(QUICK if options.quick else Amount(rigs=options.rigs), options.out)
    DOCUMENT.save(summary, options.out, options.publish)


def study(amount: Amount, out: Path) -> dict[str, Any]:
    """Run all of it; figures and rows go to `out`, the numbers of the document are returned."""
    figures = out / "figures"
    figures.mkdir(parents=True, exist_ok=True)
    clock = Clock()
    say = clock.say
    summary: dict[str, Any] = {"experiment": run(figures), "saturation": saturation()}
    say("the experiment")
    summary["calibration"] = found = calibrate(amount.searches, say)
    rigs = [{**values, "unit": CASES[0].unit} for values in found[CASES[0].name]["searches"]]
    summary["repeats"] = repeatability([{}, *rigs], amount.repeats, say)
    summary["sweep"] = sweep(taken(), amount.moved, say)
    save(sweep_figure(summary["sweep"]), figures / "chapter5-sweep.png")
    summary["ranking"] = ranked(amount, out, say)
    summary["run"] = clock.facts()
    say("done")
    return summary


def run(figures: Path) -> dict[str, Any]:
    """The experiment as `mmnn run chapter5` runs it: errors, intervals, learning's share; its figures 5.3 to 5.5."""
    result = run_experiment(chapter5(), "chapter5")
    wanted = [name for name in chapter5().plots if name.startswith("figure-")]
    for name, file in write_pictures(result.recordings, wanted, figures).items():
        file.rename(figures / f"chapter5-{name}.png")
    about = result.to_dict()
    kept = ("rms_", "learned_share", "effective_gain")
    metrics = {
        name: {key: value for key, value in each["metrics"].items() if any(part in key for part in kept)}
        for name, each in about["runs"].items()
    }
    names = ("one_layer", "two_layer_zero")
    return {
        **result.largest_errors(),
        "metrics": metrics,
        "intervals": result.figure_ranges(),
        "met": sum(row["inside"] for row in result.figure_ranges()),
        "file": taken(),
        "deviation": float(deviation(largest([chapter5()], names[:1]), names[:1])[0]),
        "deviation_of_all": float(deviation(largest([chapter5()], names), names)[0]),
    }


def ranked(amount: Amount, out: Path, say: Callable[[str], None]) -> dict[str, Any]:
    """Draw, run, judge."""
    rows = ranking(amount.rigs, amount.chunk, say)
    write_rows(out / "rigs.csv", rows)
    return {
        "rigs": amount.rigs,
        "drawn": [asdict(number) for number in DRAWN],
        "periods": PERIODS,
        "tight": TIGHT,
        "settled": SETTLED,
        "verdict": verdict(rows),
        "accuracy": accuracy(amount.checked),
    }


if __name__ == "__main__":
    main()
