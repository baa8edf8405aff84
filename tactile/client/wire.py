"""Conversion between SI, which a program uses, and messages, whose fields are named by their units.

Functions ``to_…`` make messages and check them as the server will; `from_message` reads them.
"""

import dataclasses
import functools
import math
import operator
import reprlib
import struct
import sys
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeVar

import msgspec

from tactile import messages
from tactile.errors import InputError, locate_mistake, show_field
from tactile.messages import (
    MOST_LAYERS,
    MOST_POINTS,
    ApiMessage,
    Contact,
    FrequencyPoint,
    Layer,
    PlayEffect,
    Point,
    TactileFrames,
    Transient,
    kind_of,
)

M = TypeVar("M", bound=ApiMessage)
S = TypeVar("S", bound="DisplayInfo | Appended | Stats | Telemetry | FingerState | ShearTrace")

Layers = str | Layer | tuple[str, float] | Sequence[str | Layer | tuple[str, float]]
"""One texture or several, each with its gain if it is a pair; ``()`` for none."""
Pair = tuple[float, float]

AMPLITUDE_POINT = "amplitude_points", "time [s], value"
FREQUENCY_POINT = "frequency_points", "time [s], frequency [Hz]"
TRANSIENT = "transients", "time [s], value, frequency [Hz]"
"""Argument that holds points of an effect, and the values of each point."""


@dataclass(frozen=True, slots=True)
class DisplayInfo:
    """A display that the server has.

    Attributes
    ----------
    name : str
        Name of the display.
    contactors : (N, 2) tuple of float
        Positions of the contactors in the display [m].
    shear_direction : (N,) tuple of float
        Direction of the shear of each contactor, from the x axis [rad].
    sample_rate : float
        Sample rate of the drive [Hz].
    voltage_limit : float
        Largest voltage of the drive [V].
    waveforms : bool
        Whether the link has room for `play`, `append` and `effect`.
    latency : float
        Approximate time from a contact to the skin [s].
    follows : bool
        Whether playback follows the finger, so that telemetry has the loads that it finds.
    marker_lines : int
        Number of marker lines of its amplifier; 0 for none.
    """

    name: str
    contactors: tuple[Pair, ...]
    shear_direction: tuple[float, ...]
    sample_rate: float
    voltage_limit: float
    waveforms: bool
    latency: float
    follows: bool = False
    marker_lines: int = 0


@dataclass(frozen=True, slots=True)
class Appended:
    """Result of an `append`.

    Attributes
    ----------
    samples_consumed : int
        Number of samples, from the first, that were taken; send the rest again.
    buffered : float
        Time for which what waits will play [s].
    """

    samples_consumed: int
    buffered: float


@dataclass(frozen=True, slots=True)
class Stats:
    """State of a display.

    Attributes
    ----------
    display : str
        Name of the display.
    state : str
        "disarmed", "armed", "estopped" or "lost".
    link : str
        Link to the amplifier, "up" or "down".
    detail : str
        What is wrong, or nothing.
    touching : bool
        Whether a finger is on the display.
    owner : bool
        Whether that finger is this client's.
    latency : float or None
        Time from the arrival of a contact at the server to the skin, whether or not a finger
        touches [s]; None while nothing plays.
    counters : dict of str to int
        Counts of playback, bus and amplifier.
    estop : int
        Number of the e-stop that holds, 0 for none.
    put_out_share : float or None
        Share that was put out of what was due since the display was armed, from 0 to 1, as far as
        its amplifiers have reported; None if nothing was due.
    lead : float or None
        Time by which drive is sent before it is put out [s]; None as long as the device is not
        open.
    """

    display: str
    state: str
    link: str
    detail: str
    touching: bool
    owner: bool
    latency: float | None
    counters: dict[str, int]
    estop: int = 0
    put_out_share: float | None = None
    lead: float | None = None


