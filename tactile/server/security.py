"""Admission of programs and web pages: no page that was not invited, under whatever name.

A page in a browser can send requests to this machine. It cannot omit `Origin` when it opens a
WebSocket, nor `Sec-Fetch-Site` in a current browser, and it cannot choose `Host`: a name that was
rebound to 127.0.0.1 appears there as itself. Only the server's own page is of the origin that
`Host` names. Programs send no `Origin`; they present a token, if there is one.
"""

import hashlib
import hmac
import json
import logging
import re
from collections.abc import Iterable

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from tactile.messages import Role
from tactile.server.config import ORIGIN, ServerConfig

log = logging.getLogger("tactile.server")

OWN_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})
"""Names of this machine that a `Host` header may always hold."""
ANY = frozenset({"0.0.0.0", "[::]"})
"""Addresses that stand for all addresses of this machine when listening, but name none of them."""
UNINVITED = "Origin is not invited; the server's log says how to invite it"
"""Reason to refuse a page that was not invited."""
NO_FIGURES = 'Authorization: Bearer must hold a token whose roles include "watch"'
"""Reason to refuse a request for metrics."""
MOST_ORIGINS = 100
"""Maximum number of origins that are remembered; each is logged once."""
Headers = Iterable[tuple[bytes, bytes]]
"""Names and values of HTTP headers."""


class Tokens:
    """Tokens that admit clients, and what each allows; none of them can be read back.

    Parameters
    ----------
    tokens : iterable of (bytes, frozenset of Role)
        Tokens with their roles; if there are none, clients need none.
    """

    def __init__(self, tokens: Iterable[tuple[bytes, frozenset[Role]]] = ()) -> None:
        self._digests = [(hashlib.sha256(token).digest(), roles) for token, roles in tokens]

    def __bool__(self) -> bool:
        """Return whether there is any token."""
        return bool(self._digests)

    def roles(self, token: str) -> frozenset[Role] | None:
        """Return what a token allows.

        The time that it takes reveals neither how much of the token is right nor which one it
        resembles.

        Parameters
        ----------
        token : str
            Token that a client presents.

        Returns
        -------
        frozenset of Role or None
            Roles of the token; None if it is wrong.
        """
        digest = hashlib.sha256(token.encode("utf-8", "replace")).digest()
        same = [hmac.compare_digest(digest, known) for known, _ in self._digests]
        return self._digests[same.index(True)][1] if any(same) else None


def host_name(header: str) -> str:
    """Extract the host of a `Host` header.

    Parameters
    ----------
    header : str
        Value of the header.

    Returns
    -------
    str
        Host in lower case, without its port.
    """
    host, colon, port = header.lower().rpartition(":")
    return host if colon and port.isdecimal() and port.isascii() else header.lower()


def refusal(headers: Headers, config: ServerConfig, address: str | None) -> str:
    """Decide whether a request is refused.

    Parameters
    ----------
    headers : iterable of (bytes, bytes)
        Headers of the request, with their names in lower case.
    config : ServerConfig
        Configuration with the origins that are invited.
    address : str or None
        Address of this machine to which the request came; None for a Unix socket.

    Returns
    -------
    str
        Reason of the refusal; empty if the request is admitted.
    """
    values: dict[str, list[str]] = {"host": [], "origin": [], "sec-fetch-site": []}
    for name, value in headers:
        values.get(name.decode("latin-1"), []).append(value.decode("latin-1"))
    hosts = [host_name(host) for host in values["host"]]
    own = {*OWN_NAMES, *(_host_form(host) for host in (config.host, address) if host)}
    if len(hosts) != 1 or hosts[0] not in own - ANY:
        return "Host is not one of this server"
    origins = values["origin"]
    # the server's own page is at the host and port of this request; its name was checked above
    if len(origins) > 1 or not set(origins) <= {
        *config.origins,
        f"http://{values['host'][0].lower()}",
    }:
        return UNINVITED
    if not origins and not set(values["sec-fetch-site"]) <= {"none", "same-origin"}:
        return "Sec-Fetch-Site is another site"
    return ""


def _host_form(host: str) -> str:
    """Return a host in the form that it has in a `Host` header."""
    host = host.removeprefix("::ffff:")
    return f"[{host.lower()}]" if ":" in host else host.lower()


class Door:
    """ASGI middleware that admits requests, or answers 401 or 403 even to a WebSocket.

    Parameters
    ----------
    app : ASGIApp
        Application behind the door.
    config : ServerConfig
        Configuration with the origins that are invited.
    tokens : Tokens
        Tokens, one of which is required for metrics.
    """

    def __init__(self, app: ASGIApp, config: ServerConfig, tokens: Tokens) -> None:
        self._app, self._config, self._tokens = app, config, tokens
        self._logged: set[str] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        reason, status = "", 403
        if scope["type"] in ("http", "websocket"):
            address = scope["server"][0] if scope.get("client") else None  # a Unix socket has none
            reason = refusal(scope["headers"], self._config, address)
            if reason is UNINVITED:
                self._log_origin(scope["headers"])
            if not reason and not self._may_read(scope):
                reason, status = NO_FIGURES, 401
        if not reason:
            await self._app(scope, receive, send)
        else:
            await PlainTextResponse(reason + "\n", status)(scope, receive, send)

    def _may_read(self, scope: Scope) -> bool:
        """Return whether a request is not for metrics, or its token allows reading them.

        A WebSocket presents its token in `ClientHello`.
        """
        if scope["type"] != "http" or scope["path"] != "/metrics":
            return True
        if not self._tokens or not scope.get("client"):
            return True
        header = dict(scope["headers"]).get(b"authorization", b"").decode("latin-1")
        return "watch" in (self._tokens.roles(header.removeprefix("Bearer ").strip()) or ())

    def _log_origin(self, headers: Headers) -> None:
        """Log an origin that is not invited, once, with the setting that would invite it."""
        for name, value in headers:
            origin = value.decode("latin-1")[:256]
            if name != b"origin" or origin in self._logged or len(self._logged) >= MOST_ORIGINS:
                continue
            self._logged.add(origin)
            line = "origins = " + json.dumps([*self._config.origins, origin])
            possible = re.fullmatch(ORIGIN, origin) is not None
            fields = {"origin": origin} | ({"invite": f"[server] {line}"} if possible else {})
            log.warning("a page was refused", extra={"fields": fields})
