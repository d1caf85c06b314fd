"""What strangers hand in beside recordings: values of wrong types, rows of a database, requests to the server."""

from __future__ import annotations

import importlib
import json
import pkgutil
import random
import sqlite3
from collections.abc import Iterator
from contextlib import closing, redirect_stdout
from http.client import HTTPConnection
from io import StringIO

import pytest
from random_options import tried
from sound_files import contest, study

import mmnn_pin
from mmnn_pin.cli import main, mmnn
from mmnn_pin.errors import ConfigError, MmnnError, StudyError
from mmnn_pin.lab.show.replay.page import ReplayPage
from mmnn_pin.lab.study.results import load_results
from mmnn_pin.lab.study.store import NAME
from mmnn_pin.lab.study.verdict import verdict
from mmnn_pin.settings import Settings, Timing

WRONG = [None, True, -1, 0, 3, 10**20, 0.5, float("nan"), "x", "", b"a", [], [1], [1, "a"], (), {}, {"a": 1}, 1j, int]

# -- constructors ------------------------------------------------------------------------------------------------------


def kinds(of: type = Settings) -> Iterator[type]:
    for kind in of.__subclasses__():
        yield kind
        yield from kinds(kind)


def test_settings_of_wrong_types_raise_the_packages_error():
    for module in pkgutil.walk_packages(mmnn_pin.__path__, "mmnn_pin."):
        importlib.import_module(module.name)
    rng, tried, refused = random.Random(0), 0, 0
    for kind in kinds():
        names = kind.__struct_fields__
        for _ in range(20 * bool(names)):
            given = {name: rng.choice([*WRONG, object()]) for name in rng.sample(names, min(len(names), 2))}
            try:
                kind(**given)
            except MmnnError as error:
                assert "\n" not in str(error)
                refused += 1
            except TypeError as error:
                assert str(error).startswith("Missing required argument")
            tried += 1
    assert tried > 900 and refused > tried / 3


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"duration": "x"}, "Timing.duration: error: 'x' is a text: give a number"),
        ({"control_period": [1]}, "Timing.control_period: error: [1] is a list: give a number"),
        ({"duration": object()}, "Timing.duration: error: <object object at"),
    ],
)
def test_the_error_names_class_field_value_and_what_was_expected(given, says):
    with pytest.raises(ConfigError) as raised:
        Timing(**given)
    assert str(raised.value).startswith(says)
    with pytest.raises(TypeError, match="nonsense"):  # a slip of the caller's pen, no setting
        Timing(nonsense=1)


# -- commands ----------------------------------------------------------------------------------------------------------

SAFE = [name for name in mmnn.commands if name not in ("study", "tune", "readings", "run", "check", "replay", "ros2")]


def test_random_options_end_in_one_of_our_exit_codes():
    """Those that take long are tried by `python tests/random_options.py`, too."""
    counts, wrong = tried(150, 1, None, SAFE)
    assert wrong == [] and sum(counts.values()) == 150 and counts[2] > 50


def test_a_name_that_no_file_can_have_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for command in ("study {}", "plot {}", "readings {}", "run {}", "plot x.h5 --out {}/a.png"):
        assert main(command.format("a" * 300).split()) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and "internal error" not in said, said


# -- a study's database ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> bytes:
    folder = tmp_path_factory.mktemp("study")
    study(folder)
    return (folder / "db" / NAME).read_bytes()


ROWS = {
    "UPDATE rows SET metrics = '{' WHERE id = 1": "metrics of row 1 cannot be read",
    'UPDATE rows SET metrics = \'{"effort": "x"}\' WHERE id = 1': "row 1 cannot be read: Expected",
    "UPDATE rows SET parameters = '[]' WHERE id = 1": "row 1 cannot be read: Expected `object`",
    "UPDATE rows SET parameters = '{}' WHERE id = 1": "row 1 cannot be read: its masses.root is None",
    "UPDATE rows SET controller = 'x' WHERE id = 1": "row 1 cannot be read: its controller 'x' is none of the study's",
    "UPDATE rows SET status = 'won' WHERE id = 1": "row 1 cannot be read: Invalid enum value 'won'",
    "UPDATE rows SET time = 'x' WHERE id = 1": "row 1 cannot be read: Expected `float`",
    "UPDATE meta SET value = '3' WHERE key = 'controllers'": "the fact 'controllers' cannot be read: this is a whole",
    "UPDATE meta SET value = '[[[' WHERE key = 'units'": "the fact 'units' cannot be read",
    "DELETE FROM meta WHERE key = 'units'": "it does not hold the fact 'units'",
    "DELETE FROM meta WHERE key = 'file'": "it does not hold the fact 'file'",
    "UPDATE meta SET value = '{\"factors\": 3}' WHERE key = 'settings'": "its settings cannot be read",
    "CREATE VIEW more AS SELECT 1": "the view 'more' cannot be read",
    "CREATE TRIGGER more AFTER INSERT ON rows BEGIN SELECT 1; END": "the trigger 'more' cannot be read",
    "DROP TABLE rows": "cannot read the database: no such table: rows",
}


