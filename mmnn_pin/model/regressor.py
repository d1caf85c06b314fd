"""The regressor of a robot whose masses are not known: `Y(q, nu, nu_ref, nudot_ref) theta = Psi`, linear in theta.

Only the kinematics of the robot are read: placements, axes and T. Its inertias are replaced by random ones, with which
the regressor is checked against Pinocchio when it is built, and then by zeros. `mmnn_pin.model.tree.body` gives the
theta of a robot that is known; a controller does not import it.

theta: ten numbers `m, mc, Sigma` per body that moves (the pseudo-inertia, in the joint's frame turned so that its axis
is z; joints that stand still are lumped into the body that carries them), then the inertia of every joint's rotor,
viscous friction of the base's velocities, viscous and dry friction of every joint, and the dry friction of a skid-steer
base against turning [kg, kg m, kg m^2; N s/m; N m].

A particle m of a body, at x in the axes of the body and with `xbar = (x, 1)`, moves at `V_j xbar` when joint j turns at
rate 1, `V_j = [w x, v]`, and the reference asks it for the acceleration `A xbar`, `A = [alpha x + omega_r x omega x,
a]` (a without gravity). It adds `m xbar' V_j' A xbar` to the torque of joint j, so the whole body adds

    tr(P sym(A' V_j)),      P = int xbar xbar' dm = [Sigma, mc; mc', m],

which is linear in the ten numbers of the pseudo-inertia P (Wensing, Kim, Slotine 2018, IEEE RA-L 3(1)), and these are
the ten numbers of a body in a `BodyTree`. The factorisation is that of the tree, `Mdot = C + C'`, as Slotine and
Li 1987 (Int. J. Robotics Research 6(3)) ask for. Rotors and friction of joints are linear as well; each joint acts on
nu through its row of T. Where a base steers, T and its rate are those of the measured angles, and `Y = T' Y_full`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ..compiled import compiled, copy_to, internal, linked
from ..elementary import tanh
from ..elementary.matrices import product
from ..errors import RobotError
from ..signals import Array, IntArray
from .base.rolling import TURN, Maps, Rolling, closed, new_maps, roll
from .base.steered import SteeredBase
from .reduction import COULOMB_SPEED, as_measured, put_shape
from .tree.dynamics import lead
from .tree.motion import (
    AT,
    BASE,
    LINK,
    NUMBER,
    BodyTree,
    Triple,
    add,
    along,
    cross,
    dot,
    get,
    move,
    new_scratch,
    steer,
)
from .tree.tree import TOLERANCE, configuration, flatten

if TYPE_CHECKING:
    from .robot import Robot

BODY = 10  # parameters of a body: m, mc (3), second moments xx xy xz yy yz zz [kg, kg m, kg m^2]
MOMENTS = ("m", "mx", "my", "mz", "xx", "xy", "xz", "yy", "yz", "zz")
ROWS = 100  # random positions that say how large rows of T are that change
RANK = 1e-9  # relative size under which a singular value of stacked regressors counts as zero


class Massless(NamedTuple):
    """A robot as arrays without its masses: how it moves, and memory to work in (one per thread)."""

    tree: BodyTree  # the tree; its inertial numbers are zero
    # (nj, p) rows of T of the joints that move; of a base that steers those of the last state, before there is one
    # their root mean squares
    joints: Array
    base: int  # number of base velocities nb
    first: int  # row of the first body that moves: the base, or the first link of a fixed arm
    offset: Array  # (nv,) position of every joint where the arm's joints stand at 0
    arm: Array  # (nv, n) what one arm joint moves, itself and its slaves
    coulomb_speed: float  # dry friction is `tanh(speed / coulomb_speed)` [rad/s or m/s]
    scratch: Array  # memory of the tree
    position: Array  # (nv,) measured position
    nu: Array  # (p,) measured velocity
    Y: Array  # (p, k) the regressor
    rows: IntArray  # (nj,) places of these joints in a velocity
    drift: Array  # (nj, p) rates of their rows; (0, 0) where T is constant
    shape: IntArray  # (shape,) places of the pivots of a base that steers
    rolling: Rolling | None  # that base; None where T is constant
    maps: Maps  # T and its rate, and memory to work in


@dataclass(frozen=True, eq=False)
class Regressor:
    """The regressor of one robot; k parameters.

    Attributes:
        massless: The arrays of the compiled functions; `workspace` makes those of another thread.
        bodies: Joint that carries each moving body, `root` for the base.
        joints: Joints that move.
        labels: Name of every parameter, `body.m` to `body.zz`, `joint.rotor`, `v.viscous`, `joint.coulomb` ...
        base: The base, where it steers; else None.
    """

    massless: Massless
    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    labels: tuple[str, ...]
    base: SteeredBase | None = None

    @classmethod
    def of(cls, robot: Robot, coulomb_speed: float = COULOMB_SPEED) -> Regressor:
        """Regressor of a robot, of which only the kinematics are read.

        Args:
            robot: The robot.
            coulomb_speed: Velocity in `tanh(velocity / coulomb_speed)` of the dry friction [rad/s or m/s].

        Raises:
            RobotError: A joint that cannot be flattened, or a regressor that differs from Pinocchio's dynamics.
        """
        layout, T, rolling = robot.dimensions, np.array(robot.template), robot.rolling
        frame = tuple(robot.frame) if layout.base else (0.0, 0.0, 0.0)
        model = with_any_inertias(robot.model)
        full = flatten(model, T, robot.neutral_position(), frame, absorb=False, rolling=rolling)
        theta, moving = inertial_parameters(full, layout.base), moving_joints(T, layout.base, rolling)
        offset, arm = robot.arm_map()
        turning = robot.base.scrubs
        massless = without_masses(full, T, layout.base, offset, arm, coulomb_speed, turning, rolling)
        names = robot.full_velocity_names
        bodies = ("root",) * bool(layout.base) + tuple(names[i] for i in full.links[BASE.w + 1 :, 2])
        joints = tuple(names[i] for i in moving)
        labels = [f"{body}.{moment}" for body in bodies for moment in MOMENTS]
        labels += [f"{joint}.rotor" for joint in joints]
        labels += [f"{name}.viscous" for name in (*robot.velocity_names[: layout.base], *joints)]
        labels += [f"{joint}.coulomb" for joint in joints] + ["w.coulomb"] * turning
        steered = robot.base if isinstance(robot.base, SteeredBase) else None
        regressor = cls(massless, bodies, joints, tuple(labels), steered)
        if rolling is not None:
            rng = np.random.default_rng(0)
            rows = [robot.T_at(regressor.random_position(rng))[moving] for _ in range(ROWS)]
            massless.joints[:] = np.sqrt(np.mean(np.square(rows), axis=0))
        regressor.verify(model, T, theta)
        return regressor

    @property
    def size(self) -> int:
        """Number of parameters k."""
        return len(self.labels)

    @property
    def inertial(self) -> int:
        """Number of inertial parameters, ten per body; they stand first."""
        return BODY * len(self.bodies)

    @property
    def carrying(self) -> IntArray:
        """Columns of the bodies at the arm's ends, or of the base without an arm, which a load changes."""
        links, m = self.massless.tree.links, self.massless
        moved = {joint for joint, row in zip(self.joints, m.joints, strict=True) if np.any(row[m.base :] != 0.0)}
        parents = set(links[m.first :, LINK.parent].tolist())
        ends = [b for b, body in enumerate(self.bodies) if body in moved and m.first + b not in parents]
        return np.concatenate([BODY * b + np.arange(BODY) for b in ends or [0]]).astype(np.int64)

    def workspace(self) -> Massless:
        """The arrays with a memory of their own to work in."""
        m = self.massless
        own = {name: getattr(m, name).copy() for name in ("joints", "scratch", "position", "nu", "Y", "drift")}
        return m._replace(maps=Maps(*(part.copy() for part in m.maps)), **own)

    def matrix(self, position: Array, nu: Array, nu_ref: Array, nudot_ref: Array) -> Array:
        """Y, (p, k): `Y theta = M nudot_ref + C(q, nu) nu_ref + gravity + friction`.

        Threads may share a regressor: each call works in a memory of its own.

        Args:
            position: (nv,) pose of the control frame and joint coordinates [m, rad].
            nu: (p,) velocities.
            nu_ref: (p,) reference velocities.
            nudot_ref: (p,) their time derivative.
        """
        work = self.workspace()
        work.position[:], work.nu[:] = position, nu
        regress(work, np.array(nu_ref, float), np.array(nudot_ref, float))
        return work.Y

    def along(self, q: Array, nu: Array, nudot: Array, shape: Array | None = None) -> Array:
        """Y along a motion, (N, p, k): `Y theta = M nudot + C(q, nu) nu + gravity + friction`, the base at the origin.

        Args:
            q: (N, n) the arm's joints [rad or m].
            nu: (N, p) velocities.
            nudot: (N, p) their time derivative.
            shape: (N, shape) angles of the pivots of a base that steers [rad]; None without any.
        """
        work = self.workspace()
        out = np.zeros((len(q), *work.Y.shape))
        shape = np.zeros((len(q), 0)) if shape is None else shape
        q, nu, nudot, shape = (np.ascontiguousarray(part, float) for part in (q, nu, nudot, shape))
        regress_along(work, np.zeros(3 if work.base else 0), q, shape, nu, nudot, out)
        return out

    def gram(self, samples: int = 200, seed: int = 0) -> Array:
        """Mean of `Y' Y` over random states and references of unit size, (k, k)."""
        rng, m = np.random.default_rng(seed), self.massless
        stacked = [self.matrix(self.random_position(rng), *rng.standard_normal((3, m.nu.size))) for _ in range(samples)]
        Y = np.vstack(stacked)
        return np.asarray(Y.T @ Y / samples)

    def identifiable(self, samples: int = 200, seed: int = 0) -> Array:
        """Orthonormal basis of the directions of theta that Psi depends on, (k, number of base parameters).

        The others change nothing on any motion: Y times them is zero. (Base parameters, numerically: Gautier 1991,
        J. Robotic Systems 8(4).) After the reduction by T they are fewer than those of the robot on its own.
        """
        gram = self.gram(samples, seed)
        scale = 1.0 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
        values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
        kept = vectors[:, values > RANK * values[-1]] / scale[:, None]
        return np.asarray(np.linalg.qr(kept)[0])

    def unit(self, samples: int = 200, seed: int = 0) -> Array:
        """Identifiable directions, scaled so that random motion excites each with 1, (k, number of base parameters).

        With these columns W, `W' gram() W = 1`, and the eigenvalues of `W' G W` are the excitation of a motion whose
        mean `Y' Y` is G, relative to random motion.
        """
        gram = self.gram(samples, seed)
        scale = 1.0 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
        values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
        kept = values > RANK * values[-1]
        return np.asarray(scale[:, None] * vectors[:, kept] / np.sqrt(values[kept]))

    def random_position(self, rng: np.random.Generator) -> Array:
        """A pose and an arm somewhere, slaves with their masters, wheels along a path, (nv,)."""
        m = self.massless
        position = m.offset + product(m.arm, rng.uniform(-np.pi, np.pi, m.arm.shape[1]))
        if m.base:
            position[:3] = rng.uniform(-np.pi, np.pi, 3)
        return self.turned(position, rng)

    def turned(self, position: Array, rng: np.random.Generator) -> Array:
        """A position (nv,) with the pivots of a base that steers at random angles, changed in place."""
        m, base = self.massless, self.base
        if base is not None and m.rolling is not None:
            position[m.shape] = base.random_angles(rng)
            closed(m.rolling, position)
        return position

    def verify(self, model: pin.Model, T: Array, theta: Array, samples: int = 5, seed: int = 0) -> None:
        """Compare `Y theta` with Pinocchio's full matrices at random states.

        Raises:
            RobotError: They differ by more than 1e-10 of the largest force.
        """
        rng, data, p = np.random.default_rng(seed), model.createData(), T.shape[1]
        Tdot, rolling = np.zeros_like(T), self.massless.rolling
        worst = 0.0
        for _ in range(samples):
            position = self.random_position(rng)
            nu, nu_ref, nudot_ref = rng.standard_normal((3, p))
            q = configuration(model, position, self.massless.tree.frame)
            if rolling is not None:
                maps = new_maps(rolling, T)
                roll(rolling, position, nu, maps)
                T, Tdot = maps.T, maps.Tdot
            M, C = pin.crba(model, data, q), pin.computeCoriolisMatrix(model, data, q, T @ nu)
            full = M @ (T @ nudot_ref + Tdot @ nu_ref) + C @ T @ nu_ref + pin.computeGeneralizedGravity(model, data, q)
            psi = T.T @ full
            ours = self.matrix(position, nu, nu_ref, nudot_ref)[:, : theta.size] @ theta
            worst = max(worst, float(np.nan_to_num(np.abs(ours - psi) / np.abs(psi).max(), nan=np.inf).max()))
        if worst > TOLERANCE:
            raise RobotError(
                f"the regressor differs from Pinocchio's dynamics by {worst:.1e}, relative",
                why=f"at most {TOLERANCE:.0e} is accepted",
                fix="look for joints whose distances or rows of T are far apart in size",
            )


