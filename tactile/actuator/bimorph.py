"""Electromechanical model of a layered bimorph: a shim between two equal piezo layers.

Both layers are poled the same way and driven in parallel, the shim against the outer electrodes.
The field in each layer is then U/h_p and the voltage bends the beam: M = EI ψ' − K U, and the
current is I = jω C_p U + K (ψ̇₂ − ψ̇₁). With the usual negative d31, a positive voltage moves the
tip towards positive u. Source: Hofmann & Twiefel 2014 (see `tactile.actuator`), corrected.

Wired in series, the layers are poled oppositely and the voltage lies across both, from one outer
electrode to the other, with the shim floating. Bending strains the layers oppositely, so that their
charges are equal. Each layer then has half the voltage, E3 = U/(2 h_p), and the charge of one layer
is the charge of the bender. With voltage and charge halved, K is half and C_p a quarter of those in
parallel (also in Smits, Dalke & Cooney, Sensors and Actuators A 28, 1991, and Wang & Cross,
Ferroelectrics 215, 1998). At equal field, that is at twice the voltage, a bender in series bends as
it does in parallel and takes the same energy.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tactile.actuator.beam import CrossSection, transition
from tactile.actuator.materials import (
    CFRP,
    PIEZO_3203HD,
    PiezoMaterial,
    Real,
    ShimMaterial,
    require_not_negative,
    require_positive,
)
from tactile.arrays import Complex

SHEAR_FACTOR = 5 / 6
"""Shear correction factor κ² of a rectangular cross-section (Timoshenko)."""


@dataclass(frozen=True)
class Segment:
    """A length of beam with one cross-section, passive if coupling and capacitance are zero.

    Parameters
    ----------
    section : CrossSection
        Cross-section (`tactile.actuator.beam`).
    length : array of float
        Length [m].
    coupling : complex array
        Electromechanical coupling K: bending moment per volt, and charge per rotation [N m/V = C].
    capacitance : complex array
        Capacitance C_p with bending blocked [F].
    """

    section: CrossSection
    length: NDArray[np.float64]
    coupling: Complex
    capacitance: Complex

    def cut(self, fraction: Real) -> tuple["Segment", "Segment"]:
        """Cut the segment in two.

        Parameters
        ----------
        fraction : float or array of float
            Length of the first part as a fraction of the whole length.

        Returns
        -------
        tuple of Segment
            The two parts.
        """
        share = np.asarray(fraction)
        return (
            replace(self, length=self.length * share, capacitance=self.capacitance * share),
            replace(
                self, length=self.length * (1 - share), capacitance=self.capacitance * (1 - share)
            ),
        )


@dataclass(frozen=True, kw_only=True)
class Bimorph:
    """A bimorph cantilever; the default values describe the default design.

    Any number may be an array; the arrays broadcast, with one element per design.

    Parameters
    ----------
    width, length, clamped_length : float or array of float
        Width, free length from the clamp to the tip, and clamped length [m].
    piezo_height, shim_height : float or array of float
        Thickness of one piezo layer and of the shim [m].
    piezo : PiezoMaterial
        Material of the piezo layers.
    shim : ShimMaterial
        Material of the shim.
    layer_stiffening : bool
        Whether to add ΔEI = w h_p³/6 · (1/s11E) · k31²/(1−k31²), the stiffening by the electric
        field that bending causes within each layer. Compared with a two-dimensional piezoelectric
        solution the first resonance is 1 % low without it (the model of the paper) and 0.05 % low
        with it.
    series : bool or array of bool
        Whether the layers are wired in series instead of in parallel.

    Raises
    ------
    ValueError
        If a dimension is not finite or has the wrong sign, or if ``series`` is not a bool.

    Notes
    -----
    The paper gives its parameters in a figure that is not available as text, so the default design
    is a documented surrogate. Its width is that of a bender of the MTP35×2.1×0.7 class and its
    length the paper's optimum. Clamped length and piezo thickness are assumed. The shim thickness
    is chosen so that the optimum ranges of length agree with those of the paper.

    Examples
    --------
    A bender of twice the length, wired in series: each layer then has half the voltage.

    >>> import tactile
    >>> bender = tactile.Bimorph(length=40e-3, series=True)
    >>> round(float(bender.height) * 1e3, 3)
    0.72
    >>> float(bender.layer_voltage)
    0.5
    """

    width: Real = 2.1e-3
    length: Real = 20e-3
    clamped_length: Real = 5e-3
    piezo_height: Real = 0.26e-3
    shim_height: Real = 0.20e-3
    piezo: PiezoMaterial = field(default=PIEZO_3203HD)
    shim: ShimMaterial = field(default=CFRP)
    layer_stiffening: bool = False
    series: bool | NDArray[np.bool_] = False

    def __post_init__(self) -> None:
        if np.asarray(self.series).dtype != np.bool_:
            raise ValueError(f"Bimorph: series = {self.series} is neither True nor False")
        require_positive(
            "Bimorph", width=self.width, length=self.length, piezo_height=self.piezo_height
        )
        require_not_negative(
            "Bimorph", clamped_length=self.clamped_length, shim_height=self.shim_height
        )

    @property
    def height(self) -> NDArray[np.float64]:
        """Total thickness of the three layers [m]."""
        return 2 * np.asarray(self.piezo_height) + self.shim_height

    @property
    def layer_voltage(self) -> NDArray[np.float64]:
        """Share of the voltage that lies across each layer: 1 in parallel, 1/2 in series."""
        return np.where(self.series, 0.5, 1.0)


def section(bimorph: Bimorph) -> CrossSection:
    """Compute the stiffnesses and inertias of the layered cross-section.

    Parameters
    ----------
    bimorph : Bimorph
        Geometry and materials.

    Returns
    -------
    CrossSection
        Bending and shear stiffness (complex, with losses), mass and rotary inertia per length.

    Notes
    -----
    EI = w/s11s h_s³/12 + w/s11E I2, AG = κ² w (h_s/s55s + 2 h_p/s55E), m = w (ρ_s h_s + 2 ρ_p h_p)
    and ρI = w (ρ_s h_s³/12 + ρ_p I2), where I2 = (2/3)((h_p + h_s/2)³ − (h_s/2)³) is the second
    moment of area of both piezo layers per width.
    """
    p, s, w = bimorph.piezo, bimorph.shim, np.asarray(bimorph.width)
    hp, hs = np.asarray(bimorph.piezo_height), np.asarray(bimorph.shim_height)
    piezo_loss, shim_loss = (
        1 + 1j / np.asarray(p.quality_factor),
        1 + 1j / np.asarray(s.quality_factor),
    )
    second_moment = 2 / 3 * ((hp + hs / 2) ** 3 - (hs / 2) ** 3)
    EI = w * (shim_loss / s.s11 * hs**3 / 12 + piezo_loss / p.s11E * second_moment)
    if bimorph.layer_stiffening:
        k2 = p.coupling_squared
        EI = EI + w * hp**3 / 6 * piezo_loss / p.s11E * k2 / (1 - k2)
    return CrossSection(
        EI=EI,
        AG=SHEAR_FACTOR * w * (hs * shim_loss / s.s55 + 2 * hp * piezo_loss / p.s55E),
        m=w * (s.density * hs + 2 * p.density * hp),
        rhoI=w * (s.density * hs**3 / 12 + p.density * second_moment),
    )


def coupling(bimorph: Bimorph) -> Complex:
    """Compute the electromechanical coupling K = w d31 (h_s + h_p)/s11E, or half of it in series.

    Parameters
    ----------
    bimorph : Bimorph
        Geometry, materials and wiring.

    Returns
    -------
    complex array
        Bending moment per volt [N m/V].
    """
    p = bimorph.piezo
    d31 = p.d31 * (1 - 1j * np.asarray(p.piezo_loss_tangent))
    stiffness = (1 + 1j / np.asarray(p.quality_factor)) / p.s11E
    K = bimorph.width * d31 * (np.asarray(bimorph.shim_height) + bimorph.piezo_height) * stiffness
    return np.asarray(K * bimorph.layer_voltage, np.complex128)


def capacitance(bimorph: Bimorph, length: Real) -> Complex:
    """Compute the capacitance of a length of bender with bending blocked.

    Parameters
    ----------
    bimorph : Bimorph
        Geometry, materials and wiring.
    length : float or array of float
        Length l of the electrodes [m].

    Returns
    -------
    complex array
        C_p = (2 w l/h_p)(ε33T − d31²/s11E), or a quarter of it in series [F].
    """
    p = bimorph.piezo
    d31 = p.d31 * (1 - 1j * np.asarray(p.piezo_loss_tangent))
    permittivity = p.eps33T * (1 - 1j * np.asarray(p.loss_tangent))
    clamped = permittivity - d31**2 * (1 + 1j / np.asarray(p.quality_factor)) / p.s11E
    area = bimorph.width * np.asarray(length) * bimorph.layer_voltage**2
    return np.asarray(2 * area / bimorph.piezo_height * clamped, np.complex128)


def active_segment(bimorph: Bimorph) -> Segment:
    """Return the free length of the bimorph as a driven segment.

    Parameters
    ----------
    bimorph : Bimorph
        Geometry, materials and wiring.

    Returns
    -------
    Segment
        Segment with coupling and capacitance.
    """
    return Segment(
        section(bimorph),
        np.asarray(bimorph.length, np.float64),
        coupling(bimorph),
        capacitance(bimorph, bimorph.length),
    )


def passive_segment(bimorph: Bimorph, length: Real) -> Segment:
    """Return a length of the same layers without drive.

    The electrodes are assumed to be shorted or absent, so that no electric field stiffens the
    layers.

    Parameters
    ----------
    bimorph : Bimorph
        Geometry and materials.
    length : float or array of float
        Length of the segment [m].

    Returns
    -------
    Segment
        Segment without coupling and capacitance.

    Raises
    ------
    ValueError
        If the length is not finite or not above zero.
    """
    require_positive("passive segment", length=length)
    none = np.zeros((), np.complex128)
    return Segment(section(bimorph), np.asarray(length, np.float64), none, none)


def transfer_matrix(segment: Segment, frequency: ArrayLike, *, axial_force: Real = 0.0) -> Complex:
    """Compute the 5 × 5 transfer matrix of a segment.

    Parameters
    ----------
    segment : Segment
        Segment with constants of shape (...,) over designs.
    frequency : (F,) array_like of float
        Frequencies, above zero [Hz].
    axial_force : float or (...,) array of float
        Axial tension [N].

    Returns
    -------
    (..., F, 5, 5) complex array
        Matrix from [v, ψ̇, M, F, U] at the start to [v, ψ̇, M, F, I] at the end, in SI units and at
        exp(+jωt).

    Notes
    -----
    Column U is K times column M, minus K in row M. Row I is K times row ψ̇, minus K in column ψ̇.
    Entry (I, U) is jωC_p + K T(ψ̇, U).
    """
    omega = 2 * np.pi * np.asarray(frequency, np.float64)
    over = over_frequency(segment)
    t = transition(over.section, over.length, omega, np.asarray(axial_force)[..., None])
    rows = [[*t.ww[i], *t.wf[i]] for i in (0, 1)] + [[*t.fw[i], *t.ff[i]] for i in (0, 1)]
    T = np.zeros((*np.broadcast_shapes(rows[0][0].shape, omega.shape), 5, 5), np.complex128)
    for i in range(4):
        for k in range(4):
            T[..., i, k] = rows[i][k] * (1j * omega) ** (int(i < 2) - int(k < 2))
    K = over.coupling
    T[..., :4, 4] = K[..., None] * T[..., :4, 2]
    T[..., 2, 4] -= K
    T[..., 4, :] = K[..., None] * T[..., 1, :]
    T[..., 4, 1] -= K
    T[..., 4, 4] += 1j * omega * over.capacitance
    return T


def over_frequency(segment: Segment) -> Segment:
    """Append an axis of length one to each constant of a segment, to broadcast over frequency.

    Parameters
    ----------
    segment : Segment
        Segment with constants of shape (...,).

    Returns
    -------
    Segment
        The same segment with constants of shape (..., 1).
    """
    s = segment.section
    return Segment(
        CrossSection(
            s.EI[..., None],
            s.AG[..., None],
            np.asarray(s.m)[..., None],
            np.asarray(s.rhoI)[..., None],
        ),
        segment.length[..., None],
        segment.coupling[..., None],
        segment.capacitance[..., None],
    )
