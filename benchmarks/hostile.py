"""What is not ours, tried at random; every campaign prints its line of SECURITY.md's table.

    python benchmarks/hostile.py kills [--times 12] [--seed 0] [--only study ...]    processes that are killed
    python benchmarks/hostile.py cluster [--times 12]    a Dask cluster whose processes and network die
    python benchmarks/hostile.py disks                   full, closed and gone disks, and clocks that jump
    python benchmarks/hostile.py together [--times 3]    two of the same command at once in one folder
    python benchmarks/hostile.py servers                 requests to what listens
    python benchmarks/hostile.py pages                   scripts in every name

Files and options at random are tests/fuzz_files.py, tests/fuzz_urdf.py and tests/random_options.py. Exit code 1 where
something was lost.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import io
import json
import math
import os
import random
import re
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from fuzz_files import places  # noqa: E402
from sound_files import TUNING as QUICK_TUNING  # noqa: E402
from study_files import SHORT  # noqa: E402

from mmnn_pin import Recording  # noqa: E402
from mmnn_pin.errors import InputError  # noqa: E402
from mmnn_pin.recording.recording import recorded_robot  # noqa: E402

MARK = "MMNN_HOSTILE"  # a variable that all processes of one try have
# What a process is sent, and the exit codes with which it ends.
SIGNALS = {signal.SIGKILL: {-9}, signal.SIGTERM: {-15}, signal.SIGHUP: {-1}, signal.SIGINT: {130}}
STUDY = SHORT.replace("0.04", "0.3")
TUNING = QUICK_TUNING.replace("0.004", "0.3").replace("0.002", "0.1").replace("points = 2", "points = 8")
TUNING = TUNING.replace("trials = 2", "trials = 5").replace("check = 2", "check = 4")
PROGRAM = "import sys\nfrom mmnn_pin.cli import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
PASSING = (".part", ".lock", "-journal")  # files that a killed process may leave beside its own


@dataclass(frozen=True)
class Job:
    """A command that is killed."""

    words: str  # of the command; `{here}` is a folder of the try
    # what a folder has, as numbers that can be compared: name to content. A file that cannot be read raises
    results: Callable[[Path], dict[str, Any]]
    grows: bool = True  # whether what is there is a part of what will be; else a file is there whole, or is not
    again: str = ""  # words that the same command needs to go on

    def command(self, here: Path, again: bool = False) -> list[str]:
        """The program with its words."""
        words = (self.words + (f" {self.again}" if again else "")).format(here=here).split()
        if words[0] == "judge":
            return [sys.executable, "-m", "research.judge", *words[1:]]
        return [sys.executable, str(here.parent / "mmnn"), *words]


def whole_lines(file: Path) -> list[dict[str, Any]]:
    """Lines of JSON, what is left of the last one left out."""
    return [json.loads(line) for line in file.read_bytes().rpartition(b"\n")[0].splitlines()] if file.exists() else []


def rows_of_study(here: Path) -> dict[str, Any]:
    """Runs of a study by number, with what does not depend on when they were made."""
    passing = ("seconds", "host", "finished")
    rows = [line for line in whole_lines(here / "out" / "results.jsonl") if "id" in line]
    return {str(row["id"]): repr({k: v for k, v in row.items() if k not in passing}) for row in rows}


def rows_of_judge(here: Path) -> dict[str, Any]:
    """Rows of the judge by what they are of."""
    key = ("robot", "family", "draw", "plant", "controller")
    rows = whole_lines(here / "out" / "results.jsonl")
    return {repr([row[k] for k in key]): repr({k: v for k, v in row.items() if k != "seconds"}) for row in rows}


def trials_of(here: Path) -> dict[str, Any]:
    """Completed trials of a search, in order: gains and value."""
    if not (file := here / "out" / "tune.sqlite").exists():
        return {}
    base = sqlite3.connect(file)  # it rolls back what a kill left half done
    try:
        if not base.execute("SELECT name FROM sqlite_master WHERE name = 'trial_values'").fetchall():
            return {}
        assert base.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        found = base.execute(
            "SELECT value, param_value FROM trials JOIN trial_values USING (trial_id) JOIN trial_params"
            " USING (trial_id) WHERE state = 'COMPLETE' ORDER BY number"
        ).fetchall()
    finally:
        base.close()
    return {str(k): row for k, row in enumerate(found)}


def signals_of(here: Path) -> dict[str, Any]:
    """Signals of a recording, as far as they go, and pictures."""
    found: dict[str, Any] = {}
    for file in sorted((here / "out").glob("[!.]*")) if (here / "out").is_dir() else []:
        if file.suffix == ".h5":
            run = Recording.open(file)
            found[file.name] = {name: np.array(run[name]) for name in run.names if len(run)}
        elif file.suffix == ".png":
            data = file.read_bytes()
            assert data.startswith(b"\x89PNG") and data.endswith(b"IEND\xaeB`\x82"), f"{file} is half written"
            found[file.name] = "a picture"
    return found


def texts_of(here: Path) -> dict[str, Any]:
    """Texts of a folder, without its own name."""
    files = sorted((here / "out").glob("[!.]*")) if (here / "out").is_dir() else []
    return {file.name: file.read_text().replace(str(here), "") for file in files if file.suffix in (".json", ".urdf")}


JOBS = {
    "run": Job("run chapter4 --controller two_layer --out {here}/out", signals_of, again="--force"),
    "study": Job("study {here}/study.toml --workers 2 --out {here}/out", rows_of_study),
    "tune": Job("tune {here}/tuning.toml --workers 2 --out {here}/out", trials_of),
    "judge": Job("judge {here}/out --robots platform_arm --controllers pid --draws 4 --workers 2", rows_of_judge),
    "identify": Job(
        "identify {here}/log.csv --robot two_axis_arm --even-if-worse --out {here}/out",
        texts_of, grows=False, again="--force",
    ),
}  # fmt: skip


def is_part(some: Any, whole: Any) -> bool:
    """Whether results are the first of others."""
    if isinstance(some, dict):
        return isinstance(whole, dict) and all(key in whole and is_part(some[key], whole[key]) for key in some)
    if isinstance(some, np.ndarray):
        return len(some) <= len(whole) and bool(np.array_equal(some, whole[: len(some)], equal_nan=True))
    return bool(some == whole)


def alive(mark: str) -> list[int]:
    """Processes with a mark among their variables."""
    found, word = [], f"{MARK}={mark}".encode()
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if word in (place / "environ").read_bytes().split(b"\0"):
                found.append(int(place.name))
        except OSError:
            continue
    return found


def are_gone(mark: str, patience: float = 3.0) -> bool:
    """Whether all processes of a try are over soon; those that are not are ended."""
    until = time.monotonic() + patience
    while (left := alive(mark)) and time.monotonic() < until:
        time.sleep(0.1)
    for number in left:
        os.kill(number, signal.SIGKILL)
    return not left


def prepared(folder: Path) -> Path:
    """A folder with what the commands read."""
    from sound_files import motion

    folder.mkdir(parents=True)
    (folder / "study.toml").write_text(STUDY)
    (folder / "tuning.toml").write_text(TUNING)
    motion(folder / "log.csv")
    (folder.parent / "mmnn").write_text(PROGRAM)
    return folder


def started(command: list[str], mark: str) -> subprocess.Popen[str]:
    """A command, begun, with a mark."""
    variables = os.environ | {"PYTHONPATH": str(ROOT), MARK: mark}
    return subprocess.Popen(command, cwd=ROOT, env=variables, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ended(command: list[str], mark: str, after: float = math.inf, number: int = 0) -> tuple[int, str, bool]:
    """Exit code of a command, what it said, and whether it was hit by a signal before it was over."""
    process = started(command, mark)
    try:
        said = process.communicate(timeout=None if after == math.inf else after)
        return process.returncode, said[1], False
    except subprocess.TimeoutExpired:
        process.send_signal(number)
        said = process.communicate(timeout=120)
        return process.returncode, said[1], True


def killed(job: Job, here: Path, whole: dict[str, Any], after: float, number: int) -> list[str]:
    """Kill a command in a folder and look at what is left there: what is wrong with it."""
    mark, before = f"{os.getpid()}.{time.monotonic_ns()}", job.results(here)
    code, said, hit = ended(job.command(here, bool(before)), mark, after, number)
    wrong = [] if are_gone(mark) else ["processes were left"]
    if code and not (hit and code in SIGNALS[signal.Signals(number)]):
        wrong.append(f"exit code {code}: {said[-300:]}")
    if number == signal.SIGINT and hit and ("Traceback" in said or "internal error" in said):
        wrong.append(f"not one line: {said[-300:]}")
    try:
        after_it = job.results(here)
    except Exception as error:
        return [*wrong, f"half written: {type(error).__name__}: {error}"]
    if not is_part(after_it, whole):
        wrong.append("what is there is not what would be")
    if job.grows and not job.again and not is_part(before, after_it):
        wrong.append("something is lost")
    left = [file.name for file in here.rglob(".*") if file.name.endswith(PASSING) and not file.name.endswith(".lock")]
    if number == signal.SIGINT and left:
        wrong.append(f"left {left}")
    return wrong


def tried(name: str, times: int, seed: int, folder: Path) -> tuple[int, list[str]]:
    """Kill a command, three times in each folder, then let it come to its end: how often, and what was wrong."""
    job, rng = JOBS[name], random.Random(f"{name} {seed}")
    sound = prepared(folder / "sound")
    for _ in range(2):  # the first may compile
        shutil.rmtree(sound / "out", ignore_errors=True)
        began = time.monotonic()
        code, said, _ = ended(job.command(sound), "sound")
        lasts = time.monotonic() - began
        assert code == 0, said
    whole, wrong, done = job.results(sound), list[str](), 0
    assert whole
    while done < times:
        shutil.rmtree(here := folder / "here", ignore_errors=True)
        shutil.copytree(sound, here, ignore=shutil.ignore_patterns("out"))
        for _ in range(min(3, times - done)):
            number, after = rng.choice(list(SIGNALS)), rng.uniform(0.0, lasts)
            found = killed(job, here, whole, after, number)
            wrong += [f"{name}, {signal.Signals(number).name} after {after:.2f} s: {one}" for one in found]
            done += 1
        code, said, _ = ended(job.command(here, (here / "out").exists()), "last")
        if code or not (is_part(whole, job.results(here)) and is_part(job.results(here), whole)):
            wrong.append(f"{name}: it does not come to the same end, exit code {code}: {said[-300:]}")
    return done, wrong


def kills(options: argparse.Namespace) -> list[str]:
    """Commands that are killed at random times."""
    wrong, counts = list[str](), collections.Counter[str]()
    for name in options.only or JOBS:
        with tempfile.TemporaryDirectory() as scratch:
            counts[name], found = tried(name, options.times, options.seed, Path(scratch))
        wrong += found
        print(f"{name}: {counts[name]} kills, {len(found)} wrong", file=sys.stderr, flush=True)
    said = ", ".join(f"{count} of `{name}`" for name, count in counts.items())
    print(f"{counts.total()} kills (SIGKILL, SIGTERM, SIGHUP, SIGINT): {said}: {len(wrong)} wrong")
    return wrong


# -- a cluster ---------------------------------------------------------------------------------------------------------

PATIENCE = 150.0  # until a command has seen that its cluster is gone [s]
LARGER = STUDY.replace("points = 4", "points = 24")


def cable(up: bool) -> None:
    """Join the scheduler's network to this one, or cut it: packets vanish, nobody is told."""
    from clusters import NETWORK

    state = "up" if up else "down"
    subprocess.run(["ip", "netns", "exec", NETWORK, "ip", "link", "set", f"{NETWORK}b", state], check=True)


