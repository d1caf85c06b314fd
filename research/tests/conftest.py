"""Commands and figures of this package in `mmnn`, as where it is installed."""

import research.show  # noqa: F401
from mmnn_pin.cli import mmnn
from research.contest.command import contest
from research.prove import prove

for _command in (prove, contest):
    mmnn.add_command(_command)
