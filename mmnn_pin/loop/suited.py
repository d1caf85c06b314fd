"""Defaults that suit a robot: gains of a controller that is given none, a reference that its motors can follow.

**Gains.** A gain k on a velocity is a bandwidth `k / I` times its effective inertia I. What a sampled loop bears is a
matter of bandwidth, so one rule fits a gripper of grams and a base of a hundred kilograms: `BANDWIDTHS` (of
`torque.controller`) times the smallest effective inertias, along the reference, or at some postures where there is
none, all times the largest share up to 1 with which the loop bears the delay that it has to, where it bears least, with
the feedback inside Psi and `ROOM` for what a learner adds. Loops, steppers and experiments take it for gains that are
not given. Light enough anywhere is too light elsewhere: gains that suit any posture leave an arm weak where it works.

**Rates.** How fast an integral or an observer beside the feedback may be follows from the same loop (`loop.rates`).

**Pace.** A reference is slowed until whoever follows it exactly needs of every motor no more than a share of its
effort and speed limits: the rest is for errors. What gravity and dry friction alone ask for no slowness saves; so the
arm swings about the middle of its range only where its motors hold it there within that share, else about the posture,
of some, where they are loaded least; and less far where they would not hold the ends of that swing within the share.
A base that steers first gets a path as large, and as slow, as its steering needs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import is_dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec
import numpy as np

from ..compiled import one_thread
from ..elementary.matrices import exponential, inverse, product, pseudo_inverse
from ..errors import TrajectoryError
from ..kinematic import Kinematic
from ..model.robot import Robot, speed_limits
from ..model.tree.twin import terms_of
from ..reference import Trajectory
from ..reference.steerable import fitted
from ..settings import Numbers, Timing
from ..signals import Array, Dimensions, Setpoint
from ..torque.classical import Integrating
from ..torque.controller import Bears, Feedback
from ..torque.neural import Neural, Robust
from .before_run import Start, lags, viscous_friction
from .rates import Kind, borne, largest_rate
from .sampled import HeldLoop, Machinery, held_loop, margin_at, weight_slope
from .servo import Servo
from .servo_model import LinearServos, linear_servos
from .sight import VelocityFilter

MARGIN = 0.003  # delay that default gains bear, beside the delay that is known [s]
ROOM = 1.2  # times the gains: what a learner adds to them at first
LESS, LEAST = 0.8, 0.01  # a share of the bandwidths is a power of this, and at least that
SLOWER, SLOWEST = 1.25, 16.0  # a slowness is a power of this, and at most that
INSTANTS = 100, 400  # at which a reference is looked at, at least and at most
OFTEN = 0.025  # that is how far they are apart between these [s]
LEFT = (
    0.5  # share of what gravity and friction leave of a motor, where they take so much that it is more than the share
)
POSTURES, JUDGED = 60, 6  # postures at which inertias are looked at, and those at which the loop is judged
SLOW = 3  # places where the loop is slowest, beside
PLACES = 41  # along a reference, likewise
STIFF = 2.78  # rk4 multiplies what decays at a rate a by more than 1 in a step h where a h is above 2.785
TRIALS = 100  # postures that are looked at where the middle is too heavy
NARROWER = 0.8 ** np.arange(1, 9)  # of the room about a posture, for a swing whose ends are too heavy


class LoopToSuit(NamedTuple):
    """The loop that gains have to suit."""

    kinematic: Kinematic  # gains of the kinematic layer
    period: float  # how long a torque is held [s]
    delay: float = MARGIN  # that the loop has to bear [s]
    margin: float = MARGIN  # part of it that nobody knows of, but wants to be borne [s]
    lag: Numbers = 0.0  # time constants of the motors [s]
    # setpoints where the robot will be, rows of a `Trajectory.table` as bytes; empty for `postures`
    reference: bytes = b""
    late: float = 0.0  # by how much an observer on a model is late, to an integral [s]
    sight: VelocityFilter | None = None  # how velocities are made of encoders
    interfaces: tuple[tuple[str, str], ...] = ()  # interface of joints, by name
    servo: Servo = Servo()  # the servos behind them. They count where torques act through them

    @classmethod
    def of(cls, loop: Any, trajectory: Trajectory, timing: Timing, layout: Dimensions) -> LoopToSuit:
        """The loop of a `Loop` or of an experiment, by its `kinematic`, `latency` and `actuator`.

        Raises:
            TrajectoryError: The base cannot follow the trajectory.
        """
        period, latency, sensor = timing.measurement_period, loop.latency, loop.sensor
        held, delay = max(timing.control_period, period), latency.total + latency.margin + sensor.line(period)
        rows, sight = (
            trajectory.table(np.linspace(0.0, timing.duration, PLACES), layout),
            VelocityFilter.of(sensor, period),
        )
        late = 0.0 if sight is not None else sensor.smoothing(period)
        lag, behind = loop.actuator.lag, (tuple(loop.interfaces.items()), loop.servo)
        return cls(loop.kinematic, held, delay, latency.margin, lag, rows.tobytes(), late, sight, *behind)

    def machinery(self, robot: Robot) -> Machinery:
        """The parts between torques and measurements of a robot."""
        friction, lag = viscous_friction(robot), lags(robot, self.lag)
        return Machinery(friction, lag, servos_through(robot, self.interfaces, self.servo), self.sight)


@lru_cache(16)
def servos_through(robot: Robot, given: tuple[tuple[str, str], ...], law: Servo) -> LinearServos | None:
    """The servos of a robot, where torques act through one of them; else None."""
    servos = linear_servos(robot, dict(given), law, True) if given else None
    return servos if servos is not None and servos.through.size else None


class Fit(NamedTuple):
    """Effective inertias of a robot (p,) [kg, kg m^2], and the share of `BANDWIDTHS` that its loop bears."""

    inertia: Array
    share: float


def suited(controller: Any, robot: Robot, given: Callable[[], LoopToSuit]) -> Any:
    """A controller with gains: what was not given suits the robot, bandwidths are multiplied with its inertias.

    A network whose gains come from inertias is scaled by them, too; a robust term that was not given as well.

    Args:
        controller: Any; one without a `Feedback`, or with complete gains, is returned as it is.
        robot: Its robot.
        given: The loop around them; asked only where gains are missing.
    """
    learner = getattr(controller, "learner", None)
    if isinstance(learner, Neural):
        return replace(controller, learner=suited(learner, robot, given))
    if isinstance(controller, Integrating):
        return with_rate(controller, robot, given)
    return with_answer(with_gains(controller, robot, given), robot, given)


def with_gains(controller: Any, robot: Robot, given: Callable[[], LoopToSuit]) -> Any:
    """The controller with gains, see `suited`."""
    feedback = getattr(controller, "feedback", None)
    if not isinstance(feedback, Feedback) or feedback.complete(robot.dimensions):
        return controller
    inertia, share = fit(robot, feedback, given())
    changed: dict[str, Any] = {"feedback": feedback.scaled(robot.dimensions, inertia, share)}
    if getattr(controller, "inertia", inertia) is None:
        changed["inertia"] = tuple(inertia.tolist())
    if isinstance(controller, Neural):
        changed["within_loop"] = True
        if controller.robust == Robust():
            changed["robust"] = SCALED.scaled(robot.dimensions, share * inertia)
    if is_dataclass(controller) and not isinstance(controller, type):
        return replace(controller, **changed)
    made = copy(controller)  # a plain class of a user's
    made.feedback = changed["feedback"]
    return made


def with_answer(controller: Any, robot: Robot, given: Callable[[], LoopToSuit]) -> Any:
    """A learner with what its loop bears of it; networks in the thesis's form are left as they are."""
    asks = "bears" in getattr(controller, "__dataclass_fields__", ()) and controller.bears is None
    if not asks or not controller.learning or not getattr(controller, "within_loop", True):
        return controller
    return replace(controller, bears=bears_of(robot, controller.feedback, given()))


