"""Spectrum frames: the partials on a few carriers, for a link that is too narrow for samples.

A link plays Σ_p Re Z_p(t) exp 2πj f_p t per contactor: P carriers of fixed frequency f_p, each with
a complex envelope Z_p that is sent R times a second and interpolated linearly between frames. The
envelopes are computed from the partials, not from samples. Partial m sounds at f_m = k_m·v/2π; it
is conjugated where f_m < 0, so that a reversal changes envelopes only. On carrier p it is

    s_p(|f_m|) G(|f_m|) a_m exp j(k_m·(p + x_i) + φ_m) exp(−2πj f_p t),

with the inverse response G, the frame's sample time t, and the shares s of the carriers.

**Carriers** (`carrier_frequencies`). The lowest is 0 Hz: a finger at rest is then a constant, and a
partial that passes 0 Hz in a reversal does not jump. Carriers closer than 0.62 R carry everything
between them almost unchanged. There are too few for that everywhere. The highest sub-bands are
therefore third octaves, as wide as the skin's just noticeable difference of frequency (18–25 %,
Israr, Tan & Reed 2006), in the range where its detection threshold rises (by 30 dB from 250 Hz to 1
kHz), and all other carriers are spread evenly below. With 16 carriers at 50 Hz these are 31 Hz
apart up to 282 Hz, with six third octaves above. Fewer carriers stretch that pattern. Below 100 Hz,
where thresholds rise as well, nothing can be saved: what is narrower than the frame rate takes no
carrier of its own.

**Shares** (`shares`). A single carrier, whose envelope is linear between frames, plays a partial δ
off with images R apart: (2/3 + cos(2πδ/R)/3) of its power, and only a part of that, which shrinks
with δ, at its own frequency. The images of a partial fall on the same frequencies from every
carrier, so that neighbors can cancel them. The shares are the least-squares solution that leaves
least in the images, held near the partial's own carrier, then scaled to unit power, which for one
carrier is the known compensation. They change continuously with frequency, also across sub-band
edges. The texture's envelope makes sidebands of a partial that is not a grating's, at f_m ± v·q for
its waves q; these take the shares of their place, with all waves of the envelope at their rms
frequency and to first order in its logarithm.

**Limits**. A sum of carriers never exceeds Σ|Z_p|, and between frames it stays below the larger of
its ends. Frames are turned down, all contactors alike, until that sum holds the voltage limit and
its slope the slew: no clamp ever acts, at the price of 1–2 dB less than a limiter of samples
allows. The same sum bounds the travel of a tip without a finger (`free_tip`). Since the envelope
moves what a carrier plays away from it, each carrier counts with the largest response in air within
R of it.

**Not carried** are sparse events and streamed waveforms, which are not partials; `python -m
benchmarks spectrum` tells what textures with events lose by it. Friction (`skin_stretch`) is not
carried either: it has a memory of the path, which frames, each computed from the present state of
the finger, do not have. On a link of frames no texture stretches the skin.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile.arrays import Complex, Floats
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.rendering import equalizer
from tactile.rendering.free_tip import travel_voltage
from tactile.rendering.limiter import RELEASE
from tactile.rendering.renderer import FASTEST
from tactile.rendering.shear import Law
from tactile.rendering.stroke import FARTHEST, RESTING_SPEED
from tactile.texture.surface import Texture, envelope_scale

HIGHEST = 1e3 * 10**0.05
"""Upper end of the third octave at 1 kHz and of the last sub-band [Hz]; what is above, rolled off,
is played with it."""
THIRD = 10**0.1
"""Frequency ratio of a third octave (base ten)."""
RESOLVED = 0.62
"""Distance of carriers that leaves a partial's images 25–40 dB down, as a fraction of the frame
rate."""
STRETCHED = 0.8
"""The same distance if carriers are too few; third octaves are widened with it."""
FIRST = 0.6
"""Frequency of the first carrier above 0 Hz, as a fraction of the distance of carriers: there is no
carrier below 0 Hz to help."""
FASTEST_STROKE = 0.25
"""Speed up to which a texture's highest partial has a carrier nearby (assumed) [m/s]."""
CLOSEST = 0.4
"""Distance below which another carrier adds nothing, as a fraction of the frame rate."""
IMAGES = 30
"""Number of images on either side of a partial that shares are fitted to."""
RIDGE, AFAR = 0.1, 4.0
"""Weight in the fit of what other carriers take, and how fast it grows with a sub-band's
distance."""
ROUNDING = 10 ** (0.125 / 20)
"""Factor by which the wire may round an amplitude up: half a step of 0.25 dB."""
NEAR = 41
"""Number of frequencies around each carrier at which the response in air is computed."""
MOST = 64
"""Largest number of carriers that the protocol allows."""
SLOWEST = 20.0
"""Lowest frame rate that the protocol allows [Hz]."""


