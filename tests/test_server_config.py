"""Tests of the server's configuration: what a file may contain, and one line for each mistake.

Logs and the watchdog are here as well: what they write when there is nowhere to write to.
"""

import asyncio
import json
import logging
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from server_rig import until

from tactile.errors import InputError
from tactile.messages import Role
from tactile.server import logs, watchdog
from tactile.server.config import (
    Configuration,
    DisplayConfig,
    FingerConfig,
    LogConfig,
    ServerConfig,
    is_loopback,
    load_config,
    read_tokens,
)
from tactile.server.logs import Logs

PACKAGING = Path(__file__).parents[1] / "packaging"


def ends(work: Callable[[], object]) -> bool:
    """Return whether something ends, and does not wait for what never comes."""
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(60)
    return not thread.is_alive()


def write(folder: Path, text: str) -> Path:
    path = folder / "tactile.toml"
    path.write_text(text, "utf-8")
    return path


def test_without_a_file_there_is_one_simulated_display_on_loopback() -> None:
    config = load_config(None)
    (display,) = config.display
    assert (display.name, display.display, display.device) == ("default", "reference-24", "sim:")
    assert (config.server.host, config.server.port, config.osc.port) == ("127.0.0.1", 7411, 0)
    assert not display.arm_on_start


def test_the_shipped_example_says_what_is_so_without_it() -> None:
    config = load_config(PACKAGING / "tactile.toml")
    assert config == Configuration(display=(DisplayConfig(name="right"),), path=config.path)


def test_paths_are_relative_to_the_file_and_shipped_names_stay(tmp_path: Path) -> None:
    write_secret(tmp_path / "secret", "0123456789abcdef\n")
    config = load_config(
        write(
            tmp_path,
            '[server]\ntoken_file = "secret"\neffects = "fx"\n[log]\nfile = "a.log"\n'
            '[finger]\ncalibration = "mine.npz"\n'
            '[[display]]\nname = "a"\ndisplay = "mine.toml"\n'
            '[[display]]\nname = "b"\ndisplay = "reference-64"\n',
        )
    )
    assert config.server.token_file == str(tmp_path / "secret")
    assert config.server.effects == str(tmp_path / "fx")
    assert config.log.file == str(tmp_path / "a.log")
    assert config.finger == FingerConfig(calibration=str(tmp_path / "mine.npz"))
    assert [d.display for d in config.display] == [str(tmp_path / "mine.toml"), "reference-64"]
    assert config.path == tmp_path / "tactile.toml"


BAD = {
    "[server]\nprot = 1": "server.prot: unknown key; did you mean 'port'?",
    "[sever]\nport = 1": "sever: unknown key; did you mean 'server'?",
    '[server]\nport = "7411"': "server.port = '7411': expected int",
    "[server]\nport = 70000": "server.port = 70000: expected int <= 65535",
    '[server]\nhost = "0.0.0.0"': "server.token_file = '': must be given",
    '[server]\nhost = "192.168.1.5"\ntoken_file = ""': "server.token_file = '': must be given",
    '[server]\nhost = "::"': "server.token_file = '': must be given",
    '[server]\nhost = "box.local"': "server.token_file = '': must be given",
    '[server]\norigins = ["*"]': "server.origins[0] = '*': expected str matching",
    '[server]\norigins = ["null"]': "server.origins[0] = 'null': expected str matching",
    '[server]\norigins = ["https://a.example/x"]': "server.origins[0] = ",
    '[server]\ntoken_file = "none"': "token_file = ",
    '[[token]]\nfile = "none"': "token[0].file = ",
    '[[token]]\nroles = ["play"]': "exactly one of them must be given",
    '[[token]]\nfile = "a"\ncredential = "b"': "exactly one of them must be given",
    '[[token]]\nfile = "a"\nroles = ["pley"]': "token[0].roles[0] = 'pley': unknown; did you mean",
    '[[token]]\ncredential = "../a"': "token[0].credential = '../a': expected str matching",
    '[[token]]\ncredential = "token"': "LoadCredential=token:FILE",
    "[osc]\nport = -1": "osc.port = -1: expected int >= 0",
    '[log]\nlevel = "inof"': "log.level = 'inof': unknown; did you mean 'info'?",
    "display = []": "display: at least one must be given",
    '[[display]]\nname = "a"\n[[display]]\nname = "a"': "display[1].name = 'a': is taken",
    '[[display]]\nname = "../a"': "display[0].name = '../a': expected str matching",
    "[[display]]\ngain = 1.5": "display[0].gain = 1.5: expected float <= 1.0",
    "[[display]]\nvoltage_limit_v = nan": "display[0].voltage_limit_v = nan: must be a finite",
    "[[display]]\narm_on_strat = true": "arm_on_strat: unknown key; did you mean 'arm_on_start'?",
    'path = "x"': "path: unknown key",
    "[finger]\nfolow = true": "finger.folow: unknown key; did you mean 'follow'?",
    '[finger]\ncalibration = ""': "finger.calibration = '': expected str of length >= 1",
    '[finger]\nfollow = true\n[record]\nfolder = "a"': "leave out record.folder",
    '[finger]\nfollow = true\n[[display]]\nname = "a"\n[[display]]\nname = "b"': (
        "finger.follow = true: each display needs a calibration of its own"
    ),
    '[finger]\nfollow = true\ncalibration = "a.npz"\n[[display]]\nname = "a"\n[[display]]\n'
    'name = "b"\ndisplay = "reference-64"': "and leave out finger.calibration",
}


