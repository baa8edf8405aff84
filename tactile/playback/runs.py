"""Complete run: a texture played along a path on a device, judged and recorded."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from tactile.arrays import Floats
from tactile.bus.base import Bus, BusStatus
from tactile.bus.registry import with_default_option
from tactile.clock import MONOTONIC
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusError, InputError
from tactile.playback.estop_guard import guarded
from tactile.playback.finger_following import (
    WINDOW_MS,
    FingerFollowing,
    FollowingFigures,
)
from tactile.playback.gain_search import largest_gain
from tactile.playback.origin import (
    Provenance,
    Sources,
    counts_of,
    limits_of,
    present_versions,
)
from tactile.playback.outcome import Ending, Outcome, outcome_of, share_put_out
from tactile.playback.recording import Recorder, checked_suffix
from tactile.playback.trajectory_playback import PlayedBlock, frames_of, play, play_frames
from tactile.rendering.contact import Trajectory
from tactile.rendering.equalizer import PASS_BAND
from tactile.rendering.renderer import Renderer
from tactile.rendering.spectrum import SpectrumRenderer
from tactile.sensing.baseline_file import Calibration
from tactile.sim import Fidelity, SimulatedDisplay
from tactile.strength.figures import ONSET, ShearFigures, StrokeMeter
from tactile.strength.strength import amplified
from tactile.texture.formats.effect_shear import NamedEffect
from tactile.texture.surface import Texture


@dataclass
class Summary:
    """Result of a run; the names carry the units.

    Attributes
    ----------
    texture : str
        Name of the texture or effect.
    display : str
        Name of the display.
    device : str
        URL of the bus.
    outcome : Outcome
        What became of the stroke.
    put_out_share : float
        Share of the stroke that was put out, from 0 to 1.
    gain : float
        Gain of the texture.
    gain_limit : str or None
        Limit that forbids a larger gain, if the gain is the largest one.
    sample_rate_hz : float
        Sample rate of the drive.
    seconds : float
        Duration of what was sent to the device.
    samples : int
        Number of samples that were sent to the device.
    frames : int
        Number of frames on a link that takes spectrum frames. What only samples tell is then not
        known, and limited and invalid samples are numbers of frames.
    peak_drive_v : float
        Peak drive.
    voltage_limit_v : float
        Voltage limit of the drive.
    commanded : ShearFigures or None
        Figures of the commanded shear; None on a link that takes spectrum frames, and for a stroke
        without a steady part.
    played : ShearFigures or None
        Figures of the played shear, on a simulated display.
    attainable_um : float
        Peak shear that full drive attains at the worst frequency up to 1000 Hz.
    equalizer_error_db : float
        Largest error of the inverse filter in the band.
    limited_samples : int
        Number of samples that the limiter turned down.
    invalid_samples : int
        Number of samples that were not finite or out of range.
    signal_to_error_db : float or None
        Played against commanded shear in 20–1000 Hz, on a simulated display.
    peak_current_ma : float or None
        Peak current, on a simulated display.
    status : str
        What is wrong with the link; empty if nothing is.
    faults : dict of str to int
        Counts of the link's faults.
    recording : str or None
        File of the recording.
    following : FollowingFigures or None
        Figures of a stroke that followed the finger.
    """

    texture: str
    display: str
    device: str
    outcome: Outcome = field(default_factory=Outcome)
    put_out_share: float = 0.0
    gain: float = 1.0
    gain_limit: str | None = None
    sample_rate_hz: float = 0.0
    seconds: float = 0.0
    samples: int = 0
    frames: int = 0
    peak_drive_v: float = 0.0
    voltage_limit_v: float = 0.0
    commanded: ShearFigures | None = None
    played: ShearFigures | None = None
    attainable_um: float = 0.0
    equalizer_error_db: float = 0.0
    limited_samples: int = 0
    invalid_samples: int = 0
    signal_to_error_db: float | None = None
    peak_current_ma: float | None = None
    status: str = ""
    faults: dict[str, int] = field(default_factory=dict)
    recording: str | None = None
    following: FollowingFigures | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the summary as plain data.

        Returns
        -------
        dict of str to object
            Fields by name.
        """
        return asdict(self)


