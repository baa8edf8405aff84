"""The library of JACK, which is loaded only where a sound card is made."""

from typing import Any

from tactile.errors import InputError, missing_extra

WHAT = "the sound card of JACK"


def load_jack() -> Any:
    """Load the module jack, which loads libjack.

    Returns
    -------
    module
        The module jack.

    Raises
    ------
    InputError
        If JACK-Client is not installed, or libjack cannot be loaded. The message is one line that
        names the command to install it.
    """
    try:
        import jack
    except ImportError:
        raise missing_extra(WHAT, "JACK-Client", "jack") from None
    except OSError as error:  # as JACK-Client says that there is no libjack, or as the linker does
        reason = " ".join(str(error).split())
        raise InputError(f"{WHAT} needs libjack ({reason}): apt install jackd2") from error
    return jack
