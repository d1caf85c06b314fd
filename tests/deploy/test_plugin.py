"""The exported plugin of ros2_control: through its life in a simulated controller manager, and what dies when.

No registry at hand has headers of ros2_control for C++, so it is compiled against `stubs`, made of the interfaces that
the branches humble, jazzy, kilted and master declare. `stubs/manager.cpp` is the manager, the robot and its operator.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from functools import cache

import numpy as np
import pytest
from deploy.fuzzing import loop_of
from lxml import etree
from places import ROOT

from mmnn_pin.deploy.embed.export import embed

yaml = pytest.importorskip("yaml", reason="pip install pyyaml")
STUBS = ROOT / "tests" / "deploy" / "stubs"
FLAVOURS = {"humble": ["-DMMNN_HUMBLE"], "master": []}
pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="no g++: apt-get install g++")
PACKAGE = "mmnn_platform_arm_computed_torque"


def parameter_header(text, package):
    """What generate_parameter_library makes of the YAML, as far as the plugin sees it."""
    ((name, table),) = yaml.safe_load(text).items()
    assert name == package
    lines = []

    def declare(rows, depth):
        for key, row in rows.items():
            if "type" not in row:
                lines.append(f"struct {key.title()} {{")
                declare(row, depth + 1)
                lines.append(f"}} {key};")
                continue
            assert set(row) <= {"type", "default_value", "description", "validation", "read_only"}
            value, checks = row["default_value"], row.get("validation", {})
            if row["type"] == "double_array":
                assert all(type(x) is float for x in value) and len(value) == checks["fixed_size<>"]
                low, high = checks.get("element_bounds<>", (-np.inf, np.inf))
                assert all(low <= x <= high for x in value), (key, value)
                lines.append(f"std::vector<double> {key}{{{', '.join(map(repr, value))}}};")
            else:
                assert type(value) is {"double": float, "bool": bool}[row["type"]]
                lines.append(f"{row['type']} {key} = {str(value).lower()};")

    declare(table, 0)
    return (
        "#pragma once\n#include <memory>\n#include <vector>\n"
        f"namespace {package} {{\nstruct Params {{\nint stamp = 0;\n" + "\n".join(lines) + "\n};\n"
        "struct ParamListener {\n"
        "template <class Node> explicit ParamListener(std::shared_ptr<Node>) {}\n"
        "static Params & current() { static Params one; return one; }\n"
        "static int & version() { static int one = 0; return one; }\n"
        "Params get_params() { current().stamp = version(); return current(); }\n"
        "bool is_old(const Params & other) const { return other.stamp != version(); }\n};\n}\n"
    )  # fmt: skip


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The program of a simulated manager with a plugin, made once for every flavour and set of interfaces."""

    @cache
    def folder(interfaces):
        made = tmp_path_factory.mktemp("plugin") / "c"
        loop = loop_of("platform_arm", "computed_torque", interfaces=dict(interfaces))
        embed(loop, made, steps=5, compiler=None)
        header = parameter_header((made / "ros2_control/parameters.yaml").read_text(), PACKAGE)
        (made / "ros2_control" / f"{PACKAGE}_parameters.hpp").write_text(header)
        for name in ("controller", "tuning", "robot_law", "mmnn_math"):
            subprocess.run(["gcc", "-O1", "-c", f"{name}.c", "-o", f"{name}.o"], cwd=made, check=True)
        return made

    @cache
    def make(flavour, interfaces=()):
        made = folder(interfaces)
        program = made / flavour
        command = [
            "g++",
            "-std=c++17",
            "-O0",
            "-Wall",
            "-Wextra",
            "-Werror",
            *FLAVOURS[flavour],
            f"-DPACKAGE={PACKAGE}",
        ]
        command += [f"-I{path}" for path in (STUBS, made, made / "ros2_control")]
        objects = [made / f"{name}.o" for name in ("controller", "tuning", "robot_law", "mmnn_math")]
        subprocess.run([*command, STUBS / "manager.cpp", *objects, "-o", program], check=True)
        return program

    return make


