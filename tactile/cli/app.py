"""The table of the commands, and the group that loads the module of a command when it is called.

The command ``tactile NAME`` is the function ``run`` of the module ``tactile.cli.NAME_command``. To
add a command, write its module and add its line to `COMMANDS`.
"""

import sys
from difflib import get_close_matches
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperGroup

from tactile.errors import NotFoundError

PLAY = "Play and inspect textures"
AUTHOR = "Create and convert textures"
DESIGN = "Design displays"
DEVICES = "Use devices"
SERVE = "Run the server and stop displays"


class CommandEntry(NamedTuple):
    """A line of the table: the heading of a command in ``tactile --help``, and its summary."""

    group: str
    summary: str


COMMANDS = {
    "play": CommandEntry(PLAY, "Play a texture under a moving finger, or an effect."),
    "replay": CommandEntry(PLAY, "Render a recording again and compare it bit for bit."),
    "sheet": CommandEntry(PLAY, "Draw an overview of the shipped textures."),
    "show": CommandEntry(PLAY, "Show a texture with its surface and spectrum, or an effect."),
    "strength": CommandEntry(PLAY, "Report how strongly a texture is felt on a display."),
    "textures": CommandEntry(PLAY, "List the shipped textures, or describe one of them."),
    "convert": CommandEntry(AUTHOR, "Convert haptic effects and textures to other formats."),
    "fit": CommandEntry(AUTHOR, "Fit a texture to recordings of a sliding finger or sensor."),
    "relief": CommandEntry(AUTHOR, "Create a texture from a height map of a surface."),
    "adjust": CommandEntry(DESIGN, "Fit the finger or the bimorph of a display to measurements."),
    "materials": CommandEntry(DESIGN, "List the known piezoceramics, shims and benders."),
    "optimize": CommandEntry(DESIGN, "Find the Pareto-optimal designs for the given objectives."),
    "paper": CommandEntry(DESIGN, "Reproduce the figures and claims of Hofmann & Twiefel 2014."),
    "response": CommandEntry(DESIGN, "Report the frequency response of the bimorph of a display."),
    "study": CommandEntry(DESIGN, "Sweep the parameters of a bender and compare the designs."),
    "bench": CommandEntry(DEVICES, "Measure the performance of this machine or of a link."),
    "budget": CommandEntry(DEVICES, "List the sample formats and rates that fit on a link."),
    "calibrate": CommandEntry(DEVICES, "Measure the benders of a display in air."),
    "check": CommandEntry(
        DEVICES, "Check the amplifier, the wiring and the channels of a display."
    ),
    "conform": CommandEntry(DEVICES, "Prove that an amplifier keeps to the protocol."),
    "devices": CommandEntry(DEVICES, "List the connected devices with their URLs."),
    "finger": CommandEntry(DEVICES, "Measure the finger that rests on a display."),
    "clear": CommandEntry(SERVE, "Clear an e-stop after a person has checked that it is safe."),
    "estop": CommandEntry(SERVE, "Stop all displays of this machine immediately."),
    "jack": CommandEntry(SERVE, "Turn a display into a sound card of JACK."),
    "lsl": CommandEntry(SERVE, "Offer a display to the Lab Streaming Layer, for recorders."),
    "serve": CommandEntry(SERVE, "Serve displays to other programs by WebSocket and OSC."),
}
"""All commands by name, in the order of ``tactile --help``."""

RENAMED = {
    "band": "band-hz",
    "frequency": "frequency-hz",
    "licence": "license",
    "output": "out",
    "voltage": "voltage-v",
    "write": "out",
}
"""New name of each option that was renamed in version 0.1; remove the old names in 0.2."""

_STYLE: dict[str, Any] = {
    "add_completion": False,
    "pretty_exceptions_enable": False,
    "rich_markup_mode": None,
}


class LazyGroup(TyperGroup):
    """A group whose commands are those of `COMMANDS`, each loaded when it is called."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Load a command and return it, or return None if there is no such command."""
        return load_command(cmd_name) if cmd_name in COMMANDS else None

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the arguments call, or fail with the nearest name."""
        if args[0] not in COMMANDS:
            near = get_close_matches(args[0], COMMANDS, 1, 0.5)
            hint = f"did you mean {near[0]!r}?" if near else "tactile --help lists the commands"
            ctx.fail(f"no command {args[0]!r}; {hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands with their summaries, a section for each group."""
        width = max(map(len, COMMANDS))
        for group in dict.fromkeys(entry.group for entry in COMMANDS.values()):
            rows = [
                (name.ljust(width), entry.summary)
                for name, entry in COMMANDS.items()
                if entry.group == group
            ]
            with formatter.section(group):
                formatter.write_dl(rows)


def load_command(name: str) -> Any:
    """Load the module of a command.

    Parameters
    ----------
    name : name of the command, a key of `COMMANDS`

    Returns
    -------
    typer.core.TyperCommand
        The command, which parses its arguments and calls the function ``run`` of the module.
    """
    single = typer.Typer(**_STYLE)
    single.command(name)(import_module(f"tactile.cli.{name}_command").run)
    return typer.main.get_command(single)


def _new_name(name: str) -> str:
    """Return the name of an option, and warn on standard error if an old one was given."""
    if name not in RENAMED:
        return name
    print(f"tactile: --{name} is deprecated; use --{RENAMED[name]}", file=sys.stderr)
    return RENAMED[name]


app = typer.Typer(cls=LazyGroup, context_settings={"token_normalize_func": _new_name}, **_STYLE)


def _print_version(requested: bool) -> None:
    """Print the installed version and exit, if it was asked for."""
    if requested:
        from importlib.metadata import PackageNotFoundError, version

        try:
            print(f"tactile {version('tactile-display')}")
        except PackageNotFoundError:
            raise NotFoundError("--version: the package tactile-display is not installed") from None
        raise typer.Exit


@app.callback()
def take_options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Render textures on tactile displays made of piezoelectric bimorphs.

    Run tactile COMMAND --help for the options of a command.

    Example: tactile play wood-oak --speed-mm-s 80 --seconds 5
    """
