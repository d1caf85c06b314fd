"""Controllers that learn the dynamics of nonholonomic mobile manipulators, checked against Pinocchio.

    reference -> kinematic -> torque -> safety -> actuator -> plant -> sensor -> (back)        closed by `loop`

- `model`: what the robot is. `load` a URDF: wheels found, M, C, gravity by Pinocchio, projected onto rolling wheels.
- `reference`: where it should be. `kinematic`: pose error to velocity command (Kanayama).
- `torque`: velocity command to torque: the thesis's networks, PD, computed torque, or a controller of your own.
- `safety`, `actuator`, `disturbance`: a supervisor, imperfect motors, and what the world does to a run.
- `plant`, `sensing`: the robot simulated and measured. `loop`: all of it, one row of signals per control sample.
- `recording`: one run. `lab`: what judges: experiments, studies, the proof, the contest, and what shows them.

The public names are loaded when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.3.0"

_HOME = {
    "model.loading": ("load",),
    "model.robot": ("Robot",),
    "model.dynamics": ("Dynamics",),
    "reference": ("Circle", "Eight", "Line", "Table", "Timed", "Trajectory", "Waypoints"),
    "reference.guide": ("Limits",),
    "reference.wishes": ("HOLD", "BaseVelocity", "JointGoal", "Motion"),
    "reference.hand": (
        *("Capsule", "FollowHand", "HandCircle", "HandLine", "HandMotion", "HandSpline", "Pieces", "Task", "Wait"),
        *("WholeBody", "WholeBodySettings"),
    ),
    "reference.trajectory": ("Hold", "MinimumJerk", "Sine", "Sines"),
    "kinematic": ("Kinematic",),
    "model.regressor": ("Regressor",),
    "torque.adaptive": ("Adaptive", "AdaptiveSettings"),
    "torque.adaptive_composite": ("AdaptiveComposite", "AdaptiveCompositeSettings"),
    "torque.concurrent": ("Concurrent", "ConcurrentSettings"),
    "torque.controller": ("Context", "ControllerState", "Feedback", "TorqueController"),
    "torque.kalman": (
        "Kalman",
        "KalmanBilinearSettings",
        "KalmanFeaturesSettings",
        "KalmanRegressorSettings",
        "KalmanResidualSettings",
    ),
    "torque.learning_law": ("LearningLaw", "Sample"),
    "torque.model_based": ("PD", "ComputedTorque", "ScheduledPD"),
    "torque.neural": ("Inputs", "Neural", "Robust"),
    "torque.one_layer": ("OneLayer",),
    "torque.two_layer": ("TwoLayer",),
    "torque.two_layer_composite": ("TwoLayerComposite", "TwoLayerCompositeSettings"),
    "torque.two_layer_residual": ("TwoLayerResidual",),
    "lab.experiments.controllers": ("machine_of",),
    "signals": ("Measurement", "Setpoint"),
    "actuator": ("Actuator",),
    "disturbance": ("Payload", "Push"),
    "safety": ("Safety",),
    "sensing": ("Sensor",),
    "settings": ("Timing",),
    "loop.loop": ("Loop",),
    "loop.stepper": ("Command", "Stepper"),
    "loop.before_run": ("Bounds", "Start"),
    "loop.batch": ("Run", "simulate_many"),
    "recording.recording": ("Outcome", "Recording"),
    "deploy.identify.identification": ("Identification", "identify"),
    "deploy.identify.log": ("Log",),
    "deploy.identify.payload": ("payload",),
    "deploy.identify.excitation": ("excite",),
    "lab.experiments.config": ("load_experiment",),
    "lab.experiments.runner": ("run_experiment",),
    "errors": ("InputError", "MmnnError"),
}
_WHERE = {name: module for module, names in _HOME.items() for name in names}

__all__ = sorted(["__version__", *_WHERE])


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'mmnn_pin' has no attribute '{name}'")
    return getattr(import_module(f"mmnn_pin.{_WHERE[name]}"), name)


def __dir__() -> list[str]:
    return __all__
