"""Test of a live amplifier against the behavior vectors of the protocol."""

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from itertools import zip_longest
from typing import Any, Literal

from firmware_protocol import messages as m
from firmware_protocol.capabilities import caps_fault
from firmware_protocol.host import BY_HOST
from firmware_protocol.messages import Feature, Parameter
from tactile.bus.conform.reference import Expected, Judge, config_of_caps, on_link
from tactile.bus.conform.rig import Rig, SilenceError, Trace
from tactile.bus.conform.scenarios import Answer, Scenario, load_scenarios
from tactile.bus.registry import open_wire
from tactile.errors import BusError

Verdict = Literal["passed", "failed", "not applicable", "not run"]
"""Result of a vector."""

ATTEMPTS = 4
"""Number of times that a scenario is played whose steps came too late for it."""
SLACK = 2e-3
"""Time by which a step waits longer than its vector says, so that packets which took unlike times
on the link are no closer together than there [s]; assumed to exceed the jitter of a link (USB looks
for data once in 1 ms)."""
MEASURED = (Parameter.HIGH_VOLTAGE_MV, Parameter.TEMPERATURE_MK)
"""Parameters that an amplifier may have, and the reference does not."""
BY_A_PERSON = (
    "the output: value and slope of what is put out, bridges, fades and gains, on an oscilloscope",
    "the high voltage: that it is off in IDLE, SAFE, ESTOP and FAULT",
    "0 V by hardware at reset, at brown-out, and with the processor halted (14, duty 9)",
    "the e-stop input: opening, bounces, and a wire that breaks, with the firmware halted (6.3)",
    "the hardware's faults, and what needs an amplifier that was just powered up",
)
"""What the vectors on a link cannot show."""


@dataclass(frozen=True)
class VectorResult:
    """Result of a vector.

    Attributes
    ----------
    id, section, why : str
        Name of the vector, section of SPEC.md, and its reason.
    verdict : str
        "passed", "failed", "not applicable" or "not run".
    expected, got : str
        What a vector that failed demands, and what the amplifier did; empty otherwise.
    reason : str
        Why it was not run; empty if it was.
    unseen : bool
        Whether the vector is also about the output, which was not seen.
    """

    id: str
    section: str
    why: str
    verdict: Verdict
    expected: str = ""
    got: str = ""
    reason: str = ""
    unseen: bool = False


