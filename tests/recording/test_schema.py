"""A recording that a stranger made, or that a disk damaged: one line that names what is wrong, and the rest is read."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pytest
from sound_files import old_recording
from test_recording import DONE, LAYOUT, META, record, rows_of

from mmnn_pin.cli import main
from mmnn_pin.errors import ConfigError, InputError, RecordingError
from mmnn_pin.lab.experiments.config import recorded_experiment
from mmnn_pin.recording.metrics import metrics
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.recording.recording import Recording, recorded_robot
from mmnn_pin.recording.robot_file import UNSEEN

Change = Callable[[h5py.File], object]


def replaced(name: str, **made: object) -> Change:
    """Another dataset in the place of one, with its attributes."""

    def change(file: h5py.File) -> None:
        attributes = dict(file[name].attrs)
        del file[name]
        file.create_dataset(name, **made)
        file[name].attrs.update(attributes)

    return change


def linked(name: str, link: object) -> Change:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = link

    return change


def attribute(name: str, value: object, of: str = "/") -> Change:
    return lambda file: file[of].attrs.__setitem__(name, value)


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((50, 2), "f8")
    layout[:] = h5py.VirtualSource("/etc/passwd", "z", (50, 2))
    del file["signals/z"]
    file.create_virtual_dataset("signals/z", layout)


@pytest.fixture
def file(tmp_path) -> Path:
    record(rows_of(50), tmp_path / "run.h5")
    return tmp_path / "run.h5"


def changed(file: Path, change: Change) -> Path:
    with h5py.File(file, "r+") as opened:
        change(opened)
    return file


# -- refused as a whole ------------------------------------------------------------------------------------------------

FOREIGN: dict[str, tuple[Change, str]] = {
    "soft link": (linked("signals/z", h5py.SoftLink("/signals/e")), "signals/z is not read: it is a link"),
    "external link": (linked("signals/z", h5py.ExternalLink("/etc/x.h5", "/z")), "signals/z is not read: it is a link"),
    "linked group": (linked("timing", h5py.ExternalLink("x.h5", "/")), "timing is not read: it is a link"),
    "linked urdf": (linked("urdf", h5py.SoftLink("/config")), "urdf is not read: it is a link"),
    "external storage": (
        replaced("signals/z", shape=(50, 2), dtype="f8", external=[("/etc/passwd", 0, 800)]),
        "signals/z is not read: its numbers are in another file",
    ),
    "virtual": (virtual, "signals/z is not read: its numbers are in another file"),
    "filter": (replaced("signals/z", shape=(50, 2), dtype="f8", scaleoffset=3), "signals/z is not read: filter 6"),
    "a terabyte": (
        replaced("signals/z", shape=(2**36, 2), dtype="f8", chunks=(64, 2)),
        "signals/z is not read: with it the file says it holds 1,099,5",
    ),
    "a packed gigabyte": (
        replaced("signals/z", shape=(2**26, 2), dtype="f8", chunks=(2**20, 2), compression="gzip"),
        "signals/z is not read: with it the file says it holds 1,07",
    ),
    "a chunk of a gigabyte": (
        replaced("signals/z", shape=(50, 2), maxshape=(None, 2), dtype="f8", chunks=(2**26, 2)),
        "signals/z is not read: with it the file says it holds 1,07",
    ),
    "fact of a wrong type": (attribute("robot", 5), "its attribute 'robot': 5 is a whole number: expected a text"),
    "names of a wrong type": (attribute("velocity_names", 'json:[1, "w"]'), "its attribute 'velocity_names'"),
    "limits of other motors": (attribute("effort_limits", "json:[1.0]"), "its attribute 'effort_limits': [1.0] for "),
    "no period": (attribute("control_period", -1.0), "its attribute 'control_period': -1.0 s"),
    "broken JSON": (attribute("gains", "json:{"), "its attribute 'gains' cannot be read: "),
    "deep JSON": (attribute("gains", f"json:{'[' * 99}{']' * 99}"), "it is nested more than 32 levels deep"),
    "deeper JSON": (attribute("gains", "json:" + "[" * 100_000), "its attribute 'gains' cannot be read: "),
    "a table of numbers": (
        attribute("seed", np.zeros((2, 2))),
        "its attribute 'seed' cannot be read: it has the shape",
    ),
    "a reference": (
        lambda file: attribute("seed", file.ref)(file),
        "its attribute 'seed' cannot be read: it is of the",
    ),
    "a seed below 0": (attribute("seed", -5), "its attribute 'seed': -5: use an integer from 0 to 2^63 - 1"),
    "no UTF-8": (attribute("robot", b"\xff\xfe"), "its attribute 'robot' cannot be read: "),
    "no outcome": (lambda file: file.attrs.__delitem__("outcome"), "its attribute 'outcome': None: no run ends so"),
    "odd outcome": (attribute("outcome", "won"), "its attribute 'outcome': 'won': no run ends so"),
    "endless outcome": (attribute("outcome_time", np.inf), "its attribute 'outcome_time': inf: no run ends so"),
    "odd version": (attribute("format_version", "new"), "its format version is 'new'"),
    "odd completeness": (attribute("complete", "yes"), "not a recording"),
    "no time": (lambda file: file.__delitem__("signals/time"), "it has no signals/time"),
    "many members": (lambda file: [file.create_group(f"g{i}") for i in range(1001)], "/ has 1,005 members"),
    "many signals": (lambda file: [file.create_group(f"signals/s{i}") for i in range(1001)], "/signals has 1,0"),
    "no group": (linked("signals", h5py.SoftLink("/")), "signals is not read: it is a link"),
    "an array for a group": (replaced("signals", data=np.zeros(3)), "it has no signals/time: it is no group of arrays"),
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_what_none_of_our_files_has_is_refused_in_one_line(kind, file, capsys):
    change, says = FOREIGN[kind]
    changed(file, change)
    with pytest.raises(RecordingError) as raised:
        Recording.open(file)
    assert says in str(raised.value) and str(raised.value).startswith(f"{file}: error: ")
    assert "\n" not in str(raised.value)


def test_a_file_that_lies_about_its_size_is_refused_before_memory_is_taken(file):
    import tracemalloc

    changed(file, FOREIGN["a packed gigabyte"][0])
    tracemalloc.start()
    with pytest.raises(RecordingError):
        Recording.open(file)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


# -- damaged in one place ----------------------------------------------------------------------------------------------

DAMAGE: dict[str, tuple[Change, str, str]] = {
    "integers": (replaced("signals/z", data=np.zeros((50, 2), "i4")), "signals/z", "its numbers are of the type int32"),
    "texts": (replaced("signals/z", data=np.full((50, 2), b"a")), "signals/z", "its numbers are of the type |S1"),
    "columns": (replaced("signals/z", data=np.zeros((50, 3))), "signals/z", "it has 3 columns and 2 labels"),
    "shape": (replaced("signals/z", data=np.zeros((50, 2, 2))), "signals/z", "it has the shape (50, 2, 2)"),
    "empty": (replaced("signals/z", data=h5py.Empty("f8")), "signals/z", "it has the shape None"),
    "rows": (replaced("signals/z", data=np.zeros((49, 2))), "signals/z", "it has 49 rows, the others 50"),
    "unit": (attribute("unit", "km", "signals/z"), "signals/z", "its unit is 'km', not 'm/s, rad/s'"),
    "labels": (attribute("labels", ["v", "u"], "signals/z"), "signals/z", "its columns are 'v, u', not 'v, w'"),
    "a group": (linked("signals/z", h5py.Group), "signals/z", "it is no array"),
    "unknown": (replaced("signals/z", data=np.zeros((50, 2))), "signals/zz", "this mmnn_pin knows no such signal"),
    "final": (lambda file: file.create_group("final/nu"), "final/nu", "it is no array"),
    "timing": (
        replaced("timing/step_time", data=np.zeros(50, "S2")),
        "timing/step_time",
        "its numbers are of the type",
    ),
    "urdf": (replaced("urdf", data=np.zeros(3)), "urdf", "it is no text"),
    "time": (lambda file: file["signals/time"].__setitem__(7, 0.001), "signals/time", "row 7 is at 0.001 s, the one b"),
    "far": (lambda file: file["signals/time"].__setitem__(-1, 1e300), "signals/time", "it is from 0 to 1e+300 s, and "),
    "no time": (lambda file: file["signals/time"].__setitem__(7, np.nan), "signals/time", "row 7 is at nan s"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_part_is_named_and_leaves_the_others(kind, file, tmp_path, capsys):
    change, where, why = DAMAGE[kind]
    sound = Recording.open(file)["e"]
    if kind == "a group":
        change = lambda file: (file.__delitem__("signals/z"), file.create_group("signals/z"))  # noqa: E731
    if kind == "unknown":
        change = lambda file: file.move("signals/z", "signals/zz")  # noqa: E731
    recording = Recording.open(changed(file, change))
    assert list(recording.damage) == [where] and recording.damage[where].startswith(why)
    np.testing.assert_array_equal(recording["e"], sound)
    group, _, name = where.partition("/")
    with pytest.raises(RecordingError, match=f"{where} is damaged"):
        _ = {"signals": lambda: recording[name], "final": lambda: recording.final, "urdf": lambda: recording.urdf}.get(
            group, lambda: recording.step_times
        )()
    with pytest.raises(RecordingError, match=f"{where} is damaged"):
        metrics(recording, [(0.0, 1.0)])  # numbers are of whole recordings
    code = main(["export", str(file), "--to", "csv", "--out", str(tmp_path / "x.csv")])
    assert f"warning: {file}: {where} is damaged and left out: {why}" in capsys.readouterr().err
    assert code == (2 if where == "urdf" else 0)  # the URDF says which units a joint's columns have
    assert code == 2 or "e.joint1 [rad]" in (tmp_path / "x.csv").read_text()


def test_five_hundred_unknown_signals_are_one_warning(file, tmp_path, capsys):
    def change(stored: h5py.File) -> None:
        for k in range(500):
            stored.copy("signals/z", f"signals/zz{k:03}")

    assert len(Recording.open(changed(file, change)).damage) == 500
    assert main(["export", str(file), "--to", "csv", "--out", str(tmp_path / "x.csv")]) == 0
    warnings = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: ")]
    assert len(warnings) == 1 and "signals/zz000 and 499 more are damaged and left out: " in warnings[0]


CONFIGS = ["5", "[]", '{"adaptive": 5}', '{"adaptive_composite": "memory"}', '{"adaptive": {"initial": []}}']


@pytest.mark.parametrize("text", CONFIGS)
def test_a_config_that_is_none_is_told(text, file):
    with h5py.File(file, "r+") as opened:
        opened.pop("config", None)
        opened["config"] = text
    with pytest.raises(RecordingError, match="its config cannot be read"):
        recorded_experiment(Recording.open(file))


def test_a_heap_in_which_hdf5_would_go_round_for_ever_is_refused(file):
    """Without the check the first text is never read; its free room says that it takes none."""
    assert len(Recording.open(file)) == 50
    data = bytearray(file.read_bytes())
    found = 0
    for heap in (place for place in range(len(data)) if data.startswith(b"GCOL", place)):
        size, place = int.from_bytes(data[heap + 8 : heap + 16], "little"), heap + 16
        while place + 16 <= heap + size and data[place : place + 2] != b"\0\0":
            place += 16 + (int.from_bytes(data[place + 8 : place + 16], "little") + 7) // 8 * 8
        if place + 16 <= heap + size:
            data[place + 8 : place + 16] = bytes(8)
            found += 1
    assert found
    file.write_bytes(data)
    with pytest.raises(RecordingError, match="cannot read the recording: its texts are damaged"):
        Recording.open(file)
    with Recorder(LAYOUT, META, file, force=True) as recorder:  # nor is it looked into where a run replaces it
        recorder.finish(DONE)
    assert len(Recording.open(file)) == 0


def test_heaps_upon_heaps_take_no_time(file):
    file.write_bytes(file.read_bytes() + 2_000_000 * b"GCOL\x01\0\0\0\0\0\x10\0\0\0\0\0")
    with pytest.raises(RecordingError, match="its texts are damaged"):
        Recording.open(file)


def test_a_flipped_byte_anywhere_is_a_recording_or_one_line(file):
    """Thirty bytes all over the file's structure; the fuzzer goes on from here."""
    data = file.read_bytes()
    places = np.flatnonzero(np.frombuffer(data, np.uint8))
    for at in places[:: len(places) // 30]:
        file.write_bytes(data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])
        try:
            recording = Recording.open(file)
            assert "e" in recording.damage or recording["e"].shape == (50, 2) or recording.damage
        except RecordingError as error:
            assert str(file) in str(error) and "\n" not in str(error)


