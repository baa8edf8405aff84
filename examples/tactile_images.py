"""Stream images of 16 × 48 taxels at 1 kHz: a bar that vibrates sweeps over the array.

    python examples/tactile_images.py --seconds 5

A robot's tactile sensor would give the images: any sequence or array of them will do.
"""

import argparse
import math
import sys
import time

import tactile
import tactile.client

RATE = 1000.0  # Hz
ROWS, COLUMNS = 16, 48
VIBRATION, SWEEPS = 200.0, 0.5  # Hz
WIDTH = 0.15  # of the array


def bar(seconds: float) -> list[list[float]]:
    """Return the image at a time: a bar of Gaussian profile, values from −1 to 1."""
    place = (1 - math.cos(2 * math.pi * SWEEPS * seconds)) / 2
    vibration = math.sin(2 * math.pi * VIBRATION * seconds)
    columns = ((k + 0.5) / COLUMNS - place for k in range(COLUMNS))
    row = [vibration * math.exp(-((x / WIDTH) ** 2)) for x in columns]
    return [row] * ROWS


def main() -> None:
    """Stream the bar."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--url", help="URL of the server; by default that of this machine")
    parser.add_argument("--display", help="name of the display, if there are several")
    parser.add_argument("--amplitude-um", type=float, default=5.0, help="shear at full scale")
    options = parser.parse_args()
    with tactile.client.connect(options.url, display=options.display) as display:
        frames = display.frames(RATE, amplitude=options.amplitude_um * 1e-6, grid=(ROWS, COLUMNS))
        display.arm()
        try:
            begun = time.monotonic()
            for number in range(int(options.seconds * RATE)):
                if number % 10 == 0:  # without contact, frames play 34 dB lower
                    display.touch((0.0, 0.0), velocity=(0.0, 0.0))
                frames.write(bar(number / RATE))
                time.sleep(max(begun + (number + 1) / RATE - time.monotonic(), 0.0))
        finally:
            display.disarm()
        counters = display.stats().counters
    dropped = counters["dropped_frames"] + display.connection.counters["dropped_frames"]
    print(f"{dropped} frames were not played; {counters['frame_gaps']} times one came too late")


if __name__ == "__main__":
    try:
        main()
    except tactile.TactileError as error:
        sys.exit(f"{error}")
