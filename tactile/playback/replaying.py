"""Replay of a recording: its drive is rendered again from the recording alone and compared."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tactile.arrays import Floats
from tactile.display.display import Display, display_of
from tactile.errors import InputError
from tactile.playback.origin import Sources, other_versions
from tactile.playback.recording_reader import PATH, Recording, load_recording
from tactile.playback.trajectory_playback import rendered
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.strength.strength import amplified
from tactile.texture.surface import texture_of


@dataclass
class Replay:
    """Comparison of a recorded drive with the same drive rendered again.

    Attributes
    ----------
    recording : str
        File of the recording.
    planned_samples : int
        Length of the stroke [samples].
    compared_samples : int
        Number of samples that were recorded, all of which were compared.
    contactors : int
        Number of contactors.
    incomplete : str
        Why the stroke was not put out completely; empty if it was.
    differing_values : int
        Number of drive values of which at least one bit differs.
    first_sample, first_contactor : int or None
        Sample and contactor of the first value that differs; None if none does.
    largest_difference_v : float
        Largest difference of the two drives.
    other_versions : dict of str to (str, str)
        Versions at the time of the recording and now, where they differ.
    """

    recording: str
    planned_samples: int
    compared_samples: int = 0
    contactors: int = 0
    incomplete: str = ""
    differing_values: int = 0
    first_sample: int | None = None
    first_contactor: int | None = None
    largest_difference_v: float = 0.0
    other_versions: dict[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def is_identical(self) -> bool:
        """Whether all bits of the drive are the same."""
        return not self.differing_values

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data.

        Returns
        -------
        dict of str to object
            Fields by name, and ``is_identical``.
        """
        return asdict(self) | {"is_identical": self.is_identical}

    def compare(self, recorded: Floats, again: Floats) -> None:
        """Compare the next samples.

        Parameters
        ----------
        recorded, again : (S, N) array of float
            Drive as it was recorded and as it was rendered again [V].
        """
        differs = recorded.view(np.uint64) != again.view(np.uint64)
        if differs.any():
            if self.first_sample is None:
                sample, contactor = np.argwhere(differs)[0]
                self.first_sample = self.compared_samples + int(sample)
                self.first_contactor = int(contactor)
            self.differing_values += int(differs.sum())
            largest = np.abs(recorded - again)[differs].max()
            self.largest_difference_v = max(self.largest_difference_v, float(largest))
        self.compared_samples += len(recorded)


def replay(path: str | Path) -> Replay:
    """Render the drive of a recording again, from the recording alone, and compare all bits.

    Parameters
    ----------
    path : str or Path
        Recording to replay.

    Returns
    -------
    Replay
        Result of the comparison. On the machine of the recording, with the same versions, the
        drives are identical.

    Raises
    ------
    NotFoundError, InputError
        If the recording cannot be read, or holds something that this version cannot render.
    """
    recording = load_recording(path)
    sources, rate = recording.provenance.sources, recording.provenance.sample_rate_hz
    if sources is None:
        raise InputError(
            f"{path}: cannot be replayed: its display or texture was not loaded from a file"
        )
    if not recording.samples:
        raise InputError(f"{path}: cannot be replayed: it holds no samples")
    try:
        trajectory = Trajectory(*(recording[name] for name in PATH))
        with threadpool_limits(1):  # as when it was played
            display, renderer = _renderer(recording, sources)
            waveform = _waveform(recording) if sources.texture is None else None
            planned = round(trajectory.duration * rate)
            result = Replay(str(path), planned, incomplete=recording.incomplete)
            _compare(result, recording, display, renderer, trajectory, waveform)
    except InputError as error:
        if str(error).startswith(str(path)):
            raise
        raise InputError(f"{path}: cannot be replayed: {error}") from error
    result.other_versions = other_versions(recording.provenance.versions)
    return result


def _renderer(recording: Recording, sources: Sources) -> tuple[Display, Renderer]:
    """Return the display of a recording, and a renderer as it was when the stroke began."""
    provenance = recording.provenance
    display = display_of(sources.display, recording.path)
    texture = None
    if sources.texture is not None:
        texture = texture_of(sources.texture, recording.path)
    if texture is not None:
        texture = amplified(texture, provenance.gain)
    rate = provenance.sample_rate_hz
    return display, Renderer(display, texture, sample_rate=rate, seed=provenance.seed)


def _waveform(recording: Recording) -> Floats:
    """Return the shear (S,) of the effect of a recording [m]."""
    if "waveform_m" not in recording:
        raise InputError("it holds neither a texture nor the array waveform_m")
    waveform = recording["waveform_m"]
    if waveform.ndim != 1 or not np.isfinite(waveform).all():
        raise InputError("waveform_m is no list of finite numbers")
    return waveform


def _compare(
    result: Replay,
    recording: Recording,
    display: Display,
    renderer: Renderer,
    trajectory: Trajectory,
    waveform: Floats | None,
) -> None:
    """Render as many samples as were recorded, and compare them."""
    result.contactors = len(display.contactors)
    shape = (recording.samples, result.contactors)
    if recording.shape("drive_v") != shape or recording.samples > result.planned_samples:
        raise InputError(
            f"drive_v has the shape {recording.shape('drive_v')}; the stroke has "
            f"{result.planned_samples} samples of {result.contactors} contactors"
        )
    rate = recording.provenance.sample_rate_hz
    drives = _drives(display, renderer, trajectory, rate, waveform)
    waiting = np.zeros((0, result.contactors))
    for recorded in recording.blocks("drive_v"):
        if not np.isfinite(recorded).all():
            raise InputError("drive_v holds values that are not finite")
        while len(waiting) < len(recorded):
            waiting = np.concatenate([waiting, next(drives)])
        result.compare(recorded, np.ascontiguousarray(waiting[: len(recorded)]))
        waiting = waiting[len(recorded) :]


def _drives(
    display: Display,
    renderer: Renderer,
    trajectory: Trajectory,
    rate: float,
    waveform: Floats | None,
) -> Iterator[Floats]:
    """Yield the drive of a stroke, without the delay of the renderer."""
    for _, played in rendered(display, renderer, trajectory, sample_rate=rate, waveform=waveform):
        if played is not None:
            yield played.drive
