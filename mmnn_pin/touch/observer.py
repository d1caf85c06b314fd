"""External torque by the generalized momentum, compiled: what moves a robot and neither model nor motors explain.

    p = M nu,      pdot = tau + tau_ext + C' nu - gravity - friction,      Mdot = C + C',

with the reduced M and C of `T' (.) T`, where T is constant and where it turns with the wheels. No acceleration is
needed (De Luca, Albu-Schaeffer, Haddadin, Hirzinger 2006, IEEE/RSJ IROS; Haddadin, De Luca, Albu-Schaeffer 2017, IEEE
T-RO 33(6)):

    r = bandwidth (p - int (tau + C' nu - gravity - friction + r) dt),      r = tau_ext / (1 + s / bandwidth).

tau is what was sent, behind the supervisor, the motors' known limits, the way of the commands and the motors' lag.

A controller's Psi_hat is a model as well. With s = nu_ref - nu

    tau_ext = Psi - tau - (M sdot + C s),

so that of a model of the file only M and C times the error remain where Psi_hat takes the place of its Psi: r of that
model is r of the file's and `Psi_hat - Psi`, behind the same filter.

**The band.** Errors of the model that are as large as the settings say, each body and each friction alone, give r the
covariance S: what bodies and friction add to the torque is the regressor times the parameters, body by body, and passes
the same filter. Where Psi_hat takes a share of the model, what they add to Psi goes out of S by that share and the
covariance of Psi_hat comes in; M and C times the error remain as wrong as the file, and so does friction of what
stands. What r does from sample to sample is noise of the measurement, and is measured. Contact
is where `r' S^-1 r` is beyond the quantile of chi^2.

**A load is no contact.** A mass that moves rigidly with the hand brings `r = -Y pi` with the columns Y of its mass and
first moment, `pi = (m, mc)`, behind the same filter; gravity is in Y. From the sample on that feels something pi is
fitted to what is felt, and where it leaves less than `MISFIT` of it, with m > 0, within reach and no heavier than the
arm, a load is carried: it is taken out of what is felt, and learned. A push straight down on an arm that stands is a
load, too.

**What was learned of a contact before it was felt** is forgotten: where one begins a learner's state goes back to a
copy that is `REWIND` to twice as old.

**The wrench** w of the hand with Jacobian J, `r = J' w`, is the least squares in the metric S with almost no prior,
`(J S^-1 J' + W^-1)^-1 J S^-1 r`. Of an axis that no joint feels it is 0; `wrench_seen` says which part of every axis is
felt: the diagonal of `(J S^-1 J' + W^-1)^-1 J S^-1 J'`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..by_address import by_address
from ..compiled import compiled, copy_to, entry, internal, linked
from ..elementary import cos_sin, exp, tanh
from ..elementary.arrays import is_below
from ..model.reduction import as_measured, put_shape, solve, substitute
from ..model.regressor import Massless, measured, regress
from ..model.tree.body import Body, Work, evaluate
from ..model.tree.dynamics import psi_again
from ..model.tree.motion import AT, BASE, LINK, ZERO, Triple, add, cross, dot, get
from ..model.tree.twin import psi_of
from ..parts import view
from ..signals import INDEX, Array, IntArray

POSE, VELOCITY, Q, QDOT, SHAPE = (INDEX[name] for name in ("pose", "velocity", "q", "qdot", "shape"))
NU_REF, NUDOT_REF, TORQUE = (INDEX[name] for name in ("nu_ref", "nudot_ref", "torque"))
VELOCITY_REF, POSE_ERROR = INDEX["velocity_ref"], INDEX["pose_error"]
EXTERNAL, BAND, WRENCH = INDEX["external_torque"], INDEX["external_band"], INDEX["external_wrench"]
SEEN, CONTACT, LOADED = INDEX["wrench_seen"], INDEX["contact"], INDEX["load"]
URDF, LEARNER, BOTH = range(3)
ON, FROZEN, DEADZONE = range(3)
GAP = 2.5  # periods between two samples beyond which the observer begins anew
LARGEST = 1e9  # a state or torque beyond this is none [SI units]
AVERAGED = 1.0  # time over which noise is averaged [s]
SELDOM = 5  # samples from one covariance of a learner to the next
SETTLES = 5.0  # time constants of the observer before it is believed
FORCE, MOMENT = 1e3, 3e2  # prior of the wrench [N, N m]
TIME, COUNT, ELAPSED, WAIT, CLEAR, FELT, TOUCHED, SINCE, GIVES, BEGUN, AGE, WAITS, EASED = range(13)  # of a clock
REWIND = 0.3  # time between two copies of what a learner knows; the older one is taken where contact begins [s]
LOAD = 4  # parameters of a load: mass and first moment
DECIDES = 0.25  # time in which a load is told from a contact [s]
RISES = 3.0  # time constants of the observer after which what is felt is fitted
FORGETS = 0.3  # time over which what is felt is fitted [s]
MISFIT = 0.1  # share of the squares that a load may leave
REACH = 0.5  # how far from its joint a load may be [m]
UNSURE = 0.2  # standard deviation of a load's share of r
TURNS, ALIGNED = 2.0, 0.01  # how fast a base that stands is turned back [1/s], and what is left then [rad/s]
GROWS = 0.5  # share of the largest velocity that a robot which goes back takes on in `clear`
GONE = 0.01  # share of what a robot stood against that is nothing
CERTAIN = 1e-9  # of the information about a load, relative, below which it is none


@by_address
class TouchNumbers(NamedTuple):
    """The settings that are single numbers, see `settings.Touch`.

    Attributes:
        h: Control period [s].
        every: Samples from one measurement to the next.
        bandwidth: Of the observer [1/s].
        threshold: Of `r' S^-1 r`.
        model: `URDF`, `LEARNER` or `BOTH`.
        late: How many periods ago was asked for what acts, a part of one included.
        torque: Standard deviation of the motors' torque, relative.
        clear: How long nothing is to be felt before a contact is over [s].
        settle: How long a learner then waits [s].
        freezes: `ON`, `FROZEN` or `DEADZONE`, see `Touch.learning`.
        gives: 1 where the robot gives way to contact.
        eases: 1 where the feedback is eased back after it.
        yields: Share of the feedback gains that damps it then.
        back: Largest velocity at which it goes back [m/s, rad/s].
        heaviest: A load is no heavier, which is what the arm itself weighs [kg].
    """

    h: float
    every: int
    bandwidth: float
    threshold: float
    model: int
    late: float
    torque: float
    clear: float
    settle: float
    freezes: int
    gives: int
    eases: int
    yields: float
    back: float
    heaviest: float


@by_address
class TouchState(NamedTuple):
    """State of the observer.

    Attributes:
        clock: (13,) time of the last sample [s], samples that have followed one another, time since the last
            measurement [s], time until the observer is believed [s], how long nothing was felt [s], 1 where something
            is felt in this sample, 1 while there is contact, how long something has been felt [s], 1 while a robot
            gives way, 1 where contact begins with this sample, age of the last copy of what is learned [s], 1
            while a learner waits for the robot to be back, share of `stood` that still stands.
        momentum: (p,) at the last measurement.
        bias: (p,) `C' nu - gravity - friction` there.
        last: (p,) nu there.
        impulse: (p,) of the motors since then [N s, N m s].
        stood: (p,) torque of the world that the robot has lately stood against.
        wished: (p,) velocity at which a robot that gave way goes back.
        residual: (p,) r with the model of the file [N, N m].
        beyond: (2, p) `Psi_hat - Psi` of the last sample, and behind the filter.
        weight: (p,) gravity and friction of the model.
        parts: (g, p) what every group of parameters, wrong by its standard deviation, brings to r.
        asked: (g, p) the same of Psi at the last sample.
        spared: (g, p) that behind the filter: what Psi_hat in the place of Psi takes out of `parts`.
        brings: (4, p) what a load of one unit each brings to r.
        load: (4,) mass and first moment of the load in the axes of its body [kg, kg m].
        fit: (5, 5) information about it since something is felt: of the load, its other side, and the squares.
        noise: (p, p) covariance of what r does from one measurement to the next, halved.
        learned: (p, p) covariance of Psi_hat; its first entry is negative where nobody knows.
        saved: (2, size) the controller's state of a moment ago, and of the moment before; (2, 0) where it is not kept.
        held: (m, p) torque that is held since the last sample, and those before it that are under way.
        driven: (p,) torque that the motors give.
    """

    clock: Array
    momentum: Array
    bias: Array
    last: Array
    impulse: Array
    stood: Array
    wished: Array
    residual: Array
    beyond: Array
    weight: Array
    parts: Array
    asked: Array
    spared: Array
    brings: Array
    load: Array
    fit: Array
    noise: Array
    learned: Array
    saved: Array
    held: Array
    driven: Array


@by_address
class Feeler(NamedTuple):
    """The observer of one robot: model, doubt, hand, and room to work in.

    Attributes:
        numbers: Settings.
        body: The robot as its file describes it.
        work: Room for its dynamics.
        known: How it moves.
        theta: (k,) its parameters, in the order of the regressor.
        doubt: (g,) standard deviation of a group of them, relative.
        ends: (g + 1,) where the groups begin in theta.
        dry: (joints,) dry friction of every joint that moves [N m or N].
        felt: (p,) 1 where a torque is sent, 0 where a servo holds a velocity.
        gains: (p,) feedback on the velocities.
        floor: (p,) standard deviation of what no model states [N, N m].
        most: (motors,) limits of the motors [N m or N].
        E: (p, motors) torque on nu from motor torques; of a base that steers that of the last sample.
        E_inv: (motors, p) and back.
        motor: (p,) exp(-h / lag) of the motors, 0 without lag.
        drag: (p,) lag / h.
        column: Of theta where the body that carries the hand begins; negative for none.
        carrier: Row of the tree that carries the hand.
        moving: 1 where the axes of the tree turn with the base, 0 where they are the world's.
        hand: (3,) the hand in the axes of its body [m].
        position: (nv,) position of the measurement.
        nu: (p,) velocity of the measurement.
        vectors: (7, p) room to work in.
        S: (p, p) covariance of r.
        L: (p, p) its factor.
        J: (6, p) Jacobian of the hand, in the world's axes.
        X: (6, p) `S^-1 J'`, transposed.
        G: (2, 6, 6) information of the wrench with its prior, and the factor of that.
        wrench: (2, 6) room to work in.
        state: What it remembers.
    """

    numbers: TouchNumbers
    body: Body
    work: Work
    known: Massless
    theta: Array
    doubt: Array
    ends: IntArray
    dry: Array
    felt: Array
    gains: Array
    floor: Array
    most: Array
    E: Array
    E_inv: Array
    motor: Array
    drag: Array
    column: int
    carrier: int
    moving: int
    hand: Array
    position: Array
    nu: Array
    vectors: Array
    S: Array
    L: Array
    J: Array
    X: Array
    G: Array
    wrench: Array
    state: TouchState


@compiled
def is_frozen(touch: Feeler) -> bool:
    """Whether a learner is to keep what it knows."""
    freezes, clock = touch.numbers.freezes, touch.state.clock
    return (freezes == FROZEN and clock[WAITS] > 0.0) or (freezes == DEADZONE and clock[FELT] > 0.0)


@compiled
def go_back(learned: Array, a: Feeler) -> None:
    """Copy what a learner knows (size,) now and then, and take an old copy where contact begins."""
    s = a.state
    old, older = s.saved[0], s.saved[1]
    if older.size == 0:
        return
    if s.clock[BEGUN] > 0.0:
        copy_to(older, learned)
        copy_to(older, old)
        s.clock[BEGUN] = 0.0
    elif s.clock[COUNT] <= 1.0:
        copy_to(learned, old)
        copy_to(learned, older)
    elif s.clock[TOUCHED] == 0.0:
        s.clock[AGE] += a.numbers.h
        if s.clock[AGE] >= REWIND:
            copy_to(old, older)
            copy_to(learned, old)
            s.clock[AGE] = 0.0


@compiled
def is_asked(touch: Feeler) -> bool:
    """Whether a learner is to tell its covariance at this sample."""
    return touch.numbers.model != URDF and int(touch.state.clock[COUNT]) % SELDOM == 1


@linked
def feel(row: Array, at: IntArray, time: float, a: Feeler) -> None:
    """External torque, its band, the wrench and whether there is contact, into the row, which has the measurement.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        time: Of the sample [s].
        a: The observer.
    """
    n, s, momentum, bias = a.numbers, a.state, a.vectors[0], a.vectors[1]
    period = time - s.clock[TIME]
    follows = s.clock[COUNT] > 0.0 and 0.0 < period < GAP * n.h
    s.clock[TIME] = time
    if not is_below(row[at[VELOCITY] : at[SHAPE + 1]], LARGEST):
        s.clock[COUNT], s.clock[TOUCHED] = 0.0, 0.0
        return
    if follows:
        push_on(period, a)
        s.clock[COUNT] += 1.0
        if int(s.clock[COUNT] - 1.0) % n.every != 0:
            return
    take_state(row, at, momentum, bias, a)
    if follows:
        update(momentum, bias, a)
        spread_doubt(row, at, a)
    else:
        begin(a)
    copy_to(momentum, s.momentum)
    copy_to(bias, s.bias)
    copy_to(a.nu, s.last)
    s.impulse[:] = 0.0
    judge(row, at, a)
    s.clock[ELAPSED] = 0.0
    find_wrench(row, at, a)


@internal
def begin(a: Feeler) -> None:
    """Nothing is felt, and nothing known of the noise."""
    s = a.state
    s.clock[COUNT], s.clock[WAIT] = 1.0, SETTLES / a.numbers.bandwidth
    for i in range(CLEAR, EASED + 1):
        s.clock[i] = 0.0
    s.load[:] = 0.0
    for k in range(LOAD):
        s.brings[k, :] = 0.0
    s.residual[:] = 0.0
    copy_to(s.beyond[0], s.beyond[1])
    for i in range(a.felt.size):
        s.noise[i, :] = 0.0
    for g in range(a.doubt.size):
        s.parts[g, :] = 0.0
        s.spared[g, :] = 0.0
        s.asked[g, :] = 0.0


@internal
def push_on(period: float, a: Feeler) -> None:
    """Add what the motors gave over the period that has just ended to the impulse."""
    n, s = a.numbers, a.state
    first = int(n.late)
    older, part = min(first + 1, len(s.held) - 1), n.late - first
    for i in range(s.impulse.size):
        asked = s.held[first, i] + part * (s.held[older, i] - s.held[first, i])
        gave = s.driven[i]
        s.driven[i] = a.motor[i] * gave + (1.0 - a.motor[i]) * asked
        s.impulse[i] += period * (asked - a.drag[i] * (s.driven[i] - gave))
    for j in range(len(s.held) - 1, 0, -1):
        copy_to(s.held[j - 1], s.held[j])
    s.clock[ELAPSED] += period


@internal
def take_state(row: Array, at: IntArray, momentum: Array, bias: Array, a: Feeler) -> None:
    """`M nu` and `C' nu - gravity - friction` of the measurement, which the observer keeps."""
    body, work, p = a.body, a.work, a.nu.size
    pose, velocity = view(row, at, POSE), view(row, at, VELOCITY)
    as_measured(body.offset, body.columns, pose, velocity, view(row, at, Q), view(row, at, QDOT), a.position, a.nu)
    put_shape(body.shape, view(row, at, SHAPE), a.position)
    evaluate(body, work, a.position, a.nu)
    one, none, column, weight = a.vectors[2], a.vectors[3], a.vectors[4], a.vectors[5]
    one[:], none[:] = 0.0, 0.0
    psi_again(body.tree, a.position, none, none, work.scratch, weight)
    for i in range(p):
        one[i] = 1.0
        psi_again(body.tree, a.position, one, none, work.scratch, column)  # C e_i + gravity
        one[i] = 0.0
        momentum[i] = entry(work.M, i, a.nu)
        a.state.weight[i] = weight[i] + work.F[i]
        bias[i] = -a.state.weight[i]
        for j in range(p):
            bias[i] += (column[j] - weight[j]) * a.nu[j]


@internal
def update(momentum: Array, bias: Array, a: Feeler) -> None:
    """The residual at the end of a period, implicit, and what it says of the noise."""
    n, s, p, step = a.numbers, a.state, a.nu.size, a.vectors[2]
    h = s.clock[ELAPSED]
    gain, share = n.bandwidth * h, h / AVERAGED
    for i in range(p):
        change = momentum[i] - s.momentum[i] - s.impulse[i] - 0.5 * h * (s.bias[i] + bias[i])
        new = a.felt[i] * (s.residual[i] + n.bandwidth * change) / (1.0 + gain)
        step[i] = new - s.residual[i]
        s.residual[i] = new
        s.beyond[1, i] = (s.beyond[1, i] + gain * s.beyond[0, i]) / (1.0 + gain)
    if s.clock[FELT] == 0.0 and s.clock[TOUCHED] == 0.0:
        for i in range(p):
            for j in range(p):
                s.noise[i, j] += share * (0.5 * step[i] * step[j] - s.noise[i, j])


@internal
def spread_doubt(row: Array, at: IntArray, a: Feeler) -> None:
    """Parts of r by the motion since the last measurement."""
    known, s, p, nudot = a.known, a.state, a.nu.size, a.vectors[2]
    h = s.clock[ELAPSED]
    gain = a.numbers.bandwidth * h
    pose, velocity, q, qdot = view(row, at, POSE), view(row, at, VELOCITY), view(row, at, Q), view(row, at, QDOT)
    for i in range(p):
        nudot[i] = (a.nu[i] - s.last[i]) / h
    measured(known, pose, velocity, q, qdot, view(row, at, SHAPE))
    regress(known, a.nu, nudot)
    for g in range(a.doubt.size):
        for i in range(p):
            s.parts[g, i] = (s.parts[g, i] + gain * part_of(g, i, a)) / (1.0 + gain)
            s.spared[g, i] = (s.spared[g, i] + gain * s.asked[g, i]) / (1.0 + gain)
    for k in range(LOAD if a.column >= 0 else 0):
        for i in range(p):
            s.brings[k, i] = (s.brings[k, i] - gain * known.Y[i, a.column + k]) / (1.0 + gain)


@compiled
def part_of(g: int, i: int, a: Feeler) -> float:
    """Torque on velocity i by group g of parameters, wrong by its standard deviation; Y is that of the motion."""
    part = 0.0
    for c in range(a.ends[g], a.ends[g + 1]):
        part += a.known.Y[i, c] * a.theta[c]
    return a.doubt[g] * part


@internal
def judge(row: Array, at: IntArray, a: Feeler) -> None:
    """External torque and band of the measurement, and whether there is contact."""
    n, s, S, p, raw = a.numbers, a.state, a.S, a.nu.size, a.vectors[6]
    external, band = view(row, at, EXTERNAL), view(row, at, BAND)
    weigh(raw, a)
    for i in range(p):
        for j in range(p):
            S[i, j] = (S[i, j] + s.noise[i, j]) * a.felt[i] * a.felt[j]
        motor = n.torque * s.driven[i]
        S[i, i] += motor * motor + a.floor[i] * a.floor[i]
    copy_to(raw, external)
    if s.load[0] > 0.0:
        if square_of(raw, a) > n.threshold:
            carry(external, a)
        else:
            s.load[:] = 0.0
    s.clock[WAIT] = max(0.0, s.clock[WAIT] - s.clock[ELAPSED])
    felt = square_of(external, a) > n.threshold and s.clock[WAIT] == 0.0
    follow_contact(felt, s, n.clear, n.settle)
    keep_standing(external, s, n.clear, n.settle)
    if s.clock[TOUCHED] > 0.0 and a.column >= 0:
        if s.clock[SINCE] * n.bandwidth > RISES:
            fit_load(raw, band, a)
        if s.clock[SINCE] > DECIDES and is_load(a):
            s.clock[TOUCHED] = s.clock[FELT] = s.clock[SINCE] = s.clock[WAITS] = 0.0
            copy_to(raw, external)
            carry(external, a)
            square_of(external, a)
    for i in range(p):
        band[i] = math.sqrt(S[i, i])
    row[at[CONTACT]], row[at[LOADED]] = s.clock[TOUCHED], s.load[0]


@compiled
def square_of(external: Array, a: Feeler) -> float:
    """`r' S^-1 r` (p,); the factor of S is left in a.L."""
    solve(a.S, external, a.L, a.vectors[2])
    return dot_of(external, a.vectors[2])


@compiled
def follow_contact(felt: bool, s: TouchState, clear: float, settle: float) -> None:
    """Contact begins with the sample that feels something, and ends when nothing has been felt for long enough."""
    h = s.clock[ELAPSED]
    s.clock[FELT] = 1.0 if felt else 0.0
    s.clock[CLEAR] = 0.0 if felt else s.clock[CLEAR] + h
    if s.clock[CLEAR] >= clear + settle:
        s.clock[WAITS] = 0.0
    if felt and s.clock[TOUCHED] == 0.0:
        s.clock[WAITS] = 1.0
        s.clock[TOUCHED], s.clock[SINCE], s.clock[BEGUN] = 1.0, 0.0, 1.0
        for k in range(LOAD + 1):
            s.fit[k, :] = 0.0
    elif not felt and s.clock[CLEAR] >= clear:
        s.clock[TOUCHED] = 0.0
    s.clock[SINCE] += h


@compiled
def keep_standing(external: Array, s: TouchState, clear: float, settle: float) -> None:
    """Average what a robot stands against while something is felt; after that its share falls, with half of settle."""
    h = s.clock[ELAPSED]
    if s.clock[FELT] > 0.0:
        if s.clock[SINCE] <= h:
            s.stood[:] = 0.0
        for i in range(external.size):
            s.stood[i] += min(1.0, h / max(clear, h)) * (external[i] - s.stood[i])
        s.clock[EASED] = 1.0
    else:
        s.clock[EASED] = s.clock[EASED] * exp(-2.0 * h / max(settle, h)) if s.clock[EASED] > GONE else 0.0


@compiled
def carry(external: Array, a: Feeler) -> None:
    """Take the load out of what is felt (p,); that is as sure as the load is."""
    part = a.vectors[3]
    for i in range(external.size):
        brought = 0.0
        for k in range(LOAD):
            brought += a.felt[i] * a.state.brings[k, i] * a.state.load[k]
        external[i] -= brought
        part[i] = UNSURE * brought
    add_square(part, a.S)


@internal
def fit_load(raw: Array, room: Array, a: Feeler) -> None:
    """Add a sample to what is known of a load, in the metric of the band; room (p,) is written."""
    s, columns = a.state, a.vectors
    keep, h = exp(-a.state.clock[ELAPSED] / FORGETS), a.state.clock[ELAPSED]
    for k in range(LOAD + 1):
        for i in range(raw.size):
            columns[k, i] = a.felt[i] * (s.brings[k, i] if k < LOAD else raw[i])
    for k in range(LOAD + 1):
        solve(a.S, columns[k], a.L, room)
        for m in range(LOAD + 1):
            s.fit[k, m] = keep * s.fit[k, m] + h * dot_of(columns[m], room)


@internal
def is_load(a: Feeler) -> bool:
    """Whether a mass that is carried explains what is felt; it is then the load."""
    fit, load, M, L, x = a.state.fit, a.state.load, a.G[0, :LOAD, :LOAD], a.G[1, :LOAD, :LOAD], a.wrench[0, :LOAD]
    for k in range(LOAD):
        for m in range(LOAD):
            M[k, m] = fit[k, m]
        M[k, k] += CERTAIN * (fit[0, 0] + fit[1, 1] + fit[2, 2] + fit[3, 3])
        x[k] = fit[k, LOAD]
    solve(M, x, L, a.wrench[1, :LOAD])
    found, left = a.wrench[1, :LOAD], fit[LOAD, LOAD]
    for k in range(LOAD):
        left -= found[k] * fit[k, LOAD]
    out = found[1] * found[1] + found[2] * found[2] + found[3] * found[3]
    fits, mass = left < MISFIT * fit[LOAD, LOAD], found[0]
    if not (fits and 0.0 < mass <= a.numbers.heaviest and out < REACH * REACH * mass * mass):
        return False
    copy_to(found, load)
    return True


@internal
def weigh(external: Array, a: Feeler) -> None:
    """The residual of the model that is asked for, and its covariance, into a.S."""
    s, S, p, share, model = a.state, a.S, a.nu.size, a.vectors[3], a.numbers.model
    known = s.learned[0, 0] >= 0.0
    share[:] = 0.0
    doubt_of_file(share, a)
    for i in range(p):
        share[i] = 1.0 if model == LEARNER else 0.0
        if model == BOTH and known and S[i, i] > 0.0:
            share[i] = S[i, i] / (S[i, i] + s.learned[i, i])
        s.weight[i] += share[i] * s.beyond[1, i]
        external[i] = a.felt[i] * (s.residual[i] + share[i] * s.beyond[1, i])
    if known:
        doubt_of_file(share, a)
        for i in range(p):
            for j in range(p):
                S[i, j] += share[i] * s.learned[i, j] * share[j]
    doubt_of_standing(a)


@internal
def doubt_of_file(share: Array, a: Feeler) -> None:
    """Covariance of r that errors of the file's numbers bring, (p, p), into a.S; a share (p,) of Psi is Psi_hat."""
    s, S, part = a.state, a.S, a.vectors[2]
    for i in range(part.size):
        S[i, :] = 0.0
    for g in range(a.doubt.size):
        for i in range(part.size):
            part[i] = s.parts[g, i] - share[i] * s.spared[g, i]
        add_square(part, S)