def test_what_a_recorder_is_told_is_held_to_the_same_schema(tmp_path):
    for key, value in {"robot": 5, "velocity_names": ("v", 3, "a", "b"), "control_period": 0.0, "safety": [1]}.items():
        with pytest.raises(ConfigError, match=f"meta.{key}: error: "):
            Recorder(LAYOUT, META | {key: value}, tmp_path / "run.h5")
    assert not list(tmp_path.iterdir())


def test_a_sound_recording_and_an_old_one_have_no_damage(file, tmp_path):
    assert Recording.open(file).damage == {}
    old = Recording.open(old_recording(tmp_path / "old.h5"))
    assert old.damage == {} and len(old) == 10 and recorded_robot(old).name == "platform_arm"


# -- plausible, and impossible -----------------------------------------------------------------------------------------


def test_numbers_of_another_machine_are_read_in_this_ones_order(file):
    sound = Recording.open(file)
    numbers = {name: sound[name] for name in ("time", "z")}
    for name, values in numbers.items():
        changed(file, replaced(f"signals/{name}", data=values.astype(">f8")))
    again = Recording.open(file)
    assert again.damage == {} and all(again[name].dtype.isnative for name in numbers)
    for name, values in numbers.items():
        np.testing.assert_array_equal(again[name], values)


