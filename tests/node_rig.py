"""The JavaScript client in node, as it is compiled in the wheel, driven by lines of JavaScript."""

import asyncio
import json
import os
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from server_rig import PATIENCE

from tactile.server.page import FOLDER

EVALUATOR = Path(__file__).parent / "node_evaluator.mjs"


def miss(what: str) -> None:
    """Skip for want of a tool; where CI promises it, its absence is a failure."""
    if os.environ.get("CI") == "true":
        pytest.fail(what)
    pytest.skip(what)


def tool(name: str) -> str:
    """Return the path of a program, or skip without it."""
    path = shutil.which(name)
    if path is None:
        miss(f"no {name} on PATH")
    return str(path)


class NodeError(Exception):
    """What JavaScript threw.

    Parameters
    ----------
    name : str
        Name of the error.
    message : str
        Its message.
    code : str
        Code of a `RequestError`.
    """

    def __init__(self, name: str, message: str, code: str) -> None:
        super().__init__(f"{name}: {message}")
        self.name, self.message, self.code = name, message, code


class Node:
    """A process of node with the client."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def run(self, source: str, **values: Any) -> Any:
        """Run JavaScript and return what it returns; `values` are constants in it."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        constants = "".join(f"const {k} = {json.dumps(v)};" for k, v in values.items())
        self._process.stdin.write(json.dumps(constants + source).encode() + b"\n")
        line = await asyncio.wait_for(self._process.stdout.readline(), PATIENCE)
        outcome = json.loads(line)
        if "error" in outcome:
            raise NodeError(outcome["error"], outcome["message"], outcome["code"])
        return outcome["value"]


@asynccontextmanager
async def node(folder: Path) -> AsyncIterator[Node]:
    """Run node with a copy of the compiled client, which it takes for modules."""
    shutil.copytree(FOLDER / "client", folder / "client")
    (folder / "package.json").write_text('{"type": "module"}')
    process = await asyncio.create_subprocess_exec(
        tool("node"), str(EVALUATOR), str(folder), limit=2**24,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    try:
        yield Node(process)
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()
