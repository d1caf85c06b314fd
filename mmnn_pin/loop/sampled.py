"""The sampled loop before a run: is it stable, and how much delay does it bear?

The loop is linearised about the reference, with the torque held over a control period h: deviations
`d = [ex, ey, ephi; e; nu; tau of lagging motors]` obey `d_next = Phi d + Gamma tau`, `tau = F d`, and `Phi + Gamma F`
must have no eigenvalue beyond the unit circle. F is the feedback `k s`; a controller that adds `M nudot_ref` has also
the feedback inside it, `M [alphadot; K edot]`, which is judged beside. Where velocities are made of encoders
(`VelocityFilter`), the memory of the filter or the observer is part of d, and F sees its rates in place of nu.

**Delay margin.** With a delay L between measurement and torque the loop turns unstable where
`exp(-j w L) lambda = 1` for an eigenvalue lambda of `H(w) = F (exp(j w h) - Phi)^-1 Gamma`: at a frequency where
`|lambda| = 1` that needs `L = arg(lambda) / w`. The smallest one is the margin, of all velocities coupled and delayed
alike (a delay that is no whole number of periods counts as a phase, as between samples).

**Gravity.** Its slope along the arm is a spring, mostly of a negative stiffness where an arm stands up. A torque at the
measured joints cancels it, as late as all torques are; what is left of it pushes as a negative damping does. Under a
PID, whose integral carries the weight by errors, it is not counted.

**Where it is judged.** Along the reference. An arm under PD sags below it, and is judged where it comes to rest, too:
at the nearest minimum of `1/2 (q_ref - q)' k K (q_ref - q) + U(q)`, with the stiffness of U. The worst counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy  # its parts are slow to import, and come when they are used

from ..compiled import one_thread
from ..model.base.base import LinearErrors
from ..model.dynamics import Dynamics
from ..model.structure import Structure
from ..signals import Array, IntArray, Setpoint
from ..torque.classical import Gravity, Integrator
from ..torque.controller import CompiledController
from ..torque.learning_law import LearningLaw
from ..torque.model_based import PD, ScheduledPD
from .before_run import Start, lags, viscous_friction
from .plan import Plan
from .servo_model import LinearServos
from .sight import VelocityFilter

TOLERANCE = 1e-9
TINY = 1e-5  # deviation by which a slope is taken, and by which what stands upright begins to fall [rad or m]
WITHOUT_RATES = (Gravity, Integrator)  # their Psi_hat does not answer to nudot_ref, and the errors in it
LARGEST = 700.0  # exponents up to here have an exponential
FREQUENCIES, SLOWEST = 160, 0.05  # of the sweep, from this one on [rad/s]


class Machinery(NamedTuple):
    """The parts between torque and motion, and between motion and measurement; none by default."""

    friction: Array | None = None  # viscous friction on nu, (p,) or a matrix (p, p)
    lag: Array | None = None  # (p,) time constants of first-order motors [s]
    servos: LinearServos | None = None  # of servo rows, whose gains are 0
    sight: VelocityFilter | None = None  # how velocities are measured, None for exactly


NOTHING = Machinery()


@dataclass(frozen=True)
class SampledLoop:
    """Verdict on the sampled PD loop."""

    # spectral radius of one control period; up to 1 is stable (exactly 1: something is not stabilised, such as the
    # lateral error at vr = 0)
    radius: float
    # (p,) gain on each velocity alone at which `nu_next = (Phi_ii - Gamma_ii k) nu` reaches -1, where without friction
    # `Phi_ii = 1` and `Gamma_ii = h (M^-1)_ii`
    gain_limits: Array

    @property
    def stable(self) -> bool:
        """Whether no deviation grows."""
        return self.radius <= 1.0 + TOLERANCE


def sampled_loop(
    M: Array, gains: Array, law: LinearErrors, K: Array, h: float, machinery: Machinery = NOTHING
) -> SampledLoop:
    """Spectral radius of the held PD loop at one mass matrix and law of the base.

    Args:
        M: (p, p) reduced mass matrix.
        gains: (p,) gain on `[z; r]`.
        law: The pose error under the law of the base, at a reference velocity.
        K: (n,) gain of the filtered arm error [1/s].
        h: Control period [s].
        machinery: What else is in the loop.
    """
    held, servos = held_loop(M, law, K, h, machinery), machinery.servos
    if held is None:
        return SampledLoop(np.inf, 2.0 / (h * np.diag(np.linalg.inv(M))))
    radius = float(np.abs(np.linalg.eigvals(held.closed(gains))).max())
    first = len(law.rates) + len(K)
    nu = slice(first, first + len(M))
    limits = (1.0 + np.diag(held.state)[nu]) / np.diag(held.torque[nu])
    return SampledLoop(radius, limits if servos is None else np.where(servos.on > 0.0, np.inf, limits))


@dataclass(frozen=True, eq=False)
class HeldLoop:
    """One control period of the linearised loop: `d_next = state d + torque tau`, and `s = errors d`."""

    state: Array  # (k, k)
    # (k, m): what is sent, held over the period, does: of every velocity a torque, on servo rows a velocity that is
    # asked for, and after these the torques that act through servos
    torque: Array
    rows: IntArray  # (m,) velocities that it is sent for
    errors: Array  # (m, k): `[z; r]` of a deviation, 0 where a velocity is asked for
    inside: Array  # (m, k): `M nudot_ref` of a deviation, the feedback inside Psi, likewise
    rates: Array  # (m, k): `nudot_ref` of a deviation, likewise
    # (m, k): what is sent in a deviation whatever the gains: velocities that servo rows are asked for, on the others a
    # torque that carries the weight
    asked: Array
    # by period, `(z - state)^-1 torque` at the frequencies of a sweep, which no gain changes
    responses: dict[float, Array] = field(default_factory=dict)

    def closed(self, gains: Array) -> Array:
        """(k, k) with the torque `gains s`, gains (p,)."""
        return self.state + self.torque @ self.feedback(gains, False)

    def feedback(self, gains: Array, inside: bool) -> Array:
        """(m, k) torque of a deviation: `gains s`, and `M nudot_ref` where it is added; on servo rows what is asked."""
        return gains[self.rows, None] * self.errors + self.asked + (self.inside if inside else 0.0)

    def radius(self, gains: Array, inside: bool, adds: Array | None = None) -> float:
        """Spectral radius of one period; `adds` (p,) is what a period adds over s to an integral beside, None for none.

        An integral acts one period later: `I_next = I + adds s`.
        """
        closed = self.state + self.torque @ self.feedback(gains, inside)
        if adds is not None:
            own = adds[self.rows, None] * self.errors
            closed = np.block([[closed, self.torque], [own, np.eye(len(own))]])
        return float(np.abs(np.linalg.eigvals(closed)).max())

    def response(self, z: Array) -> Array:
        """`(z - state)^-1 torque` at some z (n, 1, 1), (n, k, p)."""
        return np.asarray(np.linalg.solve(z * np.eye(len(self.state)) - self.state, self.torque + 0j), complex)

    def margin(self, gains: Array, h: float, inside: bool, adds: Array | None = None) -> float:
        """Delay at which the loop turns unstable [s]: 0 where it is already, inf where no delay does it.

        Args:
            gains: (p,) gain on s.
            h: Control period [s].
            inside: Whether the feedback inside Psi is there, too.
            adds: Of an integral, as of `radius`.
        """
        if self.radius(gains, inside, adds) > 1.0 + TOLERANCE:
            return 0.0
        F = self.feedback(gains, inside) + 0j
        own = np.zeros(self.errors.shape) if adds is None else adds[self.rows, None] * self.errors

        def loops(w: Array, responses: Array | None = None) -> Array:
            """Eigenvalues of H at some frequencies, by magnitude, (len(w), p)."""
            z = np.exp(1j * w * h)[:, None, None]
            H = (F + own / (z - 1.0)) @ (self.response(z) if responses is None else responses)
            found = np.asarray(np.linalg.eigvals(H), complex)
            return np.take_along_axis(found, np.argsort(np.abs(found), axis=1), axis=1)

        w = np.geomspace(min(SLOWEST, 0.1 / h), np.pi / h, FREQUENCIES)
        if h not in self.responses:
            self.responses[h] = self.response(np.exp(1j * w * h)[:, None, None])
        over = np.abs(loops(w, self.responses[h])) > 1.0
        at, i = np.nonzero(over[1:] != over[:-1])
        if not at.size:
            return np.inf
        low, high = np.log(w[at]), np.log(w[at + 1])
        for _ in range(3):  # regula falsi, all crossings at once
            below, above = (np.log(np.abs(loops(np.exp(x))[range(at.size), i])) for x in (low, high))
            middle = low + (high - low) * below / (below - above)
            found = loops(np.exp(middle))[range(at.size), i]
            same = np.sign(np.log(np.abs(found))) == np.sign(below)
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        return float((np.angle(found) % (2 * np.pi) / np.exp(middle)).min())


def held_loop(
    M: Array,
    law: LinearErrors,
    K: Array,
    h: float,
    machinery: Machinery = NOTHING,
    stiffness: Array | None = None,
    carried: bool = False,
) -> HeldLoop | None:
    """The linearised loop over one period, arguments as in `sampled_loop`; None where it moves too fast to compute.

    The torques of motors with a lag are further states; `stiffness` (n, n) is the derivative of gravity by the joints
    [N m/rad], which a torque at the measured joints cancels where it is `carried`, as late as that torque is. Servos
    hold velocities: see `behind`. What velocities are made of: see `seen`.
    """
    p, nb, poses = len(M), len(law.command), len(law.rates)
    friction, lag, servos, sight = machinery
    n = p - nb
    lagging = np.flatnonzero(lag) if lag is not None else np.zeros(0, int)
    motion = poses + n + p
    size = motion + len(lagging)
    A, B, errors = np.zeros((size, size)), np.zeros((size, p)), np.zeros((p, size))
    nu = slice(poses + n, motion)
    B[nu] = M_inv = np.asarray(np.linalg.inv(M), float)
    of_base = slice(poses + n, poses + n + nb)
    A[:poses, :poses], A[:poses, of_base], errors[:nb, :poses] = law
    rates = np.zeros((p, size))  # of nu_ref: what nudot_ref feeds back
    if nb:
        rates[:nb, :poses], rates[:nb, of_base] = law.command @ law.rates, law.command @ law.by_velocity
    rates[nb:, poses + n + nb : motion] = -np.diag(K)
    if lag is not None:
        of_lag = slice(motion, size)
        A[nu, of_lag], A[of_lag, of_lag] = M_inv[:, lagging], np.diag(-1.0 / lag[lagging])
        B[nu, lagging], B[np.arange(motion, size), lagging] = 0.0, 1.0 / lag[lagging]
    A[poses : poses + n, poses + n + nb : motion] = -np.eye(n)
    errors[nb:, poses : poses + n] = np.diag(K)
    errors[:, nu] = -np.eye(p)
    if not (np.isfinite(A).all() and np.linalg.norm(A, 1) * h < LARGEST):
        return None
    if friction is not None:  # it damps: however large, its exponential is small
        A[nu, nu] = -M_inv @ (np.diag(friction) if np.ndim(friction) == 1 else friction)
    weight = np.zeros((p, size))
    if stiffness is not None:
        A[nu, poses : poses + n] += M_inv[:, nb:] @ stiffness
        weight[nb:, poses : poses + n] = -stiffness * carried
    if servos is not None:
        A, B = behind(servos, A, B, M_inv, nu)
    state, torque, moved = over_a_period(A, B, nu, h)
    if sight is not None:
        (state, torque, nu), (errors, rates, weight) = seen(sight, state, torque, (errors, rates, weight), moved, nu, h)
    if servos is None:
        return HeldLoop(state, torque, np.arange(p), errors, M @ rates, rates, weight)
    return asking(servos, state, torque, (errors, rates, weight), M, nu, h)


def over_a_period(A: Array, B: Array, nu: slice, h: float) -> tuple[Array, Array, Array]:
    """State and torque of a period, as of `HeldLoop`, and nu on average over it by state and torque, (p, k + m)."""
    (size, m), p = B.shape, nu.stop - nu.start
    whole = np.zeros((size + m + p, size + m + p))
    whole[:size, :size], whole[:size, size : size + m], whole[size + m :, nu] = A, B, np.eye(p)
    held = scipy.linalg.expm(whole * h)
    return held[:size, :size], held[:size, size : size + m], held[size + m :, : size + m] / h


def seen(
    sight: VelocityFilter, state: Array, torque: Array, read: Sequence[Array], moved: Array, nu: slice, h: float
) -> tuple[tuple[Array, Array, slice], list[Array]]:
    """The loop with a filter's or an observer's memory as its last states, and where its rates stand in place of nu.

    What is read from nu (p, k) is then read from there.
    """
    size, p, (whole, total) = len(state), nu.stop - nu.start, sight.over(h)
    kept = [1] if sight.beta == 0.0 else [0, 1]
    A, b = whole[np.ix_(kept, kept)], total[kept, None]
    remembered = len(kept) * p
    state = np.block([[state, np.zeros((size, remembered))], [np.kron(b, moved[:, :size]), np.kron(A, np.eye(p))]])
    torque = np.vstack((torque, np.kron(b, moved[:, size:])))
    there = slice(len(state) - p, len(state))

    def by_sight(rows: Array) -> Array:
        found = np.zeros((len(rows), len(state)))
        found[:, : rows.shape[1]], found[:, there], found[:, nu] = rows, rows[:, nu], 0.0
        return found

    return (state, torque, there), [by_sight(rows) for rows in read]


def behind(servos: LinearServos, A: Array, B: Array, M_inv: Array, nu: slice) -> tuple[Array, Array]:
    """A and B of a loop whose servo rows take velocities u: the servos act all the time, not once in a period.

    A robot's own: `nudot_s = b (u - nu_s)`, by torques that act on the effort rows, too. Simulated ones: by the torque
    `E gain (fed E'u - E'nu + stiffness x)` with `xdot = E'(u - nu)`; the x are further states. Torques that act through
    a servo are the last columns of B.
    """
    asked, A, B = np.diag(servos.on), A.copy(), B.copy()
    if not servos.simulated:
        s = np.flatnonzero(servos.on)
        target, by_command = np.zeros((len(s), len(A))), (servos.numbers[0, :, None] * asked)[s]
        target[:, nu] = -by_command
        pull = M_inv[:, s] @ np.linalg.inv(M_inv[np.ix_(s, s)])
        A[nu] += pull @ (target - A[nu][s])
        B[nu] += pull @ (by_command - B[nu][s])
        return A, B
    E, m = servos.E, len(servos.gain)
    by_velocity, by_integral = (E * servos.gain) @ E.T, E * (servos.gain * servos.stiffness)
    further = np.zeros((m, len(A)))
    further[:, nu] = -E.T
    by_command = (E * servos.gain * servos.fed) @ E.T
    A[:, nu] -= B @ by_velocity
    whole = np.block([[A, B @ by_integral], [further, np.zeros((m, m))]])
    by_torque = np.hstack((B @ (np.eye(len(asked)) - asked + by_command @ asked), B[:, servos.through]))
    return whole, np.vstack((by_torque, np.hstack((E.T @ asked, np.zeros((m, len(servos.through)))))))


def asking(
    servos: LinearServos, state: Array, torque: Array, read: Sequence[Array], M: Array, nu: slice, h: float
) -> HeldLoop:
    """The loop with the law of servo rows (`loop.servo`), whose integrals psi are its last states.

    `u = nu_ref + nudot_ref / b + k s + psi`, `psi_next = psi = psi_last + h rate s`; on effort rows Psi has
    `nudot_s = b (u - psi - nu)`, but where torques act through the servo.
    """
    (errors, rates, weight), on, (b, k, rate), size = read, servos.on, servos.numbers[:, :, None], len(state)
    rows = np.flatnonzero(on)
    p, n = len(on), len(rows)
    s, nudot = np.zeros((p, size + n)), np.zeros((p, size + n))
    s[:, : errors.shape[1]], nudot[:, : rates.shape[1]] = errors, rates
    asked = (1.0 + k + h * rate) * s + nudot / b
    asked[:, nu] += np.eye(p)
    asked[rows, size:] = np.eye(n)
    follows = on.copy()
    follows[servos.through] = 0.0
    nudot += follows[:, None] * b * (1.0 + k) * s
    remembered = np.hstack((np.zeros((n, size)), np.eye(n))) + h * (rate * s)[rows]
    state = np.vstack((np.hstack((state, np.zeros((size, n)))), remembered))
    torque = np.vstack((torque, np.zeros((n, torque.shape[1]))))
    rows = np.concatenate((np.arange(p), servos.through))
    by_torque = np.concatenate((1.0 - on, np.ones(len(servos.through))))[:, None]
    asked = np.concatenate((on, np.zeros(len(servos.through))))[:, None] * asked[rows]
    asked[:, : weight.shape[1]] += by_torque * weight[rows]
    errors, inside, rates = (by_torque * found[rows] for found in (s, M @ nudot, nudot))
    return HeldLoop(state, torque, rows, errors, inside, rates, asked)


def linearised(plan: Plan, places: int, share: float = 1.0) -> list[HeldLoop | None]:
    """The loop at some places along the setpoints of a plan, and where an arm under PD sags to from there.

    Args:
        plan: Of a loop or a stepper.
        places: How many.
        share: Of the gains of the feedback, by which a robot sags.
    """
    robot, dynamics, servo, found = plan.robot, Dynamics(plan.robot), plan.servo, []
    for i in np.unique(np.linspace(0, len(plan.setpoints) - 1, places).astype(int)):
        position, _ = Start().state(robot, plan.setpoints[i])
        v_ref = Setpoint.side_by_side(plan.setpoints[i], robot.dimensions).velocity
        loop = robot.base.linear_errors(v_ref, plan.gains), plan.K, slowest(plan), machinery_of(plan)
        slope = weight_slope(robot, dynamics.gravity, position) if carries(plan) else None
        found.append(held_loop(dynamics.mass_matrix(position), *loop, slope, True))
        if isinstance(plan.controller, PD | ScheduledPD):
            springs = (share * gains_of(plan))[robot.dimensions.base :] * plan.K
            by_torque = np.ones(springs.size) if servo is None else servo.on[robot.dimensions.base :] == 0.0
            if (stiffness := sag(dynamics, position, springs, np.flatnonzero(by_torque))) is not None:
                found.append(held_loop(dynamics.mass_matrix(position), *loop, stiffness))
    return found


def carries(plan: Plan) -> bool:
    """Whether a torque at the measured joints carries an arm's weight: not that of a PD or a PID."""
    controller = plan.controller
    if isinstance(controller, CompiledController) and controller.networks is None:
        return controller.uses_model or not isinstance(controller.law(plan.context).learner, Integrator | None)
    return True


