"""Where a frame of the robot is and how it moves: its placement, its Jacobian `J S`, what `J S` changes by itself.

    twist = J S nu        acceleration = J S nudot + bias        S = T: rolling wheels, mimic joints

Rolling is substituted into the Jacobian, so a base velocity outside of what its wheels permit cannot be asked for. A
`Chain` is the joints between world and frame as arrays. All of it is compiled arithmetic without a libm; Pinocchio is
the second answer in the tests. Twists are (linear, angular) in the world's axes, the linear part that of the frame's
origin.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ..compiled import compiled, inlined
from ..elementary import cos_sin
from ..errors import ConfigError, RobotError, UnknownName
from ..signals import Array, IntArray, Layout
from .robot import Robot

REVOLUTE, PRISMATIC = 0, 1
SIZE = 12  # of a placement: rotation row by row, translation
PUSHES = 0.05  # of an arm that can push along a direction: motion of the frame per joint [m/rad]


class Chain(NamedTuple):
    """The joints that carry a frame; those that stand still are part of the placements."""

    # (m, 2) kind of every joint, and its place among all velocities; of a mobile base the first three are the root's
    links: IntArray
    # (m + 1, 15) placement of every joint on the one before (rotation row by row, translation), its axis; the last row
    # is the frame on the last joint
    numbers: Array
    T: Array  # (nv, p) map from nu to all velocities; of a base that steers `[twist; arm rates]` are its nu
    frame: Array  # (3,) control frame in the root link; (0,) for a fixed arm
    axes: Array  # (m, 6) axis and origin of every joint in the world, written
    columns: Array  # (m, 6) Jacobian of every joint, written
    work: Array  # (24,) scratch


def chain_of(robot: Robot, frame: str) -> Chain:
    """The chain from the world to a frame of a robot.

    Args:
        robot: The robot.
        frame: A frame of its model: a link, or a joint.

    Raises:
        UnknownName: It has no such frame.
        RobotError: A joint that is neither revolute nor prismatic carries it, or a steering joint or a hitch.
    """
    model, mobile = robot.model, robot.dimensions.base > 0
    if not model.existFrame(frame):
        raise UnknownName("frame", frame, frames_of(robot), key="reference.hand.frame")
    found = model.frames[model.getFrameId(frame)]
    joints, j = [], found.parentJoint
    while j > 0:
        joints.append(j)
        j = model.parents[j]
    links, numbers = [], []
    for j in reversed(joints):
        joint, place = model.joints[j], model.jointPlacements[j]
        if j == 1 and mobile:
            for k, axis in enumerate(np.eye(3)):
                links.append((PRISMATIC if k < 2 else REVOLUTE, k))
                numbers.append(row_of(place if k == 0 else pin.SE3.Identity(), axis))
            continue
        if model.names[j] in robot.base.shape:
            what = f"'{model.names[j]}', on which the base stands, carries '{frame}'"
            raise RobotError(what, why="a hand is led from the base's own body", fix="name another frame")
        if joint.nv != 1:
            what = f"joint '{model.names[j]}' of type {joint.shortname()} carries '{frame}'"
            raise RobotError(what, why="only revolute and prismatic joints can", fix="name another frame")
        data = joint.createData()
        joint.calc(data, np.eye(joint.nq)[0])
        linear, angular = np.ravel(data.S)[:3], np.ravel(data.S)[3:]
        links.append((REVOLUTE if angular.any() else PRISMATIC, joint.idx_v))
        numbers.append(row_of(place, angular if angular.any() else linear))
    numbers.append(row_of(found.placement, np.zeros(3)))
    m, frame_in_root = len(links), np.array(robot.frame, float) if mobile else np.zeros(0)
    table = np.array(links, np.int64).reshape(m, 2)
    return Chain(
        table, np.array(numbers), led_map(robot), frame_in_root, np.zeros((m, 6)), np.zeros((m, 6)), np.zeros(24)
    )


def led_map(robot: Robot) -> Array:
    """See `Chain.T`: constant for every base, as what a hand is led by stands on its body."""
    if not robot.steers:
        return robot.T.copy()
    d = robot.dimensions
    T = np.hstack((np.zeros((d.full, d.twist)), robot.template[:, d.base :]))
    T[:3, : d.twist] = robot.base.root_map
    return T


def row_of(placement: pin.SE3, axis: Array) -> Array:
    """A row of `Chain.numbers`."""
    return np.hstack((placement.rotation.ravel(), placement.translation, axis))


def frames_of(robot: Robot) -> list[str]:
    """Frames that the arm moves, links before joints: what a hand can be."""
    arm = {robot.model.getJointId(name) for name in robot.joint_names}
    moved = [f for f in robot.model.frames if arm & {*robot.model.supports[f.parentJoint]}]
    links = [f.name for f in moved if f.type == pin.FrameType.BODY]
    return links + [f.name for f in moved if f.type != pin.FrameType.BODY]


def hands_of(robot: Robot) -> list[str]:
    """The frames of its hands, that of the arm with the most joints first.

    Raises:
        ConfigError: The robot has no arm.
    """
    if not robot.joint_names:
        fix = "choose a robot with an arm, or free its joints with --free"
        raise ConfigError(f"'{robot.name}' has no arm", why="there is no hand to move", fix=fix, key="reference.hand")
    return list(robot.hands)


@inlined
def turn(R: Array, at: int, numbers: Array) -> None:
    """`R[at:at+9] = R[at:at+9] Q`, the (3, 3) Q from the first nine of a row, both row by row."""
    for i in range(3):
        a, b, c = R[at + 3 * i], R[at + 3 * i + 1], R[at + 3 * i + 2]
        for j in range(3):
            R[at + 3 * i + j] = a * numbers[j] + b * numbers[3 + j] + c * numbers[6 + j]


@inlined
def spin(R: Array, x: float, y: float, z: float, q: float) -> None:
    """`R = Rot((x, y, z), q) R`, the axis a unit vector in the world."""
    c, s = cos_sin(q)
    for j in range(3):
        a, b, d = R[j], R[3 + j], R[6 + j]
        along = (1.0 - c) * (x * a + y * b + z * d)
        R[j] = c * a + s * (y * d - z * b) + along * x
        R[3 + j] = c * b + s * (z * a - x * d) + along * y
        R[6 + j] = c * d + s * (x * b - y * a) + along * z


@inlined
def cross(a: Array, i: int, b: Array, j: int, out: Array, k: int, scale: float) -> None:
    """`out[k:k+3] += scale a[i:i+3] x b[j:j+3]`."""
    x = a[i + 1] * b[j + 2] - a[i + 2] * b[j + 1]
    y = a[i + 2] * b[j] - a[i] * b[j + 2]
    z = a[i] * b[j + 1] - a[i + 1] * b[j]
    out[k] += scale * x
    out[k + 1] += scale * y
    out[k + 2] += scale * z


@compiled
def move(chain: Chain, position: Array, nu: Array, place: Array, twist: Array, bias: Array, J: Array) -> None:
    """Placement, twist, bias and `J S` of a chain's frame.

    Args:
        chain: The chain.
        position: (nv,) pose of the control frame, then every joint.
        nu: (p,) velocity.
        place: (12,) written: rotation row by row, origin.
        twist: (6,) written: `J S nu`.
        bias: (6,) written: the acceleration of the frame where nudot = 0.
        J: (6, p) written: `J S`.
    """
    w, m, mobile = chain.work, chain.links.shape[0], chain.frame.size == 3
    # work: 0 step, 3 velocity and 6 its bias at the joint's origin, 9 angular velocity, 12 its bias, 15 axis times
    # rate, 21 pose of the root link
    w[:] = 0.0
    place[:] = 0.0
    place[0] = place[4] = place[8] = 1.0
    if mobile:
        root_pose(chain, position)
    for i in range(m):
        step_to_joint(chain.numbers[i], place, w)
        v = chain.links[i, 1]
        rate, q = 0.0, w[21 + i] if mobile and i < 3 else position[v]
        for j in range(nu.size):
            rate += chain.T[v, j] * nu[j]
        if chain.links[i, 0] == REVOLUTE:
            revolve(chain, i, q, rate, place)
        else:
            slide(chain, i, q, rate, place)
        if mobile and i == 2:
            heading(chain, position, place, chain.axes, w, nu)
    step_to_joint(chain.numbers[m], place, w)
    for k in range(3):
        twist[k], twist[3 + k], bias[k], bias[3 + k] = w[3 + k], w[9 + k], w[6 + k], w[12 + k]
    jacobian(chain, place, J)


@compiled
def root_pose(chain: Chain, position: Array) -> None:
    """The pose of the root link (3,) into `chain.work`; the position (nv,) begins with that of the control frame."""
    w, turned = chain.work, chain.frame[2]
    c, s = cos_sin(position[2] - turned)
    w[21] = position[0] - c * chain.frame[0] + s * chain.frame[1]
    w[22] = position[1] - s * chain.frame[0] - c * chain.frame[1]
    w[23] = position[2] - turned


@compiled
def step_to_joint(row: Array, place: Array, w: Array) -> None:
    """From one joint to the placement of the next, whose numbers are a row (15,)."""
    for k in range(3):
        w[k] = place[3 * k] * row[9] + place[3 * k + 1] * row[10] + place[3 * k + 2] * row[11]
        place[9 + k] += w[k]
    carry(w)
    for k in range(3):
        w[3 + k] += w[18 + k]
    turn(place, 0, row)


@compiled
def carry(w: Array) -> None:
    """The origin moves by a step r with the link: v += omega x r, left at 18, a += alpha x r + omega x (omega x r)."""
    w[18:21] = 0.0
    cross(w, 9, w, 0, w, 18, 1.0)
    cross(w, 12, w, 0, w, 6, 1.0)
    cross(w, 9, w, 18, w, 6, 1.0)


@compiled
def joint_axis(chain: Chain, i: int, rate: float, place: Array) -> None:
    """The axis of joint i in the world, and the axis times its rate."""
    row, axes = chain.numbers[i], chain.axes
    for k in range(3):
        axes[i, k] = place[3 * k] * row[12] + place[3 * k + 1] * row[13] + place[3 * k + 2] * row[14]
        chain.work[15 + k] = axes[i, k] * rate


@compiled
def revolve(chain: Chain, i: int, q: float, rate: float, place: Array) -> None:
    """Turn what follows joint i by its angle q [rad], at a rate [rad/s]."""
    axes, w = chain.axes, chain.work
    joint_axis(chain, i, rate, place)
    spin(place, axes[i, 0], axes[i, 1], axes[i, 2], q)
    cross(w, 9, w, 15, w, 12, 1.0)
    for k in range(3):
        axes[i, 3 + k] = place[9 + k]
        w[9 + k] += w[15 + k]


@compiled
def slide(chain: Chain, i: int, q: float, rate: float, place: Array) -> None:
    """Move what follows joint i by its travel q [m], at a rate [m/s].

    The link before carries the travel, and the sliding adds twice its Coriolis part.
    """
    axes, w = chain.axes, chain.work
    joint_axis(chain, i, rate, place)
    for k in range(3):
        place[9 + k] += axes[i, k] * q
        axes[i, 3 + k] = place[9 + k]
        w[k] = axes[i, k] * q
    carry(w)
    cross(w, 9, w, 15, w, 6, 2.0)
    for k in range(3):
        w[3 + k] += w[18 + k] + w[15 + k]


@inlined
def heading(chain: Chain, position: Array, place: Array, axes: Array, w: Array, nu: Array) -> None:
    """The planar root's velocity is in its own frame: its axes turn with it, and it turns about its own origin."""
    T = chain.T
    vx, vy, rate = 0.0, 0.0, 0.0
    for j in range(nu.size):
        vx += T[0, j] * nu[j]
        vy += T[1, j] * nu[j]
        rate += T[2, j] * nu[j]
    for k in range(3):
        axes[0, k], axes[1, k], axes[2, k] = place[3 * k], place[3 * k + 1], place[3 * k + 2]
        w[3 + k] = axes[0, k] * vx + axes[1, k] * vy
        w[6 + k], w[12 + k] = 0.0, 0.0
        w[9 + k] = axes[2, k] * rate
    cross(w, 9, w, 3, w, 6, 1.0)


