"""How strong a texture is on a display: felt level, drive, and the gain that the limits allow.

Levels come in closed form from the texture's lines (`commanded`) and what the display makes of
them: the inverse filter in use times the response of amplifier and loaded bimorph. What the limits
take is measured instead, in a trial: short strokes at `PLACES` places, for a texture's envelope and
the beating of its waves vary over centimeters. They are rendered so faintly that no limit is near;
all before the limiter is linear, so that this drive, scaled, is that of any gain.

A limiter that touches one sample is seconds in letting go (`limiter.RELEASE`), so that "at most
1e-4 of samples" means not at all in any stroke of some seconds. `automatic_gain` therefore lets the
trial's highest drive come up to `HEADROOM` below the limit. No finite trial knows the highest peak
of an endless stroke: beyond it the limiter turns down, gently and rarely.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.rendering.contact import LARGEST_FORCE, LARGEST_SPEED
from tactile.rendering.limiter import Limiter
from tactile.rendering.renderer import Renderer
from tactile.rendering.shear import CONTACT_FORCE
from tactile.rendering.skin_stretch import STROKE_SHARE
from tactile.strength.commanded import LineSpectrum, commanded_lines
from tactile.texture import perception
from tactile.texture.surface import GOLDEN, Texture, without_friction

PLACES = 32
"""Where a trial strokes, spread over `SPREAD`."""
STROKED = 0.25
"""s of each stroke of a trial."""
SETTLING = 0.02
"""s before each that are left out: the finger has jumped there, and the filter fills."""
SPREAD = 10.0
"""m in x and y, many times the longest wave of an envelope or a beat."""
TAPER = 5e-3
"""s in which one place's drive gives way to the next's."""
HEADROOM = 10 ** (-3.5 / 20)
"""By which half a minute's highest drive may be above a trial's: bursts are rare and high. Measured
at 80 mm/s on calf, suede, ABS and oak, 24 contactors: −0.5 … 3.1 dB above it."""
FAINT = 1e-3
"""Gain of the trial."""
GRID = 5.0
HIGHEST = 4000.0
"""Hz between and up to which a display's reach is told."""


@dataclass(frozen=True)
class SteadyStroke:
    """A steady stroke in a straight line.

    Attributes
    ----------
    speed : [m/s]
    normal_force : [N]
    angle : of the motion, from the x axis [rad]

    Raises
    ------
    InputError
        Where nothing would move, or nothing be touched.
    """

    speed: float = 0.08
    normal_force: float = 0.5
    angle: float = 0.0

    def __post_init__(self) -> None:
        if not 0 < self.speed <= LARGEST_SPEED:
            raise InputError(
                f"speed {self.speed:g} m/s: must be above 0 and at most {LARGEST_SPEED:g} m/s: "
                "a finger at rest feels no texture"
            )
        if not CONTACT_FORCE < self.normal_force <= LARGEST_FORCE:
            raise InputError(
                f"normal_force {self.normal_force:g} N: must be above {CONTACT_FORCE:g} "
                f"and at most {LARGEST_FORCE:g} N"
            )

    @property
    def direction(self) -> Floats:
        """Unit vector (2,) of the motion."""
        return np.array([np.cos(self.angle), np.sin(self.angle)])

    def lines(self, texture: Texture) -> LineSpectrum:
        """Return what a texture commands in it."""
        return commanded_lines(
            texture, speed=self.speed, normal_force=self.normal_force, angle=self.angle
        )


@dataclass(frozen=True)
class Reach:
    """What a display makes of commanded shear, per kind of contactor, at one normal force.

    Attributes
    ----------
    frequency : (F,) [Hz], ascending
    gain : (C, F) drive per commanded shear [V/m]
    transfer : (C, F) shear that comes of it, per commanded shear: one where the inverse is not
        bounded
    attainable : (C, F) peak shear [m] of a sinusoid at the voltage and slew limits
    share : (C,) mean square over all contactors of what of the shear each plays, by kind: where it
        is projected on the motion, its cosine
    """

    frequency: Floats
    gain: Floats
    transfer: Floats
    attainable: Floats
    share: Floats

    def delivered(self, lines: LineSpectrum) -> LineSpectrum:
        """Return the spectrum that the skin gets below the limits, mean over contactors."""
        square = self.share @ self.transfer**2
        at = np.interp(lines.frequency, self.frequency, square, right=0.0)
        return LineSpectrum(lines.frequency, lines.power * at)

    def drive_rms(self, lines: LineSpectrum) -> float:
        """Return the drive below the limits, over all contactors [V]."""
        return float(np.sqrt(self.cost(lines.frequency) @ lines.power))

    def cost(self, frequency: Floats) -> Floats:
        """Return the mean square of drive per mean square of shear at frequencies [V²/m²]."""
        square = self.share @ self.gain**2
        return np.asarray(np.interp(frequency, self.frequency, square, right=0.0))

    def least_attainable(self, frequency: Floats) -> Floats:
        """Return the peak shear [m] that every contactor attains, at frequencies [Hz]."""
        return np.asarray(np.interp(frequency, self.frequency, self.attainable.min(axis=0)))


