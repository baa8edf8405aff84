"""First drive of a display: identify the amplifiers, check every line, learn what it moves.

Drive and electrodes never exceed 5 V. One channel is driven at a time, all others stay at 0 V. The
bus itself is opened with that limit, so that host, bus and amplifier each enforce it on their own.
However the check ends, the device is left at 0 V and disarmed.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tactile.actuator.finger import FingerLoad
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
"""Number of tones disturbed by faults of the link after which the measurement of a line is given
up."""
BLINK = 5
"""Time for which an amplifier blinks to identify itself [s]."""

Ask = Callable[[str], str]
"""Function that shows a question to a person and returns the answer."""
Progress = Callable[[int, int], None]
"""Function that is called with the number of channels done and their total number."""
UNTOUCHABLE = ("open", "short", "no voltage")
"""Verdicts after which a line is not driven again."""


@dataclass
class CheckedChannel:
    """Findings about one drive line; names of attributes carry their units.

    None stands for what was not measured or not asked.

    Attributes
    ----------
    channel : int
        Index of the drive line.
    contactor : int
        Contactor that the display file assigns to the channel.
    verdict : Verdict
        Result of the measurement.
    capacitance_nf : float or None
        Measured capacitance of the line at the electrodes [nF].
    error_percent : float or None
        Standard error of the capacitance [%].
    loss : float or None
        Loss factor tan δ.
    voltage_v, current_ua : float or None
        Measured amplitudes of voltage [V] and current [µA].
    asked : bool
        Whether a person answered what the channel moves.
    moved : int or None
        Contactor that a person saw move.
    along : bool or None
        Whether that contactor moved along its shear direction.
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
class CheckReport:
    """Result of a check; names of attributes carry their units.

    Attributes
    ----------
    display, device : str
        Name of the display and URL of the device.
    voltage_v : float
        Limit of the drive during the check [V].
    capacitance_nf : float
        Capacitance that each contactor of the display should have [nF].
    frequency_hz : float
        Frequency of the tones [Hz].
    amplifiers : tuple of AmplifierFacts
        Amplifiers on the bus.
    channels : list of CheckedChannel
        Findings in the order of channels.
    notes, faults : list of str
        Remarks, and what is wrong, one line each.
    written : str or None
        File that the map was written to.
    """

    display: str
    device: str
    voltage_v: float
    capacitance_nf: float
    frequency_hz: float = FREQUENCY
    amplifiers: tuple[AmplifierFacts, ...] = ()
    channels: list[CheckedChannel] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    written: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain data.

        Returns
        -------
        dict of str to Any
            Values that can be written as JSON, by the names of the attributes.
        """
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
) -> CheckReport:
    """Check a device and the display on it.

    Parameters
    ----------
    url : str
        URL of the device.
    source : str or Path
        Name or file of the display.
    write : Path, optional
        File to write the map that the person reports to; requires ``ask``.
    force : bool
        Whether to overwrite that file.
    ask : callable, optional
        Function that shows a question and returns the answer; without it, nobody is asked.
    progress : callable, optional
        Function that is called with the number of channels done and their total number.
    accept_unsafe_hold : bool
        As in `open_bus`.

    Returns
    -------
    CheckReport
        Findings, with all faults.

    Raises
    ------
    TactileError
        If the device or a file cannot be used.
    """
    if write is not None:
        if ask is None:
            raise InputError("--out: needs a person at a terminal, who sees which contactor moves")
        checked_target(source, write, force=force)
    display = cautious(load_display(source))
    drive = display.limits.voltage
    report = CheckReport(display.name, url, drive, display.capacitance * 1e9)
    order = np.argsort(display.channel)
    report.channels = [CheckedChannel(int(display.channel[i]), int(i)) for i in order]
    with (
        open_bus(url, display, accept_unsafe_hold=accept_unsafe_hold) as bus,
        guarded(bus, url),
    ):
        _identify_amplifiers(report, bus, ask)
        _measure_all(report, bus, display, progress or (lambda done, total: None))
        if ask is not None and bus.state == "idle":
            _ask_all(report, bus, display, ask)
        report.amplifiers = amplifiers(bus)
        faults = bus.counters.faults()
    if faults:
        report.notes.append("link: " + ", ".join(f"{n} {name}" for name, n in faults.items()))
    _conclude(report, display, source, write, force=force)
    return report


def _identify_amplifiers(report: CheckReport, bus: Bus, ask: Ask | None) -> None:
    """List the amplifiers, and let each of them blink."""
    report.amplifiers = boards = amplifiers(bus)
    if not boards:
        report.notes.append("the device does not tell what it is: it has no CAPS, and no blink")
    for k, board in enumerate(boards):
        blinks = identify(bus, board.node, BLINK)
        if not blinks:
            report.notes.append(f"node {board.node} did not answer IDENTIFY")
        elif ask is not None and len(boards) > 1:
            ask(
                f"board {k + 1} of {len(boards)}, node {board.node}, shows itself; enter to go on: "
            )


# Measurement


def _measure_all(report: CheckReport, bus: Bus, display: Display, progress: Progress) -> None:
    """Play a tone on each channel in turn, and judge what is measured meanwhile."""
    total = len(report.channels)
    with measuring(bus, INTERVAL) as nodes:
        _note_unmeasured(report, nodes)
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


def _note_unmeasured(report: CheckReport, nodes: set[int]) -> None:
    """Note which amplifiers do not measure, and what therefore goes unnoticed."""
    why = "open, short and wrong lines are not noticed"
    unmeasured = [facts for facts in report.amplifiers if facts.node not in nodes]
    if not report.amplifiers:
        report.notes.append(f"no capacitance was measured: the device does not measure; {why}")
    for facts in unmeasured:
        how = "did not begin to measure" if facts.measures else "does not measure (CAPS features)"
        report.notes.append(f"node {facts.node} {how}: of its channels {why}")


def _measure_one(one: CheckedChannel, bus: Bus, display: Display) -> str:
    """Measure and judge a line; return why that failed, or an empty string."""
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
    free = display.actuator.response(FingerLoad.none(), np.array([FREQUENCY]))
    one.verdict = judge(load, drive=drive, admittance=complex(free.admittance[0]) * gain)
    one.voltage_v, one.current_ua = load.voltage, load.current * 1e6
    if math.isfinite(load.error) and display.capacitance > 0:
        one.capacitance_nf = load.capacitance / gain * 1e9
        one.error_percent = load.error * 100
        one.loss = load.loss if math.isfinite(load.loss) else None
    return ""


def _readings_of(
    channel: int, bus: Bus, begin: float, end: float
) -> list[tuple[int, float, float]]:
    """Return position, voltage [V], current [A] of a channel's readings between two positions."""
    return [
        (r.position, r.volts[channel - r.first_channel], r.current[channel - r.first_channel])
        for r in readings(bus)
        if begin <= r.position < end and 0 <= channel - r.first_channel < len(r.volts)
    ]


