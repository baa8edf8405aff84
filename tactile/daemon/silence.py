"""For how long something that should give signs of life has given none."""


class Silence:
    """The time without a sign of life, of which only what the observer itself saw counts.

    An observer that stood still, with its whole machine perhaps, cannot tell whether anyone was
    silent meanwhile: from one look to the next at most ``longest_step`` is counted.

    Parameters
    ----------
    longest_step : most that one look counts [s]
    """

    def __init__(self, longest_step: float) -> None:
        self._longest_step = longest_step
        self._looked: float | None = None
        self.seconds = 0.0

    def look(self, now: float, *, sign: bool) -> float:
        """Return for how long there has been no sign of life [s].

        Parameters
        ----------
        now : time of a clock that never steps [s]
        sign : whether there was a sign since the last look
        """
        if self._looked is not None:
            self.seconds += min(max(now - self._looked, 0.0), self._longest_step)
        self._looked = now
        if sign:
            self.seconds = 0.0
        return self.seconds
