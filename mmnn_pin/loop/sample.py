"""One control sample, as the picture of the loop shows it: setpoint -> kinematic -> torque -> safety.

    time, measurement, setpoint -> [kinematic] -> [torque] -> [safety] -> torque to the motors

`sample` is the order of it, for the ordinary loop, the compiled loop and a loop of one's own (`stepper`). All of it
happens in one row of signals. `before_torque` is what comes before the controller, `law_torque` what a controller of
this package does, `after_torque` what only a simulation knows: the true state, the energy balance and the guard.

Where a controller is plain Python, `sample` runs as plain Python, too; what it calls stays compiled.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .. import kinematic
from ..by_address import by_address
from ..compiled import by_type, compiled, copy_to, entry, internal, linked, plain
from ..compliance import Compliance, give, wish
from ..errors import ConfigError, InputError, RobotError
from ..kinematic import Steering
from ..model.base.trailers import trailer_pose
from ..model.dynamics import Dynamics
from ..model.reduction import as_measured, put_shape
from ..model.robot import Robot
from ..model.tree.body import evaluate
from ..model.tree.twin import Terms, psi_of
from ..parts import vector, view
from ..signals import INDEX, Array, IntArray, Measurement, Setpoint, VelocityCommand
from ..torque import law
from ..torque.controller import CompiledController, Context, ControllerState, TorqueController
from ..torque.law import Ahead, MotorLimits, Packed, doubt, estimate, limit, settle, turn_limits
from ..torque.learning_law import LearningLaw, Sample, blamed, norms
from ..touch import Feeler, feel, give_way, go_back, is_asked, is_frozen, remember
from .hardware import Hardware, is_stopped, send
from .lead import Lead, catch_up, held, learns, look_ahead, reference_then
from .machine import Machine, new_machine
from .plan import Plan
from .servo import Split, answered, ask, tell

TIME, POSITION, NU, POSE_REF, POSE = (INDEX[n] for n in ("time", "position", "nu", "pose_ref", "pose"))
VELOCITY, Q, QDOT, SHAPE, ALPHA, Q_REF = (INDEX[n] for n in ("velocity", "q", "qdot", "shape", "alpha", "q_ref"))
NU_REF, NUDOT_REF, PSI_HAT = (INDEX[n] for n in ("nu_ref", "nudot_ref", "psi_hat"))
TORQUE, MOTOR_TORQUE = INDEX["torque"], INDEX["motor_torque"]
TRUE_POSE_ERROR, TRUE_Z, TRUE_E = (INDEX[n] for n in ("true_pose_error", "true_z", "true_e"))
ENERGY, WORK, RESIDUAL = (INDEX[n] for n in ("energy", "work", "energy_residual"))


@by_address
class Controls(NamedTuple):
    """The arrays and numbers that every control sample works on."""

    row: Array  # (width,) row of signals
    at: IntArray  # offsets of the signals
    gains: Array  # (3,) of the kinematic layer
    K: Array  # (n,) gain of the filtered arm error [1/s]
    law: Packed  # the numbers of the law
    state: Array  # (size,) the controller's state
    setpoints: Array  # the setpoint of every control sample, (samples, ...)
    then: Array  # room for the reference of a measurement that is late
    age: float  # by how much measurements are brought up to now [s]; 0 in a stepper, which does so before (`bring_up`)
    h: float  # control period [s]


@linked
def sample(  # noqa: PLR0913 - parts that are None are not compiled
    k: int,
    time: float,
    setpoint: Array,
    before: Array,
    controls: Controls,
    model: Machine | None,
    hardware: Hardware | None,
    learner: Any,
    limits: MotorLimits | None,
    ahead: Ahead | None,
    later: Any,
    split: Split | None,
    steering: Steering | None,
    task: Compliance | None,
    touch: Feeler | None,
    kept: Controls | None,
    held: Any,
    own: Torque | None,
) -> None:
    """Write everything of a control sample up to the torque into the row, which has the measurement.

    Args:
        k: Number of the sample.
        time: [s].
        setpoint: The signals `pose_ref` ... `qddot_ref` side by side.
        before: The setpoint of the sample before, from which Psi_hat may lead.
        controls: What is worked on.
        model: The robot that the controller believes in, also an `Unflattened`; None where it uses no model.
        hardware: Sensors, motors, supervisor and disturbances; None for an ideal robot.
        learner: What the controller learns with beside networks; None for nothing.
        limits: What Psi_hat is kept within; None for nothing.
        ahead: Where Psi_hat leads; None where it does not.
        later: The learner with its weights held, which is asked there.
        split: The rows that take a velocity, which are the hardware's; None where all take effort.
        steering: Of a base that steers; None for others.
        task: A compliant hand; None for one that is stiff.
        touch: What feels external torque; None for nothing.
        kept: The controls of the law with its weights held, which takes over in contact; None where it goes on.
        held: The learner with its weights held, likewise.
        own: A controller in plain Python, which is asked in place of the law; None for one of this package.
    """
    row, at, asked = controls.row, controls.at, True
    if controls.age > 0.0:
        reference_then(controls.setpoints, k, controls.age / controls.h, controls.then)
        catch_up(row, at, setpoint, controls.then, controls.age, steering)
    turn(row, at, limits, steering)
    frozen = feel_first(row, at, time, controls.state, touch)
    before_torque(row, at, time, setpoint, controls.gains, controls.K, before, steering)
    if hardware is not None:
        asked = not is_stopped(hardware.way.supervisor.on, hardware.way.supervisor.state)
    if asked:
        bend(row, at, task, split)
        if ahead is not None:
            look_ahead(row, at, before, ahead, steering)
        if own is not None:
            own.answer(time, frozen)
        else:
            law_or_held(controls, model, learner, limits, ahead, later, kept, held, frozen)
        bear(row, at, task)
        yield_to(row, at, touch)
    if split is not None:
        answered(row, at, not asked, split)
    if hardware is not None:
        send(k, time, row, at, controls.state, hardware.way)
    if split is not None:
        tell(row, at, not asked, split)
    look_back(controls, learner, limits, asked, touch)
    if learner is not None and asked:
        settle_or_held(controls, learner, kept, held, frozen)


@compiled
def law_or_held(  # noqa: PLR0913 - parts that are None are not compiled
    controls: Controls, model: Machine | None, learner: Any, limits: MotorLimits | None, ahead: Ahead | None,
    later: Any, kept: Controls | None, held: Any, frozen: bool,
) -> None:  # fmt: skip
    """`law_torque` of the law, or of the one with its weights held; arguments as of `sample`."""
    if kept is not None:
        if frozen:
            law_torque(kept, model, held, limits, ahead, later)
        else:
            law_torque(controls, model, learner, limits, ahead, later)
    else:
        law_torque(controls, model, learner, limits, ahead, later)


@compiled
def settle_or_held(controls: Controls, learner: Any, kept: Controls | None, held: Any, frozen: bool) -> None:
    """`settle` of the learner, or of the one with its weights held; arguments as of `sample`."""
    if not frozen or kept is None:
        settle(controls.row, controls.at, learner, controls.state)
    elif held is not None:  # one that only learns by it has none
        settle(controls.row, controls.at, held, controls.state)


@compiled
def feel_first(row: Array, at: IntArray, time: float, state: Array, touch: Feeler | None) -> bool:
    """Feel what the measurement says, into the row; whether a learner is to keep what it knows."""
    frozen = False
    if touch is not None:
        feel(row, at, time, touch)
        go_back(state, touch)
        frozen = is_frozen(touch)
    return frozen


@compiled
def yield_to(row: Array, at: IntArray, touch: Feeler | None) -> None:
    """Give way to contact where that is asked for."""
    if touch is not None:
        give_way(row, at, touch)


@compiled
def look_back(controls: Controls, learner: Any, limits: MotorLimits | None, asked: bool, touch: Feeler | None) -> None:
    """Tell what feels the torque that was sent, and what the learner knows; arguments as of `sample`."""
    row, at = controls.row, controls.at
    if touch is not None:
        if limits is not None:
            remember(row, at, limits.asked, asked, touch)
        else:
            remember(row, at, view(row, at, PSI_HAT), asked, touch)
        if learner is not None and asked and is_asked(touch):
            doubt(learner, controls.state, touch.state.learned)


@compiled
def bend(row: Array, at: IntArray, task: Compliance | None, split: Split | None) -> None:
    """The velocity that is asked for, as a compliant hand and the rows that take a velocity change it."""
    if task is not None:
        wish(row, at, task)
    if split is not None:
        ask(row, at, split)


@compiled
def bear(row: Array, at: IntArray, task: Compliance | None) -> None:
    """The torque of a compliant hand in place of the feedback's."""
    if task is not None:
        give(row, at, task)


