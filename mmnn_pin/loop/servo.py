"""Velocities that take a velocity command instead of a torque: nu split into effort rows e and servo rows s.

**On s** the robot's own servo closes a loop, here taken as `nudot_s = b (u - nu_s) + rest`. Its command is

    u = nu_ref + nudot_ref / b + k s + psi,    dpsi/dt = rate s,    s = nu_ref - nu

so that `ds/dt = -b (1 + k) s - b psi - rest`: the integral psi, in units of velocity, takes the rest.

**On e** the torque law is what it was, for the robot whose servo rows move by themselves. The signals that it reads say
on s what the robot does, not what it should do: `nu_ref := nu_s` measured, `nudot_ref := b (u - psi - nu_s)` of the
servo's model with the rest that psi has found, and `s := 0`. So Psi_e contains `M_es nudot_s + C_es nu_s`, an error
of s enters no torque and teaches nothing, and as before, with `M_ee' - 2 C_ee` skew,

    V = 1/2 r' M_ee r,    dV/dt = -r' K r

`ask` comes before the torque law, `answered` after it.

In a simulation `VelocityServo` stands for the robot's servo: a torque within limits, with a bandwidth and a delay.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..actuator import Drive
from ..by_address import by_address
from ..compiled import internal, linked
from ..elementary.matrices import product, pseudo_inverse, solve
from ..errors import ConfigError, UnknownName
from ..model.robot import Robot
from ..model.tree.twin import Twin
from ..settings import Numbers, Settings, one_or_each, require_numbers
from ..signals import INDEX, Array, IntArray
from ..torque.controller import CompiledController, Context, TorqueController
from ..torque.law import KERNELS, nothing_to_keep
from .before_run import viscous_friction

EFFORT, VELOCITY, POSITION = "effort", "velocity", "position"
NU_REF, NUDOT_REF, Z, R = (INDEX[name] for name in ("nu_ref", "nudot_ref", "z", "r"))
MEASURED_BASE, MEASURED_ARM = INDEX["velocity"], INDEX["qdot"]
PSI_HAT, PSI_APPLIED, TORQUE, Q = (INDEX[name] for name in ("psi_hat", "psi_applied", "torque", "q"))
BRAKING = 2.0  # of a stop [m/s^2, rad/s^2]
TUNED = 2.0  # times viscous friction that a servo's gain has beside its bandwidth


class Servo(Settings, frozen=True):
    """What is known of the servos of velocity and position interfaces, and the law that commands them.

    Args:
        bandwidth: b, one number or one per velocity [1/s].
        gain: k of the error, one number or one per velocity.
        rate: Of the integral, one number or one per velocity [1/s].
        delay: Of the simulated servo beside the latency [s].
        strength: Largest torque of the simulated servo over the URDF's effort limit; joints without one have none.

    Raises:
        ConfigError: A number that is negative or not finite, or a bandwidth of 0.
    """

    bandwidth: Numbers = 30.0
    gain: Numbers = 0.2
    rate: Numbers = 1.0
    delay: float = 0.0
    strength: float = 1.0

    def __post_init__(self) -> None:
        require_numbers(self, "servo", {"bandwidth", "strength"})


class Command(NamedTuple):
    """What to send after a sample: views that the next step overwrites, NaN where the other interface holds.

    Attributes:
        effort: (p,) on nu: forces on the base, torques of the joints [N, N m; N m or N].
        velocity: (p,) base velocity and rates of the joints [m/s, rad/s; rad/s or m/s].
        position: (p,) of joints that take nothing else: their velocity, integrated [rad or m].
        motor_effort: (motors,) the same at the motors, drive wheels from left to right, then the arm [N m or N].
        motor_velocity: (motors,) likewise [rad/s or m/s].
    """

    effort: Array
    velocity: Array
    position: Array
    motor_effort: Array
    motor_velocity: Array


@by_address
class Split(NamedTuple):
    """The servo rows of one robot: numbers of their law and what it remembers.

    Attributes:
        on: (p,) 1 on s, 0 on e.
        numbers: (3, p) b, k, rate.
        h: Control period [s].
        integral: (p,) psi.
        command: (p,) u of the last sample.
        place: (n,) positions by integration of u, for joints that take nothing else.
        kept: (p,) errors s, put back into the row for those who look at it.
        begun: (1,) 1 once `place` is where a joint was measured.
    """

    on: Array
    numbers: Array
    h: float
    integral: Array
    command: Array
    place: Array
    kept: Array
    begun: Array


def interfaces_of(robot: Robot, given: Mapping[str, str] | None) -> tuple[tuple[str, ...], Array]:
    """The interface of every velocity, and (p,) which are servo rows.

    Args:
        robot: The robot.
        given: Interface of joints with a motor, by name; effort for those that are not named.

    Raises:
        UnknownName: A joint without a motor, or an interface that does not exist.
        ConfigError: Wheels of one base with different interfaces.
    """
    names, given = robot.actuator_names, given or {}
    for joint, kind in given.items():
        if joint not in names:
            raise UnknownName("joint", joint, names, key="interfaces")
        if kind not in (EFFORT, VELOCITY, POSITION):
            raise UnknownName("interface", kind, (EFFORT, VELOCITY, POSITION), key=f"interfaces.{joint}")
    nb, wheels = robot.dimensions.base, names[: len(names) - robot.dimensions.arm]
    found = {given.get(name, EFFORT) for name in wheels}
    if len(found) > 1 or POSITION in found:
        why, fix = "one velocity of the base moves all wheels", "use effort, or velocity, for all of them"
        raise ConfigError(f"wheels by {' and '.join(sorted(found))}", why=why, fix=fix, key="interfaces")
    base = found.pop() if found else EFFORT
    kinds = (base,) * nb + tuple(given.get(name, EFFORT) for name in robot.joint_names)
    return kinds, np.array([float(kind != EFFORT) for kind in kinds])


def split_of(robot: Robot, on: Array, servo: Servo, period: float, state: Array) -> Split | None:
    """The servo rows of a robot; None where all rows take effort.

    Args:
        robot: The robot.
        on: (p,) which rows, of `interfaces_of`.
        servo: Their law.
        period: Control period [s].
        state: (size,) what it remembers, see `state_size`.

    Raises:
        ConfigError: Neither one number nor one per velocity.
    """
    if not on.any():
        return None
    p, numbers = on.size, laws(robot, servo)
    integral, command, place, begun = np.split(state, (p, 2 * p, 2 * p + robot.dimensions.arm))
    return Split(on, numbers, period, integral, command, place, np.zeros(p), begun)


def laws(robot: Robot, servo: Servo) -> Array:
    """b, k and rate of every velocity, (3, p); errors as of `split_of`."""
    p, names = robot.dimensions.dof, ("bandwidth", "gain", "rate")
    return np.array([one_or_each(getattr(servo, name), p, "velocity", f"servo.{name}") for name in names])


def state_size(on: Array, arm: int) -> int:
    """How many numbers the servo rows remember."""
    return 2 * on.size + arm + 1 if on.any() else 0


def needs_torques(controller: CompiledController | TorqueController, context: Context) -> bool:
    """Whether a controller learns from the torque of every row: on servo rows nobody knows it."""
    learner = controller.law(context).learner if isinstance(controller, CompiledController) else None
    return learner is not None and KERNELS[type(learner)].settle is not nothing_to_keep


def require_no_torque_regressor(controller: CompiledController | TorqueController, context: Context) -> None:
    """Refuse what `needs_torques` on servo rows.

    Raises:
        ConfigError: It does.
    """
    if needs_torques(controller, context):
        why = "it goes by the torque of every velocity, and on a velocity interface there is none to know"
        fix = "use pd, pd_gravity, computed_torque, two_layer, one_layer, adaptive or disturbance_observer"
        raise ConfigError(f"{controller.name} on a velocity interface", why=why, fix=fix, key="interfaces")


@linked
def ask(row: Array, at: IntArray, split: Split) -> None:
    """The servos' commands of a sample; what the torque law reads on s becomes what the robot does there."""
    nb = at[Z + 1] - at[Z]
    for i in range(split.on.size):
        if split.on[i] > 0.0:
            error = at[Z] + i if i < nb else at[R] + i - nb
            nu = row[at[MEASURED_BASE] + i] if i < nb else row[at[MEASURED_ARM] + i - nb]
            b, k, rate = split.numbers[0, i], split.numbers[1, i], split.numbers[2, i]
            s = row[at[NU_REF] + i] - nu
            split.integral[i] += split.h * rate * s
            split.command[i] = row[at[NU_REF] + i] + row[at[NUDOT_REF] + i] / b + k * s + split.integral[i]
            split.kept[i], row[error] = row[error], 0.0
            row[at[NU_REF] + i] = nu
            row[at[NUDOT_REF] + i] = b * (split.command[i] - split.integral[i] - nu)


