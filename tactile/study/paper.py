"""The paper that this project began with: its studies, and its claims next to our results.

V. Hofmann and J. Twiefel, "Optimization of a Piezoelectric Bending Actuator for a Tactile Virtual
Reality Display", Energy Harvesting and Systems 2 (2015) 177-185, doi 10.1515/ehs-2014-0055.

The paper's figure of parameters is not available as text, so the default design is a surrogate, and
one number of it, the shim's height of 0.20 mm, was chosen to meet the paper's ranges of length.
Every claim is therefore of one of three kinds (`KINDS`), which are never added up, and `claims`
adds a validation: the shim's height is chosen again from what the paper says of one finger, and the
other finger is predicted.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tactile.actuator.bimorph import Bimorph, capacitance
from tactile.actuator.response import blocked_force
from tactile.arrays import Floats
from tactile.study.criteria import Conditions
from tactile.study.findings import range_of
from tactile.study.parameters import standard_value
from tactile.study.ranges import SHARE, Range, overlap
from tactile.study.sweep import Study, solve_study

if TYPE_CHECKING:
    import xarray

Kind = Literal["fitted", "checked", "record"]
"""Kind of a claim; see `KINDS`."""


@dataclass(frozen=True)
class ClaimKind:
    """What it means that a claim is met.

    Attributes
    ----------
    title : str
        Heading of the claims of this kind.
    source : str
        Who states these claims.
    meaning : str
        What agreement shows.
    """

    title: str
    source: str
    meaning: str


REFERENCE = (
    "V. Hofmann and J. Twiefel, Optimization of a Piezoelectric Bending Actuator for a Tactile "
    "Virtual Reality Display, Energy Harvesting and Systems 2 (2015) 177-185, "
    "doi 10.1515/ehs-2014-0055"
)
"""Citation of the paper."""
KINDS: dict[Kind, ClaimKind] = {
    "fitted": ClaimKind(
        "Stated by the paper, and fitted",
        "the paper",
        "One number of the surrogate, the shim's height of 0.20 mm, was chosen to meet these "
        "claims: agreement shows that the model can say so, not that it must.",
    ),
    "checked": ClaimKind(
        "Stated by the paper, and checked",
        "the paper",
        "The shim's height was not chosen from these claims: agreement supports the model and the "
        "paper's two fingers. The lengths are those of the fitted claims, one finger predicted "
        "from the other.",
    ),
    "record": ClaimKind(
        "Recorded from this program",
        "this program",
        "Earlier results of this program with the surrogate design, for all we know not in the "
        "paper: agreement shows that nothing changed, and says nothing of the paper.",
    ),
}
"""Kinds of claims."""
FINGERS = ("low", "high")
"""Names of the paper's two fingers."""
BAND = (0.0, 1000.0)
"""Band of the paper's study of length [Hz]."""
STATED = {"low": (18.0, 27.0), "high": (10.0, 20.0)}
"""Shortest and longest good length that the paper states for each finger [mm]."""
SMALLEST = "smallest_displacement_um_per_v"
"""Variable of the smallest displacement in the band."""
SHEAR = "displacement_um_per_v"
"""Variable of the tip's displacement."""


@dataclass(frozen=True)
class Claim:
    """A claimed number next to our result.

    Attributes
    ----------
    statement : str
        Claim in words.
    unit : str
        Unit of the numbers.
    stated : float
        Claimed number; of a record, the earlier result.
    result : float
        Present result of the model.
    limit : float
        Largest permitted difference.
    kind : str
        Kind of the claim; see `KINDS`.
    """

    statement: str
    unit: str
    stated: float
    result: float
    limit: float
    kind: Kind

    @property
    def difference(self) -> float:
        """Result minus the claimed number."""
        return self.result - self.stated

    @property
    def is_met(self) -> bool:
        """Whether the difference is within the limit."""
        return abs(self.difference) <= self.limit


