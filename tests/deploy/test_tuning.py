"""What a board may change: the same bits as the stepper with the same numbers, saved and loaded, or refused."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from deploy.boards import STRICT
from deploy.fuzzing import loop_of
from hypothesis import given, settings
from hypothesis import strategies as st

from mmnn_pin import Stepper
from mmnn_pin.deploy.embed.export import embed
from mmnn_pin.deploy.embed.golden import as_measured
from mmnn_pin.deploy.embed.tunables import ROOM
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.wishes import BaseVelocity, JointSample
from mmnn_pin.signals import Measurement, Setpoint

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc: apt-get install gcc")
STEPS = 60


class Library:
    """An exported controller as a library: its structs as arrays of doubles."""

    def __init__(self, folder, controller):
        self.loop = loop_of("platform_arm", controller)
        self.made = embed(self.loop, folder / "c", steps=5, compiler=None)
        sources = [folder / "c" / f"{name}.c" for name in ("controller", "tuning", "robot_law", "mmnn_math")]
        sources.append(folder / "row.c")
        declared = "double *row_of(mmnn_controller *c)"
        sources[-1].write_text(f'#include "c/controller.h"\n{declared};\n{declared} {{ return c->row; }}\n')
        subprocess.run(["gcc", *STRICT, "-O1", "-shared", "-fPIC", *sources, "-o", folder / "lib.so"], check=True)
        self.c = ctypes.CDLL(str(folder / "lib.so"))
        self.c.mmnn_motor_torque.restype = self.c.row_of.restype = ctypes.POINTER(ctypes.c_double)
        self.c.mmnn_step.argtypes = [
            ctypes.c_void_p,
            ctypes.c_double,
            ctypes.c_void_p,
            ctypes.c_double,
            ctypes.c_void_p,
        ]
        for name in ("set_gains", "set_limits", "set_payload"):
            if hasattr(self.c, f"mmnn_{name}"):
                getattr(self.c, f"mmnn_{name}").restype = ctypes.c_bool

    def new(self):
        """A controller before its first sample."""
        memory = ctypes.create_string_buffer(self.made.ram_bytes)
        self.c.mmnn_init(memory)
        return memory

    def got(self, memory, name, size):
        """A struct as it is."""
        numbers = (ctypes.c_double * size)()
        getattr(self.c, f"mmnn_get_{name}")(memory, numbers)
        return np.array(numbers)

    def put(self, memory, name, numbers):
        """Set a struct; whether it was taken."""
        return getattr(self.c, f"mmnn_set_{name}")(memory, (ctypes.c_double * len(numbers))(*numbers))

    def torques(self, memory, steps=range(STEPS), stepper=None):
        """Torques of samples of the loop's trajectory with an error, of a stepper beside too where there is one."""
        d, found = self.loop.robot.dimensions, []
        table = self.loop.trajectory.table(np.arange(steps.stop) * 0.001, d)
        for k in steps:
            asked, time = table[k], 0.001 * k
            read = np.ascontiguousarray(as_measured(asked, self.loop.robot) + 0.01 * np.sin(k + np.arange(9.0)))
            wanted = (ctypes.c_double * (len(asked) + 1))(0.0, *asked)
            ctypes.cast(wanted, ctypes.POINTER(ctypes.c_int))[0] = 5 if k % 2 else 1
            assert self.c.mmnn_step(memory, time, read.ctypes.data, time, ctypes.byref(wanted)) == 0
            found.append(self.c.mmnn_motor_torque(memory)[:4])
            if stepper is not None:
                sample = Setpoint.side_by_side(asked, d)
                both = BaseVelocity(sample.velocity), JointSample(sample.q, sample.qdot, sample.qddot)
                stepper.step(time, Measurement(*np.split(read, (3, 5, 7))), both if k % 2 else sample)
                assert np.array(found[-1]).tobytes() == stepper.motor_torque.tobytes(), k
        return np.array(found)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Exported controllers by name."""
    made = {}

    def make(controller):
        if controller not in made:
            made[controller] = Library(tmp_path_factory.mktemp("tuning"), controller)
        return made[controller]

    return make


def stepper_of(library):
    """The stepper of a library's loop, that makes references as the export does."""
    return Stepper.of(library.loop, limits=Limits())


def saved_bytes(library):
    """Size of a saved state."""
    return int(Path(library.made.folder, "controller.h").read_text().split("MMNN_SAVED_BYTES ")[1].split()[0])


