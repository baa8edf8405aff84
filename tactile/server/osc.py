"""OSC over UDP, for engines that speak nothing else; on the loopback interface only.

``/tactile/contact x_mm y_mm normal_force_n [vx_mm_s vy_mm_s]``, ``/tactile/texture name``,
``/tactile/gain g``, ``/tactile/stop`` and ``/tactile/estop`` act on the first display,
``/tactile/<display>/…`` on another. Bundles are carried out at once, whatever their time. Each
sender is a client, until it is silent for 5 s. Nothing is answered, and nothing here can arm:
there is no address for it, and these clients may not. An e-stop is carried out before all else,
whoever sends it and however many or much others send.

Packets are read here, of OSC 1.0 what these messages need: python-osc 1.10 never returns from a
bundle whose element claims a negative size.
"""

import asyncio
import logging
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import msgspec

from tactile.clock import loop_time
from tactile.errors import InputError
from tactile.messages import (
    Answer,
    Command,
    Contact,
    EStop,
    Failure,
    Role,
    Select,
    SetGain,
    StopPlaying,
)
from tactile.server.decoding import failed
from tactile.server.metrics import Metrics
from tactile.server.rates import TokenBucket
from tactile.server.requests import ClientProtocol, HostProtocol, Requests
from tactile.server.tasks import watched

log = logging.getLogger("tactile.osc")

LARGEST_PACKET = 4096
MOST_VALUES = 8
NUMBERS = {tag: struct.Struct(">" + code) for tag, code in zip("fdih", "fdiq", strict=True)}
WRONG = (ValueError, struct.error)
"""What reading raises where a packet is no OSC."""
BUNDLE, BUNDLE_HEAD = b"#bundle\0", 16
ROLES: frozenset[Role] = frozenset({"play", "stop"})
"""Of every sender."""
STOPS: frozenset[Role] = frozenset({"stop"})
"""Of the client that carries out e-stops, whoever sends them."""
ROOM = 2**22
"""Bytes that may wait to be read."""
MOST_READ, MOST_USED = 512, 32
"""Packets that are read, and used, before anything else gets its turn."""
MOST_SENDERS = 16
SILENCE = 5.0
"""s after which a sender is forgotten."""
FRESH = 0.05
"""s for which the names of displays are not looked up again, whatever is asked for."""
YIELDS_AFTER = 1.0
"""s of silence after which a sender makes room for a new one."""
Address = tuple[Any, ...]


def _contact(display: str, values: list[Any]) -> Contact:
    if len(values) not in (3, 5):
        raise ValueError("x_mm y_mm normal_force_n [vx_mm_s vy_mm_s]")
    content = {"display": display, "position_mm": values[:2], "normal_force_n": values[2]}
    return msgspec.convert(content | ({"velocity_mm_s": values[3:]} if values[3:] else {}), Contact)


def _texture(display: str, values: list[Any]) -> Select:
    layers = [{"texture": name} for name in values if name != ""]
    return msgspec.convert({"display": display, "layers": layers}, Select)


def _gain(display: str, values: list[Any]) -> SetGain:
    (gain,) = values
    return msgspec.convert({"display": display, "gain": gain}, SetGain)


def _stop(display: str, values: list[Any]) -> StopPlaying:
    return StopPlaying(display=display)


def _estop(display: str, values: list[Any]) -> EStop:
    return EStop(display=display)


VERBS: dict[str, Callable[[str, list[Any]], Command]] = {
    "contact": _contact,
    "texture": _texture,
    "gain": _gain,
    "stop": _stop,
    "estop": _estop,
}


def read_packet(data: bytes) -> list[tuple[str, list[Any]]]:
    """Return address and values of each message of a packet.

    Raises
    ------
    InputError
        Where it is none.
    """
    if len(data) > LARGEST_PACKET:
        raise InputError(f"{len(data)} bytes: at most {LARGEST_PACKET}")
    try:
        return [_message(part) for part in _parts(data)]
    except WRONG as error:
        raise InputError(f"no OSC: {error}") from error


def read_estops(data: bytes, first: str) -> list[EStop]:
    """Return each e-stop of a packet, whatever else is in it; ``first`` names the first display."""
    found: list[EStop] = []
    if len(data) > LARGEST_PACKET or b"estop" not in data:
        return found
    with suppress(*WRONG):  # what follows a fault cannot be read
        for part in _parts(data):
            with suppress(*WRONG):
                command = to_command(*_message(part), first)
                found += [command] if isinstance(command, EStop) else []
    return found


