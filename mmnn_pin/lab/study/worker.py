"""Runs of a study, made wherever they are sent: in a thread, in a process, on another machine.

Some `Row`s go out and as many `JobResult`s come back. The robot's files travel beside them as a `Bundle`: the URDF, its
meshes, and what is declared about it. On the other side the meshes lie beside the URDF under names of their own, so
that no folder of the first machine needs to exist there.
"""

from __future__ import annotations

import atexit
import copy
import hashlib
import importlib
import importlib.util
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import msgspec
from lxml import etree

import mmnn_pin

from ...errors import InputError, StudyError
from ...loop.batch import Run, simulate
from ...loop.loop import Loop
from ...model.base.overrides import Overrides, folders_of, with_file
from ...model.loading import load_with
from ...model.robot import Robot
from ...model.robots import find
from ...model.urdf.packages import locate
from ...model.urdf.reading import read
from ...recording.recording import as_columns
from ...signals import Array
from ..experiments.controllers import EFFECTIVE
from ..experiments.experiment import Experiment

T = TypeVar("T")
STOP = threading.Event()  # set in a process whose runs are to end


@dataclass(frozen=True)
class Row:
    """One run of a study, as a worker gets it.

    Attributes:
        id: Its number, from 0.
        point: Number of its point of the factors.
        controller: Its controller.
        seed: Its seed.
        parameters: Factor to its value.
        experiment: The experiment, of this controller alone.
        nominal: The experiment whose robot the controller is made for; None for the true one.
        fingerprint: Hash of all that decides its numbers, but for the software.
        code: Digest of the sources that made the study.
    """

    id: int
    point: int
    controller: str
    seed: int
    parameters: dict[str, Any]
    experiment: Experiment
    nominal: Experiment | None
    fingerprint: str
    code: str


@dataclass(frozen=True)
class JobResult:
    """What a worker sends back.

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


def run(
    rows: Sequence[Row],
    bundle: Bundle | None = None,
    stop: Callable[[], bool] | None = None,
) -> list[JobResult]:
    """Make runs; whatever is wrong with one is part of its result.

    Args:
        rows: The runs.
        bundle: Files of their robot; None where they are on this machine.
        stop: Asked now and then; true ends the runs as interrupted.

    Raises:
        StudyError: This worker has other sources, or lacks a package that a run needs.
    """
    stop = stop or STOP.is_set
    loops, results, took = dict[int, Loop](), dict[int, JobResult](), list[float]()
    for i, row in enumerate(rows):
        require_worker(row)
        begun = time.perf_counter()
        made = tried(row, stop, partial(loop_of, row, bundle, stop))
        took.append(time.perf_counter() - begun)
        if isinstance(made, Loop):
            loops[i] = made
        else:
            results[i] = made
    results |= {i: run_alone(rows[i], loop, stop) for i, loop in loops.items()}
    return [replace(results[i], seconds=results[i].seconds + took[i]) for i in range(len(rows))]


def run_alone(row: Row, loop: Loop, stop: Callable[[], bool]) -> JobResult:
    """Make a run."""
    begun = time.perf_counter()
    ended = tried(row, stop, partial(simulate, loop, None, row.experiment.windows, False, stop))
    return ended if isinstance(ended, JobResult) else result_of(row, ended, time.perf_counter() - begun)


def tried(row: Row, stop: Callable[[], bool], make: Callable[[], T]) -> T | JobResult:
    """What a part of a run gives; the run's result where it fails, or is not begun any more."""
    host = socket.gethostname()
    try:
        return JobResult(row.id, "interrupted", host=host) if stop() else make()
    except Exception as error:
        if stop():
            return JobResult(row.id, "interrupted", host=host)
        refused = isinstance(error, InputError)
        message = str(error) if refused else f"{type(error).__name__}: {error}"
        return JobResult(row.id, "refused" if refused else "failed", message=" ".join(message.split()), host=host)


def result_of(row: Row, ended: Run, took: float) -> JobResult:
    """What is sent back of a run that took so long [s]."""
    end, host = ended.outcome, socket.gethostname()
    return JobResult(row.id, end.status, end.time, end.signal, end.message, ended.metrics, took, host)


def loop_of(row: Row, bundle: Bundle | None = None, stop: Callable[[], bool] = STOP.is_set) -> Loop:
    """The closed loop of a run. Its gains are not judged: a loop that is unstable when sampled diverges, and counts.

    Raises:
        InputError: It cannot be made.
    """
    experiment = row.experiment
    (name,) = experiment.controllers
    robot, nominal = robots_of(row, bundle)
    gains: Array | None = None
    if name in EFFECTIVE:  # PD at a learner's gain needs the learner's run
        learner = replace(row, experiment=msgspec.structs.replace(experiment, controllers=(EFFECTIVE[name],)))
        result = simulate(loop_of(learner, bundle, stop), None, experiment.windows, True, stop)
        assert result.recording is not None
        gains = as_columns(result.recording["effective_gain"])
    loop = experiment.loop(robot, experiment.controller(name, gains, nominal or robot))
    return replace(loop, nominal=nominal, check_gains=False)


