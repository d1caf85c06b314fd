"""What a controller with fixed weights says of rows; the weights are those of a memory."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from ...loop.loop import Loop
from ...signals import Array, Layout
from ...torque.controller import CompiledController
from ..proof.learner import Learner, Stepper


def frozen(controller: Any) -> Any:
    """The controller with its weights held fixed; itself where it has none, None where they cannot be held fixed."""
    if is_dataclass(controller) and any(field.name == "learning" for field in fields(controller)):
        return replace(controller, learning=False)  # type: ignore[type-var]
    return controller if isinstance(controller, CompiledController) else None


def said(loop: Loop, layout: Layout, state: Any, rows: Array) -> Array:
    """Psi_hat of the controller of a loop, step by step along rows (N, width); (N, p) [N, N m].

    It is what the weights say, before the motors' limits take of it.

    Args:
        loop: Of the controller, which learns from the rows unless it is frozen.
        layout: Of the rows; they may lack what the loop's hardware model adds.
        state: What it remembers, changed in place.
        rows: The rows; they are not changed.
    """
    context = replace(loop.context(), layout=layout)
    stepper = Stepper(Learner(loop.controller, context, state, state, 0.0, loop.believed), state)
    found = np.zeros((len(rows), layout.dof))
    for n, row in enumerate(rows):
        stepper.step(row)
        found[n] = stepper.known
    return found