def machinery_of(plan: Plan) -> Machinery:
    """The parts between the torques of a plan and its measurements."""
    return Machinery(viscous_friction(plan.robot), lags(plan.robot, plan.lag), plan.servo, plan.sight)


def sag(dynamics: Dynamics, position: Array, springs: Array, free: IntArray) -> Array | None:
    """Let an arm down until springs hold it against gravity, in place; the stiffness of gravity there, (n, n).

    Args:
        dynamics: Of the robot.
        position: (nv,) from where; where it comes to rest.
        springs: (n,) torque per deviation of a joint [N m/rad or N/m].
        free: (k,) joints that do sag; of the others servos carry all weight.

    Returns:
        None for a robot that feels no gravity, or without springs.
    """
    robot = dynamics.robot
    arm, nb = robot.arm_index[free], robot.dimensions.base
    wanted, k = position[arm].copy(), springs[free]
    still = np.zeros(robot.dimensions.dof)

    def weight(q: Array) -> Array:
        position[arm] = q
        return np.asarray(dynamics.gravity(robot.follow(position))[nb:][free])

    def energy(y: Array) -> tuple[float, Array]:
        torque = weight(wanted + y / np.sqrt(k))  # scaled so that all springs are alike
        return 0.5 * float(y @ y) + dynamics.energy(position, still), y + torque / np.sqrt(k)

    if not (dynamics.feels_gravity and k.min(initial=np.inf) > 0.0 and arm.size):
        return None
    down = scipy.optimize.minimize(energy, TINY * np.sqrt(k), jac=True, method="BFGS")
    position[arm] = wanted + down.x / np.sqrt(k)
    robot.follow(position)
    slope, found = weight_slope(robot, dynamics.gravity, position), np.zeros((springs.size, springs.size))
    found[np.ix_(free, free)] = slope[np.ix_(free, free)]
    return found


