"""Tests of textures that are prepared: turns of clients, their number, and what is dropped."""

import asyncio
import gc
import threading
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import pytest
from msgspec import structs
from server_rig import until
from virtual_loop import LoopProcess
from virtual_server import virtual_world

from tactile.display.display import load_display
from tactile.errors import BusError
from tactile.playback.commands import DeviceOpened
from tactile.rendering.surface_picture import SurfacePicture, SurfaceSection, draw_surface
from tactile.server import preparation_queue, preparing, texture_store
from tactile.server.children import Child
from tactile.server.preparation_queue import PreparationQueue
from tactile.server.preparing import Preparation
from tactile.server.texture_store import MOST_TEXTURES, TextureStore, TooManyPreparationsError
from tactile.texture.surface import Texture, load_with_source

HOW = DeviceOpened(sample_rate=8000.0)
OAK = "wood-oak"
SECTION = SurfaceSection(0.0, 0.0, 1e-3, 3, 2)
WRITER = "tactile.server.preparing:write"


class Bench:
    """A store with a queue of its own, and what playback would have been told."""

    def __init__(self) -> None:
        self.queue = PreparationQueue()
        self.kept: list[Preparation] = []
        self.dropped: list[int] = []
        self.selected: set[int] = set()
        self.ends: list[tuple[int, int]] = []
        self.store = TextureStore(
            load_display("reference-24"), self.queue, keep=self.kept.append,
            drop=self._drop, selected=lambda: self.selected, largest=False,
        )  # fmt: skip

    async def _drop(self, number: int) -> None:
        self.dropped.append(number)

    async def texture(self, client: int, seed: int, name: str = OAK) -> int:
        """Have a texture prepared, and note when it was."""
        number = await self.store.texture(client, (name, seed), HOW)
        self.ends.append((client, seed))
        return number

    async def picture(self, client: int, seed: int) -> None:
        """Have a surface drawn, and note when it was."""
        picture = await self.queue.draw(client, OAK, seed, SECTION)
        assert picture.pixels.shape == (SECTION.rows, SECTION.columns)
        self.ends.append((client, seed))


Story = Callable[[Bench], Coroutine[Any, Any, None]]


async def told(story: Story, unseen: list[Any]) -> None:
    """Run a story, and collect hidden failures, also of tasks that nothing waited for."""
    gc.freeze()  # else all that was there before is looked at
    bench = Bench()
    try:
        await story(bench)
    finally:
        await bench.queue.close()
    await asyncio.sleep(0)
    gc.collect()
    gc.unfreeze()
    assert unseen == []


def run(story: Story) -> None:
    """Run a story with a process that prepares textures on a virtual clock."""
    with virtual_world(lambda playback, volts: None) as world:
        world.server = LoopProcess(world.clock, world.errors)
        world.run(told(story, world.errors.all))
        world.server.end()


def run_beside_a_process(story: Story) -> None:
    """Run a story with a real process that prepares textures."""
    unseen: list[dict[str, Any]] = []

    async def whole() -> None:
        asyncio.get_running_loop().set_exception_handler(lambda _, what: unseen.append(what))
        await told(story, unseen)

    asyncio.run(whole())


def test_clients_take_turns() -> None:
    """Each has its first texture before any has its second, in the order in which they came."""

    async def story(bench: Bench) -> None:
        wishes = [(1, 0), (1, 1), (1, 2), (2, 10), (3, 20), (3, 21)]
        await asyncio.gather(*(bench.texture(client, seed) for client, seed in wishes))
        assert bench.ends == [(1, 0), (1, 1), (2, 10), (3, 20), (1, 2), (3, 21)], (
            "the first was begun when nobody else had come"
        )

    run(story)


def test_pictures_wait_for_textures_and_clients_take_turns_with_them() -> None:
    """A client that wants many pictures delays no texture by more than the one that is drawn."""

    async def story(bench: Bench) -> None:
        await asyncio.gather(
            *(bench.picture(client, seed) for client, seed in [(1, 0), (1, 1), (1, 2), (2, 10)]),
            bench.texture(1, 3),
            bench.texture(3, 20),
        )
        assert bench.ends == [(1, 0), (1, 3), (3, 20), (1, 1), (2, 10), (1, 2)]

    run(story)