@compiled
def turn(row: Array, at: IntArray, limits: MotorLimits | None, steering: Steering | None) -> None:
    """The maps of a base that steers, and with them what its motors can do, at the measured angles."""
    if steering is not None:
        kinematic.steer(row, at, steering)
        if limits is not None:
            turn_limits(limits, steering.E, steering.E_inv)


@linked
def before_torque(
    row: Array,
    at: IntArray,
    time: float,
    setpoint: Array,
    gains: Array,
    K: Array,
    before: Array,
    steering: Steering | None,
) -> None:
    """Everything of a sample up to the controller: time, setpoint, velocity command; the measurement is in the row.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        time: [s].
        setpoint: The signals `pose_ref` ... `qddot_ref` side by side, as in a trajectory's table.
        gains: (3,) of the kinematic layer.
        K: (n,) gain of the filtered arm error [1/s].
        before: As of `sample`.
        steering: As of `sample`; its maps are those of this sample.
    """
    row[at[TIME]] = time
    copy_to(setpoint, vector(row, at[POSE_REF], at[POSE] - at[POSE_REF]))
    kinematic.command(row, at, gains, K, before, steering)


@linked
def law_torque(
    controls: Controls, model: Machine | None, learner: Any, limits: MotorLimits | None, ahead: Ahead | None, later: Any
) -> None:
    """Psi_hat and torque of a controller of this package; arguments as of `sample`."""
    row, at, state = controls.row, controls.at, controls.state
    if ahead is not None:
        estimate_ahead(at, state, model, ahead, later)
    if model is not None:
        model_psi(row, at, model)
    if learner is not None:
        estimate(row, at, learner, state)
    if ahead is not None:  # networks have learned by now: their weights are those of this sample's psi_hat
        law.step(ahead.row, at, ahead.law, state, None, None)
    law.step(row, at, controls.law, state, limits, ahead)


