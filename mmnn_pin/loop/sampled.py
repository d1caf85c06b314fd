"""The sampled loop before a run: is it stable, and how much delay does it bear?

The loop is linearised about the reference, with the torque held over a control period h: deviations
`d = [ex, ey, ephi; e; nu; tau of lagging motors]` obey `d_next = Phi d + Gamma tau`, `tau = F d`, and `Phi + Gamma F`
must have no eigenvalue beyond the unit circle. F is the feedback `k s`; a controller that adds `M nudot_ref` has also
the feedback inside it, `M [alphadot; K edot]`, which is judged beside.

**Delay margin.** With a delay L between measurement and torque the loop turns unstable where
`exp(-j w L) lambda = 1` for an eigenvalue lambda of `H(w) = F (exp(j w h) - Phi)^-1 Gamma`: at a frequency where
`|lambda| = 1` that needs `L = arg(lambda) / w`. The smallest one is the margin, of all velocities coupled and delayed
alike (a delay that is no whole number of periods counts as a phase, as between samples).

**Where it is judged.** Along the reference. An arm under PD sags below it, and is judged where it comes to rest, too:
at the nearest minimum of `1/2 (q_ref - q)' k K (q_ref - q) + U(q)`, with the stiffness of U. The worst counts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import expm

from ..compiled import one_thread
from ..errors import ConfigError
from ..model.base import BY_SIZE
from ..model.dynamics import Dynamics
from ..settings import Numbers
from ..signals import Array, IntArray, Setpoint
from ..torque.classical import Gravity, Integrator
from ..torque.controller import CompiledController
from ..torque.learning_law import LearningLaw
from ..torque.model_based import PD, ScheduledPD
from .before_run import Start, lags, viscous_friction
from .sample import Plan

TOLERANCE = 1e-9
TINY = 1e-5  # deviation by which a slope is taken, and by which what stands upright begins to fall [rad or m]
WITHOUT_RATES = (Gravity, Integrator)  # their Psi_hat does not answer to nudot_ref, and the errors in it
LARGEST = 700.0  # exponents up to here have an exponential
FREQUENCIES, SLOWEST = 160, 0.05  # of the sweep, from this one on [rad/s]
SHARES = np.geomspace(1.0, 0.01, 25)  # of the gains that are tried
ROOM = 1.5  # times the bandwidth of servos that is advised, the loop holds, too


@dataclass(frozen=True)
class SampledLoop:
    """Verdict on the sampled PD loop.

    Attributes:
        radius: Spectral radius of one control period; up to 1 is stable (exactly 1: something is not stabilised, such
            as the lateral error at vr = 0).
        gain_limits: (p,) gain on each velocity alone at which `nu_next = (Phi_ii - Gamma_ii k) nu` reaches -1, where
            without friction `Phi_ii = 1` and `Gamma_ii = h (M^-1)_ii`.
    """

    radius: float
    gain_limits: Array

    @property
    def stable(self) -> bool:
        """Whether no deviation grows."""
        return self.radius <= 1.0 + TOLERANCE


def sampled_loop(
    M: Array, gains: Array, v_ref: Array, base_gains: Array, K: Array, h: float, friction: Array | None = None
) -> SampledLoop:
    """Spectral radius of the held PD loop at one mass matrix and reference velocity.

    Args:
        M: (p, p) reduced mass matrix.
        gains: (p,) gain on `[z; r]`.
        v_ref: (nb,) reference velocity, (vr, wr) or (vxr, vyr, wr).
        base_gains: (3,) kx, ky, kth; of a holonomic base kx, ky, kphi.
        K: (n,) gain of the filtered arm error [1/s].
        h: Control period [s].
        friction: Viscous friction on nu, (p,) or a matrix (p, p); None for none.
    """
    held = held_loop(M, v_ref, base_gains, K, h, friction)
    if held is None:
        return SampledLoop(np.inf, 2.0 / (h * np.diag(np.linalg.inv(M))))
    radius = float(np.abs(np.linalg.eigvals(held.closed(gains))).max())
    nu = slice(len(held.state) - len(M), len(held.state))
    limits = (1.0 + np.diag(held.state)[nu]) / np.diag(held.torque[nu])
    return SampledLoop(radius, limits)


@dataclass(frozen=True, eq=False)
class HeldLoop:
    """One control period of the linearised loop: `d_next = state d + torque tau`, and `s = errors d`.

    Attributes:
        state: (k, k).
        torque: (k, p): what a torque held over the period does.
        errors: (p, k): `[z; r]` of a deviation.
        inside: (p, k): `M nudot_ref` of a deviation, the feedback inside Psi.
    """

    state: Array
    torque: Array
    errors: Array
    inside: Array

    def closed(self, gains: Array) -> Array:
        """(k, k) with the torque `gains s`, gains (p,)."""
        return self.state + self.torque @ self.feedback(gains, False)

    def feedback(self, gains: Array, inside: bool) -> Array:
        """(p, k) torque of a deviation: `gains s`, and `M nudot_ref` where it is added."""
        return gains[:, None] * self.errors + (self.inside if inside else 0.0)

    def radius(self, gains: Array, inside: bool) -> float:
        """Spectral radius of one period."""
        return float(np.abs(np.linalg.eigvals(self.state + self.torque @ self.feedback(gains, inside))).max())

    def margin(self, gains: Array, h: float, inside: bool) -> float:
        """Delay at which the loop turns unstable [s]: 0 where it is already, inf where no delay does it."""
        if self.radius(gains, inside) > 1.0 + TOLERANCE:
            return 0.0
        F, eye = self.feedback(gains, inside), np.eye(len(self.state))

        def loops(w: Array) -> Array:
            """Eigenvalues of H at some frequencies, by magnitude, (len(w), p)."""
            H = F @ np.linalg.solve(np.exp(1j * w * h)[:, None, None] * eye - self.state, self.torque + 0j)
            found = np.asarray(np.linalg.eigvals(H), complex)
            return np.take_along_axis(found, np.argsort(np.abs(found), axis=1), axis=1)

        w = np.geomspace(min(SLOWEST, 0.1 / h), np.pi / h, FREQUENCIES)
        over = np.abs(loops(w)) > 1.0
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
    v_ref: Array,
    base_gains: Array,
    K: Array,
    h: float,
    friction: Array | None = None,
    lag: Array | None = None,
    stiffness: Array | None = None,
) -> HeldLoop | None:
    """The linearised loop over one period, arguments as in `sampled_loop`; None where it moves too fast to compute.

    With `lag` (p,), time constants of first-order motors, their torques are further states where it is not 0 [s];
    `stiffness` (n, n) is the derivative of gravity by the joints [N m/rad].
    """
    p, nb = len(M), len(v_ref)
    poses, n = (3 if nb else 0), len(M) - len(v_ref)
    lagging = np.flatnonzero(lag) if lag is not None else np.zeros(0, int)
    motion = poses + n + p
    size = motion + len(lagging)
    A, B, errors = np.zeros((size, size)), np.zeros((size, p)), np.zeros((p, size))
    nu = slice(poses + n, motion)
    B[nu] = M_inv = np.linalg.inv(M)
    of_base = slice(poses + n, poses + n + nb)
    law = BY_SIZE[nb].linear_errors(v_ref, base_gains)
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
    if stiffness is not None:
        A[nu, poses : poses + n] += M_inv[:, nb:] @ stiffness
    held = expm(np.block([[A, B], [np.zeros((p, size + p))]]) * h)
    return HeldLoop(held[:size, :size], held[:size, size:], errors, M @ rates)


def require_stable(verdict: SampledLoop, gains: Array, names: tuple[str, ...], h: float) -> None:
    """Refuse gains that make the sampled PD loop unstable.

    Raises:
        ConfigError: With the spectral radius and the gains that are too high.
    """
    if verdict.stable:
        return
    over = [
        f"{name}: {gain:.4g} (limit alone {limit:.4g})"
        for name, gain, limit in zip(names, gains, verdict.gain_limits, strict=True)
        if gain > 0.5 * limit
    ]
    raise ConfigError(
        f"the sampled PD loop is unstable: spectral radius {verdict.radius:.4g} > 1, the torque held for {h:g} s",
        why="gains near or above their limit, 2 / (h (M^-1)_ii) without friction: "
        + ("; ".join(over) or "none, the kinematic gains"),
        fix="lower the gains, leave them out and let suitable ones be chosen, or shorten the control or sensor period",
        key="feedback",
    )


def linearised(plan: Plan, places: int, share: float = 1.0) -> list[HeldLoop | None]:
    """The loop at some places along the setpoints of a plan, and where an arm under PD sags to from there.

    Args:
        plan: Of a loop or a stepper.
        places: How many.
        share: Of the gains of the feedback, by which a robot sags.
    """
    robot, dynamics, servo = plan.robot, Dynamics(plan.robot), plan.servo
    friction, lag, h, found = viscous_friction(robot), lags(robot, plan.lag), slowest(plan), []
    for i in np.unique(np.linspace(0, len(plan.setpoints) - 1, places).astype(int)):
        position, _ = Start().state(robot, plan.setpoints[i])
        v_ref = Setpoint.side_by_side(plan.setpoints[i], robot.dimensions).velocity
        loop = v_ref, plan.gains, plan.K, h, friction, lag
        found.append(held_loop(dynamics.mass_matrix(position), *loop))
        if isinstance(plan.controller, PD | ScheduledPD):
            springs = (share * gains_of(plan))[robot.dimensions.base :] * plan.K
            by_torque = np.ones(springs.size) if servo is None else servo.gains[robot.dimensions.base :] == 0.0
            if (stiffness := sag(dynamics, position, springs, np.flatnonzero(by_torque))) is not None:
                found.append(held_loop(dynamics.mass_matrix(position), *loop, stiffness))
    return found


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
    from scipy.optimize import minimize  # slow to import, seldom needed

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
    down = minimize(energy, TINY * np.sqrt(k), jac=True, method="BFGS")
    q = wanted + down.x / np.sqrt(k)
    steps = TINY * np.eye(arm.size)
    slopes = [(weight(q + step) - weight(q - step)) / (2.0 * TINY) for step in steps]
    weight(q)
    found = np.zeros((springs.size, springs.size))
    found[np.ix_(free, free)] = np.transpose(slopes)
    return found


def slowest(plan: Plan) -> float:
    """A slow sensor holds the torque, too [s]."""
    return max(plan.timing.control_period, plan.timing.sensor_period or 0.0)


def gains_of(plan: Plan) -> Array:
    """Gains on s, (p,): the controller's, and on velocity interfaces what their servos amount to."""
    gains = plan.controller.feedback_gain(plan.layout)  # type: ignore[union-attr]
    return gains if plan.servo is None else np.where(plan.servo.gains > 0.0, plan.servo.gains, gains)


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
def delay_margin(plan: Plan, share: float = 1.0, places: int = 5) -> float:
    """Smallest delay between measurement and torque that makes the loop unstable along the setpoints [s].

    Args:
        plan: Of a loop or a stepper.
        share: Of the gains of the feedback.
        places: How many.

    Returns:
        NaN for a controller in plain Python, whose gains are not known.
    """
    if not judges(plan):
        return float("nan")
    gains, h = share * gains_of(plan), slowest(plan)
    return min(margin_at(held, gains, h, adds_inside(plan)) for held in linearised(plan, places, share))


