"""A picture of a robot as it was understood, without a display: bodies in colours of their roles, forward, the wheels.

Triangles are sampled at the pixels' spacing and the nearest sample of a pixel is kept. The projection is parallel, so
that lengths in the picture are those of the robot.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from ...model.inspection import inspection_of
from ...model.robot import Robot
from ...signals import Array
from .robots import summary
from .solids import CASTER, DRIVEN, LEFT, RIGHT, ROLLING, STEERING, legend, placements, solids_of

RIGHT_UP_NEAR = {  # (3, 3) rows of a view: to the right, up, towards the eye
    "from the front left": np.array([[-0.643, 0.766, 0.0], [-0.324, -0.272, 0.906], [0.694, 0.583, 0.423]]),
    "from above, forward up": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
}
ABOVE = "from above, forward up"
PIXELS = 800  # along the longer side of a view, before two by two are averaged
LIGHT = np.array([0.35, 0.2, 0.9])
MOST = 400_000  # triangles that are drawn; of more every second, third, ... stands for its neighbours
BELOW = (LEFT, RIGHT, DRIVEN, ROLLING, STEERING, CASTER)  # seen from above through what they carry
FORWARD = "#d00000"


def shaded(triangles: Array, color: str) -> Array:
    """(m, 3) colours of triangles (m, 3, 3) in daylight."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    facing = np.abs(normals @ (LIGHT / np.linalg.norm(LIGHT)))[:, None] / np.maximum(lengths, 1e-300)
    return (0.45 + 0.55 * facing) * np.array(to_rgb(color))


def longest_first(points: Array, spacing: float) -> tuple[Array, NDArray[np.int64]]:
    """Triangles (m, 3, 3) seen along their third axis, longest edge first; samples (m, 2) along and across that edge.

    A sliver takes as many samples as pixels that it covers. Counts are rounded up to powers of the root of 2, so that
    triangles of alike sizes are sampled together.
    """
    edges = np.roll(points[..., :2], -1, axis=1) - points[..., :2]
    lengths = np.linalg.norm(edges, axis=2)
    order = (lengths.argmax(axis=1)[:, None] + np.arange(3)) % 3
    longest = lengths.max(axis=1)
    doubled = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])
    close = spacing / 2**0.5  # so close that no pixel is missed
    sides = np.column_stack((longest, doubled / np.maximum(longest, 1e-300))) / close
    counts = np.ceil(2 ** (np.ceil(2 * np.log2(np.maximum(sides, 1.0))) / 2))
    return np.take_along_axis(points, order[..., None], axis=1), counts.astype(np.int64)


