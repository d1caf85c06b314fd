"""Mass matrix, bias forces and Psi of a flattened tree, compiled, in the independent velocities nu.

In the frame O of `mmnn_pin.model.tree_motion` composite bodies are plain sums. The Coriolis matrix is the one that
belongs to the Christoffel symbols, `Mdot = C + C'` (the matrix of `pin.computeCoriolisMatrix`): a particle m at x(q)
has `C = m J' Jdot`, so a body with the twist `(omega, u)` answers a reference twist of angular part `omega_r`, whose
acceleration is `(alpha, a)`, with

    F = m a + alpha x mc + omega_r x (omega x mc)
    N = (tr(Sigma) 1 - Sigma) alpha + (Sigma omega_r) x omega + mc x a

which is linear in the reference and costs one pass over the tree without forming C (the body-level matrix of
Echeandia and Wensing 2021, in moments).
"""

from __future__ import annotations

import math

from mmnn_pin.compiled import compiled
from mmnn_pin.model.tree_motion import (
    ALPHA_REF,
    AXIS,
    AXIS_RATE,
    BODY,
    COMPOSITE,
    FORCE,
    MOMENT,
    OMEGA,
    OMEGA_REF,
    ORIGIN,
    SPEED,
    SPEED_RATE_REF,
    WHIRL,
    Array,
    Tree,
    Vector,
    add,
    along,
    base_rate,
    cross,
    dot,
    first_moment,
    get,
    gravity_in_base,
    joint_rate,
    locate,
    place,
    put,
    times,
)


@compiled
def _composites(tree: Tree, scratch: Array) -> None:
    """Moments of all that each body carries."""
    n = len(tree.parent)
    for k in range(10):
        scratch[0, COMPOSITE + k] = tree.inertia[0, k]
    for i in range(1, n):
        for k in range(10):
            scratch[i, COMPOSITE + k] = scratch[i, BODY + k]
    for i in range(n - 1, 0, -1):
        for k in range(10):
            scratch[tree.parent[i], COMPOSITE + k] += scratch[i, COMPOSITE + k]


@compiled
def _scatter(tree: Tree, i: int, j: int, value: float, M: Array) -> None:
    """Add the coupling of joints i and j through their rows of T."""
    for a in range(tree.start[i], tree.start[i + 1]):
        for b in range(tree.start[j], tree.start[j + 1]):
            x = tree.weight[a] * tree.weight[b] * value
            M[tree.column[a], tree.column[b]] += x
            if i != j:
                M[tree.column[b], tree.column[a]] += x


@compiled
def _scatter_base(tree: Tree, i: int, force: Vector, moment: Vector, M: Array) -> None:
    """Add the coupling of joint i and the base."""
    for b in range(len(tree.base_column)):
        value = force[0] * tree.base_map[0, b] + force[1] * tree.base_map[1, b] + moment[2] * tree.base_map[2, b]
        for a in range(tree.start[i], tree.start[i + 1]):
            x = tree.weight[a] * value
            M[tree.column[a], tree.base_column[b]] += x
            M[tree.base_column[b], tree.column[a]] += x


@compiled
def _base_mass(tree: Tree, scratch: Array, M: Array) -> None:
    """Add the mass of the whole robot as seen from the base."""
    m, cx, cy = scratch[0, COMPOSITE], scratch[0, COMPOSITE + 1], scratch[0, COMPOSITE + 2]
    inertia = scratch[0, COMPOSITE + 4] + scratch[0, COMPOSITE + 7]
    for a in range(len(tree.base_column)):
        x, y, w = tree.base_map[0, a], tree.base_map[1, a], tree.base_map[2, a]
        fx, fy, moment = m * x - cy * w, m * y + cx * w, inertia * w + cx * y - cy * x
        for b in range(len(tree.base_column)):
            value = fx * tree.base_map[0, b] + fy * tree.base_map[1, b] + moment * tree.base_map[2, b]
            M[tree.base_column[a], tree.base_column[b]] += value


