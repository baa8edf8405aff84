"""Refusals of the server, and the time for which nothing is sent to it then."""

from math import inf

RETRY = 1.0
"""Time after which frames are sent again that were refused for what is in them [s]. Assumed: as
often as the client reports a refusal."""
PASSING = ("invalid_field",)
"""Codes of refusals that need not come again, such as that of a time that was too far ahead."""
LASTING = ("unauthorized", "unknown_display", "unsupported")
"""Codes of refusals that would come again for each cycle."""


class Refusals:
    """Refusals of the server.

    Attributes
    ----------
    until : float
        Time until which nothing is sent; infinite until `forget` [s].
    """

    def __init__(self) -> None:
        self.until = -inf
        self._last: list[str] = []

    def take(self, detail: str, now: float) -> str:
        """Take a refusal, and return a line about it.

        Parameters
        ----------
        detail : str
            Code of the refusal, the field that it is about if there is one, and the reason.
        now : float
            Time [s].

        Returns
        -------
        str
            Line; empty if the last one was about the same.
        """
        line = f"the server refuses: {detail}"
        if detail.startswith(LASTING):
            self.until = inf
            line += "; nothing is sent until the display is armed again"
        elif detail.startswith(PASSING):
            self.until = max(self.until, now + RETRY)
        subject = detail.split()[:2]
        line, self._last = "" if subject == self._last else line, subject
        return line

    def forget(self) -> None:
        """Send again, since the display was armed or the server is another."""
        self.until, self._last = -inf, []

    def retry(self) -> None:
        """Send again unless it would be refused again, since other frames come."""
        if self.until < inf:
            self.until = -inf
