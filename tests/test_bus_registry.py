"""URLs of devices, and the drivers that are registered for them."""

from collections.abc import Callable
from typing import Annotated, Literal

import pytest
from msgspec import Meta

from tactile.bus import registry
from tactile.bus.base import Bus, DisplayLike, HostDeath
from tactile.bus.options import HEXADECIMAL, Options, decode
from tactile.bus.registry import Address
from tactile.bus.simulated.mock_bus import open_mock
from tactile.bus.simulated.modeled_bus import MockOptions
from tactile.devices import open_bus
from tactile.display.display import Display
from tactile.errors import BusError, InputError

SCHEMES = ("mock", "sim")


@pytest.mark.parametrize("scheme", SCHEMES)
class TestEveryScheme:
    """Tests of what holds for any kind of device URL."""

    def test_the_driver_says_of_host_death_what_its_buses_say(
        self, scheme: str, three: Display
    ) -> None:
        with open_bus(f"{scheme}:", three) as bus:
            assert registry._drivers[scheme].on_host_death == bus.on_host_death

    def test_an_unknown_option_is_one_line_with_the_nearest(
        self, scheme: str, three: Display
    ) -> None:
        with pytest.raises(InputError, match=f"^{scheme}: unknown option 'kep'; .*'keep'") as found:
            open_bus(f"{scheme}:?kep=all", three)
        assert "\n" not in str(found.value)

    @pytest.mark.parametrize("options", ["keep=all&bogus=1", "xyzzy=2", "KEEP=all"])
    def test_every_option_is_looked_at(self, scheme: str, three: Display, options: str) -> None:
        with pytest.raises(InputError, match="unknown option"):
            open_bus(f"{scheme}:?{options}", three)

    def test_an_option_with_a_wrong_value_says_what_may_be(
        self, scheme: str, three: Display
    ) -> None:
        with pytest.raises(InputError, match=f"{scheme}: keep = 'al': must be 'all' or 'second'"):
            open_bus(f"{scheme}:?keep=al", three)

    @pytest.mark.parametrize("query", ["keep", "keep=all&keep", "keep=all&&", "&"])
    def test_options_that_are_no_options_are_one_line(
        self, scheme: str, three: Display, query: str
    ) -> None:
        with pytest.raises(InputError, match="options are name=value") as found:
            open_bus(f"{scheme}:?{query}", three)
        assert "\n" not in str(found.value)

    def test_a_path_that_means_nothing_is_refused(self, scheme: str, three: Display) -> None:
        with pytest.raises(InputError):
            open_bus(f"{scheme}:keep=all", three)

    def test_the_scheme_is_read_in_any_case(self, scheme: str, three: Display) -> None:
        with open_bus(f"{scheme.upper()}:", three) as bus:
            assert bus.state == "idle"


@pytest.mark.parametrize(
    ("url", "nearest"),
    [("moc:", "'mock:'"), ("mock", "'mock:'"), ("simm:?keep=all", "'sim:'"), ("sim", "'sim:'")],
)
def test_an_unknown_scheme_is_one_line_with_the_nearest(
    three: Display, url: str, nearest: str
) -> None:
    with pytest.raises(InputError, match=f"no such kind; did you mean {nearest}") as found:
        open_bus(url, three)
    assert repr(url) in str(found.value)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("url", ["", ":", "xyzzy:", "/dev/ttyUSB0", "c:\\here"])
def test_a_url_that_resembles_nothing_is_one_line_with_what_there_is(
    three: Display, url: str
) -> None:
    with pytest.raises(InputError, match="no such kind") as found:
        open_bus(url, three)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("url", ["sim://[", "mock://[half?keep=all"])
def test_a_malformed_url_is_an_input_error(three: Display, url: str) -> None:
    with pytest.raises(InputError):
        open_bus(url, three)


