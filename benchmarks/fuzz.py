"""Fuzzing of the protocol: the decoders and the amplifier in Python and in C, ten minutes each.

Python is fuzzed by atheris and C by libFuzzer, as many at once as there are cores. The benchmark
only runs in a checkout, with the tools that are installed; what is left out is reported in a line.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import firmware_protocol
from tactile.bench.figures import Figure, at_most

SECONDS = 600
"""Duration of each fuzzer [s]."""
C = Path(firmware_protocol.__file__).parent / "c"
"""Folder of the C sources."""
SCRIPT = C.parents[1] / "tests" / "fuzz" / "fuzz_python.py"
PYTHON_TARGETS = ("packets", "serial", "can", "i2c", "formats", "windows", "amplifier")


@dataclass(frozen=True)
class Run:
    """Result of a fuzzer.

    Attributes
    ----------
    name : str
        Name of the fuzzer.
    executions : int
        Number of inputs.
    coverage : int
        Number of edges that the inputs reached.
    failed : bool
        Whether the fuzzer found anything.
    """

    name: str
    executions: int
    coverage: int
    failed: bool


def _python_fuzzers() -> dict[str, list[str]]:
    """Return the commands of the fuzzers in Python, none without atheris or a checkout."""
    has_atheris = subprocess.run([sys.executable, "-c", "import atheris"], capture_output=True)
    if has_atheris.returncode or not SCRIPT.exists():
        print("fuzz: no atheris, or no checkout: Python is left out", file=sys.stderr)
        return {}
    return {f"python.{t}": [sys.executable, str(SCRIPT), t] for t in PYTHON_TARGETS}


def _c_fuzzers(build: Path) -> dict[str, list[str]]:
    """Build the fuzzers in C and return their commands, none without the tools or a checkout."""
    if not shutil.which("clang") or not shutil.which("make") or not (C / "fuzz").exists():
        print("fuzz: no clang or make, or no checkout: C is left out", file=sys.stderr)
        return {}
    command = ["make", "-C", str(C), f"BUILD={build}", "fuzz"]
    built = subprocess.run(command, capture_output=True, text=True)
    if built.returncode:
        print(f"fuzz: C is left out:\n{built.stderr}", file=sys.stderr)
        return {}
    programs = sorted(p for p in (build / "fuzz").iterdir() if os.access(p, os.X_OK))
    return {f"c.{p.stem.removeprefix('fuzz_')}": [str(p)] for p in programs}


def run_fuzzer(name: str, command: list[str], seconds: int, folder: Path) -> Run:
    """Run a fuzzer from an empty corpus; failing inputs are left in the working directory."""
    corpus = folder / name
    corpus.mkdir()
    options = [f"-max_total_time={seconds}", "-max_len=2000", "-print_final_stats=1"]
    options.append(f"-artifact_prefix=fuzz-{name}-")
    result = subprocess.run(
        ["nice", *command, *options, str(corpus)], capture_output=True, text=True, errors="replace"
    )
    runs = re.search(r"number_of_executed_units: (\d+)", result.stderr)
    edges = re.findall(r"cov: (\d+)", result.stderr)
    if result.returncode:
        print(f"fuzz: {name}:\n{result.stderr[-3000:]}", file=sys.stderr)
    return Run(name, int(runs[1]) if runs else 0, int(edges[-1]) if edges else 0,
               result.returncode != 0)  # fmt: skip


def measure_fuzz(seconds: int = SECONDS) -> Iterator[Figure]:
    """Count what the fuzzers find, and how much they tried."""
    with tempfile.TemporaryDirectory() as place, ThreadPoolExecutor(os.cpu_count()) as pool:
        folder = Path(place)
        commands = _python_fuzzers() | _c_fuzzers(folder)
        runs = list(pool.map(lambda c: run_fuzzer(c[0], c[1], seconds, folder), commands.items()))
    for run in runs:
        yield at_most(f"fuzz.{run.name}.findings", run.failed, "", 0)
        yield Figure(f"fuzz.{run.name}.executions", run.executions, "inputs")
        yield Figure(f"fuzz.{run.name}.coverage", run.coverage, "edges")
