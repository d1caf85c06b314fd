"""Motions in files: CSV tables with headers of any kind, recordings of this package, and bags by `bag`."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, RecordingError, UnknownName
from ...files import LARGEST, parsed_json, read_bytes, read_toml, reason
from ...model.robot import Robot
from ...recording.recording import Recording, as_columns
from ...reference.samples import TIMES
from ...signals import Array
from .bag import read_bag
from .log import BASE, REFERENCE, Columns, Log, from_signals, revolves

# Words of other headers that say what is measured; the first word of a list is our own.
WORDS = {
    "position": ("position", "positions", "pos", "q", "angle"),
    "velocity": ("velocity", "velocities", "vel", "dq", "qd", "qdot", "speed"),
    "effort": ("effort", "efforts", "torque", "torques", "tau", "eff", "current", "force", "load"),
}
LONGEST_NAME = 200  # letters of a column's
STAMPS = ("time", "timestamp", "stamp")  # in a header with other words
WANTED = {"action", "target", "desired", "goal", "command", "commanded", "cmd", "setpoint"}  # of what is not measured
UNITS = {"s", "sec", "secs", "seconds", "ms", "us", "ns"}  # that may follow
PLAIN = {"joint", "joints", "j", "axis", "motor", "link", "actual", "measured", "meas", "state", "raw", "filtered"}
PLAIN |= {"states", "field", "data", "msg", "observation", "values", "points", "trajectory"}
TAKEN = {"q": "position", "qdot": "velocity", "velocity": "base"}  # of a recording, beside its torque
BAGS = (".db3", ".mcap", ".bag")


MotionSource = Log | Recording | str | Path


def logs_of(given: MotionSource | Sequence[MotionSource], robot: Robot) -> list[Log]:
    """Logs of whatever holds a motion: a log, a recording, a file of `read_logs`, or several of these.

    Raises:
        InputError: As `read_logs`.
    """
    found: list[Log] = []
    for one in [given] if isinstance(given, Log | Recording | str | Path) else given:
        if isinstance(one, Recording):
            found.append(from_recording(one, robot))
        else:
            found += [one] if isinstance(one, Log) else read_logs([one], robot)
    return found


def read_logs(
    paths: Sequence[str | Path],
    robot: Robot,
    columns: Columns | None = None,
    rate: float | None = None,
    degrees: bool = False,
) -> list[Log]:
    """The motions of some files; tables with the same times and different signals are one motion.

    Args:
        paths: CSV files, bags (rosbag2 with sqlite3 or MCAP, or their folder; ROS 1), LeRobot datasets (a folder),
            recordings of this package.
        robot: Whose joints are looked for.
        columns: Signal to header: `position.JOINT = HEADER`, with `{joint}` in both for all joints; `joint.JOINT =
            NAME` for what a bag calls a joint; `topic.joints`, `topic.odometry`, `topic.reference` for its topics.
        rate: Rows per second of a table without times [Hz].
        degrees: Whether angles are in degrees.

    Raises:
        InputError: A file that cannot be read, or in which nothing of the robot is found; with the line.
    """
    columns, logs = columns or {}, []
    for path in map(Path, paths):
        if not path.exists():
            raise RecordingError("no such file", fix="name a CSV file, a bag or a recording", file=path)
        if path.suffix == ".h5":
            logs.append(from_recording(Recording.open(path), robot))
        elif (path / DATASET).is_file():
            logs += read_dataset(path, robot, columns)
        elif path.suffix in BAGS or path.is_dir():
            logs.append(read_bag(path, robot, columns))
        else:
            logs.append(read_csv(path, robot, columns, rate))
    made = joined(logs)
    for log in made:
        require_joints(log, robot)
    return [in_radians(log, robot) if degrees else log for log in made]


def in_radians(log: Log, robot: Robot) -> Log:
    """A log whose angles were in degrees."""
    signals = log.signals
    for signal, values in signals.items():
        kind, _, name = signal.partition(".")
        turns = name in robot.full_velocity_names and kind in ("position", "velocity") and revolves(robot, name)
        if turns or signal in ("base.phi", "base.w", "reference.phi"):
            signals[signal] = np.deg2rad(values)
    return log.with_signals(signals, None, "angles were in degrees")


def joined(logs: Iterable[Log]) -> list[Log]:
    """Logs with those made one that have the same times and no signal in common."""
    made: list[Log] = []
    for log in logs:
        for i, other in enumerate(made):
            if np.array_equal(log.time, other.time) and not set(log.signals) & set(other.signals):
                made[i] = replace(
                    other.with_signals(other.signals | log.signals), notes=tuple(dict.fromkeys(other.notes + log.notes))
                )
                break
        else:
            made.append(log)
    return made


def require_joints(log: Log, robot: Robot) -> None:
    """Refuse a log that has no positions of the robot's joints, or no efforts of its motors (`RecordingError`)."""
    names = [*robot.joint_names, *(wheel.joint for wheel in robot.base.wheels)]
    for kind, there, wanted in (("position", log.position, names), ("effort", log.effort, robot.actuator_names)):
        guesses = [note for note in log.notes if note.startswith("not taken") and f"{kind}." in note]
        moves = kind == "position" and {"base.v", "base.vx", "base.w"} & set(log.base)
        if not set(there) & set(wanted) and not moves:
            why = f"it has {kind}s of {', '.join(there)}" if there else f"it has no {kind}s at all"
            raise RecordingError(
                f"no {kind} of a joint of {robot.name} that moves",
                why=why,
                fix="; ".join((f"its joints are {', '.join(wanted)}; map names with --columns", *guesses)),
                file=log.name,
            )