@pytest.mark.parametrize("change", ROWS)
def test_a_database_that_we_did_not_write_is_one_line(change, sound, tmp_path):
    file = tmp_path / NAME
    file.write_bytes(sound)
    assert len(load_results(file).rows) == 6
    with closing(sqlite3.connect(file)) as db, db:
        db.execute(change)
    with pytest.raises(StudyError) as raised:
        load_results(file)
    assert ROWS[change] in str(raised.value) and "\n" not in str(raised.value)
    assert str(raised.value).startswith(f"{file}: error: ")
    with redirect_stdout(StringIO()):
        assert main(["export", str(file), "--to", "csv", "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("point", [2**63 - 1, -(2**63), 10**12])
def test_numbers_of_points_are_names_and_no_places(point, sound, tmp_path):
    (file := tmp_path / NAME).write_bytes(sound)
    with closing(sqlite3.connect(file)) as db, db:
        db.execute(f"UPDATE rows SET point = {point} WHERE point = 1")
    (tmp_path / "sound.sqlite").write_bytes(sound)
    found, expected = (verdict(load_results(one)) for one in (file, tmp_path / "sound.sqlite"))
    assert (found.controller, found.success) == (expected.controller, expected.success)


def test_a_text_of_a_gigabyte_is_not_read(sound, tmp_path):
    file = tmp_path / NAME
    file.write_bytes(sound)
    with closing(sqlite3.connect(file)) as db, db:
        db.execute("UPDATE rows SET metrics = zeroblob(60000000) WHERE id = 1")
    with pytest.raises(StudyError, match="cannot read the database: string or blob too big"):
        load_results(file)


def test_a_damaged_text_in_the_list_of_tables_is_one_line(sound, tmp_path):
    file = tmp_path / NAME
    file.write_bytes(sound.replace(b"CREATE TABLE rows", b"CREATE TABLE ro\xffs", 1))
    with pytest.raises(StudyError, match="cannot read the database: "):
        load_results(file)


def test_a_contest_that_lost_windows_of_a_curve_is_drawn_as_far_as_all_go(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    contest(tmp_path / "contest")
    rows = json.loads((tmp_path / "contest" / "rows.json").read_bytes())
    rows["eight/two_layer"]["rows"][0]["curve"].pop()
    (tmp_path / "contest" / "rows.json").write_text(json.dumps(rows))
    with redirect_stdout(StringIO()):
        assert main(["plot", "contest", "--what", "contest-learning", "--out", "out"]) == 0


def test_a_contest_with_a_squared_error_below_0_is_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    contest(tmp_path / "contest")
    rows = json.loads((tmp_path / "contest" / "rows.json").read_bytes())
    rows["eight/two_layer"]["rows"][0]["curve"][0][0] = -1.0
    (tmp_path / "contest" / "rows.json").write_text(json.dumps(rows))
    assert main(["report", "contest", "--html", "out.html"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "the curve of two_layer has a squared error below 0" in line


@pytest.mark.parametrize("value", [1e300, -1.0])
def test_a_contest_with_an_error_that_is_none_is_one_line(value, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    contest(tmp_path / "contest")
    rows = json.loads((tmp_path / "contest" / "rows.json").read_bytes())
    first = rows["eight/two_layer"]["rows"][0]["rms"]
    first[next(iter(first))] = value
    (tmp_path / "contest" / "rows.json").write_text(json.dumps(rows))
    assert main(["report", "contest", "--html", "out.html"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"an error of {value:g}" in line


# -- the replay's server -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Host": "localhost:1"}, 200),
        ({"Origin": "http://127.0.0.1:1"}, 200),
        ({"Host": "evil.example:80"}, 403),  # a name that leads to this machine
        ({"Host": ""}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
    ],
)
def test_a_foreign_page_gets_nothing_from_the_server(headers, status):
    with ReplayPage("<p>mine</p>").served(0) as url:
        host, port = url.removeprefix("http://").rstrip("/").split(":")
        assert host == "127.0.0.1"
        connection = HTTPConnection(host, int(port), timeout=10)
        connection.request("GET", "/", headers=headers)
        answer = connection.getresponse()
        assert (answer.status, b"mine" in answer.read()) == (status, status == 200)


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("1" * 200_000, "log.csv:2: error: not a CSV file"),
        ("1, 1e200, 0, 0", "is 1e+200 in sample 1: nothing measures"),
    ],
)
def test_a_log_that_nothing_measured_is_one_line(row, says, tmp_path, capsys):
    joints = "position.arm_1_joint,effort.arm_1_joint,velocity.arm_1_joint"
    (tmp_path / "log.csv").write_text(f"time,{joints}\n0,0,0,0\n{row}\n" if "e" in row else f"time\n{row}\n")
    words = ["identify", str(tmp_path / "log.csv"), "--robot", "two_axis_arm", "--out", str(tmp_path / "out")]
    assert main(words) == 2
    said = capsys.readouterr().err
    assert says in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


def test_a_state_that_is_no_text_is_one_line(tmp_path, capsys):
    (tmp_path / "state.json").write_bytes(b'{"\x89": 1}')
    assert main(["model", "platform_arm", "--at", str(tmp_path / "state.json")]) == 2
    assert "state.json: error: not valid JSON" in capsys.readouterr().err