def _parts(data: bytes) -> Iterator[bytes]:
    """Yield the messages of a packet, which is one or a bundle of packets."""
    waiting = [data]
    while waiting:
        packet = waiting.pop()
        if packet.startswith(b"/"):
            yield packet
            continue
        if not packet.startswith(BUNDLE) or len(packet) < BUNDLE_HEAD:
            raise ValueError("neither a message nor a bundle")
        at, parts = BUNDLE_HEAD, []
        while at < len(packet):
            (size,) = struct.unpack_from(">i", packet, at)
            if size <= 0 or size % 4 or at + 4 + size > len(packet):
                raise ValueError(f"an element of {size} bytes")
            parts.append(packet[at + 4 : at + 4 + size])
            at += 4 + size
        waiting += reversed(parts)


def _message(data: bytes) -> tuple[str, list[Any]]:
    address, at = _string(data, 0)
    tags, at = _string(data, at) if at < len(data) else (",", at)
    if not tags.startswith(",") or len(tags) - 1 > MOST_VALUES:
        raise ValueError(f"values of types {tags[:20]!r}: at most {MOST_VALUES} after a comma")
    values: list[Any] = []
    for tag in tags[1:]:
        if tag == "s":
            value, at = _string(data, at)
            values.append(value)
        elif tag in NUMBERS:
            values += NUMBERS[tag].unpack_from(data, at)
            at += NUMBERS[tag].size
        else:
            raise ValueError(f"a value of type {tag!r}: must be one of {', '.join(NUMBERS)}, s")
    return address, values


def _string(data: bytes, at: int) -> tuple[str, int]:
    """Return a string and where what follows begins."""
    end = data.find(b"\0", at)
    if end < 0:
        raise ValueError("a string without end")
    return data[at:end].decode("ascii"), end // 4 * 4 + 4


def to_command(address: str, values: list[Any], first: str) -> Command | Failure:
    """Return what a message asks, or what is wrong with it; ``first`` names the first display."""
    root, _, rest = address.removeprefix("/").partition("/")
    display, _, verb = rest.rpartition("/")
    if root != "tactile" or verb not in VERBS:
        return failed("unknown_type", f"no address {address!r}", field="address")
    try:
        return VERBS[verb](display or first, values)
    except (msgspec.ValidationError, ValueError, TypeError) as error:
        return failed("invalid_field", f"{address!r}: {error}", field=verb)


@dataclass
class Sender:
    """A client: where it sends from is all that is known of it."""

    client: ClientProtocol
    requests: Requests
    bucket: TokenBucket
    heard: float


