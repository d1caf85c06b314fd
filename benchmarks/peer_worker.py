"""A worker for one peer: `peer_worker.py WORK.npz`."""

from __future__ import annotations

import sys

import numpy as np
from peers import Timed, prepared
from worker import Prepare, serve

with np.load(sys.argv[1]) as file:
    WORK = dict(file)


def route(name: str) -> Prepare:
    """A peer's run; it says the version."""
    prepare, version = prepared(name, WORK)

    def with_version() -> Timed:
        run = prepare()
        return lambda: run() | {"version": version}

    return with_version


if __name__ == "__main__":
    serve(route)
