"""Amplifiers whose CAPS are out of range: each is refused by its first such field, before ARM.

The ranges are those of the table in section 4 of SPEC.md, which is read as text.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from math import ceil, floor
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from link_rig import LINKS, Bench, Linked, Panel, overheard
from test_protocol_spec import rows, section

from firmware_protocol import amplifier as amplifier_module
from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.capabilities import caps_fault
from firmware_protocol.host import codes_of
from tactile.devices import open_bus
from tactile.errors import BusError, InputError

TOKEN = 4660
CAPS = m.Caps(
    TOKEN, 1, 1, m.SCHEMA_CRC, 24, 16, 15, 4, 4096, 1024, 1_000_000, 2500, 16_000, 100_000_000,
    100_000_000, 700_000, 20_000, 0x10000, b"virtual",
)  # fmt: skip
"""CAPS of section 15 of SPEC.md, with a buffer of 64 ms."""


def altered(caps: m.Caps, **changed: Any) -> m.Caps:
    """Return CAPS with other values of some fields."""
    return replace(caps, **changed)


def reaches_zero(caps: m.Caps, rate: int) -> bool:
    """Return whether section 11.1 of SPEC.md lets the limits of an amplifier be, in fractions."""
    code = floor(Fraction(caps.voltage_limit_uv * 32767, caps.full_scale_uv))
    step = floor(Fraction(caps.slew_limit_v_per_s * 32767 * 10**6, caps.full_scale_uv * rate))
    return min(code, 32767) <= min(step, 65534) * (rate // 50)


# The function


def test_the_caps_of_a_right_amplifier_have_no_fault() -> None:
    assert caps_fault(CAPS, TOKEN) == ""


BOUNDS = {
    "channels": (1, 255),
    "carriers": (0, 64),
    "packet_limit": (136, 4096),
    "rate_max_hz": (2500, 16_000),  # the buffer is for 16 kHz
    "rate_min_hz": (1000, 16_000),
    "fifo_samples": (1024, 65535),
    "tick_hz": (160_000, 2**32 - 1),
    "full_scale_uv": (100_000_000, 2**32 - 1),
    "voltage_limit_uv": (1, 100_000_000),
    "fade_limit_us": (0, 20_000),
}


@pytest.mark.parametrize("field", list(BOUNDS))
def test_a_field_at_either_bound_is_allowed_and_one_beyond_is_named(field: str) -> None:
    steep = replace(CAPS, slew_limit_v_per_s=10**8)
    for bound, step in zip(BOUNDS[field], (-1, 1), strict=True):
        assert caps_fault(altered(steep, **{field: bound}), TOKEN) == ""
        if 0 <= bound + step < 2**32:
            line = caps_fault(altered(steep, **{field: bound + step}), TOKEN)
            assert line
            assert "\n" not in line


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"session": 7}, "session 7, which must be 4660, the token of HELLO"),
        ({"major": 2}, "major 2, which must be 1, the version of this host"),
        ({"channels": 0}, "channels 0, which must be 1 … 255"),
        ({"carriers": 65}, "carriers 65, which must be 0 … 64"),
        ({"formats": 0xFFF0}, "formats 65520, which must have a bit of 0 … 3"),
        ({"packet_limit": 65535}, "packet_limit 65535, which must be 136 … 4096"),
        ({"rate_max_hz": 0}, "rate_max_hz 0, which must be 1000 … 1000000"),
        ({"rate_min_hz": 999}, "rate_min_hz 999, which must be 1000 … 16000, rate_max_hz"),
        (
            {"fifo_samples": 0},
            "fifo_samples 0, which must be 1024 … 65535, 64 ms at rate_max_hz 16000",
        ),
        (
            {"tick_hz": 0},
            "tick_hz 0, which must be 160000 … 4294967295, 10 a sample at rate_max_hz 16000",
        ),
        ({"full_scale_uv": 0}, "full_scale_uv 0, which must be 1 … 4294967295"),
        (
            {"full_scale_uv": 60_000_000},
            "voltage_limit_uv 100000000, which must be 1 … 60000000, full_scale_uv",
        ),
        ({"fade_limit_us": 20_001}, "fade_limit_us 20001, which must be 0 … 20000"),
        (
            {"slew_limit_v_per_s": 5000},
            "slew_limit_v_per_s 5000, which must be 5104 … 100000000, to 0 V from "
            "voltage_limit_uv 100000000 in 20 ms at 2549 Hz",
        ),
    ],
)
def test_a_fault_names_field_value_range_and_what_to_do(change: dict[str, int], line: str) -> None:
    assert caps_fault(altered(CAPS, **change), TOKEN) == (
        f"its CAPS has {line}; correct its firmware"
    )


def test_an_amplifier_that_lacks_all_fields_is_refused() -> None:
    """A missing tail reads as 0 (SPEC.md, 4)."""
    caps = m.Caps.unpack(b"")
    assert caps is not None
    assert caps_fault(caps, TOKEN)


@given(
    rate=st.integers(1000, 1_000_000),
    full_scale=st.integers(1, 2**32 - 1),
    share=st.fractions(0, 1),
    slew=st.integers(0, 10**8),
)
def test_the_slew_limit_is_checked_as_section_11_1_says(
    rate: int, full_scale: int, share: Fraction, slew: int
) -> None:
    caps = replace(
        CAPS, rate_min_hz=rate, rate_max_hz=rate, tick_hz=10_000_000, full_scale_uv=full_scale,
        fifo_samples=min(ceil(rate * 0.064) + 1, 65535),
        voltage_limit_uv=max(int(full_scale * share), 1), slew_limit_v_per_s=slew,
    )  # fmt: skip
    line = caps_fault(caps, TOKEN)
    least = re.search(r"which must be (\d+) …", line)
    assert bool(line) is not (reaches_zero(caps, rate) and slew >= 1)
    if least and int(least[1]) <= 10**8:
        enough = replace(caps, slew_limit_v_per_s=int(least[1]))
        assert reaches_zero(enough, rate)
        assert caps_fault(enough, TOKEN) == ""


def test_the_table_of_the_spec_has_the_same_numbers() -> None:
    text = section("4").split("### Ranges of CAPS")[1].split("###")[0]
    table = {cells[0]: cells[1:] for cells in rows(text)[2:]}
    steep = replace(CAPS, rate_max_hz=1_000_000, fifo_samples=65535, tick_hz=10**7)
    steep = replace(steep, slew_limit_v_per_s=10**8)
    assert caps_fault(steep, TOKEN) == ""
    for field, cells in table.items():
        for cell, step in zip(cells, (-1, 1), strict=True):
            number = cell.replace(" ", "")
            if number.isdigit() and 0 <= (beyond := int(number) + step) < 2**32:
                line = caps_fault(altered(steep, **{field: beyond}), TOKEN)
                assert f"has {field} {beyond}," in line
    assert set(table) == {
        "session", "major", "channels", "carriers", "formats", "packet_limit", "rate_max_hz",
        "rate_min_hz", "fifo_samples", "tick_hz", "full_scale_uv", "voltage_limit_uv",
        "slew_limit_v_per_s", "fade_limit_us", "marker_lines",
    }  # fmt: skip


@pytest.mark.parametrize("full_scale", [1e-6, 60.0, 100.0])
def test_a_voltage_beyond_full_scale_never_changes_its_sign(full_scale: float) -> None:
    volts = np.array([-1000.0, -100.0, 0.0, 100.0, 1000.0])
    codes = codes_of(volts, full_scale)
    assert (np.sign(codes) == np.sign(volts)).all()
    assert np.abs(codes).max() == 32767


# On a link


@pytest.fixture
def tells(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return what lets amplifiers say something else of themselves from now on."""
    usual = ReferenceAmplifier._hello

    def tell(**changed: int) -> None:
        def hello(amplifier: ReferenceAmplifier, message: m.Hello) -> object:
            answer = usual(amplifier, message)
            return altered(answer, **changed) if isinstance(answer, m.Caps) else answer

        entry = ("hello_other", hello)
        monkeypatch.setitem(amplifier_module.HANDLERS, m.Hello, entry)

    return tell


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("full_scale_uv", 0), ("full_scale_uv", 60_000_000), ("tick_hz", 0), ("fifo_samples", 2),
        ("packet_limit", 65535), ("session", 1), ("major", 2), ("channels", 0), ("formats", 0),
    ],
)  # fmt: skip
def test_an_amplifier_out_of_range_is_refused_before_it_is_armed_or_limited(
    tells: Callable[..., None], monkeypatch: pytest.MonkeyPatch, link: str, field: str, value: int
) -> None:
    heard = overheard(monkeypatch)
    tells(**{field: value})
    with pytest.raises(BusError) as refused:
        open_bus(LINKS[link], Panel(), sample_rate=2500)
    assert not isinstance(refused.value, InputError)
    line = str(refused.value)
    assert re.match(r"node 1: its CAPS has \w+ \d+, which must ", line)
    assert line.endswith("; correct its firmware")
    assert "\n" not in line
    assert not {packet.type for packet, _ in heard} & {m.Arm.TYPE, m.Limits.TYPE, m.Start.TYPE}


