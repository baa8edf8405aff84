"""Draw how a swinging finger is followed: ``python docs/tracking_picture.py``."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from tactile.tracking.clock_map import ClockMap
from tactile.tracking.tracker import ContactTracker

HERE = Path(__file__).parent
BLUE, RED, GRAY = "#0072B2", "#D55E00", "#666666"
RATE, BLOCK, LATENCY = 8000.0, 16, 12e-3
SWING, SAMPLES, JITTER, NOISE = 0.2 / (2 * np.pi), 90.0, 5e-3, 5e-5
BEGIN, END = 2.0, 2.8


def true(time: np.ndarray) -> np.ndarray:
    """Return where the finger is [m]: 1 Hz, 200 mm/s at most."""
    return np.asarray(SWING * np.sin(2 * np.pi * time))


def main() -> None:
    """Follow a finger, and draw."""
    rng = np.random.default_rng(1)
    taken = np.arange(0, END, 1 / SAMPLES)
    came = taken + np.abs(rng.normal(0, JITTER, len(taken)))
    told = true(taken) + rng.normal(0, NOISE, len(taken))
    order = np.argsort(came)
    clock, tracker, waiting = ClockMap(), ContactTracker(), list(order)
    times, places, plain = [], [], []
    newest = 0.0
    for now in np.arange(0.05, END - LATENCY, BLOCK / RATE):
        while waiting and came[waiting[0]] <= now:
            k = waiting.pop(0)
            arrival = float(came[k])
            when = clock(float(taken[k]) - 1000.0, arrival)  # its clock is another
            tracker.add(when, (float(told[k]), 0.0), 0.5, arrival=arrival)
            newest = float(told[k])
        put_out = now + LATENCY + np.arange(BLOCK) / RATE
        place, _ = tracker.at(put_out, float(now))
        times.append(put_out)
        places.append(place[:, 0])
        plain.append(np.full(BLOCK, newest))
    time, place, last = (np.concatenate(x) for x in (times, places, plain))
    inside = (time >= BEGIN) & (time < END - 2 * LATENCY)
    time, place, last = time[inside], place[inside], last[inside]
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(9, 5), sharex=True, height_ratios=(3, 2), constrained_layout=True
    )
    shown = (came >= BEGIN) & (came < time[-1])
    above.plot(time, 1e3 * true(time), color=GRAY, lw=4, alpha=0.4, label="finger")
    above.plot(came[shown], 1e3 * told[shown], ".", color=RED, label="samples, when they come")
    above.plot(time, 1e3 * place, color=BLUE, lw=1.2, label="place each block is rendered for")
    above.set_ylabel("place in mm")
    above.legend(loc="upper right")
    above.set_title("1 Hz, 200 mm/s; 90 samples a second, 5 ms jitter, 0.05 mm noise; 12 ms ahead")
    below.plot(time, 1e3 * (last - true(time)), color=RED, lw=1, label="newest sample")
    below.plot(time, 1e3 * (place - true(time)), color=BLUE, lw=1.2, label="tracked")
    below.set_ylabel("off the finger in mm")
    below.set_xlabel("time in s")
    below.legend(loc="upper right")
    figure.savefig(HERE / "tracking.png", dpi=110)


if __name__ == "__main__":
    main()
