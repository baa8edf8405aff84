"""Strength of a texture on a display: sensation level, drive, and the gain that the limits allow.

Levels are computed in closed form from the texture's lines (`commanded`) and what the display makes
of them: the inverse filter in use times the response of amplifier and loaded bimorph. What the
limits take is measured instead, in a trial of short strokes at `PLACES` places, because a texture's
envelope and the beating of its waves vary over centimeters. The strokes are rendered so faintly
that no limit is near. Everything before the limiter is linear, so that this drive, scaled, is that
of any gain.

A limiter that acts on one sample takes seconds to recover (`limiter.RELEASE`), so that "at most
1e-4 of samples" would mean none in any stroke of some seconds. `automatic_gain` therefore lets the
trial's highest drive come up to `HEADROOM` below the limit. No finite trial knows the highest peak
of an endless stroke: above it the limiter reduces the drive, gently and rarely.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs

from tactile.arrays import Floats
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.rendering.contact import LARGEST_FORCE, LARGEST_SPEED, Trajectory
from tactile.rendering.free_tip import free_tip_of, travel_voltage
from tactile.rendering.renderer import Renderer, limiter_of
from tactile.rendering.shear import CONTACT_FORCE
from tactile.rendering.skin_stretch import STROKE_SHARE
from tactile.strength.commanded import LineSpectrum, commanded_lines
from tactile.strength.figures import ShearFigures, shear_figures
from tactile.strength.friction import SteadyFriction, steady_duration, steady_friction
from tactile.texture import perception
from tactile.texture.surface import GOLDEN, Texture, without_friction

PLACES = 32
"""Number of places at which a trial strokes, spread over `SPREAD`."""
STROKED = 0.25
"""Duration of each stroke of a trial [s]."""
SETTLING = 0.02
"""Time before each stroke of a trial that is left out, because the finger has jumped there and the
filter fills [s]."""
SPREAD = 10.0
"""Extent of a trial's places in x and y, many times the longest wave of an envelope or a beat
[m]."""
TAPER = 5e-3
"""Time over which the drive of one place changes over to that of the next [s]."""
HEADROOM = 10 ** (-3.5 / 20)
"""Gain that leaves room for the highest drive of half a minute above that of a trial: bursts are
rare and high. Measured at 80 mm/s on calf, suede, ABS and oak, 24 contactors: −0.5 … 3.1 dB above
it."""
USUAL_SPEEDS = 0.04, 0.08, 0.16
"""Speeds of a finger that explores a surface, of about 20 to 200 mm/s (assumed) [m/s]. The
displacement of most textures is larger at lower speeds, their frequencies at higher ones."""
FAINT = 1e-3
"""Gain of a trial."""
GRID = 5.0
"""Spacing of the frequencies of a display's reach [Hz]."""
SAMPLE_RATE = 8000.0
"""Sample rate of the drive of a reach and of a trial [Hz]."""