def carrier_frequencies(count: int, frame_rate: float, highest: float = HIGHEST) -> Floats:
    """Compute the frequencies of carriers.

    The result has as few third octaves below ``highest`` as leave the band below them resolved with
    even steps. If there are too few carriers for any such number, it is a stretched pattern of
    both.

    Parameters
    ----------
    count : int
        Number of carriers, P.
    frame_rate : float
        Frame rate R [Hz].
    highest : float
        Upper end of the last sub-band [Hz].

    Returns
    -------
    (P,) array of float
        Frequencies, ascending from 0 [Hz].
    """
    for thirds in range(count - 1):
        steps, end = _steps(count - thirds)
        distance = highest * THIRD**-thirds / end
        if distance <= RESOLVED * frame_rate:
            centers = highest * THIRD ** -(np.arange(thirds)[::-1] + 0.5)
            return np.concatenate([steps * distance, centers])
    f = np.linspace(0, highest, 4096)
    density = 1 / np.maximum(STRETCHED * frame_rate, f * (THIRD**0.5 - THIRD**-0.5))
    passed = np.concatenate([[0], np.cumsum(density[1:] + density[:-1])])
    steps, end = _steps(count)
    return np.asarray(np.interp(steps / end * passed[-1], passed, f))


def band_carriers(
    carriers: int, frame_rate: float, sample_rate: float, highest: float = HIGHEST
) -> Floats:
    """Compute the carriers of a band, on the frequency grid of the link.

    Parameters
    ----------
    carriers : int
        Largest number of carriers; a band that needs fewer gets fewer.
    frame_rate : float
        Frame rate R [Hz].
    sample_rate : float
        Sample rate of the amplifier [Hz].
    highest : float
        Upper end of the band [Hz].

    Returns
    -------
    (P,) array of float
        Frequencies, whole multiples of sample_rate/2³² [Hz].
    """
    count = min(carriers, max(1, int(highest / (CLOSEST * frame_rate) + 0.5)))
    exact = carrier_frequencies(count, frame_rate, highest)
    return np.asarray(np.rint(exact / sample_rate * 2**32) * (sample_rate / 2**32))


def _steps(count: int) -> tuple[Floats, float]:
    """Return even places from 0, the first step shorter, and the end of the last one's sub-band."""
    return np.append(0.0, np.arange(count - 1) + FIRST), max(count - 1.5 + FIRST, 0.5)


def shares(frequency: Floats, carriers: Floats, frame_rate: float) -> Floats:
    """Compute how much of a partial each carrier takes.

    Parameters
    ----------
    frequency : (F,) array of float
        Frequencies of partials [Hz].
    carriers : (P,) array of float
        Frequencies of carriers, ascending [Hz].
    frame_rate : float
        Frame rate R [Hz].

    Returns
    -------
    (F, P) array of float
        Shares s that minimize Σ_k |Σ_p s_p sinc²(δ_p + k) − [k = 0]|² + Σ_p λ_p (s_p − o_p)² with
        δ_p = (f − f_p)/R, where o is 1 for the partial's own carrier (with a transition at edges)
        and λ_p grows with the distance from sub-band p, scaled so that what is played has the power
        of the partial. The images of frames joined by linear ramps have the spectrum sinc². On a
        carrier, and at 0 Hz, only the own carrier has a share.
    """
    offset = (frequency[:, None] - carriers) / frame_rate
    edges = (carriers[1:] + carriers[:-1]) / 2
    low = (np.append(-np.inf, edges) - frequency[:, None]) / frame_rate
    high = (frequency[:, None] - np.append(edges, np.inf)) / frame_rate
    outside = np.maximum(low, high)
    own = np.clip(0.5 - 4 * outside, 0, 1)
    lines = np.sinc(offset[..., None] + np.arange(-IMAGES, IMAGES + 1)) ** 2
    cost = RIDGE * (1 + AFAR * np.maximum(outside, 0) ** 2)
    normal = lines @ lines.transpose(0, 2, 1) + cost[:, :, None] * np.eye(len(carriers))
    right = lines[:, :, IMAGES] + cost * own
    fitted = np.linalg.solve(normal, right[..., None])
    power = ((fitted.transpose(0, 2, 1) @ lines) ** 2).sum(axis=(1, 2))
    return np.asarray(fitted[..., 0] / np.sqrt(power)[:, None])


