"""Penn Haptic Texture Toolkit: texture models as XML, of a user's own copy (nothing is shipped).

A model is an ARMA filter for the acceleration [m/s²] of a hand-held tool at a speed and a force,
driven by white Gaussian noise (Culbertson, Unwin & Kuchenbecker, "Modeling and Rendering Realistic
Textures from Unconstrained Tool-Surface Interactions", IEEE ToH 2014). Between the models of a set
the line spectral frequencies, variance and gain are interpolated in the triangle of (speed, force)
around the point asked for, which is held at the set's largest speed and force.

The toolkit's licence is for research and does not allow redistribution: a texture made from a
model says so in its file.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray
from scipy.signal import freqz, lfilter

from tactile.errors import InputError
from tactile.texture.descriptor import (
    BANDS,
    THIRD_OCTAVE,
    About,
    Descriptor,
    Friction,
    Laws,
    Reference,
    Stochastic,
)
from tactile.texture.formats import reading

Floats = NDArray[np.float64]

REFERENCE_SPEED, REFERENCE_FORCE = 0.1, 1.0
"""m/s and N at which a texture is made: in the middle of what was recorded (assumed)."""
HAND = 20.0
"""Hz below which acceleration is the hand's; displacement is held there (assumed)."""
TOP = 1000.0
"""Hz that a texture goes up to at most."""
MOST_MODELS, MOST_COEFFICIENTS = 1000, 64
SETTLE = 4096
"""Samples of noise before the first that is kept."""
CATEGORIES = {
    "wood": "wood", "mdf": "wood", "cork": "wood", "leather": "leather", "plastic": "plastic",
    "acrylic": "plastic", "foam": "foam", "styrofoam": "foam", "metal": "metal",
    "aluminum": "metal", "sandpaper": "abrasive", "scouring": "abrasive", "stone": "stone",
    "brick": "stone", "tile": "stone", "ceramic": "stone", "terra": "stone", "rubber": "rubber",
    "glove": "rubber", "paper": "paper", "card": "paper", "cardboard": "paper", "folder": "paper",
    "book": "paper", "glass": "glass",
}  # fmt: skip
"""By a word in a material's name, the first that fits; all else is taken for a textile."""


class Filter(NamedTuple):
    """Of the noise: numerator and denominator, and the noise's variance."""

    b: Floats
    a: Floats
    variance: float


@dataclass(frozen=True)
class ModelSet:
    """A material's models.

    Attributes
    ----------
    material : its name
    sample_rate : [Hz]
    friction : kinetic coefficient, of the tool
    point : (M, 2) speed [m/s] and force [N] of each model
    triangle : (T, 3) indices of models
    ar_lsf, ma_lsf : (M, P) and (M, Q) [rad/sample]; Q is 0 for AR models
    variance, gain : (M,)
    """

    material: str
    sample_rate: float
    friction: float
    point: Floats
    triangle: NDArray[np.intp]
    ar_lsf: Floats
    ma_lsf: Floats
    variance: Floats
    gain: Floats

    def filter_at(self, speed: float, normal_force: float) -> Filter:
        """Return the interpolated filter at a speed [m/s] and force [N]."""
        model, weight = self._around(abs(speed), normal_force)
        gain = float(weight @ self.gain[model])
        return Filter(
            gain * polynomial(weight @ self.ma_lsf[model]),
            polynomial(weight @ self.ar_lsf[model]),
            float(weight @ self.variance[model]),
        )

    def _around(self, speed: float, normal_force: float) -> tuple[NDArray[np.intp], Floats]:
        """Return the models of the triangle around a point, and their weights."""
        largest = self.point.max(axis=0)
        asked = np.clip([speed, normal_force], self.point.min(axis=0), largest) / largest
        corner = (self.point / largest)[self.triangle]
        edges = np.stack([corner[:, 0] - corner[:, 2], corner[:, 1] - corner[:, 2]], axis=2)
        flat = np.abs(np.linalg.det(edges)) < 1e-12
        edges[flat] = np.eye(2)
        part = np.linalg.solve(edges, (asked - corner[:, 2])[:, :, None])[:, :, 0]
        weight = np.column_stack([part, 1 - part.sum(axis=1)])
        weight[flat] = -np.inf
        best = int(np.argmax(weight.min(axis=1)))
        inside = np.clip(weight[best], 0, None)
        return self.triangle[best], inside / inside.sum()

    def acceleration_psd(self, frequency: Floats, speed: float, normal_force: float) -> Floats:
        """Return the one-sided power spectral density [(m/s²)²/Hz] at frequencies (F,) [Hz].

        2 σ² |B/A|² / fs, in closed form; 0 above half the models' sample rate.
        """
        b, a, variance = self.filter_at(speed, normal_force)
        _, response = freqz(b, a, worN=2 * np.pi * frequency / self.sample_rate)
        density = 2 * variance * np.abs(response) ** 2 / self.sample_rate
        return np.asarray(np.where(frequency <= self.sample_rate / 2, density, 0.0))

    def acceleration(self, count: int, speed: float, normal_force: float, seed: int = 0) -> Floats:
        """Return (count,) samples of acceleration [m/s²] at the models' sample rate."""
        b, a, variance = self.filter_at(speed, normal_force)
        noise = np.random.default_rng(seed).standard_normal(count + SETTLE)
        return np.asarray(lfilter(b, a, math.sqrt(variance) * noise)[SETTLE:])


