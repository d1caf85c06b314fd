"""A run beside its certificate: what is guaranteed, what the run did, its learning rates, the thesis's own bounds.

The thesis's bounds (3.44)-(3.65) are given as printed, in numbers; they are not proved (docs/explanation/theory.md,
section 7). Per network, with the error that drives it of gain k (its smallest), |Z*| <= ZB, |x| <= qB + c2 |s|:

    C0 = eps_N + dB + sqrt(h) ZB        C1 = sqrt(2)/4 ZB qB        C2 = sqrt(2)/4 ZB c2
    C6 = ZB + C1/kappa      b = (C0 + kappa C6^2/4)/k      bZ = C6/2 + sqrt(C0/kappa + C6^2/4)      Kz > C2

The thesis leaves c0, c2, qB and dB open. Here c0 = 0, dB is the external force of the run, c2 is how strongly x follows
s (by itself and through alphadot), and qB the largest |x| - c2 |s| along the run. eps_N and |Z*| are those of the ideal
weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mmnn_pin.disturbance.settings import MOST
from mmnn_pin.errors import ConfigError, InputError, UnknownName
from mmnn_pin.lab.psi.judgement import sentence
from mmnn_pin.lab.psi.learner import NAMES, NetworkLearner, seen
from mmnn_pin.lab.psi.psi import WINDOWS
from mmnn_pin.lab.psi.rate import Rate, rate_of
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.recording.recording import Recording
from mmnn_pin.settings import finite
from mmnn_pin.settings.arguments import checked
from mmnn_pin.shown import AsText, shown
from mmnn_pin.signals import Array
from mmnn_pin.torque.neural import Robust

from .balance import BUDGET
from .boxes import BoolArray, Box
from .certificate import Certificate, certify
from .certified_loop import CertifiedLoop, certified_loop, push_bound
from .lyapunov import motion_energy
from .networks import Ideal
from .proof import Proof
from .tube import Tube, tube_of


@dataclass(frozen=True, eq=False)
class CertifiedRun:
    """What is known of one run."""

    certificate: Certificate | None  # what is guaranteed; None where the theorem does not apply
    comparison: Comparison | None  # the run against it
    rate: Rate | None  # the condition on the learning rates; None without a learner
    thesis_bounds: dict[int, ThesisBounds]  # the thesis's own bounds by network; empty where there are none
    missing: dict[str, str]  # what is left out, and why
    # what bounds the errors along the reference; None where it was not asked for or does not apply
    tube: Tube | None = None

    @property
    def holds(self) -> bool:
        """False only where a run left a region that is certified, or its tube."""
        run = self.comparison
        if self.tube is not None and not self.tube.covers:
            return False
        return self.certificate is None or run is None or not (self.certificate.holds and run.covered) or run.stays

    def to_dict(self) -> dict[str, Any]:
        """Whether it applies and holds, conditions, constants, region, bound, the run, rates, printed bounds."""
        certificate, run = self.certificate, self.comparison
        result: dict[str, Any] = {"applies": certificate is not None, "why_not": self.missing.get("certificate")}
        if certificate is not None:
            shown = run is not None and certificate.holds
            result |= certificate.to_dict() | {"run": run.to_dict() if run is not None and shown else None}
        printed = {NAMES[i]: one.to_dict() for i, one in self.thesis_bounds.items()}
        if self.tube is not None or "tube" in self.missing:
            result["tube"] = self.missing.get("tube") if self.tube is None else self.tube.to_dict()
        return result | {"rate": None if self.rate is None else self.rate.to_dict(), "printed": printed or None}


@dataclass(frozen=True, repr=False)
class Proved(AsText):
    """One run judged: what it proves, and what is certified of its loop; `print` shows both."""

    # Psi_hat against the truth, the Lyapunov function, the balance of energy; parts that a run does not have raise an
    # `InputError` when they are asked for, and `proof.missing` says why
    proof: Proof
    certificate: CertifiedRun  # what is guaranteed, and the run beside it

    @property
    def holds(self) -> bool:
        """Whether the balance holds and the run stays in the region that is certified."""
        return self.proof.holds and self.certificate.holds

    def to_dict(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        return self.proof.to_dict() | {"certificate": self.certificate.to_dict()}

    def __repr__(self) -> str:
        return f"<Proved: {self.proof.subject.controller}, {'holds' if self.holds else 'VIOLATED'}>"

    def __str__(self) -> str:
        return f"{self.proof}\n{shown(self.certificate, 'text')}"


@checked
def prove(
    recording: Recording,
    *,
    payload: float | None = None,
    windows: int = WINDOWS,
    budget: float = BUDGET,
    region: Mapping[str, float] | None = None,
    disturbance: Mapping[str, float] | None = None,
    tube: bool = False,
    progress: Callable[[str, float], None] | None = None,
) -> Proved:
    """Judge one recorded run: did it learn Psi, does its Lyapunov function fall, what is certified of its loop?

    Args:
        recording: The run.
        payload: Load of the changed robot on which frozen weights are tried [kg]; None for a usual one.
        windows: Number of windows of the online FVU.
        budget: Evaluations of the dynamics that the balance may take; inf looks at every control period.
        region: As of `certified_run`.
        disturbance: As of `certified_run`.
        tube: As of `certified_run`.
        progress: Called with what is being done and the fraction done.

    Raises:
        InputError: The recording does not hold what there is to judge, with every reason; or as of `certified_run`.

    >>> robot = load("platform_arm")
    >>> path = Trajectory.of(robot, base=Line(speed=0.3), arm={"arm_1_joint": Sine(0.5, period=4.0)})
    >>> run = Loop(robot, path, PD(), timing=Timing(duration=0.4)).run()
    >>> prove(run).holds
    True
    """
    proof = Proof(recording, payload=payload, windows=windows, budget=budget, progress=progress)
    if proof.subject.robot.rolling is not None:
        what, why = f"the base of '{proof.subject.robot.name}' steers", "its T(theta) is outside of what is certified"
        raise InputError(
            what, why=why, fix="mmnn judge says what it learned, mmnn docs explanation/steered-bases what holds"
        )
    proof.require_any()
    return Proved(proof, certified_run(proof, region, disturbance, tube))


def certified_run(
    proof: Proof,
    region: Mapping[str, float] | None = None,
    disturbance: Mapping[str, float] | None = None,
    tube: bool = False,
) -> CertifiedRun:
    """Everything that can be said of a run; what cannot is None, and `missing` says why.

    Args:
        proof: The run.
        region: Sizes `pose` [m], `arm` and `energy` [J] of the region to certify; None for the largest that is found.
        disturbance: Largest external force by velocity [N, N m], beside the pushes of the run.
        tube: Whether to look for a tube along the reference, which takes seconds.

    Raises:
        UnknownName: A size or a velocity that does not exist.
        ConfigError: A size that is missing or not positive, or a force that is negative or too large.
    """
    subject, missing = proof.subject, {}
    wanted, force = box_of(region, subject.layout.arm), forces(disturbance, subject.robot.velocity_names)
    certificate = run = rate = found = None
    bounds: dict[int, ThesisBounds] = {}
    try:
        loop = certified_loop(subject)
        loop = loop.disturbed(loop.disturbance + force)
        sizes = sizes_of(subject, loop)
        certificate = certify(loop, wanted, sizes.start)
        run = compare(subject, certificate, sizes)
    except InputError as error:
        missing["certificate"] = sentence(error)
    try:
        rate = rate_of(subject)
        if proof.has("ideal") and subject.networks is not None and isinstance(proof.ideal, dict):
            bounds = thesis_bounds(subject, subject.networks, proof.ideal, push_bound(subject) + force)
    except InputError as error:
        missing["rate"] = sentence(error)
    if tube:
        try:
            found = tube_of(subject, force, proof.progress_of("tube"))
        except InputError as error:
            missing["tube"] = sentence(error)
    return CertifiedRun(certificate, run, rate, bounds, missing, found)


def box_of(region: Mapping[str, float] | None, joints: int) -> Box | None:
    """The box that was asked for; errors as in `certified_run`."""
    if not region:
        return None
    needed = ("pose", "arm", "energy") if joints else ("pose", "energy")
    for name, size in region.items():
        if name not in needed:
            raise UnknownName("size of a region", name, needed, key="region")
        if not (np.isfinite(size) and size > 0):
            raise ConfigError(f"{name} = {size}", fix="use a finite number > 0", key="region")
    if missing := [name for name in needed if name not in region]:
        raise ConfigError(f"no {' and no '.join(missing)}", fix=f"give {', '.join(needed)}", key="region")
    return Box(region["pose"], region.get("arm", 0.0), region["energy"])


def forces(disturbance: Mapping[str, float] | None, names: Sequence[str]) -> Array:
    """(p,) forces by the names of their velocities; errors as in `certified_run`."""
    result = np.zeros(len(names))
    for name, force in (disturbance or {}).items():
        if name not in names:
            raise UnknownName("velocity", name, names, key="disturbance")
        if not 0 <= force <= MOST:
            raise ConfigError(f"{name} = {force}", fix=f"use a number from 0 to {MOST:.0e}", key="disturbance")
        result[list(names).index(name)] = force
    return result


@dataclass(frozen=True, eq=False)
class Comparison:
    """A run against its certificate."""

    starts: bool  # whether it starts in the region
    enters: float  # when it is first inside of the region [s]; nan if never
    stays: bool  # whether it never leaves the region once inside; where it is `covered`, False is a violation
    # whether its recorded weights keep within their bounds: a run that starts outside of the region may carry larger
    # ones into it, and then nothing is guaranteed
    covered: bool
    settles: float  # when it is inside of the bound for good [s]; nan if never (the run may have been too short)
    largest: Box  # largest errors once inside of the region
    last: Box  # largest errors over the last half of the run
    weights: dict[int, tuple[float, float]]  # network to largest norm of W and V that were recorded

    def to_dict(self) -> dict[str, Any]:
        """Where the run was, for JSON."""
        return {
            "starts_inside": self.starts,
            "enters": finite(self.enters),
            "stays": self.stays,
            "covered": self.covered,
            "settles": finite(self.settles),
            "largest": asdict(self.largest),
            "last_half": asdict(self.last),
            "weights": {NAMES[i]: {"W": W, "V": V} for i, (W, V) in self.weights.items()},
        }


def compare(subject: Subject, certificate: Certificate, sizes: Sizes) -> Comparison:
    """Where a run was, beside what is certified."""
    inside, settled = sizes.inside(certificate.region.box), sizes.inside(certificate.bound.box)
    first = int(np.argmax(inside)) if inside.any() else len(inside)
    out = np.flatnonzero(~settled)
    after = 0 if not len(out) else int(out[-1]) + 1
    nan, times, half = float("nan"), sizes.time, len(sizes.time) // 2
    names = ("pose", "arm", "energy")
    largest = [float(getattr(sizes, name)[first:].max(initial=0.0)) for name in names]
    last = [float(getattr(sizes, name)[half:].max()) for name in names]
    weights = subject.recording.weights
    networks = certificate.boxes.networks
    result = {i: (largest_norm(weights.get(f"W{i}")), largest_norm(weights.get(f"V{i}"))) for i in networks}
    return Comparison(
        starts=bool(inside[0]),
        enters=float(times[first]) if first < len(times) else nan,
        stays=bool(inside[first:].all()),
        covered=all(
            W <= (1 + 1e-9) * networks[i].W and (V <= (1 + 1e-9) * networks[i].V or not networks[i].V)
            for i, (W, V) in result.items()
        ),
        settles=float(times[after]) if after < len(times) else nan,
        largest=Box(*largest),
        last=Box(*last),
        weights=result,
    )


@dataclass(frozen=True, eq=False)
class Sizes:
    """The errors of a run as boxes measure them, (N,) each.

    Attributes:
        time: [s].
        pose: Size of the pose error [m].
        arm: Size of the arm errors.
        energy: s' M s / 2 [J].
    """

    time: Array
    pose: Array
    arm: Array
    energy: Array

    @property
    def start(self) -> Box:
        """The smallest box around the first sample."""
        return Box(float(self.pose[0]), float(self.arm[0]), float(self.energy[0]))

    def inside(self, box: Box) -> BoolArray:
        """Which samples are in a box, (N,) bool."""
        return box.holds(self.pose, self.arm, self.energy)


def sizes_of(subject: Subject, loop: CertifiedLoop) -> Sizes:
    """The sizes along a run."""
    rows, where = subject.truth(subject.rows), subject.layout.where
    e = rows[:, where("e")]
    arm = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", e, loop.metric.N, e), 0.0))
    pose = loop.pose.size(rows[:, where("pose_error")])
    return Sizes(subject.signal("time")[:, 0], pose, arm, motion_energy(subject, rows))


def largest_norm(snapshots: Array | None) -> float:
    """Largest norm of weights (k, ...) that were recorded; 0 without any."""
    return 0.0 if snapshots is None else float(np.sqrt((snapshots**2).sum(axis=(1, 2))).max(initial=0.0))


@dataclass(frozen=True)
class ThesisBounds:
    """One network's bounds as printed."""

    C: tuple[float, float, float, float]  # c0, C1, C2, C6 of the base or C3, C4, C5, C7 of the arm
    error: float  # ultimate bound printed for |z| or |r|, (3.59) or (3.62)
    weights: float  # ultimate bound printed for |Ztilde|, (3.60) or (3.63)
    half_width: float  # where the two braces together may stop V from falling: half-width in |z| or |r| (gap a)
    robust: float  # smallest Kz of the run, which (3.51) or (3.52) wants above C2 or C5
    largest: float  # largest |z| or |r| over the last half of the run

    @property
    def gain_holds(self) -> bool:
        """(3.51) or (3.52)."""
        return self.robust > self.C[2]

    def to_dict(self) -> dict[str, Any]:
        """The bounds for JSON."""
        return {
            "C": list(self.C),
            "error": self.error,
            "weights": self.weights,
            "half_width": self.half_width,
            "Kz": self.robust,
            "Kz_above_C2": self.gain_holds,
            "reached": self.largest,
            "proved": False,
        }


