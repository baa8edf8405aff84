"""Replay of a session: its drive is rendered again from the session alone and compared."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from tactile.bus.base import DriveBlock, DriveFrame, FrameCapability
from tactile.display.display import Display, display_of
from tactile.errors import InputError
from tactile.playback.commands import KeepTexture
from tactile.playback.mixer import Mixer
from tactile.playback.origin import other_versions
from tactile.playback.session_messages import SessionHeader
from tactile.playback.session_orders import SessionOrder, TextureDescription, decoded, realized
from tactile.playback.session_parts import (
    DIGEST_BITS,
    SessionBlock,
    SessionEvent,
    SessionPart,
    part_files,
)
from tactile.playback.session_ring import Kind, next_digest
from tactile.texture.surface import texture_of


@dataclass
class SessionReplay:
    """Comparison of the drive of a session with the same drive rendered again.

    Attributes
    ----------
    session : str
        Folder of the session.
    compared_blocks : int
        Number of blocks that were compared.
    duration_s : float
        Time from the first block to the last [s].
    first_block : int or None
        Index of the first block that differs, from 0; None if none does.
    first_time_s : float or None
        Time of that block since the first block [s].
    missing : str
        What the recorder missed, such as "12 records"; what follows was not compared. Empty if
        nothing is missing.
    other_versions : dict of str to (str, str)
        Versions at the time of the recording and now, where they differ.
    """

    session: str
    compared_blocks: int = 0
    duration_s: float = 0.0
    first_block: int | None = None
    first_time_s: float | None = None
    missing: str = ""
    other_versions: dict[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def is_identical(self) -> bool:
        """Whether the whole session was compared and nothing differs."""
        return self.first_block is None and not self.missing

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as plain data.

        Returns
        -------
        dict of str to object
            Fields by name, and ``is_identical``.
        """
        return asdict(self) | {"is_identical": self.is_identical}


class _Player:
    """Mixer of a session, and the orders that have been read."""

    def __init__(self, folder: Path, header: SessionHeader) -> None:
        how = self._how = header.how
        display = display_of(header.display, folder)
        limits = replace(display.limits, voltage=header.voltage_limit_v)
        self._display: Display = replace(display, limits=limits)
        frames = FrameCapability(how.carriers, how.frame_rate) if how.carriers else None
        self.mixer = Mixer(
            self._display, how.sample_rate, frames, gain=header.gain, worn=header.worn
        )
        self._folder = folder
        self._orders: dict[int, SessionOrder] = {}

    def read(self, part: SessionPart) -> None:
        """Take the orders of a part."""
        self._orders.update(map(decoded, part.orders))

    def execute(self, number: int) -> bool:
        """Execute an order as playback did; return False if it is missing."""
        order = self._orders.pop(number, None)
        if order is None:
            return False
        if isinstance(order, TextureDescription):
            texture = texture_of(order.source, self._folder)
            prepared = realized(self._display, texture, order.seed, self._how, gain=order.gain)
            self.mixer.apply(KeepTexture(order.number, prepared))
        else:
            with suppress(Exception):  # playback answered it with the error, and played on
                self.mixer.apply(order)
        return True


def render_session(
    folder: Path, progress: Callable[[int, int], object] | None = None
) -> Iterator[tuple[SessionBlock | SessionEvent, DriveBlock | DriveFrame | None]]:
    """Yield the blocks of a session, rendered again.

    Parameters
    ----------
    folder : Path
        Folder of the session.
    progress : callable, optional
        Function that is called with the number of parts that were rendered, and of all parts.

    Yields
    ------
    what : SessionBlock or SessionEvent
        Block, or the last event if it is one after which nothing can be rendered, since records or
        the order itself were lost.
    drive : DriveBlock or DriveFrame or None
        Drive of the block; None for an event.

    Raises
    ------
    NotFoundError, InputError
        If the session cannot be read, or holds something that this version cannot render.
    """
    files = part_files(folder)
    following: SessionPart | None = SessionPart(files[0])
    assert following is not None
    player = _Player(folder, following.header)
    player.read(following)
    for done in range(len(files)):
        part, following = following, None
        if done + 1 < len(files):
            following = SessionPart(files[done + 1])
            player.read(following)  # an order may be recorded shortly after its execution
        assert part is not None
        for what in part:
            if isinstance(what, SessionBlock):
                yield what, player.mixer.render(what.rendered_from)
            elif what.kind is Kind.SILENCE:
                player.mixer.silence()
            elif what.kind is not Kind.ORDER or not player.execute(what.number):
                yield what, None
                return
        if progress is not None:
            progress(done + 1, len(files))


def replay_session(
    folder: str | Path, progress: Callable[[int, int], object] | None = None
) -> SessionReplay:
    """Render the drive of a session again, from the session alone, and compare it.

    Parameters
    ----------
    folder : str or Path
        Folder of the session.
    progress : callable, optional
        Function that is called with the number of parts that were compared, and of all parts.

    Returns
    -------
    SessionReplay
        Result of the comparison, which ends at the first block that differs. On the machine of the
        session, with the same versions, nothing differs.

    Raises
    ------
    NotFoundError, InputError
        If the session cannot be read, or holds something that this version cannot render.
    """
    result = SessionReplay(str(folder))
    try:
        with threadpool_limits(1):  # as in the processes of the server
            _compare(result, Path(folder), progress)
    except InputError as error:
        if str(error).startswith(str(folder)):
            raise
        raise InputError(f"{folder}: cannot be replayed: {error}") from error
    result.other_versions = other_versions(SessionPart(part_files(Path(folder))[0]).header.versions)
    return result


def _compare(
    result: SessionReplay, folder: Path, progress: Callable[[int, int], object] | None
) -> None:
    """Render a session until the first difference, or until records are lost."""
    digest, begun = 0, None
    for what, drive in render_session(folder, progress):
        if isinstance(what, SessionEvent):
            is_order = what.kind is Kind.ORDER
            result.missing = f"order {what.number}" if is_order else f"{what.number} records"
            return
        assert drive is not None
        begun = what.rendered_from.now if begun is None else begun
        result.duration_s = what.rendered_from.now - begun
        digest = next_digest(digest, drive)
        if digest & DIGEST_BITS != what.digest:
            result.first_block, result.first_time_s = result.compared_blocks, result.duration_s
            return
        result.compared_blocks += 1
