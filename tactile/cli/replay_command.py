"""The command ``tactile replay``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tactile.cli.options import AsJson, emit

if TYPE_CHECKING:
    from tactile.playback.replaying import Replay


def run(
    file: Annotated[Path, typer.Argument(help="Recording (.h5, .hdf5 or .npz) of tactile play.")],
    as_json: AsJson = False,
) -> None:
    """Render a recording again and compare it bit for bit.

    The drive is computed from what the recording holds; no other file is read, and no device is
    opened. The exit code is 0 if it is identical to the recorded drive, 1 if it differs, and 2 if
    the recording cannot be replayed.

    Example: tactile replay oak.h5
    """
    from tactile.playback.replaying import replay

    result = replay(file)
    emit(result.as_dict(), as_json, lambda _: print(_compared(result)))
    if not result.is_identical:
        print(f"tactile: {file}: {_difference(result)}", file=sys.stderr)
        raise typer.Exit(1)


def _compared(r: "Replay") -> str:
    """Return how much of the recording was compared."""
    verdict = "identical" if r.is_identical else "not identical"
    text = f"{r.compared_samples} samples of {r.contactors} contactors are {verdict}"
    if r.compared_samples < r.planned_samples:
        text += f"; the recording ends before sample {r.planned_samples} of the stroke"
    return f"{text}; the stroke was incomplete: {r.incomplete}" if r.incomplete else text


def _difference(r: "Replay") -> str:
    """Return where the drives differ, by how much, and what else has changed."""
    text = (
        f"the drive differs from sample {r.first_sample}, contactor {r.first_contactor} on, by at "
        f"most {r.largest_difference_v:.3g} V"
    )
    versions = [f"{name} {one} is {other} here" for name, (one, other) in r.other_versions.items()]
    return "; ".join([text, *versions])
