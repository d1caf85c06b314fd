"""Instructions of an exported controller on an emulated Cortex-M7, against the period on a named processor."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import NamedTuple

from ...errors import ConfigError, MmnnError, UnknownName
from .in_the_loop import BOARD, M7, QEMU, require_tools

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-ffunction-sections", "-fdata-sections", "-DMMNN_COUNT")
PROCESSORS = {"stm32f767": 216e6, "stm32h743": 480e6, "imxrt1062": 600e6}  # Cortex-M7 and their clocks [Hz]
CYCLES = 2.0  # per instruction: a Cortex-M7 takes one to two for most


class Count(NamedTuple):
    """Instructions of the samples of a self-test, mean and worst; bytes of stack and of the controller."""

    mean: int
    worst: int
    stack: int
    ram: int


def counted(folder: Path) -> Count:
    """Run the self-test of a folder on the emulated board, which counts 40 instructions at a time.

    Raises:
        ConfigError: A tool is missing.
        MmnnError: It does not compile, or does not count.
    """
    require_tools(QEMU)
    start = ["-Wl,--gc-sections", "-T", "qemu_mps2/mps2.ld", "-I.", "qemu_mps2/startup.c"]
    sources = sorted(file.name for file in folder.glob("*.c"))
    command = ["arm-none-eabi-gcc", *M7.split(), *FLAGS, *start, *sources, "-o", "count.elf"]
    try:
        made = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        board = [*BOARD.split(), "-icount", "shift=0", "-kernel", "count.elf"]
        said = (
            made.stderr if made.returncode else subprocess.run(board, cwd=folder, capture_output=True, text=True).stdout
        )
    finally:
        (folder / "count.elf").unlink(missing_ok=True)
    found = re.search(r": (\d+) mean, (\d+) worst; stack: (\d+) .*: (\d+) bytes", said)
    if found is None:
        raise MmnnError(f"the instructions are not counted: {' '.join(said.splitlines()[:2])}")
    return Count(*map(int, found.groups()))


def clock_of(processor: str) -> float:
    """The clock of a named processor [Hz].

    Raises:
        UnknownName: It is none of `PROCESSORS`.
    """
    if processor not in PROCESSORS:
        raise UnknownName("processor", processor, tuple(PROCESSORS), key="processor")
    return PROCESSORS[processor]


def require_time(count: Count, period: float, processor: str) -> float:
    """The share of the control period [s] that the worst sample takes on a processor.

    Raises:
        ConfigError: More than all of it.
    """
    needed = CYCLES * count.worst / clock_of(processor)
    if needed > period:
        what = f"a sample of {1e3 * needed:.3g} ms on {processor}, the period is {1e3 * period:.3g} ms"
        why = f"its worst one has {count.worst:,} instructions of {CYCLES:g} cycles each"
        fix = (
            f"use a Cortex-M7 of {CYCLES * count.worst / period / 1e6:.0f} MHz, a longer period, or another controller"
        )
        raise ConfigError(what, why=why, fix=fix, key="processor")
    return needed / period