@dataclass(frozen=True, slots=True)
class FingerState:
    """Loads of a finger on the contactors, as playback finds them from their currents.

    Attributes
    ----------
    touching : (N,) tuple of bool
        Whether a finger is on each contactor.
    stiffness : (N,) tuple of float
        Magnitude of the dynamic stiffness of each load at 100 Hz; 0 in air [N/m].
    equalizer_error_db : (N,) tuple of float
        Standard deviation of the level of each contactor's shear that follows from the uncertainty
        of its load; 0 in air [dB].
    explained : (N,) tuple of bool
        Whether a load explains the current of each contactor. Where none does, filters for a mean
        finger play.
    guarded : (N,) tuple of bool
        Whether the guard of an amplifier has turned each contactor down, because it lost the
        finger. It comes back as soon as what plays is harmless to a bender in air.
    """

    touching: tuple[bool, ...]
    stiffness: tuple[float, ...]
    equalizer_error_db: tuple[float, ...]
    explained: tuple[bool, ...]
    guarded: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class ShearTrace:
    """Shear of one contactor, sample by sample.

    Attributes
    ----------
    contactor : int
        Index of the contactor.
    sample_rate : float
        Rate of the samples [Hz].
    first : int
        Number of the first sample. It continues the telemetry before unless samples are missing,
        and begins anew when playback is started again.
    shear : (S,) tuple of float
        Samples since the telemetry before, none while nothing plays [m].
    """

    contactor: int
    sample_rate: float
    first: int
    shear: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class CommandedSamples:
    """What playback has handed to the amplifier since the telemetry before, sample by sample.

    It comes in B blocks, of which there is none while nothing plays. After an e-stop, the amplifier
    turns to 0 V by itself.

    Attributes
    ----------
    first : int
        Number of the first sample. It continues the telemetry before unless samples are missing,
        and begins anew when the server opens the display anew.
    sample_rate : float
        Nominal rate of the samples [Hz].
    block_samples : int
        Number of samples of a block.
    times : (B,) tuple of float
        Time on this program's monotonic clock at which the first sample of each block is put out,
        by the clock of the amplifier [s]. Blocks are handed over before that.
    uncertainty : float or None
        Half of the largest interval around these times that holds the true one; None if it is not
        known, as on a sound card [s].
    finger_times : (B,) tuple of float
        Time on this program's monotonic clock for which each block has the finger [s].
    position, velocity : (B,) tuple of (2,) tuple of float
        Position and velocity of the finger in each block [m, m/s].
    normal_force : (B,) tuple of float
        Normal force of the finger in each block [N].
    touching : (B,) tuple of bool
        Whether the finger touches the surface in each block.
    shear : (S, N) memoryview of float32 or None
        Commanded shear of each contactor, in step with the drive [m]; None on a link that takes
        spectrum frames, and while nothing plays.
    drive : (S, N) memoryview of float32 or None
        Voltage of each contactor [V]; None where there is no shear.
    """

    first: int
    sample_rate: float
    block_samples: int
    times: tuple[float, ...]
    uncertainty: float | None
    finger_times: tuple[float, ...]
    position: tuple[Pair, ...]
    velocity: tuple[Pair, ...]
    normal_force: tuple[float, ...]
    touching: tuple[bool, ...]
    shear: "memoryview[float] | None"
    drive: "memoryview[float] | None"


@dataclass(frozen=True, slots=True)
class Telemetry:
    """State of a display and its finger at a time.

    Attributes
    ----------
    display : str
        Name of the display.
    time : float
        Time on this program's monotonic clock [s].
    state : str
        State as in `Stats`.
    position : (2,) tuple of float
        Position of the finger [m].
    velocity : (2,) tuple of float
        Velocity of the finger [m/s].
    normal_force : float
        Normal force of the finger [N].
    shear : (N,) tuple of float or None
        Commanded shear of each contactor [m]; None on a link that takes spectrum frames, for which
        it is not computed.
    drive : (N,) tuple of float
        Voltage of each contactor [V].
    counters : dict of str to int
        Counts as in `Stats`.
    put_out_share : float or None
        Share that was put out, as in `Stats`.
    finger : FingerState or None
        Loads of the finger on a display that follows it; None where they are not known.
    trace : ShearTrace or None
        Commanded shear of the contactor that `telemetry` was called with; None without one, and on
        a link that takes spectrum frames.
    played : ShearTrace or None
        Shear of the skin at that contactor on a simulated display, which alone knows it.
    samples : CommandedSamples or None
        What was handed to the amplifier since the telemetry before, if ``samples`` was given to
        `telemetry`.
    """

    display: str
    time: float
    state: str
    position: Pair
    velocity: Pair
    normal_force: float
    shear: tuple[float, ...] | None
    drive: tuple[float, ...]
    counters: dict[str, int]
    put_out_share: float | None = None
    finger: FingerState | None = None
    trace: ShearTrace | None = None
    played: ShearTrace | None = None
    samples: CommandedSamples | None = None