def test_a_small_picture_is_drawn_once_until_its_texture_changes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Large pictures and other sections are drawn each time."""
    drawn: list[SurfaceSection] = []

    def noted(texture: Texture, section: SurfaceSection, *, seed: int) -> SurfacePicture:
        drawn.append(section)
        return draw_surface(texture, section, seed=seed)

    monkeypatch.setattr(preparing, "draw_surface", noted)
    preparing.KEPT.clear()
    large = SurfaceSection(0.0, 0.0, 1e-3, 65, 64)
    requests = [preparing.DrawingRequest(k, OAK, 0, s) for k, s in enumerate([SECTION, large])]
    first = [preparing.draw(request) for request in requests]
    again = [preparing.draw(request) for request in requests]
    assert drawn == [SECTION, large, large]
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.pixels, other.pixels)
    texture, source = load_with_source(OAK)
    changed = structs.replace(source, text=source.text + "\n# changed")
    monkeypatch.setattr(preparing, "load_with_source", lambda name: (texture, changed))
    preparing.draw(requests[0])
    assert drawn == [SECTION, large, large, SECTION]
    assert len(preparing.KEPT) == 2
    monkeypatch.setattr(preparing, "MOST_KEPT", 2)
    preparing.draw(preparing.DrawingRequest(9, OAK, 5, SECTION))
    assert len(preparing.KEPT) == 2
    preparing.KEPT.clear()


def test_a_picture_that_nobody_waits_for_is_not_drawn() -> None:
    async def story(bench: Bench) -> None:
        tasks = [asyncio.create_task(bench.picture(1, seed)) for seed in range(3)]
        await asyncio.sleep(0)
        tasks[1].cancel()
        await tasks[2]
        assert bench.ends == [(1, 0), (1, 2)]

    run(story)


def test_a_texture_that_cannot_be_drawn_fails() -> None:
    async def story(bench: Bench) -> None:
        with pytest.raises(BusError, match="nothing-such"):
            await bench.queue.draw(1, "nothing-such", 0, SECTION)

    run(story)


def test_what_a_client_that_left_waits_for_is_not_made() -> None:
    """A hundred textures of clients that hung up wait; a new one waits for one of them."""

    async def story(bench: Bench) -> None:
        waiting = [asyncio.create_task(bench.texture(client, client)) for client in range(1, 101)]
        await asyncio.sleep(0)
        for client in range(1, 101):
            bench.store.leave(client)
        assert await bench.texture(200, 7) > 100
        failures = await asyncio.gather(*waiting, return_exceptions=True)
        assert all(isinstance(failure, BusError) for failure in failures)
        assert bench.ends == [(200, 7)]
        assert len(bench.kept) == 1

    run(story)


def test_what_another_one_waits_for_too_is_made() -> None:
    async def story(bench: Bench) -> None:
        blocker = asyncio.create_task(bench.texture(9, 1))
        await asyncio.sleep(0)
        tasks = [asyncio.create_task(bench.texture(client, 0)) for client in (1, 2)]
        await asyncio.sleep(0)
        bench.store.leave(1)
        left, stays = await asyncio.gather(*tasks, return_exceptions=True)
        assert isinstance(left, BusError)
        assert stays == 2
        await blocker

    run(story)


def test_who_comes_for_what_was_given_up_has_it_made() -> None:
    async def story(bench: Bench) -> None:
        blocker = asyncio.create_task(bench.texture(9, 1))
        first = asyncio.create_task(bench.texture(1, 0))
        await asyncio.sleep(0)
        bench.store.leave(1)
        assert await bench.texture(2, 0) == 3
        assert isinstance((await asyncio.gather(first, return_exceptions=True))[0], BusError)
        await blocker
        assert set(bench.store.ready) == {(OAK, 0), (OAK, 1)}

    run(story)


def test_a_client_waits_for_so_many_at_a_time_and_for_more_when_they_are_ready() -> None:
    async def story(bench: Bench) -> None:
        tasks = [asyncio.create_task(bench.texture(1, k)) for k in range(4)]  # as it may select
        await asyncio.sleep(0)
        with pytest.raises(
            TooManyPreparationsError, match="4 textures of this client are being prepared"
        ):
            await bench.texture(1, 4)
        other = asyncio.create_task(bench.texture(2, 4))
        await asyncio.gather(*tasks, other)
        await bench.texture(1, 5)

    run(story)


def test_above_the_cap_of_memory_it_is_refused_and_nothing_goes_that_is_selected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three textures of 42 MiB each fit in 130 MiB."""
    monkeypatch.setattr(texture_store, "LARGEST_TEXTURES", 130)

    async def story(bench: Bench) -> None:
        bench.selected |= {await bench.texture(1, seed) for seed in range(2)}
        spare = await bench.texture(1, 2)
        bench.selected.add(await bench.texture(1, 3))
        assert bench.dropped == [spare]
        with pytest.raises(BusError, match=r"more than 130 MiB .* deselect others first") as told:
            await bench.texture(1, 4)
        assert "\n" not in str(told.value)
        assert bench.dropped == [spare]
        assert [key[1] for key in bench.store.ready] == [0, 1, 3]
        bench.selected.clear()
        with bench.store.held() as held:
            held.add(1)
            await bench.texture(1, 4)
        assert bench.dropped == [spare, 2], "what is about to be selected stays too"

    run_beside_a_process(story)


