"""The tables of the laws of speed and force, and the raster that sparse events are read from.

Tables are compared with the laws; the raster with the Gaussians themselves, summed one by one in
double precision over the tiles.
"""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from tactile.arrays import Floats
from tactile.rendering.shear import EventField, Law
from tactile.texture.descriptor import About, Descriptor, Events, Laws, Reference
from tactile.texture.power_laws import held_power_law
from tactile.texture.surface import Partials, Surface

EXPONENTS = [-4.0, -1.0, -0.5, 0.4, 1.0, 3.0]
CONTACT_FORCE = 0.05
"""Force below which the finger is leaving [N]."""


def descriptor(laws: Laws, *, speed: float = 40.0, force: float = 0.5) -> Descriptor:
    """Return a descriptor of one event with these laws and this reference [mm/s], [N]."""
    return Descriptor(
        texture=About(
            id="sample",
            category="test",
            description="",
            provenance="authored",
            source="a test",
            license="",
        ),
        reference=Reference(speed_mm_s=speed, normal_force_n=force),
        events=(Events(density_per_mm2=1.0, amplitude_um=1.0, width_mm=1.0),),
        laws=laws,
    )


def factor(law: Law, speed: Floats, force: Floats) -> Floats:
    """Return a law's factor at speeds [m/s] and forces [N]."""
    return np.asarray(law(speed**2, force), np.float64)


BOTH = Laws(
    speed_exponent=-1.0,
    speed_range_mm_s=(20.0, 60.0),
    force_exponent=0.4,
    force_range_n=(0.2, 2.0),
)


def table_error(exponent: float, step: float) -> float:
    """Return what straight lines between entries leave of x^exponent, and 10 % more.

    step²/8 times x² L″/L, which is e² − e in the law, and where it bends adds 2 |e| to |e|.
    """
    return 1.1 * step**2 / 8 * (exponent**2 + 3 * abs(exponent)) + 1e-9


@pytest.mark.parametrize(("speed", "force"), [(40.0, 0.5), (25.0, 1.0), (55.0, 0.3)])
def test_the_factor_is_one_at_the_descriptor_s_reference(speed: float, force: float) -> None:
    """The factor is one within what the tables leave."""
    law = Law(descriptor(BOTH, speed=speed, force=force))
    at_reference = factor(law, np.array([speed * 1e-3]), np.array([force]))
    assert at_reference == pytest.approx(1, abs=1e-4)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_factor_follows_the_speed_law_of_the_descriptor(exponent: float) -> None:
    """Speeds go from rest to 3 m/s here, and are in mm/s in the file; the table is over speed²."""
    laws = Laws(speed_exponent=exponent, speed_range_mm_s=(20.0, 60.0))
    speed = np.concatenate([[0.0, 1e-6], np.geomspace(1e-4, 3, 999)])
    found = factor(Law(descriptor(laws)), speed, np.full(len(speed), 0.5))
    expected = held_power_law(speed * 1e3, 40.0, (20.0, 60.0), exponent)
    np.testing.assert_allclose(found, expected, rtol=table_error(exponent / 2, 0.02) + 1e-5)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_the_factor_follows_the_force_law_of_the_descriptor(exponent: float) -> None:
    """Forces go from where contact is full up to 50 N."""
    laws = Laws(force_exponent=exponent, force_range_n=(0.2, 2.0))
    force = np.geomspace(CONTACT_FORCE, 50, 999)
    found = factor(Law(descriptor(laws)), np.full(len(force), 0.04), force)
    expected = held_power_law(force, 0.5, (0.2, 2.0), exponent)
    np.testing.assert_allclose(found, expected, rtol=table_error(exponent, 0.01) + 1e-5)


def test_speed_and_force_multiply() -> None:
    law = Law(descriptor(BOTH))
    speed, force = np.meshgrid(np.linspace(0, 0.2, 30), np.linspace(0, 3, 30))
    together = factor(law, speed.ravel(), force.ravel()).reshape(30, 30)
    alone = factor(law, speed[0], np.full(30, 0.5)), factor(law, np.full(30, 0.04), force[:, 0])
    expected = np.outer(alone[1], alone[0]) / factor(law, np.array([0.04]), np.array([0.5]))
    np.testing.assert_allclose(together, expected, rtol=1e-12)


