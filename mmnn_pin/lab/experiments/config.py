"""From a TOML file to an experiment.

Finds the file and what it starts from, applies overrides, and names the key path of whatever is wrong.
"""

from __future__ import annotations

import glob
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from difflib import get_close_matches
from pathlib import Path
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec

from ...disturbance import Disturbance
from ...errors import ConfigError, InputError, RecordingError, UnknownKey, UnknownName, keyed
from ...files import parsed_toml, read_toml
from ...model.base.overrides import Overrides
from ...model.loading import load_with
from ...recording.recording import Recording
from ...settings import Settings
from ...settings.arguments import checked, unknown_key, wrong_type
from .controllers import of_today
from .experiment import FITTED, Experiment
from .hardware import COARSEST, WAYS_OUT, Fitted, UnfitHardware, borne, require_strength
from .hardware_table import GROUPS, BaseHardware, HardwareTable, JointHardware, beside_urdf, completed
from .origins import of_override, path_of, placed
from .references import as_long_as_its_file

FOLDER = Path(__file__).parent
ITS_OWN = ("title", "variant", "experiment", "cases")  # keys that no other experiment takes over
UNIONS = (Union, UnionType)
E = TypeVar("E", bound=Experiment)
SHORT_NUMBER = re.compile(r"[+-]?(\d+\.|\.\d+)([eE][+-]?\d+)?")  # TOML wants a digit on both sides of the point


@checked
def load_experiment(name_or_path: str | Path, overrides: Sequence[str] = (), variant: str | None = None) -> Experiment:
    """Experiment by name or from a TOML file.

    Args:
        name_or_path: A bundled name (`chapter4`) or a path to a file.
        overrides: `key.path=value` texts, values as in TOML (a bare word is a text).
        variant: Which variant, where the experiment has several; None for its default.

    Raises:
        UnknownName: No such experiment or variant.
        ConfigError: The file cannot be read or is not TOML, a key is unknown, a value of the wrong type or range.

    >>> load_experiment("chapter4", ["time.duration=0.2"]).time.duration
    0.2
    """
    return load_as(Experiment, name_or_path, overrides, variant)


def load_as(kind: type[E], name_or_path: str | Path, overrides: Iterable[str], variant: str | None) -> E:
    """An experiment of a kind that may have tables of its own; else as `load_experiment`."""
    path, texts = find(name_or_path), tuple(overrides)
    if variant is not None:
        path = find_variant(path, variant)
    table = complete(path)
    further = [text for text in texts if text.startswith("hardware.")]  # on top of whatever hardware there is
    for text in texts:
        if text not in further:
            override(table, text)
    if any(text.startswith("reference.file") for text in texts) and "title" not in {text[:5] for text in texts}:
        table["title"] = f"The motion of {Path(str(table['reference']['file'])).name}"
    own = from_its_folder(read_toml(path), path)
    if not any(text.startswith(("time.duration", "time=")) for text in texts):
        as_long_as_its_file(table, own if path.parent != FOLDER else {})
    with_starts(table, own, path, texts)
    try:
        require_overrides(table.get("overrides", {}))
        require_disturbances(table.get("disturbances"))
        if "hardware" not in table and (beside_it := beside_urdf(str(table.get("robot", "")))):
            table["hardware"] = beside_it
        if further and isinstance(named := table.get("hardware"), str):
            table["hardware"] = {"profile": named}
        for text in further:
            override(table, text)
        if table.get("hardware") is not None:
            return on_hardware(table, own if path.parent != FOLDER else {}, texts, kind)
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        raise from_where(config_error(error, table, kind), path, texts) from error
    except InputError as error:
        raise from_where(error, path, texts) from None


def from_where(error: InputError, path: Path, texts: Iterable[str]) -> InputError:
    """An error at a key of the experiment in a file, with the override or the file and line that the key comes from."""
    found = of_override(error, texts)
    return placed(error, *users_own(path)) if found is error else found