@lru_cache(64)
@one_thread
def bears_of(robot: Robot, feedback: Feedback, given: LoopToSuit) -> Bears:
    """The part of a learner that the loop with a complete feedback bears, see `loop.rates.borne`."""
    gains, seen = feedback.vector(robot.dimensions), places(robot, given)
    loops = [loop for loop in seen.loops(robot, given, gains, SLOW) if loop is not None]
    known = given.delay - given.margin + given.late
    rate, room, factor = borne(loops, gains, given.period, known, given.margin)
    heaviest = np.max([np.diag(M) for M in seen.masses], axis=0)
    weight = np.divide(factor * heaviest, gains, out=np.full(gains.size, np.inf), where=gains > 0.0)
    return Bears(rate, room, tuple(weight.tolist()))


def with_rate(controller: Integrating, robot: Robot, given: Callable[[], LoopToSuit]) -> Integrating:
    """A controller that integrates, with gains, inertias and the rate that its loop bears, where not given."""
    feedback, own = controller.feedback, controller.settings
    if feedback.complete(robot.dimensions) and controller.complete:
        return controller
    found = fit(robot, feedback, given())
    feedback = feedback.scaled(robot.dimensions, found.inertia, found.share)
    inertia = getattr(controller, "inertia", None) or tuple(found.inertia.tolist())
    if getattr(own, controller.rate_key) is None:
        rate = controller.rate_factor * rate_of(robot, feedback, inertia, given(), controller.kind)
        own = msgspec.structs.replace(own, **{controller.rate_key: rate})
    more: dict[str, Any] = {"inertia": inertia} if hasattr(controller, "inertia") else {}
    return replace(controller, **more | {"feedback": feedback, "settings": own})


