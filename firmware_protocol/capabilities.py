"""Check of the capabilities of an amplifier, before a host arms it (section 4 of SPEC.md)."""

from collections.abc import Iterator

from firmware_protocol import messages as m
from firmware_protocol.config import FORMATS, LimitsInForce
from firmware_protocol.messages import CARRIERS_MAX, FADE_MS, FULL_SCALE_CODE, MAJOR, PACKET_MAX

PACKET_LEAST = 136
"""Least `packet_limit` [bytes]."""
BUFFER_MS = 64
"""Least length of the buffer at the highest rate [ms]."""
RATE_LEAST, RATE_MOST = 1000, 1_000_000
"""Least `rate_min_hz` and largest `rate_max_hz` [Hz]."""
TICKS_PER_SAMPLE = 10
"""Least number of ticks per sample at the highest rate."""
SLEW_MOST = 10**8
"""Largest `slew_limit_v_per_s` [V/s]."""

Range = tuple[str, int, int, str]
"""Field of CAPS, least and largest value, and what they depend on; empty if they are constants."""


def caps_fault(caps: m.Caps, session: int) -> str:
    """Return which field of CAPS has a value that SPEC.md does not allow.

    Parameters
    ----------
    caps : Caps
        Answer of the amplifier to HELLO.
    session : int
        Token of the HELLO.

    Returns
    -------
    str
        One line on the first such field, with its value and what it must be; empty if there is
        none.
    """
    for name, least, most, reason in _ranges(caps, session):
        value = getattr(caps, name)
        if not least <= value <= most:
            allowed = str(least) if least == most else f"{least} … {most}"
            return _line(name, value, f"be {allowed}" + (f", {reason}" if reason else ""))
    if not caps.formats & FORMATS:
        return _line("formats", caps.formats, "have a bit of 0 … 3")
    return ""


def _line(name: str, value: int, must: str) -> str:
    return f"its CAPS has {name} {value}, which must {must}; correct its firmware"


def _ranges(caps: m.Caps, session: int) -> Iterator[Range]:
    """Yield the ranges of the fields, each after those that it depends on."""
    top = caps.rate_max_hz
    at_top = f"at rate_max_hz {top}"
    yield "session", session, session, "the token of HELLO"
    yield "major", MAJOR, MAJOR, "the version of this host"
    yield "channels", 1, 0xFF, ""
    yield "carriers", 0, CARRIERS_MAX, ""
    yield "packet_limit", PACKET_LEAST, PACKET_MAX, ""
    yield "rate_max_hz", RATE_LEAST, RATE_MOST, ""
    yield "rate_min_hz", RATE_LEAST, top, "rate_max_hz"
    yield "fifo_samples", -(top * BUFFER_MS // -1000), 0xFFFF, f"{BUFFER_MS} ms {at_top}"
    yield "tick_hz", TICKS_PER_SAMPLE * top, 0xFFFF_FFFF, f"{TICKS_PER_SAMPLE} a sample {at_top}"
    yield "full_scale_uv", 1, 0xFFFF_FFFF, ""
    yield "voltage_limit_uv", 1, caps.full_scale_uv, "full_scale_uv"
    yield "fade_limit_us", 0, 1000 * FADE_MS, ""
    for rate in (caps.rate_min_hz, top):
        fall = f"to 0 V from voltage_limit_uv {caps.voltage_limit_uv} in {FADE_MS} ms at {rate} Hz"
        yield "slew_limit_v_per_s", _least_slew(caps, rate), SLEW_MOST, fall


def _least_slew(caps: m.Caps, rate: int) -> int:
    """Return the least slew limit that reaches 0 V in time at a rate (section 11.1) [V/s]."""
    limit = LimitsInForce(caps.full_scale_uv, caps.voltage_limit_uv, 0, 0).code
    step = max(-(limit // -(rate * FADE_MS // 1000)), 1)
    return -(step * caps.full_scale_uv * rate // -(FULL_SCALE_CODE * 10**6))
