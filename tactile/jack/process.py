"""The process of a sound card: a client of JACK that sends what comes in to its parent.

libjack needs a process of its own, since it does not bear the end of a server, and since no other
thread of Python may hold up the callback of a cycle. When the server ends, the process ends.
"""

import gc
import os
import sys
import threading
from contextlib import suppress
from queue import SimpleQueue
from typing import IO, Any

import numpy as np

from tactile.clock import MONOTONIC, Clock
from tactile.jack.card_messages import (
    CardFailed,
    CardLost,
    CardOpened,
    CardOrder,
    CardSources,
    CardWaits,
    JackCycle,
    PortSources,
)
from tactile.jack.cycle_clock import CycleClock
from tactile.jack.frame_numbers import frames_between
from tactile.jack.library import load_jack
from tactile.jack.patchbay import Patchbay
from tactile.processes import ChildProcess, pipes_of_parent, received, send

MOST_CYCLES, LONGEST_WAIT = 64, 0.5
"""Number of cycles that may wait to be sent to the parent in any case, and duration for which
cycles may wait [s]; more are left out, and their frames are missing. Assumed: more than the
headroom, and less than the server lets frames wait."""
LOOK = 0.5
"""Time between looks at the connections, and between attempts to find a server [s]."""
CLOSING = 2.0
"""Longest wait for libjack to close a client [s]; 0.1 s was seen."""
READINGS, CLOSE = 3, 20e-6
"""Largest number of readings of JACK's clock in a cycle, and the uncertainty of one that is good
enough [s]. A reading takes some microseconds; one that was interrupted takes milliseconds."""
SWITCHING = 1e-4
"""Time after which a thread of this process gives way to another, such as that of JACK [s].
Assumed: short beside a cycle."""
NO_SERVER = "no JACK server; start one, such as jackd -d dummy, or run this under pw-jack"


class JackProcess(ChildProcess):
    """Process of a sound card as its parent knows it.

    Parameters
    ----------
    order : CardOrder
        Client to become.
    on_message : Callable
        Function that takes each message of the process, and None when they end, in a thread.
    """

    def __init__(self, order: CardOrder, on_message: Any) -> None:
        self._ended = threading.Event()
        self._on_card_message = on_message
        super().__init__("tactile.jack.process", self._receive)
        with suppress(OSError):  # a process that has ended says so
            send(self._pipe, order)

    def _receive(self, message: Any) -> None:
        """Pass a message on."""
        self._on_card_message(message)
        if message is None:
            self._ended.set()

    def close(self) -> None:
        """Let the client leave JACK, which takes a moment, and end the process."""
        with suppress(OSError):
            self._pipe.close()
        MONOTONIC.wait(self._ended, CLOSING)
        self.kill()


class JackClient:
    """Client of JACK with a port for each contactor.

    Parameters
    ----------
    order : CardOrder
        Name, ports and connections.
    messages : SimpleQueue
        Queue for messages to the parent.
    clock : Clock
        Monotonic clock.

    Attributes
    ----------
    lost : threading.Event
        Event that is set when JACK has ended.

    Raises
    ------
    jack.JackError
        If there is no server, or it does not take the client.
    """

    def __init__(
        self, order: CardOrder, messages: "SimpleQueue[object]", clock: Clock = MONOTONIC
    ) -> None:
        jack = load_jack()
        self._messages, self._clock = messages, clock
        self._xruns, self._freewheels = 0, False
        self._cycles = CycleClock()
        self.lost = threading.Event()
        name = order.name[: jack.client_name_size() - 1]
        self._client: Any = jack.Client(name, no_start_server=True)
        self._patchbay = Patchbay(order.sources)
        self._sources: PortSources = order.sources
        self._ports: list[Any] = []
        self._registered: set[str] = set()
        self._client.set_shutdown_callback(self._shut_down)

    def activate(self) -> None:
        """Register the ports, and begin to send what comes in.

        Raises
        ------
        jack.JackError
            If JACK has no more ports, or has ended.
        """
        client = self._client
        for index in range(len(self._sources)):
            port = client.inports.register(f"contactor {index}", is_terminal=True)
            self._ports.append(port)
        self._opened = CardOpened(client.name, float(client.samplerate), client.blocksize)
        client.set_process_callback(self._process)
        client.set_xrun_callback(self._count_xrun)
        client.set_freewheel_callback(self._freewheel)
        client.set_port_registration_callback(self._note_port)
        self._messages.put(self._opened)
        client.activate()

    def look(self) -> None:
        """Connect what was connected before, and report what is connected now.

        Raises
        ------
        jack.JackError
            If JACK has ended.
        """
        jack, client = load_jack(), self._client
        registered, self._registered = self._registered, set()
        existing = {port.name for port in client.get_ports(is_audio=True, is_output=True)}
        connected = [{other.name for other in port.connections} for port in self._ports]
        for index, source in self._patchbay.look(connected, existing, registered):
            with suppress(jack.JackError):  # it may have vanished again
                client.connect(source, self._ports[index])
        if self._patchbay.sources != self._sources:
            self._sources = self._patchbay.sources
            self._messages.put(CardSources(self._sources))

    def close(self) -> None:
        """Leave JACK."""
        self._client.close()

    def _process(self, count: int) -> None:
        """Send what has come into the ports."""
        client = self._client
        rate = float(client.samplerate)
        if self._freewheels:
            return
        reading, number = self._begin_of_cycle(rate)
        time = self._cycles.take(number, reading, rate)
        if self._messages.qsize() >= max(MOST_CYCLES, LONGEST_WAIT * rate / count):
            return
        frames = np.stack([port.get_array() for port in self._ports], axis=1)
        self._messages.put(JackCycle(time, number, rate, frames.tobytes(), self._xruns))

    def _begin_of_cycle(self, rate: float) -> tuple[float, int]:
        """Return the begin of the cycle on the monotonic clock [s], and its first frame."""
        client, clock = self._client, self._clock
        number = client.last_frame_time
        shortest, time = float("inf"), 0.0
        for _ in range(READINGS):
            before = clock.now()
            frame = client.frame_time
            after = clock.now()
            if after - before < shortest:
                shortest = after - before
                time = (before + after) / 2 - frames_between(number, frame) / rate
            if shortest < CLOSE:
                break
        return time, number

    def _count_xrun(self, delayed_us: float) -> None:
        """Count that JACK was late."""
        self._xruns += 1

    def _note_port(self, port: Any, register: bool) -> None:
        """Note that a port has come, which may have the name of one that has gone."""
        if register:
            self._registered.add(port.name)

    def _freewheel(self, starting: bool) -> None:
        """Leave out what JACK plays as quickly as it can, as for an export to a file."""
        if not starting:
            self._cycles = CycleClock()
            self._messages.put(self._opened)
        self._freewheels = starting

    def _shut_down(self, status: object, reason: str) -> None:
        """Report the end of JACK."""
        self._messages.put(CardLost(" ".join(reason.split())))
        self.lost.set()