@pytest.mark.parametrize("kind", ["damping", "coulomb", "breakaway", "stribeck"])
def test_friction_that_drives_is_refused_with_its_name(kind, tmp_path):
    path = changed(old_recording(tmp_path / "old.h5"), attribute("joint_friction", f'json:{{"{kind}": -1.0}}'))
    with pytest.raises(RecordingError, match=f"'{kind}' of joint_friction is negative or not finite"):
        recorded_robot(Recording.open(path))


TIMES = {"ms": 1e3, "us": 1e6}


@pytest.mark.parametrize("unit", TIMES)
@pytest.mark.parametrize("command", ["export", "prove", "report", "replay", "identify"])
def test_times_in_another_unit_end_no_command_in_an_internal_error(command, unit, tmp_path, capsys):
    path = old_recording(tmp_path / "old.h5")
    with h5py.File(path, "r+") as opened:
        opened["signals/time"][...] *= TIMES[unit]
    line = {
        "export": ["--to", "csv", "--out", str(tmp_path / "x.csv")], "report": ["--html", str(tmp_path / "x.html")],
        "replay": ["--html", str(tmp_path / "y.html")], "identify": ["--robot", "platform_arm", "--check"],
    }.get(command, [])  # fmt: skip
    assert main([command, str(path), *line]) in (0, 2)
    assert "internal error" not in capsys.readouterr().err


