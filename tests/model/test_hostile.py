"""Files that lie, blow up, or are far too large: one line, soon, and in little memory."""

from __future__ import annotations

import json
import resource
import struct
import sys
import time
import zipfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from drives import CYLINDER, robot_of
from test_wild import codes, drive_of

from mmnn_pin.errors import RobotError
from mmnn_pin.lab.show.replay.shapes import read_mesh
from mmnn_pin.model.base.report import Undecided
from mmnn_pin.model.loading import load
from mmnn_pin.model.urdf.meshes import BrokenMesh, damage_of, obj_vertices, vertices_of

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


def gltf(binary: bytes, **tree: object) -> bytes:
    """A GLB file of some triangles, with other tables in the place of those that show them once."""
    count = len(binary) // 36 * 3
    usual = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": len(binary)}],
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(usual | tree).encode()
    text += b" " * (-len(text) % 4)
    head = b"glTF" + struct.pack("<4I", 2, 28 + len(text) + len(binary), len(text), int.from_bytes(b"JSON", "little"))
    return head + text + struct.pack("<I", len(binary)) + b"BIN\0" + binary


COLLADA = b'<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema">'
DEEP = COLLADA + b"<a>" * 100_000 + b"</a>" * 100_000 + b"</COLLADA>"
CORNERS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
ACCESSOR = {"componentType": 5126, "count": 2**31, "type": "VEC3"}
MANY = [{"mesh": 0}] * 9000
SMALL_FILES_OF_MUCH = {
    "zeros.glb": (gltf(CORNERS, accessors=[ACCESSOR]), "it shows more than 2,000,000 triangles"),
    "unused.glb": (gltf(CORNERS, accessors=[{**ACCESSOR, "count": 3, "bufferView": 0}, ACCESSOR]), "it states numbers"),
    "often.glb": (gltf(CORNERS * 1000, nodes=MANY, scenes=[{"nodes": list(range(9000))}]), "it shows more than 2,000"),
    "parts.glb": (gltf(CORNERS, meshes=[{"primitives": [{"attributes": {"POSITION": 0}}] * 10_001}]), "10,000 parts"),
    "type.glb": (gltf(CORNERS, accessors=[{**ACCESSOR, "count": "3"}]), "not a whole glTF file"),
    "deep.glb": (gltf(CORNERS, extras=json.loads("[" * 900 + "]" * 900)), ""),
}
HOSTILE = {
    **{name: data for name, (data, _) in SMALL_FILES_OF_MUCH.items() if name != "deep.glb"},
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


def collada(levels: int, copies: int, end: str = "", numbers: str = "") -> bytes:
    """A scene whose node stands for several others, and so on; the last has an end, which may show a geometry."""
    nodes = "".join(
        f'<node id="n{k}">{f"""<instance_node url="#n{k + 1}"/>""" * copies if k + 1 < levels else end}</node>'
        for k in reversed(range(levels))
    )
    scene = '<visual_scene id="s"><node><instance_node url="#n0"/></node></visual_scene>'
    scene = f'<library_visual_scenes>{scene}</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>'
    geometry = f'<library_geometries><geometry id="g">{numbers}</geometry></library_geometries>'
    return COLLADA + f"{geometry}<library_nodes>{nodes}</library_nodes>{scene}</COLLADA>".encode()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (collada(60, 2), "it unfolds to more than 10,000 parts"),
        (collada(3, 1, '<instance_node url="#n0"/>'), "it unfolds to more than 10,000 parts"),
        (collada(10, 2), "holds no triangles"),
        (collada(2, 1, '<instance_geometry url="#g"/>' * 9990, "0 " * 10_000), "it unfolds to more than 120 MB"),
        (collada(2, 1, '<instance_geometry url="#g"/>' * 10_000), "it unfolds to more than 10,000 parts"),
        (
            b"<!--<COLLADA" + b"x" * 70_000 + b"--><!DOCTYPE a>" + collada(2, 1),
            "a DOCTYPE, whose entities could blow up",
        ),
        (COLLADA.decode().encode("utf-16")[:2] + b"<COLLADA</COLLADA", "not a whole Collada file"),
    ],
)
def test_a_collada_file_of_copies_of_copies_is_refused(data, words, tmp_path):
    (tmp_path / "m.dae").write_bytes(data)
    begun = time.process_time()
    assert vertices_of(tmp_path / "m.dae", 0).size == 0
    with pytest.raises(BrokenMesh, match=words):
        read_mesh(tmp_path / "m.dae")
    assert time.process_time() - begun < 5


