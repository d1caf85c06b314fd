"""The judge's plant: rigid bodies as the compiled twin has them; friction, drives and integration are its own.

A motor j has a rotor behind an elastic gear, whose link side turns with `v_j = c' T nu`:

    u' = (command - u) / lag,                             command clipped at the motor's limit, late by a delay
    J omega' = u - F - friction(omega, z, F),             F = k delta + d (omega - v)
    delta' = omega - v - |v| delta / sigma                sigma = inf for a gear: it does not creep
    M nudot + C nu + gravity = T' (F at the motors' joints - friction of joints without a motor)

For a wheel the spring is its tyre, the single contact point model with a relaxation length (H. B. Pacejka, Tire and
Vehicle Dynamics, 3rd ed. 2012, ch. 7), whose spring saturates at its grip, `grip tanh(k delta / grip)`: it creeps by
`delta / sigma`, and spins where the grip is used up. Sideways no wheel slips here; MuJoCo's do.

Friction is LuGre (C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, IEEE TAC 40(3), 1995), its level that of
A. C. Bittencourt and S. Gunnarsson (ASME J. Dyn. Sys. Meas. Control 134(5), 2012): it depends on the load of the gear
and on the temperature, which rises during a run:

    z' = (v - a z) / (1 + a / 2000),     a = sigma0 |v| / g
    friction = sigma0 z + sigma1 exp(-(v / v_d)^2) z' + viscous (1 + thick exp(-t / warm)) v
    g = (1 + stiff exp(-t / warm)) (coulomb + share_c |F| + (static + share_s |F|) exp(-|v / v_s|^1.3))

The divisor, which LuGre has not, lets a bristle relax in no less than half a millisecond: steady friction and what is
near rest stay as they are, and an explicit step can follow. All of it is one ordinary differential equation, stepped
by the classical RK4.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from mmnn_pin.by_address import by_address
from mmnn_pin.compiled import compiled, copy_to, internal, linked
from mmnn_pin.model.reduction import position_rate, solve
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.tree.body import Body, Work, body_of, evaluate, new_work, turn_wheels
from mmnn_pin.signals import Array, IntArray

FASTEST = 2000.0  # at which a bristle relaxes [1/s]
ENCODER = 1e-3  # between two readings of an encoder by its drive [s]


class Column(NamedTuple):
    """Columns of a table of friction, one row per joint.

    Attributes:
        coulomb: [N m or N].
        static: What static friction adds [N m or N].
        share: Of the load's amount, that adds to Coulomb's and to the static level.
        speed: Stribeck's [rad/s or m/s].
        viscous: [N m s or N s/m].
        thick, stiff: By how much viscous friction, and the level, are larger when cold.
        warm: Time constant of warming [s].
        bristle: sigma0 [N m/rad or N/m].
        damping: sigma1 [N m s or N s/m].
        fade: v_d [rad/s or m/s].
    """

    coulomb: int = 0
    static: int = 1
    share: int = 2
    static_share: int = 3
    speed: int = 4
    viscous: int = 5
    thick: int = 6
    stiff: int = 7
    warm: int = 8
    bristle: int = 9
    damping: int = 10
    fade: int = 11


AT = Column()


@by_address
class World(NamedTuple):
    """What the plant adds to rigid bodies, by motor (m,) and by joint without one (k,).

    Attributes:
        rows: Rows of the motors' joints among all velocities.
        rotor: J, seen through the gear [kg m^2 or kg].
        spring: k [N m/rad or N/m].
        damper: d [N m s/rad or N s/m].
        creep: 1 / sigma, 0 for a gear [1/rad].
        grip: Largest force of a tyre, inf for a gear [N m].
        limit: Of the motors [N m or N].
        lag: Of the current loops [s].
        friction: (m, 12) of the motors, `Column`.
        free: Rows of joints without a motor that have friction.
        drag: (k, 12) their friction.
    """

    rows: IntArray
    rotor: Array
    spring: Array
    damper: Array
    creep: Array
    grip: Array
    limit: Array
    lag: float
    friction: Array
    free: IntArray
    drag: Array


@by_address
class Parts(NamedTuple):
    """Views of a state `y`, or of its derivative.

    Attributes:
        position: (nv,) as of the package.
        nu: (p,).
        twist: (m,) delta [rad or m].
        omega: (m,) of the rotors.
        turned: (m,) angles of the rotors.
        torque: (m,) u.
        z: (m,) bristles of the motors' friction.
        drag: (k,) of the joints without one.
    """

    position: Array
    nu: Array
    twist: Array
    omega: Array
    turned: Array
    torque: Array
    z: Array
    drag: Array


@by_address
class Drives(NamedTuple):
    """Encoders, odometry and localisation.

    Attributes:
        nominal: The robot as told, with work.
        position: (nv,) in which measured pivots are put for it.
        base: Motors of the base, (b,).
        link: (m, 2) 1 where the angle, and the rate, are read behind the gear.
        step: (m,) resolution [rad or m].
        keep: Of a filtered rate after a reading.
        last: (m, 2) last readings.
        rate: (m,) filtered.
        pose: (3,) as estimated.
        fixes: (N, 3) noise of the localisation's fixes.
        trust: Share of a fix that is taken.
        between: Readings between two fixes.
        pivots: Rows of the pivots that are measured, and their resolution [rad].
        S: (b, nb), A, L: (nb, nb), found, right, part: (nb,) scratch; wide: (p,) scratch.
    """

    nominal: Body
    work: Work
    position: Array
    base: IntArray
    link: IntArray
    step: Array
    keep: float
    last: Array
    rate: Array
    pose: Array
    fixes: Array
    trust: float
    between: int
    pivots: IntArray
    pivot_step: float
    S: Array
    A: Array
    L: Array
    found: Array
    right: Array
    wide: Array


@by_address
class Plant(NamedTuple):
    """A run's plant.

    Attributes:
        body, loaded: The robot without and with its payload, both without friction.
        work: Scratch of theirs.
        world: Drives and friction.
        y, trial, ydot, total: (size,) state and scratch.
        state, at, rate: Views of y, trial, ydot.
        full: (nv,) forces on joints, scratch; tau, rest: (p,).
        commands: (N, m) as sent.
        arrive: (N,) the step at which each begins to act.
        counter: (2,) the next step, the command that acts.
        dt: Step [s].
        per_reading: Steps between two readings.
        carries: First and last step with the payload.
        drives: Sensors.
    """

    body: Body
    loaded: Body
    work: Work
    world: World
    y: Array
    trial: Array
    ydot: Array
    total: Array
    state: Parts
    at: Parts
    rate: Parts
    full: Array
    rest: Array
    commands: Array
    arrive: IntArray
    counter: IntArray
    dt: float
    per_reading: int
    carries: IntArray
    drives: Drives


def parts_of(y: Array, nv: int, p: int, m: int) -> Parts:
    """Views of a state."""
    ends = np.cumsum([nv, p, m, m, m, m, m])
    return Parts(*np.split(y, ends))


@compiled
def lugre(f: Array, v: float, z: float, load: float, time: float) -> tuple[float, float]:
    """Friction at a velocity, and the bristle's rate; f is a row of `Column`."""
    cold = math.exp(-time / f[AT.warm])
    speed = abs(v)
    curve = math.exp(-((speed / f[AT.speed]) ** 1.3))
    level = f[AT.coulomb] + f[AT.share] * abs(load) + (f[AT.static] + f[AT.static_share] * abs(load)) * curve
    level *= 1.0 + f[AT.stiff] * cold
    relaxes = f[AT.bristle] * speed / level if level > 0.0 else 0.0
    rate = (v - relaxes * z) / (1.0 + relaxes / FASTEST)
    sticky = f[AT.bristle] * z + f[AT.damping] * math.exp(-((v / f[AT.fade]) ** 2)) * rate
    return sticky + f[AT.viscous] * (1.0 + f[AT.thick] * cold) * v, rate


