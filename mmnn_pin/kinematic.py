"""From pose error to velocity command: the law of the base, Kanayama's (3.1)-(3.3) or its like, and the arm's error.

The laws stand with the bases that they drive (`model.base`). The arm's part is the filtered error (3.10), (3.11); a
fixed arm has nothing else. Everything is computed from the reference and the Measurement; the derivative of the
command is analytic, taken along the error kinematics with the measured velocities.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np

from .by_address import by_address
from .compiled import compiled, copy_to, internal, linked
from .elementary import cos_sin
from .errors import ConfigError
from .model.base import kind_of, velocity_command
from .model.base.rolling import PASSIVE, ROLES, Maps, Rolling, new_maps, roll
from .model.base.steered import Articulated, SteeredBase
from .model.base.steering_law import SteeringNumbers, steered_velocity
from .model.base.trailers import towed, towing, trailer_pose
from .model.reduction import shares
from .model.structure import Structure
from .parts import view
from .settings import Settings, one_or_each, require_gains
from .signals import INDEX, SIDEWAYS, Array, Dimensions, IntArray

POSE_REF, VELOCITY_REF, ACCELERATION_REF = INDEX["pose_ref"], INDEX["velocity_ref"], INDEX["acceleration_ref"]
Q_REF, QDOT_REF, QDDOT_REF = INDEX["q_ref"], INDEX["qdot_ref"], INDEX["qddot_ref"]
POSE, VELOCITY, Q, QDOT = INDEX["pose"], INDEX["velocity"], INDEX["q"], INDEX["qdot"]
ALPHA, ALPHADOT, POSE_ERROR, Z = INDEX["alpha"], INDEX["alphadot"], INDEX["pose_error"], INDEX["z"]
WORLD_ERROR, SHAPE = INDEX["world_error"], INDEX["shape"]
MOMENT = 1e-4  # over which the second derivative of a command is taken [s]
E, EDOT, R, NU_REF, NUDOT_REF = INDEX["e"], INDEX["edot"], INDEX["r"], INDEX["nu_ref"], INDEX["nudot_ref"]


@compiled
def wrap(angle: float) -> float:
    """Angle wrapped to (-pi, pi] [rad]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


@compiled
def body_error(pose_ref: Array, pose: Array, error: Array) -> None:
    """Pose error in the base frame, `e_p = T_e(phi) (q_vd - q_v)` (3.1), heading wrapped; writes error (3,)."""
    dx, dy = pose_ref[0] - pose[0], pose_ref[1] - pose[1]
    c, s = cos_sin(pose[2])
    error[0] = c * dx + s * dy
    error[1] = c * dy - s * dx
    error[2] = wrap(pose_ref[2] - pose[2])


@compiled
def world_error(pose_ref: Array, pose: Array, error: Array) -> None:
    """Pose error in the world frame, `q_vd - q_v`, heading wrapped; writes error (3,)."""
    error[0], error[1] = pose_ref[0] - pose[0], pose_ref[1] - pose[1]
    error[2] = wrap(pose_ref[2] - pose[2])


@compiled
def errors_of(pose_ref: Array, pose: Array, error: Array, in_world: Array) -> None:
    """Pose error in the base frame and in the world frame, (3,) each."""
    body_error(pose_ref, pose, error)
    world_error(pose_ref, pose, in_world)


@by_address
class Steering(NamedTuple):
    """The steering of one robot's base, for the velocity command: its maps at the measured angles, and its law."""

    rolling: Rolling  # the base, its pivots placed as in `position`
    maps: Maps  # its maps, T for the twist, the pivots and the wheels alone
    numbers: SteeringNumbers  # of the law that steers
    motors: IntArray  # rows of that T of the base's motors
    E: Array  # (p, motors) torque on nu from motor torques, at the measured angles
    E_inv: Array  # (motors, p) motor torques from the torque on nu, likewise
    factor: Array  # (2, nb, nb) scratch
    later: Array  # (8, 3) scratch: `eta_c`, its rate and the rate of that; then what the law is asked a moment later
    position: Array  # (3 + shape,) scratch: measured angles behind a pose that nobody reads
    eta: Array  # (3,) scratch: velocity of what is guided
    h: float  # control period [s]
    # (4,) of the trailer that is guided: place of its pivot in `position`, its sign, and h and L of `base.trailers`;
    # (0,) where the base is
    hitch: Array


