"""User at the other end of a local connection, as the Linux kernel knows it.

For a Unix socket, the kernel reports the user itself. For TCP, the user is in the table of all
connections, in the row whose own end is the peer's.
"""

import asyncio
import os
import socket
import struct
import sys
from pathlib import Path
from typing import NamedTuple

from tactile.messages import ALL_ROLES, Role
from tactile.server.config import is_loopback

TABLES = {socket.AF_INET: Path("/proc/self/net/tcp"), socket.AF_INET6: Path("/proc/self/net/tcp6")}
"""Tables of TCP connections by address family."""
ESTABLISHED = b"01"
"""State of a connection whose two ends are open; a closed end has no user and reports 0."""
OTHERS: frozenset[Role] = frozenset({"watch", "stop"})
"""Roles of another user who presents no token."""


class PeerCredentials(NamedTuple):
    """User at the other end of a connection.

    Attributes
    ----------
    user : int
        User id.
    process : int or None
        Process id, if it is known.
    """

    user: int
    process: int | None = None


def is_local(connection: socket.socket) -> bool:
    """Check whether a connection is a Unix socket.

    Parameters
    ----------
    connection : socket
        Any stream socket.

    Returns
    -------
    bool
        Whether its address family is AF_UNIX.
    """
    return connection.family == getattr(socket, "AF_UNIX", None)


def local_peer(connection: socket.socket) -> PeerCredentials:
    """Return who connected to a Unix socket.

    Parameters
    ----------
    connection : socket
        Connected Unix socket.

    Returns
    -------
    PeerCredentials
        User and process.

    Raises
    ------
    OSError
        If the kernel does not report them.
    """
    layout = struct.Struct("3i")
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, layout.size)
    process, user, _ = layout.unpack(data)
    return PeerCredentials(user, process)


def user_in(table: bytes, peer: tuple[str, int], own: tuple[str, int]) -> int | None:
    """Find the user of the peer's end of a TCP connection.

    Parameters
    ----------
    table : bytes
        Contents of /proc/self/net/tcp or tcp6.
    peer, own : tuple of str and int
        Address and port of each end.

    Returns
    -------
    int or None
        User id; None if the connection is not in the table or not established.
    """
    ends = b" %s %s " % (_kernel_form(*peer), _kernel_form(*own))
    at = table.find(ends)
    if at < 0:
        return None
    fields = table[at + len(ends) : table.find(b"\n", at)].split()
    state, user, inode = fields[0], int(fields[4]), int(fields[6])
    return user if state == ESTABLISHED and inode else None


def _kernel_form(address: str, port: int) -> bytes:
    """Return an end as the kernel writes it: words in the byte order of the machine."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    data = socket.inet_pton(family, address.partition("%")[0])
    words = struct.unpack(f"={len(data) // 4}I", data)
    return b"".join(b"%08X" % word for word in words) + b":%04X" % port


def tcp_peer(connection: socket.socket) -> PeerCredentials | None:
    """Return who is at the other end of a TCP connection of this machine.

    Parameters
    ----------
    connection : socket
        Connected TCP socket.

    Returns
    -------
    PeerCredentials or None
        The user; None if it cannot be determined.
    """
    peer, own = connection.getpeername()[:2], connection.getsockname()[:2]
    try:
        user = user_in(TABLES[connection.family].read_bytes(), peer, own)
    except (OSError, ValueError, IndexError):
        return None
    return None if user is None else PeerCredentials(user)


def roles_of_user(peer: PeerCredentials | None) -> frozenset[Role]:
    """Return what a user may do without a token.

    Parameters
    ----------
    peer : PeerCredentials or None
        The user; None if it could not be determined.

    Returns
    -------
    frozenset of Role
        All roles for root and for the user of the server, `OTHERS` for everybody else.
    """
    own = peer is not None and peer.user in (0, os.geteuid())
    return ALL_ROLES if own else OTHERS


async def judge(connection: socket.socket) -> tuple[frozenset[Role], PeerCredentials | None]:
    """Return what a peer may do that presents no token, where none is configured, and who it is.

    Parameters
    ----------
    connection : socket
        Connection of the peer.

    Returns
    -------
    tuple of frozenset of Role and PeerCredentials or None
        Roles, and the user if it is known.
    """
    if not sys.platform.startswith("linux"):
        return ALL_ROLES, None
    if is_local(connection):  # the mode of the socket decided who may open it
        return ALL_ROLES, local_peer(connection)
    if not is_loopback(connection.getpeername()[0]):
        return OTHERS, None
    peer = await asyncio.to_thread(tcp_peer, connection)
    return roles_of_user(peer), peer
