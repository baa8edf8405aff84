"""The command ``tactile replay``."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tactile.cli.options import AsJson, emit
from tactile.cli.printing import progress_bar

if TYPE_CHECKING:
    from tactile.playback.replaying import Replay
    from tactile.playback.session_replay import SessionReplay


def run(
    file: Annotated[
        Path,
        typer.Argument(
            help="Recording (.h5, .hdf5 or .npz) of tactile play, or folder of a session that "
            "tactile serve recorded."
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Render a recording again and compare it bit for bit.

    The drive is computed from what the recording holds; no other file is read, and no device is
    opened. The exit code is 0 if it is identical to the recorded drive, 1 if it differs, and 2 if
    the recording cannot be replayed. A session holds a digest of the drive, so that only the first
    block that differs is known; an interrupted one is compared as far as it goes.

    Example: tactile replay oak.h5
    """
    if file.is_dir():
        _replay_session(file, as_json)
        return
    from tactile.playback.replaying import replay

    result = replay(file)
    emit(result.as_dict(), as_json, lambda _: print(_compared(result)))
    if not result.is_identical:
        print(f"tactile: {file}: {_difference(result)}", file=sys.stderr)
        raise typer.Exit(1)


def _replay_session(folder: Path, as_json: bool) -> None:
    """Replay a session, and exit with 1 if it differs."""
    from tactile.playback.session_replay import replay_session

    with progress_bar(visible=not as_json) as bar:
        task = bar.add_task("minutes", total=None)
        result = replay_session(
            folder, lambda done, total: bar.update(task, completed=done, total=total)
        )
    text = f"{result.compared_blocks} blocks in {result.duration_s:.1f} s are identical"
    emit(result.as_dict(), as_json, lambda _: print(text))
    if not result.is_identical:
        print(f"tactile: {folder}: {_session_difference(result)}", file=sys.stderr)
        raise typer.Exit(1)


def _session_difference(r: "SessionReplay") -> str:
    """Return where a session differs, and what else has changed, or what it lacks."""
    if r.missing:
        return (
            f"{r.missing} missing after {r.compared_blocks} blocks; what follows was not compared"
        )
    text = f"the drive differs from block {r.first_block} on, at {r.first_time_s:.3f} s"
    return "; ".join([text, *_versions(r)])


def _versions(r: "Replay | SessionReplay") -> list[str]:
    """Return which versions have changed, a phrase for each."""
    return [f"{name} {one} is {other} here" for name, (one, other) in r.other_versions.items()]


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
    return "; ".join([text, *_versions(r)])
