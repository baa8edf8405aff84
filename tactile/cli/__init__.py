"""The command ``tactile``: parses and prints. A mistake is one line and exit code 2."""

import sys

import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from tactile.cli.app import app
from tactile.errors import TactileError


def main() -> None:
    """Run the command line; exit code 2 where a device or what was asked cannot be used."""
    if sys.argv[1:2] == ["estop"]:  # loads in a fifth of the time that all commands take
        import tactile.cli.stop_commands
    else:
        import tactile.cli.commands  # noqa: F401
    try:
        with threadpool_limits(1):
            status = app(sys.argv[1:] or ["--help"], standalone_mode=False)
    except (typer.Abort, KeyboardInterrupt):
        status = 130
    except (TactileError, OSError) as error:
        status = _complain(f"tactile: {error}")
        if rows := getattr(error, "rows", None):
            from tactile.cli.printing import print_budget

            print_budget(rows, "", console=Console(stderr=True))
    except Exception as error:
        if not hasattr(error, "format_message"):  # the parser's own kind; typer does not export it
            raise
        context = getattr(error, "ctx", None)
        where = "tactile" if context is None else context.command_path
        status = _complain(f"{where}: {' '.join(error.format_message().split())}")
    sys.exit(status if isinstance(status, int) else 0)


def _complain(message: str) -> int:
    print(message, file=sys.stderr)
    return 2
