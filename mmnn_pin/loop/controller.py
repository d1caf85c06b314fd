"""A controller around and in a run: its context, its state before and after, and its step wired to a row."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.random import Generator

from ..errors import ConfigError, InputError
from ..model.reduction import as_measured
from ..model.regressor import Regressor
from ..model.robot import Robot
from ..model.tree.twin import Terms, terms_of
from ..recording.recording import Outcome
from ..settings import given_array
from ..signals import INDEX, Array, Layout, Measurement, Setpoint, VelocityCommand
from ..torque import law
from ..torque.controller import CompiledController, Context, ControllerState, TorqueController
from ..torque.law import estimate, limit, motor_limits, settle
from ..torque.learning_law import LearningLaw, Sample, blamed, norms
from .lead import Lead, look_ahead


def state_from(controller: CompiledController | TorqueController, context: Context, given: Any = None) -> Any:
    """A copy of a state that fits a controller; a new one for None.

    Raises:
        ConfigError: It is of another controller or of other settings, or not finite.
    """
    new = new_state(controller, context)
    if given is None:
        return new
    if not isinstance(new, ControllerState):
        return copy.deepcopy(given)
    if not isinstance(given, ControllerState) or given.shapes != new.shapes:
        is_of = given.shapes if isinstance(given, ControllerState) else type(given).__name__
        raise ConfigError(
            f"not a state of {controller.name} with these settings",
            why=f"it is {is_of}, not {new.shapes}",
            fix="use one made by its init",
            key="state",
        )
    new.values[:] = given_array("state", given.values, new.values.shape)
    return new


def new_state(controller: CompiledController | TorqueController, context: Context) -> Any:
    """What a controller's `init` gives.

    Raises:
        InputError: It fails, or a learning law gives something else than a `ControllerState`.
    """
    if isinstance(controller, CompiledController):
        return controller.init(context)
    try:
        new = controller.init(context)
    except InputError:
        raise
    except Exception as error:
        raise blamed(error, controller) from error
    if isinstance(controller, LearningLaw):
        if not isinstance(new, ControllerState):
            what = f"{controller.name}.init returned {type(new).__name__}"
            raise ConfigError(
                what, why="a law learns in a `ControllerState`", fix="return ControllerState.of(name=shape, ...)"
            )
        controller.weights(new)
    return new


def findings_of(controller: CompiledController | TorqueController, state: Any) -> list[str]:
    """What a controller's state shows after a run; of one in plain Python that fails, where: the run is kept."""
    if isinstance(controller, CompiledController):
        return controller.findings(state)
    try:
        return [str(text) for text in controller.findings(state)]
    except Exception as error:
        return [f"its findings are lost: {blamed(error, controller)}"]


def with_findings(outcome: Outcome, controller: CompiledController | TorqueController, state: Any) -> Outcome:
    """An outcome whose message also tells what the controller's state shows after the run."""
    if outcome.status == "interrupted":
        return outcome
    findings = findings_of(controller, state)
    return replace(outcome, message="; ".join(text for text in (outcome.message, *findings) if text))


POSE, VELOCITY, Q, QDOT = (INDEX[name] for name in ("pose", "velocity", "q", "qdot"))
NU_REF, NUDOT_REF, PSI_HAT = (INDEX[name] for name in ("nu_ref", "nudot_ref", "psi_hat"))
REGRESSORS: WeakKeyDictionary[Robot, Regressor] = WeakKeyDictionary()


def context_of(
    controller: CompiledController | TorqueController,
    robot: Robot,
    period: float,
    samples: int,
    rng: Generator,
    within_limits: bool | None = None,
    layout: Layout | None = None,
    lag: Array | None = None,
    way: float = 0.0,
    unseen: float = 0.0,
    pose_weights: Array | None = None,
) -> Context:
    """What a controller is told before a run of a robot; how it moves only where a learning law asks for it.

    Args:
        controller: The controller.
        robot: Its robot.
        period: Control period [s].
        samples: Of the run.
        rng: The controller's own random generator.
        within_limits: Whether Psi_hat is kept within the motors' limits; None for what the controller says.
        layout: Where the signals stand in a row; None where nothing but the robot is recorded.
        lag: (p,) known time constants of the motors, seen from the velocities; None for none [s].
        way: See `Context.way` [s].
        unseen: See `Context.unseen` [s].
        pose_weights: See `Context.pose_weights`.
    """
    told = isinstance(controller, LearningLaw) and controller.knows_motion
    kept = controller.within_limits if within_limits is None else within_limits
    limits = motor_limits(robot.E, robot.effort_limits) if kept else None
    motion = regressor_of(robot) if told else None
    layout = layout or Layout.of(robot.dimensions)
    return Context(layout, period, samples, rng, motion, limits, lag, way, unseen, pose_weights)


def regressor_of(robot: Robot) -> Regressor:
    """The regressor of a robot, made once.

    Raises:
        RobotError: A joint that cannot be flattened.
    """
    if robot not in REGRESSORS:
        REGRESSORS[robot] = Regressor.of(robot)
    return REGRESSORS[robot]


