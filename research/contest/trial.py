"""A trial: one controller on one task, trained with every seed, then held out, frozen and learning; its results.

A result is one run as numbers: errors, torques, FVU, what it did on the held-out trajectories.
"""

from __future__ import annotations

import csv
import io
import math
import time as clock
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import msgspec
import numpy as np

from mmnn_pin.lab.psi.excitation import not_excited, signals_for, unknown
from mmnn_pin.lab.psi.held_out import START
from mmnn_pin.lab.psi.learner import Learner, LearnerStepper
from mmnn_pin.lab.psi.psi import fvu
from mmnn_pin.lab.psi.subject import finite_rows
from mmnn_pin.loop.batch import BatchRun, simulate_many
from mmnn_pin.loop.controller import findings_of
from mmnn_pin.loop.loop import Loop
from mmnn_pin.recording.recording import Recording, as_columns
from mmnn_pin.settings import finite
from mmnn_pin.signals import Array, Layout
from mmnn_pin.torque.controller import ControllerState

from .task import Task, frozen

ERRORS = ("true_pose_error", "true_e")
KEPT = (*ERRORS, "psi", "psi_hat", "motor_torque")  # of a training run
STEPS, REPEATS = 2000, 3  # control samples that are timed, and how often
LARGEST = 1e150  # error [m or rad]
Number = float | None
Progress = Callable[[float], None]


def require_errors(errors: dict[str, Number]) -> None:
    """ValueError for an error that is below 0, or so large that its square is no number."""
    for axis, value in errors.items():
        if value is not None and (value < 0.0 or LARGEST <= value < math.inf):
            raise ValueError(f"an error of {value:g} of {axis}")


class Tracking(msgspec.Struct, frozen=True):
    """How a held-out trajectory was followed.

    Attributes:
        outcome: How the run ended.
        rms: RMS error per axis after the first 0.5 s, None for a run that was lost [m, rad].
    """

    outcome: str
    rms: dict[str, Number]

    def __post_init__(self) -> None:
        require_errors(self.rms)


class TrialResult(msgspec.Struct, frozen=True, kw_only=True):
    """One run: a task, a controller, a seed. Errors are the true ones, by axis `x`, `y`, `phi` and joint.

    Attributes:
        task: Which task.
        controller: Which controller.
        seed: Which seed.
        outcome: How the training ended.
        ended: When [s].
        rms: RMS errors in the last window of the training, per axis [m, rad].
        peak: Largest errors there.
        peak_of_all: Largest errors of the whole training, the start included.
        effort: Time integral of the squared motor torques [N²m²s].
        torque: Largest torque asked of a motor over its limit.
        kick: The same in the first moments.
        online_fvu: FVU in the last window, mean over the components.
        online_worst: Of the worst component.
        frozen_fvu: With the final weights held fixed, mean over the components, on the worst held-out trajectory; None
            for weights that cannot be held fixed.
        frozen_worst: Of the worst component there.
        frozen_on: Per held-out trajectory, of the worst component.
        held_out: Held-out trajectory to "frozen" and "learning" to how it was followed.
        findings: What the controller's state showed at the end.
        since: When the last change of the task happened [s].
        curve: Mean squared error per window and axis.
    """

    task: str
    controller: str
    seed: int
    outcome: str
    ended: float
    rms: dict[str, Number]
    peak: dict[str, Number]
    peak_of_all: dict[str, Number]
    effort: Number
    torque: Number
    kick: Number
    online_fvu: Number
    online_worst: Number
    frozen_fvu: Number
    frozen_worst: Number
    frozen_on: dict[str, Number]
    held_out: dict[str, dict[str, Tracking]]
    findings: tuple[str, ...]
    since: float
    curve: list[list[float]]

    def __post_init__(self) -> None:
        require_errors(self.rms)
        if any(len(window) != len(self.rms) for window in self.curve):
            raise ValueError(f"a window of the curve of {self.controller} has not {len(self.rms)} axes")
        if any(value < 0.0 for window in self.curve for value in window):
            raise ValueError(f"the curve of {self.controller} has a squared error below 0")

    @property
    def completed(self) -> bool:
        """Whether the training reached its end."""
        return self.outcome == "completed"

    @property
    def not_excited(self) -> bool:
        """Whether a finding says that it was not excited."""
        return any("not excited" in text for text in self.findings)