def users_own(path: Path) -> list[Path]:
    """The file of an experiment and those that it starts from, without what comes with the package."""
    name = read_toml(path).get("experiment")
    further = [] if name is None else users_own(beside(path, name))
    return [path, *further] if path.parent != FOLDER else further


def on_hardware(table: dict[str, Any], own: Mapping[str, Any], texts: Iterable[str], kind: type[E]) -> E:
    """An experiment on its hardware, arguments and errors as of `fitted_to`; a refusal names a profile that can."""
    given = deepcopy(table)
    try:
        return fitted_to(table, own, texts, kind)
    except UnfitHardware as error:
        fix = error.fix
        for name, what in WAYS_OUT.items():
            with suppress(InputError):
                fitted_to(deepcopy(given) | {"hardware": name}, own, texts, kind)
                fix += f"; --hardware {name} {what}"
                break
        raise error.but(fix=fix) from None


def fitted_to(table: dict[str, Any], own: Mapping[str, Any], texts: Iterable[str], kind: type[E]) -> E:
    """An experiment with all that follows from its table of hardware, on top of what it starts from.

    Args:
        table: The experiment, with its hardware; changed.
        own: What a user's file says itself: it counts more.
        texts: Overrides, which count most.
        kind: Of experiment.

    Raises:
        InputError: Hardware that cannot be, a robot that cannot, motors too weak for the motion.
    """
    given = table["hardware"]
    hardware = read_hardware(given)
    robot = load_with(table["robot"], msgspec.convert(table.get("overrides", {}), Overrides))
    try:
        fitted = Fitted(hardware, robot)
    except InputError as error:
        raise in_hardware(error, given) from None
    said = merged({}, {key: value for key, value in own.items() if key != "hardware"})
    for text in texts:
        if text.partition("=")[0].partition(".")[0].strip() != "hardware":
            override(said, text)

    def under(settings: Mapping[str, Any]) -> None:
        kept = {key: said[key] for key in settings if key in said}
        table.update(merged({key: table.get(key, {}) for key in settings}, merged(settings, kept)))

    table["hardware"] = msgspec.to_builtins(hardware)
    under(fitted.settings())
    times, stated = table.setdefault("time", {}), said.get("time", {})
    period = times.get("control_period")
    if hardware.rate is not None and period:
        if "plant_step" not in stated:
            times["plant_step"] = period / math.ceil(period / COARSEST - 1e-9)
        if "duration" in times:
            times["duration"] = round(times["duration"] / period) * period
    experiment = msgspec.convert(table, kind)
    true = experiment.made_true(robot)
    require_strength(fitted, experiment, true)
    notes = fitted.notes()
    if gains := borne(experiment, true):
        under({"kinematic": gains})
        told = ", ".join(f"{name} = {value}" for name, value in gains.items())
        notes += (f"kinematic gains that the whole loop on this hardware bears: {told}",)
    table["hardware"] |= {"notes": notes}
    experiment = msgspec.convert(table, kind)
    FITTED.clear()
    FITTED[experiment.of_robot()] = true
    return experiment


def read_hardware(given: str | Mapping[str, Any]) -> HardwareTable:
    """A table of hardware on top of the profile that it starts from.

    Args:
        given: Name of a profile, a file, or a table.

    Raises:
        UnknownName: No such profile or key.
        ConfigError: A file that cannot be read, a value that cannot be.
    """
    table, _ = completed(given, merged)
    kinds = dict.fromkeys(GROUPS, JointHardware) | {"base": BaseHardware}
    for name, value in table.items():
        if name in kinds:
            as_hardware(value, kinds[name], given, f"{name}.")
        elif name == "joints" and isinstance(value, Mapping):
            for joint, item in value.items():
                as_hardware(item, JointHardware, given, f"joints.{joint}.")
    made: HardwareTable = as_hardware(table, HardwareTable, given, "")
    return made