@pytest.mark.parametrize("text", BAD)
def test_what_does_not_fit_is_one_line_with_its_place(tmp_path: Path, text: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError) as caught:
        load_config(path)
    assert BAD[text] in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("content", "length"), [("", 0), ("short\n", 5), ("x" * 300, 300)])
def test_a_token_that_cannot_be_used_is_refused(tmp_path: Path, content: str, length: int) -> None:
    write_secret(tmp_path / "token", content)
    with pytest.raises(InputError, match=f"holds {length} characters, must be 16 … 256"):
        load_config(write(tmp_path, '[server]\nhost = "0.0.0.0"\ntoken_file = "token"'))


def write_secret(path: Path, content: str, mode: int = 0o600) -> None:
    path.write_text(content, "utf-8")
    path.chmod(mode)


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o644, 0o777])
@pytest.mark.parametrize("table", ["[server]\ntoken_file", "[[token]]\nfile"])
def test_a_token_that_others_can_use_is_refused(tmp_path: Path, table: str, mode: int) -> None:
    write_secret(tmp_path / "token", "0123456789abcdef", mode)
    with pytest.raises(InputError, match=rf"has mode {mode:04o}, .*: chmod 600"):
        load_config(write(tmp_path, f'{table} = "token"'))


def test_tokens_have_their_roles_and_one_may_be_a_credential(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A credential's mode is systemd's matter: an access list looks like a group's right."""
    (tmp_path / "given").mkdir()
    write_secret(tmp_path / "given" / "tactile", "credential-of-16", 0o440)
    write_secret(tmp_path / "all", "file-with-all-of-it")
    write_secret(tmp_path / "few", "file-with-a-few-roles")
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path / "given"))
    config = load_config(
        write(
            tmp_path,
            '[server]\nhost = "0.0.0.0"\n[[token]]\nfile = "all"\n[[token]]\nfile = "few"\n'
            'roles = ["watch", "stop"]\n[[token]]\ncredential = "tactile"\nroles = ["play"]\n',
        )
    )
    assert read_tokens(config) == [
        (b"file-with-all-of-it", frozenset[Role]({"watch", "play", "arm", "stop"})),
        (b"file-with-a-few-roles", {"watch", "stop"}),
        (b"credential-of-16", {"play"}),
    ]


def test_a_token_file_that_never_ends_is_refused(tmp_path: Path) -> None:
    write_secret(tmp_path / "token", "x" * 2**21)
    with pytest.raises(InputError, match="token: has more than 1024 KiB of text"):
        load_config(write(tmp_path, '[server]\nhost = "0.0.0.0"\ntoken_file = "token"'))


def test_a_server_for_others_cannot_be_made_without_a_token_either() -> None:
    with pytest.raises(ValueError, match="must be given"):
        Configuration(server=ServerConfig(host="10.0.0.1"))


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("127.0.0.1", True), ("127.9.9.9", True), ("::1", True), ("localhost", True),
        ("LOCALHOST", True), ("0.0.0.0", False), ("::", False), ("localhost.evil.example", False),
        ("127.0.0.1.nip.io", False), ("10.0.0.1", False), ("", False),
    ],
)  # fmt: skip
def test_only_loopback_is_loopback(host: str, expected: bool) -> None:
    assert is_loopback(host) is expected


# Logs


@pytest.fixture
def quiet(monkeypatch: pytest.MonkeyPatch) -> Iterator[logging.Logger]:
    monkeypatch.setattr(logs, "PATIENCE", 60.0)
    log = logging.getLogger("tactile.test")
    before = logging.getLogger().handlers[:], logging.getLogger().level
    yield log
    assert (logging.getLogger().handlers[:], logging.getLogger().level) == before


