"""OSC over UDP, for engines that speak nothing else; on the loopback interface only.

``/tactile/contact x_mm y_mm normal_force_n [vx_mm_s vy_mm_s]``, ``/tactile/texture name``,
``/tactile/gain g``, ``/tactile/stop`` and ``/tactile/estop`` act on the first display,
``/tactile/<display>/…`` on another. Bundles are carried out at once, whatever their time. Each
sender is a client, until it is silent for 5 s. Nothing is answered, and nothing here can arm:
there is no address for it, and these clients may not.

Packets are read here, of OSC 1.0 what these messages need: python-osc 1.10 never returns from a
bundle whose element claims a negative size.
"""

import asyncio
import logging
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import msgspec

from tactile.daemon.decoding import failed
from tactile.daemon.messages import (
    Answer,
    Command,
    Contact,
    EStop,
    Failure,
    Gain,
    Role,
    Select,
    Stop,
)
from tactile.daemon.metrics import Metrics
from tactile.daemon.requests import Client, Host, Requests, TokenBucket
from tactile.errors import InputError

log = logging.getLogger("tactile.osc")

LARGEST_PACKET = 4096
MOST_VALUES = 8
NUMBERS = {tag: struct.Struct(">" + code) for tag, code in zip("fdih", "fdiq", strict=True)}
BUNDLE, BUNDLE_HEAD = b"#bundle\0", 16
ROLES: frozenset[Role] = frozenset({"play", "stop"})
"""Of every sender."""
MOST_SENDERS = 16
SILENCE = 5.0
"""s after which a sender is forgotten."""
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


def _gain(display: str, values: list[Any]) -> Gain:
    (gain,) = values
    return msgspec.convert({"display": display, "gain": gain}, Gain)


def _stop(display: str, values: list[Any]) -> Stop:
    return Stop(display=display)


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
    except (ValueError, struct.error) as error:
        raise InputError(f"no OSC: {error}") from error


def _parts(data: bytes) -> list[bytes]:
    """Return the messages of a packet, which is one or a bundle of packets."""
    found, waiting = [], [data]
    while waiting:
        packet = waiting.pop()
        if packet.startswith(b"/"):
            found.append(packet)
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
    return found


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

    client: Client
    requests: Requests
    bucket: TokenBucket
    heard: float


class OscProtocol(asyncio.DatagramProtocol):
    """Takes packets, and never raises."""

    def __init__(self, host: Host, metrics: Metrics, messages_per_second: float) -> None:
        self._host, self._rate = host, messages_per_second
        self._traffic = metrics.of("osc")
        self._senders: dict[Address, Sender] = {}
        self._ended: set[asyncio.Task[None]] = set()
        self._first, self._ask_again = "", 0.0

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Carry out what a packet says."""
        now = time.monotonic()
        try:
            sender = self._sender(addr, now)
            if sender is None:
                self._complain(failed("too_many_clients", f"{MOST_SENDERS} send already"), addr)
                return
            for address, values in read_packet(data):
                if sender.bucket.take(now):
                    self._carry_out(sender, address, values, now, addr)
                else:
                    self._traffic.drop("too_fast")
        except InputError as error:
            self._complain(failed("malformed", str(error)), addr)
        except Exception:
            self._traffic.failure("internal")
            log.exception("a packet failed")

    def error_received(self, exc: Exception) -> None:
        """Do nothing: nothing is sent that could come back."""

    def _carry_out(
        self, sender: Sender, address: str, values: list[Any], now: float, addr: Address
    ) -> None:
        command = to_command(address, values, self._first_display(now))
        if isinstance(command, Contact):
            failure = sender.client.contact(command, now)
            self._traffic.message("contact", time.monotonic() - now)
        elif isinstance(command, Failure):
            failure = command
        else:
            failure = sender.requests.offer(command)
        if failure is not None:
            self._complain(failure, addr)
        with suppress(asyncio.QueueEmpty):
            while True:
                sender.client.outbox.get_nowait()

    def _first_display(self, now: float) -> str:
        """Return the first display's name, asked for once a second."""
        if now >= self._ask_again:
            self._first = next((display.name for display in self._host.displays), "")
            self._ask_again = now + 1
        return self._first

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

    def _complain(self, failure: Failure, addr: Address) -> None:
        self._traffic.failure(failure.code)
        fields = {"code": failure.code, "why": failure.message, "sender": f"{addr[0]}:{addr[1]}"}
        log.warning("an OSC message was not used", extra={"fields": fields})

    def _forget(self, addr: Address) -> None:
        sender = self._senders.pop(addr)
        sender.client.close()
        self._traffic.clients.dec()
        task = asyncio.create_task(sender.requests.finish())
        self._ended.add(task)
        task.add_done_callback(self._ended.discard)

    async def forget_silent(self) -> None:
        """Close the clients of those that are silent, for as long as this runs."""
        while True:
            now = time.monotonic()
            for addr in [a for a, s in self._senders.items() if now - s.heard > SILENCE]:
                self._forget(addr)
            await asyncio.sleep(SILENCE / 10)

    async def finish(self) -> None:
        """Close all clients."""
        for addr in list(self._senders):
            self._forget(addr)
        await asyncio.gather(*self._ended)
