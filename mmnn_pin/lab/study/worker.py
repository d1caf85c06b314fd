"""One run of a study, made wherever it is sent: in this process, in another one, on another machine.

A `Trial` goes out and a `TrialResult` comes back. The robot's files travel beside it as a `Bundle`: the URDF, its
meshes, and what is declared about it. On the other side the meshes lie beside the URDF under names of their own, so
that no folder of the first machine needs to exist there.
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
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any

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
from ...recording.recording import Outcome, as_columns
from ...signals import Array
from ..experiments.controllers import EFFECTIVE
from ..experiments.experiment import Experiment
from .store import TrialResult


@dataclass(frozen=True)
class Trial:
    """One run of a study, as a worker gets it."""

    id: int  # its number, from 0
    point: int  # number of its point of the factors
    controller: str  # its controller
    seed: int  # its seed
    parameters: dict[str, Any]  # factor to its value
    experiment: Experiment  # the experiment, of this controller alone
    nominal: Experiment | None  # the experiment whose robot the controller is made for; None for the true one
    fingerprint: str  # hash of all that decides its numbers, but for the software
    code: str  # digest of the sources that made the study

    def result(self, status: Any, **more: Any) -> TrialResult:
        """Its result, on this machine and at this time; arguments as in `TrialResult`."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        return TrialResult(
            **{name: getattr(self, name) for name in ("id", "point", "controller", "seed", "parameters")},
            fingerprint=self.fingerprint, status=status, host=socket.gethostname(), finished=now, **more,
        )  # fmt: skip

    def ended(self, outcome: Outcome, metrics: dict[str, float], seconds: float = 0.0) -> TrialResult:
        """The result of a run that ended so."""
        how = {name: getattr(outcome, name) for name in ("status", "time", "signal", "message")}
        return self.result(**how, metrics=metrics, seconds=seconds)


def run(trial: Trial, bundle: Bundle | None = None) -> TrialResult:
    """Make a run; whatever is wrong with it is part of its result.

    Args:
        trial: The run.
        bundle: Files of its robot; None where they are on this machine.

    Raises:
        StudyError: This worker has other sources, or lacks a package that the run needs.
    """
    require_worker(trial)
    begun = time.perf_counter()
    try:
        ended = simulate(loop_of(trial, bundle), None, trial.experiment.windows, False, bool)
    except Exception as error:
        refused = isinstance(error, InputError)
        message = " ".join((str(error) if refused else f"{type(error).__name__}: {error}").split())
        return trial.result("refused" if refused else "failed", message=message, seconds=time.perf_counter() - begun)
    return trial.ended(ended.outcome, ended.metrics, time.perf_counter() - begun)


def loop_of(trial: Trial, bundle: Bundle | None = None) -> Loop:
    """The closed loop of a run. Its gains are not judged: a loop that is unstable when sampled diverges, and counts.

    Raises:
        InputError: It cannot be made.
    """
    experiment = trial.experiment
    (name,) = experiment.controllers
    robot, nominal = robots_of(trial, bundle)
    gains: Array | None = None
    if name in EFFECTIVE:  # PD at a learner's gain needs the learner's run
        learner = replace(trial, experiment=msgspec.structs.replace(experiment, controllers=(EFFECTIVE[name],)))
        result = simulate(loop_of(learner, bundle), None, experiment.windows, True, bool)
        assert result.recording is not None
        gains = as_columns(result.recording["effective_gain"])
    loop = experiment.loop(robot, experiment.controller(name, gains, nominal or robot))
    return replace(loop, nominal=nominal, check_gains=False)


def robots_of(trial: Trial, bundle: Bundle | None) -> tuple[Robot, Robot | None]:
    """The true robot of a run, and the one that its controller is made for where it is another."""
    experiment = trial.experiment
    robot = load_once(experiment.robot, experiment.overrides) if bundle is None else bundle.load()
    return experiment.made_true(robot), None if trial.nominal is None else trial.nominal.made_true(robot)


@dataclass(frozen=True)
class Bundle:
    """The files of a robot."""

    urdf: str  # file name of the URDF among the files
    files: dict[str, bytes] = field(repr=False)  # relative name to content
    # what is stated about the robot, in the call and in the file beside its URDF; it names no folders
    overrides: Overrides

    @classmethod
    def of(cls, robot: str, overrides: Overrides) -> Bundle:
        """Files of a robot that loads; a mesh that is not there stays away; errors as of `load`."""
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


def require_worker(trial: Trial) -> None:
    """Refuse to run with other sources than the study's, or without a package that the run needs (`StudyError`)."""
    here = socket.gethostname()
    if trial.code != code_digest():
        fix = "install the same version of mmnn_pin on all machines"
        raise StudyError(f"the worker on {here} runs other code of mmnn_pin than this machine", fix=fix)
    if trial.experiment.plant == "contact" and importlib.util.find_spec("mujoco") is None:
        what, fix = f"the worker on {here} has no mujoco", "pip install 'mmnn_pin[contact]' there"
        raise StudyError(what, why="the contact plant needs it", fix=fix)


@cache
def code_digest() -> str:
    """Hash of the package's sources."""
    digest = hashlib.sha256()
    package = Path(mmnn_pin.__file__).parent
    for source in sorted(package.rglob("*.py")):
        digest.update(str(source.relative_to(package)).encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()[:16]
