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

    Each claim of the paper is compared with the result of the model. Claims that the model was
    fitted to, checks of the model, and records of its own results are counted apart.

    Example: tactile paper results
    """
    from tactile.study.paper import KINDS, summarize
    from tactile.study.report import write_paper

    console = plain_console(stderr=True)
    console.quiet = as_json
    with console.status("") as status:
        claims = write_paper(folder, progress=lambda name: status.update(name))
    facts = {
        "claims": [asdict(c) | {"difference": c.difference, "is_met": c.is_met} for c in claims],
        "kinds": {name: asdict(kind) for name, kind in KINDS.items()},
        "summary": summarize(claims),
        "files": sorted(str(path) for path in folder.iterdir() if path.is_file()),
    }
    emit(facts, as_json, lambda _: _print(claims, folder))


def _print(claims: "list[Claim]", folder: Path) -> None:
    """Print the claims of each kind beside the results."""
    from tactile.study.paper import KINDS, summarize

    columns = ["claim", *right("stated", "result", "difference"), "unit", "met"]
    for name, kind in KINDS.items():
        rows = (
            (
                claim.statement,
                f"{claim.stated:.4g}", f"{claim.result:.4g}", f"{claim.difference:+.2g}",
                claim.unit, "yes" if claim.is_met else "no",
            )
            for claim in claims
            if claim.kind == name
        )  # fmt: skip
        print_table(columns, rows, f"{kind.title}: {kind.meaning}")
    print(summarize(claims))
    print(f"written: {folder / 'report.html'}")
