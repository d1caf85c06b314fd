"""One sample of a compliant hand.

`wish` comes between the kinematic layer and the torque law. It bends the velocity that is asked for so that the hand's
is that of its setpoint, base and arm sharing the difference by the weights W:

    nu_ref := nu_ref + J# (x_d' - J nu_ref),    J# = W J' (J W J')^-1,    N = I - J# J,    s = nu_ref - nu

What the kinematic layer asks of posture and base thus remains where it does not move the hand. nudot_ref is the rate of
that, J# included, over a `MOMENT` of the motion. J has T(theta) in it where the base steers. Torques are

    tau = Psi_hat + J' F + P' K P s,    F = K_x x~ + D (x_d' - J nu) + n f,    P = I - M^-1 J' (J M^-1 J')^-1 J

`give` puts the latter two in place of `K s`. The projection P is that of the inertias, so that what K does beside the
hand is no faster than it is alone. With the true Psi, `M s' + C s + P' K P s + J' F = -tau_ext`, and for a setpoint at
rest and forces at the hand `J s = -v` and

    V = s' M s / 2 + U(x~),    dV/dt = -s' P' K P s - v' D v + v' f_ext

as M' - 2 C is skew: the Coriolis terms of the reduced system belong to Psi. The posture, which is an aim for P s and no
spring, takes nothing from the hand. At rest s = 0, F = -f_ext: the hand has exactly its stiffness. V is the signal
`storage`; `injected` is what it gained beyond the work of the world on the hand: what controller and setpoint put in.

Where joints of the arm take no torque the hand is an admittance. What is felt moves a mass, `m x_c'' = F(x_c) + f`, and
the hand follows `x_d + x_c` as any reference.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ..by_address import by_address
from ..compiled import compiled, copy_to, entry, internal, linked
from ..model.chain import move
from ..model.reduction import as_measured, position_rate, put_shape, quadratic, solve, substitute
from ..model.tip import Tip, move_tip
from ..model.tree.body import Body, Work, evaluate
from ..parts import view
from ..signals import INDEX, Array, IntArray

TIME, POSE_REF, VELOCITY_REF, ACCELERATION_REF = (
    INDEX[n] for n in ("time", "pose_ref", "velocity_ref", "acceleration_ref")
)
Q_REF, QDOT_REF, QDDOT_REF = INDEX["q_ref"], INDEX["qdot_ref"], INDEX["qddot_ref"]
POSE, VELOCITY, Q, QDOT, SHAPE = (INDEX[n] for n in ("pose", "velocity", "q", "qdot", "shape"))
ALPHA, ALPHADOT, Z, R, NU_REF, NUDOT_REF = (INDEX[n] for n in ("alpha", "alphadot", "z", "r", "nu_ref", "nudot_ref"))
TORQUE, EFFECTIVE_GAIN = INDEX["torque"], INDEX["effective_gain"]
ASKED_FORCE, STORAGE, INJECTED = INDEX["asked_force"], INDEX["storage"], INDEX["injected"]

CREEPING = 0.01  # speed from which on a direction turns to the hand's motion, below it to the wrench [m/s]
LEAST = 0.1  # share of the largest pull below which a wrench turns it more slowly
PULL, RAMP = 200.0, 400.0  # of a followed speed: force per error [N s/m], and per error and second [N/m]
FOLLOWS = 8.0  # how fast the hand follows its admittance [1/s]
CARRIES = 4.0  # how fast a hand takes on what its springs carry before a force begins [1/s]
MOMENT = 1e-4  # over which the rate of what is asked for is taken [s]
# Numbers of a force, and what a compliance remembers.
NEWTONS, START, RISE, GAIN, FOLLOW, SPEED, FAR, TURNING, FORCE = 0, 1, 2, 3, 4, 5, 6, 7, 8
INTEGRAL, GONE, DIRECTION, MOVED, MOVING, BEGUN, AT_FIRST, CARRIED, FREE, ACROSS = 0, 1, 2, 5, 11, 17, 18, 19, 22, 25
STATE = 28


class HandScratch(NamedTuple):
    """Room to work in: of the setpoint, of the measurement, and a moment after that.

    Attributes:
        place, twist, bias: (3, 12), (3, 6), (3, 6) of the hand; the setpoint's bias is its acceleration.
        position, rate: (nv,).
        led: (m,) twist and arm rates of the setpoint.
        nu, nudot: (p,).
        J: (2, 6, p) of the measurement, and a moment later.
        A: (2, rows, rows) `J W J'` and its factor, then `J M^-1 J'` and its factor.
        X: (rows, p) `J M^-1`.
        L: (p, p) factor of M.
        b: (5, 6) asked velocity, displacement, asked acceleration, F, and one more.
        s: (2, p) s, and what is asked a moment later.
    """

    place: Array
    twist: Array
    bias: Array
    position: Array
    rate: Array
    led: Array
    nu: Array
    nudot: Array
    J: Array
    A: Array
    X: Array
    L: Array
    b: Array
    s: Array


@by_address
class Compliance(NamedTuple):
    """A compliant hand of one robot.

    Attributes:
        tip: The hand.
        offset, columns: Of `Robot.arm_map`.
        rows: Of the task: 3, or 6 where the orientation has a stiffness.
        by_hand: 1 where axes are those of the hand, else 0.
        springs: (6,) stiffness [N/m, N m/rad].
        dampers: (6,) [N s/m, N m s].
        limit: Largest force of a spring [N].
        station: How much of the kinematic layer's gains the base keeps.
        weights: (p,) W.
        still: (p,) K.
        most: Largest stiffness that delay and period bear [N/m].
        force: (FORCE,) numbers of a force.
        mass: (6,) of an admittance [kg, kg m^2]; (0,) of an impedance.
        felt: Place of the signal `external_wrench` in a row, -1 without it; `wrench_seen` is the next.
        h: Control period [s].
        body, inertia: The robot that is believed in, and room to evaluate it, for M.
        torque: (p,) `J' F + P' K P s`, written.
        state: Integral of the force, way gone, direction (3,), x_c (6,), its rate (6,), 1 once V is known, and V then,
            force that is carried (3,), what is felt of a free hand (3,), and what is added across a pull (3,).
        work: HandScratch.
    """

    tip: Tip
    offset: Array
    columns: Array
    rows: int
    by_hand: float
    springs: Array
    dampers: Array
    limit: float
    station: float
    weights: Array
    still: Array
    most: float
    force: Array
    mass: Array
    felt: int
    h: float
    body: Body
    inertia: Work
    torque: Array
    state: Array
    work: HandScratch


@linked
def wish(row: Array, at: IntArray, c: Compliance) -> None:
    """Bend the velocity that is asked for, in the row, and find the torque of the hand, `c.torque`."""
    w = c.work
    see(row, at, c)
    asked, error, rate, b, s, later = w.b[0], w.b[1], w.b[2], w.b[4], w.s[0], w.s[1]
    copy_to(w.twist[0], asked)
    copy_to(w.bias[0], rate)
    displacement(w.place[0], w.place[1], error)
    leave_to_force(row[at[TIME]], c)
    stored = admit(row, row[at[TIME]], c) if c.mass.size else 0.0
    for i in range(s.size):
        s[i] = row[at[NU_REF] + i]
        later[i] = s[i] + MOMENT * row[at[NUDOT_REF] + i]
    share(asked, w.J[0], s, c, b)
    for i in range(6):
        asked[i] += MOMENT * rate[i]
    share(asked, w.J[1], later, c, b)
    for i in range(6):
        asked[i] -= MOMENT * rate[i]
    nb = at[Z + 1] - at[Z]
    for i in range(s.size):
        row[at[NU_REF] + i], row[at[NUDOT_REF] + i] = s[i], (later[i] - s[i]) / MOMENT
        if i < nb:
            row[at[ALPHA] + i], row[at[ALPHADOT] + i] = s[i], row[at[NUDOT_REF] + i]
        s[i] -= w.nu[i]
    copy_to(s, later)
    if pushes(row[at[TIME]], c):
        spare(later, c)
    for i in range(s.size):
        row[at[Z] + i if i < nb else at[R] + i - nb] = later[i]
    if not c.mass.size:
        stored = hand_torque(row, row[at[TIME]], c) + 0.5 * quadratic(c.inertia.M, s)
    if c.state[BEGUN] == 0.0:
        c.state[BEGUN], c.state[AT_FIRST] = 1.0, stored
    row[at[STORAGE]], row[at[INJECTED]] = stored, stored - c.state[AT_FIRST]
    for i in range(3):
        row[at[ASKED_FORCE] + i] = w.b[3, i]


@compiled
def see(row: Array, at: IntArray, c: Compliance) -> None:
    """Where the hand is and how it moves: of the setpoint, as measured, and a moment later as it moves now."""
    w, tip, twist = c.work, c.tip, at[VELOCITY_REF + 1] - at[VELOCITY_REF]
    pose_ref, v, a = view(row, at, POSE_REF), view(row, at, VELOCITY_REF), view(row, at, ACCELERATION_REF)
    q_ref, qdot_ref, qddot_ref = view(row, at, Q_REF), view(row, at, QDOT_REF), view(row, at, QDDOT_REF)
    as_measured(c.offset, c.columns, pose_ref, v, q_ref, qdot_ref, w.position, w.led)
    move(tip.chain, w.position, w.led, w.place[0], w.twist[0], w.bias[0], tip.J)
    for i in range(6):
        for j in range(w.led.size):
            w.bias[0, i] += tip.J[i, j] * (a[j] if j < twist else qddot_ref[j - twist])
    pose, velocity, q, qdot = view(row, at, POSE), view(row, at, VELOCITY), view(row, at, Q), view(row, at, QDOT)
    as_measured(c.offset, c.columns, pose, velocity, q, qdot, w.position, w.nu)
    put_shape(c.body.shape, view(row, at, SHAPE), w.position)
    evaluate(c.body, c.inertia, w.position, w.nu)
    move_tip(tip, w.position, w.nu, w.place[1], w.twist[1], w.bias[1], w.J[0])
    position_rate(w.position, w.nu, c.inertia.v, c.body.base, c.body.sideways, c.inertia.maps.eta, w.rate)
    for i in range(w.rate.size):
        w.position[i] += MOMENT * w.rate[i]
    move_tip(tip, w.position, w.nu, w.place[2], w.twist[2], w.bias[2], w.J[1])


@compiled
def displacement(wanted: Array, place: Array, error: Array) -> None:
    """From a placement (12,) to the wanted one: position, and the vector part of the quaternion of `R_d R'`, (6,).

    The scalar part, which is not negative, follows from it.
    """
    for i in range(3):
        error[i] = wanted[9 + i] - place[9 + i]
    trace = 0.0
    for i in range(9):
        trace += wanted[i] * place[i]
    eta = 0.5 * math.sqrt(max(1.0 + trace, 1e-12))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        error[3 + i] = 0.0
        for m in range(3):  # (R_e)_kj - (R_e)_jk
            error[3 + i] += wanted[3 * k + m] * place[3 * j + m] - wanted[3 * j + m] * place[3 * k + m]
        error[3 + i] /= 4.0 * eta


@compiled
def pushes(time: float, c: Compliance) -> bool:
    """Whether the hand pushes with a force by now."""
    return c.force[NEWTONS] > 0.0 and time >= c.force[START]


@compiled
def spare(s: Array, c: Compliance) -> None:
    """Take out of the error s (p,) how fast the hand goes where its force decides: nobody is to learn to stop it."""
    w, u, along = c.work, c.state[DIRECTION : DIRECTION + 3], 0.0
    goes = w.b[2]
    for i in range(c.rows):
        goes[i] = entry(w.J[0], i, s)
        along += u[i] * goes[i] if i < 3 else 0.0
    for i in range(3):
        goes[i] = 0.0 if c.force[FOLLOW] > 0.0 else goes[i] - along * u[i]
    share(goes, w.J[0], s, c, w.b[4])


@compiled
def carry(row: Array, time: float, c: Compliance, F: Array) -> None:
    """Add what the springs carried before a force begins, and nothing touched the hand: by that the model is wrong."""
    carried, free = c.state[CARRIED : CARRIED + 3], c.state[FREE : FREE + 3]
    for i in range(3):
        if time < c.force[START]:
            carried[i] = min(c.limit, max(-c.limit, carried[i] + c.h * CARRIES * F[i]))
            free[i] += c.h * CARRIES * (row[c.felt + i] - free[i]) if c.felt >= 0 else 0.0
        F[i] += carried[i]


@compiled
def leave_to_force(time: float, c: Compliance) -> None:
    """Ask nothing along the direction of a force, which decides there, or nothing at all of a hand that follows."""
    if not pushes(time, c):
        return
    for k in range(3):
        x, along = c.work.b[k], 0.0
        for i in range(3):
            along += c.state[DIRECTION + i] * x[i]
        for i in range(3):
            x[i] = 0.0 if c.force[FOLLOW] > 0.0 else x[i] - along * c.state[DIRECTION + i]


@compiled
def share(twist: Array, J: Array, nu: Array, c: Compliance, b: Array) -> None:
    """`nu += W J' (J W J')^-1 (twist - J nu)` in the task's rows, regularized where the hand cannot move."""
    A, total, m = c.work.A[0], 0.0, c.rows
    for i in range(m):
        b[i] = twist[i]
        for j in range(nu.size):
            b[i] -= J[i, j] * nu[j]
        for k in range(m):
            A[i, k] = 0.0
            for j in range(nu.size):
                A[i, k] += J[i, j] * c.weights[j] * J[k, j]
        total += A[i, i]
    for i in range(m):
        A[i, i] += 1e-6 * total
    solve(A, b[:m], c.work.A[1], b[:m])
    for j in range(nu.size):
        for i in range(m):
            nu[j] += c.weights[j] * J[i, j] * b[i]


