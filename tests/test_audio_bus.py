"""Tests of ``audio:``, which plays what is written and ends at 0 V whatever happens.

The whole way runs in real time on JACK's dummy card, where a recorder keeps what the card is given,
and on an ALSA device that writes a file. Other programs may keep a dummy card waiting, which real
ones with their priorities are not; where that would matter the test says what it does then.
"""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from audio_rig import (
    BUFFER,
    CALIBRATED,
    CHANNELS,
    CODE,
    FADE,
    FULL_SCALE,
    LONG_BUFFER,
    RATE,
    Server,
    display_of,
    needed,
    serving,
    waves,
)

from tactile.arrays import Floats
from tactile.bus.audio import audio_bus
from tactile.bus.audio import process as audio_process
from tactile.bus.audio.audio_bus import AudioBus, find
from tactile.bus.audio.process import AudioProcess
from tactile.bus.base import Bus, DriveBlock
from tactile.bus.registry import open_bus, parse
from tactile.display.display import Display
from tactile.errors import BusError, BusStateError, InputError

PIECE = 256
"""Samples that are handed to the card at once."""


@pytest.fixture
def audio_display(tmp_path: Path) -> Display:
    return display_of(tmp_path)


# What is refused before any card is looked for


def refused(display: Display, url: str = "audio:") -> str:
    with pytest.raises((InputError, BusError)) as found:
        open_bus(url, display, accept_unsafe_hold=True)
    assert "\n" not in str(found.value)
    return str(found.value)


def test_without_accepting_what_nobody_knows_it_is_not_opened(audio_display: Display) -> None:
    with pytest.raises(InputError, match="when the host dies nobody knows"):
        open_bus("audio:", audio_display)


def test_a_display_that_is_not_calibrated_is_told_how(tmp_path: Path) -> None:
    text = refused(display_of(tmp_path, ""))
    assert "audio_full_scale_v: play a 100 Hz sine" in text


def test_what_the_card_would_clip_is_refused(tmp_path: Path) -> None:
    small = display_of(tmp_path, "[amplifier]\naudio_full_scale_v = 99.0\n")
    assert "limits.voltage_v = 100 exceeds audio_full_scale_v = 99" in refused(small)


@pytest.mark.parametrize(
    ("text", "mistake"),
    [
        ("23", "must be a number from 24 up"),
        ("0", "must be a number from 24 up"),
        ("-1", "must be a number from 24 up"),
        ("24.5", "must be a whole number"),
        ("all", "must be a number"),
        ("", "must be a number"),
    ],
)
def test_channels_are_the_displays_at_least(
    audio_display: Display, text: str, mistake: str
) -> None:
    assert mistake in refused(audio_display, f"audio:?channels={text}")


def test_an_unknown_option_is_one_line(audio_display: Display) -> None:
    assert "unknown option 'chanels'; did you mean 'channels'" in refused(
        audio_display, "audio:?chanels=24"
    )


def without(monkeypatch: pytest.MonkeyPatch, folder: Path, text: str) -> None:
    """Put a sounddevice before the real one."""
    (folder / "sounddevice.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(folder)


@pytest.mark.ci
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("raise ImportError('No module named sounddevice')", "pip install sounddevice"),
        ("raise OSError('PortAudio library not found')", "apt install libportaudio2"),
        ("import os; os.abort()", "PortAudio crashed .exit code -6"),
        ("print('noise'); import sys; sys.stderr.write('ALSA lib'); raise OSError('x')", "missing"),
    ],
)
def test_a_missing_or_crashing_portaudio_is_one_line_and_nothing_is_found(
    audio_display: Display, monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
    capfd: pytest.CaptureFixture[str], text: str, said: str,
) -> None:  # fmt: skip
    without(monkeypatch, tmp_path, text)
    monkeypatch.setattr(audio_process, "OPENING", 60.0)
    with pytest.raises(BusError, match=said) as error:
        open_bus("audio:", audio_display, accept_unsafe_hold=True)
    assert "\n" not in str(error.value)
    assert list(find()) == []
    assert capfd.readouterr() == ("", "")


