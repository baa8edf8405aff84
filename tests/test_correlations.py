"""Windows of correlated currents come from amplifiers over links to whoever takes them.

A capacitor is the load: its current is C dv/dt, so that the correlations are those of the steps of
the drive with themselves, which are computed here from what was put out.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from bus_benches import RealBench
from link_rig import Panel
from protocol_traces import Loads

from firmware_protocol import messages as m
from firmware_protocol.config import AmplifierConfig
from firmware_protocol.correlation import ENTRY
from firmware_protocol.messages import FULL_SCALE_CODE, State, Window
from tactile.arrays import Floats
from tactile.bus import correlations
from tactile.bus.base import Bus, DriveBlock, Wiring
from tactile.bus.correlations import CorrelationCounters, CorrelationWindow, WindowDecoder
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.simulated.current_sensor import CapacitiveLoad, CurrentSensor, SensorDesign
from tactile.bus.simulated.mock_bus import MockBus
from tactile.bus.simulated.modeled_bus import ModeledBus
from tactile.devices import open_bus
from tactile.errors import InputError

RATE, LOAD = 8000.0, 12.8e-9
"""Sample rate [Hz] and load of a channel [F]."""
STEP = 2.5e-3 / FULL_SCALE_CODE * 16
"""Step of an ADC of 12 bits with a range of ±2.5 mA [A]."""
NOISE = math.hypot(1.0, 12**-0.5) * STEP
"""Noise of the ADC and of its rounding, rms [A]."""
SIX_SIGMA = 6.0
"""Largest error in standard deviations: one in 5 × 10⁸ sums is larger."""
LINKS = {
    "none": "mock:?keep=all&load_pf=12800&correlation_ms=25",
    "serial": "mock:?link=serial&bit_rate=3000000&keep=all&load_pf=12800&correlation_ms=25",
    "can": "mock:?link=can&keep=all&load_pf=12800&correlation_ms=100",
    "canfd": "mock:?link=canfd&keep=all&load_pf=12800&correlation_ms=25",
    "i2c": "mock:?link=i2c&bit_rate=1000000&keep=all&load_pf=12800&correlation_ms=50",
}


def noise(count: int, channels: int, peak: float = 5.0, seed: int = 1) -> Floats:
    return np.random.default_rng(seed).uniform(-peak, peak, (count, channels))


def play(bus: Bus, volts: Floats) -> list[CorrelationWindow]:
    """Play samples from position 0 on, and return the windows."""
    windows = []
    bus.start()
    for k in range(0, len(volts), 80):
        bus.write(DriveBlock(k, volts[k : k + 80]))
        windows += bus.take_correlations()
    bus.stop()
    return windows + bus.take_correlations()


def assert_counted(bus: Bus, windows: int) -> None:
    """See that so many windows came, and nothing was wrong with them."""
    disturbed = bus.correlation_counters.disturbed
    expected = CorrelationCounters(windows=windows, disturbed=disturbed)
    assert bus.correlation_counters == expected


def steps_of(volts: Floats) -> Floats:
    """Return the steps of the drive (S, C) at each lag (S, 16, C), of 0 V before the start."""
    steps = np.diff(np.vstack([np.zeros((17, volts.shape[1])), volts]), axis=0)
    return np.stack([steps[16 - lag : len(steps) - lag] for lag in range(16)], axis=1)


def assert_of_capacitors(windows: list[CorrelationWindow], volts: Floats, rate: float) -> None:
    """Compare windows with the sums of a drive through `LOAD`."""
    lagged = steps_of(volts)
    for w in windows:
        span = slice(w.position, w.position + w.samples)
        channels = slice(w.first_channel, w.first_channel + len(w.sums))
        steps = lagged[span, :, channels]
        current = LOAD * rate * steps[:, 0]
        expected = np.einsum("sc,slc->cl", current, steps)
        noisy = SIX_SIGMA * NOISE * np.sqrt(np.einsum("slc,slc->cl", steps, steps))
        assert np.all(np.abs(w.sums - expected) <= noisy + w.rounding[:, None])
        energy = np.sum(current**2, axis=0) + w.samples * NOISE**2
        spread = SIX_SIGMA * NOISE * np.sqrt(np.sum(current**2, axis=0) + w.samples * NOISE**2)
        assert np.all(np.abs(w.energy - energy) <= 2 * spread + 1e-3 * energy)
        assert not w.clipped.any()


def assert_gapless(windows: list[CorrelationWindow], channels: int) -> None:
    """See that the windows of each channel follow each other from 0 on."""
    for channel in range(channels):
        own = [w for w in windows if 0 <= channel - w.first_channel < len(w.sums)]
        ends = [0, *(w.position + w.samples for w in own)]
        assert [w.position for w in own] == ends[:-1]
        assert len(own) > 2


@pytest.mark.parametrize("link", LINKS)
def test_windows_are_those_of_what_was_put_out(link: str) -> None:
    bus = open_bus(LINKS[link], Panel(channels=2))
    with bus:
        assert bus.correlates
        windows = play(bus, noise(4000, 2))
        output = cast(ModeledBus, bus).output
        rate = bus.wiring.sample_rate
    milliseconds = {"can": 100, "i2c": 50}.get(link, 25)
    assert {w.samples for w in windows} == {int(rate) * milliseconds // 1000}
    assert all(w.current_range == pytest.approx(2.5e-3) for w in windows)
    assert_gapless(windows, 2)
    assert_of_capacitors(windows, output, rate)
    assert_counted(bus, len(windows))


def test_boards_share_the_channels_of_a_display() -> None:
    """Thirty channels on two boards: 12 and 3 of each in a packet, which know their channels."""
    url = "mock:?link=canfd&data_bit_rate=8000000&boards=2&keep=all&load_pf=12800&correlation_ms=50"
    with open_bus(url, Panel(channels=30), sample_rate=4000) as bus:
        windows = play(bus, noise(2000, 30))
    assert {(w.first_channel, len(w.sums)) for w in windows} == {
        (0, 12), (12, 3), (15, 12), (27, 3),
    }  # fmt: skip
    assert_gapless(windows, 30)
    assert_counted(bus, len(windows))


@pytest.mark.parametrize(
    "url", ["mock:", "mock:?link=serial", "mock:?load_pf=100", "mock:?link=can&load_pf=100",
            "mock:?correlation_ms=25", "mock:?link=serial&correlation_ms=25"],
)  # fmt: skip
def test_nothing_comes_unless_it_is_measured_and_asked_for(url: str) -> None:
    with open_bus(url, Panel(channels=2)) as bus:
        assert not bus.correlates
        assert play(bus, noise(1000, 2)) == []
    assert_counted(bus, 0)


def test_a_current_beyond_the_range_is_flagged() -> None:
    """Steps of 40 V within 125 µs draw 4 mA from 12.8 nF; the channel that rests draws none."""
    volts = np.zeros((2000, 2))
    volts[:, 0] = np.resize([20.0, -20.0], 2000)
    with open_bus(LINKS["none"], Panel(channels=2, slew=2e6)) as bus:
        windows = play(bus, volts)
    assert all(w.clipped.tolist() == [True, False] for w in windows)
    assert windows[0].flags.tolist() == [Window.CLIPPED, 0]


def test_a_lost_packet_is_a_gap_and_nothing_worse() -> None:
    url = LINKS["serial"] + "&loss=0.05&seed=3"
    with open_bus(url, Panel(channels=2)) as bus:
        windows = play(bus, noise(16000, 2))
        output = cast(ModeledBus, bus).output
        rate = bus.wiring.sample_rate
    counters = bus.correlation_counters
    missing = windows[-1].position // 200 + 1 - len(windows)
    assert 0 < counters.gaps <= missing
    assert counters.faults == counters.dropped == 0
    assert_of_capacitors(windows[:3], output, rate)


def test_windows_come_again_after_a_loss_of_power() -> None:
    """An amplifier forgets what it was asked for; the host asks again."""
    bus = cast(ModeledBus, open_bus(LINKS["serial"] + "&rearm=true", Panel(channels=2)))
    with bus:
        bus.start()
        volts = noise(800, 2)
        for k in range(0, 16000, 800):
            if k == 8000:
                bus.model.power_cycle()
            bus.write(DriveBlock(k, volts))
        bus.stop()
        windows = bus.take_correlations()
    positions = [w.position for w in windows]
    assert positions == sorted(positions)
    assert min(positions) == 0
    assert max(positions) > 14000
    assert bus.correlation_counters.faults == 0


def test_positions_are_those_of_the_latest_start() -> None:
    bus = open_bus(LINKS["serial"], Panel(channels=2))
    with bus:
        for begin in (0, 10**10, -500):
            bus.start(begin)
            for k in range(0, 1200, 80):
                bus.write(DriveBlock(begin + k, noise(80, 2)))
            bus.stop()
            windows = bus.take_correlations()
            assert [w.position - begin for w in windows[:5]] == [0, 200, 400, 600, 800]
    assert bus.correlation_counters.faults == 0


def test_only_the_newest_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(correlations, "MOST_WINDOWS", 4)
    with open_bus(LINKS["none"], Panel(channels=2)) as bus:
        bus.start()
        bus.write(DriveBlock(0, noise(2000, 2)))
        bus.stop()
        assert [w.position for w in bus.take_correlations()] == [1200, 1400, 1600, 1800]
        assert bus.take_correlations() == []
    counters = bus.correlation_counters
    assert (counters.windows, counters.dropped, counters.faults) == (10, 6, 0)


@pytest.mark.parametrize("link", ["none", "serial"])
def test_a_drive_that_was_not_what_was_written_is_told(link: str) -> None:
    """Samples that are missing, and steps beyond the slew limit: 6.25 V at 8 kHz."""
    with open_bus(LINKS[link], Panel(channels=2)) as bus:
        windows = play(bus, noise(3000, 2, peak=3.0))
        assert windows
        assert bus.correlation_counters.disturbed == 0
        bus.start()
        bus.write(DriveBlock(0, noise(800, 2, peak=3.0)))
        bus.write(DriveBlock(810, noise(3200, 2, peak=3.0)))
        before = bus.correlation_counters.disturbed
        bus.write(DriveBlock(4010, noise(3200, 2, peak=30.0)))
        bus.stop()
    assert 10 <= before < 20
    assert bus.correlation_counters.disturbed > 3000


# Bad messages

CAPS = m.Caps(channels=4, full_scale_uv=100_000_000)


def window(position: int, first: int = 0, channels: int = 2, **changed: object) -> m.Correlation:
    entries = bytes(ENTRY.itemsize * channels)
    fields = {
        "position": position % 2**32, "range_ua": 2500, "samples": 100, "first_channel": first,
        "channels": channels, "lags": 16, "entries": entries,
    }  # fmt: skip
    return m.Correlation(**(fields | changed))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("messages", "good", "faults", "gaps"),
    [
        ([window(-100), window(0), window(100)], 3, 0, 0),
        ([window(-101)], 0, 1, 0),
        ([window(-99)], 1, 0, 1),
        ([window(-100), window(0), window(0)], 2, 1, 0),
        ([window(-100), window(-1), window(0)], 2, 1, 0),
        ([window(-100), window(100), window(200)], 3, 0, 1),
        ([window(-100), window(-100, 2), window(0, 2), window(0)], 4, 0, 0),
        ([window(-100), window(-100, 1), window(0)], 2, 1, 0),
        ([window(-100, 3)], 0, 1, 0),
        ([window(-100, 255)], 0, 1, 0),
        ([window(-100, lags=15)], 0, 1, 0),
        ([window(-100, samples=0)], 0, 1, 0),
    ],
)
def test_what_overlaps_or_cannot_be_is_counted(
    messages: list[m.Correlation], good: int, faults: int, gaps: int
) -> None:
    """Windows of 100 samples after a START at −100, which wraps."""
    counters = CorrelationCounters()
    decoder = WindowDecoder(counters, 2**32 - 100)
    found = [decoder.decode(message, CAPS, 7, 10) for message in messages]
    assert sum(w is not None for w in found) == good
    assert (counters.faults, counters.gaps) == (faults, gaps)


def test_windows_are_in_si_units() -> None:
    """A current code is 2.5 mA / 32767, a sample code 100 V / 32767; of exponent 3, q = 7 is 56."""
    entries = np.zeros(2, ENTRY)
    entries["exponent"], entries["sums"], entries["energy"] = (3, 0), 7, 2 << 10 | 600
    entries["flags"] = 1, 0
    counters = CorrelationCounters()
    message = window(40, 1, 2, entries=entries.tobytes())
    found = WindowDecoder(counters, 40).decode(message, CAPS, -3, 20)
    assert found is not None
    unit = 2.5e-3 / 32767 * 100 / 32767
    assert found.sums == pytest.approx(np.array([[56.0] * 16, [7.0] * 16]) * unit)
    assert found.rounding == pytest.approx(np.array([4.0, 0.0]) * unit)
    assert found.energy == pytest.approx(np.array([2400.0, 2400.0]) * (2.5e-3 / 32767) ** 2)
    assert found.current_range == pytest.approx(2.5e-3)
    assert found.clipped.tolist() == [True, False]
    assert (found.position, found.samples, found.first_channel) == (-3, 100, 21)


def test_a_window_that_nobody_asked_for_is_counted() -> None:
    """An amplifier that sends one after another session's SET; the host has asked for none."""
    bus = cast(ModeledBus, open_bus("mock:?link=serial&load_pf=100", Panel(channels=2)))
    with bus:
        (amplifier,) = bus.model.amplifiers
        amplifier._settings[m.Parameter.CORRELATION_MS] = 25
        assert play(bus, noise(1000, 2)) == []
    assert bus.correlation_counters.faults > 0