@compiled
def _mass(tree: Tree, scratch: Array, M: Array) -> None:
    """`M = T' M_full T` after `place`: composite bodies, one momentum per joint."""
    _composites(tree, scratch)
    M[:, :] = tree.rotors
    for i in range(1, len(tree.parent)):
        w, s = get(scratch, i, AXIS), get(scratch, i, AXIS + 3)
        mc = get(scratch, i, COMPOSITE + 1)
        trace = scratch[i, COMPOSITE + 4] + scratch[i, COMPOSITE + 7] + scratch[i, COMPOSITE + 9]
        force = along(cross(w, mc), s, scratch[i, COMPOSITE])
        moment = along(cross(mc, s), w, trace)
        moment = along(moment, times(scratch, i, COMPOSITE + 4, w), -1.0)
        j = i
        while j > 0:
            value = dot(get(scratch, j, AXIS), moment) + dot(get(scratch, j, AXIS + 3), force)
            _scatter(tree, i, j, value, M)
            j = tree.parent[j]
        _scatter_base(tree, i, force, moment, M)
    _base_mass(tree, scratch, M)


@compiled
def _start(tree: Tree, gravity: Vector, nu_ref: Array, nudot_ref: Array, scratch: Array) -> None:
    """Reference motion of the base, and the force on it."""
    x, y, w = base_rate(tree, nu_ref)
    ax, ay, alpha = base_rate(tree, nudot_ref)
    u, omega = get(scratch, 0, SPEED), scratch[0, OMEGA + 2]
    ax, ay = ax - omega * y - gravity[0], ay + omega * x - gravity[1]
    put(scratch, 0, OMEGA_REF, (0.0, 0.0, w))
    put(scratch, 0, ALPHA_REF, (0.0, 0.0, alpha))
    put(scratch, 0, SPEED_RATE_REF, (ax + w * u[1], ay - w * u[0], -gravity[2]))
    m, cx, cy = tree.inertia[0, 0], tree.inertia[0, 1], tree.inertia[0, 2]
    inertia = tree.inertia[0, 4] + tree.inertia[0, 7]
    put(scratch, 0, FORCE, (m * ax - alpha * cy - w * omega * cx, m * ay + alpha * cx - w * omega * cy, 0.0))
    put(scratch, 0, MOMENT, (0.0, 0.0, inertia * alpha + cx * ay - cy * ax))


@compiled
def _forces(tree: Tree, nu_ref: Array, nudot_ref: Array, scratch: Array) -> None:
    """Reference motion of every body and the force it takes, `F` and `N` of the heading."""
    for i in range(1, len(tree.parent)):
        j = tree.parent[i]
        rate, rate_dot = joint_rate(tree, i, nu_ref), joint_rate(tree, i, nudot_ref)
        w, s = get(scratch, i, AXIS), get(scratch, i, AXIS + 3)
        omega_ref = along(get(scratch, j, OMEGA_REF), w, rate)
        alpha = along(get(scratch, j, ALPHA_REF), w, rate_dot)
        alpha = along(alpha, get(scratch, i, AXIS_RATE), rate)
        a = along(get(scratch, j, SPEED_RATE_REF), s, rate_dot)
        a = along(a, get(scratch, i, AXIS_RATE + 3), rate)
        put(scratch, i, OMEGA_REF, omega_ref)
        put(scratch, i, ALPHA_REF, alpha)
        put(scratch, i, SPEED_RATE_REF, a)
        a = add(a, cross(omega_ref, get(scratch, i, SPEED)))  # of the point at O
        mc = get(scratch, i, BODY + 1)
        trace = scratch[i, BODY + 4] + scratch[i, BODY + 7] + scratch[i, BODY + 9]
        force = along(cross(alpha, mc), a, scratch[i, BODY])
        force = add(force, cross(omega_ref, get(scratch, i, WHIRL)))
        moment = along(cross(mc, a), alpha, trace)
        moment = along(moment, times(scratch, i, BODY + 4, alpha), -1.0)
        moment = add(moment, cross(times(scratch, i, BODY + 4, omega_ref), get(scratch, i, OMEGA)))
        put(scratch, i, FORCE, force)
        put(scratch, i, MOMENT, moment)