class OscProtocol(asyncio.DatagramProtocol):
    """Takes packets, and never raises."""

    def __init__(
        self, link: socket.socket, host: HostProtocol, metrics: Metrics, messages_per_second: float
    ) -> None:
        self._link, self._host, self._rate = link, host, messages_per_second
        self._traffic = metrics.of("osc")
        self._senders: dict[Address, Sender] = {}
        self._ended: set[asyncio.Task[None]] = set()
        self._first, self._names, self._ask_again = "", set[str](), 0.0
        self._stopping = host.connect("osc e-stop", roles=STOPS)
        self._stops = Requests(self._stopping, self._traffic, self._complain_of_estop)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Carry out what a packet says, and those that wait behind it; e-stops first."""
        now = loop_time()
        try:
            packets = [(data, addr), *self._waiting()]
            stops: dict[str | None, EStop] = {}
            for one, _ in packets:
                if b"estop" in one:
                    found = read_estops(one, self._first_display(now))
                    stops |= {one.display: one for one in found if self._is_known(one, now)}
            for stop in stops.values():
                self._stops.offer(stop)
            for one, sender in packets[:MOST_USED]:
                self._use(one, sender, now)
            if len(packets) > MOST_USED:
                self._traffic.drop("too_fast", len(packets) - MOST_USED)
        except Exception:
            self._traffic.failure("internal")
            log.exception("a packet failed")
        self._empty(self._stopping)

    def _waiting(self) -> Iterator[tuple[bytes, Address]]:
        """Read the packets that wait already."""
        for _ in range(MOST_READ - 1):
            try:
                yield self._link.recvfrom(LARGEST_PACKET + 1)
            except OSError:  # no more
                return

    def _use(self, data: bytes, addr: Address, now: float) -> None:
        """Carry out what a packet says besides e-stops."""
        sender = self._senders.get(addr)
        if sender is not None and not sender.bucket.take(now):
            self._traffic.drop("too_fast")
            return
        try:
            messages = read_packet(data)
        except InputError as error:
            self._complain(failed("malformed", str(error)), addr)
            return
        commands = [to_command(*message, self._first_display(now)) for message in messages]
        commands = [command for command in commands if not isinstance(command, EStop)]
        if not commands:
            return
        sender = self._sender(addr, now)
        if sender is None:
            self._complain(failed("too_many_clients", f"{MOST_SENDERS} send already"), addr)
            return
        self._carry_out(sender, commands[0], now, addr)
        for command in commands[1:]:
            if sender.bucket.take(now):
                self._carry_out(sender, command, now, addr)
            else:
                self._traffic.drop("too_fast")

    def error_received(self, exc: Exception) -> None:
        """Do nothing: nothing is sent that could come back."""

    def _carry_out(
        self, sender: Sender, command: Command | Failure, now: float, addr: Address
    ) -> None:
        if isinstance(command, Contact):
            failure = sender.client.contact(command, now)
            self._traffic.message("contact", loop_time() - now)
        elif isinstance(command, Failure):
            failure = command
        else:
            failure = sender.requests.offer(command)
        if failure is not None:
            self._complain(failure, addr)
        self._empty(sender.client)

    @staticmethod
    def _empty(client: ClientProtocol) -> None:
        """Throw away what is said to a client: nothing is sent back."""
        while not client.outbox.empty():
            client.outbox.get_nowait()

    def _first_display(self, now: float) -> str:
        """Return the first display's name, looked up once a second."""
        if now >= self._ask_again:
            self._look_up(now)
        return self._first

    def _is_known(self, stop: EStop, now: float) -> bool:
        """Return whether there is a display to stop; a flood of made-up names costs little."""
        if stop.display not in self._names and now >= self._ask_again - 1 + FRESH:
            self._look_up(now)
        return stop.display in self._names

    def _look_up(self, now: float) -> None:
        names = [display.name for display in self._host.displays]
        self._first, self._names, self._ask_again = names[0] if names else "", set(names), now + 1

    def _sender(self, addr: Address, now: float) -> Sender | None:
        sender = self._senders.pop(addr, None)
        if sender is None:
            if len(self._senders) >= MOST_SENDERS:
                oldest = next(iter(self._senders))
                if now - self._senders[oldest].heard < YIELDS_AFTER:
                    return None
                self._forget(oldest)
            client = self._host.connect(f"osc {addr[0]}:{addr[1]}", roles=ROLES)

            def answered(answer: Answer) -> None:
                if isinstance(answer, Failure):
                    self._complain(answer, addr)

            requests = Requests(client, self._traffic, answered)
            sender = Sender(client, requests, TokenBucket(self._rate), now)
            self._traffic.clients.inc()
        sender.heard = now
        self._senders[addr] = sender  # the last heard comes last
        return sender

    def _complain_of_estop(self, answer: Answer) -> None:
        if isinstance(answer, Failure):
            self._complain(answer, ("e-stop", 0))

    def _complain(self, failure: Failure, addr: Address) -> None:
        self._traffic.failure(failure.code)
        fields = {"code": failure.code, "why": failure.message, "sender": f"{addr[0]}:{addr[1]}"}
        log.warning("an OSC message was not used", extra={"fields": fields})

    def _forget(self, addr: Address) -> None:
        sender = self._senders.pop(addr)
        self._traffic.clients.dec()
        sender.client.close()
        task = watched(asyncio.create_task(sender.requests.finish()))
        self._ended.add(task)
        task.add_done_callback(self._ended.discard)

    async def forget_silent(self) -> None:
        """Close the clients of those that are silent, for as long as this runs."""
        while True:
            now = loop_time()
            for addr in [a for a, s in self._senders.items() if now - s.heard > SILENCE]:
                self._forget(addr)
            await asyncio.sleep(SILENCE / 10)

    async def finish(self) -> None:
        """Close all clients."""
        for addr in list(self._senders):
            self._forget(addr)
        self._stopping.close()
        await asyncio.gather(self._stops.finish(), *self._ended, return_exceptions=True)
