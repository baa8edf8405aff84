"""The library of LSL for tests, and streams that are found on this machine."""

import os
from collections.abc import Iterator

import pytest

if os.environ.get("CI") == "true":  # where a missing library is a failure
    import pylsl as pylsl
else:
    pylsl = pytest.importorskip("pylsl")


@pytest.fixture(scope="module", autouse=True)
def loopback(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Let liblsl look for streams on this machine also where a network has no multicast."""
    file = tmp_path_factory.mktemp("lsl") / "lsl_api.cfg"
    file.write_text("[lab]\nKnownPeers = {127.0.0.1}\n[log]\nlevel = -3\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("LSLAPICFG", str(file))
        yield
