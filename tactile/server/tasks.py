"""Background tasks whose failure is logged and acted upon, never left in silence."""

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import TypeVar

log = logging.getLogger("tactile.server")
T = TypeVar("T")


def watched(
    task: asyncio.Task[T], on_failure: Callable[[BaseException], object] | None = None
) -> asyncio.Task[T]:
    """Return the task, which is watched from now on: an exception that ends it is logged.

    A cancellation is no failure.

    Parameters
    ----------
    task : what runs in the background
    on_failure : called once with the exception, after it was logged
    """
    task.add_done_callback(partial(_judge, on_failure))
    return task


def _judge(
    on_failure: Callable[[BaseException], object] | None, task: asyncio.Task[object]
) -> None:
    error = None if task.cancelled() else task.exception()
    if error is None:
        return
    log.error("a background task failed", exc_info=error, extra={"fields": {"task": str(task)}})
    if on_failure is not None:
        on_failure(error)
