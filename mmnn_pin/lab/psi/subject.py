"""The run that is looked into: its robot, rows and gains, its hardware model, its learner built again.

A recording holds the mean torque and push of every control period. Motors with lag, limits of speed or backlash, and
pushes that change, vary within a period that has several steps of the plant; then the motion cannot be made again from
the recording.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np

from ...actuator.settings import Actuator, limits
from ...disturbance import BlockedJoint, DeadMotor, Disturbance, FrozenEncoder, Messages, Payload, Push, payload
from ...errors import RecordingError
from ...kinematic import Kinematic, command, steer
from ...loop.latency import Latency
from ...model.dynamics import Dynamics
from ...model.robot import Robot, carrying
from ...recording.reading import AGAIN
from ...recording.recording import Recording, recorded_robot
from ...sensing import Sensor, exact
from ...sensing.settings import LARGEST_NOISE
from ...settings import Timing
from ...signals import Array, Layout
from ...torque.neural import Neural
from .learner import Learner, NetworkLearner, recorded_learner

MOST_STEPS = 10_000  # of the plant in a control period
LARGEST = 1e50  # what a robot's signals stay below; its square can be counted with
NEEDED = ("time", "position", "nu", "nu_ref", "nudot_ref", "psi", "psi_hat", "robust", "torque")


@dataclass(frozen=True, eq=False)
class Subject:
    """A recorded run and what it was made of."""

    recording: Recording  # the run
    robot: Robot  # its true robot
    told: Robot  # the same with the wheels' radii that the controller takes
    kinematic: Kinematic  # gains of its kinematic layer
    timing: Timing  # its periods
    rows: Array  # (N, width) its signals as rows; those up to the first that is not finite

    @classmethod
    def of(cls, recording: Recording) -> Subject:
        """Everything from a recording.

        Raises:
            RecordingError: It is damaged, holds less than two rows that are finite, or does not hold its robot, gains,
                periods, or a signal of which everything here is made.
            InputError: Its robot cannot be built.
        """
        recording.require_whole()
        if not recording.urdf.strip():
            raise RecordingError(
                "the recording does not hold its robot's URDF",
                why="without it there is no model to compare with",
                file=recording.path,
            )
        told = recorded_robot(recording)
        with recording.using("what it tells of its wheels' radii"):
            robot = told.with_radii(recording.meta["radii"]) if "radii" in recording.meta else told
        for key, what in (("kinematic", "gains of its kinematic layer"), ("time", "periods")):
            if key not in recording.meta:
                raise RecordingError(
                    f"the recording does not hold the {what}", why="an older mmnn_pin wrote it", file=recording.path
                )
        for name in NEEDED:
            if name not in recording:
                raise RecordingError(
                    "no truth to compare with",
                    why=f"the signal '{name}' is not in the recording, as in one from outside a simulation",
                    file=recording.path,
                )
        rows = finite_rows(recording, Layout.of(robot.dimensions))
        if len(rows) < 2:
            raise RecordingError(
                "too short to judge",
                why=f"{len(rows)} of its rows are finite; its run was {recording.outcome.status}",
                fix="run longer",
                file=recording.path,
            )
        kinematic, timing = recording.fact("kinematic", Kinematic), recording.fact("time", Timing)
        require_periods(recording, timing, rows[:, Layout.of(robot.dimensions).where("time")][:, 0])
        return cls(recording, robot, told, kinematic, timing, rows)

    @property
    def layout(self) -> Layout:
        """Where the signals stand in the rows; those of wheels' contacts are left out."""
        return Layout.of(self.robot.dimensions)

    @property
    def controller(self) -> str:
        """Name of the controller."""
        return str(self.recording.meta.get("controller", "the controller"))

    @property
    def plant(self) -> str:
        """`ideal` or `contact`."""
        return str(self.recording.meta.get("plant", "ideal"))

    @property
    def exact_sensors(self) -> bool:
        """Whether the controller had the true state at every control sample."""
        every = self.timing.steps_per_control % self.timing.steps_per_measurement == 0
        return "sensor" not in self.recording.meta and not self.hardware.senses and every

    @property
    def exact_poses(self) -> bool:
        """Whether pose and joint angles were measured as they are, at every control sample; velocities may be noisy."""
        every = self.timing.steps_per_control % self.timing.steps_per_measurement == 0
        exact = msgspec.structs.replace(self.sensor, velocity_noise=0.0) == Sensor()
        return exact and not self.hardware.senses and every

    @property
    def sensor(self) -> Sensor:
        """Its sensors."""
        return msgspec.convert(self.recording.meta.get("sensor", {}), Sensor)

    @property
    def latency(self) -> Latency:
        """How long measurements and commands were under way."""
        return msgspec.convert(self.recording.meta.get("latency", {}), Latency)

    @property
    def velocity_noise(self) -> Array:
        """(p,) what the noise of the measured velocities is bounded by: `LARGEST_NOISE` standard deviations."""
        return LARGEST_NOISE * (np.zeros(self.layout.dof) + np.asarray(self.sensor.velocity_noise, float))

    @property
    def motors_lag(self) -> bool:
        """Whether its motors have more than a limit of torque."""
        motors = msgspec.convert(self.recording.meta.get("actuator", {}), Actuator)
        return bool(msgspec.structs.replace(motors, torque_limit=None) != Actuator())

    @property
    def rolls_otherwise(self) -> bool:
        """Whether its wheels have other radii than the controller takes."""
        return self.robot is not self.told

    @property
    def motor_limits(self) -> Array:
        """(motors,) largest torques of its motors, inf where there is no limit [N m or N]."""
        if "actuator" not in self.recording.meta:
            return np.full(len(self.robot.actuator_names), np.inf)
        limit = msgspec.convert(self.recording.meta["actuator"], Actuator).torque_limit
        return np.asarray(limits(limit, self.robot.effort_limits, "motor", "actuator.torque_limit"), float)

    @property
    def applied(self) -> Array:
        """The part of Psi_hat that was sent, (N, p): that of a later instant where it led, else Psi_hat [N, N m]."""
        if "psi_applied" not in self.recording:
            return self.signal("psi_hat")
        return np.asarray(self.recording["psi_applied"][: len(self.rows)])

    @cached_property
    def learner(self) -> Learner | None:
        """The learner, or None where the controller of the run has none; errors as in `recorded_learner`."""
        return recorded_learner(self.recording, self.told)

    @property
    def networks(self) -> NetworkLearner | None:
        """The learner where it is one of the thesis, networks alone; None otherwise; errors as of `learner`."""
        learner = self.learner
        return learner if isinstance(learner, NetworkLearner) and isinstance(learner.controller, Neural) else None

    @cached_property
    def hardware(self) -> HardwareEffects:
        """Effects of motors, pushes and a payload on the robot."""
        return HardwareEffects.of(self.recording, self.robot, self.timing)

    @cached_property
    def _dynamics(self) -> tuple[Dynamics, Dynamics]:
        return Dynamics(self.robot), Dynamics(self.hardware.loaded or self.robot)

    def dynamics(self, time: float) -> Dynamics:
        """Pinocchio's dynamics of the robot in the control period that begins at a time [s]."""
        return self._dynamics[int(self.hardware.pick <= time + 5e-10 < self.hardware.drop)]

    def truth(self, rows: Array) -> Array:
        """Rows as they were if the sensors gave the true state: measurement, command, errors and Psi of the truth."""
        if self.exact_sensors:
            return rows
        rows, layout, places = rows.copy(), self.layout, self.robot.measured_index
        gains, K = self.kinematic.base_gains(layout), self.kinematic.arm_gains(layout)
        steering, setpoint = (
            self.kinematic.steering_of(self.robot, self.timing.control_period),
            slice(*layout.offsets[[3, 9]]),
        )
        before = rows[0][setpoint].copy()
        for row in rows:
            position, nu = row[layout.where("position")], row[layout.where("nu")]
            exact(row, layout.offsets, position, nu, places)
            if steering is not None:
                steer(row, layout.offsets, steering)
            command(row, layout.offsets, gains, K, before, steering)
            before[:] = row[setpoint]
            nu_ref, nudot_ref, psi = (row[layout.where(name)] for name in ("nu_ref", "nudot_ref", "psi"))
            dynamics = self.dynamics(float(row[layout.where("time")][0]))
            dynamics.refresh(position, nu)
            dynamics.refresh_psi(nu_ref, nudot_ref, psi)
        return rows

    @property
    def s(self) -> Array:
        """`[z; r]` as the controller saw it, (N, p)."""
        return np.hstack((self.signal("z"), self.signal("r")))

    def signal(self, name: str) -> Array:
        """A signal of the run, (N, size)."""
        return self.rows[:, self.layout.where(name)]


