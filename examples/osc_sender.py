"""Stroke a texture over OSC, as from Max, Pure Data, Unity or TouchDesigner.

    python examples/osc_sender.py --seconds 10 --texture wood-oak

The server listens on UDP 127.0.0.1:7412. OSC can neither arm nor disarm a display: do that with
`tactile` or the SDK. ``/tactile/<display>/contact`` and so on name one of several displays.
"""

import argparse
import math
import time

from pythonosc.udp_client import SimpleUDPClient

RATE = 90.0  # Hz
STROKE_MM, FREQUENCY = 20.0, 0.5  # to either side, and how often a second
NORMAL_FORCE_N = 0.5


def main() -> None:
    """Stroke to and fro for some seconds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--url", default="osc.udp://127.0.0.1:7412", help="host and port")
    parser.add_argument("--texture", default="wood-oak")
    options = parser.parse_args()
    host, _, port = options.url.removeprefix("osc.udp://").strip("/").rpartition(":")
    sender = SimpleUDPClient(host, int(port))
    sender.send_message("/tactile/texture", options.texture)
    omega, count = 2 * math.pi * FREQUENCY, 0
    begun = time.monotonic()
    while (t := time.monotonic() - begun) < options.seconds:
        x_mm = STROKE_MM * math.sin(omega * t)
        vx_mm_s = STROKE_MM * omega * math.cos(omega * t)
        sender.send_message("/tactile/contact", [x_mm, 0.0, NORMAL_FORCE_N, vx_mm_s, 0.0])
        count += 1
        time.sleep(max(0.0, begun + count / RATE - time.monotonic()))
    sender.send_message("/tactile/contact", [0.0, 0.0, 0.0])  # lifted
    sender.send_message("/tactile/stop", [])
    print(f"{count} contacts to {host}:{port}")


if __name__ == "__main__":
    main()
