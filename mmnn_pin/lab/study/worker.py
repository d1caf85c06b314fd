"""One run of a study, made wherever it is sent: in a thread, in a process, on another machine."""

from __future__ import annotations

import hashlib
import importlib.util
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import msgspec

import mmnn_pin

from ...errors import InputError, StudyError
from ...loop.batch import simulate
from ...loop.loop import Loop
from ...model.robot import Robot
from ...recording.recording import as_columns
from ...signals import Array
from ..experiments.controllers import EFFECTIVE
from ..experiments.experiment import Experiment
from .bundle import Bundle, load_once
from .plan import Row

STOP = threading.Event()  # set in a process whose runs are to end


@dataclass(frozen=True)
class Task:
    """What a worker is told of a run.

    Attributes:
        id: The row's number.
        experiment: Its experiment, of one controller.
        nominal: The experiment whose robot the controller is made for; None for the true one.
        code: Digest of the sources that made the study.
    """

    id: int
    experiment: Experiment
    nominal: Experiment | None
    code: str

    @classmethod
    def of(cls, row: Row) -> Task:
        """The task of a row."""
        return cls(row.id, row.experiment, row.nominal, code_digest())


@dataclass(frozen=True)
class Done:
    """What came of a run.

    Attributes:
        id: The row's number.
        status: Of its outcome, or "refused" (these settings cannot be run) or "failed" (a fault; it is run again).
        time: When it ended [s].
        signal: Signal that went first.
        message: One line for people.
        metrics: See `Reducer.result`.
        seconds: Wall-clock time that it took [s].
        host: Machine that ran it.
    """

    id: int
    status: str
    time: float = 0.0
    signal: str = ""
    message: str = ""
    metrics: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    host: str = ""


def run(task: Task, bundle: Bundle | None = None, stop: Callable[[], bool] | None = None) -> Done:
    """Make a run; whatever is wrong with it is part of the result.

    Args:
        task: The run.
        bundle: Files of its robot; None where they are on this machine.
        stop: Asked now and then; true ends the run as interrupted.

    Raises:
        StudyError: This worker has other sources, or lacks a package that the run needs.
    """
    require_worker(task)
    start = time.perf_counter()
    host = socket.gethostname()
    stop = stop or STOP.is_set
    try:
        found = simulate(loop_of(task, bundle, stop), None, task.experiment.windows, False, stop)
    except Exception as error:
        if stop():
            return Done(task.id, "interrupted", host=host)
        refused = isinstance(error, InputError)
        message = str(error) if refused else f"{type(error).__name__}: {error}"
        return Done(task.id, "refused" if refused else "failed", message=" ".join(message.split()), host=host)
    took, end = time.perf_counter() - start, found.outcome
    return Done(task.id, end.status, end.time, end.signal, end.message, found.metrics, took, host)


def loop_of(task: Task, bundle: Bundle | None = None, stop: Callable[[], bool] = STOP.is_set) -> Loop:
    """The closed loop of a run. Its gains are not judged: a loop that is unstable when sampled diverges, and counts.

    Raises:
        InputError: It cannot be made.
    """
    experiment = task.experiment
    (name,) = experiment.controllers
    robot, nominal = robots_of(task, bundle)
    gains = None
    if name in EFFECTIVE:  # PD at a learner's gain needs the learner's run
        learner = msgspec.structs.replace(experiment, controllers=(EFFECTIVE[name],))
        gains = effective_gain(replace(task, experiment=learner), bundle, stop)
    loop = experiment.loop(robot, experiment.controller(name, gains, nominal or robot))
    return replace(loop, nominal=nominal, check_gains=False)


def effective_gain(task: Task, bundle: Bundle | None, stop: Callable[[], bool]) -> Array:
    """The effective gain of a learner over its run, (samples, p)."""
    found = simulate(loop_of(task, bundle, stop), None, task.experiment.windows, True, stop)
    assert found.recording is not None
    return as_columns(found.recording["effective_gain"])


def robots_of(task: Task, bundle: Bundle | None) -> tuple[Robot, Robot | None]:
    """The true robot of a run, and the one that its controller is made for where it is another."""
    experiment = task.experiment
    robot = load_once(experiment.robot, experiment.overrides) if bundle is None else bundle.load()
    return experiment.made_true(robot), None if task.nominal is None else task.nominal.made_true(robot)


def require_worker(task: Task) -> None:
    """Refuse to run with other sources than the study's, or without a package that the run needs.

    Raises:
        StudyError: With the worker's machine.
    """
    here = socket.gethostname()
    if task.code != code_digest():
        fix = "install the same version of mmnn_pin on all machines"
        raise StudyError(f"the worker on {here} runs other code of mmnn_pin than this machine", fix=fix)
    if task.experiment.plant == "contact" and not has("mujoco"):
        what, fix = f"the worker on {here} has no mujoco", "pip install 'mmnn_pin[contact]' there"
        raise StudyError(what, why="the contact plant needs it", fix=fix)


@cache
def has(module: str) -> bool:
    """Whether a module is installed here."""
    return importlib.util.find_spec(module) is not None


@cache
def code_digest() -> str:
    """Hash of the package's sources."""
    found = hashlib.sha256()
    package = Path(mmnn_pin.__file__).parent
    for source in sorted(package.rglob("*.py")):
        found.update(str(source.relative_to(package)).encode() + b"\0" + source.read_bytes())
    return found.hexdigest()[:16]