@dataclass(frozen=True)
class SteadyStroke:
    """Stroke in a straight line at constant speed and force.

    Attributes
    ----------
    speed : float
        Speed [m/s].
    normal_force : float
        Normal force [N].
    angle : float
        Direction of motion, measured from the x axis [rad].

    Raises
    ------
    InputError
        If nothing would move, nothing would be touched, or a value is too large.

    Examples
    --------
    >>> import numpy as np
    >>> import tactile
    >>> tactile.SteadyStroke(speed=0.1, angle=np.pi / 2).direction.round(3).tolist()
    [0.0, 1.0]
    >>> tactile.SteadyStroke(speed=0.0)
    Traceback (most recent call last):
        ...
    tactile.errors.InputError: speed 0 m/s: must be above 0 ...
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
        """Unit vector (2,) along the motion."""
        return np.array([np.cos(self.angle), np.sin(self.angle)])

    def lines(self, texture: Texture) -> LineSpectrum:
        """Compute the spectrum that a texture commands in this stroke.

        Parameters
        ----------
        texture : Texture
            Texture to play.

        Returns
        -------
        LineSpectrum
            Lines of commanded shear.
        """
        return commanded_lines(
            texture, speed=self.speed, normal_force=self.normal_force, angle=self.angle
        )

    def friction(self, display: Display, texture: Texture) -> SteadyFriction:
        """Compute the shear that the friction of a texture commands in this stroke.

        Parameters
        ----------
        display : Display
            Display to play on.
        texture : Texture
            Texture to play.

        Returns
        -------
        SteadyFriction
            Mean and spectrum of the steady part.
        """
        line = Trajectory.line(
            speed=self.speed, angle=self.angle, normal_force=self.normal_force,
            duration=steady_duration(self.speed),
        )  # fmt: skip
        return steady_friction(display, texture.descriptor, line, SAMPLE_RATE)


def conditions(display: Display, stroke: SteadyStroke, gain: float = 1.0) -> str:
    """Describe the conditions for which figures are given.

    Parameters
    ----------
    display : Display
        Display that plays.
    stroke : SteadyStroke
        Stroke of the finger.
    gain : float
        Gain of the texture.

    Returns
    -------
    str
        Display, speed, force, direction unless it is along x, and gain.
    """
    turned = f", {np.degrees(stroke.angle):g}°" if stroke.angle else ""
    return (
        f"{display.name}, {stroke.speed * 1e3:g} mm/s, {stroke.normal_force:g} N{turned}, "
        f"gain {gain:.3g}"
    )


@dataclass(frozen=True)
class Reach:
    """Response of a display to commanded shear, per kind of contactor, at one normal force.

    Attributes
    ----------
    frequency : (F,) array of float
        Frequencies, ascending [Hz].
    gain : (C, F) array of float
        Drive per commanded shear [V/m].
    transfer : (C, F) array of float
        Delivered per commanded shear: 1 where the inverse is not bounded.
    attainable : (C, F) array of float
        Peak shear of a sinusoid at the limits of voltage, slew rate and travel in air [m].
    share : (C,) array of float
        Contribution of each kind to the mean square over all contactors: the number of its
        contactors, weighted by the squared cosine of the motion where shear is projected, relative
        to the number of all.
    """

    frequency: Floats
    gain: Floats
    transfer: Floats
    attainable: Floats
    share: Floats

    def delivered(self, lines: LineSpectrum) -> LineSpectrum:
        """Compute the spectrum that the skin receives below the limits, as a mean over contactors.

        Parameters
        ----------
        lines : LineSpectrum
            Commanded shear.

        Returns
        -------
        LineSpectrum
            Delivered shear.
        """
        square = self.share @ self.transfer**2
        at = np.interp(lines.frequency, self.frequency, square, right=0.0)
        return LineSpectrum(lines.frequency, lines.power * at)

    def projected(self, lines: LineSpectrum) -> LineSpectrum:
        """Compute the spectrum that is commanded, as a mean over contactors.

        Parameters
        ----------
        lines : LineSpectrum
            Shear of the surface along the motion.

        Returns
        -------
        LineSpectrum
            The same, or less where shear is projected.
        """
        return LineSpectrum(lines.frequency, lines.power * self.share.sum())

    def passed(self, frequency: Floats) -> Floats:
        """Compute the factor from commanded to delivered shear, rms over contactors.

        Parameters
        ----------
        frequency : (...) array of float
            Frequencies [Hz].

        Returns
        -------
        (...) array of float
            Factor, 1 where the inverse is not bounded.
        """
        square = self.share @ self.transfer**2 / max(self.share.sum(), 1e-9)
        return np.asarray(np.sqrt(np.interp(frequency, self.frequency, square, right=0.0)))

    def held_drive(self, display: Display, shear: Floats) -> Floats:
        """Compute the drive that holds a constant shear.

        Parameters
        ----------
        display : Display
            Display of the reach.
        shear : (N,) array of float
            Shear of each contactor [m].

        Returns
        -------
        (N,) array of float
            Drive [V].
        """
        return np.asarray(self.gain[display.kind, 0] * display.polarity * shear)

    def drive_rms(self, lines: LineSpectrum) -> float:
        """Compute the drive below the limits, over all contactors.

        Parameters
        ----------
        lines : LineSpectrum
            Commanded shear.

        Returns
        -------
        float
            Drive [V rms].
        """
        return float(np.sqrt(self.cost(lines.frequency) @ lines.power))

    def cost(self, frequency: Floats) -> Floats:
        """Compute the mean square drive per mean square shear.

        Parameters
        ----------
        frequency : (...) array of float
            Frequencies [Hz].

        Returns
        -------
        (...) array of float
            Cost of shear [V²/m²].
        """
        square = self.share @ self.gain**2
        return np.asarray(np.interp(frequency, self.frequency, square, right=0.0))

    def least_attainable(self, frequency: Floats) -> Floats:
        """Compute the peak shear that every contactor attains.

        Parameters
        ----------
        frequency : (...) array of float
            Frequencies [Hz].

        Returns
        -------
        (...) array of float
            Peak shear [m].
        """
        return np.asarray(np.interp(frequency, self.frequency, self.attainable.min(axis=0)))


def reach(display: Display, stroke: SteadyStroke) -> Reach:
    """Compute the response of a display to commanded shear in a stroke.

    Parameters
    ----------
    display : Display
        Display to play on.
    stroke : SteadyStroke
        Stroke of the finger.

    Returns
    -------
    Reach
        Response at the stroke's normal force, up to half of `SAMPLE_RATE`.
    """
    frequency = np.arange(0.0, SAMPLE_RATE / 2 + GRID / 2, GRID)
    loaded = replace(display, load=display.load_at(stroke.normal_force))
    response = np.abs(loaded.responses(frequency, SAMPLE_RATE)[0])
    inverse = Renderer(display, None, sample_rate=SAMPLE_RATE).filter
    place = np.interp(stroke.normal_force, display.load_forces, np.arange(len(inverse.taps)))
    weight = np.maximum(1 - np.abs(place - np.arange(len(inverse.taps))), 0)
    taps = inverse.mix @ np.tensordot(weight, inverse.taps, axes=1)
    turns = np.exp(-2j * np.pi / SAMPLE_RATE * np.outer(np.arange(taps.shape[1]), frequency))
    gain = np.abs(taps @ turns)
    steepest = 2 * SAMPLE_RATE * np.sin(np.pi * np.minimum(frequency / SAMPLE_RATE, 0.5))
    volts = np.minimum(display.limits.voltage, display.slew / np.maximum(steepest, 1e-9))
    volts = np.minimum(volts, travel_voltage(display, frequency, SAMPLE_RATE))
    cosine = np.ones(len(display.kind))
    if display.projected:
        cosine = np.abs(display.shear_axes @ stroke.direction)
    kinds = [display.kind == c for c in range(len(gain))]
    share = np.array([np.sum(cosine[kind] ** 2) / len(cosine) for kind in kinds])
    return Reach(frequency, gain, gain * response, response * volts, share)


def amplified(texture: Texture, gain: float) -> Texture:
    """Return a texture with all of its displacement multiplied by a gain.

    The levels in its descriptor's ``[stochastic]`` stay unchanged; the realized waves have the
    gain.

    Parameters
    ----------
    texture : Texture
        Texture to change.
    gain : float
        Factor on displacement, at least 0.

    Returns
    -------
    Texture
        Texture with scaled waves, harmonics, events and map; ``texture`` itself for a gain of 1.

    Raises
    ------
    InputError
        If the gain is negative or not finite.

    Examples
    --------
    >>> import tactile
    >>> texture = tactile.load_texture("wood-oak")
    >>> louder = tactile.amplified(texture, 2.0)
    >>> round(float(louder.amplitude.max() / texture.amplitude.max()), 3)
    2.0
    """
    if not 0 <= gain < np.inf:
        raise InputError(f"gain {gain:g}: must be a number from 0")
    if gain == 1:
        return texture
    d = texture.descriptor
    periodic = tuple(
        structs.replace(p, harmonics_um=tuple(gain * h for h in p.harmonics_um)) for p in d.periodic
    )
    events = tuple(structs.replace(e, amplitude_um=gain * e.amplitude_um) for e in d.events)
    played = d.map and structs.replace(d.map, level_um=gain * d.map.level_um)
    return replace(
        texture,
        amplitude=gain * texture.amplitude,
        density=None if texture.density is None else texture.density.weighted(gain),
        descriptor=structs.replace(d, periodic=periodic, events=events, map=played),
    )


@dataclass(frozen=True)
class Trial:
    """Drive of short strokes at gain 1, without limits.

    Attributes
    ----------
    display : Display
        Display that plays.
    drive : (K, S, N) array of float
        Drive of K strokes, without friction [V].
    extremes : (2, N) array of float
        Lowest and highest shear of each contactor in these strokes, without friction [m].
    room : float
        Part of the voltage limit that friction leaves free.
    """

    display: Display
    drive: Floats
    extremes: Floats
    room: float = 1.0

    @property
    def rms(self) -> float:
        """Root mean square of the drive over all contactors [V]."""
        return float(np.sqrt(np.mean(self.drive**2)))

    @property
    def peak(self) -> float:
        """Peak of the drive over all contactors [V]."""
        return float(np.abs(self.drive).max())

    @property
    def step(self) -> float:
        """Largest change of the drive from sample to sample [V]."""
        return float(np.abs(np.diff(self.drive, axis=1)).max())

    def peak_shear(self, gain: float, friction: Floats) -> float:
        """Compute the peak of the commanded shear.

        Parameters
        ----------
        gain : float
            Gain of the texture.
        friction : (N,) array of float
            Mean shear of friction at each contactor [m].

        Returns
        -------
        float
            Largest magnitude at any contactor [m].
        """
        return float(np.abs(gain * self.extremes + friction).max())

    def peak_drive(self, gain: float, held: Floats) -> float:
        """Compute the peak of the drive below the limits.

        Parameters
        ----------
        gain : float
            Gain of the texture.
        held : (N,) array of float
            Drive of each contactor that plays friction [V].

        Returns
        -------
        float
            Largest magnitude at any contactor [V].
        """
        return float(np.abs(gain * self.drive + held).max())

    @property
    def largest_gain(self) -> tuple[float, str]:
        """Gain at which a limit is reached, and the limit's name; very large without drive."""
        limits = self.display.limits
        slewing = "slew" if self.display.slew >= limits.slew else "current"
        by_voltage = self.room * limits.voltage / max(self.peak, 1e-30)
        by_slew = self.display.slew / SAMPLE_RATE / max(self.step, 1e-30)
        return min((by_voltage, "voltage"), (by_slew, slewing), (self._gain_by_travel, "travel"))

    @property
    def _gain_by_travel(self) -> float:
        """Gain at which the drive would swing a free tip to its largest travel."""
        tip = free_tip_of(self.display, SAMPLE_RATE)
        if tip is None:
            return np.inf
        swing = tip.swing(self._played, np.zeros(self.drive.shape[2], np.complex128))
        free = tip.largest - (1 - self.room) * self.display.limits.voltage
        return float(free / max(np.abs(swing).max(), 1e-30))

    @property
    def _played(self) -> Floats:
        """Drive of one stroke after the other (K·S, N), each with soft ends [V]."""
        count, channels = self.drive.shape[1:]
        from_end = np.minimum(np.arange(count), np.arange(count)[::-1]) / SAMPLE_RATE
        taper = np.sin(np.pi / 2 * np.minimum(from_end / TAPER, 1)) ** 2
        return np.asarray((self.drive * taper[:, None]).reshape(-1, channels))

    def limited(self, gain: float, held: Floats) -> "Limited":
        """Measure how much the limiter takes at a gain.

        Parameters
        ----------
        gain : float
            Gain of the texture.
        held : (N,) array of float
            Drive of each contactor that plays friction [V].

        Returns
        -------
        Limited
            What is limited, and what is left.
        """
        places, count, _ = self.drive.shape
        limiter = limiter_of(self.display, SAMPLE_RATE)
        vibration = gain * self._played
        target = vibration + held
        played = limiter(np.pad(target, ((0, limiter.delay), (0, 0))))[limiter.delay :]
        largest = np.abs(target).max(axis=1)
        left = np.abs(played).max(axis=1) / np.maximum(largest, 1e-30)
        square = np.sum(vibration**2, axis=1)
        return Limited(
            share=min(limiter.limited_samples / (places * count), 1.0),
            vibration=float(np.sqrt(square @ left**2 / max(square.sum(), 1e-30))),
            mean=float(left.mean()),
            peak=float(np.abs(played).max() / max(largest.max(), 1e-30)),
        )


