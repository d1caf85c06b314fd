"""A trial: one controller on one task, trained with every seed, then held out, frozen and learning."""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ...loop.batch import Run, simulate_many
from ...loop.controller import findings_of
from ...loop.loop import Loop
from ...recording.recording import Recording
from ...signals import Array, Layout
from ...torque.controller import ControllerState
from ..proof.excitation import not_excited, signals_for, unknown
from ..proof.held_out import START
from ..proof.learner import Learner, Stepper
from ..proof.psi import fvu
from ..proof.subject import finite_rows
from .result import ERRORS, KEPT, Tracking, TrialResult, known, summary, tracking, training_numbers
from .task import Task, frozen

STEPS, REPEATS = 2000, 3  # control samples that are timed, and how often
Progress = Callable[[float], None]


class Stopped(Exception):
    """Ctrl-C: what was under way is dropped."""


def run_trial(
    task: Task, name: str, file: Path | None, workers: int | None, progress: Progress, knowledge: bool = True
) -> tuple[list[TrialResult], float]:
    """The results of one controller on one task, one per seed, and the processor time of its step [s].

    Args:
        task: The task.
        name: The controller.
        file: For the recording of the first seed; None keeps none.
        workers: Threads; None for one per core.
        progress: Called with the fraction done.
        knowledge: Whether the FVU with fixed weights and the time of the step are wanted; they cost half of the time.

    Raises:
        Stopped: Ctrl-C.
        RecordingError: The recording cannot be written.
    """
    controller = task.controller(name)
    first, runs = train(task, controller, file, workers, lambda f: progress(0.5 * f))
    states = [state_after(task, controller, seed, run) for seed, run in zip(task.seeds, runs, strict=True)]
    trials = follow_held_out(task, controller, states, workers, lambda f: progress(0.5 + 0.4 * f))
    results = []
    for i, (seed, run) in enumerate(zip(task.seeds, runs, strict=True)):
        results.append(result_of(task, name, controller, seed, run, states[i], trials[i], knowledge))
        progress(0.9 + 0.1 * (i + 1) / len(runs))
    return results, step_time(task.training(controller, task.seeds[0]), first) if knowledge else math.nan


def train(
    task: Task, controller: Any, file: Path | None, workers: int | None, progress: Progress
) -> tuple[Recording, list[Run]]:
    """Training runs of all seeds; that of the first is recorded whole."""
    config = msgspec.structs.replace(task.experiment, overrides=task.robot.overrides, cases={}).to_json()
    one, *others = (task.training(controller, seed) for seed in task.seeds)
    duration, share = one.timing.duration, 1 / len(task.seeds)
    recording = one.run(
        file,
        force=True,
        meta={"experiment": f"contest/{task.name}", "config": config},
        progress=lambda t: progress(share * t / duration),
    )
    require_going(recording.outcome.status)
    runs = [Run(recording.outcome, {}, dict(recording.final), recording)]
    if others:
        show = lambda done, count: progress(share + (1 - share) * done / count)  # noqa: E731
        keep = {*KEPT, *signals_for(controller)}
        runs += simulate_many(others, keep=keep, workers=workers, progress=show)
    for run in runs:
        require_going(run.outcome.status)
    return recording, runs


def require_going(status: str) -> None:
    """Stop where the user did.

    Raises:
        Stopped: They did.
    """
    if status == "interrupted":
        raise Stopped


def state_after(task: Task, controller: Any, seed: int, run: Run) -> Any:
    """The state at the end of a training run; None where it was lost or is not kept as numbers."""
    if run.outcome.status != "completed" or "controller_state" not in run.final:
        return None
    state = controller.init(task.training(controller, seed).context())
    if not isinstance(state, ControllerState) or not np.isfinite(run.final["controller_state"]).all():
        return None
    state.values[:] = run.final["controller_state"]
    return state


