"""What `mmnn report`, `plot` and objects show with this package installed; importing it registers all."""

from __future__ import annotations

from .proof import figures, text

MODULES = (figures, text)  # that register themselves
