"""Trajectories of the whole robot: setpoints from a path of the base and profiles of the arm's joints.

A `SetpointSource` says at every sample where the robot should be. A `Trajectory` is one, which also knows it ahead:
`Trajectory.table` samples it for a loop, so that nothing of it is computed between the steps.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from html import escape
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from ..errors import LENGTH, TrajectoryError, UnknownName
from ..model.robot import Robot, revolute
from ..settings.arguments import checked, faced, require_types
from ..signals import Array, Dimensions, Layout, Measurement, Setpoint
from .holonomic import HolonomicPath
from .joint import Hold, JointProfile, JointTable, Points
from .path import BasePath, Line, Waypoints, require_positive, times
from .samples import BASE_COLUMNS, HEADINGS, TIMES, BaseTable, TableColumns, check_followable, require_within, table_of
from .timed import Smoothed, Timed


class SetpointSource(Protocol):
    """A source of setpoints, sample by sample: a trajectory, a planner, a joystick, ..."""

    def write(self, time: float, measurement: Measurement, setpoint: Setpoint) -> None:
        """Write the setpoint of a time [s] in place, knowing what is measured."""


@runtime_checkable
class Watched(Protocol):
    """Frames that a trajectory takes along paths: where they should be and where they are, signals of a recording."""

    @property
    def frames(self) -> Mapping[str, bool]:
        """Their names, and whether they should also be turned as the path says."""

    def writer(self, robot: Robot, layout: Layout) -> Callable[[Array], None]:
        """A function that writes `hand_ref` and `hand` into rows (k, width) of a robot's run."""


POSITION_WORDS = {"position", "positions", "pos", "q", "angle", "joint", "measured", "actual"}
NEARLY = 0.85  # ratio of `difflib` from which two names are taken for one with a slip
STANDING = 5.0  # time of an arm's motion where no base says one [s]