SCALED = Robust(1.0, 1.0)  # a robust term that was not given, beside gains from bandwidths


class Postures(NamedTuple):
    """Places at which a loop is judged."""

    masses: list[Array]  # mass matrices (p, p)
    slopes: list[Array]  # of gravity (n, n)
    held: list[Array]  # `held_velocities`
    velocities: Array  # of the reference

    def loops(self, robot: Robot, given: LoopToSuit, gains: Array, slow: int = 0) -> list[HeldLoop | None]:
        """The loop where it is fastest with gains (p,), at `JUDGED` places, and at some where it is slowest."""
        layout, machinery = robot.dimensions, given.machinery(robot)
        modes = [np.abs(np.linalg.eigvals(Gamma * gains)) for Gamma in self.held]
        fast = np.argsort([-each.max() for each in modes])[:JUDGED]
        chosen = {*fast.tolist(), *np.argsort([each.min() for each in modes])[:slow].tolist()}
        K, base = given.kinematic.arm_gains(layout), given.kinematic.base_gains(layout)
        laws = {i: robot.base.linear_errors(self.velocities[i], base) for i in chosen}
        return [
            held_loop(self.masses[i], laws[i], K, given.period, machinery, self.slopes[i], True) for i in sorted(chosen)
        ]


@lru_cache(16)
def places(robot: Robot, given: LoopToSuit) -> Postures:
    """The places along the reference of a loop, or `postures` where it has none."""
    table = postures(robot, POSTURES)
    if given.reference:
        table = np.frombuffer(given.reference).reshape(-1, table.shape[1])
    positions = [Start().state(robot, row)[0] for row in table]
    masses = mass_matrices(robot, positions)
    held = [held_velocities(M, viscous_friction(robot), given.period) for M in masses]
    return Postures(
        masses, weight_slopes(robot, positions), held, Setpoint.side_by_side(table, robot.dimensions).velocity
    )


@lru_cache(64)
@one_thread
def rate_of(robot: Robot, feedback: Feedback, inertia: tuple[float, ...], given: LoopToSuit, kind: Kind) -> float:
    """The rate that the loop with a complete feedback bears, see `loop.rates`."""
    gains = feedback.vector(robot.dimensions)
    loops = [loop for loop in places(robot, given).loops(robot, given, gains, SLOW) if loop is not None]
    return largest_rate(loops, gains, np.array(inertia), given.period, given.delay + given.late, kind)


