"""Tactile frames from the SDK: what is sent, what is refused, and how taxels map to contactors."""

import itertools
import struct
import time
from array import array
from typing import Any

import numpy as np
import pytest
from client_rig import PATIENCE, Script, ScriptedServer, Twin, until
from hypothesis import given
from hypothesis import strategies as st

from tactile import client
from tactile import messages as m
from tactile.client.session import ClockOffset
from tactile.client.taxels import Extent, TaxelGrid, default_extent, to_grid
from tactile.errors import ClientError, InputError

SQUARE = tuple((2e-3 * x, 2e-3 * y) for y in range(4) for x in range(6))
"""Contactors in four rows of six, 2 mm apart, the lowest row first [m]."""
HEXAGONAL = tuple((2e-3 * (x + y % 2 / 2), 1.732e-3 * y) for y in range(4) for x in range(5))
"""Contactors in the corners of equilateral triangles [m]."""


def values_of(said: m.TactileFrames) -> list[float]:
    assert isinstance(said.frames, bytes)
    return list(struct.unpack(f"<{len(said.frames) // 4}f", said.frames))


def test_frames_are_sent_without_waiting_and_in_order(twin: Twin, server: ScriptedServer) -> None:
    with twin.connect(server.url, timeout=PATIENCE) as display:
        frames = display.frames(500.0, amplitude=20e-6)
        for number in range(200):
            frames.write([number / 200, -number / 200])
        until(lambda: sum(len(values_of(said)) for said in server.of(m.TactileFrames)) == 400)
    said = server.of(m.TactileFrames)
    numbers = list(itertools.chain.from_iterable(map(values_of, said)))
    assert numbers[::2] == pytest.approx([number / 200 for number in range(200)])
    assert numbers[1::2] == pytest.approx([-number / 200 for number in range(200)])
    assert {(each.frame_rate_hz, round(each.amplitude_um, 9), each.latest) for each in said} == {
        (500.0, 20.0, False)
    }


@pytest.mark.parametrize(
    "frame",
    [
        [0.5, -1], (0.5, -1.0), array("d", [0.5, -1]), np.array([0.5, -1]),
        np.array([0.5, -1], np.float32), np.array([[0.5, 9], [-1, 9]])[:, 0], iter([0.5, -1]),
        [[0.5], [-1]], np.array([[0.5, -1]]),
    ],
)  # fmt: skip
def test_a_frame_may_be_of_any_kind(server: ScriptedServer, frame: Any) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        display.frames(1000.0, amplitude=1e-6, latest=True).write(frame)
        (said,) = until(lambda: server.of(m.TactileFrames))
    assert values_of(said) == [0.5, -1.0]
    assert said.latest


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        ([0.0], "frame: 1 values, but the display takes 2"),
        ([0.0, 1.5], "frame[1]: 1.5 is outside −1 … 1"),
        ([0.0, float("nan")], "frame[1]: nan is outside −1 … 1"),
        (3.0, "frame: 3.0 is not a sequence"),
        ("ab", "frame: 'ab' is not an image of numbers"),
        ([[0.0], 1.0], "frame: [[0.0], 1.0] is no image of numbers"),
        ([[[0.0]], [[1.0]]], "frame: [[[0.0]], [[1.0]]] is not an image of numbers"),
    ],
)
def test_a_frame_that_is_none_is_refused_in_one_line(
    server: ScriptedServer, frame: Any, text: str
) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        frames = display.frames(1000.0, amplitude=1e-6)
        with pytest.raises(InputError) as caught:
            frames.write(frame)
        assert str(caught.value) == text
        assert display.stats().display == "left"
    assert server.of(m.TactileFrames) == []