def reach(display: Display, stroke: SteadyStroke, sample_rate: float = 8000.0) -> Reach:
    """Return what a display makes of shear in a stroke.

    Parameters
    ----------
    display, stroke : what is played on, and how it is touched
    sample_rate : of the drive [Hz]
    """
    frequency = np.arange(0.0, min(HIGHEST, sample_rate / 2) + GRID / 2, GRID)
    here = replace(display, load=display.load_at(stroke.normal_force))
    response = np.abs(here.responses(frequency, sample_rate)[0])
    inverse = Renderer(display, None, sample_rate=sample_rate).filter
    place = np.interp(stroke.normal_force, display.load_forces, np.arange(len(inverse.taps)))
    near = np.maximum(1 - np.abs(place - np.arange(len(inverse.taps))), 0)
    taps = inverse.mix @ np.tensordot(near, inverse.taps, axes=1)
    turns = np.exp(-2j * np.pi / sample_rate * np.outer(np.arange(taps.shape[1]), frequency))
    gain = np.abs(taps @ turns)
    steepest = 2 * sample_rate * np.sin(np.pi * np.minimum(frequency / sample_rate, 0.5))
    volts = np.minimum(display.limits.voltage, display.slew / np.maximum(steepest, 1e-9))
    cosine = np.ones(len(display.kind))
    if display.projected:
        cosine = np.abs(display.shear_axes @ stroke.direction)
    kinds = [display.kind == c for c in range(len(gain))]
    share = np.array([np.sum(cosine[kind] ** 2) / len(cosine) for kind in kinds])
    return Reach(frequency, gain, gain * response, response * volts, share)


def amplified(texture: Texture, gain: float) -> Texture:
    """Return a texture with all of its displacement multiplied.

    The levels in its descriptor's ``[stochastic]`` stay what they were; its waves have the gain.

    Raises
    ------
    InputError
        Where the gain is negative or no number.
    """
    if not 0 <= gain < np.inf:
        raise InputError(f"gain {gain:g}: must be a number from 0")
    d = texture.descriptor
    periodic = tuple(
        structs.replace(p, harmonics_um=tuple(gain * h for h in p.harmonics_um)) for p in d.periodic
    )
    events = tuple(structs.replace(e, amplitude_um=gain * e.amplitude_um) for e in d.events)
    return replace(
        texture,
        amplitude=gain * texture.amplitude,
        descriptor=structs.replace(d, periodic=periodic, events=events),
    )


@dataclass(frozen=True)
class Trial:
    """The drive of short strokes at gain 1, without limits.

    Attributes
    ----------
    display : on which
    drive : (K, S, N) of K strokes, without friction [V]
    sample_rate : [Hz]
    room : of the voltage limit, what friction leaves
    """

    display: Display
    drive: Floats
    sample_rate: float
    room: float = 1.0

    @property
    def rms(self) -> float:
        """Over all contactors [V]."""
        return float(np.sqrt(np.mean(self.drive**2)))

    @property
    def peak(self) -> float:
        """Over all contactors [V]."""
        return float(np.abs(self.drive).max())

    @property
    def step(self) -> float:
        """Largest change from sample to sample [V]."""
        return float(np.abs(np.diff(self.drive, axis=1)).max())

    @property
    def largest_gain(self) -> tuple[float, str]:
        """The gain at which a limit is met, and the limit's name; infinite for no drive."""
        limits = self.display.limits
        slewing = "slew" if self.display.slew >= limits.slew else "current"
        by_voltage = self.room * limits.voltage / max(self.peak, 1e-30)
        by_slew = self.display.slew / self.sample_rate / max(self.step, 1e-30)
        return (by_voltage, "voltage") if by_voltage <= by_slew else (by_slew, slewing)

    def limited(self, gain: float) -> tuple[float, float]:
        """Return the share of samples that the limiter turns down, and what is left of the rms."""
        places, count, channels = self.drive.shape
        limiter = Limiter(
            self.room * self.display.limits.voltage, self.display.slew / self.sample_rate,
            sample_rate=self.sample_rate, channels=channels,
        )  # fmt: skip
        from_end = np.minimum(np.arange(count), np.arange(count)[::-1]) / self.sample_rate
        taper = np.sin(np.pi / 2 * np.minimum(from_end / TAPER, 1)) ** 2
        wanted = gain * (self.drive * taper[:, None]).reshape(-1, channels)
        rest = np.zeros((limiter.delay, channels))
        played = limiter(np.concatenate([wanted, rest]))[limiter.delay :]
        kept = np.sqrt(np.mean(played**2) / max(float(np.mean(wanted**2)), 1e-30))
        return min(limiter.limited_samples / (places * count), 1.0), float(min(kept, 1.0))