@dataclass
class ConformanceReport:
    """Results of all vectors on an amplifier.

    Attributes
    ----------
    device, name, version : str
        URL of the device, name of the amplifier, and its version of the protocol.
    node, firmware, channels : int
        Its node, its firmware, and its number of channels.
    results : list of VectorResult
        Result of each vector, in their order.
    ended : str
        Why not all vectors were run, one line; empty if all were.
    interrupted : bool
        Whether a person ended it.
    """

    device: str
    name: str
    version: str
    node: int
    firmware: int
    channels: int
    results: list[VectorResult] = field(default_factory=list)
    ended: str = ""
    interrupted: bool = False

    @property
    def counts(self) -> dict[str, int]:
        """Number of vectors by verdict."""
        return dict(Counter(result.verdict for result in self.results))

    @property
    def conforms(self) -> bool:
        """Whether all vectors that apply have passed, and one does."""
        counts = self.counts
        return not self.ended and counts.get("passed", 0) > 0 and counts.get("failed", 0) == 0

    @property
    def summary(self) -> str:
        """One line with the verdict and the numbers."""
        n = {kind: self.counts.get(kind, 0) for kind in ("passed", "failed", "not applicable")}
        applied, other = n["passed"] + n["failed"], n["not applicable"]
        if self.conforms:
            unseen = sum(r.unseen for r in self.results if r.verdict == "passed")
            return (
                f"conforms to {self.version}: {applied} vectors apply and passed ({unseen} of them "
                f"by their answers only, their output was not seen), {other} do not apply"
            )
        if self.ended:
            left = self.counts.get("not run", 0)
            return f"{self.ended}; {n['passed']} passed, {n['failed']} failed, {left} not run"
        if not applied:
            return "no vector applies to this amplifier: nothing was tested"
        failed = f"{n['failed']} of {applied} vectors that apply failed"
        return f"does not conform to {self.version}: {failed}"

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain data, such as for JSON.

        Returns
        -------
        dict of str to object
            Attributes, numbers and verdict by name.
        """
        return asdict(self) | {
            "counts": self.counts, "conforms": self.conforms, "summary": self.summary,
            "by_a_person": list(BY_A_PERSON),
        }  # fmt: skip


class Conformance:
    """A test of the amplifier at a URL, which is open until `close`.

    Parameters
    ----------
    url : str
        URL of a device with one amplifier that carries the protocol.

    Attributes
    ----------
    caps : Caps
        Properties of the amplifier.
    voltage : float
        Largest voltage that the amplifier may put out in the test [V].

    Raises
    ------
    InputError
        If the device carries no packets.
    BusError
        If the device cannot be opened, or no amplifier answers that a host may arm.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._wire, self._clock = open_wire(url)
        try:
            self._rig = Rig(self._wire, self._clock)
            self._rig.find()
            if fault := caps_fault(self._rig.caps, self._rig.caps.session):
                raise BusError(f"{url}: {fault}")
        except BusError as error:
            self.close()
            raise BusError(f"{url}: {str(error).removeprefix(f'{url}: ')}") from error
        self.caps = self._rig.caps
        self.voltage = self.caps.voltage_limit_uv * 1e-6

    def __enter__(self) -> "Conformance":
        """Return the test itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the wire."""
        self.close()

    def close(self) -> None:
        """Close the wire; it may be called any number of times."""
        self._wire.close()

    def run(
        self, progress: Callable[[int, int], object] = lambda done, total: None
    ) -> ConformanceReport:
        """Run all vectors that apply, and leave the amplifier at rest.

        Parameters
        ----------
        progress : callable
            Function that is called with the number of vectors that are done, and that of all.

        Returns
        -------
        ConformanceReport
            Result of each vector, also if it was interrupted or the amplifier stopped answering.

        Raises
        ------
        BusError
            If the amplifier does not come to rest before the first vector.
        """
        report, scenarios = self._report(), load_scenarios()
        try:
            self._rig.rest()
            judge, measured = self._judge()
            for k, scenario in enumerate(scenarios):
                progress(k, len(scenarios))
                report.results.append(self._result(judge, scenario, measured))
            progress(len(scenarios), len(scenarios))
            self._rig.rest()
        except KeyboardInterrupt:
            report.interrupted, report.ended = True, f"interrupted; {self._stopped()}"
        except BusError as error:
            if not report.results:
                raise BusError(f"{self._url}: {error}") from error
            last = report.results[-1].id
            report.ended = f"{error}, after {last}; {self._stopped()}"
        report.results += [
            _row(scenario, "not run", reason="the test ended before")
            for scenario in scenarios[len(report.results) :]
        ]
        return report

    def _report(self) -> ConformanceReport:
        """Return a report without results."""
        caps = self._rig.caps
        name = caps.name.rstrip(b"\0").decode("utf-8", "replace")
        version = f"{caps.major}.{caps.minor}"
        return ConformanceReport(
            self._url, name, version, self._rig.home, caps.firmware, caps.channels
        )

    def _judge(self) -> tuple[Judge, set[int]]:
        """Return the judge for this amplifier, and the parameters that only it has."""
        rig = self._rig
        measured = {int(p) for p in MEASURED if isinstance(rig.request(m.Get(p))[1], m.Value)}
        range_ua = rig.request(m.Get(Parameter.SENSE_RANGE_UA))[1]
        config = config_of_caps(
            rig.caps, rig.home, range_ua.value if isinstance(range_ua, m.Value) else 0
        )
        senses = bool(rig.caps.features & Feature.SENSES)
        return Judge(config, senses=senses, link=self._wire.link), measured

    def _stopped(self) -> str:
        """Stop the amplifier, and return in words whether it is at rest."""
        try:
            self._rig.halt()
        except SilenceError:
            return "the amplifier does not answer STOP and DISARM: switch it off"
        except BusError:
            self._rig.emergency(BY_HOST)
            return "the amplifier was not at rest after STOP and DISARM, and an ESTOP was sent"
        return "the amplifier was stopped and disarmed"

    def _result(self, judge: Judge, scenario: Scenario, measured: set[int]) -> VectorResult:
        """Run a scenario if it applies, and return its result."""
        if scenario.parameters & measured:
            return _row(scenario, "not applicable", reason="another configuration: it measures")
        scenario = on_link(scenario, self._wire.link)
        expected = judge.judge(scenario)
        if isinstance(expected, str):
            return _row(scenario, "not applicable", reason=expected)
        for _ in range(ATTEMPTS):
            self._rig.rest()
            words = self._rig.translation(scenario)
            trace = self._rig.play(scenario, words, lambda gap: min(gap, SLACK))
            if trace.late <= expected.late:
                return _compared(scenario, expected, trace)
        reason = f"the link or this computer is later than {expected.late * 1e3:g} ms"
        return _row(scenario, "not applicable", reason=reason)


def _row(scenario: Scenario, verdict: Verdict, **more: str) -> VectorResult:
    """Return the result of a scenario."""
    s = scenario
    return VectorResult(s.id, s.section, s.why, verdict, unseen=s.unseen, **more)


def _compared(scenario: Scenario, expected: Expected, trace: Trace) -> VectorResult:
    """Return whether a trace is what a scenario demands."""
    for k, (want, got) in enumerate(zip_longest(expected.answers, trace.answers)):
        if want is None or got is None or want.differs(got):
            return _failed(scenario, k, want, got)
    if not trace.status:
        return _row(scenario, "failed", expected="STATUS after the last step", got="nothing")
    wrong = {n: v for n, v in expected.status.items() if trace.status.get(n) != v}
    if not wrong:
        return _row(scenario, "passed")
    seen = {name: trace.status[name] for name in wrong}
    where = "after the last step: "
    return _row(
        scenario, "failed",
        expected=where + str(Answer("STATUS", wrong)), got=where + str(Answer("STATUS", seen)),
    )  # fmt: skip


def _failed(scenario: Scenario, k: int, want: Answer | None, got: Answer | None) -> VectorResult:
    """Return the result of a scenario whose answer ``k`` is wrong."""
    where = f"message {k + 1}: "
    if want is not None and got is not None and want.message == got.message:
        shown = {name: got.fields.get(name, 0) for name in want.fields}
        got = Answer(got.message, shown, got.node if want.node is not None else None)
    elif got is not None:
        got = Answer(got.message, got.fields if got.message != "STATUS" else {})
    return _row(
        scenario, "failed",
        expected=where + ("nothing" if want is None else str(want)),
        got=where + ("nothing" if got is None else str(got)),
    )  # fmt: skip
