"""Numbers and names out of XML, as strictly as the audit wants them; what is bad reads as nan, which judges nothing."""

from __future__ import annotations

import math
import re
from functools import lru_cache

import numpy as np
from lxml import etree

from mmnn_pin.model.audit.schema import KNOWN
from mmnn_pin.signals import Array

Own = dict[str, list[etree._Element]]  # elements by tag
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@lru_cache(maxsize=8192)
def read_numbers(text: str) -> tuple[float, ...]:
    """Decimal numbers; nan for each word of another kind or beyond what a double holds."""
    values = (float(word) if NUMBER.fullmatch(word) else math.nan for word in text.split())
    return tuple(math.nan if math.isinf(value) else value for value in values)


def number(element: etree._Element | None, key: str, default: float) -> float:
    """A number of an attribute, the default where it is not stated, nan where it is bad."""
    return numbers(element, key, (default,))[0]


def numbers(
    element: etree._Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> tuple[float, ...]:
    """Numbers of an attribute, the default where they are not stated, nan where they are bad or not as many."""
    text = None if element is None else element.get(key)
    values = default if text is None else read_numbers(text)
    return values if len(values) == len(default) else (math.nan,) * len(default)


def vector(element: etree._Element | None, key: str, default: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Array:
    """The same as an array."""
    return np.array(numbers(element, key, default))


def own_elements(root: etree._Element) -> Own:
    """Elements of links, joints and materials that URDF defines, by tag; not what extensions hold."""
    own: Own = {tag: [] for tag in KNOWN}
    pending = list(root.iterchildren("link", "joint", "material"))
    for element in pending:
        tag = element.tag
        own[tag].append(element)
        children = KNOWN[tag][0]
        pending += [child for child in element if child.tag in children and child.tag in KNOWN]
    return own


def label(element: etree._Element) -> str:
    """The link, joint or other child of the root that an element belongs to, in words."""
    parent = element.getparent()
    while parent is not None and parent.getparent() is not None:
        element, parent = parent, parent.getparent()
    name = element.get("name")
    return f"<{element.tag}>" if name is None else f"{element.tag} '{name}'"