@pytest.mark.parametrize("name", SMALL_FILES_OF_MUCH)
def test_a_small_gltf_file_of_much_is_refused_before_it_takes_memory(name, tmp_path):
    data, words = SMALL_FILES_OF_MUCH[name]
    file = tmp_path / name
    file.write_bytes(data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    if words:
        with pytest.raises(BrokenMesh, match=words):
            read_mesh(file)
    assert (vertices_of(file, 0).size == 0) == bool(words)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB


def test_a_gltf_file_shows_what_it_says(tmp_path):
    """Thrice the same triangle, each in a place of its own: no bound cuts into it."""
    places = [{"mesh": 0, "translation": [k, 0, 0]} for k in range(3)]
    (tmp_path / "m.glb").write_bytes(gltf(CORNERS, nodes=places, scenes=[{"nodes": [0, 1, 2]}]))
    assert len(read_mesh(tmp_path / "m.glb")) == 3
    assert sorted(vertices_of(tmp_path / "m.glb", 0)[:, 0]) == [0, 0, 1, 1, 1, 2, 2, 2, 3]


def png(width: int, height: int) -> bytes:
    """A picture of one colour: a few hundred kilobytes for hundreds of megabytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    row, packer = bytes(1 + 3 * width), zlib.compressobj(1)
    data = b"".join(packer.compress(row) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


TEXTURED_PLY = "ply\nformat ascii 1.0\ncomment TextureFile {}\nelement vertex 3\n"
TEXTURED_PLY += "".join(f"property float {axis}\n" for axis in "xyzst") + "element face 1\nproperty list uchar int "
TEXTURED_PLY += "vertex_indices\nend_header\n0 0 0 0 0\n1 0 0 1 0\n0 1 0 0 1\n3 0 1 2\n"
TEXTURED_DAE = "<library_images><image id='i' name='i'><init_from>{}</init_from></image></library_images>"


def test_no_format_makes_anybody_open_a_picture_or_what_lies_elsewhere(tmp_path, monkeypatch):
    """Pictures that a mesh holds or names: of its own folder, of another, with a name from the root."""
    import PIL.Image
    import trimesh

    (folder := tmp_path / "meshes").mkdir()
    for place in (folder, tmp_path):
        (place / "t.png").write_bytes(png(4000, 4000))
        (place / "raw.bin").write_bytes(CORNERS)
    opened: list[str] = []
    monkeypatch.setattr(PIL.Image, "open", lambda *_: opened.append("a picture"))
    sys.addaudithook(lambda event, given: opened.append(str(given[0])) if event == "open" else None)
    trimesh.creation.box().export(folder / "box.dae")
    dae = (folder / "box.dae").read_text()
    shiny = {"extensions": {"KHR_materials_pbrSpecularGlossiness": {"diffuseTexture": {"index": 0}}}}
    for picture in ("t.png", "../t.png", str(tmp_path / "t.png")):
        for kind, data in {
            "ply": TEXTURED_PLY.format(picture).encode(),
            "dae": dae.replace("<library_effects", TEXTURED_DAE.format(picture) + "<library_effects").encode(),
            "glb": gltf(
                CORNERS,
                images=[{"uri": picture}],
                textures=[{"source": 0}],
                materials=[shiny, {"normalTexture": {"index": 0}}],
            ),
        }.items():
            (folder / f"m.{kind}").write_bytes(data)
            assert read_mesh(folder / f"m.{kind}") and vertices_of(folder / f"m.{kind}", 0).size
    for uri, read in (("raw.bin", True), ("../raw.bin", False), (str(tmp_path / "raw.bin"), False)):
        tree = json.loads(gltf(CORNERS, buffers=[{"byteLength": 36, "uri": uri}])[20:].partition(b"BIN\0")[0][:-4])
        (folder / "m.gltf").write_text(json.dumps(tree))
        vertices_of.cache_clear()
        assert (vertices_of(folder / "m.gltf", 0).size > 0) == read
    assert "a picture" not in opened and not [name for name in opened if name.endswith(".png")]
    assert str(folder / "raw.bin") in opened and str(tmp_path / "raw.bin") not in opened


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


def test_what_a_mesh_file_has_is_quoted_shortly(tmp_path):
    file = tmp_path / "m.off"
    file.write_bytes(b"OFF\n3 1 0\n0 0 -" + bytes(5000) + b"\n0 1 0\n1 0 0\n3 0 1 2\n")
    with pytest.raises(BrokenMesh) as caught:
        read_mesh(file)
    assert "could not convert" in str(caught.value)
    assert len(str(caught.value)) < 300
    assert str(caught.value).isprintable()


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
