"""Estimates of an amplifier's clock compared with simpler ones, over modeled links in virtual time.

Every estimator receives the same exchanges. An error is the difference between the estimate and the
clock at random instants from 20 s after the first exchange on, over all runs together.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Protocol

import numpy as np

from firmware_protocol.clock import ClockEstimator, Exchange
from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_most, seconds

Delay = Callable[[np.random.Generator, float], float]
"""Function that returns the time that a packet takes [s] if it is sent at a host time [s]."""

TICK_HZ = 1e6
"""Nominal frequency of the amplifier's clock [Hz]."""
DRIFT_PPM = 30.0
"""Deviation of the amplifier's clock from its nominal frequency [ppm]."""
HOLD = 20e-6
"""Time from reception to answer in the amplifier (assumed) [s]."""
DURATION = 120.0
"""Duration of a run [s]."""
SETTLED = 20.0
"""Time from which on errors count [s]."""
SEEDS = range(8)
"""Seeds of the runs."""

MICROFRAME, FRAME = 125e-6, 1e-3
"""Intervals of USB high speed and full speed (USB 2.0, 8.4.3) [s]."""
CAN_BIT = 1e-6
"""Duration of a bit on the CAN bus [s]."""
CAN_FRAME_BITS = 111
"""Bits of a CAN frame of 8 data bytes and an 11-bit identifier, before stuffing (ISO 11898-1).

The gap after the frame is included.
"""
CAN_STUFF_BITS = 24
"""Largest number of stuff bits (Davis et al., Controller Area Network schedulability analysis,
2007)."""
CAN_LOAD = 0.5
"""Share of the time for which other nodes hold the bus (assumed)."""
TIME_FRAMES, REPLY_FRAMES = 3, 5
"""CAN frames of TIME (16 bytes) and TIME_REPLY (32 bytes): 7 bytes each, and 2 bytes for the
length."""


@dataclass(frozen=True)
class LinkDelays:
    """Delays of a link out and back, and the known part of either that the host subtracts [s]."""

    out: Delay
    back: Delay
    known: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class DriftingClock:
    """Clock of an amplifier that reads `start` ticks at host time 0."""

    drift_ppm: float = DRIFT_PPM
    start: int = 123_456_789

    def ticks(self, host_time: float) -> int:
        """Return the reading of the clock at a host time [s]."""
        return self.start + math.floor(host_time * (1 + self.drift_ppm * 1e-6) * TICK_HZ)


def jittery(rng: np.random.Generator, _: float) -> float:
    """Return a delay of 150 µs plus 100 µs, exponential; 3 % are 3 ms longer, also exponential [s].

    The numbers are the benchmark's own.
    """
    spike = rng.exponential(3e-3) if rng.random() < 0.03 else 0.0
    return 150e-6 + rng.exponential(100e-6) + spike


def polled(interval: float, rng: np.random.Generator, _: float) -> float:
    """Return a delay of 100 µs for host and driver (assumed) plus a wait for a poll [s]."""
    return 100e-6 + rng.uniform(0, interval)


def over_can(frames: int, rng: np.random.Generator, sent: float) -> float:
    """Return the delay of USB high speed to an adapter and of frames on a 1 Mbit/s CAN bus [s].

    Each frame is stuffed according to its data, and waits for the rest of a frame that it finds on
    the bus; arbitration among waiting frames is left out. The host wakes up late by 30 µs,
    exponential (assumed).
    """
    longest = CAN_FRAME_BITS + CAN_STUFF_BITS
    bits = rng.uniform(CAN_FRAME_BITS, longest, frames)
    blocked = (rng.random(frames) < CAN_LOAD) * rng.uniform(0, longest, frames)
    wire = float(np.sum(bits + blocked)) * CAN_BIT
    return polled(MICROFRAME, rng, sent) + rng.exponential(30e-6) + wire


def in_step(rng: np.random.Generator, sent: float) -> float:
    """Return a delay until the next full-speed frame of a clock 1 ppm off (assumed) [s]."""
    return 100e-6 + rng.exponential(10e-6) + FRAME - (sent * (1 + 1e-6)) % FRAME