@faced
@dataclass(frozen=True, repr=False)
class Trajectory:
    """A motion of the whole robot over time: a source of setpoints that knows them ahead.

    Made of a path and profiles; or by `of`, `from_waypoints`, `from_arrays` or `from_csv`, which know the robot: parts
    that you do not give stand still, the arm where it rests and the base at the origin.

    Args:
        base: Path of the base; None for a fixed arm.
        arm: One profile per arm joint, in the order of the robot's arm joints.
        slowness: How much more time everything takes than base and arm say.
        watched: Frames whose paths base and arm were made for, see `reference.hand`; None for none.

    >>> robot = load("platform_arm")
    >>> corner, reach = [(0, 0), (2, 0), (2, 2)], [(0, 0), (0.5, 1), (0, 0)]
    >>> path = Trajectory.from_waypoints(robot, base=corner, arm=reach, speed=0.4)
    >>> round(path.duration, 1)
    10.6
    >>> Trajectory(base=Line(speed=0.3), arm=[Sine(amplitude=0.8, period=4.0), Hold(0.8)]).duration
    inf
    """

    base: BasePath | None
    arm: Sequence[JointProfile] = ()
    slowness: float = 1.0
    watched: Watched | None = None

    def __post_init__(self) -> None:
        require_types(self)
        object.__setattr__(self, "arm", tuple(self.arm))
        require_positive(slowness=self.slowness)

    def __repr__(self) -> str:
        parts = [] if self.base is None else [f"base {worded(self.base, 0)}"]
        kinds = Counter(type(one).__name__ for one in self.arm)
        parts += [f"arm {', '.join(f'{n} {kind}' if n > 1 else kind for kind, n in kinds.items())}"] if kinds else []
        end = f"{self.duration:.4g} s" if np.isfinite(self.duration) else "without an end"
        return f"<Trajectory: {'; '.join([*parts, end])}>"

    def _repr_html_(self) -> str:
        rows: list[tuple[str, BasePath | JointProfile]] = [] if self.base is None else [("base", self.base)]
        rows += [(f"arm[{i}]", one) for i, one in enumerate(self.arm)]
        lines = (f"<tr><th>{name}</th><td>{escape(worded(part))}</td></tr>" for name, part in rows)
        return f"<table><caption>{escape(repr(self))}</caption>{''.join(lines)}</table>"

    @classmethod
    @checked
    def of(
        cls, robot: Robot, base: BasePath | None = None, arm: Mapping[str, JointProfile] | None = None
    ) -> Trajectory:
        """Of a path of the base and profiles of some joints, for a robot.

        Args:
            robot: The robot.
            base: Path of the base; a holonomic base looks along one of a differential drive. None stands at the origin.
            arm: Profiles by joint; joints that are not named rest.

        Raises:
            TrajectoryError: A path for a base that does not move.
            UnknownName: A joint that the arm does not have.
        """
        joints = arm or {}
        for name in joints:
            require_joint(robot, name)
        nb, at = robot.dimensions.base, dict(zip(robot.position_names, robot.neutral_position(), strict=True))
        if base is not None and not nb:
            raise TrajectoryError(f"a path for {robot.name}", why="its base does not move", fix="leave it out")
        path = Line(0.0) if base is None and nb else base
        if path is not None and robot.dimensions.sideways and not path.sideways:
            path = HolonomicPath(path)
        return cls(path, tuple(joints.get(name) or Hold(float(at[name])) for name in robot.joint_names))

    @classmethod
    @checked
    def from_waypoints(
        cls,
        robot: Robot,
        base: Sequence[Sequence[float]] | None = None,
        arm: ArrayLike | None = None,
        *,
        speed: float = 0.3,
        radius: float = 0.3,
        duration: float | None = None,
        times: Sequence[float] | None = None,
    ) -> Trajectory:
        """Through points, from rest to rest: the base along straight lines with rounded corners, the arm by splines.

        Args:
            robot: The robot.
            base: (k, 2) points of the floor [m], see `Waypoints`; None stands at the origin.
            arm: (m, n) positions of the arm's joints in the order of `robot.joint_names` [rad or m]; None rests.
            speed: Of the base [m/s].
            radius: Smallest radius of its corners [m].
            duration: Time of the arm's motion [s]; by default the base's, or 5 s.
            times: (m,) when the arm is at its positions [s], in place of a duration; by default evenly spread.

        Raises:
            TrajectoryError: Points that no path goes through, or that the robot cannot have, such as positions beyond a
                joint's limits; with what it takes.
        """
        path = Waypoints(tuple(tuple(map(float, p)) for p in base), speed, radius) if base is not None else None  # type: ignore[misc]
        require_positive(**{} if duration is None else {"duration": duration})
        if times is not None and arm is None:
            why, fix = "they are those of the arm's positions", "give arm=, too, or a duration"
            raise TrajectoryError("times without positions", why=why, fix=fix, key="times")
        joints = {} if arm is None else positions_of(robot, arm)
        if joints:
            count = len(next(iter(joints.values())))
            end = duration or (path.duration if path is not None else STANDING)
            at = tuple(np.linspace(0.0, end, count).tolist()) if times is None else tuple(times)
        made: dict[str, JointProfile] = {name: Points(at, tuple(q.tolist())) for name, q in joints.items()}
        return cls.of(robot, path, made)

    @classmethod
    @checked
    def from_arrays(
        cls,
        robot: Robot,
        time: ArrayLike,
        pose: ArrayLike | None = None,
        q: ArrayLike | Mapping[str, ArrayLike] | None = None,
        *,
        velocity: ArrayLike | None = None,
        qdot: ArrayLike | Mapping[str, ArrayLike] | None = None,
    ) -> Trajectory:
        """From samples of any planner, with cubic splines between them.

        Args:
            robot: The robot.
            time: (N,) increasing times [s], the first 0.
            pose: (N, 3) `(x, y, phi)` of the base [m, m, rad], or (N, 2) points that it drives through forwards; None
                stands at the origin.
            q: (N, n) positions of the arm's joints in the order of `robot.joint_names`, or (N,) by joint [rad or m];
                joints that are not named rest.
            velocity: (N, 2) `(v, w)`, or (N, 3) `(vx, vy, w)` for a holonomic base [m/s, rad/s]; None for that of the
                poses.
            qdot: Rates of the joints, as q [rad/s or m/s]; None for those of the positions.

        Raises:
            TrajectoryError: Arrays of the wrong shape, poses that the base cannot follow, or positions beyond a joint's
                limits.
            UnknownName: A joint that the arm does not have.
        """
        if pose is not None and not robot.dimensions.base:
            raise TrajectoryError(f"poses for {robot.name}", why="its base does not move", fix="leave pose out")
        path = None if pose is None else table_of(time, pose, velocity, robot.dimensions.sideways)
        joints = {} if q is None else positions_of(robot, q)
        rates = {} if qdot is None else joints_of(robot, qdot)
        clock = np.asarray(time, float)
        return cls.of(robot, path, {name: JointTable(clock, at, rates.get(name)) for name, at in joints.items()})

    @classmethod
    @checked
    def from_csv(cls, robot: Robot, file: str | Path) -> Trajectory:
        """From a CSV file: a column `t` or `time` [s], and any of these; others are left alone.

        `x, y, phi` of the base [m, m, rad], or `x, y`, which it drives through forwards; with them or alone `v, w`, or
        `vx, vy, w` of a holonomic base; `position.JOINT` of an arm joint, or only its name [rad or m], and, where it is
        known, `velocity.JOINT`. `x, y` without `t` are driven as fast as the robot's limits allow. `mmnn excite` writes
        such files. Cells are separated by commas, semicolons or tabs. Poses that wheels cannot roll exactly are
        replaced by the nearest motion that they can, at most 2 cm and 0.1 rad beside them; `notes` tell of it.

        Raises:
            TrajectoryError: The file cannot be read, holds no motion of this robot, or one that it cannot follow; with
                the file, and the line of what is no number or beyond a joint's limits.
            UnknownName: A column `position.NAME` or `velocity.NAME` of a joint that the arm does not have.

        Columns of other names are left alone, but not one that looks like a joint, or a heading, which has none.
        """
        found, nb = TableColumns.read(file, ()), robot.dimensions.base
        names = {name: f"position.{name}" for name in robot.joint_names}
        for head in found:
            kind, _, joint = head.partition(".")
            if kind in ("position", "velocity") and joint and joint not in names:
                raise UnknownName("joint", joint, names, file=file, key=head)
        columns = {name: at if at in found else name for name, at in names.items()}
        joints = {name: found[at] for name, at in columns.items() if at in found}
        used = {*names, *columns.values(), *(f"velocity.{name}" for name in joints)}
        for head in found:
            if head not in used and (near := [name for name in names if name not in joints and alike(head, name)]):
                fix = f"name it {names[near[0]]}, or something that is no joint's"
                why = f"it may be {near[0]}, which has no column"
                raise TrajectoryError(f"nothing uses the column '{head}'", why=why, fix=fix, file=file, line=1)
            if nb and head not in used and head.lower() in HEADINGS and "x" in found and "phi" not in found:
                why, fix = "it may be the heading, which has no column", "name it phi, or something that is no heading"
                raise TrajectoryError(f"nothing uses the column '{head}'", why=why, fix=fix, file=file, line=1)
        moves = bool(nb) and any(name in found for name in BASE_COLUMNS)
        if not joints and not moves:
            fix = f"name columns {', '.join(['x, y, phi'] * bool(nb) + [*names.values()])}"
            raise TrajectoryError(f"no motion of {robot.name}", fix=fix, file=file, line=1)
        if "t" not in found:
            return cls.of(robot, timed(robot, found, list(columns.values())))
        rates = {name: found.get(f"velocity.{name}") for name in joints}
        turns = revolute(robot)
        with found.blamed():
            for name, i in zip(robot.joint_names, robot.arm_index, strict=True):
                if name in joints:
                    found.require_within(columns[name], robot.lower[i], robot.upper[i])
                    found.require_no_jump(columns[name], "rad" if turns[i] else "m", joints[name])
            arm = {name: JointTable(found["t"], at, rates[name]) for name, at in joints.items()}
            return cls.of(robot, found.base(robot.dimensions.sideways) if moves else None, arm)

    @property
    def notes(self) -> tuple[str, ...]:
        """Lines on what is driven in the place of a planner's samples, where they are not driven as they are."""
        return (self.base.note,) if isinstance(self.base, BaseTable) and self.base.note else ()

    @property
    def duration(self) -> float:
        """When all of it has come to rest, or its samples end [s]; inf for a motion without an end."""
        parts = [part for part in (self.base, *self.arm) if not still(part)]
        return self.slowness * max((float(getattr(part, "duration", np.inf)) for part in parts), default=np.inf)

    def table(self, t: ArrayLike, layout: Dimensions) -> Array:
        """Setpoints ahead of a run: rows with pose, velocity, acceleration, q, qdot, qddot side by side.

        Args:
            t: (N,) times [s].
            layout: Sizes of the robot; a row of the table fits into `row[pose_ref.start:qddot_ref.stop]`.

        Returns:
            (N, 3 + 2 twist + 3 n) table, without the base part for a fixed arm.

        Raises:
            TrajectoryError: The base cannot follow, or it is for another kind of base or another number of joints.
        """
        t = times(t)
        self._require_fit(layout)
        table = np.zeros((len(t), layout.pose + 2 * layout.twist + 3 * layout.arm))
        self._fill(t, Setpoint.side_by_side(table, layout))
        return table

    def write(self, time: float, measurement: Measurement, setpoint: Setpoint) -> None:
        """See `SetpointSource.write`."""
        self._fill(np.array([time]), Setpoint(*(getattr(setpoint, name)[None] for name in Setpoint.__slots__)))

    def _fill(self, t: Array, setpoints: Setpoint) -> None:
        """Write the setpoints of times (N,) [s], each of their arrays (N, size)."""
        t = t / self.slowness
        if self.base is not None:
            base = self.base.sample(t)
            if not self.base.followable and len(t) > 3:
                check_followable(t, base.pose, base.velocity)
            setpoints.pose[:], setpoints.velocity[:] = base.pose, base.velocity
            setpoints.acceleration[:] = base.acceleration
        for i, profile in enumerate(self.arm):
            joint = profile.sample(t)
            setpoints.q[:, i], setpoints.qdot[:, i], setpoints.qddot[:, i] = joint.q, joint.qdot, joint.qddot
        for rates in (setpoints.velocity, setpoints.qdot):
            rates /= self.slowness
        for rates in (setpoints.acceleration, setpoints.qddot):
            rates /= self.slowness * self.slowness

    def _require_fit(self, layout: Dimensions) -> None:
        given = None if self.base is None else self.base.sideways
        if given != (layout.sideways if layout.base else None):
            names = {None: "no velocities", False: "(v, w)", True: "(vx, vy, w)"}
            raise TrajectoryError(
                f"a base path of {names[given]} for a base of {names[layout.sideways if layout.base else None]}",
                fix="choose a path made for this base" if layout.base else "leave the base path out",
            )
        if len(self.arm) != layout.arm:
            raise TrajectoryError(
                f"{len(self.arm)} arm profiles for {layout.arm} arm joints",
                fix=f"give {layout.arm} of them",
                code=LENGTH,
            )


