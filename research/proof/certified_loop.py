"""The loop that a certificate speaks of, from a recording: robot, gains, reference, learner; or why there is none.

The reference must be one motion. Between two samples a rate that moves smoothly from f0 to f1, with derivatives g0 and
g1, adds `h (f0 + f1)/2 + h^2 (g0 - g1)/12` (corrected trapezoidal rule, an error of order h^5); a rate without them
`h (f0 + f1)/2`. Poses of a table may drift away from its velocities by a little, which the certificate counts with; a
velocity that jumps gives the errors a jump, which it cannot. Where a limit of a supervisor may be passed, another loop
begins.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import msgspec
import numpy as np

from mmnn_pin.errors import RecordingError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.lab.psi.learner import NetworkLearner
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.robot import Robot
from mmnn_pin.safety import Safety
from mmnn_pin.signals import Array, Layout
from mmnn_pin.torque.controller import per_velocity

from .bounds import PoseBound
from .cover import Along, ArmMetric, Cover
from .motion_bound import Drive
from .screws import Bodies

TOLERANCE = 1e-3  # of the largest rate
SPREAD = 0.5  # [rad or m]: arm errors beyond this are not looked at
LADDER = 0.7 ** np.arange(15.0)  # of the largest size of arm errors, for which there are covers
BEYOND = 2e-3  # [rad or m] that joints may move while a command is in force, where it has the gravity of its sample
SIGNALS = ("velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref", "pose_ref")
RATES = (("velocity_ref", "acceleration_ref"), ("q_ref", "qdot_ref"), ("qdot_ref", "qddot_ref"))
WEIGHED = 50  # rows whose gravity is compared with the robot's
TORQUE = "largest motor torque [N m or N]"
SPEED = 1e-6  # [m/s] below which the reference counts as standing


@dataclass(frozen=True, eq=False)
class CertifiedLoop:
    """A differential drive with an arm that follows a reference that never stands still, sampled."""

    robot: Robot  # the true robot
    kinematic: Kinematic  # gains of the kinematic layer; kx, ky, kth, K > 0
    along: Along  # the reference at every control sample
    period: float  # control period [s], in which the torque is held
    gain: Array  # (p,) constant gain on s: k [N s/m, N m s]
    learner: NetworkLearner | None  # networks and robust term; None for PD
    disturbance: Array  # (p,) largest external force on nu [N, N m]
    projection: float | None = None  # largest norm that a supervisor scales the weights back to, None without
    supervisor: Supervisor | None = None  # limits that the loop must not pass; None without
    # speed [m/s] and yaw rate [rad/s] at which the reference's poses leave its velocities, at most
    drift: tuple[float, float] = (0.0, 0.0)
    late: float = 0.0  # largest time from a sample to when its command is in force [s]
    # (p,) largest error of the measured velocities [m/s, rad/s]
    noise: Array = field(default_factory=lambda: np.zeros(1))
    # (motors,) largest torque of every motor, inf where there is no limit [N m or N]
    motors: Array = field(default_factory=lambda: np.full(1, np.inf))
    weighs: bool = False  # whether the controller adds the gravity at the joints that it measures

    def __post_init__(self) -> None:
        robot = self.robot
        object.__setattr__(self, "noise", np.zeros(robot.dimensions.dof) + self.noise)
        object.__setattr__(self, "motors", np.zeros(len(robot.E)) + self.motors)

    @cached_property
    def pose(self) -> PoseBound:
        """The Lyapunov function of the pose."""
        return PoseBound.of(self.kinematic, self.along.v_ref)

    @cached_property
    def K(self) -> Array:
        """(n,) gain of the filtered arm error [1/s]."""
        return self.kinematic.arm_gains(self.robot.dimensions)

    @cached_property
    def bodies(self) -> Bodies:
        """What bounds of the dynamics are computed from; errors as of `Bodies.of`."""
        return Bodies.of(self.robot)

    @cached_property
    def metric(self) -> ArmMetric:
        """Of the arm errors."""
        return ArmMetric.best(self.robot, self.along, self.K)

    @cached_property
    def sizes(self) -> Array:
        """Sizes of the arm errors for which there may be covers, the largest first; 0 without an arm."""
        return SPREAD / self.metric.reach.max() * LADDER if len(self.K) else np.zeros(1)

    @cached_property
    def known(self) -> dict[int, Cover]:
        """The covers that were asked for, by their place in `sizes`."""
        return {}

    def cover(self, arm: float) -> Cover:
        """Wherever the robot may be with a size of the arm errors; where M is not bounded there, the widest that is.

        Raises:
            RecordingError: Not even the smallest is.
        """
        last = len(self.sizes) - 1
        for k in range(max(int((self.sizes >= arm).sum()) - 1, 0), last + 1):
            if k not in self.known:
                size = float(self.sizes[k])
                beyond = BEYOND * self.weighs
                self.known[k] = Cover.of(self.robot, self.bodies, self.along, self.metric, size, beyond)
            if (self.known[k].mass_off < 1).all():
                return self.known[k]
        why = f"with joints up to {SPREAD * LADDER[last]:.2g} off, M may change along the reference by all of itself "
        raise RecordingError("no certificate", why=f"{why}between the places it is looked at; use a slower reference")

    @property
    def widest(self) -> Cover:
        """The one for the largest size of the arm errors; errors as of `cover`."""
        return self.cover(np.inf)

    @cached_property
    def arm_decay(self) -> float:
        """Rate at which the size of the arm errors decays for r = 0 [1/s]; see `ArmMetric.decay`."""
        return self.metric.decay(self.K)

    @cached_property
    def robust(self) -> tuple[Array, Array]:
        """Kz and ZB of the robust term, (p,) each; zeros without one."""
        layout, term = self.robot.dimensions, self.learner.own.robust if self.learner else None
        if term is None:
            return np.zeros(layout.dof), np.zeros(layout.dof)
        return per_velocity(term.base, term.arm, layout, "robust"), per_velocity(*term.ZB, layout, "robust.ZB")

    def input_norm(self, added: Drive, pose: float, arm: Array, s: Array) -> float:
        """Largest |x|, for a size of the pose error [m], arm errors (n,), velocity errors (p,) and what they drive."""
        assert self.learner is not None
        inputs, layout = self.learner.own.inputs, Layout.of(self.robot.dimensions)
        row = layout.new_row()
        for name, value in self.signal_bounds(added, pose, arm, s).items():
            row[layout.where(name)] = value
        scale, offset = inputs.numbers(layout)
        return float(np.linalg.norm(np.abs(scale) * row[inputs.rows(layout)] + np.abs(offset)))

    def signal_bounds(self, added: Drive, pose: float, arm: Array, s: Array) -> dict[str, Array]:
        """Largest absolute value of every signal that a network may see."""
        along, reach = self.along, self.pose.reach(pose)
        ref = {name: np.abs(getattr(along, name)).max(axis=0) for name in along.__dataclass_fields__}
        nu = np.abs(along.nu).max(axis=0) + added.nu
        nudot = np.abs(along.nudot).max(axis=0) + np.concatenate((added.nudot, self.K**2 * arm))
        nudot += (np.abs(added.middle) + added.half) @ s
        away = pose / np.sqrt(1 - self.pose.eps)  # |(ex, ey)| at most: the smallest eigenvalue of the metric is 1 - eps
        error = np.array([reach.ex, reach.ey, reach.heading])
        edot = s[2:] + self.K * arm
        return {
            "pose_ref": ref["pose_ref"],
            "velocity_ref": ref["v_ref"],
            "acceleration_ref": ref["a_ref"],
            "q_ref": ref["q_ref"],
            "qdot_ref": ref["qdot_ref"],
            "qddot_ref": ref["qddot_ref"],
            "pose": ref["pose_ref"] + np.array([away, away, reach.heading]),
            "velocity": nu[:2] + s[:2],
            "q": ref["q_ref"] + arm,
            "qdot": ref["qdot_ref"] + edot,
            "alpha": nu[:2],
            "alphadot": nudot[:2],
            "pose_error": error,
            "world_error": np.array([away, away, reach.heading]),
            "z": s[:2],
            "e": arm,
            "edot": edot,
            "r": s[2:],
            "nu_ref": nu,
            "nudot_ref": nudot,
        }

    def disturbed(self, disturbance: Array) -> CertifiedLoop:
        """The same with an external force of at most (p,) [N, N m]."""
        return self.tuned(disturbance=np.asarray(disturbance, float))

    def tuned(self, **changes: Any) -> CertifiedLoop:
        """The same robot along the same reference with some fields changed: covers are not made again."""
        found = replace(self, **changes)
        same = ("robot", "along", "kinematic", "weighs")
        if all(getattr(found, name) is getattr(self, name) for name in same):
            found.__dict__["known"] = self.known
        return found


def certified_loop(subject: Subject) -> CertifiedLoop:
    """The loop of a run.

    Raises:
        RecordingError: The theorem does not speak of it, with the assumption that is not met.
    """
    with subject.recording.using("what it tells of pushes and of its supervisor"):
        why = refusal(subject)
        pushes, supervisor = (push_bound(subject), supervisor_of(subject)) if not why else (np.zeros(0), None)
    if why:
        raise RecordingError("no certificate", why=why, file=subject.recording.path)
    learner, layout = subject.networks, subject.layout
    safety = subject.recording.meta.get("safety") or {}
    along = Along(*(subject.signal(name) for name in SIGNALS))
    return CertifiedLoop(
        robot=subject.robot,
        kinematic=subject.kinematic,
        along=along,
        period=subject.timing.control_period,
        gain=learner.own.feedback.vector(layout) if learner else subject.signal("effective_gain")[0].copy(),
        learner=learner,
        disturbance=pushes,
        projection=safety.get("weights"),
        supervisor=supervisor,
        drift=drift(along.pose_ref, along.v_ref, along.a_ref, subject.timing.control_period),
        late=delay(subject),
        noise=subject.velocity_noise,
        motors=subject.motor_limits,
        weighs=learner is None and not proportional(subject),
    )


def refusal(subject: Subject) -> str:
    """The first assumption of the theorem that a run does not meet; empty if it meets all."""
    asked = (plant_refusal, hardware_refusal, reference_refusal, controller_refusal)
    return next(filter(None, (refused(subject) for refused in asked)), "")


def plant_refusal(subject: Subject) -> str:
    """The first assumption on base and plant that a run does not meet; empty if it meets all."""
    if not subject.robot.base.two_sided:
        kind = f"the base is {subject.robot.base.kind}" if subject.layout.base else "a fixed base has no pose to lose"
        return f"{kind}; the theorem is about Kanayama's law for a differential drive"
    if subject.plant != "ideal":
        return f"on the {subject.plant} plant wheels may slip, and then nu does not move by the reduced model"
    if subject.timing.integrator == "stick":
        return "friction that sticks is an impulse, no force that is bounded"
    return ""


def hardware_refusal(subject: Subject) -> str:
    """The first assumption on sensors, motors and disturbances that a run does not meet; empty if it meets all."""
    if not subject.exact_poses:
        return "it takes the true pose and joint angles at every control sample; these sensors err or are slower"
    if subject.latency.sensing > 0:
        return "its measurements are late; only a delay of the commands is covered: latency.command in its place"
    if subject.rolls_otherwise:
        return "its wheels have other radii than its controller takes"
    if subject.motors_lag:
        return "its motors do not give what they are asked for, by more than a limit of torque"
    if any(event["type"] != "push" for event in subject.recording.meta.get("disturbances", ())):
        return "something else than pushes happens to the robot"
    if subject.recording.outcome.status == "tripped":
        return "its supervisor stopped it"
    return ""


def reference_refusal(subject: Subject) -> str:
    """The first assumption on the reference and the kinematic layer that a run does not meet; empty if it meets all."""
    v_ref, time = subject.signal("velocity_ref"), subject.signal("time")[:, 0]
    if not v_ref[:, 0].min() > SPEED:
        return f"vr falls to {v_ref[:, 0].min():.3g} m/s; without vr >= vmin > 0 nothing pulls ey to 0"
    for name, rate in RATES:
        at = jump(time, subject.signal(name), subject.signal(rate), subject.timing.control_period)
        if np.isfinite(at):
            return f"{name} jumps at t = {at:.4g} s, or {rate} is not its derivative"
    for name in ("kx", "ky", "kth", "K"):
        if not np.all(np.asarray(getattr(subject.kinematic, name)) > 0):
            return f"kinematic.{name} is 0"
    return ""


def controller_refusal(subject: Subject) -> str:
    """The first assumption on the torque controller that a run does not meet; empty if it meets all."""
    learner = subject.networks
    if learner is None:
        if proportional(subject) or weighing(subject):
            return ""
        if "safety" in subject.recording and np.any(subject.recording["safety"] > 0):
            return "its supervisor stepped in"
        return f"{subject.controller} is no learner of the thesis, nor PD, nor PD with the gravity of the robot"
    if learner.context.limits is not None:
        return "its robust term and Psi_hat are kept within the motors' limits"
    if learner.own.update != "after_output":
        return "the weights are updated before the output, with the hidden outputs of the call before"
    return ""


def delay(subject: Subject) -> float:
    """Largest time from a sample to when its command is in force [s], in steps of the plant."""
    step, latency = subject.timing.plant_step, subject.latency
    return round((latency.command + latency.jitter) / step) * step


def drift(pose: Array, velocity: Array, acceleration: Array, period: float) -> tuple[float, float]:
    """Largest speed [m/s] and yaw rate [rad/s] at which poses (N, 3) leave those that velocities (N, 2) lead to."""
    (v, w), (vdot, wdot), (c, s) = velocity.T, acceleration.T, (np.cos(pose[:, 2]), np.sin(pose[:, 2]))
    rate = np.stack([v * c, v * s, w], axis=1)
    change = np.stack([vdot * c - v * w * s, vdot * s + v * w * c, wdot], axis=1)
    off = np.diff(pose, axis=0) / period - mean(rate) + period / 12 * np.diff(change, axis=0)
    return float(np.hypot(off[:, 0], off[:, 1]).max(initial=0.0)), float(np.abs(off[:, 2]).max(initial=0.0))


def jump(time: Array, value: Array, rate: Array, period: float) -> float:
    """When values (N, k) first change by something else than their rates (N, k) say [s]; nan if never."""
    off = np.abs(np.diff(value, axis=0) / period - mean(rate))
    rounding = 1e-14 * np.abs(value).max(axis=0) / period
    fastest = np.maximum(np.abs(rate).max(axis=0), 1e-6 * np.abs(value).max(axis=0))
    result = (off > TOLERANCE * fastest + rounding).any(axis=1)
    return float(time[int(np.argmax(result))]) if result.any() else float("nan")


def mean(rate: Array) -> Array:
    """Of every two samples that follow each other, (N - 1, k)."""
    return (rate[1:] + rate[:-1]) / 2


def push_bound(subject: Subject) -> Array:
    """(p,) largest external force of the run's pushes: steps and sines as given, impulses and noise as they were."""
    names, result = list(subject.robot.velocity_names), np.zeros(subject.layout.dof)
    for event in subject.recording.meta.get("disturbances", ()):
        force = abs(event.get("force", 0.0))
        if event.get("shape", "step") == "impulse":
            force /= subject.timing.plant_step
        elif event.get("shape") == "noise":
            force = float(np.abs(subject.recording["disturbance"][:, names.index(event["on"])]).max())
        result[names.index(event["on"])] += force
    return result