@dataclass(frozen=True)
class Limited:
    """Effect of the limiter on a trial.

    Attributes
    ----------
    share : float
        Part of the samples that are turned down.
    vibration : float
        Part of the rms of the texture that is left.
    mean : float
        Part of a constant that is left.
    peak : float
        Part of the peak that is left.
    """

    share: float
    vibration: float
    mean: float
    peak: float


def trial(display: Display, texture: Texture, stroke: SteadyStroke) -> Trial:
    """Render short strokes far below the limits.

    Friction, which is bounded to its share of the drive, is left out, and that share is kept free.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to play.
    stroke : SteadyStroke
        Speed, force and direction of the strokes.

    Returns
    -------
    Trial
        Drive at gain 1.
    """
    faint = amplified(without_friction(texture), FAINT)
    renderer = Renderer(display, faint, sample_rate=SAMPLE_RATE)
    settling, count = round(SETTLING * SAMPLE_RATE), round(STROKED * SAMPLE_RATE)
    along = np.outer(np.arange(settling + count) * stroke.speed / SAMPLE_RATE, stroke.direction)
    start = SPREAD * (np.outer(np.arange(PLACES), [GOLDEN, GOLDEN**0.5]) % 1)
    place = (start[:, None] + along).reshape(-1, 2)
    force = np.full(len(place), stroke.normal_force)
    drive, shear = (
        both.reshape(PLACES, settling + count, -1)[:, settling:] / FAINT
        for both in renderer.block(place, force, shear=True)
    )
    extremes = np.stack([shear.min(axis=(0, 1)), shear.max(axis=(0, 1))])
    room = 1.0 if texture.descriptor.friction is None else 1.0 - STROKE_SHARE
    return Trial(display, drive, extremes, room)


