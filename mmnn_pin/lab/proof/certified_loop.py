"""The loop that a certificate speaks of, from a recording: robot, gains, reference, learner; or why there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ...errors import RecordingError
from ...kinematic import Kinematic
from ...model.base import BY_SIZE
from ...model.base.differential import DifferentialDrive
from ...model.robot import Robot
from ...signals import Array
from ...torque.controller import per_velocity
from .learner import Networks
from .motion_samples import Along, MotionSamples, sample
from .moving_reference import drift, jump
from .pose_bound import PoseBound
from .subject import Subject
from .supervised import Supervisor, supervisor_of

SPREAD = 0.5  # [rad or m]: arm errors beyond this are not looked at
SIGNALS = ("velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref", "pose_ref")
RATES = (("velocity_ref", "acceleration_ref"), ("q_ref", "qdot_ref"), ("qdot_ref", "qddot_ref"))
SPEED = 1e-6  # [m/s] below which the reference counts as standing


@dataclass(frozen=True, eq=False)
class CertifiedLoop:
    """A differential drive with an arm that follows a reference that never stands still, sampled.

    Args:
        robot: The true robot.
        kinematic: Gains of the kinematic layer; kx, ky, kth, K > 0.
        along: The reference at every control sample.
        period: Control period [s], in which the torque is held.
        gain: (p,) constant gain on s: k [N s/m, N m s].
        learner: Networks and robust term; None for PD.
        disturbance: (p,) largest external force on nu [N, N m].
        projection: Largest norm that a supervisor scales the weights back to, None without.
        supervisor: Limits that the loop must not pass; None without.
        drift: Speed [m/s] and yaw rate [rad/s] at which the reference's poses leave its velocities, at most.
        spread: (n,) largest arm error looked at [rad or m].
    """

    robot: Robot
    kinematic: Kinematic
    along: Along
    period: float
    gain: Array
    learner: Networks | None
    disturbance: Array
    projection: float | None = None
    supervisor: Supervisor | None = None
    drift: tuple[float, float] = (0.0, 0.0)
    spread: Array | None = None

    @cached_property
    def pose(self) -> PoseBound:
        """The Lyapunov function of the pose."""
        return PoseBound.of(self.kinematic, self.along.v_ref)

    @cached_property
    def K(self) -> Array:
        """(n,) gain of the filtered arm error [1/s]."""
        return self.kinematic.arm_gains(self.robot.layout)

    @cached_property
    def samples(self) -> MotionSamples:
        """The robot along the reference; the arm's metric is the one whose errors a given energy drives less far."""
        n = self.robot.layout.arm
        found = sample(self.robot, self.along, np.full(n, SPREAD) if self.spread is None else self.spread)
        if n == 0 or not np.ptp(self.K):
            return found
        return max((found, replace(found, decoupled=True)), key=lambda one: one.arm_decay(self.K) / one.arm_gain)

    @cached_property
    def arm_decay(self) -> float:
        """Rate at which the size of the arm errors decays for r = 0 [1/s]; see `MotionSamples.arm_decay`."""
        return self.samples.arm_decay(self.K)

    @cached_property
    def robust(self) -> tuple[Array, Array]:
        """Kz and ZB of the robust term, (p,) each; zeros without one."""
        layout, term = self.robot.layout, self.learner.own.robust if self.learner else None
        if term is None:
            return np.zeros(layout.dof), np.zeros(layout.dof)
        return per_velocity(term.base, term.arm, layout, "robust"), per_velocity(*term.ZB, layout, "robust.ZB")

    def disturbed(self, disturbance: Array) -> CertifiedLoop:
        """The same with an external force of at most (p,) [N, N m]."""
        return replace(self, disturbance=np.asarray(disturbance, float))


def certified_loop(subject: Subject) -> CertifiedLoop:
    """The loop of a run.

    Raises:
        RecordingError: The theorem does not speak of it, with the assumption that is not met.
    """
    why = refusal(subject)
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
        disturbance=push_bound(subject),
        projection=safety.get("weights"),
        supervisor=supervisor_of(subject),
        drift=drift(along.pose_ref, along.v_ref, along.a_ref, subject.timing.control_period),
    )


def refusal(subject: Subject) -> str:
    """The first assumption of the theorem that a run does not meet; empty if it meets all."""
    meta, layout, timing = subject.recording.meta, subject.layout, subject.timing
    if (kind_of_base := BY_SIZE[layout.base]) is not DifferentialDrive:
        kind = f"the base is {kind_of_base.kind}" if layout.base else "a fixed base has no pose to lose"
        return f"{kind}; the theorem is about Kanayama's law for a differential drive"
    if subject.plant != "ideal":
        return f"on the {subject.plant} plant wheels may slip, and then nu does not move by the reduced model"
    if timing.integrator == "stick":
        return "friction that sticks is an impulse, no force that is bounded"
    if not subject.exact_sensors:
        return "it takes the true state at every control sample; these sensors err or are slower"
    if meta.get("actuator"):
        return "its motors do not give what they are asked for"
    if any(event["type"] != "push" for event in meta.get("disturbances", ())):
        return "something else than pushes happens to the robot"
    if subject.recording.outcome.status == "tripped":
        return "its supervisor stopped it"
    v_ref, k = subject.signal("velocity_ref"), subject.kinematic
    if not v_ref[:, 0].min() > SPEED:
        return f"vr falls to {v_ref[:, 0].min():.3g} m/s; without vr >= vmin > 0 nothing pulls ey to 0"
    for name, rate in RATES:
        at = jump(subject.signal("time")[:, 0], subject.signal(name), subject.signal(rate), timing.control_period)
        if np.isfinite(at):
            return f"{name} jumps at t = {at:.4g} s, or {rate} is not its derivative"
    for name in ("kx", "ky", "kth", "K"):
        if not np.all(np.asarray(getattr(k, name)) > 0):
            return f"kinematic.{name} is 0"
    learner = subject.networks
    if learner is None:
        if proportional(subject):
            return ""
        clipped = "safety" in subject.recording and np.any(subject.recording["safety"] > 0)
        return "its supervisor stepped in" if clipped else f"{subject.controller} is no learner of the thesis, nor PD"
    if learner.context.limits is not None:
        return "its robust term and Psi_hat are kept within the motors' limits"
    if learner.own.update != "after_output":
        return "the weights are updated before the output, with the hidden outputs of the call before"
    return ""


def push_bound(subject: Subject) -> Array:
    """(p,) largest external force of the run's pushes: steps and sines as given, impulses and noise as they were."""
    names, found = list(subject.robot.velocity_names), np.zeros(subject.layout.dof)
    for event in subject.recording.meta.get("disturbances", ()):
        force = abs(event.get("force", 0.0))
        if event.get("shape", "step") == "impulse":
            force /= subject.timing.plant_step
        elif event.get("shape") == "noise":
            force = float(np.abs(subject.recording["disturbance"][:, names.index(event["on"])]).max())
        found[names.index(event["on"])] += force
    return found


def proportional(subject: Subject) -> bool:
    """Whether the torque of a run is a constant gain times s, and nothing else."""
    gain, tau = subject.signal("effective_gain"), subject.signal("torque")
    s = subject.signal("nu_ref") - np.hstack((subject.signal("velocity"), subject.signal("qdot")))
    scale = np.abs(tau).max() + 1e-300
    constant = bool((gain > 0).all()) and not np.ptp(gain, axis=0).any()
    return constant and bool(np.abs(gain * s - tau).max() <= 1e-9 * scale)