def lost(what: str, made: Any, client: subprocess.Popen[str]) -> None:
    """Take something away from a study on a cluster: a scheduler, its first worker and one outside."""
    scheduler, inside, outside = made.processes
    if what == "a worker":
        outside.kill()
        made.worker()
    elif what == "all workers":
        for process in (inside, outside):
            process.terminate()
        made.worker(inside=True)
    elif what == "the scheduler":
        scheduler.kill()
    elif what == "the client":
        client.kill()
    else:
        cable(False)
        if what == "the network for 3 s":
            time.sleep(3.0)
            cable(True)


LOSSES = ("a worker", "all workers", "the scheduler", "the client", "the network", "the network for 3 s")


def on_cluster(folder: Path, here: Path, whole: dict[str, Any], what: str, share: float) -> list[str]:
    """A study on a cluster that loses something once a share of its rows are there: what is wrong with what comes."""
    from clusters import Cluster, network

    def study(address: str) -> subprocess.Popen[str]:
        words = ["study", f"{here}/study.toml", "--out", f"{here}/out", "--cluster", address]
        return started([sys.executable, str(folder / "mmnn"), *words], folder.name)

    wrong = list[str]()
    for round_, loss in enumerate((what, "")):  # then another cluster, on which the same command goes on
        with network() as within:
            (place := folder / f"cluster{round_}").mkdir(parents=True)
            made = Cluster(place, within)
            try:
                for inside in (True, False):
                    made.worker(inside)
                for log in place.glob("worker*/log"):
                    made.told(log, "(Registered to)")
                client, until = study(made.address), time.monotonic() + PATIENCE
                while len(rows_of_study(here)) < share * len(whole) and client.poll() is None:
                    time.sleep(0.02)
                    assert time.monotonic() < until
                if loss and client.poll() is None:
                    lost(loss, made, client)
                elif loss:
                    wrong.append(f"it was over before {loss} was lost")
                try:
                    said = client.communicate(timeout=PATIENCE)[1]
                except subprocess.TimeoutExpired:
                    client.kill()
                    said = client.communicate()[1]
                    wrong.append(f"it waits for ever: {said[-300:]}")
            finally:
                made.stop()
        told = [line for line in said.splitlines() if "error: " in line]
        ends = {"the client": {-9}, "the scheduler": {1}, "the network": {1}, "the network for 3 s": {0, 1}}
        if client.returncode not in ends.get(loss, {0}) or "Traceback" in said or "internal error" in said:
            wrong.append(f"exit code {client.returncode}: {said[-500:]}")
        if client.returncode > 0 and (len(told) != 1 or "goes on" not in told[0]):
            wrong.append(f"not one line: {said[-500:]}")
        if not is_part(rows_of_study(here), whole):
            wrong.append("a row is not what it would be")
    if len(rows_of_study(here)) != len(whole):
        wrong.append(f"{len(whole) - len(rows_of_study(here))} rows are lost")
    return wrong


