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
        base: folder that origins are written relative to, ending in a slash; or empty.
        name: the grant's label; the subject when it is empty.
        overrides: XML of ``<domains>``, ``<subject_name>``, ``<validity>`` to keep.
    """
    said = "".join(f"      {part}\n" for part in overrides)
    body = "".join(_rendered(rule, base) for rule in rules.rules)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f"<!-- What the policy lets {rules.subject} do. Edits are kept as long as the policy does not change as well;\n"
        "     <domains>, <subject_name> and <validity> at the top of the grant override the defaults, and stay. -->\n"
        f'<package format="2" digest="{digest(rules.rules)}">\n'
        "  <permissions>\n"
        f'    <grant name="{_text(name or rules.subject)}">\n'
        f"{said}{body}"
        "    </grant>\n"
        "  </permissions>\n"
        "</package>\n"
    ).encode()


def _rendered(rule: Rule, base: str) -> str:
    audit = ' modifier="AUDIT"' if rule.audit else ""
    expressions = "".join(f"        <attachment>{_text(one)}</attachment>\n" for one in rule.expressions)
    partitions = "".join(f"<partition>{_text(one)}</partition>" for one in rule.partitions)
    narrowed = f"        <partitions>{partitions}</partitions>\n" if partitions else ""
    permissions = "".join(f"<{one}/>" for one in rule.permissions)
    return (
        f'      <{rule.kind} qualifier="{rule.effect}"{audit} origin="{_text(_place(rule.origin, base))}">\n'
        f"{expressions}{narrowed}"
        f"        <permissions>{permissions}</permissions>\n"
        f"      </{rule.kind}>\n"
    )


def _place(origin: Origin, base: str) -> str:
    """Return an origin as ``file:line``, followed by the places that include the file."""
    return "; ".join(f"{_relative(one.file, base)}:{one.line}" for one in (origin, *origin.chain))


@lru_cache(maxsize=1024)
def _relative(file: str, base: str) -> str:
    """Return a path relative to a folder as far as that can be told from the two alone; with odd characters quoted."""
    if file.startswith(base):
        file = file.removeprefix(base)
    elif not file.startswith("/") and not base.startswith("/"):
        file = os.path.relpath(file, base)
    return _UNSAFE.sub(_quoted, file)


def _quoted(found: re.Match[str]) -> str:
    return quote(found.group(), safe="", errors="surrogateescape")


def _text(text_: str) -> str:
    return escape(text_, _ENTITIES) if _SPECIAL.search(text_) else text_
