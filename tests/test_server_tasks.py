"""Background tasks of the server: one that fails is logged and acted upon."""

import asyncio
import logging

import pytest

from tactile.server.tasks import start_task


async def fail() -> None:
    raise ZeroDivisionError("on purpose")


async def test_a_task_that_fails_is_logged_and_acted_upon_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    failures: list[BaseException] = []
    await asyncio.wait({start_task(fail(), failures.append)})
    await asyncio.wait({start_task(fail())})
    assert [type(error) for error in failures] == [ZeroDivisionError]
    logged = [record for record in caplog.records if record.levelno == logging.ERROR]
    assert len(logged) == 2
    assert all(record.exc_info and "on purpose" in str(record.exc_info[1]) for record in logged)


async def test_a_task_that_ends_or_is_cancelled_did_not_fail(
    caplog: pytest.LogCaptureFixture,
) -> None:
    failures: list[BaseException] = []
    ends = start_task(asyncio.sleep(0, "value"), failures.append)
    waits = start_task(asyncio.Event().wait(), failures.append)
    assert await ends == "value"
    waits.cancel()
    await asyncio.wait({waits})
    assert failures == []
    assert caplog.records == []
