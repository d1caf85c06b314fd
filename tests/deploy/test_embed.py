"""The exported C: the bits of the stepper on this machine, readable, refused where it cannot be."""

from __future__ import annotations

import ast
import ctypes
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from functools import cache
from io import StringIO

import numpy as np
import pytest
from builders import first_of
from deploy.boards import STRICT, on_target, require
from deploy.fuzzing import loop_of, write_fuzzed
from drives import Drive
from hypothesis import example, given
from hypothesis import strategies as st
from lxml import etree
from places import ROOT

from mmnn_pin import Recording, Stepper, load_experiment
from mmnn_pin.cli import main
from mmnn_pin.compliance import Impedance
from mmnn_pin.deploy.embed.board import Fresh
from mmnn_pin.deploy.embed.body import write
from mmnn_pin.deploy.embed.export import embed, found_compiler, supervised
from mmnn_pin.deploy.embed.files import files_of, plain, quoted, translated
from mmnn_pin.deploy.embed.golden import as_measured
from mmnn_pin.deploy.embed.in_the_loop import HOST, Linked, build
from mmnn_pin.deploy.embed.instructions import Count, require_time
from mmnn_pin.deploy.embed.program import CProgram
from mmnn_pin.deploy.embed.source import Untranslatable
from mmnn_pin.deploy.embed.values import Number
from mmnn_pin.elementary import angles, exponentials, two_doubles
from mmnn_pin.errors import ConfigError
from mmnn_pin.kinematic import Kinematic
from mmnn_pin.reference.limits import Limits
from mmnn_pin.reference.wishes import HOLD, BaseVelocity
from mmnn_pin.safety import Safety
from mmnn_pin.signals import Measurement, Setpoint
from mmnn_pin.touch import Touch

STEPS = 80
HAS_GCC = shutil.which("gcc") is not None
needs_gcc = pytest.mark.skipif(not HAS_GCC, reason="no gcc: apt-get install gcc")
# The plain Python of the blocks gives the bits of the compiled code, and nothing has to be compiled for it.
PLAIN = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}


