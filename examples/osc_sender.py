"""Stroke a texture over OSC, as Max, Pure Data, Unity or TouchDesigner would.

    python examples/osc_sender.py --seconds 10 --texture wood-oak

The server must listen to OSC on 127.0.0.1:7412 (``[osc] port = 7412`` in its configuration). OSC
can neither arm nor disarm a display; a program does that with `tactile.connect`, or the
configuration with ``arm_on_start``. If there are several displays, ``/tactile/<display>/contact``
names one.
"""

import argparse
import math
import socket
import sys
import time

try:
    from pythonosc.osc_message_builder import build_msg
except ImportError:
    sys.exit("this example needs python-osc: pip install python-osc")

RATE = 90.0  # Hz
STROKE_MM, FREQUENCY = 20.0, 0.5  # amplitude, and strokes to and fro per second [Hz]
NORMAL_FORCE_N = 0.5


def stroke(link: socket.socket, texture: str, seconds: float) -> int:
    """Stroke to and fro for some seconds, and return the number of contacts."""

    def send(address: str, *values: object) -> None:
        link.send(build_msg(address, values).dgram)

    send("/tactile/texture", texture)
    omega, count = 2 * math.pi * FREQUENCY, 0
    begun = time.monotonic()
    while (t := time.monotonic() - begun) < seconds:
        x_mm = STROKE_MM * math.sin(omega * t)
        vx_mm_s = STROKE_MM * omega * math.cos(omega * t)
        send("/tactile/contact", x_mm, 0.0, NORMAL_FORCE_N, vx_mm_s, 0.0)
        count += 1
        time.sleep(max(0.0, begun + count / RATE - time.monotonic()))
    send("/tactile/contact", 0.0, 0.0, 0.0)  # lifted
    send("/tactile/stop")
    return count


def main() -> None:
    """Connect, stroke and print the number of contacts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument(
        "--url", default="osc.udp://127.0.0.1:7412", help="host and port of the server"
    )
    parser.add_argument("--texture", default="wood-oak")
    options = parser.parse_args()
    host, _, port = options.url.removeprefix("osc.udp://").strip("/").rpartition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect((host, int(port)))  # so that the system reports if nothing listens there
        try:
            count = stroke(link, options.texture, options.seconds)
        except ConnectionRefusedError:
            sys.exit(f"{options.url}: nothing listens there; is [osc] port = {port} configured?")
    print(f"{count} contacts to {host}:{port}")


if __name__ == "__main__":
    main()