@compiled
def factor_inertia(c: Compliance) -> None:
    """`X = J M^-1` and `J M^-1 J'`, regularized likewise."""
    w, A, J, total = c.work, c.work.A[0], c.work.J[0], 0.0
    for i in range(c.rows):
        if i == 0:
            solve(c.inertia.M, J[0], w.L, w.X[0])
        else:
            copy_to(J[i], w.X[i])
            substitute(w.L, w.X[i])
    for i in range(c.rows):
        for k in range(c.rows):
            A[i, k] = 0.0
            for j in range(J.shape[1]):
                A[i, k] += J[i, j] * w.X[k, j]
        total += A[i, i]
    for i in range(c.rows):
        A[i, i] += 1e-6 * total


@compiled
def take_out(rows: Array, back: Array, x: Array, c: Compliance, b: Array) -> None:
    """`x -= back' (J M^-1 J')^-1 rows x` for the task's rows of J and X, (p,) in place; b (6,) is scratch."""
    w = c.work
    for i in range(c.rows):
        b[i] = 0.0
        for j in range(x.size):
            b[i] += rows[i, j] * x[j]
    solve(w.A[0], b[: c.rows], w.A[1], b[: c.rows])
    for j in range(x.size):
        for i in range(c.rows):
            x[j] -= back[i, j] * b[i]


