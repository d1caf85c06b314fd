"""A run as it goes: which samples come next, what is done with their rows, and how it ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..model.robot import Robot
from ..recording.recording import Outcome
from ..recording.schema import labels_of
from ..safety import TRIPPED, remarks, trip_of
from ..signals import SIGNALS, Array
from .compiled import CompiledLoop
from .interruption import no_interruption
from .ordinary import OrdinaryLoop
from .setup import Setup, Sink

Engine = CompiledLoop | OrdinaryLoop


def to_the_end(
    loop: Setup,
    every: int,
    engine: Engine,
    sink: Sink,
    first: int,
    progress: Callable[[float], None] | None,
    cancelled: Callable[[], bool],
) -> Outcome:
    """A run to its end, to divergence, to a trip or to an interruption.

    Args:
        loop: What runs.
        every: Samples between weights that are kept.
        engine: As in `Loop.stream`, like all that follow.
        sink: Likewise.
        first: Likewise.
        progress: Likewise.
        cancelled: Likewise.
    """
    state, k, h, samples = engine.state, first, loop.timing.control_period, loop.timing.samples
    try:
        while k < samples:
            if k % every == 0 and (weights := loop.controller.weights(state)):
                sink.weights(k * h, weights)
            engine.counter[0] = 0
            failure, bad = None, -1
            try:
                bad = engine.advance(k, min(k + len(engine.rows), (k // every + 1) * every, samples))
            except (Exception, KeyboardInterrupt) as error:
                failure = error
            with no_interruption():  # rows and time told agree
                done = int(engine.counter[0])
                sink.append_block(engine.rows[:done], engine.step_times[:done])
                k += done
            if failure is not None:
                raise failure
            if bad == TRIPPED:
                break
            if bad >= 0:
                return diverged(engine.row, loop, bad, k * h, sink)
            if progress is not None:
                progress(k * h)
            if cancelled():
                return Outcome("interrupted", k * h, message=f"stopped at t = {k * h:g} s")
    except KeyboardInterrupt:
        return Outcome("interrupted", k * h, message="stopped by Ctrl-C")
    if weights := loop.controller.weights(state):
        sink.weights(k * h, weights)
    supervisor = None if engine.hardware is None else engine.hardware.way.supervisor
    if supervisor is not None and supervisor.on and supervisor.state.tripped[0]:
        return Outcome("tripped", *trip_of(supervisor.state, loop.robot))
    return Outcome("completed", samples * h)


def with_remarks(outcome: Outcome, engine: Engine, robot: Robot) -> Outcome:
    """An outcome whose message also tells what supervisor and plant saw."""
    found = engine.plant.findings() if isinstance(engine, OrdinaryLoop) else []
    if engine.hardware is not None and engine.hardware.way.supervisor.on:
        found = remarks(engine.hardware.way.supervisor.state, robot, outcome.status) + found
    return replace(outcome, message="; ".join(text for text in (outcome.message, *found) if text))


def diverged(row: Array, loop: Setup, column: int, time: float, sink: Sink) -> Outcome:
    """Outcome of a run whose row went bad at a column; a row that is still finite is kept."""
    ends = loop.layout.offsets[: len(SIGNALS) + 1]
    i = int(np.searchsorted(ends[:-1], column, side="right") - 1)
    name, at, value = SIGNALS[i][0], int(column - ends[i]), row[column]
    if np.isfinite(row).all():
        sink.append_block(row[None], np.zeros(1))
    labels = labels_of(name, int(ends[i + 1] - ends[i]), loop.robot.facts())
    what = f"{name} of {labels[at]}" if labels[at:] and labels != (name,) else f"{name}[{at}]"
    why = "left its bounds" if np.isfinite(value) else "is not finite"
    return Outcome("diverged", time, f"{name}[{at}]", f"{what} {why} ({value:.3g}) at t = {time:g} s")
