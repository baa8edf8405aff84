"""Tests of the outcome of a stroke, against the counts of the amplifier itself."""

import numpy as np
import pytest
from link_rig import Linked

from tactile.bus.base import BusStatus, DriveBlock, Wiring
from tactile.bus.simulated.mock_bus import MockBus
from tactile.playback.outcome import TOLERATED, Outcome, outcome_of

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
    assert outcome.is_within(TOLERATED) is is_within
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
    reported = max(amplifier.counters.lost_samples for amplifier in rig.model.amplifiers)
    assert (reported > 0) is (alone > 0)
    assert rig.bus.unplayed == max(
        reported, rig.bus.counters.lost_samples + rig.bus.counters.dropped_samples
    )
