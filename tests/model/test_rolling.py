"""T(theta) of steered bases against derivations that know nothing of it.

Contact rows are Pinocchio's spatial Jacobians of the wheels' material points on the floor, a linkage is the determinant
of the axles' lines, and the motion is that of the full model under all of these as constraints (KKT).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from steered import (
    LAYOUTS,
    Array,
    Made,
    along_motion,
    axle,
    car,
    constraint,
    contact_rows,
    coordination,
    robot_of,
    state,
    swerve,
    swings,
    tricycle,
)

from mmnn_pin import load
from mmnn_pin.model.base.base import Wheel
from mmnn_pin.model.base.rolling import FREE, STEERED, Pivot, closed, roll
from mmnn_pin.model.base.steered import CarWithTrailer, Casters, DriveWithTrailer, SteeredBase, Swerve
from mmnn_pin.model.checks.nonholonomy import VectorField, involutive_closure
from mmnn_pin.model.dynamics import Dynamics
from mmnn_pin.model.tree.twin import Twin

MADE = {name: Made.of(make()) for name, make in LAYOUTS.items()}
for name in ("car_arm", "casters_arm", "loader_arm", "swerve_arm", "tricycle_arm", "truck_trailer_arm"):
    bundled = load(name)  # their bases as understood from their files
    assert isinstance(bundled.base, SteeredBase)
    MADE[name] = Made(bundled.base, bundled.model, bundled.joint_names)
EVERY = pytest.mark.parametrize("made", list(MADE.values()), ids=list(MADE))
SAMPLES = 5


def states(made: Made, seed: int = 0):
    """Positions, velocities and directions."""
    rng = np.random.default_rng(seed)
    return [state(made, rng) for _ in range(SAMPLES)]


def relative(error: Array, scale: Array) -> float:
    return float(np.abs(error).max(initial=0.0) / max(1.0, np.abs(scale).max(initial=0.0)))


# -- kinematics --------------------------------------------------------------------------------------------------------


@EVERY
def test_no_wheel_slips(made):
    """`A T = 0`; of a swerve drive, whose masters could disagree, `A T nu = 0` where they turn together."""
    for position, nu, n in states(made):
        A, T = contact_rows(made, position), made.T(position, n)
        assert relative(A @ (T @ nu[:, None] if swings(made.base) else T), A) < 1e-12


@EVERY
def test_the_motions_are_all_that_are_left(made):
    """As many velocities as the constraint leaves, a linkage included, and each moves the robot in its own way."""
    for position, _, n in states(made):
        A, T = constraint(made, position), made.T(position, n)
        assert np.linalg.matrix_rank(A, tol=1e-9) == made.nv - made.p
        assert np.linalg.matrix_rank(T, tol=1e-9) == made.p


@pytest.mark.parametrize("make", [car, lambda: truck_of_four()], ids=["two", "four"])
def test_followers_keep_to_the_linkage(make):
    """All axles meet in one place, and stay there as the masters turn."""
    made = Made.of(make())
    for position, nu, n in states(made):
        np.testing.assert_allclose(coordination(made, position), 0.0, atol=1e-14)
        gradient = constraint(made, position)[2 * len(made.base.wheels) :]
        assert len(gradient) and np.abs(gradient @ made.T(position, n)).max() < 1e-11
        later = made.moved(position, nu, 0.01, n)
        np.testing.assert_allclose(closed(made.rolling, later.copy()), later, atol=1e-9)


def truck_of_four() -> SteeredBase:
    """Two steered axles ahead of the fixed one: one master, three followers."""
    places = ((1.0, 0.3), (1.0, -0.3), (0.6, 0.3), (0.6, -0.3))
    pivots = tuple(
        Pivot(f"steer_{k}", "follower" if k else "master", x, y, lower=-0.6, upper=0.6)
        for k, (x, y) in enumerate(places)
    )
    wheels = tuple(Wheel(f"front_{k}", 0.15, 1.0, 0.0, pivot=k) for k in range(4))
    return type(car())(wheels=(*wheels, *axle("rear", 0.0, 0.3, 0.15)), pivots=pivots, length=1.0)


@EVERY
def test_the_rate_of_T_is_exact(made):
    for position, nu, n in states(made):
        maps = made.maps(position, nu, n)
        by_differences = along_motion(made, lambda x, n=n: made.T(x, n), position, maps.T @ nu)
        assert relative(maps.Tdot - by_differences, maps.Tdot) < 1e-10


@EVERY
def test_bodies_move_as_pinocchio_moves_them(made):
    """`V nu` is the velocity of the control frame and of every pivot's frame, in its own axes."""
    m, d = made.model, made.data
    for position, nu, n in states(made):
        maps = made.maps(position, nu, n)
        pin.forwardKinematics(m, d, made.q(position), maps.T @ nu)
        x, y, psi = made.base.frame
        frame = pin.SE3(pin.utils.rotate("z", psi), np.array([x, y, 0.0]))
        found = [frame.actInv(d.v[1]), *(d.v[m.getJointId(p.joint)] for p in made.base.pivots)]
        for V, v, sign in zip(maps.V, found, [1.0, *(p.sign for p in made.base.pivots)], strict=True):
            assert sign in (1.0, -1.0)
            np.testing.assert_allclose(V @ nu[: made.nb], [v.linear[0], v.linear[1], v.angular[2]], atol=1e-12)
        np.testing.assert_allclose(maps.eta, maps.V[0] @ nu[: made.nb], atol=1e-15)


