"""Guards trip where section 17 of SPEC.md says, in Python and in C.

Streams are played on an amplifier with capacitors behind it, of which guards expect this or that.
What trips, and the gains, are compared with section 17 by its definition, instant by instant in
Python's own integers, and with what the amplifier in C does on the same trace.
"""

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
import pytest
from measuring_scene import CORRELATION_MS, MEASURES, NAK, OWNER, RATE, Scene
from protocol_traces import CONFIGS, LOADS_PF, Loads, play, replay

from firmware_protocol import guard
from firmware_protocol import messages as m
from firmware_protocol.amplifier import ReferenceAmplifier
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.messages import GuardReason, NakCode, State
from firmware_protocol.packet import Packet

GUARDED = 0x4A
ROOMY = replace(MEASURES, packet_limit=500)
"""An amplifier that takes the entries of all five channels in one packet."""
LEAST, FULL = 1024, 32768
ARMED, RELEASE = 1, 2
FLAGS = 0, ARMED, ARMED | RELEASE, ARMED | RELEASE, RELEASE
FALL, RISE = 15872, 318
"""Changes of a gain per instant at 2000 Hz: ⌈31744 / 2⌉ and ⌈31744 / 100⌉."""


class Entry(NamedTuple):
    """Entry of a channel, as section 17.2 lists it."""

    flags: int = ARMED
    drive_shift: int = 0
    change_shift: int = 0
    limit: int = 0
    share: int = 0
    floor: int = 0
    poles: tuple[int, ...] = (0, 0)
    drive: tuple[int, ...] = (0,) * 13
    change: tuple[int, ...] = (0,) * 13

    def packed(self) -> bytes:
        return struct.pack(
            "<BBBBHHI28h", self.flags, self.drive_shift, self.change_shift, 0, self.limit,
            self.share, self.floor, *self.poles, *self.drive, *self.change,
        )  # fmt: skip


def rounded(value: int, shift: int) -> int:
    """Return ⌊value / 2^shift + ½⌋."""
    return (2 * value + (1 << shift)) >> (shift + 1)


def clamped(value: int) -> int:
    return min(max(value, -32767), 32767)


class Arrival(NamedTuple):
    """Entry that an amplifier has received at a tick."""

    tick: int
    channel: int
    entry: Entry


class Channel:
    """Guard of a channel by the definition: entries, currents and codes in, decisions out."""

    def __init__(self) -> None:
        self.entry = Entry(flags=0)
        self.waiting: Entry | None = None
        self.reason, self.doubted = 0, False
        self.blocks: list[list[int]] = []
        self.block: list[tuple[int, int, int]] = []
        self.gain = FULL

    def begin(self) -> bool:
        """Begin a block; return whether the channel is released."""
        before, self.block = self.reason, []
        if self.waiting is not None:
            if not self.entry.flags & 1 or self.reason:
                self.blocks, self.doubted = [], False
            self.entry, self.waiting = self.waiting, None
            self.reason = 0 if self.entry.flags & 2 else self.reason
        return self.reason != before

    def judge(self) -> bool:
        """Judge a block that is over; return whether the channel trips."""
        if not self.entry.flags & 1 or self.reason:
            return False
        e = self.entry
        self.blocks.append([
            sum(r * r for r, *_ in self.block), sum(i * i for *_, i in self.block),
            sum(r * d for r, d, _ in self.block), sum(d * d for _, d, _ in self.block),
        ])  # fmt: skip
        whole = [sum(each) for each in zip(*self.blocks[-5:], strict=True)]
        loud = self.blocks[-1][0] > 8 * e.limit**2 + e.share * self.blocks[-1][1] // 2**16
        lost = len(self.blocks) >= 5 and 5 * whole[2] > 3 * whole[3] and whole[2] > e.floor
        self.reason = 1 if loud else 2 if lost and self.doubted else 0
        self.doubted = lost
        return self.reason != 0

    def move(self) -> None:
        """Move the gain on by an instant."""
        if self.reason:
            self.gain = max(self.gain - FALL, LEAST)
        else:
            self.gain = min(self.gain + RISE, FULL)


class Trip(NamedTuple):
    """What GUARDED is to tell, and the gains that follow."""

    position: int
    reasons: bytes