def without_masses(
    tree: BodyTree, T: Array, base: int, offset: Array, arm: Array, coulomb_speed: float, turning: bool = False,
    rolling: Rolling | None = None,
) -> Massless:  # fmt: skip
    """The kinematics of a tree, and memory to work in.

    Args:
        tree: A tree with a body for every joint that moves (`flatten(..., absorb=False)`).
        T: (nv, p) the map it was made with.
        base: Number of base velocities.
        offset: (nv,) positions where the arm's joints stand at 0.
        arm: (nv, n) what each arm joint moves.
        coulomb_speed: As in `Regressor.of`.
        turning: Whether dry friction acts against the turning of the base, too.
        rolling: A base that steers, which makes the rest of T; None where T is constant.
    """
    numbers, rows = tree.numbers.copy(), moving_joints(T, base, rolling)
    joints = T[rows]
    numbers[:, NUMBER.mass : NUMBER.weight] = 0.0
    first, p = first_body(base), T.shape[1]
    scratch = new_scratch(tree)
    scratch[BASE.w, AT.rotation : AT.rotation + 9] = np.eye(3).ravel()
    return Massless(
        tree=tree._replace(numbers=numbers, rotors=np.zeros((p, p)), root_energy=0.0),
        joints=joints,
        base=base,
        first=first,
        offset=offset,
        arm=arm,
        coulomb_speed=float(coulomb_speed),
        scratch=scratch,
        position=offset.copy(),
        nu=np.zeros(p),
        Y=np.zeros((p, BODY * (len(tree.links) - first) + 3 * len(joints) + base + turning)),
        rows=rows,
        drift=np.zeros((0, 0) if rolling is None else joints.shape),
        shape=np.zeros(0, np.int64) if rolling is None else rolling.turns[:, TURN.place].copy(),
        rolling=rolling,
        maps=new_maps(rolling, T),
    )