def _table(
    display: Display, carriers: Floats, frame_rate: float, sample_rate: float
) -> NDArray[np.complex64]:
    """Return what carriers play of a partial of unit shear at −`STOP_BAND` … `STOP_BAND` Hz.

    Parameters
    ----------
    display : Display
        Display to play on.
    carriers : (P,) array of float
        Frequencies of carriers [Hz].
    frame_rate : float
        Frame rate R [Hz].
    sample_rate : float
        Sample rate of the amplifier [Hz].

    Returns
    -------
    (L, C, F, P) array of complex
        Share × roll-off × inverse response per force and kind, in steps of 1 Hz [V/m]. A lossy
        response has a phase down to 0 Hz, whose sign would jump in a reversal; the imaginary part
        is faded out below 10 Hz.
    """
    frequency = np.arange(-equalizer.STOP_BAND, equalizer.STOP_BAND + 1)
    response = display.responses(np.abs(frequency), sample_rate)
    gain = equalizer.inverse(response, display.limits.voltage)
    gain = gain.real + 1j * np.clip(frequency / equalizer.GRID, -1, 1) * gain.imag
    weight = equalizer.roll_off(frequency)[:, None] * shares(frequency, carriers, frame_rate)
    return (gain[..., None] * weight).astype(np.complex64)


def _check(carriers: int, frame_rate: float, sample_rate: float) -> None:
    """Raise InputError for rates or a number of carriers that the protocol does not allow."""
    if not 1 <= carriers <= MOST:
        raise InputError(f"carriers {carriers}: must be 1 … {MOST}")
    if not equalizer.LOWEST_RATE <= sample_rate <= FASTEST:
        raise InputError(
            f"sample_rate {sample_rate:g} Hz: must be {equalizer.LOWEST_RATE:g} … {FASTEST:g} Hz"
        )
    if not SLOWEST <= frame_rate <= sample_rate:
        raise InputError(f"frame_rate {frame_rate:g} Hz: must be {SLOWEST:g} … {sample_rate:g} Hz")


class FrameLimiter:
    """Turns frames down until the sum of their carriers holds the limits, and slowly up again.

    Parameters
    ----------
    display : Display
        Display whose limits to hold.
    carriers : (P,) array of float
        Frequencies of carriers [Hz].
    frame_rate : float
        Frame rate R [Hz].
    sample_rate : float
        Sample rate of the amplifier [Hz].

    Attributes
    ----------
    limited_frames : int
        Number of frames that were turned down.
    """

    def __init__(
        self, display: Display, carriers: Floats, frame_rate: float, sample_rate: float
    ) -> None:
        voltage = min(display.limits.voltage, display.slew / (4 * frame_rate)) / ROUNDING
        slope = display.slew - 2 * voltage * frame_rate
        near = np.abs(carriers[:, None] + frame_rate * np.linspace(-1, 1, NEAR))
        swinging = travel_voltage(display, near.ravel(), sample_rate).reshape(near.shape)
        self._limits = np.stack(
            [
                np.full(len(carriers), 1 / voltage),
                2 * np.pi * carriers * ROUNDING / slope,
                ROUNDING / swinging.min(axis=1),
            ],
            axis=1,
        )
        self._held, self._let_go = 0.0, np.exp(-1 / (RELEASE * frame_rate))
        self.limited_frames = 0

    def __call__(self, envelope: Complex) -> Complex:
        """Return envelopes (N, P) [V] scaled to hold the limits."""
        over = (np.abs(envelope) @ self._limits).max(initial=0.0)
        self._held = max(1 - 1 / max(over, 1.0), self._held * self._let_go)
        if self._held < 1e-6:
            return envelope
        self.limited_frames += 1
        return envelope * (1 - self._held)


