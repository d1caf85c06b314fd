"""What judges the thesis or proves a theorem: proofs and certificates, the judge, studies. See README.md."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import click


def alone(command: click.Command) -> int:
    """Run one of these commands as `mmnn` would, from `python -m`; its exit code."""
    from mmnn_pin.cli import main, mmnn

    assert command.name is not None
    mmnn.add_command(command)
    return main([command.name, *sys.argv[1:]])
