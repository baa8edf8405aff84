"""Generator of the messages of clients in other languages from the JSON Schema of the API.

``python -m clients.generate`` writes the files. With ``--check`` it writes nothing: it names the
files that differ from what it would write, and exits with code 1 if there are any.
"""

import sys
from pathlib import Path

from clients.c_header import c_header_text
from clients.model import api_model
from clients.shapes import shapes_text
from clients.typescript import typescript_text

HERE = Path(__file__).parent
"""Folder of the clients."""
TEMPLATES = {
    "javascript/client/messages.ts": typescript_text,
    "javascript/client/shapes.ts": shapes_text,
    "c/tactile_client.h": c_header_text,
}
"""Function from the model to the text of each file."""


def outputs() -> dict[Path, str]:
    """Generate the text of each file.

    Returns
    -------
    dict of Path to str
        Texts by path.
    """
    model = api_model()
    return {HERE / name: template(model) for name, template in TEMPLATES.items()}


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
    texts = outputs()
    differing = [p for p, text in texts.items() if not p.exists() or p.read_text("utf-8") != text]
    for path in differing:
        if "--check" in arguments:
            print(f"{path.name} differs; run python -m clients.generate", file=sys.stderr)
        else:
            path.write_text(texts[path], "utf-8")
            print(f"wrote {path.name}")
    return int(bool(differing) and "--check" in arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
