"""The address of a server and the secret that it asks for, as given or from the environment."""

import os
import socket
from urllib.parse import urlsplit

from tactile import paths
from tactile.errors import InputError
from tactile.messages import PATH

PORT = 7411
"""Port that a server listens on by default."""
EXAMPLE_URL = f"ws://127.0.0.1:{PORT}{PATH}"
"""Address of a server on this machine, which messages show as an example."""
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})
"""Names of this machine on its loopback interface."""
UNIX = "ws+unix://"
"""Prefix of the address of a Unix socket; its path follows."""


def default_url() -> str:
    """Return the address of the server on this machine.

    Returns
    -------
    str
        Address of its Unix socket if it has one, otherwise `EXAMPLE_URL`.
    """
    sockets = paths.find_sockets()
    return f"{UNIX}{sockets[0]}" if sockets else EXAMPLE_URL


def endpoint(url: str | None) -> str:
    """Return the complete address of a server.

    Parameters
    ----------
    url : str, optional
        Address as the program gives it; by default that of ``TACTILE_URL`` in the environment,
        otherwise `default_url`.

    Returns
    -------
    str
        Address with port and path.

    Raises
    ------
    InputError
        If it is not the address of a WebSocket.
    """
    url = url or os.environ.get("TACTILE_URL") or default_url()
    if not isinstance(url, str):
        raise InputError(f"url {url!r}: must be a string such as {EXAMPLE_URL!r}")
    if url.startswith(UNIX):
        if not hasattr(socket, "AF_UNIX") or not url.startswith(f"{UNIX}/"):
            raise InputError(f"url {url!r}: must be {UNIX} and an absolute path, and needs Linux")
        return url
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise InputError(f"url {url!r}: {error}") from None
    if parts.scheme not in ("ws", "wss") or not parts.hostname:
        raise InputError(f"url {url!r}: must have the form {EXAMPLE_URL}")
    where = parts.netloc if port or parts.scheme == "wss" else f"{parts.netloc}:{PORT}"
    path = parts.path if parts.path.strip("/") else PATH
    return parts._replace(netloc=where, path=path).geturl()


def is_local(url: str) -> bool:
    """Return whether a server is on this machine, as far as its address says.

    Parameters
    ----------
    url : str
        Address of the server.

    Returns
    -------
    bool
        Whether it is that of a Unix socket or of the loopback interface.
    """
    return url.startswith(UNIX) or urlsplit(url).hostname in LOOPBACK


def secret(token: str | None) -> str:
    """Return the token that the server asks for.

    Parameters
    ----------
    token : str, optional
        Token as the program gives it; by default that of ``TACTILE_TOKEN`` in the environment.

    Returns
    -------
    str
        Token, empty if there is none.
    """
    return token if token is not None else os.environ.get("TACTILE_TOKEN", "")
