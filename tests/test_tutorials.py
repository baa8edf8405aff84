"""Each tutorial's lines run, in order, in an empty folder.

A page becomes one script of bash. A block that is marked ``sh`` is part of it, one marked
``python`` is a program of its own, and one with a caption is written to a file of that name. A
caption that begins with "Not run:" says why a block is left out.
"""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PAGES = sorted((Path(__file__).parents[1] / "docs" / "tutorials").glob("[!i]*.md"))
REAL_TIME = {"vr-loop", "port-the-firmware"}
BLOCK = re.compile(
    r"^```(?:\{code-block\} )?(\w+)\n(?::caption: \"?(.+?)\"?\n)?(.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
PATIENCE = 300
"""Longest time that a page may take [s]."""


def script_of(page: str) -> Iterator[str]:
    """Yield the parts of the script that a page is."""
    yield "set -euo pipefail\ntrap 'kill $(jobs -p) 2>/dev/null || :' EXIT\n"
    for language, caption, body in BLOCK.findall(page):
        if caption.startswith("Not run:"):
            yield f"echo {caption!r}\n"
        elif caption:
            yield f"cat > {caption} <<'END OF BLOCK'\n{body}END OF BLOCK\n"
        elif language == "python":
            yield f"python -W error - <<'END OF BLOCK'\n{body}END OF BLOCK\n"
        elif language == "sh":
            yield body


@pytest.mark.ci
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.stem, marks=[pytest.mark.realtime] * (page.stem in REAL_TIME))
        for page in PAGES
    ],
)
def test_its_lines_run(page: Path, tmp_path: Path) -> None:
    script = "".join(script_of(page.read_text("utf-8")))
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "XDG_RUNTIME_DIR": str(tmp_path),
        "XDG_STATE_HOME": str(tmp_path),
    }
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True,
        timeout=PATIENCE, check=False,
    )  # fmt: skip
    print(done.stdout)
    assert done.returncode == 0, done.stderr
