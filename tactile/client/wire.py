"""Between SI, which a program speaks, and the units of the wire, which carry them in their names.

`to_` makes messages, checked as the daemon will check them; `from_` reads them.
"""

import dataclasses
import functools
import math
import operator
import reprlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeVar

import msgspec

from tactile.errors import InputError
from tactile.messages import (
    MOST_LAYERS,
    MOST_POINTS,
    ApiMessage,
    Contact,
    FrequencyPoint,
    Layer,
    PlayEffect,
    Point,
    Transient,
    kind_of,
)

M = TypeVar("M", bound=ApiMessage)
S = TypeVar("S", bound="DisplayInfo | Appended | Stats | Telemetry")

Layers = str | Layer | tuple[str, float] | Sequence[str | Layer | tuple[str, float]]
"""A texture or several, each with its gain where it is a pair; none is ``()``."""
Pair = tuple[float, float]

AMPLITUDE_POINT = "amplitude_points", "time [s], value"
FREQUENCY_POINT = "frequency_points", "time [s], frequency [Hz]"
TRANSIENT = "transients", "time [s], value, frequency [Hz]"
"""What the points of an effect are called, and what each consists of."""


@dataclass(frozen=True, slots=True)
class DisplayInfo:
    """A display that the daemon has.

    Attributes
    ----------
    name : what it is called
    contactors : (N, 2) places in the display [m]
    shear_direction : (N,) from the x axis [rad]
    sample_rate : of its drive [Hz]
    voltage_limit : of its drive [V]
    waveforms : whether it has room for `play`, `append` and `effect`
    latency : from a contact to the skin, about [s]
    """

    name: str
    contactors: tuple[Pair, ...]
    shear_direction: tuple[float, ...]
    sample_rate: float
    voltage_limit: float
    waveforms: bool
    latency: float


@dataclass(frozen=True, slots=True)
class Appended:
    """What became of an `append`.

    Attributes
    ----------
    samples_consumed : how many samples, from the first, were taken; send the rest again
    buffered : for how long what waits will play [s]
    """

    samples_consumed: int
    buffered: float


@dataclass(frozen=True, slots=True)
class Stats:
    """How a display stands.

    Attributes
    ----------
    display : its name
    state : "disarmed", "armed", "estopped" or "lost"
    link : to the amplifier, "up" or "down"
    detail : what is wrong, or nothing
    touching : whether a finger is on it
    owner : whether that finger is this client's
    latency : from a contact to the skin [s]
    counters : what playback, bus and amplifier count
    estop : number of the e-stop that holds, 0 for none
    """

    display: str
    state: str
    link: str
    detail: str
    touching: bool
    owner: bool
    latency: float
    counters: dict[str, int]
    estop: int = 0


@dataclass(frozen=True, slots=True)
class Telemetry:
    """What a display does at a time.

    Attributes
    ----------
    display : its name
    time : on this program's monotonic clock [s]
    state : as in `Stats`
    position, velocity, normal_force : of the finger [m], [m/s], [N]
    shear : (N,) commanded of each contactor [m]
    drive : (N,) of each contactor [V]
    counters : as in `Stats`
    """

    display: str
    time: float
    state: str
    position: Pair
    velocity: Pair
    normal_force: float
    shear: tuple[float, ...]
    drive: tuple[float, ...]
    counters: dict[str, int]


@dataclass(frozen=True, slots=True)
class Event:
    """Something that a program should know.

    Attributes
    ----------
    kind : of `tactile.messages.EventMessage`, or one of this side: "connected" (again),
        "disconnected", "refused" (a contact, or what was to be restored after a reconnection)
    display : its name, or "" where it concerns all
    detail : in one line
    estop : number of the e-stop, of "estopped"
    """

    kind: str
    display: str = ""
    detail: str = ""
    estop: int = 0


def checked(message: M) -> M:
    """Return a message as the daemon would read it.

    Raises
    ------
    InputError
        Where a value is not one that may be sent; names the field on the wire, with its unit.
    """
    try:
        plain = msgspec.to_builtins(message, builtin_types=(bytes,))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{kind_of(message)}: {error}") from None
    return _read(plain, type(message))


def _read(plain: dict[str, Any], kind: type[M]) -> M:
    try:
        return msgspec.convert(plain, kind)
    except msgspec.ValidationError as error:
        text, _, path = str(error).partition(" - at `$")
        path = path.rstrip("`").removeprefix(".")
        raise InputError(f"{path or plain['type']}: {_value_at(plain, path)}{text}") from None


def _value_at(plain: Any, path: str) -> str:
    """Return what stands at a path as "layers[0].gain", for a text."""
    for part in path.replace("[", ".").replace("]", "").split("."):
        try:
            plain = plain[int(part) if part.isdigit() else part]
        except (IndexError, KeyError, TypeError):
            return ""
    return f"{plain!r}: " if isinstance(plain, float | int | str) else ""


def shown(value: object) -> str:
    """Return a value for a text: in one line, and not too long."""
    return " ".join(reprlib.repr(value).split())


def to_number(value: Any, what: str) -> float:
    """Return a finite number; ``what`` names the value and its unit.

    Raises
    ------
    InputError
        Where it is none.
    """
    try:
        made = float(value * 1.0)  # float() alone takes texts as well
    except (TypeError, ValueError, OverflowError):
        made = math.nan
    if not math.isfinite(made):
        raise InputError(f"{what}: {shown(value)} is not a finite number")
    return made


def to_items(values: Any, what: str, most: int | None = None) -> Iterator[Any]:
    """Return an iterator over values, over at most one more than there may be.

    Raises
    ------
    InputError
        Where they are no sequence.
    """
    try:
        return islice(values, None if most is None else most + 1)
    except TypeError:
        raise InputError(f"{what}: {shown(values)} is not a sequence") from None


