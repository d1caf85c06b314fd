"""Controllers that learn the dynamics of nonholonomic mobile manipulators, checked against Pinocchio.

    reference -> kinematic -> torque -> safety -> actuator -> plant -> sensor -> (back)        closed by `loop`

Six things are enough to begin with: a robot (`load`), a `Trajectory`, controllers (`PD`, `Neural`, or their names), a
`Loop` around them, the `Recording` that it leaves, and an experiment (`compare`, or a file: `load_experiment`).

    >>> robot = load("platform_arm")
    >>> path = Trajectory.from_waypoints(robot, base=[(0, 0), (1, 0), (1, 1)])
    >>> runs = compare(robot, path, ["pd", "two_layer"], duration=0.4)
    >>> print(runs["pd"].summary())
    pd on platform_arm: completed at t = 0.4 s, 200 rows

The names here are those that most people need; they are loaded when first used. All others are in their modules:

- `mmnn_pin.model`: what the robot is; `model.dynamics`, `model.regressor`, `model.checks`.
- `mmnn_pin.reference`: where it should be: more paths and profiles, `reference.hand`, wishes of a joystick.
- `mmnn_pin.kinematic`, `mmnn_pin.torque`: pose error to velocity command to torque; a module for every controller.
- `mmnn_pin.safety`, `actuator`, `disturbance`, `sensing`, `plant`: the robot as it is, simulated.
- `mmnn_pin.loop`: one row of signals per control sample; `loop.batch` for thousands of runs.
- `mmnn_pin.recording`, `deploy`, `lab`: one run; out of the simulation; what judges and shows.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for editors and type checkers; a test holds it against HOME
    from .deploy.embed import embed
    from .deploy.identify.identification import identify
    from .errors import InputError
    from .lab.experiments.compare import compare
    from .lab.experiments.config import load_experiment
    from .lab.experiments.runner import run_experiment
    from .lab.proof.certified_run import prove
    from .lab.study.sweep import sweep
    from .loop.loop import Loop
    from .loop.stepper import Stepper, StepperSettings
    from .model.checks.properties import check
    from .model.loading import load
    from .model.robot import Robot
    from .recording.recording import Recording
    from .reference import Circle, Eight, Hold, Line, Sine, Trajectory
    from .settings import Timing
    from .signals import Measurement, Setpoint
    from .torque.controller import Feedback, TorqueController
    from .torque.learning_law import LearningLaw
    from .torque.model_based import PD
    from .torque.neural import Neural

__version__ = "0.3.0"

HOME = {
    "model.loading": ("load",),
    "model.robot": ("Robot",),
    "model.checks.properties": ("check",),
    "reference": ("Circle", "Eight", "Hold", "Line", "Sine", "Trajectory"),
    "torque.controller": ("Feedback", "TorqueController"),
    "torque.learning_law": ("LearningLaw",),
    "torque.model_based": ("PD",),
    "torque.neural": ("Neural",),
    "signals": ("Measurement", "Setpoint"),
    "settings": ("Timing",),
    "loop.loop": ("Loop",),
    "loop.stepper": ("Stepper", "StepperSettings"),
    "recording.recording": ("Recording",),
    "lab.experiments.compare": ("compare",),
    "lab.experiments.config": ("load_experiment",),
    "lab.experiments.runner": ("run_experiment",),
    "lab.study.sweep": ("sweep",),
    "lab.proof.certified_run": ("prove",),
    "deploy.identify.identification": ("identify",),
    "deploy.embed": ("embed",),
    "errors": ("InputError",),
}
WHERE = {name: module for module, names in HOME.items() for name in names}

__all__ = [
    "PD",
    "Circle",
    "Eight",
    "Feedback",
    "Hold",
    "InputError",
    "LearningLaw",
    "Line",
    "Loop",
    "Measurement",
    "Neural",
    "Recording",
    "Robot",
    "Setpoint",
    "Sine",
    "Stepper",
    "StepperSettings",
    "Timing",
    "TorqueController",
    "Trajectory",
    "check",
    "compare",
    "embed",
    "identify",
    "load",
    "load_experiment",
    "prove",
    "run_experiment",
    "sweep",
]


def __getattr__(name: str) -> Any:
    if name not in WHERE:
        raise AttributeError(f"module 'mmnn_pin' has no attribute '{name}'")
    return getattr(import_module(f"mmnn_pin.{WHERE[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