class _Run:
    """Bookkeeping of the blocks of a run as they are played."""

    def __init__(
        self,
        summary: Summary,
        bus: Bus,
        rate: float,
        delay: int,
        recorder: Recorder | None,
        display: Display,
        trajectory: Trajectory,
        *,
        onset: float,
    ) -> None:
        self.summary, self._bus, self._rate = summary, bus, rate
        self._simulated = bus if isinstance(bus, SimulatedDisplay) else None
        self._recorder = recorder
        self._unbroken = True
        self._fidelity = Fidelity(rate)
        begin, end, fade = trajectory.time[0], trajectory.time[-1], display.limits.fade
        self._meter = StrokeMeter(display, rate, begin + fade, end - fade, onset=onset)
        self._preroll = delay
        self._waiting: list[PlayedBlock] = []
        self._skin_shear = np.zeros((0, 0))

    def account(self, block: PlayedBlock) -> None:
        """Count a block in.

        Parameters
        ----------
        block : PlayedBlock
            Block that was played.
        """
        s = self.summary
        s.samples += len(block.time)
        s.peak_drive_v = max(s.peak_drive_v, float(np.abs(block.drive).max()))

    def paired(self, block: PlayedBlock | None) -> list[tuple[PlayedBlock, Floats | None]]:
        """Return the blocks whose played shear is known by now, each with that shear.

        Parameters
        ----------
        block : PlayedBlock or None
            New block, if there is one.

        Returns
        -------
        list of (PlayedBlock, (S, N) array of float or None)
            Blocks with the shear of the skin [m]; None on a device that is not simulated.
        """
        if self._simulated is None:
            return [] if block is None else [(block, None)]
        if block is not None:
            self._waiting.append(block)
        shear = self._simulated.take_shear()
        skipped = min(self._preroll, len(shear))
        self._preroll -= skipped
        self._skin_shear = np.concatenate(
            [self._skin_shear.reshape(-1, shear.shape[1]), shear[skipped:]]
        )
        pairs: list[tuple[PlayedBlock, Floats | None]] = []
        while self._waiting and len(self._skin_shear) >= len(self._waiting[0].time):
            block_played = self._waiting.pop(0)
            count = len(block_played.time)
            self._fidelity.add(block_played.shear, self._skin_shear[:count])
            pairs.append((block_played, self._skin_shear[:count]))
            self._skin_shear = self._skin_shear[count:]
        return pairs

    def play(
        self,
        display: Display,
        renderer: Renderer,
        trajectory: Trajectory,
        watch: Callable[[PlayedBlock, Renderer], None] | None,
        *,
        realtime: bool,
        waveform: Floats | None = None,
        following: FingerFollowing | None = None,
    ) -> None:
        """Play to the end, and complete the summary.

        Parameters
        ----------
        display : Display
            Display to play.
        renderer : Renderer
            Renderer with the texture.
        trajectory : Trajectory
            Path of the finger.
        watch : callable or None
            Function that is called with each block and the renderer.
        realtime : bool
            Whether to play in step with the clock.
        waveform : (S,) array of float, optional
            Shear that is added on all contactors [m].
        following : FingerFollowing, optional
            What follows the finger.
        """

        def listen(block: PlayedBlock) -> None:
            self.account(block)
            self._write(block)
            if watch is not None:
                finger = None if following is None else following.finger
                watch(replace(block, finger=finger), renderer)

        def follow(position: int, drive: Floats) -> None:
            assert following is not None
            following.wrote(position, drive)
            renderer.limiter.leave_travel(following.watched)

        def stroke() -> BusStatus:
            return play(
                display, renderer, trajectory, self._bus,
                sample_rate=self._rate, listen=listen, clock=MONOTONIC if realtime else None,
                waveform=waveform, written=None if following is None else follow,
            )  # fmt: skip

        planned = round(trajectory.duration * self._rate)
        with self._recorder if self._recorder is not None else nullcontext():
            if self._recorder is not None:
                simulated = self._simulated is not None
                self._recorder.add(**_no_rows(len(display.contactors), simulated=simulated))
            self.summary.outcome, error = _follow(stroke, self._bus, planned, delay=renderer.delay)
            if self._simulated is not None:
                self._simulated.settle()
            self._write(None)
            self._describe()
        self._finish(renderer)
        if following is not None:
            self.summary.following = following.figures
        if error is not None:
            raise error

    def _write(self, block: PlayedBlock | None) -> None:
        """Record the blocks that are complete by now, but none after one that was interrupted."""
        if not self._unbroken:
            return
        self._unbroken = False
        for played, shear in self.paired(block):
            self._meter.add(played.time, played.position, played.shear, shear)
            if self._recorder is not None:
                self._recorder.add(**_rows(played, shear))
        self._unbroken = True

    def _describe(self) -> None:
        """Complete the provenance of the recording."""
        if self._recorder is not None and self._recorder.provenance is not None:
            self._recorder.provenance = msgspec.structs.replace(
                self._recorder.provenance,
                outcome=self.summary.outcome, counters=counts_of(self._bus.counters),
            )  # fmt: skip

    def _finish(self, renderer: Renderer) -> None:
        """Complete the summary."""
        s = self.summary
        s.seconds = s.samples / self._rate
        s.commanded, s.played = self._meter.commanded, self._meter.played
        s.limited_samples = renderer.limiter.limited_samples
        s.invalid_samples = renderer.invalid_samples + renderer.limiter.invalid_samples
        band = renderer.frequency <= PASS_BAND
        s.attainable_um = float(renderer.attainable[..., band].min()) * 1e6
        s.equalizer_error_db = float(20 * np.log10(1 + renderer.filter.error))
        if self._simulated is not None:
            ratio = self._fidelity.signal_to_error_db
            s.signal_to_error_db = ratio if np.isfinite(ratio) else None
            s.peak_current_ma = self._simulated.peak_current * 1e3