@lru_cache(16)
@one_thread
def fit(robot: Robot, feedback: Feedback, given: LoopToSuit) -> Fit:
    """Inertias, and the share of the bandwidths that are not given with which the loop bears its delay; see the top.

    The loop is judged where its gains are largest for what they move.
    """
    layout, h = robot.dimensions, given.period
    seen = places(robot, given)
    inertia: Array = np.min([h / np.diag(Gamma) for Gamma in seen.held], axis=0)
    if feedback.given(layout):
        return Fit(inertia, 1.0)
    loops = seen.loops(robot, given, feedback.scaled(layout, inertia).vector(layout))
    share = 1.0
    while share > LEAST:
        k = ROOM * feedback.scaled(layout, inertia, share).vector(layout)
        if all(margin_at(one, k, h, True) >= given.delay for one in loops):
            break
        share *= LESS
    else:  # a gain that was given is too much; the others are what they would be beside none
        return Fit(inertia, fit(robot, Feedback(), given).share if feedback != Feedback() else share)
    return Fit(inertia, share)


def postures(robot: Robot, count: int = 9, speed: float = 0.5) -> Array:
    """Setpoints at which gains are judged where there is no reference: at rest, and joints anywhere, (count, w).

    Every other one has joints at quarter turns: there arms are stretched, and feel lightest about their own axes.

    Args:
        robot: The robot.
        count: How many.
        speed: Of the base, forwards, but for the first, which stands [m/s].
    """
    d, rng, quarter = robot.dimensions, np.random.default_rng(0), np.pi / 2
    table = np.zeros((count, d.pose + 2 * d.twist + 3 * d.arm))
    setpoints, arm = Setpoint.side_by_side(table, d), robot.arm_index
    lower, upper = np.maximum(robot.lower[arm], -np.pi), np.minimum(robot.upper[arm], np.pi)
    setpoints.q[:] = rng.uniform(lower, upper, (count, d.arm))
    setpoints.q[1::2] = np.clip(quarter * np.round(setpoints.q[1::2] / quarter), lower, upper)
    setpoints.q[0] = robot.neutral_position()[arm]
    if d.base:
        setpoints.velocity[1:, 0] = speed
    return table


def mass_matrices(robot: Robot, positions: Iterable[Array]) -> list[Array]:
    """Reduced mass matrices (p, p) at some positions (nv,)."""
    terms, still, found = terms_of(robot), np.zeros(robot.dimensions.dof), []
    for position in positions:
        terms.refresh(position, still)
        found.append(terms.M.copy())
    return found


def weight_slopes(robot: Robot, positions: Iterable[Array]) -> list[Array]:
    """Slopes of gravity at some positions (nv,), see `sampled.weight_slope`."""
    terms, still = terms_of(robot), np.zeros(robot.dimensions.dof)

    def gravity(position: Array) -> Array:
        terms.refresh(position, still)
        weight = np.zeros(still.size)
        terms.refresh_psi(still, still, weight)
        return weight

    return [weight_slope(robot, gravity, position) for position in positions]


def timing_for(robot: Robot, timing: Timing) -> Timing:
    """Choose the integrator where a timing leaves it open ("auto").

    Viscous friction D lets velocities decay at the eigenvalues of `M^-1 D`, none of which is above the trace. rk4 is
    stable while the largest times the plant step is below 2.785 (Hairer and Wanner, Solving Ordinary Differential
    Equations II, IV.2); from a trace of that on it is `implicit_friction`.

    Args:
        robot: As loaded; looked at where all joints are at zero.
        timing: Of a loop.
    """
    if timing.integrator != "auto":
        return timing
    friction, stiff = viscous_friction(robot), False
    if friction.any():
        (M,) = mass_matrices(robot, [robot.follow(np.zeros(robot.dimensions.full))])
        stiff = float(np.trace(product(inverse(M), friction))) * timing.plant_step > STIFF
    return msgspec.structs.replace(timing, integrator="implicit_friction" if stiff else "rk4")


