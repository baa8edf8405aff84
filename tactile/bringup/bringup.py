"""The first time a display is driven: who is there, is every line connected, what does it move.

Never more than 5 V, at the drive and at the electrodes; one channel at a time, all others at 0 V.
The bus itself is opened for that limit, so that host, bus and amplifier hold it each on their own.
However it ends, the device is left at 0 V and disarmed.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tactile.bringup.probe import (
    FREQUENCY,
    INTERVAL,
    LEAST_READINGS,
    TONE,
    TONES,
    Verdict,
    cautious,
    judge,
    load_of,
    sound,
    tone,
    train,
)
from tactile.bus.base import Bus
from tactile.bus.link.inspection import AmplifierFacts, amplifiers, identify, measuring, readings
from tactile.devices import open_bus
from tactile.display.display import Display, load_display
from tactile.display.edit import Map, checked_target, write_map
from tactile.errors import BusError, InputError
from tactile.playback.estop_guard import guarded

MOST_DISTURBED = 40
"""Tones during which the link had a fault, after which a line is given up."""
BLINK = 5
"""s."""

Ask = Callable[[str], str]
Progress = Callable[[int, int], None]
UNTOUCHABLE = ("open", "short", "no voltage")
"""Lines that are not driven again."""


@dataclass
class Channel:
    """One drive line and what was found of it; keys carry their units.

    ``contactor`` is the file's; ``moved`` the one that a person saw move, and ``along`` whether it
    went along its direction. None is what was not measured, or not asked.
    """

    channel: int
    contactor: int
    verdict: Verdict = "not measured"
    capacitance_nf: float | None = None
    error_percent: float | None = None
    loss: float | None = None
    voltage_v: float | None = None
    current_ua: float | None = None
    asked: bool = False
    moved: int | None = None
    along: bool | None = None


@dataclass
class Report:
    """What came of it; keys carry their units."""

    display: str
    device: str
    voltage_v: float
    capacitance_nf: float
    frequency_hz: float = FREQUENCY
    amplifiers: tuple[AmplifierFacts, ...] = ()
    channels: list[Channel] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    written: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self) | {"amplifiers": [one.as_dict() for one in self.amplifiers]}


def bring_up(
    url: str,
    source: str | Path,
    *,
    write: Path | None = None,
    force: bool = False,
    ask: Ask | None = None,
    progress: Progress | None = None,
    accept_unsafe_hold: bool = False,
) -> Report:
    """Check a device and the display on it.

    Parameters
    ----------
    url : of the device
    source : a display's name or file
    write : file that the told map is written to; needs ``ask``
    force : overwrite it
    ask : shows a question, returns the answer; None where nobody can be asked
    progress : told how many channels are done, of how many
    accept_unsafe_hold : as of `open_bus`

    Raises
    ------
    TactileError
        For a device or file that cannot be used.
    """
    if write is not None:
        if ask is None:
            raise InputError("--out: needs a person at a terminal, who sees what moves")
        checked_target(source, write, force=force)
    display = cautious(load_display(source))
    drive = display.limits.voltage
    report = Report(display.name, url, drive, display.capacitance * 1e9)
    order = np.argsort(display.channel)
    report.channels = [Channel(int(display.channel[i]), int(i)) for i in order]
    with (
        open_bus(url, display, accept_unsafe_hold=accept_unsafe_hold) as bus,
        guarded(bus, url),
    ):
        _greet(report, bus, ask)
        _measure_all(report, bus, display, progress or (lambda done, total: None))
        if ask is not None and bus.state == "idle":
            _ask_all(report, bus, display, ask)
        report.amplifiers = amplifiers(bus)
        faults = bus.counters.faults()
    if faults:
        report.notes.append("link: " + ", ".join(f"{n} {name}" for name, n in faults.items()))
    _conclude(report, display, source, write, force=force)
    return report


def _greet(report: Report, bus: Bus, ask: Ask | None) -> None:
    """Learn who is there, and let each show itself."""
    report.amplifiers = found = amplifiers(bus)
    if not found:
        report.notes.append("the device does not tell what it is: it has no CAPS, and no blink")
    for k, one in enumerate(found):
        blinks = identify(bus, one.node, BLINK)
        if not blinks:
            report.notes.append(f"node {one.node} did not answer IDENTIFY")
        elif ask is not None and len(found) > 1:
            ask(f"board {k + 1} of {len(found)}, node {one.node}, shows itself; enter to go on: ")


# Measuring


def _measure_all(report: Report, bus: Bus, display: Display, progress: Progress) -> None:
    """Play a tone on each channel in turn, and judge what is measured meanwhile."""
    total = len(report.channels)
    with measuring(bus, INTERVAL) as nodes:
        _tell_what_is_not_measured(report, nodes)
        for done, one in enumerate(report.channels):
            progress(done, total)
            try:
                why = _measure_one(one, bus, display)
                if why and any(a.node in nodes and a.has(one.channel) for a in report.amplifiers):
                    report.faults.append(f"channel {one.channel} was not measured: {why}")
            except BusError:
                if bus.state != "estopped":
                    raise
            if bus.state == "estopped":
                one.verdict = "stopped"
                report.faults.append(
                    f"stopped at channel {one.channel}: {bus.status.detail}; "
                    "the channels after it were not driven"
                )
                return
            if bus.status.link == "down":
                raise BusError(f"the link is down: {bus.status.detail}")
        progress(total, total)


def _tell_what_is_not_measured(report: Report, nodes: set[int]) -> None:
    why = "open, short and wrong lines are not noticed"
    silent = [one for one in report.amplifiers if one.node not in nodes]
    if not report.amplifiers:
        report.notes.append(f"no capacitance was measured: the device does not measure; {why}")
    for one in silent:
        how = "did not begin to measure" if one.measures else "does not measure (CAPS features)"
        report.notes.append(f"node {one.node} {how}: of its channels {why}")


def _measure_one(one: Channel, bus: Bus, display: Display) -> str:
    """Return why nothing is known of a line; empty where it is judged."""
    signal, rate = tone(display), bus.wiring.sample_rate
    fade = display.limits.fade
    begin, end = fade * rate, (fade + TONE) * rate
    rows: list[tuple[int, float, float]] = []
    undisturbed = disturbed = 0
    while undisturbed < TONES:
        if disturbed == MOST_DISTURBED or bus.status.link == "down":
            return f"the link had faults in {disturbed} of {disturbed + undisturbed} tones"
        before = bus.counters.faults()
        readings(bus)
        sound(bus, signal, one.channel)
        if bus.counters.faults() == before:
            rows += _readings_of(one.channel, bus, begin, end)
            undisturbed += 1
        else:
            disturbed += 1
    if len(rows) < LEAST_READINGS:
        return f"{len(rows)} readings came, of {TONES * TONE / INTERVAL:.0f}"
    load = load_of(*np.array(rows, np.float64).T, sample_rate=rate)
    drive = float(signal.envelope(np.array([signal.duration / 2]))[0])
    gain = display.amplifier.gain
    one.verdict = judge(load, drive=drive, capacitance=display.capacitance * gain)
    one.voltage_v, one.current_ua = load.voltage, load.current * 1e6
    if math.isfinite(load.error):
        one.capacitance_nf = load.capacitance / gain * 1e9
        one.error_percent = load.error * 100
        one.loss = load.loss if math.isfinite(load.loss) else None
    return ""


def _readings_of(
    channel: int, bus: Bus, begin: float, end: float
) -> list[tuple[int, float, float]]:
    """Return position, volts and current [A] of a channel's readings between two positions."""
    return [
        (r.position, r.volts[channel - r.first_channel], r.current[channel - r.first_channel])
        for r in readings(bus)
        if begin <= r.position < end and 0 <= channel - r.first_channel < len(r.volts)
    ]


