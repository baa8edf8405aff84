"""Textures to and from other people's formats: Penn's models, .hjif and WAV at a speed.

Penn's models may not be shipped: the ones here are made from filters of our own, written as the
toolkit writes them, so that spectrum and interpolation are known without it.
"""

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_rig import Command
from format_samples import sample
from numpy.typing import NDArray
from scipy.io import wavfile
from scipy.signal import freqz, lfilter, welch

import tactile
from tactile.arrays import Floats
from tactile.errors import InputError, NotFoundError
from tactile.texture import descriptor as descriptors
from tactile.texture.formats import load_effect, surface_effect, synthesize
from tactile.texture.formats.conversion import convert_file
from tactile.texture.formats.hatt import (
    ModelSet,
    load_model,
    polynomial,
    texture_from,
)

RATE = 2000.0
A = np.poly([0.9 * np.exp(0.6j), 0.9 * np.exp(-0.6j), 0.5 * np.exp(2j), 0.5 * np.exp(-2j), 0.3])
B = np.poly([0.7 * np.exp(1.1j), 0.7 * np.exp(-1.1j)])
POINTS = [(0, 0), (200, 0), (200, 4), (0, 4), (100, 2)]
TRIANGLES = [(1, 2, 5), (2, 3, 5), (3, 4, 5), (4, 1, 5)]
VARIANCE = [0.0, 0.0, 0.08, 0.0, 0.02]


def lsf(a: NDArray[Any]) -> Floats:
    """Return the line spectral frequencies of a polynomial: roots of its sum and difference."""
    whole = np.append(a, 0.0)
    angles = np.concatenate([np.angle(np.roots(whole + s * whole[::-1])) for s in (1, -1)])
    return np.asarray(np.sort(angles[(angles > 1e-6) & (angles < math.pi - 1e-6)]))


def listed(name: str, values: Any) -> str:
    return f"<{name}>" + "".join(f"<value>{v}</value>" for v in values) + f"</{name}>"


def model_set(path: Path, *, ma: bool = True, material: str = "Stained Wood", **lists: Any) -> Path:
    ar = lists.get("ar", [lsf(A)] * len(POINTS))
    models = "".join(
        f"<model>{listed('ARlsf', ar[i])}{listed('MAlsf', lsf(B)) if ma else ''}"
        f"<var>{VARIANCE[i]}</var><gain>{1.5 + 0.5 * i}</gain>"
        f"<speedMod>{v}</speedMod><forceMod>{n}</forceMod></model>"
        for i, (v, n) in enumerate(POINTS)
    )
    triangles = "".join(listed("tri", t) for t in lists.get("triangles", TRIANGLES))
    path.write_text(
        '<?xml version="1.0" encoding="utf-8"?>\n<modelSet texture="1">'
        f"<material>{material}</material><SampleRate>{RATE:g}</SampleRate><mu>0.3</mu>"
        f"<maxSpeed>200</maxSpeed><maxForce>4</maxForce>{triangles}{models}</modelSet>"
    )
    return path


@pytest.fixture
def model(tmp_path: Path) -> ModelSet:
    return load_model(model_set(tmp_path / "Models_Wood.xml"))


# Penn's models


