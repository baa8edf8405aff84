"""Penn Haptic Texture Toolkit: texture models as XML, from the copy of the user (none is shipped).

A model is an ARMA filter, driven by white Gaussian noise, for the acceleration [m/s²] of a
hand-held tool at a speed and a force (Culbertson, Unwin & Kuchenbecker, "Modeling and Rendering
Realistic Textures from Unconstrained Tool-Surface Interactions", IEEE ToH 2014). Between the models
of a set, the line spectral frequencies, the variance and the gain are interpolated in the triangle
of (speed, force) around the given point, which is limited to the range of the set.

The license of the toolkit is for research and does not allow redistribution. A texture that was
made from a model says so in its file.
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.errors import InputError
from tactile.texture.descriptor import (
    THIRD_OCTAVE,
    About,
    Descriptor,
    Friction,
    Laws,
    Reference,
    Stochastic,
)
from tactile.texture.formats import reading
from tactile.texture.power_laws import speed_range

REFERENCE_SPEED, REFERENCE_FORCE = 0.1, 1.0
"""Default speed [m/s] and normal force [N] of a texture: in the middle of what was recorded
(assumed)."""
HAND = 20.0
"""Frequency below which acceleration is that of the hand. Displacement is held there (assumed)
[Hz]."""
TOP = 1000.0
"""Highest frequency of a texture [Hz]."""
BANDS = 16
"""Number of third octaves below that, which reach down to the motion of the hand."""
MOST_MODELS, MOST_COEFFICIENTS = 1000, 64
"""Largest number of models, and of coefficients of a model."""
CATEGORIES = {
    "wood": "wood", "mdf": "wood", "cork": "wood", "leather": "leather", "plastic": "plastic",
    "acrylic": "plastic", "foam": "foam", "styrofoam": "foam", "metal": "metal",
    "aluminum": "metal", "sandpaper": "abrasive", "scouring": "abrasive", "stone": "stone",
    "brick": "stone", "tile": "stone", "ceramic": "stone", "terra": "stone", "rubber": "rubber",
    "glove": "rubber", "paper": "paper", "card": "paper", "cardboard": "paper", "folder": "paper",
    "book": "paper", "glass": "glass",
}  # fmt: skip
"""Category by a word in the name of a material. The last word that occurs here counts; a material
without one is taken as a textile."""


class Filter(NamedTuple):
    """Filter of white noise.

    Attributes
    ----------
    b : (Q + 1,) array of float
        Numerator.
    a : (P + 1,) array of float
        Denominator.
    variance : float
        Variance of the noise [(m/s²)²].
    """

    b: Floats
    a: Floats
    variance: float


@dataclass(frozen=True)
class ModelSet:
    """Models of one material.

    Attributes
    ----------
    material : str
        Name of the material.
    sample_rate : float
        Sample rate of the models [Hz].
    friction : float
        Kinetic coefficient of friction of the tool.
    point : (M, 2) array of float
        Speed [m/s] and force [N] of each model.
    triangle : (T, 3) array of int
        Indices of the models at the corners of each triangle.
    ar_lsf : (M, P) array of float
        Line spectral frequencies of the denominators [rad/sample].
    ma_lsf : (M, Q) array of float
        Line spectral frequencies of the numerators [rad/sample]. Q is 0 for AR models.
    variance : (M,) array of float
        Variances of the noise [(m/s²)²].
    gain : (M,) array of float
        Gains of the numerators.
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
        """Interpolate the filter at a speed and force.

        Parameters
        ----------
        speed : float
            Speed, of either sign [m/s].
        normal_force : float
            Normal force [N].

        Returns
        -------
        Filter
            Filter for the acceleration of the tool.
        """
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
        target = np.clip([speed, normal_force], self.point.min(axis=0), largest) / largest
        corner = (self.point / largest)[self.triangle]
        edges = np.stack([corner[:, 0] - corner[:, 2], corner[:, 1] - corner[:, 2]], axis=2)
        # Barycentric weights of the point in each triangle; flat triangles have none.
        flat = np.abs(np.linalg.det(edges)) < 1e-12
        edges[flat] = np.eye(2)
        part = np.linalg.solve(edges, (target - corner[:, 2])[:, :, None])[:, :, 0]
        weight = np.column_stack([part, 1 - part.sum(axis=1)])
        weight[flat] = -np.inf
        # If no triangle contains the point, the one that comes nearest to doing so is taken.
        best = int(np.argmax(weight.min(axis=1)))
        inside = np.clip(weight[best], 0, None)
        return self.triangle[best], inside / inside.sum()

    def acceleration_psd(self, frequency: Floats, speed: float, normal_force: float) -> Floats:
        """Compute the one-sided power spectral density of acceleration, 2 σ² |B/A|² / fs.

        Parameters
        ----------
        frequency : (F,) array of float
            Frequencies [Hz].
        speed : float
            Speed, of either sign [m/s].
        normal_force : float
            Normal force [N].

        Returns
        -------
        (F,) array of float
            Density, 0 above half of the sample rate [(m/s²)²/Hz].
        """
        b, a, variance = self.filter_at(speed, normal_force)
        from scipy.signal import freqz  # The import takes half a second, which servers are spared.

        _, response = freqz(b, a, worN=2 * np.pi * frequency / self.sample_rate)
        density = 2 * variance * np.abs(response) ** 2 / self.sample_rate
        return np.asarray(np.where(frequency <= self.sample_rate / 2, density, 0.0))


