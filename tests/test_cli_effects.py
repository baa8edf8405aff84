"""Effects from files of others: ``tactile convert`` writes them, ``play`` plays them."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_rig import Command, assert_mistake, recorded
from format_samples import sample

import tactile
from tactile.texture.formats.synthesis import duration

TAP = {
    "Version": 1.0,
    "Pattern": [
        {"Event": {
            "Time": 0.0, "EventType": "HapticTransient",
            "EventParameters": [
                {"ParameterID": "HapticIntensity", "ParameterValue": 1.0},
                {"ParameterID": "HapticSharpness", "ParameterValue": 0.6},
            ],
        }},
    ],
}  # fmt: skip
"""Tap of 206 Hz: a sharpness of 0.6 lies there between 65 and 300 Hz."""
HERTZ, PERIODS, FADE = 206.0, 5, 0.02
"""Frequency of the tap [Hz], whole periods of it in about 22 ms, and fade of the display [s]."""


@pytest.fixture
def tap(command: Command) -> Path:
    """Return the tap as an effect file that ``tactile convert`` wrote."""
    Path("tap.ahap").write_text(json.dumps(TAP))
    assert command("convert", "tap.ahap", "tap.toml").code == 0
    return Path("tap.toml")


def test_play_gives_every_contactor_the_shear_of_the_effect(tap: Path, command: Command) -> None:
    """The commanded shear is the sine of the tap after the fade, within single precision.

    What the simulated display plays of it is 40 dB above its error: the equalizer is within 0.03 dB
    of the inverse response up to 1 kHz, and a tap has little above that.
    """
    s = command("play", tap, "--record", "tap.npz", "--json").json
    r = recorded(Path("tap.npz"))
    time = r["time_s"] - FADE
    sounds = (time > -1e-9) & (time < PERIODS / HERTZ - 0.5 / 8000)  # whole samples of an effect
    wave = np.where(sounds, np.sin(2 * np.pi * HERTZ * time), 0.0)
    expected = np.broadcast_to(10e-6 * wave[:, None], r["shear_target_m"].shape)
    np.testing.assert_allclose(r["shear_target_m"], expected, rtol=0, atol=1e-11)
    assert r["time_s"][-1] == pytest.approx(PERIODS / HERTZ + 2 * FADE, abs=2 / 8000)
    assert np.all(r["position_mm"] == 0)
    assert s["signal_to_error_db"] > 40
    assert (s["texture"], s["put_out_share"], s["limited_samples"]) == ("tap", 1.0, 0)


def test_a_gain_multiplies_an_effect(tap: Path, command: Command) -> None:
    s = command("play", tap, "--gain", 2, "--device", "mock:", "--json").json
    assert s["commanded"]["peak_um"] == pytest.approx(20, rel=1e-2)  # 39 samples a turn


def test_too_strong_an_effect_is_limited(tap: Path, command: Command) -> None:
    s = command("play", tap, "--gain", 100, "--device", "mock:", "--json").json
    assert s["limited_samples"] > 0
    assert s["peak_drive_v"] <= 100


def test_the_report_of_an_effect_says_what_was_assumed(tap: Path, command: Command) -> None:
    result = command("play", tap)
    assert (result.code, result.err) == (0, "")
    assert result.out.startswith("Played tap")
    assert "an amplitude of 1 is taken as 10 µm" in result.out


def test_an_effect_that_was_not_put_out_exits_with_1(command: Command) -> None:
    Path("long.toml").write_text(
        "[effect]\n[[effect.perceptions]]\n[[effect.perceptions.channels]]\n"
        '[[effect.perceptions.channels.bands]]\nkind = "wave"\n'
        "[[effect.perceptions.channels.bands.segments]]\n"
        "keyframes = [{ time_s = 0.0, amplitude = 0.5 }, { time_s = 2.0, amplitude = 0.5 }]\n"
    )
    device = "mock:?link=serial&bit_rate=3000000&disconnect_s=0.5"
    result = command("play", "long.toml", "--device", device, "--quiet")
    assert (result.code, result.out) == (1, "")
    assert "the device is gone" in result.err


@pytest.mark.parametrize(
    "name",
    ["haptic/valid_required_v1.haptic", "ahap/valid_required.ahap", "wav/wav_int16_3c.wav",
     "hjif/texture_template.hjif"],
)  # fmt: skip
def test_files_of_others_play_without_a_conversion(name: str, command: Command) -> None:
    effect = tactile.load_effect(sample(name))
    s = command("play", sample(name), "--device", "mock:", "--json").json
    assert s["texture"] == Path(name).stem
    assert s["put_out_share"] == 1.0
    assert s["peak_drive_v"] > 0
    assert s["seconds"] == pytest.approx(duration(effect) + 2 * FADE, abs=2 / 8000)


@pytest.mark.parametrize("option", ["--seconds", "--speed-mm-s", "--angle-deg", "--path"])
def test_an_effect_takes_no_stroke(option: str, tap: Path, command: Command) -> None:
    said = f"{option} cannot be used with {tap}, which is an effect and needs no stroke"
    assert_mistake(command("play", tap, option, 1), said)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = 1\n", "neither a texture nor an effect: has no [texture] and no [effect]"),
        ("x =\n", "not valid TOML"),
        ("[effect]\n", "x: has nothing to play"),
        ("[effect]\nname = 1\n", "effect.name: unknown key"),
        ("[effect]\n[texture]\n", "effect: unknown key"),
    ],
)
def test_what_is_no_effect_is_refused_in_a_line(text: str, said: str, command: Command) -> None:
    Path("x.toml").write_text(text)
    assert_mistake(command("play", "x.toml"), said)


@pytest.mark.parametrize("suffix", ["h5", "npz"])
def test_a_recorded_effect_is_replayed_from_the_recording_alone(
    tap: Path, command: Command, suffix: str
) -> None:
    assert command("play", tap, "--gain", "0.7", "--record", f"tap.{suffix}").code == 0
    tap.unlink()
    again = command("replay", f"tap.{suffix}", "--json")
    assert (again.code, again.err) == (0, "")
    assert again.json["compared_samples"] == again.json["planned_samples"] > 100
    waveform = tactile.load_recording(f"tap.{suffix}")["waveform_m"]
    assert 1e-6 < np.abs(waveform).max() < 1e-5


def test_an_effect_has_no_automatic_gain(tap: Path, command: Command) -> None:
    assert_mistake(
        command("play", tap, "--gain", "auto"), "gain auto cannot be used with the effect tap"
    )


def test_a_link_of_spectrum_frames_refuses_an_effect(tap: Path, command: Command) -> None:
    device = "mock:?link=can"
    assert_mistake(command("play", tap, "--device", device), "tap: is an effect, and the link")


# Show


def test_show_draws_the_waveform_and_the_spectrum(tap: Path, command: Command) -> None:
    """Nearly all of a tap of 206 Hz lies in the third octave of 200 Hz, at an rms of 10 µm / √2."""
    result = command("show", tap)
    assert (result.code, result.err) == (0, "")
    assert "shear over 0.0243 s, −10 … 10 µm" in result.out
    assert "spectrum of the effect" in result.out
    assert max(map(len, result.out.splitlines())) <= 100
    (band,) = [line for line in result.out.splitlines() if line.strip().startswith("200 ")]
    assert "µm" in band
    s = command("show", tap, "--json").json
    assert s["peak_um"] == pytest.approx(10, rel=0.01)
    assert s["rms_um"] == pytest.approx(10 / np.sqrt(2), rel=0.01)
    strongest = int(np.argmax(s["third_octave_um"]))
    assert s["third_octave_hz"][strongest] == pytest.approx(200)
    assert s["third_octave_um"][strongest] == pytest.approx(10, rel=0.05)
    assert 200 in s["felt_hz"]


def test_show_writes_a_plot_of_an_effect(tap: Path, command: Command) -> None:
    assert command("show", tap, "--plot", "tap.svg").out == "drawn: tap.svg\n"
    assert Path("tap.svg").read_text().count('id="axes_') == 2


def test_show_takes_no_speed_for_an_effect(tap: Path, command: Command) -> None:
    said = f"--speed-mm-s cannot be used with {tap}, which is an effect"
    assert_mistake(command("show", tap, "--speed-mm-s", 80), said)
