"""One control sample, from reference and measurement to the torque that is sent, in the ordinary loop and outside."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.random import Generator

from ..errors import ConfigError, InputError
from ..model.dynamics import Dynamics
from ..model.reduction import as_measured
from ..model.regressor import Regressor
from ..model.robot import Robot
from ..signals import Array, Measurement, Reference, VelocityCommand
from ..torque import law
from ..torque.controller import CompiledController, Context, ControllerState, TorqueController
from ..torque.law import estimate, limit, motor_limits, settle
from ..torque.learning_law import LearningLaw, Sample, blamed, norms
from .hardware import Hardware, is_stopped, send
from .sample import before_torque

if TYPE_CHECKING:
    from .loop import Loop

REGRESSORS: WeakKeyDictionary[Robot, Regressor] = WeakKeyDictionary()


def context_of(
    controller: CompiledController | TorqueController,
    robot: Robot,
    period: float,
    samples: int,
    rng: Generator,
    within_limits: bool | None = None,
) -> Context:
    """What a controller is told before a run of a robot; how it moves only where a learning law asks for it.

    Args:
        controller: The controller.
        robot: Its robot.
        period: Control period [s].
        samples: Of the run.
        rng: The controller's own random generator.
        within_limits: Whether Psi_hat is kept within the motors' limits; None for what the controller says.
    """
    told = isinstance(controller, LearningLaw) and controller.knows_motion
    kept = controller.within_limits if within_limits is None else within_limits
    limits = motor_limits(robot.E, robot.effort_limits) if kept else None
    return Context(robot.layout, period, samples, rng, regressor_of(robot) if told else None, limits)


def regressor_of(robot: Robot) -> Regressor:
    """The regressor of a robot, made once.

    Raises:
        RobotError: A joint that cannot be flattened.
    """
    if robot not in REGRESSORS:
        REGRESSORS[robot] = Regressor.of(robot)
    return REGRESSORS[robot]


class Control:
    """Kinematic layer, controller and supervisor wired to one row.

    Args:
        loop: The closed loop.
        row: The row that they read and write.
        state: The controller's memory.
        hardware: With the supervisor, or None.
    """

    def __init__(self, loop: Loop, row: Array, state: Any, hardware: Hardware | None) -> None:
        layout = loop.robot.layout
        self.row, self.at, self.hardware, self.arm = row, layout.offsets, hardware, loop.robot.arm_index
        self.torque = Torque(loop.controller, loop.context(), row, loop.believed, state)
        self.gains, self.K = loop.kinematic.base_gains(layout.base), loop.kinematic.arm_gains(layout)
        self.weights = state.values if isinstance(state, ControllerState) else np.zeros(0)

    def step(self, k: int, time: float, y: Array, reference: Array, measure_exactly: bool) -> None:
        """Write everything of control sample k up to the torque into the row.

        Args:
            k: Number of the sample.
            time: [s].
            y: The plant's position and nu, (nv + p + 1,).
            reference: The sample's row of the reference table.
            measure_exactly: Measure that state, else the row already has the measurement.
        """
        before_torque(self.row, self.at, time, y, reference, measure_exactly, self.arm, self.gains, self.K)
        asked = self.hardware is None or not is_stopped(self.hardware.supervisor.on, self.hardware.supervisor.state)
        if asked:
            self.torque.step(time)
        if self.hardware is not None:
            send(k, time, self.row, self.at, self.weights, self.hardware)
            if asked:
                self.torque.keep()


class Torque:
    """One controller wired to one row; the same face for compiled and for Python controllers.

    Args:
        controller: The controller.
        context: What it is told before the run.
        row: The row it reads and writes.
        nominal: The robot that a controller believes in which uses a model and brings none.
        state: Its memory.
    """

    def __init__(
        self,
        controller: TorqueController | CompiledController,
        context: Context,
        row: Array,
        nominal: Robot,
        state: Any,
    ) -> None:
        layout = context.layout
        self.controller, self.state, self.row, self.at = controller, state, row, layout.offsets
        self.limits = context.limits
        self.reference, self.measurement = Reference.of(row, layout), Measurement.of(row, layout)
        self.command = VelocityCommand.of(row, layout)
        self.torque, self.psi_hat = row[layout.where("torque")], row[layout.where("psi_hat")]
        self.gain, self.weight_norm = row[layout.where("effective_gain")], row[layout.where("weight_norm")]
        self.model: Dynamics | None = None
        self.learner: Any = None
        self.python = controller if isinstance(controller, TorqueController) else None
        if isinstance(controller, LearningLaw):
            self.layout, self.sample, self.K = layout, Sample.of(row, context), controller.feedback_gain(layout)
        if isinstance(controller, CompiledController):
            self.law = controller.law(context)
            self.learner = self.law.learner
            if controller.uses_model:
                believed: Robot = controller.model or nominal
                self.model, self.arm_map = Dynamics(believed), believed.arm_map()
                self.position, self.nu = believed.neutral_position(), np.zeros(layout.dof)

    def step(self, time: float) -> None:
        """Write psi_hat, robust, effective_gain and torque of this sample into the row."""
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
        if self.model is not None:
            self._model_psi(self.model)
        if self.learner is not None:
            estimate(self.row, self.at, self.learner, self.state.values)
        law.step(self.row, self.at, self.law.numbers, self.state.values, self.limits)
        self.keep()

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
        answer = controller.step(time, self.reference, self.measurement, self.command, self.state)
        torque, psi_hat = answer if isinstance(answer, tuple) and len(answer) == 2 else (answer, None)
        self.torque[:] = self._of_shape("torque", torque)
        if psi_hat is not None:
            self.psi_hat[:] = self._of_shape("Psi_hat", psi_hat)
            if self.limits is not None:
                self._answer(self.torque - self.psi_hat)

    def _learning_law(self, time: float, controller: LearningLaw) -> None:
        """`tau = K s + Psi_hat` of a law in plain Python, and what it learns."""
        self.sample.refresh(time)
        self.psi_hat[:] = self._of_shape("Psi_hat", controller.estimate(self.sample, self.state))
        self.gain[:] = self.K
        self.weight_norm[:] = norms(controller.weights(self.state), self.layout)
        self._answer(self.K * self.sample.s)
        if controller.learning:
            controller.learn(self.sample, self.state)

    def _answer(self, feedback: Array) -> None:
        """The torque: a feedback (p,) and Psi_hat, this within the motors' limits where it is to be."""
        if self.limits is not None:
            limit(self.psi_hat, feedback, self.limits)
        self.torque[:] = feedback + self.psi_hat

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

    def _model_psi(self, model: Dynamics) -> None:
        """Psi of the nominal model at the measured state, into psi_hat."""
        m = self.measurement
        as_measured(*self.arm_map, m.pose, m.velocity, m.q, m.qdot, self.position, self.nu)
        model.refresh(self.position, self.nu)
        model.refresh_psi(self.command.nu_ref, self.command.nudot_ref, self.psi_hat)
