"""Many runs on all cores, with the bits that each has alone.

Threads share the compiled code, which runs without the interpreter's lock; what is Python between the blocks of samples
(a run's settings, its blocks' memory, its metrics) waits for it.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..compiled import one_thread
from ..errors import ConfigError, keyed
from ..recording.metrics import Reducer, Windows
from ..recording.recorder import Recorder, known
from ..recording.recording import Outcome, Recording
from ..settings.arguments import checked
from ..signals import Array
from .controller import with_findings
from .interruption import no_interruption
from .loop import Loop
from .setup import Sink


@dataclass(frozen=True)
class BatchRun:
    """One run of a batch.

    Attributes:
        outcome: How it ended; `interrupted` at 0 s for a run that was not started before Ctrl-C.
        metrics: Numbers of the run, see `Reducer.result`; empty if it was not started.
        final: Position, nu and the states of controller and hardware at the end.
        recording: The signals, where they were asked for.
    """

    outcome: Outcome
    metrics: dict[str, float]
    final: dict[str, Array]
    recording: Recording | None = None


LOOK = 0.2  # between looks whether Ctrl-C was pressed [s]
NOT_STARTED = BatchRun(Outcome("interrupted", 0.0, message="not started"), {}, {})


@one_thread
@checked
def simulate_many(
    loops: Sequence[Loop],
    *,
    states: Sequence[Any] | None = None,
    windows: Windows = ((0.0, 1.0), (1.0, 5.0)),
    keep: bool | str | Collection[str] = False,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[BatchRun]:
    """Run many loops, each with its own robot, gains, seed, reference or weights, on all cores.

    Vary a loop with `dataclasses.replace(loop, seed=...)`, a robot with `robot.with_masses` and `robot.with_friction`.
    Signals are reduced to metrics as they come. A run that diverges is a result; gains are not judged beforehand.
    Ctrl-C ends the runs in flight and gives back what is done.

    Args:
        loops: What to run.
        states: Controllers' states to start from, one per loop; None for new ones.
        windows: Intervals for the RMS errors [s].
        keep: Keep the signals of all runs in memory: True for all of them, or the names of some, as
            `keep=("z", "e")`; `time` comes with them, and the weights at the start and the end.
        workers: Threads; by default one per core.
        progress: Called with the number of runs done and of all runs.

    Raises:
        ConfigError: No runs, not one state per run or one of another controller, less than one worker, or more memory
            needed than there is; before anything runs.
        UnknownName: A signal to keep that does not exist.
    """
    workers = (os.cpu_count() or 1) if workers is None else workers
    keep = (keep,) if isinstance(keep, str) else keep
    starts = [None] * len(loops) if states is None else states
    require_sound(loops, starts, keep, workers)
    stopped, results = threading.Event(), [NOT_STARTED] * len(loops)

    def one(i: int) -> None:
        if stopped.is_set():
            return
        with keyed(lambda inside: ".".join(filter(None, (f"loops[{i}]", inside)))):
            results[i] = simulate(loops[i], starts[i], windows, keep, stopped.is_set)

    def told(done: int) -> None:
        if progress is not None:
            progress(done, len(loops))

    try:
        one(0)  # it compiles, or loads what is compiled, before others compete for it
        told(1)
        if results[0].outcome.status == "interrupted":
            return results
        with ThreadPoolExecutor(workers) as pool, no_interruption() as pressed:
            try:
                pending: set[Future[None]] = {pool.submit(one, i) for i in range(1, len(loops))}
                while pending and not pressed:
                    finished, pending = wait(pending, LOOK, FIRST_COMPLETED)
                    for future in finished:
                        future.result()
                    if finished:
                        told(len(loops) - len(pending))
            finally:
                stopped.set()
                pool.shutdown(cancel_futures=True)
    except KeyboardInterrupt:
        stopped.set()
    return results


def require_sound(
    loops: Sequence[Loop], states: Sequence[Any], keep: bool | str | Collection[str], workers: int
) -> None:
    """Refuse a batch that cannot be run; arguments as in `simulate_many`.

    Raises:
        ConfigError: No runs, not one state per run, no worker, a state that does not fit, too little memory.
        UnknownName: A signal to keep that does not exist.
    """
    if not loops:
        raise ConfigError("no runs", fix="give at least one loop")
    if len(states) != len(loops):
        raise ConfigError(f"{len(states)} states for {len(loops)} runs", fix="give one per run")
    if workers < 1:
        raise ConfigError(f"{workers} workers", fix="use at least one")
    if not isinstance(keep, bool):
        known(keep)
    require_memory(needed_bytes(loops, keep, workers))
    require_fit(loops, states)


def simulate(
    loop: Loop, state: Any, windows: Windows, keep: bool | str | Collection[str], cancelled: Callable[[], bool]
) -> BatchRun:
    """One run, reduced to its metrics as it goes.

    Args:
        loop: What runs.
        state: The controller's state to start from; None for a new one.
        windows: As in `simulate_many`.
        keep: Likewise.
        cancelled: Asked after every block of samples; true ends the run as interrupted.
    """
    if keep is not True:
        loop = replace(loop, weights_interval=loop.timing.duration)  # nobody reads the weights on the way
    engine = loop.engine_at(state)
    names = {"velocity_names": loop.robot.velocity_names, "actuator_names": loop.robot.actuator_names}
    reducer = Reducer.of(loop.layout, names | {"control_period": loop.timing.control_period}, windows)
    recorder, sink = None, cast(Sink, reducer)
    if keep is not False:
        facts = loop.facts() | {"loop": engine.name}
        recorder = Recorder(loop.layout, facts, signals=None if keep is True else keep)
        sink = Both(reducer, recorder)
    outcome = with_findings(loop.stream(engine, sink, cancelled=cancelled), loop.controller, engine.state)
    final = loop.final(engine)
    return BatchRun(outcome, reducer.result(), final, None if recorder is None else recorder.finish(outcome, final))


@dataclass(frozen=True)
class Both:
    """A sink that feeds two others."""

    reducer: Reducer
    recorder: Recorder

    def append_block(self, rows: Array, step_times: Array) -> None:
        """Rows to both."""
        self.reducer.append_block(rows)
        self.recorder.append_block(rows, step_times)

    def weights(self, time: float, arrays: Any) -> None:
        """Weights to the recorder."""
        self.recorder.weights(time, arrays)


def require_fit(loops: Sequence[Loop], states: Sequence[Any]) -> None:
    """Refuse states that do not belong to their loop's controller (`ConfigError`)."""
    for i, (loop, state) in enumerate(zip(loops, states, strict=True)):
        if state is not None:
            try:
                loop.state_from(state)
            except ConfigError as error:
                raise error.but(key=f"states[{i}]") from error


