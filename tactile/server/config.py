"""What `tactile serve` is told in a file: where it listens, how it logs, which displays it plays.

Paths are relative to the file. Without one there is a simulated display on the loopback interface.
"""

import ipaddress
import os
import stat
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct, structs

from tactile import files
from tactile.display.display import Display, load_display
from tactile.errors import InputError
from tactile.messages import ALL_ROLES, Fraction, Name, Role

Port = Annotated[int, Meta(ge=0, le=65535)]
ORIGIN = r"^[a-z][a-z0-9+.-]*://[^\s/*,]+$"
Origin = Annotated[str, Meta(pattern=ORIGIN, max_length=256)]
SHORTEST_TOKEN, LONGEST_TOKEN = 16, 256
"""Characters; what `Hello` can hold, and what nobody guesses at a few hundred attempts a second."""
MOST_TOKENS = 32


def is_loopback(host: str) -> bool:
    """Return whether a host names this machine and nothing else can reach it."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class ServerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where clients connect, and who may.

    ``token_file`` holds a token that allows everything; it, or a `TokenConfig`, is needed where
    others than this machine can connect. ``origins`` are the pages, as "https://app.example", whose
    scripts may connect. ``socket`` is a Unix socket beside TCP, on Linux: None is the usual place,
    "" is none; who may open it may do everything. That is this user, and those of ``socket_group``.
    """

    host: Annotated[str, Meta(min_length=1, max_length=253)] = "127.0.0.1"
    port: Port = 7411
    socket: str | None = None
    socket_group: str | None = None
    token_file: str | None = None
    origins: tuple[Origin, ...] = ()
    most_clients: Annotated[int, Meta(ge=1, le=1000)] = 64
    messages_per_second: Annotated[int, Meta(ge=10, le=100_000)] = 2000


class TokenConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A token that clients may say, and what it allows.

    It stands in a ``file``, or is a ``credential`` that systemd hands over under that name.
    """

    file: str | None = None
    credential: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]+$", max_length=255)] | None = None
    roles: tuple[Role, ...] = tuple(sorted(ALL_ROLES))

    def __post_init__(self) -> None:
        if bool(self.file) == bool(self.credential):
            raise ValueError("file, credential: exactly one of them must be given")


class OscConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """OSC over UDP, on the loopback interface only, where any program may send; 0 is off."""

    port: Port = 0


class LogConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is logged, as lines of text or of JSON, to standard error or a file."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["text", "json"] = "text"
    file: str | None = None


class DisplayConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A display that is played: its name for clients, its file, its device.

    ``voltage_limit_v`` and ``gain`` may only lower what the display's file allows.
    ``worn`` says that the finger stays on it while it touches nothing, so that waveforms play then
    as well; else they play 34 dB down, since a bimorph in air rings up by as much.
    ``arm_on_start`` arms it unasked, ``rearm`` again after its link or playback was lost.
    """

    name: Name = "default"
    display: Annotated[str, Meta(min_length=1)] = "reference-24"
    device: Annotated[str, Meta(min_length=1)] = "sim:"
    sample_rate_hz: Annotated[float, Meta(ge=2500, le=200_000)] | None = None
    voltage_limit_v: Annotated[float, Meta(gt=0, le=1000)] | None = None
    gain: Fraction = 1.0
    arm_on_start: bool = False
    rearm: bool = False
    worn: bool = False
    accept_unsafe_hold: bool = False