class Definition:
    """Section 17, instant by instant, of what a scene put out.

    Attributes
    ----------
    trips : what GUARDED is to tell
    gains : gains of the channels at each position in RUNNING, after the tick of START
    """

    def __init__(self, scene: Scene, arrivals: list[Arrival]) -> None:
        rows, config = np.concatenate(scene.rig.rows), scene.rig.config
        self._late, self._count = config.current_delay, config.channels
        self.trips: list[Trip] = []
        self.gains: dict[int, list[int]] = {}
        loads, rate = Loads(config), scene.rig.amplifier.rate
        arrivals = list(arrivals)
        self._restart()
        positions = rows["position"].tolist()
        for k, (row, position) in enumerate(zip(rows, positions, strict=True)):
            while arrivals and arrivals[0].tick < row["tick"]:
                arrival = arrivals.pop(0)
                self.channels[arrival.channel].waiting = arrival.entry
            currents = loads.measure(row["codes"][None].astype(np.int64), rate)[0].tolist()
            pending = k + 1 < len(positions) and positions[k + 1] == position
            if row["state"] != State.RUNNING:
                self._restart()
            if row["state"] != State.RUNNING or pending:
                continue
            for channel in self.channels:
                channel.move()
            self.gains[position] = [channel.gain for channel in self.channels]
            self._instant(position, row["codes"].tolist(), currents)

    def _restart(self) -> None:
        self.channels = [Channel() for _ in range(self._count)]
        self._codes: list[list[int]] = []
        self._currents: list[list[int]] = []

    def _instant(self, position: int, codes: list[int], currents: list[int]) -> None:
        self._codes.append(codes)
        if len(self._codes) <= self._late:
            return
        self._currents.append(currents)
        known = len(self._currents) - 1
        over = known % 8 == 7
        changed: list[bool] = []
        for c, channel in enumerate(self.channels):
            channel.block.append(self._products(c, channel.entry, known))
            if over:
                changed += [channel.judge(), channel.begin()]
        if any(changed):
            reasons = bytes(channel.reason for channel in self.channels)
            self.trips.append(Trip((position + 1) % 2**32, reasons))

    def _products(self, c: int, e: Entry, known: int) -> tuple[int, int, int]:
        """Return residual, change and current of the instant that is judged."""

        def code(n: int) -> int:
            return self._codes[n][c] if n >= 0 else 0

        def current(n: int) -> int:
            return self._currents[n][c] if n >= 0 else 0

        steps = [code(known - lag) - code(known - lag - 1) for lag in range(13)]
        expected = sum(s * a for s, a in zip(steps, e.drive, strict=True))
        change = sum(s * b for s, b in zip(steps, e.change, strict=True))
        now = 2**14 * current(known - 2)
        now += e.poles[0] * current(known - 3) + e.poles[1] * current(known - 4)
        residual = clamped(rounded(now, 14) - rounded(expected, e.drive_shift))
        return residual, clamped(rounded(change, e.change_shift)), current(known - 2)


class GuardedScene(Scene):
    """Scene with guards.

    Attributes
    ----------
    arrivals : entries that the amplifier has taken
    """

    def __init__(self, config: AmplifierConfig = ROOMY, seed: int = 0) -> None:
        super().__init__(config, seed)
        self.arrivals: list[Arrival] = []

    def guard(self, first: int, *entries: Entry) -> None:
        body = b"".join(entry.packed() for entry in entries)
        self.tell("GUARD", OWNER, first, len(entries), body=body)
        tick = self.rig.now
        self.arrivals += [Arrival(tick, first + k, e) for k, e in enumerate(entries)]

    def tripped(self) -> list[Trip]:
        """Return what the GUARDEDs tell."""
        bodies = [p[4:-4] for p in self.rig.sent if p[0] == GUARDED]
        return [Trip(int.from_bytes(body[:4], "little"), body[4:]) for body in bodies]


def capacitor(channel: int, config: AmplifierConfig, share: float = 1.0) -> tuple[int, ...]:
    """Return the filter, with shift 8, of the current of a channel's capacitor two instants ago."""
    load = LOADS_PF[min(channel, len(LOADS_PF) - 1)]
    farads = 0.0 if isinstance(load, str) else load * 1e-12
    volts = config.full_scale_uv * 1e-6 / 32767
    code = farads * volts * RATE / (config.sense_ranges_ua[0] * 1e-6) * 32767
    taps = [0] * 13
    taps[2] = min(round(256 * share * code), 32767)
    return tuple(taps)


def random_entry(rng: Random) -> Entry:
    """Return an entry of which nothing need make sense."""
    taps = [rng.randint(-32768, 32767) for _ in range(28)]
    return Entry(
        rng.choice(FLAGS), rng.randint(0, 31), rng.randint(0, 31),
        rng.choice((0, 3000, 20000, 65535)), rng.choice((0, 1000, 65535)),
        rng.choice((0, 10**6, 2**32 - 1)), tuple(taps[:2]), tuple(taps[2:15]), tuple(taps[15:]),
    )  # fmt: skip


