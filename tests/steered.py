"""Steered bases for tests: any base as a URDF, and its motion by Pinocchio's full model, apart from `robot.T_at`.

`urdf_of` writes what a base says of itself into the joints of a file: pivots, wheels and their headings. What Pinocchio
makes of that file knows nothing of T(theta): contact points, axles and inertias come from the tree alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from closed_form import inertial, joint

from mmnn_pin.model.arm import Arm
from mmnn_pin.model.base.base import Wheel
from mmnn_pin.model.base.rolling import FREE, Maps, Pivot, Rolling, base_size, closed, new_maps, roll
from mmnn_pin.model.base.steered import (
    Articulated,
    CarLike,
    CarWithTrailer,
    Casters,
    DriveWithTrailer,
    SteeredBase,
    Swerve,
    Tricycle,
)
from mmnn_pin.model.loading import assemble, pinocchio_model
from mmnn_pin.model.robot import Robot
from mmnn_pin.model.urdf.reading import parse

Array = np.ndarray
SIXTH = ((-3, -1 / 60), (-2, 3 / 20), (-1, -3 / 4), (1, 3 / 4), (2, -3 / 20), (3, 1 / 60))
ARM = ("arm_1", "arm_2", "arm_3")


# -- bases -------------------------------------------------------------------------------------------------------------


def axle(name: str, x: float, half: float, radius: float, pivot: int = -1, driven: bool = True) -> tuple[Wheel, Wheel]:
    """Two wheels, left and right."""
    return tuple(
        Wheel(f"{name}_{side}", radius, 1.0, y, x, pivot=pivot, driven=driven)
        for side, y in (("left", half), ("right", -half))
    )


def car(wheelbase: float = 0.65, half: float = 0.25, scrub: float = 0.03) -> SteeredBase:
    """Ackermann steering ahead of the driven axle; the right joint counts to the right, one wheel turns backward."""
    pivots, wheels = [], [*axle("rear", 0.0, half, 0.15)]
    for k, (side, y, sign) in enumerate((("left", 1, 1.0), ("right", -1, -1.0))):
        at = (wheelbase, y * (half - scrub))
        role = "follower" if k else "master"
        wheel = (0.0, y * scrub, 0.0)
        pivots.append(Pivot(f"{side}_steer", role, *at, sign=sign, lower=-0.7, upper=0.7, motor=not k, wheel=wheel))
        wheels.append(Wheel(f"front_{side}", 0.15, -sign, y * scrub, pivot=k, driven=False))
    return CarLike(wheels=tuple(wheels), pivots=tuple(pivots), length=wheelbase)


def tricycle() -> SteeredBase:
    """A wheel behind the fixed axle steers and drives; the control frame stands askew in the root link."""
    pivot = Pivot("steer", "master", -1.2, 0.0, lower=-1.5, upper=1.5, motor=True)
    wheels = (Wheel("traction", 0.15, 1.0, 0.0, pivot=0), *axle("free", 0.0, 0.4, 0.12, driven=False))
    return Tricycle(wheels=wheels, pivots=(pivot,), length=1.2, frame=np.array([0.1, -0.2, 0.4]))


def loader() -> SteeredBase:
    """A waist 0.8 behind the front axle, 0.7 ahead of the rear one."""
    waist = Pivot("waist", "master", -0.8, 0.0, lower=-0.8, upper=0.8, motor=True, wheel=(-0.7, 0.0, 0.0))
    wheels = (*axle("front", 0.0, 0.45, 0.3), *axle("rear", -0.7, 0.45, 0.3, pivot=0))
    return Articulated(wheels=wheels, pivots=(waist,), length=1.5)


def hitched(pivots: list[Pivot], wheels: list[Wheel], count: int, at: float, length: float) -> None:
    """Add trailers, each on a hitch behind the axle of what pulls it."""
    parent = -1
    for i in range(count):
        pivots.append(Pivot(f"hitch_{i}", "passive", at, 0.0, parent, wheel=(-length, 0.0, 0.0)))
        parent, at = len(pivots) - 1, -length - 0.12
        wheels.extend(axle(f"trailer_{i}", -length, 0.25, 0.15, parent, driven=False))


def truck(trailers: int) -> SteeredBase:
    """A tricycle-steered truck with trailers."""
    pivots = [Pivot("steer", "master", 0.65, 0.0, lower=-0.7, upper=0.7, motor=True)]
    wheels = [Wheel("front", 0.15, 1.0, 0.0, pivot=0, driven=False), *axle("rear", 0.0, 0.25, 0.15)]
    hitched(pivots, wheels, trailers, -0.12, 0.7)
    return CarWithTrailer(wheels=tuple(wheels), pivots=tuple(pivots), length=0.65)


def drive_trailer() -> SteeredBase:
    """A differential drive with a trailer."""
    pivots: list[Pivot] = []
    wheels = [*axle("drive", 0.0, 0.25, 0.15)]
    hitched(pivots, wheels, 1, -0.2, 0.6)
    return DriveWithTrailer(wheels=tuple(wheels), pivots=tuple(pivots))


def swerve(
    corners: tuple[tuple[float, float], ...] = ((0.3, 0.22), (-0.3, -0.22), (0.3, -0.22), (-0.3, 0.22)),
) -> SteeredBase:
    """Wheels below their steering axes; every other joint counts to the right."""
    signs = [(-1.0) ** i for i in range(len(corners))]
    pivots = tuple(Pivot(f"steer_{i}", "master", x, y, sign=signs[i], motor=True) for i, (x, y) in enumerate(corners))
    wheels = tuple(Wheel(f"drive_{i}", 0.1, 1.0, 0.0, pivot=i) for i in range(len(corners)))
    return Swerve(wheels=wheels, pivots=pivots, length=float(np.sqrt(np.mean(np.square(corners).sum(axis=1)))))


def casters(trail: float = 0.06) -> SteeredBase:
    """Four powered casters."""
    corners = ((0.3, 0.22), (0.3, -0.22), (-0.3, 0.22), (-0.3, -0.22))
    pivots = tuple(
        Pivot(f"swivel_{i}", "passive", x, y, motor=True, wheel=(-trail, 0.02, 0.0)) for i, (x, y) in enumerate(corners)
    )
    wheels = tuple(Wheel(f"drive_{i}", 0.1, 1.0, 0.02, -trail, pivot=i) for i in range(4))
    return Casters(wheels=wheels, pivots=pivots)


def turret() -> SteeredBase:
    """Toyota HSR's: two wheels behind the axis of a turret that carries the body."""
    pivot = Pivot("turret", "passive", 0.0, 0.0, motor=True, wheel=(-0.11, 0.0, 0.0))
    return Casters(wheels=axle("drive", -0.11, 0.133, 0.04, pivot=0), pivots=(pivot,))


