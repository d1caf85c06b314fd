"""One quadratic program per control sample: tasks and limits of a robot in, nudot of base and arm out.

    body = WholeBody(robot, [Task()], period=0.002)
    body.put(pose, q)
    body.step(targets)           # (tasks, 24): nudot, and the state moved on by it

The program is solved by daqp; nothing else here leaves plain arithmetic.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...elementary import atan2, cos_sin, log
from ...elementary.matrices import cholesky, inverse, length, product
from ...errors import ConfigError
from ...model.chain import SIZE, chain_of, gradient, hands_of, move
from ...model.reduction import as_measured
from ...model.robot import Robot
from ...settings import one_or_each
from ...signals import Array
from ..limits import Limits
from ..steerable import bend_rate, curvatures
from .capsules import Capsule, Pairs
from .tasks import (
    AXES,
    TARGET,
    FrameMotion,
    P,
    R,
    Task,
    WholeBodySettings,
    add_frame,
    add_wishes,
    advance,
    bounds_of,
    fill_bounds,
    look,
    wanted_acceleration,
)

TOLERANCE = 1e-9  # of limits, in the program's units
EQUAL, SOFT = 5, 8  # daqp's marks of an equation and of a constraint that may give way
DEPENDENT = 1e-8  # relative size of a row's new part under which it depends on those before
STILL, OPEN = 1e-4, 1e30  # speed under which a base stands [m/s]; a bound that is none
NEAR = 0.2  # a goal that is nearer than this to the axle does not say where to turn [m]


def solver() -> Any:
    """The solver, daqp.

    Raises:
        ConfigError: It is not installed.
    """
    try:
        import daqp
    except ImportError as error:
        fix = "pip install 'mmnn_pin[tasks]'"
        raise ConfigError("tasks of the hand without daqp", fix=fix, key="reference.hand") from error
    return daqp.Model()


class WholeBody:
    """Whole-body motion of a robot. Holds a workspace: one object per thread.

    Args:
        robot: The robot.
        tasks: The tasks of its frames; those without a frame take the tips of its arms, one after the other.
        settings: How base and arm share the work.
        limits: Of base and joints.
        period: Control period [s].
        posture: (n,) posture that the joints drift to; None for the joints as they are at `put`.
        capsules: Bodies that keep apart.

    Attributes:
        pose: (3,) pose of the base, (0,) for a fixed arm.
        q: (n,) joints.
        nu: (p,) velocities.
        nudot: (p,) the last solution.
        frames: Names of the tasks' frames.
        places: (tasks, 12) rotation row by row and origin of every frame at the last solution.
        errors: (tasks, 12) what is left to its target, linear and angular; then the accelerations wanted.
        misses: How often the program had no solution, and the robot braked.

    Raises:
        ConfigError: No arm, limits that leave no room, no daqp.
        UnknownName: A frame that the robot does not have.
    """

    def __init__(
        self,
        robot: Robot,
        tasks: Sequence[Task] = (Task(),),
        *,
        settings: WholeBodySettings = WholeBodySettings(),  # noqa: B008 (frozen)
        limits: Limits = Limits(),  # noqa: B008
        period: float = 0.002,
        posture: Array | None = None,
        capsules: Sequence[Capsule] = (),
    ) -> None:
        d, hands = robot.dimensions, hands_of(robot)
        if not (0 < period < np.inf and tasks):
            raise ConfigError(f"{len(tasks)} tasks every {period} s", fix="give a task and a period > 0", key="hand")
        self.robot, self.tasks, self.settings, self.period = robot, tuple(tasks), settings, period
        free = iter([*hands, *[hands[-1]] * len(tasks)])
        self.frames = tuple(task.frame or next(free) for task in tasks)
        self.chains = [chain_of(robot, name) for name in self.frames]
        self.weights = [task.weights for task in tasks]
        order = sorted({task.priority for task in tasks})
        self.levels = [[i for i, task in enumerate(tasks) if task.priority == each] for each in order]
        self.seen = [self._seen(task) for task in tasks]
        self.numbers = np.array([settings.rate, *settings.approach])
        self.bounds = bounds_of(robot, settings, limits)
        self.curve = np.array([*curvatures(robot.base), bend_rate(robot.base), np.nan])
        shares = np.hstack((np.full(d.twist, settings.base), robot_arm(settings, d.arm)))
        self.cost = settings.slack * shares / shares.max() / self.bounds.speed**2
        self.offset, self.arm = robot.arm_map()
        self.posture, self.given = np.zeros(d.arm), posture is not None
        if posture is not None:
            self.posture[:] = posture
        self.pairs = Pairs(robot, capsules, settings.clearance) if capsules else None
        self._allocate(len(tasks))

    def _allocate(self, count: int) -> None:
        """The workspace."""
        d, curve = self.robot.dimensions, self.curve
        p, pairs = d.twist + d.arm, self.pairs.count if self.pairs else 0
        wheels, self.steers = len(self.bounds.wheel_speed), bool(curve[1] < np.inf)
        rows = wheels + 2 * self.steers
        self.pose, self.q, self.nu, self.nudot = np.zeros(d.pose), np.zeros(d.arm), np.zeros(p), np.zeros(p)
        self.position, self.still = np.zeros(d.full), np.zeros(p)
        self.places, self.twists, self.biases = np.zeros((count, SIZE)), np.zeros((count, 6)), np.zeros((count, 6))
        self.J, self.errors, self.target = np.zeros((count, 6, p)), np.zeros((count, 12)), np.zeros(TARGET)
        self.seen_place, self.seen_twist, self.seen_J = np.zeros(SIZE), np.zeros((2, 6)), np.zeros((6, p))
        self.H, self.f, self.wish, self.rows = np.zeros((p, p)), np.zeros(p), np.zeros(p), np.zeros((6, p))
        self.lower, self.upper = np.zeros(p + rows + pairs), np.zeros(p + rows + pairs)
        self.lows, self.highs = self.lower[: p + wheels], self.upper[: p + wheels]
        self.G = np.zeros((rows + pairs, p))
        self.G[:wheels, : d.twist] = self.bounds.wheels
        self.turn = slice(wheels, rows)
        self.sense, self.two, self.misses = np.zeros(p + rows + pairs, np.int32), np.zeros(2), 0
        self.sense[p + rows :] = SOFT
        self.slope = np.zeros(d.arm)
        self.solver, self.ready = solver(), False
        self.solver.settings = {"primal_tol": TOLERANCE, "iter_limit": 1000}

    def _seen(self, task: Task) -> Any:
        """The target that a task looks at: a chain, a point (3,) or nothing."""
        if not task.looks:
            return None
        return chain_of(self.robot, task.at) if isinstance(task.at, str) else np.array(task.at, float)

    def put(self, pose: Array, q: Array, nu: Array | None = None) -> None:
        """Begin from a state.

        Args:
            pose: (3,) pose of the base; (0,) for a fixed arm.
            q: (n,) joints.
            nu: (p,) velocities; None for rest.
        """
        self.pose[:], self.q[:], self.nu[:] = pose, q, 0.0 if nu is None else nu
        self.curve[3] = np.nan
        if not self.given:
            self.posture[:] = q
        self.look_around()

    @property
    def axes(self) -> Array:
        """The robot's axes in the world, (3, 3); the world's own for a fixed arm."""
        if not self.pose.size:
            return np.eye(3)
        c, s = cos_sin(self.pose[2])
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def look_around(self) -> None:
        """Where all frames are and how they move, at the present state."""
        nb = self.robot.dimensions.twist
        as_measured(self.offset, self.arm, self.pose, self.nu[:nb], self.q, self.nu[nb:], self.position, self.still)
        for i, chain in enumerate(self.chains):
            move(chain, self.position, self.nu, self.places[i], self.twists[i], self.biases[i], self.J[i])

    def solve(self, targets: Array) -> Array:
        """The solution at the present state, (p,): a view that the next one overwrites.

        Args:
            targets: (tasks, 24), see `tasks.TARGET`.
        """
        self.look_around()
        self._wish(targets)
        fill_bounds(self.q, self.nu, self.period, self.bounds, self.lows, self.highs)
        if self.pairs is not None:
            last = self.turn.stop
            at = len(self.nu) + last
            self.pairs.fill(self.position, self.nu, self.period, self.G[last:], self.lower[at:], self.upper[at:])
        missed, held = self.misses, np.zeros((0, self.nu.size))
        for level in self.levels:
            rows = self._ask(level, targets)
            if level is self.levels[0]:
                self._steer()
                self._program()
            elif len(held) < self.nu.size:
                self._program_below(held)
            if level is self.levels[-1] or self.misses > missed:
                break
            held = spanned(held, rows)
        return self.nudot

    def _ask(self, level: Sequence[int], targets: Array) -> Array:
        """Put together what tasks of a priority and the wishes cost; the tasks' rows, (m, p)."""
        self.H[:], self.f[:], asked = 0.0, 0.0, []
        for i in level:
            target, weights = targets[i] if self.seen[i] is None else self._looking(i), self.weights[i]
            frame = FrameMotion(self.places[i], self.twists[i], self.biases[i], self.J[i])
            wanted_acceleration(frame, target, self.numbers, self.errors[i])
            add_frame(frame, weights, self.errors[i], self.rows, self.H, self.f)
            asked.append(self.rows[weights > 0.0])
        add_wishes(self.nu, self.wish, self.cost, self.settings.settle, self.H, self.f)
        return np.concatenate(asked)

    def _steer(self) -> None:
        """Rows that keep `low v <= w <= high v` after the sample, in the sense of v; standing, in that of the tasks."""
        if not self.steers:
            return
        last, h, at = self.robot.dimensions.twist - 1, self.period, self.nu.size + self.turn.start
        v, w, (least, most, rate, bend) = self.nu[0], self.nu[last], self.curve
        forwards = v > 0.0
        if abs(v) > STILL:
            bend = self.curve[3] = min(max(w / v, least), most)
            rate *= abs(v) / (abs(v) + self.bounds.acceleration[0] * h)  # it changes most where it is slowest
        else:
            self.lower[at : at + 2], self.upper[at : at + 2] = -OPEN, OPEN
            forwards = bool(self._program()[0] > 0.0)
        low, high = least, most
        if not np.isnan(bend):
            low, high = max(least, bend - rate * h), min(most, bend + rate * h)
        for i, limit in enumerate((low, high)):
            self.G[self.turn.start + i, 0], self.G[self.turn.start + i, last] = -limit, 1.0
            rest = (limit * v - w) / h
            is_least = forwards == (i == 0)
            self.lower[at + i], self.upper[at + i] = (rest, OPEN) if is_least else (-OPEN, rest)

    def _program_below(self, held: Array) -> None:
        """Solve for tasks of a lower priority: what those before reach, as orthonormal rows (k, p), stays as it is.

        Bodies may come no nearer than the solution so far lets them, which therefore is one of this program, too.
        """
        x, k, program = self.nudot, len(held), solver()
        now, kept = np.hstack((x, product(self.G, x))), product(held, x)
        lower, upper = np.minimum(self.lower, now), np.maximum(self.upper, now)
        sense = np.zeros(len(lower) + k, np.int32)
        sense[len(lower) :] = EQUAL
        program.settings = self.solver.settings
        rows, most, least = np.vstack((self.G, held)), np.hstack((upper, kept)), np.hstack((lower, kept))
        flag = program.setup(self.H, self.f, rows, most, least, sense)
        if (flag if isinstance(flag, int) else flag[0]) >= 0:
            found, _, flag, _ = program.solve()
            if flag > 0:
                self.nudot[:] = found

    def _program(self) -> Array:
        """Solve what has been put together; brake where there is no solution."""
        rows = self.G if len(self.G) or not self.ready else None  # what is not given stays
        update = self.solver.update if self.ready else self.solver.setup
        self.sense[: len(self.lows)] = 0
        flag = update(self.H, self.f, rows, self.upper, self.lower, self.sense)
        self.ready = True
        if (flag if isinstance(flag, int) else flag[0]) >= 0:
            x, _, flag, _ = self.solver.solve()
            if flag > 0:
                self.nudot[:] = x
                return self.nudot
        self.misses += 1
        np.clip(-self.nu / self.period, -self.bounds.acceleration, self.bounds.acceleration, out=self.nudot)
        return self.nudot

    def step(self, targets: Array) -> Array:
        """Solve, and move the state on by a period; the solution as in `solve`."""
        nudot = self.solve(targets)
        advance(self.pose, self.q, self.nu, nudot, self.robot.dimensions.sideways, self.period, self.two)
        return nudot

    def _looking(self, i: int) -> Array:
        """The target of a frame that looks at something."""
        seen, point = self.seen[i], self.seen_place[9:]
        if isinstance(seen, np.ndarray):
            point = seen
        else:
            twist, bias = self.seen_twist
            move(seen, self.position, self.nu, self.seen_place, twist, bias, self.seen_J)
        look(self.places[i], point, AXES.index(self.tasks[i].looks), self.target)
        return self.target

    def _wish(self, targets: Array) -> None:
        """Velocities wished for where tasks leave them free: posture, manipulability, heading."""
        s, nb = self.settings, self.robot.dimensions.twist
        self.wish[:nb] = 0.0
        self.wish[nb:] = s.posture * (self.posture - self.q)
        if s.manipulability:
            self.wish[nb:] += s.manipulability * self.climb()
        if nb and s.heading:
            c, sine = cos_sin(self.pose[2])
            x, y = targets[0][P] - self.pose[0], targets[0][P + 1] - self.pose[1]
            if x * x + y * y > NEAR * NEAR:
                self.wish[nb - 1] = s.heading * atan2(c * y - sine * x, c * x + sine * y)
        np.clip(self.wish, -self.bounds.speed, self.bounds.speed, out=self.wish)

    def climb(self, i: int = 0) -> Array:
        """Gradient of log sqrt det(J J') of an arm's rows that have a weight, by its joints, (n,)."""
        rows = self.weights[i] > 0
        J, B = self.J[i][rows, self.robot.dimensions.twist :], np.zeros((6, self.q.size))
        B[rows] = gram_solved(J)
        gradient(self.chains[i], B, self.robot.dimensions.twist, self.slope)
        return self.slope

    def target_here(self, i: int) -> Array:
        """Target (24,) that keeps a frame where it is."""
        target = np.zeros(TARGET)
        target[P : P + 3], target[R : R + 9] = self.places[i, 9:], self.places[i, :9]
        return target


