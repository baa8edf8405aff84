"""Configuration file of `tactile serve`: listening, logging, and the displays that are played.

Paths are relative to the file. Without a file, there is a simulated display on the loopback
interface.
"""

import ipaddress
import os
import stat
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct, structs

from tactile import files
from tactile.display.display import Display, load_with_source
from tactile.errors import InputError
from tactile.messages import ALL_ROLES, Fraction, Name, Role
from tactile.playback.finger_following import default_calibration

Port = Annotated[int, Meta(ge=0, le=65535)]
"""TCP or UDP port; 0 means any free TCP port."""
ORIGIN = r"^[a-z][a-z0-9+.-]*://[^\s/*,]+$"
"""Pattern of the origin of a web page."""
Origin = Annotated[str, Meta(pattern=ORIGIN, max_length=256)]
"""Origin of a web page, such as "https://app.example"."""
SHORTEST_TOKEN, LONGEST_TOKEN = 16, 256
"""Shortest and longest token [characters]: what nobody guesses at a few hundred attempts per
second, and what `ClientHello` can hold."""
MOST_TOKENS = 32
"""Maximum number of ``[[token]]`` tables."""


def is_loopback(host: str) -> bool:
    """Check whether a host names this machine in such a way that no other machine can reach it.

    Parameters
    ----------
    host : str
        Host name or address.

    Returns
    -------
    bool
        Whether it is "localhost" or a loopback address.
    """
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class ServerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of the server: where clients connect, and which of them may.

    Attributes
    ----------
    host : str
        Host name or address to listen at.
    port : int
        TCP port; 0 means any free one.
    socket : str or None
        Path of a Unix socket besides TCP, on Linux. None means the usual place, "" none. Who may
        open it may do everything: this user, and the members of ``socket_group``.
    socket_group : str or None
        Group that may open the Unix socket.
    token_file : str or None
        File with a token that allows everything. It or a `TokenConfig` is required if other
        machines can connect.
    origins : tuple of str
        Origins of the web pages whose scripts may connect, such as "https://app.example".
    most_clients : int
        Maximum number of clients.
    messages_per_second : int
        Maximum rate of messages of each client [1/s].
    effects : str or None
        Folder with the effects that clients play by name, such as ``tap.toml`` or ``tap.ahap``.
    """

    host: Annotated[str, Meta(min_length=1, max_length=253)] = "127.0.0.1"
    port: Port = 7411
    socket: str | None = None
    socket_group: str | None = None
    token_file: str | None = None
    origins: tuple[Origin, ...] = ()
    most_clients: Annotated[int, Meta(ge=1, le=1000)] = 64
    messages_per_second: Annotated[int, Meta(ge=10, le=100_000)] = 2000
    effects: str | None = None


class TokenConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Token that clients may present, and what it allows.

    Exactly one of ``file`` and ``credential`` is given.

    Attributes
    ----------
    file : str or None
        File with the token.
    credential : str or None
        Name under which systemd passes the token to the server.
    roles : tuple of Role
        What the token allows; by default everything.
    """

    file: str | None = None
    credential: Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]+$", max_length=255)] | None = None
    roles: tuple[Role, ...] = tuple(sorted(ALL_ROLES))

    def __post_init__(self) -> None:
        if bool(self.file) == bool(self.credential):
            raise ValueError("file, credential: exactly one of them must be given")


class OscConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """OSC over UDP, on the loopback interface only, where any program may send.

    Attributes
    ----------
    port : int
        UDP port; 0 disables OSC.
    """

    port: Port = 0


class LogConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Configuration of logging.

    Attributes
    ----------
    level : str
        Lowest level that is logged.
    format : str
        "text" or "json", one line per record either way.
    file : str or None
        File to append to; standard error if there is none.
    """

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["text", "json"] = "text"
    file: str | None = None


class RecordConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Recording of sessions.

    Attributes
    ----------
    folder : str or None
        Folder that receives a folder for each display and each start of its playback; nothing is
        recorded if there is none.
    """

    folder: Annotated[str, Meta(min_length=1)] | None = None


class FingerConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Whether playback follows the finger.

    Attributes
    ----------
    follow : bool
        Whether the equalizer follows the finger on each contactor, by the currents that the
        amplifier measures. With an amplifier that measures none, the display's own finger is played
        for.
    calibration : str or None
        File of ``tactile calibrate``; by default that of the display's name beside this file.
    """

    follow: bool = False
    calibration: Annotated[str, Meta(min_length=1)] | None = None


class DisplayConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Display that is played.

    Attributes
    ----------
    name : str
        Name of the display for clients.
    display : str
        Name of a shipped display, or path of a display file.
    device : str
        URL of the device.
    sample_rate_hz : float or None
        Rate of the drive [Hz]; None lets the device choose.
    voltage_limit_v : float or None
        Voltage limit [V], which may only be lower than that of the display file.
    gain : float
        Factor of everything that is played, 0 to 1.
    levels : str
        What a texture of gain 1 plays: `largest`, with the largest gain that the limits of the
        display leave unchanged in strokes of 40, 80 and 160 mm/s; `file`, the levels of its file.
        While the finger is followed, textures have the levels of their files, because a stiffer
        finger than that of the display file allows less.
    arm_on_start : bool
        Whether to arm the display when the server starts, without a client.
    rearm : bool
        Whether to arm it again after its link or its playback was lost.
    worn : bool
        Whether the finger stays on the display while it touches nothing, so that waveforms play
        then as well. Otherwise they play 34 dB lower then, because a bimorph in air resonates by as
        much.
    accept_unsafe_hold : bool
        Whether to accept a device that may hold its last voltage when the host dies.
    """

    name: Name = "default"
    display: Annotated[str, Meta(min_length=1)] = "reference-24"
    device: Annotated[str, Meta(min_length=1)] = "sim:"
    sample_rate_hz: Annotated[float, Meta(ge=2500, le=200_000)] | None = None
    voltage_limit_v: Annotated[float, Meta(gt=0, le=1000)] | None = None
    gain: Fraction = 1.0
    levels: Literal["largest", "file"] = "largest"
    arm_on_start: bool = False
    rearm: bool = False
    worn: bool = False
    accept_unsafe_hold: bool = False


