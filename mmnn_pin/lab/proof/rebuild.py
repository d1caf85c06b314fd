"""The learner of a recording, built again: from the settings that it tells, or from the experiment that it names.

Nothing of this runs code of a user: a law in plain Python is rebuilt only where its class is handed over.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from ...errors import RecordingError
from ...loop.controller import context_of
from ...model.regressor import Regressor
from ...model.robot import Robot
from ...recording.recording import Recording
from ...recording.run_file import encode
from ...signals import Array
from ...torque.adaptive import Adaptive
from ...torque.adaptive_settings import Adapting
from ...torque.composite import CompositeNetwork
from ...torque.controller import ControllerState, Feedback
from ...torque.inputs import Inputs
from ...torque.learning_law import LearningLaw
from ...torque.neural import Neural
from ...torque.neural_settings import OneLayer, Robust, TwoLayer
from ...torque.residual import Residual
from ..experiments.config import recorded_experiment
from ..experiments.controllers import CONTROLLERS, EFFECTIVE, KALMAN
from ..experiments.kalman import kalman_from_facts
from ..experiments.laws import GIVEN, known_law, with_settings
from .learner import Learner
from .networks import Networks

NETWORKS: dict[str, Any] = {
    **dict.fromkeys(("two_layer", "two_layer_zero", "two_layer_random"), TwoLayer),
    "one_layer": OneLayer,
}
PARTS: dict[str, Any] = {
    "feedback": Feedback,
    "robust": Robust | None,
    "inputs": Inputs,
    "inertia": tuple[float, ...] | None,
}


def recorded_learner(recording: Recording, robot: Robot) -> Learner | None:
    """The learner of a run; None where its controller learns nothing, or is none of this package's.

    Args:
        recording: The run.
        robot: Its robot.

    Raises:
        RecordingError: It is one, and the recording does not hold its settings or its weights.
        InputError: It needs a nominal robot that cannot be loaded.
    """
    controller = controller_of(recording, robot)
    if controller is None:
        return None
    seed = np.random.SeedSequence(int(recording.meta.get("seed", 0))).spawn(1)[0]
    period = float(recording.meta["control_period"])
    kept, rng = recording.meta.get("within_limits"), np.random.default_rng(seed)
    context = context_of(controller, robot, period, len(recording), rng, kept)
    start = controller.init(context)
    snapshots = recording.weights
    if "time" in snapshots and len(snapshots["time"]) and abs(snapshots["time"][0] - recording.time[0]) < period / 2:
        put(start, snapshots, 0)
    kind = Networks if isinstance(controller, Neural | Residual | CompositeNetwork) else Learner
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
    if name in NETWORKS:
        if not settings:
            what = f"the recording does not tell the settings of {name}"
            raise RecordingError(what, why="an older mmnn_pin wrote it", fix="run it again", file=recording.path)
        return networks_of(NETWORKS[name], settings)
    if name == "adaptive" and settings:
        return adaptive_of(settings, robot)
    if name in KALMAN and settings:
        return kalman_from_facts(name, settings, robot)
    if name not in CONTROLLERS or name in EFFECTIVE:
        return None
    return of_experiment(recording, robot, name, settings)


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


def networks_of(network: type[Any], settings: dict[str, Any]) -> Neural:
    """A controller with networks from the settings that `Neural.facts` gave."""
    rest = {k: v for k, v in settings.items() if k != "network"}
    rest = {k: msgspec.convert(v, PARTS[k]) if k in PARTS else v for k, v in rest.items()}
    return Neural(network=msgspec.convert(settings["network"], network), **rest)


def adaptive_of(settings: dict[str, Any], robot: Robot) -> Adaptive:
    """An adaptive controller from the settings that `Adaptive.facts` gave."""
    adapting, start = msgspec.convert(settings["adapting"], Adapting), np.array(settings["start"], float)
    nominal = start if adapting.initial == "nominal" else None
    feedback = msgspec.convert(settings["feedback"], Feedback)
    return Adaptive(Regressor.of(robot), feedback, adapting, nominal, bool(settings["learning"]))


def of_experiment(recording: Recording, robot: Robot, name: str, settings: dict[str, Any]) -> Any:
    """A controller as the recorded experiment makes it; None where it learns nothing, or without an experiment.

    Raises:
        RecordingError: The experiment makes another one than the recording tells of.
        InputError: It needs a nominal robot that cannot be loaded.
    """
    experiment = recorded_experiment(recording)
    if experiment is None:
        return None
    controller = experiment.controller(name, robot=robot)
    if not hasattr(controller, "learning"):
        return None
    if encode(controller.facts()) != encode(settings):
        what, why = f"the config of the recording does not give its {name}", "it tells of other settings"
        raise RecordingError(what, why=why, file=recording.path)
    return controller


def put(state: ControllerState, snapshots: dict[str, Array], k: int) -> None:
    """Write the k-th snapshot of the weights into a memory."""
    for name, values in snapshots.items():
        if name != "time":
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
