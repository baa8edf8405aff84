"""Every example runs as a user runs it, against a server with a simulated display."""

import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from tactile.errors import BusError
from tactile.local import open_display

EXAMPLES = Path(__file__).parents[1] / "examples"
SECONDS = "1.5"


@pytest.fixture(scope="module")
def addresses(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """Yield those of a server of two hands, WebSocket and OSC."""
    import socket

    folder = tmp_path_factory.mktemp("server")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (folder / "tactile.toml").write_text(
        f"[server]\nport = 0\n[osc]\nport = {port}\n"
        '[[display]]\nname = "left"\ndevice = "sim:"\n'
        '[[display]]\nname = "right"\ndevice = "sim:"\n'
    )
    words = [sys.executable, "-m", "tactile", "serve", "--config", str(folder / "tactile.toml")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        url = process.stdout.readline().split()[0]
        yield {"url": url, "osc": str(port)}
        process.terminate()
        assert process.wait(60) == 0


def run(name: str, *words: str) -> str:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *words],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.realtime
def test_hand_tracking(addresses: dict[str, str]) -> None:
    said = run(
        "hand_tracking.py", "--url", addresses["url"], "--display", "left", "--seconds", SECONDS
    )
    frames, touches = (int(word) for word in said.split()[0:3:2])
    most = 90 * float(SECONDS)
    assert most / 2 < frames <= most + 1
    assert 0 < touches <= frames


@pytest.mark.realtime
def test_hand_tracking_of_a_recorded_path(addresses: dict[str, str], tmp_path: Path) -> None:
    path = tmp_path / "hand.csv"
    path.write_text("time_s,x_m,y_m,z_m\n0,0,0.748,0\n1,0.08,0.748,0\n2,0.08,0.8,0\n")
    said = run(
        "hand_tracking.py", str(path), "--url", addresses["url"], "--display", "left",
        "--seconds", SECONDS,
    )  # fmt: skip
    assert int(said.split()[2]) > 0


@pytest.mark.realtime
def test_two_fingers(addresses: dict[str, str]) -> None:
    assert run("two_fingers.py", "--url", addresses["url"], "--seconds", SECONDS)


@pytest.mark.realtime
def test_waveform_streamer(addresses: dict[str, str]) -> None:
    said = run(
        "waveform_streamer.py",
        "--url",
        addresses["url"],
        "--display",
        "right",
        "--seconds",
        SECONDS,
    )
    assert said.startswith("12000 samples at 8000 Hz in ")


@pytest.mark.realtime
def test_tactile_images(addresses: dict[str, str]) -> None:
    said = run(
        "tactile_images.py", "--url", addresses["url"], "--display", "right", "--seconds", SECONDS
    )
    assert "frames were not played" in said


@pytest.mark.realtime
def test_osc_sender(addresses: dict[str, str]) -> None:
    pytest.importorskip("pythonosc")
    url = f"osc.udp://127.0.0.1:{addresses['osc']}"
    assert run("osc_sender.py", "--url", url, "--seconds", SECONDS)
    where = addresses["url"].replace("ws://", "http://").replace("/v1", "/metrics")
    with urllib.request.urlopen(where, timeout=60) as answer:
        lines = answer.read().decode().splitlines()
    (came,) = [line for line in lines if line.startswith("tactile_messages_total") and "osc" in line
               and '"contact"' in line]  # fmt: skip
    assert float(came.split()[-1]) > 50


@pytest.mark.ci
@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_without_a_server_an_example_is_one_line(path: Path) -> None:
    scheme = "osc.udp://127.0.0.1:1" if path.stem == "osc_sender" else "ws://127.0.0.1:1/v1"
    done = subprocess.run(
        [sys.executable, str(path), "--url", scheme, "--seconds", "30"],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"{scheme}: nob" if "ws" in scheme else f"{scheme}: nothing listens")


def test_every_example_is_run_here() -> None:
    names = {path.stem for path in EXAMPLES.glob("*.py")}
    assert names == {name.removeprefix("test_") for name in globals() if name[5:] in names}


@pytest.mark.realtime
def test_a_display_without_a_server_has_the_same_interface() -> None:
    with open_display("reference-24", device="sim:", timeout=60.0) as display:
        display.select("wood-oak")
        display.arm()
        for k in range(60):
            display.touch((0.001 * k, 0.0), velocity=(0.08, 0.0), normal_force=0.5)
            list(zip(range(1), display.telemetry(rate=90), strict=False))
        stats = display.stats()
        assert stats.state == "armed"
        assert stats.touching
        told = next(display.telemetry(rate=50))
        assert max(map(abs, told.drive)) > 0
        display.disarm()
        assert display.stats().state == "disarmed"


@pytest.mark.ci
def test_a_device_that_is_not_there_is_one_line() -> None:
    with pytest.raises(BusError, match="no such port") as caught:
        open_display(device="serial:///dev/nothing")
    assert "\n" not in str(caught.value)