@internal
def steer(row: Array, at: IntArray, steering: Steering) -> None:
    """The maps of a base at its measured angles and velocity, into `steering`."""
    maps, nb = steering.maps, steering.factor.shape[1]
    copy_to(view(row, at, SHAPE), steering.position[3:])
    roll(steering.rolling, steering.position, view(row, at, VELOCITY), maps)
    shares(maps.T, steering.motors, steering.factor, steering.E_inv)
    for m in range(steering.motors.size):
        for i in range(nb):
            steering.E[i, m] = maps.T[steering.motors[m], i]


@linked
def see(row: Array, at: IntArray, steering: Steering, seen: Array) -> None:
    """A measurement of what is guided as a reference has it, pose, twist, q, qdot; n goes on by `steer` alone."""
    before, hitch = steering.later[7], steering.hitch
    copy_to(steering.maps.n, before)
    steer(row, at, steering)
    copy_to(before, steering.maps.n)
    pose, twist, n = at[VELOCITY] - at[POSE], at[ACCELERATION_REF] - at[VELOCITY_REF], at[Q + 1] - at[Q]
    copy_to(view(row, at, POSE), seen[:pose])
    for i in range(twist):
        seen[pose + i] = steering.maps.eta[i if at[SIDEWAYS] or i == 0 else 2]
    if hitch.size:
        gamma = hitch[1] * steering.position[int(hitch[0])]
        before[0], before[1] = seen[pose], seen[pose + 1]
        towed(hitch[2:], gamma, before, seen[pose : pose + twist])
        trailer_pose(hitch[2:], gamma, view(row, at, POSE), seen[:pose])
    copy_to(view(row, at, Q), seen[pose + twist : pose + twist + n])
    copy_to(view(row, at, QDOT), seen[pose + twist + n :])


@internal
def steered(row: Array, at: IntArray, gains: Array, before: Array, steering: Steering) -> None:
    """Fill alpha and alphadot of a base that steers: the law of its pose, and below it the law that steers.

    The second derivative of what the pose's law asks for is taken a moment later along the motion as asked.

    Args:
        row: (width,) row of signals with the pose error.
        at: Offsets of the signals.
        gains: As of `command`.
        before: The setpoint of the sample before, side by side.
        steering: Of the base; its maps are those of this sample.
    """
    o, eta, sideways, hitch = steering.later, steering.eta, at[SIDEWAYS], steering.hitch
    v_ref, a_ref, error = view(row, at, VELOCITY_REF), view(row, at, ACCELERATION_REF), view(row, at, POSE_ERROR)
    twist, c, cd = o[3], o[0], o[1]
    o[:] = 0.0
    copy_to(steering.maps.eta, eta)
    for i in range(v_ref.size):
        twist[i] = eta[i if sideways or i == 0 else 2]
    gamma, gammadot = 0.0, 0.0
    if hitch.size:
        gamma = hitch[1] * steering.position[int(hitch[0])]
        c[0], c[1] = twist[0], twist[1]
        towed(hitch[2:], gamma, c, twist)
        gammadot = twist[1] - c[1]
        eta[0], eta[2] = twist[0], twist[1]
    vx, vy, w = v_ref[0], v_ref[1] if sideways else 0.0, v_ref[v_ref.size - 1]
    jogs = steering.numbers.waist and error[0] == 0.0 and error[1] == 0.0 and error[2] == 0.0
    if jogs and not hitch.size:  # its reference goes where the base is: no error comes
        copy_to(v_ref, twist)
        eta[0], eta[1], eta[2] = vx, vy, w
    velocity_command(sideways, error, v_ref, a_ref, twist, gains, c, cd)
    moved, v_later, a_later, cd_later = o[4], o[5], o[6], o[2]  # o[7]: the command itself
    (cosine, sine), first = cos_sin(error[2]), at[ACCELERATION_REF] - at[POSE_REF]
    moved[0] = error[0] + MOMENT * (eta[2] * error[1] - eta[0] + cosine * vx - sine * vy)
    moved[1] = error[1] + MOMENT * (-eta[2] * error[0] - eta[1] + sine * vx + cosine * vy)
    moved[2] = error[2] + MOMENT * (w - eta[2])
    for i in range(v_ref.size):
        v_later[i] = v_ref[i] + MOMENT * a_ref[i]
        a_later[i] = a_ref[i] + MOMENT * (a_ref[i] - before[first + i]) / steering.h
        twist[i] += MOMENT * cd[i]
    velocity_command(sideways, moved, v_later, a_later, twist, gains, o[7], cd_later)
    if hitch.size:
        towing(hitch[2:], gamma + MOMENT * gammadot, twist, o[7], cd_later)
        for i in range(2):
            twist[i] -= MOMENT * cd[i]
        towing(hitch[2:], gamma, twist, c, cd)
    for i in range(v_ref.size):
        cd_later[i] = (cd_later[i] - cd[i]) / MOMENT
    if not sideways:
        for i in range(3):
            o[i, 2] = o[i, 1]
            o[i, 1] = 0.0
    alpha, alphadot = view(row, at, ALPHA), view(row, at, ALPHADOT)
    nu = view(row, at, VELOCITY)
    steered_velocity(steering.rolling, steering.position, nu, steering.maps, steering.numbers, o, jogs, alpha, alphadot)