class Run:
    """A run of the manager: its signals by time."""

    def __init__(self, program, arms=2, **options):
        done = subprocess.run([program, *(f"{k}={v}" for k, v in options.items())], capture_output=True, text=True)
        self.code, self.said = done.returncode, done.stderr
        rows = np.array([line.split() for line in done.stdout.splitlines()], float)
        if rows.size:
            self.t, self.x, self.y, self.yaw, self.v, self.w = rows[:, :6].T
            self.q, self.wanted = rows[:, 6 : 6 + 2 * arms : 2], rows[:, 7 : 7 + 2 * arms : 2]
            self.commands, self.given = rows[:, 6 + 2 * arms : 10 + 2 * arms], rows[:, 10 + 2 * arms : -1]
            self.result = rows[:, -1]

    def after(self, time):
        """Samples from a time on."""
        return self.t >= time - 1e-6


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("chained", [0, 1])
def test_base_and_arm_follow_topics_and_chained_interfaces(built, flavour, chained):
    run = Run(built(flavour), chained=chained, w=0.1)
    assert run.code == 0 and not run.result.any(), run.said
    late = run.after(3.0)
    assert np.abs(run.v[late] - 0.3).max() < 0.03 and np.abs(run.w[late] - 0.1).max() < 0.03
    assert np.abs(run.q - run.wanted)[late].max() < 0.06 and np.ptp(run.q) > 0.5


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize("dies", ["odometry_dies", "odometry_repeats", "odometry_nan", "joint_nan"])
def test_what_is_not_measured_any_more_stops_the_robot(built, flavour, dies):
    """Odometry that ends, comes again with its old stamp, or is no number; a joint that is no number.

    Motors without a torque let this robot coast to rest: it never gets faster.
    """
    run = Run(built(flavour), until=3.5, **{dies: 2.0})
    late, dead = run.after(2.8), run.after(2.0)
    assert np.abs(run.commands[late]).max() < 1e-9 and run.v[dead].max() < 0.31
    assert (np.diff(run.v[late]) < 0.0).all() and run.v[-1] < 0.26 and np.abs(run.w[dead]).max() < 0.05
    assert "nothing is measured" in run.said


def test_odometry_of_the_future_is_none(built):
    run = Run(built("master"), odometry_ahead=5.0, until=1.5)
    assert not run.commands.any() and run.x[-1] == 0.0


@pytest.mark.parametrize("dies", ["velocity_dies", "arm_dies"])
def test_a_reference_that_is_not_renewed_brakes_what_followed_it(built, dies):
    run = Run(built("master"), until=4.5, **{dies: 2.0})
    late = run.after(3.7)
    if dies == "velocity_dies":
        assert np.abs(run.v[late]).max() < 0.01 and np.abs(run.q - run.wanted)[late].max() < 0.06
    else:
        assert np.ptp(run.q[late], axis=0).max() < 0.01 and np.abs(run.v[late] - 0.3).max() < 0.03


def test_an_old_reference_is_not_taken(built):
    run = Run(built("master"), velocity_age=0.6, until=2.0)
    assert np.abs(run.v).max() < 0.01 and np.ptp(run.q) > 0.3


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_deactivated_in_motion_it_leaves_nothing_and_starts_again_where_it_is(built, flavour):
    run = Run(built(flavour), deactivate=2.0, activate=3.0, until=5.0)
    off = run.after(2.0) & ~run.after(3.0)
    assert run.code == 0 and not run.commands[off].any() and run.v[off][0] > 0.25
    on = run.after(3.0)
    assert np.abs(run.commands[on]).max() < 60.0 and np.abs(np.diff(run.v[on])).max() < 0.01
    assert abs(run.v[-1] - 0.3) < 0.03 and np.abs(run.q - run.wanted)[-1].max() < 0.06


