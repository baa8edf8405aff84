"""What SPEC.md allows an amplifier to be: ranges of CAPS (section 4), for amplifiers and hosts."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from firmware_protocol import messages as m
from firmware_protocol.config import FORMATS, AmplifierConfig, LimitsInForce
from firmware_protocol.messages import (
    CARRIERS_MAX,
    FADE_MS,
    FULL_SCALE_CODE,
    MAJOR,
    MARKER_LINES_MOST,
    PACKET_MAX,
    UNGUARDED_MOST_UV,
    SampleFormat,
)

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
NAME_SIZE = 16
"""Length of the name in CAPS [bytes]."""
NAME_MUST = f"UTF-8 of {NAME_SIZE} bytes at most without zeros (SPEC.md, 1)"
"""What the name must be."""
INSTANTS = 1000 // FADE_MS
"""Rate at which 20 ms are one instant [Hz]."""

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
    fault = _outside(caps, _greeting(session)) or _outside(caps, _ranges(caps))
    return f"its CAPS has {fault}; correct its firmware" if fault else ""


def config_fault(config: AmplifierConfig) -> str:
    """Return which field of a configuration has a value that SPEC.md does not allow.

    Parameters
    ----------
    config : AmplifierConfig
        Properties of the amplifier.

    Returns
    -------
    str
        One line on the first such field, with its name in CAPS, its value and what it must be;
        empty if there is none.
    """
    caps = replace(config, name="").caps(0, 0)
    return (
        _outside(config, [("node", 1, 127, "")])
        or _outside(caps, _ranges(caps))
        or _contradiction(config)
    )


def _contradiction(config: AmplifierConfig) -> str:
    """Return what the table of section 4 does not tell of a host, and binds an amplifier."""
    c, delay, ranges = config, config.current_delay, config.sense_ranges_ua
    if c.formats >> SampleFormat.SPECTRUM8 & 1 and not c.carriers:
        return _line("carriers", 0, f"be 1 … {CARRIERS_MAX}, with bit 3 of formats (SPEC.md, 10)")
    if c.full_scale_uv > UNGUARDED_MOST_UV and not c.estop_input:
        must = f"be True, as full_scale_uv {c.full_scale_uv} is above {UNGUARDED_MOST_UV}"
        return _line("estop_input", c.estop_input, f"{must} (SPEC.md, 6.3)")
    if not all(1 <= range_ua <= 0xFFFF for range_ua in ranges):
        return _line("sense_ranges_ua", ranges, f"be 1 … {0xFFFF} each (SPEC.md, 16)")
    if delay < 0:
        return _line("current_delay", delay, "be 0 or more (SPEC.md, 16.1)")
    return "" if _is_name(c.name) else _line("name", repr(c.name), f"be {NAME_MUST}")


def _is_name(name: str) -> bool:
    try:
        return len(name.encode()) <= NAME_SIZE and "\0" not in name
    except UnicodeEncodeError:
        return False


def _outside(values: object, ranges: Iterable[Range]) -> str:
    """Return a line on the first value that is outside its range; empty if there is none."""
    for name, least, most, reason in ranges:
        value = getattr(values, name)
        if name == "formats":
            if not value & FORMATS:
                return _line(name, value, "have a bit of 0 … 3")
        elif not least <= value <= most:
            allowed = str(least) if least == most else f"{least} … {most}"
            return _line(name, value, f"be {allowed}" + (f", {reason}" if reason else ""))
    return ""


def _line(name: str, value: object, must: str) -> str:
    return f"{name} {value}, which must {must}"


def _greeting(session: int) -> Iterator[Range]:
    """Yield the ranges of what CAPS answers to HELLO."""
    yield "session", session, session, "the token of HELLO"
    yield "major", MAJOR, MAJOR, "the version of this host"


def _ranges(caps: m.Caps) -> Iterator[Range]:
    """Yield the ranges of the fields, each after those that it depends on."""
    top = caps.rate_max_hz
    at_top = f"at rate_max_hz {top}"
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
    least, rate = _least_slew(caps)
    fall = f"to 0 V from voltage_limit_uv {caps.voltage_limit_uv} in {FADE_MS} ms at {rate} Hz"
    yield "slew_limit_v_per_s", least, SLEW_MOST, fall
    yield "formats", 1, FORMATS, ""
    yield "marker_lines", 0, MARKER_LINES_MOST, ""


def _least_slew(caps: m.Caps) -> tuple[int, int]:
    """Return the least slew limit that reaches 0 V in time at every rate (section 11.1) [V/s].

    Of the rates with the same ⌊rate / 50⌋ the highest takes the most, so that it stands for them.

    Returns
    -------
    tuple of int
        Limit [V/s], at least 1, and the rate that needs it [Hz].
    """
    low, top = caps.rate_min_hz, caps.rate_max_hz
    limit = LimitsInForce(caps.full_scale_uv, caps.voltage_limit_uv, 0, 0).code
    instants = np.arange(low // INSTANTS, top // INSTANTS + 1)
    rates = np.minimum(INSTANTS * (instants + 1) - 1, top)
    most = -(-limit // instants) * rates
    worst = int(most.argmax())
    least = -(int(most[worst]) * caps.full_scale_uv // -(FULL_SCALE_CODE * 10**6))
    return max(least, 1), int(rates[worst])
