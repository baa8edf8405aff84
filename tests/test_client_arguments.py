"""Whatever a program gives a call of the SDK by mistake is one clear line, in both twins."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from client_rig import PATIENCE, ScriptedServer, Twin

from tactile import messages as m
from tactile.errors import InputError

WAVE: Any = {"sample_rate": 8000, "amplitude": 1e-6}
Call = Callable[[Any], Any]

WRONG: dict[str, list[Call]] = {
    r"position \[m\]: .* is not two numbers": [
        lambda d: d.touch((0, 0, 0)),
        lambda d: d.touch(("a", 0)),
        lambda d: d.touch(("1", 0)),
        lambda d: d.touch((None, None)),
        lambda d: d.touch(None),
        lambda d: d.touch(5),
        lambda d: d.touch("12"),
        lambda d: d.touch((10**400, 0)),
    ],
    r"position_mm\[1\] = -inf": [lambda d: d.touch((0, -math.inf))],
    r"position_mm\[0\] = nan: expected float": [lambda d: d.touch((math.nan, 0.0))],
    r"position_mm\[1\] = 101000.0: .* <= 100000.0": [lambda d: d.touch((0.0, 101.0))],
    r"velocity_mm_s\[1\] = inf": [lambda d: d.touch((0.0, 0.0), velocity=(0.0, math.inf))],
    "normal_force_n = -0.1: .* >= 0": [lambda d: d.touch((0.0, 0.0), normal_force=-0.1)],
    "gain = 1.5: .* <= 1": [lambda d: d.gain(1.5)],
    r"layers\[1\].gain = 2.0: .* <= 1": [lambda d: d.select(["a", ("b", 2.0)])],
    "layers: 3 is no texture": [lambda d: d.select([3])],
    "layers: .*length <= 4": [lambda d: d.select(["a"] * 5)],
    "amplitude_um = 1000000.0: .* <= 500": [lambda d: d.effect(1.0)],
    r"samples\[1\]: 1.5 is outside −1 … 1": [lambda d: d.append([0.0, 1.5], **WAVE)],
    r"samples\[0\]: nan is outside": [lambda d: d.append([math.nan], **WAVE)],
    "samples: must be real": [lambda d: d.append(["a"], **WAVE)],
    "sample_rate_hz = 8.0: ": [lambda d: d.append([0.0], sample_rate=8, amplitude=1e-6)],
    "rate: 0 Hz is not above 0": [lambda d: d.telemetry(rate=0)],
    r"velocity \[m/s\]: .* is not two numbers": [
        lambda d: d.touch((0, 0), velocity=(0, 0, 0)),
        lambda d: d.touch((0, 0), velocity=0.08),
        lambda d: d.touch((0, 0), velocity=("a", 0)),
    ],
    r"normal_force \[N\], as 0.5: .* is not a finite number": [
        lambda d: d.touch((0, 0), normal_force=None),
        lambda d: d.touch((0, 0), normal_force="0.5"),
        lambda d: d.touch((0, 0), normal_force=(1, 2)),
    ],
    "normal_force_n = nan": [lambda d: d.touch((0, 0), normal_force=math.nan)],
    "time: .* is not a finite time": [
        lambda d: d.touch((0, 0), time="now"),
        lambda d: d.touch((0, 0), time=1e308),
        lambda d: d.touch((0, 0), time=math.nan),
        lambda d: d.lift(time=math.inf),
    ],
    "layers: .* is n": [lambda d: d.select(5), lambda d: d.select(None), lambda d: d.select([3])],
    "layers: .* is no texture": [lambda d: d.select([("a", "b", "c")])],
    r"layers\[0\].texture = 5": [lambda d: d.select(m.Layer(texture=5))],  # type: ignore[arg-type]
    "select: .*unsupported": [lambda d: d.select(m.Layer(texture=object()))],  # type: ignore[arg-type]
    "gain: .* is not a finite number": [
        lambda d: d.gain("x"), lambda d: d.gain(None), lambda d: d.gain(math.nan),
    ],
    "timeout .* is not a finite number": [
        lambda d: d.gain(0.5, timeout="x"),
        lambda d: d.telemetry(timeout=math.inf),
        lambda d: d.play([0.0], **WAVE, timeout="x"),
    ],
    "timeout: -1 s is not in 0": [lambda d: d.stats(timeout=-1), lambda d: d.arm(timeout=-1)],
    "estop = ": [lambda d: d.clear(estop=0), lambda d: d.clear(estop="x")],
    "samples: ": [
        lambda d: d.append(5, **WAVE),
        lambda d: d.append("abc", **WAVE),
        lambda d: d.play(None, **WAVE),
    ],
    "sample_rate .* is not a finite number": [
        lambda d: d.append([0.0], sample_rate="x", amplitude=1e-6),
    ],
    "amplitude .* is not a finite number": [
        lambda d: d.play([0.0], sample_rate=8000, amplitude=None), lambda d: d.effect("x"),
    ],
    r"contactors\[0\]: .* is not a whole number": [
        lambda d: d.append([0.0], **WAVE, contactors=[1.5]),
        lambda d: d.append([0.0], **WAVE, contactors=["a"]),
    ],
    "contactors: 5 is not a sequence": [lambda d: d.append([0.0], **WAVE, contactors=5)],
    r"contactors\[0\] = -1": [lambda d: d.append([0.0], **WAVE, contactors=[-1])],
    "amplitude_points: 5 is not a sequence": [lambda d: d.effect(1e-6, amplitude_points=5)],
    r"amplitude_points\[1\]: .* is not \(time \[s\], value\)": [
        lambda d: d.effect(1e-6, amplitude_points=[(0, 1), (1,)]),
        lambda d: d.effect(1e-6, amplitude_points=[(0, 1), (1, 2, 3)]),
    ],
    r"amplitude_points\[0\]: 0 is not a sequence": [lambda d: d.effect(1e-6, amplitude_points=[0])],
    r"frequency_points\[0\]\[0\]: 'a' is not": [
        lambda d: d.effect(1e-6, frequency_points=[("a", 1)])
    ],
    r"transients\[0\]: .* is not \(time \[s\], value, frequency \[Hz\]\)": [
        lambda d: d.effect(1e-6, transients=[(0, 1, 2, 3)]),
        lambda d: d.effect(1e-6, transients=[()]),
    ],
    r"transients\[0\]\[2\]: None": [lambda d: d.transient(1e-6, frequency=None)],
    "rate .* is not a finite number": [
        lambda d: d.telemetry(rate="x"), lambda d: d.telemetry(rate=math.inf),
    ],
    "rate_hz = 1000": [lambda d: next(iter(d.telemetry(rate=1000)))],
    "callback: 5 is not a function": [
        lambda d: d.on_event(5), lambda d: d.connection.on_event(5),
    ],
    "no display 5": [lambda d: d.connection.display(5)],
}  # fmt: skip
"""Calls by the text of the line that refuses them."""


def test_a_wrong_argument_is_one_line_and_nothing_is_sent(
    twin: Twin, server: ScriptedServer
) -> None:
    with twin.connect(server.url, timeout=PATIENCE) as display:
        for text, calls in WRONG.items():
            for number, call in enumerate(calls):
                with pytest.raises(InputError, match=text) as caught:
                    call(display)
                assert "\n" not in str(caught.value), (text, number)
        display.lift()
        display.stats()
    kinds = [type(said) for said in server.heard if not isinstance(said, m.Contact)]
    assert kinds == [m.ClientHello, m.GetStats, m.StopPlaying]


@pytest.mark.parametrize(
    "options",
    [
        {"url": 5}, {"timeout": "x"}, {"timeout": -1}, {"token": 5}, {"client_name": ""},
        {"encoding": "xml"}, {"display": 5}, {"url": "ws+unix://relative.sock"},
    ],
)  # fmt: skip
def test_a_wrong_argument_to_connect_is_one_line(
    twin: Twin, server: ScriptedServer, options: dict[str, Any]
) -> None:
    with pytest.raises(InputError) as caught:
        twin.connect(**{"url": server.url, "timeout": PATIENCE, **options})
    assert "\n" not in str(caught.value)


def test_lift_is_where_the_finger_was_although_the_position_is_gone(
    twin: Twin, server: ScriptedServer
) -> None:
    with twin.connect(server.url, timeout=PATIENCE) as display:
        place = [0.001, 0.002]
        display.touch(place)
        place[:] = ["lost"]  # type: ignore[list-item]
        display.lift()
        display.stats()
        lifted = server.of(m.Contact)[-1]
        assert (lifted.position_mm, lifted.normal_force_n) == ((1.0, 2.0), 0.0)
