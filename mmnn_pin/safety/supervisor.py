"""The supervisor's work at every measurement and at every control sample, compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

from ..by_address import by_address
from ..compiled import compiled, copy_to, entry, internal, linked
from ..elementary import hypot
from ..signals import EARLY, INDEX, SIDEWAYS, Array, IntArray

POSE, VELOCITY, Q, QDOT, ALPHA = (INDEX[name] for name in ("pose", "velocity", "q", "qdot", "alpha"))
VELOCITY_REF, QDOT_REF = INDEX["velocity_ref"], INDEX["qdot_ref"]
POSE_ERROR, JOINT_ERROR, STATE = INDEX["pose_error"], INDEX["e"], INDEX["safety"]
PSI_HAT, TORQUE, CONTACT = INDEX["psi_hat"], INDEX["torque"], INDEX["contact"]
PSI_APPLIED, ROBUST = INDEX["psi_applied"], INDEX["robust"]

# What the signal `safety` says of a sample: nothing done, a torque clipped or a value held, stopping under feedback,
# ramping to zero torque without measurements.
RUNNING, STEPPED_IN, STOPPING, RAMPING = 0.0, 1.0, 2.0, 3.0
TURN, LOWER, UPPER, EXPLAINS, JUMP, IS_FREE = range(6)  # of a door's joints
CONTRADICTION, MOST = range(2)  # of its rows
DRIFT, SPEED, WITHOUT, OFFSET, SAME, USUAL, STEP = range(7)  # of its sense
SLOWER, SLOW, POWER = range(3)  # of what shakes
SILENT, STOOD, RATE, BEND, KNOWN = range(5)  # of a supervisor's sight
TRIPPED = -2  # what an engine's `advance` returns at the end of a tripped run

NOTHING, OVER_TORQUE, OVER_SPEED, OFF_PATH, OFF_HEADING, OFF_JOINT, DEAF, LOST, BAD_WEIGHTS, PRESSED = range(10)
OVER_WHEEL, JUMPED, TOO_SLOW, OVER_TWIST, BLIND, TOUCHED, SHAKING = range(10, 17)

BORNE = 0.3  # of the slowest period: where samples are farther apart the gains of a stop are lowered in proportion
SAMPLES = 10.0  # over which the control period is averaged, those far back less
TOO_MANY = 4.0  # periods in a row that are too long
GAP = 4.0  # times the slowest period: a longer pause counts as this
PLAUSIBLE = 2.0  # times its limit: a velocity beyond this brakes as this
SMOOTH = 0.3  # share of the latest acceleration, and time between measurements, in their averages
MISSED = 2.0  # times the usual time between measurements: no silence before
CONTRADICTS, LEFT = 40.0, 4.0  # times what the measured velocity and that of the reference lead away from what stands
HELD = 3.0  # times the usual time for which it stays, after which that counts
RARE = 0.25  # most that this is taken to be [s]
FASTER, HALF = 1.25, 0.5  # times the least speed in a stop, times the limit: beyond both the stop drives it on


@by_address
class SupervisorNumbers(NamedTuple):
    """The settings that are single numbers, see `Safety`; inf for no limit."""

    timeout: float  # without a measurement [s]
    ramp: float  # in which torque goes to zero [s]
    stop_time: float  # how long a tripped run goes on [s]
    torque_time: float  # how long a motor may ask for more [s]
    position: float  # limit of the position error [m]
    heading: float  # limit of the heading error [rad]
    weights: float  # bound on the weights of a network
    hold_rate: float  # of the integral that holds the arm [1/s]
    h: float  # control period [s]
    settle: float  # time after which a stop that does not bring the robot to rest is given up [s]
    rest: float  # speed below which it rests
    short: float  # 1 where shorted windings brake the base, else 0
    fresh: float  # age of a measurement beyond which a stop does without [s]
    slowest: float  # longest control period [s]
    twist: float  # largest speed of a base that steers [m/s]
    yaw_rate: float  # its largest yaw rate [rad/s]
    limited: float  # 1 where silence is limited by how far velocities may lead, 0 by `timeout` alone
    quick: float  # share of a difference that the low-passes of `check_shaking` take in a sample
    fresher: float  # likewise the average of its squares
    contact: float  # 1 where contact trips


@by_address
class SupervisorState(NamedTuple):
    """The memory of a supervisor: single numbers, each a view (1,) of its state."""

    tripped: Array  # 1 once something tripped: at a time, for a reason, at a place, with a value beyond a limit
    time: Array
    code: Array
    place: Array
    value: Array
    limit: Array
    heard: Array  # when the last good measurement was taken [s]
    commanded: Array  # when the last good command came [s]
    good: Array  # how many measurements were good
    bad: Array  # how many were refused
    held: Array  # 1 while a measurement that is not finite is replaced by the last good one
    refused: Array  # how many commands were refused
    acted: Array  # 1 once a stop has noted where it began, 2 once feedback did not bring the robot to rest in time
    arrived: Array  # when it came [s]
    sampled: Array  # time of the last sample, inf before the first [s]
    period: Array  # the control period on average [s]
    last_period: Array  # the same at last
    steady: Array  # the same at last, without pauses
    in_a_row: Array  # how many periods in a row were too long
    news: Array  # what is new since one of a later time was seen: 1 its numbers, 2 its time, 3 both, else 0
    waited: Array  # how long ago one of a later time came last, inf for never [s]
    since: Array  # when one that differed came last, -inf for never [s]
    every: Array  # time from one to the next, on average [s]


MARKS = len(SupervisorState._fields)


@by_address
class Door(NamedTuple):
    """The door that measurements pass, as few arrays: a program of your own hands them over at every measurement."""

    # (6, n + pivots) of every joint of the arm, then of every pivot: a whole turn, 0 for one that slides; its ends; the
    # speed that explains how its position changes; what of that no speed needs to explain; 1 where it may be as fast as
    # it likes
    joints: Array
    # (2, p) by how much position and velocity may contradict each other in a stop, and velocities beyond which a stop
    # drives on what it should brake
    rows: Array
    message: Array  # the last good measurement: pose, velocity, q, qdot, shape
    state: SupervisorState  # single numbers, the supervisor's
    # (7, p + pivots) by how much positions have lately changed more than the velocities say; velocities of the last
    # measurement, in a stop the least speeds since it began; 1 s more than when a stop went without their feedback, 0
    # while it has some, -1 where that is for good; jumps that were taken out of the joints' positions; age of the last
    # change of position or velocity, to the last bit, 0 for now, and how old it usually gets [s]; the last change of
    # position
    sense: Array
    sideways: bool  # whether the base velocity is `(vx, vy, w)`
    eta: Array  # (3,) `(vx, vy, w)` of a base that steers, at the last sample; (0,) of others
    along: Array  # (3, nb) that per base velocity
    masters: IntArray  # places in `shape` of the pivots whose rates are the last base velocities
    length: float  # l of `base.rolling` [m]


@by_address
class Supervisor(NamedTuple):
    """A supervisor of one run: its limits and its state as arrays."""

    on: bool  # whether there is one; the others are empty if not
    numbers: SupervisorNumbers  # settings that are single numbers
    torque: Array  # (motors,) torque limits [N m or N]
    speed: Array  # (p,) speed limits [m/s, rad/s; rad/s or m/s]
    gains: Array  # (p,) feedback that brakes and holds [N s/m, N m s/rad; N m s/rad or N s/m]
    error: Array  # (n,) limits of the joints' errors [rad or m]
    K: Array  # (n,) gain of the filtered arm error [1/s]
    wheel: Array  # (wheels,) speed limits of the drive wheels, then of what motors steer [rad/s]
    door: Door  # what measurements pass
    E: Array  # (p, motors) torque on nu from motor torques; of a base that steers that of the last sample
    E_inv: Array  # (motors, p) the way back, likewise
    weights: IntArray  # (k, 2) start and stop of every array of weights in the controller's state
    reach: Array  # (p,) how far velocities may lead while no measurement says so; inf for any way [m, rad]
    mobility: Array  # (p, p) largest |M^-1| of some postures [1/kg, 1/(kg m), 1/(kg m^2)]
    asked: Array  # (p,) velocities that servos are asked for, of their rows
    shaken: Array  # (motors,) largest RMS of the fast part of the torque that is learned [N m or N]
    values: Array  # state: all of the following
    state: SupervisorState  # single numbers
    message: Array  # the last good measurement: pose, velocity, q, qdot, shape
    last: Array  # (p,) the last torque
    above: Array  # (motors,) how long every motor has asked for more than its limit [s]
    place: Array  # (n,) where the joints are held
    integral: Array  # (n,) of their errors
    stale: Array  # (p,) the torque that was sent on the last measurement
    # (5, p) how far velocities may have led in silence, and what led away from values that stand, inf where that is too
    # far; their bound in silence, and their average acceleration; torque that was sent before the last measurement
    sight: Array
    # (3, motors) torque that is learned behind a low-pass, what is faster behind another, and the average of the
    # squares of what is faster still
    shake: Array


@linked
def has_ended(time: float, numbers: SupervisorNumbers, state: SupervisorState) -> bool:
    """Whether a tripped run has shown its stop for long enough."""
    return state.tripped[0] > 0.0 and time - state.time[0] >= numbers.stop_time - EARLY


@compiled
def may_learn(state: SupervisorState) -> bool:
    """Whether the controller is to be asked: there is a measurement, and nothing has tripped."""
    return state.tripped[0] == 0.0 and state.good[0] > 0.0


@internal
def trip(time: float, code: int, place: int, value: float, limit: float, state: SupervisorState) -> None:
    """Stop, for the first reason that comes up."""
    if state.tripped[0] == 0.0:
        state.tripped[0], state.time[0], state.code[0], state.place[0] = 1.0, time, float(code), float(place)
        state.value[0], state.limit[0] = value, limit


def press(time: float, supervisor: Supervisor) -> None:
    """An emergency stop from outside, at a time [s]: what a trip does, whatever is to be followed."""
    trip(time, PRESSED, 0, 0.0, 0.0, supervisor.state)


@internal
def supervise(row: Array, at: IntArray, time: float, arrived: bool, weights: Array, supervisor: Supervisor) -> None:
    """Check a sample and write the torque that goes to the motors into the row, and what was done as `safety`.

    Args:
        row: (width,) row of signals, the controller's torque in it.
        at: Offsets of the signals.
        time: Of the sample [s].
        arrived: Whether a command came.
        weights: The controller's state.
        supervisor: The supervisor.
    """
    tau, state, numbers = row[at[TORQUE] : at[TORQUE + 1]], supervisor.state, supervisor.numbers
    step_in = bound_weights(time, weights, supervisor) or state.held[0] > 0.0 or state.good[0] == 0.0
    if state.good[0] > 0.0:
        look(row, at, time, supervisor)
    check_period(time, state, numbers)
    if state.good[0] > 0.0:
        check_motion(row, at, time, supervisor)
    check_contact(row, at, time, supervisor)
    fine = arrived
    for i in range(tau.size):
        fine = fine and math.isfinite(tau[i])
    for i in range(at[PSI_HAT], at[TORQUE]):  # what else came with a broken command is no number either
        row[i] = row[i] if math.isfinite(row[i]) else 0.0
    if state.tripped[0] == 0.0:
        if fine:
            state.commanded[0] = time
        else:
            state.refused[0] += arrived
            step_in = True
            copy_to(supervisor.last, tau)
        if state.good[0] == 0.0:
            tau[:] = 0.0
        check_shaking(row, at, time, supervisor)
        if time - state.heard[0] > numbers.timeout + EARLY:
            trip(time, DEAF, 0, time - state.heard[0], numbers.timeout, state)
        elif time - state.commanded[0] > numbers.timeout + EARLY:
            trip(time, LOST, 0, time - state.commanded[0], numbers.timeout, state)
    row[at[STATE]] = STEPPED_IN if step_in else RUNNING
    if state.tripped[0] > 0.0:
        stop(row, at, time, supervisor)
    clipped = clip(time, tau, supervisor)
    if clipped and row[at[STATE]] == RUNNING:
        row[at[STATE]] = STEPPED_IN
    copy_to(tau, supervisor.last)


@internal
def check_shaking(row: Array, at: IntArray, time: float, supervisor: Supervisor) -> None:
    """Trip where what is learned shakes a motor: the RMS of its torque's fast part is beyond its limit.

    Psi_hat as it is sent and the robust term count, behind two high-passes; what the first sample has is no step, and a
    step larger than a motor's torque limit counts as that.
    """
    shake, state, numbers = supervisor.shake, supervisor.state, supervisor.numbers
    p, psi = at[TORQUE + 1] - at[TORQUE], at[PSI_APPLIED] if at[PSI_APPLIED + 1] > at[PSI_APPLIED] else at[PSI_HAT]
    for j in range(shake.shape[1]):
        u = 0.0
        for i in range(p):
            u += supervisor.E_inv[j, i] * (row[psi + i] + row[at[ROBUST] + i])
        if shake[SLOWER, j] == 0.0 and shake[POWER, j] == 0.0:
            shake[SLOWER, j] = u
        most = supervisor.torque[j]
        step = min(max(u - shake[SLOWER, j], -most), most)
        shake[SLOWER, j] += numbers.quick * step
        faster = (1.0 - numbers.quick) * step
        shake[SLOW, j] += numbers.quick * (faster - shake[SLOW, j])
        fast = faster - shake[SLOW, j]
        shake[POWER, j] += numbers.fresher * (fast * fast - shake[POWER, j])
        if shake[POWER, j] > supervisor.shaken[j] * supervisor.shaken[j]:
            trip(time, SHAKING, j, math.sqrt(shake[POWER, j]), supervisor.shaken[j], state)


@internal
def look(row: Array, at: IntArray, time: float, supervisor: Supervisor) -> None:
    """Trip where the robot may have gone too far since a measurement last said where it is.

    In silence a velocity that is `nu` at the last measurement is at most `|nu| + int |a| + W |tau - tau_0| dt`: a is
    its acceleration at the last measurements, tau_0 the torque that was sent before, and W the largest |M^-1|; a servo
    reaches what it is asked for. A measurement is as old as its oldest part: where its time stays, what changes is
    measured, and all else is silent. What stands in measurements that keep coming contradicts the velocity that is
    measured with it and that of the reference, each by how far it leads meanwhile.
    """
    state, sight, sense, numbers = supervisor.state, supervisor.sight, supervisor.door.sense, supervisor.numbers
    h = numbers.h
    p, dt = sight.shape[1], max(time - state.sampled[0], 0.0)
    nb, since, waited = p - supervisor.place.size, time - state.since[0], state.waited[0]
    silent, is_news, runs = state.news[0] < 2.0, state.news[0] == 3.0, state.tripped[0] == 0.0
    if waited < math.inf and not silent:
        state.every[0] += SMOOTH * (min(waited, GAP * state.every[0]) - state.every[0])
    for i in range(p):
        nu, bend = velocity_of(row, at, i, nb), abs(sight[BEND, i])
        if silent and sense[SAME, i] > 0.0:
            for j in range(p):
                bend += supervisor.mobility[i, j] * abs(supervisor.last[j] - sight[KNOWN, j])
            rate = max(sight[RATE, i], abs(supervisor.asked[i]))
            sight[SILENT, i] += dt * (rate + 0.5 * dt * bend)
            sight[RATE, i] = rate + dt * bend
        else:
            sight[SILENT, i], sight[RATE, i] = 0.0, abs(nu)
        if runs and min(sense[SAME, i], waited) <= state.last_period[0]:
            supervisor.stale[i] = supervisor.last[i]  # it was measured at the last sample
        if not silent:
            sight[KNOWN, i] = supervisor.last[i]
            if is_news and runs:
                sight[BEND, i] += SMOOTH * ((nu - sense[SPEED, i]) / max(since, h) - sight[BEND, i])
                sense[SPEED, i] = nu
            check_standing(row, at, time, i, nu, is_news, supervisor)
        coming = numbers.limited * (sight[SILENT, i] + h * (sight[RATE, i] + 0.5 * h * bend))
        if coming > supervisor.reach[i] and not is_news and since + h > MISSED * state.every[0] + EARLY:
            trip(time, BLIND, i, coming, supervisor.reach[i], state)
        sense[SAME, i] += dt
    for i in range(p, sense.shape[1]):  # pivots, which no velocity turns
        sense[SAME, i] += dt
    if is_news:
        state.since[0] = time
    if not silent:
        state.news[0], state.waited[0] = 0.0, 0.0
    state.waited[0] += dt


@internal
def check_standing(
    row: Array, at: IntArray, time: float, i: int, nu: float, is_news: bool, supervisor: Supervisor
) -> None:
    """Trip where velocities lead away from a position that stands, over a time, and are too far from it twice in a row.

    Once is an encoder between two of its steps, whose velocity goes back and forth with it. What a servo is asked for
    may be held: there the reference counts where nothing new is measured alone.
    """
    nb = supervisor.sight.shape[1] - supervisor.place.size
    lead, counts = CONTRADICTS * nu, supervisor.numbers.limited > 0.0 or not is_news
    if supervisor.asked[i] == 0.0 or not is_news:
        lead += LEFT * referred(row, at, i, nb, supervisor)
    sense, stood, reach = supervisor.door.sense, supervisor.sight[STOOD], supervisor.reach[i]
    before = abs(stood[i])
    stood[i] = stood[i] + supervisor.state.waited[0] * lead if sense[SAME, i] > 0.0 else 0.0
    is_far = counts and before > reach and abs(stood[i]) > reach
    if is_far and sense[SAME, i] > HELD * sense[USUAL, i] + EARLY:
        trip(time, BLIND, i, before, reach, supervisor.state)
        stood[i] = math.inf


@compiled
def velocity_of(row: Array, at: IntArray, i: int, nb: int) -> float:
    """The measured velocity i, of the base and then of the joints."""
    return row[at[VELOCITY] + i] if i < nb else row[at[QDOT] + i - nb]


@compiled
def referred(row: Array, at: IntArray, i: int, nb: int, supervisor: Supervisor) -> float:
    """The reference's velocity i; of a base that steers the size of its twist, and none of what steers."""
    if i >= nb:
        return row[at[QDOT_REF] + i - nb]
    if supervisor.door.eta.size == 0:
        return row[at[VELOCITY_REF] + i]
    twist = row[at[VELOCITY_REF] : at[VELOCITY_REF + 1]]
    return hypot(twist[0], twist[1] if twist.size == 3 else 0.0) if i == 0 else 0.0


