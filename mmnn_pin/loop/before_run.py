"""What is settled before a run: where it starts, where its state counts as lost, and what is refused.

Refused are a nominal robot of another shape, a first sample without a measurement, and gains with which the PD loop
alone is unstable when it is sampled. For that the loop is linearised about the reference, with the torque held over a
control period h: deviations `d = [ex, ey, ephi; e; nu]` obey `d_next = (Phi + Gamma K) d`. A spectral radius above 1
means that the samples come too slowly for the gains, whatever a network adds.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from ..compiled import one_thread
from ..errors import ConfigError
from ..model.base import BY_SIZE
from ..model.dynamics import Dynamics
from ..model.robot import Robot
from ..settings import Settings, Timing, one_or_each, require_gains
from ..signals import Array, Dimensions, Setpoint
from ..torque.controller import CompiledController, Feedback, TorqueController
from ..torque.learning_law import LearningLaw
from .sample import Plan

TOLERANCE = 1e-9
LARGEST = 700.0  # exponents up to here have an exponential


class Start(Settings, frozen=True):
    """Where a run starts, relative to the reference at t = 0.

    Args:
        pose_offset: Start minus reference, in the reference's frame (x, y, phi) [m, m, rad].
        joint_offset: Start minus reference of every arm joint, one number or one per joint [rad or m].
        moving: Start with the reference's velocity instead of at rest.

    Raises:
        ConfigError: An offset is not finite.
    """

    pose_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joint_offset: float | tuple[float, ...] = 0.0
    moving: bool = False

    def __post_init__(self) -> None:
        for name in ("pose_offset", "joint_offset"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise ConfigError(f"{getattr(self, name)} is not finite", fix="use finite numbers", key=f"start.{name}")

    def state(self, robot: Robot, first: Array) -> tuple[Array, Array]:
        """Position (nv,) and nu (p,) for the first setpoint, its six arrays side by side.

        Raises:
            ConfigError: Neither one joint offset nor as many as arm joints.
        """
        layout = robot.dimensions
        joint_offset = one_or_each(self.joint_offset, layout.arm, "joint", "start.joint_offset")
        position, nu = robot.neutral_position(), np.zeros(layout.dof)
        setpoint = Setpoint.side_by_side(first, layout)
        if layout.base:
            x, y, phi = setpoint.pose
            dx, dy, dphi = self.pose_offset
            c, s = np.cos(phi), np.sin(phi)
            position[:3] = x + c * dx - s * dy, y + s * dx + c * dy, phi + dphi
        position[robot.arm_index] = setpoint.q + joint_offset
        if self.moving:
            nu[: layout.base], nu[layout.base :] = setpoint.velocity, setpoint.qdot
        return robot.follow(position), nu


class Bounds(Settings, frozen=True):
    """Where a state counts as lost; leaving them ends the run as diverged.

    Args:
        speed: Largest speed of the base [m/s].
        yaw_rate: Largest yaw rate of the base [rad/s].
        joint_speed: Largest speed of an arm joint [rad/s or m/s].
    """

    speed: float = 20.0
    yaw_rate: float = 100.0
    joint_speed: float = 200.0

    def __post_init__(self) -> None:
        require_gains(self, "bounds")

    def vector(self, layout: Dimensions) -> Array:
        """Bounds on |nu|, (p,)."""
        base = BY_SIZE[layout.base].per_velocity(self.speed, self.yaw_rate)
        return np.array(base + [self.joint_speed] * layout.arm, float)


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
    """

    state: Array
    torque: Array
    errors: Array

    def closed(self, gains: Array) -> Array:
        """(k, k) with the torque `gains s`, gains (p,)."""
        return self.state + self.torque @ (gains[:, None] * self.errors)


def held_loop(
    M: Array, v_ref: Array, base_gains: Array, K: Array, h: float, friction: Array | None = None
) -> HeldLoop | None:
    """The linearised loop over one period, arguments as in `sampled_loop`; None where it moves too fast to compute."""
    p, nb = len(M), len(v_ref)
    poses, n = (3 if nb else 0), len(M) - len(v_ref)
    size = poses + n + p
    A, B, errors = np.zeros((size, size)), np.zeros((size, p)), np.zeros((p, size))
    nu = slice(poses + n, size)
    M_inv = np.linalg.inv(M)
    B[nu] = M_inv
    of_base = slice(poses + n, poses + n + nb)
    A[:poses, :poses], A[:poses, of_base], errors[:nb, :poses] = BY_SIZE[nb].linear_errors(v_ref, base_gains)
    A[poses : poses + n, poses + n + nb :] = -np.eye(n)
    errors[nb:, poses : poses + n] = np.diag(K)
    errors[:, nu] = -np.eye(p)
    if not (np.isfinite(A).all() and np.linalg.norm(A, 1) * h < LARGEST):
        return None
    if friction is not None:  # it damps: however large, its exponential is small
        A[nu, nu] = -M_inv @ (np.diag(friction) if np.ndim(friction) == 1 else friction)
    held = expm(np.block([[A, B], [np.zeros((p, size + p))]]) * h)
    return HeldLoop(held[:size, :size], held[:size, size:], errors)