@dataclass(frozen=True, slots=True)
class Onset:
    """Beginning of a stimulus, as the amplifier has put it out.

    Attributes
    ----------
    display : str
        Name of the display.
    at : float
        Time at which it was to begin, on the clock of `time.monotonic` [s].
    time : float or None
        Time at which its first sample was put out, on the same clock; None if it was not [s].
    uncertainty : float or None
        Half of the interval around ``time`` that holds the true one; None if it is not known [s].
    reason : str
        Reason why it did not begin, or not at its time, or without its marker; empty if all was as
        it should be.
    marker : int
        Code that the marker lines of the amplifier have shown with its first sample, as far as it
        has confirmed that; 0 for none.
    client : int or None
        Number of the program that played it; None if it is this program.
    """

    display: str
    at: float
    time: float | None
    uncertainty: float | None
    reason: str
    marker: int = 0
    client: int | None = None


@dataclass(frozen=True, slots=True)
class Event:
    """Event that a program should know of.

    Attributes
    ----------
    kind : str
        Kind of a `tactile.messages.EventMessage`, or one of this side: "connected" (again),
        "disconnected", "refused" (a contact or frames, or what was to be restored after a
        reconnection), "onset" (of a stimulus of another program, while telemetry with samples is
        read).
    display : str
        Name of the display, or "" if the event concerns all.
    detail : str
        Description in one line.
    estop : int
        Number of the e-stop, of "estopped".
    contactors : tuple of int
        Contactors of "touched" and "lifted".
    onset : Onset or None
        What became of the stimulus, of "onset".
    """

    kind: str
    display: str = ""
    detail: str = ""
    estop: int = 0
    contactors: tuple[int, ...] = ()
    onset: Onset | None = None


def checked(message: M) -> M:
    """Return a message as the server would read it.

    Parameters
    ----------
    message : ApiMessage
        Message that may hold any values.

    Returns
    -------
    ApiMessage
        Message whose values are of the declared types.

    Raises
    ------
    InputError
        If a value is not one that may be sent; the text names the field, which has a unit.
    """
    try:
        plain = msgspec.to_builtins(message, builtin_types=(bytes,))
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{kind_of(message)}: {error}") from None
    return _read(plain, type(message))


def _read(plain: dict[str, Any], kind: type[M]) -> M:
    """Return a message of plain values, or raise `InputError`."""
    try:
        return msgspec.convert(plain, kind)
    except msgspec.ValidationError as error:
        field, problem = locate_mistake(str(error))
        where = show_field(plain, field) or f"{plain['type']}: "
        raise InputError(where + problem) from None


def excerpt(value: object) -> str:
    """Return a value for an error message.

    Parameters
    ----------
    value : object
        Value as the program gave it.

    Returns
    -------
    str
        Value in one short line.
    """
    return " ".join(reprlib.repr(value).split())


def to_number(value: Any, what: str) -> float:
    """Return a finite number.

    Parameters
    ----------
    value : object
        Value as the program gave it.
    what : str
        Name of the value and its unit, for the error message.

    Returns
    -------
    float
        Value as a number.

    Raises
    ------
    InputError
        If it is not a finite number.
    """
    try:
        number = float(value * 1.0)  # float() alone takes texts as well
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{what}: {excerpt(value)} is not a finite number")
    return number


def to_items(values: Any, what: str, most: int | None = None) -> Iterator[Any]:
    """Return an iterator over values.

    Parameters
    ----------
    values : object
        Values as the program gave them.
    what : str
        Name of the values, for the error message.
    most : int, optional
        Largest number of values; at most one more is read, so that too many are noticed.

    Returns
    -------
    iterator
        Values.

    Raises
    ------
    InputError
        If they are not a sequence.
    """
    try:
        return islice(values, None if most is None else most + 1)
    except TypeError:
        raise InputError(f"{what}: {excerpt(values)} is not a sequence") from None


def to_index(value: Any, what: str) -> int:
    """Return a whole number.

    Parameters
    ----------
    value : object
        Value as the program gave it.
    what : str
        Name of the value, for the error message.

    Returns
    -------
    int
        Value as a number.

    Raises
    ------
    InputError
        If it is not a whole number.
    """
    try:
        return operator.index(value)
    except TypeError:
        raise InputError(f"{what}: {excerpt(value)} is not a whole number") from None


