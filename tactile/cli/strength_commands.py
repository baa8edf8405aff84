"""Commands about what is felt: ``strength``."""

import json
import math
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

import tactile
from tactile.cli.app import AsJson, app, print_table, within

SMALLEST_DB = -40.0
"""dB SL of a band from which on it is shown."""


@app.command("strength")
def tell_strength(
    texture: Annotated[str, typer.Argument(help="A texture's name, or a TOML file.")],
    display: Annotated[
        list[str] | None,
        typer.Option(help="reference-24, reference-64, or a TOML file; several are made equal."),
    ] = None,
    speed_mm_s: Annotated[
        float | None, typer.Option(help="Straight stroke, 80 by default.")
    ] = None,
    normal_force_n: Annotated[
        float | None, typer.Option(help="Of the finger, 0.5 by default.")
    ] = None,
    angle_deg: Annotated[
        float | None, typer.Option(help="Of the stroke, from the x axis; 0 by default.")
    ] = None,
    gain: Annotated[float | None, typer.Option(help="Of the texture, 1 by default.")] = None,
    spend: Annotated[
        bool,
        typer.Option("--spend", help="Where drive is short, lower first what is felt least."),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Tell what of a texture is felt on a display, by band and by kind of receptor.

    Example: tactile strength wood-oak --display reference-24 --speed-mm-s 80
    """
    stroke = tactile.SteadyStroke(
        speed=within("--speed-mm-s", speed_mm_s, 1.0, 2000.0, 80.0) * 1e-3,
        normal_force=within("--normal-force-n", normal_force_n, 0.1, 20.0, 0.5),
        angle=math.radians(within("--angle-deg", angle_deg, -360.0, 360.0, 0.0)),
    )
    factor = within("--gain", gain, 0.0, 1e3, 1.0)
    shown, felt = [tactile.load_display(d) for d in display or ["reference-24"]], texture
    facts = []
    for one in shown:
        played = tactile.load_texture(felt)
        if spend:
            played = tactile.spend(one, played, stroke, gain=factor)
        facts.append(_facts(one, played, stroke, factor))
    equal = _equal(shown, tactile.load_texture(felt), stroke) if len(shown) > 1 else None
    if as_json:
        typer.echo(json.dumps({"displays": facts, "equal": equal}))
        return
    for one_facts in facts:
        _print(one_facts)
    if equal is not None:
        rows = dict(zip(equal["displays"], map("gain {:.3g}".format, equal["gains"]), strict=True))
        print_table(
            rows, f"Equal at {equal['level_db_sl']:.1f} dB SL, limited by {equal['weakest']}"
        )


def _facts(
    display: "tactile.Display", texture: "tactile.Texture", stroke: "tactile.SteadyStroke",
    gain: float,
) -> dict[str, Any]:  # fmt: skip
    """Return the figures of one display; levels of nothing are null."""
    s = tactile.texture_strength(display, texture, stroke, gain=gain)
    best = s.automatic
    rows = zip(
        s.frequency, s.commanded * 1e6, s.attained * 1e6, s.attainable * 1e6, s.threshold * 1e6,
        s.level, s.lost_db, strict=True,
    )  # fmt: skip
    keys = (
        "frequency_hz", "commanded_um_rms", "attained_um_rms", "attainable_um_peak",
        "threshold_um_peak", "level_db_sl", "lost_db",
    )  # fmt: skip
    bands = [dict(zip(keys, map(_finite, row), strict=True)) for row in rows]
    return {
        "display": display.name,
        "texture": texture.name,
        "speed_mm_s": stroke.speed * 1e3,
        "normal_force_n": stroke.normal_force,
        "gain": gain,
        "bands": bands,
        "channels_db_sl": {name: _finite(level) for name, level in s.channels.items()},
        "felt_by": list(s.felt_by),
        "drive_rms_v": s.drive_rms,
        "drive_peak_v": s.drive_peak,
        "voltage_limit_v": display.limits.voltage,
        "limited_share": s.limited_share,
        "automatic_gain": None if best is None else best.value,
        "automatic_level_db_sl": None if best is None else best.level,
        "limit": None if best is None else best.limit,
    }


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _equal(
    displays: "list[tactile.Display]", texture: "tactile.Texture", stroke: "tactile.SteadyStroke"
) -> dict[str, Any]:
    found = tactile.equal_gain(displays, texture, stroke)
    return {
        "displays": [display.name for display in displays],
        "gains": [gain.value for gain in found.gains],
        "level_db_sl": found.level,
        "weakest": found.weakest,
    }


def _print(facts: dict[str, Any]) -> None:
    title = (
        f"{facts['texture']} on {facts['display']}, {facts['speed_mm_s']:g} mm/s, "
        f"{facts['normal_force_n']:g} N, gain {facts['gain']:g}"
    )
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    headings = ("Hz", "commanded µm", "played µm", "attainable µm pk", "threshold µm pk", "dB SL")
    for heading in headings:
        table.add_column(heading, justify="right")
    for band in facts["bands"]:
        *sizes, level, _ = band.values()
        if level is not None and level > SMALLEST_DB:
            table.add_row(*(f"{size:.3g}" for size in sizes), f"{level:+.1f}")
    Console().print(table)
    rows = {
        f"{name}, {tactile.TOUCH_CHANNELS[name].receptor}": _level(level)
        for name, level in facts["channels_db_sl"].items()
    }
    rows["felt by"] = ", ".join(facts["felt_by"]) or "nothing"
    rows["drive"] = (
        f"{facts['drive_rms_v']:.2f} V rms, {facts['drive_peak_v']:.1f} V peak of "
        f"{facts['voltage_limit_v']:g} V, {facts['limited_share']:.2%} of samples limited"
    )
    if facts["limit"] is not None:
        rows["automatic gain"] = (
            f"{facts['automatic_gain']:.3g} for {facts['automatic_level_db_sl']:+.1f} dB SL, "
            f"then the {facts['limit']} limits"
        )
    print_table(rows, "Levels above detection, ± 5 dB from person to person")


def _level(level: float | None) -> str:
    return "nothing" if level is None else f"{level:+.1f} dB SL"