@internal
def doubt_of_standing(a: Feeler) -> None:
    """Add to a.S that friction of what stands is unknown, whatever Psi_hat says of friction at nu_ref."""
    known, S, p, part = a.known, a.S, a.nu.size, a.vectors[2]
    for k in range(a.dry.size):
        speed = entry(known.joints, k, a.nu)
        holds = a.dry[k] * (1.0 - abs(tanh(speed / known.coulomb_speed)))
        for i in range(p):
            part[i] = holds * known.joints[k, i]
        add_square(part, S)


@compiled
def add_square(part: Array, S: Array) -> None:
    """`S += part part'`."""
    for i in range(part.size):
        for j in range(part.size):
            S[i, j] += part[i] * part[j]


@compiled
def dot_of(a: Array, b: Array) -> float:
    """`a' b`."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


# -- the wrench --------------------------------------------------------------------------------------------------------


@internal
def find_wrench(row: Array, at: IntArray, a: Feeler) -> None:
    """The wrench of the hand and what of it is felt; `judge` has left the factor of S in a.L."""
    external, wrench, seen = view(row, at, EXTERNAL), view(row, at, WRENCH), view(row, at, SEEN)
    G, told = a.G[0], a.wrench[0]
    jacobian(a)
    for k in range(6):
        copy_to(a.J[k], a.X[k])
        substitute(a.L, a.X[k])
        told[k] = dot_of(a.X[k], external)
    for k in range(6):
        for m in range(6):
            G[k, m] = dot_of(a.X[k], a.J[m])
        size = FORCE if k < 3 else MOMENT
        G[k, k] += 1.0 / (size * size)
    solve(G, told, a.G[1], wrench)
    for k in range(6):
        size = FORCE if k < 3 else MOMENT
        for m in range(6):
            told[m] = 1.0 if m == k else 0.0
        substitute(a.G[1], told)
        seen[k] = 1.0 - told[k] / (size * size)


@internal
def jacobian(a: Feeler) -> None:
    """Jacobian of the hand in the world's axes, into a.J: what each of six unit wrenches is on nu."""
    scratch, b = a.work.scratch, a.carrier
    k = AT.rotation
    x, y, z = get(scratch, b, k), get(scratch, b, k + 3), get(scratch, b, k + 6)
    hand = (a.hand[0], a.hand[1], a.hand[2])
    lever = (dot(x, hand), dot(y, hand), dot(z, hand)) if b > BASE.w else hand
    c, s = 1.0, 0.0
    if a.moving:
        c, s = cos_sin(a.position[2] - a.body.tree.frame[2])
    for m in range(3):
        axis = (c, -s, 0.0) if m == 0 else ((s, c, 0.0) if m == 1 else (0.0, 0.0, 1.0))
        pull(b, axis, cross(lever, axis), a, a.J[m])
        pull(b, ZERO, axis, a, a.J[3 + m])
    for m in range(6):
        for i in range(a.felt.size):
            a.J[m, i] *= a.felt[i]