def polynomial(lsf: Floats) -> Floats:
    """Compute the monic polynomial of line spectral frequencies.

    Parameters
    ----------
    lsf : (P,) array of float
        Line spectral frequencies in ascending order [rad/sample].

    Returns
    -------
    (P + 1,) array of float
        Coefficients, beginning with 1.

    Notes
    -----
    The polynomial is A = (S + D)/2. The first, third, … frequency are zeros of the symmetric S, the
    others are zeros of the antisymmetric D. Where P is even, S has a further zero at −1 and D one
    at 1; where P is odd, D has both (Itakura 1975).
    """
    if not len(lsf):
        return np.ones(1)
    symmetric = _circle(lsf[0::2], [] if len(lsf) % 2 else [-1.0])
    antisymmetric = _circle(lsf[1::2], [-1.0, 1.0] if len(lsf) % 2 else [1.0])
    return np.asarray(((symmetric + antisymmetric) / 2)[:-1])


def _circle(angle: Floats, real: list[float]) -> Floats:
    """Return the polynomial with pairs of zeros on the unit circle and given real zeros."""
    zeros = np.concatenate([np.exp(1j * angle), np.exp(-1j * angle), real])
    return np.asarray(np.real(np.poly(zeros)))


# Reading of a file


def load_model(path: Path) -> ModelSet:
    """Read the models of a material from an XML file.

    Parameters
    ----------
    path : Path
        File to read.

    Returns
    -------
    ModelSet
        Models of the material.

    Raises
    ------
    NotFoundError
        If there is no such file.
    InputError
        If the file is invalid. The message is one line with the file, what is wrong and what is
        allowed.
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
    """Return the root of a file. Its text must be UTF-8 and must not define entities."""
    raw = reading.contents(path)
    if b"<!DOCTYPE" in raw or b"<!ENTITY" in raw:
        raise InputError(f"{path}: has a document type: must be plain XML")
    try:
        root = ElementTree.fromstring(raw.decode("utf-8-sig"))
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise InputError(reading.one_line(f"{path}: not valid XML: {error}")) from error
    if root.tag != "modelSet":
        raise InputError(reading.one_line(f"{path}: is <{root.tag}>: must be <modelSet>"))
    return root


def _number(path: Path, element: ElementTree.Element, name: str, low: float, high: float) -> float:
    """Return the number in a child of an element."""
    text = (element.findtext(name) or "").strip()
    return _within(path, name, text, low, high)


def _within(path: Path, name: str, text: str, low: float, high: float) -> float:
    """Return a text as a number, or raise `InputError` if it is outside its limits."""
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
    """Return the numbers in all ``value`` elements below an element."""
    return [_within(path, name, v.text or "", low, high) for v in element.iter("value")]


def _lsf(path: Path, models: list[ElementTree.Element], name: str) -> Floats:
    """Return the line spectral frequencies of all models (M, P) [rad/sample]."""
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
    """Return the triangles (T, 3), whose numbers count from 1 in a file and from 0 here."""
    rows = [_values(path, element, "tri", 1, count) for element in root.findall("tri")]
    if not rows or {len(row) for row in rows} != {3}:
        raise InputError(f"{path}: needs triangles, <tri> of three values each")
    return np.array(rows).astype(np.intp) - 1


# Conversion to a texture


def texture_from(
    model: ModelSet, speed: float = REFERENCE_SPEED, normal_force: float = REFERENCE_FORCE
) -> tuple[Descriptor, list[str]]:
    """Make a texture with the spectrum of a model at a speed and force.

    The acceleration of the tool, which Penn reduced from three axes to one signal, is taken as that
    of the skin along the stroke. Integrated twice it is displacement, which is held below 20 Hz.

    Parameters
    ----------
    model : ModelSet
        Models of a material.
    speed : float
        Reference speed of the texture [m/s].
    normal_force : float
        Reference normal force of the texture, limited to what was recorded [N].

    Returns
    -------
    texture : Descriptor
        The texture.
    assumptions : list of str
        What was assumed, one line each.

    Raises
    ------
    InputError
        If the speed is outside of what was recorded, or there is no vibration at it.
    """
    largest = model.point.max(axis=0)
    force = min(normal_force, float(largest[1]))
    if not 0.001 <= speed <= largest[0]:
        raise InputError(
            f"{model.material}: {speed * 1e3:g} mm/s: was recorded up to {largest[0] * 1e3:g} mm/s"
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
    """Return the highest frequency of a texture [Hz]."""
    return min(model.sample_rate / 2, TOP)


def _category(material: str) -> str:
    """Return the category of a material by its name."""
    words = re.findall("[a-z]+", material.lower())
    categories = [CATEGORIES[word] for word in reversed(words) if word in CATEGORIES]
    return categories[0] if categories else "textile"


def _displacement_power(model: ModelSet, center: float, speed: float, force: float) -> float:
    """Return the mean spectral density of displacement in a third octave [m²/Hz]."""
    f = center * np.linspace(10**-0.05, 10**0.05, 65)
    return float(np.mean(_displacement_psd(model, f, speed, force)))


def _displacement_psd(model: ModelSet, frequency: Floats, speed: float, force: float) -> Floats:
    """Return the spectral density of displacement, held below `HAND` [m²/Hz]."""
    held = np.maximum(frequency, HAND)
    density = model.acceleration_psd(held, speed, force) / (2 * np.pi * held) ** 4
    return np.asarray(density)


def _laws(model: ModelSet, speed: float, force: float) -> Laws:
    """Return exponents from the models at half and twice the speed and force, as far as they go.

    A surface that stays the same moves in frequency as the speed changes. The speed exponent is
    what remains of the displacement between 20 Hz and the top after this shift.
    """
    fastest, strongest = model.point.max(axis=0)
    slow, fast = speed / 2, min(2 * speed, fastest)
    weak, strong = force / 2, min(2 * force, strongest)
    f = np.geomspace(HAND, _top(model), 400)

    def power(v: float, n: float) -> float:
        """Return the power of the displacement at a speed and force [m²]."""
        return float(np.trapezoid(_displacement_psd(model, f, v, n), f))

    def moved(v: float) -> float:
        """Return the power of the reference displacement, shifted in frequency to a speed [m²]."""
        density = _displacement_psd(model, np.minimum(f * speed / v, _top(model)), speed, force)
        return float(np.trapezoid(density * speed / v, f))

    faster = power(fast, force) / moved(fast) / (power(slow, force) / moved(slow))
    stronger = power(speed, strong) / power(speed, weak)
    return Laws(
        speed_exponent=_exponent(faster, fast / slow),
        speed_range_mm_s=speed_range(slow, fast),
        force_exponent=_exponent(stronger, strong / weak),
        force_range_n=(weak, strong),
    )


def _exponent(power: float, ratio: float) -> float:
    """Return the exponent of an amplitude from the ratios of power and of its cause."""
    return min(max(math.log(power) / 2 / math.log(ratio), -4.0), 4.0) if power > 0 else 0.0


def _friction(model: ModelSet) -> Friction | None:
    """Return the friction of the tool, or None if it is 0."""
    if not model.friction:
        return None
    return Friction(static_coefficient=model.friction, kinetic_coefficient=model.friction)
