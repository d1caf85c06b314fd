"""A worker for one peer: `peer_worker.py WORK.npz`."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from peers import Timed, prepared
from worker import Prepare, serve

with np.load(sys.argv[1]) as file:
    WORK = dict(file)


def route(name: str) -> Prepare:
    """A peer's run; it says the version and how far from our run it ended [m, rad]."""
    prepare, version = prepared(name, WORK)

    def checked() -> Timed:
        run = prepare()

        def run_and_compare() -> dict[str, Any]:
            said = run()
            final = said.pop("final", None)
            away = None if final is None else float(np.abs(final - WORK["end"]).max())
            return said | {"version": version, "ended_away": away}

        return run_and_compare

    return checked


if __name__ == "__main__":
    serve(route)