def cluster(options: argparse.Namespace) -> list[str]:
    """Studies on a Dask cluster of which something dies."""
    wrong, counts, rng = list[str](), collections.Counter[str](), random.Random(options.seed)
    losses = options.only or LOSSES
    with tempfile.TemporaryDirectory() as scratch:
        sound = prepared(Path(scratch) / "sound")
        (sound / "study.toml").write_text(LARGER)
        code, said, _ = ended(JOBS["study"].command(sound), "sound")
        assert code == 0, said
        whole = rows_of_study(sound)
        for k in range(options.times):
            what, share = losses[k % len(losses)], rng.uniform(0.05, 0.7)
            here = prepared(Path(scratch) / f"try{k}" / "here")
            (here / "study.toml").write_text(LARGER)
            began = time.monotonic()
            found = on_cluster(here.parent, here, whole, what, share)
            wrong += [f"{what} lost after {share:.0%}: {one}" for one in found]
            counts[what] += 1
            lasted = time.monotonic() - began
            print(f"{what} lost after {share:.0%}: {lasted:.0f} s, wrong: {found}", file=sys.stderr, flush=True)
    said = ", ".join(f"{what} {count}" for what, count in counts.items())
    print(f"{counts.total()} studies of {len(whole)} runs on a cluster that lost {said} times: {len(wrong)} wrong")
    return wrong


