"""An experiment as data: robot, reference, gains, controllers, periods, cases.

Its TOML has exactly these keys.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from ...actuator import Actuator
from ...compliance import Force, Impedance
from ...disturbance import Disturbance, require_in_time
from ...errors import ConfigError, InputError, UnknownName, keyed
from ...kinematic import Kinematic
from ...loop.before_run import Bounds, Start
from ...loop.latency import Latency
from ...loop.loop import PLANTS, Loop
from ...loop.servo import Servo
from ...loop.suited import Fit, LoopToSuit, effective_inertia, fit, followable
from ...model.base.overrides import Overrides
from ...model.loading import load_with
from ...model.robot import Robot
from ...plant.contact.feet import Contact
from ...reference import Trajectory
from ...safety import Safety
from ...sensing import Sensor
from ...settings import Numbers, Settings, Timing, require_gains
from ...settings.arguments import faced
from ...signals import Array, Dimensions
from ...torque.controller import CompiledController, Feedback, TorqueController, per_velocity
from ...torque.neural import Inputs, Robust
from ...touch import Touch
from .controllers import CONTROLLERS, DEFAULT, EFFECTIVE, Learning, Nominal, RobustOf, new_controller
from .hand import hand_motion
from .hardware_table import HardwareTable
from .laws import resolved
from .learner_tables import LearnerTables
from .references import HeldOutReference, ReferenceTables

PLACES = 10  # along the reference at which inertias are looked at that scale bandwidths
OF_ROBOT = ("robot", "overrides", "masses", "friction", "armature", "effort_limits", "speed_limits")
FITTED: dict[bytes, Robot] = {}  # what hardware was fitted to last: its experiment takes it, and what it has cached


@lru_cache(16)
def made_for(robot: Robot, tables: bytes, duration: float, changed: float, trailer: bool) -> Trajectory:
    """The reference of some tables (JSON) for a robot or its trailer, anew when its file has changed."""
    reference = msgspec.json.decode(tables, type=ReferenceTables)
    return followable(robot, partial(reference.of, robot), duration, reference.share, trailer)


class AddedFriction(Settings, frozen=True):
    """Friction that is added to what the URDF says of its joints.

    Args:
        base: Viscous, added to what the wheels' `damping` makes, one number or one per base velocity [N s/m, N m s].
        arm: Viscous, added to the joints' `damping`, one number or one per joint [N m s or N s/m].
        coulomb: Dry friction, added to the arm joints' `friction`, one number or one per joint [N m or N]; it sticks
            with the integrator "stick", else it is smooth.
        breakaway: Ratio of static to Coulomb friction.
        stribeck: Velocity over which the one falls to the other [rad/s or m/s].
    """

    base: float | tuple[float, ...] = 0.0
    arm: float | tuple[float, ...] = 0.0
    coulomb: float | tuple[float, ...] = 0.0
    breakaway: float = 1.0
    stribeck: float = 0.05

    def __post_init__(self) -> None:
        require_gains(self, "friction")


class Case(Settings, frozen=True):
    """One case of an experiment.

    Args:
        title: A few words for the table.
        set: Keys that it changes, tables in tables.
        experiment: A bundled experiment or a file to start from, in place of the experiment with the cases; what the
            latter says itself holds in this case, too.
        own: Keys of `set` that the case itself says; filled in where it starts from another experiment.
    """

    title: str
    set: dict[str, Any] = msgspec.field(default_factory=dict)
    experiment: str = ""
    own: tuple[str, ...] = ()


class Tolerance(Settings, frozen=True):
    """Bounds that a run of a case has to keep.

    Args:
        settle: Time after which the errors count [s].
        pose: Largest distance of the base from its reference [m].
        heading: Largest heading error [rad].
        joint: Largest error of an arm joint [rad or m].
        runaway: Largest distance from the reference at the moment of a trip, and driven after it [m].
        speed: Speed of the base that counts as rest [m/s, rad/s].
        joint_speed: Speed of an arm joint that counts as rest [rad/s or m/s].
    """

    settle: float = 1.0
    pose: float = 0.05
    heading: float = 0.1
    joint: float = 0.05
    runaway: float = 0.5
    speed: float = 0.02
    joint_speed: float = 0.1

    def __post_init__(self) -> None:
        require_gains(self, "tolerance")


@faced
class Experiment(LearnerTables, frozen=True):
    """Everything that defines an experiment; see the bundled TOML files for commented examples.

    Beside the keys here it has a table for every learner, such as `adaptive` (see `mmnn_pin.torque`).

    Args:
        title: One line for tables and plots.
        variant: Which reading of the experiment this is, where it has several files.
        robot: Bundled name or path.
        overrides: What is said about the robot, as in the file beside its URDF.
        hardware: Its hardware: a table, a profile's name or a file. When the experiment is read, other keys follow from
            it (`lab.experiments.hardware`).
        effort_limits: Largest torques of its motors in place of the URDF's, one for all or one for each; 0 for the
            URDF's [N m or N].
        speed_limits: Likewise [rad/s or m/s].
        masses: Factor on the true robot's inertias, one for all or one per joint with a body (`Robot.with_masses`).
        radii: Factor on the true radii of the drive wheels, one for all or one per wheel's joint. The true robot rolls
            on them; controllers and wheel odometry take those of the file (`Robot.with_radii`).
        controllers: Controllers to run, names of `CONTROLLERS` or of `laws`; `FILE.py:Class` for a class of a user.
        seed: The one seed.
        windows: Intervals for the RMS errors [s]; an interval that a run does not reach has no errors, and a note says
            so.
        weights_interval: Time between two records of the weights [s].
        plots: Pictures that a run writes; `mmnn plot --help` names them. A figure of the thesis compares the run with
            the intervals of its axes, `figure-5.5` also with the largest errors that chapter 5 prints.
        torque_limits: Show every motor's peak torque beside its effort limit in the table, not only what exceeds it.
        time: Periods and integrator.
        start: Start relative to the reference.
        bounds: Speeds beyond which a run counts as diverged.
        reference: The reference.
        kinematic: Gains of the kinematic layer.
        feedback: k1, k2; what is not given suits the robot (`loop.suited`).
        robust: Kz, ZB, scaled as the feedback is.
        robust_of: Kz, ZB of single learners.
        nominal: The nominal model, wrong on purpose, of the controllers that have one.
        laws: Controllers of a user by name: `law`, where the class is, and its settings.
        inputs: What the networks see.
        learning: Conventions and switches.
        friction: Friction of the true robot beside its URDF's.
        armature: Inertia of the arm's rotors, seen through their gears, one number or one per joint [kg m^2 or kg].
        sensor: Errors and delays of the sensors.
        actuator: Limits and errors of the motors.
        safety: A supervisor between controller and motors; without the table there is none.
        latency: Delays of measurements and commands.
        interfaces: What the motor of a joint takes: "velocity" or "position"; "effort" for joints that are not named.
        servo: The servos behind velocity and position interfaces.
        lead: Whether Psi_hat leads by half the control period, the latency of the commands and the motors' lag.
        touch: Observer of external torque; without the table nothing is felt.
        disturbances: What happens to the robot during a run.
        impedance: Compliance of the hand; without the table it is stiff.
        force: Force with which the hand pushes.
        plant: "ideal", wheels that roll exactly, or "contact", wheels that may slip, in MuJoCo.
        contact: The floor of the contact plant.
        cases: Changes of this experiment, name to case; with them it runs once in each, with a verdict on every run.
        tolerance: Largest errors that a case allows.
        held_out: Held-out trajectories by name; if none is named, one is derived from the reference (see
            `psi.held_out`).

    Raises:
        UnknownName: A controller or a plant that does not exist.
        ConfigError: No controllers, or windows that are not intervals.
    """

    robot: str
    reference: ReferenceTables
    title: str = ""
    variant: str = ""
    overrides: Overrides = Overrides()
    hardware: HardwareTable | None = None
    effort_limits: Numbers = 0.0
    speed_limits: Numbers = 0.0
    masses: float | dict[str, float] = 1.0
    radii: float | dict[str, float] = 1.0
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
    nominal: Nominal = Nominal()
    laws: dict[str, dict[str, Any]] = msgspec.field(default_factory=dict)
    inputs: Inputs = Inputs()
    learning: Learning = Learning()
    friction: AddedFriction = AddedFriction()
    armature: float | tuple[float, ...] = 0.0
    sensor: Sensor = Sensor()
    actuator: Actuator = Actuator()
    safety: Safety | None = None
    latency: Latency = Latency()
    interfaces: dict[str, str] = msgspec.field(default_factory=dict)
    servo: Servo = Servo()
    lead: bool = False
    touch: Touch | None = None
    disturbances: tuple[Disturbance, ...] = ()
    impedance: Impedance | None = None
    force: Force | None = None
    plant: str = "ideal"
    contact: Contact = Contact()
    cases: dict[str, Case] = msgspec.field(default_factory=dict)
    tolerance: Tolerance = Tolerance()
    held_out: dict[str, HeldOutReference] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.controllers:
            raise ConfigError("no controllers", fix=f"choose from: {', '.join(CONTROLLERS)}", key="controllers")
        controllers, laws = resolved(self.controllers, self.laws, CONTROLLERS)
        msgspec.structs.force_setattr(self, "controllers", controllers)
        msgspec.structs.force_setattr(self, "laws", laws)
        there = {**CONTROLLERS, **laws, **self.objects}
        for name in self.controllers:
            if name not in there:
                raise UnknownName("controller", name, there, key="controllers")
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
                raise ConfigError(
                    f"{held.duration} s", fix="use a finite number of seconds > 0", key=f"held_out.{name}.duration"
                )
        require_in_time(self.disturbances, self.time.duration)

    @property
    def objects(self) -> Mapping[str, Any]:
        """Controllers by name that are no names of a file; a file has none."""
        return {}

    def load_robot(self) -> Robot:
        """The true robot, with the experiment's masses and friction.

        Raises:
            RobotError: The URDF cannot be used.
            UnknownName: No such robot, or no such body.
        """
        return FITTED.pop(self.of_robot(), None) or self.made_true(load_with(self.robot, self.overrides))

    def of_robot(self) -> bytes:
        """All that `load_robot` goes by."""
        return msgspec.json.encode([getattr(self, name) for name in OF_ROBOT])

    def made_true(self, robot: Robot) -> Robot:
        """A robot as its file describes it, with the experiment's masses and friction.

        Raises:
            UnknownName: No such body.
            ConfigError: A factor or a coefficient that cannot be.
        """
        robot, f = robot.with_limits(self.effort_limits, self.speed_limits).with_armature(self.armature), self.friction
        if self.masses != 1.0:
            with keyed(lambda key: "masses"):
                robot = robot.with_masses(self.masses)
        robot = robot.with_joint_friction(coulomb=f.coulomb, breakaway=f.breakaway, stribeck=f.stribeck)
        return robot.with_friction(per_velocity(f.base, f.arm, robot.dimensions, "friction"))

    def trajectory(self, layout: Dimensions, limits: tuple[Array, Array] | None = None) -> Trajectory:
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
        """The reference for a robot, within the limits of its joints and motors; errors as in `trajectory`.

        A hand's motion is made once for a robot and its periods.
        """
        if self.reference.hand is not None:
            return hand_motion(self.reference.hand, robot, self.time).trajectory
        file = Path(self.reference.file)
        changed = file.stat().st_mtime if self.reference.file and file.is_file() else 0.0
        trailer = self.kinematic.guide == "trailer"
        return made_for(robot, msgspec.json.encode(self.reference), self.time.duration, changed, trailer)

    def held_out_of(self, robot: Robot, name: str) -> Trajectory:
        """A held-out trajectory for a robot; errors as in `trajectory`, with the keys of `held_out`."""
        if name not in self.held_out:
            raise UnknownName("held-out trajectory", name, self.held_out, key="held_out")
        given = self.held_out[name]
        tables = ReferenceTables(given.base, given.heading, given.arm, given.share)
        try:
            return msgspec.structs.replace(self, reference=tables).trajectory_of(robot)
        except InputError as error:
            key = (error.key or "reference").replace("reference", f"held_out.{name}", 1)
            raise error.but(key=key, fix=error.fix.replace("[reference.", f"[held_out.{name}.")) from error

    def fit(self, robot: Robot) -> Fit | None:
        """Effective inertias and the share of the bandwidths that suits a robot; None when all gains are given.

        Bandwidths that are given are scaled by the inertias along the reference; see `loop.suited` for the rest.
        """
        if self.feedback.complete(robot.dimensions):
            return None
        if self.feedback.given(robot.dimensions):
            table = self.trajectory_of(robot).table(np.linspace(0.0, self.time.duration, PLACES), robot.dimensions)
            positions = (Start().state(robot, row)[0] for row in table)
            return Fit(effective_inertia(robot, positions, self.time.control_period), 1.0)
        return fit(robot, self.feedback, LoopToSuit.of(self, self.trajectory_of(robot), self.time, robot.dimensions))

    def controller(
        self, name: str, gains: Array | None = None, robot: Robot | None = None
    ) -> CompiledController | TorqueController:
        """A controller by name; one of a user runs its file.

        Args:
            name: One of `CONTROLLERS` or of `laws`.
            gains: (samples, p) schedule of a PD at an effective gain.
            robot: The robot that gains suit which are not given, and whose effective inertias scale bandwidths.

        Raises:
            ConfigError: Gains that are to be scaled, and no robot.
            InputError: A user's file or class that cannot be used.
        """
        return new_controller(self, name, gains, robot)

    def robust_term(self, name: str) -> Robust:
        """Kz and ZB of a controller: its own, or the common ones."""
        return getattr(self.robust_of, "two_layer" if name.startswith("two_layer") else name, None) or self.robust

    def loop(self, robot: Robot, controller: CompiledController | TorqueController | str) -> Loop:
        """The closed loop of this experiment around one controller, or the one of a name; errors as in `controller`."""
        if isinstance(controller, str):
            controller = self.controller(controller, robot=robot)
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
            latency=self.latency,
            interfaces=self.interfaces,
            servo=self.servo,
            lead=self.lead,
            touch=self.touch,
            radii=self.radii,
            impedance=self.impedance,
            force=self.force,
        )

    def setting(self, values: Mapping[str, str]) -> str:
        """The options that set some of its keys, their values as TOML has them."""
        return " ".join(f"--set {shlex.quote(f'{key}={value}')}" for key, value in values.items())

    @contextmanager
    def in_its_keys(self, written: Callable[[Mapping[str, str]], str] | None = None) -> Iterator[None]:
        """Errors of its loops within name gains and servos as this experiment takes them.

        Args:
            written: Keys and their values in TOML to how a user sets them; None for options of a command.
        """
        try:
            yield
        except ConfigError as error:
            if (values := error.values) is None:
                raise
            table = values.table
            keys = {f"{table}.{name}": re.sub(r"\((.*)\)", r"[\1]", text) for name, text in values.texts.items()}
            if values.table == "feedback" and self.feedback.scaling != "none":
                keys[f"{table}.scaling"] = '"none"'
            raise error.but(fix=error.fix.replace(str(values), (written or self.setting)(keys))) from error

    def to_json(self) -> str:
        """The complete experiment with its defaults, as text (JSON) for a recording."""
        return msgspec.json.format(msgspec.json.encode(self), indent=2).decode()
