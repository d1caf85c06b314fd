"""Does the energy of the errors change as the model says? A check on the whole pipeline, period by period.

With `s = nu_ref - nu` of the true state, `Mdot = C + C'` makes this an equality for any torque:

    d/dt (s' M s / 2) = s' (Psi - tau + d),        d = -f, f the external force

It needs M, C, gravity, friction, the command with its analytic derivative, the reference, the torque and the integrator
all to be right. Over a control period, in which tau and f are held, the right side is integrated along the motion that
starts at the recorded state: DOP853 (order 8) on Pinocchio's matrices. Inside the period alpha follows the true state.
The reference is the one that its samples determine: base velocities are cubic Hermite polynomials of the recorded
velocities and accelerations, and the pose follows from integrating them, so that it stays one that the base can follow;
joints are quintic polynomials of recorded angles, rates and accelerations.

The run itself came from the plant's integrator, so the recorded states are held to two things: to the plant's own
steps, made again from the recorded state under the recorded torque, and to the equality, which they miss by what these
steps miss the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mmnn_pin.errors import RecordingError
from mmnn_pin.kinematic import command
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.model.reduction import position_rate, quadratic
from mmnn_pin.plant.ideal import IdealPlant
from mmnn_pin.sensing import exact
from mmnn_pin.settings import finite
from mmnn_pin.signals import INDEX, Array, Layout

TOLERANCE = 1e-6
BUDGET = 50_000  # evaluations of the dynamics: a few seconds
ROUNDING = 1e-15  # relative, of what s is the difference of


@dataclass(frozen=True, eq=False)
class Balance:
    """The equality over (k,) control periods."""

    time: Array  # start of each period [s]
    increment: Array  # change of s' M s / 2 between the recorded states at its ends [J]
    model: Array  # the same along the motion that DOP853 gives from its start [J]
    # the same along the plant's own steps from its start [J]; NaN where torque or force change within control periods,
    # of which a recording has the means
    again: Array
    work: Array  # integral of s' (Psi - tau) along the motion of DOP853 [J]
    scale: Array  # root mean square of s' (Psi - tau) times the period [J], at least what rounding leaves undecided
    periods: int  # how many the run has; fewer are looked at, evenly spread, when the dynamics are slow to compute

    @property
    def identity(self) -> float:
        """Largest relative error of the equality along the motion of DOP853: model, command and reference."""
        return float((np.abs(self.model - self.work) / self.scale).max())

    @property
    def steps(self) -> float:
        """Largest relative difference between the recorded states and the plant's own steps: state, torque, engine.

        NaN where these cannot be made again.
        """
        return float((np.abs(self.increment - self.again) / self.scale).max())

    @property
    def recorded(self) -> float:
        """Largest relative error of the equality between the recorded states, with the error of the plant's steps."""
        return float((np.abs(self.increment - self.work) / self.scale).max())

    @property
    def holds(self) -> bool:
        """Whether the equality holds for the model, and the recorded states are the plant's."""
        return self.identity <= TOLERANCE and not self.steps > TOLERANCE

    def to_dict(self) -> dict[str, Any]:
        """Worst relative errors for JSON."""
        return {
            "model": finite(self.identity),
            "steps": finite(self.steps),
            "recorded": finite(self.recorded),
            "tolerance": TOLERANCE,
            "periods": len(self.time),
            "of": self.periods,
            "holds": self.holds,
        }


def balance(subject: Subject, budget: float = BUDGET, progress: Callable[[float], None] | None = None) -> Balance:
    """Check the equality over the control periods of a run.

    Args:
        subject: The run.
        budget: Evaluations of the dynamics after which no further period is looked at; inf looks at all.
        progress: Called with the fraction done.

    Raises:
        RecordingError: The run is on the contact plant, or a joint is blocked in it.
    """
    if subject.hardware.blocked:
        raise RecordingError(
            "no equality", why="a joint is blocked, which is no friction of the model", file=subject.recording.path
        )
    if subject.plant != "ideal":
        raise RecordingError(
            f"no equality on the {subject.plant} plant",
            why="its wheels may slip, and then nu does not move by the reduced model",
            file=subject.recording.path,
        )
    periods, motion = len(subject.rows) - 1, Motion(subject)
    result: dict[int, tuple[float, ...]] = {}
    for k in evenly(periods):
        if motion.evaluations > budget:
            break
        result[k] = motion.over(k)
        if progress is not None:
            progress(max(len(result) / periods, motion.evaluations / budget))
    places = np.array(sorted(result))
    increment, model, again, work, scale = np.array([result[k] for k in places]).T
    return Balance(subject.signal("time")[places, 0], increment, model, again, work, scale, periods)