@internal
def command(row: Array, at: IntArray, gains: Array, K: Array, before: Array, steering: Steering | None) -> None:
    """Velocity command of one sample: fills alpha ... nudot_ref of the row from its reference and measurement.

    Args:
        row: (width,) row of signals.
        at: offsets of the signals (`Layout.offsets`).
        gains: (3,) of the law that fits the base (`Kinematic.base_gains`); unused for a fixed arm.
        K: (n,) gain of the filtered error [1/s].
        before: The setpoint of the sample before, side by side; only a base that steers asks for it.
        steering: Of a base that steers, its maps those of this sample; None for others.
    """
    nu_ref, nudot_ref = view(row, at, NU_REF), view(row, at, NUDOT_REF)
    nb, n = at[ALPHA + 1] - at[ALPHA], at[E + 1] - at[E]
    if nb:
        error, velocity = view(row, at, POSE_ERROR), view(row, at, VELOCITY)
        alpha, alphadot, z = (view(row, at, ALPHA), view(row, at, ALPHADOT), view(row, at, Z))
        pose_ref, pose = view(row, at, POSE_REF), view(row, at, POSE)
        errors_of(pose_ref, pose, error, view(row, at, WORLD_ERROR))
        if steering is not None:
            if steering.hitch.size:
                guided = steering.later[0]
                trailer_pose(
                    steering.hitch[2:], steering.hitch[1] * steering.position[int(steering.hitch[0])], pose, guided
                )
                errors_of(pose_ref, guided, error, view(row, at, WORLD_ERROR))
            steered(row, at, gains, before, steering)
        else:
            v_ref, a_ref = (view(row, at, VELOCITY_REF), view(row, at, ACCELERATION_REF))
            velocity_command(at[SIDEWAYS], error, v_ref, a_ref, velocity, gains, alpha, alphadot)
        for i in range(nb):
            z[i] = alpha[i] - velocity[i]  # Eqn. 3.6
            nu_ref[i], nudot_ref[i] = alpha[i], alphadot[i]
    for i in range(n):
        e, edot = row[at[Q_REF] + i] - row[at[Q] + i], row[at[QDOT_REF] + i] - row[at[QDOT] + i]  # Eqn. 3.10
        row[at[E] + i], row[at[EDOT] + i] = e, edot
        row[at[R] + i] = edot + K[i] * e  # Eqn. 3.11
        nu_ref[nb + i] = row[at[QDOT_REF] + i] + K[i] * e
        nudot_ref[nb + i] = row[at[QDDOT_REF] + i] + K[i] * edot


def by_name(names: tuple[str, ...], gains: Array) -> dict[str, Array]:
    """Gains of a base as `Kinematic.base_gains` has them, by the fields that they are of, arrays of one or more."""
    ends = np.cumsum([np.size(getattr(Kinematic(), name)) for name in names])
    return dict(zip(names, np.split(gains, ends[:-1]), strict=True)) if names else {}


