"""Tests of the reference that `docs/generate.py` makes of schemas and docstrings."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType
from typing import Annotated

import msgspec
import pytest
from msgspec import Meta, Struct

from tactile import devices
from tactile.bus import registry
from tactile.bus.options import option_types
from tactile.display.tables import DisplayFile
from tactile.texture.descriptor import Descriptor

pytest.importorskip("numpydoc")
SOURCE = Path(__file__).parents[1] / "docs" / "generate.py"
ROW = r"^\| `(\w+)` \| (.*) \| (.*) \| (.*) \| (.*) \|$"


def load() -> ModuleType:
    """Return the module that writes the pages; the folder of documents is no package."""
    spec = importlib.util.spec_from_file_location("generate", SOURCE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


GENERATE = load()


def sections(page: str) -> dict[str, dict[str, list[str]]]:
    """Return the cells of each row behind its key, by heading and key."""
    parts = re.split(r"^## `(.*)`$", page, flags=re.MULTILINE)[1:]
    return {
        heading: {key: cells for key, *cells in re.findall(ROW, text, re.MULTILINE)}
        for heading, text in zip(parts[::2], parts[1::2], strict=True)
    }


def test_every_option_of_every_driver_is_on_the_page_with_its_meaning() -> None:
    listed = sections(GENERATE.device_page())
    modules = {module.__name__ for module in devices.KINDS}
    drivers = {
        scheme: driver
        for scheme, driver in registry._drivers.items()
        if driver.factory.__module__ in modules
    }
    assert len(drivers) == len(devices.KINDS)
    assert {heading: set(rows) for heading, rows in listed.items()} == {
        f"{scheme}:": set(option_types(driver.options)) for scheme, driver in drivers.items()
    }
    for heading, rows in listed.items():
        assert f"`{heading}" in GENERATE.device_page()
        meanings = [meaning for *_, meaning in rows.values()]
        assert all(meanings), heading
        assert len(set(meanings)) == len(meanings), heading


@pytest.mark.parametrize(
    ("scheme", "option", "cells"),
    [
        ("can:", "bitrate", ["bit/s", "number ≥ 10000 and ≤ 1000000", "`1000000`"]),
        ("i2c:", "address", ["", "list, each: integer ≥ 0x8 and ≤ 0x77", "`0x42`"]),
        ("i2c:", "smbus", ["", "`true`, `false`", "`false`"]),
        ("drv2667:", "range", ["V", "`50`, `100`, `150`, `200`", ""]),
        ("mock:", "drift_ppm", ["ppm", "number ≥ -20000 and ≤ 20000", "`0`"]),
    ],
)
def test_an_option_has_its_unit_range_and_default(
    scheme: str, option: str, cells: list[str]
) -> None:
    assert sections(GENERATE.device_page())[scheme][option][:3] == cells


def test_the_urls_on_the_page_are_allowed() -> None:
    page = GENERATE.device_page()
    schemes = [heading.rstrip(":") for heading in sections(page)]
    urls = re.findall(rf"`((?:{'|'.join(schemes)}):[^`]*)`", page)
    examples = [url for url in urls if "option=value" not in url]
    assert len(examples) > 2 * len(schemes)
    for url in examples:
        registry.parse(url)


@pytest.mark.parametrize("schema", [DisplayFile, Descriptor])
def test_every_key_of_a_file_is_on_its_page_with_a_meaning_of_its_own(schema: type) -> None:
    listed = sections(GENERATE.file_page("Title", schema, "`example`"))
    for heading, struct, _ in GENERATE.tables(schema):
        rows = listed[heading]
        fields = msgspec.inspect.type_info(struct).fields  # type: ignore[attr-defined]
        keys = {field.name for field in fields if GENERATE.struct_of(field.type) is None}
        assert set(rows) == keys
        assert all(meaning for *_, meaning in rows.values()), heading


def test_units_come_from_suffixes() -> None:
    coil = sections(GENERATE.file_page("Title", DisplayFile, "`example`"))["[voice_coil]"]
    assert [coil[key][0] for key in ("resistance_ohm", "inductance_mh", "current_a")] == [
        "Ω", "mH", "A",
    ]  # fmt: skip


class Invented(Struct):
    """Table with numbers whose units are not known.

    Attributes
    ----------
    mass_stone : float
        Mass.
    pair_stone : tuple of float or None
        Two masses.
    delay_ms : float
        Delay.
    name : str
        Name.
    """

    mass_stone: Annotated[float, Meta(ge=0)] = 0.0
    pair_stone: tuple[float, float] | None = None
    delay_ms: Annotated[float, Meta(ge=0)] = 0.0
    name: str = ""


INVENTED = {
    field.name: field
    for field in msgspec.inspect.type_info(Invented).fields  # type: ignore[attr-defined]
}


def test_a_number_with_an_unknown_suffix_is_an_error() -> None:
    for name in ("mass_stone", "pair_stone"):
        with pytest.raises(ValueError, match=rf"{name}: no unit"):
            GENERATE.unit_of(INVENTED[name])
    assert GENERATE.unit_of(INVENTED["mass_stone"], "kg") == "kg"
    assert GENERATE.unit_of(INVENTED["name"]) == ""


def test_a_unit_that_contradicts_the_suffix_is_an_error() -> None:
    with pytest.raises(ValueError, match=r"delay_ms: its suffix means ms"):
        GENERATE.unit_of(INVENTED["delay_ms"], "s")
