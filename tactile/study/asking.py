"""A study as it is asked in words: ``length_mm=8:30:0.5``, ``load=low,high``.

Values are a range ``start:stop:step``, its stop included where a step meets it, or a list with
commas. A band is ``low:high``. What is left out is the paper's question: the smallest displacement
of the tip in 0–1000 Hz.
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
"""Of the paper; taken where nothing is asked."""
FREQUENCIES = 201
"""In the band, evenly, where none are told: every 5 Hz to 1 kHz."""
MOST_VALUES = 10**8
"""Of an axis."""
NORMAL_FORCE = 0.5
"""N at which a display's table of fingers is read."""
DIGITS = 9
"""Decimals kept of a range, so that 8:30:0.1 has 8.3 and not 8.300000000000001."""


@dataclass(frozen=True, kw_only=True)
class Words:
    """A question in words.

    Attributes
    ----------
    axes, fixed : "name=values"
    frequency, band : values in Hz; None for the paper's, or evenly over the band
    criteria, keep : names of `CRITERIA` and `RESPONSES`
    scenarios, seed : how many are drawn, 0 for none, and from which seed; of tolerances alone
        where the finger is told
    voltage, current, amplitude : limits [V, mA] and what a drive is asked for [µm]
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
class Start:
    """What nobody varies: a bender, the fingers there are, which is meant, and limits."""

    base: Bimorph = field(default_factory=Bimorph)
    fingers: dict[str, FingerLoad] = field(default_factory=lambda: dict(FINGERS))
    meant: tuple[str, ...] = ("low", "high")
    voltage: float = 100.0
    current: float = math.inf

    @property
    def is_measured(self) -> bool:
        """Whether the finger is one that somebody told, and not the paper's two."""
        return self.meant == ("display",)


def start_from(display: Display) -> Start:
    """Return a display's bender, its finger as the load "display", and its limits."""
    return Start(
        display.bimorph,
        {**FINGERS, "display": display.load_at(NORMAL_FORCE)},
        ("display",),
        display.limits.voltage,
        display.limits.current,
    )


def ask(words: Words, start: Start | None = None) -> Study:
    """Return the study that words ask for.

    Raises
    ------
    InputError
        For words that cannot be read, and what cannot be asked; see `Study`.
    """
    start = start or Start()
    axes = _assigned(words.axes, start)
    fixed = {name: _one(name, values) for name, values in _assigned(words.fixed, start).items()}
    scenarios = None
    has_finger = bool({"load", "firmness"} & (set(axes) | set(fixed)))
    if not has_finger and (start.is_measured or not words.scenarios):
        axes["load"], has_finger = np.array(start.meant), True
    if words.scenarios:
        scenarios = draw_scenarios(words.scenarios, seed=words.seed)
        if has_finger:
            scenarios = replace(scenarios, values={})
    is_paper = not words.criteria and not (words.keep and words.frequency)
    band = _band(words, is_paper=is_paper)
    limits = Conditions(
        band=band,
        voltage=start.voltage if words.voltage is None else words.voltage,
        current=start.current if words.current is None else words.current * 1e-3,
        amplitude=words.amplitude * 1e-6,
    )
    return Study(
        axes=axes,
        fixed=fixed,
        frequency=_frequency(words, band),
        criteria=(CRITERION,) if is_paper else words.criteria,
        responses=words.keep,
        scenarios=scenarios,
        conditions=limits,
        fingers=start.fingers,
        base=start.base,
    )


def assignments(texts: Iterable[str], example: str) -> dict[str, str]:
    """Split texts of the form ``name=value``.

    Parameters
    ----------
    texts : the texts
    example : a text that would do, for the error message

    Returns
    -------
    dict
        Value by name.

    Raises
    ------
    InputError
        If a text has no "=", or a name is given twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"{text!r}: must be name=value, for example {example}")
        if name in found:
            raise InputError(f"{name}: is given twice")
        found[name] = value
    return found


def _assigned(texts: Iterable[str], start: Start) -> dict[str, NDArray[Any]]:
    """Return values by name, of texts of the form ``name=values``."""
    names = names_of(start.fingers)
    return {
        name: parse_values(name, values, is_named=name in names)
        for name, values in assignments(texts, "length_mm=8:30:0.5").items()
    }


def _one(name: str, values: NDArray[Any]) -> Any:
    if values.size != 1:
        raise InputError(f"{name}: is fixed to one value, not {values.size}; or make it an axis")
    return values.item()


def _band(words: Words, *, is_paper: bool) -> tuple[float, float] | None:
    if words.band is None:
        return BAND if is_paper and words.frequency is None else None
    return parse_span("band", words.band, "in Hz, for example 10:1000")


def _frequency(words: Words, band: tuple[float, float] | None) -> NDArray[np.float64]:
    if words.frequency is not None:
        told = np.asarray(parse_values("frequency_hz", words.frequency, is_named=False))
        if band is None or np.sum((told >= band[0]) & (told <= band[1])) < 2:
            return told
        return np.union1d(told, band)
    return np.empty(0) if band is None else np.linspace(*band, FREQUENCIES)


def parse_values(name: str, text: str, *, is_named: bool) -> NDArray[Any]:
    """Return the values that a text says: a range, a list, or names.

    Raises
    ------
    InputError
        Where it cannot be read, is empty, has a step that does not ascend, or a value twice.
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
    name : name of the value, for the error message
    text : the text
    hint : what would do, for the error message

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
    name : name of the value, for the error message
    text : the text

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