@linked
def answered(row: Array, at: IntArray, stopped: bool, split: Split) -> None:
    """No torque on s, and its errors back in the row; where the controller was not asked the commands brake, too."""
    nb = at[Z + 1] - at[Z]
    n = split.on.size - nb
    for i in range(split.on.size):
        if split.on[i] > 0.0:
            row[at[TORQUE] + i], row[at[PSI_HAT] + i] = 0.0, 0.0
            if at[PSI_APPLIED + 1] > at[PSI_APPLIED]:
                row[at[PSI_APPLIED] + i] = 0.0
            if not stopped:
                row[at[Z] + i if i < nb else at[R] + i - nb] = split.kept[i]
            else:
                step = BRAKING * split.h
                split.command[i] -= min(max(split.command[i], -step), step)
                split.integral[i] = 0.0
    for j in range(n):
        if split.begun[0] == 0.0:
            split.place[j] = row[at[Q] + j]
        split.place[j] += split.h * split.command[nb + j]
    split.begun[0] = 1.0


@by_address
class VelocityServo(NamedTuple):
    """Servos of motors in a simulation: `torque = gain (error + stiffness int error dt)`, `error = asked - speed`.

    The torque is within limits, and some steps of the plant late. The integral, which carries a weight, stands still
    while the torque is at its limit; with a stiffness of a quarter of the bandwidth the servo is critically damped.

    Attributes:
        dt: Step of the plant [s].
        on: (motors,) 1 for a motor with a servo.
        gain: (motors,) bandwidth times the inertia that the motor alone moves, and more against its viscous friction
            [N m s or N s/m].
        stiffness: (motors,) of the integral [1/s].
        limit: (motors,) largest torque [N m or N].
        E: (p, motors) speeds of the motors are E' nu.
        command: (p,) what is asked of nu, written by `ask`.
        ring: (slots + 1, motors) state: what was asked in the last steps, and the integrals [rad or m].
    """

    dt: float
    on: Array
    gain: Array
    stiffness: Array
    limit: Array
    E: Array
    command: Array
    ring: Array

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Put the servos' torques in place of what is commanded."""
        slots, n = self.ring.shape[0] - 1, int(time / self.dt + 0.5)
        for j in range(wire.torque.size):
            if self.on[j] > 0.0:
                asked = 0.0
                for i in range(self.command.size):
                    asked += self.E[i, j] * self.command[i]
                self.ring[n % slots, j] = asked
                error, integral = self.ring[(n + 1) % slots, j] - wire.joint[j], self.ring[slots, j]
                torque = self.gain[j] * (error + self.stiffness[j] * integral)
                wire.torque[j] = min(max(torque, -self.limit[j]), self.limit[j])
                if abs(torque) <= self.limit[j] or torque * error < 0.0:
                    self.ring[slots, j] = integral + self.dt * error