def evenly(count: int) -> list[int]:
    """0 ... count - 1 in an order of which every beginning is evenly spread (van der Corput)."""
    bits = max(1, (count - 1).bit_length())
    order = (int(f"{i:0{bits}b}"[::-1], 2) for i in range(2**bits))
    return [k for k in order if k < count]


class Motion:
    """The motion within control periods of a run, and the energy of its errors.

    The vector integrated is position (nv), nu (p), pose_ref (3 or 0), the work of s' (Psi - tau), and the integral of
    its square.

    Args:
        subject: The run.

    Attributes:
        evaluations: How often the dynamics were computed so far.
    """

    def __init__(self, subject: Subject) -> None:
        layout = self.layout = subject.layout
        self.subject, self.rows, self.evaluations = subject, subject.rows, 0
        self.dynamics = subject.dynamics(0.0)
        self.row, self.at, self.arm = layout.new_row(), layout.offsets, subject.robot.arm_index
        self.gains, self.K = subject.kinematic.base_gains(layout), subject.kinematic.arm_gains(layout)
        self.h, self.steps = subject.timing.control_period, subject.timing.steps_per_control
        robots, timing = (subject.robot, subject.hardware.loaded or subject.robot), subject.timing
        self.plants = [IdealPlant(robot, timing.plant_step, timing.integrator) for robot in robots]
        self.between = Between(subject.rows, layout, self.h)
        names = ("pose_ref", "velocity_ref", "nu_ref", "nudot_ref", "psi", "torque")
        self.view = {name: self.row[layout.where(name)] for name in names}
        nv, p, end = layout.full, layout.dof, layout.full + layout.dof
        self.position, self.nu, self.pose_ref = slice(0, nv), slice(nv, nv + p), slice(end, end + layout.pose)
        self.no_wheels, self.none = np.zeros(layout.full), np.zeros(0)

    def over(self, k: int) -> tuple[float, ...]:
        """Increment, its like along the motion and the plant's steps, work, scale [J] over period k; see `Balance`."""
        from scipy.integrate import DOP853  # slow to import

        start, end = (self._state(row) for row in (self.rows[k], self.rows[k + 1]))
        hardware = self.subject.hardware
        self.k, self.view["torque"][:] = k, hardware.torque[k] + hardware.push[k]
        self.dynamics = self.subject.dynamics(float(self.rows[k][0]))
        before = self._energy(0.0, start)
        flow = self.flow(0.0, start)
        tolerance = np.full(start.size, 1e-12)
        tolerance[-2:] = 1e-9 * (before + abs(flow) * self.h) + 1e-30, np.inf
        solver = DOP853(self._derivative, 0.0, start, self.h, rtol=1e-10, atol=tolerance, first_step=self.h)
        with np.errstate(over="ignore", invalid="ignore"):
            while solver.status == "running":
                solver.step()
        after, again = self._energy(self.h, solver.y), self._energy(self.h, self._stepped(start, end))
        recorded = self._energy(self.h, end)
        self.evaluations += solver.nfev
        work, squares = solver.y[-2:]
        # s is a difference: its rounding, times M s, is what the energy cannot tell
        reach = 1.0 + np.abs(self.view["nu_ref"]).max() + np.abs(end[:3]).max() * self.gains.max(initial=1.0)
        undecided = ROUNDING * reach * np.abs(self.dynamics.M @ (self.view["nu_ref"] - end[self.nu])).sum()
        scale = max(np.sqrt(squares * self.h), undecided / TOLERANCE, 1e-300)
        return recorded - before, after - before, again - before, float(work), float(scale)

    def _stepped(self, start: Array, end: Array) -> Array:
        """Where the plant's own steps lead over the period, with the reference of its end."""
        if self.subject.hardware.varies:
            return np.full_like(end, np.nan)
        tau, there = self.view["torque"].copy(), end.copy()
        plant = self.plants[int(self.dynamics is not self.subject.dynamics(-1.0))]
        plant.start(start[self.position], start[self.nu])
        for _ in range(self.steps):
            plant.step(tau)
            plant.refresh()
        there[self.position], there[self.nu] = plant.position, plant.nu
        return there

    def _state(self, row: Array) -> Array:
        parts = [row[self.layout.where(name)] for name in ("position", "nu", "pose_ref")]
        return np.concatenate([*parts, np.zeros(2)])

    def _energy(self, t: float, y: Array) -> float:
        """`s' M s / 2` at a time within the period [J]."""
        return 0.5 * quadratic(self.dynamics.M, self._evaluate(t, y))

    def flow(self, t: float, y: Array) -> float:
        """`s' (Psi - tau)` at a time within the period [W]."""
        s, view = self._evaluate(t, y), self.view
        self.dynamics.refresh_psi(view["nu_ref"], view["nudot_ref"], view["psi"])
        return float(s @ (view["psi"] - view["torque"]))

    def _derivative(self, t: float, y: Array) -> Array:
        flow, d, out = self.flow(t, y), self.dynamics, np.empty(y.size)
        base, sideways = self.layout.base, self.layout.sideways
        position_rate(y[self.position], y[self.nu], d.v, base, sideways, self.none, out[self.position])
        out[self.nu] = np.linalg.solve(d.M, self.view["torque"] - d.h)
        if base:
            pose_ref, velocity = y[self.pose_ref], self.view["velocity_ref"]
            position_rate(pose_ref, velocity, self.no_wheels, base, sideways, self.none, out[self.pose_ref])
        out[-2:] = flow, flow * flow  # inf in a trial step that is too long: the solver takes a shorter one
        return out

    def _evaluate(self, t: float, y: Array) -> Array:
        """Command and dynamics at a state; s of the true state."""
        position, nu = y[self.position], y[self.nu]
        self.between.write(self.k, t, self.row)
        self.view["pose_ref"][:] = y[self.pose_ref]
        exact(self.row, self.at, position, nu, self.arm)
        command(self.row, self.at, self.gains, self.K, self.none, None)
        self.dynamics.refresh(position, nu)
        return self.view["nu_ref"] - nu


