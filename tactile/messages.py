"""Messages between a client and the playback server, API version 1.

A client opens one WebSocket at ``/v1``. Each message is one object whose field ``type`` names it.
The subprotocol ``tactile.v1.json`` carries JSON in text frames, ``tactile.v1.msgpack`` carries
MessagePack in binary frames.

The first message of a client is `ClientHello`, which the server answers with `Welcome`. Every
request may carry an ``id``. It is answered by `Done`, by a reply of its own type or by `Failure`,
each with the same ``id``. `Contact` and `TactileFrames` are streams: one of their messages is
answered only if something is wrong with it, and none waits for a request. Either side ignores
fields that it does not know; a message of an unknown ``type`` is answered by a `Failure` with the
code ``unknown_type``. The contents of a message are validated while it is decoded, and a `Failure`
names the path of the offending field.

Positions are in the plane of the surface, in millimeters. Times that a client sends are in
microseconds of its own monotonic clock; the server maps those of `Contact` to its clock by the
times at which they arrive. `Ping` lets a client measure the offset between both clocks.

**Mixing.** A display has one finger on it. The finger belongs to the client that touched first,
until that client lifts it, sends no contact for 100 ms, or disconnects. Contacts of other clients
are ignored until then. The display plays the textures that the owner of the finger selected, each
with its gain, added up; the waveforms of all clients are added to that. `SetGain` scales everything
that its client plays. The sum is limited as a whole, so that the tactile image keeps its shape. An
e-stop takes precedence over everything else.

The waveforms, effects and tactile frames of all clients share a fixed part of the computing time of
a block. If it does not suffice, clients take turns of a tenth of a second; what is silent meanwhile
still advances in time. At most 16 transients of one effect sound at once. Blocks of a client's
waves, and transients, that were left out are counted as ``dropped_waves``.

**Closing.** The server closes a connection with one of these codes:

- 1001: the server ends
- 1002: the client offered no subprotocol of this API
- 1009: a message was too large
- 1011: an internal failure of the server
- 4008: a flood of failures, or a client that does not read its messages
- 4400: the first message was not a `ClientHello`
- 4401: wrong token
- 4406: the client asked for another version of the API
- 4408: no `ClientHello` arrived in time
- 4429: too many clients

**High voltage.** It is off until a client arms a display, or the server's configuration does. It
belongs to the clients that armed the display, and is switched off when the last of them disconnects
or has given no sign of life for half a second.

**E-stop.** Each e-stop of a display has a number. It is latched: the display stays at 0 V, across
restarts of playback, server and machine, until a `ClearEstop` names that number. A newer e-stop has
another number, so that a `ClearEstop` of an older one does not end it.

**Roles.** What a client may do follows from the token in its `ClientHello`, or from the user that
it runs as. Every client that is admitted may trigger an e-stop and read displays, textures and
states. "watch" allows no more than that on this connection; it is the role that reading the
server's metrics over HTTP requires. "play" touches, selects and plays, "arm" arms, disarms and
clears e-stops, "stop" disarms. `Welcome` lists the roles of the client.
"""

from typing import Annotated, Any, Literal, get_args

import msgspec
from msgspec import Meta, Struct

API_VERSION = 1
"""Version of the API that `ClientHello` and `Welcome` carry."""
JSON_PROTOCOL = "tactile.v1.json"
"""WebSocket subprotocol of messages in JSON."""
MSGPACK_PROTOCOL = "tactile.v1.msgpack"
"""WebSocket subprotocol of messages in MessagePack."""
PATH = "/v1"
"""Path of the WebSocket in the server's URL."""
LARGEST_MESSAGE = 64 * 1024
"""Largest size of a message [bytes]."""
MOST_LAYERS = 4
"""Maximum number of textures that one client may select on one display at a time."""
MOST_SAMPLES = 4000
"""Maximum number of samples of a waveform in one message, as in XR_FB_haptic_pcm
(XR_MAX_HAPTIC_PCM_BUFFER_SIZE_FB)."""
MOST_FRAME_VALUES = 12_000
"""Maximum number of values of the tactile frames in one message, which fits in `LARGEST_MESSAGE` in
base64 too."""
MOST_POINTS = 500
"""Maximum number of points of each curve of a parametric effect in one message, as in
XR_EXT_haptic_parametric."""
SILENCE = 0.1
"""Time without a contact after which a touching client is taken to have lifted its finger [s]."""

