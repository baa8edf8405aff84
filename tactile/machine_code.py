"""Compilation of functions to machine code, for loops over samples that no array operation covers.

numba compiles a function for one signature when its module is imported, and keeps the result on
disk: beside the module, or in the user's cache folder where that cannot be written. The first
import after an installation therefore takes seconds, later ones milliseconds, and nothing is
compiled while a display plays. Where neither folder can be written, such as in a sealed service,
each process compiles anew.

Operations may be fused and sums reordered, as by optimized numpy. NaN and infinity keep their
meaning, so that a stage can refuse them.
"""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")

OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz"},
    "nogil": True,
}
"""Options of numba: a division by 0 gives infinity, multiplications and additions may be fused and
reordered, and other threads may run meanwhile."""


def compiled(signature: str | None = None) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Compile a function for given types.

    Parameters
    ----------
    signature : str, optional
        Types of the result and the arguments in the notation of numba, such as
        ``"float64(float32[:, ::1], int64)"``. A function without it can only be called by other
        compiled functions.

    Returns
    -------
    callable
        Decorator that returns the compiled function.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        try:
            made = njit(signature, cache=signature is not None, **OPTIONS)(function)
        except RuntimeError:  # there is no folder to keep the result in
            made = njit(signature, **OPTIONS)(function)
        return cast(Callable[P, R], made)

    return decorate