class TestRegisteredBus:
    """A driver that fails to open."""

    @pytest.fixture(autouse=True)
    def _own_factories(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(registry, "_drivers", dict(registry._drivers))

    def test_an_operating_system_error_becomes_a_bus_error_that_names_the_device(
        self, three: Display
    ) -> None:
        def absent(address: Address[Options], rig: DisplayLike, sample_rate: float | None) -> Bus:
            raise FileNotFoundError(2, "No such file or directory", address.path)

        registry.register_bus("absent", absent, Options, takes_path=True)
        with pytest.raises(BusError, match=r"device 'absent:/dev/ttyX': .*No such file") as found:
            open_bus("absent:/dev/ttyX", three)
        assert isinstance(found.value.__cause__, FileNotFoundError)

    def test_a_bus_error_passes_as_it_is(self, three: Display) -> None:
        error = BusError("the amplifier does not answer")

        def silent(address: Address[Options], rig: DisplayLike, sample_rate: float | None) -> Bus:
            raise error

        registry.register_bus("silent", silent, Options)
        with pytest.raises(BusError) as found:
            open_bus("silent:", three)
        assert found.value is error

    @pytest.mark.parametrize("death", ["holds", "unknown"])
    def test_what_does_not_go_to_0_volts_by_itself_is_refused_unless_accepted(
        self, three: Display, death: HostDeath
    ) -> None:
        def factory(address: Address[Options], rig: DisplayLike, sample_rate: float | None) -> Bus:
            opened.append(address.scheme)
            return open_bus("mock:", rig)

        opened: list[str] = []
        registry.register_bus("own", factory, Options, on_host_death=death)
        with pytest.raises(InputError, match=r"when the host dies.*--accept-unsafe-hold") as found:
            open_bus("own:", three)
        assert "\n" not in str(found.value)
        assert opened == []
        open_bus("own:", three, accept_unsafe_hold=True).close()
        assert opened == ["own"]

    def test_found_devices_are_those_of_every_kind(self) -> None:
        def finder(scheme: str) -> Callable[[], list[registry.FoundDevice]]:
            return lambda: [registry.FoundDevice(f"{scheme}:{k}", "a device") for k in range(2)]

        for scheme in ("one", "two"):
            registry.register_bus(scheme, open_mock, MockOptions, find=finder(scheme))
        urls = [found.url for found in registry.find_devices()]
        assert [u for u in urls if u[:3] in ("one", "two")] == ["one:0", "one:1", "two:0", "two:1"]

    def test_a_factory_is_given_path_options_display_and_rate(self, three: Display) -> None:
        given: list[tuple[Address[OwnOptions], DisplayLike, float | None]] = []

        def factory(
            address: Address[OwnOptions], rig: DisplayLike, sample_rate: float | None
        ) -> Bus:
            given.append((address, rig, sample_rate))
            return open_bus("mock:", rig, sample_rate=sample_rate)

        registry.register_bus("own", factory, OwnOptions, takes_path=True)
        open_bus("own://host:12/dev/x?count=0x11&text=%20&numbers=2,3", three, sample_rate=4000.0)
        options = OwnOptions(count=17, text=" ", numbers=(2, 3))
        assert given == [(Address("own", "host:12/dev/x", options), three, 4000.0)]


class OwnOptions(Options, frozen=True, kw_only=True):
    """One option of each type."""

    count: Annotated[int, Meta(ge=1, le=20)] | None = None
    share: Annotated[float, Meta(ge=0, le=1)] = 0.5
    place: Annotated[int, Meta(ge=0x10, le=0x1F, extra=HEXADECIMAL)] = 0x10
    numbers: tuple[Annotated[int, Meta(ge=1, le=9)], ...] = ()
    text: str = ""
    flag: bool = False
    either: Literal["left", "right"] = "left"
    kind: Literal["pcm16", "pcm12", "bfp8"] | None = None


@pytest.mark.parametrize(
    ("given", "options"),
    [
        ({}, OwnOptions()),
        ({"count": "0x0A", "share": "1e-1"}, OwnOptions(count=10, share=0.1)),
        ({"place": "0x1f"}, OwnOptions(place=31)),
        ({"numbers": "1,9,"}, OwnOptions(numbers=(1, 9))),
        ({"numbers": ""}, OwnOptions()),
        ({"flag": "Yes"}, OwnOptions(flag=True)),
        ({"flag": "0"}, OwnOptions(flag=False)),
        ({"either": "right", "kind": "bfp8"}, OwnOptions(either="right", kind="bfp8")),
    ],
)
def test_options_are_decoded_to_their_types(given: dict[str, str], options: OwnOptions) -> None:
    decoded = decode("own", given, OwnOptions)
    assert decoded == options
    assert [type(getattr(decoded, f)) for f in decoded.__struct_fields__] == [
        type(getattr(options, f)) for f in options.__struct_fields__
    ]


@pytest.mark.parametrize(
    ("given", "mistake"),
    [
        ({"cuont": "1"}, "own: unknown option 'cuont'; did you mean 'count'?"),
        ({"count": "21"}, "own: count = '21': must be 1 … 20"),
        ({"count": "1.5"}, "own: count = '1.5': must be a whole number"),
        ({"count": "nan"}, "own: count = 'nan': must be 1 … 20"),
        ({"count": ""}, "own: count = '': must be a number"),
        ({"share": "-1"}, "own: share = '-1': must be 0 … 1"),
        ({"share": "inf"}, "own: share = 'inf': must be 0 … 1"),
        ({"place": "0x20"}, "own: place = '0x20': must be 0x10 … 0x1f"),
        ({"numbers": "1,x"}, "own: numbers = '1,x': must be a number"),
        ({"numbers": "1,10"}, "own: numbers = '1,10': must be 1 … 9"),
        ({"flag": "maybe"}, "own: flag = 'maybe': must be true or false"),
        ({"either": "up"}, "own: either = 'up': must be 'left' or 'right'"),
        ({"kind": "pcm8"}, "own: kind = 'pcm8': did you mean 'pcm16'?"),
    ],
)
def test_a_wrong_option_is_one_line_that_says_what_may_be(
    given: dict[str, str], mistake: str
) -> None:
    with pytest.raises(InputError) as caught:
        decode("own", given, OwnOptions)
    assert str(caught.value) == mistake


@pytest.mark.parametrize(
    ("url", "with_it"),
    [
        ("serial:///dev/ttyACM0", "serial:///dev/ttyACM0?rearm=true"),
        ("can:socketcan/can0?fd=true", "can:socketcan/can0?fd=true&rearm=true"),
        ("i2c:1?rearm=false", "i2c:1?rearm=false"),
        ("sim:", "sim:"),
        ("drv2667:1", "drv2667:1"),
    ],
)
def test_an_option_is_added_where_the_driver_has_it_and_the_url_does_not_say(
    url: str, with_it: str
) -> None:
    assert registry.with_default_option(url, "rearm", "true") == with_it
