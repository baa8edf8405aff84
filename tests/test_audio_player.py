"""Tests of the callback of ``audio:`` and of the choice of a device.

`CardOutput`, which fills the card's buffers, is driven here by hand, buffer by buffer, so that its
clock is the test's.
"""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from audio_rig import ANY, CODE, FADE, FULL_SCALE, RATE, SLEW, STEP, VOLTAGE, WIRE, waves

from tactile.arrays import Floats
from tactile.bus.audio.devices import Device, choose, rate_of
from tactile.bus.audio.player import CardOutput
from tactile.bus.base import Wiring
from tactile.errors import BusError, InputError, NotFoundError

# The callback, buffer by buffer


def wiring(channels: int = 3, **changed: float) -> Wiring:
    usual = {"sample_rate": float(RATE), "voltage": VOLTAGE, "slew": ANY, "fade": 20e-3}
    return Wiring(channels=channels, **(usual | changed))


class Card:
    """A card whose buffers are asked for by hand."""

    def __init__(self, wiring: Wiring, buffer: int = 64, spare: int = 0) -> None:
        self.output = CardOutput(wiring, FULL_SCALE)
        self.buffer, self.spare = buffer, spare
        self.played = np.zeros((0, wiring.channels))

    def tell(self, kind: str, *rest: object) -> None:
        self.output.inbox.append((kind, *rest))

    def write(self, position: int, volts: Floats, block: int = 1) -> None:
        self.tell("samples", position, block, volts)

    def run(self, buffers: int = 1, *, underflow: bool = False) -> Floats:
        """Return what further buffers play [V]."""
        out = np.full((self.buffer, self.played.shape[1] + self.spare), 9, np.float32)
        parts = []
        for _ in range(buffers):
            self.output(out, self.buffer, None, SimpleNamespace(output_underflow=underflow))
            assert not out[:, self.played.shape[1] :].any(), "spare channels stay at 0"
            parts.append(out[:, : self.played.shape[1]].astype(np.float64) * FULL_SCALE)
        self.played = np.concatenate([self.played, *parts])
        return np.concatenate(parts)

    def rest(self, most: int = 100) -> Floats:
        """Run until at rest; return what was played [V]."""
        parts = [self.run()]
        while self.output.phase != "rest":
            parts.append(self.run())
            assert len(parts) < most, "comes to rest"
        return np.concatenate(parts)


def start(card: Card, volts: Floats, position: int = 0) -> None:
    card.tell("start", position)
    card.write(position, volts)
    card.tell("go")