def margin_at(held: HeldLoop | None, gains: Array, h: float, inside: bool) -> float:
    """The margin of one place: that of the feedback alone, or with the feedback inside Psi where that is smaller."""
    if held is None:
        return 0.0
    return min(held.margin(gains, h, part) for part in {False, inside})


@one_thread
def require_stable_gains(plan: Plan) -> None:
    """Judge the sampled PD loop at ten places along the setpoints, and with the latency of the plan.

    Raises:
        ConfigError: It is unstable at one of them, with the numbers and the largest gain that stands, or the bandwidth
            of slower servos that cure it.
    """
    if not judges(plan):
        return
    h = slowest(plan)
    for verdict in verdicts(plan):
        if not verdict.stable:
            what = f"the sampled loop is unstable: spectral radius {verdict.radius:.4g} > 1, commands held for {h:g} s"
            require_slow_servos(plan, what)
        require_stable(verdict, gains_of(plan), plan.robot.velocity_names, h)
    if plan.latency > 0.0:
        require_margin(plan)


def verdicts(plan: Plan) -> Iterator[SampledLoop]:
    """The sampled PD loop at ten places along the setpoints."""
    robot, dynamics = plan.robot, Dynamics(plan.robot)
    gains, friction, h = gains_of(plan), viscous_friction(robot), slowest(plan)
    for i in np.unique(np.linspace(0, len(plan.setpoints) - 1, 10).astype(int)):
        position, _ = Start().state(robot, plan.setpoints[i])
        velocity = Setpoint.side_by_side(plan.setpoints[i], robot.dimensions).velocity
        yield sampled_loop(dynamics.mass_matrix(position), gains, velocity, plan.gains, plan.K, h, friction)


