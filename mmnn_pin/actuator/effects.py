"""The effects of motors and gears on a torque, one class each, as compiled code steps them.

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
from typing import Any, NamedTuple

import numpy as np

from ..by_address import by_address
from ..compiled import compiled, internal
from ..signals import EARLY, Array, IntArray


@by_address
class MotorState(NamedTuple):
    """The memory of the motors from one plant step to the next, as views of their state."""

    values: Array  # (motors, STATES) the state, a row for each motor
    torque: Array  # (motors,) of the current loop [N m or N]
    ahead: Array  # (motors,) how far the rotor is ahead of the joint [rad or m]
    rotor_speed: Array  # (motors,) [rad/s or m/s]
    drawn: Array  # (motors,) current from the supply [A]
    sum: Array  # (motors,) of what the joints got in this control period
    given: Array  # (motors,) what they got last


STATES = len(MotorState._fields) - 1


def motor_state(values: Array) -> MotorState:
    """The state of motors (motors, STATES) with its views."""
    return MotorState(values, *values.T)


@by_address
class Drive(NamedTuple):
    """The signal from the commands to the joints, which the effects change one after the other."""

    torque: Array  # (motors,) first what is commanded, last what the joints get [N m or N]
    speed: Array  # (motors,) speed of the motors [rad/s or m/s]
    joint: Array  # (motors,) speed of the joints [rad/s or m/s]
    angle: Array  # (motors,) position of the joints, where servos act [rad or m]
    free: Array  # (motors,) speed of the joints at the end of the step without a servo, likewise
    answer: Array  # (motors, motors) what a motor's torque adds to it, likewise
    shorted: IntArray  # (1,) how many motors, from the first on, have their windings shorted


def new_drive(count: int) -> Drive:
    """The signal of so many motors, at rest."""
    torque, speed, joint, angle, free = np.zeros((5, count))
    return Drive(torque, speed, joint, angle, free, np.zeros((count, count)), np.zeros(1, np.int64))


@by_address
class Motors(NamedTuple):
    """The motors of one run: whether they are imperfect, their state, what they pass on, and the effects."""

    imperfect: bool
    states: MotorState
    wire: Drive
    effects: tuple[Any, ...]


@by_address
class MotorSpeed(NamedTuple):
    """The speed at which a motor turns: its rotor's where the gear has a gap, else its joint's."""

    gap: Array
    states: MotorState

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Write the motors' speeds."""
        for i in range(wire.speed.size):
            wire.speed[i] = self.states.rotor_speed[i] if self.gap[i] > 0.0 else wire.joint[i]


@by_address
class TorqueConstant(NamedTuple):
    """A torque constant that the drive does not know: `gain` times the command."""

    gain: Array

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Scale the torques."""
        for i in range(wire.torque.size):
            wire.torque[i] = self.gain[i] * wire.torque[i]


@by_address
class TorqueLimit(NamedTuple):
    """The largest torque of every motor, inf for none."""

    limit: Array

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Clip the torques."""
        for i in range(wire.torque.size):
            wire.torque[i] = min(max(wire.torque[i], -self.limit[i]), self.limit[i])


@by_address
class Supply(NamedTuple):
    """The limit of a motor's torque by battery voltage and PWM at its speed: `kt (V - kt w) / R` [N m or N]."""

    voltage: float  # of the battery without a load [V]; 0 for a supply without end
    battery: float  # its resistance [Ohm]
    levels: float  # steps of the PWM between 0 and the voltage, 0 for none
    constant: Array  # (motors,) kt [N m/A]
    resistance: Array  # (motors,) of the windings [Ohm]
    states: MotorState

    @internal
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


@compiled
def sagged(supply: Supply) -> float:
    """Voltage of the battery under what the motors drew in the last step [V]."""
    voltage = supply.voltage
    for i in range(supply.constant.size):
        voltage -= supply.battery * supply.states.drawn[i]
    return voltage