def timed_out(latency: float, rng: np.random.Generator, sent: float) -> float:
    """Return the delay of full speed after FTDI's latency timer [s].

    The timer runs freely while nothing is received. According to FTDI AN232B-04, fewer than 62
    bytes wait until it ends. Its crystal is 40 ppm off (assumed).
    """
    wait = latency - (sent * (1 + 40e-6)) % latency
    return wait + polled(FRAME, rng, sent)


def can_usb(frames: int) -> LinkDelays:
    """Return a CAN link by the number of frames of TIME; the known delay leaves out stuffing."""
    known = frames * CAN_FRAME_BITS * CAN_BIT, REPLY_FRAMES * CAN_FRAME_BITS * CAN_BIT
    return LinkDelays(partial(over_can, frames), partial(over_can, REPLY_FRAMES), known)


def ftdi(latency: float) -> LinkDelays:
    """Return an FTDI serial adapter by its latency timer [s], without the time on the wire."""
    return LinkDelays(partial(polled, FRAME), partial(timed_out, latency))


LINKS: dict[str, LinkDelays] = {
    "jitter": LinkDelays(jittery, jittery),
    "can_usb": can_usb(TIME_FRAMES),
    "can_usb_padded": can_usb(REPLY_FRAMES),
    "usb_full_speed": LinkDelays(partial(polled, FRAME), partial(polled, FRAME)),
    "usb_in_step": LinkDelays(in_step, partial(polled, FRAME)),
    "ftdi_1ms": ftdi(1e-3),
    "ftdi_16ms": ftdi(16e-3),
}
"""Modeled links by name."""
LIMITS_US = {"jitter": 20.0, "can_usb": 50.0, "can_usb_padded": 50.0}
"""Largest permitted spread of the error on a link [µs]."""


class Estimator(Protocol):
    """Interface of the estimators that are compared."""

    def add(self, t1: float, t2: int, t3: int, t4: float) -> object:
        """Add an exchange."""

    def ticks_at(self, host_time: float) -> int:
        """Return the estimated reading of the clock at a host time [s]."""


class LastSample:
    """Estimator by the middle of the last exchange, at the nominal rate."""

    def __init__(self) -> None:
        self.samples: list[tuple[float, float, float]] = []
        self.time = self.seconds = 0.0
        self.rate = 1.0

    def add(self, t1: float, t2: int, t3: int, t4: float) -> None:
        """Store (round trip, host time, amplifier's time) [s], and update the estimate."""
        e = Exchange(t1, t2, t3, t4)
        self.samples.append((e.round_trip(TICK_HZ), (t1 + t4) / 2, (t2 + t3) / 2 / TICK_HZ))
        self.choose()

    def choose(self) -> None:
        """Use the last exchange."""
        _, self.time, self.seconds = self.samples[-1]

    def ticks_at(self, host_time: float) -> int:
        """Return the estimated reading of the clock at a host time [s]."""
        return round((self.seconds + self.rate * (host_time - self.time)) * TICK_HZ)


class ShortestTrip(LastSample):
    """Estimator by the shortest round trip of the last 8 (Cristian 1989), at the nominal rate."""

    def choose(self) -> None:
        """Use the exchange with the shortest round trip."""
        _, self.time, self.seconds = min(self.samples[-8:])


class LeastSquares(LastSample):
    """Estimator by a line through the middles of the last 64 exchanges."""

    def choose(self) -> None:
        """Fit the line."""
        _, t, u = np.array(self.samples[-64:]).T
        self.time, self.seconds = float(t.mean()), float(u.mean())
        if len(t) > 1:
            self.rate = float(np.dot(t - self.time, u) / np.sum((t - self.time) ** 2))


class Regression(LastSample):
    """Estimator by an exponential regression of gain 1/12 on the shortest trips of the last 8.

    It follows Klipper's clocksync. Its initial time variance of 1 s² holds the rate at the
    beginning.
    """

    GAIN = 1 / 12
    """Gain of the regression."""

    def __init__(self) -> None:
        super().__init__()
        self.fed: list[tuple[float, float, float]] = []
        self.variance, self.covariance = 1.0, 1.0

    def choose(self) -> None:
        """Feed the shortest round trip, unless it was the last to be fed."""
        shortest = min(self.samples[-8:])
        if self.fed and shortest == self.fed[-1]:
            return
        self.fed.append(shortest)
        gain = max(self.GAIN, 1 / len(self.fed))
        dt, du = shortest[1] - self.time, shortest[2] - self.seconds
        self.time += gain * dt
        self.seconds += gain * du
        if len(self.fed) > 1:
            self.variance = (1 - gain) * (self.variance + gain * dt * dt)
            self.covariance = (1 - gain) * (self.covariance + gain * dt * du)
            self.rate = self.covariance / self.variance