def test_so_many_stay_ready_that_nobody_has_selected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(texture_store, "MOST_TEXTURES", 3)
    assert MOST_TEXTURES > 3

    async def story(bench: Bench) -> None:
        for seed in (0, 1, 2, 0, 3):
            await bench.texture(1, seed)
        assert bench.dropped == [2], "the one that nobody had come for since"
        assert [key[1] for key in bench.store.ready] == [2, 0, 3]

    run(story)


def test_a_failure_is_told_and_nobody_need_hear_it() -> None:
    async def story(bench: Bench) -> None:
        with pytest.raises(BusError, match="nothing-such"):
            await bench.texture(1, 0, "nothing-such")
        task = asyncio.create_task(bench.texture(1, 0, "nothing-such"))
        await asyncio.sleep(0)
        task.cancel()
        await bench.texture(2, 0)

    run(story)


def test_a_texture_that_takes_too_long_ends_its_process_and_the_next_has_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The first process never hears of what it is to prepare."""
    monkeypatch.setattr(preparation_queue, "LONGEST", 0.0)
    told: list[Child] = []
    monkeypatch.setattr(Child, "send", lambda child, order: told.append(child))

    async def story(bench: Bench) -> None:
        with pytest.raises(BusError, match="was not prepared within 0 s"):
            await bench.texture(1, 0)
        (hung,) = told
        assert not hung.alive
        monkeypatch.undo()
        assert await bench.texture(1, 0) == 2

    run_beside_a_process(story)


@pytest.mark.parametrize("reaped", [True, False])
def test_a_process_that_dies_fails_what_it_makes_and_no_more(
    monkeypatch: pytest.MonkeyPatch, *, reaped: bool
) -> None:
    """The pipes of the process end before the system reports its death; nothing of it is left."""
    if not reaped:
        monkeypatch.setattr(Child, "alive", True)

    async def story(bench: Bench) -> None:
        tasks = [asyncio.create_task(bench.texture(client, client)) for client in (1, 2)]
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert bench.queue._child is not None
        bench.queue._child._process.kill()
        first, second = await asyncio.gather(*tasks, return_exceptions=True)
        assert isinstance(first, BusError)
        assert second == 2
        await until(lambda: [one.name for one in threading.enumerate()].count(WRITER) == 1)

    run_beside_a_process(story)
