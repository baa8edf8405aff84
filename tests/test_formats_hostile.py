"""Tests of files that nobody should trust: each is read, or refused with one line."""

import io
import json
import os
import resource
import subprocess
import sys
import wave
from pathlib import Path

import numpy as np
import pytest
from format_samples import SAMPLES, sample
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tactile.errors import InputError, NotFoundError
from tactile.texture.formats import load_effect, save_effect, synthesize
from tactile.texture.formats.hatt import load_model
from tactile.texture.formats.wavelets import decoded

CLIP = '{"version":{"major":1},"signals":{"continuous":{"envelopes":{"amplitude":[%s]}}}}'
POINT = '{"time":0,"amplitude":0.5}'
LARGEST_FILE = 8 * 1024 * 1024
"""Largest size that a refusal states [bytes]: minutes of effects, as Python objects some 200 MB at
worst."""


def refusal(path: Path) -> str:
    """Return the one line that a file is refused with."""
    with pytest.raises(InputError) as refused:
        load_effect(path)
    line = str(refused.value)
    assert line.startswith(str(path))
    assert "\n" not in line
    assert len(line) < 600
    return line


def refused(tmp_path: Path, text: str | bytes, name: str = "x.haptic") -> str:
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return refusal(path).removeprefix(f"{path}: ")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not valid JSON"),
        ("[]", "must be a JSON object"),
        (CLIP % POINT[:-3], "not valid JSON"),
        ("[" * 100_000, "levels deep"),
        ('{"a":' * 900 + "1" + "}" * 900, "more than 32 levels deep"),
        ('{"a":' * 40 + "1" + "}" * 40, "more than 32 levels deep"),
        (CLIP % '{"time":NaN,"amplitude":1}', "amplitude[0].time = nan: must be a finite number"),
        (CLIP % '{"time":0,"amplitude":-Infinity}', "amplitude = -inf: must be a finite number"),
        (CLIP % '{"time":1e999,"amplitude":1}', "time = inf: must be a finite number"),
        (CLIP % ('{"time":1' + "0" * 5000 + ',"amplitude":1}'), "not valid JSON"),
        (CLIP % ('{"time":1' + "0" * 400 + ',"amplitude":1}'), "is larger than 2^53"),
        (CLIP % '{"time":0,"amplitude":1.5}', "amplitude[0].amplitude = 1.5: expected float <= 1"),
        (CLIP % '{"time":-1,"amplitude":1}', "amplitude[0].time = -1: expected float >= 0"),
        (CLIP % '{"time":"0","amplitude":1}', "amplitude[0].time = '0': expected float, got str"),
        (CLIP % '{"time":true,"amplitude":1}', "time = True: expected float, got bool"),
        (CLIP % '{"time":0}', "amplitude[0]: Object missing required field amplitude"),
        (CLIP % '{"time":0,"time":1,"amplitude":1}', "field 'time' occurs twice"),
        (CLIP % "", "amplitude: is empty"),
        (CLIP % POINT.replace("}", ',"emphasis":{"amplitude":0.1,"frequency":0}}'),
         "emphasis.amplitude = 0.1: must be at least the envelope's 0.5"),
        ('{"version":{"major":true}}', "version.major = True: must be 1"),
        ('{"version":1}', "version.major = None: must be 1"),
        ('{"a":"\\ud800"}', "a: is no valid text"),
        (b'\xff\xfe{"a":1}', "not valid JSON"),
    ],
)  # fmt: skip
def test_json_that_is_none_is_refused_in_a_line(
    text: str | bytes, reason: str, tmp_path: Path
) -> None:
    assert reason in refused(tmp_path, text)


def test_what_is_no_file_of_a_known_kind_is_refused_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be read; did you mean '\.haptic'\?"):
        load_effect(tmp_path / "x.haptics")
    with pytest.raises(NotFoundError, match=r"x\.haptic: no such file"):
        load_effect(tmp_path / "x.haptic")
    (tmp_path / "dir.hjif").mkdir()
    with pytest.raises(NotFoundError):
        load_effect(tmp_path / "dir.hjif")


