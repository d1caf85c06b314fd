"""One control sample, as the picture of the loop shows it: setpoint -> kinematic -> torque -> safety.

    time, measurement, setpoint -> [kinematic] -> [torque] -> [safety] -> torque to the motors

`Control.step` is that sample for the ordinary loop and for a loop of one's own (`stepper`); the compiled loop calls the
same compiled functions. All of it happens in one row of signals. `before_torque` is what comes before the controller,
`after_torque` what only a simulation knows: the true state, the energy balance and the guard.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import kinematic
from ..compiled import compiled, copy_to, entry, linked
from ..elementary.matrices import pseudo_inverse
from ..model.robot import Robot
from ..parts import vector, view
from ..plant.contact.feet import Contact
from ..settings import Timing
from ..signals import INDEX, Array, IntArray, Layout
from ..torque.controller import CompiledController, Context, ControllerState, TorqueController
from .controller import Torque
from .hardware import Hardware, is_stopped, send
from .lead import Lead, catch_up, reference_then
from .servo import answered, ask
from .servo_model import LinearServos

TIME, POSITION, NU, POSE_REF, POSE = (INDEX[n] for n in ("time", "position", "nu", "pose_ref", "pose"))
ALPHA, Q_REF, TORQUE, MOTOR_TORQUE = (INDEX[n] for n in ("alpha", "q_ref", "torque", "motor_torque"))
TRUE_POSE_ERROR, TRUE_Z, TRUE_E = (INDEX[n] for n in ("true_pose_error", "true_z", "true_e"))
ENERGY, WORK, RESIDUAL = (INDEX[n] for n in ("energy", "work", "energy_residual"))


@linked
def before_torque(row: Array, at: IntArray, time: float, setpoint: Array, gains: Array, K: Array) -> None:
    """Everything of a sample up to the controller: time, setpoint, velocity command; the measurement is in the row.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        time: [s].
        setpoint: The signals `pose_ref` ... `qddot_ref` side by side, as in a trajectory's table.
        gains: (3,) of the kinematic layer.
        K: (n,) gain of the filtered arm error [1/s].
    """
    row[at[TIME]] = time
    copy_to(setpoint, vector(row, at[POSE_REF], at[POSE] - at[POSE_REF]))
    kinematic.command(row, at, gains, K)


@linked
def after_torque(
    row: Array,
    at: IntArray,
    y: Array,
    arm: IntArray,
    M: Array,
    E_inv: Array,
    potential: float,
    start: float,
    bounds: Array,
) -> int:
    """True state and errors, motor torques, energy balance and the guard of a sample.

    Args:
        row: (width,) row of signals with the torque.
        at: Offsets of the signals.
        y: (nv + p + 1,) the plant's position, nu, and the work done on it.
        arm: (n,) places of the arm joints in the position.
        M: (p, p) mass matrix.
        E_inv: (motors, p) motor torques from the torque on nu.
        potential: Potential energy [J].
        start: Energy at the start [J].
        bounds: (p,) on |nu|.

    Returns:
        -1, or the first column that is not finite or a velocity that is out of bounds.
    """
    position, nu, work = view(row, at, POSITION), view(row, at, NU), y[y.size - 1]
    copy_to(y[: position.size], position)
    copy_to(y[position.size : y.size - 1], nu)
    true_errors(row, at, position, nu, arm)
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
def true_errors(row: Array, at: IntArray, position: Array, nu: Array, arm: IntArray) -> None:
    """The tracking errors of the true state, which no controller sees: true_pose_error, true_z, true_e."""
    pose_ref, z = view(row, at, POSE_REF), view(row, at, TRUE_Z)
    if pose_ref.size:
        kinematic.body_error(pose_ref, position, view(row, at, TRUE_POSE_ERROR))
    for i in range(z.size):
        z[i] = row[at[ALPHA] + i] - nu[i]
    for i in range(arm.size):
        row[at[TRUE_E] + i] = row[at[Q_REF] + i] - position[arm[i]]


@dataclass(frozen=True, eq=False)
class Plan:
    """What an engine needs of a loop, looked up and checked.

    Attributes:
        robot: The robot, as all but its plant take it.
        true: The true robot, which may roll on wheels of other radii.
        layout: Where the signals stand in a row.
        timing: Periods.
        controller: The controller.
        context: What it is told before the run.
        believed: The robot that it believes in, where it uses a model.
        gains: (3,) of the kinematic layer.
        K: (n,) gain of the filtered arm error [1/s].
        bounds: (p,) on |nu|, beyond which a state counts as lost.
        setpoints: The setpoint of every control sample, (samples, ...).
        loaded: The robot once it has picked up its payload; None without one.
        contact: The floor of the contact plant; None for the ideal plant.
        block: Samples that an engine hands over at a time.
        latency: Known delay between measurement and torque, for the check of the gains [s].
        lag: Time constant of the motors, one number or one per motor, for the same [s].
        servo: What the servos of velocity interfaces amount to, for the same; None without any.
        lead: How Psi_hat looks ahead to where the torque acts; None where it does not.
        age: By how much measurements are brought up to now [s].
    """

    robot: Robot
    true: Robot
    layout: Layout
    timing: Timing
    controller: TorqueController | CompiledController
    context: Context
    believed: Robot
    gains: Array
    K: Array
    bounds: Array
    setpoints: Array
    loaded: Robot | None = None
    contact: Contact | None = None
    block: int = 1
    latency: float = 0.0
    lag: float | tuple[float, ...] = 0.0
    servo: LinearServos | None = None
    lead: Lead | None = None
    age: float = 0.0

    @property
    def E_inv(self) -> Array:
        """(motors, p) motor torques from the torque on nu."""
        return pseudo_inverse(self.robot.E)


class Control:
    """Kinematic layer, controller and supervisor wired to one row.

    Args:
        plan: Of the loop.
        row: The row that they read and write.
        state: The controller's state.
        hardware: With the supervisor, or None.
    """

    def __init__(self, plan: Plan, row: Array, state: Any, hardware: Hardware | None) -> None:
        self.row, self.at, self.hardware = row, plan.layout.offsets, hardware
        self.gains, self.K, self.age, self.back = plan.gains, plan.K, plan.age, plan.age / plan.timing.control_period
        self.setpoints, self.then = plan.setpoints, plan.setpoints[0].copy()
        self.torque = Torque(plan.controller, plan.context, row, plan.believed, state, plan.lead)
        self.weights = state.values if isinstance(state, ControllerState) else np.zeros(0)

    def step(self, time: float, setpoint: Array, k: int = 0, before: Array | None = None) -> None:
        """Write everything of a control sample up to the torque into the row, which has the measurement.

        Args:
            time: [s].
            setpoint: The signals `pose_ref` ... `qddot_ref` side by side.
            k: Number of the sample, where commands may get lost on their way.
            before: The setpoint of the sample before, from which Psi_hat may lead; None for the same one.
        """
        if self.age > 0.0:
            reference_then(self.setpoints, k, self.back, self.then)
            catch_up(self.row, self.at, setpoint, self.then, self.age)
        before_torque(self.row, self.at, time, setpoint, self.gains, self.K)
        hardware = self.hardware
        asked = hardware is None or not is_stopped(hardware.way.supervisor.on, hardware.way.supervisor.state)
        split = None if hardware is None else hardware.split
        if split is not None and asked:
            ask(self.row, self.at, split)
        if asked:
            self.torque.step(time, setpoint if before is None else before)
        if split is not None:
            answered(self.row, self.at, not asked, split)
        if hardware is not None:
            send(k, time, self.row, self.at, self.weights, hardware.way)
            if asked:
                self.torque.keep()
