"""The model of a robot's servos: a torque within limits, with a bandwidth and a delay.

Before a run it is that, or what the law of `servo` takes servos for, in the linearised loop that is judged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..actuator import Actuator, Drive, MotorState
from ..by_address import by_address
from ..compiled import compiled, internal
from ..elementary import exp
from ..elementary.matrices import product, pseudo_inverse
from ..model.base.steered import SteeredBase
from ..model.checks.properties import random_state
from ..model.robot import Robot, limits
from ..model.tree.twin import Twin
from ..settings import one_or_each
from ..signals import Array, IntArray
from .before_run import viscous_friction
from .servo import EFFORT, POSITION, Servo, Split, interfaces_of, laws, movers, own_velocities, through_servos

TINY = 1e-9  # damping of a position servo without any [N m s/rad or N s/m]
PLACES = 20  # at which inertias are looked at
TUNED = 2.0  # times viscous friction that a servo's gain has beside its bandwidth


@by_address
class Servos(NamedTuple):
    """Servos of motors in a simulation, solved together with the robot that they move.

    A position servo gives `Kp e + Ki int e dt - Kd w` at an error e of the joint, whose speed is w. An error within its
    dead band is none, the goal may move by a profile, and what stands before Kd w is a voltage, which has a limit. A
    velocity servo gives `Kd (u - w) + Kp int (u - w) dt`; with `Kp = b / 4 Kd` it is critically damped. So does a servo
    of positions that is known by its bandwidth alone: it moves between the positions that it is sent. All torques are
    within limits, and some steps of the plant late.

    **In the plant's own solve.** A servo that is stiff for a light joint would chatter if its torque was that of the
    start of a step. It is that of the end: with `w = free + W torque` of `plant.integrators.respond`, and c what a
    servo's torque falls by per speed, `torque = a - c w` of all servos at once within their limits, by projected
    Gauss-Seidel. A servo with a period of its own samples its error so often, and holds what it makes of it; what the
    speed brakes in a winding, Kd of a position servo, it does all the time.
    """

    dt: float  # step of the plant [s]
    on: Array  # (motors,) 1 for a motor with a servo
    placed: IntArray  # (motors,) its place in `place`, for a position servo; negative for others
    # (7, motors) Kp, Kd, Ki, largest torque of the PID, dead band, largest speed and acceleration of the profile; 0 for
    # none
    law: Array
    every: IntArray  # (motors,) steps of the plant between two samples of a servo
    limit: Array  # (motors,) largest torque [N m or N]
    E: Array  # (p, motors) speeds of the motors are E' nu
    command: Array  # (p,) what is asked of nu, written by `ask`
    place: Array  # (m,) positions that are sent, likewise [rad or m]
    # (motors,) inertia that the servo turns inside a gap of the gear, 0 where there is none [kg m^2 or kg]
    rotor: Array
    share: Array  # (motors,) of a servo's torque that acts at the end of a step, by lag and torque constant
    kept: Array  # (motors,) of the torque before that still does, by lag
    states: MotorState  # state of the motors
    ring: Array  # (slots + ROWS, motors) state: what was asked in the last steps, and the rows below
    work: Array  # (2, motors) scratch: c, and the speeds at the end of the step

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Put the servos' torques in place of what is commanded."""
        slots, n, slope = self.ring.shape[0] - ROWS, int(time / self.dt + 0.5), self.work[0]
        for j in range(wire.torque.size):
            if self.on[j] > 0.0:
                at_place, asked = self.placed[j] >= 0, 0.0
                if at_place:
                    asked = self.place[self.placed[j]]
                    if self.ring[slots + BEGUN, j] == 0.0:
                        self.ring[:slots, j] = asked
                        self.ring[slots + BEGUN, j], self.ring[slots + GOAL, j] = 1.0, wire.angle[j]
                else:
                    for i in range(self.command.size):
                        asked += self.E[i, j] * self.command[i]
                self.ring[n % slots, j] = asked
                asked = self.ring[(n + 1) % slots, j]
                if at_place:
                    slope[j] = hold_position(j, n, asked, wire, self)
                else:
                    slope[j] = hold_velocity(j, n, asked, wire, self)
        balance(wire, self)
        for j in range(wire.torque.size):
            if self.on[j] > 0.0:
                wire.torque[j] = self.ring[slots + TORQUE, j]
                if self.placed[j] < 0 and self.every[j] == 1:
                    keep(j, self.ring[(n + 1) % slots, j] - self.work[1, j], self.dt, self)