@internal
def check_period(time: float, state: SupervisorState, numbers: SupervisorNumbers) -> None:
    """Trip on a control period that is too long on average or several times in a row; a pause alone does not count."""
    if state.period[0] == 0.0:
        state.period[0] = state.last_period[0] = state.steady[0] = numbers.h
        state.in_a_row[0] = 0.0
    else:
        period = time - state.sampled[0]
        state.steady[0] = min(period, min(state.last_period[0], GAP * numbers.slowest))
        state.period[0] += (state.steady[0] - state.period[0]) / SAMPLES
        state.last_period[0] = period
        state.in_a_row[0] = state.in_a_row[0] + 1.0 if period > numbers.slowest else 0.0
    state.sampled[0] = time
    if state.period[0] > numbers.slowest or state.in_a_row[0] >= TOO_MANY:
        trip(time, TOO_SLOW, 0, max(state.period[0], state.steady[0]), numbers.slowest, state)


@internal
def bound_weights(time: float, weights: Array, supervisor: Supervisor) -> bool:
    """Scale weights back onto their bound; true if some were beyond it."""
    beyond, places, most = False, supervisor.weights, supervisor.numbers.weights
    for k in range(places.shape[0]):
        beyond = bound(weights[places[k, 0] : places[k, 1]], most, time, k, supervisor.state) or beyond
    return beyond