class Kinematic(Settings, frozen=True):
    """Gains of the kinematic layer.

    Args:
        kx: Differential drive: gain of the error along the heading [1/s].
        ky: Differential drive: gain of the lateral error [1/m^2].
        kth: Differential drive: gain of the heading error [1/m].
        K: Gain of the arm's filtered error `r = edot + K e`, one number or one per joint [1/s].
        holonomic: Holonomic base: gains of the errors along x, along y and of the heading [1/s].
        steering: Base that steers: how fast a wheel turns to its path, K of `steering_law` [1/s].
        slow: Base that steers: speed of a wheel under which it steers less, so that it coasts at rest [m/s].
        align: Base that steers: whether it waits for wheels that do not stand along their paths.
        guide: What follows the reference, the "base" or, where it backs, its "trailer"; of a loader the other axle.

    Raises:
        ConfigError: A gain is negative or not finite.
    """

    kx: float = 10.0
    ky: float = 64.0
    kth: float = 16.0
    K: float | tuple[float, ...] = 7.0
    holonomic: tuple[float, float, float] = (5.0, 5.0, 5.0)
    steering: float = 6.0
    slow: float = 0.03
    align: bool = False
    guide: Literal["base", "trailer"] = "base"

    def __post_init__(self) -> None:
        require_gains(self, "kinematic")

    def base_gains(self, layout: Dimensions) -> Array:
        """Gains of the law of a robot's base, (3,), and of the law that steers; zeros for a fixed arm, without one."""
        names = kind_of(layout).gain_names
        return np.hstack([getattr(self, name) for name in names]).astype(float) if names else np.zeros(3)

    def steering_of(self, robot: Structure, period: float) -> Steering | None:
        """The steering of a robot's base, at a control period [s]; None where nothing steers.

        Raises:
            ConfigError: Wheels turn to their paths in less than a period.
        """
        base, d = robot.base, robot.dimensions
        if not isinstance(base, SteeredBase):
            return None
        if base.masters and not self.steering * period < 1.0:
            what, why = (
                f"{self.steering:g} at a control period of {period:g} s",
                "a wheel passes its path in one sample",
            )
            raise ConfigError(what, why=why, fix=f"take at most {0.5 / period:g}", key="kinematic.steering")
        names = [*base.shape, *(wheel.joint for wheel in base.wheels)]
        places = {name: 3 + i for i, name in enumerate(names)}
        rolling = base.rolling_at(places)
        T, driven = np.zeros((3 + len(names), d.base)), robot.actuator_names[: d.motors - d.arm]
        E_inv = np.zeros((d.motors, d.dof))
        E_inv[d.motors - d.arm :, d.base :] = np.eye(d.arm)
        return Steering(
            rolling=rolling,
            maps=new_maps(rolling, T),
            numbers=SteeringNumbers(self.steering, self.slow, self.align, isinstance(base, Articulated)),
            motors=np.array([places[name] for name in driven], np.int64),
            E=np.array(robot.E_at(robot.rest)),
            E_inv=E_inv,
            factor=np.zeros((2, d.base, d.base)),
            later=np.zeros((8, 3)),
            position=np.zeros(3 + d.shape),
            eta=np.zeros(3),
            h=float(period),
            hitch=self.hitch_of(robot, places),
        )

    def hitch_of(self, robot: Structure, places: Mapping[str, int]) -> Array:
        """The trailer of a robot that is guided, as of `Steering.hitch`; (0,) where its base is.

        Args:
            robot: The robot.
            places: Place of every pivot in a position.

        Raises:
            ConfigError: It has not one trailer on a hitch that is not on the axle.
        """
        if self.guide == "base":
            return np.zeros(0)
        base = robot.base
        pivots = base.pivots if isinstance(base, SteeredBase) and not base.sideways else ()
        hitches = [p for p in pivots if p.role == ROLES[PASSIVE] or isinstance(base, Articulated)]
        if len(hitches) != 1 or hitches[0].x == 0.0:
            what = f"'{robot.name}' has {len(hitches)} trailers" if len(hitches) != 1 else "its hitch is on the axle"
            why, fix = "one trailer whose hitch is off the axle can be guided", "guide the base"
            raise ConfigError(what, why=why, fix=fix, key="kinematic.guide")
        p = hitches[0]
        return np.array([places[p.joint], p.sign, -p.x, -p.wheel[0]])

    def pose_weights(self, layout: Dimensions) -> Array | None:
        """Weights of the squares of the errors of a base's velocities in its pose error, (base,); None for all alike.

        They are second derivatives of the Lyapunov function of the pose error (`Base.pose_weights`).
        """
        return kind_of(layout).pose_weights(self.base_gains(layout))

    def arm_gains(self, layout: Dimensions) -> Array:
        """K for every joint, shape (n,).

        Raises:
            ConfigError: Neither one gain nor one per joint.
        """
        return one_or_each(self.K, layout.arm, "joint", "kinematic.K")
