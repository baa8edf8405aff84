"""Messages, codes and states of the protocol; written by generate.py from schema.toml.

SPEC.md defines their meaning.
"""

from dataclasses import dataclass
from enum import IntEnum
from struct import Struct

from firmware_protocol.layout import Message as Message

MAJOR, MINOR = 1, 4
SCHEMA_CRC = 0xE2066801
STAYS, REFUSED = 0x40, 0x80
WATCHDOG_MS = 150
"""Time without a heartbeat after which the watchdog expires [ms]."""
HEARTBEAT_MS = 50
"""Interval between heartbeats [ms]."""
FADE_MS = 20
"""Length of the longest ordinary ramp [ms]."""
VALID_MS = 50
"""Longest validity of a spectrum frame [ms]."""
FRAGMENT_TIMEOUT_MS = 20
"""Longest time for the reassembly of a packet [ms]."""
INPUT_CLOSED_MS = 50
"""Time after which a closed e-stop input counts as closed [ms]."""
UNGUARDED_MOST_UV = 0x3938700
"""Largest full scale of an amplifier without an e-stop input [µV]."""
START_AHEAD_MS = 10000
"""Longest time by which START may be ahead [ms]."""
PACKET_MAX = 4096
"""Largest packet, header and CRC included [bytes]."""
FULL_SCALE_CODE = 32767
"""Sample code at full scale."""
CARRIERS_MAX = 64
"""Largest number of carriers of a stream."""
CAN_PREFIX = 0x1D0B0000
"""Number that is added to an 11-bit identifier to make the 29-bit one."""
LAGS = 16
"""Number of correlations of a channel in a window."""
CORRELATED_MOST = 12
"""Largest number of channels of a CORRELATION."""
EXPONENT_MOST = 32
"""Largest exponent of an entry of CORRELATION."""
GUARD_TAPS = 13
"""Number of coefficients of a filter of GUARD."""
GUARD_BLOCK = 8
"""Number of instants from one decision of the guard to the next."""
GUARD_BLOCKS = 5
"""Number of blocks over which the guard looks for a lost contact."""
GUARD_LEAST = 1024
"""Gain of a channel after its guard has tripped, in 1/32768."""
MARKER_LINES_MOST = 8
"""Largest number of marker lines."""
MARKS_MOST = 8
"""Largest number of marks that an amplifier keeps."""


class Flag(IntEnum):
    """Flags of a packet (section 2)."""

    ACK_REQUEST = 32
    INCOMPATIBLE = 24
    COMPATIBLE = 7


class State(IntEnum):
    """States of an amplifier (section 6)."""

    IDLE = 0
    ARMED = 1
    RUNNING = 2
    RAMPDOWN = 3
    SAFE = 4
    FAULT = 5
    ESTOP = 6


class Phase(IntEnum):
    """Phases of the state RUNNING (section 8.2)."""

    STILL = 0
    WAITING = 1
    PLAYING = 2
    STARVED = 3


class NakCode(IntEnum):
    """Reasons for which a request is refused (section 5)."""

    UNKNOWN_TYPE = 1
    VERSION = 2
    UNSUPPORTED = 3
    LENGTH = 4
    SESSION = 5
    BUSY = 6
    STATE = 7
    NOT_ARMED = 8
    FAULT = 9
    ESTOP = 10
    RANGE = 11
    CHANNEL = 12
    FORMAT = 13
    PARAMETER = 14
    READ_ONLY = 15
    TIME = 16
    CARRIERS = 17
    INPUT_OPEN = 18


class Mode(IntEnum):
    """Modes of ARM (section 4)."""

    PCM = 0
    SPECTRUM = 1


class SampleFormat(IntEnum):
    """Sample formats (section 9)."""

    PCM16 = 0
    PCM12 = 1
    BFP8 = 2
    SPECTRUM8 = 3


class Fault(IntEnum):
    """Faults of the hardware (section 6)."""

    NONE = 0
    OVERCURRENT = 1
    OVERTEMPERATURE = 2
    UNDERVOLTAGE = 3
    HARDWARE = 4