def to_index(value: Any, what: str) -> int:
    """Return a whole number.

    Raises
    ------
    InputError
        Where it is none.
    """
    try:
        return operator.index(value)
    except TypeError:
        raise InputError(f"{what}: {shown(value)} is not a whole number") from None


def to_microseconds(time: float) -> int:
    """Return a time [s] in whole microseconds.

    Raises
    ------
    InputError
        Where it is not a finite number, or too long.
    """
    try:
        return round(time * 1e6)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"time: {shown(time)} s is not a finite time, as 12.5") from None


def to_contact(
    display: str,
    position: Sequence[float],
    normal_force: float,
    velocity: Sequence[float] | None,
    time_us: int,
) -> Contact:
    """Return a contact of [m], [N] and [m/s].

    Raises
    ------
    InputError
        Where a value is not of that form, or out of range.
    """
    try:  # every frame: what is wrong is looked for only where something is
        x, y = position
        plain = {
            "type": "contact",
            "display": display,
            "position_mm": (float(x * 1e3), float(y * 1e3)),
            "normal_force_n": float(normal_force * 1.0),
            "time_us": time_us,
        }
        if velocity is not None:
            vx, vy = velocity
            plain["velocity_mm_s"] = (float(vx * 1e3), float(vy * 1e3))
    except (TypeError, ValueError, OverflowError):
        to_number(normal_force, "normal_force [N], as 0.5")
        _to_pair(position, "position [m]: {} is not two numbers, as (0.012, 0.003)")
        _to_pair(velocity, "velocity [m/s]: {} is not two numbers, as (0.08, 0.0)")
        raise
    return _read(plain, Contact)


def _to_pair(values: Any, complaint: str) -> Pair:
    try:
        x, y = values
        return float(x * 1.0), float(y * 1.0)
    except (TypeError, ValueError, OverflowError):
        raise InputError(complaint.format(shown(values))) from None


def to_layers(layers: Layers) -> tuple[Layer, ...]:
    """Return what may be given as textures as layers.

    Raises
    ------
    InputError
        Where it is none of what `Layers` says.
    """
    match layers:
        case str() | Layer() | (str(), int() | float()):
            return (_to_layer(layers),)
        case _:
            return tuple(_to_layer(layer) for layer in to_items(layers, "layers", MOST_LAYERS))


def _to_layer(layer: object) -> Layer:
    match layer:
        case Layer():
            return layer
        case str():
            return Layer(texture=layer)
        case (str() as texture, int() | float() as gain):
            return Layer(texture=texture, gain=float(gain))
        case _:
            raise InputError(f"layers: {layer!r} is no texture, (texture, gain) or Layer")


def to_effect(
    display: str,
    amplitude: float,
    amplitude_points: Iterable[Pair],
    frequency_points: Iterable[Pair],
    transients: Iterable[tuple[float, ...]],
    stream: bool,
) -> PlayEffect:
    """Return an effect of [m], [s] and [Hz]."""
    return checked(
        PlayEffect(
            display=display,
            amplitude_um=to_number(amplitude, "amplitude [m]") * 1e6,
            amplitude=tuple(
                Point(t * 1e3, value) for t, value in _to_rows(amplitude_points, *AMPLITUDE_POINT)
            ),
            frequency=tuple(
                FrequencyPoint(t * 1e3, hz)
                for t, hz in _to_rows(frequency_points, *FREQUENCY_POINT)
            ),
            transients=tuple(
                Transient(t * 1e3, *rest) for t, *rest in _to_rows(transients, *TRANSIENT)
            ),
            stream=stream,
        )
    )


def _to_rows(rows: Any, what: str, names: str, fewest: int = 2) -> Iterator[list[float]]:
    """Yield each of the points of an effect, whose values have these names."""
    most = names.count(",") + 1
    for index, row in enumerate(to_items(rows, what, MOST_POINTS)):
        where = f"{what}[{index}]"
        values = list(to_items(row, where, most))
        if not fewest <= len(values) <= most:
            raise InputError(f"{where}: {shown(row)} is not ({names})")
        yield [to_number(value, f"{where}[{place}]") for place, value in enumerate(values)]


UNITS = {
    "_mm_s": 1e-3,
    "_mm": 1e-3,
    "_um": 1e-6,
    "_ms": 1e-3,
    "_us": 1e-6,
    "_deg": math.pi / 180,
    "_hz": 1.0,
    "_n": 1.0,
    "_v": 1.0,
}
"""Value in SI of the unit that a field of a message ends with."""


@functools.cache
def _units(message: type[msgspec.Struct]) -> dict[str, tuple[str, float | None]]:
    """Return each field of a message and the value of its unit, by its name without the unit."""
    units = {}
    for field in message.__struct_fields__:
        suffix = next((suffix for suffix in UNITS if field.endswith(suffix)), "")
        units[field.removesuffix(suffix)] = field, UNITS.get(suffix)
    return units


def _scaled(value: Any, unit: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_scaled(item, unit) for item in value)
    return value * unit


def from_message(kind: type[S], message: msgspec.Struct) -> S:
    """Return what a message holds in SI.

    Parameters
    ----------
    kind : type
        Data class whose fields are those of the message, without their units.
    message : Struct
        Message of the daemon.

    Returns
    -------
    kind
        Values in SI.
    """
    units, values = _units(type(message)), {}
    for name in (field.name for field in dataclasses.fields(kind)):
        field, unit = units[name]
        value = getattr(message, field)
        values[name] = value if unit is None else _scaled(value, unit)
    return kind(**values)
