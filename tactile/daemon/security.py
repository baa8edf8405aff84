"""Who may speak to the daemon: no web page, under whatever name, that was not invited.

A page in a browser can send requests to this machine. It cannot leave out `Origin` where it opens a
WebSocket, nor `Sec-Fetch-Site` in a current browser, nor choose `Host`: a name that was rebound to
127.0.0.1 stands there as itself. Programs send no `Origin`; they say the token, where there is one.
"""

import hashlib
import hmac
from collections.abc import Iterable
from dataclasses import dataclass, field

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from tactile.daemon.config import ServerConfig

OWN_NAMES = frozenset({"localhost", "127.0.0.1", "[::1]"})
ANY = frozenset({"0.0.0.0", "[::]"})
"""All addresses of this machine, to listen at; a name of none."""
Headers = Iterable[tuple[bytes, bytes]]


def is_token(said: str, token: bytes | None) -> bool:
    """Return whether what was said is the token, in a time that does not tell how much of it is."""
    if token is None:
        return True
    digests = (hashlib.sha256(t).digest() for t in (said.encode("utf-8", "replace"), token))
    return hmac.compare_digest(*digests)


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
        return "Origin is not invited"
    if not origins and not set(found["sec-fetch-site"]) <= {"none", "same-origin"}:
        return "Sec-Fetch-Site is another site"
    return ""


def _written(host: str) -> str:
    """Return a host as it stands in `Host`."""
    host = host.removeprefix("::ffff:")
    return f"[{host.lower()}]" if ":" in host else host.lower()


@dataclass
class Door:
    """Lets a request in to the application, or answers 403; WebSockets are refused unopened."""

    app: ASGIApp
    config: ServerConfig
    token: bytes | None = field(repr=False)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        reason, status = "", 403
        if scope["type"] in ("http", "websocket"):
            address = scope["server"][0] if scope.get("server") else None
            reason = refusal(scope["headers"], self.config, address)
            if not reason and not self._knows(scope):
                reason, status = "Authorization: Bearer must hold the token", 401
        if not reason:
            await self.app(scope, receive, send)
        else:
            await PlainTextResponse(reason + "\n", status)(scope, receive, send)

    def _knows(self, scope: Scope) -> bool:
        """Return whether who asks for figures knows the token; a WebSocket's `Hello` has it."""
        if scope["type"] != "http" or scope["path"] != "/metrics":
            return True
        said = dict(scope["headers"]).get(b"authorization", b"").decode("latin-1")
        return is_token(said.removeprefix("Bearer ").strip(), self.token)
