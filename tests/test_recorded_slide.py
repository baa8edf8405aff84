"""Recordings are read as what they are, and what cannot be fitted is refused with what would do."""

import io
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import wavfile

from tactile.arrays import Floats
from tactile.errors import InputError, NotFoundError
from tactile.texture import recorded_slide
from tactile.texture.recorded_slide import load_recorded

RATE = 10000
TONE = 0.5 * np.sin(2 * np.pi * 100 * np.arange(RATE) / RATE)


def wav(path: Path, signal: NDArray[Any] = TONE, rate: int = RATE) -> Path:
    """Write int16 full scale for floats, other arrays as they are."""
    data = np.round(signal * 32767).astype(np.int16) if signal.dtype == np.float64 else signal
    wavfile.write(path, rate, data)
    return path


@pytest.mark.parametrize("kind", ["uint8", "int16", "int32", "float32"])
def test_every_sample_format_of_a_wav_is_read_to_the_same_scale(tmp_path: Path, kind: str) -> None:
    scale = {"uint8": 127, "int16": 2**15 - 1, "int32": 2**31 - 1, "float32": 1}[kind]
    data = TONE * scale
    if kind != "float32":
        data = np.round(data)
    if kind == "uint8":
        data = data + 128
    path = wav(tmp_path / "tone.wav", data.astype(kind))
    found = load_recorded(path, speed=0.04, full_scale=100.0)
    assert found.calibrated
    assert found.quantity == "acceleration"
    assert found.sample_rate == RATE
    np.testing.assert_allclose(found.signal, 100 * TONE, atol=0.9 if kind == "uint8" else 0.01)
    assert np.all(found.speed == 0.04)


def test_24_bits_are_read(tmp_path: Path) -> None:
    codes = np.round(TONE * (2**23 - 1)).astype("<i4")
    packed = codes.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    header = struct.pack("<HHIIHH", 1, 1, RATE, RATE * 3, 3, 24)
    chunks = b"fmt " + struct.pack("<I", 16) + header
    chunks += b"data" + struct.pack("<I", len(packed)) + packed
    path = tmp_path / "tone.wav"
    path.write_bytes(b"RIFF" + struct.pack("<I", 4 + len(chunks)) + b"WAVE" + chunks)
    np.testing.assert_allclose(load_recorded(path, speed=0.04).signal, TONE, atol=1e-6)


def test_a_wav_without_its_full_scale_is_uncalibrated(tmp_path: Path) -> None:
    found = load_recorded(wav(tmp_path / "a.wav"), speed=0.04, normal_force=0.3)
    assert not found.calibrated
    assert found.normal_force is not None
    assert np.all(found.normal_force == 0.3)


@pytest.mark.parametrize(
    ("column", "quantity", "unit"),
    [
        ("acceleration_m_s2", "acceleration", 1.0),
        pytest.param("velocity_mm_s", "velocity", 1e-3, marks=pytest.mark.ci),
        pytest.param("displacement_um", "displacement", 1e-6, marks=pytest.mark.ci),
        ("force_n", "force", 1.0),
    ],
)
def test_a_table_says_what_it_is_by_its_names(
    tmp_path: Path, column: str, quantity: str, unit: float
) -> None:
    time = np.arange(len(TONE)) / RATE
    speed, force = 40 + time, 0.5 + 0.1 * time
    rows = np.column_stack([time, TONE, speed, force])
    path = tmp_path / "t.csv"
    np.savetxt(path, rows, delimiter=",", header=f"time_s,{column},speed_mm_s,normal_force_n",
               comments="", fmt="%.9g")  # fmt: skip
    npz = tmp_path / "t.npz"
    arrays = {"speed_mm_s": speed, "normal_force_n": force, "sample_rate_hz": np.array(RATE)}
    np.savez(npz, allow_pickle=False, **{column: TONE}, **arrays)
    for found in (load_recorded(path), load_recorded(npz)):
        assert found.quantity == quantity
        assert found.calibrated
        assert found.sample_rate == pytest.approx(RATE)
        np.testing.assert_allclose(found.signal, TONE * unit, atol=1e-8 * unit)
        np.testing.assert_allclose(found.speed, speed * 1e-3, rtol=1e-6)
        assert found.normal_force is not None
        np.testing.assert_allclose(found.normal_force, force, rtol=1e-6)


