"""Numbers and names out of XML, as strictly as the audit wants them; what is bad reads as nan, which judges nothing."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from lxml import etree

from mmnn_pin.signals import Array

from .schema import KNOWN, ONCE

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@lru_cache(maxsize=8192)
def read_numbers(text: str) -> tuple[float, ...]:
    """Decimal numbers; nan for each word of another kind or beyond what a double holds."""
    values = (float(word) if NUMBER.fullmatch(word) else math.nan for word in text.split())
    return tuple(math.nan if math.isinf(value) else value for value in values)


@lru_cache(maxsize=8192)
def largest(text: str | None) -> float:
    """Largest magnitude of some numbers, 0 where there are none or a bad one."""
    values = () if text is None else read_numbers(text)
    return 0.0 if any(math.isnan(value) for value in values) else max(map(abs, values), default=0.0)


def number(element: etree._Element | None, key: str, default: float) -> float:
    """A number of an attribute, the default where it is not stated, nan where it is bad."""
    text = None if element is None else element.get(key)
    if text is None:
        return default
    values = read_numbers(text)
    return values[0] if len(values) == 1 else math.nan


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


@dataclass(frozen=True)
class Own:
    """What URDF defines of a file, not what extensions hold; read out once, because lxml takes its time.

    Attributes:
        elements: Elements by tag.
        texts: Element, tag, and key and text of its attributes, of every element that has some.
        strangers: Element, tag and tag of the parent of what URDF does not have in that place.
        again: The same of second copies of what may stand once.
    """

    elements: dict[str, list[etree._Element]]
    texts: list[tuple[etree._Element, str, list[tuple[str, str]]]]
    strangers: list[tuple[etree._Element, str, str]]
    again: list[tuple[etree._Element, str, str]]

    def __getitem__(self, tag: str) -> list[etree._Element]:
        return self.elements[tag]

    @classmethod
    def of(cls, root: etree._Element) -> Own:
        """What a `<robot>` element holds."""
        own = cls({tag: [] for tag in KNOWN}, [], [], [])
        pending = [(root, "robot")]
        for element, tag in pending:
            own.elements[tag].append(element)
            if items := element.items():
                own.texts.append((element, tag, items))
            children, once = KNOWN[tag][0], ONCE.get(tag, ())
            seen = set()
            for child in element if len(element) else ():
                name = child.tag
                if name in children and name in KNOWN:
                    pending.append((child, name))
                else:
                    own.strangers.append((child, name, tag))
                kind = "shape" if tag == "geometry" and name in children else name
                if kind in once:
                    if kind in seen:
                        own.again.append((child, name, tag))
                    seen.add(kind)
        return own


def label(element: etree._Element) -> str:
    """The link, joint or other child of the root that an element belongs to, in words."""
    parent = element.getparent()
    while parent is not None and parent.getparent() is not None:
        element, parent = parent, parent.getparent()
    name = element.get("name")
    return f"<{element.tag}>" if name is None else f"{element.tag} '{name}'"