def to_microseconds(time: float) -> int:
    """Return a time in whole microseconds.

    Parameters
    ----------
    time : float
        Time [s].

    Returns
    -------
    int
        Time [µs].

    Raises
    ------
    InputError
        If it is not a finite number, or too large.
    """
    try:
        return round(time * 1e6)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"time: {excerpt(time)} s is not a finite time, as 12.5") from None


def to_contact(
    display: str,
    position: Sequence[float],
    normal_force: float,
    velocity: Sequence[float] | None,
    time_us: int,
) -> Contact:
    """Return the message of a contact.

    Parameters
    ----------
    display : str
        Name of the display.
    position : (2,) sequence of float
        Position [m].
    normal_force : float
        Normal force [N].
    velocity : (2,) sequence of float or None
        Velocity [m/s].
    time_us : int
        Time of the contact [µs].

    Returns
    -------
    Contact
        Message with these values.

    Raises
    ------
    InputError
        If a value is not of that form, or out of range.
    """
    try:  # this runs every frame, so the wrong value is looked for only if there is one
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


def to_frames(display: str, rate: float, amplitude: float, *, latest: bool) -> TactileFrames:
    """Return the message of tactile frames, as yet without one.

    Parameters
    ----------
    display : str
        Name of the display.
    rate : float
        Rate of the frames [Hz].
    amplitude : float
        Shear of a value of 1 [m].
    latest : bool
        Whether only the newest frame counts.

    Returns
    -------
    TactileFrames
        Message with these values.

    Raises
    ------
    InputError
        If a value is not a number, or out of range.
    """
    return checked(
        TactileFrames(
            display=display,
            frame_rate_hz=to_number(rate, "rate [Hz]"),
            amplitude_um=to_number(amplitude, "amplitude [m]") * 1e6,
            frames=b"",
            latest=latest,
        )
    )


def _to_pair(values: Any, complaint: str) -> Pair:
    """Return two numbers, or raise `InputError` with a complaint about the values."""
    try:
        x, y = values
        return float(x * 1.0), float(y * 1.0)
    except (TypeError, ValueError, OverflowError):
        raise InputError(complaint.format(excerpt(values))) from None


