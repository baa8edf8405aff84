"""Frame loop as in OpenXR: locate the hand, detect contact with a table, send the contact.

    python examples/hand_tracking.py [my-hand.csv]    # time_s,x_m,y_m,z_m of an index finger's tip

The table is the plane y = 0.75 m; in OpenXR the y axis points upward. To use your own runtime,
replace `locate` by a function that returns the position of the finger (xrLocateHandJointsEXT). Pass
XrTime, converted to seconds, as the time of `touch`.
"""

import argparse
import csv
import math
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import tactile
import tactile.client

FRAME_RATE = 90.0  # Hz, of the headset
TABLE = 0.75  # m above the floor
STIFFNESS = 250.0  # N/m: a finger 2 mm deep in the table presses with 0.5 N (assumed)
STRONGEST = 2.0  # N

Point = Sequence[float]


def synthetic(t: float) -> Point:
    """Return the position of a finger that circles on the table and lifts every 3 s [m]."""
    angle = 2 * math.pi * 0.5 * t
    height = 0.01 if t % 3.0 > 2.5 else -0.002
    return 0.03 * math.cos(angle), TABLE + height, 0.03 * math.sin(angle)


class RecordedPath:
    """Recorded path, interpolated linearly between its rows, that repeats when it ends."""

    def __init__(self, path: Path) -> None:
        with path.open(newline="") as lines:
            rows = [[float(value) for value in row] for row in list(csv.reader(lines))[1:]]
        self.times, self.points = [row[0] for row in rows], [row[1:4] for row in rows]

    def __call__(self, t: float) -> Point:
        """Return the position of the finger at a time [m]."""
        t = self.times[0] + t % (self.times[-1] - self.times[0])
        i = next(i for i in range(1, len(self.times)) if self.times[i] >= t)
        part = (t - self.times[i - 1]) / (self.times[i] - self.times[i - 1])
        before, after = self.points[i - 1], self.points[i]
        return [a + part * (b - a) for a, b in zip(before, after, strict=True)]


def run(
    display: tactile.client.RemoteDisplay, locate: Callable[[float], Point], seconds: float
) -> tuple[int, int]:
    """Run the frame loop; return the number of frames, and of those with contact."""
    frames = touches = 0
    before: Point | None = None  # position on the table in the last frame, None without contact
    begun = time.monotonic()
    while (now := time.monotonic()) - begun < seconds:
        x, y, z = locate(now - begun)
        depth = TABLE - y
        if depth > 0:
            here = (x, -z)  # position on the surface, seen from above
            velocity = None
            if before is not None:
                velocity = [(a - b) * FRAME_RATE for a, b in zip(here, before, strict=True)]
            force = min(STIFFNESS * depth, STRONGEST)
            display.touch(here, velocity=velocity, normal_force=force, time=now)
            before, touches = here, touches + 1
        elif before is not None:
            display.lift(time=now)
            before = None
        frames += 1
        time.sleep(max(0.0, begun + frames / FRAME_RATE - time.monotonic()))
    display.lift()
    return frames, touches


def main() -> None:
    """Play a path for some seconds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", nargs="?", type=Path, help="CSV: time_s,x_m,y_m,z_m")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--url", help="URL of the server; by default that of this machine")
    parser.add_argument("--display", help="name of the display, if there are several")
    parser.add_argument("--texture", default="wood-oak")
    options = parser.parse_args()
    locate = RecordedPath(options.path) if options.path else synthetic
    with tactile.client.connect(options.url, display=options.display) as display:
        display.select(options.texture)
        display.arm()
        try:
            frames, touches = run(display, locate, options.seconds)
        finally:
            display.disarm()
        share = display.stats().put_out_share
        dropped = display.dropped_contacts
        print(f"{frames} frames, {touches} touches, {dropped} dropped; put out {share:.2%}")


if __name__ == "__main__":
    try:
        main()
    except tactile.TactileError as error:
        sys.exit(f"{error}")
