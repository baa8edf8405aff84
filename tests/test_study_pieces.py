"""Tests of the parts of a study's solution: pieces, the extra, a band, and labels."""

import subprocess
import sys
from typing import Any

import pytest
from numpy.typing import ArrayLike
from study_rig import study

from tactile.errors import InputError
from tactile.study import sweep as sweeps
from tactile.study.criteria import CRITERIA
from tactile.study.parameters import Specimen
from tactile.study.sweep import Study, solve_study


def test_no_more_is_solved_at_once_than_a_processor_s_cache_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """7168 points of a complex number are below the 128 KiB at which memory gets slow."""
    solved, response_of = [], sweeps.response_of

    def watched(designs: Specimen, frequency: ArrayLike) -> object:
        found = response_of(designs, frequency)
        assert found is not None
        solved.append(found.displacement.size)
        return found

    monkeypatch.setattr(sweeps, "response_of", watched)
    asked = study(200)
    solve_study(asked)
    assert sum(solved) == 200 * 2 * 51
    assert 7168 / 2 < max(solved) <= 7168


def test_only_a_criterion_of_a_band_is_labeled_with_it() -> None:
    found = solve_study(study(2))
    assert found.smallest_displacement_um_per_v.attrs["band"] == "0 … 1000 Hz"
    assert "band" not in found.blocked_force_mn_per_v.attrs


def test_a_study_is_asked_without_the_extra_and_solved_with_it() -> None:
    """The error without xarray is one line that says what to install."""
    program = """
import sys
sys.modules["xarray"] = None
from tactile.errors import InputError
from tactile.study.sweep import Study, solve_block, solve_study
asked = Study(axes={"length_mm": [20.0]}, criteria=("footprint",))
assert solve_block(asked, (slice(0, 1),))["footprint_mm2"].shape == (1,)
try:
    solve_study(asked)
except InputError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.stderr == ""
    assert "tactile-display[study]" in done.stdout
    assert len(done.stdout.splitlines()) == 1


@pytest.mark.parametrize("name", CRITERIA)
def test_what_is_read_from_a_response_needs_a_band_and_the_rest_does_not(name: str) -> None:
    at_rest = {"blocked_force", "first_resonance", "footprint", "standing"}
    asked: dict[str, Any] = {"axes": {"length_mm": [20.0]}, "frequency": [0.0, 1000.0]}
    if name in at_rest:
        assert Study(**asked, criteria=(name,)).designs == 1
    else:
        with pytest.raises(InputError, match=f"^{name}: needs a band"):
            Study(**asked, criteria=(name,))