def with_any_inertias(model: pin.Model, seed: int = 0) -> pin.Model:
    """A copy of a model with random inertias of eight particles each, and no armature."""
    rng, copy = np.random.default_rng(seed), model.copy()
    for j in range(1, copy.njoints):
        masses, points = rng.uniform(0.1, 1.0, 8), rng.uniform(-0.3, 0.3, (8, 3))
        total = masses.sum()
        centre = masses @ points / total
        second = (points - centre).T @ np.diag(masses) @ (points - centre)
        copy.inertias[j] = pin.Inertia(total, centre, np.trace(second) * np.eye(3) - second)
    copy.armature = np.zeros(copy.nv)
    return copy


# -- how theta is laid out ---------------------------------------------------------------------------------------------


def inertial_parameters(tree: BodyTree, base: int) -> Array:
    """The ten numbers of every body of a tree, one after the other."""
    return np.array(tree.numbers[first_body(base) :, NUMBER.mass : NUMBER.weight].ravel())


def first_body(base: int) -> int:
    """Row of a tree with the first body that moves."""
    return BASE.w if base else BASE.w + 1


def moving_joints(T: Array, base: int, rolling: Rolling | None = None) -> NDArray[np.int64]:
    """Rows of T of the joints that move, without the root; `rolling` makes those that change."""
    root, moves = 3 if base else 0, np.array(T.any(axis=1))
    if rolling is not None:
        moves[rolling.turns[:, TURN.place]] = moves[rolling.carriers[:, 1]] = True
    return root + np.flatnonzero(moves[root:])


