# SPDX-License-Identifier: Apache-2.0
"""The page of ``keymint report``: one HTML file without scripts, which loads nothing. Names are always escaped."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from comarmor.text import encodable_value, one_line
from keymint.drawing.html_report import policy_source, template_text
from keymint.drawing.svg import environment


def audit_page(document: Mapping[str, Any]) -> bytes:
    """Return the page as UTF-8.

    Args:
        document: the report; ``docs/json.md`` describes it.
    """
    style = template_text("report.css") + template_text("audit.css")
    policy = f"default-src 'none'; style-src {policy_source(style)}; base-uri 'none'; form-action 'none'"
    context = {"style": Markup(style), "policy": policy, **_printable(encodable_value(document))}  # noqa: S704 - ours
    return environment().get_template("audit.html.j2").render(context).encode()


def _printable(value: Any) -> Any:
    """Return a value with every text in it on one line, without characters that hide or reorder others."""
    if isinstance(value, str):
        return one_line(value)
    if isinstance(value, Mapping):
        return {one_line(key): _printable(item) for key, item in value.items()}
    return [*map(_printable, value)] if isinstance(value, Sequence) else value
