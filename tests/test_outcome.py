"""Tests of the outcome of a stroke, against the counts of the amplifier itself."""

import subprocess
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from link_rig import RATE, Bench, Linked, disturb

from firmware_protocol.machine import PlayedRun
from firmware_protocol.messages import Fault
from firmware_protocol.player import SamplePlayer
from firmware_protocol.sources import Ints
from tactile.bus.base import BusStatus, DriveBlock, Wiring
from tactile.bus.simulated.line_model import Faults
from tactile.bus.simulated.mock_bus import MockBus
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.playback import runs
from tactile.playback.outcome import Outcome, outcome_of
from tactile.playback.trajectory_playback import PlayedBlock
from tactile.rendering.contact import Trajectory
from tactile.rendering.renderer import Renderer
from tactile.texture.surface import load_texture

WIRING = Wiring(channels=2, sample_rate=8000.0, voltage=100.0, slew=1e5, fade=0.02)


@pytest.mark.parametrize(
    ("lost", "percent", "is_within"),
    [
        (0, "100 %", True),
        (1, "99.99 %", True),
        (40, "99.90 %", True),
        (41, "99.89 %", False),
        (40_000, "0.00 %", False),
    ],
)
def test_a_share_is_never_rounded_up_and_one_in_a_thousand_may_be_lost(
    lost: int, percent: str, is_within: bool
) -> None:
    outcome = Outcome(40_000, 40_000 - lost)
    assert outcome.lost_samples == lost
    assert outcome.percent == percent
    assert outcome.is_within(Fraction("0.1")) is is_within
    assert outcome.is_within(100)


def test_a_stroke_whose_end_did_not_come_or_was_out_of_reach_was_not_played() -> None:
    assert not Outcome(100, 100, link="down").is_within(100)
    assert not Outcome(100, 100, ending="failed").is_within(100)
    assert not Outcome(100, 100, ending="interrupted").is_within(100)


@pytest.mark.parametrize("gap", [0, 1, 300])
def test_positions_that_no_block_carried_are_lost(gap: int) -> None:
    with MockBus(WIRING) as bus:
        bus.start()
        bus.write(DriveBlock(0, np.zeros((400, 2))))
        bus.write(DriveBlock(400 + gap, np.zeros((600 - gap, 2))))
        status = bus.status
        bus.stop()
        outcome = outcome_of(1000, bus, status)
    assert outcome.lost_samples == gap
    assert outcome.cause.startswith(f"{gap} lost_samples") is (gap > 0)
    assert bool(outcome.cause) is (gap > 0)


def test_the_delay_of_the_renderer_is_no_part_of_the_stroke() -> None:
    with MockBus(WIRING) as bus:
        bus.start()
        bus.write(DriveBlock(0, np.zeros((1000, 2))))
        status = bus.status
        bus.stop()
        assert outcome_of(900, bus, status, delay=100) == Outcome(900, 900)
        assert outcome_of(1000, bus, status, delay=100).put_out_samples == 900


def test_the_cause_is_the_latest_fault_that_the_bus_names() -> None:
    with MockBus(WIRING) as bus:
        bus.start()
        status = BusStatus("running", "down", "what is wrong now", last_fault="what was wrong")
        assert outcome_of(100, bus, status).cause == "what was wrong"
        assert outcome_of(100, bus, status, error="the error").cause == "the error"


@pytest.mark.parametrize("link", ["serial", "can"])
@pytest.mark.parametrize("alone", [0.0, 0.06])
def test_an_amplifier_that_had_nothing_to_play_reports_it(
    linked: Linked, link: str, alone: float
) -> None:
    """A host that does not write for 60 ms has nothing to drop, and yet leaves a gap."""
    rig = linked(link, "")
    rig.begin(0.2)
    rig.model.run_alone(rig.clock.now() + alone)
    rig.play(0.2)
    rig.bus.stop()
    silent = max(amplifier.counters.lost_samples for amplifier in rig.model.amplifiers)
    assert (silent > 0) is (alone > 0)
    assert rig.bus.unplayed == silent


def test_samples_that_were_lost_on_the_wire_are_the_cause_where_nothing_else_is(
    linked: Linked,
) -> None:
    rig = linked("serial", "&loss=0.02")
    rig.begin(0.5)
    status = rig.bus.status
    rig.bus.stop()
    outcome = outcome_of(rig.position, rig.bus, status)
    silent = rig.model.amplifiers[0].counters.lost_samples
    assert outcome.lost_samples == silent > 0
    assert outcome.cause == f"{silent} samples did not reach the amplifier in time"