class SpectrumRenderer:
    """Renders one texture on one display, frame by frame in step with the finger.

    Parameters
    ----------
    display : Display
        Display to render for.
    texture : Texture
        Texture to render.
    carriers : int
        Largest number of carriers; a texture whose band needs fewer gets fewer.
    frame_rate : float
        Frame rate R, rounded so that the sample rate is a multiple of it [Hz].
    sample_rate : float
        Sample rate of the amplifier [Hz].
    seed : int
        Seed of the surface's realization, as in `Renderer`.
    whole_band : bool
        Whether to use the carriers of the whole band, so that several textures can be added.

    Attributes
    ----------
    carriers : (P,) array of float
        Frequencies of the carriers, whole multiples of sample_rate/2³² [Hz].
    spacing : int
        Distance from frame to frame [samples].
    sample : int
        Position of the next frame, counted from 0; may be set [samples].
    limiter : FrameLimiter
        Limiter that the envelopes leave through.
    invalid_frames : int
        Number of frames for which the finger's data were not finite or out of range; the last valid
        position is held, without force.

    Raises
    ------
    InputError
        If the number of carriers or a rate is out of range.
    """

    def __init__(
        self,
        display: Display,
        texture: Texture,
        *,
        carriers: int = 16,
        frame_rate: float = 100.0,
        sample_rate: float = 8000.0,
        seed: int = 0,
        whole_band: bool = False,
    ) -> None:
        _check(carriers, frame_rate, sample_rate)
        surface = texture.realize(seed)
        self._display, self._waves = display, surface.partials
        self._law, self._envelope = Law(texture.descriptor), surface.envelope
        self._bands = len(self._waves.amplitude) - surface.gratings
        self.spacing = round(sample_rate / frame_rate)
        self._rate = rate = sample_rate / self.spacing
        sizes = np.linalg.norm(self._waves.wave_vector, axis=1) / (2 * np.pi)
        highest = min(HIGHEST, sizes.max(initial=0.0) * FASTEST_STROKE * THIRD**0.5)
        self.carriers = band_carriers(
            carriers, rate, sample_rate, HIGHEST if whole_band else highest
        )
        self._increments = np.rint(self.carriers / sample_rate * 2**32).astype(np.uint64)
        self._table = _table(display, self.carriers, rate, sample_rate)
        self._at = self._waves.phasors(display.contactors).astype(np.complex64)
        self._at_envelope = self._envelope.phasors(display.contactors)
        self._kinds = [np.flatnonzero(display.kind == c) for c in range(self._table.shape[1])]
        self.limiter = FrameLimiter(display, self.carriers, rate, sample_rate)
        self._last = np.zeros(2)
        self.sample = self.invalid_frames = 0

    def frame(self, position: ArrayLike, velocity: ArrayLike, normal_force: float) -> Complex:
        """Compute the envelopes at the time of the next frame.

        Parameters
        ----------
        position : (2,) array_like of float
            Position of the finger at that time [m].
        velocity : (2,) array_like of float
            Velocity of the finger at that time [m/s].
        normal_force : float
            Normal force at that time [N].

        Returns
        -------
        (N, P) array of complex
            Envelopes within the limits, contactors in the display's order [V].
        """
        return self.limiter(self.unlimited(position, velocity, normal_force))

    @property
    def limited_frames(self) -> int:
        """Number of frames that were turned down."""
        return self.limiter.limited_frames

    def unlimited(self, position: ArrayLike, velocity: ArrayLike, normal_force: float) -> Complex:
        """Compute the envelopes of the next frame before the limiter.

        Callers that add the frames of several textures limit the sum.

        Parameters
        ----------
        position : (2,) array_like of float
            Position of the finger at the frame's time [m].
        velocity : (2,) array_like of float
            Velocity of the finger at that time [m/s].
        normal_force : float
            Normal force at that time [N].

        Returns
        -------
        (N, P) array of complex
            Envelopes, contactors in the display's order [V].
        """
        place, v = np.asarray(position, np.float64), np.asarray(velocity, np.float64)
        force = float(normal_force)
        if not np.abs([*place, *v, force]).max() < FARTHEST:
            place, v, force = self._last, np.zeros(2), 0.0
            self.invalid_frames += 1
        self._last = place
        envelope = self._carried(place, v, force)
        turns = (self._increments * np.uint64(self.sample % 2**32)) % 2**32 / 2**32
        envelope *= np.exp(-2j * np.pi * turns)
        self.sample += self.spacing
        return envelope

    def _carried(self, place: Floats, velocity: Floats, force: float) -> Complex:
        """Return the sums (N, P) [V] of partials on carriers, with all carriers at phase 0."""
        signed = self._waves.wave_vector @ velocity / (2 * np.pi)
        sign = np.where(signed < 0, -1.0, 1.0)
        turn = np.exp(1j * sign * (self._waves.wave_vector @ place)).astype(np.complex64)
        at = np.where(sign[:, None] < 0, self._at.conj(), self._at)
        rise, even, odd, offset = self._rise(place, velocity)
        sides = (0.0, offset, -offset) if offset else (0.0,)
        table = [self._played(np.abs(signed) + side, force) for side in sides]
        total = np.empty((at.shape[1], len(self.carriers)), np.complex128)
        bands = self._bands
        for kind, members in enumerate(self._kinds):
            waves = at[:, members].T * turn
            plain, *pair = [waves[:, :bands] @ played[kind, :bands] for played in table]
            total[members] = plain
            if pair:
                both, difference = pair[0] + pair[1] - 2 * plain, pair[0] - pair[1]
                total[members] += even[members, None] * both + odd[members, None] * difference
            total[members] *= rise[members, None]
            total[members] += waves[:, bands:] @ table[0][kind, bands:]
        return total * self._factor(velocity, force)[:, None]

    def _played(self, frequency: Floats, force: float) -> NDArray[np.complex64]:
        """Return (C, M, P) of the table at frequencies (M,) [Hz] and a normal force [N]."""
        last = self._table.shape[2] - 1
        held = np.clip(frequency + last // 2, 0, last - 1e-3)
        index = held.astype(np.intp)
        part = (held - index).astype(np.float32)[:, None]
        forces = self._display.load_forces
        load = float(np.interp(force, forces, np.arange(len(forces))))
        played = np.zeros((self._table.shape[1], len(index), self._table.shape[3]), np.complex64)
        for k in {int(load), math.ceil(load)}:
            table = self._table[k]
            lower = table[:, index]
            played += (lower + (table[:, index + 1] - lower) * part) * np.float32(1 - abs(load - k))
        return played

    def _factor(self, velocity: Floats, force: float) -> Floats:
        """Return the factor of each contactor (N,): laws, axis and polarity."""
        law = self._law(np.array([velocity @ velocity]), np.array([force]))
        factor = law * self._display.polarity
        if self._display.projected:
            factor *= self._display.shear_axes @ velocity / math.hypot(*velocity, RESTING_SPEED)
        return np.asarray(factor)

    def _rise(self, place: Floats, velocity: Floats) -> tuple[Floats, Floats, Complex, float]:
        """Return the envelope at each contactor, which multiplies everything but gratings.

        Returns
        -------
        rise : (N,) array of float
            Present value.
        even, odd : (N,) array of float and of complex
            Coefficients of its course over time, 1 + even (e₊ + e₋ − 2) + odd (e₊ − e₋) with e± =
            exp(±2πj offset t), to first order in its logarithm.
        offset : float
            Frequency of its sidebands [Hz].
        """
        slow, signed = self._envelope, self._envelope.wave_vector @ velocity
        log = np.exp(1j * (slow.wave_vector @ place))[:, None] * self._at_envelope
        now, growth = log.sum(axis=0).real, (1j * signed @ log).real
        mean_square = np.sum(slow.amplitude**2) / 2
        omega = math.sqrt(np.sum((slow.amplitude * signed) ** 2) / max(2 * mean_square, 1e-12))
        rise = envelope_scale(slow) * np.exp(now)
        return rise, now / 2, growth / (2j * max(omega, 1e-12)), omega / (2 * np.pi)
