"""How far the links of a robot stay apart from each other, by spheres, and from obstacles, by their shapes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin

from ...errors import ConfigError
from ...model.base.overrides import folders_of
from ...model.robot import Robot
from ...model.urdf.reading import parse
from ...model.urdf.shapes import AtRest, Shape, outline
from ...signals import Array

TALL = 10.0  # of an obstacle without a height [m]


@dataclass(frozen=True)
class Obstacle:
    """An upright cylinder on the floor, in the control frame of the base at the start; of a fixed arm, in its root's.

    Args:
        x: Its middle, ahead [m].
        y: Its middle, to the left [m].
        radius: [m].
        height: [m].

    Raises:
        ConfigError: A number that cannot be.
    """

    x: float
    y: float
    radius: float
    height: float = TALL

    def __post_init__(self) -> None:
        numbers = (self.x, self.y, self.radius, self.height)
        if not (np.isfinite(numbers).all() and self.radius > 0 and self.height > 0):
            fix = "write X,Y,RADIUS or X,Y,RADIUS,HEIGHT in m, with a radius and height > 0"
            raise ConfigError(str(self), fix=fix, key="--obstacle")

    def __str__(self) -> str:
        numbers = (self.x, self.y, self.radius, *((self.height,) if self.height != TALL else ()))
        return ",".join(f"{one:g}" for one in numbers)

    @classmethod
    def read(cls, text: str) -> Obstacle:
        """An obstacle of `X,Y,RADIUS` or `X,Y,RADIUS,HEIGHT`.

        Raises:
            ConfigError: Something else.
        """
        try:
            numbers = [float(part) for part in text.split(",")]
        except ValueError:
            numbers = []
        if len(numbers) not in (3, 4):
            fix = "write X,Y,RADIUS or X,Y,RADIUS,HEIGHT in m, such as 0.8,0,0.2"
            raise ConfigError(f"'{text}' is no obstacle", fix=fix, key="--obstacle")
        return cls(*numbers)


def clearances(robot: Robot, radius: float) -> Callable[[Array], float]:
    """Smallest distance of spheres on links that are not neighbours, over two radii, of a position (n,).

    Spheres of one radius stand along the lines from each moving joint to the joints and centres that its body carries.
    Spheres that touch at rest do not count.
    """
    model, offset, arm = robot.model, *robot.arm_map()
    data, (owner, local) = model.createData(), spheres(robot, radius)
    if not owner.size:
        return lambda q: np.inf
    moving = moving_joints(robot)
    joints, index = np.unique(owner, return_inverse=True)
    near = {(j, k) for j in moving for k in moving if j == k or model.parents[k] == j or model.parents[j] == k}
    first, second = np.triu_indices(len(owner), 1)
    far = np.array([(owner[a], owner[b]) not in near for a, b in zip(first, second, strict=True)])
    first, second = first[far], second[far]

    def distances(q: Array) -> Array:
        pin.forwardKinematics(model, data, robot.configuration(offset + arm @ q))
        frames = [data.oMi[int(j)] for j in joints]
        turned, moved = np.array([f.rotation for f in frames]), np.array([f.translation for f in frames])
        at = np.einsum("kij,kj->ki", turned[index], local) + moved[index]
        return np.asarray(np.linalg.norm(at[first] - at[second], axis=1))

    apart = distances(robot.rest[robot.arm_index]) > 2 * radius
    first, second = first[apart], second[apart]
    return lambda q: float(distances(q).min(initial=np.inf)) / (2 * radius)


def moving_joints(robot: Robot) -> list[int]:
    """Joints of the model that move, the base's among them."""
    model = robot.model
    return [j for j in range(1, model.njoints) if robot.T[model.idx_vs[j]].any() or model.nvs[j] == 3]


