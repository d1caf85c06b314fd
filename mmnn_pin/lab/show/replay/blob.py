"""Numbers for the page: arrays one after the other in one block of bytes, found again by references in JSON."""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

TYPES = {"f4": np.float32, "u2": np.uint16, "u4": np.uint32}  # what the page can read
ALIGNMENT = 4


class Blob:
    """Arrays for the page, little endian."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, array: NDArray[Any], kind: str) -> dict[str, Any]:
        """Store an array, flattened.

        Args:
            array: The numbers.
            kind: Their type in the page, one of `TYPES`.

        Returns:
            Where it is: what the JSON holds in its place.
        """
        data = np.ascontiguousarray(array, dtype=np.dtype(TYPES[kind]).newbyteorder("<")).tobytes()
        reference = {"type": kind, "at": self._size, "size": int(array.size)}
        padded = data + bytes(-len(data) % ALIGNMENT)
        self._parts.append(padded)
        self._size += len(padded)
        return reference

    def pack(self, header: dict[str, Any]) -> str:
        """Header and arrays as text: the header's length (4 bytes), the header as JSON, the arrays; compressed."""
        text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
        text += b" " * (-len(text) % ALIGNMENT)
        return compressed(len(text).to_bytes(4, "little") + text + b"".join(self._parts))


def compressed(data: bytes) -> str:
    """Bytes as text that the page can unpack: gzip, then base64."""
    return base64.b64encode(gzip.compress(data, 9, mtime=0)).decode()