# -- CSV ---------------------------------------------------------------------------------------------------------------


def read_csv(path: Path, robot: Robot, columns: Columns, rate: float | None = None) -> Log:
    """A table with a header; errors as of `read_logs`."""
    if path.suffix in (".npz", ".npy", ".mat"):
        fix = "identify(robot, Log.of(time, position, effort)) in Python, or write a CSV file"
        raise RecordingError("arrays without names of joints", fix=fix, file=path)
    header, table, short = read_table(path)
    joints = [*robot.joint_names, *(n for n in robot.full_velocity_names if n not in robot.joint_names)]
    ours = {} if columns else exported(header)
    where = ours or found_columns(header, joints, columns, path)
    wheels = {wheel.joint for wheel in robot.base.wheels}
    moving = [n for n in robot.full_velocity_names if n in wheels or n in robot.joint_names]
    orders = robot.joint_names, moving
    sets = {} if ours else numbered_sets(header, where)
    counted, notes = numbered(header, sets, orders, where, path)
    where = counted | where
    notes += tuple(guesses(header, sets, orders, where))
    stamps = [i for i, name in enumerate(header) if set(re.findall("[a-z]+", name.lower())) & set(STAMPS)]
    if "time" not in where and len(stamps) == 1:
        where["time"] = stamps[0]
    if "time" not in where:
        if rate is None:
            rising = [name for name, column in zip(header, table.T, strict=True) if (np.diff(column) > 0).all()]
            guess = f"--columns 'time={rising[0]}'" if rising else f"one of {', '.join(header)}: --columns time=HEADER"
            raise RecordingError("no column of times", fix=f"{guess}, or give --rate HZ", file=path, line=1)
        time = np.arange(len(table)) / rate
    else:
        time = table[:, where["time"]]
    signals = {signal: table[:, i] for signal, i in where.items() if signal != "time"}
    log = replace(from_signals(str(path), {"time": time, **signals}), notes=notes + short)
    return of_recording(log, robot) if ours else log


def plain(header: str) -> str:
    """A header without the unit in brackets behind it."""
    return re.sub(r"\s*\[[^\]0-9][^\]]*\]$", "", header.strip())


def exported(header: Sequence[str]) -> dict[str, int]:
    """Place of every signal in a table that `mmnn export` wrote, as `from_recording` takes them; empty for another.

    Beside what the sensors said it has the truth, references and errors.
    """
    names = [plain(name) for name in header]
    kinds = {name.partition(".")[0] for name in names}
    if not {"time", "nu_ref", "psi_hat", "motor_torque"} <= kinds:
        return {}
    torque = {"applied": "effort", "motor_torque": "command"} if "applied" in kinds else {"motor_torque": "effort"}
    taken = TAKEN | torque
    found = {"time": names.index("time")}
    for i, name in enumerate(names):
        signal, _, label = name.partition(".")
        if signal in taken and label:
            found[f"{taken[signal]}.{label}"] = i
    return found


NumberedSets = Mapping[tuple[str, ...], Mapping[int, int]]  # places of columns by number, by the words beside it