# -- disks, and two at once --------------------------------------------------------------------------------------------


def disks(options: argparse.Namespace) -> list[str]:
    """Every command that writes, on disks in trouble and with clocks that jump."""
    from test_failing_disks import all_tried, judge

    wrong, count = list[str](), 0
    with tempfile.TemporaryDirectory() as scratch:
        found = all_tried(Path(scratch) / "here", *["--quick"] * bool(options.quick))
    said = found.pop("standard output")
    for name, troubles in found.items():
        count += len(troubles)
        try:
            judge(name, troubles)
        except AssertionError as error:
            wrong.append(f"{name}: {error}")
    kinds = len({trouble for troubles in found.values() for trouble in troubles})
    print(
        f"{len(found)} commands in {kinds} kinds of trouble, {count} tries, and {len(said)} on a full standard output: "
        f"{len(wrong)} wrong"
    )
    return wrong


def both(command: Callable[[Path], list[str]], here: Path, apart: float) -> list[str]:
    """The same command twice at the same time in one folder, one a little later: what is wrong with what they say."""
    mark, wrong = f"{os.getpid()}.{time.monotonic_ns()}", list[str]()
    first = started(command(here), mark)
    time.sleep(apart)
    pair = [first, started(command(here), mark)]
    said = [process.communicate(timeout=600)[1] for process in pair]
    codes = sorted(process.returncode for process in pair)
    if codes not in ([0, 0], [0, 2]):
        wrong.append(f"exit codes {codes}: {said}")
    for process, told in zip(pair, said, strict=True):
        lines = [line for line in told.splitlines() if "error: " in line]
        if "Traceback" in told or "internal error" in told or (process.returncode == 2 and len(lines) != 1):
            wrong.append(f"not one line: {told[-300:]}")
    left = [f.name for f in here.rglob(".*") if f.name.endswith(PASSING) and not f.name.endswith(".lock")]
    return [*wrong, *([f"left {left}"] if left else []), *([] if are_gone(mark) else ["processes were left"])]