def nearly(found: Floats, expected: Floats) -> None:
    """Compare to half a code and what single precision leaves."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=WIRE + 1e-5)


def test_a_card_at_rest_plays_zeros_and_the_amplifiers_clock_stands() -> None:
    card = Card(wiring(), spare=2)
    assert not card.run(10).any()
    assert len(card.output.output) == 0
    assert card.output.phase == "rest"


@pytest.mark.parametrize("buffer", [1, 64, 100, 512, 5000])
def test_what_is_written_is_played_then_a_straight_fade_to_exactly_0_volts(buffer: int) -> None:
    card = Card(wiring(), buffer)
    volts = waves(700, 3)
    start(card, volts, 10**12)
    card.tell("stop")
    out = card.rest(3000)
    nearly(out[:700], volts)
    line = volts[-1] * (1 - np.arange(1, FADE + 1) / FADE)[:, None]
    np.testing.assert_allclose(out[700 : 700 + FADE], line, rtol=0, atol=2 * CODE)
    assert not out[700 + FADE - 1 :].any()
    nearly(card.output.output, out[: len(card.output.output)])
    assert card.output.underruns == card.output.dropped_samples == 0


def test_float32_of_volts_over_full_scale_is_what_the_card_gets() -> None:
    card, volts = Card(wiring()), waves(64, 3)
    start(card, volts)
    out = np.zeros((64, 3), np.float32)
    card.output(out, 64, None, None)
    assert np.array_equal(out, (card.output.output / FULL_SCALE).astype(np.float32))
    np.testing.assert_allclose(card.output.output, volts, rtol=0, atol=1e-9)


def test_drive_waits_until_there_is_a_lead_of_it_or_it_was_waited_for() -> None:
    card = Card(wiring())
    card.tell("start", 0)
    assert not card.run(100).any(), "no drive, however long"
    card.write(0, waves(10, 3) + 1)
    silence = 0
    while not card.run().any() and silence < RATE:
        silence += card.buffer
    assert silence == pytest.approx(card.output.lead, abs=card.buffer)
    assert card.output.lead == RATE * 8 // 1000 + card.buffer


def test_a_writer_that_goes_silent_fades_and_comes_in_again_at_its_position() -> None:
    card = Card(wiring())
    level = np.tile([50.0, -30, 0], (640, 1))
    start(card, level)
    out = card.run(10)
    nearly(out, level)
    gone = card.run(40)
    line = level[0] * np.maximum(1 - np.arange(1, 2561) / FADE, 0)[:, None]
    np.testing.assert_allclose(gone, line, rtol=0, atol=2 * CODE)
    assert card.output.underruns == 1
    assert card.output.position == 3200
    card.write(3000, np.tile(level[0], (400, 1)), 2)
    back = card.run(3)
    assert card.output.dropped_samples == 200
    assert card.output.late_blocks == 1
    rise = level[0] * (np.arange(1, 193) / FADE)[:, None]
    np.testing.assert_allclose(back, rise, rtol=0, atol=2 * CODE)


def test_late_blocks_are_counted_once_whatever_they_are_cut_into() -> None:
    card = Card(wiring())
    start(card, np.zeros((640, 3)))
    card.run(30)
    for k in range(4):
        card.write(100 * k, np.ones((100, 3)), 7)
    card.write(400, np.ones((100, 3)), 8)
    card.run()
    assert card.output.late_blocks == 2
    assert card.output.dropped_samples == 500


def test_a_short_gap_is_bridged() -> None:
    card = Card(wiring())
    card.tell("start", 0)
    card.write(0, np.full((100, 3), 10.0))
    card.write(115, np.full((100, 3), 26.0))
    card.tell("go")
    out = card.run(3)
    np.testing.assert_allclose(out[99:116, 0], np.linspace(10, 26, 17), rtol=0, atol=2 * CODE)


def test_drive_far_ahead_waits_its_turn() -> None:
    """64 ms are what the amplifier can hold; all of it comes out, in order."""
    card, volts = Card(wiring(), 512), waves(RATE // 2, 3)
    start(card, volts[:100])
    for k in range(100, len(volts), 100):
        card.write(k, volts[k : k + 100])
    card.tell("stop")
    nearly(card.rest(200)[: len(volts)], volts)
    assert card.output.underruns == 0


@pytest.mark.parametrize("how", ["abort", "estop"])
@pytest.mark.parametrize("slew", [SLEW, 2e4])
def test_what_is_queued_is_dropped_and_the_output_falls_at_the_slew_limit(
    how: str, slew: float
) -> None:
    card = Card(wiring(slew=slew))
    climb = np.linspace(0, 80, 640)[:, None] * [1.0, -0.7, 0.1]
    start(card, np.concatenate([climb, np.tile(climb[-1], (2000, 1))]))
    card.run(10)
    card.tell(how)
    fall = card.rest()
    line = np.concatenate([climb[-1:], fall])
    step = slew / RATE
    assert np.abs(np.diff(line, axis=0)).max() <= step + CODE
    assert len(np.flatnonzero(fall.any(axis=1))) <= math.ceil(80 / (step - CODE)) + 1
    assert not card.run(20).any()


@pytest.mark.parametrize("before", ["rest", "waiting", "playing", "ending"])
def test_an_estop_holds_until_it_is_cleared_wherever_it_comes(before: str) -> None:
    card = Card(wiring())
    if before != "rest":
        card.tell("start", 0)
        card.write(0, np.full((200, 3), 50.0))
    if before in ("playing", "ending"):
        card.tell("go")
    if before == "ending":
        card.tell("stop")
    card.run(5 if before == "ending" else 1)
    assert card.output.phase == before
    card.tell("estop")
    card.rest()
    card.tell("samples", 200, 2, np.full((100, 3), 50.0))
    assert not card.run(20).any()
    card.tell("clear")
    card.run()
    assert card.output.refused == card.output.fault == ""
    start(card, np.full((64, 3), 5.0))
    nearly(card.run(), np.full((64, 3), 5.0))


def test_a_start_without_a_clear_gives_up_rather_than_play() -> None:
    card = Card(wiring())
    card.tell("estop")
    card.run()
    start(card, np.full((64, 3), 5.0))
    assert not card.run(3).any()
    assert "refused" in card.output.fault


def test_nothing_that_goes_wrong_in_the_callback_leaves_it_and_the_output_falls() -> None:
    card = Card(wiring(slew=SLEW))
    start(card, np.tile([80.0, -60, 0], (640, 1)))
    card.run(2)
    card.output._board = None  # type: ignore[assignment]
    fall = card.run(2)
    assert "AttributeError" in card.output.fault
    line = np.concatenate([[[80.0, -60, 0]], fall])
    assert np.abs(np.diff(line, axis=0)).max() <= STEP + CODE
    assert not fall[6:].any()
    assert not card.run(3).any()


def test_the_cards_underflows_count_only_while_something_plays() -> None:
    card = Card(wiring())
    card.run(3, underflow=True)
    assert card.output.xruns == 0
    start(card, np.zeros((640, 3)))
    card.run(1)
    card.run(3, underflow=True)
    assert card.output.xruns == 3


def test_no_step_is_larger_than_the_slew_limit_and_no_sample_than_the_voltage() -> None:
    card = Card(wiring(slew=SLEW))
    volts = np.random.default_rng(0).uniform(-VOLTAGE, VOLTAGE, (640, 3))
    start(card, volts)
    card.tell("stop")
    out = np.concatenate([np.zeros((1, 3)), card.rest()])
    assert np.abs(np.diff(out, axis=0)).max() <= STEP + 1e-4
    assert np.abs(out).max() <= VOLTAGE + 1e-4


def test_about_a_second_is_kept_and_the_inbox_is_bounded() -> None:
    card = Card(wiring(), 512)
    start(card, np.zeros((512, 3)))
    for k in range(1, 300):
        card.write(512 * k, np.full((512, 3), k / 10))
        card.run()
    kept = card.output.output
    assert RATE <= len(kept) <= RATE + 512
    assert kept[-1, 0] == pytest.approx(29.8, abs=0.11)
    for _ in range(5000):
        card.tell("go")
    assert len(card.output.inbox) == 1000, "ten times what a host that minds its lead has there"


# Choosing a device

FOUND = [
    Device(0, "HDA Intel: ALC (hw:0,0)", "ALSA", 2, 44100.0),
    Device(3, "DAC 24: USB (hw:1,0)", "ALSA", 24, 48000.0),
    Device(4, "system", "JACK", 24, 48000.0),
    Device(5, "default", "ALSA", 32, 44100.0),
    Device(6, "system", "OSS", 24, 48000.0),
]


@pytest.mark.parametrize(
    ("name", "index"),
    [("", 5), ("dac 24", 3), ("3", 3), ("DEFAULT", 5), ("system, jack", 4), ("hw:0", 0)],
)
def test_a_device_is_chosen_by_part_of_its_name_or_number(name: str, index: int) -> None:
    assert choose(FOUND, name, 5).number == index


def test_a_device_that_is_not_there_or_not_the_only_one_is_one_line() -> None:
    with pytest.raises(NotFoundError, match="no output device 'systen'; did you mean 'system'"):
        choose(FOUND, "systen", 5)
    with pytest.raises(NotFoundError, match="no output device '99'; there is: HDA"):
        choose(FOUND, "99", 5)
    with pytest.raises(NotFoundError, match="no default output device"):
        choose(FOUND, "", -1)
    with pytest.raises(InputError, match=r"'system' is the name of 2 devices: .*audio:4"):
        choose(FOUND, "system", 5)
    with pytest.raises(BusError, match="no output device; plug one in"):
        choose([], "", -1)


class Portaudio:
    """Stands for sounddevice where a card's manners are what is tested."""

    class PortAudioError(Exception):
        """Error of the substitute for PortAudio."""

    def __init__(self, *rates: float) -> None:
        self.rates = rates

    def check_output_settings(
        self, device: int, channels: int, dtype: str, *, samplerate: float
    ) -> None:
        if samplerate not in self.rates:
            raise self.PortAudioError("Invalid sample rate" if self.rates else "unavailable")


def test_a_rate_is_the_cards_own_or_one_that_it_plays() -> None:
    card = Portaudio(44100.0, 48000.0)
    assert rate_of(card, FOUND[1], 24, None) == 48000
    assert rate_of(card, FOUND[1], 24, 44100.0) == 44100
    with pytest.raises(InputError, match="8000 Hz: it plays 44100, 48000 Hz; leave it out"):
        rate_of(card, FOUND[1], 24, 8000.0)
    with pytest.raises(InputError, match="has 24 output channels, needs 25"):
        rate_of(card, FOUND[1], 25, None)
    with pytest.raises(BusError, match="unavailable; close what else plays on it"):
        rate_of(Portaudio(), FOUND[1], 24, None)