def as_hardware(value: Any, kind: type[Settings], given: str | Mapping[str, Any], prefix: str) -> Any:
    """A part of what is given to `read_hardware`, behind a prefix, as settings of a kind."""
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        found = config_error(error, value, kind)
        own = found.key or ""
    except ConfigError as error:
        found, own = error, (error.key or "").removeprefix(".").removeprefix("base.")
    raise in_hardware(found.but(key=f"{prefix}{own}".rstrip(".") or None), given) from None


def in_hardware(error: InputError, given: str | Mapping[str, Any]) -> InputError:
    """An error in what is given to `read_hardware`: in the file that has its key, or at its key in the experiment."""
    key = (error.key or "").removeprefix("hardware.")
    within = error.but(key=key or None)
    found = placed(within, *completed(given, merged)[1])
    its_own = isinstance(given, Mapping) and (found.line is None or value_at(given, path_of(within)) is not None)
    return error.but(key=f"hardware.{key}".rstrip(".")) if its_own or found.file is None else found


def on_other_hardware(base: E, table: dict[str, Any], said: Mapping[str, Any]) -> E:
    """An experiment on hardware that a case or a study gives it, with all that follows.

    Args:
        base: The experiment.
        table: All of it, as changed; changed.
        said: What is changed: it counts more than the hardware.

    Raises:
        InputError: As of `on_hardware`; an experiment with hardware of its own.
    """
    if base.hardware is not None:
        why = "what follows from one cannot be taken back for another"
        raise ConfigError("the experiment has hardware", why=why, fix="leave it out there", key="hardware")
    try:
        return on_hardware(table, said, (), type(base))
    except InputError as error:
        raise error.but(key=(error.key or "hardware").removeprefix("--")) from None


def recorded_experiment(recording: Recording) -> Experiment | None:
    """The experiment of a recording; None where it was run without one.

    Raises:
        RecordingError: Another version wrote it.
    """
    if not recording.config_text:
        return None
    try:
        table = msgspec.json.decode(recording.config_text, type=dict[str, Any])
        return msgspec.convert(of_today(without_null(table)), Experiment)
    except (msgspec.DecodeError, InputError) as error:
        raise RecordingError(
            "its config cannot be read",
            why=f"another version of mmnn_pin wrote it: {' '.join(str(error).split())}",
            file=recording.path,
        ) from error


def named_files(experiment: Experiment) -> list[str]:
    """Files that an experiment names for its motion and its learners: none is opened because a recording names it."""

    def within(key: str, value: Any) -> Iterator[str]:
        if key in ("file", "start") and isinstance(value, str) and value:
            yield value
        for name, item in value.items() if isinstance(value, dict) else ():
            yield from within(name, item)
        for item in value if isinstance(value, list) else ():
            yield from within("", item)

    return [*within("", msgspec.json.decode(experiment.to_json()))]


def without_null(value: Any) -> Any:
    """A value of JSON without what is null there: what is None by default, and times that are inf by default."""
    if isinstance(value, dict):
        return {key: without_null(item) for key, item in value.items() if item is not None}
    return [without_null(item) for item in value] if isinstance(value, list) else value


