"""What a program and the playback daemon say to each other, version 1.

One WebSocket at ``/v1``; each message is one object whose ``type`` names it. The subprotocol
``tactile.v1.json`` carries JSON in text frames, ``tactile.v1.msgpack`` MessagePack in binary ones.

A client says `ClientHello` first and is answered with `Welcome`. Requests may carry an ``id``, and
are answered by `Done`, by a message of their own or by `Failure`, each with the same ``id``.
`Contact` is a stream: only what is wrong with it is answered. Fields that a side does not know are
ignored; a message whose ``type`` it does not know is answered by `Failure` ``unknown_type``. What a
message may hold is checked as it is decoded, to the path of the offending field.

Places are in the surface's plane, in millimeters; times are the client's own, in microseconds of a
clock that never steps, and `Ping` tells both sides what lies between their clocks.

**Mixing.** A display has one finger on it. It belongs to the client that touched first, until that
lifts, falls silent for 100 ms, or is gone; who touches meanwhile is heard from then on. What plays
are the textures that the finger's client selected, their shear added up, each with its gain, and
the waveforms of all clients, added to that. Each client's `SetGain` scales all that is its own. The
sum is limited as a whole: its tactile image keeps its shape. An e-stop comes before everything.

Waveforms and effects of all clients have part of a block's time between them. Where it is too
short, clients take turns of a tenth of a second; the time of what is silent goes on. Of an effect
16 transients sound at once. What is left out, a client's block or a transient, is counted as
``dropped_waves``.

The connection is closed with 4400 where the first message is no hello, 4401 for a wrong token, 4406
for another version, 4408 where no hello comes, 4429 where there are too many clients, 4008 for a
flood of failures or a client that does not read, 1009 for what is too large, 1001 at the end.

High voltage is off until a client arms a display, or its configuration does. It belongs to the
clients that armed it, and goes off when the last of them leaves, or shows no sign of life for half
a second.

**E-stop.** Each e-stop of a display has a number. It is latched: the display stays at 0 V, over any
restart of playback, daemon or machine, until a `ClearEstop` names that number. A newer e-stop has
another number, which a `ClearEstop` of the older one does not end.

**Roles.** What a client may do follows from the token it says, or from the user it runs as:
"watch" reads what there is and how it stands, "play" touches, selects and plays, "arm" arms and
clears, "stop" disarms. Every client that is let in may e-stop. `Welcome` tells which roles it has.
"""

from typing import Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta, Struct

API_VERSION = 1
JSON_PROTOCOL, MSGPACK_PROTOCOL = "tactile.v1.json", "tactile.v1.msgpack"
PATH = "/v1"
LARGEST_MESSAGE = 64 * 1024
"""Bytes."""
MOST_LAYERS = 4
"""Textures that a client may have on one display at a time."""
MOST_SAMPLES = 4000
"""Of a waveform in one message, as in XR_FB_haptic_pcm (XR_MAX_HAPTIC_PCM_BUFFER_SIZE_FB)."""
MOST_POINTS = 500
"""Of a parametric effect in one message, as in XR_EXT_haptic_parametric."""
SILENCE = 0.1
"""s after which a client that said it touches is taken to have lifted."""

