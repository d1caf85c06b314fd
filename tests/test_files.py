"""Files are read within limits and written whole or not at all: TOML, single files, folders, locks."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest
import yaml
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mmnn_pin import Recording
from mmnn_pin.errors import ConfigError, RecordingError, StudyError
from mmnn_pin.files import (
    DEEPEST,
    LONGEST,
    locked,
    make_private,
    parsed_toml,
    quoted,
    read_toml,
    way_in,
    whole_file,
    whole_folder,
)
from mmnn_pin.lab.study.store import writing
from mmnn_pin.recording.recorder import Recorder
from mmnn_pin.signals import Layout

# -- TOML --------------------------------------------------------------------------------------------------------------

FAR_TOO_MUCH = {
    "a key of 500,000 parts": ("a" + ".a" * 499_990 + "=1", "not valid TOML: it is nested more than 32 levels deep"),
    "of quoted parts": ("x = 1\n" + '"a".' * 60 + "b = 1", "f.toml:2: error: not valid TOML: it is nested more than"),
    "in a table's name": ("[" + "a . " * 60 + "b]", "f.toml:1: error: not valid TOML: it is nested more than"),
    "brackets": ("x = " + "[" * 200_000, "not valid TOML: it is nested more than 32 levels deep"),
    "tables in one line": ("x = " + "{a=" * 40 + "1" + "}" * 40, "not valid TOML: it is nested more than 32 levels"),
    "both together": ("\n".join(f"[{'.'.join('a' * 20)}]\nx{k} = {'[' * 14}1{']' * 14}" for k in range(1)), "nested"),
    "size": ("#" * (LONGEST + 1), "cannot be read: it has more than 1,000 kB"),
}


@pytest.mark.parametrize("kind", FAR_TOO_MUCH)
def test_toml_is_bounded_before_it_costs_anything(kind, tmp_path):
    text, words = FAR_TOO_MUCH[kind]
    (tmp_path / "f.toml").write_text(text)
    begun = time.process_time()
    with pytest.raises(ConfigError) as raised:
        read_toml(tmp_path / "f.toml")
    assert time.process_time() - begun < 3 and words in str(raised.value) and "\n" not in str(raised.value)


@given(st.integers(1, DEEPEST - 1), st.sampled_from(["keys", "lists", "tables"]))
def test_toml_of_ordinary_depth_is_what_tomllib_reads(depth, kind):
    import tomllib

    text = {"keys": ".".join("a" * depth) + " = 1", "lists": f"x = {'[' * depth}1{']' * depth}"}.get(kind)
    text = text or f"x = {'{a = ' * depth}1{'}' * depth}"
    assert parsed_toml(text) == tomllib.loads(text)


def test_a_text_with_many_dots_is_no_key():
    assert parsed_toml(f'# {"a. " * 20}\nx = "{". ".join("word" for _ in range(100))}."')["x"].startswith("word. word")


def test_what_is_no_plain_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "f.toml")
    for path in (tmp_path / "f.toml", tmp_path, Path("/dev/zero")):
        with pytest.raises(ConfigError, match="cannot be read: it is no plain file"):
            read_toml(path)


# -- whole or not at all -----------------------------------------------------------------------------------------------


def left(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def test_a_file_is_there_when_it_is_complete(tmp_path):
    with whole_file(tmp_path / "new" / "a.txt", "text") as part:
        part.write_text("half")
        assert left(tmp_path) == ["new", f"new/{part.name}"]
        part.write_text("whole")
    assert left(tmp_path) == ["new", "new/a.txt"] and (tmp_path / "new" / "a.txt").read_text() == "whole"


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt(), ZeroDivisionError()])
def test_an_error_leaves_what_was_there(error, tmp_path):
    (tmp_path / "a.txt").write_text("before")
    for path in (tmp_path / "a.txt", tmp_path / "new" / "deep" / "b.txt"):
        raised = RecordingError if isinstance(error, OSError) else type(error)
        with pytest.raises(raised), whole_file(path, "text") as part:
            part.write_text("half")
            raise error
        with pytest.raises(raised), whole_folder(path.with_suffix(""), "text") as made:
            (made / "x").write_text("half")
            raise error
    assert left(tmp_path) == ["a.txt"] and (tmp_path / "a.txt").read_text() == "before"


@pytest.mark.parametrize("links", [True, False])
def test_a_file_that_another_process_wrote_meanwhile_is_not_replaced_unasked(links, tmp_path, monkeypatch):
    if not links:  # a file system without them
        monkeypatch.setattr("os.link", lambda *_: (_ for _ in ()).throw(OSError(errno.EPERM, "no links")))
    taken = pytest.raises(RecordingError, match="the text exists: choose another, or replace it with --force")
    with taken, whole_file(tmp_path / "a.txt", "text", force=False) as part:
        part.write_text("mine")
        (tmp_path / "a.txt").write_text("theirs")
    assert left(tmp_path) == ["a.txt"] and (tmp_path / "a.txt").read_text() == "theirs"
    with whole_file(tmp_path / "b.txt", "text", force=False) as part:
        part.write_text("mine")
    assert (tmp_path / "b.txt").read_text() == "mine" and left(tmp_path) == ["a.txt", "b.txt"]


def test_a_folder_appears_whole_or_joins_what_is_there(tmp_path):
    for names in (("a", "in/b"), ("a", "c")):
        with whole_folder(tmp_path / "out", "source") as made:
            for name in names:
                (made / name).parent.mkdir(exist_ok=True)
                (made / name).write_text(f"{names}")
    assert left(tmp_path) == ["out", "out/a", "out/c", "out/in", "out/in/b"]
    assert (tmp_path / "out").stat().st_mode & 0o777 == 0o777 & ~os.umask(os.umask(0o022))
    with pytest.raises(RecordingError, match="the source exists"), whole_folder(tmp_path / "out", "source", False) as m:
        (m / "0").write_text("new")
        (m / "a").write_text("new")
    (tmp_path / "out" / "z").mkdir()
    with (
        pytest.raises(RecordingError, match="there is a folder of that name"),
        whole_folder(tmp_path / "out", "s") as m,
    ):
        (m / "0").write_text("new")
        (m / "z").write_text("new")
    assert not (tmp_path / "out" / "0").exists() and (tmp_path / "out" / "a").read_text() != "new"


@pytest.mark.parametrize("kind", ["link", "pipe"])
@pytest.mark.parametrize("planted", [".run.h5.{pid}.part", "results.jsonl", "results.jsonl.lock"])
def test_what_is_written_goes_through_no_link_and_no_pipe(planted: str, kind: str, tmp_path: Path) -> None:
    """A folder that somebody else has made may hold them under the names that we use."""
    name, theirs = planted.format(pid=os.getpid()), tmp_path / "theirs"
    theirs.write_text("no line of ours")
    (tmp_path / name).symlink_to(theirs) if kind == "link" else os.mkfifo(tmp_path / name)
    if name.endswith(".part"):
        with whole_file(tmp_path / "run.h5", "file") as part:
            part.write_text("mine")
        assert (tmp_path / "run.h5").read_text() == "mine" and not (tmp_path / "run.h5").is_symlink()
        (tmp_path / "run.h5").unlink()
        (tmp_path / name).symlink_to(theirs) if kind == "link" else os.mkfifo(tmp_path / name)
        with Recorder(Layout(0, 1, 1, 1), {}, tmp_path / "run.h5"):
            pass
        assert Recording.open(tmp_path / "run.h5").names
    else:
        with (
            pytest.raises(StudyError, match="it is a link" if kind == "link" else "it is no plain file"),
            writing(tmp_path / "results.jsonl"),
        ):
            pass
    assert theirs.read_text() == "no line of ours"


HOLD = """
import sys
from pathlib import Path
from mmnn_pin.files import locked
with locked(Path(sys.argv[1]), "table"):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_lock_is_held_against_other_processes_and_ends_with_a_kill(tmp_path):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "t")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None and holder.stdout.readline() == "held\n"
    in_use = f"the table is in use: process {holder.pid} on .* writes it"
    with pytest.raises(RecordingError, match=in_use), locked(tmp_path / "t", "table"):
        pass
    holder.kill()
    holder.communicate()
    with locked(tmp_path / "t", "table"):
        pass