def proportional(subject: Subject) -> bool:
    """Whether the torque of a run is a constant gain times s, and nothing else."""
    gain, tau = subject.signal("effective_gain"), subject.signal("torque")
    s = subject.signal("nu_ref") - np.hstack((subject.signal("velocity"), subject.signal("qdot")))
    scale = np.abs(tau).max() + 1e-300
    constant = bool((gain > 0).all()) and not np.ptp(gain, axis=0).any()
    return constant and bool(np.abs(gain * s - tau).max() <= 1e-9 * scale)


def weighing(subject: Subject) -> bool:
    """Whether the torque of a run is a constant gain times s plus the robot's gravity at the sample."""
    gain, tau, said = (subject.signal(name) for name in ("effective_gain", "torque", "psi_hat"))
    s = subject.signal("nu_ref") - np.hstack((subject.signal("velocity"), subject.signal("qdot")))
    scale, robot = np.abs(tau).max() + 1e-300, subject.robot
    dynamics, position = Dynamics(robot), robot.neutral_position()
    for k in np.unique(np.linspace(0, len(tau) - 1, WEIGHED).astype(int)):
        position[robot.arm_index] = subject.signal("q")[k]
        if np.abs(dynamics.gravity(robot.follow(position)) - said[k]).max() > 1e-9 * scale:
            return False
    constant = bool((gain > 0).all()) and not np.ptp(gain, axis=0).any()
    return constant and bool(np.abs(gain * s + said - tau).max() <= 1e-9 * scale)


