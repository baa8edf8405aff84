"""Configurations that SPEC.md forbids are refused, by the C core and in Python, for the same field.

Cases by hand are from the tables of SPEC.md; thousands at random compare both implementations.
"""

import subprocess
from collections import Counter
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import pytest
from c_amplifier_rig import SOURCE, compiler

from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.capabilities import config_fault
from firmware_protocol.config import AmplifierConfig
from tactile.bus.base import Wiring
from tactile.bus.board import config_of
from tactile.errors import InputError

C_NAMES = {"estop_open": "estop_input", "sense_range_ua": "sense_ranges_ua"}
"""Names in C that are other ones in Python."""
RANGES = {
    "node": (1, 127),
    "channels": (1, 255),
    "carriers": (0, 64),
    "packet_limit": (136, 4096),
    "rate_min_hz": (1000, 1_000_000),
    "rate_max_hz": (1000, 1_000_000),
    "fifo": (64, 65_535),
    "tick_hz": (10_000, 2**32 - 1),
    "full_scale_uv": (1, 2**32 - 1),
    "voltage_limit_uv": (1, 2**32 - 1),
    "fade_limit_us": (0, 20_000),
    "slew_limit_v_per_s": (1, 10**8),
    "formats": (1, 15),
    "marker_lines": (0, 8),
}
"""Ranges of section 4 of SPEC.md, where they do not depend on other fields."""
WIDTHS = {
    "node": 8, "channels": 8, "carriers": 8, "packet_limit": 16, "fifo": 16, "formats": 16,
    "marker_lines": 8,
}  # fmt: skip
"""Bits of the fields in C; the others have 32."""
GOOD = AmplifierConfig()