@internal
def bound(W: Array, most: float, time: float, k: int, state: SupervisorState) -> bool:
    """Scale the weights of one network onto their bound, or trip where they are no numbers; true if beyond it."""
    squares = 0.0
    for i in range(W.size):
        squares += W[i] * W[i]
    if not math.isfinite(squares):
        trip(time, BAD_WEIGHTS, k, squares, most, state)
        return False
    if not squares > most * most:
        return False
    scale = most / math.sqrt(squares)
    for i in range(W.size):
        W[i] *= scale
    return True


@internal
def check_contact(row: Array, at: IntArray, time: float, supervisor: Supervisor) -> None:
    """Trip on contact, where that is asked for and something feels it."""
    if supervisor.numbers.contact > 0.0 and at[CONTACT + 1] > at[CONTACT] and row[at[CONTACT]] > 0.0:
        trip(time, TOUCHED, 0, 1.0, 0.0, supervisor.state)


@internal
def check_motion(row: Array, at: IntArray, time: float, supervisor: Supervisor) -> None:
    """Trip on measured speeds and tracking errors beyond their limits."""
    nb, n = at[ALPHA + 1] - at[ALPHA], at[JOINT_ERROR + 1] - at[JOINT_ERROR]
    speeds, errors, numbers, state = supervisor.speed, supervisor.error, supervisor.numbers, supervisor.state
    eta = supervisor.door.eta
    if eta.size:
        check_twist(time, hypot(eta[0], eta[1]), abs(eta[2]), numbers, state)
    for i in range(nb + n):
        speed = abs(velocity_of(row, at, i, nb))
        if at[SIDEWAYS] and i < 2 and eta.size == 0:  # the speed of a base that moves sideways, too
            speed = hypot(row[at[VELOCITY]], row[at[VELOCITY] + 1])
        if speed > speeds[i]:
            trip(time, OVER_SPEED, i, speed, speeds[i], state)
    for j in range(supervisor.wheel.size):
        turning = abs(wheel_speed(row, at[VELOCITY], nb, j, supervisor.E))
        if turning > supervisor.wheel[j]:
            trip(time, OVER_WHEEL, j, turning, supervisor.wheel[j], state)
    if at[POSE_ERROR + 1] > at[POSE_ERROR]:
        away = hypot(row[at[POSE_ERROR]], row[at[POSE_ERROR] + 1])
        turned = abs(row[at[POSE_ERROR] + 2])
        if away > numbers.position:
            trip(time, OFF_PATH, 0, away, numbers.position, state)
        if turned > numbers.heading:
            trip(time, OFF_HEADING, 2, turned, numbers.heading, state)
    for i in range(n):
        if abs(row[at[JOINT_ERROR] + i]) > errors[i]:
            trip(time, OFF_JOINT, i, abs(row[at[JOINT_ERROR] + i]), errors[i], state)


