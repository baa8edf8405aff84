"""Amplifiers whose credit is wrong, and reports of which the host must not take for its own stroke.

In virtual time. What is blocked by credit is dropped when its time has passed, counted once, and
named.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
import pytest
from cli_rig import SHORT, Command
from link_rig import LINKS, MOST, RATE, Bench, Linked, Panel, overheard

from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.messages import State
from tactile.bus.base import DriveFrame
from tactile.bus.link.link_bus import LinkBus
from tactile.devices import open_bus
from tactile.playback.outcome import outcome_of

EVERY = pytest.mark.parametrize("link", MOST)
FIFO = 1025
"""Length of the buffer of amplifiers in memory [samples]."""
WRONG = (2**31 - 16, -100_000)
"""Offsets of the credit of two firmwares that did not play a sample, without a word of the host."""

Distort = Callable[..., None]


@pytest.fixture
def distort(monkeypatch: pytest.MonkeyPatch) -> Distort:
    """Return what adds to the credit of amplifiers from now on."""
    usual = ReferenceAmplifier._send

    def begin(offset: int, nodes: Sequence[int] = (1,)) -> None:
        def send(
            amplifier: ReferenceAmplifier, message: m.Message, node: int | None = None
        ) -> None:
            if isinstance(message, m.Pulse) and amplifier.node in nodes:
                at = (message.credit_position + offset) % 2**32
                message = m.Pulse(
                    at, message.state, message.phase, message.underruns, message.fill_ms
                )
            usual(amplifier, message, node)

        monkeypatch.setattr(ReferenceAmplifier, "_send", send)

    return begin


def played(bench: Bench) -> int:
    """Return how many samples of the first channel were not 0 V."""
    bench.model.report_output()
    return sum(int(np.count_nonzero(codes[:, 0])) for h in bench.heard[0] for codes in h.codes)


# Credit that is wrong


@EVERY
@pytest.mark.parametrize("offset", [*WRONG, -FIFO, -5000])
def test_a_stroke_for_which_no_credit_comes_is_lost_and_says_so(
    linked: Linked, distort: Distort, monkeypatch: pytest.MonkeyPatch, link: str, offset: int
) -> None:
    """A credit without fifo_samples (−1025) is the nearest mistake; it is no impossible one."""
    heard = overheard(monkeypatch)
    distort(offset)
    rig = linked(link, "")
    rig.begin(1.0)
    at_end = rig.bus.status
    rig.bus.stop()
    outcome = outcome_of(rig.position, rig.bus, at_end)
    assert m.Pcm.TYPE not in {packet.type for packet, _ in heard}
    assert played(rig) == 0
    assert rig.bus.counters.dropped_samples == rig.bus.unplayed == rig.position
    assert outcome.percent == "0.00 %"
    assert not outcome.is_within(Fraction(1, 10))
    assert outcome.cause == at_end.last_fault
    assert outcome.cause.startswith("node 1 gives no credit: it says position ")
    assert "\n" not in outcome.cause
    assert at_end.detail == outcome.cause
    assert rig.bus.status.detail == ""
    assert (rig.bus.counters.credit_faults > 10) is (offset != -FIFO)
    assert rig.bus.counters.underruns == 0


def test_the_line_has_the_positions_of_credit_stream_and_buffer(
    linked: Linked, distort: Distort
) -> None:
    distort(-5000)
    rig = linked("serial", "")
    rig.begin(0.5)
    words = rig.bus.status.last_fault.replace(",", "").split()
    credit, stream, buffer = (int(word) for word in words if word.isdigit() and len(word) > 1)
    assert abs(buffer - 5000 - credit) <= 0.012 * RATE + 2  # a PULSE is 10 ms old at most
    assert buffer - FIFO - 10 <= stream <= buffer - FIFO + 0.01 * RATE


def test_what_waits_is_bounded_while_no_credit_comes(linked: Linked, distort: Distort) -> None:
    rig = linked("serial", "&lead_ms=100")
    distort(-100_000)
    rig.begin(2.0)
    stream = rig.bus._session.stream
    assert stream is not None
    waiting = sum(part.end - part.start for part in stream._parts)
    assert waiting <= 0.1 * RATE + 2 * rig.bus.plan.packet_samples


def test_credit_that_comes_back_is_used_and_the_fault_stays_named(
    linked: Linked, distort: Distort
) -> None:
    rig = linked("serial", "")
    rig.begin(0.3)
    assert rig.bus.counters.faults() == {}
    distort(-100_000)
    rig.play(0.3)
    counted = rig.bus.counters.dropped_samples
    assert 0.1 * RATE < counted < 0.3 * RATE
    distort(0)
    rig.play(0.5)
    at_end = rig.bus.status
    rig.bus.stop()
    assert rig.bus.counters.dropped_samples <= counted + 0.02 * RATE
    assert rig.bus.unplayed >= rig.bus.counters.dropped_samples
    assert rig.bus.unplayed < rig.position - 0.5 * RATE
    assert at_end.detail == ""
    assert at_end.last_fault.startswith("node 1 gives no credit: ")
    assert rig.misplaced()[1] > 0.4 * RATE


def test_a_credit_too_far_ahead_is_counted_and_plays(linked: Linked, distort: Distort) -> None:
    """The lead bounds what is sent, and STATUS tells the positions that PULSE does not."""
    distort(100_000)
    rig = linked("serial", "")
    rig.begin(1.0)
    assert rig.bus.status.last_fault == ""
    assert rig.bus.counters.credit_faults > 50
    rig.bus.stop()
    assert rig.bus.counters.faults().keys() == {"credit_faults"}
    assert rig.bus.unplayed == 0
    assert "future_samples" not in rig.faults()
    assert rig.misplaced()[1] > 0.9 * RATE


def test_of_several_amplifiers_the_one_without_credit_is_named(distort: Distort) -> None:
    distort(-100_000, nodes=(3,))
    rig = Bench(LINKS["canfd"] + "&boards=3", Panel(channels=6), rate=8000.0)
    rig.begin(0.5)
    assert rig.bus.status.last_fault.startswith("node 3 gives no credit: ")
    rig.bus.close()


def test_frames_for_which_no_credit_comes_are_counted_each(distort: Distort) -> None:
    distort(-100_000)
    bus = open_bus("mock:?link=can&format=spectrum", Panel(), sample_rate=RATE)
    with bus:
        assert isinstance(bus, LinkBus)
        assert bus.frames is not None
        spacing = round(bus.wiring.sample_rate / bus.frames.rate)
        bus.tune(np.array([100.0]))
        bus.start()
        for k in range(1, 30):
            bus.write_frame(DriveFrame(k * spacing, np.full((2, 1), 50, np.complex128)))
        bus.stop()
        assert bus.unplayed == bus.counters.dropped_samples == 29
        assert bus.status.last_fault.startswith("node 1 gives no credit: ")


@pytest.mark.parametrize("offset", WRONG)
@pytest.mark.parametrize("link", ["serial", "can&bit_rate=1000000"])
def test_play_exits_with_1_and_names_the_credit(
    command: Command, distort: Distort, link: str, offset: int
) -> None:
    distort(offset)
    result = command("play", "wood-oak", *SHORT, "--device", f"mock:?link={link}")
    assert result.code == 1
    assert "node 1 gives no credit: it says position " in result.out + result.err
    assert " 0.00 %" in result.out


# Credit that is right


@EVERY
def test_no_credit_of_a_right_amplifier_is_a_fault(linked: Linked, link: str) -> None:
    """The clock drifts, and PULSEs are 100 ms late."""
    rig = linked(link, "&rearm=true&drift_ppm=100")
    rig.begin(1.0)
    rig.model.back.hold(0.1, rig.clock.now())
    rig.play(1.0)
    rig.bus.stop()
    rig.begin(0.5)
    assert rig.bus.counters.credit_faults == 0


def test_reports_that_waited_for_a_host_that_was_held_up_are_no_faults(
    linked: Linked, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The oldest has waited for 1 s; the link does not count as lost meanwhile."""
    monkeypatch.setattr("tactile.bus.link.session.SILENCE", 10.0)
    rig = linked("serial", "&rearm=true")
    rig.begin(0.3)
    rig.model.run_alone(rig.clock.now() + 1.0)
    rig.play(1.0)
    assert rig.bus.counters.credit_faults == 0


