"""What is no plain file is refused at once, whoever names it: pipes that nobody writes to, devices that never end."""

from __future__ import annotations

import ast
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from places import ROOT
from sound_files import TUNING, motion
from study_files import written

from mmnn_pin import PD, Feedback, Recording, load_experiment
from mmnn_pin.cli import main
from mmnn_pin.errors import RecordingError, RobotError
from mmnn_pin.files import opened, read_bytes
from mmnn_pin.lab.psi.held_out import held_out
from mmnn_pin.lab.psi.subject import Subject
from mmnn_pin.lab.show.identified import page
from mmnn_pin.model.urdf.packages import VISITED
from mmnn_pin.model.urdf.reading import audit_data, audit_file

PATIENCE = 10.0  # [s] of processor time and of the clock
FILES = ("pipe", "/dev/zero", "folder", "large", "pointer")
POINTED = "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"
COMMANDS = {
    "reference": "run track --set time.duration=0.01 --controller pd --set reference.file={} --out out",
    "log": "identify {} --robot platform_arm --out out",
    "bag": "identify {}.mcap --robot platform_arm --out out",
    "recording": "export {}.h5 --to csv --out out",
    "controllers": "inspect {urdf} --controllers {}",
    "robot": "inspect {}",
    "experiment": "run {}.toml",
    "study": "study {}.toml",
    "law": "run track --set time.duration=0.01 --controller {}.py:Own --out out",
    "state": "model platform_arm --at {}.json",
    "start": "run track --set time.duration=0.01 --controller adaptive --set adaptive.start={} --out out",
    "identified": "report {}.identified.json --html out.html",
    "hardware": "run track --set time.duration=0.01 --controller pd --hardware {}.toml --out out",
    "columns": "identify log.csv --robot two_axis_arm --columns {}.toml --out out",
    "held out": "identify log.csv --robot two_axis_arm --held-out {}.csv --out out",
    "without load": "identify log.csv --robot two_axis_arm --payload --without-load {}.csv",
}
BESIDE = {  # what a command looks for beside what it is given
    "robot.mmnn.toml": "inspect robot.urdf",
    "robot.hardware.toml": "run track --robot robot.urdf --set time.duration=0.01 --controller pd --out out",
    "db/results.jsonl": "report db --html out.html",
    "out/results.jsonl": "study short.toml --workers 1 --out out",
    "runs/run.h5": "plot runs --out out",
    "tuned/tune.sqlite": "tune tuning.toml --workers 1 --out tuned",
}


def named(kind: str, word: str, folder: Path) -> str:
    """A name with the ending that the command wants, of a file of a kind."""
    if kind == "/dev/zero" and not word:
        return kind
    return str(made(kind, folder / f"{kind.strip('/').replace('/', '_')}{word}"))


def made(kind: str, path: Path) -> Path:
    """A file of a kind."""
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "large":
        with path.open("wb") as file:
            file.truncate(10**12)  # of nothing: it takes no room
    elif kind == "pointer":
        path.write_text(POINTED)
    elif kind == "latin 1":
        path.write_bytes(b"joints: [\xe9]\n")
    else:
        path.symlink_to(kind)
    return path