def test_velocities_end_and_positions_stay_when_it_is_deactivated(built):
    names = (("wheel_left_joint", "velocity"), ("wheel_right_joint", "velocity"), ("arm_2_joint", "position"))
    run = Run(built("master", names), deactivate=2.0, until=2.5)
    off, before = run.after(2.0), ~run.after(2.0)
    assert np.abs(run.v[before][-1] - 0.3) < 0.05 and abs(run.q[before][-1, 1] - run.wanted[before][-1, 1]) < 0.1
    assert not run.commands[off][:, :3].any()
    assert (run.commands[off][:, 3] == run.commands[before][-1, 3]).all() and run.commands[off][0, 3] > 0.1


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_another_rate_is_refused_when_it_is_told_and_when_it_is_measured(built, flavour):
    assert Run(built(flavour), update_rate=500).code == 3
    run = Run(built(flavour), update_rate=0, rate=500, until=0.6)
    assert run.result[-1] == 1 and not run.commands[-1].any() and "another rate" in run.said


def test_hardware_that_takes_no_commands_ends_the_run(built):
    run = Run(built("master"), hardware_refuses=1.0, until=1.5)
    assert run.result[-1] == 1 and "a command was not taken" in run.said


def test_gains_are_parameters_and_those_out_of_bounds_are_refused(built):
    kept, lower, refused = (Run(built("master"), v=0.3, gain=0.8, gain_by=by, until=1.2) for by in (1.0, 0.5, 50.0))
    assert np.array_equal(kept.commands, refused.commands) and "out of their bounds" in refused.said
    changed = np.flatnonzero((kept.commands != lower.commands).any(axis=1))
    assert abs(kept.t[changed[0]] - 0.8) < 2e-3


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_feed_forward_adds_psi_hat_to_the_efforts_of_another_controller(built, flavour):
    """Against what a mass of the arm needs: with it the other controller's PD has less to give."""
    run = Run(built(flavour), feedforward=1, chained=1, until=3.0)
    assert run.code == 0 and not run.commands[:, :2].any()
    early, late = ~run.after(0.4), run.after(1.0)
    psi = run.commands[:, 2:] - run.given
    assert np.abs(psi[early]).max() < 1e-6 + np.abs(psi[late]).max() and np.ptp(psi[late]) > 0.5
    dead = Run(built(flavour), feedforward=1, chained=1, until=3.0, odometry_dies=1.5)
    gone = dead.after(2.2)
    assert np.array_equal(dead.commands[gone][:, 2:], dead.given[gone]) and np.abs(dead.given[gone]).max() > 0.1


def test_the_package_has_what_ament_asks_for(built):
    folder = built("master").parent
    package = etree.parse(folder / "package.xml").getroot()
    assert package.findtext("name") == PACKAGE and package.findtext("export/build_type") == "ament_cmake"
    depends = {one.text for one in package.findall("depend")}
    code, cmake = (folder / "ros2_control/plugin.cpp").read_text(), (folder / "CMakeLists.txt").read_text()
    included = {one.split("/")[0] for one in re.findall(r'#include "([a-z_]+/[^"]+)"', code)} - {PACKAGE}
    assert included <= depends and {f"find_package({one} REQUIRED)" for one in depends} <= set(
        re.split(r"\n\s*", cmake)
    )
    plugin = etree.parse(folder / "ros2_control/plugin.xml").getroot()
    assert plugin.get("path") == PACKAGE
    assert f"PLUGINLIB_EXPORT_CLASS({plugin[0].get('type')}, {plugin[0].get('base_class_type')})" in code
    told = yaml.safe_load((folder / "ros2_control/controllers.yaml").read_text())
    assert told["controller_manager"]["ros__parameters"]["mmnn"]["type"] == plugin[0].get("name")


def test_cmake_builds_the_library_without_ros(built, tmp_path):
    if shutil.which("cmake") is None:
        pytest.skip("no cmake: apt-get install cmake")
    subprocess.run(["cmake", "-S", built("master").parent, "-B", tmp_path], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", tmp_path, "--target", "mmnn_controller"], check=True, capture_output=True)
