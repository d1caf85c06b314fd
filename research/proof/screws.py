"""A robot as screws and pseudo-inertias: all that bounds of its dynamics are made of (`postures`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mmnn_pin.errors import RobotError
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.tree.motion import BASE, LINK, NUMBER, PRISMATIC
from mmnn_pin.model.tree.tree import flatten
from mmnn_pin.signals import Array

BoolArray = NDArray[np.bool_]
PLANAR = np.zeros((3, 4, 4))  # screws of the base's velocities (vx, vy, w)
PLANAR[0, 0, 3] = PLANAR[1, 1, 3] = PLANAR[2, 1, 0] = 1.0
PLANAR[2, 0, 1] = -1.0


@dataclass(frozen=True, eq=False)
class Bodies:
    """A robot as screws and pseudo-inertias: J joints, wheels among them, and B = 1 + J bodies, the base first.

    Attributes:
        above: (B, J) whether a joint carries a body.
        parents: (J,) number of the body that carries each joint.
        sliding: (J,) whether a joint slides.
        placements: (J, 4, 4) of every joint in the body that carries it.
        roots: (B, 4, 4) R with `P = R diag(signs) R'`, in the frame of the body's joint.
        signs: (B, 4) 1, or -1 where a body is none that exists.
        offset: (J,) joint positions for the arm at 0; 0 for wheels.
        columns: (J, n) what each arm joint adds.
        T: (J, p) velocities of the joints.
        base: (p, 4, 4) screws of the base's part of every velocity.
        turning: (p,) how fast the base turns with it.
        uneven: Of wheels: the joint and the root u of how far P may be from that of a wheel alike all around,
            `|tr(A P B') - tr(A P_even B')| <= u^2 |A H| |B H|` at every angle, H the placement of its joint.
        rotors: (p, p) constant mass.
        g: (3,) [m/s^2].
    """

    above: BoolArray
    parents: tuple[int, ...]
    sliding: tuple[bool, ...]
    placements: Array
    roots: Array
    signs: Array
    offset: Array
    columns: Array
    T: Array
    base: Array
    turning: Array
    uneven: tuple[tuple[int, float], ...]
    rotors: Array
    g: Array

    @classmethod
    def of(cls, robot: Robot) -> Bodies:
        """The bodies of a robot.

        Raises:
            RobotError: A joint that neither follows the arm nor is a wheel on the base, a floor that is not level, or
                a joint that cannot be compiled.
        """
        tree = flatten(robot.model, robot.T, robot.rest, (robot.frame[0], robot.frame[1], robot.frame[2]))
        if not tree.level:
            raise RobotError("gravity depends on the heading", why="bounds are for a level floor")
        offset, columns = robot.arm_map()
        links, numbers, joints = tree.links, tree.numbers, slice(BASE.w + 1, None)
        T = np.zeros((len(links), robot.T.shape[1]))
        for row, (_, _, _, first, stop), own in zip(T, links, numbers, strict=True):
            row[first:stop] = own[NUMBER.weight : NUMBER.weight + stop - first]
        parents, at = links[joints, LINK.parent] - BASE.w, links[joints, LINK.coordinate]
        free = ~columns[at].any(axis=1)
        wheels = np.flatnonzero(free).tolist()
        above = np.zeros((1 + len(at), len(at)), bool)
        for k, parent in enumerate(parents):
            above[k + 1] = above[parent]
            above[k + 1, k] = True
        for k in wheels:
            if parents[k] or above[:, k].sum() > 1:
                name = robot.full_velocity_names[at[k]]
                raise RobotError(f"joint '{name}' neither follows the arm nor is a wheel that carries nothing")
        P, uneven = np.array([pseudo_inertia(own) for own in numbers[BASE.w :]]), []
        for k in wheels:
            even = around(P[k + 1])
            uneven.append((k, float(np.sqrt(np.linalg.norm(P[k + 1] - even, 2)))))
            P[k + 1] = even
        values, vectors = np.linalg.eigh(P)
        return cls(
            above=above,
            parents=tuple(parents.tolist()),
            sliding=tuple((links[joints, LINK.kind] == PRISMATIC).tolist()),
            placements=np.array([placement(own) for own in numbers[joints]]).reshape(-1, 4, 4),
            roots=vectors * np.sqrt(np.abs(values))[:, None, :],
            signs=np.where(values < 0, -1.0, 1.0),
            offset=np.where(free, 0.0, offset[at]),
            columns=columns[at],
            T=T[joints],
            base=np.einsum("bi,brc->irc", T[: BASE.w + 1], PLANAR),
            turning=np.abs(T[BASE.w]),
            uneven=tuple(uneven),
            rotors=tree.rotors,
            g=np.array(tree.gravity),
        )

    def placed(self, q: Array) -> tuple[Array, Array]:
        """Transforms of the bodies (N, B, 4, 4) and screws of the joints (N, J, 4, 4) at joint positions (N, J)."""
        H, screws = [np.broadcast_to(np.eye(4), (len(q), 4, 4))], []
        for k, parent in enumerate(self.parents):
            moved, own = np.zeros((len(q), 4, 4)), np.zeros((4, 4))
            moved[:] = np.eye(4)
            if self.sliding[k]:
                moved[:, 2, 3], own[2, 3] = q[:, k], 1.0
            else:
                c, s = np.cos(q[:, k]), np.sin(q[:, k])
                moved[:, 0, 0], moved[:, 0, 1], moved[:, 1, 0], moved[:, 1, 1] = c, -s, s, c
                own[0, 1], own[1, 0] = -1.0, 1.0
            H.append(H[parent] @ self.placements[k] @ moved)
            screws.append(H[-1] @ own @ inverse(H[-1]))
        return np.stack(H, axis=1), np.stack(screws, axis=1) if screws else np.zeros((len(q), 0, 4, 4))


def inverse(H: Array) -> Array:
    """Of transforms (N, 4, 4)."""
    result, R = np.zeros_like(H), H[:, :3, :3].swapaxes(1, 2)
    result[:, :3, :3], result[:, :3, 3], result[:, 3, 3] = R, -(R @ H[:, :3, 3:])[..., 0], 1.0
    return result


def placement(numbers: Array) -> Array:
    """(4, 4) of a joint in the body that carries it."""
    H = np.eye(4)
    H[:3, :3], H[:3, 3] = numbers[NUMBER.rotation : NUMBER.origin].reshape(3, 3), numbers[NUMBER.origin :][:3]
    return H


def pseudo_inertia(numbers: Array) -> Array:
    """(4, 4) of a body in the frame of its joint."""
    P = np.zeros((4, 4))
    xx, xy, xz, yy, yz, zz = numbers[NUMBER.second : NUMBER.weight]
    P[:3, :3] = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
    P[:3, 3] = P[3, :3] = numbers[NUMBER.moment :][:3]
    P[3, 3] = numbers[NUMBER.mass]
    return P


def around(P: Array) -> Array:
    """The nearest pseudo-inertia that is alike all around z."""
    even = np.diag(np.diag(P))
    even[0, 0] = even[1, 1] = (P[0, 0] + P[1, 1]) / 2
    even[2, 3] = even[3, 2] = P[2, 3]
    return even