def test_a_block_is_sent_in_messages_that_follow_each_other(
    server: ScriptedServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each message has as many frames as it may have, and the time of its first one."""
    count = 2 * m.MOST_FRAME_VALUES // 2 + 10
    values = np.linspace(-1, 1, 2 * count, dtype=np.float32).reshape(count, 2)
    monkeypatch.setattr(ClockOffset, "exchange", lambda *_: None)  # pings would correct it
    now = time.monotonic()
    with client.connect(server.url, timeout=PATIENCE) as display:
        display.connection._session.offset.seconds = 1000.0
        display.frames(48_000.0, amplitude=1e-6).write_block(values, time=now + 0.5)
        display.frames(1000.0, amplitude=1e-6).write_block(array("f", [0.5, -1.0]))
        until(lambda: len(server.of(m.TactileFrames)) == 4)
    *parts, plain = server.of(m.TactileFrames)
    assert np.concatenate([values_of(part) for part in parts]).tolist() == values.ravel().tolist()
    counts = [len(values_of(part)) // 2 for part in parts]
    assert counts == [m.MOST_FRAME_VALUES // 2] * 2 + [10]
    began = np.array([part.time_us for part in parts])
    assert began - began[0] == pytest.approx(1e6 * np.array([0, *np.cumsum(counts)[:2]]) / 48e3)
    assert began[0] * 1e-6 == pytest.approx(now + 1000.5, abs=1e-6)
    assert (values_of(plain), plain.time_us) == ([0.5, -1.0], None)


@pytest.mark.parametrize(
    ("frames", "options", "when", "text"),
    [
        (np.zeros(3, np.float32), {}, 1.0, "frames: 3 values are no frames of 2 each"),
        (np.zeros(2), {}, 1.0, "frames: is a buffer of format 'd', not of contiguous float32"),
        (np.zeros((2, 4), np.float32)[:, ::2], {}, 1.0, "not of contiguous float32"),
        ([0.0, 1.0], {}, 1.0, "frames: [0.0, 1.0] is not a buffer of float32"),
        (np.zeros(2, np.float32), {}, float("nan"), "time [s]: nan is not a finite number"),
        (np.zeros(2, np.float32), {"latest": True}, 1.0, "time [s]: is for frames that are all"),
        (np.zeros(2, np.float32), {"grid": (1, 2)}, None, "not images of a grid"),
    ],
)
def test_a_block_that_is_none_is_refused_in_one_line(
    server: ScriptedServer, frames: Any, options: dict[str, Any], when: float | None, text: str
) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        writer = display.frames(1000.0, amplitude=1e-6, **options)
        with pytest.raises(InputError) as caught:
            writer.write_block(frames, time=when)
    assert text in str(caught.value)
    assert server.of(m.TactileFrames) == []


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"rate": 50.0}, "frame_rate_hz"),
        ({"rate": float("nan")}, "rate [Hz]: nan is not a finite number"),
        ({"amplitude": 1.0}, "amplitude_um"),
        ({"latest": "newest"}, "latest"),
        ({"grid": (3,)}, "grid: [3] must be the number of rows and of columns"),
        ({"grid": (0, 3)}, "grid: 0 × 3 taxels are none"),
        ({"grid": (300, 300)}, "grid: 300 × 300 taxels are more than 65536"),
        ({"grid": (1.5, 3)}, "grid: 1.5 is not a whole number"),
        ({"extent": (0, 0, 1, 1)}, "extent: it belongs to a grid"),
        ({"grid": (2, 2), "extent": (0, 0, 0, 1)}, "must be left < right and bottom < top"),
        ({"grid": (2, 2), "extent": (0, 0, 1)}, "must be left < right and bottom < top"),
    ],
)
def test_a_stream_that_is_none_is_refused(
    server: ScriptedServer, options: dict[str, Any], text: str
) -> None:
    wanted: dict[str, Any] = {"rate": 1000.0, "amplitude": 1e-6} | options
    with (
        client.connect(server.url, timeout=PATIENCE) as display,
        pytest.raises(InputError) as caught,
    ):
        display.frames(**wanted)
    assert text in str(caught.value)


def test_frames_without_a_server_are_counted(script: Script, server: ScriptedServer) -> None:
    with client.connect(server.url, timeout=PATIENCE) as display:
        frames = display.frames(1000.0, amplitude=1e-6)
        server.close()
        until(lambda: not display.connected)
        for _ in range(3):
            frames.write([0.0, 0.0])
        assert display.connection.counters["dropped_frames"] == 3
        at = client.At(time.monotonic())
        frames.write([0.0, 0.0], at=at)
        with pytest.raises(ClientError, match="not sent in time"):
            at.onset(PATIENCE)


def test_a_refused_frame_is_an_event(remote: Any, script: Script, server: ScriptedServer) -> None:
    script.answers[m.TactileFrames] = lambda said: m.Failure(code="unsupported", message="no")
    events: list[client.Event] = []
    remote.on_event(events.append)
    remote.frames(1000.0, amplitude=1e-6).write([0.0, 0.0])
    until(lambda: events)
    assert events == [client.Event("refused", "", "unsupported: no")]
    assert remote.connection.counters["refused_messages"] == 1


# Taxels


def test_a_grid_over_a_square_array_is_averaged_square_by_square() -> None:
    """A grid of 16 × 48 taxels has 4 × 8 for each of 24 contactors; the first row is the upper."""
    grid = to_grid((16, 48), SQUARE, None)
    image = np.random.default_rng(1).uniform(-1, 1, (16, 48))
    expected = image.reshape(4, 4, 6, 8).mean(axis=(1, 3))[::-1]
    np.testing.assert_allclose(grid.frame(image.ravel().tolist()), expected.ravel(), atol=1e-12)


def nearest_mean(
    image: np.ndarray[Any, Any], contactors: Any, extent: Extent, points: int = 400
) -> list[float]:
    """Return the mean over the area nearest to each contactor, from many points of it."""
    x = extent.left + (np.arange(points) + 0.5) * (extent.right - extent.left) / points
    y = extent.top - (np.arange(points) + 0.5) * (extent.top - extent.bottom) / points
    place = np.stack(np.meshgrid(x, y), axis=-1)
    nearest = np.linalg.norm(place[:, :, None] - np.array(contactors), axis=-1).argmin(axis=-1)
    rows, columns = image.shape
    row = np.arange(points) * rows // points
    column = np.arange(points) * columns // points
    values = image[row[:, None], column[None]]
    return [float(values[nearest == k].mean()) for k in range(len(contactors))]


@pytest.mark.parametrize("size", [(3, 3), (16, 48), (7, 5)])
@pytest.mark.parametrize("contactors", [SQUARE, HEXAGONAL, ((0.0, 0.0), (5e-3, 1e-3))])
def test_each_contactor_gets_the_mean_over_the_area_that_is_nearest_to_it(
    contactors: Any, size: tuple[int, int]
) -> None:
    """A sum over 160 000 points of the area, which knows no polygon, gives nearly the same.

    Points are apart by 1/400 of a side, so that those along the edge of an area of a third of it,
    and of a taxel of it, may be some 0.01 of its points.
    """
    image = np.random.default_rng(2).uniform(-1, 1, size)
    grid = to_grid(size, contactors, None)
    expected = nearest_mean(image, contactors, default_extent(contactors))
    np.testing.assert_allclose(grid.frame(image.ravel().tolist()), expected, atol=0.02)


def test_a_contactor_beyond_the_grid_gets_nothing() -> None:
    grid = TaxelGrid(2, 2, ((0.0, 0.0), (10e-3, 0.0)), Extent(-1e-3, -1e-3, 1e-3, 1e-3))
    assert grid.frame([1.0, 1.0, 1.0, 1.0]) == pytest.approx([1.0, 0.0])


def test_a_display_of_one_contactor_has_a_grid_too() -> None:
    assert to_grid((2, 3), ((0.0, 0.0),), None).frame([0.0, 0.3, 0.3, 0.6, 0.6, 0.0]) == (
        pytest.approx([0.3])
    )


@given(
    st.lists(st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)), min_size=1, max_size=8),
    st.integers(1, 9),
    st.integers(1, 9),
)
def test_a_uniform_image_is_uniform_on_any_array(
    contactors: list[tuple[float, float]], rows: int, columns: int
) -> None:
    """The weights of a contactor that has an area of its own add up to 1, and none is negative."""
    grid = TaxelGrid(rows, columns, contactors, Extent(-0.02, -0.02, 0.02, 0.02))
    for weights, value in zip(grid.weights, grid.frame([1.0] * rows * columns), strict=True):
        assert all(0 <= weight <= 1 + 1e-9 for _, weight in weights)
        assert value == pytest.approx(1.0 if weights else 0.0)
