"""The Pinocchio model flattened to plain arrays for compiled loops, and checked against Pinocchio when it is built.

`flatten` makes a `BodyTree` once per robot; `terms`, `psi` and `potential_energy` of `model.tree.dynamics` work
on it without Pinocchio and without Python. Joints that stand still (zero rows of T) are lumped into the link that
carries them, and so are wheels that are alike all around their axis: of these only a constant mass stays. How joints
hang together is worked out once for all robots that differ in masses alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ...elementary.matrices import length, product
from ...errors import RobotError
from ...signals import Array
from ..base.rolling import TURN, Rolling, base_size, closed, new_maps, roll
from ..urdf.shapes import rotation
from .dynamics import psi_again, terms
from .motion import BASE, NUMBER, PRISMATIC, REVOLUTE, BodyTree, Triple, new_scratch, steer

TOLERANCE = 1e-10
PLANAR = "JointModelPlanar"
UPPER = np.triu_indices(3)

ONE_DOF = {f"JointModel{kind}{axis}" for kind in ("R", "RUB", "P") for axis in "XYZ"} | {
    "JointModelRevoluteUnaligned",
    "JointModelRevoluteUnboundedUnaligned",
    "JointModelPrismaticUnaligned",
}


class _Joints(NamedTuple):
    """The joints of a model and how they hang together, as a key of a cache; masses are not in it."""

    # kind of each joint of one degree of freedom, and its axis; None for the planar root
    kinds: tuple[tuple[int, tuple[float, float, float]] | None, ...]
    parents: tuple[int, ...]  # number of the joint that carries each
    velocities: tuple[int, ...]  # place of each in the velocities
    placements: bytes  # bytes of their placements, (joints, 4, 4)
    T: bytes  # bytes of T, (nv, p)
    rest: bytes  # bytes of the positions at rest, (nv,)


class _Carried(NamedTuple):
    """The moving bodies of a model, and the one that each link is part of."""

    # of every body that moves, the base first: number of the one that carries it, -1 for none; kind and velocity of its
    # joint; its placement there
    bodies: list[tuple[int, int, int, Array]]
    # for every joint's link, the world's first: number of the body that it is part of, its placement there
    links: list[tuple[int, Array]]


@dataclass
class _Body:
    """A link with all that stands still on it.

    Placements are homogeneous, moments are `int (x, 1)(x, 1)' dm` in the frame of the body, both 4 x 4.
    """

    parent: _Body | None = None
    kind: int = 0
    velocity: int = -1
    placement: Array = field(default_factory=lambda: np.eye(4))
    moments: Array = field(default_factory=lambda: np.zeros((4, 4)))


def flatten(
    model: pin.Model,
    T: ArrayLike,
    position_rest: ArrayLike | None = None,
    control_frame: tuple[float, float, float] = (0.0, 0.0, 0.0),
    samples: int = 5,
    seed: int = 0,
    absorb: bool = True,
    rolling: Rolling | None = None,
) -> BodyTree:
    """Flatten a Pinocchio model and check the result against Pinocchio at random states.

    Args:
        model: Full model: a planar root joint or a fixed base, revolute and prismatic joints about any axes.
        T: (nv, p) map from the independent velocities nu to all joint velocities, or what is constant of it.
        position_rest: (nv,) where the joints with a zero row in T stand, default 0 [rad or m].
        control_frame: Control frame in the root link, `(x, y, psi)` [m, m, rad].
        samples: Number of random states of the check.
        seed: Their seed.
        absorb: Lump wheels that are alike all around their axis; off keeps a body for every joint that moves.
        rolling: A base that steers, which makes the rest of T; None where T is constant.

    Raises:
        RobotError: A joint of a type that cannot be flattened, values that are not finite, arrays of wrong shape,
            or a result that differs from Pinocchio's.
    """
    T = _array("T", T, (model.nv, np.shape(T)[-1] if np.ndim(T) else 0))
    rest = _array("position_rest", np.zeros(model.nv) if position_rest is None else position_rest, (model.nv,))
    frame = _array("control_frame", control_frame, (3,))
    rotors, spins = product(T.T, model.armature[:, None] * T), np.zeros((0, 2))
    whole = T if rolling is None else _with_changing(T, rolling, model)
    bodies = _lump(model, _joints(model, whole, rest))
    if absorb and rolling is None:
        rotors = rotors + _absorb_wheels(bodies, T, _mobile(model))
    elif absorb:
        spins = _absorb_turning_wheels(bodies, T)
    tree = _tables(model, bodies, whole, rotors, frame)._replace(spins=spins, steers=rolling is not None)
    verify(tree, model, T, rest, samples, seed, rolling)
    return tree


def _with_changing(T: Array, rolling: Rolling, model: pin.Model) -> Array:
    """T with ones where it changes.

    Raises:
        RobotError: A joint there has a rotor of its own.
    """
    rows, whole = [0, 1, 2, *rolling.turns[:, TURN.place], *rolling.carriers[:, 1]], T.copy()
    whole[rows, : base_size(rolling)] = 1.0
    if model.armature[rows].any():
        raise RobotError("rotors on steering or wheels", why="only the arm's are known", fix="leave their armature out")
    return whole


def _array(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise RobotError(f"{name} has shape {array.shape}", why=f"this robot needs {shape}", fix="give one that fits")
    if not np.isfinite(array).all():
        raise RobotError(f"{name} has an entry that is not finite", fix="give finite numbers")
    return array


def _mobile(model: pin.Model) -> bool:
    """Whether the robot stands on a planar root joint."""
    return model.njoints > 1 and model.joints[1].shortname() == PLANAR


def _joints(model: pin.Model, T: Array, rest: Array) -> _Joints:
    """The joints of a model and how they hang together.

    Raises:
        RobotError: A joint or a value that a tree has no place for.
    """
    kinds, placements = list[tuple[int, tuple[float, float, float]] | None](), []
    parents, places, mobile = tuple(model.parents)[1:], tuple(model.idx_vs)[1:], _mobile(model)
    for j in range(1, model.njoints):
        joint = model.joints[j]
        kind = joint.shortname()
        root = j == 1 and kind == PLANAR
        if not (root or kind in ONE_DOF):
            raise RobotError(
                f"joint '{model.names[j]}' of type {kind} cannot be compiled",
                why="only revolute and prismatic joints and a planar root joint can",
                fix="replace it by joints of these types",
            )
        if not root and mobile and parents[j - 1] == 0:
            raise RobotError(
                f"joint '{model.names[j]}' stands in the world beside the planar root joint",
                why="all bodies of a mobile robot ride on its base",
                fix="hang it on the base",
            )
        placements.append(model.jointPlacements[j].homogeneous)
        kinds.append(None if root else _axis(joint) if "Unaligned" in kind else _axis_of(kind, joint))
        armature = model.armature[model.idx_vs[j] : model.idx_vs[j] + model.nvs[j]]
        numbers = (model.inertias[j].toDynamicParameters(), placements[-1], armature)
        if not all(np.isfinite(some).all() for some in numbers):
            raise RobotError(
                f"mass, inertia, armature or placement at joint '{model.names[j]}' is not finite",
                fix="give finite numbers",
            )
    return _Joints(tuple(kinds), parents, places, np.array(placements).tobytes(), T.tobytes(), rest.tobytes())


def carriers(model: pin.Model, T: Array, rest: Array) -> list[tuple[int, Array]]:
    """For every joint of a model the body that carries its link, 0 for the base, and the link's placement in it (4, 4).

    Arguments as of `flatten(..., absorb=False)`, whose order of bodies this is.
    """
    return [(i, at.copy()) for i, at in _carried(_joints(model, T, rest)).links[1:]]


@lru_cache(maxsize=64)
def _carried(joints: _Joints) -> _Carried:
    """The moving bodies of a model whose joints hang together so, worked out once."""
    rest = np.frombuffer(joints.rest)
    placements, T = np.frombuffer(joints.placements).reshape(-1, 4, 4), np.frombuffer(joints.T).reshape(rest.size, -1)
    found = _Carried([(-1, 0, -1, np.eye(4))], [(0, np.eye(4))])
    for j, (kind_and_axis, parent, k) in enumerate(zip(joints.kinds, joints.parents, joints.velocities, strict=True)):
        body, at = found.links[parent]
        if kind_and_axis is not None:
            (kind, axis), at = kind_and_axis, product(at, placements[j])
            if T[k].any():
                turned = _turned(axis)
                found.bodies.append((body, kind, k, product(at, turned)))
                body, at = len(found.bodies) - 1, turned.T
            else:
                at = product(at, _displaced(kind, np.array(axis), rest[k]))
        found.links.append((body, at))
    return found


def _lump(model: pin.Model, joints: _Joints) -> list[_Body]:
    """The bodies that move, the base first, each with what stands still on it."""
    carried, bodies = _carried(joints), list[_Body]()
    for parent, kind, velocity, placement in carried.bodies:
        bodies.append(_Body(bodies[parent] if parent >= 0 else None, kind, velocity, placement))
    for j, (body, at) in enumerate(carried.links[1:], start=1):
        bodies[body].moments += product(at, moments_of(model.inertias[j]), at.T)
    return bodies


def _absorb_wheels(bodies: list[_Body], T: Array, mobile: bool) -> Array:
    """Lump wheels that are alike all around their axis into the base; returns the mass (p, p) of their spinning."""
    rotors, turn = np.zeros((T.shape[1], T.shape[1])), T[2] if mobile else np.zeros(T.shape[1])
    for body in [b for b in bodies if b.parent is bodies[0] and all(other.parent is not b for other in bodies)]:
        P = body.moments
        off = np.abs([P[0, 0] - P[1, 1], P[0, 1], P[0, 2], P[1, 2], P[0, 3], P[1, 3]])
        if body.kind != REVOLUTE or off.max() > 1e-15 * np.abs(P).max():
            continue
        bodies.remove(body)
        bodies[0].moments += product(body.placement, P, body.placement.T)
        carried = body.placement[2, 2] * turn
        spin = T[body.velocity] + carried
        rotors += (P[0, 0] + P[1, 1]) * (np.outer(spin, spin) - np.outer(carried, carried))
    return rotors


def _absorb_turning_wheels(bodies: list[_Body], T: Array) -> Array:
    """Lump level wheels that are alike all around their axis into what carries them, (m, 2) as `BodyTree.spins`.

    What carries them moves in the plane: their axle stays level, and their spinning turns nothing else.
    """
    spins = list[tuple[float, float]]()
    for body in [b for b in bodies[1:] if b.kind == REVOLUTE and all(other.parent is not b for other in bodies)]:
        P, carrier, at = body.moments, body.parent, body.placement
        off = np.abs([P[0, 0] - P[1, 1], P[0, 1], P[0, 2], P[1, 2], P[0, 3], P[1, 3]])
        upright = at[2, 2]
        above = carrier
        while above is not None and above.parent is not None:
            upright, above = max(abs(upright), 1.0 - abs(above.placement[2, 2])), above.parent
        if T[body.velocity].any() or off.max() > 1e-15 * np.abs(P).max() or abs(upright) > 1e-12 or carrier is None:
            continue
        bodies.remove(body)
        carrier.moments += product(at, P, at.T)
        spins.append((float(body.velocity), float(P[0, 0] + P[1, 1])))
    return np.array(spins, float).reshape(-1, 2)


def _tables(model: pin.Model, bodies: list[_Body], T: Array, rotors: Array, frame: Array) -> BodyTree:
    """The arrays of a tree."""
    mobile, weight = _mobile(model), sum(b.moments[3, 3] for b in bodies) * model.gravity.linear
    root = model.jointPlacements[1] if mobile else pin.SE3.Identity()
    gravity = product(root.rotation.T, model.gravity.linear)
    rows = [_Body(), _Body(), *bodies]  # two more velocities of the base
    row_of = {id(body): i for i, body in enumerate(rows)}
    T_rows = [*(T[:3] if mobile else np.zeros((3, T.shape[1]))), *(T[b.velocity] for b in bodies[1:])]
    spans = [(nonzero[0], nonzero[-1] + 1) if nonzero.size else (0, 0) for nonzero in map(np.flatnonzero, T_rows)]
    numbers = np.zeros((len(rows), NUMBER.weight + max(stop - first for first, stop in spans)))
    for row, body, T_row, (first, stop) in zip(numbers, rows, T_rows, spans, strict=True):
        P, H = body.moments, body.placement
        row[: NUMBER.weight] = *H[:3, :3].ravel(), *H[:3, 3], P[3, 3], *P[:3, 3], *P[UPPER]
        row[NUMBER.weight : NUMBER.weight + stop - first] = T_row[first:stop]
    return BodyTree(
        links=np.array(
            [(row_of.get(id(b.parent), BASE.w), b.kind, b.velocity, *s) for b, s in zip(rows, spans, strict=True)]
        ),
        numbers=numbers,
        rotors=rotors,
        gravity=(gravity[0], gravity[1], gravity[2]),
        frame=(frame[0], frame[1], frame[2]),
        level=int(not (mobile and gravity[:2].any())),
        root_energy=-float(product(weight, root.translation)),
        spins=np.zeros((0, 2)),
        steers=False,
    )


# -- joints and inertias -----------------------------------------------------------------------------------------------


def _axis(joint: pin.JointModel) -> tuple[int, tuple[float, float, float]]:
    """Kind of a joint of one degree of freedom and its axis."""
    data = joint.createData()
    joint.calc(data, np.eye(joint.nq)[0])
    linear, angular = np.ravel(data.S)[:3].tolist(), np.ravel(data.S)[3:].tolist()
    return (REVOLUTE, tuple(angular)) if any(angular) else (PRISMATIC, tuple(linear))


AXES: dict[str, tuple[int, tuple[float, float, float]]] = {}  # of the kinds of joints that say it


def _axis_of(kind: str, joint: pin.JointModel) -> tuple[int, tuple[float, float, float]]:
    """Kind and axis of a joint whose kind says its axis; worked out once."""
    if kind not in AXES:
        AXES[kind] = _axis(joint)
    return AXES[kind]


def _homogeneous(rotation: Array, translation: Array) -> Array:
    return pin.SE3(rotation, translation).homogeneous


@lru_cache(maxsize=1000)
def _turned(axis: tuple[float, float, float]) -> Array:
    """Rotation whose z is the axis, homogeneous; a permutation with signs where the axis is one of x, y, z."""
    x = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    x /= length(x)
    return _homogeneous(np.column_stack((x, np.cross(axis, x), axis)), np.zeros(3))


def _displaced(kind: int, axis: Array, q: float) -> Array:
    """Placement of a body after its joint has moved by q."""
    if kind == REVOLUTE:
        return rotation(axis, q)
    return _homogeneous(np.eye(3), axis * q)


def moments_of(inertia: pin.Inertia) -> Array:
    """`int (x, 1)(x, 1)' dm` of a body, shape (4, 4)."""
    m, c = inertia.mass, np.append(inertia.lever, 1.0)
    moments = m * np.outer(c, c)
    moments[:3, :3] += 0.5 * np.trace(inertia.inertia) * np.eye(3) - inertia.inertia
    return moments


# -- the check against Pinocchio ---------------------------------------------------------------------------------------


def verify(
    tree: BodyTree,
    model: pin.Model,
    T: Array,
    position_rest: Array,
    samples: int = 5,
    seed: int = 0,
    rolling: Rolling | None = None,
) -> None:
    """Compare a tree with Pinocchio at random states.

    Raises:
        RobotError: M, h or Psi differ by more than 1e-10, relative; it names the joint that differs most.
    """
    worst = residual(tree, model, T, position_rest, samples, seed, rolling)
    row = int(np.argmax(worst))
    if worst[row] <= TOLERANCE:
        return
    joint = next(j for j in range(1, model.njoints) if T[model.idx_vs[j] : model.idx_vs[j] + model.nvs[j], row].any())
    raise RobotError(
        f"the compiled dynamics differ from Pinocchio's at joint '{model.names[joint]}' by {worst[row]:.1e}, relative",
        why=f"at most {TOLERANCE:.0e} is accepted",
        fix="look for masses or inertias of that joint that are far apart in size, or not physical",
    )


def residual(
    tree: BodyTree,
    model: pin.Model,
    T: Array,
    position_rest: Array,
    samples: int = 5,
    seed: int = 0,
    rolling: Rolling | None = None,
) -> Array:
    """Largest difference of M, h and Psi from Pinocchio's in every row, relative, shape (p,).

    An entry of M counts relative to `sqrt(M_ii M_jj)` and a force relative to `sqrt(M_ii)` times the largest force in
    that measure, so that a finger counts as much as the base that carries it. What is not a number counts as inf.
    """
    rng, p = np.random.default_rng(seed), T.shape[1]
    scratch, data = new_scratch(tree), model.createData()
    worst, M, h, psi = np.zeros(p), np.zeros((p, p)), np.zeros(p), np.zeros(p)
    whole, maps = (T, None) if rolling is None else (_with_changing(T, rolling, model), new_maps(rolling, T))
    for _ in range(samples):
        position = _random_position(model, whole, position_rest, rng)
        nu, nu_ref, nudot_ref = rng.standard_normal((3, p))
        if rolling is not None and maps is not None:
            roll(rolling, closed(rolling, position), nu, maps)
            steer(tree, maps.T, maps.Tdot, scratch)
        terms(tree, position, nu, scratch, M, h)
        psi_again(tree, position, nu_ref, nudot_ref, scratch, psi)
        q = configuration(model, position, tree.frame)
        map_and_rate = (T, None) if maps is None else (maps.T, maps.Tdot)
        M_pin, h_pin, psi_pin = _by_pinocchio(model, data, map_and_rate, q, nu, nu_ref, nudot_ref)
        root = np.sqrt(np.diag(M_pin))
        root = np.maximum(root, 1e-8 * root.max())
        errors = np.abs(M - M_pin) / np.outer(root, root)
        for ours, theirs in ((h, h_pin), (psi, psi_pin)):
            scale = np.max(np.abs(theirs / root)) + root.max()
            errors = np.column_stack((errors, np.abs(ours - theirs) / (root * scale)))
        worst = np.maximum(worst, np.nan_to_num(errors, nan=np.inf).max(axis=1))
    return worst


def _by_pinocchio(
    model: pin.Model,
    data: pin.Data,
    map_and_rate: tuple[Array, Array | None],
    q: Array,
    nu: Array,
    nu_ref: Array,
    nudot_ref: Array,
) -> tuple[Array, Array, Array]:
    """M, h and Psi by the full matrices of Pinocchio, T and its rate (None for 0)."""
    T, Tdot = map_and_rate
    full = pin.crba(model, data, q)
    M = T.T @ full @ T
    h = T.T @ pin.nonLinearEffects(model, data, q, T @ nu)
    g = T.T @ pin.computeGeneralizedGravity(model, data, q)
    C = pin.computeCoriolisMatrix(model, data, q, T @ nu)
    psi = M @ nudot_ref + T.T @ C @ T @ nu_ref + g
    if Tdot is None:
        return M, h, psi
    return M, h + T.T @ full @ Tdot @ nu, psi + T.T @ full @ Tdot @ nu_ref


def configuration(model: pin.Model, position: Array, frame: Triple) -> Array:
    """Pinocchio's q, shape (nq,), of a position (nv,) that begins with the pose of the control frame."""
    q = pin.neutral(model)
    for joint in list(model.joints)[1:]:
        i, k = joint.idx_q, joint.idx_v
        if joint.nv == 3:
            x, y, phi = position[k : k + 3]
            phi -= frame[2]
            c, s = np.cos(phi), np.sin(phi)
            q[i : i + 4] = x - c * frame[0] + s * frame[1], y - s * frame[0] - c * frame[1], c, s
        elif joint.nq == 2:
            q[i : i + 2] = np.cos(position[k]), np.sin(position[k])
        else:
            q[i] = position[k]
    return q


def _random_position(model: pin.Model, T: Array, rest: Array, rng: np.random.Generator) -> Array:
    """Position within the limits, or within one turn (or 3 m); what stands still stays at rest."""
    position = rng.uniform(-np.pi, np.pi, model.nv)
    for joint in list(model.joints)[1:]:
        low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
        if joint.nq == 1 and -1e3 < low < high < 1e3:
            position[joint.idx_v] = rng.uniform(low, high)
        if joint.nv == 1 and not T[joint.idx_v].any():
            position[joint.idx_v] = rest[joint.idx_v]
    return position
