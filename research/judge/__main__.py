"""Judge controllers on robots and draws that were fixed before any learner was changed.

    python -m research.judge FOLDER [--family dev|final] [--robots NAME ...] [--controllers NAME ...] [--draws N]
                                    [--plants judge|contact ...] [--workers N] [--publish]

Rows are kept in FOLDER/results.jsonl as they come: Ctrl-C keeps what is done, and the next call goes on. What was run
with other sources is run again. `--family final` is for the published table alone. --publish writes
docs/explanation/judge.md and judge.csv of all rows of `final` that FOLDER has of today's sources, once nothing that the
other options ask for is missing.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
import time
from collections.abc import Sequence
from functools import cache
from multiprocessing import Pool
from pathlib import Path
from typing import Any

from mmnn_pin.compiled.folders import imports_of, text_of
from mmnn_pin.errors import InputError
from mmnn_pin.files import locked
from mmnn_pin.lab.show.table import Column, Table, number, row_of, terminal_text
from mmnn_pin.lab.study.pools import begin
from mmnn_pin.torque.entries import CONTROLLERS

from .draws import draw_of, on_contact, preregistered
from .page import publish
from .run import errors_of, settings_of
from .score import Row, paired, parts_of_table, score_of

KEY = "robot", "family", "draw", "plant", "controller", "sources"
OWN = "preregistered.toml", "draws.py", "plant.py", "contact.py", "run.py"
Wanted = tuple[str, str, int, str, tuple[str, ...]]
NOT_OF_A_RUN = {"mmnn_pin.torque.entries"}  # a list that grows
PLANTS = ["judge", "contact"]
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


def rows_of(wanted: Wanted) -> list[Row]:
    """The rows of a robot, a family, a number, a plant and some controllers."""
    robot, family, number, plant, controllers = wanted
    draw, rows = draw_of(robot, family, number), []
    said = {name: draw.said[name] for name in SAID}
    for name in controllers:
        began = time.process_time()
        errors = errors_of(draw, name, plant)
        key = dict(zip(KEY, (robot, family, number, plant, name, sources(name)), strict=True))
        rows.append(key | errors | {"said": said, "seconds": round(time.process_time() - began, 2)})
    return rows


def kept(file: Path) -> list[Row]:
    """The rows of a file; a last line that was cut off is removed from it."""
    if not file.exists():
        return []
    whole, end, cut = file.read_text(encoding="utf-8").rpartition("\n")
    if cut:
        os.truncate(file, len((whole + end).encode()))
    return [json.loads(line) for line in whole.splitlines()]


def wanted_of(options: argparse.Namespace) -> list[Wanted]:
    """What `rows_of` takes for all that is asked for, draw after draw over all robots."""
    said, found = preregistered(), []
    baseline = said["controllers"]["baseline"]
    judged = options.controllers or [name for name in said["controllers"]["judged"] if name in CONTROLLERS]
    names = (baseline, *(name for name in judged if name != baseline))
    for plant in options.plants:
        file = said["robots"] | {"draws": said["draws"]} if plant == "judge" else on_contact()
        robots = file["dev"] + (file["final_only"] if options.family == "final" else [])
        robots = [name for name in robots if name in (options.robots or robots)]
        numbers = range(min(options.draws, file["draws"]))
        found += [(robot, options.family, number, plant, names) for number in numbers for robot in robots]
    return found


def key_of(row: Row) -> tuple[Any, ...]:
    """By what a row is known."""
    return tuple(row[name] for name in KEY)


def keys_of(wanted: Wanted) -> list[tuple[Any, ...]]:
    """By what the rows are known that are wanted."""
    return [(*wanted[:4], name, sources(name)) for name in wanted[4]]


def missing(rows: Sequence[Row], wanted: Sequence[Wanted]) -> list[Wanted]:
    """What is wanted and not kept."""
    done = {key_of(row) for row in rows}
    found = [(*one[:4], tuple(key[4] for key in keys_of(one) if key not in done)) for one in wanted]
    return [one for one in found if one[4]]


def run_missing(todo: Sequence[Wanted], file: Path, workers: int) -> None:
    """Run what is missing, and append rows to the file draw by draw; Ctrl-C ends at once with what the file has."""
    total, done, began = sum(len(one[4]) for one in todo), 0, time.monotonic()
    with file.open("a", encoding="utf-8") as sink, Pool(workers, begin, (os.getpid(),)) as pool:
        try:
            for rows in pool.imap_unordered(rows_of, todo):
                sink.writelines(json.dumps(row) + "\n" for row in rows)
                sink.flush()
                done += len(rows)
                left = (time.monotonic() - began) / done * (total - done)
                print(f"{done} of {total} runs, {left / 60:.0f} min left", file=sys.stderr, flush=True)
        except KeyboardInterrupt:
            print("stopped: what is done is kept, the same command goes on", file=sys.stderr)
            raise


def table_of(title: str, rows: Sequence[Row], controllers: Sequence[str]) -> Table:
    """Scores of controllers on some rows."""
    found = []
    for name in controllers:
        if not (pairs := paired(rows, name)):
            continue
        s = score_of(pairs)
        ratios = [number(value, "lost") for value in (s.median, s.high, s.worst, s.arm, s.base)]
        found.append(row_of(name, f"{100 * s.better:.0f}", *ratios, f"{s.lost} ({s.alone})", str(s.draws)))
    heads = [Column(head) for head in ("median", "90 %", "worst", "arm", "base", "lost (alone)", "draws")]
    return Table(title, (Column(text=True), Column("better", "%"), *heads), tuple(found))


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, run what is missing, print or publish."""
    said = preregistered()
    parser = argparse.ArgumentParser(prog="python -m research.judge", description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--family", choices=("dev", "final"), default="dev")
    parser.add_argument("--robots", nargs="+", metavar="NAME", help="(all of the family)")
    parser.add_argument("--controllers", nargs="+", metavar="NAME", help="beside the baseline (all)")
    parser.add_argument("--draws", type=int, default=said["draws"], metavar="N", help="of every robot (20)")
    parser.add_argument(
        "--plants", nargs="+", choices=PLANTS, help="judge, contact for MuJoCo (of final both, else judge)"
    )
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--publish", action="store_true", help="write docs/explanation/judge.md of the rows of final")
    options = parser.parse_args(arguments)
    options.plants = options.plants or PLANTS[: 2 if options.family == "final" else 1]
    if options.publish and options.family != "final":
        parser.error("--publish is for --family final")
    wanted = wanted_of(options)
    for name in options.robots or ():
        if name not in {one[0] for one in wanted}:
            parser.error(f"--robots {name}: {', '.join(options.plants)} of family {options.family} has no such robot")
    file = options.folder / "results.jsonl"
    with locked(file, "results file"):
        if todo := missing(kept(file), wanted):
            run_missing(todo, file, options.workers)
    keys = {key for one in wanted for key in keys_of(one)}
    today = [row for row in kept(file) if row["sources"] == sources(row["controller"])]
    rows = [row for row in today if key_of(row) in keys]
    if options.publish and (left := sum(len(one[4]) for one in missing(rows, wanted))):
        print(f"not published: {left} runs are missing, the same command goes on", file=sys.stderr)
    elif options.publish:
        publish([row for row in today if row["family"] == "final"])
    for plant in options.plants:
        for part, tables in parts_of_table([row for row in rows if row["plant"] == plant]).items():
            for title, own in tables.items():
                if own and part != "disturbances":
                    table = table_of(title, own, wanted[0][4])
                    print(terminal_text([f"{title}, plant {plant}", table], False, 120), flush=True)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"{error}")
    except KeyboardInterrupt:
        sys.exit(130)