@dataclass(frozen=True, eq=False)
class Supervisor:
    """Limits, inf where there is none."""

    torque: Array  # (motors,) of every motor, clipped [N m or N]
    speed: Array  # (p,) of every velocity [m/s, rad/s]
    position: float  # distance of the base from its reference [m]
    heading: float  # heading error [rad]
    joints: Array  # (n,) errors of the arm [rad or m]

    @classmethod
    def of(cls, safety: Safety, robot: Robot, period: float) -> Supervisor:
        """From settings."""
        its = safety.supervisor(robot, period, np.zeros(robot.dimensions.dof), np.zeros(robot.dimensions.arm))
        position, heading = its.numbers.position, its.numbers.heading
        return cls(its.torque, its.speed, position, heading, its.error)


def supervisor_of(subject: Subject) -> Supervisor | None:
    """The supervisor of a run, if there is one."""
    safety = subject.recording.meta.get("safety")
    if not safety:
        return None
    return Supervisor.of(msgspec.convert(safety, Safety), subject.robot, subject.timing.control_period)


@dataclass(frozen=True)
class Condition:
    """A condition of the theorem: `value < limit`, or `value > limit`."""

    name: str  # which
    value: float  # left side
    limit: float  # right side
    words: str  # what it says
    need: str = "below"  # "below" or "above"

    @property
    def holds(self) -> bool:
        """Whether it is met; what is no number is not."""
        return bool(self.value > self.limit if self.need == "above" else self.value < self.limit)


