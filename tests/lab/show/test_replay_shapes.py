"""What stands in a replay for a mesh that is not there: collision shapes of its link, else a box; and what is told."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from replays import data_of, recorded

from mmnn_pin import load
from mmnn_pin.lab.show.replay import page

LINK = """<link name="{name}"><inertial><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
<visual><origin xyz="9 0 0"/><geometry><mesh filename="package://gone/{name}.stl"/></geometry></visual>
{collision}</link>"""
JOINT = """<joint name="{child}_joint" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="50" velocity="3"/></joint>"""
ROUND = '<origin xyz="0 0 0.1"/><geometry><cylinder radius="0.04" length="0.2"/></geometry>'
KNOWN = '<origin xyz="0 0 0.05"/><geometry><mesh filename="box.stl" scale="1 1 2"/></geometry>'
LOST = '<geometry><mesh filename="package://gone/c.stl"/></geometry>'


def shown(folder: Path, **collisions: str) -> tuple[list[dict[str, Any]], dict[str, Any], tuple[str, ...]]:
    """Shapes of an arm whose visual meshes are missing: those of the page, the page's data, its warnings."""
    trimesh.creation.box((0.1, 0.2, 0.3)).export(folder / "box.stl")
    names = ["stand", *collisions]
    links = [LINK.format(name=n, collision=f"<collision>{c}</collision>" if c else "") for n, c in collisions.items()]
    joints = [JOINT.format(parent=a, child=b) for a, b in pairwise(names)]
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="arm"><link name="stand"/>{"".join(links + joints)}</robot>')
    made = page({"pd": recorded(load(file, package_dirs=[str(folder)]), "pd")})
    data = data_of(made.html)
    return data["robots"][0]["visuals"], data, made.warnings


def test_collision_shapes_stand_in_and_are_told(tmp_path: Path) -> None:
    visuals, data, warnings = shown(tmp_path, upper=ROUND, fore=KNOWN, hand="", tool=LOST)
    shapes = [data["geometries"][one["geometry"]] for one in visuals]
    assert [shape["kind"] for shape in shapes] == ["cylinder", "mesh", "box", "box"]
    assert shapes[0]["size"] == [0.04, 0.2] and shapes[2]["size"] == [0.1, 0.1, 0.1]
    places = [np.reshape(one["place"], (4, 4)).T for one in visuals]
    np.testing.assert_allclose(places[0][:3, 3], [0, 0, 0.1])  # where the collision shape is, not the mesh
    np.testing.assert_allclose(np.diag(places[1]), [1, 1, 2, 1])
    np.testing.assert_allclose(places[2][:3, 3], [9, 0, 0])
    assert visuals[0]["color"] != visuals[2]["color"] == visuals[3]["color"]
    seen, boxes = warnings
    assert seen.startswith(
        "mesh 'package://gone/upper.stl' and 1 more are missing: collision shapes stand in: give the"
    )
    assert boxes.startswith("mesh 'package://gone/hand.stl' and 1 more are missing: a box of 0.1 m stands in: give the")
    assert data["warnings"] == [seen, boxes]


def test_a_mesh_that_cannot_be_read_has_its_collision_shape_too(tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    (tmp_path / "gone" / "upper.stl").write_text("no mesh")
    visuals, data, (warning,) = shown(tmp_path, upper=ROUND)
    assert data["geometries"][visuals[0]["geometry"]]["kind"] == "cylinder"
    assert "gone/upper.stl" in warning and warning.endswith(": collision shapes stand in")
