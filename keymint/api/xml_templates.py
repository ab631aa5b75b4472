# SPDX-License-Identifier: Apache-2.0
"""Documents in XML that plugins write from templates of Jinja, for formats that no run of most users needs."""

from __future__ import annotations

from pathlib import Path

_SPECIAL = {"&": "&amp;", "<": "&lt;", ">": "&gt;", "\r": "&#13;"}
_TEXT = str.maketrans(_SPECIAL)
_ATTRIBUTE = str.maketrans({**_SPECIAL, '"': "&quot;", "\n": "&#10;", "\t": "&#09;"})


def xml_document(template: Path, **context: object) -> bytes:
    """Return a document in UTF-8.

    Args:
        template: file of the template. In it the filter ``xml`` makes a text that of an element, ``xml(True)`` that of
            an attribute. Other texts are escaped for both, apostrophes included.
        context: what the template names.
    """
    from jinja2 import Environment, StrictUndefined  # noqa: PLC0415 - slow
    from markupsafe import Markup  # noqa: PLC0415 - as above

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )

    def escaped(text: str, attribute: bool = False) -> Markup:
        return Markup(text.translate(_ATTRIBUTE if attribute else _TEXT))  # noqa: S704 - escaped here

    environment.filters["xml"] = escaped
    return environment.from_string(template.read_text(encoding="utf-8")).render(context).encode()
