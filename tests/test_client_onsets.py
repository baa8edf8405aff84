"""The SDK says when a stimulus is to begin, on the server's clock, and what became of it."""

import asyncio
import time
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from client_rig import PATIENCE, Script, ScriptedServer, until

from tactile import client
from tactile import messages as m
from tactile.client import aio
from tactile.client.onsets import FORGOTTEN, Onsets
from tactile.clock import ModelClock
from tactile.errors import ClientTimeoutError, DisconnectedError, InputError, RequestError

AHEAD = 5.0
"""The server's clock less ours, as the scripted server has it [s]."""
POINTS = [(0.0, 1.0)]


def frame(display: Any, at: Any) -> None:
    display.frames(1000.0, amplitude=1e-6).write([0.0, 0.0], at=at)


CALLS: dict[str, Callable[[Any, Any], Any]] = {
    "append": lambda d, at: d.append([0.0], sample_rate=8000, amplitude=1e-6, at=at),
    "play": lambda d, at: d.play([0.0] * 9000, sample_rate=8000, amplitude=1e-6, at=at),
    "effect": lambda d, at: d.effect(1e-6, amplitude_points=POINTS, at=at),
    "play_effect": lambda d, at: d.play_effect("tap", at=at),
    "transient": lambda d, at: d.transient(1e-6, at=at),
    "frames": frame,
}


def begun(server: ScriptedServer) -> list[m.BeginAt | None]:
    """Return when what was heard is to begin, in the order in which it came."""
    kinds = m.Append, m.PlayEffect, m.PlayNamedEffect, m.TactileFrames
    return [said.begin for said in server.of(*kinds)]


def report(begin: m.BeginAt, *, late_us: float = 40.0, reason: str = "") -> m.OnsetMessage:
    return m.OnsetMessage(
        display="left", number=begin.number, at_us=begin.at_us, onset_us=begin.at_us + late_us,
        uncertainty_us=30.0, reason=reason, marker=begin.marker,
    )  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_each_stimulus_may_begin_at_a_time_and_its_onset_comes_back(
    server: ScriptedServer, name: str
) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        at = client.At(time.monotonic() + 0.5, drop_late=True, marker=5)
        offset = display._connection._session.offset
        before = offset.uncertainty(time.monotonic())
        CALLS[name](display, at)
        first, *rest = until(lambda: begun(server))
        assert first is not None
        uncertainty = max(before, offset.uncertainty(time.monotonic()))
        assert first.at_us == pytest.approx((at.time + AHEAD) * 1e6, abs=1e6 * uncertainty + 1)
        assert (first.drop_late, first.marker) == (True, 5)
        assert set(rest) <= {None}, "the rest of a waveform follows its first part"
        assert not at.known
        server.say(report(first))
        onset = at.onset(PATIENCE)
    assert (onset.display, onset.reason, onset.marker) == ("left", "", 5)
    assert onset.at == pytest.approx(at.time, abs=1e-6)
    assert onset.time == pytest.approx(at.time + 40e-6, abs=1e-6)
    assert onset.uncertainty is not None
    assert 30.1e-6 <= onset.uncertainty < PATIENCE, "the uncertainty of the clocks is added"


def test_a_time_alone_will_do(server: ScriptedServer) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        display.transient(1e-6, at=time.monotonic())
    (begin,) = begun(server)
    assert begin is not None
    assert not begin.drop_late


def test_the_onset_of_another_program_is_an_event(server: ScriptedServer) -> None:
    """Report on one that has the number of a stimulus of this program."""
    events: list[client.Event] = []
    with client.connect(server.url, timeout=PATIENCE) as display:
        display.on_event(events.append)
        at = client.At(time.monotonic() + 0.5, marker=5)
        display.transient(1e-6, at=at)
        (begin,) = begun(server)
        assert begin is not None
        server.say(msgspec.structs.replace(report(begin, reason="late by 3 ms"), client=9))
        event = until(lambda: [one for one in events if one.kind == "onset"])[0]
        assert not at.known
    assert (event.display, event.detail) == ("left", "late by 3 ms")
    assert event.onset is not None
    assert (event.onset.client, event.onset.marker) == (9, 5)
    assert event.onset.time == pytest.approx(at.time + 40e-6, abs=1e-6)


def test_a_stimulus_that_was_not_played_says_why(server: ScriptedServer) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        at = client.At(time.monotonic())
        display.transient(1e-6, at=at)
        (begin,) = begun(server)
        assert begin is not None
        server.say(
            m.OnsetMessage(
                display="left", number=begin.number, at_us=begin.at_us, onset_us=None,
                uncertainty_us=None, reason="late by 3 ms",
            )
        )  # fmt: skip
        onset = at.onset(PATIENCE)
    assert (onset.time, onset.uncertainty, onset.reason) == (None, None, "late by 3 ms")