@internal
def check_twist(time: float, speed: float, turning: float, numbers: SupervisorNumbers, state: SupervisorState) -> None:
    """Trip on speeds of a base that steers beyond their limits [m/s, rad/s]."""
    if speed > numbers.twist:
        trip(time, OVER_TWIST, 0, speed, numbers.twist, state)
    if turning > numbers.yaw_rate:
        trip(time, OVER_TWIST, 1, turning, numbers.yaw_rate, state)


@compiled
def wheel_speed(row: Array, start: int, nb: int, j: int, E: Array) -> float:
    """Speed of drive wheel j under the base velocity (nb,) that starts at a place of the row."""
    speed = 0.0
    for i in range(nb):
        speed += E[i, j] * row[start + i]
    return speed


@internal
def stop(row: Array, at: IntArray, time: float, supervisor: Supervisor) -> None:
    """Brake the base and hold the arm by what is measured of them.

    What is not, or is not brought to rest so, gets no torque, or that of an arm's joint goes to zero in time.
    """
    tau, state, numbers = row[at[TORQUE] : at[TORQUE + 1]], supervisor.state, supervisor.numbers
    place, integral, sense, n = supervisor.place, supervisor.integral, supervisor.door.sense, supervisor.place.size
    nb, is_first, blind = tau.size - n, state.acted[0] == 0.0, 0
    if time - state.time[0] > numbers.settle and moves(row, at, nb, supervisor):
        state.acted[0] = 2.0
    last = min(state.arrived[0], state.since[0]) if state.code[0] == BLIND else state.arrived[0]
    nothing, old = state.acted[0] > 1.0 or state.good[0] == 0.0, time - last > numbers.fresh
    youngest = max(state.waited[0], HALF * state.every[0]) - EARLY  # what changed since is younger than the message
    for i in range(nb + n):
        is_old = old and not sense[SAME, i] < min(youngest, numbers.fresh)
        is_blind = nothing or is_old or supervisor.sight[STOOD, i] == math.inf
        blind += is_blind
        if is_first and is_blind:  # not what was made of a measurement that is none
            supervisor.last[i] = supervisor.stale[i]
        if is_first or (sense[WITHOUT, i] > 0.0 and not is_blind):
            sense[SPEED, i], sense[WITHOUT, i] = abs(velocity_of(row, at, i, nb)), 0.0
            if i >= nb:  # hold the arm where it is now
                place[i - nb], integral[i - nb] = row[at[Q] + i - nb], 0.0
        if is_blind and sense[WITHOUT, i] == 0.0:
            sense[WITHOUT, i] = time + 1.0
    state.acted[0] = max(state.acted[0], 1.0)
    row[at[STATE]] = RAMPING if blind == nb + n else STOPPING
    lose(row, at, supervisor)
    slow = min(1.0, BORNE * numbers.slowest / state.steady[0])
    fade = max(0.0, numbers.ramp - (time - state.time[0])) / (numbers.ramp + numbers.h)
    for i in range(nb + n):
        if sense[WITHOUT, i] > 0.0:  # these factors multiply to a straight line; no weight moves a base
            left = numbers.ramp - (time + 1.0 - sense[WITHOUT, i])
            tau[i] = supervisor.last[i] * left / (left + numbers.h) if left > 0.0 and i >= nb else 0.0
            continue
        hold, k = -plausible(velocity_of(row, at, i, nb), i, supervisor.door), i - nb
        if k < 0 and numbers.short > 0.0:
            hold = 0.0
        if k >= 0:
            e = place[k] - row[at[Q] + k]
            if supervisor.above[supervisor.above.size - n + k] == 0.0 or e * integral[k] < 0.0:
                integral[k] += numbers.h * numbers.hold_rate * e
            K = supervisor.K[k] if slow == 1.0 else min(supervisor.K[k], BORNE / state.steady[0])
            hold += K * (e + integral[k])
        stale = fade * supervisor.stale[i] if state.code[0] == LOST else 0.0
        tau[i] = (stale + slow * supervisor.gains[i] * hold) * trust(i, supervisor.door)


