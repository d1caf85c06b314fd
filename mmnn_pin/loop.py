"""Closes the loop: reference, kinematic layer, torque controller, plant, sensor; every control sample is a row.

This is the ordinary loop: Pinocchio does the dynamics, the blocks between are compiled, and a controller may be plain
Python.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from . import kinematic as kinematic_block
from . import sensor
from .compiled import compiled
from .kinematic import Kinematic
from .model.dynamics import Dynamics
from .model.robot import Robot
from .plant.ideal import IdealPlant
from .recorder import Recorder
from .recording import Outcome, Recording
from .reference import Trajectory
from .sampled import require_stable, sampled_loop
from .settings import Settings, require_gains
from .signals import INDEX, SIGNALS, Array, Layout, Measurement, Reference, VelocityCommand, part
from .timing import Timing
from .torque import law
from .torque.controller import CompiledController, Memory, TorqueController, Wiring
from .torque.neural import Neural

TIME, POSITION, NU, POSE_REF, Q_REF = (INDEX[n] for n in ("time", "position", "nu", "pose_ref", "q_ref"))
TORQUE, MOTOR_TORQUE, POSE = (INDEX[n] for n in ("torque", "motor_torque", "pose"))
ENERGY, WORK, RESIDUAL = (INDEX[n] for n in ("energy", "work", "energy_residual"))
FIRST_REFERENCE = INDEX["pose_ref"]


class Start(Settings, frozen=True):
    """Where a run starts, relative to the reference at t = 0.

    Args:
        pose_offset: Start minus reference, in the reference's frame (x, y, phi) [m, m, rad].
        joint_offset: Start minus reference of every arm joint, one number or one per joint [rad or m].
        moving: Start with the reference's velocity instead of at rest.
    """

    pose_offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joint_offset: float | tuple[float, ...] = 0.0
    moving: bool = False

    def state(self, robot: Robot, first: Array) -> tuple[Array, Array]:
        """Position (nv,) and nu (p,) for the first row of a reference table."""
        layout = robot.layout
        position, nu = robot.neutral_position(), np.zeros(layout.dof)
        at = layout.offsets - layout.offsets[FIRST_REFERENCE]
        values = {name: first[at[INDEX[name]] : at[INDEX[name] + 1]] for name in REFERENCE_NAMES}
        if layout.base:
            x, y, phi = values["pose_ref"]
            dx, dy, dphi = self.pose_offset
            c, s = np.cos(phi), np.sin(phi)
            position[:3] = x + c * dx - s * dy, y + s * dx + c * dy, phi + dphi
        position[robot.arm_index] = values["q_ref"] + self.joint_offset
        if self.moving:
            nu[: layout.base], nu[layout.base :] = values["velocity_ref"], values["qdot_ref"]
        return position, nu


REFERENCE_NAMES = ("pose_ref", "velocity_ref", "acceleration_ref", "q_ref", "qdot_ref", "qddot_ref")


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

    def vector(self, layout: Layout) -> Array:
        """Bounds on |nu|, (p,)."""
        base = [self.speed] * (layout.base - 1) + [self.yaw_rate] if layout.base else []
        return np.array(base + [self.joint_speed] * layout.arm, float)


@compiled
def before_torque(
    row: Array, at: Array, time: float, y: Array, reference: Array, measure: bool, arm: Array, gains: Array, K: Array
) -> None:
    """Everything of a sample up to the controller: time, true state, reference, measurement, velocity command."""
    row[at[TIME]] = time
    nv, p = at[POSITION + 1] - at[POSITION], at[NU + 1] - at[NU]
    position, nu = y[:nv], y[nv : nv + p]
    part(row, at, POSITION)[:] = position
    part(row, at, NU)[:] = nu
    row[at[FIRST_REFERENCE] : at[POSE]] = reference
    if measure:
        sensor.ideal(row, at, position, nu, arm)
    kinematic_block.command(row, at, gains, K)


@compiled
def after_torque(
    row: Array, at: Array, M: Array, E_inv: Array, potential: float, work: float, start: float, bounds: Array
) -> int:
    """Motor torques, energy balance and the guard of a sample.

    Returns:
        -1, or the first column that is not finite or a velocity that is out of bounds.
    """
    nu, torque, motors = part(row, at, NU), part(row, at, TORQUE), part(row, at, MOTOR_TORQUE)
    for i in range(motors.size):
        motors[i] = 0.0
        for j in range(torque.size):
            motors[i] += E_inv[i, j] * torque[j]
    energy = potential
    for i in range(nu.size):
        for j in range(nu.size):
            energy += 0.5 * nu[i] * M[i, j] * nu[j]
    row[at[ENERGY]], row[at[WORK]], row[at[RESIDUAL]] = energy, work, energy - start - work
    for i in range(nu.size):
        if abs(nu[i]) > bounds[i]:
            return int(at[NU] + i)
    for i in range(row.size):
        if not np.isfinite(row[i]):
            return i
    return -1


class _Torque:
    """One controller wired to one row; the same face for compiled and for Python controllers."""

    def __init__(
        self,
        controller: TorqueController | CompiledController,
        wiring: Wiring,
        row: Array,
        nominal: Robot,
        memory: Any,
    ) -> None:
        self.controller, self.row, self.at = controller, row, wiring.layout.offsets
        self.memory = controller.init(wiring) if memory is None else memory
        layout = wiring.layout
        self.is_python = isinstance(controller, TorqueController)
        self.records = [record.of(row, layout) for record in (Reference, Measurement, VelocityCommand)]
        self.torque, self.psi_hat = row[layout.where("torque")], row[layout.where("psi_hat")]
        self.model: Dynamics | None = None
        if isinstance(controller, CompiledController):
            self.law = controller.law(wiring)
            self.values = self.memory.values
            if controller.uses_model:
                self.model, self.nominal = Dynamics(nominal), nominal
                self.position = nominal.neutral_position()

    def step(self, time: float) -> None:
        """Write psi_hat, robust, effective_gain and torque of this sample into the row."""
        if self.is_python:
            self.torque[:] = self.controller.step(time, *self.records, self.memory)  # type: ignore[union-attr]
            return
        if self.model is not None:
            self._model_psi()
        law.step(self.law.kind, self.row, self.at, self.law.sizes, self.law.settings, self.values)

    def _model_psi(self) -> None:
        """Psi of the nominal model at the measured state, into psi_hat."""
        assert self.model is not None
        _, measured, command = self.records
        self.position[: measured.pose.size] = measured.pose
        self.position[self.nominal.arm_index] = measured.q
        self.model.refresh(self.position, np.concatenate((measured.velocity, measured.qdot)))
        self.model.refresh_psi(command.nu_ref, command.nudot_ref, self.psi_hat)

    def weights(self) -> dict[str, Array]:
        """Named views of what is learned."""
        return self.controller.weights(self.memory)

    def findings(self) -> list[str]:
        """What the memory shows after the run."""
        return self.controller.findings(self.memory) if isinstance(self.controller, Neural) else []


@dataclass(frozen=True)
class Loop:
    """A closed loop, ready to run.

    Args:
        robot: The true robot, simulated by the plant.
        trajectory: What it should do.
        controller: A controller of this package or a `TorqueController` of your own.
        kinematic: Gains of the kinematic layer.
        timing: Periods.
        start: Where the run starts.
        nominal: The robot that a model-based controller believes in; None for the true one.
        bounds: Where a state counts as lost.
        seed: The run's one seed.
        weights_interval: Time between two records of the weights [s].
        check_gains: Refuse gains that make the sampled PD loop alone unstable.
    """

    robot: Robot
    trajectory: Trajectory
    controller: TorqueController | CompiledController
    kinematic: Kinematic = field(default_factory=Kinematic)
    timing: Timing = field(default_factory=Timing)
    start: Start = field(default_factory=Start)
    nominal: Robot | None = None
    bounds: Bounds = field(default_factory=Bounds)
    seed: int = 0
    weights_interval: float = 0.1
    check_gains: bool = True

    def run(
        self,
        path: str | Path | None = None,
        *,
        force: bool = False,
        meta: Mapping[str, Any] | None = None,
        memory: Any = None,
        state: tuple[Array, Array] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Recording:
        """Run to the end, to divergence or to Ctrl-C; a diverged run is a recording too.

        Args:
            path: File for the recording; None keeps it in memory.
            force: Replace an existing file.
            meta: More facts for the recording.
            memory: A controller's memory to start from (a snapshot); None for a new one.
            state: Position (nv,) and nu (p,) to start from instead of `start`.
            progress: Called now and then with the simulated time [s].

        Raises:
            ConfigError: Gains of wrong shape, or a PD loop that is unstable when sampled.
            TrajectoryError: A reference that the base cannot follow.
            RecordingError: The recording cannot be written.
        """
        layout, timing = self.robot.layout, self.timing
        table = self.table()
        position, nu = self.start.state(self.robot, table[0]) if state is None else state
        self.require_stable_gains()
        row = layout.new_row()
        rng = np.random.default_rng(np.random.SeedSequence(self.seed).spawn(1)[0])
        wiring = Wiring(layout, timing.control_period, timing.samples, rng)
        torque = _Torque(self.controller, wiring, row, self.nominal or self.robot, memory)
        plant = IdealPlant(self.robot, timing.plant_step, timing.integrator)
        plant.start(position, nu)
        facts = self.facts() | dict(meta or {})
        with Recorder(layout, facts, path, force) as recorder:
            outcome = self._advance(row, table, torque, plant, recorder, progress)
            final = {"position": plant.position, "nu": plant.nu}
            if isinstance(torque.memory, Memory):
                final["memory"] = torque.memory.values
            notes = torque.findings()
            message = "; ".join(text for text in (outcome.message, *notes) if text)
            return recorder.finish(replace(outcome, message=message), final)

    def facts(self) -> dict[str, Any]:
        """What a recording should know of this run."""
        robot = self.robot
        return {
            "robot": robot.name,
            "controller": self.controller.name,
            "seed": self.seed,
            "loop": "ordinary, Python controller" if isinstance(self.controller, TorqueController) else "ordinary",
            "urdf": robot.urdf,
            "urdf_sha256": robot.sha256,
            "velocity_names": robot.velocity_names,
            "position_names": robot.position_names,
            "actuator_names": robot.actuator_names,
            "control_period": self.timing.control_period,
        }

    def table(self) -> Array:
        """The reference at every control sample, (samples, ...), in the order of the row's signals.

        Raises:
            TrajectoryError: The base cannot follow it.
        """
        times = np.arange(self.timing.samples) * self.timing.control_period
        return self.trajectory.table(times, self.robot.layout)

    def require_stable_gains(self) -> None:
        """Judge the sampled PD loop at ten places along the reference.

        Raises:
            ConfigError: It is unstable at one of them, with the numbers.
        """
        if not self.check_gains or isinstance(self.controller, TorqueController):
            return
        layout, dynamics, table = self.robot.layout, Dynamics(self.robot), self.table()
        gains = self.controller.feedback_gain(layout)
        K, h = self.kinematic.arm_gains(layout), self.timing.control_period
        first = layout.offsets[FIRST_REFERENCE]
        velocity = slice(*(layout.offsets[INDEX["velocity_ref"] + i] - first for i in (0, 1)))
        for i in np.unique(np.linspace(0, len(table) - 1, 10).astype(int)):
            position, _ = Start().state(self.robot, table[i])
            M = dynamics.mass_matrix(position)
            verdict = sampled_loop(M, gains, table[i, velocity], self.kinematic.base_gains(), K, h, self.robot.viscous)
            require_stable(verdict, gains, self.robot.velocity_names, h)

    def _advance(
        self,
        row: Array,
        table: Array,
        torque: _Torque,
        plant: IdealPlant,
        recorder: Recorder,
        progress: Callable[[float], None] | None,
    ) -> Outcome:
        """The loop itself."""
        robot, timing, layout = self.robot, self.timing, self.robot.layout
        at, h = layout.offsets, timing.control_period
        gains, K, bounds = self.kinematic.base_gains(), self.kinematic.arm_gains(layout), self.bounds.vector(layout)
        E_inv = np.ascontiguousarray(np.linalg.pinv(robot.E))
        tau, nu_ref, nudot_ref, psi = (row[layout.where(n)] for n in ("torque", "nu_ref", "nudot_ref", "psi"))
        dynamics, steps, per_measurement = plant.dynamics, timing.steps_per_control, timing.steps_per_measurement
        weights_every = max(1, round(self.weights_interval / h))
        start = 0.5 * plant.nu @ dynamics.M @ plant.nu + dynamics.potential()
        k, time = 0, 0.0
        try:
            for k in range(timing.samples):
                began, time = clock.perf_counter(), k * h
                measure = k * steps % per_measurement == 0
                before_torque(row, at, time, plant.y, table[k], measure, robot.arm_index, gains, K)
                torque.step(time)
                step_time = clock.perf_counter() - began
                dynamics.refresh_psi(nu_ref, nudot_ref, psi)
                bad = after_torque(row, at, dynamics.M, E_inv, dynamics.potential(), plant.y[-1], start, bounds)
                if bad >= 0:
                    return diverged(row, layout, bad, time, recorder)
                recorder.append(row, step_time)
                if k % weights_every == 0 and (weights := torque.weights()):
                    recorder.weights(time, weights)
                for i in range(steps):
                    if i > 0 and (k * steps + i) % per_measurement == 0:
                        sensor.ideal(row, at, plant.position, plant.nu, robot.arm_index)
                    plant.step(tau)
                    plant.refresh()
                if progress is not None and k % 100 == 0:
                    progress(time)
        except KeyboardInterrupt:
            return Outcome("interrupted", time, message=f"stopped by Ctrl-C at t = {time:g} s")
        if weights := torque.weights():
            recorder.weights(timing.duration, weights)
        return Outcome("completed", timing.duration)


def diverged(row: Array, layout: Layout, column: int, time: float, recorder: Recorder) -> Outcome:
    """Outcome of a run whose row went bad at a column; a row that is still finite is kept."""
    i = int(np.searchsorted(layout.offsets, column, side="right") - 1)
    signal, value = f"{SIGNALS[i][0]}[{column - layout.offsets[i]}]", row[column]
    if np.isfinite(row).all():
        recorder.append(row)
    why = "left its bounds" if np.isfinite(value) else "is not finite"
    return Outcome("diverged", time, signal, f"{signal} {why} ({value:.3g}) at t = {time:g} s")
