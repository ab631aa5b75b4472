# SPDX-License-Identifier: Apache-2.0
"""Documents in XML that plugins write from templates of Jinja, for formats that no run of most users needs."""

from __future__ import annotations

from pathlib import Path

_SPECIAL = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", "\r": "&#13;"})


def xml_document(template: Path, **context: object) -> bytes:
    """Return a document in UTF-8.

    Args:
        template: file of the template, in which the filter ``xml`` makes a text that of an element; attributes are
            escaped by themselves.
        context: what the template names.
    """
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415 - slow
    from markupsafe import Markup  # noqa: PLC0415 - as above

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters["xml"] = lambda text: Markup(text.translate(_SPECIAL))  # noqa: S704 - quotes stay as they are
    return environment.from_string(template.read_text(encoding="utf-8")).render(context).encode()
