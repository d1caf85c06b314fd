"""What gains must satisfy before the runs of a study are made with them.

A constraint takes the loop of a run and raises `ConfigError` where its gains break it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import msgspec
import numpy as np

from ...actuator import Actuator
from ...errors import ConfigError
from ...loop.loop import Loop
from ...sensing import Sensor
from ...torque.neural import Neural
from ..proof.rate import rate_of
from ..proof.subject import Subject
from .plan import Plan
from .worker import Task, loop_of

LOOK = 1.0  # of a run, to see where the weights go before the learning rates are judged [s]


def stable_when_sampled(loop: Loop) -> None:
    """The PD loop alone is stable at the control period, on the true robot; see `loop/before_run.py`."""
    replace(loop, check_gains=True).require_stable_gains()


def learns_slowly_enough(loop: Loop) -> None:
    """The loop with its network, linearised, does not grow at the first second's weights; see `lab/proof/rate.py`.

    Sensors, motors and the world are left out: this is about rates, sample time and gains.
    """
    controller = loop.controller
    if not isinstance(controller, Neural) or not controller.learning:
        return
    h, given = loop.timing.control_period, loop.timing
    timing = msgspec.structs.replace(given, duration=h * max(2, round(min(LOOK, given.duration) / h)))
    ideal = replace(loop, timing=timing, plant="ideal", sensor=Sensor(), actuator=Actuator(), safety=None)
    recording = replace(ideal, disturbances=(), check_gains=False).run()
    if recording.outcome.status != "completed":
        return  # its runs will tell
    rate = rate_of(Subject.of(recording))
    if not rate.stable:
        times = 1.0 / rate.limit.min()
        what = f"learning at {times:.3g} times its largest rate" if times > 1 else "the leakage turns the weights over"
        raise ConfigError(what, why=f"spectral radius {rate.radius.max():.4g}", fix="lower F, G or beta")


# Constraints, and on how many runs of a study, evenly spread, each is judged.
CONSTRAINTS: tuple[tuple[Callable[[Loop], None], int], ...] = ((stable_when_sampled, 64), (learns_slowly_enough, 4))


def violations(plan: Plan) -> Iterator[str]:
    """Complaints about the gains of a study, one per run that breaks a constraint."""
    refused: set[int] = set()
    for constraint, most in CONSTRAINTS:
        for number in judged(plan, most):
            try:
                if number not in refused:
                    constraint(loop_of(Task.of(plan.row(number))))
            except ConfigError as error:
                refused.add(number)
                yield f"row {number}: {error.what}"


def judged(plan: Plan, most: int = CONSTRAINTS[0][1]) -> list[int]:
    """Runs on which gains are judged."""
    return sorted({int(i) for i in np.linspace(0, len(plan) - 1, min(most, len(plan)))})