def require_periods(recording: Recording, timing: Timing, time: Array) -> None:
    """Refuse periods that are not those of the rows (`RecordingError`)."""
    h, steps = timing.control_period, timing.steps_per_control
    periods, facts = np.diff(time), recording.meta.get("control_period", h)
    if not np.allclose([*periods, facts], h, rtol=1e-6, atol=1e-9):
        why = f"its rows are {np.min(periods):g} to {np.max(periods):g} s apart, its control period is {h:g} s"
        raise RecordingError("its periods cannot be", why=why, fix=AGAIN, file=recording.path)
    if steps > MOST_STEPS:
        why = f"{steps:,} steps of the plant in a control period, at most {MOST_STEPS:,} are made again"
        raise RecordingError("its periods cannot be", why=why, fix=AGAIN, file=recording.path)


def finite_rows(recording: Recording, layout: Layout) -> Array:
    """Rows of a recording, (N, width), up to the first one that is not finite, or as large as no robot's.

    Raises:
        RecordingError: A signal has other columns than those of the robot.
    """
    recording.read_signals()
    rows = np.zeros((len(recording), layout.width))
    for name in recording:
        where = layout.where(name)
        if where.stop > where.start:
            if len(labels := recording.labels(name)) != where.stop - where.start:
                why = f"{name} has the columns {', '.join(labels)}"
                raise RecordingError("its signals are those of another robot", why=why, file=recording.path)
            rows[:, where] = recording[name].reshape(len(recording), where.stop - where.start)
    bad = np.flatnonzero(~(np.abs(rows) < LARGEST).all(axis=1))
    return rows[: bad[0]] if len(bad) else rows