def at_rest(display: Display, effect: NamedEffect, *, normal_force: float) -> Trajectory:
    """Return the trajectory of a finger that rests while an effect plays.

    Parameters
    ----------
    display : Display
        Display to play.
    effect : NamedEffect
        Effect to play.
    normal_force : float
        Normal force of the finger [N].

    Returns
    -------
    Trajectory
        Finger at the origin, for the duration of the effect between two fades of the display.
    """
    seconds = effect.seconds + 2 * display.limits.fade
    return Trajectory([0.0, seconds], np.zeros((2, 2)), normal_force)


def run(
    display: Display,
    texture: Texture | NamedEffect,
    trajectory: Trajectory,
    *,
    device: str = "sim:",
    gain: float | Literal["auto"] | None = 1.0,
    sample_rate: float | None = None,
    seed: int = 0,
    record: str | Path | None = None,
    sources: Sources | None = None,
    watch: Callable[[PlayedBlock, Renderer], None] | None = None,
    realtime: bool = False,
    accept_unsafe_hold: bool = False,
    calibration: Calibration | None = None,
) -> Summary:
    """Play a texture along a trajectory on a device, or an effect on a finger at rest.

    Parameters
    ----------
    display : Display
        Display to play.
    texture : Texture or NamedEffect
        Texture to play, or effect, which begins after a fade and plays on all contactors.
    trajectory : Trajectory
        Path of the finger; for an effect, that of `at_rest`.
    device : str
        URL of the bus.
    gain : float, "auto" or None
        Factor on the texture's displacement; "auto" for the largest that the limits allow
        (`largest_gain`) with the finger of the display. None is "auto" where something can be
        amplified, and 1 for an effect, a finger at rest, a texture that leaves nothing to play, and
        with a calibration, because a stiffer finger than that of the display allows less.
    sample_rate : float, optional
        Sample rate of the drive, by default the choice of the device [Hz].
    seed : int
        Seed of the surface's realization.
    record : str or Path, optional
        ``.h5``, ``.hdf5`` or ``.npz`` file to write, with drive_v, shear_target_m, time_s,
        position_mm, sample_rate_hz, contactors_mm, the path of the finger and, from a simulated
        display, shear_played_m; for an effect waveform_m, the shear that was added.
    sources : Sources, optional
        Files that display and texture were loaded from, for the recording.
    watch : callable, optional
        Function that is called with each block and the renderer; not called if the device takes
        spectrum frames.
    realtime : bool
        Whether to play in step with the clock.
    accept_unsafe_hold : bool
        As in `open_bus`.
    calibration : Calibration, optional
        What the display's benders draw in air; with it, the equalizer follows the finger.

    Returns
    -------
    Summary
        Result of the run.

    Raises
    ------
    TactileError
        If the device or a file cannot be used. A failure of the device or Ctrl-C in the middle of
        the stroke ends it: the recording is kept, and the outcome says how much was put out.
    """
    if record is not None:
        checked_suffix(record)  # before the device is opened
    asked = device if calibration is None else _asked_for_currents(device, record)
    summary = Summary(texture.name, display.name, device, voltage_limit_v=display.limits.voltage)
    with open_bus(
        asked, display, sample_rate=sample_rate, accept_unsafe_hold=accept_unsafe_hold
    ) as bus:
        rate = summary.sample_rate_hz = bus.wiring.sample_rate
        following = None if calibration is None else FingerFollowing(display, bus, calibration)
        if gain is None and following is not None:
            gain = 1.0
        _set_gain(summary, gain, display, texture, trajectory, seed)
        surface, waveform = _amplified(display, texture, summary.gain, rate)
        try:
            with guarded(bus, device), threadpool_limits(1):  # whose number changes the last bits
                if bus.frames is not None:
                    _play_frames(summary, display, surface, trajectory, bus, seed, record)
                else:
                    renderer = _renderer(display, surface, rate, seed, following)
                    recorder = _recorder(
                        summary, display, trajectory, seed, record, sources, waveform
                    )
                    account = _Run(
                        summary, bus, rate, renderer.delay, recorder, display, trajectory,
                        onset=ONSET if waveform is None else 0.0,
                    )  # fmt: skip
                    account.play(
                        display, renderer, trajectory, watch,
                        realtime=realtime, waveform=waveform, following=following,
                    )  # fmt: skip
        except BusError as error:  # after `guarded` has latched the e-stop of an amplifier
            if not bus.next_position:
                raise
            summary.outcome = replace(summary.outcome, ending="failed", cause=str(error))
        summary.status = bus.status.detail
        summary.faults = bus.counters.faults()
    outcome = summary.outcome
    summary.put_out_share = share_put_out(outcome.planned_samples, outcome.lost_samples)
    return summary


