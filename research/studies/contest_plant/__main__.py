"""The contest on a plant of its own: `python -m research.studies.contest_plant`.

Controllers are driven through `Stepper`, as on a robot, with the contest's settings; the plant shares no code with the
package's. Each number stands beside its share of the one in docs/explanation/contest.csv. `--change` makes the robot
other than the contest's, which no controller is told.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from mmnn_pin.lab.experiments.cases import chosen_cases
from mmnn_pin.lab.show.table import Cell, Column, Table, number, row_of, terminal_text
from research.contest.settings import load_contest
from research.contest.show import KNOWLEDGE, TRAINING
from research.contest.task import tasks_of
from research.studies.contest.document import DOCUMENT, PLANT
from research.studies.document import DOCS

from .drive import CHANGES, Errors, errors_of

TASKS = (
    *("eight", "payload", "friction", "lag", "late1", "late3"),
    *("encoders", "observed", "drop"),
)
CONTROLLERS = (
    *("pd_gravity", "pid", "two_layer", "adaptive", "adaptive_composite", "concurrent", "kalman_regressor"),
    *("kalman_friction", "computed_torque"),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, drive, print."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.contest_plant", description=__doc__)
    parser.add_argument("--task", action="append", choices=TASKS, help="may be repeated (all)")
    parser.add_argument("--controller", action="append", metavar="NAME", help="may be repeated (nine)")
    parser.add_argument("--change", action="append", choices=CHANGES, help="may be repeated (contest)")
    parser.add_argument("--held-out", default="", metavar="NAME", help="on it alone, as on 'tight' of the eights (all)")
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="of each, medians count (1)")
    parser.add_argument("--publish", action="store_true", help="keep what was found, for docs/explanation/contest.md")
    options = parser.parse_args(arguments)
    if options.held_out and options.publish:
        parser.error("--publish keeps all held-out trajectories, not one: leave --held-out out")
    tasks = tasks_of(chosen_cases(load_contest(), options.task or TASKS), ("pd",))
    for task in tasks:
        if options.held_out not in ("", *task.held_out):
            parser.error(f"--held-out {options.held_out}: {task.name} has {', '.join(task.held_out)}")
    for change in options.change or ("contest",):
        for task in tasks:
            rows = []
            for name in options.controller or CONTROLLERS:
                seeds = task.seeds[: options.seeds]
                runs = [errors_of(task, name, CHANGES[change], seed, options.held_out) for seed in seeds]
                errors, known = Errors.middle(runs), published(task.name, name)
                rows.append(row_of(name, *cells(errors, known.training if options.held_out else known)))
                if options.publish:
                    keep(change, task.name, name, errors)
            heads = Column(text=True), *(Column(*head) for head in HEADS)
            title = f"{task.name}, {CHANGES[change].about} (in brackets: over the contest's)"
            print(terminal_text([Table(title, heads, tuple(rows))], False, 120), flush=True)
    if options.publish:
        DOCUMENT.write()


HEADS = (
    *(("base\n", "mm"), ("arm\n", "mrad"), ("base\n", "mm", "held out"), ("arm\n", "mrad", "held out")),
    *(("base\n", "mm", "frozen"), ("arm\n", "mrad", "frozen"), ("FVU\n", "", "frozen")),
)


def published(task: str, name: str) -> Errors:
    """What the contest's CSV file has; nan for what it has not."""
    with (DOCS / "explanation/contest.csv").open(encoding="utf-8", newline="") as file:
        row = next((row for row in csv.DictReader(file) if (row["task"], row["controller"]) == (task, name)), {})
    units = {one.key: f"{one.key} [{one.unit}]" if one.unit else one.key for one in (*TRAINING, *KNOWLEDGE)}
    return Errors(*(float(row.get(units[key]) or "nan") for key in Errors.__dataclass_fields__))


def cells(errors: Errors, known: Errors) -> list[Cell]:
    """Numbers, each with its share of the one that is known."""
    found = []
    for key, value in asdict(errors).items():
        other = getattr(known, key)
        share = f" ({value / other:.2f})" if other > 0.0 and math.isfinite(value) and math.isfinite(other) else ""
        found.append(Cell(number(value, "lost") + share))
    return found


def keep(change: str, task: str, name: str, errors: Errors) -> None:
    """Put what was found beside what is kept."""
    content: dict[str, Any] = json.loads(PLANT.read_text(encoding="utf-8")) if PLANT.exists() else {}
    numbers = {key: value if math.isfinite(value) else None for key, value in asdict(errors).items()}
    content.setdefault(change, {}).setdefault(task, {})[name] = numbers
    PLANT.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