@pytest.mark.parametrize("made", [made for made in MADE.values() if made.base.body == STEERED])
def test_u_is_how_far_a_motion_goes_along_n(made):
    """`n' W n = 1` and `u = n' W eta`, so that turning the masters alone has none of it."""
    for position, nu, n in states(made):
        maps = made.maps(position, nu, n)
        W = np.diag([1.0, 1.0, made.base.length**2])
        direction = maps.V[0, :, 0]
        assert direction @ W @ direction == pytest.approx(1.0, abs=1e-14)
        assert direction @ W @ maps.eta == pytest.approx(nu[0], abs=1e-14)
        assert np.abs(direction @ W @ maps.Vdot[0, :, 0]) < 1e-13


def test_u_is_the_speed_of_a_cars_virtual_front_wheel():
    """Of the wheel that steers, where its wheel is on its axis on the centre line."""
    for made, sign in ((MADE["tricycle"], -1.0), (MADE["truck"], 1.0)):
        pivot = made.base.pivots[0]
        for position, nu, n in states(made):
            V = made.maps(position, nu, n).V[1] @ nu[: made.nb]
            assert abs(V[0]) == pytest.approx(abs(nu[0]), abs=1e-13) and abs(V[1]) < 1e-13
            assert np.sign(pivot.x) == sign


def test_a_right_angle_is_no_singularity():
    """A wheel steered by a quarter and beyond: the body turns about the middle of its fixed axle, u goes on."""
    made = Made.of(tricycle())
    k = made.place["steer"]
    before = None
    for angle in np.linspace(1.2, 2.0, 41):
        position = np.zeros(made.nv)
        position[k] = angle
        T = made.T(position)
        assert np.abs(contact_rows(made, position) @ T).max() < 1e-12
        assert before is None or np.abs(T - before).max() < 0.2
        before = T
    position[k] = np.pi / 2
    assert np.abs(made.maps(position, np.eye(made.p)[0]).eta[:2]).max() < 1e-15


def test_a_swerve_drive_turns_its_wheels_without_end():
    """The sign of n goes on from the sample before, so that u keeps its meaning through half turns."""
    made = Made.of(swerve())
    maps, position, nu = made.new_maps(), np.zeros(made.nv), np.eye(made.p)[0]
    maps.n[:] = 1.0, 0.0, 0.0
    for angle in np.linspace(0.0, 4 * np.pi, 200):
        for pivot in made.base.pivots:
            position[made.place[pivot.joint]] = pivot.sign * angle
        roll(made.rolling, position, nu, maps)
        np.testing.assert_allclose(maps.eta, [np.cos(angle), np.sin(angle), 0.0], atol=1e-14)


def test_masters_that_disagree_scrub_least():
    """Of three steps of inverse iteration: n slides less than any other direction, to the size of what they leave."""
    made, rng = Made.of(swerve()), np.random.default_rng(0)
    for _ in range(20):
        position, _, n = state(made, rng)
        for pivot in made.base.pivots:
            position[made.place[pivot.joint]] += 0.02 * rng.standard_normal()
        across = contact_rows(made, position)[1::2]
        T = made.T(position, n)
        root = across[:, :3] @ T[:3, 0]
        scale = np.diag([1.0, 1.0, 1.0 / made.base.length])
        least = np.linalg.svd(across[:, :3] @ scale, compute_uv=False)[-1]
        assert least <= np.linalg.norm(root) * (1 + 1e-9) and np.linalg.norm(root) < 1.001 * least + 1e-12