@compiled
def hand_torque(row: Array, time: float, c: Compliance) -> float:
    """`J' F + P' K P s` into `c.torque`; returns the energy of the springs [J]. `work.s[0]` is s."""
    w, torque = c.work, c.torque
    F, b, error = w.b[3], w.b[4], w.b[1]
    for i in range(6):
        b[i] = w.b[0, i] - w.twist[1, i]
    stored = springs_and_dampers(b, error, c, F)
    carry(row, time, c, F)
    push(row, time, w.twist[1], c, F)
    factor_inertia(c)
    copy_to(w.s[0], torque)
    take_out(w.J[0], w.X, torque, c, b)  # P s
    for j in range(torque.size):
        torque[j] *= c.still[j]
    take_out(w.X, w.J[0], torque, c, b)  # P' K P s
    for j in range(torque.size):
        for i in range(6):
            torque[j] += w.J[0, i, j] * F[i]
    return stored


@compiled
def springs_and_dampers(rate: Array, error: Array, c: Compliance, F: Array) -> float:
    """Their wrench F (6,) in the world at a displacement (6,) that changes at a rate (6,); their energy [J]."""
    w, stored = c.work, 0.0
    place, eta = w.place[0], math.sqrt(max(0.0, 1.0 - error[3] * error[3] - error[4] * error[4] - error[5] * error[5]))
    F[:] = 0.0
    for half in (0, 3):
        for i in range(3):  # axis i
            x, v = 0.0, 0.0
            for k in range(3):
                axis = place[3 * k + i] if c.by_hand > 0.0 else (1.0 if i == k else 0.0)
                x += axis * error[half + k]
                v += axis * rate[half + k]
            stiffness, damper = c.springs[half + i], c.dampers[half + i]
            if half == 3 and c.rows == 3:
                damper = 0.0
            f = stiffness * x
            if half == 0:
                held = min(c.limit, max(-c.limit, f))
                stored += held * x - 0.5 * held * held / stiffness if stiffness > 0.0 else 0.0
                f = held
            else:
                stored += 2.0 * f * x
            for k in range(3):
                axis = place[3 * k + i] if c.by_hand > 0.0 else (1.0 if i == k else 0.0)
                if half == 0:
                    F[k] += axis * (f + damper * v)
                else:
                    m, n = (k + 1) % 3, (k + 2) % 3
                    am = place[3 * m + i] if c.by_hand > 0.0 else (1.0 if i == m else 0.0)
                    an = place[3 * n + i] if c.by_hand > 0.0 else (1.0 if i == n else 0.0)
                    F[3 + k] += 2.0 * f * (eta * axis + am * error[3 + n] - an * error[3 + m]) + axis * damper * v
    return stored