@compiled
def estimate_ahead(at: IntArray, state: Array, model: Machine | None, ahead: Ahead, later: Any) -> None:
    """Write Psi_hat of model and learner where the torque acts into the row there, before the learner learns."""
    if model is not None:
        model_psi(ahead.row, at, model)
    if later is not None:
        estimate(ahead.row, at, later, state)


def model_psi(row: Array, at: IntArray, model: Any) -> None:
    """Psi of the robot that a controller believes in at the measured state, into psi_hat."""
    if isinstance(model, Machine):
        machine_psi(row, at, model)
    else:
        model.psi(row, at)


by_type(model_psi, "model", lambda kind: machine_psi)


@internal
def machine_psi(row: Array, at: IntArray, model: Machine) -> None:
    """`model_psi` of a robot as arrays."""
    body, work, psi_hat = model.body, model.work, view(row, at, PSI_HAT)
    as_measured(
        body.offset, body.columns, view(row, at, POSE), view(row, at, VELOCITY), view(row, at, Q),
        view(row, at, QDOT), model.position, model.nu,
    )  # fmt: skip
    put_shape(body.shape, view(row, at, SHAPE), model.position)
    evaluate(body, work, model.position, model.nu)
    psi_of(body, work, model.position, view(row, at, NU_REF), view(row, at, NUDOT_REF), psi_hat)


