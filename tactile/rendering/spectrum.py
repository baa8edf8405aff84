"""Spectrum frames: what the partials are on a few carriers, for a link too narrow for samples.

A link plays Σ_p Re Z_p(t) exp 2πj f_p t per contactor: P carriers of fixed frequency f_p, each with
a complex envelope Z_p that is sent R times a second and runs straight from frame to frame. The
envelopes come from the partials, not from samples. Partial m sounds at f_m = k_m·v/2π; conjugated
where f_m < 0, so that a reversal changes envelopes only, it is on carrier p

    s_p(|f_m|) G(|f_m|) a_m exp j(k_m·(p + x_i) + φ_m) exp(−2πj f_p t),

with G the inverse response, t the frame's sample time, and s the shares of the carriers.

**Carriers** (`carrier_frequencies`). The lowest is 0 Hz: a finger at rest is then a constant, and a
partial that passes 0 Hz in a reversal does not jump. Carriers closer than 0.62 R carry whatever is
between them almost as it is. There are too few for that everywhere, so the highest sub-bands are
third octaves, as wide as the skin's just noticeable difference of frequency (18–25 %, Israr & Tan
2006), where its detection threshold rises (from 250 Hz to 1 kHz by 30 dB), and all other carriers
go, evenly, to what is below. With 16 at 50 Hz that is 31 Hz apart up to 282 Hz and six third
octaves. Fewer carriers stretch that pattern. Below 100 Hz, where thresholds rise as well, there is
nothing to save: what is narrower than the frame rate takes no carrier of its own.

**Shares** (`shares`). One carrier alone, its envelope straight between frames, plays a partial δ
off with images R apart: (2/3 + cos(2πδ/R)/3) of its power, and that shrinking part in its place.
Images of one partial fall on the same frequencies from every carrier, so its neighbors can cancel
them: shares are the least-squares solution that leaves least in the images, held near the
partial's own carrier, then scaled to unit power, which for one carrier is the known
compensation. They change continuously with frequency, sub-band edges included. The texture's own
envelope makes sidebands of a partial, unless it is a grating's, at f_m ± v·q for its waves q; they
take the shares of their place, all its waves at their rms frequency and to first order in its
logarithm.

**Limits**. A sum of carriers never exceeds Σ|Z_p|, between frames no more than at the larger of its
ends. Frames are turned down, all contactors alike, until that holds the voltage limit and its
slope the slew: no clamp ever acts, at the price of 1–2 dB below what a limiter of samples allows.

**Not carried**: sparse events and streamed waveforms, which are no partials. `python -m
benchmarks spectrum` tells what textures with events lose by it. Nor friction (`skin_stretch`),
which has a memory of the way that frames, each made from where the finger is now, do not have: on
a link of frames no texture stretches the skin.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile.arrays import Complex, Floats
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.rendering import equalizer
from tactile.rendering.limiter import RELEASE
from tactile.rendering.renderer import FASTEST
from tactile.rendering.shear import Law
from tactile.rendering.stroke import FARTHEST, STILL
from tactile.texture.perception import detection_threshold
from tactile.texture.surface import Partials, Texture

HIGHEST = 1e3 * 10**0.05
"""Hz, end of the third octave at 1 kHz and of the last sub-band; the rest, rolled off, joins it."""
THIRD = 10**0.1
RESOLVED = 0.62
"""Of the frame rate, the distance of carriers that leaves a partial's images 25–40 dB down."""
STRETCHED = 0.8
"""The same where carriers are too few, and thirds become wider with it."""
FIRST = 0.6
"""Of that distance, where the first carrier above 0 Hz is: below 0 Hz none helps."""
FASTEST_STROKE = 0.25
"""m/s (assumed), up to which a texture's highest partial has a carrier nearby."""
CLOSEST = 0.4
"""Of the frame rate; carriers closer than that add nothing."""
IMAGES = 30
"""On either side of a partial that shares are fitted on."""
RIDGE, AFAR = 0.1, 4.0
"""Of the fit: what it costs to share, and how fast that grows with a sub-band's distance."""
ROUNDING = 10 ** (0.125 / 20)
"""By which the wire may round an amplitude up: half a step of 0.25 dB."""
MOST = 64
SLOWEST = 20.0
"""Carriers and frames a second that the protocol allows."""


def carrier_frequencies(count: int, frame_rate: float, highest: float = HIGHEST) -> Floats:
    """Return P ascending carrier frequencies [Hz], the first 0.

    As few third octaves below ``highest`` [Hz] as leave all below them resolved, evenly; where
    there are too few carriers for any such number, a stretched pattern of both.
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
    """Return (P,) carriers up to a frequency [Hz], whole multiples of sample_rate/2³².

    Fewer than asked for, where the band needs no more.
    """
    count = min(carriers, max(1, int(highest / (CLOSEST * frame_rate) + 0.5)))
    wanted = carrier_frequencies(count, frame_rate, highest)
    return np.asarray(np.rint(wanted / sample_rate * 2**32) * (sample_rate / 2**32))


def _steps(count: int) -> tuple[Floats, float]:
    """Return even places from 0, the first step shorter, and where the last's sub-band ends."""
    return np.append(0.0, np.arange(count - 1) + FIRST), max(count - 1.5 + FIRST, 0.5)


