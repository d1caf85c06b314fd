"""What motors and gears make of a commanded torque: limits, current loop, supply, backlash. Perfect by default.

Every motor is a chain, and each part of it is off unless it is asked for:

    command ─▶ torque constant ─▶ torque limit ─▶ supply and PWM ─▶ speed limit ─▶ lag ─▶ backlash ─▶ joint

All numbers are those at the joint, gears included. Friction of the gears belongs to the robot (its URDF, or the
experiment's `[friction]`) and sticks with the integrator `stick`.

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
from typing import Literal

import numpy as np

from .compiled import compiled
from .errors import ConfigError
from .model.checks.properties import random_state
from .model.dynamics import Dynamics
from .model.robot import Robot, limits, speed_limits
from .settings import Numbers, Settings, one_or_each, require_numbers
from .signals import Array

# Columns of the motors' table; a limit that is not there is inf.
GAIN, LIMIT, SPEED, LAG, KT, RESISTANCE, GAP, ROTOR, STIFFNESS, DAMPING, FRICTION, BRAKE, PLACE, WIDTH = range(14)
# Supply: voltage (0 for none), resistance of the battery, steps of the PWM between 0 and the voltage (0 for none).
VOLTAGE, BATTERY, LEVELS = 0, 1, 2
# What a motor remembers: torque of its current loop, how far its rotor is ahead of the joint, the rotor's speed, the
# current that it draws from the supply, and the sum of what it gave to the joint in this control period.
TORQUE, AHEAD, ROTOR_SPEED, DRAWN, SUM, STATES = range(6)
PLACES = 20  # at which a rotor is compared with what it drives


class Actuator(Settings, frozen=True):
    """Imperfect motors; every number may be one for all motors or one for each (drive wheels from left to right, arm).

    Args:
        torque_limit: Largest torque [N m or N]; "urdf" takes the effort limits of the URDF; None for none.
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

    torque_limit: Literal["urdf"] | Numbers | None = None
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
        return self == Actuator()

    def motors(self, robot: Robot, dt: float) -> Array:
        """Table of a robot's motors, (motors, WIDTH).

        Args:
            robot: The robot.
            dt: Step of the plant [s].

        Raises:
            ConfigError: Not one number per motor; a rotor heavier than what its gear drives, a brake too strong for the
            step, a battery that breaks down.
        """
        table = np.zeros((robot.layout.motors, WIDTH))
        places = [robot.position_names.index(name) for name in robot.actuator_names if name in robot.position_names]
        if len(places) < len(table) and np.any(np.asarray(self.gap) > 0):
            raise ConfigError("a base that forces drive has no gears", fix="leave the gap out", key="actuator.gap")
        columns = {GAIN: "torque_gain", KT: "torque_constant", RESISTANCE: "resistance", GAP: "gap"}
        columns |= {ROTOR: "rotor_inertia", STIFFNESS: "stiffness", DAMPING: "damping"}
        columns |= {FRICTION: "rotor_friction", BRAKE: "brake"}
        for column, name in columns.items():
            table[:, column] = one_or_each(getattr(self, name), len(table), "motor", f"actuator.{name}")
        lags = one_or_each(self.lag, len(table), "motor", "actuator.lag")
        table[:, LAG] = [0.0 if lag == 0 else math.exp(-dt / lag) for lag in lags]
        table[:, LIMIT] = limits(self.torque_limit, robot.effort_limits, "motor", "actuator.torque_limit")
        table[:, SPEED] = limits(self.speed_limit, speed_limits(robot), "motor", "actuator.speed_limit")
        table[:, PLACE] = places if len(places) == len(table) else -1
        self._require_light(robot, table, dt)
        if self.battery_resistance * np.sum(1.0 / table[:, RESISTANCE]) >= 1.0:
            parallel = 1.0 / np.sum(1.0 / table[:, RESISTANCE])
            why, fix = f"all windings in parallel have {parallel:.3g} Ohm: its voltage breaks down", "use less"
            raise ConfigError(f"{self.battery_resistance:g} Ohm", why=why, fix=fix, key="actuator.battery_resistance")
        return table

    def supply(self) -> Array:
        """Voltage, the battery's resistance, steps of the PWM, (3,)."""
        return np.array([self.voltage or 0.0, self.battery_resistance, self.pwm_levels], float)

    def _require_light(self, robot: Robot, table: Array, dt: float) -> None:
        """No rotor is heavier than what its gear drives, together with the others, anywhere; see the top.

        A brake on a joint is explicit: in a step it must not take more than there is; `dt brake` stands for J.
        """
        geared = table[:, GAP] > 0
        worst, driven = heaviest(robot, np.where(geared, table[:, ROTOR], 0.0))
        if worst >= 0:
            raise ConfigError(
                f"a rotor of {table[worst, ROTOR]:.3g} at '{robot.actuator_names[worst]}'",
                why=f"its gear drives {driven:.3g}, and the flank's torque is held over a step",
                fix="use a smaller rotor_inertia, or leave part of it in the joint's armature",
                key="actuator.rotor_inertia",
            )
        worst, driven = heaviest(robot, np.where(geared, 0.0, dt * table[:, BRAKE]))
        if worst >= 0:
            raise ConfigError(
                f"{table[worst, BRAKE]:.3g} at '{robot.actuator_names[worst]}'",
                why=f"it brakes an inertia of {driven:.3g}, and is held over a step of {dt:g} s",
                fix=f"use less than {driven / dt:.3g}, or a shorter time.plant_step",
                key="actuator.brake",
            )


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