def effective_inertia(robot: Robot, positions: Iterable[Array], period: float) -> Array:
    """Effective inertia of every velocity, the smallest one at some positions (nv,), (p,) [kg, kg m^2].

    It is `period / Gamma_ii` of `held_velocities`. Without friction this is `1 / (M^-1)_ii`: what a torque on that
    velocity alone accelerates while all others move freely. A link of a few milligram square metres in a joint with
    1 N m s weighs what its friction makes of it.
    """
    friction, masses = viscous_friction(robot), mass_matrices(robot, positions)
    return np.min([period / np.diag(held_velocities(M, friction, period)) for M in masses], axis=0)


def held_velocities(M: Array, friction: Array, period: float) -> Array:
    """`Gamma = int_0^period exp(-M^-1 D t) dt M^-1`: the velocities that torques held for a period give, (p, p).

    Args:
        M: Reduced mass matrix.
        friction: D, viscous friction on nu, (p, p).
        period: [s].
    """
    M_inv, p = inverse(M), len(M)
    held = exponential(np.block([[-product(M_inv, friction), M_inv], [np.zeros((p, 2 * p))]]) * period)
    return held[:p, p:]


class MotorLoad:
    """Torque and speed that a motion asks of a robot's motors, over their limits.

    Args:
        robot: The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot, self.terms = robot, terms_of(robot)
        self.psi = np.zeros(robot.dimensions.dof)
        self.limits, self.speeds = robot.effort_limits, speed_limits(robot)

    def along(self, trajectory: Trajectory, duration: float, enough: float | Array = np.inf) -> Array:
        """Largest torque and speed of every motor over its limits, (2, motors), a reference followed exactly.

        The whole motion counts, also what a slower one does not reach in the duration [s] that it has when not slowed;
        but the search ends where something is larger than `enough`.
        """
        robot, layout = self.robot, self.robot.dimensions
        instants = int(np.clip(duration / OFTEN, *INSTANTS))
        table = trajectory.table(np.linspace(0.0, duration * trajectory.slowness, instants), layout)
        found = np.zeros((2, layout.motors))
        for row in table:
            setpoint = Setpoint.side_by_side(row, layout)
            position, nu = Start(moving=True).state(robot, row)
            self.terms.refresh(position, nu)
            faster = robot.base_velocity(position, setpoint.acceleration)
            self.terms.refresh_psi(nu, np.concatenate((faster, setpoint.qddot)), self.psi)
            E = robot.E_at(position)
            torque, speed = product(pseudo_inverse(E), self.psi), product(E.T, nu)
            found = np.maximum(found, (over(torque, self.limits), over(speed, self.speeds)))
            if (found > enough).any():
                break
        return found

    def at_rest(self, trajectory: Trajectory, duration: float, enough: float | Array = np.inf) -> Array:
        """The share that gravity and dry friction alone ask for, as `along` at hardly any pace; its speeds are none."""
        found = self.along(replace(trajectory, slowness=SLOWEST), duration, enough)
        found[1] = 0.0
        return found


def tightest(robot: Robot, trajectory: Trajectory, duration: float, share: float) -> str:
    """The limit for which a motion of `followable` is as slow as it is, in words; empty where none asks for it."""
    load = MotorLoad(robot)
    faster = load.along(replace(trajectory, slowness=max(trajectory.slowness / SLOWER, 1.0)), duration)
    static = load.at_rest(trajectory, duration)
    over_enough = faster / enough_of(static, share)
    if over_enough.max(initial=0.0) <= 1.0:
        return ""
    kind, motor = np.unravel_index(int(over_enough.argmax()), over_enough.shape)
    limit = (robot.effort_limits, speed_limits(robot))[kind][motor]
    name, always = robot.actuator_names[motor], static[kind, motor]
    slides = robot.model.joints[robot.model.getJointId(name)].shortname().startswith("JointModelP")
    takes = f"{always:.0%} go into gravity and friction at any pace" if always > share else ""
    takes = takes or f"it may take {share:.0%} (reference.share)"
    return f"{name} has at most {limit:.3g} {(('N m', 'N'), ('rad/s', 'm/s'))[kind][slides]}, of which {takes}"


def enough_of(static: Array, share: float) -> Array:
    """How much of its limits each motor may be asked for, where a slow motion asks for `static`, (2, motors) both."""
    return np.maximum(share, static + LEFT * np.maximum(1.0 - static, 0.1))


def over(value: Array, limit: Array) -> Array:
    """|value| over its limit, 0 where nothing is asked for."""
    return np.divide(np.abs(value), limit, out=np.zeros_like(value), where=value != 0)


JointEnds = tuple[Array, Array]


@one_thread
def followable(
    robot: Robot, reference: Callable[[JointEnds], Trajectory], duration: float, share: float, trailer: bool = False
) -> Trajectory:
    """A reference within the limits of a robot's joints that its motors can follow with a share of theirs; see the top.

    Args:
        robot: The robot.
        reference: The reference within lower and upper limits of the arm's joints, (n,) each.
        duration: Of the run [s].
        share: Of every motor's effort and speed limits; 0 for any.
        trailer: Whether the reference is its trailer's.

    Raises:
        TrajectoryError: However slow, it is too fast for a motor.
    """
    lower, upper = (limit[robot.arm_index] for limit in (robot.lower, robot.upper))
    given = reference((lower, upper))
    if not share:
        return given
    to_steer = fitted(given, robot.base, robot.dimensions, duration, trailer)

    def steerable(ends: JointEnds) -> Trajectory:
        return replace(reference(ends), base=to_steer.base)

    given = replace(given, base=to_steer.base)
    load, rng = MotorLoad(robot), np.random.default_rng(0)
    bounded, off = np.isfinite(upper - lower), np.zeros(len(lower))
    low, high = np.where(bounded, lower, -np.pi), np.where(bounded, upper, np.pi)
    half, centre = (high - low) / 2, np.where(bounded, low + (high - low) / 2, np.clip(0.0, lower, upper))

    def held(tried: Trajectory, enough: float = np.inf) -> Array:
        return load.at_rest(tried, duration, enough)

    best, static = given, held(given)
    for _ in range(TRIALS if static.max(initial=0.0) > share and half.size else 0):
        other = rng.uniform(-0.5, 0.5, len(half)) * half
        tried = steerable((low + np.maximum(2 * other, 0.0), high + np.minimum(2 * other, 0.0)))
        if (load_there := held(tried, static.max(initial=0.0))).max(initial=0.0) < static.max(initial=0.0):
            best, static, off = tried, load_there, other
    for width in NARROWER if static.max(initial=0.0) > share else ():
        reach = width * (half - np.abs(off))
        tried = steerable((centre + off - reach, centre + off + reach))
        if (load_there := held(tried, static.max(initial=0.0))).max(initial=0.0) < static.max(initial=0.0):
            best, static = tried, load_there
        if static.max(initial=0.0) <= share:
            break
    slowness, enough = to_steer.slowness, enough_of(static, share)
    while slowness < SLOWEST and (load.along(replace(best, slowness=slowness), duration, enough) > enough).any():
        slowness = min(SLOWER * slowness, SLOWEST)
    found = replace(best, slowness=slowness)
    if slowness >= SLOWEST and (quick := load.along(found, duration)[1]).max(initial=0.0) > 1.0:
        motor = int(quick.argmax())
        what = f"the reference is {slowness * quick[motor]:.3g} times as fast as {robot.actuator_names[motor]} can be"
        fix = "give it in m, rad and s, or give it more time"
        raise TrajectoryError(
            what, why=f"slowed down {slowness:g} times it is still too fast", fix=fix, key="reference"
        )
    return found
