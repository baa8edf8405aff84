"""OSC over UDP, for engines that speak nothing else; on the loopback interface only.

``/tactile/contact x_mm y_mm normal_force_n [vx_mm_s vy_mm_s]``, ``/tactile/texture name``,
``/tactile/gain g``, ``/tactile/stop`` and ``/tactile/estop`` act on the first display,
``/tactile/<display>/…`` on another one. Bundles are carried out at once, whatever their time tag.
Each sender is a client until it has been silent for 5 s. Nothing is answered, and nothing here can
arm: there is no address for it, and these clients lack the role. An e-stop is carried out before
everything else, whoever sends it and however much others send.

Packets are parsed here, as far as these messages need OSC 1.0, because python-osc 1.10 never
returns from a bundle with an element of negative size.
"""

import asyncio
import logging
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
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
from tactile.server.client import Client
from tactile.server.decoding import failed
from tactile.server.host import Host
from tactile.server.metrics import Metrics
from tactile.server.rates import TokenBucket
from tactile.server.requests import Requests
from tactile.server.tasks import start_task

log = logging.getLogger("tactile.osc")

LARGEST_PACKET = 4096
"""Largest size of a packet [bytes]."""
MOST_VALUES = 8
"""Maximum number of values of a message."""
NUMBERS = {tag: struct.Struct(">" + code) for tag, code in zip("fdih", "fdiq", strict=True)}
"""Format of a number by its OSC type tag."""
WRONG = (ValueError, struct.error)
"""Exceptions that parsing raises if a packet is not OSC."""
BUNDLE, BUNDLE_HEAD = b"#bundle\0", 16
"""Beginning of a bundle, and size of its header [bytes]."""
ROLES: frozenset[Role] = frozenset({"play"})
"""Roles of every sender."""
ROOM = 2**22
"""Size of the receive buffer of the socket [bytes]."""
MOST_READ, MOST_USED = 512, 32
"""Numbers of packets that are read and that are processed before anything else gets its turn."""
MOST_SENDERS = 16
"""Maximum number of senders."""
SILENCE = 5.0
"""Silence after which a sender is forgotten [s]."""
FRESH = 0.05
"""Time for which the names of displays are not looked up again, whatever name is asked for [s]."""
YIELDS_AFTER = 1.0
"""Silence after which a sender makes room for a new one [s]."""
REMEDIES = {
    "disarmed": "arm it by a program (tactile.connect, arm), or set arm_on_start = true",
    "estopped": "tactile clear",
}
"""What lets a display play again, by its state."""
Address = tuple[Any, ...]
"""Address of a sender."""


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
"""Function that makes a command of a message's values, by the last part of its address."""


def read_packet(data: bytes) -> list[tuple[str, list[Any]]]:
    """Parse a packet.

    Parameters
    ----------
    data : bytes
        The packet, a message or a bundle.

    Returns
    -------
    list of (str, list)
        Address and values of each message.

    Raises
    ------
    InputError
        If the packet is not OSC.
    """
    if len(data) > LARGEST_PACKET:
        raise InputError(f"{len(data)} bytes: at most {LARGEST_PACKET}")
    try:
        return [_message(part) for part in _parts(data)]
    except WRONG as error:
        raise InputError(f"not an OSC packet: {error}") from error


def read_estops(data: bytes, first: str) -> list[EStop]:
    """Find each e-stop in a packet, whatever else is in it.

    Parameters
    ----------
    data : bytes
        The packet, which need not be valid throughout.
    first : str
        Name of the first display.

    Returns
    -------
    list of EStop
        E-stops up to the first fault in the structure of the packet.
    """
    estops: list[EStop] = []
    if len(data) > LARGEST_PACKET or b"estop" not in data:
        return estops
    with suppress(*WRONG):  # nothing after a fault in the structure can be parsed
        for part in _parts(data):
            with suppress(*WRONG):
                command = to_command(*_message(part), first)
                estops += [command] if isinstance(command, EStop) else []
    return estops


