"""Commands of this package on disks that fail, as `failing_disks` makes them."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import failing_disks

import research.show  # noqa: F401
from mmnn_pin.cli import mmnn
from research.proof import certified_run
from research.prove import prove

COMMANDS = {
    "prove": "prove run.h5 --plots {out}",
}
COMPUTED = ((certified_run, "Proof"), (certified_run, "certified_run"))


if __name__ == "__main__":
    mmnn.add_command(prove)
    failing_disks.COMMANDS, failing_disks.COMPUTED = COMMANDS, COMPUTED
    print(json.dumps(failing_disks.work(Path(sys.argv[1]), False)))