@inlined
def jacobian(chain: Chain, place: Array, J: Array) -> None:
    """The columns of all joints, and `J S` of them."""
    links, T, axes, columns = chain.links, chain.T, chain.axes, chain.columns
    J[:] = 0.0
    for i in range(links.shape[0]):
        if links[i, 0] == REVOLUTE:
            x, y, z = place[9] - axes[i, 3], place[10] - axes[i, 4], place[11] - axes[i, 5]
            columns[i, 0] = axes[i, 1] * z - axes[i, 2] * y
            columns[i, 1] = axes[i, 2] * x - axes[i, 0] * z
            columns[i, 2] = axes[i, 0] * y - axes[i, 1] * x
            for k in range(3):
                columns[i, 3 + k] = axes[i, k]
        else:
            for k in range(3):
                columns[i, k], columns[i, 3 + k] = axes[i, k], 0.0
        for j in range(J.shape[1]):
            share = T[links[i, 1], j]
            if share != 0.0:
                for k in range(6):
                    J[k, j] += columns[i, k] * share


@compiled
def gradient(chain: Chain, B: Array, nb: int, out: Array) -> None:
    """`out_d = sum over k, c of B[k, c] d(J S)[k, c] / d nu_d` for the arm, where `move` was called last.

    The derivative of a joint's column j by joint i is, for i before or at j, `a_i x column_j` in both halves; for i
    after j the linear half is `a_j x linear_i`. A sliding i moves only what comes before it.

    Args:
        chain: The chain.
        B: (6, n) weights.
        nb: Base velocities.
        out: (n,) written.
    """
    links, T, axes, columns, w = chain.links, chain.T, chain.axes, chain.columns, chain.work
    out[:] = 0.0
    for j in range(links.shape[0]):
        w[:6] = 0.0
        for c in range(out.size):
            share = T[links[j, 1], nb + c]
            if share != 0.0:
                for k in range(6):
                    w[k] += share * B[k, c]
        for i in range(links.shape[0]):
            w[6:12] = 0.0
            if i <= j and links[i, 0] == REVOLUTE:
                cross(axes[i], 0, columns[j], 0, w, 6, 1.0)
                cross(axes[i], 0, columns[j], 3, w, 9, 1.0)
            elif i > j and links[j, 0] == REVOLUTE:
                cross(axes[j], 0, columns[i], 0, w, 6, 1.0)
            slope = 0.0
            for k in range(6):
                slope += w[k] * w[6 + k]
            for d in range(out.size):
                out[d] += T[links[i, 1], nb + d] * slope