@compiled
def push(row: Array, time: float, v: Array, c: Compliance, F: Array) -> None:
    """Add the force along the direction; v (6,) is the hand's velocity. By what is felt it is made true."""
    force, state, felt = c.force, c.state, c.work.b[4]
    if not pushes(time, c):
        return
    u, back = state[DIRECTION : DIRECTION + 3], 0.0
    share = min(1.0, (time - force[START]) / force[RISE]) if force[RISE] > 0.0 else 1.0
    for i in range(3):
        felt[i] = row[c.felt + i] - state[FREE + i] if c.felt >= 0 else 0.0
        back -= u[i] * felt[i]
    if force[FOLLOW] > 0.0:
        follow(share, back, v, c, F)
        return
    wanted = force[NEWTONS] * share
    if force[GAIN] > 0.0 and c.felt >= 0 and wanted > 0.0:
        missing = -back
        for i in range(3):
            missing += u[i] * u[i] * row[c.felt + 6 + i] * wanted
        touches = min(1.0, max(0.0, back / wanted)) if missing > 0.0 else 1.0
        grown = state[INTEGRAL] + c.h * force[GAIN] * touches * missing
        state[INTEGRAL] = min(force[NEWTONS], max(-force[NEWTONS], grown))
    for i in range(3):
        F[i] += (wanted + state[INTEGRAL]) * u[i]


