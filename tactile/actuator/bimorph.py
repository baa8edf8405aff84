"""A layered bimorph: shim between two equal piezo layers, and its electromechanical matrix.

Both layers are poled the same way and driven in parallel, the shim against the outer electrodes,
so that the field in each is U/h_p and the voltage bends: M = EI ψ' − K U, and the current is
I = jω C_p U + K (ψ̇₂ − ψ̇₁). With the usual negative d31 a positive voltage moves the tip towards
positive u. Source: Hofmann & Twiefel 2014 (see `tactile.actuator`), corrected.

Wired in series the layers are poled oppositely and the voltage lies across both, from one outer
electrode to the other, the shim floating. Bending strains the layers oppositely, so that their
charges are the same; each has half the voltage then, E3 = U/(2 h_p), and the charge of one layer
is the charge of both. With voltage and charge halved, K is half and C_p a quarter of those in
parallel (so also Smits, Dalke & Cooney, Sensors and Actuators A 28, 1991; Wang & Cross,
Ferroelectrics 215, 1998). At equal field, that is twice the voltage, a bender bends as in parallel
and takes the same energy.
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
"""κ² of a rectangular cross-section (Timoshenko)."""


@dataclass(frozen=True)
class Segment:
    """A length of beam with one cross-section: passive where coupling and capacitance are zero.

    Parameters
    ----------
    section : `beam.Section`
    length : [m]
    coupling : K, bending moment per volt and charge per rotation [N m/V = C]
    capacitance : C_p with bending blocked [F]
    """

    section: CrossSection
    length: NDArray[np.float64]
    coupling: Complex
    capacitance: Complex

    def cut(self, fraction: Real) -> tuple["Segment", "Segment"]:
        """Return the two parts of the segment cut at a fraction of its length."""
        share = np.asarray(fraction)
        return (
            replace(self, length=self.length * share, capacitance=self.capacitance * share),
            replace(
                self, length=self.length * (1 - share), capacitance=self.capacitance * (1 - share)
            ),
        )


@dataclass(frozen=True, kw_only=True)
class Bimorph:
    """A bimorph cantilever; the defaults are the default design.

    Any number may be an array: they broadcast, one element a design.

    Parameters
    ----------
    width, length, clamped_length : [m]; length is free, from the clamp to the tip
    piezo_height, shim_height : of one layer [m]
    piezo, shim : materials
    series : True where the layers are wired in series, False in parallel
    layer_stiffening : adds ΔEI = w h_p³/6 · (1/s11E) · k31²/(1−k31²), the stiffening by the field
        that bending makes within each layer. Without it (the paper's model) the first resonance
        is 1 % low against a two-dimensional piezoelectric solid, with it 0.05 %.

    Raises
    ------
    ValueError
        Naming the dimension that is not finite or has the wrong sign, or a wiring that is no bool.

    Notes
    -----
    The paper's parameter figure is not available as text; the default design is a documented
    surrogate. Width and length: a bender of the MTP35×2.1×0.7 class and the paper's optimum
    length; clamped length and piezo height assumed; shim height chosen so that the optimum
    ranges of length agree with the paper's.
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
        """Total height of the three layers [m]."""
        return 2 * np.asarray(self.piezo_height) + self.shim_height

    @property
    def layer_voltage(self) -> NDArray[np.float64]:
        """Share of the voltage that lies across each layer: 1 in parallel, 1/2 in series."""
        return np.where(self.series, 0.5, 1.0)


def section(bimorph: Bimorph) -> CrossSection:
    """Return the cross-section's constants.

    EI = w/s11s h_s³/12 + w/s11E I2, AG = κ² w (h_s/s55s + 2 h_p/s55E), m = w (ρ_s h_s + 2 ρ_p h_p)
    and ρI = w (ρ_s h_s³/12 + ρ_p I2), with I2 = (2/3)((h_p + h_s/2)³ − (h_s/2)³) the second moment
    of both piezo layers per width.
    """
    p, s, w = bimorph.piezo, bimorph.shim, np.asarray(bimorph.width)
    hp, hs = np.asarray(bimorph.piezo_height), np.asarray(bimorph.shim_height)
    piezo_loss, shim_loss = (
        1 + 1j / np.asarray(p.quality_factor),
        1 + 1j / np.asarray(s.quality_factor),
    )
    both = 2 / 3 * ((hp + hs / 2) ** 3 - (hs / 2) ** 3)
    EI = w * (shim_loss / s.s11 * hs**3 / 12 + piezo_loss / p.s11E * both)
    if bimorph.layer_stiffening:
        k2 = p.coupling_squared
        EI = EI + w * hp**3 / 6 * piezo_loss / p.s11E * k2 / (1 - k2)
    return CrossSection(
        EI=EI,
        AG=SHEAR_FACTOR * w * (hs * shim_loss / s.s55 + 2 * hp * piezo_loss / p.s55E),
        m=w * (s.density * hs + 2 * p.density * hp),
        rhoI=w * (s.density * hs**3 / 12 + p.density * both),
    )


def coupling(bimorph: Bimorph) -> Complex:
    """Return K = w d31 (h_s + h_p)/s11E [N m/V], complex; half of it in series."""
    p = bimorph.piezo
    d31 = p.d31 * (1 - 1j * np.asarray(p.piezo_loss_tangent))
    stiffness = (1 + 1j / np.asarray(p.quality_factor)) / p.s11E
    K = bimorph.width * d31 * (np.asarray(bimorph.shim_height) + bimorph.piezo_height) * stiffness
    return np.asarray(K * bimorph.layer_voltage, np.complex128)


def capacitance(bimorph: Bimorph, length: Real) -> Complex:
    """Return C_p = (2 w l/h_p)(ε33T − d31²/s11E) [F] of a length l of bender, complex.

    In series it is a quarter of it.
    """
    p = bimorph.piezo
    d31 = p.d31 * (1 - 1j * np.asarray(p.piezo_loss_tangent))
    permittivity = p.eps33T * (1 - 1j * np.asarray(p.loss_tangent))
    clamped = permittivity - d31**2 * (1 + 1j / np.asarray(p.quality_factor)) / p.s11E
    area = bimorph.width * np.asarray(length) * bimorph.layer_voltage**2
    return np.asarray(2 * area / bimorph.piezo_height * clamped, np.complex128)


def active_segment(bimorph: Bimorph) -> Segment:
    """Return the free length of the bimorph as a driven segment."""
    return Segment(
        section(bimorph),
        np.asarray(bimorph.length, np.float64),
        coupling(bimorph),
        capacitance(bimorph, bimorph.length),
    )


def passive_segment(bimorph: Bimorph, length: Real) -> Segment:
    """Return a length of the same layers whose electrodes are not driven.

    The electrode is taken as absent (shorted): its field does not stiffen the layer.
    """
    require_positive("passive segment", length=length)
    none = np.zeros((), np.complex128)
    return Segment(section(bimorph), np.asarray(length, np.float64), none, none)


def transfer_matrix(segment: Segment, frequency: ArrayLike, *, axial_force: Real = 0.0) -> Complex:
    """Return the 5 × 5 transfer matrix of a segment.

    Parameters
    ----------
    segment : constants of shape (...,) over designs
    frequency : (F,) [Hz], above zero
    axial_force : tension [N], of shape (...,)

    Returns
    -------
    (..., F, 5, 5) complex ndarray
        From [v, ψ̇, M, F, U] at the start to [v, ψ̇, M, F, I] at the end [SI], exp(+jωt).

    Notes
    -----
    Column U is K times column M, less K in row M; row I is K times row ψ̇, less K in column ψ̇;
    entry (I, U) is jωC_p + K T(ψ̇, U).
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
    """Return the segment with a last axis of one in each constant, to broadcast over frequency."""
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
