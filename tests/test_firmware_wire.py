"""The C amplifier on emulated microcontrollers, with a serial line between it and the host."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import protocol_story as story
import pytest
from behavior_rig import check_replayed, trace
from cli_rig import Command, recorded
from emulated_part import MACHINES, SERIAL, EmulatedPart, made
from protocol_traces import CONFIGS, MARKS, PACKET, Loads, Record, Rig, row_type, saved
from test_protocol_guard import eventful
from vectors_rig import DEFAULTS, Output, Vector, config_of, vectors

from firmware_protocol.config import AmplifierConfig
from firmware_protocol.messages import FULL_SCALE_CODE, Correlation, Guarded, State
from firmware_protocol.ports import SerialPort
from tactile.display.display import load_display

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the programs."""
    build = tmp_path_factory.mktemp("qemu")
    made(build, "wire")
    return build


@pytest.fixture(scope="module", params=MACHINES)
def part(
    request: pytest.FixtureRequest, programs: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[EmulatedPart]:
    """Boot a part, once for all tests."""
    name = request.param
    folder = tmp_path_factory.mktemp(name)
    program = programs / f"wire-{name}.elf"
    with closing(EmulatedPart(program, MACHINES[name], folder)) as booted:
        yield booted


@vectors("behavior")
def test_behavior_through_the_wire(vector: Vector, part: EmulatedPart) -> None:
    config = config_of(vector)
    sensor = Output(config["channels"]) if config.get("sense") else None
    check_replayed(vector, *part.replay(config, trace(vector), sensor))


def in_words_of_vectors(config: AmplifierConfig) -> dict[str, Any]:
    names = [*DEFAULTS, "sense_ranges_ua", "marker_lines"]
    return {name: getattr(config, {"fifo_samples": "fifo"}.get(name, name)) for name in names}


@pytest.fixture
def line(monkeypatch: pytest.MonkeyPatch) -> list[tuple[SerialPort, Record]]:
    """Return what comes to the end of a modeled serial line, with the tick at which it does."""
    arrived: list[tuple[SerialPort, Record]] = []
    feed = SerialPort.feed

    def listen(port: SerialPort, data: bytes, now: int) -> None:
        arrived.append((port, Record(now, SERIAL, data)))
        feed(port, data, now)

    monkeypatch.setattr(SerialPort, "feed", listen)
    return arrived


@pytest.mark.parametrize(
    ("display", "bit_rate"), [("six.toml", 3_000_000), ("reference-24", 12_000_000)]
)
def test_a_stroke_is_put_out_as_it_was_recorded(
    display: str, bit_rate: int, part: EmulatedPart, command: Command, grid: Path,
    line: list[tuple[SerialPort, Record]],
) -> None:  # fmt: skip
    """Send over the wire what a modeled line carried in a stroke of a quarter second.

    The recording begins after the samples that the filters of the renderer are late by.
    """
    device = f"mock:?link=serial&bit_rate={bit_rate}&format=pcm16"
    stroke = ("--seconds", 0.25, "--display", display, "--device", device)
    assert command("play", "wood-oak", *stroke, "--record", "oak.npz").code == 0
    volts = load_display(display).to_channels(recorded(Path("oak.npz"))["drive_v"])
    assert len(volts) == 2000
    config = line[0][0].amplifier.config
    out, _ = part.replay(in_words_of_vectors(config), [record for _, record in line])
    rows = np.frombuffer(out, row_type(config.channels))
    played = rows["codes"][rows["state"] == State.RUNNING]
    codes = np.rint(volts * (FULL_SCALE_CODE / (config.full_scale_uv * 1e-6)))
    begins = range(len(played) - len(codes) + 1)
    assert sum(np.array_equal(played[k : k + len(codes)], codes) for k in begins) == 1
    assert not rows["codes"][-1].any()


def assert_same(rig: Rig, part: EmulatedPart) -> None:
    """Compare what the amplifier in Python has done on a trace with what a part does on it."""
    sensor = Loads(rig.config) if rig.config.sense_ranges_ua else None
    out, sent = part.replay(in_words_of_vectors(rig.config), rig.records, sensor)
    marks = saved(record for record in sent if record.kind == MARKS)
    assert out + marks == rig.out()
    assert [record.data for record in sent if record.kind == PACKET] == rig.sent


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", CONFIGS)
def test_a_part_does_what_the_amplifier_in_python_does(
    name: str, seed: int, part: EmulatedPart
) -> None:
    """Play stories of 0.3 s, with lost, late and harmed packets."""
    assert_same(story.told(CONFIGS[name], seed, 0.3, judged=False), part)


def test_guards_and_windows_on_a_part(part: EmulatedPart) -> None:
    """Play a scene in which guards trip at random and windows of currents are sent."""
    rig = eventful(0, 0).rig
    assert {packet[0] for packet in rig.sent} >= {Correlation.TYPE, Guarded.TYPE}
    assert_same(rig, part)


def test_a_part_that_ends_says_why(programs: Path, tmp_path: Path) -> None:
    with (
        closing(EmulatedPart(programs / "wire-m4.elf", MACHINES["m4"], tmp_path)) as part,
        pytest.raises(AssertionError, match="the part has ended or hangs: fifo_samples"),
    ):
        part.replay(DEFAULTS | {"fifo_samples": 1023}, [])
