"""Controllers of a user by `FILE.py:Class` or `package.module:Class`: read, judged, made with an experiment's gains.

Naming one runs its file, so nothing here is called because a recording says so: only for what a user asks to run.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any, cast, get_type_hints

import msgspec

from ...errors import ConfigError, InputError, UnknownName
from ...files import read_bytes, reason
from ...settings.arguments import wrong_type
from ...torque.controller import Feedback, TorqueController
from ...torque.learning_law import DIGEST, LearningLaw, sha256, told

SPEC = re.compile(r"(?P<place>.+\.py|[A-Za-z_][\w.]*):(?P<kind>[A-Za-z_]\w*)")
NAME = re.compile(r"[A-Za-z_][\w-]*")
LAW = "law"  # key of a table [laws.NAME] that says where its class is
GIVEN = ("feedback", "learning")  # what the experiment gives, the same to all controllers


def is_spec(name: str) -> bool:
    """Whether a controller's name says where its class is."""
    return ":" in name or name.endswith(".py")


def parsed(spec: str) -> tuple[str, str]:
    """File or module of a class, and its name, by which the controller is called in tables and files.

    Raises:
        ConfigError: The text does not say which class of which file.
    """
    found = SPEC.fullmatch(spec)
    if found is None:
        fix = "write FILE.py:Class, or package.module:Class"
        raise ConfigError(f"'{spec}' names no class", fix=fix, key="controllers")
    return found["place"], found["kind"]


def name_of(controller: str) -> str:
    """Name of a controller in tables and files, also of one that says where its class is."""
    return parsed(controller)[1] if is_spec(controller) else controller


def resolved(
    controllers: tuple[str, ...], laws: Mapping[str, Mapping[str, Any]], taken: Mapping[str, Any]
) -> tuple[tuple[str, ...], dict[str, dict[str, Any]]]:
    """Controllers by name, and the tables of the laws among them, each saying where its class is; no file is read.

    Args:
        controllers: Names, some of them such as `FILE.py:Class`.
        laws: Tables of an experiment, name to where the class is and its settings.
        taken: Names of this package's controllers.

    Raises:
        ConfigError: Two classes of one name, a name that is taken or that makes no file name, a table without a class.
    """
    tables = {name: dict(table) for name, table in laws.items()}
    names = []
    for controller in controllers:
        if is_spec(controller):
            name = name_of(controller)
            where = tables.setdefault(name, {}).setdefault(LAW, controller)
            if where != controller:
                raise ConfigError(
                    f"'{controller}' is called {name}, too",
                    why=f"laws.{name} is {where}",
                    fix="name one of them in a table of its own, [laws.NAME]",
                    key="controllers",
                )
            controller = name
        names.append(controller)
    for name, table in tables.items():
        if name in taken:
            raise ConfigError(
                f"'{name}' is a controller of this package",
                fix="call it otherwise: in a table [laws.NAME] with law = 'FILE.py:Class'",
                key=f"laws.{name}",
            )
        if not NAME.fullmatch(name):
            raise ConfigError(f"'{name}' is no name for a file", fix="use letters, digits, _ and -", key=f"laws.{name}")
        if not isinstance(table.get(LAW), str):
            raise ConfigError(
                "it does not say where its class is",
                fix=f"say law = 'FILE.py:Class' there, or run --controller FILE.py:{name}",
                key=f"laws.{name}",
            )
        parsed(table[LAW])
    return tuple(names), tables


def own_controller(name: str, table: Mapping[str, Any], feedback: Feedback, learning: bool) -> TorqueController:
    """A user's controller with the gains of an experiment; runs its file.

    Args:
        name: Its name in tables and files.
        table: Where its class is, and its settings.
        feedback: K.
        learning: Whether it learns.

    Raises:
        InputError: As `load_class`; settings that it does not take.
    """
    kind = load_class(table[LAW])
    settings = {key: value for key, value in table.items() if key != LAW}
    given: dict[str, Any] = {"feedback": feedback, "learning": learning}
    if issubclass(kind, LearningLaw):
        made: TorqueController = with_settings(kind, settings, f"laws.{name}", given)
    else:
        takes = inspect.signature(kind).parameters
        made = construct(kind, settings | {key: given[key] for key in GIVEN if key in takes}, f"laws.{name}")
    object.__setattr__(made, "name", name)
    return made


def with_settings(
    kind: type[LearningLaw], settings: Mapping[str, Any], key: str, given: Mapping[str, Any]
) -> LearningLaw:
    """A law with settings read from a table, each converted to the type that the class declares.

    Raises:
        ConfigError: An unknown one, one that the experiment gives, or one of the wrong type.
        InputError: The class refuses them.
    """
    own = {f.name for f in fields(kind)} - set(GIVEN)
    hints, values = get_type_hints(kind), {}
    for setting, value in settings.items():
        if setting in GIVEN:
            raise ConfigError(
                "the experiment gives it, equal for all",
                fix="set [feedback], or learning.learning, for all controllers",
                key=f"{key}.{setting}",
            )
        if setting not in own:
            raise UnknownName("setting", setting, sorted(own), key=key)
        try:
            values[setting] = msgspec.convert(value, hints[setting])
        except msgspec.ValidationError as error:
            what, fix = wrong_type(error, value)
            raise ConfigError(what, fix=fix, key=f"{key}.{setting}") from error
    return cast(LearningLaw, construct(kind, values | dict(given), key))


