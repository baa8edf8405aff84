"""The command ``tactile play``."""

import math
import sys
from contextlib import nullcontext, suppress
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

import tactile
from tactile.cli.options import (
    AcceptHold,
    AngleOption,
    AsJson,
    DisplayOption,
    ForceOption,
    SpeedOption,
    TextureOrEffect,
    emit,
    read_calibration,
    within,
)
from tactile.cli.printing import print_facts
from tactile.errors import InputError

if TYPE_CHECKING:
    from tactile.files import SourceFile
    from tactile.playback.outcome import Outcome
    from tactile.playback.runs import Summary
    from tactile.sensing.baseline_file import Calibration
    from tactile.texture.formats.effect_shear import NamedEffect

STROKE = {
    "--speed-mm-s": (0.0, 2000.0, 80.0),
    "--seconds": (0.1, 86400.0, 5.0),
    "--angle-deg": (-360.0, 360.0, 0.0),
    "--normal-force-n": (0.0, 20.0, 0.5),
}
"""Least value, greatest value and default of each option that describes a straight stroke."""
LARGEST_GAIN = 1e3
ALLOWED_LOSS = "0.1%"
"""Largest share that may be lost unless the user names another: 5 ms of 5 s (assumed)."""


class PlayedFinger(StrEnum):
    """Finger for which the equalizer's filters are made."""

    FIXED = "fixed"
    FOLLOW = "follow"


def run(
    texture: TextureOrEffect,
    speed_mm_s: SpeedOption = None,
    seconds: Annotated[
        float | None, typer.Option(help="Duration of the stroke in s; 5 by default.")
    ] = None,
    angle_deg: AngleOption = None,
    normal_force_n: ForceOption = None,
    path: Annotated[
        Path | None,
        typer.Option(
            help="Follow the path of a CSV file with the columns time_s, x_mm, y_mm and "
            "normal_force_n instead of a straight stroke."
        ),
    ] = None,
    display: DisplayOption = "reference-24",
    device: Annotated[
        str,
        typer.Option(
            help="URL of the device to play on: sim: simulates the display, mock: an amplifier; "
            "tactile devices lists the URLs of connected devices."
        ),
    ] = "sim:",
    gain: Annotated[
        str | None,
        typer.Option(
            help="Factor that multiplies the texture, or auto for the largest one at which the "
            "stroke stays within the limits of the display with the finger of its file; by default "
            "auto, and 1 for an effect, a finger at rest or with --finger follow."
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(
            help="Write the drive voltages, the shear and all that they were rendered from to this "
            "HDF5 (.h5) or NumPy file (.npz); tactile replay renders it again."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random surface.")] = 0,
    sample_rate_hz: Annotated[
        float | None,
        typer.Option(help="Sample rate of the drive in Hz; by default the device chooses it."),
    ] = None,
    accept_unsafe_hold: AcceptHold = False,
    as_json: AsJson = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", help="Print neither the live picture nor the report.")
    ] = False,
    finger: Annotated[
        PlayedFinger,
        typer.Option(
            help="Finger that the equalizer expects: the fixed one of the display file, or the one "
            "that the currents of the device tell of (follow), which needs tactile calibrate."
        ),
    ] = PlayedFinger.FIXED,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="File of tactile calibrate, with --finger follow; by default the name of the "
            "display with .sensing.npz."
        ),
    ] = None,
    allow_loss: Annotated[
        str,
        typer.Option(
            metavar="PERCENT",
            help="Largest share of the stroke that may be lost without exit code 1, such as 1%.",
        ),
    ] = ALLOWED_LOSS,
) -> None:
    """Play a texture under a moving finger, or an effect.

    An effect is a file that `tactile convert` wrote, or one of the formats that it reads (.ahap,
    .haptic, .hjif, .wav). It plays on all contactors for its own duration.

    In a terminal it plays in real time and shows a live picture; otherwise it plays as fast as the
    device allows. The exit code is 0 if the stroke was put out, 1 if more than 0.1 % of it was not,
    the link was down at its end or it was ended by an e-stop or a fault, 2 if it could not begin,
    and 130 after Ctrl-C, which ramps to 0 V.

    Example: tactile play wood-oak --speed-mm-s 80 --seconds 5 --record oak.h5
    """
    from tactile.display.display import load_with_source as load_display
    from tactile.playback import runs
    from tactile.playback.origin import Sources

    stroke = {
        "--speed-mm-s": speed_mm_s,
        "--seconds": seconds,
        "--angle-deg": angle_deg,
        "--normal-force-n": normal_force_n,
    }
    effect = _effect(texture, stroke, path)
    within("--sample-rate-hz", sample_rate_hz, 2500, 200000, 8000)
    allowed, factor = _percent(allow_loss), _gain(gain)
    loaded, display_source = load_display(display)
    what = _effect_request(loaded, effect, stroke) or _texture_request(texture, path, stroke)
    watched = sys.stdout.isatty() and not (quiet or as_json)
    live, watch = (
        _live(loaded, texture, sample_rate_hz or 8000.0) if watched else (nullcontext(), None)
    )
    with live:
        summary = runs.run(
            loaded, what.played, what.trajectory,
            device=device, gain=factor, sample_rate=sample_rate_hz, seed=seed, record=record,
            sources=Sources(display_source, what.source), watch=watch, realtime=watched,
            accept_unsafe_hold=accept_unsafe_hold,
            calibration=_calibration(finger, calibration, loaded),
        )  # fmt: skip
    if as_json or not quiet:
        title = _title(summary.outcome, what.description)
        rows = {"put out": _put_out(summary)} | what.rows
        emit(summary.as_dict(), as_json, lambda facts: print_facts(rows | _report(facts), title))
    raise typer.Exit(_exit_code(summary, allowed))


