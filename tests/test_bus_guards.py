"""Settings of guards come to amplifiers over links, and what guards report comes back.

A capacitor is the load: its current is C dv/dt, so that a guard which expects that of one step in
two samples never trips, and one that expects no current trips at once. Both channels play the same,
so that what one of them has become shows its gain.
"""

from typing import cast

import numpy as np
import pytest
from link_rig import Panel, overheard

from firmware_protocol import guard
from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.messages import FULL_SCALE_CODE, Feature, Window
from firmware_protocol.packet import SMALLEST, Packet, encode_packet
from tactile.arrays import Floats, Ints
from tactile.bus import correlations
from tactile.bus.amplifier_guards import AmplifierGuards
from tactile.bus.base import Bus, DriveBlock
from tactile.bus.correlations import CorrelationCounters
from tactile.bus.guards import GuardReport, GuardSettings
from tactile.bus.simulated.mock_bus import MockBus
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.devices import open_bus
from tactile.display.display import load_display
from tactile.errors import InputError

LOAD = 12.8e-9
"""Load of a channel [F]."""
AMPERE, VOLT = 2.5e-3 / FULL_SCALE_CODE, 100.0 / FULL_SCALE_CODE
"""Units of current codes [A] and sample codes [V]."""
PEAK = 2.9
"""Amplitude of the drive, whose steps stay below the slew limit of 6.25 V at 8 kHz [V]."""
LINKS = {
    "none": "mock:?keep=all&load_pf=12800&correlation_ms=25",
    "serial": "mock:?link=serial&bit_rate=3000000&keep=all&load_pf=12800&correlation_ms=25",
    "can": "mock:?link=can&keep=all&load_pf=12800&correlation_ms=100",
    "canfd": "mock:?link=canfd&keep=all&load_pf=12800&correlation_ms=25",
    "i2c": "mock:?link=i2c&bit_rate=1000000&keep=all&load_pf=12800&correlation_ms=50",
}
BEGINS = {"none": -500, "serial": 10**10, "can": 0, "canfd": 2**32 - 100, "i2c": 7}
"""Position of the start on each link."""
BOARDS = "mock:?link=canfd&data_bit_rate=8000000&boards=2&load_pf=12800&correlation_ms=50"
EVERY = pytest.mark.parametrize("link", LINKS)


def settings_of(
    channels: list[int],
    *,
    drive: Floats | None = None,
    armed: bool = True,
    release: bool = False,
    seed: int = 0,
) -> GuardSettings:
    """Return settings that differ by channel and seed; they never trip unless ``drive`` says so."""
    random, k = np.random.default_rng(seed), len(channels)
    if drive is None:
        drive = random.uniform(-2e-5, 2e-5, (k, 13))
    return GuardSettings(
        channels=np.array(channels),
        armed=np.full(k, armed),
        release=np.full(k, release),
        poles=random.uniform(-1.9, 1.9, (k, 2)) if not armed else np.zeros((k, 2)),
        drive=drive,
        change=random.uniform(-1e-5, 1e-5, (k, 13)) if not armed else np.zeros((k, 13)),
        limit=random.uniform(1e-5, 3e-5, k),
        share=0.01,
        floor=random.uniform(1e-9, 1e-8, k),
    )


def entries_of(settings: GuardSettings) -> guard.Entries:
    """Return entries in codes of 2.5 mA / 32767 and 100 V / 32767."""
    flags = settings.armed * 1 + settings.release * 2
    return guard.encode(
        flags, poles=settings.poles, drive=settings.drive / AMPERE * VOLT,
        change=settings.change / AMPERE * VOLT, limit=settings.limit / AMPERE,
        share=np.full(len(flags), settings.share), floor=settings.floor / AMPERE / AMPERE,
    )  # fmt: skip


def amplifiers(bus: Bus) -> list[ReferenceAmplifier]:
    """Return the amplifiers of a bus in memory."""
    if isinstance(bus, MockBus):
        return [board.amplifier for board in bus.boards]
    return list(cast(ModeledBus, bus).model.amplifiers)