@dataclass(frozen=True)
class PaperFigure:
    """A figure that the paper's text describes.

    Attributes
    ----------
    name : str
        Name of its files.
    title : str
        Title in the report.
    caption : str
        Caption in the report.
    study : callable
        Function that returns the `Study` of its data.
    variable : str
        Variable of the data that is drawn.
    is_map : bool
        Whether it is drawn over length and frequency.
    """

    name: str
    title: str
    caption: str
    study: Callable[[], Study]
    variable: str
    is_map: bool = False


def in_air() -> Study:
    """Return the study of the mechanical and the electrical admittance with a free tip.

    Returns
    -------
    Study
        Study with a grid of frequencies that is refined around both resonances.
    """
    near = [np.linspace(f - 60, f + 60, 241) for f in (930, 5783)]
    frequency = np.unique(np.concatenate([np.geomspace(10, 8e3, 800), *near]))
    return Study(axes={"load": ["none"]}, frequency=frequency, responses=("velocity", "admittance"))


def under_finger(finger: str) -> Study:
    """Return the study of the response under a finger.

    Parameters
    ----------
    finger : str
        Name of the finger load.

    Returns
    -------
    Study
        Study of the displacement.
    """
    return Study(
        axes={"load": [finger]}, frequency=np.geomspace(10, 8e3, 800), responses=("displacement",)
    )


def over_length(*fingers: str) -> Study:
    """Return the study of the free length under some fingers.

    Steps of 10 Hz suffice, because no loaded resonance is narrower.

    Parameters
    ----------
    *fingers : str
        Names of the finger loads.

    Returns
    -------
    Study
        Study of the displacement over load, length and frequency.
    """
    return Study(
        axes={"load": list(fingers), "length_mm": np.arange(50, 451) / 10},
        frequency=np.arange(0.0, 1001.0, 10.0),
        criteria=("smallest_displacement",),
        responses=("displacement",),
        conditions=Conditions(band=BAND),
    )


FIGURES: tuple[PaperFigure, ...] = (
    PaperFigure(
        "mechanical-admittance",
        "Mechanical admittance in air",
        "Velocity of the free tip per volt. The paper measures it to adjust its losses; those of "
        "the surrogate are assumed, so that heights of peaks are no prediction.",
        in_air,
        "velocity_mm_per_s_v",
    ),
    PaperFigure(
        "electrical-admittance",
        "Electrical admittance in air",
        "Current per volt of the whole bender with a free tip. Between each resonance and the "
        "antiresonance above it the phase falls: the distance is the coupling.",
        in_air,
        "admittance_us",
    ),
    *(
        PaperFigure(
            f"loaded-{finger}",
            f"Response under the {finger} finger",
            f"Shear of the tip per volt at the default length under the paper's {finger} finger; "
            "up to 1 kHz the finger, not the bender, decides.",
            partial(under_finger, finger),
            SHEAR,
        )
        for finger in FINGERS
    ),
    *(
        PaperFigure(
            f"length-{finger}",
            f"Free length under the {finger} finger",
            "Level of the shear per volt over free length and frequency; below, the smallest in 0 "
            f"… 1000 Hz, and where it is at least 85 % of the best. The paper finds {low:g} … "
            f"{high:g} mm.",
            partial(over_length, finger),
            SHEAR,
            is_map=True,
        )
        for finger, (low, high) in STATED.items()
    ),
)
"""Figures of the paper."""


def good_lengths(data: "xarray.Dataset") -> dict[str, Range]:
    """Compute the range of good lengths under each finger.

    Parameters
    ----------
    data : xarray.Dataset
        Data set of a study over load and length.

    Returns
    -------
    dict of str to Range
        Range of the free length by finger [mm].
    """
    return {
        str(finger): range_of(data[SMALLEST].sel(load=finger), SHARE)
        for finger in data["load"].values
    }


def claims() -> list[Claim]:
    """Compute the result for every claim with the default design; takes about a second.

    Returns
    -------
    list of Claim
        Claims on lengths, predictions and the figures of the default design.
    """
    return [*_claims_of_length(), *_claims_of_prediction(), *_records()]


