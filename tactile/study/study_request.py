"""Studies as they are requested in text: ``length_mm=8:30:0.5``, ``load=low,high``.

Values are a range ``start:stop:step``, which includes its stop if a step meets it, or a list
separated by commas. A band is ``low:high``. What is left out is taken from the paper's question:
the smallest displacement of the tip in 0–1000 Hz.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.display.display import Display
from tactile.errors import InputError
from tactile.study.criteria import Conditions
from tactile.study.parameters import FINGERS, names_of
from tactile.study.scenarios import draw_scenarios
from tactile.study.sweep import Study

CRITERION, BAND = "smallest_displacement", (0.0, 1000.0)
"""Criterion and band [Hz] of the paper, used where none are given."""
FREQUENCIES = 201
"""Default number of frequencies, evenly spaced over the band: every 5 Hz up to 1 kHz."""
MOST_VALUES = 10**8
"""Largest number of values of an axis."""
NORMAL_FORCE = 0.5
"""Normal force at which a display's table of fingers is read [N]."""
DIGITS = 9
"""Number of decimals kept of a range, so that 8:30:0.1 has 8.3 and not 8.300000000000001."""


@dataclass(frozen=True, kw_only=True)
class StudyRequest:
    """A study as it is requested in text.

    Attributes
    ----------
    axes : iterable of str
        Axes, each as "name=values".
    fixed : iterable of str
        Fixed values, each as "name=value".
    frequency : str or None
        Frequencies [Hz]; None for those of the paper, or evenly spaced over the band.
    band : str or None
        Band [Hz] as "low:high".
    criteria : tuple of str
        Names of `CRITERIA`.
    keep : tuple of str
        Names of `RESPONSES` to keep.
    scenarios : int
        Number of scenarios to draw, 0 for none. They are of tolerances alone if the finger is
        given.
    seed : int
        Seed of the scenarios.
    voltage : float or None
        Limit of the drive [V]; that of the base if None.
    current : float or None
        Limit of the amplifier's current [mA]; that of the base if None.
    amplitude : float
        Flat shear that a drive has to produce [µm].
    """

    axes: Iterable[str]
    fixed: Iterable[str] = ()
    frequency: str | None = None
    band: str | None = None
    criteria: tuple[str, ...] = ()
    keep: tuple[str, ...] = ()
    scenarios: int = 0
    seed: int = 0
    voltage: float | None = None
    current: float | None = None
    amplitude: float = 10.0


@dataclass(frozen=True)
class StudyBase:
    """Defaults of a study: a bender, the available fingers, default loads, and limits.

    Attributes
    ----------
    base : Bimorph
        Design that supplies everything that is neither varied nor fixed.
    fingers : dict of str to FingerLoad
        Finger loads by name.
    default_loads : tuple of str
        Names of the loads if none is given.
    voltage : float
        Limit of the drive [V].
    current : float
        Limit of the amplifier's current for one channel [A].
    """

    base: Bimorph = field(default_factory=Bimorph)
    fingers: dict[str, FingerLoad] = field(default_factory=lambda: dict(FINGERS))
    default_loads: tuple[str, ...] = ("low", "high")
    voltage: float = 100.0
    current: float = math.inf

    @property
    def is_measured(self) -> bool:
        """Whether the default load is that of a display, rather than the paper's two fingers."""
        return self.default_loads == ("display",)


def start_from(display: Display) -> StudyBase:
    """Return the defaults of a study on a display.

    Parameters
    ----------
    display : Display
        Display that supplies the bender, the finger load "display" and the limits.

    Returns
    -------
    StudyBase
        Defaults.
    """
    return StudyBase(
        display.bimorph,
        {**FINGERS, "display": display.load_at(NORMAL_FORCE)},
        ("display",),
        display.limits.voltage,
        display.limits.current,
    )


def requested_study(request: StudyRequest, start: StudyBase | None = None) -> Study:
    """Return the study that a request describes.

    Parameters
    ----------
    request : StudyRequest
        Request.
    start : StudyBase, optional
        Defaults of what the request leaves out.

    Returns
    -------
    Study
        Study to be solved.

    Raises
    ------
    InputError
        If a text cannot be read, or the study is not possible; see `Study`.
    """
    start = start or StudyBase()
    axes = _parse_assignments(request.axes, start)
    fixed = {
        name: _single(name, values)
        for name, values in _parse_assignments(request.fixed, start).items()
    }
    scenarios = None
    has_finger = bool({"load", "firmness"} & (set(axes) | set(fixed)))
    if not has_finger and (start.is_measured or not request.scenarios):
        axes["load"], has_finger = np.array(start.default_loads), True
    if request.scenarios:
        scenarios = draw_scenarios(request.scenarios, seed=request.seed)
        if has_finger:
            scenarios = replace(scenarios, values={})
    is_paper = not request.criteria and not (request.keep and request.frequency)
    band = _band(request, is_paper=is_paper)
    limits = Conditions(
        band=band,
        voltage=start.voltage if request.voltage is None else request.voltage,
        current=start.current if request.current is None else request.current * 1e-3,
        amplitude=request.amplitude * 1e-6,
    )
    return Study(
        axes=axes,
        fixed=fixed,
        frequency=_frequency(request, band),
        criteria=(CRITERION,) if is_paper else request.criteria,
        responses=request.keep,
        scenarios=scenarios,
        conditions=limits,
        fingers=start.fingers,
        base=start.base,
    )


