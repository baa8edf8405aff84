"""Contact tracking: a finger's samples over a bad link, and the accuracy of the tracked position.

Clients stamp their samples with a clock of their own. Delays are not negative, and keep the order,
as over a WebSocket: "jitter" is the absolute value of a normal deviate of 5 ms rms, "heavy" a
normal deviate of mean 10 ms and standard deviation 5 ms, cut at zero, and "even" is uniform up to
5 ms. Samples have white noise of 0.05 mm rms per axis. Positions are requested 12 ms ahead, in
blocks of 16 at 8 kHz. Errors are distances in the plane, from the beginning of a path to its end.

There are two bounds. A genie knows position, velocity and acceleration exactly at the newest sample
that has arrived, and extrapolates by them: what it misses could not be known from any sample. The
blind part of the slide is what anybody misses who lets a resting finger rest and a steady one
continue until a sample has arrived that is off by two σ of its noise (which noise alone causes for
one sample in seven); from this sample on they are taken to be exactly right.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfilt

from tactile.arrays import Floats
from tactile.bench.figures import RATE, Figure, at_least, at_most, not_measured
from tactile.display.display import load_display
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.texture.surface import load_texture
from tactile.tracking.clock_map import ClockMap
from tactile.tracking.finger_motion import MotionFilter, Numbers, Pair, Stillness
from tactile.tracking.finger_sample import FingerSample
from tactile.tracking.tracker import ContactTracker

BLOCK = 16
"""Number of samples of a block."""
LATENCY = 0.012
"""Time ahead for which positions are requested [s]."""
GOAL = 0.3
"""Largest permitted rms error [mm]."""
GRATING = 1e-3
"""Wavelength of the grating [m]."""
BRAKES = 2.24 / 2.496
"""Part of the slide after which it is no longer steady."""
LEAD = 1.5
"""Duration of samples before a path begins, in which clock map and noise estimate settle [s]."""
FORCE = 0.5
"""Normal force [N]."""
SLIDE = Path(__file__).parents[2] / "shared" / "data" / "paths" / "slide.csv"
"""Path of the recorded slide."""
DELAYS: dict[str, Callable[[np.random.Generator, int], Floats]] = {
    "jitter": lambda rng, n: np.abs(rng.normal(0, 0.005, n)),
    "heavy": lambda rng, n: np.maximum(rng.normal(0.010, 0.005, n), 0),
    "even": lambda rng, n: rng.uniform(0, 0.005, n),
    "none": lambda rng, n: np.zeros(n),
}
"""Functions that return delays of a number of samples [s], by name."""

Place = Callable[[Floats], Floats]
"""Function from times (S,) [s] to positions (S, 2) [m]."""


@dataclass(frozen=True)
class SamplingClient:
    """Properties of a client that takes and sends samples.

    Attributes
    ----------
    rate : float
        Sample rate [Hz].
    noise : float
        Noise per axis [m].
    delay : str
        Name of `DELAYS`.
    stamped : bool
        Whether samples carry the client's time.
    velocity : bool
        Whether samples carry velocity, with noise of 5 mm/s.
    loss : float
        Share of samples that never arrive.
    """

    rate: float = 90.0
    noise: float = 5e-5
    delay: str = "jitter"
    stamped: bool = True
    velocity: bool = False
    loss: float = 0.0


@dataclass(frozen=True)
class FingerPath:
    """A path over the surface from time 0 on; before, the finger moves as at its beginning."""

    place: Place
    duration: float


def recorded(speed: float = 1.0) -> FingerPath:
    """Return the recorded slide at a multiple of its own speed, which is 40 mm/s over 91 mm."""
    slide = Trajectory.from_csv(SLIDE)
    return FingerPath(
        lambda t: slide.at(np.clip(t * speed, 0, slide.duration))[0], slide.duration / speed
    )


def sine(duration: float = 4.0) -> FingerPath:
    """Return 1 Hz back and forth, with a peak of 200 mm/s, which turns at the beginning."""
    return FingerPath(lambda t: _along_x(0.2 / (2 * np.pi) * np.cos(2 * np.pi * t)), duration)


def line(speed: float, duration: float = 5.0) -> FingerPath:
    """Return a straight stroke that has been going on."""
    return FingerPath(lambda t: _along_x(speed * t), duration)


def _along_x(x: Floats) -> Floats:
    return np.column_stack([x, 0 * x])


@dataclass(frozen=True)
class SampleStream:
    """Samples as they arrive: the client's times, positions, velocities and arrivals."""

    time: Floats
    place: Floats
    velocity: Floats
    arrival: Floats