# Asking


def _ask_all(report: Report, bus: Bus, display: Display, ask: Ask) -> None:
    """Let a person tell what each channel moves, and which way."""
    for one in report.channels:
        if one.verdict in UNTOUCHABLE:
            continue
        try:
            goes_on = _ask_one(one, bus, display, ask)
        except EOFError:
            goes_on = False
        if not goes_on:
            report.notes.append(f"from channel {one.channel} on nobody told what moves")
            return


def _ask_one(one: Channel, bus: Bus, display: Display, ask: Ask) -> bool:
    """Play pulses and ask; return whether to go on.

    The pulses have the file's polarity, so that by the file they shear along the direction.
    """
    count, signal = len(display.contactors), train(display, display.polarity[one.contactor])
    problem = ""
    while True:
        sound(bus, signal, one.channel)
        told = ask(
            f"{problem}channel {one.channel}: which contactor moved? "
            f"[{one.contactor}; r again, - none, q end] "
        ).strip()
        if told == "q":
            return False
        if told == "-":
            one.asked = True
            return True
        if told in ("", *map(str, range(count))):
            break
        problem = "" if told == "r" else f"{told!r}: a number below {count}, r, - or q\n"
    one.moved = int(told) if told else one.contactor
    degrees = math.degrees(display.shear_direction[one.moved])
    one.along = _yes(ask, f"did it shear toward {degrees:g}° and back? [Y/n] ")
    one.asked = True
    return True