def eventful(seed: int, late: int) -> GuardedScene:
    """Return a scene with guards that come, trip and are replaced at all times."""
    scene = GuardedScene(replace(ROOMY, current_delay=late), seed=seed)
    rng, channels = Random(seed), scene.rig.config.channels
    scene.set(CORRELATION_MS, 10)
    scene.start(2**32 - 57, delay_ms=7)
    for _ in range(30):
        first = rng.randrange(channels)
        count = rng.randint(1, channels - first)
        scene.guard(first, *(random_entry(rng) for _ in range(count)))
        scene.stream(rng.randint(1, 40), loud=rng.choice((300, 32767)), gaps=rng.choice((0, 0.2)))
    scene.tell("STOP", OWNER, 0)
    scene.wait(40)
    scene.start(1000, delay_ms=5)
    scene.stream(30)
    scene.rig.end()
    return scene


@pytest.mark.parametrize(("seed", "late"), [(0, 0), (1, 0), (2, 3), (3, 60)])
def test_guards_trip_as_defined_and_as_in_c(
    seed: int, late: int, virtual_amplifier: Path, tmp_path: Path
) -> None:
    """Random entries trip for both reasons, and not at all; both amplifiers agree bit for bit."""
    scene = eventful(seed, late)
    expected = Definition(scene, scene.arrivals)
    assert scene.tripped() == expected.trips
    assert {reason for trip in expected.trips for reason in trip.reasons} == {0, 1, 2}
    out, sent = replay(virtual_amplifier, scene.rig.config, scene.rig.records, tmp_path)
    assert scene.rig.out() == out
    assert scene.rig.sent == sent


def test_instants_one_by_one_trip_as_runs_do() -> None:
    """How many instants an amplifier puts out at a time makes no difference."""
    scene = eventful(4, 3)
    singly = play(scene.rig.config, scene.rig.records, singly=True)
    assert singly.out() == scene.rig.out()
    assert [p for p in singly.sent if p[0] == GUARDED] == [
        p for p in scene.rig.sent if p[0] == GUARDED
    ]