# -- compiled: Y at a state --------------------------------------------------------------------------------------------


@linked
def regress(known: Massless, nu_ref: Array, nudot_ref: Array) -> None:
    """Y at the known position and velocity, (p, k), into `known.Y`.

    Args:
        known: The robot; `known.position` and `known.nu` say where it is.
        nu_ref: (p,) reference velocities.
        nudot_ref: (p,) their time derivative.
    """
    tree, Y = known.tree, known.Y
    turn_joints(known, known.rolling)
    move(tree.links, tree.numbers, known.position, known.nu, known.scratch)
    lead(tree, known.position, nu_ref, nudot_ref, 1.0, known.scratch)
    Y[:] = 0.0
    for i in range(known.first, len(tree.links)):
        body_columns(known, i)
    joint_columns(known, nu_ref, nudot_ref, BODY * (len(tree.links) - known.first))


@compiled
def turn_joints(known: Massless, rolling: Rolling | None) -> None:
    """Rows of T and of its rate at the known position and velocity, of tree and joints."""
    if rolling is not None:
        maps = known.maps
        roll(rolling, known.position, known.nu, maps)
        steer(known.tree, maps.T, maps.Tdot, known.scratch)
        for k in range(known.rows.size):
            copy_to(maps.T[known.rows[k]], known.joints[k])
            copy_to(maps.Tdot[known.rows[k]], known.drift[k])


