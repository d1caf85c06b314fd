"""What gains must satisfy before any run is made with them; a certificate's limit on the learning rates belongs here.

A constraint takes the loop of a run and raises `ConfigError` where its gains break it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..errors import ConfigError
from ..loop import Loop
from .plan import Plan
from .worker import Task, loop_of

MOST = 64  # runs of a study on which gains are judged, evenly spread


def stable_when_sampled(loop: Loop) -> None:
    """The PD loop alone is stable at the control period, on the true robot; see `sampled.py`."""
    replace(loop, check_gains=True).require_stable_gains()


CONSTRAINTS: tuple[Callable[[Loop], None], ...] = (stable_when_sampled,)


def violations(plan: Plan) -> Iterator[str]:
    """Complaints about the gains of a study, one per run that breaks a constraint."""
    for number in numbers(plan):
        loop = loop_of(Task.of(plan.row(number)))
        for constraint in CONSTRAINTS:
            try:
                constraint(loop)
            except ConfigError as error:
                yield f"row {number}: {error.what}"
                break


def numbers(plan: Plan) -> list[int]:
    """Runs on which gains are judged."""
    return sorted({int(i) for i in np.linspace(0, len(plan) - 1, min(MOST, len(plan)))})