def trial(
    display: Display, texture: Texture, stroke: SteadyStroke, sample_rate: float = 8000.0
) -> Trial:
    """Render short strokes far below the limits, and return their drive at gain 1.

    Friction, which is bent to keep to its share of the drive, has that share kept free.
    """
    faint = amplified(without_friction(texture), FAINT)
    renderer = Renderer(display, faint, sample_rate=sample_rate)
    settling, count = round(SETTLING * sample_rate), round(STROKED * sample_rate)
    along = np.outer(np.arange(settling + count) * stroke.speed / sample_rate, stroke.direction)
    start = SPREAD * (np.outer(np.arange(PLACES), [GOLDEN, GOLDEN**0.5]) % 1)
    place = (start[:, None] + along).reshape(-1, 2)
    drive = renderer.block(place, np.full(len(place), stroke.normal_force))
    strokes = drive.reshape(PLACES, settling + count, -1)[:, settling:]
    room = 1.0 if texture.descriptor.friction is None else 1.0 - STROKE_SHARE
    return Trial(display, strokes / FAINT, sample_rate, room)


@dataclass(frozen=True)
class Gain:
    """A gain, and what it comes to.

    Attributes
    ----------
    value : to multiply a texture by (`amplified`, or `Renderer.play`)
    limit : what forbids more: "voltage", "slew", "current", or "level" for one that was asked for
    level : of the channel that feels most [dB SL]
    channel : that one
    drive_rms, drive_peak : over all contactors [V]
    """

    value: float
    limit: str
    level: float
    channel: str
    drive_rms: float
    drive_peak: float

    @property
    def crest(self) -> float:
        """Peak over rms of the drive."""
        return self.drive_peak / max(self.drive_rms, 1e-30)


@dataclass(frozen=True)
class Strength:
    """What a texture delivers on a display in a stroke, at a gain; see `texture_strength`.

    Attributes
    ----------
    gain : that it is played at
    frequency : (B,) centers of the third octaves [Hz]
    commanded, attained : (B,) rms shear [m], asked for and played
    attainable : (B,) peak shear [m] of a sinusoid at the limits, of every contactor
    threshold : (B,) peak shear [m] that is just felt
    level : (B,) of what is played [dB SL]
    channels : level that each channel feels [dB SL]
    drive_rms, drive_peak : over all contactors [V], without the limiter
    predicted_rms : [V] the same in closed form
    limited_share : of the samples, how many the limiter turns down
    automatic : what `automatic_gain` finds; None where there is nothing to play
    """

    gain: float
    frequency: Floats
    commanded: Floats
    attained: Floats
    attainable: Floats
    threshold: Floats
    level: Floats
    channels: dict[str, float]
    drive_rms: float
    drive_peak: float
    predicted_rms: float
    limited_share: float
    automatic: Gain | None

    @property
    def lost_db(self) -> Floats:
        """(B,) by which what is played is below what is asked for, by limiter and response [dB]."""
        asked = np.maximum(self.commanded, 1e-30)
        return np.asarray(-20 * np.log10(np.maximum(self.attained, 1e-30) / asked))

    @property
    def channel(self) -> str:
        """The one that feels most."""
        return perception.strongest_channel(self.channels)

    @property
    def felt_by(self) -> tuple[str, ...]:
        """The channels above threshold; one alone is excited selectively."""
        return tuple(name for name, level in self.channels.items() if level > 0)


