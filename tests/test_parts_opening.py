"""DRV2667 and BOS1921 are found, opened or refused in one line."""

import errno
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from chip_models import Bos1921Model, ChipModel, Drv2667Model, ModelBus
from parts_rig import FakeDisplay, FakeLimits, level

from tactile.bus.base import Bus, DriveBlock, HostDeath
from tactile.bus.chips import adapter, bos1921, drv2667
from tactile.bus.chips.adapter import ChipTarget
from tactile.bus.chips.bos1921 import Bos1921Bus
from tactile.bus.chips.chip import ChipCounters
from tactile.bus.chips.drv2667 import Drv2667, Drv2667Bus
from tactile.bus.registry import find_devices, open_bus
from tactile.clock import ModelClock
from tactile.errors import BusError, InputError


@pytest.fixture
def shelf(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[int | tuple[int, int], ChipModel]]:
    """Give the chips of /dev/i2c-1, by the wall clock."""
    clock = ModelClock()
    monkeypatch.setattr(clock, "now", time.monotonic)
    monkeypatch.setattr(clock, "sleep", lambda seconds: None)
    chips: dict[int | tuple[int, int], ChipModel] = {}
    monkeypatch.setattr(
        adapter, "open_adapter", lambda path: ModelBus(clock, chips, None), raising=True
    )
    monkeypatch.setattr(chips_of, "clock", clock, raising=False)
    yield chips
    assert not [t for t in threading.enumerate() if t.name == "tactile chips"]


class chips_of:  # noqa: N801
    """Holder of the clock that the fixture uses."""

    clock: ModelClock


@pytest.mark.realtime
@pytest.mark.parametrize("url", ["drv2667:1", "drv2667:/dev/i2c-1", "bos1921:1"])
def test_a_thread_plays_what_is_written_and_is_gone_after_close(
    url: str, shelf: dict[int | tuple[int, int], ChipModel]
) -> None:
    chip = (Drv2667Model if "drv" in url else Bos1921Model)(chips_of.clock)
    shelf[0x59 if "drv" in url else 0x44] = chip
    with open_bus(url, FakeDisplay(), accept_unsafe_hold=True) as bus:
        bus.start()
        volts = level(30, 1600)
        for k in range(0, len(volts), 16):
            bus.write(DriveBlock(k, volts[k : k + 16]))
        bus.stop()
        assert bus.counters.samples == 1600
    assert chip.waveform()[-1] == 0.0
    assert chip.played, "how much depends on how busy this machine is"
    assert max(chip.played) <= 30.5


@pytest.mark.parametrize(
    ("url", "display", "message"),
    [
        ("drv2667:", FakeDisplay(), "path '': give the number"),
        ("drv2667:/dev/ttyS0", FakeDisplay(), "give the number of an I2C bus or /dev/i2c-N"),
        ("drv2667:1?adress=0x59", FakeDisplay(), "unknown option 'adress'; .*'address'"),
        ("drv2667:1?address=0x60", FakeDisplay(), "must be 0x59 … 0x59"),
        ("drv2667:1?range=75", FakeDisplay(), "must be one of 50, 100, 150, 200"),
        ("drv2667:1?range=50", FakeDisplay(), "limit 50 V exceeds the range ±25 V"),
        ("drv2667:1", FakeDisplay(limits=FakeLimits(120.0)), "120 V exceeds the range ±100 V"),
        ("drv2667:1?mux=0x60&ports=0", FakeDisplay(), "must be 0x70 … 0x77"),
        ("drv2667:1?mux=0x70&ports=0,8", FakeDisplay(), "must be 0 … 7"),
        ("drv2667:1?mux=0x70&ports=0,0", FakeDisplay(2), "one comes twice"),
        ("drv2667:1?ports=0", FakeDisplay(), "of which mux"),
        ("drv2667:1", FakeDisplay(2), "1 chips for 2 channels.*ports="),
        ("bos1921:1?address=0x44,0x45", FakeDisplay(), "2 chips for 1 channels.*address="),
        ("drv2667:1?clock_hz=1000000", FakeDisplay(), "exceeds what the chip takes, 400000"),
        ("drv2667:1?mux=0x70&ports=0,1,2,3", FakeDisplay(4), "need 92% .*23% each.* 3 chips fit"),
        ("bos1921:1?address=0x44,0x45,0x46", FakeDisplay(3), "need 118% .*39% each.* 2 chips fit"),
        ("bos1921:1?range=50", FakeDisplay(), "must be one of 13, 95"),
        ("bos1921:1?range=13", FakeDisplay(), "exceeds the range ±13.28 V"),
        ("bos1921:1?parcap=x", FakeDisplay(), "parcap = 'x'"),
        ("drv2667:1", FakeDisplay(slew=4e3), "slew limit 4000 V/s.*20 ms are promised"),
        ("drv2667:1", FakeDisplay(slew=5e3), "after 80 samples in the chip"),
    ],
)
def test_what_cannot_be_is_one_line(
    url: str,
    display: FakeDisplay,
    message: str,
    shelf: dict[int | tuple[int, int], ChipModel],
) -> None:
    with pytest.raises(InputError, match=message) as found:
        open_bus(url, display, accept_unsafe_hold=True)
    assert "\n" not in str(found.value)