def steady(scene: GuardedScene, milliseconds: int, code: int = 9000) -> None:
    """Stream the codes ± ``code`` on all channels, in turn."""
    rig, channels = scene.rig, scene.rig.config.channels
    end = rig.now + milliseconds * rig.config.tick_hz // 1000
    while rig.now < end:
        scene.tell("HEARTBEAT", OWNER)
        while (scene.sent_to - rig.amplifier.position + 2**31) % 2**32 - 2**31 < 30:
            codes = [code * (1 - 2 * (n % 2)) for n in range(scene.sent_to, scene.sent_to + 5)]
            body = np.repeat(codes, channels).astype("<i2").tobytes()
            head = scene.sent_to, OWNER, 0, channels, 0, 5
            scene.tell("PCM", *head, body=body)
            scene.sent_to += 5
        rig.run(rig.now + 2 * rig.config.tick_hz // 1000)


def played(scene: GuardedScene) -> Iterator[tuple[int, list[int]]]:
    """Yield position and codes of the instants in RUNNING."""
    for row in np.concatenate(scene.rig.rows):
        if row["state"] == State.RUNNING:
            yield int(row["position"]), row["codes"].tolist()


QUICK = replace(ROOMY, slew_limit_v_per_s=100_000_000)
"""An amplifier whose slew limit a stream of ±30 V at 2 kHz does not reach."""


def test_a_contactor_that_is_as_expected_plays_on_and_one_that_is_not_is_turned_down() -> None:
    """The gain falls to 1/32 in 1 ms after the block, and RELEASE lets it rise in 50 ms."""
    scene = GuardedScene(QUICK)
    scene.set(CORRELATION_MS, 10)
    scene.start()
    as_expected = Entry(drive_shift=8, limit=20, drive=capacitor(0, QUICK))
    scene.guard(0, as_expected)
    steady(scene, 60)
    assert scene.tripped() == []
    scene.guard(0, as_expected._replace(drive=capacitor(0, QUICK, share=0.9)))
    steady(scene, 60)
    (trip,) = scene.tripped()
    assert trip.reasons[0] == GuardReason.RESIDUAL
    assert not any(trip.reasons[1:])
    scene.guard(0, as_expected)  # without RELEASE it undoes nothing
    steady(scene, 60)
    assert scene.tripped() == [trip]
    scene.guard(0, as_expected._replace(flags=ARMED | RELEASE))
    steady(scene, 80)
    assert [change.reasons[0] for change in scene.tripped()] == [1, 0]
    expected = Definition(scene, scene.arrivals)
    assert scene.tripped() == expected.trips
    for position, codes in played(scene):
        if position < 60:  # the drive fades in
            continue
        sign = 1 - 2 * (position % 2)
        gains = expected.gains[position]
        assert codes == [sign * (9000 * gain // FULL) for gain in gains]
    gains = [row[0] for row in expected.gains.values()]
    assert min(gains) == LEAST
    assert gains[-1] == FULL
    flags = [
        (w.position, np.frombuffer(w.entries, np.uint8)[0] & 2) for w in scene.sent()
    ]  # fmt: skip
    for position, flag in flags:
        held = any(expected.gains[n][0] < FULL for n in range(position, position + 20))
        assert bool(flag) == held


@pytest.mark.parametrize("event", ["STOP", "DISARM", "ESTOP"])
def test_a_channel_that_is_held_down_stays_so_until_it_is_silent(event: str) -> None:
    """No ramp to 0 V raises a gain, and the next START plays at full gain again."""
    scene = GuardedScene(QUICK)
    scene.start()
    scene.guard(0, Entry(limit=0))
    steady(scene, 60)
    assert scene.tripped()
    before = len(np.concatenate(scene.rig.rows))
    scene.tell(event, *((1,) if event == "ESTOP" else (OWNER, 0) if event == "STOP" else (OWNER,)))
    scene.wait(60)
    codes = np.abs(np.concatenate(scene.rig.rows)["codes"][before:, 0].astype(int))
    assert codes.max() <= 9000 // 32
    assert codes[-1] == 0
    if event == "ESTOP":
        return
    scene.start(0)
    steady(scene, 60)
    assert abs(list(played(scene))[-1][1][0]) == 9000


def refusals(scene: Scene) -> list[int]:
    """Return the codes of the NAKs that were sent."""
    return [p[4 + 2] for p in scene.rig.sent if p[0] == NAK]


@pytest.mark.parametrize(
    ("channels", "entries", "code"),
    [
        ((0, 0), [], NakCode.CHANNEL),
        ((4, 2), [Entry(), Entry()], NakCode.CHANNEL),
        ((0, 2), [Entry()], NakCode.LENGTH),
        ((0, 1), [Entry(), Entry()], NakCode.LENGTH),
        ((0, 1), [Entry(drive_shift=32)], NakCode.RANGE),
        ((0, 2), [Entry(), Entry(change_shift=255)], NakCode.RANGE),
    ],
)
def test_entries_that_cannot_be_are_refused(
    channels: tuple[int, int], entries: list[Entry], code: int
) -> None:
    """A refused GUARD arms nothing, although all of its entries would trip."""
    scene = GuardedScene()
    assert scene.rig.config.channels == 5
    scene.start()
    body = b"".join(entry.packed() for entry in entries)
    scene.tell("GUARD", OWNER, *channels, body=body)
    assert refusals(scene) == [code]
    steady(scene, 60)
    assert scene.tripped() == []


def test_a_guard_is_refused_unless_the_amplifier_runs_and_measures() -> None:
    """An amplifier ignores it before START, and does not know it if it measures no currents."""
    scene = GuardedScene()
    scene.tell("GUARD", OWNER, 0, 1, body=Entry().packed())
    assert refusals(scene) == [NakCode.STATE]
    deaf = ReferenceAmplifier(CONFIGS["as shipped"])
    message = m.Guard(OWNER, 0, 1, Entry().packed())
    for each in (m.Hello(OWNER, 1), message):
        deaf.receive(Packet.of(each, node=1, ask=True), 0)
    answer = m.MESSAGES[deaf.take_sent()[-1].type]
    assert answer is m.Nak
    assert deaf.counters.unknown_type == 1


def test_messages_hold_channels_that_follow_each_other() -> None:
    """Each message fits the packet limit, and together they carry the chosen channels."""
    rng = np.random.default_rng(0)
    raw = rng.integers(0, 256, 64 * guard.ENTRY.itemsize, np.uint8).tobytes()
    entries: Any = np.frombuffer(raw, guard.ENTRY)
    chosen = [0, 1, 2, 5, 6, *range(20, 64)]
    sent = guard.messages_of(OWNER, entries, 500, channels=chosen)
    assert all(len(message.pack()) + 8 <= 500 for message in sent)
    carried = [message.first_channel + k for message in sent for k in range(message.channels)]
    assert carried == chosen
    for message in sent:
        last = message.first_channel + message.channels
        assert message.entries == entries[message.first_channel : last].tobytes()
        assert m.Guard.unpack(message.pack()) == message
