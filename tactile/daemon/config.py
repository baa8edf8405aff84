"""What `tactile serve` is told in a file: where it listens, how it logs, which displays it plays.

Paths are relative to the file. Without one there is a simulated display on the loopback interface.
"""

import ipaddress
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct, structs

from tactile import files
from tactile.daemon.messages import Fraction, Name
from tactile.errors import InputError

Port = Annotated[int, Meta(ge=0, le=65535)]
Origin = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9+.-]*://[^\s/*,]+$", max_length=256)]
SHORTEST_TOKEN, LONGEST_TOKEN = 16, 256
"""Characters; what `Hello` can hold, and what nobody guesses at a few hundred attempts a second."""


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

    ``token_file`` holds what `Hello` must say; it is needed where others than this machine can
    connect. ``origins`` are the pages, as "https://app.example", whose scripts may connect.
    """

    host: Annotated[str, Meta(min_length=1, max_length=253)] = "127.0.0.1"
    port: Port = 7411
    token_file: str | None = None
    origins: tuple[Origin, ...] = ()
    most_clients: Annotated[int, Meta(ge=1, le=1000)] = 64
    messages_per_second: Annotated[int, Meta(ge=10, le=100_000)] = 2000

    def __post_init__(self) -> None:
        if not self.token_file and not is_loopback(self.host):
            raise ValueError(
                f"token_file = {self.token_file or ''!r}: must be given, as others than this "
                f"machine can connect to host {self.host!r}"
            )


class OscConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """OSC over UDP, on the loopback interface only; 0 is off."""

    port: Port = 7412


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


class Config(File, frozen=True, kw_only=True):
    """A configuration, its paths absolute, and the file that it was read from."""

    path: Path | None = None


def load_config(path: Path | None) -> Config:
    """Return the configuration of a file, or the one without.

    Raises
    ------
    InputError
        Where it cannot be read or holds what does not fit: file, field, value, what is allowed.
    """
    if path is None:
        return Config()
    read = files.read(path, File)
    folder = path.absolute().parent
    config = Config(
        server=structs.replace(read.server, token_file=_beside(folder, read.server.token_file)),
        osc=read.osc,
        log=structs.replace(read.log, file=_beside(folder, read.log.file)),
        display=tuple(
            structs.replace(display, display=_display(folder, display.display))
            for display in read.display
        ),
        path=path.absolute(),
    )
    read_token(config.server)
    return config


def _beside(folder: Path, name: str | None) -> str | None:
    return None if not name else str(folder / name)


def _display(folder: Path, name: str) -> str:
    """Return the name of a shipped display as it is, of a file as its path."""
    named = Path(name).suffix != ".toml" and Path(name).parent == Path()
    return name if named else str(folder / name)


def read_token(config: ServerConfig) -> bytes | None:
    """Return the token that clients must say, if any.

    Raises
    ------
    InputError
        Where its file cannot be read, or holds none that could be said or that could be guessed.
    """
    if config.token_file is None:
        return None
    field = f"server.token_file = {config.token_file!r}"
    try:
        token = Path(config.token_file).read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{field}: cannot be read: {error}") from error
    if not SHORTEST_TOKEN <= len(token) <= LONGEST_TOKEN:
        raise InputError(
            f"{field}: holds {len(token)} characters, must be {SHORTEST_TOKEN} … {LONGEST_TOKEN}"
        )
    return token.encode()