@by_address
class SpeedLimit(NamedTuple):
    """The speed from which on a motor brakes but does not drive, inf for none."""

    limit: Array

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Take away the torques that would drive on."""
        for i in range(wire.torque.size):
            if abs(wire.speed[i]) >= self.limit[i] and wire.torque[i] * wire.speed[i] > 0.0:
                wire.torque[i] = 0.0


@by_address
class DeadMotors(NamedTuple):
    """Motors without current for a while: windows (k, 3) of motor, start and end [s]."""

    windows: Array

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Take the torque of the dead ones away."""
        for i in range(self.windows.shape[0]):
            if self.windows[i, 1] <= time + EARLY and time + EARLY < self.windows[i, 2]:
                wire.torque[int(self.windows[i, 0])] = 0.0


@by_address
class CurrentLoop(NamedTuple):
    """A first-order lag: `decay = exp(-dt / lag)` of what is missing is left after a step."""

    decay: Array
    states: MotorState

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Let the torques follow."""
        for i in range(wire.torque.size):
            u = wire.torque[i]
            self.states.torque[i] = u + self.decay[i] * (self.states.torque[i] - u)
            wire.torque[i] = self.states.torque[i]


@by_address
class Battery(NamedTuple):
    """The current that bridges take from the battery [A]: `V / supply` of the winding's, negative where a motor brakes.

    The supply's voltage sags by it in the next step.
    """

    supply: Supply

    @internal
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
            supply.states.drawn[i] = drawn


@by_address
class ShortedWindings(NamedTuple):
    """The brake of motors whose windings a supervisor has shorted; implicit in the rotor, where there is one."""

    dt: float
    brake: Array
    gap: Array
    rotor: Array

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Brake the first motors, as many as are shorted."""
        for i in range(wire.shorted[0]):
            u, b = wire.torque[i], self.brake[i]
            implicit = self.dt * b / self.rotor[i] if self.gap[i] > 0.0 else 0.0
            wire.torque[i] = (u - b * wire.speed[i]) / (1.0 + implicit)


@by_address
class Backlash(NamedTuple):
    """Gears with a gap: rotor and joint are two masses, a flank between them that pushes and never pulls."""

    dt: float
    gap: Array  # (motors,) from flank to flank, 0 for none [rad or m]
    rotor: Array  # (motors,) inertia J on the motor's side [kg m^2 or kg]
    stiffness: Array  # (motors,) k of the flank
    damping: Array  # (motors,) c of the flank
    friction: Array  # (motors,) Coulomb friction of the rotor
    states: MotorState

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Torque of the flanks on the joints; the rotors' speed and lead move on by implicit Euler."""
        dt = self.dt
        for i in range(wire.torque.size):
            if self.gap[i] > 0.0:
                u, joint, J, rubs = wire.torque[i], wire.joint[i], self.rotor[i], self.friction[i]
                free = slowed(self.states.rotor_speed[i] + dt * u / J, dt * rubs / J)
                before, half, torque = self.states.ahead[i], 0.5 * self.gap[i], 0.0
                ahead = before + dt * (free - joint)
                if abs(ahead) > half:
                    flank = half if ahead > 0.0 else -half
                    # torque = k (ahead - flank) + c (w - joint) at the end of the step
                    grip = dt * self.stiffness[i] + self.damping[i]
                    push = self.stiffness[i] * (before - flank) - grip * joint
                    most = 1.0 + dt * grip / J
                    pushed = slowed((self.states.rotor_speed[i] + dt * (u - push) / J) / most, dt * rubs / (J * most))
                    torque = push + grip * pushed
                    if torque * flank <= 0.0:
                        torque = 0.0
                    elif (before - flank) * flank < 0.0 and (before + dt * (pushed - joint) - flank) * flank < 0.0:
                        touching = joint + (flank - before) / dt  # it would be hit before it is there
                        free, torque = touching, J * (free - touching) / dt
                    else:
                        free = pushed
                self.states.rotor_speed[i] = free
                self.states.ahead[i] += dt * (free - joint)
                wire.torque[i] = torque


@by_address
class Meter(NamedTuple):
    """The torque of the joints, now and as the sum over a control period: the signal `applied` [N m or N]."""

    states: MotorState

    @internal
    def act(self, wire: Drive, k: int, time: float) -> None:
        """Write both down."""
        for i in range(wire.torque.size):
            self.states.given[i] = wire.torque[i]
            self.states.sum[i] += wire.torque[i]


@compiled
def slowed(speed: float, most: float) -> float:
    """Speed after a friction that takes at most so much of it and holds at rest."""
    return speed - min(max(speed, -most), most)