def sampled(stroke: FingerPath, client: SamplingClient, seed: int) -> SampleStream:
    """Return a client's samples of a stroke, from `LEAD` before it."""
    rng = np.random.default_rng(seed)
    time = np.arange(-LEAD, stroke.duration, 1 / client.rate) + rng.uniform(0, 1 / client.rate)
    time = time[rng.uniform(size=len(time)) >= client.loss]
    place = stroke.place(time) + rng.normal(0, client.noise, (len(time), 2))
    pace = (stroke.place(time + 1e-4) - stroke.place(time - 1e-4)) / 2e-4
    pace += rng.normal(0, 0.005, pace.shape)
    arrival = np.maximum.accumulate(time + DELAYS[client.delay](rng, len(time)))
    return SampleStream(time, place, pace, arrival)


def tracked(
    stroke: FingerPath,
    client: SamplingClient,
    seed: int = 0,
    *,
    tracker: ContactTracker | None = None,
    block: int = BLOCK,
) -> tuple[Floats, Floats, Floats]:
    """Return times (S,), positions (S, 2) and forces (S,) from the tracker, from time 0 on."""
    samples, tracker, clock = sampled(stroke, client, seed), tracker or ContactTracker(), ClockMap()
    now = float(samples.arrival[0])
    ahead = LATENCY + np.arange(block) / RATE
    parts, k = [], 0
    while now + LATENCY < stroke.duration:
        while k < len(samples.time) and samples.arrival[k] <= now:
            arrival = float(samples.arrival[k])
            stamp = float(samples.time[k]) + 77.0 if client.stamped else None
            vx, vy = samples.velocity[k].tolist()
            pace = (vx, vy) if client.velocity else None
            x, y = samples.place[k].tolist()
            tracker.add(FingerSample(clock(stamp, arrival), arrival, x, y, FORCE, pace))
            k += 1
        times = now + ahead
        parts.append((times, *tracker.at(times, now)))
        now += block / RATE
    times, place, force = (np.concatenate(side) for side in zip(*parts, strict=True))
    begun = times >= 0
    return times[begun], place[begun], force[begun]


def misses(
    stroke: FingerPath,
    client: SamplingClient,
    seeds: int,
    make: Callable[[], ContactTracker] = ContactTracker,
) -> Floats:
    """Return the error of the tracked position (S,) for several streams [mm]."""
    errors = []
    for seed in range(seeds):
        times, place, _ = tracked(stroke, client, seed, tracker=make())
        errors.append(np.hypot(*(place - stroke.place(times)).T) * 1e3)
    return np.concatenate(errors)


def genie(stroke: FingerPath, client: SamplingClient, seeds: int) -> Floats:
    """Return the error (S,) of a genie that knows the newest sample's motion exactly [mm]."""
    errors, h = [], 2e-3
    for seed in range(seeds):
        samples = sampled(stroke, client, seed)
        now = np.arange(-LATENCY, stroke.duration - LATENCY, BLOCK / RATE)
        time = samples.time[np.searchsorted(samples.arrival, now, side="right") - 1]
        before, here, after = (stroke.place(time + d) for d in (-h, 0, h))
        ahead = (now + LATENCY - time)[:, None]
        bend = (after - 2 * here + before) / h**2 * ahead**2 / 2
        guess = here + (after - before) / (2 * h) * ahead + bend
        errors.append(np.hypot(*(guess - stroke.place(now + LATENCY)).T) * 1e3)
    return np.concatenate(errors)