@pytest.mark.parametrize("exponent", [-2.0, 0.0, 0.4])
def test_without_contact_there_is_no_shear_and_it_comes_and_goes_smoothly(exponent: float) -> None:
    """The factor is 0 at 0 N, 1 at 0.05 N, and 3t² − 2t³ between, without a corner.

    In the table's 64 steps of it: 6/8/64² = 2e-4 off at most; the slope's corners at both ends
    are that of one step.
    """
    laws = Laws(force_exponent=exponent, force_range_n=(0.2, 2.0))
    law = Law(descriptor(laws))
    force = np.linspace(0, 2 * CONTACT_FORCE, 2001)
    found = factor(law, np.full(2001, 0.04), force)
    assert found[0] == 0
    touch = np.minimum(force / CONTACT_FORCE, 1)
    held = held_power_law(force, 0.5, (0.2, 2.0), exponent)
    np.testing.assert_allclose(found, touch**2 * (3 - 2 * touch) * held, atol=3e-4 * held[0])
    assert np.all(np.diff(found[:1001]) >= 0)
    slope = np.diff(found) / np.diff(force) * CONTACT_FORCE / held[0]
    assert abs(slope[0]) < 0.1
    assert abs(slope[999]) < 0.1
    assert slope.max() == pytest.approx(1.5, abs=0.05)


def test_no_speed_and_no_law_give_no_change() -> None:
    law = Law(descriptor(Laws()))
    speed, force = np.array([0.0, 0.01, 5.0]), np.array([0.06, 0.5, 40.0])
    np.testing.assert_allclose(factor(law, speed, force), 1, atol=1e-12)


# Events

TILE = 25.6e-3
PITCH = TILE / 2048
"""Pitch of the raster, 12.5 µm [m]."""