def open_client(
    order: CardOrder, messages: "SimpleQueue[object]", ended: threading.Event
) -> JackClient | None:
    """Open the client, and wait for a JACK server if there is none.

    Parameters
    ----------
    order : CardOrder
        Client to become.
    messages : SimpleQueue
        Queue for messages to the parent.
    ended : threading.Event
        Event that ends the wait.

    Returns
    -------
    JackClient or None
        Client; None if the event was set first.
    """
    jack = load_jack()
    last = ""
    while not ended.is_set():
        try:
            return JackClient(order, messages)
        except jack.JackOpenError as error:
            reason = NO_SERVER if error.status.server_failed else f"JACK takes no client: {error}"
        if reason != last:
            messages.put(CardWaits(reason))
            last = reason
        MONOTONIC.wait(ended, LOOK)
    return None


def send_messages(pipe: IO[bytes], messages: "SimpleQueue[object]") -> None:
    """Send messages to the parent, and end this process after the last one.

    Parameters
    ----------
    pipe : binary file
        Pipe to the parent.
    messages : SimpleQueue
        Messages; a `CardLost` or `CardFailed` is the last one.
    """
    with suppress(OSError):  # the parent has ended, and this process ends with it
        while True:
            message = messages.get()
            send(pipe, message)
            if isinstance(message, CardLost | CardFailed):
                os._exit(0)  # libjack may hang once its server has gone


def work(order: CardOrder, messages: "SimpleQueue[object]", ended: threading.Event) -> None:
    """Be a client of JACK until an event is set.

    Parameters
    ----------
    order : CardOrder
        Client to become.
    messages : SimpleQueue
        Queue for messages to the parent.
    ended : threading.Event
        Event that ends the client.
    """
    jack = load_jack()
    jack.set_error_function(lambda message: None)  # what matters comes as an exception
    jack.set_info_function(lambda message: None)
    client = open_client(order, messages, ended)
    if client is None:
        return
    try:
        client.activate()
    except jack.JackError as error:
        MONOTONIC.wait(client.lost, CLOSING)  # it may have ended, which it says itself
        if not client.lost.is_set():
            count = len(order.sources)
            messages.put(CardFailed(f"JACK has no ports for {count} contactors: {error}"))
        MONOTONIC.wait(ended, CLOSING)
        return
    gc.collect()
    gc.freeze()
    gc.disable()  # a collection would hold up a cycle
    while not ended.is_set():
        with suppress(jack.JackError, ValueError):  # JACK has ended, which it says itself
            client.look()
        MONOTONIC.wait(ended, LOOK)
    client.close()


def main() -> None:
    """Be the client of JACK that the parent orders, until the parent or JACK ends."""
    sys.setswitchinterval(SWITCHING)
    inward, outward = pipes_of_parent()
    parent = received(inward)
    order = next(parent, None)
    if not isinstance(order, CardOrder):
        return
    messages: SimpleQueue[object] = SimpleQueue()
    ended = threading.Event()

    def await_end() -> None:
        for _ in parent:
            continue
        ended.set()
        MONOTONIC.sleep(CLOSING)
        os._exit(1)  # libjack hangs

    threading.Thread(target=send_messages, args=(outward, messages), daemon=True).start()
    threading.Thread(target=await_end, daemon=True).start()
    work(order, messages, ended)
    os._exit(0)  # without the handlers of libjack
