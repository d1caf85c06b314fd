"""What motors and gears make of a commanded torque: limits, current loop, supply, backlash. Perfect by default.

Every motor is a chain of effects, each one class, and each part of it is off unless it is asked for:

    command ─▶ torque constant ─▶ torque limit ─▶ supply and PWM ─▶ speed limit ─▶ no current ─▶
    current loop ─▶ shorted windings ─▶ backlash ─▶ joint

`Actuator.motors` puts them into a list in this order. All numbers are those at the joint, gears included. Friction of
the gears belongs to the robot (its URDF, or the experiment's `[friction]`) and sticks with the integrator `stick`.

**Supply.** A direct-current motor: the drive asks for the voltage `R u / kt + kt w`, gets it within the supply and in
whole steps of the PWM, and the torque is `kt (V - kt w) / R`. Its bridge takes the share `V / supply` of the winding's
current from the battery, whose voltage sags by its resistance times the sum of what the motors took in the last step.

**Backlash.** Two masses with a gap between them, a two-sided contact: the rotor (inertia J) turns freely inside the gap
and presses on the flank with a spring and a damper that never pulls. It starts in the middle, at the joint's speed. The
rotor moves by implicit Euler, which is stable however stiff the flank; the joint feels the flank's torque, held over a
step. The rotor's inertia is then here, not in the robot's armature. What a held torque gives the joint too much in a
step is `dt^2 u' E' M^-1 E u / 2`, what implicit Euler takes from the rotors `dt^2 u' J^-1 u / 2`: rotors lighter than
what they drive never gain energy, and others are refused.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np

from .compiled import spliced
from .elementary import exp
from .errors import ConfigError
from .model.checks.properties import random_state
from .model.dynamics import Dynamics
from .model.robot import Robot, limits, speed_limits
from .settings import Numbers, Settings, one_or_each, require_numbers
from .signals import EARLY, Array, IntArray

# State of a motor: torque of its current loop, how far its rotor is ahead of the joint, the rotor's speed, the current
# that it draws from the supply, the sum of what it gave to the joint in this control period, what it gave last.
TORQUE, AHEAD, ROTOR_SPEED, DRAWN, SUM, GIVEN, STATES = range(7)
PLACES = 20  # at which a rotor is compared with what it drives
NEVER: Array = np.zeros((0, 3))  # no window of time


class Actuator(Settings, frozen=True):
    """Imperfect motors; every number may be one for all motors or one for each (drive wheels from left to right, arm).

    Args:
        torque_limit: Largest torque [N m or N]; "urdf" takes the effort limits of the URDF; "none", or None, for none.
        speed_limit: Speed at which a motor gives no more torque in the direction of its motion [rad/s or m/s]; "urdf"
            takes the velocity limits of the URDF; None for none.
        torque_gain: Real torque over commanded torque: a torque constant that the drive does not know.
        lag: Time constant of the current loop [s]; 0 for none.
        voltage: Voltage of the supply [V]; None for a supply without end, and then no PWM and no sag.
        torque_constant: kt at the joint, torque per current and back-EMF per speed alike [N m/A]; with a voltage.
        resistance: Of the winding [Ohm]; with a voltage.
        battery_resistance: Of the supply [Ohm], less than that of all windings in parallel.
        pwm_levels: Steps of the PWM between 0 and the voltage; 0 for a continuous voltage.
        gap: Backlash of the gear, from flank to flank [rad or m]; 0 for none.
        rotor_inertia: Inertia on the motor's side of the gap, seen from the joint [kg m^2 or kg]; needed with a gap.
        stiffness: Of the flank [N m/rad or N/m].
        damping: Of the flank [N m s/rad or N s/m].
        rotor_friction: Coulomb friction on the motor's side [N m or N].
        brake: Torque per speed of a motor whose windings are shorted, which a supervisor does when it has to stop
            without measurements [N m s/rad or N s/m].

    Raises:
        ConfigError: A number is out of its range or missing, with the key path.
    """

    torque_limit: Literal["urdf", "none"] | Numbers | None = None
    speed_limit: Literal["urdf"] | Numbers | None = None
    torque_gain: Numbers = 1.0
    lag: Numbers = 0.0
    voltage: float | None = None
    torque_constant: Numbers = 1.0
    resistance: Numbers = 1.0
    battery_resistance: float = 0.0
    pwm_levels: int = 0
    gap: Numbers = 0.0
    rotor_inertia: Numbers = 0.0
    stiffness: Numbers = 500.0
    damping: Numbers = 0.5
    rotor_friction: Numbers = 0.0
    brake: Numbers = 0.0

    def __post_init__(self) -> None:
        positive = ("torque_limit", "speed_limit", "torque_constant", "resistance", "stiffness", "voltage")
        require_numbers(self, "actuator", positive)
        for name, unset in (("torque_constant", 1), ("resistance", 1), ("battery_resistance", 0), ("pwm_levels", 0)):
            if self.voltage is None and getattr(self, name) != unset:
                raise ConfigError(
                    "a supply without a voltage", fix="give actuator.voltage, too", key=f"actuator.{name}"
                )
        gaps, rotors = np.atleast_1d(self.gap), np.atleast_1d(self.rotor_inertia)
        fit = gaps.size == rotors.size or 1 in (gaps.size, rotors.size)  # else told with the robot
        if fit and np.any((gaps > 0) & (rotors <= 0)):
            what, why = "a gap without a rotor", "inside the gap the rotor moves alone"
            raise ConfigError(what, why=why, fix="give actuator.rotor_inertia > 0", key="actuator.rotor_inertia")

    @property
    def perfect(self) -> bool:
        """Whether every motor gives what is asked for, at once."""
        return self in PERFECT

    def motors(self, robot: Robot, dt: float, dead: Array = NEVER, states: Array | None = None) -> Motors:
        """The motors of a robot: their effects in the order in which a command meets them.

        Args:
            robot: The robot.
            dt: Step of the plant [s].
            dead: (k, 3) windows of time without current: motor, start, end [s].
            states: (motors, STATES) their state; None for a new one, at rest.

        Raises:
            ConfigError: Not one number per motor; a rotor heavier than what its gear drives, a brake too strong for the
            step, a battery that breaks down.
        """
        count, dt = robot.dimensions.motors, float(dt)
        if states is None:
            states = np.zeros((count, STATES))

        def of(name: str) -> Array:
            return np.array(one_or_each(getattr(self, name), count, "motor", f"actuator.{name}"))

        gap, rotor, brake, constant, resistance = map(
            of, ("gap", "rotor_inertia", "brake", "torque_constant", "resistance")
        )
        torque = np.array(limits(self.torque_limit, robot.effort_limits, "motor", "actuator.torque_limit"))
        speed = np.array(limits(self.speed_limit, speed_limits(robot), "motor", "actuator.speed_limit"))
        decay = np.array([0.0 if lag == 0 else exp(-dt / lag) for lag in of("lag")])
        self._require_gears(robot, gap, rotor, brake, dt)
        self._require_battery(resistance)
        numbers = float(self.voltage or 0.0), float(self.battery_resistance), float(self.pwm_levels)
        supply = Supply(*numbers, constant, resistance, states)
        effects = (
            MotorSpeed(gap, states),
            TorqueConstant(of("torque_gain")),
            TorqueLimit(torque),
            supply,
            SpeedLimit(speed),
            DeadMotors(dead),
            CurrentLoop(decay, states),
            Battery(supply),
            ShortedWindings(dt, brake, gap, rotor),
            Backlash(dt, gap, rotor, of("stiffness"), of("damping"), of("rotor_friction"), states),
            Meter(states),
        )
        wire = Drive(np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(1, np.int64))
        return Motors(not self.perfect or len(dead) > 0, states, wire, effects)

    def _require_battery(self, resistance: Array) -> None:
        """The battery's voltage does not break down under all motors (motors,) at once."""
        if self.battery_resistance * np.sum(1.0 / resistance) >= 1.0:
            parallel = 1.0 / np.sum(1.0 / resistance)
            why, fix = f"all windings in parallel have {parallel:.3g} Ohm: its voltage breaks down", "use less"
            raise ConfigError(f"{self.battery_resistance:g} Ohm", why=why, fix=fix, key="actuator.battery_resistance")

    def _require_gears(self, robot: Robot, gap: Array, rotor: Array, brake: Array, dt: float) -> None:
        """Gears sit at joints; no rotor is heavier than what its gear drives, together with the others, see the top.

        A brake on a joint is explicit: in a step it must not take more than there is; `dt brake` stands for J.
        """
        if gap.any() and len(motor_places(robot)) < len(gap):
            raise ConfigError("a base that forces drive has no gears", fix="leave the gap out", key="actuator.gap")
        geared = gap > 0
        worst, driven = heaviest(robot, np.where(geared, rotor, 0.0))
        if worst >= 0:
            raise ConfigError(
                f"a rotor of {rotor[worst]:.3g} at '{robot.actuator_names[worst]}'",
                why=f"its gear drives {driven:.3g}, and the flank's torque is held over a step",
                fix="use a smaller rotor_inertia, or leave part of it in the joint's armature",
                key="actuator.rotor_inertia",
            )
        worst, driven = heaviest(robot, np.where(geared, 0.0, dt * brake))
        if worst >= 0:
            raise ConfigError(
                f"{brake[worst]:.3g} at '{robot.actuator_names[worst]}'",
                why=f"it brakes an inertia of {driven:.3g}, and is held over a step of {dt:g} s",
                fix=f"use less than {driven / dt:.3g}, or a shorter time.plant_step",
                key="actuator.brake",
            )


