"""How strong a texture is on a display: closed forms against strokes, gains against limits."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import Command
from scipy.integrate import quad
from strength_rig import STROKE, authored, felt, few, played, ribs, skin, spectrum

from tactile.actuator.finger import FingerLoad
from tactile.display.display import Display, load_display
from tactile.errors import InputError
from tactile.playback.runs import run
from tactile.rendering.contact import Trajectory
from tactile.rendering.equalizer import roll_off
from tactile.rendering.renderer import Renderer, render
from tactile.strength import strength
from tactile.strength.commanded import EVENT_EDGES, commanded_lines
from tactile.strength.strength import (
    SteadyStroke,
    amplified,
    automatic_gain,
    equal_gain,
    reach,
    texture_strength,
    trial,
)
from tactile.texture.perception import CENTERS, EDGES, band_sensation, detection_threshold
from tactile.texture.surface import Texture, load_texture, without_friction

pytestmark = pytest.mark.usefixtures("brief")

HEADROOM = 10 ** (-3.5 / 20)
"""Factor by which a trial stays below the limit: the peak of half a minute is up to 3.1 dB above
it."""
STROKE_SHARE = 0.3
"""Largest share of full drive that friction takes."""


# Closed form


@pytest.mark.parametrize("frequency", [30.0, 250.0, 700.0])
def test_a_grating_has_exactly_its_peak_over_the_threshold(
    tmp_path: Path, pair: Display, frequency: float
) -> None:
    """The display's filter adds its error: 0.04 dB at most."""
    texture = ribs(tmp_path, frequency, 5.0)
    lines = commanded_lines(texture, speed=0.08, normal_force=0.5)
    expected = 20 * np.log10(5e-6 / detection_threshold(np.array([frequency]))[0])
    assert band_sensation(lines.frequency, lines.power).max() == pytest.approx(expected, abs=1e-6)
    assert texture_strength(pair, texture).level.max() == pytest.approx(expected, abs=0.05)


def test_the_roll_off_above_1_khz_is_in_the_lines(tmp_path: Path) -> None:
    for frequency in (900.0, 1125.0, 1300.0):
        lines = commanded_lines(ribs(tmp_path, frequency, 1.0), speed=0.08, normal_force=0.5)
        weight = roll_off(np.array([frequency]))[0]
        assert lines.power.sum() == pytest.approx((weight * 1e-6) ** 2 / 2, abs=1e-30)


def test_laws_of_speed_and_force_are_in_the_lines(tmp_path: Path) -> None:
    """The laws are straight well within their ranges: v² (N/N0)."""
    texture = authored(
        tmp_path,
        "[[periodic]]\nwavelength_mm = 1.0\nharmonics_um = [1.0]\n"
        "[laws]\nspeed_exponent = 2.0\nspeed_range_mm_s = [2.0, 900.0]\n"
        "force_exponent = 1.0\nforce_range_n = [0.06, 15.0]\n",
    )
    lines = commanded_lines(texture, speed=0.04, normal_force=1.0)
    assert lines.frequency == pytest.approx([40.0])
    assert lines.power == pytest.approx([(2 * 0.25 * 1e-6) ** 2 / 2], rel=1e-3, abs=0)


