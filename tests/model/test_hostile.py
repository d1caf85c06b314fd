"""Files that lie, blow up, or are far too large: one line, soon, and in little memory."""

from __future__ import annotations

import json
import resource
import struct
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from drives import CYLINDER, robot_of
from test_wild import codes, drive_of

from mmnn_pin.errors import RobotError
from mmnn_pin.lab.show.replay.shapes import BrokenMesh, read_mesh
from mmnn_pin.model.base.report import Undecided
from mmnn_pin.model.loading import load
from mmnn_pin.model.urdf.shapes import damage_of, obj_vertices, vertices_of

LARGE = 49_000_000  # bytes
TRIANGLE = struct.Struct("<12fH")


def stl(triangles: list[list[float]], stated: int | None = None) -> bytes:
    """A binary STL file, with the number of triangles that it states."""
    count = len(triangles) if stated is None else stated
    return bytes(80) + struct.pack("<I", count) + b"".join(TRIANGLE.pack(*t, 0) for t in triangles)


def ply(kind: str, count: int, data: bytes) -> bytes:
    head = f"ply\nformat {kind} 1.0\nelement vertex {count}\n"
    return (head + "".join(f"property float {a}\n" for a in "xyz") + "end_header\n").encode() + data


def glb(count: int) -> bytes:
    """A glTF file whose accessor states so many vertices on twelve bytes."""
    accessor = {"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}
    tree = {"asset": {"version": "2.0"}, "accessors": [accessor], "bufferViews": [{"buffer": 0, "byteLength": 12}]}
    tree |= {"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "buffers": [{"byteLength": 12}]}
    text = json.dumps(tree | {"nodes": [{"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0}).encode()
    text += b" " * (-len(text) % 4)
    head = b"glTF" + struct.pack("<II", 2, 40 + len(text)) + struct.pack("<I", len(text)) + b"JSON"
    return head + text + struct.pack("<I", 12) + b"BIN\0" + bytes(12)


COLLADA = b'<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">'
DEEP = COLLADA + b"<a>" * 100_000 + b"</a>" * 100_000 + b"</COLLADA>"
HOSTILE = {
    "lies.stl": stl([[0.0] * 12], 2**32 - 1),
    "nan.stl": stl([[0.0] * 12] * 2000 + [[float("nan")] * 12]),
    "none.stl": stl([]),
    "flat.stl": stl([[0.0] * 12] * 100),
    "line.stl": stl([[0.0, 0, 1, 0, 0, 0, 1, 0, 0, 2, 0, 0]] * 100),
    "lies.ply": ply("binary_little_endian", 4_000_000_000, bytes(1000)),
    "text.ply": ply("ascii", 4_000_000_000, b"0 0 0\n" * 100),
    "lies.glb": glb(4_000_000_000),
    "deep.dae": DEEP,
    "inf.obj": b"v 1 2 3\nv inf 0 0\nv nan 1 1\nf 1 2 3\n",
    "word.obj": b"v 1 2 3\nv 1 a 3\nf 1 2 1\n",
    "short.obj": b"v 1 2 3\nv 1\nf 1 2 1\n",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_mesh_is_no_wheel_and_one_line(tmp_path, name):
    (tmp_path / name).write_bytes(HOSTILE[name])
    begun = time.process_time()
    with pytest.raises(Undecided) as error:
        robot_of(drive_of(f'<mesh filename="{name}"/>', 0.2, 0.1), tmp_path / "r.urdf")
    assert time.process_time() - begun < 10 and "\n" not in str(error.value) and "radius unknown" in str(error.value)


@pytest.fixture(scope="module")
def bomb(tmp_path_factory) -> bytes:
    """An archive of 200 kB that unpacks to 200 MB."""
    file = tmp_path_factory.mktemp("bomb") / "bomb"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(2):
            archive.writestr(f"3D/m{k}.model", b"0" * 100_000_000)
    return file.read_bytes()


@pytest.mark.parametrize("suffix", ["3mf", "zip", "dae", "obj"])
def test_an_archive_is_never_unpacked(tmp_path, bomb, suffix):
    file = tmp_path / f"bomb.{suffix}"
    file.write_bytes(bomb)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert vertices_of(file, 0).size == 0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB
    text = drive_of(CYLINDER.format(r=0.1), 0.2, 0.1)
    (tmp_path / "r.urdf").write_text(text.replace('<box size="0.3 0.2 0.1"/>', f'<mesh filename="{file.name}"/>'))
    assert "mesh-corrupt" in codes(load(tmp_path / "r.urdf"))


def test_vertices_of_an_obj_file_are_those_that_trimesh_reads(tmp_path):
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    file = tmp_path / "ball.obj"
    mesh.export(file)
    assert np.allclose(obj_vertices(file), trimesh.load_mesh(file, process=False).vertices, atol=1e-8)


TAGS = {
    "extensions": "<gazebo>" + '<a b="1"/>\n' * (LARGE // 12) + "</gazebo>",
    "materials": '<material name="m"><color rgba="1 1 1 1"/></material>' * (LARGE // 60),
    "comment": f"<!--{'x' * LARGE}-->",
    "attribute": f'<gazebo a="{"1" * LARGE}"/>',
    "brackets": "<" * LARGE,
}


@pytest.mark.long
@pytest.mark.parametrize("name", TAGS)
@pytest.mark.parametrize("suffix", ["urdf", "xacro"])
def test_a_file_of_50_mb_is_one_line_soon(tmp_path, name, suffix):
    file = tmp_path / f"r.{suffix}"
    file.write_text(drive_of(CYLINDER.format(r=0.1), 0.2, 0.1).replace("</robot>", TAGS[name] + "</robot>"))
    begun = time.perf_counter()
    with pytest.raises(RobotError) as error:
        load(file)
    assert time.perf_counter() - begun < 40 and "\n" not in str(error.value)  # 10 s on an idle machine


MESHES = {
    "v.obj": b"v 0.1 0.2 0.3\n" * (LARGE // 14),
    "f.obj": b"v 0.1 0.2 0.3\n" * 100 + b"f 1 2 3\n" * (LARGE // 8),
    "b.stl": bytes(80) + struct.pack("<I", LARGE // 50) + TRIANGLE.pack(*[0.1] * 12, 0) * (LARGE // 50),
    "t.ply": ply("ascii", LARGE // 6, b"0 0 0\n" * (LARGE // 6)),
}


@pytest.mark.long
@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_of_50_mb_takes_little_time_and_memory(tmp_path, name):
    (tmp_path / name).write_bytes(MESHES[name])
    begun, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(Undecided):
        robot_of(drive_of(f'<mesh filename="{name}"/>', 0.2, 0.1), tmp_path / "r.urdf")
    assert time.perf_counter() - begun < 30  # 6 s compiled, on an idle machine
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1_000_000  # kB


def collada(levels: int, copies: int, end: str = "") -> bytes:
    """A scene whose node stands for several others, and so on."""
    nodes = "".join(
        f'<node id="n{k}">{f"""<instance_node url="#n{k + 1}"/>""" * copies if k + 1 < levels else end}</node>'
        for k in reversed(range(levels))
    )
    return COLLADA + f"<library_nodes>{nodes}</library_nodes></COLLADA>".encode()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (collada(60, 2), "it unfolds to more than 100,000 nodes"),
        (collada(3, 1, '<instance_node url="#n0"/>'), "it unfolds to more than 100,000 nodes"),
        (collada(10, 2), ""),
    ],
)
def test_a_collada_file_of_copies_of_copies_is_refused(data, words, tmp_path):
    (tmp_path / "m.dae").write_bytes(data)
    begun = time.process_time()
    assert damage_of(tmp_path / "m.dae") == words

    if words:
        assert vertices_of(tmp_path / "m.dae", 0).size == 0
        with pytest.raises(BrokenMesh, match=words):
            read_mesh(tmp_path / "m.dae")
    assert time.process_time() - begun < 5


def test_a_glb_that_states_more_than_it_has_is_not_read(tmp_path):
    import trimesh

    trimesh.creation.box().export(tmp_path / "m.glb")
    sound = (tmp_path / "m.glb").read_bytes()
    assert damage_of(tmp_path / "m.glb") == ""
    for at in (8, 12):
        (tmp_path / "m.glb").write_bytes(sound[:at] + (2**31 - 1).to_bytes(4, "little") + sound[at + 4 :])
        assert damage_of(tmp_path / "m.glb").startswith("it states 21474836")
    for short in (b"glTF", sound[:19], b"x" * 40):
        (tmp_path / "m.glb").write_bytes(short)
        assert damage_of(tmp_path / "m.glb") == "not a whole GLB file"


@pytest.mark.parametrize("suffix", ["3mf", "zip", "zae", "glb", "stl"])
def test_the_replay_unpacks_no_archive_and_believes_no_count(tmp_path, bomb, suffix):
    file = tmp_path / f"bomb.{suffix}"
    file.write_bytes({"glb": HOSTILE["lies.glb"], "stl": HOSTILE["lies.stl"]}.get(suffix, bomb))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BrokenMesh):
        read_mesh(file)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


def test_the_replay_opens_no_picture_and_nothing_elsewhere(tmp_path):
    (folder := tmp_path / "meshes").mkdir()
    for place in (tmp_path, folder):
        (place / "m.mtl").write_text("newmtl a\nKd 1 0 0\nmap_Kd t.png\nmap_Kd ../t.png\n")
        (place / "t.png").write_bytes(b"\x89PNG\r\n")
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"
    opened: list[str] = []
    sys.addaudithook(lambda event, given: opened.append(str(given[0])) if event == "open" else None)
    for mtl, red in (("m.mtl", 1.0), ("../m.mtl", None), (str(tmp_path / "m.mtl"), None)):
        (folder / "m.obj").write_text(f"mtllib {mtl}\n{corners}")
        (part,) = read_mesh(folder / "m.obj")
        assert (part.color is not None and part.color[0] == red) or red is None
    assert not [name for name in opened if name.endswith(".png") or name == str(tmp_path / "m.mtl")]
    assert str(folder / "m.mtl") in opened


def test_a_pipe_is_no_mesh(tmp_path):
    import os

    os.mkfifo(tmp_path / "wheel.stl")
    with pytest.raises(Undecided, match="mesh missing"):
        robot_of(drive_of('<mesh filename="wheel.stl"/>', 0.2, 0.1), Path(tmp_path) / "r.urdf")