def embedded(folder, controller, *more, experiment="track"):
    """The JSON of `mmnn embed` in a process without numba."""
    start = [sys.executable, "-c", "from mmnn_pin.cli import main; raise SystemExit(main())", "embed", experiment]
    command = [*start, "--controller", controller, "--out", str(folder), "--json"]
    done = subprocess.run([*command, *more], env=PLAIN, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The folder of a controller's export, made once."""

    @cache
    def make(controller, steps=STEPS, *more):
        folder = tmp_path_factory.mktemp("embed") / controller
        more += ("--plant", "host", "--cc", "gcc") if controller == "two_layer" and HAS_GCC else ()
        return folder, embedded(folder, controller, "--steps", str(steps), *more)

    return make


# -- the same bits -----------------------------------------------------------------------------------------------------


@needs_gcc
@pytest.mark.parametrize(
    "controller",
    first_of(
        (
            "computed_torque",
            "two_layer",
            "adaptive_composite",
            "kalman_friction",
            "feedforward",
            "time_delay",
            "extended_state",
            "l1_adaptive",
            "super_twisting",
        ),
        *("two_layer", "feedforward", "adaptive_composite", "kalman_friction"),
    ),
)
def test_the_self_test_has_the_bits_of_the_stepper(exported, controller):
    """`mmnn embed` itself compiles and runs it: torques and checksums of weights and supervisor at every sample."""
    folder, told = exported(controller)
    assert told["controller"] == controller and told["robot"] == "platform_arm" and told["selftest_steps"] == STEPS
    assert set(told["files"]) <= {str(file.relative_to(folder)) for file in folder.rglob("*")}
    assert 0 < told["ram_bytes"] < 120_000


def test_every_table_says_what_it_holds(exported):
    folder, _ = exported("adaptive_composite")
    text = (folder / "robot_law.c").read_text()
    tables = re.findall(r"(/\* .+ \*/\n)?const \w+ (law_\w+)\[", text)
    assert len(tables) > 25 and not [name for said, name in tables if not said], tables
    assert "rotation (by rows) and origin [m]" in {name: said for said, name in tables}["law_tree_numbers"]


@needs_gcc
@pytest.mark.parametrize("robot", ["car_arm", "swerve_arm"])
@pytest.mark.parametrize("controller", ["pd", "computed_torque"])
def test_a_base_that_steers_has_the_bits_of_the_stepper(tmp_path, robot, controller):
    """The first of them with a compliant hand that pushes and what feels contact."""
    changes = ["impedance.stiffness=200.0", "force.newtons=5.0", "force.start=0.01", "touch.model='urdf'"]
    gives = [part for one in changes for part in ("--set", one)] if (robot, controller) == ("car_arm", "pd") else []
    told = embedded(tmp_path / "c", controller, "--robot", robot, "--steps", str(STEPS), *gives)
    assert ("law_wish(" in (tmp_path / "c/controller.c").read_text()) == bool(gives)
    assert told["robot"] == robot and told["selftest_steps"] == STEPS
    assert "shape[" in (tmp_path / "c/controller.h").read_text()


@needs_gcc
def test_a_base_without_an_arm_has_the_bits_of_the_stepper(tmp_path):
    (tmp_path / "bare.urdf").write_text(Drive().urdf(""))
    limits = ("--set", "safety.torque=[10.0, 10.0]")
    told = embedded(tmp_path / "c", "pd", "--robot", str(tmp_path / "bare.urdf"), "--steps", str(STEPS), *limits)
    assert told["selftest_steps"] == STEPS


@needs_gcc
@pytest.mark.parametrize("contact", ["go on", "comply"])
def test_fuzzed_samples_that_feel_contact_have_the_same_bits(tmp_path, contact):
    """The observer, the law with its weights held, and what gives way or is eased back, in compiled C."""
    touch, safety = (
        Touch(bandwidth=1e3, masses=0.0, friction=0.0, torque=0.0, clear=0.01, settle=0.05),
        Safety(contact=contact),
    )
    found = write_fuzzed(loop_of("platform_arm", "pid", touch=touch, safety=safety), tmp_path, 300, 3)
    assert 20 < found.touched < 280, found
    status, said = on_target(tmp_path, "gcc")
    assert status == 0 and "300 samples, 0 differ" in said, said


@needs_gcc
@pytest.mark.parametrize("interface", ["velocity", "position"])
def test_fuzzed_samples_of_an_admittance_have_the_same_bits(tmp_path, interface):
    """A hand whose arm takes no torque at one joint moves a mass by what is felt, in compiled C."""
    touch = Touch(bandwidth=1e3, masses=0.0, friction=0.0, torque=0.0)
    servos = {"interfaces": {"arm_2_joint": interface}, "impedance": Impedance(stiffness=200.0)}
    made = loop_of("platform_arm", "pd_gravity", touch=touch, **servos)
    write_fuzzed(made, tmp_path, 300, 3)
    assert "law_admit(" in (tmp_path / "controller.c").read_text()
    status, said = on_target(tmp_path, "gcc")
    assert status == 0 and "300 samples, 0 differ" in said, said


@needs_gcc
def test_fuzzed_samples_of_a_swerve_drive_have_the_same_bits(tmp_path):
    found = write_fuzzed(loop_of("swerve_arm", "pd"), tmp_path, 300, 3)
    assert found.distinct > 100 and found.trips >= 1, found
    status, said = on_target(tmp_path, "gcc")
    assert status == 0 and "300 samples, 0 differ" in said, said


@pytest.mark.parametrize("target", ["clang", "cortex-m7"])
def test_another_compiler_and_an_emulated_board_have_the_same_bits(exported, tmp_path, target):
    require(target)
    folder, _ = exported("two_layer")
    shutil.copytree(folder, tmp_path / "c")
    status, said = on_target(tmp_path / "c", target)
    assert status == 0 and f"{STEPS} samples, 0 differ" in said


@needs_gcc
def test_fuzzed_samples_have_the_same_bits(tmp_path):
    """A part of what `test_embed_boards` does with every controller."""
    found = write_fuzzed(loop_of("platform_arm", "two_layer"), tmp_path, 600, 7)
    assert found.distinct > 300 and found.trips >= 2 and found.refused > 5, found
    status, said = on_target(tmp_path, "gcc")
    assert status == 0 and "600 samples, 0 differ" in said, said


@needs_gcc
def test_motors_that_take_a_current_or_a_duty_are_sent_it(tmp_path):
    """The C's own division beside that of the table."""
    joints = (
        '{arm_1_joint={interface="current", torque_constant=0.7}, arm_2_joint={interface="pwm", torque_constant=9}}'
    )
    more = ("--steps", "20", "--set", f"hardware.joints={joints}")
    told = embedded(tmp_path / "c", "pd", *more)
    assert told["units"] == {"arm_1_joint": ["current", 0.7], "arm_2_joint": ["pwm", 9.0]}
    calls = 'controller.row[MMNN_ROW_MOTOR_TORQUE + j] = 2.1; printf("%.17g ", mmnn_motor_sent(&controller, j));'
    main_ = f"int main(void) {{ for (int j = 0; j < MMNN_MOTORS; j++) {{ {calls} }} return 0; }}"
    program = f'#include <stdio.h>\n#include "controller.h"\nstatic mmnn_controller controller;\n{main_}\n'
    (tmp_path / "sent.c").write_text(program)
    sources = [str(tmp_path / "c" / f"{name}.c") for name in ("controller", "robot_law", "mmnn_math", "tuning")]
    command = [
        "gcc",
        *STRICT,
        "-I",
        str(tmp_path / "c"),
        *sources,
        str(tmp_path / "sent.c"),
        "-o",
        str(tmp_path / "sent"),
    ]
    subprocess.run(command, check=True)
    sent = subprocess.run([tmp_path / "sent"], capture_output=True, text=True, check=True).stdout.split()
    assert [float(x) for x in sent] == [2.1, 2.1, 2.1 / 0.7, 2.1 / 9.0]
    header = (tmp_path / "c" / "controller.h").read_text()
    assert "arm_1_joint: current [A" in header and "arm_2_joint: pwm [share of full duty" in header


def test_the_two_layer_network_fits_into_twenty_kilobytes(exported):
    """Code and constants on a Cortex-M7 (a third of it holds references and measurements to the promise), and RAM."""
    require("cortex-m7")
    _, told = exported("two_layer")
    assert told["initial_bytes"] < told["code_bytes"] <= 20_000 + told["initial_bytes"] and told["ram_bytes"] <= 12_000


def test_the_worst_sample_is_held_to_the_period_of_a_processor(tmp_path):
    """Its instructions are those that the self-test prints; by hand their time on a clock of 216 MHz."""
    require("cortex-m7")
    loop = loop_of("platform_arm", "two_layer")
    made = embed(loop, tmp_path / "c", steps=30, compiler=None, processor="stm32f767")
    _, said = on_target(tmp_path / "c", "cortex-m7", "-DMMNN_COUNT")
    assert made.instructions == int(re.findall(r"(\d+) worst", said)[0])
    assert made.share == pytest.approx(2.0 * made.instructions / 216e6 / 0.001)
    many = Count(made.instructions, 108_001, 0, 0)
    with pytest.raises(ConfigError, match=r"a sample of 1 ms on stm32f767.*108,001 instructions.*216 MHz") as refused:
        require_time(many, 0.001, "stm32f767")
    assert refused.value.key == "processor"
    assert require_time(many, 0.001001, "stm32f767") == pytest.approx(0.999, abs=1e-3)  # the longer period


@needs_gcc
def test_a_changed_number_fails_the_self_test(exported, tmp_path):
    folder, _ = exported("two_layer")
    shutil.copytree(folder, tmp_path / "changed")
    law = tmp_path / "changed" / "robot_law.c"
    text = law.read_text()
    start = text.index("law_start_law_gains0")
    law.write_text(text[:start] + re.sub(r"\d+\.\d+", "3.0000001", text[start:], count=1))
    subprocess.run(["gcc", *STRICT, *tmp_path.glob("changed/*.c"), "-o", tmp_path / "selftest"], check=True)
    done = subprocess.run([tmp_path / "selftest"], capture_output=True, text=True)
    assert done.returncode == 1 and "differ" in done.stdout and "expected" in done.stdout


@needs_gcc
@pytest.mark.parametrize(
    "flags", [["-O0"], ["-O3", "-march=native", "-fno-tree-slp-vectorize"], ["-Os", "-DMMNN_PORTABLE_SQRT"]]
)
def test_the_bits_do_not_depend_on_the_optimiser(exported, tmp_path, flags):
    folder, _ = exported("adaptive_composite")
    subprocess.run(["gcc", *STRICT, *flags, *folder.glob("*.c"), "-o", tmp_path / "selftest"], check=True)
    subprocess.run([tmp_path / "selftest"], check=True)


@needs_gcc
def test_controllers_run_side_by_side(exported, tmp_path):
    """Two of them, stepped in turns, do what each does alone: there is no memory outside of the struct."""
    folder, _ = exported("two_layer")
    (tmp_path / "main.c").write_text(
        """#include "controller.h"
#include <string.h>
static mmnn_controller a, b, alone;
int main(void)
{
    mmnn_measurement m;
    memset(&m, 0, sizeof m);
    mmnn_init(&a); mmnn_init(&b); mmnn_init(&alone);
    for (int k = 0; k < 50; k++) {
        const double time = 0.001 * k;
        m.q[0] = 0.01; mmnn_step(&a, time, &m, time, 0);
        m.q[0] = 0.02; mmnn_step(&b, time, &m, time, 0);
    }
    for (int k = 0; k < 50; k++) { m.q[0] = 0.01; mmnn_step(&alone, 0.001 * k, &m, 0.001 * k, 0); }
    return memcmp(&a, &alone, sizeof a) != 0 || memcmp(&a, &b, sizeof a) == 0;
}
"""
    )
    sources = [file for file in folder.glob("*.c") if file.name != "selftest.c"]
    command = ["gcc", *STRICT, f"-I{folder}", tmp_path / "main.c", *sources, "-o", tmp_path / "both"]
    subprocess.run(command, check=True)
    subprocess.run([tmp_path / "both"], check=True)


@needs_gcc
def test_single_precision_is_near(exported):
    folder, _ = exported("pd", STEPS, "--single")
    done = subprocess.run(["gcc", *STRICT, *folder.glob("*.c"), "-o", folder / "selftest"], check=True)
    done = subprocess.run([folder / "selftest"], capture_output=True, text=True, check=True)
    largest, deviation = map(float, re.search(r"largest torque (\S+), largest deviation (\S+)", done.stdout).groups())
    assert 0 < deviation < 1e-3 * largest
    assert "double" not in (folder / "controller.c").read_text()


# -- in the loop -------------------------------------------------------------------------------------------------------


@needs_gcc
def test_a_run_with_the_exported_controller_is_pythons(exported):
    """Software in the loop: signals, weights, states and outcome of the recording are equal."""
    folder, told = exported("two_layer")
    assert told["in_the_loop"] == {"where": "host", "samples": STEPS, "status": "completed", "differences": []}
    run = Recording.open(folder / "run.h5")
    assert np.abs(run["torque"]).max() > 0 and np.ptp(run["weight_norm"][:, 0]) > 0


@needs_gcc
def test_what_is_asked_in_flight_is_done_as_by_the_stepper(tmp_path):
    """Wheels that take velocities; samples, velocities, a pause, a stop and a reset, through the functions of C."""
    wheels = {"wheel_left_joint": "velocity", "wheel_right_joint": "velocity"}
    loop = loop_of("platform_arm", "pd", interfaces=wheels)
    made, stepper, d = (
        embed(loop, tmp_path / "c", steps=5, compiler=None),
        Stepper.of(loop, limits=Limits()),
        loop.robot.dimensions,
    )
    sources = [tmp_path / "c" / f"{name}.c" for name in ("controller", "robot_law", "mmnn_math")]
    size = f'#include "controller.h"\ntypedef char as_told[sizeof(mmnn_controller) == {made.ram_bytes} ? 1 : -1];\n'
    (tmp_path / "c" / "size.c").write_text(size)
    sources.append(tmp_path / "c" / "size.c")
    subprocess.run(["gcc", *STRICT, "-O2", "-shared", "-fPIC", *sources, "-o", tmp_path / "lib.so"], check=True)
    c, memory = ctypes.CDLL(str(tmp_path / "lib.so")), ctypes.create_string_buffer(made.ram_bytes)
    c.mmnn_motor_torque.restype = c.mmnn_motor_velocity.restype = ctypes.POINTER(ctypes.c_double)
    c.mmnn_is_over.restype = c.mmnn_reset.restype = ctypes.c_bool
    c.mmnn_step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p]

    class Wanted(ctypes.Structure):
        _fields_ = (("wish", ctypes.c_int), ("sample", ctypes.c_double * 13))

    c.mmnn_init(memory)
    table, torques = loop.trajectory.table(np.arange(400) * 0.001, d), []
    wishes = {0: 1, 60: 2, 120: 3, 150: 1, 260: 2}  # the first sample of each: FOLLOW_SAMPLE, FOLLOW_VELOCITY, STAND
    actions = {90: "pause", 110: "resume", 300: "stop", 340: "reset", 350: "pause", 380: "resume"}
    for k, asked in enumerate(table):
        wish = wishes[max(first for first in wishes if first <= k)]
        sample, measured = Setpoint.side_by_side(asked, d), np.ascontiguousarray(as_measured(asked, loop.robot) + 0.001)
        if k in actions:
            getattr(stepper, actions[k])()
            getattr(c, f"mmnn_{actions[k]}")(memory)
        parts = np.split(measured, np.cumsum((d.pose, d.base, d.arm)))
        said = stepper.step(
            k * 0.001, Measurement(*parts), {1: sample, 2: BaseVelocity(sample.velocity), 3: HOLD}[wish]
        )
        wanted = Wanted(wish, (ctypes.c_double * 13)(*asked))
        assert c.mmnn_step(memory, k * 0.001, measured.ctypes.data, k * 0.001, ctypes.byref(wanted)) == 0
        torque = np.array(c.mmnn_motor_torque(memory)[:4])
        assert torque.tobytes() == stepper.motor_torque.tobytes(), k
        assert torque[2:].tobytes() == said.motor_effort[2:].tobytes() and np.isnan(said.motor_effort[:2]).all(), k
        assert np.array(c.mmnn_motor_velocity(memory)[:2]).tobytes() == said.motor_velocity[:2].tobytes(), k
        assert bool(c.mmnn_is_over(memory)) == stepper.is_over
        torques.append(torque)
    assert all(np.ptp(torques[first : first + 40]) > 0 for first in (0, 90, 150, 300))