class Trial(msgspec.Struct, frozen=True, rename={"results": "rows"}):
    """All results of one controller on one task; in files `results` is called `rows`.

    Attributes:
        fingerprint: Of all that decides them.
        step_time: Processor time of the controller's step [s]; None where it was not measured.
        results: One per seed.
    """

    fingerprint: str
    step_time: float | None
    results: list[TrialResult]


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
) -> tuple[Recording, list[BatchRun]]:
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
    runs = [BatchRun(recording.outcome, {}, dict(recording.final), recording)]
    if others:
        runs += simulate_many(
            others,
            keep={*KEPT, *signals_for(controller)},
            workers=workers,
            progress=lambda done, count: progress(share + (1 - share) * done / count),
        )
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


def state_after(task: Task, controller: Any, seed: int, run: BatchRun) -> Any:
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
    ways = ("learning",) if frozen(controller) is controller else ("frozen", "learning")
    places = list(product([i for i, state in enumerate(states) if state is not None], task.held_out, ways))
    every = [task.held_out_loop(controller, task.seeds[i], name, how == "learning") for i, name, how in places]
    loops = {place: loop for place, loop in zip(places, every, strict=True) if loop is not None}
    if not loops:
        return found
    runs = simulate_many(
        list(loops.values()),
        states=[states[i] for i, *_ in loops],
        keep=ERRORS,
        workers=workers,
        progress=lambda done, count: progress(done / count),
    )
    for (i, name, how), run in zip(loops, runs, strict=True):
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
    run: BatchRun,
    state: Any,
    trials: dict[str, dict[str, Tracking]],
    knowledge: bool,
) -> TrialResult:
    """The result of a run."""
    assert run.recording is not None
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
        frozen_fvu=finite(mean),
        frozen_worst=finite(worst),
        frozen_on={held: finite(values[1]) for held, values in known_of.items()},
        held_out=trials,
        findings=tuple(findings),
        since=task.since,
        **training_numbers(task, run.recording),
    )


def findings_after(task: Task, name: str, controller: Any, seed: int, run: BatchRun, state: Any) -> list[str]:
    """What the state shows at the end of a run, and whether the run excited the learner."""
    assert run.recording is not None
    loop = task.training(controller, seed)
    learner = Learner(controller, loop.context(), state, state, run.outcome.time, loop.believed)
    lacks = unknown(learner, finite_rows(run.recording, loop.layout))
    return [*findings_of(controller, state), *not_excited(name, lacks)]


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
    stepper = LearnerStepper(Learner(loop.controller, context, state, state, 0.0, loop.believed), state)
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


def base_of(numbers: dict[str, Number]) -> float:
    """Error of the base's position out of errors per axis [m]; nan without a base."""
    return math.hypot(*(nan(numbers.get(axis)) for axis in ("x", "y")))


def arm_of(numbers: dict[str, Number]) -> float:
    """Root of the mean squared error of the joints out of errors per axis [rad or m]; nan without an arm."""
    joints = [nan(value) for axis, value in numbers.items() if axis not in ("x", "y", "phi")]
    return math.sqrt(sum(value**2 for value in joints) / len(joints)) if joints else math.nan


def nan(value: Number) -> float:
    """A number that may be missing."""
    return math.nan if value is None else value


def middle(values: Sequence[float]) -> float:
    """Median; nan where a value is missing or there is none."""
    return math.nan if not values or any(map(math.isnan, values)) else median(values)