def numbered_sets(header: Sequence[str], found: Mapping[str, int]) -> NumberedSets:
    """Columns that nothing else takes, and that have one number beside the same words."""
    sets: dict[tuple[str, ...], dict[int, int]] = {}
    for i, name in enumerate(header):
        words = re.findall(r"[a-z]+|[0-9]+", re.sub(r"[\[(][^\])0-9]+[\])]", "", name.lower()))
        count = [word for word in words if word.isdigit()]
        if len(count) == 1 and i not in found.values():
            sets.setdefault(tuple(word for word in words if not word.isdigit()), {})[int(count[0])] = i
    return sets


def numbered(
    header: Sequence[str], sets: NumberedSets, orders: Sequence[Sequence[str]], found: Mapping[str, int], path: Path
) -> tuple[dict[str, int], tuple[str, ...]]:
    """Columns that number the joints, such as `q_1` to `q_7` or `tau_J[0]` to `tau_J[6]`, and what that is taken for.

    A set of as many columns as joints, of the arm or with the wheels, numbered from 0 or 1, is of these in the URDF's
    order, for a kind of signal of which no column has a joint's name. Other words in a header (`q_d`, `target_q`,
    `leg_1_q`) say that it is none.

    Raises:
        RecordingError: Two sets of one kind.
    """
    made: dict[str, int] = {}
    notes: list[str] = []
    for kind, synonyms in WORDS.items():
        known = {*PLAIN, *synonyms}
        if any(f"{kind}.{joint}" in found for joint in orders[0]):
            continue
        joints = orders[0]
        of_kind = [one for words, one in sets.items() if set(words) & set(synonyms) and not set(words) - known]
        whole = [one for one in of_kind if is_count(one, len(joints))]
        if not whole:
            joints = orders[-1]
            whole = [one for one in of_kind if is_count(one, len(joints))]
        if len(whole) > 1:
            names = " and ".join(f"'{header[min(one.values())]}'" for one in whole)
            fix = f"choose with --columns '{kind}.{{joint}}=NAME{{number}}', counted from 1, or {{index}}, from 0"
            raise RecordingError(f"several sets of columns for {kind}s: {names} ...", fix=fix, file=path, line=1)
        for one in whole:
            order = [one[i] for i in sorted(one)]
            made |= {f"{kind}.{joint}": i for joint, i in zip(joints, order, strict=True)}
            what = f"{header[order[0]]} to {header[order[-1]]} are taken for {plural(kind)}"
            notes.append(f"{what} of {joints[0]} to {joints[-1]}")
    return made, tuple(notes)


def guesses(
    header: Sequence[str], sets: NumberedSets, orders: Sequence[Sequence[str]], found: Mapping[str, int]
) -> Iterator[str]:
    """Notes on what columns may be that are not taken, with the option that takes them, as it stands.

    Positions and efforts that no column has are looked for among those that number the joints, or name as many things
    with a word for what they measure; those with such a word first, then in their order.
    """
    left = {words: one for words, one in sets.items() if not set(one.values()) & set(found.values())}
    for kind in ("position", "effort"):
        if any(signal.startswith(f"{kind}.") for signal in found):
            continue
        rows = [one for joints in orders for one in left.values() if is_count(one, len(joints))]
        rows = [one for one in rows if kind_of(header[min(one.values())]) in (kind, "")]
        one = min(rows, key=lambda one: (kind_of(header[min(one.values())]) != kind, min(one.values())), default=None)
        named = [name for i, name in enumerate(header) if i not in found.values() and kind_of(name) == kind]
        if one is not None:
            left = {words: other for words, other in left.items() if other is not one}
            first = min(one)
            name = re.sub(rf"{first}(?!.*\d)", "{number}" if first else "{index}", header[one[first]])
            option = f"--columns '{kind}.{{joint}}={name}'"
            yield f"not taken: {header[one[first]]} ...; if they are {plural(kind)}: {option}"
        elif named and len(named) in map(len, orders) and not any("," in name for name in named):
            joints = next(joints for joints in orders if len(joints) == len(named))
            pairs = ",".join(f"{kind}.{joint}={name}" for joint, name in zip(joints, named, strict=True))
            yield f"not taken: {', '.join(named)}; if they are {plural(kind)} in this order: --columns '{pairs}'"


def plural(kind: str) -> str:
    """The word for several signals of a kind."""
    return "velocities" if kind == "velocity" else f"{kind}s"