def together(options: argparse.Namespace) -> list[str]:
    """Two of the same command at once: those that grow what they write, and all others that write."""
    from failing_disks import COMMANDS, prepare

    wrong, counts, rng = list[str](), collections.Counter[str](), random.Random(options.seed)
    with tempfile.TemporaryDirectory() as scratch:
        files = Path(scratch) / "files"
        prepare(files)
        (Path(scratch) / "mmnn").write_text(PROGRAM)

        def other(words: str) -> Callable[[Path], list[str]]:
            where = ["env", "-C", str(files), sys.executable, f"{scratch}/mmnn"]
            return lambda here: [*where, *(word.format(out=here / "out") for word in words.split())]

        tried = {name: (job.command, job.results) for name, job in JOBS.items()}
        tried |= {n: (other(words), names_in) for n, words in COMMANDS.items() if n not in JOBS}
        for name in options.only or tried:
            command, results = tried[name]
            sound = prepared(Path(scratch) / name.replace(" ", "_") / "sound")
            began = time.monotonic()
            code, said, _ = ended(command(sound), "sound")
            lasts = time.monotonic() - began
            assert code == 0, said
            whole = results(sound)
            for k in range(options.times):
                here = sound.parent / f"try{k}"
                shutil.copytree(sound, here, ignore=shutil.ignore_patterns("out"))
                found = both(command, here, rng.choice((0.0, rng.uniform(0.0, lasts))))
                after = results(here)
                if not (is_part(after, whole) and is_part(whole, after)):
                    found.append(f"what is there is not what would be: {sorted(after)}, not {sorted(whole)}")
                wrong += [f"{name}: {one}" for one in found]
                counts[name] += 1
            print(f"{name}: {counts[name]} times, {len(wrong)} wrong so far", file=sys.stderr, flush=True)
    print(f"{len(counts)} commands that write, two at once, {counts.total()} times: {len(wrong)} wrong")
    return wrong


def names_in(here: Path) -> dict[str, Any]:
    """Names of what is in a folder for output."""
    found = sorted((here / "out").rglob("*"))
    return {str(file.relative_to(here)): file.is_dir() for file in found if not file.name.endswith(PASSING)}


# -- servers -----------------------------------------------------------------------------------------------------------

