"""Pictures of studies say what the data says: data sets made by hand, artists read back."""

from pathlib import Path

import matplotlib.collections as mc
import matplotlib.patches as mp
import numpy as np
import pytest
import xarray
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from tactile.errors import InputError
from tactile.show.plots import save
from tactile.study import plots

LENGTH = np.arange(2.0, 21.0)
FREQUENCY = np.linspace(0.0, 1000.0, 21)
SMALLEST = "smallest_displacement_um_per_v"
SHEAR = "displacement_um_per_v"


def study(**variables: xarray.Variable) -> xarray.Dataset:
    """Return a data set with labels like those of a study, band 0 to 500 Hz."""
    coordinates = {
        "load": ("load", np.array(["low", "high"]), {"long_name": "finger"}),
        "length_mm": ("length_mm", LENGTH, {"units": "mm", "long_name": "free length"}),
        "frequency_hz": ("frequency_hz", FREQUENCY, {"units": "Hz", "long_name": "frequency"}),
    }
    used = {d for v in variables.values() for d in v.dims}
    return xarray.Dataset(
        variables,
        {name: entry for name, entry in coordinates.items() if name in used},
        {"conditions": '{"band": [0, 500]}'},
    )


def criterion(values: NDArray[np.float64], name: str = "smallest_displacement") -> xarray.Variable:
    labels = {"units": "µm/V", "long_name": "smallest displacement in the band"}
    return xarray.Variable(
        ("load", "length_mm"), values, labels | {"band": "0 … 500 Hz", "criterion": name}
    )


def response(values: NDArray[np.complex128], *dims: str) -> xarray.Variable:
    labels = {"units": "µm/V", "long_name": "shear of the tip"}
    return xarray.Variable((*dims, "frequency_hz"), values, labels)


def tents() -> NDArray[np.float64]:
    """Return a tent for each finger that falls by 5 % of its top a millimeter from 10 and 12 mm."""
    return np.array([top * (1 - np.abs(LENGTH - at) / 20) for top, at in ((4.0, 10), (1.0, 12))])


def points(line: Line2D) -> NDArray[np.float64]:
    return np.asarray(line.get_xydata(), np.float64)


def corners(shape: mc.Collection) -> NDArray[np.float64]:
    return np.asarray(shape.get_paths()[0].vertices, np.float64)


def words(figure: Figure) -> str:
    legends = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
    titles = [legend.get_title().get_text() for legend in figure.legends]
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    return "\n".join([*legends, *titles, *texts])


def test_a_criterion_shades_what_is_good_enough_and_marks_what_all_share() -> None:
    """Values of 85 % lie within 3 mm of the tops: 7 to 13 and 9 to 15 mm, shared 9 to 13."""
    figure = plots.criterion_figure(study(**{SMALLEST: criterion(tents())}), SMALLEST)
    (axes,) = figure.axes
    for line, tent in zip(axes.lines, tents(), strict=True):
        assert np.array_equal(points(line), np.stack([LENGTH, tent], axis=1))
    shaded = [c for c in axes.collections if isinstance(c, mc.PolyCollection)]
    spans = [float(np.ptp(corners(c)[:, 0])) for c in shaded]
    ends = [float(corners(c)[:, 0].min()) for c in shaded]
    assert [*ends, *spans] == pytest.approx([7, 9, 6, 6])
    (shared,) = (p for p in axes.patches if isinstance(p, mp.Rectangle))
    assert (shared.get_x(), shared.get_width()) == pytest.approx((9, 4))
    assert axes.get_xlabel() == "free length [mm]"
    assert axes.get_ylabel().replace("\n", " ") == "smallest displacement in 0 … 500 Hz [µm/V]"
    for told in ("low finger  7 … 13 mm (best 10)", "high finger  9 … 15 mm (best 12)",
                 "all of them  9 … 13 mm", "at least 85 % of the best"):  # fmt: skip
        assert told in words(figure)


