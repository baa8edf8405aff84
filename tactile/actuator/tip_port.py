"""Benders with an open port at the tip, to which fingers are connected that differ and change.

The state of a contactor has units of √J, so that half its square is the stored energy: of each beam
mode ωq and q̇, of each spring k of the finger y = √k e with the stretch e. With the tip's velocity
v = tᵀx, a finger is

    ẋ = … − t (Σ √k y + d0 v),    ẏ0 = √k0 v,    ẏi = √ki v − (ki/di) yi,

which is a skew-symmetric coupling and losses: the stored energy never grows by itself, whatever the
constants are. If constants change, y is multiplied by √(min(k, k')/max(k, k')): springs that
detach take their energy along at constant stretch, springs that attach are relaxed and leave the
force as it is (as in Mindlin's contact whose area changes). So a change never adds energy, a finger
that is gone (k = 0) has lost its force, and one that touches begins without force where the tip is.
A slow swing of the force therefore unloads the finger from a constant displacement, little by
little.

States of the Debye chain (`dielectric`), of the amplifier's low-pass and of the electrodes behind a
resistance follow, as in `plant`.
"""

from dataclasses import dataclass

import numpy as np

from tactile.actuator.amplifier import Amplifier
from tactile.actuator.bimorph import Bimorph, coupling
from tactile.actuator.dielectric import debye_chain
from tactile.actuator.finger import FingerLoad
from tactile.actuator.plant import Modes, beam_modes
from tactile.actuator.tolerances import Tolerances
from tactile.arrays import Floats


@dataclass(frozen=True)
class TipPort:
    """Continuous-time system of N contactors in air, driven by the drive voltage v.

    ẋ = A x + B v, displacement = u·x [m], velocity = v·x [m/s], and charge = C_q·x + D_q v [C].

    Attributes
    ----------
    A : (N, n, n) array of float
        System in air; of the finger only states are there, which decay or rest.
    B : (N, n) array of float
        Input per volt.
    u, v : (N, n) array of float
        Rows that give displacement and velocity of the tip.
    C_q : (N, n) array of float
        Row that gives the charge on the electrodes.
    D_q : (N,) array of float
        Charge per volt of drive.
    beam, springs : slice
        Places of the states of the beam, and of the springs of the finger, k0 first.
    """

    A: Floats
    B: Floats
    u: Floats
    v: Floats
    C_q: Floats
    D_q: Floats
    beam: slice
    springs: slice


@dataclass(frozen=True)
class _Electrodes:
    """Capacitances of N contactors: at once (N,) and per relaxation (N, M), with rates (M,)."""

    at_once: Floats
    strength: Floats
    rate: Floats


def _electrodes(bimorph: Bimorph, tolerances: Tolerances) -> _Electrodes:
    """Return the capacitances; that of the free ceramic relaxes, that of its clamping does not."""
    p = bimorph.piezo
    chain = debye_chain(float(p.loss_tangent))
    length = bimorph.length + np.asarray(bimorph.clamped_length)
    area = float(2 * bimorph.width * length * bimorph.layer_voltage**2 / bimorph.piezo_height)
    free, clamping = area * float(p.eps33T), area * float(p.d31**2 / p.s11E)
    less = clamping * tolerances.d31**2 * tolerances.stiffness
    at_once = free * chain.instantaneous - less + tolerances.cable
    strength = np.tile(free * chain.strength, (len(at_once), 1))
    return _Electrodes(at_once, strength, chain.rate)


def _mechanics(modes: Modes, tolerances: Tolerances, size: int) -> tuple[Floats, Floats, Floats]:
    """Return A (N, n, n) of the beam, and rows (2, N, n): of the tip's u and ψ, and of v and ψ̇.

    A factor of stiffness or mass scales the modes of the design: ω² by the one over the other, and
    mass-normalized shapes by 1/√mass.
    """
    count, contactors = len(modes.frequency), len(tolerances.mass)
    pace = np.sqrt(tolerances.stiffness / tolerances.mass)[:, None]
    omega, damping = modes.frequency * pace, modes.damping * pace
    shape = modes.shape / np.sqrt(tolerances.mass)[:, None, None]
    A, (places, rates) = np.zeros((contactors, size, size)), np.zeros((2, 2, contactors, size))
    k = np.arange(count)
    A[:, k, count + k], A[:, count + k, k] = omega, -omega
    A[:, count + k, count + k] = -damping
    for i in (0, 1):
        places[i, :, :count] = shape[:, :, i] / omega
        rates[i, :, count : 2 * count] = shape[:, :, i]
    return A, places, rates


