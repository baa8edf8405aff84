"""A whole run: display, texture, path and device brought together, played, judged and recorded."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tactile.bus.base import Floats
from tactile.daemon.playback import PlayedBlock, play
from tactile.devices import open_bus
from tactile.display import Display
from tactile.recording import Recorder
from tactile.rendering.contact import Trajectory
from tactile.rendering.equalizer import PASS_BAND
from tactile.rendering.renderer import Renderer
from tactile.sim import Fidelity, SimulatedDisplay
from tactile.texture.surface import Texture


@dataclass
class Summary:
    """What came of a run; keys carry their units.

    ``signal_to_error_db`` is played against commanded shear in 20–1000 Hz, on a simulated display;
    ``attainable_um`` the peak shear that full drive attains at the worst frequency to 1000 Hz.
    """

    texture: str
    display: str
    device: str
    seconds: float = 0.0
    samples: int = 0
    peak_drive_v: float = 0.0
    voltage_limit_v: float = 0.0
    rms_shear_um: float = 0.0
    peak_shear_um: float = 0.0
    attainable_um: float = 0.0
    equalizer_error_db: float = 0.0
    limited_samples: int = 0
    invalid_samples: int = 0
    signal_to_error_db: float | None = None
    peak_current_ma: float | None = None
    faults: dict[str, int] = field(default_factory=dict)
    recording: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


class _Run:
    """Takes the blocks as they are played and keeps account of them."""

    def __init__(
        self, summary: Summary, simulated: SimulatedDisplay | None, rate: float, delay: int
    ) -> None:
        self.summary, self._simulated = summary, simulated
        self._fidelity = Fidelity(rate)
        self._preroll = delay
        self._waiting: list[PlayedBlock] = []
        self._felt = np.zeros((0, 0))
        self._square = 0.0

    def account(self, block: PlayedBlock) -> None:
        """Count a block in."""
        s = self.summary
        s.samples += len(block.time)
        s.peak_drive_v = max(s.peak_drive_v, float(np.abs(block.drive).max()))
        s.peak_shear_um = max(s.peak_shear_um, float(np.abs(block.shear).max()) * 1e6)
        self._square += float(np.mean(block.shear**2, axis=1).sum())

    def paired(self, block: PlayedBlock | None) -> list[tuple[PlayedBlock, Floats | None]]:
        """Return the blocks whose played shear is known by now, with it."""
        if self._simulated is None:
            return [] if block is None else [(block, None)]
        if block is not None:
            self._waiting.append(block)
        felt = self._simulated.take_shear()
        skipped = min(self._preroll, len(felt))
        self._preroll -= skipped
        self._felt = np.concatenate([self._felt.reshape(-1, felt.shape[1]), felt[skipped:]])
        pairs: list[tuple[PlayedBlock, Floats | None]] = []
        while self._waiting and len(self._felt) >= len(self._waiting[0].time):
            done = self._waiting.pop(0)
            count = len(done.time)
            self._fidelity.add(done.shear, self._felt[:count])
            pairs.append((done, self._felt[:count]))
            self._felt = self._felt[count:]
        return pairs

    def finish(self, renderer: Renderer, rate: float) -> None:
        """Complete the summary."""
        s = self.summary
        s.seconds = s.samples / rate
        s.rms_shear_um = float(np.sqrt(self._square / max(s.samples, 1))) * 1e6
        s.limited_samples = renderer.limiter.limited_samples
        s.invalid_samples = renderer.invalid_samples + renderer.limiter.invalid_samples
        band = renderer.frequency <= PASS_BAND
        s.attainable_um = float(renderer.attainable[..., band].min()) * 1e6
        s.equalizer_error_db = float(20 * np.log10(1 + renderer.filter.error))
        if self._simulated is not None:
            ratio = self._fidelity.signal_to_error_db
            s.signal_to_error_db = ratio if np.isfinite(ratio) else None
            s.peak_current_ma = self._simulated.peak_current * 1e3


def run(
    display: Display,
    texture: Texture,
    trajectory: Trajectory,
    *,
    device: str = "sim:",
    sample_rate: float = 8000.0,
    seed: int = 0,
    record: Path | None = None,
    watch: Callable[[PlayedBlock, Renderer], None] | None = None,
    realtime: bool = False,
) -> Summary:
    """Play a texture along a trajectory on a device.

    Parameters
    ----------
    display, texture, trajectory : what plays what, where
    device : URL of the bus
    sample_rate : of the drive [Hz]
    seed : of the surface's realization
    record : ``.npz`` to write: drive_v, shear_target_m, time_s, position_mm, sample_rate_hz,
        contactors_mm and, from a simulated display, shear_played_m
    watch : called after each block
    realtime : play in step with the clock

    Raises
    ------
    TactileError
        For a device or file that cannot be used.
    """
    renderer = Renderer(display, texture, sample_rate=sample_rate, seed=seed)
    summary = Summary(texture.name, display.name, device, voltage_limit_v=display.limits.voltage)
    with open_bus(device, display, sample_rate=sample_rate) as bus:
        simulated = bus if isinstance(bus, SimulatedDisplay) else None
        account = _Run(summary, simulated, sample_rate, renderer.delay)
        recorder = None
        if record is not None:
            recorder = Recorder(
                record, sample_rate_hz=sample_rate, contactors_mm=display.contactors * 1e3
            )
            summary.recording = str(record)

        def write(block: PlayedBlock | None) -> None:
            for done, felt in account.paired(block):
                if recorder is not None:
                    recorder.add(**_rows(done, felt))

        def listen(block: PlayedBlock) -> None:
            account.account(block)
            write(block)
            if watch is not None:
                watch(block, renderer)

        with recorder if recorder is not None else nullcontext():
            play(
                display, renderer, trajectory, bus,
                sample_rate=sample_rate, listen=listen, realtime=realtime,
            )  # fmt: skip
            if simulated is not None:
                simulated.settle()
            write(None)
        summary.faults = bus.counters.faults()
    account.finish(renderer, sample_rate)
    return summary


def _rows(block: PlayedBlock, felt: Floats | None) -> dict[str, Floats]:
    rows = {
        "drive_v": block.drive,
        "shear_target_m": block.shear,
        "time_s": block.time,
        "position_mm": block.position * 1e3,
    }
    return rows if felt is None else rows | {"shear_played_m": felt}