# -- names of others ---------------------------------------------------------------------------------------------------


@given(st.text(st.characters(exclude_categories=["Cs"])))
def test_a_quoted_text_is_that_text_in_toml_and_in_yaml_on_one_line(text: str) -> None:
    assert tomllib.loads(f"key = {quoted(text)}\nnext = 1") == {"key": text, "next": 1}
    assert yaml.safe_load(f"key: [{quoted(text)}, x]") == {"key": [text, "x"]}
    assert quoted(text).isprintable()


# -- folders whose files are run ---------------------------------------------------------------------------------------

STRANGER = 65534
MODES = st.sampled_from([0o700, 0o755, 0o775, 0o757, 0o777, 0o1777, 0o1755])


def gets_in(folders: list[Path]) -> bool:
    """Whether a stranger can change what the last of some folders holds, or that it is the one; he tries."""
    if (child := os.fork()) == 0:
        os.setgid(STRANGER)
        os.setuid(STRANGER)
        tries = [partial(os.rename, one, f"{one}.away") for one in folders]
        tries += [partial(os.chmod, one, 0o777) for one in folders]
        for attempt in [*tries, (folders[-1] / "planted").touch]:
            with suppress(OSError):
                attempt()
                os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0


@pytest.mark.skipif(os.getuid() != 0, reason="a stranger is played by root")
@given(st.lists(st.tuples(MODES, st.sampled_from([0, 0, STRANGER])), min_size=1, max_size=3))
@example([(0o757, 0), (0o1777, 0), (0o700, 0)])  # its own place is taken from a folder of many
@settings(max_examples=150, deadline=None)
def test_into_a_folder_that_is_private_no_stranger_gets(chain: list[tuple[int, int]]) -> None:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        os.chmod(name, 0o755)
        folders = [Path(name)]
        for mode, owner in chain:
            folders.append(folders[-1] / "inner")
            folders[-1].mkdir()
            folders[-1].chmod(mode)
            os.chown(folders[-1], owner, owner)
        why = way_in(folders[-1])
        if all(owner == 0 and not mode & 0o022 for mode, owner in chain):
            assert why == ""
        if not why:
            assert not gets_in(folders)
        elif all(mode in (0o755, 0o757, 0o777) for mode, _ in chain):  # else he may not come so far
            assert gets_in(folders)


def test_a_private_folder_is_ours_alone_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        assert make_private(tmp_path / "one" / "two") == ""
        os.umask(0o777)
        assert make_private(tmp_path / "one" / "three") == ""
    finally:
        os.umask(before)
    made = [tmp_path / "one", tmp_path / "one" / "two", tmp_path / "one" / "three"]
    assert [folder.stat().st_mode & 0o7777 for folder in made] == [0o700] * 3
    (tmp_path / "one").chmod(0o777)
    assert make_private(tmp_path / "one" / "two") == f"others can write to {tmp_path / 'one'} (mode 777)"
    (tmp_path / "one").chmod(0o1777)  # whose entries only their owners replace
    assert make_private(tmp_path / "one" / "two") == ""