@dataclass(frozen=True, eq=False)
class HardwareEffects:
    """Effects of the hardware model of a run on its robot."""

    torque: Array  # (N, p) generalized torque of the motors [N, N m]
    push: Array  # (N, p) external force `f` of `M nudot + C nu + ... = tau + f`; d of the equality is `-f` [N, N m]
    load: Payload | None  # the payload; None without one
    loaded: Robot | None  # the robot once it carries its payload; None without one
    pick: float  # when it picks it up [s], inf for never
    drop: float  # when it puts it down [s], inf for never
    varies: bool  # whether torque or push change within control periods
    blocked: bool  # whether a joint is blocked at some time
    senses: bool  # whether disturbances touch what the controller measures

    @classmethod
    def of(cls, recording: Recording, robot: Robot, timing: Timing) -> HardwareEffects:
        """From a recording."""
        with recording.using("its attribute 'disturbances'"):
            events = msgspec.convert(recording.meta.get("disturbances", ()), tuple[Disturbance, ...])
        imperfect = "actuator" in recording.meta or has(events, DeadMotor)
        rows, p = len(recording), robot.dimensions.dof
        torque, push = recording["torque"].reshape(rows, p), np.zeros((rows, p))
        driven = False
        if imperfect or "radii" in recording.meta:
            applied = on_nu(robot, recording["position"].reshape(rows, -1), recording["applied"].reshape(rows, -1))
            other = not np.allclose(applied, torque, rtol=1e-9, atol=1e-9 * np.abs(torque).max(initial=0.0))
            driven, torque = imperfect and other, applied if other else torque
        if "disturbance" in recording:
            push = recording["disturbance"].reshape(rows, p)
        _, load = payload(events)
        changes = driven or any(changing(one, timing.control_period) for one in events if isinstance(one, Push))
        return cls(
            torque=torque,
            push=push,
            load=load,
            loaded=None if load is None else carrying(robot, load.mass, load.joint, load.at),
            pick=np.inf if load is None else load.start,
            drop=np.inf if load is None else load.end,
            varies=changes and timing.steps_per_control > 1,
            blocked=has(events, BlockedJoint),
            senses=has(events, FrozenEncoder, Messages),
        )


def on_nu(robot: Robot, positions: Array, motors: Array) -> Array:
    """Generalized torques (N, p) of motor torques (N, motors) at positions (N, nv) of one run, from its start on."""
    if not robot.steers:
        return np.asarray(motors @ robot.E.T)
    dynamics, still = Dynamics(robot), np.zeros(robot.dimensions.dof)
    found = np.zeros((len(motors), still.size))
    for position, torque, out in zip(positions, motors, found, strict=True):
        dynamics.refresh(position, still)
        out[:] = dynamics.T.T @ (robot.E_full @ torque)
    return found


def has(events: tuple[Disturbance, ...], *kinds: type) -> bool:
    """Whether there is a disturbance of one of these kinds."""
    return any(isinstance(one, kinds) for one in events)


def changing(push: Push, period: float) -> bool:
    """Whether a push changes within control periods: by its shape, or as it begins or ends between two samples."""
    edges = [edge / period for edge in (push.start, push.end) if np.isfinite(edge)]
    return push.shape in ("impulse", "sine") or any(abs(edge - round(edge)) > 1e-6 for edge in edges)