@dataclass(frozen=True)
class Gain:
    """Gain with its consequences.

    Attributes
    ----------
    value : float
        Factor to multiply a texture by (`amplified`, or `Renderer.play`).
    limit : str
        What forbids more: "voltage", "slew", "current", "travel" of a tip without a finger, or
        "level" for a level that was requested.
    level : float
        Level of the channel that feels most [dB SL].
    channel : str
        Name of that channel.
    drive_rms : float
        Drive over all contactors [V rms].
    drive_peak : float
        Peak drive over all contactors [V].
    """

    value: float
    limit: str
    level: float
    channel: str
    drive_rms: float
    drive_peak: float


@dataclass(frozen=True)
class Strength:
    """What a texture delivers on a display in a stroke, at a gain; see `texture_strength`.

    Attributes
    ----------
    gain : float
        Gain at which the texture is played.
    frequency : (B,) array of float
        Centers of the third octaves [Hz].
    figures : ShearFigures
        Figures of the commanded shear.
    played_figures : ShearFigures
        Figures of the played shear.
    commanded : (B,) array of float
        Commanded shear [m rms].
    attained : (B,) array of float
        Played shear [m rms].
    attainable : (B,) array of float
        Peak shear of a sinusoid at the limits, attained by every contactor [m].
    threshold : (B,) array of float
        Peak shear that is just felt [m].
    level : (B,) array of float
        Level of the played shear [dB SL].
    channels : dict of str to float
        Level that each channel feels [dB SL].
    drive_rms : float
        Drive over all contactors, with friction and without the limiter [V rms].
    drive_peak : float
        Peak drive over all contactors, with friction and without the limiter [V].
    predicted_rms : float
        Drive over all contactors in closed form, without friction [V rms].
    limited_share : float
        Part of the samples that the limiter turns down.
    automatic : Gain or None
        Result of `automatic_gain`; None if there is nothing to play.
    """

    gain: float
    frequency: Floats
    figures: ShearFigures
    played_figures: ShearFigures
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
        """Loss (B,) of played relative to commanded shear, by limiter and response [dB]."""
        commanded = np.maximum(self.commanded, 1e-30)
        return np.asarray(-20 * np.log10(np.maximum(self.attained, 1e-30) / commanded))

    @property
    def channel(self) -> str:
        """Name of the channel that feels most."""
        return perception.strongest_channel(self.channels)

    @property
    def felt_by(self) -> tuple[str, ...]:
        """Names of the channels above threshold; a single one is excited selectively."""
        return tuple(name for name, level in self.channels.items() if level > 0)


