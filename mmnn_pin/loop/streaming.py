"""An engine run to the end of its loop, block after block of samples, each handed to a sink whatever ends it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..model.robot import Robot
from ..recording.recording import Outcome
from ..safety import HAS_TRIPPED, TRIPPED, remarks, trip_of
from ..signals import SIGNALS, Array, Layout
from .engines import Engine
from .ordinary import OrdinaryLoop

if TYPE_CHECKING:
    from .loop import Loop


class Sink(Protocol):
    """What takes the rows of a run: a `Recorder`, or a `Reducer` that keeps only sums."""

    def append_block(self, rows: Array, step_times: Array) -> None:
        """Take rows (k, width) and the wall-clock time of each (k,) [s]."""

    def weights(self, time: float, arrays: Mapping[str, Array]) -> None:
        """Take a snapshot of the weights at a time [s]."""


def run_to_end(
    loop: Loop,
    engine: Engine,
    sink: Sink,
    first: int,
    progress: Callable[[float], None] | None,
    cancelled: Callable[[], bool],
) -> Outcome:
    """Run to the end, to divergence, to a trip or to an interruption; arguments as in `Loop.stream`."""
    state, k, h, samples = engine.state, first, loop.timing.control_period, loop.timing.samples
    every = max(1, round(loop.weights_interval / h))
    try:
        while k < samples:
            if k % every == 0 and (weights := loop.controller.weights(state)):
                sink.weights(k * h, weights)
            engine.counter[0] = 0
            try:
                bad = engine.advance(k, min(k + len(engine.rows), (k // every + 1) * every, samples))
            finally:
                done = int(engine.counter[0])
                sink.append_block(engine.rows[:done], engine.step_times[:done])
                k += done
            if bad == TRIPPED:
                break
            if bad >= 0:
                return diverged(engine.row, loop.robot.layout, bad, k * h, sink)
            if progress is not None:
                progress(k * h)
            if cancelled():
                return Outcome("interrupted", k * h, message=f"stopped at t = {k * h:g} s")
    except KeyboardInterrupt:
        return Outcome("interrupted", k * h, message="stopped by Ctrl-C")
    if weights := loop.controller.weights(state):
        sink.weights(k * h, weights)
    if engine.hardware is not None and engine.hardware.supervisor.on and engine.hardware.supervisor.state[HAS_TRIPPED]:
        return Outcome("tripped", *trip_of(engine.hardware.supervisor.state, loop.robot))
    return Outcome("completed", samples * h)


def with_remarks(outcome: Outcome, engine: Engine, robot: Robot) -> Outcome:
    """An outcome whose message also tells what supervisor and plant saw."""
    found = engine.plant.findings() if isinstance(engine, OrdinaryLoop) else []
    if engine.hardware is not None and engine.hardware.supervisor.on:
        found = remarks(engine.hardware.supervisor.state, robot, outcome.status) + found
    return replace(outcome, message="; ".join(text for text in (outcome.message, *found) if text))


def diverged(row: Array, layout: Layout, column: int, time: float, sink: Sink) -> Outcome:
    """Outcome of a run whose row went bad at a column; a row that is still finite is kept."""
    i = int(np.searchsorted(layout.offsets, column, side="right") - 1)
    signal, value = f"{SIGNALS[i][0]}[{column - layout.offsets[i]}]", row[column]
    if np.isfinite(row).all():
        sink.append_block(row[None], np.zeros(1))
    why = "left its bounds" if np.isfinite(value) else "is not finite"
    return Outcome("diverged", time, signal, f"{signal} {why} ({value:.3g}) at t = {time:g} s")
