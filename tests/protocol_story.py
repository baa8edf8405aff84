"""Stories: random sequences of events at an amplifier.

An owner that streams, a second host, noise, and a link that loses, repeats, delays and reorders.
The chances come from seeds; hypothesis shrinks what happens.
"""

import heapq
from collections.abc import Callable, Sequence
from random import Random

import numpy as np
from protocol_judge import TURN
from protocol_traces import Rig, packet, sealed

from firmware_protocol.config import AmplifierConfig

SESSIONS = (0x1234, 0xBEEF, 1)
NOBODY = 0x7777
"""A session that never takes the amplifier."""
WRONG = 0.02
"""Share of what the owner gets wrong itself."""


class Story:
    """Random sequence of events at an amplifier.

    Parameters
    ----------
    rig : rig with the amplifier
    rng : source of all chances; may be replaced at any time
    trouble : share of packets that the link loses, repeats or delays
    """

    def __init__(self, rig: Rig, rng: Random, trouble: float = 0.15) -> None:
        self.rig, self.rng, self.trouble = rig, rng, trouble
        self.session = SESSIONS[0]
        self.mode = self.carriers = self.pointer = self.seq = 0
        self._late: list[tuple[int, int, bytes]] = []

    @property
    def hz(self) -> int:
        return self.rig.config.tick_hz

    def ms(self, milliseconds: float) -> int:
        return round(milliseconds * self.hz / 1000)

    def wait(self, ticks: int) -> None:
        """Let time pass; what the link delayed comes meanwhile."""
        end = self.rig.now + ticks
        while self._late and self._late[0][0] <= end:
            tick, _, data = heapq.heappop(self._late)
            self.rig.run(max(tick, self.rig.now))
            self.rig.packet(data)
        self.rig.run(end)

    def send(self, data: bytes) -> None:
        """Hand a packet to the link."""
        chance = self.rng.random() / self.trouble if self.trouble else 9.0
        if chance < 0.3:
            return
        if chance < 0.6:
            later = self.rig.now + self.rng.randrange(self.ms(30) + 1)
            heapq.heappush(self._late, (later, len(self.rig.records), data))
        if not 0.3 <= chance < 0.45:
            self.rig.packet(data)

    def tell(self, name: str, *fields: int, body: bytes = b"", **head: int) -> None:
        self.seq = (self.seq + 1) & 0xFF
        head = {"node": self.rig.amplifier.node, "seq": self.seq} | head
        self.send(packet(name, *fields, body=body, **head))

    def some(self, *values: int) -> int:
        return self.rng.choice(values)

    # The owner

    def hello(self) -> None:
        if self.rng.random() < 0.1:
            self.session = self.rng.choice(SESSIONS)
        self.tell("HELLO", self.session, self.some(1, 1, 1, 1, 0, 2), 0, 0)

    def beat(self) -> None:
        self.tell("HEARTBEAT", self.session)

    def arm(self, rate: int | None = None, mode: int | None = None) -> None:
        c = self.rig.config
        low, high = c.rate_min_hz, c.rate_max_hz
        self.mode = self.some(0, 1) if mode is None else mode
        some = self.some(low, high, (low + high) // 2 | 1, self.rng.randint(low, high), high + 1)
        self.tell("ARM", self.session, self.mode, some if rate is None else rate)

    def start(self, delay_ms: int | None = None) -> None:
        self.pointer = self.some(0, 160, TURN - 1, TURN - self.rng.randint(1, 400), TURN // 2)
        delay_ms = self.some(0, 0, 1, 5, 40) if delay_ms is None else delay_ms
        time = 0 if self.rng.random() < 0.7 else self.rig.now + self.rng.randint(0, self.ms(30))
        self.tell("START", self.session, self.pointer, delay_ms, time)

    def stop(self) -> None:
        self.tell("STOP", self.session, self.some(0, 1))

    def disarm(self) -> None:
        self.tell("DISARM", self.session)

    def estop(self) -> None:
        """Send an ESTOP, which needs no session."""
        self.tell("ESTOP", self.some(0, 1, 255), node=self.some(0, self.rig.amplifier.node))
        self.poll()

    def clear(self) -> None:
        """End what is latched, as of now or as of some trips ago."""
        trips = self.rig.amplifier.counters.trips - self.some(0, 0, 0, 0, 1, 2, -1)
        self.tell("CLEAR_FAULT", self.session, trips % TURN)

    def limits(self) -> None:
        c = self.rig.config
        most = c.voltage_limit_uv, c.slew_limit_v_per_s, c.fade_limit_us
        lower = [self.some(0, 0, m, m // 2, m * 9 // 10, m + 1, 1) for m in most]
        self.tell("LIMITS", self.session, *lower)

    def poll(self) -> None:
        self.tell("POLL")

    def ask(self) -> None:
        some, parameter = self.rng.randrange(256), self.some(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 99)
        value = self.some(0, 1, 2, 5, 10, 100, 101, 127, 128)
        choice = self.rng.randrange(5)
        if choice == 0:
            self.tell("SET", self.session, parameter, value)
        elif choice == 1:
            self.tell("GET", parameter)
        else:
            self.tell(("TIME", "SYNC", "IDENTIFY")[choice - 2], some, node=self.some(0, 1, 127))

    def measure(self) -> None:
        """Set what SENSE and CORRELATION need, to any value, or to that in force."""
        choices = {
            3: (0, 9, 10, 33, 1000, 1001), 8: (0, 1, 9, 10, 11, 25, 100, 101),
            9: (0, 300, 2500, 2500, 20_000, 65_535, 65_836),
        }  # fmt: skip
        parameter = self.some(3, 8, 8, 9)
        self.tell("SET", self.session, parameter, self.rng.choice(choices[parameter]))

    def ready(self) -> None:
        """Take the amplifier, arm it and start, on whatever the link makes of it."""
        self.clear()
        self.tell("HELLO", self.session, 1, 0, 0)
        mode = self.some(0, 0, 1)
        c = self.rig.config
        self.arm(
            self.some(c.rate_min_hz, c.rate_max_hz, (c.rate_min_hz + c.rate_max_hz) // 3 * 2 | 1),
            mode,
        )
        if mode:
            self.tune()
        self.start(self.some(0, 3))

    def tune(self) -> None:
        c = self.rig.config
        self.carriers = self.rng.randint(1, max(c.carriers, 1))
        body = self._bytes(4 * self.carriers + self.some(0, 0, 0, 0, 1))
        self.tell("CARRIERS", self.session, self.carriers, body=body)

    # Streams

    def _bytes(self, size: int) -> bytes:
        """Return loud, random or even bytes."""
        choice = self.rng.randrange(4)
        if choice == 0:
            return (b"\xff\x7f" * size)[:size]
        if choice == 1:
            return (b"\x00\x80\xff\x7f" * size)[:size]
        if choice == 2:
            period = self.rng.randint(4, 60)
            wave = 32767 * np.sin(np.arange(size // 2 + 1) * (2 * np.pi / period))
            return bytes(wave.astype("<i2"))[:size]
        return np.random.default_rng(self.rng.getrandbits(32)).bytes(size)

    def _channels(self) -> tuple[int, int]:
        total = self.rig.config.channels
        first = self.rng.randrange(total)
        return self.rng.choice(
            [(0, total), (0, total), (first, self.rng.randint(1, total - first))]
        )

    def _wrong(self, count: int) -> int:
        """Return a count, which now and then is not what it should be."""
        return count if self.rng.random() > WRONG else self.some(0, count + 1, max(count - 1, 0))

    def _pcm(self, position: int, samples: int) -> None:
        first, channels = self._channels()
        formats = [f for f in range(3) if self.rig.config.formats >> f & 1]
        kind = self.rng.choice(formats) if self.rng.random() > WRONG else self.rng.randrange(6)
        count = samples * channels
        size = (2 * count, (3 * count + 1) // 2, channels * (samples - samples // -32))[kind % 3]
        first, samples, size = self._wrong(first), self._wrong(samples), self._wrong(size)
        self.tell("PCM", position % TURN, self.session, first, channels, kind, samples,
                  body=self._bytes(size))  # fmt: skip

    def _frame(self, position: int) -> None:
        first, channels = self._channels()
        valid = self.some(0, 5, 40, 400, 65535)
        first, size = self._wrong(first), self._wrong(2 * channels * self.carriers)
        body = self._bytes(size)
        self.tell("SPECTRUM", position % TURN, self.session, valid, first, channels, 3,
                  self.carriers, body=body)  # fmt: skip

    def data(self) -> None:
        """Send samples or a frame anywhere: late, future, over others, or beyond the turn."""
        fifo, here = self.rig.config.fifo, self.rig.amplifier.position
        ahead = self.rng.randint(-20, fifo + 20) if self.rng.random() < 0.9 else self.some(
            fifo - 1, fifo, TURN // 2 - 3, TURN // 2, -TURN // 2 + 1
        )  # fmt: skip
        if self.mode:
            self._frame(here + ahead)
        else:
            self._pcm(here + ahead, self.rng.randint(1, 12))

    def mark(self) -> None:
        """Mark a few positions, most of which are about to be put out."""
        fifo, here = self.rig.config.fifo, self.rig.amplifier.position
        for _ in range(self.some(1, 1, 3, 12)):
            ahead = self.some(-1, 0, 1, 5, 30, 31, fifo - 1, fifo, TURN // 2)
            code, samples = self.some(0, 1, 1, 2, 255), self.some(0, 1, 2, 40, 65535)
            self.tell("MARK", self.session, (here + ahead) % TURN, code, samples)

    def stream(self, milliseconds: int | None = None) -> None:
        """Stream as a host does for a while: heartbeats, blocks, a lead, a gap or mark at times."""
        rig, rng = self.rig, self.rng
        milliseconds = rng.randint(5, 60) if milliseconds is None else milliseconds
        end, beat = rig.now + self.ms(milliseconds), rig.now
        while rig.now < end:
            if rig.now >= beat:
                self.beat()
                beat = rig.now + self.ms(50)
            rate, here = rig.amplifier.rate, rig.amplifier.position
            block = max(1, rate * self.some(2, 4, 8) // 1000)
            block = min(block, 255 if rig.config.packet_limit > 255 else 8)
            ahead = (self.pointer - here + TURN // 2) % TURN - TURN // 2
            if not -2 * block < ahead < rig.config.fifo:
                ahead = rate * 8 // 1000
            while ahead < rate * 12 // 1000:
                if self.mode:
                    self._frame(here + ahead)
                else:
                    self._pcm(here + ahead, block)
                ahead += block + (rng.randint(0, block) if rng.random() < 0.1 else 0)
            self.pointer = here + ahead
            if rng.random() < 0.1:
                self.mark()
            self.wait(max(1, block * self.hz // rate))

    # Others

    def foreign(self, name: str = "") -> None:
        """Let a second host try something, with its own session or with session 0."""
        session = self.some(NOBODY, 0, self.session ^ 1)
        name = name or self.rng.choice(
            ["HELLO", "START", "STOP", "ARM", "DISARM", "CLEAR_FAULT", "HEARTBEAT", "LIMITS", "SET",
             "PCM", "CARRIERS", "SPECTRUM", "MARK"]
        )  # fmt: skip
        fields, body = self._foreign_fields(name, session)
        head = {"node": 0} if self.rng.random() < 0.3 else {}
        self.tell(name, *fields, body=body, **head)

    def _foreign_fields(self, name: str, session: int) -> tuple[list[int], bytes]:
        a, c = self.rig.amplifier, self.rig.config
        if name in ("PCM", "SPECTRUM"):
            rest = [0, c.channels, 0, 2] if name == "PCM" else [99, 0, c.channels, 3, self.carriers]
            size = 4 * c.channels if name == "PCM" else 2 * c.channels * self.carriers
            return [(a.position + 5) % TURN, session, *rest], b"\xff\x7f" * (size // 2)
        rest = {
            "HELLO": [1, 0, 0], "START": [0, 0, 0], "STOP": [1], "ARM": [0, c.rate_min_hz],
            "CLEAR_FAULT": [a.counters.trips], "LIMITS": [1, 0, 1], "SET": [1, 9], "CARRIERS": [1],
            "MARK": [a.position, 1, 1],
        }.get(name, [])  # fmt: skip
        return [session, *rest], b"\0\0\0\1" if name == "CARRIERS" else b""

    def raw(self) -> None:
        """Any type, flags and payload, with the right CRC-32 or not; at times the owner's token."""
        rng = self.rng
        payload = bytearray(self._bytes(rng.randint(0, 24)))
        if len(payload) > 6 and rng.random() < 0.5:
            at = self.some(0, 4)
            payload[at : at + 2] = self.session.to_bytes(2, "little")
        kind = rng.randrange(0x15) if rng.random() < 0.8 else rng.randrange(256)
        flags = self.some(0x40, 0x60, 0x47, 0x48, 0x80, 0xFF)
        data = sealed(
            kind, bytes(payload), node=self.some(0, 1, self.rig.amplifier.node, 99), flags=flags
        )
        if rng.random() < 0.2:
            data = data[: rng.randrange(len(data))] + bytes(rng.randrange(3))
        self.send(data)

    def fault(self) -> None:
        self.rig.fault(self.some(0, 0, 1, 4, 200))

    def button(self) -> None:
        """Pull the e-stop button, or release it, with a contact that may bounce."""
        for _ in range(self.some(1, 1, 1, 3)):
            self.rig.estop_input(self.some(0, 1) == 1)
            self.poll()
            self.wait(self.some(0, 1, self.ms(1), self.ms(30)))
        if self.rng.random() < 0.7:
            self.rig.estop_input(False)
            self.wait(self.ms(self.some(0, 49, 50, 60)) + self.some(-1, 0, 1) * self.some(0, 1))
            self.clear()

    def silence(self) -> None:
        """Let the owner be dead about as long as the watchdog waits; a stranger is not."""
        self._late.clear()
        end = self.rig.now + self.ms(self.rng.randint(140, 230))
        while self.rig.now < end:
            self.foreign(self.some(0, 1) * "HEARTBEAT")
            self.wait(min(end - self.rig.now, self.ms(40)))

    def pause(self) -> None:
        self.wait(self.rng.randint(1, self.ms(self.some(1, 1, 10, 40))))


USUAL: Sequence[tuple[Callable[[Story], None], int]] = (
    (Story.stream, 30), (Story.data, 20), (Story.pause, 15), (Story.beat, 6), (Story.ready, 8),
    (Story.foreign, 5), (Story.raw, 5), (Story.ask, 3), (Story.poll, 3), (Story.stop, 3),
    (Story.start, 2), (Story.arm, 2), (Story.limits, 2), (Story.disarm, 1), (Story.estop, 1),
    (Story.clear, 2), (Story.hello, 1), (Story.tune, 1), (Story.fault, 1), (Story.silence, 1),
    (Story.button, 1), (Story.measure, 6), (Story.mark, 4),
)  # fmt: skip
"""Events, and the relative frequency of each."""


def told(
    config: AmplifierConfig, seed: int, seconds: float, *, judged: bool, singly: bool = False
) -> Rig:
    """Return a rig after a story of so many seconds of virtual time."""
    rng = Random(seed)
    rig = Rig(config, judged=judged, singly=singly)
    story = Story(rig, rng, trouble=rng.choice([0.0, 0.05, 0.3]))
    story.foreign()
    story.ready()
    acts, weights = zip(*USUAL, strict=True)
    while rig.now < seconds * config.tick_hz:
        rng.choices(acts, weights)[0](story)
    rig.end()
    return rig