def test_json_lines_hold_fields_and_survive_what_is_no_json(
    tmp_path: Path, quiet: logging.Logger
) -> None:
    file = tmp_path / "log"
    written = Logs(LogConfig(format="json", file=str(file)))
    quiet.info("came", extra={"fields": {"client": "a\nb\udc00", "path": tmp_path}})
    quiet.debug("not at this level")
    try:
        raise ZeroDivisionError
    except ZeroDivisionError:
        quiet.exception("broke")
    written.close()
    came, broke = (json.loads(line) for line in file.read_text("utf-8").splitlines())
    assert came["message"] == "came"
    assert came["level"] == "info"
    assert came["path"] == str(tmp_path)
    assert came["time"].endswith("Z")
    assert "ZeroDivisionError" in broke["exception"]
    assert written.dropped == 0


def test_a_text_line_stays_one_line_whatever_a_client_is_called(
    tmp_path: Path, quiet: logging.Logger
) -> None:
    file = tmp_path / "log"
    written = Logs(LogConfig(file=str(file)))
    quiet.warning("came", extra={"fields": {"client": "a\n2025 ERROR forged"}})
    written.close()
    (line,) = file.read_text("utf-8").splitlines()
    assert line.endswith("WARNING test: came client='a\\n2025 ERROR forged'")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_costs_lines_that_are_counted(quiet: logging.Logger) -> None:
    written = Logs(LogConfig(file="/dev/full"))
    for i in range(5):
        quiet.info("line %d of %s", i, "x" * i)
        quiet.info(f"line {i}")
    written.close()
    assert written.dropped == 10


def test_who_does_not_read_the_log_keeps_nobody_waiting(
    quiet: logging.Logger, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody reads the pipe of the log: the writer blocks, the rest is dropped, the end comes."""
    monkeypatch.setattr(logs, "PATIENCE", 0.05)
    reading, writing = os.pipe()
    with os.fdopen(writing, "w") as stream:
        monkeypatch.setattr(sys, "stderr", stream)
        written = Logs(LogConfig(), clock=iter(range(10**9)).__next__)

        def write_all() -> None:
            for _ in range(3000):
                quiet.info("y" * 1000)
            written.close()

        assert ends(write_all)
        assert written.dropped > 1500
        os.close(reading)


@pytest.mark.parametrize("stream", ["none", "closed"])
def test_a_closed_standard_error_stops_nothing(
    quiet: logging.Logger, monkeypatch: pytest.MonkeyPatch, stream: str, tmp_path: Path
) -> None:
    closed = (tmp_path / "x").open("w")
    closed.close()
    monkeypatch.setattr(sys, "stderr", None if stream == "none" else closed)
    written = Logs(LogConfig())
    quiet.info("into nothing")
    written.close()


def test_many_alike_are_cut_short_and_the_next_second_is_new(
    tmp_path: Path, quiet: logging.Logger
) -> None:
    now = [0.0]
    file = tmp_path / "log"
    written = Logs(LogConfig(file=str(file)), clock=lambda: now[0])
    for second in (0.0, 1.0):
        now[0] = second
        for i in range(100):
            quiet.info("packet %d", i)
        quiet.info("something else")
    written.close()
    assert len(file.read_text().splitlines()) == 2 * (10 + 1), "ten a second of one kind"
    assert written.dropped == 2 * (100 - 10)


def test_a_log_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"log.file = .*: cannot be written: "):
        Logs(LogConfig(file=str(tmp_path / "no" / "log")))


# The watchdog


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.settimeout(60)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield listening


async def test_systemd_is_told_that_we_live_only_while_playback_does(
    systemd: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "2000")
    asked: list[bool] = []

    def beat() -> bool:
        asked.append(len(asked) < 3)
        return asked[-1]

    task = asyncio.create_task(watchdog.keep_alive(beat))
    await until(lambda: len(asked) > 6)
    task.cancel()
    systemd.setblocking(False)
    assert [systemd.recv(100) for _ in range(3)] == [b"WATCHDOG=1"] * 3
    with pytest.raises(BlockingIOError):
        systemd.recv(100)


def test_the_interval_is_half_of_what_systemd_asks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    assert watchdog.interval() == 1.0
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert watchdog.interval() is None
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    monkeypatch.setenv("WATCHDOG_USEC", "-1")
    assert watchdog.interval() is None


@pytest.mark.parametrize("path", ["", "/nowhere/notify", "@nobody", "relative"])
def test_nobody_who_listens_is_no_error(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", path)
    watchdog.notify("READY=1")


def test_a_socket_that_is_full_does_not_block(systemd: socket.socket) -> None:
    def notify() -> None:
        for _ in range(1000):
            watchdog.notify("x" * 1000)

    assert ends(notify)
