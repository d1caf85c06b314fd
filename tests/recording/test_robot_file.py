"""The meshes of a recorded robot: found as the run found them, and nothing else is read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from drives import Drive

from mmnn_pin import Timing, Trajectory, load
from mmnn_pin.lab.show.replay import page
from mmnn_pin.loop.loop import Loop
from mmnn_pin.model.loading import build
from mmnn_pin.recording import robot_file
from mmnn_pin.recording.recording import Recording, recorded_robot
from mmnn_pin.recording.robot_file import UNSEEN
from mmnn_pin.torque.model_based import PD

STL = (
    b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
)
HULL = (
    '<joint name="{0}" type="fixed"><parent link="base"/><child link="{0}"/></joint><link name="{0}"><visual>'
    '<geometry><mesh filename="{1}"/></geometry></visual></link>'
)
MACRO = '<robot xmlns:xacro="x"><xacro:macro name="hull" params="name kind">{}</xacro:macro></robot>'
MANIFEST = "<package><name>{}</name></package>"


def workspace(place: Path, *packages: str) -> None:
    """Packages with a mesh each."""
    for name in packages:
        (place / name / "meshes").mkdir(parents=True)
        (place / name / "package.xml").write_text(MANIFEST.format(name))
        (place / name / "meshes" / "big_hull.stl").write_bytes(STL)


def xacro(place: Path, mesh: str) -> Path:
    """A xacro file that includes a macro by a name that an argument makes, and puts the kind of hull into its mesh."""
    (place / "robot").mkdir()
    (place / "robot" / "package.xml").write_text(MANIFEST.format("robot"))
    (place / "robot" / "part_macro.xacro").write_text(MACRO.format(HULL.format("${name}", mesh)))
    own = '<robot name="r" xmlns:xacro="x"><xacro:arg name="part" default="part"/>'
    own += '<xacro:include filename="$(find robot)/$(arg part)_macro.xacro"/><xacro:hull name="hull" kind="big"/>'
    file = place / "robot" / "r.urdf.xacro"
    file.write_text(Drive().urdf().replace('<robot name="r">', own, 1))
    return file


def run_of(file: Path, **overrides: object) -> Recording:
    robot = load(file, **overrides)
    return Loop(robot, Trajectory.of(robot), PD(), timing=Timing(duration=0.01)).run()


@pytest.mark.parametrize(
    "mesh",
    [
        "package://shapes/meshes/${kind}_hull.stl",
        "$(find shapes)/meshes/${kind}_hull.stl",
        "package://shapes/meshes/${kind}.stl",
        "${xacro.load_yaml('$(find shapes)/shapes.yaml')['hull']}",
    ],
)
def test_a_replay_of_a_xacro_robot_shows_its_meshes(mesh: str, tmp_path: Path) -> None:
    workspace(tmp_path, "shapes")
    (tmp_path / "shapes" / "meshes" / "big.stl").write_bytes(STL)
    (tmp_path / "shapes" / "shapes.yaml").write_text("hull: package://shapes/meshes/big_hull.stl")
    run = run_of(xacro(tmp_path, mesh))
    assert UNSEEN not in recorded_robot(run).urdf
    assert page({"run": run}).warnings == ()


def test_packages_are_found_where_the_environment_of_the_run_had_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace(tmp_path / "far" / "away", "shapes")
    own = tmp_path / "a" / "b" / "c" / "d" / "e"  # packages are looked for a few levels above
    own.mkdir(parents=True)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "far" / "away"))
    run = run_of(xacro(own, "package://shapes/meshes/${kind}_hull.stl"))
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    assert page({"run": run}).warnings == ()
    del run.meta["package_path"]
    assert "big_hull.stl' is missing" in page({"run": run}).warnings[0]


def test_a_folder_that_the_run_was_given_is_found_from_another_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace(tmp_path / "far" / "away", "shapes")
    (tmp_path / "own").mkdir()
    monkeypatch.chdir(tmp_path / "far")
    run = run_of(xacro(tmp_path / "own", "package://shapes/meshes/big_hull.stl"), package_dirs=("away",))
    monkeypatch.chdir(tmp_path)
    assert page({"run": run}).warnings == ()


@pytest.mark.parametrize(
    "name",
    [
        "package://private/meshes/big_hull.stl",
        "package://shapes/meshes/../../private/meshes/big_hull.stl",
        "file://{}/private/meshes/big_hull.stl",
        "package://shapes/meshes/other.stl",
    ],
)
def test_a_recording_makes_nobody_read_what_the_xacro_file_does_not_name(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace(tmp_path, "shapes", "private")
    (tmp_path / "shapes" / "meshes" / "other.stl").write_bytes(STL)
    named = "package://shapes/meshes/big_hull.stl"
    run = run_of(xacro(tmp_path, "package://shapes/meshes/${kind}_hull.stl"), package_dirs=(str(tmp_path),))
    assert named in run.urdf
    name = name.format(tmp_path)
    monkeypatch.setattr(Recording, "urdf", run.urdf.replace("</robot>", HULL.format("spy", name) + "</robot>"))
    seen = recorded_robot(run).urdf
    assert f'"{UNSEEN}{name}"' in seen and f'"{named}"' in seen


def test_runs_of_one_robot_build_it_once_and_see_what_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    workspace(tmp_path, "shapes")
    file, built = xacro(tmp_path, "package://shapes/meshes/${kind}_hull.stl"), list[str]()
    one, other = run_of(file), run_of(file)
    mesh, moved = (tmp_path / "shapes" / "meshes" / name for name in ("big_hull.stl", "elsewhere.stl"))
    mesh.rename(moved)
    monkeypatch.setattr(robot_file, "BUILT", {})
    monkeypatch.setattr(robot_file, "build", lambda *given: (built.append("again"), build(*given))[1])
    assert "big_hull.stl' is missing" in page({"run": one}).warnings[0]
    moved.rename(mesh)
    assert page({"one": one, "other": other}).warnings == () and len(built) == 2
    file.write_text(file.read_text() + "\n")
    os.utime(file, (1e9, 1e9))
    assert page({"run": one}).warnings == () and len(built) == 3
