"""The outputs that PortAudio lists: which is meant, and at which rate it is opened.

sounddevice, or what stands for it in a test, is handed in; `imported` gets the real one.
"""

from typing import Any, NamedTuple

from tactile.errors import BusError, InputError, NotFoundError
from tactile.files import nearest

RATES = (8000, 16000, 32000, 44100, 48000, 88200, 96000, 192000)
"""Hz that are tried where one is refused."""
NO_PORTAUDIO = (
    "audio: PortAudio is missing: {}; apt install libportaudio2, or where there is none "
    "pip install --force-reinstall sounddevice"
)


class Device(NamedTuple):
    """An output as PortAudio lists it."""

    number: int
    name: str
    api: str
    channels: int
    rate: float


def outputs(sd: Any) -> list[Device]:
    """Return the outputs that there are."""
    apis = [api["name"] for api in sd.query_hostapis()]
    return [
        Device(k, d["name"], apis[d["hostapi"]], d["max_output_channels"], d["default_samplerate"])
        for k, d in enumerate(sd.query_devices())
        if d["max_output_channels"] > 0
    ]


def choose(found: list[Device], name: str, default: int) -> Device:
    """Return the output of a name or number; that of number ``default`` for an empty one.

    Raises
    ------
    BusError
        Where there is none at all.
    NotFoundError, InputError
        Where none has the name, with the nearest, or several have.
    """
    if not found:
        raise BusError("audio: no output device; plug one in or start its sound server, as JACK")
    if name.isdecimal() or not name:
        number = int(name) if name else default
        chosen = [d for d in found if d.number == number]
    else:
        full = [(f"{d.name}, {d.api}".casefold(), d) for d in found]
        key = name.casefold()
        chosen = [d for text, d in full if key in (text, d.name.casefold())]
        chosen = chosen or [d for text, d in full if key in text]
    names = [d.name for d in found]
    if not chosen:
        what = f"no output device {name!r}" if name else "no default output device"
        raise NotFoundError(f"audio: {what}; {nearest(name, names)}")
    if len(chosen) > 1:
        several = ", ".join(f"{d.name!r} of {d.api}" for d in chosen)
        raise InputError(
            f"audio: {name!r} is the name of {len(chosen)} devices: {several}; "
            f"say more of it, or its number: audio:{chosen[0].number}"
        )
    return chosen[0]


def rate_of(sd: Any, device: Device, channels: int, sample_rate: float | None) -> float:
    """Return the rate [Hz] that a device is opened at, by default its own.

    Raises
    ------
    InputError, BusError
        Where it has too few channels, not that rate, or is busy.
    """
    if device.channels < channels:
        raise InputError(
            f"audio: {device.name!r} has {device.channels} output channels, needs {channels}"
        )
    wanted = sample_rate or device.rate
    if _refused(sd, device, channels, wanted) is None:
        return wanted
    would_do = [r for r in RATES if _refused(sd, device, channels, r) is None]
    if not would_do:
        raise BusError(
            f"audio: {device.name!r}: {_refused(sd, device, channels, wanted)}; "
            "close what else plays on it"
        )
    raise InputError(
        f"audio: {device.name!r}: sample_rate {wanted:g} Hz: it plays "
        f"{', '.join(map(str, would_do))} Hz; leave it out for {device.rate:g} Hz"
    )


def _refused(sd: Any, device: Device, channels: int, rate: float) -> str | None:
    """Return why a device does not play so; None where it does."""
    try:
        sd.check_output_settings(device.number, channels, "float32", samplerate=rate)
    except (sd.PortAudioError, ValueError) as error:
        return str(error)
    return None


def imported() -> Any:
    """Return sounddevice.

    Raises
    ------
    BusError
        Where it or PortAudio is missing.
    """
    try:
        import sounddevice
    except ImportError as error:
        raise BusError(f"audio: {error}; pip install sounddevice") from error
    except Exception as error:
        raise BusError(NO_PORTAUDIO.format(error)) from error
    return sounddevice


def default_output(sd: Any) -> int:
    """Return the number of the default output, −1 where there is none."""
    try:
        return int(sd.query_devices(kind="output")["index"])
    except sd.PortAudioError:
        return -1
