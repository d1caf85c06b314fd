"""The numbers of a proof and of a certificate, as JSON has them; null where there is none or it is infinite."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from ....signals import Array
from ...proof.balance import TOLERANCE, Balance
from ...proof.certificate import Faces
from ...proof.certified_run import CertifiedRun, Comparison, ThesisBounds
from ...proof.features import Network
from ...proof.ideal import Ideal, LinearFit
from ...proof.learner import NAMES
from ...proof.lyapunov import Growth, Lyapunov
from ...proof.proof import Proof
from ...proof.psi import Psi, worst
from ...proof.rate import Rate
from ...proof.truth import Truth


def to_dict(proof: Proof) -> dict[str, Any]:
    """Everything that `mmnn prove` tells; a part that cannot be had is null, and `remarks` say why."""
    subject = proof.subject
    recording = subject.recording
    return {
        "run": str(recording.path) if recording.path else None,
        "controller": subject.controller,
        "robot": subject.robot.name,
        "outcome": recording.outcome.status,
        "psi": psi_dict(proof.psi) if proof.has("psi") else None,
        "ideal": ideal_of(proof.ideal) if proof.has("ideal") else None,
        "lyapunov": lyapunov_dict(proof.lyapunov, proof.growth) if proof.has("lyapunov") else None,
        "equality": balance_dict(proof.balance) if proof.has("balance") else None,
        "holds": proof.holds,
        "remarks": proof.remarks(),
    }


def psi_dict(psi: Psi) -> dict[str, Any]:
    """FVU online and frozen per component with the worst of base and arm, shares of the torque, the networks."""

    def each(values: Array) -> dict[str, float | None]:
        return {label: number(value) for label, value in zip(psi.labels, values, strict=True)}

    def judged(values: Array) -> dict[str, Any]:
        return {"components": each(values)} | {part: number(worst(values[where])) for part, where in psi.halves.items()}

    windows = [
        {"from": number(a), "to": number(b), **judged(row), "of_run_variance": each(error)}
        for a, b, row, error in zip(psi.edges[:-1], psi.edges[1:], psi.windows, psi.errors, strict=True)
    ]
    return {
        "online": judged(psi.online),
        "windows": windows,
        "frozen": {name: {"about": frozen.about, **judged(frozen.fvu)} for name, frozen in psi.frozen.items()},
        "weights_time": number(psi.weights_time),
        "torque_share": {part: each(values) for part, values in psi.shares.items()},
        "torque_rms_ratio": {part: each(values) for part, values in psi.sizes.items()},
        "networks": {network.name: network_dict(network) for network in psi.networks},
    }


def network_dict(network: Network) -> dict[str, Any]:
    """Ranks and excitation of a network."""
    result = network.excitation
    return {
        "effective_rank": {**network.ranks, network.what: result.rank},
        "numerical_rank": network.numerical,
        "units": result.units,
        "gram_smallest": number(result.smallest),
        "gram_largest": number(result.largest),
        "excited_directions": result.directions,
        "undetermined": None if network.unknown is None else number(network.unknown.share),
        "acting_units": network.unknown.acting if network.unknown is not None and network.unknown.units else None,
    }


def ideal_of(ideal: dict[int, Ideal] | Truth | LinearFit) -> dict[str, Any]:
    """Ideal weights by network; true parameters and the estimate's distance from them; best fixed weights."""
    if isinstance(ideal, LinearFit):
        ends = {"start": number(ideal.distance[0]), "end": number(ideal.distance[1])}
        eps, left = ([number(value) for value in values] for values in (ideal.eps, ideal.unexplained))
        return {"linear": {"norm": number(ideal.norm), "distance": ends, "eps": eps, "fvu": left}}
    if not isinstance(ideal, Truth):
        return {NAMES[i]: ideal_dict(weights) for i, weights in ideal.items()}
    parts = {name: {"start": number(v[0]), "end": number(v[1])} for name, v in ideal.parts.items()}
    eps = [number(value) for value in ideal.eps]
    return {"parameters": {"theta": ideal.theta.tolist(), "known": ideal.known, "eps": eps, "distance": parts}}


def ideal_dict(ideal: Ideal) -> dict[str, Any]:
    """Norms and errors of a network's ideal weights."""
    return {
        "norm": number(ideal.norm),
        "learned_norm": number(ideal.learned_norm),
        "Z_tilde_start": number(ideal.start_distance),
        "Z_tilde_end": number(ideal.distance),
        "W_tilde_end": number(ideal.distance_W),
        "V_tilde_end": number(ideal.distance_V),
        "ZB": number(ideal.assumed),
        "eps": [number(value) for value in ideal.eps],
        "eps_N": number(ideal.eps_N),
        "fvu": [number(value) for value in ideal.unexplained],
    }