@linked
def after_torque(  # noqa: PLR0913 - the arrays of either engine
    row: Array,
    at: IntArray,
    y: Array,
    places: IntArray,
    M: Array,
    E_inv: Array,
    potential: float,
    start: float,
    bounds: Array,
    hitch: Array,
) -> int:
    """True state and errors, motor torques, energy balance and the guard of a sample.

    Args:
        row: (width,) row of signals with the torque.
        at: Offsets of the signals.
        y: (nv + p + 1,) the plant's position, nu, and the work done on it.
        places: (n + shape,) of the arm joints in the position, then of the pivots.
        M: (p, p) mass matrix.
        E_inv: (motors, p) motor torques from the torque on nu.
        potential: Potential energy [J].
        start: Energy at the start [J].
        bounds: (p,) on |nu|.
        hitch: As of `kinematic.Steering`, placed in the position.

    Returns:
        -1, or the first column that is not finite or a velocity that is out of bounds.
    """
    position, nu, work = view(row, at, POSITION), view(row, at, NU), y[y.size - 1]
    copy_to(y[: position.size], position)
    copy_to(y[position.size : y.size - 1], nu)
    true_errors(row, at, position, nu, places, hitch)
    torque, motors = view(row, at, TORQUE), view(row, at, MOTOR_TORQUE)
    for i in range(motors.size):
        motors[i] = entry(E_inv, i, torque)
    energy = potential
    for i in range(nu.size):
        for j in range(nu.size):
            energy += 0.5 * nu[i] * M[i, j] * nu[j]
    row[at[ENERGY]], row[at[WORK]], row[at[RESIDUAL]] = energy, work, energy - start - work
    for i in range(nu.size):
        if abs(nu[i]) > bounds[i]:
            return int(at[NU] + i)
    for i in range(row.size):
        if not np.isfinite(row[i]):
            return i
    return -1


@compiled
def true_errors(row: Array, at: IntArray, position: Array, nu: Array, places: IntArray, hitch: Array) -> None:
    """The tracking errors of the true state, which no controller sees: true_pose_error, true_z, true_e."""
    pose_ref, z = view(row, at, POSE_REF), view(row, at, TRUE_Z)
    if pose_ref.size:
        error = view(row, at, TRUE_POSE_ERROR)
        if hitch.size:
            trailer_pose(hitch[2:], hitch[1] * position[int(hitch[0])], position, error)
            kinematic.body_error(pose_ref, error, error)
        else:
            kinematic.body_error(pose_ref, position, error)
    for i in range(z.size):
        z[i] = row[at[ALPHA] + i] - nu[i]
    for i in range(at[TRUE_E + 1] - at[TRUE_E]):
        row[at[TRUE_E] + i] = row[at[Q_REF] + i] - position[places[i]]


class Unflattened:
    """A robot that a controller believes in and that is no arrays: Pinocchio evaluates it."""

    def __init__(self, robot: Robot, terms: Terms) -> None:
        self.terms, self.arm_map, self.shape = terms, robot.arm_map(), robot.shape_index.copy()
        self.position, self.nu = robot.neutral_position(), np.zeros(robot.dimensions.dof)

    def psi(self, row: Array, at: IntArray) -> None:
        """See `model_psi`."""
        pose, velocity, q, qdot = (view(row, at, signal) for signal in (POSE, VELOCITY, Q, QDOT))
        as_measured(*self.arm_map, pose, velocity, q, qdot, self.position, self.nu)
        put_shape(self.shape, view(row, at, SHAPE), self.position)
        self.terms.refresh(self.position, self.nu)
        self.terms.refresh_psi(view(row, at, NU_REF), view(row, at, NUDOT_REF), view(row, at, PSI_HAT))


def believed_model(robot: Robot) -> Any:
    """A robot that a controller believes in, for `sample`: a `Machine`, else `Unflattened`."""
    try:
        return new_machine(robot, None, robot.neutral_position(), np.zeros(robot.dimensions.dof))
    except RobotError:
        return Unflattened(robot, Dynamics(robot))