PERFECT = (Actuator(), Actuator(torque_limit="none"))  # motors of which nothing is known, however that is said


def motor_places(robot: Robot) -> list[int]:
    """Places of the motors' joints in the position, the first ones of the motors; a base that forces drive has none."""
    return [robot.position_names.index(name) for name in robot.actuator_names if name in robot.position_names]


def heaviest(robot: Robot, rotors: Array) -> tuple[int, float]:
    """Motor whose rotor is heavier than what it drives, and what that is; -1 where none is.

    Args:
        robot: The robot.
        rotors: (motors,) inertias on the motors' side, 0 for none.
    """
    if not rotors.any():
        return -1, math.inf
    dynamics, rng, E = Dynamics(robot), np.random.default_rng(0), robot.E * np.sqrt(rotors)
    for i in range(PLACES):
        position = robot.neutral_position() if i == 0 else random_state(robot, rng)[0]
        shares, directions = np.linalg.eigh(E.T @ np.linalg.solve(dynamics.mass_matrix(position), E))
        if shares[-1] > 1.0:
            worst = int(np.argmax(np.abs(directions[:, -1])))
            return worst, float(rotors[worst] / shares[-1])
    return -1, math.inf


class Drive(NamedTuple):
    """What goes from the commands to the joints; the effects change it one after the other.

    Attributes:
        torque: (motors,) first what is commanded, last what the joints get [N m or N].
        speed: (motors,) speed of the motors [rad/s or m/s].
        joint: (motors,) speed of the joints [rad/s or m/s].
        shorted: (1,) how many motors, from the first on, have their windings shorted.
    """

    torque: Array
    speed: Array
    joint: Array
    shorted: IntArray