Id = Annotated[int, Meta(ge=0, le=2**53)]
Name = Annotated[str, Meta(max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._ -]*$(?!\n)")]
Millimeters = Annotated[float, Meta(ge=-1e5, le=1e5)]
Speed = Annotated[float, Meta(ge=-1e4, le=1e4)]
Force = Annotated[float, Meta(ge=0, le=50)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Signed = Annotated[float, Meta(ge=-1, le=1)]
Microseconds = Annotated[int, Meta(ge=-(2**62), le=2**62)]
Micrometers = Annotated[float, Meta(ge=0, le=500)]
Milliseconds = Annotated[float, Meta(ge=0, le=60_000)]
Hertz = Annotated[float, Meta(ge=0, le=1000)]

Role = Literal["watch", "play", "arm", "stop"]
"""What a client may do; see the module's docstring."""
ALL_ROLES: frozenset[Role] = frozenset(get_args(Role))

Code = Literal[
    "malformed", "too_large", "unknown_type", "invalid_field", "unknown_texture", "unknown_display",
    "wrong_version", "unauthorized", "hello_first", "too_many_clients", "too_fast", "not_armed",
    "estopped", "busy", "unavailable", "unsupported", "internal",
]  # fmt: skip
"""Of a `Failure`."""


class ApiMessage(Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="type"):
    """Anything that goes over the connection."""


def kind_of(message: ApiMessage) -> str:
    """Return the ``type`` that names a message on the connection, such as "select"."""
    return str(type(message).__struct_config__.tag)


class Request(ApiMessage, frozen=True, kw_only=True):
    """What a client asks; ``id`` comes back with the answer."""

    id: Id | None = None


class Reply(ApiMessage, frozen=True, kw_only=True):
    """What the daemon answers, with the ``id`` of the request."""

    id: Id | None = None


# What a client says


class ClientHello(Request, frozen=True, kw_only=True, tag="hello"):
    """The first message: who it is, and which version of this API it speaks."""

    client: Annotated[str, Meta(min_length=1, max_length=64)]
    version: int = API_VERSION
    token: Annotated[str, Meta(max_length=256)] = ""


class ListTextures(Request, frozen=True, kw_only=True, tag="list_textures"):
    """Ask for all textures there are."""


class Layer(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One texture of several that lie on each other; ``seed`` draws its realization."""

    texture: Name
    gain: Fraction = 1.0
    seed: Annotated[int, Meta(ge=0, le=2**31 - 1)] = 0


class Select(Request, frozen=True, kw_only=True, tag="select"):
    """What the finger is to feel of this client; none takes it away. Old and new cross-fade."""

    display: Name
    layers: Annotated[tuple[Layer, ...], Meta(max_length=MOST_LAYERS)]


class Contact(ApiMessage, frozen=True, kw_only=True, tag="contact"):
    """Where the finger is at a time of the client's clock, and how hard; 0 N is lifted.

    Velocity is used where it is given; what it says of the next milliseconds is better than what
    places alone tell.
    """

    display: Name
    position_mm: tuple[Millimeters, Millimeters]
    normal_force_n: Force
    time_us: Microseconds | None = None
    velocity_mm_s: tuple[Speed, Speed] | None = None


class Play(Request, frozen=True, kw_only=True, tag="play"):
    """Let this client's textures sound; so it is from the start."""

    display: Name


class StopPlaying(Request, frozen=True, kw_only=True, tag="stop"):
    """Fade out all of this client: its textures, until `Play`, and its waveforms, for good."""

    display: Name


class SetGain(Request, frozen=True, kw_only=True, tag="gain"):
    """Scale all that is this client's."""

    display: Name
    gain: Fraction


class Append(Request, frozen=True, kw_only=True, tag="append"):
    """A waveform of tangential shear, to be played after what is there or in its place.

    As XR_FB_haptic_pcm: what does not fit the buffer is not taken; `AppendedReply` tells how many
    samples were, and the rest is sent again. ``samples`` are −1 … 1 of ``amplitude_um``, a list, or
    with MessagePack also little-endian float32 in a binary field; 4000 at most either way.
    ``contactors`` name those that play it, all where none is named. Without ``append`` what waits
    is dropped first, in any case.
    """

    display: Name
    sample_rate_hz: Annotated[float, Meta(ge=100, le=48_000)]
    amplitude_um: Micrometers
    samples: (
        Annotated[tuple[Signed, ...], Meta(max_length=MOST_SAMPLES)]
        | Annotated[bytes, Meta(max_length=4 * MOST_SAMPLES)]
    )
    append: bool = True
    contactors: Annotated[
        tuple[Annotated[int, Meta(ge=0, le=4095)], ...], Meta(max_length=4096)
    ] = ()


class Point(Struct, frozen=True, array_like=True):
    """A value at a time after the effect's beginning; straight between points."""

    time_ms: Milliseconds
    value: Fraction


class FrequencyPoint(Struct, frozen=True, array_like=True):
    """A frequency at a time after the effect's beginning; straight between points."""

    time_ms: Milliseconds
    frequency_hz: Hertz


class Transient(Struct, frozen=True, array_like=True):
    """A tap: two periods of a sine, the amplitude falling, at a time."""

    time_ms: Milliseconds
    value: Fraction
    frequency_hz: Annotated[float, Meta(ge=20, le=1000)] = 160.0


class PlayEffect(Request, frozen=True, kw_only=True, tag="effect"):
    """Amplitude and frequency over time, as XR_EXT_haptic_parametric; played at once, added.

    It ends with its last point. With ``stream`` it goes on from the last frame of the stream, in
    place of what was still to come, and is held for 50 ms after its last point, then fades.
    """

    display: Name
    amplitude_um: Micrometers
    amplitude: Annotated[tuple[Point, ...], Meta(max_length=MOST_POINTS)] = ()
    frequency: Annotated[tuple[FrequencyPoint, ...], Meta(max_length=MOST_POINTS)] = ()
    transients: Annotated[tuple[Transient, ...], Meta(max_length=MOST_POINTS)] = ()
    stream: bool = False


class ArmDisplay(Request, frozen=True, kw_only=True, tag="arm"):
    """Switch high voltage on, and begin to play. A person is to know of it."""

    display: Name


class DisarmDisplay(Request, frozen=True, kw_only=True, tag="disarm"):
    """Fade out, and switch high voltage off."""

    display: Name


class EStop(Request, frozen=True, kw_only=True, tag="estop"):
    """To 0 V at once, on all displays where none is named, and stay there until `ClearEstop`."""

    display: Name | None = None


class ClearEstop(Request, frozen=True, kw_only=True, tag="clear"):
    """End the e-stop with the number ``estop``, where a person has decided so.

    The display is disarmed then. The number stands in `Done`, `EventMessage`, `StatsReply` and
    `DisplayDescription`.
    """

    display: Name
    estop: Annotated[int, Meta(ge=1, le=2**53)]


class Subscribe(Request, frozen=True, kw_only=True, tag="subscribe"):
    """Ask for `TelemetryMessage` of a display, so many times a second; 0 ends it."""

    display: Name
    rate_hz: Annotated[float, Meta(ge=0, le=100)]


class GetStats(Request, frozen=True, kw_only=True, tag="get_stats"):
    """Ask for a display's `StatsReply`."""

    display: Name


class Ping(Request, frozen=True, kw_only=True, tag="ping"):
    """Ask what time it is there; ``time_us`` comes back."""

    time_us: Microseconds


# What the daemon says


class DisplayDescription(Struct, frozen=True, kw_only=True):
    """A display: its contactors (N, 2), limits, and what its link takes.

    ``latency_ms`` is from a contact message to the skin, about; ``waveforms`` whether the link has
    room for samples, without which `Append` and `PlayEffect` are unsupported; ``estop`` the number
    of the e-stop that holds, 0 where none does, ``latest_estop`` that of the latest, also if
    cleared.
    """

    name: str
    contactors_mm: tuple[tuple[float, float], ...]
    shear_direction_deg: tuple[float, ...]
    sample_rate_hz: float
    voltage_limit_v: float
    waveforms: bool
    latency_ms: float
    estop: int = 0
    latest_estop: int = 0


class Welcome(Reply, frozen=True, kw_only=True, tag="welcome"):
    """The answer to `ClientHello`."""

    server: str
    version: int
    session: str
    displays: tuple[DisplayDescription, ...]
    may_arm: bool
    time_us: Microseconds
    roles: tuple[Role, ...] = ()
    largest_message: int = LARGEST_MESSAGE
    messages_per_second: int = 0


class TextureInfo(Struct, frozen=True, kw_only=True):
    """A texture that may be selected."""

    name: str
    category: str
    description: str
    provenance: str


class Textures(Reply, frozen=True, kw_only=True, tag="textures"):
    """The answer to `ListTextures`."""

    textures: tuple[TextureInfo, ...]


class Done(Reply, frozen=True, kw_only=True, tag="done"):
    """It was done; of an `EStop`, ``estops`` holds the number that was latched by display."""

    estops: dict[str, int] = {}


class AppendedReply(Reply, frozen=True, kw_only=True, tag="appended"):
    """How many samples of an `Append` were taken, and for how long what waits will play."""

    samples_consumed: int
    buffered_ms: float


class Pong(Reply, frozen=True, kw_only=True, tag="pong"):
    """The answer to `Ping`: its time, and the daemon's when it came."""

    time_us: Microseconds
    server_time_us: Microseconds


class StatsReply(Reply, frozen=True, kw_only=True, tag="stats"):
    """How a display stands. ``counters`` hold what a bus and playback count.

    ``state`` is "disarmed", "armed", "estopped" or "lost" (its playback died and is restarted);
    ``link`` "up" or "down"; ``owner`` whether the finger is this client's; ``estop`` the number of
    the e-stop that holds, 0 where none does.
    """

    display: str
    state: Literal["disarmed", "armed", "estopped", "lost"]
    link: Literal["up", "down"]
    detail: str
    touching: bool
    owner: bool
    latency_ms: float
    counters: dict[str, int]
    estop: int = 0


class Failure(Reply, frozen=True, kw_only=True, tag="failure"):
    """What was wrong, where (``field`` as a path), in one line."""

    code: Code
    message: str
    field: str = ""


class EventMessage(ApiMessage, frozen=True, kw_only=True, tag="event"):
    """Something that a client should know: a change of state, a fault, an underrun.

    Kinds are "armed", "disarmed", "estopped" (with its number ``estop``), "cleared", "fault",
    "underrun", "link", "silent" (a client gave no sign of life, and its waveforms faded), "lost"
    (playback died and is started again) and "textures" (they were read again); more may come.
    """

    display: str
    kind: str
    detail: str = ""
    estop: int = 0


class TelemetryMessage(ApiMessage, frozen=True, kw_only=True, tag="telemetry"):
    """What a display does: shear [µm] and drive [V] of each contactor, where the finger is.

    The time is the daemon's.
    """

    display: str
    time_us: Microseconds
    state: str
    position_mm: tuple[float, float]
    velocity_mm_s: tuple[float, float]
    normal_force_n: float
    shear_um: tuple[float, ...]
    drive_v: tuple[float, ...]
    counters: dict[str, int]


Command = (
    ClientHello | ListTextures | Select | Contact | Play | StopPlaying | SetGain | Append
    | PlayEffect | ArmDisplay | DisarmDisplay | EStop | ClearEstop | Subscribe | GetStats | Ping
)  # fmt: skip
Answer = (
    Welcome | Textures | Done | AppendedReply | Pong | StatsReply | Failure | EventMessage
    | TelemetryMessage
)  # fmt: skip


def schema() -> dict[str, Any]:
    """Return the JSON Schema of all that may be said, in ``$defs`` by the name of its class."""
    (client, server), components = msgspec.json.schema_components(
        (Command, Answer), ref_template="#/$defs/{name}"
    )
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"tactile API {API_VERSION}",
        "client": client,
        "server": server,
        "$defs": components,
    }