class File(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The tables of a configuration file."""

    server: ServerConfig = ServerConfig()
    token: Annotated[tuple[TokenConfig, ...], Meta(max_length=MOST_TOKENS)] = ()
    osc: OscConfig = OscConfig()
    log: LogConfig = LogConfig()
    display: tuple[DisplayConfig, ...] = (DisplayConfig(),)

    def __post_init__(self) -> None:
        names = [display.name for display in self.display]
        if not names:
            raise ValueError("display: at least one must be given")
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f"display[{i}].name = {name!r}: is taken by another display")
        server = self.server
        if not server.token_file and not self.token and not is_loopback(server.host):
            raise ValueError(
                f"server.token_file = {server.token_file or ''!r}: must be given, or a [[token]], "
                f"as others than this machine can connect to host {server.host!r}"
            )


class DaemonConfig(File, frozen=True, kw_only=True):
    """A configuration, its paths absolute, and the file that it was read from."""

    path: Path | None = None


def load_config(path: Path | None) -> DaemonConfig:
    """Return the configuration of a file, or the one without.

    Raises
    ------
    InputError
        Where it cannot be read or holds what does not fit: file, field, value, what is allowed.
    """
    if path is None:
        return DaemonConfig()
    read = files.read(path, File)
    folder = path.absolute().parent
    config = DaemonConfig(
        server=structs.replace(
            read.server,
            token_file=_beside(folder, read.server.token_file),
            socket=_beside(folder, read.server.socket)
            if read.server.socket
            else read.server.socket,
        ),
        token=tuple(
            structs.replace(token, file=_beside(folder, token.file)) for token in read.token
        ),
        osc=read.osc,
        log=structs.replace(read.log, file=_beside(folder, read.log.file)),
        display=tuple(
            structs.replace(display, display=_display(folder, display.display))
            for display in read.display
        ),
        path=path.absolute(),
    )
    read_tokens(config)
    return config


def _beside(folder: Path, name: str | None) -> str | None:
    return str(folder / name) if name else name


def _display(folder: Path, name: str) -> str:
    """Return the name of a shipped display as it is, of a file as its path."""
    named = Path(name).suffix != ".toml" and Path(name).parent == Path()
    return name if named else str(folder / name)


def load_configured(config: DisplayConfig) -> Display:
    """Return a display as the configuration allows it.

    Raises
    ------
    InputError
        For a file that cannot be used, or a limit above the file's.
    """
    display = load_display(config.display)
    if config.voltage_limit_v is None:
        return display
    if config.voltage_limit_v > display.limits.voltage:
        raise InputError(
            f"display {config.name}: voltage_limit_v = {config.voltage_limit_v:g} is above the "
            f"display file's {display.limits.voltage:g}; it may only be lower"
        )
    limits = replace(display.limits, voltage=config.voltage_limit_v)
    return replace(display, limits=limits)


def read_tokens(config: DaemonConfig) -> list[tuple[bytes, frozenset[Role]]]:
    """Return the tokens that clients may say, and what each allows.

    Raises
    ------
    InputError
        Where one cannot be read, others can read it, it could not be said or could be guessed.
    """
    found = []
    if config.server.token_file:
        name = config.server.token_file
        found.append((_secret(f"server.token_file = {name!r}", Path(name)), ALL_ROLES))
    for i, token in enumerate(config.token):
        if token.file:
            content = _secret(f"token[{i}].file = {token.file!r}", Path(token.file))
        else:
            content = _credential(f"token[{i}].credential", str(token.credential))
        found.append((content, frozenset(token.roles)))
    return found


def _secret(field: str, path: Path) -> bytes:
    """Return the token of a file that nobody but its owner may use."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise InputError(f"{field}: cannot be read: {error.strerror}") from error
    if os.name == "posix" and mode & 0o077:
        raise InputError(f"{field}: has mode {mode:04o}, so that others can use it: chmod 600")
    return _token(field, path)


def _credential(field: str, name: str) -> bytes:
    """Return a token that systemd hands over; it sees to it that nobody else can read it."""
    folder = os.environ.get("CREDENTIALS_DIRECTORY", "")
    if not folder:
        raise InputError(
            f"{field} = {name!r}: there are no credentials; systemd gives them to a unit with "
            f"LoadCredential={name}:FILE"
        )
    return _token(f"{field} = {name!r}", Path(folder) / name)


def _token(field: str, path: Path) -> bytes:
    try:
        token = files.read_text(path).strip()
    except InputError as error:
        raise InputError(f"{field}: {error}") from error
    if not SHORTEST_TOKEN <= len(token) <= LONGEST_TOKEN:
        raise InputError(
            f"{field}: holds {len(token)} characters, must be {SHORTEST_TOKEN} … {LONGEST_TOKEN}"
        )
    return token.encode()
