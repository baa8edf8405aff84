"""The benchmark of design studies: registered, and beside the yardstick of this checkout."""

from benchmarks import BENCHMARKS
from benchmarks.study import REFERENCE, measure_study, sweep_robustly


def test_studies_are_measured_beside_the_finite_elements_of_the_checkout() -> None:
    """The figures would be left out silently outside of a checkout."""
    assert REFERENCE.is_file()
    assert BENCHMARKS["study"] is measure_study


def test_the_smallest_robust_sweep_is_solved() -> None:
    """The sweep has one length, four widths, four heights and 32 scenarios."""
    sweep_robustly(512)