# The sensor


def measured(design: SensorDesign, currents: Floats) -> Floats:
    """Return what a sensor makes of currents (S, C), as currents [A]."""
    channels = currents.shape[1]
    sensor = CurrentSensor(lambda v, r: currents, design, channels=channels, full_scale=100.0)
    codes = sensor.measure(np.zeros(currents.shape, np.int64), int(RATE))
    return np.asarray(codes * (design.ranges[0] / FULL_SCALE_CODE))


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_an_adc_rounds_to_its_steps(bits: int) -> None:
    design = SensorDesign(bits=bits, noise=0.0)
    step = 2.5e-3 / FULL_SCALE_CODE * 2 ** (16 - bits)
    currents = np.linspace(-2.45e-3, 2.45e-3, 9999)[:, None]
    found = measured(design, currents)
    assert np.abs(found - currents).max() <= step / 2 * (1 + 1e-9)
    assert np.allclose(found / step, np.rint(found / step), rtol=0, atol=1e-6)


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_the_ends_of_the_range_are_told_and_nothing_else(bits: int) -> None:
    """The last steps of the ADC are its ends: 2047 and −2048 of 12 bits, and −32767 of 16."""
    design = SensorDesign(bits=bits, noise=0.0)
    step = 2.5e-3 / FULL_SCALE_CODE * 2 ** (16 - bits)
    most = 2 ** (bits - 1)
    steps = np.array([most, most - 1, most - 2, 0, 2 - most, -most, -2 * most])[:, None]
    sensor = CurrentSensor(lambda v, r: steps * step, design, channels=1, full_scale=100.0)
    codes = sensor.measure(np.zeros((7, 1), np.int64), 8000)[:, 0]
    shift = 2 ** (16 - bits)
    assert codes.tolist() == [
        32767, 32767, (most - 2) * shift, 0, (2 - most) * shift, -32767, -32767,
    ]  # fmt: skip


