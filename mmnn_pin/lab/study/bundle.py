"""A robot's files as one piece that travels: the URDF, its meshes, and what is said about it.

On the other side the meshes lie beside the URDF under names of their own, so that no folder of the first machine needs
to exist there.
"""

from __future__ import annotations

import atexit
import copy
import hashlib
import shutil
import tempfile
import threading
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path

import msgspec
from lxml import etree

from ...model.base.overrides import Overrides, folders_of, with_file
from ...model.loading import load_with
from ...model.robot import Robot
from ...model.robots import find
from ...model.urdf.reading import read
from ...model.urdf.shapes import locate

_unpacking = threading.Lock()
_folders: dict[str, Path] = {}


@dataclass(frozen=True)
class Bundle:
    """The files of a robot.

    Attributes:
        urdf: File name of the URDF among the files.
        files: Relative name to content.
        said: What is said about the robot, in the call and in the file beside its URDF; it names no folders.
    """

    urdf: str
    files: dict[str, bytes] = field(repr=False)
    said: Overrides

    @classmethod
    def of(cls, robot: str, said: Overrides) -> Bundle:
        """Files of a robot that loads; a mesh that is not there stays away.

        Raises:
            InputError: As `load`.
        """
        path = find(robot)
        said, _ = with_file(path, said)
        folders = folders_of(path, said)
        root = copy.deepcopy(read(path, said.strict, folders).root)
        files: dict[str, bytes] = {}
        places: dict[str, str] = {}
        for element in root.iterfind("link/*/geometry/mesh"):
            name = element.get("filename", "")
            if name not in places:
                mesh = locate(name, path, folders).file
                places[name] = name if mesh is None else f"meshes/{len(files)}{mesh.suffix.lower()}"
                if mesh is not None:
                    files[places[name]] = mesh.read_bytes()
            element.set("filename", places[name])
        files[path.name] = etree.tostring(root, encoding="utf-8", xml_declaration=True)
        return cls(path.name, files, msgspec.structs.replace(said, package_dirs=()))

    @cached_property
    def digest(self) -> str:
        """Hash of all of it."""
        found = hashlib.sha256(msgspec.json.encode(self.said))
        for name, content in sorted(self.files.items()):
            found.update(f"\0{name}\0{len(content)}\0".encode() + content)
        return found.hexdigest()

    @property
    def size(self) -> int:
        """Bytes of its files."""
        return sum(map(len, self.files.values()))

    def load(self) -> Robot:
        """The robot, loaded from a temporary folder of this process, once."""
        with _unpacking:
            if self.digest not in _folders:
                folder = Path(tempfile.mkdtemp(prefix="mmnn_pin-"))
                atexit.register(shutil.rmtree, folder, ignore_errors=True)
                for name, content in self.files.items():
                    (folder / name).parent.mkdir(exist_ok=True)
                    (folder / name).write_bytes(content)
                _folders[self.digest] = folder
        return load_once(str(_folders[self.digest] / self.urdf), self.said)


@lru_cache(maxsize=16)
def load_once(robot: str, said: Overrides) -> Robot:
    """`load_with`, remembered: a study makes thousands of robots from one file."""
    return load_with(robot, said)
