"""Reasons why an amplifier does not run, each as one line for a person."""

from collections.abc import Sequence

from firmware_protocol.messages import WATCHDOG_MS, EstopReason, Fault, State
from tactile.bus.link.peer import Peer

INPUT_OPEN = "e-stop input open: release the button, then clear"
"""Advice while an e-stop input is open."""
STOPPED_AGAIN = "stopped once more in the meantime: see why, then clear again"
"""Advice where an e-stop or a fault has come since a clear began."""


def why_stopped(peer: Peer) -> str:
    """Return why an amplifier does not run.

    Parameters
    ----------
    peer : Peer
        Amplifier that is in another state than RUNNING.

    Returns
    -------
    str
        Reason with the node of the amplifier, one line.
    """
    node, state, status = peer.host.node, peer.state, peer.host.status
    if state is State.FAULT:
        fault = 0 if status is None else status.fault
        name = Fault(fault).name.lower() if fault and fault in set(Fault) else "of its hardware"
        return f"node {node} reports a fault: {name}"
    if state is State.ESTOP:
        by_input = status is not None and status.estop_reason == EstopReason.INPUT
        return f"node {node} was e-stopped by {'its e-stop input' if by_input else 'another'}"
    if state in (State.SAFE, State.RAMPDOWN):  # the host has not sent what else ends in a ramp
        return f"node {node} went to 0 V: no heartbeat reached it for {WATCHDOG_MS} ms"
    if state is State.ARMED:
        return f"node {node} stopped: a STOP of this session reached it late"
    return f"node {node} is {state.name if state is not None else 'silent'}: it was reset"


def open_input(peers: Sequence[Peer], now: float) -> str:
    """Return which e-stop input is open, and ask for STATUS as long as one is.

    Parameters
    ----------
    peers : sequence of Peer
        Amplifiers of the session.
    now : float
        Host time [s].

    Returns
    -------
    str
        Node of the first amplifier whose input is open, with advice; empty if there is none.
    """
    stopped = [peer for peer in peers if peer.input_open]
    for peer in stopped:
        peer.watch(now)
    return f"node {stopped[0].host.node}: {INPUT_OPEN}" if stopped else ""
