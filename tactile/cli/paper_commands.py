"""The command ``paper``: the paper that this project began with, reproduced."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from tactile.cli.app import AsJson, app

if TYPE_CHECKING:
    from tactile.study.paper import Claim


@app.command("paper")
def write_all(
    folder: Annotated[Path, typer.Argument(help="For pictures, data and report.html.")],
    as_json: AsJson = False,
) -> None:
    """Write every figure of Hofmann & Twiefel 2014, and its claims beside what we find.

    Example: tactile paper results
    """
    from tactile.study.paper import KINDS
    from tactile.study.report import write_paper

    console = Console(stderr=True, quiet=as_json)
    with console.status("") as status:
        found = write_paper(folder, progress=lambda name: status.update(name))
    if as_json:
        rows = [asdict(c) | {"difference": c.difference, "is_met": c.is_met} for c in found]
        files = sorted(str(path) for path in folder.iterdir() if path.is_file())
        typer.echo(json.dumps({"claims": rows, "kinds": KINDS, "files": files}))
        return
    for kind, meaning in KINDS.items():
        _print_claims([claim for claim in found if claim.kind == kind], f"{kind}: {meaning}")
    met = sum(claim.is_met for claim in found)
    typer.echo(f"{met} of {len(found)} claims met; written: {folder / 'report.html'}")


def _print_claims(claims: "list[Claim]", title: str) -> None:
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("claim")
    for heading in ("stated", "found", "differs"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("met")
    for claim in claims:
        numbers = (f"{claim.stated:.4g}", f"{claim.found:.4g}", f"{claim.difference:+.2g}")
        table.add_row(claim.statement, *numbers, claim.unit, "yes" if claim.is_met else "no")
    Console().print(table)
