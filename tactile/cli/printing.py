"""What the longer commands print, from plain figures."""

from typing import Any

from rich.console import Console
from rich.table import Table

CHECKED = (
    "channel", "contactor", "capacitance_nf", "error_percent", "loss", "voltage_v", "verdict",
    "moved", "along",
)  # fmt: skip


def print_budget(
    rows: list[Any], title: str, *, first: bool = False, console: Console | None = None
) -> None:
    """Print what fits; the ``first`` that does is what will be sent."""
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    table.add_column("sent as")
    for heading in ("Hz", "of the wire", "channels that fit"):
        table.add_column(heading, justify="right")
    table.add_column("")
    for row in rows:
        verdict = "too much" if row.why_not.startswith("takes ") else row.why_not
        if row.fits:
            verdict, first = "chosen" if first else "fits", False
        use = f"{row.use:.0%}"
        table.add_row(row.what, f"{row.sample_rate:g}", use, str(row.most), verdict)
    (console or Console()).print(table)


def print_check(r: dict[str, Any], *, console: Console | None = None) -> None:
    """Print what a check found."""
    out = console or Console()
    for one in r["amplifiers"]:
        out.print(_amplifier(one), highlight=False)
    title = f"{r['display']} at {r['device']}, tried with {r['voltage_v']:g} V at most"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    shown = [name for name in CHECKED if any(one[name] is not None for one in r["channels"])]
    for name in shown:
        heading, _, unit = name.partition("_")
        unit = {"nf": "nF", "v": "V", "percent": "±%"}.get(unit, unit)
        table.add_column(f"{heading} {unit}".strip(), justify="right")
    for one in r["channels"]:
        table.add_row(*(_cell(one[name]) for name in shown))
    out.print(table)
    for kind in ("note", "fault"):
        for line in r[f"{kind}s"]:
            out.print(f"{kind}: {line}", highlight=False, markup=False)
    if r["written"]:
        out.print(f"written: {r['written']}", highlight=False, markup=False)
    if not r["faults"]:
        whole = all(one["verdict"] == "good" for one in r["channels"])
        out.print("all lines are good" if whole else "no fault found in what was looked at")


def print_figures(figures: list[dict[str, Any]]) -> None:
    """Print measured figures beside their goals.

    Parameters
    ----------
    figures : name, value, unit, goal and reached of each, as `Figure.as_dict` returns them
    """
    table = Table(box=None, pad_edge=False)
    for heading in ("figure", "measured", "goal", ""):
        table.add_column(heading, justify="right" if heading == "measured" else "left")
    for f in figures:
        mark = {None: "", True: "reached", False: "NOT REACHED"}[f["reached"]]
        table.add_row(f["name"], f"{f['value']:.4g} {f['unit']}", f["goal"], mark)
    Console().print(table)


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)


def _amplifier(a: dict[str, Any]) -> str:
    low, high = a["rates_hz"]
    first = a["first_channel"]
    return (
        f"node {a['node']}: {a['name']!r}, firmware {a['firmware']:#010x}, channels {first} … "
        f"{first + a['channels'] - 1}, {a['voltage_limit_v']:g} V, "
        f"{a['slew_limit_v_per_us']:g} V/µs, {low} … {high} Hz, {', '.join(a['formats'])}, "
        f"{'measures' if a['measures'] else 'does not measure'}, "
        f"clock {a['drift_ppm']:+.1f} ppm"
    )