@internal
def drive_rates(time: float, command: Array, plant: Plant) -> None:
    """Rates of everything but nu at the trial state, the maps there, and the forces on all joints, into `full`."""
    w, at, rate, v, full = plant.world, plant.at, plant.rate, plant.work.v, plant.full
    full[:] = 0.0
    for j in range(w.rows.size):
        i = w.rows[j]
        slide = at.omega[j] - v[i]
        force = w.spring[j] * at.twist[j]
        if w.creep[j] > 0.0:
            force = w.grip[j] * math.tanh(force / w.grip[j])
        force += w.damper[j] * slide
        resist, rate.z[j] = lugre(w.friction[j], at.omega[j], at.z[j], force, time)
        asked = min(max(command[j], -w.limit[j]), w.limit[j])
        rate.twist[j] = slide - w.creep[j] * abs(v[i]) * at.twist[j]
        rate.omega[j] = (at.torque[j] - force - resist) / w.rotor[j]
        rate.turned[j] = at.omega[j]
        rate.torque[j] = (asked - at.torque[j]) / w.lag
        full[i] += force
    for k in range(w.free.size):
        i = w.free[k]
        resist, rate.drag[k] = lugre(w.drag[k], v[i], at.drag[k], 0.0, time)
        full[i] -= resist


@linked
def rates(time: float, command: Array, body: Body, plant: Plant) -> None:
    """Derivative of the whole state at `trial`, into `ydot`.

    Args:
        time: [s].
        command: (m,) of the motors, held.
        body: The robot, with or without payload.
        plant: The plant.
    """
    work, at, rate = plant.work, plant.at, plant.rate
    evaluate(body, work, at.position, at.nu)
    drive_rates(time, command, plant)
    position_rate(at.position, at.nu, work.v, body.base, body.sideways, work.maps.eta, rate.position)
    for a in range(at.nu.size):
        plant.rest[a] = -work.h[a]
        for i in range(plant.full.size):
            plant.rest[a] += work.maps.T[i, a] * plant.full[i]
    solve(work.M, plant.rest, work.L, rate.nu)


