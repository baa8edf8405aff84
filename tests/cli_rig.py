"""The command ``tactile`` to test: called in this process, which is quicker, or started."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import pytest

from tactile import cli
from tactile.arrays import Floats

KEYS = {
    "drive_v", "shear_target_m", "shear_played_m", "time_s", "position_mm", "sample_rate_hz",
    "contactors_mm", "path_time_s", "path_position_m", "path_normal_force_n",
}  # fmt: skip
SHORT = ["--seconds", "0.1"]


class Result(NamedTuple):
    """Outcome of a command."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Read all of what was printed as strict JSON, without NaN and infinity."""

        def refuse(name: str) -> float:
            raise AssertionError(f"{name} is no JSON")

        return json.loads(self.out, parse_constant=refuse)


Command = Callable[..., Result]


def runner(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    """Return what runs the command in this process, in a folder."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "100")

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["tactile", *map(str, arguments)])
        monkeypatch.setattr(sys.modules["__main__"], "__package__", None)  # a script's
        capsys.readouterr()
        with pytest.raises(SystemExit) as left:
            cli.main()
        out, err = capsys.readouterr()
        assert isinstance(left.value.code, int)
        return Result(left.value.code, out, err)

    return run


def started(*arguments: object, cwd: Path) -> Result:
    """Run the command as a process of its own, warnings being errors."""
    line = [sys.executable, "-W", "error", "-m", "tactile", *map(str, arguments)]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"}
    p = subprocess.run(
        line, cwd=cwd, env=environment, capture_output=True, encoding="utf-8", check=False
    )
    return Result(p.returncode, p.stdout, p.stderr)


def recorded(path: Path) -> dict[str, Floats]:
    """Read the arrays of a recording, without its provenance and without our own reader."""
    if path.suffix != ".npz":
        with h5py.File(path) as file:
            return {name: np.asarray(file[name]) for name in file if name != "provenance"}
    with np.load(path, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files if name != "provenance"}


def provenance_of(path: Path) -> Any:
    """Read the provenance of a recording, without our own reader."""
    if path.suffix != ".npz":
        with h5py.File(path) as file:
            return json.loads(file["provenance"][()])
    with np.load(path, allow_pickle=False) as archive:
        return json.loads(archive["provenance"].item())


def assert_mistake(result: Result, *said: str) -> None:
    """See that it is one line on standard error, and exit code 2."""
    assert result.code == 2, result
    assert result.out == ""
    assert result.err.endswith("\n")
    assert len(result.err.splitlines()) == 1, result.err
    assert result.err.startswith(("tactile", "python -m tactile"))
    assert "Traceback" not in result.err
    for part in said:
        assert part in result.err
