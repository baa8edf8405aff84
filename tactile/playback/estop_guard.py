"""E-stop of a device that is driven without a server, by `tactile play` or `tactile check`.

The program holds the latch of the device, as a server would. A thread waits for `tactile estop`,
latches the e-stop and stops the bus, whatever the program does meanwhile. If the program as a whole
hangs, the amplifier's watchdog acts.
"""

import logging
import os
import secrets
import select
import shlex
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from tactile.bus.base import Bus
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusError, InputError
from tactile.estop.latch import UNSAVED, Latch, inherit_estops
from tactile.estop.process import Desk, bind
from tactile.paths import state_folder

log = logging.getLogger("tactile.estop")


@contextmanager
def guarded(bus: Bus, device: str) -> Iterator[None]:
    """Let `tactile estop` stop a bus, and refuse to use it while an e-stop of its device holds.

    A device without any voltage (``sim:``) has no e-stop.

    Parameters
    ----------
    bus : Bus
        Bus of the device, open and idle.
    device : str
        URL of the device, by which `tactile estop` names it.

    Yields
    ------
    None
        Control, while the e-stop is active.

    Raises
    ------
    BusError
        If an e-stop holds or came while the bus was in use, or if another program has the latch.
    InputError
        If the file of the latch cannot be opened.

    Examples
    --------
    >>> import tactile
    >>> display = tactile.load_display("reference-24")
    >>> with tactile.open_bus("mock:", display) as bus, tactile.guarded(bus, "mock:"):
    ...     bus.start()
    ...     bus.stop()
    """
    if device.startswith(UNSAVED):
        yield
        return
    with _latch_of(bus, device) as latch:
        _refuse_where_held(latch, device)
        try:
            with _listening(bus, latch, device):
                yield
        except BusError as error:
            _latch_estop_of_amplifier(latch, bus)
            _refuse_where_held(latch, device, error)
            raise
        _refuse_where_held(latch, device)  # the caller may not have noticed it


def clear_device(
    device: str, display: Display, choose: Callable[[int, str], int], *, accept_unsafe_hold: bool
) -> int:
    """End the e-stop of a device that no server has, once a person has seen that it is safe.

    Parameters
    ----------
    device : str
        URL of the device.
    display : Display
        Display that is connected to it.
    choose : callable
        Function that is given the number of the e-stop that holds and its reason, and returns the
        number of the e-stop to end.
    accept_unsafe_hold : bool
        As in `open_bus`.

    Returns
    -------
    int
        Number of the e-stop that was ended, 0 if none held.

    Raises
    ------
    TactileError
        If the device cannot be opened, an e-stop other than the chosen one holds, or the amplifier
        refuses to clear it.
    """
    with (
        open_bus(device, display, accept_unsafe_hold=accept_unsafe_hold) as bus,
        _latch_of(bus, device) as latch,
    ):
        if not latch.holds:
            return 0
        estops = bus.estops
        chosen = choose(latch.holds, latch.reason)
        if bus.estops != estops:
            latch.trip(_reason(bus))
        if chosen != latch.holds:
            raise InputError(
                f"clear: e-stop {latch.holds} of {device} holds, not {chosen}: {latch.reason}"
            )
        bus.clear()
        latch.clear(chosen)
        latch.save()
        return chosen


@contextmanager
def _latch_of(bus: Bus, device: str) -> Iterator[Latch]:
    """Provide the latch of a device, tripped if its amplifier is e-stopped."""
    folder = state_folder()
    with closing(Latch.open(device, folder)) as latch:
        inherit_estops({device: latch}, [device], folder)
        _latch_estop_of_amplifier(latch, bus)
        yield latch


def _latch_estop_of_amplifier(latch: Latch, bus: Bus) -> None:
    """Trip the latch for an e-stop that only the amplifier knows of."""
    if bus.state == "estopped" and not latch.holds:
        latch.trip(_reason(bus))
        latch.save()


def _reason(bus: Bus) -> str:
    """Return one line on why the amplifier is e-stopped."""
    return bus.status.detail or "by the amplifier"


def _refuse_where_held(latch: Latch, device: str, error: BusError | None = None) -> None:
    """Raise BusError if an e-stop holds."""
    if latch.holds:
        raise BusError(
            f"{device}: e-stop {latch.holds} holds, {latch.reason}; "
            f"once it is safe, tactile clear --device {shlex.quote(device)} ends it"
        ) from error


@contextmanager
def _listening(bus: Bus, latch: Latch, device: str) -> Iterator[None]:
    """Serve requests of `tactile estop` in a thread while the context is open."""
    try:
        link, address = bind(f"{os.getpid()}-{secrets.token_hex(4)}")
    except OSError as error:
        log.warning("tactile estop does not reach this program: %s", error)
        yield
        return
    waking, woken = socket.socketpair()
    desk = Desk({device: latch})

    def listen() -> None:
        while woken not in select.select([link, woken], [], [])[0]:
            desk.serve(link)
            if latch.holds:
                try:
                    bus.estop()
                    latch.save()
                except OSError as error:  # a BusError is one
                    log.error("e-stop of %s: %s", device, error)

    thread = threading.Thread(target=listen, name="tactile-estop", daemon=True)
    thread.start()
    try:
        yield
    finally:
        waking.send(b"\0")
        thread.join()
        Path(address).unlink(missing_ok=True)
        for endpoint in (link, waking, woken):
            endpoint.close()