@internal
def pull(b: int, force: Triple, moment: Triple, a: Feeler, out: Array) -> None:
    """The torques on nu, (p,), of a force and a moment about the origin of body b."""
    links, scratch, i, there = a.body.tree.links, a.work.scratch, b, add(moment, ZERO)
    out[:] = 0.0
    while i > BASE.w:
        feel_at(i, force, there, a, out)
        there = add(there, cross(get(scratch, i, AT.lever), force))
        i = int(links[i, LINK.parent])
    for i in range(BASE.w + 1):
        feel_at(i, force, there, a, out)


@internal
def feel_at(i: int, force: Triple, moment: Triple, a: Feeler, out: Array) -> None:
    """Add what joint i takes of a force and a moment about its origin, through its row of T."""
    links, scratch = a.body.tree.links, a.work.scratch
    value = dot(get(scratch, i, AT.w), moment) + dot(get(scratch, i, AT.s), force)
    first = links[i, LINK.first]
    for k in range(links[i, LINK.stop] - first):
        out[first + k] += scratch[i, AT.weight + k] * value


# -- after the torque --------------------------------------------------------------------------------------------------


@linked
def remember(row: Array, at: IntArray, psi_hat: Array, learned: bool, a: Feeler) -> None:
    """Keep the torque that is held from this sample on, and by how much Psi_hat differs from the Psi of the file.

    Args:
        row: (width,) row of signals with the torque that was sent.
        at: Offsets of the signals.
        psi_hat: (p,) as it was before motors limited it.
        learned: Whether the controller was asked for one.
        a: The observer.
    """
    s, tau, told = a.state, view(row, at, TORQUE), a.vectors[2]
    within = True
    copy_to(tau, s.held[0])
    for j in range(a.most.size):
        within = within and abs(entry(a.E_inv, j, tau)) <= a.most[j]
    if not within:
        s.held[0, :] = 0.0
        for j in range(a.most.size):
            u = min(max(entry(a.E_inv, j, tau), -a.most[j]), a.most[j])
            for i in range(tau.size):
                s.held[0, i] += a.E[i, j] * u
    if learned and a.numbers.model != URDF and s.clock[COUNT] > 0.0:
        psi_of(a.body, a.work, a.position, view(row, at, NU_REF), view(row, at, NUDOT_REF), told)
        for i in range(tau.size):
            s.beyond[0, i] = psi_hat[i] - told[i]
        measured(
            a.known, view(row, at, POSE), view(row, at, VELOCITY), view(row, at, Q), view(row, at, QDOT),
            view(row, at, SHAPE),
        )  # fmt: skip
        regress(a.known, view(row, at, NU_REF), view(row, at, NUDOT_REF))
        for g in range(a.doubt.size):
            for i in range(tau.size):
                s.asked[g, i] = part_of(g, i, a)


