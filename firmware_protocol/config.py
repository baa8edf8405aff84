"""Properties of an amplifier, and the limits of its output (sections 4 and 11.1 of SPEC.md)."""

from dataclasses import dataclass
from typing import Self

from firmware_protocol.messages import (
    FADE_MS,
    FULL_SCALE_CODE,
    MAJOR,
    MINOR,
    SCHEMA_CRC,
    Caps,
    Limits,
    SampleFormat,
)

LARGEST_STEP = 2 * FULL_SCALE_CODE
"""Largest change between two sample codes."""
FORMATS = sum(1 << f for f in SampleFormat)
"""Bit mask of all sample formats, as in CAPS."""


@dataclass(frozen=True, kw_only=True)
class AmplifierConfig:
    """Properties of an amplifier, with names and units as in CAPS.

    Attributes
    ----------
    channels, carriers : int
        Number of channels, and largest number of carriers.
    formats : int
        Bit mask of the sample formats.
    packet_limit : int
        Largest packet [bytes].
    fifo : int
        Depth of the sample buffer, fifo_samples of CAPS [samples].
    tick_hz : int
        Frequency of the amplifier's clock [Hz].
    rate_min_hz, rate_max_hz : int
        Range of the sample rate [Hz].
    full_scale_uv : int
        Voltage of the largest sample code [µV].
    voltage_limit_uv : int
        Hardware limit of the voltage [µV].
    slew_limit_v_per_s : int
        Hardware limit of the slew rate [V/s].
    fade_limit_us : int
        Longest fade [µs].
    firmware : int
        Version of the firmware.
    name : str
        Name of the amplifier.
    node : int
        Node address at power-up.
    estop_input : bool
        Whether there is an e-stop input, which is mandatory above 60 V (6.3).
    sense_ranges_ua : tuple of int
        Ranges of the current that CORRELATION measures, that at power-up first [µA]; empty for an
        amplifier that does not correlate.
    current_delay : int
        Number of instants by which currents are late, as converters and filters delay them (16.1).
    marker_lines : int
        Number of marker lines, 0 for none (18).
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
    sense_ranges_ua: tuple[int, ...] = ()
    current_delay: int = 0
    marker_lines: int = 0

    def caps(self, session: int, features: int) -> Caps:
        """Return what the amplifier tells of itself.

        Parameters
        ----------
        session : int
            Token of the host that holds it, 0 for none.
        features : int
            Bits of `Feature`.

        Returns
        -------
        Caps
            Answer to HELLO.
        """
        return Caps(
            session, MAJOR, MINOR, SCHEMA_CRC, self.channels, self.carriers, self.formats,
            features, self.packet_limit, self.fifo, self.tick_hz, self.rate_min_hz,
            self.rate_max_hz, self.full_scale_uv, self.voltage_limit_uv, self.slew_limit_v_per_s,
            self.fade_limit_us, self.firmware, self.name.encode(), self.marker_lines,
        )  # fmt: skip


@dataclass(frozen=True)
class LimitsInForce:
    """Voltage, slew rate and fade that bound the output at present.

    Parameters
    ----------
    full_scale_uv : int
        Voltage of the largest sample code [µV].
    voltage_uv : int
        Largest voltage [µV].
    slew_v_per_s : int
        Largest slew rate [V/s].
    fade_us : int
        Length of a full fade [µs].
    """

    full_scale_uv: int
    voltage_uv: int
    slew_v_per_s: int
    fade_us: int

    @classmethod
    def of(cls, config: AmplifierConfig) -> Self:
        """Return the limits of an amplifier's hardware.

        Parameters
        ----------
        config : AmplifierConfig
            Properties of the amplifier.

        Returns
        -------
        LimitsInForce
            Its largest limits.
        """
        c = config
        return cls(c.full_scale_uv, c.voltage_limit_uv, c.slew_limit_v_per_s, c.fade_limit_us)

    def lowered(self, limits: Limits) -> "LimitsInForce | int":
        """Apply a LIMITS message.

        Parameters
        ----------
        limits : Limits
            Message; a value of 0 leaves a limit unchanged.

        Returns
        -------
        LimitsInForce or int
            New limits, or the index of the field that would raise a limit.
        """
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
        """Test whether the output reaches 0 V in 20 ms from any voltage within the limits.

        Parameters
        ----------
        rate : int
            Sample rate [Hz].

        Returns
        -------
        bool
            Whether the limits keep the promise of section 11.1.
        """
        return self.code <= self.step(rate) * (rate * FADE_MS // 1000)

    @property
    def code(self) -> int:
        """Largest sample code."""
        return min(self.voltage_uv * FULL_SCALE_CODE // self.full_scale_uv, FULL_SCALE_CODE)

    def step(self, rate: int) -> int:
        """Compute the largest change of the sample code from one sample instant to the next.

        Parameters
        ----------
        rate : int
            Sample rate [Hz].

        Returns
        -------
        int
            Largest change [sample codes].
        """
        most = self.slew_v_per_s * FULL_SCALE_CODE * 10**6
        return min(most // (self.full_scale_uv * rate), LARGEST_STEP)

    def fade(self, rate: int) -> int:
        """Compute the length of a full fade.

        Parameters
        ----------
        rate : int
            Sample rate [Hz].

        Returns
        -------
        int
            Length of the fade, at least 1 [samples].
        """
        return max(1, (self.fade_us * rate + 500_000) // 1_000_000)
