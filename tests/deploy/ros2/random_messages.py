"""Random messages of our types."""

from __future__ import annotations

from typing import Any, get_type_hints

import numpy as np
from cyclonedds.idl import IdlStruct

from mmnn_pin.deploy.ros2 import messages as msg


def made(kind: type[Any], rng: np.random.Generator) -> Any:
    """A random message of ours."""
    return kind(*(filled(given, rng) for given in get_type_hints(kind, include_extras=True).values()))


def filled(given: Any, rng: np.random.Generator) -> Any:
    element, shift, length = msg.taken_apart(given)
    if shift:
        return [filled(element, rng) for _ in range(length or int(rng.integers(0, 4)))]
    if isinstance(element, type) and issubclass(element, IdlStruct):
        return made(element, rng)
    word = getattr(element, "__metadata__", (getattr(element, "__name__", ""),))[0]
    if word == "str":
        return "".join(rng.choice(list("ab_/é9"), int(rng.integers(0, 9))))
    if word == "float64":
        return float(rng.choice([rng.normal(), 0.0, -0.0, np.inf, 1e300]))
    if word == "byte":
        return int(rng.integers(0, 128))  # the other encoder has no more
    if word == "bool":
        return bool(rng.integers(2))
    low, high = (0, 255) if word in ("byte", "uint8") else (np.iinfo(word).min, np.iinfo(word).max)
    return int(rng.integers(low, high, endpoint=True))