def _renderer(
    display: Display,
    surface: Texture | None,
    rate: float,
    seed: int,
    following: FingerFollowing | None,
) -> Renderer:
    """Return the renderer of a stroke, whose filters may follow the finger."""
    inverse = None if following is None else following.follower
    return Renderer(display, surface, sample_rate=rate, seed=seed, inverse=inverse)


def _asked_for_currents(url: str, record: str | Path | None) -> str:
    """Return the URL of a device that is asked for what a stroke needs to follow the finger."""
    if record is not None:
        raise InputError(
            "--record: a stroke that follows the finger cannot be rendered again; play with "
            "--finger fixed to record it"
        )
    return with_default_option(url, "correlation_ms", str(WINDOW_MS))


def _set_gain(
    summary: Summary,
    gain: float | Literal["auto"] | None,
    display: Display,
    texture: Texture | NamedEffect,
    trajectory: Trajectory,
    seed: int,
) -> None:
    """Note the gain in the summary; if it is the largest, with the limit that it reaches."""
    if isinstance(gain, float | int):
        summary.gain = gain
    elif isinstance(texture, NamedEffect):
        if gain == "auto":
            raise InputError(
                f"gain auto cannot be used with the effect {texture.name}: give a number"
            )
    else:
        rate = summary.sample_rate_hz
        try:
            largest = largest_gain(display, texture, trajectory, sample_rate=rate, seed=seed)
        except InputError:  # there is nothing to amplify
            if gain == "auto":
                raise
        else:
            summary.gain, summary.gain_limit = largest.value, largest.limit


def _amplified(
    display: Display, texture: Texture | NamedEffect, gain: float, rate: float
) -> tuple[Texture | None, Floats | None]:
    """Return a texture with its gain, or the shear (S,) of an effect [m].

    An effect begins after the fade at the beginning of a stream.
    """
    if isinstance(texture, NamedEffect):
        fade = np.zeros(round(display.limits.fade * rate))
        return None, np.concatenate([fade, replace(texture, gain=gain).shear(rate)])
    return amplified(texture, gain), None