# Questions to a person


def _ask_all(report: CheckReport, bus: Bus, display: Display, ask: Ask) -> None:
    """Ask a person what each channel moves, and in which direction."""
    for line in report.channels:
        if line.verdict in UNTOUCHABLE:
            continue
        try:
            proceed = _ask_one(line, bus, display, ask)
        except EOFError:
            proceed = False
        if not proceed:
            report.notes.append(f"from channel {line.channel} on nobody told what moves")
            return


def _ask_one(one: CheckedChannel, bus: Bus, display: Display, ask: Ask) -> bool:
    """Play pulses on a channel and ask what moves; return whether to go on.

    The pulses have the polarity of the display file, so that they shear along the direction if the
    file is right.
    """
    count, signal = len(display.contactors), train(display, display.polarity[one.contactor])
    problem = ""
    while True:
        sound(bus, signal, one.channel)
        reply = ask(
            f"{problem}channel {one.channel}: which contactor moved? "
            f"[{one.contactor}; r again, - none, q end] "
        ).strip()
        if reply == "q":
            return False
        if reply == "-":
            one.asked = True
            return True
        if reply in ("", *map(str, range(count))):
            break
        problem = "" if reply == "r" else f"{reply!r}: a number below {count}, r, - or q\n"
    one.moved = int(reply) if reply else one.contactor
    degrees = math.degrees(display.shear_direction[one.moved])
    one.along = _ask_yes_no(ask, f"did it shear toward {degrees:g}° and back? [Y/n] ")
    one.asked = True
    return True


def _ask_yes_no(ask: Ask, question: str) -> bool:
    """Ask until the answer is yes or no; return whether it is yes."""
    while (reply := ask(question).strip().lower()) not in ("", "y", "yes", "n", "no"):
        pass
    return reply in ("", "y", "yes")


def reported_map(channels: Sequence[CheckedChannel], display: Display) -> tuple[Map, list[str]]:
    """Return the map that a person reported, and what is wrong with it.

    A channel that moves nothing, or was not asked about, keeps its contactor unless another channel
    moves that one.

    Parameters
    ----------
    channels : sequence of CheckedChannel
        Channels with the answers of the person.
    display : Display
        Display with the map of its file.

    Returns
    -------
    tuple of Map and list of str
        The map, and one line for each contradiction or gap.
    """
    channel, polarity = display.channel.tolist(), display.polarity.tolist()
    movers: dict[int, CheckedChannel] = {}
    problems = []
    for line in channels:
        if line.moved is None:
            continue
        if line.moved in movers:
            other = movers[line.moved].channel
            problems.append(
                f"contactor {line.moved}: channels {other} and {line.channel} both move it"
            )
        movers[line.moved] = line
        channel[line.moved] = line.channel
        pulsed = display.polarity[line.contactor]
        polarity[line.moved] = pulsed if line.along else -pulsed
    for line in channels:
        if line.moved is None and line.contactor in movers and not problems:
            problems.append(f"channel {line.channel}: what it moves is not known")
    return Map(tuple(channel), tuple(int(p) for p in polarity)), problems


def _conclude(
    report: CheckReport, display: Display, source: str | Path, write: Path | None, *, force: bool
) -> None:
    """Add the faults to the report, and write the map if that was requested."""
    report.faults += [
        f"channel {line.channel}, contactor {line.contactor}: {_describe_fault(line, report)}"
        for line in report.channels
        if line.verdict not in ("good", "not measured", "stopped")
    ]
    report.faults += [
        f"channel {line.channel} moved nothing" for line in report.channels
        if line.asked and line.moved is None
    ]  # fmt: skip
    reported, problems = reported_map(report.channels, display)
    report.faults += problems
    unasked = [c for c in report.channels if not c.asked and c.verdict not in UNTOUCHABLE]
    changed = reported != Map.of(display)
    if write is not None and (problems or unasked):
        report.faults.append(f"{write} was not written: nobody told the whole map")
    elif write is not None:
        write_map(source, write, reported, force=force)
        report.written = str(write)
    elif changed:
        report.faults.append("the display file has another map than the display; see --out")


def _describe_fault(one: CheckedChannel, report: CheckReport) -> str:
    """Return the verdict on a line with the measured values."""
    measured = (
        "" if one.capacitance_nf is None
        else f"{one.capacitance_nf:.2f} nF where the display has {report.capacitance_nf:.2f} nF, "
    )  # fmt: skip
    return f"{one.verdict}: {measured}{one.voltage_v:.2f} V at {one.current_ua:.0f} µA"