def test_a_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "x.hjif"
    with path.open("wb") as file:
        file.truncate(100 * LARGEST_FILE)
    assert "is larger than 8 MiB" in refusal(path)


def hjif(tmp_path: Path, **changes: object) -> Path:
    keyframes = [{"relative_position": i, "amplitude_modulation": 0.5} for i in range(3)]
    content = {
        "version": "2023", "profile": "Main", "level": 1, "date": "2026-01-01", "description": "",
        "timescale": 1000, "avatars": [], "syncs": [],
        "perceptions": [{
            "id": 0, "avatar_id": 0, "description": "", "perception_modality": "Vibrotactile",
            "effect_library": [], "channels": [{
                "id": 0, "description": "", "gain": 1.0, "mixing_coefficient": 1.0,
                "body_part_mask": 0, "bands": [{
                    "band_type": "Curve", "lower_frequency_limit": 0,
                    "upper_frequency_limit": 1000, "effects": [
                        {"effect_type": "Basis", "position": 0, "keyframes": keyframes}]}]}]}],
    } | changes  # fmt: skip
    path = tmp_path / "x.hjif"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"timescale": 0}, "timescale = 0: expected int >= 1"),
        ({"version": "1"}, "version = '1'"),
        ({"profile": "Other"}, "profile = 'Other'"),
        ({"avatars": [None]}, "avatars[0]"),
        ({"syncs": [{"timestamp": None}]}, "syncs[0].timestamp: null is no value"),
        ({"perceptions": 3}, "perceptions = 3: expected array, got int"),
    ],
)
def test_a_hjif_that_does_not_fit_is_refused_in_a_line(
    changes: dict[str, object], reason: str, tmp_path: Path
) -> None:
    assert reason in refusal(hjif(tmp_path, **changes))


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('"Curve"', '"Curves"', "band_type = 'Curves': must be one of Curve, VectorialWave"),
        (
            '"relative_position": 1,',
            '"relative_position": 9,',
            "keyframes[2].relative_position = 2",
        ),
        ('"position": 0,', '"position": 4000000000,', "ends after more than an hour"),
        ('"position": 0,', '"position": -1,', "position = -1: expected int >= 0"),
        ('"gain": 1.0', '"gain": 1e300', "gain = 1e+300: expected float <= 1000"),
        ('"Basis"', '"Other"', "effect_type"),
    ],
)
def test_a_hjif_with_a_fault_inside_is_refused_in_a_line(
    old: str, new: str, reason: str, tmp_path: Path
) -> None:
    path = hjif(tmp_path)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    assert reason in refusal(path)


def test_a_library_entry_that_refers_to_itself_is_refused_in_a_line(tmp_path: Path) -> None:
    path = hjif(tmp_path)
    entry = '[{"effect_type": "Reference", "id": 3, "position": 0}]'
    path.write_text(path.read_text().replace('"effect_library": []', f'"effect_library": {entry}'))
    reason = "perceptions[0].effect_library[0] = Reference to effect 3: refers to itself"
    assert reason in refusal(path)


@pytest.mark.parametrize(
    ("stream", "length", "reason"),
    [
        ("AA=A", 128, "wavelet_stream has '=': must be base64"),
        ("AAAA", 100, "has blocks of 100 samples: must be a power of two, 16 … 16384"),
        ("AAAA", 2**15, "has blocks of 32768 samples"),
        ("AAAA", -128, "has blocks of -128 samples"),
        ("AAAA", 2**32, "1048576 at most"),
    ],
)
def test_wavelets_that_are_none_are_refused_in_a_line(
    stream: str, length: int, reason: str, tmp_path: Path
) -> None:
    path = hjif(tmp_path)
    text = path.read_text()
    content = json.loads(text)
    band = content["perceptions"][0]["channels"][0]["bands"][0]
    band |= {"band_type": "WaveletWave", "block_length": length}
    band["effects"] = [{"effect_type": "Basis", "position": 0, "wavelet_stream": stream}]
    path.write_text(json.dumps(content))
    assert reason in refusal(path)