def _parts(data: bytes) -> Iterator[bytes]:
    """Yield the messages of a packet, which is a message or a bundle of packets."""
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
    """Return a string, and the offset of what follows it."""
    end = data.find(b"\0", at)
    if end < 0:
        raise ValueError("a string without end")
    return data[at:end].decode("ascii"), end // 4 * 4 + 4


def to_command(address: str, values: list[Any], first: str) -> Command | Failure:
    """Translate a message to a command.

    Parameters
    ----------
    address : str
        Address of the message.
    values : list
        Values of the message.
    first : str
        Name of the first display, which an address without a display refers to.

    Returns
    -------
    Command or Failure
        The command, or what is wrong with the message.
    """
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
    """Sender of packets, which is a client of the host.

    Attributes
    ----------
    client : Client
        Client of the host.
    requests : Requests
        Requests of the client.
    bucket : TokenBucket
        Limit on its messages.
    last_received : float
        Time of its latest packet [s].
    is_warned : bool
        Whether it was logged that its contacts have no effect, since they last had one.
    """

    client: Client
    requests: Requests
    bucket: TokenBucket
    last_received: float
    is_warned: bool = False


class OscProtocol(asyncio.DatagramProtocol):
    """Protocol that carries out the packets that arrive, and never raises.

    Parameters
    ----------
    link : socket
        Socket of the packets, non-blocking.
    host : Host
        Displays of the server.
    metrics : Metrics
        Metrics of the server.
    messages_per_second : float
        Maximum rate of messages of each sender [1/s].
    """

    def __init__(
        self, link: socket.socket, host: Host, metrics: Metrics, messages_per_second: float
    ) -> None:
        self._link, self._host, self._rate = link, host, messages_per_second
        self._traffic = metrics.of("osc")
        self._senders: dict[Address, Sender] = {}
        self._finishing: set[asyncio.Task[None]] = set()
        self._first, self._names, self._names_expire = "", set[str](), 0.0
        self._estop_client = host.connect("osc e-stop", roles=frozenset())
        log_answer = partial(self._log_answer, ("e-stop", 0))
        self._estop_requests = Requests(self._estop_client, self._traffic, log_answer)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Carry out a packet and those that wait behind it, e-stops first.

        Parameters
        ----------
        data : bytes
            The packet.
        addr : tuple
            Address of its sender.
        """
        now = loop_time()
        try:
            packets = [(data, addr), *self._waiting()]
            stops: dict[str | None, EStop] = {}
            for packet, _ in packets:
                if b"estop" in packet:
                    estops = read_estops(packet, self._first_display(now))
                    stops |= {stop.display: stop for stop in estops if self._is_known(stop, now)}
            for stop in stops.values():
                self._estop_requests.offer(stop)
            for packet, sender in packets[:MOST_USED]:
                self._process(packet, sender, now)
            if len(packets) > MOST_USED:
                self._traffic.drop("too_fast", len(packets) - MOST_USED)
        except Exception:
            self._traffic.failure("internal")
            log.exception("an OSC packet could not be handled")
        self._discard_outbox(self._estop_client)

    def _waiting(self) -> Iterator[tuple[bytes, Address]]:
        """Read the packets that wait already."""
        for _ in range(MOST_READ - 1):
            try:
                yield self._link.recvfrom(LARGEST_PACKET + 1)
            except OSError:  # none is left
                return

    def _process(self, data: bytes, addr: Address, now: float) -> None:
        """Carry out the messages of a packet, except e-stops."""
        sender = self._senders.get(addr)
        if sender is not None and not sender.bucket.take(now):
            self._traffic.drop("too_fast")
            return
        try:
            messages = read_packet(data)
        except InputError as error:
            self._log_failure(failed("malformed", str(error)), addr)
            return
        commands = [to_command(*message, self._first_display(now)) for message in messages]
        commands = [command for command in commands if not isinstance(command, EStop)]
        if not commands:
            return
        sender = self._sender(addr, now)
        if sender is None:
            self._log_failure(failed("too_many_clients", f"{MOST_SENDERS} send already"), addr)
            return
        self._carry_out(sender, commands[0], now, addr)
        for command in commands[1:]:
            if sender.bucket.take(now):
                self._carry_out(sender, command, now, addr)
            else:
                self._traffic.drop("too_fast")

    def error_received(self, exc: Exception) -> None:
        """Ignore an error, as nothing is sent that could fail.

        Parameters
        ----------
        exc : Exception
            The error.
        """

    def _carry_out(
        self, sender: Sender, command: Command | Failure, now: float, addr: Address
    ) -> None:
        if isinstance(command, Contact):
            failure = sender.client.stream(command, now)
            self._traffic.message("contact", loop_time() - now)
            if failure is None:
                self._check_state(sender, command.display, addr)
        elif isinstance(command, Failure):
            failure = command
        else:
            failure = sender.requests.offer(command)
        if failure is not None:
            self._log_failure(failure, addr)
        self._discard_outbox(sender.client)

    def _check_state(self, sender: Sender, display: str, addr: Address) -> None:
        """Log once that contacts have no effect because the display is not armed."""
        state = self._host.state(display)
        if state == "armed":
            sender.is_warned = False
        elif not sender.is_warned:
            sender.is_warned = True
            fields = {"display": display, "state": state, "sender": f"{addr[0]}:{addr[1]}"}
            if state in REMEDIES:
                fields["remedy"] = REMEDIES[state]
            log.warning("OSC contacts have no effect", extra={"fields": fields})

    @staticmethod
    def _discard_outbox(client: Client) -> None:
        """Discard the messages for a client, because nothing is sent back."""
        while not client.outbox.empty():
            client.outbox.get_nowait()

    def _first_display(self, now: float) -> str:
        """Return the name of the first display, which is looked up once per second."""
        if now >= self._names_expire:
            self._refresh_names(now)
        return self._first

    def _is_known(self, stop: EStop, now: float) -> bool:
        """Return whether there is such a display; a flood of made-up names costs little."""
        if stop.display not in self._names and now >= self._names_expire - 1 + FRESH:
            self._refresh_names(now)
        return stop.display in self._names

    def _refresh_names(self, now: float) -> None:
        names = [display.name for display in self._host.displays]
        self._first, self._names = names[0] if names else "", set(names)
        self._names_expire = now + 1

    def _sender(self, addr: Address, now: float) -> Sender | None:
        """Return the sender with an address, which is added if there is room."""
        sender = self._senders.pop(addr, None)
        if sender is None:
            if len(self._senders) >= MOST_SENDERS:
                oldest = next(iter(self._senders))
                if now - self._senders[oldest].last_received < YIELDS_AFTER:
                    return None
                self._forget(oldest)
            client = self._host.connect(f"osc {addr[0]}:{addr[1]}", roles=ROLES)
            requests = Requests(client, self._traffic, partial(self._log_answer, addr))
            sender = Sender(client, requests, TokenBucket(self._rate), now)
            self._traffic.clients.inc()
        sender.last_received = now
        self._senders[addr] = sender  # ordered by the time of the latest packet
        return sender

    def _log_answer(self, addr: Address, answer: Answer) -> None:
        if isinstance(answer, Failure):
            self._log_failure(answer, addr)

    def _log_failure(self, failure: Failure, addr: Address) -> None:
        """Count and log a message that was not used."""
        self._traffic.failure(failure.code)
        fields = {"code": failure.code, "why": failure.message, "sender": f"{addr[0]}:{addr[1]}"}
        log.warning("an OSC message was not used", extra={"fields": fields})

    def _forget(self, addr: Address) -> None:
        """Close the client of a sender."""
        sender = self._senders.pop(addr)
        self._traffic.clients.dec()
        sender.client.close()
        start_task(sender.requests.finish(), among=self._finishing)

    async def forget_silent(self) -> None:
        """Close the clients of senders that have been silent, until cancelled."""
        while True:
            now = loop_time()
            for addr in [a for a, s in self._senders.items() if now - s.last_received > SILENCE]:
                self._forget(addr)
            await asyncio.sleep(SILENCE / 10)

    async def finish(self) -> None:
        """Close all clients."""
        for addr in list(self._senders):
            self._forget(addr)
        self._estop_client.close()
        await asyncio.gather(
            self._estop_requests.finish(), *self._finishing, return_exceptions=True
        )