@compiled
def fill_places(chain: Chain, positions: Array, nu: Array, two: Array, J: Array, places: Array) -> None:
    """Placements (N, 12) of a chain's frame at positions (N, nv); nu, two (2, 6) and J are scratch."""
    for k in range(positions.shape[0]):
        move(chain, positions[k], nu, places[k], two[0], two[1], J)


def track(chain: Chain, positions: Array) -> Array:
    """Placements of a chain's frame, (N, 12) rotation row by row and origin, at positions (N, nv)."""
    p, places = chain.T.shape[1], np.zeros((len(positions), SIZE))
    fill_places(chain, np.ascontiguousarray(positions), np.zeros(p), np.zeros((2, 6)), np.zeros((6, p)), places)
    return places


def pushing(chain: Chain, position: Array, arm: int) -> Array:
    """(3,) the first of down, left and ahead of the robot in which the last `arm` velocities move a chain's frame.

    Args:
        chain: The chain.
        position: (nv,) where the robot stands.
        arm: Number of the arm's joints.
    """
    p = chain.T.shape[1]
    J, (c, s) = np.zeros((6, p)), cos_sin(float(position[2])) if chain.frame.size else (1.0, 0.0)
    move(chain, position, np.zeros(p), np.zeros(SIZE), np.zeros(6), np.zeros(6), J)
    for direction in ((0.0, 0.0, -1.0), (-s, c, 0.0), (c, s, 0.0)):
        if float(np.abs(np.array(direction) @ J[:3, p - arm :]).max(initial=0.0)) > PUSHES:
            return np.array(direction)
    return np.array([0.0, 0.0, -1.0])