@given(st.text("ABCDwxyz0189+/", max_size=200), st.sampled_from([16, 64, 256]))
@settings(max_examples=50, deadline=None)
def test_any_stream_of_wavelets_decodes_to_finite_samples(stream: str, count: int) -> None:
    samples = decoded(stream, count)
    assert samples.shape == (count,)
    assert np.all(np.isfinite(samples))


@pytest.mark.ci
def test_a_file_of_many_keyframes_is_refused_within_bounded_memory(tmp_path: Path) -> None:
    """The largest file there may be, of the smallest keyframes, in a process of 1 GiB."""
    path = hjif(tmp_path)
    few = '{"relative_position": 0, "amplitude_modulation": 0.5}'
    many = ",".join(['{"relative_position":0}'] * ((LARGEST_FILE - 2000) // 24))
    path.write_text(path.read_text().replace(few, many))
    assert path.stat().st_size < LARGEST_FILE
    code = (
        "import sys, resource, tactile\n"
        "try:\n    tactile.load_effect(sys.argv[1])\n"
        "except tactile.InputError as error:\n    print(error)\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True,
        env=os.environ, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (2**30, 2**30)),
    )  # fmt: skip
    assert "keyframes: 200000 at most" in run.stdout


def sound(frames: bytes, channels: int = 1, width: int = 2) -> bytes:
    file = io.BytesIO()
    with wave.open(file, "wb") as out:
        out.setnchannels(channels)
        out.setsampwidth(width)
        out.setframerate(8000)
        out.writeframes(frames)
    return file.getvalue()


def test_wav_of_every_width_is_full_scale_as_another_library_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "x.wav"
    for width in (2, 3, 4):
        low = (1 << (8 * width - 1)).to_bytes(width, "little")
        half = (1 << (8 * width - 2)).to_bytes(width, "little")
        path.write_bytes(sound(low + half, width=width))
        assert synthesize(load_effect(path), 8000)[:, 0].tolist() == [-1.0, 0.5]
    path.write_bytes(sound(bytes([0, 192]), width=1))
    assert synthesize(load_effect(path), 8000)[:, 0].tolist() == [-1.0, 0.5]


@pytest.mark.parametrize("cut", [0, 3, 11, 20, 30, 43, 100, 200])
def test_a_wav_cut_short_is_refused_in_a_line(cut: int, tmp_path: Path) -> None:
    refused(tmp_path, sound(bytes(400))[:cut], "x.wav")


def test_a_wav_without_samples_is_refused(tmp_path: Path) -> None:
    assert "has no samples" in refused(tmp_path, sound(b""), "x.wav")


def test_a_wav_of_what_is_no_number_is_refused(tmp_path: Path) -> None:
    floats = np.array([0.5, np.nan], "<f4").tobytes()
    head = sound(floats, width=4)
    assert head[20:22] == b"\x01\x00"
    assert "not finite numbers" in refused(tmp_path, head[:20] + b"\x03\x00" + head[22:], "x.wav")


def test_an_effect_of_ours_that_does_not_fit_is_refused_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    band = "[effect]\n[[effect.perceptions]]\n[[effect.perceptions.channels]]\nbands = [{%s}]\n"
    for text, reason in (
        ("", "missing required field effect"),
        ("[effect]\norigin = 'haptics'", "did you mean 'haptic'?"),
        (band % 'kind = "waves"', "did you mean 'wave'?"),
        (band % 'kind = "wave", segments = [{keyframes = [{time_s = 2}, {time_s = 1}]}]', "ascend"),
        (band % 'kind = "samples"', "needs sample_rate_hz"),
        (band % 'kind = "wave", segments = [{samples = "AAA="}]', "4 for each"),
    ):
        path.write_text(text)
        assert reason in refusal(path)


# Altered samples


FUZZED = [
    "haptic/valid_v1.haptic", "ahap/valid_fields.ahap", "hjif/texture_template.hjif",
    "hjif/synth2ch_8k_wav.hjif", "wav/wav_int16_3c.wav", "wav/wav_float32.wav",
]  # fmt: skip
PIECES = [
    b"", b"{", b"}", b"[", b"]", b",", b'"', b"-1", b"1e400", b"NaN", b"null", b"true", b"\x00",
    b"\xff\xff\xff\xff", b"99999999999999999999", b'"\\ud800"', b"[[[[", b"{}", b"0.5",
]  # fmt: skip
change = st.tuples(
    st.floats(0, 1), st.integers(0, 12), st.one_of(st.sampled_from(PIECES), st.binary(max_size=6))
)


def read_or_refuse(name: str, changes: list[tuple[float, int, bytes]], folder: Path) -> None:
    """See that a changed sample is refused in one line, or loads, is written and sounds."""
    original = sample(name)
    data = original.read_bytes()
    for place, length, piece in changes:
        at = int(place * len(data))
        data = data[:at] + piece + data[at + length :]
    path = folder / f"fuzzed{original.suffix}"
    path.write_bytes(data)
    try:
        effect = load_effect(path)
        for target in ("out.toml", "out.hjif", "out.ahap", "out.haptic", "out.json"):
            save_effect(effect, folder / target, force=True)
    except InputError as error:
        reason = str(error)
    else:
        reason = ""
        assert load_effect(folder / "out.toml") == effect
    assert "\n" not in reason


@pytest.mark.skipif(not SAMPLES.is_dir() and os.environ.get("CI") != "true", reason="no samples")
@settings(max_examples=40)
@given(st.sampled_from(FUZZED), st.lists(change, min_size=1, max_size=3))
@example("haptic/valid_v1.haptic", [(0.5, 0, b"\xff")])
def test_a_changed_sample_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, name: str, changes: list[tuple[float, int, bytes]]
) -> None:
    read_or_refuse(name, changes, tmp_path_factory.mktemp("fuzz"))


