"""The learner of a run, built again from its recording, and its steps over rows.

A controller stepped again over the rows of its run, each with the torque of the sample before it still in place, gives
the weights of every sample; with learning switched off it gives what fixed weights say of any rows. It is built from
the settings that the recording tells, or from the experiment that it names. Nothing of this runs code of a user: a law
in plain Python is rebuilt only where its class is handed over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import msgspec
import numpy as np

from ...compiled import compiled, copy_to
from ...errors import RecordingError
from ...kinematic import Kinematic
from ...loop.controller import context_of
from ...loop.sample import Torque, law_torque, settle, turn
from ...model.base.overrides import Overrides
from ...model.robot import Robot
from ...model.robots import bundled, extra
from ...recording.reading import AGAIN
from ...recording.recording import Recording
from ...recording.run_file import encode
from ...settings.arguments import shortly
from ...signals import Array, IntArray, Layout
from ...torque.controller import Context, ControllerState, Feedback
from ...torque.entries import CONTROLLERS
from ...torque.learning_law import LearningLaw
from ...torque.neural import Neural, channels
from ..experiments.config import named_files, recorded_experiment
from ..experiments.controllers import Granted, Nominal
from ..experiments.laws import GIVEN, known_law, with_settings

NAMES = {1: "base", 2: "arm"}  # of the networks
LONGEST = 10.0  # lag or way of a torque that a recording may tell [s]


@dataclass(frozen=True, eq=False)
class Learner:
    """A learner and its weights."""

    controller: Any  # its settings; one with a field `learning`
    context: Context  # what it is given before the run
    start: ControllerState  # its state before the first row
    end: ControllerState  # its state at the end, or the last one that is known
    end_time: float  # when that is [s]
    robot: Robot  # the robot whose model it adds, where it uses the loop's

    def frozen(self) -> Any:
        """The controller with its weights held fixed."""
        return replace(self.controller, learning=False)


class LearnerStepper:
    """A controller stepped over rows of a recording, one after the other; the rows are not changed.

    Args:
        learner: The learner.
        state: Its state, changed in place.
        learning: Off holds its weights fixed.

    Attributes:
        row: (width,) the row that was stepped last, as the controller left it.
        torque: The controller wired to it.
    """

    def __init__(self, learner: Learner, state: ControllerState, learning: bool = True) -> None:
        layout = learner.context.layout
        controller = learner.controller if learning else learner.frozen()
        self.state, self.row = state, layout.new_row()
        self._time, self._torque, self._at = layout.where("time").start, layout.where("torque"), layout.offsets
        self._steering = Kinematic().steering_of(learner.robot, learner.context.control_period)
        self.psi_hat, self._sent = self.row[layout.where("psi_hat")], np.zeros(layout.dof)
        self.torque = Torque(controller, learner.context, self.row, learner.robot, state)

    def step(self, row: Array) -> Array:
        """Output at a row (width,), a view (p,) that the next step overwrites; a learner learns from it."""
        self.row[:] = row
        self.psi_hat[:] = 0.0  # one that says nothing leaves it as it was
        self.row[self._torque] = self._sent  # a controller finds what was sent last
        turn(self.row, self._at, self.torque.limits, self._steering)
        self.torque.answer(float(row[self._time]))
        self._sent[:] = self.row[self._torque] = row[self._torque]
        self.torque.keep()
        return self.psi_hat

    def walk(self, rows: Array, every: int, found: Array) -> None:
        """Step over rows (N, width), and write what is known at every so many of them into `found`; compiled."""
        t = self.torque
        views = Walked(self.row, self.row[self._torque], self._torque.start, self._sent, self.psi_hat, self.known)
        walk(rows, every, found, views, t.at, t.limits, self._steering, t.controls, t.model, t.learner)

    @property
    def known(self) -> Array:
        """Psi_hat of the last step as the weights say it, before the motors' limits take of it, (p,), a view."""
        limits = self.torque.limits
        return self.psi_hat if limits is None else limits.asked

    def features(self) -> Array | None:
        """Features of the last step, which the weights multiply, (rows, k), a copy; None where it does not tell."""
        found = self.torque.features()
        return None if found is None else np.array(np.atleast_2d(found), float)


class Walked(NamedTuple):
    """Arrays of a `LearnerStepper`, for `walk`."""

    row: Array
    torque: Array
    start: int
    sent: Array
    psi_hat: Array
    known: Array