class Parameter(IntEnum):
    """Parameters of GET and SET (section 4)."""

    NODE = 1
    PULSE_MS = 2
    SENSE_MS = 3
    LOG_LEVEL = 4
    UPTIME_S = 5
    HIGH_VOLTAGE_MV = 6
    TEMPERATURE_MK = 7
    CORRELATION_MS = 8
    SENSE_RANGE_UA = 9


class LogLevel(IntEnum):
    """Levels of LOG (section 4)."""

    DEBUG = 0
    INFO = 1
    WARNING = 2
    ERROR = 3
    OFF = 4


class Feature(IntEnum):
    """Bits of the features in CAPS (section 4)."""

    SENSES = 1
    ZERO_ORDER_HOLD = 2
    ESTOP_INPUT = 4
    CORRELATES = 8
    GUARDS = 16


class EstopReason(IntEnum):
    """Reasons of an e-stop that the protocol defines (section 6.3)."""

    INPUT = 255


class Input(IntEnum):
    """Bits of the inputs in STATUS (section 6.3)."""

    ESTOP_OPEN = 1


class Window(IntEnum):
    """Bits of the flags of an entry of CORRELATION (section 16.3)."""

    CLIPPED = 1
    GUARDED = 2


class GuardFlag(IntEnum):
    """Bits of the flags of an entry of GUARD (section 17.2)."""

    ARMED = 1
    RELEASE = 2


class GuardReason(IntEnum):
    """Reasons in GUARDED (section 17.4)."""

    NONE = 0
    RESIDUAL = 1
    LOST = 2


class CanClass(IntEnum):
    """Classes of messages on CAN (section 3.2)."""

    ESTOP = 0
    PROMPT = 1
    PULSE = 2
    STREAM = 3
    REQUEST = 4
    RESPONSE = 5
    BULK = 6


TABLE: dict[str, tuple[int, ...]] = {
    "hello_other": (0x40, 0x86, 0x86, 0x86, 0x40, 0x40, 0x40),
    "arm": (0x01, 0x01, 0x87, 0x87, 0x01, 0x89, 0x8A),
    "start": (0x88, 0x02, 0x87, 0x87, 0x88, 0x89, 0x8A),
    "stop": (0x40, 0x40, 0x0B, 0x40, 0x40, 0x40, 0x40),
    "disarm": (0x40, 0x00, 0x03, 0x03, 0x00, 0x40, 0x40),
    "estop": (0x06, 0x06, 0x06, 0x06, 0x06, 0x06, 0x40),
    "clear_fault": (0x40, 0x40, 0x40, 0x40, 0x40, 0x00, 0x00),
    "limits": (0x40, 0x40, 0x87, 0x87, 0x40, 0x40, 0x40),
    "carriers": (0x40, 0x40, 0x87, 0x87, 0x40, 0x40, 0x40),
    "watchdog": (0x40, 0x04, 0x23, 0x23, 0x40, 0x40, 0x40),
    "fault": (0x05, 0x05, 0x05, 0x05, 0x05, 0x40, 0x40),
    "estop_input": (0x06, 0x06, 0x06, 0x06, 0x06, 0x06, 0x40),
}
"""State table of section 6: for each event an entry per state, in the order of `State`.

An entry is `STAYS`, `REFUSED` | NAK code, or state | next << 3, where next is the state
that follows RAMPDOWN.
"""


@dataclass(frozen=True, slots=True)
class Hello(Message):
    """HELLO from the host: takes the amplifier; answered by CAPS (section 4)."""

    TYPE = 0x01
    CAN = CanClass.REQUEST
    HEAD = Struct("<HBBI")

    session: int = 0
    major: int = 0
    minor: int = 0
    schema: int = 0


@dataclass(frozen=True, slots=True)
class Time(Message):
    """TIME from the host: exchanges timestamps; answered by TIME_REPLY (section 4)."""

    TYPE = 0x02
    CAN = CanClass.REQUEST
    HEAD = Struct("<Q")

    host_time: int = 0