LAYOUTS: dict[str, Callable[[], SteeredBase]] = {
    "car": car,
    "tricycle": tricycle,
    "loader": loader,
    "truck": lambda: truck(1),
    "truck with 2 trailers": lambda: truck(2),
    "drive with trailer": drive_trailer,
    "swerve of 2": lambda: swerve(((0.3, 0.22), (-0.3, -0.22))),
    "swerve of 4": swerve,
    "casters": casters,
    "turret": turret,
}


# -- as a file ---------------------------------------------------------------------------------------------------------


def urdf_of(base: SteeredBase, seed: int = 0) -> str:
    """A base with an arm, of random inertias, as a URDF; the arm rides on the last hitch where there is one."""
    rng = np.random.default_rng(seed)
    text = f'<link name="base">{lump(rng, 80.0, 0.3, middle(base))}</link>'
    for k, pivot in enumerate(base.pivots):
        carrier = "base" if pivot.parent < 0 else f"{base.pivots[pivot.parent].joint}_link"
        stops = f'lower="{max(pivot.lower, -3)}" upper="{min(pivot.upper, 3)}"'
        endless = np.isinf(pivot.lower)
        more = f'<limit {"" if endless else stops} effort="80" velocity="4"/>'
        text += f'<link name="{pivot.joint}_link">{lump(rng, 40.0 if heavy(base, k) else 2.0, 0.1)}</link>'
        where = placed(base, carrier, pivot.x, pivot.y, 0.0, 0.0)
        kind = "continuous" if endless else "revolute"
        text += joint(pivot.joint, carrier, f"{pivot.joint}_link", where, f"0 0 {pivot.sign}", more, kind)
    for wheel in base.wheels:
        carrier = "base" if wheel.pivot < 0 else f"{base.pivots[wheel.pivot].joint}_link"
        i = 2.0 * wheel.radius**2
        shape = (
            f'<collision><origin rpy="{np.pi / 2!r} 0 0"/><geometry><cylinder radius="{wheel.radius}" length="0.04"/>'
        )
        text += f'<link name="{wheel.joint}_link">{inertial(2.0, (i / 4, i / 2, i / 4))}{shape}</geometry>'
        text += "</collision></link>"
        where = placed(base, carrier, wheel.x, wheel.y, wheel.radius, wheel.heading)
        more = '<limit effort="60" velocity="50"/>'
        text += joint(wheel.joint, carrier, f"{wheel.joint}_link", where, f"0 {wheel.sign} 0", more)
    hitches = [p.joint for p in base.pivots if p.role == "passive" and base.body != FREE]
    return f'<robot name="made">{text}{arm(rng, f"{hitches[-1]}_link" if hitches else "base")}</robot>'


