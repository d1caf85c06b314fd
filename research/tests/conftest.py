"""Commands and figures of this package in `mmnn`, as where it is installed."""

import research.show  # noqa: F401
from mmnn_pin.cli import mmnn
from research.prove import prove

mmnn.add_command(prove)