@needs_gcc
def test_a_library_that_lies_where_one_stands_is_not_linked(tmp_path, monkeypatch):
    """A linker takes the libraries that its scripts name from where it is started."""
    strange, own = tmp_path / "strange", tmp_path / "own"
    strange.mkdir()
    (strange / "libgcc_s.so.1").write_text("INPUT(/nowhere/strangers.o)")
    (strange / "cc").symlink_to(shutil.which("gcc"))
    monkeypatch.chdir(strange)
    loop = loop_of("platform_arm", "pd")
    assert embed(loop, own, steps=5, compiler="./cc").code_bytes
    assert build(own, HOST, found_compiler("./cc"), tmp_path / "link")
    with pytest.raises(ConfigError, match="cc: error: no command 'cc \"': No closing quotation: close its quotes"):
        embed(loop, tmp_path / "more", compiler='cc "')


@needs_gcc
def test_a_linked_controller_pauses_as_the_stepper_and_refuses_other_gains(tmp_path):
    loop = loop_of("platform_arm", "pd")
    embed(loop, tmp_path / "c", steps=5, compiler=None)
    linked, stepper, d = Linked.of(loop, limits=Limits()), Stepper.of(loop, limits=Limits()), loop.robot.dimensions
    linked.link(translated(linked, ""), build(tmp_path / "c", HOST, ["gcc"], tmp_path / "link"))
    with linked:
        for k, asked in enumerate(loop.trajectory.table(np.arange(60) * 0.001, d)):
            for one in (linked, stepper):
                if k in (20, 40):
                    one.pause() if k == 20 else one.resume()
                wanted = Setpoint.side_by_side(asked, d)
                one.step(k * 0.001, Measurement(np.zeros(3), np.zeros(2), wanted.q + 0.01, np.zeros(2)), wanted)
            assert linked.row.tobytes() == stepper.row.tobytes(), k
        assert np.abs(stepper.torque).max() > 0
        with pytest.raises(ConfigError, match="export it anew"):
            linked.change(kinematic=Kinematic())