def texture_strength(
    display: Display, texture: Texture, stroke: SteadyStroke | None = None, *, gain: float = 1.0
) -> Strength:
    """Compute what a texture delivers above threshold on a display.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to play.
    stroke : SteadyStroke, optional
        Stroke of the finger, by default 80 mm/s at 0.5 N along x.
    gain : float
        Gain of the texture.

    Returns
    -------
    Strength
        Levels and drive, as means over the contactors in power. The effect of the limiter is that
        measured in a trial, where it reduces all bands alike.

    Examples
    --------
    Oak is felt by the Pacinian channel alone, and the limiter takes nothing of it.

    >>> import tactile
    >>> display, texture = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
    >>> strength = tactile.texture_strength(display, texture)
    >>> strength.felt_by, round(strength.channels["P"]), strength.limited_share
    (('P',), 19, 0.0)
    """
    stroke = stroke or SteadyStroke()
    lines, able = stroke.lines(texture), reach(display, stroke)
    measured = trial(display, texture, stroke)
    friction = stroke.friction(display, texture)
    commanded = able.projected(lines).times(gain) + friction.lines
    passed = able.passed(np.append(0.0, commanded.frequency))
    held = able.held_drive(display, friction.shear)
    limited = measured.limited(gain, held)
    played = commanded.times(passed[1:] * limited.vibration)
    drag, peak = friction.drag, measured.peak_shear(gain, friction.shear)
    return Strength(
        gain=gain,
        frequency=perception.CENTERS,
        figures=shear_figures(commanded.frequency, commanded.power, drag=drag, peak=peak),
        played_figures=shear_figures(
            played.frequency,
            played.power,
            drag=drag * passed[0] * limited.mean,
            peak=peak * limited.peak,
        ),
        commanded=_band_rms(commanded),
        attained=_band_rms(played),
        attainable=able.least_attainable(perception.CENTERS),
        threshold=perception.detection_threshold(perception.CENTERS),
        level=perception.band_sensation(played.frequency, played.power),
        channels=perception.channel_sensation(played.frequency, played.power),
        drive_rms=float(np.hypot(gain * measured.rms, np.sqrt(np.mean(held**2)))),
        drive_peak=measured.peak_drive(gain, held),
        predicted_rms=able.drive_rms(lines.times(gain)),
        limited_share=limited.share,
        automatic=_largest(measured, able.delivered(lines), None),
    )


