"""Numbers of repetitions of checks: in CI a fifth of those with ``TACTILE_LONG=1``.

`.ci/nightly` sets it.
"""

import os

LONG = bool(os.environ.get("TACTILE_LONG"))


def often(count: int) -> int:
    """Return how many repetitions to make of those that a long run makes."""
    return count if LONG else count // 5