# -- what the files hold -----------------------------------------------------------------------------------------------


@needs_gcc
def test_nothing_is_allocated_printed_or_kept_outside(exported, tmp_path):
    folder, _ = exported("adaptive_composite")
    for name in ("controller", "robot_law", "mmnn_math"):
        subprocess.run(["gcc", *STRICT, "-O2", "-c", folder / f"{name}.c", "-o", tmp_path / f"{name}.o"], check=True)
    symbols = subprocess.run(["nm", *tmp_path.glob("*.o")], capture_output=True, text=True, check=True).stdout
    defined = set(re.findall(r"^\w+ [A-TV-Za-z] (\w+)$", symbols, re.M))
    wanted = set(re.findall(r"^ +U (\w+)$", symbols, re.M)) - defined
    assert wanted <= {"memcpy", "memset", "memmove", "_GLOBAL_OFFSET_TABLE_"}  # which gcc puts in for loops
    assert re.findall(r"^\w+ [bBdDcC] (\w+)$", symbols, re.M) == []  # no variables


def test_the_comments_are_the_docstrings(exported):
    folder, _ = exported("two_layer")
    text = (folder / "controller.c").read_text()
    assert "One step of the update law (3.48), (3.49)" in text and "mmnn_pin.torque.two_layer.two_layer_update" in text
    assert (
        "pose: (3,)" in (folder / "controller.h").read_text()
        or "[3]; /* m, m, rad */" in text + (folder / "controller.h").read_text()
    )