def lyapunov_dict(v: Lyapunov, growth: Growth) -> dict[str, Any]:
    """V at start and end with its parts, what each term adds, when and why it grows."""
    ends = {"start": 0, "end": -1}
    return {
        "V": {name: number(v.total[k]) for name, k in ends.items()},
        "parts": {
            part: {name: number(getattr(v, part)[k]) for name, k in ends.items()}
            for part in ("pose", "motion", "weights")
        },
        "terms": {name: number(value) for name, value in growth.work.items()},
        "growing_share": number(growth.samples),
        "rise": number(growth.rise),
        "fall": number(growth.fall),
        "largest_where_growing": growth.why,
        "spans": [{"from": s.start, "to": s.end, "rise": number(s.rise), "term": s.why} for s in growth.spans],
    }


def balance_dict(result: Balance) -> dict[str, Any]:
    """Worst relative errors of the equality."""
    return {
        "model": number(result.identity),
        "steps": number(result.steps),
        "recorded": number(result.recorded),
        "tolerance": TOLERANCE,
        "periods": len(result.time),
        "of": result.periods,
        "holds": result.holds,
    }


def number(value: float) -> float | None:
    """Number for JSON; nothing where there is none."""
    return float(value) if np.isfinite(value) else None


def certificate_dict(run: CertifiedRun) -> dict[str, Any]:
    """Whether it applies and holds, conditions, constants, region, bound, the run, rates, printed bounds."""
    result: dict[str, Any] = {"applies": run.certificate is not None, "why_not": run.missing.get("certificate")}
    if run.certificate is not None:
        certificate = run.certificate
        conditions = (asdict(c) | {"limit": number(c.limit), "value": number(c.value)} for c in certificate.conditions)
        result |= {
            "holds": certificate.holds,
            "region_asked_for": certificate.asked,
            "conditions": [c | {"holds": one.holds} for c, one in zip(conditions, certificate.conditions, strict=True)],
            "constants": [asdict(c) | {"value": number(c.value)} for c in certificate.constants],
            "region": faces_dict(certificate.region, certificate) if certificate.holds else None,
            "bound": faces_dict(certificate.bound, certificate) if certificate.holds else None,
            "run": None if run.comparison is None or not certificate.holds else comparison_dict(run.comparison),
        }
    result["rate"] = None if run.rate is None else rate_dict(run.rate)
    result["printed"] = {NAMES[i]: thesis_dict(one) for i, one in run.thesis_bounds.items()} or None
    return result


def faces_dict(faces: Faces, certificate: Any) -> dict[str, Any]:
    """A box in the units of its errors."""
    names = certificate.boxes.loop.robot.velocity_names
    return {
        "pose_size": faces.box.pose,
        "arm_size": faces.box.arm,
        "energy": faces.box.energy,
        "ex": faces.reach.ex,
        "ey": faces.reach.ey,
        "ephi": faces.reach.heading,
        "e": {name: float(value) for name, value in zip(names[2:], faces.joints, strict=True)},
        "s": {name: float(value) for name, value in zip(names, faces.velocity, strict=True)},
    }


def comparison_dict(run: Comparison) -> dict[str, Any]:
    """Where the run was."""
    return {
        "starts_inside": run.starts,
        "enters": number(run.enters),
        "stays": run.stays,
        "covered": run.covered,
        "settles": number(run.settles),
        "largest": asdict(run.largest),
        "last_half": asdict(run.last),
        "weights": {NAMES[i]: {"W": W, "V": V} for i, (W, V) in run.weights.items()},
    }


def rate_dict(rate: Rate) -> dict[str, Any]:
    """The condition on the rates, the worst over the run."""
    return {
        "stable": rate.stable,
        "spectral_radius": number(rate.radius.max()),
        "without_learner": number(rate.without.max()),
        "share_of_gain": [number(value) for value in rate.share.max(axis=0)],
        "factor_left": number(rate.limit.min()),
        "leak_per_sample": [number(value) for value in rate.leak],
    }


def thesis_dict(one: ThesisBounds) -> dict[str, Any]:
    """The thesis's bounds of one network."""
    return {
        "C": list(one.C),
        "error": one.error,
        "weights": one.weights,
        "half_width": one.half_width,
        "Kz": one.robust,
        "Kz_above_C2": one.gain_holds,
        "reached": one.largest,
        "proved": False,
    }
