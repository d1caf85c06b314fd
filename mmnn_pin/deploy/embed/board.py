"""The sample of a stepper as functions that can be written as C: `Stepper.step` without Python's objects.

    measurement ─▶ [take] ─▶ [follow: a sample, a base velocity, or hold] ─▶ [sample] ─▶ [command]

The arithmetic is the blocks' own: `safety.accept`, `reference.guide`, `loop.sample`. Here is only what
`Stepper` and `Follower` decide between them. Motions and joint goals are planned in Python and handed in as samples.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from ...compiled import copy_to
from ...compliance import Compliance
from ...kinematic import Steering, see
from ...loop.hardware import Hardware
from ...loop.machine import Machine
from ...loop.sample import Controls, sample
from ...loop.servo import Split
from ...loop.stepper import Stepper
from ...model.base.rolling import Rolling, followed
from ...reference.follower import LARGEST
from ...reference.guide import (
    ARM,
    BASE,
    SAMPLE,
    VELOCITY,
    Guide,
    advance,
    brake,
    drive,
    stand,
    take_joints,
    take_sample,
)
from ...safety import Supervisor, accept, has_ended, press, release
from ...signals import INDEX, Array, IntArray
from ...torque.law import Ahead, MotorLimits
from ...touch import Feeler

# What a sample can be asked: to go on, a full sample, a base velocity, to brake and stand, samples of the joints, and
# these with a base velocity.
GO_ON, FOLLOW_SAMPLE, FOLLOW_VELOCITY, STAND, FOLLOW_JOINTS, FOLLOW_BOTH = range(6)
# What a step answers: done; a time not after the last one; a setpoint that is not finite or does not exist.
DONE, BAD_TIME, BAD_SETPOINT = range(3)
SHAPE = INDEX["shape"]
LAST, RENEWED, STANDS, PAUSED = 0, 1, 3, 4  # of the clock
CLOCK = 5


class Board(NamedTuple):
    """The memory of a stepper; what has no words beside it is as of `loop.sample.sample`."""

    row: Array  # (width,) signals of the sample
    at: IntArray  # their offsets
    received: Array  # (m,) pose, velocity, q, qdot in the row
    incoming: Array  # (m,) the measurement that comes in
    asked: Array  # (w,) the setpoint that comes in: a full sample, or the base velocity at its place
    control: Controls  # what a control sample works on
    model: Machine | None
    hardware: Hardware
    learner: Any
    limits: MotorLimits | None
    ahead: Ahead | None
    later: Any
    guide: Guide  # what makes the reference
    supervisor: Supervisor  # the supervisor
    # (CLOCK,) time of the last sample, when base and arm were renewed [s], whether it stands, waits in a pause
    clock: Array
    losses: Array  # (1,) how often a setpoint was not renewed
    timeout: float  # age of a setpoint that has to be renewed at which it holds [s]
    command: Array  # (motors,) torques that reach the motors
    motor_torque: Array  # (motors,) the same in the row
    before: Array  # (w,) the setpoint of the sample before, from which Psi_hat leads
    split: Split | None  # the rows that take a velocity; None where all take effort
    touch: Feeler | None  # what feels external torque; None for nothing
    kept: Controls | None  # the controls of the law with its weights held, for contact; None where it goes on
    held: Any  # the learner with its weights held, likewise
    steering: Steering | None  # of a base that steers; None for others
    task: Compliance | None  # a compliant hand; None for one that is stiff
    seen: Array  # (m,) the measurement as the reference has it: pose, twist, q, qdot; of others than steer `received`
    motor_velocity: Array  # (motors,) commanded velocities [rad/s or m/s]
    motor_position: Array  # (motors,) commanded positions, of motors that take them [rad or m]
    # motors that take a position; place of each in `Split.place`; its pivot if it follows another, else -1
    placed: tuple[tuple[int, int, int], ...]
    rolling: Rolling | None  # of a base that steers; None for others


class Fresh(Stepper):
    """A stepper that has not rehearsed: its memory is as a board's is after a reset."""

    def _rehearse(self) -> None:
        """Nothing: nobody steps it."""