@linked
def advance(until: int, plant: Plant) -> None:
    """Step until a number of steps is done: commands come in, the robot moves, encoders are read."""
    counter, dt, y = plant.counter, plant.dt, plant.y
    while counter[0] < until:
        step = counter[0]
        while counter[1] + 1 < plant.arrive.size and plant.arrive[counter[1] + 1] <= step:
            counter[1] += 1
        command = plant.commands[counter[1]]
        body = plant.loaded if plant.carries[0] <= step < plant.carries[1] else plant.body
        plant.total[:] = 0.0
        copy_to(y, plant.trial)
        for stage in range(4):
            ahead = 0.0 if stage == 0 else dt if stage == 3 else 0.5 * dt
            if stage > 0:
                for i in range(y.size):
                    plant.trial[i] = y[i] + ahead * plant.ydot[i]
            rates(step * dt + ahead, command, body, plant)
            share = dt / 6.0 if stage == 0 or stage == 3 else dt / 3.0
            for i in range(y.size):
                plant.total[i] += share * plant.ydot[i]
        for i in range(y.size):
            y[i] += plant.total[i]
        counter[0] = step + 1
        if counter[0] % plant.per_reading == 0:
            read(counter[0] // plant.per_reading, plant.state, plant.drives, plant.world.rows)


@compiled
def reading(j: int, side: int, state: Parts, drives: Drives, rows: IntArray) -> float:
    """What the encoder of motor j reads, before its gear (side 0) or behind it."""
    angle = state.position[rows[j]] if side else state.turned[j]
    return float(drives.step[j] * math.floor(angle / drives.step[j] + 0.5))


@internal
def base_rates(rates: Array, drives: Drives, rows: IntArray) -> None:
    """Base velocities (nb,), into `found`, that suit the motors' rates (m,) best, as the nominal robot has it."""
    T, S, A = drives.work.maps.T, drives.S, drives.A
    b, nb = S.shape
    for k in range(b):
        for a in range(nb):
            S[k, a] = T[rows[drives.base[k]], a]
    for a in range(nb):
        drives.right[a] = 0.0
        for k in range(b):
            drives.right[a] += S[k, a] * rates[drives.base[k]]
        for c in range(nb):
            A[a, c] = 0.0
            for k in range(b):
                A[a, c] += S[k, a] * S[k, c]
    solve(A, drives.right, drives.L, drives.found)


@linked
def read(number: int, state: Parts, drives: Drives, rows: IntArray) -> None:
    """One reading of all encoders; the pose goes on with the wheels, and is corrected at a fix."""
    d, nb = drives, drives.found.size
    for j in range(rows.size):
        place, angle = reading(j, d.link[j, 0], state, d, rows), reading(j, d.link[j, 1], state, d, rows)
        d.rate[j] = d.keep * d.rate[j] + (1.0 - d.keep) * (angle - d.last[j, 1]) / ENCODER
        d.last[j, 0], d.wide[j], d.last[j, 1] = place, (angle - d.last[j, 1]) / ENCODER, angle
    if nb == 0:
        return
    turn_pivots(state, d)
    base_rates(d.wide, d, rows)
    nominal, eta = d.nominal, d.work.maps.eta
    vx, vy, w = d.found[0], d.found[1] if nominal.sideways else 0.0, d.found[nb - 1]
    if eta.size:
        V = d.work.maps.V[0]
        vx, vy, w = 0.0, 0.0, 0.0
        for a in range(nb):
            vx, vy, w = vx + V[0, a] * d.found[a], vy + V[1, a] * d.found[a], w + V[2, a] * d.found[a]
    heading = d.pose[2] + 0.5 * ENCODER * w
    c, s = math.cos(heading), math.sin(heading)
    d.pose[0] += ENCODER * (c * vx - s * vy)
    d.pose[1] += ENCODER * (s * vx + c * vy)
    d.pose[2] += ENCODER * w
    if number % d.between == 0:
        for i in range(3):
            d.pose[i] += d.trust * (state.position[i] + d.fixes[number // d.between, i] - d.pose[i])


@internal
def turn_pivots(state: Parts, drives: Drives) -> None:
    """Maps of the nominal robot at the pivots as they are measured."""
    d = drives
    for k in range(d.pivots.size):
        i = d.pivots[k]
        d.position[i] = d.pivot_step * math.floor(state.position[i] / d.pivot_step + 0.5)
    turn_wheels(d.nominal.rolling, d.nominal.tree, d.position, d.work.rest, d.work)


@linked
def tell(drives: Drives, rows: IntArray, seen: Array) -> None:
    """What a controller is told: pose, base velocity, q, qdot, pivots, side by side in `seen`."""
    d, nb, m = drives, drives.found.size, rows.size
    n, k = m - d.base.size, 0
    if nb:
        base_rates(d.rate, d, rows)
        k = 3 + nb
        copy_to(d.pose, seen[:3])
        copy_to(d.found, seen[3:k])
    for j in range(n):
        seen[k + j], seen[k + n + j] = d.last[m - n + j, 0], d.rate[m - n + j]
    for i in range(d.pivots.size):
        seen[k + 2 * n + i] = d.position[d.pivots[i]]


def motor_rows(robot: Robot) -> IntArray:
    """The row of every motor's joint among all velocities.

    >>> from mmnn_pin import load
    >>> motor_rows(load("two_axis_arm")).tolist()
    [0, 1]
    """
    rows = np.argmax(robot.E_full != 0.0, axis=0)
    assert (robot.E_full[rows, np.arange(len(rows))] == 1.0).all() and np.count_nonzero(robot.E_full) == len(rows)
    return rows


def new_drives(robot: Robot, samples: int, **given: Any) -> Drives:
    """Sensors of a robot as told, over a number of readings; fields that are not given are exact and fast."""
    body, m, nb = body_of(robot), robot.dimensions.motors, robot.dimensions.base
    b = m - robot.dimensions.arm
    usual: dict[str, Any] = {
        "link": np.zeros((m, 2), np.int64), "step": np.full(m, 1e-12), "keep": 0.0, "pose": np.zeros(3),
        "fixes": np.zeros((samples + 2, 3)), "trust": 1.0, "between": 1, "pivot_step": 1e-12,
    }  # fmt: skip
    return Drives(
        nominal=body, work=new_work(body), position=robot.neutral_position(), base=np.arange(b),
        last=np.zeros((m, 2)), rate=np.zeros(m), pivots=np.array(robot.shape_index, np.int64),
        S=np.zeros((b, nb)), A=np.zeros((nb, nb)), L=np.zeros((nb, nb)), found=np.zeros(nb), right=np.zeros(nb),
        wide=np.zeros(m), **(usual | given),
    )  # fmt: skip


def new_plant(
    true: Robot,
    loaded: Robot | None,
    world: World,
    start: tuple[Array, Array],
    timing: tuple[float, int],
    drives: Drives,
    carries: IntArray | None = None,
) -> Plant:
    """A plant at rest.

    Args:
        true: The robot that moves.
        loaded: The same with its payload.
        world: Drives and friction.
        start: Position (nv,), and the torques (m,) that motors and gears begin with.
        timing: Step [s], number of control samples.
        drives: Its sensors.
        carries: First and last step with the payload.
    """
    (position, held), (dt, samples) = start, timing
    body = body_of(true.without_friction())
    m, (nv, p) = world.rows.size, body.T.shape
    y, trial, ydot, total = np.zeros((4, nv + p + 5 * m + world.free.size))
    state = parts_of(y, nv, p, m)
    state.position[:], state.torque[:], state.twist[:] = position, held, held / world.spring
    state.turned[:] = position[world.rows] + state.twist
    begin_reading(state, drives, world.rows)
    commands, arrive = np.zeros((samples + 1, m)), np.full(samples + 1, 2**62)
    commands[0], arrive[0] = held, 0
    return Plant(
        body, body if loaded is None else body_of(loaded.without_friction()), new_work(body), world, y, trial, ydot,
        total, state, parts_of(trial, nv, p, m), parts_of(ydot, nv, p, m), np.zeros(nv), np.zeros(p), commands, arrive,
        np.zeros(2, np.int64), dt, round(ENCODER / dt), np.zeros(2, np.int64) if carries is None else carries, drives,
    )  # fmt: skip


def begin_reading(state: Parts, drives: Drives, rows: IntArray) -> None:
    """The first reading: encoders stand where they are, the pose is known."""
    for j in range(rows.size):
        for side in (0, 1):
            drives.last[j, side] = reading(j, int(drives.link[j, side]), state, drives, rows)
    turn_pivots(state, drives)
    drives.pose[:] = state.position[:3] if len(drives.found) else 0.0


class Moved:
    """A plant as a run moves it.

    Args:
        plant: The plant.

    Attributes:
        position: (nv,) where it is.
        commands: (N, m) of its motors; the one of sample k stands at k + 1.
        dt: Step [s].
    """

    def __init__(self, plant: Plant) -> None:
        self.plant, self.position, self.commands, self.dt = plant, plant.state.position, plant.commands, plant.dt

    def tell(self, seen: Array) -> None:
        """Write what a controller is told."""
        tell(self.plant.drives, self.plant.world.rows, seen)

    def advance(self, until: int) -> None:
        """Step until a number of steps is done."""
        advance(until, self.plant)
