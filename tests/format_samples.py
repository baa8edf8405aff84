"""Sample files of formats of other projects, which may not be shipped with this one."""

import os
from pathlib import Path

import pytest

SAMPLES = Path(__file__).parents[2] / "shared" / "data" / "formats"


def sample(name: str) -> Path:
    """Return a sample's path, or skip; in CI its absence is a failure."""
    path = SAMPLES / name
    if not path.is_file():
        assert os.environ.get("CI") != "true", f"{path} is missing"
        pytest.skip(f"{path} is missing: samples are not shipped with the project")
    return path
