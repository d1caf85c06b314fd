"""What strangers hand in beside recordings: values of wrong types, results of a study, requests to the server."""

from __future__ import annotations

import importlib
import json
import pkgutil
import random
from collections.abc import Iterator
from contextlib import ExitStack, nullcontext, redirect_stdout, suppress
from http.client import HTTPConnection
from io import StringIO
from socket import create_connection
from typing import Any

import pytest
from random_options import tried
from sound_files import study

import mmnn_pin
from mmnn_pin import Stepper, StepperSettings, compare, load
from mmnn_pin.cli import main, mmnn
from mmnn_pin.errors import ConfigError, MmnnError, StudyError, UnknownArgument
from mmnn_pin.lab.show.replay.page import ReplayPage
from mmnn_pin.lab.study.results import load_results
from mmnn_pin.lab.study.store import NAME
from mmnn_pin.lab.study.verdict import verdict
from mmnn_pin.safety import Safety
from mmnn_pin.settings import Settings, Timing

WRONG = [None, True, -1, 0, 3, 10**20, 0.5, float("nan"), "x", "", b"a", [], [1], [1, "a"], (), {}, {"a": 1}, 1j, int]

# -- constructors ------------------------------------------------------------------------------------------------------


def kinds(of: type = Settings) -> Iterator[type]:
    for kind in of.__subclasses__():
        yield kind
        yield from kinds(kind)


def test_settings_of_wrong_types_raise_the_packages_error():
    for module in pkgutil.walk_packages(mmnn_pin.__path__, "mmnn_pin."):
        with suppress(ModuleNotFoundError) if ".ros2." in module.name else nullcontext():  # without rclpy
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


@pytest.mark.parametrize(
    "make", [Timing, load, compare, Safety, StepperSettings, lambda **given: Stepper(None, None, **given)]
)
def test_an_argument_that_does_not_exist_is_one_line_with_the_near_ones(make):
    with pytest.raises(UnknownArgument, match=r"^\w+: error: unknown argument 'nonsense': there is: \w+, ") as raised:
        make(nonsense=1)
    assert isinstance(raised.value, TypeError)
    with pytest.raises(UnknownArgument, match="did you mean 'duration'"):
        Timing(duratoin=1.0)


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


# -- a study's results ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> bytes:
    folder = tmp_path_factory.mktemp("study")
    study(folder)
    return (folder / "db" / NAME).read_bytes()


LINES: dict[str, tuple[int, str, Any, str]] = {  # number of the line, key, value (None: none), what is said
    "a metric": (2, "metrics", {"effort": "x"}, "line 2 cannot be read: metrics[...]: this is a text, give a number"),
    "parameters": (2, "parameters", [], "line 2 cannot be read: parameters: this is a list, give a table"),
    "no parameters": (2, "parameters", {}, "row 0 cannot be read: its masses.root is None"),
    "controller": (3, "controller", "x", "row 1 cannot be read: its controller 'x' is none of the study's"),
    "status": (3, "status", "won", "line 3 cannot be read: status: Invalid enum value 'won'"),
    "time": (3, "time", "x", "line 3 cannot be read: time: this is a text, give a number"),
    "controllers": (1, "controllers", 3, "controllers: this is a whole number, give a list"),
    "units": (1, "units", [[[]]], "units: this is a list, give a table"),
    "no units": (1, "units", None, "the key 'units' is missing"),
    "settings": (1, "settings", {"factors": 3}, "its settings cannot be read"),
}


