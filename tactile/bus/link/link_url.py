"""Options of a URL whose device speaks the protocol, and the function that opens its bus."""

from collections.abc import Callable, Sequence
from typing import Annotated

from msgspec import Meta

from firmware_protocol import messages as m
from firmware_protocol.messages import Feature, SampleFormat
from tactile.bus.base import RATE, DisplayLike, Wiring
from tactile.bus.board import config_of
from tactile.bus.budget import Ability, Plan, plan
from tactile.bus.link.link_bus import LinkBus
from tactile.bus.link.stream import LEAST_LEAD, LONGEST_LEAD
from tactile.bus.options import FORMATS, FormatName, Options
from tactile.bus.wire import Wire
from tactile.bus.wire_time import Link


class LinkOptions(Options, frozen=True, kw_only=True):
    """Options of every device whose amplifiers speak the protocol.

    Attributes
    ----------
    format : str or None
        Sample format on the link; by default the best that fits it.
    rearm : bool
        Whether the bus may arm an amplifier again that went to 0 V by itself.
    lead_ms : float or None
        Time by which samples are sent before they are due [ms]; by default it adapts to underruns.
    correlation_ms : int or None
        Length of the windows of correlated currents, of amplifiers that measure them [ms]; by
        default none are asked for.
    """

    format: FormatName | None = None
    rearm: bool = False
    lead_ms: Annotated[float, Meta(ge=1e3 * LEAST_LEAD, le=1e3 * LONGEST_LEAD)] | None = None
    correlation_ms: Annotated[int, Meta(ge=10, le=100)] | None = None

    @property
    def medium(self) -> Link:
        """Medium by which packets go, which each driver knows."""
        raise NotImplementedError

    @property
    def sample_format(self) -> SampleFormat | None:
        """Sample format on the link, as the protocol numbers it; None for any."""
        return None if self.format is None else FORMATS[self.format]

    @property
    def lead(self) -> float | None:
        """Time by which samples are sent before they are due [s]; None for an adaptive one."""
        return None if self.lead_ms is None else self.lead_ms * 1e-3


def open_link(
    options: LinkOptions,
    display: DisplayLike,
    sample_rate: float | None,
    connect: Callable[[], Wire],
    *,
    nodes: Sequence[int] = (),
) -> LinkBus:
    """Open a bus whose amplifiers speak the protocol, and wait until they are ready.

    Parameters
    ----------
    options : LinkOptions
        Options of the device's URL.
    display : DisplayLike
        Display that the amplifiers drive.
    sample_rate : float or None
        Sample rate of the drive [Hz]; None for the best that fits the link.
    connect : callable
        Function that opens the wire; the thread of the bus calls it again after a loss.
    nodes : sequence of int
        Nodes of the amplifiers in the order of the channels; all that answer if empty.

    Returns
    -------
    LinkBus
        The bus, with its amplifiers found and their clocks known.

    Raises
    ------
    BusError
        If the wire cannot be opened, no amplifier answers, or one refuses a request.
    InputError
        If the amplifiers cannot do what the display needs, or nothing that they understand fits
        the link.
    """
    wiring = Wiring.of(display, sample_rate or RATE)
    config_of(wiring, 1, 1)  # raises if no amplifier can keep what the display asks for
    choose = planner(options, display, sample_rate)
    return LinkBus(
        wiring, connect, choose,
        nodes=nodes, rearm=options.rearm, lead=options.lead,
        correlation_ms=options.correlation_ms or 0,
    )  # fmt: skip


def planner(
    options: LinkOptions, display: DisplayLike, sample_rate: float | None
) -> Callable[[Sequence[m.Caps]], Plan]:
    """Return the function that chooses how the drive is sent.

    Parameters
    ----------
    options, display, sample_rate
        As `open_link` takes them.

    Returns
    -------
    callable
        Function that takes the CAPS of all amplifiers and returns the `Plan`.
    """

    def choose(caps: Sequence[m.Caps]) -> Plan:
        ability = Ability.of(caps)
        measures = any(each.features & Feature.CORRELATES for each in caps)
        return plan(
            options.medium, display.channels, ability,
            sample_rate=sample_rate, sample_format=options.sample_format,
            correlation_ms=(options.correlation_ms or 0) if measures else 0,
        )  # fmt: skip

    return choose