@compiled
def regress_along(known: Massless, pose: Array, q: Array, shape: Array, nu: Array, nudot: Array, out: Array) -> None:
    """Y at every row of a motion at one pose, see `Regressor.along`, into out (N, p, k)."""
    for i in range(len(q)):
        measured(known, pose, nu[i, : known.base], q[i], nu[i, known.base :], shape[i])
        regress(known, nu[i], nudot[i])
        for j in range(known.Y.shape[0]):
            for k in range(known.Y.shape[1]):
                out[i, j, k] = known.Y[j, k]


@compiled
def measured(known: Massless, pose: Array, velocity: Array, q: Array, qdot: Array, shape: Array) -> None:
    """Position (nv,) and nu (p,) of a measurement, see `reduction.as_measured` and `put_shape`."""
    as_measured(known.offset, known.arm, pose, velocity, q, qdot, known.position, known.nu)
    put_shape(known.shape, shape, known.position)


@internal
def body_columns(known: Massless, i: int) -> None:
    """Columns of Y of body i, after a pass over the tree."""
    links, scratch, Y = known.tree.links, known.scratch, known.Y
    column = BODY * (i - known.first)
    omega, ref = turned(scratch, i, get(scratch, i, AT.omega)), turned(scratch, i, get(scratch, i, AT.omega_ref))
    alpha, a3 = turned(scratch, i, get(scratch, i, AT.alpha)), turned(scratch, i, get(scratch, i, AT.a))
    both = dot(ref, omega)  # omega_r x (omega x .) = omega omega_r' - (omega_r' omega) 1
    a0 = add((-both, alpha[2], -alpha[1]), along((0.0, 0.0, 0.0), omega, ref[0]))
    a1 = add((-alpha[2], -both, alpha[0]), along((0.0, 0.0, 0.0), omega, ref[1]))
    a2 = add((alpha[1], -alpha[0], -both), along((0.0, 0.0, 0.0), omega, ref[2]))
    origin, j = get(scratch, i, AT.origin), i
    while j >= 0:
        w = get(scratch, j, AT.w)
        lever = along(origin, get(scratch, j, AT.origin), -1.0)
        v = turned(scratch, i, add(get(scratch, j, AT.s), cross(w, lever)))
        w = turned(scratch, i, w)
        v0, v1, v2 = (0.0, w[2], -w[1]), (-w[2], 0.0, w[0]), (w[1], -w[0], 0.0)
        first = links[j, LINK.first]
        for k in range(links[j, LINK.stop] - first):
            t, y = scratch[j, AT.weight + k], Y[first + k, column : column + BODY]
            y[0] += t * dot(a3, v)
            y[1] += t * (dot(a0, v) + dot(a3, v0))
            y[2] += t * (dot(a1, v) + dot(a3, v1))
            y[3] += t * (dot(a2, v) + dot(a3, v2))
            y[4] += t * dot(a0, v0)
            y[5] += t * (dot(a0, v1) + dot(a1, v0))
            y[6] += t * (dot(a0, v2) + dot(a2, v0))
            y[7] += t * dot(a1, v1)
            y[8] += t * (dot(a1, v2) + dot(a2, v1))
            y[9] += t * dot(a2, v2)
        j = links[j, LINK.parent] if j > BASE.w else j - 1