def test_where_less_is_better_the_range_is_around_the_least() -> None:
    drive = criterion(1 / tents(), "drive")
    figure = plots.criterion_figure(study(drive_v=drive), "drive_v", share=0.9)
    shaded = [c for c in figure.axes[0].collections if isinstance(c, mc.PolyCollection)]
    assert corners(shaded[0])[:, 0].min() == pytest.approx(8, abs=0.02)
    assert "at most 111.1 % of the best" in words(figure)


def test_what_is_neither_good_nor_bad_has_no_range() -> None:
    resonance = criterion(tents(), "first_resonance")
    figure = plots.criterion_figure(study(first_resonance_hz=resonance), "first_resonance_hz")
    assert len(figure.axes[0].collections) == 0
    assert words(figure).split("\n")[:2] == ["low finger", "high finger"]


def test_a_response_is_drawn_with_its_phase() -> None:
    """A delay of 1 ms turns by −360° to 1 kHz; three times as large under the low finger."""
    delay = np.exp(-2j * np.pi * FREQUENCY * 1e-3)
    figure = plots.response_phase_figure(
        study(**{SHEAR: response(np.array([3 * delay, delay]), "load")}), SHEAR
    )
    size, phase = figure.axes
    assert np.allclose([points(line)[:, 1] for line in size.lines], [[3.0], [1.0]])
    assert np.allclose(phase.lines[0].get_ydata(), -0.36 * FREQUENCY)
    assert size.get_ylabel() == "shear of the tip [µm/V]"
    assert [axes.get_ylabel() for axes in figure.axes][1:] == ["phase [°]"]
    assert phase.get_xlabel() == "frequency [Hz]"
    assert [text.get_text() for text in size.texts] == ["high finger", "low finger"]
    assert size.lines[0].get_linestyle() != size.lines[1].get_linestyle()


def test_a_map_shows_levels_and_the_smallest_in_the_band_alone() -> None:
    """The figure falls to a hundredth at 500 Hz, beyond the band, which must not count."""
    fall = np.where(FREQUENCY <= 500, 1.0, 0.01)
    values = tents()[:, :, None] * fall
    figure = plots.length_map_figure(
        study(**{SHEAR: response(values.astype(complex), "load", "length_mm")})
    )
    left, right, below_left, below_right = figure.axes[:4]
    for axes, tent, name in ((left, tents()[0], "low"), (right, tents()[1], "high")):
        mesh = next(c for c in axes.collections if isinstance(c, mc.QuadMesh))
        level = np.asarray(mesh.get_array()).reshape(FREQUENCY.size, LENGTH.size)
        assert np.allclose(level[0], 20 * np.log10(tent))
        assert axes.get_title() == f"{name} finger"
    assert np.allclose(below_right.lines[0].get_ydata(), tents()[1])
    for axes, ends in ((below_left, (7, 6)), (below_right, (9, 6))):
        (span,) = (p for p in axes.patches if isinstance(p, mp.Rectangle))
        assert (span.get_x(), span.get_width()) == pytest.approx(ends)
    dashed = {float(points(line)[:, 0].mean()) for line in left.lines}
    assert sorted(dashed) == pytest.approx([7, 13])
    assert figure.axes[4].get_ylabel() == "level [dB re 1 µm/V]"
    assert "7 … 13 mm" in words(figure)


def test_a_tolerance_band_holds_nine_scenarios_of_ten() -> None:
    """Scenarios 0, 1, … 100 times the length: 5, 50 and 95 times it are the band."""
    values = np.arange(101.0)[None, :] * LENGTH[:, None]
    labels = {"units": "mN/V", "long_name": "force"}
    data = study(force=xarray.Variable(("length_mm", "scenario"), values, labels))
    figure = plots.tolerance_figure(data, "force")
    (axes,) = figure.axes
    assert np.allclose(axes.lines[0].get_ydata(), 50 * LENGTH)
    (band,) = axes.collections
    ends = corners(band)
    assert {5 * 20.0, 95 * 20.0} <= set(np.round(ends[ends[:, 0] == 20.0, 1], 9).tolist())
    assert axes.get_ylabel() == "force [mN/V]"
    assert axes.get_title(loc="left") == "line: median, band: 5 … 95 % of 101 scenarios"


