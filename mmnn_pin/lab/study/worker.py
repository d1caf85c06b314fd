"""One run of a study, made wherever it is sent: in a thread, in a process, on another machine.

A `Job` goes out and a `JobResult` comes back. The robot's files travel beside it as a `Bundle`: the URDF, its meshes,
and what is declared about it. On the other side the meshes lie beside the URDF under names of their own, so that no
folder of the first machine needs to exist there.
"""

from __future__ import annotations

import atexit
import copy
import hashlib
import importlib.util
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache
from pathlib import Path

import msgspec
from lxml import etree

import mmnn_pin

from ...errors import InputError, StudyError
from ...loop.batch import simulate
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

STOP = threading.Event()  # set in a process whose runs are to end


@dataclass(frozen=True)
class Job:
    """What a worker gets of a run.

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


def run(job: Job, bundle: Bundle | None = None, stop: Callable[[], bool] | None = None) -> JobResult:
    """Make a run; whatever is wrong with it is part of the result.

    Args:
        job: The run.
        bundle: Files of its robot; None where they are on this machine.
        stop: Asked now and then; true ends the run as interrupted.

    Raises:
        StudyError: This worker has other sources, or lacks a package that the run needs.
    """
    require_worker(job)
    start = time.perf_counter()
    host = socket.gethostname()
    stop = stop or STOP.is_set
    try:
        found = simulate(loop_of(job, bundle, stop), None, job.experiment.windows, False, stop)
    except Exception as error:
        if stop():
            return JobResult(job.id, "interrupted", host=host)
        refused = isinstance(error, InputError)
        message = str(error) if refused else f"{type(error).__name__}: {error}"
        return JobResult(job.id, "refused" if refused else "failed", message=" ".join(message.split()), host=host)
    took, end = time.perf_counter() - start, found.outcome
    return JobResult(job.id, end.status, end.time, end.signal, end.message, found.metrics, took, host)


def loop_of(job: Job, bundle: Bundle | None = None, stop: Callable[[], bool] = STOP.is_set) -> Loop:
    """The closed loop of a run. Its gains are not judged: a loop that is unstable when sampled diverges, and counts.

    Raises:
        InputError: It cannot be made.
    """
    experiment = job.experiment
    (name,) = experiment.controllers
    robot, nominal = robots_of(job, bundle)
    gains = None
    if name in EFFECTIVE:  # PD at a learner's gain needs the learner's run
        learner = msgspec.structs.replace(experiment, controllers=(EFFECTIVE[name],))
        gains = effective_gain(replace(job, experiment=learner), bundle, stop)
    loop = experiment.loop(robot, experiment.controller(name, gains, nominal or robot))
    return replace(loop, nominal=nominal, check_gains=False)


def effective_gain(job: Job, bundle: Bundle | None, stop: Callable[[], bool]) -> Array:
    """The effective gain of a learner over its run, (samples, p)."""
    found = simulate(loop_of(job, bundle, stop), None, job.experiment.windows, True, stop)
    assert found.recording is not None
    return as_columns(found.recording["effective_gain"])


def robots_of(job: Job, bundle: Bundle | None) -> tuple[Robot, Robot | None]:
    """The true robot of a run, and the one that its controller is made for where it is another."""
    experiment = job.experiment
    robot = load_once(experiment.robot, experiment.overrides) if bundle is None else bundle.load()
    return experiment.made_true(robot), None if job.nominal is None else job.nominal.made_true(robot)


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
        found = hashlib.sha256(msgspec.json.encode(self.overrides))
        for name, content in sorted(self.files.items()):
            found.update(f"\0{name}\0{len(content)}\0".encode() + content)
        return found.hexdigest()

    @property
    def size(self) -> int:
        """Bytes of its files."""
        return sum(map(len, self.files.values()))

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
def load_once(robot: str, said: Overrides) -> Robot:
    """`load_with`, remembered: a study makes thousands of robots from one file."""
    return load_with(robot, said)


def require_worker(job: Job) -> None:
    """Refuse to run with other sources than the study's, or without a package that the run needs.

    Raises:
        StudyError: With the worker's machine.
    """
    here = socket.gethostname()
    if job.code != code_digest():
        fix = "install the same version of mmnn_pin on all machines"
        raise StudyError(f"the worker on {here} runs other code of mmnn_pin than this machine", fix=fix)
    if job.experiment.plant == "contact" and not has("mujoco"):
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