def texture_strength(
    display: Display, texture: Texture, stroke: SteadyStroke | None = None, *, gain: float = 1.0
) -> Strength:
    """Return what a texture delivers above threshold on a display.

    Parameters
    ----------
    display, texture : what is played on, and what
    stroke : of the finger; by default 80 mm/s at 0.5 N along x
    gain : of the texture

    Returns
    -------
    Strength
        Mean over the contactors in power; the limiter's part as measured in a trial, where it
        turns all bands down alike.
    """
    stroke = stroke or SteadyStroke()
    lines, able = stroke.lines(texture), reach(display, stroke)
    tried = trial(display, texture, stroke)
    share, kept = tried.limited(gain)
    asked, played = lines.times(gain), able.delivered(lines).times(gain * kept)
    return Strength(
        gain=gain,
        frequency=perception.CENTERS,
        commanded=_band_rms(asked),
        attained=_band_rms(played),
        attainable=able.least_attainable(perception.CENTERS),
        threshold=perception.detection_threshold(perception.CENTERS),
        level=perception.band_sensation(played.frequency, played.power),
        channels=perception.channel_sensation(played.frequency, played.power),
        drive_rms=gain * tried.rms,
        drive_peak=gain * tried.peak,
        predicted_rms=able.drive_rms(asked),
        limited_share=share,
        automatic=_largest(tried, able.delivered(lines), None),
    )


def _band_rms(lines: LineSpectrum) -> Floats:
    count = len(perception.CENTERS)
    power = np.bincount(perception.band_of(lines.frequency), lines.power, count + 1)
    return np.asarray(np.sqrt(power[:count]))


def automatic_gain(
    display: Display,
    texture: Texture,
    stroke: SteadyStroke | None = None,
    *,
    level: float | None = None,
) -> Gain:
    """Return the largest gain that a display's limits leave untouched.

    Parameters
    ----------
    display, texture, stroke : as of `texture_strength`
    level : the level to reach instead, if that takes less [dB SL]; met from below, for where a band
        crosses its threshold and begins to count the level steps, by 0.04 dB at 20 dB SL

    Raises
    ------
    InputError
        Where nothing is to be felt in this stroke at any gain.
    """
    stroke = stroke or SteadyStroke()
    delivered = reach(display, stroke).delivered(stroke.lines(texture))
    found = _largest(trial(display, texture, stroke), delivered, level)
    if found is None:
        raise InputError(f"{texture.name}: gives {display.name} nothing to play in this stroke")
    return found


def _largest(tried: Trial, delivered: LineSpectrum, level: float | None) -> Gain | None:
    """Return the gain of `automatic_gain` for a trial and what is delivered at gain 1."""
    bands = {
        name: perception.band_sensation(delivered.frequency, delivered.power, channel)
        for name, channel in perception.TOUCH_CHANNELS.items()
    }
    if tried.peak == 0 or not np.isfinite(max(np.max(b) for b in bands.values())):
        return None
    highest, limit = tried.largest_gain
    value = HEADROOM * highest
    if level is not None and _levels(bands, value)[1] > level:
        value, limit = _reaching(bands, level, value), "level"
    channel, reached = _levels(bands, value)
    return Gain(value, limit, reached, channel, value * tried.rms, value * tried.peak)


def _levels(bands: dict[str, Floats], gain: float) -> tuple[str, float]:
    """Return the channel that feels most at a gain, and its level [dB SL]."""
    more = 20 * np.log10(gain)
    levels = {name: perception.felt_level(at_one + more) for name, at_one in bands.items()}
    channel = perception.strongest_channel(levels)
    return channel, levels[channel]


def _reaching(bands: dict[str, Floats], level: float, highest: float) -> float:
    """Return the gain at which a level is reached: it grows with the gain, to 1e-9 dB."""
    low, high = highest * 1e-6, highest
    for _ in range(64):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if _levels(bands, middle)[1] <= level else (low, middle)
    return float(low)


@dataclass(frozen=True)
class EqualGains:
    """Gains with which one texture is equally strong on several displays.

    Attributes
    ----------
    gains : of each display, in their order
    level : that all reach [dB SL]
    weakest : name of the display that allows no more
    """

    gains: tuple[Gain, ...]
    level: float
    weakest: str


def equal_gain(
    displays: Sequence[Display], texture: Texture, stroke: SteadyStroke | None = None
) -> EqualGains:
    """Return the gains with which a texture has the same level on several displays.

    It is the highest that the weakest of them reaches within its limits.

    Raises
    ------
    InputError
        Where there is no display, or one has nothing to play.
    """
    if not displays:
        raise InputError("equal_gain: needs at least one display")
    alone = [automatic_gain(display, texture, stroke) for display in displays]
    least = int(np.argmin([gain.level for gain in alone]))
    level = alone[least].level
    gains = [
        gain if i == least else automatic_gain(displays[i], texture, stroke, level=level)
        for i, gain in enumerate(alone)
    ]
    return EqualGains(tuple(gains), level, displays[least].name)
