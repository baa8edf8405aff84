"""The command line ``tactile``. A mistake by the user is one line on stderr and exit code 2.

Nothing is imported before `main` can report an interrupt, because loading takes a while.
"""

import sys


def main() -> None:
    """Run the command line and exit with the exit code of the command.

    The exit code is 2 if the arguments, a file or a device cannot be used, and 130 if the command
    is interrupted. It is 1 if the command ran and its result is not good: `tactile play` lost more
    of the stroke than it may, `tactile check` saw a fault.
    """
    try:
        from tactile.cli.encoding import replace_missing_characters
        from tactile.cli.execution import execute

        replace_missing_characters()
        status = execute(sys.argv[1:])
    except KeyboardInterrupt:
        print("tactile: interrupted", file=sys.stderr)
        status = 130
    sys.exit(status)
