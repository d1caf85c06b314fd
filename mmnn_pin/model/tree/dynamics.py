"""Mass matrix, bias forces and Psi of a flattened tree, compiled, in the independent velocities nu.

The Coriolis matrix is the one that belongs to the Christoffel symbols, `Mdot = C + C'` (the matrix of
`pin.computeCoriolisMatrix`): a particle m at x(q) has `C = m J' Jdot`, so a body that turns at `omega` answers a
reference that turns at `omega_r`, with the accelerations `alpha` and, at its origin, `a`, with

    F = m a + alpha x mc + omega_r x (omega x mc)
    N = (tr(Sigma) 1 - Sigma) alpha + (Sigma omega_r) x omega + mc x a

which is linear in the reference and costs one pass over the tree without forming C (the body-level matrix of
Echeandia and Wensing 2021, in moments). Symbols as in `mmnn_pin.model.tree.motion`.
"""

from __future__ import annotations

from mmnn_pin.compiled import inlined, internal, linked

from ...elementary import cos_sin
from ...signals import Array
from .motion import (
    AT,
    BASE,
    LINK,
    NUMBER,
    ZERO,
    BodyTree,
    Indices,
    Triple,
    add,
    along,
    base_drift,
    base_rates,
    cross,
    dot,
    drift,
    first_moment,
    get,
    locate,
    place,
    put,
    rate,
    times,
)


@inlined
def _gravity(gravity: Triple, frame: Triple, level: int, position: Array) -> Triple:
    """Gravity in O."""
    x, y, z = gravity
    if not level:
        c, s = cos_sin(position[2] - frame[2])
        x, y = c * x + s * y, c * y - s * x
    return x, y, z


@inlined
def _sum_masses(links: Indices, numbers: Array, scratch: Array) -> None:
    """Moments of every body with all that it carries: `Sigma + d mc' + mc d' + m d d'` about a point d away."""
    for k in range(10):
        scratch[BASE.w, AT.all_mass + k] = numbers[BASE.w, NUMBER.mass + k]
    for i in range(BASE.w + 1, len(links)):
        for k in range(10):
            scratch[i, AT.all_mass + k] = scratch[i, AT.mass + k]
    for i in range(len(links) - 1, BASE.w, -1):
        j, m, d, mc = (
            links[i, LINK.parent],
            scratch[i, AT.all_mass],
            get(scratch, i, AT.lever),
            get(scratch, i, AT.all_moment),
        )
        h = along(mc, d, 0.5 * m)
        scratch[j, AT.all_mass] += m
        put(scratch, j, AT.all_moment, along(add(get(scratch, j, AT.all_moment), mc), d, m))
        k = 0
        for a in range(3):
            for b in range(a, 3):
                scratch[j, AT.all_second + k] += scratch[i, AT.all_second + k] + d[a] * h[b] + d[b] * h[a]
                k += 1


@inlined
def _momentum(i: int, body: int, scratch: Array) -> tuple[Triple, Triple]:
    """Linear and angular momentum of a body with all that it carries, moving along axis i at rate 1."""
    w, s, mc = get(scratch, i, AT.w), get(scratch, i, AT.s), get(scratch, body, AT.all_moment)
    k = AT.all_second
    trace = scratch[body, k] + scratch[body, k + 3] + scratch[body, k + 5]
    linear = along(cross(w, mc), s, scratch[body, AT.all_mass])
    angular = along(along(cross(mc, s), w, trace), times(scratch, body, k, w), -1.0)
    return linear, angular


@inlined
def _couple(
    links: Indices, numbers: Array, i: int, j: int, linear: Triple, angular: Triple, scratch: Array, M: Array
) -> None:
    """Add what joint j feels of a momentum of joint i, through their rows of T."""
    value = dot(get(scratch, j, AT.w), angular) + dot(get(scratch, j, AT.s), linear)
    first_i, first_j = links[i, LINK.first], links[j, LINK.first]
    for a in range(links[i, LINK.stop] - first_i):
        for b in range(links[j, LINK.stop] - first_j):
            x = scratch[i, AT.weight + a] * scratch[j, AT.weight + b] * value
            M[first_i + a, first_j + b] += x
            if i != j:
                M[first_j + b, first_i + a] += x


@inlined
def _mass(links: Indices, numbers: Array, rotors: Array, scratch: Array, M: Array) -> None:
    """`M = T' M_full T` after `place`, by composite bodies."""
    _sum_masses(links, numbers, scratch)
    for a in range(M.shape[0]):
        for b in range(M.shape[1]):
            M[a, b] = rotors[a, b]
    for i in range(len(links)):
        linear, angular = _momentum(i, max(i, BASE.w), scratch)
        j = i
        while j > BASE.w:
            _couple(links, numbers, i, j, linear, angular, scratch, M)
            angular = add(angular, cross(get(scratch, j, AT.lever), linear))
            j = links[j, LINK.parent]
        for base in range(min(i, BASE.w) + 1):
            _couple(links, numbers, i, base, linear, angular, scratch, M)


