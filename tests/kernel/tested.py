"""Print a digest of what the guests test: buses, protocol, their own checks and how those run.

`tested.sha256` holds that of the files with which all checks passed last. While it is theirs,
`test_kernel.py` boots no guest, unless KERNEL=1 says so. After a change they run, and

    python tests/kernel/tested.py > tests/kernel/tested.sha256

says that they have passed.
"""

import hashlib
from pathlib import Path

HERE = Path(__file__).parent
PROJECT = HERE.parents[1]
RECORD = HERE / "tested.sha256"
CODE = {".py", ".c", ".h", ".sh"}
BESIDES = (
    "tactile/clock.py", "tactile/processes.py", "firmware_protocol/c/Makefile",
    "tests/chip_models.py", "tests/conftest.py", "pyproject.toml",
)  # fmt: skip


def digest() -> str:
    """Return the digest of the files and their names, wherever the project lies."""
    folders = (HERE, PROJECT / "tactile" / "bus", PROJECT / "firmware_protocol")
    files = [path for folder in folders for path in folder.rglob("*") if path.suffix in CODE]
    files += [PROJECT / name for name in BESIDES]
    total = hashlib.sha256()
    for path in sorted(files):
        total.update(path.relative_to(PROJECT).as_posix().encode() + b"\0")
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


if __name__ == "__main__":
    print(digest())