# -- watched during a run ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Hands:
    """Frames that a motion takes along paths, see `trajectory.Watched`."""

    frames: Mapping[str, bool]  # their names, and whether they should also be turned as the path says
    period: float  # [s]
    wanted: Array  # (N, frames, 7) where they should be: position and quaternion `(x, y, z, w)` in the world

    def writer(self, robot: Robot, layout: Layout) -> Callable[[Array], None]:
        """See `trajectory.Watched`."""
        chains, last = [chain_of(robot, frame) for frame in self.frames], len(self.wanted) - 1
        time, position, to, wanted = (layout.where(name) for name in ("time", "position", "hand", "hand_ref"))

        def write(rows: Array) -> None:
            k = np.minimum(np.round(rows[:, time.start] / self.period).astype(np.int64), last)
            rows[:, wanted] = self.wanted[k].reshape(len(rows), self.wanted[0].size)
            rows[:, to] = np.hstack([poses(track(chain, rows[:, position])) for chain in chains])

        return write


def poses(places: Array) -> Array:
    """Position and unit quaternion `(x, y, z, w)`, w >= 0, (N, 7), of placements (N, 12) as of `track`."""
    R, rows = places[:, :9].reshape(-1, 3, 3), np.arange(len(places))
    x, y, z = R[:, 0, 0], R[:, 1, 1], R[:, 2, 2]
    square = np.stack((1 + x - y - z, 1 - x + y - z, 1 - x - y + z, 1 + x + y + z), axis=1)
    sums = {(i, j): R[:, i, j] + R[:, j, i] for i, j in ((0, 1), (0, 2), (1, 2))}
    skew = [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]]
    products = np.zeros((len(places), 4, 4))  # 4 q_i q_j
    for i in range(4):
        products[:, i, i] = square[:, i]
    for (i, j), each in sums.items():
        products[:, i, j] = products[:, j, i] = each
    for i, each in enumerate(skew):
        products[:, i, 3] = products[:, 3, i] = each
    largest = square.argmax(axis=1)
    q = products[rows, largest] / (2.0 * np.sqrt(square[rows, largest]))[:, None]
    return np.hstack((places[:, 9:], np.where(q[:, 3:] < 0.0, -q, q)))
