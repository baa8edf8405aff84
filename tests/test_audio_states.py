"""The state of an audio card's bus where its player ends, without a card.

The player is one in memory that answers as `audio_player` does; that the real one does so is what
`test_audio_bus` and `test_audio_player` show.
"""

from collections.abc import Callable

import numpy as np
import pytest

from tactile.bus.audio import audio_bus
from tactile.bus.audio.audio_bus import AudioBus
from tactile.bus.audio.player import Order, PlayerStatus, StreamOpened
from tactile.bus.base import DriveBlock, Wiring
from tactile.errors import BusError, BusStateError

RATE = 48000.0
WIRING = Wiring(channels=1, sample_rate=RATE, voltage=100.0, slew=0.7e6, fade=20e-3)
ORDER = Order(device="", channels=1, sample_rate=RATE, wiring=WIRING, full_scale=100.0)
BLOCK = np.full((64, 1), 5.0)
PIECE = 256
"""Samples of a block that are handed to the card at once, 5 ms; an e-stop comes between them."""


class Card:
    """A player in memory.

    Attributes
    ----------
    heard : the kinds of messages that it got
    hook : called after each of them
    """

    def __init__(self, order: Order | None) -> None:
        self.stream = StreamOpened("card", WIRING, 0.0)
        self.ended, self.failed, self.output, self.status_time = False, None, None, np.inf
        self.phase = "rest"
        self.heard: list[str] = []
        self.hook: Callable[[str], object] = lambda kind: None
        made.append(self)

    @property
    def status(self) -> PlayerStatus:
        """State of the card: it takes whatever comes."""
        return PlayerStatus(0, self.phase, 0, 10**9, 0, 0, 0, 0, 0, 0.0, 0.0, "", "")  # type: ignore[arg-type]

    def send(self, kind: str, *rest: object, seconds: float = 1.0) -> int:
        self.heard.append(kind)
        if kind == "start":
            self.phase = "waiting"
        elif kind in ("stop", "abort", "estop"):
            self.phase = "rest"
        number = len(self.heard)
        self.hook(kind)
        return number

    def request(self, kind: str = "status", *, seconds: float = 1.0) -> PlayerStatus | None:
        return None if self.ended else self.status

    def wait_for_card(self, seconds: float, *, rest: bool = True) -> bool:
        return not self.ended and (self.phase == "rest") == rest

    def kill(self) -> None:
        self.ended = True

    def close(self) -> None:
        self.ended = True


made: list[Card] = []


@pytest.fixture
def bus(monkeypatch: pytest.MonkeyPatch) -> AudioBus:
    made.clear()
    monkeypatch.setattr(audio_bus, "AudioProcess", Card)
    monkeypatch.setattr(audio_bus, "opened_stream", lambda player: player.stream)
    monkeypatch.setattr(audio_bus, "RETRY", 0.0)
    return AudioBus(ORDER)


def test_where_the_card_is_lost_the_bus_is_idle_and_a_start_plays_on(bus: AudioBus) -> None:
    bus.start()
    bus.write(DriveBlock(0, BLOCK))
    assert (bus.status.state, bus.status.playing) == ("running", True)
    made[0].ended = True
    assert bus.state == "idle"
    bus.write(DriveBlock(64, BLOCK))
    assert bus.counters.dropped_samples == 64
    while bus.status.link == "down":
        assert (bus.state, bus.status.playing) == ("idle", False)
    assert bus.status.state == "idle"
    assert "stop and start to play on" in bus.status.detail
    bus.write(DriveBlock(128, BLOCK))
    assert bus.counters.dropped_samples == 128
    assert "samples" not in made[1].heard
    bus.stop()
    with pytest.raises(BusStateError, match="write: the bus is idle"):
        bus.write(DriveBlock(192, BLOCK))
    bus.start()
    bus.write(DriveBlock(0, BLOCK))
    assert (bus.status.state, bus.status.playing, bus.status.detail) == ("running", True, "")
    assert made[1].heard.count("samples") == 1


def test_an_estop_between_pieces_of_a_block_drops_the_rest(bus: AudioBus) -> None:
    bus.start()
    made[0].hook = lambda kind: bus.estop() if kind == "samples" else None
    bus.write(DriveBlock(0, np.full((3 * PIECE, 1), 5.0)))
    assert {bus.state} == {"estopped"}
    assert bus.counters.dropped_samples == 2 * PIECE
    bus.write(DriveBlock(3 * PIECE, BLOCK))
    assert bus.counters.dropped_samples == 2 * PIECE + 64
    assert made[0].heard.count("samples") == 1
    bus.clear()
    assert bus.state == "idle"


def test_a_clear_that_the_player_does_not_answer_is_none(bus: AudioBus) -> None:
    bus.estop()
    made[0].hook = lambda kind: made[0].kill()
    with pytest.raises(BusError, match="clear: no answer; it stays e-stopped"):
        bus.clear()
    while (status := bus.status).link == "down":
        assert status.state == "estopped"
    assert status.state == "estopped"
    bus.clear()
    assert {bus.state} == {"idle"}


def test_an_estop_during_a_start_holds_and_is_no_loss_of_the_card(bus: AudioBus) -> None:
    def press(kind: str) -> None:
        made[0].hook = lambda kind: None
        bus.estop()

    made[0].hook = press
    with pytest.raises(BusStateError, match="start: the bus was e-stopped meanwhile"):
        bus.start()
    assert (bus.state, bus.status.link) == ("estopped", "up")
    assert made[0].heard[-1] == "estop"
    assert bus.counters.disconnects == 0
    bus.clear()
    bus.start()
    assert bus.state == "running"
