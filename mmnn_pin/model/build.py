"""The Pinocchio model of a URDF.

What Pinocchio's parser prints on standard error is captured and attached to the error; nothing is locked away and
mimic joints are joints of their own.
"""

from __future__ import annotations

import copy
import math
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pinocchio as pin
from lxml import etree

from mmnn_pin.errors import RobotError

from .urdf.document import Document

_stderr_lock = threading.Lock()


def welded(document: Document) -> tuple[Document, tuple[str, ...]]:
    """The robot with its planar and floating joints welded, and their names.

    A file made for a simulator stands its robot in the world on such a joint; here the loader does that.
    """
    names = tuple(joint.name for joint in document.joints.values() if joint.type in ("planar", "floating"))
    if not names:
        return document, ()
    root = copy.deepcopy(document.root)
    for element in root.iterchildren("joint"):
        if element.get("name") in names:
            element.set("type", "fixed")
    return replace(document, root=root, text=etree.tostring(root, encoding="unicode")), names


def pinocchio_model(document: Document, mobile: bool) -> tuple[pin.Model, str]:
    """Full Pinocchio model, on a planar root joint for a mobile base, and what its parser printed.

    Raises:
        RobotError: Pinocchio refuses the file, or loses a mass of it; what it printed is attached.
    """
    root_name = "root_joint"
    while root_name in document.joints:
        root_name += "_"
    root = (pin.JointModelPlanar(), root_name) if mobile else ()
    try:
        with captured_stderr() as printed:
            model = pin.buildModelFromXML(document.text, *root)
    except (ValueError, RuntimeError) as error:
        why = " ".join(" ".join([*printed, str(error)]).split())
        raise RobotError("Pinocchio cannot build the model", why=why, file=document.path) from None
    model.name, told = document.path.stem, " ".join(" ".join(printed).split())
    stated, taken = document.mass, sum(body.mass for body in model.inertias)
    if not math.isclose(stated, taken, rel_tol=1e-9):
        what = f"Pinocchio's model has {taken:.6g} kg where the file states {stated:.6g} kg"
        raise RobotError(what, why=told or "it lost an <inertial>", file=document.path)
    return model, told


@contextmanager
def captured_stderr() -> Iterator[list[str]]:
    """What C++ code prints on standard error meanwhile; the list is filled on leaving."""
    lines: list[str] = []
    with _stderr_lock, tempfile.TemporaryFile() as file:
        sys.stderr.flush()
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            lines += file.read().decode(errors="replace").splitlines()
