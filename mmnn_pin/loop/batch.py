"""Many runs on all cores, with the bits that each has alone.

Threads share the compiled code, which runs without the interpreter's lock; what is Python between the samples (a run's
settings, its blocks' memory, its metrics) waits for it. Large batches on Linux therefore go to processes that are
forked from this one once it has the compiled code: they inherit loops and code, and give back what is left of a run.
Signals that are kept would have to be copied, so batches that keep some stay here.
"""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from ..compiled import one_thread
from ..errors import BatchError, ConfigError, InputError
from ..recording.metrics import Reducer, Windows
from ..recording.recorder import Recorder, known
from ..recording.recording import Outcome, Recording
from ..signals import Array
from ..torque.controller import CompiledController
from .controller import with_findings
from .forking import FORK, Flag, forks, leave_to
from .interruption import no_interruption
from .loop import Loop
from .setup import Sink
from .side_by_side import LANES, WARM, WORTH, Lanes, forms_of


@dataclass(frozen=True)
class Run:
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
NOT_STARTED = Run(Outcome("interrupted", 0.0, message="not started"), {}, {})


@one_thread
def simulate_many(
    loops: Sequence[Loop],
    *,
    states: Sequence[Any] | None = None,
    windows: Windows = ((0.0, 1.0), (1.0, 5.0)),
    keep: bool | Collection[str] = False,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Run]:
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
        workers: Threads or processes; by default one per core.
        progress: Called with the number of runs done and of all runs.

    Raises:
        ConfigError: No runs, not one state per run or one of another controller, less than one worker, or more memory
            needed than there is; before anything runs.
        BatchError: A process that made some of the runs was killed.
        UnknownName: A signal to keep that does not exist.
    """
    workers = (os.cpu_count() or 1) if workers is None else workers
    keep = (keep,) if isinstance(keep, str) else keep
    starts = [None] * len(loops) if states is None else states
    require_sound(loops, starts, keep, workers)
    groups = [[0], *groups_of(loops, range(1, len(loops)), workers)]
    forked = keep is False and forks(loops, min(workers, len(groups) - 2))
    work = Work(loops, starts, windows, keep, forked)
    results = [NOT_STARTED] * len(loops)
    here = groups[: 2 if forked else 1]  # they compile, or load what is compiled, before others compete for it
    done = 0

    def take(places: Sequence[int], runs: Sequence[Run]) -> int:
        for i, run in zip(places, runs, strict=True):
            results[i] = run
        return len(places)

    def told(done: int) -> int:
        if progress is not None:
            progress(done, len(loops))
        return done

    asked: dict[Future[list[Run]], list[int]] = {}
    try:
        for group in here:
            done = told(done + take(group, work.some(group)))
            if any(results[i].outcome.status == "interrupted" for i in group):
                return results
        rest = groups[len(here) :]
        with work.pool(max(1, min(workers, len(rest)))) as pool, no_interruption() as pressed:
            try:
                for group in rest:
                    asked[work.ask(pool, group)] = group
                pending = set(asked)
                while pending and not pressed:
                    finished, pending = wait(pending, LOOK, FIRST_COMPLETED)
                    done = told(done + sum(take(asked[future], future.result()) for future in finished))
            finally:
                work.end(pool)
    except KeyboardInterrupt:
        for future, group in asked.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                take(group, future.result())
    except BrokenProcessPool as error:
        why = "the system ends processes when memory runs out"
        raise BatchError("a process of the batch was killed", why=why, fix="use fewer workers, or keep less") from error
    return results


class Work:
    """What a batch's threads or processes do; arguments as in `simulate_many`.

    Args:
        forked: Whether processes do it; where they are forked from this one, they inherit the loops.
    """

    inherited: ClassVar[Work]  # by a forked process

    def __init__(
        self, loops: Sequence[Loop], states: Sequence[Any], windows: Windows, keep: bool | Collection[str], forked: bool
    ) -> None:
        self.loops, self.states, self.windows, self.keep, self.forked = loops, states, windows, keep, forked
        self.worth = sum(loop.timing.samples for loop in loops) >= WORTH
        self.stopped = Flag() if forked else threading.Event()
        self.parent = os.getpid()

    def some(self, places: Sequence[int]) -> list[Run]:
        """Make the runs of a group; those that are stopped before they begin, as such."""
        if self.stopped.is_set():
            return [NOT_STARTED] * len(places)
        started = [begun(f"loops[{i}]", self.loops[i], self.states[i], self.windows, self.keep) for i in places]
        return simulate_group(started, self.worth, self.stopped.is_set)

    def pool(self, workers: int) -> Executor:
        """Threads, or processes that are forked when they get the first work."""
        if not self.forked:
            return ThreadPoolExecutor(workers)
        return ProcessPoolExecutor(workers, mp_context=FORK, initializer=inherit, initargs=(self,))

    def end(self, pool: Executor) -> None:
        """End threads or processes, and wait for them."""
        self.stopped.set()
        pool.shutdown(cancel_futures=True)

    def ask(self, pool: Executor, places: Sequence[int]) -> Future[list[Run]]:
        """Have the runs of a group made."""
        if not self.forked:
            return pool.submit(self.some, places)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads that BLAS has, which rest
            return pool.submit(inherited_work, places)


def inherit(work: Work) -> None:
    """Begin a forked process."""
    leave_to(work.parent)
    Work.inherited = work


def inherited_work(places: Sequence[int]) -> list[Run]:
    """Runs of a group, in a forked process."""
    return Work.inherited.some(places)


def groups_of(loops: Sequence[Loop] | Mapping[int, Loop], places: Iterable[int], workers: int) -> list[list[int]]:
    """The places of runs that may go side by side, as many as there are lanes, and of all others one by one.

    Every worker has as many groups as the others, so that none waits for one that makes four runs alone.
    """
    alike: dict[Any, list[int]] = {}
    for i in places:
        loop = loops[i]
        compilable = loop.engine != "ordinary" and isinstance(loop.controller, CompiledController)
        if compilable and not loop.layout.hardware and loop.timing.samples > WARM:
            kind = (loop.timing, loop.layout, loop.weights_interval, type(loop.controller))
            alike.setdefault(kind, []).append(i)
    groups = [some[i : i + LANES] for some in alike.values() for i in range(0, len(some) - LANES + 1, LANES)]
    groups = sorted(groups)[: len(groups) - len(groups) % workers]
    grouped = {i for group in groups for i in group}
    return sorted([*groups, *([i] for i in places if i not in grouped)])


def require_sound(loops: Sequence[Loop], states: Sequence[Any], keep: bool | Collection[str], workers: int) -> None:
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
    loop: Loop, state: Any, windows: Windows, keep: bool | Collection[str], cancelled: Callable[[], bool]
) -> Run:
    """One run, reduced to its metrics as it goes; arguments as in `simulate_many`."""
    return Started(loop, state, windows, keep).alone(cancelled)


def begun(key: str, *arguments: Any) -> Started:
    """A run at its start; errors have its place among the runs as the beginning of their key."""
    try:
        return Started(*arguments)
    except InputError as error:
        error.key = ".".join(filter(None, (key, error.key)))
        raise


def simulate_group(runs: Sequence[Started], worth: bool, cancelled: Callable[[], bool]) -> list[Run]:
    """Runs of a group, side by side where they can go so.

    Args:
        runs: As `groups_of` puts them together.
        worth: Whether it is worth while to compile for them.
        cancelled: Asked now and then; true ends them as interrupted.
    """
    engines = [run.engine for run in runs]
    if (forms := forms_of(engines)) is None:
        return [run.alone(cancelled) for run in runs]
    return simulate_together(runs, Lanes(engines, forms, worth), cancelled)


def simulate_together(runs: Sequence[Started], lanes: Lanes, cancelled: Callable[[], bool]) -> list[Run]:
    """Runs of a group, block after block side by side; with the bits that they have alone.

    Args:
        runs: As many as there are lanes.
        lanes: Their engines.
        cancelled: Asked after every block; true ends them as interrupted.
    """
    results: dict[int, Run] = {}
    courses = [run.loop.course(run.engine, run.sink, cancelled=cancelled) for run in runs]
    answers: list[Any] = [None] * len(runs)
    every = runs[0].loop.samples_between_weights
    while len(results) < len(runs):
        asked = set()
        for i, course in enumerate(courses):
            if i not in results:
                try:
                    asked.add(next(course) if answers[i] is None else course.send(answers[i]))
                except StopIteration as end:
                    lanes.put_back()
                    results[i] = runs[i].ended(end.value)
        if asked:
            (samples,) = asked
            answers = list(lanes.advance(*samples))
            if samples[1] % every == 0 or samples[1] == runs[0].loop.timing.samples:
                lanes.put_back()  # their weights are asked for
    return [results[i] for i in range(len(runs))]


class Started:
    """A run of a batch at its start; arguments as in `simulate_many`."""

    def __init__(self, loop: Loop, state: Any, windows: Windows, keep: bool | Collection[str]) -> None:
        if keep is not True:
            loop = replace(loop, weights_interval=loop.timing.duration)  # nobody reads the weights on the way
        self.loop, self.engine = loop, loop.engine_at(state)
        names = {"velocity_names": loop.robot.velocity_names, "actuator_names": loop.robot.actuator_names}
        self.reducer = Reducer.of(loop.layout, names | {"control_period": loop.timing.control_period}, windows)
        self.recorder, self.sink = None, cast(Sink, self.reducer)
        if keep is not False:
            facts = loop.facts() | {"loop": self.engine.name}
            self.recorder = Recorder(loop.layout, facts, signals=None if keep is True else keep)
            self.sink = Both(self.reducer, self.recorder)

    def alone(self, cancelled: Callable[[], bool]) -> Run:
        """The run, made alone."""
        return self.ended(self.loop.stream(self.engine, self.sink, cancelled=cancelled))

    def ended(self, outcome: Outcome) -> Run:
        """The run, once it has ended."""
        outcome, final = with_findings(outcome, self.loop.controller, self.engine.state), self.loop.final(self.engine)
        recording = None if self.recorder is None else self.recorder.finish(outcome, final)
        return Run(outcome, self.reducer.result(), final, recording)


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
    """Refuse states that do not belong to their loop's controller.

    Raises:
        ConfigError: With the place of the state.
    """
    for i, (loop, state) in enumerate(zip(loops, states, strict=True)):
        if state is not None:
            try:
                loop.state_from(state)
            except ConfigError as error:
                error.key = f"states[{i}]"
                raise


def needed_bytes(loops: Sequence[Loop], keep: bool | Collection[str], workers: int) -> int:
    """Memory that signals, weights and references take [bytes]; reading a recording's signals copies them once more."""
    in_flight = sum(sorted(8 * loop.timing.samples * loop.layout.width for loop in loops)[-workers:])
    return in_flight + 8 * sum(kept_numbers(loop, keep) for loop in loops)


def kept_numbers(loop: Loop, keep: bool | Collection[str]) -> int:
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
    """Refuse what does not fit into the machine's free memory.

    Raises:
        ConfigError: With both numbers.
    """
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