def weight_slope(robot: Structure, gravity: Callable[[Array], Array], position: Array) -> Array:
    """Derivative of gravity on the arm by its joints, (n, n) [N m/rad].

    Args:
        robot: The robot.
        gravity: Of it, at positions (nv,), (p,).
        position: Where.
    """
    slope = np.zeros((robot.dimensions.arm, robot.dimensions.arm))
    for column, i in enumerate(robot.arm_index):
        for step in (TINY, -TINY):
            beside = position.copy()
            beside[i] += step
            slope[:, column] += gravity(robot.follow(beside))[robot.dimensions.base :] / (2.0 * step)
    return slope


def slowest(plan: Plan) -> float:
    """A slow sensor holds the torque, too [s]."""
    return max(plan.timing.control_period, plan.timing.sensor_period or 0.0)


def gains_of(plan: Plan) -> Array:
    """Gains of the controller on s, (p,); 0 on servo rows through which no torque acts."""
    gains = plan.controller.feedback_gain(plan.layout)  # type: ignore[union-attr]
    if plan.servo is None:
        return np.asarray(gains)
    acts = 1.0 - plan.servo.on
    acts[plan.servo.through] = 1.0
    return np.asarray(acts * gains)


def adds_inside(plan: Plan) -> bool:
    """Whether the controller adds an estimate of Psi, and with it the feedback inside."""
    controller = plan.controller
    if not isinstance(controller, CompiledController):
        return True
    if controller.uses_model or controller.networks is not None:
        return True
    learner = controller.law(plan.context).learner
    return learner is not None and not isinstance(learner, WITHOUT_RATES)


