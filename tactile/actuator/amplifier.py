"""Model of the amplifier between a drive sample and the electrodes of the bimorph.

Drive samples stand for the band-limited signal through them, sample k at time k/fs, without a hold.
An amplifier departs from that if it holds its output between samples, has a limited bandwidth, a
delay or an output resistance. Its display file states these properties, and the equalizer inverts
them.
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
    gain : float
        Output voltage per volt of drive.
    bandwidth : float
        Corner frequency of the first-order low-pass [Hz]; infinite for none.
    output_resistance : float
        Resistance in series with the bimorph [Ω].
    hold : {"none", "zoh"}
        "none" if the output is band-limited through the samples, "zoh" (zero-order hold) if each
        sample is held until the next one.
    delay : float
        Delay of the output [s].
    audio_full_scale : float or None
        Drive at digital full scale of an audio card [V]; None if unknown.
    ac_coupling : float
        Corner frequency of the first-order high-pass at the outputs of an audio card [Hz]; 0 for DC
        coupling.

    Raises
    ------
    ValueError
        If a value is out of range, or if a hold would need infinite current.
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
        """Largest output voltage per volt of the drive limit, over all possible drives.

        Without AC coupling this is the gain. A high-pass doubles it, because it subtracts the past
        of its input: the worst drive stays at one limit until the coupling has charged and then
        jumps to the other.
        """
        return self.gain * (2.0 if self.ac_coupling else 1.0)

    def response(
        self, frequency: NDArray[np.float64], admittance: Complex, sample_rate: float
    ) -> Complex:
        """Compute the voltage at the electrodes per volt of drive.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies [Hz].
        admittance : (..., F) complex array
            Electrical admittance of the loaded bimorph [S].
        sample_rate : float
            Sample rate of the drive [Hz].

        Returns
        -------
        (..., F) complex array
            Voltage at the electrodes per volt of drive [V/V].

        Notes
        -----
        The response is gain / (1 + jf/bandwidth) / (1 + R Y) · exp(−jω delay), multiplied for a
        zero-order hold by sinc(f/fs) exp(−jπ f/fs).

        The factor of the AC coupling, 1 / (1 + corner/(jf)), is left out. Its inverse is an
        integrator, which the equalizer's filter of a few milliseconds cannot realize, and which
        would spend the voltage limit on frequencies below the band.
        """
        hold = 1.0
        if self.hold == "zoh":
            hold = np.sinc(frequency / sample_rate) * np.exp(-1j * np.pi * frequency / sample_rate)
        delay = np.exp(-2j * np.pi * frequency * self.delay)
        low_pass = 1 + 1j * frequency / self.bandwidth
        return np.asarray(
            self.gain * hold * delay / low_pass / (1 + self.output_resistance * admittance)
        )
