"""Torque controllers: velocity command and measurement in, generalized torque out. This file is the list of them.

`controller` has the interface, `law` the step that all engines call. Every learner is one module, which has its
settings, its compiled law and its controller, one entry here, and its table in `lab.experiments.learner_tables`. By its
entry `run`, `judge`, the plots and research know it. CONTRIBUTING.md shows how to add one.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

# Properties of `controller.Told`.
MOTION, MACHINE, NOMINAL, PARAMETERS, DESCRIBED = "motion", "machine", "nominal", "parameters", "described"


@dataclass(frozen=True)
class Entry:
    """One controller; its module is imported when it is first used.

    Attributes:
        name: Its name in experiments, tables and recordings.
        place: `module:Class` of the controller, in this package.
        settings: `module:Class` of its settings, a table of an experiment; empty for none.
        about: What it is, in a line.
        colour: In plots.
        dashes: In plots: lengths of dashes and gaps; empty for a line.
        width: Of its line.
        told: What it is told of its robot, properties of `controller.Told`.
        table: Key path of its table; its name unless it says.
        beside: Names of controllers whose tables it takes before its own.
        gain_of: The learner whose effective gain it takes; empty for all others.
        oracle: Whether it knows the true model.
        thesis: Whether it is a learner of the thesis.
        baseline: Whether an engineer has it without learning Psi: what a learner is compared with.
    """

    name: str
    place: str
    settings: str
    about: str
    colour: str
    dashes: tuple[float, ...] = ()
    width: float = 1.4
    told: tuple[str, ...] = ()
    table: str = ""
    beside: tuple[str, ...] = ()
    gain_of: str = ""
    oracle: bool = False
    thesis: bool = False
    baseline: bool = False

    @property
    def key(self) -> str:
        """Key path of its table in an experiment."""
        return self.table or self.name

    def load(self) -> Any:
        """The class of the controller."""
        return found(self.place)

    def load_settings(self) -> Any:
        """The class of its settings; None for none."""
        return found(self.settings) if self.settings else None


def found(place: str) -> Any:
    """The object at a place `module:name` of this package."""
    module, _, name = place.partition(":")
    return getattr(import_module(f"{__name__}.{module}"), name)


# fmt: off
ENTRIES = (
    Entry("two_layer", "neural:Neural", "two_layer:TwoLayer",
          "the thesis's two-layer network, both layers learn (3.39), (3.48)-(3.50)", "#0072B2", (), 1.8, thesis=True),
    Entry("two_layer_zero", "neural:Neural", "two_layer:TwoLayer",
          "the same with all weights from zero, whatever two_layer.initial says", "#0072B2", (), 1.8,
          table="two_layer", thesis=True),
    Entry("two_layer_random", "neural:Neural", "two_layer:TwoLayer", "the same with W = 0 and V random",
          "#CC79A7", (9, 1.5), 1.6, table="two_layer", thesis=True),
    Entry("one_layer", "neural:Neural", "one_layer:OneLayer",
          "one-layer Gaussian network of reference [9], its law reconstructed", "#D55E00", (5, 1.6), thesis=True),
    Entry("pd", "model_based:PD", "", "the feedback alone", "#000000", (1, 1.4), baseline=True),
    Entry("pd_gravity", "classical:PDGravity", "", "PD and the gravity of the URDF, at the measured joints",
          "#4D4D4D", (4, 1.2, 1, 1.2), told=(MOTION, DESCRIBED), baseline=True),
    Entry("pid", "classical:PID", "classical:PIDSettings",
          "PD and its integral, which stops where a motor is at its limit", "#999999", (2, 1.2), baseline=True),
    Entry("pd_effective", "model_based:ScheduledPD", "",
          "PD at the effective gain of two_layer (or two_layer_zero): its gain without its network",
          "#56B4E9", (6, 1.5, 1, 1.5), 1.6, gain_of="two_layer"),
    Entry("pd_effective_one_layer", "model_based:ScheduledPD", "", "PD at the effective gain of one_layer",
          "#E69F00", (5, 1.2, 1, 1.2, 1, 1.2), 1.6, gain_of="one_layer"),
    Entry("adaptive", "adaptive:Adaptive", "adaptive:AdaptiveSettings",
          "Slotine-Li adaptive control: knows the kinematics, learns masses, inertias and friction",
          "#7F4F24", (3, 1), told=(MOTION, PARAMETERS)),
    Entry("adaptive_composite", "adaptive_composite:AdaptiveComposite", "adaptive_composite:AdaptiveCompositeSettings",
          "the same, which learns from filtered torque too: it knows the robot afterwards",
          "#B7950B", (8, 1.5, 3, 1.2), told=(MOTION, PARAMETERS), beside=("adaptive",)),
    Entry("concurrent", "concurrent:Concurrent", "concurrent:ConcurrentSettings",
          "knows the kinematics; a stack of chosen equations, so that knowledge outlasts the excitation",
          "#2E7D32", (5, 1), told=(MOTION, PARAMETERS)),
    Entry("two_layer_composite", "two_layer_composite:TwoLayerComposite",
          "two_layer_composite:TwoLayerCompositeSettings",
          "the two-layer network with the prediction error of filtered torque and kept samples",
          "#8E44AD", (11, 1.5), beside=("two_layer",)),
    Entry("two_layer_residual", "two_layer_residual:TwoLayerResidual", "two_layer:TwoLayer",
          "a nominal model with wrong masses, and the two-layer network on the difference",
          "#5DADE2", (4, 1), told=(NOMINAL,), table="two_layer"),
    Entry("nominal", "model_based:ComputedTorque", "",
          "feedback and that nominal model, nothing learned: what two_layer_residual has to beat",
          "#7F8C8D", (1, 1), told=(NOMINAL,), baseline=True),
    Entry("kalman_regressor", "kalman:Kalman", "kalman_settings:KalmanRegressorSettings",
          "knows the kinematics; least squares with a covariance on filtered torque",
          "#C0392B", (2, 1), told=(MACHINE, MOTION), table="kalman.regressor"),
    Entry("kalman_friction", "kalman:Kalman", "kalman_settings:KalmanFrictionSettings",
          "the same with friction features learned offline, and a constant per velocity that changes",
          "#4A235A", (9, 1, 2, 1), told=(MACHINE, MOTION), table="kalman.friction"),
    Entry("kalman_bilinear", "kalman:Kalman", "kalman_settings:KalmanBilinearSettings",
          "knows the form of the equations: random functions of the arm's joints, the same least squares",
          "#E0A800", (7, 1.5), told=(MACHINE,), table="kalman.bilinear"),
    Entry("kalman_features", "kalman:Kalman", "kalman_settings:KalmanFeaturesSettings",
          "knows nothing: random functions of states and references, the same least squares",
          "#E84393", (3, 1.5, 1, 1.5), told=(MACHINE,), table="kalman.features"),
    Entry("kalman_residual", "kalman:Kalman", "kalman_settings:KalmanResidualSettings",
          "a nominal model with wrong masses, and kalman_bilinear for the rest",
          "#FF7F50", (6, 1.5, 2, 1.5), told=(MACHINE, MOTION, PARAMETERS), table="kalman.residual"),
    Entry("disturbance_observer", "disturbance_observer:DisturbanceObserver",
          "disturbance_observer:DisturbanceObserverSettings",
          "knows nothing: one constant per velocity, learned as an integral action", "#16A085", (6, 1, 1, 1, 1, 1),
          baseline=True),
    Entry("computed_torque", "model_based:ComputedTorque", "", "feedback and the true model: the oracle",
          "#009E73", (10, 2.5), oracle=True),
)
# fmt: on
CONTROLLERS = {entry.name: entry for entry in ENTRIES}