def blind(stroke: FingerPath, client: SamplingClient, seeds: int) -> Floats:
    """Return the unavoidable error (S,) at the slide's onset and end [mm]."""
    errors = []
    brakes, step = BRAKES * stroke.duration, 0.04 * stroke.duration
    first, there, before = (stroke.place(np.array([t])) for t in (0.0, brakes, brakes - step))

    def off(times: Floats) -> Floats:
        steady = there + (there - before) * ((times - brakes) / step)[:, None]
        early = (times < stroke.duration / 2)[:, None]
        return np.asarray(np.hypot(*(np.where(early, first, steady) - stroke.place(times)).T))

    for seed in range(seeds):
        samples = sampled(stroke, client, seed)
        now = np.arange(-LATENCY, stroke.duration - LATENCY, BLOCK / RATE)
        seen = samples.time[np.searchsorted(samples.arrival, now, side="right") - 1]
        then = now + LATENCY
        knows = (seen >= 0) & (off(seen) > 2 * client.noise)
        knows |= (seen > 0.25 * stroke.duration) & (seen < brakes)
        knows |= (then > 0.25 * stroke.duration) & (then < brakes)
        errors.append(np.where(knows, 0.0, off(then)) * 1e3)
    return np.concatenate(errors)


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def grating_power(place: Floats, true: Floats) -> float:
    """Return the share of a 1 mm grating's power that is within 10 % of its frequency.

    ``place`` and ``true`` are positions along one axis (S,) [m], the true ones ascending. The
    spectrum is taken over the true position, which for a steady stroke is proportional to time.
    """
    even = np.arange(true[0], true[-1], 1e-5)
    waves = np.sin(2 * np.pi / GRATING * np.interp(even, true, place))
    power = np.abs(np.fft.rfft(waves * np.hanning(len(waves)))) ** 2
    ratio = np.fft.rfftfreq(len(waves), 1e-5) * GRATING
    return float(power[np.abs(ratio - 1) <= 0.1].sum() / power.sum())


class Held(ContactTracker):
    """Tracker without prediction: the filtered position of the newest sample."""

    def _course(self) -> Numbers:
        return [*super()._course()[:2], 0.0, 0.0, 0.0, 0.0]


class Smoothed(MotionFilter):
    """LaViola's double exponential smoothing (2003); a factor of 0.6 is the best compromise."""

    FACTOR = 0.6
    """Smoothing factor."""

    def begin(self, time: float, x: float, y: float, velocity: Pair | None = None) -> None:
        """Begin at rest at a position."""
        super().begin(time, x, y, velocity)
        self._once = self._twice = np.array([x, y])
        self._step = 0.011

    def add(
        self, time: float, x: float, y: float, velocity: Pair | None = None, samples: int = 1
    ) -> None:
        """Add a sample."""
        self.noise.add(time, x, y, samples)
        a = self.FACTOR
        self._step += (time - self.time - self._step) / 20
        self._once = a * np.array([x, y]) + (1 - a) * self._once
        self._twice = a * self._once + (1 - a) * self._twice
        slope = a / (1 - a) * (self._once - self._twice) / self._step
        self.state = [*(2 * self._once - self._twice).tolist(), *slope.tolist(), 0.0, 0.0]
        self.time = time


class Fitted(MotionFilter):
    """Line or parabola through the last few samples."""

    def __init__(self, size: int, degree: int) -> None:
        super().__init__()
        self._size, self._degree, self._points = size, degree, list[tuple[float, float, float]]()

    def begin(self, time: float, x: float, y: float, velocity: Pair | None = None) -> None:
        """Begin at rest at a position."""
        super().begin(time, x, y, velocity)
        self._points = [(time, x, y)]

    def add(
        self, time: float, x: float, y: float, velocity: Pair | None = None, samples: int = 1
    ) -> None:
        """Add a sample."""
        self.noise.add(time, x, y, samples)
        self._points = [*self._points, (time, x, y)][-self._size :]
        points = np.array(self._points)
        powers = np.vander(points[:, 0] - time, self._degree + 1, increasing=True)
        state = np.zeros((3, 2))
        fit = np.linalg.lstsq(powers, points[:, 1:], rcond=None)[0]
        state[: self._degree + 1] = fit * np.array([1.0, 1.0, 2.0])[: self._degree + 1, None]
        self.state, self.time = state.ravel().tolist(), time


RIVALS: dict[str, Callable[[], MotionFilter]] = {
    "three_filters": MotionFilter,
    "kalman_0.1": lambda: MotionFilter((0.1, 0.1, 0.1)),
    "kalman_1": lambda: MotionFilter((1.0, 1.0, 1.0)),
    "kalman_10": lambda: MotionFilter((10.0, 10.0, 10.0)),
    "double_exponential": Smoothed,
    "line_through_6": lambda: Fitted(6, 1),
    "parabola_through_6": lambda: Fitted(6, 2),
}
"""Filters that are compared, by name."""