def commanded_figures(
    display: Display, texture: Texture, stroke: SteadyStroke | None = None
) -> ShearFigures:
    """Compute the figures of the shear that a texture commands, without rendering a stroke.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to play.
    stroke : SteadyStroke, optional
        Stroke of the finger, by default 80 mm/s at 0.5 N along x.

    Returns
    -------
    ShearFigures
        Figures, those of `Strength.figures` without a peak.

    Examples
    --------
    >>> import tactile
    >>> from tactile.strength.strength import commanded_figures
    >>> display, texture = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
    >>> figures = commanded_figures(display, texture)
    >>> round(figures.vibration_um_rms, 1), round(figures.drag_um, 1), figures.sensation
    (0.9, 6.9, 'felt: 14 dB above threshold at 250 Hz')
    """
    stroke = stroke or SteadyStroke()
    friction = stroke.friction(display, texture)
    lines = reach(display, stroke).projected(stroke.lines(texture)) + friction.lines
    return shear_figures(lines.frequency, lines.power, drag=friction.drag)


def _band_rms(lines: LineSpectrum) -> Floats:
    """Return the rms shear in each third octave, (B,) [m]."""
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
    """Compute the largest gain that the limits of a display leave unchanged.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to play.
    stroke : SteadyStroke, optional
        Stroke of the finger, by default 80 mm/s at 0.5 N along x.
    level : float, optional
        Level to reach instead, if that takes less gain [dB SL]. It is met from below: the level
        steps where a band crosses its threshold and begins to count, by 0.04 dB at 20 dB SL.

    Returns
    -------
    Gain
        Gain with its level and drive.

    Raises
    ------
    InputError
        If nothing can be felt in this stroke at any gain.

    Examples
    --------
    Oak may be played 4 times as strong, or a little stronger for a level of 20 dB SL.

    >>> import tactile
    >>> display, texture = tactile.load_display("reference-24"), tactile.load_texture("wood-oak")
    >>> largest = tactile.automatic_gain(display, texture)
    >>> largest.limit, round(largest.value, 1)
    ('voltage', 4.2)
    >>> round(tactile.automatic_gain(display, texture, level=20.0).value, 1)
    1.1
    """
    stroke = stroke or SteadyStroke()
    delivered = reach(display, stroke).delivered(stroke.lines(texture))
    gain = _largest(trial(display, texture, stroke), delivered, level)
    if gain is None:
        raise InputError(f"{texture.name}: leaves {display.name} nothing to play in this stroke")
    return gain