def robot_of(base: SteeredBase, seed: int = 0) -> Robot:
    """The robot of `urdf_of`, its base as given: nothing is understood from the file."""
    document = parse(urdf_of(base, seed).encode(), "made.urdf")
    model, _ = pinocchio_model(document, mobile=True)
    return assemble(document, base, Arm(ARM, {}, {}, {}), model)


def heavy(base: SteeredBase, k: int) -> bool:
    """Whether a pivot carries a body: a trailer, a loader's other half, what stands on a turret."""
    return sum(wheel.pivot == k for wheel in base.wheels) > 1


def placed(base: SteeredBase, carrier: str, x: float, y: float, z: float, heading: float) -> str:
    """The origin of a place on a carrier, a pivot's or the control frame's."""
    if carrier == "base":
        ox, oy, psi = (float(value) for value in base.frame)
        c, s = float(np.cos(psi)), float(np.sin(psi))
        x, y, heading = ox + c * x - s * y, oy + s * x + c * y, heading + psi
    return f'<origin xyz="{float(x)!r} {float(y)!r} {z!r}" rpy="0 0 {float(heading)!r}"/>'


def middle(base: SteeredBase) -> tuple[float, float, float]:
    """A place amid the wheels in the root link, at rest; those of trailers apart."""
    carriers, places = base.carriers(tuple(base.frame.tolist()), [0.0] * len(base.pivots)), []
    for wheel in base.wheels:
        x, y, heading = carriers[wheel.pivot + 1]
        c, s = np.cos(heading), np.sin(heading)
        if wheel.pivot >= 0 and base.body != FREE and base.pivots[wheel.pivot].role == "passive":
            continue
        places.append((x + c * wheel.x - s * wheel.y, y + s * wheel.x + c * wheel.y))
    x, y = np.mean(places, axis=0).tolist()
    return x, y, 0.2


def lump(rng: np.random.Generator, mass: float, size: float, about: tuple[float, float, float] = (0, 0, 0)) -> str:
    """An inertial of a body somewhere near its frame, or near another place."""
    moments = tuple((mass * size**2 * rng.uniform(0.8, 1.2, 3)).tolist())
    xyz = " ".join(map(str, np.add(about, rng.uniform(-0.1, 0.1, 3))))
    rpy = " ".join(map(str, rng.uniform(-0.3, 0.3, 3)))
    return inertial(mass, moments, f'<origin xyz="{xyz}" rpy="{rpy}"/>')


def arm(rng: np.random.Generator, parent: str) -> str:
    """Three joints."""
    text = ""
    for name, xyz, axis in zip(ARM, ("0.1 0 0.8", "0 0 0.3", "0.4 0 0"), ("0 0 1", "0 1 0", "0 1 0"), strict=True):
        more = '<limit lower="-2" upper="2" effort="99" velocity="9"/>'
        text += f'<link name="{name}_link">{lump(rng, 3.0, 0.1)}</link>'
        text += joint(name, parent, f"{name}_link", f'<origin xyz="{xyz}"/>', axis, more, "revolute")
        parent = f"{name}_link"
    return text


