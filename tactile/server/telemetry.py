"""Telemetry of a display, in the units of the API."""

import math

import numpy as np
from numpy.typing import NDArray

from tactile.messages import (
    TelemetryFinger,
    TelemetryMessage,
    TelemetrySamples,
    TelemetryTrace,
)
from tactile.playback.block_rendering import BLOCK
from tactile.playback.commands import DeviceOpened
from tactile.playback.followed_finger import FollowedFinger
from tactile.playback.sample_ring import SampleRing
from tactile.playback.shared_memory import PlaybackMemory
from tactile.server.playing import Playing

MOST_BYTES = 1 << 18
"""Largest size of the samples in a message [bytes]; what does not fit is in the next one. WebSocket
clients commonly take messages of at most 1 MiB, and JSON makes these a third larger."""


def known(value: float) -> float | None:
    """Return a value, or None for NaN and infinity, which JSON does not have.

    Parameters
    ----------
    value : float
        Value, which may not be known.

    Returns
    -------
    float or None
        The value.
    """
    return value if math.isfinite(value) else None


class ShearReader:
    """Reader of the shear of one contactor, which takes what came since it read last."""

    _next: int | None = None

    def read(self, ring: SampleRing, contactor: int, sample_rate: float) -> TelemetryTrace:
        """Return the new samples of a contactor, none at first.

        Parameters
        ----------
        ring : SampleRing
            Ring that holds the shear.
        contactor : int
            Index of the contactor.
        sample_rate : float
            Rate of the samples [Hz].

        Returns
        -------
        TelemetryTrace
            Samples in the units of the API.
        """
        first, shear = ring.since(contactor, ring.count if self._next is None else self._next)
        self._next = first + len(shear)
        samples = (shear * 1e6).astype("<f4").tobytes()
        return TelemetryTrace(
            contactor=contactor, sample_rate_hz=sample_rate, first=first, shear_um=samples
        )


class SamplesReader:
    """Reader of all that is played on a display, which takes what came since it read last.

    Parameters
    ----------
    memory : PlaybackMemory
        Memory that is shared with the playback process; what it holds already is old.

    Attributes
    ----------
    is_behind : bool
        Whether there may be more than was read last.
    """

    def __init__(self, memory: PlaybackMemory) -> None:
        self._memory, self._next = memory, memory.blocks.count
        self._end: int | None = None
        self.is_behind = False

    def read(self, memory: PlaybackMemory, how: DeviceOpened) -> TelemetrySamples:
        """Return the new blocks, at most as many as fit into a message.

        Parameters
        ----------
        memory : PlaybackMemory
            Memory of the display, which has another one when its configuration was read again.
        how : DeviceOpened
            How the device plays.

        Returns
        -------
        TelemetrySamples
            Blocks in the units of the API.
        """
        if memory is not self._memory:
            self._memory, self._next, self._end = memory, 0, None
        length = round(how.sample_rate / how.frame_rate) if how.carriers else BLOCK
        most = max(MOST_BYTES // (BLOCK * len(memory.drive) * 8), 1)
        index, blocks = memory.blocks.since(self._next, most)
        self.is_behind = len(blocks) == most
        if len(blocks):
            self._end = int(blocks["first"][0])
        elif self._end is None:
            self._end = index * length if how.carriers else memory.commanded.count
        first = self._end
        numbers = first + length * np.arange(len(blocks))
        # playback that was started again may have left a gap, after which another message begins
        blocks = blocks[np.logical_and.accumulate(blocks["first"] == numbers)]
        self._next, self._end = index + len(blocks), first + length * len(blocks)
        return self._message(blocks, (first, self._end), length, how)

    def _message(
        self, blocks: NDArray[np.void], samples: tuple[int, int], length: int, how: DeviceOpened
    ) -> TelemetrySamples:
        """Return blocks that follow one another in the units of the API."""
        memory, shear, drive = self._memory, None, None
        if not how.carriers:
            shear = _binary(memory.commanded.between(*samples) * 1e6)
            drive = _binary(memory.driven.between(*samples))
        uncertainty = float(blocks["uncertainty"].max(initial=0.0))
        return TelemetrySamples(
            first=samples[0],
            sample_rate_hz=how.sample_rate,
            block_samples=length,
            times_us=(blocks["due"] * 1e6).astype("<f8").tobytes(),
            uncertainty_us=known(uncertainty * 1e6),
            finger_times_us=(blocks["finger_due"] * 1e6).astype("<f8").tobytes(),
            position_mm=_binary(blocks["position"] * 1e3),
            velocity_mm_s=_binary(blocks["velocity"] * 1e3),
            normal_force_n=_binary(blocks["normal_force"]),
            touching=tuple((blocks["touching"] > 0).tolist()),
            shear_um=shear,
            drive_v=drive,
        )


def _binary(values: NDArray[np.floating]) -> bytes:
    """Return values as little-endian float32."""
    return values.astype("<f4").tobytes()


def snapshot(
    playing: Playing,
    trace: TelemetryTrace | None = None,
    played: TelemetryTrace | None = None,
    samples: TelemetrySamples | None = None,
) -> TelemetryMessage:
    """Return the present state of a display.

    Parameters
    ----------
    playing : Playing
        The display.
    trace, played : TelemetryTrace, optional
        Commanded shear of one contactor, and that of the skin, to send along.
    samples : TelemetrySamples, optional
        What was played since the message before, to send along.

    Returns
    -------
    TelemetryMessage
        State in the units of the API.
    """
    r = playing.report
    return TelemetryMessage(
        display=playing.config.name,
        time_us=round(r.time * 1e6),
        state=playing.state,
        position_mm=(r.position[0] * 1e3, r.position[1] * 1e3),
        velocity_mm_s=(r.velocity[0] * 1e3, r.velocity[1] * 1e3),
        normal_force_n=r.normal_force,
        shear_um=None if playing.how.carriers else tuple((playing.memory.shear * 1e6).tolist()),
        drive_v=tuple(playing.memory.drive.tolist()),
        counters=playing.counters,
        put_out_share=known(r.put_out_share),
        finger=None if r.finger is None else _loads(r.finger),
        trace=trace,
        played=played,
        samples=samples,
    )


def _loads(finger: FollowedFinger) -> TelemetryFinger:
    """Return the loads of a finger in the units of the API."""
    return TelemetryFinger(
        touching=tuple(finger.touching.tolist()),
        stiffness_n_m=tuple(finger.stiffness.tolist()),
        equalizer_error_db=tuple(finger.deviation.tolist()),
        explained=tuple(finger.explained.tolist()),
        guarded=tuple(finger.guarded.tolist()),
    )