def gain_at_usual_speeds(display: Display, texture: Texture) -> float:
    """Compute the largest gain for a finger whose speed is not known beforehand.

    Parameters
    ----------
    display : Display
        Display to play on.
    texture : Texture
        Texture to play.

    Returns
    -------
    float
        Smallest of the `automatic_gain` of strokes at `USUAL_SPEEDS`; 1 if there is nothing to
        play.
    """
    gains = []
    for speed in USUAL_SPEEDS:
        with suppress(InputError):  # nothing to play at this speed
            gains.append(automatic_gain(display, texture, SteadyStroke(speed=speed)).value)
    return min(gains, default=1.0)


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
    """Return the gain at which a level is reached, by bisection to 1e-9 dB."""
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
    gains : tuple of Gain
        Gain of each display, in their order.
    level : float
        Level that all displays reach [dB SL].
    weakest : str
        Name of the display that allows no more.
    """

    gains: tuple[Gain, ...]
    level: float
    weakest: str


def equal_gain(
    displays: Sequence[Display], texture: Texture, stroke: SteadyStroke | None = None
) -> EqualGains:
    """Compute the gains with which a texture has the same level on several displays.

    The level is the highest that the weakest display reaches within its limits.

    Parameters
    ----------
    displays : sequence of Display
        Displays to play on.
    texture : Texture
        Texture to play.
    stroke : SteadyStroke, optional
        Stroke of the finger, by default 80 mm/s at 0.5 N along x.

    Returns
    -------
    EqualGains
        Gain of each display, and the common level.

    Raises
    ------
    InputError
        If there is no display, or one has nothing to play.
    """
    if not displays:
        raise InputError("equal_gain: needs at least one display")
    largest = [automatic_gain(display, texture, stroke) for display in displays]
    least = int(np.argmin([gain.level for gain in largest]))
    level = largest[least].level
    gains = [
        gain if i == least else automatic_gain(displays[i], texture, stroke, level=level)
        for i, gain in enumerate(largest)
    ]
    return EqualGains(tuple(gains), level, displays[least].name)