class Torque:
    """One controller wired to one row; the same face for compiled and for Python controllers.

    Args:
        controller: The controller.
        context: What it is told before the run.
        row: The row it reads and writes.
        nominal: The robot that a controller believes in which uses a model and brings none.
        state: Its state.
        lead: How Psi_hat looks ahead; None where it does not.

    Attributes:
        law: The law of a compiled controller.
        model, learner, limits, ahead, later, kept, held: As of `sample`.
        compiled: Whether compiled code can ask it.
    """

    def __init__(
        self,
        controller: TorqueController | CompiledController,
        context: Context,
        row: Array,
        nominal: Robot,
        state: Any,
        lead: Lead | None = None,
    ) -> None:
        layout = context.layout
        self.controller, self.state, self.row, self.at = controller, state, row, layout.offsets
        self.limits, self.learner, self.model = context.limits, None, None
        self.ahead: Ahead | None = None if lead is None else lead.ahead
        self.later: Any = None if lead is None else lead.learner
        self.psi_hat = row[layout.where("psi_hat")]
        numbers = law.constant_gain(np.zeros(layout.dof))
        if isinstance(controller, CompiledController):
            self.law = controller.law(context)
            self.learner, numbers = self.law.learner, self.law.numbers
            if controller.uses_model:
                self.model = believed_model(controller.model or nominal)
        values = state.values if isinstance(state, ControllerState) else np.zeros(0)
        nothing = np.zeros(0)
        self.controls = Controls(row, self.at, nothing, nothing, numbers, values, nothing[None], nothing, 0.0, 1.0)
        self.kept: Controls | None = None
        self.held: Any = None
        self.compiled = isinstance(controller, CompiledController) and not isinstance(self.model, Unflattened)
        if isinstance(controller, TorqueController):
            self._wire(controller, context)

    def _wire(self, controller: TorqueController, context: Context) -> None:
        """Views of the row for a controller in plain Python."""
        layout, row = context.layout, self.row
        self.layout = layout
        self.setpoint, self.measurement = Setpoint.of(row, layout), Measurement.of(row, layout)
        self.command = VelocityCommand.of(row, layout)
        self.torque = row[layout.where("torque")]
        self.gain, self.weight_norm = row[layout.where("effective_gain")], row[layout.where("weight_norm")]
        if isinstance(controller, LearningLaw):
            self.sample, self.K = Sample.of(row, context), controller.feedback_gain(layout)
            self.later_sample = self.sample if self.ahead is None else Sample.of(self.ahead.row, context)

    def answer(self, time: float, frozen: bool = False) -> None:
        """Write psi_hat, robust, effective_gain and torque of this sample, at a time [s], into the row.

        Args:
            time: [s].
            frozen: Whether what is learned is to be kept.
        """
        if isinstance(self.controller, TorqueController):
            try:
                if isinstance(self.controller, LearningLaw):
                    self._learning_law(time, self.controller, frozen)
                else:
                    self._python(time, self.controller)
            except InputError:
                raise
            except Exception as error:
                raise blamed(error, self.controller) from error
            return
        function = law_torque if self.compiled else plain(law_torque)
        controls, learner = (self.kept, self.held) if frozen and self.kept else (self.controls, self.learner)
        function(controls, self.model, learner, self.limits, self.ahead, self.later)

    def hold(self, context: Context, controls: Controls) -> None:
        """Make the law with its weights held, where the controller has weights, beside controls of the law."""
        if isinstance(self.controller, CompiledController) and learns(self.controller):
            law = held(self.controller).law(context)
            self.kept, self.held = controls._replace(law=law.numbers), law.learner

    def keep(self) -> None:
        """Let a learner remember the torque in the row: the one of the law, or what a supervisor made of it."""
        if self.learner is not None:
            settle(self.row, self.at, self.learner, self.controls.state)

    def features(self) -> Array | None:
        """Features of the last step, which the weights multiply, (rows, k) or (k,); None where it is not told."""
        if isinstance(self.controller, LearningLaw):
            return self.controller.features(self.sample, self.state)
        if isinstance(self.controller, CompiledController):
            return self.controller.features(self.law, self.state)
        return None

    def _python(self, time: float, controller: TorqueController) -> None:
        """Torque of a controller in plain Python, and its Psi_hat if it tells one."""
        answer = controller.step(time, self.setpoint, self.measurement, self.command, self.state)
        torque, psi_hat = answer if isinstance(answer, tuple) and len(answer) == 2 else (answer, None)
        self.torque[:] = self._of_shape("torque", torque)
        if psi_hat is not None:
            self.psi_hat[:] = self._of_shape("Psi_hat", psi_hat)
            if self.limits is not None:
                self._answer(self.torque - self.psi_hat)

    def _learning_law(self, time: float, controller: LearningLaw, frozen: bool) -> None:
        """`tau = K s + Psi_hat` of a law in plain Python, and what it learns."""
        if self.ahead is not None:
            self.later_sample.refresh(time + self.ahead.time)
            self.ahead.row[self.layout.where("psi_hat")] = self._of_shape(
                "Psi_hat", controller.estimate(self.later_sample, self.state)
            )
        self.sample.refresh(time)
        self.psi_hat[:] = self._of_shape("Psi_hat", controller.estimate(self.sample, self.state))
        self.gain[:] = self.K
        self.weight_norm[:] = norms(controller.weights(self.state), self.layout)
        self._answer(self.K * self.sample.s)
        if controller.learning and not frozen:
            controller.learn(self.sample, self.state)

    def _answer(self, feedback: Array) -> None:
        """The torque: a feedback (p,) and Psi_hat, this within the motors' limits where it is to be."""
        sent = self.psi_hat
        if self.ahead is not None:
            sent = self.row[self.layout.where("psi_applied")]
            law.lead(self.psi_hat, self.ahead.row[self.layout.where("psi_hat")], self.ahead.share, sent)
            if self.limits is not None:
                limit(sent, feedback, self.limits)
        if self.limits is not None:
            limit(self.psi_hat, feedback, self.limits)
        self.torque[:] = feedback + sent

    def _of_shape(self, what: str, values: Any) -> Any:
        """The values, if there is one number per velocity.

        Raises:
            ConfigError: There is not.
        """
        if np.shape(values) != self.torque.shape:
            raise ConfigError(
                f"controller '{self.controller.name}' returned a {what} of shape {np.shape(values)}",
                fix=f"return an array of shape {self.torque.shape}",
            )
        return values


