"""For how long something that should give signs of life has given none."""


class SilenceTimer:
    """The time without a sign of life, of which only what the observer itself saw counts.

    An observer that stood still, with its whole machine perhaps, cannot tell whether anyone was
    silent meanwhile: from one look to the next at most ``longest_step`` is counted.

    Parameters
    ----------
    longest_step : most that one look counts [s]

    Attributes
    ----------
    seconds : length of the silence [s]
    """

    def __init__(self, longest_step: float) -> None:
        self._longest_step = longest_step
        self.seconds = 0.0

    def look(self, passed: float, *, sign: bool) -> float:
        """Return the length of the silence [s].

        Parameters
        ----------
        passed : time since the last look [s]
        sign : whether there was a sign of life since then
        """
        self.seconds = 0.0 if sign else self.seconds + min(passed, self._longest_step)
        return self.seconds