@pytest.fixture(autouse=True)
def alarm() -> Iterator[None]:
    """What waits without end fails."""

    def ring(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_refuses_it_with_one_line(
    command: str,
    kind: str,
    sound: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if (command, kind) == ("log", "folder"):
        pytest.skip("a folder is a bag")
    shutil.copytree(sound, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    words = COMMANDS[command].split()
    (place,) = [i for i, word in enumerate(words) if "{}" in word]
    _, _, ending = words[place].partition("{}")
    name = named(kind, ending.partition(":")[0], tmp_path)
    words[place] = words[place].partition("{}")[0] + name + "".join(ending.partition(":")[1:])
    arguments = [word.replace("{urdf}", str(ROOT / "urdf" / "platform_arm.urdf")) for word in words]
    line = refused_soon(arguments, capsys)
    assert Path(name).name in line or command in ("reference", "start"), line
    assert (kind == "pointer") == ("git lfs pull" in line), line


def refused_soon(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line by which a command refuses, soon and without much memory."""
    begun, clock = time.process_time(), time.monotonic()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    code = main(arguments)
    lines = capsys.readouterr().err.splitlines()
    told = [line for line in lines if "error: " in line]
    assert (code, len(told)) == (2, 1), lines
    assert "internal" not in told[0] and time.process_time() - begun < PATIENCE and time.monotonic() - clock < PATIENCE
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000  # kB
    return told[0]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of files that commands take."""
    folder = tmp_path_factory.mktemp("sound")
    written(folder)
    (folder / "tuning.toml").write_text(TUNING)
    motion(folder / "log.csv")
    (folder / "robot.urdf").write_text((ROOT / "urdf" / "platform_arm.urdf").read_text())
    return folder


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("name", BESIDE)
def test_it_is_refused_where_a_command_looks_for_it_by_itself(
    name: str,
    kind: str,
    sound: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copytree(sound, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    Path(name).parent.mkdir(exist_ok=True)
    made(kind, Path(name))
    line = refused_soon(BESIDE[name].split(), capsys)
    pointer = kind == "pointer" and "not a database" not in line  # which SQLite says of any other file
    assert Path(name).name in line and pointer == ("git lfs pull" in line), line


@pytest.mark.parametrize("kind", FILES)
def test_no_robot_is_offered_that_is_no_plain_file(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("new").mkdir()
    made(kind, Path("new/model.urdf"))
    assert ("model.urdf" in refused_soon(["inspect", "new"], capsys)) == (kind in ("large", "pointer"))


@pytest.mark.parametrize("what", ["pipe", "/dev/zero", "large"])
@pytest.mark.parametrize("how", ['<xacro:include filename="{}"/>', "<link name=\"${{xacro.load_yaml('{}')}}\"/>"])
def test_a_xacro_file_that_opens_it_is_refused_at_once(
    what: str, how: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    head = '<robot name="mini" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    name = named(what, ".yaml", tmp_path)
    (tmp_path / "robot.xacro").write_text(head + how.format(name) + "</robot>")
    begun = time.monotonic()
    assert main(["inspect", str(tmp_path / "robot.xacro")]) == 2
    assert time.monotonic() - begun < PATIENCE
    (line,) = (one for one in capsys.readouterr().err.splitlines() if "error: " in one)
    assert "it is no plain file" in line or "it has more than" in line


def test_a_pipe_beside_a_robot_keeps_nobody_waiting(tmp_path: Path) -> None:
    """Packages are looked for around a URDF by their `package.xml`."""
    robot = tmp_path / "one" / "urdf" / "robot.urdf"
    robot.parent.mkdir(parents=True)
    text = (ROOT / "urdf" / "platform_arm.urdf").read_text()
    robot.write_text(
        text.replace(
            "</robot>",
            '<link name="x"><visual><geometry><mesh filename="package://two/a.stl"/></geometry></visual></link></robot>',
        )
    )
    for name in ("one", "two"):
        (tmp_path / name).mkdir(exist_ok=True)
        os.mkfifo(tmp_path / name / "package.xml")
    begun = time.monotonic()
    assert main(["inspect", str(robot)]) in (0, 2)
    assert time.monotonic() - begun < PATIENCE


@pytest.mark.parametrize("kind", [*FILES, "nowhere", "latin 1"])
@pytest.mark.parametrize("name", ["a.yaml", "config/a.yml", "a.srdf", "config/a.srdf", "README.md"])
def test_what_lies_beside_a_robot_keeps_it_from_nobody(kind: str, name: str, tmp_path: Path) -> None:
    shutil.copy(ROOT / "urdf" / "platform_arm.urdf", tmp_path / "robot.urdf")
    (tmp_path / "package.xml").write_text("<package><name>robot</name></package>")
    (tmp_path / "config").mkdir()
    made(kind, tmp_path / name)
    begun = time.monotonic()
    assert main(["inspect", str(tmp_path / "robot.urdf")]) == 0
    assert time.monotonic() - begun < PATIENCE


@pytest.mark.parametrize("size", [0, 1, 999, 1000, 1001])
def test_a_plain_file_is_read_up_to_its_bound(size: int, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"x" * size)
    if size <= 1000:
        assert read_bytes(tmp_path / "file", 1000) == b"x" * size
    else:
        with pytest.raises(OSError, match="more than 1 kB"):
            read_bytes(tmp_path / "file", 1000)
    with opened(tmp_path / "file") as file:
        assert file.read() == b"x" * size


# -- attributes --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_tag_of_a_hundred_thousand_attributes_is_refused_soon(encoding: str) -> None:
    many = " ".join(f'a{i}=">"' for i in range(100_000))
    text = f'<?xml version="1.0" encoding="{encoding}"?>\n<robot name="x">\n<link name="a" {many}/></robot>'
    begun = time.process_time()
    document, findings = audit_data(text.encode(encoding), "x.urdf")
    assert time.process_time() - begun < 3.0 and document is None
    assert [(one.line, one.code) for one in findings] == [(3, "too-many")]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_hundred_thousand_namespaces_are_refused_soon(encoding: str) -> None:
    many = " ".join(f'xmlns:n{i}="u{i}"' for i in range(100_000))
    text = f'<?xml version="1.0" encoding="{encoding}"?>\n<robot name="x">\n<link name="a" {many}/></robot>'
    begun = time.process_time()
    document, findings = audit_data(text.encode(encoding), "x.urdf")
    assert time.process_time() - begun < 3.0 and document is None
    assert [one.code for one in findings] == ["too-many"]


DOUBTFUL = {  # beginnings of what a search looks for to the end, again and again
    "namespaces": ('<robot name="x" xmlns:xacro="">', ' xmlns:xacro> "', "</robot>"),
    "robots": ("", "<robot ", " " * 10**6),
    "comments": ("", "<!--", "<!DOCTYPE x>"),
    "sections": ("", "<![CDATA[", "<!DOCTYPE x>"),
    "macros": ('<robot name="x">', "<xacro:macro ", "</robot>"),
    "a number": ('<robot name="x"><link name="a"><inertial><mass value="', "0", 'x"/></inertial></link></robot>'),
}


@pytest.mark.parametrize("kind", DOUBTFUL)
def test_a_text_is_searched_in_time_that_grows_with_its_size(kind: str, tmp_path: Path) -> None:
    begin, again, end = DOUBTFUL[kind]
    (tmp_path / "x.urdf").write_text(begin + again * 70_000 + end)
    begun = time.process_time()
    with suppress(RobotError):
        assert audit_file(tmp_path / "x.urdf")[0] is None
    assert time.process_time() - begun < 3.0


LISTS = {  # and whether a controller is found in them
    "a key": ("wheel" * 200_000 + ":\n", False),
    "a list": ("joints:\n" + "- x\n" * 249_000, True),
    "keys": ("a: {b: 1, " * 100_000, False),
}


@pytest.mark.parametrize("kind", LISTS)
def test_so_is_a_file_of_controllers(kind: str, tmp_path: Path) -> None:
    (text, names), file = LISTS[kind], tmp_path / "a.yaml"
    file.write_text(text[:1_000_000])
    begun = time.process_time()
    code = main(["inspect", str(ROOT / "urdf" / "platform_arm.urdf"), "--controllers", str(file)])
    assert code == (0 if names else 2)
    assert time.process_time() - begun < PATIENCE


def test_folders_are_not_searched_without_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Neither for packages nor for the file that calls the macros of one which has no robot."""
    head = '<robot name="mini" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    (tmp_path / "robot.xacro").write_text(f'{head}<xacro:macro name="one"><link name="a"/></xacro:macro></robot>')
    for k in range(4 * VISITED):
        (tmp_path / f"{k}").mkdir()
    looked: list[str] = []
    sys.addaudithook(lambda event, given: looked.append(str(given[0])) if event == "os.scandir" else None)
    assert main(["inspect", str(tmp_path / "robot.xacro")]) == 2
    assert "it only defines macros: one" in capsys.readouterr().err
    assert sum(str(tmp_path) in folder for folder in set(looked)) <= 2 * VISITED + 10


def test_curves_that_unpack_to_gigabytes_are_not_read(tmp_path: Path) -> None:
    (tmp_path / "a.identified.json").write_text("{}")
    for curves, why in (
        (
            lambda file: np.savez_compressed(file, time=np.zeros(10**7)),
            "its curves unpack to far more than they should",
        ),
        (lambda file: file.write_bytes(b"PK\x03\x04nothing"), "BadZipFile"),
    ):
        curves(tmp_path / "a.identified.npz")
        with pytest.raises(RecordingError, match=f"not an identification: .*{why}"):
            page(tmp_path / "a.identified.json", "")


# -- what a recording names --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("table", [{"file": "{}"}, {"hand": {"path": [{"type": "poses", "file": "{}"}]}}])
def test_a_file_that_a_recording_names_for_its_motion_is_not_opened(
    table: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = load_experiment("track", ["time.duration=0.2"])
    robot = experiment.load_robot()
    experiment.loop(robot, PD(Feedback(500.0, 80.0))).run(tmp_path / "run.h5", meta={"config": experiment.to_json()})
    os.mkfifo(tmp_path / "pipe")
    config = json.loads(experiment.to_json())
    config["reference"] = json.loads(json.dumps(table).replace("{}", str(tmp_path / "pipe")))
    config["held_out"] = {}
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        del file["config"]
        file["config"] = json.dumps(config)
        file.attrs["experiment"] = "track"
    monkeypatch.chdir(tmp_path)
    tried: list[str] = []
    sys.addaudithook(lambda event, given: tried.append(str(given[0])) if event == "open" else None)
    assert main(["report", "run.h5", "--html", "r.html", "--no-replay"]) == 0
    found = held_out(Subject.of(Recording.open(tmp_path / "run.h5")))
    assert found.duration > 0 and np.isfinite(found.duration)
    assert str(tmp_path / "pipe") not in tried


# -- one door ----------------------------------------------------------------------------------------------------------

OWN = {  # modules that open files of ours, of Python, of the system, or what has gone through `files` before
    *("files.py", "compiled/folders.py", "loop/batch.py", "cli/docs.py"),
    *("deploy/embed/source.py", "lab/experiments/thesis.py", "lab/show/files.py", "lab/show/replay/page.py"),
    *("lab/study/worker.py", "torque/friction_features.py", "torque/learning_law.py", "recording/versions.py"),
    *("recording/run_file.py", "lab/show/export.py", "lab/show/bag.py"),
    "model/urdf/expanding.py",  # whose process watches all that it opens
    "model/urdf/meshes.py",  # of which `locate` finds plain files only, and `damage_of` bounds them
}


def test_files_of_others_are_opened_by_one_door() -> None:
    found = []
    for file in sorted((ROOT / "mmnn_pin").rglob("*.py")):
        name = str(file.relative_to(ROOT / "mmnn_pin"))
        for node in ast.walk(ast.parse(file.read_text())):
            if not isinstance(node, ast.Call):
                continue
            method = isinstance(node.func, ast.Attribute) and node.func.attr in ("read_text", "read_bytes")
            if method or (isinstance(node.func, ast.Name) and node.func.id == "open"):
                found += [f"{name}:{node.lineno}"] if name not in OWN else []
    assert found == []