def _yes(ask: Ask, question: str) -> bool:
    while (told := ask(question).strip().lower()) not in ("", "y", "yes", "n", "no"):
        pass
    return told in ("", "y", "yes")


def told_map(channels: Sequence[Channel], display: Display) -> tuple[Map, list[str]]:
    """Return the map that a person told, and what is wrong with it.

    A channel that moves nothing, or was not asked for, keeps its contactor if no other moves it.
    """
    channel, polarity = display.channel.tolist(), display.polarity.tolist()
    by: dict[int, Channel] = {}
    wrong = []
    for one in channels:
        if one.moved is None:
            continue
        if one.moved in by:
            other = by[one.moved].channel
            wrong.append(f"contactor {one.moved}: channels {other} and {one.channel} both move it")
        by[one.moved] = one
        channel[one.moved] = one.channel
        sent = display.polarity[one.contactor]
        polarity[one.moved] = sent if one.along else -sent
    for one in channels:
        if one.moved is None and one.contactor in by and not wrong:
            wrong.append(f"channel {one.channel}: what it moves is not known")
    return Map(tuple(channel), tuple(int(p) for p in polarity)), wrong


def _conclude(
    report: Report, display: Display, source: str | Path, write: Path | None, *, force: bool
) -> None:
    """Name the faults, and write the map where that is asked for."""
    report.faults += [
        f"channel {one.channel}, contactor {one.contactor}: {_explained(one, report)}"
        for one in report.channels
        if one.verdict not in ("good", "not measured", "stopped")
    ]
    report.faults += [
        f"channel {one.channel} moved nothing" for one in report.channels
        if one.asked and one.moved is None
    ]  # fmt: skip
    told, wrong = told_map(report.channels, display)
    report.faults += wrong
    untold = [one for one in report.channels if not one.asked and one.verdict not in UNTOUCHABLE]
    changed = told != Map.of(display)
    if write is not None and (wrong or untold):
        report.faults.append(f"{write} was not written: nobody told the whole map")
    elif write is not None:
        write_map(source, write, told, force=force)
        report.written = str(write)
    elif changed:
        report.faults.append("the display file has another map than the display; see --out")


def _explained(one: Channel, report: Report) -> str:
    found = (
        "" if one.capacitance_nf is None
        else f"{one.capacitance_nf:.2f} nF where the display has {report.capacitance_nf:.2f} nF, "
    )  # fmt: skip
    return f"{one.verdict}: {found}{one.voltage_v:.2f} V at {one.current_ua:.0f} µA"