LOCAL = "Host: 127.0.0.1\r\n"
FOREIGN = [
    "Host: evil.example",
    "Host: 127.0.0.1.evil.example",
    "Host: localhost.evil.example:80",
    "Host: ",
    "Host: [::1",
]
FOREIGN += [
    f"{LOCAL}Origin: {who}" for who in ("http://evil.example", "null", "file://", "http://127.0.0.1.evil.example")
]
SECRETS = [
    "../" * 8 + "etc/passwd",
    "%2e%2e/" * 8 + "etc/passwd",
    "..%2f" * 8 + "etc/passwd",
    "//etc/passwd",
    "..\\..\\etc",
]
SLOW, OPEN = 200, 5.0  # connections that never end their request; patience [s]


def answer_to(place: tuple[str, int], request: bytes) -> bytes:
    """What an answer begins with; empty where the server hangs up or waits for more."""
    with socket.create_connection(place, timeout=OPEN) as line, contextlib.suppress(ConnectionError, TimeoutError):
        line.sendall(request)
        found = b""
        while b"\r\n\r\n" not in found and (more := line.recv(500)):
            found += more
        return found
    return b""


def refusals(paths: Sequence[str]) -> Iterator[tuple[bytes, tuple[str, ...]]]:
    """Requests that no page of ours makes, and the states that answer them; "" for a connection that is closed."""
    for path in paths:
        for head in FOREIGN:
            yield f"GET {path} HTTP/1.1\r\n{head}\r\n\r\n".encode(), ("403", "400", "405")
        for method in ("POST", "PUT", "DELETE", "OPTIONS", "TRACE"):
            yield f"{method} {path} HTTP/1.1\r\n{LOCAL}Content-Length: 0\r\n\r\n".encode(), ("501", "405", "400", "403")
        yield (
            f"POST {path} HTTP/1.1\r\n{LOCAL}Content-Length: {10**12}\r\n\r\n".encode(),
            ("501", "405", "400", "413", ""),
        )
        yield f"GET {path}{'?' * 10**6} HTTP/1.1\r\n{LOCAL}\r\n".encode(), ("414", "400", "431", "")
        yield f"GET {path} HTTP/1.1\r\n{LOCAL}{'A: b' * 10**5}\r\n\r\n".encode(), ("400", "431", "")
        yield (
            f"GET {path} HTTP/1.1\r\n{LOCAL}{chr(13).join(['A: b', chr(10)]) * 20_000}\r\n".encode(),
            ("400", "431", ""),
        )
        for secret in SECRETS:
            for place in (path.rstrip("/") + "/" + secret, "/" + secret, "/static/" + secret):
                yield f"GET {place} HTTP/1.1\r\n{LOCAL}\r\n".encode(), ("404", "403", "400")
    yield b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc", ("400", "")
    yield b"\0" * 10**6, ("400", "414", "")


def besieged(url: str, paths: Sequence[str], rng: random.Random) -> tuple[int, list[str]]:
    """Ask a server what it must refuse, beside requests that never end: how often, and what was wrong."""
    name, _, port = url.removeprefix("http://").partition("/")[0].partition(":")
    place, wrong, count = (name, int(port)), list[str](), 0
    asked = list(refusals(paths))
    with contextlib.ExitStack() as slow:
        for _ in range(SLOW):
            line = slow.enter_context(socket.create_connection(place, timeout=OPEN))
            line.sendall(f"GET {paths[0]} HTTP/1.1\r\n{LOCAL}".encode()[: rng.randrange(1, 40)])
        for request, states in asked:
            said, count = answer_to(place, request), count + 1
            state = said.split(b" ")[1:2]
            found = state[0].decode(errors="replace") if state and said.startswith(b"HTTP") else ""
            if b"root:" in said or (found not in states and not (not found and len(request) > 60_000)):
                wrong.append(f"{url}: {request[:80]!r}: {said[:60]!r}")
        began = time.monotonic()
        if b"200 OK" not in answer_to(place, f"GET {paths[0]} HTTP/1.1\r\n{LOCAL}\r\n".encode()):
            wrong.append(f"{url}: its own page is not answered any more")
        if time.monotonic() - began > 5:
            wrong.append(f"{url}: its own page took {time.monotonic() - began:.1f} s")
    return count + SLOW, wrong