def construct(kind: type[TorqueController], settings: Mapping[str, Any], key: str) -> TorqueController:
    """An object of a user's class.

    Raises:
        InputError: Its constructor fails, in one line.
    """
    try:
        return kind(**settings)
    except InputError:
        raise
    except Exception as error:
        fix = f"give its settings in [{key}]" if isinstance(error, TypeError) else ""
        raise told(error, f"{kind.__name__} cannot be made", source(kind)).but(key=key, fix=fix) from error


def load_class(spec: str) -> type[TorqueController]:
    """The class of a controller; runs its file.

    Args:
        spec: `FILE.py:Class` or `package.module:Class`.

    Raises:
        InputError: No such file or module, one that fails when it is read, no such class, or one that is no
            `TorqueController`, lacks a method, or has one with other arguments.
    """
    place, name = parsed(spec)
    module = read_file(Path(place)) if place.endswith(".py") else read_module(place)
    kind, file = getattr(module, name, None), getattr(module, "__file__", None)
    if not isinstance(kind, type):
        there = tuple(own_classes(module))
        raise ConfigError(
            f"it has no controller class '{name}'",
            fix=f"there is: {', '.join(there)}" if there else "write a class derived from mmnn_pin.LearningLaw",
            file=file,
        )
    if not issubclass(kind, TorqueController):
        raise ConfigError(
            f"{name} is no TorqueController",
            fix="derive it from mmnn_pin.LearningLaw or mmnn_pin.TorqueController",
            file=file,
            line=line_of(kind),
        )
    if missing := sorted(getattr(kind, "__abstractmethods__", ())):
        raise ConfigError(f"{name} lacks {', '.join(missing)}", fix="write it", file=file, line=line_of(kind))
    base = LearningLaw if issubclass(kind, LearningLaw) else TorqueController
    for method in sorted(base.__abstractmethods__):
        asked, own = (inspect.signature(getattr(one, method)) for one in (base, kind))
        try:
            own.bind(*asked.parameters)
        except TypeError:
            what = f"{name}.{method} takes {', '.join(own.parameters)}"
            fix = f"write def {method}({', '.join(asked.parameters)})"
            raise ConfigError(what, fix=fix, file=file, line=line_of(kind)) from None
    return kind


def read_file(path: Path) -> Any:
    """A module from a file, once per content; its folder is where it finds what lies beside it.

    Raises:
        InputError: No such file, or one that fails when it is run, with the line.
    """
    path = path.absolute()
    try:
        content = read_bytes(path)
    except (OSError, ValueError) as error:
        raise ConfigError(
            "cannot be read", why=reason(error), fix="name a file of Python as FILE.py:Class", file=path
        ) from error
    digest = sha256(content)
    name = f"mmnn_pin_law_{sha256(str(path).encode())[:8]}_{digest[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    loader = importlib.util.spec_from_file_location(name, path)
    assert loader is not None and loader.loader is not None
    module = importlib.util.module_from_spec(loader)
    setattr(module, DIGEST, digest)
    sys.modules[name] = module
    sys.path.insert(0, str(path.parent))
    try:
        exec(compile(content, str(path), "exec"), module.__dict__)
    except BaseException as error:
        del sys.modules[name]
        if isinstance(error, InputError) or not isinstance(error, Exception | SystemExit):
            raise
        raise told(error, "the file fails when it is read", path) from error
    finally:
        if str(path.parent) in sys.path:
            sys.path.remove(str(path.parent))
    return module


def read_module(name: str) -> Any:
    """An installed module.

    Raises:
        InputError: There is none of that name, or it fails when it is imported.
    """
    try:
        return importlib.import_module(name)
    except Exception as error:
        fix = "name a file as FILE.py:Class, or an installed module as package.module:Class"
        raise told(error, f"no module '{name}'", None).but(fix=fix) from error


def digest_of(spec: str) -> str:
    """Hash of the file of a class, which is not run; empty where it cannot be read."""
    with suppress(ConfigError, OSError, ImportError, AttributeError, TypeError, ValueError):
        place, _ = parsed(spec)
        file = place if place.endswith(".py") else importlib.util.find_spec(place).origin  # type: ignore[union-attr]
        return sha256(read_bytes(file))  # type: ignore[arg-type]
    return ""


def own_classes(module: Any) -> Iterator[str]:
    """Controllers that are written in a module."""
    for name, value in vars(module).items():
        if isinstance(value, type) and issubclass(value, TorqueController) and value.__module__ == module.__name__:
            yield name


def source(kind: type) -> Path | None:
    """File of a class."""
    file = getattr(sys.modules.get(kind.__module__), "__file__", None)
    return None if file is None else Path(file).absolute()


def line_of(kind: type) -> int | None:
    """Line at which a class begins."""
    try:
        return inspect.getsourcelines(kind)[1]
    except (OSError, TypeError):
        return None


def known_law(name: str, digest: str) -> type[LearningLaw] | None:
    """A law that is defined in this process, by the name of its class; of several the one of that file's hash."""
    found: list[type[LearningLaw]] = []
    left: list[Any] = [LearningLaw]
    while left:
        children = left.pop().__subclasses__()
        found += [kind for kind in children if kind.__name__ == name]
        left += children
    same = [kind for kind in found if getattr(sys.modules.get(kind.__module__), DIGEST, None) == digest]
    return next(reversed(same or found), None)
