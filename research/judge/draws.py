"""Draws of the judge: of a robot, a family and a number, everything that a run has beside its controller."""

from __future__ import annotations

import tomllib
import zlib
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mmnn_pin import load
from mmnn_pin.compiled import one_thread
from mmnn_pin.elementary.matrices import inverse, pseudo_inverse
from mmnn_pin.loop.before_run import Start
from mmnn_pin.loop.suited import MotorLoad, followable, mass_matrices
from mmnn_pin.model.robot import Robot, carrying, revolute
from mmnn_pin.model.structure import bodies_of
from mmnn_pin.model.tree.twin import terms_of
from mmnn_pin.reference import BasePath, Circle, Eight, HolonomicPath, Sine, Sines, Trajectory, Waypoints
from mmnn_pin.signals import Array, Setpoint

from .plant import AT, ENCODER, Drives, Plant, World, motor_rows, new_drives, new_plant

FILE = Path(__file__).with_name("preregistered.toml")
STEP = 2.5e-4  # of the plant, at most [s]
SHAKES = 0.5  # radians of its fastest oscillation that a step may be
POSTURES = 9  # along a reference at which inertias are taken
TENTH = 0.1  # of a metre: what counts as a radian
SLIDES = 1.0 / 30.0  # of a radian that a sliding joint moves, in metres
WHEELS = 5.0  # times an arm joint's speed: a wheel's


@cache
def preregistered() -> dict[str, Any]:
    """What the judge's file says."""
    return tomllib.loads(FILE.read_text(encoding="utf-8"))


