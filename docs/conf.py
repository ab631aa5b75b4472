# SPDX-License-Identifier: Apache-2.0
"""Sphinx makes a site of the pages that repository pages show as they are: ``make docs``.

The source directory is the repository, so links between pages are relative file names in both places.
"""

import sys
from pathlib import Path

from sphinx.application import Sphinx

CHECKOUT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(CHECKOUT / "docs"), str(CHECKOUT), str(CHECKOUT / "plugins")]

import keymint  # noqa: E402 - found by the line above

project = "Keymint"
author = project_copyright = "The Keymint developers"
release = keymint.__version__
extensions = ["generated", "myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "docs/index"
include_patterns = ["docs/**.md", "examples/README.md", "examples/**/README.md", "benchmarks/README.md", "*.md"]
exclude_patterns = ["**/.*", "**/_*", "build", "dist", "tests", "*_ws"]
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence", "deflist", "fieldlist"]
html_theme = "furo"
html_title = f"Keymint {release}"
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["site.css"]
highlight_language = "none"
smartquotes = False
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_use_ivar = True
# Asked by `make docs-links` only. Anchors of pages that scripts make are not in what a server sends.
linkcheck_anchors_ignore_for_url = [r"https://github\.com/.*"]
linkcheck_retries = 2
linkcheck_timeout = 30
# The language of these blocks is no Python to a lexer: they leave out what does not matter, by an ellipsis.
suppress_warnings = ["misc.highlighting_failure"]


BELOW = {"docs/adr/README": "0*", "examples/README": "*/README"}
"""Pages that list others in a table, and which ones. The sidebar needs the list as Sphinx writes it."""


def with_pages_below(_app: Sphinx, page: str, source: list[str]) -> None:
    """Put the pages that a page lists below it in the sidebar."""
    if page in BELOW:
        source[0] += f"\n```{{toctree}}\n:hidden:\n:glob:\n\n{BELOW[page]}\n```\n"


def setup(app: Sphinx) -> None:
    """Leave out the signatures of data types: their attributes say more than a generated method."""
    app.connect("source-read", with_pages_below)
    app.connect(
        "autodoc-process-signature", lambda _app, _what, _name, _object, _options, arguments, returns: (
            ("", returns) if arguments == "(*arguments, **named)" else None
        ),
    )  # fmt: skip