# -- dynamics ----------------------------------------------------------------------------------------------------------


def reduced(made: Made, position: Array, nu: Array, n: Array) -> tuple[Array, Array, Array, Array, Array]:
    """M, C, g of the reduced model, T and Tdot."""
    maps = made.maps(position, nu, n)
    M, C, g = made.terms(position, maps.T @ nu)
    return maps.T.T @ M @ maps.T, maps.T.T @ (C @ maps.T + M @ maps.Tdot), maps.T.T @ g, maps.T, maps.Tdot


def mass(made: Made, position: Array, n: Array) -> Array:
    """M alone."""
    return reduced(made, position, np.zeros(made.p), n)[0]


@EVERY
def test_mass_matrix_and_coriolis_matrix_belong_together(made):
    """`Mdot = C + C'` with the exact Tdot; Mdot by differences."""
    for position, nu, n in states(made):
        _, C, _, T, _ = reduced(made, position, nu, n)
        Mdot = along_motion(made, lambda x, n=n: mass(made, x, n), position, T @ nu)
        assert np.abs(Mdot - C - C.T).max() / np.abs(C).max() < 1e-9


def constrained(made: Made, position: Array, v: Array, force: Array, A: Array, bias: Array) -> Array:
    """Acceleration of the full model under `A a = -bias`: KKT by least squares, as rows repeat each other."""
    M, C, g = made.terms(position, v)
    size = len(A)
    KKT = np.block([[M, A.T], [A, np.zeros((size, size))]])
    return np.linalg.lstsq(KKT, np.append(force - C @ v - g, -bias), rcond=1e-11)[0][: made.nv]


@pytest.mark.parametrize("made", [made for name, made in MADE.items() if name not in ("swerve of 4", "swerve_arm")])
def test_it_accelerates_as_the_constrained_model(made):
    """Under random torques of the motors; a swerve drive of four would need torques that keep its wheels agreeing."""
    rng = np.random.default_rng(1)
    for position, nu, n in states(made):
        M, C, g, T, Tdot = reduced(made, position, nu, n)
        force = made.motors @ (5.0 * rng.standard_normal(made.motors.shape[1]))
        nudot = np.linalg.solve(M, T.T @ force - C @ nu - g)
        ours = T @ nudot + Tdot @ nu
        A, v = constraint(made, position), T @ nu
        bias = along_motion(made, lambda x, v=v: constraint(made, x) @ v, position, v)
        theirs = constrained(made, position, v, force, A, bias)
        assert np.abs(ours - theirs).max() / np.abs(theirs).max() < 1e-9
        assert relative(A @ ours + bias, bias) < 1e-9


@pytest.mark.compiled
@EVERY
def test_it_rolls_freely_without_loss(made):
    """Without torques, integrated to 1e-11; a swerve drive of four slips as its wheels come to disagree."""
    position, nu, n = state(made, np.random.default_rng(3), 0.5)
    nu[0] = 0.8
    if made.rolling.body != FREE:
        nu[1 : made.nb] *= 0.2
    nv = made.nv

    def f(t: float, y: Array) -> Array:
        M, C, g, T, _ = reduced(made, y[:nv], y[nv:], n)
        return np.concatenate((made.rate(y[:nv], T @ y[nv:]), np.linalg.solve(M, -C @ y[nv:] - g)))

    def turned(t: float, y: Array) -> float:
        return float(made.maps(y[:nv], y[nv:], n).n @ n - 0.3)

    turned.terminal = True  # a swerve drive: `n` above is of the start, and tells the sign for half a turn
    start, events = np.concatenate((position, nu)), turned if swings(made.base) else None
    run = solve_ivp(f, (0.0, 2.0), start, method="DOP853", rtol=1e-11, atol=1e-12, events=events)
    kinetic, total, slip = [], [], []
    for y in run.y.T:
        q, v = made.q(y[:nv]), made.T(y[:nv], n) @ y[nv:]
        kinetic.append(pin.computeKineticEnergy(made.model, made.data, q, v))
        total.append(kinetic[-1] + pin.computePotentialEnergy(made.model, made.data, q))
        slip.append(np.abs(contact_rows(made, y[:nv]) @ v).max())
        np.testing.assert_allclose(closed(made.rolling, y[:nv].copy()), y[:nv], atol=1e-10)
    assert run.t[-1] > 0.2 and np.ptp([y @ y for y in run.y[nv:].T]) > 1e-3  # it does move
    assert np.ptp(total) / max(kinetic) < 1e-10
    assert max(slip) < 1e-12 or (swings(made.base) and len(made.base.pivots) > 2)