# -- texts are data ----------------------------------------------------------------------------------------------------

MESH = '<link name="hull"><visual><geometry><mesh filename="{}"/></geometry></visual></link></robot>'
STL = (
    b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
)


def with_mesh(file: Path, mesh: str, urdf_file: str, **overrides: object) -> Recording:
    """An old recording whose robot has a part with a mesh, and says where its file was."""
    path = old_recording(file)
    with h5py.File(path, "r+") as opened:
        text = opened["urdf"].asstr()[()].replace("</robot>", MESH.format(mesh))
        joint = '<joint name="hull" type="fixed"><parent link="base_link"/><child link="hull"/></joint></robot>'
        del opened["urdf"]
        opened["urdf"] = text.replace("</robot>", joint)
        opened.attrs["urdf_file"], opened.attrs["overrides"] = urdf_file, f"json:{json.dumps(overrides)}"
    return Recording.open(path)


@pytest.fixture
def opened_files(monkeypatch) -> list[str]:
    """Names of all files that Python opens from now on."""
    names: list[str] = []
    sys.addaudithook(lambda event, given: names.append(str(given[0])) if event == "open" else None)
    return names


@pytest.mark.parametrize("name", ["{}/x.stl", "file://{}/x.stl", "x.stl", "package://secret/x.stl"])
def test_a_recording_makes_nobody_read_a_mesh(name, tmp_path, opened_files):
    secret = tmp_path / "secret"
    secret.mkdir()
    (secret / "x.stl").write_bytes(STL)
    (secret / "x.urdf").write_text("<robot name='another'><link name='a'/></robot>")
    recording = with_mesh(
        tmp_path / "run.h5", name.format(secret), str(secret / "x.urdf"), package_dirs=["/", str(tmp_path)]
    )
    before = len(opened_files)
    robot = recorded_robot(recording)
    assert not [one for one in opened_files[before:] if one.endswith(".stl")]
    assert UNSEEN in robot.urdf
    given = recorded_robot(recording, [tmp_path, secret])  # the user named the folder
    assert UNSEEN not in given.urdf