class Torque:
    """One controller wired to one row; the same face for compiled and for Python controllers.

    Args:
        controller: The controller.
        context: What it is told before the run.
        row: The row it reads and writes.
        nominal: The robot that a controller believes in which uses a model and brings none.
        state: Its state.
        lead: How Psi_hat looks ahead; None where it does not.
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
        self.limits = context.limits
        self.setpoint, self.measurement = Setpoint.of(row, layout), Measurement.of(row, layout)
        self.command = VelocityCommand.of(row, layout)
        self.torque, self.psi_hat = row[layout.where("torque")], row[layout.where("psi_hat")]
        self.gain, self.weight_norm = row[layout.where("effective_gain")], row[layout.where("weight_norm")]
        self.lead, self.ahead = lead, None if lead is None else lead.ahead
        self.model: Terms | None = None
        self.learner: Any = None
        self.python = controller if isinstance(controller, TorqueController) else None
        if isinstance(controller, LearningLaw):
            self.layout, self.sample, self.K = layout, Sample.of(row, context), controller.feedback_gain(layout)
            self.later = self.sample if lead is None else Sample.of(lead.ahead.row, context)
        if isinstance(controller, CompiledController):
            self.law = controller.law(context)
            self.learner = self.law.learner
            if controller.uses_model:
                believed: Robot = controller.model or nominal
                self.model, self.arm_map = terms_of(believed), believed.arm_map()
                self.position, self.nu = believed.neutral_position(), np.zeros(layout.dof)

    def step(self, time: float, before: Array | None = None) -> None:
        """Write psi_hat, robust, effective_gain and torque of this sample into the row.

        Args:
            time: [s].
            before: The setpoint of the sample before, where Psi_hat leads.
        """
        if self.lead is not None and before is not None:
            look_ahead(self.row, self.at, before, self.lead.ahead)
        if self.python is not None:
            try:
                if isinstance(self.python, LearningLaw):
                    self._learning_law(time, self.python)
                else:
                    self._python(time, self.python)
            except InputError:
                raise
            except Exception as error:
                raise blamed(error, self.python) from error
            return
        if self.lead is not None:
            self.estimate_ahead(self.lead)
        if self.model is not None:
            self._model_psi(self.model, self.row)
        if self.learner is not None:
            estimate(self.row, self.at, self.learner, self.state.values)
        if self.lead is not None:  # networks have learned by now: their weights are those of this sample's psi_hat
            law.step(self.lead.ahead.row, self.at, self.lead.ahead.law, self.state.values, None, None)
        law.step(self.row, self.at, self.law.numbers, self.state.values, self.limits, self.ahead)
        self.keep()

    def estimate_ahead(self, lead: Lead) -> None:
        """What model and learner say where the torque acts, into the row there: a learner says first, then learns."""
        if self.model is not None:
            self._model_psi(self.model, lead.ahead.row)
        if lead.learner is not None:
            estimate(lead.ahead.row, self.at, lead.learner, self.state.values)

    def keep(self) -> None:
        """Let a learner remember the torque in the row: the one of the law, or what a supervisor made of it."""
        if self.learner is not None:
            settle(self.row, self.at, self.learner, self.state.values)

    def features(self) -> Array | None:
        """What the weights were multiplied with at the last step, (rows, k) or (k,); None where it is not told."""
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

    def _learning_law(self, time: float, controller: LearningLaw) -> None:
        """`tau = K s + Psi_hat` of a law in plain Python, and what it learns."""
        if self.ahead is not None:
            self.later.refresh(time + self.ahead.time)
            self.ahead.row[self.layout.where("psi_hat")] = self._of_shape(
                "Psi_hat", controller.estimate(self.later, self.state)
            )
        self.sample.refresh(time)
        self.psi_hat[:] = self._of_shape("Psi_hat", controller.estimate(self.sample, self.state))
        self.gain[:] = self.K
        self.weight_norm[:] = norms(controller.weights(self.state), self.layout)
        self._answer(self.K * self.sample.s)
        if controller.learning:
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
        """The same, if there is one number per velocity.

        Raises:
            ConfigError: There is not.
        """
        if np.shape(values) != self.torque.shape:
            raise ConfigError(
                f"controller '{self.controller.name}' returned a {what} of shape {np.shape(values)}",
                fix=f"return an array of shape {self.torque.shape}",
            )
        return values

    def _model_psi(self, model: Terms, row: Array) -> None:
        """Psi of the nominal model at the state that a row measures, into its psi_hat."""
        at, psi_hat = self.at, row[self.at[PSI_HAT] : self.at[PSI_HAT + 1]]
        pose, velocity = row[at[POSE] : at[POSE + 1]], row[at[VELOCITY] : at[VELOCITY + 1]]
        q, qdot = row[at[Q] : at[Q + 1]], row[at[QDOT] : at[QDOT + 1]]
        as_measured(*self.arm_map, pose, velocity, q, qdot, self.position, self.nu)
        model.refresh(self.position, self.nu)
        nu_ref, nudot_ref = row[at[NU_REF] : at[NU_REF + 1]], row[at[NUDOT_REF] : at[NUDOT_REF + 1]]
        model.refresh_psi(nu_ref, nudot_ref, psi_hat)