def in_force(bus: Bus, board: int = 0) -> guard.Entries:
    """Return the entries that are in force in an amplifier."""
    return amplifiers(bus)[board]._player.guard._entries


class Played:
    """A drive that goes on on a bus.

    Attributes
    ----------
    position : position that is written next
    flagged : channels and last positions of windows whose guards held a channel down
    reports : reports so far
    """

    def __init__(self, bus: Bus, begin: int = 0, *, alike: bool = True) -> None:
        self.bus, self.position = bus, begin
        self._random, self._alike = np.random.default_rng(1), alike
        self.flagged: list[int] = []
        self.reports: list[GuardReport] = []
        bus.start(begin)

    def play(self, seconds: float) -> "Played":
        """Write for a while, and take windows and reports, in this order."""
        width, count = self.bus.wiring.channels, round(seconds * self.bus.wiring.sample_rate)
        end = self.position + count
        while self.position < end:
            size = min(40, end - self.position)
            columns = 1 if self._alike else width
            volts = self._random.uniform(-PEAK, PEAK, (size, columns))
            self.bus.write(DriveBlock(self.position, np.repeat(volts, width // columns, axis=1)))
            self.position += size
            windows = self.bus.take_correlations()
            self.reports += self.bus.take_guard_reports()
            held = [w.position for w in windows if (w.flags & Window.GUARDED).any()]
            self.flagged += held
            assert self.reports or not held, "a window came before the report that it follows"
        return self


def capacitors(bus: Bus, *, wrong: list[int] = [], **more: bool) -> GuardSettings:  # noqa: B006
    """Return settings that expect the current of `LOAD`, and of wrong channels none."""
    channels = bus.wiring.channels
    drive = np.zeros((channels, 13))
    drive[:, 2] = LOAD * bus.wiring.sample_rate  # i[m − 2] follows the step of c[m − 2]
    drive[wrong] = 0
    return settings_of(list(range(channels)), drive=drive, **more)


def law(reports: list[GuardReport], begin: int, rate: int, count: int) -> Ints:
    """Return the gains of channel 1 at positions from the start on (17.4)."""
    fall, rise = -(-31744 // max(1, rate // 1000)), -(-31744 // max(1, rate // 20))
    changes = {report.position - begin: bool(report.tripped[1]) for report in reports}
    gain, down, gains = 32768, False, []
    for n in range(count):
        down = changes.get(n, down)
        gain = max(gain - fall, 1024) if down else min(gain + rise, 32768)
        gains.append(gain)
    return np.array(gains)


# What is sent


@EVERY
def test_settings_reach_the_guards_in_their_codes(link: str) -> None:
    first = settings_of([0, 1], armed=False, release=True, seed=5)
    second = settings_of([1], armed=False, seed=6)
    with open_bus(LINKS[link], Panel(channels=2)) as bus:
        assert bus.guards
        drive = Played(bus, BEGINS[link]).play(0.25)
        bus.set_guards(first)
        drive.play(0.1)
        assert np.array_equal(in_force(bus), entries_of(first))
        bus.set_guards(second)
        drive.play(0.1)
        assert np.array_equal(in_force(bus)[:1], entries_of(first)[:1])
        assert np.array_equal(in_force(bus)[1:], entries_of(second))
        assert drive.reports == []
        bus.stop()


def test_each_board_gets_the_settings_of_its_channels() -> None:
    """Thirty channels on two boards, of which 16 neighbors are set."""
    channels = list(range(7, 23))
    settings = settings_of(channels, armed=False, seed=3)
    with open_bus(BOARDS, Panel(channels=30), sample_rate=4000) as bus:
        drive = Played(bus).play(0.2)
        bus.set_guards(settings)
        drive.play(0.1)
        wanted = np.zeros(30, guard.ENTRY)
        wanted[channels] = entries_of(settings)
        assert np.array_equal(np.concatenate([in_force(bus, 0), in_force(bus, 1)]), wanted)


def test_an_amplifier_without_guards_is_sent_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = vars(ReferenceAmplifier)["_features"]

    def without(self: ReferenceAmplifier) -> int:
        features: int = usual.fget(self)
        return features & ~(Feature.GUARDS if self.node == 2 else 0)

    monkeypatch.setattr(ReferenceAmplifier, "_features", property(without))
    heard = overheard(monkeypatch)
    with open_bus(BOARDS, Panel(channels=30), sample_rate=4000) as bus:
        assert bus.guards
        drive = Played(bus).play(0.2)
        bus.set_guards(settings_of(list(range(30)), armed=False))
        drive.play(0.1)
    assert {packet.node for packet, _ in heard if packet.type == m.Guard.TYPE} == {1}


@pytest.mark.parametrize("url", ["mock:", "mock:?load_pf=100", "mock:?link=serial&load_pf=100",
                                 "mock:?link=can&correlation_ms=50"])  # fmt: skip
def test_buses_that_do_not_correlate_have_no_guards(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = overheard(monkeypatch)
    with open_bus(url, Panel(channels=2)) as bus:
        assert not bus.guards
        bus.start()
        bus.set_guards(settings_of([0, 1]))
        bus.write(DriveBlock(0, np.zeros((800, 2))))
        assert bus.take_guard_reports() == []
    assert m.Guard.TYPE not in {packet.type for packet, _ in heard}


def test_a_driver_is_told_only_while_the_bus_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[GuardSettings] = []
    settings = settings_of([0, 1])
    with open_bus(LINKS["none"], Panel(channels=2)) as bus:
        monkeypatch.setattr(bus, "_set_guards", told.append)
        bus.set_guards(settings)
        assert told == []
        bus.start()
        bus.set_guards(settings)
        assert told == [settings]
        bus.estop()
        bus.set_guards(settings)
    bus.set_guards(settings)
    assert told == [settings]


@EVERY
def test_nothing_is_sent_before_a_window_or_while_idle(
    link: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = overheard(monkeypatch)
    with open_bus(LINKS[link], Panel(channels=2)) as bus:
        bus.set_guards(settings_of([0, 1]))
        for begin in (0, 10**6):
            drive = Played(bus, begin)
            bus.set_guards(settings_of([0, 1]))
            drive.play(0.25)
            bus.stop()
            bus.set_guards(settings_of([0, 1]))
        assert bus.correlation_counters.windows > 0
    assert m.Guard.TYPE not in {packet.type for packet, _ in heard}


# What comes back


@EVERY
def test_a_report_has_the_position_from_which_the_output_changes(link: str) -> None:
    begin = BEGINS[link]
    with open_bus(LINKS[link], Panel(channels=2)) as bus:
        drive = Played(bus, begin).play(0.25)
        bus.set_guards(capacitors(bus))
        drive.play(0.1)
        assert drive.reports == []
        bus.set_guards(capacitors(bus, wrong=[1]))
        drive.play(0.2)
        bus.set_guards(capacitors(bus, release=True))
        drive.play(0.2)
        rate, count = round(bus.wiring.sample_rate), drive.position - begin
        bus.stop()
        output = np.rint(cast(ModeledBus, bus).output[:count] / VOLT).astype(np.int64)
    assert [report.tripped.tolist() for report in drive.reports] == [[False, True], [False, False]]
    assert [report.first_channel for report in drive.reports] == [0, 0]
    gains = law(drive.reports, begin, rate, count)
    assert np.sum(gains == 1024) > 0.1 * rate
    assert gains[-1] == 32768
    assert np.abs(output[:, 1] - output[:, 0] * gains / 32768).max() <= 1  # cut to whole codes
    held = [n for n in range(count) if gains[n] < 32768]
    assert begin + held[0] - 0.1 * rate <= min(drive.flagged)
    assert max(drive.flagged) <= begin + held[-1]
    counters = bus.correlation_counters
    assert (counters.reports, counters.dropped_reports, counters.faults) == (2, 0, 0)


def test_a_simulated_display_has_guards_too() -> None:
    """Currents are known 16 samples late, and positions are those of what was put out."""
    display = load_display("reference-24")
    with open_bus("sim:?correlation_ms=25&keep=all", display) as bus:
        assert bus.guards
        drive = Played(bus).play(0.05)
        bus.set_guards(settings_of([1], drive=np.zeros((1, 13))))
        drive.play(0.05)
        bus.set_guards(settings_of([1], armed=False, release=True))
        drive.play(0.1)
        count, unit = drive.position, display.limits.voltage / FULL_SCALE_CODE
        output = np.rint(cast(MockBus, bus).output[:count] / unit).astype(np.int64)
    assert [np.flatnonzero(r.tripped).tolist() for r in drive.reports] == [[1], []]
    gains = law(drive.reports, 0, 8000, count)
    assert 1024 in gains
    assert np.abs(output[:, 1] - output[:, 0] * gains / 32768).max() <= 1
    assert np.array_equal(output[:, 2], output[:, 0])


def test_reports_tell_which_channels_of_the_display_they_are_of() -> None:
    with open_bus(BOARDS, Panel(channels=30), sample_rate=4000) as bus:
        drive = Played(bus).play(0.2)
        bus.set_guards(capacitors(bus, wrong=[4, 20]))
        drive.play(0.2)
    tripped = {r.first_channel: np.flatnonzero(r.tripped).tolist() for r in drive.reports}
    assert tripped == {0: [4], 15: [5]}
    assert all(len(report.tripped) == 15 for report in drive.reports)


@pytest.mark.parametrize("link", ["none", "serial", "can"])
def test_wrong_reports_are_counted(link: str) -> None:
    with open_bus(LINKS[link], Panel(channels=2)) as bus:
        drive = Played(bus).play(0.2)
        (amplifier,) = amplifiers(bus)
        amplifier._send(m.Guarded(amplifier.position, b"\1"))
        amplifier._send(m.Guarded(amplifier.position, b"\1\0\0"))
        amplifier._send(m.Guarded((amplifier.position + 10**6) % 2**32, b"\1\0"))
        drive.play(0.1)
        assert bus.correlation_counters.faults == 3
        amplifier._send(m.Guarded((amplifier.position - 10**6) % 2**32, b"\1\0"))  # before START
        amplifier._send(m.Guarded(amplifier.position, b"\1\0"))
        drive.play(0.1)
    assert [report.tripped.tolist() for report in drive.reports] == [[True, False]]
    assert bus.correlation_counters.faults == 3


def test_a_report_that_is_cut_off_is_counted() -> None:
    with open_bus(LINKS["serial"], Panel(channels=2)) as bus:
        drive = Played(bus).play(0.1)
        (amplifier,) = amplifiers(bus)
        amplifier._sent.append(Packet(m.Guarded.TYPE, b"\0\0\0", node=amplifier.node))
        drive.play(0.1)
    assert drive.reports == []
    assert bus.correlation_counters.faults == 1


def test_only_the_newest_reports_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(correlations, "MOST_WINDOWS", 4)
    with open_bus(LINKS["none"], Panel(channels=2)) as bus:
        bus.start()
        (amplifier,) = amplifiers(bus)
        for k in range(6):
            amplifier._send(m.Guarded((amplifier.position + k) % 2**32, b"\1\0"))
        bus.write(DriveBlock(0, np.zeros((8, 2))))
        assert [report.position for report in bus.take_guard_reports()] == [2, 3, 4, 5]
        assert bus.take_guard_reports() == []
    counters = bus.correlation_counters
    assert (counters.reports, counters.dropped_reports, counters.faults) == (6, 2, 0)


# In between


class Sent:
    """Packets that the host gives to its wire.

    Attributes
    ----------
    packets : packets in order
    hasty : GUARDs that were sent while samples waited which could have been sent
    """

    def __init__(self, bus: Bus, monkeypatch: pytest.MonkeyPatch) -> None:
        self.packets: list[Packet] = []
        self.hasty: list[Packet] = []
        link = cast(ModeledBus, bus)
        wire = link._wire
        assert wire is not None
        send, urgent, self.link = wire.send, wire.send_urgent, wire.link

        def sending(packet: Packet) -> float:
            self.packets.append(packet)
            stream = link._session.stream
            if packet.type == m.Guard.TYPE and stream is not None and stream._parts:
                self.hasty += [] if stream._blocked else [packet]
            return send(packet)

        def overtaking(packet: Packet) -> None:
            self.packets.append(packet)
            urgent(packet)

        monkeypatch.setattr(wire, "send", sending)
        monkeypatch.setattr(wire, "send_urgent", overtaking)

    def guards(self) -> list[m.Guard]:
        """Return the GUARDs so far."""
        found = [m.Guard.unpack(p.payload) for p in self.packets if p.type == m.Guard.TYPE]
        return [message for message in found if message is not None]


FULL_LINKS = {
    "serial": "mock:?link=serial&bit_rate=1000000&format=pcm16&load_pf=12800&correlation_ms=50",
    "can": "mock:?link=can&format=pcm12&load_pf=12800&correlation_ms=100",
    "canfd": "mock:?link=canfd&format=pcm16&load_pf=12800&correlation_ms=50",
    "i2c": "mock:?link=i2c&bit_rate=1000000&format=pcm16&load_pf=12800&correlation_ms=100",
}


def full(link: str) -> Bus:
    """Return a link with as many channels as it carries."""
    best: Bus | None = None
    for channels in range(2, 40):
        try:
            bus = open_bus(FULL_LINKS[link], Panel(channels=channels), sample_rate=5000)
        except InputError:
            break
        if best is not None:
            best.close()
        best = bus
    assert best is not None
    return best


@pytest.mark.parametrize(
    "link", ["serial", *(pytest.param(k, marks=pytest.mark.ci) for k in ("can", "canfd", "i2c"))]
)
def test_settings_are_sent_only_when_the_drive_has_nothing_due(
    link: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Settings take what a full link has left, and the same channels are not always left out."""
    with full(link) as bus:
        channels = bus.wiring.channels
        drive = Played(bus, alike=False).play(0.2)
        sent = Sent(bus, monkeypatch)
        for k in range(30):
            bus.set_guards(settings_of(list(range(channels)), armed=False, seed=k))
            drive.play(0.025)
        guards, counters = sent.guards(), bus.counters
        drive_packets = sum(packet.type == m.Pcm.TYPE for packet in sent.packets)
    assert sent.hasty == []
    assert {g.first_channel + k for g in guards for k in range(g.channels)} == set(range(channels))
    assert drive_packets > 50
    assert counters.faults() == {}
    for message in guards:
        seconds = sent.link.seconds(encode_packet(Packet.of(message)))
        assert message.channels == 1 or (message.channels <= 4 and seconds <= 1e-3)


def test_a_fast_link_takes_four_channels_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_bus(LINKS["serial"], Panel(channels=10)) as bus:
        drive = Played(bus).play(0.1)
        sent = Sent(bus, monkeypatch)
        bus.set_guards(settings_of(list(range(10))))
        drive.play(0.02)
    assert [(g.first_channel, g.channels) for g in sent.guards()] == [(0, 4), (4, 4), (8, 2)]


def test_boards_take_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_bus(BOARDS, Panel(channels=30), sample_rate=4000) as bus:
        drive = Played(bus).play(0.2)
        sent = Sent(bus, monkeypatch)
        bus.set_guards(settings_of(list(range(30)), armed=False))
        drive.play(0.1)
    nodes = [packet.node for packet in sent.packets if packet.type == m.Guard.TYPE]
    assert len(nodes) >= 8
    assert nodes == [1, 2] * (len(nodes) // 2)


def test_a_link_wakes_for_settings_that_wait() -> None:
    """Nothing is written, and nothing else is due, while the rest of the settings is sent."""
    with slow_link() as bus:
        Played(bus).play(0.2)
        session, clock = cast(ModeledBus, bus)._session, cast(ModeledBus, bus).model.clock
        bus.set_guards(settings_of(list(range(4))))
        assert waiting(bus)
        while waiting(bus):
            assert session.deadline <= session._wire_free
            cast(ModeledBus, bus)._turn(clock.now() + 1.0)


def test_lost_settings_and_reports_break_nothing() -> None:
    """What is in force has come whole, and the last report that came says what is so."""
    with open_bus(LINKS["serial"] + "&loss=0.05&seed=3", Panel(channels=2)) as bus:
        drive = Played(bus).play(0.1)
        possible = set()
        for k in range(30):
            settings = capacitors(bus, wrong=[1] if k % 20 < 10 else [], release=k % 20 >= 12)
            possible |= {entry.tobytes() for entry in entries_of(settings)}
            bus.set_guards(settings)
            drive.play(0.025)
            assert {entry.tobytes() for entry in in_force(bus)} <= possible
        assert bus.state == "running"
    tripped = [report.tripped.tolist() for report in drive.reports]
    assert len(tripped) > 1
    assert all(not first for first, _ in tripped)
    positions = [report.position for report in drive.reports]
    assert positions == sorted(positions)
    assert bus.correlation_counters.faults == 0
    assert bus.correlation_counters.gaps > 0, "something was lost"


# The end of playing


def waiting(bus: Bus) -> bool:
    """Return whether settings wait to be sent."""
    return cast(ModeledBus, bus)._session._guards_wait


def slow_link(channels: int = 4) -> Bus:
    return open_bus(FULL_LINKS["serial"], Panel(channels=channels), sample_rate=5000)


def test_an_estop_goes_before_settings_and_nothing_after_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with slow_link() as bus:
        drive = Played(bus).play(0.2)
        sent = Sent(bus, monkeypatch)
        bus.set_guards(settings_of(list(range(4))))
        assert waiting(bus)
        before = len(sent.packets)
        bus.estop()
        assert sent.packets[before].type == m.Estop.TYPE
        bus.set_guards(settings_of(list(range(4))))
        drive.play(0.1)
        bus.clear()
        Played(bus).play(0.2)
        bus.stop()
    assert m.Guard.TYPE not in {packet.type for packet in sent.packets[before:]}
    assert drive.reports == []


def test_an_estop_in_the_midst_of_settings_ends_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal handler may e-stop while the thread that it interrupts sends."""
    with open_bus(LINKS["serial"], Panel(channels=20)) as bus:
        drive = Played(bus).play(0.1)
        sent = Sent(bus, monkeypatch)
        wire = cast(ModeledBus, bus)._wire
        assert wire is not None
        usual = wire.send

        def send(packet: Packet) -> float:
            seconds = usual(packet)
            if packet.type == m.Guard.TYPE:
                bus.estop()
            return seconds

        monkeypatch.setattr(wire, "send", send)
        bus.set_guards(settings_of(list(range(20))))
        drive.play(0.1)
    assert len(sent.guards()) == 1
    assert bus.estops == 1


@pytest.mark.parametrize("end", ["stop", "abort", "unplug"])
def test_what_waits_is_forgotten_when_playing_ends(
    end: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard = overheard(monkeypatch)
    with slow_link() as bus:
        drive = Played(bus).play(0.2)
        session = cast(ModeledBus, bus)._session
        monkeypatch.setattr(session, "_send_guards", lambda now, wire: None)
        bus.set_guards(settings_of(list(range(4))))
        assert waiting(bus)
        if end == "unplug":
            cast(ModeledBus, bus).model.unplug(0.02)
            drive.play(0.01)
            assert bus.status.link == "down"
            bus.set_guards(settings_of(list(range(4))))
            assert not waiting(bus)
            drive.play(0.14)
            assert bus.counters.disconnects == 1
            assert bus.status.playing
        else:
            getattr(bus, end)()
        assert not waiting(bus)
        monkeypatch.undo()
    assert m.Guard.TYPE not in {packet.type for packet, _ in heard}


# What waits of one amplifier

CAPS = m.Caps(channels=6, full_scale_uv=100_000_000, fifo_samples=512, packet_limit=4096)


def taken(guards: AmplifierGuards, most: int = 12) -> list[tuple[int, list[int]]]:
    """Return first channels and flags of all messages."""
    found = []
    while message := guards.take(9, most):
        entries = guard.decode(message)
        assert entries is not None
        assert message.session == 9
        assert not guards.waits or len(entries) <= most
        found.append((message.first_channel, entries["flags"].tolist()))
    return found


def fresh(caps: m.Caps = CAPS) -> AmplifierGuards:
    return AmplifierGuards(CorrelationCounters(), caps, 10, 100)


def test_a_release_waits_until_it_is_sent() -> None:
    guards = fresh()
    guards.set(settings_of([10, 11], armed=False, release=True), 2500)
    guards.set(settings_of([11, 12]), 2500)
    assert taken(guards) == [(0, [2, 3, 1])]
    guards.set(settings_of([10, 11, 12]), 2500)
    assert taken(guards) == [(0, [1, 1, 1])]


def test_a_release_does_not_undo_a_trip_that_is_newer() -> None:
    """Channel 1 has tripped before the release, of which a report of channel 2 tells as well."""
    guards = fresh()
    assert guards.decode(m.Guarded(0, b"\0\1\0\0\0\0"), 200, 200) is not None
    guards.set(settings_of([10, 11, 12], release=True), 2500)
    assert guards.decode(m.Guarded(0, b"\0\1\2\0\0\0"), 210, 210) is not None
    assert taken(guards) == [(0, [3, 3, 1])]


def test_what_was_forgotten_takes_its_release_along() -> None:
    guards = fresh()
    guards.set(settings_of([10], release=True), 2500)
    guards.forget()
    assert not guards.waits
    guards.set(settings_of([10]), 2500)
    assert taken(guards) == [(0, [1])]


def test_channels_take_turns_and_later_settings_do_not_push_in() -> None:
    guards = fresh()
    every = list(range(10, 16))
    guards.set(settings_of(every, seed=1), 2500)
    first = guards.take(9, 2)
    assert first is not None
    latest = settings_of(every, seed=2)
    guards.set(latest, 2500)
    sent = [guards.take(9, 2) for _ in range(3)]
    assert guards.take(9, 2) is None
    assert [message.first_channel for message in sent if message] == [2, 4, 0]
    entries = b"".join(message.entries for message in sent if message)
    assert entries == np.roll(entries_of(latest), -2).tobytes()


def test_settings_of_others_and_such_as_are_not_numbers_are_left_out() -> None:
    guards = fresh()
    settings = settings_of([0, 9, 10, 12, 13, 15, 16, 200])
    settings.poles[3, 1], settings.limit[4] = np.nan, np.inf
    guards.set(settings, 2500)
    assert taken(guards) == [(0, [1]), (5, [1])]
    guards.set(settings, 0)
    assert not guards.waits


def test_a_small_packet_has_one_channel() -> None:
    """A packet of 136 bytes, the least that an amplifier takes, has 124 for entries of 68."""
    guards = fresh(m.Caps(channels=6, full_scale_uv=100_000_000, packet_limit=136))
    guards.set(settings_of([10, 11]), 2500)
    assert taken(guards) == [(0, [1]), (1, [1])]
    assert SMALLEST + m.Guard.HEAD.size + 2 * 68 > 136


@pytest.mark.parametrize(
    ("reasons", "position", "good", "faults"),
    [
        (b"\0\1\2\0\0\7", 100, True, 0),
        (b"\0\0\0\0\0\0", 1512, True, 0),
        (b"\0\0\0\0\0\0", 1513, False, 1),
        (b"\0\0\0\0\0\0", 99, False, 0),
        (b"\0\0\0\0\0", 500, False, 1),
        (b"\0\0\0\0\0\0\0", 500, False, 1),
        (b"", 500, False, 1),
    ],
)
def test_reports_are_checked(reasons: bytes, position: int, good: bool, faults: int) -> None:
    """Playing began at 100 and has come to 1000; the amplifier's buffer holds 512."""
    counters = CorrelationCounters()
    report = AmplifierGuards(counters, CAPS, 10, 100).decode(m.Guarded(0, reasons), position, 1000)
    assert (report is not None, counters.faults) == (good, faults)
    if report is not None:
        assert (report.position, report.first_channel) == (position, 10)
        assert report.tripped.tolist() == [reason > 0 for reason in reasons]