def kind_of(header: str) -> str:
    """The kind of signal of which a header has a word; empty for none, or several."""
    words = set(re.findall(r"[a-z]+", header.lower()))
    kinds = [kind for kind, synonyms in WORDS.items() if words & set(synonyms)]
    return kinds[0] if len(kinds) == 1 else ""


def is_count(numbers: Mapping[int, int], size: int) -> bool:
    """Whether there are as many as that, from 0 or 1."""
    return size > 0 and sorted(numbers) in (list(range(size)), list(range(1, size + 1)))


def read_table(path: Path) -> tuple[list[str], Array, tuple[str, ...]]:
    """Header, numbers and notes of a CSV file; separated by commas, semicolons, tabs or blanks. An empty cell is NaN.

    A last line that ends too early, because whoever wrote it was stopped, is left out.

    Raises:
        RecordingError: The file cannot be read, has no header, or a row has other cells than numbers; with the line.
    """
    try:
        text = read_bytes(path, LARGEST).decode("utf-8-sig")
    except (OSError, ValueError) as error:
        raise RecordingError("cannot be read", why=reason(error), fix="give a CSV file as text", file=path) from None
    lines = text.splitlines()
    if not lines or not any(c.isalpha() for c in lines[0]):
        raise RecordingError("no header", fix="name the columns in the first line", file=path, line=1)
    mark = next((c for c in ",;\t" if c in lines[0]), " ")
    header = header_of(lines[0], mark, path)
    try:  # whole, by numpy; anything else is looked at cell by cell
        body = lines[1:] if len(lines) > 2 else ["none"]
        table = np.loadtxt(body, delimiter=None if mark == " " else mark, comments=None, ndmin=2)
    except ValueError:
        table = np.zeros((0, 0))
    if len(table) > 1 and table.shape[1] == len(header):
        return header, table, ()
    rows = csv.reader(lines, delimiter=mark, skipinitialspace=True)
    try:
        cells = list(rows)
    except csv.Error as error:
        raise RecordingError("not a CSV file", why=str(error), file=path, line=rows.line_num) from None
    numbers: list[list[float]] = []
    notes: tuple[str, ...] = ()
    if len(cells) > 2 and len(cells[-1]) < len(header) and not text.endswith("\n"):
        notes = (f"line {len(cells)} is cut short and left out",)
        del cells[-1]
    for line, row in enumerate(cells[1:], 2):
        if not any(cell.strip() for cell in row):
            continue
        try:
            numbers.append([float(cell) if cell.strip() else np.nan for cell in row])
        except ValueError as error:
            what = str(error).replace("could not convert string to float:", "not a number:")
            raise RecordingError(what, fix="give numbers below the header", file=path, line=line) from None
        if len(row) != len(header):
            what = f"{len(row)} cells under {len(header)} headers"
            raise RecordingError(what, fix="give one cell per column", file=path, line=line)
    if len(numbers) < 2:
        raise RecordingError(f"{len(numbers)} rows of numbers", fix="give a recorded motion", file=path)
    return header, np.array(numbers), notes


def header_of(line: str, mark: str, path: Path) -> list[str]:
    """The names in a header (`RecordingError`)."""
    try:
        return bounded(next(csv.reader([line], delimiter=mark, skipinitialspace=True)))
    except (ValueError, csv.Error) as error:
        raise RecordingError("not a CSV file", why=str(error), file=path, line=1) from None


def bounded(names: Iterable[str]) -> list[str]:
    """Names of columns without blanks around them.

    Raises:
        ValueError: One is far too long: what is looked for in it would take long.
    """
    found = [name.strip() for name in names]
    if any(len(name) > LONGEST_NAME for name in found):
        raise ValueError(f"the name of a column has more than {LONGEST_NAME} letters")
    return found


