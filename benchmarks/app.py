"""Programs that play through a server until they are ended, each in its own process.

They are forked from a process that has loaded the SDK, so that one begins within milliseconds.
"""

import math
import multiprocessing
import time
from collections.abc import Callable
from multiprocessing.process import BaseProcess

import tactile.client
import tactile.client.websocket  # Loaded before the fork, so that programs begin sooner.
from benchmarks.server import NAME, PATIENCE, wait_for
from tactile.client import RemoteDisplay

LASTS = 120.0
"""Default time after which a program ends by itself [s]."""
RATE = 90.0
"""Rate at which the finger's position is sent [Hz]."""
FREQUENCY, AMPLITUDE = 160.0, 20e-6
"""Frequency [Hz] and amplitude [m] of the shear of waveforms and effects."""
SAMPLE_RATE, AHEAD = 8000, 0.4
"""Sample rate of the waveform [Hz], and the duration of it that waits in the server [s]."""
EFFECT = 60.0
"""Longest duration of an effect that may be requested [s]."""
TEXTURE = "wood-oak"
"""Texture of the strokes."""


def get_ready(display: RemoteDisplay, sound: str) -> None:
    """Select and arm as soon as the server permits it; playback may be being started again.

    Raises
    ------
    TimeoutError
        If the server does not permit it in time.
    """

    def is_ready() -> bool:
        if sound == "stroke":
            display.select(TEXTURE, timeout=PATIENCE)
        display.arm()
        return True

    wait_for("the server permits to play", is_ready)


def play_stroke(display: RemoteDisplay, lasts: float) -> None:
    """Move a finger over oak, back and forth."""
    begun = time.monotonic()
    while (now := time.monotonic() - begun) < lasts:
        speed = 0.08 * math.cos(2 * now)
        place = 0.04 * math.sin(2 * now)
        display.touch((place, 0.0), velocity=(speed, 0.0), normal_force=0.5)
        time.sleep(1 / RATE)


def play_waveform(display: RemoteDisplay, lasts: float) -> None:
    """Append to a waveform so that it never ends."""
    period = round(SAMPLE_RATE / FREQUENCY)
    wave = [math.sin(2 * math.pi * k / period) for k in range(2 * period + 2000)]
    begun, offset = time.monotonic(), 0
    while time.monotonic() - begun < lasts:
        appended = display.append(
            wave[offset : offset + 2000], sample_rate=SAMPLE_RATE, amplitude=AMPLITUDE
        )
        offset = (offset + appended.samples_consumed) % period
        time.sleep(max(0.05, appended.buffered - AHEAD))


def play_effect(display: RemoteDisplay, lasts: float) -> None:
    """Play an effect of a minute, and do nothing more."""
    begin_effect(display)
    time.sleep(lasts)


def begin_effect(display: RemoteDisplay) -> None:
    """Request an effect of a minute."""
    display.effect(
        AMPLITUDE,
        amplitude_points=[(0.0, 1.0), (EFFECT, 1.0)],
        frequency_points=[(0.0, FREQUENCY)],
    )


SOUNDS: dict[str, Callable[[RemoteDisplay, float], None]] = {
    "stroke": play_stroke,
    "waveform": play_waveform,
    "effect": play_effect,
}
"""Functions that play, by name."""


def _be_app(url: str, sound: str, lasts: float) -> None:
    with tactile.client.connect(url, display=NAME, timeout=PATIENCE) as display:
        get_ready(display, sound)
        SOUNDS[sound](display, lasts)


def start_app(url: str, sound: str, lasts: float = LASTS) -> BaseProcess:
    """Start a program that plays one of `SOUNDS` for a duration [s], and return its process."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    process = context.Process(target=_be_app, args=(url, sound, lasts), daemon=True)
    process.start()
    return process