def test_compiled_and_plain_functions_give_the_same_text(exported):
    """The export reads the functions' source, so numba makes no difference, nor does the order of a dictionary."""
    folder, _ = exported("two_layer")
    experiment = load_experiment("track")
    robot = experiment.load_robot()
    loop = supervised(experiment.loop(robot, experiment.controller("two_layer", robot=robot)))
    texts = files_of(translated(Fresh.of(loop, limits=Limits()), "two_layer for platform_arm"))
    assert {name: (folder / name).read_text() for name in texts} == texts


@needs_gcc
@pytest.mark.long
def test_without_diagnostics_the_gram_matrix_is_left_out(tmp_path):
    """Of its 40 kB `adaptive` then needs a quarter; the bits of all else stay, as its self-test says."""
    told = embedded(tmp_path / "c", "adaptive", "--steps", "40", "--no-diagnostics")
    assert told["ram_bytes"] < 16_000 and "gram" not in (tmp_path / "c" / "controller.h").read_text()


@given(st.lists(st.text(), min_size=1, max_size=3))
def test_names_in_a_list_of_c_are_read_back_by_another_reader(names):
    texts = re.findall(r'"([^"]*)"', quoted(names))
    assert [ast.literal_eval(f'b"{text}"').decode() for text in texts] == names
    assert not re.search(r"[^ -~]|[?%]", "".join(texts))