def front() -> xarray.Dataset:
    columns = {"footprint_mm2": [3.0, 1.0, 2.0], SMALLEST: [0.9, 0.2, 0.6], "drive_v": [9, 7, 8]}
    names = ("footprint", "smallest_displacement", "drive")
    return xarray.Dataset(
        {
            name: ("design", values, {"criterion": c, "long_name": c, "units": "u"})
            for (name, values), c in zip(columns.items(), names, strict=True)
        },
        attrs={"objectives": f"footprint_mm2 {SMALLEST}"},
    )


def test_a_front_is_joined_in_order_and_the_recommended_design_is_marked() -> None:
    figure = plots.pareto_figure(front(), ("footprint_mm2", SMALLEST), recommended=2)
    (axes,) = figure.axes
    shown = [line for line in axes.lines if np.size(line.get_xdata())]
    joined, recommended = shown
    assert np.array_equal(points(joined), [[1, 0.2], [2, 0.6], [3, 0.9]])
    assert np.array_equal(points(recommended), [[2, 0.6]])
    assert axes.get_xlabel() == "footprint [u]\n(← less is better)"
    assert axes.get_ylabel().endswith("(more is better →)")
    assert "recommended: 2 u, 0.6 u" in words(figure)


def test_a_third_objective_is_color() -> None:
    figure = plots.pareto_figure(front(), ("footprint_mm2", SMALLEST, "drive_v"))
    (dots,) = (c for c in figure.axes[0].collections if isinstance(c, mc.PathCollection))
    assert np.asarray(dots.get_array()).tolist() == [9, 7, 8]
    assert figure.axes[1].get_ylabel().startswith("drive [u]")


def test_the_fingers_keep_their_colors() -> None:
    data = study(**{SMALLEST: criterion(tents())}).isel(load=[1])
    (line,) = plots.criterion_figure(data, SMALLEST).axes[0].lines
    assert line.get_color() == "#D55E00", "the second of Okabe and Ito's"


@pytest.mark.parametrize(
    ("draw", "said"),
    [
        (lambda d: plots.criterion_figure(d, "smalest_displacement_um_per_v"), SMALLEST),
        (lambda d: plots.criterion_figure(d, SMALLEST, axis="width_mm"), "there are: length_mm"),
        (lambda d: plots.criterion_figure(d.isel(length_mm=[0]), SMALLEST), "there are: none"),
        (lambda d: plots.response_phase_figure(d, SMALLEST), "is not a response over frequency"),
        (lambda d: plots.response_phase_figure(d, SHEAR), "38 lines over load, length_mm"),
        (lambda d: plots.tolerance_figure(d, SMALLEST), "no scenarios"),
        (lambda d: plots.pareto_figure(front(), [SMALLEST]), "1 objectives"),
    ],
)  # fmt: skip
def test_what_cannot_be_drawn_is_said_in_a_line(draw: object, said: str) -> None:
    shear = response(np.ones((2, LENGTH.size, FREQUENCY.size), complex), "load", "length_mm")
    data = study(**{SMALLEST: criterion(tents()), SHEAR: shear})
    with pytest.raises(InputError) as raised:
        draw(data)  # type: ignore[operator]
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("suffix", [".png", pytest.param(".pdf", marks=pytest.mark.ci)])
def test_a_picture_is_written(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"front{suffix}"
    save(plots.pareto_figure(front(), ("footprint_mm2", SMALLEST)), path)
    assert path.read_bytes()[:5] in (b"\x89PNG\r", b"%PDF-")