INTEGRAL, HELD, GOAL, GOAL_SPEED, TORQUE, BEGUN, ROWS = range(7)  # of the ring, behind its slots
KP, KD, KI, STALL, DEAD, FASTEST, STEEPEST = range(7)  # of the law
SWEEPS, CLOSE = 100, 1e-12  # of Gauss-Seidel at most, and the change that is none


@compiled
def hold_position(j: int, n: int, asked: float, wire: Drive, servos: Servos) -> float:
    """Write what a position servo gives at rest into the row `HELD`, as of step n; how much it falls with speed."""
    law, ring = servos.law, servos.ring[servos.ring.shape[0] - ROWS :]
    angle = wire.angle[j] + (servos.states.ahead[j] if servos.rotor[j] > 0.0 else 0.0)
    follow(j, asked, servos.dt, law, ring)
    if n % servos.every[j] == 0:
        error = ring[GOAL, j] - angle
        if abs(error) <= law[DEAD, j]:
            error = 0.0
        if law[KI, j] > 0.0:
            keep(j, error, servos.dt * servos.every[j], servos)
        wanted, most = law[KP, j] * error + law[KI, j] * ring[INTEGRAL, j], law[STALL, j]
        ring[HELD, j] = min(max(wanted, -most), most) if most > 0.0 else wanted
        if servos.every[j] == 1 and error != 0.0 and ring[HELD, j] == wanted:
            return law[KD, j] + servos.dt * law[KP, j]
    return law[KD, j]


@compiled
def follow(j: int, asked: float, dt: float, law: Array, ring: Array) -> None:
    """Move a position servo's goal towards what is asked, by its profile: a trapezoid of speed."""
    fastest, steepest = law[FASTEST, j], law[STEEPEST, j]
    if fastest == 0.0 and steepest == 0.0:
        ring[GOAL, j] = asked
        return
    left = asked - ring[GOAL, j]
    speed = abs(left) / dt
    if fastest > 0.0:
        speed = min(speed, fastest)
    if steepest > 0.0:
        braking = 0.5 * steepest * dt  # of a speed v that ends after v / (a dt) steps, a v / 2 is left
        speed = min(speed, max(0.0, math.sqrt(braking * braking + 2.0 * steepest * abs(left)) - braking))
    wanted = speed if left > 0.0 else -speed
    if steepest > 0.0:
        before = ring[GOAL_SPEED, j]
        wanted = min(max(wanted, before - steepest * dt), before + steepest * dt)
    ring[GOAL_SPEED, j] = wanted
    ring[GOAL, j] += dt * wanted


@compiled
def hold_velocity(j: int, n: int, asked: float, wire: Drive, servos: Servos) -> float:
    """Write what a velocity servo gives at rest, likewise."""
    law, ring, dt = servos.law, servos.ring[servos.ring.shape[0] - ROWS :], servos.dt
    if servos.every[j] == 1:
        slope = law[KD, j] + dt * law[KP, j]
        ring[HELD, j] = law[KP, j] * ring[INTEGRAL, j] + slope * asked
        return slope
    if n % servos.every[j] == 0:
        error = asked - (servos.states.rotor_speed[j] if servos.rotor[j] > 0.0 else wire.joint[j])
        keep(j, error, dt * servos.every[j], servos)
        ring[HELD, j] = law[KD, j] * error + law[KP, j] * ring[INTEGRAL, j]
    return 0.0


@compiled
def keep(j: int, error: float, time: float, servos: Servos) -> None:
    """Integrate an error over a time [s], but not further where the torque was at its limit in its direction."""
    ring = servos.ring[servos.ring.shape[0] - ROWS :]
    torque = ring[TORQUE, j]
    if abs(torque) < servos.limit[j] or torque * error < 0.0:
        ring[INTEGRAL, j] += time * error