# -- nonholonomy -------------------------------------------------------------------------------------------------------


def fields(made: Made, names: tuple[str, ...], n: Array) -> list[VectorField]:
    """One per base velocity, on the pose of the root link and the angles of some joints; followers are closed."""
    places = [made.place[name] for name in names]

    def field(i: int) -> VectorField:
        def at(x: Array) -> Array:
            position = np.zeros(made.nv)
            position[[0, 1, 2, *places]] = x
            closed(made.rolling, position)
            return made.rate(position, made.T(position, n)[:, i])[[0, 1, 2, *places]]

        return at

    return [field(i) for i in range(made.nb)]


def growth(made: Made, wheels: bool = False) -> tuple[int, ...]:
    """Ranks of the distribution and of its brackets, on the pose and on the angles that say how it may move."""
    names = tuple(p.joint for p in made.base.pivots if p.role != "follower")
    names += tuple(wheel.joint for wheel in made.base.wheels) if wheels else ()
    n, points = np.array([1.0, 0.0, 0.0]), []
    for position, *_ in states(made):
        points.append(position[[0, 1, 2, *(made.place[name] for name in names)]])
        points[-1][3:] *= 0.5  # within the half plane of n
    return involutive_closure(fields(made, names, n), np.array(points)).growth


GROWTH = {
    "car": (2, 3, 4),  # u and the steering; Campion's (1, 1)
    "tricycle": (2, 3, 4),
    "loader": (2, 3, 4),
    "truck": (2, 3, 4, 5),  # one more round for each trailer
    "truck with 2 trailers": (2, 3, 4, 5, 6),
    "drive with trailer": (2, 3, 4),  # (2, 0)
    "swerve of 2": (3, 5),  # (1, 2): both steering joints with u at once
    "turret": (3, 4),  # (3, 0): the pose is free, its swivel is brought along
}


@pytest.mark.compiled
@pytest.mark.parametrize("name", GROWTH)
def test_brackets_reach_every_posture(name):
    """The posture model is controllable: no combination of pose and steering angles is kept."""
    assert growth(MADE[name]) == GROWTH[name]


def test_the_fixed_wheels_of_a_tricycle_keep_one_thing():
    """Campion's degree of nonholonomy is 4 with three wheels: of 7 numbers 6 can be reached.

    The two wheels of the axle turn by as much more than each other as the body turns.
    """
    made = MADE["tricycle"]
    assert len(made.base.wheels) == 3
    reached = growth(made, wheels=True)
    assert reached[0] == 2 and reached[-1] == 6


# -- any base ----------------------------------------------------------------------------------------------------------

SIGN, SIDE = st.sampled_from([1.0, -1.0]), st.floats(-0.5, 0.5)
AWAY = st.builds(lambda size, sign: size * sign, st.floats(0.2, 1.5), SIGN)
ANGLE = st.floats(-np.pi, np.pi)


@st.composite
def pivot(draw, number: int, role: str, parent: int = -1, trail: bool = True) -> tuple[Pivot, list[Wheel]]:
    """A pivot anywhere, with one or two wheels whose heading is anything; the joint may count to the right."""
    heading, ahead, beside = draw(ANGLE), draw(AWAY) if trail else 0.0, draw(SIDE)
    c, s = np.cos(heading), np.sin(heading)
    x, y = (0.0, 0.0) if role == "master" and not trail else (ahead * c - beside * s, ahead * s + beside * c)
    place = (draw(AWAY), draw(SIDE))
    made = Pivot(f"pivot_{number}", role, *place, parent, draw(SIGN), wheel=(float(x), float(y), heading))
    apart = draw(st.sampled_from([[0.0], [0.2, -0.1]]))
    wheels = [
        Wheel(
            f"wheel_{number}_{i}", draw(st.floats(0.05, 0.3)), draw(SIGN), y + d * c, x - d * s, heading, pivot=number
        )
        for i, d in enumerate(apart)
    ]
    return made, wheels