def rendered(triangles: Array, colors: Array, view: Array, spacing: float) -> tuple[Array, tuple[float, ...]]:
    """An image (h, w, 4) of triangles (m, 3, 3), and its extent: left, right, bottom, top in the view [m]."""
    points = triangles @ view.T
    low, high = points[..., :2].min(axis=(0, 1)), points[..., :2].max(axis=(0, 1))
    width, height = (np.ceil((high - low) / (2 * spacing)).astype(int) + 1) * 2
    depth, index = np.full(width * height, -np.inf), np.full(width * height, -1)
    points, counts = longest_first(points, spacing)
    grids, grid_of = np.unique(counts @ (1, 1j), return_inverse=True)
    groups = np.split(np.argsort(grid_of, kind="stable"), np.cumsum(np.bincount(grid_of))[:-1])
    for grid, chosen in zip(grids, groups, strict=True):
        along, across = int(grid.real), int(grid.imag)
        s, t = (grid.ravel() for grid in np.meshgrid(np.linspace(0, 1, along + 1), np.linspace(0, 1, across + 1)))
        weights = np.column_stack(((1 - t) * (1 - s), (1 - t) * s, t))
        for part in np.array_split(chosen, max(1, len(chosen) * len(s) // 2_000_000)):
            sampled = (weights @ points[part]).reshape(-1, 3)
            cells = ((sampled[:, :2] - low) / spacing).astype(int)
            flat, owner = cells[:, 1] * width + cells[:, 0], np.repeat(part, len(s))
            order = np.argsort(sampled[:, 2])  # of several at one place numpy keeps the last
            flat, owner, near = flat[order], owner[order], sampled[order, 2]
            ahead = near > depth[flat]
            depth[flat[ahead]], index[flat[ahead]] = near[ahead], owner[ahead]
    image = np.zeros((width * height, 4))
    seen = index >= 0
    image[seen, :3], image[seen, 3] = colors[index[seen]], 1.0
    image[:, :3] *= image[:, 3:]
    small = image.reshape(height // 2, 2, width // 2, 2, 4).mean(axis=(1, 3))
    small[..., :3] /= np.maximum(small[..., 3:], 1e-9)
    low_x, low_y = low
    return small, (low_x, low_x + width * spacing, low_y, low_y + height * spacing)


def picture(robot: Robot) -> tuple[Figure, tuple[str, ...]]:
    """A figure of a robot where it rests, from the front left and from above, with what was understood of it.

    Returns:
        The figure, and a line for every shape that is not shown as the file says.
    """
    solids, warnings = solids_of(robot)
    position = robot.neutral_position()
    soups, colors, rolling = [], [], []
    for solid, place in zip(solids, placements(robot, position, solids), strict=True):
        world = solid.vertices @ place[:3, :3].T + place[:3, 3]
        soups.append(world[solid.triangles[:: 1 + sum(len(s.triangles) for s in solids) // MOST]])
        colors.append(shaded(soups[-1], solid.role.color))
        rolling.append(np.full(len(soups[-1]), solid.role in BELOW))
    triangles, tints, rolls = np.concatenate(soups), np.concatenate(colors), np.concatenate(rolling)
    figure = Figure(figsize=(11, 6.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.2, 1.0))
    size = float(np.ptp(triangles, axis=(0, 1)).max()) or 1.0
    for axes, (title, view) in zip((left, right), RIGHT_UP_NEAR.items(), strict=True):
        layers = [(np.ones(len(triangles), bool), 1.0)] + [(rolls, 0.8)] * int(title == ABOVE and rolls.any())
        for chosen, opacity in layers:
            image, extent = rendered(triangles[chosen], tints[chosen], view, size / PIXELS)
            axes.imshow(image, extent=extent, origin="lower", interpolation="antialiased", alpha=opacity)
            axes.update_datalim(np.reshape(extent, (2, 2)).T)
        marked(axes, robot, view, size)
        axes.set_title(title, fontsize=9, color="0.35")
        axes.set_axis_off()
        axes.set_aspect("equal")
        axes.margins(0.05)
        axes.autoscale()
    figure.suptitle("\n".join([robot.name, *summary(inspection_of(robot))]), fontsize=9, ha="left", x=0.01, wrap=True)
    marks = [
        (Line2D([], [], marker="s", ls="", ms=9, color=role.color), f"{role.name}: {names}")
        for role, names in legend(robot)
    ]
    marks += [(Line2D([], [], color=FORWARD, lw=2), "forward, from the control frame")] * bool(robot.dimensions.pose)
    if marks:
        figure.legend(*zip(*marks, strict=True), loc="outside lower left", ncols=2, fontsize=8, frameon=False)
    return figure, warnings


def marked(axes: Axes, robot: Robot, view: Array, size: float) -> None:
    """Draw the control frame with forward, and name the wheels."""
    if not robot.dimensions.pose:
        return

    def at(point: Sequence[float]) -> tuple[float, float]:
        x, y, _ = view @ np.array(point)
        return float(x), float(y)

    start, end = at((0.0, 0.0, 0.0)), at((0.45 * size, 0.0, 0.0))
    arrow = {"arrowstyle": "-|>", "color": FORWARD, "lw": 2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=arrow, annotation_clip=False)
    axes.update_datalim([start, end])
    axes.plot(*start, "o", color=FORWARD, ms=4)
    if view is RIGHT_UP_NEAR[ABOVE]:  # where the names have room
        for entry in inspection_of(robot)["base"]["wheels"]:
            where = at((entry["x"], entry["y"], 0.0))
            box = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75}
            side = "right" if where[0] < 0 else "left"
            axes.text(where[0], where[1], entry["joint"], ha=side, va="center", fontsize=7, bbox=box)