@internal
def joint_columns(known: Massless, nu_ref: Array, nudot_ref: Array, first: int) -> None:
    """Columns of Y of rotors and of viscous and dry friction, from `first` on; a last one is that of turning."""
    joints, nu, Y = known.joints, known.nu, known.Y
    count, p = joints.shape
    for i in range(known.base):
        Y[i, first + count + i] = nu[i]
    for k in range(count):
        acceleration, speed = 0.0, 0.0
        for i in range(p):
            acceleration += joints[k, i] * nudot_ref[i]
            speed += joints[k, i] * nu[i]
            if known.drift.shape[0] > 0:
                acceleration += known.drift[k, i] * nu_ref[i]
        dry = tanh(speed / known.coulomb_speed)
        rough = first + count + known.base + k
        for i in range(p):
            Y[i, first + k] = joints[k, i] * acceleration
            Y[i, rough] = joints[k, i] * speed
            Y[i, rough + count] = joints[k, i] * dry
    turning = first + 3 * count + known.base
    if turning < Y.shape[1]:
        w = known.base - 1
        Y[w, turning] = tanh(nu[w] / known.coulomb_speed)


@compiled
def turned(scratch: Array, i: int, a: Triple) -> tuple[float, float, float]:
    """A vector along O in the axes of body i."""
    k = AT.rotation
    x, y, z = get(scratch, i, k), get(scratch, i, k + 3), get(scratch, i, k + 6)
    return (
        x[0] * a[0] + y[0] * a[1] + z[0] * a[2],
        x[1] * a[0] + y[1] * a[1] + z[1] * a[2],
        x[2] * a[0] + y[2] * a[1] + z[2] * a[2],
    )