@compiled
def drive(
    dt: float,
    command: Array,
    speed: Array,
    dead: Array,
    shorted: int,
    motors: Array,
    supply: Array,
    states: Array,
) -> None:
    """One step of the plant: what the motors give to their joints under a command, into `states`.

    Args:
        dt: Step [s].
        command: (motors,) commanded torque [N m or N].
        speed: (motors,) speed of the joints [rad/s or m/s].
        dead: (motors,) 1 for a motor without current.
        shorted: How many motors, from the first on, have their windings shorted.
        motors: (motors, WIDTH) table of settings.
        supply: (3,) voltage, resistance of the battery, steps of the PWM.
        states: (motors, STATES + 1), moved on; the last column becomes the torque on the joint.
    """
    voltage, count = supply[VOLTAGE], command.size
    for i in range(count):
        voltage -= supply[BATTERY] * states[i, DRAWN]
    for i in range(count):
        m = motors[i]
        w = states[i, ROTOR_SPEED] if m[GAP] > 0.0 else speed[i]
        u = min(max(m[GAIN] * command[i], -m[LIMIT]), m[LIMIT])
        if supply[VOLTAGE] > 0.0:
            u = supplied(u, w, max(voltage, 0.0), supply, m)
        if abs(w) >= m[SPEED] and u * w > 0.0:
            u = 0.0
        if dead[i] > 0.0:
            u = 0.0
        states[i, TORQUE] = u + m[LAG] * (states[i, TORQUE] - u)
        states[i, DRAWN] = drawn(states[i, TORQUE], w, voltage, m)
        u = states[i, TORQUE]
        if i < shorted:  # implicit in the rotor, where there is one
            u = (u - m[BRAKE] * w) / (1.0 + (dt * m[BRAKE] / m[ROTOR] if m[GAP] > 0.0 else 0.0))
        if m[GAP] > 0.0:
            u = through_gap(dt, u, speed[i], m, states[i])
        states[i, STATES] = u
        states[i, SUM] += u


@compiled
def supplied(u: float, w: float, voltage: float, supply: Array, m: Array) -> float:
    """Torque that the supply lets a motor give at speed w."""
    wanted = m[RESISTANCE] * u / m[KT] + m[KT] * w
    if supply[LEVELS] > 0.0:
        step = supply[VOLTAGE] / supply[LEVELS]
        wanted = step * math.floor(wanted / step + 0.5)
    given = min(max(wanted, -voltage), voltage)
    return m[KT] * (given - m[KT] * w) / m[RESISTANCE]


@compiled
def drawn(torque: float, w: float, voltage: float, m: Array) -> float:
    """Current that a motor's bridge takes from the supply; negative where it brakes."""
    current = torque / m[KT]
    if voltage <= 0.0:
        return 0.0
    return min(max((m[RESISTANCE] * current + m[KT] * w) / voltage, -1.0), 1.0) * current


@compiled
def through_gap(dt: float, u: float, joint: float, m: Array, state: Array) -> float:
    """Torque of the flanks on the joint; rotor speed and its lead over the joint move on by implicit Euler."""
    free = slowed(state[ROTOR_SPEED] + dt * u / m[ROTOR], dt * m[FRICTION] / m[ROTOR])
    ahead = state[AHEAD] + dt * (free - joint)
    half, torque = 0.5 * m[GAP], 0.0
    if abs(ahead) > half:
        flank = half if ahead > 0.0 else -half
        grip = dt * m[STIFFNESS] + m[DAMPING]  # torque = k (ahead - flank) + c (w - joint) at the end of the step
        push = m[STIFFNESS] * (state[AHEAD] - flank) - grip * joint
        most = 1.0 + dt * grip / m[ROTOR]
        free_pushed = (state[ROTOR_SPEED] + dt * (u - push) / m[ROTOR]) / most
        pushed = slowed(free_pushed, dt * m[FRICTION] / (m[ROTOR] * most))
        torque = push + grip * pushed
        if torque * flank <= 0.0:
            torque = 0.0
        elif (state[AHEAD] - flank) * flank < 0.0 and (state[AHEAD] + dt * (pushed - joint) - flank) * flank < 0.0:
            touching = joint + (flank - state[AHEAD]) / dt  # it would be hit before it is there
            free, torque = touching, m[ROTOR] * (free - touching) / dt
        else:
            free = pushed
    state[ROTOR_SPEED] = free
    state[AHEAD] += dt * (free - joint)
    return torque


@compiled
def slowed(speed: float, most: float) -> float:
    """Speed after a friction that takes at most so much of it and holds at rest."""
    return speed - min(max(speed, -most), most)