@linked
def give_way(row: Array, at: IntArray, a: Feeler) -> None:
    """In contact a torque that gives way takes the place of the controller's, and then one that goes back slowly.

    In contact the model carries the robot and a share of the feedback damps it, `tau = weight - yields K nu`, which
    grows to all of it while nothing is felt any more. After it the robot follows nu_ref, which leads it back to its
    reference, no faster than `back`, to which a wish w grows at a steady rate, `tau = weight + M w' + K (w - nu)`: base
    and arm go as they are asked, whatever the inertia that couples them. Where nu_ref is slower the controller goes on.
    The law of a pose on two wheels turns no base that stands, so that is turned back first.

    A robot that does not give way stands against the world by its feedback, which throws it where the world lets go:
    `tau += share (stood - r)` takes the place of what pushed and is no more, and fades.

    Args:
        row: (width,) row of signals with the controller's torque.
        at: Offsets of the signals.
        a: The observer.
    """
    n, s, tau, nu_ref = a.numbers, a.state, view(row, at, TORQUE), view(row, at, NU_REF)
    if n.gives == 0:
        share = s.clock[EASED] if n.eases > 0 and s.clock[FELT] == 0.0 else 0.0
        for i in range(tau.size if share > 0.0 else 0):
            tau[i] += a.felt[i] * share * (s.stood[i] - row[at[EXTERNAL] + i])
        return
    touched, turn = s.clock[TOUCHED] > 0.0, turning_back(row, at, a)
    slow = abs(turn) <= ALIGNED
    for i in range(tau.size):
        slow = slow and abs(nu_ref[i]) <= n.back
    s.clock[GIVES] = 1.0 if touched or (s.clock[GIVES] > 0.0 and not slow) else 0.0
    if s.clock[GIVES] == 0.0:
        return
    clear, change = max(n.clear, n.h), a.vectors[3]
    damps = n.yields + (1.0 - n.yields) * min(1.0, s.clock[CLEAR] / clear) if touched else 1.0
    step = GROWS * n.back / clear * n.h
    for i in range(tau.size):
        wish = min(max(nu_ref[i] + (turn if i == 1 else 0.0), -n.back), n.back)
        change[i] = 0.0 if touched else min(max(wish - s.wished[i], -step), step)
        s.wished[i] = 0.0 if touched else s.wished[i] + change[i]
    for i in range(tau.size):
        if a.felt[i] > 0.0:
            tau[i] = s.weight[i] + damps * a.gains[i] * (s.wished[i] - a.nu[i]) + entry(a.work.M, i, change) / n.h


@internal
def turning_back(row: Array, at: IntArray, a: Feeler) -> float:
    """How fast a base on two wheels is to turn to its reference where that stands [rad/s]; 0 of any other."""
    velocity_ref, error = view(row, at, VELOCITY_REF), view(row, at, POSE_ERROR)
    if velocity_ref.size != 2 or a.body.shape.size > 0 or velocity_ref[0] != 0.0 or velocity_ref[1] != 0.0:
        return 0.0
    return TURNS * error[2]