def robots_of(row: Row, bundle: Bundle | None) -> tuple[Robot, Robot | None]:
    """The true robot of a run, and the one that its controller is made for where it is another."""
    experiment = row.experiment
    robot = load_once(experiment.robot, experiment.overrides) if bundle is None else bundle.load()
    return experiment.made_true(robot), None if row.nominal is None else row.nominal.made_true(robot)


@dataclass(frozen=True)
class Bundle:
    """The files of a robot.

    Attributes:
        urdf: File name of the URDF among the files.
        files: Relative name to content.
        overrides: What is stated about the robot, in the call and in the file beside its URDF; it names no folders.
    """

    urdf: str
    files: dict[str, bytes] = field(repr=False)
    overrides: Overrides

    @classmethod
    def of(cls, robot: str, overrides: Overrides) -> Bundle:
        """Files of a robot that loads; a mesh that is not there stays away.

        Raises:
            InputError: As `load`.
        """
        path = find(robot)
        overrides, _ = with_file(path, overrides)
        folders = folders_of(path, overrides)
        if overrides.controllers_file is not None:  # what it led to travels, not the file
            overrides = load_with(path, overrides).overrides
        root = copy.deepcopy(read(path, overrides.strict, folders, overrides.xacro).root)
        files: dict[str, bytes] = {}
        places: dict[str, str] = {}
        for element in root.iterfind("link/*/geometry/mesh"):
            name = element.get("filename", "")
            if name not in places:
                mesh = locate(name, path, folders).file
                places[name] = name if mesh is None else f"meshes/{len(files)}{mesh.suffix.lower()}"
                if mesh is not None:
                    files[places[name]] = mesh.read_bytes()
            element.set("filename", places[name])
        urdf = f"{path.stem}.urdf"  # of a xacro file what it expands to
        files[urdf] = etree.tostring(root, encoding="utf-8", xml_declaration=True)
        return cls(urdf, files, msgspec.structs.replace(overrides, package_dirs=(), xacro=()))

    @cached_property
    def digest(self) -> str:
        """Hash of all of it."""
        digest = hashlib.sha256(msgspec.json.encode(self.overrides))
        for name, content in sorted(self.files.items()):
            digest.update(f"\0{name}\0{len(content)}\0".encode() + content)
        return digest.hexdigest()

    def load(self) -> Robot:
        """The robot, loaded from a temporary folder of this process, once."""
        with _unpacking:
            if self.digest not in _folders:
                folder = Path(tempfile.mkdtemp(prefix="mmnn_pin-"))
                atexit.register(shutil.rmtree, folder, ignore_errors=True)
                for name, content in self.files.items():
                    (folder / name).parent.mkdir(exist_ok=True)
                    (folder / name).write_bytes(content)
                _folders[self.digest] = folder
        return load_once(str(_folders[self.digest] / self.urdf), self.overrides)


_unpacking = threading.Lock()
_folders: dict[str, Path] = {}


@lru_cache(maxsize=16)
def load_once(robot: str, overrides: Overrides) -> Robot:
    """`load_with`, remembered: a study makes thousands of robots from one file."""
    return load_with(robot, overrides)


def require_worker(row: Row) -> None:
    """Refuse to run with other sources than the study's, or without a package that the run needs.

    Raises:
        StudyError: With the worker's machine.
    """
    here = socket.gethostname()
    if row.code != code_digest():
        fix = "install the same version of mmnn_pin on all machines"
        raise StudyError(f"the worker on {here} runs other code of mmnn_pin than this machine", fix=fix)
    if row.experiment.plant == "contact" and importlib.util.find_spec("mujoco") is None:
        what, fix = f"the worker on {here} has no mujoco", "pip install 'mmnn_pin[contact]' there"
        raise StudyError(what, why="the contact plant needs it", fix=fix)


def optional(what: str, extra: str, *modules: str) -> ModuleType:
    """The first of some modules, which all have to be installed.

    Args:
        what: What cannot be done without them.
        extra: The extra of this package that installs them.
        modules: Their names.

    Raises:
        StudyError: One is not installed.
    """
    try:
        found = [importlib.import_module(name) for name in modules]
    except ModuleNotFoundError as error:
        raise StudyError(what, why=f"no {error.name}", fix=f"pip install 'mmnn_pin[{extra}]'") from None
    return found[0]


@cache
def code_digest() -> str:
    """Hash of the package's sources."""
    digest = hashlib.sha256()
    package = Path(mmnn_pin.__file__).parent
    for source in sorted(package.rglob("*.py")):
        digest.update(str(source.relative_to(package)).encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()[:16]