Id = Annotated[int, Meta(ge=0, le=2**53)]
"""Identifier of a request, chosen by the client."""
Name = Annotated[str, Meta(max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._ -]*$(?!\n)")]
"""Name of a display or texture."""
Millimeters = Annotated[float, Meta(ge=-1e5, le=1e5)]
"""Coordinate in the plane of the surface [mm]."""
Speed = Annotated[float, Meta(ge=-1e4, le=1e4)]
"""Component of the finger's velocity [mm/s]."""
Force = Annotated[float, Meta(ge=0, le=50)]
"""Normal force [N]."""
Fraction = Annotated[float, Meta(ge=0, le=1)]
"""Number from 0 to 1."""
Signed = Annotated[float, Meta(ge=-1, le=1)]
"""Number from −1 to 1."""
Microseconds = Annotated[int, Meta(ge=-(2**62), le=2**62)]
"""Time on a monotonic clock [µs]."""
Micrometers = Annotated[float, Meta(ge=0, le=500)]
"""Amplitude of shear [µm]."""
Milliseconds = Annotated[float, Meta(ge=0, le=60_000)]
"""Time since the beginning of an effect [ms]."""
Hertz = Annotated[float, Meta(ge=0, le=1000)]
"""Frequency of an effect [Hz]."""

MarkerCode = Annotated[int, Meta(ge=0, le=255)]
"""Code of marker lines, line k being bit k; 0 for none."""
FARTHEST = 60.0
"""Time by which the time of a `BeginAt` may be ahead [s]."""
Seed = Annotated[int, Meta(ge=0, le=2**31 - 1)]
"""Seed of the random realization of a texture."""
PixelCount = Annotated[int, Meta(ge=1, le=4096)]
"""Number of pixels along one side of a picture."""
MOST_PIXELS = 1 << 18
"""Maximum number of pixels of a picture."""

Role = Literal["watch", "play", "arm", "stop"]
"""Permission of a client; the module docstring says what each role allows."""
ALL_ROLES: frozenset[Role] = frozenset(get_args(Role))
"""Set of all roles."""

Code = Literal[
    "malformed", "too_large", "unknown_type", "invalid_field", "unknown_texture", "unknown_effect",
    "unknown_display",
    "wrong_version", "unauthorized", "hello_first", "too_many_clients", "too_fast", "not_armed",
    "estopped", "busy", "unavailable", "unsupported", "internal",
]  # fmt: skip
"""Kind of a `Failure`."""


class ApiMessage(Struct, frozen=True, kw_only=True, omit_defaults=True, tag_field="type"):
    """Base class of every message on the connection."""


def kind_of(message: ApiMessage) -> str:
    """Return the ``type`` that names a message on the connection, such as "select".

    Parameters
    ----------
    message : ApiMessage
        Any message of this API.

    Returns
    -------
    str
        Value of the message's ``type`` field.
    """
    return str(type(message).__struct_config__.tag)


def id_of(message: ApiMessage) -> int | None:
    """Return the id of a message.

    Parameters
    ----------
    message : ApiMessage
        Any message.

    Returns
    -------
    int or None
        Id of the request or reply; None without one, as in a `Contact`.
    """
    number: int | None = getattr(message, "id", None)
    return number


class Request(ApiMessage, frozen=True, kw_only=True):
    """Base class of every message of a client that the server answers.

    Attributes
    ----------
    id : int or None
        Identifier chosen by the client, which the answer repeats.
    """

    id: Id | None = None


class DisplayRequest(Request, frozen=True, kw_only=True):
    """Base class of every request that is about one display.

    Attributes
    ----------
    display : str
        Name of the display.
    """

    display: Name


class Reply(ApiMessage, frozen=True, kw_only=True):
    """Base class of every answer of the server.

    Attributes
    ----------
    id : int or None
        Identifier of the request that is answered.
    """

    id: Id | None = None


# Messages of a client


class ClientHello(Request, frozen=True, kw_only=True, tag="hello"):
    """First message of a client: its name, the API version that it speaks, and its token.

    It is answered by `Welcome`, or by a `Failure` after which the server closes the connection.

    Attributes
    ----------
    client : str
        Name of the program, for logs and for the reason of an e-stop.
    version : int
        Version of the API that the client speaks.
    token : str
        Token that the server's configuration knows; it determines the roles of the client. Empty if
        the client has none.
    """

    client: Annotated[str, Meta(min_length=1, max_length=64)]
    version: int = API_VERSION
    token: Annotated[str, Meta(max_length=256)] = ""


class ListTextures(Request, frozen=True, kw_only=True, tag="list_textures"):
    """Ask for all textures that can be selected; answered by `Textures`."""


class DrawTexture(Request, frozen=True, kw_only=True, tag="draw_texture"):
    """Ask for a picture of a texture's surface; answered by `TexturePicture`.

    A picture may take a second. It does not delay other requests of the client, so that answers may
    come in another order, and it waits for textures that are being prepared.

    Attributes
    ----------
    texture : str
        Name of a texture, as listed in `Textures`.
    seed : int
        Seed of the random realization, as in `Layer`.
    left_mm : float
        Coordinate x of the left edge of the picture [mm].
    bottom_mm : float
        Coordinate y of the lower edge [mm].
    pixel_mm : float
        Side of a pixel [mm]; a pixel is the mean over its area.
    columns : int
        Number of pixels along x.
    rows : int
        Number of pixels along y; with the columns at most 262 144 pixels in all.
    """

    texture: Name
    seed: Seed = 0
    left_mm: Millimeters
    bottom_mm: Millimeters
    pixel_mm: Annotated[float, Meta(ge=1e-3, le=10)]
    columns: PixelCount
    rows: PixelCount


class Layer(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """One of the textures that a client superimposes.

    Attributes
    ----------
    texture : str
        Name of a texture, as listed in `Textures`.
    gain : float
        Factor of the texture's amplitude, 0 to 1. What 1 is, the key `levels` of the server's
        configuration says: by default the largest that the limits of the display leave unchanged.
    seed : int
        Seed of the random realization of the texture; the same seed gives the same surface.
    """

    texture: Name
    gain: Fraction = 1.0
    seed: Seed = 0


class Select(DisplayRequest, frozen=True, kw_only=True, tag="select"):
    """Select the textures that the finger feels of this client; requires the role "play".

    They replace the client's earlier selection in a cross-fade. `Done` follows once the textures
    are ready; preparing one may take a second.

    Attributes
    ----------
    layers : list of Layer
        Textures to superimpose; an empty list deselects all.
    """

    layers: Annotated[tuple[Layer, ...], Meta(max_length=MOST_LAYERS)]


class Contact(ApiMessage, frozen=True, kw_only=True, tag="contact"):
    """Report where the finger is and how hard it presses; requires the role "play".

    It is not a request: it has no ``id``, and only a contact that cannot be used is answered, by a
    `Failure`. Send one per frame.

    Attributes
    ----------
    display : str
        Name of the display.
    position_mm : pair of float
        Position x, y of the finger on the surface [mm].
    normal_force_n : float
        Normal force [N]; 0 lifts the finger.
    time_us : int or None
        Time at which the finger was there, on the client's monotonic clock [µs]. Without it, the
        time of arrival is used.
    velocity_mm_s : pair of float or None
        Velocity of the finger [mm/s]. If it is given, it is used to predict the next milliseconds,
        which is more accurate than a prediction from positions alone.
    """

    display: Name
    position_mm: tuple[Millimeters, Millimeters]
    normal_force_n: Force
    time_us: Microseconds | None = None
    velocity_mm_s: tuple[Speed, Speed] | None = None


class Resume(DisplayRequest, frozen=True, kw_only=True, tag="play"):
    """Resume this client's textures after `StopPlaying`; requires the role "play".

    The textures of a new client sound without it.
    """


class StopPlaying(DisplayRequest, frozen=True, kw_only=True, tag="stop"):
    """Fade out everything that this client plays; requires the role "play".

    Its textures are silent until `Resume`. Its waveforms and effects are discarded.
    """


class SetGain(DisplayRequest, frozen=True, kw_only=True, tag="gain"):
    """Scale everything that this client plays on a display; requires the role "play".

    Attributes
    ----------
    gain : float
        Factor of textures, waveforms and effects, 0 to 1.
    """

    gain: Fraction


class BeginAt(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Time at which a waveform, an effect or tactile frames are to begin.

    It begins with the sample that is nearest to the time. What became of it, an `OnsetMessage`
    reports, unless the answer was a failure.

    Attributes
    ----------
    at_us : int
        Time of the server's monotonic clock at which the first sample is to be put out, at most
        60 s ahead [µs].
    drop_late : bool
        Whether it is dropped if that is not possible, because the time has passed or the contactors
        still play a waveform of this client. If not, it begins as soon as possible.
    number : int
        Number chosen by the client, which the `OnsetMessage` repeats.
    marker : int
        Code that the marker lines of the amplifier take with the first sample, for 10 ms, below 2
        to the power of `DisplayDescription.marker_lines`; 0 for none.
    """

    at_us: Microseconds
    drop_late: bool = False
    number: Id = 0
    marker: MarkerCode = 0


class Append(DisplayRequest, frozen=True, kw_only=True, tag="append"):
    """Queue a waveform of tangential shear; requires the role "play" and an armed display.

    It follows XR_FB_haptic_pcm: samples that do not fit in the client's buffer are not taken.
    `AppendedReply` tells how many were taken; the client sends the rest again. Each contactor has a
    queue of its own, and a waveform of several contactors begins on all of them at once, when the
    last one is free.

    Attributes
    ----------
    sample_rate_hz : float
        Rate of the samples [Hz]; the server resamples them to the rate of the display.
    amplitude_um : float
        Shear that a sample of 1 stands for [µm].
    samples : list of float, or bytes
        Samples from −1 to 1, at most 4000: a list of numbers, or little-endian float32 as a binary
        field of MessagePack (a base64 string in JSON).
    append : bool
        Whether to play the samples after those that are queued. If false, what is queued for the
        same contactors is dropped first, even if none of the new samples is taken.
    contactors : list of int
        Indices of the contactors that play the waveform; all if the list is empty.
    begin : BeginAt or null
        Time at which it is to begin; null for as soon as the contactors are free. Of a waveform
        that has a time, a second is taken, and what is appended without one does not wait for it.
    """

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
    begin: BeginAt | None = None


class TactileFrames(ApiMessage, frozen=True, kw_only=True, tag="frames"):
    """Stream tactile frames; requires the role "play".

    A tactile frame is the shear of every contactor at one instant. It is not a request: it has no
    ``id``, and only frames that cannot be used are answered, by a `Failure`. Frames that come while
    the display is not armed, after `StopPlaying`, or faster than they are played, are not played,
    and are counted as ``dropped_frames``. If a frame comes too late, the one before it is held,
    which is counted as ``frame_gaps``; if no frame comes any more, the stream fades out within a
    tenth of a second. A client has one stream on a display: frames of another rate, or with
    another ``latest``, replace it.

    If the frames have times, they are played at a constant delay after their source made them,
    however unevenly they come. A frame that comes after its time is dropped. Where the times of two
    messages do not follow each other, to within 1 ms, the signal fades out and in.

    Attributes
    ----------
    display : str
        Name of the display.
    frame_rate_hz : float
        Rate of the frames [Hz].
    amplitude_um : float
        Shear that a value of 1 stands for [µm].
    frames : list of float, or bytes
        Values from −1 to 1, frame by frame, each with one value for every contactor, at most 12 000
        in all: a list of numbers, or little-endian float32 as a binary field of MessagePack (a
        base64 string in JSON).
    latest : bool
        Whether only the newest frame counts: the signal moves to it in a straight line, within the
        period of the frames, as soon as it comes. If false, every frame is played, in a
        band-limited signal (up to 0.32 of the rate), which follows the clock of the source. It is
        four frames and 3 ms behind the frames as they come, more if the source is not even.
    begin : BeginAt or null
        Time at which the first of the frames is to be played, in a stream that replaces the one
        before; null for frames that continue a stream: one of the same rate that waits for its
        time, else the one that plays.
    time_us : int or null
        Time of the server's monotonic clock at which the first of the frames is to be put out, at
        most a second ahead, in a stream whose frames all have times; null for frames that are
        played as they come [µs].
    """

    display: Name
    frame_rate_hz: Annotated[float, Meta(ge=100, le=192_000)]
    amplitude_um: Micrometers
    frames: (
        Annotated[tuple[Signed, ...], Meta(max_length=MOST_FRAME_VALUES)]
        | Annotated[bytes, Meta(max_length=4 * MOST_FRAME_VALUES)]
    )
    latest: bool = False
    begin: BeginAt | None = None
    time_us: Microseconds | None = None


class Point(Struct, frozen=True, array_like=True):
    """Amplitude at a time, an array [time_ms, value]; linear between points.

    Attributes
    ----------
    time_ms : float
        Time since the beginning of the effect [ms].
    value : float
        Amplitude relative to the ``amplitude_um`` of the effect, 0 to 1.
    """

    time_ms: Milliseconds
    value: Fraction


class FrequencyPoint(Struct, frozen=True, array_like=True):
    """Frequency at a time, an array [time_ms, frequency_hz]; linear between points.

    Attributes
    ----------
    time_ms : float
        Time since the beginning of the effect [ms].
    frequency_hz : float
        Frequency [Hz].
    """

    time_ms: Milliseconds
    frequency_hz: Hertz


class Transient(Struct, frozen=True, array_like=True):
    """Tap at a time, an array [time_ms, value, frequency_hz]: two periods of a decaying sine.

    Attributes
    ----------
    time_ms : float
        Time since the beginning of the effect [ms].
    value : float
        Amplitude relative to the ``amplitude_um`` of the effect, 0 to 1.
    frequency_hz : float
        Frequency of the sine [Hz].
    """

    time_ms: Milliseconds
    value: Fraction
    frequency_hz: Annotated[float, Meta(ge=20, le=1000)] = 160.0


class PlayEffect(DisplayRequest, frozen=True, kw_only=True, tag="effect"):
    """Play an effect given by curves of amplitude and frequency over time.

    It requires the role "play" and an armed display, and follows XR_EXT_haptic_parametric. The
    effect starts at once on all contactors, is added to the client's textures and waveforms, and
    replaces an earlier effect of the client. It ends with its last point of amplitude or its last
    transient. Times must not descend within a curve.

    Attributes
    ----------
    amplitude_um : float
        Shear that a value of 1 stands for [µm].
    amplitude : list of Point
        Amplitude over time; without points, only the transients sound.
    frequency : list of FrequencyPoint
        Frequency over time; without points, it is 160 Hz.
    transients : list of Transient
        Taps that are added, in any order.
    stream : bool
        Whether this is a frame of a stream. It then takes over from the frame before it, in place
        of what was still to come of that, and its last amplitude is held for 50 ms before it fades.
    begin : BeginAt or null
        Time at which it is to begin; null for at once.
    """

    amplitude_um: Micrometers
    amplitude: Annotated[tuple[Point, ...], Meta(max_length=MOST_POINTS)] = ()
    frequency: Annotated[tuple[FrequencyPoint, ...], Meta(max_length=MOST_POINTS)] = ()
    transients: Annotated[tuple[Transient, ...], Meta(max_length=MOST_POINTS)] = ()
    stream: bool = False
    begin: BeginAt | None = None


class ListEffects(Request, frozen=True, kw_only=True, tag="list_effects"):
    """Ask for all effects that can be played by name; answered by `Effects`."""


class PlayNamedEffect(DisplayRequest, frozen=True, kw_only=True, tag="play_effect"):
    """Play an effect of the server; requires the role "play" and an armed display.

    It starts at once on all contactors, in place of the client's queued waveform, and is added to
    everything else that plays.

    Attributes
    ----------
    effect : str
        Name of an effect, as listed in `Effects`.
    gain : float
        Factor of the effect's amplitude, 0 to 1.
    begin : BeginAt or null
        Time at which it is to begin; null for at once.
    """

    effect: Name
    gain: Fraction = 1.0
    begin: BeginAt | None = None


class ArmDisplay(DisplayRequest, frozen=True, kw_only=True, tag="arm"):
    """Switch high voltage on and start playing; requires the role "arm".

    Only do so if the person at the display knows of it. The client owns the high voltage from then
    on.
    """


class DisarmDisplay(DisplayRequest, frozen=True, kw_only=True, tag="disarm"):
    """Fade out and switch high voltage off, whoever armed; requires the role "arm" or "stop"."""


class EStop(Request, frozen=True, kw_only=True, tag="estop"):
    """Drive displays to 0 V at once and latch the e-stop until `ClearEstop`; requires no role.

    `Done` holds the number of the e-stop of each display.

    Attributes
    ----------
    display : str or None
        Name of the display; all displays if there is none.
    """

    display: Name | None = None


class ClearEstop(DisplayRequest, frozen=True, kw_only=True, tag="clear"):
    """End an e-stop, after a person has decided that it is safe; requires the role "arm".

    The display is disarmed afterwards. If a newer e-stop holds, the answer is a `Failure` with the
    code ``estopped``.

    Attributes
    ----------
    estop : int
        Number of the e-stop, as in `Done`, `EventMessage`, `StatsReply` and `DisplayDescription`.
    """

    estop: Annotated[int, Meta(ge=1, le=2**53)]


class Subscribe(DisplayRequest, frozen=True, kw_only=True, tag="subscribe"):
    """Ask for a `TelemetryMessage` of a display at a regular rate.

    It replaces the client's earlier subscription to that display.

    Attributes
    ----------
    rate_hz : float
        Messages per second [Hz]; 0 ends the subscription.
    contactor : int or null
        Contactor whose commanded shear the messages hold sample by sample; null for none.
    samples : bool
        Whether the messages hold `TelemetrySamples` of all contactors; more messages come than
        ``rate_hz`` says if these do not fit. The client then also gets an `OnsetMessage` for what
        other clients play at a time.
    """

    rate_hz: Annotated[float, Meta(ge=0, le=100)]
    contactor: Annotated[int, Meta(ge=0, le=4095)] | None = None
    samples: bool = False


class GetStats(DisplayRequest, frozen=True, kw_only=True, tag="get_stats"):
    """Ask for the state of a display; answered by `StatsReply`."""


class Ping(Request, frozen=True, kw_only=True, tag="ping"):
    """Ask for the server's time; answered by `Pong`.

    Attributes
    ----------
    time_us : int
        Time of the client, which `Pong` repeats [µs].
    """

    time_us: Microseconds


# Messages of the server


class DisplayDescription(Struct, frozen=True, kw_only=True):
    """Properties of a display, and the state of its e-stop when the description was made.

    Attributes
    ----------
    name : str
        Name of the display, as used in all requests.
    contactors_mm : list of pair of float
        Positions x, y of the contactors under the finger [mm].
    shear_direction_deg : list of float
        Direction in which each contactor shears the skin, counterclockwise from x [°].
    sample_rate_hz : float
        Rate of the drive [Hz].
    voltage_limit_v : float
        Limit of the drive [V].
    waveforms : bool
        Whether the link carries samples. If false, `Append`, `PlayEffect` and `TactileFrames` are
        unsupported.
    latency_ms : float
        Approximate latency from a contact message to the skin [ms].
    estop : int
        Number of the e-stop that holds, 0 if none does.
    latest_estop : int
        Number of the latest e-stop, cleared or not; 0 if there has been none.
    follows : bool
        Whether playback follows the finger, so that `TelemetryMessage` has the loads that it finds.
    threshold_um : list of pair of float
        Pairs of a frequency [Hz] and the peak of a shear of that frequency that is just felt [µm],
        in third octaves; linear between them in the logarithms.
    marker_lines : int
        Number of marker lines of its amplifier; 0 for none.
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
    follows: bool = False
    threshold_um: tuple[tuple[float, float], ...] = ()
    marker_lines: int = 0


class Welcome(Reply, frozen=True, kw_only=True, tag="welcome"):
    """Answer to `ClientHello`: the client is admitted.

    Attributes
    ----------
    server : str
        Name and version of the server.
    version : int
        Version of the API.
    session : str
        Identifier of this connection in the server's log.
    displays : list of DisplayDescription
        Displays of the server.
    may_arm : bool
        Whether the client has the role "arm".
    time_us : int
        Time of the server's monotonic clock [µs].
    roles : list of str
        Roles of the client.
    largest_message : int
        Largest message that the server accepts [bytes].
    messages_per_second : int
        Maximum rate of messages of this client [1/s]; 0 if it is not limited.
    """

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
    """Description of a texture that can be selected.

    Attributes
    ----------
    name : str
        Name that `Select` takes.
    category : str
        Category, such as "wood".
    description : str
        Description for people.
    provenance : str
        Source of the texture's parameters.
    """

    name: str
    category: str
    description: str
    provenance: str


class Textures(Reply, frozen=True, kw_only=True, tag="textures"):
    """Answer to `ListTextures`.

    Attributes
    ----------
    textures : list of TextureInfo
        All textures of the server.
    """

    textures: tuple[TextureInfo, ...]


class TexturePicture(Reply, frozen=True, kw_only=True, tag="texture_picture"):
    """Answer to `DrawTexture`: displacement of the surface in 256 steps.

    Attributes
    ----------
    lowest_um : float
        Displacement that the value 0 stands for, at the texture's reference speed and force [µm].
    highest_um : float
        Displacement that the value 255 stands for [µm].
    pixels : bytes
        Displacement of each pixel, row by row from the largest y (a base64 string in JSON). Half a
        percent of the pixels is clipped at either end.
    """

    lowest_um: float
    highest_um: float
    pixels: bytes


class EffectInfo(Struct, frozen=True, kw_only=True):
    """Description of an effect that can be played by name.

    Attributes
    ----------
    name : str
        Name that `PlayNamedEffect` takes.
    description : str
        Description for people.
    seconds : float
        Duration [s].
    """

    name: str
    description: str
    seconds: float


class Effects(Reply, frozen=True, kw_only=True, tag="effects"):
    """Answer to `ListEffects`.

    Attributes
    ----------
    effects : list of EffectInfo
        All effects of the server.
    """

    effects: tuple[EffectInfo, ...]


class Done(Reply, frozen=True, kw_only=True, tag="done"):
    """Answer to a request that was carried out and has no reply of its own.

    Attributes
    ----------
    estops : dict of str to int
        After an `EStop`, the number of the e-stop that was latched, by name of the display.
    """

    estops: dict[str, int] = {}


class AppendedReply(Reply, frozen=True, kw_only=True, tag="appended"):
    """Answer to `Append`.

    Attributes
    ----------
    samples_consumed : int
        Number of samples that were taken, counted from the first.
    buffered_ms : float
        Playing time of what is queued for these contactors of this client [ms].
    """

    samples_consumed: int
    buffered_ms: float


class Pong(Reply, frozen=True, kw_only=True, tag="pong"):
    """Answer to `Ping`.

    Attributes
    ----------
    time_us : int
        Time in the `Ping` [µs].
    server_time_us : int
        Time of the server's monotonic clock when the `Ping` arrived [µs].
    """

    time_us: Microseconds
    server_time_us: Microseconds


class StatsReply(Reply, frozen=True, kw_only=True, tag="stats"):
    """Answer to `GetStats`: the state of a display.

    Attributes
    ----------
    display : str
        Name of the display.
    state : str
        "disarmed", "armed", "estopped" or "lost". "lost" means that the playback process died and
        is being restarted.
    link : str
        "up" or "down".
    detail : str
        Reason of a failure or of the e-stop in one line; otherwise the status of the device.
    touching : bool
        Whether a finger touches the display.
    owner : bool
        Whether the finger belongs to this client.
    latency_ms : float or null
        Present latency from the arrival of a contact message to the skin: the lead, what the link
        adds and half a block, whether or not a finger touches; null while nothing plays [ms].
    counters : dict of str to int
        Counters of the device's bus and of playback since it started, by name.
    estop : int
        Number of the e-stop that holds, 0 if none does.
    put_out_share : float or null
        Share that was put out of what was due since the display was armed, from 0 to 1, as far as
        its amplifiers have reported; null if nothing was due.
    lead_ms : float or null
        Time by which drive is sent before it is put out, the part of the latency that bridges
        delays of the link [ms]; null as long as the device is not open.
    """

    display: str
    state: Literal["disarmed", "armed", "estopped", "lost"]
    link: Literal["up", "down"]
    detail: str
    touching: bool
    owner: bool
    latency_ms: float | None
    counters: dict[str, int]
    estop: int = 0
    put_out_share: float | None = None
    lead_ms: float | None = None


class Failure(Reply, frozen=True, kw_only=True, tag="failure"):
    """Answer to a message that could not be carried out.

    Codes: "malformed" (the message cannot be decoded), "too_large", "unknown_type",
    "invalid_field", "unknown_texture", "unknown_effect", "unknown_display", "wrong_version",
    "unauthorized" (wrong token, or a role is missing), "hello_first" (`ClientHello` is missing),
    "too_many_clients", "too_fast" (messages were dropped because there were too many per second),
    "not_armed", "estopped" (an e-stop holds), "busy" (too many requests or textures of this client
    are pending), "unavailable" (the display, its device or a texture cannot be used now),
    "unsupported" and "internal" (a fault of the server).

    Attributes
    ----------
    code : str
        Kind of the failure, one of those above.
    message : str
        Explanation in one line.
    field : str
        Path of the offending field in the message, such as "layers[0].texture"; empty if no field
        is to blame.
    """

    code: Code
    message: str
    field: str = ""


class EventMessage(ApiMessage, frozen=True, kw_only=True, tag="event"):
    """Event on a display, sent to all clients without a request.

    Kinds are "armed", "disarmed", "estopped", "cleared" (an e-stop was cleared), "fault",
    "underrun", "link" (the link went up or down), "silent" (this client gave no sign of life and
    its waveforms were faded), "lost" (playback died and is being restarted) and "textures" (the
    textures were read again). Clients that have subscribed to the telemetry of a display that
    follows the finger also get "touched" and "lifted" (a finger is on contactors now, or not any
    more). Other kinds may be added.

    Attributes
    ----------
    display : str
        Name of the display.
    kind : str
        Kind of the event.
    detail : str
        Explanation in one line.
    estop : int
        Number of the e-stop that an "estopped" or "cleared" event is about, otherwise 0.
    contactors : list of int
        Contactors that a "touched" or "lifted" event is about, in ascending order.
    """

    display: str
    kind: str
    detail: str = ""
    estop: int = 0
    contactors: tuple[int, ...] = ()


class OnsetMessage(ApiMessage, frozen=True, kw_only=True, tag="onset"):
    """Report on a waveform, an effect or tactile frames that were to begin at a time.

    It comes a third of a second after that, when the amplifier has reported what it put out.

    Attributes
    ----------
    display : str
        Name of the display.
    number : int
        Number that the client gave it in `BeginAt`.
    client : int or null
        Number of the client that plays it; null if it is the client that gets this message.
    at_us : int
        Time at which it was to begin, as in `BeginAt` [µs].
    onset_us : float or null
        Time of the server's monotonic clock at which its first sample was put out, by the clock of
        the amplifier; null if it was not [µs].
    uncertainty_us : float or null
        Half of the interval around ``onset_us`` that holds the true time; null if it is not known,
        as on a sound card [µs].
    reason : str
        Reason in one line why it did not begin, or not at its time, or without its marker; empty if
        all was as it should be.
    marker : int
        Code that the marker lines have shown with its first sample, as far as the amplifier has
        confirmed that; 0 for none.
    """

    display: str
    number: int
    at_us: Microseconds
    onset_us: float | None
    uncertainty_us: float | None
    reason: str = ""
    marker: int = 0
    client: int | None = None


class TelemetryFinger(Struct, frozen=True, kw_only=True):
    """Loads of a finger on the contactors, as playback finds them from their currents.

    Attributes
    ----------
    touching : list of bool
        Whether a finger is on each contactor.
    stiffness_n_m : list of float
        Magnitude of the dynamic stiffness of the load on each contactor at 100 Hz; 0 in air [N/m].
    equalizer_error_db : list of float
        Standard deviation of the level of each contactor's shear that follows from the uncertainty
        of its load; 0 in air [dB].
    explained : list of bool
        Whether a load explains the current of each contactor. Where none does, filters for a mean
        finger play.
    guarded : list of bool
        Whether the guard of an amplifier has turned each contactor down, because it lost the
        finger. It comes back as soon as what plays is harmless to a bender in air.
    """

    touching: tuple[bool, ...]
    stiffness_n_m: tuple[float, ...]
    equalizer_error_db: tuple[float, ...]
    explained: tuple[bool, ...]
    guarded: tuple[bool, ...]


class TelemetryTrace(Struct, frozen=True, kw_only=True):
    """Shear of one contactor, sample by sample.

    Attributes
    ----------
    contactor : int
        Index of the contactor.
    sample_rate_hz : float
        Rate of the samples [Hz].
    first : int
        Number of the first sample. It continues the message before unless samples are missing, and
        begins anew when playback is started again.
    shear_um : bytes
        Samples since the message before as little-endian float32, none while nothing plays [µm]; a
        binary field of MessagePack (a base64 string in JSON).
    """

    contactor: int
    sample_rate_hz: float
    first: int
    shear_um: bytes


class TelemetrySamples(Struct, frozen=True, kw_only=True):
    """What playback has handed to the amplifier since the message before, sample by sample.

    Binary fields are little-endian, and binary fields of MessagePack (base64 strings in JSON). Rows
    of samples hold a value for each contactor. All is as commanded: after an e-stop, the amplifier
    turns to 0 V by itself.

    Attributes
    ----------
    first : int
        Number of the first sample. It continues the message before unless samples are missing, and
        begins anew when the server opens the display anew.
    sample_rate_hz : float
        Nominal rate of the samples [Hz].
    block_samples : int
        Number of samples of a block.
    times_us : bytes
        Time of the server's monotonic clock at which the first sample of each block is put out, by
        the clock of the amplifier, as float64 [µs]. Blocks are handed over before that.
    uncertainty_us : float or null
        Half of the largest interval around these times that holds the true one; null if it is not
        known, as on a sound card [µs].
    finger_times_us : bytes
        Time of the server's monotonic clock for which each block has the finger, as float64 [µs].
    position_mm : bytes
        Position of the finger in each block, as pairs of float32 [mm].
    velocity_mm_s : bytes
        Velocity of the finger in each block, as pairs of float32 [mm/s].
    normal_force_n : bytes
        Normal force of the finger in each block, as float32 [N].
    touching : list of bool
        Whether the finger touches the surface in each block.
    shear_um : bytes or null
        Rows of commanded shear as float32, in step with the drive [µm]; null on a link that takes
        spectrum frames.
    drive_v : bytes or null
        Rows of drive as float32 [V]; null on a link that takes spectrum frames.
    """

    first: int
    sample_rate_hz: float
    block_samples: int
    times_us: bytes
    uncertainty_us: float | None
    finger_times_us: bytes
    position_mm: bytes
    velocity_mm_s: bytes
    normal_force_n: bytes
    touching: tuple[bool, ...]
    shear_um: bytes | None
    drive_v: bytes | None


class TelemetryMessage(ApiMessage, frozen=True, kw_only=True, tag="telemetry"):
    """State of a display at one instant, sent at the rate that `Subscribe` asked for.

    Attributes
    ----------
    display : str
        Name of the display.
    time_us : int
        Time of the server's monotonic clock [µs].
    state : str
        State as in `StatsReply`.
    position_mm : pair of float
        Position of the finger on the surface, as playback tracks it [mm].
    velocity_mm_s : pair of float
        Velocity of the finger [mm/s].
    normal_force_n : float
        Normal force of the finger [N].
    shear_um : list of float or null
        Commanded shear of each contactor, 0 while nothing plays [µm]; null on a link that takes
        spectrum frames, for which it is not computed.
    drive_v : list of float
        Drive of each contactor, 0 while nothing plays [V].
    counters : dict of str to int
        Counters as in `StatsReply`.
    put_out_share : float or null
        Share that was put out, as in `StatsReply`.
    finger : TelemetryFinger or null
        Loads of the finger on a display that follows it; null where they are not known.
    trace : TelemetryTrace or null
        Commanded shear of the contactor that `Subscribe` named; null without one, and on a link
        that takes spectrum frames.
    played : TelemetryTrace or null
        Shear of the skin at that contactor on a simulated display, which alone knows it. Its
        samples are later than those of ``trace``, and have numbers of their own.
    samples : TelemetrySamples or null
        What was handed to the amplifier since the message before, if `Subscribe` asked for it.
    """

    display: str
    time_us: Microseconds
    state: str
    position_mm: tuple[float, float]
    velocity_mm_s: tuple[float, float]
    normal_force_n: float
    shear_um: tuple[float, ...] | None
    drive_v: tuple[float, ...]
    counters: dict[str, int]
    put_out_share: float | None = None
    finger: TelemetryFinger | None = None
    trace: TelemetryTrace | None = None
    played: TelemetryTrace | None = None
    samples: TelemetrySamples | None = None


Streamed = Contact | TactileFrames
"""Message of a client that is part of a stream: it is no request and waits for none."""
Command = (
    ClientHello | ListTextures | DrawTexture | Select | Contact | Resume | StopPlaying | SetGain
    | Append | TactileFrames | PlayEffect | ListEffects | PlayNamedEffect | ArmDisplay
    | DisarmDisplay | EStop | ClearEstop | Subscribe | GetStats | Ping
)  # fmt: skip
"""Any message of a client."""
Answer = (
    Welcome | Textures | TexturePicture | Effects | Done | AppendedReply | Pong | StatsReply
    | Failure | EventMessage | OnsetMessage | TelemetryMessage
)  # fmt: skip
"""Any message of the server."""


def schema() -> dict[str, Any]:
    """Return the JSON Schema of all messages.

    Returns
    -------
    dict of str to Any
        JSON Schema document. ``client`` and ``server`` are the schemas of the messages of each
        side, ``$defs`` holds each message by the name of its class.
    """
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