def to_layers(layers: Layers) -> tuple[Layer, ...]:
    """Return textures as layers.

    Parameters
    ----------
    layers : str, tuple, Layer, or sequence of these
        One texture or several.

    Returns
    -------
    tuple of Layer
        Layers of a message.

    Raises
    ------
    InputError
        If it is none of what `Layers` allows.
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
    """Return the message of an effect.

    Parameters
    ----------
    display : str
        Name of the display.
    amplitude : float
        Shear of an amplitude of 1 [m].
    amplitude_points : iterable of (float, float)
        Pairs of time [s] and amplitude, 0 … 1.
    frequency_points : iterable of (float, float)
        Pairs of time [s] and frequency [Hz].
    transients : iterable of tuple of float
        Taps: time [s], amplitude, and frequency [Hz] if it is not 160 Hz.
    stream : bool
        Whether the effect continues the last one.

    Returns
    -------
    PlayEffect
        Message with these values.

    Raises
    ------
    InputError
        If a value is not of that form, or out of range.
    """
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


def _to_rows(rows: Any, what: str, names: str) -> Iterator[list[float]]:
    """Yield the values of each point of an effect, which are called by these names."""
    most = names.count(",") + 1
    for index, row in enumerate(to_items(rows, what, MOST_POINTS)):
        where = f"{what}[{index}]"
        values = list(to_items(row, where, most))
        if not 2 <= len(values) <= most:
            raise InputError(f"{where}: {excerpt(row)} is not ({names})")
        yield [to_number(value, f"{where}[{place}]") for place, value in enumerate(values)]


UNITS = {
    "_mm_s": 1e-3,
    "_n_m": 1.0,
    "_mm": 1e-3,
    "_um": 1e-6,
    "_ms": 1e-3,
    "_us": 1e-6,
    "_deg": math.pi / 180,
    "_hz": 1.0,
    "_n": 1.0,
    "_v": 1.0,
}
"""Value in SI of each unit that the name of a field may end with."""


@functools.cache
def _units(message: type[msgspec.Struct]) -> dict[str, tuple[str, float | None]]:
    """Return each field of a message and the value of its unit, by its name without the unit."""
    units = {}
    for field in message.__struct_fields__:
        suffix = next((suffix for suffix in UNITS if field.endswith(suffix)), "")
        units[field.removesuffix(suffix)] = field, UNITS.get(suffix)
    return units


def _scaled(value: Any, unit: float) -> Any:
    """Return a number, or all numbers of nested tuples, times a unit."""
    if isinstance(value, tuple):
        return tuple(_scaled(item, unit) for item in value)
    return value * unit


def to_onset(message: messages.OnsetMessage, offset: float, uncertainty: float) -> Onset:
    """Return the report on a stimulus in SI, on the clock of this program.

    Parameters
    ----------
    message : OnsetMessage
        Report of the server.
    offset : float
        The server's clock less the program's [s].
    uncertainty : float
        Uncertainty of that offset [s].

    Returns
    -------
    Onset
        What became of the stimulus.
    """
    at, onset, half = message.at_us, message.onset_us, message.uncertainty_us
    return Onset(
        message.display,
        at * 1e-6 - offset,
        None if onset is None else onset * 1e-6 - offset,
        None if half is None else half * 1e-6 + uncertainty,
        message.reason,
        message.marker,
        message.client,
    )


def to_telemetry(
    message: messages.TelemetryMessage, offset: float, uncertainty: float
) -> Telemetry:
    """Return telemetry in SI, on the clock of this program.

    Parameters
    ----------
    message : TelemetryMessage
        Telemetry of the server.
    offset : float
        The server's clock less the program's [s].
    uncertainty : float
        Uncertainty of that offset [s].

    Returns
    -------
    Telemetry
        State of the display.
    """
    state = from_message(Telemetry, msgspec.structs.replace(message, samples=None))
    samples = message.samples
    return dataclasses.replace(
        state,
        time=state.time - offset,
        samples=None if samples is None else _to_samples(samples, offset, uncertainty),
    )


def _to_samples(
    message: messages.TelemetrySamples, offset: float, uncertainty: float
) -> CommandedSamples:
    """Return samples in SI, on the clock of this program."""

    def pairs(packed: bytes) -> tuple[Pair, ...]:
        return tuple((x * 1e-3, y * 1e-3) for x, y in struct.iter_unpack("<2f", packed))

    def times(packed: bytes) -> tuple[float, ...]:
        return tuple(time * 1e-6 - offset for (time,) in struct.iter_unpack("<d", packed))

    def numbers(packed: bytes) -> "array[float]":
        values = array("f", packed)
        if sys.byteorder == "big":
            values.byteswap()
        return values

    def rows(packed: bytes | None, unit: float) -> "memoryview[float] | None":
        if not packed:
            return None
        values = numbers(packed)
        if unit != 1:
            values = array("f", map(unit.__mul__, values))
        count = message.block_samples * len(message.touching)
        return memoryview(values).cast("B").cast("f", (count, len(values) // count))

    half = message.uncertainty_us
    return CommandedSamples(
        first=message.first,
        sample_rate=message.sample_rate_hz,
        block_samples=message.block_samples,
        times=times(message.times_us),
        uncertainty=None if half is None else half * 1e-6 + uncertainty,
        finger_times=times(message.finger_times_us),
        position=pairs(message.position_mm),
        velocity=pairs(message.velocity_mm_s),
        normal_force=tuple(numbers(message.normal_force_n)),
        touching=message.touching,
        shear=rows(message.shear_um, 1e-6),
        drive=rows(message.drive_v, 1.0),
    )


def from_message(kind: type[S], message: msgspec.Struct) -> S:
    """Return what a message holds in SI.

    Parameters
    ----------
    kind : type
        Data class whose fields are those of the message, without their units.
    message : Struct
        Message of the server.

    Returns
    -------
    kind
        Values in SI.
    """
    units, values = _units(type(message)), {}
    for name in (field.name for field in dataclasses.fields(kind)):
        field, unit = units[name]
        value = getattr(message, field)
        if isinstance(value, messages.TelemetryFinger):
            value = from_message(FingerState, value)
        elif isinstance(value, messages.TelemetryTrace):
            value = from_message(ShearTrace, value)
        elif isinstance(value, bytes):
            value = struct.unpack(f"<{len(value) // 4}f", value)
        values[name] = value if unit is None or value is None else _scaled(value, unit)
    return kind(**values)
