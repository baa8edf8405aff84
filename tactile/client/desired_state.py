"""State of displays that outlasts a connection: what the program wants, and e-stops."""

from dataclasses import dataclass

from tactile.messages import (
    Answer,
    ArmDisplay,
    DisplayRequest,
    Done,
    EStop,
    EventMessage,
    Failure,
    Request,
    Resume,
    Select,
    SetGain,
    StatsReply,
    StopPlaying,
    Welcome,
)  # fmt: skip


@dataclass
class DesiredState:
    """State that a program wants one display to have, as far as the server confirmed them.

    Attributes
    ----------
    layers : Select or None
        Last choice of textures.
    gain : SetGain or None
        Last gain.
    stop : StopPlaying or None
        Last stop, unless the program resumed since.
    armed : ArmDisplay or None
        Request that armed the display, if it is to be armed again.
    arming : int
        Id of the `ArmDisplay` whose confirmation makes the display one to be armed again, or 0.
    """

    layers: Select | None = None
    gain: SetGain | None = None
    stop: StopPlaying | None = None
    armed: ArmDisplay | None = None
    arming: int = 0

    def confirm(self, command: DisplayRequest) -> None:
        """Remember a command that was done, unless it is an `ArmDisplay` that was withdrawn.

        Parameters
        ----------
        command : DisplayRequest
            Request that the server confirmed.
        """
        match command:
            case Select():
                self.layers = command
            case SetGain():
                self.gain = command
            case StopPlaying():
                self.stop = command
            case Resume():
                self.stop = None
            case ArmDisplay() if command.id == self.arming:
                self.armed = command

    def disarm(self) -> None:
        """Forget that the display was to be armed, even if the answer is still to come."""
        self.armed, self.arming = None, 0

    def restored(self, rearm: bool) -> list[Request]:
        """Return the requests that restore the state after a reconnection.

        Parameters
        ----------
        rearm : bool
            Whether the display may be armed again.

        Returns
        -------
        list of Request
            Requests, of which the one for high voltage comes last.
        """
        commands = [self.gain, self.layers, self.stop, self.armed if rearm else None]
        return [command for command in commands if command is not None]


class EStops:
    """E-stops that the server has not confirmed yet, and the numbers of those that hold.

    Attributes
    ----------
    numbers : dict of str to int
        Number of the e-stop that holds by display, as it was last reported; 0 for none.
    missed : set of str
        Displays that were e-stopped, and perhaps cleared, while there was no connection.
    """

    def __init__(self) -> None:
        self.numbers: dict[str, int] = {}
        self.missed: set[str] = set()
        self._latest: dict[str, int] = {}  # number of the latest e-stop, also if cleared
        self._pending: dict[str | None, int] = {}  # id of the newest request, 0 for none

    def request(self, display: str | None, number: int = 0) -> None:
        """Keep an e-stop until it is confirmed.

        Parameters
        ----------
        display : str or None
            Name of the display, None for all.
        number : int
            Id of its newest request, 0 if it was not sent.
        """
        self._pending[display] = number

    def disconnect(self) -> None:
        """Take all e-stops that were not confirmed as not sent."""
        self._pending = dict.fromkeys(self._pending, 0)

    def unsent(self) -> list[EStop]:
        """Return the e-stops that are to be sent first over a new connection.

        Returns
        -------
        list of EStop
            One for each that is neither confirmed nor under way.
        """
        return [EStop(display=display) for display, number in self._pending.items() if not number]

    def report(self, answer: Answer) -> None:
        """Take what an answer says about e-stops; an e-stop that was refused is kept.

        Parameters
        ----------
        answer : Answer
            Message of the server.
        """
        match answer:
            case Welcome():
                latest = {info.name: info.latest_estop for info in answer.displays}
                known = latest | self._latest
                self.missed = {name for name, number in latest.items() if number != known[name]}
                self._latest = latest
                self.numbers = {info.name: info.estop for info in answer.displays}
            case EventMessage(kind="estopped" | "cleared"):
                self.numbers[answer.display] = answer.estop if answer.kind == "estopped" else 0
                self._set_latest(answer.display, answer.estop)
            case StatsReply():
                self.numbers[answer.display] = answer.estop
                self._set_latest(answer.display, answer.estop)
            case Done():
                self.numbers.update(answer.estops)
                for display, number in answer.estops.items():
                    self._set_latest(display, number)
        if isinstance(answer, Done | Failure) and answer.id:
            self._resolve(answer)

    def _set_latest(self, display: str, number: int) -> None:
        self._latest[display] = max(number, self._latest.get(display, 0))

    def _resolve(self, reply: Done | Failure) -> None:
        for display, number in list(self._pending.items()):
            if number == reply.id:
                if isinstance(reply, Done) or reply.code == "unknown_display":
                    del self._pending[display]
                else:
                    self._pending[display] = 0
