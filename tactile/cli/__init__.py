"""The command line ``tactile``. A mistake by the user is one line on stderr and exit code 2."""

import os
import sys

import typer

from tactile.cli.app import app
from tactile.errors import TactileError


def main() -> None:
    """Run the command line and exit with the exit code of the command.

    The exit code is 2 if the arguments, a file or a device cannot be used, and 130 if the command
    is interrupted. It is 1 if the command ran and its result is not good: `tactile play` lost more
    of the stroke than it may, `tactile check` saw a fault.
    """
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
        os.environ.setdefault(variable, "1")  # read when numpy loads: threads slow small problems
    try:
        status = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt):
        status = 130
    except (TactileError, OSError) as error:
        status = _complain(f"tactile: {error}")
        if rows := getattr(error, "rows", None):
            from tactile.cli.printing import print_budget

            print_budget(rows, "", stderr=True)
    except Exception as error:
        if not hasattr(error, "format_message"):  # the parser's own kind; typer does not export it
            raise
        context = getattr(error, "ctx", None)
        where = "tactile" if context is None else context.command_path
        status = _complain(f"{where}: {' '.join(error.format_message().split())}")
    sys.exit(status if isinstance(status, int) else 0)


def _complain(message: str) -> int:
    """Print an error message on standard error and return the exit code 2."""
    print(message, file=sys.stderr)
    return 2
