"""How well a run followed its reference: one line for every direction of the base and every joint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from html import escape
from typing import Any

import numpy as np

from ..errors import UnknownName
from ..model.urdf.reading import parse_xml
from ..settings.arguments import faced
from ..signals import Array


@dataclass(frozen=True)
class Error:
    """The error of one direction of the base or of one joint."""

    rms: float  # root of its mean square
    peak: float  # its largest magnitude
    last: float  # its magnitude at the end
    unit: str  # of all three: m or rad


@faced
class Errors(Mapping[str, Error]):
    """Errors by name: `x`, `y`, `phi` of the base in its own frame, then the arm's joints.

    It prints as a table in mm and mrad.

    Args:
        errors: By name.
        start: Since when [s].
        stop: Until when [s].
    """

    def __init__(self, errors: Mapping[str, Error], start: float, stop: float) -> None:
        self._errors, self.start, self.stop = dict(errors), start, stop

    @classmethod
    def of(
        cls, time: Array, columns: Mapping[str, tuple[Array, str]], start: float = 0.0, stop: float = np.inf
    ) -> Errors:
        """Errors of columns (N,) with their units, over the samples from `start` on and before `stop` [s]."""
        kept = (time >= start) & (time < stop)
        found = {}
        for name, (values, unit) in columns.items():
            size = np.abs(values[kept])
            some = bool(size.size)
            found[name] = Error(
                rms=float(np.sqrt(np.mean(size * size))) if some else np.nan,
                peak=float(size.max()) if some else np.nan,
                last=float(size[-1]) if some else np.nan,
                unit=unit,
            )
        return cls(found, start, min(stop, float(time[-1])) if len(time) else stop)

    def __getitem__(self, name: str) -> Error:
        if name not in self._errors:
            raise UnknownName("error", str(name), self._errors)
        return self._errors[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._errors)

    def __len__(self) -> int:
        return len(self._errors)

    def to_dict(self) -> dict[str, Any]:
        """Numbers by name, in SI units."""
        return {name: asdict(error) for name, error in self.items()}

    def rows(self) -> list[tuple[str, ...]]:
        """Lines of a table, the heads first: name, RMS, peak and last in thousandths, their unit."""
        numbers = ((name, e, [f"{1e3 * value:.3g}" for value in (e.rms, e.peak, e.last)]) for name, e in self.items())
        return [("error", "RMS", "peak", "last", ""), *((name, *three, f"m{e.unit}") for name, e, three in numbers)]

    def __repr__(self) -> str:
        rows = self.rows()
        return f"from {self.start:.3g} s to {self.stop:.3g} s\n{in_columns(rows)}"

    def _repr_html_(self) -> str:
        """The table for a notebook."""
        tagged = zip(("th", *["td"] * len(self)), self.rows(), strict=True)
        lines = [f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in row)}</tr>" for tag, row in tagged]
        return f"<p>from {self.start:.3g} s to {self.stop:.3g} s</p><table>{''.join(lines)}</table>"


def in_columns(rows: Sequence[Sequence[str]]) -> str:
    """Texts under each other: the first and the last column from the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    last = len(widths) - 1

    def line(row: Sequence[str]) -> str:
        cells = enumerate(zip(row, widths, strict=True))
        return "  ".join(cell.ljust(w) if i in (0, last) else cell.rjust(w) for i, (cell, w) in cells).rstrip()

    return "\n".join(map(line, rows))


def prismatic_joints(urdf: str) -> set[str]:
    """Names of the sliding joints in the text of a URDF; none without a text that can be read."""
    root, _ = parse_xml(urdf.encode())
    joints = () if root is None else root.iter("joint")
    return {joint.get("name", "") for joint in joints if joint.get("type") == "prismatic"}