# Reports from before a START


@pytest.mark.parametrize("link", ["serial", "can"])
@pytest.mark.parametrize(
    "passed", [2**20 - 3000, 2**20 - 1500, 2**20, 2**20 + 2**24, 2**31 + 2**20, 2**32 - 1]
)
def test_reports_of_an_amplifier_that_was_on_for_long_before_a_stroke_are_not_of_that_stroke(
    linked: Linked, link: str, passed: int
) -> None:
    """The position rises from power-up on, 2²⁰ in 131 s at 8 kHz, and START sets it (SPEC.md, 7.1).

    A PULSE of the time before START comes while START is on its way.
    """
    for seed in range(3):
        rig = linked(link, f"&delay_ms=3&seed={seed}", rate=8000.0)
        player = rig.model.amplifiers[0]._player
        player.position = (player.position + passed) % 2**32
        rig.begin(0.5)
        at_end = rig.bus.status
        (peer,) = rig.bus.peers
        lost = rig.faults().get("lost_samples", 0)
        assert peer.state is State.RUNNING
        assert peer.ledger.running
        assert 0.4 * 8000 < peer.ledger.passed < 0.55 * 8000
        rig.bus.stop()
        outcome = outcome_of(rig.position, rig.bus, at_end)
        assert outcome.lost_samples == pytest.approx(lost, abs=0.02 * 8000)
        assert rig.bus.counters.credit_faults == 0