@pytest.mark.parametrize(("shape", "direction"), [("pulse", 0.0), ("edge", 0.0), ("edge", 50.0)])
def test_events_have_the_spectrum_of_their_shape(
    tmp_path: Path, shape: str, direction: float
) -> None:
    """The reference is Campbell's theorem with one event's transform, integrated numerically."""
    texture = authored(
        tmp_path,
        "[[events]]\ndensity_per_mm2 = 0.5\namplitude_um = 3.0\namplitude_sd = 0.3\n"
        f'width_mm = 0.3\nshape = "{shape}"\ndirection_deg = {direction}\n',
    )
    lines = commanded_lines(texture, speed=0.08, normal_force=0.5)
    sigma, turn = 0.3e-3 / 2.354820045, np.radians(direction)
    rate = 0.5e6 * (3e-6) ** 2 * np.exp(2 * 0.3**2)

    def density(f: float) -> float:
        k = 2 * np.pi * f / 0.08

        def one(q: float) -> float:
            size = 2 * np.pi * sigma**2 * np.exp(-(sigma**2) * (k**2 + q**2) / 2)
            if shape == "edge":
                size *= np.exp(0.5) * sigma * (k * np.cos(turn) + q * np.sin(turn))
            return float(size**2)

        across = quad(one, -8 / sigma, 8 / sigma, points=[0.0])[0] / (2 * np.pi)
        return float(2 * rate * across / 0.08)

    for low, high in ((20.0, 40.0), (200.0, 300.0)):
        ends = EVENT_EDGES[(low <= EVENT_EDGES) & (high >= EVENT_EDGES)]
        inside = (lines.frequency > ends[0]) & (lines.frequency < ends[-1])
        expected = quad(density, ends[0], ends[-1], epsabs=0)[0]
        assert lines.power[inside].sum() == pytest.approx(expected, rel=1e-6, abs=0)


@pytest.mark.parametrize("name", ["leather-suede", "wood-oak", "plastic-abs-vdi27"])
@pytest.mark.ci
def test_bands_are_those_of_a_rendered_stroke(name: str) -> None:
    """The reference is Welch's method over eight surfaces of 10 s, which knows bands to 0.1 dB."""
    line = Trajectory.line(speed=0.08, angle=0.2, duration=10.0, normal_force=0.5)
    shown = few(load_display("reference-24"), 0, 5, 9, 14, 18, 23)
    texture = load_texture(name)
    strokes = [spectrum(render(shown, texture, line, seed=k).shear[800:]) for k in range(8)]
    measured = band_sensation(strokes[0][0], np.mean([power for _, power in strokes], axis=0))
    lines = commanded_lines(texture, speed=0.08, normal_force=0.5, angle=0.2)
    inside = (CENTERS > 35) & (CENTERS < 600)
    difference = band_sensation(lines.frequency, lines.power)[inside] - measured[inside]
    assert np.abs(difference).max() < 0.4
    assert np.abs(difference.mean()) < 0.1


@pytest.mark.ci
def test_bands_of_waves_and_their_sidebands_are_those_of_a_rendered_stroke(tmp_path: Path) -> None:
    """Every third band has power, with an envelope of half depth; 8 surfaces of 10 s give 0.4 dB.

    The bands between have sidebands, whose first order is within 1.2 dB; up to 125 Hz, they would
    be 20 dB lower without it. Speeds differ by up to 2 %, so that the mean does not depend on where
    the few waves at the edge of a band fall, which stand in columns 3 Hz apart.
    """
    level = ", ".join("-10.0" if n % 3 == 0 else "-60.0" for n in range(16))
    bands = ", ".join(f"{0.5 * 10 ** (n / 10):.5g}" for n in range(16))
    texture = authored(
        tmp_path,
        f"[stochastic]\nfrequency_per_mm = [{bands}]\nlevel_db = [{level}]\n"
        "am_depth = 0.5\nam_corner_per_mm = 0.2\ndirection_spread_deg = 1.0\n",
    )
    shown = few(load_display("reference-24"), 0)
    speeds = 0.08 * np.linspace(0.98, 1.02, 8)
    paths = [Trajectory.line(speed=v, duration=10.0, normal_force=0.5) for v in speeds]
    shear = [render(shown, texture, path, seed=k).shear[800:] for k, path in enumerate(paths)]
    powers = [spectrum(one) for one in shear]
    measured = band_sensation(powers[0][0], np.mean([power for _, power in powers], axis=0))
    lines = [commanded_lines(texture, speed=v, normal_force=0.5) for v in speeds]
    frequency, power = (
        np.concatenate([getattr(x, n) for x in lines]) for n in ("frequency", "power")
    )
    predicted = band_sensation(frequency, power / len(speeds))
    inside = (CENTERS > 35) & (CENTERS < 1000) & (predicted > predicted.max() - 30)
    assert np.count_nonzero(inside) >= 8
    own = predicted > predicted.max() - 12
    assert np.abs(predicted - measured)[inside].max() < 1.2
    assert np.abs(predicted - measured)[inside & own].max() < 0.4