@pytest.mark.ci
def test_a_portaudio_that_finds_no_end_is_given_up(
    audio_display: Display, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    without(monkeypatch, tmp_path, "import time; time.sleep(100)")
    monkeypatch.setattr(audio_process, "OPENING", 1.0)
    assert "finds no end in 1 s" in refused(audio_display)
    assert list(find()) == []


def test_the_host_imports_no_sounddevice() -> None:
    code = "import sys, tactile.bus.audio.audio_bus; print('sounddevice' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "False\n"


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with serving(LONG_BUFFER, tmp_path_factory.mktemp("jack")) as running:
        yield running


@pytest.fixture
def bus(server: Server, audio_display: Display) -> Iterator[AudioBus]:
    found = opened(audio_display)
    with found:
        server.record()
        yield found


def opened(display: Display, url: str = "audio:system", rate: float | None = None) -> AudioBus:
    found = open_bus(url, display, sample_rate=rate, accept_unsafe_hold=True)
    assert isinstance(found, AudioBus)
    return found


def play(bus: Bus, volts: Floats, begin: int = 0, block: int = 480) -> None:
    for k in range(0, len(volts), block):
        bus.write(DriveBlock(begin + k, volts[k : k + block]))


def undisturbed(bus: AudioBus, server: Server, volts: Floats) -> Floats:
    """Play and return what the card got, once other programs did not keep it waiting."""
    for _ in range(5):
        before = bus.counters.underruns, server.xruns()
        server.record()
        bus.start()
        play(bus, volts)
        bus.stop()
        heard = server.heard()
        if (bus.counters.underruns, server.xruns()) == before:
            return heard
    pytest.skip("this machine does not play a second without an underflow")


@pytest.mark.realtime
def test_what_is_written_reaches_the_card_bit_by_bit(bus: AudioBus, server: Server) -> None:
    assert bus.wiring.sample_rate == RATE
    volts = waves(RATE)
    heard = undisturbed(bus, server, volts)
    first = int(np.flatnonzero(volts.any(axis=1))[0])
    whole = volts[first:]
    assert np.array_equal(heard[: len(whole)], (whole / FULL_SCALE).astype(np.float32))
    line = (volts[-1] / FULL_SCALE) * (1 - np.arange(1, FADE + 1) / FADE)[:, None]
    fade = heard[len(whole) : len(whole) + FADE]
    np.testing.assert_allclose(fade, line, rtol=0, atol=2 * CODE / FULL_SCALE)
    assert not heard[len(whole) + FADE - 1 :].any()
    assert np.array_equal((bus.output[-FADE:] / FULL_SCALE).astype(np.float32), fade)


@pytest.mark.realtime
def test_an_ac_coupled_card_says_what_that_costs(server: Server, tmp_path: Path) -> None:
    """−10 log10(1 + (20/20)²) dB at 20 Hz; e⁻³ = 5 % after 3/(2π 20 Hz)."""
    text = CALIBRATED + "ac_coupling_hz = 20.0\n[bimorph]\npiezo_height_mm = 0.6\n"
    bus = opened(display_of(tmp_path, text))
    with bus:
        said = "AC coupled at 20 Hz, not equalized: 20 Hz is 3.0 dB weak"
        assert bus.status.detail.startswith(said)
        assert bus.status.detail.endswith("electrodes take 0.024 s to 5 %")
        assert "AC coupled at 20 Hz" in bus.about


@pytest.mark.realtime
def test_writing_is_held_back_to_the_pace_of_the_card(bus: AudioBus) -> None:
    volts = waves(RATE)
    bus.start()
    begun = time.monotonic()
    play(bus, volts)
    took = time.monotonic() - begun
    told = bus.player_status
    assert told is not None
    assert told.lead <= RATE * 8 // 1000 + 2 * LONG_BUFFER
    assert took >= 1 - (told.lead + PIECE + LONG_BUFFER) / RATE - 0.02
    extrapolated = (audio_bus.FRESH + bus.latency) * RATE  # at most, from the last report
    assert len(volts) - told.position <= told.lead + PIECE + extrapolated


@pytest.mark.realtime
def test_states_are_the_contracts(bus: AudioBus) -> None:
    block = DriveBlock(0, waves(10))
    with pytest.raises(BusStateError, match="write: the bus is idle"):
        bus.write(block)
    bus.start()
    with pytest.raises(BusStateError, match="start: the bus is running"):
        bus.start()
    bus.abort()
    bus.start(10**12)
    bus.write(DriveBlock(10**12, waves(10)))
    bus.stop()
    bus.stop()
    assert bus.state == bus.status.state == "idle"
    assert bus.status.link == "up"
    assert bus.status.detail == ""
    assert "assumed DC coupled" in bus.about
    for k in range(3):
        bus.start()
        bus.write(DriveBlock(0, np.full((300, CHANNELS), 10.0)))
        (bus.stop, bus.abort)[k % 2]()
        assert not bus.output[-1].any()
    bus.close()
    bus.close()
    assert len(bus.output)
    with pytest.raises(BusStateError, match="start: the bus is closed"):
        bus.start()


@pytest.mark.realtime
def test_a_writer_that_goes_silent_is_faded_and_counted(bus: AudioBus, server: Server) -> None:
    bus.start()
    bus.write(DriveBlock(0, np.full((4800, CHANNELS), 50.0)))
    time.sleep(0.3)
    assert not server.heard()[-LONG_BUFFER:].any()
    assert bus.status.link == "up"
    assert bus.counters.underruns >= 1
    bus.write(DriveBlock(4800, np.full((480, CHANNELS), 50.0)))
    time.sleep(3 * LONG_BUFFER / RATE)
    assert bus.status.link == "up"
    assert bus.counters.late_blocks == 1
    assert bus.counters.dropped_samples == 480
    bus.stop()


@pytest.mark.realtime
def test_estop_from_another_thread_while_one_writes(bus: AudioBus, server: Server) -> None:
    bus.start()
    ended: list[bool] = []

    def write() -> None:
        position = 0
        while not ended:
            ended.extend([True] * (bus.state == "estopped"))
            bus.write(DriveBlock(position, np.full((480, CHANNELS), 50.0)))
            position += 480
        ended.append(True)

    writer = threading.Thread(target=write)
    writer.start()
    time.sleep(0.3)
    bus.estop()
    writer.join()
    assert len(ended) == 2
    assert bus.counters.dropped_samples >= 480
    assert not bus.output[-1].any()
    assert not server.heard()[-LONG_BUFFER:].any()
    with pytest.raises(BusStateError, match="clear it first"):
        bus.start()
    bus.clear()
    bus.start()
    bus.write(DriveBlock(0, np.full((480, CHANNELS), 5.0)))
    bus.stop()
    assert bus.counters.disconnects == 0


HOST = """
import sys
sys.path[:] = {path!r}
import numpy as np
from tactile.bus.audio import audio_bus
from tactile.bus.base import DriveBlock
from tactile.bus.registry import open_bus
from tactile.display.display import load_display
bus = open_bus("audio:system", load_display({file!r}), accept_unsafe_hold=True)
print("open", flush=True)
bus.start()
for k in range(1000):
    bus.write(DriveBlock(480 * k, np.full((480, 24), 50.0)))
"""


@pytest.mark.realtime
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_when_the_host_dies_or_hangs_the_output_fades(
    server: Server, audio_display: Display, tmp_path: Path, how: signal.Signals
) -> None:
    code = HOST.format(path=sys.path, file=str(tmp_path / "sample.toml"))
    host = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert host.stdout is not None
    assert host.stdout.readline() == "open\n"
    server.record()
    time.sleep(0.5)
    host.send_signal(how)
    begun = time.monotonic()
    blocks = server.silent_blocks()
    if how == signal.SIGSTOP:
        host.kill()
    host.wait()
    host.stdout.close()
    heard = np.concatenate([b for _, b in blocks]) * FULL_SCALE
    assert heard.max() == pytest.approx(50, abs=CODE)
    falling = heard[np.flatnonzero(heard[:, 0] >= 50 - CODE)[-1] :]
    assert np.abs(np.diff(falling, axis=0)).max() <= 50 / FADE + 2 * CODE, "a fade, not a step"
    last = next(t + len(b) / RATE for t, b in reversed(blocks) if b.any())
    print(f"HOST {how.name}: 0 V after {(last - begun) * 1e3:.0f} ms")


@pytest.mark.realtime
def test_a_card_that_is_lost_is_told_and_comes_back_at_rest(
    bus: AudioBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(audio_bus, "RETRY", 0.1)
    bus.start()
    bus.write(DriveBlock(0, np.full((480, CHANNELS), 50.0)))
    player = bus._player
    assert player is not None
    player._process.kill()
    assert player.wait(lambda: player.ended, 60)
    for k in range(1, 20):
        bus.write(DriveBlock(480 * k, np.full((480, CHANNELS), 50.0)))
    assert bus.counters.disconnects == 1
    assert bus.counters.dropped_samples >= 480 * 15
    end = time.monotonic() + 60
    while (status := bus.status).link == "down" and time.monotonic() < end:
        assert "is lost: its player has ended" in status.detail
        time.sleep(0.05)
    assert bus.counters.reconnects == 1
    assert "stop and start to play on" in bus.status.detail
    bus.write(DriveBlock(9600, np.full((480, CHANNELS), 50.0)))
    assert not bus.output.any()
    bus.stop()
    bus.start()
    bus.write(DriveBlock(0, np.full((480, CHANNELS), 50.0)))
    bus.stop()
    assert bus.status.detail == ""
    assert bus.output.max() == pytest.approx(50, abs=CODE)


@pytest.mark.realtime
def test_a_player_that_hangs_holds_nobody_up(bus: AudioBus) -> None:
    """The e-stop kills the player, and thereby ends the card's output."""
    bus.start()
    play(bus, np.full((4800, CHANNELS), 50.0))
    player = bus._player
    assert player is not None
    player._process.send_signal(signal.SIGSTOP)

    def write() -> None:
        with contextlib.suppress(BusStateError):
            play(bus, np.zeros((48000, CHANNELS)), 4800)

    writer = threading.Thread(target=write)
    writer.start()
    time.sleep(0.3)
    bus.estop()  # returns, and has then killed the player
    assert player._process.poll() is not None
    writer.join(60)
    assert not writer.is_alive()
    assert bus.status.link == "down"
    assert bus.state == "estopped"


@pytest.mark.realtime
def test_what_is_not_there_is_said_by_name(server: Server, tmp_path: Path) -> None:
    display = display_of(tmp_path)
    assert "did you mean 'system'" in refused(display, "audio:sistem")
    assert "has 24 output channels, needs 25" in refused(display, "audio:system?channels=25")
    with pytest.raises(InputError, match="sample_rate 8000 Hz: it plays 48000 Hz"):
        open_bus("audio:system", display, sample_rate=8000.0, accept_unsafe_hold=True)


@pytest.mark.realtime
def test_outputs_are_found_under_urls_that_open_them(
    server: Server, audio_display: Display
) -> None:
    found = {f.url: f.about for f in find()}
    assert "24 channels, 48000 Hz" in found["audio:system"]
    for url in found:
        assert parse(url).scheme == "audio"


def cycle(display: Display, times: int) -> None:
    opened(display).close()
    threads, files = threading.active_count(), len(os.listdir("/proc/self/fd"))
    for _ in range(times):
        with opened(display) as bus:
            bus.start()
            bus.write(DriveBlock(0, np.full((100, CHANNELS), 5.0)))
    assert threading.active_count() <= threads
    assert len(os.listdir("/proc/self/fd")) <= files


@pytest.mark.realtime
def test_nothing_is_left_after_close(server: Server, audio_display: Display) -> None:
    cycle(audio_display, 8)


@pytest.mark.realtime
def test_an_estop_ends_at_0_volts_and_how_soon_is_told(
    audio_display: Display, tmp_path: Path
) -> None:
    """The median of nine is 10 ms or so, the card's buffers included (20 ms at most, promised)."""
    took = []
    with serving(BUFFER, tmp_path) as server:
        bus = opened(audio_display)
        for _ in range(9):
            server.record()
            bus.start()
            play(bus, np.full((4800, CHANNELS), 80.0))
            begun = time.monotonic()
            bus.estop()
            when, block = [(t, b) for t, b in server.silent_blocks() if b.any()][-1]
            last = when + (np.flatnonzero(block.any(axis=1))[-1] + 1) / RATE
            took.append(last - begun + bus.latency)
            bus.clear()
        assert bus.latency <= 2 * BUFFER / RATE
        bus.close()
    print(f"ESTOP: median {np.median(took) * 1e3:.1f} ms, longest {max(took) * 1e3:.1f} ms")


@pytest.mark.realtime
def test_a_sound_server_that_hangs_hangs_no_host(audio_display: Display, tmp_path: Path) -> None:
    """PortAudio itself never returns from closing such a stream."""
    with serving(LONG_BUFFER, tmp_path) as server:
        bus = opened(audio_display)
        bus.start()
        bus.write(DriveBlock(0, np.full((480, CHANNELS), 50.0)))
        server.process.send_signal(signal.SIGSTOP)
        begun = time.monotonic()
        for k in range(1, 100):
            bus.write(DriveBlock(480 * k, np.full((480, CHANNELS), 50.0)))
        assert bus.status.link == "down"
        assert bus.counters.disconnects == 1
        bus.estop()
        bus.close()
        assert time.monotonic() - begun < 60
        server.process.send_signal(signal.SIGCONT)


# On an ALSA device that writes a file


@pytest.mark.realtime
def test_an_alsa_device_without_jack(
    audio_display: Display, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needed()
    base = Path("/usr/share/alsa/alsa.conf")
    if not base.is_file():
        pytest.skip("no ALSA configuration (apt install libasound2-data)")
    raw = tmp_path / "out.raw"
    text = f'pcm.tactile_out {{ type file; slave.pcm "null"; file "{raw}"; format "raw" }}\n'
    (tmp_path / "asound.conf").write_text(text, encoding="utf-8")
    monkeypatch.setenv("ALSA_CONFIG_PATH", f"{base}:{tmp_path / 'asound.conf'}")
    monkeypatch.setenv("JACK_NO_START_SERVER", "1")
    monkeypatch.setenv("JACK_DEFAULT_SERVER", "none")
    volts = waves(256)
    with opened(audio_display, "audio:tactile_out", 48000.0) as bus:
        bus.start()
        bus.write(DriveBlock(0, volts))
        bus.stop()
    heard = np.fromfile(raw, np.float32).reshape(-1, CHANNELS)
    sounding = np.flatnonzero(heard.any(axis=1))[0]
    played = heard[sounding : sounding + 255]
    assert np.array_equal(played, (volts[1:] / FULL_SCALE).astype(np.float32))
    assert not heard[-1].any()


def test_a_player_that_is_killed_has_ended(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    without(monkeypatch, tmp_path, "import time; time.sleep(100)")
    monkeypatch.setattr(audio_process, "ANSWER", 60.0)
    player = AudioProcess(None)
    player.kill()
    assert player.exit_code() != 0
    assert player.ended
