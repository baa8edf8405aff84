"""Finite-element plant with the measured current, which shares no code with `tactile.sensing`.

It is what the figures of self-sensing are measured on: contactors with tolerances under fingers
that press, leave and touch again, and the current of each through an analog-to-digital converter.

- The modes are those of the finite elements of `tests/reference_beam.py`, and what higher modes add
  at rest is kept as a static compliance. Damping of each mode: the loss factor of its own
  deformation at its own frequency.
- Between two steps of the integration the forces on the modes run linearly, for which the update of
  a mode is exact. The finger closes the port at the tip: a spring, a damper (second-order backward
  difference) and a Maxwell branch (exact for linear motion), solved together with the modes.
- The dielectric is causal: a chain of Debye relaxations approximates a loss tangent that does not
  depend on frequency, so that the capacitance falls with frequency (Kramers and Kronig).
- The current is the time derivative of the charge (fourth-order central difference), at the sample
  instants of the drive plus the skew of the converter, with its noise, range and resolution.
"""

import importlib.util
import sys
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.signal import lfilter, upfirdn

from tactile.arrays import Complex, Floats

REFERENCE = Path(__file__).parents[1] / "tests" / "reference_beam.py"
"""Finite-element model of the beam."""
MODES = 2
"""Number of modes: 0.9 and 5.8 kHz in the default design. A stiff finger makes the integration
unstable if there are modes whose periods are near its step."""
SUBSTEPS = 8
"""Number of steps of the integration per sample of the drive."""
REACH = 16
"""Half length of the interpolation between samples of the drive [samples]."""
Q, V, FORCE = slice(0, MODES), slice(MODES, 2 * MODES), slice(2 * MODES, 3 * MODES)
U, BEFORE, INNER, REST = range(3 * MODES, 3 * MODES + 4)
"""Places of the state: the modes with the force on each, the tip now and a step before, the middle
of the Maxwell branch, and the place where the finger touched."""
STATE = REST + 1
"""Length of the state. The voltage stands behind it."""
RELAXATIONS = np.geomspace(0.05, 50e3, 13)
"""Relaxation frequencies of the dielectric, about two per decade [Hz]."""
FULL_DRIVE, ELEMENTS = 100.0, 64
"""Drive at which the hysteresis has its stated width [V], and number of its sliders."""
SLIDERS = FULL_DRIVE * (np.arange(ELEMENTS + 1) / ELEMENTS) ** 2
"""Bounds of the parts of the drive for each of which there is a slider [V]."""