def test_drive_is_predicted_from_the_lines(
    pair: Display, calf: Texture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(strength, "PLACES", 24)
    found = texture_strength(pair, calf)
    assert found.predicted_rms == pytest.approx(found.drive_rms, rel=0.05)


def test_where_the_inverse_is_bounded_less_than_asked_for_is_played(
    tmp_path: Path, pair: Display
) -> None:
    """Full drive of 0.1 V attains half of the smallest shear that anyone feels."""
    weak = few(pair, 0, volts=0.1)
    found = texture_strength(weak, ribs(tmp_path, 250.0, 0.01))
    band = int(np.argmax(found.commanded))
    assert found.attainable[band] == pytest.approx(0.0529e-6, rel=0.02)
    share = found.attained[band] / found.commanded[band]
    assert share == pytest.approx(found.attainable[band] / 0.1e-6, rel=0.02)
    assert found.lost_db[band] == pytest.approx(-20 * np.log10(share))


def test_a_projecting_display_plays_the_cosine(tmp_path: Path, pair: Display) -> None:
    texture = ribs(tmp_path, 250.0, 1.0)
    turned = replace(pair, shear_direction=np.radians([60.0, 60.0]), projected=True)
    level = texture_strength(turned, texture).level.max()
    assert level == pytest.approx(texture_strength(pair, texture).level.max() - 6.02, abs=0.01)


# Limits


def test_too_much_is_limited_and_the_automatic_gain_is_not(pair: Display, calf: Texture) -> None:
    gain = automatic_gain(pair, calf)
    assert gain.limit == "voltage"
    assert played(pair, amplified(calf, gain.value), 0.6).limited_samples == 0
    assert played(pair, amplified(calf, 1.6 * gain.value), 10.0).limited_samples > 0
    assert texture_strength(pair, calf, gain=1.6 * gain.value).limited_share > 0
    as_found = texture_strength(pair, calf, gain=gain.value)
    assert as_found.limited_share == 0
    assert as_found.automatic == gain
    assert as_found.drive_peak == pytest.approx(gain.drive_peak)
    assert gain.drive_peak == pytest.approx(HEADROOM * pair.limits.voltage, rel=1e-6)
    assert 2 < gain.drive_peak / gain.drive_rms < 10


def test_friction_has_its_share_of_the_drive_kept_free(pair: Display, calf: Texture) -> None:
    bare = automatic_gain(pair, calf)
    dragging = load_texture("leather-calf", partials=192)
    assert dragging.descriptor.friction is not None
    gain = automatic_gain(pair, dragging)
    assert gain.value == pytest.approx((1 - STROKE_SHARE) * bare.value)
    assert gain.drive_peak == pytest.approx((1 - STROKE_SHARE) * bare.drive_peak)
    assert played(pair, amplified(dragging, gain.value), 0.6).limited_samples == 0


@pytest.mark.ci
@pytest.mark.parametrize("name", ["leather-suede", "leather-calf", "plastic-abs-vdi27"])
def test_half_a_minute_stays_within_the_limits_at_the_automatic_gain(name: str) -> None:
    shown, texture = load_display("reference-24"), without_friction(load_texture(name))
    gain = automatic_gain(shown, texture).value
    assert played(shown, amplified(texture, gain), 30.0).limited_samples == 0
    louder = amplified(texture, 1.8 * gain)
    assert played(shown, louder, 30.0).limited_samples > 0, "so that no drive is given away"


def test_the_automatic_gain_of_a_grating_is_what_the_limit_attains(
    tmp_path: Path, pair: Display
) -> None:
    """Sampled peaks of a sinusoid at 250 Hz, 32 samples a period, come within 0.5 %."""
    gain = automatic_gain(pair, ribs(tmp_path, 250.0, 2.0))
    able = reach(pair, STROKE).least_attainable(np.array([250.0]))[0]
    assert gain.value == pytest.approx(HEADROOM * able / 2e-6, rel=0.01)


@pytest.mark.parametrize("limit", ["slew", "current"])
def test_what_limits_is_told(tmp_path: Path, pair: Display, limit: str) -> None:
    """The 70 V at 700 Hz that a free tip survives rise by 0.3 V/µs."""
    slow = {"slew": 1e5} if limit == "slew" else {"current": 1e5 * pair.capacitance}
    limited = replace(pair, limits=replace(pair.limits, **slow))
    gain = automatic_gain(limited, ribs(tmp_path, 700.0, 2.0))
    assert gain.limit == limit
    able = reach(limited, STROKE).least_attainable(np.array([700.0]))[0]
    assert gain.value == pytest.approx(HEADROOM * able / 2e-6, rel=0.01)
    assert able < 0.4 * reach(pair, STROKE).least_attainable(np.array([700.0]))[0]


def test_an_asked_level_is_reached_where_the_limits_allow_it(pair: Display, calf: Texture) -> None:
    """A band that crosses its threshold begins to count: at 20 dB SL a step of 0.04 dB."""
    most = automatic_gain(pair, calf)
    gain = automatic_gain(pair, calf, level=20.0)
    assert gain.limit == "level"
    assert gain.level == pytest.approx(20.0, abs=0.05)
    assert gain.value < most.value
    channels = texture_strength(pair, calf, gain=gain.value).channels
    assert max(channels.values()) == pytest.approx(20.0, abs=0.05)
    assert automatic_gain(pair, calf, level=90.0) == most


def test_a_faint_trial_is_the_drive_of_the_whole(pair: Display, calf: Texture) -> None:
    """`render` takes the delay off, the trial only what settles: 160 samples of the first place."""
    whole, late = played(pair, calf, 0.3).drive, Renderer(pair, None).delay
    found = trial(pair, calf, STROKE).drive[0]
    np.testing.assert_allclose(found, whole[160 - late : 2160 - late], atol=1e-4)


def test_a_trial_settles_at_every_place(pair: Display, calf: Texture) -> None:
    """The third place's drive is that of a stroke that began there, less the time to settle."""
    golden = (5**0.5 - 1) / 2  # places are spread over 10 m by its powers
    start = 10.0 * (2 * np.array([golden, golden**0.5]) % 1)
    line = Trajectory([0.0, 0.3], [start, start + np.array([0.024, 0.0])], 0.5)
    whole, late = render(pair, calf, line).drive, Renderer(pair, None).delay
    found = trial(pair, calf, STROKE).drive[2]
    np.testing.assert_allclose(found, whole[160 - late : 2160 - late], atol=2e-3)


@pytest.mark.ci
def test_two_displays_are_equally_strong_as_rendered(
    pair: Display, calf: Texture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One has a fifth of the voltage and a finger that loads it more; 20 s of stroke each.

    Equal within 0.1 dB; from the predicted level both may be off by chance: a wave of the envelope
    that runs across the stroke stays where it is, up to 0.5 dB off, and there are several.
    """
    monkeypatch.setattr(strength, "PLACES", 24)
    other = replace(few(pair, 1, volts=20.0), name="weak", load=FingerLoad.high())
    equal = equal_gain([pair, other], calf)
    assert equal.weakest == "weak"
    assert equal.gains[0].limit == "level"
    levels = []
    for shown, gain in zip((few(pair, 1), other), equal.gains, strict=True):
        stroke = played(shown, amplified(calf, gain.value), 20.0)
        assert stroke.limited_samples == 0
        levels.append(felt(*spectrum(skin(shown, stroke.drive)[800:-800], 8000)))
    assert levels[0] == pytest.approx(levels[1], abs=0.1)
    assert levels[0] == pytest.approx(equal.level, abs=0.8)


# Doors


def test_a_gain_multiplies_all_that_a_texture_does(tmp_path: Path, pair: Display) -> None:
    """Waves (of calf), gratings and events alike."""
    mixed = authored(
        tmp_path,
        "[[periodic]]\nwavelength_mm = 1.0\nharmonics_um = [1.0]\n"
        "[[events]]\ndensity_per_mm2 = 0.1\namplitude_um = 3.0\nwidth_mm = 0.5\n",
    )
    calf = load_texture("leather-calf")
    mixed = replace(
        mixed, wave_vector=calf.wave_vector, amplitude=calf.amplitude, density=calf.density
    )
    once, twice = (played(pair, one, 0.2).shear for one in (mixed, amplified(mixed, 2.0)))
    np.testing.assert_allclose(twice, 2 * once, atol=1e-5 * np.abs(once).max())


def test_a_run_takes_a_gain_and_tells_it(pair: Display, calf: Texture) -> None:
    line = Trajectory.line(speed=0.08, duration=0.2)
    one, three = (run(pair, calf, line, device="mock:", gain=g) for g in (1.0, 3.0))
    assert (one.gain, three.gain) == (1.0, 3.0)
    assert one.commanded is not None
    assert three.commanded is not None
    vibration = one.commanded.vibration_um_rms
    assert three.commanded.vibration_um_rms == pytest.approx(3 * vibration, rel=1e-4)


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ({"speed": 0.0}, "a finger at rest feels no texture"),
        ({"speed": float("nan")}, "speed nan m/s"),
        ({"normal_force": 0.0}, "normal_force 0 N: must be above 0.05"),
    ],
)
def test_a_stroke_without_motion_or_touch_is_refused(what: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        SteadyStroke(**what)


def test_a_negative_gain_and_no_display_are_refused(calf: Texture) -> None:
    with pytest.raises(InputError, match="gain -1: must be a number from 0"):
        amplified(calf, -1.0)
    with pytest.raises(InputError, match="needs at least one display"):
        equal_gain([], calf)


def test_a_texture_that_is_silent_has_no_automatic_gain(tmp_path: Path, pair: Display) -> None:
    with pytest.raises(InputError, match="nothing to play"):
        automatic_gain(pair, ribs(tmp_path, 1300.0, 1.0))


def test_the_command_tells_bands_channels_and_gains(tmp_path: Path, command: Command) -> None:
    ribs(tmp_path, 250.0, 0.5)
    told = ["strength", tmp_path / "authored.toml", "--display", "reference-24"]
    code, out, _ = command(*told, "--display", "reference-64", "--json")
    facts: Any = json.loads(out)
    assert code == 0
    (band,) = (b for b in facts["displays"][0]["bands"] if b["level_db_sl"] is not None)
    assert EDGES[24] < 250 < EDGES[25]
    assert band["commanded_um_rms"] == pytest.approx(0.5 / np.sqrt(2))
    assert band["level_db_sl"] == pytest.approx(20 * np.log10(0.5 / 0.045), abs=0.05)
    assert facts["displays"][0]["felt_by"] == ["P"]
    assert facts["equal"]["displays"] == ["reference-24", "reference-64"]
    code, out, _ = command(*told)
    assert code == 0
    assert "P, Pacini" in out
    assert "gain with headroom" in out


def test_play_takes_the_automatic_gain(tmp_path: Path, command: Command) -> None:
    ribs(tmp_path, 250.0, 0.5)
    play = ["play", tmp_path / "authored.toml", "--device", "mock:", "--seconds", "0.2"]
    code, out, _ = command(*play, "--gain", "auto", "--json")
    summary = json.loads(out)
    assert code == 0
    assert summary["limited_samples"] == 0
    assert summary["gain_limit"] == "voltage"
    assert 98 < summary["peak_drive_v"] <= 100
    code, out, _ = command(*play, "--gain", "auto")
    assert "the largest of this stroke within the voltage limit" in " ".join(out.split())
    code, _, err = command(*play, "--gain", "loud")
    said = "tactile: --gain loud: must be auto or a number between 0 and 1000\n"
    assert (code, err) == (2, said)