def require_slow_servos(plan: Plan, what: str) -> None:
    """Refuse servos of velocity interfaces that are too fast for a loop, where slower ones cure it.

    Args:
        plan: Of the loop.
        what: What is wrong with it.

    Raises:
        ConfigError: With the bandwidth that it bears with some room.
    """
    for share in SHARES[1:] if plan.servo is not None else ():
        slower = plan.servo.times(float(share))  # type: ignore[union-attr]
        if not holds(replace(plan, servo=slower.times(ROOM))):
            continue
        b, fast = (in_short(servo.bandwidth) for servo in (slower, plan.servo))  # type: ignore[union-attr]
        why = f"servos with a bandwidth of {fast} 1/s on velocity interfaces are too fast for it"
        fix = f"state slower ones, servo=Servo(bandwidth={b}), or shorten the control or sensor period"
        raise ConfigError(what, why=why, fix=fix, key="servo.bandwidth")


def in_short(numbers: Numbers) -> str:
    """Numbers with two digits, as Python and TOML have them."""
    short = [f"{number:.2g}" for number in np.atleast_1d(numbers)]
    return f"[{', '.join(short)}]" if np.ndim(numbers) else short[0]


def holds(plan: Plan) -> bool:
    """Whether the sampled loop of a plan is stable, and bears its latency."""
    return all(verdict.stable for verdict in verdicts(plan)) and (
        plan.latency <= 0.0 or delay_margin(plan) > plan.latency
    )