def test_an_amplifier_that_is_exchanged_for_one_out_of_range_is_not_used(
    linked: Linked, tells: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The host asks again, and uses it once its CAPS is right."""
    rig = linked("serial")
    rig.begin(0.2)
    heard = overheard(monkeypatch)
    tells(full_scale_uv=0)
    rig.model.unplug(0.1)
    rig.model.power_cycle()
    rig.play(1.0)
    assert "node 1: its CAPS has full_scale_uv 0, which must be 1 …" in rig.bus.status.last_fault
    assert (rig.bus.status.link, rig.bus.status.playing) == ("down", False)
    assert not {packet.type for packet, _ in heard} & {m.Arm.TYPE, m.Limits.TYPE, m.Start.TYPE}
    tells()
    rig.play(1.0)
    assert (rig.bus.status.link, rig.bus.status.playing) == ("up", True)


def test_a_late_answer_to_the_hello_that_searched_is_no_answer_to_the_one_that_takes(
    linked: Linked,
) -> None:
    """The late answer has session 0; the one that follows counts."""
    late: list[m.Caps] = []
    usual = ReferenceAmplifier._send

    def twice(amplifier: ReferenceAmplifier, message: m.Message, node: int | None = None) -> None:
        if isinstance(message, m.Caps):
            late.append(message)
            if message.session:
                usual(amplifier, late[0], node)
        usual(amplifier, message, node)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ReferenceAmplifier, "_send", twice)
        rig = linked("serial")
    assert late[0].session == 0
    assert rig.bus.peers[0].caps.session == rig.bus.peers[0].host.session
    rig.begin(0.1)


@pytest.mark.parametrize("factor", [4294.967295, 0.5])
def test_a_clock_that_ticks_otherwise_than_caps_says_is_named(
    tells: Callable[..., None], factor: float
) -> None:
    tells(tick_hz=int(1e6 * factor))
    with pytest.raises(BusError, match=r"^node 1: \d+ of its TIME_REPLYs do not fit a clock of "):
        Bench(LINKS["serial"])
