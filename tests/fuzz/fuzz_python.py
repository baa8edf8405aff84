"""Feeds a target of `protocol_fuzz` from atheris, which must be installed (it is no dependency).

``python tests/fuzz/fuzz_python.py TARGET [libFuzzer's options]``, as ``-max_total_time=600``.
"""

import sys
from importlib import import_module
from pathlib import Path

TESTS = Path(__file__).parents[1]


def main() -> None:
    """Run a target until libFuzzer ends it."""
    atheris = import_module("atheris")
    sys.path[:0] = [str(TESTS), str(TESTS.parent)]
    with atheris.instrument_imports(include=["firmware_protocol"]):
        targets = import_module("protocol_fuzz").TARGETS
    name = sys.argv.pop(1) if len(sys.argv) > 1 else ""
    if name not in targets:
        sys.exit(f"a target is one of {', '.join(targets)}")
    atheris.Setup(sys.argv, targets[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