def test_meshes_are_read_where_the_robots_own_file_still_lies(tmp_path):
    (tmp_path / "x.stl").write_bytes(STL)
    recording = with_mesh(tmp_path / "run.h5", "x.stl", str(tmp_path / "own.urdf"))
    assert UNSEEN in recorded_robot(recording).urdf
    (tmp_path / "own.urdf").write_text(recording.urdf)
    assert UNSEEN not in recorded_robot(recording).urdf
    (tmp_path / "own.urdf").write_text(recording.urdf.replace('value="', 'value="1', 1))
    assert UNSEEN in recorded_robot(recording).urdf


EVIL = "import pathlib\npathlib.Path('ran').touch()\nclass Evil: pass\n"


@pytest.mark.parametrize("place", ["meta", "config", "both"])
def test_a_law_that_a_recording_names_is_not_run(place, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text(EVIL)
    with h5py.File(old_recording(tmp_path / "run.h5"), "r+") as file:
        if place != "config":
            file.attrs["controller"] = "Evil"
            file.attrs["law"] = 'json:{"class": "evil.Evil", "file": "evil.py", "sha256": "0"}'
            file.attrs["controller_settings"] = 'json:{"feedback": {"base": 500.0, "arm": 80.0}, "learning": true}'
        if place != "meta":
            laws = {name: {"law": "evil.py:Evil"} for name in ("Evil",)}
            config = {"controllers": ["Evil"], "laws": laws, "nominal": {"robot": "evil.urdf"}}
            file["config"] = json.dumps(config)
    (tmp_path / "evil.urdf").write_text("<robot name='x' xmlns:xacro='http://ros.org/wiki/xacro'/>")
    for command in ("export run.h5 --to npz", "report run.h5 --html r.html --no-replay", "replay run.h5 --html p.html"):
        assert main(command.split()) in (0, 2)
    assert "internal error" not in capsys.readouterr().err
    assert not (tmp_path / "ran").exists()
    from mmnn_pin.lab.psi.learner import controller_of

    recording = Recording.open(tmp_path / "run.h5")
    with suppress(InputError):
        controller_of(recording, recorded_robot(recording))
    assert not (tmp_path / "ran").exists()


def test_a_learner_without_its_settings_is_refused_before_anything_is_fitted(tmp_path, monkeypatch):
    """Its gains would be fitted to the robot along the recorded reference, seconds of work, to find them different."""
    from mmnn_pin.lab.experiments.experiment import Experiment
    from mmnn_pin.lab.psi.learner import controller_of

    with h5py.File(old_recording(tmp_path / "run.h5"), "r+") as file:
        file.attrs["controller"], file.attrs["controller_settings"] = "adaptive", "json:{}"
    monkeypatch.setattr(Experiment, "fit", lambda *_: pytest.fail("fitted"))
    recording = Recording.open(tmp_path / "run.h5")
    with pytest.raises(RecordingError, match="the recording does not tell the settings of adaptive"):
        controller_of(recording, recorded_robot(recording))


def test_facts_that_are_missing_are_told_where_they_are_needed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with h5py.File(old_recording(tmp_path / "run.h5"), "r+") as file:
        del file.attrs["urdf_sha256"]
    assert main(["report", "run.h5", "--html", "r.html", "--no-replay"]) == 0
    assert "not recorded" in (tmp_path / "r.html").read_text()
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        del file.attrs["control_period"]
    assert main(["report", "run.h5", "--html", "r.html", "--no-replay", "--force"]) == 2
    assert capsys.readouterr().err == "run.h5: error: two_layer does not have its control period\n"


def test_a_report_of_a_recording_that_knows_no_limits_is_made(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with h5py.File(old_recording(tmp_path / "run.h5"), "r+") as file:
        for name in ("effort_limits", "actuator_names"):
            file.attrs.pop(name, None)
    assert main(["report", "run.h5", "--html", "r.html", "--no-replay"]) == 0
    assert "at its limit" not in (tmp_path / "r.html").read_text()


def test_rows_of_years_apart_or_before_0_are_shown_or_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for at, to, says in ((-1, 2e9, ""), (0, -5.0, "begins at -5 s, and a log has no times before 0")):
        with h5py.File(old_recording(tmp_path / "run.h5"), "r+") as file:
            file["signals/time"][at] = to
        assert main(["replay", "run.h5", "--html", "p.html", "--force"]) == 0
        assert main(["export", "run.h5", "--to", "mcap", "--out", "x.mcap", "--force"]) == (2 if says else 0)
        assert says in capsys.readouterr().err


def test_no_recording_by_a_name_that_leads_elsewhere(tmp_path):
    os.mkfifo(tmp_path / "pipe.h5")
    for name in ("pipe.h5", "nothing.h5"):
        with pytest.raises(RecordingError, match="no such recording"):
            Recording.open(tmp_path / name)


@pytest.mark.parametrize("left", [(), ("time",)])
def test_a_recording_of_no_signals_is_one_line_for_all_that_read_it(left, tmp_path, capsys):
    file = old_recording(tmp_path / "run.h5")
    with h5py.File(file, "r+") as run:
        for name in {*run["signals"]} - {*left}:
            run[f"signals/{name}"].attrs["unit"] = "furlong"
    out = tmp_path / "out"
    words = ["replay {} --html {}.html", "report {} --html {}.html --no-replay", "plot {} --out {}", "judge {}"]
    words += [f"export {{}} --to {to} --out {{}}" for to in ("npz", "lerobot", *(() if left else ("csv", "mcap")))]
    for command in words:
        assert main(command.format(file, out).split()) == (0 if left and " npz" in command else 2), command
        lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("warning: ")]
        assert len(lines) == (0 if left and " npz" in command else 1) and "internal" not in "".join(lines), lines
        assert not out.exists() or left