def assignments(texts: Iterable[str], example: str) -> dict[str, str]:
    """Split texts of the form ``name=value``.

    Parameters
    ----------
    texts : iterable of str
        Texts to split.
    example : str
        Text that would do, for the error message.

    Returns
    -------
    dict of str to str
        Value of each name.

    Raises
    ------
    InputError
        If a text has no "=", or a name is given twice.
    """
    values: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"{text!r}: must be name=value, for example {example}")
        if name in values:
            raise InputError(f"{name}: is given twice")
        values[name] = value
    return values


def _parse_assignments(texts: Iterable[str], start: StudyBase) -> dict[str, NDArray[Any]]:
    """Return values by name from texts "name=values", each name once."""
    names = names_of(start.fingers)
    return {
        name: parse_values(name, values, is_named=name in names)
        for name, values in assignments(texts, "length_mm=8:30:0.5").items()
    }


def _single(name: str, values: NDArray[Any]) -> Any:
    """Return the only value of an array, or raise InputError."""
    if values.size != 1:
        raise InputError(
            f"{name}: a fixed parameter has one value, not {values.size}; make it an axis"
        )
    return values.item()


def _band(request: StudyRequest, *, is_paper: bool) -> tuple[float, float] | None:
    """Return the band of a request, or None."""
    if request.band is None:
        return BAND if is_paper and request.frequency is None else None
    return parse_span("band", request.band, "in Hz, for example 10:1000")


def _frequency(request: StudyRequest, band: tuple[float, float] | None) -> NDArray[np.float64]:
    """Return the frequencies of a request, with the ends of the band added."""
    if request.frequency is not None:
        frequencies = np.asarray(parse_values("frequency_hz", request.frequency, is_named=False))
        if band is None or np.sum((frequencies >= band[0]) & (frequencies <= band[1])) < 2:
            return frequencies
        return np.union1d(frequencies, band)
    return np.empty(0) if band is None else np.linspace(*band, FREQUENCIES)


def parse_values(name: str, text: str, *, is_named: bool) -> NDArray[Any]:
    """Parse a range, a list of numbers or a list of names.

    Parameters
    ----------
    name : str
        Name of the parameter, for messages.
    text : str
        Range "start:stop:step", or values separated by commas.
    is_named : bool
        Whether the values are names.

    Returns
    -------
    (N,) array of float or of str
        Values.

    Raises
    ------
    InputError
        If the text cannot be read, is empty, has a step that is not above 0, has too many values,
        or has one twice.
    """
    if ":" in text and not is_named:
        return _range(name, text)
    words = [word.strip() for word in text.split(",") if word.strip()]
    if not words:
        raise InputError(f"{name}: the axis is empty; give at least one value")
    if len(set(words)) < len(words):
        raise InputError(f"{name} = {text}: has a value twice")
    return np.array(words if is_named else [parse_number(name, word) for word in words])


def _range(name: str, text: str) -> NDArray[np.float64]:
    """Return the numbers of a range "start:stop:step"."""
    parts = text.split(":")
    if len(parts) != 3:
        raise InputError(f"{name} = {text}: a range reads as start:stop:step")
    start, stop, step = (parse_number(name, part) for part in parts)
    if not step > 0:
        raise InputError(f"{name} = {text}: step {step:g}: must be above 0")
    if stop < start:
        raise InputError(f"{name} = {text}: is empty, as {stop:g} is below {start:g}")
    steps = (stop - start) / step
    if steps >= MOST_VALUES:
        raise InputError(f"{name} = {text}: has {steps:.3g} values, more than {MOST_VALUES:g}")
    count = math.floor(steps + 1e-9) + 1
    return np.asarray(np.round(start + step * np.arange(count), DIGITS))


def parse_span(name: str, text: str, hint: str) -> tuple[float, float]:
    """Read a text of the form ``low:high``.

    Parameters
    ----------
    name : str
        Name of the value, for the error message.
    text : str
        Text to read.
    hint : str
        What would do, for the error message.

    Returns
    -------
    tuple of float
        The two numbers, in any order.

    Raises
    ------
    InputError
        If it is not two finite numbers.
    """
    low, colon, high = text.partition(":")
    if not colon:
        raise InputError(f"{name} = {text}: must be low:high, {hint}")
    return parse_number(name, low), parse_number(name, high)


def parse_number(name: str, text: str) -> float:
    """Read a finite number.

    Parameters
    ----------
    name : str
        Name of the value, for the error message.
    text : str
        Text to read.

    Returns
    -------
    float
        The number.

    Raises
    ------
    InputError
        If it is not a finite number.
    """
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{name} = {text!r}: must be a finite number")
    return number
