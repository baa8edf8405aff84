"""Background tasks whose failures are logged and acted upon."""

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
    """Watch a task, so that an exception that ends it is logged.

    A cancellation is not a failure.

    Parameters
    ----------
    task : asyncio.Task
        Task that runs in the background.
    on_failure : callable, optional
        Function that is called once with the exception, after it was logged.

    Returns
    -------
    asyncio.Task
        The same task.
    """
    task.add_done_callback(partial(_report_failure, on_failure))
    return task


def _report_failure(
    on_failure: Callable[[BaseException], object] | None, task: asyncio.Task[object]
) -> None:
    """Log the exception of a task that has ended, and pass it on."""
    error = None if task.cancelled() else task.exception()
    if error is None:
        return
    log.error("a background task failed", exc_info=error, extra={"fields": {"task": str(task)}})
    if on_failure is not None:
        on_failure(error)