@compiled
def walk(  # noqa: PLR0913 - what `sample.law_torque` takes
    rows: Array,
    every: int,
    found: Array,
    views: Walked,
    at: IntArray,
    limits: Any,
    steering: Any,
    controls: Any,
    model: Any,
    learner: Any,
) -> None:
    """Do as `LearnerStepper.step` for all rows."""
    end = views.start + views.torque.size
    for n in range(rows.shape[0]):
        copy_to(rows[n], views.row)
        for i in range(views.psi_hat.size):
            views.psi_hat[i] = 0.0
        copy_to(views.sent, views.torque)
        turn(views.row, at, limits, steering)
        law_torque(controls, model, learner, limits, None, None)
        copy_to(rows[n, views.start : end], views.sent)
        copy_to(views.sent, views.torque)
        if learner is not None:
            settle(views.row, at, learner, controls.state)
        if n % every == 0:
            copy_to(views.known, found[n // every])


def frozen_psi_hat(learner: Learner, state: ControllerState, rows: Array, every: int = 1) -> Array:
    """Psi_hat of the weights of a state, held fixed, along rows (N, width): of every so many of them, (k, p) [N, N m].

    It is what they know: before the motors' limits take of it.
    """
    stepper = LearnerStepper(learner, state.snapshot(), learning=False)
    found = np.zeros((-(-len(rows) // every), learner.context.layout.dof))
    if stepper.torque.compiled:
        stepper.walk(np.ascontiguousarray(rows), every, found)
        return found
    for n, row in enumerate(rows):
        stepper.step(row)
        if n % every == 0:
            found[n // every] = stepper.known
    return found


@dataclass(frozen=True, eq=False)
class NetworkLearner(Learner):
    """A learner with a network for the base, one for the arm: the thesis's, or on a nominal model."""

    @property
    def own(self) -> Neural:
        """The thesis's controller in it."""
        found: Neural = self.controller.networks
        return found

    @property
    def networks(self) -> list[tuple[int, slice]]:
        """Number of every network (1 the base's, 2 the arm's) and its velocities."""
        layout = self.context.layout
        parts = {1: slice(0, layout.base), 2: slice(layout.base, layout.dof)}
        return [(i, parts[i]) for i, _ in channels(layout)]


@dataclass(frozen=True, eq=False)
class NetworkOutputs:
    """Inputs, hidden outputs and outputs of networks with fixed weights along rows."""

    psi_hat: Array  # (N, p) their output [N, N m]
    inputs: Array  # (N, nx) what they see
    activations: dict[int, Array]  # network to (N, h) hidden outputs


def seen(learner: NetworkLearner, state: ControllerState, rows: Array) -> NetworkOutputs:
    """Inputs and outputs of networks with the weights of a state, held fixed, along rows (N, width)."""
    stepper = LearnerStepper(learner, state.snapshot(), learning=False)
    psi_hat, inputs = np.zeros((len(rows), learner.context.layout.dof)), np.zeros((len(rows), state["x"].size))
    activations = {i: np.zeros((len(rows), state[f"sigma{i}"].size)) for i, _ in learner.networks}
    x, hidden = stepper.state["x"], {i: stepper.state[f"sigma{i}"] for i in activations}
    for k, row in enumerate(rows):
        psi_hat[k], inputs[k] = stepper.step(row), x
        for i, sigma in hidden.items():
            activations[i][k] = sigma
    return NetworkOutputs(psi_hat, inputs, activations)


def recorded_learner(recording: Recording, robot: Robot) -> Learner | None:
    """The learner of a run; None where its controller learns nothing, or is none of this package's.

    Args:
        recording: The run.
        robot: Its robot.

    Raises:
        RecordingError: It is one, and the recording does not hold its settings or its weights.
        InputError: It needs a nominal robot that cannot be loaded.
    """
    with recording.using("what it tells of its controller"):
        controller = controller_of(recording, robot)
    if controller is None:
        return None
    seed = np.random.SeedSequence(int(recording.meta.get("seed", 0))).spawn(1)[0]
    period = recording.fact("control_period", float)
    kept, rng = recording.meta.get("within_limits"), np.random.default_rng(seed)
    with recording.using("how long its torques were under way"):
        lag = np.array(recording.meta.get("lag", np.zeros(robot.dimensions.dof)), float).reshape(robot.dimensions.dof)
        way = float(recording.meta.get("way", 0.0))
        unseen = float(recording.meta.get("unseen", 0.0))
        if not all(0.0 <= each <= LONGEST for each in (*lag, way, unseen)):
            raise ValueError(f"{lag}, {way} and {unseen} s")
    with recording.using("the gains of its kinematic layer"):
        gains = msgspec.convert(recording.meta.get("kinematic", {}), Kinematic)
    layout, weights = Layout.of(robot.dimensions), gains.pose_weights(robot.dimensions)
    context = Context(layout, period, len(recording), rng, lag=lag, way=way, unseen=unseen, pose_weights=weights)
    context = context_of(controller, robot, context, kept)
    with recording.using("what it tells of its controller"):
        start = controller.init(context)
    snapshots = recording.weights
    if "time" in snapshots and len(snapshots["time"]) and abs(snapshots["time"][0] - recording.time[0]) < period / 2:
        put(start, snapshots, 0)
    kind = Learner if getattr(controller, "networks", None) is None else NetworkLearner
    return kind(controller, context, start, *last(recording, start), robot)


def controller_of(recording: Recording, robot: Robot) -> Any:
    """The learning controller of a run; None where it learns nothing, or is none of this package's.

    Raises:
        RecordingError: The recording does not hold its settings, or they do not give it.
        InputError: It needs a nominal robot that cannot be loaded.
    """
    name, settings = str(recording.meta.get("controller")), recording.meta.get("controller_settings") or {}
    if "law" in recording.meta:
        return law_of(recording, settings)
    entry = CONTROLLERS.get(name)
    if entry is None or entry.gain_of:
        return None
    kind = entry.load()
    found = kind.from_facts(name, settings, Granted(entry, robot, Nominal(), Overrides()))
    if found is None and (entry.thesis or (hasattr(kind, "learning") and not settings)):
        raise RecordingError(
            f"the recording does not tell the settings of {name}",
            why="an older mmnn_pin wrote it",
            fix="run it again",
            file=recording.path,
        )
    return of_experiment(recording, robot, name, settings) if found is None else found


def law_of(recording: Recording, settings: dict[str, Any]) -> LearningLaw | None:
    """A user's law, where its class is defined in this process; None where it is not, or where it is no law.

    Raises:
        InputError: The class does not take the recorded settings.
    """
    about = recording.meta["law"]
    kind = known_law(about["class"].rpartition(".")[2], about["sha256"]) if set(GIVEN) <= settings.keys() else None
    if kind is None:
        return None
    given = {"feedback": msgspec.convert(settings["feedback"], Feedback), "learning": bool(settings["learning"])}
    rest = {key: value for key, value in settings.items() if key not in GIVEN}
    return with_settings(kind, rest, f"laws.{recording.meta['controller']}", given)


def of_experiment(recording: Recording, robot: Robot, name: str, settings: dict[str, Any]) -> Any:
    """A controller as the recorded experiment makes it; None where it learns nothing, or without an experiment.

    Raises:
        RecordingError: The experiment makes another one than the recording tells of.
        InputError: It needs a nominal robot that cannot be loaded.
    """
    experiment = recorded_experiment(recording)
    if experiment is None:
        return None
    if (nominal := experiment.nominal.robot) and nominal not in bundled() | extra():
        why = f"its nominal robot is the file {shortly(nominal)}, which is not opened because a recording names it"
        raise RecordingError(f"the {name} of the recording cannot be made again", why=why, file=recording.path)
    if files := named_files(experiment):
        why = f"its config names the file {shortly(files[0])}, which is not opened because a recording names it"
        raise RecordingError(f"the {name} of the recording cannot be made again", why=why, file=recording.path)
    controller = experiment.controller(name, robot=robot)
    if not hasattr(controller, "learning"):
        return None
    if encode(controller.facts()) != encode(settings):
        raise RecordingError(
            f"the config of the recording does not give its {name}",
            why="it tells of other settings",
            file=recording.path,
        )
    return controller


def put(state: ControllerState, snapshots: dict[str, Array], k: int) -> None:
    """Write the k-th snapshot of the weights into a state.

    Raises:
        RecordingError: They are weights of another controller.
    """
    for name, values in snapshots.items():
        if name == "time":
            continue
        if state.shapes.get(name) != values.shape[1:]:
            why = f"{name} has the shape {values.shape[1:]}"
            raise RecordingError("its weights are those of another controller", why=why, fix=AGAIN)
        state[name] = values[k]


def last(recording: Recording, start: ControllerState) -> tuple[ControllerState, float]:
    """The last finite weights that a recording holds, and their time [s].

    Raises:
        RecordingError: There are none.
    """
    state, final = start.snapshot(), recording.final.get("controller_state")
    if final is not None and final.shape == state.values.shape and np.isfinite(final).all():
        state.values[:] = final
        return state, recording.outcome.time
    times = recording.weights.get("time", np.zeros(0))
    for k in reversed(range(len(times))):
        if all(np.isfinite(values[k]).all() for values in recording.weights.values()):
            put(state, recording.weights, k)
            return state, float(times[k])
    raise RecordingError(
        "the recording holds no weights", why="its run ended before", fix="run again", file=recording.path
    )