@inlined
def _lead(j: int, i: int, speed: float, speed_rate: float, scratch: Array) -> None:
    """Motion of the reference of body i on body j."""
    omega_ref, alpha = get(scratch, j, AT.omega_ref), get(scratch, j, AT.alpha)
    a = add(get(scratch, j, AT.a), cross(alpha, get(scratch, i, AT.lever)))
    a = add(a, cross(omega_ref, get(scratch, i, AT.lever_rate)))
    put(scratch, i, AT.a, along(along(a, get(scratch, i, AT.s), speed_rate), get(scratch, i, AT.s_rate), speed))
    put(scratch, i, AT.omega_ref, along(omega_ref, get(scratch, i, AT.w), speed))
    alpha = along(along(alpha, get(scratch, i, AT.w), speed_rate), get(scratch, i, AT.w_rate), speed)
    put(scratch, i, AT.alpha, alpha)


@linked
def lead(tree: BodyTree, position: Array, nu_ref: Array, nudot_ref: Array, share: float, scratch: Array) -> None:
    """Motion of the reference of all bodies, `nu_ref` and `share nudot_ref`, after `move`."""
    links, steers, omega = tree.links, tree.steers, scratch[BASE.w, AT.omega + 2]
    g = _gravity(tree.gravity, tree.frame, tree.level, position)
    x, y, w = base_rates(links, scratch, nu_ref)
    acceleration = along(ZERO, base_rates(links, scratch, nudot_ref), share)
    if steers:
        acceleration = add(acceleration, base_drift(links, scratch, nu_ref))
    ax, ay, alpha = acceleration
    put(scratch, BASE.w, AT.omega_ref, (0.0, 0.0, w))
    put(scratch, BASE.w, AT.alpha, (0.0, 0.0, alpha))
    put(scratch, BASE.w, AT.a, (ax - omega * y - g[0], ay + omega * x - g[1], -g[2]))
    for i in range(BASE.w + 1, len(links)):
        speed, speed_rate = rate(links, scratch, i, nu_ref), share * rate(links, scratch, i, nudot_ref)
        if steers:
            speed_rate += drift(links, scratch, i, nu_ref)
        _lead(links[i, LINK.parent], i, speed, speed_rate, scratch)


@inlined
def _load_base(numbers: Array, scratch: Array) -> None:
    """The force that the motion of the reference of the base takes."""
    m, cx, cy = get(numbers, BASE.w, NUMBER.mass)
    w, omega = scratch[BASE.w, AT.omega_ref + 2], scratch[BASE.w, AT.omega + 2]
    ax, ay, alpha = scratch[BASE.w, AT.a], scratch[BASE.w, AT.a + 1], scratch[BASE.w, AT.alpha + 2]
    inertia = numbers[BASE.w, NUMBER.second] + numbers[BASE.w, NUMBER.second + 3]
    put(scratch, BASE.w, AT.force, (m * ax - alpha * cy - w * omega * cx, m * ay + alpha * cx - w * omega * cy, 0.0))
    put(scratch, BASE.w, AT.torque, (0.0, 0.0, inertia * alpha + cx * ay - cy * ax))


@inlined
def _load(i: int, scratch: Array) -> None:
    """The force that the motion of the reference of body i takes, `F` and `N` of the heading."""
    omega_ref, alpha, a = get(scratch, i, AT.omega_ref), get(scratch, i, AT.alpha), get(scratch, i, AT.a)
    k, mc = AT.second, get(scratch, i, AT.moment)
    trace = scratch[i, k] + scratch[i, k + 3] + scratch[i, k + 5]
    force = along(add(cross(alpha, mc), cross(omega_ref, get(scratch, i, AT.whirl))), a, scratch[i, AT.mass])
    torque = along(along(cross(mc, a), alpha, trace), times(scratch, i, k, alpha), -1.0)
    torque = add(torque, cross(times(scratch, i, k, omega_ref), get(scratch, i, AT.omega)))
    put(scratch, i, AT.force, force)
    put(scratch, i, AT.torque, torque)


@inlined
def _pull(links: Indices, numbers: Array, i: int, force: Triple, torque: Triple, scratch: Array, out: Array) -> None:
    """Add what joint i takes of a force, through its row of T."""
    tau = dot(get(scratch, i, AT.w), torque) + dot(get(scratch, i, AT.s), force)
    first = links[i, LINK.first]
    for k in range(links[i, LINK.stop] - first):
        out[first + k] += scratch[i, AT.weight + k] * tau


@inlined
def _inverse(
    tree: BodyTree, position: Array, nu_ref: Array, nudot_ref: Array, share: float, scratch: Array, out: Array
) -> None:
    """`T' (M (share T nudot_ref + Tdot nu_ref) + C T nu_ref + g)` without the rotors, after `place`."""
    links, numbers = tree.links, tree.numbers
    out[:] = 0.0
    lead(tree, position, nu_ref, nudot_ref, share, scratch)
    _load_base(numbers, scratch)
    for i in range(BASE.w + 1, len(links)):
        _load(i, scratch)
    for i in range(len(links) - 1, BASE.w, -1):
        j = links[i, LINK.parent]
        force, torque = get(scratch, i, AT.force), get(scratch, i, AT.torque)
        _pull(links, numbers, i, force, torque, scratch, out)
        put(scratch, j, AT.force, add(get(scratch, j, AT.force), force))
        torque = add(torque, cross(get(scratch, i, AT.lever), force))
        put(scratch, j, AT.torque, add(get(scratch, j, AT.torque), torque))
    for i in range(BASE.w + 1):
        _pull(links, numbers, i, get(scratch, BASE.w, AT.force), get(scratch, BASE.w, AT.torque), scratch, out)