@st.composite
def bases(draw) -> SteeredBase:
    """Any base: what its body may do, then passive pivots on anything that is there."""
    kind = draw(st.sampled_from([CarWithTrailer, DriveWithTrailer, Casters, Swerve]))
    fixed = list(axle("fixed", 0.0, draw(st.floats(0.1, 0.6)), draw(st.floats(0.05, 0.3))))
    found: list[tuple[Pivot, list[Wheel]]] = []
    if kind is CarWithTrailer:
        found = [draw(pivot(0, "master"))]
    if kind is Swerve:
        fixed, found = [], [draw(pivot(k, "master", trail=False)) for k in range(2)]
    if kind is Casters:
        fixed = []
    for k in range(len(found), len(found) + draw(st.integers(1, 2))):
        found.append(draw(pivot(k, "passive", draw(st.integers(-1, k - 1)))))
    frame = np.array([draw(SIDE), draw(SIDE), draw(ANGLE)])
    pivots, wheels = tuple(one for one, _ in found), [wheel for _, those in found for wheel in those]
    return kind(wheels=(*fixed, *wheels), pivots=pivots, length=draw(st.floats(0.2, 2.0)), frame=frame)


def direction(made: Made, position: Array) -> Array | None:
    """About the n of a position; None where masters have none: a swerve drive's axles on one line, a jackknife."""
    masters = [one for one in made.base.pivots if one.role == "master"]
    heads = [one.wheel[2] + one.sign * position[made.place[one.joint]] for one in masters]
    if len(masters) == 2:
        rows = [(-np.sin(h), np.cos(h), m.x * np.cos(h) + m.y * np.sin(h)) for h, m in zip(heads, masters, strict=True)]
        n = np.cross(*rows) * [1.0, 1.0, made.base.length]
        return n / np.linalg.norm(n) if np.linalg.norm(n) > 0.2 else None
    for m, h in zip(masters, heads, strict=True):
        trail = m.wheel[0] * np.cos(m.wheel[2]) + m.wheel[1] * np.sin(m.wheel[2])
        if np.hypot(m.x * np.cos(h) + m.y * np.sin(h) + trail, np.sin(h)) < 0.1:
            return None
    return np.array([1.0, 0.0, 0.0])


@given(bases(), st.integers(0, 1000))
def test_any_base_rolls_and_knows_its_rate(base, seed):
    """`A T = 0` by Pinocchio's Jacobians of a file made of it, and Tdot is the derivative of T."""
    made, rng = Made.of(base, seed), np.random.default_rng(seed)
    position, nu = rng.uniform(-np.pi, np.pi, made.nv), rng.standard_normal(made.p)
    n = direction(made, position)
    if n is None:
        return
    maps = made.maps(position, nu, n)
    A = contact_rows(made, position)
    assert relative(A @ maps.T, np.abs(A).max() * np.abs(maps.T)) < 1e-12
    h = 1e-3 / (1.0 + np.abs(maps.T @ nu).max())
    rate = along_motion(made, lambda x: made.T(x, n), position, maps.T @ nu, h)
    assert relative(rate - maps.Tdot, np.abs(maps.Tdot) + np.abs(maps.T)) < 1e-7


# -- the dynamics of robots --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LAYOUTS)
def test_dynamics_and_twin_are_the_reduced_full_model(name):
    """M, C nu + g and Psi by Pinocchio's matrices with T and Tdot; the compiled twin, too."""
    made, robot = MADE[name], robot_of(LAYOUTS[name]())
    dynamics, twin, rng = Dynamics(robot), Twin(robot), np.random.default_rng(4)
    for position, nu, n in states(made):
        M, C, g, *_ = reduced(made, position, nu, n)
        sign = np.sign(robot.maps_at(position).V[0, :, 0] @ made.maps(position, nu, n).V[0, :, 0])
        flip = np.diag([sign, *np.ones(made.p - 1)]) if made.base.body == STEERED else np.eye(made.p)
        own, place = flip @ nu, control(made, position)
        reference, change = rng.standard_normal((2, made.p))
        psi = flip @ (M @ flip @ change + C @ flip @ reference + g)
        for terms in (dynamics, twin):
            terms.maps.n[:] = 0.0
            terms.refresh(place, own)
            found = np.zeros(made.p)
            terms.refresh_psi(reference, change, found)
            assert relative(terms.M - flip @ M @ flip, M) < 1e-12
            assert relative(terms.h - flip @ (C @ nu + g), C @ nu) < 1e-11
            assert relative(found - psi, psi) < 1e-11
        assert relative(dynamics.coriolis_matrix(place, own) - flip @ C @ flip, C) < 1e-11


def control(made: Made, position: Array) -> Array:
    """The house's position: the control frame's pose in the place of the root link's."""
    x, y, psi = made.base.frame
    c, s, out = np.cos(position[2]), np.sin(position[2]), position.copy()
    out[:3] += c * x - s * y, s * x + c * y, psi
    return out
