"""Reads a study's TOML; whatever is wrong with it is told with file, line and key."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ...errors import ConfigError, InputError, UnknownName
from ...settings import Settings, wrong_type
from ..experiments.config import load_experiment, words_of
from ..experiments.controllers import CONTROLLERS
from ..experiments.experiment import Experiment
from ..experiments.files import bundled, override, read_toml
from .factors import Factor
from .lines import line_of
from .settings import Sampling, StudySettings, Success, Tune

S = TypeVar("S", bound=Settings)
PARTS: dict[str, type[Settings]] = {"sampling": Sampling, "success": Success, "tune": Tune}


@dataclass(frozen=True)
class StudyFile:
    """A study as its file has it.

    Attributes:
        settings: What it says.
        base: The experiment that it varies, without the study's changes.
        path: The file.
    """

    settings: StudySettings
    base: Experiment
    path: Path

    @property
    def name(self) -> str:
        """Its name: that of the file."""
        return self.path.stem

    def placed(self, error: InputError) -> InputError:
        """An error about a key of this study, told with file and line."""
        return placed(error, self.path)

    @contextmanager
    def placing(self) -> Iterator[None]:
        """Errors within are about keys of this study."""
        try:
            yield
        except InputError as error:
            raise self.placed(error) from None


def load_study(path: str | Path, overrides: Iterable[str] = ()) -> StudyFile:
    """Study of a TOML file.

    Args:
        path: The file.
        overrides: `key.path=value` texts that change keys of the file.

    Raises:
        InputError: The file cannot be read or is not TOML; a key is unknown, a value of the wrong type or out of
            range; the experiment does not load. With the line, where it is about the file.
    """
    path = Path(path)
    if not path.is_file():
        raise ConfigError("no such file", fix="name the TOML file of a study", file=path)
    table = read_toml(path)
    try:
        for text in overrides:
            override(table, text)
        settings = settings_of(table)
    except InputError as error:
        raise placed(error, path) from None
    return StudyFile(settings, base_of(settings, path), path)


def settings_of(table: dict[str, Any]) -> StudySettings:
    """Settings of a table read from TOML.

    Raises:
        InputError: With the key path, without the file.
    """
    factors = table.get("factors", {})
    tune = table.get("tune", {})
    gains = tune.get("gains", {}) if isinstance(tune, dict) else {}
    for prefix, group in (("factors", factors), ("tune.gains", gains)):
        for name, factor in group.items() if isinstance(group, dict) else ():
            if isinstance(factor, dict):
                part(factor, Factor, f"{prefix}.{name}")
    for name, kind in PARTS.items():
        if isinstance(table.get(name), dict):
            part(table[name], kind, name)
    return part(table, StudySettings, "")


def part(table: dict[str, Any], kind: type[S], prefix: str) -> S:
    """A part of the settings; errors name the key path from the top of the file."""
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        message, _, where = str(error).partition(" - at ")
        inner = re.sub(r"^\$\.?", "", where.strip("`"))
        if not inner and (unknown := re.search(r"unknown field `([^`]*)`", message)):
            raise UnknownName("key", unknown[1], kind.__struct_fields__, key=prefix or None) from None
        known = words_of({field.name: field.type for field in msgspec.structs.fields(kind)}.get(inner))
        what, fix = wrong_type(message, table.get(inner))
        fix = f"there is: {', '.join(known)}" if known else fix
        raise ConfigError(what, fix=fix, key=joined(prefix, inner)) from None
    except InputError as error:
        error.key = joined(prefix, error.key or "")
        raise


def joined(*parts: str) -> str:
    """Key path of parts, some of them empty."""
    return ".".join(part for part in parts if part)


def placed(error: InputError, path: Path) -> InputError:
    """The error with the study's file, and the line of its key there."""
    if error.file is None:
        error.file = path
        error.line = line_of(path.read_text(encoding="utf-8"), error.key or "") if error.key else None
    return error


def base_of(settings: StudySettings, path: Path) -> Experiment:
    """The experiment that a study varies, with the study's controllers: bundled, or a file in the study's folder.

    Raises:
        InputError: It does not load, or does not know a controller.
    """
    name: str | Path = settings.experiment
    if settings.experiment not in bundled():
        beside = path.parent / settings.experiment
        if not beside.is_file():
            fix = f"name a file from the study's folder, or one of: {', '.join(bundled())}"
            raise placed(ConfigError(f"no experiment '{settings.experiment}'", fix=fix, key="experiment"), path)
        name = beside
    found = load_experiment(name, (), settings.variant)
    try:
        if settings.controllers is not None:
            found = msgspec.structs.replace(found, controllers=settings.controllers)
        if settings.tune is not None and settings.tune.controller not in (there := {**CONTROLLERS, **found.laws}):
            raise UnknownName("controller", settings.tune.controller, there, key="tune.controller")
    except InputError as error:
        raise placed(error, path) from None
    return found
