"""Traces of the playback processes of a server that a benchmark runs."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import patch

from benchmarks.traced_playback import FILE
from tactile.server import playing as server_playing
from tactile.server.children import Child


@contextmanager
def traced(playback: ModuleType, path: Path) -> Iterator[None]:
    """Run a playback that writes a trace, in place of the one of `tactile.playback.process`.

    Parameters
    ----------
    playback : module
        Program of the playback process, which writes to the path in the environment variable
        `FILE`.
    path : Path
        File of the trace.

    Yields
    ------
    None
        While servers that are started play in this way.
    """

    def child(module: str, *rest: Any) -> Child:
        assert module == "tactile.playback.process"
        return Child(playback.__name__, *rest)

    with patch.object(server_playing, "Child", child), patch.dict(os.environ, {FILE: str(path)}):
        yield
