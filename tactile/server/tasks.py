"""Background tasks whose failures are logged and acted upon."""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any, TypeVar

log = logging.getLogger("tactile.server")
T = TypeVar("T")


def start_task(
    work: Coroutine[Any, Any, T],
    on_failure: Callable[[BaseException], object] | None = None,
    *,
    among: set[asyncio.Task[T]] | None = None,
) -> asyncio.Task[T]:
    """Start a task in the background; an exception that ends it is logged.

    A cancellation is not a failure.

    Parameters
    ----------
    work : coroutine
        What the task runs.
    on_failure : callable, optional
        Function that is called once with the exception, after it was logged.
    among : set of asyncio.Task, optional
        Set that holds the task until it ends.

    Returns
    -------
    asyncio.Task
        The task.
    """
    task = asyncio.create_task(work)
    task.add_done_callback(partial(_report_failure, on_failure))
    if among is not None:
        among.add(task)
        task.add_done_callback(among.discard)
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