@cache
def on_contact() -> dict[str, Any]:
    """What the file of the second plant says."""
    return tomllib.loads(FILE.with_name("preregistered_contact.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Draw:
    """One draw.

    Attributes:
        robot: As controllers are told it.
        true: The one that moves, `loaded` the same with its payload.
        trajectory: The reference.
        table: (samples, ...) its setpoints.
        said: What was drawn, by name: numbers for whole robots, (m,) where motors differ.
        rng: Seed of what is drawn sample by sample.
    """

    robot: Robot
    true: Robot
    loaded: Robot | None
    trajectory: Trajectory
    table: Array
    said: dict[str, Any]
    seed: tuple[int, ...]

    @property
    def period(self) -> float:
        """Control period [s]."""
        return float(self.said["period"])


class Dice:
    """What is drawn of a table, by name; the file's ranges in the file's words."""

    def __init__(self, table: dict[str, Any], rng: np.random.Generator) -> None:
        self.table, self.rng = table, rng

    def one(self, name: str) -> Any:
        """One number, or one of a list."""
        if (choice := self.table.get(f"{name}_one_of")) is not None:
            return choice[int(self.rng.integers(len(choice)))]
        return float(self.many(name, 1)[0])

    def many(self, name: str, count: int) -> Array:
        """(count,) numbers."""
        low, high, *how = self.table[name]
        if how:
            return np.exp(self.rng.uniform(np.log(low), np.log(high), count))
        return self.rng.uniform(low, high, count)


@one_thread
def draw_of(name: str, family: str, number: int) -> Draw:
    """The draw of a robot, a family ("dev" or "final") and a number from 0 on."""
    said = preregistered()
    seed = (said["seed"][family], number, zlib.crc32(name.encode()))
    rng, found = np.random.default_rng(seed), dict[str, Any]()
    dice = {table: Dice(said[table], rng) for table in ("motion", "control", "drive", "friction", "body", "sensors")}
    robot = load(name)
    for each in ("period", "delay", "jitter"):
        found[each] = dice["control"].one(each)
    for each in ("lag", "encoder"):
        found[each] = dice["drive"].one(each)
    for each in ("bits", "filter", "fix_noise", "trust"):
        found[each] = dice["sensors"].one(each)
    for each in ("static", "share", "static_share", "thick", "stiff", "warm"):
        found[each] = dice["friction"].one(each)
    trajectory = motion_of(robot, dice["motion"], said["duration"])
    times = np.arange(round(said["duration"] / found["period"])) * found["period"]
    table = trajectory.table(times, robot.dimensions)
    along = table[:: max(1, len(table) // POSTURES)]
    masses = mass_matrices(robot, (Start().state(robot, row)[0] for row in along))
    inertia = np.median([link_inertia(robot, row, M) for row, M in zip(along, masses, strict=True)], axis=0)
    rotor = told_rotor(robot, inertia)
    told = robot.with_armature(rotor[robot.dimensions.motors - robot.dimensions.arm :])
    robot = replace(told, origin=None)  # the rotors are told, as if the file had them
    found |= drawn_drive(robot, dice["drive"], found["encoder"], inertia, rotor)
    found |= drawn_friction(robot, dice["friction"], trajectory, said["duration"])
    true, loaded, payload = drawn_body(robot, dice["body"], rng)
    return Draw(robot, true, loaded, trajectory, table, found | payload, (*seed, 1))


def motion_of(robot: Robot, dice: Dice, duration: float) -> Trajectory:
    """The reference that is drawn, as slow and in such a posture as its motors permit."""
    n, base = robot.dimensions.arm, path_of(robot, dice) if robot.dimensions.base else None
    turns = revolute(robot)[robot.arm_index]
    amplitude, fast = dice.many("arm_amplitude", n) * np.where(turns, 1.0, SLIDES), dice.many("arm_fast", n)
    period, ratio, share = dice.many("arm_period", n), dice.many("arm_ratio", n), dice.one("share")

    def reference(ends: tuple[Array, Array]) -> Trajectory:
        lower, upper = ends
        bounded, arm = np.isfinite(upper - lower), []
        for i in range(n):
            size = min(amplitude[i], dice.table["arm_range"] * (upper[i] - lower[i]) / 2)
            middle = (lower[i] + upper[i]) / 2 if bounded[i] else float(np.clip(0.0, lower[i], upper[i]))
            sizes, periods = (size * (1 - fast[i]), size * fast[i]), (period[i], period[i] * ratio[i])
            arm.append(Sines(sizes, periods, middle, (np.pi / 2, np.pi / 2)))
        return Trajectory(base, arm)

    return followable(robot, reference, duration, share)


def path_of(robot: Robot, dice: Dice) -> BasePath:
    """The base's path that is drawn."""
    kind, ramp, speed = dice.one("path"), dice.table["ramp"], dice.one("speed")
    length, width, period = (dice.one(f"eight_{each}") for each in ("length", "width", "period"))
    radius, turn = dice.one("circle_radius"), 1 if dice.rng.random() < 0.5 else -1
    sides, turns = dice.many("corners_side", 5), np.cumsum(dice.many("corners_turn", 5))
    bend, heading = dice.one("corners_radius"), (dice.one("heading_amplitude"), dice.one("heading_period"))
    path: BasePath = Circle(radius, speed, turn=turn, ramp=ramp)
    if kind == "eight":
        path = Eight(length, width * length, period, ramp=ramp)
    if kind == "corners":
        steps = sides[:, None] * np.column_stack((np.cos(turns), np.sin(turns)))
        points = np.vstack((np.zeros(2), np.cumsum(steps, axis=0)))
        path = Waypoints(tuple((float(x), float(y)) for x, y in points), speed, radius=bend, ramp=ramp)
    if not robot.dimensions.sideways:
        return path
    start = float(path.sample([0.0]).pose[0, 2])
    return HolonomicPath(path, Sine(heading[0], heading[1], start - heading[0], np.pi / 2))


def link_inertia(robot: Robot, row: Array, M: Array) -> Array:
    """What every motor moves (m,): an arm joint with the others held, a wheel with the others free."""
    E = robot.E_at(Start().state(robot, row)[0])
    free = 1.0 / np.einsum("im,ij,jm->m", E, inverse(M), E)
    n = robot.dimensions.arm
    free[len(free) - n :] = np.diag(M)[len(M) - n :]
    return free


def told_rotor(robot: Robot, inertia: Array) -> Array:
    """Rotors as told (m,), see the file; the base's are not told, and 0 here."""
    table, unit = preregistered()["drive"], units(robot)
    told = np.cbrt((robot.effort_limits / (table["rotor_rate"] * unit)) ** 2 * inertia)
    told[: robot.dimensions.motors - robot.dimensions.arm] = 0.0
    return told


def units(robot: Robot) -> Array:
    """What counts as a radian, by motor (m,): 1, a tenth of a metre, of wheels 5."""
    unit = np.where(revolute(robot)[motor_rows(robot)], 1.0, TENTH)
    unit[[name in robot.wheel_names for name in robot.actuator_names]] = WHEELS
    return unit


def drawn_drive(robot: Robot, dice: Dice, encoder: str, inertia: Array, rotor: Array) -> dict[str, Any]:
    """Rotors, gears and tyres (m,)."""
    m, b = robot.dimensions.motors, robot.dimensions.motors - robot.dimensions.arm
    wheels = np.array([name in robot.wheel_names for name in robot.actuator_names])
    J = rotor * dice.many("rotor_factor", m)
    J[:b] = (inertia * dice.many("rotor_base", m))[:b]
    frequency = dice.many("frequency_link" if encoder == "link" else "frequency", m)
    frequency = np.where(wheels, dice.many("tyre_frequency", m), frequency)
    ratio, relaxation, grip = dice.many("gear_damping", m), dice.many("relaxation", m), dice.one("grip")
    rate, moved = 2.0 * np.pi * frequency, inertia + J
    radius = {wheel.joint: wheel.radius for wheel in robot.base.wheels} if b else {}
    r = np.array([radius.get(name, 1.0) for name in robot.actuator_names])
    weight = 9.81 * robot.mass / max(len(radius), 1)
    return {
        "rotor": J, "spring": moved * rate**2, "damper": 2.0 * ratio * moved * rate,
        "creep": np.where(wheels, r / relaxation, 0.0), "grip": np.where(wheels, grip * weight * r, np.inf), "mu": grip,
    }  # fmt: skip


def drawn_friction(robot: Robot, dice: Dice, trajectory: Trajectory, duration: float) -> dict[str, Any]:
    """Dry and viscous friction (m,) of motors, and (k,) of joints without one; the rest of a row is as for all."""
    rows, unit, m = motor_rows(robot), units(robot), robot.dimensions.motors
    peak = MotorLoad(robot).along(trajectory, duration)[0] * robot.effort_limits
    used, dry = np.clip(4.0 * peak, 0.1 * robot.effort_limits, robot.effort_limits), dice.one("coulomb")
    level = dry * used * dice.rng.uniform(0.5, 1.5, m)
    viscous = level * dice.many("viscous", m) / (dice.table["rated"] * unit)
    wrong = dice.many("stated", robot.dimensions.full), dice.many("stated", robot.dimensions.full)
    stated, damping = robot.coulomb * wrong[0], robot.damping * wrong[1]
    level, viscous = (np.where(own[rows] > 0, own[rows], made) for own, made in ((stated, level), (damping, viscous)))
    start = Start().state(robot, trajectory.table(np.zeros(1), robot.dimensions)[0])[0]
    T, (M,) = robot.T_at(start), mass_matrices(robot, [start])
    moved = np.abs(T).max(axis=1) > 0.0
    free = np.flatnonzero(moved & ((stated > 0) | (damping > 0)))
    free = free[~np.isin(free, rows)]
    return {
        "coulomb": dry, "level": level, "viscous": viscous, "stribeck": dice.many("stribeck", m) * unit,
        "deflection": dice.many("deflection", m) * unit, "bristle_damping": dice.one("bristle_damping"),
        "free": free, "free_level": stated[free], "free_viscous": damping[free],
        "free_inertia": 1.0 / np.einsum("ij,jk,ik->i", T[free], inverse(M), T[free]),
    }  # fmt: skip


def drawn_body(robot: Robot, dice: Dice, rng: np.random.Generator) -> tuple[Robot, Robot | None, dict[str, Any]]:
    """The true robot, the same with its payload if there is one, and when it has it [s]."""
    low, high = dice.table["masses"]
    true = robot.with_masses({name: float(rng.uniform(low, high)) for name in bodies_of(robot.model)})
    if wheels := robot.base.wheels:
        sides = dice.one("radii") * (1.0 + (dice.many("radii", 2) - 1.0) / 3.0)
        true = true.with_radii({wheel.joint: float(sides[int(wheel.y > 0.0)]) for wheel in wheels})
    mass = dice.one("payload") * sum(robot.model.inertias[i].mass for i in arm_joints(robot))
    at, begin, carries = dice.one("payload_at"), dice.one("payload_from"), rng.random() < dice.table["payload_chance"]
    loaded = carrying(true, float(mass), at=(0.0, 0.0, at)) if carries else None
    return true, loaded, {"payload": carries, "payload_mass": float(mass), "payload_from": begin}


def arm_joints(robot: Robot) -> list[int]:
    """Pinocchio's numbers of the arm's joints."""
    return [robot.model.getJointId(name) for name in robot.joint_names]


def friction_table(draw: Draw, level: Array, viscous: Array, inertia: Array, **own: Array) -> Array:
    """Rows of `Column` (k, 12)."""
    said, found = draw.said, np.zeros((level.size, len(AT)))
    found[:, AT.coulomb], found[:, AT.static], found[:, AT.viscous] = level, said["static"] * level, viscous
    found[:, AT.share], found[:, AT.static_share] = said["share"], said["static_share"]
    found[:, AT.thick], found[:, AT.stiff], found[:, AT.warm] = said["thick"], said["stiff"], said["warm"]
    found[:, AT.speed] = found[:, AT.fade] = own["speed"]
    found[:, AT.bristle] = (1.0 + said["static"]) * level / own["deflection"]
    found[:, AT.damping] = 2.0 * said["bristle_damping"] * np.sqrt(found[:, AT.bristle] * inertia)
    return found


def world_of(draw: Draw) -> World:
    """Drives and friction of a draw."""
    said, robot = draw.said, draw.robot
    ones = np.ones(said["free"].size)
    swift = {"speed": 0.05 * ones, "deflection": 0.005 * ones}
    return World(
        rows=motor_rows(robot), rotor=said["rotor"], spring=said["spring"], damper=said["damper"],
        creep=said["creep"], grip=said["grip"], limit=np.array(robot.effort_limits), lag=said["lag"],
        friction=friction_table(draw, said["level"], said["viscous"], said["rotor"], speed=said["stribeck"],
                                deflection=said["deflection"]),
        free=said["free"],
        drag=friction_table(draw, said["free_level"], said["free_viscous"], said["free_inertia"], **swift),
    )  # fmt: skip


def sensors_of(draw: Draw) -> tuple[Drives, Array]:
    """Sensors of a draw, and when the command of every sample begins to act, in multiples of `STEP`."""
    said, robot, samples = draw.said, draw.robot, len(draw.table)
    rng, fixed = np.random.default_rng(draw.seed), preregistered()["sensors"]["fix"]
    m, n, readings = robot.dimensions.motors, robot.dimensions.arm, round(samples * draw.period / ENCODER)
    link = np.zeros((m, 2), np.int64)
    link[m - n :] = {"motor": (0, 0), "link": (1, 1), "both": (1, 0)}[said["encoder"]]
    drives = new_drives(
        robot, readings, link=link, step=2.0 * np.pi / 2.0 ** said["bits"] * np.minimum(units(robot), 1.0),
        keep=float(np.exp(-2.0 * np.pi * said["filter"] * ENCODER)), trust=said["trust"],
        fixes=said["fix_noise"] * rng.standard_normal((readings + 2, 3)), between=round(fixed / ENCODER),
        pivot_step=2.0 * np.pi / 2.0 ** said["bits"],
    )  # fmt: skip
    late = said["delay"] + said["jitter"] * rng.random(samples)
    arrive = np.ceil((np.arange(samples) * draw.period + late) / STEP - 1e-9)
    return drives, np.maximum.accumulate(arrive)


def plant_of(draw: Draw, step: float = 0.0) -> Plant:
    """The plant of a draw at rest where the reference begins, its motors holding it.

    Args:
        draw: The draw.
        step: Of the plant [s]; 0 for one that suits its fastest oscillation.
    """
    said, world, samples = draw.said, world_of(draw), len(draw.table)
    position, _ = Start().state(draw.robot, draw.table[0])
    M, E, held = at_rest(draw, position)
    step = step or step_for(world, M, E)
    fine = round(STEP / step)  # times come at multiples of STEP, whatever the plant's step is
    begin = fine * round(said["payload_from"] / STEP) if said["payload"] else 0
    carries = np.array([begin, 2**62 if said["payload"] else 0])
    drives, arrive = sensors_of(draw)
    plant = new_plant(draw.true, draw.loaded, world, (position, held), (step, samples), drives, carries)
    plant.arrive[1:] = fine * arrive
    return plant


def at_rest(draw: Draw, position: Array) -> tuple[Array, Array, Array]:
    """Mass matrix, map of the motors and the torques that hold a draw's robot at a position (nv,), (m,)."""
    terms, E = terms_of(draw.true.without_friction()), draw.true.E_at(position)
    terms.refresh(position, np.zeros(draw.robot.dimensions.dof))
    return terms.M, E, pseudo_inverse(E) @ terms.h


def step_for(world: World, M: Array, E: Array) -> float:
    """The largest `STEP / 2^k` that is less than `SHAKES` radians of the fastest oscillation, rotors free [s]."""
    m, p = world.rotor.size, len(M)
    coupling = np.hstack((-E.T, np.eye(m)))
    K = coupling.T @ (world.spring[:, None] * coupling)
    masses = np.zeros((p + m, p + m))
    masses[:p, :p], masses[p:, p:] = inverse(M), np.diag(1.0 / world.rotor)
    K[p:, p:] += np.diag(world.friction[:, AT.bristle])
    fastest = np.sqrt(np.abs(np.linalg.eigvals(masses @ K)).max())
    return float(STEP / 2.0 ** max(0.0, np.ceil(np.log2(STEP * fastest / SHAKES))))


def setpoints(draw: Draw) -> list[Setpoint]:
    """The reference's samples."""
    return [Setpoint.side_by_side(row, draw.robot.dimensions) for row in draw.table]
