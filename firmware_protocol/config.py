"""What an amplifier is, and the limits of what it puts out (sections 4 and 11.1 of SPEC.md)."""

from dataclasses import dataclass
from typing import Self

from firmware_protocol.messages import FADE_MS, FULL_SCALE_CODE, Limits, SampleFormat

LARGEST_STEP = 2 * FULL_SCALE_CODE
FORMATS = sum(1 << f for f in SampleFormat)


@dataclass(frozen=True, kw_only=True)
class AmplifierConfig:
    """What an amplifier is; names and units as in CAPS, ``fifo`` being fifo_samples.

    ``estop_input`` is whether it has an e-stop input, which is mandatory above 60 V (6.3).
    """

    channels: int = 24
    carriers: int = 16
    formats: int = FORMATS
    packet_limit: int = 4096
    fifo: int = 1024
    tick_hz: int = 1_000_000
    rate_min_hz: int = 2500
    rate_max_hz: int = 16000
    full_scale_uv: int = 100_000_000
    voltage_limit_uv: int = 100_000_000
    slew_limit_v_per_s: int = 700_000
    fade_limit_us: int = 20_000
    firmware: int = 0x00010000
    name: str = "virtual"
    node: int = 1
    estop_input: bool = True


@dataclass(frozen=True)
class LimitsInForce:
    """Voltage, slew and fade that bound the output.

    Parameters
    ----------
    full_scale_uv : what the largest sample code stands for
    """

    full_scale_uv: int
    voltage_uv: int
    slew_v_per_s: int
    fade_us: int

    @classmethod
    def of(cls, config: AmplifierConfig) -> Self:
        """Return the hardware's own."""
        c = config
        return cls(c.full_scale_uv, c.voltage_limit_uv, c.slew_limit_v_per_s, c.fade_limit_us)

    def lowered(self, limits: Limits) -> "LimitsInForce | int":
        """Return what LIMITS leaves of them, or the index of the field that is out of range."""
        new = LimitsInForce(
            self.full_scale_uv,
            limits.voltage_uv or self.voltage_uv,
            limits.slew_v_per_s or self.slew_v_per_s,
            limits.fade_us or self.fade_us,
        )
        for index, name in enumerate(("voltage_uv", "slew_v_per_s", "fade_us"), 1):
            if getattr(new, name) > getattr(self, name):
                return index
        return new

    def in_time(self, rate: int) -> bool:
        """Return whether they reach 0 V in 20 ms."""
        return self.code <= self.step(rate) * (rate * FADE_MS // 1000)

    @property
    def code(self) -> int:
        """Largest sample code."""
        return min(self.voltage_uv * FULL_SCALE_CODE // self.full_scale_uv, FULL_SCALE_CODE)

    def step(self, rate: int) -> int:
        """Return the largest change of the sample code in an instant."""
        most = self.slew_v_per_s * FULL_SCALE_CODE * 10**6
        return min(most // (self.full_scale_uv * rate), LARGEST_STEP)

    def fade(self, rate: int) -> int:
        """Return the instants of a full fade."""
        return max(1, (self.fade_us * rate + 500_000) // 1_000_000)