@internal
def balance(wire: Drive, servos: Servos) -> None:
    """The torques of all servos at the end of a step into the row `TORQUE`: `held - c w`, within limits."""
    slope, speed, ring = servos.work[0], servos.work[1], servos.ring[servos.ring.shape[0] - ROWS :]
    motors, share, kept = wire.torque.size, servos.share, servos.states.torque
    for i in range(motors):
        speed[i] = wire.free[i]
        if servos.rotor[i] > 0.0:
            speed[i] = servos.states.rotor_speed[i]
        for j in range(motors):
            if servos.on[j] > 0.0:
                acting = share[j] * ring[TORQUE, j] + servos.kept[j] * kept[j]
                speed[i] += answer_of(i, j, wire, servos) * acting
    for _ in range(SWEEPS):
        change = 0.0
        for j in range(motors):
            if servos.on[j] > 0.0:
                before, own = ring[TORQUE, j], share[j] * answer_of(j, j, wire, servos)
                wanted = (ring[HELD, j] - slope[j] * (speed[j] - own * before)) / (1.0 + slope[j] * own)
                ring[TORQUE, j] = min(max(wanted, -servos.limit[j]), servos.limit[j])
                step = ring[TORQUE, j] - before
                change = max(change, abs(step) / (1.0 + abs(before)))
                for i in range(motors):
                    speed[i] += answer_of(i, j, wire, servos) * share[j] * step
        if change <= CLOSE:
            break


@compiled
def answer_of(i: int, j: int, wire: Drive, servos: Servos) -> float:
    """Speed of motor i at the end of a step per torque of motor j; a rotor inside a gap moves alone."""
    if servos.rotor[i] > 0.0 or servos.rotor[j] > 0.0:
        return servos.dt / servos.rotor[j] if i == j else 0.0
    return wire.answer[i, j]


def servos_of(
    robot: Robot,
    kinds: Sequence[str],
    servo: Servo,
    actuator: Actuator,
    split: Split,
    memory: tuple[MotorState, Array],
    dt: float,
) -> Servos:
    """The simulated servos of a loop's servo rows.

    Args:
        robot: The robot.
        kinds: Interface of every velocity, of `interfaces_of`.
        servo: What is known of its servos.
        actuator: What is between them and the joints.
        split: The rows.
        memory: State of the motors, and (slots, motors) of the servos, see `servo_slots`.
        dt: Step of the plant [s].

    Raises:
        ConfigError: Neither one number nor one per motor.
    """
    motors, (states, ring) = robot.dimensions.motors, memory

    def of(table: Servo | Actuator, name: str) -> Array:
        return np.array(one_or_each(getattr(table, name), motors, "motor", f"{type(table).__name__.lower()}.{name}"))

    on, gain, stiffness = servo_motors(robot, split.on, split.numbers[0])
    law, placed = position_laws(robot, kinds, servo)
    law[KP], law[KD] = np.where(placed >= 0, law[KP], gain * stiffness), np.where(placed >= 0, law[KD], gain)
    decay = np.array([0.0 if lag == 0.0 else exp(-dt / lag) for lag in of(actuator, "lag")])
    most = limits(actuator.torque_limit, robot.effort_limits, "motor", "actuator.torque_limit")
    return Servos(
        dt=dt,
        on=on,
        placed=placed,
        law=law,
        every=np.array([max(1, round(period / dt)) for period in of(servo, "period")], np.int64),
        limit=np.minimum(servo.strength * robot.effort_limits, most),
        E=split.E,
        command=split.command,
        place=split.place,
        rotor=np.where(of(actuator, "gap") > 0.0, of(actuator, "rotor_inertia"), 0.0),
        share=(1.0 - decay) * of(actuator, "torque_gain"),
        kept=decay,
        states=states,
        ring=ring,
        work=np.zeros((2, motors)),
    )


def position_laws(robot: Robot, kinds: Sequence[str], servo: Servo) -> tuple[Array, IntArray]:
    """The law of `Servos` as far as it is known, (7, motors), and places of what position servos are sent, (motors,).

    A motor without such a servo has the place -1: so does one without a stiffness, which moves between the positions
    that it is sent.
    """
    d, own = robot.dimensions, own_velocities(robot)
    law = np.array([one_or_each(getattr(servo, name), d.motors, "motor", f"servo.{name}") for name in LAW])
    places = {d.motors - d.arm + j: j for j in range(d.arm) if kinds[d.base + j] == POSITION}
    for k, pivot in enumerate(robot.base.masters if isinstance(robot.base, SteeredBase) else ()):
        if kinds[own + k] == POSITION:
            places[robot.actuator_names.index(robot.base.pivots[pivot].joint)] = d.arm + k  # type: ignore[attr-defined]
    placed = np.full(d.motors, -1)
    for motor, j in places.items():
        placed[motor] = j if law[KP, motor] > 0.0 else -1
    return law, placed