def board_of(stepper: Stepper) -> Board:
    """The memory of a stepper."""
    guide, hardware, torque = stepper.follower.guide, stepper.hardware, stepper.control.torque
    clock = np.zeros(CLOCK)
    clock[: RENEWED + 2] = -math.inf
    return Board(
        row=stepper.row,
        at=stepper.at,
        received=stepper.received,
        incoming=np.zeros(stepper.received.size),
        asked=np.zeros(guide.wanted.size),
        control=stepper.control.controls,
        model=torque.model,
        hardware=hardware,
        learner=torque.learner,
        limits=torque.limits,
        ahead=torque.ahead,
        later=torque.later,
        guide=guide,
        supervisor=hardware.way.supervisor,
        clock=clock,
        losses=np.zeros(1),
        timeout=stepper.follower.timeout,
        command=hardware.way.totals.command,
        motor_torque=stepper.motor_torque,
        before=stepper.before,
        split=hardware.split,
        touch=hardware.touch,
        kept=None if hardware.touch is None else torque.kept,
        held=None if hardware.touch is None else torque.held,
        steering=stepper.control.steering,
        task=stepper.control.task,
        seen=stepper.received if stepper.control.steering is None else stepper.seen,
        motor_velocity=np.zeros(stepper.setup.layout.motors),
        motor_position=np.zeros(stepper.setup.layout.motors),
        placed=tuple(one[2:3] + one[1:2] + one[3:] for one in stepper.placed),
        rolling=stepper.robot.rolling,
    )


def step(b: Board, time: float, is_measured: bool, measured: float, wish: int) -> int:
    """One control sample: measurement, setpoint, kinematic layer, torque law, supervisor; `Stepper.step`.

    Args:
        b: The board; `incoming` is the measurement, `asked` the setpoint.
        time: [s], larger than at the last call.
        is_measured: Whether a measurement came.
        measured: When it was taken, at most `time` [s].
        wish: What came as a setpoint: `GO_ON` where none did.
    """
    clock = b.clock
    if not clock[LAST] < time < math.inf:
        return BAD_TIME
    if not is_possible(b, wish):
        return BAD_SETPOINT
    if is_measured:
        take(b, time, measured)
    if b.steering is not None:
        see(b.row, b.at, b.steering, b.seen)
    if clock[STANDS] == 0.0 and b.supervisor.state.good[0] > 0.0:
        stand(b.seen, b.guide)
        clock[STANDS] = 1.0
    if clock[PAUSED] == 0.0:
        follow(b, time, wish)
    advance(b.seen, time - clock[LAST] if clock[LAST] > -math.inf else 0.0, b.guide)
    if clock[LAST] == -math.inf:
        copy_to(b.guide.now, b.before)
    sample(
        0, time, b.guide.now, b.before, b.control, b.model, b.hardware, b.learner, b.limits, b.ahead, b.later, b.split,
        b.steering, b.task, b.touch, b.kept, b.held, None,
    )  # fmt: skip
    copy_to(b.guide.now, b.before)
    copy_to(b.command, b.motor_torque)
    command_servos(b)
    clock[LAST] = time
    return DONE


def command_servos(b: Board) -> None:
    """Velocities and positions of the motors that take them; `Stepper._command`."""
    if b.split is not None:
        for j in range(b.motor_velocity.size):
            speed = 0.0
            for i in range(b.split.command.size):
                speed += b.split.E[i, j] * b.split.command[i]
            b.motor_velocity[j] = speed
        for motor, place, pivot in b.placed:
            b.motor_position[motor] = b.split.place[place]
            if pivot >= 0 and b.rolling is not None:
                now = b.row[b.at[SHAPE] + pivot]
                b.motor_position[motor] = followed(b.rolling, pivot, b.split.place[place], now)


