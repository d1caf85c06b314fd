"""What contact does to learners, how fast it is felt, and how often a load is taken for one.

    python -m research.studies.touch learners [robot=ROBOT] [NAME ...]    5 s against a wall, then free: how far the
                                                                          hand is thrown
    python -m research.studies.touch own [robot=ROBOT] NAME ...    and how far from where it stands without the wall
    python -m research.studies.touch reaction               time until contact is felt and largest force, on both plants
    python -m research.studies.touch hard                   fifteen cases that should upset a hand that pushes
    python -m research.studies.touch loads                  loads taken for contacts and contacts for loads

The arm of the robot goes against a wall with its reference `DEEP` behind the surface; nothing of the settings was
chosen for these runs.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from mmnn_pin import Loop, Timing, Trajectory, load_experiment
from mmnn_pin.disturbance import Payload
from mmnn_pin.disturbance.scene import Surface
from mmnn_pin.errors import InputError
from mmnn_pin.lab.experiments.pushing import pushing_numbers
from mmnn_pin.model.chain import chain_of, track
from mmnn_pin.model.robot import Robot
from mmnn_pin.reference.joint import MinimumJerk
from mmnn_pin.safety import Safety
from mmnn_pin.signals import Array
from mmnn_pin.torque.entries import CONTROLLERS
from mmnn_pin.touch import Touch

ROBOT = "panda"
DEEP = 0.03  # of the reference behind the wall [m]
MEETS, FREE, END = 2.0, 7.0, 10.0  # when the hand meets the wall, when that is gone, end of the run [s]
NEAR = 1.6  # time after the release in which learners wait, by default [s]
WALLS = {"rigid": (1e5, 200.0), "person-like": (2.5e4, 100.0), "soft": (2e3, 20.0)}  # [N/m], [N s/m]
SPEEDS = (0.1, 0.25, 0.5)  # of the hand [m/s]
SAME = ("two_layer_zero", "two_layer_random", "pd_effective", "pd_effective_one_layer")  # the laws of others


def hand_along(robot: Robot, positions: Array) -> Array:
    """Where the hand is at positions (N, nv), (N, 3) [m]."""
    return np.asarray(track(chain_of(robot, robot.hands[0]), positions)[:, 9:])


def pressing(robot: Robot, by: float, duration: float, begin: float) -> tuple[Trajectory, Array]:
    """The first joint turns until the hand has gone a way, as a reference; and that way as a vector (3,) [m]."""
    start = robot.rest.copy()
    start[robot.arm_index] = np.where(np.arange(robot.dimensions.arm) == 1, 0.5, start[robot.arm_index])
    first = robot.arm_index[0]
    turned = start.copy()
    turned[first] += 0.01
    step = hand_along(robot, np.array([start, turned]))
    angle = 0.01 * by / float(np.linalg.norm(step[1] - step[0]))
    turned[first] = start[first] + angle
    places = hand_along(robot, np.array([start, turned]))
    arm: dict[str, Any] = {
        name: MinimumJerk(q, q, 1.0) for name, q in zip(robot.joint_names, start[robot.arm_index], strict=True)
    }
    arm[robot.joint_names[0]] = MinimumJerk(start[first], turned[first], duration, begin=begin)
    return Trajectory.of(robot, arm=arm), places[1] - places[0]


def against_a_wall(name: str, touch: Touch | None, of: str = ROBOT) -> Loop:
    """A controller whose hand is pressed against a stiff wall that goes away."""
    experiment = load_experiment("track", [f"robot={of}", f"time.duration={END}"])
    robot = experiment.load_robot()
    trajectory, way = pressing(robot, 0.10, 1.5, 0.5)
    normal = tuple((-way / np.linalg.norm(way)).tolist())
    wall = Surface(normal=normal, gap=float(np.linalg.norm(way)) - DEEP, end=FREE, friction=0.0)
    loop = experiment.loop(robot, name)
    return replace(loop, trajectory=trajectory, disturbances=(wall,), touch=touch)


def thrown(loop: Loop) -> tuple[float, float, float, float]:
    """How far the release moves the hand [m], the force just before [N], samples that felt, status 0 when complete.

    In any direction for `NEAR`, then along the wall's normal alone: what a learner learns once it is free, such as the
    arm's weight, is no throw.
    """
    run, h = loop.run(), loop.timing.control_period
    if run.outcome.status != "completed":
        return np.nan, np.nan, np.nan, 1.0
    places, free = hand_along(loop.robot, run["position"]), round(FREE / h)
    gone, wall = places[free:] - places[free - 1], loop.disturbances[0]
    assert isinstance(wall, Surface) and wall.normal is not None
    far = max(np.linalg.norm(gone[: round(NEAR / h)], axis=1).max(), np.abs(gone @ np.array(wall.normal)).max())
    force = float(np.linalg.norm(run["hand_force"][free - 20 : free - 1], axis=1).mean())
    felt = float(run["contact"][round(MEETS / h) : free].mean()) if "contact" in run else 0.0
    return float(far), force, felt, 0.0


def asked(words: list[str]) -> tuple[str, list[str]]:
    """The robot and the controllers that a command line names."""
    of = next((word.removeprefix("robot=") for word in words if word.startswith("robot=")), ROBOT)
    return of, [word for word in words if "=" not in word]


def own(words: list[str]) -> Iterator[str]:
    """A line per controller: how far the release moves the hand, and how far the wall had pushed it away.

    Away from where it would stand by then without a wall: as far goes back what is not thrown.
    """
    of, names = asked(words)
    for name in names:
        loop = against_a_wall(name, Touch(), of)
        pressed, free = (
            hand_along(each.robot, each.run()["position"])[round(FREE / each.timing.control_period) - 1]
            for each in (loop, replace(loop, disturbances=()))
        )
        far, pushed = thrown(loop)[0], float(np.linalg.norm(pressed - free))
        yield f"{name:22s} goes {1e3 * far:6.1f} mm, was pushed {1e3 * pushed:6.1f} mm"


def learners(words: list[str]) -> Iterator[str]:
    """A line per controller: how far the hand goes over the way of the right model, as it was and with touch."""
    of, names = asked(words)
    right, force, *_ = thrown(against_a_wall("computed_torque", None, of))
    yield f"{'':22s} as ever            frozen             dead zone"
    yield f"{'':22s} force N  thrown    force N  thrown    force N  thrown   felt"
    yield f"{'computed_torque':22s} {force:7.1f}  {1e3 * right:5.1f} mm = 1"
    for name in names or [each for each in CONTROLLERS if each not in (*SAME, "computed_torque")]:
        cells, felt = [], 0.0
        for touch in (None, Touch(), Touch(learning="deadzone")):
            far, force, share, _ = thrown(against_a_wall(name, touch, of))
            cells.append(f"{force:7.1f}  {far / right:6.2f}")
            felt = share if touch == Touch() else felt
        yield f"{name:22s} {'    '.join(cells)}   {felt:4.0%}"


def reaction() -> Iterator[str]:
    """A line per plant, wall and speed: time from touch to contact, and the largest force by reaction."""
    yield "plant    wall          speed m/s   felt after ms   largest force N:  go on   stop   comply"
    for plant in ("ideal", "contact"):
        for wall, (stiffness, damping) in WALLS.items():
            for speed in SPEEDS:
                found = [hit(plant, stiffness, damping, speed, react) for react in ("go on", "stop", "comply")]
                forces = "  ".join(f"{force:6.1f}" for _, force in found)
                yield f"{plant:8s} {wall:12s}  {speed:6.2f}      {1e3 * found[0][0]:8.1f}                      {forces}"


def hit(plant: str, stiffness: float, damping: float, speed: float, react: str) -> tuple[float, float]:
    """How long a hand that hits a wall has touched it before that is felt [s], and the largest force [N]."""
    experiment = load_experiment("track", [f"robot={ROBOT}", f"plant={plant}", "time.duration=2.5"])
    robot = experiment.load_robot()
    by = 0.2
    duration = 1.875 * by / speed  # the largest speed of least jerk is 1.875 of the mean
    trajectory, way = pressing(robot, by, duration, 0.3)
    normal = tuple((-way / np.linalg.norm(way)).tolist())
    wall = Surface(normal=normal, gap=0.5 * by, stiffness=stiffness, damping=damping, friction=0.0)
    timing = Timing(duration=0.3 + duration + 0.5, control_period=0.001, plant_step=2.5e-4)
    loop = replace(
        experiment.loop(robot, "computed_torque"), trajectory=trajectory, timing=timing, disturbances=(wall,),
        touch=Touch(), safety=Safety(contact=react),  # type: ignore[arg-type]
    )  # fmt: skip
    run = loop.run()
    force = np.linalg.norm(run["hand_force"], axis=1)
    touched, felt = np.flatnonzero(force > 0.0), np.flatnonzero(run["contact"])
    after = [k for k in felt if touched.size and k >= touched[0]]
    return float(after[0] - touched[0]) * 1e-3 if after else np.nan, float(force.max())


def loads(draws: int = 40) -> Iterator[str]:
    """How often loads are taken for contacts and contacts for loads, on TIAGo's arm that swings."""
    rng, robot_name = np.random.default_rng(0), "tiago"
    experiment = load_experiment("track", [f"robot={robot_name}", "time.duration=3.0"])
    robot, touch = experiment.load_robot(), Touch(masses=0.03, friction=0.1, unknown=0.01)
    counts = {"load": [0, 0, 0], "contact": [0, 0, 0]}
    for k in range(draws):
        what = "load" if k % 2 == 0 else "contact"
        if what == "load":
            at = tuple(rng.uniform(-0.05, 0.05, 3).tolist())
            event: Any = Payload(mass=float(rng.uniform(1.0, 2.0)), start=1.5, at=at)
        else:
            normal = rng.standard_normal(3)
            event = Surface(normal=tuple(normal.tolist()), gap=0.0, start=1.5, stiffness=float(rng.uniform(500, 5e3)))
        masses = {name: 1.0 + 0.03 * float(rng.standard_normal()) for name in robot.joint_names}
        true = robot.with_masses(masses)
        loop = replace(experiment.loop(true, "computed_torque"), disturbances=(event,), touch=touch, nominal=robot)
        run = loop.run()
        later = slice(round(2.0 / loop.timing.control_period), None)
        as_load, as_contact = (run["load"][later] > 0.0).mean(), run["contact"][later].mean()
        place = (
            2
            if as_load + as_contact < 0.05
            else int(as_contact > as_load)
            if what == "load"
            else int(as_load > as_contact)
        )
        counts[what][place] += 1
    yield f"{'':8s}  right  taken for the other  not felt     of {draws // 2} each"
    for what, (right, wrong, nothing) in counts.items():
        yield f"{what:8s}  {right:5d}  {wrong:19d}  {nothing:8d}"


