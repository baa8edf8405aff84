"""Playback without a server: a trajectory rendered block by block onto a bus.

The stream fades in at its beginning and out at its end. What is passed to the listener is aligned:
the renderer's delay is removed, so that drive, shear, position and time of a sample belong
together.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tactile.arrays import Floats
from tactile.bus.base import Bus, BusStatus, DriveBlock, DriveFrame
from tactile.clock import Clock
from tactile.display.display import Display
from tactile.errors import BusError
from tactile.playback.followed_finger import FollowedFinger
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.rendering.spectrum import SpectrumRenderer

BLOCK = 64
"""Largest length of a block [samples]."""


@dataclass(frozen=True)
class PlayedBlock:
    """Block that was sent, sample by sample.

    Attributes
    ----------
    time : (S,) array of float
        Times [s].
    position : (S, 2) array of float
        Position of the finger [m].
    normal_force : (S,) array of float
        Normal force [N].
    drive : (S, N) array of float
        Drive [V].
    shear : (S, N) array of float
        Commanded shear [m].
    speed : float
        Speed of the finger at the end of the block [m/s].
    finger : FollowedFinger or None
        Latest loads of a finger that is followed; None if they are not known.
    """

    time: Floats
    position: Floats
    normal_force: Floats
    drive: Floats
    shear: Floats
    speed: float
    finger: FollowedFinger | None = None


def play(
    display: Display,
    renderer: Renderer,
    trajectory: Trajectory,
    bus: Bus,
    *,
    sample_rate: float,
    listen: Callable[[PlayedBlock], None],
    clock: Clock | None = None,
    waveform: Floats | None = None,
    written: Callable[[int, Floats], None] | None = None,
) -> BusStatus:
    """Play a trajectory to its end.

    Parameters
    ----------
    display : Display
        Display to play.
    renderer : Renderer
        Renderer with the texture.
    trajectory : Trajectory
        Path of the finger.
    bus : Bus
        Bus of the display, idle.
    sample_rate : float
        Sample rate of the drive [Hz].
    listen : callable
        Function that is called with each played block.
    clock : Clock, optional
        Clock to wait for each block's time by, on a bus that does not wait; None to go ahead.
    waveform : (S,) array of float, optional
        Shear that is added on all contactors, from the first sample on [m].
    written : callable, optional
        Function that is called with the position of each block and its drive (S, N) when the block
        has been written [V].

    Returns
    -------
    BusStatus
        Status of the bus after the last sample was written, before it was stopped.

    Raises
    ------
    BusError
        If the bus fails; its ``with`` block then aborts the stream.
    """
    start_time, sent = 0.0, 0
    blocks = rendered(display, renderer, trajectory, sample_rate=sample_rate, waveform=waveform)
    for drive, played in blocks:
        if not sent:  # the first block takes longest
            bus.start()
            start_time = 0.0 if clock is None else clock.now()
        bus.write(DriveBlock(sent, display.to_channels(drive)))
        _check_estop(bus)
        if written is not None:
            written(sent, drive)
        sent += len(drive)
        if played is not None:
            listen(played)
        if clock is not None and not bus.paced:
            clock.sleep(start_time + sent / sample_rate - clock.now())
    status = bus.status
    bus.stop()
    return status


def rendered(
    display: Display,
    renderer: Renderer,
    trajectory: Trajectory,
    *,
    sample_rate: float,
    waveform: Floats | None = None,
) -> Iterator[tuple[Floats, PlayedBlock | None]]:
    """Yield the drive of a trajectory block by block, faded in and out.

    Parameters
    ----------
    display : Display
        Display to render for.
    renderer : Renderer
        Renderer with the texture.
    trajectory : Trajectory
        Path of the finger.
    sample_rate : float
        Sample rate of the drive [Hz].
    waveform : (S,) array of float, optional
        Shear that is added on all contactors, from the first sample on [m].

    Yields
    ------
    drive : (S, N) array of float
        Drive of each contactor [V].
    played : PlayedBlock or None
        Samples that this drive completes, without the delay of the renderer; None if there are
        none.
    """
    fade = round(display.limits.fade * sample_rate)
    last = round(trajectory.duration * sample_rate) - fade
    renderer.fade_in()
    sent = 0
    delayed = _Delayed(trajectory.time[0], sample_rate, renderer.delay)
    for position, normal_force in _blocks(trajectory, sample_rate, renderer.delay, last):
        if sent == max(last, 0):
            renderer.fade_out()
        added = None if waveform is None else _part(waveform, sent, len(position))
        drive, shear = renderer.block(position, normal_force, waveform=added, shear=True)
        sent += len(drive)
        yield drive, delayed(position, normal_force, drive, shear)


def _part(waveform: Floats, start: int, count: int) -> Floats:
    """Return samples of a waveform, which is 0 after its end."""
    part = waveform[start : start + count]
    return np.pad(part, (0, count - len(part)))


def frames_of(trajectory: Trajectory, sample_rate: float, spacing: int) -> int:
    """Return the number of spectrum frames of a trajectory, without the one that falls to 0 V.

    Parameters
    ----------
    trajectory : Trajectory
        Path of the finger.
    sample_rate : float
        Sample rate of the amplifier [Hz].
    spacing : int
        Distance from one frame to the next [samples].

    Returns
    -------
    int
        Number of frames, at least 1.
    """
    return max(int(trajectory.duration * sample_rate / spacing), 1)


def play_frames(
    display: Display,
    renderer: SpectrumRenderer,
    trajectory: Trajectory,
    bus: Bus,
    *,
    sample_rate: float,
) -> BusStatus:
    """Play a trajectory as spectrum frames, on a bus that takes them.

    The first frame rises from 0 V, and the last one falls to it.

    Parameters
    ----------
    display : Display
        Display to play.
    renderer : SpectrumRenderer
        Renderer with the texture.
    trajectory : Trajectory
        Path of the finger.
    bus : Bus
        Bus of the display, idle.
    sample_rate : float
        Sample rate of the amplifier [Hz].

    Returns
    -------
    BusStatus
        Status of the bus after the last frame was written, before it was stopped.

    Raises
    ------
    BusError
        If the bus fails.
    """
    bus.tune(renderer.carriers)
    spacing = renderer.spacing
    renderer.sample = spacing
    count = frames_of(trajectory, sample_rate, spacing)
    lines = np.zeros((display.channels, len(renderer.carriers)), np.complex128)
    for k in range(1, count + 1):
        time = trajectory.time[0] + k * spacing / sample_rate
        place, force = trajectory.at(time)
        lines[display.channel] = renderer.frame(place, trajectory.velocity(time), float(force))
        if k == 1:
            bus.start()
        bus.write_frame(DriveFrame(k * spacing, lines.copy()))
        _check_estop(bus)
    bus.write_frame(DriveFrame((count + 1) * spacing, np.zeros_like(lines)))
    status = bus.status
    bus.stop()
    return status


def _check_estop(bus: Bus) -> None:
    """Raise BusError if an e-stop would drop the rest of what is to be played."""
    if bus.state == "estopped":
        raise BusError(bus.status.detail or "e-stopped while playing: clear it to play again")


def _blocks(
    trajectory: Trajectory, sample_rate: float, extra: int, cut: int
) -> Iterator[tuple[Floats, Floats]]:
    """Yield the blocks of the trajectory, with a boundary where the fade begins."""
    start = 0
    for position, normal_force in trajectory.blocks(sample_rate, BLOCK, extra=extra):
        at = cut - start
        start += len(position)
        if 0 < at < len(position):
            yield position[:at], normal_force[:at]
            position, normal_force = position[at:], normal_force[at:]
        yield position, normal_force


class _Delayed:
    """Delay line of positions, until their drive and shear come out of the renderer."""

    def __init__(self, begin: float, sample_rate: float, delay: int) -> None:
        self._begin, self._rate, self._delay = begin, sample_rate, delay
        self._contact = np.zeros((0, 3))
        self._count = -delay

    def __call__(
        self, position: Floats, normal_force: Floats, drive: Floats, shear: Floats
    ) -> PlayedBlock | None:
        """Add a block; return the samples whose output has come, None if there are none."""
        contact = np.concatenate([self._contact, np.column_stack([position, normal_force])])
        early = min(max(-self._count, 0), len(drive))
        count = len(drive) - early
        self._contact = contact[count:]
        first = self._count + early
        self._count += len(drive)
        if not count:
            return None
        return PlayedBlock(
            self._begin + (first + np.arange(count)) / self._rate,
            contact[:count, :2],
            contact[:count, 2],
            drive[early:],
            shear[early:],
            self._speed(contact[:, :2], count - 1),
        )

    def _speed(self, place: Floats, at: int) -> float:
        """Return the speed [m/s] at a sample, from its neighbors."""
        before, after = max(at - 1, 0), min(at + 1, len(place) - 1)
        return float(np.hypot(*(place[after] - place[before]))) * self._rate / (after - before)