def timed(robot: Robot, found: TableColumns, joints: Sequence[str]) -> BasePath:
    """The base along points of a file without times, as fast as its limits allow.

    Raises:
        TrajectoryError: There are columns that need times, or no points.
    """
    needing = [name for name in (*joints, "v", "vx", "vy", "w", "x", "y") if name in found]
    if {*needing} != {"x", "y"}:
        why = "x and y alone are driven as fast as the limits allow" if "x" in needing else ""
        fix = "give the times, in seconds, in a column t"
        raise TrajectoryError("no column t", why=why, fix=fix, file=found.file, line=1)
    if clock := next((head for head in found if set(re.findall("[a-z]+", head.lower())[:1]) & set(TIMES)), None):
        why, fix = f"'{clock}' may be it", "name it t where it has seconds, else something that is no time"
        raise TrajectoryError("no column t", why=why, fix=fix, file=found.file, line=1)
    points = np.stack([found["x"], found["y"]], axis=1)
    with found.blamed():
        path = Smoothed(points, looks=float(found["phi"][0]) if "phi" in found else None)
        return Timed.of(path, robot)


def worded(part: BasePath | JointProfile, most: int = 100) -> str:
    """A path or a profile in a few words: as Python writes it where that is short, else how many samples it has."""
    text, kind = repr(part), type(part).__name__
    if len(text) <= most and "\n" not in text:
        return text
    held = next((held for name in ("time", "times", "points") if (held := getattr(part, name, None)) is not None), ())
    unit = "points" if kind in ("Points", "Waypoints") else "samples"
    return f"{kind} of {len(held)} {unit}" if len(held) else kind