def test_noise_has_its_size_and_comes_from_its_seed() -> None:
    still = np.zeros((20000, 2))
    one, same, other = (measured(SensorDesign(seed=s), still) for s in (5, 5, 6))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)
    # 40 000 draws: the standard deviation is known to 1 part in 280
    assert np.std(one) == pytest.approx(NOISE, rel=0.03)


@pytest.mark.parametrize("frequency", [10.0, 300.0, 1000.0])
@pytest.mark.parametrize("skew", [-1e-6, 0.1e-6, 2e-6])
def test_skew_shifts_a_sine(frequency: float, skew: float) -> None:
    """Compare with the sine at the other time; what is left is of second order, and the slope's."""
    time = np.arange(2000)[:, None] / RATE
    omega = 2 * np.pi * frequency
    design = SensorDesign(bits=16, noise=0.0, skew=skew)
    found = measured(design, 2e-3 * np.sin(omega * time))[10:]
    exact = 2e-3 * np.sin(omega * (time + skew))[10:]
    tolerance = 2e-3 * (0.07 * omega * abs(skew) + (omega * skew) ** 2) + 2.5e-3 / FULL_SCALE_CODE
    assert np.abs(found - exact).max() <= tolerance
    unshifted = np.abs(found - 2e-3 * np.sin(omega * time)[10:]).max()
    assert unshifted == pytest.approx(2e-3 * omega * abs(skew), rel=0.1, abs=1e-7)


