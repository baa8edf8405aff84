"""Playback loop of one display: it renders each block as late as possible.

Each block is rendered for the time at which it will be put out, from the finger's position
predicted for that time, as late as the bus allows. The loop is a `Mixer`, which renders the block
from a `BlockInput` with all that depends on time or chance.

The loop never raises because of what it receives and never waits for a sender; what it could not do
is counted. After a delay it continues with the block that is due by then, and fades in.
"""

import math
from collections.abc import Callable

from tactile.arrays import Floats
from tactile.bus.base import Bus, BusStatus, DriveBlock, DriveFrame
from tactile.clock import MONOTONIC, Clock
from tactile.display.display import Display
from tactile.errors import BusStateError
from tactile.playback.block_rendering import FramePlayback, SamplePlayback
from tactile.playback.block_ring import BlockRecord
from tactile.playback.commands import OnsetReport
from tactile.playback.finger_following import FingerFollowing
from tactile.playback.mixer import BlockInput, Mixer, MixerOrder
from tactile.playback.onset_reports import OnsetReports
from tactile.playback.outcome import share_put_out
from tactile.playback.session_ring import DUE_PLACES, SessionRing
from tactile.playback.shared_memory import (
    PlaybackCounters,
    PlaybackMemory,
    PlaybackReport,
    State,
)
from tactile.tracking.finger_sample import TIME_PLACES, FingerSample

MARGIN = 0.5e-3
"""Time for rendering a block before the bus wants it [s] (measured: 0.2 ms for 24 contactors)."""
LATENESS = 0.9
"""Delay from which on a block is skipped because it would be late, as a part of the bus's
``ahead``."""
HELD_UP = 20e-3
"""Delay from which on a block is skipped on a bus that is never late [s]."""
REPORTED = 5
"""Number of blocks from one report of shear and drive to the next."""
SMOOTHED = 0.02
"""Weight of a block's latency in the exponential mean."""


def state_of(status: BusStatus) -> State:
    """Return the state of playback: armed only while the amplifier is known to play.

    Parameters
    ----------
    status : BusStatus
        Status of the bus.

    Returns
    -------
    State
        "disarmed", "armed" or "estopped".
    """
    if status.state == "estopped":
        return "estopped"
    return "armed" if status.playing else "disarmed"