@pytest.fixture(scope="module")
def config_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build config_faults with the largest sizes of SPEC.md, so that only those bound it."""
    program = tmp_path_factory.mktemp("config") / "config_faults"
    sizes = ["-DTA_CHANNELS=255", "-DTA_CARRIERS=64", "-DTA_FIFO=65535", "-DTA_CURRENT_DELAY=200"]
    done = subprocess.run(
        [compiler(), "-std=c99", "-O1", "-Wall", "-Werror", *sizes, "-o", program,
         SOURCE / "test/config_faults.c", *SOURCE.glob("tactile_*.c")],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return program


def line_of(c: AmplifierConfig, name: bytes) -> str:
    numbers = [
        c.node, c.channels, c.carriers, c.formats, c.packet_limit, c.fifo,
        c.sense_ranges_ua[0] if c.sense_ranges_ua else 0, c.current_delay, c.marker_lines,
        c.tick_hz, c.rate_min_hz, c.rate_max_hz, c.full_scale_uv, c.voltage_limit_uv,
        c.slew_limit_v_per_s,
        c.fade_limit_us, bool(c.sense_ranges_ua), c.estop_input,
    ]  # fmt: skip
    return " ".join(str(int(number)) for number in numbers) + " " + name.ljust(16, b"\0").hex()


def faults_in_c(program: Path, lines: list[str]) -> list[list[str]]:
    """Return field, least and largest value of each configuration; field - for none."""
    text = "\n".join(lines) + "\n"
    done = subprocess.run([program], input=text, capture_output=True, text=True, check=True)
    faults = [line.split() for line in done.stdout.splitlines()]
    assert len(faults) == len(lines)
    return [[C_NAMES.get(field, field), *bounds] for field, *bounds in faults]


def fault_of(config: AmplifierConfig) -> str:
    """Return the field of which the amplifier in Python complains; - for none."""
    try:
        ReferenceAmplifier(config)
    except ValueError as error:
        return str(error).split()[0]
    return "-"


# By hand, from the tables of SPEC.md


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (
            {"fifo": 1023},
            "fifo_samples 1023, which must be 1024 … 65535, 64 ms at rate_max_hz 16000",
        ),
        (
            {"fifo": 65_536},
            "fifo_samples 65536, which must be 1024 … 65535, 64 ms at rate_max_hz 16000",
        ),
        (
            {"tick_hz": 159_999},
            "tick_hz 159999, which must be 160000 … 4294967295, 10 a sample at rate_max_hz 16000",
        ),
        ({"rate_min_hz": 999}, "rate_min_hz 999, which must be 1000 … 16000, rate_max_hz"),
        ({"rate_min_hz": 16_001}, "rate_min_hz 16001, which must be 1000 … 16000, rate_max_hz"),
        ({"rate_max_hz": 1_000_001}, "rate_max_hz 1000001, which must be 1000 … 1000000"),
        ({"formats": 0}, "formats 0, which must have a bit of 0 … 3"),
        ({"formats": 0xFF00}, "formats 65280, which must have a bit of 0 … 3"),
        (
            {"formats": 8, "carriers": 0},
            "carriers 0, which must be 1 … 64, with bit 3 of formats (SPEC.md, 10)",
        ),
        (
            {"voltage_limit_uv": 100_000_001},
            "voltage_limit_uv 100000001, which must be 1 … 100000000, full_scale_uv",
        ),
        ({"voltage_limit_uv": 0}, "voltage_limit_uv 0, which must be 1 … 100000000, full_scale_uv"),
        (
            {"full_scale_uv": 60_000_001, "voltage_limit_uv": 1, "estop_input": False},
            "estop_input False, which must be True, as full_scale_uv 60000001 is above 60000000 "
            "(SPEC.md, 6.3)",
        ),
        ({"fade_limit_us": 20_001}, "fade_limit_us 20001, which must be 0 … 20000"),
        ({"packet_limit": 135}, "packet_limit 135, which must be 136 … 4096"),
        ({"packet_limit": 4097}, "packet_limit 4097, which must be 136 … 4096"),
        ({"node": 0}, "node 0, which must be 1 … 127"),
        ({"channels": 256}, "channels 256, which must be 1 … 255"),
        (
            {"sense_ranges_ua": (2500, 0)},
            "sense_ranges_ua (2500, 0), which must be 1 … 65535 each (SPEC.md, 16)",
        ),
        ({"current_delay": -1}, "current_delay -1, which must be 0 or more (SPEC.md, 16.1)"),
        (
            {"name": "a" * 17},
            "name 'aaaaaaaaaaaaaaaaa', which must be UTF-8 of 16 bytes at most without zeros "
            "(SPEC.md, 1)",
        ),
    ],
)
def test_what_the_spec_forbids_is_refused_with_field_value_and_limit(
    change: dict[str, Any], line: str
) -> None:
    with pytest.raises(ValueError, match=r".") as refused:
        ReferenceAmplifier(replace(GOOD, **change))
    assert str(refused.value) == line


@pytest.mark.parametrize(
    "change",
    [
        {"formats": 7, "carriers": 0},  # no spectrum frames (section 10)
        {"formats": 0xFF01},  # of later versions
        {"full_scale_uv": 60_000_000, "voltage_limit_uv": 1, "estop_input": False},
        {"name": "ä" * 8},
        {"name": ""},
        {"fade_limit_us": 0},
        {"rate_min_hz": 1000, "rate_max_hz": 1000, "fifo": 64, "tick_hz": 10_000},
    ],
)
def test_what_the_spec_allows_is_taken(change: dict[str, Any], config_program: Path) -> None:
    config = replace(GOOD, **change)
    assert fault_of(config) == "-"
    assert faults_in_c(config_program, [line_of(config, config.name.encode())])[0][0] == "-"


def reaches(config: AmplifierConfig, rate: int) -> bool:
    """Return whether limit ≤ step × ⌊rate / 50⌋, as section 11.1 writes it."""
    limit = min(config.voltage_limit_uv * 32767 // config.full_scale_uv, 32767)
    step = config.slew_limit_v_per_s * 32767 * 10**6 // (config.full_scale_uv * rate)
    return limit <= min(step, 65534) * (rate // 50)


@pytest.mark.parametrize(
    ("low", "top", "volts"),
    [(1000, 1049, 100), (2500, 8000, 100), (1000, 1600, 60), (7999, 8001, 1), (1050, 48_000, 99)],
)
def test_the_slew_limit_is_the_least_that_reaches_0_volts_at_every_rate(
    low: int, top: int, volts: int, config_program: Path
) -> None:
    """All rates are tried one by one; 1 V/s less fails at one of them at least."""
    config = replace(
        GOOD, rate_min_hz=low, rate_max_hz=top, fifo=4096, voltage_limit_uv=volts * 10**6,
        slew_limit_v_per_s=1,
    )  # fmt: skip
    least = int(config_fault(config).split(" must be ")[1].split()[0])
    enough, less = (replace(config, slew_limit_v_per_s=least - k) for k in (0, 1))
    assert all(reaches(enough, rate) for rate in range(low, top + 1))
    assert not all(reaches(less, rate) for rate in range(low, top + 1))
    assert config_fault(enough) == ""
    faults = faults_in_c(config_program, [line_of(enough, b""), line_of(less, b"")])
    assert faults[0][0] == "-"
    assert faults[1] == ["slew_limit_v_per_s", str(least), str(10**8)]


def test_both_ends_of_the_rates_do_not_suffice() -> None:
    """5006 V/s reach 0 V from 100 V at 2500 and at 8000 Hz, and not at 2549 Hz (11.1)."""
    config = replace(GOOD, rate_max_hz=8000, slew_limit_v_per_s=5006)
    assert reaches(config, 2500)
    assert reaches(config, 8000)
    assert not reaches(config, 2549)
    assert config_fault(config).endswith("in 20 ms at 2549 Hz")


# At random


def some(rng: Random, field: str, config: AmplifierConfig) -> int:
    """Return a value of a field: at a limit, one beside it, or any."""
    least, most = RANGES[field]
    top = config.rate_max_hz
    limits = {
        "fifo": [-(-64 * top // 1000), most],
        "tick_hz": [10 * top, most],
        "rate_min_hz": [least, top],
        "rate_max_hz": [least, most, config.rate_min_hz],
        "voltage_limit_uv": [least, config.full_scale_uv],
        "full_scale_uv": [least, most, 60_000_000, config.voltage_limit_uv],
        "slew_limit_v_per_s": [least, most, least_slew(config)],
    }.get(field, [least, most])
    value = rng.choice(limits) + rng.choice([-1, 0, 0, 1])
    if rng.random() < 0.3:
        value = rng.randrange(2 ** rng.randint(1, WIDTHS.get(field, 32)))
    most = 2 ** WIDTHS.get(field, 32) - 1
    return int(min(max(value, 0), most))


def least_slew(config: AmplifierConfig) -> int:
    """Return about the least slew limit, from the rule at the lowest rate alone."""
    limit = 32767 * config.voltage_limit_uv // max(config.full_scale_uv, 1)
    rate = max(config.rate_min_hz, 50)
    return -(limit // -(rate // 50)) * config.full_scale_uv * rate // (32767 * 10**6)


def any_config(rng: Random) -> AmplifierConfig:
    config = replace(
        GOOD,
        estop_input=rng.random() < 0.8,
        sense_ranges_ua=rng.choice([(), (1,), (65_535,), (0,)] if rng.random() < 0.2 else [()]),
        current_delay=rng.choice([0, 200]),
    )
    if rng.random() < 0.5:
        low = rng.choice([1000, 1000, rng.randint(1000, 40_000)])
        top = min(rng.choice([low, low + rng.randint(0, 3000), 4 * low]), 1_000_000)
        config = replace(
            config, rate_min_hz=low, rate_max_hz=top, fifo=min(65_535, 64 * top // 1000 + 1),
            tick_hz=10 * top, slew_limit_v_per_s=10**8,
        )  # fmt: skip
    for field in rng.sample(list(RANGES), rng.choice([0, 1, 1, 1, 2, 3])):
        change: dict[str, Any] = {field: some(rng, field, config)}
        config = replace(config, **change)
    return config


def test_c_and_python_refuse_the_same_configurations_for_the_same_field(
    config_program: Path,
) -> None:
    rng = Random(11)
    configs = [any_config(rng) for _ in range(20_000)]
    faults = faults_in_c(config_program, [line_of(c, b"virtual") for c in configs])
    seen: Counter[str] = Counter()
    for config, (field, least, most) in zip(configs, faults, strict=True):
        line = config_fault(config)
        name = line.split()[0] if line else "-"
        assert name == field, (config, line)
        if name not in ("-", "formats", "estop_input") and least != most:
            assert f"{least} … {most}" in line, config
        seen[name] += 1
    fields = {"fifo_samples" if f == "fifo" else f for f in RANGES} | {
        "estop_input",
        "sense_ranges_ua",
        "-",
    }
    assert set(seen) == fields
    assert min(seen.values()) >= 20, seen


def test_names_are_utf_8_padded_with_zeros(config_program: Path) -> None:
    """Bytes at random, most of them at the edges of UTF-8: Python's decoder is the judge."""
    rng = Random(12)
    parts = [
        b"a", b"\xc3\xa4", b"\xe2\x82\xac", b"\xf0\x9f\x98\x80", b"\x7f", b"\x80",
        b"\xc1\xbf", b"\xe0\x9f\xbf", b"\xe0\xa0\x80", b"\xed\x9f\xbf", b"\xed\xa0\x80",
        b"\xf0\x8f\xbf\xbf", b"\xf4\x8f\xbf\xbf", b"\xf4\x90\x80\x80", b"\xf5\x80\x80\x80",
        b"\0", b"\xc3",
    ]  # fmt: skip
    names = [b"".join(rng.choices(parts, k=rng.randint(0, 9)))[:16] for _ in range(4000)]
    names += [bytes([lead, *rng.randbytes(3)]) for lead in range(256)]
    faults = faults_in_c(config_program, [line_of(GOOD, name) for name in names])
    right = 0
    for name, (field, *_) in zip(names, faults, strict=True):
        try:
            text = name.rstrip(b"\0").decode()
            expected = config_fault(replace(GOOD, name=text)).partition(" ")[0] or "-"
        except UnicodeDecodeError:
            expected = "name"
        assert field == expected, name
        right += field == "-"
    assert 500 < right < 3500


def wiring(**changes: Any) -> Wiring:
    return replace(
        Wiring(channels=2, sample_rate=8000.0, voltage=100.0, slew=7e5, fade=0.02), **changes
    )


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"sample_rate": 500.0}, "rate_max_hz 500, which must be 1000 … 1000000"),
        ({"voltage": 5000.0, "slew": 9e7}, "full_scale_uv 5000000000, which must be 1 … "),
    ],
)
def test_a_display_that_no_amplifier_can_drive_is_refused(
    change: dict[str, Any], line: str
) -> None:
    with pytest.raises(InputError, match=f"^{line}"):
        config_of(wiring(**change), 2, 1)