def is_possible(b: Board, wish: int) -> bool:
    """Whether a setpoint is one that can be followed; `Follower.check`."""
    fine = wish in (GO_ON, STAND, FOLLOW_JOINTS)
    nb = b.guide.base.shape[1]
    pose = 3 if nb else 0
    joints = pose + 2 * nb
    if wish == FOLLOW_SAMPLE:
        fine = True
        for i in range(joints):
            fine = fine and abs(b.asked[i]) < LARGEST
    elif wish in (FOLLOW_VELOCITY, FOLLOW_BOTH):
        fine = nb > 0
        for i in range(pose, pose + nb):
            fine = fine and math.isfinite(b.asked[i])
    if wish in (FOLLOW_SAMPLE, FOLLOW_JOINTS, FOLLOW_BOTH):
        for i in range(joints, b.asked.size):
            fine = fine and abs(b.asked[i]) < LARGEST
    return fine


def take(b: Board, time: float, measured: float) -> None:
    """A measurement into the row and before the supervisor; `Stepper._take`."""
    state = b.supervisor.state
    if state.good[0] > 0.0 and measured < state.heard[0]:
        return
    fine = not math.isnan(measured)
    copy_to(b.incoming, b.received)
    for i in range(b.received.size):
        fine = fine and abs(b.incoming[i]) < LARGEST
    if not fine:
        b.received[0] = math.nan
    when = min(measured, time)
    accept(b.row, b.at, when, when, True, b.supervisor.door)


def follow(b: Board, time: float, wish: int) -> None:
    """A setpoint that came, and those that were not renewed; `Follower.step`."""
    guide, clock = b.guide, b.clock
    nb = guide.base.shape[1]
    pose = 3 if nb else 0
    if wish == FOLLOW_SAMPLE:
        take_sample(b.asked, guide)
        clock[RENEWED + BASE], clock[RENEWED + ARM] = time, time
    elif wish in (FOLLOW_VELOCITY, FOLLOW_BOTH):
        drive(b.asked[pose : pose + nb], guide)
        clock[RENEWED + BASE] = time
    elif wish == STAND:
        brake(BASE, b.seen, guide)
        brake(ARM, b.seen, guide)
    if wish in (FOLLOW_JOINTS, FOLLOW_BOTH):
        take_joints(b.asked[pose + 2 * nb :], guide)
        clock[RENEWED + ARM] = time
    for part in range(2):
        kind = guide.kind[part]
        if kind in (SAMPLE, VELOCITY) and time - clock[RENEWED + part] > b.timeout:
            brake(part, b.seen, guide)
            b.losses[0] += 1.0


def pause(b: Board) -> None:
    """Brake and hold; setpoints are not followed until `resume`; `Stepper.pause`."""
    if b.clock[PAUSED] == 0.0:
        brake(BASE, b.seen, b.guide)
        brake(ARM, b.seen, b.guide)
        b.clock[PAUSED] = 1.0


def resume(b: Board) -> None:
    """Follow setpoints again; `Stepper.resume`."""
    b.clock[PAUSED] = 0.0


def stop(b: Board) -> None:
    """An emergency stop from outside, from the next sample on; `Stepper.stop`."""
    if b.supervisor.state.tripped[0] == 0.0:
        press(max(b.clock[LAST], 0.0), b.supervisor)


def reset(b: Board) -> bool:
    """Go on after a trip from where the robot is measured; false without a fresh measurement; `Stepper.reset`."""
    if b.supervisor.state.tripped[0] == 0.0 or not release(b.clock[LAST], b.supervisor):
        return False
    copy_to(b.supervisor.message, b.received)
    if b.steering is not None:
        see(b.row, b.at, b.steering, b.seen)
    stand(b.seen, b.guide)
    return True


def is_over(b: Board) -> bool:
    """Whether the supervisor has stopped the robot and shown its stop; `Stepper.is_over`."""
    return has_ended(b.clock[LAST], b.supervisor.numbers, b.supervisor.state)


def run(b: Board, time: float, received: Any, wish: int, asked: Any, measured: float | None = None) -> int:
    """A step from Python: arrays of the measurement and of the setpoint, or None."""
    if received is not None:
        b.incoming[:] = received
    if asked is not None:
        b.asked[:] = asked
    return step(b, time, received is not None, time if measured is None else measured, wish)