def follow_held_out(
    task: Task, controller: Any, states: list[Any], workers: int | None, progress: Progress
) -> list[dict[str, dict[str, Tracking]]]:
    """How the held-out trajectories were followed with every state, frozen and learning."""
    found: list[dict[str, dict[str, Tracking]]] = [{name: {} for name in task.held_out} for _ in states]
    loops: list[Loop] = []
    places = []
    ways = ("learning",) if frozen(controller) is controller else ("frozen", "learning")
    for i, (seed, state) in enumerate(zip(task.seeds, states, strict=True)):
        for name, how in product(task.held_out if state is not None else (), ways):
            loop = task.held_out_loop(controller, seed, name, how == "learning")
            if loop is not None:
                loops.append(loop)
                places.append((i, name, how))
    if loops:
        starts = [states[i] for i, *_ in places]
        show = lambda done, count: progress(done / count)  # noqa: E731
        runs = simulate_many(loops, states=starts, keep=ERRORS, workers=workers, progress=show)
        for (i, name, how), run in zip(places, runs, strict=True):
            require_going(run.outcome.status)
            found[i][name][how] = tracking(run.recording, run.outcome.status)
            if len(ways) == 1:  # nothing is learned, so both are one run
                found[i][name]["frozen"] = found[i][name][how]
    return found


def result_of(
    task: Task,
    name: str,
    controller: Any,
    seed: int,
    run: Run,
    state: Any,
    trials: dict[str, dict[str, Tracking]],
    knowledge: bool,
) -> TrialResult:
    """The result of a run."""
    assert run.recording is not None
    contest, window = task.contest, task.experiment.windows[-1]
    limits = np.array(task.robot.facts()["effort_limits"], float)
    numbers = training_numbers(run.recording, limits, window, contest.window, contest.start)
    judged = task.held_out if knowledge else ()
    known_of = {held: frozen_fvu(task, controller, seed, state, held) for held in judged}
    mean, worst = (largest([values[k] for values in known_of.values()]) for k in (0, 1))
    findings = findings_after(task, name, controller, seed, run, state) if state is not None else []
    return TrialResult(
        task=task.name,
        controller=name,
        seed=seed,
        outcome=run.outcome.status,
        ended=run.outcome.time,
        frozen_fvu=known(mean),
        frozen_worst=known(worst),
        frozen_on={held: known(values[0]) for held, values in known_of.items()},
        held_out=trials,
        findings=tuple(findings),
        since=task.since,
        **numbers,
    )


def findings_after(task: Task, name: str, controller: Any, seed: int, run: Run, state: Any) -> list[str]:
    """What the state shows at the end of a run, and whether the run excited the learner."""
    loop = task.training(controller, seed)
    learner = Learner(controller, loop.context(), state, state, run.outcome.time, loop.believed)
    assert run.recording is not None
    rows = finite_rows(run.recording, loop.layout)
    return [*findings_of(controller, state), *not_excited(name, unknown(learner, rows))]


def largest(values: list[float]) -> float:
    """Largest of some numbers; nan where one is missing, or all are."""
    return max(values) if values and all(map(math.isfinite, values)) else math.nan


def frozen_fvu(task: Task, controller: Any, seed: int, state: Any, held: str) -> tuple[float, float]:
    """FVU of fixed weights on a held-out trajectory, mean over the components and worst; nan where there is none."""
    loop = None if state is None else task.held_out_loop(controller, seed, held, False)
    if loop is None:
        return math.nan, math.nan
    layout, rows = Layout.of(task.robot.dimensions), task.rows[held]
    counts = rows[:, layout.where("time")][:, 0] >= START - 1e-9
    psi_hat = psi_hat_along(loop, layout, state.snapshot(), rows)
    return summary(fvu(rows[counts][:, layout.where("psi")], psi_hat[counts]))


def psi_hat_along(loop: Loop, layout: Layout, state: Any, rows: Array) -> Array:
    """Psi_hat of the controller of a loop, step by step along rows (N, width); (N, p) [N, N m].

    It is what the weights say, before the motors' limits take of it.

    Args:
        loop: Of the controller, which learns from the rows unless it is frozen.
        layout: Of the rows; they may lack what the loop's hardware adds.
        state: What it remembers, changed in place.
        rows: The rows; they are not changed.
    """
    context = replace(loop.context(), layout=layout)
    stepper = Stepper(Learner(loop.controller, context, state, state, 0.0, loop.believed), state)
    found = np.zeros((len(rows), layout.dof))
    for n, row in enumerate(rows):
        stepper.step(row)
        found[n] = stepper.known
    return found


def step_time(loop: Loop, recording: Recording) -> float:
    """Processor time of a control step of the controller alone, called from Python, least of several tries [s]."""
    rows: Array = finite_rows(recording, loop.layout)[:STEPS]
    if not len(rows):
        return math.nan
    took = []
    for _ in range(REPEATS):
        state = loop.controller.init(loop.context())
        begin = clock.thread_time()
        psi_hat_along(loop, loop.layout, state, rows)
        took.append(clock.thread_time() - begin)
    return min(took) / len(rows)