def tip_ports(
    bimorph: Bimorph, tolerances: Tolerances, amplifier: Amplifier, *, branches: int
) -> TipPort:
    """Combine benders and amplifier (gain, bandwidth, output resistance) into one system in air.

    Parameters
    ----------
    bimorph : Bimorph
        One design (numbers, not arrays).
    tolerances : Tolerances
        Factors of N benders.
    amplifier : Amplifier
        Amplifier between drive and electrodes.
    branches : int
        Number of Maxwell branches of the fingers.

    Returns
    -------
    TipPort
        Continuous-time system of N contactors.
    """
    electrodes, modes = _electrodes(bimorph, tolerances), beam_modes(bimorph)
    beam = slice(2 * len(modes.frequency))
    springs = slice(beam.stop, beam.stop + 1 + branches)
    chain = slice(springs.stop, springs.stop + len(electrodes.rate))
    has_low_pass, has_resistance = np.isfinite(amplifier.bandwidth), amplifier.output_resistance > 0
    size = chain.stop + int(has_low_pass) + int(has_resistance)
    A, (u, psi), (v, turning) = _mechanics(modes, tolerances, size)
    K = (float(coupling(bimorph).real) * tolerances.d31 * tolerances.stiffness)[:, None]
    B, C_q, unit = np.zeros(A.shape[:2]), K * psi, np.eye(size)
    C_q[:, chain] = electrodes.strength
    volts, direct = np.zeros(size), amplifier.gain
    if has_low_pass:
        corner = 2 * np.pi * amplifier.bandwidth
        A[:, chain.stop, chain.stop], B[:, chain.stop] = -corner, corner * amplifier.gain
        volts, direct = unit[chain.stop], 0.0
    if has_resistance:  # (V − U)/R is the current, of which C U̇ is what the others leave
        others = K * turning
        others[:, chain] -= electrodes.strength * electrodes.rate
        leak = (electrodes.strength * electrodes.rate).sum(axis=1)[:, None]
        R, C = amplifier.output_resistance, electrodes.at_once[:, None]
        A[:, -1] = ((volts - unit[-1]) / R - others - leak * unit[-1]) / C
        B[:, -1] = direct / (R * C[:, 0])
        volts, direct = unit[-1], 0.0
    A[:, chain, chain] -= np.diag(electrodes.rate)
    A[:, chain] += np.outer(electrodes.rate, volts)
    B[:, chain] += electrodes.rate * direct
    A += (K * turning)[:, :, None] * volts
    B += K * turning * direct
    C_q += electrodes.at_once[:, None] * volts
    return TipPort(A, B, u, v, C_q, electrodes.at_once * direct, beam, springs)


def spring_roots(load: FingerLoad, contactors: int) -> Floats:
    """Return √k of the springs of a finger, k0 first; a branch without damper has no spring.

    Parameters
    ----------
    load : FingerLoad
        Load, of numbers or of arrays (N,).
    contactors : int
        Number of contactors N.

    Returns
    -------
    (N, 1 + branches) array of float
        Square roots of the stiffnesses [√(N/m)].
    """
    springs = [load.k0, *(np.where(np.asarray(d) > 0, k, 0.0) for k, d in load.branches)]
    return np.stack([np.broadcast_to(np.sqrt(k), contactors) for k in springs], axis=1)


def loaded(port: TipPort, load: FingerLoad) -> Floats:
    """Connect fingers to the tips.

    Parameters
    ----------
    port : TipPort
        Benders in air.
    load : FingerLoad
        Load, of numbers or of arrays (N,).

    Returns
    -------
    (N, n, n) array of float
        System matrix A of the loaded contactors.
    """
    A, contactors = port.A.copy(), len(port.A)
    roots = spring_roots(load, contactors)
    damping = np.broadcast_to(np.asarray(load.d0, np.float64), contactors)
    A -= damping[:, None, None] * port.v[:, :, None] * port.v[:, None, :]
    A[:, :, port.springs] -= port.v[:, :, None] * roots[:, None, :]
    A[:, port.springs] += roots[:, :, None] * port.v[:, None, :]
    for i, (k, d) in enumerate(load.branches, port.springs.start + 1):
        k, d = np.broadcast_arrays(np.asarray(k, np.float64), np.asarray(d, np.float64))
        A[:, i, i] -= np.divide(k, d, out=np.zeros(d.shape), where=d > 0)
    return A