def reference_beam() -> ModuleType:
    """Return the finite elements, which belong to no package."""
    if "reference_beam" in sys.modules:
        return sys.modules["reference_beam"]
    spec = importlib.util.spec_from_file_location("reference_beam", REFERENCE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["reference_beam"] = module
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class PlantTolerances:
    """Deviations of N contactors from the design, as factors.

    Attributes
    ----------
    stiffness, coupling, mass : (N,) array of float
        Factors of elastic stiffness, d31 and density.
    cable : (N,) array of float
        Capacitance of the cable [F].
    """

    stiffness: Floats
    coupling: Floats
    mass: Floats
    cable: Floats

    @classmethod
    def none(cls, contactors: int) -> "PlantTolerances":
        """Return the tolerances of contactors that are exactly as designed."""
        one = np.ones(contactors)
        return cls(one, one, one, 0 * one)

    def first(self, contactors: int) -> "PlantTolerances":
        """Return the tolerances of the first contactors."""
        columns = self.stiffness, self.coupling, self.mass, self.cable
        return PlantTolerances(*(column[:contactors] for column in columns))

    @classmethod
    def drawn(cls, contactors: int, rng: np.random.Generator) -> "PlantTolerances":
        """Draw ±5 % of stiffness, ±10 % of d31, ±1 % of mass and 100 pF ± 20 % (assumed)."""
        return cls(
            1 + rng.uniform(-0.05, 0.05, contactors),
            1 + rng.uniform(-0.10, 0.10, contactors),
            1 + rng.uniform(-0.01, 0.01, contactors),
            100e-12 * (1 + rng.uniform(-0.2, 0.2, contactors)),
        )


@dataclass(frozen=True)
class Converter:
    """Analog-to-digital converter of the current.

    Attributes
    ----------
    range : float
        Largest current [A].
    bits : int
        Resolution.
    noise : float
        Standard deviation of the noise, in steps of the converter.
    skew : float
        Delay of the converter against the drive [s].
    """

    range: float = 2.5e-3
    bits: int = 12
    noise: float = 1.0
    skew: float = 0.0

    @property
    def step(self) -> float:
        """Current of one step of the converter [A]."""
        return float(self.range / 2 ** (self.bits - 1))


@dataclass
class Fingers:
    """Loads of N contactors at a normal force of 1 N; they scale with its square root (assumed).

    Attributes
    ----------
    k0, d0, k1, d1 : (N,) array of float
        Stiffness [N/m] and damping [N s/m] beside a spring and damper in series.
    """

    k0: Floats
    d0: Floats
    k1: Floats
    d1: Floats

    def stiffness(self, frequency: Floats, scale: Floats) -> Complex:
        """Return jωZ of each contactor (N, F) with all constants times a scale (N,) [N/m]."""
        s = 2j * np.pi * frequency
        k0, d0, k1, d1 = (np.asarray(x)[:, None] for x in (self.k0, self.d0, self.k1, self.d1))
        return np.asarray(np.asarray(scale)[:, None] * (k0 + s * d0 + s * k1 * d1 / (k1 + s * d1)))


@dataclass
class _Tip:
    """Modes as seen from the tip and from the electrodes, for N contactors.

    ``omega``, ``damping``, ``shape`` and ``drive`` are (M, N); the static remainders are (N,).
    """

    omega: Floats
    damping: Floats
    shape: Floats
    drive: Floats
    rest_uu: Floats
    rest_uv: Floats
    rest_vv: Floats
    capacitance: Floats


def _tip(beam: Any, tolerances: PlantTolerances) -> _Tip:
    """Return the modes of a beam whose stiffness, coupling and mass have tolerances.

    A common factor of stiffness or density changes frequencies and scales, and no shapes.
    """
    reference = reference_beam()
    lossless, lossy = reference.assemble(reference.lossless(beam)), reference.assemble(beam)
    K, drive = lossless.stiffness.real, lossless.drive.real
    balance = 1 / np.sqrt(np.diag(K))
    weigh = balance[:, None] * balance
    values, vectors = eigh(weigh * lossless.mass, weigh * K)
    x = balance[:, None] * vectors[:, ::-1][:, :MODES]  # x'Kx = 1; the largest 1/ω² first
    omega2 = 1 / values[::-1][:MODES]
    x = x * np.sqrt(omega2)  # x'Mx = 1
    loss = np.einsum("im,ij,jm->m", x, lossy.stiffness.imag, x) / omega2
    tip, push = x[lossless.tip], np.eye(len(K))[lossless.tip]
    static = np.linalg.solve(K, np.stack([push, drive], axis=1))
    modal = x @ ((x / omega2).T @ np.stack([push, drive], axis=1))
    rest = static - modal
    e, d, m = tolerances.stiffness, tolerances.coupling, tolerances.mass
    omega = np.sqrt(omega2)[:, None] * np.sqrt(e / m)
    return _Tip(
        omega, loss[:, None] * omega, tip[:, None] / np.sqrt(m),
        (x.T @ drive)[:, None] * d * e / np.sqrt(m),
        rest[lossless.tip, 0] / e, rest[lossless.tip, 1] * d, (drive @ rest[:, 1]) * d**2 * e,
        lossless.capacitance.real + tolerances.cable,
    )  # fmt: skip


@dataclass(frozen=True)
class _Update:
    """Exact update of each mode over a step in which its force runs linearly from f0 to f1.

    q1 = qq q + qv v + q_f0 f0 + q_f1 f1, and v1 likewise; all are (M, N).
    """

    qq: Floats
    qv: Floats
    vq: Floats
    vv: Floats
    q_f0: Floats
    q_f1: Floats
    v_f0: Floats
    v_f1: Floats


def _update(tip: _Tip, h: float) -> _Update:
    """Return the update over h seconds: free vibration and the particular solutions of a ramp."""
    k, c = tip.omega**2, tip.damping
    pole = -c / 2 + 1j * np.sqrt(k - c**2 / 4)
    grown, turn = np.exp(pole * h), pole.imag
    qq, qv = (np.conj(pole) * grown).imag / -turn, grown.imag / turn
    vq, vv = -k * qv, (pole * grown).imag / turn
    hold_q, hold_v = (1 - qq) / k, -vq / k
    offset, slope = -c / k**2 / h, 1 / (k * h)  # q of the force t/h is slope · t + offset
    ramp_q = 1 / k + offset - qq * offset - qv * slope
    ramp_v = slope - vq * offset - vv * slope
    return _Update(qq, qv, vq, vv, hold_q - ramp_q, ramp_q, hold_v - ramp_v, ramp_v)


class Advance:
    """One step of the integration, as a matrix of each contactor.

    Without the finger's force the step is linear in state and voltage. The force is a gain, which
    depends on the load, times another linear form of both, and changes the state in proportion.

    Attributes
    ----------
    matrix : (STATE + 1, STATE + 1, N) array of float
        Step without the finger's force; its last row is that form.
    push : (STATE, N) array of float
        Change of the state per newton of the finger's force.
    stiff, now : (N,) array of float
        Force of the finger per change of the tip within the step [N/m], and the part of this change
        that the middle of the Maxwell branch follows.
    """

    def __init__(self, tip: _Tip, m: _Update, f: Fingers, port: Floats, h: float) -> None:
        n, corner, mode = len(port), f.k1 / f.d1, np.arange(MODES)
        relax = np.exp(-corner * h)
        late, now = (1 - relax) / (corner * h) - relax, 1 - (1 - relax) / (corner * h)
        self.now = now
        self.stiff = f.k0 + 1.5 * f.d0 / h + f.k1 * (1 - now)
        A, b = np.zeros((STATE + 1, STATE + 1, n)), np.zeros((STATE, n))
        for rows, (q, v, f0, f1) in (
            (Q, (m.qq, m.qv, m.q_f0, m.q_f1)),
            (V, (m.vq, m.vv, m.v_f0, m.v_f1)),
        ):
            for columns, part in ((Q, q), (V, v), (FORCE, f0)):
                A[rows, columns][mode, mode] = part
            A[rows, STATE], b[rows] = f1 * tip.drive, f1 * tip.shape
        A[FORCE, STATE], b[FORCE] = tip.drive, tip.shape
        A[U] = np.einsum("mn,mjn->jn", tip.shape, A[Q])
        A[U, STATE] += tip.rest_uv
        A[BEFORE, U] = A[REST, REST] = 1
        A[INNER] = now * A[U]
        A[INNER, INNER] += relax
        A[INNER, U] += late
        b[U], b[INNER] = port, now * port
        pull = self.stiff * A[U]  # the force without the tip's yielding
        pull[BEFORE] += f.d0 / (2 * h)
        pull[U] -= 2 * f.d0 / h + f.k1 * late
        pull[REST] -= f.k0
        pull[INNER] -= f.k1 * relax
        A[-1] = pull
        self.matrix, self.push = A, b
        self.free = np.empty((STATE + 1, n))

    def step(self, state: Floats, gain: Floats, force: Floats, following: Floats) -> None:
        """Advance a state with its voltage; write the force and the following state."""
        free = np.einsum("ijn,jn->in", self.matrix, state, out=self.free)
        np.multiply(gain, free[-1], out=force)
        np.multiply(self.push, force, out=following)
        following += free[:-1]


def debye(loss_tangent: float) -> Floats:
    """Compute the strengths of the relaxations that make a constant loss tangent.

    Parameters
    ----------
    loss_tangent : float
        tan δ in 10–3000 Hz.

    Returns
    -------
    (R,) array of float
        Strength of each relaxation, as a part of the capacitance at high frequency.
    """
    f = np.geomspace(3, 5e3, 200)[:, None] / RELAXATIONS
    imaginary, real = f / (1 + f**2), 1 / (1 + f**2)
    return np.asarray(
        np.linalg.lstsq(imaginary - loss_tangent * real, np.full(200, loss_tangent), rcond=1e-6)[0]
    )


def friction_strengths(width: float, contactors: int, rng: np.random.Generator) -> Floats:
    """Draw the strengths of sliders that are spread over the drive.

    If all were equal, the loop would be that of Rayleigh: at the amplitude A its branches are apart
    by s A²/2 of a swing of 2 A + s A², with the strength s per volt of limit. In a ceramic the
    coercive fields of many domains make a smooth distribution.

    Parameters
    ----------
    width : float
        Distance between both branches of the loop at `FULL_DRIVE`, as a part of its swing.
    contactors : int
        Number of contactors N.
    rng : Generator
        Source of deviations: ±20 % of each contactor, and a slope and a bump over the drive by
        ±20 % each (assumed).

    Returns
    -------
    (ELEMENTS, N) array of float
        Strength of each slider.
    """
    mean = 4 * width / (1 - 2 * width) * np.diff(SLIDERS)[:, None] / FULL_DRIVE
    place = (SLIDERS[1:, None] + SLIDERS[:-1, None]) / (2 * FULL_DRIVE)
    level, slope, bump = 0.2 * rng.uniform(-1, 1, (3, contactors))
    shape = 1 + slope * (2 * place - 1) + bump * np.cos(3 * np.pi * place)
    return np.asarray(mean * (1 + level) * shape)


class SlidingCeramics:
    """Hysteresis of ceramics: springs and sliders in series, beside a spring (Maxwell slip).

    The voltage over each spring that ends at a slider is limited, as the force over an element with
    dry friction is.

    Parameters
    ----------
    strength : (ELEMENTS, N) array of float
        Strength of each slider.
    """

    def __init__(self, strength: Floats) -> None:
        self._strength, contactors = strength, strength.shape[1]
        self._limit = (SLIDERS[1:, None] + SLIDERS[:-1, None]) / 2
        self._strain, self._last = np.zeros((ELEMENTS, contactors)), np.zeros(contactors)

    def effective(self, volts: Floats) -> Floats:
        """Return the effective voltage (S, N) of the next steps of the integration."""
        out = np.empty_like(volts)
        for k, row in enumerate(volts):
            self._strain += row - self._last
            np.clip(self._strain, -self._limit, self._limit, out=self._strain)
            out[k] = row + np.einsum("en,en->n", self._strength, row - self._strain)
            self._last = row
        return out


class SensingPlant:
    """Contactors under fingers, in time: drive in, shear and measured current out.

    Parameters
    ----------
    fingers : Fingers
        Loads of the N contactors.
    tolerances : PlantTolerances
        Deviations of the contactors.
    converter : Converter, optional
        Converter of the current.
    sample_rate : float
        Sample rate of drive and current [Hz].
    seed : int
        Seed of the converter's noise.
    strength : (ELEMENTS, N) array of float, optional
        Strengths of the hysteresis between voltage and polarization; none by default.

    Attributes
    ----------
    scale : (N,) array of float
        Present scale of the load of each contactor; 0 in air.
    delay : int
        Delay of shear and current against the drive [samples].
    """

    delay = REACH + 1

    def __init__(
        self,
        fingers: Fingers,
        tolerances: PlantTolerances,
        *,
        converter: Converter | None = None,
        sample_rate: float = 8000.0,
        seed: int = 0,
        strength: Floats | None = None,
    ) -> None:
        beam, n = reference_beam().Beam(), len(tolerances.mass)
        self.fingers, self.converter = fingers, converter or Converter()
        self.tip = _tip(beam, tolerances)
        self.scale = np.ones(n)
        self._strengths = debye(beam.loss_tangent)
        self._h = 1 / (sample_rate * SUBSTEPS)
        self._rng = np.random.default_rng(seed)
        self._friction = None if strength is None else SlidingCeramics(strength)
        mode = _update(self.tip, self._h)
        self._port = np.sum(self.tip.shape**2 * mode.q_f1, axis=0) + self.tip.rest_uu
        self._advance = Advance(self.tip, mode, fingers, self._port, self._h)
        at = np.arange(-REACH * SUBSTEPS + 1, REACH * SUBSTEPS) / SUBSTEPS
        self._kernel = np.sinc(at) * np.kaiser(len(at), 8.0)
        self._past = np.zeros((2 * REACH, n))
        self._state = np.zeros((STATE, n))
        self._charges = np.zeros((SUBSTEPS + 3, n))
        self._shear = np.zeros((1, n))
        self._relaxed = np.zeros((len(RELAXATIONS), 1, n))

    def response(self, frequency: Floats, scale: Floats) -> Complex:
        """Compute the shear per volt (N, F) of contactors whose loads have a scale (N,) [m/V]."""
        yielding, driven, _ = self._ports(frequency)
        return np.asarray(driven / (1 + yielding * self.fingers.stiffness(frequency, scale)))

    def admittance(self, frequency: Floats, scale: Floats) -> Complex:
        """Compute the current per volt (N, F) of contactors whose loads have a scale [S]."""
        yielding, driven, charged = self._ports(frequency)
        k = self.fingers.stiffness(frequency, scale)
        ratio = 1j * frequency / RELAXATIONS[:, None]
        dielectric = self.tip.capacitance[:, None] * (1 + self._strengths @ (1 / (1 + ratio)))
        return np.asarray(
            2j * np.pi * frequency * (charged + dielectric - driven**2 * k / (1 + yielding * k))
        )

    def _ports(self, frequency: Floats) -> tuple[Complex, Complex, Complex]:
        """Return shear per newton, shear per volt and charge per volt of the free tip (N, F)."""
        s = 2j * np.pi * frequency[:, None, None]
        t = self.tip
        resonance = 1 / (t.omega**2 + s * t.damping + s**2)
        yielding = np.sum(t.shape**2 * resonance, axis=1) + t.rest_uu
        driven = np.sum(t.shape * t.drive * resonance, axis=1) + t.rest_uv
        charged = np.sum(t.drive**2 * resonance, axis=1) + t.rest_vv
        return yielding.T, driven.T, charged.T

    def step(
        self, drive: Floats, scale: Floats | None = None, gain: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Advance the plant.

        Parameters
        ----------
        drive : (S, N) array of float
            Voltage at the electrodes [V].
        scale : (S, N) array of float, optional
            Scale of the loads while the drive of `REACH` samples ago is played; by default it
            stays as it is. A finger that comes touches the tip where the tip is.
        gain : (S, N) array of float, optional
            Gain of the amplifier behind the interpolation, while the drive of `REACH` samples ago
            is played; 1 by default.

        Returns
        -------
        shear : (S, N) array of float
            Displacement of the tips, `delay` samples late [m].
        current : (S, N) array of float
            Measured current, as late [A].
        """
        volts = self._interpolated(drive)
        if gain is not None:
            volts = volts * np.repeat(gain, SUBSTEPS, axis=0)
        if self._friction is not None:
            volts = self._friction.effective(volts)
        scales = np.repeat(self.scale[None], len(drive), 0) if scale is None else scale
        moved, charge = self._moved(volts, scales)
        line = np.concatenate([self._charges, charge + self._dielectric(volts)])
        self._charges = line[-(SUBSTEPS + 3) :]
        at = 3 + np.arange(len(drive)) * SUBSTEPS
        current, earlier = self._rate(line, at), self._rate(line, at - 1)
        current = current + self.converter.skew / self._h * (earlier - current)
        shear = np.concatenate([self._shear, moved])
        self._shear = shear[-1:]
        return shear[:-1], self._converted(current)

    def _interpolated(self, drive: Floats) -> Floats:
        """Return the drive at the integration's steps (S · `SUBSTEPS`, N), `REACH` samples late."""
        line = np.concatenate([self._past, drive])
        self._past = line[len(drive) :]
        fine = upfirdn(self._kernel, line, up=SUBSTEPS, axis=0)
        begin = 2 * REACH * SUBSTEPS - 1
        return np.asarray(fine[begin : begin + len(drive) * SUBSTEPS])

    def _moved(self, volts: Floats, scales: Floats) -> tuple[Floats, Floats]:
        """Integrate; return the tips at the samples (S, N) and the mechanical charge at each step.

        The first step of sample n leads to its instant. The state is that of the last step.
        """
        t, gains = self.tip, self._gains(scales)
        come = (np.concatenate([self.scale[None], scales[:-1]]) == 0) & (scales > 0)
        moved, charge, force = np.empty_like(scales), np.empty_like(volts), np.empty_like(volts)
        states = np.empty((SUBSTEPS + 1, STATE + 1, len(t.capacitance)))
        first, last = states[0], states[-1, :STATE]
        last[:] = self._state
        for n, arriving in enumerate(come):
            steps = slice(n * SUBSTEPS, (n + 1) * SUBSTEPS)
            first[:STATE], states[:-1, STATE] = last, volts[steps]
            first[REST, arriving] = first[INNER, arriving] = first[U, arriving]
            for now, push, following in zip(states[:-1], force[steps], states[1:], strict=True):
                self._advance.step(now, gains[n], push, following[:STATE])
            np.einsum("mn,kmn->kn", t.drive, states[1:, Q], out=charge[steps])
            moved[n] = states[1, U]
        self._state, self.scale = last.copy(), scales[-1].copy()
        return moved, charge + t.rest_uv * force + t.rest_vv * volts

    def _gains(self, scales: Floats) -> Floats:
        """Return the gain of the fingers' forces under each row of scales (S, N)."""
        return np.asarray(-scales / (1 + self._port * scales * self._advance.stiff))

    def _dielectric(self, volts: Floats) -> Floats:
        """Return the charge of the dielectric at each step [C]."""
        total = volts.copy()
        for j, (frequency, strength) in enumerate(zip(RELAXATIONS, self._strengths, strict=True)):
            rate = np.tan(min(np.pi * frequency * self._h, 1.4))  # bilinear, warped at its corner
            b, a = np.array([1, 1]) * rate / (1 + rate), [1, (rate - 1) / (1 + rate)]
            relaxed, self._relaxed[j] = lfilter(b, a, volts, axis=0, zi=self._relaxed[j])
            total += strength * relaxed
        return np.asarray(total * self.tip.capacitance)

    def _rate(self, charge: Floats, at: NDArray[np.intp]) -> Floats:
        """Return the time derivative of a charge, to fourth order [A]."""
        outer, inner = charge[at + 2] - charge[at - 2], charge[at + 1] - charge[at - 1]
        return np.asarray((8 * inner - outer) / (12 * self._h))

    def _converted(self, current: Floats) -> Floats:
        """Return a current as the converter measures it [A]."""
        c = self.converter
        codes = np.rint(current / c.step + c.noise * self._rng.standard_normal(current.shape))
        return np.asarray(np.clip(codes, -(2 ** (c.bits - 1)), 2 ** (c.bits - 1) - 1) * c.step)