def thesis_bounds(
    subject: Subject, learner: NetworkLearner, ideal: dict[int, Ideal], force: Array
) -> dict[int, ThesisBounds]:
    """The printed bounds of every network (1 the base's, 2 the arm's); empty where kappa is 0; force (p,) is d."""
    controller, h = learner.own, learner.own.network.hidden
    x = np.linalg.norm(seen(learner, learner.start, subject.rows).inputs, axis=1)
    gain, parts = controller.feedback.vector(subject.layout), dict(learner.networks)
    s = {i: np.linalg.norm(subject.signal("z" if i == 1 else "r"), axis=1) for i in parts}
    numbers: dict[int, tuple[tuple[float, float, float, float], float, float]] = {}
    for i, part in parts.items():
        _, _, kappa = controller.network.rates(i - 1, controller.leakage)
        if not kappa > 0:
            return {}
        ZB, c2 = ideal[i].norm, follows(subject, learner, i)
        qB = float((x - c2 * s[i]).max())
        C0 = ideal[i].eps_N + float(np.linalg.norm(force[part])) + math.sqrt(h) * ZB
        C1, C2 = math.sqrt(2) / 4 * ZB * max(qB, 0.0), math.sqrt(2) / 4 * ZB * c2
        C6 = ZB + C1 / kappa
        numbers[i] = (C0, C1, C2, C6), C0 + kappa * C6**2 / 4, C6 / 2 + math.sqrt(C0 / kappa + C6**2 / 4)
    result = {}
    for i, part in parts.items():
        C, D, bZ = numbers[i]
        k, other = float(gain[part].min()), next((j for j in parts if j != i), None)
        rest = numbers[other][1] ** 2 / (4 * k * gain[parts[other]].min()) if other else 0.0
        half = D / (2 * k) + math.sqrt(D**2 / (4 * k**2) + rest)
        term = controller.robust or Robust(0.0, 0.0)
        robust = term.base if i == 1 else term.arm
        result[i] = ThesisBounds(C, D / k, bZ, half, float(np.min(robust)), float(s[i][len(s[i]) // 2 :].max()))
    return result


def follows(subject: Subject, learner: NetworkLearner, i: int) -> float:
    """c2 of the base's or c10 of the arm's network: largest factor from z, or r, to the input that depends on it."""
    signals, scale, k = learner.own.inputs.signals, learner.own.inputs.scale, subject.kinematic
    K = k.arm_gains(subject.layout)
    if i == 1:
        v = float(np.abs(subject.signal("velocity_ref")).max(initial=0.0))
        Az = subject.robot.base.largest_gain(k.base_gains(subject.layout), v)
    else:
        Az = float(K.max())
    base = {"z": 1.0, "velocity": 1.0, "alphadot": Az, "nudot_ref": Az}
    own = base if i == 1 else {"r": 1.0, "edot": 1.0, "qdot": 1.0, "nudot_ref": Az}
    return scale * math.sqrt(sum(own.get(name, 0.0) ** 2 for name in signals))
