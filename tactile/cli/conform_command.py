"""The command ``tactile conform``."""

import sys
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer

from tactile.cli.options import AsJson, emit
from tactile.cli.printing import print_table, progress_bar, unwrapped

INTERRUPTED = 130
"""Exit code after Ctrl-C, as of a shell (128 + SIGINT)."""


def run(
    url: Annotated[str, typer.Argument(help="URL of a device with one amplifier.")],
    report: Annotated[
        Path | None,
        typer.Option("--report", help="Write a report with all results to this HTML file."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Prove that an amplifier keeps to the protocol.

    It runs those behavior vectors of the protocol that can be told on a link. Which they are is
    decided by the reference amplifier, with the properties of this one. The vectors switch the high
    voltage on and play up to the voltage limit: nothing may touch the contactors. The output itself
    is not seen, and the report names what a person has to test. Ctrl-C stops and disarms the
    amplifier. The exit code is 1 if a vector failed, or not all were run.

    Example: tactile conform mock: --report conformance.html
    """
    import tactile.devices  # noqa: F401  registers the kinds of devices
    from tactile.bus.conform.conformance import Conformance

    if report is not None:
        from tactile.study.report import check_report

        check_report(report)
    with Conformance(url) as test, progress_bar(visible=not as_json) as bar:
        print(
            f"switches the high voltage on and plays up to {test.voltage:g} V: keep away from the "
            "contactors",
            file=sys.stderr,
        )
        task = bar.add_task("vectors", total=None)
        result = test.run(lambda done, total: bar.update(task, completed=done, total=total))
    facts = result.as_dict()
    if report is not None:
        _write(report, facts)
    emit(facts, as_json, _print)
    if report is not None and not as_json:
        print(f"written: {report}")
    raise typer.Exit(INTERRUPTED if result.interrupted else 0 if result.conforms else 1)


def _print(r: dict[str, Any]) -> None:
    """Print the results by section, the vectors that failed, and the verdict."""
    print_table(*_by_section(r), _title(r))
    failed = _failed(r)
    if failed:
        columns = [unwrapped("failed"), unwrapped("section"), "expected", "got"]
        print_table(columns, failed)
    if reasons := _reasons(r):
        print_table(["vectors", "do not apply or were not run, because"], reasons)
    print("not tested here, but by a person:")
    for line in r["by_a_person"]:
        print(f"  {line}")
    print(r["summary"])


def _title(r: dict[str, Any]) -> str:
    """Return what was tested, as one line."""
    return (
        f"{r['device']}, node {r['node']}: {r['name']!r}, firmware {r['firmware']:#010x}, "
        f"{r['channels']} channels, protocol {r['version']}"
    )


VERDICTS = ("passed", "failed", "not applicable", "not run")
"""Verdicts in the order of the columns."""


def _by_section(r: dict[str, Any]) -> tuple[list[str], list[tuple[str, ...]]]:
    """Return headings and rows of the numbers of verdicts by section of SPEC.md."""
    counts = Counter((one["section"], one["verdict"]) for one in r["results"])
    shown = [v for v in VERDICTS if v in r["counts"] or v in VERDICTS[:2]]
    sections = sorted({s for s, _ in counts}, key=lambda s: [int(part) for part in s.split(".")])
    rows = [(s, *(str(counts[s, verdict] or "–") for verdict in shown)) for s in sections]
    return ["section", *shown], rows


def _failed(r: dict[str, Any]) -> list[tuple[str, ...]]:
    """Return a row for each vector that failed."""
    return [
        (one["id"], one["section"], one["expected"], one["got"])
        for one in r["results"]
        if one["verdict"] == "failed"
    ]


def _reasons(r: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the number of vectors by the reason for which they were not run."""
    reasons = Counter(one["reason"] for one in r["results"] if one["reason"])
    return [(str(count), reason) for reason, count in reasons.most_common()]


def _write(path: Path, r: dict[str, Any]) -> None:
    """Write the report as a page."""
    from tactile.study.report import Section, Table, write_report

    headings, rows = _by_section(r)
    sections = [
        Section("Verdict", (r["summary"], Table((*headings,), (*rows,), "Vectors by section"))),
        Section(
            "Not tested here",
            (
                "The output of the amplifier was not seen. A person must test:",
                *(f"• {line}" for line in r["by_a_person"]),
            ),
        ),
    ]
    if failed := _failed(r):
        table = Table(("vector", "section", "expected", "got"), (*failed,))
        sections.insert(1, Section("Vectors that failed", (table,)))
    every = tuple(
        (one["id"], one["section"], _verdict(one), one["reason"] or one["why"])
        for one in r["results"]
    )
    table = Table(("vector", "section", "verdict", "about, or reason"), every)
    sections.append(Section("All vectors", (table,)))
    write_report(
        path, f"Conformance of {r['name'] or 'an amplifier'}", sections, subtitle=_title(r)
    )


def _verdict(one: dict[str, Any]) -> str:
    """Return the verdict on a vector in words."""
    seen = one["verdict"] != "passed" or not one["unseen"]
    return one["verdict"] if seen else "passed by its answers; its output was not seen"