def alike(steering: Steering | None, model: Any) -> Steering | None:
    """The steering of a base, its u counted in the direction in which a model of the robot counts it."""
    if steering is None or model is None:
        return steering
    maps = model.work.maps if isinstance(model, Machine) else model.terms.maps
    return steering._replace(maps=steering.maps._replace(n=maps.n))


def counting(task: Compliance | None, steering: Steering | None) -> Compliance | None:
    """A compliant hand that counts u of a base that steers as its steering does."""
    if task is None or steering is None:
        return task
    tip, inertia, n = task.tip, task.inertia, steering.maps.n
    maps = tip.maps._replace(n=n), inertia.maps._replace(n=n)
    return task._replace(tip=tip._replace(maps=maps[0]), inertia=inertia._replace(maps=maps[1]))


class Control:
    """Kinematic layer, controller and supervisor wired to one row.

    Args:
        plan: Of the loop.
        row: The row that they read and write.
        state: The controller's state.
        hardware: With the supervisor, or None.

    Attributes:
        blocks: What follows in the arguments of `sample`.
    """

    def __init__(self, plan: Plan, row: Array, state: Any, hardware: Hardware | None) -> None:
        self.torque = torque = Torque(plan.controller, plan.context, row, plan.believed, state, plan.lead)
        task = None if hardware is None else hardware.task
        self.controls = torque.controls._replace(
            gains=plan.gains if task is None else task.station * plan.gains,
            K=plan.K,
            setpoints=plan.setpoints,
            then=plan.setpoints[0].copy(),
            age=plan.age,
            h=plan.timing.control_period,
        )
        if plan.freezes:
            torque.hold(plan.context, self.controls)
        self.steering = alike(plan.steering, torque.model)
        self.sample = sample if torque.compiled else plain(sample)
        self.equip(hardware)

    def equip(self, hardware: Hardware | None) -> None:
        """Put a hardware model, or None, behind the controller."""
        torque, own = self.torque, None if self.torque.compiled else self.torque
        self.hardware, (split, touch) = hardware, (None, None) if hardware is None else (hardware.split, hardware.touch)
        learned = torque.learner, torque.limits, torque.ahead, torque.later
        task = self.task = None if hardware is None else counting(hardware.task, self.steering)
        kept = (None, None) if touch is None else (torque.kept, torque.held)
        self.blocks = (self.controls, torque.model, hardware, *learned, split, self.steering, task, touch, *kept, own)

    def step(self, time: float, setpoint: Array, k: int = 0, before: Array | None = None) -> None:
        """One `sample`; `before` is None for the setpoint itself."""
        self.sample(k, time, setpoint, setpoint if before is None else before, *self.blocks)