def found_columns(header: Sequence[str], joints: Sequence[str], columns: Columns, path: Path) -> dict[str, int]:
    """Place of every signal that a header has, by what the user says, our names, or words in the header.

    Raises:
        UnknownName: The user names a column that is not there, or a joint that the robot does not have.
        RecordingError: Two columns for one signal.
    """
    known = ("time", *BASE, *REFERENCE, *(f"{kind}.{joint}" for kind in (*WORDS, "command") for joint in joints))
    found: dict[str, int] = {}
    for signal, name in spelled_out(columns, joints).items():
        if signal.partition(".")[0] in ("joint", "topic"):
            continue
        if signal not in known:
            raise UnknownName("signal", signal, known, key="--columns")
        if name in header:
            found[signal] = header.index(name)
        elif "{joint}" not in "".join(columns) and signal in columns:
            raise UnknownName("column", name, header, file=path, key=f"--columns {signal}")
    bare = {name.lower(): f"position.{name}" for name in joints}  # as in a reference
    by_words = plain, lambda name: meant(name, joints), lambda name: bare.get(plain(name).lower(), "")
    for signal_of in by_words:  # a name of ours stands before what words may mean
        taken = dict(found)
        for i, name in enumerate(header):
            signal = signal_of(name)
            if signal not in known or signal in taken or i in taken.values():
                continue
            if signal in found:
                what = f"two columns for {signal}: '{header[found[signal]]}' and '{name}'"
                raise RecordingError(what, fix=f"choose with --columns {signal}=HEADER", file=path, line=1)
            found[signal] = i
    return found


def spelled_out(columns: Columns, joints: Sequence[str]) -> dict[str, str]:
    """The user's mapping with a line of every joint for one with `{joint}`."""
    found: dict[str, str] = {}
    for signal, name in columns.items():
        if "{joint}" in signal:
            for i, joint in enumerate(joints):
                header = name.replace("{joint}", joint).replace("{number}", f"{i + 1}").replace("{index}", f"{i}")
                found[signal.replace("{joint}", joint)] = header
    return found | {signal: name for signal, name in columns.items() if "{joint}" not in signal}


def meant(header: str, joints: Sequence[str]) -> str:
    """The signal that a header names with other words: a joint's name and a word for what is measured; or empty."""
    plain = header.strip().strip("'\"").lower()
    first, *more = re.findall(r"[a-z]+", plain) or [""]
    if first in TIMES and not set(more) - UNITS:
        return "time"
    names = [joint for joint in joints if re.search(rf"(?<![a-z0-9]){re.escape(joint.lower())}(?![a-z0-9])", plain)]
    if not names:
        return ""
    joint = max(names, key=len)
    words = re.split(r"[^a-z]+", plain.replace(joint.lower(), " ", 1))
    kinds = [kind for kind, synonyms in WORDS.items() if set(words) & set(synonyms)]
    if len(kinds) != 1 or (set(words) & WANTED and kinds != ["effort"]):
        return ""
    return f"{'command' if set(words) & WANTED else kinds[0]}.{joint}"


# -- LeRobot datasets --------------------------------------------------------------------------------------------------

DATASET = "meta/info.json"  # in the folder of one


