"""Select an output of PortAudio, and the sample rate at which it is opened.

Functions receive the module sounddevice, or a test's substitute, as ``sd``; `imported` returns the
real one.
"""

from typing import Any, NamedTuple

from tactile.errors import BusError, InputError, NotFoundError
from tactile.files import nearest

RATES = (8000, 16000, 32000, 44100, 48000, 88200, 96000, 192000)
"""Sample rates that are tried where the requested one is refused [Hz]."""
NO_PORTAUDIO = (
    "audio: PortAudio is missing: {}; apt install libportaudio2, or where there is none "
    "pip install --force-reinstall sounddevice"
)
"""Message for a missing PortAudio library, to be formatted with the error."""


class Device(NamedTuple):
    """Output device as PortAudio lists it.

    Attributes
    ----------
    number : int
        Index of the device in PortAudio's list.
    name : str
        Name of the device.
    api : str
        Name of its sound system, such as "ALSA".
    channels : int
        Number of output channels.
    rate : float
        Default sample rate [Hz].
    """

    number: int
    name: str
    api: str
    channels: int
    rate: float


def outputs(sd: Any) -> list[Device]:
    """Return the available output devices.

    Parameters
    ----------
    sd : module
        Module sounddevice.

    Returns
    -------
    list of Device
        Devices with at least one output channel.
    """
    apis = [api["name"] for api in sd.query_hostapis()]
    return [
        Device(k, d["name"], apis[d["hostapi"]], d["max_output_channels"], d["default_samplerate"])
        for k, d in enumerate(sd.query_devices())
        if d["max_output_channels"] > 0
    ]


def choose(devices: list[Device], name: str, default: int) -> Device:
    """Select an output device by its name or number.

    Names are compared without regard to case. A full name takes precedence over a part of a name.

    Parameters
    ----------
    devices : list of Device
        Available devices.
    name : str
        Name, part of a name or number of the device; empty for the default device.
    default : int
        Number of the default device.

    Returns
    -------
    Device
        The only device that matches.

    Raises
    ------
    BusError
        If there is no device at all.
    NotFoundError
        If no device matches; the message suggests the nearest name.
    InputError
        If several devices match.
    """
    if not devices:
        raise BusError("audio: no output device; plug one in or start its sound server, as JACK")
    if name.isdecimal() or not name:
        number = int(name) if name else default
        matches = [d for d in devices if d.number == number]
    else:
        full = [(f"{d.name}, {d.api}".casefold(), d) for d in devices]
        key = name.casefold()
        matches = [d for text, d in full if key in (text, d.name.casefold())]
        matches = matches or [d for text, d in full if key in text]
    names = [d.name for d in devices]
    if not matches:
        problem = f"no output device {name!r}" if name else "no default output device"
        raise NotFoundError(f"audio: {problem}; {nearest(name, names)}")
    if len(matches) > 1:
        listing = ", ".join(f"{d.name!r} of {d.api}" for d in matches)
        raise InputError(
            f"audio: {name!r} is the name of {len(matches)} devices: {listing}; "
            f"say more of it, or its number: audio:{matches[0].number}"
        )
    return matches[0]


def rate_of(sd: Any, device: Device, channels: int, sample_rate: float | None) -> float:
    """Return the sample rate at which a device is to be opened.

    Parameters
    ----------
    sd : module
        Module sounddevice.
    device : Device
        Device to be opened.
    channels : int
        Number of channels to be opened.
    sample_rate : float or None
        Requested rate [Hz]; None for the device's default rate.

    Returns
    -------
    float
        Sample rate [Hz].

    Raises
    ------
    InputError
        If the device has too few channels, or plays at other rates only.
    BusError
        If the device refuses all rates, for example because it is in use.
    """
    if device.channels < channels:
        raise InputError(
            f"audio: {device.name!r} has {device.channels} output channels, needs {channels}"
        )
    rate = sample_rate or device.rate
    if _refusal(sd, device, channels, rate) is None:
        return rate
    supported = [r for r in RATES if _refusal(sd, device, channels, r) is None]
    if not supported:
        raise BusError(
            f"audio: {device.name!r}: {_refusal(sd, device, channels, rate)}; "
            "close what else plays on it"
        )
    raise InputError(
        f"audio: {device.name!r}: sample_rate {rate:g} Hz: it plays "
        f"{', '.join(map(str, supported))} Hz; leave it out for {device.rate:g} Hz"
    )


def _refusal(sd: Any, device: Device, channels: int, rate: float) -> str | None:
    """Return why a device refuses these settings, or None if it accepts them."""
    try:
        sd.check_output_settings(device.number, channels, "float32", samplerate=rate)
    except (sd.PortAudioError, ValueError) as error:
        return str(error)
    return None


def imported() -> Any:
    """Import sounddevice, which loads PortAudio.

    Returns
    -------
    module
        Module sounddevice.

    Raises
    ------
    BusError
        If sounddevice or PortAudio is missing.
    """
    try:
        import sounddevice
    except ImportError as error:
        raise BusError(f"audio: {error}; pip install sounddevice") from error
    except Exception as error:
        raise BusError(NO_PORTAUDIO.format(error)) from error
    return sounddevice


def default_output(sd: Any) -> int:
    """Return the number of the default output device.

    Parameters
    ----------
    sd : module
        Module sounddevice.

    Returns
    -------
    int
        Number of the device; −1 if there is no default.
    """
    try:
        return int(sd.query_devices(kind="output")["index"])
    except sd.PortAudioError:
        return -1
