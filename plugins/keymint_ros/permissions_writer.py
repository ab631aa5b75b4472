# SPDX-License-Identifier: Apache-2.0
"""Writes ``permissions.xml``, the document of a subject's rules."""

from __future__ import annotations

import os.path
import re
from collections.abc import Iterable
from functools import lru_cache
from urllib.parse import quote
from xml.sax.saxutils import escape

from comarmor.errors import Origin
from keymint.ir import Rule, SubjectRules
from keymint_ros.permissions import digest

_UNSAFE = re.compile(r"[%;\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")
_SPECIAL = re.compile('[&<>"\r\n\t]')
_ENTITIES = {'"': "&quot;", "\r": "&#13;", "\n": "&#10;", "\t": "&#9;"}


def render(rules: SubjectRules, base: str, *, name: str = "", overrides: Iterable[str] = ()) -> bytes:
    """Return the document of a subject's rules.

    Args:
        rules: the rules.
        base: folder that origins are relative to, ending in a slash; or empty.
        name: the grant's label; if empty, the subject is the label.
        overrides: XML of ``<domains>``, ``<subject_name>``, ``<validity>`` to keep.
    """
    head = "".join(f"      {element}\n" for element in overrides)
    body = "".join(_rule(rule, base) for rule in rules.rules)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f"<!-- What the policy lets {rules.subject} do. Edits are kept as long as the policy does not change as well;\n"
        "     <domains>, <subject_name> and <validity> at the top of the grant override the defaults, and stay. -->\n"
        f'<package format="2" digest="{digest(rules.rules)}">\n'
        "  <permissions>\n"
        f'    <grant name="{_text(name or rules.subject)}">\n'
        f"{head}{body}"
        "    </grant>\n"
        "  </permissions>\n"
        "</package>\n"
    ).encode()


def _rule(rule: Rule, base: str) -> str:
    audit = ' modifier="AUDIT"' if rule.audit else ""
    expressions = "".join(f"        <attachment>{_text(each)}</attachment>\n" for each in rule.expressions)
    partitions = "".join(f"<partition>{_text(each)}</partition>" for each in rule.partitions)
    partition_list = f"        <partitions>{partitions}</partitions>\n" if partitions else ""
    permissions = "".join(f"<{each}/>" for each in rule.permissions)
    return (
        f'      <{rule.kind} qualifier="{rule.effect}"{audit} origin="{_text(_place(rule.origin, base))}">\n'
        f"{expressions}{partition_list}"
        f"        <permissions>{permissions}</permissions>\n"
        f"      </{rule.kind}>\n"
    )


def _place(origin: Origin, base: str) -> str:
    """Return an origin as ``file:line``, followed by the places that included the file."""
    return "; ".join(f"{_relative(each.file, base)}:{each.line}" for each in (origin, *origin.chain))


@lru_cache(maxsize=1024)
def _relative(file: str, base: str) -> str:
    """Return a path relative to a folder where the two paths alone allow it, with unsafe characters quoted."""
    if file.startswith(base):
        file = file.removeprefix(base)
    elif not file.startswith("/") and not base.startswith("/"):
        file = os.path.relpath(file, base)
    return _UNSAFE.sub(_percent_encoded, file)


def _percent_encoded(match: re.Match[str]) -> str:
    return quote(match.group(), safe="", errors="surrogateescape")


def _text(text: str) -> str:
    return escape(text, _ENTITIES) if _SPECIAL.search(text) else text