def viscous_friction(robot: Robot) -> Array:
    """Viscous friction of a robot's joints and base on nu, (p, p); Coulomb friction has none once it slides."""
    return robot.T.T @ (robot.damping[:, None] * robot.T) + np.diag(robot.viscous)


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
        fix="lower the gains, or shorten the control or sensor period",
        key="feedback",
    )


@one_thread
def require_stable_gains(plan: Plan) -> None:
    """Judge the sampled PD loop at ten places along the reference.

    Raises:
        ConfigError: It is unstable at one of them, with the numbers.
    """
    if not isinstance(plan.controller, CompiledController | LearningLaw):
        return
    robot, dynamics = plan.robot, Dynamics(plan.robot)
    gains, friction = plan.controller.feedback_gain(plan.layout), viscous_friction(robot)
    h = max(plan.timing.control_period, plan.timing.sensor_period or 0.0)  # a slow sensor holds the torque, too
    for i in np.unique(np.linspace(0, len(plan.setpoints) - 1, 10).astype(int)):
        position, _ = Start().state(robot, plan.setpoints[i])
        velocity = Setpoint.side_by_side(plan.setpoints[i], robot.dimensions).velocity
        verdict = sampled_loop(dynamics.mass_matrix(position), gains, velocity, plan.gains, plan.K, h, friction)
        require_stable(verdict, gains, robot.velocity_names, h)


def postures(robot: Robot, speed: float = 0.5, count: int = 9) -> Array:
    """Setpoints at which gains are judged where there is no reference: at rest, and joints anywhere, (count, w).

    Args:
        robot: The robot.
        speed: Of the base, forwards, but for the first, which stands [m/s].
        count: How many.
    """
    d, rng = robot.dimensions, np.random.default_rng(0)
    table = np.zeros((count, d.pose + 2 * d.base + 3 * d.arm))
    setpoints, arm = Setpoint.side_by_side(table, d), robot.arm_index
    lower, upper = np.maximum(robot.lower[arm], -np.pi), np.minimum(robot.upper[arm], np.pi)
    setpoints.q[:] = rng.uniform(lower, upper, (count, d.arm))
    setpoints.q[0] = robot.neutral_position()[arm]
    if d.base:
        setpoints.velocity[1:, 0] = speed
    return table


def with_gains_of(
    controller: CompiledController | TorqueController, robot: Robot, period: float
) -> CompiledController | TorqueController:
    """A controller whose bandwidths are gains: times the robot's smallest effective inertias at `postures`."""
    feedback = getattr(controller, "feedback", None)
    if not isinstance(feedback, Feedback) or feedback.scaling == "none":
        return controller
    inertia = effective_inertia(robot, (Start().state(robot, row)[0] for row in postures(robot)), period)
    return replace(controller, feedback=feedback.scaled(robot.dimensions, inertia))  # type: ignore[type-var]


def effective_inertia(robot: Robot, positions: Iterable[Array], period: float) -> Array:
    """Effective inertia of every velocity, the smallest one at some positions (nv,), (p,) [kg, kg m^2].

    It is `period / Gamma_ii`, with `Gamma = int_0^period exp(-M^-1 D t) dt M^-1` the velocity that a torque held for
    one control period gives, M the reduced mass matrix and D its viscous friction. Without friction this is
    `1 / (M^-1)_ii`: what a torque on that velocity alone accelerates while all others move freely. A link of a few
    milligram square metres in a joint with 1 N m s weighs what its friction makes of it.
    """
    dynamics, D, p = Dynamics(robot), viscous_friction(robot), robot.dimensions.dof
    found = []
    for position in positions:
        M_inv = np.linalg.inv(dynamics.mass_matrix(position))
        held = expm(np.block([[-M_inv @ D, M_inv], [np.zeros((p, 2 * p))]]) * period)
        found.append(period / np.diag(held[:p, p:]))
    return np.min(found, axis=0)


def require_nominal(nominal: Robot, robot: Robot) -> None:
    """Refuse a nominal robot of another shape.

    Raises:
        ConfigError: It has another base or other joints.
    """
    if nominal.dimensions != robot.dimensions:
        raise ConfigError(
            f"the nominal robot has {nominal.dimensions}, the robot {robot.dimensions}",
            fix="use one with the same base and the same joints",
            key="nominal",
        )


def require_first(timing: Timing, first: int) -> None:
    """Refuse to start at a control sample at which there is no measurement.

    Raises:
        ConfigError: There is none, or no such sample.
    """
    if not 0 <= first < timing.samples or first * timing.steps_per_control % timing.steps_per_measurement:
        raise ConfigError(
            f"cannot start at control sample {first}",
            why=f"the run has {timing.samples}, and a held measurement is not part of the state",
            fix="choose one of them at which there is a measurement",
            key="first",
        )