@pytest.mark.parametrize("order", [1, 2, 5, 6, 12, 19])
def test_a_polynomial_comes_back_from_its_line_spectral_frequencies(order: int) -> None:
    rng = np.random.default_rng(order)
    zeros = rng.uniform(0.2, 0.95, order // 2) * np.exp(1j * rng.uniform(0.1, 3.0, order // 2))
    a = np.poly([*zeros, *zeros.conj(), *([0.4] if order % 2 else [])]).real
    assert polynomial(lsf(a)) == pytest.approx(a, abs=1e-8)


def test_at_a_model_the_spectrum_is_the_models_and_noise_has_it(model: ModelSet) -> None:
    f = np.linspace(5, 995, 400)
    _, h = freqz(3.5 * B, A, worN=f, fs=RATE)
    want = 2 * 0.02 * np.abs(h) ** 2 / RATE
    assert model.acceleration_psd(f, 0.1, 2.0) == pytest.approx(want, rel=1e-6)
    b, a, variance = model.filter_at(0.1, 2.0)
    noise = np.sqrt(variance) * np.random.default_rng(1).standard_normal(204_096)
    x = lfilter(b, a, noise)[4096:]
    at, density = welch(x, RATE, nperseg=512)
    expected = model.acceleration_psd(at[5:-5], 0.1, 2.0)
    assert 10 * np.log10(density[5:-5] / expected) == pytest.approx(0, abs=1.2)
    assert np.var(x) == pytest.approx(np.trapezoid(want, f), rel=0.05)


def test_between_models_they_are_weighed_by_the_triangle(model: ModelSet) -> None:
    """Variance and gain are means at a third from each corner of (200, 0), (200, 4), (100, 2)."""
    b, a, variance = model.filter_at(0.5 / 3, 2.0)
    assert variance == pytest.approx((0 + 0.08 + 0.02) / 3)
    assert b == pytest.approx((2.0 + 2.5 + 3.5) / 3 * B, abs=1e-8)
    assert a == pytest.approx(A, abs=1e-8)


def test_interpolated_filters_are_stable(tmp_path: Path) -> None:
    other = np.poly([0.98 * np.exp(2.5j), 0.98 * np.exp(-2.5j), 0.9, -0.5, 0.1])
    mixed = load_model(model_set(tmp_path / "x.xml", ar=[lsf(A), lsf(other)] * 2 + [lsf(A)]))
    for speed in np.linspace(0, 0.2, 9):
        for force in np.linspace(0, 4, 9):
            assert np.all(np.abs(np.roots(mixed.filter_at(speed, force).a)) < 1)


def test_beyond_what_was_recorded_the_models_are_held(model: ModelSet) -> None:
    f = np.array([100.0])
    at_most = model.acceleration_psd(f, 0.2, 4.0)
    assert model.acceleration_psd(f, 5.0, 50.0) == pytest.approx(at_most)
    assert model.acceleration_psd(f, -0.2, 4.0) == pytest.approx(at_most)
    assert model.acceleration_psd(f, 0.0, 4.0) == pytest.approx(0.0)
    assert model.acceleration_psd(np.array([1001.0]), 0.2, 4.0) == 0.0


def test_a_model_without_a_moving_average_is_one_of_gain_one(tmp_path: Path) -> None:
    b, a, _ = load_model(model_set(tmp_path / "x.xml", ma=False)).filter_at(0.1, 2.0)
    assert b.tolist() == [1.0]
    assert a == pytest.approx(A, abs=1e-8)


def test_a_models_texture_has_its_displacement_spectrum_in_space(model: ModelSet) -> None:
    """Band by band: ∫ S_a/(2πf)⁴ df over the band in time is the variance of the band in space."""
    texture, told = texture_from(model, 0.1, 2.0)
    assert texture.texture.category == "wood"
    assert "not to be redistributed" in texture.texture.license
    assert any("assumed" in line for line in told)
    s = texture.stochastic
    assert s is not None
    for k, level in zip(s.frequency_per_mm, s.level_db, strict=True):
        f = np.linspace(k * 100 * 10**-0.05, k * 100 * 10**0.05, 2001)
        if f[0] < 20:
            continue
        _, h = freqz(3.5 * B, A, worN=f, fs=RATE)
        acceleration = 2 * 0.02 * np.abs(h) ** 2 / RATE
        variance = np.trapezoid(acceleration / (2 * np.pi * f) ** 4, f) * 1e12
        width = (f[-1] - f[0]) / 100
        assert level == pytest.approx(10 * math.log10(variance / width), abs=0.1)


def test_a_models_force_law_is_that_of_its_variance(tmp_path: Path) -> None:
    """The law is fitted from half to twice 2 N at 100 mm/s, and gains change as well."""
    model = load_model(model_set(tmp_path / "x.xml"))
    f = np.geomspace(20, 1000, 4000)
    power = [
        np.trapezoid(model.acceleration_psd(f, 0.1, n) / (2 * np.pi * f) ** 4, f) for n in (1, 4)
    ]
    want = math.log(power[1] / power[0]) / 2 / math.log(4)
    assert texture_from(model, 0.1, 2.0)[0].laws.force_exponent == pytest.approx(want, abs=0.01)


@pytest.mark.parametrize(
    ("lists", "reason"),
    [
        ({"triangles": [(1, 2, 9)]}, "tri = '9': must be 1 … 5"),
        ({"triangles": [(1, 2)]}, "needs triangles"),
        ({"triangles": []}, "needs triangles"),
        ({"ar": [[0.5, 0.4]] * 5}, "model 1: ARlsf has 2 values: must be 1 … 64 that ascend"),
        ({"ar": [[0.5, 4.0]] * 5}, "ARlsf = '4.0': must be 0 … 3.14159"),
        ({"ar": [["nan"]] * 5}, "ARlsf = 'nan'"),
        ({"ar": [[]] * 5}, "model 1: ARlsf has 0 values"),
        ({"ar": [[0.5], [0.5, 1.0], [0.5], [0.5], [0.5]]}, "different numbers of values"),
    ],
)
def test_a_model_set_with_a_fault_is_refused_in_a_line(
    lists: dict[str, Any], reason: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as refused:
        load_model(model_set(tmp_path / "x.xml", **lists))
    assert reason in str(refused.value)


def test_a_speed_that_was_not_recorded_or_does_not_sound_is_refused(model: ModelSet) -> None:
    with pytest.raises(InputError, match="300 mm/s: was recorded up to 200"):
        texture_from(model, 0.3)


# Converting


def test_a_model_becomes_a_texture_that_can_be_played(tmp_path: Path) -> None:
    source, target = model_set(tmp_path / "Models_Wood.xml"), tmp_path / "my-wood.toml"
    done = convert_file(str(source), target, speed=0.1)
    assert done.became == "texture"
    texture = tactile.load_texture(target, partials=128)
    assert texture.name == "my-wood"
    assert texture.partials.amplitude.any()


def test_a_texture_file_must_have_a_name_that_a_texture_can_have(tmp_path: Path) -> None:
    source = model_set(tmp_path / "x.xml")
    with pytest.raises(InputError, match=r"My Wood\.toml: not written: texture\.id = 'My Wood'"):
        convert_file(str(source), tmp_path / "My Wood.toml")
    assert not (tmp_path / "My Wood.toml").exists()


RIBBED = "plastic-acrylic-ribbed"


@pytest.fixture(scope="module")
def ribbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[str, ...]]:
    """Return a texture at 80 mm/s as .hjif, and what was told."""
    target = tmp_path_factory.mktemp("ribbed") / "ribbed.hjif"
    return target, convert_file(RIBBED, target, speed=0.08).lost


def test_a_texture_as_wav_has_the_power_of_its_waves_at_their_frequencies(
    ribbed: tuple[Path, tuple[str, ...]], tmp_path: Path
) -> None:
    """The file, read by scipy, agrees with the surface's wave vectors and law within 2 %."""
    speed, target = 0.08, tmp_path / "out.wav"
    convert_file(str(ribbed[0]), target)
    (told,) = [line for line in ribbed[1] if "µm of displacement" in line]
    reach = float(told.split()[5]) * 1e-6
    rate, x = wavfile.read(target)
    assert (rate, x.shape) == (8000, (8000,))
    assert np.abs(x).max() == pytest.approx(1.0, abs=1e-6)
    texture = tactile.load_texture(RIBBED)
    low, high = texture.laws.speed_range_mm_s
    reference = texture.descriptor.reference.speed_mm_s
    law = (np.clip(80, low, high) / np.clip(reference, low, high)) ** texture.laws.speed_exponent
    f = np.abs(texture.partials.wave_vector[:, 0]) * speed / (2 * np.pi)
    power = (law * texture.partials.amplitude) ** 2 / 2
    density = np.abs(np.fft.rfft(x * reach)) ** 2 * 2 / 8000**2
    assert density.sum() == pytest.approx(power[(f >= 0.5) & (f < 1000.5)].sum(), rel=0.02)
    for first, last in pairwise([20, 50, 125, 315, 800]):
        want = power[(f >= first + 0.5) & (f < last + 0.5)].sum()
        assert density[first + 1 : last + 1].sum() == pytest.approx(want, rel=0.02, abs=1e-18)


def test_a_texture_comes_back_from_hjif_with_its_keyword_and_its_power(
    ribbed: tuple[Path, tuple[str, ...]], tmp_path: Path
) -> None:
    there, back = ribbed[0], tmp_path / "again.toml"
    data = json.loads(there.read_text())
    (perception,) = data["perceptions"]
    assert perception["perception_modality"] == "Vibrotactile Texture"
    assert perception["reference_devices"][0]["type"] == "Piezo"
    effects = perception["channels"][0]["bands"][0]["effects"]
    assert {e["semantic_keywords"] for e in effects} == {"Texture/Plastic"}
    assert "effect_semantic_scheme" not in perception
    convert_file(str(there), back, speed=0.08)
    texture = descriptors.load(back)
    assert texture.texture.category == "plastic"
    ours = sum(p.harmonics_um[0] ** 2 for p in texture.periodic)
    effect = load_effect(there)
    reach = effect.perceptions[0].reference_devices[0].maximum_displacement_mm
    assert reach is not None
    theirs = np.mean((synthesize(effect, 8000)[:, 0] * reach * 1e3) ** 2) * 2
    assert ours == pytest.approx(theirs, rel=1e-6)


def grating(direction_deg: float) -> descriptors.Descriptor:
    part = descriptors.Periodic(
        wavelength_mm=0.8, harmonics_um=(2.0, 0.5), phases_deg=(30.0, -60),
        direction_deg=direction_deg,
    )  # fmt: skip
    about = descriptors.About(
        id="ribs", category="metal", description="", provenance="authored", source="x",
        license="CC0-1.0",
    )  # fmt: skip
    reference = descriptors.Reference(speed_mm_s=80, normal_force_n=1)
    return descriptors.Descriptor(texture=about, reference=reference, periodic=(part,))


@pytest.mark.parametrize("direction_deg", [0, 180, 60])
def test_a_grating_sounds_as_its_displacement_along_the_stroke(direction_deg: float) -> None:
    effect, _ = surface_effect.effect_of(grating(direction_deg), 0.08)
    reach = effect.perceptions[0].reference_devices[0].maximum_displacement_mm
    assert reach is not None
    x = 0.08 * np.arange(8000) / 8000 * math.cos(math.radians(direction_deg)) / 0.8e-3
    want = 2e-3 * np.cos(2 * np.pi * x + math.radians(30)) + 0.5e-3 * np.cos(
        4 * np.pi * x - math.radians(60)
    )
    assert synthesize(effect, 8000)[:, 0] * reach == pytest.approx(want, abs=1e-9)


def test_a_grating_comes_back_with_wavelength_amplitude_and_place(tmp_path: Path) -> None:
    effect, _ = surface_effect.effect_of(grating(0), 0.08)
    back, lost = surface_effect.texture_from(effect, 0.08, "ribs", "ribs.hjif")
    assert [p.wavelength_mm for p in back.periodic] == pytest.approx([0.8, 0.4])
    assert [p.harmonics_um[0] for p in back.periodic] == pytest.approx([2.0, 0.5])
    assert [p.phases_deg[0] for p in back.periodic] == pytest.approx([30, -60])
    assert back.texture.category == "metal"
    assert lost == ["each oscillation is a grating, as at 80 mm/s"]


def test_the_same_hjif_is_an_effect_without_a_speed_and_a_texture_with_one(tmp_path: Path) -> None:
    source = str(sample("hjif/texture_template.hjif"))
    assert convert_file(source, tmp_path / "effect.toml").became == "effect"
    assert "[effect]" in (tmp_path / "effect.toml").read_text()
    done = convert_file(source, tmp_path / "wood.toml", speed=0.06)
    assert done.became == "texture"
    texture = descriptors.load(tmp_path / "wood.toml")
    assert texture.texture.category == "wood"
    assert [p.wavelength_mm for p in texture.periodic] == pytest.approx([1.0, 0.24])
    assert [p.harmonics_um[0] for p in texture.periodic] == pytest.approx([60, 30])
    assert "a texture is one surface: 1 more channels left out" in done.lost


def test_what_has_no_texture_in_it_cannot_become_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no perception 'Vibrotactile Texture'"):
        convert_file(str(sample("hjif/synth2ch_8k_wav.hjif")), tmp_path / "x.toml", speed=0.06)


def test_a_texture_needs_a_speed_and_an_effect_has_no_use_for_one(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--speed-mm-s must give the speed"):
        convert_file("wood-oak", tmp_path / "x.hjif")
    with pytest.raises(InputError, match="cannot be used to convert an effect to an effect"):
        convert_file(str(sample("ahap/valid_fields.ahap")), tmp_path / "x.hjif", speed=0.1)
    with pytest.raises(
        NotFoundError, match="neither a file nor a texture; did you mean 'wood-oak'"
    ):
        convert_file("wood-oka", tmp_path / "x.hjif", speed=0.1)


def test_openxr_is_given_buffers_of_4000_that_are_appended(tmp_path: Path) -> None:
    target = tmp_path / "x.json"
    convert_file(str(sample("hjif/synth2ch_8k.wav")), target)
    data = json.loads(target.read_text())
    assert data["sampleRate"] == 8000
    assert [b["append"] for b in data["buffers"]] == [False, True]
    assert [b["bufferSize"] for b in data["buffers"]] == [4000, 4000]
    joined = [x for b in data["buffers"] for x in b["buffer"]]
    _, raw = wavfile.read(sample("hjif/synth2ch_8k.wav"))
    assert joined == pytest.approx((raw[:, 0] / 32768).tolist(), abs=1e-7)


# The command


def clip(path: Path) -> Path:
    path.write_text(
        '{"version":{"major":1},"metadata":{"author":"me"},"signals":{"continuous":{"envelopes":'
        '{"amplitude":[{"time":0,"amplitude":1},{"time":0.5,"amplitude":0}]}}},"more":1}'
    )
    return path


def test_the_command_tells_a_line_for_each_loss(command: Command, tmp_path: Path) -> None:
    source, target = clip(tmp_path / "x.haptic"), tmp_path / "x.hjif"
    said = command("convert", source, target)
    assert said.code == 0
    lost = ["ignored: more", ".hjif has no place for author"]
    want = [f"{target}: an effect, channels: 1, 0.5 s", *(f"  {line}" for line in lost)]
    assert said.out.splitlines() == want
    said = command("convert", source, target, "--force", "--json")
    assert said.code == 0
    facts = {"target": str(target), "became": "effect", "lost": lost, "channels": 1, "seconds": 0.5}
    assert json.loads(said.out) == facts


def test_the_command_overwrites_only_when_told_to(command: Command, tmp_path: Path) -> None:
    source, target = clip(tmp_path / "x.haptic"), tmp_path / "x.wav"
    target.write_text("mine")
    said = command("convert", source, target)
    assert said.code == 2
    assert said.err == f"tactile: {target}: already exists; --force overwrites it\n"
    assert target.read_text() == "mine"
    for bad, reason in (
        (tmp_path / "x.mp3", "cannot be written; there is: .haptic, .ahap"),
        (tmp_path / "no" / "x.wav", f"no folder {tmp_path / 'no'}"),
    ):
        said = command("convert", source, bad)
        assert said.code == 2
        assert reason in said.err
    said = command("convert", "wood-oak", tmp_path / "y.wav", "--speed-mm-s", 0)
    assert said.code == 2
    assert "--speed-mm-s 0: must be between 1 and 1000" in said.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["x.haptic", "x.wav"]
    assert command("convert", source, target, "--force").code == 0
    assert target.read_bytes()[:4] == b"RIFF"
