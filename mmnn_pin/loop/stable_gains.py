"""Refuses gains that make the sampled loop unstable, with numbers that hold (`loop.sampled` judges them)."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import msgspec
import numpy as np

from ..compiled import one_thread
from ..errors import ConfigError, Values
from ..kinematic import by_name
from ..settings import Numbers
from ..signals import Array
from .plan import Plan
from .sampled import SampledLoop, delay_margin, gains_of, judges, slowest, verdicts
from .servo_model import servos_on

SHARES = np.geomspace(1.0, 0.01, 25)  # of the gains that are tried
ROOM = 1.5  # times the gains that are advised, the loop holds, too
LEAST = 0.2  # of that share, where gains are too low
CHANGE = "change"  # gains that are too low for others
FASTER = (2.0, 4.0, 8.0, 16.0, 32.0)  # times the bandwidth of simulated servos


class Cure(NamedTuple):
    """Gains that hold: what to do with those that were given, and to which values."""

    word: str
    values: Values


@one_thread
def require_stable_gains(plan: Plan) -> None:
    """Judge the sampled PD loop at ten places along the setpoints, and with the latency of the plan.

    Raises:
        ConfigError: It is unstable at one of them, with the numbers and the largest gain that stands, or what cures the
            servo rows.
    """
    if not judges(plan):
        return
    h, found = slowest(plan), list(verdicts(plan))
    for verdict in found:
        if not verdict.stable:
            what = f"the sampled loop is unstable: spectral radius {verdict.radius:.7g} > 1, commands held for {h:g} s"
            require_servo_rows(plan, what)
            cure = cured(plan, np.min([each.gain_limits for each in found], axis=0))
            if cure is None and (delay := known_delay(plan)) > 0.0:
                what = f"the loop does not bear a latency of {1e3 * delay:g} ms"
                why = f"no gains were found that do (spectral radius {verdict.radius:.7g} > 1)"
                raise ConfigError(what, why=why, fix="shorten the latency", key="latency")
            require_stable(verdict, gains_of(plan), plan.robot.velocity_names, h, cure)
    if known_delay(plan) > 0.0:
        require_margin(plan)


def require_stable(
    verdict: SampledLoop, gains: Array, names: tuple[str, ...], h: float, cure: Cure | None = None
) -> None:
    """Refuse gains that make the sampled PD loop unstable; `cure` says which do not (`ConfigError`)."""
    if verdict.stable:
        return
    over = [
        f"{name}: {gain:.4g} (limit alone {limit:.4g})"
        for name, gain, limit in zip(names, gains, verdict.gain_limits, strict=True)
        if gain > 0.5 * limit
    ]
    low = "they are too low for " if cure and cure.word == CHANGE else ""
    raise ConfigError(
        f"the sampled PD loop is unstable: spectral radius {verdict.radius:.7g} > 1, the torque held for {h:g} s",
        why="gains near or above their limit, 2 / (h (M^-1)_ii) without friction: "
        + ("; ".join(over) or f"none, {low}the kinematic gains"),
        fix=(f"{cure.word} them, {cure.values}, or " if cure else "lower the gains, or ")
        + "leave them out and let suitable ones be chosen (mmnn inspect ROBOT --gains prints "
        "them), or shorten the control or sensor period",
        key="feedback",
        values=cure.values if cure else None,
    )


def cured(plan: Plan, limits: Array) -> Cure | None:
    """Gains that hold as a fix: each at most the same share of its limit; or, if need be, not far below that.

    Args:
        plan: Of the loop.
        limits: (p,) `SampledLoop.gain_limits`, the smallest along the setpoints.

    Returns:
        None where none is found.
    """
    own = gains_of(plan)
    limits = np.where(np.isfinite(limits), limits, 0.0)
    for word, least in (("lower", 0.0), (CHANGE, LEAST)):
        for share in SHARES[1:]:
            gains = two_digits(np.clip(own, least * share * limits, share * limits))
            if all(holds(plan, f * gains) for f in (1.0, ROOM)):
                return Cure(word, feedback_values(gains, plan))
    return None


def require_servo_rows(plan: Plan, what: str) -> None:
    """Refuse a loop that other numbers of its servo rows cure: the kinematic layer's, or those of the servos' law.

    Args:
        plan: Of the loop.
        what: What is wrong with it.

    Raises:
        ConfigError: With numbers that it bears with some room.
    """
    servos = plan.servo
    if servos is None:
        return
    b = in_short(servos.law.bandwidth)
    if (values := lower_kinematics(plan)) is not None:
        why = f"the gains of the kinematic layer are too high for servos with a bandwidth of {b} 1/s"
        fix = f"lower them, {values}, or shorten the control or sensor period"
        raise ConfigError(what, why=why, fix=fix, key="kinematic", values=values)
    weak = f"simulated servos with a bandwidth of {b} 1/s are too slow for it"
    tries = [("gain", factor, "the servos' law answers an error too strongly") for factor in (0.5, 0.2, 0.0)]
    for name, factor, why in (*tries, *(("bandwidth", factor, weak) for factor in FASTER if servos.simulated)):
        value = as_given(two_digits(factor * np.atleast_1d(getattr(servos.law, name))))
        law = msgspec.structs.replace(servos.law, **{name: value})
        if holds(replace(plan, servo=servos_on(plan.robot, servos.kinds, law, servos.simulated))):
            values = Values("servo", {name: in_short(value)})
            fix = f"{values}, or shorten the control or sensor period"
            raise ConfigError(what, why=why, fix=fix, key=f"servo.{name}", values=values)


def lower_kinematics(plan: Plan) -> Values | None:
    """Lower gains of the kinematic layer with which the loop of a plan holds, with some room; None without any."""
    for share in SHARES[1:]:
        gains, K = two_digits(share * plan.gains), two_digits(share * plan.K)
        if all(holds(replace(plan, gains=f * gains, K=f * K)) for f in (1.0, ROOM)):
            base = by_name(plan.robot.base.gain_names, gains)
            texts = {name: in_short(tuple(part) if part.size > 1 else float(part[0])) for name, part in base.items()}
            return Values("kinematic", texts | ({"K": in_short(as_given(K))} if K.size else {}))
    return None


def require_margin(plan: Plan) -> None:
    """Refuse gains that do not bear the latency of a plan (`ConfigError`)."""
    margin, delay = delay_margin(plan), known_delay(plan)
    if margin > delay:
        return
    what = f"the loop does not bear a latency of {1e3 * delay:g} ms"
    require_servo_rows(plan, what)
    fix, share = "shorten the latency", largest_share(plan)
    if share > 0.0:
        less: Values | None = feedback_values(share * gains_of(plan), plan)
        fix = f"lower the feedback to {share:.4f} of it, {less}, or {fix}"
    elif (less := lower_kinematics(plan)) is not None:
        fix = f"lower the gains of the kinematic layer, {less}, or {fix}"
    why = f"its delay margin is {1e3 * margin:.3g} ms"
    raise ConfigError(what, why=why, fix=fix, key="latency", values=less)


def largest_share(plan: Plan) -> float:
    """Largest share of the feedback that bears the latency of a plan, to 2 %; 0 where none does."""
    delay = known_delay(plan)
    for below, share in pairwise(SHARES):
        if delay_margin(plan, float(share)) > delay:
            low, high = float(share), float(below)
            while high > 1.02 * low:
                middle = float(np.sqrt(low * high))
                low, high = (middle, high) if delay_margin(plan, middle) > delay else (low, middle)
            return int(low * 1e4) / 1e4
    return 0.0


@one_thread
def holds(plan: Plan, gains: Array | None = None) -> bool:
    """Whether the sampled loop of a plan is stable and bears its delay, with its own gains on s or with others (p,)."""
    delay = known_delay(plan)
    return all(verdict.stable for verdict in verdicts(plan, gains)) and (
        delay <= 0.0 or delay_margin(plan, gains=gains) > delay
    )


def known_delay(plan: Plan) -> float:
    """The latency, and what simulated servos add to it [s]."""
    return plan.latency + (plan.servo.law.delay if plan.servo is not None and plan.servo.simulated else 0.0)


def feedback_values(gains: Array, plan: Plan) -> Values:
    """Gains on s (p,) as settings."""
    parts = zip(("base", "arm"), np.split(gains, [plan.robot.dimensions.base]), strict=True)
    return Values("feedback", {name: in_short(as_given(part)) for name, part in parts if part.size})


def in_short(numbers: Numbers) -> str:
    """Numbers as a call in Python has them."""
    short = [f"{number:.4g}" for number in np.atleast_1d(numbers)]
    return f"({', '.join(short)})" if np.ndim(numbers) else short[0]


def as_given(numbers: Array) -> float | tuple[float, ...]:
    """One number where all are alike, as settings take them."""
    return float(numbers[0]) if np.ptp(numbers) == 0.0 else tuple(numbers.tolist())


def two_digits(numbers: Array) -> Array:
    """Numbers with two digits, none of them larger than it was."""
    ten = 10.0 ** (np.floor(np.log10(np.maximum(numbers, 1e-300))) - 1.0)
    return np.asarray(np.floor(numbers / ten + 1e-9) * ten)