class File(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Tables of a configuration file.

    Attributes
    ----------
    server : ServerConfig
        Table ``[server]``.
    token : tuple of TokenConfig
        Tables ``[[token]]``.
    osc : OscConfig
        Table ``[osc]``.
    log : LogConfig
        Table ``[log]``.
    record : RecordConfig
        Table ``[record]``.
    finger : FingerConfig
        Table ``[finger]``.
    display : tuple of DisplayConfig
        Tables ``[[display]]``.
    """

    server: ServerConfig = ServerConfig()
    token: Annotated[tuple[TokenConfig, ...], Meta(max_length=MOST_TOKENS)] = ()
    osc: OscConfig = OscConfig()
    log: LogConfig = LogConfig()
    record: RecordConfig = RecordConfig()
    finger: FingerConfig = FingerConfig()
    display: tuple[DisplayConfig, ...] = (DisplayConfig(),)

    def __post_init__(self) -> None:
        names = [display.name for display in self.display]
        if not names:
            raise ValueError("display: at least one must be given")
        for i, name in enumerate(names):
            if name in names[:i]:
                raise ValueError(f"display[{i}].name = {name!r}: is taken by another display")
        self._check_finger()
        server = self.server
        if not server.token_file and not self.token and not is_loopback(server.host):
            raise ValueError(
                f"server.token_file = {server.token_file or ''!r}: must be given, or a [[token]], "
                f"because other machines can connect to host {server.host!r}"
            )

    def _check_finger(self) -> None:
        """Raise ValueError if the finger cannot be followed as the tables say."""
        if not self.finger.follow:
            return
        if self.record.folder:
            raise ValueError(
                "finger.follow = true: a session that follows the finger cannot be rendered again; "
                "leave out record.folder"
            )
        files = [self.finger.calibration or display.display for display in self.display]
        if len(set(files)) < len(files):
            raise ValueError(
                "finger.follow = true: each display needs a calibration of its own; give them "
                "display files of different names, and leave out finger.calibration"
            )


class Configuration(File, frozen=True, kw_only=True):
    """Configuration with absolute paths.

    Attributes
    ----------
    path : Path or None
        File that it was read from.
    """

    path: Path | None = None


def load_config(path: Path | None) -> Configuration:
    """Load a configuration file.

    Parameters
    ----------
    path : Path or None
        Path of the file; None gives the configuration without a file.

    Returns
    -------
    Configuration
        The configuration.

    Raises
    ------
    InputError
        If the file cannot be read or a value is invalid, with file, field, value and what is
        allowed.
    """
    if path is None:
        return Configuration()
    tables = files.read(path, File)
    folder = path.absolute().parent
    config = Configuration(
        server=structs.replace(
            tables.server,
            token_file=_beside(folder, tables.server.token_file),
            socket=_beside(folder, tables.server.socket),
            effects=_beside(folder, tables.server.effects),
        ),
        token=tuple(
            structs.replace(token, file=_beside(folder, token.file)) for token in tables.token
        ),
        osc=tables.osc,
        log=structs.replace(tables.log, file=_beside(folder, tables.log.file)),
        record=structs.replace(tables.record, folder=_beside(folder, tables.record.folder)),
        finger=structs.replace(
            tables.finger, calibration=_beside(folder, tables.finger.calibration)
        ),
        display=tuple(
            structs.replace(display, display=_display(folder, display.display))
            for display in tables.display
        ),
        path=path.absolute(),
    )
    read_tokens(config)
    return config


def _beside(folder: Path, name: str | None) -> str | None:
    """Return a path relative to a folder, if there is one."""
    return str(folder / name) if name else name


def _display(folder: Path, name: str) -> str:
    """Return the name of a shipped display unchanged, or the path of a display file."""
    named = Path(name).suffix != ".toml" and Path(name).parent == Path()
    return name if named else str(folder / name)


def load_configured(config: DisplayConfig) -> tuple[Display, files.SourceFile]:
    """Load a display with the limits of the configuration, and the texts of its files.

    Parameters
    ----------
    config : DisplayConfig
        Configuration of the display.

    Returns
    -------
    display : Display
        The display.
    source : SourceFile
        Texts of its files, without the limits of the configuration.

    Raises
    ------
    InputError
        If the display file cannot be used, or the configured limit is above that of the file.
    """
    display, source = load_with_source(config.display)
    if config.voltage_limit_v is None:
        return display, source
    if config.voltage_limit_v > display.limits.voltage:
        raise InputError(
            f"display {config.name}: voltage_limit_v = {config.voltage_limit_v:g} is above the "
            f"display file's {display.limits.voltage:g}; it may only be lower"
        )
    limits = replace(display.limits, voltage=config.voltage_limit_v)
    return replace(display, limits=limits), source


def calibration_of(config: Configuration, display: Display) -> str:
    """Return the calibration by which playback of a display follows the finger.

    Parameters
    ----------
    config : Configuration
        Configuration of the server.
    display : Display
        The display.

    Returns
    -------
    str
        Path of the file; empty if the finger is not to be followed.
    """
    if not config.finger.follow:
        return ""
    folder = Path() if config.path is None else config.path.parent
    return config.finger.calibration or str(folder / default_calibration(display.name))


def read_tokens(config: Configuration) -> list[tuple[bytes, frozenset[Role]]]:
    """Read the tokens that clients may present.

    Parameters
    ----------
    config : Configuration
        Configuration that names the tokens.

    Returns
    -------
    list of (bytes, frozenset of Role)
        Each token, and what it allows.

    Raises
    ------
    InputError
        If a token cannot be read, can be read by others, is too long for a `ClientHello`, or is
        short enough to be guessed.
    """
    tokens = []
    if config.server.token_file:
        name = config.server.token_file
        tokens.append((_secret(f"server.token_file = {name!r}", Path(name)), ALL_ROLES))
    for i, token in enumerate(config.token):
        if token.file:
            content = _secret(f"token[{i}].file = {token.file!r}", Path(token.file))
        else:
            content = _credential(f"token[{i}].credential", str(token.credential))
        tokens.append((content, frozenset(token.roles)))
    return tokens


def _secret(field: str, path: Path) -> bytes:
    """Return the token in a file that only its owner may use."""
    try:
        mode = stat.S_IMODE(path.stat().st_mode)
    except OSError as error:
        raise InputError(f"{field}: cannot be read: {error.strerror}") from error
    if os.name == "posix" and mode & 0o077:
        raise InputError(f"{field}: has mode {mode:04o}, so that others can use it: chmod 600")
    return _token(field, path)


def _credential(field: str, name: str) -> bytes:
    """Return a token that systemd passes on, which nobody else can read."""
    folder = os.environ.get("CREDENTIALS_DIRECTORY", "")
    if not folder:
        raise InputError(
            f"{field} = {name!r}: there are no credentials; systemd gives them to a unit with "
            f"LoadCredential={name}:FILE"
        )
    return _token(f"{field} = {name!r}", Path(folder) / name)


def _token(field: str, path: Path) -> bytes:
    """Return the token in a file, whose length is checked."""
    try:
        token = files.read_text(path).strip()
    except InputError as error:
        raise InputError(f"{field}: {error}") from error
    if not SHORTEST_TOKEN <= len(token) <= LONGEST_TOKEN:
        raise InputError(
            f"{field}: holds {len(token)} characters, must be {SHORTEST_TOKEN} … {LONGEST_TOKEN}"
        )
    return token.encode()