def strokes() -> dict[str, tuple[FingerPath, int]]:
    """Return the paths that are judged, with the number of streams; recorded ones if available."""
    paths = {"sine": (sine(), 4)}
    if SLIDE.exists():
        paths |= {"slide_1x": (recorded(), 4), "slide_5x": (recorded(5.0), 20)}
    return paths


def _spread(name: str, found: Floats) -> Iterator[Figure]:
    yield Figure(f"{name}.p99", float(np.percentile(found, 99)), "mm")
    yield Figure(f"{name}.max", float(found.max()), "mm")


def measure_errors() -> Iterator[Figure]:
    """Measure the position's error with and without prediction, and for other clients."""
    plain = SamplingClient()
    others = {
        "heavy_jitter": replace(plain, delay="heavy"),
        "even_jitter": replace(plain, delay="even"),
        "stamped_on_arrival": replace(plain, stamped=False),
        "velocity_given": replace(plain, velocity=True),
        "loss_30": replace(plain, loss=0.3),
        "30_hz": replace(plain, rate=30.0),
        "1000_hz": replace(plain, rate=1000.0),
    }
    for name, (stroke, seeds) in strokes().items():
        errors = misses(stroke, plain, seeds)
        yield at_most(f"tracking.{name}.rms", rms(errors), "mm", GOAL)
        yield from _spread(f"tracking.{name}", errors)
        known = genie(stroke, plain, seeds)
        yield Figure(f"tracking.{name}.genie.rms", rms(known), "mm")
        yield from _spread(f"tracking.{name}.genie", known)
        if name.startswith("slide"):
            missed = blind(stroke, plain, seeds)
            yield Figure(f"tracking.{name}.blind.rms", rms(missed), "mm")
            yield from _spread(f"tracking.{name}.blind", missed)
        for other, client in others.items():
            errors = misses(stroke, client, seeds)
            yield Figure(f"tracking.{name}.{other}.rms", rms(errors), "mm")
            yield from _spread(f"tracking.{name}.{other}", errors)
        held = misses(stroke, plain, seeds, Held)
        yield Figure(f"tracking.{name}.not_predicted.rms", rms(held), "mm")
        yield from _spread(f"tracking.{name}.not_predicted", held)


def _with(make: Callable[[], MotionFilter]) -> ContactTracker:
    return ContactTracker(motion=make())


def measure_rivals() -> Iterator[Figure]:
    """Measure other filters in the same tracker."""
    paths = strokes() | {"line": (line(0.08), 2)}
    for rival, make in RIVALS.items():
        for name, (stroke, seeds) in paths.items():
            errors = misses(stroke, SamplingClient(), seeds, partial(_with, make))
            yield Figure(f"tracking.rivals.{name}.{rival}.rms", rms(errors), "mm")


def measure_gratings() -> Iterator[Figure]:
    """Measure a slide over a 1 mm grating, at 80 mm/s and as recorded."""
    steady = line(0.08)
    for name, client in (
        ("", SamplingClient()),
        (".heavy_jitter", SamplingClient(delay="heavy")),
        (".stamped_on_arrival", SamplingClient(stamped=False)),
    ):
        for end, make in (("", ContactTracker), (".not_predicted", Held)):
            shares = []
            for seed in range(4):
                times, place, _ = tracked(steady, client, seed, tracker=make())
                shares.append(grating_power(place[:, 0], steady.place(times)[:, 0]))
            label = f"tracking.grating_80{name}{end}"
            if name or end:
                yield Figure(label, 100 * min(shares), "%")
            else:
                yield at_least(label, 100 * min(shares), "%", 90)
    if not SLIDE.exists():
        yield not_measured("tracking.grating_slide", f"needs the recording {SLIDE.name}")
    else:
        slide = recorded()
        for end, make in (("", ContactTracker), (".not_predicted", Held)):
            times, place, _ = tracked(slide, SamplingClient(), tracker=make())
            true = slide.place(times)[:, 1 if np.ptp(slide.place(times)[:, 1]) > 0.05 else 0]
            inside = (times > 0.3) & (times < 2.2) & (np.gradient(true) > 0)
            axis = 1 if np.ptp(place[:, 1]) > 0.05 else 0
            part = 100 * grating_power(place[inside, axis], true[inside])
            label = f"tracking.grating_slide{end}"
            yield Figure(label, part, "%") if end else at_least(label, part, "%", 90)