@pytest.mark.ci
@pytest.mark.skipif(not SAMPLES.is_dir() and os.environ.get("CI") != "true", reason="no samples")
@settings(max_examples=1500)
@given(st.sampled_from(FUZZED), st.lists(change, min_size=1, max_size=3))
def test_many_changed_samples_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, name: str, changes: list[tuple[float, int, bytes]]
) -> None:
    read_or_refuse(name, changes, tmp_path_factory.mktemp("fuzz"))


# Models


def test_an_xml_with_entities_is_refused_unexpanded(tmp_path: Path) -> None:
    path = tmp_path / "x.xml"
    laughs = '<!ENTITY l0 "ha">' + "".join(
        f'<!ENTITY l{i} "' + f"&l{i - 1};" * 9 + '">' for i in range(1, 9)
    )
    for text in (
        f"<!DOCTYPE modelSet [{laughs}]><modelSet>&l8;</modelSet>",
        '<!DOCTYPE m [<!ENTITY x SYSTEM "file:///etc/passwd">]><modelSet>&x;</modelSet>',
    ):
        path.write_text(text)
        with pytest.raises(InputError, match="has a document type: must be plain XML"):
            load_model(path)
        path.write_bytes(text.encode("utf-16"))
        with pytest.raises(InputError, match="not valid XML"):
            load_model(path)


@pytest.mark.parametrize(
    "text", ["", "<a/>", "<modelSet>", "<modelSet/>", "<modelSet>" + "<a>" * 50_000]
)
def test_an_xml_that_is_no_model_set_is_refused_in_a_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.xml"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        load_model(path)
    assert "\n" not in str(refused.value)