def servers(options: argparse.Namespace) -> list[str]:
    """The servers of `replay`, of `replay --live` and of `view`."""
    import resource

    from mmnn_pin import PD, Stepper, load
    from mmnn_pin.lab.show.live import LiveView
    from mmnn_pin.lab.show.replay.page import ReplayPage

    wrong, counts, rng = list[str](), collections.Counter[str](), random.Random(options.seed)
    robot, before = load("platform_arm"), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with (
        ReplayPage("<p>mine</p>").served(0) as page,
        Stepper(robot, PD()) as stepper,
        LiveView(stepper, port=0) as live,
        robot.view(port=0) as shown,
    ):
        places = {
            "replay": (page, ["/"]),
            "live": (live.url, ["/", "/live"]),
            "view": (shown.url, ["/view", "/static/"]),
        }
        for name, (url, paths) in places.items():
            counts[name], found = besieged(url, paths, rng)
            wrong += found
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    wrong += [f"{grown:.0f} MB more memory"] if grown > 300 else []
    said = ", ".join(f"{count} to `{name}`" for name, count in counts.items())
    print(f"{counts.total()} requests ({said}): {len(wrong)} wrong, {grown:.0f} MB more memory")
    return wrong


# -- pages -------------------------------------------------------------------------------------------------------------

RUNS = "</script></style><script>window.ran=1;alert(1)</script><img src=x onerror=alert(2)>"  # and a way out of quotes
QUOTED = "\"'`>" + RUNS + "{{7*7}}<svg onload=alert(4)>"


def ours(words: str, file: Path) -> bool:
    """Whether a command takes a file and writes its page."""
    from mmnn_pin.cli import main as command

    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return command([*words.split(), "--html", str(file), "--force"]) == 0


def named_so(tree: Any, takes: Callable[[], bool]) -> int:
    """Put what would run into every text of a tree of JSON that is still taken so: how many."""
    count = 0
    for here, key in places(tree):
        if isinstance(here.get(key) if isinstance(here, dict) else here[key], str):
            before, here[key] = here[key], QUOTED + here[key]
            if takes():
                count += 1
            else:
                here[key] = before
    for here, key in [(here, key) for here, key in places(tree) if isinstance(here, dict)]:
        if key in here:  # names of its own
            here[QUOTED + key] = here.pop(key)
            if takes():
                count += 1
            else:
                here[key] = here.pop(QUOTED + key)
    return count


def study_so(folder: Path) -> int:
    """A study whose texts would run."""
    from mmnn_pin.lab.study.results import load_results

    file = folder / "db" / "results.jsonl"
    lines = [json.loads(line) for line in file.read_text().splitlines()]

    def takes() -> bool:
        file.write_text("".join(json.dumps(line) + "\n" for line in lines))
        try:
            load_results(file)
        except InputError:
            return False
        return True

    return named_so([lines[0], lines[1]], takes) + int(takes()) - 1


def identified_so(folder: Path) -> int:
    """What was identified, whose texts would run."""
    (file,) = (folder / "identified").glob("*.json")
    tree = json.loads(file.read_text())

    def takes() -> bool:
        file.write_text(json.dumps(tree))
        return ours(f"report {folder / 'identified'}", folder / "try.html")

    return named_so(tree, takes) + int(takes()) - 1


def recording_so(folder: Path) -> int:
    """A recording whose robot, names and facts would run."""
    import h5py

    file, count = folder / "run.h5", 0
    with h5py.File(file, "r+") as run:
        names = [str(name) for name in run.attrs["actuator_names"]]
        urdf = run["urdf"].asstr()[()]
        for name in [*names, *re.findall(r'<link name="(\w+)"', urdf), *re.findall(r'robot name="(\w+)"', urdf)]:
            urdf, count = urdf.replace(f'"{name}"', f'"{escape(QUOTED, {chr(34): "&quot;"})}{name}"'), count + 1
        del run["urdf"]
        run["urdf"] = urdf
        holders = ["/", *(f"signals/{name}" for name in run["signals"])]
        texts = [
            (holder, key) for holder in holders for key, value in run[holder].attrs.items() if isinstance(value, str)
        ]
        lists = [
            (holder, key)
            for holder in holders
            for key in ("actuator_names", "velocity_names", "position_names", "labels")
        ]
        for holder, key in lists:
            if key in run[holder].attrs:
                run[holder].attrs[key] = [QUOTED + one if one in names else one for one in run[holder].attrs[key]]
    for holder, key in texts:
        before = written(file, holder, key, lambda value: QUOTED + value)
        try:
            if Recording.open(file).damage:
                raise InputError("damaged")
            count += 1
        except InputError:
            written(file, holder, key, lambda _, value=before: value)
    return count


