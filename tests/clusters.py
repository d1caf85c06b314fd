"""A Dask cluster of this machine for tests and campaigns: a scheduler in a network of its own, workers, their logs."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from ipaddress import IPv4Address
from pathlib import Path

from places import ROOT

from mmnn_pin.compiled.folders import cache_root

NETWORK = f"mmnn{os.getpid()}"
# Four addresses of its own for every process, so that runs at the same time do not take each other's way.
OUTSIDE, INSIDE = (str(IPv4Address("10.213.0.0") + 4 * (os.getpid() % 2**14) + i) for i in (1, 2))
QUIET = {"DASK_DISTRIBUTED__ADMIN__TICK__LIMIT": "60s", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def started(folder: Path, *command: str, within: str | None) -> subprocess.Popen[str]:
    """A process of the cluster, in a network and a folder of its own; it shares compiled code and nothing else."""
    folder.mkdir()
    inside = ["ip", "netns", "exec", within] if within else []
    program = [sys.executable, "-m", *command]
    paths = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | QUIET | {"PYTHONPATH": paths, "HOME": str(folder), "TMPDIR": str(folder)}
    environment["NUMBA_CACHE_DIR"] = str(cache_root())
    log = (folder / "log").open("w")
    return subprocess.Popen([*inside, *program], cwd=folder, env=environment, stdout=log, stderr=log, text=True)


def left_behind() -> list[str]:
    """Networks whose process was killed before it could take them down."""
    if not shutil.which("ip"):
        return []
    listed = subprocess.run(["ip", "netns"], capture_output=True, text=True).stdout
    return [name for name, pid in re.findall(r"^(mmnn(\d+))\b", listed, re.M) if not Path(f"/proc/{pid}").exists()]


@contextlib.contextmanager
def network() -> Iterator[str | None]:
    """A network namespace joined to this one by a pair of virtual cables; None where the machine allows none."""
    for left in left_behind():
        subprocess.run(["ip", "netns", "del", left], capture_output=True)
    steps = (
        f"ip netns add {NETWORK}",
        f"ip link add {NETWORK}a type veth peer name {NETWORK}b",
        f"ip link set {NETWORK}b netns {NETWORK}",
        f"ip addr add {OUTSIDE}/30 dev {NETWORK}a",
        f"ip link set {NETWORK}a up",
        f"ip netns exec {NETWORK} ip addr add {INSIDE}/30 dev {NETWORK}b",
        f"ip netns exec {NETWORK} ip link set {NETWORK}b up",
        f"ip netns exec {NETWORK} ip link set lo up",
    )
    try:
        made = all(shutil.which("ip") and subprocess.run(s.split(), capture_output=True).returncode == 0 for s in steps)
        yield NETWORK if made else None
    finally:
        for step in (f"ip link del {NETWORK}a", f"ip netns del {NETWORK}") if shutil.which("ip") else ():
            subprocess.run(step.split(), capture_output=True)


class Cluster:
    """A scheduler and workers as processes of their own."""

    def __init__(self, folder: Path, within: str | None, more: tuple[str, ...] = ()) -> None:
        self.folder, self.within, self.more = folder, within, more
        self.processes: list[subprocess.Popen[str]] = []
        host = INSIDE if within else "127.0.0.1"
        command = ("distributed.cli.dask_scheduler", "--host", host, "--port", "0", "--no-dashboard", *more)
        self.processes.append(started(folder / "scheduler", *command, within=within))
        self.address = self.told(folder / "scheduler" / "log", r"Scheduler at: +(\w+://[\d.:]+)")

    def worker(self, inside: bool = False) -> subprocess.Popen[str]:
        """Start a worker, in the scheduler's network or outside of it."""
        folder = self.folder / f"worker{len(self.processes)}"
        own = tuple(word for word in self.more if word not in ("--protocol", "tls"))
        options = ("--nworkers", "1", "--nthreads", "1", "--no-nanny", "--no-dashboard", *own)
        command = ("distributed.cli.dask_worker", self.address, *options, "--local-directory", str(folder / "scratch"))
        process = started(folder, *command, within=self.within if inside else None)
        self.processes.append(process)
        return process

    def told(self, log: Path, pattern: str) -> str:
        """What a process has told in its log."""
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            if found := re.search(pattern, log.read_text()):
                return found[1]
            time.sleep(0.05)
        raise AssertionError(log.read_text())

    def stop(self) -> None:
        """End all processes."""
        for process in reversed(self.processes):
            process.kill()
            process.wait()