def test_only_8_khz_is_played(shelf: dict[int | tuple[int, int], ChipModel]) -> None:
    with pytest.raises(InputError, match="drv2667: sample_rate 4000 Hz: the chip plays 8000 Hz"):
        open_bus("drv2667:1", FakeDisplay(), sample_rate=4000.0)


def test_a_chip_that_does_not_answer_or_is_another_is_one_line(
    shelf: dict[int | tuple[int, int], ChipModel], monkeypatch: pytest.MonkeyPatch
) -> None:
    wires: list[ModelBus] = []

    def wired(path: str) -> ModelBus:
        wires.append(ModelBus(chips_of.clock, shelf, None))
        return wires[-1]

    monkeypatch.setattr(adapter, "open_adapter", wired)
    for url in ("drv2667:1", "bos1921:1"):
        with pytest.raises(BusError, match=r"does not answer .*is it wired") as found:
            open_bus(url, FakeDisplay(), accept_unsafe_hold=True)
        assert "\n" not in str(found.value)
    assert all(wire.closed for wire in wires)
    shelf[0x59] = Drv2667Model(chips_of.clock, identity=5)
    with pytest.raises(BusError, match="DRV2667 at 0x59: there is DRV2665, not a DRV2667"):
        open_bus("drv2667:1", FakeDisplay())


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (
            FileNotFoundError(2, "No such file"),
            "no such bus; there are: ",
        ),
        (PermissionError(13, "Permission denied"), "permission denied; sudo usermod -aG i2c"),
        (OSError(16, "Device or resource busy"), "Device or resource busy"),
    ],
)
def test_an_adapter_that_cannot_be_opened_is_one_line(
    monkeypatch: pytest.MonkeyPatch, error: OSError, message: str
) -> None:
    smbus2 = pytest.importorskip("smbus2")

    def refuse(path: str) -> None:
        raise error

    monkeypatch.setattr(smbus2, "SMBus", refuse)
    with pytest.raises(BusError, match=f"/dev/i2c-7: {message}") as found:
        open_bus("drv2667:7", FakeDisplay())
    assert "\n" not in str(found.value)


def test_without_smbus2_it_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "smbus2", None)
    with pytest.raises(BusError, match="pip install smbus2"):
        open_bus("drv2667:7", FakeDisplay())


@pytest.mark.parametrize(
    ("voltage", "wide"), [(10, 50), (25, 50), (25.1, 100), (75, 150), (99, 200)]
)
def test_the_smallest_range_that_covers_the_limit_is_chosen(voltage: float, wide: int) -> None:
    assert drv2667.chosen_range(voltage, None) == wide


@pytest.mark.parametrize(("kind", "death"), [(Drv2667Bus, "zero"), (Bos1921Bus, "holds")])
def test_what_host_death_does_is_declared(kind: type[Bus], death: HostDeath) -> None:
    assert kind.on_host_death == death


def test_chips_are_found_by_reading_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = ModelClock()
    wire = ModelBus(clock, {0x59: Drv2667Model(clock), 0x45: Bos1921Model(clock)}, None)
    monkeypatch.setattr(adapter, "open_adapter", lambda path: wire)
    monkeypatch.setattr(Path, "glob", lambda self, pattern: [Path("/dev/i2c-3")])
    urls = [found.url for found in (*drv2667.find(), *bos1921.find())]
    assert urls == ["drv2667:3", "bos1921:3?address=0x45"]
    assert wire.closed


def test_without_an_adapter_nothing_is_found_silently(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Path, "glob", lambda self, pattern: [])
    assert [f for f in find_devices() if f.url.startswith(("drv", "bos"))] == []
    assert capfd.readouterr() == ("", "")


def test_a_refusal_of_a_full_fifo_is_none_that_the_driver_ever_meets() -> None:
    """The model refuses the 101st byte, so that the tests above would see one written."""
    clock = ModelClock()
    chip = Drv2667Model(clock)
    chip.write(bytes([2, 4]))
    with pytest.raises(OSError, match="Remote") as found:
        chip.write(bytes([0x0B]) + bytes(101))
    assert found.value.errno == errno.EREMOTEIO
    chip._pointer = 0
    assert chip.read(1)[0] & 1
    single = Drv2667(
        ChipTarget(ModelBus(clock, {0x59: chip}, None), 0x59),
        clock,
        ChipCounters(),
        wide=50,
        step=1.0,
    )
    single.identify()
