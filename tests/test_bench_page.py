"""The benchmark of the page: registered, honest about what is missing, and no contact is lost."""

import math
import shutil

import pytest

from benchmarks import BENCHMARKS, page


def test_the_page_is_measured_by_default() -> None:
    assert BENCHMARKS["page"] is page.measure_page


def test_without_a_browser_and_node_each_figure_says_what_is_needed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    figures = list(page.page_figures())
    reasons = {figure.name: figure.reason for figure in figures}
    assert all(math.isnan(figure.value) for figure in figures)
    assert "chromium" in reasons["page.latency"]
    assert "chromium" in reasons["page.late_blocks"]
    assert "chromium" in reasons["page.frames_per_second"]
    assert "node" in reasons["page.client"]


@pytest.mark.ci
def test_each_contact_that_the_client_sends_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    """How many the client leaves out depends on the machine, and is not judged here.

    Send fewer contacts than the benchmark does, so that a slow server does not fall so far behind
    that the client gives it up.
    """
    monkeypatch.setattr(page, "CONTACTS", 1000)
    if why := page.no_node():
        pytest.skip(why)
    figures = {figure.name: figure for figure in page.client_figures()}
    assert figures["page.client.contacts"].value > 0
    assert figures["page.client.lost"].value == 0
