"""Build of the JavaScript client and of the page that the server serves, by TypeScript.

``python -m clients.build`` compiles both to `WEB`. With ``--check`` it writes nothing: it names the
files that differ from what it would write, and exits with code 1 if there are any.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

PROJECT = Path(__file__).parents[1]
"""Folder of the checkout."""
SOURCE = PROJECT / "clients" / "javascript"
"""Folder of the TypeScript sources and of the compiler's configuration."""
WEB = PROJECT / "tactile" / "server" / "web"
"""Folder of the files that the server serves."""
FOLDERS = ("client", "page")
"""Folders in `WEB` that the build writes, and that hold nothing else."""


def main(arguments: list[str]) -> int:
    """Write the files, or name those that differ.

    Parameters
    ----------
    arguments : list of str
        Command line arguments.

    Returns
    -------
    int
        Exit code.
    """
    built, present = compiled(), scripts_in(WEB)
    differing = [name for name in sorted(built | present) if built.get(name) != present.get(name)]
    for name in differing:
        if "--check" in arguments:
            print(f"web/{name} differs; run python -m clients.build", file=sys.stderr)
        elif name in built:
            (WEB / name).parent.mkdir(parents=True, exist_ok=True)
            (WEB / name).write_text(built[name], "utf-8")
            print(f"wrote web/{name}")
        else:
            (WEB / name).unlink()
            print(f"removed web/{name}")
    return int(bool(differing) and "--check" in arguments)


def compiled() -> dict[str, str]:
    """Compile all sources.

    Returns
    -------
    dict of str to str
        Texts of the JavaScript files by name, such as "client/index.js".

    Raises
    ------
    SystemExit
        If there is no compiler, or if the sources have errors, with those.
    """
    compiler = shutil.which("tsc")
    if compiler is None:
        raise SystemExit("no tsc on PATH: install TypeScript, such as Debian's node-typescript")
    with TemporaryDirectory() as folder:
        command = [compiler, "--project", str(SOURCE), "--outDir", folder]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        if run.returncode != 0:
            raise SystemExit(f"{run.stdout}{run.stderr}the sources in {SOURCE} have errors")
        return scripts_in(Path(folder))


def scripts_in(folder: Path) -> dict[str, str]:
    """Read all files that a build has written.

    Parameters
    ----------
    folder : Path
        Folder that holds `FOLDERS`.

    Returns
    -------
    dict of str to str
        Texts by name relative to the folder.
    """
    return {
        path.relative_to(folder).as_posix(): path.read_text("utf-8")
        for name in FOLDERS
        for path in (folder / name).rglob("*")
        if path.is_file()
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