class Motors(NamedTuple):
    """The motors of one run: whether they are imperfect, their state, what they pass on, and the effects."""

    imperfect: bool
    states: Array
    wire: Drive
    effects: tuple[Any, ...]


class MotorSpeed(NamedTuple):
    """The speed at which a motor turns: its rotor's where the gear has a gap, else its joint's."""

    gap: Array
    states: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Write the motors' speeds."""
        for i in range(wire.speed.size):
            wire.speed[i] = self.states[i, ROTOR_SPEED] if self.gap[i] > 0.0 else wire.joint[i]


class TorqueConstant(NamedTuple):
    """A torque constant that the drive does not know: `gain` times the command."""

    gain: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Scale the torques."""
        for i in range(wire.torque.size):
            wire.torque[i] = self.gain[i] * wire.torque[i]


class TorqueLimit(NamedTuple):
    """The largest torque of every motor, inf for none."""

    limit: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Clip the torques."""
        for i in range(wire.torque.size):
            wire.torque[i] = min(max(wire.torque[i], -self.limit[i]), self.limit[i])


class Supply(NamedTuple):
    """What the battery's voltage and the PWM let a motor give at its speed: `kt (V - kt w) / R`."""

    voltage: float  # of the battery without a load [V]; 0 for a supply without end
    battery: float  # its resistance [Ohm]
    levels: float  # steps of the PWM between 0 and the voltage, 0 for none
    constant: Array  # (motors,) kt [N m/A]
    resistance: Array  # (motors,) of the windings [Ohm]
    states: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Limit the torques to what the drives' voltages give."""
        if self.voltage > 0.0:
            voltage = max(sagged(self), 0.0)
            for i in range(wire.torque.size):
                kt, w = self.constant[i], wire.speed[i]
                wanted = self.resistance[i] * wire.torque[i] / kt + kt * w
                if self.levels > 0.0:
                    step = self.voltage / self.levels
                    wanted = step * math.floor(wanted / step + 0.5)
                wire.torque[i] = kt * (min(max(wanted, -voltage), voltage) - kt * w) / self.resistance[i]


@spliced
def sagged(supply: Supply) -> float:
    """Voltage of the battery under what the motors drew in the last step [V]."""
    voltage = supply.voltage
    for i in range(supply.constant.size):
        voltage -= supply.battery * supply.states[i, DRAWN]
    return voltage


