"""Tests of the server's end of the e-stop process, which is started again after any fault."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from tactile.estop.latch import Latch
from tactile.server import estop_desk
from tactile.server.children import Child
from tactile.server.estop_desk import EstopDesk


async def test_a_process_that_cannot_be_started_is_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refused: list[str] = []

    def started(module: str, *words: Any) -> Child:
        if len(refused) < 2:
            refused.append(module)
            raise OSError(24, "Too many open files")
        return Child(module, *words)

    monkeypatch.setattr(estop_desk, "Child", started)
    monkeypatch.setattr(estop_desk, "RETRY", 0.0)
    latch = Latch.open("sim:", Path())
    desk = EstopDesk()
    await desk.start({"right": latch})
    async with asyncio.timeout(60):
        while not desk.address:
            await asyncio.sleep(0.01)
    assert len(refused) == 2
    await desk.close()
    assert not desk.address
    latch.close()