def surface(place: Floats, peak: Floats, kind: NDArray[np.intp]) -> Surface:
    none = Partials(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    return Surface(none, none, place, peak, kind, TILE)


def read(field: EventField, place: Floats) -> Floats:
    """Return displacement (S, N) [m] for finger places (S, 2) [m]."""
    shear = np.zeros((len(place), field._offset.shape[1]), np.float32)
    field.add_to(shear, place.T)
    return shear.astype(np.float64)


def summed(
    place: Floats, peak: Floats, kinds: list[Events], kind: NDArray[np.intp], at: Floats
) -> Floats:
    """Return the displacement (S,) of every event on 3 × 3 tiles, Gaussian by Gaussian [m]."""
    total = np.zeros(len(at))
    home = at % TILE
    for where, size, k in zip(place, peak, kind, strict=True):
        event = kinds[k]
        sigma = event.width_mm * 1e-3 / math.sqrt(8 * math.log(2))
        turn = math.radians(event.direction_deg)
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                x, y = (home - where - TILE * np.array([i, j])).T
                bump = np.exp(-(x**2 + y**2) / (2 * sigma**2))
                if event.shape == "edge":
                    along = x * math.cos(turn) + y * math.sin(turn)
                    bump = bump * along / sigma * math.exp(0.5)
                total += size * bump
    return total


KINDS = [
    Events(density_per_mm2=1.0, amplitude_um=1.0, width_mm=0.25),
    Events(density_per_mm2=1.0, amplitude_um=1.0, width_mm=1.3, shape="edge", direction_deg=30.0),
    Events(density_per_mm2=1.0, amplitude_um=1.0, width_mm=5.0),
]


def bend(width: float, shape: str) -> float:
    """Return the most that bilinear reading may miss of an event of peak one.

    pitch²/8 times the second derivatives along both axes: 1/σ² each for a Gaussian, and for its
    derivative (scaled to a peak of one) at most 3.22/σ² together.
    """
    sigma = width * 1e-3 / math.sqrt(8 * math.log(2))
    return (2.0 if shape == "pulse" else 3.22) * (PITCH / sigma) ** 2 / 8


def test_the_raster_is_the_sum_of_its_events_at_random_places() -> None:
    """60 events of three kinds, some across the tile's edges; 2000 places on ± 4 tiles.

    Each event near a place adds what its bilinear reading misses (0.35 % of the narrowest) and
    the five-σ cut (4e-6); eight of them overlap at most, float32 adds 1e-6.
    """
    rng = np.random.default_rng(5)
    place, kind = rng.uniform(0, TILE, (60, 2)), rng.choice(3, 60, p=[0.6, 0.25, 0.15])
    place[:6, 0], place[6:12, 1] = rng.uniform(0, 2e-4, 6), TILE - rng.uniform(0, 2e-4, 6)
    peak = rng.choice([-1, 1], 60) * rng.uniform(0.5e-6, 2e-6, 60)
    field = EventField(surface(place, peak, kind), tuple(KINDS), np.zeros((1, 2)))
    at = np.concatenate(
        [rng.uniform(-4 * TILE, 4 * TILE, (1000, 2)), place.repeat(16, 0)]
    ) + rng.normal(0, 2e-4, (1960, 2))
    expected = summed(place, peak, KINDS, kind, at)
    assert np.std(expected) > 0.5e-6
    tolerance = 2e-6 * (bend(0.25, "pulse") + bend(1.3, "edge") + 8 * bend(5.0, "pulse") + 1e-4)
    np.testing.assert_allclose(read(field, at)[:, 0], expected, atol=tolerance)


@pytest.mark.parametrize("shape", ["pulse", "edge"])
@pytest.mark.parametrize("width", [0.1, 0.25, 1.0])
def test_one_event_is_read_within_the_error_of_a_bilinear_reading(width: float, shape: str) -> None:
    """The event may lie anywhere on the raster, and be read anywhere between pixels."""
    worst = worst_reading(width, shape)
    assert worst < bend(width, shape) + 2e-5
    assert worst > 0.3 * bend(width, shape)


def worst_reading(width: float, shape: str) -> float:
    """Return the largest error of reading an event, of its peak, over offsets of both."""
    rng, worst = np.random.default_rng(1), 0.0
    direction = 0.0 if shape == "edge" else 77.0
    event = Events(
        density_per_mm2=1.0,
        amplitude_um=1.0,
        width_mm=width,
        shape="edge" if shape == "edge" else "pulse",
        direction_deg=direction,
    )
    for offset in ([0.0, 0.0], [0.5, 0.5], [0.3, 0.8]):
        place = (np.array([[700.0, 1200.0]]) + offset) * PITCH
        field = EventField(
            surface(place, np.ones(1), np.zeros(1, np.intp)), (event,), np.zeros((1, 2))
        )
        near = place + rng.uniform(-1, 1, (4000, 2)) * width * 1e-3
        near = np.concatenate([near, np.floor(near / PITCH) * PITCH + 0.5 * PITCH, place])
        expected = summed(place, np.ones(1), [event], np.zeros(1, np.intp), near)
        worst = max(worst, float(np.abs(read(field, near)[:, 0] - expected).max()))
    return worst


@pytest.mark.parametrize("corner", [(0.0, 0.0), (TILE - 1e-6, 1e-6), (1e-5, TILE / 2)])
def test_an_event_on_the_edge_of_the_tile_goes_on_at_the_other(corner: tuple[float, float]) -> None:
    """The same shape around it as in the middle of the tile, on whichever tile it is read."""
    rng = np.random.default_rng(3)
    around = rng.uniform(-2e-3, 2e-3, (500, 2))
    place = np.round(np.array([corner]) / PITCH) * PITCH % TILE
    middle = np.array([[1000, 900]]) * PITCH
    shapes = []
    for where in (place, middle):
        one = surface(where, np.full(1, 1e-6), np.ones(1, np.intp))
        shapes.append(read(EventField(one, tuple(KINDS), np.zeros((1, 2))), where + around))
    np.testing.assert_allclose(shapes[0], shapes[1], atol=1e-12)
    one = surface(place, np.full(1, 1e-6), np.ones(1, np.intp))
    field = EventField(one, tuple(KINDS), np.zeros((1, 2)))
    for tiles in ([1, 0], [0, -1], [-20, 35]):
        np.testing.assert_allclose(
            read(field, place + around + np.array(tiles) * TILE), shapes[0], atol=1e-11
        )


def test_every_contactor_reads_at_its_own_place() -> None:
    """The place is the finger's plus its own, on pixels and between them."""
    rng = np.random.default_rng(8)
    place, kind = rng.uniform(0, TILE, (40, 2)), rng.integers(0, 2, 40)
    whole = surface(place, rng.uniform(1e-6, 2e-6, 40), kind)
    contactors = np.array([[0.0, 0.0], [2.5e-3, 0.0], [-6.2513e-3, 5.2481e-3], [1e-3, -3e-2]])
    finger = rng.uniform(-0.1, 0.1, (300, 2))
    shear = read(EventField(whole, tuple(KINDS), contactors), finger)
    assert shear.shape == (300, 4)
    alone = EventField(whole, tuple(KINDS), np.zeros((1, 2)))
    for i, where in enumerate(contactors):
        np.testing.assert_allclose(shear[:, i], read(alone, finger + where)[:, 0], atol=1e-11)


def test_a_surface_without_events_is_still() -> None:
    field = EventField(
        surface(np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.intp)), (), np.zeros((3, 2))
    )
    assert not np.any(read(field, np.random.default_rng(0).uniform(-1, 1, (50, 2))))
