"""The library pylsl, which is loaded only where a bridge is made."""

import os
from pathlib import Path
from typing import Any

from tactile.errors import missing_extra

WHAT = "the bridge to the Lab Streaming Layer"
QUIET = "[log]\nlevel = -2\n"
"""Configuration of liblsl with which it logs errors only; by default it also logs its version."""


def load_pylsl() -> Any:
    """Load pylsl, and let liblsl log errors only, unless the user has configured it otherwise.

    Returns
    -------
    module
        The module pylsl.

    Raises
    ------
    InputError
        If pylsl is not installed, or the library liblsl that it needs cannot be loaded. The message
        is one line that names the command to install it.
    """
    try:
        import pylsl
    except ImportError:
        raise missing_extra(WHAT, "pylsl", "lsl") from None
    except (RuntimeError, OSError, AttributeError) as error:  # as pylsl says it, or of an old one
        reason = " ".join(str(error).split()).partition(". ")[0]
        raise missing_extra(WHAT, f"liblsl ({reason})", "lsl") from error
    if not _is_configured():
        pylsl.set_config_content(QUIET)  # before the first use of liblsl; later it changes nothing
    return pylsl


def _is_configured() -> bool:
    """Return whether there is a file that liblsl reads, such as for the names of other hosts."""
    named = os.environ.get("LSLAPICFG")
    places = (
        Path("lsl_api.cfg"),
        Path("~/lsl_api/lsl_api.cfg").expanduser(),
        Path("/etc/lsl_api/lsl_api.cfg"),
    )
    return bool(named) or any(place.is_file() for place in places)
