"""Filtered torque: what a control period says of the dynamics, without a measured acceleration. Compiled.

Over the period that ends at a sample the torque was constant. With the mean of a signal over that period written as
<.>, the mean acceleration is a difference of velocities, `<nudot> = (nu_k+1 - nu_k) / h`, and

    Phi(<q>, <nu>, <nu>, <nudot>) W = <tau>,

up to terms of second order in h, is one equation per velocity for the weights W of `Psi_hat = Phi W`, as Psi is tau
where nu_ref is nu. Both sides pass the same low-pass `1 / (1 + s / pole)`, which takes the noise that differencing
brings. For features linear in nudot this is the filtered regressor (Hsu, Bodson, Sastry, Paden 1987, IEEE ICRA;
Slotine and Li 1989, Automatica 25(4), composite adaptive control).

Features that are not linear in nudot do not commute with a filter and see the noise before it. For them there is a
second low-pass ahead of the features, on states and torque: `x' = state_pole (u - x)`, exact for a torque that is held
and for states that go straight between samples, whose means over a period are again exact,
`<x> = <u> - (x_k+1 - x_k) / (state_pole h)`.

What the motors were asked for is not at once what they give, and a measurement may be old. Where that is stated, the
torque of an equation is the one that moved the robot while it was measured: the command as many periods ago as it was
under way, behind `u' = (command - u) / lag`, which is exact for a command that is held,
`<u> = command - (u_k+1 - u_k) lag / h`.

A period counts only where the sample before it is one control period ago: after a start, a resumption elsewhere, a stop
by the supervisor or a sample that is no number the filter takes the next state as its first.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..compiled import compiled, copy_to, internal
from ..elementary import exp
from ..elementary.arrays import is_below
from ..errors import ConfigError
from ..parts import Matrix, Vector
from ..signals import INDEX, Array, IntArray

if TYPE_CHECKING:
    from .controller import Context

TIME, Q, QDOT, TORQUE = INDEX["time"], INDEX["q"], INDEX["qdot"], INDEX["torque"]
VELOCITY, POSE, SHAPE = INDEX["velocity"], INDEX["pose"], INDEX["shape"]
LARGEST = 1e9  # a state or torque beyond this is none [SI units]
SETTLED = 5.0  # time constants of the states' filter after which its start is forgotten


class Filter(NamedTuple):
    """The numbers of a filter, and room to work in."""

    h: float  # control period [s]
    keep: float  # exp(-state_pole h), 0 without that filter
    fresh: float  # what a state's change over a period adds to its filtered value; 1 without the filter
    lag: float  # 1 / (state_pole h), 0 without the filter
    hold: float  # exp(-pole h), 0 without the low-pass
    motor: Array  # (p,) exp(-h / lag) of the motors, 0 without lag
    drag: Array  # (p,) lag / h
    late: float  # how many periods ago was asked for what acts, a part of one included
    wait: int  # periods after a start that do not count
    pose: Array  # (3,) or (0,) pose at the end of the last period, as it was measured
    q: Array  # (n,) its mean angles
    nu: Array  # (p,) its mean velocities
    nudot: Array  # (p,) its mean accelerations
    torque: Array  # (p,) its mean torque; subtract from it what is known already
    shape: Array  # (shape,) its mean angles of a base that steers
    told: Array  # (p,) 1, or 0 for a velocity whose torque a servo hides: its equation is 0 = 0


class Filtered(NamedTuple):
    """State of a filter."""

    clock: Vector  # (2,) time of the last sample [s], and how many have followed one another
    held: Matrix  # (m, p) torque that is held since then, and those before it that are under way
    driven: Vector  # (p,) torque that the motors give
    filtered_torque: Vector  # (p,) torque behind the filter ahead of the features
    states: Matrix  # (2, n + p + shape) angles and velocities of the last sample, and behind that filter
    Phi_f: Matrix  # (rows, k) features behind the low-pass
    Y_f: Vector  # (p,) torque behind the low-pass


def new_filter(context: Context, pole: float, state_pole: float = 0.0) -> Filter:
    """The numbers of a filter.

    Args:
        context: Sizes, control period, and how long a torque is known to be under way.
        pole: Of the low-pass behind the features [1/s]; 0 for none.
        state_pole: Of the one ahead of them [1/s]; 0 for none.

    Raises:
        ConfigError: A pole is negative or not finite.
    """
    for value in (pole, state_pole):
        if not (np.isfinite(value) and value >= 0):
            raise ConfigError(f"a filter's pole of {value} 1/s", fix="use a finite number >= 0; 0 is no filter")
    layout, h = context.layout, float(context.control_period)
    slow = np.zeros(layout.dof) if context.lag is None else context.lag / h
    keep, lag = (exp(-state_pole * h), 1.0 / (state_pole * h)) if state_pole else (0.0, 0.0)
    return Filter(
        h=h,
        keep=keep,
        fresh=1.0 - (1.0 - keep) * lag,
        lag=lag,
        hold=exp(-pole * h) if pole else 0.0,
        motor=np.array([exp(-1.0 / each) if each > 0.0 else 0.0 for each in slow]),
        drag=slow,
        late=context.way / h,
        wait=math.ceil(SETTLED * max(lag, float(slow.max(initial=0.0))) + context.way / h),
        pose=np.zeros(layout.pose),
        q=np.zeros(layout.arm),
        nu=np.zeros(layout.dof),
        nudot=np.zeros(layout.dof),
        torque=np.zeros(layout.dof),
        shape=np.zeros(layout.shape),
        told=np.ones(layout.dof) if context.hidden is None else 1.0 - context.hidden,
    )


def parts(context: Context, rows: int, k: int) -> dict[str, tuple[int, ...]]:
    """Names and shapes of what a filter remembers, to be parts of a `ControllerState`.

    Args:
        context: Sizes, and how long a torque is known to be under way.
        rows: Rows of the features Phi.
        k: Columns of Phi.
    """
    p = context.layout.dof
    way = 1 + math.ceil(context.way / context.control_period)
    own: dict[str, tuple[int, ...]] = {"clock": (2,), "held": (way, p), "driven": (p,), "filtered_torque": (p,)}
    states = (2, context.layout.arm + p + context.layout.shape)
    return own | {"states": states, "Phi_f": (rows, k), "Y_f": (p,)}


@compiled
def remember(row: Array, at: IntArray, seen: Filtered) -> None:
    """Keep the torque that is held from this sample on; the last one that is kept in a sample counts.

    Args:
        row: (width,) row of signals.
        at: Offsets of the signals.
        seen: What the filter remembers.
    """
    copy_to(row[at[TORQUE] : at[TORQUE + 1]], seen.held[0])


@internal
def period(row: Array, at: IntArray, f: Filter, seen: Filtered) -> bool:
    """Take a sample in; the means over the period that ends with it into f.q, f.nu, f.nudot, f.shape and f.torque.

    Args:
        row: (width,) row of signals with the measurement of this sample.
        at: Offsets of the signals.
        f: The filter.
        seen: What it remembers.

    Returns:
        Whether there is such a period, and the filter has settled.
    """
    n, p, nb = f.q.size, f.nu.size, f.nu.size - f.q.size
    clock, drive = seen.clock, seen.filtered_torque
    held, older, old = seen.held[int(f.late)], seen.held[min(int(f.late) + 1, len(seen.held) - 1)], f.late % 1.0
    last, smooth = seen.states[0], seen.states[1]
    time = row[at[TIME]]
    follows = clock[1] > 0.0 and abs(time - clock[0] - f.h) < 0.5 * f.h
    usable = is_below(row[at[VELOCITY] : at[SHAPE + 1]], LARGEST)
    follows = follows and usable and is_below(held, LARGEST) and is_below(older, LARGEST)
    clock[0] = time
    clock[1] = clock[1] + 1.0 if follows else 1.0 if usable else 0.0
    for i in range(f.pose.size):
        f.pose[i] = row[at[POSE] + i]
    for i in range(n + p + f.shape.size):
        u = row[at[Q] + i] if i < n else row[at[VELOCITY] + i - n] if i < n + nb else row[at[QDOT] + i - n - nb]
        if follows:
            before = smooth[i]
            smooth[i] = f.keep * before + (1.0 - f.keep) * last[i] + f.fresh * (u - last[i])
            mean = 0.5 * (last[i] + u) - f.lag * (smooth[i] - before)
            if i < n:
                f.q[i] = mean
            elif i >= n + p:
                f.shape[i - n - p] = mean
            else:
                f.nu[i - n], f.nudot[i - n] = mean, (smooth[i] - before) / f.h
        elif usable:
            smooth[i] = u
        if usable:
            last[i] = u
    for i in range(p):
        asked, gave = held[i] + old * (older[i] - held[i]), seen.driven[i] if follows else 0.0
        seen.driven[i] = f.motor[i] * gave + (1.0 - f.motor[i]) * asked if follows else 0.0
        given, before = asked - f.drag[i] * (seen.driven[i] - gave), drive[i] if follows else 0.0
        drive[i] = f.keep * before + (1.0 - f.keep) * given if follows else 0.0
        f.torque[i] = given - f.lag * (drive[i] - before)
    for j in range(len(seen.held) - 1, 0, -1):
        copy_to(seen.held[j - 1], seen.held[j])
    return follows and clock[1] > f.wait + 1.0


@compiled
def low_pass(f: Filter, Phi: Array, seen: Filtered) -> None:
    """Features and torque of the last period through the low-pass.

    Args:
        f: The filter, with f.torque.
        Phi: (rows, k) features at the means of the period.
        seen: What the filter remembers.
    """
    rows, k = Phi.shape
    Phi_f, Y_f = seen.Phi_f, seen.Y_f
    for i in range(rows):
        fresh = (1.0 - f.hold) * (f.told[i] if rows == f.told.size else 1.0)
        for j in range(k):
            Phi_f[i, j] = f.hold * Phi_f[i, j] + fresh * Phi[i, j]
    for i in range(f.torque.size):
        Y_f[i] = f.hold * Y_f[i] + (1.0 - f.hold) * f.told[i] * f.torque[i]