def played(
    stroke: FingerPath, client: SamplingClient, *, seed: int = 0, still: bool = True
) -> float:
    """Return the rms of the commanded shear of wood above 5 Hz, without the first 1 s [m]."""
    renderer = Renderer(load_display("reference-24"), load_texture("wood-oak"), sample_rate=RATE)
    _, place, force = tracked(
        stroke, client, seed, tracker=ContactTracker() if still else restless()
    )
    shear = [
        renderer.block(place[k : k + BLOCK], force[k : k + BLOCK], shear=True)[1]
        for k in range(0, len(place), BLOCK)
    ]
    sections = butter(2, 5, "highpass", fs=RATE, output="sos")
    return rms(sosfilt(sections, np.concatenate(shear), axis=0)[round(RATE) :])


class Restless(Stillness):
    """Detector that never takes a finger as resting, to show what noise does without it."""

    def add(self, time: float, x: float, y: float, variance: float) -> None:
        """Ignore a sample."""


def restless() -> ContactTracker:
    """Return a tracker without the dead band."""
    tracker = ContactTracker()
    tracker._stillness = Restless()
    return tracker


def measure_rest() -> Iterator[Figure]:
    """Compare the commanded shear under a resting finger with that under a sliding one."""
    slides, client = played(line(0.08, 6.0), SamplingClient()), SamplingClient()
    for name, still in (("rest", True), ("rest.without_dead_band", False)):
        rests = played(line(0.0, 6.0), client, still=still)
        level = 20 * np.log10(max(rests / slides, 1e-10))
        label = f"tracking.{name}.against_80"
        yield at_most(label, float(level), "dB", -40) if still else Figure(label, level, "dB")
    times, place, _ = tracked(line(0.0, 20.0), client)
    yield Figure("tracking.rest.wander", float(np.ptp(place[times > 1], axis=0).max()) * 1e6, "µm")
    for speed in (0.0005, 0.001, 0.002, 0.005):
        times, place, _ = tracked(line(speed, 10.0), client)
        stands = np.mean(np.hypot(*np.diff(place, axis=0).T) * RATE < 1e-6)
        yield Figure(f"tracking.slow_{speed * 1e3:g}_mm_s.stands", 100 * float(stands), "% of time")


def measure_cost() -> Iterator[Figure]:
    """Time `at` and `add` while a finger slides.

    The 10th percentile of the calls is taken, since machines are shared. The mean of `at` is over
    blocks with and without a new sample.
    """
    ahead, stopwatch = LATENCY + np.arange(BLOCK) / RATE, time.perf_counter
    for rate in (90, 1000):
        tracker, sent = ContactTracker(), 0
        spent: dict[str, list[float]] = {"add": [], "at": [], "at.no_sample": []}
        for block in range(2000):
            now = block * BLOCK / RATE
            kind = "at.no_sample"
            while sent / rate <= now:
                moment, kind = sent / rate, "at"
                begun = stopwatch()
                tracker.add(FingerSample(moment, moment, 0.08 * moment, 0.0, FORCE))
                spent["add"].append(stopwatch() - begun)
                sent += 1
            begun = stopwatch()
            tracker.at(now + ahead, now)
            spent[kind].append(stopwatch() - begun)
        name = f"tracking.cost.{rate}_hz"
        cost = {kind: 1e6 * float(np.percentile(v, 10)) for kind, v in spent.items() if v}
        calls = {kind: len(spent[kind]) for kind in cost if kind != "add"}
        mean = sum(cost[kind] * calls[kind] for kind in calls) / sum(calls.values())
        yield at_most(f"{name}.add", cost["add"], "µs", 20)
        yield at_most(f"{name}.at.mean", mean, "µs", 60)
        yield Figure(f"{name}.at.with_sample", cost["at"], "µs")
        if "at.no_sample" in cost:
            yield Figure(f"{name}.at.without_sample", cost["at.no_sample"], "µs")


def measure_tracking() -> Iterator[Figure]:
    """Measure errors, rival filters, gratings, rest and cost."""
    yield from measure_errors()
    yield from measure_rivals()
    yield from measure_gratings()
    yield from measure_rest()
    yield from measure_cost()