@internal
def lose(row: Array, at: IntArray, supervisor: Supervisor) -> None:
    """Do without feedback where it drives the robot on, or where position and velocity contradict each other.

    What steers may be turned by the brakes of what drives; its angle tells whether its rate is true.
    """
    rows, sense, n = supervisor.door.rows, supervisor.door.sense, supervisor.place.size
    nb = rows.shape[1] - n
    for i in range(nb + n):
        speed = abs(velocity_of(row, at, i, nb))
        sense[SPEED, i] = min(sense[SPEED, i], speed)
        driven = speed > max(HALF * rows[MOST, i], FASTER * sense[SPEED, i])
        steers = min(i - (nb - supervisor.door.masters.size), nb - 1 - i) >= 0  # C compilers see no empty range so
        if (driven and not steers) or abs(sense[DRIFT, i]) > rows[CONTRADICTION, i]:
            sense[WITHOUT, i] = -1.0
    for j in range(supervisor.wheel.size):
        turned, drives = 0.0, 0.0
        for i in range(nb):
            turned += abs(supervisor.E[i, j]) * sense[SPEED, i]
            drives += abs(supervisor.E[i, j]) if i < nb - supervisor.door.masters.size else 0.0
        turning = abs(wheel_speed(row, at[VELOCITY], nb, j, supervisor.E))
        driven = turning > max(HALF * supervisor.wheel[j], FASTER * turned)
        if driven and drives > 0.0 and math.isfinite(rows[CONTRADICTION, 0]):  # what only steers has its own row
            for i in range(nb):
                sense[WITHOUT, i] = -1.0


