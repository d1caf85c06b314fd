"""Judge controllers on robots and draws that were fixed before any learner was changed.

    python -m research.judge FOLDER [--family dev|final] [--robots NAME ...] [--controllers NAME ...] [--draws N]
                                    [--workers N] [--publish]

Rows are kept in FOLDER/results.jsonl as they come: Ctrl-C keeps what is done, and the next call goes on. What was run
with other sources is run again. `--family final` is for the published table alone. --publish writes
docs/explanation/judge.md and judge.csv of the rows that FOLDER has.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from pathlib import Path
from typing import Any

from mmnn_pin.compiled.folders import imports_of, text_of
from mmnn_pin.lab.show.table import Cell, Column, Table, number, row_of, terminal_text
from mmnn_pin.torque.entries import CONTROLLERS

from .draws import draw_of, preregistered
from .run import errors_of, settings_of
from .score import Row, paired, parts_of_table, score_of

KEY = "robot", "family", "draw", "controller", "plant", "sources"
OWN = "preregistered.toml", "draws.py", "plant.py", "run.py"
NOT_OF_A_RUN = {"mmnn_pin.torque.entries"}  # a list that grows
SAID = "period", "delay", "lag", "encoder", "bits", "payload", "coulomb", "static"


@cache
def sources(name: str) -> str:
    """Hash of what a controller's rows depend on: this judge, what its module and the stepper import, its settings."""
    entry = CONTROLLERS.get(name)
    digest, left = hashlib.sha256(repr(settings_of(name) if entry else "").encode()), {"mmnn_pin.loop.stepper"}
    left |= {"mmnn_pin.model.loading", "mmnn_pin.loop.suited"}
    left |= {entry.load().__module__} if entry else set()
    found = set(left)
    while left:
        new = set(imports_of(left.pop()).values()) - found
        found |= new
        left |= new
    for file in (Path(__file__).with_name(own) for own in OWN):
        digest.update(file.read_bytes())
    for module in sorted(found - NOT_OF_A_RUN):
        digest.update(module.encode() + b"\0" + text_of(module))
    return digest.hexdigest()[:12]


def judge_draw(robot: str, family: str, number: int, controllers: Sequence[str]) -> Iterator[Row]:
    """Rows of some controllers on one draw, as they come."""
    draw = draw_of(robot, family, number)
    said = {name: draw.said[name] for name in SAID}
    for name in controllers:
        began = time.process_time()
        errors = errors_of(draw, name)
        key = dict(zip(KEY, (robot, family, number, name, "judge", sources(name)), strict=True))
        yield key | errors | {"said": said, "seconds": round(time.process_time() - began, 2)}


def rows_of(*arguments: Any) -> list[Row]:
    """`judge_draw` for another process."""
    return list(judge_draw(*arguments))


def kept(file: Path) -> list[Row]:
    """The rows of a file; a last line that was cut off is removed from it."""
    if not file.exists():
        return []
    whole, end, cut = file.read_text(encoding="utf-8").rpartition("\n")
    if cut:
        os.truncate(file, len((whole + end).encode()))
    return [json.loads(line) for line in whole.splitlines()]


def key_of(row: Row) -> tuple[Any, ...]:
    """By what a row is known."""
    return tuple(row[name] for name in KEY)


def missing(rows: Sequence[Row], wanted: dict[str, Any]) -> list[tuple[Any, ...]]:
    """The arguments of `judge_draw` for what is wanted and not kept, draw after draw over all robots."""
    done, found = {key_of(row) for row in rows}, []
    for draw in range(wanted["draws"]):
        for robot in wanted["robots"]:
            beside = (robot, wanted["family"], draw)
            names = [name for name in wanted["controllers"] if (*beside, name, "judge", sources(name)) not in done]
            if names:
                found.append((*beside, names))
    return found


def wanted_of(rows: Sequence[Row], wanted: dict[str, Any]) -> list[Row]:
    """The rows of what is wanted that were run with today's sources."""
    return [
        row
        for row in rows
        if row["controller"] in wanted["controllers"]
        and row["sources"] == sources(row["controller"])
        and row["family"] == wanted["family"]
        and row["robot"] in wanted["robots"]
        and row["draw"] < wanted["draws"]
    ]


def run_missing(todo: Sequence[tuple[Any, ...]], file: Path, workers: int) -> None:
    """Run what is missing, and append rows to the file as they come."""
    total, done, began = sum(len(one[3]) for one in todo), 0, time.monotonic()
    with file.open("a", encoding="utf-8") as sink, ProcessPoolExecutor(workers) as pool:
        runs = [pool.submit(rows_of, *one) for one in todo]
        try:
            for run in as_completed(runs):
                for row in run.result():
                    sink.write(json.dumps(row) + "\n")
                    done += 1
                sink.flush()
                left = (time.monotonic() - began) / done * (total - done)
                print(f"{done} of {total} runs, {left / 60:.0f} min left", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            print("stopped; what is done is kept", file=sys.stderr)


def table_of(title: str, rows: Sequence[Row], controllers: Sequence[str]) -> Table:
    """Scores of controllers on some rows."""
    found = []
    for name in controllers:
        if not (pairs := paired(rows, name)):
            continue
        s = score_of(pairs)
        cells = [Cell(f"{100 * s.better:.0f}"), *(Cell(number(value, "lost")) for value in (s.median, s.high, s.worst))]
        found.append(row_of(name, *cells, f"{s.lost} ({s.alone})", str(s.draws)))
    heads = (
        ("better\n", "%"),
        ("median\n", ""),
        ("90 %\n", ""),
        ("worst\n", ""),
        ("lost (alone)\n", ""),
        ("draws\n", ""),
    )
    return Table(title, (Column(text=True), *(Column(*head) for head in heads)), tuple(found))


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, run what is missing, print or publish."""
    said = preregistered()
    parser = argparse.ArgumentParser(prog="python -m research.judge", description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--family", choices=("dev", "final"), default="dev")
    parser.add_argument("--robots", nargs="+", metavar="NAME", help="(all of the family)")
    parser.add_argument("--controllers", nargs="+", metavar="NAME", help="beside the baseline (all)")
    parser.add_argument("--draws", type=int, default=said["draws"], metavar="N", help="of every robot (20)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--publish", action="store_true", help="write docs/explanation/judge.md")
    options = parser.parse_args(arguments)
    robots = said["robots"]["dev"] + (said["robots"]["final_only"] if options.family == "final" else [])
    for name in options.robots or ():
        if name not in robots:
            parser.error(f"--robots {name}: family {options.family} has {', '.join(robots)}")
    wanted = {"family": options.family, "robots": options.robots or robots, "draws": options.draws}
    baseline, judged = said["controllers"]["baseline"], options.controllers or said["controllers"]["judged"]
    wanted["controllers"] = [baseline, *(name for name in judged if name != baseline)]
    options.folder.mkdir(parents=True, exist_ok=True)
    file = options.folder / "results.jsonl"
    if todo := missing(kept(file), wanted):
        run_missing(todo, file, options.workers)
    rows = wanted_of(kept(file), wanted)
    for part, tables in parts_of_table(rows).items():
        for title, own in tables.items():
            if own and part != "disturbances":
                print(terminal_text([title, table_of(title, own, wanted["controllers"])], False, 120), flush=True)


if __name__ == "__main__":
    main()
