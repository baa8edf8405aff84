"""Tests of the figures of the protocol: capacities by hand, and faults that are noticed."""

import numpy as np
import pytest

from benchmarks import BENCHMARKS, LONG
from benchmarks.faults import (
    HARMS,
    SPOILERS,
    Account,
    harmed_frames,
    spoilt_stream,
)
from benchmarks.protocol import measure_formats, measure_links, signal_to_error_db
from firmware_protocol.messages import SampleFormat
from firmware_protocol.packet import Packet


def test_links_carry_what_is_promised() -> None:
    """256 B in 274: 276 bytes of 10 bits; 40 frames of CAN, 5 of CAN FD; 9 bits a byte on I²C."""
    found = {f.name.removeprefix("protocol."): f for f in measure_links()}
    assert [f for f in found.values() if f.reached is False] == []
    by_hand = {
        "uart.efficiency": 2048 / 2760,
        "uart.efficiency.worst": 2048 / 2770,
        "can.efficiency.unstuffed": 2048 / (39 * 111 + 79),
        "can.efficiency.worst": 2048 / (39 * 135 + 79 + 16),
        "can_fd.efficiency.unstuffed": 2048 / (5 * 5 * 30 + 4 * 549 + 293),
        "i2c.efficiency": 2048 / (2 + 9 * 275),
        "smbus.efficiency": 2048 / (9 * 2 + 9 * (9 * 3 + 276 + 9)),
    }
    for name, part in by_hand.items():
        assert found[name].value == pytest.approx(100 * part, rel=1e-3), name


@pytest.mark.parametrize("kind", SPOILERS)
@pytest.mark.parametrize("longest", [1, 8])
def test_a_spoilt_byte_costs_a_packet_and_makes_none(kind: str, longest: int) -> None:
    account = spoilt_stream(SPOILERS[kind], 300, longest=longest, seed=1)
    assert account.errors == 300
    assert account.wrong == account.twice == 0
    assert 270 <= account.lost <= 1.2 * 300


@pytest.mark.parametrize("kind", HARMS)
@pytest.mark.parametrize("fd", [False, True])
def test_a_harmed_frame_costs_a_packet_and_makes_none(kind: str, fd: bool) -> None:
    """A whole packet in one FD frame that comes twice is received twice; streams bear that."""
    account = harmed_frames(HARMS[kind], 300, fd=fd, seed=1)
    assert account.wrong == 0
    assert 0 < account.lost <= 1.2 * 300
    assert account.twice == 0 or (kind, fd) == ("repeated", True)


def test_the_account_sees_what_is_lost_wrong_and_twice() -> None:
    sent = [Packet(1, b"a"), Packet(1, b"b"), Packet(1, b"c")]
    account = Account()
    account.add(sent, [sent[0], sent[0], Packet(1, b"d")], 2)
    assert account == Account(errors=2, lost=2, wrong=1, twice=1)
    assert [f.reached for f in account.figures("")] == [True, False]


def test_the_ratio_of_pcm12_on_noise_is_that_of_steps_of_16() -> None:
    """Rounding errors of 16 codes have a power of 16² / 12; uniform noise ± A has A² / 3."""
    noise = np.random.default_rng(0).uniform(-30_000, 30_000, (3200, 4))
    expected = 10 * np.log10((30_000**2 / 3) / (16**2 / 12))
    assert signal_to_error_db(noise, SampleFormat.PCM12) == pytest.approx(expected, abs=0.1)


def test_the_benchmarks_are_registered() -> None:
    assert {"protocol", "faults"} <= set(BENCHMARKS)
    assert "fuzz" in LONG


@pytest.mark.ci
def test_promised_figures_that_no_clock_decides_are_reached() -> None:
    """The figures of `measure_faults` are checked in `test_figures.py`."""
    figures = list(measure_formats())
    assert any(f.reached is not None for f in figures)
    assert [f for f in figures if f.reached is False] == []