def needed_bytes(loops: Sequence[Loop], keep: bool | str | Collection[str], workers: int) -> int:
    """Memory that signals, weights and references take [bytes]; reading a recording's signals copies them once more."""
    in_flight = sum(sorted(8 * loop.timing.samples * loop.layout.width for loop in loops)[-workers:])
    return in_flight + 8 * sum(kept_numbers(loop, keep) for loop in loops)


def kept_numbers(loop: Loop, keep: bool | str | Collection[str]) -> int:
    """How many numbers are kept of a run."""
    layout = loop.layout
    if isinstance(keep, bool):
        return (loop.timing.samples * layout.width + recorded_weights(loop)) if keep else 0
    where = [layout.where(name) for name in {"time", *keep}]
    return loop.timing.samples * sum(columns.stop - columns.start for columns in where)


def recorded_weights(loop: Loop) -> int:
    """Number of weights that a recording of a run holds, over all its snapshots."""
    weights = loop.controller.weights(loop.controller.init(loop.context()))
    return (2 + int(loop.timing.duration / loop.weights_interval)) * sum(np.size(array) for array in weights.values())


def require_memory(needed: int) -> None:
    """Refuse what does not fit into the machine's free memory (`ConfigError`)."""
    free = free_bytes()
    if needed > free:
        raise ConfigError(
            f"the runs need {needed / 2**30:.3g} GiB, {free / 2**30:.3g} GiB are free",
            fix="run fewer at a time, shorten them, or do not keep their signals",
        )


def free_bytes() -> float:
    """Memory that programs can have, caches included; all the machine has, or inf, where that is not known [bytes]."""
    meminfo = Path("/proc/meminfo")
    for line in meminfo.read_text().splitlines() if meminfo.exists() else ():
        if line.startswith("MemAvailable:"):
            return 1024.0 * int(line.split()[1])
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return float("inf")
