"""Torques of real robots on motions that were not learned on: `python -m research.studies.real_data FOLDER`.

FOLDER holds clones of the repositories in `sources`; those that are not there are named. Every method sees the motions
to learn on, and nothing of the others: the low-pass, the weights of every ridge and the gains come from the first. The
errors are those of `mmnn identify`: RMS of measured minus predicted torque over RMS of the measured one, where the
joint moves. Settings of learners are the shipped ones.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mmnn_pin import identify
from mmnn_pin.deploy.identify.equations import chosen_cutoff
from mmnn_pin.deploy.identify.identification import Identification, relative, scaled
from mmnn_pin.deploy.identify.quality import sound
from mmnn_pin.lab.show.table import Cell, Column, Table, row_of, terminal_text
from mmnn_pin.signals import Array

from . import learned
from .motion import Motion
from .sources import Case, cases

WIDTH = 140  # of a table
MODELS = ("urdf", "friction", "least_squares", "identified")


def predicted(case: Case, folder: Path) -> tuple[Motion, dict[str, Array], list[str]]:
    """The judged motion, what every method says of it, (M, r), and what `chosen` is for every joint."""
    known, asked = (
        [sound(scaled(log, case.robot, case.constants), case.robot) for log in logs]
        for logs in (case.learned, case.judged)
    )
    cutoff = chosen_cutoff(known, case.robot)
    found = identify(case.robot, known, held_out=asked, cutoff=cutoff)
    period = float(np.median(np.diff(known[0].time)))
    ours, theirs = (Motion.of(logs, found.unknowns, cutoff, period) for logs in (known, asked))
    said = {model: found.predicted(model, theirs.stacked) for model in MODELS}
    residual, chosen = learned.residuals(found, ours, theirs)
    return theirs, said | residual | by_learners(found, folder, ours, theirs, period), chosen


def by_learners(found: Identification, folder: Path, ours: Motion, theirs: Motion, period: float) -> dict[str, Array]:
    """What the package's learners say of the judged motion, (M, r) each."""
    files, said = found.save(folder, force=True), {}
    for rival in learned.rivals(files):
        learner = learned.new_learner(rival, found, period)
        state = learned.taught(learner, ours.stretches, rival)
        said[rival.title] = theirs.filtered(learned.along(learner, state))
    return said


def errors(judged: Motion, said: dict[str, Array]) -> dict[str, Array]:
    """Error of every joint, then of all together, (r + 1,)."""
    rows = judged.stacked
    return {name: np.append(relative(rows, each), relative(rows, each, None)) for name, each in said.items()}


def table_of(title: str, found: dict[str, Array], heads: Sequence[Column]) -> Table:
    """Errors as a table, the best of every column marked."""
    best = np.nanmin(list(found.values()), axis=0)
    rows = []
    for name, each in found.items():
        cells = (Cell(f"{100 * e:.2f}", mark="*" if e == least else "") for e, least in zip(each, best, strict=True))
        rows.append(row_of(name, *cells))
    return Table(title, (Column(text=True), *heads), tuple(rows))


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, learn, judge, print."""
    parser = argparse.ArgumentParser(prog="python -m research.studies.real_data", description=__doc__)
    parser.add_argument("folder", type=Path, help="with the clones")
    parser.add_argument("--only", default="", help="cases whose name holds this")
    options = parser.parse_args(arguments)
    together: dict[str, list[float]] = {}
    shown = [case for case in cases(options.folder) if options.only in case.name]
    for case in shown:
        before = time.process_time()
        with tempfile.TemporaryDirectory() as temporary:
            judged, said, chosen = predicted(case, Path(temporary))
        found = errors(judged, said)
        for name, each in found.items():
            together.setdefault(name, []).append(each[-1])
        joints = [Column(f"joint\n{i + 1}", "%") for i in range(len(chosen))]
        print(terminal_text([table_of(case.name, found, (*joints, Column("all\n", "%")))], False, WIDTH))
        print(f"chosen: {', '.join(kind or 'nothing' for kind in chosen)}; {time.process_time() - before:.0f} s\n")
    if len(shown) > 1:
        base = np.array(together["identified"])
        ratio = {name: np.exp(np.mean(np.log(each / base))) / 100 for name, each in together.items()}
        rows = {name: np.append(each, ratio[name]) for name, each in together.items()}
        heads = (*(Column(case.name.replace(", ", "\n"), "%") for case in shown), Column("mean over\nidentified"))
        print(terminal_text([table_of("all joints together", rows, heads)], False, 2 * WIDTH))


if __name__ == "__main__":
    main()
