"""Folders in which a server keeps its state and its sockets, and in which programs find them."""

import os
import sys
import warnings
from contextlib import suppress
from pathlib import Path

import platformdirs

APP = "tactile"
"""Name of the application in paths."""
API_SOCKET = "tactile.sock"
"""File name in the runtime folder of the socket on which the server serves its API."""
SYSTEM_FOLDER = Path("/run") / APP
"""Runtime folder of the server that the system starts for all users of the host."""


def runtime_folder() -> Path:
    """Return the folder of this process's sockets; it need not exist yet.

    It is ``$RUNTIME_DIRECTORY`` if systemd started the process, else the runtime folder of the
    user.

    Returns
    -------
    Path
        Runtime folder.

    Raises
    ------
    PermissionError
        If the folder would belong to another user.
    """
    if folder := _systemd_folder("RUNTIME_DIRECTORY"):
        return folder
    with warnings.catch_warnings():  # a session without XDG_RUNTIME_DIR is normal
        warnings.simplefilter("ignore")
        return Path(platformdirs.user_runtime_dir(APP))


def state_folder() -> Path:
    """Return the folder of data that outlives this process; it need not exist yet.

    It is ``$STATE_DIRECTORY`` if systemd started the process, else the state folder of the user.

    Returns
    -------
    Path
        State folder.
    """
    return _systemd_folder("STATE_DIRECTORY") or Path(platformdirs.user_state_dir(APP))


def _systemd_folder(variable: str) -> Path | None:
    """Return the first folder that systemd names in an environment variable."""
    first = os.environ.get(variable, "").split(":")[0]
    return Path(first) if first else None


def find_sockets(name: str = API_SOCKET) -> list[Path]:
    """List the sockets of a name to which this user may connect, the user's own first.

    A socket in a folder that belongs to another user is left out, except in the system's folder:
    otherwise whoever is first to create a shared folder could pose as the server.

    Parameters
    ----------
    name : str
        File name of the socket.

    Returns
    -------
    list of Path
        Sockets that exist and are writable; empty on systems other than Linux.
    """
    if sys.platform != "linux":
        return []
    folders = [SYSTEM_FOLDER]
    try:
        own = runtime_folder()
        if own != SYSTEM_FOLDER and own.lstat().st_uid == os.geteuid():
            folders.insert(0, own)
    except OSError:  # the folder belongs to another user or does not exist
        pass
    return [folder / name for folder in folders if _is_open(folder / name)]


def _is_open(path: Path) -> bool:
    """Return whether a path is a socket to which this user may connect."""
    try:
        return path.is_socket() and os.access(path, os.W_OK)
    except OSError:
        return False


def estop_sockets() -> list[Path]:
    """List the e-stop sockets of all servers of this host that this user can see.

    A datagram to somebody who poses as a server does no harm, so that sockets of all owners are
    included.

    Returns
    -------
    list of Path
        E-stop sockets.
    """
    folders = {SYSTEM_FOLDER}
    with suppress(OSError):
        folders.add(runtime_folder())
    if sys.platform != "win32" and os.geteuid() == 0:
        folders.update(Path("/run/user").glob(f"*/{APP}"))
    sockets = []
    for folder in sorted(folders):
        with suppress(OSError):
            sockets += sorted(folder.glob("estop-*.sock"))
    return sockets