@dataclass(frozen=True, slots=True)
class Sync(Message):
    """SYNC from the host: notes the tick of reception (section 4)."""

    TYPE = 0x03
    CAN = CanClass.PROMPT
    HEAD = Struct("<B")

    index: int = 0


@dataclass(frozen=True, slots=True)
class Start(Message):
    """START from the host: starts to play a position at a given time (section 4)."""

    TYPE = 0x04
    CAN = CanClass.REQUEST
    HEAD = Struct("<HIBQ")

    session: int = 0
    position: int = 0
    delay_ms: int = 0
    time: int = 0


@dataclass(frozen=True, slots=True)
class Stop(Message):
    """STOP from the host: ramps to 0 V (section 4)."""

    TYPE = 0x05
    CAN = CanClass.REQUEST
    HEAD = Struct("<HB")

    session: int = 0
    quick: int = 0


@dataclass(frozen=True, slots=True)
class Arm(Message):
    """ARM from the host: switches the high voltage on (section 4)."""

    TYPE = 0x06
    CAN = CanClass.REQUEST
    HEAD = Struct("<HBI")

    session: int = 0
    mode: int = 0
    sample_rate_hz: int = 0


@dataclass(frozen=True, slots=True)
class Disarm(Message):
    """DISARM from the host: ramps to 0 V and switches the high voltage off (section 4)."""

    TYPE = 0x07
    CAN = CanClass.REQUEST
    HEAD = Struct("<H")

    session: int = 0


@dataclass(frozen=True, slots=True)
class Estop(Message):
    """ESTOP from the host: goes to 0 V at the slew limit, latched (section 4)."""

    TYPE = 0x08
    CAN = CanClass.ESTOP
    HEAD = Struct("<B")

    reason: int = 0


@dataclass(frozen=True, slots=True)
class ClearFault(Message):
    """CLEAR_FAULT from the host: ends ESTOP or FAULT (section 4)."""

    TYPE = 0x09
    CAN = CanClass.REQUEST
    HEAD = Struct("<HI")

    session: int = 0
    trips: int = 0


@dataclass(frozen=True, slots=True)
class Heartbeat(Message):
    """HEARTBEAT from the host: shows that the streaming loop is alive (section 4)."""

    TYPE = 0x0A
    CAN = CanClass.PROMPT
    HEAD = Struct("<H")

    session: int = 0


@dataclass(frozen=True, slots=True)
class Limits(Message):
    """LIMITS from the host: lowers the limits (section 4)."""

    TYPE = 0x0B
    CAN = CanClass.REQUEST
    HEAD = Struct("<HIII")

    session: int = 0
    voltage_uv: int = 0
    slew_v_per_s: int = 0
    fade_us: int = 0


@dataclass(frozen=True, slots=True)
class Get(Message):
    """GET from the host: reads a parameter; answered by VALUE (section 4)."""

    TYPE = 0x0C
    CAN = CanClass.REQUEST
    HEAD = Struct("<H")

    parameter: int = 0


@dataclass(frozen=True, slots=True)
class Set(Message):
    """SET from the host: writes a parameter (section 4)."""

    TYPE = 0x0D
    CAN = CanClass.REQUEST
    HEAD = Struct("<HHI")

    session: int = 0
    parameter: int = 0
    value: int = 0


@dataclass(frozen=True, slots=True)
class Identify(Message):
    """IDENTIFY from the host: lets a person find the board (section 4)."""

    TYPE = 0x0E
    CAN = CanClass.REQUEST
    HEAD = Struct("<B")

    seconds: int = 0


@dataclass(frozen=True, slots=True)
class Poll(Message):
    """POLL from the host: requests STATUS (section 4)."""

    TYPE = 0x0F
    CAN = CanClass.REQUEST
    HEAD = Struct("<")


@dataclass(frozen=True, slots=True)
class Pcm(Message):
    """PCM from the host: samples of some channels (section 4)."""

    TYPE = 0x10
    CAN = CanClass.STREAM
    HEAD = Struct("<IHBBBB")
    BODY = True

    position: int = 0
    session: int = 0
    first_channel: int = 0
    channels: int = 0
    format: int = 0
    samples: int = 0
    data: bytes = b""


