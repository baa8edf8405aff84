"""Tests of functions compiled to machine code."""

from collections.abc import Callable

import numpy as np

from tactile.arrays import Floats
from tactile.machine_code import compiled

SUM = "float64(float64[::1])"


@compiled(SUM)
def total(values: Floats) -> float:
    """Return the sum of values."""
    result = 0.0
    for value in values:
        result += value
    return result


def test_not_a_number_and_infinity_keep_their_meaning() -> None:
    assert total(np.ones(1000)) == 1000.0
    assert np.isnan(total(np.array([1.0, np.nan] * 50)))
    assert total(np.array([1.0, np.inf] * 50)) == np.inf


def test_a_function_whose_result_cannot_be_kept_is_compiled_all_the_same() -> None:
    """Compile a function without a source file, for which numba knows no folder."""
    names: dict[str, Callable[[Floats], float]] = {}
    exec("def first(values): return values[0]", names)
    assert compiled(SUM)(names["first"])(np.array([2.0, 3.0])) == 2.0
