"""Which user a connection of this machine comes from, as the kernel knows it, on Linux.

Over a Unix socket the kernel says so itself. Over TCP the user stands in the table of all
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
ESTABLISHED = b"01"
"""State of a connection whose both ends are open; a closed end has no user and says 0."""
OTHERS: frozenset[Role] = frozenset({"watch", "stop"})
"""Of another user, who says no token."""


class PeerCredentials(NamedTuple):
    """Who is at the other end: user and, where it is known, process."""

    user: int
    process: int | None = None


def is_local(connection: socket.socket) -> bool:
    """Return whether it is a Unix socket."""
    return connection.family == getattr(socket, "AF_UNIX", None)


def local_peer(connection: socket.socket) -> PeerCredentials:
    """Return who connected to a Unix socket.

    Raises
    ------
    OSError
        Where the kernel does not say.
    """
    layout = struct.Struct("3i")
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, layout.size)
    process, user, _ = layout.unpack(data)
    return PeerCredentials(user, process)


def user_in(table: bytes, peer: tuple[str, int], own: tuple[str, int]) -> int | None:
    """Return the user of the peer's end of a TCP connection, or None where it is not there.

    Parameters
    ----------
    table : as of /proc/self/net/tcp or tcp6
    peer, own : address and port of each end
    """
    ends = b" %s %s " % (_written(*peer), _written(*own))
    at = table.find(ends)
    if at < 0:
        return None
    fields = table[at + len(ends) : table.find(b"\n", at)].split()
    state, user, inode = fields[0], int(fields[4]), int(fields[6])
    return user if state == ESTABLISHED and inode else None


def _written(address: str, port: int) -> bytes:
    """Return an end as the kernel writes it: words in the byte order of the machine."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    data = socket.inet_pton(family, address.partition("%")[0])
    words = struct.unpack(f"={len(data) // 4}I", data)
    return b"".join(b"%08X" % word for word in words) + b":%04X" % port


def tcp_peer(connection: socket.socket) -> PeerCredentials | None:
    """Return who is at the other end of a TCP connection of this machine, if it can be told."""
    peer, own = connection.getpeername()[:2], connection.getsockname()[:2]
    try:
        user = user_in(TABLES[connection.family].read_bytes(), peer, own)
    except (OSError, ValueError, IndexError):
        return None
    return None if user is None else PeerCredentials(user)


def roles_of_user(peer: PeerCredentials | None) -> frozenset[Role]:
    """Return what a user may do without a token, None being one that could not be told."""
    own = peer is not None and peer.user in (0, os.geteuid())
    return ALL_ROLES if own else OTHERS


async def judge(connection: socket.socket) -> tuple[frozenset[Role], PeerCredentials | None]:
    """Return what a peer may do that says no token where none is configured, and who it is."""
    if not sys.platform.startswith("linux"):
        return ALL_ROLES, None
    if is_local(connection):  # who may open it was decided by its mode
        return ALL_ROLES, local_peer(connection)
    if not is_loopback(connection.getpeername()[0]):
        return OTHERS, None
    peer = await asyncio.to_thread(tcp_peer, connection)
    return roles_of_user(peer), peer