def still(part: BasePath | JointProfile | None) -> bool:
    """Whether a path or a profile does not move at all."""
    return part is None or isinstance(part, Hold) or (isinstance(part, Line) and part.speed == 0)


def positions_of(robot: Robot, given: ArrayLike | Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Positions over time by arm joint, (N,) each; as `joints_of`.

    Raises:
        TrajectoryError: As of `joints_of`, or a position beyond a joint's limits.
        UnknownName: As of `joints_of`.
    """
    found = joints_of(robot, given)
    for name, i in zip(robot.joint_names, robot.arm_index, strict=True):
        if name in found:
            require_within(name, found[name], robot.lower[i], robot.upper[i])
    return found


def joints_of(robot: Robot, given: ArrayLike | Mapping[str, ArrayLike]) -> dict[str, Array]:
    """Numbers over time by arm joint, (N,) each; (N, n) are all of them in their order.

    Raises:
        TrajectoryError: Not one column per joint.
        UnknownName: A joint that the arm does not have.
    """
    names = robot.joint_names
    if isinstance(given, Mapping):
        for name in given:
            require_joint(robot, name)
        return {name: np.asarray(values, float) for name, values in given.items()}
    table = np.asarray(given, float)
    if table.ndim != 2 or table.shape[1] != len(names):
        what = f"positions of shape {table.shape} for {len(names)} arm joints"
        raise TrajectoryError(what, fix=f"give (N, {len(names)}): {', '.join(names)}")
    return dict(zip(names, table.T, strict=True))


def alike(head: str, joint: str) -> bool:
    """Whether a column may be the position of a joint: the same words but for those of positions, or nearly."""
    one, other = (re.findall(r"[a-z]+|[0-9]+", name.lower()) for name in (head, joint))
    if [word for word in one if word not in POSITION_WORDS] == [word for word in other if word not in POSITION_WORDS]:
        return True
    fixed = [[word for word in words if word.isdigit() or len(word) == 1] for words in (one, other)]
    return fixed[0] == fixed[1] and SequenceMatcher(None, head.lower(), joint.lower()).ratio() > NEARLY


def require_joint(robot: Robot, name: str) -> None:
    """Refuse a name that no arm joint of a robot has (`UnknownName`)."""
    if name not in robot.joint_names:
        raise UnknownName("arm joint", name, robot.joint_names)