LAW = ("stiffness", "damping", "integral", "stall", "dead_band", "profile_speed", "profile_acceleration")  # of `Servo`


def servo_motors(robot: Robot, on: Array, bandwidth: Array) -> tuple[Array, Array, Array]:
    """Which motors have a servo known by its bandwidth, its Kd and Kp over Kd, (motors,) each, of `Servos`.

    Kd is the bandwidth times the inertia that a motor moves while the others hold theirs, the largest at some postures,
    and more against friction.

    Args:
        robot: The robot.
        on: (p,) which rows are servo rows.
        bandwidth: (p,) of them [1/s].
    """
    back = pseudo_inverse(np.ascontiguousarray(robot.E_at(robot.rest)))
    twin, rng, inertia = Twin(robot), np.random.default_rng(0), np.zeros(len(back))
    for i in range(PLACES):
        position = robot.neutral_position() if i == 0 else random_state(robot, rng)[0]
        inertia = np.maximum(inertia, np.diag(product(back, twin.mass_matrix(position), back.T)))
    moves = movers(robot)
    b = np.array([bandwidth[rows].min() for rows in moves.T])
    damping = np.diag(product(back, viscous_friction(robot), back.T))
    return (on @ moves > 0.0).astype(float), b * inertia + TUNED * damping, 0.25 * b


def servo_slots(servo: Servo, latency: float, dt: float) -> int:
    """Rows of a servo's state: a command per step of its way [s] and of its own delay, one more, and what it keeps."""
    return round((servo.delay + latency) / dt) + 1 + ROWS


class LinearServos(NamedTuple):
    """Servo rows in the linearised loop that is judged before a run."""

    law: Servo  # as stated
    kinds: tuple[str, ...]  # (p,) interface of every velocity
    numbers: Array  # (3, p) b, k, rate
    E: Array  # (p, m) of the m motors with a servo
    gain: Array  # (m,) Kd of `Servos`
    stiffness: Array  # (m,) Kp over Kd [1/s]
    fed: Array  # (m,) 1 where Kd brakes the speed that is not asked for, 0 for a position servo, where it brakes all
    through: IntArray  # (t,) rows on which torques act through a servo, as in `loop.servo`
    simulated: bool  # whether they are `Servos`, else what the law takes them for, `nudot_s = b (u - nu_s)`

    @property
    def on(self) -> Array:
        """(p,) 1 on s, 0 on e."""
        return np.array([float(kind != EFFORT) for kind in self.kinds])


def linear_servos(robot: Robot, given: Mapping[str, str] | None, law: Servo, simulated: bool) -> LinearServos | None:
    """The servo rows of a robot; None where all rows take effort.

    Errors as of `interfaces_of` and `split_of`.
    """
    kinds, on = interfaces_of(robot, given)
    return servos_on(robot, kinds, law, simulated) if on.any() else None


def servos_on(robot: Robot, kinds: tuple[str, ...], law: Servo, simulated: bool) -> LinearServos:
    """The servos of these rows, (p,); errors as of `split_of`."""
    numbers, on = laws(robot, law), np.array([float(kind != EFFORT) for kind in kinds])
    motors, gain, stiffness = servo_motors(robot, on, numbers[0])
    known, placed = position_laws(robot, kinds, law)
    at_place = placed >= 0
    gain = np.where(at_place, np.maximum(known[KD], TINY), gain)
    stiffness = np.where(at_place, known[KP] / gain, stiffness)
    there, fed = motors > 0.0, np.where(at_place, 0.0, 1.0)
    E = robot.E_at(robot.rest)[:, there]
    through = np.flatnonzero(through_servos(robot, kinds, law)[0])
    known_by_law = simulated or through.size > 0
    return LinearServos(law, kinds, numbers, E, gain[there], stiffness[there], fed[there], through, known_by_law)