@dataclass(frozen=True, slots=True)
class Carriers(Message):
    """CARRIERS from the host: frequencies of the spectrum frames (section 4)."""

    TYPE = 0x11
    CAN = CanClass.REQUEST
    HEAD = Struct("<HB")
    BODY = True

    session: int = 0
    count: int = 0
    increments: bytes = b""


@dataclass(frozen=True, slots=True)
class Spectrum(Message):
    """SPECTRUM from the host: a spectrum frame (section 4)."""

    TYPE = 0x12
    CAN = CanClass.STREAM
    HEAD = Struct("<IHHBBBB")
    BODY = True

    position: int = 0
    session: int = 0
    valid: int = 0
    first_channel: int = 0
    channels: int = 0
    format: int = 0
    carriers: int = 0
    envelopes: bytes = b""


@dataclass(frozen=True, slots=True)
class Guard(Message):
    """GUARD from the host: what the guards of some channels expect (section 4)."""

    TYPE = 0x13
    CAN = CanClass.REQUEST
    HEAD = Struct("<HBB")
    BODY = True

    session: int = 0
    first_channel: int = 0
    channels: int = 0
    entries: bytes = b""


@dataclass(frozen=True, slots=True)
class Mark(Message):
    """MARK from the host: shows a code on the marker lines with a sample (section 4)."""

    TYPE = 0x14
    CAN = CanClass.STREAM
    HEAD = Struct("<HIBH")

    session: int = 0
    position: int = 0
    code: int = 0
    samples: int = 0


@dataclass(frozen=True, slots=True)
class Ack(Message):
    """ACK from the amplifier: a request was done (section 4)."""

    TYPE = 0x40
    CAN = CanClass.RESPONSE
    HEAD = Struct("<BB")

    type: int = 0
    seq: int = 0


@dataclass(frozen=True, slots=True)
class Nak(Message):
    """NAK from the amplifier: a request was refused (section 4)."""

    TYPE = 0x41
    CAN = CanClass.RESPONSE
    HEAD = Struct("<BBBBI")

    type: int = 0
    seq: int = 0
    code: int = 0
    state: int = 0
    detail: int = 0


@dataclass(frozen=True, slots=True)
class Caps(Message):
    """CAPS from the amplifier: capabilities and limits of the hardware (section 4)."""

    TYPE = 0x42
    CAN = CanClass.RESPONSE
    HEAD = Struct("<HBBIBBHHHHIIIIIIII16sB")

    session: int = 0
    major: int = 0
    minor: int = 0
    schema: int = 0
    channels: int = 0
    carriers: int = 0
    formats: int = 0
    features: int = 0
    packet_limit: int = 0
    fifo_samples: int = 0
    tick_hz: int = 0
    rate_min_hz: int = 0
    rate_max_hz: int = 0
    full_scale_uv: int = 0
    voltage_limit_uv: int = 0
    slew_limit_v_per_s: int = 0
    fade_limit_us: int = 0
    firmware: int = 0
    name: bytes = b""
    marker_lines: int = 0


@dataclass(frozen=True, slots=True)
class TimeReply(Message):
    """TIME_REPLY from the amplifier: timestamps of reception and answer (section 4)."""

    TYPE = 0x43
    CAN = CanClass.RESPONSE
    HEAD = Struct("<QQQ")

    host_time: int = 0
    received: int = 0
    sent: int = 0


@dataclass(frozen=True, slots=True)
class Value(Message):
    """VALUE from the amplifier: value of a parameter (section 4)."""

    TYPE = 0x44
    CAN = CanClass.RESPONSE
    HEAD = Struct("<HI")

    parameter: int = 0
    value: int = 0


@dataclass(frozen=True, slots=True)
class Pulse(Message):
    """PULSE from the amplifier: credit and state of the stream (section 4)."""

    TYPE = 0x45
    CAN = CanClass.PULSE
    HEAD = Struct("<IBBBB")

    credit_position: int = 0
    state: int = 0
    phase: int = 0
    underruns: int = 0
    fill_ms: int = 0


