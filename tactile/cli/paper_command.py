"""The command ``tactile paper``."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tactile.cli.options import AsJson, emit
from tactile.cli.printing import plain_console, print_table, right

if TYPE_CHECKING:
    from tactile.study.paper import Claim


def run(
    folder: Annotated[Path, typer.Argument(help="Folder to write: figures, data and report.html.")],
    as_json: AsJson = False,
) -> None:
    """Reproduce the figures and claims of Hofmann & Twiefel 2014.

    Each claim of the paper is compared with the result of the model.

    Example: tactile paper results
    """
    from tactile.study.paper import KINDS
    from tactile.study.report import write_paper

    console = plain_console(stderr=True)
    console.quiet = as_json
    with console.status("") as status:
        claims = write_paper(folder, progress=lambda name: status.update(name))
    facts = {
        "claims": [asdict(c) | {"difference": c.difference, "is_met": c.is_met} for c in claims],
        "kinds": KINDS,
        "files": sorted(str(path) for path in folder.iterdir() if path.is_file()),
    }
    emit(facts, as_json, lambda _: _print(claims, folder))


def _print(claims: "list[Claim]", folder: Path) -> None:
    """Print the claims of each kind beside what was found."""
    from tactile.study.paper import KINDS

    columns = ["claim", *right("stated", "found", "difference"), "unit", "met"]
    for kind, meaning in KINDS.items():
        rows = (
            (
                claim.statement,
                f"{claim.stated:.4g}", f"{claim.found:.4g}", f"{claim.difference:+.2g}",
                claim.unit, "yes" if claim.is_met else "no",
            )
            for claim in claims
            if claim.kind == kind
        )  # fmt: skip
        print_table(columns, rows, f"{kind}: {meaning}")
    met = sum(claim.is_met for claim in claims)
    typer.echo(f"{met} of {len(claims)} claims met; written: {folder / 'report.html'}")