def summarize(results: list[Claim]) -> str:
    """Count the claims of each kind and those of them that are met, without one sum over kinds.

    Parameters
    ----------
    results : list of Claim
        Claims as `claims` computes them.

    Returns
    -------
    str
        Summary in two sentences.
    """
    counts = {kind: sum(claim.kind == kind for claim in results) for kind in KINDS}
    met = {kind: sum(claim.kind == kind and claim.is_met for claim in results) for kind in KINDS}
    fitted, checked = (f"{counts[kind]} {kind} ({met[kind]} met)" for kind in ("fitted", "checked"))
    return (
        f"{counts['fitted'] + counts['checked']} claims are stated by the paper: {fitted}, "
        f"{checked}. {counts['record']} are records of this program's own results, of which "
        f"{met['record']} are unchanged; they say nothing of the paper."
    )


def _claims_of_length() -> list[Claim]:
    """Return the claims that the shim's height was chosen to meet."""
    ranges = good_lengths(solve_study(over_length(*FINGERS)))
    results = [
        _length_claim(f"good lengths under the {finger} finger, {end}", stated, value, "fitted")
        for finger in FINGERS
        for end, stated, value in zip(
            ("shortest", "longest"), STATED[finger], _ends(ranges[finger]), strict=True
        )
    ]
    _, longest = overlap(list(ranges.values())) or (np.nan, np.nan)
    results.append(_length_claim("longest bender that suits both fingers", 20.0, longest, "fitted"))
    return results


def _ends(good: Range) -> tuple[float, float]:
    return good.low, good.high


def _length_claim(statement: str, stated: float, result: float, kind: Kind) -> Claim:
    """Return a claim on an end of a range of length."""
    return Claim(statement, "mm", stated, result, 1.0, kind)


def _claims_of_prediction() -> list[Claim]:
    """Return the claims on one finger, the shim's height chosen from the other finger alone."""
    heights = np.arange(4, 42, 2) / 100
    study = Study(
        axes={
            "load": list(FINGERS), "shim_height_mm": heights, "length_mm": np.arange(20, 180) / 4,
        },
        frequency=np.arange(0.0, 1001.0, 25.0), criteria=("smallest_displacement",),
        conditions=Conditions(band=BAND),
    )  # fmt: skip
    data = solve_study(study)
    ranges = [good_lengths(data.isel(shim_height_mm=k)) for k in range(heights.size)]
    results = []
    for known, other in (FINGERS, FINGERS[::-1]):
        miss = [np.hypot(*np.subtract(_ends(f[known]), STATED[known])) for f in ranges]
        best = int(np.argmin(miss))
        for end, stated, value in zip(
            ("shortest", "longest"), STATED[other], _ends(ranges[best][other]), strict=True
        ):
            statement = (
                f"good lengths under the {other} finger, {end}, with the shim's height chosen from "
                f"the {known} finger alone ({heights[best]:.2f} mm)"
            )
            results.append(_length_claim(statement, stated, value, "checked"))
    shorter = sum(f["high"].best < f["low"].best for f in ranges) / len(ranges) * 100
    statement = "shims of 0.04 … 0.40 mm whose best length is shorter under the high finger"
    return [*results, Claim(statement, "%", 100.0, shorter, 0.0, "checked")]