ESTIMATORS: dict[str, Callable[[], Estimator]] = {
    "error": partial(ClockEstimator, TICK_HZ),
    "regression": Regression,
    "shortest_of_8": ShortestTrip,
    "least_squares_64": LeastSquares,
    "last": LastSample,
}
"""Estimators by name; "error" is the project's own."""


def exchanges(
    link: LinkDelays, clock: DriftingClock, rng: np.random.Generator, interval: float | None = None
) -> Iterator[Exchange]:
    """Yield the exchanges that the host sees from host time 100 s on.

    The host probes when the estimator requests it, or at a fixed interval [s] if one is given.
    """
    schedule = ClockEstimator(TICK_HZ)
    now = 100.0
    end = now + DURATION
    while now < end:
        schedule.probe_due(now)
        due = schedule.next_probe if interval is None else now + interval
        received = now + link.out(rng, now)
        sent = received + HOLD
        arrived = sent + link.back(rng, sent)
        yield Exchange(
            now + link.known[0], clock.ticks(received), clock.ticks(sent), arrived - link.known[1]
        )
        now = max(arrived, due)


def followed(estimator: Estimator, seen: list[Exchange], clock: DriftingClock, seed: int) -> Floats:
    """Return (time since the first exchange, error) [s] at 4 random instants per exchange."""
    rng = np.random.default_rng(seed)
    errors: list[tuple[float, float]] = []
    for e, following in pairwise(seen):
        estimator.add(e.t1, e.t2, e.t3, e.t4)
        for instant in rng.uniform(e.t4, max(e.t4, following.t4), 4):
            off = estimator.ticks_at(float(instant)) - clock.ticks(float(instant))
            errors.append((float(instant) - seen[0].t1, off / TICK_HZ))
    return np.array(errors)


def trial(
    link: LinkDelays, estimator: Callable[[], Estimator], interval: float | None = None
) -> Floats:
    """Return (time, error) [s] for all seeds."""
    clock, runs = DriftingClock(), []
    for seed in SEEDS:
        seen = list(exchanges(link, clock, np.random.default_rng(seed), interval))
        runs.append(followed(estimator(), seen, clock, seed))
    return np.concatenate(runs)


def settled(found: Floats) -> Floats:
    """Return the errors after the estimate has settled [µs]."""
    return np.asarray(found[found[:, 0] >= SETTLED, 1] * 1e6)


def measure_clock() -> Iterator[Figure]:
    """Measure the estimates of a clock that is 30 ppm off, over every link, by every estimator."""
    for link, delays in LINKS.items():
        for name, estimator in ESTIMATORS.items():
            errors = trial(delays, estimator)
            error = settled(errors)
            limit = LIMITS_US.get(link) if name == "error" else None
            yield at_most(f"clock.{link}.{name}", float(error.std()), "µs", limit)
            yield Figure(f"clock.{link}.{name}.bias", float(error.mean()), "µs")
            yield Figure(f"clock.{link}.{name}.at_first", _at_first(errors), "µs")
    error = settled(trial(LINKS["usb_in_step"], ESTIMATORS["error"], 0.25))
    yield Figure("clock.usb_in_step.probed_each_250ms.bias", float(error.mean()), "µs")
    yield Figure("clock.add", _cost() * 1e6, "µs")


def _at_first(found: Floats) -> float:
    """Return the root mean square of the errors after the first 8 exchanges, within 5 s [µs]."""
    early = found[(found[:, 0] > 0.3) & (found[:, 0] < 5), 1]
    return float(np.sqrt(np.mean(early**2))) * 1e6


def _cost() -> float:
    """Return the processing time of an exchange [s]."""
    seen = list(exchanges(LINKS["jitter"], DriftingClock(), np.random.default_rng(0)))

    def feed() -> None:
        estimator = ClockEstimator(TICK_HZ)
        for e in seen:
            estimator.add(e.t1, e.t2, e.t3, e.t4)

    return seconds(feed) / len(seen)