@internal
def follow(share: float, back: float, v: Array, c: Compliance, F: Array) -> None:
    """Pull at a speed along the direction, turn that to where the hand can move, and give way across it.

    A way t that permits no other motion answers a pull f u by `-f (u - t t' u)`, of which the part across u,
    `f (t' u) (t - u u' t)`, points to the way. So a hand that hardly moves turns u by the wrench that is felt, one that
    moves by its velocity, and what is then felt across is the model's error: its integral is added to the pull.

    Args:
        share: Of the speed.
        back: Of the wrench that is felt, in `work.b[4]`, against the direction [N].
        v: (6,) twist of the hand.
        c: The compliance.
        F: (6,) its wrench.
    """
    force, state, felt = c.force, c.state, c.work.b[4]
    u, across = state[DIRECTION : DIRECTION + 3], state[ACROSS : ACROSS + 3]
    along, speed, stays, size = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        felt[i] += back * u[i]
        along += u[i] * v[i]
        speed += v[i] * v[i]
    moves = min(1.0, math.sqrt(speed) / CREEPING)
    if along > 0.0:
        turn_to(v, c.h * force[TURNING] * moves, u)
    if force[GAIN] > 0.0 and back > 0.0:
        for i in range(3):
            felt[i + 3] = u[i] + felt[i] / max(back, LEAST * force[NEWTONS])
        turn_to(felt[3:], c.h * force[TURNING] * (1.0 - moves), u)
    for i in range(3):
        across[i] += c.h * force[GAIN] * felt[i]
        stays += u[i] * across[i]
    for i in range(3):
        across[i] -= stays * u[i]
        size += across[i] * across[i]
    size = force[NEWTONS] / max(force[NEWTONS], math.sqrt(size))
    state[GONE] += c.h * along
    missing = (force[SPEED] * share if state[GONE] < force[FAR] else 0.0) - along
    state[INTEGRAL] = min(force[NEWTONS], max(0.0, state[INTEGRAL] + c.h * RAMP * missing))
    value = min(force[NEWTONS], max(-force[NEWTONS], PULL * missing + state[INTEGRAL]))
    for i in range(3):
        across[i] *= size
        F[i] += value * u[i] + across[i]