class Between:
    """The reference between the rows of a run, but for the pose.

    Args:
        rows: (N, width) the rows.
        layout: Where signals stand in them.
        period: Time between two rows [s].
    """

    def __init__(self, rows: Array, layout: Layout, period: float) -> None:
        from scipy.interpolate import BPoly, CubicHermiteSpline, PPoly  # slow to import

        time = np.arange(len(rows)) * period
        velocity, acceleration, q, qdot, qddot = (
            rows[:, layout.where(name)]
            for name in ("velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref")
        )
        # coefficients (degree + 1, N - 1, size), highest first, in the time since the row
        self.base = CubicHermiteSpline(time, velocity, acceleration).c if layout.base else np.zeros((4, len(rows), 0))
        joints = np.stack((q, qdot, qddot), axis=1)
        self.arm = PPoly.from_bernstein_basis(BPoly.from_derivatives(time, joints)).c if layout.arm else None
        at = layout.offsets
        self.of_base = slice(int(at[INDEX["velocity_ref"]]), int(at[INDEX["acceleration_ref"] + 1]))
        self.of_arm = slice(int(at[INDEX["q_ref"]]), int(at[INDEX["qddot_ref"] + 1]))

    def write(self, k: int, t: float, row: Array) -> None:
        """Reference at a time t [s] after row k into a row (width,)."""
        row[self.of_base] = np.concatenate(polynomial(self.base[:, k], t)[:2])
        if self.arm is not None:
            row[self.of_arm] = np.concatenate(polynomial(self.arm[:, k], t))


def polynomial(coefficients: Array, t: float) -> tuple[Array, Array, Array]:
    """Value and first two derivatives at t of polynomials (n, m), highest coefficient first; (m,) each."""
    value = rate = half = np.zeros(coefficients.shape[1])
    for c in coefficients:  # Horner's scheme
        half = half * t + rate
        rate = rate * t + value
        value = value * t + c
    return value, rate, 2.0 * half
