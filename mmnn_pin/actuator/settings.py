"""Settings of motors and gears: limits, current loop, supply, backlash. They are perfect by default.

Every motor is a chain of effects, each one class, and each part of it is off unless it is asked for:

    command ─▶ torque constant ─▶ torque limit ─▶ supply and PWM ─▶ speed limit ─▶ no current ─▶
    current loop ─▶ shorted windings ─▶ backlash ─▶ joint

`Actuator.motors` puts them into a list in this order. All numbers are those at the joint, gears included. Friction of
the gears belongs to the robot (its URDF, or the experiment's `[friction]`) and sticks with the integrator `stick`.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ..elementary import exp
from ..errors import ConfigError
from ..model.checks.properties import random_state
from ..model.dynamics import Dynamics
from ..model.robot import Robot, limits, speed_limits
from ..settings import Numbers, Settings, one_or_each, require_numbers
from ..signals import Array
from .effects import (
    STATES,
    Backlash,
    Battery,
    CurrentLoop,
    DeadMotors,
    Meter,
    Motors,
    MotorSpeed,
    MotorState,
    ShortedWindings,
    SpeedLimit,
    Supply,
    TorqueConstant,
    TorqueLimit,
    motor_state,
    new_drive,
)

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
        voltage: Voltage of the supply [V]; None for an unlimited supply, without PWM and sag.
        torque_constant: kt at the joint, torque per current and back-EMF per speed alike [N m/A]; with a voltage.
        resistance: Resistance of the winding [Ohm]; with a voltage.
        battery_resistance: Resistance of the supply [Ohm], less than that of all windings in parallel.
        pwm_levels: Steps of the PWM between 0 and the voltage; 0 for a continuous voltage.
        gap: Backlash of the gear, from flank to flank [rad or m]; 0 for none.
        rotor_inertia: Inertia on the motor's side of the gap, seen from the joint [kg m^2 or kg]; needed with a gap.
        stiffness: Stiffness of a flank [N m/rad or N/m].
        damping: Damping of a flank [N m s/rad or N s/m].
        rotor_friction: Coulomb friction on the motor's side [N m or N].
        brake: Torque per speed of a motor with shorted windings; a supervisor shorts them when it has to stop without
            measurements [N m s/rad or N s/m].

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

    def motors(self, robot: Robot, dt: float, dead: Array = NEVER, states: MotorState | None = None) -> Motors:
        """The motors of a robot: their effects in the order in which a command meets them.

        Args:
            robot: The robot.
            dt: Step of the plant [s].
            dead: (k, 3) windows of time without current: motor, start, end [s].
            states: Their state; None for a new one, at rest.

        Raises:
            ConfigError: Not one number per motor; a rotor heavier than what its gear drives, a brake too strong for the
            step, a battery that breaks down.
        """
        count, dt = robot.dimensions.motors, float(dt)
        if states is None:
            states = motor_state(np.zeros((count, STATES)))

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
        wire = new_drive(count)
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
    dynamics, rng = Dynamics(robot), np.random.default_rng(0)
    for i in range(PLACES):
        position = robot.neutral_position() if i == 0 else random_state(robot, rng)[0]
        E = robot.E_at(position) * np.sqrt(rotors)
        shares, directions = np.linalg.eigh(E.T @ np.linalg.solve(dynamics.mass_matrix(position), E))
        if shares[-1] > 1.0:
            worst = int(np.argmax(np.abs(directions[:, -1])))
            return worst, float(rotors[worst] / shares[-1])
    return -1, math.inf