def spanned(held: Array, rows: Array) -> Array:
    """Orthonormal rows (k, p) and more of them, so that they span the rows (m, p), too; by Gram and Schmidt."""
    for row in rows:
        rest = row / max(length(row), 1e-300)
        for _ in range(2):
            rest = rest - product(held.T, product(held, rest))
            size = length(rest)
            if size < DEPENDENT:
                break
            rest = rest / size
        else:
            held = np.vstack((held, rest))
    return held


def gram_solved(J: Array) -> Array:
    """`(J J' + e)^-1 J`, for fewer columns than rows `J (J' J + e)^-1`; e is small."""
    wide = J.shape[1] >= J.shape[0]
    gram = product(J, J.T) if wide else product(J.T, J)
    gram = gram + 1e-6 * np.eye(len(gram))
    return product(inverse(gram), J) if wide else product(J, inverse(gram))


def manipulability(J: Array) -> float:
    """`log sqrt det(J J' + e)`, of the smaller of both products; as its Cholesky factor has it."""
    gram = product(J, J.T) if J.shape[1] >= J.shape[0] else product(J.T, J)
    L = cholesky(gram + 1e-6 * np.eye(len(gram)))
    return sum(log(float(L[i, i])) for i in range(len(L)))


def robot_arm(settings: WholeBodySettings, n: int) -> Array:
    """Costs of the joints, (n,)."""
    return one_or_each(settings.arm, n, "joint", "reference.hand.arm")