def spheres(robot: Robot, radius: float) -> tuple[Array, Array]:
    """Spheres along the links: the joint that carries each, (k,), and its middle in that joint's frame, (k, 3)."""
    model, moving = robot.model, moving_joints(robot)
    owners: list[int] = []
    places: list[Array] = []
    for j in moving:
        ends = [model.jointPlacements[k].translation for k in moving if model.parents[k] == j]
        ends += [model.inertias[j].lever]
        for end in ends:
            for share in np.linspace(0.0, 1.0, max(2, int(np.linalg.norm(end) / max(2 * radius, 0.04)) + 1)):
                owners.append(j)
                places.append(share * end)
    return np.array(owners, dtype=int), np.array(places).reshape(-1, 3)


def to_obstacles(robot: Robot, obstacles: tuple[Obstacle, ...], radius: float) -> Callable[[Array, Array], Array]:
    """Distances of a robot to obstacles [m], (obstacles,), of a position (n,) of its arm and a pose (3,) of its base.

    Shapes are the convex hulls of the URDF's collisions, else of its visuals; spheres along bodies that have none.
    """
    model, (offset, arm) = robot.model, robot.arm_map()
    geometry, count = shapes_of(robot, radius), len(obstacles)
    own, floor = geometry.ngeoms, robot.base.floor if robot.dimensions.base and np.isfinite(robot.base.floor) else 0.0
    for k, one in enumerate(obstacles):
        place = pin.SE3(np.eye(3), np.array([one.x, one.y, floor + one.height / 2]))
        geometry.addGeometryObject(pin.GeometryObject(f"obstacle_{k}", 0, place, coal.Cylinder(one.radius, one.height)))
        for i in range(own):
            geometry.addCollisionPair(pin.CollisionPair(i, own + k))
    data, found = model.createData(), geometry.createData()

    def distances(q: Array, pose: Array) -> Array:
        position = offset + arm @ q
        position[: len(pose)] = pose
        pin.computeDistances(model, data, geometry, found, robot.configuration(position))
        return np.array([result.min_distance for result in found.distanceResults]).reshape(count, own).min(axis=1)

    return distances


def shapes_of(robot: Robot, radius: float) -> pin.GeometryModel:
    """The shapes of a robot's links as Pinocchio has them, and spheres along bodies without any."""
    model, geometry = robot.model, pin.GeometryModel()
    rest = AtRest(parse(robot.urdf.encode(), robot.path), folders_of(robot.path, robot.overrides))
    for name, link in rest.document.links.items():
        frame = model.frames[model.getFrameId(name, pin.FrameType.BODY)]
        tag = "visual" if link.find("collision") is None else "collision"
        for i, shape in enumerate(rest.shapes(name, tag)):
            if shape.kind == "mesh" and not len(shape.points):
                continue
            place = frame.placement * pin.SE3(np.linalg.inv(rest.placements[name]))
            geometry.addGeometryObject(
                pin.GeometryObject(f"{name}_{i}", frame.parentJoint, place * middle_of(shape), hull(shape))
            )
    shown = {one.parentJoint for one in geometry.geometryObjects}
    for k, (j, at) in enumerate(zip(*spheres(robot, radius), strict=True)):
        if int(j) not in shown:
            place = pin.SE3(np.eye(3), at)
            geometry.addGeometryObject(pin.GeometryObject(f"sphere_{k}", int(j), place, coal.Sphere(max(radius, 1e-3))))
    return geometry


def middle_of(shape: Shape) -> pin.SE3:
    """Where the coal shape of `hull` stands: a ball at its middle, points where they are."""
    return pin.SE3(np.eye(3), shape.pose[:3, 3]) if shape.kind == "sphere" else pin.SE3.Identity()


def hull(shape: Shape) -> coal.CollisionGeometry:
    """A ball, or the convex hull of a shape's points."""
    if shape.kind == "sphere":
        return coal.Sphere(shape.radius)
    points = coal.StdVec_Vec3s()
    points.extend(list(outline(shape)))
    return coal.Convex.convexHull(points, False, "")