def errors_of(recording: Recording) -> tuple[tuple[str, ...], Array]:
    """Axes and their true errors (N, axes) [m, rad]."""
    names = [name for name in ERRORS if name in recording]
    labels = tuple(label for name in names for label in recording.labels(name))
    return labels, np.hstack([as_columns(recording[name]) for name in names])


def rms_of(axes: tuple[str, ...], errors: Array) -> dict[str, Number]:
    """RMS per axis; None without samples."""
    values = np.sqrt((errors**2).mean(axis=0)) if len(errors) else np.full(len(axes), np.nan)
    return {axis: finite(value) for axis, value in zip(axes, values, strict=True)}


def peak_of(axes: tuple[str, ...], errors: Array) -> dict[str, Number]:
    """Largest magnitude per axis; None without samples."""
    return {axis: finite(value) for axis, value in zip(axes, np.abs(errors).max(axis=0, initial=-np.inf), strict=True)}


def tracking(recording: Recording | None, status: str) -> Tracking:
    """How a held-out trajectory was followed."""
    if recording is None or not len(recording):
        return Tracking(status, {})
    axes, errors = errors_of(recording)
    if status != "completed":
        return Tracking(status, dict.fromkeys(axes))
    return Tracking(status, rms_of(axes, errors[recording.time >= START - 1e-9]))


def training_numbers(task: Task, recording: Recording) -> dict[str, Any]:
    """What a result says of its training run."""
    time, (axes, errors), contest = recording.time, errors_of(recording), task.contest
    window, period = task.experiment.windows[-1], recording.fact("control_period", float)
    late = (time >= window[0] - 1e-9) & (time < window[1] - 1e-9) & (recording.outcome.status == "completed")
    motors, limits = as_columns(recording["motor_torque"]), np.array(task.robot.facts()["effort_limits"], float)
    share = (np.abs(motors) / limits).max(axis=1)
    mean, worst = summary(fvu(as_columns(recording["psi"])[late], as_columns(recording["psi_hat"])[late]))
    per = max(1, round(contest.window / period))
    full = len(errors) // per
    squares = (errors[: full * per] ** 2).reshape(full, per, len(axes)).mean(axis=1)
    return {
        "rms": rms_of(axes, errors[late]),
        "peak": peak_of(axes, errors[late]),
        "peak_of_all": peak_of(axes, errors),
        "effort": finite(float((motors**2).sum() * period)),
        "torque": finite(share.max(initial=0.0)),
        "kick": finite(share[time < contest.start - 1e-9].max(initial=0.0)),
        "online_fvu": finite(mean),
        "online_worst": finite(worst),
        "curve": squares[np.isfinite(squares).all(axis=1)].tolist(),
    }


def summary(values: Array) -> tuple[float, float]:
    """Mean and worst of the components that have an FVU; nan where none has."""
    judged = values[np.isfinite(values)]
    return (float(judged.mean()), float(judged.max())) if len(judged) else (math.nan, math.nan)


def as_csv(results: Sequence[TrialResult]) -> str:
    """Results as a table, one line per run, a column per number; empty where there is none."""
    tables = [dict(flat("", as_json(result))) for result in results]
    text = io.StringIO()
    columns = list(dict.fromkeys(name for table in tables for name in table))
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(tables)
    return text.getvalue()


def flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """A value under its name; what is inside a table under `name.inner`."""
    if not isinstance(value, dict):
        yield name, "; ".join(value) if isinstance(value, list | tuple) else value
        return
    for inner, one in value.items():
        yield from flat(f"{name}.{inner}" if name else inner, one)


def as_json(result: TrialResult) -> dict[str, Any]:
    """A result for JSON: without its curve, with the errors of base, heading and arm."""
    table: dict[str, Any] = {k: v for k, v in msgspec.to_builtins(result).items() if k != "curve"}
    for word in ("rms", "peak"):
        numbers = getattr(result, word)
        table[f"{word}_base"], table[f"{word}_arm"] = finite(base_of(numbers)), finite(arm_of(numbers))
        table[f"{word}_heading"] = numbers.get("phi")
    return table
