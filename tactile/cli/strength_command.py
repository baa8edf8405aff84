"""The command ``tactile strength``."""

import math
from dataclasses import asdict
from typing import Annotated, Any

import typer

import tactile
from tactile.cli.options import (
    AngleOption,
    AsJson,
    ForceOption,
    SpeedOption,
    TextureArgument,
    emit,
    within,
)
from tactile.cli.printing import print_facts, print_table, right

SMALLEST_DB = -40.0
"""Level in dB SL above which a band is printed."""


def run(
    texture: TextureArgument,
    display: Annotated[
        list[str] | None,
        typer.Option(
            help="Name or TOML file of a display; reference-24 by default. If given several times, "
            "the gains at which the texture feels equally strong are also reported."
        ),
    ] = None,
    speed_mm_s: SpeedOption = None,
    normal_force_n: ForceOption = None,
    angle_deg: AngleOption = None,
    gain: Annotated[
        float | None, typer.Option(help="Factor that multiplies the texture; 1 by default.")
    ] = None,
    spend: Annotated[
        bool,
        typer.Option(
            "--spend",
            help="If the drive voltage is not sufficient, reduce the bands that are felt least "
            "first.",
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Report how strongly a texture is felt on a display.

    Levels are given for each frequency band and each kind of mechanoreceptor, in dB above the
    detection threshold (dB SL).

    Example: tactile strength wood-oak --display reference-24 --speed-mm-s 80
    """
    stroke = tactile.SteadyStroke(
        speed=within("--speed-mm-s", speed_mm_s, 1.0, 2000.0, 80.0) * 1e-3,
        normal_force=within("--normal-force-n", normal_force_n, 0.1, 20.0, 0.5),
        angle=math.radians(within("--angle-deg", angle_deg, -360.0, 360.0, 0.0)),
    )
    factor = within("--gain", gain, 0.0, 1e3, 1.0)
    loaded = [tactile.load_display(d) for d in display or ["reference-24"]]
    facts = []
    for one in loaded:
        played = tactile.load_texture(texture)
        if spend:
            played = tactile.spend(one, played, stroke, gain=factor)
        facts.append(_facts(one, played, stroke, factor))
    equal = _equal(loaded, tactile.load_texture(texture), stroke) if len(loaded) > 1 else None
    emit({"displays": facts, "equal": equal}, as_json, _print)


def _facts(
    display: "tactile.Display", texture: "tactile.Texture", stroke: "tactile.SteadyStroke",
    gain: float,
) -> dict[str, Any]:  # fmt: skip
    """Return the levels and the drive of one display; the level of no motion is None."""
    from tactile.strength.strength import conditions
    from tactile.texture.bands import nominal_centers

    s = tactile.texture_strength(display, texture, stroke, gain=gain)
    best = s.automatic
    rows = zip(
        nominal_centers(s.frequency), s.commanded * 1e6, s.attained * 1e6, s.attainable * 1e6,
        s.threshold * 1e6, s.level, s.lost_db, strict=True,
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
        "conditions": conditions(display, stroke, gain),
        "commanded": asdict(s.figures),
        "played": asdict(s.played_figures),
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
    """Return a number, or None if it is not finite."""
    return float(value) if math.isfinite(value) else None


def _equal(
    displays: "list[tactile.Display]", texture: "tactile.Texture", stroke: "tactile.SteadyStroke"
) -> dict[str, Any]:
    """Return the gains at which a texture is equally strong on several displays."""
    equal = tactile.equal_gain(displays, texture, stroke)
    return {
        "displays": [display.name for display in displays],
        "gains": [gain.value for gain in equal.gains],
        "level_db_sl": equal.level,
        "weakest": equal.weakest,
    }


def _print(facts: dict[str, Any]) -> None:
    """Print the levels on each display, and the gains that make them equal."""
    for one in facts["displays"]:
        _print_display(one)
    if (equal := facts["equal"]) is not None:
        gains = (f"gain {gain:.3g}" for gain in equal["gains"])
        rows = dict(zip(equal["displays"], gains, strict=True))
        level = f"{equal['level_db_sl']:.1f} dB SL"
        print_facts(rows, f"Equally strong at {level}, limited by {equal['weakest']}")


def _print_display(facts: dict[str, Any]) -> None:
    """Print the bands, the levels of the receptors and the drive of one display."""
    from tactile.strength.figures import ShearFigures, figure_rows

    title = f"{facts['texture']} on {facts['conditions']}"
    columns = right(
        "Hz", "commanded µm", "played µm", "attainable µm pk", "threshold µm pk", "dB SL"
    )
    cells = []
    for band in facts["bands"]:
        *sizes, level, _ = band.values()
        if level is not None and level > SMALLEST_DB:
            cells.append((*(f"{size:.3g}" for size in sizes), f"{level:+.1f}"))
    print_table(columns, cells, title)
    figures = figure_rows(ShearFigures(**facts["commanded"]), ShearFigures(**facts["played"]))
    print_facts(figures, "Figures of the shear")
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
        rows["gain with headroom"] = (
            f"{facts['automatic_gain']:.3g} for {facts['automatic_level_db_sl']:+.1f} dB SL, below "
            f"the {facts['limit']} limit anywhere on the surface for half a minute"
        )
    print_facts(rows, "All bands together, above the detection threshold, ± 5 dB between people")


def _level(level: float | None) -> str:
    """Return a level as text."""
    return "no motion" if level is None else f"{level:+.1f} dB SL"