def test_gains_in_c_are_those_of_python_bit_for_bit(library):
    """By `Stepper.change` those of the kinematic layer, the feedback in the numbers of the law."""
    c, gains = library("pd"), np.array([2.0, 12.0, 6.0, 5.0, 4.0, 3000.0, 200.0, 25.0, 2.0])
    memory, stepper = c.new(), stepper_of(c)
    before = c.torques(memory, range(20), stepper)
    assert c.put(memory, "gains", gains) and (c.got(memory, "gains", 9) == gains).all()
    stepper.change(kinematic=Kinematic(kx=2.0, ky=12.0, kth=6.0, K=(5.0, 4.0)))
    stepper.control.controls.law.settings[-4:] = gains[5:]
    after = c.torques(memory, range(20, STEPS), stepper)
    assert np.abs(after).max() > 1.0 and np.abs(after[0] - before[-1]).max() > 0.5


def test_limits_in_c_are_those_of_python_bit_for_bit(library):
    c = library("pd")
    memory, stepper = c.new(), stepper_of(c)
    c.torques(memory, range(10), stepper)
    limits = c.got(memory, "limits", 12)
    limits[4:] = 0.2, 0.4, 0.5, 0.6, 0.3, 0.3, 2.0, 2.0
    assert c.put(memory, "limits", limits)
    stepper.change(limits=Limits(speed=0.2, yaw_rate=0.4, joint_speed=(0.3, 0.3)))
    for row, numbers in ((stepper.follower.guide.base[1], (0.5, 0.6)), (stepper.follower.guide.arm[1], (2.0, 2.0))):
        row[:] = numbers
    c.torques(memory, range(10, STEPS), stepper)
    limits[:4] = 1.0, 1.0, 2.0, 2.0
    assert c.put(memory, "limits", limits)
    assert np.abs(c.torques(memory, range(STEPS, STEPS + 20))[-1]).max() <= 2.0


@settings(max_examples=30)
@given(st.integers(0, 8), st.sampled_from([-1.0, np.nan, np.inf, 1.0001 * ROOM[0]]))
def test_a_gain_out_of_its_bounds_is_refused_and_nothing_changes(library, place, by):
    c = library("pd")
    memory, gains = c.new(), c.got(c.new(), "gains", 9)
    gains[place] *= by
    before = bytes(memory)
    assert not c.put(memory, "gains", gains) and bytes(memory) == before


def test_what_is_got_can_be_set_and_changes_nothing(library):
    c = library("two_layer")
    memory = c.new()
    before = bytes(memory)
    for name, size in (("gains", 9), ("limits", 12)):
        assert c.put(memory, name, c.got(memory, name, size))
    assert bytes(memory) == before
    limits = c.got(memory, "limits", 12)
    assert not c.put(memory, "limits", 1.001 * limits) and bytes(memory) == before


def test_a_payload_is_the_one_of_pinocchio(library):
    """Psi_hat of `computed_torque` at rest, with it and without, against Pinocchio's mass matrices and gravity."""
    c = library("computed_torque")
    robot, memory, other = c.loop.robot, c.new(), c.new()
    payload = np.array([2.5, 0.3, 0.05, -0.1, 0.04, 0.002, -0.001, 0.05, 0.003, 0.03])
    assert c.put(memory, "payload", payload)
    q, wanted = np.array([0.4, -0.7]), (ctypes.c_double * 14)(0.0, *np.zeros(7), 0.41, -0.69, 0.1, 0.2, 1.5, -2.5)
    ctypes.cast(wanted, ctypes.POINTER(ctypes.c_int))[0] = 1
    read, found = np.concatenate((np.zeros(5), q, np.zeros(2))), []
    layout = stepper_of(c).setup.layout
    for one in (memory, other):
        for k in range(2):
            assert c.c.mmnn_step(one, 0.001 * k, read.ctypes.data, 0.001 * k, ctypes.byref(wanted)) == 0
        row = np.array(c.c.row_of(one)[: layout.width])
        found.append((row[layout.where("psi_hat")], row[layout.where("nudot_ref")]))
    model, loaded = robot.model, pin.Model(robot.model)
    joint, (xx, xy, xz, yy, yz, zz) = model.getJointId("arm_2_joint"), payload[4:]
    J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    loaded.inertias[joint] = loaded.inertias[joint] + pin.Inertia(payload[0], payload[1:4], J)
    place, T, more = pin.neutral(model), robot.template, []
    for i, name in enumerate(robot.joint_names):
        place[model.joints[model.getJointId(name)].idx_q] = q[i]
    for one in (loaded, model):
        data = one.createData()
        M = pin.crba(one, data, place)
        M = np.triu(M) + np.triu(M, 1).T
        more.append(T.T @ (M @ T @ found[0][1] + pin.computeGeneralizedGravity(one, data, place)))
    assert np.array_equal(found[0][1], found[1][1]) and np.abs(found[0][1][2:]).min() > 0.5
    np.testing.assert_allclose(found[0][0] - found[1][0], more[0] - more[1], rtol=1e-9, atol=1e-9)
    assert np.abs(more[0] - more[1]).max() > 0.5
    for place, wrong in ((0, -1.0), (0, np.nan), (2, np.inf), (4, 1.0)):  # no body has the last inertia
        bad = payload.copy()
        bad[place] = wrong
        before = bytes(other)
        assert not c.put(other, "payload", bad) and bytes(other) == before
    empty = c.new()
    assert c.put(empty, "payload", payload) and c.c.mmnn_set_payload(empty, None) and bytes(empty) == bytes(c.new())