def require_margin(plan: Plan) -> None:
    """Refuse gains that do not bear the latency of a plan.

    Raises:
        ConfigError: They do not, with the largest share of them that does.
    """
    margin = delay_margin(plan)
    if margin > plan.latency:
        return
    what = f"the loop does not bear a latency of {1e3 * plan.latency:.3g} ms"
    require_slow_servos(plan, what)
    share = largest_share(plan)
    fix = "lower the gains of the kinematic layer, or shorten the latency"
    if share > 0.0:
        gains = share * gains_of(plan)
        largest = ", ".join(f"{name} {gain:.4g}" for name, gain in zip(plan.robot.velocity_names, gains, strict=True))
        fix = f"lower the feedback to {share:.4f} of it: {largest}; or shorten the latency"
    why = f"its delay margin is {1e3 * margin:.3g} ms"
    raise ConfigError(what, why=why, fix=fix, key="latency")


def largest_share(plan: Plan) -> float:
    """Largest share of the feedback that bears the latency of a plan, to 2 %; 0 where none does."""
    for below, share in pairwise(SHARES):
        if delay_margin(plan, float(share)) > plan.latency:
            low, high = float(share), float(below)
            while high > 1.02 * low:
                middle = float(np.sqrt(low * high))
                low, high = (middle, high) if delay_margin(plan, middle) > plan.latency else (low, middle)
            return int(low * 1e4) / 1e4
    return 0.0