def test_runs_of_any_length_are_measured_alike() -> None:
    codes = np.rint(3000 * noise(999, 3)).astype(np.int64)
    design = SensorDesign(skew=1e-6, seed=8)
    whole, parts = (
        CurrentSensor(CapacitiveLoad(LOAD, 3), design, channels=3, full_scale=100.0)
        for _ in range(2)
    )
    found = [parts.measure(piece, 8000) for piece in np.split(codes, [1, 3, 200, 201])]
    assert np.array_equal(whole.measure(codes, 8000), np.vstack(found))


@pytest.mark.parametrize(
    "wrong", [{"bits": 7}, {"bits": 17}, {"ranges": (0.1,)}, {"ranges": (0.0,)}]
)
def test_a_sensor_that_cannot_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match=r"bits|range"):
        SensorDesign(**wrong)  # type: ignore[arg-type]


def test_a_mock_measures_on_one_amplifier_only() -> None:
    wiring = Wiring(channels=256, sample_rate=RATE, voltage=100.0, slew=1e6, fade=0.02)
    with pytest.raises(InputError, match="256 channels"):
        MockBus(wiring, currents=CapacitiveLoad(LOAD, 256))


# The amplifier in C, in real time


@pytest.fixture
def real(virtual_amplifier: Path, tmp_path: Path) -> Iterator[RealBench]:
    bench = RealBench("virtual", virtual_amplifier, tmp_path)
    yield bench
    bench.reset()