def written(file: Path, holder: str, key: str, new: Callable[[str], str]) -> str:
    """Change a text of a recording: what it was."""
    import h5py

    with h5py.File(file, "r+") as run:
        before = str(run[holder].attrs[key])
        run[holder].attrs[key] = new(before)
    return before


def pages(options: argparse.Namespace) -> list[str]:
    """Pages of files in which every name is a script, opened in Chromium."""
    from browser import browser
    from sound_files import sound_files

    from mmnn_pin import PD, Stepper
    from mmnn_pin.lab.show.live import LiveView

    wrong, count = list[str](), 0
    with tempfile.TemporaryDirectory() as scratch, contextlib.ExitStack() as held:
        folder = sound_files(Path(scratch) / "sound", ("pd",), tuned=False)
        os.replace(folder / "run_pd.h5", folder / "run.h5")
        put = {"study": study_so(folder), "identified": identified_so(folder), "recording": recording_so(folder)}
        own = folder / f"{RUNS.replace('/', '_')}.h5"
        shutil.copy(folder / "run.h5", own)
        urls = {}
        for name, words in {
            "study": f"report {folder / 'db'}",
            "identified": f"report {folder / 'identified'}",
            "replay": f"replay {folder / 'run.h5'}",
            "report": f"report {folder / 'run.h5'}",
        }.items():
            if ours(words, file := folder / f"{name}.html"):
                urls[name] = file.as_uri()
            else:
                wrong.append(f"no page of {name}")
        robot = recorded_robot(Recording.open(folder / "run.h5"))
        urls["view"] = held.enter_context(robot.view(port=0)).url
        stepper = held.enter_context(Stepper(robot, PD()))
        urls["live"] = held.enter_context(LiveView(stepper, port=0)).url
        with browser() as chromium:
            for name, url in urls.items():
                wrong += [f"{name}: {what}" for what in looked_at(chromium, url)]
                count += 1
    said = ", ".join(f"{number} texts of a {name}" for name, number in put.items())
    print(f"{count} pages with a script in every name that is taken ({said}): {len(wrong)} wrong")
    return wrong


def looked_at(chromium: Any, url: str) -> list[str]:
    """What a page does that it must not: dialogs, scripts of names, requests elsewhere, elements of names."""
    page, found = chromium.new_page(), list[str]()
    own = url.partition("/view")[0] if url.startswith("http") else url
    page.on("dialog", lambda dialog: (found.append(f"dialog {dialog.message}"), dialog.dismiss()))
    page.on("pageerror", lambda error: found.append(str(error)))
    page.on(
        "request",
        lambda sent: None if sent.url.startswith((own, "data:", "blob:", "about:")) else found.append(sent.url),
    )
    page.goto(url)
    page.wait_for_timeout(3000)
    for frame in page.frames:
        if frame.evaluate("window.ran === 1 || document.querySelectorAll('img[src=x], svg[onload]').length > 0"):
            found.append("a name was run, or made an element")
    page.close()
    return found


CAMPAIGNS = {
    "kills": kills,
    "cluster": cluster,
    "disks": disks,
    "together": together,
    "servers": servers,
    "pages": pages,
}


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", choices=CAMPAIGNS)
    parser.add_argument("--times", type=int, default=12, help="of each kind (12)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+")
    parser.add_argument("--quick", action="store_true", help="the commonest troubles of disks alone")
    options = parser.parse_args()
    wrong = CAMPAIGNS[options.campaign](options)
    print(*wrong, sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