@given(st.text())
@example("*/ #error here /*")
@example('??/ \\ " %n <x> // \n')
def test_a_plain_name_ends_no_comment_and_is_no_format(name):
    assert len(plain(name)) == len(name)
    assert not re.search(r"[^ -~]|[*?%<>&\\\"'`#]", plain(name))


@pytest.mark.skipif(not HAS_GCC, reason="no gcc: apt-get install gcc")
def test_names_that_imitate_c_are_harmless_in_every_file(tmp_path):
    """Joints and the robot are called so that each would end a comment, a text or a format."""
    hostile = 'a */ #error x /* ??/ \\ " %n %s'
    text = (ROOT / "urdf" / "platform_arm.urdf").read_text()
    escaped = hostile.replace('"', "&quot;")
    text = re.sub(r'(<robot name=")[^"]*', lambda found: found[1] + escaped, text)
    text = re.sub(r'"(arm_1_joint|wheel_left_joint)"', lambda found: f'"{found[1]} {escaped}"', text)
    (tmp_path / "hostile.urdf").write_text(text)
    folder = tmp_path / "out"
    named = ["--robot", str(tmp_path / "hostile.urdf"), "--controller", "pd", "--out", str(folder)]
    with redirect_stdout(StringIO()):
        assert main(["embed", "track", *named, "--steps", str(STEPS), "--no-check"]) == 0  # it is compiled below
    sources = sorted(map(str, folder.glob("*.c")))
    done = subprocess.run(
        ["gcc", *STRICT, "-trigraphs", "-o", tmp_path / "test", *sources], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert subprocess.run([tmp_path / "test"], capture_output=True, check=False).returncode == 0
    etree.parse(folder / "ros2_control" / "plugin.xml")
    plugin = (folder / "ros2_control" / "plugin.cpp").read_text()
    assert "#error" not in "".join(file.read_text() for file in folder.rglob("*.[ch]"))
    assert quoted([f"arm_1_joint {hostile}"]) in plugin


# -- the small parts ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def library(exported, tmp_path_factory):
    """`mmnn_math.c` as a library, with the small parts of Python that stand in its header."""
    if not HAS_GCC:
        pytest.skip("no gcc: apt-get install gcc")
    folder, _ = exported("adaptive_composite")
    made = tmp_path_factory.mktemp("library")
    (made / "parts.c").write_text(
        '#include "mmnn_math.c"\n'  # some of its functions are static
        "double exponential(double x) { return mmnn_exp(x); }\n"
        "double smaller(double a, double b) { return mmnn_min(a, b); }\n"
        "double larger(double a, double b) { return mmnn_max(a, b); }\n"
        "double whole(double x) { return mmnn_floor(x); }\n"
        "int64_t rest(int64_t a, int64_t b) { return mmnn_rest_long(a, b); }\n"
        "int64_t quotient(int64_t a, int64_t b) { return mmnn_quotient_long(a, b); }\n"
    )
    command = [
        "gcc",
        *STRICT,
        "-DMMNN_PORTABLE_SQRT",
        "-O2",
        "-shared",
        "-fPIC",
        f"-I{folder}",
        made / "parts.c",
    ]
    subprocess.run([*command, "-o", made / "lib.so"], check=True)
    found = ctypes.CDLL(str(made / "lib.so"))
    for name in (
        "mmnn_portable_sqrt",
        "mmnn_modulo",
        "exponential",
        "mmnn_tanh",
        "mmnn_hypot",
        "smaller",
        "larger",
        "whole",
    ):
        getattr(found, name).restype = ctypes.c_double
        one = name in ("mmnn_portable_sqrt", "exponential", "mmnn_tanh", "whole")
        getattr(found, name).argtypes = [ctypes.c_double] * (1 if one else 2)
    for name in ("rest", "quotient"):
        getattr(found, name).restype, getattr(found, name).argtypes = ctypes.c_int64, [ctypes.c_int64] * 2

    class Pair(ctypes.Structure):
        _fields_ = (("v", ctypes.c_double * 2),)

    found.mmnn_cos_sin.restype, found.mmnn_cos_sin.argtypes = Pair, [ctypes.c_double]
    return found


def same(a, b):
    """Equal bits, or both no numbers."""
    return (a != a and b != b) or np.float64(a).tobytes() == np.float64(b).tobytes()


ANY = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
TINY = [0.0, -0.0, 5e-324, -5e-324, 2.2250738585072014e-308, 1.7976931348623157e308, math.inf, -math.inf, math.nan]


@given(ANY)
def test_the_portable_root_is_rounded_correctly(library, x):
    assert same(library.mmnn_portable_sqrt(x), math.sqrt(x) if x >= 0 else math.nan)


@given(ANY, ANY)
def test_the_rest_of_a_division_is_pythons(library, x, y):
    fine = math.isfinite(x) and y == y and y != 0
    assert same(library.mmnn_modulo(x, y), x % y if fine else math.nan)


def test_the_rest_of_tiny_and_huge_numbers_is_exact(library):
    for x in TINY[:6]:
        for y in (5e-324, 1.5e-323, 2.2250738585072014e-308, 3.0, -7e300):
            assert same(library.mmnn_modulo(x, y), x % y), (x, y)


@given(st.integers(-(10**9), 10**9), st.integers(-1000, 1000).filter(bool))
def test_whole_divisions_are_pythons(library, a, b):
    assert (library.rest(a, b), library.quotient(a, b)) == (a % b, a // b)


@given(ANY)
def test_the_largest_whole_number_below_is_pythons(library, x):
    assert same(library.whole(x), float(math.floor(x)) if math.isfinite(x) else x)


@given(ANY, ANY)
def test_min_and_max_keep_their_first_argument_as_python_does(library, a, b):
    assert same(library.smaller(a, b), min(a, b)) and same(library.larger(a, b), max(a, b))


def test_the_elementary_functions_have_the_bits_of_python(library):
    rng = np.random.default_rng(4)
    points = [*TINY, *(rng.standard_normal(300) * 10.0 ** rng.uniform(-12, 12, 300)), *rng.uniform(-700, 700, 100)]
    for x in map(float, points):
        assert same(library.exponential(x), exponentials.exp(x)), x
        assert same(library.mmnn_tanh(x), exponentials.tanh(x)), x
        assert same(library.mmnn_hypot(x, points[3]), two_doubles.hypot(x, float(points[3]))), x
        pair, (c, s) = library.mmnn_cos_sin(x), angles.cos_sin(x)
        assert same(pair.v[0], c) and same(pair.v[1], s), x


# -- what is refused ---------------------------------------------------------------------------------------------------


def unknown_construct(x: float) -> float:
    """A function with something that C cannot say."""
    y = 2.0 * x
    return [y, x][0]


def unknown_name(x: float) -> float:
    """A function that calls what is nowhere."""
    return not_there(x)  # noqa: F821


def library_call(x: float) -> float:
    """A function that calls a libm."""
    return math.sin(x)


def assertion(x: float) -> float:
    """A function that raises."""
    if x > 0.0:
        raise ValueError("no")
    return x


@pytest.mark.parametrize(
    ("function", "what", "line"),
    [
        (unknown_construct, "a List", 3),
        (unknown_name, "'not_there'", 2),
        (library_call, "a call of <built-in function sin>", 2),
        (assertion, "'raise'", 3),
    ],
)
def test_an_unknown_construct_stops_the_export_with_function_and_line(function, what, line):
    program = CProgram(write)
    with pytest.raises(Untranslatable, match=re.escape(what)) as caught:
        program.function(program.source(function), {"x": Number("real", "x")})
    assert f"in '{function.__name__}'" in caught.value.what
    assert caught.value.line == function.__code__.co_firstlineno + line
    assert str(caught.value.file).endswith("test_embed.py")


FREE = """<robot name="free"><link name="base_link"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="arm"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="lift" type="revolute"><parent link="base_link"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="1" effort="0"/></joint></robot>"""


def refused(capsys, *arguments):
    assert main(["embed", *arguments]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    errors = [line for line in lines if "error:" in line]
    assert len(errors) == 1, lines
    return errors[0]


def test_what_cannot_be_embedded_is_refused_in_one_line(tmp_path, capsys):
    (tmp_path / "exists").mkdir()
    (tmp_path / "free.urdf").write_text(FREE)
    own = f"{ROOT / 'examples' / 'own_law.py'}:LeastSquares"
    out = ["--out", str(tmp_path / "c")]
    pd = ["track", "--controller", "pd"]
    (tmp_path / "file").touch()
    cases = {
        "is a file": [*pd, "--out", str(tmp_path / "file"), "--force"],
        "exists": [*pd, "--out", str(tmp_path / "exists")],
        "no compiler 'nocc'": [*pd, *out, "--cc", "nocc"],
        "motors that nothing limits": [*pd, *out, "--robot", str(tmp_path / "free.urdf"), "--no-check"],
        "an experiment with the plant 'contact'": [*pd, *out, "--set", "plant=contact"],
        "measurements that are brought up to now": [
            *pd,
            *out,
            "--set",
            "latency.sensing=0.004",
            "--set",
            "latency.predict=true",
        ],
        "cannot be written as C": ["track", "--controller", own, *out, "--no-check"],
        "unknown controller": ["track", "--controller", "pdd", *out],
        "unknown processor": [*pd, *out, "--processor", "m8"],
    }
    for text, arguments in cases.items():
        assert text in refused(capsys, *arguments)
        assert not (tmp_path / "c").exists()


def test_limits_are_asked_for_by_a_command_that_works(tmp_path, capsys):
    (tmp_path / "free.urdf").write_text(FREE)
    asked = ["track", "--controller", "pd", "--robot", str(tmp_path / "free.urdf"), "--out", str(tmp_path / "c")]
    fix = shlex.split(refused(capsys, *asked, "--no-check").partition("for 10 in ")[2])
    assert fix[0] == "--set" and main(["embed", *asked, *fix, "--no-check"]) == 0


def test_what_does_not_fit_is_refused_with_the_numbers(tmp_path, capsys):
    line = refused(capsys, "track", "--controller", "kalman_features", "--out", str(tmp_path / "c"), "--no-check")
    assert re.search(r"remembers \d{3,} kB \(u \d+ kB.*512 kB is the limit", line)