def test_what_was_learned_is_saved_and_goes_on(library):
    c = library("two_layer")
    memory, fresh = c.new(), c.new()
    c.torques(memory)
    size = saved_bytes(c)
    saved = ctypes.create_string_buffer(size)
    assert c.c.mmnn_save(memory, saved, size - 1) == 0 and c.c.mmnn_save(memory, saved, size) == size
    data = bytes(saved)
    assert data[:4] == b"MMNN" and int.from_bytes(data[4:8], "little") == 1
    assert int.from_bytes(data[20:24], "little") == zlib.crc32(data[:20] + data[24:])
    learned = np.frombuffer(data[24:], "<f8")
    V2, again = learned[-484:].tobytes(), ctypes.create_string_buffer(size)  # the arm's, the last member
    assert np.isfinite(learned).all() and V2 in bytes(memory) and V2 not in bytes(fresh)
    assert c.c.mmnn_load(fresh, saved, size) == 0 and V2 in bytes(fresh)
    assert c.c.mmnn_save(fresh, again, size) == size and bytes(again) == data
    other = library("computed_torque")
    assert not hasattr(other.c, "mmnn_save")


@settings(max_examples=40)
@given(st.data())
def test_a_damaged_save_is_refused_and_nothing_changes(library, data):
    c = library("two_layer")
    size = saved_bytes(c)
    saved, memory = ctypes.create_string_buffer(size), c.new()
    assert c.c.mmnn_save(memory, saved, size) == size
    place, bit = data.draw(st.integers(0, size - 1)), data.draw(st.integers(0, 7))
    saved[place] = bytes([saved.raw[place] ^ (1 << bit)])
    before = bytes(memory)
    assert c.c.mmnn_load(memory, saved, size) == 3 and bytes(memory) == before
    assert c.c.mmnn_load(memory, saved, size - 8) == 3


@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++: apt-get install g++")
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
@pytest.mark.parametrize("controller", ["two_layer", "computed_torque"])
def test_it_builds_as_cpp_without_a_warning(library, compiler, controller, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    folder = library(controller).made.folder
    flags = ["-x", "c++", "-std=c++17", *STRICT[1:], "-Wno-unused-function", f"-I{folder}", "-fsyntax-only"]
    for name in ("controller", "tuning", "robot_law", "mmnn_math", "in_the_loop/link"):
        subprocess.run([compiler, *flags, f"{folder}/{name}.c"], check=True)


def test_every_file_says_licence_version_commit_and_settings(library):
    folder = library("pd").made.folder
    heads = set()
    for name in library("pd").made.files:
        first = Path(folder, name).read_text().splitlines()[:3]
        assert any("SPDX-License-Identifier: Apache-2.0" in line for line in first), name
        heads |= {line.strip("/*<!-# >") for line in first if "Written by" in line}
    (head,) = heads
    settings_hash = head.split("settings ")[1].strip(". ")
    assert len(settings_hash) == 16 and f'MMNN_SETTINGS "{settings_hash}"' in Path(folder, "controller.h").read_text()
