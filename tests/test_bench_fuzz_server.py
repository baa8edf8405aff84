"""The benchmark that sends random messages to a server: what it sends, and its arithmetic."""

import json
import random
from collections import Counter

from benchmarks.fuzz_server import LEGAL, random_message
from benchmarks.server import block_figures
from tactile.messages import JSON_PROTOCOL, Failure
from tactile.server.decoding import ENCODINGS, read


def payload(frame: bytes) -> bytes:
    return frame[8:] if frame[1] == 0xFE else frame[6:]


def test_all_kinds_are_sent_and_about_a_third_is_refused() -> None:
    rng = random.Random(1)
    kinds: Counter[str] = Counter()
    refused, count = 0, 2000
    for _ in range(count):
        data = payload(random_message(rng)).decode("utf-8", "replace")
        made = read(data, ENCODINGS[JSON_PROTOCOL])
        if isinstance(made, Failure):
            refused += 1
        else:
            kinds[json.loads(data)["type"]] += 1
    assert set(kinds) == set(LEGAL)
    assert count / 10 < refused < count / 2


def test_blocks_are_counted_from_the_beginning_of_the_fuzz() -> None:
    before = {"blocks": 1000, "late_blocks": 7, "skipped_samples": 32, "underruns": 1}
    after = {"blocks": 11_000, "late_blocks": 9, "skipped_samples": 160, "underruns": 1}
    figures = {figure.name: figure.value for figure in block_figures("x", before, after, 10)}
    assert figures["x.blocks"] == 10_000
    assert figures["x.late_blocks"] == 2 + 128 / 16
    assert figures["x.underruns"] == 0