def read_dataset(folder: Path, robot: Robot, columns: Columns) -> list[Log]:
    """The episodes of a LeRobot dataset (v2 and v3): what its observations say, by the names of their columns.

    Names such as `JOINT.pos` are found as headers of a CSV file are; an action is what was wanted, not measured. Of a
    base they are `x.vel`, `y.vel` and `theta.vel`.

    Raises:
        RecordingError: It cannot be read, or has no rows.
    """
    try:
        import pyarrow.parquet
    except ModuleNotFoundError:
        what, fix = "a LeRobot dataset", "pip install 'mmnn_pin[export]'"
        raise RecordingError(what, why="the package pyarrow is not installed", fix=fix, file=folder) from None
    try:
        features = parsed_json(read_bytes(folder / DATASET))["features"]
        files = [pyarrow.parquet.ParquetFile(file) for file in sorted((folder / "data").rglob("*.parquet"))]
        if sum(map(numbers_in, files)) > LARGEST / 8:
            raise ValueError(f"it unpacks to more than {LARGEST / 1e6:g} MB")
        table = pyarrow.concat_tables([file.read(columns=columns_of_numbers(file)) for file in files])
        time, episode = (table[name].to_numpy() for name in ("timestamp", "episode_index"))
        named = {
            name: (bounded(names_of(features[name])), np.array(table[name].to_pylist(), float).reshape(len(time), -1))
            for name in table.column_names
            if name.startswith("observation.") and features.get(name, {}).get("dtype", "").startswith("float")
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        why = f"{type(error).__name__}: {error}".splitlines()[0]
        raise RecordingError("no LeRobot dataset that can be read", why=why, file=folder) from None
    header, tables = ["time"], [np.asarray(time, float)[:, None]]
    for names, values in named.values():
        if len(names) == values.shape[1]:
            header += [OF_BASE.get(name, name) for name in names]
            tables.append(values)
    joints = [*robot.joint_names, *(n for n in robot.full_velocity_names if n not in robot.joint_names)]
    where, whole = found_columns(header, joints, columns, folder / DATASET), np.hstack(tables)
    return [
        from_signals(f"{folder}, episode {i}", {signal: whole[episode == i, k] for signal, k in where.items()})
        for i in np.unique(episode)
    ]


def numbers_in(file: Any) -> int:
    """How many values a Parquet file has in all of its columns: a kilobyte may hold a billion equal ones."""
    groups = (file.metadata.row_group(k) for k in range(file.metadata.num_row_groups))
    return sum(group.column(k).num_values for group in groups for k in range(group.num_columns))


def columns_of_numbers(file: Any) -> list[str]:
    """Paths of the columns of numbers: of texts, a few bytes may say a billion times the same."""
    columns = map(file.schema.column, range(len(file.schema)))
    return [column.path for column in columns if column.physical_type in ("FLOAT", "DOUBLE", "INT32", "INT64")]


OF_BASE = {"x.vel": "base.v", "y.vel": "base.vy", "theta.vel": "base.w"}


def names_of(feature: Mapping[str, Any]) -> Sequence[str]:
    """Names of a feature's columns: a list, or lists by a word."""
    names = feature.get("names") or []
    return [one for part in names.values() for one in part] if isinstance(names, dict) else names


# -- recordings of this package ----------------------------------------------------------------------------------------


def from_recording(recording: Recording, robot: Robot) -> Log:
    """The log of a recorded run: what its sensors measured, and the torques of its motors.

    Raises:
        RecordingError: It cannot be read, is of another robot, or holds too few signals.
    """
    path = recording.path or Path(f"recording of {recording.meta.get('controller', 'a run')}")
    needed = ("q", "qdot", "velocity", "motor_torque")
    size = {"q": robot.dimensions.arm, "qdot": robot.dimensions.arm, "velocity": robot.dimensions.base}
    missing = [name for name in needed if name not in recording and size.get(name, 1)]
    if missing:
        what = f"the recording has no {', '.join(missing)}"
        raise RecordingError(what, fix="record all signals", file=path)
    if len(recording) < 2:
        raise RecordingError("the recording has no rows", fix="name one of a longer run", file=path)
    torque = {"applied": "effort", "motor_torque": "command"} if "applied" in recording else {"motor_torque": "effort"}
    signals = {"time": recording.time}
    for signal, kind in (TAKEN | torque).items():
        if signal in recording:
            table = as_columns(recording[signal])
            signals |= {f"{kind}.{name}": table[:, i] for i, name in enumerate(recording.labels(signal))}
    return of_recording(from_signals(str(path), signals), robot)


def of_recording(log: Log, robot: Robot) -> Log:
    """The log of a recording: its efforts are held for a period.

    Raises:
        RecordingError: It is of another robot.
    """
    known = {*robot.joint_names, *robot.actuator_names}
    if others := [name for name in log.position if name not in known]:
        what = f"the recording is of a robot with the joint '{others[0]}'"
        raise RecordingError(what, fix=f"name it with --robot; {robot.name} has {', '.join(known)}", file=log.name)
    return replace(log, effort_delay=float(np.median(np.diff(log.time))) / 2)


def read_columns(given: Sequence[str]) -> dict[str, str]:
    """The mapping of `--columns`: `SIGNAL=HEADER`, several separated by commas, or TOML files of such lines.

    Raises:
        InputError: Neither.
    """
    found: dict[str, str] = {}
    for text in given:
        if text.endswith(".toml"):
            found |= flat(read_toml(Path(text)))
            continue
        for part in text.split(","):
            signal, equals, name = part.partition("=")
            if not (equals and signal.strip() and name):
                fix = "write SIGNAL=HEADER, such as position.arm_1_joint=q1, or a file NAME.toml"
                raise InputError(f"'{part}' is no mapping", fix=fix, key="--columns")
            found[signal.strip()] = name
    return found


def flat(table: Mapping[str, object], before: str = "") -> dict[str, str]:
    """A table of tables as one, with dots between the keys."""
    found: dict[str, str] = {}
    for key, value in table.items():
        found |= flat(value, f"{before}{key}.") if isinstance(value, Mapping) else {f"{before}{key}": str(value)}
    return found
