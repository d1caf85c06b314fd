"""Commands of this package on disks that fail, as `failing_disks` makes them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any
from unittest.mock import patch

import failing_disks
import sound_contest

import research.show  # noqa: F401
from mmnn_pin.cli import mmnn
from research.contest import contest
from research.contest.command import contest as command
from research.contest.task import Demand, Task
from research.proof import certified_run
from research.prove import prove

COMMANDS = {
    "contest": "contest --case eight --controller two_layer --out {out}",
    "plot of a contest": "plot contest --what contest-fvu --out {out}",
    "prove": "prove run.h5 --plots {out}",
}
COMPUTED = ((certified_run, "Proof"), (certified_run, "certified_run"))
DEMAND = Demand(("a", "b"), (0.4, 0.4), (0.2, 0.2))


def quick_trial(task: Task, controller: str, *_: Any) -> tuple[list[Any], float]:
    """A trial of a contest whose numbers are invented: the runs are not what is tested."""
    return sound_contest.invented(controller, 0.01), 1e-5


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    for one in (prove, command):
        mmnn.add_command(one)
    failing_disks.COMMANDS, failing_disks.COMPUTED = COMMANDS, COMPUTED
    prepared = failing_disks.prepare

    def prepare(folder: Path) -> None:
        """What the commands read."""
        prepared(folder)
        sound_contest.contest(folder / "contest")

    failing_disks.prepare = prepare
    with (
        patch.object(contest, "run_trial", quick_trial),
        patch.object(contest, "demand", lambda task: DEMAND),
        patch.object(Task, "rows", None),
    ):
        found = failing_disks.work(folder, False)
    print(json.dumps(found))