class Truth:
    """Positions that amplifiers played as they were sent, noted inside the amplifiers."""

    def __init__(self, rig: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
        self._rig, self._spans = rig, list[tuple[SamplePlayer, int, int]]()
        self._played = [set[int]() for _ in rig.model.amplifiers]
        self._usual, self._on_output = SamplePlayer._playing, rig.model.on_output
        monkeypatch.setattr(SamplePlayer, "_playing", lambda *given: self._playing(*given))
        rig.model.on_output = self._output

    def _playing(self, player: SamplePlayer, n: int, count: int) -> Ints:
        before = player.underruns, player.lost_samples
        out = self._usual(player, n, count)
        if before == (player.underruns, player.lost_samples):
            self._spans.append((player, n, n + len(out)))
        return out

    def _output(self, board: int, run: PlayedRun) -> None:
        self._on_output(board, run)
        model, rig = self._rig.model, self._rig
        player = model.amplifiers[board]._player
        pace = model.configs[board].tick_hz * (1 + model.drift[board])
        due = (model.time_of(board, 0) + run.ticks / pace - rig.zero) * rig.rate
        for k, position in enumerate(np.rint(due).astype(int).tolist()):
            at = run.position + k
            if any(one is player and a <= at < b for one, a, b in self._spans[-50:]):
                self._played[board].add(position)

    @property
    def lost(self) -> int:
        """Number of positions of the stroke that some amplifier did not play."""
        stroke = set(range(self._rig.position))
        return max(len(stroke - played) for played in self._played)


@pytest.mark.parametrize(
    ("link", "options"),
    [
        ("serial", "&rearm=true&loss=0.02"),
        ("serial", "&rearm=true&disconnect_s=0.7&seed=3"),
        ("serial", "&rearm=true&power_s=0.7&seed=1"),
        ("can", "&rearm=true&stall_s=0.7&seed=2"),
        ("serial", "&disconnect_s=1&loss=0.02&seed=1"),
    ],
)
def test_as_much_is_lost_as_amplifiers_did_not_play(
    linked: Linked, monkeypatch: pytest.MonkeyPatch, link: str, options: str
) -> None:
    """An amplifier that dies has confirmed all but 10 ms, from one PULSE to the next.

    One that stops by itself says so by a PULSE; where that is lost, the next one comes after 10 ms
    at most. The first sample after a restart is left out for the gain to rise, and not reported.
    """
    rig = linked(link, options)
    rig.start()
    truth = Truth(rig, monkeypatch)
    rig.play(2.0)
    rig.bus.stop()
    rig.model.report_output()
    counters = rig.bus.counters
    unknown = counters.disconnects * 0.01 * RATE
    assert truth.lost > 0
    assert truth.lost - counters.reconnects - unknown <= rig.bus.unplayed
    assert rig.bus.unplayed <= truth.lost + unknown + 16 * counters.disconnects


@pytest.mark.parametrize("link", ["serial", "can"])
def test_what_an_amplifier_out_of_reach_was_sent_at_the_end_is_lost(
    linked: Linked, link: str
) -> None:
    """The host does not know yet that it is out of reach, and has dropped nothing."""
    rig = linked(link, "")
    rig.begin(0.5)
    disturb(rig, Faults(loss=1.0))
    rig.play(0.2)
    status = rig.bus.status
    assert (status.link, rig.bus.counters.dropped_samples) == ("up", 0)
    rig.bus.stop()
    outcome = outcome_of(rig.position, rig.bus, status)
    assert 0.2 * RATE <= outcome.lost_samples <= 0.22 * RATE
    assert "silent for 250 ms" in outcome.cause


def test_each_playing_adds_what_it_lost(linked: Linked) -> None:
    rig = linked("serial", "")
    for played in (1, 2):
        rig.begin(0.2)
        rig.model.run_alone(rig.clock.now() + 0.06)
        rig.play(0.2)
        rig.bus.stop()
        silent = rig.model.amplifiers[0].counters.lost_samples
        assert rig.bus.unplayed == silent > played * 0.04 * RATE


def overheat(bus: ModeledBus) -> None:
    """Let the first amplifier report a fault of its hardware."""
    bus.model.amplifiers[0].fault(Fault.OVERTEMPERATURE, bus.model.tick(0))


def hold_up(bus: ModeledBus) -> None:
    """Let the host do nothing for longer than the watchdog waits."""
    bus.model.run_alone(bus.model.clock.now() + 0.2)


@pytest.mark.parametrize(
    ("happens", "ending", "cause"),
    [
        (overheat, "failed", "reports a fault: overtemperature"),
        (hold_up, "complete", "no heartbeat reached it for 150 ms"),
    ],
)
def test_the_cause_is_what_the_amplifier_reported(
    display: Display,
    monkeypatch: pytest.MonkeyPatch,
    happens: Callable[[ModeledBus], None],
    ending: str,
    cause: str,
) -> None:
    buses, blocks = list[ModeledBus](), list[PlayedBlock]()

    def opened(*given: Any, **options: Any) -> ModeledBus:
        bus = open_bus(*given, **options)
        assert isinstance(bus, ModeledBus)
        buses.append(bus)
        return bus

    def watch(block: PlayedBlock, renderer: Renderer) -> None:
        blocks.append(block)
        if len(blocks) == 10:
            happens(buses[0])

    monkeypatch.setattr(runs, "open_bus", opened)
    oak, line = load_texture("wood-oak"), Trajectory.line(speed=0.08, duration=0.5)
    url = "mock:?link=serial&bit_rate=3000000"
    outcome = runs.run(display, oak, line, device=url, watch=watch).outcome
    assert (outcome.ending, outcome.playing) == (ending, False)
    assert cause in outcome.cause
    assert 0 < outcome.put_out_samples <= 11 * 64
    assert not outcome.is_within(Fraction("0.1"))


@pytest.mark.realtime
def test_an_amplifier_that_is_killed_within_a_stroke_put_out_no_more(
    display: Display, virtual_amplifier: Path, tmp_path: Path
) -> None:
    """The amplifier in C is killed at the tenth block of a second, and put out no more."""
    oak, line = load_texture("wood-oak"), Trajectory.line(speed=0.08, duration=1.0)
    out = tmp_path / "out"
    command: list[str | Path] = [virtual_amplifier, "--pty", "--channels", "24", "--out", out]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as amplifier:
        assert amplifier.stdout is not None
        url = f"serial://{amplifier.stdout.readline().strip()}"
        blocks: list[PlayedBlock] = []

        def watch(block: PlayedBlock, renderer: Renderer) -> None:
            blocks.append(block)
            if len(blocks) == 10:
                amplifier.kill()

        outcome = runs.run(display, oak, line, device=url, watch=watch).outcome
    assert sum(len(block.time) for block in blocks) == 8000
    assert outcome.put_out_samples <= 11 * 64
    assert (outcome.link, outcome.ending) == ("down", "complete")
    assert outcome.cause
    assert not outcome.is_within(99)
