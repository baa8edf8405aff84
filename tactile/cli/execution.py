"""Execution of a command: its exit code, and its errors as one line on standard error."""

import os
import sys

import typer

from tactile.cli.app import app
from tactile.errors import TactileError


def execute(arguments: list[str]) -> int:
    """Run a command, and print the mistakes of the user.

    Parameters
    ----------
    arguments : name of the command and its arguments

    Returns
    -------
    int
        Exit code.

    Raises
    ------
    KeyboardInterrupt
        If the command is interrupted.
    """
    for variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
        os.environ.setdefault(variable, "1")  # read when numpy loads: threads slow small problems
    command = typer.main.get_command(app)
    try:  # as the parser does itself, which would hide an interrupt
        with command.make_context("tactile", arguments or ["--help"]) as context:
            status = command.invoke(context)
    except typer.Exit as ending:
        status = ending.exit_code
    except (typer.Abort, EOFError) as error:  # of a question
        raise KeyboardInterrupt from error
    except (TactileError, OSError) as error:
        status = _complain(f"tactile: {error}")
        if rows := getattr(error, "rows", None):
            from tactile.cli.printing import print_budget

            print_budget(rows, "", stderr=True)
    except Exception as error:
        if not hasattr(error, "format_message"):  # the parser's own kind; typer does not export it
            raise
        where = getattr(getattr(error, "ctx", None), "command_path", "tactile")
        status = _complain(f"{where}: {' '.join(error.format_message().split())}")
    return status if isinstance(status, int) else 0


def _complain(message: str) -> int:
    """Print an error message on standard error and return the exit code 2."""
    print(message, file=sys.stderr)
    return 2
