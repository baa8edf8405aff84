"""Checks in QEMU: our CAN bus against amplifiers in C, on the kernel's interface."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest
from bus_tools import (
    Record,
    assert_is,
    linked,
    opened,
    play,
    playing,
    wait_for_link,
)
from guest_tools import WAIT, command, virtual_amplifier, wait_for
from numpy.typing import NDArray

from firmware_protocol.messages import State
from tactile.bus import can_bus
from tactile.bus.link import link_bus
from tactile.bus.registry import find_devices
from tactile.errors import BusError

INTERFACE = "vcan0"
CLASSIC = f"can:socketcan/{INTERFACE}?format=bfp8"
REARMED = f"{CLASSIC}&rearm=true"
FD = f"can:socketcan/{INTERFACE}?fd=true"
FD_MTU = 72
RATE = 2500
"""Sample rate [Hz]. The processor of a guest copes with two amplifiers at this rate, no more."""
TICK_HZ = 1_000_000
TOGETHER = 1e-3
"""Largest difference in time between two amplifiers that play together [s]."""
ESTOP_MS, DEATH_MS = 20, 220


@pytest.fixture(autouse=True)
def interface() -> Iterator[None]:
    command("ip", "link", "add", INTERFACE, "type", "vcan")
    command("ip", "link", "set", INTERFACE, "mtu", str(FD_MTU), "up")
    yield
    command("ip", "link", "delete", INTERFACE)


@contextmanager
def amplifier(out: Path, channels: int, *options: str) -> Iterator[None]:
    out.unlink(missing_ok=True)
    words = ["--socketcan", INTERFACE, "--channels", str(channels), "--out", str(out)]
    with virtual_amplifier(*words, *options):
        wait_for("the amplifier is there", out.exists)
        yield


@pytest.mark.parametrize(("url", "channels"), [(CLASSIC, 3), (FD, 24)])
def test_it_plays_what_it_is_given(tmp_path: Path, url: str, channels: int) -> None:
    out = tmp_path / "out"
    with amplifier(out, channels, *["--fd"] * (url == FD)):
        with linked(url, channels) as bus:
            volts = play(bus)
        wait_for("high voltage is off", lambda: not Record.read(out, channels).high_voltage[-1])
    record = Record.read(out, channels)
    assert_is(record.played(bus, len(volts)), volts, bus.plan.sample_format)
    assert record.at_rest[-1]


def test_two_amplifiers_play_one_display_together(tmp_path: Path) -> None:
    outs = [tmp_path / "1", tmp_path / "2"]
    with ExitStack() as stack:
        for k, out in enumerate(outs):
            stack.enter_context(amplifier(out, 2, "--fd", "--node", str(k + 1)))
        with linked(f"{FD}&nodes=1,2", 4, RATE) as bus:
            volts = play(bus)
    records = [Record.read(out, 2) for out in outs]
    clocks = [peer.clock for peer in bus._session.peers]
    begins = [
        clock.host_time_at(int(record.ticks[record.began(bus, k)]))
        for k, (clock, record) in enumerate(zip(clocks, records, strict=True))
        if clock is not None
    ]
    assert abs(begins[1] - begins[0]) < TOGETHER
    together = np.hstack([r.played(bus, len(volts), k) for k, r in enumerate(records)])
    assert_is(together, volts, bus.plan.sample_format)


def estopped(out: Path, channels: int) -> NDArray[np.bool_]:
    return np.asarray(Record.read(out, channels).states == State.ESTOP)


def test_an_estop_ends_at_0_volts_in_time(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with amplifier(out, 24, "--fd"), linked(f"{FD}&rearm=true", 24) as bus:
        with playing(bus):
            wait_for("it plays", lambda: not Record.read(out, 24).at_rest.all())
            bus.estop()
        assert bus.status.state == "estopped"
        wait_for("it is told", lambda: bool(estopped(out, 24).any()))
        bus.clear()
        assert bus.state == "idle"
    record = Record.read(out, 24)
    told = record.first(record.states == State.ESTOP)
    assert not record.at_rest[record.ticks < told][-1]
    silent = record.first((record.ticks >= told) & record.at_rest)
    assert silent - told <= ESTOP_MS * TICK_HZ / 1e3
    assert record.at_rest[record.ticks >= silent].all()


@pytest.mark.parametrize("rearm", [False, True])
def test_an_interface_that_goes_down_while_it_plays(tmp_path: Path, rearm: bool) -> None:
    out = tmp_path / "out"
    with amplifier(out, 3), linked(f"{CLASSIC}&rearm={str(rearm).lower()}", 3) as bus:
        with playing(bus):
            wait_for("it plays", lambda: not Record.read(out, 3).at_rest.all())
            command("ip", "link", "set", INTERFACE, "down")
            wait_for_link(bus, "down")
            assert "the interface is down" in bus.status.detail
            wait_for("its state is true", lambda: bus.state == ("running" if rearm else "idle"))
            wait_for("it is safe", lambda: Record.read(out, 3).states[-1] == State.SAFE)
            safe = Record.read(out, 3).ticks[-1]
            command("ip", "link", "set", INTERFACE, "up")
            wait_for_link(bus, "up")
            if rearm:
                wait_for(
                    "it plays on",
                    lambda: not (r := Record.read(out, 3)).at_rest[r.ticks > safe].all(),
                )
                assert "not armed" not in bus.status.detail
            else:
                wait_for("it is told", lambda: "not armed again" in bus.status.detail)
                assert Record.read(out, 3).at_rest[-1]
        assert (bus.counters.disconnects, bus.counters.reconnects) == (1, 1)
        assert bus.counters.dropped_samples
        assert bus.state == ("running" if rearm else "idle")
        bus.stop()
        wait_for("it is at 0 V", lambda: bool(Record.read(out, 3).at_rest[-1]))
        bus.start()  # and is as good as new
        bus.stop()


def test_an_interface_that_is_taken_away_and_comes_back(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with amplifier(out, 3), linked(REARMED, 3) as bus:
        command("ip", "link", "delete", INTERFACE)
        wait_for_link(bus, "down")
        command("ip", "link", "add", INTERFACE, "type", "vcan")
        command("ip", "link", "set", INTERFACE, "up")
        wait_for_link(bus, "up")
        with playing(bus):
            wait_for("it plays", lambda: not Record.read(out, 3).at_rest.all())


def test_a_host_that_is_killed_leaves_0_volts(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with amplifier(out, 3):
        child = os.fork()
        if not child:
            try:
                bus = opened(REARMED, 3)
                with playing(bus):
                    time.sleep(WAIT)
            except BusError as error:
                print(error, flush=True)
            finally:
                os._exit(1)
        try:
            wait_for("it plays", lambda: not Record.read(out, 3).at_rest.all())
            before = int(Record.read(out, 3).ticks[-1])
        finally:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
        wait_for("it is safe", lambda: Record.read(out, 3).states[-1] == State.SAFE)
    record = Record.read(out, 3)
    safe = record.first((record.states == State.SAFE) & record.at_rest)
    assert safe - before <= DEATH_MS * TICK_HZ / 1e3
    assert record.at_rest[record.ticks >= safe].all()
    assert not record.high_voltage[record.ticks >= safe].any()


def test_nobody_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_bus, "OPENING", 0.5)
    with pytest.raises(BusError, match="nothing answers HELLO") as caught:
        opened(CLASSIC, 3)
    assert "\n" not in str(caught.value)
    command("ip", "link", "set", INTERFACE, "down")
    with pytest.raises(BusError, match="the interface is down") as caught:
        opened(CLASSIC, 3)
    assert "\n" not in str(caught.value)
    with pytest.raises(BusError, match=rf"no such interface; there are: .*{INTERFACE}"):
        opened("can:socketcan/vcan9", 3)


def test_the_interface_is_found() -> None:
    assert f"can:socketcan/{INTERFACE}" in [found.url for found in can_bus.find()]
    assert f"can:socketcan/{INTERFACE}" in [found.url for found in find_devices()]
