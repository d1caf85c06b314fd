"""How far the links of a robot stay apart: spheres along them, of which those on neighbours may touch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from ...model.robot import Robot
from ...signals import Array


def clearances(robot: Robot, radius: float) -> Callable[[Array], float]:
    """Smallest distance of spheres on links that are not neighbours, over two radii, of a position (n,).

    Spheres of one radius stand along the lines from each moving joint to the joints and centres that its body carries.
    Spheres that touch at rest do not count.
    """
    model, offset, arm = robot.model, *robot.arm_map()
    data, owners, places = model.createData(), [], []
    moving = [j for j in range(1, model.njoints) if robot.T[model.idx_vs[j]].any() or model.nvs[j] == 3]
    carrier = {j: j for j in moving}
    for j in range(1, model.njoints):
        carrier.setdefault(j, carrier.get(model.parents[j], 0))
    for j in moving:
        ends = [model.jointPlacements[k].translation for k in moving if model.parents[k] == j]
        ends += [model.inertias[j].lever]
        for end in ends:
            for share in np.linspace(0.0, 1.0, max(2, int(np.linalg.norm(end) / max(2 * radius, 0.04)) + 1)):
                owners.append(j)
                places.append(share * end)
    if not owners:
        return lambda q: np.inf
    owner, local = np.array(owners), np.array(places)
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