@dataclass(frozen=True, slots=True)
class Status(Message):
    """STATUS from the amplifier: state, limits in force and counters (section 4)."""

    TYPE = 0x46
    CAN = CanClass.RESPONSE
    HEAD = Struct("<BBBBHIQBQIIIIIIIIIIIIIIIIIIIIIIIIB")

    state: int = 0
    phase: int = 0
    fault: int = 0
    estop_reason: int = 0
    session: int = 0
    position: int = 0
    time: int = 0
    sync_index: int = 0
    sync_time: int = 0
    voltage_limit_uv: int = 0
    slew_limit_v_per_s: int = 0
    fade_us: int = 0
    packets: int = 0
    crc_errors: int = 0
    malformed: int = 0
    oversized: int = 0
    fragments_dropped: int = 0
    wrong_version: int = 0
    unsupported: int = 0
    unknown_type: int = 0
    foreign_session: int = 0
    refused: int = 0
    ignored: int = 0
    wrong_channel: int = 0
    wrong_format: int = 0
    late_samples: int = 0
    future_samples: int = 0
    lost_samples: int = 0
    underruns: int = 0
    limited_samples: int = 0
    watchdogs: int = 0
    dropped_replies: int = 0
    trips: int = 0
    inputs: int = 0


@dataclass(frozen=True, slots=True)
class Sense(Message):
    """SENSE from the amplifier: measured voltages and currents (section 4)."""

    TYPE = 0x47
    CAN = CanClass.BULK
    HEAD = Struct("<IBB")
    BODY = True

    position: int = 0
    first_channel: int = 0
    channels: int = 0
    readings: bytes = b""


@dataclass(frozen=True, slots=True)
class Log(Message):
    """LOG from the amplifier: text for a person (section 4)."""

    TYPE = 0x48
    CAN = CanClass.BULK
    HEAD = Struct("<B")
    BODY = True

    level: int = 0
    text: bytes = b""


@dataclass(frozen=True, slots=True)
class Correlation(Message):
    """CORRELATION from the amplifier: currents of a window, correlated with what was played (section 4)."""

    TYPE = 0x49
    CAN = CanClass.BULK
    HEAD = Struct("<IHHBBB")
    BODY = True

    position: int = 0
    range_ua: int = 0
    samples: int = 0
    first_channel: int = 0
    channels: int = 0
    lags: int = 0
    entries: bytes = b""


@dataclass(frozen=True, slots=True)
class Guarded(Message):
    """GUARDED from the amplifier: guards that have tripped (section 4)."""

    TYPE = 0x4A
    CAN = CanClass.RESPONSE
    HEAD = Struct("<I")
    BODY = True

    position: int = 0
    reasons: bytes = b""


@dataclass(frozen=True, slots=True)
class Marked(Message):
    """MARKED from the amplifier: a code was shown on the marker lines (section 4)."""

    TYPE = 0x4B
    CAN = CanClass.BULK
    HEAD = Struct("<IB")

    position: int = 0
    code: int = 0


MESSAGES: dict[int, type[Message]] = {
    0x01: Hello,
    0x02: Time,
    0x03: Sync,
    0x04: Start,
    0x05: Stop,
    0x06: Arm,
    0x07: Disarm,
    0x08: Estop,
    0x09: ClearFault,
    0x0A: Heartbeat,
    0x0B: Limits,
    0x0C: Get,
    0x0D: Set,
    0x0E: Identify,
    0x0F: Poll,
    0x10: Pcm,
    0x11: Carriers,
    0x12: Spectrum,
    0x13: Guard,
    0x14: Mark,
    0x40: Ack,
    0x41: Nak,
    0x42: Caps,
    0x43: TimeReply,
    0x44: Value,
    0x45: Pulse,
    0x46: Status,
    0x47: Sense,
    0x48: Log,
    0x49: Correlation,
    0x4A: Guarded,
    0x4B: Marked,
}
"""Classes of the messages by their type."""