# -- its motion --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Made:
    """A made robot: Pinocchio's full model of the file, and the maps of its base by `roll`."""

    base: SteeredBase  # its base
    model: pin.Model  # pinocchio's, on a planar joint
    arm: tuple[str, ...] = ARM  # joints of its arm

    @classmethod
    def of(cls, base: SteeredBase, seed: int = 0) -> Made:
        """The robot of `urdf_of`."""
        return cls(base, pin.buildModelFromXML(urdf_of(base, seed), pin.JointModelPlanar()))

    @cached_property
    def data(self) -> pin.Data:
        return self.model.createData()

    @cached_property
    def place(self) -> dict[str, int]:
        """Place of every joint in a velocity."""
        return {name: self.model.idx_vs[i] for i, name in enumerate(self.model.names) if i > 1}

    @cached_property
    def rolling(self) -> Rolling:
        return self.base.rolling_at(self.place)

    @property
    def nv(self) -> int:
        return self.model.nv

    @property
    def nb(self) -> int:
        return base_size(self.rolling)

    @property
    def p(self) -> int:
        return self.nb + len(self.arm)

    def new_maps(self) -> Maps:
        T = np.zeros((self.nv, self.p))
        for i, name in enumerate(self.arm):
            T[self.place[name], self.nb + i] = 1.0
        return new_maps(self.rolling, T)

    def maps(self, position: Array, nu: Array, n: Array | None = None) -> Maps:
        """T and Tdot at a position (nv,): the root link's pose and the angles of all joints."""
        maps = self.new_maps()
        if n is not None:
            maps.n[:] = n
        roll(self.rolling, position, nu, maps)
        return maps

    def T(self, position: Array, n: Array | None = None) -> Array:
        return self.maps(position, np.zeros(self.p), n).T

    def q(self, position: Array) -> Array:
        """Pinocchio's configuration."""
        q = pin.neutral(self.model)
        q[:4] = position[0], position[1], np.cos(position[2]), np.sin(position[2])
        for name, k in self.place.items():
            i = self.model.joints[self.model.getJointId(name)]
            angle = position[k]
            q[i.idx_q : i.idx_q + i.nq] = (np.cos(angle), np.sin(angle)) if i.nq == 2 else angle
        return q

    def rate(self, position: Array, velocity: Array) -> Array:
        """Of a position, at a velocity of the full model, the root's in its own axes."""
        c, s, out = np.cos(position[2]), np.sin(position[2]), velocity.copy()
        out[:2] = c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]
        return out

    def moved(self, position: Array, nu: Array, t: float, n: Array | None = None) -> Array:
        """The position a short time later at a constant nu: one Runge-Kutta step, exact to t^4."""

        def f(x: Array) -> Array:
            return self.rate(x, self.T(x, n) @ nu)

        k1 = f(position)
        k2 = f(position + t / 2 * k1)
        k3 = f(position + t / 2 * k2)
        return position + t / 6 * (k1 + 2 * k2 + 2 * k3 + f(position + t * k3))

    def terms(self, position: Array, velocity: Array) -> tuple[Array, Array, Array]:
        """M, C, g of the full model."""
        m, d, q = self.model, self.data, self.q(position)
        M, C = pin.crba(m, d, q).copy(), pin.computeCoriolisMatrix(m, d, q, velocity).copy()
        return M, C, pin.computeGeneralizedGravity(m, d, q).copy()

    @property
    def motors(self) -> Array:
        """(nv, motors): the columns of E of the full model."""
        return np.eye(self.nv)[:, [self.place[name] for name in (*self.base.driven, *self.arm)]]


# -- states ------------------------------------------------------------------------------------------------------------


def swings(base: SteeredBase) -> bool:
    """Whether all wheels of a base steer, so that their angles have to agree."""
    return isinstance(base, Swerve) and base.body != FREE


