"""Break files of every kind at random and hand them to every command that reads them: an answer or one clear line.

python tests/fuzz_files.py [--files 10000] [--seed 0] [--batch 100] [--kinds recording study ...]

A batch is worked through in a process of its own, so that a crash of the interpreter is seen and its file known. Every
command has 10 s of processor time (300 s in all, if it waits) and 1 GB more than at the start there, all without
compiling; one that takes longer is tried again compiled; what it writes,
makes or removes outside its output folder, what it runs out of a file, and what it reads from a folder that nobody
named is noticed.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import faulthandler
import io
import json
import math
import os
import random
import re
import resource
import shutil
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fuzz_urdf
import h5py
import numpy as np

from mmnn_pin.compiled.folders import cache_root

ROOT = Path(__file__).parent.parent
SECONDS, WAITING, MEMORY = 10, 300, 1 << 30  # of a command: processor time, time, bytes
AT_WORK = re.compile(r", after \d+ s$", re.MULTILINE)  # what a long command tells now and then
DRAWING = ("plot", "report", "run")  # what takes seconds
GOOD = ("done", "failed", "refused", "at work")  # the last: a file asks for much, and the command tells how far it is
OUTPUT = ("out", "db", "tuned")  # folders that a command may write to
EVIL = "from pathlib import Path\nPath('ran').touch()\nclass Evil: pass\n"
SECRET = (
    b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
)
VALUES: list[Any] = [None, True, 0, 1, -1, 3, 2**40, -(2**63), 10**30, 0.0, -0.5, 1e-300, 1e300, math.inf, -math.inf]
VALUES += [math.nan, "", "x", "nan", "../../x", "/dev/zero", "/etc/passwd", "evil.py:Evil", "<script>alert(1)</script>"]
VALUES += [
    "$x^",
    "\x1b[2J\u202e",
    "a\nb",
    "\x00",
    "é" * 300,
    "y" * 3000,
    [],
    {},
    [1, 2],
    ["a", 5],
    [[]],
    [[1.0]],
    {"a": 1},
]
VALUES += [{"type": "push"}, ["v"], ["v", "v", "v", "v"], [1e400], {"k": {"k": {"k": []}}}]

Mutation = Callable[[Path, random.Random], None]


# -- trees of JSON -----------------------------------------------------------------------------------------------------


def places(tree: Any) -> list[tuple[Any, Any]]:
    """Every container in a tree with every key of it."""
    found, left = [], [tree]
    while left:
        here = left.pop()
        keys = list(here) if isinstance(here, dict) else list(range(len(here))) if isinstance(here, list) else []
        found += [(here, key) for key in keys]
        left += [here[key] for key in keys]
    return found


def disturbed(tree: Any, rng: random.Random) -> Any:
    """A tree with something else at one of its places."""
    tree = json.loads(json.dumps(tree))
    everywhere = places(tree)
    if not everywhere or rng.random() < 0.05:
        return rng.choice(VALUES)
    here, key = rng.choice(everywhere)
    how = rng.random()
    if how < 0.2:
        del here[key]
    elif how < 0.3 and isinstance(here, dict):
        here[rng.choice(["x", "law", "type", "file", "", "é"])] = rng.choice(VALUES)
    elif how < 0.4:
        deep: Any = 1
        for _ in range(rng.choice((5, 50, 500))):
            deep = [deep]
        here[key] = deep
    elif how < 0.6 and isinstance(here[key], int | float) and not isinstance(here[key], bool):
        here[key] = here[key] * rng.choice((-1, 0, 0.5, 2, 1e3, 1e9, 1e-9, 1e200))
    else:
        here[key] = rng.choice(VALUES)
    return tree


def json_file(name: str) -> Mutation:
    """A mutation of a JSON file in a folder."""

    def mutate(folder: Path, rng: random.Random) -> None:
        with contextlib.suppress(ValueError):
            (folder / name).write_text(json.dumps(disturbed(json.loads((folder / name).read_bytes()), rng)))

    return mutate


# -- bytes -------------------------------------------------------------------------------------------------------------


def zeros(data: bytes, rng: random.Random) -> bytes:
    at, count = rng.randrange(len(data)), rng.choice((1, 8, 64, 4096))
    return data[:at] + bytes(min(count, len(data) - at)) + data[at + count :]


def head(data: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(min(len(data), 4096))
    return data[:at] + bytes([rng.choice((0, 1, 0x7F, 0x80, 0xFF))]) + data[at + 1 :]


def live(data: bytes, rng: random.Random) -> bytes:
    """A byte changed where there is something: most of a short recording is room for more rows."""
    places = np.flatnonzero(np.frombuffer(data, np.uint8))
    at = int(rng.choice(places)) if len(places) else 0
    return data[:at] + bytes([rng.randrange(256)]) + data[at + 1 :]


BYTES = [
    *4 * [live],
    fuzz_urdf.flip_byte,
    fuzz_urdf.cut_bytes,
    fuzz_urdf.copy_bytes,
    fuzz_urdf.truncate,
    zeros,
    *2 * [head],
]


def raw(name: str) -> Mutation:
    """A mutation of the bytes of a file in a folder."""

    def mutate(folder: Path, rng: random.Random) -> None:
        data = (folder / name).read_bytes()
        for _ in range(rng.choice((1, 1, 3, 20))):
            data = rng.choice(BYTES)(data or b" ", rng)
        (folder / name).write_bytes(data)

    return mutate


def words(name: str) -> Mutation:
    """A mutation of a word of a text file in a folder."""

    def mutate(folder: Path, rng: random.Random) -> None:
        lines = (folder / name).read_text(errors="replace").splitlines() or [""]
        at = rng.randrange(len(lines))
        how = rng.random()
        if how < 0.2:
            lines[at] = ""
        elif how < 0.4:
            lines.insert(rng.randrange(len(lines)), lines[at])
        elif how < 0.9:
            first, mark, _ = lines[at].partition(rng.choice(("=", ",", " ")))
            value = rng.choice([*VALUES, "[" * 500, "{x=" * 300, "1e999", "2020-01-01", "'''", "0x1F", "-"])
            lines[at] = f"{first}{mark}{value if rng.random() < 0.5 else json.dumps(value)}"
        else:
            lines[at] = f"[{rng.choice(('a' * 99, 'a.' * 400 + 'a', 'time', 'laws.x', 'cases.x', '[x]'))}]"
        (folder / name).write_text("\n".join(lines), errors="replace")

    return mutate


def cells(name: str) -> Mutation:
    """A mutation of cells of a table in a folder, or of its columns."""

    def mutate(folder: Path, rng: random.Random) -> None:
        rows = [line.split(",") for line in (folder / name).read_text().splitlines()]
        how, at = rng.random(), rng.randrange(len(rows[0]))
        if how < 0.15:
            for row in rows:
                row.insert(at, rng.choice((row[at], "0", "x")))
        elif how < 0.3:
            rows[0][at] = rng.choice(("x", "v", "w", "vy", "time", "position.nobody", "velocity.arm_1_joint", ""))
        elif how < 0.4:
            rows[1:] = rng.choice((rows[:0:-1], rows[1:2], rows[1:] * 3, rows[1:2] * 500))
        else:
            for _ in range(rng.choice((1, 1, 3, 30))):
                rng.choice(rows[1:])[at] = rng.choice(
                    ("nan", "inf", "-1", "1e300", "1e9", "1e-320", "", "0", "90", "0x1")
                )
        (folder / name).write_text("\n".join(map(",".join, rows)))

    return mutate


# -- recordings --------------------------------------------------------------------------------------------------------


def fact(file: h5py.File, rng: random.Random) -> None:
    """Something else in an attribute."""
    holder = file if rng.random() < 0.7 else file[f"signals/{rng.choice(list(file['signals']))}"]
    name, how = rng.choice(list(holder.attrs)), rng.random()
    if how < 0.15:
        del holder.attrs[name]
        return
    old = holder.attrs[name]
    if how < 0.6 and isinstance(old, str) and old.startswith("json:"):
        holder.attrs[name] = f"json:{json.dumps(disturbed(json.loads(old[5:]), rng))}"
        return
    odd = [
        np.arange(6.0).reshape(2, 3),
        np.array([b"ab"]),
        h5py.Empty("f8"),
        np.void(b"abc"),
        file.ref,
        "json:",
        "json:{",
    ]
    odd += [
        "json:" + "[" * 5000,
        "json:1" + "0" * 5000,
        np.array(["a"] * 3, h5py.string_dtype()),
        b"\xff\xfe",
        np.int8(3),
    ]
    value = rng.choice(odd if how < 0.75 else VALUES)
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        holder.attrs[name] = f"json:{json.dumps(value)}" if value is None or isinstance(value, list | dict) else value


def dataset_of(file: h5py.File, rng: random.Random) -> str:
    """A dataset by name; a quarter are not signals."""
    group = rng.choice(("signals", "signals", "signals", "weights", "final", "timing"))
    if not isinstance(file.get(group), h5py.Group) or not len(file[group]):
        group = "signals"
    return f"{group}/{rng.choice(list(file[group]))}"


def numbers(file: h5py.File, rng: random.Random) -> None:
    """Other numbers in a dataset."""
    name = rng.choice(("signals/time", dataset_of(file, rng)))
    table = file[name]
    if not isinstance(table, h5py.Dataset) or not table.size or table.dtype.kind != "f":
        return
    values = table[()]
    flat = np.atleast_1d(values).reshape(-1)
    for _ in range(rng.choice((1, 3, flat.size))):
        flat[rng.randrange(flat.size)] = rng.choice((math.nan, math.inf, -1e300, 1e300, 0.0, -1.0, 1e9, 1e-320))
    table[...] = rng.choice((flat, flat[::-1])).reshape(values.shape)


def another(file: h5py.File, rng: random.Random) -> None:
    """Another dataset in the place of one."""
    name = dataset_of(file, rng)
    old = file[name]
    attributes = dict(old.attrs) if hasattr(old, "attrs") else {}
    values = old[()] if isinstance(old, h5py.Dataset) else np.zeros(3)
    kinds: list[Callable[[], Any]] = [
        lambda: np.asarray(values, "i4"),
        lambda: np.asarray(values, "f4"),
        lambda: np.asarray(values, "c16"),
        lambda: np.asarray(np.shape(values), "S3"),
        lambda: np.zeros(3, [("a", "f8"), ("b", "i2")]),
        lambda: np.atleast_1d(values)[: rng.randrange(5)],
        lambda: np.concatenate([np.atleast_1d(values)] * 2),
        lambda: np.zeros((4, 3, 2)),
        lambda: np.zeros((len(np.atleast_1d(values)), rng.choice((0, 1, 3, 9)))),
        lambda: h5py.Empty("f8"),
        lambda: 1.0,
        lambda: "text",
    ]
    made = rng.choice(kinds)()
    del file[name]
    kept = file.create_dataset(name, data=made)
    for key, value in attributes.items():
        kept.attrs[key] = value


def elsewhere(file: h5py.File, rng: random.Random) -> None:
    """A link, a file outside, a bomb, a group where a dataset was, or nothing."""
    name = rng.choice((dataset_of(file, rng), "signals", "urdf", "config", "weights", "final", "timing"))
    attributes = dict(file[name].attrs) if name in file and isinstance(file[name], h5py.Dataset) else {}
    if name in file:
        del file[name]
    sizes = ((10**12,), (10**6, 40), (2**40, 2**20))

    def outside() -> None:
        file.create_dataset(name, (3,), "f8", external=[("secret/raw.bin", 0, 24)])

    def virtual() -> None:
        layout = h5py.VirtualLayout((10,), "f8")
        layout[:] = h5py.VirtualSource("secret/run.h5", "signals/time", (10,))
        file.create_virtual_dataset(name, layout)

    def bomb() -> None:
        file.create_dataset(
            name, (rng.choice((10**6, 10**8)),), "f8", compression="gzip", chunks=(10**5,), fillvalue=0.0
        )

    choices: list[Callable[[], Any]] = [
        lambda: file.__setitem__(name, h5py.SoftLink(rng.choice(("/signals/time", "/", "/nowhere")))),
        lambda: file.__setitem__(name, h5py.ExternalLink("secret/run.h5", f"/{name}")),
        lambda: file.__setitem__(name, file["/"]),
        lambda: file.__setitem__(name, np.dtype("f8")),
        lambda: file.create_group(name),
        lambda: file.create_dataset(name, rng.choice(sizes), "f8", chunks=True),
        outside,
        virtual,
        bomb,
        lambda: None,
        lambda: file["signals"].create_dataset(rng.choice(("x", "é", "<b>", "a" * 900)), data=np.zeros(10)),
    ]
    with contextlib.suppress(ValueError, TypeError, RuntimeError, OSError, KeyError):
        rng.choice(choices)()
        for key, value in attributes.items():
            file[name].attrs[key] = value


FOREIGN = ("secret/x.toml", "/dev/zero", "secret/fifo")
NAMING: list[dict[str, Any]] = [{"laws": {"Evil": {"law": "evil.py:Evil"}}}]  # what a config names
NAMING += [{key: name} for key in ("hardware", "robot", "start") for name in FOREIGN]
NAMING += [{"hardware": {"profile": name}} for name in FOREIGN] + [{"reference": {"file": name}} for name in FOREIGN]


def text(file: h5py.File, rng: random.Random) -> None:
    """Another URDF or config: broken, with foreign meshes, or naming a law to run."""
    if rng.random() < 0.5 and "config" in file:
        config = json.loads(file["config"].asstr()[()])
        config = disturbed(config, rng) if rng.random() < 0.7 else config | rng.choice(NAMING)
        new = json.dumps(config)
        del file["config"]
        file["config"] = new
        return
    urdf = file["urdf"].asstr()[()].encode()
    mesh = rng.choice(
        (f"{os.getcwd()}/secret/x.stl", "file://../secret/x.stl", "package://secret/x.stl", "../secret/x.stl")
    )
    for _ in range(rng.choice((1, 2))):
        urdf = rng.choice(fuzz_urdf.MUTATIONS)(urdf, rng)
    if rng.random() < 0.3:
        urdf = urdf.replace(b"<geometry>", f'<geometry><mesh filename="{mesh}"/></geometry><geometry>'.encode())
    del file["urdf"]
    with contextlib.suppress(ValueError):
        file["urdf"] = urdf.decode(errors="replace")
    if rng.random() < 0.5:
        file.attrs["urdf_file"] = f"{os.getcwd()}/secret/x.urdf"
        file.attrs["overrides"] = "json:" + json.dumps({"package_dirs": ["/"]})


def law(file: h5py.File, rng: random.Random) -> None:
    """A controller of a file that is not to be run."""
    file.attrs["controller"] = "Evil"
    file.attrs["law"] = "json:" + json.dumps({"class": "evil.Evil", "file": "evil.py", "sha256": "0"})
    file.attrs["controller_settings"] = 'json:{"feedback": {"base": 500.0, "arm": 80.0}, "learning": true}'


STRUCTURE = [*4 * [fact], *2 * [numbers], *2 * [another], *2 * [elsewhere], *2 * [text], law]


def structure(name: str) -> Mutation:
    """A mutation of the structure of a recording in a folder."""

    def mutate(folder: Path, rng: random.Random) -> None:
        with (
            contextlib.suppress(Exception),
            h5py.File(folder / name, "r+") as file,
        ):  # a second one of what the first broke
            for _ in range(rng.choice((1, 1, 1, 2, 3))):
                rng.choice(STRUCTURE)(file, rng)

    return mutate


def folder_of_runs(folder: Path, rng: random.Random) -> None:
    """A sound recording and a broken one in a folder."""
    (folder / "runs").mkdir()
    for name in ("a", "b"):
        shutil.copy(folder / "run.h5", folder / "runs" / f"{name}.h5")
    rng.choice([structure("runs/b.h5"), raw("runs/b.h5")])(folder, rng)


# -- robots and their meshes -------------------------------------------------------------------------------------------

HEADS = [
    '<!DOCTYPE robot [<!ENTITY a "{e}">]>',
    '<!DOCTYPE robot [<!ENTITY a SYSTEM "file://{here}/secret/x.stl">]>',
    '<!DOCTYPE robot SYSTEM "{here}/secret/x.dtd">',
    '<!DOCTYPE robot [<!ENTITY % p SYSTEM "http://127.0.0.1:1/x"> %p;]>',
    '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "{ten_a}"><!ENTITY c "{ten_b}"><!ENTITY d "{ten_c}">]>',
    '<?xml version="1.0" encoding="UTF-16"?>',
    '<?xml-stylesheet href="{here}/secret/x.xsl"?>',
]
BODIES = [
    "&a;",
    "<a>" * 5000,
    "<xi:include xmlns:xi='http://www.w3.org/2001/XInclude' href='secret/x.stl' parse='text'/>",
    f'<gazebo a="{"1" * 100_000}"/>',
    "<!--" + "-" * 1000,
    "<![CDATA[" * 50,
]


def xml(name: str) -> Mutation:
    """A mutation of a URDF: as `fuzz_urdf`, or with entities, includes, far too deep."""

    def mutate(folder: Path, rng: random.Random) -> None:
        data = (folder / name).read_bytes()
        if rng.random() < 0.5:
            data = rng.choice(fuzz_urdf.MUTATIONS)(data, rng)
        else:
            tens = {f"ten_{letter}": f"&{letter};" * 10 for letter in "abc"}
            head = rng.choice(HEADS)
            for key, value in {"here": str(folder), "e": "x" * 50, **tens}.items():
                head = head.replace(f"{{{key}}}", value)
            body = rng.choice(BODIES)
            data = head.encode() + data.replace(b"</robot>", body.encode() + b"</robot>").replace(
                b'name="base_link"', b'name="&a;"' if rng.random() < 0.3 else b'name="base_link"'
            )
        (folder / name).write_bytes(data)

    return mutate


def texture(folder: Path, rng: random.Random) -> None:
    """A picture of any format, sound but large, short of a part, or with a size that lies."""
    from PIL import Image

    kind, size = rng.choice(("PNG", "JPEG", "BMP", "GIF", "TIFF", "TGA", "WEBP")), rng.choice((1, 64, 3000))
    data = io.BytesIO()
    Image.new("RGB", (size, size), "red").save(data, kind)
    made = bytearray(data.getvalue())
    where = {"PNG": 16, "BMP": 18, "GIF": 6, "TGA": 12, "JPEG": made.find(b"\xff\xc0") + 5, "WEBP": 26, "TIFF": 4}[kind]
    how = rng.random()
    if how < 0.4:
        made[where : where + 4] = rng.choice((bytes(4), b"\xff" * 4, b"\0\0\xff\xff", b"\x7f\xff\xff\xff"))
    elif how < 0.6:
        del made[rng.randrange(len(made)) :]
    elif how < 0.8:
        made = bytearray(fuzz_urdf.copy_bytes(bytes(made), rng))
    (folder / "meshes" / "t.png").write_bytes(made)


def inside(folder: Path, rng: random.Random) -> None:
    """Another number, name or table in the JSON of a GLB file, one with a picture."""
    file = folder / "meshes" / "m.glb"
    data, picture = file.read_bytes(), (folder / "meshes" / "t.png").read_bytes()
    end = 20 + int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20:end])
    views, image = tree["bufferViews"], rng.choice(({"bufferView": -1}, {"uri": "t.png"}, {"uri": "../secret/x.stl"}))
    views.append({"buffer": 0, "byteOffset": len(data) - end - 8, "byteLength": len(picture)})
    tree["images"] = [{"bufferView": len(views) - 1, "mimeType": "image/png"} if "bufferView" in image else image]
    tree |= {"textures": [{"source": 0}], "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}
    tree["buffers"][0]["byteLength"] += len(picture)
    tree["meshes"][0]["primitives"] *= rng.choice((1, 1, 50, 20_000))
    tree["nodes"] += [{"mesh": 0, "children": [0]}] * rng.choice((0, 0, 3, 20_000))
    for _ in range(rng.choice((0, 1, 3))):
        tree = disturbed(tree, rng)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[end + 8 :] + picture + bytes(-len(picture) % 4)
    sizes = [2, 28 + len(text) + len(rest), len(text), int.from_bytes(b"JSON", "little")]
    numbers = b"".join(one.to_bytes(4, "little") for one in sizes)
    file.write_bytes(b"glTF" + numbers + text + len(rest).to_bytes(4, "little") + b"BIN\0" + rest)


def counts(folder: Path, rng: random.Random) -> None:
    """Another count where a mesh states one, or a scene of many copies."""
    name = rng.choice(("m.stl", "m.ply", "m.dae"))
    file = folder / "meshes" / name
    data, count = file.read_bytes(), rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 10**7))
    if name == "m.stl":
        data = data[:80] + count.to_bytes(4, "little") + data[84:]
    elif name == "m.ply":
        data = re.sub(rb"(element \w+) \d+", lambda m: m[1] + b" %d" % rng.choice((count, 3)), data)
    elif rng.random() < 0.5:
        data = re.sub(rb'(count|stride|offset)="\d+"', lambda m: m[1] + b'="%d"' % rng.choice((count, 1)), data)
    else:
        url = re.findall(rb'<geometry id="([^"]+)"', data)[0]
        copies = b'<node id="q"><instance_geometry url="#%s"/></node>' % url * rng.choice((5, 20_000))
        data = data.replace(b"</visual_scene>", copies + b"</visual_scene>", 1)
        dtd = b'<!DOCTYPE COLLADA [<!ENTITY a SYSTEM "../secret/x.stl">]>' if rng.random() < 0.5 else b""
        data = (
            b"<!--<COLLADA" + b"x" * rng.choice((0, 70_000)) + b"-->" + dtd + data.partition(b"?>")[2] if dtd else data
        )
    file.write_bytes(data)


MESHES = ("m.stl", "m.obj", "m.mtl", "m.dae", "m.glb", "m.ply", "t.png")
PART = '<link name="part_{i}"><visual><geometry><mesh filename="{file}"/></geometry></visual></link>'
PART += '<joint name="part_{i}" type="fixed"><parent link="base_link"/><child link="part_{i}"/></joint>'


def mesh(folder: Path, rng: random.Random) -> None:
    """A robot, and a recording of it, with a mesh of every kind, one of them broken or exchanged for another."""
    name, how = rng.choice(MESHES), rng.random()
    if how < 0.45:
        rng.choice((texture, inside, counts))(folder, rng)
    elif how < 0.6:
        (folder / "meshes" / name).write_bytes((folder / "meshes" / rng.choice(MESHES)).read_bytes())
    else:
        (words if name in ("m.obj", "m.mtl", "m.dae") and rng.random() < 0.5 else raw)(f"meshes/{name}")(folder, rng)
    (folder / "meshes" / "m.ply").write_bytes(
        (folder / "meshes" / "m.ply").read_bytes().replace(b"element", b"comment TextureFile t.png\nelement", 1)
    )
    files = [f"{where}{one}" for one in MESHES[:6] if one != "m.mtl" for where in ("", "meshes/")]
    parts = "".join(PART.format(i=i, file=file) for i, file in enumerate(files))
    text = (folder / "robot.urdf").read_text().replace("</robot>", f"{parts}</robot>")
    (folder / "robot.urdf").write_text(text)
    with h5py.File(folder / "run.h5", "r+") as file:
        del file["urdf"]
        file["urdf"] = text


# -- databases ---------------------------------------------------------------------------------------------------------


def database(name: str) -> Mutation:
    """A mutation of a table of a database in a folder."""

    def mutate(folder: Path, rng: random.Random) -> None:
        with contextlib.suppress(sqlite3.Error), contextlib.closing(sqlite3.connect(folder / name)) as db, db:
            tables = [row[0] for row in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
            table = rng.choice(tables)
            columns = [row[1] for row in db.execute(f"PRAGMA table_info({table})")]
            rows, column = db.execute(f"SELECT * FROM {table}").fetchall(), rng.choice(columns)
            if not rows or rng.random() < 0.05:
                db.execute(
                    rng.choice((f"DROP TABLE {table}", f"DELETE FROM {table}", f"ALTER TABLE {table} ADD x TEXT"))
                )
                return
            row, at = rng.choice(rows), columns.index(column)
            value = rng.choice([*VALUES, b"\xff\x00", "9" * 5000, "[" * 5000])
            if isinstance(row[at], str) and rng.random() < 0.7:
                with contextlib.suppress(ValueError):
                    value = json.dumps(disturbed(json.loads(row[at]), rng))
            value = value if isinstance(value, str | bytes | float | int | None) else json.dumps(value)
            if isinstance(value, int) and abs(value) >= 2**63:
                value = str(value)
            db.execute(f"UPDATE {table} SET {column} = ? WHERE {columns[0]} = ?", (value, row[0]))

    return mutate


def lines(name: str) -> Mutation:
    """A mutation of a line of JSON in a file in a folder."""

    def mutate(folder: Path, rng: random.Random) -> None:
        every = (folder / name).read_text().splitlines()
        at = rng.randrange(len(every))
        every[at] = json.dumps(disturbed(json.loads(every[at]), rng))
        (folder / name).write_text("\n".join(every) + "\n" * (rng.random() < 0.9))

    return mutate


# -- what is broken, and who reads it ----------------------------------------------------------------------------------

RUN = [
    *2 * ["plot run.h5 --out out"],
    "plot run.h5 --out out/x.svg --what psi",
    "plot run.h5 --out out --what gains --what path --what torque",
    *2 * ["report run.h5 --html out/r.html --no-replay"],
    "report run.h5 --html out/r.html",
    *2 * ["replay run.h5 --html out/p.html"],
    *2 * ["export run.h5 --to csv --out out"],
    "export run.h5 --to npz --out out",
    "export run.h5 --to parquet --out out",
    *2 * ["export run.h5 --to mcap --out out"],
    *3 * ["judge run.h5"],
]
SHORTLY = "--set set.time.duration=0.004"  # a file may ask for long runs: these are no hang
HERE = f"--workers 1 --out out {SHORTLY}"
STUDY = [
    *3 * ["report db --html out/s.html"],
    *2 * ["export db --to csv --out out"],
    "export db --to parquet --out out",
    "report db/results.jsonl --html out/s.html",
    *2 * ["study short.toml --out db --workers 1"],
    "study short.toml --out db --workers 1 --force",
    "study short.toml --out db --row 1",
]
KINDS: dict[str, tuple[list[Mutation], list[str]]] = {
    "recording bytes": ([raw("run.h5")], RUN),
    "recording": ([structure("run.h5")], RUN),
    "study": ([*3 * [lines("db/results.jsonl")], raw("db/results.jsonl")], STUDY),
    "tuning": ([database("tuned/tune.sqlite"), raw("tuned/tune.sqlite")], ["tune tuning.toml --workers 1 --out tuned"]),
    "study file": (
        [*3 * [words("short.toml")], raw("short.toml")],
        [f"study short.toml {HERE}"],
    ),
    "tuning file": (
        [*3 * [words("tuning.toml")], raw("tuning.toml")],
        [f"tune tuning.toml {HERE}"],
    ),
    "experiment": ([*3 * [words("x.toml")], raw("x.toml")], ["run x.toml --out out --set time.duration=0.004"]),
    "overrides": (
        [*3 * [words("robot.mmnn.toml")], raw("robot.mmnn.toml")],
        ["inspect robot.urdf"],
    ),
    "state": ([json_file("state.json"), raw("state.json")], ["model platform_arm --at state.json"]),
    "controllers": ([words("c.yaml"), raw("c.yaml")], ["inspect robot.urdf --controllers c.yaml"]),
    "run folder": (
        [folder_of_runs],
        ["plot runs --out out", "report runs --html out/r.html --no-replay", "export runs --to csv --out out"],
    ),
    "robot": ([xml("robot.urdf")], ["inspect robot.urdf", "model robot.urdf"]),
    "mesh": (
        [mesh],
        ["inspect robot.urdf", "replay run.h5 --html out/p.html --package-dir meshes", "prove run.h5"],
    ),
    "log": (
        [*3 * [words("log.csv")], raw("log.csv"), raw("log.mcap"), structure("run.h5"), words("columns.toml")],
        [
            *2 * ["identify log.csv --robot two_axis_arm --out out --columns columns.toml"],
            "identify log.mcap --robot platform_arm --out out",
            "identify run.h5 --robot platform_arm --out out",
            "identify log.csv --robot two_axis_arm --payload",
        ],
    ),
    "hardware": (
        [*4 * [words("armed.hardware.toml")], raw("armed.hardware.toml")],
        [
            *3 * ["run track --robot armed.urdf --controller pd --set time.duration=0.02 --out out"],
            "run track --robot platform_arm --hardware armed.hardware.toml --controller adaptive "
            "--set time.duration=0.02 --out out",
            "embed track --robot armed.urdf --controller pd --no-check --steps 3 --out out",
        ],
    ),
    "steered": (
        [*2 * [xml("steered.urdf")], xml("trailing.urdf")],
        [
            command.format(name)
            for name in ("steered", "trailing")
            for command in (
                "inspect {}.urdf",
                "model {}.urdf",
                "check {}.urdf --samples 2",
                "run track --robot {}.urdf --controller pd --set time.duration=0.02 --out out",
            )
        ],
    ),
    "planned": (
        [*2 * [words("path.csv")], raw("path.csv"), cells("path.csv"), cells("points.csv"), words("points.csv")],
        [
            f"run track --robot platform_arm --controller pd --set reference.file={file} --set time.duration=0.02 "
            "--out out"
            for file in ("path.csv", "points.csv")
        ],
    ),
    "identified": (
        [json_file("identified/two_axis_arm.identified.json"), raw("identified/two_axis_arm.identified.json")],
        ["report identified --html out/i.html"],
    ),
}


class Hang(BaseException):
    """A command took too long."""


def stop(*_: Any) -> None:
    raise Hang


READ: list[str] = []  # what Python opened
CHANGED: list[str] = []  # what it wrote, made, moved or removed
CHANGES = {
    "os.mkdir": 1,
    "os.rename": 2,
    "os.remove": 1,
    "os.rmdir": 1,
    "os.link": 2,
    "os.symlink": 2,
    "os.truncate": 1,
}


def watch() -> None:
    """Note what Python opens and changes from now on."""

    def hook(event: str, given: tuple[Any, ...]) -> None:
        if event == "open" and isinstance(given[0], str | bytes):
            name, flags = os.path.abspath(os.fsdecode(given[0])), given[2] if isinstance(given[2], int) else 0
            writes = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) and not os.path.isdir(name)  # a file without a name
            (CHANGED if writes else READ).append(name)
        elif event in CHANGES:
            names = [
                os.path.abspath(os.fsdecode(n)) for n in given[: CHANGES[event]] if isinstance(n, str | bytes | Path)
            ]
            CHANGED.extend(name for name in names if event != "os.mkdir" or not os.path.isdir(name))
        elif (
            event in ("os.system", "os.exec", "os.posix_spawn", "subprocess.Popen") and given[0] != "git"
        ):  # its commit
            CHANGED.append(f"the program {given[0]}")

    sys.addaudithook(hook)


def outside(folder: Path) -> list[str]:
    """What was changed elsewhere than in the folders for output and for passing files of this process."""
    passing_beside = (str(folder / f".{name}.") for name in OUTPUT)  # until they are complete
    allowed = (
        *(str(folder / name) for name in OUTPUT),
        *passing_beside,
        os.devnull,
        "/dev/shm",
        "/proc/self",
        str(cache_root()),
    )
    passing = re.compile(rf"{re.escape(tempfile.gettempdir())}/(tmp|\.|mmnn|matplotlib-)[^/]*(/|$)")
    found = (name for name in CHANGED if not name.startswith(allowed))
    return [name for name in found if name.startswith(str(folder)) or not passing.match(name)]


def listed(folder: Path) -> dict[str, int]:
    """Files of a folder with their times, those for output left out."""
    return {str(f): f.lstat().st_mtime_ns for f in folder.rglob("*") if f.relative_to(folder).parts[0] not in OUTPUT}


@contextlib.contextmanager
def limits() -> Iterator[None]:
    """So much processor time and so much more memory for a command."""
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    old = resource.getrlimit(resource.RLIMIT_AS)
    signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    faulthandler.dump_traceback_later(WAITING, exit=True, file=sys.__stderr__)  # seen as a crash
    resource.setrlimit(resource.RLIMIT_AS, (size + MEMORY, old[1]))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        faulthandler.cancel_dump_traceback_later()
        resource.setrlimit(resource.RLIMIT_AS, old)


def verdict(command: list[str], folder: Path) -> str:
    """`done`, `failed`, `refused`, or what went wrong."""
    from mmnn_pin.cli import main

    before, output, errors = listed(folder), io.StringIO(), io.StringIO()
    READ.clear()
    CHANGED.clear()
    try:
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors), limits():
            code = main(command)
    except Hang:
        return "at work" if AT_WORK.search(errors.getvalue()) else f"more than {SECONDS} s"
    except BaseException as error:
        return f"it raised {type(error).__name__}: {error}"
    told, beyond = errors.getvalue(), outside(folder)
    wrong: dict[str, Any] = {
        "internal error": "internal error" in told,
        "more than 1 GB": re.search(r"not enough memory|[Uu]nable to allocate|[Cc]annot allocate|MemoryError", told),
        f"exit code {code}": code not in (0, 1, 2),
        "an error without words": code == 2 and "error: " not in told,
        "a traceback": "Traceback" in told,
        "a program of the file was run": (folder / "ran").exists(),
        # The robot's own file is compared with what the recording has of it: SECURITY.md.
        "a secret was read": any("/secret/" in name and not name.endswith("/x.urdf") for name in READ),
        f"written outside: {beyond[:3]}": beyond or listed(folder) != before,
    }
    if "--json" in command:
        try:
            wrong["no object"] = not isinstance(json.loads(output.getvalue()), dict)
        except ValueError:
            wrong[f"not one JSON object: {output.getvalue()[:80]!r}"] = True
    found = [what for what, is_so in wrong.items() if is_so]
    return f"{', '.join(found)}: {told[-300:]}" if found else ("done", "failed", "refused")[code]


def mutant(sources: Path, folder: Path, kind: str, seed: int, cheap: bool) -> list[str]:
    """A folder of files, one of them broken, and the command to try on it; `cheap` leaves the drawing out."""
    rng = random.Random(f"{kind} {seed}")
    mutations, commands = KINDS[kind]
    shutil.copytree(sources, folder)
    runs = sorted(folder.glob("run*.h5"))
    chosen = rng.choice(runs)
    os.replace(chosen, folder / "run.h5")
    for other in runs:
        other.unlink(missing_ok=True) if other.name != "run.h5" else None
    (folder / "evil.py").write_text(EVIL)
    (folder / "secret").mkdir()
    (folder / "secret" / "x.stl").write_bytes(SECRET)
    (folder / "secret" / "raw.bin").write_bytes(bytes(24))
    (folder / "secret" / "x.toml").write_text("rate = 100.0\n")
    os.mkfifo(folder / "secret" / "fifo")
    os.chdir(folder)
    rng.choice(mutations)(folder, rng)
    commands = [one for one in commands if not (cheap and one.startswith(DRAWING))] or commands[:1]
    return [*rng.choice(commands).split(), *(["--json"] if rng.random() < 0.5 else [])]


def work_through(sources: Path, kinds: list[str], first: int, last: int, cheap: bool, twice: bool = False) -> None:
    """Try the mutants of some seeds, one line each on standard output; `twice` lets the command compile before."""
    import mmnn_pin.cli.output
    import mmnn_pin.lab.show.report

    assert mmnn_pin.lab.show.report  # slow imports are nobody's fault
    mmnn_pin.cli.output.EVERY = SECONDS / 4  # between two lines of progress
    watch()
    out = os.fdopen(os.dup(1), "w")
    with tempfile.TemporaryDirectory() as scratch:
        for seed in range(first, last):
            folder, kind = Path(scratch) / "here", kinds[seed % len(kinds)]
            command = mutant(sources, folder, kind, seed, cheap)
            if twice:
                with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                    mmnn_pin.cli.main(command)
                os.chdir("/")
                shutil.rmtree(folder)
                mutant(sources, folder, kind, seed, cheap)
            print(seed, kind.replace(" ", "_"), end=" ", file=out, flush=True)
            begun = time.process_time()
            said = verdict(command, folder)
            said = said if said in GOOD else f"`{' '.join(command)}`: {said}"
            print(f"{time.process_time() - begun:.2f}", said.replace("\n", " "), file=out, flush=True)
            os.chdir("/")
            shutil.rmtree(folder)


def slow_without_compiling(line: str) -> bool:
    """Whether a verdict tells of too much time."""
    return f": more than {SECONDS} s" in line


def worked(
    sources: Path, kinds: list[str], first: int, last: int, cheap: bool, twice: bool = False
) -> tuple[list[list[str]], str]:
    """The lines of a process that works some seeds through; and how it ended.

    A line is a number, a kind, processor seconds and a verdict; of a crash the first two.
    """
    command = [sys.executable, __file__, "--sources", str(sources), "--work", str(first), str(last)]
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "MPLBACKEND": "agg"}
    environment |= {"NUMBA_DISABLE_JIT": str(int(not twice))}
    done = subprocess.run(
        [*command, *["--cheap"] * cheap, *["--twice"] * twice, "--kinds", *kinds],
        capture_output=True,
        text=True,
        timeout=60 * (last - first) + 600,
        env=environment,
    )
    lines = [line.split(" ", 3) for line in done.stdout.splitlines()]
    if not lines:
        raise RuntimeError(done.stderr)
    return lines, f"crash, exit code {done.returncode}: {done.stderr[-300:]}"


def fuzz(
    sources: Path,
    files: int,
    seed: int = 0,
    batch: int = 100,
    kinds: list[str] | None = None,
    cheap: bool = False,
    watched: bool = False,
) -> tuple[dict[str, collections.Counter[str]], list[str], dict[str, float]]:
    """Try many mutants in subprocesses; `watched` tells of every batch, and Ctrl-C ends it with what is done.

    Returns:
        Per kind how often each verdict came; every line that tells of something wrong; processor seconds per kind.
    """
    kinds = kinds or list(KINDS)
    counts: dict[str, collections.Counter[str]] = collections.defaultdict(collections.Counter)
    wrong: list[str] = []
    spent: dict[str, float] = collections.defaultdict(float)
    try:
        for start in range(seed, seed + files, batch):
            first, last = start, min(start + batch, seed + files)
            while first < last:
                lines, end = worked(sources, kinds, first, last, cheap)
                for number, kind, *told in lines:
                    seconds, said = told if len(told) == 2 else ("0", "")
                    if slow_without_compiling(said):
                        again = worked(sources, kinds, int(number), int(number) + 1, cheap, twice=True)[0][-1]
                        said = again[3] if len(again) == 4 else ""
                    counts[kind][said if said in GOOD else "wrong"] += 1
                    spent[kind] += float(seconds)
                    wrong += [] if said in GOOD else [f"seed {number}, {kind}: {said or end}"]
                first = int(lines[-1][0]) + 1  # after a crash: go on behind it
            if watched:
                done = sum(map(collections.Counter.total, counts.values()))
                print(f"{done:,} files, {sum(spent.values()):.0f} s, {len(wrong)} wrong", *wrong[-1:], file=sys.stderr)
    except KeyboardInterrupt:
        if not watched:
            raise
    return dict(counts), wrong, dict(spent)


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--batch", type=int, default=100)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS))
    parser.add_argument("--sources", type=Path)
    parser.add_argument("--cheap", action="store_true", help="Without the commands that take seconds each.")
    parser.add_argument("--twice", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--work", type=int, nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.work:
        work_through(given.sources, given.kinds, *given.work, given.cheap, given.twice)
        return 0
    with tempfile.TemporaryDirectory() as scratch:
        sources = given.sources or sound_files(Path(scratch) / "sources")
        counts, wrong, spent = fuzz(sources, given.files, given.seed, given.batch, given.kinds, given.cheap, True)
    for kind, found in counts.items():
        print(f"{kind}: {sum(found.values()):,} files, {spent[kind]:.0f} s of processor time, {dict(found)}")
    print(f"{sum(map(collections.Counter.total, counts.values())):,} files, {sum(spent.values()):.0f} s")
    print(*wrong, sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    from sound_files import sound_files

    sys.exit(main())
