"""The recordings of real robots: where they are, how they are read, what is learned on and what is judged.

Nothing of them is kept here: a folder holds clones of the repositories that publish them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mmnn_pin import load
from mmnn_pin.deploy.identify.log import Log
from mmnn_pin.deploy.identify.reading import read_logs
from mmnn_pin.model.robot import Robot

# Joint torque over motor current of a UR10e [N m / A]: at rest the quotient of the controller's wanted torques and
# currents, which the logs hold, of the joints that gravity loads; the shoulder's motors are alike, the wrist's too.
UR10E = {"shoulder_pan": 11.98, "shoulder_lift": 11.98, "elbow": 9.84, "wrist_1": 10.7, "wrist_2": 10.7}
UR10E = {f"{name}_joint": value for name, value in (UR10E | {"wrist_3": 10.7}).items()}
WIDTH, USED = 31, 19  # columns of its tables, and those that are read
RICH = [  # of February 2020, without a load
    *("05-20sec_12harm", "05-20sec_8harm", "06-20sec_10harm", "06-20sec_5harm", "10-20sec_7harm", "10-30sec_12harm"),
    *("12-40sec_12harm", "19_14harm50sec", "19_15harm50sec"),
]
OTHER, SEVERAL = "12-50sec_12harm", "ptp_10_points"
PERIOD = 12.0  # of the motion of the first Panda, which is recorded once and three quarters [s]


@dataclass(frozen=True, eq=False)
class Case:
    """Motions to learn on, and others to predict the torques of."""

    title: str  # what the robot is called
    shift: str  # what is other in the motions to judge
    robot: Robot  # as its URDF has it
    learned: Sequence[Log]  # logs that are learned on
    judged: Sequence[Log]  # logs that are not looked at before
    constants: dict[str, float] = field(default_factory=dict)  # torque per unit of a recorded effort, by motor

    @property
    def name(self) -> str:
        """Robot and shift."""
        return f"{self.title}, {self.shift}"


@dataclass(frozen=True)
class Source:
    """A public repository that holds recordings."""

    address: str  # of the clone
    part: str  # a path in it that is needed
    cases: Callable[[Path], Iterator[Case]]  # its cases, from the clone's folder


def columns_of_ur10e(file: Path, robot: Robot) -> Log:
    """A table without heads: time, of six joints positions, velocities, currents, and more; without broken lines."""
    lines = [line.split(",") for line in file.read_text().splitlines()]
    table = np.array([line[:USED] for line in lines if len(line) == WIDTH], float)
    parts = [dict(zip(robot.joint_names, table[:, i : i + 6].T, strict=True)) for i in (1, 7, 13)]
    return Log.of(table[:, 0], parts[0], parts[2], parts[1], name=file.stem)


def ur10e(folder: Path) -> Iterator[Case]:
    """Nine sums of sines of all joints; another sum, single joints one after the other, points; and the other way."""
    robot, data = load(folder / "URe/urdf/ur10e.urdf"), folder / "dataset_ur10e"
    files = (data / "identification_data" / f"ur-20_02_{name}.csv" for name in RICH)
    rich = [columns_of_ur10e(file, robot) for file in files]
    other = [columns_of_ur10e(data / "identification_data" / f"ur-20_02_{OTHER}.csv", robot)]
    single = [columns_of_ur10e(data / "jointwise_motion" / f"ur-20_01_22-joint_{i}.csv", robot) for i in range(1, 7)]
    several = [columns_of_ur10e(data / "validation_data" / f"ur-20_01_17-{SEVERAL}.csv", robot)]
    yield Case("UR10e", "other sines", robot, rich, other, UR10E)
    yield Case("UR10e", "joint by joint", robot, rich, single, UR10E)
    yield Case("UR10e", "point to point", robot, rich, several, UR10E)
    yield Case("UR10e", "from single joints to all", robot, single, rich, UR10E)


def gaz(folder: Path) -> Iterator[Case]:
    """The first half of a periodic motion; the second."""
    data, robot = folder / "matlab/data/Exciting_Traj/Trajectory_1/rbt_log", load("panda")
    time = np.loadtxt(data / "exciting_traj_time.txt")
    q, tau = (
        np.loadtxt(data / f"exciting_traj_{name}.txt").reshape(len(time), -1) for name in ("positions", "torques")
    )
    names = robot.joint_names, robot.actuator_names
    position, effort = (dict(zip(of, table.T, strict=True)) for of, table in zip(names, (q, tau), strict=True))
    log = Log.of(time, position, effort, name="panda")
    half, whole = np.searchsorted(time, (PERIOD / 2, PERIOD))
    first, second = log.rows(slice(half)), log.rows(slice(half, whole))
    yield Case("Panda G", "second half", robot, [first], [second])


def halves(title: str, robot: Robot, log: Log) -> Iterator[Case]:
    """The first half of a motion; the second; and the other way."""
    first, second = log.rows(slice(len(log.time) // 2)), log.rows(slice(len(log.time) // 2, None))
    yield Case(title, "second half", robot, [first], [second])
    yield Case(title, "first half", robot, [second], [first])


def unisa(folder: Path) -> Iterator[Case]:
    """One exciting motion each of a UR10 and of a Panda."""
    names = {f"joint.panda_joint{i}": f"fer_joint{i}" for i in range(1, 8)}
    for title, bag, columns in (
        ("UR10", "ur10_inverse_dynamics_solver/bagfiles/ur10_exciting_trajectory.db3", {}),
        ("Panda", "franka_inria_inverse_dynamics_solver/bagfiles/panda_exciting_trajectory.db3", names),
    ):
        robot = load(title.lower())
        yield from halves(title, robot, read_logs([folder / bag], robot, columns)[0])


SOURCES = (
    Source("https://github.com/shamilmamedov/dynamic_calibration", "dataset_ur10e", ur10e),
    Source("https://github.com/marcocognetti/FrankaEmikaPandaDynModel", "matlab/data/Exciting_Traj", gaz),
    Source("https://github.com/unisa-acg/inverse-dynamics-solver", "ur10_inverse_dynamics_solver/bagfiles", unisa),
)


def cases(folder: Path) -> Iterator[Case]:
    """All cases whose recordings a folder holds; says what to fetch for the others."""
    for source in SOURCES:
        clone = folder / source.address.rpartition("/")[2]
        if (clone / source.part).exists():
            yield from source.cases(clone)
        else:
            print(f"no {clone / source.part}: git clone --depth 1 {source.address} {clone}")
