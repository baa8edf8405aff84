"""Checks in QEMU: our audio bus on a sound card, whose other end is recorded."""

import importlib
from collections.abc import Iterator

import numpy as np
import pytest
from bus_tools import CODE, Rig, play, playing
from guest_tools import wait_for
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.bus.audio.audio_bus import AudioBus
from tactile.bus.registry import open_bus

CARD, EAR = "Loopback: PCM (hw:0,0)", "Loopback: PCM (hw:0,1)"
CHANNELS = 24
RATE = 16000
"""Sample rate [Hz]. At 48 kHz the buffer has 8 ms, too short in a guest for a card that ticks every
4 ms."""
BLOCK = RATE // 100
QUIET = RATE // 10
FULL_SCALE = 100.0
"""Full scale of `Rig` [V]."""


class Ear:
    """Recorder of the card's other end, as long as the context lasts."""

    def __init__(self) -> None:
        sd = importlib.import_module("sounddevice")
        number = next(d["index"] for d in sd.query_devices() if d["name"] == EAR)
        self.gaps: list[str] = []
        """Losses that PortAudio reports."""
        self._blocks: list[NDArray[np.float32]] = []
        self.stream = sd.InputStream(
            device=number, callback=self._take, dtype="float32", samplerate=RATE,
            channels=CHANNELS, blocksize=BLOCK, latency=0.8,
        )  # fmt: skip

    def _take(self, block: NDArray[np.float32], _frames: int, _time: object, gap: object) -> None:
        self._blocks.append(block.copy())
        self.gaps += [str(gap)] * bool(gap)

    @property
    def heard(self) -> Floats:
        """Everything that was recorded so far (S, C) [V]."""
        return np.concatenate([np.zeros((1, CHANNELS)), *self._blocks]) * FULL_SCALE

    @property
    def is_quiet(self) -> bool:
        """Whether the recording has fallen silent."""
        return len(self.heard) > QUIET and not self.heard[-QUIET:].any()


@pytest.fixture
def ear() -> Iterator[Ear]:
    ear = Ear()
    with ear.stream:
        yield ear


@pytest.fixture
def bus(ear: Ear) -> Iterator[AudioBus]:
    url = f"audio:{CARD}?channels={CHANNELS}"
    bus = open_bus(url, Rig(CHANNELS), sample_rate=RATE, accept_unsafe_hold=True)
    assert isinstance(bus, AudioBus)
    with bus:
        yield bus


def sounding(codes: Floats) -> Floats:
    """Return what comes from the last beginning of a sound on."""
    sounds = np.asarray(codes.any(axis=1))
    return codes[np.flatnonzero(sounds[1:] & ~sounds[:-1])[-1] + 1 :]


def test_24_channels_are_heard_as_they_were_given(ear: Ear, bus: AudioBus) -> None:
    """Compare the last play: those before it came late, as the bus has counted."""
    volts = play(bus, block=BLOCK)
    wait_for("all is heard", lambda: ear.is_quiet)
    assert not ear.gaps
    given = sounding(np.rint(volts / CODE))
    heard = ear.heard / CODE
    assert np.abs(heard - np.rint(heard)).max() < 1e-2
    assert np.array_equal(sounding(np.rint(heard))[: len(given)], given)


def test_an_estop_silences_the_card_at_the_slew_limit(ear: Ear, bus: AudioBus) -> None:
    with playing(bus, BLOCK):
        wait_for("it is heard", lambda: bool(ear.heard.any()))
        bus.estop()
    wait_for("it is quiet", lambda: ear.is_quiet)
    assert (bus.state, bus.counters.disconnects) == ("estopped", 0)
    heard = ear.heard
    last = int(np.flatnonzero(heard.any(axis=1))[-1])
    step = bus.wiring.slew / RATE
    fall = np.abs(np.diff(heard[last - 4 :], axis=0)).max()
    assert step / 4 < fall <= step + CODE