def _records() -> list[Claim]:
    """Return the recorded figures of the default design as claims."""
    loads = {"load": ["none", *FINGERS]}
    size = _sizes(loads)
    changed = partial(_change, size, loads)
    dense = changed(shim_density_kg_m3=2 * float(standard_value("shim_density_kg_m3", Bimorph())))
    wide = changed(width_mm=2 * float(standard_value("width_mm", Bimorph())))
    pressed = changed(axial_force_n=-0.1)
    shaping = 20 * np.log10(size.max(axis=1) / size[:, 1:].min(axis=1))
    volts = 10 / size[:, 1:].min(axis=1)
    force, stiffness = blocked_force(Bimorph(), 0)
    free = _free_capacitance()
    rows = [
        ("first resonance in air", "Hz", 930, _peak(930), 1),
        ("second resonance in air", "Hz", 5783, _peak(5783), 1),
        ("static shear in air", "µm/V", 0.931, size[0, 0], 0.0005),
        ("static shear under the low finger", "µm/V", 0.56, size[1, 0], 0.005),
        ("static shear under the high finger", "µm/V", 0.245, size[2, 0], 0.0005),
        ("blocked force", "mN/V", 1.43, force[0].real * 1e3, 0.005),
        ("stiffness of the tip", "N/m", 1535, stiffness[0].real, 0.5),
        ("capacitance, tip free", "nF", 12.8, free, 0.05),
        ("capacitance, bending blocked", "nF", 11.0, _held_capacitance(), 0.05),
        ("shaping for flat shear, 10 … 1000 Hz, low finger", "dB", 1.7, shaping[1], 0.05),
        ("shaping for flat shear, 10 … 1000 Hz, high finger", "dB", 5.4, shaping[2], 0.05),
        ("shaping for flat shear, 10 … 1000 Hz, in air", "dB", 34, shaping[0], 0.5),
        ("drive for flat 10 µm, low finger", "V", 20, volts[1], 0.5),
        ("drive for flat 10 µm, high finger", "V", 76, volts[2], 0.5),
        ("most that twice the shim's density changes, loaded", "dB", 0.35, dense.max(), 0.005),
        ("least that twice the width gains, loaded", "dB", 1.9, wide.min(), 0.06),
        ("most that twice the width gains, loaded", "dB", 6.8, wide.max(), 0.06),
        ("most that pressing with 0.1 N changes, loaded", "dB", 0.02, np.abs(pressed).max(), 0.005),
        ("most that the printed sign of the load is wrong by", "dB", 13, _wrong_sign(), 1),
    ]
    return [
        Claim(words, unit, stated, float(result), limit, "record")
        for words, unit, stated, result, limit in rows
    ]


def _responses(axes: dict[str, Any], frequency: Floats, **fixed: float) -> NDArray[np.complex128]:
    """Return the displacement per volt, with one row for each load [µm/V]."""
    study = Study(axes=axes, frequency=frequency, fixed=fixed, responses=("displacement",))
    return np.asarray(solve_study(study)[SHEAR].values)


def _sizes(axes: dict[str, Any], **fixed: float) -> Floats:
    """Return the magnitude of the displacement per volt over 0 … 1000 Hz [µm/V]."""
    return np.abs(_responses(axes, np.arange(0.0, 1001.0, 10.0), **fixed))


def _change(size: Floats, axes: dict[str, Any], **fixed: float) -> Floats:
    """Return the level that a change of the design adds under both fingers [dB]."""
    return np.asarray(20 * np.log10(_sizes(axes, **fixed)[1:] / size[1:]))


def _peak(near: float) -> float:
    """Return the frequency within 20 Hz of ``near`` at which the free tip moves most [Hz]."""
    sweep = np.arange(near - 20, near + 20, 0.1)
    return float(sweep[np.argmax(np.abs(_responses({"load": ["none"]}, sweep)))])


def _free_capacitance() -> float:
    """Return the low-frequency capacitance of the free bender, from its admittance [nF]."""
    study = Study(axes={"load": ["none"]}, frequency=[1.0], responses=("admittance",))
    siemens = complex(solve_study(study)["admittance_us"].values.item()) * 1e-6
    return siemens.imag / (2 * np.pi) * 1e9


def _held_capacitance() -> float:
    """Return the capacitance with bending blocked, including the clamped part [nF]."""
    b = Bimorph()
    return float(np.real(capacitance(b, np.add(b.length, b.clamped_length)))) * 1e9


def _wrong_sign() -> float:
    """Return the largest error of the response if the finger pulled instead of pushing back [dB].

    With r = free/loaded = 1 + C S, for the tip's compliance C and the load's stiffness S, the wrong
    sign gives free/(1 − C S) = loaded · r/(2 − r).
    """
    axes = {"load": ["none", *FINGERS]}
    free, *loaded = _responses(axes, np.arange(0.0, 1001.0, 10.0))
    ratio = free / np.array(loaded)
    return float(np.max(np.abs(20 * np.log10(np.abs(ratio / (2 - ratio))))))
