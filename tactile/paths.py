"""Where a daemon keeps its state and its sockets, and where programs look for them."""

import os
import sys
import warnings
from contextlib import suppress
from pathlib import Path

import platformdirs

APP = "tactile"
API_SOCKET = "tactile.sock"
"""File in the runtime folder over which the daemon speaks its API."""
SYSTEM_FOLDER = Path("/run") / APP
"""Runtime folder of the daemon that the system starts, for all users of the machine."""


def runtime_folder() -> Path:
    """Return the folder of this process's sockets; it need not exist yet.

    It is ``$RUNTIME_DIRECTORY`` where systemd started the process, else the user's own.

    Raises
    ------
    PermissionError
        Where the folder would belong to another user.
    """
    if folder := _given("RUNTIME_DIRECTORY"):
        return folder
    with warnings.catch_warnings():  # a session without XDG_RUNTIME_DIR is nothing to warn of
        warnings.simplefilter("ignore")
        return Path(platformdirs.user_runtime_dir(APP))


def state_folder() -> Path:
    """Return the folder of what outlives this process; it need not exist yet.

    It is ``$STATE_DIRECTORY`` where systemd started the process, else the user's own.
    """
    return _given("STATE_DIRECTORY") or Path(platformdirs.user_state_dir(APP))


def _given(variable: str) -> Path | None:
    """Return the first folder that systemd names in a variable."""
    first = os.environ.get(variable, "").split(":")[0]
    return Path(first) if first else None


def find_sockets(name: str = API_SOCKET) -> list[Path]:
    """Return the sockets of that name that this user may connect to, the user's own first.

    A socket in a folder that belongs to another user is left out, unless the system made it:
    whoever gets to a shared folder first could otherwise pose as the daemon.
    """
    if sys.platform != "linux":
        return []
    folders = [SYSTEM_FOLDER]
    try:
        own = runtime_folder()
        if own != SYSTEM_FOLDER and own.lstat().st_uid == os.geteuid():
            folders.insert(0, own)
    except OSError:  # another user's, or not there
        pass
    return [folder / name for folder in folders if _is_open(folder / name)]


def _is_open(path: Path) -> bool:
    try:
        return path.is_socket() and os.access(path, os.W_OK)
    except OSError:
        return False


def estop_sockets() -> list[Path]:
    """Return the e-stop sockets of all daemons of this machine that this user can see.

    A datagram that goes to somebody who poses as a daemon does no harm, so nobody's is left out.
    """
    folders = {SYSTEM_FOLDER}
    with suppress(OSError):
        folders.add(runtime_folder())
    if sys.platform != "win32" and os.geteuid() == 0:
        folders.update(Path("/run/user").glob(f"*/{APP}"))
    found = []
    for folder in sorted(folders):
        with suppress(OSError):
            found += sorted(folder.glob("estop-*.sock"))
    return found