@pytest.mark.parametrize("change", LINES)
def test_results_that_we_did_not_write_are_one_line(change, sound, tmp_path):
    number, key, value, words = LINES[change]
    file = tmp_path / NAME
    file.write_bytes(sound)
    assert len(load_results(file).rows) == 6
    lines = sound.decode().splitlines(keepends=True)
    table = json.loads(lines[number - 1]) | {key: value}
    lines[number - 1] = json.dumps({name: v for name, v in table.items() if v is not None}) + "\n"
    file.write_text("".join(lines))
    with pytest.raises(StudyError) as raised:
        load_results(file)
    assert words in str(raised.value) and "\n" not in str(raised.value)
    assert str(raised.value).startswith(f"{file}: error: ")
    with redirect_stdout(StringIO()):
        assert main(["export", str(file), "--to", "csv", "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("point", [2**63 - 1, -(2**63), 10**12])
def test_numbers_of_points_are_names_and_no_places(point, sound, tmp_path):
    (file := tmp_path / NAME).write_bytes(sound.replace(b'"point": 1,', f'"point": {point},'.encode()))
    (tmp_path / "sound.jsonl").write_bytes(sound)
    found, expected = (verdict(load_results(one)) for one in (file, tmp_path / "sound.jsonl"))
    assert (found.controller, found.success) == (expected.controller, expected.success)


@pytest.mark.parametrize("end", [b"", b"\n"])
def test_a_line_of_a_gigabyte_is_not_read(end, sound, tmp_path):
    file = tmp_path / NAME
    file.write_bytes(sound + b" " * 60_000_000 + end)
    with pytest.raises(StudyError, match="cannot read the results: a line is too long"):
        load_results(file)


def test_a_text_that_is_no_utf8_is_one_line(sound, tmp_path):
    file = tmp_path / NAME
    file.write_bytes(sound.replace(b"completed", b"compl\xffted", 1))
    with pytest.raises(StudyError, match="line 2 cannot be read: 'utf-8' codec can't decode"):
        load_results(file)


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


@pytest.mark.parametrize(
    "name", ["a" * 200_000, '"' + "a," * 100_000 + '"', "q_" + "1" * 5000, "a" + " " * 100_000 + "b"]
)
def test_a_name_of_a_column_that_is_far_too_long_is_one_line(name, tmp_path, capsys):
    (tmp_path / "log.csv").write_text(f"time,position.arm_1_joint,{name}\n0,0,0\n1,1,1\n")
    assert main(["identify", str(tmp_path / "log.csv"), "--robot", "two_axis_arm", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "log.csv:1: error: not a CSV file: " in said and said.count("\n") == 1 and len(said) < 2000


DEEP = "[" * 100_000
DEEP_FILES = {
    "meta/info.json": "identify . --robot two_axis_arm --out out",
    "a.identified.json": "run track --controller adaptive --set adaptive.start=a.identified.json --out out",
    "a.json": "model platform_arm --at a.json",
}


@pytest.mark.parametrize("file", DEEP_FILES)
def test_json_that_is_nested_without_end_is_one_line(file, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(DEEP)
    assert main(DEEP_FILES[file].split()) == 2
    (line,) = (one for one in capsys.readouterr().err.splitlines() if "error: " in one)
    assert "internal" not in line


def test_a_state_that_is_no_text_is_one_line(tmp_path, capsys):
    (tmp_path / "state.json").write_bytes(b'{"\x89": 1}')
    assert main(["model", "platform_arm", "--at", str(tmp_path / "state.json")]) == 2
    assert "state.json: error: not valid JSON" in capsys.readouterr().err


def answer_to(place: tuple[str, int], request: bytes) -> bytes:
    """The first bytes of what a server says to a request; nothing where it hangs up on one that is too long."""
    with create_connection(place, timeout=10) as socket, suppress(ConnectionError):
        socket.sendall(request)
        return socket.recv(100)
    return b""


def test_requests_that_never_end_hold_nobody_up_and_odd_ones_get_nothing():
    host = b" HTTP/1.1\r\nHost: 127.0.0.1\r\n"
    odd = {b"GET /../../etc/passwd" + host: b"404", b"GET /%2e%2e/%2e%2e/etc/passwd" + host: b"404"}
    odd |= {b"GET /" + b"a" * 200_000 + host: b"414", b"GET /" + host + b"A: b\r\n" * 5_000: b"431"}
    odd |= {b"POST /" + host + b"Content-Length: 10000000000\r\n": b"501", b"\x00\xff\r\n": b"Error resp"}
    with ReplayPage("<p>mine</p>").served(0) as url, ExitStack() as slow:
        name, port = url.removeprefix("http://").rstrip("/").split(":")
        for _ in range(100):
            slow.enter_context(create_connection((name, int(port)), timeout=10)).sendall(b"GET /" + host)
        for request, status in odd.items():
            answer = answer_to((name, int(port)), request + b"\r\n")
            assert status in answer or (not answer and len(request) > 10_000)
        assert b"200 OK" in answer_to((name, int(port)), b"GET /" + host + b"\r\n")
