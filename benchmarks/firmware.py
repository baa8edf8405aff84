"""Instructions and bytes of the C core on emulated microcontrollers, with 24 channels at 8 kHz.

They are counted by ``make qemu`` in ``firmware_protocol/c``, exactly and alike in every run; its
budgets are the goals.
"""

import os
import re
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import firmware_protocol
from tactile.bench.figures import Figure, at_most, not_measured

C = Path(firmware_protocol.__file__).parent / "c"
"""Folder of the C sources."""
BYTES = ("stack", "ta_amplifier", "ta_serial", "flash", "flash_all_links", "ram")
"""Names of figures that are counted in bytes; the others are counted in instructions."""


def counted(text: str) -> Iterator[Figure]:
    """Read what `make qemu` printed.

    Parameters
    ----------
    text : str
        Lines with the name of a part, and after them lines with name, count and budget.

    Yields
    ------
    Figure
        Each count, with its budget as the goal.
    """
    part = ""
    for line in text.splitlines():
        if re.fullmatch(r"cortex-\w+", line):
            part = line
        elif row := re.match(r"(\w+) (\d+) (\d+)", line):
            unit = "B" if row[1] in BYTES else "instructions"
            yield at_most(f"firmware.{part}.{row[1]}", int(row[2]), unit, int(row[3]))


def measure_firmware() -> Iterator[Figure]:
    """Count the instructions of instants and packets, and the bytes, of each part.

    Yields
    ------
    Figure
        Counts, with their budgets as goals.
    """
    with tempfile.TemporaryDirectory() as build:
        command = ["make", "--silent", "--keep-going", "-C", str(C), f"BUILD={build}", "qemu"]
        environment = {k: v for k, v in os.environ.items() if k != "CI"}
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if skipped := re.search(r"^skipped: (.*)$", done.stdout, re.MULTILINE):
        yield not_measured("firmware", skipped[1])
        return
    yield from counted(done.stdout)
