"""Coming to rest at a place in the shortest time within speed and acceleration, by closed forms: exact for any step.

A joint at a distance d of its goal, with rate u towards it, drives at +a up to the rate `sqrt(a d + u^2 / 2)` or the
largest one, and brakes at -a (Pontryagin's bang-bang control of a double integrator). It passes its goal only where it
cannot stop before it, and then by what braking needs.
"""

from __future__ import annotations

import math

from ..compiled import compiled


@compiled
def brought_home(gap: float, rate: float, most: float, fastest: float, dt: float) -> tuple[float, float]:
    """A gap and its rate some time later, on the shortest way to rest at 0.

    Args:
        gap: [rad or m].
        rate: [rad/s or m/s].
        most: Largest acceleration.
        fastest: Largest rate; one that is larger is braked first.
        dt: Time [s].

    Returns:
        Gap and rate then.
    """
    stop = gap + 0.5 * rate * abs(rate) / most
    side = -1.0 if stop > 0.0 else 1.0  # where it has to be pushed first
    d, u, push = -side * gap, side * rate, most
    peak = math.sqrt(max(most * d + 0.5 * u * u, 0.0))
    cruise = 0.0
    if peak > fastest:
        push = -most if u > fastest else most
        peak = fastest
        cruise = d - 0.5 * (fastest * fastest - u * u) / push - 0.5 * fastest * fastest / most
        cruise = max(cruise, 0.0) / fastest if fastest > 0.0 else math.inf
    first, last = (peak - u) / push, peak / most
    if dt < first:
        left, speed = d - u * dt - 0.5 * push * dt * dt, u + push * dt
    elif dt < first + cruise:
        left, speed = 0.5 * peak * last + peak * (first + cruise - dt), peak
        if fastest <= 0.0:
            left = d - 0.5 * (u + peak) * first
    elif dt < first + cruise + last:
        rest = first + cruise + last - dt
        left, speed = 0.5 * most * rest * rest, most * rest
    else:
        left, speed = 0.0, 0.0
    return -side * left, side * speed


@compiled
def led(
    place: float, rate: float, goal: float, low: float, high: float, most: float, fastest: float, dt: float
) -> tuple[float, float]:
    """Place and rate some time later, on the shortest way to rest at a goal between two ends.

    What cannot stop before an end within the acceleration brakes harder, to it; beyond the end, nothing goes on.

    Args:
        place: [rad or m].
        rate: [rad/s or m/s].
        goal: Between the ends.
        low: Lower end.
        high: Upper end.
        most: Largest acceleration.
        fastest: Largest rate.
        dt: Time [s].
    """
    room = high - place if rate > 0.0 else place - low
    if rate != 0.0 and rate * rate > 2.0 * most * room * (1.0 + 1e-9):
        if room <= 0.0:
            return place, 0.0
        stop = 2.0 * room / abs(rate)
        if dt >= stop:
            return high if rate > 0.0 else low, 0.0
        return place + rate * dt * (1.0 - 0.5 * dt / stop), rate * (1.0 - dt / stop)
    gap, after = brought_home(place - goal, rate, most, fastest, dt)
    return goal + gap, after


@compiled
def in_one_step(place: float, rate: float, to: float, with_rate: float, most: float, dt: float) -> bool:
    """Whether a place and a rate can follow on others within an acceleration, a time dt later [s]."""
    bend = most * dt + 1e-9
    return abs(with_rate - rate) <= bend and abs(to - place - 0.5 * (rate + with_rate) * dt) <= 0.5 * bend * dt + 1e-9