class SpeedLimit(NamedTuple):
    """The speed from which on a motor brakes but does not drive, inf for none."""

    limit: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Take away the torques that would drive on."""
        for i in range(wire.torque.size):
            if abs(wire.speed[i]) >= self.limit[i] and wire.torque[i] * wire.speed[i] > 0.0:
                wire.torque[i] = 0.0


class DeadMotors(NamedTuple):
    """Motors without current for a while: windows (k, 3) of motor, start and end [s]."""

    windows: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Take the torque of the dead ones away."""
        for i in range(self.windows.shape[0]):
            if self.windows[i, 1] <= time + EARLY and time + EARLY < self.windows[i, 2]:
                wire.torque[int(self.windows[i, 0])] = 0.0


class CurrentLoop(NamedTuple):
    """A first-order lag: `decay = exp(-dt / lag)` of what is missing is left after a step."""

    decay: Array
    states: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Let the torques follow."""
        for i in range(wire.torque.size):
            u = wire.torque[i]
            self.states[i, TORQUE] = u + self.decay[i] * (self.states[i, TORQUE] - u)
            wire.torque[i] = self.states[i, TORQUE]


class Battery(NamedTuple):
    """What the bridges take from the battery, `V / supply` of the winding's current, negative where a motor brakes.

    The supply's voltage sags by it in the next step.
    """

    supply: Supply

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Write the currents of this step."""
        supply = self.supply
        voltage = sagged(supply)
        for i in range(wire.torque.size):
            drawn = 0.0
            if voltage > 0.0:
                current = wire.torque[i] / supply.constant[i]
                needed = supply.resistance[i] * current + supply.constant[i] * wire.speed[i]
                drawn = min(max(needed / voltage, -1.0), 1.0) * current
            supply.states[i, DRAWN] = drawn


class ShortedWindings(NamedTuple):
    """The brake of motors whose windings a supervisor has shorted; implicit in the rotor, where there is one."""

    dt: float
    brake: Array
    gap: Array
    rotor: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Brake the first motors, as many as are shorted."""
        for i in range(wire.shorted[0]):
            u, b = wire.torque[i], self.brake[i]
            implicit = self.dt * b / self.rotor[i] if self.gap[i] > 0.0 else 0.0
            wire.torque[i] = (u - b * wire.speed[i]) / (1.0 + implicit)


class Backlash(NamedTuple):
    """Gears with a gap: rotor and joint are two masses, a flank between them that pushes and never pulls."""

    dt: float
    gap: Array  # (motors,) from flank to flank, 0 for none [rad or m]
    rotor: Array  # (motors,) inertia J on the motor's side [kg m^2 or kg]
    stiffness: Array  # (motors,) k of the flank
    damping: Array  # (motors,) c of the flank
    friction: Array  # (motors,) Coulomb friction of the rotor
    states: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Torque of the flanks on the joints; the rotors' speed and lead move on by implicit Euler."""
        dt = self.dt
        for i in range(wire.torque.size):
            if self.gap[i] > 0.0:
                u, joint, J, rubs = wire.torque[i], wire.joint[i], self.rotor[i], self.friction[i]
                free = slowed(self.states[i, ROTOR_SPEED] + dt * u / J, dt * rubs / J)
                before, half, torque = self.states[i, AHEAD], 0.5 * self.gap[i], 0.0
                ahead = before + dt * (free - joint)
                if abs(ahead) > half:
                    flank = half if ahead > 0.0 else -half
                    # torque = k (ahead - flank) + c (w - joint) at the end of the step
                    grip = dt * self.stiffness[i] + self.damping[i]
                    push = self.stiffness[i] * (before - flank) - grip * joint
                    most = 1.0 + dt * grip / J
                    pushed = slowed((self.states[i, ROTOR_SPEED] + dt * (u - push) / J) / most, dt * rubs / (J * most))
                    torque = push + grip * pushed
                    if torque * flank <= 0.0:
                        torque = 0.0
                    elif (before - flank) * flank < 0.0 and (before + dt * (pushed - joint) - flank) * flank < 0.0:
                        touching = joint + (flank - before) / dt  # it would be hit before it is there
                        free, torque = touching, J * (free - touching) / dt
                    else:
                        free = pushed
                self.states[i, ROTOR_SPEED] = free
                self.states[i, AHEAD] += dt * (free - joint)
                wire.torque[i] = torque


class Meter(NamedTuple):
    """What the joints get, now and as the sum over a control period: the signal `applied`."""

    states: Array

    @spliced
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Write both down."""
        for i in range(wire.torque.size):
            self.states[i, GIVEN] = wire.torque[i]
            self.states[i, SUM] += wire.torque[i]


@spliced
def slowed(speed: float, most: float) -> float:
    """Speed after a friction that takes at most so much of it and holds at rest."""
    return speed - min(max(speed, -most), most)