def limits_in(supervisor: Supervisor, bounds: dict[str, Array], torque: Array) -> list[Condition]:
    """What a box may reach of every limit: bounds of `signal_bounds`, torques of motors up to (motors,)."""
    nu = np.concatenate((bounds["velocity"], bounds["qdot"]))
    limits = [
        worst("torque", torque, supervisor.torque, TORQUE),
        worst("speed", nu, supervisor.speed, "largest speed [m/s, rad/s or m/s of a joint]"),
        worst("position", bounds["world_error"][:1], supervisor.position, "largest distance from the reference [m]"),
        worst("heading", bounds["pose_error"][2:], supervisor.heading, "largest heading error [rad]"),
        worst("joint error", bounds["e"], supervisor.joints, "largest error of a joint [rad or m]"),
    ]
    return [limit for limit in limits if limit is not None]


def limits_of_motors(motors: Array, torque: Array) -> list[Condition]:
    """What a box may ask of the motors, torques up to (motors,), beside their limits; empty where there are none."""
    found = worst("torque", torque, motors, TORQUE, "motors")
    return [] if found is None else [found]


def worst(name: str, values: Array, limits: Array | float, words: str, whose: str = "supervisor") -> Condition | None:
    """The value that comes nearest to its limit or passes it furthest; None where there is no limit."""
    limits = np.broadcast_to(limits, values.shape)
    if not np.isfinite(limits).any():
        return None
    k = int(np.argmax(values / limits))
    return Condition(
        f"{whose}, {name}", float(values[k]), float(limits[k]), f"{words}, within the limit of its {whose}"
    )