def _follow(
    stroke: Callable[[], BusStatus], bus: Bus, planned: int, *, delay: int, spacing: int = 1
) -> tuple[Outcome, BusError | None]:
    """Play a stroke; return its outcome once the output is at 0 V, and the error that ended it.

    Ctrl-C ends the stroke. It is raised if nothing was written before, and so is an error.
    """
    ending: Ending = "complete"
    error = None
    try:
        status = stroke()
    except (BusError, KeyboardInterrupt) as reason:
        status = bus.status
        if not bus.next_position:
            raise
        if isinstance(reason, BusError):
            ending, error = "failed", reason
        else:
            ending = "interrupted"
        bus.abort()
    outcome = outcome_of(
        planned, bus, status,
        delay=delay, spacing=spacing, ending=ending, error=str(error or ""),
    )  # fmt: skip
    return outcome, error


def _play_frames(
    summary: Summary,
    display: Display,
    texture: Texture | None,
    trajectory: Trajectory,
    bus: Bus,
    seed: int,
    record: str | Path | None,
) -> None:
    """Play on a link that takes spectrum frames, and complete the summary."""
    assert bus.frames is not None
    if texture is None:
        raise InputError(
            f"{summary.texture}: is an effect, and the link takes spectrum frames, which play "
            "textures only"
        )
    if record is not None:
        raise InputError("--record: the link takes spectrum frames, which have no samples")
    rate = bus.wiring.sample_rate
    renderer = SpectrumRenderer(
        display, texture,
        carriers=bus.frames.carriers, frame_rate=bus.frames.rate, sample_rate=rate, seed=seed,
    )  # fmt: skip
    spacing = renderer.spacing
    planned = frames_of(trajectory, rate, spacing) * spacing
    summary.outcome, error = _follow(
        lambda: play_frames(display, renderer, trajectory, bus, sample_rate=rate),
        bus, planned, spacing=spacing,
        delay=1,  # since the position after a frame is counted
    )  # fmt: skip
    summary.frames = min(bus.next_position, planned) // spacing
    summary.samples = summary.frames * spacing
    summary.seconds = summary.samples / rate
    summary.limited_samples = renderer.limited_frames
    summary.invalid_samples = renderer.invalid_frames
    if error is not None:
        raise error


def _recorder(
    summary: Summary,
    display: Display,
    trajectory: Trajectory,
    seed: int,
    record: str | Path | None,
    sources: Sources | None,
    waveform: Floats | None,
) -> Recorder | None:
    """Return the recorder of a run, if one was requested."""
    if record is None:
        return None
    effect = {} if waveform is None else {"waveform_m": waveform}
    recorder = Recorder(
        record,
        **effect,
        sample_rate_hz=summary.sample_rate_hz,
        contactors_mm=display.contactors * 1e3,
        path_time_s=trajectory.time,
        path_position_m=trajectory.position,
        path_normal_force_n=trajectory.normal_force,
    )
    recorder.provenance = Provenance(
        texture=summary.texture,
        display=summary.display,
        device=summary.device,
        gain=summary.gain,
        seed=seed,
        sample_rate_hz=summary.sample_rate_hz,
        limits=limits_of(display.limits),
        versions=present_versions(),
        sources=sources,
    )
    summary.recording = str(record)
    return recorder


def _no_rows(contactors: int, *, simulated: bool) -> dict[str, Floats]:
    """Return empty arrays of a recording, which has them even if nothing is added to it."""
    none = np.zeros((0, contactors))
    block = PlayedBlock(np.zeros(0), np.zeros((0, 2)), np.zeros(0), none, none, 0.0)
    return _rows(block, none if simulated else None)


def _rows(block: PlayedBlock, skin_shear: Floats | None) -> dict[str, Floats]:
    """Return the arrays of a block to record, by name."""
    rows = {
        "drive_v": block.drive,
        "shear_target_m": block.shear,
        "time_s": block.time,
        "position_mm": block.position * 1e3,
    }
    return rows if skin_shear is None else rows | {"shear_played_m": skin_shear}