def polynomial(lsf: Floats) -> Floats:
    """Return the monic polynomial of line spectral frequencies (P,) [rad/sample], (P + 1,).

    A = (S + D)/2; the first, third … frequency are zeros of the symmetric S, the others of the
    antisymmetric D, which have a zero at −1 and at 1 besides where P is even, and D both where it
    is odd (Itakura 1975).
    """
    if not len(lsf):
        return np.ones(1)
    symmetric = _circle(lsf[0::2], [] if len(lsf) % 2 else [-1.0])
    antisymmetric = _circle(lsf[1::2], [-1.0, 1.0] if len(lsf) % 2 else [1.0])
    return np.asarray(((symmetric + antisymmetric) / 2)[:-1])


def _circle(angle: Floats, real: list[float]) -> Floats:
    zeros = np.concatenate([np.exp(1j * angle), np.exp(-1j * angle), real])
    return np.asarray(np.real(np.poly(zeros)))


# Reading


def load_model(path: Path) -> ModelSet:
    """Return the models of a file.

    Raises
    ------
    NotFoundError, InputError
        One line: file, what, and what is allowed.
    """
    root = _parsed(path)
    models = root.findall("model")
    if not 3 <= len(models) <= MOST_MODELS:
        raise InputError(f"{path}: {len(models)} models: must be 3 … {MOST_MODELS}")
    point = np.array([
        [_number(path, m, "speedMod", 0, 1e4) / 1e3, _number(path, m, "forceMod", 0, 1e3)]
        for m in models
    ])  # fmt: skip
    if np.any(np.ptp(point, axis=0) <= 0):
        raise InputError(f"{path}: all models are at one speed or one force: needs a triangle")
    moving = any(m.find("MAlsf") is not None for m in models)
    return ModelSet(
        material=reading.one_line(root.findtext("material") or path.stem),
        sample_rate=_number(path, root, "SampleRate", 100, 100_000),
        friction=_number(path, root, "mu", 0, 5),
        point=point,
        triangle=_triangles(path, root, len(models)),
        ar_lsf=_lsf(path, models, "ARlsf"),
        ma_lsf=_lsf(path, models, "MAlsf") if moving else np.zeros((len(models), 0)),
        variance=np.array([_number(path, m, "var", 0, 1e9) for m in models]),
        gain=np.array([_number(path, m, "gain", 0, 1e9) if moving else 1.0 for m in models]),
    )


def _parsed(path: Path) -> ElementTree.Element:
    """Return a file's root; its text is UTF-8 and defines no entities."""
    raw = reading.contents(path)
    if b"<!DOCTYPE" in raw or b"<!ENTITY" in raw:
        raise InputError(f"{path}: has a document type: must be plain XML")
    try:
        root = ElementTree.fromstring(raw.decode("utf-8-sig"))
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise InputError(reading.one_line(f"{path}: no valid XML: {error}")) from error
    if root.tag != "modelSet":
        raise InputError(reading.one_line(f"{path}: is <{root.tag}>: must be <modelSet>"))
    return root


def _number(path: Path, element: ElementTree.Element, name: str, low: float, high: float) -> float:
    text = (element.findtext(name) or "").strip()
    return _within(path, name, text, low, high)


