"""Configuration of the documentation: ``sphinx-build -W -b html docs build/docs``."""

import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from generate import generate  # noqa: E402  (found in this folder)

project = "tactile"
author = "the tactile authors"
copyright = author  # noqa: A001  (the name that Sphinx reads)
version = release = installed_version("tactile-display")

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
]
exclude_patterns: list[str] = []
smartquotes = False  # of "--json" it would make a dash
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4

html_theme = "furo"
html_title = f"tactile {version}"

default_role = "py:obj"  # a name in single backticks is a link where it is documented
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autosummary_generate = False
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

generate(HERE / "generated")


ARRAY = r"~?numpy\.ndarray\[tuple\[.*?\], .*?\[~?numpy\.\w+\]\]"
ARRAY_LIKE = (
    r"~?numpy\._typing\._array_like\._Buffer \| .*?_NestedSequence\[complex \| bytes \| str\]"
)


def shorten(*arguments: Any) -> tuple[str | None, str | None]:
    """Return a signature and what it returns, with arrays named as briefly as numpy names them."""
    signature, returns = arguments[-2:]
    for long, short in (
        (ARRAY, "~numpy.ndarray"),
        (ARRAY_LIKE, "~numpy.typing.ArrayLike"),
        ("<factory>", "..."),
    ):
        signature = signature and re.sub(long, short, signature)
        returns = returns and re.sub(long, short, returns)
    return signature, returns


def setup(app: Sphinx) -> None:
    """Have Sphinx call what is defined here."""
    app.connect("autodoc-process-signature", shorten)