def _calibration(
    finger: PlayedFinger, file: Path | None, display: "tactile.Display"
) -> "Calibration | None":
    """Return the calibration for a stroke that follows the finger; None for a fixed one."""
    if finger is PlayedFinger.FIXED:
        if file is not None:
            raise InputError("--calibration: is used with --finger follow only")
        return None
    return read_calibration(file, display.name)


class _Request(NamedTuple):
    """What is to be played, along which path, and how the report describes it."""

    played: "tactile.Texture | NamedEffect"
    trajectory: "tactile.Trajectory"
    description: str
    rows: dict[str, str]
    source: "SourceFile | None"


def _effect_request(
    display: "tactile.Display", effect: "NamedEffect | None", stroke: dict[str, float | None]
) -> _Request | None:
    """Return the request for an effect, which plays on a finger at rest; None for a texture."""
    from tactile.playback import runs

    if effect is None:
        return None
    name = "--normal-force-n"
    trajectory = runs.at_rest(
        display, effect, normal_force=within(name, stroke[name], *STROKE[name])
    )
    rows = {"effect": "; ".join(effect.notes)} if effect.notes else {}
    return _Request(effect, trajectory, effect.description, rows, None)


def _texture_request(name: str, path: Path | None, stroke: dict[str, float | None]) -> _Request:
    """Return the request for a stroke over a texture."""
    from tactile.texture.surface import load_with_source

    trajectory = _trajectory(path, stroke)
    texture, source = load_with_source(name)
    description = texture.descriptor.texture.description
    rows = {"stroke": _stroke_of(stroke, path)}
    return _Request(texture, trajectory, description, rows, source)


def _effect(
    source: str, stroke: dict[str, float | None], path: Path | None
) -> "NamedEffect | None":
    """Return the effect that the source is, or None if it is a texture."""
    from tactile.texture.formats.conversion import is_effect, load_named

    if not is_effect(source):
        return None
    given = stroke | {"--path": path, "--normal-force-n": None}
    for name, value in given.items():
        if value is not None:
            raise InputError(
                f"{name} cannot be used with {source}, which is an effect and needs no stroke"
            )
    return load_named(source)


def _percent(text: str) -> Fraction:
    """Return the share of the option ``--allow-loss`` [%]."""
    with suppress(ValueError):
        share = Fraction(text.removesuffix("%"))
        if text.endswith("%") and 0 <= share <= 100:
            return share
    raise InputError(f"--allow-loss {text}: must be a share between 0% and 100%, such as 1%")


def _title(outcome: "Outcome", description: str) -> str:
    """Return the title of the report, which does not claim more than was put out."""
    share = f"{outcome.percent} of " if outcome.lost_samples else ""
    return f"Played {share}{description}"


def _put_out(summary: "Summary") -> str:
    """Return the share of a stroke that was put out, and the length of the stroke."""
    outcome = summary.outcome
    return f"{outcome.percent} of {outcome.planned_samples / summary.sample_rate_hz:.2f} s"


def _exit_code(summary: "Summary", allowed: Fraction) -> int:
    """Return the exit code of a stroke; print why on standard error unless it is 0."""
    outcome = summary.outcome
    if outcome.is_within(allowed):
        return 0
    print(f"tactile: put out {_put_out(summary)}: {outcome.cause}", file=sys.stderr)
    return 130 if outcome.ending == "interrupted" else 1


def _stroke_of(stroke: dict[str, float | None], path: Path | None) -> str:
    """Return the path of the finger as text."""
    if path is not None:
        return f"as in {path}"
    speed, _, angle, force = (within(name, stroke[name], *STROKE[name]) for name in STROKE)
    return f"{speed:g} mm/s, {force:g} N" + (f", {angle:g}°" if angle else "")


def _trajectory(path: Path | None, stroke: dict[str, float | None]) -> "tactile.Trajectory":
    """Return the path of a file, or the straight stroke that the options describe."""
    if path is not None:
        others = [name for name, value in stroke.items() if value is not None]
        if others:
            raise InputError(
                f"{others[0]} cannot be used with --path, which gives the whole stroke"
            )
        return tactile.Trajectory.from_csv(path)
    speed, seconds, angle, force = (
        within(name, stroke[name], *bounds) for name, bounds in STROKE.items()
    )
    return tactile.Trajectory.line(
        speed=speed * 1e-3, duration=seconds, angle=math.radians(angle), normal_force=force
    )