def shares(frequency: Floats, carriers: Floats, frame_rate: float) -> Floats:
    """Return how much of a partial each carrier takes, (F, P).

    Parameters
    ----------
    frequency : (F,) of partials [Hz]
    carriers : (P,) ascending [Hz]
    frame_rate : R [Hz]

    Returns
    -------
    (F, P) ndarray
        s that minimizes Σ_k |Σ_p s_p sinc²(δ_p + k) − [k = 0]|² + Σ_p λ_p (s_p − o_p)² with
        δ_p = (f − f_p)/R, o one for the own carrier (fading over at edges) and λ_p growing with
        the distance from sub-band p, scaled so that what is played has the partial's power.
        Frames joined by straight ramps have images with the spectrum sinc². On a carrier, and at
        0 Hz, it is the own carrier alone.
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
    wanted = lines[:, :, IMAGES] + cost * own
    fitted = np.linalg.solve(normal, wanted[..., None])
    power = ((fitted.transpose(0, 2, 1) @ lines) ** 2).sum(axis=(1, 2))
    return np.asarray(fitted[..., 0] / np.sqrt(power)[:, None])


def _phasors(partials: Partials, contactors: Floats) -> Complex:
    """Return a exp j(k·x + φ), (M, N)."""
    phase = partials.wave_vector @ contactors.T + partials.phase[:, None]
    return np.asarray(partials.amplitude[:, None] * np.exp(1j * phase))


def _table(
    display: Display, carriers: Floats, frame_rate: float, sample_rate: float
) -> NDArray[np.complex64]:
    """Return what carriers play of a partial of unit shear at −`STOP_BAND` … `STOP_BAND` Hz.

    Returns
    -------
    (L, C, F, P) complex ndarray
        Share × roll-off × inverse response [V/m] per force and kind, every hertz. A lossy
        response has a phase down to 0 Hz, where its sign would jump in a reversal: it fades out
        below 10 Hz.
    """
    frequency = np.arange(-equalizer.STOP_BAND, equalizer.STOP_BAND + 1)
    response = display.responses(np.abs(frequency), sample_rate)
    gain = equalizer.inverse(response, display.limits.voltage)
    gain = gain.real + 1j * np.clip(frequency / equalizer.GRID, -1, 1) * gain.imag
    weight = equalizer.roll_off(frequency)[:, None] * shares(frequency, carriers, frame_rate)
    return (gain[..., None] * weight).astype(np.complex64)


def _check(carriers: int, frame_rate: float, sample_rate: float) -> None:
    if not 1 <= carriers <= MOST:
        raise InputError(f"carriers {carriers}: must be 1 … {MOST}")
    if not equalizer.LOWEST_RATE <= sample_rate <= FASTEST:
        raise InputError(
            f"sample_rate {sample_rate:g} Hz: must be {equalizer.LOWEST_RATE:g} … {FASTEST:g} Hz"
        )
    if not SLOWEST <= frame_rate <= sample_rate:
        raise InputError(f"frame_rate {frame_rate:g} Hz: must be {SLOWEST:g} … {sample_rate:g} Hz")


class FrameLimiter:
    """Turns frames down until their carriers together hold the limits, and slowly up again.

    Parameters
    ----------
    display : whose limits
    carriers, frame_rate : of the frames [Hz]

    Attributes
    ----------
    limited_frames : frames that were turned down
    """

    def __init__(self, display: Display, carriers: Floats, frame_rate: float) -> None:
        voltage = min(display.limits.voltage, display.slew / (4 * frame_rate)) / ROUNDING
        slope = display.slew - 2 * voltage * frame_rate
        self._limits = np.stack(
            [np.full(len(carriers), 1 / voltage), 2 * np.pi * carriers * ROUNDING / slope], 1
        )
        self._held, self._let_go = 0.0, np.exp(-1 / (RELEASE * frame_rate))
        self.limited_frames = 0

    def __call__(self, envelope: Complex) -> Complex:
        """Return envelopes (N, P) [V] that hold the limits."""
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
    display, texture : what to render on, and what
    carriers : P; fewer where a texture's band needs no more
    frame_rate : R [Hz], of which the sample rate is a multiple
    sample_rate : of the amplifier [Hz]
    seed : of the surface's realization, as in `Renderer`
    whole_band : have the carriers of any texture, so that several may be added

    Attributes
    ----------
    carriers : (P,) frequencies [Hz], whole multiples of sample_rate/2³²
    spacing : samples from frame to frame
    sample : position of the next frame, from 0; may be set
    limiter : the `FrameLimiter` that envelopes leave through
    invalid_frames : frames whose finger was not finite or beyond reason; the last good place is
        held, without force

    Raises
    ------
    InputError
        Where carriers or rates are beyond reason.
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
        self._at = _phasors(self._waves, display.contactors).astype(np.complex64)
        self._at_envelope = _phasors(self._envelope, display.contactors)
        self._kinds = [np.flatnonzero(display.kind == c) for c in range(self._table.shape[1])]
        self.limiter = FrameLimiter(display, self.carriers, rate)
        self._last = np.zeros(2)
        self.sample = self.invalid_frames = 0

    def frame(self, position: ArrayLike, velocity: ArrayLike, normal_force: float) -> Complex:
        """Return the envelopes at the next frame's time.

        Parameters
        ----------
        position, velocity : (2,) of the finger then [m] and [m/s]
        normal_force : then [N]

        Returns
        -------
        (N, P) complex ndarray
            Volts, contactors in the display's order.
        """
        return self.limiter(self.unlimited(position, velocity, normal_force))

    @property
    def limited_frames(self) -> int:
        """Frames that were turned down."""
        return self.limiter.limited_frames

    def unlimited(self, position: ArrayLike, velocity: ArrayLike, normal_force: float) -> Complex:
        """Return what `frame` does before its limits, for who adds several and limits the sum."""
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
        """Return (N, P) sums of partials on carriers [V], carriers at phase 0."""
        signed = self._waves.wave_vector @ velocity / (2 * np.pi)
        sign = np.where(signed < 0, -1.0, 1.0)
        turn = np.exp(1j * sign * (self._waves.wave_vector @ place)).astype(np.complex64)
        at = np.where(sign[:, None] < 0, self._at.conj(), self._at)
        rise, even, odd, aside = self._rise(place, velocity)
        sides = (0.0, aside, -aside) if aside else (0.0,)
        table = [self._played(np.abs(signed) + side, force) for side in sides]
        found = np.empty((at.shape[1], len(self.carriers)), np.complex128)
        bands = self._bands
        for kind, members in enumerate(self._kinds):
            waves = at[:, members].T * turn
            plain, *pair = [waves[:, :bands] @ played[kind, :bands] for played in table]
            found[members] = plain
            if pair:
                both, apart = pair[0] + pair[1] - 2 * plain, pair[0] - pair[1]
                found[members] += even[members, None] * both + odd[members, None] * apart
            found[members] *= rise[members, None]
            found[members] += waves[:, bands:] @ table[0][kind, bands:]
        return found * self._factor(velocity, force)[:, None]

    def _played(self, frequency: Floats, force: float) -> NDArray[np.complex64]:
        """Return (C, M, P) of the table at frequencies (M,) [Hz] and a force [N]."""
        last = self._table.shape[2] - 1
        held = np.clip(frequency + last // 2, 0, last - 1e-3)
        index = held.astype(np.intp)
        part = (held - index).astype(np.float32)[:, None]
        forces = self._display.load_forces
        load = float(np.interp(force, forces, np.arange(len(forces))))
        found = np.zeros((self._table.shape[1], len(index), self._table.shape[3]), np.complex64)
        for k in {int(load), math.ceil(load)}:
            table = self._table[k]
            here = table[:, index]
            found += (here + (table[:, index + 1] - here) * part) * np.float32(1 - abs(load - k))
        return found

    def _factor(self, velocity: Floats, force: float) -> Floats:
        """Return what multiplies each contactor (N,): laws, axis and polarity."""
        law = self._law(np.array([velocity @ velocity]), np.array([force]))
        factor = law * self._display.polarity
        if self._display.projected:
            factor *= self._display.shear_axes @ velocity / math.hypot(*velocity, STILL)
        return np.asarray(factor)

    def _rise(self, place: Floats, velocity: Floats) -> tuple[Floats, Floats, Complex, float]:
        """Return the envelope at each contactor, which multiplies what is no grating.

        Returns
        -------
        rise : (N,) now
        even, odd, aside : (N,), (N,) and [Hz]; it goes on as 1 + even (e₊ + e₋ − 2) +
            odd (e₊ − e₋) with e± = exp(±2πj aside t), to first order in its logarithm
        """
        slow, signed = self._envelope, self._envelope.wave_vector @ velocity
        log = np.exp(1j * (slow.wave_vector @ place))[:, None] * self._at_envelope
        now, growth = log.sum(axis=0).real, (1j * signed @ log).real
        mean_square = np.sum(slow.amplitude**2) / 2
        omega = math.sqrt(np.sum((slow.amplitude * signed) ** 2) / max(2 * mean_square, 1e-12))
        rise = np.exp(now - mean_square)
        return rise, now / 2, growth / (2j * max(omega, 1e-12)), omega / (2 * np.pi)

    def sensation_level(self, velocity: ArrayLike, normal_force: float) -> Floats:
        """Return how far what each carrier plays is above detection, (P,) [dB].

        Where a link has room for few envelopes, those below 0 dB are the first to leave out: the
        power of a sub-band's partials, each relative to the threshold at its own frequency.
        """
        v = np.asarray(velocity, np.float64)
        frequency = np.abs(self._waves.wave_vector @ v) / (2 * np.pi)
        law = float(self._law(np.array([v @ v]), np.array([normal_force]))[0])
        felt = law * self._waves.amplitude / detection_threshold(frequency)
        share = shares(frequency, self.carriers, self._rate)
        power = (felt * equalizer.roll_off(frequency)) ** 2 @ share**2
        return np.asarray(10 * np.log10(np.maximum(power, 1e-12)))