def _within(path: Path, name: str, text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise InputError(reading.one_line(f"{path}: {name} = {text!r}: must be {low:g} … {high:g}"))
    return value


def _values(
    path: Path, element: ElementTree.Element, name: str, low: float, high: float
) -> list[float]:
    return [_within(path, name, v.text or "", low, high) for v in element.iter("value")]


def _lsf(path: Path, models: list[ElementTree.Element], name: str) -> Floats:
    rows = []
    for i, model in enumerate(models):
        element = model.find(name)
        row = [] if element is None else _values(path, element, name, 0, math.pi)
        if not 1 <= len(row) <= MOST_COEFFICIENTS or np.any(np.diff(row) <= 0):
            raise InputError(
                f"{path}: model {i + 1}: {name} has {len(row)} values: must be 1 … "
                f"{MOST_COEFFICIENTS} that ascend"
            )
        rows.append(row)
    if len({len(row) for row in rows}) > 1:
        raise InputError(f"{path}: {name} has different numbers of values from model to model")
    return np.array(rows)


def _triangles(path: Path, root: ElementTree.Element, count: int) -> NDArray[np.intp]:
    """Return the triangles (T, 3), a file's numbers counting from 1."""
    rows = [_values(path, element, "tri", 1, count) for element in root.findall("tri")]
    if not rows or {len(row) for row in rows} != {3}:
        raise InputError(f"{path}: needs triangles, <tri> of three values each")
    return np.array(rows).astype(np.intp) - 1


# As a texture


def texture_from(
    model: ModelSet, speed: float = REFERENCE_SPEED, normal_force: float = REFERENCE_FORCE
) -> tuple[Descriptor, list[str]]:
    """Return a texture with a model's spectrum at a speed and force, and what was assumed.

    The acceleration of the tool, which Penn made one signal of three axes, is taken for that of
    the skin along the stroke; twice integrated it is displacement, held below 20 Hz.

    Raises
    ------
    InputError
        Where the speed is beyond what was recorded, or the model is still there.
    """
    largest = model.point.max(axis=0)
    force = min(normal_force, float(largest[1]))
    if not 0.001 <= speed <= largest[0]:
        raise InputError(
            f"{model.material}: {speed * 1e3:g} mm/s: recorded are up to {largest[0] * 1e3:g}"
        )
    center = _top(model) / 10**0.05 * THIRD_OCTAVE ** np.arange(1.0 - BANDS, 1.0)
    density = np.array([_displacement_power(model, f, speed, force) for f in center])
    if not np.all(density > 0):
        raise InputError(f"{model.material}: no vibration at {speed * 1e3:g} mm/s, {force:g} N")
    level = 10 * np.log10(density * 1e12 * speed * 1e3)
    material = model.material
    texture = Descriptor(
        texture=About(
            id=re.sub("[^a-z0-9]+", "-", material.lower()).strip("-") or "texture",
            category=_category(material),  # type: ignore[arg-type]
            provenance="fitted",
            description=f"{material}, under a tool",
            source=f"Penn Haptic Texture Toolkit, {material}: its spectrum at {speed * 1e3:g} mm/s "
                   f"and {force:g} N, tool acceleration taken for skin acceleration",
            license="Penn Haptic Texture Toolkit: research only, not to be redistributed",
        ),
        reference=Reference(speed_mm_s=speed * 1e3, normal_force_n=force),
        stochastic=Stochastic(
            frequency_per_mm=tuple((center / (speed * 1e3)).tolist()),
            level_db=tuple(np.clip(level, -120, 60).tolist()),
        ),
        laws=_laws(model, speed, force),
        friction=_friction(model),
    )  # fmt: skip
    return texture, [
        "tool acceleration is taken for tangential skin acceleration (assumed)",
        f"below {HAND:g} Hz displacement is held at its spectral density there (assumed)",
        "spectrum and laws of one speed and force stand for the whole set of models",
        "friction is the tool's, and static friction taken as kinetic (assumed)",
    ]


def _top(model: ModelSet) -> float:
    return min(model.sample_rate / 2, TOP)


def _category(material: str) -> str:
    words = re.findall("[a-z]+", material.lower())
    found = [CATEGORIES[word] for word in reversed(words) if word in CATEGORIES]
    return found[0] if found else "textile"


def _displacement_power(model: ModelSet, center: float, speed: float, force: float) -> float:
    """Return the mean spectral density of displacement in a third octave [m²/Hz]."""
    f = center * np.linspace(10**-0.05, 10**0.05, 65)
    return float(np.mean(_displacement_psd(model, f, speed, force)))


def _displacement_psd(model: ModelSet, frequency: Floats, speed: float, force: float) -> Floats:
    held = np.maximum(frequency, HAND)
    density = model.acceleration_psd(held, speed, force) / (2 * np.pi * held) ** 4
    return np.asarray(density)


def _laws(model: ModelSet, speed: float, force: float) -> Laws:
    """Return exponents from the models at half and twice the speed and force, where they are.

    The speed's is what is left of the displacement between 20 Hz and the top when a surface that
    stays the same has moved in frequency.
    """
    fastest, strongest = model.point.max(axis=0)
    slow, fast = speed / 2, min(2 * speed, fastest)
    weak, strong = force / 2, min(2 * force, strongest)
    f = np.geomspace(HAND, _top(model), 400)

    def power(v: float, n: float) -> float:
        return float(np.trapezoid(_displacement_psd(model, f, v, n), f))

    def moved(v: float) -> float:
        density = _displacement_psd(model, np.minimum(f * speed / v, _top(model)), speed, force)
        return float(np.trapezoid(density * speed / v, f))

    faster = power(fast, force) / moved(fast) / (power(slow, force) / moved(slow))
    stronger = power(speed, strong) / power(speed, weak)
    return Laws(
        speed_exponent=_exponent(faster, fast / slow),
        speed_range_mm_s=(slow * 1e3, fast * 1e3),
        force_exponent=_exponent(stronger, strong / weak),
        force_range_n=(weak, strong),
    )


def _exponent(power: float, ratio: float) -> float:
    return min(max(math.log(power) / 2 / math.log(ratio), -4.0), 4.0) if power > 0 else 0.0


def _friction(model: ModelSet) -> Friction | None:
    if not model.friction:
        return None
    return Friction(static_coefficient=model.friction, kinetic_coefficient=model.friction)