HARD = {
    "a wall of 1e6 N/m": ("wipe", ["disturbances.0.stiffness=1e6"]),
    "and steps of 0.2 ms": ("wipe", ["disturbances.0.stiffness=1e6", "time.plant_step=0.0002"]),
    "commands 8 ms late": ("wipe", ["latency.command=0.008"]),
    "20 ms late": ("wipe", ["latency.command=0.02"]),
    "1e5 N/m, 8 ms late": ("wipe", ["disturbances.0.stiffness=1e5", "latency.command=0.008"]),
    "encoders of 1 mrad": ("wipe", ["sensor.resolution=0.001", "sensor.velocity='difference'"]),
    "a forearm of twice its weight": ("wipe", ["masses={arm_2_joint=2.0}"]),
    "gain = 100": ("wipe", ["force.gain=100.0"]),
    "a table that goes away": ("wipe", ["disturbances.0.end=4.0"]),
    "a negative force": ("wipe", ["force.newtons=-20.0"]),
    "a stiffness of 1e6 N/m": ("wipe", ["impedance.stiffness=1e6"]),
    "a handle of 1e6 N/m": ("door", ["disturbances.0.grip=1e6"]),
    "a door, 8 ms late": ("door", ["latency.command=0.008"]),
    "a door of 200 kg m^2": ("door", ["disturbances.0.inertia=200.0"]),
    "a door, first guess 75 degrees off": ("door", ["force.along=[-0.26, 0.97, 0.0]"]),
}


def hard() -> Iterator[str]:
    """A line per case that should upset a hand that pushes: what it did, or the line that refuses it."""
    for words, (name, changes) in HARD.items():
        try:
            made = load_experiment(name, ["plant=ideal", *changes])
            run = made.loop(made.load_robot(), "pd_gravity").run()
        except InputError as error:
            yield f"{words:36s} refused: {error}"
            continue
        numbers = pushing_numbers(run, made.load_robot())
        told = ", ".join(f"{key} {value:.3g}" for key, value in numbers.items() if value is not None)
        yield f"{words:36s} {run.outcome.status}: {told}, peak {np.linalg.norm(run['hand_force'], axis=1).max():.3g} N"


def main() -> None:
    """Print the table that is asked for, line by line."""
    what, *names = sys.argv[1:] or ["learners"]
    tables = {
        "learners": lambda: learners(names),
        "own": lambda: own(names),
        "reaction": reaction,
        "loads": loads,
        "hard": hard,
    }
    for line in tables[what]():
        print(line, flush=True)


if __name__ == "__main__":
    main()