def state(made: Made, rng: np.random.Generator, speed: float = 1.0) -> tuple[Array, Array, Array]:
    """A position, a nu and a direction n: masters within their stops, followers closed, passive pivots anywhere."""
    base, position = made.base, rng.uniform(-1.2, 1.2, made.nv)
    n, nu = np.array([1.0, 0.0, 0.0]), speed * rng.standard_normal(made.p)
    for pivot in base.pivots:
        k = made.place[pivot.joint]
        position[k] = 0.9 * rng.uniform(max(pivot.lower, -1.2), min(pivot.upper, 1.2))
        if pivot.role == "follower":
            position[k] = 0.0
    if swings(base):
        motion, change = rng.standard_normal((2, 3))
        motion /= np.sqrt(motion[0] ** 2 + motion[1] ** 2 + (base.length * motion[2]) ** 2)
        n = motion * [1.0, 1.0, base.length]
        for i, pivot in enumerate(base.pivots):
            c, d = (np.array([v[0] - pivot.y * v[2], v[1] + pivot.x * v[2]]) for v in (motion, change))
            position[made.place[pivot.joint]] = pivot.sign * (np.arctan2(c[1], c[0]) - pivot.wheel[2])
            nu[1 + i] = speed * pivot.sign * (c[0] * d[1] - c[1] * d[0]) / (c @ c)
    return closed(made.rolling, position), nu, n


# -- what Pinocchio says of its wheels ---------------------------------------------------------------------------------


def axis(model: pin.Model, j: int) -> Array:
    """(3,) axis of a joint in its frame."""
    data = model.joints[j].createData()
    model.joints[j].calc(data, np.eye(model.joints[j].nq)[0])
    return np.ravel(data.S)[3:]


def contact_rows(made: Made, position: Array) -> Array:
    """(2 W, nv) velocity of the material point of every wheel at the floor, along and across, by spatial Jacobians."""
    m, d, rows = made.model, made.data, []
    pin.computeJointJacobians(m, d, made.q(position))
    for wheel in made.base.wheels:
        j = m.getJointId(wheel.joint)
        J = pin.getJointJacobian(m, d, j, pin.LOCAL_WORLD_ALIGNED)
        axle = d.oMi[j].rotation @ axis(m, j)
        point = J[:3] - pin.skew(np.array([0.0, 0.0, -wheel.radius])) @ J[3:]
        rows += [np.cross(axle, [0.0, 0.0, 1.0]) @ point, axle @ point]
    return np.array(rows)


def coordination(made: Made, position: Array) -> Array:
    """(followers,) determinants: the line of a follower's axle meets that of the fixed axle and the master's."""
    m, d, base = made.model, made.data, made.base
    pin.forwardKinematics(m, d, made.q(position))
    lines: dict[int, Array] = {}
    for wheel in base.wheels:
        j = m.getJointId(wheel.joint)
        a, c = d.oMi[j].rotation @ axis(m, j), d.oMi[j].translation
        lines.setdefault(wheel.pivot, np.array([a[0], a[1], a[1] * c[0] - a[0] * c[1]]))
    master = next((k for k in lines if k >= 0 and base.pivots[k].role == "master"), None)
    follow = [k for k in lines if k >= 0 and base.pivots[k].role == "follower"]
    return np.array([np.linalg.det([lines[-1], lines[master], lines[k]]) for k in follow])


def constraint(made: Made, position: Array, h: float = 1e-3) -> Array:
    """All rows that velocities obey: wheels, then followers by the gradient of their coordination."""
    gradient = np.zeros((len(coordination(made, position)), made.nv))
    for k in [2, *(made.place[pivot.joint] for pivot in made.base.pivots)] if len(gradient) else ():
        step = h * np.eye(made.nv)[k]
        gradient[:, k] = sum(w * coordination(made, position + i * step) for i, w in SIXTH) / h
    return np.vstack((contact_rows(made, position), gradient))


def along_motion(made: Made, of: Callable[[Array], Array], position: Array, velocity: Array, h: float = 5e-4) -> Array:
    """Rate of a function of the position at a velocity (nv,), by sixth-order differences along a straight line."""
    rate = made.rate(position, velocity)
    return sum(w * of(position + i * h * rate) for i, w in SIXTH) / h