def velocity_servo(robot: Robot, servo: Servo, split: Split, dt: float, ring: Array) -> VelocityServo:
    """The simulated servos of a robot's servo rows.

    Args:
        robot: The robot.
        servo: Their settings.
        split: The rows.
        dt: Step of the plant [s].
        ring: (slots, motors) state, see `servo_slots`.
    """
    on, gain, stiffness = servo_motors(robot, split.on, split.numbers[0])
    E, limit = np.ascontiguousarray(robot.E), servo.strength * robot.effort_limits
    return VelocityServo(dt, on, gain, stiffness, limit, E, split.command, ring)


def servo_motors(robot: Robot, on: Array, bandwidth: Array) -> tuple[Array, Array, Array]:
    """Which motors have a servo, its gain and its stiffness, (motors,) each, of `VelocityServo`.

    Args:
        robot: The robot.
        on: (p,) which rows are servo rows.
        bandwidth: (p,) of them [1/s].
    """
    E = np.ascontiguousarray(robot.E)
    M = Twin(robot).mass_matrix(robot.neutral_position())
    inertia = 1.0 / np.diag(product(E.T, solve(M, E)))  # what a motor alone moves
    moves = np.abs(E) > 0.0
    b = np.array([bandwidth[rows].min() for rows in moves.T])
    back = pseudo_inverse(E)
    damping = np.diag(product(back, viscous_friction(robot), back.T))
    return (on @ moves > 0.0).astype(float), b * inertia + TUNED * damping, 0.25 * b


def servo_slots(servo: Servo, latency: float, dt: float) -> int:
    """Rows of a servo's state: a command per step of its way [s] and of the servo's own delay, one more, integrals."""
    return round((servo.delay + latency) / dt) + 2


class LinearServos(NamedTuple):
    """Servo rows in the linearised loop that is judged before a run.

    Attributes:
        law: As stated.
        on: (p,) 1 on s, 0 on e.
        numbers: (3, p) b, k, rate.
        E: (p, m) of the m motors with a servo.
        gain: (m,) as in `VelocityServo`.
        stiffness: (m,) likewise [1/s].
        simulated: Whether they are `VelocityServo`, else what the law takes them for, `nudot_s = b (u - nu_s)`.
    """

    law: Servo
    on: Array
    numbers: Array
    E: Array
    gain: Array
    stiffness: Array
    simulated: bool


def linear_servos(robot: Robot, given: Mapping[str, str] | None, law: Servo, simulated: bool) -> LinearServos | None:
    """The servo rows of a robot; None where all rows take effort.

    Errors as of `interfaces_of` and `split_of`.
    """
    _, on = interfaces_of(robot, given)
    return servos_on(robot, on, law, simulated) if on.any() else None


def servos_on(robot: Robot, on: Array, law: Servo, simulated: bool) -> LinearServos:
    """The servos of these rows, (p,); errors as of `split_of`."""
    numbers = laws(robot, law)
    motors, gain, stiffness = servo_motors(robot, on, numbers[0])
    there = motors > 0.0
    return LinearServos(law, on, numbers, robot.E[:, there], gain[there], stiffness[there], simulated)
