"""The numbers of a certificate, as JSON has them; where there is none, or it is infinite, stands null."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ...proof.boxes import Faces
from ...proof.certified_run import CertifiedRun
from ...proof.learner import NAMES
from ...proof.printed import Printed
from ...proof.rate import Rate
from ...proof.reached import Reached
from .numbers import number


def certificate_dict(told: CertifiedRun) -> dict[str, Any]:
    """Whether it applies and holds, conditions, constants, region, bound, the run, rates, printed bounds."""
    found: dict[str, Any] = {"applies": told.certificate is not None, "why_not": told.missing.get("certificate")}
    if told.certificate is not None:
        certificate = told.certificate
        conditions = (asdict(c) | {"limit": number(c.limit), "value": number(c.value)} for c in certificate.conditions)
        found |= {
            "holds": certificate.holds,
            "region_asked_for": certificate.asked,
            "conditions": [c | {"holds": one.holds} for c, one in zip(conditions, certificate.conditions, strict=True)],
            "constants": [asdict(c) | {"value": number(c.value)} for c in certificate.constants],
            "region": faces_dict(certificate.region, certificate) if certificate.holds else None,
            "bound": faces_dict(certificate.bound, certificate) if certificate.holds else None,
            "run": None if told.reached is None or not certificate.holds else reached_dict(told.reached),
        }
    found["rate"] = None if told.rate is None else rate_dict(told.rate)
    found["printed"] = {NAMES[i]: printed_dict(one) for i, one in told.printed.items()} or None
    return found


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


def reached_dict(run: Reached) -> dict[str, Any]:
    """What the run reached."""
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


def printed_dict(one: Printed) -> dict[str, Any]:
    """The thesis's bounds of one network."""
    return {
        "C": list(one.C),
        "error": one.error,
        "weights": one.weights,
        "half_width": one.half_width,
        "Kz": one.robust,
        "Kz_above_C2": one.gain_holds,
        "reached": one.reached,
        "proved": False,
    }