@internal
def _spin_mass(tree: BodyTree, scratch: Array, M: Array) -> None:
    """Add the mass of the spinning of lumped wheels, `I t t'` with their rows t of T."""
    n, stop = len(tree.links), tree.links[BASE.w, LINK.stop]
    for i in range(len(tree.spins)):
        t, inertia = scratch[n + i, AT.weight :], tree.spins[i, 1]
        for a in range(stop):
            for b in range(stop):
                M[a, b] += inertia * t[a] * t[b]


@internal
def _spin(tree: BodyTree, nu_ref: Array, nudot_ref: Array, share: float, scratch: Array, out: Array) -> None:
    """Add what their spinning takes, `I t (share t nudot_ref + tdot nu_ref)`."""
    n, stop = len(tree.links), tree.links[BASE.w, LINK.stop]
    k = tree.numbers.shape[1] - NUMBER.weight
    for i in range(len(tree.spins)):
        t, rate = scratch[n + i, AT.weight :], 0.0
        for a in range(stop):
            rate += share * t[a] * nudot_ref[a] + t[k + a] * nu_ref[a]
        for a in range(stop):
            out[a] += tree.spins[i, 1] * t[a] * rate


@linked
def terms(tree: BodyTree, position: Array, nu: Array, scratch: Array, M: Array, h: Array) -> None:
    """Reduced mass matrix and bias forces, `M = T' M T` and `h = T' (C(q, T nu) T nu + g)`.

    Args:
        tree: The robot.
        position: (nv,) pose of the control frame and joint coordinates [m, rad].
        nu: (p,) independent velocities.
        scratch: Memory of `new_scratch`.
        M: (p, p) out.
        h: (p,) out.
    """
    links, numbers = tree.links, tree.numbers
    place(links, numbers, position, nu, scratch)
    _mass(links, numbers, tree.rotors, scratch, M)
    _inverse(tree, position, nu, nu, 0.0, scratch, h)
    if tree.steers:
        _spin_mass(tree, scratch, M)
        _spin(tree, nu, nu, 0.0, scratch, h)


@linked
def psi(
    tree: BodyTree, position: Array, nu: Array, nu_ref: Array, nudot_ref: Array, scratch: Array, out: Array
) -> None:
    """True Psi without friction, `T' (M T nudot_ref + C(q, T nu) T nu_ref + g)`, thesis (3.20), (3.21).

    Args:
        tree: The robot.
        position: (nv,) pose of the control frame and joint coordinates [m, rad].
        nu: (p,) independent velocities.
        nu_ref: (p,) reference velocities.
        nudot_ref: (p,) their time derivative.
        scratch: Memory of `new_scratch`.
        out: (p,) out.
    """
    place(tree.links, tree.numbers, position, nu, scratch)
    psi_again(tree, position, nu_ref, nudot_ref, scratch, out)


@linked
def psi_again(tree: BodyTree, position: Array, nu_ref: Array, nudot_ref: Array, scratch: Array, out: Array) -> None:
    """`psi` where `scratch` still holds this state, from `terms` or `psi` just before."""
    _inverse(tree, position, nu_ref, nudot_ref, 1.0, scratch, out)
    for a in range(len(out)):
        for b in range(len(out)):
            out[a] += tree.rotors[a, b] * nudot_ref[b]
    if tree.steers:
        _spin(tree, nu_ref, nudot_ref, 1.0, scratch, out)


@linked
def potential_energy(tree: BodyTree, position: Array, scratch: Array) -> float:
    """Potential energy [J], as `pin.computePotentialEnergy`; overwrites the places in `scratch`."""
    links, numbers, frame = tree.links, tree.numbers, tree.frame
    g = _gravity(tree.gravity, frame, tree.level, position)
    mass, energy = numbers[BASE.w, NUMBER.mass], tree.root_energy - dot(g, get(numbers, BASE.w, NUMBER.moment))
    for i in range(BASE.w + 1, len(links)):
        locate(links, numbers, position, i, scratch)
        m = numbers[i, NUMBER.mass]
        energy -= dot(g, along(first_moment(numbers, i, scratch), get(scratch, i, AT.origin), m))
        mass += m
    if not tree.level:
        c, s = cos_sin(position[2] - frame[2])
        x = position[0] - c * frame[0] + s * frame[1]
        y = position[1] - s * frame[0] - c * frame[1]
        energy -= mass * (tree.gravity[0] * x + tree.gravity[1] * y)
    return energy