def bundled() -> dict[str, Path]:
    """Experiments that come with the package, name to file; of one with variants the file of its default."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.toml")) if "." not in path.stem}


def variants(path: Path) -> dict[str, Path]:
    """Variants of an experiment, name to file, the default first.

    `NAME.toml` is the default and says its variant's name itself; the others are `NAME.VARIANT.toml` beside it.
    """
    own = read_toml(path).get("variant")
    others = sorted(path.parent.glob(f"{glob.escape(path.stem)}.*.toml"))
    return ({own: path} if own else {}) | {other.stem.removeprefix(f"{path.stem}."): other for other in others}


def find(name_or_path: str | Path) -> Path:
    """File of an experiment.

    Raises:
        UnknownName: Neither a bundled name nor something that looks like a path.
        ConfigError: A path without a file.
    """
    text = str(name_or_path)
    if text in bundled():
        return bundled()[text]
    path = Path(text)
    if path.suffix != ".toml" and len(path.parts) < 2 and not path.exists():
        raise UnknownName("experiment", text, bundled())
    if not path.is_file():
        raise ConfigError("no such file", fix=f"name a TOML file, or one of: {', '.join(bundled())}", file=path)
    return path


def find_variant(path: Path, variant: str) -> Path:
    """File of an experiment's variant.

    Raises:
        UnknownName: It has no such variant.
        ConfigError: It has no variants.
    """
    known, own = variants(path), path if path.parent != FOLDER else None
    if not known:
        raise ConfigError(f"{path.stem} has no variants", fix="leave --variant out", file=own, key="--variant")
    if variant not in known:
        raise UnknownName("variant", variant, known, file=own, key="--variant")
    return known[variant]


def complete(path: Path, before: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Content of a TOML file; where its key `experiment` names another one, on top of what that one says.

    Args:
        path: The file.
        before: Files that have led to it.

    Raises:
        UnknownName: No such experiment.
        ConfigError: A file cannot be read, or starts from itself.
    """
    table = from_its_folder(read_toml(path), path)
    name = table.pop("experiment", None)
    if name is None:
        return table
    if path in before:
        raise placed(ConfigError("starts from itself", fix="name another experiment", key="experiment"), path)
    try:
        start = beside(path, name)
    except UnknownName as error:
        raise placed(error.but(key="experiment"), path) from None
    return merged(inherited(complete(start, (*before, path))), table)


def with_starts(table: dict[str, Any], own: Mapping[str, Any], path: Path, overrides: tuple[str, ...]) -> None:
    """Complete the cases that start from another experiment: that one, what this file itself says, overrides, the case.

    Args:
        table: The experiment, changed in place.
        own: What its file itself says.
        path: The file.
        overrides: `key.path=value` texts.

    Raises:
        UnknownName: No such experiment.
        ConfigError: A file cannot be read, or an override sets nothing.
    """
    cases = table.get("cases")
    for name, case in cases.items() if isinstance(cases, dict) else ():
        if not (isinstance(case, dict) and case.get("experiment")):
            continue
        try:
            start = merged(inherited(complete(beside(path, case["experiment"]))), inherited(own))
        except UnknownName as error:
            raise placed(error.but(key=f"cases.{name}.experiment"), path) from None
        for text in overrides:
            if not text.startswith("cases."):
                override(start, text)
        changes = case.get("set", {})
        case["own"], case["set"] = list(changes), merged(start, changes)


