"""The undriven and the held tip of a bender over frequency, for a design and its deviations."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from tactile.actuator.amplifier import Amplifier
from tactile.actuator.bimorph import Bimorph
from tactile.actuator.finger import FingerLoad
from tactile.actuator.response import blocked_force, tip_response
from tactile.arrays import Complex, Floats

GRID = np.arange(0.0, 4001.0, 5.0)
"""Frequencies at which a design is computed, from 0 Hz to above all that is measured; force and
stiffness of a tip vary slowly even where that in air resonates [Hz]."""

RESONANCE_BELOW = 0.6
"""Part of the frequencies of a design in which its resonance is sought; the second resonance is six
times as high as the first."""


@dataclass(frozen=True)
class Deviations:
    """Deviations of N benders from their design, as factors.

    A factor e of all elastic constants moves each resonance by √e: S(f) = e S₀(f/√e). The mass
    cannot be told from the current, since (F, S, k, u) and (αF, α²S, α²k, u/α) draw the same; it
    is taken to be that of the design, and 2 % of mass are 0.1 dB of shear.

    Attributes
    ----------
    stiffness : (N,) array of float
        Factor of the elastic constants.
    coupling : (N,) array of float
        Factor of d31.
    loss : (N,) array of float
        Factor of the mechanical loss factor 1/Q.
    """

    stiffness: Floats
    coupling: Floats
    loss: Floats


@dataclass(frozen=True)
class Bender:
    """Force of the held tip and stiffness of the undriven tip of a design.

    Attributes
    ----------
    frequency : (K,) array of float
        Frequencies from 0 Hz up, in steps small against the width of the resonance [Hz].
    force : (K,) complex array
        Force of the held tip per volt at the electrodes, F [N/V].
    stiffness : (K,) complex array
        Dynamic stiffness of the undriven tip, S [N/m].
    amplifier : (K,) complex array
        Voltage at the electrodes per volt of drive.
    capacitance : float
        Capacitance at rest with the tip held, clamped length included [F].
    """

    frequency: Floats
    force: Complex
    stiffness: Complex
    amplifier: Complex
    capacitance: float

    @cached_property
    def _splines(self) -> tuple[CubicSpline[np.complex128], ...]:
        """Splines of force, stiffness and amplifier over frequency."""
        values = self.force, self.stiffness, self.amplifier
        return tuple(CubicSpline(self.frequency, value) for value in values)

    def electrode_voltage(self, frequency: Floats) -> Complex:
        """Evaluate the amplifier.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies [Hz].

        Returns
        -------
        (F,) complex array
            Voltage at the electrodes per volt of drive.
        """
        return np.asarray(self._splines[2](frequency))

    @cached_property
    def resonance(self) -> float:
        """Resonance in air, where the tip moves most in the lower half of the band [Hz]."""
        lower = self.frequency < RESONANCE_BELOW * self.frequency[-1]
        moved = np.abs(self.force[lower] / self.stiffness[lower])
        return float(self.frequency[lower][np.argmax(moved)])

    def at(self, frequency: Floats, deviations: Deviations) -> tuple[Complex, Complex]:
        """Evaluate the design with deviations.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies [Hz].
        deviations : Deviations
            Deviations of N benders.

        Returns
        -------
        force : (N, F) complex array
            Force of the held tip per volt at the electrodes [N/V].
        stiffness : (N, F) complex array
            Dynamic stiffness of the undriven tip [N/m].
        """
        e = np.asarray(deviations.stiffness, np.float64)[:, None]
        at = np.clip(frequency / np.sqrt(e), 0, self.frequency[-1])
        force, stiffness, _ = (spline(at) for spline in self._splines)
        loss = np.asarray(deviations.loss)[:, None]
        return (
            e * np.asarray(deviations.coupling)[:, None] * force,
            np.asarray(e * (stiffness.real + 1j * loss * stiffness.imag)),
        )


def bender_of(bimorph: Bimorph, amplifier: Amplifier, sample_rate: float) -> Bender:
    """Compute the tip of a display's bimorph behind its amplifier.

    Parameters
    ----------
    bimorph : Bimorph
        Geometry and materials.
    amplifier : Amplifier
        Amplifier between drive and electrodes; its output resistance sees the bender in air.
    sample_rate : float
        Sample rate of the drive [Hz].

    Returns
    -------
    Bender
        The design.
    """
    force, stiffness = blocked_force(bimorph, GRID)
    admittance = tip_response(bimorph, FingerLoad.none(), GRID).admittance
    held = admittance[1] / (2j * np.pi * GRID[1]) - force[1] ** 2 / stiffness[1]
    electrodes = amplifier.response(GRID, admittance, sample_rate)
    return Bender(GRID, force, stiffness, electrodes, float(held.real))