def test_an_onset_is_awaited_under_asyncio(server: ScriptedServer) -> None:
    async def main() -> client.Onset:
        async with aio.connect(server.url, timeout=PATIENCE) as display:
            at = client.At(time.monotonic())
            await display.transient(1e-6, at=at)
            (begin,) = begun(server)
            assert begin is not None
            server.say(report(begin))
            return await at

    assert asyncio.run(main()).reason == ""


def test_what_is_refused_disconnected_or_not_known_yet_is_raised(
    script: Script, server: ScriptedServer
) -> None:
    refused, waiting = client.At(time.monotonic()), client.At(time.monotonic())
    with client.connect(server.url, timeout=PATIENCE) as display:
        script.answers[m.PlayEffect] = lambda said: m.Failure(
            id=said.id, code="not_armed", message="disarmed"
        )
        with pytest.raises(RequestError):
            display.transient(1e-6, at=refused)
        with pytest.raises(RequestError):
            refused.onset(PATIENCE)
        del script.answers[m.PlayEffect]
        display.transient(1e-6, at=waiting)
        with pytest.raises(ClientTimeoutError, match="not known after 0 s"):
            waiting.onset(0)
    with pytest.raises(DisconnectedError):
        waiting.onset(PATIENCE)


def test_a_stimulus_whose_answer_did_not_come_is_reported_all_the_same(
    script: Script, server: ScriptedServer
) -> None:
    script.answers[m.PlayEffect] = lambda said: None
    with client.connect(server.url, timeout=PATIENCE) as display:
        at = client.At(time.monotonic())
        with pytest.raises(ClientTimeoutError):
            display.transient(1e-6, at=at, timeout=0.05)
        (begin,) = until(lambda: begun(server))
        assert begin is not None
        server.say(report(begin))
        assert at.onset(PATIENCE).reason == ""


@pytest.mark.parametrize("at", [float("nan"), "soon", [1.0]])
def test_a_time_that_is_none_is_refused(server: ScriptedServer, at: Any) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        with pytest.raises(InputError, match=r"at \[s\]"):
            display.transient(1e-6, at=at)
        assert begun(server) == []


@pytest.mark.parametrize("marker", [-1, 256, 1.5, "1", None])
def test_a_marker_that_is_no_code_is_refused(marker: Any) -> None:
    with pytest.raises(InputError, match=r"marker .*: a code of 8 lines is one of 0 … 255"):
        client.At(0.0, marker=marker)


def test_a_time_belongs_to_one_stimulus(server: ScriptedServer) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        at = client.At(time.monotonic())
        display.transient(1e-6, at=at)
        with pytest.raises(InputError, match="another stimulus"):
            display.transient(1e-6, at=at)


def test_a_time_that_is_too_far_ahead_is_refused(server: ScriptedServer) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        with pytest.raises(InputError, match=r"at most 60 s, of time\.monotonic"):
            display.transient(1e-6, at=time.time() + 60)
        assert begun(server) == []


def test_the_rest_of_a_waveform_that_was_dropped_is_not_played(
    script: Script, server: ScriptedServer
) -> None:
    """The server reports the drop before it answers to the first part."""

    def dropped(said: m.Append) -> m.AppendedReply:
        assert said.begin is not None
        server.say(
            m.OnsetMessage(
                display="left", number=said.begin.number, at_us=said.begin.at_us, onset_us=None,
                uncertainty_us=None, reason="late by 3 ms",
            )
        )  # fmt: skip
        return m.AppendedReply(id=said.id, samples_consumed=4000, buffered_ms=0.0)

    with client.connect(server.url, timeout=PATIENCE) as display:
        script.answers[m.Append] = dropped
        at = client.At(time.monotonic(), drop_late=True)
        assert display.play([0.0] * 9000, sample_rate=8000, amplitude=1e-6, at=at) == 4000
    assert len(begun(server)) == 1


def test_an_onset_that_is_awaited_in_vain_times_out_and_may_be_awaited_again(
    server: ScriptedServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with aio.connect(server.url, timeout=PATIENCE) as display:
            at = client.At(time.monotonic() - 1e6)
            await display.transient(1e-6, at=at)
            (begin,) = begun(server)
            assert begin is not None
            with monkeypatch.context() as impatient:
                impatient.setattr("tactile.client.onsets.PATIENCE", 0.0)
                with pytest.raises(ClientTimeoutError, match="not known after 0 s"):
                    await at
            server.say(report(begin))
            assert (await at).reason == ""

    asyncio.run(main())


def test_a_stimulus_of_which_no_report_came_is_forgotten() -> None:
    """A lost report must not hold its memory forever."""
    clock = ModelClock()
    onsets, now = Onsets(clock, lambda: (0.0, 0.0)), clock.now()
    onsets.begin(client.At(now - 1e6))
    onsets.begin(client.At(now))
    assert len(onsets._waiting) == 2, "by the time of sending, not that of the stimulus"
    clock.sleep(FORGOTTEN + 1)
    onsets.begin(client.At(now))
    assert len(onsets._waiting) == 1
