"""Who may speak to the daemon: no web page, under whatever name, that was not invited.

A page in a browser can send requests to this machine. It cannot leave out `Origin` where it opens a
WebSocket, nor `Sec-Fetch-Site` in a current browser, nor choose `Host`: a name that was rebound to
127.0.0.1 stands there as itself. Programs send no `Origin`; they say the token, where there is one.
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
ANY = frozenset({"0.0.0.0", "[::]"})
"""All addresses of this machine, to listen at; a name of none."""
UNINVITED = "Origin is not invited; the daemon's log says how to invite it"
NO_FIGURES = 'Authorization: Bearer must hold a token whose roles include "watch"'
MOST_ORIGINS = 100
"""That are remembered, each of which is logged once."""
Headers = Iterable[tuple[bytes, bytes]]


class Tokens:
    """All tokens that let in, and what each allows; none of them can be read back.

    Parameters
    ----------
    tokens : with their roles; where there are none, none is asked for
    """

    def __init__(self, tokens: Iterable[tuple[bytes, frozenset[Role]]] = ()) -> None:
        self._digests = [(hashlib.sha256(token).digest(), roles) for token, roles in tokens]

    def __bool__(self) -> bool:
        """Return whether there is any."""
        return bool(self._digests)

    def roles(self, said: str) -> frozenset[Role] | None:
        """Return what a token allows, None for a wrong one.

        The time does not tell how much of it is right, nor which of the tokens it is like.
        """
        digest = hashlib.sha256(said.encode("utf-8", "replace")).digest()
        same = [hmac.compare_digest(digest, one) for one, _ in self._digests]
        return self._digests[same.index(True)][1] if any(same) else None


def host_name(header: str) -> str:
    """Return the host of a `Host` header in lower case, without its port."""
    host, colon, port = header.lower().rpartition(":")
    return host if colon and port.isdecimal() and port.isascii() else header.lower()


def refusal(headers: Headers, config: ServerConfig, address: str | None) -> str:
    """Return why a request is refused, or "".

    Parameters
    ----------
    headers : names in lower case
    config : who is invited
    address : of this machine, to which the request came
    """
    found: dict[str, list[str]] = {"host": [], "origin": [], "sec-fetch-site": []}
    for name, value in headers:
        found.get(name.decode("latin-1"), []).append(value.decode("latin-1"))
    hosts = [host_name(host) for host in found["host"]]
    own = {*OWN_NAMES, *(_written(host) for host in (config.host, address) if host)}
    if len(hosts) != 1 or hosts[0] not in own - ANY:
        return "Host is not one of this server"
    origins = found["origin"]
    if len(origins) > 1 or not set(origins) <= set(config.origins):
        return UNINVITED
    if not origins and not set(found["sec-fetch-site"]) <= {"none", "same-origin"}:
        return "Sec-Fetch-Site is another site"
    return ""


def _written(host: str) -> str:
    """Return a host as it stands in `Host`."""
    host = host.removeprefix("::ffff:")
    return f"[{host.lower()}]" if ":" in host else host.lower()


class Door:
    """Lets a request in to the application, or answers 403; WebSockets are refused unopened.

    Parameters
    ----------
    app : what is behind it
    config : who is invited
    tokens : one of which must be said for figures
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
            if not reason and not self._knows(scope):
                reason, status = NO_FIGURES, 401
        if not reason:
            await self._app(scope, receive, send)
        else:
            await PlainTextResponse(reason + "\n", status)(scope, receive, send)

    def _knows(self, scope: Scope) -> bool:
        """Return whether who asks for figures may watch; a WebSocket's `Hello` has its token."""
        if scope["type"] != "http" or scope["path"] != "/metrics":
            return True
        if not self._tokens or not scope.get("client"):
            return True
        said = dict(scope["headers"]).get(b"authorization", b"").decode("latin-1")
        return "watch" in (self._tokens.roles(said.removeprefix("Bearer ").strip()) or ())

    def _log_origin(self, headers: Headers) -> None:
        """Log an origin that is not invited, once, with the line that would invite it."""
        for name, value in headers:
            origin = value.decode("latin-1")[:256]
            if name != b"origin" or origin in self._logged or len(self._logged) >= MOST_ORIGINS:
                continue
            self._logged.add(origin)
            line = "origins = " + json.dumps([*self._config.origins, origin])
            possible = re.fullmatch(ORIGIN, origin) is not None
            fields = {"origin": origin} | ({"invite": f"[server] {line}"} if possible else {})
            log.warning("a page was refused", extra={"fields": fields})
