"""The list of all torque controllers: their classes, by name, and how they are described and drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .. import torque

# Properties of `controller.Told`.
MOTION, MACHINE, NOMINAL, PARAMETERS, DESCRIBED = "motion", "machine", "nominal", "parameters", "described"


@dataclass(frozen=True)
class Entry:
    """One controller; its module is imported when it is first used."""

    name: str  # its name in experiments, tables and recordings
    kind: str  # class of the controller, a name in `torque`
    settings: str  # class of its settings likewise, a table of an experiment; empty for none
    about: str  # what it is, in a line
    colour: str  # in plots
    dashes: tuple[float, ...] = ()  # in plots: lengths of dashes and gaps; empty for a line
    width: float = 1.4  # of its line
    told: tuple[str, ...] = ()  # what it is told of its robot, properties of `controller.Told`
    table: str = ""  # key path of its table; its name unless it says
    beside: tuple[str, ...] = ()  # names of controllers whose tables it takes before its own
    gain_of: str = ""  # the learner whose effective gain it takes; empty for all others
    oracle: bool = False  # whether it knows the true model
    thesis: bool = False  # whether it is a learner of the thesis
    baseline: bool = False  # whether an engineer has it without learning Psi: what a learner is compared with

    @property
    def key(self) -> str:
        """Key path of its table in an experiment."""
        return self.table or self.name

    def load(self) -> Any:
        """The class of the controller."""
        return getattr(torque, self.kind)

    def load_settings(self) -> Any:
        """The class of its settings; None for none."""
        return getattr(torque, self.settings) if self.settings else None


# fmt: off
ENTRIES = (
    Entry("two_layer", "Neural", "TwoLayer",
          "the thesis's two-layer network, both layers learn (3.39), (3.48)-(3.50)", "#0072B2", (), 1.8, thesis=True),
    Entry("two_layer_zero", "Neural", "TwoLayer",
          "the same with all weights from zero, whatever two_layer.initial says", "#0072B2", (), 1.8,
          table="two_layer", thesis=True),
    Entry("two_layer_random", "Neural", "TwoLayer", "the same with W = 0 and V random",
          "#CC79A7", (9, 1.5), 1.6, table="two_layer", thesis=True),
    Entry("one_layer", "Neural", "OneLayer",
          "one-layer Gaussian network of reference [9], its law reconstructed", "#D55E00", (5, 1.6), thesis=True),
    Entry("pd", "PD", "", "the feedback alone", "#000000", (1, 1.4), baseline=True),
    Entry("pd_gravity", "PDGravity", "", "PD and the gravity of the URDF, at the measured joints",
          "#4D4D4D", (4, 1.2, 1, 1.2), told=(MOTION, DESCRIBED), baseline=True),
    Entry("pid", "PID", "PIDSettings",
          "PD and its integral, which stops where a motor is at its limit", "#999999", (2, 1.2), baseline=True),
    Entry("feedforward", "Feedforward", "FeedforwardSettings",
          "the model of the URDF along the reference, friction where it states some, and an integral",
          "#3B6FD4", (7, 1.2, 1, 1.2), 1.6, told=(MOTION, DESCRIBED), baseline=True),
    Entry("time_delay", "TimeDelay", "TimeDelaySettings",
          "the disturbance of a moment ago: torque that was sent less inertia times acceleration", "#16A085",
          (6, 1, 1, 1, 1, 1), baseline=True),
    Entry("extended_state", "ExtendedState", "ExtendedStateSettings",
          "active disturbance rejection: an observer of velocity and disturbance", "#00838F", (4, 1.5, 2, 1.5),
          baseline=True),
    Entry("l1_adaptive", "L1Adaptive", "L1AdaptiveSettings",
          "L1 adaptive control: adapts within a sample, behind a low-pass", "#8D6E63", (2, 1.5, 4, 1.5), baseline=True),
    Entry("super_twisting", "SuperTwisting", "SuperTwistingSettings",
          "a sliding mode of second order, linear within a layer", "#B71C1C", (1, 1, 4, 1), baseline=True),
    Entry("pd_effective", "ScheduledPD", "",
          "PD at the effective gain of two_layer (or two_layer_zero): its gain without its network",
          "#56B4E9", (6, 1.5, 1, 1.5), 1.6, gain_of="two_layer"),
    Entry("pd_effective_one_layer", "ScheduledPD", "", "PD at the effective gain of one_layer",
          "#E69F00", (5, 1.2, 1, 1.2, 1, 1.2), 1.6, gain_of="one_layer"),
    Entry("adaptive", "Adaptive", "AdaptiveSettings",
          "Slotine-Li adaptive control: knows the kinematics, learns masses, inertias and friction",
          "#7F4F24", (3, 1), told=(MOTION, PARAMETERS)),
    Entry("adaptive_composite", "AdaptiveComposite", "AdaptiveCompositeSettings",
          "the same, which learns from filtered torque too: it knows the robot afterwards",
          "#B7950B", (8, 1.5, 3, 1.2), told=(MOTION, PARAMETERS), beside=("adaptive",)),
    Entry("concurrent", "Concurrent", "ConcurrentSettings",
          "knows the kinematics; a stack of chosen equations, so that knowledge outlasts the excitation",
          "#2E7D32", (5, 1), told=(MOTION, PARAMETERS)),
    Entry("two_layer_residual", "TwoLayerResidual", "TwoLayer",
          "a nominal model with wrong masses, and the two-layer network on the difference",
          "#5DADE2", (4, 1), told=(NOMINAL,), table="two_layer"),
    Entry("nominal", "ComputedTorque", "",
          "feedback and that nominal model, nothing learned: what two_layer_residual has to beat",
          "#7F8C8D", (1, 1), told=(NOMINAL,), baseline=True),
    Entry("kalman_regressor", "Kalman", "KalmanRegressorSettings",
          "knows the kinematics; least squares with a covariance on filtered torque",
          "#C0392B", (2, 1), told=(MACHINE, MOTION), table="kalman.regressor"),
    Entry("kalman_friction", "Kalman", "KalmanFrictionSettings",
          "the same with friction features learned offline, and a constant per velocity that changes",
          "#4A235A", (9, 1, 2, 1), told=(MACHINE, MOTION), table="kalman.friction"),
    Entry("kalman_bilinear", "Kalman", "KalmanBilinearSettings",
          "knows the form of the equations: random functions of the arm's joints, the same least squares",
          "#E0A800", (7, 1.5), told=(MACHINE,), table="kalman.bilinear"),
    Entry("kalman_features", "Kalman", "KalmanFeaturesSettings",
          "knows nothing: random functions of states and references, the same least squares",
          "#E84393", (3, 1.5, 1, 1.5), told=(MACHINE,), table="kalman.features"),
    Entry("kalman_residual", "Kalman", "KalmanResidualSettings",
          "a nominal model with wrong masses, and kalman_bilinear for the rest",
          "#FF7F50", (6, 1.5, 2, 1.5), told=(MACHINE, MOTION, PARAMETERS), table="kalman.residual"),
    Entry("learned", "LearnedFeedforward", "LearnedSettings",
          "feedforward and integral, and on top what filtered torque teaches, as far as it has predicted",
          "#8250D0", (16, 1.5), 1.8, told=(MOTION, DESCRIBED)),
    Entry("computed_torque", "ComputedTorque", "", "feedback and the true model: the oracle",
          "#009E73", (10, 2.5), oracle=True),
)
# fmt: on
CONTROLLERS = {entry.name: entry for entry in ENTRIES}
