"""An experiment as data: robot, reference, gains, controllers, periods. Its TOML has exactly these keys."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from ...actuator import Actuator
from ...disturbance import Disturbance, require_in_time
from ...errors import ConfigError, InputError, UnknownName
from ...kinematic import Kinematic
from ...loop.before_run import Bounds, Start
from ...loop.loop import PLANTS, Loop
from ...model.base.overrides import Overrides
from ...model.loading import load_with
from ...model.robot import Robot
from ...plant.contact.floor import Contact
from ...reference import Trajectory
from ...safety import Safety
from ...sensing import Sensor
from ...settings import Settings, Timing
from ...signals import Array, Layout
from ...torque.adaptive_settings import Adapting, Predicting
from ...torque.composite import Replaying
from ...torque.concurrent import Concurrent
from ...torque.controller import CompiledController, Feedback, TorqueController, per_velocity
from ...torque.inputs import Inputs
from ...torque.kalman_settings import KalmanTables
from ...torque.neural_settings import OneLayer, Robust, TwoLayer
from .contest import Contest
from .controllers import CONTROLLERS, DEFAULT, EFFECTIVE, TWO_LAYERS, Learning, RobustOf
from .friction import Friction
from .inertia import effective_inertia
from .laws import resolved
from .nominal import Nominal
from .references import HeldOut, ReferenceTables
from .tolerance import Case, Tolerance

# Pictures that a run can write; `show.gallery` has them.
PLOTS = (
    *("errors", "torque", "psi", "gains", "path", "weights", "residuals", "step-times"),
    *("fvu", "frozen", "shares", "ranks", "lyapunov", "lyapunov-terms", "equality"),
    *("figure-4.2", "figure-4.3", "figure-4.4", "figure-5.3", "figure-5.4", "figure-5.5"),
)


class Experiment(Settings, frozen=True):
    """Everything that defines an experiment; see the bundled TOML files for commented examples.

    Args:
        title: One line for tables and plots.
        variant: Which reading of the experiment this is, where it has several files.
        robot: Bundled name or path.
        overrides: What is said about the robot, as in the file beside its URDF.
        masses: Factor on the true robot's inertias, one for all or one per joint with a body (`Robot.with_masses`).
        controllers: Controllers to run, names of `CONTROLLERS` or of `laws`; `FILE.py:Class` for a class of a user.
        seed: The one seed.
        windows: Intervals for the RMS errors [s]; one that a run does not reach has none, which a note says.
        weights_interval: Time between two records of the weights [s].
        plots: Pictures that a run writes, names of `PLOTS`. With figures of the thesis it is compared with the
            intervals of their axes, with `figure-5.5` also with the largest errors that chapter 5 prints.
        torque_limits: Show every motor's peak torque beside its effort limit in the table, not only what exceeds it.
        time: Periods and integrator.
        start: Start relative to the reference.
        bounds: Where a run counts as diverged.
        reference: The reference.
        kinematic: Gains of the kinematic layer.
        feedback: k1, k2.
        robust: Kz, ZB.
        robust_of: Kz, ZB of single learners.
        two_layer: The two-layer network.
        one_layer: The one-layer network.
        adaptive: The adaptive controller.
        prediction: The prediction error of `adaptive_composite`.
        concurrent: The concurrent learner.
        replay: The prediction error of `two_layer_composite`.
        nominal: The model that is wrong on purpose, for those that have one.
        laws: Controllers of a user by name: `law`, where the class is, and its settings.
        kalman: The linear learners.
        inputs: What the networks see.
        learning: Conventions and switches.
        friction: Friction of the true robot beside its URDF's.
        armature: Inertia of the arm's rotors, seen through their gears, one number or one per joint [kg m^2 or kg].
        sensor: What the sensors do to the truth.
        actuator: What the motors make of their commands.
        safety: A supervisor between controller and motors; without the table there is none.
        disturbances: What happens to the robot during a run.
        plant: "ideal", wheels that roll exactly, or "contact", wheels that may slip, in MuJoCo.
        contact: The floor of the contact plant.
        cases: Changes of this experiment, name to case; with them it runs once in each, with a verdict on every run.
        tolerance: What a case asks of its runs.
        contest: With it the cases are the tasks of a contest: runs are not judged one by one but compared.
        held_out: Held-out trajectories by name; without any one follows from the reference (see `proof.held_out`).

    Raises:
        UnknownName: A controller, a plot or a plant that does not exist.
        ConfigError: No controllers, or windows that are not intervals.
    """

    robot: str
    reference: ReferenceTables
    title: str = ""
    variant: str = ""
    overrides: Overrides = Overrides()
    masses: float | dict[str, float] = 1.0
    controllers: tuple[str, ...] = DEFAULT
    seed: int = 0
    windows: tuple[tuple[float, float], ...] = ((0.0, 1.0), (1.0, 5.0))
    weights_interval: float = 0.1
    plots: tuple[str, ...] = ("errors",)
    torque_limits: bool = False
    time: Timing = Timing()
    start: Start = Start()
    bounds: Bounds = Bounds()
    kinematic: Kinematic = Kinematic()
    feedback: Feedback = Feedback()
    robust: Robust = Robust()
    robust_of: RobustOf = RobustOf()
    two_layer: TwoLayer = TwoLayer()
    one_layer: OneLayer = OneLayer()
    adaptive: Adapting = Adapting()
    prediction: Predicting = Predicting()
    concurrent: Concurrent = Concurrent()
    replay: Replaying = Replaying()
    nominal: Nominal = Nominal()
    laws: dict[str, dict[str, Any]] = msgspec.field(default_factory=dict)
    kalman: KalmanTables = KalmanTables()
    inputs: Inputs = Inputs()
    learning: Learning = Learning()
    friction: Friction = Friction()
    armature: float | tuple[float, ...] = 0.0
    sensor: Sensor = Sensor()
    actuator: Actuator = Actuator()
    safety: Safety | None = None
    disturbances: tuple[Disturbance, ...] = ()
    plant: str = "ideal"
    contact: Contact = Contact()
    cases: dict[str, Case] = msgspec.field(default_factory=dict)
    tolerance: Tolerance = Tolerance()
    held_out: dict[str, HeldOut] = msgspec.field(default_factory=dict)
    contest: Contest | None = None

    def __post_init__(self) -> None:
        if not self.controllers:
            raise ConfigError("no controllers", fix=f"choose from: {', '.join(CONTROLLERS)}", key="controllers")
        controllers, laws = resolved(self.controllers, self.laws, CONTROLLERS)
        msgspec.structs.force_setattr(self, "controllers", controllers)
        msgspec.structs.force_setattr(self, "laws", laws)
        there = {**CONTROLLERS, **laws}
        for key, names, known in (("controller", self.controllers, there), ("plot", self.plots, PLOTS)):
            for name in names:
                if name not in known:
                    raise UnknownName(key, name, known, key=f"{key}s")
        if len(set(self.controllers)) < len(self.controllers):
            raise ConfigError("a controller appears twice", fix="name each once", key="controllers")
        if self.plant not in PLANTS:
            raise UnknownName("plant", self.plant, PLANTS, key="plant")
        if any(not 0 <= start < end < np.inf for start, end in self.windows):
            raise ConfigError(f"{self.windows}", fix="give intervals [start, end] in seconds", key="windows")
        if not 0 <= self.seed < 2**63:
            raise ConfigError(f"{self.seed}", fix="use an integer from 0 to 2^63 - 1", key="seed")
        if not (np.isfinite(self.weights_interval) and self.weights_interval > 0):
            raise ConfigError(f"{self.weights_interval} s", fix="use a number > 0", key="weights_interval")
        for name, held in self.held_out.items():
            if not 0 < held.duration < np.inf:
                fix = "use a finite number of seconds > 0"
                raise ConfigError(f"{held.duration} s", fix=fix, key=f"held_out.{name}.duration")
        require_in_time(self.disturbances, self.time.duration)

    def load_robot(self) -> Robot:
        """The true robot, with the experiment's masses and friction.

        Raises:
            RobotError: The URDF cannot be used.
            UnknownName: No such robot, or no such body.
        """
        return self.made_true(load_with(self.robot, self.overrides))

    def made_true(self, robot: Robot) -> Robot:
        """A robot as its file describes it, with the experiment's masses and friction.

        Raises:
            UnknownName: No such body.
            ConfigError: A factor or a coefficient that cannot be.
        """
        robot, f = robot.with_armature(self.armature), self.friction
        if self.masses != 1.0:
            try:
                robot = robot.with_masses(self.masses)
            except InputError as error:
                error.key = "masses"
                raise
        robot = robot.with_joint_friction(coulomb=f.coulomb, breakaway=f.breakaway, stribeck=f.stribeck)
        return robot.with_friction(per_velocity(f.base, f.arm, robot.layout, "friction"))

    def trajectory(self, layout: Layout, limits: tuple[Array, Array] | None = None) -> Trajectory:
        """The reference for a robot.

        Args:
            layout: Sizes of the robot.
            limits: Lower and upper limits of its arm joints, (n,) each; None for none.

        Raises:
            ConfigError: Unknown type or argument, or not one profile per arm joint.
            TrajectoryError: A path that the base cannot follow, or an argument out of range.
        """
        return self.reference.trajectory(layout, limits)

    def trajectory_of(self, robot: Robot) -> Trajectory:
        """The reference for a robot, within the limits of its joints; errors as in `trajectory`."""
        return self.trajectory(robot.layout, (robot.lower[robot.arm_index], robot.upper[robot.arm_index]))

    def held_out_of(self, robot: Robot, name: str) -> Trajectory:
        """A held-out trajectory for a robot; errors as in `trajectory`, with the keys of `held_out`."""
        given = self.held_out[name]
        tables = ReferenceTables(given.base, given.heading, given.arm)
        try:
            return msgspec.structs.replace(self, reference=tables).trajectory_of(robot)
        except InputError as error:
            error.key = (error.key or "reference").replace("reference", f"held_out.{name}", 1)
            error.fix = error.fix.replace("[reference.", f"[held_out.{name}.")
            raise

    def inertia(self, robot: Robot) -> Array | None:
        """Effective inertias along the reference, (p,); None when nothing is scaled by them."""
        if self.feedback.scaling == "none":
            return None
        return effective_inertia(robot, self.trajectory_of(robot), self.time.duration, self.time.control_period)

    def controller(
        self, name: str, gains: Array | None = None, robot: Robot | None = None
    ) -> CompiledController | TorqueController:
        """A controller by name; one of a user runs its file.

        Args:
            name: One of `CONTROLLERS` or of `laws`.
            gains: (samples, p) schedule of a PD at an effective gain.
            robot: The robot whose effective inertias scale the gains; needed when `feedback.scaling` is "inertia".

        Raises:
            ConfigError: Gains that are to be scaled, and no robot.
            InputError: A user's file or class that cannot be used.
        """
        from .new_controller import new_controller

        return new_controller(self, name, gains, robot)

    def network(self, name: str) -> TwoLayer | OneLayer:
        """The network of a learner that has one."""
        if name == "one_layer":
            return self.one_layer
        initial = TWO_LAYERS.get(name)
        return self.two_layer if initial is None else msgspec.structs.replace(self.two_layer, initial=initial)

    def robust_term(self, name: str) -> Robust:
        """Kz and ZB of a controller: its own, or the common ones."""
        return getattr(self.robust_of, "two_layer" if name.startswith("two_layer") else name, None) or self.robust

    def loop(self, robot: Robot, controller: CompiledController | TorqueController) -> Loop:
        """The closed loop of this experiment around one controller."""
        return Loop(
            robot=robot,
            trajectory=self.trajectory_of(robot),
            controller=controller,
            kinematic=self.kinematic,
            timing=self.time,
            start=self.start,
            bounds=self.bounds,
            sensor=self.sensor,
            actuator=self.actuator,
            safety=self.safety,
            disturbances=self.disturbances,
            seed=self.seed,
            weights_interval=self.weights_interval,
            check_gains=controller.name not in EFFECTIVE,
            plant=self.plant,
            contact=self.contact,
            within_limits=self.learning.within_limits,
        )

    def to_json(self) -> str:
        """The complete experiment with its defaults, as text (JSON) for a recording."""
        return msgspec.json.format(msgspec.json.encode(self), indent=2).decode()
