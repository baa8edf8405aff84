"""Two fingers with asyncio, each with its own display and path, on one connection.

    python examples/two_fingers.py --displays left right --seconds 10

If the server has only one display, only one finger is played, because a display has one finger.
"""

import argparse
import asyncio
import math
import sys
import time

import tactile
from tactile.client import aio

RATE = 120.0  # Hz, of the tracker


async def stroke(display: aio.AsyncDisplay, texture: str, frequency: float, seconds: float) -> int:
    """Stroke to and fro, and return the number of contacts that were sent."""
    await display.select((texture, 0.8))
    await display.arm()
    omega, amplitude = 2 * math.pi * frequency, 0.02  # rad/s, m
    begun, count = time.monotonic(), 0
    try:
        while (t := time.monotonic() - begun) < seconds:
            x, speed = amplitude * math.sin(omega * t), amplitude * omega * math.cos(omega * t)
            await display.touch((x, 0.0), velocity=(speed, 0.0), normal_force=0.5)
            count += 1
            await asyncio.sleep(max(0.0, count / RATE - t))
        await display.lift()
    finally:
        await display.disarm()
    return count


async def play(options: argparse.Namespace) -> None:
    """Connect, stroke with each finger, and print the number of contacts."""
    async with aio.open_connection(options.url) as connection:
        connection.on_event(lambda event: print(f"{event.display}: {event.kind} {event.detail}"))
        names = options.displays or list(connection.displays)[:2]
        strokes = [
            stroke(connection.display(name), texture, frequency, options.seconds)
            for name, texture, frequency in zip(names, options.textures, (0.5, 0.8), strict=False)
        ]
        counts = await asyncio.gather(*strokes)
        told = ", ".join(f"{name} {count}" for name, count in zip(names, counts, strict=True))
        print(f"contacts: {told}; dropped: {connection.counters['dropped_contacts']}")


def main() -> None:
    """Read the command line, and play."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--url", help="URL of the server; by default that of this machine")
    parser.add_argument(
        "--displays", nargs="+", help="names of one or two displays; by default the first two"
    )
    parser.add_argument("--textures", nargs=2, default=["wood-oak", "leather-calf"])
    asyncio.run(play(parser.parse_args()))


if __name__ == "__main__":
    try:
        main()
    except tactile.TactileError as error:
        sys.exit(f"{error}")
