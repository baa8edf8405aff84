"""Time for which something that should give signs of life has given none."""


class SilenceTimer:
    """Time without a sign of life, of which only what the observer itself saw counts.

    An observer that stood still, perhaps with its whole machine, cannot tell whether anyone was
    silent meanwhile: from one look to the next at most ``longest_step`` is counted.

    Parameters
    ----------
    longest_step : float
        Largest time that one look counts [s].

    Attributes
    ----------
    seconds : float
        Length of the silence [s].
    """

    def __init__(self, longest_step: float) -> None:
        self._longest_step = longest_step
        self.seconds = 0.0

    def look(self, passed: float, *, sign: bool) -> float:
        """Update and return the length of the silence.

        Parameters
        ----------
        passed : float
            Time since the last look [s].
        sign : bool
            Whether there was a sign of life since then.

        Returns
        -------
        float
            Length of the silence [s].
        """
        self.seconds = 0.0 if sign else self.seconds + min(passed, self._longest_step)
        return self.seconds