def judges(plan: Plan) -> bool:
    """Whether the gains of a plan's controller are known."""
    return isinstance(plan.controller, CompiledController | LearningLaw)


@one_thread
def delay_margin(plan: Plan, share: float = 1.0, places: int = 5, gains: Array | None = None) -> float:
    """Smallest delay between measurement and torque that makes the loop unstable along the setpoints [s].

    Args:
        plan: Of a loop or a stepper.
        share: Of the gains of the feedback.
        places: How many.
        gains: (p,) in place of its own.

    Returns:
        NaN for a controller in plain Python, whose gains are not known.
    """
    if not judges(plan):
        return float("nan")
    gains, h = share * (gains_of(plan) if gains is None else gains), slowest(plan)
    return min(margin_at(held, gains, h, adds_inside(plan)) for held in linearised(plan, places, share))


def margin_at(held: HeldLoop | None, gains: Array, h: float, inside: bool) -> float:
    """The margin of one place: that of the feedback alone, or with the feedback inside Psi where that is smaller."""
    if held is None:
        return 0.0
    return min(held.margin(gains, h, part) for part in {False, inside})


def verdicts(plan: Plan, other: Array | None = None) -> Iterator[SampledLoop]:
    """The sampled PD loop at ten places along the setpoints, with gains (p,) in place of its own."""
    robot, dynamics = plan.robot, Dynamics(plan.robot)
    machinery, h = machinery_of(plan), slowest(plan)
    gains = gains_of(plan) if other is None else other
    for i in np.unique(np.linspace(0, len(plan.setpoints) - 1, 10).astype(int)):
        position, _ = Start().state(robot, plan.setpoints[i])
        velocity = Setpoint.side_by_side(plan.setpoints[i], robot.dimensions).velocity
        law = robot.base.linear_errors(velocity, plan.gains)
        yield sampled_loop(dynamics.mass_matrix(position), gains, law, plan.K, h, machinery)