@compiled
def trust(i: int, door: Door) -> float:
    """Share of a velocity's feedback that is left: less, the more position and velocity contradict each other."""
    if door.sense[WITHOUT, i] < 0.0:
        return 0.0
    return max(0.0, 1.0 - abs(door.sense[DRIFT, i]) / door.rows[CONTRADICTION, i])


@compiled
def plausible(velocity: float, i: int, door: Door) -> float:
    """A measured velocity, as far as it can be true."""
    most = PLAUSIBLE * door.rows[MOST, i]
    return min(max(velocity, -most), most)


@compiled
def moves(row: Array, at: IntArray, nb: int, supervisor: Supervisor) -> bool:
    """Whether a velocity that is measured is not at rest."""
    fastest = 0.0
    for i in range(nb + supervisor.place.size):
        if supervisor.door.sense[WITHOUT, i] <= 0.0:
            fastest = max(fastest, abs(velocity_of(row, at, i, nb)))
    return fastest > supervisor.numbers.rest


@compiled
def clip(time: float, tau: Array, supervisor: Supervisor) -> bool:
    """Clip the motor torques, and trip when a motor has asked for too much for too long."""
    clipped, numbers, above = False, supervisor.numbers, supervisor.above
    for j in range(above.size):
        u, limit = entry(supervisor.E_inv, j, tau), supervisor.torque[j]
        over = abs(u) > limit
        clipped = clipped or over
        above[j] = above[j] + numbers.h if over else 0.0
        if above[j] > numbers.torque_time + EARLY:
            trip(time, OVER_TORQUE, j, abs(u), limit, supervisor.state)
    if clipped:
        if supervisor.door.eta.size:
            nb = supervisor.door.rows.shape[1] - supervisor.place.size
            yield_drive(tau, nb - supervisor.door.masters.size, supervisor.E_inv, supervisor.torque)
        within(tau, supervisor.E, supervisor.E_inv, supervisor.torque)
    return clipped


@internal
def yield_drive(tau: Array, drive: int, E_inv: Array, limits: Array) -> None:
    """Lower what drives, the first of tau (p,), as far as the limits ask: what steers and the arm keep theirs."""
    share = 1.0
    for j in range(limits.size):
        u, mine = entry(E_inv, j, tau), 0.0
        for i in range(drive):
            mine += E_inv[j, i] * tau[i]
        if abs(u) > limits[j] and u * mine > 0.0:
            share = min(share, max(0.0, 1.0 - (abs(u) - limits[j]) / abs(mine)))
    for i in range(drive):
        tau[i] *= share


@internal
def within(tau: Array, E: Array, E_inv: Array, limits: Array) -> None:
    """Tau (p,) with every motor within its limit (motors,); more motors than velocities are all scaled alike."""
    p, motors, scale = E.shape[0], E.shape[1], 1.0
    for j in range(motors):
        u, limit = entry(E_inv, j, tau), limits[j]
        if abs(u) > limit:
            scale = min(scale, limit / abs(u))
            if motors == p:
                for i in range(p):
                    tau[i] -= E[i, j] * (u - math.copysign(limit, u))
    if motors != p:
        for i in range(p):
            tau[i] *= scale
