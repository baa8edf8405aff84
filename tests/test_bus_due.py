"""When a bus says that a sample is put out, the amplifier's own clock says the same."""

import os
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from benchmarks.virtual import VirtualAmplifier, can_be_built
from firmware_protocol.messages import State
from tactile.bus.base import DriveBlock
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.registry import open_bus
from tactile.display.display import load_display

BLOCK, BLOCKS = 16, 500
CLOCK = 1e-3
"""Largest clock error [s]; a quiet machine has 15 µs, a busy one answers pings late."""


@pytest.mark.realtime
def test_a_position_is_due_when_the_amplifier_puts_it_out(tmp_path: Path) -> None:
    if not can_be_built():
        assert os.environ.get("CI") != "true", "no C compiler"
        pytest.skip("needs make and cc")
    display = load_display("reference-24")
    rest = np.zeros((BLOCK, display.channels))
    told = {}
    with (
        closing(VirtualAmplifier(tmp_path, "--pty")) as amplifier,
        open_bus(f"serial://{amplifier.path}", display) as bus,
    ):
        assert isinstance(bus, LinkBus)
        bus.start(1000)
        for k in range(BLOCKS):
            position = 1000 + k * BLOCK
            bus.write(DriveBlock(position, rest))
            told[position] = bus.due(position)
        (peer,) = bus.peers
        first, begun = peer.wire_end(0), peer.begun
        bus.stop()
        records = amplifier.take()
    playing = (records.state == State.RUNNING) & (records.tick >= begun)
    position = records.position[playing].astype(np.int64) - first
    put_out = amplifier.powered_up + records.tick[playing] * 1e-6
    at = {int(p): t for p, t in zip(position[::-1], put_out[::-1], strict=True)}
    late = np.array([told[p] - at[p] for p in told if p in at])
    assert len(late) > 0.9 * BLOCKS
    assert abs(np.median(late)) < CLOCK
    assert np.median(np.abs(late - np.median(late))) < CLOCK