@compiled
def turn_to(v: Array, share: float, u: Array) -> None:
    """Turn a direction u (3,) by a share of the way to that of v (6,)."""
    length = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if length <= 0.0:
        return
    total, part = 0.0, min(1.0, share)
    for i in range(3):
        u[i] += part * (v[i] / length - u[i])
        total += u[i] * u[i]
    for i in range(3):
        u[i] /= math.sqrt(total)


@compiled
def admit(row: Array, time: float, c: Compliance) -> float:
    """Move the mass of an admittance by what is felt, and ask the hand to follow it; its energy [J]."""
    w, x, v = c.work, c.state[MOVED : MOVED + 6], c.state[MOVING : MOVING + 6]
    asked, error, rate, F, b = w.b[0], w.b[1], w.b[2], w.b[3], w.b[4]
    for i in range(6):
        b[i] = -v[i]
        asked[i] += v[i]
        error[i] += x[i] if i < 3 else 0.5 * x[i]
    for i in range(c.rows):
        asked[i] += FOLLOWS * error[i] * (1.0 if i < 3 else 2.0)
    copy_to(x, w.b[1])
    for i in range(3):
        w.b[1, i], w.b[1, 3 + i] = -x[i], -0.5 * x[3 + i]
    stored = springs_and_dampers(b, w.b[1], c, F)
    push(row, time, v, c, F)
    for i in range(c.rows):
        felt = row[c.felt + i] if c.felt >= 0 else 0.0
        acceleration = (F[i] + felt) / c.mass[i]
        rate[i] += acceleration
        v[i] += c.h * acceleration
        x[i] += c.h * v[i]
        stored += 0.5 * c.mass[i] * v[i] * v[i]
    return stored


@linked
def give(row: Array, at: IntArray, c: Compliance) -> None:
    """The torque of an impedance in place of the feedback's."""
    nb = at[Z + 1] - at[Z]
    for i in range(0 if c.mass.size else c.torque.size):
        s = row[at[Z] + i] if i < nb else row[at[R] + i - nb]
        row[at[TORQUE] + i] += c.torque[i] - row[at[EFFECTIVE_GAIN] + i] * s