@compiled
def _gather(tree: Tree, scratch: Array, out: Array) -> None:
    """Hand the forces down to the base and add what each joint takes of them, `T' tau`."""
    for i in range(len(tree.parent) - 1, 0, -1):
        j = tree.parent[i]
        force, moment = get(scratch, i, FORCE), get(scratch, i, MOMENT)
        tau = dot(get(scratch, i, AXIS), moment) + dot(get(scratch, i, AXIS + 3), force)
        for k in range(tree.start[i], tree.start[i + 1]):
            out[tree.column[k]] += tree.weight[k] * tau
        put(scratch, j, FORCE, add(get(scratch, j, FORCE), force))
        put(scratch, j, MOMENT, add(get(scratch, j, MOMENT), moment))
    fx, fy, moment_z = scratch[0, FORCE], scratch[0, FORCE + 1], scratch[0, MOMENT + 2]
    for k in range(len(tree.base_column)):
        value = fx * tree.base_map[0, k] + fy * tree.base_map[1, k] + moment_z * tree.base_map[2, k]
        out[tree.base_column[k]] += value


@compiled
def _inverse(tree: Tree, position: Array, nu_ref: Array, nudot_ref: Array, scratch: Array, out: Array) -> None:
    """`T' (M T nudot_ref + C T nu_ref + g)` without the rotors, after `place`."""
    _start(tree, gravity_in_base(tree, position), nu_ref, nudot_ref, scratch)
    _forces(tree, nu_ref, nudot_ref, scratch)
    out[:] = 0.0
    _gather(tree, scratch, out)


@compiled
def _add_rotors(tree: Tree, nudot_ref: Array, out: Array) -> None:
    for a in range(len(out)):
        for b in range(len(out)):
            out[a] += tree.rotors[a, b] * nudot_ref[b]


@compiled
def terms(tree: Tree, position: Array, nu: Array, scratch: Array, M: Array, h: Array) -> None:
    """Reduced mass matrix and bias forces, `M = T' M T` and `h = T' (C(q, T nu) T nu + g)`.

    Args:
        tree: The robot.
        position: (nv,) pose of the control frame and joint coordinates [m, rad].
        nu: (p,) independent velocities.
        scratch: Memory of `new_scratch`.
        M: (p, p) out.
        h: (p,) out.
    """
    place(tree, position, nu, scratch)
    _mass(tree, scratch, M)
    _inverse(tree, position, nu, tree.still, scratch, h)


@compiled
def psi(tree: Tree, position: Array, nu: Array, nu_ref: Array, nudot_ref: Array, scratch: Array, out: Array) -> None:
    """What the networks must learn, `T' (M T nudot_ref + C(q, T nu) T nu_ref + g)`, thesis (3.20), (3.21).

    Args:
        tree: The robot.
        position: (nv,) pose of the control frame and joint coordinates [m, rad].
        nu: (p,) independent velocities.
        nu_ref: (p,) reference velocities.
        nudot_ref: (p,) their time derivative.
        scratch: Memory of `new_scratch`.
        out: (p,) out.
    """
    place(tree, position, nu, scratch)
    psi_again(tree, position, nu_ref, nudot_ref, scratch, out)


@compiled
def psi_again(tree: Tree, position: Array, nu_ref: Array, nudot_ref: Array, scratch: Array, out: Array) -> None:
    """`psi` where `scratch` still holds this state, from `terms` or `place`."""
    _inverse(tree, position, nu_ref, nudot_ref, scratch, out)
    _add_rotors(tree, nudot_ref, out)


@compiled
def potential_energy(tree: Tree, position: Array, scratch: Array) -> float:
    """Potential energy [J], as `pin.computePotentialEnergy`; overwrites the places in `scratch`."""
    g = gravity_in_base(tree, position)
    energy = tree.height_energy - dot(g, get(tree.inertia, 0, 1))
    mass = tree.inertia[0, 0]
    for i in range(1, len(tree.parent)):
        locate(tree, position, i, scratch)
        energy -= dot(g, along(first_moment(tree, i, scratch), get(scratch, i, ORIGIN), tree.inertia[i, 0]))
        mass += tree.inertia[i, 0]
    if not tree.level:
        phi = position[2] - tree.frame[2]
        x = position[0] - math.cos(phi) * tree.frame[0] + math.sin(phi) * tree.frame[1]
        y = position[1] - math.sin(phi) * tree.frame[0] - math.cos(phi) * tree.frame[1]
        energy -= mass * (tree.gravity[0] * x + tree.gravity[1] * y)
    return energy
