"""The amplifier between a drive sample and the bimorph's electrodes.

A drive sample means the band-limited signal through the samples, sample k at time k/fs, with no
hold. An amplifier that holds its output between samples, is slow, late or has an output
resistance departs from that; its display file says so and the equalizer inverts it.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tactile.actuator.materials import require_not_negative, require_positive
from tactile.arrays import Complex


@dataclass(frozen=True, kw_only=True)
class Amplifier:
    """A linear piezo amplifier; the default is ideal.

    Parameters
    ----------
    gain : volts out per volt of drive
    bandwidth : corner of its first-order low-pass [Hz]; infinite for none
    output_resistance : in series with the bimorph [Ω]
    hold : "none" (output band-limited through the samples) or "zoh" (held until the next one)
    delay : [s]
    audio_full_scale : volts of drive at digital full scale of an audio card [V]; None if unknown
    ac_coupling : corner of the first-order high-pass of a card's outputs [Hz], 0 for DC coupled

    Raises
    ------
    ValueError
        Naming the value out of range; also where a hold would need infinite current.
    """

    gain: float = 1.0
    bandwidth: float = np.inf
    output_resistance: float = 0.0
    hold: Literal["none", "zoh"] = "none"
    delay: float = 0.0
    audio_full_scale: float | None = None
    ac_coupling: float = 0.0

    def __post_init__(self) -> None:
        require_positive("Amplifier", gain=self.gain)
        if not self.bandwidth > 0:
            raise ValueError(f"Amplifier: bandwidth = {self.bandwidth} is not a number above 0")
        require_not_negative(
            "Amplifier", output_resistance=self.output_resistance, delay=self.delay,
            ac_coupling=self.ac_coupling,
        )  # fmt: skip
        if self.audio_full_scale is not None:
            require_positive("Amplifier", audio_full_scale=self.audio_full_scale)
        if self.hold not in ("none", "zoh"):
            raise ValueError(f"Amplifier: hold = {self.hold!r} is neither 'none' nor 'zoh'")
        if self.hold == "zoh" and np.isinf(self.bandwidth) and self.output_resistance == 0:
            raise ValueError(
                "Amplifier: the steps of hold 'zoh' would draw infinite current; "
                "give a bandwidth or an output resistance"
            )

    @property
    def peak(self) -> float:
        """Largest volts out per volt of the drive's limit, whatever the drive.

        The gain; behind a high-pass twice as much, which takes its own past away: a drive that
        stayed at one limit until the coupling had charged, then at the other.
        """
        return self.gain * (2.0 if self.ac_coupling else 1.0)

    def response(
        self, frequency: NDArray[np.float64], admittance: Complex, sample_rate: float
    ) -> Complex:
        """Return volts at the electrodes per volt of drive.

        Parameters
        ----------
        frequency : (F,) [Hz]
        admittance : (..., F) of the loaded bimorph [S]
        sample_rate : of the drive [Hz]

        Returns
        -------
        (..., F) complex ndarray
            gain / (1 + jf/bandwidth) / (1 + R Y) · exp(−jω delay), and for a zero-order hold
            sinc(f/fs) exp(−jπ f/fs). Without the AC coupling, 1 / (1 + corner/(jf)): its inverse
            is an integrator, which the equalizer's filter of milliseconds cannot be, and which
            would spend the voltage limit on what is slower than the band.
        """
        held = 1.0
        if self.hold == "zoh":
            held = np.sinc(frequency / sample_rate) * np.exp(-1j * np.pi * frequency / sample_rate)
        late = np.exp(-2j * np.pi * frequency * self.delay)
        slow = 1 + 1j * frequency / self.bandwidth
        return np.asarray(
            self.gain * held * late / slow / (1 + self.output_resistance * admittance)
        )
