"""The command ``tactile devices``."""

from tactile.cli.options import AsJson, emit
from tactile.cli.printing import print_table, unwrapped


def run(as_json: AsJson = False) -> None:
    """List the connected devices with their URLs.

    Example: tactile devices
    """
    from tactile.devices import find_devices

    emit([{"url": one.url, "about": one.about} for one in find_devices()], as_json, _print)


def _print(devices: list[dict[str, str]]) -> None:
    """Print a line for each device."""
    if devices:
        columns = [unwrapped("device"), "description"]
        print_table(columns, ((one["url"], one["about"]) for one in devices))
    else:
        print("no device found; sim: and mock: are always available")
