"""The reduced model as text: matrices with the names of their rows and columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def model_text(model: dict[str, Any]) -> str:
    """Text of what `mmnn_pin.model.inspection.model_at` gives."""
    names, full, motors = model["velocity_names"], model["full_velocity_names"], model["actuator_names"]
    rows = [f"constraint {i + 1}" for i in range(len(model["A"]))]
    blocks = [
        f"robot {model['robot']}, base {model['base']}",
        "M nudot + C nu + gravity + friction = E u,   velocity = T nu,   A velocity = 0",
        matrix("M", model["M"], names, names),
        matrix("C", model["C"], names, names),
        matrix(
            "gravity, friction", np.transpose([model["gravity"], model["friction"]]), names, ["gravity", "friction"]
        ),
        matrix("T", model["T"], full, names),
        matrix("A", model["A"], rows, full),
        matrix("E", model["E"], names, motors),
    ]
    return "\n\n".join(block for block in blocks if block)


def matrix(title: str, values: Any, rows: Sequence[str], columns: Sequence[str]) -> str:
    """A matrix with names; empty if it has no rows or no columns."""
    values = np.asarray(values, float)
    if not values.size:
        return ""
    cells = [[f"{value:.5g}" for value in row] for row in values]
    left = max(map(len, [title, *rows]))
    widths = [max(len(name), *(len(row[j]) for row in cells)) for j, name in enumerate(columns)]
    head = "  ".join(name.rjust(width) for name, width in zip(columns, widths, strict=True))
    lines = [f"{title.ljust(left)}  {head}"]
    for name, row in zip(rows, cells, strict=True):
        lines.append(f"{name.ljust(left)}  " + "  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)))
    return "\n".join(lines)