class PlaybackLoop(Mixer):
    """Loop that plays one display on its bus.

    Parameters
    ----------
    display : Display
        Display to play.
    bus : Bus
        Bus of the display.
    memory : PlaybackMemory
        Memory shared with the server.
    gain : float
        Gain of the display, on top of that of each client.
    worn : bool
        Whether the finger stays on the display although it touches nothing.
    clock : Clock
        Clock of the host, in which blocks are due.
    session : SessionRing or None
        Ring that receives all that is rendered from; None without a recorder.
    following : FingerFollowing or None
        What follows the finger, on a bus that takes samples; None for the display's own finger.
    played : callable, optional
        Function that returns the shear (S, N) of the skin since its last call [m], which only a
        simulated display knows.

    Attributes
    ----------
    bus : Bus
        Bus of the display.
    memory : PlaybackMemory
        Memory shared with the server.
    clock : Clock
        Clock of the host, in which blocks are due.
    position : int
        Position of the next block [samples].
    report : PlaybackReport
        Report to the server.
    following : FingerFollowing or None
        What follows the finger.
    onset_reports : OnsetReports
        Reports on stimuli that were to begin at a time.
    """

    def __init__(
        self,
        display: Display,
        bus: Bus,
        memory: PlaybackMemory,
        *,
        gain: float = 1.0,
        worn: bool = False,
        clock: Clock = MONOTONIC,
        session: SessionRing | None = None,
        following: FingerFollowing | None = None,
        played: Callable[[], Floats] | None = None,
    ) -> None:
        rate = bus.wiring.sample_rate
        inverse = None if following is None else following.follower
        super().__init__(display, rate, bus.frames, gain=gain, worn=worn, inverse=inverse)
        self.bus, self.memory, self.clock, self.following = bus, memory, clock, following
        self._session, self._played = session, played
        self.onset_reports = OnsetReports(bus)
        self.report = PlaybackReport(sample_rate=rate)
        self.position = self._skipped = 0
        self._unplayed_before = 0
        """Number of samples that had not been put out when playing began."""

    def arm(self) -> None:
        """Start the bus, at 0 V and in silence: no earlier wave continues.

        Raises
        ------
        BusError
            If the amplifier does not start.
        """
        self.bus.stop()
        self.onset_reports.settle(self.clock.now(), self._pass_onsets_on())
        if isinstance(self.rendering, FramePlayback):
            self.bus.tune(self.rendering.carriers)
        if self.following is not None:
            self.following.restart()
            self._leave_travel(self.following)
        self.silence()
        if self._session is not None:
            self._session.add_silence()
        self.position, self._unplayed_before = 0, self._unplayed
        self.bus.start()
        self.write_report()

    def disarm(self) -> None:
        """Fade out and stop the bus."""
        self.bus.stop()
        self.write_report()

    def execute(self, number: int, order: MixerOrder) -> tuple[float, ...]:
        """Execute an order of the server.

        Parameters
        ----------
        number : int
            Number of the order.
        order : MixerOrder
            Order to execute.

        Returns
        -------
        tuple of float
            Result of the order.
        """
        if self._session is not None:
            self._session.add_order(number)
        return self.apply(order)

    # The loop

    @property
    def running(self) -> bool:
        """Whether there are blocks to play."""
        return self.bus.state == "running"

    def write_time(self, position: int) -> float:
        """Return the time at which the bus wants a block.

        Parameters
        ----------
        position : int
            Position of the block [samples].

        Returns
        -------
        float
            Time in the host's clock [s].
        """
        return self.bus.due(position) - self.bus.ahead

    def wait(self) -> None:
        """Wait until it is time to render the next block."""
        self.clock.sleep(self.write_time(self.position) - MARGIN - self.clock.now())

    def step(self) -> None:
        """Wait until it is time for a block, render it and play it."""
        self.wait()
        now = round(self.clock.now(), TIME_PLACES)
        if not self.running:
            return
        skipped = self._catch_up(now)
        contacts = self._take_contacts()
        position = self.position
        self.position += self.rendering.spacing
        due = round(self.bus.due(position + self.rendering.timed), DUE_PLACES)
        block = BlockInput(self.report.blocks, position, skipped, now, due, contacts)
        known = len(self.onsets)
        drive = self.render(block)
        for onset in self.onsets[known:]:
            if onset.marker and onset.position is not None:
                self.bus.mark(onset.position, onset.marker)
        try:
            if isinstance(drive, DriveBlock):
                self.bus.write(drive)
                self._follow(drive)
            else:
                self.bus.write_frame(drive)
        except BusStateError:
            if self.running:
                raise
            return  # an e-stop or a fault came since the state was read: nothing to play
        finally:  # what was not played either, since the next block continues it
            if self._session is not None:
                self._session.add_block(block, drive)
        self._share(block, drive)
        self._report_block(block)

    def report_onsets(self) -> list[OnsetReport]:
        """Return what has become known of stimuli that were to begin at a time.

        Returns
        -------
        list of OnsetReport
            Reports since the last call.
        """
        now, running = self.clock.now(), self.running
        if not running:
            self.drop_scheduled()
        if self.onsets or self.onset_reports.waiting:
            self.onset_reports.look(now, self._pass_onsets_on(), running=running)
        return self.onset_reports.take()

    def _pass_onsets_on(self) -> int:
        """Pass stimuli on to their reports; return the number of samples not put out so far."""
        unplayed = self._unplayed
        for onset in self.onsets:
            self.onset_reports.add(onset, unplayed)
        self.onsets.clear()
        return unplayed

    def _follow(self, drive: DriveBlock) -> None:
        """Let the filters follow what has been measured by now, after a block was written."""
        if self.following is not None:
            self.following.wrote(drive.position, drive.volts[:, self.display.channel])
            self._leave_travel(self.following)

    def _leave_travel(self, following: FingerFollowing) -> None:
        """Let the limiter bound the travel of those contactors that no guard watches now."""
        if isinstance(self.rendering, SamplePlayback):
            self.rendering.leave_travel(following.watched)

    def _catch_up(self, now: float) -> bool:
        """Continue with the block that is due now, if the loop was delayed; return whether."""
        late = now - self.write_time(self.position)
        if late <= (LATENESS * self.bus.ahead or HELD_UP):
            return False
        spacing = self.rendering.spacing
        count = math.ceil(late * self._rate / spacing) * spacing
        self.position += count
        self._skipped += count
        return True

    def _take_contacts(self) -> tuple[tuple[int, FingerSample], ...]:
        """Return the contacts that arrived since the last block."""
        return tuple(self.memory.contacts())

    def _share(self, block: BlockInput, drive: DriveBlock | DriveFrame) -> None:
        """Add a block that was handed to the bus to the rings from which the server reads it."""
        memory, rendering = self.memory, self.rendering
        first = memory.blocks.count * rendering.spacing
        if isinstance(rendering, SamplePlayback) and isinstance(drive, DriveBlock):
            first = memory.commanded.count
            memory.commanded.add(rendering.trace)
            memory.driven.add(drive.volts[:, self.display.channel], first)
        if self._played is not None:
            memory.played.add(self._played())
        due, uncertainty = self.bus.due(block.position), self.bus.due_uncertainty(block.position)
        (x, y), (vx, vy) = self.place[-1].tolist(), self.tracker.velocity.tolist()
        memory.blocks.add(
            BlockRecord(
                first, due, uncertainty, float(rendering.times(block.due)[-1]), (x, y), (vx, vy),
                float(self.force[-1]), self.tracker.touching,
            )
        )  # fmt: skip

    def _report_block(self, block: BlockInput) -> None:
        """Update the report after a block was played, and write it now and then."""
        report = self.report
        # A contact waits for half a block on average before it is taken.
        wait = self.rendering.spacing / (2 * self._rate)
        latency = self.bus.due(block.position + self.rendering.first) - block.now + wait
        before = latency if math.isnan(report.latency) else report.latency
        report.latency = before + SMOOTHED * (latency - before)
        report.blocks += 1
        report.position = float(self.place[-1, 0]), float(self.place[-1, 1])
        report.normal_force = float(self.force[-1])
        if report.blocks % REPORTED == 0:
            self.write_report()

    @property
    def _unplayed(self) -> int:
        """Number of samples that were not put out since the bus was opened.

        A bus that takes frames counts frames, and none for a position that was left out.
        """
        if self.bus.frames is None:
            return self.bus.unplayed
        return self.bus.unplayed * self.rendering.spacing + self._skipped

    def write_report(self) -> None:
        """Write the state of playback to the shared memory."""
        r, status = self.report, self.bus.status
        r.time = self.clock.now()
        r.state = state_of(status)
        r.link, r.detail, r.running = status.link, status.detail, self.running
        r.latency = r.latency if self.running else math.nan
        r.touching, r.client = self.tracker.touching, self._client
        r.put_out_share = share_put_out(self.position, self._unplayed - self._unplayed_before)
        r.velocity = float(self.tracker.velocity[0]), float(self.tracker.velocity[1])
        following = self.following
        r.finger = following.finger if following is not None and self.running else None
        followed = {} if following is None else following.counters
        r.counters = vars(
            PlaybackCounters(
                **self.bus.counters.common(),
                **followed,
                limited_samples=self.rendering.limited,
                lost_contacts=self.memory.lost_contacts,
                skipped_samples=self._skipped,
                dropped_waves=self.dropped_waves,
                dropped_frames=self.dropped_frames,
                frame_gaps=self.frame_gaps,
                late_contacts=self.tracker.late,
                invalid_contacts=self.tracker.invalid,
            )
        )
        self.memory.write_report(r)
        rendering = self.rendering if self.running else None  # else the last block is not played
        self.memory.shear[:] = 0.0 if rendering is None else rendering.shear
        self.memory.drive[:] = 0.0 if rendering is None else rendering.drive