def _gain(text: str | None) -> float | Literal["auto"] | None:
    """Return the gain of the option ``--gain``, None without it."""
    if text is None:
        return None
    if text == "auto":
        return "auto"
    try:
        return within("--gain", float(text), 0.0, LARGEST_GAIN, 1.0)
    except ValueError:
        raise InputError(
            f"--gain {text}: must be auto or a number between 0 and {LARGEST_GAIN:g}"
        ) from None


def _live(display: "tactile.Display", texture: str, sample_rate: float) -> tuple[Any, Any]:
    """Return a live picture for the terminal, and the function that updates it with a block."""
    from rich.live import Live

    from tactile.playback.trajectory_playback import PlayedBlock
    from tactile.show.live import LivePicture

    picture = LivePicture(display, texture=texture, sample_rate=sample_rate)

    def watch(block: PlayedBlock, renderer: "tactile.Renderer") -> None:
        picture.update(
            float(block.time[-1]), block.position[-1], block.speed, float(block.normal_force[-1]),
            block.shear, block.drive, renderer.limiter.limited_samples,
        )  # fmt: skip
        if block.finger is not None:
            finger = block.finger
            picture.follow(finger.touching, finger.deviation, finger.guarded)

    return Live(picture, refresh_per_second=15, transient=True), watch


def _report(s: dict[str, Any]) -> dict[str, str]:
    """Return the lines of the report by name, from a summary."""
    rows = {
        "on": f"{s['display']} at {s['device']}, {s['sample_rate_hz']:g} Hz",
        "length": f"{s['seconds']:.3f} s, {s['samples']} samples",
    }
    rows["gain"] = f"{s['gain']:.3g}" + (
        f", the largest of this stroke within the {s['gain_limit']} limit"
        if s["gain_limit"]
        else ""
    )
    if s["frames"]:
        rows["frames"] = (
            f"{s['frames']} spectrum frames, {s['limited_samples']} of them limited; the events of "
            "the texture are not played"
        )
    else:
        rows |= _samples(s)
    if s["faults"] or s["invalid_samples"]:
        counted = s["faults"] | {"invalid_samples": s["invalid_samples"]}
        rows["faults"] = ", ".join(f"{n} {name}" for name, n in counted.items() if n)
    cause = s["outcome"]["cause"]
    if cause:
        rows["lost by"] = cause
    if s["status"] not in ("", cause):
        rows["link"] = s["status"]
    if s["recording"]:
        rows["recorded"] = s["recording"]
    return rows


def _shear(commanded: dict[str, Any] | None, played: dict[str, Any] | None) -> dict[str, str]:
    """Return the lines about the shear, from its figures."""
    from tactile.strength.figures import ONSET, SHORTEST, ShearFigures, figure_rows

    if commanded is None:
        return {
            "vibration": f"not measured: without its first {ONSET * 1e3:g} mm and the ramps, less "
            f"than {SHORTEST:g} s of the stroke is left"
        }
    return figure_rows(
        ShearFigures(**commanded), None if played is None else ShearFigures(**played)
    )


def _equalizer(s: dict[str, Any]) -> dict[str, str]:
    """Return the lines about the equalizer."""
    f = s["following"]
    if f is None:
        error = f"within {s['equalizer_error_db']:.2f} dB of the inverse response, 10–1000 Hz"
        return {"equalizer": error}
    if f["deviation_db"] is None:
        return {"equalizer": "for air: no finger was felt"}
    rows = {
        "equalizer": f"follows the finger, to ± {f['deviation_db']:.2f} dB by its own estimate",
        "finger": f"on {100 * f['touched_share']:.0f}% of the contactors in {f['windows']} windows",
    }
    changes = {
        "lifted": f["lifted"],
        "touched again": f["touched"],
        "turned down by a guard": f["guarded"],
    }
    if any(changes.values()):
        rows["finger"] += ", " + ", ".join(f"{n} times {what}" for what, n in changes.items() if n)
    if f["unexplained_share"] or f["dropped_windows"]:
        rows["windows"] = (
            f"{f['dropped_windows']} not usable; {100 * f['unexplained_share']:.1f}% of the "
            "currents are those of no finger"
        )
    return rows


def _samples(s: dict[str, Any]) -> dict[str, str]:
    """Return the lines about a device that takes samples."""
    rows = _shear(s["commanded"], s["played"]) | {
        "attainable": f"{s['attainable_um']:.1f} µm peak at every frequency up to 1 kHz",
        "drive": f"{s['peak_drive_v']:.1f} V peak of {s['voltage_limit_v']:.0f} V, "
        f"{s['limited_samples']} samples limited",
    }
    rows |= _equalizer(s)
    if s["signal_to_error_db"] is not None:
        rows["played"] = (
            f"{s['signal_to_error_db']:.1f} dB signal-to-error ratio of the displacement, "
            "20–1000 Hz"
        )
    if s["peak_current_ma"] is not None:
        rows["current"] = f"{s['peak_current_ma']:.2f} mA peak per contactor"
    return rows
