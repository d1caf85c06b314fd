"""Compilers and emulators for exported controllers, and what a test needs to say where one is missing."""

from __future__ import annotations

import shutil
import subprocess

import pytest

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off"]
GROUPED = ["-ffunction-sections", "-fdata-sections", "-Wl,--gc-sections"]
NEWLIB = ["--specs=rdimon.specs", "-nostartfiles", "-T", "qemu_mps2/mps2.ld", "-I.", "qemu_mps2/startup.c"]
SEMIHOSTING = ["-semihosting-config", "enable=on,target=native"]
BARE = ["-nographic", "-monitor", "none", "-serial", "none", "-icount", "shift=0", *SEMIHOSTING]
ARM = "apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"
# Name: packages, compiler with its flags, what runs the program.
TARGETS = {
    "gcc": ("apt-get install gcc", ["gcc", "-O2"], []),
    "clang": ("apt-get install clang", ["clang", "-O2"], []),
    "cortex-m7": (
        ARM,
        ["arm-none-eabi-gcc", "-O2", *["-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"], *NEWLIB],
        ["qemu-system-arm", "-M", "mps2-an500", *BARE, "-kernel"],
    ),
    "cortex-m4f": (
        ARM,
        ["arm-none-eabi-gcc", "-O2", *["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"], *NEWLIB],
        ["qemu-system-arm", "-M", "mps2-an386", *BARE, "-kernel"],
    ),
    "aarch64": (
        "apt-get install gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user",
        ["aarch64-linux-gnu-gcc", "-O2", "-static"],
        ["qemu-aarch64"],
    ),
}


def require(target):
    """Skip where a target's compiler or emulator is missing, and say what to install."""
    packages, compiler, runner = TARGETS[target]
    missing = [tool for tool in (compiler[0], *runner[:1]) if shutil.which(tool) is None]
    if missing:
        pytest.skip(f"no {' and no '.join(missing)}: {packages}")


def on_target(folder, target, *flags):
    """Exit status and output of an export's self-test on a target."""
    _, compiler, runner = TARGETS[target]
    program = folder / f"selftest-{target}"
    grouped = GROUPED if "none" in compiler[0] else []
    sources = sorted(str(file) for file in folder.glob("*.c"))
    command = [*compiler, *STRICT, *grouped, *flags, *sources, "-o", str(program)]
    subprocess.run(command, cwd=folder, check=True)
    done = subprocess.run([*runner, str(program)], capture_output=True, text=True, timeout=600)
    return done.returncode, done.stdout + done.stderr