def csv(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def npz(path: Path, **arrays: object) -> Path:
    np.savez(path, **arrays)  # type: ignore[arg-type]
    return path


def flawed(position: int, value: float) -> Floats:
    signal = TONE.copy()
    signal[position] = value
    return signal


def truncated(path: Path) -> Path:
    buffer = io.BytesIO()
    wavfile.write(buffer, RATE, np.round(TONE * 32767).astype(np.int16))
    path.write_bytes(buffer.getvalue()[:-4000])
    return path


BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "silence": (lambda p: wav(p / "a.wav", 0 * TONE), "is silent; check the sensor's gain"),
    "a step of noise": (
        lambda p: wav(p / "a.wav", np.random.default_rng(0).integers(-1, 2, RATE).astype(np.int16)),
        "is silent",
    ),
    "clipping": (
        lambda p: wav(p / "a.wav", np.clip(4 * TONE, -1, 1)),
        r"% of its samples are at 1, the largest value: clipped; record with less gain",
    ),
    "a slow rate": (lambda p: wav(p / "a.wav", rate=1000), "1000 samples per second: .* 2000"),
    "stereo": (
        lambda p: wav(p / "a.wav", np.ones((RATE, 2), np.int16)),
        "has 2 channels; must have one",
    ),
    "a cut off WAV": (lambda p: truncated(p / "a.wav"), "is truncated; copy it again"),
    "no WAV": (lambda p: csv(p / "a.wav", "hello"), "not a readable WAV file"),
    "an empty WAV": (lambda p: csv(p / "a.wav", ""), "not a readable WAV file"),
    "another file": (lambda p: csv(p / "a.mp3", "hello"), "must be a .wav, .csv or .npz"),
    "no signal": (lambda p: csv(p / "a.csv", "time_s,speed\n0,1\n"), "no signal; needs one of"),
    "two signals": (
        lambda p: csv(p / "a.csv", "time_s,force_n,velocity_mm_s\n0,1,1\n"),
        "velocity_mm_s and force_n: which is it",
    ),
    "one row": (lambda p: csv(p / "a.csv", "time_s,force_n\n0,1\n"), "has 1 rows"),
    "an uneven time": (
        lambda p: csv(p / "a.csv", "time_s,force_n\n0,1\n0.0001,2\n0.0002,1\n0.0009,2\n"),
        r"line 5: time_s increases by 0.0007 s, elsewhere by 0.0001 s",
    ),
    "a word": (
        lambda p: csv(p / "a.csv", "time_s,force_n\n0,1\n0.0001,much\n"),
        "line 3: force_n = 'much': must be a finite number",
    ),
    "no number": (
        lambda p: npz(p / "a.npz", force_n=flawed(7, np.nan), sample_rate_hz=RATE),
        r"sample 7 \(0.001 s\) is nan: must be finite; invalid samples: 1",
    ),
    "no rate": (lambda p: npz(p / "a.npz", force_n=TONE), "no array 'sample_rate_hz'"),
    "two columns": (
        lambda p: npz(p / "a.npz", force_n=np.ones((9, 2)), sample_rate_hz=RATE),
        r"force_n is float64 \(9, 2\): must be numbers \(S,\)",
    ),
    "words": (
        lambda p: npz(p / "a.npz", force_n=np.array(["a"] * 9), sample_rate_hz=RATE),
        r"force_n is <U1 \(9,\): must be numbers",
    ),
    "objects": (
        lambda p: npz(p / "a.npz", force_n=np.array([{}] * 9), sample_rate_hz=RATE),
        "not a readable NPZ file",
    ),
    "sides of two lengths": (
        lambda p: npz(p / "a.npz", force_n=TONE, speed_mm_s=np.ones(9), sample_rate_hz=RATE),
        "speed_mm_s has 9 values for 10000 samples",
    ),
    "no NPZ": (lambda p: csv(p / "a.npz", "hello"), "not a readable NPZ file"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_fitted_is_one_clear_line(tmp_path: Path, case: str) -> None:
    make, message = BAD[case]
    path = make(tmp_path)
    with pytest.raises(InputError, match=message) as found:
        load_recorded(path, speed=0.04)
    assert str(path) in str(found.value)
    assert "\n" not in str(found.value)


def test_a_header_that_claims_4_gb_takes_no_memory(tmp_path: Path) -> None:
    path = wav(tmp_path / "a.wav")
    raw = bytearray(path.read_bytes())
    at = raw.index(b"data") + 4
    raw[4:8] = raw[at : at + 4] = b"\xf0\xff\xff\xff"
    path.write_bytes(raw)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="is truncated"):
            load_recorded(path, speed=0.04)
        assert tracemalloc.get_traced_memory()[1] < 2**26
    finally:
        tracemalloc.stop()


def test_a_wav_that_is_too_large_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorded_slide, "LARGEST_WAV", 1000)
    with pytest.raises(InputError, match="is larger than"):
        load_recorded(wav(tmp_path / "a.wav"), speed=0.04)


def test_a_missing_speed_and_a_missing_file_say_what_would_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="speed is missing; give --speed-mm-s, or a column"):
        load_recorded(wav(tmp_path / "a.wav"))
    with pytest.raises(NotFoundError, match="no such file"):
        load_recorded(tmp_path / "b.wav", speed=0.04)
    with pytest.raises(InputError, match="--speed-mm-s -1: must be above 0"):
        load_recorded(wav(tmp_path / "a.wav"), speed=-1.0)


def test_a_drift_does_not_change_what_is_fitted(tmp_path: Path) -> None:
    """A parabola of a hundred times the signal leaks 2 %, −34 dB, through the edge at 10 Hz."""
    from tactile.texture.slide_strokes import strokes_of

    noise = 0.01 * np.random.default_rng(0).standard_normal(3 * RATE)
    drift = np.linspace(-0.6, 0.8, len(noise)) ** 2
    plain, drifting = (
        strokes_of(load_recorded(wav(tmp_path / f"{k}.wav", s), speed=0.04), 2e-5, 0.02)[0]
        for k, s in enumerate((noise, noise + drift))
    )
    inner = slice(len(plain) // 4, -len(plain) // 4)
    error = np.std((plain - drifting)[inner]) / np.std(plain[inner])
    assert error < 0.04
