"""Stream a waveform as with XR_FB_haptic_pcm, where each call reports the samples it consumed.

    python examples/waveform_streamer.py                   # a sweep from 20 Hz to 500 Hz
    python examples/waveform_streamer.py knock.wav         # first channel of a 16-bit file

`display.play` does all of this in one call. This example uses `display.append`, for programs that
have a frame loop and must not wait.
"""

import argparse
import math
import sys
import time
import wave
from array import array
from collections.abc import Sequence
from pathlib import Path

import tactile
import tactile.client

SWEEP_RATE = 8000.0  # Hz
LOWEST, HIGHEST = 20.0, 500.0  # Hz
FRAME_RATE = 90.0  # Hz; a frame loop would draw its frame instead of holding the finger


def sweep(seconds: float) -> list[float]:
    """Return the samples of an exponential sweep, −1 … 1."""
    ratio = math.log(HIGHEST / LOWEST)
    times = (n / SWEEP_RATE for n in range(int(seconds * SWEEP_RATE)))
    return [
        math.sin(2 * math.pi * LOWEST * seconds / ratio * math.expm1(t / seconds * ratio))
        for t in times
    ]


def recorded(path: Path, seconds: float) -> tuple[list[float], float]:
    """Return the first channel of a file, −1 … 1, and its sample rate [Hz]."""
    with wave.open(str(path)) as file:
        if file.getsampwidth() != 2:
            raise SystemExit(f"{path}: {8 * file.getsampwidth()} bit; must be 16")
        rate, channels = file.getframerate(), file.getnchannels()
        whole = array("h", file.readframes(int(seconds * rate)))
    if sys.byteorder == "big":
        whole.byteswap()
    return [sample / 32768 for sample in whole[::channels]], float(rate)


def stream(
    display: tactile.client.RemoteDisplay, samples: Sequence[float], rate: float, amplitude: float
) -> int:
    """Send all samples as the server has room for them; return the number of messages."""
    sent = calls = 0
    while sent < len(samples):
        taken = display.append(samples[sent : sent + 4000], sample_rate=rate, amplitude=amplitude)
        sent, calls = sent + taken.samples_consumed, calls + 1
        ended = sent == len(samples)
        hold(display, taken.buffered if ended else min(taken.buffered / 2, 0.05))
    return calls


def hold(display: tactile.client.RemoteDisplay, seconds: float) -> None:
    """Report a resting finger for some time: without contact, waveforms play 34 dB lower."""
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        display.touch((0.0, 0.0), velocity=(0.0, 0.0))
        time.sleep(min(left, 1 / FRAME_RATE))


def main() -> None:
    """Play a file or a sweep."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, help="16-bit WAV file")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--url", help="URL of the server; by default that of this machine")
    parser.add_argument("--display", help="name of the display, if there are several")
    parser.add_argument("--amplitude-um", type=float, default=5.0, help="shear at full scale")
    options = parser.parse_args()
    samples, rate = sweep(options.seconds), SWEEP_RATE
    if options.file:
        samples, rate = recorded(options.file, options.seconds)
    with tactile.client.connect(options.url, display=options.display) as display:
        display.arm()
        try:
            calls = stream(display, samples, rate, options.amplitude_um * 1e-6)
        finally:
            display.disarm()
        share = display.stats().put_out_share
    print(f"{len(samples)} samples at {rate:g} Hz in {calls} messages; put out {share:.2%}")


if __name__ == "__main__":
    try:
        main()
    except tactile.TactileError as error:
        sys.exit(f"{error}")