def inherited(table: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a table that another experiment takes over."""
    return {key: value for key, value in table.items() if key not in ITS_OWN}


def beside(path: Path, name: Any) -> Path:
    """File of an experiment that a file names: a path from its folder, or as in `find`."""
    there = path.parent / str(name)
    return there if there.suffix == ".toml" and there.is_file() else find(str(name))


def from_its_folder(table: dict[str, Any], path: Path) -> dict[str, Any]:
    """The table of a file; robots and motions that lie in its folder are named from there."""
    reference = table.get("reference")
    for where, key in ((table, "robot"), (reference, "file")):
        name = where.get(key) if isinstance(where, dict) else None
        if isinstance(name, str) and Path(name).suffix and (path.parent / name).is_file():
            where[key] = str(path.parent / name)  # type: ignore[index]
    return table


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A table with the keys of another, tables in it likewise; a table of another `type` replaces the old one."""
    result = dict(table)
    for key, value in changes.items():
        old = result.get(key)
        both = isinstance(value, Mapping) and isinstance(old, Mapping)
        same = both and value.get("type", old.get("type")) == old.get("type")  # type: ignore[union-attr]
        result[key] = merged(old, value) if same else value  # type: ignore[arg-type]
    return result


def override(table: dict[str, Any], text: str) -> None:
    """Set `key.path=value` in a table read from TOML.

    Raises:
        ConfigError: No `=`, or the path runs through something that is not a table.
    """
    key, equals, value = text.partition("=")
    key = key.strip()
    if not equals or not all(key.split(".")):
        raise ConfigError(f"'{text}' sets nothing", fix="write key.path=value, e.g. time.duration=2", key="--set")
    put(table, key, parse_value(value.strip()))


def put(table: dict[str, Any], key: str, value: Any) -> None:
    """Set a value at a key path of a table; numbers in the path are places in lists, counted from 0.

    Raises:
        ConfigError: The path runs through something that is not a table, or a list has no such place.
    """
    parts = key.split(".")
    here: Any = table
    for part in parts[:-1]:
        here = here[place(here, part, key)] if isinstance(here, list) else here.setdefault(part, {})
        if not isinstance(here, (dict, list)):
            raise ConfigError(f"'{part}' is not a table", fix="see the experiment's TOML for its keys", key=key)
    here[place(here, parts[-1], key) if isinstance(here, list) else parts[-1]] = value


def place(items: list[Any], part: str, key: str) -> int:
    """Place in a list that a part of a key path names.

    Raises:
        ConfigError: The list has no such place.
    """
    if not (part.isdecimal() and int(part) < len(items)):
        raise ConfigError(f"'{part}' is no place in a list of {len(items)}", fix="count from 0", key=key)
    return int(part)


def parse_value(text: str) -> Any:
    """Value as TOML reads it, with .5 and 5. as numbers, too; what neither reads is a text."""
    try:
        return parsed_toml(f"value = {text}")["value"]
    except ValueError:
        return float(text) if SHORT_NUMBER.fullmatch(text) else text


def require_overrides(table: Any) -> None:
    """Judge what is declared about the robot by itself: its errors name keys of a file of its own.

    Raises:
        InputError: A value out of range, with the key path of an experiment.
    """
    # a wrong type is reported with its path when the whole experiment is read
    with suppress(msgspec.ValidationError), keyed("overrides.{}".format):
        msgspec.convert(table, Overrides)


def require_disturbances(items: Any) -> None:
    """Judge every disturbance by itself: its errors do not know its place in the list.

    Raises:
        ConfigError: A value out of range, with the key path of an experiment.
    """
    for i, item in enumerate(items if isinstance(items, list) else ()):
        outside = f"disturbances.{i}.{{}}".format
        with suppress(msgspec.ValidationError), keyed(lambda key, to=outside: to(key.removeprefix("disturbances."))):  # type: ignore[misc]
            msgspec.convert(item, Disturbance)


def config_error(error: msgspec.ValidationError, table: Any = None, root: type[Settings] = Experiment) -> ConfigError:
    """The key path and a line of advice out of a message such as "Expected `int` - at `$.seed`".

    Args:
        error: From the conversion.
        table: What was converted; tells which of several types a table is.
        root: To what it was.
    """
    message, _, where = str(error).partition(" - at ")
    there = re.sub(r"\[(\d+)\]", r".\1", where.strip("`").removeprefix("$").replace("[...]", ".*")).removeprefix(".")
    key = with_names(there, table, root) or None
    kind, known = kind_at(key, table, root), tuple[str, ...]()
    unknown = unknown_key(error)
    if unknown is not None:
        known = keys_of(kind)
        tables = [".".join(filter(None, (key, name))) for name in known]
        below = [f"{one}.{unknown}" for one in tables if unknown in keys_of(kind_at(one, table, root))]
        near = below[:3] or get_close_matches(unknown, known, n=1)
        guess = f"did you mean {' or '.join(map(repr, near))}? " if near else ""
        fix = f"{guess}there is: {', '.join(known)}" if known else "leave it out"
        return UnknownKey(unknown, fix=fix, key=key)
    if "missing required field `type`" in message:
        message, known = "the key 'type' is missing", tags_of(kind)
    elif key and (wrong := re.fullmatch(r"Invalid value '(.*)'", message)):
        message, known = f"unknown type '{wrong[1]}'", tags_of(kind_at(key.rpartition(".")[0], table, root))
    elif wrong := re.fullmatch(r"Invalid enum value '?(.*?)'?", message):
        message, known = f"unknown value '{wrong[1]}'", words_of(kind)
        known += ("or a number",) if float in get_args(kind) else ()
    if known:
        return ConfigError(message, fix=f"there is: {', '.join(known)}", key=key)
    what, fix = wrong_type(message, value_at(table, key))
    return ConfigError(what, fix=fix, key=key)


def with_names(key: str, table: Any, root: type[Settings]) -> str:
    """A key path with `*`, which stands for a name, as that of the first entry there that is of the wrong type."""
    head, star, rest = key.partition(".*")
    if not star:
        return key
    entries, kind = value_at(table, head), kind_at(f"{head}.*", table, root)
    if kind is None:
        return head
    for name, entry in entries.items() if isinstance(entries, dict) else ():
        try:
            msgspec.convert(entry, kind)
        except msgspec.ValidationError:
            return with_names(f"{head}.{name}{rest}", table, root)
        except InputError:
            continue
    return head


def value_at(table: Any, key: str | None) -> Any:
    """The value in a table at a key path; None where there is none."""
    for part in key.split(".") if key else ():
        table = entry_of(table, part)
    return table if key else None


def kind_at(key: str | None, table: Any = None, root: type[Settings] = Experiment) -> Any:
    """The type that stands at a key path, of a table with a `type` the one that it says; None where there is none."""
    kind: Any = root
    for part in (key or "").split("."):
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct) and part:
            kind, table = {f.encode_name: f.type for f in msgspec.structs.fields(kind)}.get(part), entry_of(table, part)
        elif get_origin(kind) in (tuple, list) and part:
            kind, table = get_args(kind)[0], entry_of(table, part)
        elif part and (tables := [k for k in (kind, *get_args(kind)) if get_origin(k) is dict]):
            kind, table = get_args(tables[0])[1], entry_of(table, part)
        elif part:
            return None
        kinds = tuple(k for k in get_args(kind) if k is not type(None)) if get_origin(kind) in UNIONS else (kind,)
        named = [k for k in kinds if len(kinds) > 1 and entry_of(table, "type") in tags_of(k)]
        kind = named[0] if named else kinds[0] if len(kinds) == 1 else Union[kinds]  # noqa: UP007
    return kind


def entry_of(table: Any, part: str) -> Any:
    """The value in a table or a list at one part of a key path; None where there is none."""
    if isinstance(table, list):
        return table[int(part)] if part.isdecimal() and int(part) < len(table) else None
    return table.get(part) if isinstance(table, dict) else None


def keys_of(kind: Any) -> tuple[str, ...]:
    """Keys of settings; none of anything else."""
    is_settings = isinstance(kind, type) and issubclass(kind, msgspec.Struct)
    return tuple(f.encode_name for f in msgspec.structs.fields(kind)) if is_settings else ()


def tags_of(kind: Any) -> tuple[str, ...]:
    """Values of the key `type` of one kind of settings or several."""
    kinds = get_args(kind) or (kind,)
    found = [k.__struct_config__.tag for k in kinds if isinstance(k, type) and issubclass(k, msgspec.Struct)]
    return tuple(str(tag) for tag in found if tag is not None)


def words_of(kind: Any) -> tuple[str, ...]:
    """Words that stand for a value, such as those of `Literal["true", "odometry"]`."""
    if get_origin(kind) is Literal:
        return tuple(map(str, get_args(kind)))
    return tuple(word for part in get_args(kind) for word in words_of(part)) if get_origin(kind) in UNIONS else ()
