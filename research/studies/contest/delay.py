"""What each controller of the contest's eight bears of a delay that nobody told it.

Commands reach the motors late; neither the lead of Psi_hat nor a learner's filtered torque knows. Everything else is
the contest's `eight`, without its held-out trajectories, with the first seed. One step of the plant is the least delay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from mmnn_pin.loop.batch import BatchRun, simulate_many
from mmnn_pin.loop.latency import Latency
from mmnn_pin.loop.loop import Loop
from research.contest.task import Task

DELAYS = (0.0, 0.001, 0.002, 0.003, 0.004, 0.005)  # of the commands [s]
LOST = 2.0  # times PD's error without delay


class Unaware(Loop):
    """A loop whose controller takes commands to be on time; the plant is as the loop's latency says."""

    @property
    def known(self) -> Latency:
        """None is known."""
        return Latency()


def late(task: Task, name: str, delay: float) -> Loop:
    """A controller's training run, its commands late by an untold delay [s]."""
    loop = task.training(task.controller(name), task.seeds[0])
    loop = replace(loop, latency=Latency(command=delay), check_gains=False)
    return Unaware(**{field.name: getattr(loop, field.name) for field in fields(loop)})


def errors_by_delay(task: Task, names: Sequence[str]) -> dict[str, list[list[float] | None]]:
    """Controller to its errors of base [mm] and arm [mrad] in the last window with each of `DELAYS`; None where lost.

    A run counts as lost if it diverges, or if one of its errors exceeds `LOST` times that of PD without delay.
    """
    names = ("pd", *(name for name in names if name != "pd"))
    loops = [late(task, name, delay) for name in names for delay in DELAYS]
    window = task.experiment.windows[-1]
    rows = [errors(run, loop, window) for run, loop in zip(simulate_many(loops, windows=(window,)), loops, strict=True)]
    bound, found = [LOST * error for error in rows[0]], {}
    for i, name in enumerate(names):
        each = rows[i * len(DELAYS) : (i + 1) * len(DELAYS)]
        found[name] = [row if all(a <= b for a, b in zip(row, bound, strict=True)) else None for row in each]
    return found


def errors(run: BatchRun, loop: Loop, window: tuple[float, float]) -> list[float]:
    """Errors of the base's place [mm] and of the arm [mrad] as in the contest's tables; inf for a lost run."""
    if run.outcome.status != "completed":
        return [math.inf, math.inf]
    suffix = f".rms_{window[0]:g}_{window[1]:g}"
    base = math.hypot(*(run.metrics[f"pose_error.{axis}{suffix}"] for axis in ("x", "y")))
    joints = [run.metrics[f"e.{name}{suffix}"] for name in loop.robot.velocity_names[loop.layout.base :]]
    return [1e3 * base, 1e3 * float(np.sqrt(np.mean(np.square(joints))))]
