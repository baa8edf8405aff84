"""Guard: how soon an amplifier notices that a contactor has lost the finger, and what it costs.

The guard is the reference amplifier's own, in integers, with the entries that a host sends it for
the loads which it estimates from the windows. The plant is the finite-element plant of
`sensing_plant`. Gains act behind the interpolation of the drive, so that the delay of the plant's
interpolation is none of the amplifier's.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.sensing_loop import (
    CODE,
    FREQUENCY,
    RATE,
    WINDOW,
    Case,
    Loop,
    draw_case,
    steady,
    swinging,
)
from benchmarks.sensing_plant import Converter
from firmware_protocol import guard
from firmware_protocol.correlation import Correlator
from firmware_protocol.messages import FULL_SCALE_CODE, GUARD_BLOCK, GuardFlag, GuardReason
from tactile.actuator.finger import FingerLoad
from tactile.arrays import Floats
from tactile.bench.figures import Figure, at_most
from tactile.sensing.correlation import SumWindow
from tactile.sensing.estimator import CONSISTENT, Estimate
from tactile.sensing.guard import GuardDesign
from tactile.sensing.load_follower import GUARD_WINDOWS

FINGERS, CONTACTORS = 10, 24
"""Numbers of random fingers, and of contactors under each."""
LOSS = 0.005
"""Time in which a finger leaves a contactor [s]."""
WORST = 10.0
"""Longest time until a guard is to trip after a finger has begun to leave [ms]."""
AWAY = 0.02, 0.3
"""Times for which a finger is away from a contactor, shorter and longer than a guard holds it
down [s]."""
RETOUCHED = 0.2
"""Time after the finger has come back at which the level is judged [s]."""
TONE, DISPLACEMENT = 920.0, 2e-6
"""Frequency [Hz] and amplitude [m] of a tone near the resonance in air."""


class GuardedLoop(Loop):
    """A texture under several fingers, with guards in the amplifier.

    Parameters
    ----------
    case, converter : Case, Converter
        As in `Loop`.
    lift : (N,) array of float
        Time at which each contactor begins to lose the finger [s]; infinite for never.
    retouch : (N,) array of float, optional
        Time at which the finger begins to come back [s]; by default never.
    guarded : bool
        Whether a tripped guard turns the channel down.
    tone : bool
        Whether a tone plays instead of the texture.
    options : object
        Further parameters of `Loop`.

    Attributes
    ----------
    tripped : (N,) array of float
        Time at which each guard tripped [s]; NaN if it never did.
    reason : (N,) array of int
        Reason for which it did.
    commanded : (S, M) array of float
        Commanded displacement of the M contactors under a finger [m].
    largest : (N,) array of float
        Largest displacement of the tip after the finger began to leave [m].
    """

    def __init__(
        self,
        case: Case,
        converter: Converter,
        *,
        lift: Floats,
        retouch: Floats | None = None,
        guarded: bool = True,
        tone: bool = False,
        **options: object,
    ) -> None:
        super().__init__(case, converter, **options)  # type: ignore[arg-type]
        n = len(case.logarithms)
        if tone:
            time = np.arange(len(self._shear)) / RATE
            wave = DISPLACEMENT * np.sin(2 * np.pi * TONE * time)
            self._shear = np.repeat(wave[:, None], self._shear.shape[1], axis=1).astype(np.float32)
        self._lift, self._guarded, self.commanded = lift, guarded, self._shear
        self._retouch = np.full(n, np.inf) if retouch is None else retouch
        noise = converter.step * float(np.hypot(converter.noise, 1 / np.sqrt(12)))
        self._design = GuardDesign(case.baseline, RATE, noise=noise)
        self._unit = converter.range / FULL_SCALE_CODE
        self._guard, self._known = guard.ChannelGuards(n), Correlator(n)
        self._guard.start(round(RATE))
        self._late = np.zeros((self.plant.delay, n))
        self._gain = np.ones((1, n))
        self._held = np.zeros(n, np.intp)
        self._windows, self._armed = 0, np.zeros(n, np.bool_)
        self.tripped, self.reason = np.full(n, np.nan), np.zeros(n, np.int64)
        self.largest = np.zeros(n)

    def _window(self) -> SumWindow:
        """Return the window before the one that was played last.

        Estimators learn of the channels that tripped in that one. What was measured until then does
        not count any more.
        """
        held = self._guard.reasons != GuardReason.NONE
        self._held = np.where(held, self._held + 1, 0)
        if self._guarded:
            new = (self._held == 1).reshape(self.case.fingers, -1)
            for estimator, contactors in zip(self._estimators, new, strict=True):
                estimator.lift(contactors)
        window = super()._window()
        return replace(window, valid=window.valid & ~((self._held == 1) | (self._held == 2)))

    def _estimated(self, estimate: Estimate) -> None:
        """Send entries for the loads in the middle of the next windows.

        Each contactor gets one in one of `GUARD_WINDOWS` windows, and at once where its guard is
        armed, disarmed or released, as from the product's playback. A channel is released when the
        filter of the free bender has faded in.
        """
        loads = self._ahead(1.5 + GUARD_WINDOWS / 2)
        filters = self._design.filters(loads, estimate.capacitance)
        armed = estimate.touching & (estimate.inconsistency <= CONSISTENT)
        n, unit = len(armed), self._unit
        entries = guard.encode(
            armed * int(GuardFlag.ARMED) + (self._held > 2) * int(GuardFlag.RELEASE),
            poles=filters.poles,
            drive=filters.drive * CODE / unit, change=filters.change * CODE / unit,
            limit=filters.limit / unit, share=np.full(n, filters.share),
            floor=filters.floor / unit**2,
        )  # fmt: skip
        turn = (np.arange(n) + self._windows) % GUARD_WINDOWS == 0
        due = turn | (self._held > 2) | (armed != self._armed)
        self._windows, self._armed = self._windows + 1, armed
        for first in np.flatnonzero(due):
            self._guard.take(int(first), entries[first : first + 1])

    def _scale(self, first: int, samples: int) -> Floats:
        """Return the scale of the loads (S, N), 0 while a finger is away."""
        time = (first + np.arange(samples) - self.plant.delay + 1) / RATE
        left, back = (
            np.clip((time[:, None] - begin) / LOSS, 0, 1) for begin in (self._lift, self._retouch)
        )
        return super()._scale(first, samples) * (1 - left + back)

    def _put_out(self, begin: int, drive: Floats) -> tuple[Floats, Floats]:
        """Put out the drive of a window block by block, each with the gains of the guards."""
        played, currents, late = [], [], self.plant.delay
        for at in range(0, WINDOW, GUARD_BLOCK):
            block = drive[at : at + GUARD_BLOCK]
            moved = self._guard.move(GUARD_BLOCK, ramping=False)
            gain = moved / guard.FULL if self._guarded else np.ones_like(block)
            first = begin + at
            shear, current = self.plant.step(block, self._scale(first, GUARD_BLOCK), gain)
            played.append(self._judge(first, block, gain, current))
            self._measure(first, shear)
            currents.append(current)
        known = np.concatenate(played)  # up to what the interpolation still holds
        self._drive[-late:] = known[:late]
        self._voltage[-late:] = known[:late]  # since these benders have no hysteresis
        return np.concatenate([known[late:], drive[-late:]]), np.concatenate(currents)

    def _judge(self, first: int, drive: Floats, gain: Floats, current: Floats) -> Floats:
        """Let the guards judge a block; return what was played `delay` samples before it."""
        line, gains = np.concatenate([self._late, drive]), np.concatenate([self._gain, gain])
        self._late, self._gain = line[GUARD_BLOCK:], gains[GUARD_BLOCK:]
        played = np.asarray(line[:GUARD_BLOCK] * gains[:GUARD_BLOCK])
        codes, currents = (
            np.rint(values / unit).astype(np.int64)
            for values, unit in ((played, CODE), (current, self._unit))
        )
        self._known.add(first, codes, currents, 0)
        self._guard.add(self._known.currents, self._known.steps())
        new = np.isnan(self.tripped) & (self._guard.reasons != GuardReason.NONE)
        self.tripped[new] = (first + GUARD_BLOCK - self.plant.delay) / RATE
        self.reason[new] = self._guard.reasons[new]
        return played

    def _measure(self, first: int, shear: Floats) -> None:
        """Take note of the displacement of tips after the finger began to leave."""
        time = (first + np.arange(len(shear)) - self.plant.delay) / RATE
        after = time[:, None] >= self._lift
        self.largest = np.maximum(self.largest, np.where(after, np.abs(shear), 0).max(axis=0))

    @property
    def gain(self) -> Floats:
        """Present gains of the amplifier, (N,)."""
        return np.asarray(self._gain[-1])

    def play(self) -> "GuardedLoop":
        """Play to the end."""
        for _ in self.run():
            pass
        return self


def measure_guard() -> Iterator[Figure]:
    """Measure how soon guards trip, how often without reason, and the overshoot at lift-off."""
    converter = Converter()
    case = draw_case(FINGERS, CONTACTORS, converter, seed=7)
    n = FINGERS * CONTACTORS
    strokes = GuardedLoop(
        case, converter, lift=np.full(n, np.inf), force=swinging(1.5), seconds=3.0
    ).play()
    name = f"guard, {n * 3 // 60} min of strokes of a contactor, force 0.2–2 N: false trips"
    yield at_most(name, float(np.sum(~np.isnan(strokes.tripped))), "", 0)
    lift = 0.7 + 0.4 * np.random.default_rng(1).random(n)
    loop = GuardedLoop(case, converter, lift=lift, force=swinging(1.5), seconds=1.25).play()
    late = 1e3 * (loop.tripped - lift)
    within = late <= WORST
    yield Figure("guard, lift-off: median time until it trips", float(np.nanmedian(late)), "ms")
    yield at_most("guard, lift-off: worst", float(np.nanmax(late)), "ms", WORST)
    yield Figure("guard, lift-off: contactors within 10 ms", 100 * float(np.mean(within)), "%")
    rest = 1e6 * float(loop.largest[~within].max(initial=0))
    yield Figure("guard, lift-off: largest displacement of the others", rest, "µm")
    commanded = 1e6 * float(np.abs(loop.commanded).max())
    yield Figure("guard, lift-off: largest commanded displacement", commanded, "µm")
    yield from _retouch(case, converter)
    yield from _overshoot(converter)


def _retouch(case: Case, converter: Converter) -> Iterator[Figure]:
    """Yield how soon what is commanded is played again when fingers come back.

    An error is the level of what is played at `FREQUENCY`, with the gain of the guard.
    """
    n = len(case.logarithms)
    random = np.random.default_rng(2)
    for away in AWAY:
        lift = 0.6 + 0.05 * random.random(n)
        retouch = lift + away
        loop = GuardedLoop(case, converter, lift=lift, retouch=retouch, force=steady, seconds=1.4)
        errors = np.full((n, len(FREQUENCY)), np.nan)
        for moment in loop.run():
            new = np.isnan(errors[:, 0]) & (moment.time >= retouch + LOSS + RETOUCHED)
            level = moment.error + 20 * np.log10(loop.gain)[:, None]
            errors[new] = np.abs(level[new])
        name = f"guard, touched again after {1e3 * away:.0f} ms: p95 {RETOUCHED:g} s later"
        yield at_most(name, float(np.percentile(errors, 95)), "dB", 3.0)


def _overshoot(converter: Converter) -> Iterator[Figure]:
    """Yield the displacement of a tip that loses the finger while a tone near resonance plays."""
    case = draw_case(1, CONTACTORS, converter, seed=7)
    high = FingerLoad.high()
    ((k1, d1),) = high.branches
    constants = np.array([high.k0, high.d0, k1, d1], np.float64)
    loads = np.tile(np.log(constants), (CONTACTORS, 1))
    stiff = replace(case, logarithms=loads)
    lift = 0.7 + 0.1 * np.random.default_rng(1).random(CONTACTORS)
    for guarded in (True, False):
        name = "guard, 2 µm at 920 Hz under a high finger, largest displacement at lift-off"
        loop = GuardedLoop(
            stiff, converter, lift=lift, guarded=guarded, tone=True, force=steady, seconds=1.0
        ).play()
        largest = 1e6 * float(loop.largest.max())
        if guarded:
            yield at_most(name, largest, "µm", 60.0)
        else:
            yield Figure(f"{name}, without a guard", largest, "µm")
