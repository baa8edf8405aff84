"""Reading of sessions: contacts, blocks and events as arrays, and the drive rendered again."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from tactile.bus.base import DriveBlock, DriveFrame
from tactile.playback.session_messages import SessionHeader
from tactile.playback.session_parts import SessionBlock, SessionPart, part_files
from tactile.playback.session_replay import render_session


@dataclass(frozen=True)
class Session:
    """Session that a server recorded, made by `load_session`.

    Attributes
    ----------
    folder : Path
        Folder of the session.
    header : SessionHeader
        What the session was played with.
    contacts : dict of str to (K,) array
        Contacts that playback used, of all clients: ``client``, ``time_s``, ``arrival_s``, ``x_m``,
        ``y_m``, ``normal_force_n``, ``velocity_x_m_s`` and ``velocity_y_m_s``. A contact that was
        not valid is NaN, and so is a velocity that the client did not send.
    blocks : dict of str to (B,) array
        Blocks that were rendered: ``rendered_s``, ``due_s``, ``position`` [samples], ``skipped``.
    messages : list of dict
        What happened, such as an e-stop: ``time_s``, ``kind`` and ``detail``.
    """

    folder: Path
    header: SessionHeader
    contacts: dict[str, NDArray[np.generic]]
    blocks: dict[str, NDArray[np.generic]]
    messages: list[dict[str, Any]]

    def drives(self) -> Iterator[tuple[float, DriveBlock | DriveFrame]]:
        """Yield the drive, rendered again from the session as far as nothing is missing.

        Yields
        ------
        due_s : float
            Time for which the block was rendered, in the host's clock [s].
        drive : DriveBlock or DriveFrame
            Drive of all channels.

        Raises
        ------
        InputError
            If this version cannot render the session.
        """
        libraries, rendered = ThreadpoolController(), render_session(self.folder)
        while True:
            with libraries.limit(limits=1):  # as in the processes of the server
                what, drive = next(rendered, (None, None))
            if not isinstance(what, SessionBlock) or drive is None:
                return
            yield what.rendered_from.due, drive


def load_session(folder: str | Path) -> Session:
    """Load a session that a server recorded.

    Parameters
    ----------
    folder : str or Path
        Folder of the session.

    Returns
    -------
    Session
        Contacts, blocks and messages. All times are in the host's clock [s], which showed
        ``header.begun_s`` at the date ``header.begun_utc``.

    Raises
    ------
    NotFoundError
        If the folder holds no session.
    InputError
        If a part is missing or cannot be read.
    """
    folder = Path(folder)
    parts = [SessionPart(path) for path in part_files(folder)]
    return Session(
        folder,
        parts[0].header,
        _joined([part.contacts() for part in parts]),
        _joined([part.blocks() for part in parts]),
        [message for part in parts for message in part.messages],
    )


def _joined(tables: list[dict[str, NDArray[np.generic]]]) -> dict[str, NDArray[np.generic]]:
    """Return tables one below the other."""
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