LOADS = "--load-pf", "12800,0,400000,short", "--sense-ranges-ua", "2500,20000"


@pytest.mark.realtime
@pytest.mark.usefixtures("unhurried_links")
@pytest.mark.parametrize("link", ["serial", "can"])
def test_the_amplifier_in_c_sends_windows(
    link: str, real: RealBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every window that came is that of what the program wrote that it put out."""
    start = real.amplifier
    monkeypatch.setattr(real, "amplifier", lambda channels, *rest: start(channels, *rest, *LOADS))
    real.url = "pty" if link == "serial" else "virtual"
    amplifier, url = real._reached(4)
    display = Panel(channels=4)
    with open_bus(f"{url}&correlation_ms=20", display, sample_rate=4000) as bus:
        assert bus.correlates
        windows = play(bus, noise(4000, 4))
        assert isinstance(bus, LinkBus)
        origin, rows = bus.peers[0].wire_end(0), amplifier.settled()
    assert len(windows) > 20
    assert bus.correlation_counters.faults == 0
    running = rows[rows["state"] == State.RUNNING]
    begin = int(np.flatnonzero(running["position"] == origin)[-1])
    codes = running["codes"][begin:].astype(np.int64)
    loads = Loads(AmplifierConfig(channels=4, sense_ranges_ua=(2500, 20000)))
    currents = loads.measure(codes, 4000)
    lagged = steps_of(codes.astype(np.float64))
    for w in windows:
        span = slice(w.position, w.position + w.samples)
        sums = np.einsum("sc,slc->cl", currents[span], lagged[span])
        unit = 2.5e-3 / FULL_SCALE_CODE * 100.0 / FULL_SCALE_CODE
        assert np.all(np.abs(w.sums - sums * unit) <= w.rounding[:, None] + 1e-9 * unit)
        assert np.array_equal(w.clipped, (np.abs(currents[span]) == 32767).any(axis=0))
